//! `ToolSensor` and `ToolBeam`: what the fibres of the flexible tool say, and where its tip goes.

use crate::arrays::{fixed, rows, rows_like, same_length, shaped};
use crate::errors::to_python;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};
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

/// What the fibres tell at one time, as numbers.
struct Measurement {
    time_s: f64,
    force: [f64; 2],
    force_covariance: [[f64; 2]; 2],
    depth: f64,
    depth_variance: f64,
    depth_with_force: [f64; 2],
}

fn measurement_of(numbers: &[f64; MEASUREMENT]) -> Measurement {
    let [time_s, fx, fy, xx, xy, yx, yy, depth, variance, dx, dy] = *numbers;
    Measurement {
        time_s,
        force: [fx, fy],
        force_covariance: [[xx, xy], [yx, yy]],
        depth,
        depth_variance: variance,
        depth_with_force: [dx, dy],
    }
}

fn numbers_of(m: &Measurement) -> [f64; MEASUREMENT] {
    let [[xx, xy], [yx, yy]] = m.force_covariance;
    let ([fx, fy], [dx, dy]) = (m.force, m.depth_with_force);
    let (depth, variance) = (m.depth, m.depth_variance);
    [m.time_s, fx, fy, xx, xy, yx, yy, depth, variance, dx, dy]
}

/// A calibrated tool: nine wavelengths in, moments, force and depth with their uncertainty out.
#[pyclass(frozen, module = "sherkit._core")]
pub struct ToolSensor(Sensor, Option<Rod>);

impl ToolSensor {
    /// A measurement of a reading; of a rod that bends as an elastica, where one is given.
    fn measured(&self, time_s: f64, reading: &Reading) -> Measurement {
        let c = &reading.force_covariance;
        let (depth, depth_variance, with) = match reading.depth {
            Depth::Measured {
                mm,
                variance,
                with_force,
            } => (mm, variance, [with_force.x, with_force.y]),
            Depth::NoForce => (0.0, f64::INFINITY, [0.0; 2]),
        };
        let mut m = Measurement {
            time_s,
            force: [reading.force.x, reading.force.y],
            force_covariance: [[c.m11, c.m12], [c.m21, c.m22]],
            depth,
            depth_variance,
            depth_with_force: with,
        };
        let size = reading.force.norm();
        if let (Some(rod), true) = (self.1, m.depth_variance.is_finite() && size > 0.0) {
            let (force, depth) = rod.exactly(size, m.depth, self.0.calibration().distances_mm);
            m.force = m.force.map(|f| f * (force / size));
            m.depth = depth;
        }
        m
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
    #[pyo3(signature = (gains, distances_mm, reference_nm, noise_nm, beam=None))]
    fn new(
        gains: PyReadonlyArray3<'_, f64>,
        distances_mm: PyReadonlyArray1<'_, f64>,
        reference_nm: PyReadonlyArray1<'_, f64>,
        noise_nm: f64,
        beam: Option<&ToolBeam>,
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
        .map(|sensor| Self(sensor, beam.map(ToolBeam::rod)))
        .map_err(to_python)
    }

    /// A measurement `(11,)` at a time from wavelengths `(9,)`.
    fn measure<'py>(
        &self,
        py: Python<'py>,
        time_s: f64,
        wavelengths_nm: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let row = fixed("wavelengths_nm", &wavelengths_nm)?;
        let reading = self.0.read(&sections(&row)).map_err(to_python)?;
        let measured = self.measured(time_s, &reading);
        Ok(PyArray1::from_slice(py, &numbers_of(&measured)))
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
                measured[i * MEASUREMENT..][..MEASUREMENT].copy_from_slice(&numbers_of(&m));
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

    /// Depth as Eq. 2 is printed, from the lengths of the moments at sections I and II `(n, 2)`, mm. It is not finite
    /// where the force is zero or a wavelength is not finite.
    fn depth_by_lengths_batch<'py>(
        &self,
        py: Python<'py>,
        wavelengths_nm: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let w = rows::<WAVELENGTHS, _>("wavelengths_nm", &wavelengths_nm)?.to_vec();
        let depth = |reading: Reading| self.0.depth_by_lengths(&reading);
        let of = |row| self.0.read(&sections(row)).map_or([f64::NAN; 2], depth);
        let out: Vec<f64> = py.detach(|| w.iter().flat_map(of).collect());
        shaped(py, out, [w.len(), 2])
    }
}

