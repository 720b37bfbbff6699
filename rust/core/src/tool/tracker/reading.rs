//! One reading: what the moments say beside what is expected, and Schmidt's update of the depth by it.

use super::ToolFilter;
use super::moments::Moments;
use super::state::Felt;
use super::unknowns::{DISTANCE, Tied, UNKNOWNS};
use crate::numbers::math::sqrt;
use crate::tool::filters::Status;
use nalgebra::Vector2;

/// Deviations of the force below which it does not tell a depth.
pub(super) const DETECTED: f64 = 5.0;
/// Deviation by what is not known, over the lever, above which a depth does not hang on it in proportion any more: the
/// deviation would be that of the wrong depth.
const STRAIGHT: f64 = 0.07;
/// Part of the moment that no error of a calibration puts across the force.
const PLAIN: f64 = 0.04;
/// The hole must stand so far below a section for its moment to count, mm.
const NEAREST_MM: f64 = 1.0;
/// Deviations squared from which on a section feels a force plainly.
const PLAINLY_FELT: f64 = 100.0;
/// The part of an arm that is left at least where a contact is found elsewhere.
const LEAST_ARM: f64 = 0.25;

/// What a reading says beside the expected state.
#[derive(Clone, Copy)]
pub(super) struct Said {
    pub(super) size: f64,
    pub(super) way: Vector2<f64>,
    /// The depth that the reading was looked at with, and how far the expected one lies beyond it, mm.
    pub(super) depth: f64,
    pub(super) beyond: f64,
    pub(super) short: f64,
    pub(super) relief: [f64; 2],
    /// Variance of the force's components by noise.
    pub(super) noise: f64,
    pub(super) weights: [f64; 2],
    /// Whether the hole is felt.
    pub(super) touched: bool,
    pub(super) off: Option<Off>,
    /// Square of what the moments say across the force over its variance, and whether no error of a calibration does.
    pub(super) misfit: f64,
    pub(super) plainly: bool,
}

/// How far the depth is from the expected one.
#[derive(Clone, Copy)]
pub(super) struct Off {
    pub(super) mm: f64,
    /// Variance by the reading's noise; how the difference hangs on the unknowns; its variance in all, and with `l`.
    pub(super) noise: f64,
    pub(super) tied: Tied,
    pub(super) total: f64,
    pub(super) shared: f64,
}

impl Said {
    /// Square of how far the depth is from the expected one over its variance; zero where it is not told.
    pub(super) fn far(&self) -> f64 {
        match &self.off {
            Some(off) if off.total > 0.0 => off.mm * off.mm / off.total,
            Some(_) => f64::INFINITY,
            None => 0.0,
        }
    }
}

impl ToolFilter {
    /// What moments say beside the state.
    #[inline]
    pub(super) fn say(&self, m: &Moments) -> Said {
        let s = &self.state;
        let [l0, l1] = self.distances_mm;
        // first with the shape of the last reading, for the shape of this one
        let (mut short, mut relief) = (s.short, s.relief);
        // what section I feels plainly acts below it, wherever the hole was thought to be
        let felt = m.x[0] * m.x[0] + m.y[0] * m.y[0] > PLAINLY_FELT * m.variance[0];
        let most = if felt && m.precision[0] > 0.0 {
            l0 - 2.0 * NEAREST_MM
        } else {
            f64::INFINITY
        };
        let mut depth = (s.along - short).min(most);
        let mut arms = [l0 - depth, l1 - depth];
        let (first, ..) = weighted(m, &arms, &relief);
        let squared = first.norm_squared();
        relief = [
            self.shaft.relief(squared, arms[0]),
            self.shaft.relief(squared, arms[1]),
        ];
        short = self.shaft.short(squared, self.shaft.arc(depth));
        let expected = s.along - short;
        depth = expected.min(most);
        arms = [l0 - depth, l1 - depth];
        let (force, weights, noise) = weighted(m, &arms, &relief);
        let size = sqrt(force.norm_squared());
        let (way, per_size) = if size > 0.0 {
            (force / size, 1.0 / size)
        } else {
            (Vector2::new(1.0, 0.0), 0.0)
        };
        let mut said = Said {
            size,
            way,
            depth,
            beyond: expected - depth,
            short,
            relief,
            noise,
            weights,
            touched: false,
            off: None,
            misfit: 0.0,
            plainly: false,
        };
        if weights[0] > 0.0 && weights[1] > 0.0 {
            self.compare(&mut said, m, &arms, per_size);
        }
        said
    }

