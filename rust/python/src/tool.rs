//! `ToolSensor` and `ToolBeam`: what the fibres of the flexible tool say, and where its tip goes.

use crate::arrays::{fixed, rows, rows_like, same_length, shaped};
use crate::errors::to_python;
use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};
use numpy::{
    PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use sherkit_core::numbers::rigid::Rigid;
use sherkit_core::tool::beam::Beam;
use sherkit_core::tool::rod::{Bending, Rod};
use sherkit_core::tool::sensing::{Calibration, Depth, Reading, Sensor};

/// Wavelengths of a row: three fibres at each of the sections I, II, III.
pub const WAVELENGTHS: usize = 9;
/// Numbers of a measurement: time, force (2), its covariance (4), depth, its variance, covariance with the force (2).
pub const MEASUREMENT: usize = 11;
/// Numbers of a pose: the rotation's rows, then the shift.
pub const POSE: usize = 12;

/// Why a row has no depth.
#[repr(u8)]
enum Code {
    Measured = 0,
    NoForce = 1,
    NotFinite = 2,
}

/// Sections from a row.
pub fn sections(row: &[f64; WAVELENGTHS]) -> [[f64; 3]; 3] {
    let [a, b, c, d, e, f, g, h, i] = *row;
    [[a, b, c], [d, e, f], [g, h, i]]
}

/// A pose from its numbers.
pub fn pose_of(numbers: &[f64; POSE]) -> Rigid {
    Rigid {
        rotation: Matrix3::from_row_slice(&numbers[..9]),
        translation: Vector3::new(numbers[9], numbers[10], numbers[11]),
    }
}

/// A calibrated tool: nine wavelengths in, moments, force and depth with their uncertainty out, of a rod that bends.
#[pyclass(frozen, module = "sherkit._core")]
pub struct ToolSensor(Sensor, Rod);

impl ToolSensor {
    /// The core's calibration of the gratings, and the shaft.
    pub fn parts(&self) -> (&Calibration, Rod) {
        (self.0.calibration(), self.1)
    }

    /// A measurement of a reading, as numbers.
    fn measured(&self, time_s: f64, reading: &Reading) -> [f64; MEASUREMENT] {
        let (c, size, mut force) = (
            &reading.force_covariance,
            reading.force.norm(),
            reading.force,
        );
        let (depth, variance, with) = match reading.depth {
            Depth::Measured {
                mm,
                variance,
                with_force,
            } => {
                let distances = self.0.calibration().distances_mm;
                let (true_size, depth) = self.1.exactly(size, mm, distances);
                force *= true_size / size;
                (depth, variance, with_force)
            }
            Depth::NoForce => (0.0, f64::INFINITY, Vector2::zeros()),
        };
        [
            time_s, force.x, force.y, c.m11, c.m12, c.m21, c.m22, depth, variance, with.x, with.y,
        ]
    }
}

type Readings<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<u8>>,
);

#[pymethods]
impl ToolSensor {
    /// `gains` `(2, 2, 3)`: `K_I`, `K_II` (mN·mm/nm); `distances_mm` from the tip to sections I and II;
    /// `reference_nm` `(9,)` of the unloaded tool.
    #[new]
    fn new(
        gains: PyReadonlyArray3<'_, f64>,
        distances_mm: PyReadonlyArray1<'_, f64>,
        reference_nm: PyReadonlyArray1<'_, f64>,
        noise_nm: f64,
        beam: &ToolBeam,
    ) -> PyResult<Self> {
        if gains.shape() != [2, 2, 3] {
            return Err(crate::errors::shape("gains", "(2, 2, 3)", gains.shape()));
        }
        let k = fixed::<12, _>("gains", &gains)?;
        Sensor::new(Calibration {
            gains: [
                Matrix2x3::from_row_slice(&k[..6]),
                Matrix2x3::from_row_slice(&k[6..]),
            ],
            distances_mm: fixed("distances_mm", &distances_mm)?,
            reference_nm: sections(&fixed("reference_nm", &reference_nm)?),
            noise_nm,
        })
        .map(|sensor| Self(sensor, beam.0))
        .map_err(to_python)
    }

