"""What the kind of serial arms brings."""

from ...model.kinds import Kind
from .calibration import SerialCalibration
from .identified import drawing
from .imported import read_in_the_other_convention
from .model import SerialModel
from .robot import POSITION, Joint, Serial, layout_of_arm
from .virtual import AREAS, VirtualSerial

_TURN = (-175.0, 175.0)
#: A described example: six joints as most industrial arms have them, a wrist that is spherical.
_EXAMPLE = Serial(
    (
        Joint("joint_1", origin_mm=(0.0, 0.0, 300.0), limits=_TURN),
        Joint("joint_2", origin_mm=(50.0, 0.0, 100.0), axis=(0.0, 1.0, 0.0), limits=(-90.0, 110.0)),
        Joint("joint_3", origin_mm=(0.0, 0.0, 450.0), axis=(0.0, 1.0, 0.0), limits=(-120.0, 70.0)),
        Joint("joint_4", origin_mm=(200.0, 0.0, 40.0), axis=(1.0, 0.0, 0.0), limits=_TURN),
        Joint("joint_5", origin_mm=(250.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0), limits=(-110.0, 110.0)),
        Joint("joint_6", origin_mm=(80.0, 0.0, 0.0), axis=(1.0, 0.0, 0.0), limits=_TURN),
    ),
    target_mm=(120.0, 0.0, 60.0),
)

#: Arms of six and seven joints without names of their own: their runs are known before any robot is.
_COMMON = tuple(layout_of_arm([(f"joint_{i + 1}", "rad") for i in range(count)]) for count in (6, 7))

KIND = Kind(
    "serial", Serial, SerialModel, _COMMON, SerialCalibration, VirtualSerial, coordinates=POSITION, areas=AREAS,
    called="the serial arm", example=_EXAMPLE, own_layouts=lambda robot: (robot.layout,),
    misread=read_in_the_other_convention, drawing=drawing,
)  # fmt: skip
