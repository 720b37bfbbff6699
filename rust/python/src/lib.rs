//! `PyO3` translation of `sherkit-core`: checks shapes, lends storage, translates errors. No numerics.

mod arrays;
mod bernstein;
mod calibrated;
mod camera;
mod delta;
mod errors;
mod evidence;
mod lanes;
mod maps;
mod model;
mod play;
mod problem;
mod registration;
mod rows;
mod serial;
mod solver;
mod spherical;
mod spherical_kinematics;
mod tool;
mod tool_filter;

use pyo3::prelude::*;

/// The compiled core of sherkit.
#[pymodule]
fn _core(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add_class::<delta::DeltaKinematics>()?;
    m.add_class::<delta::DeltaModel>()?;
    m.add_class::<spherical_kinematics::SphericalKinematics>()?;
    m.add_class::<spherical::SphericalModel>()?;
    m.add_class::<spherical::SphericalCalibrated>()?;
    m.add_class::<serial::SerialModel>()?;
    m.add_class::<serial::SerialCalibrated>()?;
    m.add_class::<camera::Camera>()?;
    m.add_class::<solver::Solver>()?;
    m.add_class::<bernstein::Bernstein>()?;
    m.add_class::<delta::Calibrated>()?;
    m.add_class::<tool::ToolSensor>()?;
    m.add_class::<tool::ToolBeam>()?;
    m.add_class::<tool_filter::ToolFilter>()?;
    m.add_class::<tool_filter::PaperFilter>()?;
    for (name, flag) in tool_filter::STATUS {
        m.add(name, flag)?;
    }
    m.add_function(wrap_pyfunction!(play::play, m)?)?;
    m.add_function(wrap_pyfunction!(registration::register_points, m)?)?;
    m.add_function(wrap_pyfunction!(registration::register_most, m)?)?;
    m.add_function(wrap_pyfunction!(registration::rotation_vector, m)?)?;
    m.add_function(wrap_pyfunction!(evidence::blocks_taken, m)?)?;
    m.add_function(wrap_pyfunction!(bernstein::bernstein_basis, m)?)?;
    m.add_function(wrap_pyfunction!(bernstein::bernstein_fit, m)?)?;
    m.add_function(wrap_pyfunction!(bernstein::bernstein_held_out, m)?)?;
    m.add_function(wrap_pyfunction!(bernstein::bernstein_fit_grid, m)?)?;
    m.add_function(wrap_pyfunction!(spherical::spherical_camera_placement, m)?)?;
    Ok(())
}
