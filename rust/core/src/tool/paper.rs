//! The paper's two Kalman filters as they are printed: insertion depth (Eq. 8), and tip (Eqs. 9 to 14).
//!
//! Source: Ebrahimi et al. 2020, section IV, with the noise of section VII. They are here to reproduce the paper, and to
//! run beside [`super::filter`], which must never be worse.
//!
//! Eq. 13 measures in units of force, `F + Γ Rᵀ S = Γ Rᵀ P`. Multiplied by `Γ⁻¹` this is `δ + Rᵀ S = Rᵀ P`: the same
//! filter, with noise in mm² and no free `α_z`. Its third line, no deflection along the shaft, is exact: in the tool's frame
//! the filter first conditions on it, which leaves two numbers and their 2 × 2 noise, and no zero is ever inverted.

use super::beam::Beam;
use super::sensing::{Calibration, FIBRES, SECTIONS, Sensor};
use super::status::{Consistency, Counts, Status, Told};
use crate::numbers::math::sqrt;
use crate::numbers::rigid::Rigid;
use crate::{Error, Result};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Variances of what is measured.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Variances {
    /// Of the depth, mm².
    pub depth: f64,
    /// Of each component across the shaft: of the deflection (mm²) or of the force (mN²).
    pub across: f64,
}

/// The noise of section VII.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct PaperNoise {
    /// The force from which on the second set holds, mN.
    pub at_mn: f64,
    /// Below it.
    pub below: Variances,
    /// From it on.
    pub above: Variances,
    /// Whether [`Variances::across`] is of the force, as Eq. 14 would have it, or of the deflection: the paper gives no
    /// units.
    pub of_force: bool,
    /// Process noise that each step adds, mm²: depth, and each axis of the tip.
    pub per_step: [f64; 2],
}

impl PaperNoise {
    /// The paper's, for steps of 200 Hz, its entries read as variances in mm².
    #[must_use]
    pub fn ebrahimi_2020() -> Self {
        Self {
            at_mn: 50.0,
            below: Variances {
                depth: 1e6,
                across: 10.0,
            },
            above: Variances {
                depth: 0.005,
                across: 0.002,
            },
            of_force: false,
            per_step: [0.0025, 0.01],
        }
    }

    fn check(&self) -> Result<()> {
        let sets = [self.below, self.above].map(|v| [v.depth, v.across]);
        let all = sets.as_flattened().iter().chain(&self.per_step);
        if all.chain([&self.at_mn]).all(|x| *x >= 0.0 && x.is_finite()) {
            Ok(())
        } else {
            Err(Error::Invalid {
                what: "noise: variances must be zero or more, and finite",
            })
        }
    }
}

/// Both filters on one tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperFilter {
    sensor: Sensor,
    beam: Beam,
    noise: PaperNoise,
    time_s: f64,
    pose: Rigid,
    depth: f64,
    variance: f64,
    tip: Vector3<f64>,
    /// In the base frame, mm².
    covariance: Matrix3<f64>,
    force: Vector2<f64>,
    counts: Counts,
    consistency: Consistency,
}

impl PaperFilter {
    /// Starts at a depth (mm) with a variance (mm², of each axis of the tip as well), with the tool at a pose, at a time.
    ///
    /// # Errors
    /// [`Error::Invalid`] for numbers that mean nothing.
    pub fn new(
        calibration: &Calibration,
        beam: Beam,
        noise: PaperNoise,
        depth_mm: f64,
        variance: f64,
        pose: &Rigid,
        time_s: f64,
    ) -> Result<Self> {
        noise.check()?;
        let sensor = Sensor::new(*calibration)?;
        let pose_known = pose.translation.iter().chain(pose.rotation.iter());
        let known = pose_known
            .chain([&depth_mm, &time_s])
            .all(|x| x.is_finite());
        if !(known && variance >= 0.0 && variance.is_finite()) {
            return Err(Error::Invalid {
                what: "filter: the first estimate must be finite, its variance zero or more",
            });
        }
        Ok(Self {
            sensor,
            beam,
            noise,
            time_s,
            pose: *pose,
            depth: depth_mm,
            variance,
            tip: pose.translation,
            covariance: Matrix3::identity() * variance,
            force: Vector2::zeros(),
            counts: Counts::default(),
            consistency: Consistency::default(),
        })
    }

