//! The nonlinear iteration on problems whose minima are known.

use crate::common::{Random, config};
use crate::fits::*;
use crate::systems::*;
use nalgebra::SVector;
use proptest::prelude::*;
use sherkit_core::Error;
use sherkit_core::fit::{
    Decomposition, Levenberg, Progress, Settings, decomposition_len, levenberg_len,
};

proptest! {
    #![proptest_config(config())]

    /// Damping that never comes down again, or a step accepted that made things worse: the curved valley.
    #[test]
    fn rosenbrock_is_minimised_from_anywhere(start in prop::array::uniform2(-3.0..3.0_f64)) {
        let settings = Settings { step_tolerance: 1e-10, max_evaluations: 500, ..Settings::default() };
        let found = fit(start, [1.0; 2], settings, |p| Some(rosenbrock(p)));
        prop_assert_eq!(found.progress, Progress::Converged);
        prop_assert!((found.estimate - SVector::from([1.0, 1.0])).amax() < 1e-9, "{}", found.estimate);
        prop_assert_eq!(found.rank, 2);
    }

    /// The estimate of a linear problem: two evaluations and the dense solution, whatever the start.
    #[test]
    fn a_linear_problem_takes_one_step(system in systems(), start in prop::array::uniform6(-1.0..1.0_f64)) {
        // in units that differ by more, rounding alone moves a parameter by a fraction of its plausible size
        let (a, b, sizes) = System { decades: 0.5 * system.decades, ..system }.build();
        let Some((s, rank)) = spectrum(&a) else { return Ok(()) };
        prop_assume!(s[0] > 0.0);
        let start = Vector::from(start).component_mul(&sizes);
        let rows = |p: &[f64; N]| {
            let left = b - a * Vector::from(*p);
            Some(a.row_iter().zip(left.iter()).map(|(j, r)| (std::array::from_fn(|k| j[k]), *r)).collect())
        };
        let found = fit(start.into(), sizes.into(), Settings::default(), rows);
        prop_assert_eq!(found.progress, Progress::Converged);
        prop_assert_eq!(found.rank, rank);
        prop_assert!(found.evaluations <= 3, "{}", found.evaluations);
        let expected = start + solution(&decompose(&a, &(b - a * start), &sizes));
        let norms = norms_of(&a);
        let size = expected.component_mul(&norms).amax().max(start.component_mul(&norms).amax()).max(b.norm());
        let difference = (found.estimate - expected).component_mul(&norms).norm();
        prop_assert!(difference < 1e-10 * size, "{difference}");
    }

    /// Rotations that chase a vector of rounding down to where products underflow: two equal columns beside a
    /// third, in one of a few hundred draws.
    #[test]
    fn equal_columns_settle(seed in any::<u64>()) {
        let mut random = Random(seed);
        for _ in 0..20 {
            let (rate, scale) = (1.5 * random.unit(), 1.0 + 0.3 * random.unit());
            let mut s = stack(3, 1);
            for i in 0..30 {
                let x = f64::from(i) / 10.0;
                let y = scale * (rate * x).exp();
                s.push([x * y, x * y, y / scale, random.unit()]);
            }
            let mut d = Decomposition::new(3, vec![0.0; decomposition_len(3)]).unwrap();
            prop_assert_eq!(d.decompose(s.triangle(), &[1.0; 3], 1e-9), Ok(()));
            prop_assert_eq!(d.rank(), 2);
        }
    }

    /// Parameters of which only a sum is seen: an estimate that wanders along the difference instead of
    /// sharing the change by plausible size.
    #[test]
    fn an_unseen_difference_is_shared_by_plausible_size(
        start in prop::array::uniform3(-1.0..1.0_f64),
        sizes in prop::array::uniform3(-2.0..2.0_f64),
        truth in (-0.7..0.7_f64, 0.5..2.0_f64),
    ) {
        let sizes = sizes.map(|s: f64| 10.0_f64.powf(s));
        let start = [start[0], start[1], 1.0 + 0.3 * start[2]];
        let (sum, scale) = truth;
        let rows = |p: &[f64; 3]| {
            Some((0..30).map(|i| {
                let x = f64::from(i) / 10.0;
                let y = p[2] * ((p[0] + p[1]) * x).exp();
                ([x * y, x * y, y / p[2]], scale * (sum * x).exp() - y)
            }).collect())
        };
        let settings = Settings { step_tolerance: 1e-10, max_evaluations: 1000, ..Settings::default() };
        let found = fit(start, sizes, settings, rows);
        prop_assert_eq!(found.progress, Progress::Converged);
        prop_assert_eq!(found.rank, 2);
        let p = found.estimate;
        prop_assert!((p[0] + p[1] - sum).abs() < 1e-7 && (p[2] - scale).abs() < 1e-7, "{p}");
        let share = |k: usize| sizes[k].powi(2) / (sizes[0].powi(2) + sizes[1].powi(2));
        let change = sum - start[0] - start[1];
        for k in 0..2 {
            prop_assert!((p[k] - start[k] - change * share(k)).abs() < 1e-7 * change.abs().max(1.0), "{p}");
        }
    }

    /// As above where the unseen direction turns on the way: a false claim of convergence, from anywhere. That it
    /// does converge is checked from a few starts below.
    #[test]
    fn an_unseen_curve_is_never_left_elsewhere(
        start in prop::array::uniform2(0.5..3.0_f64),
        sizes in prop::array::uniform2(-0.5..0.5_f64),
        growth in 0.5..2.0_f64,
    ) {
        let sizes = sizes.map(|s: f64| 10.0_f64.powf(s));
        let (found, along) = fit_product(start, sizes, growth * start[0] * start[1]);
        if found.progress == Progress::Converged {
            prop_assert!(along.abs() < 1e-7, "{along} at {}", found.estimate);
        }
    }

    /// A trial that cannot be evaluated and ends the iteration, or whose rows get into the estimate: the first
    /// step of a logarithm leads far outside of where it exists.
    #[test]
    fn failed_trials_are_recovered_from(
        truth in prop::array::uniform2(0.05..2.0_f64),
        start in prop::array::uniform2(6.0..40.0_f64),
        nan in any::<bool>(),
    ) {
        let mut failures = 0;
        let mut iteration = Levenberg::new(
            &start, &[1.0; 2], Settings { step_tolerance: 1e-10, max_evaluations: 500, ..Settings::default() },
            vec![0.0; levenberg_len(2)],
        ).unwrap();
        let mut s = stack(2, 1);
        let end = loop {
            let p = [iteration.trial()[0], iteration.trial()[1]];
            s.clear();
            let mut cost = 0.0;
            if p.iter().all(|p| *p > 0.0) {
                for k in 0..2 {
                    let left = truth[k].ln() - p[k].ln();
                    let mut j = [0.0; 2];
                    j[k] = 1.0 / p[k];
                    s.push(j.into_iter().chain([left]));
                    cost += left * left;
                }
            } else {
                failures += 1;
                // rows of nonsense that must not be looked at
                s.push([f64::NAN; 3]);
                cost = if nan { f64::NAN } else { f64::INFINITY };
            }
            match iteration.advance(s.triangle(), cost).unwrap() {
                Progress::Evaluate => {}
                end => break end,
            }
        };
        prop_assert_eq!(end, Progress::Converged);
        prop_assert!(failures > 0);
        for k in 0..2 {
            prop_assert!((iteration.trial()[k] - truth[k]).abs() < 1e-9);
        }
        prop_assert!(iteration.cost() < 1e-14);
    }

    /// A cost that rises from one estimate to the next, or an estimate that is not the best trial seen.
    #[test]
    fn the_best_trial_is_kept(start in prop::array::uniform2(-3.0..3.0_f64), allowed in 1..12_usize) {
        let mut best = f64::INFINITY;
        let settings = Settings { max_evaluations: allowed, step_tolerance: 0.0, ..Settings::default() };
        let found = fit(start, [1.0; 2], settings, |p| {
            let rows = rosenbrock(p);
            best = best.min(rows.iter().map(|(_, r)| r * r).sum());
            Some(rows)
        });
        prop_assert!(found.evaluations <= allowed);
        prop_assert!(found.cost <= best * (1.0 + 1e-11) && found.cost >= best * (1.0 - 1e-11));
        let estimate: [f64; 2] = found.estimate.into();
        let cost: f64 = rosenbrock(&estimate).iter().map(|(_, r)| r * r).sum();
        // where the minimum is reached exactly, both are rounding
        prop_assert!((cost - best).abs() <= 1e-9 * best + 1e-25, "{cost} {best}");
    }

    /// A single step that is damped, repeated, or not the linear solution at the start.
    #[test]
    fn a_single_step_is_the_linear_solution(start in prop::array::uniform2(0.9..1.1_f64)) {
        let settings = Settings { single_step: true, ..Settings::default() };
        // from a start of no curvature in the first row's residual the step lowers the cost
        let start = [start[0], start[0] * start[0] + 0.01 * (start[1] - 1.0)];
        let found = fit(start, [1.0; 2], settings, |p| {
            let [x, y] = *p;
            Some(vec![([-2.0 * x, 1.0], x * x - y), ([1.0, 0.0], 1.0 - x)])
        });
        prop_assert!(found.progress == Progress::Converged && found.evaluations <= 2);
        let [x, y] = start;
        // the step to x = 1 that keeps the linearised first residual at zero
        let expected = SVector::from([1.0, y + (x * x - y) + 2.0 * x * (1.0 - x)]);
        prop_assert!((found.estimate - expected).amax() < 1e-12, "{} {expected}", found.estimate);
    }
}

