"""The arrows of a residual map: where in the workspace the model is wrong, and in which direction.

An arrow per pose (the mean of its repeats) along the error in the first two readings, the third as colour; a panel per
plane. Before and after share one scale unless each is to have its own. The circle shows how far noise alone would carry
95 of 100 arrows. What is drawn is computed here once, for both ways of drawing it.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..base.types import Bools, Floats
from .picture import Table, Tables, float32, number, padded, quantity
from .residuals import Residuals, in_noise, in_place

#: One scale for before and after; each its own, so that what is left is seen too; its own, counted in the noise of each
#: reading (where that is not known, as ``own``).
SCALES = ("shared", "own", "noise")
#: More arrows than this in one panel become the means of cells.
_MOST_ARROWS = 300
_CELLS = 15
_MOST_PLANES = 6
_SLABS = 3
_FLAT = 0.3
#: Radius, in standard deviations, within which 95 of 100 two-dimensional Gaussian errors lie.
_CIRCLE = 2.4477
#: The same for one reading.
_INTERVAL = 1.96
MOMENTS = ("before", "after")
#: Heights of the strips for a title of two lines, for each more, and for the keys, distance from the edge, width of a
#: bold letter, and the shortest scale bar, px.
_TITLE, _LINE, _KEYS, _EDGE, _LETTER, _SHORTEST_BAR = 54, 20, 40, 9, 10, 28
#: Lines of what a state is called, and letters of an error with its unit.
_MOST_LINES, _FIGURE = 2, 7
#: Height of a panel by its width, at the least and at the most.
_FLATTEST, _TALLEST = 0.35, 1.2


@dataclass(frozen=True, eq=False)
class Change:
    """Two moments of a study: what the model left before, and what it leaves now."""

    before: Residuals
    after: Residuals
    before_title: str = "before"
    after_title: str = "after"
    #: How arrows and colours are scaled, one of :data:`SCALES`.
    scale: str = "shared"


@dataclass(frozen=True, eq=False)
class Panels:
    """How the workspace is cut: which rows stand in which panel."""

    across: str
    up: str | None
    names: tuple[str, ...]
    rows: tuple[Bools, ...]
    x: Floats
    y: Floats


class Sheet:
    """What is drawn of a change in panels of ``width`` px: on which scale (length of an arrow per unit of error, colour
    and bar of each moment), and the tables. Another change is drawn in the ``panels`` of the first one."""

    def __init__(self, change: Change, width: int, panels: Panels | None = None) -> None:
        left = change.before
        self.change, self.width, self.panels = change, width, panels or cut(left)
        panels = self.panels
        each = {m: [_arrows(side, panels, rows) for rows in panels.rows]
                for m, side in zip(MOMENTS, shown(change), strict=True)}  # fmt: skip
        arrows = [a for m in MOMENTS for a in each[m]]
        self.coloured = len(left.names) != 2
        number = max(max((len(a["x"]) for a in arrows), default=1), 1)
        span_x, span_y = np.ptp(panels.x) or 1.0, np.ptp(panels.y) or np.ptp(panels.x) or 1.0
        spacing = np.sqrt(span_x * span_y / number)
        self.per_unit: dict[str, float] = {}
        self.colours: dict[str, float] = {}
        typical: dict[str, float] = {}
        for moment in MOMENTS:
            counted = arrows if change.scale == "shared" else each[moment]
            ex, ey, ez = (np.concatenate([np.zeros(0), *(a[k] for a in counted)]) for k in ("ex", "ey", "ez"))
            length, colour = np.hypot(ex, ey), np.abs(ez)
            typical[moment] = float(np.quantile(length, 0.95)) if len(length) else 0.0
            self.per_unit[moment] = 1.3 * spacing / typical[moment] if typical[moment] > 0 else 1.0
            high = float(np.quantile(colour, 0.98)) if len(colour) else 1.0
            self.colours[moment] = round_number(high, up=True) or 1.0
        noise = shown(change)[0].noise[: min(2, len(left.names))]
        self.noise = float(np.sqrt(np.mean(noise**2))) if left.noise_origin != "unknown" else 0.0
        self.circles = {m: [self._circle(left, rows) * self.per_unit[m] for rows in panels.rows] for m in MOMENTS}
        largest = max((c for circles in self.circles.values() for c in circles), default=0.0)
        scaled = [(a, self.per_unit[m]) for m in MOMENTS for a in each[m]]
        self.letters = int((width - 2 * _EDGE) / _LETTER)
        called = [textwrap.wrap(one, self.letters) for one in (change.before_title, change.after_title)]
        #: Lines of what a state is called, and what stands between a plane and its error: all panels have equal ones.
        self.lines = min(max(map(len, called)), _MOST_LINES)
        self.between = ": " if max(map(len, panels.names)) + 2 + _FIGURE <= self.letters else "\n"
        above = _TITLE + _LINE * (self.lines - 1 + (self.between == "\n"))
        #: First and last value of the axes across and up.
        self.ranges = _ranges(panels, scaled, largest, width, above)
        x, y = self.ranges
        #: Of the workspace, in a pixel: titles and keys keep their size.
        self.pixel = (x[1] - x[0]) / width
        self.height_px = round((y[1] - y[0]) / self.pixel)
        # as long as the longest arrows, and long enough to be compared with
        self.bars = {
            m: round_number(max(typical[m], _SHORTEST_BAR * self.pixel / self.per_unit[m]), up=True) for m in MOMENTS
        }

    def _circle(self, left: Residuals, mask: Bools) -> float:
        """Radius that holds 95 of 100 means of repeats that are noise alone."""
        use = _used(left, mask)
        repeats = max(int(use.sum()) / max(len(np.unique(left.group[use])), 1), 1.0)
        return float((_CIRCLE if len(left.names) > 1 else _INTERVAL) * self.noise / np.sqrt(repeats))

    def tables(self, change: Change) -> Tables:
        """Arrows of each moment and panel, and beside them a table with a single row: title, bar and circle. Those of
        ``change``, which may be another one than that of the scale."""
        out: Tables = {}
        panels = self.panels
        titles = (change.before_title, change.after_title)
        moments = zip(MOMENTS, (change.before, change.after), shown(change), titles, strict=True)
        for moment, plain, left, title in moments:
            per_unit = self.per_unit[moment]
            for k, mask in enumerate(panels.rows):
                a = _arrows(left, panels, mask)
                # numbers on hover stay in the unit of the run
                hovered = a if left is plain else _arrows(plain, panels, mask)
                drawn = {
                    "x": a["x"], "y": a["y"], "x1": a["x"] + per_unit * a["ex"], "y1": a["y"] + per_unit * a["ey"],
                    **{name: hovered[name] for name in ("ex", "ey", "ez")}, "colour": a["ez"] * self.coloured,
                }  # fmt: skip
                table = {name: float32(column) for name, column in drawn.items()}
                out[f"{moment}_{k}"] = table | {name: a[name] for name in ("n", "lines", "rows")}
                use = mask & ~left.outlier
                rms = float(np.sqrt(np.nansum(np.nanmean(left.values[use] ** 2, axis=0)))) if use.any() else 0.0
                out[f"{moment}_{k}_key"] = self._key(moment, left, title, k, rms)
        return out

    def _key(self, moment: str, left: Residuals, title: str, panel: int, rms: float) -> Table:
        """Title, scale bar and noise circle of one panel."""
        (x0, x1), (y0, y1) = self.ranges
        plane = self.panels.names[panel]
        edge = _EDGE * self.pixel
        figure_of = f"{plane + self.between if plane else ''}{number(rms)} {left.unit}"
        if len(figure_of.rpartition("\n")[2]) + 4 <= self.letters:
            figure_of += " RMS"
        called = textwrap.wrap(title, self.letters, max_lines=self.lines, placeholder="…")
        heading = "\n".join([*called, figure_of])
        bar = self.bars[moment] * self.per_unit[moment]
        circle = self.circles[moment][panel]
        return {
            "title": [heading], "title_x": [x0 + edge], "title_y": [y1 - edge],
            "bar_x0": [x1 - edge - bar], "bar_x1": [x1 - edge], "bar_y": [y0 + edge],
            "bar_text": [f"{self.bars[moment]:g} {left.unit}"], "bar_text_x": [x1 - edge],
            "bar_text_y": [y0 + 1.6 * edge],
            "noise_x": [x0 + edge + circle], "noise_y": [y0 + max(circle + edge, 1.8 * edge)], "noise_r": [circle],
            "noise_text": ["noise" if self.noise else ""], "noise_text_x": [x0 + 1.8 * edge + 2 * circle],
        }  # fmt: skip


def round_number(value: float, *, up: bool = False) -> float:
    """The nearest of 1, 2, 5, 10 … below ``value`` (above it where ``up``)."""
    if not value > 0:
        return 0.0
    steps = 10.0 ** np.floor(np.log10(value)) * np.array([1.0, 2.0, 5.0, 10.0])
    return float(steps[steps >= value * (1 - 1e-9)][0] if up else steps[steps <= value * (1 + 1e-9)][-1])


_SAID = {
    "shared": "All panels have one scale.",
    "own": "Before and after each have a scale of their own.",
    "noise": "Counted in the noise of each reading, σ; before and after each have a scale of their own.",
}


def note(change: Change) -> str:
    """How to read it."""
    left, names = change.before, change.before.names
    shows = "arrow shows" if len(names) > 1 else "arrow and its colour show"
    said = f"An {shows} the error in {' and '.join(names[:2])} at a pose, mean of its repeats"
    if len(names) > 2:
        said += f", its colour the error in {names[2]}"
    if any(_dense(left.group[_used(left, m)]) for m in cut(left).rows):
        said += "; where poses are dense it is the mean of a cell"
    said += f". {_SAID[change.scale]}"
    if left.noise_origin != "unknown":
        said += " Noise alone would leave 95 of 100 arrows inside the circle."
    if len(names) > 1:
        said += (
            " The number over a panel is the RMS error of its single readings, of all axes together, by a fit that has "
            "seen them."
        )
    return said


def cut(left: Residuals) -> Panels:
    """Panels by the third coordinate, the highest first, as they lie in the workspace."""
    names = list(left.place)
    n = len(left)
    across, up = (names[0] if names else "pose"), (names[1] if len(names) > 1 else None)
    x = left.place[across] if names else np.zeros(n)
    y = left.place[up] if up else np.zeros(n)
    planes = planes_of(left.place, n)
    return Panels(across, up, tuple(name for name, _ in planes), tuple(rows for _, rows in planes), x, y)


def planes_of(place: Mapping[str, Floats], n: int) -> list[tuple[str, Bools]]:
    """Name and rows (``n``,) of each plane of the third coordinate; slabs of equal numbers where planes are many.

    Planes are thinner than what lies between them. One without a name where there is no third coordinate.
    """
    names = list(place)
    if len(names) < 3:
        return [("", np.ones(n, dtype=bool))]
    third = place[names[2]]
    order = np.sort(third)
    # a plane is never quite flat: the robot is not where it was sent
    span = max(float(np.ptp(third)), _FLAT * max(float(np.ptp(place[name])) for name in names[:2])) or 1.0
    gaps = np.flatnonzero(np.diff(order) > 0.05 * span)
    clusters = np.split(order, gaps + 1)
    thickest = min(_FLAT * span, np.diff(order)[gaps].min(initial=np.inf))
    if len(clusters) <= _MOST_PLANES and max(float(np.ptp(c)) for c in clusters) <= thickest:
        edges = [-np.inf, *(0.5 * (order[gaps] + order[gaps + 1])), np.inf]
    else:
        edges = [-np.inf, *np.quantile(third, np.arange(1, _SLABS) / _SLABS), np.inf]
    label, unit = quantity(names[2]).partition(", ")[::2]
    fine = max(0, 1 - int(np.floor(np.log10(span))))
    out = []
    for low, high in pairwise(edges):
        mask = (third > low) & (third <= high)
        if not mask.any():
            continue
        a, b, mean = third[mask].min(), third[mask].max(), round(float(third[mask].mean()), fine) + 0.0
        at = f"{a:.{fine}f} to {b:.{fine}f}" if b - a > 0.15 * span else f"{mean:.{fine}f}"
        out.append((f"{label} = {at} {unit}", mask))
    return out[::-1]


def plane_of_most(place: Mapping[str, Floats], error: Floats) -> tuple[str, Bools]:
    """The plane in which the error (n, m) is largest in mean square."""
    return max(planes_of(place, len(error)), key=lambda plane: float(np.nanmean(error[plane[1]] ** 2)))


def _arrows(left: Residuals, panels: Panels, mask: Bools) -> Table:
    """Mean error of every pose in a panel, or of every cell where poses are many."""
    rows = np.flatnonzero(_used(left, mask))
    if not len(rows):
        return {k: np.zeros(0) for k in ("x", "y", "ex", "ey", "ez", "n")} | {"rows": [], "lines": []}
    group = np.unique(left.group[rows], return_inverse=True)[1]
    if _dense(group):
        group = _cells(panels.x[rows], panels.y[rows])
    count = np.bincount(group)

    def mean(values: Floats) -> Floats:
        return np.asarray(np.bincount(group, values) / count)

    error = left.values[rows]
    # a single reading stands upright, and its colour says the same
    if error.shape[1] == 1:
        error = error * [0.0, 1.0, 1.0]
    columns = dict(zip(("x", "y", "ex", "ey", "ez"), (panels.x[rows], panels.y[rows], *error.T), strict=False))
    table: Table = {"ez": np.zeros(len(count)), "n": count} | {name: mean(v) for name, v in columns.items()}
    members = np.split(rows[np.argsort(group, kind="stable")], np.cumsum(count)[:-1])
    table["rows"] = [left.row[m].tolist() for m in members]
    table["lines"] = [_lines(left.line[m]) for m in members]
    return table


def _used(left: Residuals, mask: Bools) -> Bools:
    """Rows of a panel that are drawn."""
    return mask & ~left.outlier & np.isfinite(left.values).all(axis=1)


def _dense(group: NDArray[np.int64]) -> bool:
    """Whether poses are so many that arrows would hide one another."""
    return len(np.unique(group)) > _MOST_ARROWS


def _cells(x: Floats, y: Floats) -> NDArray[np.int64]:
    def ticks(v: Floats) -> NDArray[np.int64]:
        return np.minimum((v - v.min()) / (np.ptp(v) or 1.0) * _CELLS, _CELLS - 1).astype(np.int64)

    inverse: NDArray[np.int64] = np.unique(ticks(x) * _CELLS + ticks(y), return_inverse=True)[1]
    return inverse


def _lines(lines: NDArray[np.int64], most: int = 6) -> str:
    text = ", ".join(str(k) for k in lines[:most])
    return text if len(lines) <= most else f"{text} … ({len(lines)} rows)"


def shown(change: Change) -> tuple[Residuals, Residuals]:
    """Both moments in the unit and along the axes in which they are drawn."""
    before, after = in_place(change.before), in_place(change.after)
    counted = change.scale == "noise" and before.noise_origin != "unknown"
    return (in_noise(before), in_noise(after)) if counted else (before, after)


def _ranges(
    panels: Panels, arrows: Sequence[tuple[Table, float]], circle: float, width: int, title_px: int
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Room for poses and heads of arrows, and for title and keys above and below.

    A millimetre is as long upwards as across.
    """
    heads = [
        np.concatenate([a[at] + per_unit * a[by] for a, per_unit in arrows]) for at, by in (("x", "ex"), ("y", "ey"))
    ]
    x, y = (
        padded(min(v.min(), h.min(initial=v.min())), max(v.max(), h.max(initial=v.max())), 0.04)
        for v, h in zip((panels.x, panels.y), heads, strict=True)
    )
    x0, x1, y0, y1 = (float(v) for v in (x.start, x.end, y.start, y.end))
    wide = x1 - x0
    if panels.up is None:
        y0, y1 = min(y0, -0.05 * wide), max(y1, 0.05 * wide)
    # the strips for text have their size in pixels, whatever a pixel comes to be
    for _ in range(30):
        pixel = wide / width
        above, below = title_px * pixel, max(_KEYS * pixel, 2 * circle + 2 * _EDGE * pixel)
        wide = max(wide, (y1 - y0 + above + below) / _TALLEST)
    more = max(_FLATTEST * wide - (y1 - y0 + above + below), 0.0) / 2
    middle = 0.5 * (x0 + x1)
    return (middle - 0.5 * wide, middle + 0.5 * wide), (y0 - below - more, y1 + above + more)
