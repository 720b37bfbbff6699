//! `DeltaModel`: predicted readings, their derivatives, and rows for the solver.

use crate::arrays::{fixed, rows, shaped};
use crate::errors::{shape, to_python};
use crate::kinematics::assembly;
use crate::solver::Solver;
use nalgebra::Vector3;
use numpy::{
    PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use sherkit_core::delta::{GEOMETRIC, Geometry, Kind, Model, PARAMETERS};
use sherkit_core::least_squares::Progress;

/// Readings a row may have: x, y, z, distance.
const READINGS: usize = 4;

/// Joint readings of a set of rows: positions, or distances where the second end is given.
struct Rows {
    joints: Vec<[f64; 3]>,
    to: Option<Vec<[f64; 3]>>,
}

impl Rows {
    /// Copies the arrays, so that nobody else can write them while they are used.
    fn new(
        joints: &PyReadonlyArray2<'_, f64>,
        to: Option<&PyReadonlyArray2<'_, f64>>,
    ) -> PyResult<Self> {
        let joints = rows::<3, _>("joints", joints)?.to_vec();
        let to = match to {
            None => None,
            Some(array) => {
                let to = rows::<3, _>("to_joints", array)?.to_vec();
                if to.len() != joints.len() {
                    let expected = format!("({}, 3)", joints.len());
                    return Err(shape("to_joints", &expected, array.shape()));
                }
                Some(to)
            }
        };
        Ok(Self { joints, to })
    }

    fn len(&self) -> usize {
        self.joints.len()
    }

    /// A row whose second end is NaN is a position.
    fn kind(&self, row: usize) -> Kind {
        let from = self.joints[row];
        match &self.to {
            Some(to) if !to[row][0].is_nan() => Kind::Distance { from, to: to[row] },
            _ => Kind::Position { joints: from },
        }
    }
}

/// A nominal delta whose geometric errors and datum are to be identified.
#[pyclass(frozen, module = "sherkit._core")]
pub struct DeltaModel(Model);

#[pymethods]
impl DeltaModel {
    /// Number of parameters: 18 geometric errors and the datum.
    #[classattr]
    const PARAMETERS: usize = PARAMETERS;

    #[new]
    fn new(
        geometry: PyReadonlyArray1<'_, f64>,
        target_offset: PyReadonlyArray1<'_, f64>,
        assembly_mode: &str,
    ) -> PyResult<Self> {
        let p = fixed::<GEOMETRIC, _>("geometry", &geometry)?;
        let geometry = Geometry::from_parameters(&p, assembly(assembly_mode)?);
        geometry.check().map_err(to_python)?;
        Ok(Self(Model {
            geometry,
            target_offset: Vector3::from(fixed("target_offset", &target_offset)?),
        }))
    }

    /// Predicted readings `(n, 4)` (x, y, z, distance; what does not apply is zero) and which rows are in reach.
    fn predict<'py>(
        &self,
        py: Python<'py>,
        errors: PyReadonlyArray1<'_, f64>,
        joints: PyReadonlyArray2<'_, f64>,
        to_joints: Option<PyReadonlyArray2<'_, f64>>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<bool>>)> {
        let predictor = self.0.with(&fixed("errors", &errors)?).map_err(to_python)?;
        let rows = Rows::new(&joints, to_joints.as_ref())?;
        let mut out = vec![0.0; rows.len() * READINGS];
        let mut reached = vec![false; rows.len()];
        for (i, out) in out.chunks_exact_mut(READINGS).enumerate() {
            let kind = rows.kind(i);
            if let Ok(value) = predictor.value(&kind) {
                let (at, count) = place(&kind);
                out[at..at + count].copy_from_slice(&value.as_slice()[..count]);
                reached[i] = true;
            } else {
                out.fill(f64::NAN);
            }
        }
        Ok((
            shaped(py, out, [rows.len(), READINGS])?,
            PyArray1::from_vec(py, reached),
        ))
    }

    /// Derivatives `(n, 4, free)` by the parameters whose indices are given, and which rows are in reach.
    fn derivatives<'py>(
        &self,
        py: Python<'py>,
        errors: PyReadonlyArray1<'_, f64>,
        joints: PyReadonlyArray2<'_, f64>,
        to_joints: Option<PyReadonlyArray2<'_, f64>>,
        free: Vec<usize>,
    ) -> PyResult<(Bound<'py, PyArray3<f64>>, Bound<'py, PyArray1<bool>>)> {
        check_free(&free)?;
        let predictor = self.0.with(&fixed("errors", &errors)?).map_err(to_python)?;
        let rows = Rows::new(&joints, to_joints.as_ref())?;
        let mut out = vec![0.0; rows.len() * READINGS * free.len()];
        let mut reached = vec![false; rows.len()];
        for (i, out) in out
            .chunks_exact_mut((READINGS * free.len()).max(1))
            .enumerate()
        {
            let kind = rows.kind(i);
            if let Ok(prediction) = predictor.predict(&kind) {
                let (at, count) = place(&kind);
                for axis in 0..count {
                    for (k, &column) in free.iter().enumerate() {
                        out[(at + axis) * free.len() + k] = prediction.derivative[(axis, column)];
                    }
                }
                reached[i] = true;
            } else {
                out.fill(f64::NAN);
            }
        }
        Ok((
            shaped(py, out, [rows.len(), READINGS, free.len()])?,
            PyArray1::from_vec(py, reached),
        ))
    }

    /// Adds a block of rows to the solver at its trial. `errors` holds the parameters that are not free.
    /// Returns the rows that are out of reach there.
    #[allow(
        clippy::too_many_arguments,
        reason = "one array for each column group of a block"
    )]
    fn accumulate(
        &self,
        solver: &mut Solver,
        errors: PyReadonlyArray1<'_, f64>,
        free: Vec<usize>,
        joints: PyReadonlyArray2<'_, f64>,
        to_joints: Option<PyReadonlyArray2<'_, f64>>,
        readings: PyReadonlyArray2<'_, f64>,
        weights: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Vec<usize>> {
        check_free(&free)?;
        let fixed_errors = fixed("errors", &errors)?;
        let rows = Rows::new(&joints, to_joints.as_ref())?;
        let (readings, weights) = self::readings(rows.len(), &readings, &weights)?;
        evaluate(
            &self.0,
            solver,
            fixed_errors,
            &free,
            &rows,
            &readings,
            &weights,
        )
    }

    /// Iterates to the minimum over rows in memory. Returns how it ended and the rows out of reach at the start,
    /// with which nothing is solved.
    #[allow(
        clippy::too_many_arguments,
        reason = "one array for each column group of a block"
    )]
    fn solve(
        &self,
        py: Python<'_>,
        solver: &mut Solver,
        errors: PyReadonlyArray1<'_, f64>,
        free: Vec<usize>,
        joints: PyReadonlyArray2<'_, f64>,
        to_joints: Option<PyReadonlyArray2<'_, f64>>,
        readings: PyReadonlyArray2<'_, f64>,
        weights: PyReadonlyArray2<'_, f64>,
        priors: bool,
    ) -> PyResult<(&'static str, Vec<usize>)> {
        check_free(&free)?;
        let fixed_errors = fixed("errors", &errors)?;
        let rows = Rows::new(&joints, to_joints.as_ref())?;
        let (readings, weights) = self::readings(rows.len(), &readings, &weights)?;
        py.detach(|| {
            let mut first = true;
            loop {
                solver.begin();
                let missing = evaluate(
                    &self.0,
                    solver,
                    fixed_errors,
                    &free,
                    &rows,
                    &readings,
                    &weights,
                )?;
                if !missing.is_empty() {
                    if first {
                        return Ok(("unreachable", missing));
                    }
                    solver.fail_trial();
                } else if priors {
                    solver.add_priors();
                }
                first = false;
                match solver.step()? {
                    Progress::Evaluate => {}
                    Progress::Converged => return Ok(("converged", Vec::new())),
                    Progress::Exhausted => return Ok(("exhausted", Vec::new())),
                }
            }
        })
    }
}

