//! Back over a recorded run: every estimate from all measurements, the later ones too.
//!
//! Source: Rauch, Tung and Striebel 1965; Simon, *Optimal State Estimation*, 2006, 9.4.2. The covariance is
//! `(1 - G F) P (1 - G F)ᵀ + G (P' + Q) Gᵀ`, with `P'` the smoothed one of the next step: equal to the textbook
//! form for this gain, and positive semidefinite by its shape. The predicted covariance may be singular: along what
//! it holds exactly there is nothing to learn.

use super::filter::{Estimate, Filter};
use crate::{Error, Result};

/// One step of a filter, as the smoother needs it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Record<const N: usize> {
    /// Before the measurement.
    pub predicted: Filter<N>,
    /// After it.
    pub filtered: Filter<N>,
    /// Process noise between the step before and this one.
    pub process: [[f64; N]; N],
}

impl<const N: usize> Record<N> {
    /// A step that changed nothing.
    #[must_use]
    pub fn still(filter: Filter<N>) -> Self {
        Self {
            predicted: filter,
            filtered: filter,
            process: [[0.0; N]; N],
        }
    }
}

/// Smooths a run whose state moves by `transition` (the identity for the filters of the tool) between steps.
///
/// # Errors
/// [`Error::WrongLength`] where the buffers differ in length.
pub fn smooth<const N: usize>(
    transition: &[[f64; N]; N],
    records: &[Record<N>],
    smoothed: &mut [Estimate<N>],
) -> Result<()> {
    if records.len() != smoothed.len() {
        return Err(Error::WrongLength {
            expected: records.len(),
            found: smoothed.len(),
        });
    }
    let mut later: Option<(&Record<N>, Estimate<N>)> = None;
    for (record, place) in records.iter().zip(smoothed).rev() {
        *place = match later {
            None => record.filtered.estimate(),
            Some((next, state)) => back(transition, &record.filtered.estimate(), next, &state),
        };
        later = Some((record, *place));
    }
    Ok(())
}

/// One step back, from the smoothed state of the next step.
fn back<const N: usize>(
    f: &[[f64; N]; N],
    filtered: &Estimate<N>,
    next: &Record<N>,
    smoothed: &Estimate<N>,
) -> Estimate<N> {
    // columns of the transposed gain: Gᵀ = P_predicted⁻¹ F P
    let mut gain = multiply(f, &filtered.covariance);
    next.predicted.factors.solve(&mut gain);
    let gain = transpose(&gain);
    let mut mean = filtered.mean;
    for i in 0..N {
        for j in 0..N {
            mean[i] += gain[i][j] * (smoothed.mean[j] - next.predicted.mean[j]);
        }
    }
    let mut keep = multiply(&gain, f);
    for i in 0..N {
        for j in 0..N {
            keep[i][j] = if i == j { 1.0 } else { 0.0 } - keep[i][j];
        }
    }
    let mut inner = smoothed.covariance;
    for i in 0..N {
        for j in 0..N {
            inner[i][j] += next.process[i][j];
        }
    }
    let kept = sandwich(&keep, &filtered.covariance);
    let brought = sandwich(&gain, &inner);
    let mut covariance = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let mean = 0.5 * (kept[i][j] + kept[j][i] + brought[i][j] + brought[j][i]);
            covariance[i][j] = mean;
            covariance[j][i] = mean;
        }
        covariance[i][i] = covariance[i][i].max(0.0);
    }
    Estimate { mean, covariance }
}

fn multiply<const N: usize>(a: &[[f64; N]; N], b: &[[f64; N]; N]) -> [[f64; N]; N] {
    let mut product = [[0.0; N]; N];
    for i in 0..N {
        for k in 0..N {
            for j in 0..N {
                product[i][j] += a[i][k] * b[k][j];
            }
        }
    }
    product
}

fn transpose<const N: usize>(a: &[[f64; N]; N]) -> [[f64; N]; N] {
    let mut turned = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..N {
            turned[j][i] = a[i][j];
        }
    }
    turned
}

/// `A P Aᵀ`.
fn sandwich<const N: usize>(a: &[[f64; N]; N], p: &[[f64; N]; N]) -> [[f64; N]; N] {
    multiply(&multiply(a, p), &transpose(a))
}
