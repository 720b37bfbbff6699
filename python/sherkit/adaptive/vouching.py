"""What speaks against the rows of a loop as witnesses that nothing is missing.

"Nothing is missing" is said of what was looked at: at enough places, with joints that move and channels that vary, so
that an error of three times what is required would have been seen in 95 of 100 runs. What stands apart from all other
rows is told, and is an accident only where it is not wrong again and lies where accidents do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..base.figures import listed, number, spans
from ..base.types import Floats, Ints
from ..data.doubts import doubts
from ..data.doubts.repeats import copied
from ..data.noise import noise_of
from ..diagnosis.gathered import gathered, said
from ..evidence.plausible import farthest_parameter, times_plausible
from ..evidence.thresholds import FAR_SIGMA, LOUDER, MOVES, NEARLY_ALWAYS, PLAUSIBLE, SAME_PLACE, WRONG
from .gate import TIMES
from .look import BEYOND, InterimAnalysis, of_no_side
from .rule import Unseen, outlook


def against(found: InterimAnalysis, required_um: float | None, level: float, seed: int) -> tuple[str, ...]:
    """Why these rows cannot say that nothing is missing, in sentences; empty where they can. Where there is an alarm it
    is not asked what they would have shown."""
    out = [*_few_places(found)]
    # rows that are told again are no witnesses, whatever time is given to them
    told = (*doubts(found.data), *copied(replace(found.data, time_s=None)))
    out += dict.fromkeys(one.sentence for one in told if not one.poses)
    sizes = times_plausible(found.fit)
    if sizes.max(initial=0.0) > PLAUSIBLE:
        out.append(f"{farthest_parameter(found.fit, int(np.argmax(sizes)))}: is the robot's file that of this robot?")
    if required_um is not None and found.log_evidence < -np.log(level):
        out += _unseen(found, outlook(found, level), required_um, found.known.accuracy_um(found.data, found.fit, seed))
    return tuple(out)


def _few_places(found: InterimAnalysis) -> Iterator[str]:
    region, data = found.known.region, found.data
    rows = data.used[:, list(found.known.axes)].any(axis=1)
    joints = data.joints[rows]
    still = [
        name for name, way, half in zip(data.layout.joints, np.ptp(joints, axis=0), region.joint_half, strict=True)
        if half > 0 and way < MOVES * 2.0 * half
    ]  # fmt: skip
    if still:
        yield (
            f"{listed(still)} {'hardly move' if len(still) > 1 else 'hardly moves'} in all {len(joints)} rows: "
            "nothing is said of what moves with it; look whether the encoders are read"
        )
    places = len(np.unique(np.round(joints / (SAME_PLACE * np.maximum(region.joint_half, 1e-300))), axis=0))
    needed = len(found.fit.values) + BEYOND
    if places * len(found.known.axes) < needed:
        yield (
            f"{places} place{'s' if places > 1 else ''} in {len(joints)} rows for {len(found.fit.values)} parameters: "
            f"read at {-(-needed // len(found.known.axes))} at least"
        )


def _unseen(
    found: InterimAnalysis, seen: Sequence[Unseen], required_um: float, accuracy_um: float | None
) -> Iterator[str]:
    layout = found.data.layout
    must = TIMES * required_um
    if layout.unit == "µm":
        hidden = {
            one.name: layout.per_unit * one.from_rms for one in seen
            if not one.in_time and layout.per_unit * one.most_rms >= must and layout.per_unit * one.from_rms > must
        }  # fmt: skip
        if hidden:
            worst = max(hidden, key=lambda name: hidden[name])
            size = f"from {number(hidden[worst])} µm RMS on" if np.isfinite(hidden[worst]) else "undetectable here"
            yield (
                f"{_scattering(found)}: of {listed(sorted(hidden))} an error of {must:g} µm ({TIMES:g} × the "
                f"target of {required_um:g}) would not have been seen in {NEARLY_ALWAYS:.0%} of such runs, "
                f"{worst} {size}"
            )
    if accuracy_um is not None and accuracy_um > must:
        yield (
            f"{_scattering(found)}: the calibrated robot may be off by {number(accuracy_um)} µm, where the "
            f"target is {required_um:g}"
        )


def _scattering(found: InterimAnalysis) -> str:
    """What a fit leaves of each channel, and in how many rows."""
    data, layout = found.data, found.data.layout
    each = []
    for k in found.known.axes:
        left = found.fit.residuals[data.used[:, k], k]
        if len(left):
            each.append(f"{layout.readings[k]} {number(layout.per_unit * float(np.sqrt(np.mean(left**2))))}")
    return f"left of {listed(each)} {layout.unit} in {int(data.used.any(axis=1).sum())} rows"


# -- rows that are set aside ------------------------------------------------------------------------------------------


def set_aside(found: InterimAnalysis) -> Ints:
    """Rows that stand apart, but for a first one of which only the side is not known."""
    return np.setdiff1d(found.aside, of_no_side(found.data))


def told_of(found: InterimAnalysis) -> str:
    """How many rows are set aside, which, and how far off they are; empty where none is."""
    rows = set_aside(found)
    if not len(rows):
        return ""
    data, layout = found.data, found.data.layout
    by = layout.per_unit * float(np.abs(_off(found)[rows]).max())
    which = f"pose{'s' if len(rows) > 1 else ''} {spans(data.pose[rows])}" if data.pose is not None else (
        f"{data.counted}s {spans(data.line[rows])}"
    )  # fmt: skip
    many = len(rows) > 1
    return (
        f"{len(rows)} of {len(data)} readings {'are' if many else 'is'} set aside and in none of these numbers ({which}"
        f"; {'up to ' if many else ''}{number(by)} {layout.unit} off)"
    )


def structure_of(found: InterimAnalysis) -> str:
    """Why rows that are set aside are no accidents; empty where they are."""
    data, rows = found.data, set_aside(found)
    if len(rows) > WRONG * len(data):
        return f"{len(rows)} of {len(data)} readings stand apart from the others: the rest is no run any more"
    if twice := _wrong_again(found, rows):
        many = len(twice) > 1
        return (
            f"pose{'s' if many else ''} {spans(twice)} {'were' if many else 'was'} read once more and "
            f"{'are' if many else 'is'} off by the same again: no accident, look at what is there"
        )
    joints = {name: data.joints[:, k] for k, name in enumerate(data.layout.joints)}
    places = joints | found.fit.model.place(data, found.fit.predicted, found.fit.values)
    one = gathered(data.mark_outliers(rows), rows, places)
    return said(one, data) if one is not None else ""


def _wrong_again(found: InterimAnalysis, rows: Ints) -> list[int]:
    """Numbers of poses that were read twice or more, each time off by the same."""
    if found.data.pose is None:
        return []
    off, noise = _off(found), float(found.fit.scale) * found.noise.sigma / np.exp(np.mean(np.log(found.noise.sigma)))
    of_pose = found.data.pose
    out = []
    for pose in np.unique(of_pose[rows]).tolist():
        here, every = rows[of_pose[rows] == pose], np.flatnonzero(of_pose == pose)
        apart = np.ptp(off[here], axis=0) if len(here) > 1 else np.full(off.shape[1], np.inf)
        if len(here) == len(every) and (apart <= FAR_SIGMA * noise).all():
            out.append(int(pose))
    return out


def _off(found: InterimAnalysis) -> Floats:
    """What the best explanation leaves of each row (n, m) on the axes."""
    return np.nan_to_num(found.best_fit.residuals[:, list(found.known.axes)])


def louder_than_told(found: InterimAnalysis, verdict: str) -> str:
    """That more is left than the noise that the columns of the readings declare; empty where it is not."""
    declared = noise_of(found.data)
    if declared.origin != "declared":
        return ""
    axes = list(found.known.axes)
    each = declared.sigma[:, axes][found.data.used[:, axes]]
    said = float(np.exp(np.mean(np.log(each))))
    left = float((found.best_fit if verdict == "explained" else found.fit).scale)
    layout = found.data.layout
    if left <= LOUDER * said:
        return ""
    return (
        f"{layout.per_unit * left:.3g} {layout.unit} are left of each reading where its column declares "
        f"{layout.per_unit * said:.3g}: more noise than is told, or physics without a pattern"
    )
