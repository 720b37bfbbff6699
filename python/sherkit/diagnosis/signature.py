"""The signature of what no effect explains: the shape that describes it, and those that do as well."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import scipy.special

from ..base.figures import stated
from ..base.types import Floats
from ..evidence.base import Base
from ..evidence.blocks import Block
from ..evidence.names import Names
from ..evidence.run import Run
from ..evidence.settings import finer
from ..evidence.thresholds import HARDLY, SURE_SIGMA
from ..fit.identify import Fit
from .template import course, what_parts

# -- Signature ---------------------------------------------------------------------------------------------------------

#: Evidence, in nats, by which one shape is clearly better than another (Kass and Raftery, "Bayes factors", JASA 1995).
CLEARLY = 3.0
#: Kinds of shapes, the simplest first.
_SIMPLEST = ("alternating", "smooth", "step", "kink", "bump", "interaction", "hysteretic", "periodic")


def signature_of(names: Names, named: Sequence[str]) -> dict[str, Any] | None:
    """In words and numbers, what effects leave, or, where none is ``named``, what is left without any; None where no
    shape describes it."""
    lead = names.lead
    described, base = names.alone, names.without
    if named and lead is not None:
        described, base = names.beside, lead.base
    if not described.shapes:
        return None
    first, *others = _as_likely(base)
    first = finer(base, first)
    with_it = base.beside(first)
    # what is left once every shape that was found is in the model stands for the noise
    noise = described.base.rss / max(described.base.free, 1)
    gain = base.rss - with_it.rss
    excess = max(base.rss - noise * base.free, gain, 1e-300)
    run = base.family.run
    axes = [run.of.names[a] for a in run.of.axes]
    values = {**run.view.way, **run.view.variables, **({} if first.pattern is None else run.view.stood)}
    told = {
        **_told(run, first, _axes_of(base, with_it, noise, len(first.at), axes)),
        "share_explained": float(np.clip(gain / excess, 0.0, 1.0)),
        "ranges": {name: _range(values[name]) for name in first.depends_on if name in values},
        "indistinguishable": [_told(run, other, axes) for other in others],
    }
    return told | {"apart": what_parts(told, run.view.pattern_of, run.view.place)}


def _as_likely(base: Base) -> list[Block]:
    """The likeliest shape of each cause that is as likely as any, the simplest first."""
    likeliest = float(base.shapes.max())
    some: dict[tuple[object, ...], tuple[tuple[float, ...], Block]] = {}
    for i in np.flatnonzero(base.shapes >= likeliest - CLEARLY).tolist():
        block = base.family.blocks[i]
        numbers = len(block.at) + (block.period is not None)
        order = (numbers, _SIMPLEST.index(block.shape), len(block.depends_on), -float(base.shapes[i]))
        if block.cause not in some or order < some[block.cause][0]:
            some[block.cause] = order, block
    return [block for _, block in sorted(some.values(), key=lambda one: one[0])]


def _told(run: Run, shape: Block, axes: list[str]) -> dict[str, Any]:
    """A shape as a table has it; ``axes`` where it is one on all of them."""
    return numbers_of(shape, axes if shape.axis is None else [run.of.names[run.of.axes[shape.axis]]])


def numbers_of(shape: Block, axes: Sequence[str]) -> dict[str, Any]:
    """A shape on these ``axes`` as a table has it."""
    at, width = shape.setting if isinstance(shape.setting, tuple) else (shape.setting, None)
    return {
        "depends_on": list(shape.depends_on),
        "shape": shape.shape,
        "order": shape.order,
        "period": shape.period,
        "axis": list(axes),
        "at": at,
        "width": width,
        "joint": shape.pattern,
    }


def _range(values: Floats) -> tuple[float, float]:
    """Middle and half width of a variable's values."""
    low, high = float(values.min()), float(values.max())
    return (0.5 * (low + high), 0.5 * (high - low) or 1.0)


def _axes_of(base: Base, with_it: Base, noise: float, count: int, axes: list[str]) -> list[str]:
    """Axes on which a shape takes more than ``noise``, a variance, would."""
    taken = np.square(base.residual - with_it.residual).reshape(-1, len(axes)).sum(axis=0)
    enough = noise * float(scipy.special.chdtri(max(count / len(axes), 1.0), HARDLY))
    some = [axis for axis, one in zip(axes, taken.tolist(), strict=True) if one > enough]
    return some or [axes[int(np.argmax(taken))]]


# -- Waves in words ----------------------------------------------------------------------------------------------------
# How large the waves of gears and encoders are, joint by joint, in words.


def bends_in_words(judged: Names | None, names: Sequence[str], readings: Sequence[str]) -> str:
    """Bends that a run cannot tell from waves which are named; empty where there is none."""
    told = {} if judged is None else {one.name: one.bend for one in judged.told}
    # a tie that rows held out are nearer with is named in the place of one that was told, and is as little seen
    instead = next((name for name in names if name not in told), None)
    bends = {name if name in names else instead: bend for name, bend in told.items() if bend is not None}
    return "; ".join(
        f"it may as well be that {course(numbers_of(bend, readings))}: of {name} too little is seen to tell it "
        "from a bend"
        for name, bend in bends.items() if name is not None
    )  # fmt: skip


def waves_in_words(fit: Fit) -> Iterator[str]:
    """A sentence for each effect of waves that has a period for each joint, or a second wave in it: how large they
    are at the joints where they are told, the second wave of each period behind the first."""
    for effect in fit.model.effects:
        if not effect.is_periodic:
            continue
        names = [p.name for p in fit.parameters]
        seconds = {p.name for e in fit.model.effects if e.goes_with == effect.name for p in e.qualified()}
        if not (seconds or isinstance(fit.model.setting_of(effect), tuple)):
            continue
        said = []
        for sine, cosine in zip(effect.qualified()[::2], effect.qualified()[1::2], strict=True):
            joint = sine.name.partition(".sine_")[2]
            size, std = _amplitude(fit, [names.index(sine.name), names.index(cosine.name)])
            if size < SURE_SIGMA * std:
                continue
            both = stated(size, std, sine.unit)
            ends = (f".sine_{joint}", f".cosine_{joint}")
            if its := [names.index(name) for name in names if name in seconds and name.endswith(ends)]:
                both += f" and, twice as often, {stated(*_amplitude(fit, its), sine.unit)}"
            said.append(f"joint {joint} by {both}")
        if said:
            yield f"{effect.name}: {', '.join(said)}"


def _amplitude(fit: Fit, pair: list[int]) -> tuple[float, float]:
    """Of sine and cosine, with its deviation to first order."""
    both = fit.values[pair]
    size = float(np.hypot(*both))
    along = both / max(size, 1e-300)
    covariance = (fit.covariance + fit.unobserved_covariance)[np.ix_(pair, pair)]
    return size, float(np.sqrt(np.clip(along @ covariance @ along, 0.0, None)))
