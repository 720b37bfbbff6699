//! `DeltaKinematics`: forward, inverse and derivatives, single and batched.

use crate::arrays::{fixed, rows, shaped};
use crate::errors::{shape, to_python};
use nalgebra::Vector3;
use numpy::{PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use sherkit_core::delta::{Assembly, GEOMETRIC, Geometry, Kinematics};

type Marked<'py, A> = (Bound<'py, A>, Bound<'py, PyArray1<bool>>);

/// Poses computed side by side.
const LANES: usize = 8;

/// The assembly mode of this name.
pub fn assembly(name: &str) -> PyResult<Assembly> {
    match name {
        "below" => Ok(Assembly::Below),
        "above" => Ok(Assembly::Above),
        _ => Err(shape("assembly", "'below' or 'above'", &[])),
    }
}

/// Kinematics of the platform centre of a linear delta.
#[pyclass(frozen, module = "sherkit._core")]
pub struct DeltaKinematics(Kinematics);

#[pymethods]
impl DeltaKinematics {
    #[new]
    fn new(parameters: PyReadonlyArray1<'_, f64>, assembly_mode: &str) -> PyResult<Self> {
        let p = fixed::<GEOMETRIC, _>("parameters", &parameters)?;
        let geometry = Geometry::from_parameters(&p, assembly(assembly_mode)?);
        Kinematics::new(&geometry).map(Self).map_err(to_python)
    }

    fn forward<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let q = Vector3::from(fixed("joints", &joints)?);
        let x = self.0.forward(&q).map_err(to_python)?;
        Ok(PyArray1::from_slice(py, x.as_slice()))
    }

    fn inverse<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let x = Vector3::from(fixed("position", &position)?);
        let q = self.0.inverse(&x).map_err(to_python)?;
        Ok(PyArray1::from_slice(py, q.as_slice()))
    }

    fn forward_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        let q = rows::<3, _>("joints", &joints)?;
        let (x, reached) = in_lanes(q, Map::Forward(&self.0));
        marked(py, x, reached)
    }

    fn inverse_batch<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        let x = rows::<3, _>("positions", &positions)?;
        let (q, reached) = in_lanes(x, Map::Inverse(&self.0));
        marked(py, q, reached)
    }

    /// Velocity Jacobian, `(n, 3, 3)`; rows out of reach are NaN and marked.
    fn jacobian_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Marked<'py, PyArray3<f64>>> {
        let q = rows::<3, _>("joints", &joints)?;
        let mut out = vec![f64::NAN; q.len() * 9];
        let mut reached = vec![false; q.len()];
        for ((q, out), ok) in q.iter().zip(out.chunks_exact_mut(9)).zip(&mut reached) {
            if let Ok(pose) = self.0.pose(&Vector3::from(*q)) {
                out.copy_from_slice(pose.by_joints().transpose().as_slice());
                *ok = true;
            }
        }
        Ok((
            shaped(py, out, [q.len(), 3, 3])?,
            PyArray1::from_vec(py, reached),
        ))
    }

    /// Derivative by the 18 geometric parameters, `(n, 3, 18)`; rows out of reach are NaN and marked.
    fn by_parameters_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Marked<'py, PyArray3<f64>>> {
        let q = rows::<3, _>("joints", &joints)?;
        let mut out = vec![f64::NAN; q.len() * 3 * GEOMETRIC];
        let mut reached = vec![false; q.len()];
        for ((q, out), ok) in q
            .iter()
            .zip(out.chunks_exact_mut(3 * GEOMETRIC))
            .zip(&mut reached)
        {
            if let Ok(pose) = self.0.pose(&Vector3::from(*q)) {
                out.copy_from_slice(self.0.by_parameters(&pose).transpose().as_slice());
                *ok = true;
            }
        }
        Ok((
            shaped(py, out, [q.len(), 3, GEOMETRIC])?,
            PyArray1::from_vec(py, reached),
        ))
    }
}

fn marked(
    py: Python<'_>,
    values: Vec<f64>,
    reached: Vec<bool>,
) -> PyResult<Marked<'_, PyArray2<f64>>> {
    let n = reached.len();
    Ok((shaped(py, values, [n, 3])?, PyArray1::from_vec(py, reached)))
}

