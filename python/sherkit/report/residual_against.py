"""What is left of single readings: against anything, in the order of the run, and against the noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from bokeh.models import ColumnDataSource
from numpy.typing import NDArray

from ..base.types import Floats, Ints
from .picture import (
    COLOURS,
    FONT_SIZE,
    INK,
    MARKERS,
    MUTED,
    PLAIN,
    Picture,
    Table,
    Tables,
    figure,
    float32,
    hover,
    legend,
    quantity,
    rows_to_draw,
    rule,
    shortened,
    sources_of,
)
from .residuals import Residuals, at_the_rim

MOST_POINTS = 3000
#: Places of the running mean, and the part of the poses that each of them averages.
_PLACES, _WINDOW = 40, 1 / 12
_FEW_VALUES = 12
#: Fewer points than this are drawn larger.
_FEW_ROWS = 300
_PANEL_HEIGHT = 200


@dataclass(frozen=True, eq=False)
class ResidualAgainst:
    """What is left now, what was left before the effects in question were added, and the variable to draw against."""

    now: Residuals
    variable: str
    before: Residuals | None = None


def residual_against(state: ResidualAgainst) -> Picture[ResidualAgainst]:
    """A panel per reading with one shared axis: the error against ``state.variable``.

    The band is two standard errors of the running mean, counted by poses. The line through it is what the model has
    gained since ``state.before``: where it lies on the points of that moment, the effect explains them.
    """
    first = tables(state)
    sources = sources_of(first)
    figures: list[Any] = []
    edges = []
    for k, name in enumerate(state.now.names):
        figures.append(_panel(sources, k, name, state, figures[0].x_range if figures else None))
        band = sources["noise"].data[f"n{k}"]
        edges.append([rule(figures[-1], "width", edge, line_dash="dotted") for edge in band])

    def tune(new: ResidualAgainst) -> None:
        figures[-1].xaxis.axis_label = quantity(new.variable)
        for lines, at in zip(edges, noise_band(new.now).values(), strict=True):
            for line, edge in zip(lines, at, strict=False):
                line.location = float(edge)

    return Picture.of("against", figures, sources, tables, tune, note=note(state.now))


def note(left: Residuals) -> str:
    """How to read it, and what is not drawn."""
    n = len(left)
    few = (
        f" {MOST_POINTS} of {n} are drawn, chosen at random, marked outliers first; means and bands count all of them."
        if n > MOST_POINTS
        else ""
    )
    noise = " Dotted: the noise, ±2 σ." if left.noise_origin != "unknown" else ""
    return (
        "Points are single readings, the line their running mean, the band two standard errors of it (counted by "
        f"poses).{few}{noise} Where effects were added, grey points are the error before them and "
        "the dashed line through these is what the effects explain."
    )


def tables(state: ResidualAgainst) -> Tables:
    """Points, running mean, noise and legend text for a variable."""
    left = state.now
    windows, rows = Windows.of(left, state.variable), shown(left)
    out = {"points": points(left), "mean": means(left, windows), "noise": noise_band(left)}
    at = out["points"]["v"] = float32(left.variables[state.variable][rows])
    before = state.before
    # where nothing was added there is nothing to see of it
    if before is None or before is left or len(before) != len(left):
        before, rows, at = left, rows[:0], at[:0]
    out["gained"] = gained(before, left, windows)
    values = at_the_rim(left, before.values)[0]
    out["earlier"] = {"v": at} | {f"r{k}": float32(values[rows, k]) for k in range(len(left.names))}
    return out


def shown(left: Residuals) -> NDArray[np.int64]:
    """Rows whose points are drawn, the same for every state of a run."""
    return np.asarray(rows_to_draw(len(left), MOST_POINTS, np.flatnonzero(left.outlier)))


def points(left: Residuals) -> Table:
    """Error of the drawn rows by reading, without the variable."""
    rows = shown(left)
    values, beyond = at_the_rim(left, left.values)
    out: Table = {f"r{k}": float32(values[rows, k]) for k in range(len(left.names))}
    out["beyond"] = [beyond[row] for row in rows]
    out["line"], out["row"] = left.line[rows].astype(np.int32), left.row[rows].astype(np.int32)
    few = len(rows) < _FEW_ROWS
    out["alpha"] = float32(np.where(left.outlier[rows], 0.9, 0.8 if few else 0.35))
    out["size"] = float32(np.where(left.outlier[rows], 11, 7 if few else 4))
    return out


def means(left: Residuals, windows: Windows) -> Table:
    """Running mean with its band of two standard errors."""
    out: Table = {"v": float32(windows.at)}
    for k in range(len(left.names)):
        mean, error = windows.mean(left.values[:, k])
        out |= {f"m{k}": float32(mean), f"low{k}": float32(mean - 2 * error), f"high{k}": float32(mean + 2 * error)}
    return out


def gained(before: Residuals, now: Residuals, windows: Windows) -> Table:
    """Running mean of what the model explains now and did not explain before; empty where nothing was added."""
    names = [f"g{k}" for k in range(len(now.names))]
    if before is now or len(before) != len(now):
        return {"v": float32([])} | {name: float32([]) for name in names}
    change = before.values - now.values
    return {"v": float32(windows.at)} | {name: float32(windows.mean(change[:, k])[0]) for k, name in enumerate(names)}


def noise_band(left: Residuals) -> Table:
    """±2 σ of a single reading; nothing where the noise is not known."""
    known = left.noise_origin != "unknown"
    edges = [np.array([2.0, -2.0]) * s if known else np.zeros(0) for s in left.noise]
    return {f"n{k}": edge for k, edge in enumerate(edges)}


def _places(v: Floats) -> tuple[Floats, Floats]:
    """Where to average, and how far around."""
    values = np.unique(v)
    if len(values) <= min(_FEW_VALUES, len(v) // 4):
        return values, np.zeros(len(values))
    at = np.quantile(v, np.linspace(0, 1, _PLACES))
    order = np.sort(v)
    rank = np.linspace(0, 1, _PLACES) * (len(v) - 1)
    wide = max(_WINDOW * len(v) / 2, 4)
    low = order[np.clip(rank - wide, 0, len(v) - 1).astype(int)]
    high = order[np.clip(rank + wide, 0, len(v) - 1).astype(int)]
    unique, index = np.unique(at, return_index=True)
    return unique, np.maximum(0.5 * (high - low), 1e-12)[index]


@dataclass(frozen=True, eq=False)
class Windows:
    """Rows around each of several places of a variable, ready to average whatever was read on them.

    ``at`` (p,) are the places. ``row`` (k,) are the rows in all windows together, ``place`` (k,) the window of each,
    and ``pose`` (k,) a number for each pose in each window; ``place_of_pose`` is the window of such a number.
    """

    at: Floats
    row: Ints
    place: Ints
    pose: Ints
    place_of_pose: Ints

    @classmethod
    def of(cls, left: Residuals, variable: str) -> Windows:
        """The windows along a variable; rows marked as outliers are in none."""
        used = np.flatnonzero(~left.outlier)
        v = left.variables[variable][used]
        at, half = _places(v)
        order = np.argsort(v, kind="stable")
        first = np.searchsorted(v[order], at - half - 1e-12)
        count = np.searchsorted(v[order], at + half + 1e-12, side="right") - first
        place = np.repeat(np.arange(len(at)), count)
        row = used[order][np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + first[place]]
        poses = int(left.group.max(initial=0)) + 1
        number, pose = np.unique(place * poses + left.group[row], return_inverse=True)
        return cls(at, row, place, pose, number // poses)

    def mean(self, values: Floats) -> tuple[Floats, Floats]:
        """Mean and its standard error at each place; poses, not readings, are what is independent."""
        r, taken = values[self.row], np.isfinite(values[self.row])
        size = len(self.at)
        count = np.bincount(self.place[taken], minlength=size)
        total = np.bincount(self.place[taken], r[taken], minlength=size)
        mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
        many = len(self.place_of_pose)
        by_pose = np.bincount(self.pose[taken], (r - mean[self.place])[taken], minlength=many)
        poses = np.bincount(self.place_of_pose[np.bincount(self.pose[taken], minlength=many) > 0], minlength=size)
        spread = np.sqrt(np.bincount(self.place_of_pose, by_pose**2, minlength=size))
        return mean, np.where(poses > 1, spread / np.maximum(count, 1), 0.0)


def _panel(sources: dict[str, ColumnDataSource], k: int, name: str, state: ResidualAgainst, x_range: Any) -> Any:
    unit, last = state.now.unit, k == len(state.now.names) - 1
    settings = {} if x_range is None else {"x_range": x_range}
    made = figure(
        quantity(state.variable) if last else None, f"{name}, {unit}", height=_PANEL_HEIGHT + (45 if last else 0),
        tools="pan,box_zoom,wheel_zoom,box_select,lasso_select,tap,reset", **settings,
    )  # fmt: skip
    if last:
        made.xaxis[0].name = "against_axis"
    made.xaxis.major_label_text_font_size = FONT_SIZE if last else "0px"
    rule(made, "width", 0)
    colour = COLOURS[k % len(COLOURS)]
    few = len(state.now) < _FEW_ROWS
    made.scatter(
        "v", f"r{k}", source=sources["earlier"], size=6 if few else 3, color=PLAIN, alpha=0.6 if few else 0.25,
        line_color=None,
    )  # fmt: skip
    dots = made.scatter(
        "v", f"r{k}", source=sources["points"], marker=MARKERS[k % len(MARKERS)], size="size", color=colour,
        alpha="alpha", line_color=None, nonselection_alpha=0.08,
    )  # fmt: skip
    made.varea("v", f"low{k}", f"high{k}", source=sources["mean"], fill_color=INK, fill_alpha=0.18)
    made.line("v", f"m{k}", source=sources["mean"], color=INK, line_width=2.5)
    made.line("v", f"g{k}", source=sources["gained"], color=COLOURS[3], line_width=3, line_dash="dashed")
    made.add_tools(
        hover([dots], ("at", "@v{0.000}"), (name, f"@r{k}{{0.0}} {unit}@beyond"), (state.now.counted, "@line"))
    )
    return made


# -- The run in time --------------------------------------------------------------------------------------------------

_TIME_HEIGHT, _BELOW = 320, 150
_MOST_IN_TIME = 4000
#: That stand beside a low figure.
_LETTERS = 15


def run_in_time(left: Residuals) -> Picture[Residuals]:
    """All readings in the order they were taken; outliers larger. Covariates that vary stand below on the same axis."""
    sources = sources_of(_in_time(left))
    made = figure(up=f"residual, {left.unit}", height=_TIME_HEIGHT, tools="pan,box_zoom,wheel_zoom,box_select,reset")
    rule(made, "width", 0)
    for k, name in enumerate(left.names):
        dots = made.scatter(
            "t", f"r{k}", source=sources["run"], color=COLOURS[k % len(COLOURS)], marker=MARKERS[k % len(MARKERS)],
            size="size", alpha=0.8 if len(left) < _FEW_ROWS else 0.45, legend_label=name,
        )  # fmt: skip
        made.add_tools(
            hover([dots], ("", name), ("residual", f"@r{k}{{0.0}} {left.unit}@beyond"), (left.counted, "@line"))
        )
    legend(made)
    figures = [made]
    for name in _below(left):
        lower = figure(up=shortened(quantity(name), _LETTERS), height=_BELOW, x_range=made.x_range)
        lower.yaxis.ticker.desired_num_ticks = 3
        lower.scatter("t", name, source=sources["run"], size=4, color=MUTED)
        figures.append(lower)
    figures[-1].xaxis.axis_label = "time, s" if "time_s" in left.variables else "reading"
    few = f"{_MOST_IN_TIME} of {len(left)} rows, chosen at random, marked outliers first"
    drawn = few if len(left) > _MOST_IN_TIME else f"all {len(left)} rows"
    note = f"What the model leaves, in the order of the run: {drawn}. Rows that are left out stand at the rim."
    return Picture.of("run", figures, sources, _in_time, note=note)


def _below(left: Residuals) -> list[str]:
    """Covariates, not coordinates, joints, directions or time; at most two."""
    known, joints = {*left.place, "time_s"}, ("direction_", "q1", "q2", "q3", "theta")
    return [name for name in left.variables if name not in known and not name.startswith(joints)][:2]


def _in_time(left: Residuals) -> Tables:
    rows = np.asarray(rows_to_draw(len(left), _MOST_IN_TIME, np.flatnonzero(left.outlier)))
    time = left.variables.get("time_s", left.row.astype(float))
    table: dict[str, Any] = {"t": time[rows], "line": left.line[rows].astype(np.int32)}
    table["size"] = np.where(left.outlier[rows], 11, 7 if len(left) < _FEW_ROWS else 4)
    values, beyond = at_the_rim(left, left.values)
    table |= {f"r{k}": float32(values[rows, k]) for k in range(len(left.names))}
    table["beyond"] = [beyond[row] for row in rows]
    table |= {name: left.variables[name][rows] for name in _below(left)}
    return {"run": table}


# -- What is left against the noise -----------------------------------------------------------------------------------

_BINS, _CURVE, _QUANTILES = (11, 41), 121, 200
_NOISE_HEIGHT = 360


def noise_picture(left: Residuals) -> Picture[Residuals]:
    """Left a histogram of what remains over its noise, right its quantiles against those of the noise.

    On the dashed line the remains are noise; a steeper line means that they are larger, bent ends that single readings
    are wilder. Where the noise is unknown it is that of the remains themselves, which the axis says.
    """
    sources = sources_of(_distribution(left))
    known = left.noise_origin != "unknown"
    unit = "σ of the noise" if known else "σ of the rest itself"
    curve = "noise" if known else "Gaussian"
    histogram = figure(f"residual, {unit}", "density, per σ", height=_NOISE_HEIGHT)
    plot = figure("quantile of a Gaussian, σ", "quantile of the residuals, σ", height=_NOISE_HEIGHT)
    histogram.line("x", "y", source=sources["normal"], color=INK, line_dash="dashed", line_width=2, legend_label=curve)
    plot.line("x", "x", source=sources["normal"], color=INK, line_dash="dashed", line_width=2)
    for k, name in enumerate(left.names):
        colour = COLOURS[k % len(COLOURS)]
        histogram.step(
            "at", f"density_{k}", source=sources["bins"], color=colour, line_width=2.5, mode="center", legend_label=name
        )
        dots = plot.scatter(
            "gauss", f"q_{k}", source=sources["quantiles"], color=colour, marker=MARKERS[k % len(MARKERS)], size=7,
            alpha=0.8,
        )  # fmt: skip
        plot.add_tools(hover([dots], ("", name), ("Gaussian", "@gauss{0.00} σ"), ("residual", f"@q_{k}{{0.00}} σ")))
    legend(histogram)
    note = (
        "On the dashed line what remains is noise. Steeper: there is more than noise."
        if known
        else "The noise is not known: what remains is drawn over its own spread, and only its shape says something."
    ) + " Bent ends: some readings are wild. The histogram's first and last bars hold whatever lies beyond them."
    return Picture.of("noise", [histogram, plot], sources, _distribution, note=note, columns=2)


def _distribution(left: Residuals) -> Tables:
    # few readings in many bars are a comb
    readings = int(np.isfinite(left.values[~left.outlier]).sum()) / max(len(left.names), 1)
    edges = np.linspace(-5, 5, int(np.clip(np.sqrt(readings), *_BINS)) // 2 * 2 + 2)
    bins = {"at": 0.5 * (edges[1:] + edges[:-1])}
    count = min(int(np.isfinite(left.values).all(axis=1).sum()), _QUANTILES)
    level = (np.arange(count) + 0.5) / max(count, 1)
    quantiles = {"gauss": scipy.special.ndtri(level)}
    for k in range(len(left.names)):
        u = _over_noise(left, k)
        # what lies beyond the picture is counted in its last bins: nothing is left out
        number = np.histogram(np.clip(u, edges[0], edges[-1]), edges)[0]
        bins[f"density_{k}"] = number / max(len(u), 1) / (edges[1] - edges[0])
        quantiles[f"q_{k}"] = np.quantile(u, level) if len(u) else np.zeros(count)
    x = np.linspace(-5, 5, _CURVE)
    return {"bins": bins, "quantiles": quantiles, "normal": {"x": x, "y": np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi)}}


def _over_noise(left: Residuals, k: int) -> Floats:
    values = left.values[~left.outlier, k]
    values = values[np.isfinite(values)]
    sigma = left.noise[k] if left.noise_origin != "unknown" else values.std()
    return np.asarray(values / sigma if sigma > 0 else values * 0.0)
