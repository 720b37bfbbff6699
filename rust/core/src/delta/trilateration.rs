//! Where three spheres meet.
//!
//! The platform centre of a delta lies on three spheres about `s_i = b_i + q_i ẑ - p_i` with the rods as
//! radii. With `d_2 = s_2 - s_1`, `d_3 = s_3 - s_1`, `n = d_2 × d_3` and `k_j = (|d_j|² + l_1² - l_j²)/2`:
//! `x = s_1 + [k_2 (d_3 × n) + k_3 (n × d_2)]/|n|² ± t n`, `t² = (l_1² - |…|²)/|n|²`.
//! Branch-free, so that loops over lanes vectorise. A negative or NaN `t²` means that the spheres miss.

use crate::numbers::math::{Real, Triple, add, cross, dot, scale, sqrt, subtract};
use nalgebra::Vector3;

/// Where the spheres meet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Meeting<T> {
    /// The chosen solution; NaN where the spheres miss.
    pub point: Triple<T>,
    /// Squared distance of the solution from the plane of the centres: negative where the spheres miss, NaN
    /// where the centres lie on a line.
    pub height_squared: T,
}

/// Intersection of three spheres. `side` is +1 or -1: along the normal `d_2 × d_3` or against it.
#[inline(always)]
pub(super) fn meet<T: Real>(centres: &[Triple<T>; 3], radii: &[f64; 3], side: f64) -> Meeting<T> {
    let [s1, s2, s3] = *centres;
    let d2 = subtract(s2, s1);
    let d3 = subtract(s3, s1);
    let n = cross(d2, d3);
    let half = T::splat(0.5);
    let e2 = 0.5 * (radii[0] - radii[1]) * (radii[0] + radii[1]);
    let e3 = 0.5 * (radii[0] - radii[2]) * (radii[0] + radii[2]);
    let k2 = half * dot(d2, d2) + T::splat(e2);
    let k3 = half * dot(d3, d3) + T::splat(e3);
    let inverse = T::splat(1.0) / dot(n, n);
    let foot = scale(
        add(scale(cross(d3, n), k2), scale(cross(n, d2), k3)),
        inverse,
    );
    let height_squared = T::splat(radii[0] * radii[0]) - dot(foot, foot);
    let t = T::splat(side) * (height_squared * inverse).root();
    Meeting {
        point: add(s1, add(foot, scale(n, t))),
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
    // the nearer end of what would do: just beyond the edge of reach the miss is a rounding error
    let miss = |limb: usize, shortest: f64, longest: f64| {
        let middle = 0.5 * (shortest + longest);
        let wanted = if radii[limb] < middle {
            shortest
        } else {
            longest
        };
        (limb, wanted - radii[limb])
    };
    if circle_squared < 0.0 {
        return miss(i, (gap - radii[j]).abs(), gap + radii[j]);
    }
    let circle = sqrt(circle_squared);
    let from_middle = centres[k] - (centres[i] + axis * along);
    let height = from_middle.dot(&axis);
    let radial = (from_middle - axis * height).norm();
    let nearest = sqrt(height * height + (radial - circle) * (radial - circle));
    let farthest = sqrt(height * height + (radial + circle) * (radial + circle));
    miss(k, nearest, farthest)
}

fn others(k: usize) -> (usize, usize) {
    match k {
        0 => (1, 2),
        1 => (0, 2),
        _ => (0, 1),
    }
}
