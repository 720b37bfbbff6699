//! Predictions of rows: of readings at one place, or of a distance, which fills the first component alone.

use super::effects::Wanted;
use super::gauges::{self, Around, Gauge};
use super::mechanism::Mechanism;
use super::robot::{Chain, Robot};
use super::row::{Aim, Prediction, Row};
use super::sensor::{Itself, first};
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
        let (known, target) = (&row.covariates, row.aim.target);
        let joints = SVector::from(row.joints);
        if let Some(to) = &row.to {
            let there = SVector::from(*to);
            let a = self.value_by(&Itself, &joints, known, &row.push, target)?;
            let b = self.value_by(&Itself, &there, known, &Vector3::zeros(), target)?;
            return Ok(first((b - a).norm() + self.around.zero()));
        }
        match self.gauge(row.aim) {
            None => self.value_by(&self.sensor, &joints, known, &row.push, target),
            Some(gauge) => self.value_by(&gauge, &joints, known, &row.push, target),
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
            return self.predict_aimed(row, wanted, out);
        }
        *out = self.row_predict(row, wanted)?;
        Ok(())
    }

    /// What is read at one place.
    fn predict_aimed(
        &self,
        row: &Row<J>,
        wanted: Wanted,
        out: &mut Prediction<J, M, P>,
    ) -> Result<()> {
        let (joints, known) = (SVector::from(row.joints), &row.covariates);
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

    /// [`Self::row_predict_into`] as a value of its own. Of a distance between two places the derivatives by joints and body
    /// are those of its first end; those of the other are the first's where the ends are exchanged.
    ///
    /// # Errors
    /// As [`Chain::predict`].
    pub fn row_predict(&self, row: &Row<J>, wanted: Wanted) -> Result<Prediction<J, M, P>> {
        let Some(to) = &row.to else {
            let mut out = Prediction::new();
            self.predict_aimed(row, wanted, &mut out)?;
            return Ok(out);
        };
        let at = |q: &[f64; J], push| {
            let (mut out, joints) = (Prediction::new(), SVector::from(*q));
            let (known, target) = (&row.covariates, row.aim.target);
            self.predict_by(&Itself, &joints, known, push, target, wanted, &mut out)?;
            Ok(out)
        };
        let (a, b) = (at(&row.joints, &row.push)?, at(to, &Vector3::zeros())?);
        let between = b.value - a.value;
        let distance = between.norm();
        // two equal places have no direction; their distance is stationary at zero
        let along = if distance > 0.0 {
            between / distance
        } else {
            SVector::zeros()
        };
        let mut out = Prediction {
            value: first(distance + self.around.zero()),
            by_joints: first_row(&-along, &a.by_joints),
            by_body: first_row(&-along, &a.by_body),
            by_parameters: first_row(&along, &(b.by_parameters - a.by_parameters)),
        };
        if let Some(place) = wanted.wants(R::AT.bar.bar_zero) {
            out.by_parameters[(0, place.start)] = 1.0;
        }
        Ok(out)
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
