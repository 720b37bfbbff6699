//! One frame for the models of all robots: predictions, derivatives, rows for the solver. Bodies are generic functions; the
//! macro holds the signatures that Python sees.

use crate::arrays::{Marked, fixed, marked, shaped};
use crate::errors::to_python;
use crate::problem::predicted;
use crate::rows::{Block, check_free, columns, own_rows, place};
use nalgebra::Vector3;
use numpy::{PyArray1, PyArray2, PyArray3, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use sherkit_core::chain::effects::{Effect, Wanted};
use sherkit_core::chain::{Chain, Prediction, Robot};

/// By parameters, joint readings and a displacement of the measured point, and which rows could be computed.
pub type Derivatives<'py> = (
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<bool>>,
);

/// The table of a robot for Python.
pub fn catalogue<'py>(py: Python<'py>, table: &[Effect]) -> PyResult<Bound<'py, PyList>> {
    let out = PyList::empty(py);
    for effect in table {
        let parameters = PyList::empty(py);
        for p in effect.parameters {
            let one = PyDict::new(py);
            one.set_item("name", p.name)?;
            one.set_item("symbol", p.symbol)?;
            one.set_item("unit", p.unit)?;
            one.set_item("size", p.size)?;
            one.set_item("lever_mm", (!p.lever_mm.is_nan()).then_some(p.lever_mm))?;
            parameters.append(one)?;
        }
        let row = PyDict::new(py);
        row.set_item("name", effect.name)?;
        row.set_item("link", effect.link.name())?;
        row.set_item("base", effect.base)?;
        row.set_item("needs", effect.needs)?;
        row.set_item("search", effect.search)?;
        row.set_item("parameters", parameters)?;
        out.append(row)?;
    }
    Ok(out)
}

/// The robot with the given values of all its parameters.
pub fn chain<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize>(
    model: &R,
    values: &PyReadonlyArray1<'_, f64>,
) -> PyResult<Chain<R, J, M, P>> {
    model.with(&fixed("values", values)?).map_err(to_python)
}

/// Predicted readings, and which rows could be computed; the others are NaN.
pub fn predict<'py, R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize>(
    py: Python<'py>,
    model: &R,
    values: &PyReadonlyArray1<'_, f64>,
    block: &Block<'_>,
) -> PyResult<Marked<'py, PyArray2<f64>>>
where
    Chain<R, J, M, P>: Sync,
{
    let chain = chain(model, values)?;
    let rows = own_rows::<R, J, M, P>(model, block)?;
    let (out, reached) = py.detach(|| predicted(&chain, &rows));
    marked(py, out, reached, columns::<R, J, M, P>())
}

/// Points of the mechanism's parts at each row `(n, k, 3)`, the measured point last, and which rows could be computed.
pub fn parts<'py, R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize>(
    py: Python<'py>,
    model: &R,
    values: &PyReadonlyArray1<'_, f64>,
    block: &Block<'_>,
) -> PyResult<Marked<'py, PyArray3<f64>>>
where
    Chain<R, J, M, P>: Sync,
{
    let chain = chain(model, values)?;
    let rows = own_rows::<R, J, M, P>(model, block)?;
    let found: Vec<Option<Vec<f64>>> = py.detach(|| {
        let of = |row| {
            let mut points = Vec::new();
            let put = |p: Vector3<f64>| points.extend_from_slice(p.as_slice());
            chain.row_parts(row, put).ok().map(|()| points)
        };
        rows.iter().map(of).collect()
    });
    // as many at every pose; none is known where no row can be computed
    let width = found.iter().flatten().next().map_or(0, Vec::len);
    let mut out = vec![f64::NAN; rows.len() * width];
    let mut reached = vec![false; rows.len()];
    for (i, points) in found.iter().enumerate() {
        if let Some(points) = points {
            out[i * width..][..width].copy_from_slice(points);
            reached[i] = true;
        }
    }
    Ok((
        shaped(py, out, [rows.len(), width / 3, 3])?,
        PyArray1::from_vec(py, reached),
    ))
}

