"""The compiled core: numerics in Rust. Arrays are float64 and contiguous; errors are ``sherkit.errors``."""

from typing import Any, final

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]
_Bools = NDArray[np.bool_]

__all__ = [
    "Bernstein",
    "Calibrated",
    "DeltaKinematics",
    "DeltaModel",
    "Solver",
    "__version__",
    "bernstein_basis",
    "bernstein_fit",
    "bernstein_fit_grid",
]

__version__: str

@final
class DeltaKinematics:
    def __new__(cls, parameters: _Floats, assembly_mode: str) -> DeltaKinematics: ...
    def forward(self, joints: _Floats) -> _Floats: ...
    def inverse(self, position: _Floats) -> _Floats: ...
    def forward_batch(self, joints: _Floats) -> tuple[_Floats, _Bools]: ...
    def inverse_batch(self, positions: _Floats) -> tuple[_Floats, _Bools]: ...
    def jacobian_batch(self, joints: _Floats) -> tuple[_Floats, _Bools]: ...
    def by_parameters_batch(self, joints: _Floats) -> tuple[_Floats, _Bools]: ...

_Block = tuple[_Floats, _Floats | None, _Floats | None, _Floats | None]

@final
class DeltaModel:
    PARAMETERS: int
    def __new__(
        cls, geometry: _Floats, target_offset: _Floats, assembly_mode: str, settings: _Floats
    ) -> DeltaModel: ...
    def predict(self, values: _Floats, block: _Block) -> tuple[_Floats, _Bools]: ...
    def derivatives(
        self, values: _Floats, block: _Block, free: list[int]
    ) -> tuple[_Floats, _Floats, _Floats, _Bools]: ...
    def accumulate(
        self, solver: Solver, values: _Floats, free: list[int], block: _Block, readings: _Floats, weights: _Floats
    ) -> list[int]: ...
    def solve(
        self,
        solver: Solver,
        values: _Floats,
        free: list[int],
        block: _Block,
        readings: _Floats,
        weights: _Floats,
        priors: bool,
    ) -> tuple[str, list[int]]: ...

@final
class Solver:
    def __new__(
        cls,
        start: _Floats,
        sizes: _Floats,
        *,
        loss: str = "linear",
        max_evaluations: int = 100,
        step_tolerance: float = 1e-5,
        rank_tolerance: float = 1e-9,
        single_step: bool = False,
    ) -> Solver: ...
    @property
    def trial(self) -> _Floats: ...
    def clear(self) -> None: ...
    def push(self, derivatives: _Floats, residuals: _Floats, weights: _Floats) -> None: ...
    def push_priors(self) -> None: ...
    def fail(self) -> None: ...
    def advance(self) -> str: ...
    def result(self) -> dict[str, Any]: ...

@final
class Bernstein:
    def __new__(
        cls, orders: tuple[int, int, int], low: _Floats, high: _Floats, fade: float, coefficients: _Floats
    ) -> Bernstein: ...
    def share(self, position: _Floats) -> float: ...
    def evaluate(self, positions: _Floats) -> tuple[_Floats, _Floats]: ...

@final
class Calibrated:
    def __new__(
        cls,
        whole: tuple[DeltaModel, _Floats, Bernstein | None],
        local: tuple[DeltaModel, _Floats, Bernstein | None] | None,
        region: tuple[_Floats, _Floats, float] | None,
    ) -> Calibrated: ...
    def forward(self, joints: _Floats, covariates: list[float]) -> tuple[_Floats, _Floats]: ...
    def inverse(self, position: _Floats, covariates: list[float]) -> _Floats: ...
    def forward_batch(self, joints: _Floats, covariates: list[float]) -> tuple[_Floats, _Floats, _Bools]: ...
    def inverse_batch(self, positions: _Floats, covariates: list[float]) -> tuple[_Floats, _Bools]: ...

def bernstein_basis(order: int, t: _Floats) -> _Floats: ...
def bernstein_fit(
    orders: tuple[int, int, int], low: _Floats, high: _Floats, positions: _Floats, targets: _Floats
) -> tuple[_Floats, float]: ...
def bernstein_fit_grid(
    orders: tuple[int, int, int], axes: tuple[_Floats, _Floats, _Floats], values: _Floats
) -> _Floats: ...
