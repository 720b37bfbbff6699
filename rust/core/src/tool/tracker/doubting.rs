//! Which reading, and which grating, not to believe.
//!
//! A reading is doubted where the sections' means do not agree, where its moments do not point one way, or where the
//! depth they tell is far from the one expected. Then it is asked what would explain it: two peaks that changed places,
//! one grating that lies, a section. Where nothing does it is refused a few times; then it is the state that is wrong.

use super::interrogator::{BELIEVED, Interrogator, Set, Swap, of_section};
use super::reading::Said;
use super::state::State;
use super::unknowns::UNKNOWNS;
use super::{Look, ToolFilter};
use crate::tool::filters::Status;
use crate::tool::sensing::{FIBRES, SECTIONS};

/// A comparison of χ² that fails, one degree of freedom.
const FAILS: f64 = 36.0;
/// Readings in a row that fail alike before what fails is held to be so.
const SURE: u16 = 3;
/// Readings that tell one grating of a lost section from its neighbours.
const SINGLED_OUT: f64 = 50.0;
/// Readings in a row that are refused before it is the state that must be wrong.
const PATIENCE: u16 = 20;
/// The same where the moments agree with each other.
const PATIENCE_ALONE: u16 = 4;

impl ToolFilter {
    #[inline]
    pub(super) fn fold(&mut self, next: &mut State, w: &[[f64; FIBRES]; SECTIONS]) -> Status {
        let w = self
            .swapped
            .map_or(*w, |swap| Interrogator::put_back(swap, w));
        let (mut shifts, silent) = self.interrogator.look(&w);
        let agreement = self.interrogator.agree(&shifts, silent);
        let bad = silent | self.bad;
        if silent & !self.silent & self.interrogator.stuck() != 0 {
            self.back(next, false);
        }
        self.silent = silent;
        let mut moments = self.interrogator.moments(&shifts, bad);
        let mut said = self.say(next, &moments);
        let mut faulty = bad | self.swapped.map_or(0, Swap::set);
        let odd = agreement.odd.filter(|i| bad & of_section(*i) == 0);
        let crossed = said.misfit > FAILS && said.plainly;
        let doubtful = odd.is_some() || crossed || Self::far(next, &said) > FAILS;
        if self.bad != 0 {
            self.again(next, &shifts, silent, agreement.odd.is_some());
            self.single_out(next, &shifts, silent);
        }
        let mut trusted = true;
        let swap = if doubtful && odd.is_none() {
            self.search_swap(next, &shifts, bad)
        } else {
            None
        };
        if let Some(swap) = swap {
            faulty |= swap.set();
            self.suspect(swap.set());
            shifts = self.interrogator.shifts_back(swap, &shifts);
            if self.streak >= SURE {
                // a second change of the same two puts them right
                self.swapped = if self.swapped == Some(swap) {
                    None
                } else {
                    Some(swap)
                };
                self.streak = 0;
                self.interrogator.forget();
                self.back(next, false);
            }
            moments = self.interrogator.moments(&shifts, bad);
            said = self.say(next, &moments);
            self.refused = 0;
        } else if doubtful {
            if let Some(set) = self.search(next, &shifts, bad, odd, agreement.slowly) {
                faulty |= set;
                self.suspect(set);
                if self.streak >= SURE || agreement.slowly {
                    self.bad |= set;
                    self.streak = 0;
                    self.interrogator.forget();
                    self.back(next, agreement.slowly);
                }
                moments = self.interrogator.moments(&shifts, faulty);
                said = self.say(next, &moments);
                self.refused = 0;
            } else {
                self.refused = self.refused.saturating_add(1);
                trusted = self.refused > if crossed { PATIENCE } else { PATIENCE_ALONE };
            }
        } else {
            self.streak = 0;
            self.refused = 0;
        }
        self.look = Look {
            misfit: said.misfit,
            faulty,
        };
        if !(moments.usable[0] || moments.usable[1]) {
            return Status::NOT_FINITE;
        }
        if !trusted {
            return Status::GATED;
        }
        self.take(next, &said)
    }

    /// Counts how often in a row the same gratings were suspected.
    fn suspect(&mut self, set: Set) {
        self.streak = if self.suspects == set {
            self.streak + 1
        } else {
            1
        };
        self.suspects = set;
    }

    /// Square of how far the depth is from the expected one over its variance; zero where it is not told.
    fn far(state: &State, said: &Said) -> f64 {
        said.depth_off.map_or(0.0, |(off, noise, tied)| {
            let mut total = state.variance + noise;
            for k in 0..UNKNOWNS {
                let t = tied[k] - state.tied[k];
                total += t * t;
            }
            off * off / total.max(f64::MIN_POSITIVE)
        })
    }

