//! One reading: what the moments say beside what is expected, and Schmidt's update of the depth by it.

use super::interrogator::Moments;
use super::state::{State, depth_of};
use super::unknowns::{DISTANCE, REBUILT, Tied, UNKNOWNS, Unknowns};
use super::{PACE_UP_TO_S, ToolFilter};
use crate::tool::filters::Status;
use nalgebra::Vector2;

/// Deviations of the force below which it does not tell a depth.
const DETECTED: f64 = 5.0;
/// Part of the moment that no error of a calibration puts across the force.
const PLAIN: f64 = 0.04;
/// The hole must stand so far below a section for its moment to count, mm.
const NEAREST_MM: f64 = 1.0;
/// The pace of the force is taken over this time, and remembered for the other, s.
const PACE_OVER_S: f64 = 0.1;
const PACE_KEPT_S: f64 = 5.0;
/// No hole gives way more, mm/mN.
const MOST_GIVING: f64 = 0.1;
/// What a force may jump whatever its pace, mN, and of its size.
const JUMP_MN: f64 = 1.0;
const JUMP_SHARE: f64 = 0.05;
/// Deviations squared from which on a section feels a force plainly.
const PLAINLY_FELT: f64 = 100.0;
/// The part of an arm that is left at least where a contact is found elsewhere.
const LEAST_ARM: f64 = 0.25;

/// What a reading says beside an expected state.
#[derive(Clone, Copy)]
pub(super) struct Said {
    pub(super) force: Vector2<f64>,
    pub(super) size: f64,
    pub(super) depth: f64,
    pub(super) noise: f64,
    pub(super) weights: [f64; 2],
    pub(super) tied: [[Tied; 2]; 2],
    /// Depth less the expected one, its variance by noise; `None` where there is no telling.
    pub(super) depth_off: Option<(f64, f64, Tied)>,
    /// How far the expected depth lies beyond the one that the reading was looked at with, mm.
    pub(super) beyond: f64,
    pub(super) misfit: f64,
    pub(super) plainly: bool,
    pub(super) jump: f64,
}

pub(super) fn cross(a: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(-a.y, a.x)
}

impl ToolFilter {
    /// What moments say where the state is expected so.
    #[inline]
    pub(super) fn say(&self, state: &State, m: &Moments) -> Said {
        // what section I feels plainly acts below it, wherever the hole was thought to be
        let felt = m.moment[0].norm_squared() > PLAINLY_FELT * m.variance[0];
        let most = if m.usable[0] && felt {
            self.distances_mm[0] - 2.0 * NEAREST_MM
        } else {
            f64::INFINITY
        };
        let mut expected = state.depth(&self.rod);
        let mut depth = expected.min(most);
        let mut force = Vector2::zeros();
        let mut size = 0.0;
        let mut scaled = m.moment;
        let (mut arms, mut weights) = ([0.0; 2], [0.0; 2]);
        for _ in 0..2 {
            let (mut sum, mut total) = (Vector2::zeros(), 0.0);
            for i in 0..2 {
                arms[i] = self.distances_mm[i] - depth;
                weights[i] = 0.0;
                if m.usable[i] && arms[i] > NEAREST_MM {
                    scaled[i] = m.moment[i] / self.rod.moment_share(size, arms[i]);
                    weights[i] = arms[i] / m.variance[i].max(1e-60);
                    sum += scaled[i] * weights[i];
                    total += arms[i] * weights[i];
                }
            }
            if total > 0.0 {
                force = sum / total;
                weights = weights.map(|w| w / total);
            }
            size = force.norm();
            expected = depth_of(&self.rod, state.along, size);
            depth = expected.min(most);
        }
        for i in 0..2 {
            arms[i] = self.distances_mm[i] - depth;
        }
        let way = if size > 0.0 {
            force / size
        } else {
            Vector2::new(1.0, 0.0)
        };
        let mut tied = [[[0.0; UNKNOWNS]; 2]; 2];
        for i in 0..2 {
            if m.usable[i] {
                for (k, way) in [way, cross(&way)].iter().enumerate() {
                    let of = self
                        .unknowns
                        .of_moment(i, way, &m.differences[i], m.common_nm[i]);
                    let place = Unknowns::place(i);
                    tied[i][k][place..place + of.len()].copy_from_slice(&of);
                    let unlike = self.interrogator.unlike_nm(m.common_nm[i]);
                    tied[i][k][REBUILT + i] = m.rebuilt[i].dot(way) * unlike;
                }
            }
        }
        let moved = force - state.force;
        let waited = (state.time_s - state.force_s).min(PACE_UP_TO_S);
        let (mut noise, mut by_unknowns) = (0.0, 0.0);
        for i in 0..2 {
            noise += weights[i] * weights[i] * m.variance[i].min(1e300);
        }
        for k in 0..UNKNOWNS {
            let t = weights[0] * tied[0][0][k] + weights[1] * tied[1][0][k];
            by_unknowns += t * t;
        }
        let sized = JUMP_SHARE * size;
        let jump = moved.norm_squared()
            / (noise + self.pace * waited * waited + JUMP_MN * JUMP_MN + sized * sized);
        let (mut depth_off, mut misfit, mut plainly) = (None, 0.0, false);
        if weights[0] > 0.0 && weights[1] > 0.0 {
            let between = self.distances_mm[1] - self.distances_mm[0];
            let contrast = scaled[0] * arms[1] - scaled[1] * arms[0];
            let variance = m.variance[0] * arms[1] * arms[1] + m.variance[1] * arms[0] * arms[0];
            let across = contrast.dot(&cross(&way));
            if variance > 0.0 {
                misfit = across * across / variance;
            }
            plainly = across.abs() > PLAIN * size * arms[0] * arms[1];
            if size * size > DETECTED * DETECTED * (noise + by_unknowns) {
                let lever = 1.0 / (size * between);
                let mut on = [0.0; UNKNOWNS];
                for k in 0..UNKNOWNS {
                    on[k] = (arms[0] * tied[1][0][k] - arms[1] * tied[0][0][k]) * lever;
                }
                on[DISTANCE] += self.unknowns.distance_mm;
                let off = -contrast.dot(&way) * lever;
                depth_off = Some((off - (expected - depth), variance * lever * lever, on));
            }
        }
        Said {
            force,
            size,
            depth,
            noise,
            weights,
            tied,
            depth_off,
            beyond: expected - depth,
            misfit,
            plainly,
            jump,
        }
    }

