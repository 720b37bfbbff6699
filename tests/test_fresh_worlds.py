"""Worlds that nobody has seen: that they are what they say, and what no answer to one of them may be. The counts are
scripts, ``fresh_worlds.py`` and ``level_of_noise.py``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import sherkit as sk
from consistency import PRAISED, consistent
from fresh_scenes import SUITES, Fresh, read, scene_of, written
from fresh_worlds import answered, asks_of, in_words, missed, table_of
from level_of_noise import Heard, at_most, heard
from level_of_noise import table_of as table_of_noise
from second_machines import apart
from second_simulator.more_unnamed import MORE_KINDS, preisach, stops_short
from second_simulator.unnamed import Kind, Scene

#: A world of each suite in which all joints move.
MOVING = {"delta": 100_000, "sphere": 100_001, "arm": 100_002, "machine": 100_003}
#: Whose diagnosis takes longest: their rows leave most to be described.
LONG = {"bumps", "bad_stretch", "preisach", "stops_short", "heat_of_motors"}


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    """What machines make known is forgotten."""
    with apart():
        yield


def _moving(to: list[float]) -> Scene:
    """A robot of one joint whose readings are its joint, going there."""
    at = np.array(to)[:, None]
    rows = len(to)
    return Scene(
        np.random.default_rng(3), np.arange(rows, dtype=float), np.full(rows, 20.0), np.full(rows, 45.0), at,
        np.zeros((rows, 3)), at, np.ones((rows, 1, 1)), np.zeros((rows, 1, 3)),
    )  # fmt: skip


# -- the worlds ----------------------------------------------------------------------------------------------------


def test_relays_remember_the_way_and_close_their_loops() -> None:
    """Catches a hysteresis that is a function of the place, or of the last direction alone, and one whose minor loops
    do not close: by Preisach's model the value comes back with the turning point."""
    error = preisach(_moving([-1.0, 1.0, 0.0, 0.6, 0.0, -1.0, 0.0, 1.0])).ravel()
    down, again, up = error[2], error[4], error[6]
    assert again == pytest.approx(down)  # a loop from 0 to 0.6 and back was wiped out
    assert error[7] == pytest.approx(error[1])
    assert up < down - 0.05 * np.ptp(error)  # the same place, come to from below
    # the same place and the same last direction, after another turning point
    assert preisach(_moving([-1.0, 1.0, 0.0])).ravel()[2] > preisach(_moving([-1.0, 0.2, 0.0, 1.0])).ravel()[2]


def test_a_joint_stops_before_it_is_there() -> None:
    """Catches a joint that goes too far, one that is short by the same after any move, and one that errs at rest."""
    error = stops_short(_moving([0.0, 0.1, 0.1, 1.0, 0.9, 0.0])).ravel()
    assert error[2] == 0.0
    assert error[3] < error[1] < 0.0 < error[4] < error[5]


@pytest.mark.parametrize("suite", SUITES)
def test_what_is_hidden_is_as_large_as_told_there_and_elsewhere(suite: str) -> None:
    """Catches a machine that is another one at the other poses: with nothing hidden a fit is right there, and of a
    stretch of a scale that is bad at five times the noise it is off by about as much as at the first."""
    world = Fresh(suite, MOVING[suite], {})
    assert world.error(sk.identify(world.robot, world.run())) < 0.5
    world = Fresh(suite, MOVING[suite], {"bad_stretch": 5.0})
    fit = sk.identify(world.robot, world.run())
    left = float(np.sqrt(np.nanmean(np.square(fit.residuals)))) / world.noise
    assert left == pytest.approx(np.hypot(5.0, 1.0), rel=0.15)
    assert 2.5 < world.error(fit) < 10.0


@pytest.mark.parametrize("kind", MORE_KINDS)
def test_a_kind_is_of_the_scene_alone(kind: Kind) -> None:
    """Catches a kind that draws from elsewhere than its scene, or leaves a row without a number."""
    scene, _ = scene_of(Fresh("sphere", MOVING["sphere"], {}).standing)
    one, other = (kind(replace(scene, rng=np.random.default_rng(5))) for _ in range(2))
    assert np.array_equal(one, other)
    assert np.isfinite(one).all()
    assert np.ptp(one) > 0.0


def test_a_world_is_told_in_one_word() -> None:
    """Catches a world that is listed as a miss and is another one when it is asked again."""
    for hidden in asks_of("delta", MOVING["delta"]).values():
        assert read(written(hidden)) == hidden


# -- the answers ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=[pytest.mark.slow] * (k.__name__ in LONG), id=k.__name__) for k in MORE_KINDS]
)
def test_physics_of_no_catalogue_is_not_praised(kind: Kind) -> None:
    """Catches a verdict of praise over an error that is five times the noise, for each of six kinds on one delta."""
    world = Fresh("delta", MOVING["delta"], {kind.__name__: 5.0})
    d = sk.diagnose(world.robot, world.run())
    consistent(d)
    assert d.verdict not in PRAISED


def test_a_lie_is_counted_as_one() -> None:
    """Catches a count that never counts: an answer of praise that is off elsewhere, an innocent, a name that is
    lost."""
    told = answered("delta", MOVING["delta"], "one at 5", {"drift": 5.0})
    assert told["right"]
    assert not told["lie"]
    assert told["noises"] < 1.25
    assert missed(told) is None
    lie = told | {"lie": True, "noises": 3.0, "innocents": ["slip"], "takes": [0.05], "right": False, "as_well": False}
    assert "LIE; innocent slip (takes 0.05); not found" in in_words(lie)
    lines = table_of([told, lie]).splitlines()
    assert [line.split()[-1] for line in lines if line.startswith(("one effect at 5 x", "... lies"))] == ["1/2", "1/2"]


def test_alarms_are_counted_with_their_bound() -> None:
    """Catches a bound that is not that of Clopper and Pearson: three in a thousand for none of a thousand."""
    assert at_most(0, 1000) == pytest.approx(1 - 0.05 ** (1 / 1000))
    assert at_most(3, 3) == 1.0
    one = heard(("delta", "normal", 4))
    assert not one.alarm
    blamed = Heard("delta", "normal", 5, "explained", ("drift",), "", 1.0)
    assert "1/2" in table_of_noise([one, blamed])
