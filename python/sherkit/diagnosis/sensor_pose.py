"""The pose of a sensor: what it takes up where it is free, and whether it stands where it is known to.

What a free pose takes up are directions of effects and of the geometry that these readings cannot tell from where the
instrument stands. A lean common to all rails is a tilt of the tracker, a turn common to all base angles its turn; a
target fixed to the base would tell them apart, no reading of the tool does. What is known of a pose is a prior, which
readings contradict where both together are less likely than chance (a prior predictive check: Box, "Sampling and Bayes'
inference in scientific modelling and robustness", 1980).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ..base import linalg
from ..base.names import listed
from ..base.types import Floats
from ..data import Measurements
from ..evidence.whitening import orthonormal
from ..fit.identify import Fit
from ..fit.plausible import thinned
from ..fit.table import Direction
from ..model.base import ModelWithEffects
from ..model.effect import Effect
from ..model.sensor_pose import POSE, SHIFTS, TURNS
from ..model.set_ups import SETUP_PREFIX

#: Part of a direction that is left at most where it is taken up.
_TAKEN = 0.05
#: Directions of an effect beside its strongest that count.
_COUNTS = 1e-3
#: A known pose is contradicted where chance would do as much in one run of so many.
KNOWN_LEVEL = 1e-4
#: Directions of which readings tell less than this part of what is known already contradict nothing.
_TELLS = 0.01


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
        if taken := int(np.count_nonzero(left < _TAKEN**2)):
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


@dataclass(frozen=True)
class KnownStand:
    """How far a fit has a sensor from where it is known to stand: shift, mm, and turn, degrees, each with how well that
    is known (0 where it is not), and how likely that is (``p``: χ² of as many directions as the readings tell)."""

    shift_mm: float
    shift_sd_mm: float
    turn_deg: float
    turn_sd_deg: float
    p: float

    def __str__(self) -> str:
        each = ((self.shift_mm, self.shift_sd_mm, " mm"), (self.turn_deg, self.turn_sd_deg, "°"))
        told = [(f"{off:.2g}{unit}", f"± {sd:.2g}{unit}") for off, sd, unit in each if sd > 0]
        off, known = zip(*told, strict=True)
        return f"{' and '.join(off)} from where the robot's file has it, known within {' and '.join(known)}"


def known_stand(fit: Fit) -> KnownStand | None:
    """How far the sensor is from where it is known to stand; None where nothing is known of it that readings tell.

    With ``z`` (k,) the values in what is known of them and ``c`` an eigenvalue of their covariance there, readings
    weigh ``a = r² (1/c - 1)`` along its direction, by noise that is ``r`` times as large as it was taken for. If the
    sensor stands as well as is known, ``z`` has the variance ``(a/(1 + a))² (1 + r²/a)`` there.
    """
    named = [(k, p) for k, p in enumerate(fit.parameters) if p.known and p.name in POSE]
    if not named:
        return None
    at, sd = np.array([k for k, _ in named]), np.array([p.size for _, p in named])
    z = fit.values[at] / sd
    covariance = (fit.covariance + fit.unobserved_covariance)[np.ix_(at, at)] / np.outer(sd, sd)
    c, directions = linalg.eigh(covariance)
    ratio = float(fit.scale) ** 2
    a = ratio * (1.0 / c.clip(1e-300, 1.0) - 1.0)
    told = a > _TELLS
    if not told.any():
        return None
    a = a[told]
    along = directions[:, told].T @ z
    square = float((along**2 / ((a / (1.0 + a)) ** 2 * (1.0 + ratio / a))).sum())
    off, known = dict.fromkeys(POSE, 0.0), dict.fromkeys(POSE, 0.0)
    for k, p in named:
        off[p.name], known[p.name] = float(fit.values[k]), p.size
    sizes = [float(np.linalg.norm([off[name] for name in part])) for part in (SHIFTS, TURNS)]
    sds = [max(known[name] for name in part) for part in (SHIFTS, TURNS)]
    return KnownStand(
        sizes[0], sds[0], float(np.rad2deg(sizes[1])), float(np.rad2deg(sds[1])),
        float(scipy.special.chdtrc(len(a), square)),
    )  # fmt: skip
