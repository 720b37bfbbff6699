//! `ToolFilter`: wavelengths and poses to depth and tip, in a loop or over a recorded run, with the same bits.

use crate::arrays::{fixed, rows, rows_like, same_length, shaped};
use crate::errors::{shape, to_python};
use crate::filter::statistics;
use crate::tool::{POSE, ToolBeam, WAVELENGTHS, pose_of, sections};
use nalgebra::{Matrix2, Matrix2x3, Matrix3};
use numpy::{
    PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyReadonlyArray4, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sherkit_core::tool::sensing::Calibration;
use sherkit_core::tool::tracker::{Doubt, ToolFilter as Core, Trusted};

/// Depth and tip from wavelengths and poses.
#[pyclass(module = "sherkit._core")]
pub struct ToolFilter(Core);

#[pymethods]
impl ToolFilter {
    /// `gains` `(2, 2, 3)` and their covariance by rows `(2, 2, 3, 3)`; `reference_nm` `(9,)`; `warmth`
    /// `(2, 3)`: how much more than its section's mean each fibre answers to it; `doubts`: deviations of a reference (nm),
    /// of the fibres' answers to warmth among each other and of `warmth`, of the clearance (mm), of the sections' distance
    /// (mm);    /// `beam_covariance` `(2, 2)` of length and stiffness; `start`: depth (mm), its variance (mm²), time (s).
    #[new]
    #[allow(clippy::too_many_arguments, reason = "a tool has that many numbers")]
    fn new(
        gains: PyReadonlyArray3<'_, f64>,
        gain_covariance: PyReadonlyArray4<'_, f64>,
        distances_mm: PyReadonlyArray1<'_, f64>,
        reference_nm: PyReadonlyArray1<'_, f64>,
        noise_nm: f64,
        warmth: PyReadonlyArray2<'_, f64>,
        beam: &ToolBeam,
        beam_covariance: PyReadonlyArray2<'_, f64>,
        doubts: [f64; 5],
        clearance_mm: f64,
        per_second_mm2: f64,
        start: [f64; 3],
        pose: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Self> {
        if gains.shape() != [2, 2, 3] {
            return Err(shape("gains", "(2, 2, 3)", gains.shape()));
        }
        if gain_covariance.shape() != [2, 2, 3, 3] {
            return Err(shape(
                "gain_covariance",
                "(2, 2, 3, 3)",
                gain_covariance.shape(),
            ));
        }
        let k = fixed::<12, _>("gains", &gains)?;
        let spread = fixed::<36, _>("gain_covariance", &gain_covariance)?;
        let row = |i: usize| Matrix3::from_row_slice(&spread[9 * i..9 * i + 9]);
        if warmth.shape() != [2, 3] {
            return Err(shape("warmth", "(2, 3)", warmth.shape()));
        }
        let [a, b, c, d, e, f] = fixed::<6, _>("warmth", &warmth)?;
        let [reference, unlike, of_warmth, clearance, distance] = doubts;
        let trusted = Trusted {
            calibration: Calibration {
                gains: [
                    Matrix2x3::from_row_slice(&k[..6]),
                    Matrix2x3::from_row_slice(&k[6..]),
                ],
                distances_mm: fixed("distances_mm", &distances_mm)?,
                reference_nm: sections(&fixed("reference_nm", &reference_nm)?),
                noise_nm,
            },
            warmth: [[a, b, c], [d, e, f]],
            rod: beam.rod(),
            doubt: Doubt {
                gains: [[row(0), row(1)], [row(2), row(3)]],
                reference_nm: reference,
                unlike,
                warmth: of_warmth,
                beam: Matrix2::from_row_slice(&fixed::<4, _>("beam_covariance", &beam_covariance)?),
                clearance_mm: clearance,
                distance_mm: distance,
            },
            clearance_mm,
            per_second_mm2,
        };
        let [depth, variance, time_s] = start;
        let pose = pose_of(&fixed("pose", &pose)?);
        Core::new(&trusted, depth, variance, &pose, time_s)
            .map(Self)
            .map_err(to_python)
    }

    /// One step to a time and a pose `(12,)`; where there is a reading, its stamp (s) and wavelengths `(9,)`. The status
    /// is a sum of the module's `STATUS_…` flags.
    #[pyo3(signature = (time_s, pose, stamp_s=None, wavelengths_nm=None))]
    fn step(
        &mut self,
        time_s: f64,
        pose: PyReadonlyArray1<'_, f64>,
        stamp_s: Option<f64>,
        wavelengths_nm: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<u8> {
        let pose = pose_of(&fixed("pose", &pose)?);
        let row = wavelengths_nm
            .map(|w| Ok::<_, PyErr>(sections(&fixed("wavelengths_nm", &w)?)))
            .transpose()?;
        let reading = row.as_ref().map(|w| (stamp_s.unwrap_or(time_s), w));
        Ok(self.0.step(time_s, &pose, reading).0)
    }

    /// As many steps as there are times `(n,)`, at poses `(n, 12)`, with wavelengths `(n, 9)` of stamps `(n,)` where
    /// `present` `(n,)`. By name: `state` (depth, tip) `(n, 4)`, `covariance` `(n, 4, 4)`, `force_mn` `(n, 2)`,
    /// `force_variance`, `misfit`, `nis`, `degrees`, `per_second_mm2`, `faulty` (a bit for each grating), `status` `(n,)`,
    /// and for smoothing `noise` (variance) `(n,)` and `tied` `(n, k)`.
    fn run<'py>(
        &mut self,
        py: Python<'py>,
        times_s: PyReadonlyArray1<'_, f64>,
        poses: PyReadonlyArray2<'_, f64>,
        stamps_s: PyReadonlyArray1<'_, f64>,
        wavelengths_nm: PyReadonlyArray2<'_, f64>,
        present: PyReadonlyArray1<'_, bool>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let times = times_s.as_slice()?.to_vec();
        let n = times.len();
        let poses = rows_like::<POSE>("poses", &poses, n)?.to_vec();
        let stamps = same_length("stamps_s", &stamps_s, n)?.to_vec();
        let waves = rows::<WAVELENGTHS, _>("wavelengths_nm", &wavelengths_nm)?.to_vec();
        if waves.len() != n {
            return Err(shape(
                "wavelengths_nm",
                "a row for each time",
                wavelengths_nm.shape(),
            ));
        }
        let present = same_length("present", &present, n)?.to_vec();
        let mut state = Vec::with_capacity(4 * n);
        let mut covariance = Vec::with_capacity(16 * n);
        let mut force = Vec::with_capacity(2 * n);
        let mut columns: [Vec<f64>; 6] = core::array::from_fn(|_| Vec::with_capacity(n));
        let (mut status, mut degrees, mut faulty) = (vec![], vec![], vec![]);
        let width = self.0.told_tied().1.len();
        let mut tied = Vec::with_capacity(width * n);
        py.detach(|| {
            for i in 0..n {
                let w = sections(&waves[i]);
                let reading = present[i].then_some((stamps[i], &w));
                let done = self.0.step(times[i], &pose_of(&poses[i]), reading);
                let told = self.0.told();
                state.push(told.depth_mm);
                state.extend_from_slice(&told.tip_mm);
                covariance.extend_from_slice(told.covariance.as_flattened());
                force.extend_from_slice(&told.force_mn);
                let (look, nis) = (self.0.look(), self.0.consistency());
                let (noise, of) = self.0.told_tied();
                tied.extend_from_slice(&of);
                let row = [
                    told.force_variance,
                    look.misfit,
                    nis.last,
                    self.0.per_second_mm2(),
                    noise,
                    self.0.pace(),
                ];
                for (column, x) in columns.iter_mut().zip(row) {
                    column.push(x);
                }
                degrees.push(u8::try_from(nis.last_degrees).unwrap_or(u8::MAX));
                faulty.push(look.faulty);
                status.push(done.0);
            }
        });
        let out = PyDict::new(py);
        out.set_item("state", shaped(py, state, [n, 4])?)?;
        out.set_item::<_, Bound<'py, PyArray3<f64>>>(
            "covariance",
            shaped(py, covariance, [n, 4, 4])?,
        )?;
        out.set_item::<_, Bound<'py, PyArray2<f64>>>("force_mn", shaped(py, force, [n, 2])?)?;
        out.set_item::<_, Bound<'py, PyArray2<f64>>>("tied", shaped(py, tied, [n, width])?)?;
        let names = [
            "force_variance",
            "misfit",
            "nis",
            "per_second_mm2",
            "noise",
            "pace",
        ];
        for (name, column) in names.iter().zip(columns) {
            out.set_item(name, PyArray1::from_vec(py, column))?;
        }
        out.set_item("degrees", PyArray1::from_vec(py, degrees))?;
        out.set_item("faulty", PyArray1::from_vec(py, faulty))?;
        out.set_item("status", PyArray1::from_vec(py, status))?;
        Ok(out)
    }

    #[getter]
    fn depth_mm(&self) -> f64 {
        self.0.told().depth_mm
    }

    #[getter]
    fn tip_mm<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.0.told().tip_mm)
    }

    /// Of depth and tip `(4, 4)`, mm².
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        shaped(py, self.0.told().covariance.as_flattened().to_vec(), [4, 4])
    }

    #[getter]
    fn misfit(&self) -> f64 {
        self.0.look().misfit
    }

    /// A bit for each grating that was not believed in the last reading.
    #[getter]
    fn faulty(&self) -> u16 {
        self.0.look().faulty
    }

    #[getter]
    fn time_s(&self) -> f64 {
        self.0.time_s()
    }

    /// The same tool from another `start` (depth, variance, time) and pose, with what was learnt of how the eye moves.
    fn anew(&self, start: [f64; 3], pose: PyReadonlyArray1<'_, f64>) -> PyResult<Self> {
        let [depth, variance, time_s] = start;
        let pose = pose_of(&fixed("pose", &pose)?);
        self.0
            .anew(depth, variance, &pose, time_s)
            .map(Self)
            .map_err(to_python)
    }

    /// How often what happened, and the innovation statistics of the depth.
    fn statistics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        statistics(py, self.0.counts(), self.0.consistency())
    }

    fn copy(&self) -> Self {
        Self(self.0)
    }
}
