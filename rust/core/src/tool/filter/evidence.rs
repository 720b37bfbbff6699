//! Which gratings not to believe.
//!
//! Nine shifts say two moments and a warmth: what they say beyond is asked. The means of the sections, freed of what bends
//! leave in them (that is calibrated), must agree; section III, which nothing bends, must show no bend; both moments must
//! point one way; depth and force must be those that the motion of the tool foresees. A reading that fails is looked at
//! under every *hypothesis*: each grating, each fibre (one that is off, or that slips and answers to bends by a share),
//! section III, a section that is warmer, two peaks that changed
//! places. Evidence adds up over readings, each counted to a
//! limit (Page's cumulative sum, *Biometrika* 41, 1954), until one leads. Meanwhile a reading is taken as it fits, or
//! refused; where nothing explains it, it is the state that is wrong: another hole.

use super::known::Trusted;
use super::moments::{Moments, Set, Shifts, of_fibre, of_section};
use super::reading::Said;
use super::state::{State, TURN};
use super::status::Status;
use super::{Look, ToolFilter};
use crate::numbers::math::sqrt;
use crate::tool::sensing::{FIBRES, SECTIONS};

/// No shaft is bent or warmed so far, nm.
const FARTHEST_NM: f64 = 8.0;
/// A comparison of χ² that fails, one degree of freedom; what one counts at most.
const FAILS: f64 = 36.0;
const MOST: f64 = 60.0;
/// Evidence from which a hypothesis is held, and by how much it must lead.
const HELD: f64 = 80.0;
const LEADS: f64 = 40.0;
/// What it counts for a hypothesis that a comparison which it lets stand comes out: one in so many could (Occam).
const PASSES: f64 = 4.0;
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
/// Readings that the slow comparison looks back on.
const SLOW: f64 = 200.0;
/// Warmth of two sections differs by this, nm.
const UNLIKE_NM: f64 = 0.15e-3;
/// What a force may jump whatever its pace, mN, and of its size.
const JUMP_MN: f64 = 1.0;
const JUMP_SHARE: f64 = 0.06;
/// Section III feels a bend where the hole is nearer the tip than this, mm.
const BENT_MM: f64 = 7.0;
/// A bend, as a fibre's shift, in which fibres that slip show, nm.
const SHOWS_NM: f64 = 0.1;
/// A regression's memory, s, and least readings; the least `a` of a fibre that slips, five in a hundred; what it may leave
/// of the differences at most, and by how much more any other must.
const REGRESSED_S: f64 = 10.0;
const SLIPS: f64 = 100.0;
const WILD_NM: f64 = 0.15;
const SLIPPED: f64 = 0.017;
const EXPLAINED: f64 = 0.05;
const ALONE: f64 = 3.0;
/// Repeats of one number after which a grating is not asked.
const REPEATS: u8 = 3;

/// Hypotheses: nine gratings, three fibres, section III, three sections that are warmer than the others, six changes of
/// places.
const GRATINGS: usize = FIBRES * SECTIONS;
const ALL: Set = (1 << GRATINGS) - 1;
const FIBRE: usize = GRATINGS;
const WITNESS: usize = FIBRE + FIBRES;
const WARM: usize = WITNESS + 1;
const SWAPS: usize = WARM + SECTIONS;
const HYPOTHESES: usize = SWAPS + 2 * FIBRES;

/// Comparisons of the means.
const COMPARED: usize = 4;

/// Which fibre slips: means' differences regressed on what each fibre should show of the bend.
///
/// A fibre that answers by a share `s` less takes `-a p` from the mean of its section, where `p` is what the moments say
/// of it, distorted as they then are: `a = (s/3)/(1 - 2s/3)`. So do all sections of the fibre by one `a`; III, unbent,
/// stays. What warmth makes is the regression's constant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Slips {
    n: f64,
    d: [f64; 2],
    dd: f64,
    x: [[f64; 2]; FIBRES],
    xx: [f64; FIBRES],
    xd: [f64; FIBRES],
}

