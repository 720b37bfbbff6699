//! Which reading, and which grating, not to believe.
//!
//! A reading is doubted where the sections' means do not agree, where its moments do not point one way, or where the
//! depth they tell is far from the one expected. Then it is asked what would explain it: two peaks that changed places,
//! one grating that lies, a section. Where nothing does it is refused a few times; then it is the state that is wrong.

use super::interrogator::{Agreement, BELIEVED, Set, Shifts, Swap, of_section};
use super::moments::Moments;
use super::reading::Said;
use super::{Look, ToolFilter};
use crate::tool::filters::Status;
use crate::tool::sensing::FIBRES;

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
/// What a force may jump whatever its pace, mN, and of its size.
const JUMP_MN: f64 = 1.0;
const JUMP_SHARE: f64 = 0.05;

impl ToolFilter {
    /// Folds in a reading at the state's time.
    #[inline]
    pub(super) fn fold(&mut self, w: &Shifts) -> Status {
        let put_back;
        let w = if let Some(swap) = self.watch.swapped {
            put_back = swap.put_back(w);
            &put_back
        } else {
            w
        };
        let (shifts, silent) = self.interrogator.look(w);
        let agreement = self.interrogator.agree(&shifts, silent, self.watch.bad);
        if silent | self.watch.silent | self.watch.bad == 0
            && self.watch.swapped.is_none()
            && agreement.odd.is_none()
        {
            let moments = self.gains.moments(&shifts);
            let said = self.say(&moments);
            if !(said.crossed() || said.far() > FAILS) {
                self.watch.streak = 0;
                self.watch.refused = 0;
                self.watch.look = Look {
                    misfit: said.misfit,
                    faulty: 0,
                };
                return self.take(&moments, &said);
            }
        }
        self.doubt(&shifts, silent, agreement)
    }

    /// The same where something does not fit, or did not.
    #[inline(never)]
    fn doubt(&mut self, shifts: &Shifts, silent: Set, agreement: Agreement) -> Status {
        self.state.lean(&self.shaft, self.clearance_mm);
        let mut shifts = *shifts;
        let bad = silent | self.watch.bad;
        self.watch.silent = silent;
        let mut moments = self.moments(&shifts, bad);
        let mut said = self.say(&moments);
        let mut faulty = bad | self.watch.swapped.map_or(0, Swap::set);
        let odd = agreement.odd.filter(|i| bad & of_section(*i) == 0);
        let crossed = said.crossed();
        let doubtful = odd.is_some() || crossed || said.far() > FAILS;
        if self.watch.bad != 0 {
            self.again(&shifts, silent, agreement.odd.is_some());
            self.single_out(&shifts, silent);
        }
        let mut trusted = true;
        let swap = if doubtful && odd.is_none() {
            self.search_swap(&shifts, bad)
        } else {
            None
        };
        if let Some(swap) = swap {
            faulty |= swap.set();
            self.suspect(swap.set());
            shifts = self.interrogator.shifts_back(swap, &shifts);
            if self.watch.streak >= SURE {
                // a second change of the same two puts them right
                self.watch.swapped = if self.watch.swapped == Some(swap) {
                    None
                } else {
                    Some(swap)
                };
                self.watch.streak = 0;
                self.interrogator.forget();
                self.back(false);
            }
            moments = self.moments(&shifts, bad);
            said = self.say(&moments);
            self.watch.refused = 0;
        } else if doubtful {
            if let Some(set) = self.search(&shifts, bad, odd, agreement.slowly) {
                faulty |= set;
                self.suspect(set);
                if self.watch.streak >= SURE || agreement.slowly {
                    self.watch.bad |= set;
                    if agreement.slowly {
                        self.watch.crept |= set;
                    }
                    self.watch.streak = 0;
                    self.interrogator.forget();
                    self.back(agreement.slowly);
                }
                moments = self.moments(&shifts, faulty);
                said = self.say(&moments);
                let sure = self.watch.bad & set == set;
                // two that lie at once: what is left must not leap
                let leaps = !sure && self.jump(&said) > FAILS;
                if !sure {
                    // while it is only suspected, the force may be what it was
                    let leap = said.way * said.size - self.state.force();
                    said.noise += leap.norm_squared() / 2.0;
                }
                self.watch.refused = if leaps {
                    self.watch.refused.saturating_add(1)
                } else {
                    0
                };
                trusted = self.watch.refused == 0 || self.watch.refused > PATIENCE_ALONE;
            } else {
                self.watch.refused = self.watch.refused.saturating_add(1);
                trusted = self.watch.refused > if crossed { PATIENCE } else { PATIENCE_ALONE };
            }
        } else {
            self.watch.streak = 0;
            self.watch.refused = 0;
        }
        self.watch.look = Look {
            misfit: said.misfit,
            faulty,
        };
        if moments.none() {
            return Status::NOT_FINITE;
        }
        if !trusted {
            return Status::GATED;
        }
        self.take(&moments, &said)
    }

