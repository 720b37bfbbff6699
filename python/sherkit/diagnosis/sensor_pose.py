"""The pose of a sensor: what it takes up where it is free, and what else would do where it stands elsewhere than known.

What a free pose takes up are directions of effects and of the geometry that these readings cannot tell from where the
instrument stands. A lean common to all rails is a tilt of the tracker, a turn common to all base angles its turn; a
target fixed to the base would tell them apart, no reading of the tool does.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from ..base import linalg
from ..base.figures import listed, stated
from ..base.types import Floats
from ..data import Measurements
from ..errors import SherkitError
from ..evidence.fitted_run import FittedRun
from ..evidence.plausible import is_plausible
from ..evidence.thresholds import SEEN_SIGMA, TWIN
from ..evidence.whitening import orthonormal
from ..fit.identify import Fit
from ..fit.known_stand import known_stand
from ..fit.plausible import thinned
from ..fit.table import Direction
from ..model.base import ModelWithEffects
from ..model.effect import Effect
from ..model.sensor_pose import POSE, SLIP, left_jacobian, slip_of
from ..model.set_ups import SETUP_PREFIX

# -- What a free pose takes up -----------------------------------------------------------------------------------------

#: Directions of an effect beside its strongest that count.
_COUNTS = 1e-3


def taken_by_pose(
    model: ModelWithEffects, rows: Measurements, values: Floats, effects: Sequence[Effect]
) -> dict[str, tuple[int, int]]:
    """Of each effect how many of its directions only the sensor's pose takes up, of how many that the other parameters
    leave; those of which it takes none are not there."""
    names = [p.name for p in model.parameters]
    of_pose = np.array(
        [
            name.startswith((*POSE, SETUP_PREFIX)) and not p.known
            for name, p in zip(names, model.parameters, strict=True)
        ],
        dtype=bool,
    )
    if not of_pose.any():
        return {}
    data = thinned(rows)
    fitted = _flat(data, model.derivatives(data, values))
    others, whole = orthonormal(fitted[:, ~of_pose]), orthonormal(fitted)
    # what is searched for besides is a moment, a lag or a period: no pose that stays
    asked = [one for one in model.is_testable(effects, data)[0] if one.search is None]
    tried = model.tried(data, values, asked)
    every = _flat(data, tried.columns(slice(None)))
    out = {}
    for effect, at in tried.effects:
        columns = every[:, at] * [p.size for p in effect.parameters]
        if not np.isfinite(columns).all():
            continue
        before, after = (columns - basis @ (basis.T @ columns) for basis in (others, whole))
        value, vector = linalg.eigh(before.T @ before)
        kept = value > _COUNTS**2 * max(float(np.square(columns).sum(axis=0).max(initial=0.0)), 1e-300)
        root = vector[:, kept] / np.sqrt(value[kept])
        if not root.shape[1]:
            continue
        left = linalg.eigvalsh(root.T @ (after.T @ after) @ root)
        if taken := int(np.count_nonzero(left < (1.0 - TWIN) ** 2)):
            out[effect.name] = (taken, root.shape[1])
    return out


def _flat(data: Measurements, columns: Floats) -> Floats:
    return np.asarray(columns[data.used])


def pose_in_words(unobserved: Sequence[Direction], taken: dict[str, tuple[int, int]]) -> str | None:
    """What the pose takes up, in a sentence, with the combinations of parameters that no reading shows; None where it
    is told from everything."""
    named = [f"{count} of the {of} directions of {name}" for name, (count, of) in taken.items()]
    same = []
    for one in unobserved:
        mine = [name for name in one.change if name.startswith((*POSE, SETUP_PREFIX))]
        others = [name for name in one.change if name not in mine]
        if mine and others:
            same.append(f"{listed(mine)} from {listed(sorted(others))} together")
    if not named and not same:
        return None
    told = "The sensor's pose is free"
    if named:
        told += f": it takes up {listed(named, 12)}"
    if same:
        told += f"{'; nor' if named else ':'} can these readings tell {'; '.join(same)}"
    return (
        f"{told}. Three points fixed to the base that are read as well would tell where their places in its frame are "
        "known (sensor_pose of the robot's file, by SensorPose.from_targets), or a level on the base."
    )


# -- where it is known to stand ------------------------------------------------------------------------------------


def stands_with(run: FittedRun) -> tuple[str, ...]:
    """Effects of a plausible size, each of which alone has the sensor of a run where it is known to stand."""
    tried, _ = run.model.is_testable([effect for effect in run.catalogue if effect.search is None], run.data)
    out = []
    for effect in tried:
        with contextlib.suppress(SherkitError):
            more = run.refit([(effect, None)])
            stand = known_stand(more.fit)
            if more.fit.converged and is_plausible(more, effect) and stand is not None and stand.holds:
                out.append(effect.name)
    return tuple(out)


# -- What the instrument did in the course of a run --------------------------------------------------------------------
# What the instrument did in the course of a run: how far it moved, at which row. It is said of the instrument,
# which is no part of the robot.


@dataclass(frozen=True)
class Motion:
    """By how much the instrument moved: what it sees of the middle of the readings is shifted by ``shift_mm`` and
    turned by ``turn_rad``, each with its standard deviation, from the row at ``line`` on, which was read at
    ``time_s``."""

    shift_mm: tuple[float, float]
    turn_rad: tuple[float, float]
    line: int
    counted: str
    time_s: float

    def __str__(self) -> str:
        shift, turn = stated(*self.shift_mm, "mm"), stated(*self.turn_rad, "rad")
        if self.turn_rad[0] < SEEN_SIGMA * self.turn_rad[1]:
            how = f"{shift}, without a turn ({turn})"
        elif self.shift_mm[0] < SEEN_SIGMA * self.shift_mm[1]:
            how = f"{turn}, without a shift ({shift})"
        else:
            how = f"{shift} and {turn}"
        return f"the instrument moved by {how} at {self.counted} {self.line} (time_s = {self.time_s:.1f})"

    @property
    def numbers(self) -> dict[str, float]:
        """For programs."""
        return {"shift_mm": self.shift_mm[0], "turn_deg": float(np.rad2deg(self.turn_rad[0])), "time_s": self.time_s}


def motion_of(fit: Fit) -> Motion | None:
    """The motion of the instrument as a fit has it; None where its model has none."""
    model: Any = fit.model
    effect = next((e for e in model.effects if e.name == SLIP), None)
    when = None if effect is None else model.setting_of(effect)
    if effect is None or when is None or fit.data.time_s is None:
        return None
    (turn, shift), (turned, shifted) = (model.sensor_frame(fit.values, slipped=on) for on in (False, True))
    middle = _middle(fit)
    by = np.concatenate([
        scipy.spatial.transform.Rotation.from_matrix(turned @ turn.T).as_rotvec(),
        (turned - turn) @ middle + shifted - shift,
    ])  # fmt: skip
    spread = _spread(fit, turned @ middle)
    late = np.flatnonzero(fit.data.time_s >= when)
    row = int(late[np.argmin(fit.data.time_s[late])]) if len(late) else len(fit.data) - 1
    turns, shifts = slice(0, 3), slice(3, 6)
    return Motion(
        _length(by[shifts], spread[shifts, shifts]), _length(by[turns], spread[turns, turns]),
        int(fit.data.line[row]), fit.data.counted, float(fit.data.time_s[row]),
    )  # fmt: skip


def _middle(fit: Fit) -> Floats:
    """The middle (3,) of what was read, mm, base frame; the origin where readings are no places."""
    model, data, out = fit.model, fit.data, np.zeros(3)
    if model.reads_places(data):
        places = model.at_base(fit.predicted[:, : data.coordinates], fit.values)
        out[: places.shape[1]] = places[data.used[:, : data.coordinates].any(axis=1)].mean(axis=0)
    return out


def _spread(fit: Fit, seen: Floats) -> Floats:
    """Covariance (6, 6) of turn and shift of what is ``seen`` (3,) without its shift, from that of the numbers."""
    names = [p.name for p in fit.parameters]
    here = [k for k, name in enumerate(POSE) if slip_of(name) in names]
    at = [names.index(slip_of(POSE[k])) for k in here]
    known = dict(zip(names, fit.values.tolist(), strict=True))
    off = np.array([known.get(name, 0.0) + known.get(slip_of(name), 0.0) for name in POSE])
    by = np.eye(6)
    by[:3, :3] = left_jacobian(off[:3])
    by[3:, :3] = np.cross(by[:3, :3], seen, axisa=0).T
    by = by[:, here]
    both = fit.covariance + fit.unobserved_covariance
    return np.asarray(by @ both[np.ix_(at, at)] @ by.T)


def _length(vector: Floats, spread: Floats) -> tuple[float, float]:
    """The length of a vector and its standard deviation along it."""
    length = float(np.linalg.norm(vector))
    along = vector / length if length > 0 else np.full(3, 3**-0.5)
    return length, max(float(along @ spread @ along), 0.0) ** 0.5


def called(effects: Sequence[str]) -> str:
    """Effects by name in one text, with the instrument's motion said as what it is."""
    return ", ".join(f"the instrument moved ({name})" if name == SLIP else name for name in effects)
