"""What an effect could do between the poses of a run, and did not show at them.

At any place x the deployed model is a linear function of the readings it was made from. An effect with parameters e
that is not in it moves the readings by E e and the place by h(x) e, so that the robot misses x by

    a(x) e,  a(x) = h(x) - g(x) J⁺ E - b(x) B⁺ (I - J J⁺) E,

with the derivatives J at the poses and g at x by the identified parameters, and the functions B and b of a smooth
correction. What is known of e is its plausible size and what the readings say (Rasmussen and Williams, *Gaussian
Processes for Machine Learning*, 2.1). The second moment of a(x) e, less what the same e leaves at the poses, where the
held-out residuals hold it already, is what the poses could not show.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base import linalg
from ..base.types import Bools, Floats
from ..data import Measurements
from ..data.columns import TEMPERATURE, TIME, unit_in
from ..data.lagged import DRAWN_C
from ..data.toml import Table
from ..model.chain import ChainModel
from ..model.effect import Effect


@dataclass(frozen=True, eq=False)
class UnobservedEffect:
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
        effect = model.known_effects[self.effect]
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
    def from_table(cls, table: Table, model: ChainModel, functions: int, size: int) -> UnobservedEffect:
        """Back from :meth:`to_table`: beside a model, with ``functions`` of a correction and ``size`` coordinates.

        Raises what the table raises, naming file and key.
        """
        effect = model.known_effects[table.text("effect", tuple(model.known_effects))]
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
        own = [p.size for p in model.known_effects[self.effect].parameters]
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
    model: ChainModel, values: Floats, readings: tuple[str, ...], joints: Floats, now: Floats
) -> tuple[Floats, Floats, Bools]:
    """Derivatives of ``readings`` (columns) by the identified values (n, m, p) and by the joints (n, m, j), and which
    rows can be read, of a robot that stands at ``joints`` (n, j) and carries nothing; ``now`` (n, 2 + j) is time,
    temperature, directions.
    """
    layout = next((one for one in model.layouts if one.coordinates == readings), model.layouts[0])
    columns = dict(zip((TIME, TEMPERATURE, *layout.directions), now.T, strict=True))
    columns |= {name: np.zeros(len(joints)) for name in (*layout.velocities, *layout.loads)}
    rows = Measurements.planned(joints, layout, **columns)
    q, ends, known, push = model.block(rows)
    if known is not None:
        known[:, -1] = DRAWN_C
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
    wider = model.with_effect(effect, at=setting)
    own = wider.owns(effect)
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
    columns, by_joints, _ = at_rest(wider, more, readings, joints, now)
    return np.delete(columns, own, axis=2), columns[:, :, own], by_joints
