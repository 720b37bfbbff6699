//! Gauss–Newton with Levenberg–Marquardt damping, as a state machine.
//!
//! The caller evaluates rows at [`Levenberg::trial`], folds them into a stack, and calls
//! [`Levenberg::advance`]. Damping is zero until a step fails, so that a good start converges quadratically
//! (Nocedal and Wright, *Numerical Optimization*, 10.3; column scaling as in Moré 1978). It begins where it halves the
//! step along the weakest direction, for in most valleys only that step is too long, grows ever faster while steps fail,
//! and shrinks as well as a step kept what it promised (Nielsen, *Damping parameter in Marquardt's method*, 1999). Along
//! directions that no row observes the estimate stays at the smallest deviation from the start, in plausible sizes.

use super::decomposition::{Decomposition, decomposition_len};
use crate::{Error, Result};

/// Numbers that a [`Levenberg`] of `n` parameters needs.
#[must_use]
pub const fn levenberg_len(n: usize) -> usize {
    5 * n + decomposition_len(n)
}

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Evaluations allowed, the first included.
    pub max_evaluations: usize,
    /// Converged when the next step moves no parameter by more than this fraction of its plausible size. That
    /// step is still taken, so the error left is of second order in it.
    pub step_tolerance: f64,
    /// Singular values below this fraction of the largest count as zero.
    pub rank_tolerance: f64,
    /// Take one undamped step and stop: the linear solution of Eq. 11.
    pub single_step: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            max_evaluations: 100,
            step_tolerance: 1e-5,
            rank_tolerance: 1e-9,
            single_step: false,
        }
    }
}

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Evaluate the rows at the new trial.
    Evaluate,
    /// The minimum is reached and the trial is the estimate. The decomposition was taken one last step away
    /// from it, which is below the tolerance.
    Converged,
    /// The evaluations are used up; the trial is the best so far.
    Exhausted,
}

/// The iteration. `S` is storage of [`levenberg_len`] numbers.
#[derive(Clone, Debug)]
pub struct Levenberg<S> {
    n: usize,
    settings: Settings,
    evaluations: usize,
    damping: f64,
    /// By what the damping grows where the next step fails too.
    growth: f64,
    /// By how much the trial lowers the cost, were the rows linear.
    promised: f64,
    cost: f64,
    rank: usize,
    /// start | sizes | best | trial | step | decomposition at best
    storage: S,
}

/// Part of the cost by which rounding may change it.
const ROUNDING: f64 = 1e-12;
/// By what damping grows at first, and by what that grows.
const GROWTH: f64 = 10.0;
/// Damping never grows by more at once.
const FASTEST: f64 = 1e3;
/// Damping never shrinks by more at once.
const LEAST: f64 = 0.1;

const START: usize = 0;
const SIZES: usize = 1;
const BEST: usize = 2;
const TRIAL: usize = 3;
const STEP: usize = 4;

impl<S: AsRef<[f64]> + AsMut<[f64]>> Levenberg<S> {
    /// Starts at `start`; `sizes` are the plausible sizes of the parameters.
    ///
    /// # Errors
    /// [`Error::WrongLength`]; [`Error::NotFinite`] where a size is not a positive number.
    pub fn new(start: &[f64], sizes: &[f64], settings: Settings, mut storage: S) -> Result<Self> {
        let n = start.len();
        for (expected, found) in [(levenberg_len(n), storage.as_ref().len()), (n, sizes.len())] {
            if expected != found {
                return Err(Error::WrongLength { expected, found });
            }
        }
        if let Some(index) = sizes.iter().position(|s| !(s.is_finite() && *s > 0.0)) {
            return Err(Error::NotFinite { index });
        }
        let s = storage.as_mut();
        for (slot, values) in [
            (START, start),
            (SIZES, sizes),
            (BEST, start),
            (TRIAL, start),
        ] {
            s[slot * n..][..n].copy_from_slice(values);
        }
        Ok(Self {
            n,
            settings,
            evaluations: 0,
            damping: 0.0,
            growth: GROWTH,
            promised: 0.0,
            cost: f64::INFINITY,
            rank: 0,
            storage,
        })
    }

    /// Begins where a descent from the same start got to, after that many evaluations.
    pub fn begin_at(&mut self, place: &[f64], evaluations: usize) {
        let n = self.n;
        for slot in [BEST, TRIAL] {
            for (own, new) in self.storage.as_mut()[slot * n..][..n].iter_mut().zip(place) {
                *own = *new;
            }
        }
        self.evaluations = evaluations;
    }

    fn slot(&self, slot: usize) -> &[f64] {
        &self.storage.as_ref()[slot * self.n..][..self.n]
    }

    /// Parameters at which to evaluate the rows; after the end, the estimate.
    #[must_use]
    pub fn trial(&self) -> &[f64] {
        self.slot(TRIAL)
    }

    /// Where the iteration started.
    #[must_use]
    pub fn start(&self) -> &[f64] {
        self.slot(START)
    }

    /// Plausible sizes.
    #[must_use]
    pub fn sizes(&self) -> &[f64] {
        self.slot(SIZES)
    }

