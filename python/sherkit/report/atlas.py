"""Signature atlas: the measured map, and beside it the map that each effect would leave on the same poses.

The parameters of an effect are mixed as its best fit to the measured map has them, so that a tile shows the most alike
that this effect can look; its size is that of the measured map. What the fitted parameters cover is taken out first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from bokeh.core.properties import value
from bokeh.models import Range1d

from ..base import linalg
from ..base.types import Floats
from ..diagnosis.fitted_run import FittedRun
from ..diagnosis.linearised import orthonormal
from ..diagnosis.stage import Stage, stage_of
from ..model.effect import Effect
from .picture import Picture, Tables, sources_of, stacked
from .residual_map import plane_of_most, round_number
from .style import ADDED, FONT, FONT_SIZE, INK, figure, quantity

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

    ``effects`` are the user's own, beside the catalogue. Raises :class:`~sherkit.errors.FitError` where there is too
    little to diagnose.
    """
    run = FittedRun(fit)
    every = (*run.catalogue, *effects)
    stage = stage_of(run, every, np.flatnonzero(run.whole), run.noise[0], rho=0.0, thorough=False)
    measured, signatures = _signatures(stage)
    view = stage.view
    names = view.place
    plane, mask = plane_of_most({n: view.variables[n] for n in names}, measured)
    poses = np.unique(view.group[mask])
    keep = np.linspace(0, len(poses) - 1, min(len(poses), _MOST_ARROWS)).round().astype(int)
    chosen = poses[np.unique(keep)]
    place = [view.variables[n] for n in names[:2]] + [np.zeros(len(view))] * 2
    group = view.group

    def at_poses(values: Floats) -> Floats:
        return np.stack([values[group == g].mean(axis=0) for g in chosen])

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


def _signatures(stage: Stage) -> tuple[Floats, list[tuple[str, float, Floats]]]:
    """Measured error (n, m) in the unit of the layout, and for every effect its name, share explained, and error."""
    view = stage.view
    n, m = view.residual.shape
    unit = stage.sigma * stage.run.per_unit
    basis = orthonormal(view.fitted(view.whole))
    residual = view.residual.ravel()
    residual = residual - basis @ (basis.T @ residual)
    whole = float(residual @ residual)
    best: dict[str, tuple[float, Floats]] = {}
    for candidate in stage.candidates:
        columns = stage.raw(candidate.columns, view.whole).reshape(n * m, -1)
        columns = columns - basis @ (basis.T @ columns)
        scale = np.linalg.norm(columns, axis=0)
        x = linalg.lstsq(columns / np.where(scale > 0, scale, 1.0), residual, rcond=1e-9)[0]
        shown = (columns / np.where(scale > 0, scale, 1.0)) @ x
        share = float(shown @ residual) / whole if whole > 0 else 0.0
        if candidate.name not in best or share > best[candidate.name][0]:
            best[candidate.name] = (share, shown.reshape(n, m) * unit)
    return view.residual * unit, [(name, share, error) for name, (share, error) in best.items()]


def signature_atlas(atlas: Atlas) -> Picture[Atlas]:
    """One tile for the measured map and one for each effect, all on one scale."""
    sources = sources_of(_tables(atlas))
    figures = []
    x_range, y_range = Range1d(*_reach(atlas.x)), Range1d(*_reach(atlas.y))
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
        text_font_size=FONT_SIZE, text_font=value(FONT), text_color=INK,
    )  # fmt: skip
    note = (
        f"Errors in {' and '.join(atlas.names[:2])} over {quantity(atlas.across)} and {quantity(atlas.up)}"
        f"{' at ' + atlas.plane if atlas.plane else ''}, in black as measured, in blue as each effect would leave them "
        "after the fitted parameters had their say; the percentage says how much of the squared error it explains. "
        "Each effect is drawn as large as the measured map. Lines start at the pose, which is the dot."
    )
    return Picture(
        "signature_atlas", stacked("signature_atlas", figures, columns=_PER_ROW), sources, _tables, note=note
    )


def _tables(atlas: Atlas) -> Tables:
    measured = atlas.tiles[0].error
    length = np.hypot(measured[:, 0], measured[:, 1] if measured.shape[1] > 1 else 0.0)
    typical = float(np.quantile(length, 0.9)) or 1.0
    span = max(np.ptp(atlas.x), np.ptp(atlas.y)) or 1.0
    per_unit = 0.11 * span / typical
    out: Tables = {}
    for k, tile in enumerate(atlas.tiles):
        up = tile.error[:, 1] if tile.error.shape[1] > 1 else np.zeros(len(tile.error))
        out[f"tile_{k}"] = {
            "x": atlas.x.astype(np.float32), "y": atlas.y.astype(np.float32),
            "x1": (atlas.x + per_unit * tile.error[:, 0]).astype(np.float32),
            "y1": (atlas.y + per_unit * up).astype(np.float32),
        }  # fmt: skip
    (x0, x1), (y0, y1) = _reach(atlas.x), _reach(atlas.y)
    wide = x1 - x0
    # at least a tenth of the tile
    bar = round_number(max(typical, 0.1 * wide / per_unit), up=True)
    end = x1 - 0.04 * wide
    out["scale"] = {
        "x0": [end - bar * per_unit], "x1": [end], "y": [y0 + 0.04 * (y1 - y0)], "text": [f"{bar:g} {atlas.unit}"],
    }  # fmt: skip
    return out


def _reach(places: Floats) -> tuple[float, float]:
    """Range of a tile, with room for arrows on all sides and for the scale below."""
    room = 0.16 * float(np.ptp(places)) or 1.0
    return float(places.min()) - 1.6 * room, float(places.max()) + room
