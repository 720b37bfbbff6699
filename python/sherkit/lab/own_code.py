"""The user's Python that makes instruments: files that a person named on the command line, and installed packages.

No experiment names a file that would be run: it names what is to be found in those that a person has given
(``sherkit measure experiment.toml --python my_lab.py``), or in an installed package that offers it under the entry
point group ``sherkit.instruments``.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from ..base.names import listed, nearest
from ..errors import ExperimentError

GROUP = "sherkit.instruments"


@dataclass(frozen=True)
class OwnCode:
    """What can be made, by name: of the files that were run, and then of installed packages."""

    makers: Mapping[str, Callable[..., Any]] = field(default_factory=dict)
    files: tuple[str, ...] = ()

    def maker(self, name: str, where: str) -> tuple[Callable[..., Any], str]:
        """What makes ``name``, and the words that say where it stands.

        Raises :class:`~sherkit.errors.ExperimentError` where nobody offers it; ``where`` names the file that asks.
        """
        if name in self.makers:
            made = self.makers[name]
            return made, f"{Path(sys.modules[made.__module__].__file__ or '').name}:{name}"
        offered = {one.name: one for one in entry_points(group=GROUP)}
        if name in offered:
            try:
                return offered[name].load(), f"{offered[name].value} (installed)"
            except Exception as error:
                raise ExperimentError(
                    f"{where}: '{name}' ({offered[name].value}) cannot be loaded: {type(error).__name__}: {error}"
                ) from error
        known = [*self.makers, *offered]
        hint = nearest(name, known) or (f"; known are {listed(known, 12)}" if known else "")
        nobody = f"{listed(self.files)} did not define it" if self.files else "no Python file was named"
        raise ExperimentError(
            f"{where}: '{name}' is made by Python code, and {nobody}{hint}. No file of data runs code: "
            "name the Python file on the command line, --python my_lab.py"
        )


def run_code(paths: Sequence[str | Path]) -> OwnCode:
    """Runs Python files, with the rights of whoever names them; what can be made are their functions and classes.

    Raises :class:`~sherkit.errors.ExperimentError` where a file is not there, fails, or defines none.
    """
    makers: dict[str, Callable[..., Any]] = {}
    for path in map(Path, paths):
        found = {k: v for k, v in _run(path).items() if not k.startswith("_") and callable(v)}
        own = {k: v for k, v in found.items() if getattr(v, "__module__", None) == _module(path)}
        if not own:
            raise ExperimentError(f"{path}: defines no function and no class that could make an instrument")
        twice = sorted(own.keys() & makers.keys())
        if twice:
            raise ExperimentError(f"{path}: '{twice[0]}' was defined by another file, too")
        makers |= own
    return OwnCode(makers, tuple(Path(path).name for path in paths))


def _module(path: Path) -> str:
    return f"sherkit_lab_{path.stem}"


def _run(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise ExperimentError(f"{path}: there is no such Python file")
    spec = importlib.util.spec_from_file_location(_module(path), path)
    if spec is None or spec.loader is None:
        raise ExperimentError(f"{path}: is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise ExperimentError(f"{path}: {type(error).__name__}: {error}") from error
    return vars(module)
