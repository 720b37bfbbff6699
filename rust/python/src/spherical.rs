//! The spherical robot from Python: `SphericalModel`, `SphericalCalibrated`, and where its camera should stand.

use crate::arrays::{Marked, Rows, fixed, periods as each_period, rows};
use crate::calibrated::{self, Calibrated as _, Single, calibrated_class};
use crate::camera::face;
use crate::errors::{shape, to_python};
use crate::maps::{WithDerivative, each, one};
use crate::model::{Derivatives, chain, model_class};
use crate::problem::Problem;
use crate::rows::{Block, check_free, copied, now, rows_of};
use crate::solver::Solver;
use crate::spherical_kinematics::{assembly, elbows_of};
use nalgebra::{Matrix2, Vector2, Vector3};
use numpy::{PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sherkit_core::Result;
use sherkit_core::camera::{Camera, Description};
use sherkit_core::chain::Robot;
use sherkit_core::chain::effects::Wanted;
use sherkit_core::flat::write_spherical;
use sherkit_core::spherical::vision::{self, Region};
use sherkit_core::spherical::{
    self, CATALOGUE, Calibrated as Core, Covariates, Elbows, GEOMETRIC, Geometry, Model,
    PARAMETERS, Readings, Values,
};
use std::f64::consts::PI;

fn region_of(name: &str) -> PyResult<Region> {
    match name {
        "half" => Ok(Region::Half),
        "quarter" => Ok(Region::Quarter),
        _ => Err(shape("region", "'half' or 'quarter'", &[])),
    }
}

/// What a run of this name reads.
fn readings_of(name: &str) -> PyResult<Readings> {
    match name {
        "pixels" => Ok(Readings::Pixels),
        "angles" => Ok(Readings::Angles),
        _ => Err(shape("readings", "'pixels' or 'angles'", &[])),
    }
}

/// A nominal spherical robot and camera whose errors and effects are to be identified. Readings are u, v in pixels or
/// φ, γ in rad, throughout.
#[pyclass(frozen, module = "sherkit._core")]
pub struct SphericalModel(Model);

model_class!(SphericalModel, Model, spherical, {
    /// `settings`: radius of the sphere (mm), direction of the weight (3), home joint readings (2, rad), time origin and
    /// slip times of marker and camera (s) and period of the encoders (rad); these four may be left out;
    /// `periods` `(2,)`: that of each joint, where they differ.
    #[new]
    #[pyo3(signature = (geometry, camera, settings, assembly_mode="outer", face_mode="near", readings="pixels", periods=None))]
    fn new(
        geometry: PyReadonlyArray1<'_, f64>,
        camera: PyReadonlyArray1<'_, f64>,
        settings: PyReadonlyArray1<'_, f64>,
        assembly_mode: &str,
        face_mode: &str,
        readings: &str,
        periods: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<Self> {
        let p = fixed::<GEOMETRIC, _>("geometry", &geometry)?;
        let geometry = Geometry::from_parameters(&p, assembly(assembly_mode)?);
        geometry.check().map_err(to_python)?;
        let camera = Description::from_parameters(&fixed("camera", &camera)?);
        Camera::new(&camera).map_err(to_python)?;
        let given = settings.as_slice()?;
        let [radius_mm, gx, gy, gz, h1, h2, rest @ ..] = match *given {
            [r, gx, gy, gz, h1, h2] => [r, gx, gy, gz, h1, h2, 0.0, 0.0, 0.0, 0.0, PI],
            _ => fixed("settings", &settings)?,
        };
        let [
            time_origin_s,
            slip_time_s,
            joint_slip_time_s,
            sensor_slip_time_s,
            encoder_period,
        ] = rest;
        let model = Model {
            geometry,
            radius_mm,
            camera,
            face: face(face_mode)?,
            readings: readings_of(readings)?,
            gravity: Vector3::new(gx, gy, gz),
            home: [h1, h2],
            time_origin_s,
            slip_time_s,
            joint_slip_time_s,
            encoder_period: each_period(2, encoder_period, periods.as_ref())?,
            sensor_slip_time_s,
        };
        model.with(&[0.0; PARAMETERS]).map_err(to_python)?;
        Ok(Self(model))
    }

    /// The same robot whose run holds other readings.
    fn reading(&self, readings: &str) -> PyResult<Self> {
        let readings = readings_of(readings)?;
        Ok(Self(Model { readings, ..self.0 }))
    }

    /// The camera with its errors.
    fn camera(&self, values: PyReadonlyArray1<'_, f64>) -> PyResult<crate::camera::Camera> {
        let camera = self.0.camera(&fixed("values", &values)?);
        Ok(crate::camera::Camera(camera.map_err(to_python)?))
    }

    /// Markers in the base frame `(n, 3)`, mm.
    fn markers<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'_, f64>,
        block: Block<'_>,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        let chain = chain(&self.0, &values)?;
        each(py, &rows_of(&block)?, |row| chain.row_point(row))
    }

    /// Displacement of the platform's centre `(n, 3)`, mm, and its derivatives by the parameters whose indices are
    /// given `(n, 3, free)` and by the joint readings `(n, 3, 2)`.
    fn centres<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'_, f64>,
        block: Block<'_>,
        free: Vec<usize>,
    ) -> PyResult<(
        Bound<'py, PyArray2<f64>>,
        Bound<'py, PyArray3<f64>>,
        Bound<'py, PyArray3<f64>>,
        Bound<'py, PyArray1<bool>>,
    )> {
        check_free::<PARAMETERS>(&free)?;
        let chain = chain(&self.0, &values)?;
        let rows = rows_of::<2>(&block)?;
        let mut out = Rows::new(rows.len(), 3, 1);
        let mut by_parameters = Rows::new(rows.len(), 3, free.len());
        let mut by_joints = Rows::new(rows.len(), 3, 2);
        let mut reached = vec![false; rows.len()];
        py.detach(|| {
            for (i, row) in rows.iter().enumerate() {
                let Ok(centre) = chain.centre(&row.joints, &row.covariates) else {
                    continue;
                };
                reached[i] = true;
                out.put(i, &centre.value);
                by_joints.put(i, &centre.by_joints);
                by_parameters.put_columns(i, &centre.by_parameters, &free);
            }
        });
        Ok((
            out.vectors(py)?,
            by_parameters.matrices(py)?,
            by_joints.matrices(py)?,
            PyArray1::from_vec(py, reached),
        ))
    }

    /// The paper's residuals `(n, 2)`, rad: measured joints minus the inverse kinematics of the readings `(n, 2)`
    /// (Eq. 6), and their derivatives by the parameters whose indices are given `(n, 2, free)`.
    fn inverse_residuals<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'_, f64>,
        block: Block<'_>,
        readings: PyReadonlyArray2<'_, f64>,
        free: Vec<usize>,
    ) -> PyResult<WithDerivative<'py>> {
        check_free::<PARAMETERS>(&free)?;
        let chain = chain(&self.0, &values)?;
        let rows = rows_of::<2>(&block)?;
        let readings = copied::<2>("readings", &readings, rows.len())?;
        let mut out = Rows::new(rows.len(), 2, 1);
        let mut by_parameters = Rows::new(rows.len(), 2, free.len());
        let mut reached = vec![false; rows.len()];
        py.detach(|| {
            for (i, (row, reading)) in rows.iter().zip(&readings).enumerate() {
                let Ok(found) = chain.inverse_residual(row, &Vector2::from(*reading)) else {
                    continue;
                };
                reached[i] = true;
                out.put(i, &found.value);
                by_parameters.put_columns(i, &found.by_parameters, &free);
            }
        });
        Ok((
            out.vectors(py)?,
            by_parameters.matrices(py)?,
            PyArray1::from_vec(py, reached),
        ))
    }

    /// As [`Self::solve`], for the paper's residuals (Eq. 6): weights are those of the joints, 1/rad.
    #[allow(
        clippy::too_many_arguments,
        reason = "one argument for each part of the problem"
    )]
    fn solve_inverse(
        &self,
        py: Python<'_>,
        solver: &mut Solver,
        values: PyReadonlyArray1<'_, f64>,
        free: Vec<usize>,
        block: Block<'_>,
        readings: PyReadonlyArray2<'_, f64>,
        weights: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<(&'static str, Vec<usize>)> {
        let taken = (&readings, &weights);
        let problem = Problem::new(&self.0, solver, &values, free, &block, taken)?;
        problem.solve(py, solver, |problem, solver| {
            problem.fill(solver, |chain, row, reading, weight, solver| {
                let reading = Vector2::new(reading[0], reading[1]);
                let Ok(found) = chain.inverse_residual(row, &reading) else {
                    return false;
                };
                for axis in 0..2 {
                    // the solver wants the derivative of what is predicted: minus that of the residual
                    let line = problem
                        .free
                        .iter()
                        .map(|&k| -found.by_parameters[(axis, k)]);
                    solver.add(line, found.value[axis], weight[axis]);
                }
                true
            })
        })
    }
});

