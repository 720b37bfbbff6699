"""Tables as files: the kind of a file is the ending of its name."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import polars as pl

from ..errors import MeasurementError
from .files import write_whole
from .head import head_of

PARQUET = (".parquet", ".pq")
#: The first and the last bytes of every Parquet file.
_MAGIC = b"PAR1"
#: Larger files are not read twice; their damage is said where it does not end the program.
_TRIED_BYTES = 100 * 2**20
#: What a trial may take: a damaged file can name any size.
_TRIAL_S = 120.0
_TRIAL = """
import sys
sys.path[:] = {path}
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
except (ImportError, ValueError, OSError):
    pass
import polars
try:
    polars.read_parquet({file})
except BaseException as error:
    print((str(error).splitlines() or [type(error).__name__])[0])
    sys.exit(1)
"""


def read_table(path: Path) -> pl.DataFrame:
    """Reads Parquet where the name says so, else text with notes after ``#``, its cells parted as :mod:`.head` finds
    them. Raises polars' own errors for text."""
    if path.suffix.lower() in PARQUET:
        return read_parquet(path)
    if not path.is_file():
        return pl.read_csv(path, comment_prefix="#", infer_schema_length=None)  # a pipe cannot be read twice
    with suppress(UnicodeDecodeError), path.open(encoding="utf-8-sig", newline="") as file:
        head = head_of(str(path), enumerate(file, start=1))
        if head is not None and (head.called or head.separator != ","):
            first = "" if head.called else head.names.rstrip("\r\n") + "\n"
            text = io.StringIO(first + "".join(line for _, line in head.lines))
            names = list(head.called) or None
            return pl.read_csv(
                text, separator=head.separator, has_header=not names, new_columns=names, comment_prefix="#",
                infer_schema_length=None,
            )  # fmt: skip
    return pl.read_csv(path, comment_prefix="#", infer_schema_length=None)


def read_parquet(path: Path) -> pl.DataFrame:
    """A Parquet file as it is. Raises :class:`~sherkit.errors.MeasurementError` where it is none, or damaged."""
    try_parquet(path)
    with parquet_errors(path):
        return pl.read_parquet(path)


def try_parquet(path: Path) -> None:
    """Reads a file in a process of its own: polars panics at some damaged files, and some end the whole program.

    Raises :class:`~sherkit.errors.MeasurementError`.
    """
    with path.open("rb") as file:
        head = file.read(4)
        file.seek(max(0, path.stat().st_size - 4))
        if head != _MAGIC or file.read(4) != _MAGIC:
            raise not_parquet(path, "it does not begin and end as one")
    if sys.executable and path.stat().st_size <= _TRIED_BYTES and (why := _tried(path)) is not None:
        raise not_parquet(path, why)


def _tried(path: Path) -> str | None:
    """What is wrong with a Parquet file, as a process of its own finds it; None where it can be read."""
    source = _TRIAL.format(path=ascii([p for p in sys.path if p]), file=ascii(str(path.resolve())))
    try:
        done = subprocess.run(
            [sys.executable, "-I", "-X", "utf8", "-c", source], capture_output=True, encoding="utf-8", errors="replace",
            timeout=_TRIAL_S, check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"reading it takes more than {_TRIAL_S:g} s"
    return done.stdout.strip() or "it is damaged" if done.returncode else None


@contextmanager
def parquet_errors(path: Path) -> Iterator[None]:
    """Whatever polars says of a Parquet file as a sentence."""
    try:
        yield
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        raise not_parquet(path, str(error)) from None


def not_parquet(path: Path, why: str) -> MeasurementError:
    """What to say of a file that is called Parquet and is none."""
    return MeasurementError(f"{path}: is not a Parquet file: {why.splitlines()[0] if why else 'it is damaged'}")


def write_table(frame: pl.DataFrame, path: str | Path) -> None:
    """Writes Parquet where the name says so, else CSV. Raises :class:`~sherkit.errors.NotWritten`."""
    held = io.BytesIO()
    if Path(path).suffix.lower() in PARQUET:
        frame.write_parquet(held)
    else:
        frame.write_csv(held)
    write_whole(path, held.getvalue())
