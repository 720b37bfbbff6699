"""What was identified of a robot in one run: values and covariance of its errors, what is left, and what the poses of
the run could not show.

At any place x the deployed model is a linear function of the readings it was made from. An effect with parameters e
that is not in it moves the readings by E e and the place by h(x) e, so that the robot misses x by

    a(x) e,  a(x) = h(x) - g(x) J⁺ E - b(x) B⁺ (I - J J⁺) E,

with the derivatives J at the poses and g at x by the identified parameters, and the functions B and b of a smooth
correction; where the drawing counts as a measurement, J has its rows and E is zero in them. What is known of e is its
plausible size and what the readings say (Rasmussen and Williams, *Gaussian Processes for Machine Learning*, 2.1). The
second moment of a(x) e, less what the same e leaves at the poses, where the held-out residuals hold it already, is what
the poses could not show.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from ..base import linalg
from ..base.figures import listed
from ..base.types import Bools, Floats
from ..data import Measurements
from ..data.columns import TEMPERATURE, TIME, unit_in
from ..data.declared import Key, key, keys_from, keys_of
from ..data.in_time import DRAWN_C
from ..data.toml import Table
from ..fit.identify import Fit
from ..fit.known_stand import off_stand
from ..model.chain import ChainModel
from ..model.effect import Effect, Setting, as_written, effects_by_name
from ..model.kinds import Robot, catalogue_of, kind_of, model_of
from .poses_hull import outermost

# -- What an effect could do between the poses, and did not show at them ------------------------------------------


@dataclass(frozen=True, eq=False)
class BiasBound:
    """What the poses of a run could not show of one effect.

    ``setting`` is its period or its moment, None where it has none. Per unit of its k parameters, ``absorbed`` (p, k)
    is what the identified parameters take, ``corrected`` (c, d, k) what the coefficients of a correction do. ``moment``
    (k, k) is the second moment of the parameters given the readings; ``shown`` (d, d), in the squared unit of the
    coordinates, is what that leaves at the poses. At ``places`` (r, d), coordinates, readings would tell most of it:
    ``left`` is the part that they would leave (root mean square over the place of the run).
    """

    effect: str
    setting: float | None
    absorbed: Floats
    corrected: Floats
    moment: Floats
    shown: Floats
    places: Floats
    left: float

    def called(self, model: ChainModel) -> str:
        """The effect with its period or moment, in words."""
        effect = model.may_be_off[self.effect]
        if self.setting is None or effect.search is None:
            return self.effect
        unit = unit_in(effect.search)
        if effect.is_periodic:
            return f"{self.effect} with a period of {self.setting:.4g} {unit}"
        if effect.is_lagging:
            return f"{self.effect} with a lag of {self.setting:.4g} {unit}"
        return f"{self.effect} at {self.setting:.4g} {unit}"

    def to_table(self) -> dict[str, Any]:
        """For TOML, without loss."""
        return {
            "effect": self.effect,
            **({} if self.setting is None else {"setting": self.setting}),
            "absorbed": self.absorbed.tolist(),
            **({"corrected": self.corrected.tolist()} if len(self.corrected) else {}),
            "moment": self.moment.tolist(),
            "shown": self.shown.tolist(),
            "places": self.places.tolist(),
            "left": self.left,
        }

    @classmethod
    def from_table(cls, table: Table, model: ChainModel, functions: int, size: int) -> BiasBound:
        """Back from :meth:`to_table`: beside a model, with ``functions`` of a correction and ``size`` coordinates.

        Raises what the table raises, naming file and key.
        """
        effect = model.may_be_off[table.text("effect", tuple(model.may_be_off))]
        if not effect.is_periodic and any(one.name == effect.name for one in model.effects):
            raise table.fail("effect", "one that is not in the model")
        k = len(effect.parameters)
        setting = None
        # what comes with a lag is tried without one
        if effect.search is not None and not effect.is_lagging:
            setting = table.number("setting", positive=effect.is_periodic)
        return cls(
            effect=effect.name,
            setting=setting,
            absorbed=table.array("absorbed", len(model.parameters), k),
            corrected=table.array("corrected", functions, size, k) if functions else np.zeros((0, size, k)),
            moment=table.covariance("moment", k),
            shown=table.covariance("shown", size),
            places=np.array(table.rows("places", size), dtype=float).reshape(-1, size),
            left=table.number("left"),
        )

    def largest(self, model: ChainModel) -> tuple[float, float]:
        """How large it is: in plausible sizes of the effect's own parameters and of those that take of it, whichever is
        more, and in the unit of the coordinates."""
        own = [p.size for p in model.may_be_off[self.effect].parameters]
        others = np.array([[p.size] for p in model.parameters])
        errors = np.vstack([np.diag(1.0 / np.array(own)), self.absorbed / others])
        moves = self.corrected.reshape(-1, len(own))
        with np.errstate(over="ignore", invalid="ignore"):
            each, moved = (np.einsum("ik,kl,il->i", by, self.moment, by) for by in (errors, moves))
        far = np.concatenate([moved, np.diag(self.shown)])
        # what is too large for a number is no number here
        largest = [float(np.sqrt(np.nan_to_num(one.clip(0.0), nan=np.inf).max())) for one in (each, far)]
        return largest[0], largest[1]

    def missed(self, by_values: Floats, by_effect: Floats, functions: Floats) -> Floats:
        """a (n, m, k): what readings miss per unit of the parameters, from their derivatives by the identified values
        (n, m, p) and by the effect (n, m, k), and from a correction's functions (n, c)."""
        out = by_effect - by_values @ self.absorbed
        if len(self.corrected):
            out[:, : self.corrected.shape[1]] -= np.tensordot(functions, self.corrected, (1, 0))
        return out

    def beyond(self, missed: Floats) -> Floats:
        """Covariance (n, d, d) beyond what is shown at the poses, for what coordinates miss per unit (n, d, k)."""
        size, axes = linalg.eigh(missed @ self.moment @ missed.transpose(0, 2, 1) - self.shown)
        return np.asarray((axes * size.clip(0.0)[:, None, :]) @ axes.transpose(0, 2, 1))

    def hides(self, missed: Floats) -> float:
        """Mean square of what coordinates miss beyond what is shown."""
        spread = missed @ self.moment @ missed.transpose(0, 2, 1) - self.shown
        return float(linalg.eigvalsh(spread).clip(0.0).sum(axis=1).mean())


