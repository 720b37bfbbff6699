"""The page's server, without a browser: to whom it answers, and what others see of it."""

from __future__ import annotations

import asyncio
import http.client
import os
import signal
import stat
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from tornado.ioloop import IOLoop

from running import slow
from sherkit import save_robot
from sherkit.app.server import PageServer, ended_by_interrupt
from sherkit.app.workbench import Workbench
from sherkit.cli.app import _open
from sherkit.cli.demo import EXAMPLE
from sherkit.robots.delta.robot import grid
from sherkit.robots.delta.virtual import VirtualDelta


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A page that is served."""
    folder = tmp_path_factory.mktemp("served")
    save_robot(EXAMPLE, folder / "robot.toml")
    VirtualDelta.draw(EXAMPLE, 6).measure(grid(20.0, 4, (-18.0, 18.0)), repeats=2, seed=1).save(folder / "run.csv")
    ready = threading.Event()
    made: list[PageServer] = []

    def serve() -> None:
        loop = asyncio.new_event_loop()
        asyncio.set_event_loop(loop)
        bench = Workbench.open(folder / "robot.toml", folder / "run.csv", folder / "study")
        made.append(PageServer(bench, port=0, command="sherkit app robot.toml run.csv"))
        made[0].run(ready.set)
        loop.close()

    thread = threading.Thread(target=serve)
    thread.start()
    assert ready.wait(600)
    yield made[0].url
    made[0].server.io_loop.add_callback(made[0].server.io_loop.stop)
    thread.join(600)


def answer(url: str, path: str | None = None, host: str | None = None) -> tuple[int, str]:
    """Status and text of an answer."""
    where, _, own = url.removeprefix("http://").partition("/")
    line = http.client.HTTPConnection(where, timeout=600)
    line.request("GET", path or f"/{own}", headers={"Host": host or where})
    try:
        got = line.getresponse()
        return got.status, got.read().decode()
    finally:
        line.close()


@pytest.mark.parametrize("name", ["localhost", *slow("127.0.0.1", "[::1]")])
def test_it_answers_to_this_machine(url: str, name: str) -> None:
    """Catches a page that its owner cannot open by another name of the same machine."""
    port = url.rsplit(":", 1)[1].split("/")[0]
    status, text = answer(url, host=f"{name}:{port}")
    assert status == 200
    assert "bokeh" in text.lower()


@pytest.mark.parametrize("name", ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example"])
def test_it_answers_to_no_other_name(url: str, name: str) -> None:
    """Catches a page that another site's name leads to (DNS rebinding), whatever path it asks for."""
    port = url.rsplit(":", 1)[1].split("/")[0]
    status, text = answer(url, host=f"{name}:{port}")
    assert status == 421
    assert "does not answer to that name" in text


def test_an_old_address_says_how_to_go_on(url: str) -> None:
    """Catches a bare 404 for who reloads the page of an earlier start."""
    status, text = answer(url, "/AAAAAAAAAAAAAAAA/")
    assert status == 404
    assert "open the one that it printed last" in text


def test_a_browser_is_led_there_without_its_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches the key of the page on a command line, where every user of the machine reads it, or in a file for all."""
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    _open("http://127.0.0.1:5006/secret/", tmp_path / "leads.html")
    assert opened == [(tmp_path / "leads.html").as_uri()]
    assert "http://127.0.0.1:5006/secret/" in (tmp_path / "leads.html").read_text()
    if os.name == "posix":
        assert stat.S_IMODE((tmp_path / "leads.html").stat().st_mode) == 0o600


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
def test_a_study_is_its_owners_alone(tmp_path: Path) -> None:
    """Catches a folder of lines and measurements that every user of the machine can read."""
    save_robot(EXAMPLE, tmp_path / "robot.toml")
    VirtualDelta.draw(EXAMPLE, 6).measure(grid(20.0, 4, (-18.0, 18.0)), repeats=2, seed=1).save(tmp_path / "run.csv")
    Workbench.open(tmp_path / "robot.toml", tmp_path / "run.csv", tmp_path / "study").close()
    assert stat.S_IMODE((tmp_path / "study").stat().st_mode) == 0o700


def test_ctrl_c_wakes_a_loop_that_sleeps() -> None:
    """Catches a page that goes on after Ctrl-C until the next thing comes, ten seconds later: here nothing comes."""
    loop = IOLoop(make_current=False)
    slept: list[bool] = []

    def overslept() -> None:
        slept.append(True)
        loop.stop()

    loop.call_later(60.0, overslept)
    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
    with ended_by_interrupt(loop):
        loop.start()
    loop.close()
    assert not slept
