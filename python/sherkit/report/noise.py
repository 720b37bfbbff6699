"""Residuals against the noise: histogram with the noise's own curve, and Q–Q plot."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from ..base.types import Floats
from .picture import Picture, Tables, sources_of, stacked
from .residuals import Residuals
from .style import COLOURS, INK, MARKERS, figure, hover, legend

_BINS, _CURVE, _QUANTILES = (11, 41), 121, 200
_HEIGHT = 360


def noise_picture(left: Residuals) -> Picture[Residuals]:
    """Left a histogram of what remains over its noise, right its quantiles against those of the noise.

    On the dashed line the remains are noise; a steeper line means that they are larger, bent ends that single readings
    are wilder. Where the noise is unknown it is that of the remains themselves, which the axis says.
    """
    sources = sources_of(_tables(left))
    known = left.noise_origin != "unknown"
    unit = "σ of the noise" if known else "σ of the rest itself"
    curve = "noise" if known else "Gaussian"
    histogram = figure(height=_HEIGHT, sizing_mode="stretch_width")
    histogram.xaxis.axis_label, histogram.yaxis.axis_label = f"residual, {unit}", "density, per σ"
    plot = figure(height=_HEIGHT, sizing_mode="stretch_width")
    plot.xaxis.axis_label, plot.yaxis.axis_label = "quantile of a Gaussian, σ", "quantile of the residuals, σ"
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
    root = stacked("noise", [histogram, plot], columns=2, sizing_mode="stretch_width")
    return Picture("noise", root, sources, _tables, note=note)


def _tables(left: Residuals) -> Tables:
    bins: dict[str, Any] = {}
    quantiles: dict[str, Any] = {}
    # few readings in many bars are a comb
    readings = int(np.isfinite(left.values[~left.outlier]).sum()) / max(len(left.names), 1)
    edges = np.linspace(-5, 5, int(np.clip(np.sqrt(readings), *_BINS)) // 2 * 2 + 2)
    bins["at"] = 0.5 * (edges[1:] + edges[:-1])
    count = min(int(np.isfinite(left.values).all(axis=1).sum()), _QUANTILES)
    level = (np.arange(count) + 0.5) / max(count, 1)
    quantiles["gauss"] = scipy.special.ndtri(level)
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
