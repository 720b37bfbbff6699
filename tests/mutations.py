"""Damage to files: to their bytes, their lines, their words, and to the trees that they hold. Seeded; no one format."""

from __future__ import annotations

import copy
import faulthandler
import json
import math
import random
import re
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from sherkit import SherkitError

from hostile import HOSTILE  # isort: skip

#: Nothing that a person gives may keep the program busy for longer, s.
HANGS_S = 5.0
_ARMED_ANEW_S = 10.0
#: Words that numbers, names and structures are replaced by.
WORDS = (
    "", "0", "-0", "1", "-1", "1e308", "-1e308", "1e-320", "1e400", "nan", "NaN", "inf", "-inf", "0x10", "1_000",
    "1,000", "1.000,5", "1e5000", "9" * 400, "9223372036854775808", "-9223372036854775809", "1.5", "true", "false",
    "null",
    "none", "[]", "{}", '""', "''", "[[]]", "[1, 2]", "#", "=", "[x]", "[[x]]", ";", ",", ",,,,", "\t", '"', "'", "\\",
    "\x00", "\ufeff", "µ", "..", "/", "/dev/null", ".", "~", "2024-01-01", "12:00:00", "1e-5", "360", "1000000",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 10**6, 10**30, -(10**30), 1.5, -0.0, 1e-320, 1e99, 1e308, float("inf"),
    float("nan"), "", "x", "1", [], {}, [[]], [None], [1, 2, 3], [1.0, "x", 2.0], {"x": 1}, [{"x": 1}], *HOSTILE,
)  # fmt: skip
_MARKS = ((b",", b";"), (b".", b","), (b"\n", b"\r"), (b",", b"\t"), (b"=", b":"))
_WORD = re.compile(rb"[\w.+-]+")


def damaged_bytes(raw: bytes, rng: random.Random) -> bytes:
    """A file with one to four things done to its bytes, lines and words."""
    out = bytearray(raw)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        at = rng.randrange(len(out) + 1)
        match rng.randrange(10):
            case 0 if out:
                out[min(at, len(out) - 1)] = rng.randrange(256)
            case 1:
                del out[at : at + rng.choice((1, 3, 30, 300))]
            case 2:
                out[at:at] = rng.choice(WORDS).encode()
            case 3:
                del out[at:]
            case 4:
                out = bytearray(_lines(bytes(out), rng))
            case 5:
                out[at:at] = bytes(out[at : at + rng.choice((1, 10, 100))])
            case 6:
                out = out.replace(*rng.choice(_MARKS))
            case _:
                out = bytearray(_word(bytes(out), rng))
    return bytes(out)


def _lines(raw: bytes, rng: random.Random) -> bytes:
    lines = raw.split(b"\n")
    k, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    match rng.randrange(3):
        case 0:
            lines[k], lines[j] = lines[j], lines[k]
        case 1:
            lines.insert(j, lines[k])
        case _:
            del lines[k]
    return b"\n".join(lines)


def _word(raw: bytes, rng: random.Random) -> bytes:
    one, other = _some_word(raw, rng), _some_word(raw, rng)
    if one is None or other is None:
        return raw
    word = other[0] if rng.random() < 0.3 else rng.choice(WORDS).encode()
    return raw[: one.start()] + word + raw[one.end() :]


def _some_word(raw: bytes, rng: random.Random) -> re.Match[bytes] | None:
    # not of a list of all words, which takes longer to make than most inputs to read
    return _WORD.search(raw, rng.randrange(len(raw) + 1)) or _WORD.search(raw)


