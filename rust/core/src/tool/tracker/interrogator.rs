//! Which gratings to believe.
//!
//! What there is to compare. Bending stretches one side of the shaft and shortens the other: the mean of three fibres
//! does not feel it, and the sections stand in one eye, so their means must agree; section III is the witness. What two
//! moments say across the force must be nothing. A reading never repeats to the last digit while its neighbours go on.
//! And no grating is pulled by more than a few nm.

use super::unknowns::Doubt;
use crate::numbers::math::sqrt;
use crate::tool::sensing::{Calibration, FIBRES, SECTIONS};

/// No shaft is bent or warmed so far, nm.
const FARTHEST_NM: f64 = 8.0;
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
/// Shifts of the gratings from their rest, nm.
pub type Shifts = [[f64; FIBRES]; SECTIONS];

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

    /// Wavelengths with the two peaks back in their places.
    pub fn put_back(self, w: &Shifts) -> Shifts {
        let mut out = *w;
        if let Some(s) = out.get_mut(self.section) {
            let [a, b, c] = *s;
            *s = match self.stays {
                0 => [a, c, b],
                1 => [c, b, a],
                _ => [b, a, c],
            };
        }
        out
    }
}

/// The gratings of a section.
pub(super) fn of_section(section: usize) -> Set {
    0b111 << (FIBRES * section)
}

/// Comparisons of the sections' means.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Agreement {
    /// The section that stands farthest off, where one fails.
    pub odd: Option<usize>,
    /// Whether it failed slowly: by its mean over many readings.
    pub slowly: bool,
}

/// The interrogator, watched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interrogator {
    reference_nm: Shifts,
    /// Variances, nm²: noise of a wavelength, doubt of a reference; and of the answer to warmth, relative.
    noise: f64,
    reference: f64,
    warmth: f64,
    last: Shifts,
    /// How often in a row each grating repeated one number, up to 12: four planes of bits.
    repeats: [Set; 4],
    /// Slow means: of each section's mean less the others', and of what that is allowed; over so many readings.
    slow: [f64; SECTIONS],
    slow_size: f64,
    slow_count: f64,
}

impl Interrogator {
    /// Of a calibration and what it does not know.
    pub fn new(c: &Calibration, doubt: &Doubt) -> Self {
        Self {
            reference_nm: c.reference_nm,
            noise: c.noise_nm * c.noise_nm,
            reference: doubt.reference_nm * doubt.reference_nm,
            warmth: doubt.unlike * doubt.unlike,
            last: [[f64::NAN; FIBRES]; SECTIONS],
            repeats: [0; 4],
            slow: [0.0; SECTIONS],
            slow_size: 0.0,
            slow_count: 0.0,
        }
    }

    /// Anew: nothing was read yet.
    pub fn anew(&self) -> Self {
        Self {
            last: [[f64::NAN; FIBRES]; SECTIONS],
            repeats: [0; 4],
            slow: [0.0; SECTIONS],
            slow_size: 0.0,
            slow_count: 0.0,
            ..*self
        }
    }

    /// Shifts with two peaks back in their places.
    pub fn shifts_back(&self, swap: Swap, shifts: &Shifts) -> Shifts {
        let mut w = *shifts;
        for i in 0..SECTIONS {
            for k in 0..FIBRES {
                w[i][k] += self.reference_nm[i][k];
            }
        }
        let mut out = swap.put_back(&w);
        for i in 0..SECTIONS {
            for k in 0..FIBRES {
                out[i][k] -= self.reference_nm[i][k];
            }
        }
        out
    }

    /// Shifts from the reference, nm, and the gratings that say nothing: not finite, out of all bounds, or stuck.
    #[inline]
    pub fn look(&mut self, w: &Shifts) -> (Shifts, Set) {
        let mut shifts = [[0.0; FIBRES]; SECTIONS];
        let (mut usual, mut repeated) = (true, false);
        for i in 0..SECTIONS {
            for k in 0..FIBRES {
                let shift = w[i][k] - self.reference_nm[i][k];
                shifts[i][k] = shift;
                // false for NaN
                usual &= shift.abs() < FARTHEST_NM;
                repeated |= w[i][k] == self.last[i][k];
            }
        }
        let silent = if usual && !repeated {
            self.repeats = [0; 4];
            0
        } else {
            self.silent(w, &mut shifts)
        };
        self.last = *w;
        (shifts, silent)
    }

