"""What a verb reads and what it writes: the types of its options, through which nothing of a person's is overwritten.

Every path of a verb is an :class:`InputFile`, an :class:`OutputFile` or an :class:`OutputFolder`. They know of each
other while a command line is read, so that an output that is an input is refused before anything is done. A path that a
verb makes by itself (the run file that an experiment names) goes through :meth:`OutputFile.checked`.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import click

from ..data.files import bag_in, refuse_device
from ..errors import SherkitError
from .file_kinds import RUN, FileContent, FileKind, called, run_file_of

_KEY = "sherkit.paths"


@dataclass
class _Paths:
    """What a command reads, and what it writes with the option that says so."""

    read: list[Path] = field(default_factory=list)
    written: list[tuple[str, Path]] = field(default_factory=list)

    def reads(self, path: Path) -> None:
        self.read.append(path)
        for option, output in self.written:
            _refuse_read(option, output, path)

    def writes(self, option: str, path: Path) -> None:
        for one in self.read:
            _refuse_read(option, path, one)
        for other, output in self.written:
            if _same(output, path) and not _is_stream(path):
                raise SherkitError(f"{path}: is what {other} writes, too; give {option} another name")
        self.written.append((option, path))


def _of(ctx: click.Context | None) -> _Paths:
    """Those of the command that is being read."""
    held: _Paths = _Paths() if ctx is None else ctx.meta.setdefault(_KEY, _Paths())
    return held


def _refuse_read(option: str, output: Path, given: Path) -> None:
    matching = "*" in output.name and os.path.isdir(output.parent)
    for one in output.parent.glob(output.name) if matching else (output,):
        if _same(one, given):
            what = "is" if str(one) == str(given) else f"is the same file as {given}, which is"
            raise SherkitError(f"{one}: {what} read by this command and would be lost; give {option} another name")


def _same(one: Path, other: Path) -> bool:
    """Whether two paths lead to one file: by another spelling, a link, or what is not there yet."""
    try:
        return one.samefile(other)
    except (OSError, ValueError):
        return os.path.normcase(os.path.realpath(one)) == os.path.normcase(os.path.realpath(other))


def _is_stream(path: Path) -> bool:
    """Whether a path is that of a pipe or a device, as the standard output: nothing stands there to be lost."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode) or stat.S_ISBLK(mode))


def _name(param: click.Parameter | None) -> str:
    """An option as it is typed."""
    return max(param.opts, key=len) if isinstance(param, click.Option) else "the output"


class InputFile(click.Path):
    """A path that is read. A device or a pipe is refused: it may never end, and cannot be read twice. So is a folder,
    but where ``folders`` are read.

    ``words`` is a pattern of what is no path where it may stand in the place of one, as the number of a camera.
    """

    def __init__(self, words: str = "", *, folders: bool = False) -> None:
        super().__init__(path_type=Path)
        self._words = words
        self.folders = folders

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path; a word as it is."""
        if self._words and re.fullmatch(self._words, str(value)):
            return str(value)
        path = cast(Path, super().convert(value, param, ctx))
        refuse_device(path, SherkitError, pipes=True)
        if os.path.isdir(path) and not self.folders:
            raise SherkitError(f"{path}: is a folder, expected a file{bag_in(path)}")
        _of(ctx).reads(path)
        return path


class OutputFile(click.Path):
    """A path that is written, with a file of one of these kinds."""

    def __init__(self, *kinds: FileKind) -> None:
        super().__init__(path_type=Path)
        self.kinds = kinds

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path, which may be written."""
        path = cast(Path, super().convert(value, param, ctx))
        return self.checked(path, _name(param), ctx)

    def checked(self, path: Path, option: str, ctx: click.Context | None = None) -> Path:
        """The path. Raises :class:`~sherkit.errors.SherkitError` where it is an input of this command, a run file, or a
        file of another kind than what is written."""
        ctx = ctx or click.get_current_context(silent=True)
        if "\0" not in str(path):  # a name that no file has: who writes says so
            _of(ctx).writes(option, path)
            require_kind(path, option, self.kinds)
        return path


def require_kind(path: Path, option: str, kinds: Sequence[FileKind]) -> None:
    """Refuses what must not be replaced by a file of one of these kinds. Raises :class:`~sherkit.errors.SherkitError`.

    A verb that knows only when it has read its inputs which of its kinds it writes asks again for that one.
    """
    if _is_stream(path):
        return
    if os.path.isdir(path):
        raise SherkitError(f"{path}: is a folder; {option} names a file")
    refuse_device(path, SherkitError)
    made = " or ".join(dict.fromkeys(kind.called for kind in kinds))
    if RUN not in kinds and (run := run_file_of(path)) is not None:
        what = "is" if run.name == os.path.basename(os.path.realpath(path)) else f"belongs to {run.name}, which is"
        raise SherkitError(f"{path}: {what} the run file of an experiment; give {option} another name")
    if all(kind.only for kind in kinds) and not any(path.suffix.lower() in kind.endings for kind in kinds):
        endings = [ending for kind in kinds for ending in kind.endings]
        wanted = " or ".join(([", ".join(endings[:-1])] if endings[1:] else []) + endings[-1:])
        raise SherkitError(f"{path}: expected a name that ends in {wanted}; {option} writes {made}")
    look = FileContent(path)
    if os.path.isfile(path) and not any(kind.replaces(look) for kind in kinds):
        raise SherkitError(f"{path}: is {called(look)} and would be replaced by {made}; give {option} another name")


class OutputFolder(click.Path):
    """A folder into which files of these names are written; a name may be a pattern, of files that no other has."""

    def __init__(self, files: Mapping[str, FileKind]) -> None:
        super().__init__(path_type=Path)
        self.files = files

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The folder, into which these files may be written."""
        return self.checked(cast(Path, super().convert(value, param, ctx)), _name(param), ctx)

    def checked(self, folder: Path, option: str, ctx: click.Context | None = None) -> Path:
        """The folder. Raises :class:`~sherkit.errors.SherkitError` where one of its files must not be replaced."""
        if os.path.exists(folder) and not os.path.isdir(folder):
            raise SherkitError(f"{folder}: is a file; {option} names a folder")
        for name, kind in self.files.items():
            if "*" in name:
                _of(ctx or click.get_current_context(silent=True)).writes(option, folder / name)
            else:
                OutputFile(kind).checked(folder / name, option, ctx)
        return folder
