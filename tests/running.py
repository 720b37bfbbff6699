"""Commands of sherkit: in this process, or several in one process that is not as this one."""

from __future__ import annotations

import contextlib
import io
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import polars as pl
import pytest

from sherkit.cli import main
from sherkit.cli.verbs import cli


def slow(*cases: Any) -> list[Any]:
    """Cases of a parametrization that wait for ``-m slow``, since another asks quickly; a tuple is one of several
    names."""
    return [pytest.param(*(one if isinstance(one, tuple) else (one,)), marks=pytest.mark.slow) for one in cases]


def command(folder: Path, *arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of the command, run in ``folder``."""
    out, err = io.StringIO(), io.StringIO()
    code: Any = 0
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(list(arguments))
        except SystemExit as done:
            code = done.code
    return int(code or 0), out.getvalue(), err.getvalue()


def parse(arguments: list[str]) -> None:
    """Reads the words of a command after ``sherkit`` without running it. Raises ClickException where a verb or an
    option is gone."""
    # a verb remembers how its help is asked for by the first that asks
    top = click.Context(cli, info_name="sherkit", **cli.context_settings)
    (verb, *words), context = arguments, top
    made = cli.get_command(top, verb)
    if isinstance(made, click.Group) and words[:1] != ["--help"]:
        context = click.Context(made, info_name=verb, parent=top)
        words = made.worded(words) if verb == "export" else words
        made, words = made.get_command(context, words[0]), words[1:]
    if made is None:
        raise click.UsageError(f"no such command: {' '.join(arguments)}")
    with contextlib.suppress(click.exceptions.Exit), contextlib.redirect_stdout(io.StringIO()):  # --help ends there
        made.make_context(verb, words, parent=context)


_SEVERAL = """
import contextlib, io, json, sys
from sherkit.cli import main
for words in json.loads(sys.argv[1]):
    out, err, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try: main(words)
        except SystemExit as end: code = end.code or 0
    print(json.dumps([code, out.getvalue(), err.getvalue()]))
"""


def several(folder: Path, *lines: str, before: str = "", **environment: str) -> list[tuple[int, str, str]]:
    """Exit code, stdout and stderr of each of the commands, run in ``folder`` one after the other in one process, since
    to start one takes longer than most commands do. It first runs the Python that stands ``before``."""
    done = subprocess.run(
        [sys.executable, "-c", before + _SEVERAL, json.dumps([shlex.split(line) for line in lines])],
        cwd=folder, capture_output=True, encoding="utf-8", env=os.environ | environment, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return [(code, out, err) for code, out, err in map(json.loads, done.stdout.splitlines())]


@contextlib.contextmanager
def cluster_of_two() -> Iterator[tuple[Any, Any]]:
    """A client of a cluster of two processes on this machine, and its executor."""
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
        ) as cluster,
        distributed.Client(cluster) as client,
        client.get_executor() as executor,
    ):
        yield client, executor


def thin(run: Path, every: int = 6) -> None:
    """Leaves one of so many poses of a run."""
    pl.read_csv(run).filter(pl.col("pose") % every == 0).write_csv(run)
