"""Every effect of the catalogue: what it says of itself, its readings by an independent way, its derivatives."""

from __future__ import annotations

from itertools import combinations, pairwise
from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray

import sherkit as sk
from second_simulator import NOMINAL_CONFIG, Robot, draw_effect, draw_geometric_errors, grid, make_plan, simulate
from second_simulator.effects import EFFECTS as SIMULATED
from sherkit.model.effect import LINKS
from strategies import EXAMPLE

Floats = NDArray[np.float64]

ROBOT = Robot.from_dict(NOMINAL_CONFIG)
#: Parameters and link of each effect.
EXPECTED = {
    "joint_scale": (3, "joints", ()),
    "encoder_cyclic": (6, "joints", ()),
    "encoder_second_1": (2, "joints", ()),
    "encoder_second_2": (2, "joints", ()),
    "encoder_second_3": (2, "joints", ()),
    "backlash": (3, "joints", ("direction",)),
    "rail_lean": (6, "structure", ()),
    "rod_mismatch": (3, "structure", ()),
    "limb_twist": (3, "structure", ()),
    "drive_compliance": (3, "structure", ()),
    "gravity_sag": (3, "body", ()),
    "link_growth": (3, "structure", ("temperature_c",)),
    "thermal_growth": (1, "body", ("temperature_c",)),
    "drift": (3, "body", ("time_s",)),
    "slip": (3, "body", ("time_s",)),
    "joint_slip": (3, "joints", ("time_s",)),
    "thermal_shift": (3, "sensor", ("temperature_c",)),
    "beam_alignment": (9, "sensor", ()),
    "sensor_linearity": (3, "sensor", ()),
    "sensor_slip": (6, "sensor", ("time_s",)),
    "sensor_drift": (6, "sensor", ("time_s",)),
    "bar_zero": (1, "sensor", ("distance_mm",)),
}
#: Those of the simulator: the second waves of all joints are one, and go with the first.
SECOND = "encoder_second"
#: What acts on distances alone is asked in ``test_ball_bar.py``.
NAMES = (*(name for name in EXPECTED if not name.startswith((SECOND, "bar_zero"))), SECOND)
#: What else the fourth number of an effect of the simulator is called.
SETTINGS = {
    "slip": "slip_time_s", "sensor_slip": "sensor_slip_time_s",
    "joint_slip": "joint_slip_time_s", "thermal_shift": "thermal_shift_lag_s",
}  # fmt: skip
#: The value of ours for one unit of the simulator's: what the whole weight (5 N) does instead of a newton.
UNITS = {"gravity_sag": 5.0, "drive_compliance": 5.0}
#: Where the two programs differ in the product of two small effects, mm, at three times the typical size: ours bends
#: what a misaligned beam sees, the other the point itself.
CONVENTIONS = (
    ({"beam_alignment", "sensor_linearity"}, 2e-3),
    # ours grows by what is drawn, the other by what is built
    ({"link_growth"}, 5e-4),
)


def test_the_catalogue_says_what_each_effect_is() -> None:
    """Catches an effect that was renamed, moved to another link, lost a parameter, or has nothing to tell a person."""
    found = {name: (len(e.parameters), e.link, e.needs) for name, e in sk.delta.CATALOGUE.items()}
    assert found == EXPECTED
    for name, effect in sk.delta.CATALOGUE.items():
        assert effect.name == name
        assert effect.link in LINKS
        for text in (effect.physics, effect.residuals, effect.remedy):
            assert text.strip().endswith(".")
        assert len({p.name for p in effect.parameters}) == len(effect.parameters)
        for p in effect.parameters:
            assert p.unit in ("mm", "rad", "mm/mm", "mm/h", "rad/h", "1/°C", "mm/°C")
            assert p.size > 0
            assert p.lever_mm > 0
        assert [p.name for p in effect.qualified()] == [f"{name}.{p.name}" for p in effect.parameters]
    assert {n for n, e in sk.delta.CATALOGUE.items() if e.search} == {
        "encoder_cyclic", "joint_slip", "sensor_slip", "slip", "thermal_shift",
    }  # fmt: skip


def run(seed: int, effects: dict[str, Any] | None = None) -> tuple[sk.Measurements, dict[str, float]]:
    """A run without noise, shuffled so that joints turn back and forth, and the errors planted in it."""
    plan = make_plan(ROBOT, grid(18.0, 4, (-18.0, 0.0, 18.0)), repeats=2, order="shuffled", seed=seed)
    errors = draw_geometric_errors(np.random.default_rng(seed))
    return sk.from_frame(pl.DataFrame(simulate(ROBOT, plan, errors, effects))), errors


