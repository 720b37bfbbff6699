"""What is really known of an effect: the simplest form of it that the readings do not refuse.

An effect with a number for each limb often shows one of a few simple forms: the same in all limbs, in one limb only,
opposite in two. Each form is a linear restriction θ = A φ of the fitted numbers θ with covariance C. Its distance
(θ - A φ)ᵀ C⁻¹ (θ - A φ) at the best φ is χ² with as many degrees of freedom as it saves (Wald, "Tests of statistical
hypotheses", Trans. AMS 1943); among those that are not refused, Schwarz's criterion chooses, with the choice itself
paid for. Where none holds, the combination that is known best says how much is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import scipy

from ..base import linalg
from ..base.figures import listed
from ..base.types import Floats, Ints
from ..model.effect import Effect, Parameter

#: What readings that say nothing weigh, beside a plausible size.
_NOTHING = 1e-6
#: A form with a smaller p is refused.
_LEVEL = 0.01
#: Forms whose criterion is nearer than this to the leading one fit as well (Kass and Raftery, JASA 1995).
_AS_WELL = 2.0
#: A number is known where its deviation is less than this part of its plausible size.
_KNOWN = 1.0 / 3.0
#: Which form leads among those that fit as well.
_ORDER = ("common", "opposite", "one")
#: A combination is written with the fewest parts and digits with which it is known to this many of its deviations.
_WRITTEN = 1.5
#: So many parts are as many as anybody reads: with them it may be known less well.
_READ = 3
#: What is fewer of its deviations from zero says nothing.
_CLEAR = 3.0


@dataclass(frozen=True)
class Value:
    """A number that the readings tell: what it is in words, of how many ``parts``, and its standard deviation, in
    ``unit``."""

    what: str
    value: float
    std: float
    unit: str
    parts: int = 1

    def __str__(self) -> str:
        gap = "" if self.unit == "°" else " "
        digits = max(0, 1 - int(np.floor(np.log10(self.std)))) if self.std > 0 else 6
        if digits > 6:
            return f"{self.what} {self.value:.4g} ± {self.std:.1g}{gap}{self.unit}"
        return f"{self.what} {self.value:.{digits}f} ± {self.std:.{digits}f}{gap}{self.unit}"


@dataclass(frozen=True)
class SimplestForm:
    """What is known of one effect.

    ``form`` is ``common``, ``one``, ``opposite`` or ``combination``; ``at`` the numbers of the limbs or joints that it
    names; ``values`` what the readings tell, ``single`` the smallest deviation of the single numbers, in the unit of
    the first. ``p`` is how well the form stands against the free one; ``also`` names forms that fit as well.
    """

    effect: Effect
    form: str
    at: tuple[int, ...]
    values: tuple[Value, ...]
    single: float
    p: float
    also: tuple[str, ...] = ()

    @property
    def where(self) -> str:
        """Which limbs or joints: in words."""
        return _where(self.form, self.at, _place(self.effect))

    @property
    def short(self) -> str:
        """What is known, for a cell of a table: of combinations those that a person reads, and that say something."""
        said = self.values
        if self.form == "combination":
            said = tuple(one for one in said if one.parts <= _READ and abs(one.value) >= _CLEAR * one.std)
        return (
            f"{self.where} {listed(said)}"
            if said
            else f"known of all {_place(self.effect)}s together, of none alone {self._no_better}"
        )

    @property
    def _no_better(self) -> str:
        unit = self.values[0].unit
        return f"to better than {self.single:.2g}{'' if unit == '°' else ' '}{unit}"

    @property
    def sentence(self) -> str:
        """What is known, in one sentence."""
        said = f"{self.effect.name}: {self.short}"
        if self.single > 2.0 * self.values[0].std and not said.endswith(self._no_better):
            said += f"; the single {_place(self.effect)}s are not known {self._no_better}"
        return said + (f"; as well fits: {' or '.join(self.also)}" if self.also else "")

    @property
    def remedy(self) -> str:
        """What to do about it: the effect's own sentence, for the limbs that it is about."""
        place, own = _place(self.effect), self.effect.remedy
        if self.form == "common":
            return f"{own} All {place}s err alike: look for one cause before you adjust single ones.".strip()
        if self.form == "combination":
            return f"{own} Adjust no single {place} by its own number: only the combination is known.".strip()
        them = f"{place} {self.at[0]}" if self.form == "one" else f"{place}s {self.at[0]} and {self.at[1]}"
        return f"{own} It concerns {them}.".strip()

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "effect": self.effect.name,
            "form": self.form,
            "at": list(self.at),
            "values": [{"what": v.what, "value": v.value, "std": v.std, "unit": v.unit} for v in self.values],
            "single_std": self.single,
            "p_value": self.p,
            "sentence": self.sentence,
        }


