"""Robot files: what is right is read without loss, what is wrong is refused by file, table and key."""

from __future__ import annotations

import copy
import math
import re
import subprocess
import sys
import tomllib
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import hypothesis.strategies as st
import pytest
import tomli_w
from hypothesis import given

from bad_inputs import PAGE
from second_simulator import write_robot_toml
from sherkit import SherkitWarning, load_robot, save_robot
from sherkit.errors import RobotError
from sherkit.model import kinds
from sherkit.model.kinds import robot_from_tables
from sherkit.robots.delta import Delta
from sherkit.robots.machine.described import MachineDescription
from strategies import EXAMPLE, between, deltas

TEXT = """\
kind = "delta"

[geometry]
base_radius_mm = [90, 90, 90]
base_angle_deg = [90, 210, 330]
platform_radius_mm = [30, 30.0, 3e1]
platform_angle_deg = [90, 210, 330]
rod_length_mm = [120, 120, 120]
rod_spacing_mm = 40.0
target_offset_mm = [0, 0, -25]

[joints]
pole_pitch_mm = 2.0

[workspace]
radius_mm = 30.0
z_mm = [-22, 22]

[region_of_interest]
half_width_mm = 10.0
"""
TABLES = tomllib.loads(TEXT)
KEYS = [(table, key) for table, values in TABLES.items() if table != "kind" for key in values]
LISTS = [(table, key) for table, key in KEYS if isinstance(TABLES[table][key], list)]
REQUIRED = [
    ("geometry", f"{key}")
    for key in ("base_radius_mm", "base_angle_deg", "platform_radius_mm", "platform_angle_deg", "rod_length_mm")
]
NOT_NEGATIVE = [
    ("geometry", "base_radius_mm"),
    ("geometry", "platform_radius_mm"),
    ("geometry", "rod_length_mm"),
    ("geometry", "rod_spacing_mm"),
]
NAME = "delta.toml"


def saved(folder: Path, tables: dict[str, Any] | str | bytes) -> Path:
    """A robot file in ``folder``."""
    path = folder / NAME
    text = tomli_w.dumps(tables) if isinstance(tables, dict) else tables
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def changed(table: str, key: str, value: Any = None, *, name: str | None = None) -> dict[str, Any]:
    """The example with a value changed, a key renamed, or (both None) a key left out."""
    tables = copy.deepcopy(TABLES)
    old = tables[table].pop(key)
    if name is not None:
        tables[table][name] = old
    elif value is not None:
        tables[table][key] = value
    return tables


