"""Files of a calibration: back to the last bit, and refused by their key where they are wrong."""

from __future__ import annotations

import copy
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
import tomli_w
from hypothesis import given

from sherkit.errors import CalibrationError
from sherkit.robots.delta import Correction, DeltaCalibration, grid
from strategies import EXAMPLE
from test_calibration import BLEND, EFFECTS, HALF, SEEDS, SIZES, SOME, SOME_EFFECTS, experiment, made, part


@SOME
@given(SEEDS, st.booleans(), st.sampled_from([None, 1.7]), SOME_EFFECTS)
def test_file_and_back_is_the_same_calibration(
    tmp_path_factory: pytest.TempPathFactory, seed: int, local: bool, blend_mm: float | None, effects: tuple[str, ...]
) -> None:
    """Catches a digit lost in the file: positions, Jacobians, covariance and accuracy are the same to the last bit."""
    c = made(seed, local=local, blend_mm=blend_mm, effects=effects)
    path = tmp_path_factory.mktemp("file") / "calibration.toml"
    c.save(path)
    back = DeltaCalibration.load(path)
    rng = np.random.default_rng(seed)
    q = EXAMPLE.inverse_batch(rng.uniform(-25.0, 25.0, (30, 3))).require()
    np.testing.assert_array_equal(back.forward_batch(q).values, c.forward_batch(q).values)
    np.testing.assert_array_equal(back.jacobian_batch(q).values, c.jacobian_batch(q).values)
    for x in rng.uniform(-20.0, 20.0, (5, 3)):
        assert back.accuracy(x) == c.accuracy(x)
        assert back.measured(x) == c.measured(x)
    assert back.robot == c.robot
    assert (back.region_half_width_mm, back.blend_mm) == (c.region_half_width_mm, c.blend_mm)
    assert (back.local is None) == (c.local is None)
    for ours, theirs in ((c.whole, back.whole), (c.local, back.local)):
        if ours is None or theirs is None:
            continue
        for name in ("free", "effects", "settings", "left_out", "now", "made_from", "rows"):
            assert getattr(theirs, name) == getattr(ours, name)
        for name in ("values", "covariance", "residual_covariance", "uncorrected_covariance"):
            np.testing.assert_array_equal(getattr(theirs, name), getattr(ours, name))
    back.save(path.with_name("again.toml"))
    assert path.with_name("again.toml").read_text() == path.read_text()


def test_measured_calibration_survives_its_file(tmp_path: Path) -> None:
    """Catches what random parts do not have: orders chosen, boxes of real runs, robot with all its tables."""
    c = experiment(0, 0.01)[1].calibration
    c.save(tmp_path / "c.toml")
    back = DeltaCalibration.load(str(tmp_path / "c.toml"))
    q = EXAMPLE.inverse_batch(grid(21.0, 9, (-20.0, 0.0, 9.0))).require()
    np.testing.assert_array_equal(back.forward_batch(q).values, c.forward_batch(q).values)
    assert [back.accuracy([v, 0.0, 0.0]) for v in (0.0, 15.0)] == [c.accuracy([v, 0.0, 0.0]) for v in (0.0, 15.0)]
    assert repr(back) == repr(c)


def test_standard_deviations_in_the_file_are_those_of_the_covariance(tmp_path: Path) -> None:
    """Catches numbers for people that disagree with those for the machine."""
    made(0).save(tmp_path / "c.toml")
    for name in ("whole", "local"):
        table = tomllib.loads((tmp_path / "c.toml").read_text())[name]
        for k, p in enumerate(table["parameters"]):
            assert p["std"] ** 2 == pytest.approx(table["covariance"][k][k], rel=1e-12)
            assert p["unit"] == ("rad" if "angle" in p["name"] or "turn" in p["name"] else "mm")


