//! A sensor that shows pixels: one camera.

use super::effects::{Wanted, values_of};
use super::sensor::{Look, Sensor};
use super::sensor_pose::{Moments, SensorPose, Stand};
use super::table::Table;
use crate::Result;
use crate::camera::{Camera, Description, Projection};
use nalgebra::{Matrix2x3, SMatrix, SVector, Vector2, Vector3};

/// A camera with the errors of its pose and its lens.
#[derive(Clone, Copy, Debug)]
pub struct Eye {
    pose: SensorPose,
    /// Where it stands before it slips or drifts, if ever.
    camera: Camera,
    /// Nominal focal lengths, px.
    focal: [f64; 2],
}

impl Eye {
    /// A nominal camera with the effects that a robot has.
    ///
    /// # Errors
    /// As [`Camera::new`].
    pub(crate) fn new<T: Table, const P: usize>(
        nominal: &Description,
        moments: Moments,
        values: &[f64; P],
    ) -> Result<Self> {
        let at = T::AT.camera;
        let mut camera = *nominal;
        let [longer] = values_of(at.focal_length, values);
        let [fx, fy, cx, cy] = nominal.intrinsics;
        let [du, dv] = values_of(at.principal_point, values);
        camera.intrinsics = [fx * (1.0 + longer), fy * (1.0 + longer), cx + du, cy + dv];
        let bent: [f64; 4] = values_of(at.lens_distortion, values);
        for (k, d) in camera.distortion.iter_mut().zip(bent) {
            *k += d;
        }
        let camera = Camera::new(&camera)?;
        let pose = SensorPose::new::<T, P>(&camera.frame(), moments, values);
        Ok(Self {
            camera: camera.standing(&pose.first().frame),
            pose,
            focal: [fx, fy],
        })
    }

    /// The camera as it stands before it slips or drifts.
    pub(crate) fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The camera as it stands when a picture is taken.
    pub(crate) fn at(&self, look: Look) -> Result<(Camera, Stand)> {
        let stand = self.pose.at(look)?;
        Ok((self.camera.standing(&stand.frame), stand))
    }

    /// Writes the wanted columns of the camera's errors.
    #[inline]
    pub(crate) fn columns<T: Table, const P: usize>(
        &self,
        stand: &Stand,
        projection: &Projection,
        point: &Vector3<f64>,
        look: Look,
        wanted: Wanted,
        d: &mut SMatrix<f64, 2, P>,
    ) {
        let at = T::AT.camera;
        let turned = stand.frame.rotation * point;
        self.pose
            .columns::<T, 2, P>(stand, &turned, &projection.by_seen, look, wanted, d);
        let by = &projection.by_intrinsics;
        if let Some(place) = wanted.wants(at.focal_length) {
            let focal = by.column(0) * self.focal[0] + by.column(1) * self.focal[1];
            d.set_column(place.start, &focal);
        }
        if let Some(place) = wanted.wants(at.principal_point) {
            d.fixed_columns_mut::<2>(place.start)
                .copy_from(&by.fixed_columns::<2>(2));
        }
        if let Some(place) = wanted.wants(at.lens_distortion) {
            d.fixed_columns_mut::<4>(place.start)
                .copy_from(&projection.by_distortion.fixed_columns::<4>(0));
        }
    }
}

impl Sensor<2> for Eye {
    #[inline]
    fn value(&self, point: &Vector3<f64>, look: Look) -> Result<Vector2<f64>> {
        self.at(look)?.0.project(point)
    }

    #[inline]
    fn predict<T: Table, const P: usize>(
        &self,
        point: &Vector3<f64>,
        look: Look,
        wanted: Wanted,
        d: &mut SMatrix<f64, 2, P>,
    ) -> Result<(SVector<f64, 2>, Matrix2x3<f64>)> {
        let (camera, stand) = self.at(look)?;
        let projection = camera.projection(point)?;
        self.columns::<T, P>(&stand, &projection, point, look, wanted, d);
        Ok((projection.pixel, camera.by_point(&projection)))
    }
}
