//! One frame for the calibrated robots of control loops. Bodies are generic functions; the macro holds the signatures that
//! Python sees.

use crate::arrays::{Rows, rows, shaped};
use crate::errors::to_python;
use crate::maps::{WithDerivative, vector};
use crate::rows::now;
use nalgebra::{SMatrix, SVector};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use sherkit_core::Result;
use sherkit_core::chain::Covariates;

/// A value and its derivative by the joints.
pub type Single<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>);

/// A calibrated robot of as many coordinates as joints.
pub trait Calibrated<const N: usize> {
    /// What computes.
    type Core<'a>: Sync
    where
        Self: 'a;
    /// The core's robot.
    fn core(&self) -> PyResult<Self::Core<'_>>;
    /// All that makes it, number by number.
    fn write(&self, put: impl FnMut(f64)) -> PyResult<()>;
    /// Where it is at joint readings, with the derivative by them.
    fn forward_at(
        core: &Self::Core<'_>,
        joints: &SVector<f64, N>,
        now: &Covariates<N>,
    ) -> Result<(SVector<f64, N>, SMatrix<f64, N, N>)>;
    /// Joint readings at which it is somewhere.
    fn inverse_at(
        core: &Self::Core<'_>,
        place: &SVector<f64, N>,
        now: &Covariates<N>,
    ) -> Result<SVector<f64, N>>;
}

/// Where a calibrated robot is at joint readings `(N,)`, and the derivative by them `(N, N)`.
pub fn forward<'py, T: Calibrated<N>, const N: usize>(
    py: Python<'py>,
    robot: &T,
    joints: &PyReadonlyArray1<'_, f64>,
    covariates: &[f64],
) -> PyResult<Single<'py>> {
    let (q, now) = (vector("joints", joints)?, now(covariates)?);
    let (x, j) = T::forward_at(&robot.core()?, &q, &now).map_err(to_python)?;
    Ok((
        PyArray1::from_slice(py, x.as_slice()),
        shaped(py, j.transpose().as_slice().to_vec(), [N, N])?,
    ))
}

/// The same for many joint readings `(n, N)`; those out of reach are NaN and marked.
pub fn forward_batch<'py, T: Calibrated<N>, const N: usize>(
    py: Python<'py>,
    robot: &T,
    joints: &PyReadonlyArray2<'_, f64>,
    covariates: &[f64],
) -> PyResult<WithDerivative<'py>> {
    let (core, now) = (robot.core()?, now(covariates)?);
    let q = rows::<N, _>("joints", joints)?.to_vec();
    let (mut places, mut by_joints) = (Rows::new(q.len(), N, 1), Rows::new(q.len(), N, N));
    let mut reached = vec![false; q.len()];
    py.detach(|| {
        for (i, q) in q.iter().enumerate() {
            if let Ok((x, j)) = T::forward_at(&core, &SVector::from(*q), &now) {
                places.put(i, &x);
                by_joints.put(i, &j);
                reached[i] = true;
            }
        }
    });
    Ok((
        places.vectors(py)?,
        by_joints.matrices(py)?,
        PyArray1::from_vec(py, reached),
    ))
}

/// A calibrated class: its constructor and what it has beyond others in braces, what every one has from the frame.
macro_rules! calibrated_class {
    ($class:ident, $n:literal, $place:ident, $places:ident, { $($own:tt)* }) => {
        #[pymethods]
        impl $class {
            /// All that makes it as a row of numbers `(n,)`, for a control loop in another language.
            fn flat<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
                let mut numbers = Vec::new();
                self.write(|x| numbers.push(x))?;
                Ok(PyArray1::from_vec(py, numbers))
            }

            /// Where it is at joint readings, and the derivative by them, row by row.
            fn forward<'py>(
                &self,
                py: Python<'py>,
                joints: PyReadonlyArray1<'_, f64>,
                covariates: Vec<f64>,
            ) -> PyResult<Single<'py>> {
                $crate::calibrated::forward(py, self, &joints, &covariates)
            }

            /// The same for many joint readings, and which are in reach; the others are NaN.
            fn forward_batch<'py>(
                &self,
                py: Python<'py>,
                joints: PyReadonlyArray2<'_, f64>,
                covariates: Vec<f64>,
            ) -> PyResult<WithDerivative<'py>> {
                $crate::calibrated::forward_batch(py, self, &joints, &covariates)
            }

            /// Joint readings at which it is there.
            fn inverse<'py>(
                &self,
                py: Python<'py>,
                $place: PyReadonlyArray1<'_, f64>,
                covariates: Vec<f64>,
            ) -> PyResult<Bound<'py, PyArray1<f64>>> {
                let (core, now) = (self.core()?, now(&covariates)?);
                one(py, stringify!($place), &$place, |x| Self::inverse_at(&core, x, &now))
            }

            /// Joint readings for many places, and which are in reach; the others are NaN.
            fn inverse_batch<'py>(
                &self,
                py: Python<'py>,
                $places: PyReadonlyArray2<'_, f64>,
                covariates: Vec<f64>,
            ) -> PyResult<Marked<'py, PyArray2<f64>>> {
                let (core, now) = (self.core()?, now(&covariates)?);
                let places = rows::<$n, _>(stringify!($places), &$places)?.to_vec();
                each(py, &places, |x| Self::inverse_at(&core, &(*x).into(), &now))
            }

            $($own)*
        }
    };
}
pub(crate) use calibrated_class;
