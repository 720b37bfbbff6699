"""What a package shows, loaded when it is first asked for (PEP 562).

A package that is slow to load says twice what it shows: to who reads types, by imports under ``TYPE_CHECKING``; and to
Python by a :func:`door`, which a test compares with them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def door(package: str, values: Mapping[str, str], modules: Mapping[str, str] | None = None) -> Callable[[str], Any]:
    """A ``__getattr__`` for ``package``: values by the module below it that has them, and modules by theirs."""
    modules = modules or {}

    def __getattr__(name: str) -> Any:  # noqa: N807
        if name in modules:
            found: Any = import_module(f"{package}.{modules[name]}")
        elif name in values:
            found = getattr(import_module(f"{package}.{values[name]}"), name)
        else:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        setattr(sys.modules[package], name, found)
        return found

    return __getattr__
