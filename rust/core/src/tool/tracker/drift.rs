//! How fast the eye strays along the shaft: learnt from how readings differ from what was expected.
//!
//! Source: multiple models, Bar-Shalom, Li and Kirubarajan, *Estimation with Applications to Tracking and Navigation*,
//! 11.6. Five filters of the depth alone, each with another process noise, share the readings; how likely they are says
//! how much each is believed. Beliefs are renewed every few readings, so that a step takes no logarithm.

const MODELS: usize = 5;
/// Process noise of each model over that of the slowest.
const TIMES: [f64; MODELS] = [1.0, 8.0, 64.0, 512.0, 4096.0];
/// Readings between two renewals of the beliefs.
const RENEWED: u32 = 16;
/// What is left of a belief after a renewal: the past of some ten seconds counts.
const FORGET: f64 = 0.992;
/// Belief in each model before any reading, as a logarithm: the faster, the less.
const PRIOR: [f64; MODELS] = [0.0, -1.0, -2.0, -3.0, -4.0];

/// The models and what they make of the process noise. All arrays are by model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    slowest: f64,
    /// Depth less the filter's, its variance, the belief in it (logarithm).
    off: [f64; MODELS],
    variance: [f64; MODELS],
    belief: [f64; MODELS],
    /// Of the readings since the last renewal: squares over variances, and the variances' product.
    squares: [f64; MODELS],
    product: [f64; MODELS],
    count: u32,
    /// Process noise to use, mm²/s.
    pub per_second: f64,
}

impl Drift {
    /// From the process noise of the slowest model (mm²/s) and the depth's first variance (mm²).
    pub fn new(slowest: f64, variance: f64) -> Self {
        let mut new = Self {
            slowest,
            off: [0.0; MODELS],
            variance: [variance; MODELS],
            belief: PRIOR,
            squares: [0.0; MODELS],
            product: [1.0; MODELS],
            count: 0,
            per_second: slowest,
        };
        new.renew();
        new
    }

    /// Anew from a variance of the depth, with what was learnt of the pace.
    pub fn anew(&self, variance: f64) -> Self {
        Self {
            off: [0.0; MODELS],
            variance: [variance; MODELS],
            squares: [0.0; MODELS],
            product: [1.0; MODELS],
            count: 0,
            ..*self
        }
    }

    /// Time passes.
    #[inline]
    pub fn pass(&mut self, elapsed_s: f64) {
        let q = self.slowest * elapsed_s;
        for k in 0..MODELS {
            self.variance[k] += q * TIMES[k];
        }
    }

    /// A reading `innovation` away from the filter, which moves by `moved`; its noise has this variance.
    #[inline]
    pub fn take(&mut self, innovation: f64, noise: f64, moved: f64) {
        let per_noise = 1.0 / noise;
        for k in 0..MODELS {
            let left = innovation - self.off[k];
            let total = self.variance[k] + noise;
            let per_total = 1.0 / total;
            let gain = self.variance[k] * per_total;
            self.squares[k] += left * left * per_total;
            self.product[k] *= total * per_noise;
            self.off[k] += gain * left - moved;
            // what is left of the variance is that share of the noise
            self.variance[k] = gain * noise;
        }
        self.count += 1;
        if self.count >= RENEWED {
            self.count = 0;
            self.renew();
        }
    }

    #[inline(never)]
    fn renew(&mut self) {
        let mut best = f64::NEG_INFINITY;
        for k in 0..MODELS {
            let likely = -0.5 * (self.squares[k] + libm::log(self.product[k]));
            // a reading that no model explains says nothing
            if likely.is_finite() {
                self.belief[k] = PRIOR[k] + FORGET * (self.belief[k] - PRIOR[k]) + likely;
            }
            self.squares[k] = 0.0;
            self.product[k] = 1.0;
            if self.belief[k] > best {
                best = self.belief[k];
            }
        }
        let (mut sum, mut weighted) = (0.0, 0.0);
        for k in 0..MODELS {
            self.belief[k] -= best;
            let weight = libm::exp(self.belief[k]);
            sum += weight;
            weighted += weight * (self.slowest * TIMES[k]);
        }
        self.per_second = weighted / sum;
    }
}