def at_rest(
    model: ChainModel, values: Floats, readings: tuple[str, ...], joints: Floats, now: Floats, *,
    stand_warms: bool = False,
) -> tuple[Floats, Floats, Bools]:  # fmt: skip
    """Derivatives of ``readings`` (columns) by the identified values (n, m, p) and by the joints (n, m, j), and which
    rows can be read, of a robot that stands at ``joints`` (n, j) and carries nothing; ``now`` (n, 2 + j) is time,
    temperature, directions. The instrument's stand is as warm as it was drawn, as a loop has it, unless
    ``stand_warms`` with the temperature.
    """
    layout = next((one for one in model.layouts if one.coordinates == readings), model.layouts[0])
    columns = dict(zip((TIME, TEMPERATURE, *layout.directions), now.T, strict=True))
    columns |= {name: np.zeros(len(joints)) for name in (*layout.velocities, *layout.loads)}
    rows = Measurements.planned(joints, layout, **columns)
    q, ends, known, push = model.block(rows)
    if known is not None:
        known[:, -1] = now[:, 1] if stand_warms else DRAWN_C
    block = (q, ends, known, push)
    found, by_joints, _, read = model.core_for(rows).derivatives(model.full(values), block, model.indices)
    m = rows.coordinates
    return found[:, :m], by_joints[:, :m], read


def waves(by_joints: Floats, joints: Floats, period: float, which: list[int]) -> Floats:
    """Derivatives (n, m, 2 w) by sine and cosine of ``which`` (w) of the joints (n, j) at a period, joint by joint,
    from those by the joints (n, m, j)."""
    angle = 2.0 * np.pi / period * joints[:, which]
    both = np.stack([np.sin(angle), np.cos(angle)], axis=2)
    made: Floats = (by_joints[:, :, which, None] * both[:, None]).reshape(*by_joints.shape[:2], -1)
    return made


