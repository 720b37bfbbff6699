//! Gains of the gratings, stiffness and length of the shaft, from rows with known force and depth.
//!
//! Source: section VII of the tool paper and its reference 21 (He et al. 2014): known forces at known places along
//! the shaft. Gains are linear; stiffness is fitted as in the paper, by the slope of `F (h - d)³` over the
//! deflection, and together with the length by least squares in the deflection. The paper's slope takes the
//! length from the drawing and puts the noise of the deflection into the abscissa, which flattens the line;
//! the joint fit does neither.

use super::beam::Beam;
use crate::fit::back_substitute;
use crate::fit::{
    Levenberg, Progress, Settings, Stack, decomposition_len, levenberg_len, stack_len,
};
use crate::numbers::math::sqrt;
use crate::{Error, Result};
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Matrix3x2, Vector2};

/// Below this the rows do not determine the unknowns.
const SINGULAR: f64 = 1e-9;
/// Plausible error of the length for the joint fit, mm.
const LENGTH_SIZE_MM: f64 = 5.0;
/// Plausible error of the stiffness for the joint fit, relative.
const STIFFNESS_SIZE: f64 = 0.3;

/// Two directions across (1, 1, 1): what is left of three fibres without their common mode.
fn differences() -> Matrix3x2<f64> {
    let (a, b) = (1.0 / sqrt(6.0), 1.0 / sqrt(2.0));
    Matrix3x2::new(2.0 * a, 0.0, -a, b, -a, -b)
}

/// Fit of one section's gains, in constant memory.
#[derive(Clone, Debug)]
pub struct GainFit {
    distance_mm: f64,
    stack: Stack<[f64; stack_len(2, 2)]>,
}

/// Gains of one section.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gain {
    /// `K`, mN·mm/nm. Its rows sum to zero: the common mode is not observed, and the least gain of all is taken.
    pub gain: Matrix2x3<f64>,
    /// Covariance of the two moments' residuals, (mN·mm)².
    pub residual_covariance: Matrix2<f64>,
    /// Times a moment's residual variance it is the covariance of its row of `K`, nm⁻².
    pub unit_covariance: Matrix3<f64>,
    /// Smallest over largest share that the rows tell of the two directions of bending: near zero where all
    /// forces pointed one way.
    pub weakest: f64,
}

impl GainFit {
    /// For a section at this distance from the tip, mm.
    ///
    /// # Errors
    /// [`Error::Invalid`] where the distance is not positive.
    pub fn new(distance_mm: f64) -> Result<Self> {
        if !(distance_mm > 0.0 && distance_mm.is_finite()) {
            return Err(Error::Invalid {
                what: "calibration: a section must lie above the tip",
            });
        }
        let stack = Stack::new(2, 2, [0.0; stack_len(2, 2)])?;
        Ok(Self { distance_mm, stack })
    }

    /// Adds a row: wavelengths less those of the unloaded tool (nm), force (mN) and its depth (mm).
    ///
    /// # Errors
    /// [`Error::NotFinite`] names the component (wavelengths 0 to 2, force 3 and 4, depth 5);
    /// [`Error::Invalid`] where the force acts above the section, which then does not feel it.
    pub fn push(&mut self, shift_nm: &[f64; 3], force_mn: &[f64; 2], depth_mm: f64) -> Result<()> {
        let all = shift_nm.iter().chain(force_mn).chain([&depth_mm]);
        if let Some(index) = all.copied().position(|x| !x.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        let lever = self.distance_mm - depth_mm;
        if lever < 0.0 {
            return Err(Error::Invalid {
                what: "calibration: the force acts above the section, which does not feel it",
            });
        }
        let [a, b, c] = *shift_nm;
        let s = differences();
        let left = |k: usize| s[(0, k)] * a + s[(1, k)] * b + s[(2, k)] * c;
        self.stack
            .push([left(0), left(1), force_mn[0] * lever, force_mn[1] * lever]);
        Ok(())
    }

    /// Rows so far.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.stack.rows()
    }

