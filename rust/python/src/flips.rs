//! The largest score of many candidates under flips of signs.

use crate::arrays::{same_length, shaped};
use crate::errors::shape;
use numpy::{
    PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use sherkit_core::numbers::walsh::{Transform, walsh_hadamard};
use sherkit_core::numbers::wide::{Kernel, LANES, Wide, widest};

/// Vectors of flips for which a candidate is computed at once: its columns stay in the cache.
const AT_ONCE: usize = 32;
/// Flips beyond which there would be no memory.
const MOST: usize = 1 << 16;

/// Candidates: of how many columns and directions each is, which these are, and how much of each column is in a direction.
struct Family<'a> {
    sizes: &'a [usize],
    ranks: &'a [usize],
    class_of: &'a [usize],
    columns: &'a [usize],
    roots: &'a [f64],
}

/// The largest of each class under every pattern of signs: `best` (classes, flips / 8). `values` (K, flips / 8) has what
/// the poses of each code add to each column.
struct Largest<'a> {
    family: Family<'a>,
    values: &'a mut [[f64; LANES]],
    best: &'a mut [[f64; LANES]],
    width: usize,
}

impl Kernel for Largest<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Wide>(self) {
        let (values, best, width, of) = (self.values, self.best, self.width, self.family);
        for row in values.chunks_exact_mut(width) {
            Transform(row.as_flattened_mut()).run::<V>();
        }
        for start in (0..width).step_by(AT_ONCE) {
            let end = width.min(start + AT_ONCE);
            let (mut column, mut root) = (0, 0);
            for ((&size, &rank), class) in of.sizes.iter().zip(of.ranks).zip(of.class_of) {
                let columns = &of.columns[column..column + size];
                let directions = &of.roots[root..root + size * rank];
                for at in start..end {
                    let mut total = V::splat(0.0);
                    for direction in directions.chunks_exact(size.max(1)) {
                        let mut along = V::splat(0.0);
                        for (part, c) in direction.iter().zip(columns) {
                            along = along + V::splat(*part) * V::of(values[c * width + at]);
                        }
                        total = total + along * along;
                    }
                    let most = &mut best[class * width + at];
                    let before = V::of(*most);
                    *most = total.above(before, total, before).numbers();
                }
                column += size;
                root += size * rank;
            }
        }
    }
}

/// Largest sum of squares, by class of candidate, under each pattern of signs of a group of `flips`.
///
/// `sums` (K, c) are what the poses of each of the `codes` (c,) add to each column: pattern `t` gives those of code `h`
/// the sign of the parity of `h & t`. Candidate `c` has as many directions as `ranks[c]`, each of them so much of its
/// `sizes[c]` columns as the next numbers of `roots` say; `columns` names these, candidate by candidate.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn largest_under_flips<'py>(
    py: Python<'py>,
    sums: PyReadonlyArray2<'py, f64>,
    codes: PyReadonlyArray1<'py, i64>,
    flips: usize,
    columns: PyReadonlyArray1<'py, i64>,
    roots: PyReadonlyArray1<'py, f64>,
    sizes: PyReadonlyArray1<'py, i64>,
    ranks: PyReadonlyArray1<'py, i64>,
    class_of: PyReadonlyArray1<'py, i64>,
    classes: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let dims = [sums.shape()[0], sums.shape()[1]];
    let [count, of_code] = dims;
    let sums = sums
        .as_slice()
        .map_err(|_| shape("sums", "(K, c), contiguous", &dims))?;
    if !flips.is_power_of_two() || !(LANES..=MOST).contains(&flips) {
        return Err(wrong());
    }
    let codes = below(same_length("codes", &codes, of_code)?, flips)?;
    let n = sizes.shape()[0];
    let sizes = below(same_length("sizes", &sizes, n)?, usize::MAX)?;
    let ranks = below(same_length("ranks", &ranks, n)?, usize::MAX)?;
    let class_of = below(same_length("class_of", &class_of, n)?, classes)?;
    let columns = below(same_length("columns", &columns, sizes.iter().sum())?, count)?;
    let needed = sizes.iter().zip(&ranks).map(|(k, r)| k * r).sum();
    let roots = same_length("roots", &roots, needed)?;
    // NumPy's own memory: in large pages, where there are some
    let values = PyArray2::<f64>::zeros(py, [count, flips], false);
    let mut values = values.readwrite();
    let values = values
        .as_slice_mut()
        .map_err(|_| shape("sums", "(K, c), contiguous", &dims))?;
    let best = py.detach(|| {
        let width = flips / LANES;
        let rows = values.chunks_exact_mut(flips);
        for (of, row) in sums.chunks_exact(of_code.max(1)).zip(rows) {
            for (code, sum) in codes.iter().zip(of) {
                row[*code] += sum;
            }
        }
        let mut best = vec![[0.0; LANES]; classes * width];
        widest(Largest {
            family: Family {
                sizes: &sizes,
                ranks: &ranks,
                class_of: &class_of,
                columns: &columns,
                roots,
            },
            values: values.as_chunks_mut().0,
            best: &mut best,
            width,
        });
        best.into_flattened()
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
        "flips must be a power of two from 8 to 65,536; codes, columns, sizes, ranks and classes must count what there is",
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
