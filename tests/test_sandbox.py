"""Lines that a person types run in a process of their own: whatever they do, the page lives and loses nothing."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import sherkit as sk
from running import slow
from sherkit import save_robot
from sherkit.app.folder import Typed
from sherkit.app.sandbox import Cancelled, Sandbox
from sherkit.app.views import _card
from sherkit.app.workbench import Workbench
from sherkit.cli.demo import EXAMPLE
from sherkit.errors import EffectError, FitError
from sherkit.model.kinds import model_of
from sherkit.robots.delta.robot import grid
from sherkit.robots.delta.virtual import VirtualDelta

_WAIT_S = 600.0
_HEAD = "import numpy as np\nimport sherkit as sk\n"
_EFFECT = """
@sk.effect(at="body", parameters={"a": "mm"})
def ramp(rows, p):
    "A ramp."
    %s
    return p.a * np.outer(np.sin(rows.position[:, 0] / 7.0), [0, 0, 1])
"""
#: Fails only once the effect is asked for more than in its trial, a thousandth of its plausible size.
_LATE = "if abs(p.a) > 1.5e-4: %s"


def lines(inside: str = "pass", before: str = "") -> str:
    return _HEAD + before + _EFFECT % inside


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Workbench]:
    """A workbench on a small run, whose patience with typed lines is short."""
    save_robot(EXAMPLE, tmp_path / "robot.toml")
    virtual = VirtualDelta.draw(EXAMPLE, 6, rail_lean_rad=8e-3, noise_mm=0.005)
    virtual.measure(grid(20.0, 4, (-18.0, 0.0, 18.0)), repeats=2, seed=1).save(tmp_path / "run.csv")
    made = Workbench.open(tmp_path / "robot.toml", tmp_path / "run.csv", tmp_path / "study")
    yield made
    made.close()
    assert not multiprocessing.active_children()


def patient(bench: Workbench, patience_s: float) -> None:
    """Lines that are typed from now on may take so long."""
    bench._typed = Typed(bench.typed_path, patience_s)
    bench._typed.look = bench._worker.look


def done(bench: Workbench) -> None:
    """Waits until all work that was asked for is done."""
    bench.ask("waiting", lambda study, step: None).result(_WAIT_S)


def errors(bench: Workbench) -> list[str]:
    """The sentences that are told from now on."""
    out: list[str] = []
    bench.listen(lambda kind, value: out.append(value.text) if kind in ("error", "warning") else None)
    return out


def test_effects_apart_give_what_they_give_here(bench: Workbench) -> None:
    """Catches rows that arrive changed, a parameter in another's place, a position that is another model's."""
    study = sk.Study(EXAMPLE, bench.page_state.data)
    made = Sandbox(lines(), lambda: None)

    @sk.effect(at="body", parameters={"a": "mm"})
    def ramp(rows: object, p: object) -> object:
        return p.a * np.outer(np.sin(rows.position[:, 0] / 7.0), [0, 0, 1])  # type: ignore[attr-defined]

    here = sk.Study(EXAMPLE, bench.page_state.data)
    study.add(made.effects[0])
    here.add(ramp)
    made.end()
    np.testing.assert_allclose(study.fit.values, here.fit.values, rtol=1e-9, atol=1e-12)
    assert study.history[-1].error.rms == pytest.approx(here.history[-1].error.rms, rel=1e-9)


def test_out_of_reach_no_effect_is_at_fault(tmp_path: Path) -> None:
    """Catches an effect that looks at where the robot is, refused as "not finite" where a step of the fit leaves what
    can be reached, here and apart, and where a row is marked since nothing reaches it."""
    virtual = VirtualDelta.draw(EXAMPLE, 6, rail_lean_rad=8e-3, noise_mm=0.005)
    data = virtual.measure(grid(20.0, 4, (-18.0, 0.0, 18.0)), repeats=2, seed=1)
    made = Sandbox(lines(), lambda: None)
    model = model_of(EXAMPLE).with_effect(made.effects[0])
    far = model.start(data)
    far[[p.name for p in model.parameters].index("rod_length_1")] = -100.0
    try:
        for what in (model.predict, model.derivatives):
            with pytest.raises(FitError, match="cannot reach"):
                what(data, far)
    finally:
        made.end()

    away = data.to_frame().with_columns(outlier=pl.Series(np.arange(len(data)) == 3))
    away[3, "q1_mm"] = 1e4
    here: dict[str, Any] = {}
    exec(lines(), here)
    fit = sk.identify(EXAMPLE, sk.from_frame(away), effects=[here["ramp"], "rail_lean"])
    assert fit.converged
    assert np.isfinite(fit.values).all()


#: Lines that misbehave in the effect or before it, with what is said of them.
#: Ways to misbehave: endless, dead, dead by a signal, out of memory; then others of the same kinds.
_MISBEHAVE = [
    ("while True: pass", "", "did not end within 0.5 s"),
    ("import os; os._exit(3)", "", "exit code 3"),
    ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "", "SIGSEGV"),
    ("hog = []\n    while True: hog.append(np.empty(50_000_000))", "", "more than 2 GB of memory"),
    ("pass", "while True: pass\n", "did not end within 0.5 s"),
    ("import time; time.sleep(600)", "", "did not end within 0.5 s"),
    ("import subprocess; subprocess.run(['sleep', '600'])", "", "did not end within 0.5 s"),
    ("import sys; sys.exit()", "", "SystemExit"),
    ("pass", "import sys; sys.exit(1)\n", "SystemExit"),
]


@pytest.mark.parametrize("ways", [_MISBEHAVE[:1], *slow(_MISBEHAVE[1:])], ids=len)
def test_lines_that_misbehave_are_ended(bench: Workbench, ways: list[tuple[str, str, str]]) -> None:
    """Catches lines that take the page with them, one that is silent on what happened, and half a change."""
    told = errors(bench)
    for inside, before, said in ways:
        patient(bench, 0.5 if "within" in said else 20.0)
        told.clear()
        bench.type_effect(lines(inside, before))
        done(bench)
        assert len(told) == 1, (inside, before, told)
        assert said in told[0]
        assert bench.page_state.own == ()
        assert not bench.typed_path.exists()
    bench.toggle("rail_lean")
    done(bench)
    assert bench.page_state.effects == ("rail_lean",)


_DETACHED = """
    import subprocess
    subprocess.Popen(["sh", "-c", "(sleep 777.{n} &) ; exit"], start_new_session=True)
    subprocess.Popen(["sleep", "777.{n}"])
    {then}
