"""Draws docs/pictures/demo.svg from the demo's run: what is wrong before and after. ``python docs/draw_demo.py``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import sherkit as sk

FOLDER = Path("demo")
OUT = Path(__file__).parent / "pictures" / "demo.svg"
PANEL, GAP, TOP = 300, 40, 70


def arrows(x0: float, title: str, note: str, where: np.ndarray, error_um: np.ndarray, scale: float) -> str:
    """One panel: an arrow per pose from where it is along its horizontal error; colour tells the vertical one."""
    parts = [
        f'<rect x="{x0}" y="{TOP}" width="{PANEL}" height="{PANEL}" fill="#fff" stroke="#bbb"/>',
        f'<text x="{x0}" y="{TOP - 32}" class="title">{title}</text>',
        f'<text x="{x0}" y="{TOP - 12}">{note}</text>',
    ]
    centre = np.array([x0 + PANEL / 2, TOP + PANEL / 2])
    for point, error in zip(where, error_um, strict=True):
        a = centre + point[:2] * [1, -1] * (PANEL / 2 - 26) / 20
        b = a + error[:2] * [1, -1] * scale
        colour = "#0072b2" if error[2] < 0 else "#d55e00"
        parts.append(
            f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}" stroke="{colour}" '
            f'stroke-width="1.5" stroke-opacity="{min(1.0, 0.25 + abs(error[2]) * scale / 14):.2f}"/>'
            f'<circle cx="{a[0]:.1f}" cy="{a[1]:.1f}" r="1.2" fill="#444"/>'
        )
    return "\n".join(parts)


def main() -> None:
    robot = sk.load_robot(FOLDER / "robot.toml")
    data = sk.read_measurements(FOLDER / "whole.csv")
    result = sk.calibrate(robot, data)
    fit = result.whole.fit
    plane = (np.abs(fit.predicted_mm[:, 2]) < 5) & (data.repeat == 1)
    where = fit.predicted_mm[plane]
    panels = (
        ("as drawn", fit.nominal_residuals_mm, 0.016),
        ("geometry calibrated", fit.residuals_mm, 0.1),
        ("corrected, on poses held out", result.whole.corrected_mm, 0.1),
    )
    body = []
    for k, (title, residual, scale) in enumerate(panels):
        rms = 1e3 * np.sqrt(np.nanmean(residual[:, :3] ** 2))
        note = f"{rms:.1f} µm RMS; bar = {20 / scale:.0f} µm"
        x0 = GAP + k * (PANEL + GAP)
        body.append(arrows(x0, title, note, where, residual[plane, :3] * 1e3, scale))
        body.append(f'<line x1="{x0 + PANEL - 30}" x2="{x0 + PANEL - 10}" y1="{TOP + PANEL - 10}" '
                    f'y2="{TOP + PANEL - 10}" stroke="#000" stroke-width="2"/>')  # fmt: skip
    width = GAP + len(panels) * (PANEL + GAP)
    OUT.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {TOP + PANEL + 45}" '
        'font-family="sans-serif" font-size="14">\n<style>.title{font-size:17px;font-weight:bold}</style>\n'
        f'<rect width="{width}" height="{TOP + PANEL + 45}" fill="#fafafa"/>\n'
        + "\n".join(body)
        + f'\n<text x="{GAP}" y="{TOP + PANEL + 28}">Measured minus predicted in the plane z = 0 of the simulated '
        "run of the demo (arrows: x, y; blue: lower, orange: higher than predicted).</text>\n</svg>\n",
        encoding="utf-8",
    )


if __name__ == "__main__":
    main()
