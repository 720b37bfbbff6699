//! `DeltaModel`: predicted readings, their derivatives, and rows for the solver.

use crate::arrays::{fixed, rows, shaped};
use crate::errors::{shape, to_python};
use crate::kinematics::assembly;
use crate::solver::{Solver, iterate};
use nalgebra::Vector3;
use numpy::{
    PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use sherkit_core::delta::parameters::{PARAMETERS, Values};
use sherkit_core::delta::{Covariates, GEOMETRIC, Geometry, Kind, Model, Prediction, Row, Wanted};

/// Readings a row may have: x, y, z, distance.
const READINGS: usize = 4;

/// Covariates a row may have: time, temperature, three directions.
const COVARIATES: usize = 5;

/// A block of rows as it comes from Python: joints `(n, 3)`, the other ends of distances `(n, 3)`, covariates
/// `(n, 5)` (time s, temperature °C, three directions) and displacements of the measured point `(n, 3)`.
type Block<'py> = (
    PyReadonlyArray2<'py, f64>,
    Option<PyReadonlyArray2<'py, f64>>,
    Option<PyReadonlyArray2<'py, f64>>,
    Option<PyReadonlyArray2<'py, f64>>,
);

/// The rows of a block, copied, so that nobody else can write them while they are used. A row whose second end
/// is NaN is a position.
fn rows_of(block: &Block<'_>) -> PyResult<Vec<Row>> {
    let joints = rows::<3, _>("joints", &block.0)?;
    let n = joints.len();
    let to = optional::<3>("to_joints", block.1.as_ref(), n)?;
    let covariates = optional::<COVARIATES>("covariates", block.2.as_ref(), n)?;
    let push = optional::<3>("push", block.3.as_ref(), n)?;
    let row = |i: usize| Row {
        joints: joints[i],
        covariates: covariates.map_or(Covariates::NONE, |c| {
            let [time_s, temperature_c, d1, d2, d3] = c[i];
            Covariates {
                time_s,
                temperature_c,
                direction: [d1, d2, d3],
            }
        }),
        push: push.map_or_else(Vector3::zeros, |p| Vector3::from(p[i])),
        kind: match to {
            Some(to) if !to[i][0].is_nan() => Kind::Distance { to: to[i] },
            _ => Kind::Position,
        },
    };
    Ok((0..n).map(row).collect())
}

pub fn optional<'a, const N: usize>(
    name: &str,
    array: Option<&'a PyReadonlyArray2<'_, f64>>,
    n: usize,
) -> PyResult<Option<&'a [[f64; N]]>> {
    let Some(array) = array else { return Ok(None) };
    let found = rows::<N, _>(name, array)?;
    if found.len() != n {
        return Err(shape(name, &format!("({n}, {N})"), array.shape()));
    }
    Ok(Some(found))
}

/// A nominal delta whose geometric errors and datum are to be identified.
#[pyclass(frozen, module = "sherkit._core")]
pub struct DeltaModel(Model);

impl DeltaModel {
    /// The core's model.
    pub fn model(&self) -> &Model {
        &self.0
    }
}

#[pymethods]
impl DeltaModel {
    /// Number of parameters of the chain.
    #[classattr]
    const PARAMETERS: usize = PARAMETERS;

    /// `settings`: rod spacing, pole pitch, three home joint readings (mm), time origin, slip time (s).
    #[new]
    fn new(
        geometry: PyReadonlyArray1<'_, f64>,
        target_offset: PyReadonlyArray1<'_, f64>,
        assembly_mode: &str,
        settings: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Self> {
        let p = fixed::<GEOMETRIC, _>("geometry", &geometry)?;
        let geometry = Geometry::from_parameters(&p, assembly(assembly_mode)?);
        geometry.check().map_err(to_python)?;
        let [
            rod_spacing,
            pole_pitch,
            h1,
            h2,
            h3,
            time_origin_s,
            slip_time_s,
        ] = fixed::<7, _>("settings", &settings)?;
        Ok(Self(Model {
            geometry,
            target_offset: Vector3::from(fixed("target_offset", &target_offset)?),
            rod_spacing,
            pole_pitch,
            home: [h1, h2, h3],
            time_origin_s,
            slip_time_s,
        }))
    }

    /// Predicted readings `(n, 4)` (x, y, z, distance; what does not apply is zero) and which rows could be
    /// computed; the others are NaN.
    fn predict<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'_, f64>,
        block: Block<'_>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<bool>>)> {
        let chain = self.0.with(&fixed("values", &values)?).map_err(to_python)?;
        let rows = rows_of(&block)?;
        let mut out = vec![0.0; rows.len() * READINGS];
        let mut reached = vec![false; rows.len()];
        for ((row, out), ok) in rows
            .iter()
            .zip(out.chunks_exact_mut(READINGS))
            .zip(&mut reached)
        {
            if let Ok(value) = chain.row_value(row) {
                let (at, count) = place(&row.kind);
                out[at..at + count].copy_from_slice(&value.as_slice()[..count]);
                *ok = true;
            } else {
                out.fill(f64::NAN);
            }
        }
        Ok((
            shaped(py, out, [rows.len(), READINGS])?,
            PyArray1::from_vec(py, reached),
        ))
    }

