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

/// The widest vectors that this processor has; every choice gives the same bits.
fn widest(input: &[[f64; 3]], out: &mut [[f64; 3]], reached: &mut [bool], map: Map<'_>) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx512f")]
        fn avx512(input: &[[f64; 3]], out: &mut [[f64; 3]], reached: &mut [bool], map: Map<'_>) {
            run(input, out, reached, map);
        }
        #[target_feature(enable = "avx2")]
        fn avx2(input: &[[f64; 3]], out: &mut [[f64; 3]], reached: &mut [bool], map: Map<'_>) {
            run(input, out, reached, map);
        }
        if std::arch::is_x86_feature_detected!("avx512f") {
            // SAFETY: the processor was just asked for the feature.
            return unsafe { avx512(input, out, reached, map) };
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor was just asked for the feature.
            return unsafe { avx2(input, out, reached, map) };
        }
    }
    run(input, out, reached, map);
}

// everything below must end up inside the functions above to be compiled with their features: no closures
#[inline(always)]
fn run(input: &[[f64; 3]], out: &mut [[f64; 3]], reached: &mut [bool], map: Map<'_>) {
    let (blocks, rest) = input.as_chunks::<LANES>();
    let (out_blocks, out_rest) = out.as_chunks_mut::<LANES>();
    let (ok_blocks, ok_rest) = reached.as_chunks_mut::<LANES>();
    for ((rows, out), ok) in blocks.iter().zip(out_blocks).zip(ok_blocks) {
        compute(rows, out, ok, map);
    }
    if !rest.is_empty() {
        let mut rows = [[0.0; 3]; LANES];
        rows[..rest.len()].copy_from_slice(rest);
        let (mut values, mut ok) = ([[0.0; 3]; LANES], [false; LANES]);
        compute(&rows, &mut values, &mut ok, map);
        out_rest.copy_from_slice(&values[..out_rest.len()]);
        ok_rest.copy_from_slice(&ok[..ok_rest.len()]);
    }
}

#[inline(always)]
fn compute(
    rows: &[[f64; 3]; LANES],
    out: &mut [[f64; 3]; LANES],
    reached: &mut [bool; LANES],
    map: Map<'_>,
) {
    let mut block = [[0.0; LANES]; 3];
    for axis in 0..3 {
        for lane in 0..LANES {
            block[axis][lane] = rows[lane][axis];
        }
    }
    let (values, ok) = match map {
        Map::Forward(k) => k.forward_lanes::<LANES>(&block),
        Map::Inverse(k) => k.inverse_lanes::<LANES>(&block),
    };
    for lane in 0..LANES {
        for axis in 0..3 {
            out[lane][axis] = if ok[lane] {
                values[axis][lane]
            } else {
                f64::NAN
            };
        }
    }
    *reached = ok;
}
