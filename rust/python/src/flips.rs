//! The largest score of many candidates under flips of signs.

use crate::arrays::{same_length, shaped};
use crate::errors::shape;
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadwriteArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use sherkit_core::numbers::walsh::walsh_hadamard;

/// Flips for which a candidate is computed at once: its columns stay in the cache.
const AT_ONCE: usize = 256;

/// Largest sum of squares, by class of candidate, under each pattern of signs of a group.
///
/// `sums` (K, flips), which are used up, are what the poses of each code add to each column: pattern `t` gives those of
/// code `h` the sign of the parity of `h & t`. Candidate `c` has as many directions as `ranks[c]`, each of them so much
/// of its `sizes[c]` columns as the next numbers of `roots` say; `columns` names these, candidate by candidate.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn largest_under_flips<'py>(
    py: Python<'py>,
    mut sums: PyReadwriteArray2<'py, f64>,
    columns: PyReadonlyArray1<'py, i64>,
    roots: PyReadonlyArray1<'py, f64>,
    sizes: PyReadonlyArray1<'py, i64>,
    ranks: PyReadonlyArray1<'py, i64>,
    class_of: PyReadonlyArray1<'py, i64>,
    classes: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let dims = [sums.shape()[0], sums.shape()[1]];
    let (count, flips) = (dims[0], dims[1]);
    let sums = sums
        .as_slice_mut()
        .map_err(|_| shape("sums", "(K, flips), contiguous", &dims))?;
    let n = sizes.shape()[0];
    let sizes = below(same_length("sizes", &sizes, n)?, usize::MAX)?;
    let ranks = below(same_length("ranks", &ranks, n)?, usize::MAX)?;
    let class_of = below(same_length("class_of", &class_of, n)?, classes)?;
    let columns = below(same_length("columns", &columns, sizes.iter().sum())?, count)?;
    let needed = sizes.iter().zip(&ranks).map(|(k, r)| k * r).sum();
    let roots = same_length("roots", &roots, needed)?;
    if !flips.is_power_of_two() {
        return Err(wrong());
    }
    let best = py.detach(|| {
        for row in sums.chunks_exact_mut(flips) {
            walsh_hadamard(row);
        }
        let mut best = vec![0.0_f64; classes * flips];
        for start in (0..flips).step_by(AT_ONCE) {
            let width = AT_ONCE.min(flips - start);
            let (mut column, mut root) = (0, 0);
            for ((&size, &rank), class) in sizes.iter().zip(&ranks).zip(&class_of) {
                let mut total = [0.0; AT_ONCE];
                for direction in roots[root..root + size * rank].chunks_exact(size.max(1)) {
                    let mut along = [0.0; AT_ONCE];
                    for (part, c) in direction.iter().zip(&columns[column..column + size]) {
                        let values = &sums[c * flips + start..][..width];
                        for (a, v) in along.iter_mut().zip(values) {
                            *a += part * v;
                        }
                    }
                    for (t, a) in total.iter_mut().zip(along) {
                        *t += a * a;
                    }
                }
                let of_class = &mut best[class * flips + start..][..width];
                for (b, t) in of_class.iter_mut().zip(total) {
                    *b = if t > *b { t } else { *b };
                }
                column += size;
                root += size * rank;
            }
        }
        best
    });
    shaped(py, best, [classes, flips])
}

/// Whole numbers from zero on, all below a limit.
pub fn below(values: &[i64], limit: usize) -> PyResult<Vec<usize>> {
    values
        .iter()
        .map(|v| {
            usize::try_from(*v)
                .ok()
                .filter(|v| *v < limit)
                .ok_or_else(wrong)
        })
        .collect()
}

fn wrong() -> PyErr {
    PyValueError::new_err(
        "flips must be a power of two; columns, sizes, ranks and classes must count what there is",
    )
}

/// Sums of `values` (n,), a power of two, under every pattern of signs: number `t` has each of them with the sign of the
/// parity of `h & t`.
#[pyfunction]
#[pyo3(name = "walsh_hadamard")]
pub fn walsh<'py>(
    py: Python<'py>,
    values: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let mut values = same_length("values", &values, values.shape()[0])?.to_vec();
    if !values.len().is_power_of_two() {
        return Err(wrong());
    }
    walsh_hadamard(&mut values);
    Ok(PyArray1::from_vec(py, values))
}
