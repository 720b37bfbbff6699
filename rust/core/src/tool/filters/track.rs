//! What all filters of the tool do at every step beside their equations: time, refusal, counting.

use super::filter::Filter;
use super::measurement::{Content, Measurement};
use super::status::{Consistency, Counts, Status};
use crate::{Error, Result};

/// A state in time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Track<const N: usize> {
    filter: Filter<N>,
    time_s: f64,
    /// Time of the last measurement used.
    used_s: f64,
    counts: Counts,
    consistency: Consistency,
}

impl<const N: usize> Track<N> {
    /// A state at a time.
    ///
    /// # Errors
    /// [`Error::Invalid`] for numbers that are not finite or a negative variance.
    pub(super) fn new(filter: Filter<N>, time_s: f64) -> Result<Self> {
        let possible = filter.variances().iter().all(|v| *v >= 0.0);
        if !(filter.is_finite() && possible && time_s.is_finite()) {
            return Err(Error::Invalid {
                what: "filter: the first estimate must be finite, its variance zero or more",
            });
        }
        Ok(Self {
            filter,
            time_s,
            used_s: f64::NEG_INFINITY,
            counts: Counts::default(),
            consistency: Consistency::default(),
        })
    }

    /// The estimate.
    #[must_use]
    pub fn filter(&self) -> &Filter<N> {
        &self.filter
    }

    /// Time of the estimate, s.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// How often what happened.
    #[must_use]
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Innovation statistics.
    #[must_use]
    pub fn consistency(&self) -> &Consistency {
        &self.consistency
    }

    /// One step to `time_s`: the state drifts with the velocity and the process noise (mm², of all of the step) that
    /// `motion` says for the time elapsed, then `fold` corrects it with a measurement that is good for something.
    #[inline]
    pub(super) fn step(
        &mut self,
        time_s: f64,
        measurement: Option<&Measurement>,
        motion: impl FnOnce(f64) -> ([f64; N], [[f64; N]; N]),
        fold: impl FnOnce(&mut Self, &Measurement, Content) -> Status,
    ) -> Status {
        let Some(elapsed) = self.elapsed(time_s) else {
            return Status::CLOCK;
        };
        let admitted = self.admit(measurement);
        let (velocity, process) = motion(elapsed);
        let moved = self.predict(elapsed, &velocity, &process);
        let used = match admitted {
            Err(why) => why,
            Ok((m, content)) => fold(self, m, content),
        };
        self.time_s = time_s;
        self.counts.add(moved | used);
        moved | used
    }

    /// Time from the state to the step, s. `None`, with the step counted, where the clock is no clock.
    #[inline]
    fn elapsed(&mut self, time_s: f64) -> Option<f64> {
        self.consistency.last = 0.0;
        self.consistency.last_degrees = 0;
        let elapsed = time_s - self.time_s;
        if elapsed >= 0.0 && elapsed.is_finite() {
            return Some(elapsed);
        }
        self.counts.add(Status::CLOCK);
        None
    }

    /// Moves the state.
    #[inline]
    fn predict(&mut self, elapsed_s: f64, velocity: &[f64; N], process: &[[f64; N]; N]) -> Status {
        let mut status = Status::default();
        let input = velocity.map(|v| v * elapsed_s);
        if !self.filter.drift(process, &input) {
            // not known where it went; what noise there is still counts
            self.filter.drift(process, &[0.0; N]);
            status = Status::NO_MOTION;
        }
        status
    }

    /// What a measurement is good for, or why it is not used.
    #[inline]
    fn admit<'m>(
        &self,
        measurement: Option<&'m Measurement>,
    ) -> core::result::Result<(&'m Measurement, Content), Status> {
        let m = measurement.ok_or(Status::MISSING)?;
        if !m.time_s.is_finite() {
            return Err(Status::NOT_FINITE);
        }
        // the state is still at its old time here; one stamp is used once, and one from the future (a clock that is
        // off) does not make all later ones late
        if m.time_s < self.time_s || m.time_s == self.used_s {
            return Err(Status::LATE);
        }
        match m.content() {
            Content::NotFinite => Err(Status::NOT_FINITE),
            content => Ok((m, content)),
        }
    }

    /// Folds a measurement in.
    #[inline]
    pub(super) fn correct<const M: usize>(
        &mut self,
        stamp_s: f64,
        h: &[[f64; N]; M],
        r: &[[f64; M]; M],
        innovation: &[f64; M],
    ) -> Status {
        let Some(found) = self.filter.update(h, r, innovation) else {
            return Status::NOT_FINITE;
        };
        self.used_s = stamp_s;
        let c = &mut self.consistency;
        c.last = found.squared;
        c.last_degrees = u64::from(found.degrees);
        c.sum += found.squared;
        c.degrees = c.degrees.wrapping_add(c.last_degrees);
        c.count = c.count.wrapping_add(1);
        Status::UPDATED
    }
}
