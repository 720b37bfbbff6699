//! The table of the serial arm, for all the joints that one may have. What a robot has not, its model does not offer.
//!
//! Units, sizes and levers of what counts in the unit of a joint are those of a revolute one; the model turns them into
//! those of a prismatic one. Sizes are those of an industrial arm.

use crate::chain::effects::{OWN_LEVER, places};
use crate::chain::table::effects;

/// What a radian of a joint moves in a common arm, mm.
const LEVER: f64 = 500.0;
/// The moment that a common payload puts on a joint, N·m.
const MOMENT: f64 = 20.0;

// what the mechanism computes itself, in `structure.rs`
places! { At:
    joint_shift joint_tilt tool targets joint_coupling joint_compliance payload_compliance
    link_growth slip
}

effects! { At;
    // where the tracker sees the base frame: a turn of its picture of the robot, and a shift, in its own axes; people put
    // trackers anywhere
    sensor_pose: Sensor by pose (base) {
        sensor_turn_x, sensor_turn_y, sensor_turn_z: "rad", 1.0, OWN_LEVER;
        sensor_shift_x, sensor_shift_y, sensor_shift_z: "mm", 1000.0, 1.0;
    }
    // the zero of each joint
    joint_offset: Joints by joints (base) {
        offset_1 "δq₁", offset_2 "δq₂", offset_3 "δq₃", offset_4 "δq₄", offset_5 "δq₅", offset_6 "δq₆", offset_7 "δq₇",
        offset_8 "δq₈", offset_9 "δq₉": "rad", 0.01, OWN_LEVER;
    }
    // by how much each axis lies beside its place, along x and y of its frame
    joint_shift: Structure by structure (base) {
        shift_x_1, shift_y_1, shift_x_2, shift_y_2, shift_x_3, shift_y_3, shift_x_4, shift_y_4, shift_x_5, shift_y_5,
        shift_x_6, shift_y_6, shift_x_7, shift_y_7, shift_x_8, shift_y_8, shift_x_9, shift_y_9: "mm", 1.0, 1.0;
    }
    // by how much each axis leans, about x and y of its frame
    joint_tilt: Structure by structure (base) {
        tilt_x_1, tilt_y_1, tilt_x_2, tilt_y_2, tilt_x_3, tilt_y_3, tilt_x_4, tilt_y_4, tilt_x_5, tilt_y_5, tilt_x_6,
        tilt_y_6, tilt_x_7, tilt_y_7, tilt_x_8, tilt_y_8, tilt_x_9, tilt_y_9: "rad", 5e-3, OWN_LEVER;
    }
    // where the target is on the flange
    tool: Structure by structure (base) {
        tool_x, tool_y, tool_z: "mm", 5.0, 1.0;
    }
    // where other targets are on the flange
    targets: Structure by structure (base) {
        target_2_x, target_2_y, target_2_z, target_3_x, target_3_y, target_3_z, target_4_x, target_4_y,
        target_4_z: "mm", 5.0, 1.0;
    }
    // where the fixed centres are in the base frame, from which distances are read
    centres: Sensor by bar (base) {
        centre_1_x, centre_1_y, centre_1_z, centre_2_x, centre_2_y, centre_2_z, centre_3_x, centre_3_y, centre_3_z,
        centre_4_x, centre_4_y, centre_4_z, centre_5_x, centre_5_y, centre_5_z, centre_6_x, centre_6_y, centre_6_z,
        centre_7_x, centre_7_y, centre_7_z, centre_8_x, centre_8_y, centre_8_z: "mm", 20.0, 1.0;
    }
    // how the fixed planes lean, along two directions of their own, and how much higher they lie
    planes: Sensor by plane (base) {
        plane_1_lean_u, plane_1_lean_v: "rad", 0.02, OWN_LEVER; plane_1_height: "mm", 20.0, 1.0;
        plane_2_lean_u, plane_2_lean_v: "rad", 0.02, OWN_LEVER; plane_2_height: "mm", 20.0, 1.0;
        plane_3_lean_u, plane_3_lean_v: "rad", 0.02, OWN_LEVER; plane_3_height: "mm", 20.0, 1.0;
        plane_4_lean_u, plane_4_lean_v: "rad", 0.02, OWN_LEVER; plane_4_height: "mm", 20.0, 1.0;
    }
    // relative scale error of each encoder, about its home reading
    joint_scale: Joints by joints {
        scale_1, scale_2, scale_3, scale_4, scale_5, scale_6, scale_7, scale_8, scale_9: "rad/rad", 1e-3, LEVER;
    }
    // by how much each joint follows the one before it
    joint_coupling: Joints by structure {
        share_2, share_3, share_4, share_5, share_6, share_7, share_8, share_9: "rad/rad", 2e-3, LEVER;
    }
    // how far each joint gives way under the greatest moment that the weight behind it can make
    joint_compliance: Joints by structure {
        yield_1, yield_2, yield_3, yield_4, yield_5, yield_6, yield_7, yield_8, yield_9: "rad", 1e-3, LEVER;
    }
    // how far each joint gives way under what hangs at the target, by its moment about the joint
    payload_compliance: Joints by structure needs "payload_kg" {
        give_1, give_2, give_3, give_4, give_5, give_6, give_7, give_8, give_9: "rad/(N·m)", 3e-5, MOMENT * LEVER;
    }
    // lost motion of each joint: the full width between the two directions
    backlash: Joints by joints needs "direction" {
        width_1, width_2, width_3, width_4, width_5, width_6, width_7, width_8, width_9: "rad", 5e-4, LEVER;
    }
    // what each joint reads too little from the moment on at which it slipped
    joint_slip: Joints by joints needs "time_s" search "time_s" {
        step_1, step_2, step_3, step_4, step_5, step_6, step_7, step_8, step_9: "rad", 5e-4, LEVER;
    }
    // error of each encoder once per turn: sine and cosine, joint by joint
    encoder_eccentricity: Joints by joints {
        sine_1, cosine_1, sine_2, cosine_2, sine_3, cosine_3, sine_4, cosine_4, sine_5, cosine_5, sine_6, cosine_6,
        sine_7, cosine_7, sine_8, cosine_8, sine_9, cosine_9: "rad", 5e-4, LEVER;
    }
    // error of each encoder at the period: sine and cosine, joint by joint
    encoder_cyclic: Joints by joints search "period_rad" {
        sine_1, cosine_1, sine_2, cosine_2, sine_3, cosine_3, sine_4, cosine_4, sine_5, cosine_5, sine_6, cosine_6,
        sine_7, cosine_7, sine_8, cosine_8, sine_9, cosine_9: "rad", 3e-4, LEVER;
    }
    // expansion of the target's place about the origin of the base frame
    thermal_growth: Body by body needs "temperature_c" {
        coefficient "α": "1/°C", 2e-5, LEVER;
    }
    // expansion of each link: of the base, to the first joint; behind each joint, to the next one; to the target
    link_growth: Structure by structure needs "temperature_c" {
        base "α₀", link_1 "α₁", link_2 "α₂", link_3 "α₃", link_4 "α₄", link_5 "α₅", link_6 "α₆", link_7 "α₇",
        link_8 "α₈", link_9 "α₉": "1/°C", 2e-5, LEVER;
    }
    // drift of the target, base frame
    drift: Body by body needs "time_s" {
        rate_x, rate_y, rate_z: "mm/h", 0.1, 1.0;
    }
    // step of the targets at the slip time, in the frame behind the last joint that holds them
    slip: Structure by structure needs "time_s" search "time_s" {
        step_x, step_y, step_z: "mm", 0.2, 1.0;
    }
    // by how much the target seems to move, base frame, where the stands of arm and tracker warm
    thermal_shift: Sensor by body needs "temperature_c" search "lag_s" {
        shift_x, shift_y, shift_z: "mm/°C", 0.02, 1.0;
    }
    // by how much the tracker's frame moved at the time of its slip
    sensor_slip: Sensor by pose needs "time_s" search "time_s" {
        turn_x, turn_y, turn_z: "rad", 5e-4, LEVER;
        shift_x, shift_y, shift_z: "mm", 0.2, 1.0;
    }
    // relative error of all that the tracker reads
    sensor_scale: Sensor by tracker {
        scale: "mm/mm", 1e-4, LEVER;
    }
    // cubic error of each coordinate read, a metre from the middle
    sensor_linearity: Sensor by tracker {
        cubic_x, cubic_y, cubic_z: "mm", 0.2, 1.0;
    }
    // what a bar or wire adds to every distance
    bar_zero: Sensor by bar {
        length: "mm", 0.5, 1.0;
    }
    // how much earlier the reading shows the robot
    reading_delay: Sensor by joints needs "velocity" {
        delay: "s", 0.01, LEVER;
    }
    // the cyclic error's second wave in each period; behind what rows of numbers from before it hold
    encoder_second: Joints by joints {
        sine_1, cosine_1, sine_2, cosine_2, sine_3, cosine_3, sine_4, cosine_4, sine_5, cosine_5, sine_6, cosine_6,
        sine_7, cosine_7, sine_8, cosine_8, sine_9, cosine_9: "rad", 3e-4, LEVER;
    }
    // how fast the tracker's pose changes, from the beginning of the run
    sensor_drift: Sensor by pose needs "time_s" {
        turn_rate_x, turn_rate_y, turn_rate_z: "rad/h", 1e-4, LEVER;
        shift_rate_x, shift_rate_y, shift_rate_z: "mm/h", 0.1, 1.0;
    }
}
