"""The built-in effects of the spherical robot and its camera, by link. The numbers run in `rust/core/src/spherical`."""

from __future__ import annotations

from ..parameters import Parameter
from .effect import Effect

#: What a radian moves on the sphere of the paper's robot, mm.
_LEVER_MM = 200.0


def _parameters(names: str, unit: str, size: float, lever_mm: float = 1.0) -> tuple[Parameter, ...]:
    return tuple(Parameter(name, name, unit, size, lever_mm) for name in names.split())


JOINT_OFFSET = Effect(
    name="joint_offset",
    link="joints",
    parameters=_parameters("offset_1 offset_2", "rad", 0.02, _LEVER_MM),
    physics="The zero of an encoder is not where the drawing has it: every reading of the joint is off by one angle.",
    residuals="The common part turns the whole picture about the actuated axis; the difference lifts the tool.",
    workshop="Drive each joint to its mechanical zero and set the encoder there.",
)
JOINT_SCALE = Effect(
    name="joint_scale",
    link="joints",
    parameters=_parameters("scale_1 scale_2", "rad/rad", 2e-3, _LEVER_MM),
    physics="The ratio of gear or belt is not quite what the drawing says, so an encoder counts too many or too few "
    "radians.",
    residuals="Grows in proportion to the travel of one joint; zero at the home position.",
    workshop="Compare a full turn of each joint with its index mark; correct counts per turn.",
)
ENCODER_ECCENTRICITY = Effect(
    name="encoder_eccentricity",
    link="joints",
    parameters=_parameters("sine_1 cosine_1 sine_2 cosine_2", "rad", 2e-3, _LEVER_MM),
    physics="The encoder's ring sits off the axis of its joint, so it errs by a sine once per turn.",
    residuals="A slow wave along one joint: one period in a whole turn.",
    workshop="Centre the ring with a dial gauge; or read it at two opposite places.",
)
BACKLASH = Effect(
    name="backlash",
    link="joints",
    parameters=_parameters("width_1 width_2", "rad", 2e-3, _LEVER_MM),
    needs=("direction",),
    physics="Play in gear and bearings: where a joint stops depends on the side from which it came.",
    residuals="Two values at one place, by the direction of the last motion.",
    workshop="Preload the gear; or approach every pose from the same side.",
)
UNEQUAL_LIMBS = Effect(
    name="unequal_limbs",
    link="structure",
    parameters=_parameters("proximal distal", "rad", 0.02, _LEVER_MM),
    physics="The two limbs are not alike: one has longer arcs than the other, by half the value each.",
    residuals="The tool leans to one side, more where it points away from the actuated axis.",
    workshop="Measure the arcs of both limbs on one fixture and match them.",
)
AXIS_OFFSET = Effect(
    name="axis_offset",
    link="structure",
    parameters=_parameters("across_1 along_1 across_2 along_2", "mm", 1.0),
    physics="The axis between the links of a limb misses the centre, so the remote centre of motion wanders as the "
    "robot moves.",
    residuals="Millimetres that turn with the joints, whatever the radius.",
    workshop="Shim the bearings of the elbows until their axes meet; this is what makes the robot safe.",
)
GRAVITY_FLEXURE = Effect(
    name="gravity_flexure",
    link="body",
    parameters=_parameters("bend_1 bend_2", "rad", 0.01, _LEVER_MM),
    physics="The distal links bend under the weight of the tool; the value is the bend under all of its moment.",
    residuals="Droop that grows with the horizontal lever arm of the tool.",
    workshop="Stiffen the distal links, or balance the tool.",
)
MARKER_OFFSET = Effect(
    name="marker_offset",
    link="body",
    parameters=_parameters("towards_elbow across", "mm", 2.0),
    physics="The marker is not on the tool axis: it sits beside it, and turns with the distal link.",
    residuals="A shift that turns with the tool.",
    workshop="Move the marker onto the axis, or measure where it is.",
)
CAMERA_POSE = Effect(
    name="camera_pose",
    link="sensor",
    parameters=(
        *_parameters("turn_x turn_y turn_z", "rad", 0.02, _LEVER_MM),
        *_parameters("shift_x shift_y shift_z", "mm", 5.0),
    ),
    physics="The camera does not stand where the drawing has it, or does not look where it should; in its own axes, "
    "x right, y down, z forward.",
    residuals="The whole picture turned, shifted, grown or in perspective.",
    workshop="Survey the camera with a board on the base; clamp it so that it stays.",
)
FOCAL_LENGTH = Effect(
    name="focal_length",
    link="sensor",
    parameters=_parameters("focal", "1", 0.01, _LEVER_MM),
    physics="The focal length differs from the calibrated one: the lens was refocused, or warmed up.",
    residuals="The picture grows or shrinks about its middle.",
    workshop="Lock the focus and calibrate the camera again.",
)
LENS_DISTORTION = Effect(
    name="lens_distortion",
    link="sensor",
    parameters=(*_parameters("k1 k2", "1", 0.05, _LEVER_MM), *_parameters("p1 p2", "1", 2e-3, _LEVER_MM)),
    physics="The lens bends straight lines: radially (k1, k2) and, where its elements are not centred, sideways "
    '(p1, p2). Source: Brown, "Decentering distortion of lenses", 1966.',
    residuals="Grows with the third power of the distance from the middle of the picture.",
    workshop="Calibrate the camera with a board that fills the picture to its corners.",
)
CAMERA_DELAY = Effect(
    name="camera_delay",
    link="sensor",
    parameters=_parameters("delay", "s", 0.02, _LEVER_MM),
    needs=("theta1_rad_per_s", "theta2_rad_per_s"),
    physics="A picture shows the robot a little earlier than its time stamp says: exposure, transfer, buffers.",
    residuals="Proportional to the velocity of the joints; none where the robot stands still.",
    workshop="Trigger camera and encoders together; or measure at rest.",
)

#: The catalogue in the order of the chain.
SPHERICAL_CATALOGUE: dict[str, Effect] = {
    e.name: e
    for e in (
        JOINT_SCALE, JOINT_OFFSET, BACKLASH, ENCODER_ECCENTRICITY, UNEQUAL_LIMBS, AXIS_OFFSET, GRAVITY_FLEXURE,
        MARKER_OFFSET, CAMERA_POSE, FOCAL_LENGTH, LENS_DISTORTION, CAMERA_DELAY,
    )
}  # fmt: skip
