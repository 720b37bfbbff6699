"""An effect: a physical cause of error with its parameters, as data, and for a user's own one a function, from a file
where it stands in one.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from ..base.arguments import validate_arguments
from ..base.figures import listed, nearest, stated
from ..base.notebook import Shown
from ..base.types import Floats
from ..data.columns import unit_in
from ..errors import EffectError, SherkitError
from .python_file import NamedObject, named, run_python
from .rows import handed_on_run, seen_at

#: What is searched for besides parameters: a moment, a lag, a period, or a period for each joint that has waves.
Setting = float | tuple[float, ...]

# -- Parameters of a model ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Parameter:
    """One identifiable quantity. Its value is a deviation from the drawing, zero where the drawing is right.

    ``size`` is a plausible size in ``unit``: it weighs directions that no measurement observes and, where
    priors are asked for, is the standard deviation of the prior. Of one that is ``known`` it is a measurement, one more
    row of every fit. ``lever_mm`` turns the unit into the millimetres it moves in this robot, so that directions of
    mixed units can be compared.
    """

    name: str
    symbol: str
    unit: str
    size: float
    lever_mm: float = 1.0
    known: bool = False


def as_written(settings: Mapping[str, Setting | None]) -> dict[str, float | list[float]]:
    """Settings as a file has them: one number, or a list; those alone that there are."""
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in settings.items() if value is not None
    }  # fmt: skip


# -- Effects ---------------------------------------------------------------------------------------------------------

#: Two words of which the sign of a value chooses one.
_WAYS = re.compile(r"\b(\w+)/(\w+)\b")

#: What belongs to the model of a robot that has it: no effect that may be missing.
WITHIN = frozenset({"datum", "sensor_pose"})

LINKS = ("joints", "structure", "body", "sensor")
#: Links at which a NumPy function can act, and the columns of what it gives, one row for each row of the run.
USER_LINKS = {
    "joints": "one column for each joint, in the unit of its reading",
    "body": "x, y, z of the displacement of the measured point, mm",
    "sensor": "one column for each reading, in its unit",
}

#: A user's function: rows (attributes ``joints``, ``time``, every covariate by name) and parameters → what it adds at
#: its link, see :data:`USER_LINKS`.
Function = Callable[[Any, SimpleNamespace], Any]


@dataclass(frozen=True)
class Sentences:
    """What a person is told of an effect: what it is, what it leaves in the residuals, what to do in the workshop."""

    physics: str
    residuals: str
    remedy: str
    #: By the name of a parameter without its limb or axis: what its value means, with ``{k}`` for that, ``{size}``, and
    #: the two ``ways`` of its sign as ``longer/shorter``.
    sizes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Effect(Shown):
    """A physical effect at one link of the measurement chain.

    ``parameters`` carry unit and plausible size; inside a model their names are prefixed (``rail_lean.radial_1``).
    ``needs`` are the covariates without which it cannot be told. ``search`` names a setting that is looked for
    besides the parameters (``time_s``, ``lag_s``, or ``period_mm`` or ``period_rad`` of a wave of each joint).
    ``function`` is set for effects given in NumPy. One that ``frees`` is no physics of its own: its parameters are the
    model's, which were held at the drawing. One that ``goes_with`` another is in no model without that: its setting is
    the other's.
    """

    name: str
    link: str
    parameters: tuple[Parameter, ...]
    needs: tuple[str, ...] = ()
    physics: str = ""
    residuals: str = ""
    remedy: str = ""
    sizes: Mapping[str, str] = field(default_factory=dict, hash=False, repr=False)
    search: str | None = None
    frees: bool = False
    goes_with: str = ""
    function: Function | None = field(default=None, repr=False)
    derivative: Callable[[Any, SimpleNamespace], Any] | None = field(default=None, repr=False)

    def __reduce__(self) -> tuple[Any, ...]:
        """A user's effect is found again by its name in its file, as Python finds functions; others by their fields."""
        made = {one.name: getattr(self, one.name) for one in fields(self)}
        if self.function is None:
            return _made, (made,)
        place = named(self.function.__module__, getattr(self.function, "__qualname__", ""))
        own = None if place is None else place.found()
        if place is None or not isinstance(own, Effect) or own.function is not self.function:
            return _made, (made,)
        others = {key: value for key, value in made.items() if value is not getattr(own, key)}
        return _found, (place, others)

    @property
    def is_periodic(self) -> bool:
        """Whether it is sine and cosine of each joint reading, joint by joint, with a period that can be searched."""
        return self.search is not None and self.search.startswith("period_")

    @property
    def is_lagging(self) -> bool:
        """Whether it follows the temperature with a time constant that can be searched."""
        return self.search == "lag_s"

    def waving(self, joints: Sequence[str]) -> list[int]:
        """Which of these joints, by the names of their readings, are in the unit of its period: those that it moves."""
        unit = (self.search or "").removeprefix("period_")
        return [k for k, name in enumerate(joints) if unit_in(name) == unit]

    def in_words(self, parameter: str, value: float, std: float, unit: str) -> str:
        """What a value of one of its parameters is in the workshop ("rail 3 leans sideways by 0.81 ± 0.01°"); empty
        where nobody has said."""
        for stem, said in self.sizes.items():
            if parameter == stem or parameter.startswith(f"{stem}_"):
                chosen = _WAYS.sub(lambda found: found[1 + (value < 0)], said)
                size = stated(value if chosen == said else abs(value), std, unit)
                return chosen.format(k=parameter[len(stem) + 1 :], size=size)
        return ""

    def qualified(self) -> tuple[Parameter, ...]:
        """The parameters under the names they have in a model."""
        if self.frees:
            return self.parameters
        return tuple(
            Parameter(f"{self.name}.{p.name}", p.symbol or p.name, p.unit, p.size, p.lever_mm) for p in self.parameters
        )

    @property
    def parts(self) -> dict[str, list[int]]:
        """The numbers of its parameters by what each is of alone: a limb or a joint by its number or its name, one of
        what an instrument reads wrong, of how one joint moves another, or of what was held, by its own name. None where
        it has not several, or a number of all."""
        out: dict[str, list[int]] = {}
        for k, p in enumerate(self.parameters):
            part = p.name.rpartition("_")[2]
            if not part.isdigit():
                by_itself = self.link == "sensor" or self.frees or "_by_" in p.name
                # a wave of one joint is what any bend of it looks like
                of_joint = self.link == "joints" and self.function is None and not self.is_periodic
                part = p.name if by_itself else p.name.partition("_")[2] if of_joint else ""
            out.setdefault(part, []).append(k)
        return out if len(out) > 1 and "" not in out else {}

    def of(self, numbers: Sequence[int]) -> Effect:
        """These numbers of it alone."""
        return replace(self, parameters=tuple(self.parameters[k] for k in numbers))

    def evaluate(self, rows: Any, values: Floats, axes: int) -> Floats:
        """What a NumPy effect adds at its link (n, axes), see :data:`USER_LINKS`.

        Raises :class:`EffectError` naming effect and what is wrong.
        """
        if self.function is None:
            raise EffectError(f"effect '{self.name}' is built in and computed by the core")
        names = [p.name for p in self.parameters]
        p = SimpleNamespace(**dict(zip(names, values.tolist(), strict=True)))
        try:
            out = np.asarray(self.function(seen_at(self.link, rows), p))
        except EffectError as error:
            raise EffectError(f"effect '{self.name}': {error}") from error
        except SherkitError:
            raise
        except (Exception, SystemExit) as error:
            raise EffectError(f"effect '{self.name}' failed: {type(error).__name__}: {error}") from error
        n = len(rows)
        if out.shape != (n, axes):
            raise EffectError(
                f"effect '{self.name}': expected an array of shape ({n}, {axes}), got {out.shape}; at the link "
                f"'{self.link}' it is {USER_LINKS[self.link]}"
            )
        out = out.astype(float)
        wrong = ~np.isfinite(out).all(axis=1)
        if wrong.any():
            # a row that was marked since no model reaches it has no position either
            out[wrong & handed_on_run(rows).outlier] = 0.0
            wrong &= ~handed_on_run(rows).outlier
        if wrong.any():
            row = int(np.argmax(wrong))
            raise EffectError(f"effect '{self.name}' is not finite at row {row}")
        return out

    def columns_at_zero(self, rows: Any, axes: int) -> Floats:
        """Derivatives (n, axes, p) of a NumPy effect that is not in the model.

        Raises :class:`EffectError` also where none of its parameters moves anything in these rows.
        """
        out = self.columns(rows, np.zeros(len(self.parameters)), axes)
        self.require_moving(out)
        return out

    def require_moving(self, columns: Floats) -> None:
        """Raises :class:`EffectError` where these derivatives are all zero."""
        if not columns.any():
            raise EffectError("its parameters move nothing in these rows")

    def columns(self, rows: Any, values: Floats, axes: int) -> Floats:
        """Derivatives (n, axes, p) of a NumPy effect: the user's own, or central differences of fourth order."""
        names = [p.name for p in self.parameters]
        if self.derivative is not None:
            p = SimpleNamespace(**dict(zip(names, values.tolist(), strict=True)))
            try:
                out = np.asarray(self.derivative(seen_at(self.link, rows), p), dtype=float)
            except SherkitError:
                raise
            except (Exception, SystemExit) as error:
                raise EffectError(
                    f"effect '{self.name}': its derivative failed: {type(error).__name__}: {error}"
                ) from error
            expected = (len(rows), axes, len(names))
            if out.shape != expected or not np.isfinite(out).all():
                raise EffectError(f"effect '{self.name}': derivative: expected finite numbers of shape {expected}")
            return out
        out = np.empty((len(rows), axes, len(names)))
        for k, parameter in enumerate(self.parameters):
            h = 1e-3 * parameter.size
            at = []
            for step in (-2, -1, 1, 2):
                moved = values.copy()
                moved[k] += step * h
                at.append(self.evaluate(rows, moved, axes))
            out[:, :, k] = (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * h)
        return out


