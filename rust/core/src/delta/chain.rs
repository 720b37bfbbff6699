//! The whole measurement chain of the delta, with every effect of the catalogue and exact derivatives.
//!
//! joint readings → joints → structure → body → sensor → reading. Each link maps a value to a value; the
//! derivative by a parameter is that of its own link, carried on by the derivatives of the links behind it. With
//! all effects at zero the chain is the paper's model plus a datum.
//!
//! A covariate that a row lacks is NaN; an effect that needs it must then be at zero, where it is not asked.

use super::geometry::{Geometry, IDENTIFIABLE, LIMBS, PER_LIMB};
use super::kinematics::Kinematics;
use super::parameters::{
    BACKLASH, BEAM_ALIGNMENT, DATUM, DRIFT, ENCODER_CYCLIC, GEOMETRY, GRAVITY_SAG, JOINT_SCALE,
    PARAMETERS, RAIL_LEAN, ROD_MISMATCH, SENSOR_LINEARITY, SLIP, THERMAL_GROWTH, Values, of,
};
use super::structure::{Extras, Structure};
use crate::math::sin_cos;
use crate::{Error, Result};
use core::f64::consts::TAU;
use nalgebra::{Matrix3, SMatrix, Vector3};

/// The cubic error of a sensor is named by its size this far from the middle, mm.
pub const LINEARITY_SPAN_MM: f64 = 20.0;
/// Temperature at which the robot is as drawn, °C.
pub const REFERENCE_TEMPERATURE_C: f64 = 20.0;
const SECONDS_PER_HOUR: f64 = 3600.0;

/// Nominal robot and the settings of its effects: what the drawing and the user say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Nominal geometry.
    pub geometry: Geometry,
    /// From the platform centre to the measured point, mm.
    pub target_offset: Vector3<f64>,
    /// Distance between the two rods of a limb, mm; zero where the platform cannot tilt.
    pub rod_spacing: f64,
    /// Period of the encoders' cyclic error, mm.
    pub pole_pitch: f64,
    /// Joint readings of the home position, mm, about which scale errors and leans turn.
    pub home: [f64; LIMBS],
    /// Time from which drift counts, s.
    pub time_origin_s: f64,
    /// Moment of the slip, s.
    pub slip_time_s: f64,
}

/// What a row brings besides its readings. NaN where it is not known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariates {
    /// Time of the reading, s.
    pub time_s: f64,
    /// Temperature, °C.
    pub temperature_c: f64,
    /// Direction of the last motion of each joint, ±1 or 0.
    pub direction: [f64; LIMBS],
}

impl Covariates {
    /// Nothing known.
    pub const NONE: Self = Self {
        time_s: f64::NAN,
        temperature_c: f64::NAN,
        direction: [f64::NAN; LIMBS],
    };
}

/// Which derivatives are wanted: a bit for each group of parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wanted(u16);

impl Wanted {
    const BASE: u16 = 1;
    const PLATFORM: u16 = 128;
    const LEAN: u16 = 2;
    const MISMATCH: u16 = 4;
    const SAG: u16 = 8;
    const JOINTS: u16 = 16;
    const BODY: u16 = 32;
    const SENSOR: u16 = 64;
    /// Every derivative.
    pub const ALL: Self = Self(u16::MAX);

    /// The groups that hold the given parameters.
    #[must_use]
    pub fn of(parameters: &[usize]) -> Self {
        parameters.iter().fold(Self::default(), |wanted, p| {
            let group = match p {
                p if GEOMETRY.contains(p) && p % PER_LIMB < IDENTIFIABLE => Self::BASE,
                p if GEOMETRY.contains(p) => Self::PLATFORM,
                p if RAIL_LEAN.contains(p) => Self::LEAN,
                p if ROD_MISMATCH.contains(p) => Self::MISMATCH,
                p if GRAVITY_SAG.contains(p) => Self::SAG,
                p if (JOINT_SCALE.start..BACKLASH.end).contains(p) => Self::JOINTS,
                p if (THERMAL_GROWTH.start..SLIP.end).contains(p) => Self::BODY,
                _ => Self::SENSOR,
            };
            Self(wanted.0 | group)
        })
    }

    #[inline(always)]
    fn has(self, group: u16) -> bool {
        self.0 & group != 0
    }
}

/// Position of one row with its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Prediction {
    /// What the sensors would show, mm.
    pub value: Vector3<f64>,
    /// By the joint readings.
    pub by_joints: Matrix3<f64>,
    /// By a displacement of the measured point.
    pub by_body: Matrix3<f64>,
    /// By the parameters, one column each.
    pub by_parameters: SMatrix<f64, 3, PARAMETERS>,
}

