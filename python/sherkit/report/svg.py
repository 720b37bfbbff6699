"""Residual maps as SVG: an arrow per pose along its horizontal error, the vertical one as colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from ..base.types import Floats

_PANEL, _GAP, _TOP = 300, 40, 70
_LOWER, _HIGHER = "#0072b2", "#d55e00"  # blue and orange, told apart by colour-blind people too
_MARGIN = 30


@dataclass(frozen=True, eq=False)
class Panel:
    """One map: where (n, 3) mm, the error there (n, 3) mm, and the length of the scale bar in µm."""

    title: str
    where_mm: Floats
    error_mm: Floats
    bar_um: float
    note: str = ""


def residual_maps(panels: Sequence[Panel], caption: str) -> str:
    """An SVG with the panels side by side on one scale of the workspace. Text is escaped."""
    reach = max(float(np.abs(p.where_mm[:, :2]).max(initial=1.0)) for p in panels)
    body = [_draw(p, _GAP + k * (_PANEL + _GAP), reach) for k, p in enumerate(panels)]
    width, height = _GAP + len(panels) * (_PANEL + _GAP), _TOP + _PANEL + 45
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
        'font-size="14">\n<style>.title{font-size:17px;font-weight:bold}</style>\n'
        f'<rect width="{width}" height="{height}" fill="#fafafa"/>\n'
        + "\n".join(body)
        + f'\n<text x="{_GAP}" y="{_TOP + _PANEL + 28}">{escape(caption)}</text>\n</svg>\n'
    )


def _draw(panel: Panel, x0: float, reach: float) -> str:
    centre = np.array([x0 + _PANEL / 2, _TOP + _PANEL / 2])
    per_um = 20.0 / panel.bar_um  # the bar is 20 pixels long
    rms = 1e3 * np.sqrt(np.mean(panel.error_mm**2)) if len(panel.error_mm) else 0.0
    note = panel.note or f"{rms:.1f} µm RMS; bar = {panel.bar_um:g} µm"
    parts = [
        f'<rect x="{x0}" y="{_TOP}" width="{_PANEL}" height="{_PANEL}" fill="#fff" stroke="#bbb"/>',
        f'<text x="{x0}" y="{_TOP - 32}" class="title">{escape(panel.title)}</text>',
        f'<text x="{x0}" y="{_TOP - 12}">{escape(note)}</text>',
    ]
    for point, error in zip(panel.where_mm, panel.error_mm * 1e3, strict=True):
        a = centre + point[:2] * [1, -1] * (_PANEL / 2 - _MARGIN) / reach
        b = a + error[:2] * [1, -1] * per_um
        strength = min(1.0, 0.25 + abs(float(error[2])) * per_um / 14)
        parts.append(
            f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}" '
            f'stroke="{_LOWER if error[2] < 0 else _HIGHER}" stroke-width="1.5" stroke-opacity="{strength:.2f}"/>'
            f'<circle cx="{a[0]:.1f}" cy="{a[1]:.1f}" r="1.2" fill="#444"/>'
        )
    right, bottom = x0 + _PANEL - 10, _TOP + _PANEL - 10
    parts.append(f'<line x1="{right - 20}" x2="{right}" y1="{bottom}" y2="{bottom}" stroke="#000" stroke-width="2"/>')
    return "\n".join(parts)


def round_bar(error_mm: Floats) -> float:
    """A round length for the scale bar, µm: near the largest error."""
    largest = 1e3 * float(np.abs(error_mm).max(initial=0.0))
    if largest <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(largest))
    return float(power * max(step for step in (1, 2, 5) if step * power <= largest))
