//! Maps of one vector or of many, as Python gives and takes them.

use crate::arrays::{Marked, Rows, fixed, marked, rows};
use crate::errors::{shape, to_python};
use crate::lanes::{LaneMap, in_lanes};
use nalgebra::{SMatrix, SVector};
use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use sherkit_core::Result;

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
