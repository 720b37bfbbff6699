"""Trials of Parquet files as ``sherkit.data.tables`` makes them, each in a process of its own: forked from one that has
polars loaded already, since to load it takes a hundred times longer than to read the file."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from sherkit.data import tables

_SERVER = """
import os, resource, signal, sys
import polars
for line in sys.stdin:
    child = os.fork()
    if not child:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
        signal.alarm(5)
        try:
            polars.read_parquet(line.rstrip(chr(10)))
        except BaseException:
            os._exit(1)
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@contextmanager
def forked(patch: pytest.MonkeyPatch) -> Iterator[None]:
    """Trials are forked while this lasts, where there is such a thing. One that takes longer than five seconds fails
    the test."""
    if not hasattr(os, "fork"):
        yield
        return
    command = [sys.executable, "-c", _SERVER]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdin
        assert server.stdout
        asked, said = server.stdin, server.stdout

        def tried(path: Path) -> str | None:
            asked.write(f"{path}\n")
            asked.flush()
            code = int(said.readline())
            assert code != -14, "to read it takes more than 5 s"
            return "it is damaged" if code else None

        with patch.context() as patched:
            patched.setattr(tables, "_tried", tried)
            yield
        asked.close()
