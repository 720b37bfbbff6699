"""What other packages bring: a robot, an instrument, an importer and a verb from a package outside the tree
(``tests/plugin_robot``), installed as anybody would; and the suite that every kind of robot passes."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import distribution
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import sherkit as sk
from planar_arm import KIND as PLANAR
from planar_arm import PlanarArm
from planar_arm.pose_sets import fan
from running import command, several, slow
from sherkit import testing
from sherkit.data.columns import known_layouts
from sherkit.model import kinds
from sherkit.model.kinds import Kind, known_kinds
from sherkit.testing import check_robot

PLUGIN = Path(__file__).parent / "plugin_robot"
PAGE = Path(__file__).parents[1] / "docs" / "howto_package.md"
ARM = PlanarArm((250.0, 180.0), joint_limits_deg=(-170.0, 170.0))


# -- the suite of kinds ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["printer", *slow("spherical", "delta", "serial")])
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
        *slow(
            (lambda k: replace(k, robot=_Short), _Short, "inverse_batch: do not agree"),
            (lambda k: replace(k, model=_Steep), PlanarArm, "derivative by length_1 is not that of the readings"),
            (lambda k: replace(k, model=_Lazy), PlanarArm, "droop: has no remedy"),
            (lambda k: replace(k, virtual=_Bent), PlanarArm, "alarms where nothing is hidden"),
            (lambda k: replace(k, robot=_Open), _Open, "takes a key that nobody knows"),
        ),
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


class _Raises(known_kinds()["delta"].model):  # type: ignore[name-defined, misc]
    """It cannot predict anything."""

    def predict(self, data: Any, values: Any) -> Any:
        raise ValueError("never")


class _Ends(known_kinds()["delta"].model):  # type: ignore[name-defined, misc]
    """It ends the program that asks it."""

    def predict(self, data: Any, values: Any) -> Any:
        raise SystemExit(3)


@pytest.mark.parametrize(("model", "said"), [(_Raises, "ValueError: never"), (_Ends, "SystemExit: 3")])
def test_the_suite_asks_the_kind_that_is_given(model: Any, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a suite that asks the kind which is known by this name, where a model that always raises passed 10 of 10;
    and one that leaves what it was given in the place of what was known."""
    monkeypatch.setattr(testing, "_SEEDS", ())
    held, layouts = known_kinds()["delta"], list(known_layouts())
    with pytest.raises(AssertionError, match="of 10 do not hold") as refused:
        check_robot(replace(held, model=model))
    assert said in str(refused.value)
    assert known_kinds()["delta"] is held
    assert known_layouts() == layouts
    with pytest.raises(AssertionError, match="no_such_joint_mm"):
        check_robot(replace(held, layouts=(replace(held.layout, joints=("no_such_joint_mm", "q2_mm", "q3_mm")),)))
    assert known_layouts() == layouts


def test_a_robot_with_a_kind_of_its_own_is_not_taken_for_another(planar: Kind) -> None:
    """Catches a machine that is asked in place of the kind that was given for it."""
    xy = sk.Machine(
        lambda joints, p: joints * (1.0 + p.scale), joints=("east_mm", "north_mm"), readings=("x_mm", "y_mm"),
        parameters={"scale": ("mm", 1e-3)}, name="xy_in_suite",
    )  # fmt: skip
    try:
        with pytest.raises(AssertionError, match="brings a Kind of its own"):
            check_robot(replace(xy.brings, model=planar.model), xy)
    finally:
        kinds.KINDS.pop(xy.kind, None)


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


def beside(installed: Path) -> str:
    """Where Python looks first: these packages, then where it looks anyway."""
    return os.pathsep.join([str(installed), *filter(None, [os.environ.get("PYTHONPATH")])])


def run(installed: Path, folder: Path, code: str) -> str:
    """What a program prints where the package is installed."""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": beside(installed)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def verbs(installed: Path, folder: Path, *lines: str, code: int = 0) -> list[str]:
    """What verbs print there; the last ends with this code, the others go well."""
    done = several(folder, *lines, PYTHONPATH=beside(installed))
    assert [ended for ended, _, _ in done] == [*[0] * (len(lines) - 1), code], done
    return [" ".join((out + err).split()) for _, out, err in done]


