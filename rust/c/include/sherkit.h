/* sherkit inside a control loop: kinematics of a calibrated robot, fibres and filters of the flexible tool.
 *
 * Every function works on memory that the caller owns, takes bounded time, allocates nothing, takes no lock and never
 * panics. It answers with SHERKIT_OK or says why not; then nothing was written but what its comment says. One object
 * must not be used by two threads at a time, unless both only read it; different ones may.
 *
 * Lengths are mm, angles rad, forces mN, times s, wavelengths nm, temperatures degrees Celsius.
 *
 * Made from rust/c/src by cbindgen; do not edit. */

#ifndef SHERKIT_H
#define SHERKIT_H

#include <stddef.h>
#include <stdint.h>

// The base of the robot, as its drawing and its controller have it: where the robot is. Nothing of the instrument counts.
#define SHERKIT_FRAME_BASE 0

// The instrument that measured the robot: what it reads, errors and all, from where it stood at last.
#define SHERKIT_FRAME_SENSOR 1

// Done.
#define SHERKIT_OK 0

// A pointer that must point to something is null.
#define SHERKIT_NULL 1

// The object has not been initialised, or is one of another kind.
#define SHERKIT_NOT_INITIALISED 2

// A number in or out is NaN or infinite; a covariate may be what lacks.
#define SHERKIT_NOT_FINITE 3

// The robot cannot take this pose.
#define SHERKIT_OUT_OF_REACH 4

// The robot stands where joints and position do not follow from each other.
#define SHERKIT_SINGULAR 5

// The bounded iteration did not settle.
#define SHERKIT_NOT_CONVERGED 6

// Numbers that mean nothing: a negative variance, a length of zero, a geometry that is no robot, a frame that is none.
#define SHERKIT_INVALID 7

// A calibration that this version cannot read.
#define SHERKIT_UNREADABLE 8

// A measurement was used.
#define SHERKIT_STATUS_UPDATED 1

// There was no measurement.
#define SHERKIT_STATUS_MISSING 2

// The measurement is older than the state, or has been used already.
#define SHERKIT_STATUS_LATE 4

// The measurement holds a number that is not finite, or would have made the estimate so.
#define SHERKIT_STATUS_NOT_FINITE 8

// There is no force that would tell the depth.
#define SHERKIT_STATUS_NO_FORCE 16

// The pose is not finite, or its rotation no turn: the state stood still, and its covariance does not know how far it is off.
#define SHERKIT_STATUS_NO_MOTION 32

// The step's time is not finite or lies before the state's: nothing was done at all.
#define SHERKIT_STATUS_CLOCK 64

// The measurement contradicts the state or itself, and was not used.
#define SHERKIT_STATUS_GATED 128

// One of the SHERKIT codes: SHERKIT_OK, or why not.
typedef int32_t sherkit_result;

// A calibrated delta robot. Its content is nobody's business.
typedef struct sherkit_delta {
    uint64_t words[640];
} sherkit_delta;

// One of the SHERKIT_FRAME codes: where the coordinates of a place are counted from.
typedef uint32_t sherkit_frame;

// What a reading of the delta depends on beside its joints. NaN where it is not known; an effect that needs it then
// gives SHERKIT_NOT_FINITE.
typedef struct sherkit_delta_covariates {
    // Time, s, on the clock of the calibration.
    double time_s;
    // Temperature, degrees Celsius.
    double temperature_c;
    // Direction of the last motion of each joint: 1, -1 or 0.
    double direction[3];
} sherkit_delta_covariates;

// The filters of Ebrahimi et al. 2020 (Eqs. 8 and 14). Their content is nobody's business.
typedef struct sherkit_paper_filter {
    uint64_t words[128];
} sherkit_paper_filter;

// Calibration of the gratings.
typedef struct sherkit_sensor_calibration {
    // K_I and K_II, mN mm/nm: a row for each of the moments' components, a column for each fibre.
    double gains[2][2][3];
    // From the tip to sections I and II, mm.
    double distances_mm[2];
    // Wavelengths of the unloaded tool, nm: a row of fibres for each of the sections I, II, III.
    double reference_nm[3][3];
    // Standard deviation of one wavelength, nm.
    double noise_nm;
} sherkit_sensor_calibration;

// Length and stiffness of the shaft.
typedef struct sherkit_beam {
    // Free length h, mm.
    double length_mm;
    // Bending stiffness EI, mN mm^2.
    double stiffness;
} sherkit_beam;

// Pose of the tool: takes tool coordinates to the base frame. The tool's z axis runs along the unbent shaft and out
// of the tip, its origin is where the unbent tip would be.
typedef struct sherkit_pose {
    // Rotation, rows.
    double rotation[3][3];
    // Where the origin goes, mm.
    double translation_mm[3];
} sherkit_pose;

