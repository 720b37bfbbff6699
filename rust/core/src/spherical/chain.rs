//! The whole measurement chain of the spherical robot seen by a camera, with every effect and exact derivatives.
//!
//! joint readings → joints → structure → body → sensor → reading. Each link maps a value to a value; the derivative
//! by a parameter is that of its own link, carried on by the derivatives of the links behind it. With all effects at
//! zero the chain is the paper's model: a marker on the tool axis, on a sphere about the remote centre, seen by the
//! nominal camera.
//!
//! A covariate that a row lacks is NaN; an effect that needs it must then be at zero, where it is not asked.

use super::geometry::{Geometry, LIMBS, PER_LIMB};
use super::joints::{Covariates, JointEffects};
use super::kinematics::Kinematics;
use super::parameters::{
    AXIS_OFFSET, CAMERA_POSE, DATUM, FOCAL_LENGTH, GEOMETRY, GRAVITY_FLEXURE, LENS_DISTORTION,
    MARKER_OFFSET, PARAMETERS, PRINCIPAL_POINT, UNEQUAL_LIMBS, Values, of,
};
use super::pose::{angles_by_axis, angles_of};
use super::structure::{Displaced, Extras, INPUTS, Structure};
use crate::camera::{Camera, Description, Face, Projection, left_jacobian};
use crate::{Error, Result};
use nalgebra::{Matrix2, Matrix2x3, Matrix3x2, SMatrix, Vector2, Vector3};

/// Nominal robot and camera, and the settings of the effects: what the drawing and the user say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Nominal geometry.
    pub geometry: Geometry,
    /// Nominal radius of the sphere on which the marker moves, mm.
    pub radius_mm: f64,
    /// Nominal camera.
    pub camera: Description,
    /// Side of the sphere that the camera sees.
    pub face: Face,
    /// Direction in which the weight pulls, base frame, of any length but zero.
    pub gravity: Vector3<f64>,
    /// Joint readings of the home position, rad, about which scale errors turn.
    pub home: [f64; LIMBS],
}

/// What was read at a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Pixel of the marker, u and v.
    Pixels,
    /// Direction of the marker seen from the nominal centre, φ and γ, rad.
    Angles,
}

/// A row: where the joints were, what else is known, what was read there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Joint readings, rad.
    pub joints: [f64; LIMBS],
    /// Time, temperature, directions, velocities.
    pub covariates: Covariates,
    /// Added to the marker before the sensor sees it, mm: a user's own effect.
    pub push: Vector3<f64>,
    /// What was read.
    pub kind: Kind,
}

/// Reading of one row with its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Prediction {
    /// What the sensor would show, px or rad.
    pub value: Vector2<f64>,
    /// By the joint readings.
    pub by_joints: Matrix2<f64>,
    /// By a displacement of the marker, mm.
    pub by_body: Matrix2x3<f64>,
    /// By the parameters, one column each.
    pub by_parameters: SMatrix<f64, 2, PARAMETERS>,
}

/// Displacement of the platform's centre from the remote centre, with its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Centre {
    /// Base frame, mm.
    pub value: Vector3<f64>,
    /// By the joint readings.
    pub by_joints: Matrix3x2<f64>,
    /// By the parameters, one column each.
    pub by_parameters: SMatrix<f64, 3, PARAMETERS>,
}

/// A robot with given errors and effects, ready to predict.
#[derive(Clone, Copy, Debug)]
pub struct Chain {
    pub(super) kinematics: Kinematics,
    pub(super) effects: JointEffects,
    pub(super) camera: Camera,
    pub(super) radius: f64,
    pub(super) datum: [f64; 2],
    pub(super) face: Face,
    geometry: Geometry,
    extras: Extras,
    /// Nominal focal lengths, px.
    focal: [f64; 2],
    turn: Vector3<f64>,
}

