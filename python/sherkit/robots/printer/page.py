"""The page of a printer: what its owner is told, the machine from above and from the side, the plate as it reads."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from ...base.types import Floats
from ...fit.forms import known
from ...report.page import Made, Section, html_sentences, html_table, write_page
from .printer_diagnosis import Examined

_SIZE, _GAP, _TOP = 300, 40, 40
#: Blue and orange, which colour-blind people tell apart too.
_LOW, _HIGH = np.array([0, 114, 178]), np.array([213, 94, 0])
_NAMES = "ABC"


#: What the answer does not say already.
_FURTHER = ("What was measured", "What accuracy remains", "What to measure next")


def write_printer(path: Path, examined: Examined, made: Made) -> None:
    """A page that opens without a network. Raises :class:`~sherkit.errors.NotWritten`."""
    sections = [
        Section("The machine and its plate", f'<div class="picture">{drawing(examined)}</div>'),
        Section("Numbers of the firmware", html_table(("", "now", "better"), examined.numbers)),
        *(Section(title, html_sentences(*said)) for title, said in examined.sections if title in _FURTHER),
    ]
    write_page(path, examined.answer, sections, made)


def drawing(examined: Examined) -> str:
    """An SVG: the plate as it reads and as it would with the best numbers, the towers from above and from the front."""
    plain = examined.plain
    rows = ~plain.data.between_places & ~plain.data.outlier
    at = plain.model.tips(plain.data)[rows, :2]
    before, after = -plain.nominal_residuals[rows, 0], -examined.left_by_new[rows, 0]
    before, after = before - before.mean(), after - after.mean()
    most = max(float(np.abs(before).max(initial=0.0)), 1e-6)
    lean = _lean(examined)
    panels = [
        _plate("the plate as it reads now", at, before, most),
        _plate("with the best numbers", at, after, most),
        _above(examined, lean),
        _side(examined, lean),
    ]
    width = _GAP + len(panels) * (_SIZE + _GAP)
    body = "".join(
        f'<g transform="translate({_GAP + k * (_SIZE + _GAP)},{_TOP})">{one}</g>' for k, one in enumerate(panels)
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {_SIZE + _TOP + 60}" font-family="sans-serif" '
        f'font-size="14"><rect width="100%" height="100%" fill="#fafafa"/>{body}</svg>'
    )


def _titled(title: str, parts: Sequence[str], *notes: str) -> str:
    frame = f'<rect width="{_SIZE}" height="{_SIZE}" fill="#fff" stroke="#bbb"/>'
    return f'<text y="-12" font-weight="bold">{escape(title)}</text>{frame}{"".join(parts)}' + "".join(
        f'<text y="{_SIZE + 22 + 19 * k}">{escape(line)}</text>' for k, line in enumerate(notes)
    )


def _plate(title: str, at: Floats, high: Floats, most: float) -> str:
    reach = 1.15 * max(float(np.abs(at).max(initial=1.0)), 1.0)
    parts = []
    for (x, y), z in zip(at.tolist(), high.tolist(), strict=True):
        part = min(abs(z) / most, 1.0)
        red, green, blue = (np.array([255, 255, 255]) + part * ((_HIGH if z > 0 else _LOW) - 255)).astype(int)
        parts.append(
            f'<circle cx="{_px(x, reach):.1f}" cy="{_px(-y, reach):.1f}" r="9" fill="rgb({red},{green},{blue})" '
            'stroke="#999" stroke-width="0.5"/>'
        )
    rms = float(np.sqrt(np.mean((high - high.mean()) ** 2))) if len(high) else 0.0
    return _titled(title, parts, f"{1e3 * rms:.0f} µm RMS", f"orange high, blue low, to ± {1e3 * most:.0f} µm")


def _above(examined: Examined, lean: Floats) -> str:
    robot = examined.found.robot
    turn = np.deg2rad(robot.towers.angle_deg)
    radius = robot.towers.radius_mm
    reach, plate = 1.5 * radius, robot.workspace_radius_mm or 0.8 * radius
    parts = [f'<circle cx="150" cy="150" r="{plate / reach * 150:.1f}" fill="#eee" stroke="#999"/>']
    for k, (name, t) in enumerate(zip(_NAMES, turn, strict=True)):
        x, y = radius * np.cos(t), radius * np.sin(t)
        # leans are drawn twenty times as large as they are
        dx, dy = 20.0 * (lean[k, 0] * np.array([np.cos(t), np.sin(t)]) + lean[k, 1] * np.array([-np.sin(t), np.cos(t)]))
        parts.append(f'<circle cx="{_px(x, reach):.1f}" cy="{_px(-y, reach):.1f}" r="7" fill="#444"/>')
        parts.append(
            f'<line x1="{_px(x, reach):.1f}" y1="{_px(-y, reach):.1f}" x2="{_px(x + dx, reach):.1f}" '
            f'y2="{_px(-y - dy, reach):.1f}" stroke="rgb(213,94,0)" stroke-width="3"/>'
        )
        parts.append(f'<text x="{_px(1.25 * x, reach) - 5:.1f}" y="{_px(-1.25 * y, reach) + 5:.1f}">{name}</text>')
    return _titled("from above, front below", parts, "orange: leans of the towers,", "20 times as large")


def _side(examined: Examined, lean: Floats) -> str:
    robot = examined.found.robot
    turn, radius, top = np.deg2rad(robot.towers.angle_deg), robot.towers.radius_mm, float(robot.towers.top_mm.max())
    scale = 260.0 / max(top, 3.0 * radius)
    parts = ['<line x1="20" x2="280" y1="280" y2="280" stroke="#999"/>']
    for k, (name, t) in enumerate(zip(_NAMES, turn, strict=True)):
        x = radius * np.cos(t)
        away = 20.0 * (lean[k, 0] * np.cos(t) - lean[k, 1] * np.sin(t))
        parts.append(
            f'<line x1="{150 + scale * x:.1f}" y1="280" x2="{150 + scale * (x + away):.1f}" '
            f'y2="{280 - scale * top:.1f}" stroke="#444" stroke-width="4"/>'
        )
        parts.append(f'<text x="{145 + scale * x:.1f}" y="{272 - scale * top:.1f}">{name}</text>')
    return _titled("from the front", parts, "leans 20 times as large")


def _lean(examined: Examined) -> Floats:
    """How far out and sideways (3, 2) the top of each tower is, mm, as far as that is known of the first suspect whose
    towers lean; zero where there is none, or where no single tower can be told."""
    out = np.zeros((3, 2))
    top = float(examined.found.robot.towers.top_mm.mean())
    for one in examined.suspects:
        what = known(one.fit).get("rail_lean")
        if what is None or what.form == "combination":
            continue
        signs = (1.0, -1.0) if what.form == "opposite" else (1.0, 1.0, 1.0)
        for value in what.values:
            kind = ("radial", "tangential").index(value.what.split()[0])
            for tower, sign in zip(what.at, signs, strict=False):
                out[tower - 1, kind] = sign * top * float(np.tan(np.deg2rad(value.value)))
        break
    return out


def _px(value: float, reach: float) -> float:
    return 150.0 + 150.0 * value / reach
