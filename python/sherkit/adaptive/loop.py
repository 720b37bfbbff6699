"""The loop: asks for rows, is told what was read, and knows when it is enough."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from ..base.answer import AFTER, BEFORE, FILES, TARGET, Answer, Bar, ToDo
from ..base.figures import odds
from ..data.columns import POSE, REPEAT
from ..diagnosis import Diagnosis
from . import told
from .choice import Batches, next_pose
from .conclusion import Conclusion, conclude
from .held import BatchLooks, Progress, progress
from .vouching import told_of


class Adaptive(BatchLooks):
    """Chooses poses, is told what was read there, and ends when it is known what is missing.

    ``required_um`` is the accuracy that the robot is for (its file's, if left out), ``budget`` the most readings,
    ``span_min`` over how many minutes it is to be judged, ``box`` maps joints or coordinates to (low, high) where less
    than the whole workspace is meant, ``level`` is the chance of an alarm at any look where nothing is missing,
    ``batch`` how many readings lie between two looks. Raises :class:`~sherkit.errors.ExperimentError` for a robot whose
    file does not say how far it may go.

        loop = sk.Adaptive("robot.toml", required_um=20, budget=400, span_min=30)
        while not loop.done:
            loop.tell(measure(loop.ask()))
        print(loop.verdict, loop.effects)

    The rule is in :mod:`~sherkit.adaptive.rule`, the evidence in :mod:`~sherkit.evidence.blocks`. All that it holds
    follows from the rows.
    """

    def _begin_anew(self) -> None:
        super()._begin_anew()
        self._progress: list[Progress] = []
        self._concluded: tuple[int, Conclusion] | None = None

    # -- what it holds -----------------------------------------------------------------------------------

    @property
    def progress(self) -> tuple[Progress, ...]:
        """How far off the models were, look by look, at readings that they were not fitted to yet."""
        looks = self.looks
        for k in range(len(self._progress), len(looks)):
            self._progress.append(progress(looks[k - 1] if k else None, looks[k], self.seed))
        return tuple(self._progress)

    @property
    def done(self) -> bool:
        """Whether it is known, or cannot be, or the budget is spent."""
        return self.conclusion.done

    @property
    def verdict(self) -> str:
        """``adequate``, ``explained``, ``partly explained``, ``unexplained`` or ``undecided``; so far until it is
        done."""
        return self.conclusion.verdict

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects that are missing; the leading ones where others explain as well."""
        return self.conclusion.effects

    @property
    def indistinguishable(self) -> tuple[tuple[str, ...], ...]:
        """Groups of effects that these rows cannot tell apart, the leading one first."""
        return self.conclusion.indistinguishable

    @property
    def why(self) -> str:
        """Why it ended, in a sentence; empty while it goes on."""
        return self.conclusion.why

    @property
    def notes(self) -> tuple[str, ...]:
        """What could not be seen and from which size on it would have been, and what else is to be known."""
        return self.conclusion.notes

    @property
    def accuracy_um(self) -> float | None:
        """How far off the calibrated robot may be anywhere in the region, in 95 of 100 cases; None where it is not
        known yet."""
        return self.conclusion.accuracy_um

    @property
    def diagnosis(self) -> Diagnosis:
        """The diagnosis of all rows, with the verdict of the loop. Raises :class:`~sherkit.errors.FitError` while they
        are too few."""
        return self.conclusion.diagnosis

    def __repr__(self) -> str:
        return f"Adaptive({self.sentence()})"

    def sentence(self) -> str:
        """Where it stands, in one line: readings, verdict so far, the leading three with their evidence."""
        end = self.conclusion
        leading = ", ".join(f"{name} {value / np.log(10.0):+.1f}" for name, value in end.evidence)
        known = f", within {end.accuracy_um:.3g} µm" if end.accuracy_um is not None else ""
        chance = odds(0.0 if self.last is None else self.last.log_evidence / float(np.log(10.0)))
        new = self.progress[-1] if len(self._looks) > 1 else None
        off = ""
        if new is not None and np.isfinite(new.by_lead):
            unit, led = self.layout.unit, new.by_lead < new.by_geometry
            without = f" ({new.by_geometry:.3g} {unit} by the geometry alone)" if led else ""
            off = f"; off by {new.by_lead:.3g} {unit} at the readings since the look before{without}"
        off += "".join(f"; {one}" for one in self._first)
        return (
            f"{self.readings} readings: {self.verdict}{known}; the odds that something is missing are {chance}; "
            f"leading (powers of ten): {leading or 'nothing yet'}{off}"
        )

    @property
    def _first(self) -> tuple[str, ...]:
        """What is to be looked at, said before all else."""
        apart = told_of(self.last) if self.last is not None else ""
        return tuple(one for one in (*self.stuck, *self.against[:1], self.blind, apart) if one)

    def told(self) -> tuple[str, ...]:
        """What it found, in sentences for people."""
        end = self.conclusion
        named = ", ".join(end.effects)
        out = [f"{end.verdict}{f': {named}' if named else ''}"]
        out += [f"these readings cannot tell {' from '.join(tie)}" for tie in end.indistinguishable]
        if end.accuracy_um is not None:
            needed = "" if self.required_um is None else f" ({self.required_um:g} µm needed)"
            out.append(
                f"calibrated, it is within {end.accuracy_um:.3g} µm anywhere in the region, in 95 of 100 cases{needed}"
            )
        return (*out, *end.notes)

    @property
    def answer(self) -> Answer:
        """What it says for whoever reads nothing else, while it goes on too."""
        end, said = self.conclusion, list(self.told())
        needed = () if self.required_um is None else (Bar(TARGET, "target", self.required_um),)
        within = () if end.accuracy_um is None else (Bar(AFTER, "anywhere, 95 of 100", end.accuracy_um),)
        new = self.progress[-1] if len(self._looks) > 1 else None
        off = () if new is None or not np.isfinite(new.by_geometry) or self.layout.unit != "µm" else (
            Bar(BEFORE, "new readings, geometry alone", float(new.by_geometry)),
        )  # fmt: skip
        to_do = ToDo("") if self.done else ToDo(self.next_in_words)
        if self.done and end.verdict == "explained":
            named = " ".join(f"--effect {name}" for name in end.effects)
            to_do = ToDo("take the rows out, and calibrate", f"sherkit calibrate {FILES} {named} -o calibrated.toml")
        verdict = said[0] if self.done else f"{self.readings} readings, {said[0]} so far"
        return Answer(
            verdict, self.why, tuple(said[1:]), (to_do,) if to_do.sentence else (), (*off, *within, *needed), "µm"
        )  # fmt: skip

    @property
    def next_in_words(self) -> str:
        """Why the next poses are driven."""
        asked = Counter(row["reason"] for row in self.ask())
        return "next: " + ", ".join(f"{count} × {reason}" for reason, count in asked.items())

    @property
    def conclusion(self) -> Conclusion:
        """All of the above, made once for the rows that there are."""
        if self._concluded is None or self._concluded[0] != self.readings:
            self._concluded = (self.readings, conclude(self))
        return self._concluded[1]

    # -- asking ------------------------------------------------------------------------------------------

    def ask(self) -> list[dict[str, Any]]:
        """The rows to read next, in this order: ``pose`` and ``repeat``, the joints as a run file names them, where
        they lead, the ``reason``, and ``not_before_s``, the run's clock before which a row should not be read (0 where
        that does not matter). Empty once it is done."""
        if self.done:
            return []
        boundary = self._boundary
        if self._asked_at != boundary:
            self._asked, self._asked_at = self._planned(boundary), boundary
        known = set(told.poses(self.frame))
        missing = boundary - self.readings
        # what is read may be written into the rows themselves
        left = [dict(one) for one in self._asked if (one[POSE], one[REPEAT]) not in known]
        return left[:missing] if len(left) >= missing else [*left, *self._more(missing - len(left), boundary)]

    def _planned(self, boundary: int) -> list[dict[str, Any]]:
        rng = np.random.default_rng([self.seed, boundary])
        taken = told.poses(self.frame)
        if not self._looked:
            return Batches(self).first(boundary, taken, rng)
        count = boundary - self._looked
        if self.last is None or self.blind:
            # nothing is known that could choose: what was read may come right again
            return Batches(self).anywhere(count, next_pose(taken), rng)
        return Batches(self).chosen(self.last, self.state, count, boundary, taken, self.data, rng)

    def _more(self, count: int, boundary: int) -> list[dict[str, Any]]:
        """Rows anywhere in place of those that came back as others than were asked."""
        rng = np.random.default_rng([self.seed, boundary, self.readings])
        first = next_pose([*told.poses(self.frame), *((one[POSE], one[REPEAT]) for one in self._asked)])
        return Batches(self).anywhere(count, first, rng)
