//! The delta from Python: `DeltaKinematics`, `DeltaModel`, `Calibrated`.

use crate::arrays::{self, Marked, RIGID, fixed, periods as each_period, rigid, rows};
use crate::bernstein::Bernstein;
use crate::calibrated::{self, Calibrated as _, Single, calibrated_class};
use crate::errors::{shape, to_python};
use crate::lanes::LaneMap;
use crate::maps::{Both, WithDerivative, both, each, many, one};
use crate::model::{Derivatives, model_class};
use crate::rows::{Block, now};
use crate::solver::Solver;
use nalgebra::{Matrix3, Vector3};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use sherkit_core::Result;
use sherkit_core::chain::{Frame, Robot};
use sherkit_core::delta::correction::Domain;
use sherkit_core::delta::{
    self, Assembly, Branch, Calibrated as Core, Chain, Covariates, GEOMETRIC, Geometry, Kinematics,
    Model, Values,
};
use sherkit_core::flat::{BranchParts, write_delta};
use sherkit_core::numbers::wide::Wide;

/// The assembly mode of this name.
fn assembly(name: &str) -> PyResult<Assembly> {
    match name {
        "below" => Ok(Assembly::Below),
        "above" => Ok(Assembly::Above),
        _ => Err(shape("assembly", "'below' or 'above'", &[])),
    }
}

#[derive(Clone, Copy)]
struct Forward<'a>(&'a Kinematics);

impl LaneMap<3, 3> for Forward<'_> {
    #[inline(always)]
    fn run<V: Wide>(self, from: [V; 3]) -> ([V; 3], V) {
        self.0.forward_lanes(from)
    }
}

#[derive(Clone, Copy)]
struct Inverse<'a>(&'a Kinematics);

impl LaneMap<3, 3> for Inverse<'_> {
    #[inline(always)]
    fn run<V: Wide>(self, from: [V; 3]) -> ([V; 3], V) {
        self.0.inverse_lanes(from)
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
        one(py, "joints", &joints, |q| self.0.forward(q))
    }

    fn inverse<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        one(py, "position", &position, |x| self.0.inverse(x))
    }

    fn forward_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        many(py, "joints", &joints, Forward(&self.0))
    }

    fn inverse_batch<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        many(py, "positions", &positions, Inverse(&self.0))
    }

    /// Derivative of the position by the joints `(n, 3, 3)` and by the 18 geometric parameters `(n, 3, 18)`.
    fn derivatives_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Both<'py>> {
        both(py, "joints", &joints, |q| {
            let pose = self.0.pose(q).ok()?;
            Some((pose.by_joints(), self.0.by_parameters(&pose)))
        })
    }
}

/// A nominal delta whose errors and effects are to be identified. Readings are x, y, z, distance; what does not apply to
/// a row is zero.
#[pyclass(frozen, module = "sherkit._core")]
pub struct DeltaModel(Model);

