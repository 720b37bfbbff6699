"""Pictures in three dimensions that need no library: lines and arrows on a canvas that turns, and the same drawn still.

A scene is written as an element ``<sherkit-scene>``, which its script (:func:`script`, once for a page) brings to life
wherever it comes to stand, in a page's own elements and in Bokeh's. What the element holds is a still picture: what is
printed, and what readers without JavaScript see. Every text is escaped; nothing is asked of a network.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from html import escape
from importlib.resources import files
from itertools import pairwise
from typing import Any

import numpy as np

from ..base.types import Floats, Ints
from ..data import Measurements
from ..errors import SherkitError
from ..fit.identify import Fit
from ..model.drawing import Draw, Drawing
from ..model.kinds import draw_of, kind_of
from ..model.sensor_pose import POSE, SPACE
from ..robots.calibrated import Calibration
from ..robots.deployed import BASE, SENSOR
from .picture import in_text, rows_to_draw
from .residual_arrows import round_number
from .residuals import ModelState

_STILL_PX = 640
#: Turn about the vertical and height of the eye above the horizon, rad.
_VIEW = (0.3, 0.38)
(_SIN_YAW, _COS_YAW), (_SIN, _COS) = ((np.sin(a), np.cos(a)) for a in _VIEW)
#: Room around what is drawn.
_ROOM = 1.16
#: How far beyond the places of errors the machine around them is shown, by their width.
_ERRORS_FILL = 0.55
_TYPE = 'font-size="15" font-family="sans-serif"'
#: Width, colour and radius of dots in the still picture, by look.
_LOOK = {
    "guide": (1, "#c8c8c8", 0), "frame": (3, "#777", 0), "axis": (1, "#777", 0), "rod": (2.2, "#0072b2", 0),
    "link": (4, "#333", 0), "platform": (3, "#0072b2", 0), "joint": (1, "#333", 3.5), "sensor": (1.6, "#777", 0),
    "ray": (1.6, "#d55e00", 0), "target": (1, "#0072b2", 5), "shown": (2, "#d55e00", 5),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Arrows:
    """Errors at places: ``where_mm`` (n, 3), ``errors_mm`` of each of some states (n, 3), their ``titles``.

    ``line`` (n,) is the number of each row, counted in ``counted``; ``worst`` are rows to be ringed, by state;
    ``slabs`` (lowest, highest, name) are the heights among which one is chosen, ``height`` what they are called. People
    read errors in ``unit``, of which a mm has ``per_mm``. ``bar_mm`` is a round length for the bar.
    """

    where_mm: Floats
    errors_mm: Sequence[Floats]
    titles: Sequence[str]
    line: Floats
    counted: str
    worst: Sequence[Floats]
    slabs: Sequence[tuple[float, float, str]]
    height: str
    unit: str
    per_mm: float
    bar_mm: float


@dataclass(frozen=True, eq=False)
class Field:
    """Numbers (n,) at places (n, 3), mm, in ``unit``, coloured from ``low`` to ``high``, ``cell_mm`` apart."""

    where_mm: Floats
    value: Floats
    low: float
    high: float
    unit: str
    title: str
    cell_mm: float


@dataclass(frozen=True, eq=False)
class Scene:
    """What is drawn: a machine with more and more of an effect (``frames``: factor and drawing, the first one without),
    or at one pose; errors; a field. ``begin`` is the factor that is shown first, ``moment`` the number of the state
    whose errors are. The view is as wide as what is measured, or as the ``whole`` machine. ``label`` says in words
    what it is.
    """

    label: str
    frames: Sequence[tuple[float, Drawing]] = ()
    begin: float = 0.0
    arrows: Arrows | None = None
    field: Field | None = None
    aspect: float = 0.72
    moment: int = 0
    whole: bool = False

    def html(self) -> str:
        """The element, with the still picture in it."""
        told = escape(json.dumps(self._told(), allow_nan=False, ensure_ascii=False), quote=True)
        return f'<sherkit-scene data-scene="{told}">{self.still()}</sherkit-scene>'

    @property
    def _extent(self) -> tuple[Floats, float]:
        """Centre (3,) and size of what is drawn at first."""
        points = [drawing.points_mm[0] for at, drawing in self.frames if at <= max(self.begin, 1e-9)]
        every = np.concatenate(points or [np.zeros((0, 3))])
        every = every[np.isfinite(every).all(axis=1)]
        if self.arrows is not None:
            # what is measured fills the middle, however much larger the machine is
            places = self.arrows.where_mm
            middle = places.mean(axis=0)
            reach = np.inf if self.whole else _ERRORS_FILL * float(np.linalg.norm(np.ptp(places, axis=0)))
            every = np.concatenate([places, np.clip(every, middle - reach, middle + reach)])
        middle = 0.5 * (every.min(axis=0) + every.max(axis=0))
        seen = projected(every, middle, 1.0, (0.0, 0.0))
        low, high = seen.min(axis=0), seen.max(axis=0)
        # the middle of what is seen, in the plane that is looked at
        across, up = 0.5 * (low + high)
        middle = middle + across * np.array([_COS_YAW, _SIN_YAW, 0.0])
        middle -= up * np.array([-_SIN * _SIN_YAW, _SIN * _COS_YAW, _COS])
        wide, tall = high - low
        return middle, _ROOM * max(float(tall), self.aspect * float(wide)) or 1.0

    def _told(self) -> dict[str, Any]:
        centre, size = self._extent
        parts = [] if not self.frames else self.frames[0][1].parts
        return {
            **{name: getattr(self, name) for name in ("label", "aspect", "begin", "moment")},
            "view": _VIEW,
            "centre": centre.round(6).tolist(),
            "size": round(size, 6),
            "width": _STILL_PX,
            "axes": ["x", "y", "z"],
            "parts": [[p.name, p.look, p.path_mm.shape[1]] for p in parts],
            "frames": [{"at": at, "p": in_text(d.points_mm[0])} for at, d in self.frames],
            "arrows": None if self.arrows is None else _told_arrows(self.arrows, size),
            "field": None
            if (f := self.field) is None
            else {
                "where": in_text(f.where_mm),
                "value": in_text(f.value),
                "low": f.low,
                "high": f.high,
                "unit": f.unit,
                "title": f.title,
                "cell": f.cell_mm,
            },
        }

    def still(self, width_px: int = _STILL_PX) -> str:
        """The scene as it is seen at first, as SVG."""
        centre, size = self._extent
        height = self.aspect * width_px
        scale = min(width_px, height) / size
        # errors have the page for themselves, a drawing stands beside what is said of it
        wide = f"{width_px}px" if self.arrows is None else "100%"
        now = min(self.frames, key=lambda one: abs(one[0] - self.begin), default=None)
        drawn = [(self.frames[0][1], True)] if len(self.frames) > 1 else []
        drawn += [] if now is None else [(now[1], self.arrows is not None)]
        shown: list[str] = []
        for drawing, plain in drawn:
            shown += _still_parts(drawing, centre, scale, (width_px, height), plain=plain)
        if self.arrows is not None:
            shown += _still_arrows(self.arrows, centre, size, scale, (width_px, height))
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width_px} {height:.0f}" role="img" '
            f'aria-label="{escape(self.label)}" style="max-width:100%;width:{wide};background:#fff">'
            + "".join(shown)
            + "</svg>"
        )


def projected(points_mm: Floats, centre: Floats, scale: float, frame_px: tuple[float, float]) -> Floats:
    """Places (k, 3) as pixels (k, 2), as the canvas shows them at first."""
    x, y, z = (points_mm - centre).T
    depth = -_SIN_YAW * x + _COS_YAW * y
    across = _COS_YAW * x + _SIN_YAW * y
    return np.column_stack([frame_px[0] / 2 + scale * across, frame_px[1] / 2 - scale * (_COS * z + _SIN * depth)])


@cache
def script() -> str:
    """The script that brings scenes to life; a page needs it once."""
    return (files("sherkit.report") / "templates" / "scene.js").read_text(encoding="utf-8")


def _times(arrows: Arrows, size: float) -> float:
    """How much longer than the errors arrows are drawn: one of the bar's length is easily seen."""
    return 0.09 * size / arrows.bar_mm