/// Derivatives by the parameters whose indices are given, by the joint readings and by a displacement of the measured
/// point, and which rows could be computed.
pub fn derivatives<'py, R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize>(
    py: Python<'py>,
    model: &R,
    values: &PyReadonlyArray1<'_, f64>,
    block: &Block<'_>,
    free: &[usize],
) -> PyResult<Derivatives<'py>>
where
    Chain<R, J, M, P>: Sync,
{
    check_free::<P>(free)?;
    let chain = chain(model, values)?;
    let (rows, width) = (
        own_rows::<R, J, M, P>(model, block)?,
        columns::<R, J, M, P>(),
    );
    let wanted = Wanted::of(R::CATALOGUE, free);
    let (n, lines) = (rows.len(), rows.len() * width);
    let joints = model.joints();
    let mut by_parameters = vec![0.0; lines * free.len()];
    let mut by_joints = vec![0.0; lines * joints];
    let mut by_body = vec![0.0; lines * 3];
    let mut reached = vec![false; n];
    py.detach(|| {
        let mut p = Prediction::new();
        for (i, row) in rows.iter().enumerate() {
            if chain.row_predict_into(row, wanted, &mut p).is_err() {
                by_parameters[i * width * free.len()..][..width * free.len()].fill(f64::NAN);
                by_joints[i * width * joints..][..width * joints].fill(f64::NAN);
                by_body[i * width * 3..][..width * 3].fill(f64::NAN);
                continue;
            }
            reached[i] = true;
            let (at, count) = place::<J, M>(row);
            for axis in 0..count {
                let line = i * width + at + axis;
                let out = &mut by_parameters[line * free.len()..][..free.len()];
                for (o, &column) in out.iter_mut().zip(free) {
                    *o = p.by_parameters[(axis, column)];
                }
                for k in 0..joints {
                    by_joints[line * joints + k] = p.by_joints[(axis, k)];
                }
                for k in 0..3 {
                    by_body[line * 3 + k] = p.by_body[(axis, k)];
                }
            }
        }
    });
    Ok((
        shaped(py, by_parameters, [n, width, free.len()])?,
        shaped(py, by_joints, [n, width, joints])?,
        shaped(py, by_body, [n, width, 3])?,
        PyArray1::from_vec(py, reached),
    ))
}

/// A model class: its constructor and what it has beyond others in braces, what every model has from the frame.
macro_rules! model_class {
    ($class:ident, $model:ty, $robot:ident, { $($own:tt)* }) => {
        #[pymethods]
        impl $class {
            /// Number of parameters of the chain.
            #[classattr]
            const PARAMETERS: usize = $robot::PARAMETERS;

            /// The parameters of the chain in its order, effect by effect: names, units, plausible sizes, levers.
            #[classattr]
            #[pyo3(name = "CATALOGUE")]
            fn catalogue(py: Python<'_>) -> PyResult<Bound<'_, pyo3::types::PyList>> {
                $crate::model::catalogue(py, $robot::CATALOGUE)
            }

            /// Predicted readings `(n, m)` and which rows could be computed; the others are NaN.
            fn predict<'py>(
                &self,
                py: Python<'py>,
                values: PyReadonlyArray1<'_, f64>,
                block: Block<'_>,
            ) -> PyResult<Marked<'py, PyArray2<f64>>> {
                $crate::model::predict(py, &self.0, &values, &block)
            }

            /// Points of the mechanism's parts `(n, k, 3)`, mm, the measured point last, and which rows could be computed.
            fn parts<'py>(
                &self,
                py: Python<'py>,
                values: PyReadonlyArray1<'_, f64>,
                block: Block<'_>,
            ) -> PyResult<Marked<'py, numpy::PyArray3<f64>>> {
                $crate::model::parts(py, &self.0, &values, &block)
            }

            /// Derivatives by the parameters whose indices are given `(n, m, free)`, by the joint readings `(n, m, J)`,
            /// by a displacement of the measured point `(n, m, 3)`, and which rows could be computed.
            fn derivatives<'py>(
                &self,
                py: Python<'py>,
                values: PyReadonlyArray1<'_, f64>,
                block: Block<'_>,
                free: Vec<usize>,
            ) -> PyResult<Derivatives<'py>> {
                $crate::model::derivatives(py, &self.0, &values, &block, &free)
            }

            /// Adds a block of rows to the solver at its trial. `values` holds the parameters that are not free.
            /// Returns the rows that cannot be computed there.
            #[allow(clippy::too_many_arguments, reason = "one argument for each part of the problem")]
            fn accumulate(
                &self,
                py: Python<'_>,
                solver: &mut Solver,
                values: PyReadonlyArray1<'_, f64>,
                free: Vec<usize>,
                block: Block<'_>,
                readings: PyReadonlyArray2<'_, f64>,
                weights: PyReadonlyArray2<'_, f64>,
            ) -> PyResult<Vec<usize>> {
                let taken = (&readings, &weights);
                let problem = $crate::problem::Problem::new(&self.0, solver, &values, free, &block, taken)?;
                Ok(py.detach(|| problem.readings(solver)))
            }

            /// Iterates to the minimum over rows in memory. Returns how it ended and the rows that cannot be computed
            /// at the start, with which nothing is solved.
            #[allow(clippy::too_many_arguments, reason = "one argument for each part of the problem")]
            fn solve(
                &self,
                py: Python<'_>,
                solver: &mut Solver,
                values: PyReadonlyArray1<'_, f64>,
                free: Vec<usize>,
                block: Block<'_>,
                readings: PyReadonlyArray2<'_, f64>,
                weights: PyReadonlyArray2<'_, f64>,
            ) -> PyResult<(&'static str, Vec<usize>)> {
                let taken = (&readings, &weights);
                let problem = $crate::problem::Problem::new(&self.0, solver, &values, free, &block, taken)?;
                problem.solve(py, solver, |problem, solver| problem.readings(solver))
            }

            $($own)*
        }
    };
}
pub(crate) use model_class;