model_class!(DeltaModel, Model, delta, {
    /// `sensor` `(12,)`: from the base frame to that of the sensors (turn row by row, shift in mm); `settings`: rod
    /// spacing, pole pitch, three home joint readings (mm), time origin, slip times of point, joints and sensors (s);
    /// `periods` `(3,)`: the pitch of each joint, where they differ.
    #[new]
    #[pyo3(signature = (geometry, target_offset, assembly_mode, sensor, settings, periods=None))]
    fn new(
        geometry: PyReadonlyArray1<'_, f64>,
        target_offset: PyReadonlyArray1<'_, f64>,
        assembly_mode: &str,
        sensor: PyReadonlyArray1<'_, f64>,
        settings: PyReadonlyArray1<'_, f64>,
        periods: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<Self> {
        let p = fixed::<GEOMETRIC, _>("geometry", &geometry)?;
        let geometry = Geometry::from_parameters(&p, assembly(assembly_mode)?);
        geometry.check().map_err(to_python)?;
        let [
            rod_spacing,
            pole_pitch,
            h1,
            h2,
            h3,
            time_origin_s,
            slip_time_s,
            joint_slip_time_s,
            sensor_slip_time_s,
        ] = fixed::<9, _>("settings", &settings)?;
        let model = Model {
            geometry,
            target_offset: Vector3::from(fixed("target_offset", &target_offset)?),
            sensor: rigid(&fixed::<RIGID, _>("sensor", &sensor)?),
            rod_spacing,
            pole_pitch: each_period(3, pole_pitch, periods.as_ref())?,
            home: [h1, h2, h3],
            time_origin_s,
            slip_time_s,
            joint_slip_time_s,
            sensor_slip_time_s,
        };
        model.check().map_err(to_python)?;
        Ok(Self(model))
    }
});

struct OwnedBranch {
    model: Model,
    values: Values,
    chain: Chain,
    correction: Option<Bernstein>,
}

impl OwnedBranch {
    fn new(part: Part<'_>) -> PyResult<Self> {
        let (model, values) = (part.0.0, fixed("values", &part.1)?);
        Ok(Self {
            model,
            values,
            chain: model.with(&values).map_err(to_python)?,
            correction: part.2,
        })
    }

    fn view(&self) -> PyResult<Branch<'_>> {
        let correction = self.correction.as_ref().map(Bernstein::view).transpose()?;
        Ok(Branch::new(&self.chain, correction))
    }

    fn parts(&self) -> PyResult<BranchParts<'_>> {
        Ok(BranchParts {
            model: &self.model,
            values: &self.values,
            correction: self.correction.as_ref().map(Bernstein::view).transpose()?,
        })
    }
}

/// A calibrated delta: whole-workspace model, and perhaps a local one blended in.
#[pyclass(frozen, module = "sherkit._core")]
pub struct Calibrated {
    whole: OwnedBranch,
    local: Option<(OwnedBranch, Domain)>,
    frame: Frame,
}

/// A model, the values of all its parameters, and a correction.
type Part<'py> = (
    PyRef<'py, DeltaModel>,
    PyReadonlyArray1<'py, f64>,
    Option<Bernstein>,
);
type Region<'py> = (PyReadonlyArray1<'py, f64>, PyReadonlyArray1<'py, f64>, f64);

impl calibrated::Calibrated<3> for Calibrated {
    type Core<'a> = Core<'a>;

    fn core(&self) -> PyResult<Core<'_>> {
        Ok(Core {
            whole: self.whole.view()?,
            local: match &self.local {
                None => None,
                Some((branch, region)) => Some((branch.view()?, *region)),
            },
            frame: self.frame,
        })
    }

    fn write(&self, put: impl FnMut(f64)) -> PyResult<()> {
        let local = match &self.local {
            None => None,
            Some((branch, region)) => Some((branch.parts()?, region)),
        };
        let local = local.as_ref().map(|(parts, region)| (parts, *region));
        write_delta(&self.whole.parts()?, local, put);
        Ok(())
    }

    fn forward_at(
        core: &Core<'_>,
        joints: &Vector3<f64>,
        now: &Covariates,
    ) -> Result<(Vector3<f64>, Matrix3<f64>)> {
        core.forward(joints, now)
    }

    fn inverse_at(core: &Core<'_>, place: &Vector3<f64>, now: &Covariates) -> Result<Vector3<f64>> {
        core.inverse(place, now)
    }
}

calibrated_class!(Calibrated, 3, position, positions, {
    /// `whole` and `local` are (model, values of all parameters, correction); `region` is (low corner, high
    /// corner, width of the blend); `frame` is that of positions, "sensor" or "base".
    #[new]
    #[pyo3(signature = (whole, local, region, frame="sensor"))]
    fn new(
        whole: Part<'_>,
        local: Option<Part<'_>>,
        region: Option<Region<'_>>,
        frame: &str,
    ) -> PyResult<Self> {
        let local = match (local, region) {
            (Some(local), Some((low, high, width))) => Some((
                OwnedBranch::new(local)?,
                crate::bernstein::domain(&low, &high, width)?,
            )),
            _ => None,
        };
        Ok(Self {
            whole: OwnedBranch::new(whole)?,
            local,
            frame: arrays::frame(frame)?,
        })
    }

    /// From the base frame to that of the sensors `(12,)`: turn row by row, shift in mm.
    fn sensor<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let numbers = arrays::numbers_of(self.core()?.sensor());
        Ok(PyArray1::from_slice(py, &numbers))
    }
});
