//! What was seen of the gratings: what they say beyond two moments and a warmth, and the evidence that adds up.
//!
//! The means of the sections, freed of what bends leave in them (that is calibrated), must agree; section III, which nothing
//! bends, must show no bend. Evidence for a hypothesis adds up over readings, each counted to a limit (Page's cumulative
//! sum, *Biometrika* 41, 1954).

use super::hypotheses::{Believed, GRATINGS, HYPOTHESES, changed};
use super::known::Trusted;
use super::moments::{Moments, Set, Shifts, of_section};
use super::slips::Slips;
use crate::tool::sensing::{FIBRES, SECTIONS};

/// No shaft is bent or warmed so far, nm.
pub(super) const FARTHEST_NM: f64 = 8.0;
/// A comparison of χ² that fails, one degree of freedom; what one counts at most.
pub(super) const FAILS: f64 = 36.0;
pub(super) const MOST: f64 = 60.0;
/// What it counts for a hypothesis that a comparison which it lets stand comes out: one in so many could (Occam).
const PASSES: f64 = 4.0;
/// Readings that the slow comparison looks back on.
const SLOW: f64 = 200.0;
/// Warmth of two sections differs by this, nm.
pub(super) const UNLIKE_NM: f64 = 0.15e-3;
/// Section III feels a bend where the hole is nearer the tip than this, mm.
pub(super) const BENT_MM: f64 = 7.0;
/// Repeats of one number after which a grating is not asked.
const REPEATS: u8 = 3;
/// Comparisons of the means.
pub(super) const COMPARED: usize = 4;

/// What was seen of the gratings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Evidence {
    reference_nm: Shifts,
    /// Variances of a mean: noise; what references are off; warmth (by its square) and bends (by theirs).
    pub(super) own: f64,
    reference: f64,
    by_warmth: f64,
    by_bend: f64,
    last: Shifts,
    repeats: [u8; GRATINGS],
    /// Means over the last readings: shifts, and what a bend leaves in the means, squared.
    pub(super) slow: Shifts,
    pub(super) slow_bends: [f64; 2],
    pub(super) slow_count: f64,
    /// Time of the last reading, s.
    pub(super) at_s: f64,
    /// Evidence against the readings as they are, for each hypothesis.
    pub(super) sums: [f64; HYPOTHESES],
    pub(super) slips: Slips,
    pub(super) leader: usize,
    pub(super) leads_for: u16,
    pub(super) held: Believed,
    pub(super) good: u16,
    pub(super) refused: u16,
    pub(super) calm: u16,
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
    pub(super) fn calmed(&mut self) {
        self.sums = [0.0; HYPOTHESES];
        self.slow_count = 0.0;
        self.leads_for = 0;
        self.refused = 0;
        self.calm = 0;
    }

    /// Shifts from the reference, nm, and the gratings that say nothing: not finite, out of all bounds, or stuck.
    #[inline]
    pub(super) fn look(&mut self, w: &Shifts) -> (Shifts, Set) {
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
    pub(super) fn compared(
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
    pub(super) fn keep(&mut self, shifts: &Shifts, bends: [f64; 2], deep_mm: f64) {
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

    /// Shifts with two peaks back in their places.
    pub(super) fn put_back(&self, shifts: &Shifts, swap: Option<usize>) -> Shifts {
        let mut out = *shifts;
        if let Some(s) = swap {
            let (section, a, b) = changed(s);
            if let (Some(own), Some(rest)) = (out.get_mut(section), self.reference_nm.get(section))
            {
                let apart = rest[b] - rest[a];
                (own[a], own[b]) = (own[b] + apart, own[a] - apart);
            }
        }
        out
    }

    /// Whether the evidence for a hypothesis leads by so much that for every other which is no larger set around it.
    pub(super) fn leads(&self, h: usize, by: f64) -> bool {
        let own = Believed::of(h);
        let sums = &self.sums;
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
}

/// What a comparison counts: nothing is gained by how well it comes out, but that it does.
#[inline]
pub(super) fn counts(square: f64) -> f64 {
    if square > FAILS {
        square.min(MOST)
    } else {
        -PASSES
    }
}

/// What comparisons count, and whether one fails.
#[inline]
pub(super) fn weighed(off: &[f64; COMPARED], size: &[f64; COMPARED]) -> (f64, bool) {
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