def _still_parts(
    drawing: Drawing, centre: Floats, scale: float, frame: tuple[float, float], *, plain: bool
) -> list[str]:
    out = []
    for part in drawing.parts:
        width, colour, dot = _LOOK[part.look]
        colour = "#c4c4c4" if plain else colour
        xy = projected(part.path_mm[0], centre, scale, frame)
        if not np.isfinite(xy).all():
            continue
        if dot:
            hollow = 'fill="none" stroke-width="2.5"' if part.look == "shown" else f'fill="{colour}"'
            out.append(f'<circle cx="{xy[0, 0]:.1f}" cy="{xy[0, 1]:.1f}" r="{dot}" stroke="{colour}" {hollow}/>')
            continue
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in xy)
        fill = f'fill="{colour}" fill-opacity="0.18"' if part.look == "platform" and not plain else 'fill="none"'
        out.append(
            f'<polyline points="{points}" {fill} stroke="{colour}" stroke-width="{width}" stroke-linecap="round"/>'
        )
    return out


def _told_arrows(a: Arrows, size: float) -> dict[str, Any]:
    return {
        "where": in_text(a.where_mm), "errors": [*map(in_text, a.errors_mm)], "titles": a.titles,
        "line": in_text(a.line), "counted": a.counted, "worst": [*map(in_text, a.worst)], "slabs": a.slabs,
        "height": a.height, "unit": a.unit, "perUnit": a.per_mm, "bar": a.bar_mm, "times": _times(a, size),
    }  # fmt: skip


