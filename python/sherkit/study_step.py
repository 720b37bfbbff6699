"""One state of a study, and what a change took the place of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .data import Measurements
from .fit.identify import Fit
from .model.chain import ChainModel


@dataclass(frozen=True, eq=False)
class StudyStep:
    """One state of a study: what was done, and the error it left by reading, in ``unit``, fitted and held out.

    ``fit`` is None for steps of a loaded study whose rows were others than the last ones: those were not kept.
    """

    action: str
    effects: tuple[str, ...]
    training_rms: dict[str, float]
    held_out_rms: dict[str, float]
    parameters: dict[str, float]
    rows: int
    fit: Fit | None
    unit: str = "µm"

    def __repr__(self) -> str:
        axes = ", ".join(f"{k.rsplit('_', 1)[0]} {v:.3g}" for k, v in self.held_out_rms.items())
        return f"StudyStep({self.action}: held out {axes} {self.unit})"

    @property
    def held_out(self) -> float:
        """Held-out RMS of all readings together."""
        values = list(self.held_out_rms.values())
        return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")


@dataclass(frozen=True, eq=False)
class Before:
    """What a change took the place of. The ``step`` that recorded it is not known of a study that was saved."""

    model: ChainModel
    data: Measurements
    step: StudyStep | None = None
    #: What the change was; empty where the study was saved before that was kept.
    action: str = ""
