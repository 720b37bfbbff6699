"""Measuring until it is known: the evidence, the rule, what is asked, and loops on the second simulators."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest
from scipy import integrate, stats

import sherkit as sk
from driven_worlds import DrivenArm, DrivenDelta, DrivenSpherical, World, driven
from running import slow
from sherkit.adaptive import told
from sherkit.adaptive.known import FixedBefore, run_at
from sherkit.errors import ArgumentError, ExperimentError, FitError, MeasurementError
from sherkit.evidence.base import log_bayes_of
from sherkit.evidence.family import Family
from sherkit.evidence.thresholds import SCALES

Floats = np.ndarray


drive = partial(driven, budget=150, span_min=5.0)


@pytest.fixture(scope="module")
def leaning() -> tuple[sk.Adaptive, World]:
    """A delta whose rails lean, measured until that was known."""
    world = DrivenDelta(1, ("rail_lean",), 3.0)
    return drive(world, required_um=20), world


# -- the evidence ---------------------------------------------------------------------------------------------------


def by_integration(x: Floats, y: Floats, size: float) -> float:
    """The Bayes factor of one column against none, Jeffreys' noise, by two integrals: a second way to the number."""
    n, half_log_2pi = len(y), 0.5 * np.log(2.0 * np.pi)

    def likelihood(c: float, log_sigma: float) -> float:
        # written out: SciPy's densities are slow one by one
        return float(np.exp(-0.5 * (((y - c * x) / np.exp(log_sigma)) ** 2).sum() - n * (log_sigma + half_log_2pi)))

    def prior(c: float, log_sigma: float) -> float:
        return float(np.exp(-0.5 * (c / size / np.exp(log_sigma)) ** 2 - np.log(size) - log_sigma - half_log_2pi))

    wide = np.log(np.std(y)) + np.array([-1.5, 2.5])
    above = integrate.dblquad(lambda c, s: likelihood(c, s) * prior(c, s), *wide, -30.0, 30.0, epsrel=1e-6)[0]
    below = integrate.quad(lambda s: likelihood(0.0, s), *wide, epsrel=1e-8)[0]
    assert n
    return above / below


