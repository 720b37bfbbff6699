//! Depth and tip now, and how well they are known together.

use super::ToolFilter;
use super::state::{DEEPER, L, OFFSETS, State, TURN};
use crate::tool::rod::Bending;
use crate::tool::status::Told;
use nalgebra::{Matrix3, Matrix4, Matrix4x2, SMatrix, Vector2, Vector3};

/// Numbers of the state that depth and tip hang on.
const KNOWN: [usize; 6] = [L, TURN, OFFSETS, OFFSETS + 1, OFFSETS + 2, OFFSETS + 3];

impl ToolFilter {
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
        let (felt, shaft) = (self.felt.as_ref(), &self.shaft);
        self.told_of(&s, self.edge.strayed(felt, shaft, &self.state, &s))
    }

    /// Of a state, with the variance of a component of its force that was not read.
    #[inline]
    fn told_of(&self, s: &State, stray: f64) -> Told {
        let (rod, d, size, way) = (&self.trusted.rod, &self.trusted.doubt, s.size, s.way);
        let arc = s.x[L] - self.shaft.short(size * size, self.shaft.arc(s.arc()));
        let shape = rod.bent(size, arc + s.x[DEEPER], arc);
        let bend = rod.beam.compliance(arc);
        // the force along and across itself by what is known of the state: moments that nothing makes are taken off it
        let (mut white, mut by_depth, [mut a, mut b]) = (stray, 0.0, [0.0; 2]);
        if let Some((_, felt)) = &self.felt {
            white += felt.noise + self.offsets.lagging_force(&self.gratings, felt.by_moments);
            (by_depth, [a, b]) = (felt.by_depth, felt.by_moments);
        }
        let p = SMatrix::<f64, 6, 6>::from_fn(|i, j| s.p[KNOWN[i]][KNOWN[j]]);
        let (x, y) = (way.x, way.y);
        let along = [by_depth, 0.0, -a * x, -a * y, -b * x, -b * y];
        let across = [0.0, 0.0, a * y, -a * x, b * y, -b * x];
        let force = SMatrix::<f64, 2, 6>::from_rows(&[along.into(), across.into()]);
        let gain = (d.force * size) * (d.force * size);
        let force_variance = white + 0.5 * ((force * p * force.transpose()).trace() + gain);
        // what the bend takes goes with the force squared, `a⁵/15 + d a⁴/8` over EI² for a tip
        let clamp = (rod.beam.length_mm() - arc).max(0.0);
        let squared = clamp * clamp / rod.beam.stiffness();
        let exact = f64::from(u8::from(rod.bending == Bending::Exact));
        let raised = exact * squared * squared * (clamp / 15.0 + arc * 0.125);
        let per_force = if size > 0.0 { 2.0 / size } else { 0.0 };
        // depth, and the tip along and across the force and up the shaft: by the force, and by the state
        let by_force = Matrix4x2::new(
            0.0,
            0.0,
            bend.value,
            0.0,
            0.0,
            bend.value,
            -per_force * shape.short,
            0.0,
        );
        let mut by = by_force * force;
        by[(0, 0)] += 1.0;
        by[(1, 0)] += size * bend.by_depth;
        by[(2, 1)] += shape.across;
        let mut sum = by * p * by.transpose() + by_force * by_force.transpose() * white;
        let by_along = by_force.column(0);
        sum += by_along * by_along.transpose() * gain;
        let beam = Vector2::new(bend.by_length, bend.by_stiffness) * size;
        sum[(1, 1)] += beam.dot(&(d.beam * beam));
        sum[(0, 0)] += s.lasting * s.lasting;
        // where the force is not known, neither is its square
        sum[(3, 3)] += 8.0 * (raised * stray) * (raised * stray);
        let (mut bent, gives) = (way * shape.across, rod.beam.compliance(0.0).value);
        if self.tip.on {
            bent += self.tip.force * gives;
        }
        // a late robot has gone on since; nobody reads what is to come, but where gratings are ahead its rows are old. Of how
        // late it is, little more than a third is learnt
        let (late, unsure) = self.edge.late();
        let unsure = unsure + 3.0 * late * late;
        let axes = &s.pose.rotation;
        sum[(0, 0)] += unsure * s.slide * s.slide;
        for k in 1..3 {
            sum[(k, k)] += self.tip.unsure() * gives * gives;
        }
        let turn = axes * Matrix3::new(x, -y, 0.0, y, x, 0.0, 0.0, 0.0, 1.0);
        let mut base = Matrix4::identity();
        base.fixed_view_mut::<3, 3>(1, 1).copy_from(&turn);
        let turned = base * sum * base.transpose();
        let mut covariance = (turned + turned.transpose()) * 0.5;
        // a late robot puts the tip off along its way and nowhere else; of a tremor nobody knows the way so well
        let mut of_tip = covariance.fixed_view_mut::<3, 3>(1, 1);
        of_tip += s.speeds * (1.5 * unsure);
        for k in 0..4 {
            covariance[(k, k)] = covariance[(k, k)].max(0.0);
        }
        let tip = s.pose.apply(&Vector3::new(bent.x, bent.y, -shape.short));
        Told {
            time_s: s.time_s,
            // a tip that has left the eye has no length of shaft in it
            depth_mm: s.x[L].max(0.0),
            arc_mm: arc.max(0.0),
            tip_mm: (tip + s.speed * late.max(0.0)).into(),
            covariance: covariance.into(),
            force_mn: (way * size).into(),
            force_variance,
        }
    }
}
