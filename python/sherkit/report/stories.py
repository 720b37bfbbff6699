"""Short pages of their own: what has changed between runs, the course over the years, a run that chose its poses."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.layouts import column
from bokeh.models import Div

from ..adaptive import Adaptive
from ..changes import Comparison, History
from ..data.files import write_whole
from .changed import before_and_after, course, mechanism_with_change
from .policy import fresh_nonce, page_of
from .scene import script
from .style import COLOURS, MUTED, figure, legend, quantity

_HEIGHT, _WIDE = 300, 420
_TEN = float(np.log(10.0))


def _page(path: Path, title: str, sentences: Sequence[str], figures: Sequence[Any], scene: str = "") -> None:
    """One HTML file that opens without a network; ``scene`` is HTML that follows what is told."""
    told = "".join(f"<p>{escape(one)}</p>" for one in sentences)
    style = "<style>:host{font:15px/1.45 sans-serif}p{margin:.5em 0}</style>"
    head = Div(text=f"{style}<h1>{escape(title)}</h1>{told}{scene}", sizing_mode="stretch_width")
    nonce = fresh_nonce()
    whole = column(head, *figures, sizing_mode="stretch_width", margin=(10, 30, 30, 30))
    # a library of Bokeh's holds the end of a body in a text
    page, _, end = page_of(whole, title, nonce).rpartition("</body>")
    moving = f'<script nonce="{nonce}">{script()}</script>' if "<sherkit-scene" in scene else ""
    write_whole(path, f"{page}{moving}</body>{end}")


def write_comparison(path: Path, found: Comparison, title: str) -> None:
    """Before and after beside each other on one scale, and the mechanism with what has changed, exaggerated.

    Raises :class:`~sherkit.errors.FitError` for a comparison that was read from a file, without its runs.
    """
    picture = before_and_after(found)
    told = [found.headline, *(f"{' or '.join(tie)}: these runs cannot tell" for tie in found.indistinguishable)]
    poses = [", ".join(f"{name} {value:.4g}" for name, value in pose.items()) for pose in found.next_poses]
    drawn = mechanism_with_change(found)
    scene = "" if drawn is None else f"<h2>What has changed</h2>{drawn[0].html()}<p>{escape(drawn[1])}</p>"
    scene += f"<h2>Before and after</h2><p>{escape(picture.note)}</p>"
    _page(path, title, [*told, found.advice, *poses], [picture.root], scene)


def write_history(path: Path, found: History, title: str) -> None:
    """The error of each run, and of what has changed its course with deviations; what stood still is left out."""
    told = [f"{found.verdict}.", *map(str, found.changes), f"{len(found.stood_still)} others stood still."]
    _page(path, title, told, [course(found).root])


def write_adaptive(path: Path, loop: Adaptive, title: str) -> None:
    """The story of a run that chose its poses: the evidence of what led in the end, reading after reading."""
    looks = loop.looks
    made = figure(height=_HEIGHT + 60, sizing_mode="stretch_width")
    made.xaxis.axis_label, made.yaxis.axis_label = "readings", "evidence, powers of ten"
    readings = [one.readings for one in looks]
    made.line(readings, [one.log_evidence / _TEN for one in looks], color=MUTED, line_dash="dashed",
              legend_label="anything is missing")  # fmt: skip
    # what led, and what else would have done; the leader with something besides is no story
    lead = {name for name, _ in looks[-1].sets[0][0]} if looks else set()
    last = (
        [one for k, one in enumerate(looks[-1].sets) if not k or not lead <= {n for n, _ in one[0]}][:3]
        if looks
        else []
    )
    for k, (keys, _) in enumerate(last):
        names = frozenset(name for name, _ in keys)
        values = [max((v for other, v in one.sets if frozenset(n for n, _ in other) == names), default=np.nan) / _TEN
                  for one in looks]  # fmt: skip
        made.line(readings, values, color=COLOURS[k], line_width=2, legend_label=" & ".join(sorted(names)))
        made.scatter(readings, values, color=COLOURS[k], size=6)
    if last:
        legend(made)
    data = loop.data
    where = figure(height=_WIDE, width=_WIDE, sizing_mode="fixed")
    x, y = list(data.layout.coordinates)[:2]
    places = data.readings[:, :2]
    where.scatter(places[:, 0], places[:, 1], size=6, color=COLOURS[0], alpha=0.7)
    where.xaxis.axis_label, where.yaxis.axis_label = quantity(x), quantity(y)
    _page(path, title, [loop.sentence(), loop.why, *loop.told()], [made, where])
