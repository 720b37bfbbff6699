//! `DepthFilter` and `TipFilter`: one step in a loop, or a whole recorded run at once. Both run the
//! same steps of the core, and agree to the last bit.
//!
//! Bodies are generic over [`Stepped`]; the macro `filter_class!` holds what Python sees.

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
use sherkit_core::numbers::rigid::Rigid;
use sherkit_core::tool::filters::track::Track;
use sherkit_core::tool::filters::{
    Consistency, Counts, DepthFilter as CoreDepth, Measurement, Status, TipFilter as CoreTip,
};

/// A number for each step.
type Column<'py> = PyReadonlyArray1<'py, f64>;
/// A row for each step.
type Table<'py> = PyReadonlyArray2<'py, f64>;
/// The numbers of one step.
type Numbers<'py> = PyReadonlyArray1<'py, f64>;

/// A filter of the core, with what it is given at a step beside time and measurement.
trait Stepped<const N: usize>: Copy + Send {
    /// Of one step.
    type Input: Copy + Send + Sync;
    /// The arguments that hold it for one step.
    type One<'a>;
    /// The columns that hold it for every step.
    type All<'a>: Copy;
    fn advance(&mut self, time_s: f64, input: &Self::Input, m: Option<&Measurement>) -> Status;
    fn state(&self) -> &Track<N>;
    /// The input of one step.
    fn one(given: Self::One<'_>) -> PyResult<Self::Input>;
    /// The input of step `i` from columns of `n` steps.
    fn all(given: Self::All<'_>, n: usize) -> PyResult<impl Fn(usize) -> Self::Input>;
}

/// Velocity along the shaft.
impl Stepped<1> for CoreDepth {
    type Input = f64;
    type One<'a> = (f64,);
    type All<'a> = (&'a Column<'a>,);
    fn advance(&mut self, time_s: f64, velocity: &f64, m: Option<&Measurement>) -> Status {
        self.step(time_s, *velocity, m)
    }
    fn state(&self) -> &Track<1> {
        self.track()
    }
    fn one((velocity,): (f64,)) -> PyResult<f64> {
        Ok(velocity)
    }
    fn all((v,): Self::All<'_>, n: usize) -> PyResult<impl Fn(usize) -> f64> {
        let v = same_length("velocities_mm_s", v, n)?;
        Ok(|i: usize| v[i])
    }
}

/// Velocity and pose of the unbent tip, depth and its variance.
impl Stepped<3> for CoreTip {
    type Input = (Vector3<f64>, Rigid, (f64, f64));
    type One<'a> = (Numbers<'a>, Numbers<'a>, (f64, f64));
    type All<'a> = (&'a Table<'a>, &'a Table<'a>, &'a Table<'a>);
    fn advance(&mut self, time_s: f64, input: &Self::Input, m: Option<&Measurement>) -> Status {
        let (velocity, tool, depth) = input;
        self.step(time_s, velocity, tool, *depth, m)
    }
    fn state(&self) -> &Track<3> {
        self.track()
    }
    fn one((velocity, pose, depth): Self::One<'_>) -> PyResult<Self::Input> {
        let velocity = fixed("velocity_mm_s", &velocity)?;
        Ok((velocity.into(), pose_of(&fixed("pose", &pose)?), depth))
    }
    fn all((v, poses, depths): Self::All<'_>, n: usize) -> PyResult<impl Fn(usize) -> Self::Input> {
        let v = rows_like::<3>("velocities_mm_s", v, n)?;
        let poses = rows_like::<POSE>("poses", poses, n)?;
        let depths = rows_like::<2>("depths", depths, n)?;
        Ok(|i: usize| (v[i].into(), pose_of(&poses[i]), depths[i].into()))
    }
}

/// A recorded run, as Python gives it.
#[derive(Clone, Copy)]
struct Recorded<'a, A> {
    times_s: &'a Column<'a>,
    inputs: A,
    measurements: &'a Table<'a>,
    present: Option<&'a PyReadonlyArray1<'a, bool>>,
}

/// Some steps of a run, copied, so that nobody else can write them while the lock is not held.
type Steps<I> = Vec<(f64, I, Option<Measurement>)>;

fn copy<'a, const N: usize, F: Stepped<N>>(
    steps: &mut Steps<F::Input>,
    range: Range<usize>,
    run: Recorded<'a, F::All<'a>>,
) -> PyResult<()> {
    let times = run.times_s.as_slice()?;
    let input = F::all(run.inputs, times.len())?;
    let measured = rows_like::<MEASUREMENT>("measurements", run.measurements, times.len())?;
    let present = run
        .present
        .map(|p| same_length("present", p, times.len()))
        .transpose()?;
    let measurement = |i: usize| {
        let there = present.is_none_or(|p| p[i]);
        there.then(|| measurement_of(&measured[i]))
    };
    steps.clear();
    steps.extend(range.map(|i| (times[i], input(i), measurement(i))));
    Ok(())
}

/// Steps that are copied at a time; they stay in the second cache.
const CHUNK: usize = 256;

