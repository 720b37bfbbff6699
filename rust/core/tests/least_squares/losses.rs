//! Losses: their weights, knees and efficiency.

use crate::common::config;
use crate::systems::stack;
use nalgebra::SVector;
use proptest::prelude::*;
use sherkit_core::fit::{Levenberg, Loss, Progress, Settings, levenberg_len};

const LOSSES: [(Loss, &str, f64); 4] = [
    (Loss::Linear, "linear", f64::INFINITY),
    (Loss::Huber, "huber", 1.345),
    (Loss::Cauchy, "cauchy", 2.385),
    (Loss::Tukey, "tukey", 4.685),
];

proptest! {
    #![proptest_config(config())]

    /// A weight that is not the derivative of its cost, so that the iteration minimises something else than
    /// it reports: `d(2ρ)/du = 2 w u`.
    #[test]
    fn weight_is_the_slope_of_the_cost(u in -12.0..12.0_f64) {
        for (loss, name, knee) in LOSSES {
            let h = 1e-3;
            if (u.abs() - knee).abs() < 2.0 * h {
                continue;
            }
            let slope = crate::common::derivative(|h| SVector::<f64, 1>::new(loss.root_weight_and_cost(u + h).1), h)[0];
            let (root, cost) = loss.root_weight_and_cost(u);
            prop_assert!((slope - 2.0 * root * root * u).abs() < 1e-9, "{name} at {u}");
            prop_assert_eq!(loss.root_weight_and_cost(-u), (root, cost));
            prop_assert!((0.0..=1.0).contains(&root) && cost >= 0.0 && cost <= u * u + 1e-12);
        }
    }
}

/// A step in cost or weight where a loss changes its formula; a cost that is not `u²` for small residuals.
#[test]
fn losses_are_continuous_at_the_knee_and_square_near_zero() {
    for (loss, name, knee) in LOSSES {
        assert_eq!(Loss::from_name(name), Some(loss));
        assert_eq!(loss.root_weight_and_cost(0.0), (1.0, 0.0), "{name}");
        let u = 1e-4;
        assert!((loss.root_weight_and_cost(u).1 / (u * u) - 1.0).abs() < 1e-7);
        if knee.is_finite() {
            let (below, above) = (knee * (1.0 - 1e-9), knee * (1.0 + 1e-9));
            let (a, b) = (
                loss.root_weight_and_cost(below),
                loss.root_weight_and_cost(above),
            );
            assert!(
                (a.0 - b.0).abs() < 1e-7 && (a.1 - b.1).abs() < 1e-7,
                "{name}"
            );
        }
    }
    assert_eq!(Loss::from_name("Huber"), None);
}

/// A tuning constant that does not give the efficiency of 95 % on Gaussian noise that it is chosen for:
/// `(E ψ')² / E ψ²` with `ψ(u) = w u`, and `E ψ' = E u ψ` for a standard normal.
#[test]
fn losses_are_95_percent_efficient() {
    for (loss, name, knee) in LOSSES {
        let (mut slope, mut square) = (0.0, 0.0);
        let h = 1e-3;
        for i in -12_000..12_000 {
            let u = (f64::from(i) + 0.5) * h;
            let density = (-0.5 * u * u).exp() / std::f64::consts::TAU.sqrt() * h;
            let psi = loss.root_weight_and_cost(u).0.powi(2) * u;
            slope += u * psi * density;
            square += psi * psi * density;
        }
        let expected = if knee.is_finite() { 0.95 } else { 1.0 };
        let efficiency = slope * slope / square;
        assert!((efficiency - expected).abs() < 1e-3, "{name}: {efficiency}");
    }
}

/// An outlier that still decides the fit, under iteratively reweighted rows as the solver makes them.
#[test]
fn robust_losses_resist_an_outlier() {
    let data: Vec<(f64, f64)> = (0..40)
        .map(|i| {
            let x = f64::from(i) / 10.0;
            let noise = 0.3 * (f64::from(i) * 1.7).sin();
            (x, 1.0 + 2.0 * x + noise + if i == 37 { 50.0 } else { 0.0 })
        })
        .collect();
    let fitted = |loss: Loss| {
        // from near the truth, as Tukey's loss demands
        let mut iteration = Levenberg::new(
            &[1.2, 1.9],
            &[1.0; 2],
            Settings::default(),
            vec![0.0; levenberg_len(2)],
        )
        .unwrap();
        let mut s = stack(2, 1);
        loop {
            let [a, b] = [iteration.trial()[0], iteration.trial()[1]];
            s.clear();
            let mut total = 0.0;
            for (x, y) in &data {
                let u = (y - a - b * x) / 0.3;
                let (root, cost) = loss.root_weight_and_cost(u);
                total += cost;
                s.push([root / 0.3, root * x / 0.3, root * u]);
            }
            if iteration.advance(s.triangle(), total).unwrap() != Progress::Evaluate {
                return (iteration.trial()[0] - 1.0)
                    .abs()
                    .max((iteration.trial()[1] - 2.0).abs());
            }
        }
    };
    assert!(fitted(Loss::Linear) > 1.0);
    for loss in [Loss::Huber, Loss::Cauchy, Loss::Tukey] {
        assert!(fitted(loss) < 0.2, "{loss:?}: {}", fitted(loss));
    }
}
