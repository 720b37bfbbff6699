//! Which gratings to believe: nine wavelengths into the moments at sections I and II, without those that lie.
//!
//! What there is to compare. Bending stretches one side of the shaft and shortens the other: the mean of three fibres
//! does not feel it, and the sections stand in one eye, so their means must agree; section III is the witness. What two
//! moments say across the force must be nothing. A reading never repeats to the last digit while its neighbours go on.
//! And no grating is pulled by more than a few nm.
//!
//! A single grating that lies is rebuilt: the mean of its section is that of the others, so it is thrice that mean less
//! its two neighbours. Where two lie, the section is lost.

use super::unknowns::Doubt;
use crate::numbers::math::sqrt;
use crate::tool::sensing::{Calibration, FIBRES, SECTIONS};
use nalgebra::{Matrix2x3, Vector2};

/// No shaft is bent or warmed so far, nm.
const FARTHEST_NM: f64 = 8.0;
/// The same number so often is no reading any more.
const STUCK: u8 = 12;
/// Deviations from which on a comparison fails.
const DEVIATIONS: f64 = 6.0;
/// How unlike fibres feel a bend: share of it that stays in their mean.
const COUPLING: f64 = 0.002;
/// Readings that the slow comparison looks back on.
const SLOW: f64 = 200.0;
/// Readings in a row that must be in order before a section is believed again.
pub(super) const BELIEVED: u16 = 200;

/// A set of gratings: bit `3 section + fibre`.
pub type Set = u16;

/// Two peaks of a section that changed places: all but the one that stays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Swap {
    /// Section I or II.
    pub section: usize,
    /// The fibre that stays.
    pub stays: usize,
}

impl Swap {
    /// The gratings.
    pub fn set(self) -> Set {
        of_section(self.section) & !(1 << (FIBRES * self.section + self.stays))
    }
}

/// The gratings of a section.
pub(super) fn of_section(section: usize) -> Set {
    0b111 << (FIBRES * section)
}

/// What the fibres say of the moments at sections I and II.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moments {
    /// Whether a section says anything.
    pub usable: [bool; 2],
    /// mN·mm.
    pub moment: [Vector2<f64>; 2],
    /// Variance of each component, (mN·mm)².
    pub variance: [f64; 2],
    /// Shifts of the fibres without their mean, as two differences.
    pub differences: [Vector2<f64>; 2],
    /// Mean shift, nm.
    pub common_nm: [f64; 2],
    /// Size of the moment along which a rebuilt grating errs per nm, and which way; zero where none is rebuilt.
    pub rebuilt: [Vector2<f64>; 2],
}

/// Comparisons of the sections' means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// The section that stands farthest off, where one fails.
    pub odd: Option<usize>,
    /// Whether it failed slowly: by its mean over many readings.
    pub slowly: bool,
}

/// The interrogator, watched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interrogator {
    reference_nm: [[f64; FIBRES]; SECTIONS],
    pub(super) gains: [Matrix2x3<f64>; 2],
    /// Variance of a moment's component per variance of a wavelength.
    share: [f64; 2],
    noise_nm: f64,
    reference_doubt_nm: f64,
    warmth: f64,
    last: [[f64; FIBRES]; SECTIONS],
    repeats: [[u8; FIBRES]; SECTIONS],
    /// Slow means: of each section's mean less the others', and of what that is allowed.
    slow: [f64; SECTIONS],
    slow_size: f64,
    slow_count: f64,
}

impl Interrogator {
    /// Of a calibration and what it does not know.
    pub fn new(c: &Calibration, doubt: &Doubt) -> Self {
        let gains = c.gains.map(|k| {
            let mean = k.column_sum() / 3.0;
            Matrix2x3::from_columns(&[k.column(0) - mean, k.column(1) - mean, k.column(2) - mean])
        });
        Self {
            reference_nm: c.reference_nm,
            gains,
            share: gains.map(|k| k.norm_squared() / 2.0),
            noise_nm: c.noise_nm,
            reference_doubt_nm: doubt.reference_nm,
            warmth: doubt.warmth,
            last: [[f64::NAN; FIBRES]; SECTIONS],
            repeats: [[0; FIBRES]; SECTIONS],
            slow: [0.0; SECTIONS],
            slow_size: 0.0,
            slow_count: 0.0,
        }
    }

