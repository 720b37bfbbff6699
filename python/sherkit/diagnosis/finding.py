"""One answer of a diagnosis, as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

#: The questions, in the order in which a person asks.
WRONG, MISSING, WHERE, WHICH, APART, NEXT = QUESTIONS = (
    "What is wrong?", "Is anything missing?", "Where?", "Which effect?", "What can these data not tell apart?",
    "What next?",
)  # fmt: skip
#: Where a command has the files that were given.
FILES = "ROBOT RUN"


@dataclass(frozen=True)
class Finding:
    """One answer to one of the :data:`QUESTIONS`.

    ``about`` says what of: cause, brings, verdict; missing, noise, note, left_out; where; step, shape; tie, confounded,
    untestable, nothing; next. ``answer`` is a sentence or a part of one; ``numbers`` are by name with their unit;
    ``sure`` says how sure it is; ``rows`` are the lines of the rows it speaks of; ``to_do`` what a person can do;
    ``command`` is what does that, with :data:`FILES` where the files stand that were given.
    """

    question: str
    about: str
    answer: str
    numbers: Mapping[str, float] = field(default_factory=dict)
    sure: str = ""
    rows: tuple[int, ...] = ()
    to_do: str = ""
    command: str = ""

    def __str__(self) -> str:
        if not self.sure:
            return f"{self.answer}: {self.command}" if self.command else self.answer
        return f"{self.answer[:-1]} ({self.sure})." if self.answer.endswith(".") else f"{self.answer}: {self.sure}"

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "question": self.question, "about": self.about, "answer": self.answer, "numbers": dict(self.numbers),
            "sure": self.sure, "rows": list(self.rows), "to_do": self.to_do,
            "command": self.command,
        }  # fmt: skip
