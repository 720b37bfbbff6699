"""Distances between two places, as a ball bar or callipers read them: what is wrong with a joint is wrong at both ends,
what is wrong with an instrument's beams at none, and the bar itself may be longer than it says.

Runs are those of the independent simulator, of which only the places of the two ends are used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import sherkit as sk
from running import slow
from second_simulator import NOMINAL_CONFIG, Robot, draw_geometric_errors, inverse_kinematics, truth
from sherkit.app.views import idle
from sherkit.evidence.fitted_run import FittedRun
from sherkit.evidence.run import Run
from sherkit.model.chain import ChainModel
from sherkit.model.sensor_pose import POSE
from sherkit.planning import Planning
from strategies import EXAMPLE

Floats = NDArray[np.float64]

ROBOT = Robot.from_dict(NOMINAL_CONFIG)
SIGMA_MM = 0.004
#: No encoder of this robot says its period.
UNKNOWN = replace(EXAMPLE, pole_pitch_mm=None)


def places(rng: np.random.Generator, count: int) -> Floats:
    """Joints (n, 3), mm, spread over the workspace."""
    radius, turn = 18.0 * np.sqrt(rng.uniform(0, 1, count)), rng.uniform(0, 2 * np.pi, count)
    at = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), rng.uniform(-18, 18, count)])
    return inverse_kinematics(ROBOT, at)


def apart(
    a: Floats, b: Floats, errors: Mapping[str, float], effects: Mapping[str, Any], bend: Callable[[Floats], Floats],
    temperature: Floats,
) -> Floats:  # fmt: skip
    """How far (n,) the places at two joint readings are from one another, each joint off by what ``bend`` says."""
    ends = []
    for q in (a, b):
        off = q + bend(q)
        columns = {f"q{k + 1}_mm": off[:, k] for k in range(3)}
        columns |= {"time_s": 10.0 * np.arange(len(q)), "temperature_c": temperature}
        columns["humidity_pct"] = np.full(len(q), 45.0)
        ends.append(truth(ROBOT, columns, errors, effects))
    return np.asarray(np.linalg.norm(ends[1] - ends[0], axis=1))


def nothing(q: Floats) -> Floats:
    return np.zeros_like(q)


def bar(
    seed: int, *, effects: Mapping[str, Any] | None = None, bend: Callable[[Floats], Floats] = nothing,
    zero: float = 0.0, count: int = 240, fixed: bool = False, sigma: float = SIGMA_MM,
    errors: Mapping[str, float] | None = None,
) -> sk.Measurements:  # fmt: skip
    """A run of distances alone; from one place that is ``fixed``, or between any two."""
    rng = np.random.default_rng([seed, 31])
    errors = draw_geometric_errors(rng, None) if errors is None else errors
    a, b = places(rng, count), places(rng, count)
    a = np.tile(a[:1], (count, 1)) if fixed else a
    temperature = 20.0 + np.linspace(0.0, 4.0, count)
    read = apart(a, b, errors, effects or {}, bend, temperature) + zero + sigma * rng.normal(size=count)
    columns = {f"q{k + 1}_mm": a[:, k] for k in range(3)} | {f"to_q{k + 1}_mm": b[:, k] for k in range(3)}
    columns |= {"time_s": 10.0 * np.arange(count), "temperature_c": temperature, "distance_mm": read}
    return sk.from_frame(columns | {"sigma_distance_mm": np.full(count, max(sigma, 1e-6))})


def central(of: Callable[[Floats], Floats], values: Floats, sizes: Floats) -> Floats:
    """Derivatives (n, m, p) by central differences of fourth order."""
    out = []
    for k, size in enumerate(sizes):
        h = 0.1 * size * np.eye(len(values))[k]
        out.append((8 * (of(values + h) - of(values - h)) - of(values + 2 * h) + of(values - 2 * h)) / (1.2 * size))
    return np.stack(out, axis=2)


# -- the chain ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("joint_scale", [1e-3, -5e-4, 7e-4]),
        ("encoder_cyclic", [0.01, -0.02, 0.0, 0.015, -0.01, 0.005]),
        ("rail_lean", [2e-3, -1e-3, 3e-3, 1e-3, -2e-3, 2e-3]),
        ("thermal_growth", [2e-4]),
        ("beam_alignment", [0.0] * 9),
    ],
)
def test_a_distance_is_that_of_the_independent_simulator(name: str, values: list[float]) -> None:
    """Catches an effect that is left out at one end, or that acts on the bar as if instruments saw its ends."""
    errors = draw_geometric_errors(np.random.default_rng(3))
    data = bar(1, effects={name: values}, errors=errors, sigma=0.0, zero=0.07)
    model = sk.delta.DeltaModel(EXAMPLE).with_effect(sk.delta.CATALOGUE[name])
    model = model.with_effect(sk.delta.CATALOGUE["bar_zero"])
    own = {p.name: v for p, v in zip(sk.delta.CATALOGUE[name].qualified(), values, strict=True)} | errors
    # beams that are bent move no end of a bar, wherever the instrument stands
    own |= {f"beam_alignment.{x}_by_{y}": 0.01 for x in "xyz" for y in "xyz"} if not any(values) else {}
    own |= dict.fromkeys(POSE, 0.3) | {"bar_zero.length": 0.07}
    at = np.array([own[p.name] for p in model.parameters])
    assert np.abs(model.predict(data, at)[:, 3] - data.readings[:, 3]).max() < 1e-9
    columns = model.derivatives(data, at)
    assert np.abs(columns - central(lambda v: model.predict(data, v), at, np.array([1e-3] * len(at)))).max() < 1e-6


@sk.effect(at="joints", parameters={"sine": ("mm", 0.02), "warm": ("mm", 0.02)})
def waving(rows: Any, p: Any) -> Floats:
    """Two waves of each joint, one of which grows with the temperature, and play, of which nobody knows here."""
    warm = p.warm * (rows.temperature_c - 20.0)[:, None] * np.cos(rows.joints / 3.0)
    return np.asarray(p.sine * np.sin(rows.joints / 2.0 + p.sine * rows.joints) + warm + p.sine * rows.direction)


@sk.effect(at="body", parameters={"up": ("mm", 0.02)})
def bulge(rows: Any, p: Any) -> Floats:
    """The point rises by the square of how far out it is."""
    up = p.up * np.sum((rows.position[:, :2] / 20.0) ** 2, axis=1)
    return np.column_stack([np.zeros((len(up), 2)), up])


@sk.effect(at="sensor", parameters={"shift": ("mm", 0.02)})
def shifted(rows: Any, p: Any) -> Floats:
    """All coordinates read too much."""
    return np.full((len(rows), 3), p.shift)


def waves_by_hand(q: Floats, temperature: Floats, sine: float, warm: float) -> Floats:
    return np.asarray(sine * np.sin(q / 2.0 + sine * q) + warm * (temperature - 20.0)[:, None] * np.cos(q / 3.0))


def test_an_effect_of_ones_own_acts_at_both_ends() -> None:
    """Catches an effect at the joints that moves the first end alone, with the readings or the direction of that end,
    and a derivative that is not that of the readings: at joints, at the body, and what is read of places."""
    data = bar(2, sigma=0.0, errors={}, bend=nothing)
    temperature, sine, warm = data.covariates["temperature_c"], 0.03, 0.005
    bent = bar(2, sigma=0.0, errors={}, bend=lambda q: waves_by_hand(q, temperature, sine, warm))
    model: ChainModel = sk.delta.DeltaModel(EXAMPLE)
    for effect in (waving, bulge, shifted):
        model = model.with_effect(effect)
    names = [p.name for p in model.parameters]
    values = np.zeros(len(names))
    values[names.index("waving.sine")], values[names.index("waving.warm")] = sine, warm
    values[names.index("shifted.shift")] = 0.01
    assert np.abs(model.predict(data, values)[:, 3] - bent.readings[:, 3]).max() < 1e-9
    assert np.abs(data.readings - bent.readings).max() > 0.01
    # the ends are alike: exchanged, they are as far apart
    values[names.index("bulge.up")] = 0.02
    read = model.predict(data, values)
    np.testing.assert_allclose(model.predict(data.from_other_end, values), read, rtol=0, atol=1e-9)
    columns = model.derivatives(data, values)
    # a bulge is by where the built-in model has the point, which its own joints' waves do not move
    by_hand = central(lambda v: model.predict(data, v), values, np.array([p.size * 1e-2 for p in model.parameters]))
    own = [names.index(name) for name in ("waving.sine", "waving.warm", "bulge.up", "shifted.shift")]
    assert np.abs(columns - by_hand)[:, :, own].max() < 1e-6
    assert np.abs(columns[:, 3, own[:3]]).max(axis=0).min() > 0.1
    assert not columns[:, :, own[3]].any()


def test_an_effect_of_ones_own_is_named() -> None:
    """Catches columns of an effect that is tried that are not those of the effect once it is in the model."""
    temperature = bar(4).covariates["temperature_c"]
    data = bar(4, bend=lambda q: waves_by_hand(q, temperature, 0.0, 0.01))
    d = sk.diagnose(UNKNOWN, data, effects=[waving, shifted])
    assert d.effects == ("waving",)
    assert d.verdict == "explained"
    assert d.untestable["shifted"] == "its parameters move nothing in these rows"


# -- the evidence ------------------------------------------------------------------------------------------------------


#: Waves, another slope from a place on, a bump.
ERRORS_OF_A_JOINT: tuple[Callable[[Floats], Floats], ...] = (
    lambda q: np.sin(q / 1.3),
    lambda q: np.maximum(q - 127.0, 0.0),
    lambda q: np.exp(-((q - 128.0) ** 2)),
)


def alone(of: Callable[[Floats], Floats], size: Floats, q: Floats) -> Floats:
    """An error (n, 3) of the joints, as large as that of each is."""
    return of(q) * size


@pytest.mark.parametrize("fixed", [False, True])
def test_an_error_of_a_joint_arrives_from_both_ends(fixed: bool) -> None:
    """Catches a wave, a kink or a bump of a joint that arrives from the first end alone."""
    data = bar(5, fixed=fixed, sigma=0.0, errors={})
    fit = FittedRun(sk.identify(UNKNOWN, data))
    run = Run.plain(fit, np.arange(len(data)), (), fit.noise[0])
    view = run.view
    assert view.ends == 2
    assert set(view.pattern_of) == {"q1_mm", "q2_mm", "q3_mm"}
    for k, name in enumerate(data.layout.joints):
        for of in ERRORS_OF_A_JOINT:
            read = [
                bar(5, fixed=fixed, sigma=0.0, errors={}, bend=partial(alone, of, size * np.eye(3)[k])).readings[:, 3]
                for size in (1e-4, -1e-4)
            ]
            arrives = view.arriving(name, of(view.stood[name])[:, None])[:, 0, 0] * run.sigma[3]
            assert np.abs(arrives - (read[0] - read[1])[run.rows] / 2e-4).max() < 1e-5


@pytest.mark.parametrize(("seed", "fixed"), [(2, True), *slow((0, False), (1, False))])
def test_the_period_of_a_wave_is_found_by_distances(seed: int, fixed: bool) -> None:
    """Catches waves at one end of a bar alone: another period fitted better, or the right one was called wrong."""
    period = 6.3 + seed
    data = bar(seed, fixed=fixed, bend=lambda q: 0.012 * np.sin(2 * np.pi * q / period + np.arange(3.0)))
    d = sk.diagnose(UNKNOWN, data)
    assert (d.verdict, d.effects) == ("explained", ("encoder_cyclic",))
    known = sk.diagnose(replace(UNKNOWN, pole_pitch_mm=period), data)
    assert (known.verdict, known.effects) == ("explained", ("encoder_cyclic",))
    assert not any("pole_pitch_mm" in note for note in known.notes)


@pytest.mark.slow
def test_a_bump_of_a_joint_is_found_where_it_is() -> None:
    """Catches shapes of a joint that are looked for at one end of a bar alone."""
    data = bar(6, count=400, bend=lambda q: 0.05 * np.exp(-0.5 * ((q - 128.0) / 3.0) ** 2) * np.array([0.0, 1.0, 0.0]))
    told = sk.diagnose(UNKNOWN, data).signature
    assert told is not None
    assert told["joint"] == "q2_mm"


# -- the bar -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
@pytest.mark.parametrize(
    ("zero", "lean", "named"),
    [(0.05, 0.0, {"bar_zero"}), (0.05, 5e-3, {"bar_zero", "rail_lean"}), (0.0, 0.0, set())],
)
def test_a_bar_that_is_longer_than_it_says_is_named(zero: float, lean: float, named: set[str], seed: int) -> None:
    """Catches a bar's zero that is given to an instrument's beams, of which it has none, and one that is seen where the
    bar is right."""
    rng = np.random.default_rng(seed)
    d = sk.diagnose(UNKNOWN, bar(seed, zero=zero, effects={"rail_lean": lean * rng.normal(size=6)}))
    assert set(d.effects) == named
    assert d.verdict == ("explained" if named else "adequate")
    assert {"beam_alignment", "sensor_linearity", "sensor_slip", "drift", "backlash"} <= set(d.untestable)


def test_where_places_are_read_a_bar_cannot_be_tried() -> None:
    """Catches a bar among the candidates of a run that has none, one of which nothing is said, one that a plan promises
    to miss, and one among what a promise counts with."""
    rng = np.random.default_rng(9)
    q = places(rng, 200)
    columns = {f"q{k + 1}_mm": q[:, k] for k in range(3)} | {"time_s": np.arange(200.0)}
    now = {"temperature_c": np.full(200, 20.0), "humidity_pct": np.full(200, 45.0)}
    at = truth(ROBOT, columns | now) + SIGMA_MM * rng.normal(size=(200, 3))
    data = sk.from_frame(columns | {f"{a}_mm": at[:, k] for k, a in enumerate("xyz")})
    d = sk.diagnose(UNKNOWN, data)
    assert "bar_zero" not in {c.effect for c in d.candidates}
    assert d.untestable["bar_zero"] == "it needs the column distance_mm"
    assert "bar_zero" in idle(d)
    (planned,) = (one for one in Planning(d.fit.model, data, SIGMA_MM).effect_powers if one.name == "bar_zero")
    assert planned.missing_columns == ("distance_mm",)
    assert "bar_zero" not in sk.delta.DeltaModel(EXAMPLE).may_be_off
