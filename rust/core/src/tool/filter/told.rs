//! Depth and tip now, and how well they are known together.

use super::start::ToolFilter;
use super::state::{DEEPER, L, OFFSETS, State, TURN};
use crate::numbers::math::sqrt;
use crate::numbers::rigid::Rigid;
use crate::tool::rod::{Bending, Shape};
use nalgebra::{Vector2, Vector3};

/// Where depth and tip are.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Told {
    /// s.
    pub time_s: f64,
    /// Insertion depth, the paper's `l`: from the hole to the unbent tip, along the unbent axis, mm.
    pub depth_mm: f64,
    /// Length of shaft beyond the hole, mm: shorter than the depth by what the bend takes.
    pub arc_mm: f64,
    /// The tip in the base frame, mm.
    pub tip_mm: [f64; 3],
    /// Covariance of depth and tip, mm².
    pub covariance: [[f64; 4]; 4],
    /// Force of the hole across the shaft, tool frame, mN.
    pub force_mn: [f64; 2],
    /// Variance of each of its components, mN².
    pub force_variance: f64,
}

/// Covariance of `l` and of the force along and across itself.
struct Spread {
    depth: f64,
    along: f64,
    across: f64,
    depth_along: f64,
    depth_across: f64,
}

impl ToolFilter {
    /// The state at the present, carried there where the last reading is older, and the variance of a component of its
    /// force that was not read.
    fn now(&self) -> (State, f64) {
        let now = self.poses.now();
        let mut s = self.state;
        let carried = !(s.time_s == now.time_s && self.felt.is_some());
        if carried {
            s.go(now.time_s, &now.pose, self.drift.per_second);
            s.lean(&self.shaft);
            let moved = sqrt((s.aside - self.state.aside).norm_squared());
            let gives = s.gives(&self.shaft);
            let stray = self.pace.strayed(&s, self.felt.as_ref(), moved, gives);
            (s, stray)
        } else {
            (s, 0.0)
        }
    }

    /// Depth and tip now, with what they know of each other.
    #[must_use]
    pub fn told(&self) -> Told {
        let (s, stray) = self.now();
        let short = self.shaft.short(s.size * s.size, self.shaft.arc(s.arc()));
        let arc = s.l() - short;
        let shape = self.rod.bent(s.size, arc + s.known.x[DEEPER], arc);
        let spread = self.spread(&s, stray);
        let beside = self.beside_the_force(&s, &spread, stray, arc, &shape);
        let bent = s.way * shape.across;
        let tip = s.pose.apply(&Vector3::new(bent.x, bent.y, -shape.short));
        let held = |mm: f64| if mm > 0.0 { mm } else { 0.0 };
        Told {
            time_s: s.time_s,
            // a tip that has left the eye has no length of shaft in it
            depth_mm: held(s.l()),
            arc_mm: held(arc),
            tip_mm: tip.into(),
            covariance: in_base(&beside, &s.way, &s.pose),
            force_mn: s.force().into(),
            force_variance: 0.5 * (spread.along + spread.across),
        }
    }

    #[inline]
    fn spread(&self, s: &State, stray: f64) -> Spread {
        let depth = s.known.covariance(L, L);
        let (mut along, mut across) = (stray, stray);
        let (mut depth_along, mut depth_across) = (0.0, 0.0);
        if let Some(felt) = &self.felt {
            along += felt.noise + felt.by_depth * felt.by_depth * depth;
            across += felt.noise;
            depth_along = felt.by_depth * depth;
            for i in 0..2 {
                let (w, o) = (felt.by_moments[i], OFFSETS + 2 * i);
                let p = &s.known.p;
                let own = 0.5 * (p[o][o] + p[o + 1][o + 1]) * w * w;
                along += own;
                across += own;
                // moments that nothing makes are taken off the force
                let with = |x: f64, y: f64| -w * (p[L][o] * x + p[L][o + 1] * y);
                let d = with(s.way.x, s.way.y);
                depth_along += d;
                along += 2.0 * felt.by_depth * d;
                depth_across += with(-s.way.y, s.way.x);
            }
        }
        let known = self.unknown_force * s.size;
        Spread {
            depth,
            along: along.max(0.0) + known * known,
            across,
            depth_along,
            depth_across,
        }
    }

    /// Lower triangle of the covariance of `l` and of the tip's places along and across the force and along the shaft, mm².
    #[inline]
    fn beside_the_force(
        &self,
        s: &State,
        spread: &Spread,
        stray: f64,
        arc_mm: f64,
        shape: &Shape,
    ) -> [[f64; 4]; 4] {
        let size = s.size;
        let bend = self.rod.beam.compliance(arc_mm);
        let per_stiffness = 1.0 / self.rod.beam.stiffness();
        let clamp = (self.rod.beam.length_mm() - arc_mm).max(0.0);
        // what the bend takes goes with the force squared, `a⁵/15 + d a⁴/8` over EI² for a tip
        let third = match self.rod.bending {
            Bending::Exact => clamp * clamp * clamp * (per_stiffness * per_stiffness),
            Bending::Small => 0.0,
        };
        let shorter = if size > 0.0 {
            2.0 / size * shape.short
        } else {
            0.0
        };
        let shorter_by_depth = -size * size * third * (5.0 * clamp * (1.0 / 24.0) + 0.5 * arc_mm);
        // the tip along the force and up the shaft, by the force and by the depth
        let (f, d) = (bend.value, size * bend.by_depth);
        let (up, up_d) = (-shorter, -shorter_by_depth);
        let Spread {
            depth: ll,
            along: aa,
            across: cc,
            depth_along: la,
            depth_across: lc,
        } = *spread;
        let (l_along, l_up) = (d * ll + f * la, up_d * ll + up * la);
        // where the force is not known, neither is its square
        let at_tip = third * clamp * (clamp * (1.0 / 15.0) + arc_mm * 0.125);
        let squared = at_tip * at_tip * 8.0 * stray * stray;
        let mut along = d * l_along + f * (d * la + f * aa);
        let mut along_up = d * l_up + f * (up_d * la + up * aa);
        let mut upward = up_d * l_up + up * (up_d * la + up * aa) + squared;
        let turned = shape.across * sqrt(s.known.covariance(TURN, TURN));
        let factor = &self.beam;
        for k in 0..2 {
            let (length, stiffer) = (factor[(0, k)], factor[(1, k)]);
            let moved = size * (bend.by_length * length + bend.by_stiffness * stiffer);
            let raised = 2.0 * shape.short * per_stiffness * stiffer;
            along += moved * moved;
            along_up += moved * raised;
            upward += raised * raised;
        }
        [
            [ll, 0.0, 0.0, 0.0],
            [l_along, along, 0.0, 0.0],
            [f * lc, f * d * lc, f * f * cc + turned * turned, 0.0],
            [l_up, along_up, f * up_d * lc, upward],
        ]
    }
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
