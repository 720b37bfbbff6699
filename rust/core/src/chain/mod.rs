//! The measurement chain, once for every robot: joint readings → joints → structure → body → sensor → reading.
//!
//! A link maps a value to a value and knows two derivatives: by its input, and by its own parameters. The derivative of a
//! reading by a parameter is that of its own link, carried on by the derivatives of the links behind it. What differs
//! from robot to robot is the link `structure`, a [`Mechanism`]; [`joints`](Joints), [`body`](Body) and the sensors
//! ([`Cartesian`], [`Tracker`], [`Eye`], [`Angles`]) are the same for all. Which of their effects a robot has, its table says
//! ([`effects`]): the place of each parameter is a constant of the type, so that what a robot has not costs nothing.
//!
//! A covariate that a row lacks is NaN; an effect that needs it must then be at zero, where it is not asked.
//!
//! The numbers `J` of joints, `M` of readings and `P` of parameters are parameters of every type, because stable Rust has
//! no other way to say that the sizes of arrays belong to a robot.

mod angles;
mod bar;
pub(crate) mod body;
mod camera;
mod cartesian;
pub mod effects;
mod gauges;
mod inverse;
mod joints;
pub mod places;
#[cfg(test)]
mod planar;
mod plane;
mod row;
mod tracker;

use crate::numbers::math::{Real, Triple, add, dot};
use crate::{Error, Result};
use core::fmt::Debug;
use effects::{Effect, Wanted};
use nalgebra::{SMatrix, SVector, Vector3};
use places::Places;

pub use angles::Angles;
pub(crate) use angles::{angles_by_axis, angles_of};
pub use bar::CENTRES;
pub use body::{Body, REFERENCE_TEMPERATURE_C};
pub use camera::Eye;
pub use cartesian::{Cartesian, LINEARITY_SPAN_MM};
pub use gauges::{Around, Fixed, Gauge, Gauges};
pub(crate) use inverse::inverse;
pub use joints::{Joints, Turned};
pub use plane::{Flat, PLANES};
pub use row::{Aim, Covariates, Prediction, Row};
pub use tracker::Tracker;

/// Where a robot's parameters stand.
pub trait Table: Copy + Debug {
    /// Places of the effects that only this mechanism has.
    type Own: Copy;
    /// Its parameters, effect by effect.
    const CATALOGUE: &'static [Effect];
    /// Places of all effects that it has.
    const AT: Places<Self::Own>;
}

/// Takes the columns of rows side by side: how `M` coordinates move with each parameter. A trait, since a closure is not
/// always inlined.
pub trait Columns<T, const M: usize> {
    /// Takes that of a parameter.
    fn put(&mut self, parameter: usize, column: [T; M]);
}

/// Columns of a point, carried on to the readings.
struct Carried<'a, T, C, const M: usize> {
    by_point: [Triple<T>; M],
    to: &'a mut C,
}

impl<T: Real, C: Columns<T, M>, const M: usize> Columns<T, 3> for Carried<'_, T, C, M> {
    #[inline(always)]
    fn put(&mut self, parameter: usize, column: Triple<T>) {
        let mut shown = [T::splat(0.0); M];
        for axis in 0..M {
            shown[axis] = dot(self.by_point[axis], column);
        }
        self.to.put(parameter, shown);
    }
}

/// The link `structure`: from joints to the measured point, with what only this mechanism has.
pub trait Mechanism<const J: usize, const P: usize>: Copy + Debug {
    /// A solved pose, from which every derivative follows.
    type Solved;
    /// Solved poses side by side.
    type Many<T: Real>;

    /// Solves the pose.
    ///
    /// # Errors
    /// Says why the joints make no pose, or one without derivatives.
    fn solve(&self, joints: &SVector<f64, J>) -> Result<Self::Solved>;

    /// Puts the pose of these joints, as by [`Self::solve_at`], in the place of one nearby, if any: as far as one step goes. Whether that is all the
    /// way is returned. Who iterates on the joints besides need not solve each pose to the end.
    ///
    /// # Errors
    /// As [`Self::solve`].
    #[inline]
    fn solve_near(
        &self,
        joints: &SVector<f64, J>,
        row: &Covariates<J>,
        near: &mut Option<Self::Solved>,
    ) -> Result<bool> {
        *near = Some(self.solve_at(joints, row)?);
        Ok(true)
    }

    /// Measured point of a solved pose, base frame, mm.
    fn point(&self, solved: &Self::Solved) -> Vector3<f64>;

    /// [`Self::solve`] of a mechanism that its load or its warmth changes.
    ///
    /// # Errors
    /// As [`Self::solve`].
    #[inline]
    fn solve_at(&self, joints: &SVector<f64, J>, row: &Covariates<J>) -> Result<Self::Solved> {
        let _ = row;
        self.solve(joints)
    }

    /// The same pose with another of the targets that a robot may carry as the measured point.
    #[inline]
    fn aimed(&self, solved: Self::Solved, target: usize) -> Self::Solved {
        let _ = target;
        solved
    }

