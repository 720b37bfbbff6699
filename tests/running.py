"""A command of sherkit in this process, in a folder of its own."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

from sherkit.cli import main


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