impl Prediction {
    /// Room for a prediction.
    #[must_use]
    pub fn new() -> Self {
        Self {
            value: Vector3::zeros(),
            by_joints: Matrix3::zeros(),
            by_body: Matrix3::zeros(),
            by_parameters: SMatrix::zeros(),
        }
    }
}

impl Default for Prediction {
    fn default() -> Self {
        Self::new()
    }
}

/// A robot with given errors and effects, ready to predict.
#[derive(Clone, Copy, Debug)]
pub struct Chain {
    kinematics: Kinematics,
    extras: Extras,
    joint_scale: [f64; LIMBS],
    cyclic: [f64; 2 * LIMBS],
    backlash: [f64; LIMBS],
    thermal: f64,
    drift: Vector3<f64>,
    slip: Vector3<f64>,
    beams: Matrix3<f64>,
    linearity: [f64; 3],
    datum: Vector3<f64>,
    wave: f64,
    home: [f64; LIMBS],
    time_origin_s: f64,
    slip_time_s: f64,
    /// No effect acts at the joints.
    exact_joints: bool,
}

/// Joint readings turned into joints, with derivatives by reading and by the link's own parameters.
struct Joints {
    value: Vector3<f64>,
    by_reading: [f64; LIMBS],
    /// Per joint: by scale, by sine, by cosine, by backlash.
    by_own: [[f64; 4]; LIMBS],
}

