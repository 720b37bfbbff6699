//! What a control loop calls never asks the allocator for anything.
//!
//! The counter is the thread's own, so that the test harness may do as it likes on its threads.

mod common;

use common::{drawing, drawn, model_of, plausible, range_of, some_covariates, straight_over_all};
use nalgebra::{SMatrix, Vector2, Vector3};
use sherkit_core::camera::{Description, Face};
use sherkit_core::chain::effects::Wanted;
use sherkit_core::chain::{Aim, Frame, Robot as _};
use sherkit_core::delta::correction::{
    Correction, Domain, apply_axis, axis_scratch_len, project_axis, push,
};
use sherkit_core::delta::{Branch, CATALOGUE, Calibrated, GEOMETRIC, Kinematics, Row, Values};
use sherkit_core::fit::{Levenberg, Loss, Progress, Settings, Stack, levenberg_len, stack_len};
use sherkit_core::numbers::registration::{Method, Moments};
use sherkit_core::numbers::rigid::Rigid;
use sherkit_core::spherical;
use sherkit_core::tool::beam::Beam;
use sherkit_core::tool::filter::{Doubt, ToolFilter, Trusted};
use sherkit_core::tool::paper::{PaperFilter, PaperNoise};
use sherkit_core::tool::rod::{Bending, Rod};
use sherkit_core::tool::sensing::{Calibration, Sensor};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::hint::black_box;
use std::ops::Range;

const SENSOR_POSE: Range<usize> = range_of(CATALOGUE, "sensor_pose");

struct Counting;

thread_local! {
    static REQUESTS: Cell<usize> = const { Cell::new(0) };
}

fn count() {
    // a thread that is ending has no counter any more, and nothing to count
    let _ = REQUESTS.try_with(|r| r.set(r.get() + 1));
}

