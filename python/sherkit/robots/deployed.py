"""What a control loop runs: where the tool of a calibrated robot is, and how to bring it there."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..base.saved import Saved
from ..base.types import Bools, Floats
from ..data.columns import unit_in
from ..errors import SherkitWarning
from ..model.batch import Batch, matrix, vector
from ..model.kinds import Robot
from .part import Part

#: A place is far from the poses of a run from this many times their extent on.
_FAR = 1.0


@dataclass(frozen=True, eq=False)
class Deployed(Saved, ABC):
    """A robot with ``whole``, what was identified over its workspace.

    Coordinates are those of :attr:`coordinates`, joint readings those of the robot. Covariates of the control loop
    (``temperature_c``, and ``direction``: the sign of the last motion of each joint) matter only where the model holds
    an effect that needs them; left out, :attr:`Part.now` stands for them.
    """

    #: What :meth:`forward` gives, with units.
    coordinates: ClassVar[tuple[str, ...]]
    #: What one and many of them are called in messages.
    called: ClassVar[tuple[str, str]]

    robot: Robot
    whole: Part

    def __post_init__(self) -> None:
        _ = self.core  # refuses numbers that do not fit together

    @property
    @abstractmethod
    def core(self) -> Any:
        """The compiled model: the same code that a control loop runs."""

    @cached_property
    def model(self) -> Any:
        """The model that was identified over the workspace, a :class:`~sherkit.model.chain.ChainModel`."""
        return self.whole.model(self.robot)

    @cached_property
    def by_name(self) -> dict[str, float]:
        """Its values by the names of their parameters."""
        return dict(zip((p.name for p in self.model.parameters), self.whole.values.tolist(), strict=True))

    def forward(
        self, joints: ArrayLike, *, temperature_c: float | None = None, direction: ArrayLike | None = None
    ) -> Floats:
        """Coordinates (k,) for joint readings (j,). Raises :class:`~sherkit.errors.OutOfReach` with what is wrong."""
        return self._one(joints, temperature_c, direction)[0]

    def jacobian(
        self, joints: ArrayLike, *, temperature_c: float | None = None, direction: ArrayLike | None = None
    ) -> Floats:
        """d coordinates / d joints (k, j) of the whole corrected model. Arguments and errors as :meth:`forward`."""
        return self._one(joints, temperature_c, direction)[1]

    def inverse(
        self, coordinates: ArrayLike, *, temperature_c: float | None = None, direction: ArrayLike | None = None
    ) -> Floats:
        """Joint readings (j,) at which the corrected model gives ``coordinates`` (k,), to 1e-6 mm or 1e-12 rad.

        Arguments as :meth:`forward`. Raises :class:`~sherkit.errors.OutOfReach`, or ``NotConverged`` where a
        correction folds over. Warns once (:class:`~sherkit.errors.SherkitWarning`) of a place that is farther from the
        poses of the run than these lie apart.
        """
        x = self._place(coordinates)
        made: Floats = self.core.inverse(x, self._now(temperature_c, direction))
        self._went_to(x)
        return made

    def forward_batch(self, joints: ArrayLike) -> Batch:
        """Coordinates (n, k) for joint readings (n, j); rows out of reach are marked."""
        values, _, reached = self._rows(joints)
        return Batch(values, reached)

    def jacobian_batch(self, joints: ArrayLike) -> Batch:
        """Jacobians (n, k, j) for joint readings (n, j); rows out of reach are marked."""
        _, values, reached = self._rows(joints)
        return Batch(values, reached)

    def inverse_batch(self, coordinates: ArrayLike, *, direction: ArrayLike | None = None) -> Batch:
        """Joint readings (n, j) for coordinates (n, k), all reached in one ``direction`` (j,) if given; rows out of
        reach are marked."""
        values, reached = self.core.inverse_batch(self._places(coordinates), self._now(None, direction))
        return Batch(values, reached)

    def _went_to(self, x: Floats) -> None:
        """Says once that it is asked where nothing like the place was measured: quick, for control loops."""
        for value, (low, high) in zip(x.tolist(), self._near, strict=True):
            if not low <= value <= high:
                return self._say_far(x)
        return None

    @cached_property
    def _near(self) -> list[tuple[float, float]]:
        """Places (k) that the poses of the run are near to, coordinate by coordinate."""
        low, high = self.whole.low, self.whole.high
        extent = float((high - low).max())
        # a single pose says of no place that it is far
        reach = _FAR * extent if extent > 0 else np.inf
        return list(zip((low - reach).tolist(), (high + reach).tolist(), strict=True))

    def _say_far(self, x: Floats) -> None:
        low, high, unit = self.whole.low, self.whole.high, unit_in(self.coordinates[0])
        beyond, extent = float(np.maximum(low - x, x - high).max()), float((high - low).max())
        warnings.warn(
            f"{', '.join(f'{v:.4g}' for v in x)} {unit} is {beyond:.3g} {unit} beyond the poses of "
            f"{self.whole.made_from}, which cover {extent:.3g} {unit}: what is so far outside is extrapolated, and no "
            "accuracy is promised there; measure nearer to it",
            SherkitWarning,
            stacklevel=4,
        )
        self.__dict__["_near"] = [(-np.inf, np.inf)] * len(x)

    def _one(
        self, joints: ArrayLike, temperature_c: float | None, direction: ArrayLike | None
    ) -> tuple[Floats, Floats]:
        q = vector(joints, "joint readings", self._joints)
        made: tuple[Floats, Floats] = self.core.forward(q, self._now(temperature_c, direction))
        return made

    def _rows(self, joints: ArrayLike) -> tuple[Floats, Floats, Bools]:
        """Coordinates, Jacobians, and which rows are within reach."""
        q = matrix(joints, "joint readings", self._joints)
        made: tuple[Floats, Floats, Bools] = self.core.forward_batch(q, self._now())
        return made

    def _now(self, temperature_c: float | None = None, direction: ArrayLike | None = None) -> list[float]:
        """Covariates for the core: those given, else those that stand in for them."""
        now = list(self.whole.now)
        if temperature_c is not None:
            now[1] = float(temperature_c)
        if direction is not None:
            now[2:] = [float(d) for d in vector(direction, "direction", self._joints)]
        return now

    @property
    def _joints(self) -> int:
        return len(self.whole.now) - 2

    def _place(self, coordinates: ArrayLike) -> Floats:
        return vector(coordinates, self.called[0], len(self.coordinates))

    def _places(self, coordinates: ArrayLike) -> Floats:
        return matrix(coordinates, self.called[1], len(self.coordinates))