// What a step did with what it was given: a sum of these flags. Without SHERKIT_STATUS_UPDATED it only predicted.
typedef uint32_t sherkit_status;

// Depth and tip after a step.
typedef struct sherkit_tool_estimate {
    // Time of the estimate, s.
    double time_s;
    // Insertion depth, the paper's l: from the hole to the unbent tip, along the unbent axis, mm.
    double depth_mm;
    // Length of shaft beyond the hole, mm: shorter than the depth by what the bend takes.
    double arc_mm;
    // The tip in the base frame, mm.
    double tip_mm[3];
    // Covariance of depth and tip, mm^2.
    double covariance[4][4];
    // Force of the hole across the shaft, tool frame, mN.
    double force_mn[2];
    // Variance of each of its components, mN^2.
    double force_variance;
    // Square of what the moments of the last reading say across the force over its variance: about 1.
    double misfit;
    // Gratings that were not believed in the last reading: bit 3 section + fibre.
    uint32_t faulty;
    // What the step did.
    sherkit_status status;
} sherkit_tool_estimate;

// How often what happened, and the innovation statistics (NIS). nis_sum over nis_degrees is 1 where the noise is
// right, more where the filter is overconfident.
typedef struct sherkit_statistics {
    // Steps asked for.
    uint64_t steps;
    // Steps that used a measurement.
    uint64_t updated;
    // Steps without a measurement.
    uint64_t missing;
    // Measurements that came late.
    uint64_t late;
    // Measurements that were not finite.
    uint64_t not_finite;
    // Measurements without force.
    uint64_t no_force;
    // Motions that were not finite.
    uint64_t no_motion;
    // Steps refused for their time.
    uint64_t clock;
    // Measurements that were refused.
    uint64_t gated;
    // Updates that the sum is over.
    uint64_t nis_count;
    // Their degrees of freedom.
    uint64_t nis_degrees;
    // Sum of their normalised innovations squared.
    double nis_sum;
} sherkit_statistics;

// The fibres of a calibrated tool. Its content is nobody's business.
typedef struct sherkit_sensor {
    uint64_t words[64];
} sherkit_sensor;

// What the fibres tell at one time.
typedef struct sherkit_measurement {
    // When the fibres were read, s, on the clock of the steps.
    double time_s;
    // Sclera force, tool frame, mN.
    double force_mn[2];
    // Its covariance, mN^2.
    double force_covariance[2][2];
    // Insertion depth, mm; not read where its variance is infinite.
    double depth_mm;
    // Its variance, mm^2; infinite where there is no force that would tell the depth.
    double depth_variance;
    // Covariance of depth with force, mm mN.
    double depth_with_force[2];
} sherkit_measurement;

// A calibrated serial arm. Its content is nobody's business.
typedef struct sherkit_serial {
    uint64_t words[1152];
} sherkit_serial;

// What a pose of the arm depends on beside its joints. NaN where it is not known; an effect that needs it then gives
// SHERKIT_NOT_FINITE.
typedef struct sherkit_serial_covariates {
    // Time, s, on the clock of the calibration.
    double time_s;
    // Temperature, degrees Celsius.
    double temperature_c;
    // Direction of the last motion of each joint, 1, -1 or 0; those beyond its joints are not looked at.
    double direction[9];
    // What hangs at its first target besides its own weight, kg.
    double payload_kg;
} sherkit_serial_covariates;

// A calibrated spherical robot. Its content is nobody's business.
typedef struct sherkit_spherical {
    uint64_t words[192];
} sherkit_spherical;

// What a pose of the spherical robot depends on beside its joints. NaN where it is not known; an effect that needs
// it then gives SHERKIT_NOT_FINITE.
typedef struct sherkit_spherical_covariates {
    // Time, s, on the clock of the calibration.
    double time_s;
    // Temperature, degrees Celsius.
    double temperature_c;
    // Direction of the last motion of each joint: 1, -1 or 0.
    double direction[2];
} sherkit_spherical_covariates;

// The filter of a tool. Its content is nobody's business.
typedef struct sherkit_tool_filter {
    uint64_t words[2048];
} sherkit_tool_filter;

