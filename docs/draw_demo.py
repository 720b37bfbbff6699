"""Draws docs/pictures/demo.svg from the demo's run: what is wrong before and after. ``python docs/draw_demo.py``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import sherkit as sk
from sherkit.base.figures import CALIBRATED, state_with
from sherkit.report.residual_arrows import Change
from sherkit.report.residual_map import still
from sherkit.report.residuals import on_rows, residuals_of

FOLDER = Path("demo")
OUT = Path(__file__).parent / "pictures" / "demo.svg"


def main() -> None:
    study = sk.Study(sk.load_robot(FOLDER / "robot.toml"), sk.read_measurements(FOLDER / "whole.csv"))
    before = study.fit
    for name in study.diagnose().effects:
        study.add(name)
    upper = np.flatnonzero(before.predicted[:, 2] > 10)
    drawn, calibrated, found = (
        residuals_of(on_rows(fit, upper)) for fit in (replace(before, values=0.0 * before.values), before, study.fit)
    )
    as_drawn = Change(drawn, drawn, after_title="as drawn")
    with_effects = Change(calibrated, found, CALIBRATED, state_with(study.effects))
    caption = "Measured minus predicted in one plane of the demo."
    OUT.write_text(still(as_drawn, with_effects, caption=caption), encoding="utf-8")


if __name__ == "__main__":
    main()