/// The shaft as a cantilever.
#[pyclass(frozen, module = "sherkit._core")]
pub struct ToolBeam(Rod);

impl ToolBeam {
    /// The core's beam.
    pub fn beam(&self) -> Beam {
        self.0.beam
    }

    /// The core's rod.
    pub fn rod(&self) -> Rod {
        self.0
    }
}

#[pymethods]
impl ToolBeam {
    /// Free length (mm), bending stiffness `EI` (mN·mm²), and whether it bends as an elastica: `tip_batch`, `loads_batch`
    /// and what is made of it do, all else is the paper's cantilever.
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

    #[staticmethod]
    fn ebrahimi_2020() -> Self {
        let (beam, bending) = (Beam::ebrahimi_2020(), Bending::Small);
        Self(Rod { beam, bending })
    }

    #[getter]
    fn exact(&self) -> bool {
        self.0.bending == Bending::Exact
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

    #[getter]
    fn length_mm(&self) -> f64 {
        self.0.beam.length_mm()
    }

    #[getter]
    fn stiffness(&self) -> f64 {
        self.0.beam.stiffness()
    }

    /// Tip deflection per force (mm/mN) at depths `(n,)`, and its derivatives by depth, length and stiffness `(n, 4)`.
    fn compliance_batch<'py>(
        &self,
        py: Python<'py>,
        depths_mm: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let depths = depths_mm.as_slice()?.to_vec();
        let of = |d: &f64| {
            let c = self.0.beam.compliance(*d);
            [c.value, c.by_depth, c.by_length, c.by_stiffness]
        };
        let out: Vec<f64> = py.detach(|| depths.iter().flat_map(of).collect());
        shaped(py, out, [depths.len(), 4])
    }

    /// Deflection at the contact itself per force `(n,)`, mm/mN.
    fn contact_compliance_batch<'py>(
        &self,
        py: Python<'py>,
        depths_mm: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let depths = depths_mm.as_slice()?.to_vec();
        let of = |d: &f64| self.0.beam.contact_compliance(*d);
        let out = py.detach(|| depths.iter().map(of).collect());
        Ok(PyArray1::from_vec(py, out))
    }

    /// Tip deflection `(n, 3)` in the tool frame for forces `(n, 2)` at depths `(n,)`, mm, and its derivatives
    /// `(n, 2, 5)`: by the force's x and y, depth, length, stiffness.
    fn deflection_batch<'py>(
        &self,
        py: Python<'py>,
        forces_mn: PyReadonlyArray2<'_, f64>,
        depths_mm: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>)> {
        let forces = rows::<2, _>("forces_mn", &forces_mn)?.to_vec();
        let depths = same_length("depths_mm", &depths_mm, forces.len())?.to_vec();
        let n = forces.len();
        let mut out = Vec::with_capacity(n * 3);
        let mut by = Vec::with_capacity(n * 10);
        py.detach(|| {
            for (f, d) in forces.iter().zip(&depths) {
                let f = Vector2::from(*f);
                out.extend_from_slice(self.0.beam.deflection(&f, *d).as_slice());
                let derivatives = self.0.beam.deflection_derivatives(&f, *d);
                by.extend_from_slice(derivatives.transpose().as_slice());
            }
        });
        Ok((shaped(py, out, [n, 3])?, shaped(py, by, [n, 2, 5])?))
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

    /// Covariance of the deflection's x and y `(n, 2, 2)`, mm², that follows from measurements `(n, 11)`.
    fn covariance_batch<'py>(
        &self,
        py: Python<'py>,
        measurements: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let measured = rows::<MEASUREMENT, _>("measurements", &measurements)?.to_vec();
        let mut out = Vec::with_capacity(measured.len() * 4);
        py.detach(|| {
            for m in measured.iter().map(measurement_of) {
                let [[xx, xy], [yx, yy]] = m.force_covariance;
                let p = self.0.beam.deflection_covariance(
                    &Vector2::from(m.force),
                    m.depth,
                    &Matrix2::new(xx, xy, yx, yy),
                    m.depth_variance,
                    &Vector2::from(m.depth_with_force),
                );
                out.extend_from_slice(p.transpose().as_slice());
            }
        });
        shaped(py, out, [measured.len(), 2, 2])
    }
}
