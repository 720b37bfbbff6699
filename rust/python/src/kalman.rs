//! `DepthFilter`, `TipFilter` and `DepthTipFilter`: one step in a loop, or a whole recorded run at once. Both run the
//! same steps of the core, and agree to the last bit.

use crate::arrays::{fixed, rows_like, same_length, shaped};
use crate::errors::to_python;
use crate::noise::FilterNoise;
use crate::tool::{MEASUREMENT, POSE, ToolBeam, measurement_of, pose_of};
use core::ops::Range;
use nalgebra::Vector3;
use numpy::{
    PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sherkit_core::kalman::track::Track;
use sherkit_core::kalman::{
    DepthFilter as CoreDepth, DepthTipFilter as CoreJoint, Estimate, Measurement, Record, Status,
    TipFilter as CoreTip, smooth,
};
use sherkit_core::rigid::Rigid;

/// A filter with what it is given at a step.
trait Stepped<const N: usize>: Copy + Send {
    /// Beside the measurement.
    type Input: Copy + Send + Sync;
    fn advance(&mut self, input: &Self::Input, measurement: Option<&Measurement>) -> Status;
    fn state(&self) -> &Track<N>;
}

impl Stepped<1> for CoreDepth {
    type Input = (f64, f64);
    fn advance(&mut self, input: &Self::Input, measurement: Option<&Measurement>) -> Status {
        self.step(input.0, input.1, measurement)
    }
    fn state(&self) -> &Track<1> {
        self.track()
    }
}

impl Stepped<3> for CoreTip {
    type Input = (f64, Vector3<f64>, Rigid, (f64, f64));
    fn advance(&mut self, input: &Self::Input, measurement: Option<&Measurement>) -> Status {
        let (time_s, velocity, tool, depth) = input;
        self.step(*time_s, velocity, tool, *depth, measurement)
    }
    fn state(&self) -> &Track<3> {
        self.track()
    }
}

impl Stepped<4> for CoreJoint {
    type Input = (f64, Vector3<f64>, Rigid);
    fn advance(&mut self, input: &Self::Input, measurement: Option<&Measurement>) -> Status {
        let (time_s, velocity, tool) = input;
        self.step(*time_s, velocity, tool, measurement)
    }
    fn state(&self) -> &Track<4> {
        self.track()
    }
}

/// Steps that are copied at a time; they stay in the second cache.
const CHUNK: usize = 256;

/// Some steps of a run, copied, so that nobody else can write them while the lock is not held.
type Steps<I> = Vec<(I, Option<Measurement>)>;

fn fill<I>(
    steps: &mut Steps<I>,
    range: Range<usize>,
    count: usize,
    measurements: &PyReadonlyArray2<'_, f64>,
    present: Option<&PyReadonlyArray1<'_, bool>>,
    input: impl Fn(usize) -> I,
) -> PyResult<()> {
    let measured = rows_like::<MEASUREMENT>("measurements", measurements, count)?;
    let present = present
        .map(|p| same_length("present", p, count))
        .transpose()?;
    let measurement = |i: usize| {
        let there = present.is_none_or(|p| p[i]);
        there.then(|| measurement_of(&measured[i]))
    };
    steps.clear();
    steps.extend(range.map(|i| (input(i), measurement(i))));
    Ok(())
}

/// Runs a filter over all steps, chunk by chunk; the lock is held while a chunk is copied. Says after each step where
/// the filter is.
fn over<const N: usize, F: Stepped<N>>(
    py: Python<'_>,
    filter: &mut F,
    count: usize,
    copy: impl Fn(&mut Steps<F::Input>, Range<usize>) -> PyResult<()>,
    mut after: impl FnMut(Status, &Track<N>) + Send,
) -> PyResult<()> {
    let mut steps = Vec::with_capacity(CHUNK.min(count));
    // shapes are checked before the first step, also where there is none
    copy(&mut steps, 0..0)?;
    for start in (0..count).step_by(CHUNK) {
        copy(&mut steps, start..count.min(start + CHUNK))?;
        py.detach(|| {
            for (input, measurement) in &steps {
                let status = filter.advance(input, measurement.as_ref());
                after(status, filter.state());
            }
        });
    }
    Ok(())
}

/// Estimates `(n, N)`, covariances `(n, N, N)`, status `(n,)`, NIS `(n,)`, its degrees of freedom `(n,)`.
type Run<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<u8>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<u8>>,
);

