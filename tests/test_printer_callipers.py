"""Distances by callipers beside probed heights: each counts by its own noise, and rough ones ruin no calibration."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from second_printer import Firmware, Machine, Plate, Probe, klipper_file, mesh_points, touched
from sherkit import identify
from sherkit.cli import main
from sherkit.robots.printer import PrinterModel, Towers, hypotheses, import_klipper
from sherkit.robots.printer.callipers import weighed
from sherkit.robots.printer.model import CATALOGUE
from sherkit.robots.printer.printer_diagnosis import Examined, examine
from sherkit.robots.printer.robot import WEIGHT

Floats = NDArray[np.float64]

#: What is wrong with a printer: by how much its tower angles (°), radius, arms and end stops are off, mm.
FAULTS = {
    "none": (0.0, 0.0, 0.0, 0.0), "angles": (0.25, 0.0, 0.0, 0.0), "radius": (0.0, 0.6, 0.0, 0.0),
    "arms": (0.0, 0.0, 0.25, 0.0), "ends": (0.0, 0.0, 0.0, 0.25),
}  # fmt: skip


class Bowl(Plate):
    """A plate that is higher at its edge, by so much 110 mm from the middle, mm."""

    deep = 0.15

    def at(self, xy: Floats) -> Floats:
        """Heights (n,) at places (n, 2), mm."""
        return self.deep * (xy**2).sum(axis=1) / 110.0**2


class Case:
    """A printer with probed heights and distances by callipers that scatter by so much, mm; all else is drawn."""

    def __init__(self, seed: int, fault: str, callipers_mm: float, plate: Plate | None = None) -> None:
        rng = np.random.default_rng([seed, list(FAULTS).index(fault)])
        radius = rng.uniform(100, 160)
        arm = radius * rng.uniform(2.0, 2.3)
        turned = (210.0 + rng.normal(0, 0.3), 330.0 + rng.normal(0, 0.3), 90.0)
        arms, ends = (tuple(middle + rng.normal(0, 0.3, 3)) for middle in (arm, 300.0))
        self.firmware = Firmware(radius, turned, arms, ends)
        off = [size * rng.normal(size=3) for size in FAULTS[fault]]
        top = self.firmware.top + off[3]
        self.plate = plate or Plate.flat()
        # a bowl that is taken for numbers is that of where the tip is: a nozzle beside it is tilted over the plate
        beside = (0.0, 0.0) if plate else rng.uniform(-20, 20, 2).tolist()
        probe = Probe((*beside, 1.5), noise=rng.uniform(0.004, 0.01))
        self.reach = 0.7 * radius
        at = np.deg2rad(60.0 * np.arange(6) + rng.uniform(0, 60))
        around = rng.uniform(40, 65) * np.column_stack([np.cos(at), np.sin(at)])
        spots = np.column_stack([np.vstack([np.zeros(2), around]), np.full(7, 2.0)])
        self.machine = Machine.of(
            np.full(3, radius) + off[1][0], np.array(turned) + off[0], np.array(arms) + off[2], top
        )
        # who calibrates sets the zero at the middle
        low = self.tips(self.firmware, np.zeros((1, 3)))[0, 2] - self.plate.at(np.zeros((1, 2)))[0]
        self.machine = replace(self.machine, top=top - low)
        ticks, inside = mesh_points(self.reach, int(rng.choice([7, 9])))
        z = np.full(inside.shape, np.nan)
        x, y = np.meshgrid(ticks, ticks)
        where = np.column_stack([x[inside], y[inside]])
        z[inside] = touched(self.machine, self.firmware, self.plate, probe, where, rng)[0]
        down, real = self.firmware.down(spots), self.tips(self.firmware, spots)
        pairs = [(0, k) for k in range(1, 7)] + [(k, k % 6 + 1) for k in range(1, 7)]
        read = [
            (float(np.linalg.norm(real[a] - real[b]) + callipers_mm * rng.normal()), down[a], down[b])
            for a, b in (pairs[k] for k in rng.permutation(12)[: rng.integers(9, 13)])
        ]
        self.text = klipper_file(
            self.firmware, {"default": (ticks, ticks, z)}, offset=probe.offset, distances=read, print_radius=self.reach
        )

    def tips(self, firmware: Firmware, at: Floats) -> Floats:
        """Where the nozzle really goes (n, 3) when it is sent to places (n, 3), mm."""
        return self.machine.tip(firmware.down(at), np.zeros(3))

    def off(self, firmware: Firmware) -> tuple[float, float]:
        """How uneven the nozzle is over the plate, RMS, mm, and how wrong the size of a part is, as a part of it."""
        ticks = np.linspace(-self.reach, self.reach, 15)
        xy = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
        xy = xy[np.hypot(*xy.T) <= self.reach]
        real = self.tips(firmware, np.column_stack([xy, np.zeros(len(xy))]))
        middle = real[:, :2] - real[:, :2].mean(axis=0)
        moved = xy - xy.mean(axis=0)
        # where the frame faces is no size
        turn, _, other = np.linalg.svd(moved.T @ middle)
        size = np.trace(turn.T @ (moved.T @ middle) @ other.T) / (moved**2).sum() - 1
        return float(np.std(real[:, 2] - self.plate.at(real[:, :2]))), float(size)

    def examined(self, folder: Path) -> Examined:
        """By its file."""
        (folder / "printer.cfg").write_text(self.text)
        return examine(import_klipper(folder / "printer.cfg"))


def entered(towers: Towers) -> Firmware:
    """What a firmware believes with these numbers."""
    return Firmware(towers.radius_mm, towers.angle_deg, towers.arm_mm, towers.endstop_mm)


def counted(fault: str, callipers_mm: float, seeds: range, folder: Path, plate: Plate | None = None) -> Counter[str]:
    """What so many printers are told, and how true that is."""
    out: Counter[str] = Counter()
    for seed in seeds:
        case = Case(seed, fault, callipers_mm, plate)
        e = case.examined(folder)
        before, after = case.off(case.firmware), case.off(entered(e.new.towers))
        blamed = {s.names for s in e.suspects}
        out["quiet"] += not blamed and not e.unknown
        out["machine alone"] += bool(blamed) and not any("bed_shape" in names for names in blamed)
        out["new"] += e.better_numbers
        out["promised"] += after[0] <= e.after_mm
        out["even"] += after[0] < max(0.009, 0.3 * before[0])
        # a size is known to about a third of what callipers scatter over the spokes
        out["worse"] += after[0] > before[0] + 0.003 or abs(after[1]) > abs(before[1]) + callipers_mm / 40.0
    return out


def test_callipers_are_nobody_where_no_distance_was_measured(tmp_path: Path) -> None:
    """Catches "callipers that read every distance too long or too short" named by 29 heights of a real printer: what
    moves nothing that was measured explains nothing, however a fit with it ends."""
    text = Case(1, "radius", 0.05).text
    for kept, there in ((text, True), ("\n".join(line for line in text.splitlines() if "distance" not in line), False)):
        (tmp_path / "printer.cfg").write_text(kept)
        plain = examine(import_klipper(tmp_path / "printer.cfg")).plain
        assert bool(plain.data.between_places.any()) == there
        nothing = hypotheses.Suspect((), plain, plain)
        assert bool(hypotheses._fitted(nothing, [(CATALOGUE["bar_zero"],)])) == there


def test_callipers_are_told_from_a_probe(tmp_path: Path) -> None:
    """Catches distances that count as much as heights, or by what is usual where their rows say something else."""
    found = []
    for callipers in (0.01, 0.2):
        ratios = []
        for seed in range(2):
            (tmp_path / "printer.cfg").write_text(Case(seed, "radius", callipers).text)
            read = import_klipper(tmp_path / "printer.cfg")
            ratios.append(0.007 / weighed(PrinterModel(read.robot), read.measurements).covariates[WEIGHT].min())
        found.append(float(np.exp(np.mean(np.log(ratios)))))
    assert found == pytest.approx([0.02, 0.2], rel=0.6)


def test_a_run_is_weighed_once(tmp_path: Path) -> None:
    """Catches rows that are weighed again by whoever takes them from a fit, readings that are weighed and predictions
    that are not, and derivatives of the one by the parameters of the other."""
    (tmp_path / "printer.cfg").write_text(Case(3, "arms", 0.03).text)
    read = import_klipper(tmp_path / "printer.cfg")
    fit = identify(read.robot, read.measurements)
    far = fit.data.between_places
    assert fit.model.as_declared(fit.data) is fit.data
    assert np.abs(fit.residuals[far]).max() < 0.03
    plain = fit.model.predict(read.measurements, fit.values)
    weight = fit.data.covariates[WEIGHT]
    assert np.allclose(plain[:, 0] * weight, fit.predicted[:, 0], atol=1e-12)
    assert (weight[~far] == 1.0).all()
    step = np.zeros(len(fit.values))
    step[0] = 1e-4
    numeric = (fit.model.predict(fit.data, fit.values + step) - fit.model.predict(fit.data, fit.values - step)) / 2e-4
    assert np.allclose(fit.model.derivatives(fit.data, fit.values)[:, 0, 0], numeric[:, 0], atol=1e-6)


def test_rough_distances_leave_a_perfect_printer_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches twelve distances of 0.03 mm that bend a perfect machine by 0.4 mm, and a new.cfg that is no better."""
    case = Case(1, "none", 0.03)
    (tmp_path / "printer.cfg").write_text(case.text)
    with pytest.raises(SystemExit):
        main(["printer", str(tmp_path / "printer.cfg"), "-o", str(tmp_path / "new.cfg")])
    said = " ".join(capsys.readouterr().out.split())
    assert "Verdict: nothing that this probing shows" in said
    assert "Sizes of parts:" in said
    assert not (tmp_path / "new.cfg").exists()


