//! Where the cones of two limbs meet, and which elbow azimuths hold a tool axis: the formulas without branches, for one
//! pose or many side by side.
//!
//! Half sum `s` and half difference `d` of the elbow axes are at right angles, so with `k_s`, `k_d` the half sum and
//! difference of the cosines `x = s k_s/|s|² + d k_d/|d|² ± √(1 - k_s²/|s|² - k_d²/|d|²) (d × s)/(|d||s|)`. The sign is
//! the assembly's times that of `sin A`, `A = (ψ₁ - ψ₂)/2`: with equal limbs this is the sign of Eq. 35.

use super::geometry::LIMBS;
use crate::numbers::math::{Real, add, cross, dot, scale};
use crate::numbers::trig;

/// Where the cones meet, in the frame turned to the mean azimuth of the elbows; one pose or many side by side.
#[derive(Clone, Copy)]
pub(super) struct Meeting<T> {
    pub axis: [T; 3],
    /// φ, γ.
    pub angles: [T; 2],
    /// Squared part of the axis out of the plane of the elbows; negative where the cones do not meet.
    pub height_squared: T,
    /// Squared sine of half the angle between the elbows, or of what it lacks to half a turn.
    pub spread_squared: T,
    /// Squared sine of the tool axis' angle from the actuated one.
    pub polar_squared: T,
}

/// The cones of both limbs: sines and cosines are taken once.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cones {
    /// Sign of the assembly.
    pub sign: f64,
    pub sin_alpha: [f64; LIMBS],
    pub cos_alpha: [f64; LIMBS],
    pub cos_beta: [f64; LIMBS],
    pub offset: [f64; LIMBS],
}

impl Cones {
    /// Half sum and half difference of the elbow axes, for the sine and cosine of `A`.
    #[inline(always)]
    pub fn halves<T: Real>(&self, (sin, cos): (T, T)) -> [[T; 3]; 2] {
        let of = T::splat;
        let ([s1, s2], [c1, c2]) = (self.sin_alpha, self.cos_alpha);
        let (sum, difference) = (of(0.5 * (s1 + s2)), of(0.5 * (s1 - s2)));
        [
            [sum * cos, difference * sin, of(0.5 * (c1 + c2))],
            [difference * cos, sum * sin, of(0.5 * (c1 - c2))],
        ]
    }

    /// The formula of the module, without branches. `half` has the sine and cosine of `A`.
    #[inline(always)]
    pub fn meet<T: Real>(&self, mean: T, half: (T, T)) -> Meeting<T> {
        let of = T::splat;
        let [s, d] = self.halves(half);
        let (ss, dd) = (dot(s, s), dot(d, d));
        let [b1, b2] = self.cos_beta;
        let (sum, difference) = (of(0.5 * (b1 + b2)), of(0.5 * (b1 - b2)));
        let (along, across) = (sum / ss, difference / dd);
        let height_squared = (of(1.0) - sum * along) - difference * across;
        let side = of(self.sign) * of(1.0).signed(half.0);
        let rise = (height_squared / (ss * dd)).root() * side;
        let axis = add(
            add(scale(s, along), scale(d, across)),
            scale(cross(d, s), rise),
        );
        let polar_squared = axis[0] * axis[0] + axis[1] * axis[1];
        let side = of(1.0).signed(axis[0]);
        Meeting {
            axis,
            angles: [
                mean + trig::atan2(side * axis[1], axis[0].size()),
                side * trig::atan2(polar_squared.root(), axis[2]),
            ],
            height_squared,
            spread_squared: dd.above(ss, ss, dd),
            polar_squared,
        }
    }

    /// Joint angles, cosines of `ψ_i - φ`, and a number with the sign of the assembly, for φ and the sine and cosine
    /// of γ. No branches.
    #[inline(always)]
    pub fn reach<T: Real>(
        &self,
        phi: T,
        (sin, cos): (T, T),
        signs: [f64; LIMBS],
    ) -> ([T; LIMBS], [T; LIMBS], T) {
        let of = T::splat;
        let nothing = [of(0.0); LIMBS];
        let (mut joints, mut turns) = (nothing, nothing);
        let (mut cosines, mut sines) = (nothing, nothing);
        for i in 0..LIMBS {
            let part = of(self.cos_beta[i]) - of(self.cos_alpha[i]) * cos;
            cosines[i] = part / (of(self.sin_alpha[i]) * sin);
            let sine = ((of(1.0) - cosines[i]) * (of(1.0) + cosines[i])).root();
            turns[i] = of(signs[i]) * trig::atan2(sine, cosines[i]);
            sines[i] = of(signs[i]) * sine;
            joints[i] = phi + turns[i] - of(self.offset[i]);
        }
        // x·(e₁ × e₂) in the frame turned to φ; its sign times that of sin A is the assembly's
        let ([s1, s2], [c1, c2]) = (self.sin_alpha, self.cos_alpha);
        let triple = sin * (of(s1 * c2) * sines[0] - of(c1 * s2) * sines[1])
            - cos * of(s1 * s2) * (sines[0] * cosines[1] - cosines[0] * sines[1]);
        (joints, cosines, triple * (turns[0] - turns[1]))
    }
}
