"""Rules that look at a table before anything is fitted to it: each says what is wrong in it, and nothing of any that is
as it was taken."""

from __future__ import annotations

import time
from collections import Counter

import numpy as np
import pytest

import clean_tables
import sherkit as sk
import table_mistakes
from running import slow
from second_machines import apart
from sherkit.data.doubts import doubts


def said(tables: clean_tables.Tables) -> tuple[int, list[str]]:
    """How many tables there are, and what is said of them."""
    count, out = 0, []
    for name, data in tables:
        count += 1
        out += [f"{name}: {doubt.sentence}" for doubt in doubts(data)]
    return count, out


@pytest.mark.parametrize("source", clean_tables.SOURCES)
@pytest.mark.parametrize("seeds", [pytest.param(range(2)), *slow(range(2, 42))])
def test_nothing_is_said_of_a_table_in_which_nothing_is_wrong(source: str, seeds: range) -> None:
    """Catches rules that cry wolf at planes, coarse grids, runs in order of their poses, few digits, large physics."""
    _, out = said(clean_tables.SOURCES[source](seeds))
    assert out == []


def test_nothing_is_said_of_real_tables() -> None:
    """Catches rules made for simulated readings."""
    count, out = said(clean_tables.real())
    assert count == 8
    assert out == []


def test_a_large_table_is_looked_through_at_once() -> None:
    """Catches a rule that sorts every column: 300,000 rows, a tenth of a second of processor time in all
    on a quiet machine."""
    n = 300_000
    rng = np.random.default_rng(0)
    q = rng.uniform(80.0, 120.0, (n // 3, 3)).repeat(3, axis=0)
    x = q @ rng.normal(size=(3, 3)) + 0.002 * rng.normal(size=(n, 3))
    columns = {f"q{k + 1}_mm": q[:, k] for k in range(3)} | dict(zip(("x_mm", "y_mm", "z_mm"), x.T, strict=True))
    columns |= {"pose": np.arange(n) // 3, "time_s": 0.1 * rng.permutation(n), "temperature_c": rng.normal(20, 0.1, n)}
    data = sk.from_frame(columns)
    _ = data.used, data.groups, data.repeatability  # what every fit asks for as well
    began = time.process_time()
    assert doubts(data) == ()
    assert time.process_time() - began < 0.3


def test_poses_that_are_read_several_times_on_the_spot_are_no_sorted_table() -> None:
    """Catches an honest run by a clock of even steps of which "nothing can be said before that is put right": a table
    that was sorted by its poses looks the same, and is said beside the verdict."""
    slip = next(one for one in table_mistakes.SLIPS if one.name == "sorted by pose")
    answer = slip.change(table_mistakes.delta(3), np.random.default_rng(0)).ask()
    assert answer.diagnosis is not None
    assert answer.diagnosis.verdict == "adequate"
    assert any("on the spot" in note for note in answer.diagnosis.notes)


RULES = tuple(dict.fromkeys(slip.rule for slip in table_mistakes.SLIPS))


@pytest.mark.parametrize("rule", RULES)
def test_a_mistake_is_said_before_a_machine_is_blamed(rule: str) -> None:
    """Catches a rule that nobody asks, and a machine that is blamed all the same: one mistake of each, on a delta."""
    slip = next(one for one in table_mistakes.SLIPS if one.rule == rule)
    assert table_mistakes.outcome(slip, table_mistakes.delta(0), 0)[0] == "named"


@pytest.mark.slow
def test_no_mistake_of_a_table_is_physics() -> None:
    """All mistakes on four robots, four seeds each: no lie and no crash among more than 500, effects named as a part in
    at most 3 %, and more than nine in ten named as they are."""
    with apart():
        every = list(table_mistakes.every(range(4)))
    count = Counter(how for *_, how, _ in every)
    print(f"\n{len(every)} runs: {dict(count)}")
    for rule in RULES:
        of_rule = Counter(how for slip, *_, how, _ in every if slip.rule == rule)
        print(f"  {rule:8} {dict(of_rule)}")
    wrong = [f"{slip.name} on {robot} {seed}: {how}, {short}" for slip, robot, seed, how, short in every
             if how in ("lie", "crash", "accused")]  # fmt: skip
    assert len(every) >= 500
    assert count["lie"] == count["crash"] == 0, "\n".join(wrong)
    assert count["accused"] <= 0.03 * len(every), "\n".join(wrong)
    assert count["named"] >= 0.9 * len(every)