    /// One step to a time (s) and a pose, with wavelengths (nm; three fibres at each of the sections I, II, III) where
    /// there are some. The paper knows no late readings: they are of the present.
    #[inline]
    pub fn step(
        &mut self,
        time_s: f64,
        pose: &Rigid,
        wavelengths_nm: Option<&[[f64; FIBRES]; SECTIONS]>,
    ) -> Status {
        self.consistency.rest();
        let elapsed = time_s - self.time_s;
        if !(elapsed >= 0.0 && elapsed.is_finite()) {
            self.counts.add(Status::CLOCK);
            return Status::CLOCK;
        }
        self.time_s = time_s;
        let mut status = Status::default();
        let moved = pose.translation - self.pose.translation;
        // false for NaN
        if moved.norm_squared() < 1e12 && pose.rotation.iter().all(|x| x.abs() < 2.0) {
            self.depth += moved.dot(&self.pose.rotation.column(2));
            self.tip += moved;
            self.pose = *pose;
        } else {
            status = Status::NO_MOTION;
        }
        self.variance += self.noise.per_step[0];
        self.covariance += Matrix3::identity() * self.noise.per_step[1];
        status = status | wavelengths_nm.map_or(Status::MISSING, |w| self.fold(w));
        self.counts.add(status);
        status
    }

    fn fold(&mut self, w: &[[f64; FIBRES]; SECTIONS]) -> Status {
        let Ok(reading) = self.sensor.read(w) else {
            return Status::NOT_FINITE;
        };
        self.force = reading.force;
        // Eq. 2, from section II
        let [_, measured] = self.sensor.depth_by_lengths(&reading);
        if !measured.is_finite() {
            return Status::NO_FORCE;
        }
        let of = if reading.force.norm() < self.noise.at_mn {
            self.noise.below
        } else {
            self.noise.above
        };
        // Eq. 7
        let (innovation, total) = (measured - self.depth, self.variance + of.depth);
        if total > 0.0 {
            let gain = self.variance / total;
            self.depth += gain * innovation;
            self.variance *= 1.0 - gain;
            self.consistency.add(innovation * innovation / total);
        }
        let bend = self.beam.compliance(self.depth).value;
        let across = of.across
            * if self.noise.of_force {
                bend * bend
            } else {
                1.0
            };
        self.bend(reading.force * bend, across);
        Status::UPDATED
    }

    /// Eq. 14 in the tool's frame: no deflection along the shaft, and a measured one across it with such a variance.
    fn bend(&mut self, deflection: Vector2<f64>, variance: f64) {
        let r = self.pose.rotation;
        let off = r.transpose() * (self.pose.translation - self.tip);
        let p = r.transpose() * self.covariance * r;
        let z = p[(2, 2)];
        // what rounding leaves of a direction that is known already says nothing of the others
        let with = if z > 1e-12 * p.trace() {
            Vector2::new(p[(0, 2)], p[(1, 2)]) / z
        } else {
            Vector2::zeros()
        };
        let left = p.fixed_view::<2, 2>(0, 0) - with * with.transpose() * z;
        let total = left + Matrix2::identity() * variance;
        let Some(inverse) = total.try_inverse() else {
            return;
        };
        let gain = left * inverse;
        let after = with * off.z;
        let across = after + gain * (off.xy() + deflection - after);
        self.tip += r * Vector3::new(across.x, across.y, off.z);
        // (I - K) left = K variance; by its factor it stays symmetric, and positive
        let axes = r.fixed_view::<3, 2>(0, 0) * factor(&(gain * variance));
        self.covariance = axes * axes.transpose();
    }

    /// Depth and tip now; the paper says nothing of what they know of each other.
    #[must_use]
    pub fn told(&self) -> Told {
        let mut covariance = [[0.0; 4]; 4];
        covariance[0][0] = self.variance;
        for i in 0..3 {
            for j in 0..3 {
                covariance[i + 1][j + 1] = self.covariance[(i, j)];
            }
        }
        Told {
            time_s: self.time_s,
            depth_mm: self.depth,
            arc_mm: self.depth,
            tip_mm: self.tip.into(),
            covariance,
            force_mn: self.force.into(),
            force_variance: 0.0,
        }
    }

    /// How often what happened.
    #[must_use]
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Innovation statistics of the depth.
    #[must_use]
    pub fn consistency(&self) -> &Consistency {
        &self.consistency
    }
}

/// Factor `L` of a covariance of two numbers, with zeros where rounding has left nothing of it.
fn factor(c: &Matrix2<f64>) -> Matrix2<f64> {
    let first = sqrt(c.m11.max(0.0));
    let below = if first > 0.0 {
        0.5 * (c.m12 + c.m21) / first
    } else {
        0.0
    };
    Matrix2::new(first, 0.0, below, sqrt((c.m22 - below * below).max(0.0)))
}