/// Where the readings of a row stand among the four, and how many there are.
fn place(kind: &Kind) -> (usize, usize) {
    match kind {
        Kind::Position { .. } => (0, 3),
        Kind::Distance { .. } => (3, 1),
    }
}

fn check_free(free: &[usize]) -> PyResult<()> {
    if free.iter().any(|&k| k >= PARAMETERS) {
        return Err(shape("free", &format!("indices below {PARAMETERS}"), free));
    }
    Ok(())
}

type Readings = Vec<[f64; READINGS]>;

fn readings(
    expected: usize,
    readings: &PyReadonlyArray2<'_, f64>,
    weights: &PyReadonlyArray2<'_, f64>,
) -> PyResult<(Readings, Readings)> {
    let wanted = format!("({expected}, {READINGS})");
    let r = rows::<READINGS, _>("readings", readings)?;
    let w = rows::<READINGS, _>("weights", weights)?;
    if r.len() != expected {
        return Err(shape("readings", &wanted, readings.shape()));
    }
    if w.len() != expected {
        return Err(shape("weights", &wanted, weights.shape()));
    }
    Ok((r.to_vec(), w.to_vec()))
}

fn evaluate(
    model: &Model,
    solver: &mut Solver,
    mut errors: [f64; PARAMETERS],
    free: &[usize],
    rows: &Rows,
    readings: &[[f64; READINGS]],
    weights: &[[f64; READINGS]],
) -> PyResult<Vec<usize>> {
    let trial = solver.trial_values();
    if trial.len() != free.len() {
        return Err(shape("free", &format!("({},)", trial.len()), &[free.len()]));
    }
    for (&k, &value) in free.iter().zip(trial) {
        errors[k] = value;
    }
    // errors that leave no robot make every row unreachable
    let Ok(predictor) = model.with(&errors) else {
        return Ok((0..rows.len()).collect());
    };
    let mut missing = Vec::new();
    for (i, (reading, weight)) in readings.iter().zip(weights).enumerate() {
        if weight.iter().all(|w| *w == 0.0) {
            continue;
        }
        let kind = rows.kind(i);
        let Ok(prediction) = predictor.predict(&kind) else {
            missing.push(i);
            continue;
        };
        let (at, count) = place(&kind);
        for axis in 0..count {
            let residual = reading[at + axis] - prediction.value[axis];
            let row = free.iter().map(|&k| prediction.derivative[(axis, k)]);
            solver.add(row, residual, weight[at + axis]);
        }
    }
    Ok(missing)
}