    /// Whether what is held to be bad is in order again.
    pub(super) fn again(
        &mut self,
        state: &State,
        shifts: &[[f64; FIBRES]; SECTIONS],
        silent: Set,
        odd: bool,
    ) {
        let all = self.interrogator.moments(shifts, silent);
        let said = self.say(state, &all);
        let held = self.bad & silent != 0;
        if odd || held || (said.misfit > FAILS && said.plainly) || Self::far(state, &said) > FAILS {
            self.good = 0;
        } else {
            self.good += 1;
            if self.good >= BELIEVED {
                self.bad = 0;
                self.good = 0;
            }
        }
    }

    /// In a section that was lost for a drift: the one grating without which the others fit for a while.
    pub(super) fn single_out(
        &mut self,
        state: &State,
        shifts: &[[f64; FIBRES]; SECTIONS],
        silent: Set,
    ) {
        for i in 0..2 {
            let all = of_section(i);
            if self.bad & all != all || silent & all != 0 {
                continue;
            }
            let others = self.bad & !all;
            for k in 0..FIBRES {
                let found = self.unlikely(state, shifts, others | silent | (1 << (FIBRES * i + k)));
                let held = if found < 4.0 * FAILS {
                    found
                } else {
                    4.0 * FAILS
                };
                self.alone[k] += (held - self.alone[k]) / SINGLED_OUT;
            }
            self.alone_for = self.alone_for.saturating_add(1);
            if f64::from(self.alone_for) > 2.0 * SINGLED_OUT {
                for k in 0..FIBRES {
                    let rest = (0..FIBRES).filter(|j| *j != k);
                    if self.alone[k] < 4.0 && rest.clone().all(|j| self.alone[j] > 12.0) {
                        self.bad = others | (1 << (FIBRES * i + k));
                        self.alone = [0.0; FIBRES];
                        self.alone_for = 0;
                        return;
                    }
                }
            }
            return;
        }
        self.alone_for = 0;
    }

    /// How badly a set of gratings fits without these; smaller is better.
    pub(super) fn unlikely(
        &self,
        state: &State,
        shifts: &[[f64; FIBRES]; SECTIONS],
        bad: Set,
    ) -> f64 {
        let m = self.interrogator.moments(shifts, bad);
        let said = self.say(state, &m);
        if !(m.usable[0] || m.usable[1]) {
            return f64::INFINITY;
        }
        said.misfit + said.jump + Self::far(state, &said)
    }

    /// Two peaks whose change of places explains why a reading does not fit.
    #[inline(never)]
    pub(super) fn search_swap(
        &self,
        state: &State,
        shifts: &[[f64; FIBRES]; SECTIONS],
        bad: Set,
    ) -> Option<Swap> {
        let (mut best, mut second, mut which) = (f64::INFINITY, f64::INFINITY, None);
        for section in 0..2 {
            if bad & of_section(section) != 0 {
                continue;
            }
            for stays in 0..FIBRES {
                let swap = Swap { section, stays };
                let back = self.interrogator.shifts_back(swap, shifts);
                let found = self.unlikely(state, &back, bad);
                if found < best {
                    second = best;
                    best = found;
                    which = Some(swap);
                } else if found < second {
                    second = found;
                }
            }
        }
        if best < FAILS / 2.0 && second > best + 12.0 {
            which
        } else {
            None
        }
    }

    /// The gratings that explain why a reading does not fit: one, or all of a section.
    #[inline(never)]
    pub(super) fn search(
        &self,
        state: &State,
        shifts: &[[f64; FIBRES]; SECTIONS],
        bad: Set,
        odd: Option<usize>,
        slowly: bool,
    ) -> Option<Set> {
        if odd == Some(2) || (slowly && odd.is_some()) {
            return odd.map(of_section);
        }
        let (mut best, mut second, mut which) = (f64::INFINITY, f64::INFINITY, 0);
        for i in 0..2 {
            if odd.is_some_and(|o| o != i) || bad & of_section(i) != 0 {
                continue;
            }
            for k in 0..FIBRES {
                let set = 1 << (FIBRES * i + k);
                let found = self.unlikely(state, shifts, bad | set);
                if found < best {
                    second = best;
                    best = found;
                    which = set;
                } else if found < second {
                    second = found;
                }
            }
        }
        if best < FAILS && second > best + 12.0 {
            return Some(which);
        }
        let lost = [0, 1].map(|i| self.unlikely(state, shifts, bad | of_section(i)));
        match odd {
            Some(i) => Some(of_section(i)),
            None if lost[0] < FAILS && lost[1] > FAILS => Some(of_section(0)),
            None if lost[1] < FAILS && lost[0] > FAILS => Some(of_section(1)),
            None => None,
        }
    }
}