impl Slips {
    /// Differences of means (of I and II, of III and both, nm), and `p` of each fibre in sections I and II.
    fn add(&mut self, keeps: f64, d: [f64; 2], p: [[f64; FIBRES]; 2]) {
        self.n = keeps * self.n + 1.0;
        self.dd *= keeps;
        for j in 0..2 {
            self.d[j] = keeps * self.d[j] + d[j];
            self.dd += d[j] * d[j];
        }
        for k in 0..FIBRES {
            let x = [p[1][k] - p[0][k], 0.5 * (p[0][k] + p[1][k])];
            self.xx[k] *= keeps;
            self.xd[k] *= keeps;
            for j in 0..2 {
                self.x[k][j] = keeps * self.x[k][j] + x[j];
                self.xx[k] += x[j] * x[j];
                self.xd[k] += x[j] * d[j];
            }
        }
    }

    /// The fibre that slips, where one does and no other could: what it leaves of the differences is a small part of them,
    /// and of what any other leaves.
    fn slipping(&self, noise: f64) -> Option<usize> {
        if self.n < SLIPS {
            return None;
        }
        let spread = |a: [f64; 2], b: [f64; 2], ab: f64| ab - (a[0] * b[0] + a[1] * b[1]) / self.n;
        let all = spread(self.d, self.d, self.dd);
        let (mut best, mut least, mut next) = (None, f64::INFINITY, f64::INFINITY);
        for k in 0..FIBRES {
            let (xx, xd) = (
                spread(self.x[k], self.x[k], self.xx[k]),
                spread(self.x[k], self.d, self.xd[k]),
            );
            let left = if xd > SLIPPED * xx && xx > 0.0 {
                all - xd * xd / xx
            } else {
                all
            };
            if left < least {
                (best, least, next) = (Some(k), left, least);
            } else if left < next {
                next = left;
            }
        }
        let least = least.max(0.0) + 2.0 * noise * self.n;
        if least < EXPLAINED * all && next > ALONE * least {
            best
        } else {
            None
        }
    }
}

/// What was seen of the gratings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Evidence {
    reference_nm: Shifts,
    /// Variances of a mean: noise; what references are off; warmth (by its square) and bends (by theirs).
    own: f64,
    reference: f64,
    by_warmth: f64,
    by_bend: f64,
    last: Shifts,
    repeats: [u8; GRATINGS],
    /// Means over the last readings: shifts, and what a bend leaves in the means, squared.
    slow: Shifts,
    slow_bends: [f64; 2],
    slow_count: f64,
    /// Time of the last reading, s.
    at_s: f64,
    /// Evidence against the readings as they are, for each hypothesis.
    sums: [f64; HYPOTHESES],
    slips: Slips,
    leader: usize,
    leads_for: u16,
    held: Believed,
    good: u16,
    refused: u16,
    calm: u16,
}

/// What a reading says under a hypothesis.
struct Seen {
    moments: Moments,
    said: Said,
    /// Squares over variances less their number.
    score: f64,
    /// Whether a comparison fails that no state makes.
    fails: bool,
}

impl Evidence {
    pub(super) fn new(t: &Trusted) -> Self {
        let noise = t.calibration.noise_nm * t.calibration.noise_nm;
        let reference = t.doubt.reference_nm * t.doubt.reference_nm;
        Self {
            reference_nm: t.calibration.reference_nm,
            own: noise / 3.0,
            reference: reference / 3.0,
            by_warmth: t.doubt.unlike * t.doubt.unlike / 3.0,
            by_bend: t.doubt.mean * t.doubt.mean,
            last: [[f64::NAN; FIBRES]; SECTIONS],
            repeats: [0; GRATINGS],
            slow: [[0.0; FIBRES]; SECTIONS],
            slow_bends: [0.0; 2],
            slow_count: 0.0,
            at_s: f64::NEG_INFINITY,
            sums: [0.0; HYPOTHESES],
            slips: Slips::default(),
            leader: 0,
            leads_for: 0,
            held: Believed::default(),
            good: 0,
            refused: 0,
            calm: 0,
        }
    }

    /// Nothing is suspected any more.
    fn calmed(&mut self) {
        self.sums = [0.0; HYPOTHESES];
        self.slow_count = 0.0;
        self.leads_for = 0;
        self.refused = 0;
        self.calm = 0;
    }

