"""The answer of an interim check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import scipy

from ..adaptive.gate import Silent
from ..base.answer import AFTER, TARGET, Answer, Bar, ToDo
from ..base.figures import finite, listed, number
from ..base.notebook import Shown
from ..data import Measurements
from ..data.columns import unit_in
from ..evidence.thresholds import ALARM, NEARLY_ALWAYS
from ..model.effect import Effect
from .change_model import ParameterChange
from .pool import told_ties
from .runs import moved_in_words

#: An error, in promises, of which it is said whether a check finds it.
_SURE = 1.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Verification(Shown):
    """``valid`` is whether the error that was promised still holds (None: this run cannot say, and ``silent`` why),
    ``error`` what was ``seen`` beyond noise, what was ``promised``, and the ``smallest_found``, an error that would
    have been called not valid in 95 of 100 checks (root mean squares of rows), in ``unit``. ``changed`` names what has
    moved, with ``parameters``; ``would_show`` and ``would_not`` are the changes of plausible size that these poses
    would have shown and would not."""

    valid: bool | None
    error: dict[str, float | None]
    unit: str
    changed: tuple[str, ...]
    indistinguishable: tuple[tuple[str, ...], ...]
    parameters: tuple[ParameterChange, ...]
    evidence: float
    stand: dict[str, float]
    would_show: tuple[str, ...]
    would_not: tuple[str, ...]
    advice: str
    silent: str = ""
    #: The accuracy that the robot is for, in 95 of 100 cases, µm, where its file says so.
    required_um: float | None = None
    #: Readings far off from all others, by their lines, which count for nothing.
    set_aside: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """``valid``, ``not valid`` or ``undecided``."""
        return "undecided" if self.valid is None else "valid" if self.valid else "not valid"

    @property
    def headline(self) -> str:
        """The verdict in one line."""
        seen, promised = self.error["seen"], self.error["promised"]
        told = "" if seen is None or promised is None else f": {seen:.3g} {self.unit} RMS seen, {promised:.3g} promised"
        moved = "; ".join(map(str, self.parameters))
        return f"{self.verdict}{told}{f'; {moved}' if moved else ''}{f'; {self.silent}' if self.silent else ''}"

    @property
    def sees(self) -> list[str]:
        """What a check by these rows finds and what it cannot, in words; a refusal needs none."""
        least, promised = self.error["smallest_found"], self.error["promised"]
        if self.silent or promised is None or (least is None and self.valid is False):
            return []
        if least is None:
            return [f"these rows cannot tell an error of {_SURE:g} × the promise, nor one of any size"]
        found = f"an error of {number(least)} {self.unit} would have been found in 95 of 100 such checks"
        if least <= _SURE * promised * (1.0 + 1e-9):
            return [found]
        return [f"these rows cannot tell an error of {_SURE:g} × the promise: {found}, {number(least / promised)} × it"]

    @property
    def _elsewhere(self) -> str:
        """How far the robot stands elsewhere, seen from the instrument, where that is more than what was promised."""
        by = {name: value for name, value in self.stand.items() if unit_in(name) == "mm"}
        far = 1e3 * float(np.linalg.norm(list(by.values()))) if by else 0.0
        if self.unit != "µm" or far <= (self.error["promised"] or np.inf):
            return ""
        return moved_in_words(self.stand)

    @property
    def answer(self) -> Answer:
        """What it says for whoever reads nothing else."""
        told = [*self.sees, *told_ties(self.indistinguishable)]
        if self.set_aside:
            told.insert(0, f"Set aside, far off from all others: {listed(self.set_aside)}; read it once more")
        if self.unit == "µm" and (promised := self.error["promised"]) is not None:
            within = promised * float(np.sqrt(scipy.special.chdtri(3, 1.0 - NEARLY_ALWAYS) / 3))
            # what could hide between the poses of the calibration no check by a few other poses can be held to
            told.append(
                "The promise is what the run of the calibration shows of its accuracy at these places: within "
                f"{number(within)} µm in 95 of 100 cases; the accuracy that calibrate prints also counts what that run "
                "could not show"
            )
            if self.required_um is not None and within > self.required_um:
                told.append(
                    f"That is more than the {number(self.required_um)} µm that the robot is for: a calibration that "
                    "holds what it promises is not good enough by that"
                )
        if off := self._elsewhere:
            told.append(
                "Seen from the instrument the robot stands elsewhere than in the run of the calibration: "
                f"{off}. These rows do not tell which of the two moved, and it counts for nothing above; places in the "
                "frame of the sensor are off by it where the instrument was not set up anew"
            )
        told.append(f"These poses would have shown, at its plausible size: {listed(self.would_show, 12) or 'nothing'}")
        if self.would_not:
            told.append(f"And would not have shown: {listed(self.would_not, 12)}")
        bars = ((AFTER, "seen", self.error["seen"]), (TARGET, "promised", self.error["promised"]))
        return Answer(
            self.headline, "", tuple(told), (ToDo(self.advice),),
            tuple(Bar(what, name, value) for what, name, value in bars if value is not None), self.unit,
        )  # fmt: skip

    @classmethod
    def unsaid(cls, data: Measurements, candidates: Sequence[Effect], why: Silent) -> Self:
        """Of a run that says nothing by its rows alone."""
        return cls(
            valid=None, error={"seen": None, "promised": None, "smallest_found": None}, unit=data.layout.unit,
            changed=(), indistinguishable=(), parameters=(), evidence=0.0, stand={}, would_show=(),
            would_not=tuple(one.name for one in candidates), advice=why.measure, silent=f"{data.source}: {why}",
        )  # fmt: skip

    def __repr__(self) -> str:
        return str(self.answer)

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "verdict": self.verdict,
            "error": {name: None if value is None else finite(value) for name, value in self.error.items()},
            "unit": self.unit,
            "changed": list(self.changed),
            "indistinguishable": [list(tie) for tie in self.indistinguishable],
            "parameters": [one.to_json() for one in self.parameters],
            "evidence": finite(self.evidence),
            "stand": self.stand,
            "required_um": self.required_um,
            "set_aside": list(self.set_aside),
            "would_show": list(self.would_show),
            "would_not": list(self.would_not),
            "silent": self.silent,
            "advice": self.advice,
        }


def advice_of(
    valid: bool | None, names: tuple[str, ...], ties: tuple[tuple[str, ...], ...], evidence: float, held: Sequence[str]
) -> str:  # fmt: skip
    """What to do after a check."""
    if valid is None:
        return "the calibration promises nothing at these places: calibrate again"
    if valid and not names and evidence < ALARM:
        return "nothing needs to be done"
    if valid:
        what = " or ".join(ties[0]) if ties else ", ".join(names) or "what, is not known"
        return f"something has changed ({what}), and is within what was promised"
    if held and not valid:
        verb = "does" if len(held) == 1 else "do"
        return (
            f"look first whether {listed(held)}, which {verb} not move in this run, {verb} move; else calibrate again"
        )
    if names:
        which = " or ".join(ties[0][:4]) if ties else names[0]
        return f"calibrate again: {which} has moved"
    return "calibrate again; these poses are too few to say what has moved"
