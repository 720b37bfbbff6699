//! The flexible tool: fibres and beam.

mod common;

use common::{Random, config, derivative, rotation};
use nalgebra::{Matrix2x3, Matrix3, Vector1, Vector2, Vector3};
use proptest::prelude::*;
use sherkit_core::Error;
use sherkit_core::numbers::rigid::Rigid;
use sherkit_core::tool::beam::Beam;
use sherkit_core::tool::rod::{Bending, Rod};
use sherkit_core::tool::sensing::{Calibration, Depth, Sensor};

/// A tool with random gains and reference wavelengths near 1550 nm.
fn calibration(random: &mut Random, noise_nm: f64) -> Calibration {
    // three fibres a third of a turn apart, each with a gain of its own
    let gain = |random: &mut Random| {
        Matrix2x3::from_fn(|i, j| {
            let angle = std::f64::consts::TAU * (j as f64 / 3.0 - 0.25 * i as f64);
            4e4 * (angle.cos() + 0.2 * random.unit())
        })
    };
    Calibration {
        gains: [gain(random), gain(random)],
        distances_mm: [28.0 + random.unit(), 34.0 + random.unit()],
        reference_nm: [[0.0; 3]; 3].map(|s| s.map(|_| 1550.0 + 10.0 * random.unit())),
        noise_nm,
    }
}

/// Wavelengths of a force at a depth: the least ones that give the moments, with a common change.
fn wavelengths(
    c: &Calibration,
    force: &Vector2<f64>,
    depth: f64,
    common: [f64; 3],
) -> [[f64; 3]; 3] {
    let mut w = c.reference_nm;
    for i in 0..2 {
        let g = c.gains[i] * (Matrix3::identity() - Matrix3::repeat(1.0 / 3.0));
        let moment = force * (c.distances_mm[i] - depth);
        let s = g.transpose() * (g * g.transpose()).try_inverse().unwrap() * moment;
        for k in 0..3 {
            w[i][k] += s[k];
        }
    }
    for i in 0..3 {
        w[i] = w[i].map(|x| x + common[i]);
    }
    w
}

fn force(random: &mut Random, size: f64) -> Vector2<f64> {
    let angle = std::f64::consts::PI * random.unit();
    Vector2::new(angle.cos(), angle.sin()) * size
}

/// Force, then depth, of wavelengths.
fn read(sensor: &Sensor, w: &[[f64; 3]; 3]) -> Vector3<f64> {
    let reading = sensor.read(w).unwrap();
    let Depth::Measured { mm, .. } = reading.depth else {
        panic!("no force");
    };
    Vector3::new(reading.force.x, reading.force.y, mm)
}

