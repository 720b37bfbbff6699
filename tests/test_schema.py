"""JSON schemas of files: what the readers take is what the schemas hold."""

from __future__ import annotations

import contextlib
import io
import json
import random
import tomllib
import warnings
from pathlib import Path
from typing import Any

import pytest

import sherkit as sk
from laboratories import SPHERICAL, experiment, laboratory, spherical_laboratory
from mutations import damaged_tree, plain
from sherkit.cli import main
from sherkit.cli.demo import EXAMPLE
from sherkit.lab.emulators import FAULTS
from sherkit.robots.tool.tool import FlexibleTool
from test_fuzz import toml


@pytest.fixture(scope="module")
def schemas() -> dict[str, Any]:
    out = {}
    for file in ("robot", "experiment", "laboratory"):
        said = io.StringIO()
        with contextlib.redirect_stdout(said), pytest.raises(SystemExit) as ended:
            main(["schema", file])
        assert ended.value.code == 0
        out[file] = json.loads(said.getvalue())
    return out


def fits(value: Any, schema: dict[str, Any]) -> bool:
    """Whether a value is what a schema describes: the words that these schemas use."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    kinds = {
        "object": isinstance(value, dict), "array": isinstance(value, list), "string": isinstance(value, str),
        "number": number, "integer": number and isinstance(value, int), "boolean": isinstance(value, bool),
    }  # fmt: skip
    if "oneOf" in schema:
        return sum(fits(value, one) for one in schema["oneOf"]) == 1
    if not kinds.get(schema.get("type", ""), True) or ("const" in schema and value != schema["const"]):
        return False
    if "enum" in schema and value not in schema["enum"]:
        return False
    if number and not (schema.get("minimum", value) <= value <= schema.get("maximum", value)):
        return False
    if number and "exclusiveMinimum" in schema and not value > schema["exclusiveMinimum"]:
        return False
    if isinstance(value, list):
        count = schema.get("minItems", len(value)) <= len(value) <= schema.get("maxItems", len(value))
        return count and all(fits(v, schema.get("items", {})) for v in value)
    if isinstance(value, dict):
        known, more = schema.get("properties", {}), schema.get("additionalProperties", True)
        if set(schema.get("required", ())) - set(value) or (more is False and set(value) - set(known)):
            return False
        return all(fits(v, known.get(k, more if isinstance(more, dict) else {})) for k, v in value.items())
    return True


def files(folder: Path) -> list[tuple[str, dict[str, Any]]]:
    """Files that are read, of each sort."""
    made: list[tuple[str, Any]] = [
        ("robot", EXAMPLE.to_tables()), ("robot", SPHERICAL), ("robot", FlexibleTool().to_tables()),
        ("robot", EXAMPLE.to_tables() | {"columns": {"q1_mm": "Enc1"}}),
    ]  # fmt: skip
    for name in ("delta", "seen"):
        (folder / name).mkdir()
    lab = laboratory(folder / "delta", tool={"depth_mm": 5.0})
    planned = experiment(folder / "delta", goal={"std_um": 5.0}, lasers={"outputs": [1, 2, 3], "unit": "um"})
    seen = spherical_laboratory(folder / "seen", faults={next(iter(FAULTS)): 0.1})
    made += [("laboratory", lab), ("experiment", planned), ("laboratory", seen)]
    made += [("experiment", folder / "seen" / "experiment.toml")]
    return [(k, tomllib.loads(v.read_text()) if isinstance(v, Path) else plain(v)) for k, v in made]


def test_what_is_read_fits(schemas: dict[str, Any], tmp_path: Path) -> None:
    """Catches a key that a reader takes and an editor would mark as wrong."""
    for kind, tables in files(tmp_path):
        assert fits(json.loads(json.dumps(tables)), schemas[kind]), (kind, tables)


def test_what_is_refused_by_its_shape_does_not_fit(schemas: dict[str, Any], tmp_path: Path) -> None:
    """Catches a schema that lets anything through: most slips of a finger in a robot file are seen by it."""
    rng, caught, refused = random.Random(1), 0, 0
    path = tmp_path / "robot.toml"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(300):
            with contextlib.suppress(ValueError, TypeError, OverflowError):
                tables = plain(damaged_tree(EXAMPLE.to_tables(), rng))
                path.write_bytes(toml(tables))
                fitting = fits(tables, schemas["robot"])
                try:
                    sk.load_robot(path)
                except sk.SherkitError:
                    refused += 1
                    caught += not fitting
                else:
                    assert fitting, tables
    assert refused > 100
    assert caught > 0.8 * refused


def test_where_the_sensor_stands_can_be_completed(schemas: dict[str, dict[str, Any]]) -> None:
    """Catches a table that every file may leave out, and of which an editor therefore knows no key."""
    found = {one["properties"]["kind"]["const"]: one["properties"] for one in schemas["robot"]["oneOf"]}
    for kind in ("delta", "serial", "spherical"):
        keys = set(found[kind]["sensor_pose"]["properties"])
        own = set() if kind == "spherical" else {"origin_mm", "rpy_deg"}
        assert keys == {"free", "shift_sd_mm", "turn_sd_deg"} | own
