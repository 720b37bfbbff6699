//! A nominal robot, and the chain that it becomes with given errors.

use super::body::Body;
use super::columns::{Carried, Columns};
use super::effects::Wanted;
use super::gauges::Around;
use super::joints::{Joints, Turned};
use super::mechanism::Mechanism;
use super::row::{Covariates, Prediction};
use super::sensor::{Look, Sensor};
use super::table::{Settings, Table};
use crate::numbers::math::{Real, Triple, add};
use crate::{Error, Result};
use nalgebra::{SVector, Vector3};

/// Distances that a robot's rows can hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Distances {
    /// None.
    None,
    /// Between two of its places: readings are coordinates in one frame.
    BetweenPlaces,
    /// Between a target and a fixed centre or plane.
    FromFixed,
}

/// A nominal robot and the settings of its effects: what the drawing and the user say.
pub trait Robot<const J: usize, const M: usize, const P: usize>: Table {
    /// What joins its joints to the measured point.
    type Structure: Mechanism<J, P>;
    /// What it is measured with.
    type Sensor: Sensor<M>;
    /// What stands fixed around it, from which distances are read.
    type Around: Around;

    /// Which distances can be read of it.
    const DISTANCES: Distances = Distances::None;

    /// How many of its joints it has; the others stand still and are not read.
    #[inline]
    fn joints(&self) -> usize {
        J
    }

    /// Settings of the effects that are no parameters.
    fn settings(&self) -> Settings<J>;

    /// Refuses settings that mean nothing.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::InvalidGeometry`].
    fn check(&self) -> Result<()>;

    /// The mechanism with its errors.
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`] where the errors leave no robot.
    fn structure(&self, values: &[f64; P]) -> Result<Self::Structure>;

    /// The instrument with its errors.
    ///
    /// # Errors
    /// [`Error::InvalidCamera`] where the errors leave no camera.
    fn sensor(&self, values: &[f64; P]) -> Result<Self::Sensor>;

    /// What stands fixed around it, with its errors.
    fn around(&self, values: &[f64; P]) -> Self::Around;

    /// The robot with the given values of all its parameters.
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`] and [`Error::InvalidCamera`] where the errors leave no robot or camera,
    /// [`Error::NotFinite`] for a value that is none.
    fn with(&self, values: &[f64; P]) -> Result<Chain<Self, J, M, P>> {
        if let Some(index) = values.iter().position(|v| !v.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        self.check()?;
        let settings = self.settings();
        Ok(Chain {
            joints: Joints::new::<Self, P>(values, &settings),
            structure: self.structure(values)?,
            body: Body::new::<Self, J, P>(values, &settings),
            sensor: self.sensor(values)?,
            around: self.around(values),
        })
    }
}

/// A robot with given errors and effects, ready to predict.
#[derive(Clone, Copy, Debug)]
pub struct Chain<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize> {
    pub(crate) joints: Joints<J>,
    pub(crate) structure: R::Structure,
    pub(crate) body: Body,
    pub(crate) sensor: R::Sensor,
    pub(crate) around: R::Around,
}

/// What an iteration on the joints remembers of the last ones: the pose, and room for what is predicted.
pub(crate) struct Trail<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize> {
    solved: Option<<R::Structure as Mechanism<J, P>>::Solved>,
    pub(crate) prediction: Prediction<J, M, P>,
}

impl<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize> Trail<R, J, M, P> {
    /// Nothing yet.
    pub(crate) fn new() -> Self {
        Self {
            solved: None,
            prediction: Prediction::new(),
        }
    }
}

impl<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize> Chain<R, J, M, P> {
    /// What joins the joints to the measured point.
    #[must_use]
    pub fn structure(&self) -> &R::Structure {
        &self.structure
    }

    /// The measured point, base frame, mm. `push` is added to it (a user's effect).
    ///
    /// # Errors
    /// As [`Mechanism::solve`].
    pub fn point(
        &self,
        readings: &SVector<f64, J>,
        row: &Covariates<J>,
        push: &Vector3<f64>,
    ) -> Result<Vector3<f64>> {
        let joints = self.joints.at::<R>(readings, row, Wanted::default());
        let (growth, shift) = self.body.at(row);
        Ok(self.structure.target_at(&joints.value, row, 0)? * growth + shift + push)
    }

    #[inline]
    pub(crate) fn look(&self, joints: &SVector<f64, J>, row: &Covariates<J>) -> Look {
        Look {
            azimuth: self.structure.azimuth(joints),
            time_s: row.time_s,
        }
    }

    /// Reading of one row. `push` is added to the measured point before the sensor sees it (a user's effect).
    ///
    /// # Errors
    /// As [`Mechanism::solve`] and [`Sensor::value`]; [`Error::NotFinite`] where an active effect lacks its covariate.
    pub fn value(
        &self,
        readings: &SVector<f64, J>,
        row: &Covariates<J>,
        push: &Vector3<f64>,
    ) -> Result<SVector<f64, M>> {
        self.value_by(&self.sensor, readings, row, push, 0)
    }

    /// What an instrument reads of a target.
    #[inline]
    pub(super) fn value_by(
        &self,
        sensor: &impl Sensor<M>,
        readings: &SVector<f64, J>,
        row: &Covariates<J>,
        push: &Vector3<f64>,
        target: usize,
    ) -> Result<SVector<f64, M>> {
        let joints = self.joints.at::<R>(readings, row, Wanted::default());
        let (growth, shift) = self.body.at(row);
        let place = self.structure.target_at(&joints.value, row, target)?;
        let point = place * growth + shift + push + self.body.apart(row);
        checked(sensor.value(&point, self.look(&joints.value, row))?)
    }

