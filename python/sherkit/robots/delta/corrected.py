"""What a Bernstein correction takes of a delta's run, and what the paper's protocol finds on the same."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ...base.types import Floats, Ints
from ...errors import FitError
from ...fit.identify import Fit
from ..calibration_run import Cells, Corrected
from .correction import Choice, choose_correction, leftover
from .paper import PaperProtocol, paper_protocol


@dataclass(frozen=True, eq=False)
class DeltaCorrected(Corrected):
    """A correction and how it was chosen; ``seed`` rules the split of the paper's protocol."""

    fit: Fit
    choice: Choice
    seed: int

    @cached_property
    def paper(self) -> PaperProtocol | None:
        """The paper's protocol on the same run, to stand beside; None where the run has no plane at the middle."""
        with suppress(FitError):
            return paper_protocol(self.fit, seed=self.seed)
        return None

    @property
    def rows(self) -> Ints:
        """Rows with a full position that are no outliers."""
        return leftover(self.fit).rows

    @property
    def held_out(self) -> Floats:
        """What the chosen orders leave of blocks that they did not see (k, 3), mm."""
        return self.choice.held_out_mm

    @property
    def chosen(self) -> bool:
        """Whether a polynomial helps."""
        return self.choice.correction is not None

    def __str__(self) -> str:
        chosen = self.choice.correction
        text = "none helps on held-out blocks" if chosen is None else f"order {chosen.orders} in (x, y, z)"
        return f"Bernstein correction by blocked cross-validation: {text}"

    def to_json(self) -> dict[str, Any]:
        """Orders of the correction, and those of the paper's protocol with their errors."""
        chosen, paper = self.choice.correction, self.paper
        return {
            "correction": None if chosen is None else {"orders": list(chosen.orders)},
            "paper_protocol": None
            if paper is None
            else {
                "orders": paper.orders,
                "test_um": paper.test_um,
                "other_planes_um": {f"{z:g}": v for z, v in paper.other_planes_um.items()},
            },
        }

    def cells(self) -> Cells | None:
        """Table III: order, error on the test part and on the other planes, by the paper's protocol."""
        p = self.paper
        if p is None:
            return None
        planes = sorted(p.other_planes_um, reverse=True)
        lines = []
        for axis in "xyz":
            errors = [(p.test_um[axis], p.test_std_um[axis])]
            errors += [(p.other_planes_um[z][axis], p.other_planes_std_um[z][axis]) for z in planes]
            lines.append((axis, str(p.orders[axis]), *(f"{rms:.1f} ± {std:.1f}" for rms, std in errors)))
        return Cells(("order", f"test, z = {round(p.plane_mm)}", *(f"z = {round(z)}" for z in planes)), tuple(lines))


def corrected(fit: Fit, way: str, seed: int) -> DeltaCorrected:
    """Chooses a correction: ``auto`` by blocked cross-validation, ``paper`` with the order that the paper's protocol
    finds on the middle plane, in x and y alone, fitted to all planes.

    Raises :class:`~sherkit.errors.FitError` where the rows do not determine one.
    """
    if way == "paper":
        n = max(paper_protocol(fit, seed=seed).orders.values())
        return DeltaCorrected(fit, choose_correction(fit, orders=(n,), heights=1, seed=seed, keep_none=False), seed)
    return DeltaCorrected(fit, choose_correction(fit, seed=seed), seed)
