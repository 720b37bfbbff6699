//! The table of the delta: its parameters in the order of the chain, with units, plausible sizes and levers.
//!
//! Sizes are those of a machined and assembled robot, geometry in the order of the paper's Table II. The place of each
//! row among the parameters follows from its place here.

use crate::chain::effects::{OWN_LEVER, places};
use crate::chain::table::effects;

/// One degree, rad.
const DEGREE: f64 = 1.0_f64.to_radians();

// what the mechanism computes itself, in `structure.rs`
places! { At:
    limb_1 platform_1 limb_2 platform_2 limb_3 platform_3 rail_lean rod_mismatch limb_twist gravity_sag
    drive_compliance link_growth
}

effects! { At;
    // geometric errors, limb by limb, as in `Geometry::parameters`; angles move what stands at their radius
    limb_1: Structure by structure (base) {
        base_radius_1 "δr_b₁": "mm", 3.0, 1.0;
        base_angle_1 "δθ_b₁": "rad", DEGREE, OWN_LEVER;
        joint_offset_1 "δq₁", rod_length_1 "δl₁": "mm", 2.0, 1.0;
    }
    platform_1: Structure by structure (base) {
        platform_radius_1 "δr_p₁": "mm", 1.0, 1.0;
        platform_angle_1 "δθ_p₁": "rad", DEGREE, OWN_LEVER;
    }
    limb_2: Structure by structure (base) {
        base_radius_2 "δr_b₂": "mm", 3.0, 1.0;
        base_angle_2 "δθ_b₂": "rad", DEGREE, OWN_LEVER;
        joint_offset_2 "δq₂", rod_length_2 "δl₂": "mm", 2.0, 1.0;
    }
    platform_2: Structure by structure (base) {
        platform_radius_2 "δr_p₂": "mm", 1.0, 1.0;
        platform_angle_2 "δθ_p₂": "rad", DEGREE, OWN_LEVER;
    }
    limb_3: Structure by structure (base) {
        base_radius_3 "δr_b₃": "mm", 3.0, 1.0;
        base_angle_3 "δθ_b₃": "rad", DEGREE, OWN_LEVER;
        joint_offset_3 "δq₃", rod_length_3 "δl₃": "mm", 2.0, 1.0;
    }
    platform_3: Structure by structure (base) {
        platform_radius_3 "δr_p₃": "mm", 1.0, 1.0;
        platform_angle_3 "δθ_p₃": "rad", DEGREE, OWN_LEVER;
    }
    // relative scale error of each encoder
    joint_scale: Joints by joints {
        scale_1, scale_2, scale_3: "mm/mm", 5e-4, 20.0;
    }
    // error of each encoder at the period: sine and cosine, joint by joint
    encoder_cyclic: Joints by joints search "period_mm" {
        sine_1, cosine_1, sine_2, cosine_2, sine_3, cosine_3: "mm", 0.005, 1.0;
    }
    // lost motion of each joint: the full width between the two directions
    backlash: Joints by joints needs "direction" {
        width_1, width_2, width_3: "mm", 0.02, 1.0;
    }
    // what each joint reads too little from the moment on at which it lost steps
    joint_slip: Joints by joints needs "time_s" search "time_s" {
        step_1, step_2, step_3: "mm", 0.1, 1.0;
    }
    // lean of each rail, limb by limb
    rail_lean: Structure by structure {
        radial_1, tangential_1, radial_2, tangential_2, radial_3, tangential_3: "rad", 5e-3, 20.0;
    }
    // difference in length of the two rods of each limb
    rod_mismatch: Structure by structure {
        difference_1, difference_2, difference_3: "mm", 0.1, 1.0;
    }
    // turn of each limb's joint axis at the carriage against that at the platform, about the vertical
    limb_twist: Structure by structure {
        twist_1 "δψ₁", twist_2 "δψ₂", twist_3 "δψ₃": "rad", 0.01, 20.0;
    }
    // how far each carriage gives way along its rail if that carried the platform's whole weight alone
    drive_compliance: Structure by structure {
        yield_1, yield_2, yield_3: "mm", 0.05, 1.0;
    }
    // stretch of each limb if it carried the platform's whole weight alone
    gravity_sag: Body by structure {
        compliance_1, compliance_2, compliance_3: "mm", 0.05, 1.0;
    }
    // expansion of the measured position
    thermal_growth: Body by body needs "temperature_c" {
        coefficient "α": "1/°C", 2e-5, 20.0;
    }
    // expansion of the rods, of frame and platform across, of the rails with their scales
    link_growth: Structure by structure needs "temperature_c" {
        rods, frame, rails: "1/°C", 2e-5, 20.0;
    }
    // drift of the measured point
    drift: Body by body needs "time_s" {
        rate_x, rate_y, rate_z: "mm/h", 0.1, 1.0;
    }
    // step of the measured point at the slip time
    slip: Body by body needs "time_s" search "time_s" {
        step_x, step_y, step_z: "mm", 0.1, 1.0;
    }
    // by how much robot and instrument move apart where their stands warm
    thermal_shift: Sensor by body needs "temperature_c" search "lag_s" {
        shift_x, shift_y, shift_z: "mm/°C", 0.01, 1.0;
    }
    // what the sensors show of each coordinate beyond the coordinate itself: 3 × 3, row by row
    beam_alignment: Sensor by cartesian {
        x_by_x "xx": "mm/mm", 1e-3, 20.0;
        x_by_y "xy", x_by_z "xz", y_by_x "yx": "mm/mm", 5e-3, 20.0;
        y_by_y "yy": "mm/mm", 1e-3, 20.0;
        y_by_z "yz", z_by_x "zx", z_by_y "zy": "mm/mm", 5e-3, 20.0;
        z_by_z "zz": "mm/mm", 1e-3, 20.0;
    }
    // cubic error of each sensor at `LINEARITY_SPAN_MM` from its zero
    sensor_linearity: Sensor by cartesian {
        cubic_x, cubic_y, cubic_z: "mm", 0.005, 1.0;
    }
    // where the sensors see the base frame: a turn of their picture of the robot, and a shift, in their own axes
    sensor_pose: Sensor by pose (base) {
        sensor_turn_x, sensor_turn_y, sensor_turn_z: "rad", 1.0, OWN_LEVER;
        sensor_shift_x, sensor_shift_y, sensor_shift_z: "mm", 10.0, 1.0;
    }
    // by how much that changed at the time of a slip
    sensor_slip: Sensor by pose needs "time_s" search "time_s" {
        turn_x, turn_y, turn_z: "rad", 2e-3, 20.0;
        shift_x, shift_y, shift_z: "mm", 0.1, 1.0;
    }
    // the cyclic error's second wave in each period; behind what rows of numbers from before it hold
    encoder_second: Joints by joints {
        sine_1, cosine_1, sine_2, cosine_2, sine_3, cosine_3: "mm", 0.002, 1.0;
    }
    // what a bar or callipers add to every distance; the last for the same reason
    bar_zero: Sensor by bar needs "distance_mm" {
        length: "mm", 0.1, 1.0;
    }
    // how fast the sensors' pose changes, from the beginning of the run
    sensor_drift: Sensor by pose needs "time_s" {
        turn_rate_x, turn_rate_y, turn_rate_z: "rad/h", 5e-4, 20.0;
        shift_rate_x, shift_rate_y, shift_rate_z: "mm/h", 0.1, 1.0;
    }
}