    /// Wavelengths with two peaks of a section back in their places.
    pub fn put_back(swap: Swap, w: &[[f64; FIBRES]; SECTIONS]) -> [[f64; FIBRES]; SECTIONS] {
        let mut out = *w;
        if let Some(s) = out.get_mut(swap.section) {
            let [a, b, c] = *s;
            *s = match swap.stays {
                0 => [a, c, b],
                1 => [c, b, a],
                _ => [b, a, c],
            };
        }
        out
    }

    /// Shifts with two peaks back in their places.
    pub fn shifts_back(
        &self,
        swap: Swap,
        shifts: &[[f64; FIBRES]; SECTIONS],
    ) -> [[f64; FIBRES]; SECTIONS] {
        let mut w = *shifts;
        for i in 0..SECTIONS {
            for k in 0..FIBRES {
                w[i][k] += self.reference_nm[i][k];
            }
        }
        let mut out = Self::put_back(swap, &w);
        for i in 0..SECTIONS {
            for k in 0..FIBRES {
                out[i][k] -= self.reference_nm[i][k];
            }
        }
        out
    }

    /// Shifts from the reference, nm, and the gratings that say nothing: not finite, out of all bounds, or stuck.
    #[inline]
    pub fn look(&mut self, w: &[[f64; FIBRES]; SECTIONS]) -> ([[f64; FIBRES]; SECTIONS], Set) {
        let mut shifts = [[0.0; FIBRES]; SECTIONS];
        let (mut silent, mut still): (Set, Set) = (0, 0);
        for i in 0..SECTIONS {
            for k in 0..FIBRES {
                let bit = 1 << (FIBRES * i + k);
                let shift = w[i][k] - self.reference_nm[i][k];
                // false for NaN
                if shift.abs() < FARTHEST_NM {
                    shifts[i][k] = shift;
                } else {
                    silent |= bit;
                }
                if w[i][k] == self.last[i][k] {
                    self.repeats[i][k] = self.repeats[i][k].saturating_add(1);
                } else {
                    self.repeats[i][k] = 0;
                }
                if self.repeats[i][k] >= STUCK {
                    still |= bit;
                }
                self.last[i][k] = w[i][k];
            }
        }
        // where all stand still it is the world, or a source that gives each reading several times
        if still.count_ones() <= 3 {
            silent |= still;
        }
        (shifts, silent)
    }

    /// Whether the means of the sections without a bad grating agree, and how they did over the last readings.
    #[inline]
    pub fn agree(&mut self, shifts: &[[f64; FIBRES]; SECTIONS], bad: Set) -> Agreement {
        let mut means = [0.0; SECTIONS];
        let (mut bend, mut warm) = (0.0_f64, 0.0_f64);
        let mut agreement = Agreement {
            odd: None,
            slowly: false,
        };
        if bad != 0 {
            // two means that differ do not say which is wrong
            self.slow = [0.0; SECTIONS];
            self.slow_count = 0.0;
            return agreement;
        }
        for i in 0..SECTIONS {
            let s = &shifts[i];
            means[i] = (s[0] + s[1] + s[2]) / 3.0;
            warm = warm.max(means[i].abs());
            for x in s {
                bend = bend.max((x - means[i]).abs());
            }
        }
        let (still, warmed) = (self.reference_doubt_nm, self.warmth * warm);
        let unlike = sqrt(still * still + warmed * warmed);
        let allowed = COUPLING * bend;
        let total = means[0] + means[1] + means[2];
        // of a section's mean less that of the two others
        let deviation = sqrt(0.5 * (self.noise_nm * self.noise_nm + unlike * unlike));
        let limit = DEVIATIONS * deviation + allowed;
        self.slow_count = (self.slow_count + 1.0).min(SLOW);
        let weight = 1.0 / self.slow_count;
        self.slow_size += (unlike * DEVIATIONS * 0.8 + allowed - self.slow_size) * weight;
        let averaged = self.noise_nm * sqrt(0.5 / self.slow_count) * DEVIATIONS;
        let (mut worst, mut worst_slow) = (1.0, 1.0);
        for i in 0..SECTIONS {
            let off = 1.5 * means[i] - 0.5 * total;
            // a single wild reading is no drift
            self.slow[i] += (off.min(limit).max(-limit) - self.slow[i]) * weight;
            if off.abs() > worst * limit {
                worst = off.abs() / limit;
                agreement = Agreement {
                    odd: Some(i),
                    slowly: false,
                };
            }
            let far = self.slow[i].abs() / (averaged + self.slow_size);
            if agreement.odd.is_none_or(|_| agreement.slowly) && far > worst_slow {
                worst_slow = far;
                agreement = Agreement {
                    odd: Some(i),
                    slowly: true,
                };
            }
        }
        agreement
    }

