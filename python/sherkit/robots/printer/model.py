"""A linear delta printer as a model for identification: twelve errors of its geometry, read by a probe."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

import sherkit._core as _core

from ...base.figures import listed
from ...base.types import Bools, Floats
from ...data import Measurements
from ...errors import FitError
from ...fit.numpy_chain import NumpyChain
from ...model.base import Reachable
from ...model.chain import Block
from ...model.effect import Effect, Parameter, effect
from ...model.rows import EffectRows
from ...model.sensor_pose import HELD, POSE
from ..delta.model import CATALOGUE as DELTA
from ..delta.model import DeltaModel
from ..delta.robot import POSITION
from .callipers import weighed
from .robot import PLATE, PROBED, PROBING, WEIGHT, Printer

# -- The bed: its own shape, which turns with the plate, and the zero of each probing -----------------------------

#: Shapes are named by their height this far from the middle, mm.
SPAN_MM = 100.0
#: Smooth shapes of a plate: order in the distance from the middle, and how many lobes they have around it. A constant
#: is the zero of the probing.
_SHAPES = ((1, 1), (2, 0), (2, 2), (3, 1), (3, 3), (4, 0), (4, 2), (4, 4))
_NAMES = tuple(
    f"{kind}_{order}_{lobes}" if lobes else f"ring_{order}"
    for order, lobes in _SHAPES
    for kind in (("cosine", "sine") if lobes else ("",))
)


def shapes_at(xy: Floats, plate_deg: Floats | float) -> Floats:
    """The shapes (n, 14), 1 at their highest on a ring of :data:`SPAN_MM`, at places (n, 2), mm, of the machine under
    which the plate lies turned by ``plate_deg`` (n,)."""
    turn = np.exp(-1j * np.deg2rad(plate_deg))
    at = (xy[:, 0] + 1j * xy[:, 1]) * turn / SPAN_MM
    out = []
    for order, lobes in _SHAPES:
        wave = at**lobes * np.abs(at) ** (order - lobes)
        out += [wave.real, wave.imag] if lobes else [wave.real]
    return np.stack(out, axis=1)


def _columns(rows: Any, p: SimpleNamespace) -> Floats:
    """What the reading loses where the bed is higher (n, 1, 14); distances are none of the bed's."""
    del p
    return -np.where(rows.is_distance[:, None], 0.0, shapes_at(rows.position[:, :2], rows[PLATE]))[:, None, :]


@effect(
    at="sensor",
    parameters=dict.fromkeys(_NAMES, ("mm", 0.1)),
    needs=(PLATE,),
    physics="The plate that is probed is not flat: bent, bowed or twisted, smoothly; it turns with the plate.",
    remedy="Lay a straightedge and a feeler gauge across the plate, or turn it and probe again: what turns with it "
    "is its own. A mesh in the firmware covers it for printing.",
    derivative=_columns,
)
def bed_shape(rows: Any, p: SimpleNamespace) -> Floats:
    """Heights above a plate that is not flat."""
    return _columns(rows, p)[:, 0] @ np.array([getattr(p, name) for name in _NAMES])[:, None]


def _zeros(rows: Any, p: SimpleNamespace) -> Floats:
    """Which of the probings behind the first each row (n, 1, count) is from; distances have no zero."""
    of: Bools = rows[PROBING][:, None] == np.arange(1, len(vars(p)) + 1)
    return np.where(rows.is_distance[:, None], 0.0, of)[:, None, :]


@effect(
    at="sensor",
    parameters={"zero_1": ("mm", 1.0)},
    needs=(PROBING,),
    physics="The zero of a probe is set anew, or moves with the temperature, between one probing and the next.",
    remedy="None needed.",
    derivative=_zeros,
)
def probing_zero(rows: Any, p: SimpleNamespace) -> Floats:
    """The zero of each probing behind the first."""
    return _zeros(rows, p)[:, 0] @ np.array(list(vars(p).values()))[:, None]


def zeros_of(probings: int) -> Effect:
    """The zeros of so many probings: that of the first is in the end stops."""
    one = probing_zero.parameters[0]
    made = tuple(Parameter(f"zero_{k}", f"zero_{k}", one.unit, one.size) for k in range(1, probings))
    return replace(probing_zero, parameters=made)


# -- What may be wrong, in the order of the chain, in words of its owner ------------------------------------------