// A calibrated tool, and what its calibration does not know. A doubt of zero is certainty.
typedef struct sherkit_tool {
    // The gratings.
    struct sherkit_sensor_calibration sensor;
    // The shaft.
    struct sherkit_beam beam;
    // 1: it bends as an elastica; 0: as a cantilever by small angles.
    uint32_t exact;
    // What the mean of three fibres answers to a moment at sections I and II, nm per mN mm, and the standard deviation of
    // that over a fibre's own answer.
    double means_nm[2][2];
    // See above.
    double mean_doubt;
    // Covariance of t0, t1, t2, mm^2: at a length d beyond the hole the depth that the gratings measure is off by
    // t0 + t1 (d/10) + t2 (d/10)^2.
    double depth_covariance[3][3];
    // Standard deviation of how much deeper than that the gratings count all depths, mm.
    double deeper_doubt_mm;
    // Of how far the gratings are turned about the shaft against the robot's frame, rad.
    double turn_doubt_rad;
    // Of a force over the force.
    double force_doubt;
    // Standard deviation of a reference wavelength, nm.
    double reference_doubt_nm;
    // How unlike fibres answer to warmth: standard deviation over the mean answer.
    double warmth_unlike;
    // How much more than the mean of its section each fibre of sections I and II answers to warmth, relative, and the
    // standard deviation of that: `warmth_unlike` where nothing was learnt of it.
    double warmth[2][3];
    // See above.
    double warmth_doubt;
    // Covariance of length (mm) and stiffness (mN mm^2).
    double beam_covariance[2][2];
    // Radius by which the hole is wider than the shaft, and its standard deviation, mm.
    double clearance_mm;
    // See above.
    double clearance_doubt_mm;
    // How fast the hole strays along the shaft at least, mm^2/s.
    double per_second_mm2;
} sherkit_tool;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Nowhere defined.
extern void sherkit_has_a_path_to_a_panic(void);

// Loads a calibration: count numbers as sherkit writes them. They are not copied and must stay as they are for as
// long as the robot is used. Where it fails the robot is not initialised. Its positions are in the frame of the sensor,
// see sherkit_delta_use_frame.
sherkit_result sherkit_delta_init(struct sherkit_delta *robot, const double *numbers, size_t count);

// Chooses the frame of positions from now on: SHERKIT_FRAME_SENSOR, which it is after sherkit_delta_init, or
// SHERKIT_FRAME_BASE. A delta is sent where its instrument reads the tool, because only there the readings promise
// anything: how the base itself is tilted and shifted against them is no better known than the readings tell. In the
// frame of the base the robot is where it is, whatever the instrument makes of it.
// SHERKIT_INVALID for any other value, which changes nothing.
sherkit_result sherkit_delta_use_frame(struct sherkit_delta *robot, sherkit_frame frame);

// Position (3, mm) for joint readings (3, mm), and its derivative by them (9, row by row) unless jacobian is null,
// both in the frame that is used. Covariates may be null.
sherkit_result sherkit_delta_forward(const struct sherkit_delta *robot,
                                     const double *joints,
                                     const struct sherkit_delta_covariates *covariates,
                                     double *position,
                                     double *jacobian);

// Joint readings (3, mm) at which the robot stands at a position (3, mm) of the frame that is used, to 1 nm. Covariates
// may be null.
sherkit_result sherkit_delta_inverse(const struct sherkit_delta *robot,
                                     const double *position,
                                     const struct sherkit_delta_covariates *covariates,
                                     double *joints);

// Starts at a depth (mm) with a variance (mm^2, of each axis of the tip as well), with the tool at a pose, at a time
// (s), with the paper's noise for steps of 200 Hz. of_force: 1 where its entries for the tip are variances of the force
// (mN^2), 0 where they are of the deflection (mm^2); the paper gives no units. Where it fails the filter is not
// initialised.
sherkit_result sherkit_paper_filter_init(struct sherkit_paper_filter *filter,
                                         const struct sherkit_sensor_calibration *sensor,
                                         const struct sherkit_beam *beam,
                                         uint32_t of_force,
                                         double depth_mm,
                                         double variance,
                                         const struct sherkit_pose *pose,
                                         double time_s);

// One step to a time (s) with the tool at a pose, and nine wavelengths of that time (nm; three fibres at each of the
// sections I, II, III; null where there are none). In the estimate depth and tip are independent, arc_mm is depth_mm,
// force_variance and misfit are zero, and no grating is faulty: of these the paper says nothing. What could not be used
// is said by its status, not by the code.
sherkit_result sherkit_paper_filter_step(struct sherkit_paper_filter *filter,
                                         double time_s,
                                         const struct sherkit_pose *pose,
                                         const double *wavelengths_nm,
                                         struct sherkit_tool_estimate *estimate);

// How often what happened since the filter was initialised, and the innovations of the depth.
sherkit_result sherkit_paper_filter_statistics(const struct sherkit_paper_filter *filter,
                                               struct sherkit_statistics *statistics);

