//! The paper's filters of the tool (Eqs. 8 and 14) against textbook filters written here, and what they refuse.

mod common;

use common::fibres::{DISTANCES, calibration, wavelengths};
use common::{Random, config, rotation};
use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use proptest::prelude::*;
use sherkit_core::numbers::jacobi::symmetric_eigen;
use sherkit_core::numbers::rigid::Rigid;
use sherkit_core::tool::beam::Beam;
use sherkit_core::tool::filter::{Status, Told};
use sherkit_core::tool::paper::{PaperFilter, PaperNoise};

const START: (f64, f64) = (12.0, 0.5);

/// Moments of a force at a depth, each with an error of its own.
fn moments(random: &mut Random, force: &Vector2<f64>, depth: f64) -> [Vector2<f64>; 2] {
    DISTANCES.map(|l| force * (l - depth) + Vector2::new(random.normal(), random.normal()))
}

fn filter(noise: PaperNoise, tool: &Rigid) -> PaperFilter {
    let beam = Beam::ebrahimi_2020();
    PaperFilter::new(&calibration(), beam, noise, START.0, START.1, tool, 0.0).unwrap()
}

fn pose(random: &mut Random) -> Rigid {
    Rigid {
        rotation: rotation(random),
        translation: Vector3::from_fn(|_, _| 50.0 * random.unit()),
    }
}

/// The tool a little further on.
fn on(random: &mut Random, tool: &Rigid) -> Rigid {
    let turn = Rotation3::new(Vector3::from_fn(|_, _| 0.02 * random.unit()));
    Rigid {
        rotation: tool.rotation * turn.into_inner(),
        translation: tool.translation + Vector3::from_fn(|_, _| 0.05 * random.normal()),
    }
}

fn tip_covariance(told: &Told) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| told.covariance[i + 1][j + 1])
}

/// Whether depth and tip are numbers, and their covariance exactly symmetric with no negative variance; its least
/// eigenvalue over its greatest.
fn soundness(told: &Told) -> (bool, f64) {
    let c = &told.covariance;
    let finite = told
        .tip_mm
        .iter()
        .chain(c.as_flattened())
        .all(|x| x.is_finite());
    let symmetric = (0..4).all(|i| c[i][i] >= 0.0 && (0..4).all(|j| c[i][j] == c[j][i]));
    let tip = std::array::from_fn(|i| std::array::from_fn(|j| c[i + 1][j + 1]));
    let [most, _, least] = symmetric_eigen::<3>(tip).0;
    let ratio = if most > 0.0 { least / most } else { 0.0 };
    (finite && symmetric && told.depth_mm.is_finite(), ratio)
}

