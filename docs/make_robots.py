"""Writes ``rust/c/examples/robots.h``: calibrations of three example robots as C arrays.

Run with sherkit installed whenever the layout of ``flat()`` changes: ``python docs/make_robots.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sherkit import _core
from sherkit.cli.demo import EXAMPLE
from sherkit.model.sensor_pose import SensorPose
from sherkit.robots.c_header import c_array
from sherkit.robots.serial import KIND


def _places(catalogue: Sequence[Mapping[str, Any]]) -> dict[str, slice]:
    out: dict[str, slice] = {}
    for row in catalogue:
        start = max((place.stop for place in out.values()), default=0)
        out[row["name"]] = slice(start, start + len(row["parameters"]))
    return out


#: Where the rows of parameters stand.
PLACES, ARM_PLACES = _places(_core.DeltaModel.CATALOGUE), _places(_core.SerialModel.CATALOGUE)

#: Where the instruments of delta and arm stand: as trackers do, anywhere.
BESIDE_DELTA = SensorPose((210.0, -140.0, 35.0), (25.0, -40.0, 160.0))
BESIDE_ARM = SensorPose((1200.0, -700.0, 300.0), (3.0, -5.0, 130.0))

HEADER = Path(__file__).parents[1] / "rust/c/examples/robots.h"


#: What is wrong with the instruments: beams that are not square, a scale, ends that bend, a stand that was knocked.
BEAMS = np.array([[1e-3, 2e-3, -1e-3], [0.0, -1e-3, 3e-3], [-2e-3, 1e-3, 1e-3]])
BENDS_MM, SCALE, ARM_BENDS_MM = np.array([1e-5, -2e-5, 3e-4]), 1e-4, np.array([0.1, -0.2, 0.1])
KNOCK = np.array([1e-3, -2e-3, 1e-3, 0.1, -0.2, 0.1])


def delta(frame: str = "sensor") -> _core.Calibrated:
    """The example delta with small errors, a correction, and a local model blended in, read by an instrument that is
    not right either; positions in a frame."""
    random = np.random.default_rng(1)
    settings = np.array([40.0, 2.0, 130.0, 130.0, 130.0, 0.0, 0.0, 0.0, 0.0])
    offset = np.array(EXAMPLE.target_offset_mm)
    model = _core.DeltaModel(EXAMPLE.geometry, offset, "below", BESIDE_DELTA.numbers, settings)
    values = np.zeros(_core.DeltaModel.PARAMETERS)
    values[:18] = 0.02 * random.normal(size=18) * np.tile([1.0, 0.01, 1.0, 1.0, 0.0, 0.0], 3)
    values[PLACES["sensor_pose"]] = 0.1 * random.normal(size=6) * [0.01, 0.01, 0.01, 1.0, 1.0, 1.0]
    values[PLACES["beam_alignment"]], values[PLACES["sensor_linearity"]] = BEAMS.ravel(), BENDS_MM
    values[PLACES["sensor_slip"]] = KNOCK
    local = values.copy()
    local[PLACES["rail_lean"]] = 1e-4 * random.normal(size=6)
    local[PLACES["rod_mismatch"]] = 0.01 * random.normal(size=3)
    corner = np.full(3, 20.0)
    corrections = []
    for orders in ((2, 2, 1), (1, 1, 1)):
        count = int(np.prod(np.array(orders) + 1))
        corrections.append(_core.Bernstein(orders, -corner, corner, 5.0, 0.005 * random.normal(size=(count, 3))))
    return _core.Calibrated(
        (model, values, corrections[0]), (model, local, corrections[1]), (-0.25 * corner, 0.25 * corner, 2.0), frame
    )


def spherical() -> _core.SphericalCalibrated:
    """A robot with unequal limbs, seen by a camera."""
    camera = _core.Camera.facing(1.5, 0.8, 446.2, np.array([1100.0, 1100.0, 640.0, 320.0]))
    geometry = np.array([0.7854, 0.7854, 0.0, 0.7854, 0.7854, 0.0])
    settings = np.array([200.0, 0.0, 0.6, -0.8, 1.5, 1.5])
    model = _core.SphericalModel(geometry, camera, settings)
    values = np.zeros(_core.SphericalModel.PARAMETERS)
    values[0:2] = [-0.02, 0.018]
    return _core.SphericalCalibrated(model, values)


def serial(frame: str = "base") -> _core.SerialCalibrated:
    """A six-axis arm with small geometric errors; its joints give way, under a payload too, and have play; its tracker
    is not right either; places in a frame."""
    at_work = ("joint_compliance", "payload_compliance", "joint_coupling", "backlash", "encoder_eccentricity")
    random = np.random.default_rng(2)
    arm = replace(KIND.example, sensor_pose=BESIDE_ARM)
    values = np.zeros(_core.SerialModel.PARAMETERS)
    for row in _core.SerialModel.CATALOGUE:
        sizes = [p["size"] for p in row["parameters"]]
        if row["base"] or row["name"] in at_work:
            values[ARM_PLACES[row["name"]]] = 0.3 * random.normal(size=len(sizes)) * sizes
    values[ARM_PLACES["sensor_scale"]], values[ARM_PLACES["sensor_linearity"]] = SCALE, ARM_BENDS_MM
    values[ARM_PLACES["sensor_slip"]] = KNOCK
    return _core.SerialCalibrated(arm.core(), values, *(np.ascontiguousarray(one) for one in arm.ranges), frame)


def text() -> str:
    lines = ["/* Calibrations of three example robots, as sherkit's flat() writes them. Made by make_robots.py. */"]
    lines += ["#ifndef ROBOTS_H", "#define ROBOTS_H", "", c_array("example_delta", delta().flat()) + "\n"]
    lines += [
        c_array("example_spherical", spherical().flat()) + "\n",
        c_array("example_serial", serial().flat()) + "\n",
        "#endif",
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    HEADER.write_text(text(), encoding="utf-8")
