//! Which gratings not to believe, and so what is taken of a reading.
//!
//! Nine shifts say two moments and a warmth: what they say beyond is asked ([`Evidence`](super::evidence)). Both moments
//! must point one way; depth and force must be those that the motion of the tool foresees. A reading that fails is looked
//! at under every hypothesis ([`Believed`]), until the evidence of one leads. Meanwhile a reading is taken as it fits, or
//! refused; where nothing explains it, it is the state that is wrong: another hole.

use super::evidence::{BENT_MM, COMPARED, FAILS, FARTHEST_NM, MOST, UNLIKE_NM, counts, weighed};
use super::hypotheses::{ALL, Believed, FIBRE, HYPOTHESES, of_swap};
use super::moments::{Moments, Set, Shifts};
use super::reading::Said;
use super::start::ToolFilter;
use super::state::{State, TURN};
use super::status::{Look, Status};
use crate::numbers::math::sqrt;

/// Evidence from which a hypothesis is held, and by how much it must lead.
const HELD: f64 = 80.0;
const LEADS: f64 = 40.0;
/// What is left of the evidence after a reading in order.
const FADES: f64 = 0.98;
/// Readings in a row over which it leads before it is held: a single wild one is no fault.
const SURE: u16 = 5;
/// A set of more gratings is held only where it does better by this for each.
const LARGER: f64 = 12.0;
/// Readings in a row that are refused before it is the state that must be wrong; the same where the gratings agree.
const PATIENCE: u16 = 60;
const PATIENCE_ALONE: u16 = 20;
/// Readings in a row in order before gratings are believed again.
const BELIEVED: u16 = 200;
/// Square over its variance up to which a comparison is in order, all of them in every reading.
const IN_ORDER: f64 = 12.0;
/// What a force may jump whatever its pace, mN, and of its size.
const JUMP_MN: f64 = 1.0;
const JUMP_SHARE: f64 = 0.06;
/// A bend, as a fibre's shift, in which fibres that slip show, nm.
const SHOWS_NM: f64 = 0.1;
/// The memory of the regression on slips, s, and differences of means that no slip makes, nm.
const REGRESSED_S: f64 = 10.0;
const WILD_NM: f64 = 0.15;

/// What a reading says under a hypothesis.
struct Seen {
    moments: Moments,
    said: Said,
    /// Squares over variances less their number.
    score: f64,
    /// Whether a comparison fails that no state makes.
    fails: bool,
}

impl ToolFilter {
    /// How much sections I and II are bent, as a fibre's shift, nm.
    #[inline]
    fn bends(&self, m: &Moments) -> [f64; 2] {
        let per = sqrt(self.gratings.noise);
        [0, 1].map(|i| sqrt(m.m[i].norm_squared() / self.variances[i]) * per)
    }

    #[inline]
    fn moments(&self, shifts: &Shifts, b: Believed) -> Moments {
        let known = &self.state.known;
        let m = if b.bad.trailing_zeros() >= 6 {
            self.gratings.of_all(shifts)
        } else {
            self.gratings.without(shifts, b.bad, b.warm)
        };
        m.less(known.offsets(), known.x[TURN])
    }

    /// Folds in a reading at the state's time.
    #[inline]
    pub(super) fn fold(&mut self, w: &Shifts) -> Status {
        let (shifts, silent) = self.evidence.look(w);
        if silent == ALL {
            self.watch.look.faulty = silent;
            return Status::NOT_FINITE;
        }
        self.before = self.state.known;
        let elapsed = self.state.time_s - self.evidence.at_s;
        self.evidence.at_s = self.state.time_s;
        if silent == 0 && self.evidence.calm > 0 {
            self.regress(&shifts, elapsed);
        }
        let mut b = self.evidence.held;
        b.bad |= silent;
        let put_back = self.evidence.put_back(&shifts, b.swap);
        let m = self.moments(&put_back, b);
        let bends = self.bends(&m);
        let (off, size) = self
            .evidence
            .compared(&put_back, &m, b, self.state.l(), bends, 1.0);
        let wild = weighed(&off, &size).1;
        if !wild {
            self.evidence.keep(&shifts, bends, self.state.l());
        }
        let agrees = !wild && !self.over_time(b).1;
        let warm = (m.means_nm[0] + m.means_nm[1]) * 0.5;
        self.warmth.pass(warm, &mut self.state.known);
        let said = self.say(&self.state, &m);
        self.watch.look = Look {
            misfit: said.misfit,
            faulty: b.faulty(),
        };
        if agrees
            && self.evidence.calm == 0
            && b == Believed::default()
            && !said.crossed()
            && said.far() <= FAILS
        {
            self.evidence.refused = 0;
            return self.take(&m, &said);
        }
        self.doubt(&shifts, silent, b, &m, &said, agrees)
    }

