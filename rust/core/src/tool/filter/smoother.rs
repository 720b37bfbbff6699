//! Depth from all readings of a run: the filter's states once more, from the last back to the first.
//!
//! Source: Rauch, Tung and Striebel, *AIAA Journal* 3, 1965, on the same model: from one reading to the next only `l` moves,
//! by what clearance and give bring into it, and by what the hole strays. How an error hangs on what is only considered is
//! carried back beside it, so that both passes owe the bench one error, not two.

use super::known::{Tied, UNKNOWNS};
use super::state::{CLEARANCE, GIVES, Known, L, N};
use crate::numbers::math::sqrt;
use nalgebra::SMatrix;

type Square = SMatrix<f64, N, N>;

/// One reading of a run: what was expected at it, what was known after it, and how `l` came to hang on clearance and give
/// since the one before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    pub(super) before: Known,
    pub(super) after: Known,
    pub(super) shares: [f64; 2],
}

/// What all readings say of `l` at one of them: by how much (mm) the estimate after it, and the one expected before it, is
/// to be moved; its variance (mm²).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Smoothed {
    /// Of the estimate after the reading.
    pub moved_mm: f64,
    /// Of the one expected before it.
    pub expected_moved_mm: f64,
    /// mm².
    pub variance: f64,
}

fn total(k: &Known) -> Square {
    Square::from_fn(|i, j| k.covariance(i, j))
}

/// `A B⁻¹` for a covariance `B`, of which some numbers may be known exactly.
fn over(a: &Square, b: &Square) -> Square {
    let scale = [(); N];
    let mut scales = scale.map(|()| 0.0);
    for (i, s) in scales.iter_mut().enumerate() {
        *s = if b[(i, i)] > 0.0 {
            1.0 / sqrt(b[(i, i)])
        } else {
            0.0
        };
    }
    let by = |m: &Square, left: bool| {
        Square::from_fn(|i, j| {
            m[(i, j)]
                * if left {
                    scales[i] * scales[j]
                } else {
                    scales[j]
                }
        })
    };
    let mut unit = by(b, true);
    for i in 0..N {
        unit[(i, i)] = 1.0 + 1e-9;
    }
    unit.cholesky().map_or_else(Square::zeros, |c| {
        let solved = c.solve(&by(a, false).transpose()).transpose();
        Square::from_fn(|i, j| solved[(i, j)] * scales[j])
    })
}

/// What all nodes say of each; `out` is as long as `nodes`.
pub fn smooth(nodes: &[Node], out: &mut [Smoothed]) {
    let mut later: Option<(Known, &Node)> = None;
    for (node, told) in nodes.iter().zip(out.iter_mut()).rev() {
        let mut s = node.after;
        if let Some((next, of)) = &later {
            // F: l alone moves
            let own = total(&node.after);
            let mut moved = own;
            for i in 0..N {
                moved[(i, L)] +=
                    of.shares[0] * own[(i, CLEARANCE)] + of.shares[1] * own[(i, GIVES)];
            }
            let gain = over(&moved, &total(&of.before));
            let square = |k: &Known| Square::from_fn(|i, j| k.p[i][j]);
            let p =
                square(&node.after) + gain * (square(next) - square(&of.before)) * gain.transpose();
            for i in 0..N {
                let mut tied: Tied = [0.0; UNKNOWNS];
                for j in 0..N {
                    s.x[i] += gain[(i, j)] * (next.x[j] - of.before.x[j]);
                    for (k, t) in tied.iter_mut().enumerate() {
                        *t += gain[(i, j)] * (next.tied[j][k] - of.before.tied[j][k]);
                    }
                    s.p[i][j] = 0.5 * (p[(i, j)] + p[(j, i)]);
                }
                for (k, t) in tied.iter().enumerate() {
                    s.tied[i][k] += t;
                }
                s.p[i][i] = s.p[i][i].max(0.0);
            }
        }
        *told = Smoothed {
            moved_mm: s.x[L] - node.after.x[L],
            expected_moved_mm: s.x[L] - node.before.x[L],
            variance: s.covariance(L, L),
        };
        later = Some((s, node));
    }
}