    /// Derivatives by the parameters whose indices are given `(n, 4, free)`, by the joint readings `(n, 4, 3)`,
    /// by a displacement of the measured point `(n, 4, 3)`, and which rows could be computed.
    fn derivatives<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'_, f64>,
        block: Block<'_>,
        free: Vec<usize>,
    ) -> PyResult<Derivatives<'py>> {
        check_free(&free)?;
        let chain = self.0.with(&fixed("values", &values)?).map_err(to_python)?;
        let rows = rows_of(&block)?;
        let wanted = Wanted::of(&free);
        let n = rows.len();
        let mut by_parameters = vec![0.0; n * READINGS * free.len()];
        let mut by_joints = vec![0.0; n * READINGS * 3];
        let mut by_body = vec![0.0; n * READINGS * 3];
        let mut reached = vec![false; n];
        for (i, row) in rows.iter().enumerate() {
            let Ok(p) = chain.row_predict(row, wanted) else {
                by_parameters[i * READINGS * free.len()..][..READINGS * free.len()].fill(f64::NAN);
                by_joints[i * READINGS * 3..][..READINGS * 3].fill(f64::NAN);
                by_body[i * READINGS * 3..][..READINGS * 3].fill(f64::NAN);
                continue;
            };
            reached[i] = true;
            let (at, count) = place(&row.kind);
            for axis in 0..count {
                let line = i * READINGS + at + axis;
                let out = &mut by_parameters[line * free.len()..][..free.len()];
                for (o, &column) in out.iter_mut().zip(&free) {
                    *o = p.by_parameters[(axis, column)];
                }
                for k in 0..3 {
                    by_joints[line * 3 + k] = p.by_joints[(axis, k)];
                    by_body[line * 3 + k] = p.by_body[(axis, k)];
                }
            }
        }
        Ok((
            shaped(py, by_parameters, [n, READINGS, free.len()])?,
            shaped(py, by_joints, [n, READINGS, 3])?,
            shaped(py, by_body, [n, READINGS, 3])?,
            PyArray1::from_vec(py, reached),
        ))
    }

    /// Adds a block of rows to the solver at its trial. `values` holds the parameters that are not free.
    /// Returns the rows that cannot be computed there.
    fn accumulate(
        &self,
        solver: &mut Solver,
        values: PyReadonlyArray1<'_, f64>,
        free: Vec<usize>,
        block: Block<'_>,
        readings: PyReadonlyArray2<'_, f64>,
        weights: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Vec<usize>> {
        check_free(&free)?;
        let fixed_values = fixed("values", &values)?;
        let rows = rows_of(&block)?;
        let (readings, weights) = self::readings(rows.len(), &readings, &weights)?;
        evaluate(
            &self.0,
            solver,
            fixed_values,
            &free,
            &rows,
            &readings,
            &weights,
        )
    }

    /// Iterates to the minimum over rows in memory. Returns how it ended and the rows that cannot be computed at
    /// the start, with which nothing is solved.
    #[allow(
        clippy::too_many_arguments,
        reason = "one argument for each part of the problem"
    )]
    fn solve(
        &self,
        py: Python<'_>,
        solver: &mut Solver,
        values: PyReadonlyArray1<'_, f64>,
        free: Vec<usize>,
        block: Block<'_>,
        readings: PyReadonlyArray2<'_, f64>,
        weights: PyReadonlyArray2<'_, f64>,
        priors: bool,
    ) -> PyResult<(&'static str, Vec<usize>)> {
        check_free(&free)?;
        let fixed_values = fixed("values", &values)?;
        let rows = rows_of(&block)?;
        let (readings, weights) = self::readings(rows.len(), &readings, &weights)?;
        py.detach(|| {
            iterate(solver, priors, |solver| {
                evaluate(
                    &self.0,
                    solver,
                    fixed_values,
                    &free,
                    &rows,
                    &readings,
                    &weights,
                )
            })
        })
    }
}

type Derivatives<'py> = (
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<bool>>,
);

/// Where the readings of a row stand among the four, and how many there are.
fn place(kind: &Kind) -> (usize, usize) {
    match kind {
        Kind::Position => (0, 3),
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
    mut values: Values,
    free: &[usize],
    rows: &[Row],
    readings: &[[f64; READINGS]],
    weights: &[[f64; READINGS]],
) -> PyResult<Vec<usize>> {
    let trial = solver.trial_values();
    if trial.len() != free.len() {
        return Err(shape("free", &format!("({},)", trial.len()), &[free.len()]));
    }
    for (&k, &value) in free.iter().zip(trial) {
        values[k] = value;
    }
    // errors that leave no robot make every row unreachable
    let Ok(chain) = model.with(&values) else {
        return Ok((0..rows.len()).collect());
    };
    let wanted = Wanted::of(free);
    let mut prediction = Prediction::new();
    let mut missing = Vec::new();
    for (i, ((row, reading), weight)) in rows.iter().zip(readings).zip(weights).enumerate() {
        if weight.iter().all(|w| *w == 0.0) {
            continue;
        }
        if chain
            .row_predict_into(row, wanted, &mut prediction)
            .is_err()
        {
            missing.push(i);
            continue;
        }
        let (at, count) = place(&row.kind);
        for axis in 0..count {
            let residual = reading[at + axis] - prediction.value[axis];
            let line = free.iter().map(|&k| prediction.by_parameters[(axis, k)]);
            solver.add(line, residual, weight[at + axis]);
        }
    }
    Ok(missing)
}
