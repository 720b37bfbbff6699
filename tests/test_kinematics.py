"""Kinematics of random deltas: inverse of each other, right derivatives, honest about what is out of reach."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from numpy.typing import NDArray

from second_simulator import Robot, truth
from sherkit import SherkitError
from sherkit.errors import NotFinite, OutOfReach, ShapeError, Singular
from sherkit.robots.delta import Delta, VirtualDelta
from strategies import EXAMPLE, between, deltas, posed_deltas, triples

Floats = NDArray[np.float64]

# times are nobody's business here, so hypothesis has no deadline
SOME = settings(max_examples=max(20, settings().max_examples // 8), deadline=None)

ABOVE = Delta(
    base_radius_mm=(90.0, 95.0, 88.0),
    base_angle_deg=(80.0, -35.0, -160.0),
    platform_radius_mm=(30.0, 28.0, 33.0),
    platform_angle_deg=(82.0, -38.0, -158.0),
    rod_length_mm=(120.0, 130.0, 115.0),
    target_offset_mm=(3.0, -2.0, 10.0),
    assembly_mode="above",
)
ROBOTS = pytest.mark.parametrize("robot", [EXAMPLE, ABOVE], ids=["below", "above"])


# -- there and back ------------------------------------------------------------------------------------------


@given(posed_deltas())
def test_forward_undoes_inverse(case: tuple[Delta, Floats]) -> None:
    """Catches a wrong sign, a wrong assembly side, a forgotten target offset, lost digits: 1e-9 mm there and back."""
    robot, (x,) = case
    assert np.abs(robot.forward(robot.inverse(x)) - x).max() < 1e-9


@given(posed_deltas())
def test_inverse_undoes_forward(case: tuple[Delta, Floats]) -> None:
    """Catches what the other direction hides: joints of another assembly that lead to the same place."""
    robot, (x,) = case
    q = robot.inverse(x)
    assert np.abs(robot.inverse(robot.forward(q)) - q).max() < 1e-9


@given(posed_deltas())
def test_platform_is_on_the_assembled_side(case: tuple[Delta, Floats]) -> None:
    """Catches a solution whose rods have the right length but stand on the wrong side of a carriage."""
    robot, (x,) = case
    rise = robot.inverse(x) - (x - np.array(robot.target_offset_mm))[2]
    assert (rise > 0).all() if robot.assembly_mode == "below" else (rise < 0).all()


@given(posed_deltas())
def test_assembly_modes_mirror_each_other(case: tuple[Delta, Floats]) -> None:
    """Catches a mode that is treated differently in one place: standing is hanging, upside down, bit for bit."""
    robot, (x,) = case
    offset = np.array(robot.target_offset_mm)
    below, above = (Delta(**{**_fields(robot), "target_offset_mm": (0.0, 0.0, 0.0), "assembly_mode": mode})
                    for mode in ("below", "above"))  # fmt: skip
    flip = np.array([1.0, 1.0, -1.0])
    q = below.inverse(x - offset)
    np.testing.assert_array_equal(above.inverse((x - offset) * flip), -q)
    np.testing.assert_array_equal(above.forward(-q), below.forward(q) * flip)


# -- derivatives ---------------------------------------------------------------------------------------------


@SOME
@given(posed_deltas())
def test_jacobian_against_sixth_order_differences(case: tuple[Delta, Floats]) -> None:
    """Catches a wrong velocity Jacobian, or one that belongs to the transposed matrix."""
    robot, (x,) = case
    q = robot.inverse(x)
    numeric = np.stack([_difference(lambda t, k=k: robot.forward(q + t * np.eye(3)[k]), 0.02) for k in range(3)], 1)
    np.testing.assert_allclose(robot.jacobian(q), numeric, rtol=0, atol=1e-7 * np.abs(numeric).max())


@SOME
@given(posed_deltas())
def test_parameter_derivative_against_sixth_order_differences(case: tuple[Delta, Floats]) -> None:
    """Catches any of the 18 columns being wrong, misplaced, or in degrees."""
    robot, (x,) = case
    q = robot.inverse(x)
    analytic = robot.parameter_jacobian(q[None, :]).require()[0]
    for k, name in enumerate(robot.parameter_names):
        step, least = (2e-4, 1.0) if "angle" in name else (0.02, 0.05)
        numeric = _difference(lambda t, name=name: robot.kinematics({name: t}).forward(q), step)
        # a column may be zero but for rounding
        scale = max(np.abs(numeric).max(), least)
        np.testing.assert_allclose(analytic[:, k], numeric, rtol=0, atol=1e-7 * scale, err_msg=name)


@given(posed_deltas())
def test_derivatives_against_complex_steps(case: tuple[Delta, Floats]) -> None:
    """Catches what differences are too coarse for: Newton on the rod lengths in complex NumPy gives every digit."""
    robot, (x,) = case
    q = robot.inverse(x)
    platform = x - np.array(robot.target_offset_mm)
    steps = 1e-30j * np.eye(21)
    moved = [_newton(robot.geometry + s[:18], q + s[18:], platform, robot.assembly_mode) for s in steps]
    exact = np.stack(moved, axis=1).imag / 1e-30
    analytic = np.hstack([robot.parameter_jacobian(q[None, :]).require()[0], robot.jacobian(q)])
    scale = np.maximum(np.abs(exact).max(axis=0), 1e-3)
    assert (np.abs(analytic - exact) / scale).max() < 1e-9


@SOME
@given(deltas(), between(0.01, 0.2), between(-20.0, 20.0))
def test_joint_offset_moves_like_its_joint(robot: Delta, offset: float, z: float) -> None:
    """Catches an offset with the wrong sign: +δq and a joint reading lower by δq are the same carriage."""
    q = robot.inverse(np.array([0.0, 0.0, z]) + np.array(robot.target_offset_mm))
    for limb in range(3):
        shifted = q - offset * np.eye(3)[limb]
        moved = robot.kinematics({f"joint_offset_{limb + 1}": offset}).forward(shifted)
        np.testing.assert_allclose(moved, robot.kinematics().forward(q), rtol=0, atol=1e-9)


# -- the same numbers another way ----------------------------------------------------------------------------


@SOME
@given(posed_deltas(count=4, most=0.6))
def test_forward_against_newton_of_the_virtual_delta(case: tuple[Delta, Floats]) -> None:
    """Catches a common error of forward and inverse: the simulation solves the rod lengths by Newton in NumPy."""
    robot, x = case
    q = robot.inverse_batch(x).require()
    np.testing.assert_allclose(VirtualDelta(robot).true_reading(q), robot.forward_batch(q).require(), rtol=0, atol=1e-9)


@SOME
@given(posed_deltas(count=4, most=0.6, height_mm=50.0, assembly_modes=("below",)), st.integers(0, 2**32 - 1))
def test_forward_against_the_second_simulator(case: tuple[Delta, Floats], seed: int) -> None:
    """Catches a misread drawing: six single rods, platform free to tilt, written by other hands; errors in all 18."""
    robot, x = case
    # its home is where the measured point is at zero: the platform's centre can always be there
    x = x - np.array(robot.target_offset_mm)
    robot = Delta(**_fields(robot))
    q = robot.inverse_batch(x).require()
    rng = np.random.default_rng(seed)
    errors = {n: rng.normal() * (1e-3 if "angle" in n else 0.1) for n in robot.parameter_names}
    config = robot.to_tables() | {"joints": {"pole_pitch_mm": 2.0}, "workspace": {"radius_mm": 1.0}}
    config["geometry"]["rod_spacing_mm"] = 40.0  # what keeps its platform level
    still = {name: np.zeros(len(q)) for name in ("time_s", "humidity_pct", "temperature_c")}
    there = truth(Robot.from_dict(config), still | {f"q{k + 1}_mm": q[:, k] for k in range(3)}, errors)
    here, reached = robot.kinematics(errors).forward_batch(q)
    assert reached.all()
    np.testing.assert_allclose(here, there, rtol=0, atol=1e-9)


# -- batches -------------------------------------------------------------------------------------------------


@ROBOTS
@pytest.mark.parametrize("count", range(21))
def test_batch_equals_single_bit_for_bit(robot: Delta, count: int) -> None:
    """Catches lanes that mix or drop rows: every length up to two blocks and a half, misses in between."""
    rng = np.random.default_rng(count)
    x = rng.uniform(-60.0, 60.0, (count, 3)) * np.array([1.5, 1.5, 1.0])
    q = rng.uniform(20.0, 240.0, (count, 3)) * (1.0 if robot.assembly_mode == "below" else -1.0)
    for batch, single, rows in (
        (robot.inverse_batch, robot.inverse, x),
        (robot.forward_batch, robot.forward, q),
        (robot.parameter_jacobian, lambda row: robot.parameter_jacobian(row[None, :]).require()[0], q),
    ):
        got = batch(rows)
        wanted = [_or_none(single, row) for row in rows]
        assert got.values.shape[0] == got.reached.shape[0] == count
        assert got.reached.tolist() == [w is not None for w in wanted]
        for value, want in zip(got.values, wanted, strict=True):
            np.testing.assert_array_equal(value, np.full_like(value, np.nan) if want is None else want)


def test_both_outcomes_occur_in_the_batches_above() -> None:
    """Catches a batch test without misses (or without hits), which would prove nothing."""
    x = np.random.default_rng(20).uniform(-60.0, 60.0, (20, 3)) * np.array([1.5, 1.5, 1.0])
    assert 0 < EXAMPLE.inverse_batch(x).reached.sum() < 20
    q = np.random.default_rng(20).uniform(20.0, 240.0, (20, 3))
    assert 0 < EXAMPLE.forward_batch(q).reached.sum() < 20


@ROBOTS
@pytest.mark.parametrize("row", range(9))
@pytest.mark.parametrize("spoil", [np.nan, np.inf, -np.inf, 1e6])
def test_bad_row_is_marked_and_leaves_the_others_alone(robot: Delta, row: int, spoil: float) -> None:
    """Catches a NaN or a miss that spreads along its lane, block or batch."""
    x = np.random.default_rng(4).uniform(-15.0, 15.0, (9, 3)) + np.array(robot.target_offset_mm)
    q = robot.inverse_batch(x).require()
    for batch, good in ((robot.inverse_batch, x), (robot.forward_batch, q), (robot.parameter_jacobian, q)):
        spoilt = good.copy()
        spoilt[row, row % 2] = spoil
        result, clean = batch(spoilt), batch(good)
        others = np.arange(9) != row
        assert result.reached.tolist() == others.tolist()
        assert np.isnan(result.values[row]).all()
        np.testing.assert_array_equal(result.values[others], clean.values[others])
        with pytest.raises(OutOfReach, match=rf"rows {row} \(counted from 0\) cannot be reached \(first: row {row}: "):
            result.require()


# -- out of reach --------------------------------------------------------------------------------------------


@given(deltas(), between(0.0, 2.0 * np.pi), between(1.01, 3.0), between(-50.0, 50.0))
def test_inverse_out_of_reach_names_limb_and_distance(robot: Delta, turn: float, far: float, z: float) -> None:
    """Catches a wrong limb or distance: with its rod longer by that much, the limb just reaches."""
    direction = np.array([np.cos(turn), np.sin(turn)])
    x = np.array([*(direction * far * (max(robot.rod_length_mm) + 160.0)), z])
    with pytest.raises(OutOfReach) as caught:
        robot.inverse(x + np.array(robot.target_offset_mm))
    limb, miss = caught.value.limb, caught.value.miss_mm
    assert limb in (1, 2, 3)
    assert miss > 0
    assert f"the rod of limb {limb} is {miss:.4f} mm too short" in str(caught.value)
    assert _limb_short(robot.kinematics({f"rod_length_{limb}": miss - 1e-6}).inverse, x) == limb
    assert _limb_short(robot.kinematics({f"rod_length_{limb}": miss + 1e-6}).inverse, x) != limb


@given(deltas(), st.sampled_from((0, 1, 2)), between(1.0, 4.0), st.sampled_from((1.0, -1.0)))
def test_forward_out_of_reach_names_limb_and_distance(robot: Delta, limb: int, far: float, way: float) -> None:
    """Catches a wrong culprit where one joint strays: with that limb's rod corrected, the spheres just touch."""
    q = robot.inverse(robot.target_offset_mm)
    q[limb] += way * far * sum(robot.rod_length_mm)
    with pytest.raises(OutOfReach) as caught:
        robot.forward(q)
    assert caught.value.limb == limb + 1
    miss = caught.value.miss_mm
    assert miss > 0
    assert f"the rod of limb {limb + 1} is {miss:.4f} mm too short" in str(caught.value)
    name = f"rod_length_{limb + 1}"
    assert _limb_short(robot.kinematics({name: miss - 1e-6}).forward, q) == limb + 1
    assert _limb_short(robot.kinematics({name: miss + 1e-6}).forward, q) is None