    /// The moments without the bad gratings.
    #[inline]
    pub fn moments(&self, shifts: &[[f64; FIBRES]; SECTIONS], bad: Set) -> Moments {
        let mut made = Moments {
            usable: [false; 2],
            moment: [Vector2::zeros(); 2],
            variance: [f64::INFINITY; 2],
            differences: [Vector2::zeros(); 2],
            common_nm: [0.0; 2],
            rebuilt: [Vector2::zeros(); 2],
        };
        let (mut sum, mut count) = (0.0, 0.0);
        if bad != 0 {
            for i in 0..SECTIONS {
                if bad & of_section(i) == 0 {
                    sum += (shifts[i][0] + shifts[i][1] + shifts[i][2]) / 3.0;
                    count += 1.0;
                }
            }
        }
        let noise = self.noise_nm * self.noise_nm;
        for i in 0..2 {
            let mut s = shifts[i];
            let missing = (bad >> (FIBRES * i)) & 0b111;
            let mut variance = self.share[i] * noise;
            if missing != 0 {
                if missing.count_ones() > 1 || count == 0.0 {
                    continue;
                }
                let mean = sum / count;
                let lost = missing.trailing_zeros() as usize;
                let (a, b) = match lost {
                    0 => (1, 2),
                    1 => (0, 2),
                    _ => (0, 1),
                };
                let others = s[a] + s[b];
                let k = &self.gains[i];
                let Some(slot) = s.get_mut(lost) else {
                    continue;
                };
                *slot = 3.0 * mean - others;
                let column = |j: usize| Vector2::new(k[(0, j)], k[(1, j)]);
                let of = match lost {
                    0 => column(0),
                    1 => column(1),
                    _ => column(2),
                };
                let (pa, pb) = (column(a) - of, column(b) - of);
                variance = noise
                    * (pa.norm_squared()
                        + pb.norm_squared()
                        + 9.0 * of.norm_squared() / (3.0 * count))
                    / 2.0;
                made.rebuilt[i] = of * 3.0;
            }
            let mean = (s[0] + s[1] + s[2]) / 3.0;
            let d = [s[0] - mean, s[1] - mean, s[2] - mean];
            let k = &self.gains[i];
            made.usable[i] = true;
            made.moment[i] = Vector2::new(
                k.m11 * d[0] + k.m12 * d[1] + k.m13 * d[2],
                k.m21 * d[0] + k.m22 * d[1] + k.m23 * d[2],
            );
            made.variance[i] = variance;
            made.differences[i] = super::unknowns::differences(&d);
            made.common_nm[i] = mean;
        }
        made
    }

    /// How far the mean of a rebuilt grating's section may be off, nm.
    #[inline]
    pub fn unlike_nm(&self, common_nm: f64) -> f64 {
        self.warmth * common_nm.abs()
    }

    /// Gratings that repeat one number.
    pub fn stuck(&self) -> Set {
        let mut set = 0;
        for i in 0..SECTIONS {
            for k in 0..FIBRES {
                if self.repeats[i][k] >= STUCK {
                    set |= 1 << (FIBRES * i + k);
                }
            }
        }
        set
    }

    /// Forgets the slow comparison.
    pub fn forget(&mut self) {
        self.slow = [0.0; SECTIONS];
        self.slow_count = 0.0;
    }
}
