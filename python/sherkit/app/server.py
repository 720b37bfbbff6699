"""The server of the page: on loopback, under an address that cannot be guessed, with the files to take away.

Who can open the page can change the study, and type effects that run with the rights of who started it. So the whole
page stands under a random path, like a notebook's token, and typed effects are off where other machines can reach it.
"""

from __future__ import annotations

import asyncio
import errno
import io
import ipaddress
import secrets
import signal
import socket
import tempfile
import threading
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.util import bind_sockets
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPHeaders, HTTPMessageDelegate, HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.routing import Router
from tornado.web import OutputTransform, RequestHandler

from ..errors import SherkitError
from ..report.document import Report, html
from ..report.page import Made
from ..study import Study
from .page import StudyPage
from .workbench import Progress, Workbench

_LINKS = (
    ("calibration.toml", "the calibration (TOML)"),
    ("report.html", "the report (HTML)"),
    ("study.zip", "the study (ZIP)"),
)
_FOLLOW_MS = 1000


def is_loopback(address: str) -> bool:
    """Whether only this machine can reach ``address``."""
    if address == "localhost":
        return True
    return _is_address(address) and ipaddress.ip_address(address).is_loopback


class PageServer:
    """Serves a workbench. ``url`` is where; :meth:`run` serves until it is interrupted.

    Raises :class:`~sherkit.errors.SherkitError` where the port is taken.
    """

    def __init__(
        self,
        bench: Workbench,
        *,
        address: str = "127.0.0.1",
        port: int = 5006,
        command: str = "",
        follow: Path | None = None,
    ) -> None:
        self.bench = bench
        token = secrets.token_urlsafe(12)
        each = "".join(f'&nbsp; <a href="/{token}/{name}" download>{text}</a> ' for name, text in _LINKS)
        links = f"<details><summary>Export …</summary>{each}</details>"
        application = Application(FunctionHandler(lambda document: _make(document, bench, links, command, follow)))
        shared = {"bench": bench, "command": command}
        # Other machines call this one by names that it does not know, and Bokeh knows no IPv6; there the path that
        # nobody can guess is what keeps strangers out.
        trusted = is_loopback(address) and ":" not in address
        origins = {address, "localhost", "127.0.0.1"} if trusted else {"*"}
        try:
            sockets, port = bind_sockets(address, port)
            tornado = BokehTornado(
                {"/": application}, prefix=f"/{token}",
                extra_patterns=[(f"/{name}", _Download, {**shared, "name": name}) for name, _ in _LINKS],
                extra_websocket_origins=[f"{host}:{port}" for host in origins],
                transforms=[_Locked], session_token_expiration=3600, websocket_max_message_size_bytes=200 * 2**20,
                default_handler_class=_Elsewhere,
            )  # fmt: skip
            http = HTTPServer(_ByName(tornado, address, trusted))
            http.add_sockets(sockets)
            self.server = BaseServer(IOLoop.current(), tornado, http)
        except OSError as error:
            if isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
                raise SherkitError(f"{address} is no address of this machine ({error.strerror})") from None
            raise SherkitError(
                f"port {port} on {address} cannot be used: {error.strerror}; give another --port"
            ) from None
        host = f"[{address}]" if ":" in address else address
        self.url = f"http://{host}:{port}/{token}/"

    def run(self, ready: Callable[[], None] = lambda: None) -> None:
        """Serves until interrupted; ``ready`` is called once the page can be opened."""
        self.server.start()
        self.server.io_loop.add_callback(ready)
        try:
            with ended_by_interrupt(self.server.io_loop):
                self.server.io_loop.start()
        except KeyboardInterrupt:
            pass
        finally:
            self.server.stop()
            self.bench.close()