def test_miss_at_the_very_border_is_small() -> None:
    """Catches a miss of hundreds of mm reported where rounding alone keeps the spheres apart."""
    rng = np.random.default_rng(0)
    misses = []
    for _ in range(50):
        q = EXAMPLE.inverse([0.0, 0.0, 0.0])
        q[rng.integers(3)] += rng.choice((-1.0, 1.0)) * rng.uniform(300.0, 900.0)
        with pytest.raises(OutOfReach) as caught:
            EXAMPLE.forward(q)
        try:
            EXAMPLE.kinematics({f"rod_length_{caught.value.limb}": caught.value.miss_mm}).forward(q)
        except OutOfReach as error:
            if "passed the horizontal" not in str(error):
                misses.append(abs(error.miss_mm))
    assert max(misses, default=0.0) < 1e-6


def test_sphere_inside_another_is_not_called_apart() -> None:
    """Catches a rod called too long by more than its own length: here sphere 1 lies inside sphere 2."""
    robot = Delta((70.0, 80.0, 80.0), (90.0, 210.0, 330.0), (30.0,) * 3, (90.0, 210.0, 330.0), (45.0, 150.0, 150.0))
    with pytest.raises(OutOfReach) as caught:
        robot.forward([100.0, 120.0, 330.0])
    limb, miss = caught.value.limb, caught.value.miss_mm
    assert robot.rod_length_mm[limb - 1] + miss > 0
    mended = robot.kinematics({f"rod_length_{limb}": miss + np.sign(miss) * 1e-6})
    assert _limb_short(mended.forward, np.array([100.0, 120.0, 330.0])) != limb


