//! The play operator.

use crate::arrays::same_length;
use numpy::{PyArray1, PyReadonlyArray1, PyUntypedArrayMethods};
use pyo3::prelude::*;
use sherkit_core::numbers::play::play as follow;

/// What follows `motion` (n,) with a dead zone of `width`.
#[pyfunction]
pub fn play<'py>(
    py: Python<'py>,
    motion: PyReadonlyArray1<'py, f64>,
    width: f64,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let motion = same_length("motion", &motion, motion.shape()[0])?;
    let mut out = vec![0.0; motion.len()];
    py.detach(|| follow(motion, width, &mut out));
    Ok(PyArray1::from_vec(py, out))
}