    /// The gains of least squared residuals in the moments, with what wavelengths of this noise (nm) flatten them by
    /// taken back: the normal matrix is less by a row's noise for each row (Fuller, *Measurement Error Models*, 2.2).
    ///
    /// # Errors
    /// [`Error::TooFew`] below three rows; [`Error::Singular`] where all forces point one way, or where the noise is
    /// all that the wavelengths show.
    pub fn solve(&mut self, noise_nm: f64) -> Result<Gain> {
        let rows = self.stack.rows();
        if rows < 3 {
            return Err(Error::TooFew {
                needed: 3,
                found: rows,
            });
        }
        let triangle = self.stack.triangle();
        let mut solution = [0.0; 4];
        let weakest = back_substitute(triangle, 2, 2, &mut solution);
        if weakest.is_nan() || weakest < SINGULAR {
            return Err(Error::Singular);
        }
        let t = Matrix2::new(triangle[10], triangle[11], 0.0, triangle[15]);
        let r = Matrix2::new(triangle[0], triangle[1], 0.0, triangle[5]);
        let inverse = r.try_inverse().ok_or(Error::Singular)?;
        let s = differences();
        let plain = Matrix2::new(solution[0], solution[2], solution[1], solution[3]);
        let normal = r.transpose() * r;
        let less = normal - Matrix2::identity() * (noise_nm * noise_nm * rows as f64);
        if !(less.m11 > 0.0 && less.determinant() > 0.0) {
            return Err(Error::Singular);
        }
        let by_differences = plain * normal * less.try_inverse().ok_or(Error::Singular)?;
        Ok(Gain {
            gain: by_differences * s.transpose(),
            residual_covariance: t.transpose() * t / (rows - 2) as f64,
            unit_covariance: s * inverse * inverse.transpose() * s.transpose(),
            weakest,
        })
    }
}

/// The paper's fit of the stiffness: `F (h - d)³` over the deflection at the contact, slope `3EI`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlopeFit {
    length_mm: f64,
    count: usize,
    /// Means of deflection and of `F (h - d)³`.
    mean: Vector2<f64>,
    /// Their scatter about the means.
    scatter: Matrix2<f64>,
}

/// A stiffness and its standard deviation, mN·mm².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stiffness {
    /// `EI`.
    pub value: f64,
    /// Its standard deviation as the scatter about the line tells.
    pub deviation: f64,
}

impl SlopeFit {
    /// For a shaft of this free length, mm.
    ///
    /// # Errors
    /// [`Error::Invalid`] where it is not positive.
    pub fn new(length_mm: f64) -> Result<Self> {
        // the beam's own check, so that both say the same
        Beam::new(length_mm, 1.0)?;
        Ok(Self {
            length_mm,
            count: 0,
            mean: Vector2::zeros(),
            scatter: Matrix2::zeros(),
        })
    }

    /// Adds a row: force (mN), depth (mm), deflection of the shaft where the force acts (mm).
    ///
    /// # Errors
    /// [`Error::NotFinite`] names the component; the row is not taken.
    pub fn push(&mut self, force_mn: f64, depth_mm: f64, deflection_mm: f64) -> Result<()> {
        let all = [force_mn, depth_mm, deflection_mm];
        if let Some(index) = all.iter().position(|x| !x.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        let a = self.length_mm - depth_mm;
        let row = Vector2::new(deflection_mm, force_mn * a * a * a);
        self.count += 1;
        let before = row - self.mean;
        self.mean += before / self.count as f64;
        self.scatter += before * (row - self.mean).transpose();
        Ok(())
    }

    /// The stiffness by a line through the origin, or with an intercept.
    ///
    /// # Errors
    /// [`Error::TooFew`] below two rows (three with an intercept); [`Error::Singular`] where all deflections are
    /// equal (zero).
    pub fn solve(&self, intercept: bool) -> Result<Stiffness> {
        let needed = if intercept { 3 } else { 2 };
        if self.count < needed {
            return Err(Error::TooFew {
                needed,
                found: self.count,
            });
        }
        let n = self.count as f64;
        let s = if intercept {
            self.scatter
        } else {
            self.scatter + self.mean * self.mean.transpose() * n
        };
        if s.m11 <= 0.0 {
            return Err(Error::Singular);
        }
        let slope = s.m12 / s.m11;
        let left = (s.m22 - slope * s.m12).max(0.0);
        let degrees = n - needed as f64 + 1.0;
        Ok(Stiffness {
            value: slope / 3.0,
            deviation: sqrt(left / degrees / s.m11) / 3.0,
        })
    }
}

/// Where a deflection was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Where the force acts.
    Contact,
    /// At the tip.
    Tip,
}

