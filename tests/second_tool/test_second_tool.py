"""The second simulator of the tool, by ways of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from . import CONDITIONS, FAULTS, Rod, World, honesty, write_csv
from .honesty import Honesty, pooled


def test_the_elastica_is_that_of_a_chain_of_short_pieces() -> None:
    """Catches a wrong curve, scale or rotation: the balance of moments on 4,000 pieces, to a 2e-6th of the bend."""
    rod = Rod()
    for force, arc in ((30.0, 58.0), (250.0, 40.0), (800.0, 50.0)):
        s = np.linspace(0.0, arc, 4001)
        step, angle = s[1], np.zeros_like(s)

        def summed(v: np.ndarray, step: float = step) -> np.ndarray:
            return np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) / 2 * step)])

        for _ in range(200):
            along, across = summed(np.cos(angle)), summed(np.sin(angle))
            moment = force * ((along[-1] - along) * np.cos(angle[-1]) + (across[-1] - across) * np.sin(angle[-1]))
            angle = summed(moment / rod.stiffness_mn_mm2)
        bent = rod.under(np.array([force]), np.array([arc]))
        assert bent.angle_rad[0] == pytest.approx(angle[-1], rel=2e-6)
        assert bent.across_mm[0] == pytest.approx(across[-1], rel=2e-6)
        assert bent.along_mm[0] == pytest.approx(along[-1], rel=1e-8)
        assert bent.moment(rod.length_mm)[0] == pytest.approx(moment[0], rel=2e-6)
        assert bent.moment(rod.length_mm - s[1500])[0] == pytest.approx(moment[1500], rel=2e-6)


def test_a_small_force_bends_as_a_cantilever() -> None:
    """Catches a factor between the exact rod and the small bend, in place, angle, moment and tip."""
    force, arc = np.array([0.05, 0.05]), np.array([35.0, 55.0])
    exact, small = (Rod(exact=kind).under(force, arc) for kind in (True, False))
    for name in ("across_mm", "angle_rad"):
        np.testing.assert_allclose(getattr(exact, name), getattr(small, name), rtol=1e-5)
    np.testing.assert_allclose(exact.tip()[0], small.tip()[0], rtol=1e-5)
    np.testing.assert_allclose(exact.moment(50.0), small.moment(50.0), rtol=1e-5)


def test_rod_and_hole_are_in_balance() -> None:
    """Catches a force that the hole does not give, or a contact that is not where the hole is."""
    rng = np.random.default_rng(0)
    along, push = rng.uniform(36.0, 60.0, 200), rng.uniform(0.0, 6.0, 200)
    for exact in (True, False):
        bent = Rod(exact=exact).pressed(along, push, 120.0)
        across = bent.force_mn * (np.cos(bent.angle_rad) if exact else 1.0)
        np.testing.assert_allclose(across, 120.0 * (push - bent.across_mm), atol=1e-6)
        np.testing.assert_allclose(bent.along_mm, along, atol=1e-9)
    loaded = Rod().loaded(np.array([200.0]), np.array([10.0]))
    assert loaded.force_mn * np.cos(loaded.angle_rad) == pytest.approx(200.0)


def test_the_depth_changes_by_the_turning_shaft_as_well() -> None:
    """Catches a tool that is led so that (S - E) z' is nothing: with it the depth is the sum, without it is not."""
    for name, needed in (("pivot", True), ("matched", False)):
        r = replace(CONDITIONS[name], wander_mm2_s=0.0).run("vessels", seconds=20.0, seed=1)
        shaft = Rotation.from_rotvec(r.turn_rad).as_matrix()[:, :, 2]
        step = np.diff(r.place_mm, axis=0)
        middle, swept = (shaft[1:] + shaft[:-1]) / 2, np.diff(shaft, axis=0)
        led = np.einsum("ni,ni->n", step, middle)
        about = np.einsum("ni,ni->n", (r.place_mm[1:] + r.place_mm[:-1]) / 2, swept)
        gone = r.depth_mm - r.depth_mm[0]
        np.testing.assert_allclose(np.cumsum(led + about), gone[1:], atol=1e-3)
        assert (np.abs(np.cumsum(led) - gone[1:]).max() > 0.2) == needed