def test_limb_past_the_horizontal_is_named() -> None:
    """Catches a pose returned with a rod on the wrong side of its carriage, where the spheres do meet."""
    q = EXAMPLE.inverse([0.0, 0.0, 0.0]) - np.array([150.0, 0.0, 0.0])
    with pytest.raises(OutOfReach, match="limb 1 has passed the horizontal") as caught:
        EXAMPLE.forward(q)
    assert caught.value.limb == 1
    # the spheres do meet: NumPy finds the platform above carriage 1 by what the message says
    start = np.array([0.0, -60.0, q[1] - 100.0])
    x = _newton(EXAMPLE.geometry.astype(complex), q.astype(complex), start, "below", 40).real
    assert x[2] - q[0] == pytest.approx(caught.value.miss_mm, abs=1e-9)
    assert not EXAMPLE.forward_batch(q[None, :]).reached[0]


def test_rails_in_one_plane_are_singular() -> None:
    """Catches a division by zero where the three carriages stand in line and the platform is free to swing."""
    line = Delta((90.0, 10.0, 60.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (120.0, 120.0, 120.0))
    q = np.zeros(3)
    with pytest.raises(Singular, match="one plane"):
        line.forward(q)
    assert not line.forward_batch(q[None, :]).reached[0]
    assert not line.parameter_jacobian(q[None, :]).reached[0]


def test_jacobian_at_a_singular_pose_says_so() -> None:
    """Catches a singular pose that raises something else than promised: here all rods lie level."""
    with pytest.raises(Singular):
        EXAMPLE.jacobian([1e308, 1e308, 1e308])


# -- what is no number, and what is no triple ----------------------------------------------------------------


@SOME
@given(st.sampled_from((EXAMPLE, ABOVE)), st.integers(0, 2), st.sampled_from((np.nan, np.inf, -np.inf)))
def test_single_calls_refuse_what_is_not_finite(robot: Delta, at: int, bad: float) -> None:
    """Catches NaN that goes in and comes out again as a position."""
    row = [0.0, 0.0, 0.0]
    row[at] = bad
    for call in (robot.forward, robot.inverse, robot.jacobian):
        with pytest.raises(NotFinite, match="finite"):
            call(row)


@pytest.mark.parametrize("wrong", [0.0, [0.0], [0.0] * 2, [0.0] * 4, [[0.0] * 3], np.zeros((0, 3)), []])
def test_single_calls_refuse_wrong_shapes(wrong: Any) -> None:
    """Catches a batch or a pair taken for one pose."""
    for call in (EXAMPLE.forward, EXAMPLE.inverse, EXAMPLE.jacobian):
        with pytest.raises(ShapeError, match="expected 3 numbers"):
            call(wrong)


@pytest.mark.parametrize("wrong", [0.0, [0.0] * 3, np.zeros((2, 2)), np.zeros((2, 4)), np.zeros((1, 2, 3)), []])
def test_batches_refuse_wrong_shapes(wrong: Any) -> None:
    """Catches nine numbers cut into the wrong three rows."""
    for call in (EXAMPLE.forward_batch, EXAMPLE.inverse_batch, EXAMPLE.parameter_jacobian):
        with pytest.raises(ShapeError, match=r"shape \(n, 3\)"):
            call(wrong)


def test_batches_take_any_layout() -> None:
    """Catches rows read with the wrong strides: Fortran order, slices, integers and float32 are the same rows."""
    x = np.arange(12.0).reshape(4, 3)
    wanted = EXAMPLE.inverse_batch(x).require()
    wide = np.zeros((8, 6))
    wide[::2, ::2] = x
    for same in (np.asfortranarray(x), wide[::2, ::2], x.astype(np.int64), x.astype(np.float32), x.tolist()):
        np.testing.assert_array_equal(EXAMPLE.inverse_batch(same).require(), wanted)


_ANY = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)
_EXTREME = st.one_of(
    _ANY, st.sampled_from((0.0, -0.0, 5e-324, 2.2e-308, 1e16, 1e154, 1.4e154, 1e200, 1e308, 1.7e308, -1e308, -1.7e308))
)


