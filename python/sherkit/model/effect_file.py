"""A user's effects from a Python file. Runs the file with the rights of whoever names it."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

from ..errors import EffectError
from .effect import Effect
from .python_file import run_python


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """The effects that a Python file defines with ``@sk.effect``, in the order of their definition.

    Raises :class:`~sherkit.errors.EffectError` where the file is not there, fails, or defines none.
    """

    def take(module: ModuleType) -> tuple[Effect, ...]:
        found = tuple(v for v in vars(module).values() if isinstance(v, Effect) and v.function is not None)
        if not found:
            raise EffectError(f"{path}: defines no effect; expected a function under @sk.effect(...)")
        return found

    return run_python(path, "effects", take, EffectError)
