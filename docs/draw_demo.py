"""Draws docs/pictures/demo.svg from the demo's run: what is wrong before and after. ``python docs/draw_demo.py``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import sherkit as sk
from sherkit.report.picture import Panel, residual_maps

FOLDER = Path("demo")
OUT = Path(__file__).parent / "pictures" / "demo.svg"


def main() -> None:
    study = sk.Study(sk.load_robot(FOLDER / "robot.toml"), sk.read_measurements(FOLDER / "whole.csv"))
    before = study.fit
    for name in study.diagnose().effects:
        study.add(name)
    plane = (np.abs(before.predicted[:, 2]) > 10) & (before.predicted[:, 2] > 0) & (study.data.repeat == 1)
    where = before.predicted[plane, :3]
    panels = [
        Panel("as drawn", where, before.nominal_residuals[plane, :3], 1000.0),
        Panel("geometry calibrated", where, before.residuals[plane, :3], 200.0),
        Panel(f"{' and '.join(study.effects)} found and added", where, study.fit.residuals[plane, :3], 200.0),
    ]
    caption = "Measured minus predicted in the plane z = 20 mm of the demo's simulated run (arrows: x, y; blue: lower, "
    OUT.write_text(residual_maps(panels, caption + "orange: higher)."), encoding="utf-8")


if __name__ == "__main__":
    main()