proptest! {
    #![proptest_config(config())]

    /// A section's gains or distance taken for the other's, temperature that reads as force, a depth whose
    /// sign or lever is wrong.
    #[test]
    fn force_and_depth_come_back(
        seed in any::<u64>(), size in 1.0..200.0_f64, depth in 0.0..25.0_f64, common in prop::array::uniform3(-1.0..1.0_f64),
    ) {
        let mut random = Random(seed);
        let c = calibration(&mut random, 0.0);
        let sensor = Sensor::new(c).unwrap();
        let f = force(&mut random, size);
        let w = wavelengths(&c, &f, depth, common);
        let reading = sensor.read(&w).unwrap();
        // wavelengths round at 2e-13 nm, which the gains make 1e-8 mN mm
        prop_assert!((reading.force - f).amax() < 1e-7);
        let Depth::Measured { mm, variance, .. } = reading.depth else {
            return Err(TestCaseError::fail("no force"));
        };
        prop_assert!((mm - depth).abs() < 1e-6 / size.min(1.0));
        prop_assert_eq!(variance, 0.0);
        for k in 0..3 {
            prop_assert!((reading.common_nm[k] - common[k]).abs() < 1e-9);
        }
        for by_length in sensor.depth_by_lengths(&reading) {
            prop_assert!((by_length - depth).abs() < 1e-6 / size.min(1.0));
        }
        for i in 0..2 {
            prop_assert!((reading.moments[i] - f * (c.distances_mm[i] - depth)).amax() < 1e-6);
        }
    }

    /// A derivative in the propagation that is not that of the reading; a covariance between force and depth that
    /// is left out or has the wrong sign; anything but what the module's text says added to the variance.
    #[test]
    fn covariance_is_that_of_the_derivatives(seed in any::<u64>(), size in 20.0..200.0_f64, depth in 0.0..25.0_f64) {
        let mut random = Random(seed);
        let c = calibration(&mut random, 1e-4);
        let sensor = Sensor::new(c).unwrap();
        let f = force(&mut random, size);
        let w = wavelengths(&c, &f, depth, [0.0; 3]);
        let mut expected = Matrix3::zeros();
        for section in 0..3 {
            for fibre in 0..3 {
                let slope = derivative(|h| {
                    let mut w = w;
                    w[section][fibre] += h;
                    read(&sensor, &w)
                }, 1e-4);
                expected += slope * slope.transpose() * (c.noise_nm * c.noise_nm);
            }
        }
        let reading = sensor.read(&w).unwrap();
        let Depth::Measured { variance, with_force, .. } = reading.depth else {
            return Err(TestCaseError::fail("no force"));
        };
        let squared = f.norm_squared();
        let first_order = variance * (squared - 9.0 * reading.force_covariance.trace()) / squared;
        let close = |a: f64, b: f64, scale: f64| (a - b).abs() < 1e-5 * scale;
        prop_assert!(close(first_order, expected.m33, expected.m33));
        for i in 0..2 {
            prop_assert!(close(with_force[i], expected[(i, 2)], (expected[(i, i)] * expected.m33).sqrt()));
            for j in 0..2 {
                prop_assert!(close(reading.force_covariance[(i, j)], expected[(i, j)], expected.trace()));
            }
        }
    }

    /// A variance that jumps or shrinks as the force fades, a NaN, a wild number without force.
    #[test]
    fn a_fading_force_tells_less_and_less(seed in any::<u64>(), depth in 0.0..25.0_f64) {
        let mut random = Random(seed);
        let c = calibration(&mut random, 1e-4);
        let sensor = Sensor::new(c).unwrap();
        let direction = force(&mut random, 1.0);
        let mut last = 0.0;
        let deviation = sensor.read(&c.reference_nm).unwrap().force_covariance.trace().sqrt();
        for i in 0..400 {
            let size = 400.0 * deviation * 0.98_f64.powi(i);
            let reading = sensor.read(&wavelengths(&c, &(direction * size), depth, [0.1; 3])).unwrap();
            let variance = match reading.depth {
                Depth::Measured { variance, .. } => variance,
                Depth::NoForce => f64::INFINITY,
            };
            prop_assert!(variance >= last && !variance.is_nan());
            if size > 5.2 * deviation {
                prop_assert!(last == 0.0 || variance < 1.5 * last, "{variance} {last}");
            }
            prop_assert_eq!(reading.depth == Depth::NoForce, size <= 5.0 * deviation);
            last = variance;
        }
        let nothing = sensor.read(&c.reference_nm).unwrap();
        prop_assert_eq!(nothing.depth, Depth::NoForce);
    }

    /// A panic, or a reading that holds anything but numbers, for any bits.
    #[test]
    fn any_bits_are_answered(bits in prop::array::uniform9(prop::num::f64::ANY), which in 0..9_usize, noise in prop_oneof![Just(0.0), Just(1e-3)]) {
        let c = calibration(&mut Random(3), noise);
        let sensor = Sensor::new(c).unwrap();
        let mut w = c.reference_nm;
        w[which / 3][which % 3] = bits[which];
        for w in [w, std::array::from_fn(|i| std::array::from_fn(|k| bits[3 * i + k]))] {
            let Ok(reading) = sensor.read(&w) else { continue };
            prop_assert!(w[0].iter().chain(&w[1]).all(|x| x.is_finite()));
            prop_assert!(reading.force.iter().chain(reading.force_covariance.iter()).all(|x| x.is_finite()));
            prop_assert!(reading.misfit.is_finite());
            if let Depth::Measured { mm, variance, .. } = reading.depth {
                prop_assert!(mm.is_finite() && variance.is_finite() && variance >= 0.0);
            }
        }
    }

    /// An Eq. 9 mistyped: against the beam's curvature, integrated twice.
    #[test]
    fn compliance_is_the_bent_beam(h in 20.0..80.0_f64, k in 1e5..1e7_f64, share in 0.0..1.0_f64) {
        const CELLS: usize = 2000;
        let beam = Beam::new(h, k).unwrap();
        let (d, step) = (share * h, 1.0 / CELLS as f64);
        let a = h - d;
        let sum = |end: f64| -> f64 {
            (0..CELLS)
                .map(|i| {
                    let s = (i as f64 + 0.5) * step * a;
                    (a - s) * (end - s) / k * step * a
                })
                .sum()
        };
        let c = beam.compliance(d).value;
        prop_assert!((sum(h) - c).abs() <= 1e-6 * c + 1e-15);
        let rod = Rod { beam, bending: Bending::Small };
        prop_assert!((sum(a) - rod.aside(1.0, a)).abs() <= 1e-6 * c + 1e-15);
    }

    /// A derivative of Eq. 9 mistyped, at the ends too.
    #[test]
    fn derivatives_of_the_beam_are_exact(h in 20.0..80.0_f64, k in 1e5..1e7_f64, share in 0.02..0.98_f64) {
        let d = share * h;
        let c = Beam::new(h, k).unwrap().compliance(d);
        let of = |h, k, d| Vector1::new(Beam::new(h, k).unwrap().compliance(d).value);
        let small = 0.01;
        for (found, differences) in [
            (c.by_depth, derivative(|e| of(h, k, d + e), small)),
            (c.by_length, derivative(|e| of(h + e, k, d), small)),
            (c.by_stiffness * k, derivative(|e| of(h, k * (1.0 + e), d), small)),
        ] {
            prop_assert!((found - differences.x).abs() < 1e-6 * found.abs() + 1e-12, "{found} {differences}");
        }
    }

    /// A jump at either end, a tip that goes on bending beyond it, a NaN that looks like a number.
    #[test]
    fn a_depth_off_the_shaft_is_held(h in 20.0..80.0_f64, beyond in 0.0..100.0_f64) {
        let beam = Beam::new(h, 1e6).unwrap();
        let c = |d| beam.compliance(d);
        prop_assert_eq!(c(-beyond).value, c(0.0).value);
        prop_assert_eq!(c(h + beyond).value, 0.0);
        prop_assert!(beyond == 0.0 || c(-beyond).by_depth == 0.0);
        prop_assert_eq!(c(h + beyond).by_depth, 0.0);
        prop_assert!((c(1e-9).value - c(-1e-9).value).abs() < 1e-9);
        prop_assert!((c(h - 1e-9).value - c(h + 1e-9).value).abs() < 1e-9);
        prop_assert!(c(f64::NAN).value.is_nan());
    }

    /// A tip bent along the wrong axis or carried to the wrong frame, and a cantilever that is not Eq. 9's.
    #[test]
    fn the_tip_of_a_cantilever(seed in any::<u64>(), depth in 1.0..55.0_f64) {
        let mut random = Random(seed);
        let (beam, bending) = (Beam::ebrahimi_2020(), Bending::Small);
        let tool = Rigid {
            rotation: rotation(&mut random),
            translation: Vector3::from_fn(|_, _| 100.0 * random.unit()),
        };
        let f = force(&mut random, 100.0);
        let c = beam.compliance(depth).value;
        let tip = Rod { beam, bending }.tip(&f, depth, &tool);
        let expected = tool.translation
            + tool.rotation.column(0) * (f.x * c)
            + tool.rotation.column(1) * (f.y * c);
        prop_assert!((tip - expected).amax() < 1e-12);
    }
}

