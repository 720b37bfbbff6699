"""Effects found again where nothing is counted from where the drawing has its origin: measured point and readings have
zeros of their own, within 50 mm."""

from __future__ import annotations

from itertools import combinations

import pytest
from scipy import stats

import sherkit as sk
from running import slow
from second_simulator import CATALOGUE
from zeros import counted_from_anywhere

EFFECTS = tuple(name for name in CATALOGUE if name not in ("datum", "sensor_pose"))
#: Chance with which a correct program fails one of the counts below.
RARE = 1e-3


def named(*effects: str, seed: int, ratio: float = 2.0) -> bool:
    """Whether all of them lead, or are tied with what does."""
    d = sk.diagnose(*counted_from_anywhere(seed, dict.fromkeys(effects, ratio)))
    return set(effects) <= set(d.effects).union(*d.indistinguishable)


@pytest.mark.parametrize("seed", [3, *slow(2, 4, 5)])
def test_a_sensor_that_bends_about_its_own_zero_is_found(seed: int) -> None:
    """Catches a cubic that is counted from the origin of the robot's frame: three of these four were unexplained then,
    at twice the noise."""
    assert named("sensor_linearity", seed=seed)


@pytest.mark.slow
def test_each_effect_is_found_in_98_of_100() -> None:
    """Catches an effect that is found only where frame and readings have one zero. Seeds 0 to 5 of each, at 1, 2 and 5
    times the noise, binomial allowance of 1 in 1,000."""
    missed = [(n, s, r) for n in EFFECTS for s in range(6) for r in (1, 2, 5) if not named(n, seed=s, ratio=r)]
    assert len(missed) <= stats.binom.isf(RARE, 18 * len(EFFECTS), 0.02), missed


@pytest.mark.slow
def test_pairs_are_named_in_95_of_100() -> None:
    """Catches the same in pairs: all, twice the noise each, a seed of its own; those with a bent sensor three times."""
    every = [(pair, k) for k, pair in enumerate(combinations(EFFECTS, 2))]
    every += [(pair, k + s) for pair, k in every for s in (1000, 2000) if "sensor_linearity" in pair]
    missed = [(pair, seed) for pair, seed in every if not named(*pair, seed=seed)]
    assert len(missed) <= stats.binom.isf(RARE, len(every), 0.05), missed
