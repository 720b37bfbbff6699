"""What is wrong and what to do about it, in sentences for a person who reads nothing else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..diagnosis import Diagnosis
from ..figures import stated
from ..fit.forms import known
from ..fit.identify import Fit
from ..model.effect import Effect
from ..names import listed
from .style import number


@dataclass(frozen=True)
class Answer:
    """``cause``: what is wrong; ``brings``: what the error becomes with it known; ``workshop``: what to do besides."""

    cause: str
    brings: str
    workshop: str

    @property
    def cure(self) -> str:
        """All but the cause."""
        return f"{self.brings} {self.workshop}".strip()


def answer(found: Diagnosis) -> Answer:
    """The answer of a diagnosis."""
    first, last = number(found.steps[0].held_out_rms), number(found.steps[-1].held_out_rms)
    unit = found.unit
    if not found.effects:
        if found.verdict == "adequate":
            return Answer(
                f"The model describes this machine: on poses that it was not fitted to it is off by {first} {unit}, "
                "and nothing that was tried would make that less.",
                "",
                "Use the calibration as it is; only better or more readings could tell more.",
            )
        if found.verdict == "undecided":
            return Answer(
                f"The model is off by {first} {unit} on poses that it was not fitted to, and that may be because these "
                "are too few: nothing shows beside what they leave open.",
                "",
                "Measure more poses, out to the rim of the workspace, and ask again.",
            )
        return Answer(
            f"The model is off by {first} {unit}, and no effect that is known explains it: what is left has a pattern.",
            "",
            "Look at the pattern below, ask what could leave it, and add that as an effect of your own.",
        )
    causes = [effect for effect in found.fit.model.effects if effect.name in found.effects]
    physics = " ".join(f"{_first_sentence(e.physics)} {_most(found.fit, e)}".strip() for e in causes)
    tied = (
        f" These poses cannot tell it from {listed(found.indistinguishable[0][1:])}." if found.indistinguishable else ""
    )
    whole = "" if found.verdict == "explained" else " That is not all: the rest has a pattern, too."
    if found.too_few_poses:
        whole = " These poses are too few to say whether that is all."
    doubt = f" With a caveat: {found.caveat}." if found.caveat else ""
    repair = " ".join(found.known[e.name].workshop if e.name in found.known else e.workshop for e in causes)
    return Answer(
        f"The model lacks {listed(found.effects)}. {physics}".strip() + tied,
        f"With that in the model the error falls from {first} to {last} {unit} on poses that the fit had not seen."
        + whole
        + doubt,
        f"To be rid of it in the machine: {repair[:1].lower()}{repair[1:]}" if repair else "",
    )


def _most(fit: Fit, effect: Effect) -> str:
    """What is known of an effect, or the largest of its numbers, in a sentence."""
    one = known(fit).get(effect.name)
    if one is not None:
        return f"As fitted: {one.short}."
    place = fit.model.owns(effect)
    sizes = np.array([p.size for p in effect.parameters])
    k = int(np.argmax(np.abs(fit.values[place]) / sizes))
    p, value, std = effect.parameters[k], fit.values[place][k], fit.std[place][k]
    said = f"{p.name} = {stated(float(value), float(std), p.unit)}"
    return f"As fitted: {said}{', the largest' if len(sizes) > 1 else ''}."


def _first_sentence(text: str) -> str:
    return text.partition(". ")[0].rstrip(".") + "." if text else ""
