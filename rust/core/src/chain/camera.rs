//! A sensor that shows pixels: one camera.

use super::body::since;
use super::effects::{Wanted, values_of};
use super::sensor::{Look, Sensor};
use super::table::Table;
use crate::camera::{Camera, Description, Projection, left_jacobian};
use crate::{Error, Result};
use nalgebra::{Matrix2x3, SMatrix, SVector, Vector2, Vector3};

/// A camera with the errors of its pose and its lens.
#[derive(Clone, Copy, Debug)]
pub struct Eye {
    stand: Stand,
    /// From the moment of the slip on, where it slips.
    slipped: Option<Stand>,
    slip_time_s: f64,
    /// Nominal focal lengths, px.
    focal: [f64; 2],
}

/// A camera where it stands.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stand {
    pub(crate) camera: Camera,
    /// Turn about its own axes, rad.
    turn: Vector3<f64>,
}

impl Stand {
    /// A camera whose pose is off by a turn about its own axes and a translation.
    fn new(camera: &Description, pose: &[f64; 6]) -> Result<Self> {
        let turn = Vector3::new(pose[0], pose[1], pose[2]);
        let mut camera = *camera;
        camera.translation += Vector3::new(pose[3], pose[4], pose[5]);
        let camera = Camera::new(&camera)?.turned(&turn);
        Ok(Self { camera, turn })
    }
}

impl Eye {
    /// A nominal camera with the effects that a robot has; it slips at a moment, s.
    ///
    /// # Errors
    /// As [`Camera::new`].
    pub(crate) fn new<T: Table, const P: usize>(
        nominal: &Description,
        slip_time_s: f64,
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
        let mut pose: [f64; 6] = values_of(at.camera_pose, values);
        let stand = Stand::new(&camera, &pose)?;
        let slip: [f64; 6] = values_of(at.camera_slip, values);
        let slipped = if slip == [0.0; 6] {
            None
        } else {
            for (p, s) in pose.iter_mut().zip(slip) {
                *p += s;
            }
            Some(Stand::new(&camera, &pose)?)
        };
        Ok(Self {
            stand,
            slipped,
            slip_time_s,
            focal: [fx, fy],
        })
    }

    /// The camera as it stands before it slips.
    pub(crate) fn camera(&self) -> &Camera {
        &self.stand.camera
    }

    /// The camera as it stands when a picture is taken.
    pub(crate) fn at(&self, look: Look) -> Result<&Stand> {
        match &self.slipped {
            Some(_) if look.time_s.is_nan() => Err(Error::NotFinite { index: 0 }),
            Some(slipped) if look.time_s >= self.slip_time_s => Ok(slipped),
            _ => Ok(&self.stand),
        }
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
        let (pose, slip) = (wanted.wants(at.camera_pose), wanted.wants(at.camera_slip));
        if pose.is_some() || slip.is_some() {
            let turned = stand.camera.rotation() * point;
            let by_turn =
                -(projection.by_seen * turned.cross_matrix() * left_jacobian(&stand.turn));
            for (place, share) in [(pose, 1.0), (slip, since(look.time_s, self.slip_time_s))] {
                if let Some(place) = place {
                    d.fixed_columns_mut::<3>(place.start)
                        .copy_from(&(by_turn * share));
                    d.fixed_columns_mut::<3>(place.start + 3)
                        .copy_from(&(projection.by_seen * share));
                }
            }
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
    fn value(&self, point: &Vector3<f64>, look: Look) -> Result<Vector2<f64>> {
        self.at(look)?.camera.project(point)
    }

    #[inline]
    fn predict<T: Table, const P: usize>(
        &self,
        point: &Vector3<f64>,
        look: Look,
        wanted: Wanted,
        d: &mut SMatrix<f64, 2, P>,
    ) -> Result<(SVector<f64, 2>, Matrix2x3<f64>)> {
        let stand = self.at(look)?;
        let projection = stand.camera.projection(point)?;
        self.columns::<T, P>(stand, &projection, point, look, wanted, d);
        Ok((projection.pixel, stand.camera.by_point(&projection)))
    }
}
