//! Sums of weights times waves of a variable, and the play operator.

use crate::arrays::same_length;
use crate::errors::shape;
use crate::flips::below;
use numpy::{
    PyArray1, PyReadonlyArray1, PyReadonlyArray2, PyReadwriteArray2, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use sherkit_core::numbers::math::sin_cos;
use sherkit_core::numbers::play::play as follow;
use sherkit_core::numbers::waves::{WIDTH, add_waves, spread};
use sherkit_core::numbers::wide::{Kernel, LANES, Wide, widest};

/// Rows of sums that are written at once: a line of the cache.
const AT_ONCE: usize = 8;

/// Adds to `cells` (cells, k) the `weights` (n, k) of rows at `places` (n,), counted in cells, times a kernel.
///
/// `kernel` (powers, 14) is a polynomial, highest power first, of where in its cell a row is (-1 to 1), for each of the
/// cells from there on.
#[pyfunction]
pub fn spread_rows<'py>(
    py: Python<'py>,
    places: PyReadonlyArray1<'py, f64>,
    weights: PyReadonlyArray2<'py, f64>,
    kernel: PyReadonlyArray2<'py, f64>,
    mut cells: PyReadwriteArray2<'py, f64>,
) -> PyResult<()> {
    let (n, k) = (weights.shape()[0], weights.shape()[1]);
    let dims = [cells.shape()[0], cells.shape()[1]];
    let places = same_length("places", &places, n)?;
    let kernel = crate::arrays::rows::<WIDTH, _>("kernel", &kernel)?;
    let weights = weights
        .as_slice()
        .map_err(|_| shape("weights", "(n, k), contiguous", &[n, k]))?;
    let cells = cells
        .as_slice_mut()
        .ok()
        .filter(|_| dims[1] == k)
        .ok_or_else(|| shape("cells", "(cells, k), contiguous", &dims))?;
    py.detach(|| spread(places, weights, k, kernel, cells));
    Ok(())
}

/// Adds to `sums` (2 t, codes) the `weights` (n,) of the rows of each code times the sine of their `angles` (n,) and of
/// its first t multiples, and then the cosines. `codes` (n,) must not fall; only multiples in `taken` (t,), rising, are
/// kept.
#[pyfunction]
pub fn wave_sums<'py>(
    py: Python<'py>,
    angles: PyReadonlyArray1<'py, f64>,
    weights: PyReadonlyArray1<'py, f64>,
    codes: PyReadonlyArray1<'py, i64>,
    taken: PyReadonlyArray1<'py, i64>,
    mut sums: PyReadwriteArray2<'py, f64>,
) -> PyResult<()> {
    let n = angles.shape()[0];
    let dims = [sums.shape()[0], sums.shape()[1]];
    let angles = same_length("angles", &angles, n)?;
    let weights = same_length("weights", &weights, n)?;
    let codes = below(same_length("codes", &codes, n)?, dims[1])?;
    let taken = below(same_length("taken", &taken, dims[0] / 2)?, usize::MAX)?;
    let of_code = dims[1];
    let sums = sums
        .as_slice_mut()
        .map_err(|_| shape("sums", "(2 t, codes), contiguous", &dims))?;
    if !codes.is_sorted() || taken.contains(&0) || dims[0] % 2 != 0 {
        return Err(PyValueError::new_err(
            "codes must rise and count the columns of sums; sums has two rows for each wave, from 1 on",
        ));
    }
    py.detach(|| {
        widest(OfCodes {
            angles,
            weights,
            codes: &codes,
            taken: &taken,
            of_code,
            sums,
        });
    });
    Ok(())
}

/// What [`wave_sums`] does.
struct OfCodes<'a> {
    angles: &'a [f64],
    weights: &'a [f64],
    codes: &'a [usize],
    taken: &'a [usize],
    of_code: usize,
    sums: &'a mut [f64],
}

impl Kernel for OfCodes<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Wide>(self) {
        let Self {
            codes,
            taken,
            of_code,
            sums,
            ..
        } = self;
        let length = taken.iter().copied().max().unwrap_or(0).div_ceil(LANES);
        let mut waves = vec![[0.0; LANES]; AT_ONCE * 2 * length];
        let mut row = 0;
        for first in (0..of_code).step_by(AT_ONCE) {
            let end = of_code.min(first + AT_ONCE);
            let before = row;
            while row < codes.len() && codes[row] < end {
                let here = (codes[row] - first) * 2 * length;
                let (sine, cosine) = waves[here..here + 2 * length].split_at_mut(length);
                let (sin, cos) = sin_cos(self.angles[row]);
                add_waves::<V>((cos, sin), self.weights[row], sine, cosine);
                row += 1;
            }
            if row == before {
                continue;
            }
            let flat = waves.as_flattened();
            for (k, t) in taken.iter().enumerate() {
                for half in 0..2 {
                    let line =
                        &mut sums[(half * taken.len() + k) * of_code + first..][..end - first];
                    for (c, sum) in line.iter_mut().enumerate() {
                        *sum += flat[(2 * c + half) * length * LANES + t - 1];
                    }
                }
            }
            waves.fill([0.0; LANES]);
        }
    }
}

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
