//! Nine shifts of wavelengths into what they say of the moments at sections I and II.
//!
//! Grating `k` of a section answers `s_k·M + T` to a moment and to warmth. What three of them say of `M` is a precision `J`
//! and a vector `z = J M`; a section of which one is left out says less (`J` of rank one where two are), and needs the
//! warmth from elsewhere: the means of whole sections, freed of what bends leave in them. So there is one way for whole
//! and for damaged sets: what was lost is a smaller precision.

use super::known::Trusted;
use crate::tool::sensing::{FIBRES, SECTIONS};
use nalgebra::{Matrix2, Matrix2x3, Vector2};

/// A set of gratings: bit `3 section + fibre`.
pub type Set = u16;
/// Shifts of the gratings from their rest, nm.
pub type Shifts = [[f64; FIBRES]; SECTIONS];

/// Warmth of two sections differs by this, nm.
const UNLIKE_NM: f64 = 1.5e-3;

/// The gratings of a section.
pub(super) const fn of_section(section: usize) -> Set {
    0b111 << (FIBRES * section)
}

/// The gratings of a fibre.
pub(super) const fn of_fibre(fibre: usize) -> Set {
    0b001_001_001 << fibre
}

/// What the fibres say of the moments at sections I and II.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moments {
    /// Precision, 1/(mN·mm)², and that times the moment.
    pub(super) j: [Matrix2<f64>; 2],
    pub(super) z: [Vector2<f64>; 2],
    /// Whether a section is whole, and the moment (mN·mm) where it is.
    pub(super) whole: [bool; 2],
    pub(super) m: [Vector2<f64>; 2],
    /// Means of the three sections without what bends leave in them, nm; of whole sections alone.
    pub(super) means_nm: [f64; SECTIONS],
}

impl Moments {
    /// Without moments that nothing makes, turned about the shaft by a small angle.
    #[inline]
    pub(super) fn less(mut self, offsets: [f64; 4], turn_rad: f64) -> Self {
        let [a, b, c, d] = offsets;
        let turn = Matrix2::new(1.0, -turn_rad, turn_rad, 1.0);
        for (i, o) in [Vector2::new(a, b), Vector2::new(c, d)].iter().enumerate() {
            self.z[i] = turn * (self.z[i] - self.j[i] * o);
            self.m[i] = turn * (self.m[i] - o);
            // a precision that is the same in all ways stays as it is
            if !self.whole[i] {
                self.j[i] = turn * self.j[i] * turn.transpose();
            }
        }
        self
    }
}

/// The gratings' answers, prepared for the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Gratings {
    /// Moments by shifts of a whole section, without what is common, and their precision.
    gains: [Matrix2x3<f64>; 2],
    precision: [Matrix2<f64>; 2],
    /// `s_k` of sections I and II, nm per mN·mm, and their mean.
    pub(super) answers: [[Vector2<f64>; FIBRES]; 2],
    pub(super) means: [Vector2<f64>; 2],
    warmth: [[f64; FIBRES]; 2],
    /// Variance of a wavelength, nm².
    pub(super) noise: f64,
    unlike: f64,
}

impl Gratings {
    pub(super) fn new(t: &Trusted) -> Self {
        let noise = t.calibration.noise_nm * t.calibration.noise_nm;
        let own = t.calibration.gains.map(|k| {
            let mean = k.column_sum() / 3.0;
            Matrix2x3::from_columns(&[k.column(0) - mean, k.column(1) - mean, k.column(2) - mean])
        });
        let square = own.map(|k| k * k.transpose());
        let inverse = |m: &Matrix2<f64>| m.try_inverse().unwrap_or_else(Matrix2::zeros);
        // the least shifts without a common part that make a moment of one
        let answers = [0, 1].map(|i| {
            let least = own[i].transpose() * inverse(&square[i]);
            [0, 1, 2].map(|k| least.row(k).transpose() + t.means[i])
        });
        let gains = [0, 1].map(|i| {
            let [a, b, c] = t.warmth[i];
            let warm = own[i].column(0) * a + own[i].column(1) * b + own[i].column(2) * c;
            let share = warm / 3.0;
            let k = &own[i];
            Matrix2x3::from_columns(&[
                k.column(0) - share,
                k.column(1) - share,
                k.column(2) - share,
            ])
        });
        Self {
            gains,
            precision: square.map(|s| inverse(&(s * noise))),
            answers,
            means: t.means,
            warmth: t.warmth,
            noise,
            unlike: t.doubt.unlike,
        }
    }