def _made(values: dict[str, Any]) -> Effect:
    return Effect(**values)


def _found(place: NamedObject, others: dict[str, Any]) -> Effect:
    """The effect of this place, but for what differs."""
    return replace(place.found(), **others)


def freeing(parameter: Parameter) -> Effect:
    """What a parameter of the model that is held at its drawing does once it is free."""
    name = parameter.name
    return Effect(
        name=f"free {name}",
        link="structure",
        parameters=(parameter,),
        frees=True,
        physics=f"{name} is held at the drawing, and the robot is not as drawn there.",
        residuals=f"What a {name} other than the drawing's leaves, as far as no free parameter takes its place.",
        remedy=f"Free it (free=[…, '{name}'], --free {name}), or measure it and correct the robot file.",
    )


class Catalogue(dict[str, Effect], Shown):
    """Effects by name, in the order of the chain; a notebook shows them as a table."""


def catalogue_of_core(table: Sequence[Mapping[str, Any]], sentences: Mapping[str, Sentences]) -> Catalogue:
    """The effects of a compiled table by name, in its order, each with its three sentences.

    A row that every model has (geometry, the sensor's pose) is an effect only where there are sentences for it. Raises
    :class:`~sherkit.errors.EffectError` where table and sentences do not name the same effects.
    """
    rows = {row["name"]: row for row in table if not row["base"] or row["name"] in sentences}
    if differing := set(rows) ^ set(sentences):
        raise EffectError(f"effects of the core and their sentences differ: {listed(sorted(differing), 12)}")
    out = Catalogue()
    for name, row in rows.items():
        effect = Effect(
            name=name,
            link=row["link"],
            parameters=parameters_of_core(row),
            needs=tuple(row["needs"]),
            search=row["search"],
            physics=sentences[name].physics,
            residuals=sentences[name].residuals,
            remedy=sentences[name].remedy,
            sizes=sentences[name].sizes,
        )
        out |= _joint_by_joint(effect) if name == _SECOND_WAVE else {name: effect}
    return out


