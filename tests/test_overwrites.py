"""Nothing of a person's is overwritten: every verb, every option that writes, every one of its inputs.

The cases are made from the commands' own parameters, so that a new verb or option is among them by itself.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
import pytest

import sherkit as sk
from sherkit.cli import file_kinds, main
from sherkit.cli.demo import EXAMPLE
from sherkit.cli.file_kinds import FileKind
from sherkit.cli.paths import InputFile, OutputFile, OutputFolder
from sherkit.cli.verbs import cli
from sherkit.data.files import write_whole
from sherkit.errors import ExperimentError, SherkitError
from sherkit.lab.experiment import RunFile, load_experiment, plan_of_poses, run_lock
from sherkit.lab.kinds import write_ports
from sherkit.lab.verbs import lab
from sherkit.model.robot_file import save_robot
from sherkit.report.card import card_page
from sherkit.robots.c_header import calibration_header
from sherkit.robots.delta.robot import grid
from sherkit.robots.delta.virtual import VirtualDelta
from sherkit.robots.tool.tool import FlexibleTool

PLAN = plan_of_poses(np.array([[100.0, 101.0, 102.0]]), (90.0, 90.0, 90.0))
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="links and devices of POSIX")

# -- The table of all verbs ------------------------------------------------------------------------------------------


def verbs() -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """What can be typed, with its command; groups are walked."""

    def below(words: tuple[str, ...], command: click.Command) -> Iterator[tuple[tuple[str, ...], click.Command]]:
        if isinstance(command, click.Group):
            context = click.Context(command)
            for name in command.list_commands(context):
                yield from below((*words, name), command.get_command(context, name))
        else:
            yield words, command

    yield from below((), cli)


@dataclass(frozen=True)
class Case:
    """A verb, an option of it that writes, and an input that it could write over."""

    words: tuple[str, ...]
    command: click.Command
    output: click.Parameter
    read: click.Parameter

    def __str__(self) -> str:
        return " ".join((*self.words, str(self.output.name), str(self.read.name)))


def params(command: click.Command) -> list[click.Parameter]:
    # as it is asked below its group: a command keeps the options for help with which it was asked first
    return command.get_params(click.Context(command, parent=click.Context(cli, **cli.context_settings)))


CASES = [
    Case(words, command, output, read)
    for words, command in verbs()
    for output in params(command)
    # what is written where it is installed it looks at by itself
    if isinstance(output.type, OutputFile) or (isinstance(output.type, OutputFolder) and output.type.files)
    for read in params(command)
    if isinstance(read.type, InputFile)
]
#: What stands in a file. No verb has to read it: it refuses before.
CONTENT = "q1_mm,x_mm\n1,2\n3,4\n"


def typed(case: Case, path: Callable[[click.Parameter], list[str]]) -> list[str]:
    """A line that gives the verb all that it asks for; ``path`` says what is typed for a path."""
    options, arguments = [], []
    for param in params(case.command):
        wanted = param in (case.output, case.read)
        if not (param.required or wanted or isinstance(param, click.Argument)):
            continue
        if isinstance(param.type, InputFile | OutputFile | OutputFolder):
            given = path(param)
        elif isinstance(param.type, click.Choice):
            given = [str(param.type.choices[0])]
        else:
            given = ["1"]
        if isinstance(param, click.Argument):
            arguments += given
        else:
            options += [param.opts[0], given[0]]
    return [*case.words, *arguments, *options]


def refused(line: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one sentence with which a line is refused."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        main(line)
    said = capsys.readouterr()
    assert (ended.value.code, said.out) == (1, ""), (line, said)
    assert said.err.startswith("error: ")
    assert said.err.count("\n") == 1
    return said.err


def content_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sherkit.vision.verbs.cameras.require_vision", lambda: None)


LINKS: dict[str, Callable[[Path, Path], object]] = {
    "itself": print, "spelt otherwise": print, "a link": os.symlink, "a hard link": os.link,
}  # fmt: skip


# -- An input is never an output -------------------------------------------------------------------------------------


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_no_verb_writes_over_what_it_reads(
    case: Case, link: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches an output that replaces an input, by any name of it: the rows of a run by a page, a robot by a table; and
    a verb that works for an hour before it refuses."""
    into = tmp_path / "into"
    into.mkdir()
    output = case.output.type
    if isinstance(output, OutputFolder):
        name = next(iter(output.files)).replace("*", "0001")
    else:
        name = f"output{output.kinds[0].endings[0]}"
    target = into / name
    linked = link in ("a link", "a hard link")
    real = tmp_path / "real" if linked else target
    real.write_text(CONTENT)
    if linked:
        LINKS[link](real, target)
    spelt = into / ".." / "into" / name if link == "spelt otherwise" else target

    def path(param: click.Parameter) -> list[str]:
        if param is case.output:
            return [str(spelt.parent if isinstance(output, OutputFolder) else spelt)]
        if param is case.read:
            return [str(real)]
        return [str(tmp_path / f"{param.name}.toml")]

    before = content_of(tmp_path)
    monkeypatch.setattr(case.command, "callback", lambda **_: pytest.fail("it works before it refuses"))
    refused(typed(case, path), capsys)
    assert content_of(tmp_path) == before
    assert target.is_symlink() == (link == "a link")


