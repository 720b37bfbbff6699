//! How fast the eye strays along the shaft: learnt from how readings differ from what was expected.
//!
//! Source: multiple models, Bar-Shalom, Li and Kirubarajan, *Estimation with Applications to Tracking and Navigation*,
//! 11.6. Four filters of the depth alone, each with another process noise, share the readings; how likely they are says
//! how much each is believed. Beliefs are renewed every few readings, so that a step takes no logarithm.

use crate::numbers::math::sqrt;

const MODELS: usize = 5;
/// Process noise of one model over that of the one before.
const APART: f64 = 8.0;
/// Readings between two renewals of the beliefs.
const RENEWED: u32 = 16;
/// What is left of a belief after a renewal: the past of some ten seconds counts.
const FORGET: f64 = 0.992;
/// Belief in each model before any reading, as a logarithm: the faster, the less.
const PRIOR: [f64; MODELS] = [0.0, -1.5, -3.0, -4.5, -6.0];

/// One model: its depth less the filter's, its variance, its belief (logarithm).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Model {
    off: f64,
    variance: f64,
    belief: f64,
    /// Of the readings since the last renewal: squares over variances, and the variances' product.
    squares: f64,
    product: f64,
}

/// The models and what they make of the process noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    slowest: f64,
    models: [Model; MODELS],
    count: u32,
    /// Process noise to use, mm²/s.
    pub per_second: f64,
}

impl Drift {
    /// From the process noise of the slowest model (mm²/s) and the depth's first variance (mm²).
    pub fn new(slowest: f64, variance: f64) -> Self {
        let of = |belief| Model {
            off: 0.0,
            variance,
            belief,
            squares: 0.0,
            product: 1.0,
        };
        Self {
            slowest,
            models: PRIOR.map(of),
            count: 0,
            per_second: slowest,
        }
    }

    /// Time passes.
    #[inline]
    pub fn pass(&mut self, elapsed_s: f64) {
        let mut q = self.slowest * elapsed_s;
        for model in &mut self.models {
            model.variance += q;
            q *= APART;
        }
    }

    /// A reading `innovation` away from the filter, which moves by `moved`; its noise has this variance.
    #[inline]
    pub fn take(&mut self, innovation: f64, noise: f64, moved: f64) {
        for m in &mut self.models {
            let left = innovation - m.off;
            let total = m.variance + noise;
            let gain = m.variance / total;
            m.squares += left * left / total;
            m.product *= total / noise;
            m.off += gain * left - moved;
            m.variance *= 1.0 - gain;
        }
        self.count += 1;
        if self.count >= RENEWED {
            self.count = 0;
            self.renew();
        }
    }

    fn renew(&mut self) {
        let mut best = f64::NEG_INFINITY;
        for (m, prior) in self.models.iter_mut().zip(PRIOR) {
            let likely = -0.5 * (m.squares + libm::log(m.product));
            // a reading that no model explains says nothing
            if likely.is_finite() {
                m.belief = prior + FORGET * (m.belief - prior) + likely;
            }
            m.squares = 0.0;
            m.product = 1.0;
            if m.belief > best {
                best = m.belief;
            }
        }
        let (mut sum, mut weighted, mut q) = (0.0, 0.0, self.slowest);
        for m in &mut self.models {
            m.belief -= best;
            let weight = libm::exp(m.belief);
            sum += weight;
            weighted += weight * sqrt(q);
            q *= APART;
        }
        let mean = weighted / sum;
        self.per_second = mean * mean;
    }
}