// The tool of Ebrahimi et al. 2020: 60 mm, 3 EI = 3.39e6 mN mm^2.
struct sherkit_beam sherkit_beam_ebrahimi_2020(void);

// Prepares the fibres. Where it fails the sensor is not initialised.
sherkit_result sherkit_sensor_init(struct sherkit_sensor *sensor, const struct sherkit_sensor_calibration *calibration);

// Force and depth from wavelengths (9, nm; three fibres at each of the sections I, II, III) read at a time. With
// SHERKIT_NOT_FINITE the measurement is written too, all NaN but the time.
sherkit_result sherkit_sensor_read(const struct sherkit_sensor *sensor,
                                   double time_s,
                                   const double *wavelengths_nm,
                                   struct sherkit_measurement *measurement);

// Loads a calibration: count numbers as sherkit writes them. They are copied. Where it fails the robot is not
// initialised. Its positions are in the frame of the base, see sherkit_serial_use_frame.
sherkit_result sherkit_serial_init(struct sherkit_serial *robot, const double *numbers, size_t count);

// Chooses the frame of positions from now on: SHERKIT_FRAME_BASE, which it is after sherkit_serial_init, or
// SHERKIT_FRAME_SENSOR. An arm's programs are written in its base, from which its controller counts, and the instrument
// is taken away after the measurement; in the frame of the sensor positions are what it would read where it stood at
// last. SHERKIT_INVALID for any other value, which changes nothing.
sherkit_result sherkit_serial_use_frame(struct sherkit_serial *robot, sherkit_frame frame);

// How many joints it has, 1 to 9.
sherkit_result sherkit_serial_joints(const struct sherkit_serial *robot, size_t *count);

// Position (3, mm) of the target, in the frame that is used, for the readings of its joints (rad, or mm of those that
// slide), and its derivative by them (3 times as many, row by row) unless jacobian is null. Covariates may be null.
sherkit_result sherkit_serial_forward(const struct sherkit_serial *robot,
                                      const double *joints,
                                      const struct sherkit_serial_covariates *covariates,
                                      double *position,
                                      double *jacobian);

// Readings of its joints within their limits at which the target is at a position (3, mm) of the frame that is used, to
// 1 nm: of many postures that to which the smallest steps lead from start, which is where the arm stands.
// SHERKIT_OUT_OF_REACH where they lead nowhere. Covariates may be null; joints and start may be the same array.
sherkit_result sherkit_serial_inverse(const struct sherkit_serial *robot,
                                      const double *position,
                                      const double *start,
                                      const struct sherkit_serial_covariates *covariates,
                                      double *joints);

// Loads a calibration: count numbers as sherkit writes them. They are copied. Where it fails the robot is not
// initialised.
sherkit_result sherkit_spherical_init(struct sherkit_spherical *robot, const double *numbers, size_t count);

// Where the tool points (phi, gamma, rad) for joint readings (2, rad), and its derivative by them (4, row by row)
// unless jacobian is null. Covariates may be null.
sherkit_result sherkit_spherical_forward(const struct sherkit_spherical *robot,
                                         const double *joints,
                                         const struct sherkit_spherical_covariates *covariates,
                                         double *angles,
                                         double *jacobian);

// Joint readings (2, rad) at which the tool points to phi, gamma (rad), to 1e-12 rad. Covariates may be null.
sherkit_result sherkit_spherical_inverse(const struct sherkit_spherical *robot,
                                         const double *angles,
                                         const struct sherkit_spherical_covariates *covariates,
                                         double *joints);

// Starts at a depth (mm) with a variance (mm^2), with the tool at a pose, at a time (s). Where it fails the filter is
// not initialised.
sherkit_result sherkit_tool_filter_init(struct sherkit_tool_filter *filter,
                                        const struct sherkit_tool *tool,
                                        double depth_mm,
                                        double variance,
                                        const struct sherkit_pose *pose,
                                        double time_s);

// One step to a time (s) with the tool at a pose, and a reading: nine wavelengths (nm; three fibres at each of the
// sections I, II, III; null where there is none) with the time that they were taken at, which may lie up to 0.3 s back.
// What could not be used is said by the estimate's status, not by the code.
sherkit_result sherkit_tool_filter_step(struct sherkit_tool_filter *filter,
                                        double time_s,
                                        const struct sherkit_pose *pose,
                                        double stamp_s,
                                        const double *wavelengths_nm,
                                        struct sherkit_tool_estimate *estimate);

// How often what happened since the filter was initialised.
sherkit_result sherkit_tool_filter_statistics(const struct sherkit_tool_filter *filter,
                                              struct sherkit_statistics *statistics);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SHERKIT_H */