def test_a_bayes_factor_is_the_ratio_of_two_integrals() -> None:
    """Catches a wrong prior, a wrong number of degrees of freedom, a determinant that is left out."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=8)
    y = 0.6 * x + rng.normal(size=8)
    found = log_bayes_of((x @ x).reshape(1, 1, 1), np.array([[x @ y]]), float(y @ y), len(y))[0]
    assert np.exp(found) == pytest.approx(np.mean([by_integration(x, y, size) for size in SCALES]), rel=2e-3)


def test_the_mean_of_bayes_factors_never_rises_where_nothing_is_missing() -> None:
    """Catches evidence that grows by being looked at: its mean at the look where it is largest so far must not exceed
    one by more than chance (400 runs of 12 looks, Ville's bound at 20 broken with a chance below 1e-3 otherwise)."""
    rng = np.random.default_rng(0)
    alarms, last = 0, []
    for _ in range(400):
        own, column, y = rng.normal(size=(60, 3)), rng.normal(size=(60, 2)), rng.normal(size=60)
        seen = []
        for n in range(12, 61, 4):
            q, _ = np.linalg.qr(own[:n])
            x, r = column[:n] - q @ (q.T @ column[:n]), y[:n] - q @ (q.T @ y[:n])
            seen.append(float(np.exp(log_bayes_of((x.T @ x)[None], (x.T @ r)[None], float(r @ r), n - 3)[0])))
        alarms += max(seen) >= 20.0
        last.append(seen[-1])
    assert alarms <= stats.binom.ppf(1.0 - 1e-3, 400, 1 / 20)
    assert np.mean(last) < 1.0 + 4.0 * np.std(last) / np.sqrt(len(last))


@pytest.mark.slow
def test_what_is_tried_does_not_hang_on_the_rows_read_so_far() -> None:
    """Catches a scale, a setting or a weight that moves with each look: the columns of every effect and shape, on the
    scale of their prior, are those of the rows before, once more rows are there; then no mean of them is an e-process.
    Shapes that an effect is, are none."""
    world = DrivenDelta(3)
    loop = sk.Adaptive(world.robot)
    places = loop.region.anywhere(24, np.random.default_rng(0)).joints
    rows = [
        {"pose": k + 1, "repeat": 1, **dict(zip(world.joints, q.tolist(), strict=True))} for k, q in enumerate(places)
    ]
    data = told.in_order_of_time(pl.DataFrame(world.read(rows)), loop.robot, loop.model, loop.layout)
    known = FixedBefore.of(loop.model.for_run(data), loop.region, data.select(np.arange(12)), (0, 1, 2), 1800.0)
    fit = sk.identify(known.model, data)
    early, late = (
        Family(run_at(replace(fit, data=data.select(np.arange(n))), np.ones(len(data.layout.names))), known.reference)
        for n in (16, 24)
    )
    assert {"rail_lean", "backlash", "drift", "slip"} <= set(known.effects)
    assert 400 < len(early) <= len(late)
    for block, weight in zip(early.blocks, early.log_weight, strict=True):
        same = late.where(block)
        then = late.blocks[same]
        assert (then.setting, then.period, late.log_weight[same]) == (block.setting, block.period, weight)
        before, after = (f.columns.of(b.at) * f.prior(b) for f, b in ((early, block), (late, then)))
        assert after[: 16 * 3] == pytest.approx(before, rel=1e-6, abs=1e-6)
    assert np.exp(late.log_weight).sum() + np.exp(late.log_missing) == pytest.approx(1.0)
    for name, block in {block.name: block for block in late.blocks if block.name}.items():
        # a coefficient of one leaves a root mean square of one over the reference
        squares = known.reference.squares[known.reference.sort_of(block)]
        assert name in known.effects
        assert np.trace(squares) == pytest.approx(1.0)


# -- loops ----------------------------------------------------------------------------------------------------------


def test_a_loop_ends_with_the_name_of_what_was_hidden(leaning: tuple[sk.Adaptive, World]) -> None:
    """Catches a loop that does not end, names another effect, or promises what does not hold elsewhere."""
    loop, world = leaning
    assert (loop.verdict, loop.effects, loop.indistinguishable) == ("explained", ("rail_lean",), ())
    assert loop.readings <= 60
    assert loop.accuracy_um is not None
    assert loop.accuracy_um <= 20
    places = loop.region.anywhere(50, np.random.default_rng(0))
    missed = world.missed(loop.last.lead.run.of.fit, places.joints)
    assert np.mean(1e3 * missed <= loop.accuracy_um) >= 0.9
    assert loop.diagnosis.verdict == "explained"
    assert loop.diagnosis.effects == ("rail_lean",)
    assert loop.ask() == []


@pytest.mark.slow
def test_silence_says_what_could_not_have_been_seen() -> None:
    """Catches an innocent that is blamed, a loop that stops before the span is over, and silence without its limits."""
    world = DrivenDelta(5)
    loop = drive(world, span_min=20.0)
    assert (loop.verdict, loop.effects) == ("adequate", ())
    assert loop.readings <= 66
    assert world.clock_s >= 20.0 * 60.0 - 5.0
    said = ("would have been seen", "was not looked for", "the first reading is set aside")
    assert all(any(words in note for words in said) for note in loop.notes)
    assert loop.diagnosis.verdict == "adequate"


@pytest.mark.slow
def test_what_is_in_no_catalogue_is_never_explained() -> None:
    """Catches a name for a warped plate."""
    loop = drive(DrivenDelta(2, unknown="saddle", ratio=5.0))
    assert loop.verdict == "unexplained"
    assert loop.effects == ()
    assert "looks like" in loop.why


@pytest.mark.parametrize(
    ("world", "name"),
    [
        (lambda: DrivenSpherical(0, ("backlash",), 3.0), "backlash"),
        *slow((lambda: DrivenArm(0, ("joint_compliance",), 3.0), "joint_compliance")),
    ],
)
def test_other_robots(world: Callable[[], World], name: str) -> None:
    """Catches a loop that knows deltas alone."""
    loop = drive(world())
    assert (loop.verdict, loop.effects) == ("explained", (name,))


@pytest.mark.slow
def test_a_tie_names_nobody_twice() -> None:
    """Catches one effect at two moments as its own rival."""
    loop = drive(DrivenDelta(62, ("slip",), 5.0), budget=200, span_min=30.0)
    assert all(len(set(tie)) == len(tie) for tie in loop.indistinguishable)
    assert {"slip"} <= {*loop.effects, *sum(loop.indistinguishable, ())}


def forward(joints: Any, p: Any) -> Floats:
    """A plotter whose axes are not square."""
    x, y = joints.T
    return np.stack([x - p.squareness * y + p.x_zero, y + p.y_zero], axis=1)


@pytest.mark.slow
def test_a_machine_of_the_users_own() -> None:
    """Catches a machine by a function that no loop can drive: here its first joint reads too much by its length."""
    machine = sk.Machine(
        forward, joints={"a_mm": (0.0, 300.0), "b_mm": (0.0, 200.0)}, readings=("x_mm", "y_mm"), name="plotter",
        parameters={"squareness": ("rad", 1e-3), "x_zero": ("mm", 1.0), "y_zero": ("mm", 1.0)},
    )  # fmt: skip
    rng = np.random.default_rng(4)
    loop = sk.Adaptive(machine, budget=120)
    assert loop.ask()[0].keys() >= {"pose", "repeat", "a_mm", "b_mm", "x_mm", "y_mm", "reason", "not_before_s"}
    while not loop.done:
        rows = []
        for row in loop.ask():
            a, b = row["a_mm"], row["b_mm"]
            seen = np.array([1.0004 * a - 3e-4 * b, b]) + 0.002 * rng.normal(size=2)
            rows.append({"pose": row["pose"], "repeat": 1, "a_mm": a, "b_mm": b, "x_mm": seen[0], "y_mm": seen[1]})
        loop.tell(rows)
    assert loop.verdict == "explained"
    assert any("scale" in name for name in (*loop.effects, *sum(loop.indistinguishable, ())))


# -- what is asked and told -----------------------------------------------------------------------------------------


def pan_and_tilt(joints: Any, p: Any) -> Floats:
    """Two axes that cross, and a telescope on them."""
    a, b = np.deg2rad(joints[:, 0]), np.deg2rad(joints[:, 1]) + p.tilt_zero
    far = 300.0 + joints[:, 2] + p.reach
    out = 60.0 + p.shoulder + far * np.cos(b)
    return np.stack([out * np.cos(a), out * np.sin(a), far * np.sin(b)], axis=1)


@pytest.mark.slow
def test_a_shape_of_one_number_does_not_outdo_one_of_six() -> None:
    """Catches shapes that say as much as an effect as one of its numbers alone does, and stop a loop for that: one
    coupling of six was "unexplained" in 11 of 12 loops, which a diagnosis of the same rows named. Readings are
    written into the rows that were asked: these were then what a loop remembered of where joints should lead."""
    machine = sk.Machine(
        pan_and_tilt,
        joints={"pan_deg": (-90.0, 90.0), "tilt_deg": (-20.0, 70.0), "ext_mm": (0.0, 250.0)},
        readings=("x_mm", "y_mm", "z_mm"),
        parameters={"tilt_zero": ("rad", 3e-3), "reach": ("mm", 0.5), "shoulder": ("mm", 0.5)},
    )
    rng, loop, now = np.random.default_rng(7), sk.Adaptive(machine, budget=60, required_um=60.0, span_min=10.0), 0.0
    true = SimpleNamespace(tilt_zero=1e-3, reach=0.3, shoulder=-0.4)
    while not loop.done:
        rows = loop.ask()
        joints = np.array([[row[name] for name in ("pan_deg", "tilt_deg", "ext_mm")] for row in rows])
        joints[:, 1] += 4e-4 * joints[:, 0]
        seen = pan_and_tilt(joints, true) + rng.normal(size=(len(rows), 3)) * 0.01
        for row, place in zip(rows, seen.tolist(), strict=True):
            now = max(now + 15.0, row.get("not_before_s", 0.0))
            row |= dict(zip(("time_s", "x_mm", "y_mm", "z_mm"), (now, *place), strict=True))
        loop.tell(rows)
    assert (loop.verdict, loop.effects) == ("explained", ("joint_coupling",))


def test_what_is_asked_is_what_a_run_file_names() -> None:
    """Catches rows that a lab script cannot use: keys, reasons, a place for each, within the workspace."""
    world = DrivenDelta(3)
    loop = sk.Adaptive(world.robot, budget=60, span_min=20.0, batch=5)
    asked = loop.ask()
    assert [set(row) for row in asked] == [
        {"pose", "repeat", "q1_mm", "q2_mm", "q3_mm", "x_mm", "y_mm", "z_mm", "reason", "not_before_s"}
    ] * len(asked)
    assert asked == loop.ask()
    assert {row["reason"] for row in asked} == {"start"}
    assert all(np.hypot(row["x_mm"], row["y_mm"]) <= 30.0 for row in asked)
    for row in asked:
        place = world.robot.forward([row[f"q{k}_mm"] for k in (1, 2, 3)])
        assert place == pytest.approx([row[f"{a}_mm"] for a in "xyz"], abs=2e-3)
    reasons, waits = set(), []
    while not loop.done:
        asked = loop.ask()
        reasons |= {row["reason"] for row in asked}
        waits += [row["not_before_s"] for row in asked]
        assert loop.readings == 0 or len(asked) <= 5
        loop.tell(world.read(asked))
    assert reasons <= {"start", "all", "explore", "again", "time"}
    assert "time" in reasons
    late = [one for one in waits if one > 0]
    assert late == sorted(late)
    assert late[-1] > 19.0 * 60.0


def test_a_box_is_kept() -> None:
    """Catches poses outside of the part of the workspace that was given."""
    box = {"x_mm": (-5.0, 5.0), "z_mm": (0.0, 10.0)}
    loop = sk.Adaptive(DrivenDelta(0).robot, box=box)
    asked = loop.ask()
    assert all(-5.0 <= row["x_mm"] <= 5.0 and 0.0 <= row["z_mm"] <= 10.0 for row in asked)
    assert max(abs(row["y_mm"]) for row in asked) > 10.0


def test_rows_may_come_back_as_they_like() -> None:
    """Catches a loop that hangs, or forgets, where rows come back fewer, later, elsewhere, twice, or with more columns
    than were asked for; all are counted once."""
    world = DrivenDelta(6, ("backlash",), 4.0)
    loop = sk.Adaptive(world.robot, budget=120)
    first = world.read(loop.ask())
    loop.tell(first[:5])
    loop.tell(first[:7])
    assert loop.readings == 7
    assert len(loop.ask()) == len(first) - 7
    elsewhere = loop.ask()
    for row in elsewhere:
        row["q1_mm"] += 0.3
        row["hum"] = "somebody spoke"
    loop.tell([{**row, "note": "late"} for row in world.read(elsewhere)])
    assert loop.readings == len(first)
    assert loop.looks
    loop.tell(pl.DataFrame(world.read(loop.ask())))
    frame = pl.DataFrame(world.read(loop.ask()))
    loop.tell({name: frame[name].to_list() for name in frame.columns})
    while not loop.done:
        loop.tell(world.read(loop.ask()))
    assert loop.effects == ("backlash",)


@pytest.mark.slow
def test_a_wrong_column_is_said() -> None:
    """Catches physics that is named, or an unknown that is looked for, where two columns are swapped."""
    world = DrivenDelta(7)
    loop = sk.Adaptive(world.robot, budget=36)
    while not loop.done:
        loop.tell([{**row, "x_mm": row["y_mm"], "y_mm": row["x_mm"]} for row in world.read(loop.ask())])
    assert loop.verdict == "unexplained"
    assert "x_mm" in loop.why
    assert "y_mm" in loop.why


def test_a_row_that_is_wrong_is_driven_again() -> None:
    """Catches a gross error that becomes physics, and one that nobody looks at again."""
    world = DrivenDelta(9)
    loop = sk.Adaptive(world.robot, budget=80)
    reasons = set()
    while not loop.done:
        asked = loop.ask()
        reasons |= {row["reason"] for row in asked}
        rows = world.read(asked)
        for row in rows:
            if row["pose"] in (3, 15) and row["repeat"] == 1:
                row["z_mm"] += 0.5
        loop.tell(rows)
    assert loop.verdict == "adequate"
    # and the first, of which nobody knows from which side it was approached
    assert len(loop.last.aside) == 3
    assert "again" in reasons


@pytest.mark.parametrize("from_file", [False, *slow(True)], ids=["at once", "file"])
def test_state_follows_from_the_rows(leaning: tuple[sk.Adaptive, World], from_file: bool, tmp_path: Path) -> None:
    """Catches a file, or all rows told at once, that lead to another verdict or other poses."""
    loop, _ = leaning
    if from_file:
        loop.save(tmp_path / "loop.json")
        other = sk.Adaptive.load(tmp_path / "loop.json")
    else:
        other = sk.Adaptive(loop.robot, required_um=20, budget=150, span_min=5.0)
        other.tell(loop.data)
    assert (other.verdict, other.effects, other.readings) == (loop.verdict, loop.effects, loop.readings)
    assert [one.log_evidence for one in other.looks] == pytest.approx([one.log_evidence for one in loop.looks])


# -- bad input ------------------------------------------------------------------------------------------------------


def without_workspace() -> Any:
    """A delta whose file does not say how far it may go."""
    tables = DrivenDelta(0).robot.to_tables()
    del tables["workspace"]
    from sherkit.model.kinds import robot_from_tables

    return robot_from_tables(tables, "robot")


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (lambda: sk.Adaptive(without_workspace()), "nothing says how far this robot may go"),
        (lambda: sk.Adaptive(DrivenDelta(0).robot, box={"u_px": (0.0, 1.0)}), "'u_px' is no joint and no coordinate"),
        (lambda: sk.Adaptive(DrivenDelta(0).robot, box={"x_mm": (5.0, -5.0)}), "low below high"),
        (lambda: sk.Adaptive(DrivenDelta(0).robot, box={"x_mm": (90.0, 95.0)}), "outside of the robot's own workspace"),
        (lambda: sk.Adaptive(DrivenDelta(0).robot, box={"q1_mm": (0.0, 50.0)}), "all of them"),
    ],
)
def test_a_region_that_is_none(made: Callable[[], object], says: str) -> None:
    """Catches a traceback, or a robot that is sent anywhere, for a region that nobody knows or that is empty."""
    with pytest.raises(ExperimentError, match=says):
        made()


