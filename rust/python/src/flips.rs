//! The largest score of many candidates under flips of signs.

use crate::arrays::{same_length, shaped};
use crate::errors::shape;
use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use sherkit_core::numbers::walsh::walsh_hadamard;

/// Largest sum of squares, by class of candidate, under each pattern of signs of a group.
///
/// `rows` (R, g) are what each pose adds to a direction; candidate `c` owns those up to `ends[c]`. Pattern `t` gives
/// pose `p` the sign of the parity of `codes[p] & t`.
#[pyfunction]
pub fn largest_under_flips<'py>(
    py: Python<'py>,
    rows: PyReadonlyArray2<'py, f64>,
    ends: PyReadonlyArray1<'py, i64>,
    class_of: PyReadonlyArray1<'py, i64>,
    classes: usize,
    codes: PyReadonlyArray1<'py, i64>,
    flips: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let dims = rows.shape();
    let numbers = rows
        .as_slice()
        .map_err(|_| shape("rows", "(R, g), contiguous", dims))?;
    let (count, poses) = (dims[0], dims[1]);
    let ends = same_length("ends", &ends, ends.shape()[0])?;
    let class_of = same_length("class_of", &class_of, ends.len())?;
    let codes = same_length("codes", &codes, poses)?;
    let below = |values: &[i64], limit: usize| -> PyResult<Vec<usize>> {
        values
            .iter()
            .map(|v| {
                usize::try_from(*v)
                    .ok()
                    .filter(|v| *v < limit)
                    .ok_or_else(wrong)
            })
            .collect()
    };
    let ends = below(ends, count + 1)?;
    let class_of = below(class_of, classes)?;
    let codes = below(codes, flips)?;
    if !flips.is_power_of_two() || !ends.is_sorted() {
        return Err(wrong());
    }
    let best = py.detach(|| {
        let mut best = vec![0.0_f64; classes * flips];
        let (mut signed, mut total) = (vec![0.0; flips], vec![0.0; flips]);
        let mut first = 0;
        for (&end, class) in ends.iter().zip(class_of) {
            total.fill(0.0);
            for row in numbers[first * poses..end * poses].chunks_exact(poses.max(1)) {
                signed.fill(0.0);
                for (code, value) in codes.iter().zip(row) {
                    signed[*code] += value;
                }
                walsh_hadamard(&mut signed);
                for (t, s) in total.iter_mut().zip(&signed) {
                    *t += s * s;
                }
            }
            let of_class = &mut best[class * flips..][..flips];
            for (b, t) in of_class.iter_mut().zip(&total) {
                *b = b.max(*t);
            }
            first = end;
        }
        best
    });
    shaped(py, best, [classes, flips])
}

fn wrong() -> PyErr {
    PyValueError::new_err(
        "flips must be a power of two, with codes below it; ends must rise to the number of rows, with a class each",
    )
}
