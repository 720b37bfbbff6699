//! The parameters of the whole measurement chain, and where each effect's stand among them.
//!
//! What no plan of poses can tell apart. In pixels: the scale of all lengths (radius, translation of the camera, offsets);
//! a common joint offset from a turn of the camera about the actuated axis; `ζ₁` from the marker's offset towards elbow 1
//! together with other lengths. In angles: the radius shows through offsets alone, and a common joint offset is a datum in φ.
//! Flexure is told from the geometry by gravity across the actuated axis; where it pulls along that axis and α = β, both
//! of its parameters are taken up by geometry and camera entirely.

use core::ops::Range;

/// Errors of the common proximal and distal arc, α and β, rad, and of the sphere's radius, mm.
pub const GEOMETRY: Range<usize> = 0..3;
/// Constant offset of readings in φ and γ, rad.
pub const DATUM: Range<usize> = 3..5;
/// Error of the camera's pose: turn about its own axes, rad (the image of the centre stays), and translation, mm.
pub const CAMERA_POSE: Range<usize> = 5..11;
/// Relative error of both focal lengths.
pub const FOCAL_LENGTH: Range<usize> = 11..12;
/// Error of the principal point, px.
pub const PRINCIPAL_POINT: Range<usize> = 12..14;
/// Errors of `k₁, k₂, p₁, p₂`.
pub const LENS_DISTORTION: Range<usize> = 14..18;
/// Added to each joint reading, rad.
pub const JOINT_OFFSET: Range<usize> = 18..20;
/// Relative scale error of each encoder, about its home reading.
pub const JOINT_SCALE: Range<usize> = 20..22;
/// Error of each encoder once per turn, rad: sine and cosine, joint by joint.
pub const ENCODER_ECCENTRICITY: Range<usize> = 22..26;
/// Lost motion of each joint, rad: the full width between the two directions.
pub const BACKLASH: Range<usize> = 26..28;
/// Half the difference of the limbs' α and of their β, rad: limb 1 has more, limb 2 less.
pub const UNEQUAL_LIMBS: Range<usize> = 28..30;
/// By how much each elbow axis misses the centre, mm: along the normal of the plane of the proximal link and along
/// the tangent in that plane, limb by limb.
pub const AXIS_OFFSET: Range<usize> = 30..34;
/// Bend of each distal link under the whole moment of the weight, rad.
pub const GRAVITY_FLEXURE: Range<usize> = 34..36;
/// Offset of the marker from the tool axis, mm: towards elbow 1, and at right angles to that.
pub const MARKER_OFFSET: Range<usize> = 36..38;
/// How much earlier the camera shows the robot, s.
pub const CAMERA_DELAY: Range<usize> = 38..39;
/// All parameters of the chain.
pub const PARAMETERS: usize = 39;

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
