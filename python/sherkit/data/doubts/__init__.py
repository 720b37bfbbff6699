"""What a table says against itself, before any model is fitted: a list of rules, each from a table to sentences.

A rule knows no robot: it sees columns, their names and units, which rows are repeats, and how far a smooth function of
the joints reaches. What it says must be true of the table, whatever the machine.
"""

from collections.abc import Callable, Iterator

from ..rows import Measurements
from .alike import alike, piled
from .doubt import DataWarning
from .repeats import averaged, commanded, copied, declared
from .values import angles, by_number, frozen, lost, on_a_line, one_value, order_lost, temperature, time_in_milliseconds

__all__ = ["RULES", "DataWarning", "angles", "by_number", "commanded", "copied", "doubts"]

#: What is asked of every table.
RULES: tuple[Callable[[Measurements], Iterator[DataWarning]], ...] = (
    frozen, time_in_milliseconds, copied, averaged, alike, piled, declared, temperature, order_lost, on_a_line,
)  # fmt: skip

#: And of one that a person looks at.
_BY_HAND = (lost, one_value, by_number)


def doubts(data: Measurements, *, by_hand: bool = False) -> tuple[DataWarning, ...]:
    """Everything that a table says against itself; ``by_hand`` with what a diagnosis puts right by itself."""
    return tuple(doubt for rule in (*RULES, *(_BY_HAND if by_hand else ())) for doubt in rule(data))
