"""What a page shows: the study at one moment, and what is said to a person."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..data import Measurements
from ..diagnosis import Diagnosis
from ..model.effect import Effect
from ..report.residuals import ModelState, Residuals
from ..study import StudyStep


@dataclass(frozen=True)
class Said:
    """A sentence, beside the control that it is ``about``: the name of an effect, or one of those below."""

    text: str
    about: str = ""


#: Controls that a sentence may be about.
HISTORY, LINES, FILES, ROWS, EXPORTS = "history", "lines", "files", "rows", "exports"


@dataclass(frozen=True, eq=False)
class PageState:
    """The study as it stands: model, rows and history, by the number of their step the ``states`` that can be compared,
    and a diagnosis where it is done: until then the noise is that of the last one.

    ``without`` is the error held out that the model would leave without each of its effects, known with the diagnosis;
    so are the ``drawings``, as HTML, of the user's own effects that are in the model or named: a page never asks lines
    that a person typed. So is the ``space``, as HTML: the workspace in three dimensions with the errors of the first
    step and of this one, empty where the run says no places.
    """

    data: Measurements
    #: Rows that are left out as gross errors.
    left_out: tuple[int, ...]
    effects: tuple[str, ...]
    own: tuple[str, ...]
    #: The built-in effects of this robot, and the user's own.
    known: Mapping[str, Effect]
    history: tuple[StudyStep, ...]
    states: Mapping[int, ModelState]
    diagnosis: Diagnosis | None
    undoes: str
    redoes: str
    number: int
    #: The accuracy that the robot is for, µm, where its file says so.
    required_um: float | None = None
    without: Mapping[str, float] = field(default_factory=dict)
    drawings: Mapping[str, str] = field(default_factory=dict)
    space: str = ""

    @property
    def now(self) -> Residuals:
        """What the current model leaves."""
        return [*self.states.values()][-1].left