def with_effect(model: ChainModel, values: Floats, effect: Effect, setting: float | None) -> tuple[Any, Floats, slice]:
    """The model with one more effect, its values with zeros for that, and where they stand."""
    wider = model.adopting(effect, at=setting)
    first = [p.name for p in wider.parameters].index(effect.qualified()[0].name)
    own = slice(first, first + len(effect.parameters))
    return wider, np.insert(values, [own.start] * len(effect.parameters), 0.0), own


def by_effect(
    model: ChainModel, values: Floats, effect: Effect, setting: float | None, readings: tuple[str, ...],
    joints: Floats, now: Floats,
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """As :func:`at_rest`: by the identified values (n, m, p), by an effect's parameters (n, m, k), by the joints
    (n, m, j). A periodic effect may be in the model already, with another period."""
    if effect.is_periodic and setting is not None:
        columns, by_joints, _ = at_rest(model, values, readings, joints, now)
        which = effect.waving(model.layouts[0].joints)
        return columns, waves(by_joints, joints, setting, which), by_joints
    wider, more, own = with_effect(model, values, effect, setting)
    # a stand that nobody identified stood in the run where its temperature had it, and the sensor's pose is that one
    columns, by_joints, _ = at_rest(wider, more, readings, joints, now, stand_warms=effect.is_lagging)
    return np.delete(columns, own, axis=2), columns[:, :, own], by_joints


# -- What was identified ------------------------------------------------------------------------------------------

#: So many plausible sizes are no identified error any more.
_ABSURD = 1e4
#: Readings that are further off than this (mm, px, rad) say nothing.
_LARGEST_RESIDUAL = 1e4


@dataclass(frozen=True, eq=False)
class IdentifiedModel:
    """One identified model: errors by name, their covariance, and what it leaves.

    ``free`` and ``effects`` say what was identified, ``settings`` the settings of the effects; effects given in NumPy
    do not run in a control loop and are listed in ``left_out``. ``now`` holds time, temperature and a direction for
    each joint that stand for the covariates where the loop does not give its own: the end of the run, its mean
    temperature, the middle of the backlash. ``covariance`` (p, p) in the order of ``values``; ``residual_covariance``
    (k, k) of what poses held out miss beyond noise and parameters, ``noise_covariance`` (k, k) of how single readings
    scatter about their pose, both in the unit of the coordinates; where the noise is not known it is in the first.
    ``low`` and ``high`` (k,) are the corners of the box in which the run measured, as coordinates. ``readings`` are the
    columns that instruments showed; ``unobserved_effects`` is what the poses could not show, by effect, and ``untried``
    are effects of which nothing can be said: the run lacks a column that they need.
    """

    free: tuple[str, ...]
    effects: tuple[str, ...]
    settings: dict[str, Setting]
    left_out: tuple[str, ...]
    now: tuple[float, ...]
    values: Floats
    covariance: Floats
    residual_covariance: Floats
    low: Floats
    high: Floats
    made_from: str
    rows: int
    noise_covariance: Floats | None = field(default=None, kw_only=True)
    readings: tuple[str, ...] = field(default=(), kw_only=True)
    unobserved_effects: tuple[BiasBound, ...] = field(default=(), kw_only=True)
    untried: tuple[str, ...] = field(default=(), kw_only=True)
    #: Joints (k, j) of the outermost poses of the run, none where they are not known; and by how much the error of
    #: regions that were left out whole exceeds that of poses among others.
    poses: Floats = field(default_factory=lambda: np.zeros((0, 0)), kw_only=True)
    elsewhere: float = field(default=1.0, kw_only=True)
    #: The values (p,) that have the instrument where it is known not to stand, the others zero: either it stands there,
    #: or they hold what the model lacks. None where there are none.
    off_stand: Floats | None = field(default=None, kw_only=True)
    #: By which the rows of the run are known again; empty in earlier files.
    digest: str = field(default="", kw_only=True)

    @classmethod
    def identified(cls, fit: Fit, size: int, *, shrink: float = 1.0, **own: Any) -> Self:
        """What a fit alone says, of ``size`` coordinates: as if it left nothing, about zero. :meth:`leaving` says the
        rest. ``shrink`` is the part of the readings' own share of the covariance that counts, ``own`` what a kind's
        part has besides."""
        model, data, core = fit.model, fit.data, len(fit.model.indices)
        time, temperature = data.time_s, data.covariates.get(TEMPERATURE)
        return cls(
            free=model.free,
            effects=tuple(e.name for e in model.built_in),
            settings={name: value or 0.0 for name, value in model.settings().items()},
            left_out=tuple(e.name for e in model.own if e in model.effects),
            now=(
                float(time.max()) if time is not None else 0.0,
                float(temperature.mean()) if temperature is not None else 20.0,
                *(0.0 for _ in data.layout.joints),
            ),
            values=fit.values[:core],
            covariance=(fit.covariance * shrink + fit.unobserved_covariance)[:core, :core],
            residual_covariance=np.zeros((size, size)),
            low=np.zeros(size),
            high=np.zeros(size),
            made_from=f"{data.source}, setup {data.last_set_up}" if data.set_ups else data.source,
            rows=len(data),
            digest=data.digest,
            readings=data.layout.coordinates,
            poses=outermost(data.joints[data.used.any(axis=1)]),
            elsewhere=1.0 if fit.elsewhere is None else fit.elsewhere.beside(fit.error),
            off_stand=off if (off := off_stand(fit)[:core]).any() else None,
            **own,
        )

    def leaving(self, left: Floats, scatter: Floats, where: Floats) -> Self:
        """With what poses held out miss (k, k), how single readings scatter (k, k), and the places (n, k) of the run;
        what is not finite in these is none, and without any the box stays."""
        known = where[np.isfinite(where).all(axis=1)]
        box = {"low": known.min(axis=0), "high": known.max(axis=0)} if len(known) else {}
        return replace(self, residual_covariance=left, noise_covariance=scatter, **box)

    @property
    def scatter(self) -> Floats:
        """Covariance (k, k) of single readings about their pose, zero where it is not known."""
        return np.zeros_like(self.residual_covariance) if self.noise_covariance is None else self.noise_covariance

    def model(self, robot: Robot) -> ChainModel:
        """The model that was identified."""
        chosen = effects_by_name(catalogue_of(robot), self.effects)
        return kind_of(robot).model(robot, self.free, chosen, **self.settings)  # type: ignore[arg-type]

    def functions(self, coordinates: Floats) -> Floats:
        """Values (n, c) of the functions that a smooth correction is a sum of; it has none of them by default."""
        return np.zeros((len(coordinates), 0))

    @property
    def corrects(self) -> bool:
        """Whether there is a smooth correction."""
        return self.functions(self.low[None, :]).shape[1] > 0

    @classmethod
    def keys(cls, unit: str, size: int, values: int, joints: int) -> dict[str, Key]:
        """What is kept of it as it is, for so many coordinates, which are in a ``unit``, values and joints."""
        return {
            "made_from": key(Table.words, empty=True),
            "rows": key(Table.whole, least=0),
            "digest": key(Table.words, empty=True),
            "effects": key(Table.texts),
            "left_out": key(Table.texts),
            "covariance": key(Table.covariance, values),
            f"residual_covariance_{unit}2": key(Table.covariance, size).of("residual_covariance"),
            f"noise_covariance_{unit}2": Key(
                lambda table, name: table.covariance(name, size) if table.has(name) else None, "noise_covariance"
            ),
            **cls.own_keys(unit, size),
            f"low_{unit}": key(Table.array, size).of("low"),
            f"high_{unit}": key(Table.array, size).of("high"),
            # earlier files have none: then a box is all that is known
            "poses": Key(
                lambda table, name: np.array(table.rows(name, joints) if table.has(name) else np.zeros((0, 0)), float)
            ),
            "elsewhere": key(Table.number, least=1.0),
            "off_stand": Key(lambda table, name: table.array(name, values) if table.has(name) else None),
            "readings": key(Table.texts).needed,
            "untried": key(Table.texts).needed,
        }

    @classmethod
    def own_keys(cls, unit: str, size: int) -> dict[str, Key]:
        """What the part of a kind of robot keeps besides."""
        del unit, size
        return {}

    def to_table(self, robot: Robot, coordinates: tuple[str, ...]) -> dict[str, Any]:
        """For TOML, without loss."""
        now, p = _now_names(robot), self.model(robot).parameters
        made = keys_of(self, self.keys(unit_in(coordinates[0]), len(coordinates), len(p), len(now) - 2))
        if not len(self.poses):
            del made["poses"], made["elsewhere"]
        std = np.sqrt(np.diag(self.covariance).clip(0.0))
        return made | {
            **({"settings": as_written(self.settings)} if self.settings else {}),
            "now": dict(zip(now, self.now, strict=True)),
            "parameters": [
                {"name": p.name, "value": float(v), "std": float(s), "unit": p.unit}
                for p, v, s in zip(p, self.values, std, strict=True)
            ],
            **self._own_tables(),
            "unobserved_effects": [one.to_table() for one in self.unobserved_effects],
        }

    def _own_tables(self) -> dict[str, Any]:
        return {}

    @classmethod
    def from_table(cls, table: Table, robot: Robot, coordinates: tuple[str, ...]) -> Self:
        """Back from :meth:`to_table`. Raises :class:`~sherkit.errors.CalibrationError` with the key."""
        unit, size = unit_in(coordinates[0]), len(coordinates)
        names, values, told = [], [], []
        for p in table.tables("parameters", optional=False):
            names.append(p.words("name"))
            values.append(p.number("value"))
            # they follow from covariance and model, and must agree with them
            told.append((p.words("unit", empty=True), p.number("std")))
        settings = {}
        known = model_of(robot).settings()
        if known:
            with table.table("settings") as s:
                # what came with a later version was not there
                settings = {name: s.one_or_more(name, 0.0) for name in known}
        with table.table("now") as n:
            now = tuple(n.number(name) for name in _now_names(robot))
        made = cls(
            free=tuple(name for name in names if "." not in name),
            settings=settings,
            now=now,
            values=np.array(values, dtype=float),
            **keys_from(table, cls.keys(unit, size, len(values), len(now) - 2), cls),
            **cls._own_from(table),
        )
        if (made.low > made.high).any():
            raise table.fail(f"low_{unit}", f"nothing above high_{unit}")
        model = made.model(robot)
        expected = [p.name for p in model.parameters]
        if names != expected:
            wrong = next((f for f, e in zip(names, expected, strict=False) if f != e), "a missing one")
            raise table.refuse(f"parameters: expected {listed(expected, 30)}; '{wrong}' does not belong there")
        made._check(table, robot, told)
        if made.readings not in [(), *(one.coordinates for one in model.layouts)]:
            raise table.fail("readings", f"one of {listed(' '.join(one.coordinates) for one in model.layouts)}")
        functions = made.functions(made.low[None, :]).shape[1]
        unobserved_effects = tuple(
            BiasBound.from_table(one, model, functions, size) for one in table.tables("unobserved_effects")
        )
        for k, one in enumerate(unobserved_effects):
            sizes, far = one.largest(model)
            if sizes > _ABSURD or far > _LARGEST_RESIDUAL:
                raise table.refuse(f"unobserved_effects: entry {k + 1} ({one.effect}): larger than any robot")
        return replace(made, unobserved_effects=unobserved_effects)

    @classmethod
    def _own_from(cls, table: Table) -> dict[str, Any]:
        del table
        return {}

    def _check(self, table: Table, robot: Robot, told: list[tuple[str, float]]) -> None:
        """Refuses numbers that no identification gave: in other units, or absurd beside what is plausible."""
        known = np.sqrt(np.diag(self.covariance).clip(0.0))
        for p, (unit, std), value, sigma in zip(self.model(robot).parameters, told, self.values, known, strict=True):
            if unit != p.unit:
                raise table.refuse(f"parameters: {p.name} is in {p.unit or 'no unit'}, found '{unit}'")
            if abs(std - sigma) > 1e-3 * max(sigma, std):
                raise table.refuse(f"parameters: {p.name}: std = {std:g}, by the covariance it is {sigma:g}")
            if max(abs(value), sigma) > _ABSURD * p.size:
                raise table.refuse(f"parameters: {p.name} = {value:g} ± {sigma:g} {p.unit}: no robot is so far off")
        if np.diag(self.residual_covariance).max() > _LARGEST_RESIDUAL**2:
            raise table.refuse("residual_covariance: larger than any robot")


def _now_names(robot: Robot) -> tuple[str, ...]:
    return ("time_s", "temperature_c", *kind_of(robot).layout.directions)
