"""The answers of a diagnosis, in the order a person asks, and how they are printed for people and for programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..base.answer import AFTER, BEFORE, NOISE, TARGET, Answer, Bar, ToDo
from ..base.figures import finite, in_column, in_names, state_with
from ..base.notebook import Shown
from ..base.types import Ints
from ..fit.error import ErrorSize
from ..fit.forms import SimplestForm, known
from ..fit.identify import Fit
from ..fit.regions import Elsewhere
from ..model.kinds import required_um
from .sensor_pose import called
from .where import Dependence

# -- What a verdict rests on: checks, each made on numbers that the same report shows ------------------------------

#: Checks of which the first line speaks though nothing is decided by them.
AS_DRAWN, DIGITS, DECLARED = "as_drawn", "digits", "noise_as_declared"
#: The check that rows that are wrong lie as accidents do.
FEW, SINGLY = "gross_errors", "apart"
#: What comes next where the verdict has already said that the model holds.
ADD_IT = "add it"
NOTHING = "nothing; go on with the model as it is"
#: The check that repeats differ by noise alone.
REPEATS = "repeats_are_noise"
#: The check that tests lack of fit.
POSES_AS_REPEATS = "poses_as_repeats"
#: The check that a sensor stands where it is known to.
STANDS = "stands_as_known"
#: The checks that compare rows held out with the noise, and with what few poses make of it.
SMALL, LOOSE = "as_small_as_noise", "poses_suffice"
#: The checks that the poses are no line, and that the fit came to rest; where these alone fail, or that the poses
#: suffice, nothing is decided.
PLACES, SETTLED = "poses_tell", "converged"
_UNDECIDED = {LOOSE, PLACES, SETTLED}
#: Checks without which the drawing is not judged.
_MOVES = {"set_up", "plausible", PLACES}
#: Reasons that the first line gives; the checks have all.
_MOST = 2


@dataclass(frozen=True)
class Check:
    """One statement and how its test came out.

    ``tested`` is the statement, ``rows`` on which rows, ``result`` what was found, both in words. ``holds`` is None
    where these rows cannot test it; ``p`` the p value where the test has one. A verdict of praise needs all that are
    ``decisive``; ``fails`` is then how the first line says that one does not hold.
    """

    name: str
    tested: str
    rows: str
    result: str
    holds: bool | None
    p: float | None = None
    decisive: bool = True
    fails: str = ""

    @property
    def forbids_praise(self) -> bool:
        """Whether it decides, and does not hold."""
        return self.decisive and self.holds is False

    def __str__(self) -> str:
        word = {True: "yes", False: "no", None: "cannot be told"}[self.holds]
        p = "" if self.p is None else f" (p = {self.p:.2g})"
        return f"{self.tested}: {word}, {self.result}{p}; tested on {self.rows}"

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "name": self.name, "tested": self.tested, "rows": self.rows, "result": self.result,
            "holds": self.holds, "p_value": self.p, "decisive": self.decisive,
        }  # fmt: skip


def verdict_of(checks: Sequence[Check], effects: Sequence[str]) -> str:
    """The verdict, from checks alone: of praise only where no decisive one fails, of blame only where another fails
    than that the poses are enough."""
    failing = {check.name for check in checks if check.forbids_praise}
    if not failing:
        return "explained" if effects else "adequate"
    if effects:
        return "partly explained"
    return "undecided" if failing <= _UNDECIDED else "unexplained"


def headline(checks: Sequence[Check], effects: Sequence[str], not_needed: Sequence[str], *, noise_known: bool) -> str:
    """The verdict in one line: never more praise than the noise allows, and why not where there is none."""
    verdict = verdict_of(checks, effects)
    failing = [check.fails for check in checks if check.forbids_praise and check.fails]
    named = called(effects)
    if verdict == "adequate":
        line = "adequate: no effect is missing" if noise_known else (
            "nothing with structure is missing; how much of the rest is noise is not known"
        )  # fmt: skip
    elif verdict == "explained":
        line = f"explained: {named}"
        if not noise_known:
            line += "; nothing with structure is left, how much of the rest is noise is not known"
    else:
        line = f"{verdict}: {named or ('no effect shows' if verdict == 'undecided' else 'no effect added')}"
        if failing:
            line += "; " + "; ".join(failing[:_MOST])
    # a wrong column, or an absurd number, moves the drawing as well
    wrong = {check.name for check in checks if check.holds is False}
    spoken = {DIGITS, DECLARED} | ({AS_DRAWN} if not wrong & _MOVES else set())
    line += "".join(
        f"; but {check.fails}" for check in checks if check.name in wrong & spoken and check.fails not in line
    )
    if not_needed:
        verb = "is" if len(not_needed) == 1 else "are"
        line += f"; but {' and '.join(not_needed)}, in the model already, {verb} not needed"
    return line


# -- One answer, as plain values -----------------------------------------------------------------------------------

#: The questions, in the order in which a person asks.
WRONG, MISSING, WHERE, WHICH, APART, NEXT = QUESTIONS = (
    "What is wrong?", "Is anything missing?", "Where?", "Which effect?", "What can these data not tell apart?",
    "What next?",
)  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One answer to one of the :data:`QUESTIONS`.

    ``about`` says what of: cause, brings, elsewhere, unread, verdict; missing, noise, note, left_out; where; step,
    shape; tie, confounded, sensor_pose, untestable, nothing; next. ``answer`` is a sentence or a part of one;
    ``numbers`` are by name with their unit; ``sure`` says how sure its first sentence is; ``rows`` are the lines of the
    rows it speaks of; ``to_do`` what a person can do; ``command`` is what does that, with :data:`FILES` where the files
    stand that were given.
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
        if not self.answer.endswith("."):
            return f"{self.answer}: {self.sure}"
        first, dot, others = self.answer.partition(". ")
        return f"{first.removesuffix('.')} ({self.sure}).{dot[1:]}{others}"

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "question": self.question, "about": self.about, "answer": self.answer, "numbers": dict(self.numbers),
            "sure": self.sure, "rows": list(self.rows), "to_do": self.to_do,
            "command": self.command,
        }  # fmt: skip


# -- A diagnosis in words and numbers alone -------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Summary:
    """What a diagnosis says of a run, without its rows.

    ``before`` and ``after`` are errors (RMS of rows held out, in 3-D for what is read in space) in ``unit`` without
    and with the ``effects`` that were found missing; ``noise`` is counted as they are, by ``noise_origin``.
    ``p_missing`` is that of the one test over all effects and shapes before anything is added, ``p_lack_of_fit`` that
    of poses against their repeats with what was found in the model, None where too few were repeated; ``p_confirmed``
    the largest with which an effect earns its place on rows held out, None where none is named.
    """

    rows: int = 0
    verdict: str = ""
    effects: tuple[str, ...] = ()
    not_needed: tuple[str, ...] = ()
    unit: str = ""
    before: float | None = None
    after: float | None = None
    noise: float | None = None
    noise_origin: str = ""
    p_missing: float | None = None
    p_lack_of_fit: float | None = None
    p_confirmed: float | None = None
    outliers: int = 0

    def row(self) -> dict[str, str | int | float | None]:
        """One flat dict with the unit in each name (``after_um`` for µm), names of effects in one text, and ``ratio``:
        the error after over that before."""
        end = f"_{in_names(self.unit)}"
        return {
            "rows": self.rows,
            "verdict": self.verdict,
            "effects": ", ".join(self.effects),
            "not_needed": ", ".join(self.not_needed),
            f"before{end}": self.before,
            f"after{end}": self.after,
            "ratio": self.after / self.before if self.after is not None and self.before else None,
            f"noise{end}": self.noise,
            "noise_origin": self.noise_origin,
            "p_missing": self.p_missing,
            "p_lack_of_fit": self.p_lack_of_fit,
            "p_confirmed": self.p_confirmed,
            "outliers": self.outliers,
        }


# -- The diagnosis ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class CandidateReport:
    """One effect as an addition to the fit: what it would bring and whether that can be believed.

    ``held_out_std`` is the standard error of ``held_out_rms``, from how much the blocks held out differ; it is
    ``plausible`` where its largest parameter has at most three plausible sizes, give or take two deviations.
    """

    effect: str
    link: str
    held_out_rms: float
    held_out_std: float
    p_value: float
    plausible: bool
    parameters: tuple[dict[str, Any], ...]

    @property
    def largest(self) -> dict[str, Any]:
        """The parameter that is farthest beyond its plausible size."""
        return max(self.parameters, key=_times)

    @property
    def times(self) -> float:
        """How many plausible sizes that is."""
        return _times(self.largest) if self.parameters else 0.0


def _times(parameter: Mapping[str, Any]) -> float:
    return float(abs(parameter["value"]) / parameter["size"])


@dataclass(frozen=True)
class StepReport:
    """One step of the fall: the effect added (None: nothing yet) and the error that held."""

    effect: str | None
    error: ErrorSize
    #: Effects that were in the model before any was looked for.
    inside: tuple[str, ...] = ()

    @property
    def state(self) -> str:
        """What the model is called then: as what was there already, or by what is new."""
        return state_with(self.inside if self.effect is None else [self.effect])


@dataclass(frozen=True, eq=False)
class Diagnosis(Shown):
    """The answers, in the order a person asks.

    ``verdict`` is ``adequate``, ``explained``, ``partly explained``, ``unexplained`` or ``undecided``, where the poses
    are too few to tell: it follows from ``checks`` alone. ``effects`` are those that are missing, ``not_needed`` those
    in the model that bring nothing; ``caveat`` says what one unknown would look like where many numbers explain, and
    which size is implausible. ``indistinguishable`` are groups of effects that these rows cannot tell apart, the
    leading one first; ``confirmed`` is the largest p with which a named effect earns its place on rows held out.
    ``taken_by_pose`` says of each effect how many of its directions, of how many, only
    the free pose of the sensor takes up. ``next_poses`` are joints to drive to and the coordinates that these are, in
    the order to measure them, each with the separation in standard deviations that run and poses up to it reach;
    ``advice`` says what no reachable pose tells, and what would. ``fit`` is the model with the named effects on all
    rows. Errors are those of rows, in 3-D for what is read in space (:class:`~sherkit.fit.error.ErrorSize`), in
    ``unit``: µm for a delta; ``noise`` is that of single readings.
    """

    verdict: str
    unit: str
    noise: dict[str, float]
    noise_origin: str
    correlation_in_time: float
    level: float
    p_missing: float
    effects: tuple[str, ...]
    not_needed: tuple[str, ...]
    checks: tuple[Check, ...]
    caveat: str | None
    indistinguishable: tuple[tuple[str, ...], ...]
    steps: tuple[StepReport, ...]
    candidates: tuple[CandidateReport, ...]
    untestable: dict[str, str]
    smallest_found: dict[str, tuple[float, float]]
    where: tuple[Dependence, ...]
    neighbour_correlation: float
    confirmed: float | None
    signature: dict[str, Any] | None
    confounded_with: dict[str, tuple[str, ...]]
    taken_by_pose: dict[str, tuple[int, int]]
    outliers: Ints
    next_poses: tuple[dict[str, float], ...]
    advice: str
    notes: tuple[str, ...]
    fit: Fit = field(repr=False)
    base: Fit = field(repr=False)
    #: All that it says, in the order in which a person asks; what screens and papers show is this list.
    findings: tuple[Finding, ...] = ()
    #: Errors in whole regions that were left out; None where poses are too few for that, or no joint moves.
    elsewhere: Elsewhere | None = None

    @property
    def headline(self) -> str:
        """The verdict in one line, with why it is no better."""
        line = headline(self.checks, self.effects, self.not_needed, noise_known=self.noise_origin != "unknown")
        return f"{line}; with a caveat: {self.caveat}" if self.caveat else line

    @property
    def error(self) -> ErrorSize:
        """What the model with the named effects leaves on poses held out."""
        return self.steps[-1].error

    @property
    def too_few_poses(self) -> bool:
        """Whether nothing stands against praise but that the poses fix the parameters too loosely."""
        return {check.name for check in self.checks if check.forbids_praise} == {LOOSE}

    @property
    def noise_size(self) -> float:
        """The noise as the error is counted: of all that is read of a row together."""
        return float(np.linalg.norm(list(self.noise.values())))

    @cached_property
    def known(self) -> dict[str, SimplestForm]:
        """What is really known of the effects in :attr:`fit` that have a number for each limb, by name."""
        return known(self.fit)

    @cached_property
    def summary(self) -> Summary:
        """What it says in words and numbers alone, without rows or fits."""
        return Summary(
            rows=len(self.fit.data),
            verdict=self.verdict,
            effects=self.effects,
            not_needed=self.not_needed,
            unit=self.unit,
            before=float(self.steps[0].error.rms),
            after=float(self.error.rms),
            noise=self.noise_size,
            noise_origin=self.noise_origin,
            p_missing=self.p_missing,
            p_lack_of_fit=next((check.p for check in self.checks if check.name == POSES_AS_REPEATS), None),
            p_confirmed=self.confirmed,
            outliers=len(self.outliers),
        )

    def row(self) -> dict[str, str | int | float | None]:
        """One flat dict, for a table over many runs: verdict, effects, errors held out before and after, their ratio, p
        values; keys name their units. See :class:`~sherkit.diagnosis.result.Summary`.

            table = pl.DataFrame([sk.diagnose(robot, run).row() for run in runs])
        """
        return self.summary.row()

    def added(self, command: str) -> Diagnosis:
        """The same where what it says to add has been added: what comes next is a command."""
        return replace(self, findings=tuple(
            replace(one, answer="go on with it", command=command) if one.answer == ADD_IT else one
            for one in self.findings
        ))  # fmt: skip

    @cached_property
    def answer(self) -> Answer:
        """The same for whoever reads nothing else: what is missing, what it brings, what to do."""
        told = {one.about: one for one in reversed(self.findings)}
        cause, brings, elsewhere = told["cause"], told.get("brings"), told.get("elsewhere")
        beside = (brings, elsewhere, told.get("unread"))
        to_do = [ToDo((brings or cause).to_do)]
        if elsewhere is not None:
            to_do.append(ToDo(elsewhere.to_do))
        # what the cause itself says is not said once more
        if told["next"].answer != NOTHING and told["next"].answer not in cause.answer:
            to_do.append(ToDo(told["next"].answer, told["next"].command))
        return Answer(
            self.headline, cause.answer, tuple(str(one) for one in beside if one is not None),
            tuple(one for one in to_do if one.sentence), self._bars(), self.unit,
        )  # fmt: skip

    def _bars(self) -> tuple[Bar, ...]:
        """The error before and after, the noise where it is known, and what is needed."""
        needed = required_um(getattr(self.fit.model, "robot", None))
        out = [Bar(BEFORE, self.steps[0].state, float(self.steps[0].error.rms))]
        if len(self.steps) > 1:
            out.append(Bar(AFTER, state_with(self.effects), float(self.error.rms)))
        if self.noise_origin != "unknown":
            out.append(Bar(NOISE, "noise", self.noise_size))
        return (*out, *([Bar(TARGET, "target", needed)] if needed and self.unit == "µm" else []))

    def finding(self, about: str) -> Finding:
        """The first finding about this. Raises ``KeyError`` where there is none."""
        for one in self.findings:
            if one.about == about:
                return one
        raise KeyError(about)

    def __repr__(self) -> str:
        lines = [self.headline]
        lines += [f"  {one.answer}" for one in self.findings if one.about == "tie"]
        for one in self.findings:
            if one.about == "step":
                lines += [
                    f"  {one.answer:<24} {in_column(value)} {self.unit} held out" for value in one.numbers.values()
                ]
        lines.append(f"  {'noise':<24} {in_column(self.noise_size)} {self.unit} ({self.noise_origin})")
        lines += [f"  {'left out':<24} {one.answer}" for one in self.findings if one.about == "left_out"]
        lines += [f"  {one.answer}" for one in self.findings if one.about == "shape"]
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """For programs; see the README. Keys end in ``_um`` where errors are in µm; else ``unit`` says in what."""
        um = "_um" if self.unit == "µm" else ""
        return ({} if um else {"unit": self.unit}) | {
            "verdict": self.verdict,
            "headline": self.headline,
            "findings": [one.to_json() for one in self.findings],
            f"noise{um}": self.noise,
            "noise_origin": self.noise_origin,
            "correlation_in_time": self.correlation_in_time,
            "neighbour_correlation": self.neighbour_correlation,
            "level": self.level,
            "p_missing": self.p_missing,
            "effects": list(self.effects),
            "caveat": self.caveat,
            "not_needed": list(self.not_needed),
            "checks": [check.to_json() for check in self.checks],
            "indistinguishable": [list(t) for t in self.indistinguishable],
            "error": self.error.to_json(),
            "elsewhere": None if self.elsewhere is None else self.elsewhere.to_json(),
            "steps": [{"effect": s.effect, "error": s.error.to_json()} for s in self.steps],
            "candidates": [
                {
                    "effect": c.effect,
                    "link": c.link,
                    f"held_out_rms{um}": c.held_out_rms,
                    f"held_out_std{um}": c.held_out_std,
                    "p_value": c.p_value,
                    "plausible": c.plausible,
                    "plausible_sizes": c.times,
                    "parameters": list(c.parameters),
                }
                for c in self.candidates
            ],
            "known": [one.to_json() for one in self.known.values()],
            "untestable": self.untestable,
            "smallest_found": {
                name: {"plausible_sizes": finite(size), f"rms{um}": finite(rms)}
                for name, (size, rms) in self.smallest_found.items()
            },
            "where": [{"variable": d.variable, f"rms{um}": list(d.rms), "p_value": d.p_value} for d in self.where],
            "confirmed_p_value": self.confirmed,
            "signature": self.signature,
            "confounded_with": {k: list(v) for k, v in self.confounded_with.items()},
            "taken_by_pose": {k: list(v) for k, v in self.taken_by_pose.items()},
            "outliers": self.fit.data.line[self.outliers].tolist(),
            "next_poses": list(self.next_poses),
            "advice": self.advice,
            "notes": list(self.notes),
        }
