"""Instruments that read one number: an interferometer along one axis, a ball bar about a centre. Their worlds stand
here, and share nothing with the product but the names of columns."""

from __future__ import annotations

from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray

import sherkit as sk
from running import slow
from sherkit.errors import FitError

TRAVEL_MM, RADIUS_MM = 400.0, 150.0


def axis() -> Any:
    """A carriage and the beam that says how far it is."""
    return sk.Machine(
        lambda q, p: (p.beam_zero + q[:, 0])[:, None], joints={"carriage_mm": (0.0, TRAVEL_MM)},
        readings=("beam_mm",), parameters={"beam_zero": ("mm", 5.0)}, name="axis",
    )  # fmt: skip


def beam(seed: int, *, screw_mm: float = 0.0, bend_um: float = 0.0, per_c: float = 0.0, even: bool = False) -> Any:
    """Bidirectional cycles as of ISO 230-2, at targets drawn at random or ``even`` ones: of a screw that errs by 2.5 µm
    in each pitch, of a scale that is bent or grows."""
    rng = np.random.default_rng([seed, 1])
    targets = np.linspace(10, 390, 39) if even else np.sort(rng.uniform(5, 395, int(rng.integers(25, 55))))
    number = np.tile(np.concatenate([np.arange(len(targets)), np.arange(len(targets))[::-1]]), 3)
    q, time_s = targets[number], 8.0 * np.arange(len(number))
    warmth = 20.5 + rng.uniform(0.6, 1.2) * np.sin(2 * np.pi * time_s / rng.uniform(3e3, 9e3) + rng.uniform(0, 6))
    error = bend_um * 1e-3 * np.square(q / 200 - 1) + per_c * (warmth - 20) * q
    if screw_mm:
        error = error + 2.5e-3 * np.sin(2 * np.pi * q / screw_mm + rng.uniform(0, 6))
    read = q + error + rng.uniform(-4, 4) + rng.uniform(0.1, 0.4) * 1e-3 * rng.normal(size=len(q))
    columns = {"time_s": time_s, "pose": number + 1, "carriage_mm": q, "beam_mm": read, "temperature_c": warmth}
    return sk.from_frame(pl.DataFrame(columns))


@pytest.mark.parametrize("pitch_mm", [4.0, 5.0, 10.0])
def test_a_screw_is_found_at_uneven_targets(pitch_mm: float) -> None:
    """Catches "which no effect and no shape follows" of a pitch shorter than half of the distance of targets, which are
    chosen unevenly just so that it shows."""
    d = sk.diagnose(axis(), beam(int(pitch_mm), screw_mm=pitch_mm))
    assert (d.verdict, d.effects) == ("explained", ("encoder_cyclic",))
    assert d.fit.model.period_mm == pytest.approx(pitch_mm, rel=1e-3)


def test_of_even_targets_no_pitch_beyond_their_number_is_named() -> None:
    """Catches one wave of many that look alike there: a pitch of 10 mm at targets 10 mm apart moves none of them."""
    d = sk.diagnose(axis(), beam(3, screw_mm=10.0, even=True))
    assert (d.verdict, d.effects) == ("adequate", ())


@pytest.mark.parametrize("seed", range(4))
def test_a_bent_scale_is_no_wave_that_nobody_saw_repeat(seed: int) -> None:
    """Catches a parabola that is "explained: encoder_cyclic" with a period of twice the travel."""
    d = sk.diagnose(axis(), beam(seed, bend_um=3.0))
    assert (d.verdict, d.effects) == ("unexplained", ())
    assert "varies smoothly" in str(d)


@pytest.mark.parametrize("seed", range(3))
def test_a_scale_that_grows_is_named(seed: int) -> None:
    """Catches the commonest error of a linear axis, which had no name where readings are no place; an instrument whose
    air warms looks the same, and is said with it."""
    d = sk.diagnose(axis(), beam(seed, per_c=1.1e-5))
    assert d.verdict == "explained"
    assert {"joint_growth", "sensor_growth"} <= {*d.effects}.union(*d.indistinguishable)
    assert d.fit.by_name[f"{d.effects[0]}.growth_{'carriage' if d.effects[0] == 'joint_growth' else 'beam'}"] == (
        pytest.approx(1.1e-5, rel=0.15)
    )


def ball_bar(seed: int, *, scale: float = 0.0, square: float = 0.0) -> tuple[Any, Any]:
    """A table and a ball bar that is led around a circle both ways, four times: its reading hardly moves."""
    machine = sk.Machine(
        lambda q, p: (np.hypot(q[:, 0] - p.centre_x, q[:, 1] - p.centre_y) + p.bar)[:, None],
        joints={"x_mm": (-160.0, 160.0), "y_mm": (-160.0, 160.0)}, readings=("bar_mm",),
        parameters={"centre_x": ("mm", 0.05), "centre_y": ("mm", 0.05), "bar": ("mm", 0.05)}, name="table",
    )  # fmt: skip
    rng = np.random.default_rng([seed, 2])
    once = np.linspace(0, 2 * np.pi, 90, endpoint=False) + rng.uniform(0, 1)
    angle = np.concatenate([once, once[::-1], once, once[::-1]])
    q = RADIUS_MM * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    x, y = q[:, 0] * (1 + scale) + square * q[:, 1], q[:, 1]
    read = np.hypot(x - 0.02 * rng.normal(), y - 0.02 * rng.normal()) + 0.01 * rng.normal()
    read = read + rng.uniform(0.2, 0.5) * 1e-3 * rng.normal(size=len(read))
    columns = {"time_s": 0.3 * np.arange(len(read)), "x_mm": q[:, 0], "y_mm": q[:, 1], "bar_mm": read}
    return machine, sk.from_frame(pl.DataFrame(columns))


