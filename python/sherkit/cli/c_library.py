"""``sherkit c``: where the C library stands that the wheel ships, for compilers, CMake and pkg-config."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import click

from ..data.files import write_whole
from ..errors import SherkitError
from . import output
from .paths import OutputFolder

HOME = Path(__file__).resolve().parents[1] / "c"


def archive() -> Path:
    """The static library. Raises :class:`~sherkit.errors.SherkitError` where this installation has none."""
    found = HOME / "lib" / ("sherkit.lib" if sys.platform == "win32" else "libsherkit.a")
    if not found.is_file():
        raise SherkitError(
            f"{HOME}: this installation has no C library (a source tree has none, a wheel does); "
            "in the source tree: cargo build --profile control -p sherkit-c"
        )
    return found


@click.command("c")
@click.option("--cflags", is_flag=True, help="What the compiler needs.")
@click.option("--libs", is_flag=True, help="What the linker needs; the library goes into the program itself.")
@click.option("--shared", is_flag=True, help="With --libs: the shared library, found at run time where it stands.")
@click.option("--cmake", is_flag=True, help="The folder for -Dsherkit_DIR=.")
@click.option("--pkgconfig", is_flag=True, help="The folder for PKG_CONFIG_PATH.")
@click.option("--example", type=OutputFolder({}), metavar="FOLDER", help="Write a 1 kHz loop there.")
def c_library(cflags: bool, libs: bool, shared: bool, cmake: bool, pkgconfig: bool, example: Path | None) -> None:
    """Say where header and library for C and C++ are.

    \b
    sherkit export c calibrated.toml -o robot.h
    cc -O2 loop.c $(sherkit c --cflags --libs) -o loop
    cmake -S . -B build -Dsherkit_DIR="$(sherkit c --cmake)"
    """
    static = archive()
    if example is not None:
        files = {file.name: file.read_bytes() for file in sorted((HOME / "example").iterdir())}
        for name, content in files.items():
            if (example / name).exists() and (example / name).read_bytes() != content:
                raise SherkitError(f"{example / name}: is another file; give --example a folder of its own")
        example.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            write_whole(example / name, content)
        output.say(f"{example}: a 1 kHz loop; it reads robot.h, from sherkit export c calibrated.toml -o robot.h")
        return
    words: list[str] = []
    if cflags:
        words.append(f"-I{HOME / 'include'}")
    if libs:
        folder = static.parent
        # the system's own mathematics first: the static library has some of the same names
        words += [] if sys.platform == "win32" else ["-lm"]
        words += [f"-L{folder}", "-lsherkit", f"-Wl,-rpath,{folder}"] if shared else [str(static)]
    if words:
        print(shlex.join(words))
    if cmake:
        print(static.parent / "cmake" / "sherkit")
    if pkgconfig:
        print(static.parent / "pkgconfig")
    if not (words or cmake or pkgconfig):
        output.say(
            f"header:  {HOME / 'include' / 'sherkit.h'}\nlibrary: {static}\nsherkit c --help says how to use them"
        )
