//! Which gratings not to believe.
//!
//! Nine shifts say two moments and a warmth. Beyond that the means of the sections, freed of what bends leave in them (that is
//! calibrated), must agree, and section III must show no bend but that of a force at the tip. These alone accuse: a depth or
//! a force that is far off never does. A reading that fails is looked at under every hypothesis, until the evidence of one
//! leads (Page's cumulative sum, *Biometrika* 41, 1954).

use super::moments::{Moments, Shifts, of_section};
use super::offsets::APART_NM;
use super::reading::Said;
use super::slips::Slips;
use super::start::{Believed, GRATINGS, HYPOTHESES, ToolFilter, Watch};
use super::state::{L, OFFSETS, State, TURN};
use super::tip::DEEP_MM;
use crate::tool::sensing::{FIBRES, SECTIONS};
use crate::tool::status::{Look, Set, Status};

const ALL: Set = (1 << GRATINGS) - 1;
/// No shaft is bent or warmed so far, nm; repeats of one number after which a grating is not asked.
const FARTHEST_NM: f64 = 8.0;
const REPEATS: u8 = 3;
/// Peaks that move by more at once than this may have changed places, nm; within this time, s.
const MOVED_NM: f64 = 0.08;
const AT_ONCE_S: f64 = 0.1;
/// How long noise is watched, s.
const WATCHED_S: f64 = 5.0;
/// A square over its variance that fails, the most that one counts, and what one that does not counts for a hypothesis
/// that lets it stand (Occam); up to which it is in order.
pub(super) const FAILS: f64 = 36.0;
const MOST: f64 = 60.0;
const PASSES: f64 = 4.0;
const IN_ORDER: f64 = 12.0;
/// What bends may leave in the means, over the bend, beside what the calibration says; what a force at the tip makes, nm.
const LEAVES: f64 = 0.008;
const TIP_NM: f64 = 0.01;
/// Evidence from which a hypothesis is held, and by how much it must lead; readings in a row over which it does; for how
/// much more a set of more gratings must do better; what is left of the evidence after a reading in order.
const HELD: f64 = 80.0;
const LEADS: f64 = 40.0;
const SURE: u16 = 5;
const LARGER: f64 = 12.0;
const FADES: f64 = 0.98;
/// Readings in a row that are refused before they are taken, and where the gratings agree: then it is another hole, or
/// references have crept unseen, nm.
const PATIENCE: u16 = 60;
const PATIENCE_ALONE: u16 = 20;
const UNSEEN_NM: f64 = 5e-3;
/// Readings in a row in order before gratings are believed again; a bend in which faults show, squared, nm².
const BELIEVED: u16 = 200;
const SHOWS_NM2: f64 = 0.01;
/// What a force may jump whatever its pace, mN, and of its size.
const JUMP_MN: f64 = 1.0;
const JUMP_SHARE: f64 = 0.06;
/// The memory of the regression on slips, s, and differences of means that no slip makes, nm.
const REGRESSED_S: f64 = 10.0;
const WILD_NM: f64 = 0.15;

impl Believed {
    fn of(h: usize) -> Self {
        match h {
            0..=8 => Self {
                bad: 1 << h,
                warm: 0,
            },
            9..=11 => Self {
                bad: 0b1_001_001 << (h - 9),
                warm: 0,
            },
            12 => Self {
                bad: 0b111_000_000,
                warm: 0,
            },
            _ => Self {
                bad: 0,
                warm: 1 << (h - 13),
            },
        }
    }

    fn and(self, more: Self) -> Self {
        Self {
            bad: self.bad | more.bad,
            warm: self.warm | more.warm,
        }
    }
}