    /// Both sections beside each other: across the force they must say nothing, along it how deep.
    #[inline]
    fn compare(&self, said: &mut Said, m: &Moments, arms: &[f64; 2], per_size: f64) {
        let Said {
            size, way, relief, ..
        } = *said;
        let [one, two] = [relief[0] * arms[1], relief[1] * arms[0]];
        let contrast = Vector2::new(m.x[0] * one - m.x[1] * two, m.y[0] * one - m.y[1] * two);
        let variance = m.variance[0] * arms[1] * arms[1] + m.variance[1] * arms[0] * arms[0];
        let across = contrast.y * way.x - contrast.x * way.y;
        if variance > 0.0 {
            said.misfit = across * across / variance;
        }
        said.plainly = across.abs() > PLAIN * size * arms[0] * arms[1];
        let lever = per_size / (self.distances_mm[1] - self.distances_mm[0]);
        let on = [-arms[1] * lever, arms[0] * lever];
        let mut tied = self
            .unknowns
            .of_moments(&self.gains.by, &m.bends, &way, &on);
        // what the unknowns make of the force, weight for weight
        let shares = [said.weights[0] / on[0], said.weights[1] / on[1]];
        let mut squares = [0.0; 2];
        for k in 0..UNKNOWNS / 2 {
            squares[0] += tied[2 * k] * tied[2 * k];
            squares[1] += tied[2 * k + 1] * tied[2 * k + 1];
        }
        let by_unknowns = squares[0] * shares[0] * shares[0] + squares[1] * shares[1] * shares[1];
        said.touched = size * size > DETECTED * DETECTED * (said.noise + by_unknowns);
        let straight = squares[0] + squares[1] < STRAIGHT * STRAIGHT * arms[0] * arms[0];
        // both false for NaN
        if said.touched && straight {
            tied[DISTANCE] += self.unknowns.distance_mm;
            let s = &self.state;
            let noise = variance * lever * lever;
            let (mut total, mut shared) = ([0.0; 2], [0.0; 2]);
            for k in 0..UNKNOWNS / 2 {
                for j in 0..2 {
                    let before = s.tied[2 * k + j];
                    let v = tied[2 * k + j] - before;
                    tied[2 * k + j] = v;
                    total[j] += v * v;
                    shared[j] -= before * v;
                }
            }
            said.off = Some(Off {
                mm: -(contrast.x * way.x + contrast.y * way.y) * lever - said.beyond,
                noise,
                tied,
                total: s.variance + noise + (total[0] + total[1]),
                shared: s.variance + (shared[0] + shared[1]),
            });
        }
    }

