//! `ToolFilter` and `PaperFilter`: wavelengths and poses to depth and tip, in a loop or over a recorded run, with the same
//! bits.

use crate::arrays::{fixed, rows, rows_like, same_length, shaped};
use crate::errors::{shape, to_python};
use crate::tool::{POSE, ToolSensor, WAVELENGTHS, pose_of, sections};
use nalgebra::{Matrix2, Matrix3, Vector2};
use numpy::{
    PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sherkit_core::numbers::rigid::Rigid;
use sherkit_core::tool::filter::{
    Consistency, Counts, Doubt, LEARNT, Look, Shifts, Status, Told, ToolFilter as CoreTool, Trusted,
};
use sherkit_core::tool::paper::{PaperFilter as CorePaper, PaperNoise};

type Numbers<'py> = PyReadonlyArray1<'py, f64>;

/// What both filters do.
trait Stepped: Copy + Send {
    fn advance(&mut self, time_s: f64, pose: &Rigid, reading: Option<(f64, &Shifts)>) -> Status;
    fn told(&self) -> Told;
    fn look(&self) -> Look;
    fn fared(&self) -> (&Counts, &Consistency);
    /// What was learnt ([`CoreTool::learnt`]).
    fn inner(&self) -> [f64; LEARNT];
}

impl Stepped for CoreTool {
    fn advance(&mut self, time_s: f64, pose: &Rigid, reading: Option<(f64, &Shifts)>) -> Status {
        self.step(time_s, pose, reading)
    }
    fn told(&self) -> Told {
        self.told()
    }
    fn look(&self) -> Look {
        self.look()
    }
    fn fared(&self) -> (&Counts, &Consistency) {
        (self.counts(), self.consistency())
    }
    fn inner(&self) -> [f64; LEARNT] {
        self.learnt()
    }
}

impl Stepped for CorePaper {
    fn advance(&mut self, time_s: f64, pose: &Rigid, reading: Option<(f64, &Shifts)>) -> Status {
        self.step(time_s, pose, reading.map(|(_, w)| w))
    }
    fn told(&self) -> Told {
        self.told()
    }
    fn look(&self) -> Look {
        Look::default()
    }
    fn fared(&self) -> (&Counts, &Consistency) {
        (self.counts(), self.consistency())
    }
    fn inner(&self) -> [f64; LEARNT] {
        [0.0; LEARNT]
    }
}

/// A recorded run, as Python gives it.
struct Recorded<'a> {
    times_s: Numbers<'a>,
    poses: PyReadonlyArray2<'a, f64>,
    stamps_s: Numbers<'a>,
    wavelengths_nm: PyReadonlyArray2<'a, f64>,
    present: PyReadonlyArray1<'a, bool>,
}

fn run<'py, F: Stepped>(
    py: Python<'py>,
    filter: &mut F,
    r: &Recorded<'_>,
) -> PyResult<Bound<'py, PyDict>> {
    let times = r.times_s.as_slice()?.to_vec();
    let n = times.len();
    let poses = rows_like::<POSE>("poses", &r.poses, n)?.to_vec();
    let stamps = same_length("stamps_s", &r.stamps_s, n)?.to_vec();
    let waves = rows::<WAVELENGTHS, _>("wavelengths_nm", &r.wavelengths_nm)?.to_vec();
    if waves.len() != n {
        return Err(shape(
            "wavelengths_nm",
            "a row for each time",
            r.wavelengths_nm.shape(),
        ));
    }
    let present = same_length("present", &r.present, n)?.to_vec();
    let (mut state, mut covariance) = (Vec::with_capacity(4 * n), Vec::with_capacity(16 * n));
    let (mut force, mut inner) = (Vec::with_capacity(2 * n), Vec::with_capacity(LEARNT * n));
    let mut columns: [Vec<f64>; 4] = core::array::from_fn(|_| Vec::with_capacity(n));
    let (mut status, mut degrees, mut faulty) = (vec![], vec![], vec![]);
    py.detach(|| {
        for i in 0..n {
            let w = sections(&waves[i]);
            let reading = present[i].then_some((stamps[i], &w));
            let done = filter.advance(times[i], &pose_of(&poses[i]), reading);
            let told = filter.told();
            state.push(told.depth_mm);
            state.extend_from_slice(&told.tip_mm);
            covariance.extend_from_slice(told.covariance.as_flattened());
            force.extend_from_slice(&told.force_mn);
            inner.extend_from_slice(&filter.inner());
            let (look, (_, nis)) = (filter.look(), filter.fared());
            let row = [told.arc_mm, told.force_variance, look.misfit, nis.last];
            for (column, x) in columns.iter_mut().zip(row) {
                column.push(x);
            }
            degrees.push(u8::try_from(nis.last_degrees).unwrap_or(u8::MAX));
            faulty.push(look.faulty);
            status.push(done.0);
        }
    });
    let out = PyDict::new(py);
    let covariance: Bound<'py, PyArray3<f64>> = shaped(py, covariance, [n, 4, 4])?;
    out.set_item("covariance", covariance)?;
    for (name, data, width) in [
        ("state", state, 4),
        ("force_mn", force, 2),
        ("inner", inner, LEARNT),
    ] {
        out.set_item::<_, Bound<'py, PyArray2<f64>>>(name, shaped(py, data, [n, width])?)?;
    }
    let names = ["arc_mm", "force_variance", "misfit", "nis"];
    for (name, column) in names.iter().zip(columns) {
        out.set_item(name, PyArray1::from_vec(py, column))?;
    }
    out.set_item("degrees", PyArray1::from_vec(py, degrees))?;
    out.set_item("faulty", PyArray1::from_vec(py, faulty))?;
    out.set_item("status", PyArray1::from_vec(py, status))?;
    Ok(out)
}

