//! Fits of models given as closures, by the nonlinear iteration.

use crate::systems::stack;
use nalgebra::SVector;
use sherkit_core::fit::{
    Descended, Descent, Fold, Levenberg, Progress, Settings, descent_len, levenberg_len,
};

pub struct Fit<const N: usize> {
    pub progress: Progress,
    pub estimate: SVector<f64, N>,
    pub cost: f64,
    pub evaluations: usize,
    pub rank: usize,
    pub unobserved: Vec<SVector<f64, N>>,
}

/// Rows of a model: each is handed over with its derivatives and what is left of the measurement. `None`
/// where the model does not exist.
pub type Rows<const N: usize> = Vec<([f64; N], f64)>;

pub fn fit<const N: usize>(
    start: [f64; N],
    sizes: [f64; N],
    settings: Settings,
    rows: impl FnMut(&[f64; N]) -> Option<Rows<N>>,
) -> Fit<N> {
    let iteration = Levenberg::new(&start, &sizes, settings, vec![f64::NAN; levenberg_len(N)]);
    iterate(start, sizes, iteration.unwrap(), rows)
}

/// Products of the rows and their cost, infinite where there are none.
pub fn products<const N: usize>(rows: Option<Rows<N>>) -> (Vec<f64>, f64) {
    let mut s = stack(N, 1);
    s.clear_for(Fold::Products);
    let mut cost = f64::INFINITY;
    if let Some(rows) = rows {
        cost = rows.iter().map(|(_, r)| r * r).sum();
        for (j, r) in rows {
            s.push(j.into_iter().chain([r]));
        }
    }
    (s.triangle().to_vec(), cost)
}

/// The same with a descent before: begun where it ends, or at the start where it gets lost.
pub fn fit_after_descent<const N: usize>(
    start: [f64; N],
    sizes: [f64; N],
    settings: Settings,
    mut rows: impl FnMut(&[f64; N]) -> Option<Rows<N>>,
) -> Fit<N> {
    let mut descent = Descent::new(&start, &sizes, 1e-3, vec![f64::NAN; descent_len(N)]).unwrap();
    let near = loop {
        let trial: [f64; N] = descent.trial().try_into().unwrap();
        let (products, cost) = products(rows(&trial));
        match descent.advance(&products, cost) {
            Descended::Evaluate => {}
            end => break end == Descended::Near,
        }
    };
    let mut iteration =
        Levenberg::new(&start, &sizes, settings, vec![f64::NAN; levenberg_len(N)]).unwrap();
    let place = if near { descent.trial() } else { &start };
    iteration.begin_at(place, descent.evaluations());
    iterate(start, sizes, iteration, rows)
}

pub fn iterate<const N: usize>(
    start: [f64; N],
    sizes: [f64; N],
    mut iteration: Levenberg<Vec<f64>>,
    mut rows: impl FnMut(&[f64; N]) -> Option<Rows<N>>,
) -> Fit<N> {
    assert_eq!(
        (iteration.start(), iteration.sizes()),
        (&start[..], &sizes[..])
    );
    let mut s = stack(N, 1);
    let progress = loop {
        let trial: [f64; N] = iteration.trial().try_into().unwrap();
        assert!(trial.iter().all(|t| t.is_finite()), "{trial:?}");
        s.clear();
        let mut cost = f64::INFINITY;
        if let Some(rows) = rows(&trial) {
            cost = rows.iter().map(|(_, r)| r * r).sum();
            for (j, r) in rows {
                s.push(j.into_iter().chain([r]));
            }
        }
        match iteration.advance(s.triangle(), cost).unwrap() {
            Progress::Evaluate => {}
            end => break end,
        }
    };
    let (rank, unobserved) = iteration
        .with_decomposition(|d| {
            (
                d.rank(),
                d.unobserved().map(SVector::from_column_slice).collect(),
            )
        })
        .unwrap();
    Fit {
        progress,
        estimate: SVector::from_column_slice(iteration.trial()),
        cost: iteration.cost(),
        evaluations: iteration.evaluations(),
        rank,
        unobserved,
    }
}

/// To the last digit: every rank that rounding can show, and steps down to rounding.
pub fn thorough() -> Settings {
    Settings {
        max_evaluations: 3000,
        step_tolerance: 1e-12,
        rank_tolerance: 1e-14,
        single_step: false,
    }
}

pub fn rosenbrock(p: &[f64; 2]) -> Rows<2> {
    let [x, y] = *p;
    vec![
        ([-20.0 * x, 10.0], -10.0 * (y - x * x)),
        ([-1.0, 0.0], x - 1.0),
    ]
}
