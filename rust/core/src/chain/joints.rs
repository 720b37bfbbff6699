//! The joints link: from joint readings to the joints as they were when they were measured.

use super::body::since;
use super::effects::{Place, Wanted, values_of};
use super::row::Covariates;
use super::table::{Settings, Table};
use crate::numbers::math::sin_cos;
use nalgebra::{SMatrix, SVector};

/// Where a delay stands, of whatever reads the robot.
#[inline(always)]
fn late<T: Table>() -> Option<Place> {
    let at = T::AT.joints;
    at.camera_delay.or(at.reading_delay)
}

/// Effects that act at the joints.
#[derive(Clone, Copy, Debug)]
pub struct Joints<const J: usize> {
    offset: [f64; J],
    scale: [f64; J],
    cyclic: [[f64; 2]; J],
    second: [[f64; 2]; J],
    eccentricity: [[f64; 2]; J],
    backlash: [f64; J],
    slip: [f64; J],
    delay: f64,
    wave: [f64; J],
    home: [f64; J],
    slip_time_s: f64,
    /// No effect acts.
    exact: bool,
}

/// What one unit of each of a joint's own parameters adds to it.
#[derive(Clone, Copy, Debug)]
struct Gains {
    scale: f64,
    cyclic: [f64; 2],
    second: [f64; 2],
    eccentricity: [f64; 2],
    backlash: f64,
    slip: f64,
    delay: f64,
}

/// Joint readings turned into joints, with derivatives by reading and by the link's own parameters.
#[derive(Clone, Copy, Debug)]
pub struct Turned<const J: usize> {
    /// The joints as they really are.
    pub value: SVector<f64, J>,
    /// By the reading of the same joint; none where they are as they are read.
    by_reading: Option<[f64; J]>,
    gains: [Gains; J],
}

/// Whether a wave counts.
#[inline(always)]
fn asked(place: Option<Place>, wave: &[f64; 2], wanted: Wanted) -> bool {
    place.is_some() && (*wave != [0.0; 2] || wanted.wants(place).is_some())
}

/// Sine and cosine of each joint, one after the other among the values.
fn waves<const J: usize>(numbers: impl Fn(usize) -> f64) -> [[f64; 2]; J] {
    core::array::from_fn(|i| [numbers(2 * i), numbers(2 * i + 1)])
}

impl<const J: usize> Joints<J> {
    /// The link with the effects that a robot has.
    pub(crate) fn new<T: Table, const P: usize>(values: &[f64; P], settings: &Settings<J>) -> Self {
        let at = T::AT.joints;
        let number = |place: Option<Place>, k: usize| {
            place.map_or(0.0, |place| {
                values.get(place.start + k).copied().unwrap_or(0.0)
            })
        };
        let mut out = Self {
            offset: values_of(at.joint_offset, values),
            scale: values_of(at.joint_scale, values),
            cyclic: waves(|k| number(at.encoder_cyclic, k)),
            second: waves(|k| number(at.encoder_second, k)),
            eccentricity: waves(|k| number(at.encoder_eccentricity, k)),
            backlash: values_of(at.backlash, values),
            slip: values_of(at.joint_slip, values),
            delay: number(late::<T>(), 0),
            wave: settings.wave,
            home: settings.home,
            slip_time_s: settings.joint_slip_time_s,
            exact: false,
        };
        let waves = out
            .cyclic
            .as_flattened()
            .iter()
            .chain(out.second.as_flattened())
            .chain(out.eccentricity.as_flattened());
        let mut all = out
            .offset
            .iter()
            .chain(&out.scale)
            .chain(waves)
            .chain(&out.backlash)
            .chain(&out.slip);
        out.exact = all.all(|v| *v == 0.0) && out.delay == 0.0;
        out
    }

    /// Whether joints are as they are read, and no derivative by an effect is wanted.
    pub(crate) fn are_exact<T: Table>(&self, wanted: Wanted) -> bool {
        self.exact && !wanted.any(T::AT.joints.rows)
    }

