//! One frame for every robot: rows as they come from Python, predictions, derivatives, rows for the solver, the model of
//! the control loop. Bodies are generic functions; the macros hold the signatures that Python sees.

use crate::arrays::{Marked, Rows, fixed, marked, rows, rows_like, shaped};
use crate::errors::{shape, to_python};
use crate::lanes::{LaneMap, in_lanes};
use crate::problem;
use nalgebra::{SMatrix, SVector, Vector3};
use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use sherkit_core::Result;
use sherkit_core::chain::effects::{Effect, Wanted};
use sherkit_core::chain::{
    Aim, Chain, Covariates, Distances, Fixed, Prediction, REFERENCE_TEMPERATURE_C, Robot, Row,
};

/// A block of rows as it comes from Python: joints `(n, J)`, the other ends of distances `(n, J)`, covariates
/// `(n, 3 + 2 J)` (time s, temperature °C, directions, velocities, the number of the target and its payload where there are
/// several, and the temperature of the stands; a loop leaves out what follows the directions) and displacements of the measured point `(n, 3)`. Where distances are read from fixed centres and
/// planes, the other ends are the number of one or the other `(n, 2)`.
pub type Block<'py> = (
    PyReadonlyArray2<'py, f64>,
    Option<PyReadonlyArray2<'py, f64>>,
    Option<PyReadonlyArray2<'py, f64>>,
    Option<PyReadonlyArray2<'py, f64>>,
);

/// Targets, centres and planes are numbered up to here.
const MOST: usize = 16;

/// By parameters, joint readings and a displacement of the measured point, and which rows could be computed.
pub type Derivatives<'py> = (
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<bool>>,
);

/// Two derivatives for each row, and which rows could be computed.
pub type Both<'py> = (
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<bool>>,
);

/// A value for each row with its derivative, and which rows could be computed.
pub type WithDerivative<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<bool>>,
);

/// A value and its derivative by the joints.
pub type Single<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>);

// -- models ------------------------------------------------------------------------------------------------------------

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

/// The rows of a block, copied, so that nobody else can write them while they are used. A row whose other end is NaN is
/// no distance.
pub fn rows_of<const J: usize>(block: &Block<'_>) -> PyResult<Vec<Row<J>>> {
    rows_of_first(block, J, Distances::BetweenPlaces)
}

/// The same of a robot that has the first `k` joints alone: the others stand at zero.
pub fn rows_of_first<const J: usize>(
    block: &Block<'_>,
    k: usize,
    distances: Distances,
) -> PyResult<Vec<Row<J>>> {
    let fixed = distances == Distances::FromFixed;
    // the number of a centre, and that of a plane
    let wide = if fixed { 2 } else { k };
    let n = block.0.shape().first().copied().unwrap_or(0);
    let joints = table("joints", &block.0, n, k)?;
    let to = optional("to_joints", block.1.as_ref(), n, wide)?;
    let given = block.2.as_ref().and_then(|c| c.shape().last().copied());
    // an arm's rows have target and payload as well
    let known = given
        .filter(|width| [2 + k, 5 + 2 * k].contains(width))
        .unwrap_or(3 + 2 * k);
    // numbers are counted from one
    let counted = |number: f64| (0..MOST).find(|k| (k + 1) as f64 == number).unwrap_or(0);
    let covariates = optional("covariates", block.2.as_ref(), n, known)?;
    let push = optional("push", block.3.as_ref(), n, 3)?;
    let row = |i: usize| Row {
        joints: first(&joints[k * i..], k),
        to: to
            .filter(|_| !fixed)
            .map(|to| first(&to[k * i..], k))
            .filter(|to| !to[0].is_nan()),
        aim: Aim {
            target: covariates
                .filter(|_| known > 3 + 2 * k)
                .map_or(0, |c| counted(c[known * i + 2 + 2 * k])),
            from: to.filter(|_| fixed).and_then(|to| {
                let number = |at: usize| Some(to[2 * i + at]).filter(|x| !x.is_nan());
                let centre = number(0).map(|x| Fixed::Centre(counted(x)));
                centre.or_else(|| number(1).map(|x| Fixed::Plane(counted(x))))
            }),
        },
        covariates: covariates.map_or(Covariates::NONE, |c| {
            let c = &c[known * i..];
            Covariates {
                time_s: c[0],
                temperature_c: c[1],
                stand_c: if known == 2 + k {
                    REFERENCE_TEMPERATURE_C
                } else {
                    c[known - 1]
                },
                payload_kg: if known > 3 + 2 * k {
                    c[3 + 2 * k]
                } else {
                    f64::NAN
                },
                direction: first(&c[2..], k),
                velocity: if known == 2 + k {
                    [f64::NAN; J]
                } else {
                    first(&c[2 + k..], k)
                },
            }
        }),
        push: push.map_or_else(Vector3::zeros, |p| Vector3::from(several(&p[3 * i..]))),
    };
    Ok((0..n).map(row).collect())
}

