"""``sherkit simulate``: a virtual robot's runs, to try things on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np
import tomli_w

from ..errors import SherkitError
from ..measurements import Measurements
from ..names import listed
from ..poses import paper_local, paper_whole, sphere_patch
from ..robots import Delta, Spherical, load_robot
from ..robots.flexible_tool import load_tool
from ..simulation import TABLE_II_SIZES, VirtualDelta
from ..spherical_simulation import PAPER_ERRORS, VirtualSpherical
from ..tool_simulation import EXPERIMENTS, VirtualTool
from . import output
from .tool import is_tool
from .vision import require_vision

POSES = {"whole": paper_whole, "local": paper_local}
_OF_DELTA = {"noise_um": 5.0, "rail_lean_mrad": 0.0, "beam_mrad": 0.0}
_OF_SPHERICAL: dict[str, Any] = {"noise_px": 0.1, "joint_offset_mrad": 0.0, "unequal_limbs_mrad": 0.0, "pictures": None}
_PER_SIDE = {"whole": 12, "local": 8}


@click.command()
@click.argument("robot", type=click.Path(path_type=Path))
@click.option("-o", "--output", "destination", type=click.Path(path_type=Path), required=True, help="CSV or Parquet.")
@click.option("--poses", type=click.Choice(tuple(POSES)), default="whole", show_default=True)
@click.option("--repeats", type=click.IntRange(min=1), default=5, show_default=True)
@click.option("--order", type=click.Choice(("planes", "shuffled")), default="planes", show_default=True)
@click.option("--errors", type=click.FloatRange(min=0), default=1.0, show_default=True,
              help="Size of the geometric errors, 1 = as in the paper's tables.")  # fmt: skip
@click.option("--noise-um", type=click.FloatRange(min=0), help="Delta: of a reading; default 5.")
@click.option("--rail-lean-mrad", type=click.FloatRange(min=0), help="Delta: rails that lean by this much.")
@click.option("--beam-mrad", type=click.FloatRange(min=0), help="Delta: laser beams that are not square.")
@click.option("--noise-px", type=click.FloatRange(min=0), help="Spherical: of a reading; default 0.1.")
@click.option("--joint-offset-mrad", type=float, help="Spherical: joints that are off by this much, each its own way.")
@click.option("--unequal-limbs-mrad", type=float, help="Spherical: limbs that differ by twice this much.")
@click.option("--pictures", type=click.Path(path_type=Path), help="Spherical: draw pictures into this folder, and read "
              "the pixels from them.")  # fmt: skip
@click.option("--experiment", type=click.Choice((*EXPERIMENTS, "free", "bench")), default="vessels", show_default=True,
              help="Flexible tool: one of the paper's, free (unbent), bench (known loads).")  # fmt: skip
@click.option("--seconds", type=click.FloatRange(min=2), default=60.0, show_default=True, help="Flexible tool.")
@click.option("--seed", type=int, default=0, show_default=True, help="Draws the robot and the noise.")
@click.option("--truth", type=click.Path(path_type=Path), help="Write the planted errors here (TOML).")
def simulate(
    robot: Path, destination: Path, poses: str, repeats: int, order: str, errors: float, seed: int,
    truth: Path | None, experiment: str, seconds: float, **given: Any,
) -> None:  # fmt: skip
    """Simulate a run of ROBOT (TOML) with planted errors, or of a flexible tool (see --experiment)."""
    if is_tool(robot):
        _tool(robot, destination, experiment, seconds, seed, given)
        return
    nominal = load_robot(robot)
    own, other = (_OF_DELTA, _OF_SPHERICAL) if isinstance(nominal, Delta) else (_OF_SPHERICAL, _OF_DELTA)
    wrong = [f"--{name.replace('_', '-')}" for name in other if given[name] is not None]
    if wrong:
        raise SherkitError(f"{robot}: is a {nominal.kind} robot; {listed(wrong)} is not for that kind")
    chosen = {name: default if given[name] is None else given[name] for name, default in own.items()}
    make = _delta if isinstance(nominal, Delta) else _spherical
    data, planted = make(nominal, poses, repeats, order, errors, seed, chosen)  # type: ignore[arg-type]
    data.save(destination)
    output.say(f"{len(data)} rows written to {destination}")
    if truth is not None:
        truth.write_text(tomli_w.dumps(planted), encoding="utf-8")
        output.say(f"planted errors written to {truth}")


def _tool(path: Path, destination: Path, experiment: str, seconds: float, seed: int, given: dict[str, Any]) -> None:
    """A run of the flexible tool as its file has it."""
    wrong = [f"--{name.replace('_', '-')}" for name, value in given.items() if value is not None]
    if wrong:
        raise SherkitError(f"{path}: is a flexible tool; {listed(wrong)} is not for that kind")
    virtual = VirtualTool(load_tool(path))
    if experiment == "bench":
        loads = virtual.bench(seed=seed)
        loads.save(destination)
        output.say(f"{len(loads)} loads written to {destination}")
        return
    if experiment == "free":
        run = virtual.free_motion(seconds=seconds, seed=seed)
    else:
        run = virtual.run(experiment, seconds=seconds, seed=seed)
    run.save(destination)
    output.say(f"{len(run)} rows and {len(run.camera_time_s)} pictures written to {destination}")


def _delta(
    robot: Delta, poses: str, repeats: int, order: str, errors: float, seed: int, given: dict[str, Any]
) -> tuple[Measurements, dict[str, Any]]:
    virtual = VirtualDelta.draw(
        robot,
        seed,
        sizes={k: v * errors for k, v in TABLE_II_SIZES.items()},
        rail_lean_rad=1e-3 * given["rail_lean_mrad"],
        beam=1e-3 * given["beam_mrad"],
        noise_mm=1e-3 * given["noise_um"],
    )
    planted = {
        "errors": dict(virtual.errors),
        "rail_lean_rad": np.asarray(virtual.rail_lean_rad, dtype=float).tolist(),
        "beam_matrix": np.asarray(virtual.beam_matrix, dtype=float).tolist(),
    }
    return virtual.measure(POSES[poses](), repeats=repeats, order=order, seed=seed + 1), planted


def _spherical(
    robot: Spherical, poses: str, repeats: int, order: str, errors: float, seed: int, given: dict[str, Any]
) -> tuple[Measurements, dict[str, Any]]:
    offset, unequal = 1e-3 * given["joint_offset_mrad"], 1e-3 * given["unequal_limbs_mrad"]
    virtual = VirtualSpherical(
        robot,
        {name: errors * value for name, value in PAPER_ERRORS.items()},
        joint_offset_rad=(offset, -0.5 * offset),
        unequal_limbs_rad=(unequal, -0.5 * unequal),
        noise_px=given["noise_px"],
    )
    angles = sphere_patch(robot, _PER_SIDE[poses], 1.0 if poses == "whole" else 0.5)
    planted = {
        "errors": dict(virtual.errors),
        "joint_offset_rad": list(np.asarray(virtual.joint_offset_rad, dtype=float)),
        "unequal_limbs_rad": list(np.asarray(virtual.unequal_limbs_rad, dtype=float)),
    }
    if given["pictures"] is None:
        return virtual.measure(angles, repeats=repeats, order=order, seed=seed + 1), planted
    require_vision()
    from ..vision.rows import seen_run

    plan = virtual.plan(angles, repeats=repeats, order=order, seed=seed + 1)
    return seen_run(plan, virtual.pictures(plan, seed=seed), save_in=given["pictures"]), planted