@pytest.mark.slow
def test_a_robot_from_outside_passes_the_suite(installed: Path, tmp_path: Path) -> None:
    """Catches a suite that only sherkit's own robots pass."""
    asked = "import sherkit.testing, xy_stage; print(len(sherkit.testing.check_robot(xy_stage.KIND)))"
    assert run(installed, tmp_path, asked).split()[0] == "9"


def test_a_robot_from_outside_is_one_like_the_others(installed: Path, tmp_path: Path) -> None:
    """Catches a door that only sherkit's own robots come through: a simulation, a diagnosis, the schema."""
    (tmp_path / "robot.toml").write_text('kind = "xy_stage"\n[geometry]\ntravel_mm = [120.0, 80.0]\n')
    made, found, effects, schema = verbs(
        installed, tmp_path, "simulate robot.toml -o run.csv --bow-um 12 --seed 3", "diagnose robot.toml run.csv",
        "effects --robot robot.toml", "schema robot",
    )  # fmt: skip
    assert "broken: its robot 'hexapod' (not_there:KIND) cannot be loaded (ModuleNotFoundError" in made
    assert "broken: its robot 'delta' (xy_stage:KIND) is not used: sherkit's own robot has that name" in made
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


@pytest.mark.slow
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


# -- packages that do harm ---------------------------------------------------------------------------------------


