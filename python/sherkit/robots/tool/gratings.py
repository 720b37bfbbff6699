"""What an interrogator does wrong, in words: which gratings were not believed, since when, and why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...base.types import Bools, Floats
from .columns import FIBRES
from .plausible import OUT_OF_REACH_NM

#: A grating that was not believed for fewer rows is a single outlier, and counted with the others.
_LASTING_ROWS = 20
_REPEATED = 0.9
_SWAPPED_NM = 0.08


@dataclass(frozen=True)
class Fault:
    """A grating (column) that was not believed in ``rows`` rows from ``since_s`` to ``until_s``, and what it did."""

    column: str
    since_s: float
    until_s: float
    rows: int
    what: str

    def __str__(self) -> str:
        return (
            f"{self.column}: {self.what}; left out in {self.rows} rows from {self.since_s:.2f} to {self.until_s:.2f} s"
        )


def faults_of(
    time_s: Floats, wavelengths_nm: Floats, reference_nm: Floats, faulty: NDArray[np.uint16]
) -> tuple[Fault, ...]:
    """Names what the filter left out (n,; a bit for each grating) of wavelengths (n, 9)."""
    bits = (faulty[:, None] >> np.arange(9)) & 1 > 0
    found: list[Fault] = []
    shift = wavelengths_nm - reference_nm
    for k in range(9):
        rows = bits[:, k]
        if int(rows.sum()) < _LASTING_ROWS:
            continue
        where = np.flatnonzero(rows)
        what = _what(k, rows, shift, bits)
        found.append(Fault(FIBRES[k], float(time_s[where[0]]), float(time_s[where[-1]]), len(where), what))
    return tuple(found)


def _what(k: int, rows: Bools, shift: Floats, bits: Bools) -> str:
    mine = shift[rows, k]
    if np.isnan(mine).mean() > 0.5:
        return "shows nothing"
    known = mine[np.isfinite(mine)]
    for j in range(9):
        # a column that shows its neighbour's peak stands off by the distance of their references
        if j != k and bits[rows, j].mean() > 0.5 and np.isfinite(shift[rows, j]).any():
            apart = float(np.median(known)) + float(np.nanmedian(shift[rows, j]))
            if abs(float(np.median(known))) > _SWAPPED_NM and abs(apart) < 0.3 * abs(float(np.median(known))):
                return f"shows the peak of {FIBRES[j]}, which shows its"
    if (np.diff(known) == 0).mean() > _REPEATED:
        return "is stuck or saturated: it repeats one number"
    if np.median(np.abs(known)) > OUT_OF_REACH_NM:
        return "shows what no grating can"
    section = slice(3 * (k // 3), 3 * (k // 3) + 3)
    if bits[rows][:, section].all(axis=1).mean() > 0.5:
        return "stands in a section that does not agree with the others: one of its three drifts"
    return "does not agree with the other gratings"
