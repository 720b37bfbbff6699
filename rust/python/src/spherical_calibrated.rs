//! `SphericalCalibrated`: the spherical robot of the control loop, from Python.

use crate::arrays::{fixed, rows, shaped};
use crate::errors::to_python;
use crate::spherical::elbows_of;
use crate::spherical_model::SphericalModel;
use crate::spherical_rows::check_free;
use nalgebra::Vector2;
use numpy::{PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use sherkit_core::flat::write_spherical;
use sherkit_core::spherical::parameters::Values;
use sherkit_core::spherical::{Calibrated as Core, Covariates, Elbows, Model};

/// A calibrated spherical robot: where its tool points.
#[pyclass(frozen, module = "sherkit._core")]
pub struct SphericalCalibrated {
    robot: Core,
    model: Model,
    values: Values,
    elbows: Elbows,
}

type Single<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>);
type Batch<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<bool>>,
);

/// Covariates from (time s, temperature °C, two directions); a loop commands places, so velocities are zero.
fn now(numbers: [f64; 4]) -> Covariates {
    let [time_s, temperature_c, d1, d2] = numbers;
    Covariates {
        time_s,
        temperature_c,
        direction: [d1, d2],
        velocity_rad_s: [0.0; 2],
    }
}

#[pymethods]
impl SphericalCalibrated {
    /// The model with identified `values` of all its parameters.
    #[new]
    #[pyo3(signature = (model, values, elbows="open"))]
    fn new(
        model: PyRef<'_, SphericalModel>,
        values: PyReadonlyArray1<'_, f64>,
        elbows: &str,
    ) -> PyResult<Self> {
        let values = fixed("values", &values)?;
        let (model, elbows) = (*model.model(), elbows_of(elbows)?);
        let robot = Core::new(&model, &values, elbows).map_err(to_python)?;
        Ok(Self {
            robot,
            model,
            values,
            elbows,
        })
    }

    /// All that makes it as a row of numbers `(n,)`, for a control loop in another language.
    fn flat<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let mut numbers = Vec::new();
        let put = |x| numbers.push(x);
        write_spherical(&self.model, &self.values, self.elbows, put);
        PyArray1::from_vec(py, numbers)
    }

    /// φ, γ `(2,)` and their derivative by the joints `(2, 2)`.
    fn forward<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray1<'_, f64>,
        covariates: [f64; 4],
    ) -> PyResult<Single<'py>> {
        let q = Vector2::from(fixed("joints", &joints)?);
        let (x, j) = self
            .robot
            .forward(&q, &now(covariates))
            .map_err(to_python)?;
        let j = j.transpose().as_slice().to_vec();
        Ok((
            PyArray1::from_slice(py, x.as_slice()),
            shaped(py, j, [2, 2])?,
        ))
    }

    /// Joint readings `(2,)` for φ, γ.
    fn inverse<'py>(
        &self,
        py: Python<'py>,
        angles: PyReadonlyArray1<'_, f64>,
        covariates: [f64; 4],
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let x = Vector2::from(fixed("angles", &angles)?);
        let q = self
            .robot
            .inverse(&x, &now(covariates))
            .map_err(to_python)?;
        Ok(PyArray1::from_slice(py, q.as_slice()))
    }

    /// φ, γ `(n, 2)`, by the joints `(n, 2, 2)`, by the parameters in `free` `(n, 2, free)`, and which rows are in reach.
    fn forward_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
        covariates: [f64; 4],
        free: Vec<usize>,
    ) -> PyResult<Batch<'py>> {
        check_free(&free)?;
        let q = rows::<2, _>("joints", &joints)?;
        let mut x = vec![f64::NAN; q.len() * 2];
        let mut j = vec![f64::NAN; q.len() * 4];
        let mut p = vec![f64::NAN; q.len() * 2 * free.len()];
        let mut reached = vec![false; q.len()];
        for (i, q) in q.iter().enumerate() {
            let Ok(found) = self.robot.predict(&Vector2::from(*q), &now(covariates)) else {
                continue;
            };
            x[2 * i..][..2].copy_from_slice(found.value.as_slice());
            j[4 * i..][..4].copy_from_slice(found.by_joints.transpose().as_slice());
            for axis in 0..2 {
                for (k, &index) in free.iter().enumerate() {
                    p[(2 * i + axis) * free.len() + k] = found.by_parameters[(axis, index)];
                }
            }
            reached[i] = true;
        }
        Ok((
            shaped(py, x, [q.len(), 2])?,
            shaped(py, j, [q.len(), 2, 2])?,
            shaped(py, p, [q.len(), 2, free.len()])?,
            PyArray1::from_vec(py, reached),
        ))
    }

    /// Joint readings `(n, 2)` for φ, γ `(n, 2)`, and which are in reach.
    fn inverse_batch<'py>(
        &self,
        py: Python<'py>,
        angles: PyReadonlyArray2<'_, f64>,
        covariates: [f64; 4],
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<bool>>)> {
        let x = rows::<2, _>("angles", &angles)?;
        let mut out = vec![f64::NAN; x.len() * 2];
        let mut reached = vec![false; x.len()];
        for (i, x) in x.iter().enumerate() {
            if let Ok(joints) = self.robot.inverse(&Vector2::from(*x), &now(covariates)) {
                out[i * 2..][..2].copy_from_slice(joints.as_slice());
                reached[i] = true;
            }
        }
        Ok((
            shaped(py, out, [x.len(), 2])?,
            PyArray1::from_vec(py, reached),
        ))
    }
}
