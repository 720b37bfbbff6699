"""Whatever sherkit writes is whole or not there: power cuts, full disks, pipes."""

from __future__ import annotations

import ast
import copy
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import sherkit as sk
from sherkit.cli.demo import EXAMPLE
from sherkit.data.files import write_whole
from sherkit.errors import NotWritten
from sherkit.robots.delta.robot import grid
from sherkit.robots.delta.virtual import VirtualDelta
from sources import nodes

PACKAGE = Path(sk.__file__).parent
#: Methods and functions that write a file by themselves.
WRITERS = {"write_text", "write_bytes", "write_csv", "write_parquet", "imwrite", "savez", "savetxt", "tofile"}


class PowerCut(BaseException):
    """The machine stops here: no handler runs on."""


@pytest.fixture
def study() -> sk.Study:
    virtual = VirtualDelta.draw(EXAMPLE, 6, noise_mm=0.005)
    return sk.Study(EXAMPLE, virtual.measure(grid(20.0, 4, (-15.0, 0.0, 15.0)), repeats=2, seed=1))


def cut_at(monkeypatch: pytest.MonkeyPatch, number: int) -> list[str]:
    """Cuts the power at the ``number``-th thing that is done to the disk; the list tells what was done before."""
    done: list[str] = []

    def cutting(name: str, real: Any) -> Any:
        def call(*args: Any, **options: Any) -> Any:
            if len(done) == number:
                raise PowerCut(name)
            done.append(name)
            return real(*args, **options)

        return call

    for place, name in ((os, "fsync"), (Path, "replace"), (Path, "chmod"), (Path, "open")):
        monkeypatch.setattr(place, name, cutting(name, getattr(place, name)))
    # after a power cut nobody tidies up
    monkeypatch.setattr(Path, "unlink", cutting("unlink", Path.unlink))
    return done


def test_a_power_cut_leaves_the_old_study_or_the_new_one(study: sk.Study, tmp_path: Path) -> None:
    """Catches rows and steps that do not belong together: two files renamed one after the other."""
    marked = copy.copy(study)
    marked.history = list(study.history)
    marked._undone = []
    marked.mark_outliers([3])
    before, after, left = repr(study), repr(marked), set()
    for number in range(40):
        study.save(tmp_path)
        with pytest.MonkeyPatch.context() as monkeypatch:
            done = cut_at(monkeypatch, number)
            try:
                marked.save(tmp_path)
                cut = False
            except PowerCut:
                cut = True
        kept = sk.Study.load(tmp_path)
        assert repr(kept) in (before, after), done
        assert kept.data.outlier.any() == (repr(kept) == after)
        left.add(repr(kept))
        if not cut:
            break
    assert not cut
    assert left == {before, after}
    assert len(list(tmp_path.glob("rows-*.parquet"))) == 1


def test_a_file_is_on_the_disk_before_it_has_its_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Catches a rename before fsync: an empty file under the right name after a power cut; and a folder not synced."""
    done = cut_at(monkeypatch, -1)
    write_whole(tmp_path / "a.txt", "content")
    assert done == ["open", "fsync", "replace", "fsync"]


def test_what_stood_there_stays_where_nothing_can_be_written(tmp_path: Path) -> None:
    """Catches a full disk that leaves half a file, or a traceback, or the name of a file that nobody gave."""
    names = ("run.csv", "run.parquet")
    for name in names:
        (tmp_path / name).write_text("old")
    source = (
        "import resource, numpy as np, polars as pl\n"
        "from sherkit.data.tables import write_table\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        f"for name in {names}:\n"
        "    try: write_table(pl.DataFrame({'a': np.random.rand(5000)}), name)\n"
        "    except OSError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, timeout=600, cwd=tmp_path)
    said = [f"{n}: cannot be written: File too large; the file that stands there is as it was" for n in names]
    assert (done.stdout.splitlines(), done.stderr) == (said, "")
    assert {(tmp_path / name).read_text() for name in names} == {"old"}
    assert sorted(p.name for p in tmp_path.iterdir()) == list(names)
    with pytest.raises(NotWritten, match=r"no/x\.csv: cannot be written: No such file"):
        write_whole(tmp_path / "no" / "x.csv", "")
    with pytest.raises(NotWritten, match="/dev/full: cannot be written: No space left on device"):
        write_whole("/dev/full", "content")


def test_links_and_rights_stay(tmp_path: Path) -> None:
    """Catches a link replaced by a file, or a private file that everybody may read after it was written anew."""
    real, link = tmp_path / "real.csv", tmp_path / "link.csv"
    real.write_text("old")
    real.chmod(0o600)
    link.symlink_to(real)
    write_whole(link, "new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    assert real.stat().st_mode & 0o777 == 0o600
    umask = os.umask(0)
    os.umask(umask)
    write_whole(tmp_path / "fresh.csv", "new")
    assert (tmp_path / "fresh.csv").stat().st_mode & 0o777 == 0o666 & ~umask


@pytest.mark.parametrize("to_file", [False, True])
def test_the_standard_output_can_be_written_to(to_file: bool, tmp_path: Path) -> None:
    """Catches ``-o /dev/stdout`` that replaces the device's name, writes over what was printed, or adds a sentence."""
    source = (
        "from sherkit.data.files import write_whole\nfrom sherkit.cli import output\nprint('before')\n"
        "write_whole('/dev/stdout', 'a,b\\n')\noutput.say('written', '/dev/stdout')\nprint('after')"
    )
    if to_file:
        with (tmp_path / "out.csv").open("wb") as file:
            done = subprocess.run([sys.executable, "-c", source], stdout=file, stderr=subprocess.PIPE, timeout=600)
        printed = (tmp_path / "out.csv").read_bytes()
    else:
        done = subprocess.run([sys.executable, "-c", source], capture_output=True, timeout=600)
        printed = done.stdout
    assert (done.returncode, printed, done.stderr) == (0, b"before\na,b\nafter\n", b"written\n")


def test_every_file_is_written_in_one_place() -> None:
    """Catches a writer of its own: half a file after a crash, which no test of another one would see."""
    wrong = []
    for file in sorted(PACKAGE.rglob("*.py")):
        if file == PACKAGE / "data" / "files.py":
            continue
        for node in nodes(file):
            if not isinstance(node, ast.Call):
                continue
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            given = [a.value for a in (*node.args, *(k.value for k in node.keywords)) if isinstance(a, ast.Constant)]
            opened = name == "open" and any(isinstance(v, str) and set("wx+") & set(v) and len(v) < 4 for v in given)
            # tables are made in memory, then written
            in_memory = name in ("write_csv", "write_parquet") and ast.unparse(node.args[0]) == "held"
            if opened or (name in WRITERS and not in_memory):
                wrong.append(f"{file.relative_to(PACKAGE)}:{node.lineno}: {ast.unparse(node)[:80]}")
    assert not wrong, "\n".join(wrong)


def test_errors_of_writing_are_both_kinds() -> None:
    """Catches a NotWritten that the command would show as a traceback, or that callers of OSError do not catch."""
    assert issubclass(NotWritten, sk.SherkitError)
    assert issubclass(NotWritten, OSError)
