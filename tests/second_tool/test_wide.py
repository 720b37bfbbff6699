"""The drawn worlds of the tool, by ways of their own."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from .rod import Rod
from .wide import EXPERIMENTS, FAULTS, Wide, WideRun
from .wide_rod import RoughRod, Tissue

SEEDS = (1, 5, 14)


@cache
def _run(seed: int, experiment: str, size: float = 1.0) -> WideRun:
    return Wide(seed, size=size).run(experiment)


def _column(*values: float) -> np.ndarray:
    return np.array(values)


def test_the_elastica_with_friction_is_that_of_a_chain_of_short_pieces() -> None:
    """Catches a wrong curve or a friction of the wrong sign: the moments of a force given in the clamp's frame, turned
    with the contact, on 4,000 pieces."""
    rod = RoughRod(60.0, 1.13e6)
    for normal, reach, friction in ((30.0, 58.0, 0.15), (280.0, 40.0, -0.15), (300.0, 50.0, 0.08), (200.0, 50.0, 0.0)):
        s = np.linspace(0.0, reach, 4001)
        angle = np.zeros_like(s)

        def summed(v: np.ndarray, step: float = s[1]) -> np.ndarray:
            return np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) / 2 * step)])

        for _ in range(60):
            along, across = summed(np.cos(angle)), summed(np.sin(angle))
            to_tip, aside = np.cos(angle[-1]), np.sin(angle[-1])
            force_along = normal * (friction * to_tip - aside)
            force_across = normal * (friction * aside + to_tip)
            moment = (along[-1] - along) * force_across - (across[-1] - across) * force_along
            angle = summed(moment / rod.stiffness_mn_mm2)
        bent = rod.under(_column(normal), _column(reach), _column(friction))
        assert bent.angle_rad[0] == pytest.approx(angle[-1], rel=2e-6)
        assert bent.across_mm[0] == pytest.approx(across[-1], rel=2e-6)
        assert bent.along_mm[0] == pytest.approx(along[-1], rel=1e-8)
        assert bent.moment(rod.length_mm)[0] == pytest.approx(moment[0], rel=2e-6)
        assert bent.moment(rod.length_mm - s[1500])[0] == pytest.approx(moment[1500], rel=2e-6)
        assert (bent.pushed_mn[0], bent.dragged_mn[0]) == pytest.approx((force_across, force_along), rel=1e-5)


def test_without_friction_it_is_the_smooth_rod() -> None:
    """Catches an error between the friction's nodes: the other rod of this folder, solved apart."""
    force, reach = np.linspace(5.0, 300.0, 50), np.linspace(35.0, 58.0, 50)
    smooth, rough = Rod().under(force, reach), RoughRod(60.0, 1.13e6).under(force, reach, np.zeros(50))
    for name in ("across_mm", "along_mm", "angle_rad"):
        np.testing.assert_allclose(getattr(rough, name), getattr(smooth, name), rtol=1e-8)
    for at in (40.0, 50.0, 5.0):
        np.testing.assert_allclose(rough.moment(at), smooth.moment(at), rtol=1e-8)


def test_rod_and_tissue_are_in_balance() -> None:
    """Catches a force that the tissue does not give, across or along, hard or soft."""
    rng = np.random.default_rng(0)
    depth, push, friction = rng.uniform(1.0, 25.0, 300), rng.uniform(-1.0, 6.0, 300), rng.uniform(-0.15, 0.15, 300)
    rod = RoughRod(58.0, 1.0e6)
    for tissue in (Tissue(40.0, 5.0, 80.0), Tissue(600.0, 10.0, 150.0), Tissue(1000.0)):
        bent = rod.in_hole(depth, push, tissue, friction)
        on = push > 0.0
        assert (bent.normal_mn[~on] == 0.0).all()
        np.testing.assert_allclose(bent.arc_mm[~on], depth[~on])
        theta = bent.angle_rad
        across = bent.normal_mn * (np.cos(theta) + friction * np.sin(theta))
        along = bent.normal_mn * (friction * np.cos(theta) - np.sin(theta))
        soft = tissue.hardens_at_mn * np.sinh(tissue.lateral_mn_mm * (push - bent.across_mm) / tissue.hardens_at_mn)
        np.testing.assert_allclose(across[on], soft[on], rtol=1e-6, atol=1e-6)
        given = -along / (tissue.axial_ratio * tissue.lateral_mn_mm)
        np.testing.assert_allclose(bent.along_mm[on], (rod.length_mm - depth + given)[on], atol=1e-7)