/// How often what happened, and the innovation statistics.
fn statistics<'py>(
    py: Python<'py>,
    (counts, nis): (&Counts, &Consistency),
) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    for (name, count) in [
        ("steps", counts.steps),
        ("updated", counts.updated),
        ("missing", counts.missing),
        ("late", counts.late),
        ("not_finite", counts.not_finite),
        ("no_force", counts.no_force),
        ("no_motion", counts.no_motion),
        ("clock", counts.clock),
        ("gated", counts.gated),
        ("nis_count", nis.count),
        ("nis_degrees", nis.degrees),
        ("nis_last_degrees", nis.last_degrees),
    ] {
        out.set_item(name, count)?;
    }
    out.set_item("nis_sum", nis.sum)?;
    out.set_item("nis_last", nis.last)?;
    out.set_item("nis_ratio", nis.ratio())?;
    Ok(out)
}

/// A filter of the core as a class: what both have, and what is a filter's own.
macro_rules! filter_class {
    ($(#[$about:meta])* $class:ident($core:ident); $($own:tt)*) => {
        $(#[$about])*
        #[pyclass(module = "sherkit._core")]
        pub struct $class($core);

        #[pymethods]
        #[allow(clippy::too_many_arguments, reason = "a tool has that many numbers")]
        impl $class {
            $($own)*

            /// One step to a time and a pose `(12,)`; where there is a reading, its stamp (s) and wavelengths `(9,)`. The
            /// status is a sum of the module's `STATUS_…` flags.
            #[pyo3(signature = (time_s, pose, stamp_s=None, wavelengths_nm=None))]
            fn step(
                &mut self,
                time_s: f64,
                pose: Numbers<'_>,
                stamp_s: Option<f64>,
                wavelengths_nm: Option<Numbers<'_>>,
            ) -> PyResult<u8> {
                let pose = pose_of(&fixed("pose", &pose)?);
                let row = wavelengths_nm
                    .map(|w| Ok::<_, PyErr>(sections(&fixed("wavelengths_nm", &w)?)))
                    .transpose()?;
                let reading = row.as_ref().map(|w| (stamp_s.unwrap_or(time_s), w));
                Ok(self.0.advance(time_s, &pose, reading).0)
            }

            /// As many steps as there are times `(n,)`, at poses `(n, 12)`, with wavelengths `(n, 9)` of stamps `(n,)`
            /// where `present` `(n,)`. By name: `state` (depth, tip) `(n, 4)`, `covariance` `(n, 4, 4)`, `force_mn`
            /// `(n, 2)`, `inner` `(n, 13)`, and `(n,)` `arc_mm`, `force_variance`, `misfit`, `nis`, `degrees`, `faulty`
            /// (a bit for each grating), `status`.
            fn run<'py>(
                &mut self,
                py: Python<'py>,
                times_s: Numbers<'_>,
                poses: PyReadonlyArray2<'_, f64>,
                stamps_s: Numbers<'_>,
                wavelengths_nm: PyReadonlyArray2<'_, f64>,
                present: PyReadonlyArray1<'_, bool>,
            ) -> PyResult<Bound<'py, PyDict>> {
                run(py, &mut self.0, &Recorded { times_s, poses, stamps_s, wavelengths_nm, present })
            }

            #[getter]
            fn depth_mm(&self) -> f64 {
                self.0.told().depth_mm
            }

            #[getter]
            fn arc_mm(&self) -> f64 {
                self.0.told().arc_mm
            }

            #[getter]
            fn tip_mm<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
                PyArray1::from_slice(py, &self.0.told().tip_mm)
            }

            /// Of the hole across the shaft, tool frame `(2,)`.
            #[getter]
            fn force_mn<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
                PyArray1::from_slice(py, &self.0.told().force_mn)
            }

            /// Of each of its components, mN².
            #[getter]
            fn force_variance(&self) -> f64 {
                self.0.told().force_variance
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
                self.0.told().time_s
            }

            /// How often what happened, and the innovation statistics of the depth.
            fn statistics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
                statistics(py, self.0.fared())
            }

            fn copy(&self) -> Self {
                Self(self.0)
            }
        }
    };
}

