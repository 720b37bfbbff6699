"""The checks that every verdict is derived from, made on the final fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..base.figures import listed, number
from ..base.types import Floats
from ..data.columns import TIME, bare
from ..data.doubts import DataWarning
from ..evidence.base import Base, OwnErrors, chance_of
from ..evidence.fitted_run import FittedRun
from ..evidence.plausible import farthest_parameter, times_plausible
from ..evidence.thresholds import LOUDER, PLAUSIBLE
from ..fit.constant_columns import frozen
from ..fit.identify import ABSURD
from ..fit.known_stand import known_stand
from ..fit.set_up import Mistake
from .held_out import Elimination, HeldOutGain
from .repeats import CONTRADICTS, Repeats, Rounded, rounded
from .result import (  # fmt: skip
    AS_DRAWN,
    DECLARED,
    DIGITS,
    LOOSE,
    PLACES,
    POSES_AS_REPEATS,
    REPEATS,
    SETTLED,
    SMALL,
    STANDS,
    Check,
)
from .selection import NamedEffects
from .sensor_pose import stands_with
from .where import SlowDrift


def checks_of(
    final: FittedRun,
    found: NamedEffects,
    sigma: Floats,
    origin: str,
    needed: Sequence[HeldOutGain],
    level: float,
    wrong: Sequence[Check],
    mistakes: Sequence[Mistake],
    table: Sequence[DataWarning],
    digits: Rounded | None,
    slow_drift: SlowDrift | None,
    repeats: Repeats | None,
    contradicted: Mapping[str, tuple[float, float]],
    by_noise: Callable[[], float],
    enough: Callable[[], Elimination | None],
) -> tuple[Check, ...]:
    """Every check about a final fit, those that decide first.

    ``sigma`` (columns,) is the noise, ``needed`` what the
    effects that were in the model earn, ``wrong`` what is asked of the rows left out, ``mistakes`` those of the
    set-up, ``table`` what its poses cannot tell, ``digits`` what steps of columns leave where that is most,
    ``slow_drift`` what is left in the course of time, ``repeats`` what repeats of a pose hold, ``contradicted`` by
    axis the noise that was declared and the one that repeats show; ``by_noise`` gives what noise alone leaves on
    rows held out of these poses, in noises, and ``enough`` the parameters that are enough there.
    """
    unit, used = final.unit, f"all {int(final.whole.sum())} rows that are used"
    out = [_set_up(mistakes, final), *_table(table, final), _converged(final, used), _plausible(final, used)]
    out += [_as_drawn(final, used), *wrong]
    p = chance_of(found.missing)
    own = _own_errors(found.base)
    off = own is not None and chance_of(own.evidence) <= level
    left = Check(
        "nothing_left", "no effect and no shape takes anything from what is left", used,
        "by the weighted mean of the Bayes factors of all effects and shapes",
        holds=p > level and not found.structure, p=p,
        fails=f"what is left has a structure{_in_time(found)}{frozen(final.data)}{found.unwitnessed}",
    )  # fmt: skip
    error = found.steps[-1].error.rms
    small = _small(final, error, sigma, origin, by_noise)
    fails = not left.holds or small.holds is False or off
    known = origin != "unknown"
    # few poses predict worse than they were read: what is their own tells more
    beyond = _size(final, own) if own else float(np.sqrt(max(error**2 - known * _noise(final, sigma) ** 2, 0.0)))
    steps = digits or (rounded(final, beyond, sigma, noise_known=known) if fails else None)
    if steps is not None and own is not None and not steps.joints and steps.size >= _size(final, own):
        # repeats agree on a part of what rounding leaves
        off = False
    poses = _poses(final, own, off, slow_drift, followed=found.structure or steps is not None)
    if found.structure and found.left.shapes:
        poses = replace(poses, fails=_beside_shapes(final, _own_errors(found.left.base), level))
    out += [left, poses, small]
    out += _stands(final, used)
    if (loose := _loosely(final, small, error, sigma, enough)) is not None:
        out.append(loose)
    out.append(_digits(steps, used, asked=fails, alone=digits is not None))
    out.append(_repeats(repeats))
    out.append(_as_declared(final, contradicted, origin))
    out.append(_steady(final, slow_drift, used))
    for one in found.gains:
        out.append(
            Check(
                f"earns:{one.effect}", f"{one.effect} earns its place given all others", _HELD,
                _fall(one, unit),
                holds=one.holds, p=one.p, decisive=False,
            )
        )  # fmt: skip
    for one in needed:
        told = "" if one.holds else f"{one.effect} is in the model and not needed: "
        out.append(
            Check(
                f"needed:{one.effect}", f"{one.effect}, which is in the model, is needed", _HELD,
                told + _fall(one, unit), holds=one.holds, p=one.p, decisive=False,
            )
        )  # fmt: skip
    if table:
        # what these poses cannot tell does not decide
        out = [replace(check, decisive=check.name in ("set_up", PLACES)) for check in out]
    return tuple(out)


def _in_time(found: NamedEffects) -> str:
    first = next(iter(found.left.shapes), None)
    return ", in the course of time" if first is not None and tuple(first.depends_on) == (TIME,) else ""


_HELD = "every row in turn, held out with its block, five times over other folds"


def _fall(one: HeldOutGain, unit: str) -> str:
    if not np.isfinite(one.without):
        return "without it these rows cannot be fitted"
    return f"held out {number(one.without)} {unit} without it, {number(one.with_it)} with it"


def _set_up(mistakes: Sequence[Mistake], final: FittedRun) -> Check:
    tested = "no usual mistake is in the columns, their units and the robot file"
    told = "; ".join(m.sentence for m in mistakes) or "no usual mistake would make it better"
    return Check("set_up", tested, f"all {len(final.data)} rows", told, holds=not mistakes, fails=told)


def _table(table: Sequence[DataWarning], final: FittedRun) -> list[Check]:
    """Said where there is something to be said."""
    told = "; ".join(doubt.sentence for doubt in table)
    tested = "the poses can tell what the model asks of them"
    return [Check(PLACES, tested, f"all {len(final.data)} rows", told, holds=False, fails=told)] if told else []


def _converged(final: FittedRun, used: str) -> Check:
    fit = final.fit
    how = "settled" if fit.converged else "still moved"
    return Check(
        SETTLED, "the fit converged", used, f"it {how} after {fit.evaluations} evaluations", holds=fit.converged,
        fails="the fit did not converge, so that nothing it says can be believed",
    )  # fmt: skip


def _plausible(final: FittedRun, used: str) -> Check:
    tested = "no parameter is absurdly large"
    if not len(final.fit.values):
        return Check("plausible", tested, used, "there is none", holds=True)
    sizes = times_plausible(final.fit)
    worst = int(np.argmax(sizes))
    told = farthest_parameter(final.fit, worst)
    return Check(
        "plausible", tested, used, f"the largest is {told}", holds=bool(sizes[worst] <= ABSURD),
        fails=f"{told}: that is absurd",
    )  # fmt: skip


def _as_drawn(final: FittedRun, used: str) -> Check:
    tested = "the robot is as near to its drawing as robots are"
    # where a sensor stands that is known is asked by itself
    own = np.array([not p.known for p in final.fit.parameters], dtype=bool)
    for effect in final.model.effects:
        own[final.owns(effect)] = False
    if not own.any():
        return Check(AS_DRAWN, tested, used, "nothing of the drawing is free", holds=None, decisive=False)
    sizes = np.where(own, times_plausible(final.fit), 0.0)
    told, far = farthest_parameter(final.fit, int(np.argmax(sizes))), int((sizes > PLAUSIBLE).sum())
    more = f" (and {far - 1} more)" if far > 1 else ""
    return Check(
        AS_DRAWN, tested, used, f"farthest is {told}{more}", holds=far == 0, decisive=False,
        fails=f"{told}{more}: is the robot file that of this robot?",
    )  # fmt: skip


def _stands(final: FittedRun, used: str) -> list[Check]:
    """Asked of a sensor of which it is known where it stands."""
    stand = known_stand(final.fit)
    if stand is None:
        return []
    its, holds = stand.called, stand.holds
    instead = () if holds else stands_with(final)
    also = f"; with it there {listed(instead)} would do as well" if instead else ""
    return [
        Check(
            STANDS, f"the {its} stands where the robot's file has it, as well as that is known", used,
            f"it stands {stand}", holds=holds, p=stand.p,
            fails=f"the {its} stands {stand}: measure again where it stands, or free it ([sensor_pose] free = true)"
            + also,
        )
    ]  # fmt: skip


def _own_errors(base: Base) -> OwnErrors | None:
    """What each pose is off by its own, beyond what the run declares, in the unit of the readings."""
    run = base.family.run
    axes = list(run.of.axes)
    sigma = run.sigma[axes]
    own = base.own_errors(np.square(run.of.data.pose_sigma[run.rows][:, axes]).mean(axis=0) / sigma**2)
    return None if own is None else replace(own, size=own.size * sigma)


def _size(final: FittedRun, own: OwnErrors) -> float:
    return final.per_unit * float(np.linalg.norm(own.size))


def _poses(
    final: FittedRun, own: OwnErrors | None, off: bool, slow_drift: SlowDrift | None, *, followed: bool
) -> Check:
    tested = "poses are as near to the model as their repeats are to one another"
    if own is None:
        return Check(POSES_AS_REPEATS, tested, "no rows", "too few poses were repeated", holds=None)
    names = [bare(final.names[a]) for a in final.axes]
    each = ", ".join(f"{axis} {final.per_unit * one:.2g}" for axis, one in zip(names, own.size.tolist(), strict=True))
    told = f"each pose is off by {_size(final, own):.2g} {final.unit} of its own ({each})"
    columns = listed([name for k, name in enumerate(final.data.layout.pose_sigmas) if k in final.axes])
    file = final.model.pose_sigma_in_file
    declare = f"columns {columns}" + (f", or {file} in the robot file" if file else "")
    if followed:
        # what follows something is not each pose's own
        why = ""
    elif slow_drift is not None and slow_drift.counts:
        why = (
            f", and in the course of the run {slow_drift.axis} wanders by {slow_drift.size:.2g} {final.unit}: repeats "
            "at once do not see that; look at the instrument's stand and warmth, and come back to poses later"
        )
    else:
        why = (
            ", which no effect and no shape follows: look at what differs from pose to pose but not between repeats "
            "(how the marker is found, seating, a reading taken before it is still); where that is known, declare it: "
            f"{declare}{frozen(final.data)}"
        )
    return Check(
        POSES_AS_REPEATS, tested, f"{own.poses} poses", told, holds=not off, p=chance_of(own.evidence),
        fails=told + why,
    )  # fmt: skip


def _beside_shapes(final: FittedRun, own: OwnErrors | None, level: float) -> str:
    """What follows something is not each pose's own: what is, beside the shapes that describe what is left."""
    if own is None or chance_of(own.evidence) > level:
        return ""
    return f"beside that each pose is off by {_size(final, own):.2g} {final.unit} of its own"


