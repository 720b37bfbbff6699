"""What today's diagnosis says where it is wrong: the reasons of the tests that are expected to fail.

A line belongs to one test. Whoever mends what it tells of takes the line away; a test that passes with its line still
here fails, so that none is forgotten. Robot and run of seed 0 where nothing else is said.
"""

from __future__ import annotations

import pytest

ROWS: dict[str, str] = {}

GROSS: dict[str, str] = {}


def expected(table: dict[str, str], row: str) -> list[pytest.MarkDecorator]:
    """The mark of a test that fails today; none where the row is right."""
    return [pytest.mark.xfail(strict=True, reason=f"{row}: {table[row]}")] if row in table else []


def rows(table: dict[str, str], *names: str) -> list[object]:
    """Parameters of a test, one for each name, marked where today's answer is wrong."""
    return [pytest.param(name, id=name, marks=expected(table, name)) for name in names]
