"""A user's effects from a Python file. Runs the file with the rights of whoever names it."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

from ..errors import EffectError
from .effect import Effect


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """The effects that a Python file defines with ``@sk.effect``, in the order of their definition.

    Raises :class:`~sherkit.errors.EffectError` where the file is not there, fails, or defines none.
    """
    path = Path(path)
    if not path.is_file():
        raise EffectError(f"{path}: there is no such file of effects")
    spec = importlib.util.spec_from_file_location(f"sherkit_effects_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise EffectError(f"{path}: is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise EffectError(f"{path}: {type(error).__name__}: {error}") from error
    found = tuple(v for v in vars(module).values() if isinstance(v, Effect) and v.function is not None)
    if not found:
        raise EffectError(f"{path}: defines no effect; expected a function under @sk.effect(...)")
    return found
