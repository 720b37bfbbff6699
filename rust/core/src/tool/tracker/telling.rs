//! Depth and tip now, and how well they are known together.

use super::ToolFilter;
use super::state::State;
use super::stray::Stray;
use super::unknowns::{Tied, UNKNOWNS};
use crate::numbers::rigid::Rigid;
use crate::tool::rod::{Bending, Shape};
use nalgebra::{Vector2, Vector3};

/// Where depth and tip are.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Told {
    /// s.
    pub time_s: f64,
    /// Length of shaft inside the eye, mm.
    pub depth_mm: f64,
    /// The tip in the base frame, mm.
    pub tip_mm: [f64; 3],
    /// Covariance of depth and tip, mm².
    pub covariance: [[f64; 4]; 4],
    /// Force of the hole across the shaft, tool frame, mN.
    pub force_mn: [f64; 2],
    /// Variance of each of its components, mN².
    pub force_variance: f64,
}

/// Variances and covariances of `l` and of the force along and across itself.
struct Spread {
    depth: f64,
    along: f64,
    across: f64,
    depth_along: f64,
    depth_across: f64,
    along_across: f64,
}

impl ToolFilter {
    /// Depth and tip now, with what they know of each other.
    #[must_use]
    pub fn told(&self) -> Told {
        let now = self.poses.now();
        if self.state.time_s == now.time_s && self.state.read() {
            self.told_of(&self.state, &Stray::default())
        } else {
            let s = self.carried(&self.state, now.time_s, &now.pose);
            self.told_of(&s, &self.stray(&s))
        }
    }

    /// `stray`: of the force since it was read.
    #[inline]
    fn told_of(&self, s: &State, stray: &Stray) -> Told {
        let depth = s.depth(&self.shaft);
        let shape = self.rod.shape(s.size, depth);
        let spread = self.spread(s);
        let beside = self.beside_the_force(s, &spread, stray, depth, &shape);
        let by_depth = s.felt.by_depth * s.felt.share;
        let bent = s.way * shape.across;
        let tip = s.pose.apply(&Vector3::new(bent.x, bent.y, -shape.short));
        Told {
            time_s: s.time_s,
            // a tip that has left the eye has no length of shaft in it
            depth_mm: if depth > 0.0 { depth } else { 0.0 },
            tip_mm: tip.into(),
            covariance: in_base(&beside, &s.way, &s.pose),
            force_mn: s.force().into(),
            force_variance: spread.along
                + stray.mean()
                + by_depth * (2.0 * spread.depth_along + by_depth * spread.depth),
        }
    }

    fn spread(&self, s: &State) -> Spread {
        let felt = &s.felt;
        let weights = felt.weights.map(|w| w * felt.share);
        let of = |way| {
            self.unknowns
                .of_moments(&self.gains.by, &felt.bends, &way, &weights)
        };
        let (along, across) = (of(felt.way), of(Vector2::new(-felt.way.y, felt.way.x)));
        Spread {
            depth: s.variance + dot(&s.tied, &s.tied),
            along: felt.noise + dot(&along, &along),
            across: felt.noise + dot(&across, &across),
            depth_along: dot(&s.tied, &along),
            depth_across: dot(&s.tied, &across),
            along_across: dot(&along, &across),
        }
    }

