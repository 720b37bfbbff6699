//! Registration of two clouds: exact recovery, agreement of the two methods, covariance, refusals.

mod common;

use common::{Random, config, rotation};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use proptest::prelude::*;
use sherkit_core::Error;
use sherkit_core::numbers::jacobi::{singular_values, symmetric_eigen};
use sherkit_core::numbers::registration::{Method, Moments, of_most};
use sherkit_core::numbers::rigid::Rigid;

const METHODS: [Method; 2] = [Method::Quaternion, Method::SingularValues];

fn transform(random: &mut Random, far: f64) -> Rigid {
    Rigid {
        rotation: rotation(random),
        translation: Vector3::from_fn(|_, _| far * random.unit()),
    }
}

/// A cloud with the given half widths about a centre.
fn cloud(random: &mut Random, n: usize, widths: [f64; 3], centre: f64) -> Vec<Vector3<f64>> {
    let turn = rotation(random);
    let centre = Vector3::from_fn(|_, _| centre * random.unit());
    (0..n)
        .map(|_| turn * Vector3::from(widths.map(|w| w * random.unit())) + centre)
        .collect()
}

fn moments<'a>(pairs: impl IntoIterator<Item = (&'a Vector3<f64>, Vector3<f64>)>) -> Moments {
    let mut moments = Moments::default();
    for (a, b) in pairs {
        moments.push(a, &b).unwrap();
    }
    moments
}