"""


def running(command: str) -> bool:
    """Whether a program of this command line is there."""
    told = (path.read_bytes() for path in Path("/proc").glob("[0-9]*/cmdline") if os.access(path, os.R_OK))
    with contextlib.suppress(OSError):
        return any(command.encode() in one.replace(b"\0", b" ") for one in told)
    return False


@pytest.mark.parametrize("then", ["import time; time.sleep(600)", *slow("import os; os._exit(3)", "pass")])
def test_what_lines_begin_ends_with_them(bench: Workbench, then: str) -> None:
    """Catches a child, or a detached grandchild, that outlives lines that were ended, crashed or were put away."""
    patient(bench, 1.0 if "sleep" in then else 20.0)
    number = f"{os.getpid()}{abs(hash(then)) % 1000}"
    bench.type_effect(lines(_DETACHED.format(n=number, then=then)))
    done(bench)
    bench.close()
    deadline = time.monotonic() + 20.0
    while running(f"sleep 777.{number}") and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not running(f"sleep 777.{number}")


def test_an_effect_that_crashes_in_the_fit_leaves_the_study_as_it_was(bench: Workbench) -> None:
    """Catches an effect that passed its trial, crashes when it is fitted, and stays in the model."""
    told = errors(bench)
    bench.type_effect(lines(_LATE % "import os; os._exit(7)"))
    done(bench)
    assert bench.page_state.own == ("ramp",)
    bench.toggle("ramp")
    done(bench)
    assert bench.page_state.effects == ()
    assert any("ended their own process" in one or "exit code 7" in one for one in told), told
    # once mended they run
    bench.type_effect(lines())
    bench.toggle("ramp")
    done(bench)
    assert bench.page_state.effects == ("ramp",)
    bench.undo()
    bench.redo()
    done(bench)
    assert bench.page_state.effects == ("ramp",)


def test_cancel_ends_lines_that_run(bench: Workbench) -> None:
    """Catches a Cancel that waits for an endless loop, and one after which the work goes on by itself."""
    told = errors(bench)
    begun = threading.Event()
    bench.listen(lambda kind, value: begun.set() if kind == "progress" and "your lines" in str(value) else None)
    before = bench.page_state
    bench.type_effect(lines("while True: pass"))
    assert begun.wait(_WAIT_S)
    bench.cancel()
    done(bench)
    assert told == ["cancelled: running your lines; nothing was changed"]
    assert bench.page_state is before or bench.page_state.own == ()
    assert not bench.typed_path.exists()


def test_what_is_cancelled_before_it_begins_never_begins(bench: Workbench) -> None:
    """Catches work that was waiting when a person cancelled, and that is done all the same."""
    told = errors(bench)
    hold, held = threading.Event(), threading.Event()

    def wait(study: sk.Study, step: object) -> None:
        held.set()
        hold.wait(_WAIT_S)

    bench.ask("waiting", wait)
    assert held.wait(_WAIT_S)
    bench.toggle("rail_lean")
    bench.toggle("drift")
    bench.cancel()
    hold.set()
    bench.toggle("slip")
    done(bench)
    assert bench.page_state.effects == ("slip",)
    assert [one.split(";")[0] for one in told if one.startswith("cancelled")] == [
        "cancelled: adding rail_lean", "cancelled: adding drift",
    ]  # fmt: skip


def test_lines_are_ended_with_the_one_who_asks(tmp_path: Path) -> None:
    """Catches what a look raises lost in the lines' own errors, and a process that is left behind."""
    asked = time.monotonic()

    def look() -> None:
        if time.monotonic() - asked > 0.3:
            raise Cancelled("enough")

    with pytest.raises((Cancelled, EffectError)):
        Sandbox(lines(before="while True: pass\n"), look)
    assert not multiprocessing.active_children()


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        ("pass", "<sherkit-scene"),
        # whichever of the drawing's questions is the first that is not answered
        pytest.param(
            "while abs(p.a) > 0.1: pass",
            "nothing could be told any more|did not end within 1 s",
            marks=pytest.mark.slow,
        ),
    ],
    ids=["drawn", "endless only where it is exaggerated"],
)
def test_a_typed_effect_is_drawn_apart(bench: Workbench, inside: str, said: str) -> None:
    """Catches a card without its drawing, and a page that hangs since it asks typed lines itself while it draws."""
    patient(bench, 1.0)
    bench.type_effect(lines(inside))
    bench.toggle("ramp").result(_WAIT_S)
    assert dict(bench.page_state.drawings) == {}
    done(bench)
    assert bench.page_state.diagnosis is not None
    drawn = bench.page_state
    assert re.search(said, drawn.drawings["ramp"])

    # an exaggeration that fails is no mistake of the model
    told = errors(bench)
    bench.toggle("rail_lean").result(_WAIT_S)
    assert told == []
    assert bench.page_state.effects == ("ramp", "rail_lean")
    bench.cancel()
    done(bench)

    def asked(*_: object) -> None:
        raise AssertionError("the page asked the typed lines")

    effect = bench.page_state.known["ramp"]
    object.__setattr__(effect, "function", asked)
    assert re.search(said, _card(effect, drawn, opened=False))
