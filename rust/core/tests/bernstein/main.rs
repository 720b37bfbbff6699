//! Bernstein polynomials: the basis, the fit in both its forms, and the correction inside and outside its box.

#[path = "../common/mod.rs"]
mod common;
mod refused;

use common::{Random, config, derivative};
use nalgebra::{SVector, Vector3};
use proptest::prelude::*;
use sherkit_core::Error;
use sherkit_core::delta::correction::{
    Correction, Domain, MAX_ORDER, apply_axis, axis_scratch_len, basis, basis_derivative,
    coefficients_len, project_axis, push,
};
use sherkit_core::delta::moments::{Moments, moments_len, solve_len};
use sherkit_core::fit::{Stack, back_substitute, stack_len};

const WIDTH: usize = MAX_ORDER + 1;

fn domain() -> Domain {
    Domain {
        low: Vector3::new(-40.0, -30.0, -200.0),
        high: Vector3::new(60.0, 50.0, -120.0),
        fade: 15.0,
    }
}

/// A tensor polynomial in normalised coordinates with random monomial coefficients, three components.
struct Polynomial {
    orders: [usize; 3],
    monomials: Vec<Vector3<f64>>,
}

impl Polynomial {
    fn random(random: &mut Random, orders: [usize; 3]) -> Self {
        let monomials = (0..coefficients_len(orders))
            .map(|_| Vector3::from_fn(|_, _| random.unit()))
            .collect();
        Self { orders, monomials }
    }

    fn at(&self, domain: &Domain, position: &Vector3<f64>) -> Vector3<f64> {
        let t = (position - domain.low).component_div(&(domain.high - domain.low));
        let mut sum = Vector3::zeros();
        let mut monomials = self.monomials.iter();
        for i in 0..=self.orders[0] {
            for j in 0..=self.orders[1] {
                for k in 0..=self.orders[2] {
                    // a variable of order zero may have a box without sides
                    let powers = [(t.x, i), (t.y, j), (t.z, k)].map(|(t, n)| match n {
                        0 => 1.0,
                        n => t.powi(i32::try_from(n).unwrap()),
                    });
                    sum += monomials.next().unwrap() * powers.iter().product::<f64>();
                }
            }
        }
        sum
    }
}

fn inside(random: &mut Random, domain: &Domain) -> Vector3<f64> {
    Vector3::from_fn(|k, _| {
        domain.low[k] + (0.5 + 0.5 * random.unit()) * (domain.high[k] - domain.low[k])
    })
}

/// Fits by rows: coefficients and how well they are determined.
fn fit(
    orders: [usize; 3],
    domain: &Domain,
    points: &[(Vector3<f64>, Vector3<f64>)],
) -> (Vec<[f64; 3]>, f64) {
    let n = coefficients_len(orders);
    let mut stack = Stack::new(n, 3, vec![0.0; stack_len(n, 3)]).unwrap();
    for (position, target) in points {
        push(&mut stack, orders, domain, position, target);
    }
    let mut solution = vec![f64::NAN; 3 * n];
    let weakest = back_substitute(stack.triangle(), n, 3, &mut solution);
    let coefficients = solution
        .chunks_exact(3)
        .map(|c| [c[0], c[1], c[2]])
        .collect();
    (coefficients, weakest)
}

/// Fits on a grid, one axis after the other.
fn fit_grid(
    orders: [usize; 3],
    axes: &[Vec<f64>; 3],
    mut values: Vec<f64>,
) -> Result<Vec<[f64; 3]>, Error> {
    for k in 0..3 {
        let (n, m) = (orders[k] + 1, axes[k].len());
        let mut projector = vec![f64::NAN; n * m];
        let mut scratch = vec![f64::NAN; axis_scratch_len(m, orders[k])];
        project_axis(orders[k], &axes[k], &mut projector, &mut scratch)?;
        let inner = 3 * axes[k + 1..].iter().map(Vec::len).product::<usize>();
        let mut out = vec![f64::NAN; values.len() / m * n];
        apply_axis(&projector, m, n, inner, &values, &mut out);
        values = out;
    }
    Ok(values.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect())
}