@settings(max_examples=300, deadline=None)
@given(st.sampled_from((EXAMPLE, ABOVE)), st.tuples(_EXTREME, _EXTREME, _EXTREME))
@example(EXAMPLE, (1.7e308, 1.7e308, 1.7e308))
@example(EXAMPLE, (1e308, -1e308, 0.0))
@example(ABOVE, (0.0, 0.0, -1.7e308))
def test_no_number_raises_anything_else_or_gives_what_is_none(robot: Delta, row: tuple[float, float, float]) -> None:
    """Catches overflow: any float gives a finite answer or a SherkitError, and the batch marks the same rows."""
    for single, batch in (
        (robot.forward, robot.forward_batch),
        (robot.inverse, robot.inverse_batch),
        (robot.jacobian, None),
        (lambda r: robot.parameter_jacobian([r]).require(), robot.parameter_jacobian),
    ):
        value = _or_none(single, row)
        assert value is None or np.isfinite(value).all()
        if batch is not None:
            assert batch([row]).reached.tolist() == [value is not None]


@given(triples(20.0, 240.0))
def test_any_joints_in_reach_agree_with_their_own_inverse(joints: tuple[float, float, float]) -> None:
    """Catches joints far from any drawn pose that give a place with rods of other lengths."""
    x = _or_none(EXAMPLE.forward, joints)
    assume(x is not None)
    np.testing.assert_allclose(EXAMPLE.inverse(x), joints, rtol=0, atol=1e-6)


