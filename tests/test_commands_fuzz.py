"""Every command, by a grammar of what can be typed: an answer or a sentence, an exit code, and no NaN in JSON."""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import click
import pytest

from hostile import HOSTILE
from mutations import HANGS_S, Hung, at_most, damaged_bytes
from sherkit.cli.main import cli, main
from test_fuzz import formats

FAST = 60
SLOW = int(os.environ.get("SHERKIT_FUZZ", "100000")) // 20
#: Commands that go on until they are stopped, or move what is at a port; they are tried with what they refuse.
_ENDLESS = {
    "app": ["--port", "65536"],
    "lab": ["--time-scale", "0"],
    "measure": ["--ports", "nowhere.json"],
    "demo": ["-x"],
}
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


def typed(name: str, command: click.Command, files: list[str], rng: random.Random) -> list[str]:
    """A command line: arguments and options of the command, with values that fit, nearly fit, or do not."""
    line, context = [], click.Context(command, parent=click.Context(cli, **cli.context_settings))
    for parameter in command.get_params(context):
        if isinstance(parameter, click.Argument):
            count = rng.choice((1, 1, 1, 2)) if parameter.nargs == -1 else rng.choice((1,) * 9 + (0,))
            line += [rng.choice(files) for _ in range(count)]
        elif not parameter.is_eager and rng.random() < 0.25:
            option: Any = parameter
            line += [rng.choice(option.opts)]
            if not option.is_flag:
                line += [value_of(option.type, files, rng)]
    if rng.random() < 0.05:
        line.insert(rng.randrange(len(line) + 1), rng.choice(("--nothing", "-q", "", *HOSTILE)))
    return [*name.split(), *line, *_ENDLESS.get(name, [])]


def value_of(kind: click.ParamType, files: list[str], rng: random.Random) -> str:
    wild = ("-1", "0", "1", "3", "0.5", "1e308", "nan", "inf", "x", "", "10000000000000000000000", *HOSTILE)
    if rng.random() < 0.2:
        return rng.choice(wild).replace("\0", "")
    if isinstance(kind, click.Choice):
        return str(rng.choice(list(kind.choices)))
    if isinstance(kind, click.Path):
        return rng.choice((*files, "out.csv", "out.parquet", "out.toml", "out.html", "out.svg", "no/where.csv", "."))
    return str(rng.choice(("0", "1", "2", "0.5", "5", "rail_lean", "datum", "rod_length_1", "0.01", "9x6")))


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


def campaign(folder: Path, count: int, seed: str) -> dict[str, int]:
    """Types so many lines in a folder of whole and damaged files; fails at the first kinds of wrong answers."""
    rng, wrong, codes = random.Random(seed), {}, {}
    known = commands()
    whole = {one.path: one.path.read_bytes() for one in formats(folder).values()}
    files = [str(p.relative_to(folder)) for p in whole] + ["nothing.csv", "damaged.toml", "damaged.csv", "study", "."]
    here = Path.cwd()
    os.chdir(folder)
    try:
        for _ in range(count):
            for name in ("damaged.toml", "damaged.csv"):
                like = [p for p in whole if p.suffix == Path(name).suffix]
                Path(name).write_bytes(damaged_bytes(whole[rng.choice(like)], rng))
            name = rng.choice(list(known))
            line = typed(name, known[name], files, rng)
            try:
                with at_most(_WORK_S):
                    code, out, err = run(line)
            except BaseException as error:
                if isinstance(error, KeyboardInterrupt):
                    raise
                wrong.setdefault(f"{type(error).__name__}: {str(error)[:80]}", line)
                continue
            codes[code] = codes.get(code, 0) + 1
            if code not in (0, 1, 2, 3) or "Traceback" in err + out or "panicked" in err:
                wrong.setdefault(f"code {code}: {err[-200:]}", line)
            if code in (1, 2) and not err.strip():
                wrong.setdefault(f"code {code} and no sentence", line)
            if "--json" in line and code == 0 and out.strip():
                constants: list[str] = []
                try:
                    json.loads(out, parse_constant=constants.append)
                except ValueError:
                    constants.append(f"{out[:40]!r}")
                if constants:
                    wrong.setdefault(f"{constants[0]} for JSON", line)
            for path, content in whole.items():
                if not path.exists() or path.read_bytes() != content:
                    path.write_bytes(content)  # a line may name a whole file as its output
    finally:
        os.chdir(here)
    told = [f"{kind}\n    {line}" for kind, line in wrong.items()]
    assert not told, "\n".join(told)
    return codes


def test_every_command_answers_in_a_sentence(tmp_path: Path) -> None:
    """Catches a traceback, an endless command, NaN in JSON, a refusal without a word."""
    codes = campaign(tmp_path, FAST, "commands")
    assert set(codes) >= {1, 2}


@pytest.mark.slow
def test_many_command_lines(tmp_path: Path) -> None:
    """Catches the same where it is rare."""
    seed = os.urandom(8).hex() if os.environ.get("SHERKIT_RANDOM") else "many commands"
    print(f"seed {seed}: {campaign(tmp_path, SLOW, seed)}", file=sys.__stdout__)


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