@pytest.fixture
def tables(tmp_path: Path) -> dict[str, Any]:
    """A calibration file's tables: two parts, one of them corrected."""
    rng = np.random.default_rng(0)
    values = 0.1 * SIZES * rng.normal(size=len(SIZES))
    whole, local = (part(rng, values, box, corrected=False) for box in (24.0, 14.0))
    side = np.array([14.0, 14.0, np.inf])
    local = replace(local, correction=Correction((1, 1, 0), -side, side, 4.0, np.eye(4)[:, :3]))
    DeltaCalibration(EXAMPLE, whole, local, HALF, BLEND).save(tmp_path / "good.toml")
    return tomllib.loads((tmp_path / "good.toml").read_text())


def broken(tables: dict[str, Any], key: str, value: Any, path: Path) -> str:
    """What loading says, after the file's name, of a value replaced at a dotted key, or left out where it is None."""
    *above, last = key.split(".")
    table = tables = copy.deepcopy(tables)
    for name in above:
        table = table[name]
    if value is None:
        del table[last]
    else:
        assert last in table
        table[last] = value
    path.write_text(tomli_w.dumps(tables))
    with pytest.raises(CalibrationError) as caught:
        DeltaCalibration.load(path)
    # the name of pytest's folder may hold the key
    assert str(caught.value).startswith(str(path))
    return str(caught.value).replace(str(path), "file")


PART = (
    "effects", "left_out", "settings", "now", "parameters", "covariance", "residual_covariance_mm2",
    "uncorrected_covariance_mm2", "low_mm", "high_mm", "made_from", "rows",
)  # fmt: skip
CORRECTION = ("orders", "low_mm", "high_mm", "fade_mm", "coefficients_mm")


@pytest.mark.parametrize(
    "key",
    [
        "calibration", "calibration.format", "calibration.frame", "robot",
        "robot.kind", "robot.geometry", "robot.geometry.rod_length_mm",
        "whole", *(f"whole.{k}" for k in PART), *(f"local.{k}" for k in PART),
        *(f"local.correction.{k}" for k in CORRECTION),
    ],
)  # fmt: skip
def test_missing_key_is_named(tables: dict[str, Any], key: str, tmp_path: Path) -> None:
    """Catches a file that lost a line and still loads, or fails without saying which."""
    assert key.rsplit(".", 1)[-1] in broken(tables, key, None, tmp_path / "bad.toml")


@pytest.mark.parametrize("key", ["local", "calibration.region_half_width_mm"])
def test_half_a_local_model_is_refused(tables: dict[str, Any], key: str, tmp_path: Path) -> None:
    """Catches a local model without its region, or the reverse, in a file."""
    assert "file: a local model needs the half width" in broken(tables, key, None, tmp_path / "bad.toml")


