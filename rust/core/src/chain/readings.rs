//! Predictions of rows: of readings at one place, or of a distance, which fills the first component alone.

use super::effects::Wanted;
use super::gauges::{self, Around, Gauge};
use super::mechanism::Mechanism;
use super::robot::{Chain, Robot};
use super::row::{Aim, Prediction, Row};
use super::sensor::first;
use crate::Result;
use nalgebra::{SMatrix, SVector, Vector3};

impl<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize> Chain<R, J, M, P> {
    /// Measured point of a row, base frame, mm.
    ///
    /// # Errors
    /// As [`Chain::point`].
    pub fn row_point(&self, row: &Row<J>) -> Result<Vector3<f64>> {
        self.point(&SVector::from(row.joints), &row.covariates, &row.push)
    }

    /// Hands over the points of the mechanism's parts at a row ([`Mechanism::parts`]), then the measured point where the
    /// body link takes it; base frame, mm.
    ///
    /// # Errors
    /// As [`Chain::point`].
    pub fn row_parts(&self, row: &Row<J>, mut put: impl FnMut(Vector3<f64>)) -> Result<()> {
        let readings = SVector::from(row.joints);
        let joints = self
            .joints
            .at::<R>(&readings, &row.covariates, Wanted::default());
        let solved = self.structure.solve_at(&joints.value, &row.covariates)?;
        let (growth, shift) = self.body.at(&row.covariates);
        self.structure.parts(&solved, &mut put);
        put(self.structure.point(&solved) * growth + shift + row.push);
        Ok(())
    }

    /// Predicts a row without derivatives; a distance fills the first component alone.
    ///
    /// # Errors
    /// As [`Chain::value`].
    pub fn row_value(&self, row: &Row<J>) -> Result<SVector<f64, M>> {
        let at = |q: &[f64; J]| {
            let (joints, known) = (SVector::from(*q), &row.covariates);
            let target = row.aim.target;
            match self.gauge(row.aim) {
                None => self.value_by(&self.sensor, &joints, known, &row.push, target),
                Some(gauge) => self.value_by(&gauge, &joints, known, &row.push, target),
            }
        };
        let value = at(&row.joints)?;
        match &row.to {
            None => Ok(value),
            Some(to) => Ok(first((at(to)? - value).norm())),
        }
    }

    /// Predicts a row with the wanted derivatives; a distance fills the first component alone, and columns that were
    /// not wanted are zero.
    ///
    /// # Errors
    /// As [`Chain::predict`].
    #[inline]
    pub fn row_predict_into(
        &self,
        row: &Row<J>,
        wanted: Wanted,
        out: &mut Prediction<J, M, P>,
    ) -> Result<()> {
        if !row.is_distance() {
            return self.predict_aimed(&row.joints, row, wanted, out);
        }
        *out = self.row_predict(row, wanted)?;
        Ok(())
    }

    /// What is read with the joints of a row, or with others.
    fn predict_aimed(
        &self,
        joints: &[f64; J],
        row: &Row<J>,
        wanted: Wanted,
        out: &mut Prediction<J, M, P>,
    ) -> Result<()> {
        let (joints, known) = (SVector::from(*joints), &row.covariates);
        let target = row.aim.target;
        match self.gauge(row.aim) {
            None => {
                // no distance: what an earlier row left in the columns of what stands fixed is cleared
                gauges::clear::<R, M, P>(wanted, &mut out.by_parameters);
                self.predict_by(&self.sensor, &joints, known, &row.push, target, wanted, out)
            }
            Some(gauge) => self.predict_by(&gauge, &joints, known, &row.push, target, wanted, out),
        }
    }

    /// What reads the distance that a row holds; None where it holds a place.
    #[inline]
    fn gauge(&self, aim: Aim) -> Option<Gauge> {
        aim.from.and_then(|from| self.around.gauge(from))
    }

    /// [`Self::row_predict_into`] as a value of its own.
    ///
    /// # Errors
    /// As [`Chain::predict`].
    pub fn row_predict(&self, row: &Row<J>, wanted: Wanted) -> Result<Prediction<J, M, P>> {
        let at = |q: &[f64; J]| {
            let mut out = Prediction::new();
            self.predict_aimed(q, row, wanted, &mut out)?;
            Ok(out)
        };
        let Some(to) = &row.to else {
            return at(&row.joints);
        };
        let (a, b) = (at(&row.joints)?, at(to)?);
        let between = b.value - a.value;
        let distance = between.norm();
        // two equal places have no direction; their distance is stationary at zero
        let along = if distance > 0.0 {
            between / distance
        } else {
            SVector::zeros()
        };
        Ok(Prediction {
            value: first(distance),
            by_joints: first_row(&along, &(b.by_joints - a.by_joints)),
            by_body: first_row(&along, &(b.by_body - a.by_body)),
            by_parameters: first_row(&along, &(b.by_parameters - a.by_parameters)),
        })
    }
}

/// Derivatives along a direction, in the first row.
fn first_row<const M: usize, const N: usize>(
    along: &SVector<f64, M>,
    of: &SMatrix<f64, M, N>,
) -> SMatrix<f64, M, N> {
    let mut out = SMatrix::<f64, M, N>::zeros();
    out.set_row(0, &along.tr_mul(of));
    out
}
