//! The parameters of the whole measurement chain, and where each effect's stand among them.

use core::ops::Range;

/// Geometric errors, limb by limb (18), as in [`super::Geometry::parameters`].
pub const GEOMETRY: Range<usize> = 0..18;
/// Constant offset of the sensors, mm: x, y, z.
pub const DATUM: Range<usize> = 18..21;
/// Relative scale error of each encoder.
pub const JOINT_SCALE: Range<usize> = 21..24;
/// Error of each encoder at the period, mm: sine and cosine, joint by joint.
pub const ENCODER_CYCLIC: Range<usize> = 24..30;
/// Lost motion of each joint, mm: the full width between the two directions.
pub const BACKLASH: Range<usize> = 30..33;
/// Lean of each rail, rad: radial and tangential, limb by limb.
pub const RAIL_LEAN: Range<usize> = 33..39;
/// Difference in length of the two rods of each limb, mm.
pub const ROD_MISMATCH: Range<usize> = 39..42;
/// Stretch of each limb if it carried the platform's whole weight alone, mm.
pub const GRAVITY_SAG: Range<usize> = 42..45;
/// Expansion of the measured position, 1/°C.
pub const THERMAL_GROWTH: Range<usize> = 45..46;
/// Drift of the measured point, mm/h: x, y, z.
pub const DRIFT: Range<usize> = 46..49;
/// Step of the measured point at the slip time, mm: x, y, z.
pub const SLIP: Range<usize> = 49..52;
/// What the sensors show of each coordinate beyond the coordinate itself, mm/mm: 3 × 3, row by row.
pub const BEAM_ALIGNMENT: Range<usize> = 52..61;
/// Cubic error of each sensor at [`super::LINEARITY_SPAN_MM`] from its middle, mm.
pub const SENSOR_LINEARITY: Range<usize> = 61..64;
/// All parameters of the chain.
pub const PARAMETERS: usize = 64;

/// Values of all parameters.
pub type Values = [f64; PARAMETERS];

/// The values of one effect.
#[inline]
pub(super) fn of<const N: usize>(values: &Values, range: Range<usize>) -> [f64; N] {
    let mut out = [0.0; N];
    for (o, v) in out.iter_mut().zip(&values[range]) {
        *o = *v;
    }
    out
}
