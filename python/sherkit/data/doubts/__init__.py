"""What a table says against itself, before any model is fitted: a list of rules, each from a table to sentences.

A rule knows no robot: it sees columns, their names and units, which rows are repeats, and how far a smooth function of
the joints reaches. What it says must be true of the table, whatever the machine.
"""

from collections.abc import Callable, Iterator

from ..rows import Measurements
from .alike import alike, piled
from .doubt import DataWarning
from .repeats import averaged, commanded, copied, declared
from .values import angles, frozen, on_a_line, order_lost, temperature, time_in_milliseconds

__all__ = ["RULES", "DataWarning", "angles", "commanded", "doubts"]

#: What is asked of every table.
RULES: tuple[Callable[[Measurements], Iterator[DataWarning]], ...] = (
    frozen, time_in_milliseconds, copied, averaged, alike, piled, declared, temperature, order_lost, on_a_line,
)  # fmt: skip


def doubts(data: Measurements) -> tuple[DataWarning, ...]:
    """Everything that a table says against itself."""
    return tuple(doubt for rule in RULES for doubt in rule(data))