/// The first `k` numbers, then zeros.
pub fn first<const N: usize>(numbers: &[f64], k: usize) -> [f64; N] {
    std::array::from_fn(|i| if i < k { numbers[i] } else { 0.0 })
}

fn several<const N: usize>(numbers: &[f64]) -> [f64; N] {
    std::array::from_fn(|k| numbers[k])
}

fn optional<'a>(
    name: &str,
    array: Option<&'a PyReadonlyArray2<'_, f64>>,
    n: usize,
    width: usize,
) -> PyResult<Option<&'a [f64]>> {
    array.map(|array| table(name, array, n, width)).transpose()
}

/// The numbers of an array of as many rows as there are others.
pub fn table<'a>(
    name: &str,
    array: &'a PyReadonlyArray2<'_, f64>,
    n: usize,
    width: usize,
) -> PyResult<&'a [f64]> {
    let wrong = || shape(name, &format!("({n}, {width}), contiguous"), array.shape());
    if array.shape() != [n, width] {
        return Err(wrong());
    }
    array.as_slice().map_err(|_| wrong())
}

/// Refuses indices that are no parameter's.
pub fn check_free<const P: usize>(free: &[usize]) -> PyResult<()> {
    if free.iter().any(|&k| k >= P) {
        return Err(shape("free", &format!("indices below {P}"), free));
    }
    Ok(())
}

/// Columns that the readings of a robot have: what its sensor shows, and a distance where it can be read.
pub fn columns<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize>() -> usize {
    M + usize::from(R::DISTANCES != Distances::None)
}

/// Where the readings of a row stand among the columns, and how many there are.
pub fn place<const J: usize, const M: usize>(row: &Row<J>) -> (usize, usize) {
    if row.is_distance() { (M, 1) } else { (0, M) }
}

/// The rows of a block of this robot.
pub fn own_rows<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize>(
    model: &R,
    block: &Block<'_>,
) -> PyResult<Vec<Row<J>>> {
    if let (Distances::None, Some(to)) = (R::DISTANCES, &block.1) {
        return Err(shape(
            "to_joints",
            "None: this robot reads no distances",
            to.shape(),
        ));
    }
    rows_of_first(block, model.joints(), R::DISTANCES)
}

/// The robot with the given values of all its parameters.
pub fn chain<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize>(
    model: &R,
    values: &PyReadonlyArray1<'_, f64>,
) -> PyResult<Chain<R, J, M, P>> {
    model.with(&fixed("values", values)?).map_err(to_python)
}

/// A result `(n, N)` for each row; those that cannot be computed are NaN and marked.
pub fn each<'py, Q, const N: usize>(
    py: Python<'py>,
    rows: &[Q],
    of: impl Fn(&Q) -> Result<SVector<f64, N>> + Sync,
) -> PyResult<Marked<'py, PyArray2<f64>>>
where
    Q: Sync,
{
    let mut out = vec![f64::NAN; rows.len() * N];
    let mut reached = vec![false; rows.len()];
    py.detach(|| {
        for ((row, out), ok) in rows
            .iter()
            .zip(out.as_chunks_mut::<N>().0)
            .zip(&mut reached)
        {
            if let Ok(value) = of(row) {
                *out = value.into();
                *ok = true;
            }
        }
    });
    marked(py, out, reached, N)
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
    let (out, reached) = py.detach(|| problem::predicted(&chain, &rows));
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
                $crate::robot::catalogue(py, $robot::CATALOGUE)
            }

            /// Predicted readings `(n, m)` and which rows could be computed; the others are NaN.
            fn predict<'py>(
                &self,
                py: Python<'py>,
                values: PyReadonlyArray1<'_, f64>,
                block: Block<'_>,
            ) -> PyResult<Marked<'py, PyArray2<f64>>> {
                $crate::robot::predict(py, &self.0, &values, &block)
            }

            /// Points of the mechanism's parts `(n, k, 3)`, mm, the measured point last, and which rows could be computed.
            fn parts<'py>(
                &self,
                py: Python<'py>,
                values: PyReadonlyArray1<'_, f64>,
                block: Block<'_>,
            ) -> PyResult<Marked<'py, numpy::PyArray3<f64>>> {
                $crate::robot::parts(py, &self.0, &values, &block)
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
                $crate::robot::derivatives(py, &self.0, &values, &block, &free)
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
                priors: bool,
            ) -> PyResult<(&'static str, Vec<usize>)> {
                let taken = (&readings, &weights);
                let problem = $crate::problem::Problem::new(&self.0, solver, &values, free, &block, taken)?;
                problem.solve(py, solver, priors, |problem, solver| problem.readings(solver))
            }

            $($own)*
        }
    };
}
pub(crate) use model_class;

