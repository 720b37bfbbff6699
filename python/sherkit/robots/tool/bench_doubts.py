"""What a table of loads has wrong, seen before it is fitted: single loads, and columns against the drawing.

The gratings' shifts are linear in the moments at their sections, so gains by least absolute deviations show a wrong
load for what it is; moments are those of the drawn rod, however a table is to be read. Beside the drawing's gains they
show axes that are exchanged or mirrored, gratings in each other's columns, and forces in gram-force.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, permutations

import numpy as np

from ...base import linalg
from ...base.figures import listed
from ...base.types import Bools, Floats, Ints
from .bench_fit import CONVENTIONS, DIFFERENCES, BenchModel, LoadRows
from .tool import FIBRES, FlexibleTool

_ROUNDS = 30
#: A load is wrong that is off by this share of itself, and by so many times what half of the loads are off; no more
#: than this share of a table's.
_OFF, _TIMES, _MOST = 0.1, 8.0, 0.1
#: Gains agree with a drawing where they differ by less than this share, and do not where by more than the other.
_LIKE, _UNLIKE = 0.35, 0.7
#: Columns are exchanged where with that undone loads are off by less than this part of what they are.
_FOLLOWS = 0.4
#: Fibres run straight along the shaft: from section to section they turn by less than this, beside the drawing's, rad.
_STRAIGHT = 0.5
#: Millinewtons in a gram-force, and how near to that a drawing's sizes come.
_GRAM_FORCE, _NEAR = 9.80665, 0.25


def wrong_loads(tool: FlexibleTool, rows: LoadRows) -> tuple[Bools, list[str]]:
    """Rows (n,) whose force is not what their gratings say, and of each what those say of it."""
    moments = _moments(tool, rows)
    told = _told(rows, robust_gains(moments, rows))
    size = np.linalg.norm(moments, axis=2)
    # a wrong load is wrong at both sections, what is off at one alone is a small moment in noise
    off = (np.linalg.norm(told - moments, axis=2) / size).min(axis=1)
    # a wrong load changes the others' gains little, since each counts by its distance alone
    # a load cell's noise is the same in mN, what else a bench has is in proportion: it is beyond both
    off_mn = off * np.abs(rows.size_mn)
    bad = (off > max(_OFF, _TIMES * float(np.median(off)))) & (off_mn > _TIMES * float(np.median(off_mn)))
    if bad.mean() > _MOST:
        bad = np.zeros(len(off), dtype=bool)
    feels = (np.einsum("nsa,nsa->ns", told, moments) / size**2).mean(axis=1)
    larger = (np.linalg.norm(told, axis=2) / size).mean(axis=1)
    return bad, [
        f"its force of {force:.4g} mN is not the one that its gratings feel, "
        + (
            f"{times:.2g} times as large"
            if along > -0.5 * times
            else "which points the other way: its sign seems wrong"
        )
        for force, along, times in zip(rows.size_mn[bad], feels[bad], larger[bad], strict=True)
    ]


def against_drawing(tool: FlexibleTool, rows: LoadRows) -> list[str]:
    """Sentences on what the columns have wrong, by the drawing."""
    drawn, moments = np.array(tool.gains), _moments(tool, rows)
    gains = robust_gains(moments, rows)
    if told := _out_of_order(tool, moments, rows):
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
    turns = [np.linalg.det(gains[s] @ drawn[s].T) for s in range(2)]
    if min(turns) < 0.0 < max(turns):
        return [*told, _within_a_section(tool, gains, turns.index(min(turns)))]
    if _apart(gains, drawn) < _UNLIKE:
        return told
    for what, undone in _undone(gains):
        if _apart(undone, drawn) < _LIKE:
            return [*told, f"{what}: with that undone the gains are the drawing's"]
    if max(turns) < 0.0:
        told.append(
            "the gains run about the shaft the other way than the drawing's: one axis of the forces is mirrored, or "
            "two columns of fibres are exchanged in both sections"
        )
    return told


# -- Gratings in each other's columns ---------------------------------------------------------------------------------


def _orders() -> Iterator[tuple[str, Ints]]:
    """Columns as they may stand, each with where those of sections I, II, III are: the simplest first."""
    for a, b in combinations(range(9), 2):
        if a // 3 != b // 3:
            order = np.arange(9)
            order[[a, b]] = b, a
            yield f"{FIBRES[a]} and {FIBRES[b]} are exchanged", order
    nine = np.arange(9).reshape(3, 3)
    yield "the gratings stand in reverse order, from fbg9_nm to fbg1_nm", nine.ravel()[::-1]
    yield (
        "the gratings stand by fibres (sections I, II, III of the first, then of the next), not by sections",
        nine.T.ravel(),
    )
    for sections in permutations(range(3)):
        if sections != (0, 1, 2):
            named = listed(("I", "II", "III")[k] for k in np.argsort(sections))
            yield f"the gratings stand in the order of sections {named}", nine[list(sections)].ravel()


def _out_of_order(tool: FlexibleTool, moments: Floats, rows: LoadRows) -> list[str]:
    """Gratings of several sections in each other's columns: what no gains of these columns follow, and those of others
    do, whatever the drawing has; of orders that are as good the one in which fibres run as they are drawn."""
    own, told = _left(moments, rows), []
    for what, order in _orders():
        undone = replace(rows, shifts_nm=rows.shifts_nm[:, order])
        left = _left(moments, undone)
        if left < _FOLLOWS * own:
            gains = robust_gains(moments, undone)
            other = sum(np.linalg.det(g @ d.T) < 0.0 for g, d in zip(gains, np.array(tool.gains), strict=True))
            told.append((left * (1 + other), f"{what}: loads are off by {own:.2g} of their moments, with that undone "
                         f"by {left:.2g}"))  # fmt: skip
    return [min(told)[1]] if told else []


def _left(moments: Floats, rows: LoadRows) -> float:
    """By which share of their moments half of the loads are off, with what section III shows of them, which bends
    little, over what section I does."""
    off = np.linalg.norm(_told(rows, robust_gains(moments, rows)) - moments, axis=2)
    sections = rows.shifts_nm.reshape(-1, 3, 3)
    bends = np.median(np.linalg.norm(sections - sections.mean(axis=2, keepdims=True), axis=2), axis=0)
    return float(np.median(off / np.linalg.norm(moments, axis=2)) + bends[2] / max(bends[0], 1e-12))


def _within_a_section(tool: FlexibleTool, gains: Floats, s: int) -> str:
    """Of a section that runs about the shaft the other way than the drawing's, and the other does not."""
    name, other = ("I", "II")[s], ("II", "I")[s]
    told = (
        f"section {name} runs about the shaft the other way than the drawing's, and section {other} does not: two of "
        "its columns are exchanged"
    )
    turned = [np.angle(g[0] + 1j * g[1]) for g in gains]
    drawn = [np.angle(g[0] + 1j * g[1]) for g in np.array(tool.gains)]
    meant = turned[1 - s] + drawn[s] - drawn[1 - s]
    for a, b in combinations(range(3), 2):
        order = np.arange(3)
        order[[a, b]] = b, a
        if np.abs(np.angle(np.exp(1j * (turned[s][order] - meant)))).max() < _STRAIGHT:
            return f"{told}, {FIBRES[3 * s + a]} and {FIBRES[3 * s + b]} as it seems"
    return told