impl Watch {
    /// Shifts from the reference, nm, with peaks back in their places, and the gratings that say nothing: not finite, out of
    /// all bounds, or stuck.
    #[inline]
    fn look(&mut self, w: &Shifts, reference: &Shifts, elapsed_s: f64) -> (Shifts, Set) {
        let shown = w.as_flattened();
        let mut peaks: [f64; GRATINGS] = core::array::from_fn(|k| shown[self.places[k] % GRATINGS]);
        if elapsed_s < AT_ONCE_S {
            let mut moved: [f64; GRATINGS] =
                core::array::from_fn(|k| (peaks[k] - self.last[k]).abs());
            for a in 0..GRATINGS {
                for b in a + 1..GRATINGS {
                    if !(moved[a] > MOVED_NM) {
                        continue;
                    }
                    let changed = (peaks[a] - self.last[b]).abs() + (peaks[b] - self.last[a]).abs();
                    // a bend that comes at once moves the others as well
                    let alone =
                        |k: usize| k == a || k == b || !(moved[k] > 0.25 * moved[a].min(moved[b]));
                    let swapped = changed < 0.1 * (moved[a] + moved[b]);
                    if swapped && (0..GRATINGS).all(alone) {
                        self.places.swap(a, b);
                        peaks.swap(a, b);
                        (moved[a], moved[b]) = (0.0, 0.0);
                    }
                }
            }
        }
        let (mut shifts, mut silent, mut still): (Shifts, Set, Set) =
            ([[0.0; FIBRES]; SECTIONS], 0, 0);
        for k in 0..GRATINGS {
            let shift = peaks[k] - reference[k / FIBRES][k % FIBRES];
            // false for NaN
            if shift.abs() < FARTHEST_NM {
                shifts[k / FIBRES][k % FIBRES] = shift;
            } else {
                silent |= 1 << k;
            }
            let same = peaks[k] == self.last[k];
            self.repeats[k] = if same {
                self.repeats[k].saturating_add(1)
            } else {
                0
            };
            still |= Set::from(self.repeats[k] >= REPEATS) << k;
        }
        // the difference of two that a bend moves least, from reading to reading
        let jump = (peaks[7] - self.last[7]) - (peaks[8] - self.last[8]);
        if jump.abs() < MOVED_NM && jump != 0.0 {
            self.jitter += (0.25 * jump * jump - self.jitter) * (elapsed_s / WATCHED_S).min(0.1);
        }
        self.last = peaks;
        // where all stand still it is the world, or a source that gives each reading several times
        if still.count_ones() <= 3 {
            silent |= still;
        }
        (shifts, silent)
    }

    fn calm(&mut self) {
        (self.sums, self.leads_for, self.refused, self.good) = ([0.0; HYPOTHESES], 0, 0, 0);
    }

    fn misplaced(&self) -> Set {
        (0..GRATINGS).fold(0, |set, k| set | Set::from(self.places[k] != k) << k)
    }
}

/// What a comparison counts: nothing is gained by how well it comes out, but that it does.
fn counts(square: f64) -> f64 {
    if square > FAILS {
        square.min(MOST)
    } else {
        -PASSES
    }
}

impl ToolFilter {
    #[inline]
    fn moments(&self, shifts: &Shifts, b: Believed) -> Moments {
        let x = &self.state.x;
        self.gratings
            .read(shifts, b.bad, b.warm, &x[OFFSETS..OFFSETS + 4], x[TURN])
    }

    /// Squares of the comparisons over their variances: means of I and II, of III and both, two bends of III, none where a
    /// grating of them is left out.
    #[inline]
    fn compared(&self, shifts: &Shifts, m: &Moments, b: Believed) -> [f64; 4] {
        let (d, g, mut told) = (&self.trusted.doubt, &self.gratings, [f64::NAN; 4]);
        let tells = |i: usize| of_section(b.bad, i) == 0 && b.warm & (1 << i) == 0;
        let [one, two, _] = m.means_nm;
        let warm = 0.5 * (one + two) * d.unlike;
        let own =
            (g.noise + d.reference_nm * d.reference_nm + APART_NM * APART_NM + warm * warm) / 3.0;
        let share = d.mean * d.mean + LEAVES * LEAVES;
        let bends = g.bends(m);
        let by_bend = [0, 1].map(|i| share * self.offsets.bent[i].max(bends[i]));
        if tells(0) && tells(1) {
            told[0] = (one - two) * (one - two) / (2.0 * own + by_bend[0] + by_bend[1]);
        }
        if !(self.state.x[L] > DEEP_MM) {
            return told;
        }
        let [p, q, r] = shifts[2];
        let (mean, across, twice) = match !of_section(b.bad, 2) & 0b111 {
            0b111 => ((p + q + r) / 3.0, q - r, Some(2.0 * p - q - r)),
            0b110 => (0.5 * (q + r), q - r, None),
            0b101 => (0.5 * (p + r), p - r, None),
            0b011 => (0.5 * (p + q), p - q, None),
            _ => return told,
        };
        let (both, spread) = match (tells(0), tells(1)) {
            (true, true) => (0.5 * (one + two), 0.25 * (by_bend[0] + by_bend[1])),
            (true, false) => (one, by_bend[0]),
            (false, true) => (two, by_bend[1]),
            _ => (mean, 0.0),
        };
        if (tells(0) || tells(1)) && b.warm & 0b100 == 0 {
            told[1] = (mean - both) * (mean - both) / (2.0 * own + spread);
        }
        let own = 3.0 * (own + (mean * d.unlike) * (mean * d.unlike) / 3.0) + TIP_NM * TIP_NM;
        told[2] = across * across * 0.5 / own;
        told[3] = twice.map_or(f64::NAN, |x| x * x / 6.0 / own);
        told
    }

