//! Rows of a run: where the joints were, what else is known; readings at one place, or a distance between two places,
//! in which the datum cancels.

use super::effects::Wanted;
use super::gauges::{self, Around, Fixed, Gauge};
use super::{Chain, Mechanism, Robot};
use crate::Result;
use nalgebra::{SMatrix, SVector, Vector3};

/// What a row brings besides its readings. NaN where it is not known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariates<const J: usize> {
    /// Time of the reading, s.
    pub time_s: f64,
    /// Temperature, °C.
    pub temperature_c: f64,
    /// Temperature of what the instrument and the robot stand on, °C: that of the room, later. A control loop, which has no
    /// instrument, leaves it where the drawing was made.
    pub stand_c: f64,
    /// What hangs at the target besides the robot's own weight, kg.
    pub payload_kg: f64,
    /// Direction of the last motion of each joint, ±1 or 0.
    pub direction: [f64; J],
    /// Velocity of each joint, its unit by s.
    pub velocity: [f64; J],
}

impl<const J: usize> Covariates<J> {
    /// Nothing known.
    pub const NONE: Self = Self {
        time_s: f64::NAN,
        temperature_c: f64::NAN,
        stand_c: f64::NAN,
        payload_kg: f64::NAN,
        direction: [f64::NAN; J],
        velocity: [f64::NAN; J],
    };
}

/// What of a robot was read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Aim {
    /// Which of its targets, from 0.
    pub target: usize,
    /// From where the distance of the target was read, instead of its place.
    pub from: Option<Fixed>,
}

/// A row: where the joints were, what else is known, what was read there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row<const J: usize> {
    /// Joint readings, mm or rad.
    pub joints: [f64; J],
    /// Joint readings at the other end, where a distance was read instead of the place.
    pub to: Option<[f64; J]>,
    /// Which target, and from where.
    pub aim: Aim,
    /// Time, temperature, directions, velocities.
    pub covariates: Covariates<J>,
    /// Added to the measured point before the sensor sees it, mm: a user's own effect.
    pub push: Vector3<f64>,
}

/// Reading of one row with its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Prediction<const J: usize, const M: usize, const P: usize> {
    /// What the sensor would show.
    pub value: SVector<f64, M>,
    /// By the joint readings.
    pub by_joints: SMatrix<f64, M, J>,
    /// By a displacement of the measured point, mm.
    pub by_body: SMatrix<f64, M, 3>,
    /// By the parameters, one column each.
    pub by_parameters: SMatrix<f64, M, P>,
}

impl<const J: usize, const M: usize, const P: usize> Prediction<J, M, P> {
    /// Room for a prediction.
    #[must_use]
    pub fn new() -> Self {
        Self {
            value: SVector::zeros(),
            by_joints: SMatrix::zeros(),
            by_body: SMatrix::zeros(),
            by_parameters: SMatrix::zeros(),
        }
    }
}

impl<const J: usize, const M: usize, const P: usize> Default for Prediction<J, M, P> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const J: usize> Row<J> {
    /// Whether one distance was read, instead of a place.
    #[inline]
    #[must_use]
    pub fn is_distance(&self) -> bool {
        self.to.is_some() || self.aim.from.is_some()
    }
}

impl<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize> Chain<R, J, M, P> {
    /// Measured point of a row, base frame, mm.
    ///
    /// # Errors
    /// As [`Chain::point`].
    pub fn row_point(&self, row: &Row<J>) -> Result<Vector3<f64>> {
        self.point(&SVector::from(row.joints), &row.covariates, &row.push)
    }

    /// Hands over the points of the mechanism's parts at a row ([`Mechanism::parts`]), then the measured point where the
    /// body link takes it; base frame, mm.
    ///
    /// # Errors
    /// As [`Chain::point`].
    pub fn row_parts(&self, row: &Row<J>, mut put: impl FnMut(Vector3<f64>)) -> Result<()> {
        let readings = SVector::from(row.joints);
        let joints = self
            .joints
            .at::<R>(&readings, &row.covariates, Wanted::default());
        let solved = self.structure.solve_at(&joints.value, &row.covariates)?;
        let (growth, shift) = self.body.at(&row.covariates);
        self.structure.parts(&solved, &mut put);
        put(self.structure.point(&solved) * growth + shift + row.push);
        Ok(())
    }

