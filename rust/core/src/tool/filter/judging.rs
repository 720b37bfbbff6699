//! Which gratings not to believe.
//!
//! Nine shifts say two moments and a warmth. Beyond that the means of the sections, freed of what bends leave in them (that is
//! calibrated), must agree, and section III must show no bend but that of a force at the tip. These alone accuse: a depth or
//! a force that is far off never does. A reading that fails is looked at under every hypothesis, until the evidence of one
//! leads (Page's cumulative sum, *Biometrika* 41, 1954); one that leads for long is held until, without
//! it, all is in order again.

use super::ToolFilter;
use super::moments::{GRATINGS, Moments, Shifts, of_section, tells};
use super::offsets::{APART_NM, PLAY_NM2};
use super::reading::{Said, say};
use super::slips::Slips;
use super::state::{L, OFFSETS, State, TURN};
use super::tip::DEEP_MM;
use super::watch::HYPOTHESES;
use crate::tool::sensing::FIBRES;
use crate::tool::status::{Set, Status};

const ALL: Set = (1 << GRATINGS) - 1;
/// A square over its variance that fails, the most that one counts, and what one that does not counts for a hypothesis
/// that lets it stand (Occam); up to which it is in order.
const FAILS: f64 = 36.0;
const MOST: f64 = 60.0;
const PASSES: f64 = 4.0;
const IN_ORDER: f64 = 12.0;
/// What bends may leave in the means, over the bend, beside what the calibration says; what a force at the tip makes, nm.
const LEAVES: f64 = 0.008;
const TIP_NM: f64 = 0.01;
/// By how much the evidence of one must lead, and where the other leaves out all that it does and more; from which on it is
/// held, and by how much it must lead then, for how many readings in a row; what is left of it after a reading in order.
const LEADS: f64 = 10.0;
const HELD: f64 = 80.0;
const LEADS_SURELY: f64 = 40.0;
const SURE: u16 = 5;
const LEADS_WIDER: f64 = 80.0;
const FADES: f64 = 0.98;
/// Readings in a row that are refused before they are taken: then it is another hole, or references have crept unseen, nm.
const PATIENCE: u16 = 20;
const UNSEEN_NM: f64 = 5e-3;
/// What a force may jump whatever its pace, mN, and of its size.
const JUMP_MN: f64 = 1.0;
const JUMP_SHARE: f64 = 0.06;
/// Readings of bending for which a fibre is suspected of slipping; a bend in which it shows, squared, nm²; the memory of the
/// regression, s, and differences of means that no slip makes, nm.
const SUSPECTED: u16 = 200;
const SHOWS_NM2: f64 = 0.01;
const REGRESSED_S: f64 = 10.0;
const WILD_NM: f64 = 0.15;

