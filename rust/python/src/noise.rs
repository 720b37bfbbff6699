//! `FilterNoise`: what the filters of the flexible tool trust, by name or by its numbers.

use crate::errors::to_python;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sherkit_core::tool::filters::noise::Variances;
use sherkit_core::tool::filters::{Noise, Trust};

/// Noise of a filter.
#[pyclass(frozen, eq, module = "sherkit._core")]
#[derive(PartialEq)]
pub struct FilterNoise(Noise);

impl FilterNoise {
    /// The core's noise.
    pub fn noise(&self) -> Noise {
        self.0
    }

    fn checked(noise: Noise) -> PyResult<Self> {
        noise.check().map_err(to_python)?;
        Ok(Self(noise))
    }
}

/// Variances from (depth, across).
fn pair([depth, across]: [f64; 2]) -> Variances {
    Variances { depth, across }
}

fn numbers(v: &Variances) -> (f64, f64) {
    (v.depth, v.across)
}

#[pymethods]
impl FilterNoise {
    #[staticmethod]
    fn ebrahimi_2020() -> Self {
        Self(Noise::ebrahimi_2020())
    }

    #[staticmethod]
    fn ebrahimi_2020_of_force() -> Self {
        Self(Noise::ebrahimi_2020_of_force())
    }

    /// From the covariance that the sensing carries, and `floor` on top of it; pairs are (depth, across or tip), mm².
    #[staticmethod]
    #[pyo3(signature = (per_second, floor, per_step=[0.0, 0.0]))]
    fn propagated(per_second: [f64; 2], floor: [f64; 2], per_step: [f64; 2]) -> PyResult<Self> {
        let plain = Noise::propagated(per_second, pair(floor));
        Self::checked(Noise { per_step, ..plain })
    }

    /// One pair of variances below a force, another from it on, as the paper has it.
    #[staticmethod]
    #[pyo3(signature = (at_mn, below, above, per_step, per_second=[0.0, 0.0], of_force=false))]
    fn switched(
        at_mn: f64,
        below: [f64; 2],
        above: [f64; 2],
        per_step: [f64; 2],
        per_second: [f64; 2],
        of_force: bool,
    ) -> PyResult<Self> {
        let trust = Trust::Switched {
            at_mn,
            below: pair(below),
            above: pair(above),
            of_force,
        };
        Self::checked(Noise {
            trust,
            per_step,
            per_second,
        })
    }

    /// All numbers by name.
    fn numbers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let out = PyDict::new(py);
        match &self.0.trust {
            Trust::Switched {
                at_mn,
                below,
                above,
                of_force,
            } => {
                out.set_item("kind", "switched")?;
                out.set_item("at_mn", at_mn)?;
                out.set_item("below", numbers(below))?;
                out.set_item("above", numbers(above))?;
                out.set_item("of_force", of_force)?;
            }
            Trust::Propagated { floor } => {
                out.set_item("kind", "propagated")?;
                out.set_item("floor", numbers(floor))?;
            }
        }
        out.set_item("per_step", self.0.per_step)?;
        out.set_item("per_second", self.0.per_second)?;
        Ok(out)
    }
}