// SAFETY: every request goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of `alloc_zeroed`.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, place: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of `realloc`.
        unsafe { System.realloc(place, layout, size) }
    }

    unsafe fn dealloc(&self, place: *mut u8, layout: Layout) {
        count();
        // SAFETY: the caller keeps the contract of `dealloc`.
        unsafe { System.dealloc(place, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Runs `body` and returns how often it asked the allocator.
fn requests(body: impl FnOnce()) -> usize {
    let before = REQUESTS.get();
    body();
    REQUESTS.get() - before
}

/// A counter that counts nothing would pass everything below.
#[test]
fn the_counter_counts() {
    assert_eq!(requests(|| drop(black_box(vec![1_u8; black_box(100)]))), 2);
}

/// A vector that grows, a boxed closure or a message that is formatted, in the kinematics, in reach or out of it.
#[test]
fn kinematics_allocate_nothing() {
    let geometry = drawing();
    let found = requests(|| {
        let k = Kinematics::new(&geometry).unwrap();
        for height in 0..500 {
            let joints = Vector3::new(200.0, 210.0, 2.0 * f64::from(height));
            let position = black_box(k.forward(&joints));
            if let Ok(position) = position {
                black_box(k.inverse(&position)).unwrap();
                let pose = k.pose(&joints).unwrap();
                let by_parameters: SMatrix<f64, 3, GEOMETRIC> = k.by_parameters(&pose);
                black_box((pose.by_joints(), by_parameters));
            }
            black_box(k.forward_lanes([200.0, 210.0, joints.z]));
            black_box(k.inverse_lanes([0.0, joints.z, -300.0]));
        }
    });
    assert_eq!(found, 0);
}

/// As above, for the chain with its effects and the calibrated robot with corrections and a region.
#[test]
fn the_calibrated_robot_allocates_nothing() {
    let robot = drawn();
    let now = some_covariates();
    let coefficients = [[0.01, -0.02, 0.03]; 64];
    let found = requests(|| {
        let model = model_of(&robot);
        let sizes: Values = plausible(CATALOGUE);
        let [some, mut more] =
            [0.3, 0.4].map(|share| straight_over_all(&robot, sizes.map(|s| share * s)));
        // both models were seen from one place
        more[SENSOR_POSE].copy_from_slice(&some[SENSOR_POSE]);
        let chain = model.with(&some).unwrap();
        let other = model.with(&more).unwrap();
        let domain = Domain {
            low: Vector3::new(-30.0, -40.0, -200.0),
            high: Vector3::new(40.0, 30.0, -20.0),
            fade: 20.0,
        };
        let correction = Correction::new([3; 3], domain, &coefficients).unwrap();
        let branch = |chain| Branch::new(&chain, Some(correction));
        let calibrated = Calibrated {
            whole: branch(chain),
            local: Some((branch(other), domain)),
            frame: Frame::Sensor,
        };
        let mut reached = 0;
        for step in 0..400 {
            let joints = Vector3::new(200.0, 210.0 - 0.1 * f64::from(step), 190.0);
            black_box(correction.at(&Vector3::new(f64::from(step) - 200.0, 0.0, -90.0)));
            for frame in [Frame::Sensor, Frame::Base] {
                let calibrated = calibrated.in_frame(frame);
                if let Ok((position, _)) = calibrated.forward(&joints, &now) {
                    let back = calibrated.inverse(&position, &now).unwrap();
                    assert!((back - joints).amax() < 1e-6);
                    reached += 1;
                }
            }
            let row = Row {
                joints: [joints.x, joints.y, joints.z],
                covariates: now,
                push: Vector3::zeros(),
                to: Some([200.0; 3]),
                aim: Aim::default(),
            };
            let _ = black_box(chain.row_predict(&row, Wanted::ALL));
            let _ = black_box(chain.row_value(&row));
        }
        assert!(reached > 600);
        // far beyond reach: errors are values
        assert!(calibrated.inverse(&Vector3::repeat(1e4), &now).is_err());
    });
    assert_eq!(found, 0);
}

/// As above, for the least squares: rows into the stack, the iteration, covariance, the Bernstein fit.
#[test]
fn least_squares_allocate_nothing() {
    const N: usize = 3;
    let mut storage = vec![0.0; stack_len(N, 1)];
    let mut state = vec![0.0; levenberg_len(N)];
    let domain = Domain {
        low: Vector3::zeros(),
        high: Vector3::repeat(1.0),
        fade: 1.0,
    };
    let mut fit_storage = vec![0.0; stack_len(8, 3)];
    let mut axis_scratch = vec![0.0; axis_scratch_len(5, 2)];
    let found = requests(|| {
        let mut stack = Stack::new(N, 1, storage.as_mut_slice()).unwrap();
        let start = [0.5, 0.5, 1.0];
        let mut iteration =
            Levenberg::new(&start, &[1.0; N], Settings::default(), state.as_mut_slice()).unwrap();
        loop {
            let [a, b, c] = [0, 1, 2].map(|k| iteration.trial()[k]);
            stack.clear();
            let mut total = 0.0;
            for i in 0..300 {
                let x = 0.01 * f64::from(i);
                let y = c * ((a + b) * x).exp();
                let u = 1.5 * (0.7 * x).exp() - y;
                let (root, cost) = Loss::Cauchy.root_weight_and_cost(u);
                total += cost;
                stack.push([root * x * y, root * x * y, root * y / c, root * u]);
            }
            let progress = iteration.advance(stack.triangle(), total).unwrap();
            if progress != Progress::Evaluate {
                assert_eq!(progress, Progress::Converged);
                break;
            }
        }
        let (mut data, mut unobserved) = ([0.0; N * N], [0.0; N * N]);
        iteration
            .with_decomposition(|d| d.covariance(&mut data, &mut unobserved, &mut [0.0; N]))
            .unwrap();
        black_box((data, unobserved));
        // an evaluation that failed
        black_box(iteration.advance(stack.triangle(), f64::INFINITY)).unwrap();

        let mut fit = Stack::new(8, 3, fit_storage.as_mut_slice()).unwrap();
        for i in 0..300 {
            let x = Vector3::new(0.003 * f64::from(i), 0.01 * f64::from(i % 100), 0.1);
            push(&mut fit, [1; 3], &domain, &x, &x);
        }
        black_box(fit.triangle());
        let (mut projector, mut line) = ([0.0; 15], [0.0; 3]);
        let points = [0.0, 0.2, 0.5, 0.7, 1.0];
        project_axis(2, &points, &mut projector, &mut axis_scratch).unwrap();
        apply_axis(&projector, 5, 3, 1, &points, &mut line);
        black_box(line);
    });
    assert_eq!(found, 0);
}

/// As above, for the flexible tool: sensing, filters, registration.
#[test]
fn the_flexible_tool_allocates_nothing() {
    let calibration = Calibration {
        gains: [nalgebra::Matrix2x3::new(4e4, -2e4, -2e4, 0.0, 3.5e4, -3.5e4); 2],
        distances_mm: [28.0, 34.0],
        reference_nm: [[1550.0; 3]; 3],
        noise_nm: 1e-3,
    };
    let noise = PaperNoise::ebrahimi_2020();
    let tool = Rigid::identity();
    let beam = Beam::ebrahimi_2020();
    let found = requests(|| {
        let sensor = Sensor::new(calibration).unwrap();
        let mut paper = PaperFilter::new(&calibration, beam, noise, 5.0, 1.0, &tool, 0.0).unwrap();
        let trusted = Trusted {
            calibration,
            means: [Vector2::new(1e-6, 0.0); 2],
            warmth: [[0.01, -0.02, 0.01]; 2],
            rod: Rod {
                beam,
                bending: Bending::Exact,
            },
            doubt: Doubt::default(),
            clearance_mm: 0.05,
            per_second_mm2: 0.01,
        };
        let mut whole = ToolFilter::new(&trusted, 5.0, 1.0, &tool, 0.0).unwrap();
        for k in 1..=500 {
            let time = 0.005 * f64::from(k);
            let mut w = calibration.reference_nm;
            w[0][0] += 0.02 * (0.1 * f64::from(k)).sin();
            w[1][1] -= 0.03 * (0.1 * f64::from(k)).sin();
            if k % 10 == 0 {
                w[0][0] = f64::NAN;
            }
            if k > 300 {
                w[1][2] += 0.3;
            }
            black_box(whole.step(time, &tool, Some((time - 0.1, &w))));
            black_box(whole.told());
            black_box(sensor.read(&w)).ok();
            black_box(paper.step(time, &tool, Some(&w)));
            black_box(paper.told());
        }
        let mut moments = Moments::default();
        for k in 0..60_u32 {
            let a = Vector3::new(f64::from(k), f64::from(k * k % 17), f64::from(k % 5));
            moments.push(&a, &(a * 1.001)).unwrap();
        }
        for method in [Method::Quaternion, Method::SingularValues] {
            black_box(moments.solve(method)).unwrap();
        }
    });
    assert_eq!(found, 0);
}

/// As above, for the spherical robot and its camera, in reach or out of it.
#[test]
fn the_spherical_robot_allocates_nothing() {
    let model = spherical::Model {
        geometry: spherical::Geometry::equal(0.9, 0.7),
        radius_mm: 200.0,
        camera: Description::facing(1.57, 0.8, 446.0, [1100.0, 1100.0, 640.0, 320.0]),
        face: Face::Near,
        readings: spherical::Readings::Pixels,
        gravity: -Vector3::y(),
        home: [0.0; 2],
        time_origin_s: 0.0,
        slip_time_s: 0.0,
        joint_slip_time_s: 0.0,
        encoder_period: [0.4, 0.3],
        sensor_slip_time_s: 0.0,
    };
    let now = spherical::Covariates {
        time_s: 0.0,
        temperature_c: 20.0,
        stand_c: 20.5,
        payload_kg: f64::NAN,
        direction: [1.0, -1.0],
        velocity: [0.1, 0.2],
    };
    let found = requests(|| {
        let pointing = spherical::Model {
            readings: spherical::Readings::Angles,
            ..model
        };
        let values = [1e-3; spherical::PARAMETERS];
        let [chain, pointing] = [model, pointing].map(|model| model.with(&values).unwrap());
        let mut seen = 0;
        for half in 0..500 {
            let half = 0.004 * f64::from(half);
            let joints = [1.5 + half, 1.5 - half];
            for chain in [&chain, &pointing] {
                let row = spherical::Row {
                    joints,
                    to: None,
                    aim: Aim::default(),
                    covariates: now,
                    push: Vector3::zeros(),
                };
                if let Ok(p) = black_box(chain.row_predict(&row, Wanted::ALL)) {
                    seen += 1;
                    black_box(chain.inverse_residual(&row, &p.value)).ok();
                }
            }
            black_box(chain.centre(&joints, &now)).unwrap();
            let k = chain.structure().kinematics();
            black_box(k.forward_lanes([joints[0], joints[1]]));
            black_box(k.inverse_lanes([1.5, half], spherical::Elbows::Open));
        }
        assert!(seen > 300);
    });
    assert_eq!(found, 0);
}
