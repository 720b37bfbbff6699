"""Answers of today, kept: ``make golden`` says which worlds are answered otherwise now, ``make golden-write`` keeps the
new answers.

A step of the work may change a number in its last digits, or a verdict that was wrong: each change of a verdict is
named in its commit. Worlds are those of ``golden_worlds.py``; an argument picks those whose name holds it.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from golden_worlds import WORLDS
from worlds import Answer

FILE = Path(__file__).parent / "golden" / "answers.jsonl"
#: By how much, relative, a number may be another one: the BLAS of another machine settles a fit a little elsewhere,
#: and noise that repeats tell by shapes comes out by a part in a thousand otherwise.
LAST_DIGITS = 2e-3
DIGITS = 7

Record = dict[str, Any]


def record(answer: Answer) -> Record:
    """What is kept of an answer: nothing else in this file reads a diagnosis."""
    d = answer.diagnosis
    if d is None:
        return {"refused": " ".join(answer.sentences[-1].split())[:160]}
    sizes = {p["name"]: p["value"] for c in d.candidates if c.effect in d.effects for p in c.parameters}
    told = d.signature
    return {
        "verdict": d.verdict,
        "effects": list(d.effects),
        "indistinguishable": [list(tie) for tie in d.indistinguishable],
        "caveat": d.caveat is not None,
        "fails": [check.name for check in d.checks if check.decisive and check.holds is False],
        "signature": None if told is None else [told["depends_on"], told["shape"]],
        "outliers": len(d.outliers),
        "noise_origin": d.noise_origin,
        "noise": {name: _short(value) for name, value in d.noise.items()},
        "held_out": {s.effect or "geometry calibrated": _short(s.error.rms) for s in d.steps},
        "sizes": {name: _short(value) for name, value in sizes.items()},
    }


def differences(kept: Record, now: Record, within: float = LAST_DIGITS) -> Iterator[str]:
    """What is otherwise now, in words; numbers only where they differ by more than ``within``."""
    for key in dict.fromkeys((*kept, *now)):
        before, after = kept.get(key), now.get(key)
        if isinstance(before, dict) and isinstance(after, dict) and before.keys() == after.keys():
            for name, value in before.items():
                if abs(after[name] - value) > within * max(abs(value), abs(after[name])):
                    yield f"{key} {name}: {value:g} → {after[name]:g}"
        elif before != after:
            yield f"{key}: {json.dumps(before, ensure_ascii=False)} → {json.dumps(after, ensure_ascii=False)}"


def asked(name: str) -> tuple[str, Record]:
    """A world's name and its answer of today."""
    return name, record(WORLDS[name]())


def kept() -> dict[str, Record]:
    """The answers on file, by the names of their worlds."""
    lines = FILE.read_text(encoding="utf-8").splitlines() if FILE.exists() else []
    return {line.pop("world"): line for line in map(json.loads, lines)}


def answers(names: Iterable[str]) -> Iterator[tuple[str, Record]]:
    """Of today, two worlds at a time, in the order of their names on the list."""
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        yield from pool.imap(asked, names)


def _short(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def main() -> int:
    """Compares, or with ``--write`` keeps."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", nargs="?", default="", help="of the names of the worlds")
    parser.add_argument("--write", action="store_true", help="keep the answers of today")
    given = parser.parse_args()
    before = kept()
    names = [name for name in WORLDS if given.part in name]
    other = 0
    for name, now in answers(names):
        found = [*differences(before[name], now)] if name in before else ["is new"]
        other += bool(found)
        if found:
            print(name, *found, sep="\n    ", flush=True)
        before[name] = now
    print(f"{len(names)} worlds, {other} answered otherwise than {FILE.name} has it")
    if given.write:
        lines = [json.dumps({"world": name, **before[name]}, ensure_ascii=False) for name in WORLDS if name in before]
        FILE.parent.mkdir(exist_ok=True)
        FILE.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return 0
    return int(other > 0)


if __name__ == "__main__":
    sys.exit(main())
