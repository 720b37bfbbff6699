//! The remote centre of motion: how far it wanders with the joints.

use super::effects::{AT, PARAMETERS};
use super::geometry::LIMBS;
use super::model::{Chain, Covariates};
use super::nominal::Model;
use crate::chain::effects::Wanted;
use crate::{Error, Result};
use nalgebra::{Matrix3x2, SMatrix, Vector2, Vector3};

/// Displacement of the platform's centre from the remote centre, with its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Centre {
    /// Base frame, mm.
    pub value: Vector3<f64>,
    /// By the joint readings.
    pub by_joints: Matrix3x2<f64>,
    /// By the parameters, one column each.
    pub by_parameters: SMatrix<f64, 3, PARAMETERS>,
}

impl Chain {
    /// Displacement of the platform's centre from the remote centre at joint readings, by elbow axes that miss it.
    ///
    /// # Errors
    /// [`Error::NotFinite`] where an active effect lacks its covariate.
    pub fn centre(&self, readings: &[f64; LIMBS], row: &Covariates) -> Result<Centre> {
        let readings = Vector2::from(*readings);
        let joints = self.joints.at::<Model>(&readings, row, Wanted::ALL);
        let displaced = self.structure.displaced(&joints.value);
        let at = AT.structure;
        let mut d = SMatrix::<f64, 3, PARAMETERS>::zeros();
        let (one, two) = (displaced.by_alphas.column(0), displaced.by_alphas.column(1));
        if let (Some(both), Some(unequal)) = (at.geometry, at.unequal_limbs) {
            d.set_column(both.start, &(one + two));
            d.set_column(unequal.start, &(one - two));
        }
        if let Some(place) = at.axis_offset {
            for (k, by) in displaced.by_misses.iter().enumerate() {
                d.set_column(place.start + k, by);
            }
        }
        joints.columns::<Model, 3, PARAMETERS>(&displaced.by_azimuths, Wanted::ALL, &mut d);
        if let Some(index) = displaced.value.iter().position(|v| !v.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        Ok(Centre {
            value: displaced.value,
            by_joints: joints.by_readings(displaced.by_azimuths),
            by_parameters: d,
        })
    }
}