/// Only the product of two parameters is seen. The smallest deviation on the hyperbola is where the deviation
/// is at right angles to it, in plausible sizes: the second result vanishes there.
fn fit_product(start: [f64; 2], sizes: [f64; 2], product: f64) -> (Fit<2>, f64) {
    let settings = Settings {
        step_tolerance: 1e-9,
        max_evaluations: 2000,
        ..Settings::default()
    };
    let found = fit(start, sizes, settings, |p| {
        // rows in pairs of opposite noise, so that the cost has a floor above rounding
        let row = |i: u8| {
            let x = f64::from(i / 2);
            let noise = if i.is_multiple_of(2) { 0.1 } else { -0.1 };
            ([x * p[1], x * p[0]], x * (product - p[0] * p[1]) + noise)
        };
        Some((2..20).map(row).collect())
    });
    let part =
        |k: usize| found.estimate[k] * (found.estimate[k] - start[k]) / (sizes[k] * sizes[k]);
    let along = part(0) - part(1);
    (found, along)
}

/// An estimate that keeps to the first linearisation's unseen direction while the direction turns.
#[test]
fn an_unseen_curve_is_left_at_the_smallest_deviation() {
    for (start, sizes, product) in [
        ([1.0, 1.0], [1.0, 1.0], 1.5),
        ([1.0, 1.0], [1.0, 3.0], 0.8),
        ([2.0, 0.5], [0.5, 1.0], 1.3),
        ([0.7, 2.5], [1.0, 2.0], 2.0),
    ] {
        let (found, along) = fit_product(start, sizes, product);
        assert_eq!(
            (found.progress, found.rank, found.unobserved.len()),
            (Progress::Converged, 1, 1)
        );
        let p = found.estimate;
        assert!((p[0] * p[1] - product).abs() < 1e-8, "{p}");
        assert!(along.abs() < 1e-7, "{along} at {p}");
    }
}

