"""Candidates: the error that each effect would leave if it were added, with its uncertainty; and the map that it would
leave, beside the measured one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from bokeh.models import FactorRange, Range1d, Whisker

from ..base import linalg
from ..base.types import Floats
from ..diagnosis import Diagnosis, largest
from ..diagnosis.held_out import strongest
from ..evidence.base import Base
from ..evidence.family import Family
from ..evidence.fitted_run import FittedRun
from ..evidence.run import Run
from ..evidence.settings import unit_columns
from ..model.effect import Effect
from .picture import (
    ADDED,
    INK,
    LETTERS,
    MUTED,
    PLAIN,
    REFUSED,
    Picture,
    Tables,
    figure,
    float32,
    hover,
    quantity,
    rule,
    sources_of,
    ticks_between,
)
from .residual_arrows import plane_of_most, round_number

_ROW_HEIGHT, _AROUND = 30, 110


def candidates(found: Diagnosis) -> Picture[Diagnosis]:
    """A line for every effect that could be tried: error on poses held out, with two standard errors.

    Blue: named by the diagnosis. Grey: tried. Crosses: only at an implausible size. Effects that the rows cannot
    tell apart stand together behind a bracket. Dashed: the error without any of them; dotted: the noise.
    """
    sources = sources_of(_tables(found))
    made = figure(
        f"RMS error {found.error.in_words} on poses held out with it in the model, {found.unit}", x_axis_type="log",
        y_range=FactorRange(), x_range=Range1d(),
    )  # fmt: skip
    made.add_layout(
        Whisker(base="effect", lower="low", upper="high", source=sources["effects"], dimension="width",
                line_color=MUTED, upper_head=None, lower_head=None, line_width=2)
    )  # fmt: skip
    marks = made.scatter(
        "error", "effect", source=sources["effects"], size=13, marker="marker", fill_color="fill", line_color="line",
        line_width=2,
    )  # fmt: skip
    rule(made, "height", found.steps[0].error.rms, line_color=INK, line_dash="dashed")
    noise = _noise(found)
    if noise:
        rule(made, "height", noise, line_dash="dotted", line_width=2)
    made.segment("x0", "y0", "x1", "y1", source=sources["brackets"], line_color=INK, line_width=2)
    made.text("x", "y", "text", source=sources["tied"], text_baseline="middle", x_offset=6, **LETTERS)
    made.add_tools(
        hover([marks], ("effect", "@effect (@link)"), ("held out", f"@error{{0.00}} ± @std{{0.00}} {found.unit}"),
              ("p", "@p{0.0e}"), ("largest parameter", "@largest"), ("size", "@size"))
    )  # fmt: skip
    made.ygrid.grid_line_color = None

    def tune(new: Diagnosis) -> None:
        names = [c.effect for c in _order(new)]
        made.y_range.factors = names[::-1]
        made.height = _ROW_HEIGHT * len(names) + _AROUND
        made.x_range.start, made.x_range.end = reach = _reach(new)
        made.xaxis.ticker.ticks = ticks_between(*reach)

    tune(found)
    note = (
        "Error with two standard errors. Blue: named by the diagnosis; grey: tried; a cross: only at an implausible "
        f"size. Dashed: the error without any of them.{' Dotted: the noise.' if noise else ''}"
        f"{' Behind a bracket: effects that these rows cannot tell apart.' if found.indistinguishable else ''}"
    )
    return Picture.of("candidates", made, sources, _tables, tune, note=note)


def _order(found: Diagnosis) -> list[Any]:
    """Effects as reported, with those tied to one right behind it."""
    reports = {c.effect: c for c in found.candidates}
    out: list[str] = []
    for c in found.candidates:
        tied = next((t for t in found.indistinguishable if c.effect in t), (c.effect,))
        out += [name for name in tied if name in reports and name not in out]
    return [reports[name] for name in out]


def _noise(found: Diagnosis) -> float:
    return 0.0 if found.noise_origin == "unknown" else found.noise_size


def _reach(found: Diagnosis) -> tuple[float, float]:
    values = [max(c.held_out_rms, 1e-12) for c in found.candidates] + [found.steps[0].error.rms]
    # an addition that overfits a small run may hold out absurdly badly; it need not set the scale
    top = min(max(values), 5 * found.steps[0].error.rms)
    low = min([*values, *map(_lowest, found.candidates), _noise(found) or np.inf])
    return 0.85 * low, 1.1 * top * (top / low) ** 0.2


def _lowest(candidate: Any) -> float:
    """Lower end of the interval; a logarithmic axis has no place for zero."""
    return float(max(candidate.held_out_rms - 2 * candidate.held_out_std, 0.3 * candidate.held_out_rms, 1e-12))


def _tables(found: Diagnosis) -> Tables:
    order = _order(found)
    high = _reach(found)[1]
    named = set(found.effects)
    rows = []
    for c in order:
        kept = c.plausible or c.effect in named
        colour = ADDED if c.effect in named else PLAIN if c.plausible else REFUSED
        rows.append({
            "effect": c.effect, "link": c.link, "error": min(c.held_out_rms, 0.98 * high), "std": c.held_out_std,
            "low": _lowest(c), "high": min(c.held_out_rms + 2 * c.held_out_std, high), "p": c.p_value,
            "largest": largest(found, c), "size": "plausible" if c.plausible else "implausible",
            "fill": colour if kept else "white", "line": colour, "marker": "circle" if kept else "x",
        })  # fmt: skip
    return {"effects": {key: [row[key] for row in rows] for key in rows[0]}} | _brackets(found, order)


def _brackets(found: Diagnosis, order: list[Any]) -> Tables:
    """A bracket at the right edge for every group that the rows cannot tell apart."""
    low, high = _reach(found)
    stem, tick = (low * (high / low) ** part for part in (0.89, 0.875))
    lines: list[tuple[float, str, float, str]] = []
    tied: list[str] = []
    for tie in found.indistinguishable:
        here = [c.effect for c in order if c.effect in tie]
        if len(here) > 1:
            lines += [(stem, here[0], stem, here[-1]), *((tick, name, stem, name) for name in here)]
            tied.append(here[0])
    columns = zip(*lines, strict=True) if lines else ((),) * 4
    return {
        "brackets": {key: [*column] for key, column in zip(("x0", "y0", "x1", "y1"), columns, strict=True)},
        "tied": {"x": [stem] * len(tied), "y": tied, "text": ["tied"] * len(tied)},
    }


# -- What each effect looks like --------------------------------------------------------------------------------------

_TILE = 216
_PER_ROW = 4
#: Tiles that explain less of the squared error are not drawn, but for the best.
_SHOWS = 0.08
_MOST_ARROWS = 120


@dataclass(frozen=True, eq=False)
class Tile:
    """One map: ``title``, and how much of the measured map it explains (1 for the measured one itself).

    ``error`` (k, m) in the unit of the layout at the drawn poses.
    """

    title: str
    share: float
    error: Floats


@dataclass(frozen=True, eq=False)
class Atlas:
    """Tiles over one plane; ``x`` and ``y`` (k,) are places, named in ``across`` and ``up``."""

    tiles: tuple[Tile, ...]
    x: Floats
    y: Floats
    across: str
    up: str
    plane: str
    unit: str
    names: tuple[str, ...]


def atlas_of(fit: Any, effects: Sequence[Effect] = ()) -> Atlas:
    """The atlas of a fit: measured map first, then effects by how much of it they explain.

    The parameters of an effect are mixed as its best fit to the measured map has them, so that a tile shows the most
    alike that this effect can look; its size is that of the measured map. What the fitted parameters cover is taken out
    first.

    ``effects`` are the user's own, beside the catalogue. Raises :class:`~sherkit.errors.FitError` where there is too
    little to diagnose.
    """
    run = FittedRun(fit)
    every = (*run.catalogue, *effects)
    sigma = run.noise[0]
    # each row as it was read, without a filter in time
    rows = Run.plain(run, np.flatnonzero(run.whole), every, sigma)
    measured, signatures = _signatures(rows)
    view = rows.view
    names = view.place
    plane, mask = plane_of_most({n: view.variables[n] for n in names}, measured)
    poses = np.unique(view.group[mask])
    keep = np.linspace(0, len(poses) - 1, min(len(poses), _MOST_ARROWS)).round().astype(int)
    chosen = poses[np.unique(keep)]
    place = [view.variables[n] for n in names[:2]] + [np.zeros(len(view))] * 2
    group = view.group

    def at_poses(values: Floats) -> Floats:
        return np.stack([values[group == g].mean(axis=0) for g in chosen])

    turn = run.turn_of_readings
    if turn is not None:
        measured, signatures = measured @ turn, [(name, share, error @ turn) for name, share, error in signatures]
    tiles = [Tile("measured", 1.0, at_poses(measured))]
    size = float(np.sqrt(np.mean(measured**2)))
    for name, share, error in sorted(signatures, key=lambda s: -s[1]):
        own = float(np.sqrt(np.mean(error**2)))
        tiles.append(Tile(name, share, at_poses(error) * (size / own if own > 0 else 0.0)))
    return Atlas(
        tiles=tuple(tiles),
        x=at_poses(place[0]),
        y=at_poses(place[1]),
        across=names[0] if names else "pose",
        up=names[1] if len(names) > 1 else "",
        plane=plane,
        unit=run.unit,
        names=tuple(run.names[a] for a in run.axes),
    )


def _signatures(run: Run) -> tuple[Floats, list[tuple[str, float, Floats]]]:
    """Measured error (n, m) in the unit of the layout, and for every effect its name, share explained, and error."""
    base = Base.of(Family(run, shapes=False), run)
    residual, m = base.residual, run.axes
    unit, whole = run.sigma[list(run.of.axes)] * run.of.per_unit, max(base.rss, 1e-300)
    out = []
    for name, block in strongest(base).items():
        assert block.effect is not None, "shapes were not asked for"
        columns = unit_columns(run, block.effect, block.setting)
        columns = columns - base.basis @ (base.basis.T @ columns)
        scale = np.linalg.norm(columns, axis=0)
        columns = columns / np.where(scale > 0, scale, 1.0)
        shown = columns @ linalg.lstsq(columns, residual, rcond=1e-9)[0]
        out.append((name, float(shown @ residual) / whole, shown.reshape(-1, m) * unit))
    return run.view.residual * unit, out


def signature_atlas(atlas: Atlas) -> Picture[Atlas]:
    """One tile for the measured map and one for each effect, all on one scale."""
    sources = sources_of(_tiles(atlas))
    figures = []
    x_range, y_range = Range1d(*_room(atlas.x)), Range1d(*_room(atlas.y))
    for k, tile in enumerate(atlas.tiles):
        if k > 1 and tile.share < _SHOWS:
            continue
        made = figure(
            frame_width=_TILE, frame_height=_TILE, x_range=x_range, y_range=y_range, tools="pan,wheel_zoom,reset"
        )
        made.axis.visible = False
        made.segment("x", "y", "x1", "y1", source=sources[f"tile_{k}"], color=INK if k == 0 else ADDED, line_width=2)
        made.scatter("x", "y", source=sources[f"tile_{k}"], size=3, color=INK)
        made.title.text = tile.title if k == 0 else f"{tile.title}: {100 * max(tile.share, 0):.0f} %"
        made.title.text_font_style = "normal" if k else "bold"
        figures.append(made)
    key = figures[0]
    key.segment("x0", "y", "x1", "y", source=sources["scale"], color=INK, line_width=3)
    key.text(
        "x1", "y", "text", source=sources["scale"], text_align="right", text_baseline="bottom", y_offset=-3,
        **LETTERS,
    )  # fmt: skip
    note = (
        f"Errors in {' and '.join(atlas.names[:2])} over {quantity(atlas.across)} and {quantity(atlas.up)}"
        f"{' at ' + atlas.plane if atlas.plane else ''}, in black as measured, in blue as each effect would leave them "
        "after the fitted parameters had their say; the percentage says how much of the squared error it explains. "
        "Each effect is drawn as large as the measured map. Lines start at the pose, which is the dot."
    )
    return Picture.of("signature_atlas", figures, sources, _tiles, note=note, columns=_PER_ROW)


def _tiles(atlas: Atlas) -> Tables:
    measured = atlas.tiles[0].error
    length = np.hypot(measured[:, 0], measured[:, 1] if measured.shape[1] > 1 else 0.0)
    typical = float(np.quantile(length, 0.9)) or 1.0
    span = max(np.ptp(atlas.x), np.ptp(atlas.y)) or 1.0
    per_unit = 0.11 * span / typical
    out: Tables = {}
    for k, tile in enumerate(atlas.tiles):
        up = tile.error[:, 1] if tile.error.shape[1] > 1 else 0.0
        ends = {"x1": atlas.x + per_unit * tile.error[:, 0], "y1": atlas.y + per_unit * up}
        out[f"tile_{k}"] = {name: float32(v) for name, v in {"x": atlas.x, "y": atlas.y, **ends}.items()}
    (x0, x1), (y0, y1) = _room(atlas.x), _room(atlas.y)
    # at least a tenth of the tile
    bar = round_number(max(typical, 0.1 * (x1 - x0) / per_unit), up=True)
    end = x1 - 0.04 * (x1 - x0)
    out["scale"] = {
        "x0": [end - bar * per_unit], "x1": [end], "y": [y0 + 0.04 * (y1 - y0)], "text": [f"{bar:g} {atlas.unit}"],
    }  # fmt: skip
    return out


def _room(places: Floats) -> tuple[float, float]:
    """Range of a tile, with room for arrows on all sides and for the scale below."""
    room = 0.16 * float(np.ptp(places)) or 1.0
    return float(places.min()) - 1.6 * room, float(places.max()) + room