def refusal(folder: Path, tables: dict[str, Any] | str | bytes) -> str:
    """What sherkit says to a bad file: one line that starts with its name."""
    path = saved(folder, tables)
    with pytest.raises(RobotError) as refused:
        load_robot(path)
    message = str(refused.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message.removeprefix(f"{path}: ")


# -- reading and writing -------------------------------------------------------------------------------------


def test_the_example_is_read(tmp_path: Path) -> None:
    """Catches a key read into the wrong field; whole numbers are numbers as well."""
    assert load_robot(saved(tmp_path, TEXT)) == EXAMPLE
    assert load_robot(str(saved(tmp_path, TEXT))) == EXAMPLE


def test_the_second_simulator_means_the_same_robot(tmp_path: Path) -> None:
    """Catches a change of the file's layout that an independent writer of it would not follow."""
    write_robot_toml(tmp_path / NAME)
    assert load_robot(tmp_path / NAME) == EXAMPLE


def test_the_readme_shows_the_example(tmp_path: Path) -> None:
    """Catches a page whose robot file is refused."""
    shown = re.search(r"```toml\n(kind = .*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert load_robot(saved(tmp_path, shown[1])) == replace(EXAMPLE, required_um=20.0)


def test_windows_files_are_read(tmp_path: Path) -> None:
    """Catches a byte order mark or carriage returns refused as broken TOML."""
    assert load_robot(saved(tmp_path, TEXT.replace("\n", "\r\n").encode("utf-8-sig"))) == EXAMPLE


@pytest.mark.filterwarnings("ignore:.* is left out:sherkit.SherkitWarning")
@given(data=st.data())
def test_round_trip_is_lossless(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Catches a field that ``save_robot`` forgets or rounds."""
    length = between(1e-3, 1e3)
    robot = replace(
        data.draw(deltas()),
        rod_spacing_mm=data.draw(st.none() | between(0.0, 100.0)),
        pole_pitch_mm=data.draw(st.none() | st.just(0.0) | length),
        workspace_radius_mm=data.draw(st.none() | length),
        workspace_z_mm=data.draw(st.none() | st.tuples(between(-100.0, -1e-3), between(0.0, 100.0))),
        region_half_width_mm=data.draw(st.none() | length),
        required_um=data.draw(st.none() | length),
    )
    path = tmp_path_factory.getbasetemp() / NAME
    save_robot(robot, path)
    assert load_robot(path) == robot


def test_what_may_be_left_out(tmp_path: Path) -> None:
    """Catches an optional table that has become required, and a default that is not the documented one."""
    tables = {"kind": "delta", "geometry": {key: TABLES["geometry"][key] for _, key in REQUIRED}}
    with pytest.warns(SherkitWarning, match="is left out"):
        robot = load_robot(saved(tmp_path, tables))
    assert robot == Delta(
        base_radius_mm=(90.0, 90.0, 90.0),
        base_angle_deg=(90.0, 210.0, 330.0),
        platform_radius_mm=(30.0, 30.0, 30.0),
        platform_angle_deg=(90.0, 210.0, 330.0),
        rod_length_mm=(120.0, 120.0, 120.0),
    )


@pytest.mark.parametrize(
    ("table", "key", "says"),
    [
        ("geometry", "rod_spacing_mm", "rods of unequal length (rod_mismatch) cannot be tried"),
        ("joints", "pole_pitch_mm", "the period of the encoders' cyclic error (encoder_cyclic) is searched for"),
    ],
)
def test_a_setting_that_is_left_out_is_asked_for(table: str, key: str, says: str, tmp_path: Path) -> None:
    """Catches an effect that cannot be tried, or a period that nobody gave, in silence; and nagging who has none."""
    path = saved(tmp_path, changed(table, key))
    with pytest.warns(SherkitWarning) as heard:
        robot = load_robot(path)
    assert len(heard) == 1
    said = str(heard[0].message)
    assert said.startswith(f"{path}: [{table}] {key} is left out: {says}")
    assert f"{key} = 0" in said
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert getattr(load_robot(saved(tmp_path, changed(table, key, 0))), key) == 0.0
        robot_from_tables(robot.to_tables(), "made in Python")
    save_robot(robot, path)
    with pytest.warns(SherkitWarning, match=f"{key} is left out"):
        assert load_robot(path) == robot


@pytest.mark.slow
def test_settings_are_asked_for_in_plain_lines(tmp_path: Path) -> None:
    """Catches a warning that the command prints with a path of the library, in more than a line, or not at all."""
    path = saved(tmp_path, {"kind": "delta", "geometry": {key: TABLES["geometry"][key] for _, key in REQUIRED}})
    made = subprocess.run(
        [sys.executable, "-c", "from sherkit.cli import main; main()", "effects", "--robot", str(path)],
        capture_output=True, text=True, encoding="utf-8", check=True,
    )  # fmt: skip
    lines = made.stderr.splitlines()
    assert [line.split(" is left out")[0] for line in lines] == [
        f"warning: {path}: [geometry] rod_spacing_mm", f"warning: {path}: [joints] pole_pitch_mm",
    ]  # fmt: skip


# -- keys ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("table", "key"), REQUIRED)
def test_missing_keys_are_named(table: str, key: str, tmp_path: Path) -> None:
    """Catches a missing key taken for zero, and another right key of the table suggested in its place."""
    message = refusal(tmp_path, changed(table, key))
    assert message.startswith(f"[{table}] {key} is missing; expected 3 ")
    assert "meant" not in message


@pytest.mark.parametrize(("table", "key"), KEYS)
@pytest.mark.parametrize("slip", [lambda k: k[:-1], lambda k: k.replace("_", ""), lambda k: k[1] + k[0] + k[2:]])
def test_misspelt_keys_are_named_with_the_right_one(table: str, key: str, slip: Any, tmp_path: Path) -> None:
    """Catches an optional key that is ignored because of a slip, and a message that leaves the slip to be found."""
    message = refusal(tmp_path, changed(table, key, name=slip(key)))
    assert f"[{table}] " in message
    assert f"'{key}'" in message or f" {key} is missing" in message
    assert slip(key) in message


@pytest.mark.parametrize("table", ["geometry", "joints", "workspace", "region_of_interest"])
def test_unknown_keys_are_refused(table: str, tmp_path: Path) -> None:
    """Catches keys that are read by nobody and silently dropped."""
    tables = copy.deepcopy(TABLES)
    tables[table]["xyzzy"] = 1.0
    message = refusal(tmp_path, tables)
    assert message.startswith(f"unknown key [{table}] xyzzy; known keys: ")
    assert all(key in message for key in TABLES[table])


@pytest.mark.parametrize(("table", "key"), KEYS)
@pytest.mark.parametrize(
    "value", ["90", True, {"a": 1.0}, math.nan, math.inf, 10**400, [], [True, True, True]], ids=lambda v: repr(v)[:12]
)
def test_values_of_the_wrong_kind_are_refused(table: str, key: str, value: Any, tmp_path: Path) -> None:
    """Catches text, truth values, NaN, infinity and endless integers taken for lengths."""
    message = refusal(tmp_path, changed(table, key, value))
    assert message.startswith(f"[{table}] {key}: expected ")
    assert ", found " in message
    assert len(message) < 250


@pytest.mark.parametrize(("table", "key"), LISTS)
@pytest.mark.parametrize(
    "change", [lambda v: v[:-1], lambda v: [*v, 1.0], lambda v: [math.nan, *v[1:]], lambda v: v[0]]
)
def test_lists_need_their_numbers(table: str, key: str, change: Any, tmp_path: Path) -> None:
    """Catches a limb left out, or one too many, or a NaN among good numbers."""
    message = refusal(tmp_path, changed(table, key, change(TABLES[table][key])))
    count = len(TABLES[table][key])
    such = r"(, one for each, such as \[.+\]|, the lower first)?"
    assert re.match(rf"\[{table}\] {key}: expected ({count}|two) (positive )?numbers{such}, found ", message)


@pytest.mark.parametrize(("table", "key"), NOT_NEGATIVE)
def test_lengths_below_zero_are_refused(table: str, key: str, tmp_path: Path) -> None:
    """Catches a sign slip in a length."""
    value = TABLES[table][key]
    negative = [*value[:-1], -value[-1]] if isinstance(value, list) else -value
    assert refusal(tmp_path, changed(table, key, negative)).startswith(f"[{table}] {key}: expected ")


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        ("joints", "pole_pitch_mm", -1.0),
        *((table, key, value) for table, key in (("workspace", "radius_mm"), ("region_of_interest", "half_width_mm"))
          for value in (-1.0, 0.0)),
    ],
)  # fmt: skip
def test_optional_lengths_must_be_positive(table: str, key: str, value: float, tmp_path: Path) -> None:
    """Catches a region of interest of negative width, and a zero silently taken for "not given"."""
    assert refusal(tmp_path, changed(table, key, value)).startswith(f"[{table}] {key}: expected ")


def test_heights_must_be_in_order(tmp_path: Path) -> None:
    """Catches a workspace upside down."""
    assert refusal(tmp_path, changed("workspace", "z_mm", [22, -22])).startswith(
        "[workspace] z_mm: expected two numbers"
    )


# -- tables and files ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("table", ["geometry", "joints", "workspace", "region_of_interest"])
def test_tables_are_tables(table: str, tmp_path: Path) -> None:
    """Catches a table misspelt, or a value in its place, that is silently passed over."""
    tables = copy.deepcopy(TABLES)
    slip = table[:3] + table[4:]
    tables[slip] = tables.pop(table)
    message = refusal(tmp_path, tables)
    assert table in message
    assert slip in message
    message = refusal(tmp_path, {**TABLES, table: 3.0})
    assert message.startswith(f"{table}: expected a table [{table}], found 3.0")


@pytest.mark.parametrize(
    ("tables", "says"),
    [
        ({"geometry": TABLES["geometry"]}, "kind is missing; expected one of 'delta', 'spherical', 'serial'"),
        ({**TABLES, "kind": "scara"}, "kind: expected one of 'delta', 'spherical', 'serial', 'printer', found 'scara'"),
        (
            {**TABLES, "kind": ["delta"]},
            "kind: expected one of 'delta', 'spherical', 'serial', 'printer', found ['delta']",
        ),
        ({"kind": "delta"}, "geometry is missing; expected a table"),
        ({**TABLES, "tool": {}}, "unknown key tool"),
        ({**TABLES, "kind": ""}, "kind: expected one of 'delta', 'spherical', 'serial', 'printer', found ''"),
        ({}, "kind is missing"),
        ("", "kind is missing"),
        ("kind = delta", "is not valid TOML: Invalid value (at line 1"),
        (TEXT + "[geometry]\n", "is not valid TOML"),
        (TEXT.replace("delta", "dälta").encode("latin-1"), "is not a text file"),
        (b"\x89PNG\r\n\x1a\n\x00\xff", "is not a text file"),
    ],
)
def test_other_files_are_refused(tables: Any, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a file of another robot, another program or another encoding that ends in a traceback."""
    # machines that other tests made known are named, too
    built_in = {
        name: kind for name, kind in kinds.known_kinds().items() if not isinstance(kind.robot, MachineDescription)
    }
    monkeypatch.setattr(kinds, "KINDS", built_in)
    assert says in refusal(tmp_path, tables)


def test_files_that_cannot_be_opened(tmp_path: Path) -> None:
    """Catches an OSError where a name is wrong."""
    with pytest.raises(RobotError, match=r"other\.toml: there is no such robot file"):
        load_robot(tmp_path / "other.toml")
    with pytest.raises(RobotError, match="is a folder, expected a robot TOML file"):
        load_robot(tmp_path)


# -- no robots -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("limb", "length"), [(1, 60.0), (2, 59.9), (3, 0.001)])
def test_rods_must_span_their_gap(limb: int, length: float, tmp_path: Path) -> None:
    """Catches a rod too short to be mounted, and the wrong limb blamed for it."""
    rods = [120.0, 120.0, 120.0]
    rods[limb - 1] = length
    message = refusal(tmp_path, changed("geometry", "rod_length_mm", rods))
    assert message.startswith(f"[geometry] rod_length_mm: expected rod {limb} longer than 60.000 mm")


def test_a_rod_spans_from_its_own_angle(tmp_path: Path) -> None:
    """Catches a check of rod lengths by radii alone: turned by 180°, the same radii are 120 mm apart."""
    turned = changed("geometry", "platform_angle_deg", [270, 210, 330])
    assert "expected rod 1 longer than 120.000 mm" in refusal(tmp_path, turned)


@pytest.mark.parametrize(
    ("key", "value"),
    [("platform_radius_mm", [90, 90, 90]), ("base_angle_deg", [90, 90, 330])],
    ids=["upright", "twins"],
)
def test_geometries_that_never_are_robots_are_refused(key: str, value: list[float], tmp_path: Path) -> None:
    """Catches three parallel rods, or two limbs in one place: no position is fixed by the joints."""
    tables = changed("geometry", key, value)
    tables["geometry"][key.replace("base", "platform")] = value
    assert "geometry" in refusal(tmp_path, tables)