// -- kinematics and control loops --------------------------------------------------------------------------------------

/// The vector of a Python array.
pub fn vector<const N: usize>(
    name: &str,
    array: &PyReadonlyArray1<'_, f64>,
) -> PyResult<SVector<f64, N>> {
    Ok(SVector::from(fixed("", array).map_err(|_| {
        shape(name, &format!("({N},), contiguous"), array.shape())
    })?))
}

/// A map of one vector.
pub fn one<'py, const N: usize, const O: usize>(
    py: Python<'py>,
    name: &str,
    array: &PyReadonlyArray1<'_, f64>,
    of: impl Fn(&SVector<f64, N>) -> Result<SVector<f64, O>>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let found = of(&vector(name, array)?).map_err(to_python)?;
    Ok(PyArray1::from_slice(py, found.as_slice()))
}

/// A map of many vectors, in lanes.
pub fn many<'py, const N: usize, const O: usize>(
    py: Python<'py>,
    name: &str,
    array: &PyReadonlyArray2<'_, f64>,
    map: impl LaneMap<N, O>,
) -> PyResult<Marked<'py, PyArray2<f64>>> {
    let from = rows::<N, _>(name, array)?;
    let n = from.len();
    // SAFETY: nobody else knows the new arrays, and every number of both is written; not detached, so that nobody
    // writes to `from` meanwhile
    let (found, reached) = unsafe {
        let found = PyArray2::<f64>::new(py, [n, O], false);
        let reached = PyArray1::<bool>::new(py, [n], false);
        let out = found.as_slice_mut()?.as_chunks_mut::<O>().0;
        in_lanes(from, out, reached.as_slice_mut()?, map);
        (found, reached)
    };
    Ok((found, reached))
}

/// Two matrices for each of many vectors `(n, R, A)` and `(n, R, B)`; where they cannot be computed they are NaN and marked.
pub fn both<'py, const N: usize, const R: usize, const A: usize, const B: usize>(
    py: Python<'py>,
    name: &str,
    array: &PyReadonlyArray2<'_, f64>,
    of: impl Fn(&SVector<f64, N>) -> Option<(SMatrix<f64, R, A>, SMatrix<f64, R, B>)> + Sync,
) -> PyResult<Both<'py>> {
    let vectors = rows::<N, _>(name, array)?.to_vec();
    let n = vectors.len();
    let (mut first, mut second) = (Rows::new(n, R, A), Rows::new(n, R, B));
    let mut reached = vec![false; n];
    py.detach(|| {
        for (i, vector) in vectors.iter().enumerate() {
            if let Some((a, b)) = of(&SVector::from(*vector)) {
                first.put(i, &a);
                second.put(i, &b);
                reached[i] = true;
            }
        }
    });
    Ok((
        first.matrices(py)?,
        second.matrices(py)?,
        PyArray1::from_vec(py, reached),
    ))
}

/// What a control loop knows besides the joints: time s, temperature °C, a direction for each joint. It commands places,
/// so velocities are zero.
pub fn now<const J: usize>(numbers: &[f64]) -> PyResult<Covariates<J>> {
    if numbers.len() != 2 + J {
        return Err(shape(
            "covariates",
            &format!("({},)", 2 + J),
            &[numbers.len()],
        ));
    }
    Ok(Covariates {
        time_s: numbers[0],
        temperature_c: numbers[1],
        stand_c: REFERENCE_TEMPERATURE_C,
        payload_kg: f64::NAN,
        direction: several(&numbers[2..]),
        velocity: [0.0; J],
    })
}

/// A calibrated robot of as many coordinates as joints.
pub trait Calibrated<const N: usize> {
    /// What computes.
    type Core<'a>: Sync
    where
        Self: 'a;
    /// The core's robot.
    fn core(&self) -> PyResult<Self::Core<'_>>;
    /// All that makes it, number by number.
    fn write(&self, put: impl FnMut(f64)) -> PyResult<()>;
    /// Where it is at joint readings, with the derivative by them.
    fn forward_at(
        core: &Self::Core<'_>,
        joints: &SVector<f64, N>,
        now: &Covariates<N>,
    ) -> Result<(SVector<f64, N>, SMatrix<f64, N, N>)>;
    /// Joint readings at which it is somewhere.
    fn inverse_at(
        core: &Self::Core<'_>,
        place: &SVector<f64, N>,
        now: &Covariates<N>,
    ) -> Result<SVector<f64, N>>;
}