    /// How badly a reading fits, and whether means fail.
    fn misfits(
        &self,
        here: &State,
        shifts: &Shifts,
        b: Believed,
        m: &Moments,
        said: &Said,
    ) -> (f64, bool) {
        let told = self.compared(shifts, m, b);
        let mut score: f64 = told
            .iter()
            .filter(|x| !x.is_nan())
            .map(|x| counts(*x))
            .sum();
        let jump = self.jump(here, said);
        score += if jump.is_finite() {
            jump.min(MOST)
        } else {
            MOST
        };
        (score, told.iter().any(|x| *x > FAILS))
    }

    /// Square of the jump of the force over what it may jump.
    fn jump(&self, here: &State, said: &Said) -> f64 {
        let jump = (said.way * said.size - here.way * here.size).norm_squared();
        let own = JUMP_SHARE * said.size;
        jump / (2.0 * (said.noise + self.strayed(here) + JUMP_MN * JUMP_MN) + own * own)
    }

    /// Folds in a reading at the state's time.
    #[inline]
    pub(super) fn fold(&mut self, w: &Shifts) -> Status {
        let elapsed = self.state.time_s - self.watch.at_s;
        self.watch.at_s = self.state.time_s;
        let elapsed = if elapsed.is_finite() { elapsed } else { 0.0 };
        self.watch.elapsed_s = elapsed;
        let (shifts, silent) = self
            .watch
            .look(w, &self.trusted.calibration.reference_nm, elapsed);
        if silent == ALL {
            self.look.faulty = silent;
            return Status::NOT_FINITE;
        }
        let mut b = self.watch.held;
        b.bad |= silent;
        let third = of_section(b.bad, 2) == 0 && b.warm & 0b100 == 0 && self.state.x[L] > DEEP_MM;
        self.feel_tip(&shifts, third, elapsed);
        let mut m = self.moments(&shifts, b);
        let told = self.compared(&shifts, &m, b);
        let mut open = told.iter().any(|x| *x > FAILS);
        if !open {
            self.unsettle(&m, elapsed);
            if m.whole[0] && m.whole[1] && told[0] < IN_ORDER && !(told[1] > IN_ORDER) {
                let [x, y, z] = shifts[2];
                self.learn_lag(&m, third.then_some((x + y + z) / 3.0), elapsed);
            }
            if m.whole[0] && m.whole[1] && !self.tip.on {
                self.rest(&m, third.then_some(&shifts[2]));
            }
        }
        if told.iter().any(|x| *x > IN_ORDER) || self.watch.held.bad != 0 {
            self.watch.suspects = BELIEVED;
        }
        if self.watch.suspects > 0 && silent == 0 {
            self.regress(&shifts, &m, b, elapsed);
        }
        let mut said = self.say(&self.state, &m);
        self.look = Look {
            misfit: said.misfit,
            faulty: b.bad | self.watch.misplaced(),
        };
        if open {
            (m, said, open) = self.doubt(&shifts, b, m, said);
        } else {
            self.watch.leads_for = 0;
            if self.watch.held != Believed::default() {
                self.forgive(&shifts, silent);
            }
            if self.watch.sums != [0.0; HYPOTHESES] {
                self.watch.sums = self
                    .watch
                    .sums
                    .map(|sum| if sum > 1e-3 { sum * FADES } else { 0.0 });
            }
        }
        let far = said.far() > FAILS;
        if open || far {
            self.watch.refused = self.watch.refused.saturating_add(1);
            if self.watch.refused <= if open { PATIENCE } else { PATIENCE_ALONE } {
                return Status::GATED;
            }
            if let (Some((mm, seen)), true) = (said.off, far) {
                for k in 0..4 {
                    let own = &mut self.state.p[OFFSETS + k][OFFSETS + k];
                    *own = own.max(UNSEEN_NM * UNSEEN_NM * self.gratings.per_nm[k / 2]);
                }
                self.state.forget(L, mm * mm + seen.total);
                said = self.say(&self.state, &m);
            }
        } else {
            self.watch.refused = 0;
        }
        self.take(&said)
    }

