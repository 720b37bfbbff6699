//! Which fibre slips, from what bends leave in the means of the sections.

use crate::tool::sensing::FIBRES;

/// Least readings; the least `a` of a fibre that slips, nine in a hundred, beyond what fibres lag; what it may leave of the
/// differences at most, and by how much more any other must.
const SLIPS: f64 = 100.0;
const SLIPPED: f64 = 0.03;
const EXPLAINED: f64 = 0.05;
const ALONE: f64 = 3.0;

/// Which fibre slips: means' differences regressed on what each fibre should show of the bend.
///
/// A fibre that answers by a share `s` less takes `-a p` from the mean of its section, where `p` is what the moments say
/// of it, distorted as they then are: `a = (s/3)/(1 - 2s/3)`. So do all sections of the fibre by one `a`; III, unbent,
/// stays. What warmth makes is the regression's constant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Slips {
    n: f64,
    /// Sums of both differences and of their squares, then of each fibre's `p`: itself, its square, and with the differences.
    d: [f64; 2],
    dd: f64,
    x: [[f64; 2]; FIBRES],
    xx: [f64; FIBRES],
    xd: [f64; FIBRES],
}

impl Slips {
    /// Differences of means (of I and II, of III and both, nm), and `p` of each fibre in sections I and II.
    pub(super) fn add(&mut self, keeps: f64, d: [f64; 2], p: [[f64; FIBRES]; 2]) {
        let more = |sum: &mut f64, x: f64| *sum = keeps * *sum + x;
        more(&mut self.n, 1.0);
        more(&mut self.dd, d[0] * d[0] + d[1] * d[1]);
        (0..2).for_each(|j| more(&mut self.d[j], d[j]));
        for k in 0..FIBRES {
            let x = [p[1][k] - p[0][k], 0.5 * (p[0][k] + p[1][k])];
            (0..2).for_each(|j| more(&mut self.x[k][j], x[j]));
            more(&mut self.xx[k], x[0] * x[0] + x[1] * x[1]);
            more(&mut self.xd[k], x[0] * d[0] + x[1] * d[1]);
        }
    }

    /// The fibre that slips, where one does and no other could: what it leaves of the differences is a small part of them,
    /// and of what any other leaves.
    pub(super) fn slipping(&self, noise: f64) -> Option<usize> {
        let spread = |a: [f64; 2], b: [f64; 2], ab: f64| ab - (a[0] * b[0] + a[1] * b[1]) / self.n;
        let all = spread(self.d, self.d, self.dd);
        let (mut best, mut least, mut next) = (None, f64::INFINITY, f64::INFINITY);
        for k in 0..FIBRES {
            let xx = spread(self.x[k], self.x[k], self.xx[k]);
            let xd = spread(self.x[k], self.d, self.xd[k]);
            let explains = xd > SLIPPED * xx && xx > 0.0;
            let left = all - if explains { xd * xd / xx } else { 0.0 };
            if left < least {
                (best, least, next) = (Some(k), left, least);
            } else {
                next = next.min(left);
            }
        }
        let least = least.max(0.0) + 2.0 * noise * self.n;
        best.filter(|_| self.n >= SLIPS && least < EXPLAINED * all && next > ALONE * least)
    }
}
