//! The rigid transform that takes one cloud of points to another.
//!
//! Source: Eqs. 15 to 19 of the tool paper (its reference 36: Besl 1992), and by singular values (Kabsch 1978, with
//! Umeyama's guard against reflections). Both read the same moments, which points are folded into one by one,
//! so that a run of any length needs no memory. Eq. 17 of the paper puts the target first; with Eq. 18 as it is
//! printed (and as its reference defines it, source first) that would give the transform's inverse, so
//! the source stands first here.
//!
//! Lengths are mm, angles rad.

use crate::numbers::jacobi::{singular_values, symmetric_eigen};
use crate::numbers::math::sqrt;
use crate::numbers::rigid::Rigid;
use crate::{Error, Result};
use core::iter::zip;
use nalgebra::{Matrix3, Matrix6, Vector3};

/// Points that fix a rigid transform.
const LEAST_POINTS: usize = 3;
/// Width across over length along, below which points that are exact to rounding stand on a line.
const COLLINEAR: f64 = 1e-6;
/// A cloud less wide than this times the residuals' standard deviation is wide only by its noise.
const NOISE_WIDTHS: f64 = 2.0;

/// How the rotation is found. The results agree to rounding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// The eigenvector of the 4 × 4 matrix of Eq. 18.
    #[default]
    Quaternion,
    /// Singular vectors of the cross covariance.
    SingularValues,
}

/// Moments of pairs of points: count, means, scatter. Welford's update, so that clouds far from the origin
/// lose nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moments {
    count: usize,
    source: Vector3<f64>,
    target: Vector3<f64>,
    /// `Σ (a - ā)(a - ā)ᵀ` of the source.
    source_scatter: Matrix3<f64>,
    /// `Σ |b - b̄|²` of the target.
    target_spread: f64,
    /// `Σ (a - ā)(b - b̄)ᵀ`, source first.
    cross: Matrix3<f64>,
}

impl Default for Moments {
    fn default() -> Self {
        Self {
            count: 0,
            source: Vector3::zeros(),
            target: Vector3::zeros(),
            source_scatter: Matrix3::zeros(),
            target_spread: 0.0,
            cross: Matrix3::zeros(),
        }
    }
}

/// A transform and how well the points fix it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registration {
    /// Takes source points to target points.
    pub transform: Rigid,
    /// Variance of a residual along one axis, mm²: squared residuals over `3 n - 6`. It is a difference of
    /// moments: below `1e-8` of the cloud's size its root is rounding; the residuals themselves tell better.
    pub residual_variance: f64,
    /// Width across over length along, as the cross covariance tells: zero for a line.
    pub width_ratio: f64,
    /// Inverse of the normal matrix: times the variance of one coordinate it is the covariance of a small
    /// rotation (rad, applied after the transform's own, about the target frame's axes) and of the
    /// translation (mm), in this order.
    pub unit_covariance: Matrix6<f64>,
}

impl Registration {
    /// Covariance of (rotation, translation) for points whose coordinates have this variance, mm².
    #[must_use]
    pub fn covariance(&self, variance: f64) -> Matrix6<f64> {
        self.unit_covariance * variance
    }
}