def model_of(names: tuple[str, ...], planted: dict[str, Floats] | None = None) -> sk.delta.DeltaModel:
    effects = [effect for name in names for effect in ours(name)]
    if SECOND in names and "encoder_cyclic" not in names:
        effects += ours("encoder_cyclic")
    known = planted or {}
    settings = {key: float(known[name][-1]) for name, key in SETTINGS.items() if name in known}
    return sk.delta.DeltaModel(EXAMPLE, (), tuple(effects), **settings)


def ours(name: str) -> list[sk.Effect]:
    """What the simulator has as one."""
    return [e for e in sk.delta.CATALOGUE.values() if e.name == name or (name == SECOND and e.name.startswith(name))]


def values_of(model: sk.delta.DeltaModel, errors: dict[str, float], planted: dict[str, Floats]) -> Floats:
    """The model's values for what was planted in the simulator."""
    by_name = dict(errors)
    for name, parameters in planted.items():
        names = [p.name for effect in ours(name) for p in effect.qualified()]
        by_name |= dict(zip(names, UNITS.get(name, 1.0) * parameters[: len(names)], strict=True))
    return np.array([by_name.get(p.name, 0.0) for p in model.parameters])


def drawn(names: tuple[str, ...], seed: int, times: float) -> dict[str, Floats]:
    """Random parameters, ``times`` the typical size."""
    rng = np.random.default_rng([seed, 9])
    out = {}
    for name in names:
        parameters = draw_effect(name, rng, 300.0)
        parameters[: SIMULATED[name].amplitudes] *= times
        out[name] = parameters
    return out


def agree(names: tuple[str, ...], seed: int, times: float) -> None:
    planted = drawn(names, seed, times)
    data, errors = run(seed, planted)
    model = model_of(names, planted)
    predicted = model.predict(data, values_of(model, errors, planted))[:, :3]
    allowed = 1e-9 + sum(mm for pair, mm in CONVENTIONS if pair <= set(names))
    assert np.abs(predicted - data.readings[:, :3]).max() < allowed
    without = model.predict(data, values_of(model, errors, {}))[:, :3]
    assert np.abs(without - predicted).max() > 1e-5


