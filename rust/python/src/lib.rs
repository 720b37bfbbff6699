//! `PyO3` translation of `sherkit-core`: checks shapes, lends storage, translates errors. No numerics.

mod arrays;
mod bernstein;
mod calibrated;
mod errors;
mod kinematics;
mod model;
mod solver;

use pyo3::prelude::*;

/// The compiled core of sherkit.
#[pymodule]
fn _core(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add_class::<kinematics::DeltaKinematics>()?;
    m.add_class::<model::DeltaModel>()?;
    m.add_class::<solver::Solver>()?;
    m.add_class::<bernstein::Bernstein>()?;
    m.add_class::<calibrated::Calibrated>()?;
    m.add_function(wrap_pyfunction!(bernstein::bernstein_basis, m)?)?;
    m.add_function(wrap_pyfunction!(bernstein::bernstein_fit, m)?)?;
    m.add_function(wrap_pyfunction!(bernstein::bernstein_fit_grid, m)?)?;
    Ok(())
}
