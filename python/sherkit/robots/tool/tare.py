"""The wavelengths of the unloaded tool, from seconds in which nothing touched it: a tare before each run.

Where the tool warms meanwhile, the differences of three fibres follow their mean: the slopes are how unlike they answer
to warmth. What was known of that before counts with its own variance, so where nothing warms nothing is learnt
(Bayesian linear regression; Bishop, Pattern Recognition and Machine Learning, 2006, 3.3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...base import linalg
from ...base.types import Bools, Floats
from ...errors import MeasurementError
from .runs import ToolRun
from .tool import FlexibleTool, nested

#: Forces up to this many deviations are none, where they are none for so long, s.
_NO_FORCE, _STILL_S = 5.0, 0.5
#: Seconds without which nothing is tared.
_LEAST_S = 1.0
#: Readings over whose means errors that last are seen.
_LASTING = 100


@dataclass(frozen=True, eq=False)
class Tare:
    """``tool`` with its new references and its fibres' own answers to warmth, how far the references moved ``shift_nm``
    (9,), without what is common to a section, and the ``seconds`` from which they come."""

    tool: FlexibleTool
    shift_nm: Floats
    seconds: float


@linalg.one_thread()
def tare(tool: FlexibleTool, run: ToolRun, *, untouched: bool = False) -> Tare:
    """References from the unloaded seconds of a run, or from all of it where the tool was ``untouched``.

    What three fibres of a section have in common stays: it is warmth or pull, and no force. Unloaded are seconds of
    which every force lies within five deviations of none; fewer than one of them leave the tool as it is. Raises
    :class:`~sherkit.errors.MeasurementError` for an untouched run without wavelengths, or in which something was felt.
    """
    rows = run.present if untouched else unloaded(tool, run)
    seconds = float(rows.sum()) * run.step_s
    if untouched and not rows.any():
        raise MeasurementError(f"{run.source}: no row has wavelengths; the tare needs those of the untouched tool")
    if seconds < _LEAST_S and not untouched:
        return Tare(tool, np.zeros(9), 0.0)
    shift = run.wavelengths_nm[rows] - tool.reference_nm
    known = [*np.array(tool.warmth), np.zeros(3)]
    found = [
        _unloaded_section(own, before, tool.doubt.warmth, tool.noise_nm)
        for own, before in zip(shift.reshape(-1, 3, 3).transpose(1, 0, 2), known, strict=True)
    ]
    moved = np.concatenate([rest for rest, _, _ in found])
    made = replace(
        tool,
        reference_nm=nested(np.array(tool.reference_nm) + moved),
        warmth=nested(np.array([warmth for _, warmth, _ in found[:2]])),
        doubt=replace(tool.doubt, warmth=max(std for _, _, std in found[:2])),
    )
    if untouched:
        force, std = _forces(made, run)
        felt = float(np.quantile(np.linalg.norm(force[rows], axis=1), 0.99))
        if felt > 2.0 * _NO_FORCE * std:
            raise MeasurementError(
                f"{run.source}: something touched the tool ({felt:.1f} mN, where noise makes {std:.1f}); lead it freely"
            )
    return Tare(made, moved, seconds)


def _unloaded_section(
    shift_nm: Floats, warmth: Floats, warmth_std: float, noise_nm: float
) -> tuple[Floats, Floats, float]:
    """Where three unloaded fibres stand without what they have in common (3,), nm, and how much more than their mean
    each answers to warmth (3,), with one deviation: from shifts (n, 3) of one section. A fibre that shows nothing
    leaves it as it is."""
    shift = shift_nm[np.isfinite(shift_nm).all(axis=1)]
    n = len(shift)
    if not n or not warmth_std > 0.0:
        rest = (shift - shift.mean(axis=1, keepdims=True)).mean(axis=0) if n else np.zeros(3)
        return rest, warmth, warmth_std
    common = shift.mean(axis=1)
    own = shift - common[:, None]
    middle, still = float(common.mean()), own.mean(axis=0)
    # the mean's own noise warms nothing
    spread = max(float(((common - middle) ** 2).sum()) - n * noise_nm**2 / 3.0, 0.0)
    across = (common - middle) @ (own - still)
    before, variance = 1.0 / warmth_std**2, noise_nm**2
    blocks = n // _LASTING
    for _ in range(2):
        precision = before + spread / variance
        slope = (before * warmth + across / variance) / precision
        if blocks > 1:
            left = own - still - np.outer(common - middle, slope)
            means = left[: blocks * _LASTING].reshape(blocks, _LASTING, 3).mean(axis=1)
            # two of three are free
            variance = max(noise_nm**2, 1.5 * _LASTING * float((means**2).mean()))
    return still - slope * middle, slope, float(1.0 / np.sqrt(precision))


def unloaded(tool: FlexibleTool, run: ToolRun) -> Bools:
    """Rows (n,) in which no force was felt, nor half a second around."""
    force, std = _forces(tool, run)
    loaded = ~(np.linalg.norm(force, axis=1) <= _NO_FORCE * std)
    reach = max(1, round(_STILL_S / run.step_s))
    count = np.concatenate([[0], np.cumsum(loaded & run.present)])
    here = np.arange(len(run))
    near = count[np.minimum(here + reach + 1, len(run))] - count[np.maximum(here - reach, 0)]
    return np.asarray((near == 0) & run.present)


def _forces(tool: FlexibleTool, run: ToolRun) -> tuple[Floats, float]:
    """Forces (n, 2), and the deviation of one component, mN."""
    measured = tool.sensor.measure_batch(run.time_s, tool.as_if_cold(run.wavelengths_nm))[0]
    there = np.flatnonzero(run.present)
    std = float(np.sqrt(0.5 * (measured[there[0], 3] + measured[there[0], 6]))) if len(there) else float("nan")
    return measured[:, 1:3], std