def _digits(steps: Rounded | None, used: str, *, asked: bool, alone: bool) -> Check:
    """``alone``: steps are most of all that is left. Where they are those of joints, what repeats differ by is no noise
    of an instrument, and nothing is praised beside it."""
    tested = "columns have digits enough"
    told = "what is left is not what steps of their columns leave" if asked else "nothing asks for more of them"
    if steps is not None:
        told = str(steps)
    decisive = steps is not None and steps.joints and alone
    return Check(DIGITS, tested, used, told, holds=steps is None, decisive=decisive, fails=told)


def _repeats(repeats: Repeats | None) -> Check:
    tested = "what repeats of a pose differ by is noise alone"
    if repeats is None:
        return Check(REPEATS, tested, "no rows", "too few poses were repeated", holds=None)
    return Check(
        REPEATS, tested, f"{repeats.rows} rows of repeated poses", str(repeats), holds=not repeats.held,
        fails=f"repeats of a pose differ by more than noise: {repeats}",
    )  # fmt: skip


def _as_declared(final: FittedRun, contradicted: Mapping[str, tuple[float, float]], origin: str) -> Check:
    tested, rows = "repeats scatter by the noise that was declared", "rows of repeated poses"
    if not contradicted:
        told = "nothing else was seen" if origin == "declared" else "none was declared"
        return Check(DECLARED, tested, rows, told, holds=True if origin == "declared" else None, decisive=False)
    each = ", ".join(
        f"{axis} {said:.3g} {final.unit} declared, {shown:.3g} shown" for axis, (said, shown) in contradicted.items()
    )
    ratio = max(max(said / shown, shown / said) for said, shown in contradicted.values())
    told = f"{each}: {ratio:.2g} times apart; all that is said here is by what repeats show"
    return Check(
        DECLARED, tested, rows, told, holds=False, decisive=False,
        fails=f"the declared noise is not what repeats show ({told}): "
        + (
            "are the deviations in the unit of their column?" if ratio >= CONTRADICTS
            else "is what was declared the instrument's alone, without what the robot scatters by when it comes back?"
        ),
    )  # fmt: skip