    /// The moment of section I or II from all its shifts, mN·mm.
    #[inline]
    pub(super) fn moment(&self, section: usize, s: &[f64; FIBRES]) -> Vector2<f64> {
        let k = &self.gains[section];
        k.column(0) * s[0] + k.column(1) * s[1] + k.column(2) * s[2]
    }

    /// How a moment's noise is in whole sections: variance of a component, on the mean of both, (mN·mm)².
    pub(super) fn variance(&self, section: usize) -> f64 {
        let precision = self.precision[section].trace() / 2.0;
        if precision > 0.0 {
            1.0 / precision
        } else {
            f64::INFINITY
        }
    }

    /// What all gratings say.
    #[inline]
    pub(super) fn of_all(&self, shifts: &Shifts) -> Moments {
        let m = [0, 1].map(|i| self.moment(i, &shifts[i]));
        let mean = |i: usize| (shifts[i][0] + shifts[i][1] + shifts[i][2]) * (1.0 / 3.0);
        Moments {
            j: self.precision,
            z: [self.precision[0] * m[0], self.precision[1] * m[1]],
            whole: [true; 2],
            m,
            means_nm: [
                mean(0) - self.means[0].dot(&m[0]),
                mean(1) - self.means[1].dot(&m[1]),
                mean(2),
            ],
        }
    }

    /// What is said without the gratings of a set; the warmth is not that of sections (bits) that are warm by themselves.
    #[inline(never)]
    pub(super) fn without(&self, shifts: &Shifts, bad: Set, warm_by_itself: u8) -> Moments {
        let mut kept = *shifts;
        for (k, x) in kept.as_flattened_mut().iter_mut().enumerate() {
            if bad & (1 << k) != 0 {
                *x = 0.0;
            }
        }
        let mut made = self.of_all(&kept);
        // the warmth of whole sections, else of what is left of III
        let (mut warm, mut count) = (0.0, 0.0);
        for i in 0..SECTIONS {
            if bad & of_section(i) == 0 && warm_by_itself & (1 << i) == 0 {
                warm += made.means_nm[i];
                count += 1.0;
            }
        }
        let left = |section: usize| (!bad >> (FIBRES * section)) & 0b111;
        if count == 0.0 {
            for k in 0..FIBRES {
                if left(2) & (1 << k) != 0 {
                    warm += kept[2][k];
                    count += 1.0;
                }
            }
        }
        let sure = count > 0.0;
        let warm = if sure { warm / count } else { 0.0 };
        let own = self.noise / (3.0 * count.max(1.0)) + self.unlike * self.unlike * warm * warm;
        let per_noise = if self.noise > 0.0 {
            1.0 / self.noise
        } else {
            1e60
        };
        for i in 0..2 {
            if left(i) == 0b111 {
                continue;
            }
            let tie = if sure {
                self.noise / (own + UNLIKE_NM * UNLIKE_NM)
            } else {
                0.0
            };
            let (mut square, mut sum) = (Matrix2::zeros(), Vector2::zeros());
            let (mut with, mut total, mut n) = (Vector2::zeros(), tie * warm, tie);
            for k in 0..FIBRES {
                if left(i) & (1 << k) != 0 {
                    let s = &self.answers[i][k];
                    let y = kept[i][k] - self.warmth[i][k] * warm;
                    square += s * s.transpose();
                    sum += s;
                    with += s * y;
                    total += y;
                    n += 1.0;
                }
            }
            if n > 0.0 {
                square -= sum * sum.transpose() / n;
                with -= sum * (total / n);
            }
            made.j[i] = square * per_noise;
            made.z[i] = with * per_noise;
            made.whole[i] = false;
            made.means_nm[i] = warm;
            made.m[i] = made.j[i]
                .try_inverse()
                .map_or_else(Vector2::zeros, |v| v * made.z[i]);
        }
        made
    }
}
