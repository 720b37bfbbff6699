"""Every command, by a grammar of what can be typed: an answer or a sentence, an exit code, and no NaN in JSON."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import pytest

from hostile import HOSTILE
from mutations import HANGS_S, Hung, at_most, damaged_bytes, in_memory, watched
from sherkit.cli import main
from sherkit.cli.verbs import cli
from sherkit.robots.tool.tool import FlexibleTool
from sherkit.robots.tool.virtual import VirtualTool
from test_fuzz import formats

FAST = 60
SLOW = int(os.environ.get("SHERKIT_FUZZ", "100000"))
#: Of so many lines in one, the files are those that the command asks for, and whole, or one of them damaged: these are
#: worked on, which takes a thousand times longer than to refuse the others.
_WHOLE, _MEANT = 0.001, 0.02
_MEANT_BY = {
    "robot": ("delta.toml", "spherical.toml", "delta.toml", "tool.toml"),
    "run": ("run.csv", "semicolons.csv", "run.parquet"),
    "runs": ("run.csv", "semicolons.csv", "run.parquet"),
    "tool": ("tool.toml",),
    "bench": ("loads.csv",),
    "free": ("free.csv",),
    "experiment": ("lab/experiment.toml", "seen/experiment.toml"),
    "laboratory": ("lab/lab.toml", "seen/lab.toml"),
    "config": ("printer.cfg",),
    "what": ("run.sqlite", "study", "calibrated.toml"),
}
#: Of these commands it is another file.
_MEANT_OF = {
    "tool": {"run": ("free.csv",)},
    "estimate": {"run": ("motion.csv",)},
    "register": {"run": ("motion.csv",)},
    "plan": {"robot": ("lab/robot.toml",), "experiment": ("lab/experiment.toml",)},
}
#: Commands that go on until they are stopped, or move what is at a port; they are tried with what they refuse.
_ENDLESS = {
    "app": ["--port", "65536"], "lab": ["--time-scale", "0"], "measure": ["--ports", "nowhere.json"], "demo": ["-x"],
}  # fmt: skip
#: So long may honest work on small files take, s; what is damaged is said sooner.
_WORK_S = 60 * HANGS_S


def commands() -> dict[str, click.Command]:
    """Every command by its words."""
    out: dict[str, click.Command] = {}
    context = click.Context(cli)
    for name in cli.list_commands(context):
        one = cli.get_command(context, name)
        assert one is not None
        inner = getattr(one, "commands", None)
        out |= {f"{name} {k}": v for k, v in inner.items()} if inner else {name: one}
    return out


@dataclass
class Grammar:
    """Command lines over the files of a folder; what they say besides is random."""

    folder: Path
    whole: dict[Path, bytes]
    rng: random.Random

    @functools.cached_property
    def files(self) -> list[str]:
        """What a file's name may be."""
        there = [str(path.relative_to(self.folder)) for path in self.whole]
        return [*there, "nothing.csv", "damaged.toml", "damaged.csv", "study", "."]

    def line(self, name: str, command: click.Command) -> list[str]:
        """A command line: arguments and options of the command, with values that fit, nearly fit, or do not.

        Few fit in all; some in all but a damaged file, which is of the kind that is asked for.
        """
        rng, context = self.rng, click.Context(command, parent=click.Context(cli, **cli.context_settings))
        chance = rng.random()
        fits, line, damaged = chance < _MEANT, [], []
        for parameter in command.get_params(context):
            if isinstance(parameter, click.Argument):
                count = (
                    rng.choice((1, 1, 1, 2)) if parameter.nargs == -1 else 1 if fits else rng.choice((1,) * 9 + (0,))
                )
                for _ in range(count):
                    line += [self._file(name, parameter) if fits else rng.choice(self.files)]
                    damaged += [len(line) - 1]
            elif not parameter.is_eager and (rng.random() < (0.1 if fits else 0.25) or (fits and parameter.required)):
                option: Any = parameter
                line += [rng.choice(option.opts)]
                if not option.is_flag:
                    line += [value_of(option.type, self.files, rng)]
        if fits and damaged and chance > _WHOLE:
            line[at] = self._damaged(line[at := rng.choice(damaged)])
        if rng.random() < 0.05:
            line.insert(rng.randrange(len(line) + 1), rng.choice(("--nothing", "-q", "", *HOSTILE)).replace("\0", ""))
        return [*name.split(), *line, *_ENDLESS.get(name, [])]

    def _file(self, command: str, argument: click.Argument) -> str:
        if isinstance(argument.type, click.Choice):
            return self.rng.choice(argument.type.choices)
        meant = {**_MEANT_BY, **_MEANT_OF.get(command, {})}
        return self.rng.choice(meant.get(argument.name or "", ("run.csv",)))

    def _damaged(self, name: str) -> str:
        whole = self.whole.get(self.folder / name)
        if whole is None:
            return name
        path = Path(name).with_stem("damaged")
        (self.folder / path).write_bytes(damaged_bytes(whole, self.rng))
        return str(path)


