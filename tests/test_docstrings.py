"""Every name at the door says what it does, and its example runs."""

from __future__ import annotations

import inspect
import json
import re
import textwrap
import warnings
from pathlib import Path
from typing import Any

import polars
import pytest

import sherkit as sk
from test_other_programs import bag, told

FUNCTIONS = [name for name in sk.__all__ if inspect.isfunction(getattr(sk, name))]


def examples(of: Any) -> list[str]:
    """The indented blocks of a docstring."""
    text = inspect.getdoc(of) or ""
    return [textwrap.dedent(block) for block in re.findall(r"(?:(?<=\n\n)|^)((?:    .*(?:\n|$)|\n(?=    ))+)", text)]


def test_every_name_at_the_door_is_described() -> None:
    """Catches a public name without a word."""
    for name in sk.__all__:
        assert inspect.getdoc(getattr(sk, name)), name


#: What takes longest; the tests of their own verbs ask the same functions.
LONG = ("fleet", "history", "compare")


@pytest.mark.parametrize("name", [pytest.param(one, marks=[pytest.mark.slow] * (one in LONG)) for one in FUNCTIONS])
def test_an_example_runs(name: str, work: Path) -> None:
    """Catches a function without an example, and one that shows what no longer works. In a folder where ``make demo``
    has run, with what others wrote beside it."""
    (work / "run.jsonl").write_text("\n".join(json.dumps(pair) for pair in told()))
    if name == "from_rosbag":
        bag(work / "bag")
    found = examples(getattr(sk, name))
    assert found, name
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sk.SherkitWarning)
        for text in found:
            exec(compile(text, name, "exec"), {"sk": sk, "polars": polars})
