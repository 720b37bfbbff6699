"""``sherkit demo``: the paper's two experiments on a virtual robot, calibrated."""

from __future__ import annotations

from pathlib import Path

import click

from ..calibrate import calibrate
from ..measurements import read_measurements
from ..poses import paper_local, paper_whole
from ..robots import load_robot, save_robot
from ..robots.delta import Delta
from ..simulation import VirtualDelta
from . import output, tables

#: A described example, not the paper's robot: no nominal dimension of that one is printed.
EXAMPLE = Delta(
    base_radius_mm=(90.0, 90.0, 90.0),
    base_angle_deg=(90.0, 210.0, 330.0),
    platform_radius_mm=(30.0, 30.0, 30.0),
    platform_angle_deg=(90.0, 210.0, 330.0),
    rod_length_mm=(120.0, 120.0, 120.0),
    rod_spacing_mm=40.0,
    target_offset_mm=(0.0, 0.0, -25.0),
    pole_pitch_mm=2.0,
    workspace_radius_mm=30.0,
    workspace_z_mm=(-22.0, 22.0),
    region_half_width_mm=10.0,
)


@click.command()
@click.option("-o", "--output", "folder", type=click.Path(path_type=Path), default=Path("demo"), show_default=True)
@click.option("--seed", type=int, default=6, show_default=True)
def demo(folder: Path, seed: int) -> None:
    """Simulate the paper's experiments, calibrate, and print its tables beside the paper's."""
    folder.mkdir(parents=True, exist_ok=True)
    save_robot(EXAMPLE, folder / "robot.toml")
    robot = load_robot(folder / "robot.toml")
    # leaning rails and skew beams: the paper's own suspects for what its model leaves
    virtual = VirtualDelta.draw(robot, seed, rail_lean_rad=10e-3, beam=20e-3, noise_mm=0.005)
    with output.steps(9) as step:
        step("simulating the whole workspace")
        virtual.measure(paper_whole(), repeats=5, seed=seed).save(folder / "whole.csv")
        step("simulating the region of interest")
        virtual.measure(paper_local(), repeats=5, seed=seed + 1).save(folder / "local.csv")
        result = calibrate(
            robot, read_measurements(folder / "whole.csv"), read_measurements(folder / "local.csv"), step=step
        )
    result.calibration.save(folder / "calibrated.toml")
    output.out.print(
        "[bold]SIMULATION.[/] A virtual delta with planted errors of the size of the paper's Table II, 5 µm noise, "
        "leaning rails and skew laser beams.\nThe geometry is an example; the paper's figures (dim) are of its own "
        "robot, so sizes may be compared and values may not.\n"
    )
    tables.result(result, demo=True)
    output.say(
        f"\nrobot.toml, whole.csv, local.csv and calibrated.toml are in {folder}/. Try:\n"
        f"  sherkit calibrate {folder}/robot.toml {folder}/whole.csv --local {folder}/local.csv"
    )