impl Model {
    /// The robot with the given parameter values.
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`] and [`Error::InvalidCamera`] where the errors leave no robot or camera,
    /// [`Error::NotFinite`] for a value that is none.
    pub fn with(&self, values: &Values) -> Result<Chain> {
        if let Some(index) = values.iter().position(|v| !v.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        let settings = self.home.iter().chain(&self.gravity);
        if let Some(index) = settings.clone().position(|v| !v.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        let norm = self.gravity.norm();
        if !(norm > 0.0 && norm.is_finite()) {
            let what = "gravity needs a direction";
            return Err(Error::InvalidGeometry { limb: 0, what });
        }
        let [alpha, beta, radius] = of(values, GEOMETRY);
        let [more_alpha, more_beta] = of(values, UNEQUAL_LIMBS);
        let mut p = self.geometry.parameters();
        for (limb, sign) in [(0, 1.0), (1, -1.0)] {
            p[limb * PER_LIMB] += alpha + sign * more_alpha;
            p[limb * PER_LIMB + 1] += beta + sign * more_beta;
        }
        let geometry = Geometry::from_parameters(&p, self.geometry.assembly);
        let radius = self.radius_mm + radius;
        // written so that a NaN is refused, too
        if !(radius > 0.0 && radius.is_finite()) {
            let what = "the radius of the sphere must be positive";
            return Err(Error::InvalidGeometry { limb: 0, what });
        }
        let pose = of::<6>(values, CAMERA_POSE);
        let turn = Vector3::new(pose[0], pose[1], pose[2]);
        let mut camera = self.camera;
        camera.translation += Vector3::new(pose[3], pose[4], pose[5]);
        let [longer] = of(values, FOCAL_LENGTH);
        let [fx, fy, cx, cy] = self.camera.intrinsics;
        let [du, dv] = of(values, PRINCIPAL_POINT);
        camera.intrinsics = [fx * (1.0 + longer), fy * (1.0 + longer), cx + du, cy + dv];
        for (k, d) in camera.distortion.iter_mut().zip(&values[LENS_DISTORTION]) {
            *k += d;
        }
        let misses = of::<4>(values, AXIS_OFFSET);
        Ok(Chain {
            kinematics: Kinematics::new(&geometry)?,
            effects: JointEffects::new(values, self.home),
            camera: Camera::new(&camera)?.turned(&turn),
            radius,
            datum: of(values, DATUM),
            face: self.face,
            geometry,
            extras: Extras {
                radius,
                misses: [[misses[0], misses[1]], [misses[2], misses[3]]],
                flexure: of(values, GRAVITY_FLEXURE),
                marker: of(values, MARKER_OFFSET),
                gravity: self.gravity / norm,
            },
            focal: [fx, fy],
            turn,
        })
    }
}

impl Chain {
    /// The robot's kinematics with its errors, without effects of joints and body.
    #[must_use]
    pub fn kinematics(&self) -> &Kinematics {
        &self.kinematics
    }

    /// The camera with its errors.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    fn mean_azimuth(&self, joints: &Vector2<f64>) -> f64 {
        let [a, b] = &self.geometry.limbs;
        0.5 * (joints.x + a.offset_rad + (joints.y + b.offset_rad))
    }

    /// Marker of a row, base frame, mm.
    ///
    /// # Errors
    /// As [`Kinematics::pose`].
    pub fn marker(&self, row: &Row) -> Result<Vector3<f64>> {
        let joints = self.effects.at(&row.joints, &row.covariates);
        let structure = Structure::solve(&self.kinematics, &self.extras, &joints.value)?;
        Ok(structure.marker + row.push)
    }

    /// Reading of a row.
    ///
    /// # Errors
    /// As [`Kinematics::pose`] and [`Camera::project`]; [`Error::SingularPose`] where angles are read at γ = 0;
    /// [`Error::NotFinite`] where an active effect lacks its covariate.
    pub fn row_value(&self, row: &Row) -> Result<Vector2<f64>> {
        let marker = self.marker(row)?;
        match row.kind {
            Kind::Pixels => self.camera.project(&marker),
            Kind::Angles => {
                let joints = self.effects.at(&row.joints, &row.covariates);
                let seen = angles_of(&marker, self.mean_azimuth(&joints.value))?;
                checked(Vector2::from(seen) + Vector2::from(self.datum))
            }
        }
    }

    /// Reading of a row with its derivatives. A column whose covariate is missing is NaN.
    ///
    /// # Errors
    /// As [`Self::row_value`].
    #[inline]
    pub fn row_predict(&self, row: &Row) -> Result<Prediction> {
        let joints = self.effects.at(&row.joints, &row.covariates);
        let structure = Structure::solve(&self.kinematics, &self.extras, &joints.value)?;
        let marker = structure.marker + row.push;
        let mut d = SMatrix::<f64, 2, PARAMETERS>::zeros();
        let (value, by_body) = match row.kind {
            Kind::Pixels => {
                let projection = self.camera.projection(&marker)?;
                self.camera_columns(&mut d, &projection, &marker);
                (projection.pixel, self.camera.by_point(&projection))
            }
            Kind::Angles => {
                let seen = angles_of(&marker, self.mean_azimuth(&joints.value))?;
                d[(0, DATUM.start)] = 1.0;
                d[(1, DATUM.start + 1)] = 1.0;
                let value = checked(Vector2::from(seen) + Vector2::from(self.datum))?;
                (value, angles_by_axis(&marker, seen[1]))
            }
        };
        let by_inputs = by_body * structure.by_inputs(&self.extras);
        let by_joints = Self::structure_columns(&mut d, &by_inputs);
        joints.columns(&mut d, &by_joints);
        let places = [
            GEOMETRY.start + 2,
            MARKER_OFFSET.start,
            MARKER_OFFSET.start + 1,
        ];
        for (place, by) in places.into_iter().zip(structure.by_body()) {
            d.set_column(place, &(by_body * by));
        }
        let Structure { pose, .. } = &structure;
        for i in 0..LIMBS {
            let misses = [pose.normals[i], pose.tangents[i]];
            for (k, by) in misses.iter().enumerate() {
                d.set_column(AXIS_OFFSET.start + 2 * i + k, &(by_body * by * 0.5));
            }
        }
        Ok(Prediction {
            value,
            by_joints: joints.by_readings(by_joints),
            by_body,
            by_parameters: d,
        })
    }

    /// Writes the columns of geometry and flexure; returns the derivative by the joints.
    fn structure_columns(
        d: &mut SMatrix<f64, 2, PARAMETERS>,
        by_inputs: &SMatrix<f64, 2, INPUTS>,
    ) -> Matrix2<f64> {
        for (k, first) in [2, 4].into_iter().enumerate() {
            let (one, two) = (by_inputs.column(first), by_inputs.column(first + 1));
            d.set_column(GEOMETRY.start + k, &(one + two));
            d.set_column(UNEQUAL_LIMBS.start + k, &(one - two));
        }
        d.fixed_columns_mut::<LIMBS>(GRAVITY_FLEXURE.start)
            .copy_from(&by_inputs.fixed_columns::<LIMBS>(6));
        by_inputs.fixed_columns::<LIMBS>(0).into_owned()
    }

    /// Writes the columns of the camera's errors.
    pub(super) fn camera_columns(
        &self,
        d: &mut SMatrix<f64, 2, PARAMETERS>,
        projection: &Projection,
        point: &Vector3<f64>,
    ) {
        let turned = self.camera.rotation() * point;
        let by_turn = -(projection.by_seen * turned.cross_matrix() * left_jacobian(&self.turn));
        d.fixed_columns_mut::<3>(CAMERA_POSE.start)
            .copy_from(&by_turn);
        d.fixed_columns_mut::<3>(CAMERA_POSE.start + 3)
            .copy_from(&projection.by_seen);
        let by = &projection.by_intrinsics;
        let focal = by.column(0) * self.focal[0] + by.column(1) * self.focal[1];
        d.set_column(FOCAL_LENGTH.start, &focal);
        d.fixed_columns_mut::<2>(PRINCIPAL_POINT.start)
            .copy_from(&by.fixed_columns::<2>(2));
        d.fixed_columns_mut::<4>(LENS_DISTORTION.start)
            .copy_from(&projection.by_distortion.fixed_columns::<4>(0));
    }

    /// Displacement of the platform's centre from the remote centre at joint readings, by elbow axes that miss it.
    ///
    /// # Errors
    /// [`Error::NotFinite`] where an active effect lacks its covariate.
    pub fn centre(&self, readings: &[f64; LIMBS], row: &Covariates) -> Result<Centre> {
        let joints = self.effects.at(readings, row);
        let [a, b] = &self.geometry.limbs;
        let azimuths = [joints.value.x + a.offset_rad, joints.value.y + b.offset_rad];
        let alphas = [a.alpha_rad, b.alpha_rad];
        let displaced = Displaced::at(azimuths, alphas, &self.extras.misses);
        let mut d = SMatrix::<f64, 3, PARAMETERS>::zeros();
        let (one, two) = (displaced.by_alphas.column(0), displaced.by_alphas.column(1));
        d.set_column(GEOMETRY.start, &(one + two));
        d.set_column(UNEQUAL_LIMBS.start, &(one - two));
        for (k, by) in displaced.by_misses.iter().enumerate() {
            d.set_column(AXIS_OFFSET.start + k, by);
        }
        joints.columns(&mut d, &displaced.by_azimuths);
        if let Some(index) = displaced.value.iter().position(|v| !v.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        Ok(Centre {
            value: displaced.value,
            by_joints: joints.by_readings(displaced.by_azimuths),
            by_parameters: d,
        })
    }
}

fn checked(value: Vector2<f64>) -> Result<Vector2<f64>> {
    value
        .iter()
        .position(|v| !v.is_finite())
        .map_or(Ok(value), |index| Err(Error::NotFinite { index }))
}