def _still_arrows(
    a: Arrows, centre: Floats, size: float, scale: float, frame: tuple[float, float]
) -> list[str]:  # fmt: skip
    """The last state's arrows, those before it paler beneath."""
    out = []
    start = projected(a.where_mm, centre, scale, frame)
    states = list(zip(a.errors_mm, a.titles, strict=True))
    ends = [(*states[0], "#e8a878", "#b5622a"), (*states[-1], "#0072b2", "#0072b2")][-len(states) :]
    for errors, _, colour, _ in ends:
        end = projected(a.where_mm + _times(a, size) * errors, centre, scale, frame)
        path = "".join(f"M{p[0]:.1f} {p[1]:.1f}L{q[0]:.1f} {q[1]:.1f}" for p, q in zip(start, end, strict=True))
        out.append(f'<path d="{path}" stroke="{colour}" stroke-width="1.3" fill="none"/>')
    long, y = a.bar_mm * _times(a, size) * scale, frame[1] - 20
    out.append(f'<path d="M14 {y:.0f}h{long:.1f}" stroke="#222" stroke-width="2"/>')
    for k, (_, title, _, ink) in enumerate(ends):
        out.append(f'<text x="14" y="{24 + 20 * k}" {_TYPE} fill="{ink}">{escape(title)}</text>')
    bar = f"{a.bar_mm * a.per_mm:g} {a.unit}"
    out.append(f'<text x="{20 + long:.0f}" y="{y + 5:.0f}" {_TYPE}>{escape(bar)}</text>')
    return out


# -- The workspace ----------------------------------------------------------------------------------------------------

#: So many arrows are drawn, and places at which the accuracy is predicted.
_MOST_ARROWS, _MOST_CELLS = 3000, 700
#: Height by width: with what is said above it, a scene stands on one screen.
_ASPECT, _ASPECT_OF_ALL = 0.42, 0.8
#: Rings of the largest errors.
_WORST = 5
#: Heights that a run kept to, if they are no more; else slabs of equally many places.
_PLANES, _SLABS = 12, 6


def space_of(
    before: ModelState,
    after: ModelState,
    calibration: Calibration | None = None,
    *,
    moment: int = 0,
    whole: bool = False,
) -> Scene | None:
    """The scene of two fits of one run: errors of the one and of the other, mean of the repeats of a pose. Where both
    are the same, its errors once. It begins with the errors of the fit of this number, ``moment``, and shows the
    ``whole`` machine or what is measured of it.

    Errors are those of the place that who trusts the drawing reads off the instrument: for a camera, on the sphere of
    the drawing. None where the run says no places: distances alone, or poses with a coordinate that was not read.
    """
    fit, titles = after.fit, [before.title, after.title]
    data, draw = fit.data, draw_of(fit.model)
    count = data.coordinates
    rows = np.flatnonzero(~data.is_distance & data.taken[:, :count].all(axis=1) & ~data.outlier)
    if len(rows) < 2:
        return None
    _, first, group = np.unique(data.groups[rows], return_index=True, return_inverse=True)
    keep = rows_to_draw(len(first), _MOST_ARROWS)
    try:
        where, errors, machine = _errors(draw, (before.fit, after.fit), data.select(rows), first[keep], group, keep)
    except SherkitError:
        return None
    if before.fit is after.fit or before.title == after.title:
        errors, titles = errors[:1], titles[:1]
    good = np.isfinite(where).all(axis=1) & np.isfinite(errors).all(axis=(0, 2))
    where, errors, lines = where[good], errors[:, good], data.line[rows[first[keep]]][good]
    if len(where) < 2:
        return None
    sizes = np.linalg.norm(errors, axis=2)
    arrows = Arrows(
        where, list(errors), titles, lines.astype(float), "pose at " + data.counted,
        [np.argsort(-s)[:_WORST].astype(float) for s in sizes], _slabs(where[:, 2]), "height",
        "µm", 1e3, round_number(float(np.quantile(sizes[0], 0.9))) or 1.0,
    )  # fmt: skip
    field = None if calibration is None else _field(calibration, draw, fit, where)
    label = f"{machine_name(fit.model)} and the errors of {len(where)} poses, {' and '.join(titles)}"
    aspect = _ASPECT_OF_ALL if whole else _ASPECT
    moment = min(moment, len(errors) - 1)
    return Scene(label, [(0.0, machine)], 0.0, arrows, field, aspect, moment, whole)


