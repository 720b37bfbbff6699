//! Nine wavelengths into moments, sclera force and insertion depth, with their uncertainty.
//!
//! Source: Eqs. 1 and 2 of the tool paper; common-mode removal from He et al. 2014 (the paper's reference 21).
//!
//! Eq. 2 gives depth twice, from the moments at section I and at II. Taken along the force instead of by
//! their lengths, `d = l_i - M_i·F / |F|²`, both are one number, because `M_II - M_I = F Δl` is how the force
//! was found: nothing is left to combine. Unlike the lengths this keeps the sign of a moment, and it is the
//! same to first order in the noise. What the two moments say beyond force and depth is whether they are parallel
//! at all; [`Reading::misfit`] keeps that.
//!
//! Depth is a ratio, and first-order propagation thinks too well of it when the force is not far above its
//! noise. `|F|²` in the variance is therefore lowered by `3²` times the variance of the force, which far above the
//! noise changes nothing. Up to five standard deviations of the force depth is [`Depth::NoForce`]: noise alone puts
//! the ratio between the two sections, where its own propagated variance is smallest, so that what noise feigns is
//! no wild number but a plausible one. Beyond three deviations it does so once in 10⁴ readings (Rayleigh:
//! `exp(-3²)`), a minute of them; beyond five once in 10¹⁰.

use crate::{Error, Result};
use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};

/// Sections with gratings: I and II up the shaft, and III, which Eqs. 1 and 2 do not read.
pub const SECTIONS: usize = 3;
/// Fibres around the shaft.
pub const FIBRES: usize = 3;
/// Standard deviations of the force below which it is no force.
const DETECTED: f64 = 5.0;
/// Standard deviations of the force by which its length is not trusted in the variance of the depth.
const CAUTION: f64 = 3.0;

/// Calibration of the gratings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// `K_I`, `K_II`: moment (mN·mm) per wavelength difference (nm). A moment bears the name of the force that
    /// causes it: its x component is that of a force along x.
    pub gains: [Matrix2x3<f64>; 2],
    /// `l_I`, `l_II`: from tip to the sections, mm. II is further up the shaft.
    pub distances_mm: [f64; 2],
    /// Wavelengths of the unloaded tool, nm: one row of fibres for each of the sections I, II, III.
    pub reference_nm: [[f64; FIBRES]; SECTIONS],
    /// Standard deviation of one wavelength, nm.
    pub noise_nm: f64,
}

/// Insertion depth as the fibres tell it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Depth {
    /// The force is large enough to say where it acts.
    Measured {
        /// Depth, mm. It may lie outside the tool where noise or a second contact put it there.
        mm: f64,
        /// Variance, mm².
        variance: f64,
        /// Covariance with the force, mm·mN.
        with_force: Vector2<f64>,
    },
    /// The force does not differ from zero: depth has no bound.
    NoForce,
}

/// What one set of wavelengths says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Moments at sections I and II, mN·mm.
    pub moments: [Vector2<f64>; 2],
    /// Sclera force across the shaft, tool frame, mN (Eq. 1).
    pub force: Vector2<f64>,
    /// Its covariance, mN².
    pub force_covariance: Matrix2<f64>,
    /// Insertion depth (Eq. 2).
    pub depth: Depth,
    /// Square of how far the moments are from parallel over its variance: about 1 on average for a single
    /// contact below section I, larger for a second contact or wrong gains. Zero where there is no noise.
    pub misfit: f64,
    /// Mean wavelength change of the sections I, II and III, nm: temperature and pull.
    pub common_nm: [f64; SECTIONS],
}

/// A calibrated tool, ready to read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    calibration: Calibration,
    /// Gains that ignore what is common to the three fibres.
    gains: [Matrix2x3<f64>; 2],
    moment_covariance: [Matrix2<f64>; 2],
    force_covariance: Matrix2<f64>,
    between_mm: f64,
}

/// `x yᵗ - y xᵗ`: how far two moments are from parallel.
fn across(a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    a.x * b.y - a.y * b.x
}

