//! A sensor that shows a direction: φ and γ of a point seen from the origin of the base frame.

use super::effects::{Wanted, values_of};
use super::sensor::{Look, Sensor};
use super::table::Table;
use crate::numbers::math::{sin_cos, sqrt};
use crate::{Error, Result, Singularity};
use nalgebra::{Matrix2x3, SMatrix, Vector2, Vector3};

/// Sines below this count as none: there a direction has no azimuth.
const SINGULAR: f64 = 1e-9;

/// Angles with an arbitrary zero.
#[derive(Clone, Copy, Debug)]
pub struct Angles {
    pub(crate) datum: Vector2<f64>,
}

impl Angles {
    /// The instrument with the effects that a robot has.
    pub(crate) fn new<T: Table, const P: usize>(values: &[f64; P]) -> Self {
        Self {
            datum: Vector2::from(values_of::<2, P>(T::AT.angles.datum, values)),
        }
    }
}

impl Sensor<2> for Angles {
    #[inline]
    fn value(&self, point: &Vector3<f64>, look: Look) -> Result<Vector2<f64>> {
        Ok(Vector2::from(angles_of(point, look.azimuth)?) + self.datum)
    }

    #[inline]
    fn predict<T: Table, const P: usize>(
        &self,
        point: &Vector3<f64>,
        look: Look,
        wanted: Wanted,
        d: &mut SMatrix<f64, 2, P>,
    ) -> Result<(Vector2<f64>, Matrix2x3<f64>)> {
        let seen = angles_of(point, look.azimuth)?;
        if let Some(place) = wanted.wants(T::AT.angles.datum) {
            d.fixed_columns_mut::<2>(place.start).fill_with_identity();
        }
        Ok((
            Vector2::from(seen) + self.datum,
            angles_by_axis(point, seen[1]),
        ))
    }
}

/// φ, γ of a direction, φ within a quarter turn of `mean`; γ is negative where that takes the other side of the
/// polar axis.
pub(crate) fn angles_of(direction: &Vector3<f64>, mean: f64) -> Result<[f64; 2]> {
    let (sin, cos) = sin_cos(mean);
    let x = direction.x * cos + direction.y * sin;
    let y = direction.y * cos - direction.x * sin;
    let polar = sqrt(x * x + y * y);
    if polar < SINGULAR * direction.norm() {
        return Err(Error::SingularPose(Singularity::Pole));
    }
    let side = 1.0_f64.copysign(x);
    let phi = mean + libm::atan2(side * y, x.abs());
    Ok([phi, side * libm::atan2(polar, direction.z)])
}

/// Derivative of φ, γ of a direction of any length by that direction; `gamma` gives the side.
pub(crate) fn angles_by_axis(v: &Vector3<f64>, gamma: f64) -> Matrix2x3<f64> {
    let polar_squared = v.x * v.x + v.y * v.y;
    let polar = sqrt(polar_squared).copysign(gamma);
    let squared = polar_squared + v.z * v.z;
    let along = v.z / (squared * polar);
    Matrix2x3::new(
        -v.y / polar_squared,
        v.x / polar_squared,
        0.0,
        v.x * along,
        v.y * along,
        -polar / squared,
    )
}