    /// Evaluations so far.
    #[must_use]
    pub fn evaluations(&self) -> usize {
        self.evaluations
    }

    /// Cost at the estimate.
    #[must_use]
    pub fn cost(&self) -> f64 {
        self.cost
    }

    /// Ends the iteration where it stands: the trial is the best so far.
    pub fn stop(&mut self) {
        let n = self.n;
        let slots = self.storage.as_mut();
        slots.copy_within(BEST * n..(BEST + 1) * n, TRIAL * n);
    }

    /// Runs `read` on the decomposition at the estimate.
    ///
    /// # Errors
    /// Those of [`Decomposition::new`], which cannot occur here.
    pub fn with_decomposition<T>(
        &mut self,
        read: impl FnOnce(&Decomposition<&mut [f64]>) -> T,
    ) -> Result<T> {
        let n = self.n;
        let rank = self.rank;
        let d = Decomposition::restore(n, rank, &mut self.storage.as_mut()[5 * n..])?;
        Ok(read(&d))
    }

    /// Takes the triangle and the cost at the trial, and says what to do next. A trial that could not be
    /// evaluated (a row out of reach) has an infinite cost.
    ///
    /// # Errors
    /// [`Error::NotFinite`] where the very first evaluation failed; those of the decomposition.
    pub fn advance(&mut self, triangle: &[f64], cost: f64) -> Result<Progress> {
        let n = self.n;
        self.evaluations += 1;
        let first = self.cost == f64::INFINITY;
        if first && !cost.is_finite() {
            if self.slot(TRIAL) == self.slot(START) {
                return Err(Error::NotFinite { index: 0 });
            }
            // the descent ended where nothing can be computed
            let slots = self.storage.as_mut();
            for slot in [BEST, TRIAL] {
                slots.copy_within(START * n..(START + 1) * n, slot * n);
            }
            return Ok(Progress::Evaluate);
        }
        let (slots, room) = self.storage.as_mut().split_at_mut(5 * n);
        // a step that changes the cost by less than rounding is neither better nor worse: accept it
        let accepted = cost <= self.cost * (1.0 + ROUNDING);
        let mut decomposition;
        if accepted {
            // a promise below rounding cannot be checked
            let kept = if self.promised > ROUNDING * self.cost {
                (self.cost - cost) / self.promised
            } else {
                1.0
            };
            self.cost = cost.min(self.cost);
            slots.copy_within(TRIAL * n..(TRIAL + 1) * n, BEST * n);
            decomposition = Decomposition::new(n, room)?;
            decomposition.decompose(
                triangle,
                &slots[SIZES * n..][..n],
                self.settings.rank_tolerance,
            )?;
            self.rank = decomposition.rank();
            let well = 2.0 * kept - 1.0;
            self.damping *= (1.0 - well * well * well).clamp(LEAST, 1.0 / LEAST);
            self.growth = GROWTH;
            if self.damping <= LEAST * decomposition.weakest() {
                self.damping = 0.0;
            }
        } else {
            decomposition = Decomposition::restore(n, self.rank, room)?;
            self.damping = (self.damping * self.growth).max(decomposition.weakest());
            self.growth = (self.growth * GROWTH).min(FASTEST);
        }
        // the last step, taken from the estimate: how far would the next one go?
        let (head, step) = slots.split_at_mut(STEP * n);
        let step = &mut step[..n];
        // the minimum is where the undamped step is small too: a damped one is small at every wall
        decomposition.step(0.0, step);
        let undamped = step
            .iter()
            .zip(&head[SIZES * n..])
            .map(|(t, s)| (t / s).abs())
            .fold(0.0, f64::max);
        decomposition.step(self.damping, step);
        self.promised = decomposition.gain(self.damping);
        let (head, trial) = head.split_at_mut(TRIAL * n);
        let (start, rest) = head.split_at(n);
        let (sizes, best) = rest.split_at(n);
        let trial = &mut trial[..n];
        for ((t, s), (b, o)) in trial.iter_mut().zip(&*step).zip(best.iter().zip(start)) {
            *t = b + s - o;
        }
        decomposition.remove_unobserved(trial);
        for (t, o) in trial.iter_mut().zip(start) {
            *t += o;
        }
        let farthest = trial
            .iter()
            .zip(best)
            .zip(sizes)
            .map(|((t, b), s)| ((t - b) / s).abs())
            .fold(0.0, f64::max);
        let converged = farthest.max(undamped) <= self.settings.step_tolerance;
        let exhausted = self.evaluations >= self.settings.max_evaluations || self.damping > 1e12;
        if self.settings.single_step {
            // the linear solution, whatever it would cost: that is what was asked for
            return Ok(Progress::Converged);
        }
        if exhausted && !converged {
            self.stop();
            return Ok(Progress::Exhausted);
        }
        if converged {
            // the last step is too small to be worth an evaluation, and still brings the minimum closer
            return Ok(Progress::Converged);
        }
        Ok(Progress::Evaluate)
    }
}