def test_fibres_have_the_gains_they_were_drawn_with() -> None:
    """Catches a shift that is not strain, a drawing of another frame or handedness, a section III that feels what it
    should not."""
    for seed in SEEDS:
        r, d = _run(seed, "bends"), Wide(seed).drawn
        on = np.flatnonzero(r.touched & (r.touch.normal_mn > 20.0))
        way = r.force_mn[on] / np.linalg.norm(r.force_mn[on], axis=1, keepdims=True)
        for s, section in enumerate(("I", "II")):
            moment = r.touch.moment(float(d.glass.from_tip_mm[s]))[on]
            side = np.stack([np.cos(d.glass.side_rad[s]), np.sin(d.glass.side_rad[s])])
            strain = (moment / d.rod.stiffness_mn_mm2)[:, None] * (way @ side) * d.glass.radius_mm[s]
            rest = d.glass.rest_nm[3 * s : 3 * s + 3]
            np.testing.assert_allclose(r.signals.bending_nm[on, 3 * s : 3 * s + 3], 0.78 * rest * strain, atol=1e-12)
            # statics: the moment is that of the force about the section, but for the bend of the lever
            lever = d.glass.from_tip_mm[s] - r.arc_mm[on]
            np.testing.assert_allclose(moment, np.linalg.norm(r.force_mn[on], axis=1) * lever, rtol=0.05)
            table = Wide(seed).drawing()["gratings"]
            gains = np.array([table[f"gain_{section}_{a}"] for a in "xy"])
            told = (r.wavelengths_nm - d.glass.rest_nm)[on, 3 * s : 3 * s + 3] @ gains.T
            off = np.linalg.norm(told - moment[:, None] * way, axis=1) / moment
            assert np.median(off) < 0.2
        beyond = r.arc_mm > d.glass.from_tip_mm[2]
        third = np.abs(r.signals.bending_nm[:, 6:]).max(axis=1)
        assert (third[beyond & r.touched] == 0.0).all()
    shallow = _run(1, "phantom")
    before = shallow.touched & (shallow.arc_mm < 0.5 * Wide(1).drawn.glass.from_tip_mm[2])
    assert (np.abs(shallow.signals.bending_nm[before, 6:]).max(axis=1) > 0.0).all()


def test_depth_along_the_axis_is_no_length_of_shaft() -> None:
    """Catches an l that is not (S - E) z, an arc that is not the shaft beyond the contact, a tip that is elsewhere."""
    for seed, experiment in ((1, "phantom"), (5, "vessels")):
        world = Wide(seed, wander_mm2_s=0.0)
        r, d = world.run(experiment), world.drawn
        turn = Rotation.from_rotvec(r.turn_rad)
        hole = turn.inv().apply(r.place_mm - d.middle_mm)
        np.testing.assert_allclose(hole[:, 2], r.l_mm, atol=5 * 2e-3)
        # the contact seen back from the tip; it stands in the hole, but for what the tissue gives
        tip = turn.inv().apply(r.tip_mm - r.place_mm)
        on = r.touch.normal_mn > 5.0
        way = r.force_mn[on] / np.linalg.norm(r.force_mn[on], axis=1, keepdims=True)
        across = np.einsum("ni,ni->n", tip[on, :2], way)
        contact = across - r.arc_mm[on] * np.sin(r.touch.angle_rad[on])
        np.testing.assert_allclose(contact, r.touch.across_mm[on], atol=5 * 2e-3)
        edge = -np.einsum("ni,ni->n", hole[on, :2], way) - d.clearance_mm[experiment]
        np.testing.assert_allclose(edge - contact, d.tissue.give(r.touch.pushed_mn[on]), atol=5 * 2e-3)
        given = -r.along_mn[on] / d.tissue.axial_mn_mm
        back = tip[on, 2] - r.arc_mm[on] * np.cos(r.touch.angle_rad[on])
        np.testing.assert_allclose(back, -r.l_mm[on] + given, atol=5 * 2e-3)
        short = (r.l_mm - r.arc_mm)[on]
        np.testing.assert_allclose(short - given, 0.6 * contact**2 / r.touch.reach_mm[on], rtol=0.05, atol=1e-2)
        assert short.max() > 0.2