    /// The same where something does not fit, or did not.
    #[inline(never)]
    fn doubt(
        &mut self,
        shifts: &Shifts,
        silent: Set,
        b: Believed,
        m: &Moments,
        said: &Said,
        agrees: bool,
    ) -> Status {
        if self.evidence.held != Believed::default() {
            self.forgive(shifts, silent);
        }
        let mut here = self.state;
        here.lean(&self.shaft);
        let now = self.seen(&here, &self.evidence.put_back(shifts, b.swap), b, m, said);
        let doubtful = !agrees || now.fails || now.said.far() > FAILS;
        if doubtful {
            self.evidence.calm = BELIEVED;
        } else {
            self.evidence.refused = 0;
            if self.evidence.calm > 0 && self.shows(&now.said, &now.moments) {
                self.evidence.calm -= 1;
                if self.evidence.calm == 0 {
                    self.evidence.calmed();
                }
            }
        }
        if !doubtful {
            // what is in order tells nothing of what would be better, and nothing at all where nothing shows
            if self.shows(&now.said, &now.moments) {
                for sum in &mut self.evidence.sums {
                    *sum *= FADES;
                }
            }
            return self.take(&now.moments, &now.said);
        }
        let best = self.weigh(&here, shifts, b, &now);
        let mut used = now;
        let mut open = used.fails || used.said.far() > FAILS;
        if let Some((h, seen)) = best {
            let of = b.and(Believed::of(h));
            let told = self.evidence.leads(h, LEADS / 4.0);
            if told {
                self.watch.look.faulty |= of.faulty();
                self.watch.look.misfit = seen.said.misfit;
                used = seen;
                open = used.fails || used.said.far() > FAILS;
            }
            let sure = self.evidence.sums.get(h).is_some_and(|sum| *sum > HELD)
                && self.evidence.leads(h, LEADS);
            self.evidence.leads_for = if sure && self.evidence.leader == h {
                self.evidence.leads_for + 1
            } else {
                0
            };
            self.evidence.leader = h;
            if self.evidence.leads_for >= SURE {
                self.evidence.held = self.evidence.held.and(Believed::of(h));
                self.evidence.calmed();
                self.evidence.calm = BELIEVED;
                self.evidence.good = 0;
            }
        }
        if open {
            self.evidence.refused = self.evidence.refused.saturating_add(1);
            let alone = agrees && !used.fails;
            let patience = if alone { PATIENCE_ALONE } else { PATIENCE };
            if self.evidence.refused <= patience {
                return Status::GATED;
            }
            if alone {
                // no fault explains it: references that crept unseen, or another hole
                if let Some((mm, row, seen)) = &mut used.said.off {
                    self.creep.doubt(&mut self.state.known);
                    self.state.known.forget_depth(*mm * *mm + seen.total);
                    *seen = self.state.known.see(row);
                }
                self.evidence.calmed();
            }
        }
        self.take(&used.moments, &used.said)
    }

    /// The comparisons of the means over the last readings: they are as linear as those of one.
    #[inline]
    fn over_time(&self, b: Believed) -> (f64, bool) {
        let shifts = self.evidence.put_back(&self.evidence.slow, b.swap);
        let m = self.moments(&shifts, b);
        let bends = self.evidence.slow_bends.map(sqrt);
        let count = self.evidence.slow_count.max(1.0);
        let (off, size) = self
            .evidence
            .compared(&shifts, &m, b, self.state.l(), bends, count);
        weighed(&off, &size)
    }

    /// What a reading says, and how well it fits.
    fn seen(
        &self,
        here: &State,
        shifts: &Shifts,
        b: Believed,
        moments: &Moments,
        said: &Said,
    ) -> Seen {
        let (off, size) =
            self.evidence
                .compared(shifts, moments, b, self.state.l(), self.bends(moments), 1.0);
        let (now, at_once) = weighed(&off, &size);
        let (slow, over_time) = self.over_time(b);
        let (mut score, fails) = (now + slow, said.crossed() || at_once || over_time);
        score += if said.noise > 0.0 {
            self.jump(here, said).min(MOST)
        } else {
            MOST
        };
        if moments.whole[0] && moments.whole[1] {
            score += counts(said.misfit);
        }
        if let Some((mm, _, seen)) = &said.off {
            let total = seen.total - said.lasting;
            score += if total > 0.0 {
                counts(mm * mm / total)
            } else {
                MOST
            };
        }
        Seen {
            moments: *moments,
            said: *said,
            score,
            fails,
        }
    }

