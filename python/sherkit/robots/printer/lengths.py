"""How far off a printer's numbers have lengths: by distances that were measured, or by what heights leave open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from ...base.types import Bools, Floats
from ...data import Measurements
from ...errors import SherkitError
from ...fit.identify import Fit, identify
from .model import shapes_at
from .robot import PLATE, PROBED, PROBING, WEIGHT

#: A bowl that plates usually have, mm at :data:`~.model.SPAN_MM` from the middle.
BOWL_MM = 0.1
_RING = 2
#: Where lengths are asked for, as a part of the radius of the printed area, and in how many directions.
_OUT, _WAYS = 0.7, 6


def lengths_of(data: Measurements, left: Floats) -> float:
    """What is ``left`` (n, 1) of distances, RMS, mm; zero where none was measured."""
    rows, weight = _of_distances(data)
    return float(np.sqrt(np.mean(np.square(left[rows, 0] / weight)))) if rows.any() else 0.0


def size_of(best: Fit, left: Floats) -> tuple[float, float] | None:
    """By which part distances are longer than numbers say that ``left`` this (n, 1), and within which part that is
    known in 95 of 100 cases, by what the ``best`` fit leaves; None without distances."""
    data = best.data
    rows, _ = _of_distances(data)
    if not rows.any():
        return None
    length, off = data.readings[rows, 0], left[rows, 0]
    rest = best.residuals[data.used]
    noise = float(np.sqrt(rest @ rest / max(len(rest) - best.rank, 1)))
    within = noise / float(np.sqrt(length @ length)) * float(scipy.special.stdtrit(max(len(length) - 1, 1), 0.975))
    return float(length @ off / (length @ length)), within


def size_by_bowl(plain: Fit) -> float:
    """By which part sizes change where a bowl of :data:`BOWL_MM` is taken for other numbers, as heights alone do."""
    data, model = plain.data, plain.model
    bowl = shapes_at(model.tips(data)[:, :2], 0.0)[:, _RING] * BOWL_MM
    bent = replace(data, readings=data.readings - np.where(data.between_places, 0.0, bowl)[:, None])
    robot = model.robot
    turn = 2 * np.pi * np.arange(_WAYS) / _WAYS
    reach = _OUT * (robot.workspace_radius_mm or 0.8 * robot.towers.radius_mm)
    at = reach * np.column_stack([np.cos(turn), np.sin(turn)])
    sent = [robot.inverse_batch(np.column_stack([xy, robot.plane_mm(xy)])).values for xy in (at, -at)]
    ends = dict(zip(PROBED.to_joints, sent[1].T, strict=True))
    nothing = dict.fromkeys((PLATE, PROBING), np.zeros(_WAYS))
    plan = Measurements.planned(sent[0], PROBED, "lengths", **ends, **nothing)
    try:
        fits = plain, identify(model, bent, noise=plain.noise, start=plain.values)
    except SherkitError:
        return 0.0
    now, then = (one.model.predict(plan, one.values)[:, 0] for one in fits)
    return float(np.abs(then / now - 1.0).mean())


def _of_distances(data: Measurements) -> tuple[Bools, Floats]:
    """Which rows (n,) are distances that count, and what they are multiplied by."""
    rows = data.between_places & data.used[:, 0]
    return rows, data.covariates.get(WEIGHT, np.ones(len(data)))[rows]
