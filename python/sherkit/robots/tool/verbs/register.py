"""``sherkit register``: frame and clock of the camera that sees a flexible tool."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from ....cli import output
from ....cli.file_kinds import TOOL
from ....cli.paths import InputFile, OutputFile
from ..alignment import Aligned, align_run
from ..runs import read_free_motion
from ..tool import load_tool


@click.command()
@click.argument("tool", type=InputFile())
@click.argument("run", type=InputFile())
@click.option("-o", "--output", "destination", type=OutputFile(TOOL), help="Write the tool file here.")
@click.option("--longest-delay-s", type=click.FloatRange(min=0, min_open=True), default=0.5, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
def register(tool: Path, run: Path, destination: Path | None, longest_delay_s: float, as_json: bool) -> None:
    """Frame and clock of the camera from RUN, in which the unbent TOOL was led around freely."""
    made = load_tool(tool)
    found = align_run(read_free_motion(run, made.columns), longest_delay_s, made.length_mm)
    if destination is not None:
        found.in_tool(made).save(destination)
    if as_json:
        output.print_json({**alignment_json(found), "tool": found.in_tool(made).to_tables()})
        return
    print_alignment(found)
    if destination is not None:
        output.say(f"tool with this camera written to {destination}")


def alignment_json(found: Aligned) -> dict[str, Any]:
    """Frame and clock of the camera, without the tool."""
    r, errors = found.registration, found.errors
    return {
        "rotation_rad": r.rotation_rad.tolist(), "translation_mm": r.translation_mm.tolist(),
        "std": np.sqrt(np.diag(r.covariance).clip(0.0)).tolist(), "delay_s": found.delay_s,
        "delay_std_s": found.delay_std_s, "pictures": len(r.residuals_mm), "mean_error_mm": r.mean_error_mm,
        "rms_mm": found.rms_mm, "noise_mm": errors.noise_mm, "smooth_errors_mm": errors.size_mm,
        "reach_mm": errors.reach_mm,
    }  # fmt: skip


def print_alignment(found: Aligned) -> None:
    """Frame and clock of the camera."""
    r = found.registration
    std = np.sqrt(np.diag(r.covariance).clip(0.0))
    table = output.table(
        "Camera in the robot's base", "", "value", "± std", note=f"{len(r.residuals_mm)} pictures, mean error "
        f"{r.mean_error_mm:.3f} mm (paper: 0.67 mm)",
    )  # fmt: skip
    cells = (
        *((f"turn {axis}, rad", f"{v:+.5f}") for axis, v in zip("xyz", r.rotation_rad, strict=True)),
        *((f"shift {axis}, mm", f"{v:+.3f}") for axis, v in zip("xyz", r.translation_mm, strict=True)),
        ("delay, s", f"{found.delay_s:+.4f}"),
    )
    for (name, value), known_to in zip(cells, (*std, found.delay_std_s), strict=True):
        table.add_row(name, value, f"{known_to:.1g}")
    output.out.print(table)
    errors = found.errors
    if errors.size_mm > 0:
        output.say(
            f"   deviations are for noise of {errors.noise_mm:.2f} mm an axis and smooth errors of "
            f"{errors.size_mm:.2f} mm that are alike within {errors.reach_mm:.0f} mm"
        )