impl Moments {
    /// Adds a pair.
    ///
    /// # Errors
    /// [`Error::NotFinite`] names the component (source 0 to 2, target 3 to 5); the pair is not taken.
    pub fn push(&mut self, source: &Vector3<f64>, target: &Vector3<f64>) -> Result<()> {
        if let Some(index) = source.iter().chain(target).position(|x| !x.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        self.count += 1;
        let share = 1.0 / self.count as f64;
        let (a, b) = (source - self.source, target - self.target);
        self.source += a * share;
        self.target += b * share;
        let (a_new, b_new) = (source - self.source, target - self.target);
        self.source_scatter += a * a_new.transpose();
        self.target_spread += b.dot(&b_new);
        self.cross += a * b_new.transpose();
        Ok(())
    }

    /// Pairs so far.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// The transform of least squared residuals.
    ///
    /// # Errors
    /// [`Error::TooFew`] below three pairs; [`Error::Collinear`] where the points stand on a line, or are no
    /// wider across it than twice what the residuals are.
    pub fn solve(&self, method: Method) -> Result<Registration> {
        if self.count < LEAST_POINTS {
            return Err(Error::TooFew {
                needed: LEAST_POINTS,
                found: self.count,
            });
        }
        let n = self.count as f64;
        let (values, left, right) = singular_values(self.cross.data.0);
        let sign = if self.cross.determinant() < 0.0 {
            -1.0
        } else {
            1.0
        };
        // what holds the turn about the longest axis: half the gap of the eigenvalues of Eq. 18
        let across = values[1] + sign * values[2];
        let width_ratio = sqrt((across / values[0]).max(0.0));
        // a cloud in one point has 0/0 here, and is refused as well
        if width_ratio.is_nan() || width_ratio <= COLLINEAR {
            let ratio = if width_ratio.is_nan() {
                0.0
            } else {
                width_ratio
            };
            return Err(Error::Collinear { ratio });
        }
        let rotation = match method {
            Method::Quaternion => by_quaternion(&self.cross),
            Method::SingularValues => by_singular_vectors(&left, &right),
        };
        let explained = (rotation * self.cross).trace();
        let squares = self.source_scatter.trace() + self.target_spread - 2.0 * explained;
        let residual_variance = squares.max(0.0) / (3.0 * n - 6.0);
        if across / n < NOISE_WIDTHS * NOISE_WIDTHS * residual_variance {
            return Err(Error::Collinear { ratio: width_ratio });
        }
        let moved = rotation * self.source;
        Ok(Registration {
            transform: Rigid {
                rotation,
                translation: self.target - moved,
            },
            residual_variance,
            width_ratio,
            unit_covariance: self.unit_covariance(&rotation, &moved)?,
        })
    }

    /// About the centroid, turn and shift do not mix: `(tr S 1 - S)⁻¹` and `1/n`. The shift of the frame's
    /// origin then moves with the turn by the lever of the centroid.
    fn unit_covariance(
        &self,
        rotation: &Matrix3<f64>,
        centroid: &Vector3<f64>,
    ) -> Result<Matrix6<f64>> {
        let scatter = rotation * self.source_scatter * rotation.transpose();
        let information = Matrix3::identity() * scatter.trace() - scatter;
        let turn = information.try_inverse().ok_or(Error::Singular)?;
        let turn = (turn + turn.transpose()) * 0.5;
        let lever = centroid.cross_matrix();
        let mixed = turn * lever.transpose();
        let shift = lever * mixed + Matrix3::identity() / self.count as f64;
        let mut all = Matrix6::zeros();
        all.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        all.fixed_view_mut::<3, 3>(0, 3).copy_from(&mixed);
        all.fixed_view_mut::<3, 3>(3, 0)
            .copy_from(&mixed.transpose());
        all.fixed_view_mut::<3, 3>(3, 3).copy_from(&shift);
        Ok(all)
    }
}

/// Eq. 18: the eigenvector of the largest eigenvalue is the unit quaternion.
fn by_quaternion(s: &Matrix3<f64>) -> Matrix3<f64> {
    let trace = s.trace();
    let delta = [
        s[(1, 2)] - s[(2, 1)],
        s[(2, 0)] - s[(0, 2)],
        s[(0, 1)] - s[(1, 0)],
    ];
    let mut q = [[0.0; 4]; 4];
    q[0][0] = trace;
    for i in 0..3 {
        q[0][i + 1] = delta[i];
        q[i + 1][0] = delta[i];
        for j in 0..3 {
            let diagonal = if i == j { trace } else { 0.0 };
            q[i + 1][j + 1] = s[(i, j)] + s[(j, i)] - diagonal;
        }
    }
    let [w, x, y, z] = symmetric_eigen(q).1[0];
    Matrix3::new(
        w * w + x * x - y * y - z * z,
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        w * w - x * x + y * y - z * z,
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        w * w - x * x - y * y + z * z,
    )
}

/// Two pairs of singular vectors and their cross products: the third pair's sign, in which a reflection would
/// hide, is never asked for, and a flat cloud (third value zero) needs no case of its own.
fn by_singular_vectors(left: &[[f64; 3]; 3], right: &[[f64; 3]; 3]) -> Matrix3<f64> {
    let complete = |rows: &[[f64; 3]; 3]| {
        let (a, b) = (Vector3::from(rows[0]), Vector3::from(rows[1]));
        Matrix3::from_columns(&[a, b, a.cross(&b)])
    };
    // cross = Σ left · value · rightᵀ with the source on the left, so the rotation takes left to right
    complete(right) * complete(left).transpose()
}

/// Rounds in which the pairs that tell a transform are chosen anew; those count that are off by no more than so many times
/// the median; and how wide beside its largest coordinate a cloud is that is more than a line.
const ROUNDS: usize = 5;
const FAR: f64 = 5.0;
const LINE: f64 = 1e-3;

/// The transform of most pairs of points, and by how much half of all are off or less, mm; `mirrored`, the best turn with a
/// mirror. None where fewer than `fewest` tell it, or these stand in a line. Pairs that are not finite and pairs far off do
/// not count; `missed` holds how far off each is, and `room` as many numbers more.
///
/// Source: Kabsch 1976, on what is left of the pairs in each round.
pub fn of_most(
    pairs: impl Iterator<Item = (Vector3<f64>, Vector3<f64>)> + Clone,
    mirrored: bool,
    fewest: usize,
    missed: &mut [f64],
    room: &mut [f64],
) -> Option<(Rigid, f64)> {
    let mut limit = f64::MAX;
    for ((from, to), missed) in zip(pairs.clone(), missed.iter_mut()) {
        let finite = from.iter().chain(&to).all(|x| x.is_finite());
        *missed = if finite { 0.0 } else { f64::INFINITY };
    }
    let mut found = None;
    for _ in 0..ROUNDS {
        let near = || {
            let marked = zip(pairs.clone(), missed.iter());
            marked.filter(|(_, m)| **m <= limit).map(|(pair, _)| pair)
        };
        let count = near().count();
        if count < fewest.max(1) {
            return found;
        }
        let (mut from, mut to) = (Vector3::zeros(), Vector3::zeros());
        for (a, b) in near() {
            from += a;
            to += b;
        }
        (from, to) = (from / count as f64, to / count as f64);
        let (mut scatter, mut cross) = (Matrix3::zeros(), Matrix3::zeros());
        let mut largest = 0.0_f64;
        for (a, b) in near() {
            let a = a - from;
            largest = largest.max(a.amax());
            scatter += a * a.transpose();
            cross += a * (b - to).transpose();
        }
        let wide = LINE * largest;
        if symmetric_eigen(scatter.data.0).0[1] <= wide * wide {
            return found;
        }
        let (_, left, right) = singular_values(cross.data.0);
        let mut turn = by_singular_vectors(&left, &right);
        if mirrored {
            let [a, b] = [&right, &left].map(|v| Vector3::from(v[0]).cross(&Vector3::from(v[1])));
            turn -= a * b.transpose() * 2.0;
        }
        let transform = Rigid {
            rotation: turn,
            translation: to - turn * from,
        };
        let (mut finite, mut changed) = (0, false);
        let before = limit;
        for ((a, b), missed) in zip(pairs.clone(), missed.iter_mut()) {
            if missed.is_finite() {
                let off = (b - to - turn * (a - from)).norm();
                // whether it told this transform is kept in the sign until the next limit is known
                *missed = if *missed <= before { off } else { -off };
                if let Some(place) = room.get_mut(finite) {
                    *place = off;
                    finite += 1;
                }
            }
        }
        let median = middle_of(room.get_mut(..finite)?)?;
        if !median.is_finite() {
            return None;
        }
        limit = (FAR * median).max(1e-300);
        for missed in missed.iter_mut() {
            let (told, off) = (missed.is_sign_positive(), missed.abs());
            changed |= off.is_finite() && told != (off <= limit);
            *missed = off;
        }
        found = Some((transform, median));
        if !changed {
            break;
        }
    }
    found
}

/// The median of numbers, whose order changes; None where there are none.
fn middle_of(numbers: &mut [f64]) -> Option<f64> {
    let half = numbers.len() / 2;
    if half >= numbers.len() {
        return None;
    }
    let odd = numbers.len() % 2 == 1;
    let (below, &mut middle, _) = numbers.select_nth_unstable_by(half, f64::total_cmp);
    let largest = below.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    Some(if odd {
        middle
    } else {
        0.5 * (largest + middle)
    })
}