/// A wall around the start that is called a minimum: every other place fails, so the iteration has to give up.
#[test]
fn a_wall_is_no_minimum() {
    let found = fit([2.0], [1.0], Settings::default(), |p| {
        (p[0] == 2.0).then(|| vec![([1.0], 3.0)])
    });
    assert_eq!(found.progress, Progress::Exhausted);
    assert_eq!(found.estimate[0], 2.0);
}

/// The linear solution withheld because the model's curvature raises the cost there.
#[test]
fn a_single_step_is_taken_even_where_it_raises_the_cost() {
    let settings = Settings {
        single_step: true,
        ..Settings::default()
    };
    let found = fit([-1.2, 1.0], [1.0; 2], settings, |p| Some(rosenbrock(p)));
    assert!((found.estimate - SVector::from([1.0, -3.84])).amax() < 1e-12);
}

/// A start that cannot be evaluated and is iterated from.
#[test]
fn a_start_that_fails_is_refused() {
    for cost in [f64::INFINITY, f64::NAN, f64::NEG_INFINITY] {
        let mut iteration = Levenberg::new(
            &[1.0],
            &[1.0],
            Settings::default(),
            vec![0.0; levenberg_len(1)],
        )
        .unwrap();
        assert_eq!(
            iteration.advance(&[1.0, 0.0, 0.0, 1.0], cost),
            Err(Error::NotFinite { index: 0 })
        );
    }
}
