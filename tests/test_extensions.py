"""What other packages bring: a robot, an instrument, an importer and a verb from a package outside the tree
(``tests/plugin_robot``), installed as anybody would; and the suite that every kind of robot passes."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from planar_arm import KIND as PLANAR
from planar_arm import PlanarArm
from planar_arm.pose_sets import fan
from running import several
from sherkit import testing
from sherkit.model import kinds
from sherkit.model.kinds import Kind, known_kinds
from sherkit.testing import check_robot

PLUGIN = Path(__file__).parent / "plugin_robot"
PAGE = Path(__file__).parents[1] / "docs" / "howto_package.md"
ARM = PlanarArm((250.0, 180.0), joint_limits_deg=(-170.0, 170.0))


# -- the suite of kinds ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["delta", "spherical", "serial", "printer"])
def test_a_built_in_kind_passes_the_suite_of_strangers(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a suite that asks what sherkit's own robots do not do, and a robot of its own that has an exception. How
    often they alarm is counted elsewhere."""
    monkeypatch.setattr(testing, "_SEEDS", testing._SEEDS[: testing._ALARMS + 1])
    held = check_robot(known_kinds()[name])
    told = re.findall(r"^- (The|A|Every|An|Derivatives|Without|Where)(.*\.)$", PAGE.read_text(), re.MULTILINE)
    statements = tuple(first + rest for first, rest in told)[:10]
    assert held == (statements[:4] if name == "printer" else statements)


@pytest.fixture
def planar() -> Any:
    """The arm's kind with few poses, forgotten afterwards."""
    yield replace(PLANAR, areas={"whole": lambda robot: fan(robot, 5)})
    kinds.KINDS.pop(PLANAR.name, None)


class _Short(PlanarArm):
    """Its inverse forgets the elbow."""

    def inverse_batch(self, tips_mm: Any) -> Any:
        found = super().inverse_batch(tips_mm)
        return found._replace(values=found.values + np.array([0.0, 1e-3]))


class _Steep(PLANAR.model):  # type: ignore[name-defined, misc]
    """Its derivatives are a tenth too large."""

    def derivatives(self, data: Any, values: Any) -> Any:
        return 1.1 * super().derivatives(data, values)


class _Lazy(PLANAR.model):  # type: ignore[name-defined, misc]
    """It says nothing of an effect."""

    catalogue: ClassVar = {n: replace(e, remedy=" ") if n == "droop" else e for n, e in PLANAR.model.catalogue.items()}


class _Bent(PLANAR.virtual):  # type: ignore[name-defined, misc]
    """It always falls."""

    @classmethod
    def simulated(cls, robot: Any, seed: int, errors: float, sizes: Any) -> Any:
        return super().simulated(robot, seed, errors, {**sizes, "fall_mm": 0.1})


class _Open(PlanarArm):
    """It takes whatever stands in a file."""

    @classmethod
    def from_table(cls, table: Any) -> Any:
        made = super().from_table(table)
        table.pass_over(*table.names())
        return cls(made.length_mm, made.height_mm, made.elbow, made.home_deg, made.joint_limits_deg)


