"""A person's own Python file: run once, and found again by copies and other processes. Whoever names it has it run."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, TypeVar

from ..errors import SherkitError

T = TypeVar("T")


def run_python(path: str | os.PathLike[str], of: str, take: Callable[[ModuleType], T], error: type[SherkitError]) -> T:
    """What ``take`` finds in the module that a file of ``of`` makes.

    The module has a name of its own, made of its path: a ``json.py`` hides no other. Where anything fails the module
    that this path made before stays known. Raises ``error`` where the file is not there or fails.
    """
    path = Path(path)
    if not path.is_file():
        raise error(f"{path}: there is no such file of {of}")
    name = f"sherkit_file_{path.stem}_{zlib.crc32(str(path.resolve()).encode()):08x}"
    before = sys.modules.get(name)
    try:
        return take(_module(name, path))
    except (Exception, SystemExit) as wrong:
        sys.modules.pop(name, None)
        if before is not None:
            sys.modules[name] = before
        if isinstance(wrong, SherkitError):
            raise
        raise error(f"{path}: {type(wrong).__name__}: {wrong}") from wrong


def _module(name: str, path: str | Path) -> ModuleType:
    """The module of this name, run from its file. Raises :class:`ImportError` for what is no Python file."""
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is not a Python file")
    made = importlib.util.module_from_spec(spec)
    sys.modules[name] = made  # what it defines is found by its name while it runs
    spec.loader.exec_module(made)
    return made


@dataclass(frozen=True)
class NamedObject:
    """Something at the top of a module, in whatever process: its module's file is run where it cannot be imported."""

    module: str
    file: str | None
    name: str

    def found(self) -> Any:
        """It. Raises :class:`ImportError` and :class:`AttributeError` where it is no longer there."""
        there = sys.modules.get(self.module)
        if there is None:
            try:
                there = importlib.import_module(self.module)
            except ImportError:
                if self.file is None:
                    raise
                there = _module(self.module, self.file)
        return getattr(there, self.name)


def named(module: str, name: str) -> NamedObject | None:
    """What stands under a name at the top of a loaded module; None where nothing does."""
    there = sys.modules.get(module)
    if not hasattr(there, name):
        return None
    return NamedObject(module, getattr(there, "__file__", None), name)


def portable(value: Any) -> Any:
    """A function by its name in its module, where it is that; anything else as it is."""
    if not isinstance(value, FunctionType):
        return value
    found = named(value.__module__, value.__qualname__)
    return found if found is not None and found.found() is value else value


def carried(value: Any) -> Any:
    """What :func:`portable` was given."""
    return value.found() if isinstance(value, NamedObject) else value
