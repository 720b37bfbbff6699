"""Files of a laboratory and an experiment for tests, and a delta whose truth is known."""

from __future__ import annotations

import tomli_w

from sherkit.cli.demo import EXAMPLE

ROBOT = EXAMPLE.to_tables() | {"joints": {"pole_pitch_mm": 2.0, "limits_mm": [60.0, 200.0]}}


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
            # a machine that does other work answers late
            {
                "name": "rails",
                "kind": "galil",
                "counts_per_mm": 10000,
                "poll_s": 0.002,
                "poll_timeout_s": 5.0,
                **(rails or {}),
            },
            {"name": "lasers", "kind": "keyence", **(lasers or {})},
        ],
        **tables,
    }
    (folder / "experiment.toml").write_text(tomli_w.dumps(values), encoding="utf-8")
    return folder / "experiment.toml"


SPHERICAL = {
    "kind": "spherical",
    "geometry": {"alpha_deg": 45.0, "beta_deg": 45.0, "radius_mm": 200.0, "gravity": [0.0, 0.0, -1.0]},
    "joints": {"limits_deg": [-180.0, 270.0]},
    "workspace": {"phi_deg": [60.0, 120.0], "gamma_deg": [25.0, 65.0]},
    "camera": {
        "size_px": [1280, 640], "focal_px": [710.0, 710.0], "phi_deg": 90.0, "gamma_deg": 45.0, "distance_mm": 446.2,
    },
}  # fmt: skip


def spherical_laboratory(folder, *, per_side=5, faults=None):
    """Writes robot.toml, lab.toml and experiment.toml of a spherical robot that a camera looks at."""
    (folder / "robot.toml").write_text(tomli_w.dumps(SPHERICAL), encoding="utf-8")
    lab = {
        "robot": "robot.toml",
        "seed": 3,
        "time_scale": 200.0,
        "hidden": {"errors": 1.0},
        "instrument": [
            {"name": "joints", "kind": "galil", "counts_per_rad": 200000.0},
            {"name": "eye", "kind": "camera", "noise_grey": 2.0, **({"faults": faults} if faults else {})},
        ],
    }
    (folder / "lab.toml").write_text(tomli_w.dumps(lab), encoding="utf-8")
    values = {
        "robot": "robot.toml",
        "ports": "ports.json",
        "plan": {"poses": "patch", "per_side": per_side, "share": 0.8, "order": "shuffled"},
        "settle": {"seconds": 0.0},
        "instrument": [
            {"name": "joints", "kind": "galil", "counts_per_rad": 200000.0, "poll_s": 0.002, "poll_timeout_s": 5.0},
            {"name": "eye", "kind": "camera"},
        ],
    }
    (folder / "experiment.toml").write_text(tomli_w.dumps(values), encoding="utf-8")
    return folder / "lab.toml"
