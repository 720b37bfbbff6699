//! Core errors as the exceptions of `sherkit.errors`.

use pyo3::prelude::*;
use pyo3::types::PyModule;
use sherkit_core::Error;

/// The Python exception for a core error.
pub fn to_python(error: Error) -> PyErr {
    Python::attach(|py| build(py, error).unwrap_or_else(|failure| failure))
}

fn build(py: Python<'_>, error: Error) -> PyResult<PyErr> {
    let errors = PyModule::import(py, "sherkit.errors")?;
    let message = error.to_string();
    let exception = match error {
        Error::OutOfReach { limb, miss_mm } => {
            errors
                .getattr("OutOfReach")?
                .call1((message, limb + 1, miss_mm))?
        }
        Error::LimbReversed { limb, beyond_mm } => {
            errors
                .getattr("OutOfReach")?
                .call1((message, limb + 1, beyond_mm))?
        }
        Error::TargetOutOfReach { miss_mm } => {
            errors.getattr("OutOfReach")?.call1((message, 0, miss_mm))?
        }
        Error::AxisOutOfReach { limb, miss_rad } => {
            errors
                .getattr("OutOfReach")?
                .call1((message, limb + 1, f64::NAN, miss_rad))?
        }
        Error::LimbsApart { miss_rad } => {
            errors
                .getattr("OutOfReach")?
                .call1((message, 0, f64::NAN, miss_rad))?
        }
        Error::OtherAssembly => {
            errors
                .getattr("OutOfReach")?
                .call1((message, 0, f64::NAN, f64::NAN))?
        }
        Error::BehindCamera { .. } | Error::RayMisses { .. } | Error::LensFolds => {
            errors.getattr("NotSeen")?.call1((message,))?
        }
        Error::Singular | Error::SingularPose(_) => {
            errors.getattr("Singular")?.call1((message,))?
        }
        Error::NotFinite { .. } => errors.getattr("NotFinite")?.call1((message,))?,
        Error::InvalidGeometry { .. }
        | Error::InvalidCamera { .. }
        | Error::NoOptimum
        | Error::Invalid { .. } => errors.getattr("RobotError")?.call1((message,))?,
        Error::TooFew { .. } | Error::Collinear { .. } => {
            errors.getattr("FitError")?.call1((message,))?
        }
        Error::NotConverged { .. } => errors.getattr("NotConverged")?.call1((message,))?,
        Error::WrongLength { .. } => errors.getattr("ShapeError")?.call1((message,))?,
    };
    Ok(PyErr::from_value(exception))
}

/// A wrong shape, in the words of the caller's argument.
pub fn shape(name: &str, expected: &str, found: &[usize]) -> PyErr {
    Python::attach(|py| {
        let message = format!("{name}: expected an array of shape {expected}, got {found:?}");
        PyModule::import(py, "sherkit.errors")
            .and_then(|errors| errors.getattr("ShapeError")?.call1((message,)))
            .map_or_else(|failure| failure, PyErr::from_value)
    })
}
