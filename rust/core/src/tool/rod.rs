//! The shaft as an exact rod: a clamped elastica that a frictionless edge pushes, and the cantilever that it is for
//! small bends.
//!
//! The edge pushes with `F` across the rod at the arc `a` from the clamp. Between them the force is the same
//! everywhere: with the angle `φ` against the contact's own direction and the arc `σ` back from the contact,
//! `EI φ'' = F cos φ`, `φ(0) = φ'(0) = 0` (Antman, *Nonlinear Problems of Elasticity*, IV.3). In `τ = σ √(F/EI)` nothing
//! is left to choose, so all rods are one curve. Its curvature is `φ' = v`, a lemniscate sine with `v'² = 1 - v⁴/4`,
//! `sin φ = v²/2`, and along the contact's direction it reaches `v`. The power series of that curve in `q = τ⁴` converge
//! for `τ < 2.6`; to `τ = 1.3` (1 rad) seven terms leave less than 1e-9. They are the table.
//!
//! The first terms are the cantilever's, and what follows says where that ends: the moment is `F σ (1 - q/40)`, the
//! bend at the contact `F a³/3EI (1 - 11 q/280)`, and the shaft gets shorter along the clamp's axis by `a q/15`, which
//! is `0.6 w²/a`. The cantilever is off by less than 0.03 mm across up to about 150 mN for the paper's shaft.

use super::beam::Beam;
use crate::numbers::math::sqrt;
use crate::numbers::rigid::Rigid;
use nalgebra::{Vector2, Vector3};

/// Beyond this `q`, an angle of 1 rad, no shaft is bent; the shape is that of the end.
const FARTHEST: f64 = 2.8561;
/// `φ'/τ`.
const CURVATURE: [f64; 7] = [
    1.0,
    -1.0 / 40.0,
    1.0 / 1920.0,
    -11.0 / 998_400.0,
    211.0 / 905_216_000.0,
    -1607.0 / 325_877_760_000.0,
    1511.0 / 14_483_456_000_000.0,
];
/// Place of the contact along the clamp's axis, over the arc.
const AXIAL: [f64; 7] = [
    1.0,
    -1.0 / 15.0,
    1.0 / 420.0,
    -127.0 / 1_801_800.0,
    261.0 / 136_136_000.0,
    -34_621.0 / 698_377_680_000.0,
    73_737.0 / 59_491_432_000_000.0,
];
/// Place of the contact across the clamp's axis, over the arc and `τ²`.
const LATERAL: [f64; 7] = [
    1.0 / 3.0,
    -11.0 / 840.0,
    307.0 / 739_200.0,
    -13_511.0 / 1_153_152_000.0,
    3.098_425_609_854_112_3e-7,
    -7.865_989_673_947_456e-9,
    1.941_472_680_249_289e-10,
];

/// `τ/φ'`, whose own series converges to `τ = 3.7`: four terms leave 2e-7.
const RELIEF: [f64; 4] = [1.0, 1.0 / 40.0, 1.0 / 9600.0, 1.0 / 1_664_000.0];

/// Four terms hold to 1e-8 up to here, a bend of 0.2 rad.
const GENTLE: f64 = 0.2;

#[inline]
fn series(terms: &[f64; 7], q: f64) -> f64 {
    let [a, b, c, d, e, f, g] = *terms;
    let rest = if q < GENTLE {
        d
    } else {
        d + q * (e + q * (f + q * g))
    };
    a + q * (b + q * (c + q * rest))
}

/// How a shaft bends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bending {
    /// As a cantilever by small angles, which gets no shorter (Eq. 9 of the tool paper).
    Small,
    /// As an elastica.
    Exact,
}

/// A shaft and how it bends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rod {
    /// Length and stiffness.
    pub beam: Beam,
    /// The model.
    pub bending: Bending,
}

/// Where a push brings contact and tip, mm, in the plane of the bend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Deflection of the contact across the unbent shaft.
    pub contact_across: f64,
    /// How much nearer to the clamp the contact stands than on the unbent shaft.
    pub contact_short: f64,
    /// Deflection of the tip across the unbent shaft.
    pub across: f64,
    /// How much nearer to the clamp the tip stands.
    pub short: f64,
}

impl Rod {
    /// Angle's measure `q = (σ² F/EI)²` by the force squared, so that no root is taken; held where no shaft would be whole, and
    /// nothing where bends are small: every series is its first term.
    #[inline]
    fn q(&self, force_squared: f64, arc: f64) -> f64 {
        let p = arc * arc * self.beam.softness;
        match self.bending {
            Bending::Small => 0.0,
            // the end for NaN
            Bending::Exact => {
                let q = force_squared * (p * p);
                if q < FARTHEST { q } else { FARTHEST }
            }
        }
    }

    /// Moment at an arc from the contact (mm) over force times arc: 1 for small bends.
    #[must_use]
    #[inline]
    pub fn moment_share(&self, force_mn: f64, arc_mm: f64) -> f64 {
        series(&CURVATURE, self.q(force_mn * force_mn, arc_mm))
    }

    /// Force times arc (mm from the contact) over the moment there: the inverse of [`Rod::moment_share`].
    #[inline]
    pub(super) fn relief(&self, force_squared: f64, arc_mm: f64) -> f64 {
        let q = self.q(force_squared, arc_mm);
        let [a, b, c, d] = RELIEF;
        a + q * (b + q * (c + q * d))
    }

