//! Tensor-product Bernstein polynomials in up to three variables: evaluation, derivative, fit.
//!
//! Source: Eq. 12 of the delta paper; basis and its properties from Farouki, "The Bernstein polynomial basis:
//! a centennial retrospective", 2012. A variable of order zero is no variable. The fit is linear in the
//! coefficients, so one QR solve gives the minimum that the paper seeks by Levenberg–Marquardt.
//!
//! Outside its box a correction keeps the value at the border and fades to nothing over a margin; a NaN
//! position gives a NaN correction.

use crate::fit::{Stack, back_substitute, stack_len};
use crate::{Error, Result};
use nalgebra::{Matrix3, Vector3};

/// Highest order per variable.
pub const MAX_ORDER: usize = 8;
const WIDTH: usize = MAX_ORDER + 1;

/// The `order + 1` Bernstein polynomials at `t`, by the stable recursion; unused places are zero.
#[must_use]
pub fn basis(order: usize, t: f64) -> [f64; WIDTH] {
    let mut b = [0.0; WIDTH];
    b[0] = 1.0;
    for n in 1..=order.min(MAX_ORDER) {
        let mut carried = 0.0;
        for value in &mut b[..=n] {
            let previous = *value;
            *value = carried * t + previous * (1.0 - t);
            carried = previous;
        }
    }
    b
}

/// Derivatives of [`basis`] by `t`: `n (b_{k-1}^{n-1} - b_k^{n-1})`.
#[must_use]
pub fn basis_derivative(order: usize, t: f64) -> [f64; WIDTH] {
    let mut d = [0.0; WIDTH];
    let order = order.min(MAX_ORDER);
    if order == 0 {
        return d;
    }
    let lower = basis(order - 1, t);
    for k in 0..=order {
        let before = if k > 0 { lower[k - 1] } else { 0.0 };
        d[k] = order as f64 * (before - lower[k]);
    }
    d
}

/// Number of coefficients of a tensor product.
#[must_use]
pub const fn coefficients_len(orders: [usize; 3]) -> usize {
    (orders[0] + 1) * (orders[1] + 1) * (orders[2] + 1)
}

/// Where a correction holds, mm. A side may be infinite where the variable has order zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Domain {
    /// Lower corner of the fitted box.
    pub low: Vector3<f64>,
    /// Upper corner of the fitted box.
    pub high: Vector3<f64>,
    /// Distance over which the correction fades outside the box.
    pub fade: f64,
}

impl Domain {
    /// Coordinates in the box, held at its border, 0 to 1; and how fast they move with position.
    pub(super) fn normalised(
        &self,
        position: &Vector3<f64>,
        orders: [usize; 3],
    ) -> ([f64; 3], [f64; 3]) {
        let mut t = [0.0; 3];
        let mut rate = [0.0; 3];
        for k in 0..3 {
            if orders[k] == 0 {
                continue;
            }
            let span = self.high[k] - self.low[k];
            let raw = (position[k] - self.low[k]) / span;
            t[k] = raw.clamp(0.0, 1.0);
            if raw == t[k] {
                rate[k] = 1.0 / span;
            }
        }
        (t, rate)
    }

    /// Share of the correction that is left at a position (1 inside, 0 beyond the margin), and its gradient.
    #[must_use]
    pub fn share(&self, position: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let mut value = [1.0; 3];
        let mut slope = [0.0; 3];
        for k in 0..3 {
            let (beyond, sign) = if position[k] > self.high[k] {
                (position[k] - self.high[k], 1.0)
            } else if position[k] < self.low[k] {
                (self.low[k] - position[k], -1.0)
            } else {
                // a coordinate that is no number must not look like one inside
                if position[k].is_nan() {
                    value[k] = f64::NAN;
                }
                continue;
            };
            let t = beyond / self.fade;
            if t >= 1.0 {
                value[k] = 0.0;
            } else {
                // smoothstep: value and slope meet those of both sides
                value[k] = 1.0 - t * t * (3.0 - 2.0 * t);
                slope[k] = -sign * 6.0 * t * (1.0 - t) / self.fade;
            }
        }
        let gradient = Vector3::new(
            slope[0] * value[1] * value[2],
            slope[1] * value[0] * value[2],
            slope[2] * value[0] * value[1],
        );
        (value[0] * value[1] * value[2], gradient)
    }
}

/// A fitted correction: three tensor products over one box. Coefficients belong to the caller,
/// `[i_x][i_y][i_z]` in row-major order, one vector (x, y, z) each.
#[derive(Clone, Copy, Debug)]
pub struct Correction<'a> {
    orders: [usize; 3],
    domain: Domain,
    coefficients: &'a [[f64; 3]],
}

impl<'a> Correction<'a> {
    /// Checks and keeps the pieces.
    ///
    /// # Errors
    /// [`Error::WrongLength`] where order or number of coefficients do not fit.
    pub fn new(orders: [usize; 3], domain: Domain, coefficients: &'a [[f64; 3]]) -> Result<Self> {
        check_orders(orders)?;
        let (expected, found) = (coefficients_len(orders), coefficients.len());
        if expected != found {
            return Err(Error::WrongLength { expected, found });
        }
        Ok(Self {
            orders,
            domain,
            coefficients,
        })
    }

    /// Orders per variable.
    #[must_use]
    pub fn orders(&self) -> [usize; 3] {
        self.orders
    }

