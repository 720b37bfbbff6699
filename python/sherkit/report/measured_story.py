"""The story of a run that chose its poses, as a page: also while it goes on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.models import DataRange1d

from ..adaptive import Adaptive
from .stories import write_page
from .style import COLOURS, MUTED, figure, legend, quantity

#: Until it is done a browser reads the page anew after so many seconds.
_AGAIN_S = 5
_HEIGHT, _SQUARE = 300, 380
_TEN = float(np.log(10.0))
#: What several rows are driven for is one colour.
_KINDS = ("start", "all", "what tells rivals apart", "confirm", "explore", "again", "time")


def write_adaptive(path: Path, loop: Adaptive, title: str) -> None:
    """Writes the evidence of what led, reading after reading, how far off the models were at readings that they did
    not know yet, and where and why the robot was driven. Until the loop is done the page renews itself."""
    told = [loop.sentence(), loop.why, *loop.told()] if loop.done else [loop.sentence(), _next(loop)]
    figures: list[Any] = []
    if loop.looks:
        figures += [_evidence(loop), _errors(loop)]
    if loop.readings:
        figures.append(_places(loop))
    write_page(path, title, [one for one in told if one], figures, again_s=0 if loop.done else _AGAIN_S)


def _next(loop: Adaptive) -> str:
    """Why the next poses are driven, in words."""
    asked: dict[str, int] = {}
    for row in loop.ask():
        asked[row["reason"]] = asked.get(row["reason"], 0) + 1
    return "next: " + ", ".join(f"{count} × {reason}" for reason, count in asked.items())


def _evidence(loop: Adaptive) -> Any:
    looks = loop.looks
    made = figure(height=_HEIGHT + 60, sizing_mode="stretch_width")
    made.xaxis.axis_label, made.yaxis.axis_label = "readings", "evidence, powers of ten"
    readings = [one.readings for one in looks]
    made.line(readings, [one.log_evidence / _TEN for one in looks], color=MUTED, line_dash="dashed",
              legend_label="anything is missing")  # fmt: skip
    for k, (keys, _) in enumerate(looks[-1].leading):
        names = frozenset(name for name, _ in keys)
        values = [max((v for other, v in one.sets if frozenset(n for n, _ in other) == names), default=np.nan) / _TEN
                  for one in looks]  # fmt: skip
        made.line(readings, values, color=COLOURS[k], line_width=2, legend_label=" & ".join(sorted(names)))
        made.scatter(readings, values, color=COLOURS[k], size=6)
    legend(made)
    return made


def _errors(loop: Adaptive) -> Any:
    steps = loop.progress
    readings = [one.readings for one in steps]
    made = figure(height=_HEIGHT, sizing_mode="stretch_width", y_range=DataRange1d(start=0.0))
    made.xaxis.axis_label, made.yaxis.axis_label = "readings", f"error, {loop.layout.unit}"
    lines: tuple[tuple[str, Sequence[float | None], str], ...] = (
        ("new readings, by the geometry alone", [one.by_geometry for one in steps], MUTED),
        ("new readings, with what leads", [one.by_lead for one in steps], COLOURS[0]),
        ("anywhere, 95 of 100, by the fit alone", [one.accuracy_um for one in steps], COLOURS[1]),
    )
    for name, values, colour in lines:
        if any(value is not None and np.isfinite(value) for value in values):
            made.line(readings, values, color=colour, line_width=2, legend_label=name)
            made.scatter(readings, values, color=colour, size=6)
    if loop.done and loop.accuracy_um is not None:
        made.scatter(readings[-1:], [loop.accuracy_um], color=COLOURS[1], size=10, marker="diamond",
                     legend_label="anywhere, promised by a calibration")  # fmt: skip
    legend(made)
    return made


def _places(loop: Adaptive) -> Any:
    """Where the robot was driven, by why."""
    data = loop.data
    reached = loop.region.reached_at(data.joints)
    placed = dict(zip(loop.region.targets, reached.T, strict=True))
    x, y = list(placed)[:2]
    why = [_kind(one) for one in loop.reasons] or ["all"] * len(data)
    made = figure(frame_width=_SQUARE, frame_height=_SQUARE, match_aspect=True)
    for k, kind in enumerate(_KINDS):
        at = [i for i, one in enumerate(why) if one == kind]
        if at:
            made.scatter(placed[x][at], placed[y][at], size=7, color=COLOURS[k % len(COLOURS)], alpha=0.8,
                         legend_label=kind)  # fmt: skip
    made.xaxis.axis_label, made.yaxis.axis_label = quantity(x), quantity(y)
    legend(made)
    return made


def _kind(reason: str) -> str:
    return _KINDS[2] if "|" in reason else reason if reason in _KINDS else "all"