#: The row of a table that is an effect of each joint by itself, and the effect that it goes with.
_SECOND_WAVE, _FIRST_WAVE = "encoder_second", "encoder_cyclic"


def _joint_by_joint(effect: Effect) -> dict[str, Effect]:
    """The second wave as an effect of each joint, since one gear has it and another has none."""
    waves = [effect.parameters[k : k + 2] for k in range(0, len(effect.parameters), 2)]
    each = {f"{effect.name}_{wave[0].name.partition('_')[2]}": wave for wave in waves}
    return {name: replace(effect, name=name, parameters=wave, goes_with=_FIRST_WAVE) for name, wave in each.items()}


def effects_of_row(catalogue: Mapping[str, Effect], name: str) -> list[Effect]:
    """The effects of a catalogue that are one row of the compiled table, in the order of its parameters."""
    if name != _SECOND_WAVE:
        return [catalogue[name]]
    return [effect for effect in catalogue.values() if effect.name.startswith(name)]


def parameters_of_core(
    row: Mapping[str, Any], own_lever: Callable[[str], float] = lambda _: 1.0
) -> tuple[Parameter, ...]:
    """The parameters of a row of a compiled table; ``own_lever`` knows the levers that depend on the robot."""
    return tuple(
        Parameter(
            p["name"],
            p["symbol"],
            p["unit"],
            p["size"],
            own_lever(p["name"]) if p["lever_mm"] is None else p["lever_mm"],
        )
        for p in row["parameters"]
    )


