//! Bernstein corrections: fit and evaluation.

use crate::arrays::{fixed, rows, rows_like, same_length, shaped};
use crate::errors::{shape, to_python};
use nalgebra::Vector3;
use numpy::{
    PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray4, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use sherkit_core::Result;
use sherkit_core::delta::correction::{
    Correction, Domain, MAX_ORDER, apply_axis, axis_scratch_len, basis, coefficients_len,
    project_axis, push,
};
use sherkit_core::delta::moments::{Moments, moments_len, solve_len};
use sherkit_core::fit::{Stack, back_substitute, stack_len};

/// Weakest pivot of the normal equations from which on they are as good as orthogonal rotations, to ten digits.
const WELL_DETERMINED: f64 = 0.02;

/// A fitted tensor product with its box and fade.
#[pyclass(frozen, from_py_object, module = "sherkit._core")]
#[derive(Clone)]
pub struct Bernstein {
    orders: [usize; 3],
    domain: Domain,
    coefficients: Vec<[f64; 3]>,
}

impl Bernstein {
    /// The core's view of it.
    pub fn view(&self) -> PyResult<Correction<'_>> {
        Correction::new(self.orders, self.domain, &self.coefficients).map_err(to_python)
    }
}

#[pymethods]
impl Bernstein {
    #[new]
    fn new(
        orders: [usize; 3],
        low: PyReadonlyArray1<'_, f64>,
        high: PyReadonlyArray1<'_, f64>,
        fade: f64,
        coefficients: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Self> {
        let new = Self {
            orders,
            domain: domain(&low, &high, fade)?,
            coefficients: rows::<3, _>("coefficients", &coefficients)?.to_vec(),
        };
        new.view()?;
        Ok(new)
    }

    /// Share of the correction that is left at a position.
    fn share(&self, position: PyReadonlyArray1<'_, f64>) -> PyResult<f64> {
        Ok(self
            .domain
            .share(&Vector3::from(fixed("position", &position)?))
            .0)
    }

    /// Correction `(n, 3)` and its derivative by position `(n, 3, 3)`.
    fn evaluate<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>)> {
        let positions = rows::<3, _>("positions", &positions)?.to_vec();
        let n = positions.len();
        let correction = self.view()?;
        let mut values = Vec::with_capacity(n * 3);
        let mut derivatives = Vec::with_capacity(n * 9);
        py.detach(|| {
            for x in &positions {
                let (value, derivative) = correction.at(&Vector3::from(*x));
                values.extend_from_slice(value.as_slice());
                derivatives.extend_from_slice(derivative.transpose().as_slice());
            }
        });
        Ok((
            shaped(py, values, [n, 3])?,
            shaped(py, derivatives, [n, 3, 3])?,
        ))
    }
}

/// A box with its fade.
pub fn domain(
    low: &PyReadonlyArray1<'_, f64>,
    high: &PyReadonlyArray1<'_, f64>,
    fade: f64,
) -> PyResult<Domain> {
    Ok(Domain {
        low: Vector3::from(fixed("low", low)?),
        high: Vector3::from(fixed("high", high)?),
        fade,
    })
}

/// Basis values `(n, order + 1)` at `t`.
#[pyfunction]
pub fn bernstein_basis<'py>(
    py: Python<'py>,
    order: usize,
    t: PyReadonlyArray1<'_, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    if order > MAX_ORDER {
        return Err(shape("order", &format!("at most {MAX_ORDER}"), &[order]));
    }
    let t = t.as_slice()?.to_vec();
    let of = |t: &f64| basis(order, *t).into_iter().take(order + 1);
    let numbers = py.detach(|| t.iter().flat_map(of).collect());
    shaped(py, numbers, [t.len(), order + 1])
}

/// Points and what the polynomial is to be there.
type Points<'a> = (&'a [[f64; 3]], &'a [[f64; 3]]);

/// Sums over some points.
fn moments(orders: [usize; 3], domain: Domain, (x, y): Points<'_>) -> Result<Moments<Vec<f64>>> {
    let mut moments = Moments::new(orders, domain, vec![0.0; moments_len(orders)])?;
    moments.push(x, y);
    Ok(moments)
}

/// Coefficients by the sums over points, or by orthogonal rotations of their rows where the sums determine them badly;
/// and how well the points determine them.
fn coefficients(
    orders: [usize; 3],
    domain: &Domain,
    moments: &Moments<Vec<f64>>,
    points: impl Iterator<Item = ([f64; 3], [f64; 3])>,
) -> Result<(Vec<[f64; 3]>, f64)> {
    let n = coefficients_len(orders);
    let mut found = vec![[0.0; 3]; n];
    if let Ok(weakest) = moments.solve(&mut found, &mut vec![0.0; solve_len(orders)])
        && weakest > WELL_DETERMINED
    {
        return Ok((found, weakest));
    }
    let mut stack = Stack::new(n, 3, vec![0.0; stack_len(n, 3)])?;
    for (x, y) in points {
        push(&mut stack, orders, domain, &x.into(), &y.into());
    }
    let weakest = back_substitute(stack.triangle(), n, 3, found.as_flattened_mut());
    Ok((found, weakest))
}