def test_the_cases_are_there() -> None:
    """Catches a table that is empty, and cases that are made of half of it."""
    assert len(CASES) > 60
    assert {case.words[0] for case in CASES} >= {
        "app", "calibrate", "check", "compare", "diagnose", "effects", "estimate", "export", "history", "import", "lab",
        "markers", "measure", "plan", "printer", "register", "simulate", "tool", "intrinsics",
    }  # fmt: skip


def test_every_path_of_a_verb_says_what_it_is_for() -> None:
    """Catches an option with a path that nothing guards: one of click's own, or a word that is opened as a file."""
    ours = (InputFile, OutputFile, OutputFolder)
    for words, command in verbs():
        for param in params(command):
            is_ours = isinstance(param.type, ours)
            assert is_ours or not isinstance(param.type, click.Path | click.File), (words, param.name)
            # of what is given by its place only the name of an effect is no path and no choice
            free = isinstance(param, click.Argument) and not isinstance(param.type, click.Choice)
            assert is_ours or not free or words == ("effects",), (words, param.name)


# -- What is no file -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("made", ["a folder", "a device", "a pipe"])
@pytest.mark.parametrize(
    ("words", "command", "read"),
    [(w, c, p) for w, c in verbs() for p in params(c) if isinstance(p.type, InputFile)],
    ids=lambda v: " ".join(v) if isinstance(v, tuple) else getattr(v, "name", ""),
)
def test_what_is_no_file_is_not_read(
    words: tuple[str, ...], command: click.Command, read: click.Parameter, made: str, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Catches ``/dev/zero`` read until memory ends, and a pipe that nobody writes into waited for for ever."""
    if made == "a folder" and isinstance(read.type, InputFile) and read.type.folders:
        pytest.skip("folders are read, or told of in a line of the table")
    odd = {"a folder": tmp_path / "folder", "a device": Path("/dev/zero"), "a pipe": tmp_path / "pipe"}[made]
    if made == "a folder":
        odd.mkdir()
    elif made == "a pipe":
        os.mkfifo(odd)
    case = Case(words, command, read, read)

    def path(param: click.Parameter) -> list[str]:
        if param is read:
            return [str(odd)]
        return [str(tmp_path / f"{param.name}.csv")]

    assert f"{odd}: is {made}, expected a file" in refused(typed(case, path), capsys)


# -- Another kind of file is never replaced --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def kinds(tmp_path_factory: pytest.TempPathFactory) -> dict[FileKind, Path]:
    """A file of each kind, as sherkit itself writes it, and a few of a person's own."""
    folder = tmp_path_factory.mktemp("kinds")
    virtual = VirtualDelta.draw(EXAMPLE, 6, noise_mm=0.005)
    data = virtual.measure(grid(20.0, 4, (-15.0, 0.0, 15.0)), repeats=2, seed=1)
    study = sk.Study(EXAMPLE, data)
    study.save(folder)
    data.save(folder / "run.csv")
    calibration = study.calibration()
    calibration.save(folder / "calibrated.toml")
    save_robot(EXAMPLE, folder / "robot.toml")
    FlexibleTool().save(folder / "tool.toml")
    write_ports(folder / "ports.json", {"rails": {"kind": "galil", "address": "x"}})
    with RunFile.create(folder / "run.sqlite", PLAN, {"robot": "", "experiment": ""}) as file:
        file.begin({})
    for name, text in {
        "robot.h": calibration_header(calibration),
        "page.html": card_page("x", []),
        "effect.py": '"""Written by `sherkit diagnose`: x.\n"""\n',
        "lab.toml": 'robot = "robot.toml"\n',
        "camera.toml": "[camera]\nsize_px = [1, 1]\n",
        "truth.toml": f"{file_kinds.PLANTED_BY}rail_lean_rad = [0.0]\n",
        "drawn.svg": '<svg xmlns="http://www.w3.org/2000/svg"></svg>',
        "marker.pdf": "%PDF-1.4",
        "printer.cfg": "[printer]\nkinematics: delta\n[stepper_a]\n",
        "m665.g": "M665 L1\nM666 X0\n",
        "study.jsonl": '{"study": "00"}\n[]\n',
        "sources.json": '{"robot": "", "run": "", "run_bytes": 1}',
    }.items():
        (folder / name).write_text(text)
    K = file_kinds
    return {kind: folder / name for kind, name in {
        K.TABLE: "run.csv", K.CALIBRATION: "calibrated.toml", K.TOOL: "tool.toml", K.ROBOT: "robot.toml",
        K.PLANNED: "lab.toml", K.CAMERA: "camera.toml", K.PLANTED: "truth.toml", K.PAGE: "page.html",
        K.PICTURE: "drawn.svg", K.PRINTED: "marker.pdf", K.TEMPLATE: "effect.py", K.HEADER: "robot.h",
        K.KLIPPER: "printer.cfg", K.COMMANDS: "m665.g", K.PORTS: "ports.json", K.RESULTS: "study.jsonl",
        K.RUN: "run.sqlite", K.STUDY: "study.json", K.BEGUN_FROM: "sources.json",
    }.items()}  # fmt: skip


#: Lines of a person's own, which are of no kind that a verb writes.
OWN = {
    "notes.txt": "Dear diary,\nthe robot was measured on Monday, again, twice.\n", "mine.py": "import sherkit\n",
    "raw.csv": "Measured by hand\nq1,q2,q3\n1,2,3\n", "config.g": "M665 L1\nM84 S30\n", "my.h": "#pragma once\n",
    "mine.toml": "[a]\nb = 1\n", "data.json": "[1, 2]", "mine.cfg": "[extruder]\n", "moving.png": "GIF89a",
    "page.html": "a,b\n1,2\n", "other.sqlite": "SQLite format 3\0", "letter.pdf": "a letter",
}  # fmt: skip
OUTPUTS = list(
    {
        param.type.kinds: param.type
        for _, command in verbs()
        for param in params(command)
        if isinstance(param.type, OutputFile)
    }.values()
)


@pytest.mark.parametrize("output", OUTPUTS, ids=lambda o: ", ".join(kind.called for kind in o.kinds))
def test_a_file_is_replaced_by_one_of_its_kind_alone(output: OutputFile, kinds: dict, tmp_path: Path) -> None:
    """Catches a run replaced by a calibration, a person's own text by a table; and an output that is refused where the
    verb wrote it the last time."""
    for kind, path in kinds.items():
        pictures = {file_kinds.PAGE, file_kinds.PICTURE, file_kinds.DRAWN}
        same = kind in output.kinds or ({kind, *output.kinds} <= pictures and path.suffix in output.kinds[0].endings)
        if same:
            assert output.checked(path, "--output") == path
        else:
            with pytest.raises(SherkitError, match=r"give --output another name|expected a name that ends in"):
                output.checked(path, "--output")
    for name, text in OWN.items():
        (tmp_path / name).write_text(text)
        if not (name.endswith("sqlite") and output.kinds == (file_kinds.RUN,)):  # refused when it is opened
            with pytest.raises(SherkitError, match=r"give --output another name|expected a name that ends in"):
                output.checked(tmp_path / name, "--output")
    for name in ("fresh", "empty"):
        free = tmp_path / f"{name}{output.kinds[0].endings[0]}"
        if name == "empty":
            free.touch()  # as mktemp makes them
        assert output.checked(free, "--output") == free


@pytest.mark.parametrize("beside", ["", "-wal", "-shm", "-journal", ".lock"])
def test_a_run_is_not_written_over(beside: str, kinds: dict, tmp_path: Path) -> None:
    """Catches a finished run whose newest rows stand beside it in a log that a verb replaces, through a link too."""
    shutil.copy(kinds[file_kinds.RUN], tmp_path / "run.csv")
    target = tmp_path / f"run.csv{beside}"
    if beside:
        os.symlink(target, tmp_path / "link.csv")
        target = tmp_path / "link.csv"
    for output in OUTPUTS:
        if output.kinds != (file_kinds.RUN,):
            with pytest.raises(SherkitError, match=r"run file of an experiment|expected a name that ends in"):
                output.checked(target, "--output")


# -- As they were found ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "line",
    [
        "measure experiment.toml --until diagnosed --report run.sqlite",
        "compare robot.toml run.csv a.csv --report a.csv",
        "check run.csv robot.toml --write robot.toml", "check run.csv robot.toml --write run.csv",
        "simulate robot.toml -o robot.toml", "calibrate robot.toml run.csv -o run.csv",
        "calibrate robot.toml run.csv -o tool.toml", "export c calibrated.toml -o calibrated.toml",
        "export c calibrated.toml -o run.csv", "export run.sqlite -o robot.h", "export run.sqlite -o run.sqlite",
        "estimate tool.toml run.csv -o run.csv", "simulate robot.toml -o new.csv --truth robot.toml",
        "simulate robot.toml -o new.csv --truth new.csv", "import poses robot.toml run.csv -o .",
        "diagnose robot.toml run.csv --report page.png", "diagnose robot.toml run.csv --template mine.py",
        "plan robot.toml lab.toml --keep run.sqlite", "lab lab.toml --ports lab.toml", "demo -o run.csv",
        "diagnose robot.toml run.csv --report nowhere.csv", "lab --demo -o .",
    ],
)  # fmt: skip
def test_what_was_lost(line: str, kinds: dict, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches each of the ways in which a lab's data was lost once more."""
    for path in kinds.values():
        shutil.copy(path, tmp_path)
    (tmp_path / "mine.py").write_text(OWN["mine.py"])
    shutil.copy(tmp_path / "run.csv", tmp_path / "a.csv")
    shutil.copy(tmp_path / "run.sqlite", tmp_path / "local.sqlite")
    before = content_of(tmp_path)
    refused(line.split(), capsys)
    assert content_of(tmp_path) == before


def test_the_demo_takes_only_its_own_runs_away(kinds: dict, tmp_path: Path) -> None:
    """Catches a lab's finished run that goes since the demo names one of its own so, and a second demo that does not
    begin since the first one's runs are there."""
    lab.write_files(tmp_path, 2, lab._TIME_SCALE)
    texts = lab.experiments(2, lab._TIME_SCALE)
    chosen = load_experiment(tmp_path / "local.toml", offline=True)
    RunFile.create(chosen.run_path, chosen.plan, chosen.about()).close()
    (tmp_path / "local.sqlite.lock").touch()  # of a demo that was killed
    lab._anew(tmp_path, texts)
    assert not list(tmp_path.glob("*.sqlite*"))
    shutil.copy(kinds[file_kinds.RUN], tmp_path / "local.sqlite")
    before = content_of(tmp_path)
    with pytest.raises(ExperimentError, match=r"local\.sqlite: holds a run that is none of this demo's"):
        lab.lab_demo(tmp_path)
    assert content_of(tmp_path) == before


# -- Whole or absent, and nothing beside -----------------------------------------------------------------------------


def test_a_study_takes_nothing_away_but_its_own_rows(tmp_path: Path) -> None:
    """Catches rows-monday.parquet of the lab's own that go with the study's, rows that somebody wrote anew under the
    study's name, and another program's study.json."""
    virtual = VirtualDelta.draw(EXAMPLE, 6, noise_mm=0.005)
    study = sk.Study(EXAMPLE, virtual.measure(grid(20.0, 4, (-15.0, 0.0, 15.0)), repeats=2, seed=1))
    (tmp_path / "rows-monday.parquet").write_text("the lab's")
    study.save(tmp_path)
    first = json.loads((tmp_path / "study.json").read_text())["rows"]
    study.mark_outliers([3])
    study.save(tmp_path)
    second = json.loads((tmp_path / "study.json").read_text())["rows"]
    assert {p.name for p in tmp_path.iterdir()} == {"study.json", second, "rows-monday.parquet"}
    (tmp_path / second).write_text("somebody's")
    (tmp_path / first).write_text("somebody's")
    study.undo()
    study.save(tmp_path)
    assert (tmp_path / first).read_text() == (tmp_path / second).read_text() == "somebody's"
    assert not sk.Study.load(tmp_path).data.outlier.any()
    # as studies were written before: they do not say what they wrote
    state = json.loads((tmp_path / "study.json").read_text())
    of_old = tmp_path / state["rows"]
    del state["rows_sha256"]
    (tmp_path / "study.json").write_text(json.dumps(state))
    study.mark_outliers([3])
    study.save(tmp_path)
    assert of_old.exists()
    (tmp_path / "study.json").write_text('{"name": "of another program"}')
    with pytest.raises(SherkitError, match=r"study\.json: is no study"):
        study.save(tmp_path)


def test_an_old_study_is_read(tmp_path: Path) -> None:
    """Catches a study without the hash of its rows that can no longer be opened, or whose damage is not seen."""
    virtual = VirtualDelta.draw(EXAMPLE, 6, noise_mm=0.005)
    sk.Study(EXAMPLE, virtual.measure(grid(20.0, 4, (-15.0, 0.0, 15.0)), repeats=2, seed=1)).save(tmp_path)
    state = json.loads((tmp_path / "study.json").read_text())
    del state["rows_sha256"]
    (tmp_path / "study.json").write_text(json.dumps(state))
    assert len(sk.Study.load(tmp_path).data) == 96
    with (tmp_path / state["rows"]).open("ab") as file:
        file.write(b"x")
    with pytest.raises(SherkitError, match="is damaged"):
        sk.Study.load(tmp_path)


def test_ctrl_c_leaves_the_old_file_and_nothing_beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a temporary file that stays, and half of a table, where a person presses Ctrl-C while it is written."""
    (tmp_path / "run.csv").write_text("old")

    def interrupted(_: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "run.csv", "new")
    assert content_of(tmp_path) == {"run.csv": b"old"}


def test_a_lock_goes_with_its_run(tmp_path: Path) -> None:
    """Catches ``run.sqlite.lock`` left behind, and one that a second program holds taken away by the first."""
    path = tmp_path / "run.sqlite"
    with RunFile.create(path, PLAN, {"robot": "", "experiment": ""}) as file:
        file.begin({})
        assert (tmp_path / "run.sqlite.lock").exists()
        with pytest.raises(ExperimentError, match="is being measured by another program"):
            RunFile.resume(path, PLAN, {"robot": "", "experiment": ""})
        assert (tmp_path / "run.sqlite.lock").exists()
    assert {p.name for p in tmp_path.iterdir()} == {"run.sqlite"}


def test_a_lock_that_was_taken_away_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches two runners: one that waits for a lock gets it when its file has gone, and holds a lock of nothing."""
    (tmp_path / "a.sqlite").touch()
    lock, real, once = tmp_path / "a.sqlite.lock", run_lock._take, []

    def taken(file: int) -> None:
        real(file)
        if not once:
            once.append(lock.unlink())  # as the program does that had it

    monkeypatch.setattr(run_lock, "_take", taken)
    with run_lock.RunLock(tmp_path / "a.sqlite"), pytest.raises(ExperimentError, match="another program"):
        run_lock.RunLock(tmp_path / "a.sqlite")
