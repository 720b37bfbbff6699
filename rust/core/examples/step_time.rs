//! Nanoseconds that one step of the flexible tool's filter and of the paper's takes, and one reading of the fibres:
//! `cargo run --release -p sherkit-core --example step_time`.
//!
//! Every line is the median of batches, after a warm-up. The shaft leans on its hole and leaves it again, as its pose has
//! it, so that both sides of each branch are taken; nothing is at fault.

use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};
use sherkit_core::numbers::rigid::Rigid;
use sherkit_core::tool::beam::Beam;
use sherkit_core::tool::filter::{Doubt, ToolFilter, Trusted};
use sherkit_core::tool::paper::{PaperFilter, PaperNoise};
use sherkit_core::tool::rod::{Bending, Rod};
use sherkit_core::tool::sensing::{Calibration, Sensor};
use std::hint::black_box;
use std::time::Instant;

/// Steps of one batch; as many different measurements are taken in turn.
const BATCH: usize = 2000;
/// Batches of one line.
const BATCHES: usize = 400;

/// Median over the batches, ns per step.
fn median(mut step: impl FnMut(usize)) -> f64 {
    let mut times: Vec<f64> = (0..BATCHES + 20)
        .map(|batch| {
            let start = Instant::now();
            for k in 0..BATCH {
                step(batch * BATCH + k);
            }
            start.elapsed().as_secs_f64() * 1e9 / BATCH as f64
        })
        .skip(20)
        .collect();
    times.sort_by(f64::total_cmp);
    times[BATCHES / 2]
}

/// Where the shaft is led, and the wavelengths there: the hole stands still, with 5 mm of shaft beyond it.
fn led(trusted: &Trusted) -> Vec<(Rigid, [[f64; 3]; 3])> {
    let mut state = 1_u64;
    let mut noise = || {
        (0..12).fold(-6.0, |sum, _| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            sum + (state >> 11) as f64 / (1_u64 << 53) as f64
        })
    };
    let (c, rod, depth, gives) = (&trusted.calibration, &trusted.rod, 5.0, 0.005);
    let way = Vector2::new(80.0, 30.0).normalize();
    (0..BATCH)
        .map(|k| {
            let phase = std::f64::consts::TAU * k as f64 / BATCH as f64;
            let lean = 60.0 * (1.0 - 1.3 * phase.cos());
            let size = lean.max(0.0);
            let shape = rod.shape(size, depth);
            let within = (trusted.clearance_mm + 0.001 * lean.min(0.0)).max(-0.05);
            let aside = way * (shape.contact_across + gives * size + within);
            let place = Vector3::new(-aside.x, -aside.y, depth + shape.contact_short);
            let mut w = c.reference_nm;
            for i in 0..2 {
                let gain = c.gains[i];
                let back =
                    gain.transpose() * (gain * gain.transpose()).try_inverse().expect("a gain");
                let arm = c.distances_mm[i] - depth;
                let moment = way * (size * arm * rod.moment_share(size, arm));
                let shift = back * moment;
                let mean = trusted.means[i].dot(&moment);
                for j in 0..3 {
                    w[i][j] += shift[j] + mean;
                }
            }
            let read = w.map(|section| section.map(|x| x + c.noise_nm * noise()));
            let pose = Rigid {
                rotation: Matrix3::identity(),
                translation: place,
            };
            (pose, read)
        })
        .collect()
}

/// The filter that takes wavelengths and poses.
fn whole_filter(trusted: &Trusted, led: &[(Rigid, [[f64; 3]; 3])]) {
    let (dt, first) = (0.005, &led[0].0);
    for (name, late) in [("in time", 0.0), ("late", 0.1)] {
        let mut whole = ToolFilter::new(trusted, 5.0, 1.0, first, 0.0).expect("a filter");
        println!("tool  {name:11} {:5.1} ns", {
            median(|k| {
                let time = (k + 1) as f64 * dt;
                let (pose, w) = black_box(&led[k % BATCH]);
                black_box(whole.step(time, pose, Some((time - late, w))));
            })
        });
        println!("tool  {name:11} {:5.1} ns with what it tells", {
            let mut whole = ToolFilter::new(trusted, 5.0, 1.0, first, 0.0).expect("a filter");
            median(|k| {
                let time = (k + 1) as f64 * dt;
                let (pose, w) = black_box(&led[k % BATCH]);
                black_box(whole.step(time, pose, Some((time - late, w))));
                black_box(whole.told());
            })
        });
    }
}

fn main() {
    let side = |k: usize| std::f64::consts::TAU * k as f64 / 3.0;
    let gain =
        Matrix2x3::from_fn(|i, k| 3200.0 * if i == 0 { side(k).cos() } else { side(k).sin() });
    let calibration = Calibration {
        gains: [gain; 2],
        distances_mm: [40.0, 50.0],
        reference_nm: [[1550.0; 3]; 3],
        noise_nm: 1e-3,
    };
    let sensor = Sensor::new(calibration).expect("a calibration");
    let beam = Beam::ebrahimi_2020();
    let doubt = Doubt {
        depth: Matrix3::from_diagonal_element(0.01),
        deeper_mm: 0.1,
        turn_rad: 0.005,
        force: 0.01,
        reference_nm: 2e-4,
        mean: 0.02,
        clearance_mm: 0.02,
        unlike: 0.02,
        warmth: 0.02,
        ..Doubt::default()
    };
    let trusted = Trusted {
        calibration,
        means: [Vector2::new(1e-6, 0.0); 2],
        warmth: [[0.01, -0.02, 0.01]; 2],
        rod: Rod {
            beam,
            bending: Bending::Exact,
        },
        doubt,
        clearance_mm: 0.05,
        per_second_mm2: 0.004,
    };
    let led = led(&trusted);

    println!("sensing        {:8.1} ns", {
        median(|k| {
            black_box(sensor.read(black_box(&led[k % BATCH].1))).ok();
        })
    });
    whole_filter(&trusted, &led);
    let noise = PaperNoise::ebrahimi_2020();
    let mut paper =
        PaperFilter::new(&calibration, beam, noise, 5.0, 1.0, &led[0].0, 0.0).expect("a filter");
    println!("paper          {:8.1} ns", {
        median(|k| {
            let (pose, w) = black_box(&led[k % BATCH]);
            black_box(paper.step((k + 1) as f64 * 0.005, pose, Some(w)));
        })
    });
}
