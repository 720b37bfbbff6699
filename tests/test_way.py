"""The way of a diagnosis is as CONTRIBUTING draws it."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

import sherkit as sk
from sherkit.cli import main
from strategies import EXAMPLE

HERE = Path(__file__).parents[1]
PACKAGE = Path(sk.__file__).parent
_LINE = re.compile(r"^( *)([\w.]+) +(\S+\.py) +\S")


@dataclass(frozen=True)
class Step:
    """A line of the picture: the function and its file, and the line further out that it stands under."""

    name: str
    file: str
    within: Step | None


def drawn() -> Iterator[Step]:
    """The picture of CONTRIBUTING, from top to bottom."""
    text = (HERE / "CONTRIBUTING.md").read_text(encoding="utf-8")
    picture = text.partition("## The way of a diagnosis")[2].partition("```text\n")[2].partition("```")[0]
    above: list[tuple[int, Step]] = []
    for line in picture.splitlines():
        found = _LINE.match(line)
        assert found is not None, f"'{line}' is no step of the way"
        inward, name, file = len(found[1]), found[2], found[3]
        above = [(there, step) for there, step in above if there < inward]
        step = Step(name, file, above[-1][1] if above else None)
        above.append((inward, step))
        yield step


class Followed:
    """Steps in the order in which each was first entered from the one that it is drawn within."""

    def __init__(self, steps: list[Step]) -> None:
        self.steps = {(step.file, step.name.rpartition(".")[2]): step for step in steps}
        self.entered: list[Step] = []
        self.open: list[tuple[Step, FrameType]] = []

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        if event == "return" and self.open and self.open[-1][1] is frame:
            self.open.pop()
        if event != "call" or not frame.f_code.co_filename.startswith(str(PACKAGE)):
            return
        file = Path(frame.f_code.co_filename).relative_to(PACKAGE).as_posix()
        step = self.steps.get((file, frame.f_code.co_name))
        if step is None or step.within != (self.open[-1][0] if self.open else None):
            return
        self.open.append((step, frame))
        if step not in self.entered:
            self.entered.append(step)


def test_the_way_is_as_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a picture that tells of another way than the code goes: a function that is not there, is never called, is
    called by somebody else, or in another order."""
    steps = list(drawn())
    virtual = sk.delta.VirtualDelta.draw(EXAMPLE, 3, rail_lean_rad=3e-3, noise_mm=0.005)
    virtual.measure(sk.delta.paper_local()[::4], repeats=2, order="shuffled", seed=4).save(tmp_path / "run.csv")
    sk.save_robot(EXAMPLE, tmp_path / "robot.toml")
    followed = Followed(steps)
    sys.setprofile(followed)
    try:
        with pytest.raises(SystemExit) as ended:
            main(["diagnose", str(tmp_path / "robot.toml"), str(tmp_path / "run.csv")])
    finally:
        sys.setprofile(None)
    assert ended.value.code == 0
    assert "explained: rail_lean" in capsys.readouterr().out
    assert [step.name for step in followed.entered] == [step.name for step in steps]