    /// Shifts from the reference, nm, and the gratings that say nothing: not finite, out of all bounds, or stuck.
    #[inline]
    fn look(&mut self, w: &Shifts) -> (Shifts, Set) {
        let (mut shifts, mut silent, mut still): (Shifts, Set, Set) =
            ([[0.0; FIBRES]; SECTIONS], 0, 0);
        for i in 0..SECTIONS {
            for k in 0..FIBRES {
                let (at, shift) = (FIBRES * i + k, w[i][k] - self.reference_nm[i][k]);
                // false for NaN
                if shift.abs() < FARTHEST_NM {
                    shifts[i][k] = shift;
                } else {
                    silent |= 1 << at;
                }
                let same = w[i][k] == self.last[i][k];
                self.repeats[at] = if same {
                    self.repeats[at].saturating_add(1)
                } else {
                    0
                };
                if self.repeats[at] >= REPEATS {
                    still |= 1 << at;
                }
            }
        }
        self.last = *w;
        // where all stand still it is the world, or a source that gives each reading several times
        if still.count_ones() <= 3 {
            silent |= still;
        }
        (shifts, silent)
    }

    /// Comparisons without warmth, nm, and their variances: means of I and II, of III and both, two bends at III; zero
    /// where a grating of them is left out.
    #[inline]
    fn compared(
        &self,
        shifts: &Shifts,
        m: &Moments,
        b: Believed,
        deep_mm: f64,
        bends: [f64; 2],
        readings: f64,
    ) -> ([f64; COMPARED], [f64; COMPARED]) {
        let tells = |i: usize| b.bad & of_section(i) == 0 && b.warm & (1 << i) == 0;
        let warm = (m.means_nm[0] + m.means_nm[1]) * 0.5;
        let shared = self.own / readings
            + self.reference
            + UNLIKE_NM * UNLIKE_NM
            + self.by_warmth * warm * warm;
        let [one, two] = bends.map(|b| shared + self.by_bend * b * b);
        let (mut off, mut size) = ([0.0; COMPARED], [0.0; COMPARED]);
        if tells(0) && tells(1) {
            off[0] = m.means_nm[0] - m.means_nm[1];
            size[0] = one + two;
        }
        if deep_mm > BENT_MM {
            let left = (!b.bad >> (2 * FIBRES)) & 0b111;
            let [p, q, r] = shifts[2];
            let (mean, difference) = match left {
                0b111 => ((p + q + r) / 3.0, 0.0),
                0b110 => (0.5 * (q + r), q - r),
                0b101 => (0.5 * (p + r), p - r),
                0b011 => (0.5 * (p + q), p - q),
                _ => return (off, size),
            };
            let (both, of_both) = match (tells(0), tells(1)) {
                (true, true) => (warm, (one + two) * 0.25),
                (true, false) => (m.means_nm[0], one),
                (false, true) => (m.means_nm[1], two),
                _ => (0.0, 0.0),
            };
            if of_both > 0.0 && b.warm & 0b100 == 0 {
                off[1] = mean - both;
                size[1] = shared + of_both;
            }
            let own = shared + self.by_warmth * mean * mean;
            if left == 0b111 {
                off[2] = (2.0 * p - q - r) * 0.408_248_290_463_863;
                size[2] = 3.0 * own;
                off[3] = (q - r) * core::f64::consts::FRAC_1_SQRT_2;
            } else {
                off[3] = difference * core::f64::consts::FRAC_1_SQRT_2;
            }
            size[3] = 3.0 * own;
        }
        (off, size)
    }

    /// Keeps the means over the last readings.
    #[inline]
    fn keep(&mut self, shifts: &Shifts, bends: [f64; 2], deep_mm: f64) {
        if !(deep_mm > BENT_MM) {
            self.slow_count = 0.0;
        }
        if self.slow_count < SLOW {
            self.slow_count += 1.0;
        }
        let weight = 1.0 / self.slow_count;
        for i in 0..SECTIONS {
            for k in 0..FIBRES {
                self.slow[i][k] += (shifts[i][k] - self.slow[i][k]) * weight;
            }
        }
        for i in 0..2 {
            self.slow_bends[i] += (bends[i] * bends[i] - self.slow_bends[i]) * weight;
        }
    }
}

/// What a comparison counts: nothing is gained by how well it comes out, but that it does.
#[inline]
fn counts(square: f64) -> f64 {
    if square > FAILS {
        square.min(MOST)
    } else {
        -PASSES
    }
}

/// What comparisons count, and whether one fails.
#[inline]
fn weighed(off: &[f64; COMPARED], size: &[f64; COMPARED]) -> (f64, bool) {
    let (mut score, mut fails) = (0.0, false);
    for k in 0..COMPARED {
        if size[k] > 0.0 {
            let square = off[k] * off[k] / size[k];
            fails |= square > FAILS;
            score += counts(square);
        }
    }
    (score, fails)
}