@pytest.mark.parametrize("settings", [{"budget": 0}, {"level": 2.0}, {"span_min": -1.0}, {"batch": "six"}])
def test_settings_that_are_none(settings: dict[str, Any]) -> None:
    """Catches a number that means nothing."""
    with pytest.raises(ArgumentError, match=next(iter(settings))):
        sk.Adaptive(DrivenDelta(0).robot, **settings)


def test_rows_that_are_none_change_nothing(tmp_path: Path) -> None:
    """Catches half of a table that is taken before the other half is refused."""
    world = DrivenDelta(0)
    loop = sk.Adaptive(world.robot)
    assert (loop.verdict, loop.effects, loop.done) == ("undecided", (), False)
    with pytest.raises(FitError, match="nothing was told yet"):
        _ = loop.diagnosis
    rows = world.read(loop.ask())
    loop.tell(rows[:4])
    bad = [{**rows[4], "x_mm": "much"}, rows[5]]
    for wrong in (bad, [{"pose": 1}], 7, [3], {"theta1_rad": [1.0]}):
        with pytest.raises(MeasurementError):
            loop.tell(wrong)
        assert loop.readings == 4
    loop.tell([])
    loop.tell([{**rows[4], "x_mm": float("nan"), "y_mm": float("nan"), "z_mm": 1.0}])
    (tmp_path / "no.json").write_text(json.dumps({"kind": "other"}))
    for name, says in (("no.json", "no file of an adaptive loop"), ("missing.json", "cannot be read")):
        with pytest.raises(ExperimentError, match=says):
            sk.Adaptive.load(tmp_path / name)


def test_a_budget_that_is_spent_says_so() -> None:
    """Catches a loop that goes on for ever, and a budget below what it begins with."""
    loop = drive(DrivenDelta(0, ("joint_scale",), 0.5), budget=20)
    assert loop.readings == 20
    assert "budget of 20 readings is spent" in loop.why
    small = drive(DrivenDelta(0), budget=5)
    assert (small.verdict, small.readings) == ("undecided", 5)


@pytest.mark.slow
def test_a_tie_says_what_would_tell() -> None:
    """Catches a tie that leaves the reader without a next step: a focal length and the distortion of a lens do much the
    same in one camera, so that either poses are named or it is said that these instruments cannot tell."""
    loop = drive(DrivenSpherical(80, ("focal_length",), 1.0), budget=60)
    assert {"focal_length", "lens_distortion"} <= set(loop.indistinguishable[0])
    assert re.search(r"these instruments cannot tell|poses that would tell most, the last: theta1_rad", loop.notes[0])