    /// Schmidt's update of the depth, and the force at the depth found.
    #[inline]
    pub(super) fn take(&mut self, next: &mut State, said: &Said) -> Status {
        let mut status = Status::UPDATED;
        let mut moved = 0.0;
        if let Some((mut off, mut noise, tied)) = said.depth_off {
            if self.refused > 0 {
                // far from the expected depth the force is another than arms to there make it
                let near = off + said.beyond;
                let lever = said.weights[0] + said.weights[1];
                off = near / (1.0 + near * lever).max(LEAST_ARM) - said.beyond;
                // no fault explains it: the state is wrong, or the calibration
                next.variance += off * off;
                noise *= 1.0 + said.misfit;
            }
            let mut v = tied;
            let (mut total, mut shared) = (next.variance + noise, next.variance);
            for k in 0..UNKNOWNS {
                v[k] -= next.tied[k];
                total += v[k] * v[k];
                shared -= next.tied[k] * v[k];
            }
            if total > 0.0 {
                let gain = shared / total;
                moved = gain * off;
                next.along += moved;
                let left = 1.0 - gain;
                next.variance = left * left * next.variance + gain * gain * noise;
                for k in 0..UNKNOWNS {
                    next.tied[k] += gain * v[k];
                }
                if noise > 0.0 {
                    self.drift.take(off, noise, moved);
                }
                let c = &mut self.consistency;
                c.last = off * off / total;
                c.last_degrees = 1;
                c.sum += c.last;
                c.degrees = c.degrees.wrapping_add(1);
                c.count = c.count.wrapping_add(1);
            }
        } else {
            status = status | Status::NO_FORCE;
        }
        let w = said.weights;
        if w[0] > 0.0 || w[1] > 0.0 {
            let lever = w[0] + w[1];
            next.by_depth = said.size * lever;
            next.force = said.force * (1.0 + lever * moved);
            for k in 0..2 {
                for j in 0..UNKNOWNS {
                    next.force_tied[k][j] = w[0] * said.tied[0][k][j] + w[1] * said.tied[1][k][j];
                }
            }
            next.force_noise = said.noise;
            next.force_s = next.time_s;
            let size = next.force.norm();
            let touched = size > 0.0 && said.depth_off.is_some();
            let across = if touched {
                self.rod.shape(size, said.depth + moved).contact_across
            } else {
                0.0
            };
            let renewed = self.keep_pace(next, across);
            next.free = !touched;
            if touched {
                next.gives = across / size + self.hole_gives();
                next.off = next.force * ((self.clearance_mm + next.gives * size) / size);
            } else if next.gives > 0.0 {
                // where nothing pushes, the hole is around the shaft
                let far = next.off.norm();
                if far > self.clearance_mm {
                    next.off *= self.clearance_mm / far;
                }
            }
            if next.gives > 0.0 {
                next.rest = next.force - next.pushed(self.clearance_mm);
            }
            if renewed {
                self.paced = *next;
            }
        }
        status
    }

    /// What the hole gives way for a force, mm/mN.
    pub(super) fn hole_gives(&self) -> f64 {
        let [shared, squares] = self.yielded;
        if shared > 0.0 && squares > 0.0 {
            (shared / squares).min(MOST_GIVING)
        } else {
            0.0
        }
    }

    /// How fast the force strays from what the motion of the tool makes of it, and what the hole gives way: over a
    /// moment, from the state at its start and the force and the bend at the contact now.
    #[inline]
    pub(super) fn keep_pace(&mut self, state: &State, across: f64) -> bool {
        let elapsed = state.time_s - self.paced.time_s;
        if elapsed < PACE_OVER_S {
            return false;
        }
        let mut then = self.paced;
        let touched = then.gives > 0.0 && then.force.norm_squared() > 0.0 && across > 0.0;
        let (force, gave) = (then.force, self.hole_gives());
        then.carry(&state.pose);
        if touched {
            // the edge stood at the rest's place less what the force pushed it
            let there = then.off - force * gave;
            let here = state.force * ((across + self.clearance_mm) / state.force.norm());
            let changed = state.force - force;
            let kept = 1.0 - elapsed.min(PACE_KEPT_S) / (4.0 * PACE_KEPT_S);
            let [shared, squares] = self.yielded;
            self.yielded = [
                shared * kept - (here - there).dot(&changed),
                squares * kept + changed.norm_squared(),
            ];
        }
        then.lean(self.clearance_mm);
        let pace = (state.force - then.force).norm_squared() / (2.0 * elapsed * elapsed);
        let weight = if elapsed < PACE_KEPT_S {
            elapsed / PACE_KEPT_S
        } else {
            1.0
        };
        self.pace += (pace - self.pace) * weight;
        true
    }
}
