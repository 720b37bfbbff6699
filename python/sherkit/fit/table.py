"""A fit as a table for people: every parameter with both its deviations, what the fit rests on, and the combinations of
parameters that it knows badly or not at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from ..base import linalg
from ..base.figures import in_people_units, with_error
from ..base.types import Floats
from ..model.effect import Parameter
from .forms import known

# -- Directions that are badly known, or not at all ------------------------------------------------------------------

#: Parameters whose share of a direction is below this fraction of the largest are not named.
_NAMED = 0.3
#: How many badly observed directions are worth reading.
_MOST = 5


@dataclass(frozen=True)
class Direction:
    """A combination of parameters. ``change`` maps each named parameter to its part, in its own unit.

    ``std`` is how far the combination may move by one standard deviation, all its parts taken together in ``unit``
    (of a robot: millimetres); infinite where the readings do not change at all.
    """

    change: dict[str, float]
    std: float
    unit: str

    def __str__(self) -> str:
        names = list(self.change)
        if len(names) == 1:
            joined = f"{names[0]} alone"
        else:
            first = np.sign(self.change[names[0]])
            along = [n for n in names if np.sign(self.change[n]) == first]
            against = [n for n in names if n not in along]
            joined = _and(along) + (f" against {_and(against)}" if against else " together")
        return joined if np.isinf(self.std) else f"{joined}: {self.std:.2g} {self.unit}"


def badly_observed(
    parameters: Sequence[Parameter], covariance: Floats, sensitivities: tuple[Floats, str]
) -> tuple[Direction, ...]:
    """The principal axes of the covariance, worst first.

    Axes are listed down to a tenth of the worst. ``covariance`` (p, p) in the parameters' own units; ``sensitivities``
    turn each into one common unit, which they name.
    """
    lever, _ = sensitivities
    variance, axes = linalg.eigh(covariance * np.outer(lever, lever))
    out: list[Direction] = []
    for k in np.argsort(variance)[::-1][:_MOST]:
        std = float(np.sqrt(max(variance[k], 0.0)))
        if std <= 0 or (out and std < 0.1 * out[0].std):
            break
        out.append(_named(parameters, axes[:, k] * std, sensitivities, std))
    return tuple(out)


def unobserved(
    parameters: Sequence[Parameter], basis: Floats, sensitivities: tuple[Floats, str]
) -> tuple[Direction, ...]:
    """The null space in as few names as possible. ``basis`` (m, p) in units of plausible size.

    Any basis of the null space is as good as another; the one shown has been brought to echelon form from
    the last parameter on, so that each direction has a parameter that no other one has.
    """
    lever, _ = sensitivities
    size = np.array([p.size for p in parameters])
    rows = np.array(basis, dtype=float) * size * lever
    pivots: list[int] = []
    for k in range(len(rows)):
        scores = np.abs(rows[k:]).max(axis=0)
        scores[pivots] = 0.0
        # the last parameter with a fair share: where the sensor stands comes last and is the natural handle
        pivot = int(np.flatnonzero(scores >= _NAMED * scores.max())[-1])
        best = k + int(np.argmax(np.abs(rows[k:, pivot])))
        rows[[k, best]] = rows[[best, k]]
        rows[k] /= rows[k, pivot]
        for other in range(len(rows)):
            if other != k:
                rows[other] -= rows[other, pivot] * rows[k]
        pivots.append(pivot)
    return tuple(_named(parameters, row, sensitivities, float("inf")) for row in rows)


def _named(parameters: Sequence[Parameter], moved: Floats, sensitivities: tuple[Floats, str], std: float) -> Direction:
    lever, unit = sensitivities
    order = np.argsort(-np.abs(moved))
    named = [int(k) for k in order if abs(moved[k]) >= _NAMED * abs(moved[order[0]])]
    sign = np.sign(moved[named[0]])
    return Direction({parameters[k].name: float(sign * moved[k] / lever[k]) for k in named}, std, unit)


def _and(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


# -- The table -------------------------------------------------------------------------------------------------------

#: A parameter counts as observed where no more than this part of its plausible variance is unobserved, and as
#: unobserved from one less this part on.
_OBSERVED = 1e-3
#: Deviations from zero from which on a number of an effect is one by itself.
_CLEAR = 3.0
_COLUMNS = ("parameter", "nominal", "deviation", "value", "± readings", "± total", "unit", "")
#: Correlations that are told: so many, of this size at least.
_CORRELATIONS, _LEAST = 5, 0.1


def parameter_table(fit: Any) -> str:
    """Text of some lines for a :class:`~sherkit.fit.identify.Fit`: errors, noise, rank, then each parameter: as it is
    drawn, where the robot's file says so, by how much it is off, and both together; and the strongest correlations.

    ``± readings`` is the standard deviation that the readings leave, ``± total`` that with what they do not tell at
    all, from plausible sizes. Angles are in degrees; numbers to compute with are in
    :attr:`~sherkit.fit.identify.Fit.params`. A parameter is ``observed``, ``in part`` or ``unobserved`` by the
    readings, or ``fixed``; of an effect of which a simpler form is ``known``, which has a line of its own, it may be
    known ``not by itself``.
    """
    layout = fit.data.layout
    named = dict(zip(layout.readings, layout.names, strict=True))
    errors = ", ".join(f"{named[name]} {value:.4g}" for name, value in fit.rms().items())
    origin = {"declared": "as declared", "repeats": "from repeats", "unknown": "unknown: every reading weighs the same"}
    effects = ", ".join(e.name for e in fit.model.effects)
    condition = f", condition number {fit.condition_number:.2g}" if np.isfinite(fit.condition_number) else ""
    about = [
        ("fit", f"{len(fit.parameters)} parameters to {len(fit.data)} rows of {fit.data.source}"),
        ("effects", effects or "none"),
        ("loss", fit.loss + _knowledge(fit.priors)),
        ("error", str(fit.error)),
        ("fitted", f"{errors} {layout.unit} RMS"),
        ("noise", f"{origin[fit.noise.origin]}; reduced χ² {fit.scale**2:.3g}"
         if fit.noise.origin != "unknown" else origin["unknown"]),
        ("rank", f"{fit.rank} of {len(fit.parameters)}{condition}"),
        *((name, said) for name, said in (("lacking", fit.lacking), ("supported", fit.overparametrised)) if said),
        ("converged", f"{'yes' if fit.converged else 'NO'}, {fit.evaluations} evaluations"),
    ]  # fmt: skip
    drawn = _nominal(fit.model)
    lines: list[tuple[str, ...]] = [_COLUMNS]
    for p, value, readings, sizes, state in zip(
        fit.parameters, fit.values, fit.std_from_readings, fit.std, _states(fit), strict=True
    ):
        lines.append((p.name, *_cells(p.unit, drawn.get(p.name), value, readings, sizes), state))
    for name, one in known(fit).items():
        for value in one.values:
            cells = _cells(value.unit, None, value.value, value.std, value.std)
            lines.append((f"{name}: {one.where} {value.what}", *cells, "known"))
    for p in fit.model.fixed:
        as_drawn = _as_drawn(p.unit, drawn.get(p.name))
        lines.append((p.name, as_drawn, "0", as_drawn, "", "", in_people_units(p.unit)[0], "fixed"))
    widths = [max(len(line[k]) for line in lines) for k in range(len(_COLUMNS))]
    words = (True, *[False] * 5, True, True)
    head = [f"{name:<10} {text}" for name, text in about]
    body = [
        "  ".join(
            cell.ljust(width) if left else cell.rjust(width)
            for cell, width, left in zip(line, widths, words, strict=True)
        ).rstrip()
        for line in lines
    ]
    return "\n".join([*head, "", *body, *_correlated(fit)])


def _knowledge(part: float) -> str:
    """What a fit takes for known of the drawing, within a part of the plausible sizes."""
    if not part:
        return ""
    return f", with {'' if part == 1.0 else f'{part:.2g} of the '}plausible sizes as knowledge"


def _nominal(model: Any) -> dict[str, float]:
    """Geometric parameters as the robot is drawn, by name, where it says them."""
    robot = getattr(model, "robot", None)
    names, values = getattr(robot, "parameter_names", ()), getattr(robot, "geometry", ())
    return dict(zip(names, map(float, values), strict=True)) if len(names) == len(values) else {}


def _as_drawn(unit: str, value: float | None) -> str:
    return "" if value is None else f"{in_people_units(unit)[1] * value:.6g}"


def _cells(unit: str, drawn: float | None, off: float, readings: float, total: float) -> tuple[str, ...]:
    """A parameter as drawn, by how much it is off, both together, and the deviations; all but the first rounded to what
    the readings leave; then the unit in which people read them."""
    shown, factor = in_people_units(unit)
    known = off if drawn is None else drawn + off
    deviation, std, other, value = with_error(*(factor * float(v) for v in (off, readings, total, known)))
    return _as_drawn(unit, drawn), deviation, "" if drawn is None else value, std, other, shown


def _correlated(fit: Any) -> list[str]:
    """The strongest correlations between parameters, from readings and plausible sizes."""
    covariance = fit.covariance + fit.unobserved_covariance
    std = np.sqrt(np.diag(covariance).clip(0.0))
    known = np.where(std > 0, std, np.inf)
    pairs = np.triu(covariance / np.outer(known, known), 1)
    names = [p.name for p in fit.parameters]
    strongest = np.argsort(-np.abs(pairs), axis=None, kind="stable")[:_CORRELATIONS]
    told = [(pairs.flat[k], *np.unravel_index(k, pairs.shape)) for k in strongest]
    lines = [f"  {names[i]}, {names[j]}: {value:+.3f}" for value, i, j in told if abs(value) >= _LEAST]
    return ["", "correlations", *lines] if lines else []


def parameter_frame(fit: Any) -> pl.DataFrame:
    """The same for programs, without the forms; see :attr:`~sherkit.fit.identify.Fit.params`."""
    parameters, held = (*fit.parameters, *fit.model.fixed), len(fit.model.fixed)
    return pl.DataFrame(
        {
            "name": [p.name for p in parameters],
            "value": [*fit.values.tolist(), *[0.0] * held],
            "std_from_readings": [*fit.std_from_readings.tolist(), *[None] * held],
            "std": [*fit.std.tolist(), *[None] * held],
            "unit": [p.unit for p in parameters],
            "plausible": [float(p.size) for p in parameters],
            "state": [*_states(fit), *["fixed"] * held],
        }
    )


def _states(fit: Any) -> list[str]:
    """What the readings tell of each parameter by itself."""
    forms = known(fit)
    unseen = np.diag(fit.unobserved_covariance) / np.array([p.size for p in fit.parameters]) ** 2
    clear = np.abs(fit.values) > _CLEAR * fit.std
    return [
        _state(float(unseen[k])) if clear[k] or p.name.partition(".")[0] not in forms else "not by itself"
        for k, p in enumerate(fit.parameters)
    ]


def _state(unseen: float) -> str:
    if unseen <= _OBSERVED:
        return "observed"
    return "unobserved" if unseen >= 1.0 - _OBSERVED else "in part"
