"""An emulated instrument as a server: a pseudo-terminal, or a TCP, HTTP or UDP port of this machine.

One thread per emulator waits for bytes, hands whole commands to the instrument, and sends its answers as a real line
does: late, in pieces, with other text in between, or not at all.
"""

from __future__ import annotations

import contextlib
import os
import random
import select
import socket
import tempfile
import threading
import time
import tty
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import ClassVar, Self

from .world import Faults, InjectedFault, World

LOOPBACK = "127.0.0.1"
_TICK_S = 0.005
_LONGEST_COMMAND = 1 << 16


@dataclass(eq=False)
class Client:
    """Who is connected: what has come from them, and what goes to them and when."""

    channel: int | socket.socket
    received: bytearray = field(default_factory=bytearray)
    outbox: deque[tuple[float, bytes]] = field(default_factory=deque)

    def fileno(self) -> int:
        return self.channel if isinstance(self.channel, int) else self.channel.fileno()


@dataclass(eq=False, repr=False)
class Emulator(ABC):
    """The base of all emulated instruments with a port. ``with`` starts and stops it; ``address`` is for the driver.

    ``link`` is "pty", "tcp", "http" or "udp". ``latency_s`` passes before an answer; ``pieces`` is the most parts that
    it is cut into, ``gap_s`` apart. ``faults`` says what goes wrong. ``log`` holds what came, what was answered and the
    fault. It listens on this machine alone unless ``host`` says otherwise. ``page`` is its page on HTTP, if it has one.
    ``failure`` is what went wrong in the emulator itself.
    """

    links: ClassVar[tuple[str, ...]] = ("tcp",)

    world: World
    _: KW_ONLY
    link: str = ""
    host: str = LOOPBACK
    port: int = 0
    faults: Faults = field(default_factory=Faults)
    latency_s: float = 0.0
    pieces: int = 1
    gap_s: float = 0.001
    seed: int = 0
    page: str = field(default="", init=False)
    log: list[tuple[bytes, bytes, InjectedFault | None]] = field(default_factory=list, init=False)
    failure: Exception | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.link = self.link or self.links[0]
        if self.link not in self.links:
            raise ValueError(f"{type(self).__name__} has no {self.link!r}; expected one of {', '.join(self.links)}")
        self._streams = self.link in ("tcp", "http")
        self.random = random.Random(self.seed)
        self._clients: list[Client] = []
        self._listener: socket.socket | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._slave = -1
        self._running = False
        self._thread: threading.Thread | None = None
        self._waker = socket.socketpair()
        self._powered = True
        #: what is to be done between two commands, by the emulator's own thread
        self._errands: deque[tuple[Callable[[], None], threading.Event]] = deque()

    # --- what an instrument says

    @abstractmethod
    def take_command(self, received: bytearray) -> bytes | None:
        """Cuts the next whole command off ``received``, None where it is not yet whole."""

    @abstractmethod
    def answer(self, command: bytes, fault: InjectedFault | None) -> bytes:
        """The answer to a command, "" for none; ``fault`` is the machine's (over_range, limit_switch), if any."""

    def tick(self) -> None:  # noqa: B027 - most have nothing to do by themselves
        """Called often, for what happens by itself."""

    def forget(self) -> None:  # noqa: B027 - most lose nothing that matters
        """Called when the power goes: what was set and not burnt into memory is lost."""

    def switch_off(self) -> None:
        """Takes the power away: it answers nobody, whoever was connected is cut off, what was set is lost."""

        def off() -> None:
            if self._powered:
                self._powered = False
                self.forget()
                for client in list(self._clients):
                    if self._streams:
                        self._leave(client)
                    client.received.clear()
                    client.outbox.clear()

        self._between(off)

    def switch_on(self) -> None:
        """Gives the power back."""
        self._between(lambda: setattr(self, "_powered", True))

    def _between(self, task: Callable[[], None]) -> None:
        """Has the task done between two commands, and returns when it is."""
        if self._thread is None:
            task()
            return
        done = threading.Event()
        self._errands.append((task, done))
        self._waker[1].send(b".")
        while not done.wait(0.1):
            if not self._thread.is_alive():
                raise RuntimeError("the emulator has stopped") from self.failure

    def interjection(self) -> bytes:
        """Text that comes in the middle of an answer, "" for none."""
        return b""

    # --- running

    @property
    def address(self) -> str:
        """What the driver is to open."""
        if self._folder is not None:
            return str(Path(self._folder.name) / "port")
        if self._listener is None:
            raise RuntimeError("the emulator was not started")
        host, port = self._listener.getsockname()[:2]
        return f"{self.link}://{host}:{port}"

    def start(self) -> Self:
        """Opens the port and serves it in a thread."""
        if self.link == "pty":
            self._folder = tempfile.TemporaryDirectory(prefix="sherkit-port-")
            self._new_terminal()
        else:
            kind = socket.SOCK_STREAM if self._streams else socket.SOCK_DGRAM
            self._listener = socket.socket(socket.AF_INET, kind)
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind((self.host, self.port))
            if self._streams:
                self._listener.listen()
        self._running = True
        self._thread = threading.Thread(target=self._serve, daemon=True, name=type(self).__name__)
        self._thread.start()
        return self

    def stop(self) -> None:
        """Closes the port. Raises what went wrong in the emulator itself."""
        if self._thread is not None:
            self._running = False
            self._waker[1].send(b".")
            self._thread.join(10.0)
            self._thread = None
            for client in list(self._clients):
                self._leave(client)
            if self._listener is not None:
                self._listener.close()
            if self._slave >= 0:
                os.close(self._slave)
                self._slave = -1
            if self._folder is not None:
                self._folder.cleanup()
            for end in self._waker:
                end.close()
        if self.failure is not None:
            raise self.failure

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _new_terminal(self) -> None:
        """A new pseudo-terminal behind the same name, as an adapter that is plugged in again."""
        assert self._folder is not None
        old = self._slave
        master, self._slave = os.openpty()
        # raw from the beginning: a terminal would echo and translate what the first program says
        tty.setraw(self._slave)
        os.set_blocking(master, False)
        name = Path(self._folder.name) / "port"
        fresh = name.with_suffix(".new")
        fresh.symlink_to(os.ttyname(self._slave))
        fresh.replace(name)
        if old >= 0:
            os.close(old)
        self._clients.append(Client(master))

    def _leave(self, client: Client) -> None:
        self._clients.remove(client)
        with contextlib.suppress(OSError):
            os.close(client.channel) if isinstance(client.channel, int) else client.channel.close()

    def _serve(self) -> None:
        try:
            while self._running:
                self._serve_once()
        # kept for stop(): a thread has nobody to raise to
        except Exception as error:
            self.failure = error

    def _serve_once(self) -> None:
        waiting: list[Client | socket.socket] = [self._waker[0], *self._clients]
        if self._listener is not None:
            waiting.append(self._listener)
        now = time.monotonic()
        due = [max(c.outbox[0][0] - now, 0.0) for c in self._clients if c.outbox]
        ready, _, _ = select.select(waiting, [], [], min([*due, _TICK_S]))
        for source in ready:
            if source is self._waker[0]:
                self._waker[0].recv(16)
            elif source is self._listener:
                self._from_listener(self._listener)
            elif source in self._clients:
                self._from_client(source)
        while self._errands:
            task, done = self._errands.popleft()
            task()
            done.set()
        self.tick()
        for client in list(self._clients):
            self._send_due(client)

    def _from_listener(self, listener: socket.socket) -> None:
        if not self._streams:
            data, where = listener.recvfrom(1 << 16)
            if self._powered:
                self._datagram(data, where)
            return
        channel, _ = listener.accept()
        if not self._powered:
            channel.close()
            return
        channel.setblocking(False)
        channel.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients.append(Client(channel))

    def _datagram(self, data: bytes, where: tuple[str, int]) -> None:  # noqa: B027 - for UDP alone
        """A datagram has come (UDP)."""

    def _from_client(self, client: Client) -> None:
        try:
            data = os.read(client.fileno(), 4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            if self.link == "pty":
                # nobody has it open: the terminal stays for the next one
                time.sleep(_TICK_S)
            else:
                self._leave(client)
            return
        if not self._powered:
            return
        client.received += data
        if len(client.received) > _LONGEST_COMMAND:
            client.received.clear()
        while client in self._clients and (command := self.take_command(client.received)) is not None:
            self._obey(client, command)

    def _obey(self, client: Client, command: bytes) -> None:
        fault = self.faults.take()
        kind = fault.kind if fault is not None else ""
        heard = self._misheard(command) if kind == "misheard" else command
        reply = self.answer(heard, fault)
        self.log.append((heard, reply, fault))
        if kind == "disconnect":
            if self.link == "pty":
                self._new_terminal()
            self._leave(client)
        elif kind != "drop" and reply:
            if kind == "garble":
                reply = self.faults.garbled(reply)
            late_s = fault.seconds if fault is not None and kind == "stall" else 0.0
            self._post(client, reply, self.latency_s + late_s, self.interjection())

    def _misheard(self, command: bytes) -> bytes:
        """The command as a bad line hands it on; the end of it arrives."""
        return self.faults.garbled(command)

    def _post(self, client: Client, data: bytes, delay_s: float, between: bytes = b"") -> None:
        # a line does not let answers overtake each other
        due = max([time.monotonic() + delay_s, *(at for at, _ in client.outbox)])
        cuts = sorted(self.random.randrange(len(data) + 1) for _ in range(self.random.randint(1, self.pieces) - 1))
        parts = [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]
        if between:
            parts.insert(self.random.randrange(len(parts) + 1), between)
        client.outbox.extend((due + k * self.gap_s, part) for k, part in enumerate(parts) if part)

    def _send_due(self, client: Client) -> None:
        while client in self._clients and client.outbox and client.outbox[0][0] <= time.monotonic():
            due, data = client.outbox.popleft()
            try:
                sent = os.write(client.fileno(), data)
            except BlockingIOError:
                sent = 0
            except OSError:
                if self.link != "pty":
                    self._leave(client)
                return
            if sent < len(data):
                client.outbox.appendleft((due, data[sent:]))
                return


class LineEmulator(Emulator):
    """An instrument whose commands end with ``ending``."""

    ending: ClassVar[bytes]

    def take_command(self, received: bytearray) -> bytes | None:
        """Up to the end of the line."""
        at = received.find(self.ending)
        if at < 0:
            return None
        line = bytes(received[: at + len(self.ending)])
        del received[: len(line)]
        return line

    def _misheard(self, command: bytes) -> bytes:
        return self.faults.garbled(command[:-1]).replace(self.ending, b"") + self.ending


class Page(LineEmulator):
    """What shows one thing on HTTP, at ``path``. What goes wrong with it, it shows itself."""

    links = ("http",)
    ending = b"\r\n\r\n"
    path: ClassVar[str]
    content_type: ClassVar[str]

    @property
    def address(self) -> str:
        """The address of what it shows."""
        return super().address + self.path

    @abstractmethod
    def shown(self) -> bytes | None:
        """What is at its path now, None where that fails."""

    def answer(self, command: bytes, fault: InjectedFault | None) -> bytes:
        """Of HTTP/1.0: what it shows, to a GET of its path alone."""
        there = command.startswith(f"GET {self.path} HTTP".encode())
        body = self.shown() if there else None
        said = "200 OK" if body is not None else "503 Service Unavailable" if there else "404 Not Found"
        body = body or b""
        head = f"HTTP/1.0 {said}\r\nContent-Type: {self.content_type}\r\nContent-Length: {len(body)}\r\n\r\n"
        return head.encode() + body

    def _obey(self, client: Client, command: bytes) -> None:
        self._post(client, self.answer(command, None), self.latency_s)