    #[inline(never)]
    fn silent(&mut self, w: &Shifts, shifts: &mut Shifts) -> Set {
        let (mut silent, mut same): (Set, Set) = (0, 0);
        for i in 0..SECTIONS {
            for k in 0..FIBRES {
                let bit = 1 << (FIBRES * i + k);
                if w[i][k] == self.last[i][k] {
                    same |= bit;
                }
                let usual = shifts[i][k].abs() < FARTHEST_NM;
                if !usual {
                    silent |= bit;
                    shifts[i][k] = 0.0;
                }
            }
        }
        // one more where it is the same again and has not come to the end, zero where it is not
        let mut carry = same & !self.stuck();
        for plane in &mut self.repeats {
            let sum = *plane ^ carry;
            carry &= *plane;
            *plane = sum & same;
        }
        // one that has begun to repeat itself is not asked, long before it is held to be stuck
        let [_, twice, four, eight] = self.repeats;
        let still = twice | four | eight;
        // where all stand still it is the world, or a source that gives each reading several times
        if still.count_ones() <= 3 {
            silent |= still;
        }
        silent
    }

    /// Gratings whose repeats are not counted further.
    fn stuck(&self) -> Set {
        self.repeats[3] & self.repeats[2]
    }

    /// Whether the sections' means agree, and how they did over the last readings: `silent` gratings say nothing, and while
    /// others are held to be bad the mean over readings would say so of their neighbours, too.
    #[inline]
    pub fn agree(&mut self, shifts: &Shifts, silent: Set, bad: Set) -> Agreement {
        if bad != 0 {
            self.forget();
        }
        if silent != 0 {
            // two means that differ do not say which is wrong
            self.forget();
            return Agreement::default();
        }
        let mut means = [0.0; SECTIONS];
        let (mut bend, mut warm) = (0.0_f64, 0.0_f64);
        for i in 0..SECTIONS {
            let s = &shifts[i];
            means[i] = (s[0] + s[1] + s[2]) * (1.0 / 3.0);
            warm = larger(warm, means[i].abs());
            for x in s {
                bend = larger(bend, (x - means[i]).abs());
            }
        }
        let unlike = self.reference + self.warmth * warm * warm;
        let allowed = COUPLING * bend;
        let half = 0.5 * (means[0] + means[1] + means[2]);
        // of a section's mean less that of the two others
        let limit = DEVIATIONS * sqrt(0.5 * (self.noise + unlike)) + allowed;
        if self.slow_count < SLOW {
            self.slow_count += 1.0;
        }
        let weight = 1.0 / self.slow_count;
        self.slow_size += (sqrt(unlike) * (DEVIATIONS * 0.8) + allowed - self.slow_size) * weight;
        let slow_limit = DEVIATIONS * sqrt(0.5 * self.noise * weight) + self.slow_size;
        let (mut off, mut good) = ([0.0; SECTIONS], true);
        for i in 0..SECTIONS {
            off[i] = 1.5 * means[i] - half;
            good &= off[i].abs() <= limit;
            if bad != 0 {
                continue;
            }
            // a single wild reading is no drift
            let held = if off[i] > limit { limit } else { off[i] };
            let held = if held < -limit { -limit } else { held };
            self.slow[i] += (held - self.slow[i]) * weight;
            good &= self.slow[i].abs() <= slow_limit;
        }
        if good {
            return Agreement::default();
        }
        let slowly = off.iter().all(|x| x.abs() <= limit);
        let farthest = if slowly { &self.slow } else { &off };
        let (mut odd, mut worst) = (0, 0.0);
        for i in 0..SECTIONS {
            if farthest[i].abs() > worst {
                worst = farthest[i].abs();
                odd = i;
            }
        }
        Agreement {
            odd: Some(odd),
            slowly,
        }
    }

    /// Forgets the slow comparison.
    pub fn forget(&mut self) {
        self.slow = [0.0; SECTIONS];
        self.slow_count = 0.0;
    }
}

#[inline]
fn larger(a: f64, b: f64) -> f64 {
    if b > a { b } else { a }
}