    /// Lower triangle of the covariance of the depth and of the tip's places along and across the force and along the
    /// shaft, mm².
    #[inline]
    fn beside_the_force(
        &self,
        s: &State,
        spread: &Spread,
        stray: &Stray,
        depth: f64,
        shape: &Shape,
    ) -> [[f64; 4]; 4] {
        let size = s.size;
        let bend = self.rod.beam.compliance(depth);
        let per_stiffness = 1.0 / self.rod.beam.stiffness();
        let arc = (self.rod.beam.length_mm() - depth).max(0.0);
        // what the bend takes goes with the force squared, `a⁵/15 + d a⁴/8` over EI² for a tip
        let third = match self.rod.bending {
            Bending::Exact => arc * arc * arc * (per_stiffness * per_stiffness),
            Bending::Small => 0.0,
        };
        let twice = if size > 0.0 { 2.0 / size } else { 0.0 };
        let (shorter, contact) = (twice * shape.short, -twice * shape.contact_short);
        let shorter_by_depth = -size * size * third * (5.0 * arc * (1.0 / 24.0) + 0.5 * depth);
        let by_depth = s.felt.by_depth * s.felt.share;
        // shares of depth and of the force along itself in the tip along, and in the tip up the shaft
        let f = bend.value;
        let d = f * by_depth + size * bend.by_depth;
        let (up, up_d) = (-shorter, -(shorter * by_depth + shorter_by_depth));
        let Spread {
            depth: ll,
            along: aa,
            across: cc,
            depth_along: la,
            depth_across: lc,
            along_across: ac,
        } = *spread;
        // of depth and force along with the tip along, up
        let (l_along, l_up) = (d * ll + f * la, up_d * ll + up * la);
        let (a_along, a_up) = (d * la + f * aa, up_d * la + up * aa);
        // where the force is not known, neither is its square
        let squared = 8.0 * stray.along * stray.along;
        let (at_hole, at_tip) = (
            third * arc * arc * (1.0 / 15.0),
            third * arc * (arc * (1.0 / 15.0) + depth * 0.125),
        );
        let mut along = d * l_along + f * a_along + f * f * stray.along;
        let mut along_up = d * l_up + f * a_up + f * up * stray.along;
        let mut upward =
            up_d * l_up + up * a_up + up * up * stray.along + at_tip * at_tip * squared;
        let factor = &self.unknowns.beam;
        for k in 0..2 {
            let (length, stiffer) = (factor[(0, k)], factor[(1, k)]);
            let moved = size * (bend.by_length * length + bend.by_stiffness * stiffer);
            let raised = 2.0 * shape.short * per_stiffness * stiffer;
            along += moved * moved;
            along_up += moved * raised;
            upward += raised * raised;
        }
        [
            [
                ll + contact * contact * stray.along + at_hole * at_hole * squared,
                0.0,
                0.0,
                0.0,
            ],
            [l_along + contact * f * stray.along, along, 0.0, 0.0],
            [
                f * lc + contact * f * stray.both,
                f * (d * lc + f * ac) + f * f * stray.both,
                f * f * (cc + stray.across),
                0.0,
            ],
            [
                l_up + contact * up * stray.along + at_hole * at_tip * squared,
                along_up,
                f * (up_d * lc + up * ac) + f * up * stray.both,
                upward,
            ],
        ]
    }

    /// Variance of the depth by noise alone, and how its error hangs on the unknowns: for a smoother.
    #[must_use]
    pub fn told_tied(&self) -> (f64, Tied) {
        let now = self.poses.now();
        let s = self.carried(&self.state, now.time_s, &now.pose);
        (s.variance, s.tied)
    }
}

#[inline]
fn dot(a: &Tied, b: &Tied) -> f64 {
    let mut sum = [0.0; 2];
    for k in 0..UNKNOWNS / 2 {
        sum[0] += a[2 * k] * b[2 * k];
        sum[1] += a[2 * k + 1] * b[2 * k + 1];
    }
    sum[0] + sum[1]
}

/// A lower triangle, depth and the tip along and across a way and along the shaft, in the base frame.
#[inline]
fn in_base(lower: &[[f64; 4]; 4], way: &Vector2<f64>, pose: &Rigid) -> [[f64; 4]; 4] {
    let [[depth, ..], [p, a, ..], [q, b, c, _], [r, d, e, f]] = *lower;
    let axes = &pose.rotation;
    let (mut to, mut turned) = ([[0.0; 3]; 3], [[0.0; 3]; 3]);
    let mut out = [[0.0; 4]; 4];
    out[0][0] = depth;
    for i in 0..3 {
        let (x, y, z) = (axes[(i, 0)], axes[(i, 1)], axes[(i, 2)]);
        let row = [x * way.x + y * way.y, y * way.x - x * way.y, z];
        let [u, v, w] = row;
        to[i] = row;
        turned[i] = [
            u * a + v * b + w * d,
            u * b + v * c + w * e,
            u * d + v * e + w * f,
        ];
        out[i + 1][0] = u * p + v * q + w * r;
        out[0][i + 1] = out[i + 1][0];
    }
    for i in 0..3 {
        for j in 0..=i {
            let [u, v, w] = to[j];
            let with = turned[i][0] * u + turned[i][1] * v + turned[i][2] * w;
            out[i + 1][j + 1] = with;
            out[j + 1][i + 1] = with;
        }
        out[i + 1][i + 1] = out[i + 1][i + 1].max(0.0);
    }
    out
}
