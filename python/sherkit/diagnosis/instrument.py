"""What the instrument did in the course of a run: how far it moved, at which row. It is said of the instrument, which
is no part of the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from ..base.figures import stated
from ..base.types import Floats
from ..fit.identify import Fit
from ..model.sensor_link import left_jacobian
from ..model.sensor_pose import POSE, SLIP, slip_of

#: Deviations from which on a motion is one.
_SEEN = 2.0


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
        if self.turn_rad[0] < _SEEN * self.turn_rad[1]:
            how = f"{shift}, without a turn ({turn})"
        elif self.shift_mm[0] < _SEEN * self.shift_mm[1]:
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