# -- helpers -------------------------------------------------------------------------------------------------


def _fields(robot: Delta) -> dict[str, Any]:
    names = ("base_radius_mm", "base_angle_deg", "platform_radius_mm", "platform_angle_deg", "rod_length_mm")
    return {name: getattr(robot, name) for name in names}


def _or_none(call: Callable[[Any], Floats], row: Any) -> Floats | None:
    """The value, or None where the call raises a SherkitError; any other exception goes through."""
    try:
        return call(row)
    except SherkitError:
        return None


def _limb_short(call: Callable[[Floats], Floats], row: Floats) -> int | None:
    """The limb whose rod does not reach; None where all do, on whichever side of the horizontal."""
    try:
        call(row)
    except OutOfReach as error:
        return None if "passed the horizontal" in str(error) else error.limb
    return None


def _difference(f: Callable[[float], Floats], h: float) -> Floats:
    """Central difference of sixth order."""
    one, two, three = (f(k * h) - f(-k * h) for k in (1, 2, 3))
    return (45.0 * one - 9.0 * two + three) / (60.0 * h)


def _newton(
    geometry: NDArray[np.complex128], joints: NDArray[np.complex128], start: Floats, mode: str, steps: int = 6
) -> NDArray[np.complex128]:
    """Platform centre (3,) from |x - s_i|² = l_i², without conjugates, so that imaginary steps carry through."""
    rb, tb, dq, rod, rp, tp = geometry.reshape(3, 6).T
    s = np.stack([rb * np.cos(tb) - rp * np.cos(tp), rb * np.sin(tb) - rp * np.sin(tp), dq + joints], axis=1)
    x = start.astype(complex)
    for _ in range(steps):
        rods = x - s
        x = x - np.linalg.solve(2.0 * rods, (rods**2).sum(axis=1) - rod**2)
    return x
