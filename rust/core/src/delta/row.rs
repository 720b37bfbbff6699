//! Rows of a run: a position, or a distance between two places, in which the datum cancels.

use super::chain::{Chain, Covariates, Prediction, Wanted};
use super::geometry::LIMBS;
use super::parameters::PARAMETERS;
use crate::Result;
use nalgebra::{Matrix3, SMatrix, Vector3};

/// What was read at a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Coordinates of the measured point.
    Position,
    /// Distance to the measured point at these joint readings, mm.
    Distance {
        /// Joint readings at the other end.
        to: [f64; LIMBS],
    },
}

/// A row: where the joints were, what else is known, what was read there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Joint readings, mm.
    pub joints: [f64; LIMBS],
    /// Time, temperature, directions.
    pub covariates: Covariates,
    /// Added to the measured point before the sensors see it, mm: a user's own effect.
    pub push: Vector3<f64>,
    /// What was read.
    pub kind: Kind,
}

impl Chain {
    /// Predicts a row without derivatives.
    ///
    /// # Errors
    /// As [`Chain::value`].
    pub fn row_value(&self, row: &Row) -> Result<Vector3<f64>> {
        let at = |q: &[f64; LIMBS]| self.value(&Vector3::from(*q), &row.covariates, &row.push);
        let value = at(&row.joints)?;
        match &row.kind {
            Kind::Position => Ok(value),
            Kind::Distance { to } => Ok(Vector3::new((at(to)? - value).norm(), 0.0, 0.0)),
        }
    }

    /// Predicts a row with the wanted derivatives; a distance fills the first component alone, and columns that were
    /// not wanted are zero.
    ///
    /// # Errors
    /// As [`Chain::predict`].
    #[inline]
    pub fn row_predict_into(&self, row: &Row, wanted: Wanted, out: &mut Prediction) -> Result<()> {
        if let Kind::Position = row.kind {
            let joints = Vector3::from(row.joints);
            return self.predict_into(&joints, &row.covariates, &row.push, wanted, out);
        }
        *out = self.row_predict(row, wanted)?;
        Ok(())
    }

    /// [`Self::row_predict_into`] as a value of its own.
    ///
    /// # Errors
    /// As [`Chain::predict`].
    pub fn row_predict(&self, row: &Row, wanted: Wanted) -> Result<Prediction> {
        let at =
            |q: &[f64; LIMBS]| self.predict(&Vector3::from(*q), &row.covariates, &row.push, wanted);
        let Kind::Distance { to } = &row.kind else {
            return at(&row.joints);
        };
        let (a, b) = (at(&row.joints)?, at(to)?);
        let between = b.value - a.value;
        let distance = between.norm();
        // two equal places have no direction; their distance is stationary at zero
        let along = if distance > 0.0 {
            between / distance
        } else {
            Vector3::zeros()
        };
        let mut by_parameters = SMatrix::<f64, 3, PARAMETERS>::zeros();
        by_parameters.set_row(0, &along.tr_mul(&(b.by_parameters - a.by_parameters)));
        let first = |m: Matrix3<f64>| {
            let mut out = Matrix3::zeros();
            out.set_row(0, &along.tr_mul(&m));
            out
        };
        Ok(Prediction {
            value: Vector3::new(distance, 0.0, 0.0),
            by_joints: first(b.by_joints - a.by_joints),
            by_body: first(b.by_body - a.by_body),
            by_parameters,
        })
    }
}
