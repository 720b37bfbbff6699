"""Reads a run that is still being written, and files that are known to people under another name."""

from __future__ import annotations

import tempfile
import warnings
from dataclasses import replace
from pathlib import Path

from ..data import Measurements, read_measurements
from ..data.files import write_whole
from ..data.headers import Columns
from ..data.tables import PARQUET
from ..errors import SherkitError


def read_as(path: Path, name: str, columns: Columns | None = None) -> Measurements:
    """Reads a file under another name: that is what errors and warnings are about."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            data = read_measurements(path, columns=columns)
        except SherkitError as error:
            raise type(error)(str(error).replace(str(path), name)) from None
    for one in said:
        warnings.warn(str(one.message).replace(str(path), name), one.category, stacklevel=2)
    return replace(data, source=name)


def read_so_far(run: Path, columns: Columns | None = None) -> Measurements:
    """The rows of a run that is being written: a last line that has no end may be half of one, or half a number."""
    if run.suffix.lower() in PARQUET or not run.is_file():
        return read_measurements(run, columns=columns)
    content = run.read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / run.name
        write_whole(whole, whole_lines(content))
        return read_as(whole, str(run), columns)


def whole_lines(content: bytes) -> bytes:
    return content[: content.rfind(b"\n") + 1]
