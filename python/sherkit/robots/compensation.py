"""Tables by which a controller sets the errors of a calibrated machine right: axis by axis, or over a grid.

LinuxCNC reads, for each joint, lines of three numbers: where the axis is sent, and where it really is when it came
there upwards and downwards. It goes further by what is lacking (``COMP_FILE_TYPE = 0``), and stops reading at a line
that holds anything else, so that no note stands in the file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from ..base import linalg
from ..base.figures import listed, nearest
from ..base.types import Bools, Floats
from ..data.columns import unit_in
from ..errors import CalibrationError
from .calibrated import Calibration
from .deployed import BASE

#: Of effects that an axis by itself has, the link of the chain.
_JOINTS = "joints"
#: Those of them that hang on more than where the axis is.
_BEYOND = ("joint_coupling", "reading_delay")
#: LinuxCNC holds so many lines of an axis.
MOST_LINES = 256
#: Steps by which the place of a joint is found, and what is near enough, in units of the joint.
_ITERATIONS, _NEAR = 20, 1e-10
#: A grid has at most so many points.
_MOST_POINTS = 200_000


@dataclass(frozen=True)
class AxisTable:
    """Of one axis: where it is sent (n,), and where it really is, come upwards and downwards (n,), mm or degrees;
    ``left`` is what is left at most halfway between its lines, where a controller interpolates."""

    axis: str
    unit: str
    nominal: Floats
    upwards: Floats
    downwards: Floats
    left: float
    #: What was identified and is none of an axis by itself.
    others: tuple[str, ...] = ()

    @property
    def largest(self) -> float:
        """The largest error."""
        return float(max(np.abs(self.upwards - self.nominal).max(), np.abs(self.downwards - self.nominal).max()))

    @property
    def reversal(self) -> float:
        """The largest difference between both directions."""
        return float(np.abs(self.upwards - self.downwards).max())

    def linuxcnc(self) -> str:
        """The text of a ``comp`` file of type 0."""
        rows = zip(self.nominal, self.upwards, self.downwards, strict=True)
        return "".join(" ".join(f"{value:.9f}" for value in row) + "\n" for row in rows)


def axis_table(made: Calibration, axis: str | None = None, points: int = 101) -> AxisTable:
    """The errors of one axis by itself over its range, the others standing in the middle of theirs: what the effects of
    joints (scale, cyclic errors, backlash, zeros) add to where it is sent.

    Raises :class:`~sherkit.errors.CalibrationError` for a machine without such errors or axes, and an ``axis`` that it
    does not have; left out, it is the only one.
    """
    names, box = _axes(made)
    k = _which(names, axis)
    if not 2 <= points <= MOST_LINES:
        raise CalibrationError(f"points: expected 2 to {MOST_LINES}, got {points}")
    own = _of_axes(made)
    if not own.any():
        what = f"{listed(made.whole.effects)} is none of an axis" if made.whole.effects else "it has no effects"
        raise CalibrationError(
            f"no error of an axis by itself is in this calibration ({what}); calibrate with --effect joint_scale, "
            "encoder_cyclic or backlash, or write a grid"
        )
    at = _CompensatedAxis(made, _without(made, own), box, k)
    sent = np.linspace(box[k, 0], box[k, 1], points)
    # what the controller adds is what makes it right there
    trims = {side: at.trim(sent, side) for side in (1.0, -1.0)}
    between = 0.5 * (sent[1:] + sent[:-1])
    left = [at.really(between + np.interp(between, sent, trim), side) - between for side, trim in trims.items()]
    unit, per = ("deg", 180.0 / np.pi) if unit_in(names[k]) == "rad" else (unit_in(names[k]), 1.0)
    identified = [p.name for p in made.model.parameters[: len(own)]]
    others = [
        name.partition(".")[0] for name, mine in zip(identified, own, strict=True)
        if not mine and name not in made.model.of_sensor
    ]  # fmt: skip
    largest = per * float(np.abs(left).max())
    ways = (per * (sent - trims[1.0]), per * (sent - trims[-1.0]))
    return AxisTable(names[k], unit, per * sent, *ways, largest, tuple(dict.fromkeys(others)))


@dataclass(frozen=True, eq=False)
class _CompensatedAxis:
    """Axis ``k`` of a machine whose others stand in the middle of their ``box``: as it was ``made``, and ``without``
    the errors of its axes by themselves."""

    made: Calibration
    without: Calibration
    box: Floats
    k: int

    def really(self, sent: Floats, side: float) -> Floats:
        """Where the axis is (n,) that was sent to places (n,) from one side: the joint at which the machine without its
        axes' errors does the same."""
        joints = np.tile(self.box.mean(axis=1), (len(sent), 1))
        joints[:, self.k] = sent
        now = [*self.made.whole.now[:2], *(side for _ in self.box)]
        wanted, there = self.made.core.forward_batch(joints, now)[0], joints.copy()
        for _ in range(_ITERATIONS):
            shown, slopes, _ = self.without.core.forward_batch(there, now)
            step = (linalg.pinv(slopes) @ (wanted - shown)[:, :, None])[:, :, 0]
            there = np.ascontiguousarray(there + step)
            if np.abs(step).max() < _NEAR:
                break
        return there[:, self.k]

    def trim(self, sent: Floats, side: float) -> Floats:
        """What is to be added (n,) so that it is where it was sent."""
        out = np.zeros_like(sent)
        for _ in range(_ITERATIONS):
            lacking = sent - self.really(sent + out, side)
            out = out + lacking
            if np.abs(lacking).max() < _NEAR:
                break
        return out


