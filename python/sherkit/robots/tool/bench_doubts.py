"""What a table of loads has wrong, seen before it is fitted: single loads, and columns against the drawing.

The gratings' shifts are linear in the moments at their sections, so gains by least absolute deviations show a wrong
load for what it is. Beside the drawing's gains they show axes that are exchanged or mirrored, gratings in each other's
columns, and forces in gram-force.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from ...base import linalg
from ...base.types import Bools, Floats
from .bench_fit import DIFFERENCES, LoadRows
from .tool import FIBRES, FlexibleTool

_ROUNDS = 30
#: A load is wrong that is off by this share of itself, and by so many times what half of the loads are off; no more
#: than this share of a table's.
_OFF, _TIMES, _MOST = 0.25, 8.0, 0.1
#: Gains agree with a drawing where they differ by less than this share, and do not where by more than the other.
_LIKE, _UNLIKE = 0.35, 0.7
#: Columns are exchanged where with that undone loads are off by less than this part of what they are.
_FOLLOWS = 0.4
#: Millinewtons in a gram-force, and how near to that a drawing's sizes come.
_GRAM_FORCE, _NEAR = 9.80665, 0.25


def wrong_loads(tool: FlexibleTool, rows: LoadRows) -> tuple[Bools, Floats]:
    """Rows (n,) whose force is not what their gratings say, and by how much the gratings' is larger (n,)."""
    moments = _moments(tool, rows)
    told = _told(rows, robust_gains(tool, rows))
    size = np.linalg.norm(moments, axis=2)
    # a wrong load is wrong at both sections, what is off at one alone is a small moment in noise
    off = (np.linalg.norm(told - moments, axis=2) / size).min(axis=1)
    # a wrong load changes the others' gains little, since each counts by its distance alone
    # a load cell's noise is the same in mN, what else a bench has is in proportion: it is beyond both
    off_mn = off * np.abs(rows.size_mn)
    bad = (off > max(_OFF, _TIMES * float(np.median(off)))) & (off_mn > _TIMES * float(np.median(off_mn)))
    if bad.mean() > _MOST:
        bad = np.zeros(len(off), dtype=bool)
    return bad, np.asarray((np.linalg.norm(told, axis=2) / size).mean(axis=1))


def against_drawing(tool: FlexibleTool, rows: LoadRows) -> list[str]:
    """Sentences on what the columns have wrong, by the drawing."""
    drawn = np.array(tool.gains)
    gains = robust_gains(tool, rows)
    if told := _across_sections(tool, rows, gains):
        return told
    size = float(np.linalg.norm(gains) / np.linalg.norm(drawn))
    for factor, unit in (
        (1.0 / _GRAM_FORCE, "gram-force"),
        (_GRAM_FORCE, "mN where the file's gains are per gram-force"),
    ):
        if abs(np.log(size / factor)) < _NEAR:
            told.append(
                f"gains are {size:.2g} times the drawing's, which is {factor:.3g}: are forces in {unit}? The columns "
                "force_x_mn and force_y_mn are in mN"
            )
    if _apart(gains, drawn) < _UNLIKE:
        return told
    for what, undone in _undone(tool, rows, gains):
        if _apart(undone, drawn) < _LIKE:
            return [*told, f"{what}: with that undone the gains are the drawing's"]
    turns = [np.linalg.det(gains[s] @ drawn[s].T) for s in range(2)]
    if max(turns) < 0.0:
        told.append(
            "the gains run about the shaft the other way than the drawing's: one axis of the forces is mirrored, or "
            "two columns of fibres are exchanged in both sections"
        )
    return told


def _across_sections(tool: FlexibleTool, rows: LoadRows, gains: Floats) -> list[str]:
    """Gratings of two sections in each other's columns: what no gains of these columns follow, and those of others do,
    whatever the drawing has."""
    own, best = _left(tool, rows, gains), (np.inf, "")
    for a, b in product(range(3), range(3, 6)):
        order = np.arange(6)
        order[[a, b]] = b, a
        undone = replace(rows, shifts_nm=rows.shifts_nm[:, order])
        left = _left(tool, undone, robust_gains(tool, undone))
        best = min(best, (left, f"{FIBRES[a]} and {FIBRES[b]} are exchanged"))
    if best[0] > _FOLLOWS * own:
        return []
    return [f"{best[1]}: loads are off by {own:.2g} of their moments, with that undone by {best[0]:.2g}"]


def _left(tool: FlexibleTool, rows: LoadRows, gains: Floats) -> float:
    """By which share of their moments half of the loads are off."""
    moments = _moments(tool, rows)
    off = np.linalg.norm(_told(rows, gains) - moments, axis=2)
    return float(np.median(off / np.linalg.norm(moments, axis=2)))


def _undone(tool: FlexibleTool, rows: LoadRows, gains: Floats) -> Iterator[tuple[str, Floats]]:
    """Mistakes, and the gains with each undone."""
    yield "force_x_mn and force_y_mn are exchanged", gains[:, ::-1]
    yield "force_y_mn has the other sign: its axis is mirrored", gains * np.array([[1.0], [-1.0]])
    yield "force_x_mn has the other sign: its axis is mirrored", gains * np.array([[-1.0], [1.0]])
    for a, b in combinations(range(6), 2):
        order = np.arange(6)
        order[[a, b]] = b, a
        swapped = robust_gains(tool, replace(rows, shifts_nm=rows.shifts_nm[:, order]))
        yield f"{FIBRES[a]} and {FIBRES[b]} are exchanged", swapped


def _apart(gains: Floats, drawn: Floats) -> float:
    """How far gains, made as large as the drawn ones, are from those, over their size."""
    gains = gains * (np.linalg.norm(drawn) / np.linalg.norm(gains))
    return max(float(np.linalg.norm(gains[s] - drawn[s]) / np.linalg.norm(drawn[s])) for s in range(2))


def _moments(tool: FlexibleTool, rows: LoadRows) -> Floats:
    """By the drawing's arms (n, 2, 2)."""
    arms = np.array(tool.distances_mm) - rows.depth_mm[:, None]
    return np.asarray((rows.size_mn[:, None] * arms)[:, :, None] * rows.way[:, None, :])


def _told(rows: LoadRows, gains: Floats) -> Floats:
    """By the gratings with these gains (n, 2, 2)."""
    return np.asarray(np.einsum("sad,nsd->nsa", gains @ DIFFERENCES.T, rows.differences_nm))


def robust_gains(tool: FlexibleTool, rows: LoadRows) -> Floats:
    """Gains (2, 2, 3) by least absolute deviations, relative to each moment by the drawing's arms: least squares,
    reweighted."""
    moments, differences = _moments(tool, rows), rows.differences_nm
    size = np.linalg.norm(moments, axis=2)
    weight = 1.0 / size
    found = np.zeros((2, 2, 2))
    for _ in range(_ROUNDS):
        for s in range(2):
            w = weight[:, s, None]
            found[s] = linalg.lstsq(w * differences[:, s], w * moments[:, s], rcond=None)[0].T
        off = np.linalg.norm(np.einsum("sad,nsd->nsa", found, differences) - moments, axis=2) / size
        weight = 1.0 / (size * np.sqrt(np.maximum(off, 1e-3)))
    return np.asarray(found @ DIFFERENCES)