def machine_name(model: Any) -> str:
    """What people call the machine of a model."""
    name = "the machine" if model.robot is None else kind_of(model.robot).title
    return name[:1].upper() + name[1:]


def _errors(
    draw: Draw, fits: tuple[Fit, Fit], data: Measurements, first: Ints, group: Ints, keep: Ints
) -> tuple[Floats, Floats, Drawing]:
    """Places (k, 3), errors of each fit (2, k, 3), and the machine amid them; repeats of a pose are averaged.

    The machine is that of the drawing; what reads its places stands where the first fit has it, for all that is drawn.
    """
    places = data.layout.coordinates in (SPACE, SPACE[:2])
    stands = {p.name: v for p, v in zip(fits[0].parameters, fits[0].values, strict=True) if places and p.name in POSE}
    plain = [np.array([stands.get(p.name, 0.0) for p in fit.parameters]) for fit in fits]
    read = draw(fits[0].model, data, plain[0], data.readings[:, : data.coordinates]).shown_mm

    def mean(values: Floats) -> Floats:
        sums = np.zeros((group.max() + 1, 3))
        np.add.at(sums, group, values)
        return (sums / np.bincount(group)[:, None])[keep]

    errors = [
        mean(read - draw(fit.model, data, at, fit.model.predict(data, fit.values)[:, : data.coordinates]).shown_mm)
        for fit, at in zip(fits, plain, strict=True)
    ]
    where = mean(read)
    middle = int(np.nanargmin(np.linalg.norm(where - np.nanmean(where, axis=0), axis=1)))
    pose = data.select(first[[middle]])
    return where, np.array(errors), draw(fits[0].model, pose, plain[0], None)


def _slabs(height: Floats) -> list[tuple[float, float, str]]:
    levels = np.unique(height.round(3))
    room = 1e-3 + 1e-3 * float(np.ptp(height))
    if len(levels) <= _PLANES:
        return [(float(z) - room, float(z) + room, f"{z:.4g} mm") for z in levels]
    # poses that were commanded to a few heights lie a little beside them
    near = np.split(np.sort(height), np.flatnonzero(np.diff(np.sort(height)) > 0.04 * np.ptp(height)) + 1)
    if 1 < len(near) <= _PLANES:
        return [(float(z[0]) - room, float(z[-1]) + room, f"{np.mean(z):.3g} mm") for z in near]
    edges = np.quantile(height, np.linspace(0, 1, _SLABS + 1))
    return [(float(a), float(b), f"{a:.3g} to {b:.3g} mm") for a, b in pairwise(edges)]


def _field(calibration: Calibration, draw: Draw, fit: Fit, where: Floats) -> Field | None:
    """The accuracy that the calibration promises over the workspace, as a field of places."""
    planes = calibration.planes(2 * int(np.sqrt(_MOST_CELLS / 3)) // 2)
    grid = np.ascontiguousarray(planes.grid[planes.inside])
    try:
        # a robot is sent to places of its base
        at_base = calibration.frame == SENSOR and BASE in calibration.frames
        found = fit.model.robot.inverse_batch(calibration.from_sensor(grid) if at_base else grid)
        grid = grid[found.reached]
        promised = 1e3 * calibration.predicted_accuracies(grid).total_mm
        model = replace(fit.model, effects=())
        rows = fit.data.unmeasured(found.values[found.reached])
        places = draw(model, rows, np.zeros(len(model.parameters)), None).target_mm
    except SherkitError:
        return None
    good = np.isfinite(promised) & np.isfinite(places).all(axis=1)
    if not good.any():
        return None
    cell = float(np.sqrt(np.prod(np.ptp(where, axis=0)[:2]) / max(1, good.sum() / 3)))
    high = float(np.quantile(promised[good], 0.98))
    return Field(places[good], promised[good], 0.0, high, "µm", "accuracy to come, 95 %", cell)
