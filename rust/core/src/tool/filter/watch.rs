//! What was seen of the gratings from reading to reading: peaks that change places, numbers that stand still, evidence.

use super::moments::{GRATINGS, Shifts};
use super::slips::Slips;
use crate::tool::sensing::{FIBRES, SECTIONS};
use crate::tool::status::Set;

/// No shaft is bent or warmed so far, nm; repeats of one number after which a grating is not asked.
const FARTHEST_NM: f64 = 8.0;
const REPEATS: u8 = 3;
/// Peaks that move by more at once than this may have changed places, nm; within this time, s.
const MOVED_NM: f64 = 0.08;
const AT_ONCE_S: f64 = 0.1;
/// How long noise is watched, s.
const WATCHED_S: f64 = 5.0;
/// What may be left out beside what is: nine gratings, three fibres, the warmth of three sections.
pub(super) const HYPOTHESES: usize = GRATINGS + FIBRES + SECTIONS;

/// What was seen of the gratings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Watch {
    /// The last wavelengths, each in its place, and when; which peak shows where; how often each repeated a number.
    pub(super) last: [f64; GRATINGS],
    pub(super) at_s: f64,
    pub(super) places: [usize; GRATINGS],
    pub(super) repeats: [u8; GRATINGS],
    /// Variance of a grating from reading to reading, nm².
    pub(super) jitter: f64,
    /// Evidence for each hypothesis, the one that surely leads, and for how many readings; those in a row that were refused.
    pub(super) sums: [f64; HYPOTHESES],
    pub(super) leader: Set,
    pub(super) leads_for: u16,
    pub(super) refused: u16,
    /// What is held to be bad, and for how many readings of bending it is suspected, or a fibre that slips is.
    pub(super) held: Set,
    pub(super) suspects: u16,
    pub(super) slips: Slips,
}

impl Watch {
    pub(super) fn new(jitter: f64) -> Self {
        Self {
            last: [f64::NAN; GRATINGS],
            at_s: f64::NEG_INFINITY,
            places: core::array::from_fn(|k| k),
            repeats: [REPEATS; GRATINGS],
            jitter,
            sums: [0.0; HYPOTHESES],
            leader: 0,
            leads_for: 0,
            refused: 0,
            held: 0,
            suspects: 0,
            slips: Slips::default(),
        }
    }

    /// Puts peaks back that have changed places.
    pub(super) fn sort(&mut self, peaks: &mut [f64; GRATINGS]) {
        let mut moved: [f64; GRATINGS] = core::array::from_fn(|k| (peaks[k] - self.last[k]).abs());
        for a in 0..GRATINGS {
            for b in a + 1..GRATINGS {
                let changed = (peaks[a] - self.last[b]).abs() + (peaks[b] - self.last[a]).abs();
                let least = moved[a].min(moved[b]);
                // a bend that comes at once moves the others as well
                let alone = |k: usize| k == a || k == b || !(moved[k] > 0.25 * least);
                let swapped = moved[a] > MOVED_NM && changed < 0.1 * (moved[a] + moved[b]);
                if swapped && (0..GRATINGS).all(alone) {
                    self.places.swap(a, b);
                    peaks.swap(a, b);
                    (moved[a], moved[b]) = (0.0, 0.0);
                }
            }
        }
    }

    /// Shifts from the reference, nm, with peaks back in their places, and the gratings that say nothing: not finite, out of
    /// all bounds, or stuck.
    #[inline]
    pub(super) fn look(&mut self, w: &Shifts, reference: &Shifts, elapsed_s: f64) -> (Shifts, Set) {
        let shown = w.as_flattened();
        let mut peaks: [f64; GRATINGS] = core::array::from_fn(|k| shown[self.places[k] % GRATINGS]);
        if elapsed_s < AT_ONCE_S
            && (0..GRATINGS).any(|k| (peaks[k] - self.last[k]).abs() > MOVED_NM)
        {
            self.sort(&mut peaks);
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
            // one that has never moved may be dead
            let same = u8::from(peaks[k] == self.last[k] || self.last[k].is_nan());
            self.repeats[k] = same * self.repeats[k].saturating_add(1);
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

    pub(super) fn hold(&mut self, held: Set) {
        (self.held, self.leads_for, self.refused) = (held, 0, 0);
        self.sums = [0.0; HYPOTHESES];
    }

    pub(super) fn misplaced(&self) -> Set {
        (0..GRATINGS).fold(0, |set, k| set | Set::from(self.places[k] != k) << k)
    }
}