proptest! {
    #![proptest_config(config())]

    /// Catches a depth that is not Eq. 8 with the paper's numbers on either side of 50 mN, and a tip that is not Eqs. 10 to
    /// 14, written out here in units of force as they are printed, with any `α_z`, the noise read either way.
    #[test]
    fn the_filters_are_equations_8_and_14(seed in any::<u64>(), alpha_z in prop_oneof![-5.0..-0.1_f64, 0.1..5.0_f64], of_force in any::<bool>()) {
        let mut random = Random(seed);
        let beam = Beam::ebrahimi_2020();
        let mut tool = pose(&mut random);
        let mut filter = filter(PaperNoise { of_force, ..PaperNoise::ebrahimi_2020() }, &tool);
        let (mut depth, mut variance) = START;
        let (mut tip, mut p) = (tool.translation, Matrix3::identity() * START.1);
        for k in 1..40_u32 {
            let next = on(&mut random, &tool);
            let moved = next.translation - tool.translation;
            let contact = 12.0 + 5.0 * random.unit();
            let force = Vector2::new(60.0 * random.unit(), 60.0 * random.unit());
            let m = moments(&mut random, &force, contact);
            let w = wavelengths(&m, random.unit());
            let told = filter.step(0.005 * f64::from(k), &next, Some(&w));
            prop_assert_eq!(told, Status::UPDATED);

            // what Eqs. 1 and 2 make of the moments
            let force = (m[1] - m[0]) / (DISTANCES[1] - DISTANCES[0]);
            let measured = DISTANCES[1] - m[1].norm() / force.norm();
            let (of_depth, across) = if force.norm() < 50.0 { (1e6, 10.0) } else { (0.005, 0.002) };
            depth += moved.dot(&tool.rotation.column(2));
            variance += 0.0025;
            let gain = variance / (variance + of_depth);
            let squared = (measured - depth).powi(2) / (variance + of_depth);
            depth += gain * (measured - depth);
            variance *= 1.0 - gain;

            tool = next;
            tip += moved;
            p += Matrix3::identity() * 0.01;
            let c = beam.compliance(depth).value;
            let h = Matrix3::from_diagonal(&Vector3::new(1.0 / c, 1.0 / c, alpha_z)) * tool.rotation.transpose();
            let y = Vector3::new(force.x, force.y, 0.0) + h * tool.translation;
            let across = if of_force { across } else { across / (c * c) };
            let r = Matrix3::from_diagonal(&Vector3::new(across, across, 0.0));
            let gain = p * h.transpose() * (h * p * h.transpose() + r).try_inverse().unwrap();
            tip += gain * (y - h * tip);
            p -= gain * h * p;

            let told = filter.told();
            prop_assert!((told.depth_mm - depth).abs() < 1e-8 && told.arc_mm == told.depth_mm);
            prop_assert!((told.covariance[0][0] - variance).abs() < 1e-9);
            prop_assert!((Vector3::from(told.tip_mm) - tip).amax() < 1e-8 * (1.0 + tip.amax()));
            prop_assert!((tip_covariance(&told) - p).amax() < 1e-9);
            prop_assert!(tool.apply_inverse(&told.tip_mm.into()).z.abs() < 1e-12 * (1.0 + tip.amax()));
            let nis = filter.consistency();
            prop_assert!((nis.last - squared).abs() < 1e-6 * (1.0 + squared));
            prop_assert_eq!((nis.last_degrees, nis.count), (1, u64::from(k)));
        }
    }

    /// Catches an estimate that is not finite, or a refusal that the status hides, for any bits anywhere in a step.
    #[test]
    fn any_bits_are_answered(bits in prop::collection::vec(prop::num::f64::ANY, 22), sane in prop::collection::vec(any::<bool>(), 22), seed in any::<u64>()) {
        let mut random = Random(seed);
        let start = pose(&mut random);
        let mut filter = filter(PaperNoise::ebrahimi_2020(), &start);
        let mut bits = bits.into_iter().zip(sane);
        let mut any = |x: f64| bits.next().map_or(x, |(b, sane)| if sane { x } else { b });
        let time = any(0.005);
        let w = wavelengths(&moments(&mut random, &Vector2::new(70.0, 10.0), 12.0), 0.0);
        let w = w.map(|s| s.map(&mut any));
        let next = on(&mut random, &start);
        let next = Rigid { translation: next.translation.map(&mut any), rotation: next.rotation.map(&mut any) };
        let status = filter.step(time, &next, Some(&w));
        prop_assert!(status != Status::default() && soundness(&filter.told()).0);
        if !next.translation.iter().chain(next.rotation.iter()).all(|x| x.is_finite()) {
            prop_assert!(status.has(Status::NO_MOTION) || status == Status::CLOCK);
        }
        if !w[..2].as_flattened().iter().all(|x| x.is_finite()) {
            prop_assert!(!status.has(Status::UPDATED));
        }
        // and on it goes
        let status = filter.step(f64::MAX, &start, None);
        prop_assert!(status.has(Status::MISSING) || status == Status::CLOCK);
        prop_assert!(soundness(&filter.told()).0);
    }
}