    /// Measurements `(n, 11)` at times `(n,)`, moments `(n, 2, 2)`, misfit `(n,)`, common mode `(n, 3)` and why a row
    /// has no depth `(n,)`: 0 has one, 1 no force, 2 not finite. The first is what the filters take; of a row that is
    /// not finite all but the time is NaN.
    fn measure_batch<'py>(
        &self,
        py: Python<'py>,
        times_s: PyReadonlyArray1<'_, f64>,
        wavelengths_nm: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Readings<'py>> {
        let w = rows::<WAVELENGTHS, _>("wavelengths_nm", &wavelengths_nm)?.to_vec();
        let times = same_length("times_s", &times_s, w.len())?.to_vec();
        let n = w.len();
        let mut measured = vec![f64::NAN; n * MEASUREMENT];
        let mut moments = vec![f64::NAN; n * 4];
        let mut misfit = vec![f64::NAN; n];
        let mut common = vec![f64::NAN; n * 3];
        let mut codes = vec![Code::NotFinite as u8; n];
        py.detach(|| {
            for i in 0..n {
                measured[i * MEASUREMENT] = times[i];
                let Ok(reading) = self.0.read(&sections(&w[i])) else {
                    continue;
                };
                let m = self.measured(times[i], &reading);
                measured[i * MEASUREMENT..][..MEASUREMENT].copy_from_slice(&m);
                moments[i * 4..][..2].copy_from_slice(reading.moments[0].as_slice());
                moments[i * 4 + 2..][..2].copy_from_slice(reading.moments[1].as_slice());
                misfit[i] = reading.misfit;
                common[i * 3..][..3].copy_from_slice(&reading.common_nm);
                codes[i] = match reading.depth {
                    Depth::Measured { .. } => Code::Measured,
                    Depth::NoForce => Code::NoForce,
                } as u8;
            }
        });
        Ok((
            shaped(py, measured, [n, MEASUREMENT])?,
            shaped(py, moments, [n, 2, 2])?,
            PyArray1::from_vec(py, misfit),
            shaped(py, common, [n, 3])?,
            PyArray1::from_vec(py, codes),
        ))
    }
}

/// The shaft, as a cantilever or an elastica.
#[pyclass(frozen, module = "sherkit._core")]
pub struct ToolBeam(Rod);

#[pymethods]
impl ToolBeam {
    /// Free length (mm), bending stiffness `EI` (mN·mm²), and whether it bends as an elastica.
    #[new]
    #[pyo3(signature = (length_mm, stiffness, exact=false))]
    fn new(length_mm: f64, stiffness: f64, exact: bool) -> PyResult<Self> {
        let beam = Beam::new(length_mm, stiffness).map_err(to_python)?;
        let bending = if exact {
            Bending::Exact
        } else {
            Bending::Small
        };
        Ok(Self(Rod { beam, bending }))
    }

    /// Loads of a bench `(n,)`, mN, at depths `(n,)`, mm, both as the bench reads them (see the core's `Rod::loaded`):
    /// force across the rod, length of shaft beyond it, moments at two distances from the tip (mN·mm), and the deflection
    /// of the contact (mm) `(n, 5)`.
    fn loads_batch<'py>(
        &self,
        py: Python<'py>,
        forces_mn: PyReadonlyArray1<'_, f64>,
        depths_mm: PyReadonlyArray1<'_, f64>,
        distances_mm: [f64; 2],
        axial: bool,
        across: bool,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let forces = forces_mn.as_slice()?;
        let depths = same_length("depths_mm", &depths_mm, forces.len())?;
        let mut out = Vec::with_capacity(5 * forces.len());
        for (f, d) in forces.iter().zip(depths) {
            let (force, depth) = self.0.loaded(*f, *d, axial, across);
            out.extend([force, depth]);
            for l in distances_mm {
                let arm = (l - depth).max(0.0);
                out.push(force * arm * self.0.moment_share(force, arm));
            }
            out.push(self.0.aside(force, self.0.beam.length_mm() - depth));
        }
        shaped(py, out, [forces.len(), 5])
    }

    /// The tip in the base frame `(n, 3)`, mm, for poses `(n, 12)`.
    fn tip_batch<'py>(
        &self,
        py: Python<'py>,
        forces_mn: PyReadonlyArray2<'_, f64>,
        depths_mm: PyReadonlyArray1<'_, f64>,
        poses: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let forces = rows::<2, _>("forces_mn", &forces_mn)?.to_vec();
        let depths = same_length("depths_mm", &depths_mm, forces.len())?.to_vec();
        let poses = rows_like::<POSE>("poses", &poses, forces.len())?.to_vec();
        let mut out = Vec::with_capacity(forces.len() * 3);
        py.detach(|| {
            for ((f, d), pose) in forces.iter().zip(&depths).zip(&poses) {
                let tip = self.0.tip(&Vector2::from(*f), *d, &pose_of(pose));
                out.extend_from_slice(tip.as_slice());
            }
        });
        shaped(py, out, [forces.len(), 3])
    }
}