@pytest.mark.parametrize("times", [1.0, 5.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("name", NAMES)
def test_readings_are_those_of_the_independent_simulator(name: str, seed: int, times: float) -> None:
    """Catches a wrong sign, order, unit, lever or link of an effect: two programs agree to 1e-9 mm, errors planted."""
    agree((name,), seed, times)


@pytest.mark.parametrize("part", [0, 1, 2])
def test_growth_of_a_robot_as_drawn_is_that_of_the_independent_simulator(part: int) -> None:
    """Catches a part that grows with another, from another place or by another temperature: two programs agree to 1e-9
    mm where the robot is built as drawn; and that all parts together are the robot made larger."""
    growth = np.zeros(3)
    growth[part] = 5e-4
    plan = make_plan(ROBOT, grid(18.0, 4, (-18.0, 0.0, 18.0)), repeats=1, order="shuffled", seed=part)
    data = sk.from_frame(pl.DataFrame(simulate(ROBOT, plan, {}, {"link_growth": growth})))
    model = model_of(("link_growth",))
    predicted = model.predict(data, values_of(model, {}, {"link_growth": growth}))[:, :3]
    assert np.abs(predicted - data.readings[:, :3]).max() < 1e-9
    larger, all_parts = model_of(("thermal_growth",)), values_of(model, {}, {"link_growth": np.full(3, 5e-4)})
    whole = larger.predict(data, values_of(larger, {}, {"thermal_growth": np.array([5e-4])}))[:, :3]
    together = model.predict(data, all_parts)[:, :3]
    target = np.outer(data.covariates["temperature_c"] - 20.0, ROBOT.target_offset) * 5e-4
    assert np.abs(whole - together - target).max() < 1e-9


@pytest.mark.parametrize("names", [*combinations(NAMES, 2), NAMES], ids="+".join)
def test_effects_together_act_in_the_order_of_the_chain(names: tuple[str, ...]) -> None:
    """Catches links in another order: where the sensor stands before beams, growth after drift, lean before joint
    errors."""
    agree(names, 5, 3.0)


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_at_zero_is_none(name: str) -> None:
    """Catches an effect that acts without having been given a size."""
    data, errors = run(3)
    plain, model = model_of(()), model_of((name,), dict.fromkeys(SETTINGS, np.full(4, 100.0)))
    values = values_of(plain, errors, {})
    padded = np.concatenate([values, np.zeros(len(model.parameters) - len(values))])
    np.testing.assert_array_equal(model.predict(data, padded)[:, :3], plain.predict(data, values)[:, :3])


def richardson(model: sk.delta.DeltaModel, data: sk.Measurements, values: Floats, k: int) -> Floats:
    """Derivative of the readings by the k-th value: central differences at three steps, extrapolated to zero."""
    # the step moves the point by about 0.1 mm
    h = 0.1 / model.parameters[k].lever_mm
    if model.parameters[k].unit == "1/°C":
        h = 5e-3
    table = []
    for step in (h, h / 2, h / 4):
        ahead, behind = values.copy(), values.copy()
        ahead[k] += step
        behind[k] -= step
        table.append((model.predict(data, ahead) - model.predict(data, behind))[:, :3] / (2 * step))
    once = [(4 * b - a) / 3 for a, b in pairwise(table)]
    return (16 * once[1] - once[0]) / 15


@pytest.mark.parametrize("names", [*((n,) for n in NAMES), NAMES], ids="+".join)
def test_derivatives_are_those_of_the_readings(names: tuple[str, ...]) -> None:
    """Catches a derivative that forgets a link after its own, to 1e-7 of its largest entry."""
    planted = drawn(names, 7, 3.0)
    data, errors = run(7, planted)
    model = model_of(names, planted)
    values = values_of(model, errors, planted)
    exact = model.derivatives(data, values)[:, :3]
    for k, parameter in enumerate(model.parameters):
        difference = richardson(model, data, values, k)
        scale = np.abs(difference).max()
        assert scale > 0, parameter.name
        assert np.abs(exact[:, :, k] - difference).max() < 1e-7 * scale, parameter.name


def test_a_missing_column_is_named() -> None:
    """Catches an effect that takes a missing temperature for a number: the rows are refused with the reason."""
    data, errors = run(1, drawn(("thermal_growth",), 1, 1.0))
    bare = sk.from_frame(data.to_frame().drop("temperature_c"))
    model = model_of(("thermal_growth",))
    values = values_of(model, errors, {"thermal_growth": np.array([1e-4])})
    with pytest.raises(
        sk.errors.FitError, match="thermal_growth, in the model, cannot be computed without the column temperature_c"
    ):
        model.predict(bare, values)
    with pytest.raises(sk.errors.EffectError, match="temperature_c"):
        sk.Study(EXAMPLE, bare).add("thermal_growth")


def test_rows_of_both_kinds_do_not_leak_into_each_other() -> None:
    """Catches derivatives of a distance that stay behind in the position after it, where rows share their room."""
    rng = np.random.default_rng(8)
    q = 128.0 + rng.uniform(-5, 5, (40, 3))
    robot = sk.delta.Delta(
        (90.0,) * 3, (90.0, 210.0, 330.0), (30.0,) * 3, (90.0, 210.0, 330.0), (120.0,) * 3,
        rod_spacing_mm=40.0, target_offset_mm=(0.0, 0.0, -25.0),
    )  # fmt: skip
    model = sk.delta.DeltaModel(robot, effects=(sk.delta.CATALOGUE["beam_alignment"],))
    places = robot.forward_batch(q).values
    far = np.arange(40) % 2 == 0
    other = np.roll(q, 1, axis=0)
    distance = np.linalg.norm(robot.forward_batch(other).values - places, axis=1)
    columns = {f"q{k + 1}_mm": q[:, k] for k in range(3)}
    columns |= {f"to_q{k + 1}_mm": np.where(far, other[:, k], np.nan) for k in range(3)}
    columns |= {
        f"{a}_mm": np.where(far, np.nan, places[:, k] + 1e-3 * rng.normal(size=40)) for k, a in enumerate("xyz")
    }
    columns |= {"distance_mm": np.where(far, distance, np.nan)}
    mixed = sk.from_frame(columns)
    sorted_rows = mixed.select(np.argsort(far, kind="stable"))
    one, two = sk.identify(model, mixed), sk.identify(model, sorted_rows)
    np.testing.assert_allclose(one.values, two.values, rtol=0, atol=1e-9)
