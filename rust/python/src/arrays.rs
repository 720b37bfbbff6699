//! `NumPy` arrays in and out, with their shapes checked.

use crate::errors::shape;
use nalgebra::{Matrix3, SMatrix, Vector3};
use numpy::ndarray::Dimension;
use numpy::{
    IntoPyArray, PyArray, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray, PyReadonlyArray1,
    PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use sherkit_core::chain::Frame;
use sherkit_core::numbers::rigid::Rigid;

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

/// A period of each of `count` joints: its own where they are given, else the one of all.
pub fn periods<const N: usize>(
    count: usize,
    common: f64,
    own: Option<&PyReadonlyArray1<'_, f64>>,
) -> PyResult<[f64; N]> {
    let mut out = [common; N];
    if let Some(own) = own {
        let wrong = || shape("periods", &format!("({count},), contiguous"), own.shape());
        let found = own.as_slice().map_err(|_| wrong())?;
        let to = out.get_mut(..count).ok_or_else(wrong)?;
        if found.len() != count {
            return Err(wrong());
        }
        to.copy_from_slice(found);
    }
    Ok(out)
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

/// A matrix of as many numbers for each of many rows, NaN until it is put.
pub struct Rows {
    numbers: Vec<f64>,
    shape: [usize; 3],
}

impl Rows {
    /// `n` matrices of `lines` and `columns`.
    pub fn new(n: usize, lines: usize, columns: usize) -> Self {
        Self {
            numbers: vec![f64::NAN; n * lines * columns],
            shape: [n, lines, columns],
        }
    }

    fn line(&mut self, row: usize, line: usize) -> &mut [f64] {
        let [_, lines, columns] = self.shape;
        &mut self.numbers[(row * lines + line) * columns..][..columns]
    }

    /// The matrix of a row.
    pub fn put<const R: usize, const C: usize>(&mut self, row: usize, matrix: &SMatrix<f64, R, C>) {
        for (k, numbers) in matrix.row_iter().enumerate() {
            // a robot with fewer joints than there may be has fewer columns
            for (out, number) in self.line(row, k).iter_mut().zip(numbers.iter()) {
                *out = *number;
            }
        }
    }

    /// The matrix of a row is these columns of another.
    pub fn put_columns<const R: usize, const C: usize>(
        &mut self,
        row: usize,
        matrix: &SMatrix<f64, R, C>,
        columns: &[usize],
    ) {
        for k in 0..R {
            for (out, &column) in self.line(row, k).iter_mut().zip(columns) {
                *out = matrix[(k, column)];
            }
        }
    }

    /// All of them, one after the other.
    pub fn numbers(self) -> Vec<f64> {
        self.numbers
    }

    /// As an array `(n, lines)` of matrices with one column.
    pub fn vectors(self, py: Python<'_>) -> PyResult<Bound<'_, PyArray2<f64>>> {
        let [n, lines, _] = self.shape;
        shaped(py, self.numbers, [n, lines])
    }

    /// As an array `(n, lines, columns)`.
    pub fn matrices(self, py: Python<'_>) -> PyResult<Bound<'_, PyArray3<f64>>> {
        shaped(py, self.numbers, self.shape)
    }
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

/// Numbers of a rigid transform: its turn row by row, then its shift.
pub const RIGID: usize = 12;

/// A rigid transform from so many numbers, mm.
pub fn rigid(numbers: &[f64]) -> Rigid {
    Rigid {
        rotation: Matrix3::from_row_slice(&numbers[..9]),
        translation: Vector3::from_column_slice(&numbers[9..RIGID]),
    }
}

/// The numbers of a rigid transform.
pub fn numbers_of(rigid: &Rigid) -> [f64; RIGID] {
    let mut out = [0.0; RIGID];
    let turn = rigid.rotation.transpose();
    let numbers = turn.iter().chain(&rigid.translation);
    out.iter_mut().zip(numbers).for_each(|(o, v)| *o = *v);
    out
}

/// The frame of this name.
pub fn frame(name: &str) -> PyResult<Frame> {
    match name {
        "base" => Ok(Frame::Base),
        "sensor" => Ok(Frame::Sensor),
        _ => Err(shape("frame", "'base' or 'sensor'", &[])),
    }
}
