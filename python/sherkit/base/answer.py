"""What a verb answers, in the order in which a person reads it. Each verb makes one; terminal, page and notebook show
it and word nothing themselves."""

from __future__ import annotations

from dataclasses import dataclass

#: Stands in a command for the files of a verb, in their order.
FILES = "ROBOT RUN"
BEFORE, AFTER, NOISE, TARGET = "before", "after", "noise", "target"


@dataclass(frozen=True)
class Bar:
    """An error beside others: ``what`` is :data:`BEFORE`, :data:`AFTER`, :data:`NOISE` or :data:`TARGET`."""

    what: str
    name: str
    value: float


@dataclass(frozen=True)
class ToDo:
    """A step that a person can take, and the command that takes it where there is one."""

    sentence: str
    command: str = ""


@dataclass(frozen=True)
class Answer:
    """``verdict`` is one line for whoever reads nothing else, ``headline`` the same as a sentence of the workshop,
    empty where the verdict says it all; ``sure`` says how large it is, how sure and on what that rests; ``to_do`` comes
    in the order in which it is done. ``bars`` are errors in ``unit``."""

    verdict: str
    headline: str = ""
    sure: tuple[str, ...] = ()
    to_do: tuple[ToDo, ...] = ()
    bars: tuple[Bar, ...] = ()
    unit: str = ""

    def __str__(self) -> str:
        told = (self.headline, *self.sure, *(step.sentence for step in self.to_do))
        return "\n".join([self.verdict, *(f"  {as_sentence(one)}" for one in told if one)])


def as_sentence(text: str) -> str:
    """With a capital and a point; a name of the program that comes first, as ``rail_lean``, stays as it is."""
    first = text.partition(" ")[0].rstrip(",;:.")
    begin = text[:1].upper() + text[1:] if first.replace("-", "").isalpha() else text
    return f"{begin}{'' if text.endswith(('.', ':', '!', '?')) else '.'}"
