//! Depth and tip now, and how well they are known together.

use super::start::ToolFilter;
use super::state::{DEEPER, L, OFFSETS, State, TURN};
use crate::tool::rod::Bending;
use crate::tool::status::Told;
use nalgebra::{Matrix4, Vector2, Vector3, Vector4};

impl ToolFilter {
    /// The share of its slides by which the shaft was seen to take the hole along; zero where it was not.
    #[must_use]
    pub fn goes_along(&self) -> f64 {
        self.along.share()
    }

    /// Depth and tip now, with what they know of each other: the state at the present, carried there where the last reading
    /// is older.
    #[must_use]
    pub fn told(&self) -> Told {
        let now = self.poses.now();
        if self.state.time_s == now.time_s && self.felt.is_some() {
            return self.told_of(&self.state, 0.0);
        }
        let mut s = self.state;
        s.go(now.time_s, &now.pose, self.drift.per_second);
        s.lean(&self.shaft);
        self.told_of(&s, self.strayed(&s))
    }

    /// Of a state, with the variance of a component of its force that was not read.
    #[inline]
    fn told_of(&self, s: &State, stray: f64) -> Told {
        let (rod, size, across_way) = (&self.trusted.rod, s.size, Vector2::new(-s.way.y, s.way.x));
        let short = self.shaft.short(size * size, self.shaft.arc(s.arc()));
        let arc = s.x[L] - short;
        let shape = rod.bent(size, arc + s.x[DEEPER], arc);
        let bend = rod.beam.compliance(arc);
        let mut bent = s.way * shape.across;
        // variances of the force along and across itself, and how the depth goes with it
        let (mut along, mut across, mut depth) = (stray, stray, Vector2::zeros());
        if let Some(felt) = &self.felt {
            let noise = felt.noise + self.lagging_force(felt.by_moments);
            along += noise + felt.by_depth * felt.by_depth * s.p[L][L];
            across += noise;
            depth.x = felt.by_depth * s.p[L][L];
            for i in 0..2 {
                // moments that nothing makes are taken off the force
                let (w, o) = (felt.by_moments[i], OFFSETS + 2 * i);
                let with = Vector2::new(s.p[L][o], s.p[L][o + 1]) * -w;
                let own = 0.5 * (s.p[o][o] + s.p[o + 1][o + 1]) * w * w;
                along += own + 2.0 * felt.by_depth * with.dot(&s.way);
                across += own;
                depth += Vector2::new(with.dot(&s.way), with.dot(&across_way));
            }
        }
        along =
            along.max(0.0) + (self.trusted.doubt.force * size) * (self.trusted.doubt.force * size);
        // what the bend takes goes with the force squared, `a⁵/15 + d a⁴/8` over EI² for a tip
        let clamp = (rod.beam.length_mm() - arc).max(0.0);
        let per_stiffness = 1.0 / rod.beam.stiffness();
        let third = match rod.bending {
            Bending::Exact => clamp * clamp * clamp * (per_stiffness * per_stiffness),
            Bending::Small => 0.0,
        };
        let shorter = if size > 0.0 {
            2.0 / size * shape.short
        } else {
            0.0
        };
        let shorter_by_depth = -size * size * third * (5.0 * clamp * (1.0 / 24.0) + 0.5 * arc);
        let turned = shape.across * shape.across * s.p[TURN][TURN];
        // depth and the tip along and across the force and up the shaft, by depth, force along and across it, and the beam
        let by_depth = Vector4::new(1.0, size * bend.by_depth, 0.0, -shorter_by_depth);
        let by_along = Vector4::new(0.0, bend.value, 0.0, -shorter);
        let by_across = Vector4::new(0.0, 0.0, bend.value, 0.0);
        let own = |v: &Vector4<f64>, variance: f64| (v * variance) * v.transpose();
        let both = |v: &Vector4<f64>, by: f64| {
            let one = (by_depth * by) * v.transpose();
            one + one.transpose()
        };
        let mut spread: Matrix4<f64> = own(&by_depth, s.p[L][L])
            + own(&by_along, along)
            + own(&by_across, across)
            + both(&by_along, depth.x)
            + both(&by_across, depth.y);
        for k in 0..2 {
            let (length, stiffer) = (self.beam[(0, k)], self.beam[(1, k)]);
            let moved = size * (bend.by_length * length + bend.by_stiffness * stiffer);
            let raised = 2.0 * shape.short * per_stiffness * stiffer;
            spread += own(&Vector4::new(0.0, moved, 0.0, raised), 1.0);
        }
        spread[(2, 2)] += turned;
        // where the force is not known, neither is its square
        let at_tip = third * clamp * (clamp * (1.0 / 15.0) + arc * 0.125);
        spread[(3, 3)] += at_tip * at_tip * 8.0 * stray * stray;
        // what lasts puts depth and force off in no fixed proportion
        spread[(0, 0)] += s.lasting * s.lasting;
        spread[(3, 3)] += shorter_by_depth * shorter_by_depth * s.lasting * s.lasting;
        if self.tip.on {
            let h = rod.beam.length_mm();
            let gives = h * h * h * per_stiffness / 3.0;
            bent += self.tip.force * gives;
            for k in 1..3 {
                spread[(k, k)] += self.tip.unsure() * gives * gives;
            }
        }
        // a late robot has gone on since; nobody reads what is to come, but where gratings are ahead its rows are old. Of how
        // late it is, little more than a third is learnt
        let (late, unsure) = self.edge.late();
        let tip = s.pose.apply(&Vector3::new(bent.x, bent.y, -shape.short));
        let (tip, unsure) = (tip + s.speed * late.max(0.0), unsure + 3.0 * late * late);
        let axes = &s.pose.rotation;
        let mut to_base = Matrix4::identity();
        for i in 0..3 {
            to_base[(i + 1, 1)] = axes[(i, 0)] * s.way.x + axes[(i, 1)] * s.way.y;
            to_base[(i + 1, 2)] = axes[(i, 0)] * across_way.x + axes[(i, 1)] * across_way.y;
            to_base[(i + 1, 3)] = axes[(i, 2)];
        }
        let mut covariance = [[0.0; 4]; 4];
        let (half, back) = (to_base * spread, to_base.transpose());
        for i in 0..4 {
            for j in 0..=i {
                covariance[i][j] = half.row(i).transpose().dot(&back.column(j));
                covariance[j][i] = covariance[i][j];
            }
            covariance[i][i] = covariance[i][i].max(0.0);
        }
        covariance[0][0] += unsure * s.slide * s.slide + self.along.doubt();
        for k in 1..4 {
            covariance[k][k] += 0.5 * unsure * s.speed2;
        }
        Told {
            time_s: s.time_s,
            // a tip that has left the eye has no length of shaft in it
            depth_mm: s.x[L].max(0.0),
            arc_mm: arc.max(0.0),
            tip_mm: tip.into(),
            covariance,
            force_mn: (s.way * size).into(),
            force_variance: 0.5 * (along + across),
        }
    }
}
