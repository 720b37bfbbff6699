"""``sherkit doctor``: what is installed, what is missing for which purpose, and the one command that fixes it;
``completion``: the tab key.
"""

from __future__ import annotations

import os
import platform
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from pathlib import Path

import click
from click.shell_completion import get_completion_class
from rich.markup import escape

import sherkit._core as _core

from ..errors import SherkitError
from . import output
from .c_library import archive

#: What each extra is for; their packages stand in the metadata of what is installed.
_PURPOSE = {
    "view": "pictures, the report, the page",
    "vision": "cameras and pictures of a marker",
    "lab": "serial ports",
    "visa": "instruments at GPIB, USB and VXI (visa://)",
    "ophyd": "devices of ophyd and ophyd-async",
    "pymeasure": "instruments of PyMeasure",
    "ros": "bags of ROS",
}
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
_FIRST_OF = {"opencv-python-headless": "cv2", "pyserial": "serial"}


@dataclass(frozen=True)
class InstallationCheck:
    """One line: what was looked at, whether it is ok, what was found, and how to fix it."""

    what: str
    ok: bool
    found: str
    fix: str = ""
    needed: bool = False


def findings() -> Iterator[InstallationCheck]:
    """Everything that is looked at; nothing is opened, moved or fetched."""
    yield InstallationCheck("sherkit", True, f"{_core.__version__} in {Path(__file__).resolve().parents[1]}")
    yield InstallationCheck("Python", True, f"{platform.python_version()} ({platform.machine()}, {platform.system()})")
    for extra, packages in _extras().items():
        missing = [name for name in packages if _version(name) is None]
        found = ", ".join(f"{name} {_version(name)}" for name in packages if name not in missing)
        needed = extra == ""
        title = "core" if needed else f"extra {extra}"
        if not missing:
            yield InstallationCheck(title, True, found, needed=needed)
            continue
        fix = "pip install --force-reinstall sherkit" if needed else f'pip install "sherkit[{extra}]"'
        purpose = "" if needed else f", for {_PURPOSE[extra]}"
        yield InstallationCheck(title, False, f"missing: {', '.join(missing)}{purpose}", fix, needed)
    yield _sqlite()
    yield _browser()
    yield _ports()
    yield _c_library()


def _extras() -> dict[str, list[str]]:
    """Packages by extra, "" for those that sherkit cannot do without."""
    out: dict[str, list[str]] = {name: [] for name in ("", *_PURPOSE)}
    try:
        lines = requires("sherkit") or []
    except PackageNotFoundError:
        # a source tree that was not installed
        return {"": ["numpy", "scipy", "polars", "rich", "click", "tomli-w"]}
    for line in lines:
        needs, _, condition = line.partition(";")
        name = needs.strip().split(" ")[0].split("[")[0]
        for mark in "<>=!~(":
            name = name.partition(mark)[0]
        extra = condition.partition("extra ==")[2].strip().strip("'\"")
        if extra in out and name != "sherkit":
            out[extra].append(name)
    return {extra: names for extra, names in out.items() if names}


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        module = _FIRST_OF.get(package, package.replace("-", "_"))
        return "of unknown version" if find_spec(module) is not None else None


def _sqlite() -> InstallationCheck:
    if find_spec("_sqlite3") is not None:
        return InstallationCheck("SQLite", True, "runs of experiments, bags of ROS 2")
    said = "this Python was built without it: no experiment is run, and no bag of ROS 2 read"
    fix = "sudo apt-get install libsqlite3-dev, then build Python again" if sys.platform == "linux" else ""
    return InstallationCheck("SQLite", False, said, fix or "install Python from python.org")


def _browser() -> InstallationCheck:
    found = next((path for name in _BROWSERS if (path := shutil.which(name))), None)
    if found is not None:
        return InstallationCheck("browser", True, f"{found}: pictures as PNG and SVG")
    fix = {"linux": "sudo apt-get install chromium", "darwin": "brew install --cask chromium"}.get(sys.platform, "")
    said = "no Chromium: pictures are written as HTML, not as PNG and SVG"
    return InstallationCheck("browser", False, said, fix or "install Chromium or Chrome")


def _ports() -> InstallationCheck:
    if find_spec("serial") is None:
        return InstallationCheck(
            "serial ports", False, "cannot be listed without pyserial", 'pip install "sherkit[lab]"'
        )
    from serial.tools.list_ports import comports

    paths = sorted(port.device for port in comports())
    closed = [path for path in paths if not os.access(path, os.R_OK | os.W_OK)] if os.name == "posix" else []
    if closed:
        fix = "sudo usermod -aG dialout $USER, then log in again"
        return InstallationCheck("serial ports", False, f"{', '.join(closed)} cannot be opened by you", fix)
    return InstallationCheck("serial ports", True, ", ".join(paths) or "none is plugged in")


def _c_library() -> InstallationCheck:
    try:
        return InstallationCheck("C library", True, str(archive()))
    except SherkitError:
        return InstallationCheck(
            "C library", False, "not shipped with this installation", "pip install --force-reinstall sherkit"
        )


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def doctor(as_json: bool) -> int:
    """Say what is installed, what is missing and for what, and the one command that fixes it.

    Ends with code 1 only where something is missing that nothing works without.
    """
    root = click.get_current_context().find_root()
    if isinstance(root.command, click.Group):
        root.command.list_commands(root)  # warns of verbs of other packages that are not used
    found = list(findings())
    if as_json:
        output.print_json([vars(one) for one in found])
    else:
        made = output.table("What is installed", "", "", "what was found", "how to fix it")
        for one in found:
            mark = "ok" if one.ok else "MISSING" if one.needed else "missing"
            made.add_row(one.what, mark, escape(one.found), escape(one.fix))
        for column in made.columns[1:]:
            column.justify, column.overflow = "left", "fold"
        output.out.print(made)
    return int(any(one.needed and not one.ok for one in found))


# -- The tab key ------------------------------------------------------------------------------------------------------

_SHELLS = ("bash", "zsh", "fish")
_VARIABLE = "_SHERKIT_COMPLETE"


@click.command()
@click.argument("shell", type=click.Choice(_SHELLS), required=False)
def completion(shell: str | None) -> None:
    """Print what completes verbs, options and files with the tab key; by default for the SHELL that runs.

    \b
    eval "$(sherkit completion bash)"                                   # in ~/.bashrc
    eval "$(sherkit completion zsh)"                                    # in ~/.zshrc
    sherkit completion fish > ~/.config/fish/completions/sherkit.fish
    """
    name = shell or Path(os.environ.get("SHELL", "")).name
    made = get_completion_class(name) if name in _SHELLS else None
    if made is None:
        raise SherkitError(f"which shell runs cannot be told ('{name}'); expected sherkit completion bash, zsh or fish")
    root = click.get_current_context().find_root()
    print(made(root.command, {}, "sherkit", _VARIABLE).source())
