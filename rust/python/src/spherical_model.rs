//! `SphericalModel`: predicted readings, their derivatives, and rows for the solver.

use crate::arrays::{fixed, shaped};
use crate::camera::face;
use crate::errors::to_python;
use crate::solver::{Solver, iterate};
use crate::spherical::{Marked, assembly, marked};
use crate::spherical_rows::{Block, Problem, READINGS, check_free, place, read, rows_of, table};
use nalgebra::Vector3;
use numpy::{PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use sherkit_core::camera::{Camera, Description};
use sherkit_core::spherical::parameters::PARAMETERS;
use sherkit_core::spherical::{Chain, GEOMETRIC, Geometry, Model, Row};

/// Derivatives of `n` rows of `R` readings each.
struct Derivatives {
    rows: usize,
    by_parameters: Vec<f64>,
    by_joints: Vec<f64>,
    by_body: Vec<f64>,
    reached: Vec<bool>,
}

/// A nominal spherical robot and camera whose errors and effects are to be identified.
#[pyclass(frozen, module = "sherkit._core")]
pub struct SphericalModel(Model);

#[pymethods]
impl SphericalModel {
    /// Number of parameters of the chain.
    #[classattr]
    const PARAMETERS: usize = PARAMETERS;

    /// `settings`: radius of the sphere (mm), direction of the weight (3), home joint readings (2, rad).
    #[new]
    #[pyo3(signature = (geometry, camera, settings, assembly_mode="outer", face_mode="near"))]
    fn new(
        geometry: PyReadonlyArray1<'_, f64>,
        camera: PyReadonlyArray1<'_, f64>,
        settings: PyReadonlyArray1<'_, f64>,
        assembly_mode: &str,
        face_mode: &str,
    ) -> PyResult<Self> {
        let p = fixed::<GEOMETRIC, _>("geometry", &geometry)?;
        let geometry = Geometry::from_parameters(&p, assembly(assembly_mode)?);
        geometry.check().map_err(to_python)?;
        let camera = Description::from_parameters(&fixed("camera", &camera)?);
        Camera::new(&camera).map_err(to_python)?;
        let [radius_mm, gx, gy, gz, h1, h2] = fixed("settings", &settings)?;
        let model = Model {
            geometry,
            radius_mm,
            camera,
            face: face(face_mode)?,
            gravity: Vector3::new(gx, gy, gz),
            home: [h1, h2],
        };
        model.with(&[0.0; PARAMETERS]).map_err(to_python)?;
        Ok(Self(model))
    }

    /// Predicted readings `(n, 4)` (u, v, φ, γ; what does not apply is zero) and which rows could be computed; the
    /// others are NaN.
    fn predict<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'_, f64>,
        block: Block<'_>,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        let chain = self.chain(&values)?;
        let rows = rows_of(&block)?;
        let mut out = vec![0.0; rows.len() * READINGS];
        let mut reached = vec![false; rows.len()];
        for ((row, out), ok) in rows
            .iter()
            .zip(out.as_chunks_mut::<READINGS>().0)
            .zip(&mut reached)
        {
            if let Ok(value) = chain.row_value(row) {
                out[place(row.kind)..][..2].copy_from_slice(value.as_slice());
                *ok = true;
            } else {
                out.fill(f64::NAN);
            }
        }
        marked(py, out, reached, READINGS)
    }

    /// Derivatives by the parameters whose indices are given `(n, 4, free)`, by the joint readings `(n, 4, 2)`, by a
    /// displacement of the marker `(n, 4, 3)`, and which rows could be computed.
    fn derivatives<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'_, f64>,
        block: Block<'_>,
        free: Vec<usize>,
    ) -> PyResult<(
        Bound<'py, PyArray3<f64>>,
        Bound<'py, PyArray3<f64>>,
        Bound<'py, PyArray3<f64>>,
        Bound<'py, PyArray1<bool>>,
    )> {
        check_free(&free)?;
        let chain = self.chain(&values)?;
        let d = derivatives(&chain, &rows_of(&block)?, &free);
        Ok((
            shaped(py, d.by_parameters, [d.rows, READINGS, free.len()])?,
            shaped(py, d.by_joints, [d.rows, READINGS, 2])?,
            shaped(py, d.by_body, [d.rows, READINGS, 3])?,
            PyArray1::from_vec(py, d.reached),
        ))
    }

    /// The camera with its errors.
    fn camera(&self, values: PyReadonlyArray1<'_, f64>) -> PyResult<crate::camera::Camera> {
        Ok(crate::camera::Camera(*self.chain(&values)?.camera()))
    }

    /// Markers in the base frame `(n, 3)`, mm.
    fn markers<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'_, f64>,
        block: Block<'_>,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        let chain = self.chain(&values)?;
        let rows = rows_of(&block)?;
        let mut out = vec![f64::NAN; rows.len() * 3];
        let mut reached = vec![false; rows.len()];
        for (i, row) in rows.iter().enumerate() {
            if let Ok(marker) = chain.marker(row) {
                out[3 * i..][..3].copy_from_slice(marker.as_slice());
                reached[i] = true;
            }
        }
        marked(py, out, reached, 3)
    }

    /// Displacement of the platform's centre `(n, 3)`, mm, and its derivatives by the parameters whose indices are
    /// given `(n, 3, free)` and by the joint readings `(n, 3, 2)`.
    fn centres<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'_, f64>,
        block: Block<'_>,
        free: Vec<usize>,
    ) -> PyResult<(
        Bound<'py, PyArray2<f64>>,
        Bound<'py, PyArray3<f64>>,
        Bound<'py, PyArray3<f64>>,
        Bound<'py, PyArray1<bool>>,
    )> {
        check_free(&free)?;
        let chain = self.chain(&values)?;
        let rows = rows_of(&block)?;
        let n = rows.len();
        let mut out = vec![f64::NAN; n * 3];
        let mut by_parameters = vec![f64::NAN; n * 3 * free.len()];
        let mut by_joints = vec![f64::NAN; n * 6];
        let mut reached = vec![false; n];
        for (i, row) in rows.iter().enumerate() {
            let Ok(centre) = chain.centre(&row.joints, &row.covariates) else {
                continue;
            };
            reached[i] = true;
            out[3 * i..][..3].copy_from_slice(centre.value.as_slice());
            by_joints[6 * i..][..6].copy_from_slice(centre.by_joints.transpose().as_slice());
            for axis in 0..3 {
                let line = &mut by_parameters[(3 * i + axis) * free.len()..][..free.len()];
                for (o, &k) in line.iter_mut().zip(&free) {
                    *o = centre.by_parameters[(axis, k)];
                }
            }
        }
        Ok((
            shaped(py, out, [n, 3])?,
            shaped(py, by_parameters, [n, 3, free.len()])?,
            shaped(py, by_joints, [n, 3, 2])?,
            PyArray1::from_vec(py, reached),
        ))
    }

    /// The paper's residuals `(n, 2)`, rad: measured joints minus the inverse kinematics of the readings `(n, 4)`
    /// (Eq. 6), and their derivatives by the parameters whose indices are given `(n, 2, free)`.
    fn inverse_residuals<'py>(
        &self,
        py: Python<'py>,
        values: PyReadonlyArray1<'_, f64>,
        block: Block<'_>,
        readings: PyReadonlyArray2<'_, f64>,
        free: Vec<usize>,
    ) -> PyResult<(
        Bound<'py, PyArray2<f64>>,
        Bound<'py, PyArray3<f64>>,
        Bound<'py, PyArray1<bool>>,
    )> {
        check_free(&free)?;
        let chain = self.chain(&values)?;
        let rows = rows_of(&block)?;
        let n = rows.len();
        let readings = table::<READINGS>("readings", &readings, n)?;
        let mut out = vec![f64::NAN; n * 2];
        let mut by_parameters = vec![f64::NAN; n * 2 * free.len()];
        let mut reached = vec![false; n];
        for (i, (row, reading)) in rows.iter().zip(&readings).enumerate() {
            let Ok(found) = chain.inverse_residual(row, &read(row, reading)) else {
                continue;
            };
            reached[i] = true;
            out[2 * i..][..2].copy_from_slice(found.value.as_slice());
            for axis in 0..2 {
                let line = &mut by_parameters[(2 * i + axis) * free.len()..][..free.len()];
                for (o, &k) in line.iter_mut().zip(&free) {
                    *o = found.by_parameters[(axis, k)];
                }
            }
        }
        Ok((
            shaped(py, out, [n, 2])?,
            shaped(py, by_parameters, [n, 2, free.len()])?,
            PyArray1::from_vec(py, reached),
        ))
    }

    /// Adds a block of rows to the solver at its trial. `values` holds the parameters that are not free. Returns the
    /// rows that cannot be computed there.
    fn accumulate(
        &self,
        solver: &mut Solver,
        values: PyReadonlyArray1<'_, f64>,
        free: Vec<usize>,
        block: Block<'_>,
        readings: PyReadonlyArray2<'_, f64>,
        weights: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Vec<usize>> {
        let rows = rows_of(&block)?;
        let problem = self.problem(solver, &values, &free, &rows)?;
        let n = problem.rows.len();
        let readings = table::<READINGS>("readings", &readings, n)?;
        let weights = table::<READINGS>("weights", &weights, n)?;
        Ok(problem.readings(solver, &readings, &weights))
    }

    /// Iterates to the minimum over rows in memory. Returns how it ended and the rows that cannot be computed at the
    /// start, with which nothing is solved.
    #[allow(
        clippy::too_many_arguments,
        reason = "one argument for each part of the problem"
    )]
    fn solve(
        &self,
        py: Python<'_>,
        solver: &mut Solver,
        values: PyReadonlyArray1<'_, f64>,
        free: Vec<usize>,
        block: Block<'_>,
        readings: PyReadonlyArray2<'_, f64>,
        weights: PyReadonlyArray2<'_, f64>,
        priors: bool,
    ) -> PyResult<(&'static str, Vec<usize>)> {
        let rows = rows_of(&block)?;
        let problem = self.problem(solver, &values, &free, &rows)?;
        let n = problem.rows.len();
        let readings = table::<READINGS>("readings", &readings, n)?;
        let weights = table::<READINGS>("weights", &weights, n)?;
        py.detach(|| {
            iterate(solver, priors, |solver| {
                Ok(problem.readings(solver, &readings, &weights))
            })
        })
    }

    /// As [`Self::solve`], for the paper's residuals (Eq. 6): `weights` `(n, 2)` are those of the joints, 1/rad.
    #[allow(
        clippy::too_many_arguments,
        reason = "one argument for each part of the problem"
    )]
    fn solve_inverse(
        &self,
        py: Python<'_>,
        solver: &mut Solver,
        values: PyReadonlyArray1<'_, f64>,
        free: Vec<usize>,
        block: Block<'_>,
        readings: PyReadonlyArray2<'_, f64>,
        weights: PyReadonlyArray2<'_, f64>,
        priors: bool,
    ) -> PyResult<(&'static str, Vec<usize>)> {
        let rows = rows_of(&block)?;
        let problem = self.problem(solver, &values, &free, &rows)?;
        let n = problem.rows.len();
        let readings = table::<READINGS>("readings", &readings, n)?;
        let weights = table::<2>("weights", &weights, n)?;
        py.detach(|| {
            iterate(solver, priors, |solver| {
                Ok(problem.inverse(solver, &readings, &weights))
            })
        })
    }
}