fn run<'py, const N: usize, F: Stepped<N>>(
    py: Python<'py>,
    filter: &mut F,
    n: usize,
    copy: impl Fn(&mut Steps<F::Input>, Range<usize>) -> PyResult<()>,
) -> PyResult<Run<'py>> {
    // filled as they come: memory that is zeroed first is written twice
    let (mut means, mut covariances) = (Vec::with_capacity(n * N), Vec::with_capacity(n * N * N));
    let mut status = Vec::with_capacity(n);
    let (mut nis, mut degrees) = (Vec::with_capacity(n), Vec::with_capacity(n));
    over(py, filter, n, copy, |done, state| {
        status.push(done.0);
        means.extend_from_slice(&state.filter().mean);
        covariances.extend_from_slice(state.filter().covariance().as_flattened());
        nis.push(state.consistency().last);
        // at most as many as a measurement has numbers
        degrees.push(u8::try_from(state.consistency().last_degrees).unwrap_or(u8::MAX));
    })?;
    Ok((
        shaped(py, means, [n, N])?,
        shaped(py, covariances, [n, N, N])?,
        PyArray1::from_vec(py, status),
        PyArray1::from_vec(py, nis),
        PyArray1::from_vec(py, degrees),
    ))
}

/// Estimates `(n, N)` and covariances `(n, N, N)`.
type Smoothed<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>);

/// The run from the filter's state, which stays as it is, and back.
fn back<const N: usize, F: Stepped<N>>(
    py: Python<'_>,
    mut filter: F,
    n: usize,
    copy: impl Fn(&mut Steps<F::Input>, Range<usize>) -> PyResult<()>,
) -> PyResult<Smoothed<'_>> {
    let (mut means, mut covariances) = (vec![0.0; n * N], vec![0.0; n * N * N]);
    let mut records: Vec<Record<N>> = Vec::with_capacity(n);
    over(py, &mut filter, n, copy, |_, state| {
        records.push(*state.record());
    })?;
    py.detach(|| {
        let mut unmoved = [[0.0; N]; N];
        for k in 0..N {
            unmoved[k][k] = 1.0;
        }
        let empty = Estimate {
            mean: [0.0; N],
            covariance: [[0.0; N]; N],
        };
        let mut smoothed = vec![empty; n];
        smooth(&unmoved, &records, &mut smoothed)?;
        for (i, estimate) in smoothed.iter().enumerate() {
            means[i * N..][..N].copy_from_slice(&estimate.mean);
            let covariance = estimate.covariance.as_flattened();
            covariances[i * N * N..][..N * N].copy_from_slice(covariance);
        }
        Ok(())
    })
    .map_err(to_python)?;
    Ok((
        shaped(py, means, [n, N])?,
        shaped(py, covariances, [n, N, N])?,
    ))
}

/// A measurement that may be missing.
type Given<'py> = Option<PyReadonlyArray1<'py, f64>>;

fn given(measurement: Option<&PyReadonlyArray1<'_, f64>>) -> PyResult<Option<Measurement>> {
    measurement
        .map(|m| Ok(measurement_of(&fixed("measurement", m)?)))
        .transpose()
}

fn covariance<'py, const N: usize>(
    py: Python<'py>,
    state: &Track<N>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let p = state.filter().covariance();
    shaped(py, p.as_flattened().to_vec(), [N, N])
}

/// How often what happened, and the innovation statistics.
fn statistics<'py, const N: usize>(
    py: Python<'py>,
    state: &Track<N>,
) -> PyResult<Bound<'py, PyDict>> {
    let (counts, nis) = (state.counts(), state.consistency());
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

/// Insertion depth.
#[pyclass(module = "sherkit._core")]
pub struct DepthFilter(CoreDepth);

impl DepthFilter {
    fn copy_steps(
        steps: &mut Steps<(f64, f64)>,
        range: Range<usize>,
        times_s: &PyReadonlyArray1<'_, f64>,
        velocities: &PyReadonlyArray1<'_, f64>,
        measurements: &PyReadonlyArray2<'_, f64>,
        present: Option<&PyReadonlyArray1<'_, bool>>,
    ) -> PyResult<()> {
        let times = times_s.as_slice()?;
        let v = same_length("velocities_mm_s", velocities, times.len())?;
        fill(steps, range, times.len(), measurements, present, |i| {
            (times[i], v[i])
        })
    }
}