def package(place: Path, name: str, code: str, entries: str) -> None:
    """A package of one module, as an installer leaves it."""
    (place / f"{name}.py").write_text(code)
    meta = place / f"{name}-1.0.dist-info"
    meta.mkdir()
    (meta / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (meta / "entry_points.txt").write_text(entries)


@pytest.fixture(scope="module")
def harmful(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where packages are installed of which each does one thing that none should."""
    place = tmp_path_factory.mktemp("harmful")
    package(place, "ends", "import sys\nsys.exit(0)\n", "[sherkit.robots]\nends = ends:KIND\n[sherkit.verbs]\n"
            "ended = ends:verb\n[sherkit.importers]\nended = ends:verb\n")  # fmt: skip
    package(place, "prints", "import os, click\nprint('NOISE')\nos.write(1, b'RAW')\n"
            "from sherkit.robots.delta import KIND\n@click.command()\ndef verb():\n"
            "    'Says something.'\n    print('said')\n",
            "[sherkit.robots]\nprints = prints:KIND\n[sherkit.verbs]\ncheck = prints:verb\nsaying = prints:verb\n"
            "[sherkit.importers]\nurdf = prints:verb\n[sherkit.instruments]\ngalil = prints:verb\n")  # fmt: skip
    # by its name it comes before sherkit, and its value stands in sherkit
    package(place, "a_thief", "from dataclasses import replace\nfrom sherkit.robots.delta import KIND as D\n"
            "KIND = replace(D, called='stolen')\nBARE = replace(D, name='bare', layouts=None)\n",
            "[sherkit.robots]\ndelta = sherkit.robots.spherical:KIND\nserial = a_thief:KIND\nown = a_thief:KIND\n"
            "bare = a_thief:BARE\n")  # fmt: skip
    code = "class Machine:\n    pass\ndef schema():\n    return {'stolen': True}\nNOTHING = object()\n"
    package(place, "takes", code, "[sherkit.machines]\ndelta = takes:Machine\nsome = takes:Machine\n"
            "[sherkit.simulations]\nsome = takes:NOTHING\n[sherkit.schemas]\nrobot = takes:schema\n"
            "gone = takes:gone\n")  # fmt: skip
    damaged = place / "damaged-1.0.dist-info"
    damaged.mkdir()
    (damaged / "METADATA").write_text("Metadata-Version: 2.1\nName: damaged\nVersion: 1.0\n")
    (damaged / "entry_points.txt").write_text("[sherkit.robots]\nno equals sign here\n")
    return place


def test_a_package_that_does_harm_takes_nothing_with_it(harmful: Path, tmp_path: Path) -> None:
    """Catches an end of sherkit without a word by a sys.exit of a package, its printing in what a program reads, a
    stranger's robot in the place of a built-in one, a kind under another's name, a damaged package that ends all."""
    rows = "".join(f"1{k},2{k},3{k},{k},{k},{k}\n" for k in range(9))
    (tmp_path / "run.csv").write_text(f"q1_mm,q2_mm,q3_mm,x_mm,y_mm,z_mm\n{rows}")
    sk.save_robot(known_kinds()["delta"].example, tmp_path / "robot.toml")
    ((code, out, err),) = several(tmp_path, "check run.csv robot.toml --json", PYTHONPATH=beside(harmful))
    assert code == 0, err
    assert json.loads(out)["good"]
    told = " ".join(err.split())
    for said in (
        "ends: its robot 'ends' (ends:KIND) cannot be loaded (SystemExit: 0)",
        "NOISE",
        "a_thief: its robot 'delta' (sherkit.robots.spherical:KIND) is not used: sherkit's own robot has",
        "a_thief: its robot 'serial' (a_thief:KIND) is not used: sherkit's own robot has that name",
        "a_thief: its robot 'own' (a_thief:KIND) is not used: the Kind calls itself 'delta'",
        "prints: its robot 'prints' (prints:KIND) is not used: the Kind calls itself 'delta'",
        "a_thief: its robot 'bare' (a_thief:BARE) is not used (RobotError: the Kind 'bare': layouts: expected a tuple",
        "damaged",
    ):
        assert said in told
    kinds_of = "from sherkit.model.kinds import known_kinds as k; print({n: o.called for n, o in k().items()})"
    known = run(harmful, tmp_path, kinds_of)
    # those that this package declares
    own = distribution("sherkit").entry_points.select(group="sherkit.robots")
    assert ast.literal_eval(known) == {one.name: known_kinds()[one.name].called for one in own}


@pytest.mark.slow
def test_a_machine_or_schema_from_outside_takes_nothing_with_it(harmful: Path, tmp_path: Path) -> None:
    """Catches a stranger that answers for every delta or for the schema of robots, one that lacks what it is to have
    and ends a verb for all, and a schema that cannot be made and is another file's."""
    sk.save_robot(known_kinds()["delta"].example, tmp_path / "robot.toml")
    simulated, catalogue, schema, gone = several(
        tmp_path, "simulate robot.toml -o run.csv --repeats 1", "effects --json", "schema robot", "schema gone",
        PYTHONPATH=beside(harmful),
    )  # fmt: skip
    assert simulated[0] == 0, simulated[2]
    assert "takes: its simulation 'some' (takes:NOTHING) lacks 'simulate_options'" in " ".join(simulated[2].split())
    assert "rail_lean" in {one["name"] for one in json.loads(catalogue[1])["effects"]["delta"]}
    assert "takes: its machine 'some' (takes:Machine) lacks 'title'" in " ".join(catalogue[2].split())
    assert "stolen" not in schema[1]
    assert gone[0] == 1
    assert "error: schema gone: what makes it cannot be loaded" in " ".join(gone[2].split())


@pytest.mark.slow
def test_a_name_that_is_taken_is_said(harmful: Path, tmp_path: Path) -> None:
    """Catches a verb, an importer or an instrument of a package that is passed over in silence, though the documents
    promise a warning, and one that takes those of sherkit."""
    told, doctor, importers, saying = verbs(harmful, tmp_path, "--help", "doctor", "import --help", "saying")
    for said in (told, doctor):
        assert "prints: its verb 'check' (prints:verb) is not used: sherkit's own verb has that name" in said
        assert "ends: its verb 'ended' (ends:verb) cannot be loaded (SystemExit: 0)" in said
    assert "prints: its importer 'urdf' (prints:verb) is not used: sherkit's own importer has that name" in importers
    assert "said" in saying
    told = run(harmful, tmp_path, "import warnings\nfrom sherkit.lab.kinds import instrument_kinds\n"
               "with warnings.catch_warnings(record=True) as said:\n    instrument_kinds()\n"
               "print(*(w.message for w in said))")  # fmt: skip
    assert "prints: its instrument 'galil' (prints:verb) is not used" in told


def test_a_verb_that_is_none_names_the_nearest(tmp_path: Path) -> None:
    """Catches a refusal of a slip of the finger without the verb that was meant."""
    assert "there is no 'diagnos'; did you mean 'diagnose'?" in command(tmp_path, "diagnos", "robot.toml")[2]
    assert "did you mean 'klipper'?" in command(tmp_path, "import", "klippr")[2]
    code, _, err = command(tmp_path, "xyzzy")
    assert code == 2
    assert "did you mean" not in err
