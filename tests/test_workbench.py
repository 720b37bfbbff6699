"""What stands behind the page: one worker, every step saved, errors as sentences, work that gives way."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import sherkit as sk
from changed_worlds import DeltaPair
from sherkit import save_robot
from sherkit.app.views import ordered
from sherkit.app.workbench import Workbench
from sherkit.cli.demo import EXAMPLE
from sherkit.errors import SherkitError
from sherkit.robots.delta.robot import grid
from sherkit.robots.delta.virtual import VirtualDelta

_WAIT_S = 600.0


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """A robot and a run with leaning rails."""
    save_robot(EXAMPLE, tmp_path / "robot.toml")
    virtual = VirtualDelta.draw(EXAMPLE, 6, rail_lean_rad=8e-3, noise_mm=0.005)
    virtual.measure(grid(20.0, 5, (-18.0, 0.0, 18.0)), repeats=2, seed=1).save(tmp_path / "run.csv")
    return tmp_path / "robot.toml", tmp_path / "run.csv"


@pytest.fixture
def bench(files: tuple[Path, Path], tmp_path: Path) -> Iterator[Workbench]:
    """A workbench on it."""
    made = Workbench.open(*files, tmp_path / "study")
    yield made
    made.close()


def heard(bench: Workbench) -> list[tuple[str, Any]]:
    """Everything that listeners are told."""
    out: list[tuple[str, Any]] = []
    bench.listen(lambda kind, value: out.append((kind, value)))
    return out


def settled(bench: Workbench) -> None:
    """Waits until all work that was asked for is done."""
    bench.ask("waiting", lambda study, step: None).result(_WAIT_S)


def test_a_change_is_shown_then_diagnosed_and_saved(bench: Workbench, tmp_path: Path) -> None:
    """Catches a moment that changes under a page that draws it, and a step that is not on disk when it is seen."""
    told = heard(bench)
    before = bench.page_state
    bench.toggle("rail_lean")
    settled(bench)
    moments = [value for kind, value in told if kind == "moment"]
    assert [m.diagnosis is None for m in moments] == [True, False]
    assert moments[0].effects == ("rail_lean",)
    assert moments[-1].diagnosis.verdict == "adequate"
    assert moments[-1].now.noise_size == pytest.approx(moments[-1].diagnosis.noise_size)
    assert before.effects == ()
    with pytest.raises(FrozenInstanceError):
        before.effects = ("slip",)  # type: ignore[misc]
    assert sk.Study.load(tmp_path / "study").effects == ("rail_lean",)
    np.testing.assert_allclose(moments[0].now.values, 1e3 * moments[0].history[-1].fit.residuals[:, :3])
    assert moments[-1].without["rail_lean"] == pytest.approx(before.history[0].error.rms, rel=1e-9)
    bench.toggle("rail_lean")
    bench.undo()
    settled(bench)
    assert bench.page_state.effects == ("rail_lean",)
    assert (bench.page_state.undoes, bench.page_state.redoes) == ("+ rail_lean", "− rail_lean")
    bench.redo()
    settled(bench)
    assert bench.page_state.effects == ()


def test_the_workspace_follows_the_model(bench: Workbench) -> None:
    """Catches a workspace of the model as it came under a model that has changed, or none; it comes after the verdict,
    which must not wait for it."""
    told = heard(bench)
    bench.toggle("rail_lean")
    settled(bench)
    assert [kind for kind, _ in told if kind in ("moment", "space")] == ["moment", "moment", "space"]
    assert bench.page_state.space.startswith("<sherkit-scene")
    assert "geometry calibrated and + rail_lean" in bench.page_state.space
    bench.toggle("rail_lean")
    settled(bench)
    # with one step alone, what is found missing stands beside it
    assert bench.page_state.effects == ()
    assert "geometry calibrated and + rail_lean" in bench.page_state.space


def test_errors_are_sentences_and_change_nothing(bench: Workbench, tmp_path: Path) -> None:
    """Catches a traceback on the page, and half a change."""
    told = heard(bench)
    bench.toggle("no_such_effect")
    bench.undo()
    bench.mark_outliers([10_000])
    bench.put_back()
    bench.add_measurements("empty.csv", b"")
    bench.add_measurements("bad.csv", b"q1_mm,q2_mm,q3_mm,x_mm\n1,2,3,four\n")
    bench.type_effect("raise SystemExit(3)")
    bench.type_effect(
        "import sherkit as sk\n@sk.effect(at='body', parameters={'a': 'mm'})\ndef f(rows, p):\n    return 1\n"
    )
    settled(bench)
    errors = [value.text for kind, value in told if kind == "error"]
    about = [value.about for kind, value in told if kind == "error"]
    assert about == ["no_such_effect", "history", "rows", "rows", "files", "files", "lines", "lines"]
    assert len(errors) == 8, errors
    assert "no_such_effect" in errors[0]
    assert "nothing to undo" in errors[1]
    assert "there is no row 10000" in errors[2]
    assert "no row is left out as a gross error" in errors[3]
    assert errors[4].startswith("empty.csv: is empty")
    assert errors[5].startswith("bad.csv: line 2")
    assert "SystemExit" in errors[6]
    assert bench.page_state.effects == ()
    assert len(bench.page_state.history) == 1
    assert not list((tmp_path / "study").glob("added*"))
    # and the worker goes on
    bench.toggle("rail_lean")
    settled(bench)
    assert bench.page_state.effects == ("rail_lean",)


def test_a_change_makes_a_diagnosis_give_way(bench: Workbench) -> None:
    """Catches a click that waits for a diagnosis nobody needs any more, and a state that is never diagnosed."""
    told = heard(bench)
    started = threading.Event()
    bench.listen(lambda kind, value: started.set() if kind == "progress" and "diagnosing" in str(value) else None)
    bench.diagnose()
    assert started.wait(_WAIT_S)
    bench.toggle("rail_lean")
    settled(bench)
    assert bench.page_state.effects == ("rail_lean",)
    assert bench.page_state.diagnosis.verdict == "adequate"
    assert not [value for kind, value in told if kind == "error"]


def test_work_that_is_cancelled_leaves_the_study_as_it_was(bench: Workbench) -> None:
    """Catches a Cancel that does nothing, or that ends the worker."""
    started = threading.Event()
    bench.listen(lambda kind, value: started.set() if kind == "progress" and "diagnosing: " in str(value) else None)
    bench.diagnose()
    assert started.wait(_WAIT_S)
    bench.cancel()
    settled(bench)
    assert bench.page_state.diagnosis is None
    bench.diagnose()
    settled(bench)
    assert bench.page_state.diagnosis is not None


def test_a_study_is_reopened_only_for_the_same_files(
    files: tuple[Path, Path], bench: Workbench, tmp_path: Path
) -> None:
    """Catches a study of yesterday's run shown for today's."""
    bench.toggle("rail_lean")
    settled(bench)
    with pytest.raises(SherkitError, match="open in another sherkit app"):
        Workbench.open(*files, tmp_path / "study")
    bench.close()
    again = Workbench.open(*files, tmp_path / "study")
    assert again.page_state.effects == ("rail_lean",)
    assert again.page_state.undoes == "+ rail_lean"
    again.undo()
    settled(again)
    assert again.page_state.effects == ()
    again.close()
    text = files[1].read_text()
    files[1].write_text(text + text.splitlines()[-1].replace(",2,", ",3,") + "\n")
    with pytest.raises(SherkitError, match=r"has grown since .* give --follow"):
        Workbench.open(*files, tmp_path / "study")
    header, *rows = text.splitlines(keepends=True)
    files[1].write_text("".join([header, *reversed(rows)]))
    with pytest.raises(SherkitError, match="was begun from another run file; give --fresh"):
        Workbench.open(*files, tmp_path / "study")
    Workbench.open(*files, tmp_path / "study", fresh=True).close()


def test_a_run_that_was_rewritten_is_refused(files: tuple[Path, Path], bench: Workbench) -> None:
    """Catches rows that change their meaning while a run is followed."""
    told = heard(bench)
    lines = files[1].read_text().splitlines(keepends=True)
    assert bench.follow(files[1]) is not None
    settled(bench)
    assert bench.follow(files[1]) is None  # nothing new
    files[1].write_text("".join([lines[0], *lines[2:], *[line.replace(",2,", ",3,") for line in lines[2:]]]))
    bench.follow(files[1])
    settled(bench)
    errors = [value.text for kind, value in told if kind == "error"]
    assert len(errors) == 1, errors
    error = errors[0]
    assert "no longer those that were read before" in error or "was given before" in error
    assert len(bench.page_state.history) == 1


def test_joined_runs_of_a_changed_machine_are_sent_to_compare(tmp_path: Path) -> None:
    """Catches a machine that changed between two runs, called one that no effect explains, without who asks what has
    changed."""
    world = DeltaPair(3, ("base_angle_2",), 60.0, stationed=False)
    save_robot(world.robot, tmp_path / "robot.toml")
    for name, run in zip(("run.csv", "later.csv"), world.runs, strict=True):
        pl.DataFrame(run).write_csv(tmp_path / name)
    bench = Workbench.open(tmp_path / "robot.toml", tmp_path / "run.csv", tmp_path / "study")
    try:
        told = heard(bench)
        bench.add_measurements("later.csv", (tmp_path / "later.csv").read_bytes())
        settled(bench)
        found = bench.page_state.diagnosis
        assert found is not None
        said = [value.text for kind, value in told if kind == "warning"]
        assert any("sherkit compare " in one for one in said) == (found.verdict in ("partly explained", "unexplained"))
        assert found.verdict in ("partly explained", "unexplained"), found.headline
    finally:
        bench.close()


def test_what_goes_with_another_is_offered_beside_it(bench: Workbench) -> None:
    """Catches a second wave in the list of a model that has no first, unfolded and without a number."""
    state = bench.page_state
    second = replace(state.known["backlash"], name="second", goes_with="backlash")
    state = replace(state, known={**state.known, "second": second})
    assert "second" not in ordered(state, {})
    assert "second" in ordered(replace(state, effects=("backlash",)), {})
