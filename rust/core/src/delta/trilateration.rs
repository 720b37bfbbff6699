//! Where three spheres meet.
//!
//! The platform centre of a delta lies on three spheres about `s_i = b_i + q_i ẑ - p_i` with the rods as
//! radii. With `d_2 = s_2 - s_1`, `d_3 = s_3 - s_1`, `n = d_2 × d_3` and `k_j = (|d_j|² + l_1² - l_j²)/2`:
//! `x = s_1 + [k_2 (d_3 × n) + k_3 (n × d_2)]/|n|² ± t n`, `t² = (l_1² - |…|²)/|n|²`.
//! Branch-free, so that loops over lanes vectorise. A negative or NaN `t²` means that the spheres miss.

use crate::math::sqrt;
use nalgebra::Vector3;

/// The two solutions' midpoint, the half distance between them along the unit normal, squared.
#[derive(Clone, Copy, Debug)]
pub(super) struct Meeting {
    /// The chosen solution; NaN where the spheres miss.
    pub point: Vector3<f64>,
    /// Negative where the spheres miss; NaN where the centres lie on a line.
    pub height_squared: f64,
}

/// Intersection of three spheres on the side given by `sign`: +1 the lower, -1 the upper one.
#[inline(always)]
pub(super) fn meet(centres: &[Vector3<f64>; 3], radii: &[f64; 3], sign: f64) -> Meeting {
    let [s1, s2, s3] = centres;
    let d2 = s2 - s1;
    let d3 = s3 - s1;
    let n = d2.cross(&d3);
    let n_squared = n.norm_squared();
    let k2 = 0.5 * (d2.norm_squared() + (radii[0] - radii[1]) * (radii[0] + radii[1]));
    let k3 = 0.5 * (d3.norm_squared() + (radii[0] - radii[2]) * (radii[0] + radii[2]));
    let inverse = 1.0 / n_squared;
    let foot = (d3.cross(&n) * k2 + n.cross(&d2) * k3) * inverse;
    let height_squared = radii[0] * radii[0] - foot.norm_squared();
    let t = sqrt(height_squared * inverse);
    // n points up or down with the order of the limbs; "below" is against +z whatever that order
    let side = if n.z >= 0.0 { -sign } else { sign };
    Meeting {
        point: s1 + foot + n * (side * t),
        height_squared,
    }
}

/// Names the limb that keeps the spheres from meeting and the length its rod lacks (positive: too short).
///
/// The culprit is the limb whose centre stands farthest from the plane height of the other two: the usual
/// cause is one wrong joint reading. Its distance to the circle in which the other two spheres meet says
/// by how much; where those two miss each other already, the gap between them does.
pub(super) fn culprit(centres: &[Vector3<f64>; 3], radii: &[f64; 3]) -> (usize, f64) {
    let stray = |k: usize| {
        let (i, j) = others(k);
        (centres[k].z - 0.5 * (centres[i].z + centres[j].z)).abs()
    };
    let k = (0..3).fold(0, |best, k| if stray(k) > stray(best) { k } else { best });
    let (i, j) = others(k);
    let between = centres[j] - centres[i];
    let gap = between.norm();
    let axis = between / gap;
    let along = 0.5 * (gap + (radii[i] - radii[j]) * (radii[i] + radii[j]) / gap);
    let circle_squared = radii[i] * radii[i] - along * along;
    if circle_squared < 0.0 {
        return (i, gap - radii[i] - radii[j]);
    }
    let circle = sqrt(circle_squared);
    let from_middle = centres[k] - (centres[i] + axis * along);
    let height = from_middle.dot(&axis);
    let radial = (from_middle - axis * height).norm();
    let nearest = sqrt(height * height + (radial - circle) * (radial - circle));
    let farthest = sqrt(height * height + (radial + circle) * (radial + circle));
    if radii[k] < nearest {
        (k, nearest - radii[k])
    } else {
        (k, farthest - radii[k])
    }
}

fn others(k: usize) -> (usize, usize) {
    match k {
        0 => (1, 2),
        1 => (0, 2),
        _ => (0, 1),
    }
}
