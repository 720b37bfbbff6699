"""A study: fit, diagnose, add, again; with the history of the error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..base.arguments import Level, NotNegative, Positive, Seed, validate_arguments
from ..base.figures import CALIBRATED, NOMINAL, listed
from ..base.notebook import Shown
from ..base.types import Ints
from ..data import Measurements
from ..data.reader import RunLike
from ..data.stream import joined
from ..data.toml import Table
from ..diagnosis import Diagnosis, diagnose, gross_errors
from ..diagnosis.selection import setting_for
from ..errors import EffectError, MeasurementError, SherkitError
from ..fit.error import of_residuals
from ..fit.hold_out import hold_out
from ..fit.identify import Fit, identify
from ..fit.least_squares import LOSSES
from ..model.base import require_columns
from ..model.chain import ChainModel
from ..model.effect import WITHIN, Effect, Setting, effects_by_name
from ..model.kinds import model_of, robot_from_table
from ..model.robot_file import RobotLike, robot_of, run_for
from ..model.thermometers import with_thermometers
from ..robots.calibrated import Calibration, calibration_class
from ..robots.calibration_run import CalibrationRun
from . import files
from .files import Before, StudyStep

_FOLLOWED = "the run so far"


class Study(Shown):
    """Compares a robot with its measurements, step by step. Both may be given by their files.

    ``effects`` are the user's own, beside the catalogue; ``free`` and ``loss`` are those of
    :func:`~sherkit.fit.identify.identify`. Rows that a diagnosis lists as gross errors are left out of every number
    (:attr:`left_out`), unless ``with_outliers``; :meth:`put_back` takes them in. Every change refits all parameters and
    takes the held-out error anew; :attr:`history` holds each step. Raises :class:`~sherkit.errors.FitError` where the
    rows cannot be fitted.
    """

    @validate_arguments
    def __init__(
        self,
        robot: RobotLike,
        data: RunLike,
        *,
        effects: Sequence[Effect] = (),
        free: Sequence[str] = (),
        loss: str = "linear",
        seed: Seed = 0,
        with_outliers: bool = False,
    ) -> None:
        self.robot = robot_of(robot)
        self.model = model_of(self.robot, free)
        self.data = self.model.as_declared(run_for(robot, data))
        self.seed = seed
        self.loss = loss
        self.own: dict[str, Effect] = {}
        self.history: list[StudyStep] = []
        self._undone: list[Before] = []
        self._redone: list[Before] = []
        self._diagnosis: Diagnosis | None = None
        for effect in effects:
            self._register(effect)
        #: Rows that were judged to be gross errors; those of them that are not marked were put back.
        self._judged: Ints = np.zeros(0, dtype=np.int64)
        self._with_outliers = with_outliers
        self._record(CALIBRATED)
        self._leave_out(gross_errors(self._fit, tuple(self.own.values()), keep=self._put_back))

    @property
    def fit(self) -> Fit:
        """The current fit."""
        return self._fit

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects in the model."""
        return tuple(e.name for e in self.model.effects)

    @property
    def left_out(self) -> Ints:
        """Rows (k,), by number from 0, that are left out as gross errors."""
        return self._judged[self.data.outlier[self._judged]]

    @property
    def _put_back(self) -> list[int]:
        if self._with_outliers:
            return list(range(len(self.data)))
        return self._judged[~self.data.outlier[self._judged]].tolist()

    def _leave_out(self, rows: Ints) -> bool:
        """Leaves these rows out of the step that is taken, and takes in what was judged before and is right; whether
        that changes anything."""
        judged = self._with_outliers_at(rows)
        self._judged = np.union1d(self._judged[~self.data.outlier[self._judged]], rows)
        if np.array_equal(judged.outlier, self.data.outlier):
            return False
        before, action = self.data, self.history.pop().action
        self.data = judged
        try:
            self._record(action)
        except SherkitError:
            # the rows that are left cannot be fitted
            self.data = before
            self._record(action)
        return True

    def _with_outliers_at(self, rows: Ints) -> Measurements:
        """The rows as they would be if these were judged, and no others."""
        marked = self.data.outlier.copy()
        marked[self.left_out] = False
        marked[rows] = True
        return replace(self.data, outlier=marked)

    def _record(self, action: str) -> StudyStep:
        return self._take(*self._looked_at(self.model, action))

    def _looked_at(self, model: ChainModel, action: str) -> tuple[StudyStep, Fit]:
        """What a model leaves of the rows of today, and its fit."""
        fit = identify(model, self.data, loss=self.loss)
        step = StudyStep(
            action=action,
            effects=tuple(e.name for e in model.effects),
            fitted=of_residuals(self.data, fit.residuals, held_out=False),
            error=fit.error_by(self.seed),
            parameters={p.name: value for p, value in zip(fit.parameters, fit.values.tolist(), strict=True)},
            rows=len(self.data),
            fit=fit,
        )
        return step, fit

    def _take(self, step: StudyStep, fit: Fit) -> StudyStep:
        """Makes a step the last one of the history, and its fit the current one."""
        self.history.append(step)
        self._fit = fit
        self._diagnosis = None
        return step

    def _change(self, model: ChainModel, data: Measurements, action: str) -> StudyStep:
        before = Before(self.model, self.data, self.history[-1], action)
        self.model, self.data = model, data
        try:
            step = self._record(action)
        except SherkitError:
            self.model, self.data = before.model, before.data
            raise
        self._undone.append(before)
        self._redone.clear()
        return step

    @validate_arguments
    def diagnose(self, *, level: Level = 0.01, step: Callable[[str], None] = lambda _: None) -> Diagnosis:
        """What is missing now. The answer is kept until something changes."""
        if self._diagnosis is None or self._diagnosis.level != level:
            found = diagnose(
                self._with_all(), effects=tuple(self.own.values()), level=level, keep=self._put_back, seed=self.seed,
                step=step,
            )  # fmt: skip
            # what is left out is one decision: the rows of the answer are those of the study
            self._leave_out(found.outliers)
            self._diagnosis = found
        return self._diagnosis

    def _with_all(self) -> Fit:
        """The fit of all rows but those that a person marked: what is wrong is judged anew."""
        if not len(self.left_out):
            return self._fit
        return identify(self.model, self._with_outliers_at(self.left_out[:0]), loss=self.loss)

    @validate_arguments
    def add(
        self,
        effect: str | Effect,
        *,
        period_mm: Positive | Sequence[Positive] | None = None,
        period_rad: Positive | Sequence[Positive] | None = None,
        slip_time_s: float | None = None,
        lag_s: NotNegative | None = None,
    ) -> StudyStep:
        """Adds an effect by name, or a user's own, and refits.

        The time of a slip, the period of a cyclic error and the lag of a stand are searched for where they are not
        given; the period that the model has stays unless another is clearly better. A period is one number, or one for
        each joint. Raises :class:`~sherkit.errors.EffectError` for an unknown or doubled effect, one whose columns the
        rows lack, and as many periods as there are no joints.
        """
        if isinstance(effect, Effect):
            self._register(effect)
            chosen = effect
        else:
            known = {**self.model.known_effects, **self.model.held}
            (chosen,) = effects_by_name(known, (effect,), with_thermometers(self.own, self.model, self.data))
        if chosen.name in self.effects or chosen.name in WITHIN:
            raise EffectError(f"'{chosen.name}' is in the model already")
        require_columns(chosen, self.data)
        given = {"time_s": slip_time_s, "period_mm": period_mm, "period_rad": period_rad, "lag_s": lag_s}
        wanted = given.get(chosen.search or "")
        at: Setting | None = tuple(wanted) if isinstance(wanted, Sequence) else wanted
        if at is None:
            at = setting_for(self.fit, chosen)
        action = chosen.name if chosen.frees else f"+ {chosen.name}"
        return self._change(self.model.adopting(chosen, at=at), self.data, action)

    @validate_arguments
    def remove(self, name: str) -> StudyStep:
        """Takes an effect out and refits. Raises :class:`~sherkit.errors.EffectError` where it is not in the model."""
        return self._change(self._model_without(name), self.data, f"− {name}")

    def without(self, name: str) -> StudyStep:
        """What the rest of the model would leave without one of its effects; the study stays as it is.

        Raises :class:`~sherkit.errors.EffectError` where the effect is not in the model.
        """
        return self._looked_at(self._model_without(name), f"without {name}")[0]

    def _model_without(self, name: str) -> ChainModel:
        if name not in self.effects:
            raise EffectError(f"'{name}' is not in the model; it has {listed(self.effects) or 'no effects'}")
        return self.model.without_effect(name)

    @property
    def can_undo(self) -> bool:
        """Whether there is a change to take back."""
        return bool(self._undone)

    @property
    def undoes(self) -> str:
        """What :meth:`undo` would take back, in words; empty where there is nothing."""
        return (self._undone[-1].action or "the last change") if self._undone else ""

    @property
    def redoes(self) -> str:
        """What :meth:`redo` would make again, in words; empty where there is nothing."""
        return self._redone[-1].action if self._redone else ""

    def undo(self) -> StudyStep:
        """Takes the last change back. Raises :class:`~sherkit.errors.EffectError` where there is none."""
        if not self._undone:
            raise EffectError("there is nothing to undo")
        return self._return_to(self._undone, self._redone, self.undoes, "undone")

    def redo(self) -> StudyStep:
        """Makes the change again that was taken back last, until something else is changed or the study is saved and
        read. Raises :class:`~sherkit.errors.EffectError` where there is none."""
        if not self._redone:
            raise EffectError("there is nothing to do again")
        return self._return_to(self._redone, self._undone, self.redoes, "redone")

    def _return_to(self, there: list[Before], back: list[Before], action: str, done: str) -> StudyStep:
        """Takes the state that lies ``there`` last, from which ``back`` leads to that of now."""
        state, said = there.pop(), f"{done}: {action}"
        back.append(Before(self.model, self.data, self.history[-1], action))
        self.model, self.data = state.model, state.data
        if state.step is None or state.step.fit is None:
            return self._record(said)
        return self._take(replace(state.step, action=said), state.step.fit)

    @validate_arguments
    def extend(self, more: RunLike) -> StudyStep:
        """Joins new measurements, a file or a frame of them, to the study and refits: :func:`joined`."""
        more = run_for(self.robot, more)
        step = self._change(self.model, joined(self.data, more), f"{len(more)} rows joined")
        wrong = gross_errors(self._with_all(), tuple(self.own.values()), keep=self._put_back)
        return self.history[-1] if self._leave_out(wrong) else step

    @validate_arguments
    def mark_outliers(self, rows: Sequence[int] | Ints) -> StudyStep:
        """Marks rows (by number from 0) as outliers: kept, listed, not fitted.

        Raises :class:`~sherkit.errors.MeasurementError` for a row that is not there.
        """
        which = self._rows(rows)
        self._judged = np.setdiff1d(self._judged, which)
        return self._change(self.model, self.data.mark_outliers(which), f"{len(which)} rows marked as outliers")

    @validate_arguments
    def put_back(self, rows: Sequence[int] | Ints | None = None) -> StudyStep:
        """Takes rows (by number from 0) in that are left out, all that are :attr:`left_out` unless they are given: no
        diagnosis leaves them out again.

        Raises :class:`~sherkit.errors.MeasurementError` for a row that is not left out.
        """
        which = self.left_out if rows is None else self._rows(rows)
        if not len(which):
            marked = np.flatnonzero(self.data.outlier).tolist()
            by_number = f"; those that were marked are put back by number: put_back({marked})" if marked else ""
            raise MeasurementError(f"{self.data.source}: no row is left out as a gross error{by_number}")
        if not self.data.outlier[which].all():
            there = self.data.line[which[~self.data.outlier[which]]]
            raise MeasurementError(f"{self.data.source}: {self.data.counted} {listed(there)} is not left out")
        taken = self.data.outlier.copy()
        taken[which] = False
        before, self._judged = self._judged, np.union1d(self._judged, which)
        try:
            return self._change(self.model, replace(self.data, outlier=taken), f"{len(which)} rows put back")
        except SherkitError:
            self._judged = before
            raise

    def _rows(self, rows: Sequence[int] | Ints) -> Ints:
        which = np.unique(np.ravel(rows if isinstance(rows, np.ndarray) else list(rows)).astype(np.int64))
        absent = which[(which < 0) | (which >= len(self.data))]
        if len(absent):
            raise MeasurementError(
                f"{self.data.source}: there is no row {listed(absent)}; rows are counted from 0 to {len(self.data) - 1}"
            )
        return which

    @validate_arguments
    def follow(self, data: Measurements) -> StudyStep:
        """Takes the same run with the rows that were added to it since, keeps the marks, and refits.

        Steps that follow one another make one step of the history. Raises
        :class:`~sherkit.errors.MeasurementError` where the rows so far are not the first ones of ``data``.
        """
        known = len(self.data)
        both = (data.joints, self.data.joints), (data.readings, self.data.readings)
        if not all(np.array_equal(now[:known], before) for now, before in both):
            raise MeasurementError(f"{data.source}: its first {known} rows are no longer those that were read before")
        marked = data.mark_outliers(np.flatnonzero(self.data.outlier))
        if self.history[-1].action.startswith(_FOLLOWED):
            before = self.history.pop()
            self.data = marked
            try:
                return self._record(f"{_FOLLOWED}: {len(data)} rows")
            except SherkitError:
                self.history.append(before)
                raise
        return self._change(self.model, marked, f"{_FOLLOWED}: {len(data)} rows")

    @property
    def deployable(self) -> bool:
        """Whether robots of this kind have calibrations."""
        return calibration_class(self.robot) is not Calibration

    def calibration(self) -> Calibration:
        """The model to deploy: what was identified, and a correction where the robot has one and it helps on held-out
        blocks. Raises :class:`~sherkit.errors.CalibrationError` where its kind has no calibration."""
        made = calibration_class(self.robot)
        made.require(self.robot)
        held = hold_out(self.model, self.data, seed=self.seed, loss=self.loss, start=self.fit.values)
        correction = made.correct(self.fit, seed=self.seed) if made.may_correct(self.fit) else None
        region = made.in_region(self.fit)
        return made.from_runs(CalibrationRun(self.fit, held.residuals, correction, region, self.left_out, held.block))

    @validate_arguments
    def register(self, effect: Effect) -> None:
        """Makes a user's effect one that diagnosis tries and :meth:`add` knows by name; a newer one replaces it.

        Raises :class:`~sherkit.errors.EffectError` for one that is none, or whose namesake is in the model.
        """
        if effect.name in self.effects:
            raise EffectError(f"'{effect.name}' is in the model; remove it before you change it")
        self._register(effect)
        self._diagnosis = None

    def _register(self, effect: Effect) -> None:
        plain = model_of(self.robot)
        plain.check_effect(effect, self.data, np.zeros(len(plain.parameters)))
        self.own[effect.name] = effect

    @validate_arguments
    def save(self, folder: str | Path) -> None:
        """Writes robot, rows and steps into a folder that :meth:`load` reads back without loss: all of it or nothing.

        Whatever else is in the folder stays. Raises :class:`~sherkit.errors.NotWritten`, and
        :class:`~sherkit.errors.SherkitError` where the folder's ``study.json`` is another program's.
        """
        state = {
            "robot": self.robot.to_tables(),
            **files.model_state(self.model),
            "undo": [files.before_state(one) for one in self._undone],
            "judged": self._judged.tolist(),
            "with_outliers": self._with_outliers,
            "seed": self.seed,
            "loss": self.loss,
            "history": [files.step_state(one) for one in self.history],
        }
        files.write_study(Path(folder), state, self.data)

    @classmethod
    @validate_arguments
    def load(cls, folder: str | Path, *, effects: Sequence[Effect] = ()) -> Study:
        """Reads a study, with what can be undone. User effects must be given again; no code is loaded from the folder.

        Raises :class:`~sherkit.errors.EffectError` where one is missing, :class:`~sherkit.errors.SherkitError` naming
        file and key for what is no study."""
        state = files.read_state(folder := Path(folder))
        study = cls.__new__(cls)
        with state.table("robot") as r:
            study.robot = robot_from_table(r)
        study.seed, study.loss = state.whole("seed", least=0), state.text("loss", LOSSES)
        study.data = files.read_rows(folder, state)
        study.own, study._undone, study._redone, study._diagnosis = {}, [], [], None
        study._with_outliers = state.flag("with_outliers", False)
        judged = np.array(state.wholes("judged"), dtype=np.int64)
        study._judged = judged[(judged >= 0) & (judged < len(study.data))]
        for effect in effects:
            study._register(effect)
        study.model = study._model_from(state)
        study.data = study.model.as_declared(study.data)
        for undone in state.tables("undo"):
            before = files.rows_from(undone, study.data)
            action = undone.words("action", empty=True) if undone.has("action") else ""
            try:
                study._undone.append(Before(study._model_from(undone), before, action=action))
            except EffectError:  # an effect of the user's that is no longer given: what lies before it is out of reach
                study._undone.clear()
        study._fit = identify(study.model, study.data, loss=study.loss)
        steps = map(files.step_from, state.tables("history", optional=False))
        study.history = [replace(step, fit=study._fit_of(step)) for step in steps]
        if not study.history:
            raise state.fail("history", "at least one step")
        state.finish()
        return study

    def _model_from(self, state: Table) -> ChainModel:
        return files.model_from(state, self.robot, with_thermometers(self.own, model_of(self.robot), self.data))

    def _fit_of(self, step: StudyStep) -> Fit | None:
        """The fit of an earlier step, where the rows of today give what it left."""
        try:
            own = with_thermometers(self.own, self.model, self.data)
            effects = effects_by_name(self.model.known_effects, step.effects, own)
        except EffectError:  # an effect of the user's that is no longer given
            return None
        fit = identify(replace(self.model, effects=effects), self.data, loss=self.loss)
        rms, left = fit.rms(), step.fitted.by_reading
        same = rms.keys() == left.keys() and np.allclose(list(rms.values()), [left[k] for k in rms], rtol=1e-9)
        return fit if same else None

    def __repr__(self) -> str:
        lines = [f"Study of {self.data.source}: {len(self.data)} rows", f"  {NOMINAL:<24} {self._fit.nominal_error}"]
        lines += [f"  {s.action:<24} {s.error}" for s in self.history]
        if len(wrong := self.left_out):
            told = f"{self.data.counted}{'s' if len(wrong) > 1 else ''} {listed(self.data.line[wrong], 20)}"
            lines.append(f"  left out as gross errors: {told}; put_back() takes them in")
        return "\n".join(lines)
