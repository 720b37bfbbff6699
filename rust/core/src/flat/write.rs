//! A calibrated robot's numbers, handed on one after the other.

use super::{
    BranchParts, DELTA, LATER_OF_DELTA, LATER_OF_SERIAL, LATER_OF_SPHERICAL, Row, SERIAL, SPHERICAL,
};
use crate::Result;
use crate::delta;
use crate::delta::correction::Domain;
use crate::serial::{self, Limits};
use crate::spherical::{self, Elbows};

/// Hands every number on.
struct Writer<F>(F);

impl<F: FnMut(f64)> Row for Writer<F> {
    fn any(&mut self, value: &mut f64) -> Result<()> {
        (self.0)(*value);
        Ok(())
    }

    // what is written is a robot's own: whatever it holds stands in the row, and a reader refuses it
    fn numbers<'n>(&mut self, values: impl IntoIterator<Item = &'n mut f64>) -> Result<()> {
        values.into_iter().for_each(|value| (self.0)(*value));
        Ok(())
    }
}

impl<F: FnMut(f64)> Writer<F> {
    fn branch(&mut self, parts: &BranchParts<'_>) -> Result<()> {
        let (mut model, mut values) = (*parts.model, *parts.values);
        self.delta(&mut model, &mut values, delta::PARAMETERS)?;
        self.flag(&mut parts.correction.is_some())?;
        let Some(correction) = &parts.correction else {
            return Ok(());
        };
        self.numbers(&mut correction.orders().map(|order| order as f64))?;
        self.domain(&mut correction.domain().clone())?;
        let coefficients = correction.coefficients().as_flattened();
        for number in coefficients {
            (self.0)(*number);
        }
        Ok(())
    }
}

/// Writes a calibrated delta, number by number.
pub fn write_delta(
    whole: &BranchParts<'_>,
    local: Option<(&BranchParts<'_>, &Domain)>,
    put: impl FnMut(f64),
) {
    let mut row = Writer(put);
    let mut write = || -> Result<()> {
        row.head(DELTA, delta::PARAMETERS, LATER_OF_DELTA)?;
        row.branch(whole)?;
        row.flag(&mut local.is_some())?;
        let Some((branch, region)) = local else {
            return Ok(());
        };
        row.domain(&mut region.clone())?;
        row.branch(branch)
    };
    // a writer refuses nothing that a robot is made from
    let _ = write();
}

/// Writes a calibrated spherical robot, number by number.
pub fn write_spherical(
    model: &spherical::Model,
    values: &spherical::Values,
    mut elbows: Elbows,
    put: impl FnMut(f64),
) {
    let (mut row, mut model, mut values) = (Writer(put), *model, *values);
    let known = row.head(SPHERICAL, spherical::PARAMETERS, LATER_OF_SPHERICAL);
    let _ = known.and_then(|known| row.spherical(&mut model, &mut elbows, &mut values, known));
}

/// Writes a calibrated arm, number by number.
pub fn write_serial(
    model: &serial::Model,
    values: &serial::Values,
    limits: &Limits,
    put: impl FnMut(f64),
) {
    let (mut row, mut model, mut values) = (Writer(put), *model, *values);
    let mut limits = *limits;
    let known = row.head(SERIAL, serial::PARAMETERS, LATER_OF_SERIAL);
    let _ = known.and_then(|known| row.serial(&mut model, &mut limits, &mut values, known));
}