def test_friction_drags_to_the_clamp_while_the_shaft_goes_in() -> None:
    """Catches the sign of the friction, and one that tremor turns though the edge goes along with it."""
    world = Wide(1, friction=0.12, sticks=True, wander_mm2_s=0.0)
    r = world.run("phantom")
    speed = np.gradient(gaussian_filter1d(r.l_mm, 40.0), r.time_s)
    quick = r.touched & (np.abs(speed) > 1.0)
    assert (np.sign(r.touch.friction[quick]) == -np.sign(speed[quick])).mean() > 0.95
    assert np.abs(r.touch.friction).max() <= 0.12

    def turns(sticks: bool) -> int:
        friction = Wide(1, friction=0.12, sticks=sticks).run("phantom").touch.friction
        return int((np.diff(np.sign(friction)) != 0).sum())

    assert turns(False) > 3 * turns(True)


def test_a_bench_reads_by_its_convention() -> None:
    """Catches readings that are alike where they must differ, or other loads behind another convention."""
    bench = {(d, f): Wide(2, depth=d, force=f).bench() for d in ("axis", "arc") for f in ("across", "normal")}
    first = bench["axis", "across"]
    loaded = first["force_x_mn"] != 0.0
    assert loaded.sum() == 80
    assert (~loaded).sum() == 20
    for table in bench.values():
        for name in ("deflection_mm", *(f"fbg{k}_nm" for k in range(1, 10))):
            np.testing.assert_array_equal(table[name], first[name])
        assert ((table["depth_mm"] > -0.5) & (table["depth_mm"] < 28.5)).all()
        assert (table["force_y_mn"][~loaded] == 0.0).all()
    by_axis, by_arc = first["depth_mm"][loaded], bench["arc", "across"]["depth_mm"][loaded]
    rod, bend = Wide(2).drawn.rod, first["deflection_mm"][loaded]
    np.testing.assert_allclose(by_axis - by_arc, 0.6 * bend**2 / (rod.length_mm - by_arc), rtol=0.1, atol=0.01)
    across, normal = (
        np.hypot(bench["axis", f]["force_x_mn"], bench["axis", f]["force_y_mn"])[loaded] for f in ("across", "normal")
    )
    share, angle = across / normal, 1.5 * bend / (rod.length_mm - by_arc)
    assert (np.abs(share - np.cos(angle)) < 0.11 * np.sin(angle) + 0.01).all()
    assert normal.max() < 301.0
    assert normal.min() > 19.0
    assert np.hypot(Wide(2, size=0.5).bench()["force_x_mn"], Wide(2, size=0.5).bench()["force_y_mn"]).max() < 151.0
    # they are not the cantilever's deflections by chance
    small = across * (rod.length_mm - by_axis) ** 3 / (3.0 * rod.stiffness_mn_mm2)
    assert 0.9 < np.median(bend / small) < 1.1