#[pymethods]
impl DepthFilter {
    #[new]
    fn new(depth_mm: f64, variance: f64, time_s: f64, noise: &FilterNoise) -> PyResult<Self> {
        CoreDepth::new(depth_mm, variance, time_s, noise.noise())
            .map(Self)
            .map_err(to_python)
    }

    /// One step; the status is a sum of the module's `STATUS_…` flags.
    #[pyo3(signature = (time_s, velocity_mm_s, measurement=None))]
    fn step(&mut self, time_s: f64, velocity_mm_s: f64, measurement: Given<'_>) -> PyResult<u8> {
        let measurement = given(measurement.as_ref())?;
        Ok(self.0.step(time_s, velocity_mm_s, measurement.as_ref()).0)
    }

    /// As many steps as there are times.
    #[pyo3(signature = (times_s, velocities_mm_s, measurements, present=None))]
    fn filter<'py>(
        &mut self,
        py: Python<'py>,
        times_s: PyReadonlyArray1<'_, f64>,
        velocities_mm_s: PyReadonlyArray1<'_, f64>,
        measurements: PyReadonlyArray2<'_, f64>,
        present: Option<PyReadonlyArray1<'_, bool>>,
    ) -> PyResult<Run<'py>> {
        let (v, m, present) = (&velocities_mm_s, &measurements, present.as_ref());
        run(py, &mut self.0, times_s.len(), |steps, range| {
            Self::copy_steps(steps, range, &times_s, v, m, present)
        })
    }

    /// The same run from the present state, which stays as it is; every estimate from all measurements.
    #[pyo3(signature = (times_s, velocities_mm_s, measurements, present=None))]
    fn smooth<'py>(
        &self,
        py: Python<'py>,
        times_s: PyReadonlyArray1<'_, f64>,
        velocities_mm_s: PyReadonlyArray1<'_, f64>,
        measurements: PyReadonlyArray2<'_, f64>,
        present: Option<PyReadonlyArray1<'_, bool>>,
    ) -> PyResult<Smoothed<'py>> {
        let (v, m, present) = (&velocities_mm_s, &measurements, present.as_ref());
        back(py, self.0, times_s.len(), |steps, range| {
            Self::copy_steps(steps, range, &times_s, v, m, present)
        })
    }

    #[getter]
    fn time_s(&self) -> f64 {
        self.0.track().time_s()
    }

    #[getter]
    fn depth_mm(&self) -> f64 {
        self.0.depth_mm()
    }

    #[getter]
    fn variance(&self) -> f64 {
        self.0.variance()
    }

    fn statistics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        statistics(py, self.0.track())
    }

    fn copy(&self) -> Self {
        Self(self.0)
    }
}

/// Position of the tip.
#[pyclass(module = "sherkit._core")]
pub struct TipFilter(CoreTip);

impl TipFilter {
    #[allow(clippy::too_many_arguments, reason = "one for each column of a run")]
    fn copy_steps(
        steps: &mut Steps<<CoreTip as Stepped<3>>::Input>,
        range: Range<usize>,
        times_s: &PyReadonlyArray1<'_, f64>,
        velocities: &PyReadonlyArray2<'_, f64>,
        poses: &PyReadonlyArray2<'_, f64>,
        depths: &PyReadonlyArray2<'_, f64>,
        measurements: &PyReadonlyArray2<'_, f64>,
        present: Option<&PyReadonlyArray1<'_, bool>>,
    ) -> PyResult<()> {
        let times = times_s.as_slice()?;
        let v = rows_like::<3>("velocities_mm_s", velocities, times.len())?;
        let poses = rows_like::<POSE>("poses", poses, times.len())?;
        let depths = rows_like::<2>("depths", depths, times.len())?;
        fill(steps, range, times.len(), measurements, present, |i| {
            let [depth, variance] = depths[i];
            let (velocity, tool) = (Vector3::from(v[i]), pose_of(&poses[i]));
            (times[i], velocity, tool, (depth, variance))
        })
    }
}

