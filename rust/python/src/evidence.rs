//! What readings say of blocks of columns, many of one width at once.

use crate::arrays::same_length;
use crate::errors::{shape, to_python};
use numpy::{
    PyArray1, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use sherkit_core::evidence;

/// The sum of squares that each block `(b, k, k)` takes and its rank, `(b,)` each: `right` `(b, k)` are products with what is
/// left of the readings; a column of whose square no more is left than `least` `(b,)` is none.
#[pyfunction]
pub fn blocks_taken<'py>(
    py: Python<'py>,
    grams: PyReadonlyArray3<'py, f64>,
    right: PyReadonlyArray2<'py, f64>,
    least: PyReadonlyArray1<'py, f64>,
) -> PyResult<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>)> {
    let dims = [right.shape()[0], right.shape()[1], right.shape()[1]];
    if grams.shape() != dims {
        return Err(shape("grams", &format!("{dims:?}"), grams.shape()));
    }
    let least = same_length("least", &least, dims[0])?;
    // parts of larger blocks do not lie in one piece
    let (grams, right) = (grams.as_array(), right.as_array());
    let (grams, right) = (grams.as_standard_layout(), right.as_standard_layout());
    let (grams, right) = (
        grams.as_slice().unwrap_or_default(),
        right.as_slice().unwrap_or_default(),
    );
    let k = dims[1].max(1);
    let (mut gains, mut ranks) = (vec![0.0; dims[0]], vec![0.0; dims[0]]);
    py.detach(|| {
        let mut room = vec![0.0; k * k + k];
        let blocks = grams.chunks_exact(k * k).zip(right.chunks_exact(k));
        let out = gains.iter_mut().zip(&mut ranks);
        for (((block, right), least), (gain, rank)) in blocks.zip(least).zip(out) {
            let count;
            (*gain, count) = evidence::taken(block, right, *least, &mut room)?;
            *rank = count as f64;
        }
        Ok(())
    })
    .map_err(to_python)?;
    let [gains, ranks] = [gains, ranks].map(|made| PyArray1::from_vec(py, made));
    Ok((gains, ranks))
}