/// What a hypothesis leaves out.
fn hypothesis(h: usize) -> Set {
    match h {
        0..GRATINGS => 1 << h,
        9..12 => 0b1_001_001 << (h - GRATINGS),
        _ => 1 << (h - FIBRES),
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
    fn moments(&self, shifts: &Shifts, out: Set) -> Moments {
        let x = &self.state.x;
        self.gratings
            .read(shifts, out, &x[OFFSETS..OFFSETS + 4], x[TURN])
    }

    /// What they say beside the state.
    #[inline]
    fn say(&self, m: &Moments) -> Said {
        let (t, g) = (&self.trusted, &self.gratings);
        say(t, &self.shaft, g, &self.tip, &self.offsets, &self.state, m)
    }

    /// Squares of the comparisons over their variances: means of I and II, of III and both, two bends of III, none where a
    /// grating of them is left out.
    #[inline]
    fn compared(&self, shifts: &Shifts, m: &Moments, out: Set) -> [f64; 4] {
        let (d, g, mut told) = (&self.trusted.doubt, &self.gratings, [f64::NAN; 4]);
        let [one, two, _] = m.means_nm;
        let warm = 0.5 * (one + two) * d.unlike;
        let own =
            (g.noise + d.reference_nm * d.reference_nm + APART_NM * APART_NM + warm * warm) / 3.0;
        let (share, bends) = (d.mean * d.mean + LEAVES * LEAVES, g.bends(m));
        let by_bend = [0, 1].map(|i| share * self.offsets.bent[i].max(bends[i]));
        let whole = [tells(out, 0), tells(out, 1)];
        if whole[0] && whole[1] {
            told[0] = (one - two) * (one - two) / (2.0 * own + by_bend[0] + by_bend[1]);
        }
        if !(self.state.x[L] > DEEP_MM) {
            return told;
        }
        let [p, q, r] = shifts[2];
        let (mean, across, twice) = match !of_section(out, 2) & 0b111 {
            0b111 => ((p + q + r) / 3.0, q - r, 2.0 * p - q - r),
            0b110 => (0.5 * (q + r), q - r, f64::NAN),
            0b101 => (0.5 * (p + r), p - r, f64::NAN),
            0b011 => (0.5 * (p + q), p - q, f64::NAN),
            _ => return told,
        };
        let others = whole.map(|x| f64::from(u8::from(x)));
        let some = others[0] + others[1];
        if some > 0.0 && out >> (GRATINGS + 2) == 0 {
            let both = (others[0] * one + others[1] * two) / some;
            let spread = (others[0] * by_bend[0] + others[1] * by_bend[1]) / (some * some);
            told[1] = (mean - both) * (mean - both) / (2.0 * own + spread);
        }
        // a hole that passed over glue with play has left a bend
        let left = TIP_NM * TIP_NM + self.offsets.lag * PLAY_NM2;
        let own = 3.0 * own + (mean * d.unlike) * (mean * d.unlike) + left;
        (told[2], told[3]) = (across * across * 0.5 / own, twice * twice / 6.0 / own);
        told
    }

    /// How badly a reading fits, and whether means fail.
    fn misfits(
        &self,
        here: &State,
        shifts: &Shifts,
        out: Set,
        m: &Moments,
        said: &Said,
    ) -> (f64, bool) {
        let told = self.compared(shifts, m, out);
        let jump = (said.way * said.size - here.way * here.size).norm_squared();
        let own = JUMP_SHARE * said.size;
        let may = 2.0
            * (said.noise
                + self
                    .edge
                    .strayed(self.felt.as_ref(), &self.shaft, &self.state, here)
                + JUMP_MN * JUMP_MN)
            + own * own;
        // the most for NaN
        let mut score = (jump / may).min(MOST);
        for x in told.into_iter().filter(|x| !x.is_nan()) {
            score += counts(x);
        }
        (score, told.iter().any(|x| *x > FAILS))
    }

    /// Folds in a reading at the state's time.
    #[inline]
    pub(super) fn fold(&mut self, w: &Shifts) -> Status {
        let elapsed = self.state.time_s - self.watch.at_s;
        self.watch.at_s = self.state.time_s;
        let elapsed = if elapsed.is_finite() { elapsed } else { 0.0 };
        let reference = &self.trusted.calibration.reference_nm;
        let (shifts, silent) = self.watch.look(w, reference, elapsed);
        let out = self.watch.held | silent;
        self.look.faulty = (out | self.watch.misplaced()) & ALL;
        if silent == ALL {
            return Status::NOT_FINITE;
        }
        let (d, g, whole) = (&self.trusted.doubt, &self.gratings, tells(out, 2));
        let deep = self.state.x[L] > DEEP_MM;
        let (o, zero) = (&mut self.offsets, d.reference_nm);
        self.tip.feel(g, o, zero, &shifts, (whole, deep), elapsed);
        let third = whole && deep;
        let mut m = self.moments(&shifts, out);
        let told = self.compared(&shifts, &m, out);
        let mut open = told.iter().any(|x| *x > FAILS);
        if !open {
            let (o, g, s) = (&mut self.offsets, &self.gratings, &mut self.state);
            o.unsettle(s, g, self.trusted.doubt.warmth, &m, elapsed);
            if m.whole[0] && m.whole[1] {
                if !told[..2].iter().any(|x| *x > IN_ORDER) {
                    let mean = (shifts[2][0] + shifts[2][1] + shifts[2][2]) / 3.0;
                    let jitter = self.watch.jitter;
                    o.learn_lag(g, jitter, &m, third.then_some(mean), elapsed);
                }
                if !self.tip.on
                    && let Some(zero) = o.rest(s, g, &m, whole.then_some(&shifts[2]))
                {
                    self.tip.zero = zero;
                }
            }
        }
        let watched = self.watch.held != 0 || self.watch.suspects > 0;
        if watched || told.iter().any(|x| *x > IN_ORDER) {
            self.suspect(&shifts, silent, elapsed);
        }
        let mut said = self.say(&m);
        if self.felt.is_none() {
            // a first reading does not tell whether its gratings live
            said.off = None;
        }
        self.look.misfit = said.misfit;
        if open {
            (m, said, open) = self.doubt(&shifts, out, m, said);
        } else {
            let fade = |sum: f64| if sum > 1e-3 { sum * FADES } else { 0.0 };
            self.watch.sums = self.watch.sums.map(fade);
            self.watch.leads_for = 0;
        }
        let far = said.far() > FAILS;
        if !(open || far) {
            self.watch.refused = 0;
            return self.take(&said);
        }
        self.watch.refused = self.watch.refused.saturating_add(1);
        if self.watch.refused <= PATIENCE {
            return Status::GATED;
        }
        if let (Some((mm, seen)), true) = (said.off, far) {
            for k in 0..4 {
                let own = &mut self.state.p[OFFSETS + k][OFFSETS + k];
                *own = own.max(UNSEEN_NM * UNSEEN_NM * self.gratings.per_nm[k / 2]);
            }
            // the depth is known no better than this, and by itself
            for row in &mut self.state.p {
                row[L] = 0.0;
            }
            self.state.p[L] = Default::default();
            self.state.p[L][L] = mm * mm + seen.total;
            said = self.say(&m);
        }
        self.take(&said)
    }

    /// A reading whose means fail, under the hypothesis that explains it, where one leads; whether it still fails.
    #[inline(never)]
    fn doubt(
        &mut self,
        shifts: &Shifts,
        out: Set,
        m: Moments,
        said: Said,
    ) -> (Moments, Said, bool) {
        let mut here = self.state;
        here.lean(&self.shaft);
        let (base, _) = self.misfits(&here, shifts, out, &m, &said);
        let (mut best, mut most) = (None, 0.0);
        for h in 0..HYPOTHESES {
            let mut sum = 0.0;
            let of = out | hypothesis(h);
            if of != out {
                let moments = self.moments(shifts, of);
                let told = self.say(&moments);
                let (score, fails) = self.misfits(&here, shifts, of, &moments, &told);
                sum = (self.watch.sums[h] + base - score - 0.5).max(0.0);
                if sum > most {
                    (best, most) = (Some((hypothesis(h), moments, told, fails)), sum);
                }
            }
            self.watch.sums[h] = sum;
        }
        let Some((own, moments, told, fails)) = best else {
            return (m, said, true);
        };
        // a fibre does as well as its grating
        let sums = self.watch.sums;
        let leads = |by: f64| {
            (0..HYPOTHESES).all(|k| {
                let other = hypothesis(k);
                let wider = own & !other == 0;
                own == other || sums[k] + if wider { -LEADS_WIDER } else { by } < most
            })
        };
        if !leads(LEADS) {
            return (m, said, true);
        }
        let w = &mut self.watch;
        let again = most > HELD && leads(LEADS_SURELY) && w.leader == own;
        (w.leader, w.leads_for) = (own, if again { w.leads_for + 1 } else { 0 });
        if w.leads_for >= SURE {
            w.hold(w.held | own);
            w.suspects = SUSPECTED;
        }
        self.look.faulty |= own & ALL;
        self.look.misfit = told.misfit;
        (moments, told, fails)
    }

    /// Looks for a fibre that slips, and whether what is held is bad, until means agree for a while of bending.
    #[inline(never)]
    fn suspect(&mut self, shifts: &Shifts, silent: Set, elapsed_s: f64) {
        let m = self.moments(shifts, silent);
        let told = self.compared(shifts, &m, silent);
        if told.iter().any(|x| *x > IN_ORDER) {
            self.watch.suspects = SUSPECTED;
        } else if self.gratings.bends(&m)[1] > SHOWS_NM2 && self.state.x[L] > DEEP_MM {
            self.watch.suspects = self.watch.suspects.saturating_sub(1);
        }
        if self.watch.suspects == 0 {
            self.watch.slips = Slips::default();
            self.watch.hold(0);
        }
        if silent != 0 {
            return;
        }
        let keeps = 1.0 - elapsed_s / REGRESSED_S;
        let p = [0, 1].map(|i| [0, 1, 2].map(|k: usize| self.gratings.answers[i][k].dot(&m.m[i])));
        let ([a, b, c], [one, two, _]) = (shifts[2], m.means_nm);
        let apart = [one - two, (a + b + c) / 3.0 - 0.5 * (one + two)];
        // false for NaN, and for a wild reading
        let tame = apart[0].abs() < WILD_NM && apart[1].abs() < WILD_NM;
        if !(tame && self.state.x[L] > DEEP_MM && keeps > 0.0) {
            return;
        }
        self.watch.slips.add(keeps, apart, p);
        let noise = (self.gratings.noise + APART_NM * APART_NM) / 3.0;
        if let Some(k) = self.watch.slips.slipping(noise) {
            let found = hypothesis(GRATINGS + k);
            if self.watch.held & found != found {
                self.watch.hold(found);
            }
            self.watch.suspects = SUSPECTED;
        }
    }
}
