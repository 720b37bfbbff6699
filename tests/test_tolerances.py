"""How well a drawing is known: [tolerances] and [known] of a robot's file take the place of plausible sizes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

import sherkit as sk
from sherkit.errors import RobotError
from sherkit.model.kinds import known_kinds, model_of
from sherkit.robots.delta import VirtualDelta, paper_local
from strategies import EXAMPLE


def written(folder: Path, kind: str, **tables: Any) -> Path:
    """The file of the example of a kind, with more tables."""
    path = folder / f"{kind}.toml"
    path.write_text(tomli_w.dumps(known_kinds()[kind].example.to_tables() | tables), encoding="utf-8")
    return path


STATED = {
    "delta": (
        {"rod_length": "0.05 mm", "base_angle": "0.1°", "rod_length_3": "± 20 µm"},
        {"rod_length_2": "120.00 ± 0.01 mm", "joint_offset_1": "± 0.2 mm"},
        {
            "rod_length_1": (0.05, False), "rod_length_2": (0.01, True), "rod_length_3": (0.02, False),
            "base_angle_1": (np.deg2rad(0.1), False), "joint_offset_1": (0.2, True), "joint_offset_2": (2.0, False),
        },
    ),
    "spherical": ({"beta": "2 mrad"}, {"alpha": "45 ± 0.01 deg"},
                  {"alpha": (np.deg2rad(0.01), True), "beta": (0.002, False), "radius": (20.0, False)}),
    "serial": ({"tilt": "0.02 deg", "tool": "1 mm"}, {"tool_x": "± 0.1 mm", "offset_2": "± 1e-4 rad"},
               {"tilt_y_3": (np.deg2rad(0.02), False), "tool_x": (0.1, True), "tool_y": (1.0, False),
                "offset_2": (1e-4, True), "offset_3": (0.01, False)}),
    "printer": ({"rod_length": "0.05 mm"}, {}, {"rod_length_2": (0.05, False), "base_radius_1": (3.0, False)}),
}  # fmt: skip


@pytest.mark.parametrize("kind", STATED)
def test_a_file_states_sizes_and_keeps_them(kind: str, tmp_path: Path) -> None:
    """Catches a unit that is not converted, a class that reaches too far, a single name that a class outvotes, and a
    file that is saved without its tables."""
    tolerances, known, expected = STATED[kind]
    robot = sk.load_robot(written(tmp_path, kind, tolerances=tolerances, known=known))
    found = {p.name: (p.size, p.known) for p in model_of(robot).base}
    for name, (size, is_known) in expected.items():
        assert found[name] == (pytest.approx(size), is_known), name
    sk.save_robot(robot, tmp_path / "again.toml")
    assert sk.load_robot(tmp_path / "again.toml") == robot


WRONG = [
    ({"tolerances": {"rod_length": "0.05"}}, "[tolerances] rod_length: '0.05' has no unit"),
    ({"tolerances": {"rod_length": 0.05}}, "[tolerances] rod_length: expected a size with its unit in quotes"),
    ({"tolerances": {"rod_length": "0.05 deg"}}, "expected a length (mm, um, m, in), found '0.05 deg'"),
    ({"tolerances": {"base_angle": "1 mm"}}, "expected an angle (deg, rad, mrad, arcmin, arcsec)"),
    ({"tolerances": {"rod_lenght": "1 mm"}}, "did you mean 'rod_length'?"),
    ({"tolerances": {"rod_length": "120 ± 1 mm"}}, "a value that was measured stands under [known]"),
    ({"known": {"rod_length_2": "217 ± 1 mm"}}, "expected 120 mm, which it is in this file"),
    ({"known": {"rod_length_2": "120 ± 1"}}, "'120 ± 1' has no unit"),
    ({"known": {"rod_length_2": "120 mm"}}, 'expected a size such as "217 ± 1 mm"'),
    ({"known": {"rod_length_2": "120 ± 0 mm"}}, "expected a deviation above zero"),
    ({"known": {"rod_length": "120 ± 1 mm"}}, "did you mean 'rod_length_"),
    ({"known": {"sensor_turn_x": "0 ± 1 deg"}}, "is said under [sensor_pose]"),
]  # fmt: skip


@pytest.mark.parametrize(("tables", "said"), WRONG)
def test_what_states_no_size_is_refused(tables: dict[str, Any], said: str, tmp_path: Path) -> None:
    """Catches a slip that is taken for a size, and a sentence that names neither file nor key nor what to write."""
    path = written(tmp_path, "delta", **tables)
    with pytest.raises(RobotError) as found:
        sk.load_robot(path)
    assert str(found.value).startswith(f"{path}: [")
    assert said in str(found.value)


def test_sizes_count_in_fits_and_are_kept_in_calibrations(tmp_path: Path) -> None:
    """Catches a tolerance that priors do not take, a known length that plain fits forget, and a calibration whose robot
    has lost both."""
    run = VirtualDelta(EXAMPLE, {"rod_length_2": 0.3}, noise_mm=0.001).measure(paper_local()[::8], seed=1)
    tight = replace(EXAMPLE, tolerances=sk.Stated.of({"base_angle": "1 arcsec"}))
    plain = sk.identify(EXAMPLE, run, priors=True)
    held = sk.identify(tight, run, priors=True)
    at = [p.name for p in plain.parameters].index("base_angle_1")
    assert held.std[at] <= np.deg2rad(1 / 3600) < plain.std[at]
    measured = replace(EXAMPLE, known=sk.Stated.of({"rod_length_2": "120 ± 0.0001 mm"}))
    assert abs(sk.identify(measured, run, priors=False).by_name["rod_length_2"]) < 0.01
    assert abs(sk.identify(EXAMPLE, run, priors=False).by_name["rod_length_2"] - 0.3) < 0.05
    sk.calibrate(tight, run).calibration.save(tmp_path / "c.toml")
    assert sk.load_calibration(tmp_path / "c.toml").robot == tight
