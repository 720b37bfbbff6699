//! Warmth, and what unlike fibres make of it.

use super::state::{Known, OFFSETS};

/// Answers that nobody knows make moments in proportion to how much warmer it is than where the last rest told them: not a
/// random walk, one error that grows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Warmth {
    now_nm: f64,
    rest_nm: f64,
    /// Variance of a moment's component by a squared nanometre, sections I and II.
    unit: [f64; 2],
}

impl Warmth {
    /// At the reference, with the variances of a moment's component by a squared nanometre.
    pub(super) fn new(unit: [f64; 2]) -> Self {
        Self {
            now_nm: 0.0,
            rest_nm: 0.0,
            unit,
        }
    }

    /// A reading's warmth: the offsets' variances grow by what it adds.
    #[inline]
    pub(super) fn pass(&mut self, nm: f64, known: &mut Known) {
        let before = self.now_nm - self.rest_nm;
        if nm.is_finite() {
            self.now_nm += 0.02 * (nm - self.now_nm);
        }
        let now = self.now_nm - self.rest_nm;
        let more = now * now - before * before;
        if more > 0.0 {
            for k in 0..4 {
                known.p[OFFSETS + k][OFFSETS + k] += more * self.unit[k / 2];
            }
        }
    }

    /// Offsets were learnt at this warmth.
    pub(super) fn rest(&mut self, before: &Known, after: &Known) {
        let o = OFFSETS;
        if before.p[o][o] > 0.0 {
            let left = (after.p[o][o] / before.p[o][o]).min(1.0);
            self.rest_nm = self.now_nm + (self.rest_nm - self.now_nm) * left;
        }
    }
}