    /// Reading of one row with the wanted derivatives. A column whose covariate is missing is NaN.
    ///
    /// # Errors
    /// As [`Self::value`].
    #[inline]
    pub fn predict(
        &self,
        readings: &SVector<f64, J>,
        row: &Covariates<J>,
        push: &Vector3<f64>,
        wanted: Wanted,
    ) -> Result<Prediction<J, M, P>> {
        let mut out = Prediction::new();
        self.predict_into(readings, row, push, wanted, &mut out)?;
        Ok(out)
    }

    /// [`Self::predict`] into a prediction that is used again: only wanted columns are written.
    ///
    /// # Errors
    /// As [`Self::value`].
    #[inline]
    pub fn predict_into(
        &self,
        readings: &SVector<f64, J>,
        row: &Covariates<J>,
        push: &Vector3<f64>,
        wanted: Wanted,
        out: &mut Prediction<J, M, P>,
    ) -> Result<()> {
        self.predict_by(&self.sensor, readings, row, push, 0, wanted, out)
    }

    /// [`Self::predict_into`] of what an instrument reads of a target.
    #[inline]
    #[allow(
        clippy::too_many_arguments,
        reason = "one argument for each thing that a reading depends on"
    )]
    pub(crate) fn predict_by(
        &self,
        sensor: &impl Sensor<M>,
        readings: &SVector<f64, J>,
        row: &Covariates<J>,
        push: &Vector3<f64>,
        target: usize,
        wanted: Wanted,
        out: &mut Prediction<J, M, P>,
    ) -> Result<()> {
        let joints = self.joints.at::<R>(readings, row, wanted);
        let solved = self.structure.solve_at(&joints.value, row)?;
        let solved = self.structure.aimed(solved, target);
        self.shown(sensor, &joints, &solved, row, push, wanted, out)
    }

    /// What an instrument reads in one row with its derivative by the joints, from the pose that `trail` remembers, and whether the pose is
    /// solved to the end ([`Mechanism::solve_near`]).
    ///
    /// # Errors
    /// As [`Self::value`].
    #[inline]
    pub(crate) fn predict_near(
        &self,
        sensor: &impl Sensor<M>,
        readings: &SVector<f64, J>,
        row: &Covariates<J>,
        trail: &mut Trail<R, J, M, P>,
    ) -> Result<bool> {
        let (wanted, still) = (Wanted::default(), Vector3::zeros());
        let joints = self.joints.at::<R>(readings, row, wanted);
        let settled = self
            .structure
            .solve_near(&joints.value, row, &mut trail.solved)?;
        let solved = trail.solved.as_ref().ok_or(Error::Singular)?;
        let out = &mut trail.prediction;
        self.shown(sensor, &joints, solved, row, &still, wanted, out)?;
        Ok(settled)
    }

    /// What is shown of a solved pose, with the wanted derivatives.
    #[inline]
    #[allow(
        clippy::too_many_arguments,
        reason = "one argument for each thing that a reading depends on"
    )]
    fn shown(
        &self,
        sensor: &impl Sensor<M>,
        joints: &Turned<J>,
        solved: &<R::Structure as Mechanism<J, P>>::Solved,
        row: &Covariates<J>,
        push: &Vector3<f64>,
        wanted: Wanted,
        out: &mut Prediction<J, M, P>,
    ) -> Result<()> {
        let (growth, shift) = self.body.at(row);
        let point = self.structure.point(solved);
        let body = point * growth + shift + push + self.body.apart(row);
        let look = self.look(&joints.value, row);
        let d = &mut out.by_parameters;
        let (value, by_body) = sensor.predict::<R, P>(&body, look, wanted, d)?;
        self.body
            .columns::<R, J, M, P>(&point, row, &by_body, wanted, d);
        let by_point = by_body * growth;
        let by_joints = self
            .structure
            .columns(&joints.value, solved, &by_point, wanted, d);
        joints.columns::<R, M, P>(&by_joints, wanted, d);
        out.value = checked(value)?;
        out.by_joints = joints.by_readings(by_joints);
        out.by_body = by_body;
        Ok(())
    }
}

impl<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize> Chain<R, J, M, P> {
    /// [`Self::predict`] for rows side by side, `push` as there: readings, and one for the rows that have them, else zero;
    /// hands over the wanted columns. None where the effects that act or are wanted are computed one row at a time.
    #[inline(always)]
    pub fn predict_many<T: Real>(
        &self,
        readings: [T; J],
        push: Triple<T>,
        wanted: Wanted,
        to: &mut impl Columns<T, M>,
    ) -> Option<([T; M], T)> {
        if !self.joints.are_exact::<R>(wanted) || !self.body.is_still::<R>(wanted) {
            return None;
        }
        let (point, mut reached, solved) = self.structure.solve_many(readings, wanted)?;
        let seen = add(point, push);
        let (value, by_point) = self.sensor.predict_many::<R, T>(seen, wanted, to)?;
        for shown in value {
            reached = T::splat(f64::MAX).at_least(shown.size(), reached, T::splat(0.0));
        }
        let mut carried = Carried { by_point, to };
        self.structure
            .columns_many(readings, &solved, wanted, &mut carried);
        Some((value, reached))
    }
}

/// A reading, where it is one.
pub(super) fn checked<const M: usize>(value: SVector<f64, M>) -> Result<SVector<f64, M>> {
    value
        .iter()
        .position(|v| !v.is_finite())
        .map_or(Ok(value), |index| Err(Error::NotFinite { index }))
}