def known(fit: Any) -> dict[str, SimplestForm]:
    """What is known of each effect of a :class:`~sherkit.fit.identify.Fit`, by its name; effects whose numbers each
    stand for themselves are left out."""
    found = {e.name: simplest_form(fit, e) for e in fit.model.effects}
    return {name: one for name, one in found.items() if one is not None}


def simplest_form(fit: Any, effect: Effect) -> SimplestForm | None:
    """What is known of an effect that is in a fit; None where it has no number for each limb, or each of them is."""
    kinds = _by_limb(effect.parameters)
    if not kinds:
        return None
    place = fit.model.owns(effect)
    covariance = (fit.covariance + fit.unobserved_covariance)[place, place]
    size = np.array([p.size for p in effect.parameters])
    theta, c = fit.values[place] / size, covariance / np.outer(size, size)
    if not (np.isfinite(theta).all() and np.isfinite(c).all() and np.diag(c).min() > 0):
        return None
    weight = linalg.pinv(c, rcond=1e-12, hermitian=True)
    if fit.priors:
        # what the readings alone say: the drawing, at one plausible size, taken off
        told = weight @ theta
        value, turn = linalg.eigh(weight - np.eye(len(weight)))
        value = np.maximum(value, _NOTHING)
        weight, c = (turn * value) @ turn.T, (turn / value) @ turn.T
        theta = c @ told
    price = np.log(max(int(fit.data.used.sum()), 3))
    free = len(theta) * price
    scored = []
    forms = _forms(kinds)
    for form in forms:
        # in plausible sizes, of which all limbs have the same
        a = form.matrix(len(theta))
        inner = linalg.inv(a.T @ weight @ a)
        phi = inner @ (a.T @ weight @ theta)
        left = theta - a @ phi
        distance = float(left @ weight @ left)
        p = float(scipy.special.chdtrc(len(theta) - len(phi), distance))
        choice = 2.0 * np.log(sum(len(f.kinds) == len(form.kinds) for f in forms))
        scored.append((distance + len(phi) * price + choice, p, form, phi, np.sqrt(np.diag(inner))))
    single = np.sqrt(np.diag(c))
    least = min((s[0] for s in scored if s[1] > _LEVEL), default=np.inf)
    if least >= free:
        return _combination(effect, theta, c, size)
    near = [s for s in scored if s[1] > _LEVEL and s[0] < least + _AS_WELL]
    # among forms that fit alike, one cause for all limbs before one for a single limb
    near.sort(key=lambda s: (_ORDER.index(s[2].name), s[0]))
    _, p, form, phi, std = near[0]
    others = [s[2] for s in near if (s[2].name, s[2].at) != (form.name, form.at)]
    values = []
    for kind, value, deviation in zip(form.kinds, phi.tolist(), std.tolist(), strict=True):
        one = effect.parameters[next(iter(kinds[kind].values()))]
        factor, unit = _shown(one)
        values.append(Value(_called(effect, kind, kinds), factor * value, factor * deviation, unit))
    first = kinds[form.kinds[0]]
    smallest = min(_shown(effect.parameters[k])[0] * float(single[k]) for k in first.values())
    also = tuple(dict.fromkeys(_where(f.name, f.at, _place(effect)).rstrip(":") for f in others))
    return SimplestForm(effect, form.name, form.at, tuple(values), smallest, p, also)


@dataclass(frozen=True)
class _Form:
    """A form: which kinds of number are not zero, in which limbs, and their places among the parameters."""

    name: str
    at: tuple[int, ...]
    kinds: tuple[str, ...]
    entries: tuple[tuple[tuple[int, float], ...], ...]

    def matrix(self, count: int) -> Floats:
        """A (count, kinds): the parameters, in plausible sizes, by the numbers of the form."""
        out = np.zeros((count, len(self.kinds)))
        for column, entries in enumerate(self.entries):
            for row, part in entries:
                out[row, column] = part
        return out


def _by_limb(parameters: Sequence[Parameter]) -> dict[str, dict[int, int]]:
    """Kinds of number that an effect has for each of several limbs: limb to place. Empty where it has others too.

    A parameter belongs to a limb where its name ends in the limb's number: ``tangential_2``.
    """
    kinds: dict[str, dict[int, int]] = {}
    for place, parameter in enumerate(parameters):
        kind, _, limb = parameter.name.rpartition("_")
        if not kind or not limb.isdigit():
            return {}
        kinds.setdefault(kind, {})[int(limb)] = place
    limbs = {tuple(sorted(one)) for one in kinds.values()}
    return kinds if len(limbs) == 1 and len(limbs.pop()) > 1 else {}