/// Runs a filter over all steps, chunk by chunk; the lock is held while a chunk is copied. Says after each step where
/// the filter is.
fn over<'a, const N: usize, F: Stepped<N>>(
    py: Python<'_>,
    filter: &mut F,
    run: Recorded<'a, F::All<'a>>,
    mut after: impl FnMut(Status, &Track<N>) + Send,
) -> PyResult<()> {
    let count = run.times_s.len();
    let mut steps = Vec::with_capacity(CHUNK.min(count));
    // shapes are checked before the first step, also where there is none
    copy::<N, F>(&mut steps, 0..0, run)?;
    for start in (0..count).step_by(CHUNK) {
        copy::<N, F>(&mut steps, start..count.min(start + CHUNK), run)?;
        py.detach(|| {
            for (time_s, input, measurement) in &steps {
                let status = filter.advance(*time_s, input, measurement.as_ref());
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

fn run<'py, 'a, const N: usize, F: Stepped<N>>(
    py: Python<'py>,
    filter: &mut F,
    recorded: Recorded<'a, F::All<'a>>,
) -> PyResult<Run<'py>> {
    let n = recorded.times_s.len();
    // filled as they come: memory that is zeroed first is written twice
    let (mut means, mut covariances) = (Vec::with_capacity(n * N), Vec::with_capacity(n * N * N));
    let mut status = Vec::with_capacity(n);
    let (mut nis, mut degrees) = (Vec::with_capacity(n), Vec::with_capacity(n));
    over(py, filter, recorded, |done, state| {
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

/// One step, with a measurement that may be missing.
fn step<const N: usize, F: Stepped<N>>(
    filter: &mut F,
    time_s: f64,
    input: F::One<'_>,
    measurement: Option<&Numbers<'_>>,
) -> PyResult<u8> {
    let input = F::one(input)?;
    let measurement = measurement
        .map(|m| Ok::<_, PyErr>(measurement_of(&fixed("measurement", m)?)))
        .transpose()?;
    Ok(filter.advance(time_s, &input, measurement.as_ref()).0)
}

fn covariance<'py, const N: usize>(
    py: Python<'py>,
    state: &Track<N>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let p = state.filter().covariance();
    shaped(py, p.as_flattened().to_vec(), [N, N])
}

/// How often what happened, and the innovation statistics.
pub fn statistics<'py>(
    py: Python<'py>,
    counts: &Counts,
    nis: &Consistency,
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

/// A filter of the core as a class: `step` with what it takes for one step, `filter` with the columns of a run, and what is the filter's own.
macro_rules! filter_class {
    (
        $(#[$about:meta])*
        $class:ident($core:ident);
        step($($value:ident: $one:ty),+);
        run($($column:ident: $all:ident),+);
        $($own:tt)*
    ) => {
        $(#[$about])*
        #[pyclass(module = "sherkit._core")]
        pub struct $class($core);

        #[pymethods]
        #[allow(clippy::too_many_arguments, reason = "one for each column of a run")]
        impl $class {
            $($own)*

            /// One step; the status is a sum of the module's `STATUS_…` flags.
            #[pyo3(signature = (time_s, $($value,)+ measurement=None))]
            fn step(
                &mut self,
                time_s: f64,
                $($value: $one,)+
                measurement: Option<Numbers<'_>>,
            ) -> PyResult<u8> {
                step(&mut self.0, time_s, ($($value,)+), measurement.as_ref())
            }

            /// As many steps as there are times.
            #[pyo3(signature = (times_s, $($column,)+ measurements, present=None))]
            fn filter<'py>(
                &mut self,
                py: Python<'py>,
                times_s: Column<'_>,
                $($column: $all<'_>,)+
                measurements: Table<'_>,
                present: Option<PyReadonlyArray1<'_, bool>>,
            ) -> PyResult<Run<'py>> {
                let (times_s, inputs, measurements) = (&times_s, ($(&$column,)+), &measurements);
                let present = present.as_ref();
                run(py, &mut self.0, Recorded { times_s, inputs, measurements, present })
            }

            #[getter]
            fn time_s(&self) -> f64 {
                self.0.track().time_s()
            }

            fn statistics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
                let track = self.0.track();
                statistics(py, track.counts(), track.consistency())
            }

            fn copy(&self) -> Self {
                Self(self.0)
            }
        }
    };
}

filter_class! {
    /// Insertion depth.
    DepthFilter(CoreDepth);
    step(velocity_mm_s: f64);
    run(velocities_mm_s: Column);

    #[new]
    fn new(depth_mm: f64, variance: f64, time_s: f64, noise: &FilterNoise) -> PyResult<Self> {
        CoreDepth::new(depth_mm, variance, time_s, noise.noise())
            .map(Self)
            .map_err(to_python)
    }

    #[getter]
    fn depth_mm(&self) -> f64 {
        self.0.depth_mm()
    }

    #[getter]
    fn variance(&self) -> f64 {
        self.0.variance()
    }
}

filter_class! {
    /// Position of the tip.
    TipFilter(CoreTip);
    step(velocity_mm_s: Numbers<'_>, pose: Numbers<'_>, depth: (f64, f64));
    run(velocities_mm_s: Table, poses: Table, depths: Table);

    #[new]
    fn new(
        beam: &ToolBeam,
        pose: Numbers<'_>,
        variance: f64,
        time_s: f64,
        noise: &FilterNoise,
    ) -> PyResult<Self> {
        let tool = pose_of(&fixed("pose", &pose)?);
        CoreTip::new(beam.beam(), &tool, variance, time_s, noise.noise())
            .map(Self)
            .map_err(to_python)
    }

    #[getter]
    fn tip_mm<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, self.0.tip().as_slice())
    }

    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        covariance(py, self.0.track())
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
