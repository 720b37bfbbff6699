"""Files of a laboratory and an experiment for tests, and a delta whose truth is known."""

from __future__ import annotations

import tomli_w

from sherkit.cli.demo import EXAMPLE

ROBOT = EXAMPLE.to_tables() | {"joints": {"limits_mm": [60.0, 200.0]}}


def laboratory(folder, *, time_scale=400.0, noise_mm=0.005, lasers=None, rails=None, **tables):
    """Writes robot.toml and lab.toml; ``lasers`` and ``rails`` are more settings of the two instruments."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.toml").write_text(tomli_w.dumps(ROBOT), encoding="utf-8")
    values = {
        "robot": "robot.toml",
        "seed": 6,
        "time_scale": time_scale,
        "hidden": {"errors": 1.0, "rail_lean_mrad": 8.0},
        "instrument": [
            {"name": "rails", "kind": "galil", "counts_per_mm": 10000, **(rails or {})},
            {"name": "lasers", "kind": "keyence", "noise_mm": noise_mm, "noise_of_place": True, **(lasers or {})},
        ],
        **tables,
    }
    (folder / "lab.toml").write_text(tomli_w.dumps(values), encoding="utf-8")
    return folder / "lab.toml"


def experiment(folder, *, per_side=3, planes=(-8.0, 8.0), rails=None, lasers=None, plan=None, **tables):
    """Writes experiment.toml over a grid; addresses come from ports.json."""
    grid = {"poses": "grid", "half_width_mm": 8.0, "per_side": per_side, "planes_mm": list(planes), "seed": 3}
    values = {
        "robot": "robot.toml",
        "ports": "ports.json",
        "plan": {**grid, "order": "shuffled", **(plan or {})},
        "settle": {"seconds": 0.0},
        "check": {"agree_within_mm": 0.0005},
        "instrument": [
            {"name": "rails", "kind": "galil", "counts_per_mm": 10000, "poll_s": 0.002, **(rails or {})},
            {"name": "lasers", "kind": "keyence", **(lasers or {})},
        ],
        **tables,
    }
    (folder / "experiment.toml").write_text(tomli_w.dumps(values), encoding="utf-8")
    return folder / "experiment.toml"