filter_class! {
    /// Depth and tip from wavelengths and poses, by the rod, its pivot and its gratings.
    ToolFilter(CoreTool);

    /// `means_nm` `(2, 2)`: what the mean of a section's fibres answers to a moment, nm per mN·mm; `warmth` `(2, 3)`: how
    /// much more than its section's mean each fibre answers to it. `doubts`: deviations of all depths alike (mm), of the
    /// gratings' turn (rad), of a force (relative), of a reference (nm), of `means_nm` (over a fibre's answer), of the fibres'
    /// answers to warmth among each other and of `warmth`, of the clearance (mm); `depth_covariance` `(3, 3)` of what the
    /// depth is off, `θ₀ + θ₁ d/10 + θ₂ (d/10)²`; `beam_covariance` `(2, 2)` of length and stiffness; `start`: depth (mm), its
    /// variance (mm²), time (s).
    #[new]
    fn new(
        sensor: &ToolSensor,
        means_nm: PyReadonlyArray2<'_, f64>,
        warmth: PyReadonlyArray2<'_, f64>,
        depth_covariance: PyReadonlyArray2<'_, f64>,
        beam_covariance: PyReadonlyArray2<'_, f64>,
        doubts: [f64; 8],
        clearance_mm: f64,
        per_second_mm2: f64,
        start: [f64; 3],
        pose: Numbers<'_>,
    ) -> PyResult<Self> {
        if warmth.shape() != [2, 3] {
            return Err(shape("warmth", "(2, 3)", warmth.shape()));
        }
        let [a, b, c, d, e, f] = fixed::<6, _>("warmth", &warmth)?;
        let [p, q, r, s] = fixed::<4, _>("means_nm", &means_nm)?;
        let [deeper_mm, turn_rad, force, reference_nm, mean, unlike, of_warmth, of_clearance] = doubts;
        let (calibration, rod) = sensor.parts();
        let trusted = Trusted {
            calibration: *calibration,
            means: [Vector2::new(p, q), Vector2::new(r, s)],
            warmth: [[a, b, c], [d, e, f]],
            rod,
            doubt: Doubt {
                depth: Matrix3::from_row_slice(&fixed::<9, _>("depth_covariance", &depth_covariance)?),
                deeper_mm,
                turn_rad,
                force,
                beam: Matrix2::from_row_slice(&fixed::<4, _>("beam_covariance", &beam_covariance)?),
                reference_nm,
                mean,
                unlike,
                warmth: of_warmth,
                clearance_mm: of_clearance,
            },
            clearance_mm,
            per_second_mm2,
        };
        let [depth, variance, time_s] = start;
        let pose = pose_of(&fixed("pose", &pose)?);
        CoreTool::new(&trusted, depth, variance, &pose, time_s)
            .map(Self)
            .map_err(to_python)
    }
}

filter_class! {
    /// The paper's two filters as they are printed (Eqs. 8 and 14), with the noise of its section VII.
    PaperFilter(CorePaper);

    /// `of_force`: the entries of the noise for the tip are variances of the force (mN²), not of the deflection (mm²).
    #[new]
    #[pyo3(signature = (sensor, start, pose, of_force=false))]
    fn new(
        sensor: &ToolSensor,
        start: [f64; 3],
        pose: Numbers<'_>,
        of_force: bool,
    ) -> PyResult<Self> {
        let (calibration, rod) = sensor.parts();
        let noise = PaperNoise { of_force, ..PaperNoise::ebrahimi_2020() };
        let [depth, variance, time_s] = start;
        let pose = pose_of(&fixed("pose", &pose)?);
        CorePaper::new(calibration, rod.beam, noise, depth, variance, &pose, time_s)
            .map(Self)
            .map_err(to_python)
    }
}

/// Names and values of the status flags.
pub const STATUS: [(&str, u8); 8] = [
    ("STATUS_UPDATED", Status::UPDATED.0),
    ("STATUS_MISSING", Status::MISSING.0),
    ("STATUS_LATE", Status::LATE.0),
    ("STATUS_NOT_FINITE", Status::NOT_FINITE.0),
    ("STATUS_NO_FORCE", Status::NO_FORCE.0),
    ("STATUS_NO_MOTION", Status::NO_MOTION.0),
    ("STATUS_CLOCK", Status::CLOCK.0),
    ("STATUS_GATED", Status::GATED.0),
];