#: Part of its plausible size at which an effect is asked twice, and by which part of the largest both may differ:
#: threads may sum in another order.
_TRIED, _SAME = 1e-3, 1e-9


def check_user_effect(effect: Effect, rows: Any, axes: int) -> None:
    """What a user's effect must pass on these rows: zero at zero, right shape, finite, the same when it is asked again,
    derivative that agrees.

    Raises :class:`~sherkit.errors.EffectError` with a sentence on what is wrong.
    """
    zero = np.zeros(len(effect.parameters))
    if np.abs(effect.evaluate(rows, zero, axes)).max(initial=0.0) > 0:
        raise EffectError(f"effect '{effect.name}' is not zero where its parameters are zero")
    sizes = np.array([p.size for p in effect.parameters])
    once, again = (effect.evaluate(rows, _TRIED * sizes, axes) for _ in range(2))
    if np.abs(once - again).max(initial=0.0) > _SAME * np.abs(once).max(initial=0.0):
        raise EffectError(
            f"effect '{effect.name}' gives another answer each time it is asked the same: draw no random numbers in it "
            "and keep nothing from one call to the next"
        )
    if effect.derivative is not None:
        numeric = replace(effect, derivative=None).columns(rows, 0.3 * sizes, axes)
        given = effect.columns(rows, 0.3 * sizes, axes)
        scale = np.abs(numeric).max(initial=1e-300)
        if np.abs(given - numeric).max(initial=0.0) > 1e-4 * scale:
            raise EffectError(f"effect '{effect.name}': its derivative does not agree with a difference")


