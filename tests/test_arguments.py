"""Absurd arguments at the Python door: an answer, or one sentence of ours."""

from __future__ import annotations

import dis
import inspect
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import sherkit as sk
from mutations import HANGS_S, at_most
from sherkit.cli.demo import EXAMPLE
from sherkit.model import Parameter
from test_fuzz import lines_run
from test_other_programs import told

#: What a text is a path of lies in the folder of the test.
_LETTERS = st.characters(exclude_characters="/.~")
#: Arguments that are tried; ``SHERKIT_FUZZ`` sets another count.
TRIED = int(os.environ.get("SHERKIT_FUZZ", "250"))
ABSURD = st.one_of(
    st.sampled_from((
        None, True, -1, 0, 2, 10**30, -1.0, 0.5, float("nan"), float("inf"), "", "x", "1", "\0", b"x", "linear", (), [],
        {}, set(), [None], ["x"], [1.5], [[1.0, "x"]], {"x": 1}, {1: 2}, 1j, np.nan, np.array(1.0), np.zeros((2, 2)),
        np.array(["a"]), np.array([None]), Path(), Path("nowhere"), print, int, object(), Ellipsis, NotImplemented,
    )),
    st.integers(), st.floats(), st.text(_LETTERS, max_size=3), st.binary(max_size=3),
    st.lists(st.one_of(st.none(), st.floats(), st.text(max_size=2)), max_size=3),
    st.dictionaries(st.text(max_size=2), st.one_of(st.none(), st.floats(), st.lists(st.floats())), max_size=2),
)  # fmt: skip


@dataclass(frozen=True)
class Door:
    """What a person calls, and arguments with which it works."""

    call: Callable[..., object]
    good: dict[str, Any]


def _kept(path: Path) -> Path:
    """A loop that was saved."""
    sk.Adaptive(EXAMPLE).save(path)
    return path


def doors(folder: Path) -> dict[str, Door]:
    """Every public name that can be called, and the methods of what it makes."""
    data = lines_run()
    study = sk.Study(EXAMPLE, data)
    study.calibration().save(folder / "calibrated.toml")
    sk.save_robot(EXAMPLE, folder / "robot.toml")
    data.save(folder / "run.csv")
    study.save(folder / "study")
    path = folder / "run.csv"
    fitted = {"robot": EXAMPLE, "data": data, "free": (), "effects": (), "loss": "linear"}

    def of_a_study(name: str) -> Callable[..., object]:
        def call(**given: Any) -> object:
            # a study of its own each time, without another fit
            made = sk.Study.load(folder / "study")
            return getattr(made, name)(**given)

        return call

    sway = lambda rows, p: p.size * rows.joints  # noqa: E731
    return {
        "Study": Door(sk.Study, {**fitted, "seed": 0}),
        "Study.add": Door(of_a_study("add"), {"effect": "encoder_cyclic", "period_mm": 2.0}),
        "Study.add slip": Door(of_a_study("add"), {"effect": "slip", "slip_time_s": 40.0}),
        "Study.remove": Door(of_a_study("remove"), {"name": "rail_lean"}),
        "Study.without": Door(of_a_study("without"), {"name": "rail_lean"}),
        "Study.extend": Door(of_a_study("extend"), {"more": data}),
        "Study.follow": Door(of_a_study("follow"), {"data": data}),
        "Study.mark_outliers": Door(of_a_study("mark_outliers"), {"rows": [1]}),
        "Study.put_back": Door(of_a_study("put_back"), {"rows": [1]}),
        "Study.diagnose": Door(of_a_study("diagnose"), {"level": 0.01}),
        "Study.register": Door(of_a_study("register"), {"effect": None}),
        "Study.save": Door(of_a_study("save"), {"folder": folder / "saved"}),
        "Study.load": Door(sk.Study.load, {"folder": folder / "study", "effects": ()}),
        "Adaptive": Door(
            sk.Adaptive,
            {"robot": EXAMPLE, "required_um": 20.0, "budget": 40, "span_min": 1.0, "box": {"x_mm": (-5.0, 5.0)},
             "level": 0.01, "batch": 6, "seed": 0, "minutes": None},
        ),
        "Adaptive.tell": Door(lambda **given: sk.Adaptive(EXAMPLE).tell(**given), {"rows": data.to_frame().head(3)}),
        "Adaptive.save": Door(lambda **given: sk.Adaptive(EXAMPLE).save(**given), {"path": folder / "loop.json"}),
        "Adaptive.load": Door(sk.Adaptive.load, {"path": _kept(folder / "kept.json"), "robot": None}),
        "compare": Door(sk.compare, {"robot": EXAMPLE, "runs": [data, data], "effects": ()}),
        "history": Door(sk.history, {"robot": EXAMPLE, "runs": [data, data], "dates": (), "effects": ()}),
        "verify": Door(sk.verify, {"calibration": folder / "calibrated.toml", "run": path}),
        "calibrate": Door(
            sk.calibrate,
            {"robot": EXAMPLE, "whole": data, "local": None, "free": (), "effects": (), "loss": "linear",
             "priors": False, "linear": False, "correction": "none", "seed": 0},
        ),
        "diagnose": Door(sk.diagnose, {"fit": study.fit, "effects": (), "level": 0.01, "seed": 0}),
        "fleet": Door(sk.fleet, {"runs": [path], "robot": EXAMPLE, "level": 0.01, "seed": 0}),
        "diagnose a robot": Door(sk.diagnose, {"fit": EXAMPLE, "data": data}),
        "identify": Door(sk.identify, {**fitted, "priors": False, "linear": False, "start": None, "noise": None}),
        "effect": Door(
            lambda **given: sk.effect(**given)(sway),
            {"at": "joints", "parameters": {"size": ("mm", 0.01)}, "needs": (), "physics": "", "remedy": "",
             "derivative": None},
        ),
        "Effect": Door(
            sk.Effect,
            {"name": "sway", "link": "joints", "parameters": (Parameter("size", "a", "mm", 0.1),), "needs": (),
             "physics": "", "residuals": "", "remedy": "", "search": None, "function": sway, "derivative": None},
        ),
        "from_frame": Door(sk.from_frame, {"frame": data.to_frame(), "source": "frame", "columns": None}),
        "from_bluesky": Door(
            sk.from_bluesky, {"documents": list(told()), "columns": None, "stream": "primary", "poses": False}
        ),
        "from_rosbag": Door(
            sk.from_rosbag,
            {"path": folder / "no_bag", "joints": {"q1_mm": "rail_1"}, "poses": "/tracker", "joint_states": "/js",
             "coordinates": ("x_mm",), "longest_gap_s": 0.05, "still_per_s": None},
        ),
        "read_measurements": Door(sk.read_measurements, {"path": path, "columns": None}),
        "load_robot": Door(sk.load_robot, {"path": folder / "robot.toml"}),
        "load_calibration": Door(sk.load_calibration, {"path": folder / "calibrated.toml"}),
        "save_robot": Door(sk.save_robot, {"robot": EXAMPLE, "path": folder / "saved.toml"}),
        "hold_out": Door(sk.fit.hold_out, {"robot": study.model, "data": data, "folds": 5, "seed": 0, "loss": "huber"}),
        "stream": Door(
            lambda **given: list(sk.data.stream_measurements(**given).blocks()), {"path": path, "block_rows": 10}
        ),
        "choose_poses": Door(
            sk.planning.choose_poses, {"model": study.model, "candidates": data, "count": 30, "sigma": 1.0, "seed": 0}
        ),
    }  # fmt: skip


