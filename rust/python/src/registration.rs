//! Rigid transforms between clouds of points.
//!
//! A row that holds a number that is not finite is passed over, and marked so.

use crate::arrays::{rows, rows_like, shaped};
use crate::errors::{shape, to_python};
use nalgebra::{SMatrix, Vector3};
use numpy::{PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sherkit_core::Error;
use sherkit_core::numbers::registration::{Method, Moments, of_most};
use sherkit_core::numbers::rigid::Rigid;

/// A small matrix as an array.
fn matrix<'py, const R: usize, const C: usize>(
    py: Python<'py>,
    m: &SMatrix<f64, R, C>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let rows = (0..R).flat_map(|i| (0..C).map(move |j| m[(i, j)]));
    shaped(py, rows.collect(), [R, C])
}

/// Whether a row was taken; what is not finite is no failure.
fn taken(pushed: sherkit_core::Result<()>) -> PyResult<bool> {
    match pushed {
        Ok(()) => Ok(true),
        Err(Error::NotFinite { .. }) => Ok(false),
        Err(error) => Err(to_python(error)),
    }
}

fn method_of(name: &str) -> PyResult<Method> {
    match name {
        "quaternion" => Ok(Method::Quaternion),
        "svd" => Ok(Method::SingularValues),
        _ => Err(shape("method", "'quaternion' or 'svd'", &[])),
    }
}

/// The rigid transform that takes points `(n, 3)` to points `(n, 3)`, mm.
#[pyfunction]
#[pyo3(signature = (source, target, method="quaternion"))]
pub fn register_points<'py>(
    py: Python<'py>,
    source: PyReadonlyArray2<'_, f64>,
    target: PyReadonlyArray2<'_, f64>,
    method: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let method = method_of(method)?;
    let from = rows::<3, _>("source", &source)?;
    let to = rows_like::<3>("target", &target, from.len())?;
    let mut moments = Moments::default();
    let mut used = Vec::with_capacity(from.len());
    for (a, b) in from.iter().zip(to) {
        used.push(taken(moments.push(&Vector3::from(*a), &Vector3::from(*b)))?);
    }
    let found = moments.solve(method).map_err(to_python)?;
    let mut left = Vec::with_capacity(from.len() * 3);
    for (a, b) in from.iter().zip(to) {
        let miss = Vector3::from(*b) - found.transform.apply(&Vector3::from(*a));
        left.extend_from_slice(miss.as_slice());
    }
    let out = PyDict::new(py);
    out.set_item("rotation", matrix(py, &found.transform.rotation)?)?;
    let shift = found.transform.translation;
    out.set_item("translation_mm", PyArray1::from_slice(py, shift.as_slice()))?;
    out.set_item("residuals_mm", shaped(py, left, [from.len(), 3])?)?;
    out.set_item("residual_variance", found.residual_variance)?;
    out.set_item("width_ratio", found.width_ratio)?;
    out.set_item("unit_covariance", matrix(py, &found.unit_covariance)?)?;
    out.set_item("used", PyArray1::from_vec(py, used))?;
    Ok(out)
}

/// The transform that takes most points `(n, 3)` to where they were read `(n, 3)`, mm: turn, shift, and by how much half of
/// them are off or less; None where too few tell it, or these stand in a line.
#[pyfunction]
#[pyo3(signature = (points, read, *, mirrored=false, fewest=4))]
pub fn register_most<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'_, f64>,
    read: PyReadonlyArray2<'_, f64>,
    mirrored: bool,
    fewest: usize,
) -> PyResult<Option<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>, f64)>> {
    let from = rows::<3, _>("points", &points)?;
    let to = rows_like::<3>("read", &read, from.len())?;
    let pairs = from.iter().zip(to);
    let pairs = pairs.map(|(a, b)| (Vector3::from(*a), Vector3::from(*b)));
    let (mut missed, mut room) = (vec![0.0; from.len()], vec![0.0; from.len()]);
    let Some((found, half)) = of_most(pairs, mirrored, fewest, &mut missed, &mut room) else {
        return Ok(None);
    };
    let shift = PyArray1::from_slice(py, found.translation.as_slice());
    Ok(Some((matrix(py, &found.rotation)?, shift, half)))
}

/// A turn `(3, 3)` as a rotation vector `(3,)`, rad.
#[pyfunction]
pub fn rotation_vector<'py>(
    py: Python<'py>,
    turn: PyReadonlyArray2<'_, f64>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let given = rows_like::<3>("turn", &turn, 3)?;
    let rotation = nalgebra::Matrix3::from_fn(|i, j| given[i][j]);
    let rigid = Rigid {
        rotation,
        ..Rigid::identity()
    };
    Ok(PyArray1::from_slice(py, rigid.rotation_vector().as_slice()))
}