proptest! {
    #![proptest_config(config())]

    /// A quaternion, a product or a sign that is not that of the transform; a reflection instead of a rotation;
    /// digits lost to a cloud far from the origin; a flat cloud that is refused.
    #[test]
    fn random_transforms_come_back(
        seed in any::<u64>(),
        n in 4..60_usize,
        flat in any::<bool>(),
        far in prop_oneof![Just(0.0), Just(100.0)],
    ) {
        let mut random = Random(seed);
        let truth = transform(&mut random, far);
        let widths = [30.0, 20.0, if flat { 0.0 } else { 10.0 }];
        let points = cloud(&mut random, n, widths, far);
        let moments = moments(points.iter().map(|a| (a, truth.apply(a))));
        // few random points may stand near a line: rounding grows with that
        let found = METHODS.map(|m| moments.solve(m).unwrap());
        prop_assume!(found[0].width_ratio > 0.2);
        for found in &found {
            let back = &found.transform;
            prop_assert!((back.rotation - truth.rotation).amax() < 1e-12);
            prop_assert!((back.rotation.determinant() - 1.0).abs() < 1e-13);
            // in mm: relative to the size of the coordinates
            let size = 30.0 + 2.0 * far;
            for a in &points {
                prop_assert!((back.apply(a) - truth.apply(a)).amax() < 1e-12 * size.max(1.0));
            }
            prop_assert!(found.residual_variance.sqrt() < 1e-6);
        }
        prop_assert!((found[0].transform.rotation - found[1].transform.rotation).amax() < 1e-12);
    }

    /// Two methods that minimise different things once there is noise, or a minimum that is none.
    #[test]
    fn methods_agree_on_the_minimum(seed in any::<u64>(), n in 4..40_usize) {
        let mut random = Random(seed);
        let truth = transform(&mut random, 50.0);
        let pairs: Vec<_> = cloud(&mut random, n, [30.0, 25.0, 20.0], 50.0)
            .into_iter()
            .map(|a| (a, truth.apply(&a) + Vector3::from_fn(|_, _| 0.5 * random.normal())))
            .collect();
        let moments = moments(pairs.iter().map(|(a, b)| (a, *b)));
        let [a, b] = METHODS.map(|m| moments.solve(m));
        prop_assume!(a.is_ok());
        let (a, b) = (a.unwrap(), b.unwrap());
        prop_assert!((a.transform.rotation - b.transform.rotation).amax() < 1e-11);
        let cost = |t: &Rigid| pairs.iter().map(|(p, q)| (q - t.apply(p)).norm_squared()).sum::<f64>();
        let least = cost(&a.transform);
        let expected = a.residual_variance * (3.0 * n as f64 - 6.0);
        prop_assert!((least - expected).abs() < 1e-9 * (1.0 + 30.0 * 30.0 * n as f64));
        for _ in 0..10 {
            let turn = nalgebra::Rotation3::new(Vector3::from_fn(|_, _| 1e-4 * random.unit()));
            let other = Rigid {
                rotation: turn.matrix() * a.transform.rotation,
                translation: a.transform.translation + Vector3::from_fn(|_, _| 1e-3 * random.unit()),
            };
            prop_assert!(cost(&other) >= least - 1e-9);
        }
    }

    /// An inverse that does not undo.
    #[test]
    fn inverse_undoes(seed in any::<u64>()) {
        let mut random = Random(seed);
        let t = transform(&mut random, 10.0);
        let x = Vector3::from_fn(|_, _| random.unit());
        prop_assert!((t.inverse().apply(&t.apply(&x)) - x).amax() < 1e-13);
        prop_assert!((t.apply_inverse(&t.apply(&x)) - x).amax() < 1e-13);
    }

    /// A line, a point, or a line with noise about it, that gets a transform; a refusal that cannot say how flat.
    #[test]
    fn lines_are_refused(seed in any::<u64>(), n in 3..40_usize, noise in prop_oneof![Just(0.0), Just(0.2)]) {
        let mut random = Random(seed);
        let truth = transform(&mut random, 50.0);
        let line = cloud(&mut random, n, [40.0, 0.0, 0.0], 20.0);
        let noisy = |random: &mut Random| Vector3::from_fn(|_, _| noise * random.normal());
        let pairs: Vec<_> = line
            .iter()
            .map(|a| (a + noisy(&mut random), truth.apply(a) + noisy(&mut random)))
            .collect();
        // few noisy points may by chance fit a turn well
        prop_assume!(noise == 0.0 || n >= 12);
        for method in METHODS {
            let refused = moments(pairs.iter().map(|(a, b)| (a, *b))).solve(method);
            let Err(Error::Collinear { ratio }) = refused else {
                return Err(TestCaseError::fail(format!("{refused:?}")));
            };
            prop_assert!((0.0..0.1).contains(&ratio));
            let point = moments([(line[0], line[0]); 5].iter().map(|(a, b)| (a, *b)));
            prop_assert_eq!(point.solve(method).err(), Some(Error::Collinear { ratio: 0.0 }));
        }
    }

    /// Eigenvectors that are none, values out of order, a matrix that does not come back.
    #[test]
    fn decompositions_compose(seed in any::<u64>(), rank in 1..4_usize) {
        let mut random = Random(seed);
        let vectors: Vec<[f64; 4]> = (0..rank)
            .map(|_| std::array::from_fn(|_| random.normal() * random.magnitude(2.0)))
            .collect();
        let mut a = [[0.0; 4]; 4];
        for v in &vectors {
            for i in 0..4 {
                for j in 0..4 {
                    a[i][j] += v[i] * v[j];
                }
            }
        }
        let (values, rows) = symmetric_eigen(a);
        let size = values[0];
        for i in 0..4 {
            prop_assert!(i == 0 || values[i] <= values[i - 1]);
            for j in 0..4 {
                let back: f64 = (0..4).map(|k| rows[k][i] * values[k] * rows[k][j]).sum();
                prop_assert!((back - a[i][j]).abs() < 1e-14 * size);
                let product: f64 = (0..4).map(|k| rows[i][k] * rows[j][k]).sum();
                let expected = f64::from(u8::from(i == j));
                prop_assert!((product - expected).abs() < 1e-14);
            }
        }
        let columns: [[f64; 3]; 3] =
            std::array::from_fn(|i| std::array::from_fn(|j| if i < rank { random.normal() } else { 0.5 * j as f64 }));
        let (values, left, right) = singular_values(columns);
        for i in 0..3 {
            for j in 0..3 {
                let back: f64 = (0..3).map(|k| left[k][i] * values[k] * right[k][j]).sum();
                prop_assert!((back - columns[j][i]).abs() < 1e-14 * (1.0 + values[0]));
            }
        }
    }
}