_BELTS = replace(
    DELTA["joint_scale"],
    physics="A belt moves its carriage a little more or less than the firmware believes: it is stretched, or of "
    "another pitch.",
    residuals="Grows with the travel of one carriage.",
    remedy="Send a carriage 300 mm down and measure with callipers or a steel rule how far it went; correct "
    "rotation_distance or the steps per millimetre of that tower.",
)
_LEAN = replace(
    DELTA["rail_lean"],
    physics="A tower does not stand upright: it leans out from the middle (radial) or sideways (tangential). All three "
    "leaning sideways the same way is a frame that is twisted.",
    residuals="High and low places between the towers that no radius, angle or arm length takes away.",
    remedy="Loosen the screws of the upper corner of that tower, push the frame until it is upright, tighten.",
)
_LOOSE = replace(
    DELTA["backlash"],
    physics="A loose belt or pulley: where a carriage stops depends on the side from which it came.",
    remedy="Tighten the belt and the pulley's screw. A probe that always comes from above does not show it.",
)
#: How far the two rods of a printer's arm usually differ, mm.
_RODS_MM = 0.2
_ARMS = replace(
    DELTA["rod_mismatch"],
    parameters=tuple(replace(p, size=_RODS_MM) for p in DELTA["rod_mismatch"].parameters),
    physics="The two rods of an arm differ in length, so the effector tilts as it moves, and a probe beside the nozzle "
    "is higher or lower than it.",
    remedy="Lay the two rods of each arm side by side on two pins and match their lengths.",
)

_CALLIPERS = replace(
    DELTA["bar_zero"],
    needs=(),
    physics="Callipers read every distance too long or too short by the same length: they are not at zero when closed, "
    "or their jaws do not touch the edges that are meant.",
    remedy="Close the callipers, set them to zero, and measure from edge to like edge.",
)

_PLATE = replace(bed_shape, residuals="A smooth shape over the plate that turns with it.")
_ZERO = replace(probing_zero, residuals="Constant over each probing.")

#: What is tried of a printer.
CATALOGUE: dict[str, Effect] = {one.name: one for one in (_BELTS, _LOOSE, _LEAN, _ARMS, _PLATE, _ZERO, _CALLIPERS)}


# -- The compiled chain of a delta, asked for the one number that a printer's row holds -----------------------------

#: Among the readings of a delta.
_HEIGHT, _DISTANCE = 2, 3


@dataclass(frozen=True, eq=False)
class Probed(NumpyChain):
    """The compiled chain of a delta with readings (n, 1)."""

    core: _core.DeltaModel
    #: Whether the last covariate of a block is what its readings are multiplied by.
    weighed: bool = False

    def predict(self, values: Floats, block: Block) -> tuple[Floats, Bools]:
        """Predicted readings (n, 1), and which rows have one."""
        block, weight = self._split(block)
        out, reached = self.core.predict(values, block)
        return _picked(out, block) * weight[:, None], reached

    def derivatives(self, values: Floats, block: Block, free: Sequence[int]) -> tuple[Floats, Floats, Floats, Bools]:
        """By parameters (n, 1, p), joints (n, 1, 3) and a displacement of the measured point (n, 1, 3)."""
        block, weight = self._split(block)
        *found, reached = self.core.derivatives(values, block, list(free))
        by_parameters, by_joints, by_body = (_picked(one, block) * weight[:, None, None] for one in found)
        return by_parameters, by_joints, by_body, reached

    def _split(self, block: Block) -> tuple[Block, Floats]:
        """A block as the core takes it, and what its readings (n,) are multiplied by."""
        joints, ends, known, push = block
        if not self.weighed or known is None:
            return block, np.ones(len(joints))
        own = np.ascontiguousarray(known[:, :-1]) if known.shape[1] > 1 else None
        return (joints, ends, own, push), known[:, -1]


def _picked(values: Floats, block: Block) -> Floats:
    """Of values (n, 4, …) those of the reading that each row holds (n, 1, …)."""
    ends = block[1]
    which = _HEIGHT if ends is None else np.where(np.isfinite(ends).all(axis=1), _DISTANCE, _HEIGHT)
    return np.ascontiguousarray(values[np.arange(len(values)), which][:, None])


# -- The model -------------------------------------------------------------------------------------------------------