def said(error: BaseException) -> str | None:
    """None where it is one of ours, or raised by a line of ours on purpose; else where it comes from."""
    trace = error.__traceback__
    while trace.tb_next is not None:
        trace = trace.tb_next
    code = trace.tb_frame.f_code
    told = str(error)
    if not isinstance(error, sk.SherkitError | ValueError | TypeError) or not told or len(told) > 600:
        return f"{type(error).__name__} at {code.co_filename}:{trace.tb_lineno}: {told[:150]!r}"
    raised = dis.opname[code.co_code[trace.tb_lasti]] in ("RAISE_VARARGS", "RERAISE")
    if isinstance(error, sk.SherkitError) or (raised and "sherkit" in code.co_filename):
        return None
    # what has the wrong name, or is left out, Python itself says well
    return f"{type(error).__name__} at {code.co_filename}:{trace.tb_lineno}: {told[:150]!r}"


def tried(door: Door, name: str, value: object) -> str | None:
    """What is wrong with what is said of an argument; None where nothing is."""
    try:
        with at_most(4 * HANGS_S), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            door.call(**{**door.good, name: value})
    except Exception as error:
        return said(error)
    return None


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Door]:
    return doors(tmp_path_factory.mktemp("doors"))


def test_an_absurd_argument_is_named_in_a_sentence(
    known: dict[str, Door], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a traceback out of NumPy or pathlib for a seed of -1, a level that is NaN, a text for a number, a folder
    for a file, a list of lists for a list."""
    names = [(door, argument) for door, one in known.items() for argument in one.good]
    monkeypatch.chdir(tmp_path)  # what can be written is
    wrong: dict[str, str] = {}

    @settings(
        max_examples=TRIED, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck)
    )
    @given(which=st.sampled_from(names), value=ABSURD)
    def walk(which: tuple[str, str], value: object) -> None:
        door, argument = which
        if (told := tried(known[door], argument, value)) is not None:
            wrong.setdefault(f"{door}({argument}=…): {told}", repr(value))

    walk()
    assert not wrong, "\n".join(f"{kind}\n    {value}" for kind, value in wrong.items())


@pytest.mark.parametrize("name", ["seed", "level", "folds", "block_rows"])
def test_a_number_out_of_range_is_refused_before_anything_is_done(known: dict[str, Door], name: str) -> None:
    """Catches a seed, a level or a count that goes down to NumPy, or that is taken as it is."""
    for one in known.values():
        for value in (-1, float("nan"), "1", 2.5) if name in one.good else ():
            with pytest.raises(
                sk.errors.ArgumentError, match=rf"^\w+(\.\w+)?: {name}: expected a \w+ number (above|of at least)"
            ):
                one.call(**{**one.good, name: value})


def test_every_public_name_is_walked(known: dict[str, Door]) -> None:
    """Catches a new public function, or a new method of a study, that nobody gives absurd arguments."""
    walked = {name.split()[0] for name in known}
    called = {name for name in sk.__all__ if inspect.isfunction(getattr(sk, name))} | {"Study", "Effect"}
    methods = {f"Study.{name}" for name, one in vars(sk.Study).items() if callable(one) and not name.startswith("_")}
    without = {"Study.undo", "Study.redo", "Study.calibration"}  # nothing is given to them
    assert called | methods - without <= walked