    /// How much nearer to the clamp a contact stands than on the unbent shaft, mm, by the arc to it.
    #[inline]
    pub(super) fn short(&self, force_squared: f64, arc_mm: f64) -> f64 {
        arc_mm * (1.0 - series(&AXIAL, self.q(force_squared, arc_mm)))
    }

    /// How far a contact gives way across the unbent shaft, mm/mN, by the arc to it.
    #[inline]
    pub(super) fn gives(&self, force_squared: f64, arc_mm: f64) -> f64 {
        let lateral = series(&LATERAL, self.q(force_squared, arc_mm));
        self.beam.softness * arc_mm * (arc_mm * arc_mm) * lateral
    }

    /// A load of a bench as it truly is: its force across the rod (mN) and the length of shaft beyond it (mm).
    ///
    /// `force_mn` is that, or where `across` the part of it across the clamp's axis, as a load cell has it; `depth_mm` is
    /// that, or where `axial` how far the load stands from the unbent tip along the unbent axis.
    #[must_use]
    pub fn loaded(&self, force_mn: f64, depth_mm: f64, axial: bool, across: bool) -> (f64, f64) {
        let (mut force, mut depth) = (force_mn, depth_mm);
        if self.bending == Bending::Exact {
            // shape and load hardly change with what they add to each other
            for _ in 0..20 {
                let arc = self.beam.length_mm() - depth;
                if across {
                    force = force_mn / self.turn(force, arc).1;
                }
                if axial {
                    let share = series(&AXIAL, self.q(force * force, arc));
                    depth = self.beam.length_mm() - (self.beam.length_mm() - depth_mm) / share;
                }
            }
        }
        (force, depth)
    }

    /// Sine and cosine of the angle at the contact.
    fn turn(&self, force: f64, arc: f64) -> (f64, f64) {
        if self.bending == Bending::Small {
            return (0.5 * force * arc * arc * self.beam.softness, 1.0);
        }
        let q = self.q(force * force, arc);
        let curvature = series(&CURVATURE, q);
        let sine = sqrt(q) * curvature * curvature / 2.0;
        (sine, sqrt(1.0 - sine * sine))
    }

    /// Force across the rod and depth that give the moments which a cantilever would give with these, at two places
    /// (mm from the tip, the second further up).
    #[must_use]
    pub fn exactly(&self, force_mn: f64, depth_mm: f64, distances_mm: [f64; 2]) -> (f64, f64) {
        let [one, two] = distances_mm.map(|l| force_mn * (l - depth_mm));
        let (mut force, mut depth) = (force_mn, depth_mm);
        if self.bending == Bending::Exact && force_mn > 0.0 {
            for _ in 0..4 {
                let share =
                    |l: f64| self.moment_share(force, if l > depth { l - depth } else { 0.0 });
                let [a, b] = [one / share(distances_mm[0]), two / share(distances_mm[1])];
                force = (b - a) / (distances_mm[1] - distances_mm[0]);
                depth = distances_mm[1] - b / force;
            }
        }
        if force.is_finite() && depth.is_finite() {
            (force, depth)
        } else {
            (force_mn, depth_mm)
        }
    }

    /// Length from the clamp to a contact at a depth, which lies on the shaft.
    #[inline]
    pub(super) fn arc(&self, depth_mm: f64) -> f64 {
        let length = self.beam.length_mm();
        let depth = if depth_mm > 0.0 { depth_mm } else { 0.0 };
        if depth < length { length - depth } else { 0.0 }
    }

    /// Deflection of a contact across the unbent shaft, mm, at a length from the clamp: beyond the end as well, where a bench
    /// counts from a zero of its own.
    #[must_use]
    #[inline]
    pub fn aside(&self, force_mn: f64, arc_mm: f64) -> f64 {
        force_mn * self.gives(force_mn * force_mn, arc_mm)
    }

    /// Shape under a force across the rod (mN, zero or more) at a depth: the length of shaft beyond the contact (mm).
    #[must_use]
    #[inline]
    pub fn shape(&self, force_mn: f64, depth_mm: f64) -> Shape {
        self.bent(force_mn, depth_mm, depth_mm)
    }

    /// The same where a tip stands another length beyond the contact than the rod's end, by which the depth is counted.
    #[must_use]
    #[inline]
    pub fn bent(&self, force_mn: f64, depth_mm: f64, beyond_mm: f64) -> Shape {
        let beyond = if beyond_mm > 0.0 { beyond_mm } else { 0.0 };
        let arc = self.arc(depth_mm);
        let (sine, cosine) = self.turn(force_mn, arc);
        let contact_across = self.aside(force_mn, arc);
        let contact_short = self.short(force_mn * force_mn, arc);
        Shape {
            contact_across,
            contact_short,
            across: contact_across + beyond * sine,
            short: contact_short + beyond * (1.0 - cosine),
        }
    }

    /// The tip in the base frame, mm, where `tool` takes tool coordinates there.
    #[must_use]
    pub fn tip(&self, force_mn: &Vector2<f64>, depth_mm: f64, tool: &Rigid) -> Vector3<f64> {
        let size = force_mn.norm();
        let shape = self.shape(size, depth_mm);
        let per_force = if size > 0.0 { shape.across / size } else { 0.0 };
        let bent = force_mn * per_force;
        tool.apply(&Vector3::new(bent.x, bent.y, -shape.short))
    }
}
