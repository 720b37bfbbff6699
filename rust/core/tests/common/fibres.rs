//! Gratings of a flexible tool whose fibres stand evenly, and what they show.

use nalgebra::{Matrix2x3, Vector2};
use sherkit_core::tool::filter::Shifts;
use sherkit_core::tool::sensing::Calibration;
use std::f64::consts::TAU;

/// From the tip to sections I and II, mm.
pub const DISTANCES: [f64; 2] = [40.0, 50.0];

pub fn calibration() -> Calibration {
    let gain = Matrix2x3::from_fn(|i, k| {
        let (sine, cosine) = (TAU * k as f64 / 3.0).sin_cos();
        3200.0 * if i == 0 { cosine } else { sine }
    });
    let [one, two] = [1530.0, 1545.0].map(|x| [x, x + 1.0, x + 2.0]);
    Calibration {
        gains: [gain; 2],
        distances_mm: DISTANCES,
        reference_nm: [one, two, [1560.0; 3]],
        noise_nm: 1e-3,
    }
}

/// Wavelengths that two moments (mN·mm) make, all warmed (nm).
pub fn wavelengths(moments: &[Vector2<f64>; 2], warm: f64) -> Shifts {
    let c = calibration();
    let mut w = c.reference_nm.map(|s| s.map(|x| x + warm));
    for i in 0..2 {
        let shift = c.gains[i].pseudo_inverse(1e-9).unwrap() * moments[i];
        for k in 0..3 {
            w[i][k] += shift[k];
        }
    }
    w
}