/// Where a calibrated robot is at joint readings `(N,)`, and the derivative by them `(N, N)`.
pub fn forward<'py, T: Calibrated<N>, const N: usize>(
    py: Python<'py>,
    robot: &T,
    joints: &PyReadonlyArray1<'_, f64>,
    covariates: &[f64],
) -> PyResult<Single<'py>> {
    let (q, now) = (vector("joints", joints)?, now(covariates)?);
    let (x, j) = T::forward_at(&robot.core()?, &q, &now).map_err(to_python)?;
    Ok((
        PyArray1::from_slice(py, x.as_slice()),
        shaped(py, j.transpose().as_slice().to_vec(), [N, N])?,
    ))
}

/// The same for many joint readings `(n, N)`; those out of reach are NaN and marked.
pub fn forward_batch<'py, T: Calibrated<N>, const N: usize>(
    py: Python<'py>,
    robot: &T,
    joints: &PyReadonlyArray2<'_, f64>,
    covariates: &[f64],
) -> PyResult<WithDerivative<'py>> {
    let (core, now) = (robot.core()?, now(covariates)?);
    let q = rows::<N, _>("joints", joints)?.to_vec();
    let (mut places, mut by_joints) = (Rows::new(q.len(), N, 1), Rows::new(q.len(), N, N));
    let mut reached = vec![false; q.len()];
    py.detach(|| {
        for (i, q) in q.iter().enumerate() {
            if let Ok((x, j)) = T::forward_at(&core, &SVector::from(*q), &now) {
                places.put(i, &x);
                by_joints.put(i, &j);
                reached[i] = true;
            }
        }
    });
    Ok((
        places.vectors(py)?,
        by_joints.matrices(py)?,
        PyArray1::from_vec(py, reached),
    ))
}

/// A calibrated class: its constructor and what it has beyond others in braces, what every one has from the frame.
macro_rules! calibrated_class {
    ($class:ident, $n:literal, $place:ident, $places:ident, { $($own:tt)* }) => {
        #[pymethods]
        impl $class {
            /// All that makes it as a row of numbers `(n,)`, for a control loop in another language.
            fn flat<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
                let mut numbers = Vec::new();
                self.write(|x| numbers.push(x))?;
                Ok(PyArray1::from_vec(py, numbers))
            }

            /// Where it is at joint readings, and the derivative by them, row by row.
            fn forward<'py>(
                &self,
                py: Python<'py>,
                joints: PyReadonlyArray1<'_, f64>,
                covariates: Vec<f64>,
            ) -> PyResult<Single<'py>> {
                $crate::robot::forward(py, self, &joints, &covariates)
            }

            /// The same for many joint readings, and which are in reach; the others are NaN.
            fn forward_batch<'py>(
                &self,
                py: Python<'py>,
                joints: PyReadonlyArray2<'_, f64>,
                covariates: Vec<f64>,
            ) -> PyResult<WithDerivative<'py>> {
                $crate::robot::forward_batch(py, self, &joints, &covariates)
            }

            /// Joint readings at which it is there.
            fn inverse<'py>(
                &self,
                py: Python<'py>,
                $place: PyReadonlyArray1<'_, f64>,
                covariates: Vec<f64>,
            ) -> PyResult<Bound<'py, PyArray1<f64>>> {
                let (core, now) = (self.core()?, now(&covariates)?);
                one(py, stringify!($place), &$place, |x| Self::inverse_at(&core, x, &now))
            }

            /// Joint readings for many places, and which are in reach; the others are NaN.
            fn inverse_batch<'py>(
                &self,
                py: Python<'py>,
                $places: PyReadonlyArray2<'_, f64>,
                covariates: Vec<f64>,
            ) -> PyResult<Marked<'py, PyArray2<f64>>> {
                let (core, now) = (self.core()?, now(&covariates)?);
                let places = rows::<$n, _>(stringify!($places), &$places)?.to_vec();
                each(py, &places, |x| Self::inverse_at(&core, &(*x).into(), &now))
            }

            $($own)*
        }
    };
}
pub(crate) use calibrated_class;

/// A copy of rows of as many numbers as there are others.
pub fn copied<const N: usize>(
    name: &str,
    array: &PyReadonlyArray2<'_, f64>,
    n: usize,
) -> PyResult<Vec<[f64; N]>> {
    Ok(rows_like::<N>(name, array, n)?.to_vec())
}
