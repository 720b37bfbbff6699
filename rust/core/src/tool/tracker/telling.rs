//! Depth and tip now, and how well they are known together.

use super::PACE_UP_TO_S;
use super::ToolFilter;
use super::reading::cross;
use super::state::State;
use super::unknowns::{Tied, UNKNOWNS};
use crate::numbers::rigid::Rigid;
use crate::tool::rod::{Bending, Shape};
use nalgebra::{Matrix3, Vector2, Vector3};

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

impl ToolFilter {
    /// Depth and tip now, with what they know of each other.
    #[must_use]
    pub fn told(&self) -> Told {
        let now = self.poses.now();
        let s = self.carried(&self.state, now.time_s, &now.pose);
        let size = s.force.norm();
        let depth = s.depth(&self.rod);
        let way = if size > 0.0 {
            s.force / size
        } else {
            Vector2::new(1.0, 0.0)
        };
        let shape = self.rod.shape(size, depth);
        let waited = (s.time_s - s.force_s).min(PACE_UP_TO_S);
        let moved = (s.pose.translation - self.state.pose.translation).norm();
        let edge = s.edge(moved, self.clearance_mm);
        let stray = self.pace * waited * waited + edge;
        let beside = self.beside_the_force(&s, stray, size, depth, &shape);
        let bent = way * shape.across;
        let mut force_variance = s.force_noise + stray + s.by_depth * s.by_depth * s.variance;
        for k in 0..UNKNOWNS {
            let t = s.force_tied[0][k] + s.by_depth * s.tied[k];
            force_variance += t * t;
        }
        let tip = now.pose.apply(&Vector3::new(bent.x, bent.y, -shape.short));
        Told {
            time_s: now.time_s,
            depth_mm: depth,
            tip_mm: tip.into(),
            covariance: in_base(&beside, &way, &now.pose),
            force_mn: s.force.into(),
            force_variance,
        }
    }

    /// Lower triangle of the covariance of the depth and of the tip's places along and across the force and along the
    /// shaft, mm².
    fn beside_the_force(
        &self,
        s: &State,
        stray: f64,
        size: f64,
        depth: f64,
        shape: &Shape,
    ) -> [[f64; 4]; 4] {
        let bend = self.rod.beam.compliance(depth);
        let stiffness = self.rod.beam.stiffness();
        let exact = self.rod.bending == Bending::Exact;
        let arc = (self.rod.beam.length_mm() - depth).max(0.0);
        // what the bend takes goes with the force squared, `a⁵/15 + d a⁴/8` over EI² for a tip
        let third = if exact {
            arc * arc * arc / (stiffness * stiffness)
        } else {
            0.0
        };
        let twice = if size > 0.0 { 2.0 / size } else { 0.0 };
        let (shorter, contact) = (twice * shape.short, -twice * shape.contact_short);
        let shorter_by_depth = -size * size * third * (5.0 * arc / 24.0 + depth / 2.0);
        let (by_force, by_depth) = (bend.value, size * bend.by_depth);
        let on_depth = [
            1.0,
            by_force * s.by_depth + by_depth,
            0.0,
            -(shorter * s.by_depth + shorter_by_depth),
        ];
        let mut covariance = [[0.0; 4]; 4];
        // every unknown moves the four by its shares of depth, force along and force across: three rows, and what these
        // have in common
        let [along, across] = &s.force_tied;
        let rows = [
            on_depth,
            [0.0, by_force, 0.0, -shorter],
            [0.0, 0.0, by_force, 0.0],
        ];
        let of = [&s.tied, along, across];
        for a in 0..3 {
            for b in 0..=a {
                let shared = dot(of[a], of[b]);
                for i in 0..4 {
                    for j in 0..=i {
                        covariance[i][j] += rows[a][i] * rows[b][j] * shared;
                        if a != b {
                            covariance[i][j] += rows[b][i] * rows[a][j] * shared;
                        }
                    }
                }
            }
        }
        let mut add = |row: [f64; 4], weight: f64| {
            for i in 0..4 {
                for j in 0..=i {
                    covariance[i][j] += row[i] * row[j] * weight;
                }
            }
        };
        add(on_depth, s.variance);
        add([0.0, by_force, 0.0, -shorter], s.force_noise);
        add([contact, by_force, 0.0, -shorter], stray);
        add([0.0, 0.0, by_force, 0.0], s.force_noise + stray);
        // where the force is not known, neither is its square
        let (at_hole, at_tip) = (arc * arc / 15.0, arc * (arc / 15.0 + depth / 8.0));
        let squared = [at_hole, 0.0, 0.0, at_tip].map(|x| x * third);
        add(squared, 8.0 * stray * stray);
        let factor = &self.unknowns.beam;
        for k in 0..2 {
            let (length, stiffer) = (factor[(0, k)], factor[(1, k)]);
            let moved = size * (bend.by_length * length + bend.by_stiffness * stiffer);
            add(
                [0.0, moved, 0.0, 2.0 * shape.short / stiffness * stiffer],
                1.0,
            );
        }
        covariance
    }

    /// Variance of the depth by noise alone, and how its error hangs on the unknowns: for a smoother.
    #[must_use]
    pub fn told_tied(&self) -> (f64, Tied) {
        let now = self.poses.now();
        let s = self.carried(&self.state, now.time_s, &now.pose);
        (s.variance, s.tied)
    }
}

fn dot(a: &Tied, b: &Tied) -> f64 {
    let mut sum = 0.0;
    for k in 0..UNKNOWNS {
        sum += a[k] * b[k];
    }
    sum
}

/// A lower triangle, depth and the tip along and across a way and along the shaft, in the base frame.
fn in_base(lower: &[[f64; 4]; 4], way: &Vector2<f64>, pose: &Rigid) -> [[f64; 4]; 4] {
    let axes = &pose.rotation;
    let lead = |v: &Vector2<f64>| axes.column(0) * v.x + axes.column(1) * v.y;
    let to = Matrix3::from_columns(&[lead(way), lead(&cross(way)), axes.column(2).into_owned()]);
    let [_, [p, a, _, _], [q, b, c, _], [r, d, e, f]] = *lower;
    let tip = to * Matrix3::new(a, b, d, b, c, e, d, e, f) * to.transpose();
    let with_depth = to * Vector3::new(p, q, r);
    let mut out = [[0.0; 4]; 4];
    out[0][0] = lower[0][0];
    for i in 0..3 {
        out[0][i + 1] = with_depth[i];
        out[i + 1][0] = with_depth[i];
        for j in 0..=i {
            out[i + 1][j + 1] = tip[(i, j)];
            out[j + 1][i + 1] = tip[(i, j)];
        }
        out[i + 1][i + 1] = out[i + 1][i + 1].max(0.0);
    }
    out
}
