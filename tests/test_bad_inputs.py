"""The documents' table of messages is what sherkit says today."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from bad_inputs import END, PAGE, START, between_markers, table


def test_the_table_is_what_is_said() -> None:
    """Catches a page that promises words which the program no longer says."""
    parts = between_markers(PAGE.read_text(encoding="utf-8"))
    assert parts is not None, f"{PAGE} has no {START} … {END}"
    assert parts[1].strip() == table(), "run: python tests/bad_inputs.py --write"


def test_every_bad_input_says_something() -> None:
    """Catches an empty cell, a path of the test's own folder, or a line break that would end the Markdown table."""
    for row in table().splitlines()[2:]:
        wrong, message = (cell.strip() for cell in row.strip("|").split("|"))
        assert wrong
        assert message.removeprefix("warning: ").startswith("readings.csv: ")


def test_only_the_block_is_replaced() -> None:
    """Catches text around the markers lost when the table is written anew, and markers found where there are none."""
    text = f"# title\n{START}\nold\n{END}\nmore\n"
    parts = between_markers(text)
    assert (parts[0], parts[2]) == (f"# title\n{START}", f"{END}\nmore\n")
    assert "".join(parts) == text
    assert between_markers(f"# title\n{START}\nno end\n") is None
    assert between_markers("# title\n") is None


@pytest.mark.slow
def test_the_script_prints_the_table() -> None:
    """Catches a script that the page names and that no longer runs."""
    script = str(Path(__file__).with_name("bad_inputs.py"))
    done = subprocess.run([sys.executable, script], capture_output=True, encoding="utf-8", timeout=600)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == table() + "\n"
    wrong = subprocess.run([sys.executable, script, "--wirte"], capture_output=True, encoding="utf-8", timeout=600)
    assert wrong.returncode == 1
    assert wrong.stderr.startswith("usage: ")