/// A calibrated spherical robot: where its tool points.
#[pyclass(frozen, module = "sherkit._core")]
pub struct SphericalCalibrated {
    robot: Core,
    model: Model,
    values: Values,
    elbows: Elbows,
}

impl calibrated::Calibrated<2> for SphericalCalibrated {
    type Core<'a> = &'a Core;

    fn core(&self) -> PyResult<&Core> {
        Ok(&self.robot)
    }

    fn write(&self, put: impl FnMut(f64)) -> PyResult<()> {
        write_spherical(&self.model, &self.values, self.elbows, put);
        Ok(())
    }

    fn forward_at(
        core: &&Core,
        joints: &Vector2<f64>,
        now: &Covariates,
    ) -> Result<(Vector2<f64>, Matrix2<f64>)> {
        core.forward(joints, now)
    }

    fn inverse_at(core: &&Core, place: &Vector2<f64>, now: &Covariates) -> Result<Vector2<f64>> {
        core.inverse(place, now)
    }
}

calibrated_class!(SphericalCalibrated, 2, angles, angles, {
    /// The model with identified `values` of all its parameters.
    #[new]
    #[pyo3(signature = (model, values, elbows="open"))]
    fn new(
        model: PyRef<'_, SphericalModel>,
        values: PyReadonlyArray1<'_, f64>,
        elbows: &str,
    ) -> PyResult<Self> {
        let values = fixed("values", &values)?;
        let (model, elbows) = (model.0, elbows_of(elbows)?);
        let robot = Core::new(&model, &values, elbows).map_err(to_python)?;
        Ok(Self {
            robot,
            model,
            values,
            elbows,
        })
    }

    /// φ, γ `(n, 2)`, their derivatives by the parameters in `free` `(n, 2, free)`, and which rows are in reach.
    fn by_parameters_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
        covariates: Vec<f64>,
        free: Vec<usize>,
    ) -> PyResult<WithDerivative<'py>> {
        check_free::<PARAMETERS>(&free)?;
        let (now, wanted) = (now(&covariates)?, Wanted::of(CATALOGUE, &free));
        let q = rows::<2, _>("joints", &joints)?.to_vec();
        let mut out = Rows::new(q.len(), 2, 1);
        let mut by_parameters = Rows::new(q.len(), 2, free.len());
        let mut reached = vec![false; q.len()];
        py.detach(|| {
            for (i, q) in q.iter().enumerate() {
                if let Ok(found) = self.robot.predict(&Vector2::from(*q), &now, wanted) {
                    reached[i] = true;
                    out.put(i, &found.value);
                    by_parameters.put_columns(i, &found.by_parameters, &free);
                }
            }
        });
        Ok((
            out.vectors(py)?,
            by_parameters.matrices(py)?,
            PyArray1::from_vec(py, reached),
        ))
    }
});

/// What a camera sees from a distance from the centre, by default from the best one (Eqs. 29 to 33).
#[pyfunction]
#[pyo3(signature = (radius_mm, lens_rad, weight, region="half", distance_mm=None))]
pub fn spherical_camera_placement<'py>(
    py: Python<'py>,
    radius_mm: f64,
    lens_rad: f64,
    weight: f64,
    region: &str,
    distance_mm: Option<f64>,
) -> PyResult<Bound<'py, PyDict>> {
    let region = region_of(region)?;
    let found = match distance_mm {
        None => vision::best_placement(radius_mm, lens_rad, weight, region),
        Some(distance) => vision::placement(radius_mm, distance, lens_rad, weight, region),
    }
    .map_err(to_python)?;
    let out = PyDict::new(py);
    out.set_item("distance_mm", found.distance_mm)?;
    out.set_item("half_angle_rad", found.half_angle_rad)?;
    out.set_item("coverage", found.coverage)?;
    out.set_item("seen_mm2", found.seen_mm2)?;
    out.set_item("waste_mm2", found.waste_mm2)?;
    out.set_item("benefit_mm2", found.benefit_mm2)?;
    Ok(out)
}
