"""What every verb says is as it is kept: see ``outputs.py``."""

from __future__ import annotations

import json

import pytest

from outputs import FILE, LINES, differs, said


@pytest.mark.slow
def test_every_verb_says_what_it_said() -> None:
    """Catches a change of the code that was to change nothing, and changed a sentence, a table or JSON."""
    kept = json.loads(FILE.read_text(encoding="utf-8"))
    assert len(kept) == len(LINES)
    changed = {line: found for line, now in said() if (found := differs(kept.get(line, ""), now))}
    assert not changed, "\n".join(f"sherkit {line}\n{found}" for line, found in changed.items())


def test_what_differs_is_seen() -> None:
    """Catches a comparison that passes over a word, a number, a line more or less."""
    kept = "0\nerror 12.30 µm\nrail_lean 8.0"
    assert not differs(kept, "0\nerror 12.31 µm\nrail_lean   8.0")
    for now in (
        "0\nerror 12.90 µm\nrail_lean 8.0",
        "0\nerror 12.30 mm\nrail_lean 8.0",
        "0\nerror 12.30 µm",
        "1" + kept[1:],
    ):
        assert differs(kept, now), now