@pytest.mark.parametrize(
    ("change", "robot", "said"),
    [
        (lambda k: replace(k, robot=_Short), _Short, "inverse_batch: do not agree"),
        (lambda k: replace(k, model=_Steep), PlanarArm, "derivative by length_1 is not that of the readings"),
        (lambda k: replace(k, model=_Lazy), PlanarArm, "droop: has no remedy"),
        (lambda k: replace(k, virtual=_Bent), PlanarArm, "alarms where nothing is hidden"),
        (lambda k: replace(k, robot=_Open), _Open, "takes a key that nobody knows"),
        (lambda k: replace(k, name="flat"), PlanarArm, "robots say 'planar', the Kind is 'flat'"),
        (lambda k: replace(k, areas={}), PlanarArm, "areas: expected the poses"),
    ],
    ids=["inverse", "derivative", "sentence", "virtual", "file", "name", "areas"],
)
def test_the_suite_sees_a_mistake(
    planar: Kind, change: Callable[[Kind], Kind], robot: Any, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a suite that lets a wrong robot pass, or does not say what is wrong with it. As few runs as can be too
    many alarms, where alarms are the mistake."""
    monkeypatch.setattr(testing, "_SEEDS", testing._SEEDS[: (testing._ALARMS + 1) * ("alarms" in said)])
    made = change(planar)
    try:
        with pytest.raises(AssertionError, match="of 10 do not hold") as refused:
            check_robot(made, robot(ARM.length_mm, joint_limits_deg=ARM.joint_limits_deg))
    finally:
        kinds.KINDS.pop(made.name, None)
    assert said in str(refused.value)


# -- a package from outside ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the package is installed, beside a second one that is broken."""
    place = tmp_path_factory.mktemp("site")
    install = ["install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--target", str(place)]
    subprocess.run([sys.executable, "-m", "pip", *install, str(PLUGIN)], check=True)
    broken = place / "broken-0.1.dist-info"
    broken.mkdir()
    (broken / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 0.1\n")
    (broken / "entry_points.txt").write_text(
        "[sherkit.robots]\nhexapod = not_there:KIND\ndelta = xy_stage:KIND\n[sherkit.verbs]\nsay = os:sep\n"
    )
    return place


def run(installed: Path, folder: Path, code: str) -> str:
    """What a program prints where the package is installed."""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(installed)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def verbs(installed: Path, folder: Path, *lines: str, code: int = 0) -> list[str]:
    """What verbs print there; the last ends with this code, the others go well."""
    done = several(folder, *lines, PYTHONPATH=str(installed))
    assert [ended for ended, _, _ in done] == [*[0] * (len(lines) - 1), code], done
    return [" ".join((out + err).split()) for _, out, err in done]


def test_a_robot_from_outside_is_one_like_the_others(installed: Path, tmp_path: Path) -> None:
    """Catches a door that only sherkit's own robots come through: the suite, a simulation, a diagnosis, the schema."""
    asked = "import sherkit.testing, xy_stage; print(len(sherkit.testing.check_robot(xy_stage.KIND)))"
    assert run(installed, tmp_path, asked).split()[0] == "9"
    (tmp_path / "robot.toml").write_text('kind = "xy_stage"\n[geometry]\ntravel_mm = [120.0, 80.0]\n')
    made, found, effects, schema = verbs(
        installed, tmp_path, "simulate robot.toml -o run.csv --bow-um 12 --seed 3", "diagnose robot.toml run.csv",
        "effects --robot robot.toml", "schema robot",
    )  # fmt: skip
    assert "broken: its robot 'hexapod' (not_there:KIND) cannot be loaded (ModuleNotFoundError" in made
    assert "broken: its robot 'delta' (xy_stage:KIND) is not used: sherkit.robots.delta:KIND has that name" in made
    assert "Verdict: explained: bow" in found
    assert "bow" in effects
    assert "travel_mm" in schema


def test_verbs_and_importers_from_outside(installed: Path, tmp_path: Path) -> None:
    """Catches a verb that is not told of, a file of another program that cannot be read, and a broken verb that takes
    the help with it."""
    rng = np.random.default_rng(0)
    places = rng.uniform(-35.0, 35.0, (40, 2)).round(3)
    seen = places + np.outer(places[:, 1], [-2e-3, 0.0]) + 1e-4 * rng.normal(size=places.shape)
    lines = [f"X={a} Y={b} DX={x:.5f} DY={y:.5f}" for (a, b), (x, y) in zip(places, seen, strict=True)]
    (tmp_path / "stage.log").write_text("\n".join(lines))
    (tmp_path / "wrong.log").write_text("X=1 Y=2\n")
    (tmp_path / "robot.toml").write_text('kind = "xy_stage"\n[geometry]\ntravel_mm = [120.0, 80.0]\n')
    told, importers, made, lean, wrong = verbs(
        installed, tmp_path, "--help", "import --help", "import xy-log stage.log -o run.csv",
        "squareness robot.toml run.csv", "import xy-log wrong.log -o run.csv", code=1,
    )  # fmt: skip
    assert "Of other packages: squareness How far the axes of an XY stage are from a right angle." in told
    assert "broken: its verb 'say' (os:sep) is str, expected Command" in told
    assert "xy-log" in importers
    assert "40 rows" in made
    assert "the axes lean by 199" in lean
    assert "error: wrong.log: line 1: expected X=… Y=… DX=… DY=…" in wrong


_MEASURE = """
from pathlib import Path
from sherkit.lab.experiment import RunFile, load_experiment, run
from sherkit.lab.laboratory import RunningLaboratory, load_laboratory

with RunningLaboratory(load_laboratory(Path("lab.toml"))) as lab:
    lab.write_ports(Path("ports.json"))
    chosen = load_experiment(Path("experiment.toml"))
    with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
        assert run(chosen.plan, bench, file) == "complete"
        file.measurements().save("run.csv")
"""


def test_an_instrument_from_outside_measures(installed: Path, tmp_path: Path) -> None:
    """Catches a laboratory or an experiment whose kinds of instrument are a closed list."""
    (tmp_path / "robot.toml").write_text('kind = "xy_stage"\n[geometry]\ntravel_mm = [120.0, 80.0]\n')
    motors = '[[instrument]]\nname = "axes"\nkind = "galil"\ncounts_per_mm = 100000\n'
    gauge = '[[instrument]]\nname = "gauge"\nkind = "dial_gauge"\n'
    (tmp_path / "lab.toml").write_text(
        f'robot = "robot.toml"\nseed = 2\ntime_scale = 400.0\n[hidden]\nerrors = 1.0\n{motors}{gauge}noise_mm = 0.001\n'
    )
    (tmp_path / "experiment.toml").write_text(
        'robot = "robot.toml"\nports = "ports.json"\n[plan]\nposes = "grid"\nper_side = 5\norder = "shuffled"\n'
        f"[settle]\nseconds = 0.0\n{motors}poll_s = 0.002\n{gauge}"
    )
    run(installed, tmp_path, _MEASURE)
    assert "the axes lean by" in verbs(installed, tmp_path, "squareness robot.toml run.csv")[0]