def value_of(kind: click.ParamType, files: list[str], rng: random.Random) -> str:
    wild = ("-1", "0", "1", "3", "0.5", "1e308", "nan", "inf", "x", "", "10000000000000000000000", *HOSTILE)
    if rng.random() < 0.2:
        return rng.choice(wild).replace("\0", "")
    if isinstance(kind, click.Choice):
        return str(rng.choice(list(kind.choices)))
    if isinstance(kind, click.Path):
        return rng.choice((*files, "out.csv", "out.parquet", "out.toml", "out.html", "out.svg", "no/where.csv", "."))
    return str(rng.choice(("0", "1", "2", "0.5", "5", "rail_lean", "sensor_pose", "rod_length_1", "0.01", "9x6")))


def run(line: list[str]) -> tuple[int, str, str]:
    """Exit code and what was printed."""
    out, err = io.StringIO(), io.StringIO()
    code = 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(line)
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 1
    return code, out.getvalue(), err.getvalue()


@dataclass
class Answers:
    """What was answered to command lines: how often with which code, and what should not have been, each kind once."""

    codes: Counter[int] = field(default_factory=Counter)
    wrong: dict[str, str] = field(default_factory=dict)

    def of(self, line: list[str], damaged: Path) -> None:
        """Types one line."""
        told = f"{line}"
        if (name := str(damaged)) in line and damaged.is_file():
            told += f"\n    {name}: {damaged.read_bytes()[:2000]!r}"
        try:
            with at_most(_WORK_S):
                code, out, err = run(line)
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            self.wrong.setdefault(f"{type(error).__name__}: {str(error)[:80]}", told)
            return
        self.codes[code] += 1
        if code not in (0, 1, 2, 3) or "Traceback" in err + out or "panicked" in err:
            self.wrong.setdefault(f"code {code}: {err[-300:]}", told)
        if code in (1, 2) and not err.strip():
            self.wrong.setdefault(f"code {code} and no sentence", told)
        if "--json" in line and code == 0 and out.strip():
            constants: list[str] = []
            try:
                json.loads(out, parse_constant=constants.append)
            except ValueError:
                constants.append(f"{out[:40]!r}")
            if constants:
                self.wrong.setdefault(f"{constants[0]} for JSON", told)

    def over(self) -> None:
        """Fails with every kind of wrong answer, and a line for each."""
        told = [f"{kind}\n    {line}" for kind, line in self.wrong.items()]
        assert not told, "\n".join(told)


def campaign(names: Sequence[str], count: int, seed: str) -> Answers:
    """Types so many lines of these commands in a folder of whole and damaged files."""
    known, rng, answers = commands(), random.Random(seed), Answers()
    with in_memory() as folder, contextlib.chdir(folder), watched():
        whole = {one.path: one.path.read_bytes() for one in formats(folder).values()}
        # long enough to align the clocks of robot and camera by it
        VirtualTool(FlexibleTool()).free_motion(seconds=2.0, seed=1).save(folder / "motion.csv")
        whole |= {path: path.read_bytes() for path in (folder / "motion.csv", folder / "lab" / "robot.toml")}
        written = {path: os.stat(path).st_mtime_ns for path in whole}
        grammar = Grammar(folder, whole, rng)
        for k in range(count):
            if k % 10 == 0:
                for suffix in (".toml", ".csv"):
                    like = rng.choice([path for path in whole if path.suffix == suffix])
                    Path(f"damaged{suffix}").write_bytes(damaged_bytes(whole[like], rng))
            name = rng.choice(names)
            line = grammar.line(name, known[name])
            answers.of(line, next((Path(one) for one in line if one.startswith("damaged.")), Path("damaged")))
            for path, content in whole.items():
                # a line may name a whole file as its output
                if not path.exists() or os.stat(path).st_mtime_ns != written[path]:
                    path.write_bytes(content)
                    written[path] = os.stat(path).st_mtime_ns
    return answers


def test_every_command_answers_in_a_sentence() -> None:
    """Catches a traceback, an endless command, NaN in JSON, a refusal without a word."""
    answers = campaign(sorted(commands()), FAST, "commands")
    answers.over()
    assert set(answers.codes) >= {1, 2}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(commands()))
def test_many_command_lines(name: str) -> None:
    """Catches the same where it is rare."""
    seed = os.urandom(8).hex() if os.environ.get("SHERKIT_RANDOM") else f"many {name}"
    answers = campaign([name], SLOW, seed)
    print(f"{name}: seed {seed}: {dict(answers.codes)}", file=sys.__stdout__)
    answers.over()


def test_a_hang_would_be_seen() -> None:
    """Catches a watch that watches nothing."""
    with pytest.raises(Hung), at_most(0.05):
        time.sleep(60.0)


def test_ctrl_c_while_it_loads_is_a_sentence(tmp_path: Path) -> None:
    """Catches a traceback through half of the imports, where somebody typed the wrong thing and stops it at once."""
    script = tmp_path / "sherkit"
    script.write_text("from sherkit.cli import main\nmain()\n")
    for _ in range(5):
        process = subprocess.Popen([sys.executable, str(script), "effects"], stdout=subprocess.PIPE,
                                   stderr=subprocess.PIPE, text=True)  # fmt: skip
        maps = Path(f"/proc/{process.pid}/maps")
        # NumPy is loaded after the handler is set, and long before the last of the imports
        while process.poll() is None and "_multiarray_umath" not in maps.read_text():
            time.sleep(0.002)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=600)
        assert (process.returncode, err) == (130, "error: interrupted\n")
