"""A calibrated machine: what it shows for its joints, how to bring it to a reading, and how far off it may be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from ...base.figures import listed
from ...base.types import Bools, Floats
from ...data import Measurements
from ...data.columns import TEMPERATURE, TIME, bare, unit_in
from ...data.in_time import DRAWN_C
from ...data.toml import Table
from ...errors import NotConverged, OutOfReach
from ...model.chain import Block, ChainModel
from ...model.effect import Effect, Parameter, own_effect
from ..accuracy import Planes
from ..calibrated import Calibration
from ..calibration_run import CalibrationRun
from ..deployed import BASE, SENSOR
from ..identified_model import IdentifiedModel
from .core import MachineCore
from .described import MachineDescription
from .function import settled, starts

#: Effects of the instrument: where the machine goes, they are not.
_OF_INSTRUMENT = ("sensor_offset", "sensor_scale", "sensor_growth", "instrument_turned", "thermal_shift")


def _ours(parameters: Sequence[Parameter]) -> Bools:
    """Which of them move the machine, and not the instrument alone."""
    return np.array([p.name.partition(".")[0] not in _OF_INSTRUMENT for p in parameters], dtype=bool)


#: What an effect of the owner's own may ask of a loop: the moment and the room.
_KNOWN_IN_A_LOOP = {TIME, TEMPERATURE}
#: Step of a central difference, as a part of a joint's range.
_STEP = 1e-5


@dataclass(frozen=True, eq=False)
class OwnEffects:
    """Effects in NumPy at their values, in the order of the ``model`` that has them: a machine that is NumPy itself
    runs them in its loop as well. ``values`` (p,) are of all of the model's parameters, without those of the
    instrument."""

    model: ChainModel
    values: Floats

    def readings(self, joints: Floats, now: list[float]) -> Floats:
        """What is read (n, m) at these joints (n, k), at rest at this moment, which is that of every row whatever the
        one before it. Raises :class:`~sherkit.errors.FitError` for joints out of reach."""
        layout = self.model.layouts[0]
        moment = dict(zip((TIME, TEMPERATURE, *layout.directions), now, strict=False))
        every = {name: np.full(len(joints), value) for name, value in moment.items()}
        rows = Measurements.planned(joints, layout, "deployed", **every)
        made: Floats = self.model.predict(rows, self.values)[:, : rows.coordinates]
        return made

    def by_joints(self, joints: Floats, now: list[float], box: Floats) -> Floats:
        """Derivatives of the readings by the joints (n, m, k)."""
        out = []
        for k, step in enumerate(_STEP * np.maximum(np.ptp(box, axis=1), 1e-3)):
            off = np.zeros(joints.shape[1])
            off[k] = step
            out.append((self.readings(joints + off, now) - self.readings(joints - off, now)) / (2.0 * step))
        return np.stack(out, axis=2)


@dataclass(frozen=True, eq=False)
class MachineCalibrated:
    """The model of a control loop: the chain at ``values``, within the ``box`` (k, 2) of its joints. Its readings are
    those of the instrument, or, where that is ``seen_from`` the base by a turn (3, 3) and a shift (3,), places of the
    base."""

    chain: MachineCore
    values: Floats
    box: Floats
    seen_from: tuple[Floats, Floats] | None = None
    own: OwnEffects | None = None

    def block(self, joints: Floats, now: list[float]) -> Block:
        """Rows that all have the covariates of this moment, at rest."""
        known = np.concatenate([now, np.zeros(joints.shape[1]), [DRAWN_C]])
        return joints, None, np.tile(known, (len(joints), 1)), None

    def forward_batch(self, joints: Floats, now: list[float]) -> tuple[Floats, Floats, Bools]:
        """Readings (n, m), their derivatives by the joints (n, m, k), and which rows could be computed."""
        values, reached = self._shown(joints, now)
        by_joints = self.chain.derivatives(self.values, self.block(joints, now), [])[1]
        if self.own is not None and reached.any():
            by_joints[reached] = self.own.by_joints(joints[reached], now, self.box)
        if self.seen_from is not None:
            turn, shift = self.seen_from
            values, by_joints = (values - shift) @ turn, turn.T @ by_joints
        return values, by_joints, reached

    def _shown(self, joints: Floats, now: list[float]) -> tuple[Floats, Bools]:
        """Readings (n, m) as the instrument sees them, and which rows could be computed."""
        values, reached = self.chain.predict(self.values, self.block(joints, now))
        if self.own is not None and reached.any():
            values[reached] = self.own.readings(joints[reached], now)
        return values, reached

    def forward(self, joints: Floats, now: list[float]) -> tuple[Floats, Floats]:
        """The same of one pose. Raises :class:`~sherkit.errors.OutOfReach`."""
        values, by_joints, reached = self.forward_batch(joints[None, :], now)
        if not reached[0]:
            raise OutOfReach("the model's function gives no number for these joints", 0, float("nan"))
        return values[0], by_joints[0]

    def inverse(self, readings: Floats, now: list[float], begin: Floats | None = None) -> Floats:
        """Joints for readings (m,), from joints (k,) at which to ``begin``. Raises
        :class:`~sherkit.errors.NotConverged`."""
        joints, reached = self.inverse_batch(readings[None, :], now, None if begin is None else begin[None, :])
        if not reached[0]:
            how = "nowhere" if begin is None else "at no joints to which steps lead from the start"
            raise NotConverged(f"the machine shows this {how} within the ranges of its joints")
        return joints[0]

    def inverse_batch(
        self, readings: Floats, now: list[float], begin: Floats | None = None
    ) -> tuple[Floats, Bools]:  # fmt: skip
        """Joints of rows (n, m), each from its own at which to ``begin`` (n, k), or from the nearest of many over their
        ranges; those that cannot be reached are marked."""

        if self.seen_from is not None:
            turn, shift = self.seen_from
            readings = readings @ turn.T + shift

        def shown(joints: Floats) -> Floats:
            return self._shown(joints, now)[0]

        def forward(joints: Floats) -> tuple[Floats, Floats]:
            return replace(self, seen_from=None).forward_batch(joints, now)[:2]

        if begin is None:
            begin = starts(shown, readings, self.box)
        return settled(forward, readings, begin, self.box)


@dataclass(frozen=True, eq=False, repr=False)
class MachineCalibration(Calibration):
    """A calibrated machine. Its coordinates are its readings, without the errors of the instrument itself: as its
    instrument sees it, where that stood at last, unless the frame of the base is asked for of a machine whose sensor's
    pose is in the model.

    ``box`` (k, 2) is where its joints went, or may go.
    """

    called = ("readings", "readings")
    many_postures: ClassVar = True
    frame: ClassVar = SENSOR
    no_other: ClassVar = "where its instrument stands is not in its model"

    robot: MachineDescription
    whole: IdentifiedModel
    box: tuple[tuple[float, ...], ...]
    #: Effects of the owner's own that run in the loop, each with its values.
    own: tuple[tuple[Effect, tuple[float, ...]], ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        """Its class is made again with the machine."""
        return _again, (self.robot, self.whole, self.box, self.own)

    @classmethod
    def of(cls, whole: CalibrationRun, local: CalibrationRun | None = None) -> Self:
        """From a run; there is no local one."""
        del local
        fit = whole.fit
        data = fit.data
        # one that asks for more than a loop knows leaves all of them out: they were identified together
        unknown = dict.fromkeys(name for e in whole.own for name in e.needs if name not in _KNOWN_IN_A_LOOP)
        runs = not unknown
        held_out = (
            whole.held_out
            if runs
            else whole.deployed(
                whole.held_out,
                f"they need {listed(unknown)}, of which a control loop is not told (it is told the moment and "
                "the temperature),",
            )
        )
        own = [(one, tuple(fit.values[fit.model.owns(one)].tolist())) for one in whole.own] if runs else []
        use = data.taken.all(axis=1) & ~data.outlier
        went = data.joints[~data.outlier]
        low, high = went.min(axis=0), went.max(axis=0)
        if hasattr(fit.model.robot.joints, "keys"):  # ranges were given
            low, high = np.minimum(low, fit.model.robot.box[:, 0]), np.maximum(high, fit.model.robot.box[:, 1])
        left, scatter = whole.left(lambda missed: missed[use], held_out)
        part = IdentifiedModel.identified(fit, len(cls.coordinates))
        part = replace(part, left_out=()) if runs else part
        made = cls(fit.model.robot, part, tuple(zip(low.tolist(), high.tolist(), strict=True)), tuple(own))
        return replace(made, whole=part.leaving(left, scatter, made._rows(went)[0]))

    @property
    def frames(self) -> tuple[str, ...]:
        """That of the instrument, and that of the base where the model says where it stands."""
        return (SENSOR, BASE) if self.robot.pose is not None else (SENSOR,)

    @cached_property
    def core(self) -> MachineCalibrated:
        """The model of the control loop."""
        values = np.where(_ours(self.model.core_parameters), self.model.full(self.whole.values), 0.0)
        return MachineCalibrated(self.model.core, values, np.array(self.box), own=self._own_effects)

    @property
    def _own_effects(self) -> OwnEffects | None:
        """The effects of the owner's own, beside the model of the loop."""
        if not self.own:
            return None
        model: ChainModel = self.model
        for effect, _ in self.own:
            model = model.adopting(effect)
        values = np.zeros(len(model.parameters))
        values[: len(self.whole.values)] = np.where(_ours(self.model.parameters), self.whole.values, 0.0)
        for effect, numbers in self.own:
            values[model.owns(effect)] = numbers
        return OwnEffects(model, values)

    @cached_property
    def _core_elsewhere(self) -> MachineCalibrated:
        return replace(self.core, seen_from=self.sensor_frame)

    def counted(self, part: IdentifiedModel, frame: str) -> Bools:
        """Nor is what was identified of the instrument alone in any frame."""
        return super().counted(part, frame) & _ours(self.model.parameters[: len(part.values)])

    def by_values(self, part: IdentifiedModel, joints: Floats, now: list[float]) -> Floats:
        """Of its readings (n, m, p)."""
        del part
        core = self.core
        return core.chain.derivatives(core.values, core.block(joints, now), self.model.indices)[0]

    def places(self) -> list[tuple[str, Floats]]:
        """The middle of the run and what its joints' corners show."""
        low, high = np.array(self.box, dtype=float).reshape(-1, 2).T
        joints = np.stack([0.5 * (low + high), low, high])
        names: tuple[str, ...] = ("middle of its joints", "joints at their lower ends", "joints at their upper ends")
        if not len(low):
            joints, names = joints[:1], ("where it stands",)
        shown = self._rows(joints)[0]
        return [(name, place) for name, place in zip(names, shown, strict=True) if np.isfinite(place).all()]

    def planes(self, per_side: int) -> Planes:
        """Its first two readings over where the run went, the others as in the middle of the run."""
        low, high = self.whole.low, self.whole.high
        x, y, *_ = (*(np.linspace(a, b, per_side) for a, b in zip(low, high, strict=True)), np.zeros(1))
        names = [*(f"{bare(name)}, {unit_in(name)}" for name in self.coordinates), ""]
        grid = np.tile(0.5 * (low + high), (len(x) * len(y), 1))
        for axis, places in zip(grid.T, (np.tile(x, len(y)), np.repeat(y, len(x))), strict=False):
            axis[:] = places
        inside = self.inverse_batch(grid).reached
        return Planes(x, y, (names[0], names[1]), ("middle of the run",), grid, inside)

    def _settings(self) -> dict[str, Any]:
        own = [{"effect": effect.name, "values": list(values)} for effect, values in self.own]
        return {"box": [list(one) for one in self.box], **({"own": own} if own else {})}

    @classmethod
    def _settings_from(cls, table: Table) -> dict[str, Any]:
        own = []
        for one in table.tables("own"):
            name = one.words("effect")
            effect = own_effect(name)
            if effect is None:
                raise table.fail("own", f"an effect that this program knows: run the file of '{name}' first "
                                        f"(sk.model.load_effects)")  # fmt: skip
            own.append((effect, tuple(one.numbers("values", len(effect.parameters)))))
        return {"box": table.rows("box", 2), "own": tuple(own)}


def _again(robot: Any, *given: Any) -> MachineCalibration:
    made: MachineCalibration = robot.brings.calibration(robot, *given)
    return made