    /// Schmidt's update of the depth, and the force at the depth found.
    #[inline]
    pub(super) fn take(&mut self, m: &Moments, said: &Said) -> Status {
        let mut status = Status::UPDATED;
        let mut moved = 0.0;
        if let Some(off) = &said.off {
            let Off {
                mut mm,
                mut noise,
                mut total,
                mut shared,
                ..
            } = *off;
            let s = &mut self.state;
            let mut variance = s.variance;
            if self.watch.refused > 0 {
                // far from the expected depth the force is another than arms to there make it
                let near = mm + said.beyond;
                let lever = said.weights[0] + said.weights[1];
                mm = near / (1.0 + near * lever).max(LEAST_ARM) - said.beyond;
                // no fault explains it: the state is wrong, or the calibration
                variance += mm * mm;
                shared += mm * mm;
                total += mm * mm + noise * said.misfit;
                noise *= 1.0 + said.misfit;
            }
            let per_total = 1.0 / total;
            let gain = shared * per_total;
            let left = 1.0 - gain;
            let before = variance;
            moved = gain * mm;
            variance = left * left * variance + gain * gain * noise;
            if !(total > 0.0 && (moved + variance).is_finite()) {
                return Status::NOT_FINITE;
            }
            s.along += moved;
            s.variance = variance;
            for k in 0..UNKNOWNS {
                s.tied[k] += gain * off.tied[k];
            }
            // what the unknowns make of it is no motion of the eye
            if total > before {
                self.drift.take(mm, total - before, moved);
            }
            self.watch.consistency.add(mm * mm * per_total);
            // from the depth that the reading was looked at with
            moved += said.beyond;
        } else {
            status = status | Status::NO_FORCE;
        }
        let lever = said.weights[0] + said.weights[1];
        if lever > 0.0 && said.size.is_finite() {
            let by_depth = said.size * lever;
            let size = said.size + by_depth * moved;
            self.feel(m, said, if size > 0.0 { size } else { 0.0 }, moved);
        } else {
            self.state.lean(&self.shaft, self.clearance_mm);
        }
        status
    }

    /// The force of a reading, and where it says that the hole stands.
    #[inline]
    fn feel(&mut self, m: &Moments, said: &Said, size: f64, moved: f64) {
        let way = said.way;
        let s = &mut self.state;
        s.size = size;
        s.way = way;
        s.short = said.short;
        s.relief = said.relief;
        s.felt = Felt {
            time_s: s.time_s,
            bends: m.bends,
            way,
            weights: said.weights,
            noise: said.noise,
            size,
            by_depth: said.size * (said.weights[0] + said.weights[1]),
            share: 1.0,
        };
        let touched = size > 0.0 && said.touched;
        s.free = !touched;
        let renewed = if touched {
            let arc = self.shaft.arc(said.depth + moved);
            let shaft_gives = self.shaft.gives(size * size, arc);
            let renewed = self.keep_pace(Some(shaft_gives));
            let s = &mut self.state;
            s.touched = true;
            s.felt_s = s.time_s;
            s.hole_gives = self.pace.hole_gives;
            s.off = way * (self.clearance_mm + (shaft_gives + s.hole_gives) * size);
            s.rest = if s.along > 0.0 {
                Vector2::zeros()
            } else {
                s.force()
            };
            renewed
        } else {
            let renewed = self.keep_pace(None);
            let s = &mut self.state;
            if s.touched {
                // where nothing pushes, the hole is around the shaft, if the tip has not left it
                let far = sqrt(s.off.norm_squared());
                if far > self.clearance_mm && s.surely_inside() {
                    s.off *= self.clearance_mm / far;
                }
                s.rest = s.force();
            }
            renewed
        };
        if renewed {
            self.pace.since = self.state;
        }
    }
}

/// Weighted mean of the forces of both moments, mN, what each counts, and the variance of its components by noise.
#[inline]
fn weighted(m: &Moments, arms: &[f64; 2], relief: &[f64; 2]) -> (Vector2<f64>, [f64; 2], f64) {
    let (mut weights, mut total) = ([0.0; 2], 0.0);
    for i in 0..2 {
        let weight = if arms[i] > NEAREST_MM {
            arms[i] * m.precision[i]
        } else {
            0.0
        };
        weights[i] = weight;
        total += weight * arms[i];
    }
    let noise = if total > 0.0 { 1.0 / total } else { 0.0 };
    let (mut x, mut y) = (0.0, 0.0);
    for i in 0..2 {
        weights[i] *= noise;
        let counts = weights[i] * relief[i];
        x += counts * m.x[i];
        y += counts * m.y[i];
    }
    (Vector2::new(x, y), weights, noise)
}