@pytest.mark.parametrize("size", [1.0, pytest.param(0.5, marks=pytest.mark.slow)])
def test_a_hand_keeps_to_its_limits(size: float) -> None:
    """Catches a run that bends or pushes further than said, never leaves the edge, or leaves the eye."""
    for seed in SEEDS:
        for experiment in EXPERIMENTS:
            r = _run(seed, experiment, size)
            force = np.hypot(np.linalg.norm(r.force_mn, axis=1), r.along_mn)
            assert r.bend_mm.max() <= 10.0 * size
            assert r.bend_mm.max() >= 2.0 * size
            assert force.max() <= 300.0 * size
            assert (force[~r.touched] == 0.0).all()
            assert 0.2 < r.touched.mean() < 0.95
            assert np.nanmin(r.arc_mm) > 0.1
            assert np.nanmax(r.l_mm) < 27.0
            assert np.isnan(r.l_mm).any() == (experiment == "bends")
            if experiment == "bends":
                continue
            assert r.l_mm[0] == pytest.approx(Wide(seed).drawn.start_mm, abs=1e-9)
            edges = np.flatnonzero(np.diff(np.concatenate([[1], r.touched.astype(int), [1]])))
            rests = np.diff(edges)[::2] / 200.0
            assert (rests > 0.9).sum() >= 3