/// Scattered points from Python, copied.
fn points(
    orders: [usize; 3],
    positions: &PyReadonlyArray2<'_, f64>,
    targets: &PyReadonlyArray2<'_, f64>,
) -> PyResult<(Vec<[f64; 3]>, Vec<[f64; 3]>)> {
    if orders.iter().any(|o| *o > MAX_ORDER) {
        return Err(shape(
            "orders",
            &format!("at most {MAX_ORDER} each"),
            &orders,
        ));
    }
    let x = rows::<3, _>("positions", positions)?.to_vec();
    let y = rows_like::<3>("targets", targets, x.len())?.to_vec();
    Ok((x, y))
}

/// Coefficients `(k, 3)` by least squares over scattered points, and how well the points determine them.
#[pyfunction]
pub fn bernstein_fit<'py>(
    py: Python<'py>,
    orders: [usize; 3],
    low: PyReadonlyArray1<'_, f64>,
    high: PyReadonlyArray1<'_, f64>,
    positions: PyReadonlyArray2<'_, f64>,
    targets: PyReadonlyArray2<'_, f64>,
) -> PyResult<(Bound<'py, PyArray2<f64>>, f64)> {
    let domain = domain(&low, &high, 1.0)?;
    let (x, y) = points(orders, &positions, &targets)?;
    let (solution, weakest) = py
        .detach(|| {
            let all = x.iter().copied().zip(y.iter().copied());
            coefficients(orders, &domain, &moments(orders, domain, (&x, &y))?, all)
        })
        .map_err(to_python)?;
    let n = solution.len();
    Ok((shaped(py, solution.into_flattened(), [n, 3])?, weakest))
}

/// What polynomials leave of the targets `(n, 3)`, each point's fitted without its block (0 to `blocks` - 1), and how well
/// the points determine the worst of them. The sums over all points less those over a block are those over the others.
#[pyfunction]
pub fn bernstein_held_out<'py>(
    py: Python<'py>,
    orders: [usize; 3],
    low: PyReadonlyArray1<'_, f64>,
    high: PyReadonlyArray1<'_, f64>,
    positions: PyReadonlyArray2<'_, f64>,
    targets: PyReadonlyArray2<'_, f64>,
    block: PyReadonlyArray1<'_, i64>,
) -> PyResult<(Bound<'py, PyArray2<f64>>, f64)> {
    let domain = domain(&low, &high, 1.0)?;
    let (x, y) = points(orders, &positions, &targets)?;
    let block = same_length("block", &block, x.len())?.to_vec();
    let held = |block_of: i64| {
        let mut out = (Vec::new(), Vec::new());
        for (i, _) in block.iter().enumerate().filter(|(_, b)| **b == block_of) {
            out.0.push(x[i]);
            out.1.push(y[i]);
        }
        out
    };
    let (left, weakest) = py
        .detach(|| {
            let mut blocks = block.clone();
            blocks.sort_unstable();
            blocks.dedup();
            let all = moments(orders, domain, (&x, &y))?;
            let (mut left, mut worst) = (y.clone(), f64::INFINITY);
            for own in blocks {
                let (own_x, own_y) = held(own);
                let mut others = all.clone();
                others.absorb(&moments(orders, domain, (&own_x, &own_y))?, -1.0)?;
                let seen = (0..x.len())
                    .filter(|&i| block[i] != own)
                    .map(|i| (x[i], y[i]));
                let (found, weakest) = coefficients(orders, &domain, &others, seen)?;
                worst = worst.min(weakest);
                let fitted = Correction::new(orders, domain, &found)?;
                for i in (0..x.len()).filter(|&i| block[i] == own) {
                    let (predicted, _) = fitted.at(&x[i].into());
                    left[i] = [0, 1, 2].map(|k| y[i][k] - predicted[k]);
                }
            }
            Ok((left, worst))
        })
        .map_err(to_python)?;
    let n = left.len();
    Ok((shaped(py, left.into_flattened(), [n, 3])?, weakest))
}

/// Coefficients `(k, 3)` from values `(n_x, n_y, n_z, 3)` on a grid with the given axes (0 to 1), one small
/// solve per axis.
#[pyfunction]
pub fn bernstein_fit_grid<'py>(
    py: Python<'py>,
    orders: [usize; 3],
    axes: (
        PyReadonlyArray1<'_, f64>,
        PyReadonlyArray1<'_, f64>,
        PyReadonlyArray1<'_, f64>,
    ),
    values: PyReadonlyArray4<'_, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let axes = [
        axes.0.as_slice()?.to_vec(),
        axes.1.as_slice()?.to_vec(),
        axes.2.as_slice()?.to_vec(),
    ];
    let expected = [axes[0].len(), axes[1].len(), axes[2].len(), 3];
    if values.shape() != expected {
        return Err(shape("values", &format!("{expected:?}"), values.shape()));
    }
    let mut current = values.as_slice()?.to_vec();
    let mut dims = expected;
    py.detach(|| {
        for k in 0..3 {
            let (points, n) = (axes[k].len(), orders[k] + 1);
            let mut projector = vec![0.0; n * points];
            let mut scratch = vec![0.0; axis_scratch_len(points, orders[k])];
            project_axis(orders[k], &axes[k], &mut projector, &mut scratch)?;
            let inner = dims[k + 1..].iter().product();
            dims[k] = n;
            let mut next = vec![0.0; dims.iter().product()];
            apply_axis(&projector, points, n, inner, &current, &mut next);
            current = next;
        }
        Ok(())
    })
    .map_err(to_python)?;
    shaped(py, current, [coefficients_len(orders), 3])
}
