//! `Calibrated`: the model of the control loop, from Python.

use crate::arrays::{fixed, rows, shaped};
use crate::bernstein::Bernstein;
use crate::errors::to_python;
use crate::model::DeltaModel;
use nalgebra::Vector3;
use numpy::{PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use sherkit_core::bernstein::Domain;
use sherkit_core::calibrated::{Branch, Calibrated as Core};
use sherkit_core::delta::parameters::Values;
use sherkit_core::delta::{Chain, Covariates, Model};
use sherkit_core::flat::{BranchParts, write_delta};

struct OwnedBranch {
    model: Model,
    values: Values,
    chain: Chain,
    correction: Option<Bernstein>,
}

impl OwnedBranch {
    fn view(&self) -> PyResult<Branch<'_>> {
        Ok(Branch {
            chain: self.chain,
            correction: self.correction.as_ref().map(Bernstein::view).transpose()?,
        })
    }

    fn parts(&self) -> PyResult<BranchParts<'_>> {
        Ok(BranchParts {
            model: &self.model,
            values: &self.values,
            correction: self.correction.as_ref().map(Bernstein::view).transpose()?,
        })
    }
}

/// A calibrated delta: whole-workspace model, and perhaps a local one blended in.
#[pyclass(frozen, module = "sherkit._core")]
pub struct Calibrated {
    whole: OwnedBranch,
    local: Option<(OwnedBranch, Domain)>,
}

/// A model, the values of all its parameters, and a correction.
type Part<'py> = (
    PyRef<'py, DeltaModel>,
    PyReadonlyArray1<'py, f64>,
    Option<Bernstein>,
);
type Region<'py> = (PyReadonlyArray1<'py, f64>, PyReadonlyArray1<'py, f64>, f64);
type Single<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>);
type Batch<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<bool>>,
);

/// Covariates from (time s, temperature °C, three directions).
fn now(numbers: [f64; 5]) -> Covariates {
    let [time_s, temperature_c, d1, d2, d3] = numbers;
    Covariates {
        time_s,
        temperature_c,
        direction: [d1, d2, d3],
    }
}

#[pymethods]
impl Calibrated {
    /// `whole` and `local` are (model, values of all parameters, correction); `region` is (low corner, high
    /// corner, width of the blend).
    #[new]
    fn new(whole: Part<'_>, local: Option<Part<'_>>, region: Option<Region<'_>>) -> PyResult<Self> {
        let branch = |part: Part<'_>| -> PyResult<OwnedBranch> {
            let values = fixed("values", &part.1)?;
            let model = *part.0.model();
            Ok(OwnedBranch {
                model,
                values,
                chain: model.with(&values).map_err(to_python)?,
                correction: part.2,
            })
        };
        let local = match (local, region) {
            (Some(local), Some((low, high, width))) => Some((
                branch(local)?,
                crate::bernstein::domain(&low, &high, width)?,
            )),
            _ => None,
        };
        Ok(Self {
            whole: branch(whole)?,
            local,
        })
    }

    /// All that makes it as a row of numbers `(n,)`, for a control loop in another language.
    fn flat<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let local = match &self.local {
            None => None,
            Some((branch, region)) => Some((branch.parts()?, region)),
        };
        let local = local.as_ref().map(|(parts, region)| (parts, *region));
        let mut numbers = Vec::new();
        write_delta(&self.whole.parts()?, local, |x| numbers.push(x));
        Ok(PyArray1::from_vec(py, numbers))
    }

    /// Position `(3,)` and its derivative by the joints `(3, 3)`.
    fn forward<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray1<'_, f64>,
        covariates: [f64; 5],
    ) -> PyResult<Single<'py>> {
        let q = Vector3::from(fixed("joints", &joints)?);
        let (x, j) = self
            .view()?
            .forward(&q, &now(covariates))
            .map_err(to_python)?;
        let j = j.transpose().as_slice().to_vec();
        Ok((
            PyArray1::from_slice(py, x.as_slice()),
            shaped(py, j, [3, 3])?,
        ))
    }

    /// Joint readings for a position.
    fn inverse<'py>(
        &self,
        py: Python<'py>,
        position: PyReadonlyArray1<'_, f64>,
        covariates: [f64; 5],
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let x = Vector3::from(fixed("position", &position)?);
        let q = self
            .view()?
            .inverse(&x, &now(covariates))
            .map_err(to_python)?;
        Ok(PyArray1::from_slice(py, q.as_slice()))
    }

    /// Positions, Jacobians, and which rows are in reach; the others are NaN.
    fn forward_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
        covariates: [f64; 5],
    ) -> PyResult<Batch<'py>> {
        let q = rows::<3, _>("joints", &joints)?;
        let model = self.view()?;
        let mut x = vec![f64::NAN; q.len() * 3];
        let mut j = vec![f64::NAN; q.len() * 9];
        let mut reached = vec![false; q.len()];
        for (i, q) in q.iter().enumerate() {
            if let Ok((position, by_joints)) = model.forward(&Vector3::from(*q), &now(covariates)) {
                x[i * 3..][..3].copy_from_slice(position.as_slice());
                j[i * 9..][..9].copy_from_slice(by_joints.transpose().as_slice());
                reached[i] = true;
            }
        }
        Ok((
            shaped(py, x, [q.len(), 3])?,
            shaped(py, j, [q.len(), 3, 3])?,
            PyArray1::from_vec(py, reached),
        ))
    }

    /// Joint readings `(n, 3)` for positions, and which are in reach.
    fn inverse_batch<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<'_, f64>,
        covariates: [f64; 5],
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<bool>>)> {
        let x = rows::<3, _>("positions", &positions)?;
        let model = self.view()?;
        let mut out = vec![f64::NAN; x.len() * 3];
        let mut reached = vec![false; x.len()];
        for (i, x) in x.iter().enumerate() {
            if let Ok(joints) = model.inverse(&Vector3::from(*x), &now(covariates)) {
                out[i * 3..][..3].copy_from_slice(joints.as_slice());
                reached[i] = true;
            }
        }
        Ok((
            shaped(py, out, [x.len(), 3])?,
            PyArray1::from_vec(py, reached),
        ))
    }
}

impl Calibrated {
    fn view(&self) -> PyResult<Core<'_>> {
        Ok(Core {
            whole: self.whole.view()?,
            local: match &self.local {
                None => None,
                Some((branch, region)) => Some((branch.view()?, *region)),
            },
        })
    }
}