/// One measured bend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bend {
    /// Force, mN.
    pub force_mn: f64,
    /// Depth where it acts, mm.
    pub depth_mm: f64,
    /// Deflection along the force, mm.
    pub deflection_mm: f64,
    /// Where.
    pub place: Place,
}

impl Bend {
    /// What a beam says of it, mm, and the derivatives by length and stiffness.
    fn predict(&self, beam: &Beam) -> (f64, [f64; 2]) {
        let f = self.force_mn;
        match self.place {
            Place::Tip => {
                let c = beam.compliance(self.depth_mm);
                (f * c.value, [f * c.by_length, f * c.by_stiffness])
            }
            Place::Contact => {
                let (k, c) = (beam.stiffness(), beam.contact_compliance(self.depth_mm));
                let a = (beam.length_mm() - self.depth_mm.max(0.0)).max(0.0);
                (f * c, [f * a * a / k, -f * c / k])
            }
        }
    }
}

/// A beam that fits measured bends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamFit {
    /// Length and stiffness.
    pub beam: Beam,
    /// Covariance of length (mm) and stiffness (mN·mm²), from the scatter of the residuals.
    pub covariance: Matrix2<f64>,
    /// Standard deviation of a residual, mm.
    pub residual_mm: f64,
}

/// Length and stiffness together, by least squares in the deflection, from a beam to start at.
///
/// # Errors
/// [`Error::TooFew`] below three bends; [`Error::NotFinite`] where one is not finite; [`Error::Singular`] where all
/// stand at one depth, which cannot tell a longer shaft from a softer one; [`Error::NotConverged`].
pub fn fit_beam(bends: &[Bend], start: &Beam) -> Result<BeamFit> {
    const N: usize = 2;
    if bends.len() < 3 {
        return Err(Error::TooFew {
            needed: 3,
            found: bends.len(),
        });
    }
    let first = [start.length_mm(), start.stiffness()];
    let sizes = [LENGTH_SIZE_MM, STIFFNESS_SIZE * start.stiffness()];
    let settings = Settings {
        step_tolerance: 1e-9,
        ..Settings::default()
    };
    let mut iteration = Levenberg::new(&first, &sizes, settings, [0.0; levenberg_len(N)])?;
    let mut stack = Stack::new(N, 1, [0.0; stack_len(N, 1)])?;
    loop {
        let trial = iteration.trial();
        // a step to a beam that is none is a step too far: the iteration shortens it
        let beam = Beam::new(trial[0], trial[1]);
        stack.clear();
        let mut cost = if beam.is_ok() { 0.0 } else { f64::INFINITY };
        if let Ok(beam) = &beam {
            for bend in bends {
                let (value, [by_length, by_stiffness]) = bend.predict(beam);
                let left = bend.deflection_mm - value;
                cost += left * left;
                stack.push([by_length, by_stiffness, left]);
            }
        }
        let progress = iteration.advance(stack.triangle(), cost)?;
        // along a direction that is not observed the iteration need not settle
        if iteration.with_decomposition(|d| N - d.rank())? > 0 {
            return Err(Error::Singular);
        }
        match progress {
            Progress::Evaluate => {}
            Progress::Converged => break,
            Progress::Exhausted => {
                return Err(Error::NotConverged {
                    iterations: iteration.evaluations(),
                });
            }
        }
    }
    let trial = iteration.trial();
    let beam = Beam::new(trial[0], trial[1])?;
    let left = bends
        .iter()
        .map(|b| b.deflection_mm - b.predict(&beam).0)
        .map(|left| left * left);
    let variance = left.sum::<f64>() / (bends.len() - N) as f64;
    let (mut data, mut unobserved) = ([0.0; N * N], [0.0; N * N]);
    iteration.with_decomposition(|d| d.covariance(&mut data, &mut unobserved, &mut [0.0; N]))?;
    Ok(BeamFit {
        beam,
        covariance: Matrix2::from_row_slice(&data) * variance,
        residual_mm: sqrt(variance),
    })
}

// the storage of the fit stands on the stack of its caller: it must stay small
const _: () = assert!(levenberg_len(2) + stack_len(2, 1) + decomposition_len(2) < 1024);
