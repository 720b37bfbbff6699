//! Rows of the spherical robot as they come from Python, and their way into the solver.

use crate::arrays::rows;
use crate::errors::shape;
use crate::model::optional;
use crate::solver::Solver;
use nalgebra::{Vector2, Vector3};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use sherkit_core::spherical::parameters::{PARAMETERS, Values};
use sherkit_core::spherical::{Chain, Covariates, Kind, Model, Row};

/// Readings a row may have: u, v, φ, γ.
pub const READINGS: usize = 4;

/// Covariates a row may have: time, temperature, two directions, two velocities.
const COVARIATES: usize = 6;

/// A block of rows as it comes from Python: joints `(n, 2)`, which rows read angles `(n,)`, covariates `(n, 6)` (time
/// s, temperature °C, two directions, two velocities rad/s) and displacements of the marker `(n, 3)`.
pub type Block<'py> = (
    PyReadonlyArray2<'py, f64>,
    Option<PyReadonlyArray1<'py, bool>>,
    Option<PyReadonlyArray2<'py, f64>>,
    Option<PyReadonlyArray2<'py, f64>>,
);

/// The rows of a block, copied, so that nobody else can write them while they are used.
pub fn rows_of(block: &Block<'_>) -> PyResult<Vec<Row>> {
    let joints = rows::<2, _>("joints", &block.0)?;
    let n = joints.len();
    let angles = match &block.1 {
        None => None,
        Some(a) if a.len() == n => Some(a.as_slice()?),
        Some(a) => return Err(shape("angles", &format!("({n},)"), a.shape())),
    };
    let covariates = optional::<COVARIATES>("covariates", block.2.as_ref(), n)?;
    let push = optional::<3>("push", block.3.as_ref(), n)?;
    let row = |i: usize| Row {
        joints: joints[i],
        covariates: covariates.map_or(Covariates::NONE, |c| {
            let [time_s, temperature_c, d1, d2, v1, v2] = c[i];
            Covariates {
                time_s,
                temperature_c,
                direction: [d1, d2],
                velocity_rad_s: [v1, v2],
            }
        }),
        push: push.map_or_else(Vector3::zeros, |p| Vector3::from(p[i])),
        kind: if angles.is_some_and(|a| a[i]) {
            Kind::Angles
        } else {
            Kind::Pixels
        },
    };
    Ok((0..n).map(row).collect())
}

/// Where the readings of a row stand among the four.
pub fn place(kind: Kind) -> usize {
    match kind {
        Kind::Pixels => 0,
        Kind::Angles => 2,
    }
}

pub fn read(row: &Row, reading: &[f64; READINGS]) -> Vector2<f64> {
    let at = place(row.kind);
    Vector2::new(reading[at], reading[at + 1])
}

pub fn check_free(free: &[usize]) -> PyResult<()> {
    if free.iter().any(|&k| k >= PARAMETERS) {
        return Err(shape("free", &format!("indices below {PARAMETERS}"), free));
    }
    Ok(())
}

/// A copy of `(n, N)` numbers.
pub fn table<const N: usize>(
    name: &str,
    array: &PyReadonlyArray2<'_, f64>,
    n: usize,
) -> PyResult<Vec<[f64; N]>> {
    optional::<N>(name, Some(array), n).map(|found| found.unwrap_or_default().to_vec())
}

/// Rows to be fitted: the parameters that are free, and the values of those that are not.
pub struct Problem<'a> {
    pub model: &'a Model,
    pub values: Values,
    pub free: &'a [usize],
    pub rows: &'a [Row],
}

impl Problem<'_> {
    pub fn check(&self, solver: &Solver) -> PyResult<()> {
        check_free(self.free)?;
        let expected = solver.trial_values().len();
        if expected != self.free.len() {
            return Err(shape("free", &format!("({expected},)"), &[self.free.len()]));
        }
        Ok(())
    }

    /// The chain at the solver's trial; errors that leave no robot make every row unreachable.
    fn chain(&self, solver: &Solver) -> Option<Chain> {
        let mut values = self.values;
        for (&k, &value) in self.free.iter().zip(solver.trial_values()) {
            values[k] = value;
        }
        self.model.with(&values).ok()
    }

    /// Adds the readings at the solver's trial; returns the rows that cannot be computed there.
    pub fn readings(
        &self,
        solver: &mut Solver,
        readings: &[[f64; READINGS]],
        weights: &[[f64; READINGS]],
    ) -> Vec<usize> {
        let Some(chain) = self.chain(solver) else {
            return (0..self.rows.len()).collect();
        };
        let mut missing = Vec::new();
        for (i, ((row, reading), weight)) in self.rows.iter().zip(readings).zip(weights).enumerate()
        {
            let at = place(row.kind);
            if weight[at] == 0.0 && weight[at + 1] == 0.0 {
                continue;
            }
            let Ok(p) = chain.row_predict(row) else {
                missing.push(i);
                continue;
            };
            for axis in 0..2 {
                let line = self.free.iter().map(|&k| p.by_parameters[(axis, k)]);
                let residual = reading[at + axis] - p.value[axis];
                solver.add(line, residual, weight[at + axis]);
            }
        }
        missing
    }

    /// As [`Self::readings`], for the paper's residuals (Eq. 6).
    pub fn inverse(
        &self,
        solver: &mut Solver,
        readings: &[[f64; READINGS]],
        weights: &[[f64; 2]],
    ) -> Vec<usize> {
        let Some(chain) = self.chain(solver) else {
            return (0..self.rows.len()).collect();
        };
        let mut missing = Vec::new();
        for (i, ((row, reading), weight)) in self.rows.iter().zip(readings).zip(weights).enumerate()
        {
            if *weight == [0.0; 2] {
                continue;
            }
            let Ok(found) = chain.inverse_residual(row, &read(row, reading)) else {
                missing.push(i);
                continue;
            };
            for axis in 0..2 {
                // the solver wants the derivative of what is predicted: minus that of the residual
                let line = self.free.iter().map(|&k| -found.by_parameters[(axis, k)]);
                solver.add(line, found.value[axis], weight[axis]);
            }
        }
        missing
    }
}