def _steady(final: FittedRun, slow_drift: SlowDrift | None, used: str) -> Check:
    tested = "what is left is steady in the course of time"
    if slow_drift is None:
        told = "no times, or too few"
        return Check("steady", tested, used, told, holds=None, decisive=False)
    return Check(
        "steady", tested, used,
        f"{slow_drift.axis} wanders by {slow_drift.size:.3g} {final.unit} "
        f"beside {slow_drift.beside:.3g} from row to row",
        holds=not slow_drift.counts, p=slow_drift.p, decisive=False,
    )  # fmt: skip


def _small(final: FittedRun, error: float, sigma: Floats, origin: str, by_noise: Callable[[], float]) -> Check:
    tested = "the error on rows held out is as small as the noise"
    noise = _noise(final, sigma)
    if origin == "unknown":
        return Check(SMALL, tested, _HELD, f"{number(error)} {final.unit}; the noise is unknown", holds=None)
    most, told = LOUDER * noise, f"{number(error)} {final.unit} at a noise of {number(noise)} ({origin})"
    if error > most and (bound := by_noise() * noise) > most:
        told += f", which alone leaves up to {number(bound)} on rows held out of these poses"
        most = bound
    return Check(
        SMALL, tested, _HELD, told, holds=error <= most,
        fails=f"{number(error)} {final.unit} are left on rows held out at a noise of {number(noise)}",
    )  # fmt: skip


