"""What of a printer and its plate could stand behind what a calibration leaves: each is fitted, and those that come as
near the data as the best are said together.

A plate that is bent and a frame that is not square leave much the same on one mesh. So whatever is left is given to
each of them in turn: the best is who leaves least, with each number for nothing, at what it takes of noise in the mean,
or at what it must bring to be worth it (Schwarz, "Estimating the dimension of a model", 1978), and tied with it is
whoever is not clearly worse by either (Kass and Raftery, "Bayes factors", JASA 1995). Whether anything is left at all
the diagnosis says, at its level."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from ...data import Measurements
from ...errors import FitError, SherkitError
from ...fit.identify import Fit, identify
from ...model.effect import Effect
from .model import PrinterModel, bed_shape
from .robot import PLATE, Printer

#: So many usual sizes are still plausible.
_PLAUSIBLE = 5.0
#: Difference of Schwarz's criterion that counts as clear.
_CLEARLY = 6.0


@dataclass(frozen=True, eq=False)
class Suspect:
    """One thing, or two together, that may be behind what the ``plain`` fit leaves; ``fit`` has it in the model."""

    effects: tuple[Effect, ...]
    fit: Fit
    plain: Fit

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its effects."""
        return tuple(e.name for e in self.effects)

    @property
    def is_plausible(self) -> bool:
        """Whether none of its numbers is far beyond what is usual, give or take two deviations."""
        fit = self.fit
        return all(
            abs(fit.values[k]) - 2.0 * fit.std_from_readings[k] <= _PLAUSIBLE * p.size
            for effect in self.effects
            for k, p in enumerate(fit.parameters)
            if p.name.startswith(f"{effect.name}.")
        )

    @cached_property
    def alone(self) -> float:
        """Schwarz's criterion without a price on the numbers."""
        left = self.fit.residuals[self.fit.data.used]
        # what the plain fit has used up is no reading any more
        return float((len(left) - self.plain.rank) * np.log(np.mean(left**2)))

    @property
    def numbers(self) -> int:
        """How many its effects have."""
        return sum(len(e.parameters) for e in self.effects)

    @property
    def fair(self) -> float:
        """Schwarz's criterion with each number at what it takes of noise in the mean."""
        return self.alone + self.numbers

    @property
    def priced(self) -> float:
        """Schwarz's criterion."""
        return self.alone + self.numbers * float(np.log(self.fit.data.used.sum()))


def suspects(plain: Fit, *, significant: bool) -> tuple[Suspect, ...]:
    """Those that explain what the ``plain`` fit leaves, the likeliest first, and tied with it the others; none where
    nothing is clearly better than the plain fit.

    Where a diagnosis says that something ``significant`` is left, it is enough to take more of it than chance would;
    else a suspect must be worth its numbers.
    """
    model, data = plain.model, plain.data
    nothing = Suspect((), plain, plain)
    tried, _ = model.is_testable(tuple(model.known_effects.values()), data)
    found = _leading(nothing, _fitted(nothing, [(effect,) for effect in tried]), significant=significant)
    plate = [e for e in tried if e.name == bed_shape.name]
    # plate and machine both, where that is clearly better than either, told by its numbers' worth
    both = [(one, *plate) for one in tried if plate and one not in plate]
    pairs = _fitted(nothing, both) if found else []
    best = min((s.priced for s in found), default=np.inf)
    clear = [p for p in pairs if p.is_plausible and p.priced < best - _CLEARLY]
    return _leading(nothing, clear, significant=significant) if clear else found


def _fitted(nothing: Suspect, sets: list[tuple[Effect, ...]]) -> list[Suspect]:
    out, plain = [], nothing.fit
    for effects in sets:
        model = reduce(lambda one, effect: one.with_effect(effect), effects, plain.model)
        start = [plain.by_name.get(p.name, 0.0) for p in model.parameters]
        try:
            fit = identify(model, plain.data, noise=plain.noise, start=start)
        except SherkitError:
            continue
        # what has as many numbers as rows explains whatever there is; short of that it counts, though it may fit noise:
        # few points must not leave the plate out, and the machine alone to be blamed
        # and what moves nothing that was measured, as callipers do where there are no distances, is nobody
        if fit.data.used.sum() > fit.rank > nothing.fit.rank:
            out.append(Suspect(effects, fit, plain))
    return out


def _leading(nothing: Suspect, tried: list[Suspect], *, significant: bool) -> tuple[Suspect, ...]:
    # one of many is better by chance, where no diagnosis says that anything is left
    clearly = _CLEARLY + (0.0 if significant else 2.0 * float(np.log(max(len(tried), 1))))
    # who would have to be absurdly far off is none while somebody else would not
    tried = [s for s in tried if s.is_plausible] or tried
    better = [
        s for s in tried if s.priced < nothing.priced - clearly or (significant and s.alone < nothing.alone - _fair(s))
    ]
    if not better:
        return ()
    # who is no better than nothing by its price, having many numbers, may yet leave as little as the best; and who
    # leaves more may have done without what many numbers take of noise
    alone, fair, priced = (min(getattr(s, one) for s in better) + _CLEARLY for one in ("alone", "fair", "priced"))
    near = [s for s in tried if s.alone < alone or s.fair < fair or (s in better and s.priced < priced)]
    return tuple(sorted(near, key=lambda s: s.priced))


def _fair(one: Suspect) -> float:
    """What so many numbers take of noise, and clearly more."""
    return one.numbers + 2.0 * float(np.sqrt(2.0 * one.numbers)) + _CLEARLY


def plain_fit(robot: Printer, data: Measurements) -> Fit:
    """The printer with what its firmware can hold. Raises :class:`~sherkit.errors.FitError` where too little was
    measured for that, in words."""
    heights = int((~data.between_places).sum())
    numbers = len(PrinterModel(robot).parameters) - 3  # where the middle is and what it faces is no error
    if len(data) <= numbers:
        raise FitError(
            f"{data.source}: {len(data)} measurements ({heights} heights, {len(data) - heights} distances) cannot "
            f"tell the "
            f"{numbers} numbers of a delta, let alone what is wrong beside them; probe a mesh of 7 by 7 points or more "
            "(BED_MESH_CALIBRATE, G29)"
        )
    return identify(robot, data)


def turns(data: Measurements) -> tuple[float, ...]:
    """By how many degrees the plate was turned in this run, each once."""
    found = data.covariates.get(PLATE)
    return () if found is None else tuple(np.unique(found % 360.0).tolist())
