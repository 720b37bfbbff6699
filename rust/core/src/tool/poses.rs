//! Where the tool was a moment ago, for readings that come late: a short memory of fixed size.

use crate::numbers::rigid::Rigid;

/// Poses kept.
const KEPT: usize = 64;
/// Least time between two of them, s: so many reach back 0.3 s at any rate of the loop.
const APART_S: f64 = 0.005 - 1e-6;

/// A pose at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posed {
    /// s.
    pub time_s: f64,
    /// Tool to base.
    pub pose: Rigid,
}

/// The last poses, and the present one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Poses {
    kept: [Posed; KEPT],
    /// Place of the newest kept.
    newest: usize,
    now: Posed,
}

impl Poses {
    /// Remembers a start.
    pub fn new(start: Posed) -> Self {
        Self {
            kept: [start; KEPT],
            newest: 0,
            now: start,
        }
    }

    /// The present.
    #[inline]
    pub fn now(&self) -> &Posed {
        &self.now
    }

    /// Goes on to a later time; at the same pose where none is given.
    #[inline]
    pub fn push(&mut self, time_s: f64, pose: Option<&Rigid>) {
        if self.now.time_s - self.kept[self.newest % KEPT].time_s >= APART_S {
            self.newest = (self.newest + 1) % KEPT;
            self.kept[self.newest % KEPT] = self.now;
        }
        self.now.time_s = time_s;
        if let Some(pose) = pose {
            self.now.pose = *pose;
        }
    }

    /// The pose at a time before now, by straight lines between neighbours. `None` before all that is remembered.
    #[inline(never)]
    pub fn at(&self, time_s: f64) -> Option<Rigid> {
        // of the kept ones from the newest back, how many are later
        let (mut least, mut most) = (0, KEPT);
        while least < most {
            let middle = usize::midpoint(least, most);
            if self.back(middle).time_s > time_s {
                least = middle + 1;
            } else {
                most = middle;
            }
        }
        if least == KEPT {
            return None;
        }
        let earlier = self.back(least);
        let later = if least > 0 {
            self.back(least - 1)
        } else {
            &self.now
        };
        let span = later.time_s - earlier.time_s;
        let share = if span > 0.0 {
            (time_s - earlier.time_s) / span
        } else {
            0.0
        };
        let (a, b) = (&earlier.pose, &later.pose);
        Some(Rigid {
            rotation: a.rotation + (b.rotation - a.rotation) * share,
            translation: a.translation + (b.translation - a.translation) * share,
        })
    }

    #[inline]
    fn back(&self, by: usize) -> &Posed {
        &self.kept[(self.newest + KEPT - by) % KEPT]
    }
}
