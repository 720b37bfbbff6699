//! Nine shifts of wavelengths into what they say of the moments at sections I, II and III.
//!
//! Grating `k` of a section answers `s_k·M + T` to a moment and to warmth. What three of them say of `M` is a precision `J`
//! and a vector `z = J M`; a section of which one is left out says less, and needs the warmth from elsewhere: the means of
//! whole sections, freed of what bends leave in them. So what was lost is a smaller precision.

use crate::tool::sensing::{FIBRES, SECTIONS};
use crate::tool::status::Set;
use crate::tool::trusted::Trusted;
use nalgebra::{Matrix2, Matrix2x3, Vector2};

/// Shifts of the gratings from their rest, nm.
pub type Shifts = [[f64; FIBRES]; SECTIONS];

/// Warmth of two sections differs by this, nm.
const UNLIKE_NM: f64 = 1.5e-3;

/// What is left out: gratings, and sections whose warmth is their own, as bits behind those.
pub(super) const GRATINGS: usize = FIBRES * SECTIONS;

/// The gratings of a set that are of a section, as three bits.
pub(super) const fn of_section(set: Set, section: usize) -> Set {
    (set >> (FIBRES * section)) & 0b111
}

/// Whether all of a section is believed, and warm as the others are.
pub(super) const fn tells(out: Set, section: usize) -> bool {
    of_section(out, section) == 0 && out >> (GRATINGS + section) & 1 == 0
}

/// What the fibres say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moments {
    /// Of I and II: precision, 1/(mN·mm)², that times the moment; whether all three tell, and the moment (mN·mm) then.
    pub(super) j: [Matrix2<f64>; 2],
    pub(super) z: [Vector2<f64>; 2],
    pub(super) whole: [bool; 2],
    pub(super) m: [Vector2<f64>; 2],
    /// Means of the three sections without what bends leave in them, nm.
    pub(super) means_nm: [f64; SECTIONS],
}

/// The gratings' answers, prepared for the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Gratings {
    /// Moments by shifts of a whole section, and `s_k`, nm per mN·mm, with their mean.
    gains: [Matrix2x3<f64>; 2],
    pub(super) answers: [[Vector2<f64>; FIBRES]; 2],
    means: [Vector2<f64>; 2],
    /// Variance of a wavelength, nm², and of a component of a moment by a squared nanometre of each grating.
    pub(super) noise: f64,
    pub(super) per_nm: [f64; 2],
}

impl Gratings {
    pub(super) fn new(t: &Trusted) -> Self {
        let own = t.calibration.gains.map(|k| {
            let mean = k.column_sum() / 3.0;
            Matrix2x3::from_fn(|i, j| k[(i, j)] - mean[i])
        });
        Self {
            gains: [0, 1].map(|i| {
                let share = own[i] * nalgebra::Vector3::from(t.warmth[i]) / 3.0;
                Matrix2x3::from_fn(|r, j| own[i][(r, j)] - share[r])
            }),
            // the least shifts without a common part that make a moment of one
            answers: [0, 1].map(|i| {
                let square = own[i] * own[i].transpose();
                let least = own[i].transpose() * square.try_inverse().unwrap_or_default();
                [0, 1, 2].map(|k| least.row(k).transpose() + t.means[i])
            }),
            means: t.means,
            noise: (t.calibration.noise_nm * t.calibration.noise_nm).max(1e-30),
            per_nm: own.map(|k| 0.5 * k.norm_squared()),
        }
    }

    /// The moment of section III, which nothing calibrates: its fibres are those of the others.
    pub(super) fn of_third(&self, s: &[f64; FIBRES]) -> Vector2<f64> {
        let k = (self.gains[0] + self.gains[1]) * 0.5;
        k.column(0) * s[0] + k.column(1) * s[1] + k.column(2) * s[2]
    }

    /// How much sections I and II are bent, as a fibre's shift squared, nm².
    #[inline]
    pub(super) fn bends(&self, m: &Moments) -> [f64; 2] {
        [0, 1].map(|i| m.m[i].norm_squared() / self.per_nm[i])
    }

    /// What all gratings say but those left out, less moments that nothing makes, turned about the shaft by a small angle.
    #[inline]
    pub(super) fn read(&self, shifts: &Shifts, out: Set, less: &[f64], turn: f64) -> Moments {
        let mut made = Moments {
            j: self.per_nm.map(|v| Matrix2::identity() / (v * self.noise)),
            z: [Vector2::zeros(); 2],
            whole: [true; 2],
            m: [Vector2::zeros(); 2],
            means_nm: shifts.map(|s| (s[0] + s[1] + s[2]) * (1.0 / 3.0)),
        };
        for i in 0..2 {
            let (k, s) = (&self.gains[i], &shifts[i]);
            made.m[i] = k.column(0) * s[0] + k.column(1) * s[1] + k.column(2) * s[2];
            made.means_nm[i] -= self.means[i].dot(&made.m[i]);
        }
        if out.trailing_zeros() < 6 {
            self.without(&mut made, shifts, out);
        }
        let r = Matrix2::new(1.0, -turn, turn, 1.0);
        for i in 0..2 {
            let o = Vector2::new(less[2 * i], less[2 * i + 1]);
            if made.whole[i] {
                made.m[i] = r * (made.m[i] - o);
                made.z[i] = made.j[i] * made.m[i];
            } else {
                // a precision that is not the same in all ways is turned as well
                made.m[i] = r * (made.m[i] - o);
                made.z[i] = r * (made.z[i] - made.j[i] * o);
                made.j[i] = r * made.j[i] * r.transpose();
            }
        }
        made
    }

    /// Sections that lost a grating, by what is left of them and the warmth of whole sections, else of what is left of III.
    #[inline(never)]
    fn without(&self, made: &mut Moments, shifts: &Shifts, out: Set) {
        let (mut warmth, mut count) = (0.0, 0.0_f64);
        for i in (0..SECTIONS).filter(|i| tells(out, *i)) {
            (warmth, count) = (warmth + made.means_nm[i], count + 1.0);
        }
        if count == 0.0 {
            for k in (0..FIBRES).filter(|k| of_section(out, 2) & (1 << k) == 0) {
                (warmth, count) = (warmth + shifts[2][k], count + 1.0);
            }
        }
        let some = count.max(1.0);
        warmth /= some;
        let tie = count / some * self.noise / (self.noise / (3.0 * some) + UNLIKE_NM * UNLIKE_NM);
        for i in (0..2).filter(|i| of_section(out, *i) != 0) {
            let (mut square, mut sum) = (Matrix2::zeros(), Vector2::zeros());
            let (mut with, mut total, mut n) = (Vector2::zeros(), tie * warmth, tie);
            for k in (0..FIBRES).filter(|k| of_section(out, i) & (1 << k) == 0) {
                let (s, y) = (&self.answers[i][k], shifts[i][k]);
                square += s * s.transpose();
                (sum, with) = (sum + s, with + s * y);
                (total, n) = (total + y, n + 1.0);
            }
            let per = 1.0 / n.max(f64::MIN_POSITIVE);
            made.j[i] = (square - sum * sum.transpose() * per) / self.noise;
            made.z[i] = (with - sum * (total * per)) / self.noise;
            (made.whole[i], made.means_nm[i]) = (false, warmth);
            made.m[i] = made.j[i].try_inverse().unwrap_or_default() * made.z[i];
        }
    }
}
