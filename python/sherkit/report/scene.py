"""Pictures in three dimensions that need no library: lines and arrows on a canvas that turns, and the same drawn still.

A scene is written as an element ``<sherkit-scene>``, which its script (:func:`script`, once for a page) brings to life
wherever it comes to stand, in a page's own elements and in Bokeh's. What the element holds is a still picture: what is
printed, and what readers without JavaScript see. Every text is escaped; nothing is asked of a network.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np

from ..base.types import Floats
from ..model.drawing import Drawing

_STILL_PX = 640
#: Turn about the vertical and height of the eye above the horizon, rad.
_VIEW = (0.3, 0.38)
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
    unit: str = "mm"
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
        (sin_yaw, cos_yaw), (sin, cos) = ((np.sin(a), np.cos(a)) for a in _VIEW)
        middle = middle + across * np.array([cos_yaw, sin_yaw, 0.0])
        middle -= up * np.array([-sin * sin_yaw, sin * cos_yaw, cos])
        wide, tall = high - low
        return middle, _ROOM * max(float(tall), self.aspect * float(wide)) or 1.0

    def _told(self) -> dict[str, Any]:
        centre, size = self._extent
        parts = [] if not self.frames else self.frames[0][1].parts
        return {
            "label": self.label,
            "view": list(_VIEW),
            "centre": [float(v) for v in centre.round(6)],
            "size": round(size, 6),
            "aspect": self.aspect,
            "width": _STILL_PX,
            "unit": self.unit,
            "axes": ["x", "y", "z"],
            "begin": self.begin,
            "moment": self.moment,
            "parts": [[p.name, p.look, p.path_mm.shape[1]] for p in parts],
            "frames": [{"at": at, "p": _packed(d.points_mm[0])} for at, d in self.frames],
            "arrows": None if self.arrows is None else _told_arrows(self.arrows, size),
            "field": None if self.field is None else _told_field(self.field),
        }

    def still(self, width_px: int = _STILL_PX) -> str:
        """The scene as it is seen at first, as SVG."""
        centre, size = self._extent
        height = self.aspect * width_px
        scale = min(width_px, height) / size
        # errors have the page for themselves, a drawing stands beside what is said of it
        wide = f"{width_px}px" if self.arrows is None else "100%"
        shown: list[str] = []
        if len(self.frames) > 1:
            shown += self._still_parts(self.frames[0][1], centre, scale, (width_px, height), plain=True)
        if self.frames:
            now = min(self.frames, key=lambda one: abs(one[0] - self.begin))[1]
            shown += self._still_parts(now, centre, scale, (width_px, height), plain=self.arrows is not None)
        if self.arrows is not None:
            shown += _still_arrows(self.arrows, centre, size, scale, (width_px, height))
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width_px} {height:.0f}" role="img" '
            f'aria-label="{escape(self.label)}" style="max-width:100%;width:{wide};background:#fff">'
            + "".join(shown)
            + "</svg>"
        )

    @staticmethod
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


def projected(points_mm: Floats, centre: Floats, scale: float, frame_px: tuple[float, float]) -> Floats:
    """Places (k, 3) as pixels (k, 2), as the canvas shows them at first."""
    x, y, z = (points_mm - centre).T
    (sin_yaw, cos_yaw), (sin, cos) = ((np.sin(a), np.cos(a)) for a in _VIEW)
    depth = -sin_yaw * x + cos_yaw * y
    across = cos_yaw * x + sin_yaw * y
    return np.column_stack([frame_px[0] / 2 + scale * across, frame_px[1] / 2 - scale * (cos * z + sin * depth)])


@cache
def script() -> str:
    """The script that brings scenes to life; a page needs it once."""
    return (files("sherkit.report") / "templates" / "scene.js").read_text(encoding="utf-8")


def _packed(values: Any) -> str:
    return base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii")


def _times(arrows: Arrows, size: float) -> float:
    """How much longer than the errors arrows are drawn: one of the bar's length is easily seen."""
    return 0.09 * size / arrows.bar_mm


def _told_arrows(a: Arrows, size: float) -> dict[str, Any]:
    return {
        "where": _packed(a.where_mm),
        "errors": [_packed(e) for e in a.errors_mm],
        "titles": list(a.titles),
        "line": _packed(a.line),
        "counted": a.counted,
        "worst": [_packed(w) for w in a.worst],
        "slabs": [list(s) for s in a.slabs],
        "height": a.height,
        "unit": a.unit,
        "perUnit": a.per_mm,
        "bar": a.bar_mm,
        "times": _times(a, size),
    }


def _told_field(f: Field) -> dict[str, Any]:
    return {
        "where": _packed(f.where_mm), "value": _packed(f.value), "low": f.low, "high": f.high, "unit": f.unit,
        "title": f.title, "cell": f.cell_mm,
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
    out.append(
        f'<text x="{20 + long:.0f}" y="{y + 5:.0f}" font-size="15" font-family="sans-serif">{escape(bar)}</text>'
    )
    return out
