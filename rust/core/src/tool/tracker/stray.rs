//! What is not known of the force that a late reading is carried on to: all that the edge may have done since.
//!
//! A force was felt at a stamp; the hole is carried from there to the present by the pose alone. What the carried force
//! does not know is how the edge has strayed ([`Pace`]), what the hole gives way for the force's change, and where the
//! edge stood where the force was small or none.

use super::ToolFilter;
use super::pace::{OVER_S, Pace};
use super::reading::DETECTED;
use super::state::State;
use crate::numbers::math::sqrt;
use nalgebra::Vector2;

/// Deviation of a force that nobody has read, mN: what presses a tool in an eye is smaller as a rule.
const UNREAD_MN: f64 = 100.0;
/// Deviations of a force beyond which it is hardly noise.
const NOTICED: f64 = 3.0;

/// Covariance of a force, mN²: along its way, between that and across, and across.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Stray {
    pub(super) along: f64,
    pub(super) both: f64,
    pub(super) across: f64,
}

impl Stray {
    pub(super) fn in_all_ways(variance: f64) -> Self {
        Self {
            along: variance,
            both: 0.0,
            across: variance,
        }
    }

    /// With an error of a force that goes one way.
    fn with(self, error: &Vector2<f64>, way: &Vector2<f64>) -> Self {
        let (along, across) = (error.dot(way), error.y * way.x - error.x * way.y);
        Self {
            along: self.along + along * along,
            both: self.both + along * across,
            across: self.across + across * across,
        }
    }

    /// Variance of a component, on the mean of both.
    pub(super) fn mean(&self) -> f64 {
        f64::midpoint(self.along, self.across)
    }
}

impl Pace {
    /// How a state's force has strayed while it was waited for, where shaft and hole give way so much (mm/mN).
    ///
    /// The edge strays in proportion as long as its pace was taken over, and from one such time to the next as it comes.
    /// What it strays along the shaft (mm²/s) goes across as the shaft has turned from the mean of where it stood while
    /// the pace was taken. And what the hole gives way is in all that the force has changed since it was felt.
    pub(super) fn strayed(
        &self,
        s: &State,
        waited_s: f64,
        gives: f64,
        per_second_mm2: f64,
    ) -> Stray {
        if gives <= 0.0 {
            return Stray::default();
        }
        let stiff = 1.0 / gives;
        let edge = self.square() * waited_s.min(OVER_S) * waited_s;
        let [x, y] = [0, 1].map(|k| s.pose.rotation.column(k).dot(&self.axis));
        let turned = Vector2::new(x, y) * (sqrt(per_second_mm2 * waited_s) * stiff);
        let changed = (s.force() - s.felt.way * s.felt.size) * (sqrt(self.giving) * stiff);
        Stray::in_all_ways(edge * stiff * stiff)
            .with(&turned, &s.way)
            .with(&changed, &s.way)
    }
}

impl State {
    /// What noise of where the edge stands makes of the force, beyond the noise of the force as it was felt.
    ///
    /// The edge is a clearance beyond the way of the force, so that noise across a small force moves it more than along.
    /// What lies along the force now is felt whole; what lies across only turns it, as far as it stands from the middle
    /// of the hole.
    pub(super) fn turned(&self, clearance_mm: f64, gives: f64) -> Stray {
        if gives <= 0.0 {
            return Stray::default();
        }
        let clearance = clearance_mm / gives;
        let felt = self.felt.size.max(f64::MIN_POSITIVE);
        let farther = (felt + clearance) / felt;
        let turns = farther * self.size / (self.size + clearance);
        // across the force that was felt, in the way of the one now and across it
        let across = self.felt.way.dot(&self.way);
        let along = self.felt.way.x * self.way.y - self.felt.way.y * self.way.x;
        let most = clearance * clearance;
        let of = |share: f64, times: f64| {
            let more = self.felt.noise * (times * times - 1.0);
            share * share * more.max(0.0).min(most)
        };
        Stray {
            along: of(along, farther),
            both: 0.0,
            across: of(across, turns),
        }
    }

    /// Variance of the force's components where the shaft was felt to be free and the hole has moved across it (mm) by
    /// the pose, since.
    ///
    /// A shaft that comes free stands at the edge, within the force that is not noticed, on the side where the last force
    /// was just felt, and strays from there: `loose` since it was felt, `since` since the reading (mN²). What it may press
    /// is what of that lies beyond the edge, and no more than the hole has moved. A force that was noticed, though not yet
    /// felt, may be gone.
    fn loose(&self, moved_mm: f64, clearance_mm: f64, gives: f64, loose: f64, since: f64) -> f64 {
        let (moved, clearance) = (moved_mm / gives + sqrt(since), clearance_mm / gives);
        let pressed = sqrt(self.off.norm_squared()) / gives - clearance;
        let noticed = NOTICED * sqrt(self.felt.noise);
        let range = (noticed + clearance / DETECTED + sqrt(loose)).min(2.0 * clearance);
        let most = (pressed + range).max(0.0).min(2.0 * range).min(moved);
        let gone = if self.felt.size > noticed {
            self.felt.size.min(moved)
        } else {
            0.0
        };
        most * most / 4.0 + gone * gone
    }
}

impl ToolFilter {
    /// What shaft and hole give way for a force, mm/mN, also where nothing has touched yet.
    pub(super) fn would_give(&self, s: &State) -> f64 {
        let arc = self.shaft.arc(s.along - s.short);
        self.shaft.gives(s.size * s.size, arc) + s.hole_gives
    }

    /// What a state that was carried on does not know of its force.
    pub(super) fn stray(&self, s: &State) -> Stray {
        if !s.read() {
            return Stray::in_all_ways(UNREAD_MN * UNREAD_MN);
        }
        let gives = self.would_give(s);
        if gives <= 0.0 {
            // the whole shaft is beyond the hole, and nothing of it left to bend
            return Stray::default();
        }
        let strayed = |waited_s| {
            let per_second = self.drift.per_second;
            self.pace.strayed(s, waited_s, gives, per_second)
        };
        let moved = sqrt((s.off - self.state.off).norm_squared());
        let followed = strayed(s.time_s - s.felt.time_s);
        let mut stray = if s.free {
            // where nothing leans, the edge may stray as it likes
            let loose = strayed(s.time_s - s.felt_s).mean();
            Stray::in_all_ways(s.loose(moved, self.clearance_mm, gives, loose, followed.mean()))
        } else {
            let turned = s.turned(self.clearance_mm, gives);
            Stray {
                along: followed.along + turned.along,
                both: followed.both + turned.both,
                across: followed.across + turned.across,
            }
        };
        if !s.surely_inside() {
            // a tip near the hole may have left it, or come in and lean at once
            let far = sqrt(s.off.norm_squared()) - self.clearance_mm;
            let press = (far.max(0.0) + moved) / gives;
            let either = s.size * s.size + press * press;
            stray.along += either;
            stray.across += either;
        }
        stray
    }
}