    /// A reading whose means fail, under the hypothesis that explains it, where one leads; whether it still fails.
    #[inline(never)]
    fn doubt(
        &mut self,
        shifts: &Shifts,
        b: Believed,
        m: Moments,
        said: Said,
    ) -> (Moments, Said, bool) {
        let mut here = self.state;
        here.lean(&self.shaft);
        let (base, _) = self.misfits(&here, shifts, b, &m, &said);
        let (mut best, mut most) = (None, 0.0);
        for h in 0..HYPOTHESES {
            let of = b.and(Believed::of(h));
            let mut sum = 0.0;
            if of != b {
                let moments = self.moments(shifts, of);
                let told = self.say(&self.state, &moments);
                let (score, fails) = self.misfits(&here, shifts, of, &moments, &told);
                sum = (self.watch.sums[h] + base - score - 0.5).max(0.0);
                let counts = sum - LARGER * f64::from(of.bad.count_ones() - b.bad.count_ones());
                if counts > most {
                    (best, most) = (Some((h, of, moments, told, fails)), counts);
                }
            }
            self.watch.sums[h] = sum;
        }
        let Some((h, of, moments, told, fails)) = best else {
            return (m, said, true);
        };
        // a fibre does as well as its grating
        let own = Believed::of(h).bad;
        let mine = self.watch.sums.get(h).copied().unwrap_or(0.0);
        let ahead = |by: f64, w: &Watch| {
            w.sums.iter().enumerate().all(|(k, sum)| {
                let other = Believed::of(k).bad;
                let wider = own != 0 && own & !other == 0 && own != other;
                k == h || sum + if wider { -2.0 * LEADS } else { by } < mine
            })
        };
        if !ahead(LEADS / 4.0, &self.watch) {
            return (m, said, true);
        }
        let sure = mine > HELD && ahead(LEADS, &self.watch);
        let again = sure && self.watch.leader == h;
        self.watch.leads_for = if again { self.watch.leads_for + 1 } else { 0 };
        self.watch.leader = h;
        if self.watch.leads_for >= SURE {
            self.watch.held = self.watch.held.and(Believed::of(h));
            self.watch.calm();
        }
        self.look.faulty |= of.bad;
        self.look.misfit = told.misfit;
        (moments, told, fails)
    }

    /// Looks for a fibre that slips, since means were far apart, until they are not for a while of bending.
    #[inline]
    fn regress(&mut self, shifts: &Shifts, m: &Moments, b: Believed, elapsed_s: f64) {
        let m = if b == Believed::default() {
            *m
        } else {
            self.moments(shifts, Believed::default())
        };
        let keeps = 1.0 - elapsed_s / REGRESSED_S;
        if self.gratings.bends(&m)[1] > SHOWS_NM2 {
            self.watch.suspects -= 1;
        }
        if self.watch.suspects == 0 {
            self.slips = Slips::default();
        }
        if !(self.state.x[L] > DEEP_MM && keeps > 0.0) {
            return;
        }
        let p = [0, 1].map(|i| [0, 1, 2].map(|k: usize| self.gratings.answers[i][k].dot(&m.m[i])));
        let [a, b, c] = shifts[2];
        let [one, two, _] = m.means_nm;
        let apart = [one - two, (a + b + c) / 3.0 - 0.5 * (one + two)];
        // false for NaN, and for a wild reading
        if !(apart[0].abs() < WILD_NM && apart[1].abs() < WILD_NM) {
            return;
        }
        self.slips.add(keeps, apart, p);
        let noise = (self.gratings.noise + APART_NM * APART_NM) / 3.0;
        if let Some(k) = self.slips.slipping(noise) {
            let found = Believed::of(GRATINGS + k);
            if self.watch.held.bad & found.bad != found.bad {
                self.watch.held = found;
                self.watch.calm();
            }
            self.watch.good = 0;
        }
    }

    /// Whether what is held to be bad is in order again.
    fn forgive(&mut self, shifts: &Shifts, silent: Set) {
        let b = Believed {
            bad: silent,
            warm: 0,
        };
        let m = self.moments(shifts, b);
        let said = self.say(&self.state, &m);
        let mut here = self.state;
        here.lean(&self.shaft);
        let good = self.jump(&here, &said) < IN_ORDER
            && said.far() <= IN_ORDER
            && self.watch.held.bad & silent == 0
            && !self.compared(shifts, &m, b).iter().any(|x| *x > IN_ORDER);
        if !good {
            self.watch.good = 0;
        } else if said.off.is_some()
            && self.gratings.bends(&m)[1] > SHOWS_NM2
            && self.state.x[L] > DEEP_MM
        {
            self.watch.good += 1;
        }
        if self.watch.good >= BELIEVED {
            self.watch.held = Believed::default();
            self.watch.calm();
        }
    }
}
