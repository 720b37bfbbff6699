"""Settings of all tests."""

from __future__ import annotations

import gc
import os
import shutil
import time
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import settings

import browsing
from consistency import consistent
from sherkit.diagnosis import Diagnosis

# how long an example takes depends on what else the machine does; and a run that says something else than the last one
# shall mean that the code changed
settings.register_profile("same", deadline=None, derandomize=True, print_blob=True, max_examples=40)
# `make test-slow` looks elsewhere each time, and longer
settings.register_profile(
    "random", deadline=None, print_blob=True, max_examples=int(os.environ.get("SHERKIT_EXAMPLES", "500"))
)
settings.load_profile("random" if os.environ.get("SHERKIT_RANDOM") else "same")


# What tests write need not outlive a power cut: in memory they do not wait for the disk, to which sherkit brings every
# file before it goes on.
_MEMORY = Path("/dev/shm")
_ENOUGH = 4 << 30
if _MEMORY.is_dir() and os.access(_MEMORY, os.W_OK) and shutil.disk_usage(_MEMORY).free > _ENOUGH:
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(_MEMORY))


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--part 2/8``: every eighth test of those that are chosen, from the second on, so that a part ends in time."""
    parser.addoption("--part", default="1/1", metavar="K/N", help="one part of so many of the chosen tests")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Tests that ask one thing of many seeds follow each other: dealt out, every part has its share of them."""
    part, parts = map(int, config.getoption("--part").split("/"))
    others = [one for k, one in enumerate(items) if k % parts != part - 1]
    config.hook.pytest_deselected(items=others)
    items[:] = items[part - 1 :: parts]


def pytest_collection_finish() -> None:
    """What is loaded stays: nobody need look for garbage among it, again and again."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000)
    global _before_s
    _before_s = sum(os.times()[:4])


#: More than so much of a processor is too much for a quick test (parts of one: what is set up for many falls on the
#: first of them).
_QUICK_S = 0.5
_before_s = 0.0


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, Any, Any]:
    """What each part of a test and the processes that it waited for computed, whatever else the machine did."""
    global _before_s
    report = yield
    now_s = sum(os.times()[:4])
    report.processor_s, _before_s = now_s - _before_s, now_s
    return report


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Names the quick tests that are not."""
    parts = [one for some in terminalreporter.stats.values() for one in some if hasattr(one, "processor_s")]
    for one in sorted(parts, key=lambda one: -one.processor_s):
        if one.processor_s > _QUICK_S and "slow" not in one.keywords:
            terminalreporter.write_line(f"{one.processor_s:5.1f} s of processor  {one.when:8}  {one.nodeid}")


def made_once(tmp_path_factory: pytest.TempPathFactory, name: str, every: int) -> Path:
    """What ``make demo`` leaves of one of so many poses. The worker that is first makes it for all."""
    from sherkit.robots.delta.robot import paper_local, paper_whole
    from test_docs import sherkit
    from test_klipper import SAVED, TRUE, config

    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name
    making = shared.with_name(f"making_{name}")
    while not shared.exists():
        try:
            making.mkdir()
        except FileExistsError:  # another worker is at it: to wait leaves it the processor
            time.sleep(0.05)
            continue
        if not shared.exists():
            folder = tmp_path_factory.mktemp("made")
            some = {one.__name__: lambda one=one: one()[every - 1 :: every] for one in (paper_whole, paper_local)}
            with patch.multiple("sherkit.cli.demo", **some):
                (folder / "said.txt").write_text(sherkit(["demo", "--tables"], folder), encoding="utf-8")
            shutil.copy(folder / "demo" / "robot.toml", folder / "robot.toml")
            shutil.copy(folder / "demo" / "local.csv", folder / "run.csv")
            (folder / "printer.cfg").write_text(config(TRUE, SAVED), encoding="utf-8")
            folder.rename(shared)
        making.rmdir()
    return shared


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a reader has after ``make demo``, what that said with its tables (``said.txt``), and the files that the
    documents name as the reader's own. Of every sixth pose: what is shown must run, and how long it takes goes with the
    rows. Tests that write there take a copy (:func:`work`)."""
    return made_once(tmp_path_factory, "made_by_demo", 6)


@pytest.fixture(scope="session")
def made_whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same of all poses, as a reader has it: where figures are compared with those of the documents."""
    return made_once(tmp_path_factory, "made_by_whole_demo", 1)


@pytest.fixture(autouse=True, scope="module")
def one_chromium_for_a_module() -> Iterator[None]:
    """See :func:`browsing.chromium`."""
    yield
    browsing.close()


@pytest.fixture
def in_each_font() -> Iterator[browsing.InEachFont]:
    """Looks at an open page once in each font of :data:`browsing.FONTS`: ``in_each_font(page, looked_at)``. Where this
    machine lacks one, the test says so: it passed in the others alone."""
    missing: dict[str, str] = {}

    def each(page: Any, look: Callable[[], None]) -> None:
        for font, package in browsing.FONTS.items():
            if not browsing.has_font(page, font):
                missing[font] = package
                continue
            browsing.draw_in(page, font)
            try:
                look()
            except Exception as error:
                error.add_note(f"in {font}")
                raise

    yield each
    if missing:
        lacking = "; ".join(f"{font} (Debian: {package})" for font, package in missing.items())
        pytest.skip(f"not looked at in a font that this machine lacks: {lacking}")


@pytest.fixture
def work(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A fresh copy of it, as the current folder."""
    folder = tmp_path / "work"
    shutil.copytree(made, folder)
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture(autouse=True, scope="session")
def every_diagnosis_is_consistent() -> Iterator[None]:
    """Whatever a test asks, no diagnosis that it makes may contradict its own numbers."""
    make = Diagnosis.__init__

    def checked(self: Diagnosis, *args: Any, **fields: Any) -> None:
        make(self, *args, **fields)
        consistent(self)

    Diagnosis.__init__ = checked  # type: ignore[method-assign]
    yield
    Diagnosis.__init__ = make  # type: ignore[method-assign]
