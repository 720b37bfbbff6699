//! The body link: from where the mechanism puts the measured point to where it is.
//!
//! What the stands do is computed here as well: an instrument that moves by `-s` sees, whatever it is, what it would see
//! of a point that moved by `s`.

use super::effects::{Wanted, values_of};
use super::row::Covariates;
use super::table::{Settings, Table};
use nalgebra::{SMatrix, Vector3};

/// Temperature at which the robot is as drawn, °C.
pub const REFERENCE_TEMPERATURE_C: f64 = 20.0;
const SECONDS_PER_HOUR: f64 = 3600.0;

/// Effects that act at the measured point, in the base frame.
#[derive(Clone, Copy, Debug)]
pub struct Body {
    thermal: f64,
    stand: Vector3<f64>,
    drift: Vector3<f64>,
    slip: Vector3<f64>,
    time_origin_s: f64,
    slip_time_s: f64,
}

impl Body {
    /// The link with the effects that a robot has.
    pub(crate) fn new<T: Table, const J: usize, const P: usize>(
        values: &[f64; P],
        settings: &Settings<J>,
    ) -> Self {
        let at = T::AT.body;
        let [thermal] = values_of(at.thermal_growth, values);
        Self {
            thermal,
            stand: Vector3::from(values_of::<3, P>(at.thermal_shift, values)),
            drift: Vector3::from(values_of::<3, P>(at.drift, values)),
            slip: Vector3::from(values_of::<3, P>(at.slip, values)),
            time_origin_s: settings.time_origin_s,
            slip_time_s: settings.slip_time_s,
        }
    }

    /// Whether the point is where the mechanism puts it, and no derivative by an effect is wanted.
    pub(crate) fn is_still<T: Table>(&self, wanted: Wanted) -> bool {
        let zero = Vector3::zeros();
        self.thermal == 0.0
            && self.stand == zero
            && self.drift == zero
            && self.slip == zero
            && !wanted.any(T::AT.body.rows)
    }

    /// The factor by which temperature scales a point about the origin of the base frame, and what time and slip add to
    /// it. An effect at zero does not ask for its covariate.
    #[inline]
    pub(crate) fn at<const J: usize>(&self, row: &Covariates<J>) -> (f64, Vector3<f64>) {
        let mut growth = 1.0;
        let mut shift = Vector3::zeros();
        if self.thermal != 0.0 {
            growth += self.thermal * warmer(row);
        }
        if self.drift != Vector3::zeros() {
            shift += self.drift * hours(row.time_s, self.time_origin_s);
        }
        if self.slip != Vector3::zeros() {
            shift += self.slip * self.slipped(row);
        }
        (growth, shift)
    }

    /// By how much an instrument sees the point beside where it is, since stands have moved apart.
    #[inline]
    pub(crate) fn apart<const J: usize>(&self, row: &Covariates<J>) -> Vector3<f64> {
        if self.stand == Vector3::zeros() {
            Vector3::zeros()
        } else {
            self.stand * standing(row)
        }
    }

    fn slipped<const J: usize>(&self, row: &Covariates<J>) -> f64 {
        since(row.time_s, self.slip_time_s)
    }

    /// Writes the wanted columns for the point that the mechanism gives, carried on by the derivative by the body.
    #[inline]
    pub(crate) fn columns<T: Table, const J: usize, const M: usize, const P: usize>(
        &self,
        point: &Vector3<f64>,
        row: &Covariates<J>,
        by_body: &SMatrix<f64, M, 3>,
        wanted: Wanted,
        d: &mut SMatrix<f64, M, P>,
    ) {
        let at = T::AT.body;
        if let Some(place) = wanted.wants(at.thermal_growth) {
            d.set_column(place.start, &(by_body * point * warmer(row)));
        }
        if let Some(place) = wanted.wants(at.thermal_shift) {
            d.fixed_columns_mut::<3>(place.start)
                .copy_from(&(by_body * standing(row)));
        }
        if let Some(place) = wanted.wants(at.drift) {
            d.fixed_columns_mut::<3>(place.start)
                .copy_from(&(by_body * hours(row.time_s, self.time_origin_s)));
        }
        if let Some(place) = wanted.wants(at.slip) {
            d.fixed_columns_mut::<3>(place.start)
                .copy_from(&(by_body * self.slipped(row)));
        }
    }
}

/// Hours since a moment, by which a drift counts; NaN where the time is not known.
#[inline]
pub(crate) fn hours(time_s: f64, origin_s: f64) -> f64 {
    (time_s - origin_s) / SECONDS_PER_HOUR
}

/// One from a moment on, zero before; NaN where the time is not known.
#[inline]
pub(crate) fn since(time_s: f64, moment_s: f64) -> f64 {
    if time_s.is_nan() {
        f64::NAN
    } else {
        f64::from(u8::from(time_s >= moment_s))
    }
}

/// By how much it is warmer than the drawing, °C; NaN where that is not known.
#[inline]
pub(crate) fn warmer<const J: usize>(row: &Covariates<J>) -> f64 {
    row.temperature_c - REFERENCE_TEMPERATURE_C
}

/// By how much the stands are warmer than when the drawing was made, °C; NaN where that is not known.
#[inline]
fn standing<const J: usize>(row: &Covariates<J>) -> f64 {
    row.stand_c - REFERENCE_TEMPERATURE_C
}