@pytest.mark.parametrize("seed", [3, *slow(0, 1, 2)])
@pytest.mark.parametrize(("scale", "square", "named"), [
    (5e-5, 0.0, {"joint_scale"}), (0.0, 6e-5, {"joint_coupling"}), (0.0, 0.0, set()),
])  # fmt: skip
def test_a_reading_that_does_not_move_by_design_is_no_mistake(
    seed: int, scale: float, square: float, named: set[str]
) -> None:
    """Catches "the poses are too close together" of a ball bar on a circle, where all that moves is what is wrong; and
    a fit that runs away along the scale of all, which the bar's length takes up: a bar of minus 38 mm."""
    machine, run = ball_bar(seed, scale=scale, square=square)
    d = sk.diagnose(machine, run)
    assert (d.verdict, set(d.effects)) == ("explained" if named else "adequate", named)
    assert abs(d.fit.by_name["bar"]) < 0.5


def head(seed: int, began: NDArray[np.float64]) -> tuple[Any, Any]:
    """A head of two joints with an inclinometer, with play in the first and a zero that wanders with the temperature;
    the machine came to its first row from the sides ``began`` (2,)."""
    machine = sk.Machine(
        lambda q, p: np.stack([np.sin(q[:, 0] + p.outer), np.cos(q[:, 0] + p.outer) * np.sin(q[:, 1] + p.inner)], 1),
        joints={"outer_rad": (-0.6, 0.6), "inner_rad": (-0.6, 0.6)}, readings=("pitch_g", "roll_g"),
        parameters={"outer": ("rad", 5e-3), "inner": ("rad", 5e-3)}, name="head",
    )  # fmt: skip
    rng = np.random.default_rng([seed, 3])
    poses = rng.uniform(-0.55, 0.55, (80, 2))
    number = np.concatenate([rng.permutation(80) for _ in range(3)])
    q, time_s = poses[number], 12.0 * np.arange(240)
    warmth = 21 + 1.5 * np.sin(time_s / 700 + rng.uniform(0, 6))
    came = np.concatenate([began[:1], np.sign(np.diff(q[:, 0]))])
    came[came == 0] = 1.0
    a, b = q[:, 0] + 4e-4 * came + 2e-3, q[:, 1] - 1e-3
    read = np.stack([np.sin(a), np.cos(a) * np.sin(b)], axis=1) + np.outer(warmth - 21, [3e-4, 2e-4])
    read = read + 1e-4 * rng.normal(size=read.shape)
    columns = {"time_s": time_s, "outer_rad": q[:, 0], "inner_rad": q[:, 1], "temperature_c": warmth}
    return machine, sk.from_frame(pl.DataFrame(columns | {"pitch_g": read[:, 0], "roll_g": read[:, 1]}))


@pytest.mark.parametrize("began", [-1.0, *slow(1.0)])
@pytest.mark.parametrize("seed", [0, *slow(1)])
def test_nobody_knows_from_where_a_machine_came_to_its_first_row(seed: int, began: float) -> None:
    """Catches a first row that is taken for one reached upwards: off by all of the play, it left "a structure" beside
    every pair of effects with play in it. All worlds began upwards, as the product did."""
    machine, run = head(seed, np.array([began, began]))
    d = sk.diagnose(machine, run)
    assert (d.verdict, set(d.effects)) == ("explained", {"backlash", "thermal_shift"})
    # a size of a millionth is no 0.00
    assert " 0.00 g" not in str(d)


def test_readings_of_one_axis_a_row_are_told_what_to_do() -> None:
    """Catches "0 rows with all readings are too few" of a laser that reads x, then y, then z, and nothing else."""
    rng = np.random.default_rng(5)
    machine = sk.Machine(
        lambda q, p: q + np.stack([p.a + 0 * q[:, 0], p.b + 0 * q[:, 0]], axis=1),
        joints={"u_mm": (0.0, 100.0), "v_mm": (0.0, 100.0)}, readings=("east_mm", "north_mm"),
        parameters={"a": ("mm", 1.0), "b": ("mm", 1.0)},
    )  # fmt: skip
    q = rng.uniform(0, 100, (60, 2))
    read = np.where(np.arange(60)[:, None] % 2 == [0, 1], q + 0.01 * rng.normal(size=q.shape), np.nan)
    frame = pl.DataFrame(dict(zip(("u_mm", "v_mm", "east_mm", "north_mm"), [*q.T, *read.T], strict=True)))
    with pytest.raises(FitError, match=r"one at a time.*one row") as caught:
        sk.diagnose(machine, sk.from_frame(frame.fill_nan(None)))
    assert "all of east, north" in str(caught.value)
