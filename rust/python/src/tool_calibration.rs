//! Calibration of the flexible tool from rows with known force and depth, and rigid transforms between clouds.
//!
//! A row that holds a number that is not finite is passed over, and marked so.

use crate::arrays::{rows, rows_like, same_length, shaped};
use crate::errors::{shape, to_python};
use crate::tool::ToolBeam;
use nalgebra::{SMatrix, Vector3};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sherkit_core::Error;
use sherkit_core::numbers::registration::{Method, Moments};
use sherkit_core::tool::calibration::{Bend, GainFit, Place, SlopeFit, fit_beam};

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

/// Gains `K` of the section at `distance_mm` from the tip, from wavelengths less those of the unloaded tool `(n, 3)`,
/// forces `(n, 2)` and depths `(n,)`; what a noise of the wavelengths (nm) flattens the gains by is taken back.
#[pyfunction]
#[pyo3(signature = (distance_mm, shifts_nm, forces_mn, depths_mm, noise_nm=0.0))]
pub fn tool_fit_gain<'py>(
    py: Python<'py>,
    distance_mm: f64,
    shifts_nm: PyReadonlyArray2<'_, f64>,
    forces_mn: PyReadonlyArray2<'_, f64>,
    depths_mm: PyReadonlyArray1<'_, f64>,
    noise_nm: f64,
) -> PyResult<Bound<'py, PyDict>> {
    let shifts = rows::<3, _>("shifts_nm", &shifts_nm)?;
    let forces = rows_like::<2>("forces_mn", &forces_mn, shifts.len())?;
    let depths = same_length("depths_mm", &depths_mm, shifts.len())?;
    let mut fit = GainFit::new(distance_mm).map_err(to_python)?;
    let mut used = Vec::with_capacity(shifts.len());
    for ((s, f), d) in shifts.iter().zip(forces).zip(depths) {
        used.push(taken(fit.push(s, f, *d))?);
    }
    let found = fit.solve(noise_nm).map_err(to_python)?;
    let out = PyDict::new(py);
    out.set_item("gain", matrix(py, &found.gain)?)?;
    let residual = matrix(py, &found.residual_covariance)?;
    out.set_item("residual_covariance", residual)?;
    out.set_item("unit_covariance", matrix(py, &found.unit_covariance)?)?;
    out.set_item("weakest", found.weakest)?;
    out.set_item("used", PyArray1::from_vec(py, used))?;
    Ok(out)
}

/// Stiffness `EI` and its standard deviation by the paper's slope, mN·mm², from forces, depths and deflections of the
/// shaft where the force acts `(n,)`.
#[pyfunction]
#[pyo3(signature = (length_mm, forces_mn, depths_mm, deflections_mm, intercept=false))]
pub fn tool_fit_slope(
    length_mm: f64,
    forces_mn: PyReadonlyArray1<'_, f64>,
    depths_mm: PyReadonlyArray1<'_, f64>,
    deflections_mm: PyReadonlyArray1<'_, f64>,
    intercept: bool,
) -> PyResult<(f64, f64)> {
    let forces = forces_mn.as_slice()?;
    let depths = same_length("depths_mm", &depths_mm, forces.len())?;
    let deflections = same_length("deflections_mm", &deflections_mm, forces.len())?;
    let mut fit = SlopeFit::new(length_mm).map_err(to_python)?;
    for ((f, d), x) in forces.iter().zip(depths).zip(deflections) {
        taken(fit.push(*f, *d, *x))?;
    }
    let found = fit.solve(intercept).map_err(to_python)?;
    Ok((found.value, found.deviation))
}

/// Length and stiffness together by least squares in the deflection, from forces, depths and deflections along the
/// force `(n,)`, measured at the contact or, where `at_tip` says so, at the tip.
#[pyfunction]
pub fn tool_fit_beam<'py>(
    py: Python<'py>,
    forces_mn: PyReadonlyArray1<'_, f64>,
    depths_mm: PyReadonlyArray1<'_, f64>,
    deflections_mm: PyReadonlyArray1<'_, f64>,
    at_tip: PyReadonlyArray1<'_, bool>,
    start: &ToolBeam,
) -> PyResult<Bound<'py, PyDict>> {
    let forces = forces_mn.as_slice()?;
    let n = forces.len();
    let depths = same_length("depths_mm", &depths_mm, n)?;
    let deflections = same_length("deflections_mm", &deflections_mm, n)?;
    let at_tip = same_length("at_tip", &at_tip, n)?;
    let bend = |i: usize| Bend {
        force_mn: forces[i],
        depth_mm: depths[i],
        deflection_mm: deflections[i],
        place: if at_tip[i] {
            Place::Tip
        } else {
            Place::Contact
        },
    };
    let finite =
        |b: &Bend| b.force_mn.is_finite() && b.depth_mm.is_finite() && b.deflection_mm.is_finite();
    let all: Vec<Bend> = (0..n).map(bend).collect();
    let used: Vec<bool> = all.iter().map(finite).collect();
    let bends: Vec<Bend> = all.into_iter().filter(finite).collect();
    let start = start.beam();
    let found = py.detach(|| fit_beam(&bends, &start)).map_err(to_python)?;
    let out = PyDict::new(py);
    out.set_item("length_mm", found.beam.length_mm())?;
    out.set_item("stiffness", found.beam.stiffness())?;
    out.set_item("covariance", matrix(py, &found.covariance)?)?;
    out.set_item("residual_mm", found.residual_mm)?;
    out.set_item("used", PyArray1::from_vec(py, used))?;
    Ok(out)
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