#[pymethods]
impl TipFilter {
    #[new]
    fn new(
        beam: &ToolBeam,
        pose: PyReadonlyArray1<'_, f64>,
        variance: f64,
        time_s: f64,
        noise: &FilterNoise,
    ) -> PyResult<Self> {
        let tool = pose_of(&fixed("pose", &pose)?);
        CoreTip::new(beam.beam(), &tool, variance, time_s, noise.noise())
            .map(Self)
            .map_err(to_python)
    }

    /// One step; `depth` is (mm, mm²).
    #[pyo3(signature = (time_s, velocity_mm_s, pose, depth, measurement=None))]
    fn step(
        &mut self,
        time_s: f64,
        velocity_mm_s: PyReadonlyArray1<'_, f64>,
        pose: PyReadonlyArray1<'_, f64>,
        depth: (f64, f64),
        measurement: Given<'_>,
    ) -> PyResult<u8> {
        let velocity = Vector3::from(fixed("velocity_mm_s", &velocity_mm_s)?);
        let tool = pose_of(&fixed("pose", &pose)?);
        let measurement = given(measurement.as_ref())?;
        let status = self
            .0
            .step(time_s, &velocity, &tool, depth, measurement.as_ref());
        Ok(status.0)
    }

    /// As many steps as there are times; `depths` `(n, 2)`: mm, mm².
    #[allow(clippy::too_many_arguments, reason = "one for each column of a run")]
    #[pyo3(signature = (times_s, velocities_mm_s, poses, depths, measurements, present=None))]
    fn filter<'py>(
        &mut self,
        py: Python<'py>,
        times_s: PyReadonlyArray1<'_, f64>,
        velocities_mm_s: PyReadonlyArray2<'_, f64>,
        poses: PyReadonlyArray2<'_, f64>,
        depths: PyReadonlyArray2<'_, f64>,
        measurements: PyReadonlyArray2<'_, f64>,
        present: Option<PyReadonlyArray1<'_, bool>>,
    ) -> PyResult<Run<'py>> {
        let (v, m, present) = (&velocities_mm_s, &measurements, present.as_ref());
        run(py, &mut self.0, times_s.len(), |steps, range| {
            Self::copy_steps(steps, range, &times_s, v, &poses, &depths, m, present)
        })
    }

    /// The same run from the present state, which stays as it is; every estimate from all measurements.
    #[allow(clippy::too_many_arguments, reason = "one for each column of a run")]
    #[pyo3(signature = (times_s, velocities_mm_s, poses, depths, measurements, present=None))]
    fn smooth<'py>(
        &self,
        py: Python<'py>,
        times_s: PyReadonlyArray1<'_, f64>,
        velocities_mm_s: PyReadonlyArray2<'_, f64>,
        poses: PyReadonlyArray2<'_, f64>,
        depths: PyReadonlyArray2<'_, f64>,
        measurements: PyReadonlyArray2<'_, f64>,
        present: Option<PyReadonlyArray1<'_, bool>>,
    ) -> PyResult<Smoothed<'py>> {
        let (v, m, present) = (&velocities_mm_s, &measurements, present.as_ref());
        back(py, self.0, times_s.len(), |steps, range| {
            Self::copy_steps(steps, range, &times_s, v, &poses, &depths, m, present)
        })
    }

    #[getter]
    fn time_s(&self) -> f64 {
        self.0.track().time_s()
    }

    #[getter]
    fn tip_mm<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, self.0.tip().as_slice())
    }

    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        covariance(py, self.0.track())
    }

    fn statistics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        statistics(py, self.0.track())
    }

    fn copy(&self) -> Self {
        Self(self.0)
    }
}

/// Depth and tip in one state.
#[pyclass(module = "sherkit._core")]
pub struct DepthTipFilter(CoreJoint);

impl DepthTipFilter {
    fn copy_steps(
        steps: &mut Steps<<CoreJoint as Stepped<4>>::Input>,
        range: Range<usize>,
        times_s: &PyReadonlyArray1<'_, f64>,
        velocities: &PyReadonlyArray2<'_, f64>,
        poses: &PyReadonlyArray2<'_, f64>,
        measurements: &PyReadonlyArray2<'_, f64>,
        present: Option<&PyReadonlyArray1<'_, bool>>,
    ) -> PyResult<()> {
        let times = times_s.as_slice()?;
        let v = rows_like::<3>("velocities_mm_s", velocities, times.len())?;
        let poses = rows_like::<POSE>("poses", poses, times.len())?;
        fill(steps, range, times.len(), measurements, present, |i| {
            (times[i], Vector3::from(v[i]), pose_of(&poses[i]))
        })
    }
}