def _loosely(
    final: FittedRun, small: Check, error: float, sigma: Floats, enough: Callable[[], Elimination | None]
) -> Check | None:
    """Said of poses whose fit predicts others worse than they were read, though nothing is missing; and of so few that
    their fit goes through all of them. Where the noise is not known, it is what the fit leaves for each reading that it
    has not used up."""
    fit, left = final.fit, final.residuals[final.whole][:, list(final.axes)]
    poses = len(np.unique(final.data.standing[final.whole]))
    told = f"{poses} pose{'s fix' if poses > 1 else ' fixes'} {len(fit.values)} parameters so loosely that "
    known = small.holds is not None
    noise = _noise(final, sigma) if known else (
        final.per_row * float(np.sqrt((left**2).sum() / max(left.size - fit.rank, 1)))
    )  # fmt: skip
    if poses * len(final.axes) <= fit.rank:
        told += "a fit goes through all of them, and nothing tells whether it holds elsewhere"
    elif small.holds is not False and not final.is_exact and error > LOUDER * noise:
        told += f"rows held out are off by {error:.3g} {final.unit} where "
        told += f"the noise is {noise:.3g}" if known else f"what the fit leaves is no more than noise of {noise:.3g}"
    else:
        return None
    few = enough()
    few_words = f", or free fewer: {len(few.names)} of {few.every} are enough" if few else ""
    return Check(
        LOOSE, "the poses fix the parameters well enough to predict others", _HELD,
        f"{told}; {few}" if few else told, holds=False,
        fails=f"{told}: measure more poses, out to the rim of the workspace" + few_words,
    )  # fmt: skip


def _noise(final: FittedRun, sigma: Floats) -> float:
    return final.per_row * float(np.sqrt(np.mean(sigma[list(final.axes)] ** 2)))
