//! `NumPy` arrays in and out, with their shapes checked.

use crate::errors::shape;
use numpy::ndarray::Dimension;
use numpy::{
    IntoPyArray, PyArray, PyArrayMethods, PyReadonlyArray, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

/// An array, and which of its rows could be computed.
pub type Marked<'py, A> = (Bound<'py, A>, Bound<'py, numpy::PyArray1<bool>>);

/// The numbers of a contiguous array of rows of `N`.
pub fn rows<'a, const N: usize, D: Dimension>(
    name: &str,
    array: &'a PyReadonlyArray<'_, f64, D>,
) -> PyResult<&'a [[f64; N]]> {
    let dims = array.shape();
    let expected = || format!("(n, {N}), contiguous");
    if dims.len() != 2 || dims.last() != Some(&N) {
        return Err(shape(name, &expected(), dims));
    }
    let flat = array
        .as_slice()
        .map_err(|_| shape(name, &expected(), dims))?;
    Ok(flat.as_chunks::<N>().0)
}

/// A fixed number of numbers.
pub fn fixed<const N: usize, D: Dimension>(
    name: &str,
    array: &PyReadonlyArray<'_, f64, D>,
) -> PyResult<[f64; N]> {
    let wrong = || shape(name, &format!("({N},), contiguous"), array.shape());
    array
        .as_slice()
        .map_err(|_| wrong())?
        .try_into()
        .map_err(|_| wrong())
}

/// Rows of `N`, as many as there are others.
pub fn rows_like<'a, const N: usize>(
    name: &str,
    array: &'a PyReadonlyArray2<'_, f64>,
    n: usize,
) -> PyResult<&'a [[f64; N]]> {
    let found = rows::<N, _>(name, array)?;
    if found.len() != n {
        return Err(shape(name, &format!("({n}, {N})"), array.shape()));
    }
    Ok(found)
}

/// As many numbers as there are rows.
pub fn same_length<'a, T: numpy::Element>(
    name: &str,
    array: &'a PyReadonlyArray1<'_, T>,
    n: usize,
) -> PyResult<&'a [T]> {
    let wrong = || shape(name, &format!("({n},), contiguous"), array.shape());
    let found = array.as_slice().map_err(|_| wrong())?;
    if found.len() != n {
        return Err(wrong());
    }
    Ok(found)
}

/// A new array of the given shape from its numbers.
pub fn shaped<T: numpy::Element, const K: usize>(
    py: Python<'_>,
    numbers: Vec<T>,
    dims: [usize; K],
) -> PyResult<Bound<'_, PyArray<T, numpy::ndarray::Dim<[usize; K]>>>>
where
    numpy::ndarray::Dim<[usize; K]>: Dimension,
    [usize; K]: numpy::ndarray::IntoDimension<Dim = numpy::ndarray::Dim<[usize; K]>>,
{
    numbers.into_pyarray(py).reshape(dims)
}

/// Rows of `width` numbers, and which of them could be computed.
pub fn marked(
    py: Python<'_>,
    values: Vec<f64>,
    reached: Vec<bool>,
    width: usize,
) -> PyResult<Marked<'_, numpy::PyArray2<f64>>> {
    Ok((
        shaped(py, values, [reached.len(), width])?,
        numpy::PyArray1::from_vec(py, reached),
    ))
}
