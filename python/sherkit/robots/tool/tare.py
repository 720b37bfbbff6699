"""The wavelengths of the unloaded tool, from seconds in which nothing touched it: a tare before each run."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...errors import MeasurementError
from ...types import Bools, Floats
from .runs import ToolRun
from .tool import FlexibleTool

#: Forces up to this many deviations are none, where they are none for so long, s.
_NO_FORCE, _STILL_S = 5.0, 0.5
#: Seconds without which nothing is tared.
_LEAST_S = 1.0


@dataclass(frozen=True, eq=False)
class Tare:
    """``tool`` with its new references, how far they moved ``shift_nm`` (9,), without what is common to a section, and
    the ``seconds`` from which they come."""

    tool: FlexibleTool
    shift_nm: Floats
    seconds: float


def tare(tool: FlexibleTool, run: ToolRun, *, untouched: bool = False) -> Tare:
    """References from the unloaded seconds of a run, or from all of it where the tool was ``untouched``.

    What three fibres of a section have in common stays: it is warmth or pull, and no force. Unloaded are seconds of
    which every force lies within five deviations of none; fewer than one of them leave the tool as it is. Raises
    :class:`~sherkit.errors.MeasurementError` for an untouched run without wavelengths, or in which something was felt.
    """
    step = float(np.median(np.diff(run.time_s)))
    rows = run.present if untouched else unloaded(tool, run)
    seconds = float(rows.sum()) * step
    if untouched and not rows.any():
        raise MeasurementError(f"{run.source}: no row has wavelengths; the tare needs those of the untouched tool")
    if seconds < _LEAST_S and not untouched:
        return Tare(tool, np.zeros(9), 0.0)
    shift = run.wavelengths_nm[rows] - np.array(tool.reference_nm)
    sections = shift.reshape(-1, 3, 3)
    own = (sections - sections.mean(axis=2, keepdims=True)).reshape(-1, 9)
    # a fibre that shows nothing leaves its section as it is
    moved = np.nansum(own, axis=0) / np.isfinite(own).sum(axis=0).clip(1)
    made = replace(tool, reference_nm=tuple((np.array(tool.reference_nm) + moved).tolist()))
    if untouched:
        force, std = _forces(made, run)
        felt = float(np.quantile(np.linalg.norm(force[rows], axis=1), 0.99))
        if felt > 2.0 * _NO_FORCE * std:
            raise MeasurementError(
                f"{run.source}: something touched the tool ({felt:.1f} mN, where noise makes {std:.1f}); lead it freely"
            )
    return Tare(made, moved, seconds)


def unloaded(tool: FlexibleTool, run: ToolRun) -> Bools:
    """Rows (n,) in which no force was felt, nor half a second around."""
    force, std = _forces(tool, run)
    loaded = ~(np.linalg.norm(force, axis=1) <= _NO_FORCE * std)
    step = float(np.median(np.diff(run.time_s)))
    reach = max(1, round(_STILL_S / step))
    count = np.concatenate([[0], np.cumsum(loaded & run.present)])
    here = np.arange(len(run))
    near = count[np.minimum(here + reach + 1, len(run))] - count[np.maximum(here - reach, 0)]
    return np.asarray((near == 0) & run.present)


def _forces(tool: FlexibleTool, run: ToolRun) -> tuple[Floats, float]:
    """Forces (n, 2), and the deviation of one component, mN."""
    measured = tool.sensor.measure_batch(run.time_s, np.ascontiguousarray(run.wavelengths_nm))[0]
    there = np.flatnonzero(run.present)
    std = float(np.sqrt(0.5 * (measured[there[0], 3] + measured[there[0], 6]))) if len(there) else float("nan")
    return measured[:, 1:3], std