impl Model {
    /// The robot with the given parameter values.
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`] where the errors leave no robot, [`Error::NotFinite`] for a value that is none.
    pub fn with(&self, values: &Values) -> Result<Chain> {
        if let Some(index) = values.iter().position(|v| !v.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        let settings = [
            self.rod_spacing,
            self.pole_pitch,
            self.time_origin_s,
            self.slip_time_s,
        ];
        let settings = settings.iter().chain(&self.home).chain(&self.target_offset);
        if let Some(index) = settings.clone().position(|v| !v.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        if self.pole_pitch <= 0.0 {
            let what = "the period of the encoders must be positive";
            return Err(Error::InvalidGeometry { limb: 0, what });
        }
        let mut geometry = self.geometry.parameters();
        for (g, e) in geometry.iter_mut().zip(values) {
            *g += e;
        }
        let geometry = Geometry::from_parameters(&geometry, self.geometry.assembly);
        let lean = of::<6>(values, RAIL_LEAN);
        let lean = [[lean[0], lean[1]], [lean[2], lean[3]], [lean[4], lean[5]]];
        let half = 0.5 * self.rod_spacing;
        let pair = |limb: usize| {
            // the joint axes of a limb are alike at carriage and platform, or equal rods would tilt it too
            let (sin, cos) = sin_cos(self.geometry.limbs[limb].platform_angle_rad);
            Vector3::new(-sin * half, cos * half, 0.0)
        };
        let b = of::<9>(values, BEAM_ALIGNMENT);
        Ok(Chain {
            kinematics: Kinematics::leaning(&geometry, lean, self.home)?,
            extras: Extras {
                target: self.target_offset,
                half_pair: [pair(0), pair(1), pair(2)],
                mismatch: of(values, ROD_MISMATCH),
                compliance: of(values, GRAVITY_SAG),
            },
            joint_scale: of(values, JOINT_SCALE),
            cyclic: of(values, ENCODER_CYCLIC),
            backlash: of(values, BACKLASH),
            thermal: of::<1>(values, THERMAL_GROWTH)[0],
            drift: Vector3::from(of::<3>(values, DRIFT)),
            slip: Vector3::from(of::<3>(values, SLIP)),
            beams: Matrix3::from_row_slice(&b),
            linearity: of(values, SENSOR_LINEARITY),
            datum: Vector3::from(of::<3>(values, DATUM)),
            wave: TAU / self.pole_pitch,
            home: self.home,
            time_origin_s: self.time_origin_s,
            slip_time_s: self.slip_time_s,
            exact_joints: values[JOINT_SCALE.start..BACKLASH.end]
                .iter()
                .all(|v| *v == 0.0),
        })
    }
}

impl Chain {
    /// Joints as they really are.
    #[inline]
    fn joints(&self, readings: &Vector3<f64>, row: &Covariates, wanted: Wanted) -> Joints {
        let mut out = Joints {
            value: *readings,
            by_reading: [1.0; LIMBS],
            by_own: [[0.0; 4]; LIMBS],
        };
        if self.exact_joints && !wanted.has(Wanted::JOINTS) {
            return out;
        }
        for i in 0..LIMBS {
            let q = readings[i];
            let from_home = q - self.home[i];
            let half_way = 0.5 * row.direction[i];
            let (sin, cos) = sin_cos(self.wave * q);
            let [a, b] = [self.cyclic[2 * i], self.cyclic[2 * i + 1]];
            out.value[i] += self.joint_scale[i] * from_home + a * sin + b * cos;
            if self.backlash[i] != 0.0 {
                out.value[i] += self.backlash[i] * half_way;
            }
            out.by_reading[i] += self.joint_scale[i] + self.wave * (a * cos - b * sin);
            out.by_own[i] = [from_home, sin, cos, half_way];
        }
        out
    }

    /// What time, temperature and slip add to a point, and the factor they scale it by.
    #[inline]
    fn body(&self, row: &Covariates) -> (f64, Vector3<f64>) {
        let mut growth = 1.0;
        let mut shift = Vector3::zeros();
        if self.thermal != 0.0 {
            growth += self.thermal * (row.temperature_c - REFERENCE_TEMPERATURE_C);
        }
        if self.drift != Vector3::zeros() {
            shift += self.drift * self.hours(row);
        }
        if self.slip != Vector3::zeros() {
            shift += self.slip * self.slipped(row);
        }
        (growth, shift)
    }

    fn hours(&self, row: &Covariates) -> f64 {
        (row.time_s - self.time_origin_s) / SECONDS_PER_HOUR
    }

    fn slipped(&self, row: &Covariates) -> f64 {
        if row.time_s.is_nan() {
            f64::NAN
        } else {
            f64::from(u8::from(row.time_s >= self.slip_time_s))
        }
    }

    /// What the sensors show of a point, and the derivative by it.
    #[inline]
    fn sensor(&self, point: &Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>, Vector3<f64>) {
        let seen = point + self.beams * point;
        let mut cubes = Vector3::zeros();
        let mut by_seen = Vector3::from_element(1.0);
        for k in 0..3 {
            let t = seen[k] / LINEARITY_SPAN_MM;
            cubes[k] = t * t * t;
            by_seen[k] += 3.0 * self.linearity[k] * t * t / LINEARITY_SPAN_MM;
        }
        let shown = seen + Vector3::from(self.linearity).component_mul(&cubes) + self.datum;
        let mut by_point = self.beams;
        for k in 0..3 {
            by_point[(k, k)] += 1.0;
            by_point.row_mut(k).scale_mut(by_seen[k]);
        }
        (shown, by_point, cubes)
    }

    /// Reading of one row. `push` is added to the measured point before the sensors see it (a user's effect).
    ///
    /// # Errors
    /// As [`Kinematics::forward`], [`Error::Singular`], and [`Error::NotFinite`] where an active effect lacks its
    /// covariate.
    pub fn value(
        &self,
        joints: &Vector3<f64>,
        row: &Covariates,
        push: &Vector3<f64>,
    ) -> Result<Vector3<f64>> {
        let joints = self.joints(joints, row, Wanted::default());
        let point = if self.extras.is_plain() {
            self.kinematics.forward(&joints.value)? + self.extras.target
        } else {
            Structure::solve(&self.kinematics, &self.extras, &joints.value)?.point
        };
        let (growth, shift) = self.body(row);
        let (value, _, _) = self.sensor(&(point * growth + shift + push));
        checked(value)
    }

    /// Reading of one row with the wanted derivatives. A column whose covariate is missing is NaN.
    ///
    /// # Errors
    /// As [`Self::value`].
    #[inline]
    pub fn predict(
        &self,
        readings: &Vector3<f64>,
        row: &Covariates,
        push: &Vector3<f64>,
        wanted: Wanted,
    ) -> Result<Prediction> {
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
        readings: &Vector3<f64>,
        row: &Covariates,
        push: &Vector3<f64>,
        wanted: Wanted,
        out: &mut Prediction,
    ) -> Result<()> {
        let joints = self.joints(readings, row, wanted);
        let structure = Structure::solve(&self.kinematics, &self.extras, &joints.value)?;
        let (growth, shift) = self.body(row);
        let body = structure.point * growth + shift + push;
        let (value, by_body, cubes) = self.sensor(&body);
        let by_structure = by_body * growth;
        let d = &mut out.by_parameters;
        let by_joints = self.by_structure(d, &joints, &structure, &by_structure, wanted);
        if wanted.has(Wanted::BODY) {
            let warmer = row.temperature_c - REFERENCE_TEMPERATURE_C;
            d.set_column(THERMAL_GROWTH.start, &(by_body * structure.point * warmer));
            for axis in 0..3 {
                let along: Vector3<f64> = by_body.column(axis).into_owned();
                d.set_column(DRIFT.start + axis, &(along * self.hours(row)));
                d.set_column(SLIP.start + axis, &(along * self.slipped(row)));
            }
        }
        if wanted.has(Wanted::SENSOR) {
            // a sensor's parameters touch its own axis alone: clear what an earlier row left on the others
            for range in [DATUM, BEAM_ALIGNMENT, SENSOR_LINEARITY] {
                d.columns_range_mut(range).fill(0.0);
            }
            let seen = body + self.beams * body;
            for axis in 0..3 {
                let t = seen[axis] / LINEARITY_SPAN_MM;
                let steep = 1.0 + 3.0 * self.linearity[axis] * t * t / LINEARITY_SPAN_MM;
                d[(axis, DATUM.start + axis)] = 1.0;
                d[(axis, SENSOR_LINEARITY.start + axis)] = cubes[axis];
                for from in 0..3 {
                    d[(axis, BEAM_ALIGNMENT.start + 3 * axis + from)] = steep * body[from];
                }
            }
        }
        out.value = checked(value)?;
        out.by_joints = by_joints;
        out.by_body = by_body;
        Ok(())
    }

    /// Writes the columns of joints and structure, carried on by `by_structure`; returns the derivative by the
    /// joint readings.
    #[inline]
    fn by_structure(
        &self,
        d: &mut SMatrix<f64, 3, PARAMETERS>,
        joints: &Joints,
        structure: &Structure,
        by_structure: &Matrix3<f64>,
        wanted: Wanted,
    ) -> Matrix3<f64> {
        let mut by_joints = Matrix3::zeros();
        if wanted.has(Wanted::MISMATCH) {
            let columns = by_structure * structure.by_rod_mismatch(&self.kinematics, &self.extras);
            d.fixed_columns_mut::<LIMBS>(ROD_MISMATCH.start)
                .copy_from(&columns);
        }
        for limb in 0..LIMBS {
            let joint = joints.value[limb];
            let by = self.kinematics.by_limb(limb, joint);
            let by_joint = by_structure * structure.by_carriage(limb, &by.joint);
            by_joints.set_column(limb, &(by_joint * joints.by_reading[limb]));
            let first = limb * PER_LIMB;
            if wanted.has(Wanted::BASE) {
                let radius = structure.by_carriage(limb, &by.base_radius);
                let angle = structure.by_carriage(limb, &by.base_angle);
                d.set_column(first, &(by_structure * radius));
                d.set_column(first + 1, &(by_structure * angle));
                d.set_column(first + 2, &by_joint);
                d.set_column(first + 3, &(by_structure * structure.by_length(limb)));
            }
            if wanted.has(Wanted::PLATFORM) {
                // the kinematics gives the sphere centre, which moves against the platform end
                let radius = structure.by_platform(limb, &-by.platform_radius);
                let angle = structure.by_platform(limb, &-by.platform_angle);
                d.set_column(first + 4, &(by_structure * radius));
                d.set_column(first + 5, &(by_structure * angle));
            }
            if wanted.has(Wanted::LEAN) {
                for (k, lean) in self.kinematics.by_lean(limb, joint).iter().enumerate() {
                    let column = by_structure * structure.by_carriage(limb, lean);
                    d.set_column(RAIL_LEAN.start + 2 * limb + k, &column);
                }
            }
            if wanted.has(Wanted::JOINTS) {
                let [scale, sin, cos, half_way] = joints.by_own[limb];
                for (index, gain) in [
                    (JOINT_SCALE.start + limb, scale),
                    (ENCODER_CYCLIC.start + 2 * limb, sin),
                    (ENCODER_CYCLIC.start + 2 * limb + 1, cos),
                    (BACKLASH.start + limb, half_way),
                ] {
                    d.set_column(index, &(by_joint * gain));
                }
            }
            if wanted.has(Wanted::SAG) {
                let column = by_structure * structure.by_compliance(limb);
                d.set_column(GRAVITY_SAG.start + limb, &column);
            }
        }
        by_joints
    }

    /// Joint readings near those that bring the measured point to a reading: effects but lean and datum left out.
    ///
    /// # Errors
    /// As [`Kinematics::inverse`].
    pub fn rough_inverse(&self, reading: &Vector3<f64>) -> Result<Vector3<f64>> {
        self.kinematics
            .inverse(&(reading - self.datum - self.extras.target))
    }
}

fn checked(value: Vector3<f64>) -> Result<Vector3<f64>> {
    value
        .iter()
        .position(|v| !v.is_finite())
        .map_or(Ok(value), |index| Err(Error::NotFinite { index }))
}
