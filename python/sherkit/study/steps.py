"""One state of a study, and what a change took the place of."""

from __future__ import annotations

from dataclasses import dataclass

from ..data import Measurements
from ..fit.error import ErrorSize
from ..fit.identify import Fit
from ..model.chain import ChainModel


@dataclass(frozen=True, eq=False)
class StudyStep:
    """One state of a study: what was done, and the ``error`` it left on poses held out, beside that of the rows it was
    ``fitted`` to.

    ``fit`` is None for steps of a loaded study whose rows were others than the last ones: those were not kept.
    """

    action: str
    effects: tuple[str, ...]
    fitted: ErrorSize
    error: ErrorSize
    parameters: dict[str, float]
    rows: int
    fit: Fit | None

    def __repr__(self) -> str:
        return f"StudyStep({self.action}: {self.error})"


@dataclass(frozen=True, eq=False)
class Before:
    """What a change took the place of. The ``step`` that recorded it is not known of a study that was saved."""

    model: ChainModel
    data: Measurements
    step: StudyStep | None = None
    #: What the change was; empty where the study was saved before that was kept.
    action: str = ""
