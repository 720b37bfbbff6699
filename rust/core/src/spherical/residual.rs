//! The residual that the paper minimises: measured joints minus the inverse kinematics of what was seen (Eq. 6).
//!
//! Kinematics, sphere, camera, datum and the effects of the joints take part; those of the body (axes that miss the
//! centre, flexure, offset, growth, drift and slip of the marker) have no place in it and are left out, with columns of
//! zero.

use super::effects::{AT, PARAMETERS};
use super::geometry::{LIMBS, PER_LIMB};
use super::model::{Chain, Instrument, Row};
use super::nominal::Model;
use crate::camera::{Camera, Face};
use crate::chain::effects::Wanted;
use crate::chain::{Look, angles_by_axis, angles_of};
use crate::{Error, Result};
use core::f64::consts::TAU;
use nalgebra::{Matrix3, SMatrix, Vector2, Vector3};

/// Residual of one row with its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct InverseResidual {
    /// Measured minus computed joint angles, rad, within half a turn.
    pub value: Vector2<f64>,
    /// By the parameters, one column each.
    pub by_parameters: SMatrix<f64, 2, PARAMETERS>,
}

impl Camera {
    /// φ, γ of the point of a sphere about the origin that a pixel shows, rad.
    ///
    /// # Errors
    /// As [`Camera::on_sphere`]; [`Error::SingularPose`] at γ = 0.
    pub fn angles_on_sphere(
        &self,
        pixel: &Vector2<f64>,
        radius_mm: f64,
        face: Face,
    ) -> Result<Vector2<f64>> {
        let point = self.on_sphere(pixel, radius_mm, face)?;
        let azimuth = libm::atan2(point.y, point.x);
        angles_of(&point, azimuth).map(Vector2::from)
    }
}

impl Chain {
    /// Direction seen at a reading: φ, γ, and their derivatives by the parameters.
    fn seen(
        &self,
        reading: &Vector2<f64>,
        look: Look,
    ) -> Result<(Vector2<f64>, SMatrix<f64, 2, PARAMETERS>)> {
        let mut d = SMatrix::<f64, 2, PARAMETERS>::zeros();
        let (eye, face) = match &self.sensor {
            Instrument::Camera(eye, face) => (eye, *face),
            Instrument::Angles(angles) => {
                if let Some(index) = reading.iter().position(|v| !v.is_finite()) {
                    return Err(Error::NotFinite { index });
                }
                if let Some(place) = AT.angles.datum {
                    d[(0, place.start)] = -1.0;
                    d[(1, place.start + 1)] = -1.0;
                }
                return Ok((reading - angles.datum, d));
            }
        };
        let radius = self.structure.radius();
        let (camera, stand) = eye.at(look)?;
        let point = camera.on_sphere(reading, radius, face)?;
        let angles = angles_of(&point, libm::atan2(point.y, point.x))?;
        let projection = camera.projection(&point)?;
        // the pixel is held and the point stays on the sphere: (∂π/∂X; Xᵀ) dX = (-∂π/∂p dp; R dR)
        let by_point = camera.by_point(&projection);
        let mut held = Matrix3::zeros();
        held.fixed_rows_mut::<2>(0).copy_from(&by_point);
        held.set_row(2, &point.transpose());
        let answers = held
            .try_inverse()
            .ok_or(Error::RayMisses { miss_mm: 0.0 })?;
        let by_pixel = answers.fixed_columns::<2>(0);
        eye.columns::<Model, PARAMETERS>(&stand, &projection, &point, look, Wanted::ALL, &mut d);
        let by_axis = angles_by_axis(&point, angles[1]);
        d = -(by_axis * by_pixel) * d;
        let by_radius: Vector3<f64> = answers.column(2) * radius;
        if let Some(place) = AT.structure.geometry {
            d.set_column(place.start + 2, &(by_axis * by_radius));
        }
        Ok((Vector2::from(angles), d))
    }

    /// Measured joints minus the inverse kinematics of the reading, with the elbows on the sides where they were
    /// measured.
    ///
    /// # Errors
    /// As [`Camera::on_sphere`] and [`super::Kinematics::inverse`] but for the assembly, which is not asked;
    /// [`Error::NotFinite`] where an active effect lacks its covariate.
    pub fn inverse_residual(&self, row: &Row, reading: &Vector2<f64>) -> Result<InverseResidual> {
        let readings = Vector2::from(row.joints);
        let joints = self
            .joints
            .at::<Model>(&readings, &row.covariates, Wanted::ALL);
        if let Some(index) = joints.value.iter().position(|v| !v.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        let (angles, by_seen) = self.seen(reading, self.look(&joints.value, &row.covariates))?;
        let pose = self
            .structure
            .kinematics()
            .pose_below(&angles, &joints.value)?;
        let mut value = joints.value - pose.joints;
        for v in value.iter_mut() {
            *v -= TAU * libm::rint(*v / TAU);
        }
        let by_angles = pose.pose.joints_by_angles()?;
        let own = pose.pose.joints_by_parameters()?;
        let mut d = SMatrix::<f64, 2, PARAMETERS>::zeros();
        let identity = nalgebra::Matrix2::identity();
        joints.columns::<Model, 2, PARAMETERS>(&identity, Wanted::ALL, &mut d);
        d -= by_angles * by_seen;
        if let (Some(both), Some(unequal)) = (AT.structure.geometry, AT.structure.unequal_limbs) {
            for k in 0..2 {
                for limb in 0..LIMBS {
                    let by = own[(limb, limb * PER_LIMB + k)];
                    let sign = if limb == 0 { 1.0 } else { -1.0 };
                    d[(limb, both.start + k)] -= by;
                    d[(limb, unequal.start + k)] -= sign * by;
                }
            }
        }
        Ok(InverseResidual {
            value,
            by_parameters: d,
        })
    }
}