    /// The measured point without what its derivatives need; the same bits as by [`Self::solve`].
    ///
    /// # Errors
    /// As [`Self::solve`].
    #[inline]
    fn point_at(&self, joints: &SVector<f64, J>) -> Result<Vector3<f64>> {
        Ok(self.point(&self.solve(joints)?))
    }

    /// [`Self::point_at`] of a target, by [`Self::solve_at`].
    ///
    /// # Errors
    /// As [`Self::solve`].
    #[inline]
    fn target_at(
        &self,
        joints: &SVector<f64, J>,
        row: &Covariates<J>,
        target: usize,
    ) -> Result<Vector3<f64>> {
        let _ = (row, target);
        self.point_at(joints)
    }

    /// Hands over the points of its parts at a solved pose, base frame, mm, in an order of its own: what a drawing joins by
    /// lines. As many at every pose; the measured point is the last.
    fn parts(&self, solved: &Self::Solved, put: &mut impl FnMut(Vector3<f64>)) {
        put(self.point(solved));
    }

    /// Writes its wanted columns, carried on by the derivative of the readings by the point; returns that by the joints.
    fn columns<const M: usize>(
        &self,
        joints: &SVector<f64, J>,
        solved: &Self::Solved,
        by_point: &SMatrix<f64, M, 3>,
        wanted: Wanted,
        d: &mut SMatrix<f64, M, P>,
    ) -> SMatrix<f64, M, J>;

    /// [`Self::solve`] for poses side by side: measured points, one for those that have one and derivatives, else zero.
    /// None where the effects that act or are wanted must be computed one pose at a time.
    #[inline(always)]
    fn solve_many<T: Real>(
        &self,
        joints: [T; J],
        wanted: Wanted,
    ) -> Option<(Triple<T>, T, Self::Many<T>)> {
        let _ = (joints, wanted);
        None
    }

    /// Hands over its wanted columns, by which the measured points move.
    #[inline(always)]
    fn columns_many<T: Real>(
        &self,
        joints: [T; J],
        solved: &Self::Many<T>,
        wanted: Wanted,
        to: &mut impl Columns<T, 3>,
    ) {
        let _ = (joints, solved, wanted, to);
    }

    /// Azimuth about which angles of the measured point are counted, rad.
    #[inline]
    fn azimuth(&self, joints: &SVector<f64, J>) -> f64 {
        let _ = joints;
        0.0
    }
}

/// What an instrument's reading depends on besides the point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Azimuth about which angles are counted, rad.
    pub azimuth: f64,
    /// Time of the reading, s; NaN where it is not known.
    pub time_s: f64,
}

/// The link `sensor`: what an instrument shows of a point.
pub trait Sensor<const M: usize>: Copy + Debug {
    /// Reading of a point.
    ///
    /// # Errors
    /// Says why the instrument shows nothing.
    fn value(&self, point: &Vector3<f64>, look: Look) -> Result<SVector<f64, M>>;

    /// [`Self::value`] with the derivative by the point; writes its wanted columns.
    ///
    /// # Errors
    /// As [`Self::value`].
    fn predict<T: Table, const P: usize>(
        &self,
        point: &Vector3<f64>,
        look: Look,
        wanted: Wanted,
        d: &mut SMatrix<f64, M, P>,
    ) -> Result<(SVector<f64, M>, SMatrix<f64, M, 3>)>;

    /// Readings of points side by side with the derivative by the point, row by row; hands over its wanted columns. None
    /// where points are looked at one at a time.
    #[inline(always)]
    fn predict_many<T: Table, N: Real>(
        &self,
        points: Triple<N>,
        wanted: Wanted,
        to: &mut impl Columns<N, M>,
    ) -> Option<([N; M], [Triple<N>; M])> {
        let _ = (points, wanted, to);
        None
    }
}

/// What of a robot's effects is no parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings<const J: usize> {
    /// Joint readings of the home position, about which scale errors turn, mm or rad.
    pub home: [f64; J],
    /// Phase of the encoders' cyclic error by the reading, rad/mm or rad/rad.
    pub wave: f64,
    /// Time from which drift counts, s.
    pub time_origin_s: f64,
    /// Moment of the slip, s.
    pub slip_time_s: f64,
    /// Moment at which joints slip, s.
    pub joint_slip_time_s: f64,
}

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
    pub(super) fn predict_by(
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

    /// Reading of one row with its derivative by the joints, from the pose that `trail` remembers, and whether the pose is
    /// solved to the end ([`Mechanism::solve_near`]).
    ///
    /// # Errors
    /// As [`Self::value`].
    #[inline]
    pub(crate) fn predict_near(
        &self,
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
        self.shown(&self.sensor, &joints, solved, row, &still, wanted, out)?;
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

fn checked<const M: usize>(value: SVector<f64, M>) -> Result<SVector<f64, M>> {
    value
        .iter()
        .position(|v| !v.is_finite())
        .map_or(Ok(value), |index| Err(Error::NotFinite { index }))
}