@contextmanager
def ended_by_interrupt(loop: Any) -> Iterator[None]:
    """Ctrl-C stops a loop of tornado; a second one is raised wherever it comes. Only the main thread hears of it, and
    nobody where who started this had it ignored, as shells do behind ``&``.

    Raised at once, it could end in a callback or a destructor that drops what is raised there, and the page went on.
    The loop is woken: it may sleep for ten seconds until something comes.
    """
    before = signal.getsignal(signal.SIGINT)
    if not callable(before) or threading.current_thread() is not threading.main_thread():
        yield
        return

    def first(*_: object) -> None:
        signal.signal(signal.SIGINT, before)
        loop.asyncio_loop.call_soon_threadsafe(loop.stop)

    signal.signal(signal.SIGINT, first)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class _ByName(Router):
    """Answers only to names of this machine: a page from elsewhere whose own name leads here gets nothing.

    Addresses are no such names. Source: DNS rebinding (Jackson et al., "Protecting browsers from DNS rebinding
    attacks", CCS 2007).
    """

    def __init__(self, application: BokehTornado, address: str, loopback: bool) -> None:
        self._application = application
        own = set() if loopback else {socket.gethostname(), socket.getfqdn(), f"{socket.gethostname()}.local"}
        self._names = {name.lower() for name in (address, "localhost", *own)}

    def find_handler(self, request: HTTPServerRequest, **_: Any) -> HTTPMessageDelegate | None:
        """The page's own answer, or a refusal."""
        name = request.host_name.strip("[]").lower()
        if name in self._names or _is_address(name):
            return self._application.find_handler(request)
        return self._application.get_handler_delegate(request, _Refused)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class _Saying(RequestHandler):
    """Answers in words."""

    def say(self, status: int, words: str) -> None:
        self.set_status(status)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(words)


class _Refused(_Saying):
    """To a name that is not this machine's."""

    def prepare(self) -> None:
        self.say(
            421, "This server does not answer to that name; open the page by the address that sherkit app printed."
        )


class _Elsewhere(_Saying):
    """Where there is no page: most often the address of a page that was started anew since."""

    def prepare(self) -> None:
        self.say(
            404,
            "There is no page here. Each start of sherkit app has an address of its own: open the one that it printed "
            "last in its terminal. Nothing is lost; the study is in its folder.",
        )


class _Locked(OutputTransform):
    """What a page cannot say of itself: it stands in no other page, is what it says it is, and tells nobody its
    address, which is its key."""

    def transform_first_chunk(
        self, status_code: int, headers: HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, HTTPHeaders, bytes]:
        """Adds the headers to every answer."""
        del finishing
        headers["Content-Security-Policy"] = "frame-ancestors 'none'; object-src 'none'; base-uri 'none'"
        headers["X-Content-Type-Options"] = "nosniff"
        headers["Referrer-Policy"] = "no-referrer"
        return status_code, headers, chunk


def _make(document: Document, bench: Workbench, links: str, command: str, follow: Path | None) -> None:
    StudyPage(document, bench, links, command)
    if follow is not None:

        def look() -> None:
            bench.follow(follow)

        document.add_periodic_callback(look, _FOLLOW_MS)


class _Download(_Saying):
    """Files made from the study as it stands."""

    def initialize(self, bench: Workbench, command: str, name: str) -> None:
        self.bench, self.command, self.name = bench, command, name

    async def get(self) -> None:
        make = {"calibration.toml": _calibration, "report.html": self._report, "study.zip": self._study}[self.name]
        try:
            content = await asyncio.wrap_future(self.bench.ask(f"making {self.name}", make))
        except Exception as error:
            # a browser does not show what comes instead of a file that it was to save
            self.bench.tell(error)
            self.say(409, str(error))
            return
        self.set_header("Content-Disposition", f'attachment; filename="{self.name}"')
        self.set_header("Content-Type", "application/octet-stream")
        self.finish(content)

    def _report(self, study: Study, step: Progress) -> bytes:
        found = self.bench.page_state.diagnosis or study.diagnose(step=step)
        paths = [path for path in self.bench.sources if path.exists()]
        made = Made.of(paths, self.command, about="" if paths else Path(study.data.source).name)
        calibration = study.calibration() if study.deployable else None
        return html(Report(study, found, made, calibration)).encode("utf-8")

    def _study(self, study: Study, _: Progress) -> bytes:
        study.save(self.bench.folder)
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted(self.bench.folder.iterdir()):
                if path.is_file() and not path.name.startswith("."):
                    archive.write(path, path.name)
        return packed.getvalue()


def _calibration(study: Study, _: Progress) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "calibrated.toml"
        study.calibration().save(path)
        return path.read_bytes()