/// Catches a covariance that loses symmetry or definiteness in the long run, or an estimate that runs away on what rounding
/// leaves of it: nothing is added, measurements are exact or nearly so, and the tool turns.
#[test]
fn covariances_stay_semidefinite_without_process_noise() {
    let beam = Beam::ebrahimi_2020();
    for (per_step, across) in [(0.0, 0.002), (0.0, 0.0), (1e-18, 1e-9), (1e6, 0.0)] {
        let mut random = Random(1);
        let mut noise = PaperNoise::ebrahimi_2020();
        noise.above.across = across;
        noise.per_step = [per_step; 2];
        let mut tool = pose(&mut random);
        let mut filter = filter(noise, &tool);
        let force = Vector2::new(70.0, -30.0);
        let bend = (force * beam.compliance(START.0).value).norm();
        for k in 1..=100_000 {
            // about the hole: the depth stays
            tool.rotation = on(&mut random, &tool).rotation;
            if k % 1000 == 0 {
                tool.rotation = rotation(&mut random);
            }
            let w = wavelengths(&moments(&mut random, &force, START.0), 0.0);
            filter.step(0.005 * f64::from(k), &tool, (k % 5 != 0).then_some(&w));
            let told = filter.told();
            let (sound, least) = soundness(&told);
            assert!(sound && least > -1e-13, "{across} {k}: {least:e}");
            let off = (Vector3::from(told.tip_mm) - tool.translation).norm();
            assert!(off < 2.0 * bend + 1.0, "{across} {k}: {off}");
        }
    }
}

/// Catches a fault that is used, not counted or not said, and a number that gets into the estimate and stays.
#[test]
fn refusals_are_said_and_counted() {
    let mut random = Random(2);
    let here = Rigid::identity();
    let mut filter = filter(PaperNoise::ebrahimi_2020(), &here);
    let w = wavelengths(&moments(&mut random, &Vector2::new(80.0, 0.0), 12.0), 0.0);
    let nothing = calibration().reference_nm;
    let (mut lost, mut witness) = (w, w);
    lost[1][2] = f64::NAN;
    witness[2] = [f64::NAN; 3];
    let nowhere = Rigid {
        translation: Vector3::new(0.0, f64::NAN, 0.0),
        ..here
    };
    let blind = Status::UPDATED | Status::NO_MOTION;
    let steps = [
        (1.0, &here, Some(&w), Status::UPDATED),
        (1.1, &here, None, Status::MISSING),
        (1.2, &here, Some(&lost), Status::NOT_FINITE),
        // section III is not read
        (1.3, &here, Some(&witness), Status::UPDATED),
        (1.4, &here, Some(&nothing), Status::NO_FORCE),
        (1.5, &nowhere, Some(&w), blind),
        (1.4, &here, Some(&w), Status::CLOCK),
        (f64::NAN, &here, Some(&w), Status::CLOCK),
        (f64::INFINITY, &here, None, Status::CLOCK),
    ];
    for (time, tool, w, expected) in steps {
        let before = filter.told();
        assert_eq!(filter.step(time, tool, w), expected, "{time}");
        let told = filter.told();
        assert!(soundness(&told).0);
        if !expected.has(Status::UPDATED) {
            assert_eq!(told.tip_mm, before.tip_mm);
            let added = f64::from(u8::from(expected != Status::CLOCK)) * 0.0025;
            assert!((told.covariance[0][0] - before.covariance[0][0] - added).abs() < 1e-12);
        }
    }
    assert_eq!(filter.told().time_s, 1.5);
    let c = filter.counts();
    let refused = [c.missing, c.not_finite, c.no_force, c.no_motion, c.clock];
    assert_eq!((c.steps, c.updated, refused), (9, 3, [1, 1, 1, 1, 3]));
}

/// Catches noise or a start that means nothing, taken.
#[test]
fn nonsense_is_refused() {
    let (c, beam, here) = (calibration(), Beam::ebrahimi_2020(), Rigid::identity());
    let made = |noise, depth, variance, time| {
        PaperFilter::new(&c, beam, noise, depth, variance, &here, time).is_ok()
    };
    let paper = PaperNoise::ebrahimi_2020();
    assert!(made(paper, 1.0, 0.0, 0.0));
    assert!(!made(paper, f64::NAN, 1.0, 0.0) && !made(paper, 1.0, -1.0, 0.0));
    assert!(!made(paper, 1.0, f64::INFINITY, 0.0) && !made(paper, 1.0, 1.0, f64::NAN));
    for change in [
        |n: &mut PaperNoise| n.per_step[0] = -1.0,
        |n: &mut PaperNoise| n.below.across = f64::NAN,
        |n: &mut PaperNoise| n.at_mn = f64::INFINITY,
    ] {
        let mut noise = paper;
        change(&mut noise);
        assert!(!made(noise, 1.0, 1.0, 0.0));
    }
}
