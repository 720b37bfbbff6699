"""What the evidence of a run names, on simulated robots whose hidden effects are known."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import worlds
from sherkit.base.types import Floats
from sherkit.evidence import names
from sherkit.evidence.base import Base
from sherkit.evidence.family import Family
from sherkit.evidence.fitted_run import FittedRun
from sherkit.evidence.names import Names, judged_names
from sherkit.evidence.run import weighed_run
from sherkit.evidence.sets import Sets
from sherkit.evidence.settings import refined
from worlds import World


def sets_of(world: World) -> Sets:
    """Of a run without outliers or mistakes."""
    fit = FittedRun(world.study().fit)
    run = weighed_run(fit, np.flatnonzero(fit.whole), fit.catalogue, fit.noise[0])
    family = Family(run)
    return Sets(family, Base.of(family, run))


@cache
def asked(*hidden: str) -> Names:
    """Names in a delta's run with these effects hidden, each of four noises."""
    return judged_names(sets_of(worlds.delta_world(1, dict.fromkeys(hidden, 4 * worlds.NOISE_UM))))


def test_nothing_hidden_names_nothing() -> None:
    """Catches evidence that grows with how much is tried. Level: one run in a hundred; this seed is fixed."""
    found = judged_names(sets_of(worlds.clean(0)))
    assert found.lead is None
    assert found.alone.shapes == ()


@pytest.mark.parametrize("name", ["rail_lean", "joint_scale"])
def test_a_single_effect_is_named_and_explains(name: str) -> None:
    """Catches a lead that is not the likeliest, and a rest that counts the effect again."""
    found = asked(name)
    assert found.named == (name,)
    assert found.explains
    assert found.told[0].needed > 0


def test_the_size_is_that_of_the_full_fit() -> None:
    """Catches a set whose base is that of the fit before it: with the effect in, noise is left."""
    lead = asked("rail_lean").lead
    assert lead is not None
    assert lead.base.rss / lead.base.free == pytest.approx(1.0, abs=0.1)
    assert lead.log_bf > 100.0


def test_two_effects_are_a_pair() -> None:
    """Catches a search that stops at singles, and a pair that is found where each was best alone."""
    found = asked("rail_lean", "drive_compliance")
    assert set(found.named) == {"rail_lean", "drive_compliance"}
    assert found.explains


def test_a_moment_is_found_to_the_row() -> None:
    """Catches a moment that stays where a block was made, 24 over the run: a step of three noises from one row on."""
    world = worlds.clean(0)
    sets = sets_of(world)
    run = sets.family.run
    time, n = run.view.time, len(run)
    assert time is not None
    cut = n // 3 + 7
    step = np.where(np.arange(n) >= cut, 3.0, 0.0)[:, None] * np.ones(run.axes)
    base = with_residual(sets.base, run.residual + run.flat(step))
    i = max((i for i, b in enumerate(base.family.blocks) if b.setting and b.effect), key=lambda i: base.gains[0][i])
    block = base.family.blocks[i]
    if block.effect is None or block.effect.search != "time_s":
        pytest.fail(f"a step in time is taken for {block.name}")
    assert refined(base, block).setting == pytest.approx(0.5 * (time[cut - 1] + time[cut]), abs=float(np.ptp(time)) / n)


def with_residual(base: Base, residual: Floats) -> Base:
    """The same model of other readings."""
    left = residual - base.basis @ (base.basis.T @ residual)
    return Base(base.family, base.basis, left, base.left, base.family.columns.products(left[:, None])[:, 0])


def test_what_is_no_robots_is_no_tie(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches "cannot tell thermal_shift from thermal_growth" where growth has rails lean by 11°, 47 usual sizes:
    beside a lead that is none itself that is no tie, however well it fits."""
    monkeypatch.setattr(names, "is_plausible", lambda run, effect, most: run.times <= most)

    def a_set(times: float) -> Any:
        block = SimpleNamespace(effect=object())
        return SimpleNamespace(
            blocks=(block,), value=100.0, rest=-3.0, explains=True, plausible=times <= 5.0,
            base=SimpleNamespace(rss=100.0, free=100), run=SimpleNamespace(of=SimpleNamespace(times=times)),
        )  # fmt: skip

    sets: Any = SimpleNamespace(counted=lambda one: 1)
    sound, large, far = a_set(1.0), a_set(9.0), a_set(47.0)
    assert names._ties(sets, sound, [sound, large, far]) == (large,)
    assert names._ties(sets, large, [sound, large, far]) == (sound, far)