#[pymethods]
impl DepthTipFilter {
    /// `variances`: of the depth and of each axis of the tip, mm².
    #[new]
    fn new(
        beam: &ToolBeam,
        depth_mm: f64,
        pose: PyReadonlyArray1<'_, f64>,
        variances: [f64; 2],
        time_s: f64,
        noise: &FilterNoise,
    ) -> PyResult<Self> {
        let tool = pose_of(&fixed("pose", &pose)?);
        let (beam, noise) = (beam.beam(), noise.noise());
        CoreJoint::new(beam, depth_mm, &tool, variances, time_s, noise)
            .map(Self)
            .map_err(to_python)
    }

    /// One step.
    #[pyo3(signature = (time_s, velocity_mm_s, pose, measurement=None))]
    fn step(
        &mut self,
        time_s: f64,
        velocity_mm_s: PyReadonlyArray1<'_, f64>,
        pose: PyReadonlyArray1<'_, f64>,
        measurement: Given<'_>,
    ) -> PyResult<u8> {
        let velocity = Vector3::from(fixed("velocity_mm_s", &velocity_mm_s)?);
        let tool = pose_of(&fixed("pose", &pose)?);
        let measurement = given(measurement.as_ref())?;
        let status = self.0.step(time_s, &velocity, &tool, measurement.as_ref());
        Ok(status.0)
    }

    /// As many steps as there are times.
    #[pyo3(signature = (times_s, velocities_mm_s, poses, measurements, present=None))]
    fn filter<'py>(
        &mut self,
        py: Python<'py>,
        times_s: PyReadonlyArray1<'_, f64>,
        velocities_mm_s: PyReadonlyArray2<'_, f64>,
        poses: PyReadonlyArray2<'_, f64>,
        measurements: PyReadonlyArray2<'_, f64>,
        present: Option<PyReadonlyArray1<'_, bool>>,
    ) -> PyResult<Run<'py>> {
        let (v, m, present) = (&velocities_mm_s, &measurements, present.as_ref());
        run(py, &mut self.0, times_s.len(), |steps, range| {
            Self::copy_steps(steps, range, &times_s, v, &poses, m, present)
        })
    }

    /// The same run from the present state, which stays as it is; every estimate from all measurements.
    #[pyo3(signature = (times_s, velocities_mm_s, poses, measurements, present=None))]
    fn smooth<'py>(
        &self,
        py: Python<'py>,
        times_s: PyReadonlyArray1<'_, f64>,
        velocities_mm_s: PyReadonlyArray2<'_, f64>,
        poses: PyReadonlyArray2<'_, f64>,
        measurements: PyReadonlyArray2<'_, f64>,
        present: Option<PyReadonlyArray1<'_, bool>>,
    ) -> PyResult<Smoothed<'py>> {
        let (v, m, present) = (&velocities_mm_s, &measurements, present.as_ref());
        back(py, self.0, times_s.len(), |steps, range| {
            Self::copy_steps(steps, range, &times_s, v, &poses, m, present)
        })
    }

    #[getter]
    fn time_s(&self) -> f64 {
        self.0.track().time_s()
    }

    #[getter]
    fn depth_mm(&self) -> f64 {
        self.0.depth_mm()
    }

    #[getter]
    fn tip_mm<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, self.0.tip().as_slice())
    }

    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        covariance(py, self.0.track())
    }

    fn statistics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        statistics(py, self.0.track())
    }

    fn copy(&self) -> Self {
        Self(self.0)
    }
}

/// Names and values of the status flags.
pub const STATUS: [(&str, u8); 7] = [
    ("STATUS_UPDATED", Status::UPDATED.0),
    ("STATUS_MISSING", Status::MISSING.0),
    ("STATUS_LATE", Status::LATE.0),
    ("STATUS_NOT_FINITE", Status::NOT_FINITE.0),
    ("STATUS_NO_FORCE", Status::NO_FORCE.0),
    ("STATUS_NO_MOTION", Status::NO_MOTION.0),
    ("STATUS_CLOCK", Status::CLOCK.0),
];
