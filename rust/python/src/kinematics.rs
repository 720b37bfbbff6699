//! `DeltaKinematics`: forward, inverse and derivatives, single and batched.

use crate::arrays::{fixed, rows, shaped};
use crate::errors::{shape, to_python};
use crate::lanes::{Block, LANES, LaneMap, in_lanes};
use nalgebra::Vector3;
use numpy::{PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use sherkit_core::delta::{Assembly, GEOMETRIC, Geometry, Kinematics};

type Marked<'py, A> = (Bound<'py, A>, Bound<'py, PyArray1<bool>>);

/// The assembly mode of this name.
pub fn assembly(name: &str) -> PyResult<Assembly> {
    match name {
        "below" => Ok(Assembly::Below),
        "above" => Ok(Assembly::Above),
        _ => Err(shape("assembly", "'below' or 'above'", &[])),
    }
}

/// Kinematics of the platform centre of a linear delta.
#[pyclass(frozen, module = "sherkit._core")]
pub struct DeltaKinematics(Kinematics);

#[pymethods]
impl DeltaKinematics {
    #[new]
    fn new(parameters: PyReadonlyArray1<'_, f64>, assembly_mode: &str) -> PyResult<Self> {
        let p = fixed::<GEOMETRIC, _>("parameters", &parameters)?;
        let geometry = Geometry::from_parameters(&p, assembly(assembly_mode)?);
        Kinematics::new(&geometry).map(Self).map_err(to_python)
    }

    fn forward<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let q = Vector3::from(fixed("joints", &joints)?);
        let x = self.0.forward(&q).map_err(to_python)?;
        Ok(PyArray1::from_slice(py, x.as_slice()))
    }

    fn inverse<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let x = Vector3::from(fixed("position", &position)?);
        let q = self.0.inverse(&x).map_err(to_python)?;
        Ok(PyArray1::from_slice(py, q.as_slice()))
    }

    fn forward_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        let q = rows::<3, _>("joints", &joints)?;
        let (x, reached) = in_lanes(q, Forward(&self.0));
        marked(py, x, reached)
    }

    fn inverse_batch<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        let x = rows::<3, _>("positions", &positions)?;
        let (q, reached) = in_lanes(x, Inverse(&self.0));
        marked(py, q, reached)
    }

    /// Velocity Jacobian, `(n, 3, 3)`; rows out of reach are NaN and marked.
    fn jacobian_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Marked<'py, PyArray3<f64>>> {
        let q = rows::<3, _>("joints", &joints)?;
        let mut out = vec![f64::NAN; q.len() * 9];
        let mut reached = vec![false; q.len()];
        for ((q, out), ok) in q.iter().zip(out.chunks_exact_mut(9)).zip(&mut reached) {
            if let Ok(pose) = self.0.pose(&Vector3::from(*q)) {
                out.copy_from_slice(pose.by_joints().transpose().as_slice());
                *ok = true;
            }
        }
        Ok((
            shaped(py, out, [q.len(), 3, 3])?,
            PyArray1::from_vec(py, reached),
        ))
    }

    /// Derivative by the 18 geometric parameters, `(n, 3, 18)`; rows out of reach are NaN and marked.
    fn by_parameters_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Marked<'py, PyArray3<f64>>> {
        let q = rows::<3, _>("joints", &joints)?;
        let mut out = vec![f64::NAN; q.len() * 3 * GEOMETRIC];
        let mut reached = vec![false; q.len()];
        for ((q, out), ok) in q
            .iter()
            .zip(out.chunks_exact_mut(3 * GEOMETRIC))
            .zip(&mut reached)
        {
            if let Ok(pose) = self.0.pose(&Vector3::from(*q)) {
                out.copy_from_slice(self.0.by_parameters(&pose).transpose().as_slice());
                *ok = true;
            }
        }
        Ok((
            shaped(py, out, [q.len(), 3, GEOMETRIC])?,
            PyArray1::from_vec(py, reached),
        ))
    }
}

fn marked(
    py: Python<'_>,
    values: Vec<f64>,
    reached: Vec<bool>,
) -> PyResult<Marked<'_, PyArray2<f64>>> {
    let n = reached.len();
    Ok((shaped(py, values, [n, 3])?, PyArray1::from_vec(py, reached)))
}

#[derive(Clone, Copy)]
struct Forward<'a>(&'a Kinematics);

impl LaneMap<3, 3> for Forward<'_> {
    #[inline(always)]
    fn run(self, from: &Block<3>) -> (Block<3>, [bool; LANES]) {
        self.0.forward_lanes::<LANES>(from)
    }
}

#[derive(Clone, Copy)]
struct Inverse<'a>(&'a Kinematics);

impl LaneMap<3, 3> for Inverse<'_> {
    #[inline(always)]
    fn run(self, from: &Block<3>) -> (Block<3>, [bool; LANES]) {
        self.0.inverse_lanes::<LANES>(from)
    }
}