#[derive(Clone, Copy)]
enum Map<'a> {
    Forward(&'a Kinematics),
    Inverse(&'a Kinematics),
}

/// Poses below which a second thread costs more than it brings.
const WORTH_A_THREAD: usize = 50_000;

/// Runs the lanes, on all cores where there are many poses. The interpreter lock is held, so that nobody
/// writes the input meanwhile.
fn in_lanes(input: &[[f64; 3]], map: Map<'_>) -> (Vec<f64>, Vec<bool>) {
    let mut out = vec![0.0; input.len() * 3];
    let mut reached = vec![false; input.len()];
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = cores.min(input.len() / WORTH_A_THREAD).max(1);
    let share = input
        .len()
        .div_ceil(threads)
        .next_multiple_of(LANES)
        .max(LANES);
    let parts = input
        .chunks(share)
        .zip(out.as_chunks_mut::<3>().0.chunks_mut(share))
        .zip(reached.chunks_mut(share));
    if threads == 1 {
        for ((input, out), reached) in parts {
            widest(input, out, reached, map);
        }
    } else {
        std::thread::scope(|scope| {
            for ((input, out), reached) in parts {
                scope.spawn(move || widest(input, out, reached, map));
            }
        });
    }
    (out, reached)
}

/// Coordinates of [`LANES`] poses, side by side.
type Block = [[f64; LANES]; 3];

/// Blocks that are turned from rows to lanes and back at a time; they stay in the first cache.
const BLOCKS: usize = 32;

/// Turns rows into lanes, runs the kernel, and turns the result back. The three steps are kept apart: only a loop
/// that reads and writes lanes becomes vector instructions.
fn widest(input: &[[f64; 3]], out: &mut [[f64; 3]], reached: &mut [bool], map: Map<'_>) {
    let kernel = kernel();
    let mut from = [[[0.0; LANES]; 3]; BLOCKS];
    let mut to = [[[0.0; LANES]; 3]; BLOCKS];
    let mut ok = [[false; LANES]; BLOCKS];
    let chunks = input
        .chunks(BLOCKS * LANES)
        .zip(out.chunks_mut(BLOCKS * LANES))
        .zip(reached.chunks_mut(BLOCKS * LANES));
    for ((rows, out), reached) in chunks {
        let used = rows.len().div_ceil(LANES);
        for (rows, block) in rows.chunks(LANES).zip(&mut from) {
            for (lane, row) in rows.iter().enumerate() {
                for axis in 0..3 {
                    block[axis][lane] = row[axis];
                }
            }
        }
        kernel(&from[..used], &mut to[..used], &mut ok[..used], map);
        let results = to.iter().zip(&ok);
        let places = out.chunks_mut(LANES).zip(reached.chunks_mut(LANES));
        for ((block, ok), (out, reached)) in results.zip(places) {
            for (lane, (out, reached)) in out.iter_mut().zip(reached).enumerate() {
                for axis in 0..3 {
                    out[axis] = if ok[lane] {
                        block[axis][lane]
                    } else {
                        f64::NAN
                    };
                }
                *reached = ok[lane];
            }
        }
    }
}

type Kernel = fn(&[Block], &mut [Block], &mut [[bool; LANES]], Map<'_>);

/// The kernel with the widest vectors that this processor has; every choice gives the same bits.
fn kernel() -> Kernel {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx512f")]
        fn avx512(from: &[Block], to: &mut [Block], ok: &mut [[bool; LANES]], map: Map<'_>) {
            run(from, to, ok, map);
        }
        #[target_feature(enable = "avx2")]
        fn avx2(from: &[Block], to: &mut [Block], ok: &mut [[bool; LANES]], map: Map<'_>) {
            run(from, to, ok, map);
        }
        if std::arch::is_x86_feature_detected!("avx512f") {
            // SAFETY: the processor was just asked for the feature.
            return |from, to, ok, map| unsafe { avx512(from, to, ok, map) };
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor was just asked for the feature.
            return |from, to, ok, map| unsafe { avx2(from, to, ok, map) };
        }
    }
    run
}

#[inline(always)]
fn run(from: &[Block], to: &mut [Block], reached: &mut [[bool; LANES]], map: Map<'_>) {
    match map {
        Map::Forward(k) => {
            for ((from, to), reached) in from.iter().zip(to).zip(reached) {
                (*to, *reached) = k.forward_lanes::<LANES>(from);
            }
        }
        Map::Inverse(k) => {
            for ((from, to), reached) in from.iter().zip(to).zip(reached) {
                (*to, *reached) = k.inverse_lanes::<LANES>(from);
            }
        }
    }
}