def test_a_hand_trembles() -> None:
    """Catches a tremor of the wrong size or pace."""
    for seed in SEEDS:
        r = Wide(seed, wander_mm2_s=0.0).run("vessels")
        drawn = Wide(seed).drawn.hand
        shaft = Rotation.from_rotvec(r.turn_rad).as_matrix()[:, :, 2]
        deep = np.einsum("ni,ni->n", r.place_mm - r.place_mm[0], shaft)[400:]
        power, rate = np.abs(np.fft.rfft(deep * np.hanning(len(deep)))) ** 2, np.fft.rfftfreq(len(deep), 1 / 200.0)
        band = (rate > 7.5) & (rate < 12.5)
        assert power[band].sum() > 10 * power[(rate > 14.0) & (rate < 50.0)].sum()
        rms = np.sqrt(2 * power[band].sum() / len(deep) / (np.hanning(len(deep)) ** 2).sum())
        assert rms == pytest.approx(drawn.tremor_mm / np.sqrt(3.0), rel=0.35)


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_touch_their_gratings_alone(fault: str) -> None:
    """Catches a fault that is none, leaks, starts early, or names the wrong gratings."""
    for seed in SEEDS:
        sound, r = _run(seed, "phantom"), Wide(seed).run("phantom", fault=fault, since_s=25.0)
        late, d = r.time_s >= 25.0, Wide(seed).drawn
        np.testing.assert_array_equal(r.wavelengths_nm[~late], sound.wavelengths_nm[~late])
        np.testing.assert_array_equal(r.tip_mm, sound.tip_mm)
        other = {k for k in range(9) if not np.array_equal(r.wavelengths_nm[:, k], sound.wavelengths_nm[:, k])}
        assert r.bad <= r.changed
        # a slipped fibre shows in section III only where the contact is nearer the tip than that
        assert other == r.changed or (fault == "slip" and other == {k for k in r.changed if k < 6})
        gone = (r.wavelengths_nm - sound.wavelengths_nm)[late][:, sorted(r.changed)]
        if fault in ("grating", "fibre"):
            np.testing.assert_allclose(np.abs(gone), 0.5)
            assert len(r.bad) == {"grating": 1, "fibre": 3}[fault]
        if fault in ("fibre", "slip", "cut"):
            assert len({k % 3 for k in r.bad}) == 1
        if fault == "slip":
            assert (gone[~r.touched[late]] == 0.0).all()
        if fault == "cut":
            assert np.isnan(gone).all()
            assert {k // 3 for k in r.bad} in ({0, 1, 2}, {0, 2}, {2})
        if fault.startswith("warm"):
            assert r.bad == frozenset()
            warmer = gone[-2000:].mean(axis=0) / d.glass.warmth_nm_k[sorted(r.changed)]
            np.testing.assert_allclose(warmer, 5.0, rtol=0.02)
            assert r.changed == {"warm_all": set(range(9)), "warm_II": {3, 4, 5}, "warm_III": {6, 7, 8}}[fault]


def test_the_camera_sees_the_tip_late_and_in_its_own_frame() -> None:
    """Catches a frame turned the wrong way round, a delay with the wrong sign, a warp of another size."""
    for seed in SEEDS:
        r, d = _run(seed, "vessels"), Wide(seed).drawn
        tip = np.column_stack([np.interp(r.camera_time_s - d.delay_s, r.time_s, x) for x in r.tip_mm.T])
        off = d.camera.apply(r.camera_mm) + d.camera_mm - tip
        assert np.sqrt((off**2).sum(axis=1).mean()) == pytest.approx(np.hypot(0.2, 0.1), rel=0.15)
        columns = r.columns()
        assert (np.diff(columns["time_s"]) >= 0.0).all()
        assert np.isfinite(columns["camera_x_mm"]).sum() == len(r.camera_time_s)
        assert np.isfinite(columns["depth_mm"]).sum() == len(r.time_s)
    free = Wide(1).free(seconds=20.0)
    assert "depth_mm" not in free
    assert np.ptp(free["robot_x_mm"][np.isfinite(free["robot_x_mm"])]) > 10.0


def test_a_drawing_is_off_by_what_a_workshop_is_off() -> None:
    """Catches a drawing that tells the truth, or one that nobody could have drawn."""
    starts = []
    for seed in range(40):
        d, file = Wide(seed).drawn, Wide(seed).drawing()
        tomli_w.dumps(file)
        assert 0.2 < abs(file["shaft"]["length_mm"] - d.rod.length_mm) <= 0.5
        assert 0.04 < abs(file["shaft"]["stiffness_mn_mm2"] / d.rod.stiffness_mn_mm2 - 1.0) <= 0.1
        moved = np.abs(np.array(file["gratings"]["distances_mm"]) - d.glass.from_tip_mm[:2])
        np.testing.assert_allclose(np.sort(moved), [0.0, 0.3], atol=1e-12)
        assert np.abs(np.array(file["gratings"]["reference_nm"]) - d.glass.rest_nm).max() < 0.25
        assert 50.0 <= d.rod.length_mm <= 70.0
        assert d.glass.from_tip_mm[1] + 2.0 < d.rod.length_mm
        assert 0.0 <= d.delay_s <= 0.06
        starts.append(file["filter"]["start_depth_mm"] - d.start_mm)
        assert file["filter"]["start_depth_mm"] >= 0.0
    assert np.std(starts) == pytest.approx(0.5, rel=0.4)


def test_a_seed_is_a_world() -> None:
    """Catches chance that no seed holds, two seeds alike, and a choice that changes what was not chosen."""
    one, same, other = (Wide(s).run("bends", seconds=5.0).columns() for s in (3, 3, 4))
    for name, values in one.items():
        np.testing.assert_array_equal(values, same[name])
    assert not np.array_equal(one["fbg1_nm"], other["fbg1_nm"])
    for name, values in Wide(3).bench().items():
        np.testing.assert_array_equal(values, Wide(3, tissue="soft", sticks=True).bench()[name])
    assert Wide(3, tissue="soft").drawn.tissue.lateral_mn_mm == 40.0
    assert Wide(3, tissue="soft").drawn.hand == Wide(3, tissue="stiff", friction=0.1).drawn.hand
    assert len({Wide(s).drawn.reading for s in range(30)}) == 4


def test_it_imports_numbers_alone() -> None:
    """Catches a world that leans on what it is to judge."""
    for file in Path(__file__).parent.glob("wide*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            known = {"__future__", "collections", "dataclasses", "functools", "typing", "numpy", "scipy"}
            assert {n.split(".")[0] for n in names} <= known, file