/// A covariance that is not that of the estimates: rotation, translation, and how they go together.
#[test]
fn covariance_is_that_of_many_clouds() {
    const RUNS: usize = 20_000;
    let mut random = Random(7);
    let truth = transform(&mut random, 40.0);
    let points = cloud(&mut random, 12, [30.0, 15.0, 8.0], 60.0);
    let noise = 0.2;
    let clean = moments(points.iter().map(|a| (a, truth.apply(a))))
        .solve(Method::Quaternion)
        .unwrap();
    let predicted = clean.covariance(noise * noise);
    let (mut sum, mut variance) = (Matrix6::zeros(), 0.0);
    for _ in 0..RUNS {
        let noisy = points.iter().map(|a| {
            let noise = Vector3::from_fn(|_, _| noise * random.normal());
            (a, truth.apply(a) + noise)
        });
        let found = moments(noisy).solve(Method::Quaternion).unwrap();
        let small: Matrix3<f64> = found.transform.rotation * truth.rotation.transpose();
        let turn = Vector3::new(
            small[(2, 1)] - small[(1, 2)],
            small[(0, 2)] - small[(2, 0)],
            small[(1, 0)] - small[(0, 1)],
        ) * 0.5;
        let shift = found.transform.translation - truth.translation;
        let change = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
        sum += change * change.transpose() / RUNS as f64;
        variance += found.residual_variance / RUNS as f64;
    }
    // in units of the predicted deviations: about sqrt(2 / RUNS) = 1 % off by chance
    for i in 0..6 {
        for j in 0..6 {
            let scale = (predicted[(i, i)] * predicted[(j, j)]).sqrt();
            let miss = (sum[(i, j)] - predicted[(i, j)]) / scale;
            assert!(miss.abs() < 0.04, "{i} {j} {miss}");
        }
    }
    assert!((variance / (noise * noise) - 1.0).abs() < 0.02);
}

/// Too few points or no numbers, taken; a refusal that changes what was there.
#[test]
fn too_few_or_not_finite_is_refused() {
    let mut moments = Moments::default();
    for found in 0..3 {
        let needed = 3;
        assert_eq!(
            moments.solve(Method::default()).err(),
            Some(Error::TooFew { needed, found })
        );
        let x = Vector3::ith(found, 1.0);
        moments.push(&x, &x).unwrap();
        let before = moments;
        let nan = Vector3::new(0.0, f64::NAN, 0.0);
        assert_eq!(moments.push(&nan, &x), Err(Error::NotFinite { index: 1 }));
        assert_eq!(moments.push(&x, &nan), Err(Error::NotFinite { index: 4 }));
        assert_eq!(moments, before);
    }
    let found = moments.solve(Method::default()).unwrap();
    assert!((found.transform.rotation - Matrix3::identity()).amax() < 1e-14);
}

proptest! {
    #![proptest_config(config())]

    /// Wild pairs or empty ones that turn the transform; a mirror that is none, or one where none was asked for; a limit
    /// from the wrong median; a turn whose vector is that of its inverse.
    #[test]
    fn most_pairs_tell_the_transform(
        seed in any::<u64>(),
        n in 24..60_usize,
        wild in 0..3_usize,
        mirrored in any::<bool>(),
    ) {
        let mut random = Random(seed);
        let truth = transform(&mut random, 50.0);
        let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, if mirrored { -1.0 } else { 1.0 }));
        let points = cloud(&mut random, n, [30.0, 20.0, 10.0], 50.0);
        let mut read: Vec<_> = points.iter().map(|a| truth.apply(&(mirror * a))).collect();
        for k in 0..wild {
            read[k] += Vector3::new(0.0, 80.0, 500.0);
        }
        read[n - 1].x = f64::NAN;
        let (mut missed, mut room) = (vec![0.0; n], vec![0.0; n]);
        let pairs = points.iter().copied().zip(read.iter().copied());
        let (found, half) = of_most(pairs, mirrored, 4, &mut missed, &mut room).unwrap();
        prop_assert!((found.rotation - truth.rotation * mirror).amax() < 1e-9);
        prop_assert!((found.translation - truth.translation).amax() < 1e-7);
        prop_assert!(half < 1e-9);
        let vector = truth.rotation_vector();
        let back = nalgebra::Rotation3::new(vector).into_inner();
        prop_assert!((back - truth.rotation).amax() < 1e-12 && vector.norm() < 3.15);
    }
}

#[test]
fn pairs_that_tell_nothing_are_refused() {
    let at = |x: f64| Vector3::new(x, 2.0 * x, 0.0);
    let line: Vec<_> = (0..9)
        .map(|k| (at(f64::from(k)), at(f64::from(k))))
        .collect();
    let (mut missed, mut room) = ([0.0; 9], [0.0; 9]);
    assert!(of_most(line.iter().copied(), false, 4, &mut missed, &mut room).is_none());
    let few = line.iter().copied().take(3);
    assert!(of_most(few, false, 4, &mut missed[..3], &mut room[..3]).is_none());
    let none = line.iter().copied().take(0);
    assert!(of_most(none, false, 0, &mut missed[..0], &mut room[..0]).is_none());
}
