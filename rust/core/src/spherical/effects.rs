//! The table of the spherical robot: its parameters in the order of the chain, with units, plausible sizes and levers.
//!
//! What no plan of poses can tell apart. In pixels: the scale of all lengths (radius, translation of the camera, offsets);
//! a common joint offset from a turn of the camera about the actuated axis; `ζ₁` from the marker's offset towards elbow 1
//! together with other lengths. In angles: the radius shows through offsets alone, and a common joint offset is a datum in φ.
//! Flexure is told from the geometry by gravity across the actuated axis; where it pulls along that axis and α = β, both
//! of its parameters are taken up by geometry and camera entirely. Growth about the remote centre shows in pixels alone.

use crate::chain::effects::{OWN_LEVER, places};
use crate::chain::table::effects;

/// What a radian moves on the sphere of the paper's robot, mm.
const LEVER: f64 = 200.0;

// what the mechanism computes itself, in `structure.rs`
places! { At:
    geometry unequal_limbs axis_offset gravity_flexure marker_offset
}

effects! { At;
    // errors of the common proximal and distal arc and of the sphere's radius
    geometry: Structure by structure (base) {
        alpha "δα", beta "δβ": "rad", 0.02, OWN_LEVER;
        radius "δR": "mm", 20.0, 1.0;
    }
    // constant offset of readings in φ and γ
    datum: Sensor by angles (base) {
        datum_phi "d_φ", datum_gamma "d_γ": "rad", 0.02, OWN_LEVER;
    }
    // error of the camera's pose: turn about its own axes (the image of the centre stays), and shift
    sensor_pose: Sensor by pose (base) {
        sensor_turn_x, sensor_turn_y, sensor_turn_z: "rad", 0.02, OWN_LEVER;
        sensor_shift_x, sensor_shift_y, sensor_shift_z: "mm", 5.0, 1.0;
    }
    principal_point: Sensor by camera (base) {
        principal_point_u "δc_u", principal_point_v "δc_v": "px", 10.0, 1.0;
    }
    // relative scale error of each encoder, about its home reading
    joint_scale: Joints by joints {
        scale_1, scale_2: "rad/rad", 2e-3, LEVER;
    }
    // added to each joint reading
    joint_offset: Joints by joints {
        offset_1, offset_2: "rad", 0.02, LEVER;
    }
    // lost motion of each joint: the full width between the two directions
    backlash: Joints by joints needs "direction" {
        width_1, width_2: "rad", 2e-3, LEVER;
    }
    // what each joint reads too little from the moment on at which it lost steps
    joint_slip: Joints by joints needs "time_s" search "time_s" {
        step_1, step_2: "rad", 2e-3, LEVER;
    }
    // error of each encoder once per turn: sine and cosine, joint by joint
    encoder_eccentricity: Joints by joints {
        sine_1, cosine_1, sine_2, cosine_2: "rad", 2e-3, LEVER;
    }
    // error of each encoder at the period: sine and cosine, joint by joint
    encoder_cyclic: Joints by joints search "period_rad" {
        sine_1, cosine_1, sine_2, cosine_2: "rad", 1e-3, LEVER;
    }
    // half the difference of the limbs' α and of their β: limb 1 has more, limb 2 less
    unequal_limbs: Structure by structure {
        proximal, distal: "rad", 0.02, LEVER;
    }
    // by how much each elbow axis misses the centre: along the normal of the plane of the proximal link and along the
    // tangent in that plane, limb by limb
    axis_offset: Structure by structure {
        across_1, along_1, across_2, along_2: "mm", 1.0, 1.0;
    }
    // bend of each distal link under the whole moment of the weight
    gravity_flexure: Body by structure {
        bend_1, bend_2: "rad", 0.01, LEVER;
    }
    // offset of the marker from the tool axis: towards elbow 1, and at right angles to that
    marker_offset: Body by structure {
        towards_elbow, across: "mm", 2.0, 1.0;
    }
    // expansion of the marker's place about the remote centre
    thermal_growth: Body by body needs "temperature_c" {
        coefficient "α": "1/°C", 2e-5, LEVER;
    }
    // drift of the marker, base frame
    drift: Body by body needs "time_s" {
        rate_x, rate_y, rate_z: "mm/h", 0.1, 1.0;
    }
    // step of the marker at the slip time, base frame
    slip: Body by body needs "time_s" search "time_s" {
        step_x, step_y, step_z: "mm", 0.1, 1.0;
    }
    // by how much the marker seems to move, base frame, where the stands of robot and camera warm; in pixels this is a
    // camera that moves the other way
    thermal_shift: Sensor by body needs "temperature_c" search "lag_s" {
        shift_x, shift_y, shift_z: "mm/°C", 0.02, 1.0;
    }
    // by how much the camera's pose changed at the time of a slip
    sensor_slip: Sensor by pose needs "time_s" search "time_s" {
        turn_x, turn_y, turn_z: "rad", 2e-3, LEVER;
        shift_x, shift_y, shift_z: "mm", 0.5, 1.0;
    }
    // relative error of both focal lengths
    focal_length: Sensor by camera {
        focal: "1", 0.01, LEVER;
    }
    // errors of k₁, k₂, p₁, p₂
    lens_distortion: Sensor by camera {
        k1, k2: "1", 0.05, LEVER;
        p1, p2: "1", 2e-3, LEVER;
    }
    // how much earlier the camera shows the robot
    camera_delay: Sensor by joints needs "theta1_rad_per_s" "theta2_rad_per_s" {
        delay: "s", 0.02, LEVER;
    }
    // the cyclic error's second wave in each period; behind what rows of numbers from before it hold
    encoder_second: Joints by joints {
        sine_1, cosine_1, sine_2, cosine_2: "rad", 3e-4, LEVER;
    }
    // how fast the camera's pose changes, from the beginning of the run
    sensor_drift: Sensor by pose needs "time_s" {
        turn_rate_x, turn_rate_y, turn_rate_z: "rad/h", 5e-4, LEVER;
        shift_rate_x, shift_rate_y, shift_rate_z: "mm/h", 0.1, 1.0;
    }
}
