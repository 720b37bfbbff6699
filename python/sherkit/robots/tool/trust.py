"""Whether the depth of a run is to be trusted: one verdict, said once, with what to do; and what was noticed: what
contradicts it, a hole that goes along, lags.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...base.answer import Answer, ToDo
from ...base.figures import listed
from .checks import RunCheck, checks
from .consistency import NeesConsistency, known_of
from .filters import Estimate
from .tool import FIBRES

#: Without a truth: a mean of squared innovations over their variances beyond which deviations are too small.
_TOO_FAR = 1.5
#: Clocks that differ by less say nothing that is worth a sentence, s.
_LATE_S = 0.008
#: Fibres that lag by less say nothing that is worth a sentence, over the bend.
_LAGS = 0.004
#: Beyond this share of the variance a truth says more about the camera than about the tip.
COARSE = 0.8


@dataclass(frozen=True)
class Trust:
    """``verdict``: ``trusted``, ``too careful``, ``overconfident`` or ``unknown``, and ``of`` what; the sentence that
    says so with what to do, what else was noticed in the run, and the ``checks`` that it was asked."""

    verdict: str
    sentence: str
    to_do: str
    noticed: tuple[str, ...]
    of: str = "depth"
    checks: tuple[RunCheck, ...] = ()

    @property
    def answer(self) -> Answer:
        """What it says for whoever reads nothing else."""
        return Answer(f"the {self.of} is {self.verdict}", "", (self.sentence, *self.noticed), (ToDo(self.to_do),))


def trust(e: Estimate, truths: list[NeesConsistency]) -> Trust:
    """From what is known of the depth's and the tip's errors, where the run tells a truth, else from the depth's
    innovations, which see no bias and never know that a filter is too careful. Where a check fails none of these tells
    anything, and nothing is trusted."""
    asked = checks(e, truths)
    against = [one for one in asked if one.holds is False]
    # of what is learnt in a run that contradicts itself nothing is left to say
    noticed = tuple(sentence for one in against for sentence in one.sentences) or tuple(_noticed(e))
    verdict, of, told = _judged(e, truths)
    if against and verdict != "overconfident":
        verdict = "unknown"
    do = {
        "trusted": "use the estimate with its deviation",
        "too careful": "use it as it is; more loads on the bench would narrow the deviation",
        "overconfident": "count on more than the deviation"
        + (" for what is said below" if noticed else ", and calibrate the tool again on its bench"),
        "unknown": "nothing was measured that tells; look at what the rows say of themselves",
    }[verdict]
    return Trust(verdict, told, against[0].to_do if against else do, noticed, of, asked)


def _judged(e: Estimate, truths: list[NeesConsistency]) -> tuple[str, str, str]:
    """The verdict by errors that are known or by innovations, of what it is, and what they are."""
    depth, tip = known_of(truths, "depth"), known_of(truths, "tip")
    std = float(np.median(e.depth_std_mm))
    if depth is not None and depth.verdict != "unknown":
        told = (
            f"{100 * depth.coverage:.0f} % of the rows lie in its 95 % interval, NEES {depth.nees:.2f}, ± {std:.2f} mm"
        )
        verdict = {"consistent": "trusted"}.get(depth.verdict, depth.verdict)
    else:
        c = e.depth.consistency
        verdict = "unknown" if not np.isfinite(c.ratio) else ("overconfident" if c.ratio > _TOO_FAR else "trusted")
        nothing = "no truth is in this run" if tip is None else "no depth_mm is in this run"
        said = f"innovations squared are {c.ratio:.2f} of what is stated, ± {std:.2f} mm"
        told = f"{said if np.isfinite(c.ratio) else 'no force was felt that tells the depth'}; {nothing}"
    if tip is None or tip.verdict == "unknown":
        return verdict, "depth", told
    told += f"; {100 * tip.coverage:.0f} % of the pictures lie where the tip is stated to be, NEES {tip.nees:.2f}"
    if tip.verdict == "overconfident" and tip.of_truth > COARSE:
        # an error beyond what is stated may as well be that of the coarser of both
        return verdict, "depth", f"{told}: or std_mm of [camera] is too small"
    if tip.verdict == "overconfident" and verdict != "overconfident":
        return "overconfident", "tip", told
    return verdict, "depth", told


def _noticed(e: Estimate) -> list[str]:
    out = []
    if (single := e.run.leaps.single.sum(axis=0)).any():
        where = listed((f"{name}: {count}" for name, count in zip(FIBRES, single, strict=True) if count), 9)
        out.append(f"{single.sum()} single readings leap off what is before and after them and are left out ({where})")
    if gaps := e.run.gaps:
        spans = listed((f"{a:.2f} to {b:.2f} s" for a, b in gaps), 4)
        out.append(
            f"No row of the robot came from {spans}: a hole that moved meanwhile is known again by the next forces"
        )
    if (share := float(e.goes_along[-1])) > 0.0:
        out.append(
            f"The hole goes along with the shaft, by about {100 * share:.0f} % of each slide: the depth is known less "
            "well than where it stays. Support the eye, or slide more slowly"
        )
    late_s = float(e.late_s[-1])
    if abs(late_s) > _LATE_S:
        ms = 1e3 * abs(late_s)
        out.append(
            f"The robot's rows are about {ms:.0f} ms later than the gratings: the tip is led on by as much, and its "
            "deviation is larger. Give both one clock"
            if late_s > 0.0
            else f"The gratings are about {ms:.0f} ms later than the robot's rows, or lag as if they were: `sherkit "
            "tool` finds the delay of the fibres, which the tool file holds ([gratings] delay_s)"
        )
    lags = float(np.median(e.lags))
    if lags > _LAGS and np.isfinite(e.fibre_depth_mm).any():
        out.append(
            f"Fibres lag behind their bends, by about {100 * lags:.1f} % of the bend, which the bench did not show: "
            "the deviation is larger for it. A bench that loads from all sides, up and down, would say so"
        )
    return out