impl SphericalModel {
    /// The nominal robot and camera.
    pub fn model(&self) -> &Model {
        &self.0
    }

    fn problem<'a>(
        &'a self,
        solver: &Solver,
        values: &PyReadonlyArray1<'_, f64>,
        free: &'a [usize],
        rows: &'a [Row],
    ) -> PyResult<Problem<'a>> {
        let values = fixed("values", values)?;
        let problem = Problem {
            model: &self.0,
            values,
            free,
            rows,
        };
        problem.check(solver)?;
        Ok(problem)
    }

    fn chain(&self, values: &PyReadonlyArray1<'_, f64>) -> PyResult<Chain> {
        self.0.with(&fixed("values", values)?).map_err(to_python)
    }
}

fn derivatives(chain: &Chain, rows: &[Row], free: &[usize]) -> Derivatives {
    let n = rows.len();
    let mut d = Derivatives {
        rows: n,
        by_parameters: vec![0.0; n * READINGS * free.len()],
        by_joints: vec![0.0; n * READINGS * 2],
        by_body: vec![0.0; n * READINGS * 3],
        reached: vec![false; n],
    };
    for (i, row) in rows.iter().enumerate() {
        let Ok(p) = chain.row_predict(row) else {
            d.by_parameters[i * READINGS * free.len()..][..READINGS * free.len()].fill(f64::NAN);
            d.by_joints[i * READINGS * 2..][..READINGS * 2].fill(f64::NAN);
            d.by_body[i * READINGS * 3..][..READINGS * 3].fill(f64::NAN);
            continue;
        };
        d.reached[i] = true;
        for axis in 0..2 {
            let line = i * READINGS + place(row.kind) + axis;
            let out = &mut d.by_parameters[line * free.len()..][..free.len()];
            for (o, &k) in out.iter_mut().zip(free) {
                *o = p.by_parameters[(axis, k)];
            }
            for k in 0..2 {
                d.by_joints[line * 2 + k] = p.by_joints[(axis, k)];
            }
            for k in 0..3 {
                d.by_body[line * 3 + k] = p.by_body[(axis, k)];
            }
        }
    }
    d
}
