"""``sherkit simulate``: a virtual robot's runs, to try things on."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
import tomli_w

from ..poses import paper_local, paper_whole
from ..robots import load_robot
from ..simulation import TABLE_II_SIZES, VirtualDelta
from . import output

POSES = {"whole": paper_whole, "local": paper_local}


@click.command()
@click.argument("robot", type=click.Path(path_type=Path))
@click.option("-o", "--output", "destination", type=click.Path(path_type=Path), required=True, help="CSV or Parquet.")
@click.option("--poses", type=click.Choice(tuple(POSES)), default="whole", show_default=True)
@click.option("--repeats", type=click.IntRange(min=1), default=5, show_default=True)
@click.option("--order", type=click.Choice(("planes", "shuffled")), default="planes", show_default=True)
@click.option("--noise-um", type=click.FloatRange(min=0), default=5.0, show_default=True)
@click.option("--errors", type=click.FloatRange(min=0), default=1.0, show_default=True,
              help="Size of the geometric errors, 1 = as in the paper's Table II.")  # fmt: skip
@click.option("--rail-lean-mrad", type=click.FloatRange(min=0), default=0.0, show_default=True)
@click.option("--beam-mrad", type=click.FloatRange(min=0), default=0.0, show_default=True)
@click.option("--seed", type=int, default=0, show_default=True, help="Draws the robot and the noise.")
@click.option("--truth", type=click.Path(path_type=Path), help="Write the planted errors here (TOML).")
def simulate(
    robot: Path, destination: Path, poses: str, repeats: int, order: str, noise_um: float, errors: float,
    rail_lean_mrad: float, beam_mrad: float, seed: int, truth: Path | None,
) -> None:  # fmt: skip
    """Simulate a run of ROBOT (TOML) with planted errors."""
    virtual = VirtualDelta.draw(
        load_robot(robot),
        seed,
        sizes={k: v * errors for k, v in TABLE_II_SIZES.items()},
        rail_lean_rad=1e-3 * rail_lean_mrad,
        beam=1e-3 * beam_mrad,
        noise_mm=1e-3 * noise_um,
    )
    data = virtual.measure(POSES[poses](), repeats=repeats, order=order, seed=seed + 1)
    data.save(destination)
    output.say(f"{len(data)} rows written to {destination}")
    if truth is not None:
        planted = {
            "errors": dict(virtual.errors),
            "rail_lean_rad": np.asarray(virtual.rail_lean_rad, dtype=float).tolist(),
            "beam_matrix": np.asarray(virtual.beam_matrix, dtype=float).tolist(),
        }
        truth.write_text(tomli_w.dumps(planted), encoding="utf-8")
        output.say(f"planted errors written to {truth}")
