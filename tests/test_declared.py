"""Classes that declare their files: what is written is read, and what is wrong is said as by any reader."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import pytest

from sherkit.data.declared import AskedTable, Declared, Inner, key, keys_from, keys_of
from sherkit.data.toml import Table
from sherkit.errors import RobotError


@dataclass(frozen=True)
class Lens:
    """Reads and writes its table by its keys."""

    focal_mm: float

    @classmethod
    def from_table(cls, table: Table) -> Lens:
        return cls(**keys_from(table, LENS, cls))

    def to_table(self) -> dict[str, Any]:
        return keys_of(self, LENS)


LENS = {"focal_mm": key(Table.number, positive=True)}


@dataclass(frozen=True)
class Stage(Declared):
    """One of each: a needed key, one with a default, a quiet one, elements, a table of its own."""

    travel_mm: tuple[float, float]
    home_mm: float = 1.0
    mode: str = "slow"
    gains: tuple[tuple[float, ...], tuple[float, ...]] = ((1.0, 2.0), (3.0, 4.0))
    limit_mm: float | None = None
    lens: Lens | None = None
    kind: str = field(default="stage", init=False)

    TABLES: ClassVar = {
        "geometry": {"travel": key(Table.numbers, 2).of("travel_mm"), "home_mm": key(Table.number).needed},
        "drive": {
            "mode": key(Table.text, ("slow", "fast")).quiet,
            "gain_x": key(Table.numbers, 2).of("gains", 0),
            "gain_y": key(Table.numbers, 2).of("gains", 1),
        },
        "limits": {"limit_mm": key(Table.positive)},
        "lens": Inner(Lens, "lens"),
    }

    @classmethod
    def check(cls, name: str, table: Table, values: Mapping[str, Any]) -> None:
        if name == "drive" and values["mode"] == "fast" and values["home_mm"] > 5.0:
            raise table.fail("mode", "'slow' so far from the middle")


STAGE = Stage((1.0, 2.0))


def read(tables: dict[str, Any]) -> Stage:
    """The stage of these tables."""
    table = Table({k: v for k, v in tables.items() if k != "kind"}, "stage.toml")
    made = Stage.from_table(table)
    table.finish()
    return made


@pytest.mark.parametrize(
    "change", [{}, {"mode": "fast"}, {"gains": ((0.5, 2.0), (3.0, 1.0 / 3.0))}, {"limit_mm": 3.0}, {"lens": Lens(8.0)}]
)
def test_what_is_written_is_read(change: dict[str, Any]) -> None:
    """Catches a key that is written and not read, or forgotten."""
    made = replace(STAGE, **change)
    assert read(made.to_tables()) == made


def test_what_the_class_has_is_quiet_or_left_out() -> None:
    """Catches a file full of nothing, and a default that only the writer knows."""
    assert STAGE.to_tables() == {
        "kind": "stage",
        "geometry": {"travel": [1.0, 2.0], "home_mm": 1.0},
        "drive": {"gain_x": [1.0, 2.0], "gain_y": [3.0, 4.0]},
    }
    assert read({"geometry": {"travel": [1, 2], "home_mm": 1}, "drive": {"gain_y": [3, 4]}}) == STAGE


@pytest.mark.parametrize(
    ("table", "values", "says"),
    [
        ("geometry", {"travel": [1.0, 2.0]}, "[geometry] home_mm is missing; expected a number"),
        ("drive", {"gainx": [1.0, 2.0]}, "unknown key [drive] gainx; did you mean 'gain_x'?"),
        ("lense", {"focal_mm": 8.0}, "unknown key lense; did you mean 'lens'?"),
        ("lens", {}, "[lens] focal_mm is missing; expected a positive number"),
        ("drive", {"mode": "fast"}, "[drive] mode: expected 'slow' so far from the middle, found 'fast'"),
    ],
)
def test_what_is_wrong_is_said(table: str, values: dict[str, Any], says: str) -> None:
    """Catches a declaration that reads what nobody meant, or does not say where."""
    far = {"geometry": {"travel": [1.0, 2.0], "home_mm": 9.0}}
    with pytest.raises(RobotError) as refused:
        read({**far, table: values})
    assert str(refused.value) == f"stage.toml: {says}"


def test_a_schema_asks_for_what_is_needed() -> None:
    """Catches a schema in which what may be left out is needed, or the reverse."""
    table = AskedTable({}, "an example")
    Stage.from_table(table)
    made = table.schema()
    assert made["required"] == ["geometry"]
    assert made["properties"]["geometry"]["required"] == ["home_mm", "travel"]
    assert "required" not in made["properties"]["drive"]
    assert made["properties"]["limits"]["properties"]["limit_mm"]["exclusiveMinimum"] == 0
