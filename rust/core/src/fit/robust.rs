//! Losses that keep a few wrong rows from deciding the fit.
//!
//! Each is a function ρ of the residual in units of its noise, used through iteratively reweighted least
//! squares: weight ρ'(u)/u. Tuning constants give 95 % efficiency on Gaussian noise (Huber and Ronchetti,
//! *Robust Statistics*; Maronna et al., *Robust Statistics: Theory and Methods*, 2.2 to 2.4).

use crate::numbers::math::sqrt;

/// A loss function by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Loss {
    /// Plain squares.
    #[default]
    Linear,
    /// Squares near zero, absolute values beyond 1.345.
    Huber,
    /// Logarithmic tails, constant 2.385.
    Cauchy,
    /// Rows beyond 4.685 have no say; start from a fit that is nearly right.
    Tukey,
}

impl Loss {
    /// The loss of this name, where there is one.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "linear" => Some(Self::Linear),
            "huber" => Some(Self::Huber),
            "cauchy" => Some(Self::Cauchy),
            "tukey" => Some(Self::Tukey),
            _ => None,
        }
    }

    /// Square root of the weight, and the cost `2ρ(u)`, which is `u²` for plain squares.
    #[inline]
    #[must_use]
    pub fn root_weight_and_cost(self, u: f64) -> (f64, f64) {
        let a = u.abs();
        match self {
            Self::Linear => (1.0, u * u),
            Self::Huber => {
                const K: f64 = 1.345;
                if a <= K {
                    (1.0, u * u)
                } else {
                    (sqrt(K / a), K * (2.0 * a - K))
                }
            }
            Self::Cauchy => {
                const K: f64 = 2.385;
                let v = (u / K) * (u / K);
                (1.0 / sqrt(1.0 + v), K * K * libm::log1p(v))
            }
            Self::Tukey => {
                const K: f64 = 4.685;
                if a >= K {
                    (0.0, K * K / 3.0)
                } else {
                    let v = (u / K) * (u / K);
                    (1.0 - v, K * K / 3.0 * v * (3.0 - v * (3.0 - v)))
                }
            }
        }
    }
}