def _without(made: Calibration, values: Bools) -> Calibration:
    """The same with some of the identified values (p,) at zero."""
    return replace(made, whole=replace(made.whole, values=np.where(values, 0.0, made.whole.values)))


def _of_axes(made: Calibration) -> Bools:
    """Which identified values (p,) are errors of axes by themselves."""
    model = made.model
    own = {effect.name for effect in model.built_in if effect.link == _JOINTS and effect.name not in _BEYOND}
    zeros = {p.name for p in model.base if p.name.startswith("offset_")}
    names = [p.name for p in model.parameters[: len(made.whole.values)]]
    return np.array([name in zeros or name.partition(".")[0] in own for name in names])


def grid_table(made: Calibration, points: int = 11) -> pl.DataFrame:
    """Over a grid of all its axes, what is to be added to where each is sent (columns ``add_`` and its name), so that
    the machine is where its drawing has it: rad or mm, null where that is out of reach. Of the postures that lead there
    the one that is near to where it was sent: a table that interpolates cannot go over to another.

    Raises :class:`~sherkit.errors.CalibrationError` for a machine without axes and for more points than 200 000.
    """
    names, box = _axes(made)
    if points < 2 or points ** len(names) > _MOST_POINTS:
        most = int(_MOST_POINTS ** (1.0 / len(names)))
        raise CalibrationError(f"points: expected 2 to {most} along each of {len(names)} axes, got {points}")
    frame = BASE if BASE in made.frames else None
    drawn = _without(made, np.ones(len(made.whole.values), dtype=bool))
    grid = np.stack(np.meshgrid(*(np.linspace(low, high, points) for low, high in box), indexing="ij"), axis=-1)
    joints = np.ascontiguousarray(grid.reshape(-1, len(names)))
    wanted = drawn.forward_batch(joints, frame=frame)
    found = made.inverse_batch(wanted.values, frame=frame, starts=joints)
    add = np.where((found.reached & wanted.reached)[:, None], found.values - joints, np.nan)
    columns = dict(zip(names, joints.T, strict=True)) | {f"add_{name}": a for name, a in zip(names, add.T, strict=True)}
    return pl.DataFrame(columns).with_columns(pl.all().fill_nan(None))


def _axes(made: Calibration) -> tuple[Sequence[str], Floats]:
    """Names of the joints of a machine and its box (k, 2)."""
    box = np.array(getattr(made, "box", ()), dtype=float)
    if box.ndim != 2 or not len(box):
        raise CalibrationError(
            f"a {made.robot.kind} robot has no axes that a table could compensate one by one: that is for a stage or "
            'an axis (sk.Machine); of an arm, "sherkit export program" makes the targets'
        )
    return made.model.layouts[0].joints, box


def _which(names: Sequence[str], axis: str | None) -> int:
    if axis is None and len(names) == 1:
        return 0
    if axis in names:
        return names.index(axis)
    if axis is None:
        raise CalibrationError(f"--axis: name one of {listed(names)}: a table is that of one axis")
    raise CalibrationError(f"--axis: '{axis}' is no axis of this machine{nearest(axis, names)}; it has {listed(names)}")
