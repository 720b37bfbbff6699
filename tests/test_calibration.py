"""The model to deploy: its inverse, its Jacobian, no jump at the region's border, files without loss, honest accuracy.

Levels: as in test_identification, the chance of failure over the choice of the (fixed) seed.
"""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import cache

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import example, given, settings
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation
from scipy.special import comb

from running import slow
from second_simulator import Robot, truth
from sherkit import SherkitError, SherkitWarning, calibrate
from sherkit.calibration import Result
from sherkit.errors import CalibrationError, NotFinite, OutOfReach, ShapeError
from sherkit.model.effect import effects_by_name
from sherkit.model.sensor_pose import POSE
from sherkit.robots.delta import (
    CATALOGUE,
    Correction,
    DeltaCalibration,
    DeltaModel,
    VirtualDelta,
    grid,
    paper_local,
    paper_whole,
)
from sherkit.robots.delta.calibration import DeltaPart
from strategies import EXAMPLE, between, triples

Floats = NDArray[np.float64]

#: Of what takes long, fewer inputs than others have.
SOME = settings(max_examples=max(15, settings().max_examples // 8), deadline=None)
SEEDS = st.integers(0, 2**32 - 1)
MODEL = DeltaModel(EXAMPLE)
#: Effects at every link of the chain, some of which ask for temperature and direction.
EFFECTS = ("joint_scale", "backlash", "rail_lean", "thermal_growth", "beam_alignment")
SOME_EFFECTS = st.sampled_from([(), ("rail_lean", "beam_alignment"), EFFECTS])
#: Half width of the region of interest and of the blend around it, mm.
HALF, BLEND = 10.0, 2.5


def correction(rng: np.random.Generator, box_mm: float, size_mm: float = 0.05) -> Correction:
    """Random orders in x, y, z; zero, which makes a side infinite, among them."""
    orders = tuple(int(n) for n in rng.integers(0, 5, 3))
    side = np.where(np.array(orders) > 0, box_mm, np.inf)
    count = int(np.prod(np.array(orders) + 1))
    return Correction(orders, -side, side, 0.3 * box_mm, size_mm * rng.normal(size=(count, 3)))


def spread(rng: np.random.Generator, size: Floats) -> Floats:
    """A random covariance with standard deviations of about ``size``."""
    root = size[:, None] * rng.normal(size=(len(size), len(size))) / np.sqrt(len(size))
    return root @ root.T


def sizes(effects: tuple[str, ...] = ()) -> Floats:
    return np.array([p.size for p in DeltaModel(EXAMPLE, MODEL.free, effects_by_name(CATALOGUE, effects)).parameters])


SIZES = sizes()
#: Where the numbers of the sensor's pose stand among them.
STANDS = [k for k, name in enumerate(MODEL.free) if name in POSE]


def part(
    rng: np.random.Generator, values: Floats, box_mm: float, *, corrected: bool = True, effects: tuple[str, ...] = ()
) -> DeltaPart:
    """A part of a robot whose sensor stands where the values have it, with a box about where that sees the base."""
    model = DeltaModel(EXAMPLE, MODEL.free, effects_by_name(CATALOGUE, effects))
    turn, origin = model.sensor_frame(values, slipped=True)
    return DeltaPart(
        free=MODEL.free,
        effects=effects,
        settings=dict.fromkeys(MODEL.settings(), 0.0),
        left_out=(),
        now=(1000.0, 20.0 + rng.uniform(0.0, 5.0), *rng.choice((-1.0, 0.0, 1.0), 3).tolist()),
        values=values,
        covariance=spread(rng, 1e-3 * sizes(effects)),
        residual_covariance=spread(rng, np.full(3, 0.005)),
        uncorrected_covariance=spread(rng, np.full(3, 0.05)),
        low=origin - box_mm,
        high=origin + box_mm,
        sensor_turn=turn,
        sensor_origin_mm=origin,
        correction=correction(rng, box_mm) if corrected else None,
        made_from="a test",
        rows=int(rng.integers(1, 10_000)),
    )


def made(
    seed: int,
    *,
    apart: float = 0.01,
    local: bool = True,
    blend_mm: float | None = None,
    effects: tuple[str, ...] = (),
) -> DeltaCalibration:
    """A random calibration; the local model's parameters are ``apart`` plausible sizes from the whole one's.

    Both corrections' boxes end where nothing else does, at 24 and 14 mm.
    """
    rng = np.random.default_rng(seed)
    size = sizes(effects)
    values = 0.3 * size * rng.normal(size=len(size))
    whole = part(rng, values, 24.0, effects=effects)
    # it is the same instrument
    moved = apart * size * rng.normal(size=len(size))
    moved[STANDS] = 0.0
    inner = part(rng, values + moved, 14.0, effects=effects) if local else None
    return DeltaCalibration(EXAMPLE, whole, inner, HALF if local else None, blend_mm)


def seen(c: DeltaCalibration, x: ArrayLike) -> Floats:
    """A place (3,), or places (n, 3), of the base as the sensor sees them, mm."""
    at = np.asarray(x, dtype=float)
    return c.to_sensor(at.reshape(-1, 3)).reshape(at.shape)


@cache
def experiment(seed: int, lean: float) -> tuple[VirtualDelta, Result]:
    """A robot with these leaning rails and crossed beams, measured everywhere and in its region, and calibrated."""
    robot = VirtualDelta.draw(EXAMPLE, seed, rail_lean_rad=lean, beam=lean, noise_mm=0.005)
    whole = robot.measure(paper_whole()[::2], repeats=2, seed=seed)
    local = robot.measure(paper_local()[::2], repeats=2, seed=seed + 1000)
    return robot, calibrate(EXAMPLE, whole, local, seed=seed)


# -- forward, inverse, Jacobian ------------------------------------------------------------------------------


def test_a_place_far_from_the_run_is_said_once() -> None:
    """Catches silence where nothing like the place was measured, a warning among the poses, and one for each step."""
    whole = part(np.random.default_rng(0), np.zeros(len(SIZES)), 2.0, corrected=False)
    calibration = DeltaCalibration(EXAMPLE, whole)
    calibration.inverse([5.0, 0.0, 0.0])
    with pytest.warns(SherkitWarning, match="12, 0, 0 mm is 10 mm beyond the poses of a test, which cover 4 mm"):
        first = calibration.inverse([12.0, 0.0, 0.0])
    assert np.array_equal(calibration.inverse([12.0, 0.0, 0.0]), first)
    with pytest.warns(SherkitWarning, match="beyond the poses"):
        pickle.loads(pickle.dumps(calibration)).inverse([12.0, 0.0, 0.0])


@given(SEEDS, triples(-22.0, 22.0), st.booleans(), SOME_EFFECTS)
def test_forward_undoes_inverse_to_a_nanometre(
    seed: int, x: tuple[float, float, float], local: bool, effects: tuple[str, ...]
) -> None:
    """Catches an inverse that forgets datum, effects, correction or blend, or stops early: 1 nm everywhere."""
    c = made(seed, local=local, effects=effects)
    for frame, place in (("base", np.array(x)), ("sensor", seen(c, x))):
        joints = c.inverse(place, frame=frame)
        assert np.abs(c.forward(joints, frame=frame) - place).max() < 1e-6


@given(SEEDS, triples(-22.0, 22.0), SOME_EFFECTS)
def test_inverse_undoes_forward(seed: int, x: tuple[float, float, float], effects: tuple[str, ...]) -> None:
    """Catches an inverse that finds other joints than those the robot has: a fold, or another assembly."""
    c = made(seed, effects=effects)
    q = EXAMPLE.inverse(x)
    np.testing.assert_allclose(c.inverse(c.forward(q)), q, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_measured_robot_round_trip() -> None:
    """Catches what random numbers do not have: a calibration as it comes from two runs, on a fine grid."""
    c = experiment(0, 0.01)[1].calibration
    assert c.local is not None
    assert c.whole.correction is not None
    x = np.concatenate([grid(20.0, 15, (-20.0, -7.0, 0.0, 11.0, 20.0)), grid(12.5, 15, (-10.0, 3.0, 11.0))])
    q = c.inverse_batch(x).require()
    np.testing.assert_allclose(c.forward_batch(q).require(), x, rtol=0, atol=1e-6)


@SOME
@given(SEEDS)
def test_forward_is_the_sum_of_its_parts(seed: int) -> None:
    """Catches a part left out, or taken at the wrong place: geometry, datum, binomials and blend put together here."""
    c = made(seed)
    assert c.local is not None
    q = EXAMPLE.inverse_batch(np.random.default_rng(seed).uniform(-16.0, 16.0, (200, 3))).require()
    whole, local = _branch(c.whole, q), _branch(c.local, q)
    beyond = np.maximum(np.abs(c.from_sensor(whole)) - HALF, 0.0) / BLEND
    share = np.where(beyond < 1, 1 - beyond**2 * (3 - 2 * beyond), 0.0).prod(axis=1)
    expected = whole + share[:, None] * (local - whole)
    np.testing.assert_allclose(c.forward_batch(q).require(), expected, rtol=0, atol=1e-9)
    assert (share == 1).any()  # inside
    assert (share == 0).any()  # and outside


@SOME
@given(SEEDS, SOME_EFFECTS)
def test_jacobian_against_differences(seed: int, effects: tuple[str, ...]) -> None:
    """Catches a slope of correction or blend left out: sixth-order differences inside, in the blend and beyond."""
    c = made(seed, effects=effects)
    rng = np.random.default_rng(seed)
    step = 1e-3
    x = rng.choice((-1.0, 1.0), (30, 3)) * rng.choice((5.0, 9.0, 11.0, 12.0, 13.0, 18.0), (30, 3))
    x += rng.uniform(-0.9, 0.9, x.shape)
    q = c.inverse_batch(x, frame="base").require()
    assert c.local is not None
    # the second derivative jumps where a blend or fade begins and ends, the first where a correction is held
    kinks = np.array([HALF, HALF + BLEND, 14.0, 14.0 * 1.3, 24.0, 24.0 * 1.3])
    bare = [DeltaCalibration(EXAMPLE, replace(p, correction=None, now=c.whole.now)) for p in (c.whole, c.local)]
    own = [m.forward_batch(q).require() for m in (DeltaCalibration(EXAMPLE, c.whole), *bare)]
    own = [c.from_sensor(one) for one in own]
    smooth = np.min([np.abs(np.abs(p)[:, :, None] - kinks).min(axis=(1, 2)) for p in own], axis=0) > 0.02
    assert smooth.sum() > 5
    for row in q[smooth]:
        numeric = np.empty((3, 3))
        for k in range(3):
            h = step * np.eye(3)[k]
            one, two, three = (c.forward(row + m * h) - c.forward(row - m * h) for m in (1, 2, 3))
            numeric[:, k] = (45 * one - 9 * two + three) / (60 * step)
        np.testing.assert_allclose(c.jacobian(row), numeric, rtol=0, atol=1e-7)


@SOME
@given(SEEDS, st.integers(0, 20), SOME_EFFECTS)
def test_batches_equal_single_calls_bit_for_bit(seed: int, count: int, effects: tuple[str, ...]) -> None:
    """Catches rows mixed up, or a miss that spreads: every third row is out of reach or no number."""
    c = made(seed, effects=effects)
    rng = np.random.default_rng(seed)
    x = rng.uniform(-20.0, 20.0, (count, 3))
    q = EXAMPLE.inverse_batch(x).require() if count else np.zeros((0, 3))
    bad = np.arange(count) % 3 == 2
    for rows in (x, q):
        rows[bad, 1] = np.resize([1e6, np.nan, -np.inf], bad.sum())
    for batch, single, rows in (
        (c.forward_batch, c.forward, q),
        (c.jacobian_batch, c.jacobian, q),
        (c.inverse_batch, c.inverse, seen(c, x)),
    ):
        result = batch(rows)
        np.testing.assert_array_equal(result.reached, ~bad)
        assert np.isnan(result.values[bad]).all()
        for k in np.flatnonzero(~bad):
            np.testing.assert_array_equal(result.values[k], single(rows[k]))
        for k in np.flatnonzero(bad):
            with pytest.raises((OutOfReach, NotFinite)):
                single(rows[k])


@SOME
@given(SEEDS, triples(-15.0, 15.0), between(15.0, 30.0), st.tuples(*[st.sampled_from((-1.0, 1.0))] * 3))
def test_effects_run_in_the_loop_as_in_the_second_simulator(
    seed: int, x: tuple[float, float, float], temperature: float, direction: tuple[float, ...]
) -> None:
    """Catches an effect that the loop leaves out, or temperature and direction that do not arrive there."""
    rng = np.random.default_rng(seed)
    size = sizes(EFFECTS)
    one = part(rng, 0.3 * size * rng.normal(size=len(size)), 24.0, corrected=False, effects=EFFECTS)
    c = DeltaCalibration(EXAMPLE, one)
    q = EXAMPLE.inverse(x)
    errors = dict(zip(one.free, one.values.tolist(), strict=False))
    effects: dict[str, Floats] = {"sensor_pose": np.array([errors.pop(name) for name in POSE])}
    rest = one.values[len(one.free) :]
    for name, count in (("joint_scale", 3), ("backlash", 3), ("rail_lean", 6), ("thermal_growth", 1),
                        ("beam_alignment", 9)):  # fmt: skip
        effects[name], rest = rest[:count], rest[count:]
    assert len(rest) == 0
    # the row before it is where each joint comes from
    rows = np.stack([q - np.array(direction), q])
    columns = {f"q{k + 1}_mm": rows[:, k] for k in range(3)} | {
        "time_s": np.array([0.0, 3.0]),
        "temperature_c": np.full(2, temperature),
        "humidity_pct": np.full(2, 45.0),
    }
    expected = truth(Robot.from_dict(EXAMPLE.to_tables()), columns, errors, effects)[1]
    np.testing.assert_allclose(
        c.forward(q, temperature_c=temperature, direction=direction), expected, rtol=0, atol=1e-8
    )
    back = c.inverse(expected, temperature_c=temperature, direction=direction)
    np.testing.assert_allclose(back, q, rtol=0, atol=1e-6)
    for many, one in ((c.forward_batch, c.forward), (c.jacobian_batch, c.jacobian)):
        told = many([q], temperature_c=temperature, direction=direction).require()[0]
        np.testing.assert_array_equal(told, one(q, temperature_c=temperature, direction=direction))


def test_covariates_left_out_are_those_of_the_run() -> None:
    """Catches a default of 20 °C or no direction where the calibration knows better."""
    c = made(4, effects=EFFECTS)
    q = EXAMPLE.inverse([3.0, -4.0, 5.0])
    _, temperature, *direction = c.whole.now
    np.testing.assert_array_equal(c.forward(q), c.forward(q, temperature_c=temperature, direction=direction))
    np.testing.assert_array_equal(c.forward(q), c.forward_batch([q]).require()[0])
    assert np.abs(c.forward(q) - c.forward(q, temperature_c=temperature + 10.0)).max() > 1e-5
    assert np.abs(c.forward(q) - c.forward(q, direction=[-2.0 * d or 1.0 for d in direction])).max() > 1e-4


# -- the border of the region --------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [*range(4), *slow(*range(4, 10))])
def test_no_jump_on_the_way_across_the_border(seed: int) -> None:
    """Catches a switch: the two models differ by more than 20 µm at the border, and steps of 1 µm stay of that size.

    The blend may stretch a step by difference × 1.5 / width, and the geometry by the norm of its Jacobian.
    """
    c = made(seed, apart=0.05)
    jump = c.border_jump_mm()
    assert jump is not None
    assert jump > 0.02
    rng = np.random.default_rng(seed)
    for _ in range(5):
        inside, outside = rng.uniform(-8.0, 8.0, 3), rng.uniform(-8.0, 8.0, 3)
        axis = rng.integers(3)
        outside[axis] = rng.choice((-15.0, 15.0))
        ends = EXAMPLE.inverse_batch(np.stack([inside, outside])).require()
        count = int(np.linalg.norm(ends[1] - ends[0]) / 1e-3)
        path = ends[0] + np.linspace(0.0, 1.0, count)[:, None] * (ends[1] - ends[0])
        steps = np.linalg.norm(np.diff(c.forward_batch(path).require(), axis=0), axis=1)
        smooth = np.linalg.norm(np.diff(EXAMPLE.forward_batch(path).require(), axis=0), axis=1)
        assert (np.abs(steps - smooth) < 1e-3 * (0.2 + 1.5 * 2.0 * jump / BLEND)).all()


def test_local_model_rules_inside_and_whole_model_beyond() -> None:
    """Catches a blend that starts inside the region or never ends."""
    c = made(3)
    assert c.local is not None
    for low, high, alone in ((0.0, 9.5, c.local), (13.0, 20.0, c.whole)):
        x = np.random.default_rng(3).uniform(low, high, (50, 3))
        q = c.inverse_batch(x, frame="base").require()
        expected = DeltaCalibration(EXAMPLE, alone).forward_batch(q).require()
        np.testing.assert_allclose(c.forward_batch(q).require(), expected, rtol=0, atol=1e-12)


def test_border_jump_is_the_largest_difference_there() -> None:
    """Catches a jump measured in one corner only, or inside: a dense look at the border finds at most 10 % more."""
    for seed in range(5):
        c = made(seed)
        jump = c.border_jump_mm()
        assert c.local is not None
        faces = np.random.default_rng(seed).uniform(-HALF, HALF, (2000, 3))
        faces[np.arange(2000), np.arange(2000) % 3] = np.resize([HALF, -HALF], 2000)
        faces = seen(c, faces)
        q = DeltaCalibration(EXAMPLE, c.whole).inverse_batch(faces).require()
        there = DeltaCalibration(EXAMPLE, c.local).forward_batch(q).require()
        assert jump == pytest.approx(np.linalg.norm(there - faces, axis=1).max(), rel=0.1)
    assert made(0, local=False).border_jump_mm() is None


@given(SEEDS, triples(-14.0, 14.0))
def test_folded_models_are_never_inverted_wrongly(seed: int, x: tuple[float, float, float]) -> None:
    """Catches joints given for a place that the model does not put there: here the two models are millimetres apart."""
    c = made(seed, apart=3.0, blend_mm=0.5)
    try:
        q = c.inverse(x)
    except SherkitError:
        assert not c.inverse_batch([x]).reached[0]
    else:
        assert np.abs(c.forward(q) - x).max() < 1e-6


# -- what goes in wrong --------------------------------------------------------------------------------------


def test_wrong_input_is_refused() -> None:
    """Catches NaN that comes out again, a batch taken for a pose, and a miss without its limb."""
    c = made(1)
    for call in (c.forward, c.jacobian, c.inverse, c.accuracy, c.measured):
        for bad in (np.nan, np.inf):
            with pytest.raises(NotFinite):
                call([0.0, bad, 0.0])
        with pytest.raises(ShapeError):
            call(np.zeros((1, 3)))
    for batch in (c.forward_batch, c.jacobian_batch, c.inverse_batch):
        with pytest.raises(ShapeError):
            batch([0.0, 0.0, 0.0])
    for call in (c.inverse, c.accuracy):
        with pytest.raises(OutOfReach, match=r"limb 1 is \d+\.\d+ mm too short") as caught:
            call([0.0, -200.0, 0.0])
        assert caught.value.limb == 1


@pytest.mark.filterwarnings("ignore::sherkit.SherkitWarning")  # most places are far from the run
@settings(max_examples=200, deadline=None)
@given(st.tuples(*[st.floats(allow_nan=True, allow_infinity=True)] * 3))
@example((1e308, 1e308, 1e308))
@example((1e308, -1e308, 0.0))
@example((0.0, 0.0, 1e17))
def test_no_number_raises_anything_else_or_gives_what_is_none(row: tuple[float, float, float]) -> None:
    """Catches overflow: any float gives finite numbers or a SherkitError, and batches mark the same rows."""
    c = made(2)
    for single, batch in ((c.forward, c.forward_batch), (c.jacobian, c.jacobian_batch), (c.inverse, c.inverse_batch)):
        try:
            value = single(row)
        except SherkitError:
            assert not batch([row]).reached[0]
        else:
            assert np.isfinite(value).all()
            np.testing.assert_array_equal(batch([row]).require()[0], value)


def test_local_model_and_region_go_together() -> None:
    """Catches a local model that is silently never used."""
    c = made(0)
    with pytest.raises(CalibrationError, match="half width"):
        DeltaCalibration(EXAMPLE, c.whole, c.local)
    with pytest.raises(CalibrationError, match="half width"):
        DeltaCalibration(EXAMPLE, c.whole, None, HALF)


def test_half_width_may_be_a_whole_number() -> None:
    """Catches 10 taken for something else than 10.0, in Python or in a file edited by hand."""
    c = made(0)
    whole = DeltaCalibration(EXAMPLE, c.whole, c.local, 10)
    q = EXAMPLE.inverse([1.0, 2.0, 3.0])
    np.testing.assert_array_equal(whole.forward(q), c.forward(q))


# -- helpers -------------------------------------------------------------------------------------------------


def _branch(one: DeltaPart, joints_mm: Floats) -> Floats:
    """Readings (n, 3) of one part: nominal kinematics with its errors, offset, binomials on top, and where its sensor
    stands."""
    assert not one.effects
    errors = dict(zip(one.free, one.values.tolist(), strict=True))
    pose = np.array([errors.pop(name) for name in POSE])
    seen = Rotation.from_rotvec(pose[:3])
    x, reached = EXAMPLE.kinematics(errors).forward_batch(np.ascontiguousarray(joints_mm))
    assert reached.all()
    x = x + np.array(EXAMPLE.target_offset_mm)
    c = one.correction
    if c is None:
        return np.asarray(seen.apply(x) + pose[3:])
    used = np.array(c.orders) > 0
    low, span = np.where(used, c.low_mm, 0.0), np.where(used, c.high_mm - c.low_mm, 1.0)
    t = np.where(used, np.clip((x - low) / span, 0.0, 1.0), 0.0)
    b = [comb(n, np.arange(n + 1)) * t[:, [k]] ** np.arange(n + 1) * (1 - t[:, [k]]) ** (n - np.arange(n + 1))
         for k, n in enumerate(c.orders)]  # fmt: skip
    value = np.einsum("ni,nj,nk,ijka->na", *b, c.coefficients_mm.reshape(*(n + 1 for n in c.orders), 3))
    far = np.maximum(np.maximum(x - c.high_mm, c.low_mm - x), 0.0) / c.fade_mm
    x = x + value * np.where(far < 1, 1 - far**2 * (3 - 2 * far), 0.0).prod(axis=1)[:, None]
    return np.asarray(seen.apply(x) + pose[3:])