def test_fibres_feel_force_and_warmth() -> None:
    """Catches gains that the file does not share with the world: force and depth from noiseless wavelengths."""
    world = replace(CONDITIONS["matched"], noise_nm=0.0, temperature_c=3.0)
    r, file = world.run("phantom", seconds=10.0), world.file()["gratings"]
    shift = (r.wavelengths_nm - file["reference_nm"]).reshape(-1, 3, 3)
    gains = [np.array([file[f"gain_{s}_{a}"] for a in "xy"]) for s in ("I", "II")]
    lower, upper = (shift[:, s] @ gains[s].T for s in range(2))
    np.testing.assert_allclose((upper - lower) / 10.0, r.force_mn, atol=1e-6)
    assert shift[-1].mean() == pytest.approx(0.010 * (3.0 * (1 - np.exp(-0.5)) + 0.1 * np.sin(10 / 7)), rel=0.05)


def test_late_readings_are_those_of_earlier_and_say_so() -> None:
    """Catches a delay with the wrong sign, and a stamp that is not that of the reading."""
    still = replace(CONDITIONS["exact_rod"], noise_nm=0.0)
    now, late = still.run("phantom", seconds=10.0), replace(still, fibre_delay_s=0.1).run("phantom", seconds=10.0)
    np.testing.assert_allclose(late.wavelengths_nm[20:], now.wavelengths_nm[:-20], atol=1e-9)
    assert late.fibre_time_s is not None
    np.testing.assert_allclose(late.fibre_time_s, late.time_s - 0.1)
    slow = CONDITIONS["slow"].run("phantom", seconds=10.0)
    assert np.isfinite(slow.wavelengths_nm).all(axis=1).sum() == pytest.approx(200, abs=2)


@pytest.mark.parametrize("name", FAULTS)
def test_faults_touch_their_fibres_alone(name: str) -> None:
    """Catches a fault that is none, or one that leaks into rows or fibres that are sound."""
    sound, faulty = (
        w.run("phantom", seconds=30.0).wavelengths_nm for w in (CONDITIONS["exact_rod_pivot"], FAULTS[name])
    )
    other = (sound != faulty).any(axis=0)
    assert other.sum() == {"swapped_I": 2, "swapped_II": 2, "swapped_sections": 2, "spikes": 9, "pm": 9, "m": 9}.get(
        name, 1
    )
    if name not in ("spikes", "pm", "m", "saturated"):
        np.testing.assert_array_equal(sound[:4000], faulty[:4000])


def test_honesty_of_what_is_known() -> None:
    """Catches a coverage of the wrong share, a NEES not per degree, a NaN that counts as covered."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(3, 3))
    spread = np.broadcast_to(root @ root.T, (20_000, 3, 3))
    off = rng.standard_normal((20_000, 3)) @ root.T
    told = honesty(off, spread, np.zeros_like(off))
    assert (told.coverage, told.nees, told.beyond_5) == (
        pytest.approx(0.95, abs=0.006),
        pytest.approx(1.0, abs=0.03),
        0,
    )
    sure = honesty(off, spread / 9.0, np.zeros_like(off))
    assert sure.coverage < 0.6
    assert sure.nees == pytest.approx(9.0, rel=0.03)
    lost = honesty([0.0, np.nan, 0.0], [1.0, 1.0, np.nan], [0.0, 0.0, 0.0])
    assert lost.coverage == pytest.approx(1 / 3)
    assert pooled([told, sure]) == Honesty(40_000, pytest.approx((told.coverage + sure.coverage) / 2),  # type: ignore[arg-type]
                                           pytest.approx((told.nees + sure.nees) / 2), sure.largest, sure.beyond_5,
                                           pytest.approx(told.mean_error_mm))  # fmt: skip


def test_it_stands_apart(tmp_path: Path) -> None:
    """Catches a simulator that shares code with what it is to judge, or a file that loses digits."""
    for file in Path(__file__).parent.glob("*.py"):
        assert "sher" + "kit" not in file.read_text(encoding="utf-8").replace("sher" + '" + "kit', ""), file
    columns = World().run("free", seconds=2.0).columns()
    write_csv(columns, tmp_path / "free.csv")
    again = np.genfromtxt(tmp_path / "free.csv", delimiter=",", names=True)
    for name, values in columns.items():
        np.testing.assert_array_equal(again[name], values)