@validate_arguments
def effect(
    *,
    at: str,
    parameters: Mapping[str, str | tuple[str, float]],
    needs: tuple[str, ...] = (),
    physics: str = "",
    remedy: str = "",
    derivative: Callable[[Any, SimpleNamespace], Any] | None = None,
) -> Callable[[Function], Effect]:
    """Makes a NumPy function of a few lines an effect with the standing of the built-in ones.

    ``at`` is the link, and the function gives what is added there: at ``joints`` (n, k) to the readings of k joints, mm
    or rad as they are; at ``body`` (n, 3) mm to the measured point; at ``sensor`` (n, m) to what is read, in its unit:
    (n, 3) mm of a delta, (n, 2) px or rad of a spherical robot, the readings of any other machine. ``parameters`` maps
    names to units, or to (unit, plausible size). Raises :class:`~sherkit.errors.EffectError` for an unknown link, no
    parameter, or a size that is not positive.

        @sk.effect(at="body", parameters={"amplitude": "mm"})
        def floor_heave(rows, p):
            return p.amplitude * np.outer(np.sin(2 * np.pi * rows.time / 86400), [0, 0, 1])
    """
    if at not in USER_LINKS:
        raise EffectError(f"effect: at='{at}' is no link for a NumPy function; choose {', '.join(USER_LINKS)}")
    if not parameters:
        raise EffectError("effect: give it at least one parameter with its unit")

    def wrap(function: Function) -> Effect:
        made = []
        for name, unit in parameters.items():
            text, size = unit if isinstance(unit, tuple) else (unit, _SIZES.get(unit, 1.0))
            if size <= 0.0:
                raise EffectError(f"effect: the plausible size of '{name}' is {size:g} {text}; give a positive number")
            made.append(Parameter(name, name, text, float(size)))
        return Effect(
            name=getattr(function, "__name__", "effect"),
            link=at,
            parameters=tuple(made),
            needs=needs,
            physics=physics or (function.__doc__ or "").strip(),
            remedy=remedy,
            function=function,
            derivative=derivative,
        )

    return wrap


def effects_by_name(
    catalogue: Mapping[str, Effect], names: Sequence[str], own: Sequence[Effect] = ()
) -> tuple[Effect, ...]:
    """Effects of a catalogue and the user's by name. Raises :class:`EffectError` with the nearest name."""
    known = {**catalogue, **{e.name: e for e in own}}
    for effect in own:
        if effect.name in catalogue:
            raise EffectError(f"'{effect.name}' is the name of a built-in effect; give yours another")
    out = []
    for name in names:
        if name in WITHIN:
            raise EffectError(f"'{name}' is in the model already: it belongs to the default model")
        if name not in known:
            raise EffectError(f"'{name}' is not a known effect{nearest(name, known)}; known: {listed(known, 30)}")
        out.append(known[name])
    return tuple(out)


def named_effects(catalogue: Mapping[str, Effect], effects: Sequence[str | Effect]) -> tuple[Effect, ...]:
    """Effects given by name or as they are. Raises :class:`EffectError` for what is neither."""
    if isinstance(effects, str):
        raise EffectError(f"effects: expected a list of effects, got the text {effects!r}; did you mean [{effects!r}]?")
    out = []
    for one in effects:
        if not isinstance(one, str | Effect):
            raise EffectError(f"effects: expected names or effects, got {type(one).__name__}")
        out.append(one if isinstance(one, Effect) else effects_by_name(catalogue, (one,))[0])
    return tuple(out)


#: Plausible sizes where the user gives only a unit.
_SIZES = {"mm": 0.1, "um": 100.0, "µm": 100.0, "rad": 0.01, "deg": 0.5, "": 0.01}


# -- A user's effects from a Python file ---------------------------------------------------------------------------


def own_effect(name: str) -> Effect | None:
    """The user's effect of this name that stands at the top of a module of this process; nothing is run to find it."""
    for module in list(sys.modules.values()):
        for value in list(vars(module).values()) if isinstance(module, ModuleType) else ():
            if isinstance(value, Effect) and value.function is not None and value.name == name:
                return value
    return None


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """The effects that a Python file defines with ``@sk.effect``, in the order of their definition.

    Raises :class:`~sherkit.errors.EffectError` where the file is not there, fails, or defines none.
    """

    def take(module: ModuleType) -> tuple[Effect, ...]:
        found = tuple(v for v in vars(module).values() if isinstance(v, Effect) and v.function is not None)
        if not found:
            raise EffectError(f"{path}: defines no effect; expected a function under @sk.effect(...)")
        return found

    return run_python(path, "effects", take, EffectError)
