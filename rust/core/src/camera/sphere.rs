//! From a pixel to the point of a sphere about the base's origin, exact for any pose of the camera.

use super::Camera;
use crate::numbers::math::sqrt;
use crate::{Error, Result};
use nalgebra::{Vector2, Vector3};

/// Which of the two points is meant where the line of sight enters and leaves the sphere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Face {
    /// Where it enters: the side that faces the camera (the paper's set-up).
    #[default]
    Near,
    /// Where it leaves.
    Far,
}

impl Camera {
    /// Line of sight of a pixel: optical centre (mm) and unit direction, base frame.
    ///
    /// # Errors
    /// As [`Self::undistort`].
    pub fn ray(&self, pixel: &Vector2<f64>) -> Result<(Vector3<f64>, Vector3<f64>)> {
        let direction = self.rotation.transpose() * self.undistort(pixel)?;
        Ok((self.position(), direction / direction.norm()))
    }

    /// Point of the sphere of a radius about the base's origin that a pixel shows, mm.
    ///
    /// # Errors
    /// [`Error::RayMisses`] says by how much, [`Error::BehindCamera`] where the point is on the line of sight
    /// backwards; as [`Self::undistort`].
    pub fn on_sphere(
        &self,
        pixel: &Vector2<f64>,
        radius_mm: f64,
        face: Face,
    ) -> Result<Vector3<f64>> {
        let (origin, direction) = self.ray(pixel)?;
        let along = origin.dot(&direction);
        // the foot of the perpendicular, and not |C|² - along², keeps the digits of a camera far away
        let foot = origin - direction * along;
        let miss = foot.norm();
        let half_chord_squared = (radius_mm - miss) * (radius_mm + miss);
        if half_chord_squared < 0.0 {
            let miss_mm = miss - radius_mm;
            return Err(Error::RayMisses { miss_mm });
        }
        let half_chord = match face {
            Face::Near => -sqrt(half_chord_squared),
            Face::Far => sqrt(half_chord_squared),
        };
        let distance = half_chord - along;
        if distance <= 0.0 {
            let depth_mm = distance;
            return Err(Error::BehindCamera { depth_mm });
        }
        let point = foot + direction * half_chord;
        point
            .iter()
            .position(|c| !c.is_finite())
            .map_or(Ok(point), |index| Err(Error::NotFinite { index }))
    }
}