class Touches(EffectRows):
    """The rows of a printer as its effects see them: ``position`` (n, 3) of the probe's tip, mm, and which of them
    ``is_distance`` (n,)."""

    def __init__(self, data: Measurements, position: Callable[[], Floats]) -> None:
        super().__init__(data, position)
        self.is_distance = data.between_places


@dataclass(frozen=True)
class PrinterModel(DeltaModel):
    """A nominal printer with named errors and effects to identify.

    A height is read above the bed, whose middle plane is the zero, by a probe that the printer carries: where that
    stands is held. By default the twelve errors of :class:`~sherkit.robots.delta.DeltaModel` are free, and the zero of
    each probing behind the first.
    """

    robot: Printer

    catalogue: ClassVar = CATALOGUE
    layouts: ClassVar = (PROBED,)
    within: ClassVar = frozenset({"sensor_pose", probing_zero.name})
    usual_pose_sd: ClassVar = (HELD, HELD)

    def __post_init__(self) -> None:
        several = len(self.robot.probings) > 1
        if several and probing_zero.name not in [e.name for e in self.effects]:
            object.__setattr__(self, "effects", (*self.effects, zeros_of(len(self.robot.probings))))
        super().__post_init__()

    @property
    def default(self) -> tuple[str, ...]:
        """The paper's twelve."""
        return tuple(name for name in super().default if name not in POSE)

    @property
    def known_effects(self) -> Mapping[str, Effect]:
        """What is tried of it; effects of the two rods of an arm only where their distance is known."""
        left_out = {probing_zero.name} if self.robot.rod_spacing_mm else {probing_zero.name, _ARMS.name}
        return {name: one for name, one in self.catalogue.items() if name not in left_out}

    @cached_property
    def core_parameters(self) -> tuple[Parameter, ...]:
        """Those of the compiled delta."""
        return DeltaModel(self.robot).core_parameters

    def core_for(self, data: Measurements) -> Any:
        """The compiled chain, asked for heights and distances."""
        return Probed(self.core, WEIGHT in data.covariates)

    def block(self, data: Measurements, joints: Floats | None = None, push: Floats | None = None) -> Block:
        """The rows as the core takes them."""
        at, ends, known, by = super().block(data, joints, push)
        if (weight := data.covariates.get(WEIGHT)) is not None:
            known = np.column_stack([weight] if known is None else [known, weight])
        return at, ends, known, by

    def as_declared(self, data: Measurements) -> Measurements:
        """As of any model, with distances in the noise of heights (:mod:`.callipers`)."""
        return weighed(self, super().as_declared(data))

    def covariates(self, data: Measurements) -> dict[str, Floats]:
        """As of any model; what a distance is multiplied by follows from its being one."""
        return {name: one for name, one in super().covariates(data).items() if name != WEIGHT}

    def require_own(self, data: Measurements) -> None:
        """Raises :class:`~sherkit.errors.FitError` for a run of something else, half a distance, or a probing that
        the robot file does not name."""
        super().require_own(data)
        ends = np.isfinite(data.to_joints)
        half = np.asarray(ends.any(axis=1) & ~ends.all(axis=1))
        if half.any():
            raise FitError(f"{data.place(half)}: a distance needs all of {listed(PROBED.to_joints)}")
        several = len(self.robot.probings)
        if several > 1 and PROBING not in data.covariates:
            raise FitError(
                f"{data.source}: column '{PROBING}' is missing: the robot file names {several} probings, and each row "
                "is to say from which it is (0 for the first)"
            )

    def tips(self, data: Measurements) -> Floats:
        """Where the tip of the probe was sent (n, 3), mm; at a distance, its first end."""
        return self.robot.forward_batch(data.joints).values

    def rows(self, data: Measurements, values: Floats) -> EffectRows:
        """The rows, with the places to which the tip of the probe was sent: a plate is smooth, and how far the tip is
        from there does not matter."""
        del values
        return Touches(data, lambda: self.tips(data))

    def reachable(self, data: Measurements, values: Floats) -> Reachable | None:
        """None: a printer is not sent to poses that would tell more; what to measure next is said in words."""
        del data, values
        return None

    def place(self, data: Measurements, predicted: Floats, values: Floats | None = None) -> dict[str, Floats]:
        """Where the printer was sent: x and y of the probe's tip."""
        del predicted
        at = self.tips(data)
        return dict(zip(POSITION[:2], at[:, :2].T, strict=True))
