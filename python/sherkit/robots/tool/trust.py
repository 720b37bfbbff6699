"""Whether the depth of a run is to be trusted: one verdict, said once, with what to do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...base.answer import Answer, ToDo
from .began import began
from .consistency import NeesConsistency
from .exchanged import exchanged
from .filters import Estimate

#: Without a truth: a mean of squared innovations over their variances beyond which deviations are too small.
_TOO_FAR = 1.5
#: Clocks that differ by less say nothing that is worth a sentence, s.
_LATE_S = 0.008
#: Fibres that lag by less say nothing that is worth a sentence, over the bend.
_LAGS = 0.004


@dataclass(frozen=True)
class Trust:
    """``verdict``: ``trusted``, ``too careful``, ``overconfident`` or ``unknown``; the sentence that says so with what
    to do, and what else was noticed in the run."""

    verdict: str
    sentence: str
    to_do: str
    noticed: tuple[str, ...]

    @property
    def answer(self) -> Answer:
        """What it says for whoever reads nothing else."""
        return Answer(f"the depth is {self.verdict}", "", (self.sentence, *self.noticed), (ToDo(self.to_do),))


def trust(e: Estimate, truths: list[NeesConsistency]) -> Trust:
    """From what is known of the depth's errors, where the run tells a truth; else from its innovations, which see no
    bias and never know that a filter is too careful."""
    mistaken, froze = [*exchanged(e), *began(e)], e.run.froze
    noticed = (*mistaken, *froze, *_noticed(e))
    why = " for what is said below" if noticed else ""
    of = [k for k in truths if (k.quantity, k.signal, k.condition) == ("depth", "filter", "whole run")]
    std = float(np.median(e.depth_std_mm))
    if of and of[0].verdict != "unknown":
        k = of[0]
        told = f"{100 * k.coverage:.0f} % of the rows lie in its 95 % interval, NEES {k.nees:.2f}, ± {std:.2f} mm"
        verdict = {"consistent": "trusted"}.get(k.verdict, k.verdict)
    else:
        c = e.depth.consistency
        verdict = "unknown" if not np.isfinite(c.ratio) else ("overconfident" if c.ratio > _TOO_FAR else "trusted")
        told = f"innovations squared are {c.ratio:.2f} of what is stated, ± {std:.2f} mm; no truth is in this run"
    # of a run that was recorded wrongly innovations tell nothing
    wrong = "put that right, and estimate again" if mistaken else "use the other seconds, or measure again"
    if (mistaken or froze) and verdict != "overconfident":
        verdict = "unknown"
    do = {
        "trusted": "use the estimate with its deviation",
        "too careful": "use it as it is; more loads on the bench would narrow the deviation",
        "overconfident": f"count on more than the deviation{why or ', and calibrate the tool again on its bench'}",
        "unknown": wrong
        if mistaken or froze
        else "nothing was measured that tells; look at what the rows say of themselves",
    }[verdict]
    return Trust(verdict, told, do, noticed)


def _noticed(e: Estimate) -> list[str]:
    out = []
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
    if lags > _LAGS:
        out.append(
            f"Fibres lag behind their bends, by about {100 * lags:.1f} % of the bend, which the bench did not show: "
            "the deviation is larger for it. A bench that loads from all sides, up and down, would say so"
        )
    return out