    /// `θ = r + o + s (r - home) + a sin kr + b cos kr + w direction/2 + j - delay · velocity`, with `k` the joint's own
    /// wave of its encoder or gear, twice that, or one for the eccentricity of its ring, and `j` from the moment on at
    /// which joints slipped.
    #[inline]
    pub(crate) fn at<T: Table>(
        &self,
        readings: &SVector<f64, J>,
        row: &Covariates<J>,
        wanted: Wanted,
    ) -> Turned<J> {
        let at = T::AT.joints;
        let nothing = Gains {
            scale: 0.0,
            cyclic: [0.0; 2],
            second: [0.0; 2],
            eccentricity: [0.0; 2],
            backlash: 0.0,
            slip: 0.0,
            delay: 0.0,
        };
        let slipped = since(row.time_s, self.slip_time_s);
        let mut out = Turned {
            value: *readings,
            by_reading: None,
            gains: [nothing; J],
        };
        if self.are_exact::<T>(wanted) {
            return out;
        }
        let mut by_reading = [1.0; J];
        for i in 0..J {
            let r = readings[i];
            let gains = &mut out.gains[i];
            let (mut more, mut slope) = (0.0, 0.0);
            if at.joint_offset.is_some() {
                more += self.offset[i];
            }
            if at.joint_scale.is_some() {
                gains.scale = r - self.home[i];
                more += self.scale[i] * gains.scale;
                slope += self.scale[i];
            }
            // a wave at zero whose derivatives nobody wants need not be computed
            if asked(at.encoder_cyclic, &self.cyclic[i], wanted) {
                let ((sin, cos), [a, b]) = (sin_cos(self.wave[i] * r), self.cyclic[i]);
                gains.cyclic = [sin, cos];
                more = more + a * sin + b * cos;
                slope += self.wave[i] * (a * cos - b * sin);
            }
            if asked(at.encoder_second, &self.second[i], wanted) {
                let wave = 2.0 * self.wave[i];
                let ((sin, cos), [a, b]) = (sin_cos(wave * r), self.second[i]);
                gains.second = [sin, cos];
                more = more + a * sin + b * cos;
                slope += wave * (a * cos - b * sin);
            }
            if asked(at.encoder_eccentricity, &self.eccentricity[i], wanted) {
                let ((sin, cos), [a, b]) = (sin_cos(r), self.eccentricity[i]);
                gains.eccentricity = [sin, cos];
                more = more + a * sin + b * cos;
                slope = slope + a * cos - b * sin;
            }
            out.value[i] += more;
            // an effect at zero does not ask for its covariate
            if at.backlash.is_some() {
                gains.backlash = 0.5 * row.direction[i];
                if self.backlash[i] != 0.0 {
                    out.value[i] += self.backlash[i] * gains.backlash;
                }
            }
            if at.joint_slip.is_some() {
                gains.slip = slipped;
                if self.slip[i] != 0.0 {
                    out.value[i] += self.slip[i] * slipped;
                }
            }
            if late::<T>().is_some() {
                gains.delay = -row.velocity[i];
                if self.delay != 0.0 {
                    out.value[i] -= self.delay * row.velocity[i];
                }
            }
            by_reading[i] += slope;
        }
        out.by_reading = Some(by_reading);
        out
    }
}

impl<const J: usize> Turned<J> {
    /// Writes the wanted columns of the link's own parameters, carried on by the derivative by the joints.
    #[inline]
    pub(crate) fn columns<T: Table, const M: usize, const P: usize>(
        &self,
        by_joints: &SMatrix<f64, M, J>,
        wanted: Wanted,
        d: &mut SMatrix<f64, M, P>,
    ) {
        let at = T::AT.joints;
        if !wanted.any(at.rows) {
            return;
        }
        for i in 0..J {
            let (by_joint, gains) = (by_joints.column(i), &self.gains[i]);
            if let Some(place) = wanted.wants(at.joint_offset) {
                d.set_column(place.start + i, &by_joint);
            }
            if let Some(place) = wanted.wants(at.joint_scale) {
                d.set_column(place.start + i, &(by_joint * gains.scale));
            }
            if let Some(place) = wanted.wants(at.encoder_cyclic) {
                d.set_column(place.start + 2 * i, &(by_joint * gains.cyclic[0]));
                d.set_column(place.start + 2 * i + 1, &(by_joint * gains.cyclic[1]));
            }
            if let Some(place) = wanted.wants(at.encoder_second) {
                d.set_column(place.start + 2 * i, &(by_joint * gains.second[0]));
                d.set_column(place.start + 2 * i + 1, &(by_joint * gains.second[1]));
            }
            if let Some(place) = wanted.wants(at.encoder_eccentricity) {
                let [sin, cos] = gains.eccentricity;
                d.set_column(place.start + 2 * i, &(by_joint * sin));
                d.set_column(place.start + 2 * i + 1, &(by_joint * cos));
            }
            if let Some(place) = wanted.wants(at.backlash) {
                d.set_column(place.start + i, &(by_joint * gains.backlash));
            }
            if let Some(place) = wanted.wants(at.joint_slip) {
                d.set_column(place.start + i, &(by_joint * gains.slip));
            }
        }
        if let Some(place) = wanted.wants(late::<T>()) {
            let mut behind = SVector::<f64, M>::zeros();
            for i in 0..J {
                behind += by_joints.column(i) * self.gains[i].delay;
            }
            d.set_column(place.start, &behind);
        }
    }

    /// Carries a derivative by the joints on to one by the readings.
    #[inline]
    pub(crate) fn by_readings<const M: usize>(
        &self,
        mut by_joints: SMatrix<f64, M, J>,
    ) -> SMatrix<f64, M, J> {
        if let Some(by_reading) = &self.by_reading {
            for i in 0..J {
                by_joints.column_mut(i).scale_mut(by_reading[i]);
            }
        }
        by_joints
    }
}