/// A first-order covariance that is not that of noisy readings, and a misfit that is not 1 on average.
#[test]
fn covariance_and_misfit_are_those_of_many_readings() {
    const RUNS: usize = 20_000;
    let mut random = Random(11);
    let c = calibration(&mut random, 1e-4);
    let sensor = Sensor::new(c).unwrap();
    let f = force(&mut random, 120.0);
    let w = wavelengths(&c, &f, 8.0, [0.2; 3]);
    let clean = sensor.read(&w).unwrap();
    let (mut sum, mut misfit, mut bent) = (Matrix3::zeros(), 0.0, 0.0);
    for _ in 0..RUNS {
        let mut noisy = w.map(|s| s.map(|x| x + c.noise_nm * random.normal()));
        let miss = read(&sensor, &noisy) - Vector3::new(f.x, f.y, 8.0);
        sum += miss * miss.transpose() / RUNS as f64;
        misfit += sensor.read(&noisy).unwrap().misfit / RUNS as f64;
        // a second contact above section I bends section II alone
        noisy[1][0] += 2e-3;
        bent += sensor.read(&noisy).unwrap().misfit / RUNS as f64;
    }
    let Depth::Measured {
        variance,
        with_force,
        ..
    } = clean.depth
    else {
        panic!("no force");
    };
    let p = clean.force_covariance;
    let predicted = Matrix3::new(
        p.m11,
        p.m12,
        with_force.x,
        p.m21,
        p.m22,
        with_force.y,
        with_force.x,
        with_force.y,
        variance,
    );
    for i in 0..3 {
        for j in 0..3 {
            let scale = (predicted[(i, i)] * predicted[(j, j)]).sqrt();
            let miss = (sum[(i, j)] - predicted[(i, j)]) / scale;
            assert!(miss.abs() < 0.05, "{i} {j} {miss}");
        }
    }
    assert!((misfit - 1.0).abs() < 0.05, "{misfit}");
    assert!(bent > 5.0, "{bent}");
}

/// Numbers that are no tool, taken.
#[test]
fn nonsense_is_refused() {
    let good = calibration(&mut Random(1), 1e-4);
    let refused = |change: fn(&mut Calibration)| {
        let mut c = good;
        change(&mut c);
        matches!(Sensor::new(c), Err(Error::Invalid { .. }))
    };
    assert!(!refused(|_| {}));
    assert!(refused(|c| c.distances_mm = [34.0, 28.0]));
    assert!(refused(|c| c.distances_mm = [0.0, 28.0]));
    assert!(refused(|c| c.noise_nm = -1.0));
    assert!(refused(|c| c.noise_nm = f64::NAN));
    assert!(refused(|c| c.gains[1][(1, 2)] = f64::INFINITY));
    assert!(refused(|c| c.reference_nm[2][2] = f64::NAN));
    for (h, k) in [
        (0.0, 1.0),
        (1.0, -1.0),
        (f64::NAN, 1.0),
        (1.0, f64::INFINITY),
    ] {
        assert!(matches!(Beam::new(h, k), Err(Error::Invalid { .. })));
    }
}