def _undone(gains: Floats) -> Iterator[tuple[str, Floats]]:
    """Mistakes, and the gains with each undone."""
    yield "force_x_mn and force_y_mn are exchanged", gains[:, ::-1]
    yield "force_y_mn has the other sign: its axis is mirrored", gains * np.array([[1.0], [-1.0]])
    yield "force_x_mn has the other sign: its axis is mirrored", gains * np.array([[-1.0], [1.0]])


def _apart(gains: Floats, drawn: Floats) -> float:
    """How far gains, made as large as the drawn ones, are from those, over their size."""
    gains = gains * (np.linalg.norm(drawn) / np.linalg.norm(gains))
    return max(float(np.linalg.norm(gains[s] - drawn[s]) / np.linalg.norm(drawn[s])) for s in range(2))


# -- Moments, by the drawing and by the gratings ----------------------------------------------------------------------


def _moments(tool: FlexibleTool, rows: LoadRows) -> Floats:
    """Of the drawn rod (n, 2, 2), read as the gratings follow best; by its arms alone where it cannot bear them."""
    arms = np.array(tool.distances_mm) - rows.depth_mm[:, None]
    tried = [rows.size_mn[:, None] * arms]
    for convention in CONVENTIONS:
        model = BenchModel(rows, tool, convention, tool.noise_nm)
        tried.append(model.residuals(np.append(np.zeros(8), model.drawn_rod))[1][:, :2])
    able = [one for one in tried if np.isfinite(one).all() and (one > 0.0).all()] or tried[:1]
    every = [np.asarray(one[:, :, None] * rows.way[:, None, :]) for one in able]
    return min(every, key=lambda one: _left(one, rows))


def _told(rows: LoadRows, gains: Floats) -> Floats:
    """By the gratings with these gains (n, 2, 2)."""
    return np.asarray(np.einsum("sad,nsd->nsa", gains @ DIFFERENCES.T, rows.differences_nm))


def robust_gains(moments: Floats, rows: LoadRows) -> Floats:
    """Gains (2, 2, 3) by least absolute deviations, relative to each moment (n, 2, 2): least squares, reweighted."""
    differences = rows.differences_nm
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


def drawn_gains(tool: FlexibleTool, rows: LoadRows) -> Floats:
    """The same by the drawn rod."""
    return robust_gains(_moments(tool, rows), rows)