def damaged_tree(tree: Any, rng: random.Random) -> Any:
    """Tables and lists with one to four values replaced, removed, doubled, moved or misnamed, wherever they are."""
    out = copy.deepcopy(tree)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        places = list(_places(out))
        if not places:
            return out
        holder, key = rng.choice(places)
        value = holder[key]
        match rng.randrange(8):
            case 0:
                del holder[key]
            case 1:
                other, there = rng.choice(places)
                holder[key] = copy.deepcopy(other[there])
            case 2 if isinstance(holder, dict):
                holder[rng.choice((f"{key}s", str(key)[:-1], str(key).upper(), *HOSTILE))] = holder.pop(key)
            case 2 | 3 if isinstance(value, list):
                holder[key] = [*value, *value]
            case 4 if isinstance(value, int | float) and not isinstance(value, bool):
                holder[key] = rng.choice(
                    (-value, value * 1e6, value * 1e-6, value + 1, int(value) if abs(value) < 1e9 else 0)
                )
            case 5:
                holder[key] = [value]
            case _:
                holder[key] = copy.deepcopy(rng.choice(VALUES))
    return out


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in list(items):
        yield tree, key
        yield from _places(value)


def plain(tree: Any) -> Any:
    """A tree as TOML can hold it: what it cannot is left out."""
    if isinstance(tree, dict):
        return {str(k): plain(v) for k, v in tree.items() if v is not None}
    if isinstance(tree, list):
        return [plain(v) for v in tree if v is not None]
    return tree


class Hung(BaseException):
    """Longer than anybody waits."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Ends what takes longer, where Python can; a hang below it is written down in :func:`watched`."""

    def over(number: int, frame: FrameType | None) -> None:
        raise Hung(f"more than {seconds:g} s")

    before = signal.signal(signal.SIGALRM, over)
    _watch(seconds)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


_armed_s: float | None = None


@contextmanager
def watched() -> Iterator[None]:
    """While many things are tried, ends the program where Python itself does not come back from one of them."""
    global _armed_s
    _armed_s = -math.inf
    try:
        yield
    finally:
        _armed_s = None
        faulthandler.cancel_dump_traceback_later()


def _watch(seconds: float) -> None:
    # once in a while: to arm it starts a thread, which takes longer than to read most inputs
    global _armed_s
    if _armed_s is not None and (now := time.monotonic()) - _armed_s > _ARMED_ANEW_S:
        faulthandler.dump_traceback_later(_ARMED_ANEW_S + 12 * seconds, exit=True, file=sys.__stderr__)
        _armed_s = now


@contextmanager
def in_memory() -> Iterator[Path]:
    """A folder, in memory where there is one: to open a file on a disk for writing takes longer than to read it."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as folder:
        yield Path(folder)


@dataclass
class Campaign:
    """Counts what was said to damaged inputs, and keeps what should not have been."""

    read: int = 0
    refused: int = 0
    wrong: dict[str, tuple[str, bytes]] = field(default_factory=dict)

    def try_one(self, label: str, content: bytes, reads: Callable[[], None]) -> None:
        """One input: it is read, or refused in one sentence, in time; all else is wrong, each kind kept once."""
        try:
            with at_most(HANGS_S), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                reads()
            self.read += 1
        except SherkitError as error:
            self.refused += 1
            said = str(error)
            if not said or "Traceback" in said or "\n" in said or len(said) > 1000:
                self.wrong.setdefault(
                    f"no sentence: {len(said)} characters, {said[:60]!r} … {said[-60:]!r}", (label, content)
                )
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt | SystemExit):
                raise
            where = _where(error)
            self.wrong.setdefault(f"{type(error).__name__} at {where}: {str(error)[:90]}", (label, content))

    def over(self) -> None:
        """Fails with every kind of wrong answer, and an input for each."""
        told = [f"{kind}\n    {label}: {content[:600]!r}" for kind, (label, content) in self.wrong.items()]
        assert not told, "\n".join(told)
        assert self.refused, "nothing was refused: nothing was damaged"


def _where(error: BaseException) -> str:
    trace, last = error.__traceback__, "?"
    while trace is not None:
        code = trace.tb_frame.f_code
        if "sherkit" in code.co_filename:
            last = f"{code.co_filename.rpartition('sherkit/')[2]}:{trace.tb_lineno}"
        trace = trace.tb_next
    return last


def as_json(tree: Any) -> bytes:
    """JSON with the infinities that Python writes and reads."""
    return json.dumps(tree).encode()