impl Sensor {
    /// Checks a calibration and prepares what does not change.
    ///
    /// # Errors
    /// [`Error::Invalid`] for numbers that are not finite, a negative noise, or section II not above I.
    pub fn new(calibration: Calibration) -> Result<Self> {
        let c = &calibration;
        let numbers = c.gains.iter().flatten();
        let numbers = numbers.chain(c.reference_nm.as_flattened());
        if !numbers.chain(&c.distances_mm).all(|x| x.is_finite()) {
            return Err(Error::Invalid {
                what: "tool: gains, distances and reference wavelengths must be finite",
            });
        }
        let between_mm = c.distances_mm[1] - c.distances_mm[0];
        if between_mm <= 0.0 || c.distances_mm[0] <= 0.0 {
            return Err(Error::Invalid {
                what: "tool: section I must lie above the tip, and section II above section I",
            });
        }
        if !(c.noise_nm >= 0.0 && c.noise_nm.is_finite()) {
            return Err(Error::Invalid {
                what: "tool: the noise of a wavelength must be zero or more",
            });
        }
        let gains = c.gains.map(|k| {
            let mean = k.column_sum() / 3.0;
            Matrix2x3::from_columns(&[k.column(0) - mean, k.column(1) - mean, k.column(2) - mean])
        });
        let variance = c.noise_nm * c.noise_nm;
        let moment_covariance = gains.map(|g| g * g.transpose() * variance);
        Ok(Self {
            calibration,
            gains,
            moment_covariance,
            force_covariance: (moment_covariance[0] + moment_covariance[1])
                / (between_mm * between_mm),
            between_mm,
        })
    }

    /// The calibration.
    #[must_use]
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// Force and depth from wavelengths (nm; sections I, II, III).
    ///
    /// # Errors
    /// [`Error::NotFinite`] names the wavelength, counted through the sections; those of III do not matter.
    pub fn read(&self, wavelengths_nm: &[[f64; FIBRES]; SECTIONS]) -> Result<Reading> {
        let shift = |section: usize| {
            let (now, then) = (
                &wavelengths_nm[section],
                &self.calibration.reference_nm[section],
            );
            Vector3::new(now[0] - then[0], now[1] - then[1], now[2] - then[2])
        };
        let shifts = [shift(0), shift(1), shift(2)];
        let read = shifts[0].iter().chain(&shifts[1]);
        if let Some(index) = read.clone().position(|x| !x.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        // the gains remove the common mode too; taken off first, a large one costs no digits
        let common = shifts.map(|s| (s[0] + s[1] + s[2]) / 3.0);
        let moment = |i: usize| self.gains[i] * shifts[i].add_scalar(-common[i]);
        let moments = [moment(0), moment(1)];
        let force = (moments[1] - moments[0]) / self.between_mm;
        if !(force.x.is_finite() && force.y.is_finite()) {
            return Err(Error::NotFinite { index: 0 });
        }
        Ok(Reading {
            moments,
            force,
            force_covariance: self.force_covariance,
            depth: self.depth(&moments, &force),
            misfit: self.misfit(&moments),
            common_nm: common,
        })
    }

    /// Eq. 2 along the force, with the variance of the module's text.
    fn depth(&self, moments: &[Vector2<f64>; 2], force: &Vector2<f64>) -> Depth {
        let squared = force.norm_squared();
        let noise = self.force_covariance.trace();
        // written so that NaN is no force either
        if !(squared > DETECTED * DETECTED * noise && squared > 0.0) {
            return Depth::NoForce;
        }
        let known = squared - CAUTION * CAUTION * noise;
        let lever = moments[1].dot(force) / squared;
        // derivatives of the lever by the force at a given moment, and by the moment at a given force
        let by_force = (moments[1] - force * (2.0 * lever)) / (squared * self.between_mm);
        let by_upper = -(force / squared + by_force);
        let by_lower = by_force;
        let [lower, upper] = self.moment_covariance;
        let (pushed_lower, pushed_upper) = (lower * by_lower, upper * by_upper);
        let first_order = by_lower.dot(&pushed_lower) + by_upper.dot(&pushed_upper);
        let mm = self.calibration.distances_mm[1] - lever;
        let variance = first_order * (squared / known);
        if !(mm.is_finite() && variance.is_finite()) {
            return Depth::NoForce;
        }
        Depth::Measured {
            mm,
            variance,
            // what was added to the variance is uncertainty of its own, so this stays as it is
            with_force: (pushed_upper - pushed_lower) / self.between_mm,
        }
    }

    fn misfit(&self, moments: &[Vector2<f64>; 2]) -> f64 {
        let [lower, upper] = moments;
        let turned = |m: &Vector2<f64>| Vector2::new(m.y, -m.x);
        let [lower_covariance, upper_covariance] = &self.moment_covariance;
        let variance = turned(upper).dot(&(lower_covariance * turned(upper)))
            + turned(lower).dot(&(upper_covariance * turned(lower)));
        let miss = across(lower, upper);
        let misfit = miss * miss / variance;
        if misfit.is_finite() { misfit } else { 0.0 }
    }

    /// Depth as Eq. 2 is printed, by the lengths of the moments at sections I and II, mm: for comparison with the
    /// paper. Without force it is not finite.
    #[must_use]
    pub fn depth_by_lengths(&self, reading: &Reading) -> [f64; 2] {
        let force = reading.force.norm();
        let [lower, upper] = self.calibration.distances_mm;
        [
            lower - reading.moments[0].norm() / force,
            upper - reading.moments[1].norm() / force,
        ]
    }
}