/// Distinct points from 0 to 1, unevenly spaced.
fn axis(random: &mut Random, count: usize) -> Vec<f64> {
    (0..count)
        .map(|i| (i as f64 + 0.5 + 0.4 * random.unit()) / count as f64)
        .collect()
}

fn orders(highest: usize) -> impl Strategy<Value = [usize; 3]> {
    prop::array::uniform3(0..=highest)
}

fn corrections() -> impl Strategy<Value = ([usize; 3], Vec<[f64; 3]>)> {
    (orders(3), any::<u64>()).prop_map(|(orders, seed)| {
        let mut random = Random(seed);
        let coefficients = (0..coefficients_len(orders))
            .map(|_| std::array::from_fn(|_| random.unit()))
            .collect();
        (orders, coefficients)
    })
}

fn difference(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter()
        .flatten()
        .zip(b.iter().flatten())
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}

proptest! {
    #![proptest_config(config())]

    /// A recursion with a wrong index: values that are no partition of unity, negative, not symmetric, or not the
    /// binomial form; places beyond the order that are not zero.
    #[test]
    fn basis_is_bernsteins(order in 0..=MAX_ORDER, t in 0.0..=1.0_f64, beyond in -0.5..1.5_f64) {
        let b = basis(order, t);
        prop_assert!((b.iter().sum::<f64>() - 1.0).abs() < 1e-14);
        prop_assert!((basis(order, beyond).iter().sum::<f64>() - 1.0).abs() < 1e-12);
        prop_assert!(b.iter().all(|x| *x >= 0.0));
        prop_assert!(b[order + 1..].iter().all(|x| *x == 0.0));
        let mirrored = basis(order, 1.0 - t);
        let mut binomial = 1.0;
        for k in 0..=order {
            let (i, j) = (i32::try_from(k).unwrap(), i32::try_from(order - k).unwrap());
            prop_assert!((b[k] - binomial * t.powi(i) * (1.0 - t).powi(j)).abs() < 1e-14);
            prop_assert!((b[k] - mirrored[order - k]).abs() < 1e-14);
            binomial = binomial * (order - k) as f64 / (k + 1) as f64;
        }
    }

    /// A slope that is not that of the values, at the ends too.
    #[test]
    fn basis_derivative_is_that_of_the_basis(order in 0..=MAX_ORDER, t in 0.0..=1.0_f64, end in 0..4_u8) {
        let t = match end { 0 => 0.0, 1 => 1.0, _ => t };
        let d = basis_derivative(order, t);
        prop_assert!(d.iter().sum::<f64>().abs() < 1e-12);
        let differences = derivative(|h| SVector::<f64, WIDTH>::from(basis(order, t + h)), 1e-3);
        prop_assert!((SVector::from(d) - differences).amax() < 1e-7);
    }

    /// Coefficients in another order than the correction reads them, a component that takes another's target, a
    /// fit that is not exact where it can be.
    #[test]
    fn random_points_of_a_polynomial_are_reproduced(seed in any::<u64>(), orders in orders(3)) {
        let (mut random, domain) = (Random(seed), domain());
        let polynomial = Polynomial::random(&mut random, orders);
        let points: Vec<_> = (0..4 * coefficients_len(orders))
            .map(|_| {
                let x = inside(&mut random, &domain);
                (x, polynomial.at(&domain, &x))
            })
            .collect();
        let (coefficients, weakest) = fit(orders, &domain, &points);
        prop_assume!(weakest > 1e-5);
        let correction = Correction::new(orders, domain, &coefficients).unwrap();
        for _ in 0..20 {
            let x = inside(&mut random, &domain);
            let miss = (correction.at(&x).0 - polynomial.at(&domain, &x)).amax();
            prop_assert!(miss < 1e-8, "{miss} {weakest}");
        }
    }

    /// A grid fit that runs along the wrong axis, in either of its two forms; both must reproduce the polynomial
    /// and agree, for orders up to the highest.
    #[test]
    fn grids_of_a_polynomial_are_reproduced_by_rows_and_by_axes(
        seed in any::<u64>(),
        orders in prop_oneof![orders(3), (0..=MAX_ORDER, 0..3_usize).prop_map(|(n, k)| {
            let mut orders = [1; 3];
            orders[k] = n;
            orders
        })],
        extra in prop::array::uniform3(0..4_usize),
        noise in prop_oneof![Just(0.0), Just(1.0)],
    ) {
        let (mut random, domain) = (Random(seed), domain());
        let polynomial = Polynomial::random(&mut random, orders);
        let axes: [Vec<f64>; 3] = std::array::from_fn(|k| axis(&mut random, orders[k] + 1 + extra[k]));
        let mut points = Vec::new();
        for x in &axes[0] {
            for y in &axes[1] {
                for z in &axes[2] {
                    let t = Vector3::new(*x, *y, *z);
                    let position = domain.low + t.component_mul(&(domain.high - domain.low));
                    let noise = Vector3::from_fn(|_, _| noise * random.unit());
                    points.push((position, polynomial.at(&domain, &position) + noise));
                }
            }
        }
        let (by_rows, weakest) = fit(orders, &domain, &points);
        prop_assume!(weakest > 1e-4);
        let values = points.iter().flat_map(|(_, v)| [v.x, v.y, v.z]).collect();
        let by_axes = fit_grid(orders, &axes, values).unwrap();
        let size = by_rows.iter().flatten().fold(1.0, |m: f64, c| m.max(c.abs()));
        prop_assert!(difference(&by_rows, &by_axes) < 1e-8 * size, "{}", difference(&by_rows, &by_axes) / size);
        if noise == 0.0 {
            for coefficients in [&by_rows, &by_axes] {
                let correction = Correction::new(orders, domain, coefficients).unwrap();
                let x = inside(&mut random, &domain);
                prop_assert!((correction.at(&x).0 - polynomial.at(&domain, &x)).amax() < 1e-8 * size);
            }
        }
    }

    /// Moments that are not those of the rows: fitted by them or by rotations, noise must give the same polynomial, all
    /// points at once, in two heaps, and with some added and taken away again.
    #[test]
    fn moments_and_rotations_give_the_same_polynomial(seed in any::<u64>(), orders in orders(4), extra in 0..40_usize) {
        let mut random = Random(seed);
        let domain = domain();
        let points: Vec<_> = (0..6 * coefficients_len(orders) + extra)
            .map(|_| (inside(&mut random, &domain), Vector3::from_fn(|_, _| random.unit())))
            .collect();
        let (by_rows, _) = fit(orders, &domain, &points);
        let empty = || Moments::new(orders, domain, vec![f64::NAN; moments_len(orders)]).unwrap();
        let of = |points: &[(Vector3<f64>, Vector3<f64>)]| {
            let (x, y): (Vec<[f64; 3]>, Vec<[f64; 3]>) =
                points.iter().map(|(x, y)| (<[f64; 3]>::from(*x), <[f64; 3]>::from(*y))).unzip();
            let mut sums = empty();
            sums.push(&x, &y);
            sums
        };
        let half = points.len() / 2;
        let mut two = of(&points[..half]);
        two.absorb(&of(&points[half..]), 1.0).unwrap();
        let mut back = of(&points);
        let others = of(&points[..half]);
        back.absorb(&others, 1.0).unwrap();
        back.absorb(&others, -1.0).unwrap();
        for sums in [of(&points), two, back] {
            let mut coefficients = vec![[f64::NAN; 3]; coefficients_len(orders)];
            let weakest = sums.solve(&mut coefficients, &mut vec![f64::NAN; solve_len(orders)]).unwrap();
            let size = by_rows.iter().flatten().fold(1.0, |s: f64, c| s.max(c.abs()));
            // what rounding leaves grows with the square of how badly the points tell
            prop_assert!(difference(&coefficients, &by_rows) < 1e-12 * size / (weakest * weakest).max(1e-6));
        }
    }

    /// A projector that is no least-squares fit: it must be the left inverse of the basis, and what it leaves of
    /// any values must be orthogonal to the basis.
    #[test]
    fn projector_is_the_pseudo_inverse(seed in any::<u64>(), order in 0..=MAX_ORDER, extra in 0..20_usize) {
        let mut random = Random(seed);
        let points = axis(&mut random, order + 1 + extra);
        let (n, m) = (order + 1, points.len());
        let mut projector = vec![f64::NAN; n * m];
        project_axis(order, &points, &mut projector, &mut vec![0.0; axis_scratch_len(m, order)]).unwrap();
        let rows: Vec<_> = points.iter().map(|t| basis(order, *t)).collect();
        let size = projector.iter().fold(1.0, |s: f64, p| s.max(p.abs()));
        for i in 0..n {
            for j in 0..n {
                let product: f64 = (0..m).map(|k| projector[i * m + k] * rows[k][j]).sum();
                let expected = if i == j { 1.0 } else { 0.0 };
                prop_assert!((product - expected).abs() < 1e-11 * size, "{}", product - expected);
            }
        }
        let values: Vec<f64> = (0..m).map(|_| random.unit()).collect();
        let mut coefficients = vec![f64::NAN; n];
        apply_axis(&projector, m, n, 1, &values, &mut coefficients);
        for j in 0..n {
            let left: f64 = (0..m)
                .map(|k| {
                    let fitted: f64 = (0..n).map(|i| rows[k][i] * coefficients[i]).sum();
                    rows[k][j] * (values[k] - fitted)
                })
                .sum();
            prop_assert!(left.abs() < 1e-11 * size, "{left}");
        }
    }

    /// Too few distinct points that give numbers instead of a refusal.
    #[test]
    fn too_few_points_are_refused(seed in any::<u64>(), order in 1..=MAX_ORDER, copies in 1..4_usize) {
        let distinct = axis(&mut Random(seed), order);
        let points = distinct.repeat(copies);
        let mut projector = vec![0.0; (order + 1) * points.len()];
        let mut scratch = vec![0.0; axis_scratch_len(points.len(), order)];
        prop_assert_eq!(project_axis(order, &points, &mut projector, &mut scratch), Err(Error::Singular));
        let points: Vec<_> = points
            .iter()
            .map(|t| (domain().low.map(|l| l + t), Vector3::zeros()))
            .collect();
        prop_assert!(fit([order, 0, 0], &domain(), &points).1 < 1e-9);
    }

    /// A derivative that forgets the fade, the gradient of the share, or that a coordinate is held at the border.
    #[test]
    fn derivative_of_a_correction_is_exact(
        (orders, coefficients) in corrections(),
        place in prop::array::uniform3(-0.4..1.4_f64),
    ) {
        let domain = domain();
        let correction = Correction::new(orders, domain, &coefficients).unwrap();
        let span = domain.high - domain.low;
        let x = domain.low + Vector3::from(place).component_mul(&span);
        let h = 0.05;
        // the slope jumps at the border of the box, the curvature at the end of the fade
        for k in 0..3 {
            for edge in [domain.low[k], domain.high[k], domain.low[k] - domain.fade, domain.high[k] + domain.fade] {
                prop_assume!((x[k] - edge).abs() > h);
            }
        }
        let (_, slope) = correction.at(&x);
        for k in 0..3 {
            let differences = derivative(|h| correction.at(&(x + Vector3::ith(k, h))).0, h);
            prop_assert!((slope.column(k) - differences).amax() < 1e-8, "{}", (slope.column(k) - differences).amax());
        }
    }

    /// A jump at the border of the box or at the end of the fade, on any side or edge.
    #[test]
    fn a_correction_has_no_jump(
        (orders, coefficients) in corrections(),
        place in prop::array::uniform3(-0.3..1.3_f64),
        axis in 0..3_usize,
        side in 0..4_usize,
    ) {
        let domain = domain();
        let correction = Correction::new(orders, domain, &coefficients).unwrap();
        let mut x = domain.low + Vector3::from(place).component_mul(&(domain.high - domain.low));
        x[axis] = [domain.low[axis], domain.high[axis], domain.low[axis] - domain.fade, domain.high[axis] + domain.fade][side];
        let step = Vector3::ith(axis, 1e-9);
        let [before, at, after] = [x - step, x, x + step].map(|x| correction.at(&x).0);
        prop_assert!((before - at).amax() < 1e-8 && (after - at).amax() < 1e-8);
        prop_assert!((domain.share(&(x - step)).1 - domain.share(&(x + step)).1).amax() < 1e-8);
    }

    /// A correction that does not fade, that grows outside, or that is left beyond the margin.
    #[test]
    fn a_correction_fades_to_nothing(
        (orders, coefficients) in corrections(),
        place in prop::array::uniform3(0.0..1.0_f64),
        away in prop::array::uniform3(-40.0..40.0_f64),
    ) {
        let domain = domain();
        let correction = Correction::new(orders, domain, &coefficients).unwrap();
        let x = domain.low + Vector3::from(place).component_mul(&(domain.high - domain.low));
        prop_assert_eq!(domain.share(&x), (1.0, Vector3::zeros()));
        // from the border outwards
        let mut last = 1.0;
        for i in 0..=20 {
            let y = Vector3::from_fn(|k, _| {
                let border = if away[k] > 0.0 { domain.high[k] } else { domain.low[k] };
                border + away[k] * f64::from(i) / 20.0
            });
            let (share, _) = domain.share(&y);
            prop_assert!((0.0..=last).contains(&share));
            last = share;
            let (value, slope) = correction.at(&y);
            let far = (0..3).any(|k| y[k] > domain.high[k] + domain.fade || y[k] < domain.low[k] - domain.fade);
            if far {
                prop_assert_eq!(share, 0.0);
                prop_assert_eq!((value.amax(), slope.amax()), (0.0, 0.0));
            }
            // a sum of positive weights that add up to one stays within the coefficients
            let largest = coefficients.iter().flatten().fold(0.0, |m: f64, c| m.max(c.abs()));
            prop_assert!(value.amax() <= share * largest * (1.0 + 1e-12));
        }
    }

    /// A variable of order zero that has a say, or an infinite side that makes NaN.
    #[test]
    fn a_variable_of_order_zero_has_no_say(seed in any::<u64>(), axis in 0..3_usize, x in -1e6..1e6_f64) {
        let mut random = Random(seed);
        let mut orders = [2; 3];
        orders[axis] = 0;
        let mut domain = domain();
        domain.low[axis] = f64::NEG_INFINITY;
        domain.high[axis] = f64::INFINITY;
        let coefficients: Vec<[f64; 3]> =
            (0..9).map(|_| std::array::from_fn(|_| random.unit())).collect();
        let correction = Correction::new(orders, domain, &coefficients).unwrap();
        let mut position = Vector3::new(1.0, 2.0, -150.0);
        position[axis] = 0.0;
        let expected = correction.at(&position);
        prop_assert!(expected.0.iter().all(|v| v.is_finite()) && expected.0.amax() > 0.0);
        prop_assert_eq!(expected.1.column(axis).amax(), 0.0);
        position[axis] = x;
        prop_assert_eq!(correction.at(&position), expected);
    }

    /// A panic on any bits; a finite value for a coordinate that is none; a value that is not finite for one that is.
    #[test]
    fn any_bits_are_answered((orders, coefficients) in corrections(), bits in prop::array::uniform3(prop::num::f64::ANY)) {
        let x = Vector3::from(bits);
        let correction = Correction::new(orders, domain(), &coefficients).unwrap();
        let (value, slope) = correction.at(&x);
        if x.iter().all(|c| c.is_finite()) {
            prop_assert!(value.iter().chain(slope.iter()).all(|c| c.is_finite()));
        }
        if (0..3).any(|k| orders[k] > 0 && x[k].is_nan()) {
            prop_assert!(value.iter().all(|c| c.is_nan()));
        }
    }
}
