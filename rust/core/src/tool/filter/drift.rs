//! How fast the eye strays along the shaft: learnt from whether innovations are white.
//!
//! Where the filter's process noise is right, innovations are independent, and their sum over a fifth of a second, each
//! over its variance, has the variance that it should (Mehra, *IEEE Trans. Automatic Control* 15, 1970). Where the hole
//! strays faster they pull one way together; the process noise follows by a fixed share for each such sum that is too
//! large or too small.

/// A sum is taken over this time, s.
const OVER_S: f64 = 0.2;
/// How far the logarithm of the process noise follows, and the largest square that counts.
const FOLLOWS: f64 = 0.1;
const MOST: f64 = 16.0;
/// A square of a sum from which on it is another hole.
const ANOTHER: f64 = 49.0;
/// The fastest eye over the slowest.
const FASTEST: f64 = 256.0;

/// The sum at present and what was made of those before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Drift {
    slowest: f64,
    sum: f64,
    weight: f64,
    elapsed_s: f64,
    /// Process noise to use, mm²/s.
    pub(super) per_second: f64,
}

impl Drift {
    /// From the least process noise, mm²/s.
    pub(super) fn new(slowest: f64) -> Self {
        Self {
            slowest,
            sum: 0.0,
            weight: 0.0,
            elapsed_s: 0.0,
            per_second: slowest * 4.0,
        }
    }

    /// Time passes.
    #[inline]
    pub(super) fn pass(&mut self, elapsed_s: f64) {
        self.elapsed_s += elapsed_s;
    }

    /// An innovation (mm) of this variance (mm²). Where their sum is far beyond all noise, the hole is another: how far off,
    /// squared (mm²).
    #[inline]
    pub(super) fn take(&mut self, innovation: f64, variance: f64) -> Option<f64> {
        let precision = 1.0 / variance;
        self.sum += innovation * precision;
        self.weight += precision;
        let (square, weight) = (self.sum * self.sum, self.weight);
        if square > ANOTHER * weight {
            (self.sum, self.weight, self.elapsed_s) = (0.0, 0.0, 0.0);
            return Some(square / (weight * weight));
        }
        if self.elapsed_s >= OVER_S {
            self.renew();
        }
        None
    }

    #[inline(never)]
    fn renew(&mut self) {
        let square = self.sum * self.sum / self.weight;
        if square.is_finite() {
            let held = if square < MOST { square } else { MOST };
            let next = self.per_second * libm::exp(FOLLOWS * (held - 1.0));
            self.per_second = next.min(self.slowest * FASTEST).max(self.slowest);
        }
        (self.sum, self.weight, self.elapsed_s) = (0.0, 0.0, 0.0);
    }
}
