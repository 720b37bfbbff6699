//! The nominal kinematics of the spherical robot from Python, and the names of its modes.

use crate::arrays::{Marked, fixed};
use crate::errors::{shape, to_python};
use crate::lanes::LaneMap;
use crate::maps::{Both, both, many, one};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use sherkit_core::numbers::wide::Wide;
use sherkit_core::spherical::{Assembly, Elbows, GEOMETRIC, Geometry, Kinematics};

/// The assembly of this name.
pub fn assembly(name: &str) -> PyResult<Assembly> {
    match name {
        "outer" => Ok(Assembly::Outer),
        "inner" => Ok(Assembly::Inner),
        _ => Err(shape("assembly", "'outer' or 'inner'", &[])),
    }
}

/// The working mode of this name.
pub fn elbows_of(name: &str) -> PyResult<Elbows> {
    match name {
        "open" => Ok(Elbows::Open),
        "crossed" => Ok(Elbows::Crossed),
        "ahead" => Ok(Elbows::Ahead),
        "behind" => Ok(Elbows::Behind),
        _ => Err(shape(
            "elbows",
            "'open', 'crossed', 'ahead' or 'behind'",
            &[],
        )),
    }
}

#[derive(Clone, Copy)]
struct Forward<'a>(&'a Kinematics);

impl LaneMap<2, 2> for Forward<'_> {
    #[inline(always)]
    fn run<V: Wide>(self, from: [V; 2]) -> ([V; 2], V) {
        self.0.forward_lanes(from)
    }

    fn alone(self, joints: &[f64; 2]) -> Option<[f64; 2]> {
        self.0.forward(&(*joints).into()).ok().map(Into::into)
    }
}

#[derive(Clone, Copy)]
struct Inverse<'a>(&'a Kinematics, Elbows);

impl LaneMap<2, 2> for Inverse<'_> {
    #[inline(always)]
    fn run<V: Wide>(self, from: [V; 2]) -> ([V; 2], V) {
        self.0.inverse_lanes(from, self.1)
    }

    fn alone(self, angles: &[f64; 2]) -> Option<[f64; 2]> {
        self.0
            .inverse(&(*angles).into(), self.1)
            .ok()
            .map(Into::into)
    }
}

/// Kinematics of the tool axis of a spherical robot with two limbs on one actuated axis.
#[pyclass(frozen, module = "sherkit._core")]
pub struct SphericalKinematics(Kinematics);

#[pymethods]
impl SphericalKinematics {
    #[new]
    #[pyo3(signature = (parameters, assembly_mode="outer"))]
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
        one(py, "joints", &joints, |q| self.0.forward(q))
    }

    #[pyo3(signature = (angles, elbows="open"))]
    fn inverse<'py>(
        &self,
        py: Python<'py>,
        angles: PyReadonlyArray1<'_, f64>,
        elbows: &str,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let elbows = elbows_of(elbows)?;
        one(py, "angles", &angles, |x| self.0.inverse(x, elbows))
    }

    fn forward_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        many(py, "joints", &joints, Forward(&self.0))
    }

    #[pyo3(signature = (angles, elbows="open"))]
    fn inverse_batch<'py>(
        &self,
        py: Python<'py>,
        angles: PyReadonlyArray2<'_, f64>,
        elbows: &str,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        many(py, "angles", &angles, Inverse(&self.0, elbows_of(elbows)?))
    }

    /// Derivative of φ, γ by the joint angles `(n, 2, 2)` and by the six parameters `(n, 2, 6)`.
    fn derivatives_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Both<'py>> {
        both(py, "joints", &joints, |q| {
            let pose = self.0.pose(q).ok()?;
            pose.phi_rad
                .is_finite()
                .then(|| (pose.by_joints(), pose.by_parameters()))
        })
    }

    /// Derivative of the inverse at joint angles: of the joints by φ, γ `(n, 2, 2)` and by the six parameters
    /// `(n, 2, 6)`.
    fn inverse_derivatives_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Both<'py>> {
        both(py, "joints", &joints, |q| {
            let pose = self.0.pose(q).ok()?;
            let by_angles = pose.joints_by_angles().ok()?;
            let by_parameters = pose.joints_by_parameters().ok()?;
            pose.phi_rad
                .is_finite()
                .then_some((by_angles, by_parameters))
        })
    }
}