    /// Square of the jump of the force over what it may jump.
    fn jump(&self, here: &State, said: &Said) -> f64 {
        let jump = (said.way * said.size - here.force()).norm_squared();
        let own = JUMP_SHARE * said.size;
        let moved = sqrt((here.aside - self.state.aside).norm_squared());
        let stray = self
            .pace
            .strayed(here, self.felt.as_ref(), moved, here.gives(&self.shaft));
        jump / (2.0 * (said.noise + stray + JUMP_MN * JUMP_MN) + own * own)
    }

    /// Adds up the evidence; the hypothesis with most of it, and what the reading says under it.
    fn weigh(
        &mut self,
        here: &State,
        shifts: &Shifts,
        b: Believed,
        now: &Seen,
    ) -> Option<(usize, Seen)> {
        let mut best: Option<(usize, Seen)> = None;
        let mut most = 0.0;
        for h in 0..HYPOTHESES {
            let more = Believed::of(h);
            let overlaps = more.swap.is_some() && of_swap(more.swap) & b.bad != 0;
            let of = b.and(more);
            let mut sum = self.evidence.sums.get(h).copied().unwrap_or(0.0);
            if overlaps || more.within(b) {
                sum = 0.0;
            } else {
                let put_back = self.evidence.put_back(shifts, of.swap);
                let moments = self.moments(&put_back, of);
                let said = self.say(&self.state, &moments);
                let seen = self.seen(here, &put_back, of, &moments, &said);
                sum += now.score - seen.score - 0.5;
                if !(sum > 0.0) {
                    sum = 0.0;
                }
                let counts = sum - LARGER * f64::from(more.size());
                if counts > most {
                    most = counts;
                    best = Some((h, seen));
                }
            }
            if let Some(kept) = self.evidence.sums.get_mut(h) {
                *kept = sum;
            }
        }
        best
    }

    /// Looks for a fibre that slips.
    fn regress(&mut self, shifts: &Shifts, elapsed_s: f64) {
        let m = self.moments(shifts, Believed::default());
        let size = self.bends(&m);
        if !(self.state.l() > BENT_MM && size[0] < FARTHEST_NM && elapsed_s < REGRESSED_S) {
            return;
        }
        let p = [0, 1].map(|i| {
            let of = |k: usize| self.gratings.answers[i][k].dot(&m.m[i]);
            [of(0), of(1), of(2)]
        });
        let [a, b, c] = shifts[2];
        let [one, two, _] = m.means_nm;
        let d = [one - two, (a + b + c) / 3.0 - 0.5 * (one + two)];
        // false for NaN, and for a wild reading
        if !(d[0].abs() < WILD_NM && d[1].abs() < WILD_NM) {
            return;
        }
        self.evidence.slips.add(1.0 - elapsed_s / REGRESSED_S, d, p);
        let noise = self.evidence.own + UNLIKE_NM * UNLIKE_NM;
        if let Some(k) = self.evidence.slips.slipping(noise) {
            let found = Believed::of(FIBRE + k);
            if self.evidence.held.bad & found.bad != found.bad {
                self.evidence.held = found;
                self.evidence.calmed();
                self.evidence.calm = BELIEVED;
            }
            self.evidence.good = 0;
        }
    }

    /// Whether a fault would show: where nothing bends, or the witness is bent, it does not.
    fn shows(&self, said: &Said, m: &Moments) -> bool {
        said.touched && self.bends(m).iter().any(|b| *b > SHOWS_NM) && self.state.l() > BENT_MM
    }

    /// Whether what is held to be bad is in order again.
    fn forgive(&mut self, shifts: &Shifts, silent: Set) {
        let b = Believed {
            bad: silent,
            ..Believed::default()
        };
        let m = self.moments(shifts, b);
        let said = self.say(&self.state, &m);
        let (off, size) =
            self.evidence
                .compared(shifts, &m, b, self.state.l(), self.bends(&m), 1.0);
        let mut here = self.state;
        here.lean(&self.shaft);
        let mut good = !self.over_time(b).1
            && self.jump(&here, &said) < IN_ORDER
            && !said.crossed()
            && said.far() <= IN_ORDER
            && self.evidence.held.bad & silent == 0;
        for k in 0..COMPARED {
            good &= off[k] * off[k] <= IN_ORDER * size[k];
        }
        let shows = self.shows(&said, &m);
        if !good {
            self.evidence.good = 0;
        } else if shows {
            self.evidence.good += 1;
        }
        if self.evidence.good >= BELIEVED {
            self.evidence.held = Believed::default();
            self.evidence.calmed();
            self.evidence.good = 0;
        }
    }
}

impl Said {
    /// Whether the moments do not point one way.
    pub(super) fn crossed(&self) -> bool {
        self.misfit > FAILS && self.plainly
    }
}
