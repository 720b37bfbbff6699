"""What every diagnosis must keep to, whatever the run: its verdict agrees with the numbers beside it.

To be called on every diagnosis that the suite makes: ``consistent(d)``. It asks nothing about the truth, only whether
the report contradicts itself, so it holds for real runs as for simulated ones.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

#: Held-out error over noise up to which a verdict may be one of praise.
PRAISE = 1.25
PRAISED = ("adequate", "explained")
#: Level of the confirmation on rows that had no part in the choice.
CONFIRMED = 0.05


def noise_of(d: Any) -> float | None:
    """The noise of all readings of a row together, as errors are counted; None where it is not known."""
    if d.noise_origin == "unknown":
        return None
    return float(np.sqrt(np.sum(np.square(list(d.noise.values())))))


def named(d: Any) -> set[str]:
    """Effects that lead or are tied with one that does."""
    return set(d.effects).union(*d.indistinguishable)


def contradictions(d: Any, level: float = CONFIRMED) -> list[str]:
    """Each way in which a diagnosis contradicts itself, as a sentence; empty where it does not."""
    out = []
    errors = [step.error.rms for step in d.steps]
    noise = noise_of(d)
    verdict = d.verdict.split(",")[0]  # "adequate, but … is not needed" praises as well
    if verdict in PRAISED:
        if noise is not None and not errors[-1] <= PRAISE * noise:
            out.append(f"{d.verdict}, but {errors[-1]:.4g} {d.unit} are left at a noise of {noise:.4g}")
        fitted = d.fit
        if not getattr(fitted, "converged", True):
            out.append(f"{d.verdict}, but the fit did not converge")
        absurd = [c.effect for c in d.candidates if c.effect in d.effects and not c.plausible]
        if absurd and not d.caveat:
            out.append(f"{d.verdict}, but the size of {', '.join(absurd)} is not plausible, and nothing says so")
    for before, step in pairwise(d.steps):
        if not step.error.rms < before.error.rms:
            out.append(
                f"{step.effect} is named, but the held-out error goes from {before.error.rms:.5g} to "
                f"{step.error.rms:.5g} {d.unit}"
            )
    if d.effects and d.confirmed is not None and not d.confirmed <= level:
        out.append(f"{', '.join(d.effects)} named, but on rows not used p = {d.confirmed:.2g}")
    if [s.effect for s in d.steps[1:]] != list(d.effects):
        out.append(f"the steps {[s.effect for s in d.steps]} are not those of the effects {d.effects}")
    for check in getattr(d, "checks", ()):
        if check.p is not None and not 0.0 <= check.p <= 1.0:
            out.append(f"check {check.name}: p = {check.p}")
    return out


def consistent(d: Any, level: float = CONFIRMED) -> None:
    """Asserts that a diagnosis does not contradict its own numbers; to be called after every one that a test makes.

    Catches the verdicts ``adequate`` and ``explained`` at a held-out error above 1.25 times a known noise, on a fit
    that did not converge or with an effect of absurd size; an effect that is named though the held-out error does not
    fall with it; and one that the rows kept aside did not confirm at ``level``.
    """
    found = contradictions(d, level)
    assert not found, "\n".join((*found, repr(d)))