    /// Predicts a row without derivatives; a distance fills the first component alone.
    ///
    /// # Errors
    /// As [`Chain::value`].
    pub fn row_value(&self, row: &Row<J>) -> Result<SVector<f64, M>> {
        let at = |q: &[f64; J]| {
            let (joints, known) = (SVector::from(*q), &row.covariates);
            let target = row.aim.target;
            match self.gauge(row.aim) {
                None => self.value_by(&self.sensor, &joints, known, &row.push, target),
                Some(gauge) => self.value_by(&gauge, &joints, known, &row.push, target),
            }
        };
        let value = at(&row.joints)?;
        match &row.to {
            None => Ok(value),
            Some(to) => Ok(first((at(to)? - value).norm())),
        }
    }

    /// Predicts a row with the wanted derivatives; a distance fills the first component alone, and columns that were
    /// not wanted are zero.
    ///
    /// # Errors
    /// As [`Chain::predict`].
    #[inline]
    pub fn row_predict_into(
        &self,
        row: &Row<J>,
        wanted: Wanted,
        out: &mut Prediction<J, M, P>,
    ) -> Result<()> {
        if !row.is_distance() {
            return self.predict_aimed(&row.joints, row, wanted, out);
        }
        *out = self.row_predict(row, wanted)?;
        Ok(())
    }

    /// What is read with the joints of a row, or with others.
    fn predict_aimed(
        &self,
        joints: &[f64; J],
        row: &Row<J>,
        wanted: Wanted,
        out: &mut Prediction<J, M, P>,
    ) -> Result<()> {
        let (joints, known) = (SVector::from(*joints), &row.covariates);
        let target = row.aim.target;
        match self.gauge(row.aim) {
            None => {
                // no distance: what an earlier row left in the columns of what stands fixed is cleared
                gauges::clear::<R, M, P>(wanted, &mut out.by_parameters);
                self.predict_by(&self.sensor, &joints, known, &row.push, target, wanted, out)
            }
            Some(gauge) => self.predict_by(&gauge, &joints, known, &row.push, target, wanted, out),
        }
    }

    /// What reads the distance that a row holds; None where it holds a place.
    #[inline]
    fn gauge(&self, aim: Aim) -> Option<Gauge> {
        aim.from.and_then(|from| self.around.gauge(from))
    }

    /// [`Self::row_predict_into`] as a value of its own.
    ///
    /// # Errors
    /// As [`Chain::predict`].
    pub fn row_predict(&self, row: &Row<J>, wanted: Wanted) -> Result<Prediction<J, M, P>> {
        let at = |q: &[f64; J]| {
            let mut out = Prediction::new();
            self.predict_aimed(q, row, wanted, &mut out)?;
            Ok(out)
        };
        let Some(to) = &row.to else {
            return at(&row.joints);
        };
        let (a, b) = (at(&row.joints)?, at(to)?);
        let between = b.value - a.value;
        let distance = between.norm();
        // two equal places have no direction; their distance is stationary at zero
        let along = if distance > 0.0 {
            between / distance
        } else {
            SVector::zeros()
        };
        Ok(Prediction {
            value: first(distance),
            by_joints: first_row(&along, &(b.by_joints - a.by_joints)),
            by_body: first_row(&along, &(b.by_body - a.by_body)),
            by_parameters: first_row(&along, &(b.by_parameters - a.by_parameters)),
        })
    }
}

pub(super) fn first<const M: usize>(distance: f64) -> SVector<f64, M> {
    SVector::from_fn(|axis, _| if axis == 0 { distance } else { 0.0 })
}

/// Derivatives along a direction, in the first row.
fn first_row<const M: usize, const N: usize>(
    along: &SVector<f64, M>,
    of: &SMatrix<f64, M, N>,
) -> SMatrix<f64, M, N> {
    let mut out = SMatrix::<f64, M, N>::zeros();
    out.set_row(0, &along.tr_mul(of));
    out
}
