//! Reference problems of NIST.

use crate::fits::*;
use crate::nist::{self, Problem};
use nalgebra::SVector;
use sherkit_core::fit::Progress;

/// Fits from both starts, with a descent before and without. Where `may_give_up` says so, running out of evaluations is no failure.
fn check_nist<const N: usize>(name: &str, problem: &Problem<N>, may_give_up: [bool; 2]) {
    for (k, after_descent) in [(0, false), (1, false), (0, true), (1, true)] {
        let start = problem.starts[k];
        let sizes = start.map(f64::abs);
        let rows_at = |b: &[f64; N]| {
            let rows: Rows<N> = problem
                .rows
                .iter()
                .map(|(y, x)| {
                    let (value, derivative) = (problem.model)(b, *x);
                    (derivative, y - value)
                })
                .collect();
            rows.iter()
                .all(|(j, r)| r.is_finite() && j.iter().all(|d| d.is_finite()))
                .then_some(rows)
        };
        let fit = if after_descent {
            fit_after_descent(start, sizes, thorough(), rows_at)
        } else {
            fit(start, sizes, thorough(), rows_at)
        };
        let at = format!(
            "{name} from start {}, after a descent: {after_descent}",
            k + 1
        );
        if may_give_up[k] && fit.progress == Progress::Exhausted {
            continue;
        }
        assert_eq!(fit.progress, Progress::Converged, "{at}");
        assert_eq!(fit.rank, N, "{at}");
        for (found, certified) in fit.estimate.iter().zip(problem.certified) {
            assert!(
                (found / certified - 1.0).abs() < 1e-7,
                "{at}: {found} for {certified}"
            );
        }
        assert!(
            (fit.cost / problem.sum_of_squares - 1.0).abs() < 1e-9,
            "{at}: cost {}",
            fit.cost
        );
    }
}

/// A NIST model whose hand-made derivatives are wrong would test nothing.
#[test]
fn nist_derivatives_are_right() {
    fn check<const N: usize>(problem: &Problem<N>) {
        for &(_, x) in problem.rows {
            let (_, derivative) = (problem.model)(&problem.certified, x);
            for k in 0..N {
                let differences = crate::common::derivative(
                    |h| {
                        let mut b = problem.certified;
                        b[k] *= 1.0 + h;
                        SVector::<f64, 1>::new((problem.model)(&b, x).0)
                    },
                    3e-5,
                )[0] / problem.certified[k];
                let size = (problem.model)(&problem.certified, x).0 / problem.certified[k];
                assert!(
                    (derivative[k] - differences).abs()
                        < 1e-7 * size.abs().max(derivative[k].abs())
                );
            }
        }
    }
    check(&nist::MISRA1A);
    check(&nist::THURBER);
    check(&nist::MGH09);
    check(&nist::ECKERLE4);
    check(&nist::BENNETT5);
}

/// An iteration that stops early, at a saddle, or with a parameter called unobserved: Misra1a.
#[test]
fn nist_misra1a() {
    check_nist("Misra1a", &nist::MISRA1A, [false; 2]);
}

/// As above, with seven parameters: Thurber.
#[test]
fn nist_thurber() {
    check_nist("Thurber", &nist::THURBER, [false; 2]);
}

/// As above, with a residual that flattens out: MGH09.
#[test]
fn nist_mgh09() {
    check_nist("MGH09", &nist::MGH09, [false; 2]);
}

/// As above, with a narrow peak: Eckerle4. From the far start, where no row sees the peak, the iteration may run
/// out of evaluations, but must not claim a minimum elsewhere.
#[test]
fn nist_eckerle4() {
    check_nist("Eckerle4", &nist::ECKERLE4, [true, false]);
}

/// As above, almost rank-deficient: Bennett5. Its valley is so narrow that damping which begins too strong crawls
/// through it for thousands of evaluations.
#[test]
fn nist_bennett5() {
    let near = nist::BENNETT5.certified.map(|b| b * (1.0 + 1e-5));
    let near = Problem {
        starts: [near, near],
        ..nist::BENNETT5
    };
    check_nist("Bennett5 from nearby", &near, [false; 2]);
    check_nist("Bennett5", &nist::BENNETT5, [false; 2]);
}
