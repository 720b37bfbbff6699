"""What is said of the effects that an arm has by itself, or says in its own words."""

from __future__ import annotations

from ...model.effect import Sentences

OWN = {
    "joint_coupling": Sentences(
        physics="A joint moves a little when the one before it does: a belt or shaft runs through that joint, as in "
        "many wrists, and the controller's ratio for it is missing or not quite right.",
        residuals="Proportional to the travel of the joint before, as if the next one had turned.",
        remedy="Enter the coupling ratio of this joint in the controller; check it by turning one joint alone.",
        sizes={"share": "joint {k} moves with the one before it by {size}"},
    ),
    "joint_compliance": Sentences(
        physics="Gears and bearings give way under the weight that a joint carries; the value is how far under the "
        "greatest moment that this weight can make.",
        residuals="Downwards, most where the arm is stretched out level, none where it stands upright.",
        remedy="Enter the payload and its centre in the controller; balance the arm; read joints behind gears.",
        sizes={"yield": "joint {k} gives way by {size}"},
    ),
    "payload_compliance": Sentences(
        physics="Gears and bearings give way under what hangs at the target; the value is how far a joint turns by the "
        "moment that this puts on it, or how far it slides by the force.",
        residuals="Downwards and proportional to the payload, most where the arm is stretched out level.",
        remedy="Enter mass and centre of each payload in the controller; calibrate with the payload of the work.",
        sizes={"give": "joint {k} gives way by {size}"},
    ),
    "link_growth": Sentences(
        physics="Each link expands with temperature by its own part: links of other materials, or nearer to motors, "
        "than the rest. Where all parts are equal, it is thermal_growth.",
        residuals="Along the links as they stand, proportional to the deviation of temperature from 20 °C.",
        remedy="Warm up before measuring; hold the temperature; links of carbon fibre or Invar.",
    ),
    "slip": Sentences(
        physics="What the last link holds moved in it at one moment: a nest that was knocked, a target or tool that "
        "let go, shifted or grew.",
        residuals="A step over time that turns with the last link.",
        remedy="Seat and tighten what the flange holds; measure again from the moment on.",
        sizes={"step": "the target jumped along the flange's {k} by {size}"},
    ),
    "sensor_scale": Sentences(
        physics="All that the instrument reads is too large or too small by the same part: air temperature and "
        "pressure of a laser tracker, focal length of a camera, a scale bar.",
        residuals="The picture of the robot grows about the instrument.",
        remedy="Enter air temperature and pressure; check the instrument on a scale bar.",
        sizes={"scale": "the instrument reads {size} too much/little"},
    ),
    "bar_zero": Sentences(
        physics="Every distance is read too long or too short by the same length: the bar's zero, the radius of its "
        "balls, the dead path of a wire or beam.",
        residuals="The same in every distance, whatever its length and direction.",
        remedy="Calibrate the bar on a gauge of known length.",
        sizes={"length": "every distance reads {size} too long/short"},
    ),
}
