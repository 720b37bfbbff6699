"""Answers that are kept: a dozen worlds are asked again here, all of them by ``make golden``."""

from __future__ import annotations

import pytest

import golden
from golden_worlds import WORLDS

#: One of each kind that takes a second at the most.
ASKED = (
    "delta, nothing hidden, 0", "spherical, nothing hidden, 1", "contradiction, one pose wrong by metres",
    "delta, rail_lean", "delta, zeros of its own, thermal_growth", "spherical, backlash",
    "delta, no catalogue, humidity", "delta, mistake, joint 1 counted downwards", "arm, nothing hidden",
    "gantry, drift", "printer, none", "real, FLSUN V400", "tool, nothing hidden",
)  # fmt: skip
#: Of these, what takes longest.
LONGEST = (
    "delta, zeros of its own, thermal_growth", "delta, no catalogue, humidity", "gantry, drift", "tool, nothing hidden",
)  # fmt: skip
#: Another processor rounds otherwise, and a fit ends where it no longer falls.
WITHIN = 1e-3


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONGEST)) for name in ASKED])
def test_the_answer_is_that_on_file(name: str) -> None:
    """Catches a change of an answer that nobody named: ``make golden`` says what differs."""
    assert list(golden.differences(golden.kept()[name], golden.asked(name)[1], WITHIN)) == []


def test_every_world_has_its_answer_on_file() -> None:
    """Catches a world that is compared with nothing, and an answer whose world is gone."""
    assert list(golden.kept()) == list(WORLDS)
    assert len(WORLDS) >= 200


def test_what_differs_is_said() -> None:
    """Catches a comparison that passes another verdict, an effect less, or another size."""
    kept = {"verdict": "explained", "effects": ["drift"], "sizes": {"rate_x": 0.1}, "noise": {"x": 5.0}}
    assert list(golden.differences(kept, kept | {"noise": {"x": 5.0001}})) == []
    assert len(list(golden.differences(kept, kept | {"verdict": "adequate"}))) == 1
    assert len(list(golden.differences(kept, kept | {"effects": []}))) == 1
    assert list(golden.differences(kept, kept | {"sizes": {"rate_x": 0.2}})) == ["sizes rate_x: 0.1 → 0.2"]
    assert len(list(golden.differences(kept, {"refused": "no rows"}))) == 5