/// What is not believed: gratings left out, sections whose warmth is their own (bits), a change of places to undo.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Believed {
    bad: Set,
    warm: u8,
    swap: Option<usize>,
}

impl Believed {
    /// Of a hypothesis alone.
    fn of(h: usize) -> Self {
        let (mut bad, mut warm, mut swap) = (0, 0, None);
        match h {
            0..FIBRE => bad = 1 << h,
            FIBRE..WITNESS => bad = of_fibre(h - FIBRE),
            WITNESS => bad = of_section(2),
            WARM..SWAPS => warm = 1 << (h - WARM),
            _ => swap = Some(h - SWAPS),
        }
        Self { bad, warm, swap }
    }

    /// With another beside it; a second change of the same two puts them right.
    fn and(self, more: Self) -> Self {
        Self {
            bad: self.bad | more.bad,
            warm: self.warm | more.warm,
            swap: match (self.swap, more.swap) {
                (one, None) => one,
                (one, two) if one == two => None,
                (_, two) => two,
            },
        }
    }

    /// All gratings that are not as they should be.
    fn faulty(self) -> Set {
        self.bad | of_swap(self.swap)
    }

    /// Gratings that it costs: a section that is warmer costs none.
    fn size(self) -> u32 {
        self.faulty().count_ones()
    }

    /// Whether another costs more and explains all that this does: a larger set around it, or gratings of a section whose
    /// warmth this has to be its own.
    fn contained(self, other: Self) -> bool {
        let warm =
            (0..SECTIONS).all(|i| self.warm & (1 << i) == 0 || other.bad & of_section(i) != 0);
        self.swap.is_none() && self.bad & !other.bad == 0 && warm && other.size() > self.size()
    }

    /// Whether it says nothing that is not said already.
    fn within(self, other: Self) -> bool {
        self.bad & !other.bad == 0 && self.warm & !other.warm == 0 && self.swap.is_none()
    }
}

/// The two gratings of a change of places: of the section, all but the fibre that stays.
fn changed(swap: usize) -> (usize, usize, usize) {
    let (section, stays) = (swap / FIBRES, swap % FIBRES);
    let (a, b) = match stays {
        0 => (1, 2),
        1 => (0, 2),
        _ => (0, 1),
    };
    (section.min(1), a, b)
}

fn of_swap(swap: Option<usize>) -> Set {
    swap.map_or(0, |s| {
        let (section, a, b) = changed(s);
        1 << (FIBRES * section + a) | 1 << (FIBRES * section + b)
    })
}

impl ToolFilter {
    /// Shifts with two peaks back in their places.
    fn put_back(&self, shifts: &Shifts, swap: Option<usize>) -> Shifts {
        let mut out = *shifts;
        if let Some(s) = swap {
            let (section, a, b) = changed(s);
            if let (Some(own), Some(rest)) = (
                out.get_mut(section),
                self.evidence.reference_nm.get(section),
            ) {
                let apart = rest[b] - rest[a];
                (own[a], own[b]) = (own[b] + apart, own[a] - apart);
            }
        }
        out
    }

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
        let put_back = self.put_back(&shifts, b.swap);
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
        let now = self.seen(&here, &self.put_back(shifts, b.swap), b, m, said);
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
            let told = self.leads(h, LEADS / 4.0);
            if told {
                self.watch.look.faulty |= of.faulty();
                self.watch.look.misfit = seen.said.misfit;
                used = seen;
                open = used.fails || used.said.far() > FAILS;
            }
            let sure =
                self.evidence.sums.get(h).is_some_and(|sum| *sum > HELD) && self.leads(h, LEADS);
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
        let shifts = self.put_back(&self.evidence.slow, b.swap);
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
                let put_back = self.put_back(shifts, of.swap);
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

    /// Whether the evidence for a hypothesis leads by so much that for every other which is no larger set around it.
    fn leads(&self, h: usize, by: f64) -> bool {
        let own = Believed::of(h);
        let sums = &self.evidence.sums;
        let mine = sums.get(h).copied().unwrap_or(0.0);
        let mut all = sums.iter().enumerate();
        all.all(|(k, sum)| {
            let other = Believed::of(k);
            // a fibre does as well as its grating, and gratings at all as a section that is warmer
            let ahead = if own.contained(other) && own.warm == 0 {
                -by
            } else {
                by
            };
            k == h || sum + ahead < mine
        })
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