def _forms(kinds: dict[str, dict[int, int]]) -> list[_Form]:
    """Every form, of each kind of number alone and of all of them together."""
    limbs = tuple(sorted(next(iter(kinds.values()))))
    chosen = [(kind,) for kind in kinds] + ([tuple(kinds)] if len(kinds) > 1 else [])
    out = []
    for some in chosen:
        signs: list[tuple[str, dict[int, float]]] = [("common", dict.fromkeys(limbs, 1.0))]
        signs += [("one", {limb: 1.0}) for limb in limbs]
        signs += [("opposite", {a: 1.0, b: -1.0}) for a, b in combinations(limbs, 2)]
        for name, parts in signs:
            entries = tuple(tuple((kinds[kind][limb], part) for limb, part in parts.items()) for kind in some)
            out.append(_Form(name, tuple(parts), some, entries))
    return out


def _combination(effect: Effect, theta: Floats, c: Floats, size: Floats) -> SimplestForm | None:
    """The combinations that are known, where not every single number is. ``theta``, ``c`` in plausible sizes."""
    std = np.sqrt(np.diag(c))
    if (std < _KNOWN).all():
        return None
    variance, axes = linalg.eigh(c)
    values = []
    for k in np.flatnonzero(np.sqrt(variance.clip(0.0)) < _KNOWN)[:2]:
        order = np.argsort(-np.abs(axes[:, k]))
        top = int(order[0])
        # what is said is known of what is written, not of what was left out and rounded
        parts, spread = _written(
            axes[:, k] / axes[top, k] / size * size[top], order, c * np.outer(size, size), _KNOWN * size[top]
        )
        what = " ".join(_part(float(parts[j]), effect.parameters[j].name, j == top) for j in order if parts[j])
        factor, unit = _shown(effect.parameters[top])
        if spread < _KNOWN * size[top]:
            factor /= size[top]
            value = factor * float(parts @ (theta * size))
            values.append(Value(what, value, factor * spread, unit, int(np.count_nonzero(parts))))
    if not values:
        return None
    top = int(np.argmin(std))
    return SimplestForm(
        effect, "combination", (), tuple(values), _shown(effect.parameters[top])[0] * float(std[top]), 1.0
    )


def _written(parts: Floats, order: Ints, covariance: Floats, known: float) -> tuple[Floats, float]:
    """A combination as it is written, its rounded parts (n,), and its deviation, ``known`` below that size."""
    best = float(np.sqrt(parts @ covariance @ parts))
    for digits in (2, 3, 4):
        whole = np.array([float(f"{part:.{digits}g}") for part in parts.tolist()])
        for count in range(1, len(order) + 1):
            written = np.zeros(len(parts))
            written[order[:count]] = whole[order[:count]]
            spread = float(np.sqrt(written @ covariance @ written))
            if spread <= _WRITTEN * best or (count == _READ and spread < known):
                return written, spread
    return whole, spread


def _part(part: float, name: str, first: bool) -> str:
    size = "" if abs(part) == 1.0 else f"{abs(part):.4g} "
    sign = "-" if part < 0 else "" if first else "+"
    return f"{sign}{'' if first else ' '}{size}{name}"


def _shown(parameter: Parameter) -> tuple[float, str]:
    """What turns a plausible size of a parameter into the unit in which people read it; angles are read in degrees."""
    return (float(np.rad2deg(parameter.size)), "°") if parameter.unit == "rad" else (parameter.size, parameter.unit)


def _place(effect: Effect) -> str:
    """What an effect has a number for."""
    return "joint" if effect.link == "joints" else "limb"


def _called(effect: Effect, kind: str, kinds: dict[str, dict[int, int]]) -> str:
    """The number in words: ``tangential rail lean``; of an effect that has one kind alone, its name."""
    words = effect.name.replace("_", " ")
    return words if len(kinds) == 1 else f"{kind.replace('_', ' ')} {words}"


def _where(form: str, at: tuple[int, ...], place: str) -> str:
    if form == "common":
        return "common"
    if form == "one":
        return f"{place} {at[0]} alone:"
    if form == "opposite":
        return f"{place} {at[0]} against {place} {at[1]}:"
    return "best known:"
