"""Every public value can be pickled, copied and sent to another process; batches leave the interpreter to others."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import math
import multiprocessing
import pickle
import re
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sherkit as sk
import sherkit.errors as errors
from laboratories import SPHERICAL, experiment, laboratory
from second_machines import apart, run_of
from sherkit.cli.demo import EXAMPLE
from sherkit.data.noise import noise_of
from sherkit.lab.kinds import write_ports
from sherkit.model.effect import load_effects
from sherkit.model.kinds import Robot, robot_from_tables
from sherkit.robots.machine import load_machine
from test_fuzz import lines_run

PUBLIC = (sk, sk.data, sk.delta, sk.spherical, sk.tool, sk.fit, sk.model, sk.planning, sk.diagnosis, sk.lab)
EFFECT = '''import numpy as np
import sherkit as sk

@sk.effect(at="body", parameters={"slope": ("mm", 0.01)})
def ramp(rows, p):
    """The floor rises."""
    return p.slope * np.outer(rows.joints[:, 0] / 100.0, [0, 0, 1])
'''


class Leaning:
    """A machine of its own, as a person writes one."""

    parameters = (sk.model.Parameter("lean", "lean", "mm", 0.1),)

    def predict(self, data: sk.Measurements, values: Any) -> Any:
        """Readings that grow with the first input."""
        return data.joints[:, :1] * values

    def derivatives(self, data: sk.Measurements, values: Any) -> Any:
        """By its one parameter."""
        return data.joints[:, :1, None]

    def covariates(self, data: sk.Measurements) -> dict[str, Any]:
        """None."""
        return {}


def virtual_of(robot: Any) -> Any:
    made = sk.spherical.VirtualSpherical
    return made.simulated(robot, 1, 1.0, {name: one.default for name, one in made.OPTIONS.items()})


def seen_run(robot: Robot) -> sk.Measurements:
    virtual = virtual_of(robot)
    return virtual.measure(sk.spherical.sphere_patch(robot, 6), repeats=2, order="planes", seed=1)


@pytest.fixture(scope="module")
def values(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[Any]]:
    """A value of each kind that the package makes, asked for what it computes."""
    left = ExitStack()
    left.enter_context(apart())
    folder = tmp_path_factory.mktemp("values")
    (folder / "my_effects.py").write_text(EFFECT)
    (effect,) = load_effects(folder / "my_effects.py")
    data = lines_run()
    data.save(folder / "run.csv")
    study = sk.Study(EXAMPLE, data, effects=[effect])
    study.add("ramp")
    fit = study.fit
    stream = sk.data.stream_measurements(folder / "run.csv")
    sph: Any = robot_from_tables(SPHERICAL, "spherical")
    looked = seen_run(sph)
    by_sight = sk.identify(sph, looked)
    tool = sk.tool.FlexibleTool()
    hand = sk.tool.VirtualTool(tool)
    run, loads = hand.run("vessels", seconds=4.0, seed=1), hand.bench(seed=1)
    free = hand.free_motion(seconds=4.0, seed=1)
    plain = sk.delta.DeltaModel(EXAMPLE)
    planning = sk.planning.planning_of(plain, data, 0.005)
    write_ports(folder / "ports.json", {n: {"kind": "x", "address": "tcp://127.0.0.1:1"} for n in ("rails", "lasers")})
    laboratory(folder)
    plan = sk.lab.plan_of_poses(data.joints, (1.0, 2.0, 3.0))
    gantry = load_machine(Path(__file__).parents[1] / "examples" / "machines" / "gantry.py")
    of_gantry = sk.Study(gantry, run_of("gantry", 1, poses=40))
    calibrated, seen = sk.calibrate(EXAMPLE, data), sk.tool.estimate(tool, run)
    made = [
        sk.lab.Live(EXAMPLE, plan), sk.model.Extended(Leaning()), plan, effect,
        *plain.catalogue.values(), *fit.parameters, data, stream, data.repeatability, study, fit,
        study.history[-1], study.diagnose(), *study.diagnose().findings, calibrated.calibration, EXAMPLE, study.model,
        sk.delta.VirtualDelta.draw(EXAMPLE, 1), EXAMPLE.sensor_pose, EXAMPLE.tolerances,
        sk.fit.hold_out(plain, data), noise_of(data),
        sk.delta.choose_correction(sk.identify(EXAMPLE, data)), sk.delta.DELTA, sk.fit.identify_stream(EXAMPLE, stream),
        sph, sph.camera, virtual_of(sph), looked, by_sight, by_sight.model,
        sk.Study(sph, looked).calibration(), sk.spherical.camera_placement(200.0, 0.5),
        sk.spherical.task_error(by_sight.model, looked, by_sight.values),
        tool, hand, run, loads, seen, *sk.tool.judge(seen),
        sk.tool.calibrate_tool(tool, loads), sk.tool.ToolModel(tool, run),
        sk.tool.align(free.time_s, free.position_mm, free.camera_time_s, free.camera_mm).registration,
        planning, planning.effect_powers, sk.planning.choose_poses(plain, data, 6),
        sk.planning.EffectSize("rail_lean", {}),
        gantry, of_gantry.model, of_gantry.calibration(), sk.lab.Goal(10.0), sk.lab.load_experiment(experiment(folder)),
        sk.lab.load_laboratory(folder / "lab.toml"), calibrated,
        sk.fit.Mistake("x"), sk.delta.fit_polynomial(data.readings[:, :3], data.readings[:, :3], (1, 1, 1)),
        sk.spherical.remote_centre(sk.identify(sph, looked, effects=["axis_offset"])),
    ]  # fmt: skip
    for value in made:
        asked(value)
    yield made
    left.close()


def asked(value: Any) -> None:
    """Asks a value for everything that it computes and remembers."""
    for name in dir(type(value)):
        if isinstance(inspect.getattr_static(type(value), name), cached_property):
            try:
                getattr(value, name)
            except sk.SherkitError:
                continue


def same(a: Any, b: Any) -> bool:
    """Whether two values hold the same, whatever they remember."""
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if isinstance(a, float):
        return a == b or (math.isnan(a) and math.isnan(b))
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if dataclasses.is_dataclass(a) and not isinstance(a, type):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    return type(a) is type(b)


def test_every_value_is_copied_whole(values: list[Any]) -> None:
    """Catches a compiled part, a closure or a proxy in a value, that cannot be sent, and a copy that lost something."""
    for value in values:
        for copied in (pickle.loads(pickle.dumps(value)), copy.deepcopy(value), copy.copy(value)):
            assert same(copied, value), type(value).__name__
            asked(copied)


def test_every_public_class_is_among_them(values: list[Any]) -> None:
    """Catches a new public class of values that nobody copies here. What holds a port, a file or a thread is none."""
    known = {base for value in values for base in type(value).__mro__}
    missing = []
    for module in PUBLIC:
        for name in module.__all__:
            kind = getattr(module, name)
            if not inspect.isclass(kind) or kind in known or issubclass(kind, BaseException | Warning):
                continue
            holds = re.search("def __enter__|thread|lock", inspect.getsource(kind), re.IGNORECASE)
            if not (holds or getattr(kind, "_is_protocol", False) or inspect.isabstract(kind)):
                missing.append(f"{module.__name__}.{name}")
    assert not missing


def test_every_error_is_copied_whole() -> None:
    """Catches an error of a worker process that ends the pool instead of being told."""
    made: list[BaseException] = [
        errors.OutOfReach("limb 1", 1, 2.0, 0.5), errors.NotWritten("x.csv", OSError(28, "No space left on device")),
        errors.Refused("no", 3, "busy", instrument="rails", port="pty", sent=b"a", received=b"b"),
        errors.Timeout("late", instrument="rails", port="tcp"),
    ]  # fmt: skip
    kinds = [k for k in vars(errors).values() if inspect.isclass(k) and issubclass(k, BaseException | Warning)]
    made += [kind("a sentence") for kind in kinds if kind not in map(type, made)]
    for error in made:
        copied = pickle.loads(pickle.dumps(error))
        assert (type(copied), str(copied), vars(copied)) == (type(error), str(error), vars(error))


def residual(effect: sk.Effect, model: Any, data: sk.Measurements) -> float:
    """What a worker does."""
    return float(np.abs(model.predict(data, np.zeros(len(model.parameters)))).sum()) + len(effect.parameters)


def test_values_go_to_another_process(values: list[Any], tmp_path: Path) -> None:
    """Catches a user's effect or machine that is found in the process that read its file and in no other."""
    effect, study = (
        next(v for v in values if isinstance(v, sk.Effect)),
        next(v for v in values if isinstance(v, sk.Study)),
    )
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        found = pool.apply(residual, (effect, study.model, study.data))
        gantry = load_machine(Path(__file__).parents[1] / "examples" / "machines" / "gantry.py")
        of_gantry = sk.Study(gantry, run_of("gantry", 1, poses=40))
        there = pool.apply(residual, (effect, of_gantry.model, of_gantry.data))
    assert found == pytest.approx(residual(effect, study.model, study.data), rel=1e-12)
    assert there == pytest.approx(residual(effect, of_gantry.model, of_gantry.data), rel=1e-12)


