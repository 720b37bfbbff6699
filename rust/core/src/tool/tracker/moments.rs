//! Nine shifts of wavelengths into the moments at sections I and II, with or without gratings that lie.
//!
//! A moment is the gain times two differences of three fibres: what is common to them is warmth. Both sections are
//! worked on side by side.
//!
//! A single grating that lies is rebuilt: the mean of its section is that of the others, so it is thrice that mean less
//! its two neighbours. Where two lie, the section is lost.

use super::interrogator::{Set, Shifts, of_section};
use super::unknowns::{LENGTHS, differences};
use crate::tool::sensing::{Calibration, FIBRES, SECTIONS};
use nalgebra::{Matrix2x3, Vector2, Vector3};

/// A number of section I and one of section II.
pub type Pair = [f64; 2];

/// How the fibres of sections I and II are shifted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bends {
    /// Two differences, nm, see [`differences`].
    pub differences: [Pair; 2],
    /// Mean, nm.
    pub common_nm: Pair,
    /// Moment per nm of the mean that a rebuilt grating took from elsewhere; zero where none is rebuilt.
    pub rebuilt: [Vector2<f64>; 2],
    /// Whether one is.
    pub any_rebuilt: bool,
}

/// What the fibres say of the moments at sections I and II; nothing where a precision is zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moments {
    /// mN·mm.
    pub x: Pair,
    /// mN·mm.
    pub y: Pair,
    /// Variance of each component, (mN·mm)², and its inverse.
    pub variance: Pair,
    /// 1/(mN·mm)².
    pub precision: Pair,
    /// What they were made of.
    pub bends: Bends,
}

impl Moments {
    /// Whether no section says anything.
    pub fn none(&self) -> bool {
        self.precision == [0.0; 2]
    }
}

/// The gains, prepared for the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// By fibre, without common mode.
    fibres: [Matrix2x3<f64>; 2],
    /// Moment's component by difference.
    pub(super) by: [[Pair; 2]; 2],
    /// Differences by mean, of warmth alone.
    warmth: [Pair; 2],
    /// Variance of a wavelength, of a moment's component, and the latter's inverse.
    noise: f64,
    variance: Pair,
    precision: Pair,
}

fn inverse(variance: f64) -> f64 {
    1.0 / if variance > 1e-60 { variance } else { 1e-60 }
}

impl Gains {
    /// Of a calibration, and of how much more than its section's mean each fibre answers to warmth.
    pub fn new(c: &Calibration, warmth: &[[f64; FIBRES]; 2]) -> Self {
        let fibres = c.gains.map(|k| {
            let mean = k.column_sum() / 3.0;
            Matrix2x3::from_columns(&[k.column(0) - mean, k.column(1) - mean, k.column(2) - mean])
        });
        let [one, two] = fibres.map(|k| k * differences().transpose());
        let [w, v] = warmth.map(|more| differences() * Vector3::from(more));
        let noise = c.noise_nm * c.noise_nm;
        let variance = fibres.map(|k| k.norm_squared() / 2.0 * noise);
        Self {
            fibres,
            by: [
                [[one.m11, two.m11], [one.m12, two.m12]],
                [[one.m21, two.m21], [one.m22, two.m22]],
            ],
            warmth: [[w.x, v.x], [w.y, v.y]],
            noise,
            variance,
            precision: variance.map(inverse),
        }
    }

    /// The moments of all fibres.
    #[inline]
    pub fn moments(&self, shifts: &Shifts) -> Moments {
        let (a, b) = LENGTHS;
        let mut made = Moments {
            x: [0.0; 2],
            y: [0.0; 2],
            variance: self.variance,
            precision: self.precision,
            bends: Bends::default(),
        };
        let [[xd, xe], [yd, ye]] = &self.by;
        for i in 0..2 {
            let [p, q, r] = shifts[i];
            let others = q + r;
            let common = (p + others) * (1.0 / 3.0);
            let d = a * (2.0 * p - others) - self.warmth[0][i] * common;
            let e = b * (q - r) - self.warmth[1][i] * common;
            made.bends.differences[0][i] = d;
            made.bends.differences[1][i] = e;
            made.bends.common_nm[i] = common;
            made.x[i] = xd[i] * d + xe[i] * e;
            made.y[i] = yd[i] * d + ye[i] * e;
        }
        made
    }

    /// The moments without the bad gratings.
    #[inline(never)]
    pub fn moments_without(&self, shifts: &Shifts, bad: Set) -> Moments {
        let (mut sum, mut count) = (0.0, 0.0);
        for i in 0..SECTIONS {
            if bad & of_section(i) == 0 {
                sum += (shifts[i][0] + shifts[i][1] + shifts[i][2]) / 3.0;
                count += 1.0;
            }
        }
        let mut whole = *shifts;
        let (mut variance, mut precision) = (self.variance, self.precision);
        let mut rebuilt = [Vector2::zeros(); 2];
        for i in 0..2 {
            let missing = (bad >> (FIBRES * i)) & 0b111;
            if missing == 0 {
                continue;
            }
            if missing.count_ones() > 1 || count == 0.0 {
                variance[i] = f64::INFINITY;
                precision[i] = 0.0;
                whole[i] = [0.0; FIBRES];
                continue;
            }
            let [p, q, r] = whole[i];
            let k = &self.fibres[i];
            let [of_p, of_q, of_r] = [0, 1, 2].map(|j| Vector2::new(k[(0, j)], k[(1, j)]));
            let thrice = 3.0 * sum / count;
            let (of, others) = match missing {
                0b001 => {
                    whole[i][0] = thrice - (q + r);
                    (of_p, [of_q, of_r])
                }
                0b010 => {
                    whole[i][1] = thrice - (p + r);
                    (of_q, [of_p, of_r])
                }
                _ => {
                    whole[i][2] = thrice - (p + q);
                    (of_r, [of_p, of_q])
                }
            };
            let [a, b] = others.map(|column| (column - of).norm_squared());
            variance[i] = self.noise * (a + b + 3.0 * of.norm_squared() / count) / 2.0;
            precision[i] = inverse(variance[i]);
            rebuilt[i] = of * 3.0;
        }
        let mut made = self.moments(&whole);
        made.variance = variance;
        made.precision = precision;
        made.bends.rebuilt = rebuilt;
        made.bends.any_rebuilt = true;
        made
    }
}