    /// Where it holds.
    #[must_use]
    pub fn domain(&self) -> &Domain {
        &self.domain
    }

    /// Coefficients, row-major.
    #[must_use]
    pub fn coefficients(&self) -> &'a [[f64; 3]] {
        self.coefficients
    }

    /// Correction at a position, mm, and its derivative by position.
    #[must_use]
    pub fn at(&self, position: &Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        let (share, gradient) = self.domain.share(position);
        let (t, rate) = self.domain.normalised(position, self.orders);
        // `new` has checked them; said again, the compiler knows that no index below is out of bounds
        let o = self.orders.map(|order| order.min(MAX_ORDER));
        let b = [basis(o[0], t[0]), basis(o[1], t[1]), basis(o[2], t[2])];
        let d = [
            basis_derivative(o[0], t[0]),
            basis_derivative(o[1], t[1]),
            basis_derivative(o[2], t[2]),
        ];
        let mut value = Vector3::zeros();
        let mut slopes = [Vector3::zeros(); 3];
        let mut coefficients = self.coefficients.iter();
        for i in 0..=o[0] {
            for j in 0..=o[1] {
                for (k, c) in coefficients.by_ref().take(o[2] + 1).enumerate() {
                    let c = Vector3::from(*c);
                    value += c * (b[0][i] * b[1][j] * b[2][k]);
                    slopes[0] += c * (d[0][i] * b[1][j] * b[2][k]);
                    slopes[1] += c * (b[0][i] * d[1][j] * b[2][k]);
                    slopes[2] += c * (b[0][i] * b[1][j] * d[2][k]);
                }
            }
        }
        let by_position = Matrix3::from_columns(&[
            slopes[0] * rate[0],
            slopes[1] * rate[1],
            slopes[2] * rate[2],
        ]);
        (
            value * share,
            by_position * share + value * gradient.transpose(),
        )
    }
}

fn check_orders(orders: [usize; 3]) -> Result<()> {
    orders
        .iter()
        .find(|o| **o > MAX_ORDER)
        .map_or(Ok(()), |&found| {
            Err(Error::WrongLength {
                expected: MAX_ORDER,
                found,
            })
        })
}

/// Folds one point into a stack of three targets whose columns are the coefficients.
pub fn push<S: AsRef<[f64]> + AsMut<[f64]>>(
    stack: &mut Stack<S>,
    orders: [usize; 3],
    domain: &Domain,
    position: &Vector3<f64>,
    target: &Vector3<f64>,
) {
    let orders = orders.map(|o| o.min(MAX_ORDER));
    let (t, _) = domain.normalised(position, orders);
    let [bx, by, bz] = [
        basis(orders[0], t[0]),
        basis(orders[1], t[1]),
        basis(orders[2], t[2]),
    ];
    let mut places = stack.next_row();
    for x in &bx[..=orders[0]] {
        for y in &by[..=orders[1]] {
            let xy = x * y;
            for (z, place) in bz[..=orders[2]].iter().zip(places.by_ref()) {
                *place = xy * z;
            }
        }
    }
    for (t, place) in target.iter().zip(places) {
        *place = *t;
    }
    stack.commit_row();
}

/// Numbers of scratch that [`project_axis`] needs.
#[must_use]
pub const fn axis_scratch_len(points: usize, order: usize) -> usize {
    stack_len(order + 1, points)
}

/// The matrix that takes values at `points` (0 to 1) to Bernstein coefficients of one variable by least
/// squares: `order + 1` rows of `points.len()`. On a grid the fit of a tensor product is the product of these.
///
/// # Errors
/// [`Error::WrongLength`] for a wrong buffer or an order above [`MAX_ORDER`]; [`Error::Singular`] where there
/// are fewer distinct points than coefficients.
pub fn project_axis(
    order: usize,
    points: &[f64],
    projector: &mut [f64],
    scratch: &mut [f64],
) -> Result<()> {
    check_orders([order, 0, 0])?;
    let (n, m) = (order + 1, points.len());
    if projector.len() != n * m {
        return Err(Error::WrongLength {
            expected: n * m,
            found: projector.len(),
        });
    }
    let mut stack = Stack::new(n, m, scratch)?;
    for (i, t) in points.iter().enumerate() {
        let b = basis(order, *t);
        let unit = (0..m).map(|j| if i == j { 1.0 } else { 0.0 });
        stack.push(b[..n].iter().copied().chain(unit));
    }
    let weakest = back_substitute(stack.triangle(), n, m, projector);
    if weakest < 1e-12 {
        return Err(Error::Singular);
    }
    Ok(())
}

/// Applies a projector (`out_len × in_len`) along the middle axis of `values`, shape `(outer, in_len, inner)`,
/// into `out`, shape `(outer, out_len, inner)`.
pub fn apply_axis(
    projector: &[f64],
    in_len: usize,
    out_len: usize,
    inner: usize,
    values: &[f64],
    out: &mut [f64],
) {
    for (block, result) in values
        .chunks_exact(in_len * inner)
        .zip(out.chunks_exact_mut(out_len * inner))
    {
        for (weights, line) in projector
            .chunks_exact(in_len)
            .zip(result.chunks_exact_mut(inner))
        {
            line.fill(0.0);
            for (w, source) in weights.iter().zip(block.chunks_exact(inner)) {
                for (o, s) in line.iter_mut().zip(source) {
                    *o += w * s;
                }
            }
        }
    }
}