# -- the interpreter's lock ----------------------------------------------------------------------------------

BINDINGS = Path(__file__).parents[1] / "rust" / "python" / "src"


def test_every_batch_is_computed_without_the_lock() -> None:
    """Catches a loop over rows with the lock held: a page or a plot that stands still meanwhile."""
    held = []
    for file in sorted(BINDINGS.glob("*.rs")):
        text = re.sub(r"//.*", "", file.read_text())
        for found in re.finditer(r"fn (\w+)[^{;]*?py: Python<[^{;]*\{", text):
            depth, end = 1, found.end()
            while depth:
                depth += {"{": 1, "}": -1}.get(text[end], 0)
                end += 1
            body = text[found.end() : end]
            loops = re.search(r"\bfor .* in |\.iter\(\)[\s\S]*collect", body)
            # what gives a table of names and numbers goes through a few of them, not through rows
            by_row = not re.search(r"PyDict|PyList", found[0])
            # `Problem::solve` lets go of the lock itself
            if loops and by_row and not re.search(r"\.detach\(|problem\.solve\(", body):
                held.append(f"{file.name}: {found[1]}")
    assert not held


def test_another_thread_goes_on_while_a_batch_is_computed() -> None:
    """Catches a batch that keeps the interpreter's lock: the other thread would stand still."""
    joints = np.random.default_rng(0).uniform(120.0, 135.0, (2_000_000, 3))
    ticks, over = 0, threading.Event()

    def tick() -> None:
        nonlocal ticks
        while not over.is_set():
            ticks += 1

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-4)
    thread = threading.Thread(target=tick)
    try:
        thread.start()
        core = EXAMPLE.kinematics()
        during = 0
        for _ in range(3):
            start = ticks
            core.derivatives_batch(joints[:100_000])
            during += ticks - start
    finally:
        over.set()
        thread.join()
        sys.setswitchinterval(before)
    # a thread that waits for the lock ticks for a switch interval at most, before and after
    assert during > 10_000