    /// The moments without the bad gratings.
    fn moments(&self, shifts: &Shifts, bad: Set) -> Moments {
        if bad == 0 {
            self.gains.moments(shifts)
        } else {
            self.gains.moments_without(shifts, bad)
        }
    }

    /// Counts how often in a row the same gratings were suspected.
    fn suspect(&mut self, set: Set) {
        self.watch.streak = if self.watch.suspects == set {
            self.watch.streak + 1
        } else {
            1
        };
        self.watch.suspects = set;
    }

    /// Whether what is held to be bad is in order again. What crept away has let go, and comes back by chance alone: one
    /// reading does not show it.
    pub(super) fn again(&mut self, shifts: &Shifts, silent: Set, odd: bool) {
        if self.watch.bad == self.watch.crept {
            return;
        }
        let said = self.say(&self.moments(shifts, silent));
        let held = self.watch.bad & silent != 0;
        if odd || held || said.crossed() || said.far() > FAILS {
            self.watch.good = 0;
        } else {
            self.watch.good += 1;
            if self.watch.good >= BELIEVED {
                self.watch.bad = self.watch.crept;
                self.watch.good = 0;
            }
        }
    }

    /// In a section that was lost for a drift: the one grating without which the others fit for a while.
    pub(super) fn single_out(&mut self, shifts: &Shifts, silent: Set) {
        for i in 0..2 {
            let all = of_section(i);
            if self.watch.bad & all != all || silent & all != 0 {
                continue;
            }
            let others = self.watch.bad & !all;
            let mut alone = self.watch.alone;
            for (k, misfit) in alone.iter_mut().enumerate() {
                let found = self.unlikely(shifts, others | silent | (1 << (FIBRES * i + k)));
                let held = if found < 4.0 * FAILS {
                    found
                } else {
                    4.0 * FAILS
                };
                *misfit += (held - *misfit) / SINGLED_OUT;
            }
            self.watch.alone = alone;
            self.watch.alone_for = self.watch.alone_for.saturating_add(1);
            if f64::from(self.watch.alone_for) > 2.0 * SINGLED_OUT {
                // by iterators: an index would keep its check on some processors, and with it a path to a panic
                let is_lone = |k: usize| {
                    let mut each = alone.iter().enumerate();
                    each.all(|(j, misfit)| {
                        if j == k {
                            *misfit < 4.0
                        } else {
                            *misfit > 12.0
                        }
                    })
                };
                if let Some(k) = (0..FIBRES).find(|k| is_lone(*k)) {
                    self.watch.bad = others | (1 << (FIBRES * i + k));
                    self.watch.crept &= self.watch.bad;
                    self.watch.alone = [0.0; FIBRES];
                    self.watch.alone_for = 0;
                    return;
                }
            }
            return;
        }
        self.watch.alone_for = 0;
    }

    /// How badly a set of gratings fits without these; smaller is better.
    pub(super) fn unlikely(&self, shifts: &Shifts, bad: Set) -> f64 {
        let m = self.moments(shifts, bad);
        if m.none() {
            return f64::INFINITY;
        }
        let said = self.say(&m);
        said.misfit + self.jump(&said) + said.far()
    }

    /// Square of the jump of the force over what it may jump.
    fn jump(&self, said: &Said) -> f64 {
        let s = &self.state;
        let moved = said.way * said.size - s.force();
        let sized = JUMP_SHARE * said.size;
        let waited = s.time_s - s.felt.time_s;
        let gives = self.would_give(s);
        let strayed = self
            .pace
            .strayed(s, waited, gives, self.drift.per_second)
            .mean();
        moved.norm_squared() / (said.noise + strayed + JUMP_MN * JUMP_MN + sized * sized)
    }

    /// Two peaks whose change of places explains why a reading does not fit.
    #[inline(never)]
    pub(super) fn search_swap(&self, shifts: &Shifts, bad: Set) -> Option<Swap> {
        let (mut best, mut second, mut which) = (f64::INFINITY, f64::INFINITY, None);
        for section in 0..2 {
            if bad & of_section(section) != 0 {
                continue;
            }
            for stays in 0..FIBRES {
                let swap = Swap { section, stays };
                let back = self.interrogator.shifts_back(swap, shifts);
                let found = self.unlikely(&back, bad);
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
        shifts: &Shifts,
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
                let found = self.unlikely(shifts, bad | set);
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
        let lost = [0, 1].map(|i| self.unlikely(shifts, bad | of_section(i)));
        match odd {
            Some(i) => Some(of_section(i)),
            None if lost[0] < FAILS && lost[1] > FAILS => Some(of_section(0)),
            None if lost[1] < FAILS && lost[0] > FAILS => Some(of_section(1)),
            None => None,
        }
    }
}

impl Said {
    /// Whether the moments do not point one way.
    fn crossed(&self) -> bool {
        self.misfit > FAILS && self.plainly
    }
}
