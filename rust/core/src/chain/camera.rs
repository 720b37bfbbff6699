//! A sensor that shows pixels: one camera.

use super::effects::{Wanted, places, values_of};
use super::{Sensor, Table};
use crate::Result;
use crate::camera::{Camera, Description, Projection, left_jacobian};
use nalgebra::{Matrix2x3, SMatrix, SVector, Vector2, Vector3};

places! { camera_pose focal_length principal_point lens_distortion }

/// A camera with the errors of its pose and its lens.
#[derive(Clone, Copy, Debug)]
pub struct Eye {
    pub(crate) camera: Camera,
    /// Nominal focal lengths, px.
    focal: [f64; 2],
    /// Turn about its own axes, rad.
    turn: Vector3<f64>,
}

impl Eye {
    /// A nominal camera with the effects that a robot has.
    ///
    /// # Errors
    /// As [`Camera::new`].
    pub(crate) fn new<T: Table, const P: usize>(
        nominal: &Description,
        values: &[f64; P],
    ) -> Result<Self> {
        let at = T::AT.camera;
        let pose: [f64; 6] = values_of(at.camera_pose, values);
        let turn = Vector3::new(pose[0], pose[1], pose[2]);
        let mut camera = *nominal;
        camera.translation += Vector3::new(pose[3], pose[4], pose[5]);
        let [longer] = values_of(at.focal_length, values);
        let [fx, fy, cx, cy] = nominal.intrinsics;
        let [du, dv] = values_of(at.principal_point, values);
        camera.intrinsics = [fx * (1.0 + longer), fy * (1.0 + longer), cx + du, cy + dv];
        let bent: [f64; 4] = values_of(at.lens_distortion, values);
        for (k, d) in camera.distortion.iter_mut().zip(bent) {
            *k += d;
        }
        Ok(Self {
            camera: Camera::new(&camera)?.turned(&turn),
            focal: [fx, fy],
            turn,
        })
    }

    /// Writes the wanted columns of the camera's errors.
    #[inline]
    pub(crate) fn columns<T: Table, const P: usize>(
        &self,
        projection: &Projection,
        point: &Vector3<f64>,
        wanted: Wanted,
        d: &mut SMatrix<f64, 2, P>,
    ) {
        let at = T::AT.camera;
        if let Some(place) = wanted.wants(at.camera_pose) {
            let turned = self.camera.rotation() * point;
            let by_turn = -(projection.by_seen * turned.cross_matrix() * left_jacobian(&self.turn));
            d.fixed_columns_mut::<3>(place.start).copy_from(&by_turn);
            d.fixed_columns_mut::<3>(place.start + 3)
                .copy_from(&projection.by_seen);
        }
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
    fn value(&self, point: &Vector3<f64>, _: f64) -> Result<Vector2<f64>> {
        self.camera.project(point)
    }

    #[inline]
    fn predict<T: Table, const P: usize>(
        &self,
        point: &Vector3<f64>,
        _: f64,
        wanted: Wanted,
        d: &mut SMatrix<f64, 2, P>,
    ) -> Result<(SVector<f64, 2>, Matrix2x3<f64>)> {
        let projection = self.camera.projection(point)?;
        self.columns::<T, P>(&projection, point, wanted, d);
        Ok((projection.pixel, self.camera.by_point(&projection)))
    }
}