def test_what_remains_counts_a_bowl(tmp_path: Path) -> None:
    """Catches an accuracy of 0.005 mm without a word that heights alone take a bowl of the plate for other numbers."""
    case = Case(2, "ends", 0.03)
    (tmp_path / "printer.cfg").write_text(case.text.split("#*# [delta_calibrate]")[0])
    said = " ".join(dict(examine(import_klipper(tmp_path / "printer.cfg")).sections)["What accuracy remains"])
    assert "a plate bowed by 0.1 mm passes for other numbers" in said
    share = float(said.split("parts are ")[1].split(" %")[0])
    assert 0.1 < share < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("callipers", [0.006, 0.03, 0.1])
def test_perfect_printers_are_left_alone(callipers: float, tmp_path: Path) -> None:
    """Catches patterns and new numbers out of the scatter of callipers (7 of 16 where they count as a probe does)."""
    out = counted("none", callipers, range(40), tmp_path)
    assert out["quiet"] >= 39, out
    assert out["new"] == 0, out


@pytest.mark.slow
@pytest.mark.parametrize("fault", [name for name in FAULTS if name != "none"])
def test_wrong_numbers_are_put_right(fault: str, tmp_path: Path) -> None:
    """Catches numbers that rough distances keep from being right, and an accuracy that is promised and not there."""
    out = counted(fault, 0.03, range(40), tmp_path)
    assert out["even"] >= 38, out
    assert out["promised"] >= 36, out
    assert out["worse"] <= 1, out


@pytest.mark.slow
def test_a_bowl_is_no_lean(tmp_path: Path) -> None:
    """Catches a bowl of the plate that is told as towers that lean, and numbers that are worse than those before."""
    out = counted("none", 0.03, range(40), tmp_path, Bowl.flat())
    assert out["machine alone"] <= 4, out
    assert out["promised"] >= 36, out