_NAN, _INF = float("nan"), float("inf")
#: Wrong counts, types and robots, by their key, which is named.
WRONG: dict[str, tuple[Any, ...]] = {
    "calibration.format": (6, "1"),
    "calibration.frame": ("base", "bed", 1),
    "calibration.region_half_width_mm": ("x",),
    "calibration.blend_mm": ("x",),
    "robot": (3,),
    "robot.kind": ("hexapod",),
    "robot.geometry": (3,),
    "robot.geometry.rod_length_mm": ([120.0, 120.0], [120.0, _NAN, 120.0], [20.0, 20.0, 20.0]),
    "whole": (3, []),
    "whole.rows": ("x",),
    "whole.parameters": (3, [1.0]),
    "whole.covariance": ([], [[0.0] * 18] * 17, [[_NAN] * 18] * 18, "x"),
    "whole.high_mm": ([0.0, _INF, 0.0],),
    "local.low_mm": ([0.0, 0.0], {"x": 1}),
    "local.residual_covariance_mm2": ([[1.0]],),
    "local.uncorrected_covariance_mm2": (0.0,),
    "local.correction": (3,),
    "local.correction.orders": ([1, 1], ["x", 1, 1]),
    "local.correction.low_mm": ([0.0],),
    "local.correction.fade_mm": ("x",),
    "local.correction.coefficients_mm": ([[1.0, 2.0, 3.0]],),
}
#: Numbers of the right type that make no sense.
SENSELESS: dict[str, tuple[Any, ...]] = {
    "calibration.region_half_width_mm": (_NAN, _INF, -10.0),
    "calibration.blend_mm": (_NAN, -1.0),
    "whole.rows": (_INF,),
    "whole.low_mm": ([30.0, 30.0, 30.0],),
    "whole.residual_covariance_mm2": ((-np.eye(3)).tolist(),),
    "local.correction.orders": ([-1, 1, 0],),
    "local.correction.low_mm": ([_NAN, -14.0, -_INF], [14.0, -14.0, -_INF]),
    "local.correction.high_mm": ([_INF, 14.0, _INF],),
    "local.correction.fade_mm": (_NAN, -4.0),
    "local.correction.coefficients_mm": ([[_NAN] * 3] * 4, [[_INF] * 3] * 4),
}


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, values in WRONG.items() for value in values])
def test_wrong_value_is_named(tables: dict[str, Any], key: str, value: Any, tmp_path: Path) -> None:
    """Catches wrong counts, types and impossible robots that load, or are refused without file and key, as 'float'
    object is not subscriptable."""
    assert key.rsplit(".", 1)[-1] in broken(tables, key, value, tmp_path / "bad.toml")


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, values in SENSELESS.items() for value in values])
def test_senseless_number_is_refused(tables: dict[str, Any], key: str, value: Any, tmp_path: Path) -> None:
    """Catches a file that loads and then gives NaN, or a wrong place, as a position."""
    broken(tables, key, value, tmp_path / "bad.toml")


@pytest.mark.parametrize("name", ["rail_lean.radial_9", "rail_lean.tangential_1", "beam_alignment.x_by_x"])
def test_wrong_parameter_of_an_effect_is_refused(name: str, tmp_path: Path) -> None:
    """Catches a value that is given to another parameter than the file says."""
    DeltaCalibration(EXAMPLE, made(0, effects=EFFECTS).whole).save(tmp_path / "good.toml")
    tables = tomllib.loads((tmp_path / "good.toml").read_text())
    parameters = tables["whole"]["parameters"]
    place = [p["name"] for p in parameters].index("rail_lean.radial_1")
    parameters[place]["name"] = name
    broken(tables, "whole.parameters", parameters, tmp_path / "bad.toml")


def test_wrong_parameters_are_named(tables: dict[str, Any], tmp_path: Path) -> None:
    """Catches a parameter that is misspelt, given twice, or without its value."""
    for change, words in (
        ({"name": "rod_lenght_1"}, "'rod_lenght_1' is not a parameter of this robot; did you mean 'rod_length_1'"),
        ({"name": "sensor_shift_x"}, "freed twice"),
        ({"value": _NAN}, "parameters"),
    ):
        parameters = copy.deepcopy(tables["whole"]["parameters"])
        parameters[3] |= change
        assert words in broken(tables, "whole.parameters", parameters, tmp_path / "bad.toml")
    del parameters[3]["value"]
    assert "value is missing" in broken(tables, "whole.parameters", parameters, tmp_path / "bad.toml")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is not a calibration"),
        (b"kind = 'delta'", "is not a calibration"),
        (b"[calibration", "is not valid TOML"),
        (b"\xff\xfe", "is not a text file"),
        (b"calibration = 1", "is not a calibration"),
    ],
)
def test_other_files_are_refused(content: bytes, words: str, tmp_path: Path) -> None:
    """Catches a traceback where somebody gives the wrong file."""
    path = tmp_path / "other.toml"
    path.write_bytes(content)
    with pytest.raises(CalibrationError, match=words) as caught:
        DeltaCalibration.load(path)
    assert str(path) in str(caught.value)


def test_missing_file_and_folder_are_refused(tmp_path: Path) -> None:
    """Catches an OSError that reaches the user."""
    for path in (tmp_path / "nothing.toml", tmp_path):
        with pytest.raises(CalibrationError, match=r"there is no such calibration file|is a folder") as caught:
            DeltaCalibration.load(path)
        assert str(path) in str(caught.value)
