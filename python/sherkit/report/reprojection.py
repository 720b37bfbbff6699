"""Reprojection errors on the picture of the camera: where the model sees the marker and where the camera saw it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from bokeh.models import LinearColorMapper, Range1d
from numpy.typing import NDArray

from ..base.types import Floats
from .picture import Picture, Tables, single, sources_of
from .residual_map import round_number
from .style import INK, SEQUENTIAL, colour_bar, figure, hover, number

_WIDTH = 820
_MOST = 1500


@dataclass(frozen=True, eq=False)
class Reprojection:
    """``seen_px`` (n, 2) and ``error_px`` (n, 2) seen minus predicted, in a picture of ``size_px`` (width, height).

    ``image`` (height, width) in grey, 0 to 255, is drawn below them where there is one; ``line`` (n,) the row's number.
    """

    seen_px: Floats
    error_px: Floats
    size_px: tuple[int, int]
    line: NDArray[np.int64]
    image: NDArray[np.uint8] | None = None


def reprojection(state: Reprojection) -> Picture[Reprojection]:
    """Arrows from where the marker was seen along its error, much longer than they are; the scale is written below."""
    width, height = state.size_px
    sources = sources_of(_tables(state))
    made = figure(
        frame_width=_WIDTH, frame_height=int(_WIDTH * height / width), x_range=Range1d(0, width),
        y_range=Range1d(height, 0),
    )  # fmt: skip
    made.xaxis.axis_label, made.yaxis.axis_label = "u, px", "v, px"
    if state.image is not None:
        # pictures are stored from the top down, the axis runs down as well; pale, so that arrows stand out
        grey = LinearColorMapper(palette="Greys256", low=0, high=255)
        made.image([state.image], x=0, y=0, dw=width, dh=height, color_mapper=grey, alpha=0.45)
    size = np.hypot(*state.error_px.T)
    top = round_number(float(np.nanquantile(size, 0.99)) if len(size) else 1.0, up=True) or 1.0
    mapper = LinearColorMapper(palette=SEQUENTIAL[20:], low=0.0, high=top)
    made.segment(
        "u", "v", "u1", "v1", source=sources["marks"], line_width=2, color={"field": "size", "transform": mapper}
    )
    dots = made.scatter("u", "v", source=sources["marks"], size=4, color=INK)
    colour_bar(made, mapper, "error, px")
    made.add_tools(
        hover([dots], ("seen at", "@u{0.0}, @v{0.0} px"), ("error", "@eu{0.00}, @ev{0.00} px"), ("row", "@line"))
    )
    rms = float(np.sqrt(np.nanmean(np.sum(state.error_px**2, axis=1)))) if len(size) else 0.0
    note = f"Arrows are {_magnified(state):.0f} times as long as the errors; {number(rms)} px RMS."
    return Picture("reprojection", single("reprojection", made), sources, _tables, note=note)


def _magnified(state: Reprojection) -> float:
    size = np.hypot(*state.error_px.T)
    typical = float(np.nanquantile(size, 0.9)) if len(size) else 0.0
    return round_number(0.05 * state.size_px[0] / typical) if typical > 0 else 1.0


def _tables(state: Reprojection) -> Tables:
    keep = np.linspace(0, len(state.seen_px) - 1, min(len(state.seen_px), _MOST)).round().astype(int)
    by = _magnified(state)
    seen, error = state.seen_px[keep], state.error_px[keep]
    return {
        "marks": {
            "u": seen[:, 0], "v": seen[:, 1], "u1": seen[:, 0] + by * error[:, 0], "v1": seen[:, 1] + by * error[:, 1],
            "eu": error[:, 0], "ev": error[:, 1], "size": np.hypot(*error.T), "line": state.line[keep],
        }
    }  # fmt: skip
