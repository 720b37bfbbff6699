"""Xiao et al., ISMR 2022: what they printed, to stand beside one's own figures, and their protocol."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...base.types import Floats
from ...errors import FitError
from ...fit.identify import Fit
from .correction import Correction, fit_polynomial, leftover, levels_of

#: Table I: RMS ± standard deviation, µm, per axis.
TABLE_I = {
    "whole": {
        "before": {"x": (1388, 1390), "y": (1293, 1297), "z": (650, 459)},
        "after": {"x": (245, 217), "y": (149, 144), "z": (217, 149)},
        "before, region": {"x": (798, 780), "y": (769, 771), "z": (175, 149)},
        "after, region": {"x": (140, 74), "y": (77, 66), "z": (116, 34)},
    },
    "local": {
        "before": {"x": (762, 764), "y": (771, 773), "z": (222, 169)},
        "after": {"x": (121, 68), "y": (97, 57), "z": (100, 27)},
    },
}

#: Table II: identified errors per limb: δr_b mm, δθ_b deg, δL mm, δl mm.
TABLE_II = {
    "whole": ((-2.31, 0.38, -0.43, 1.23), (5.19, 0.21, -1.79, 3.49), (2.83, -1.32, 0.68, 0.44)),
    "local": ((1.33, 0.12, 1.31, -0.70), (3.76, 0.15, 1.28, 0.28), (2.57, -1.83, 1.60, -0.49)),
}

#: Table III: order, RMS ± standard deviation on the test set, on the upper and on the lower plane, µm.
TABLE_III = {
    "whole": {"x": (6, (40, 38), (121, 80), (82, 75)), "y": (6, (27, 28), (36, 35), (90, 49)),
              "z": (6, (31, 31), (77, 76), (27, 25))},
    "local": {"x": (3, (11, 10), (18, 18), (18, 18)), "y": (3, (9, 9), (15, 15), (16, 16)),
              "z": (3, (13, 12), (18, 15), (13, 13))},
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class PaperProtocol:
    """Orders chosen per axis, their errors, and one correction of the highest order that holds all three.

    ``orders`` maps axis to order; ``validation_um`` axis to order to RMS; ``test_um`` axis to RMS on the test
    part; ``other_planes_um`` plane height to axis to RMS.
    """

    plane_mm: float
    orders: dict[str, int]
    validation_um: dict[str, dict[int, float]]
    test_um: dict[str, float]
    test_std_um: dict[str, float]
    other_planes_um: dict[float, dict[str, float]]
    other_planes_std_um: dict[float, dict[str, float]]
    corrections: dict[str, Correction] = field(repr=False)

    def __call__(self, positions_mm: Floats) -> Floats:
        """Correction (n, 3): each axis from the polynomial of its own order."""
        return np.stack([self.corrections[a](positions_mm)[:, k] for k, a in enumerate("xyz")], axis=1)


def paper_protocol(
    fit: Fit, *, plane_mm: float = 0.0, orders: Sequence[int] = (2, 3, 4, 5, 6), seed: int = 0
) -> PaperProtocol:
    """Section II-B of the paper: one horizontal plane, 70/20/10 at random by pose, the order of 2 to 6 with the
    lowest validation error for each axis, then the other planes. ``seed`` rules the split.

    Raises :class:`FitError` where no pose lies within 2 mm of ``plane_mm``, or too few do.
    """
    left = leftover(fit)
    heights = left.positions_mm[:, 2]
    levels = levels_of(heights)
    nearest = levels[np.argmin(np.abs(levels - plane_mm))]
    if abs(nearest - plane_mm) > 2.0:
        found = ", ".join(f"{v:.1f}" for v in levels)
        raise FitError(f"no pose lies within 2 mm of the plane z = {plane_mm:g} mm; heights found: {found} mm")
    plane = levels[np.argmin(np.abs(heights[:, None] - levels), axis=1)]
    on_plane = np.flatnonzero(plane == nearest)
    poses, pose = np.unique(fit.data.groups[left.rows[on_plane]], return_inverse=True)
    share = (np.random.default_rng(seed).permutation(len(poses)) / len(poses))[pose.ravel()]
    ends = ((0.0, 0.7), (0.7, 0.9), (0.9, 1.0))
    train, validate, test = (on_plane[(share >= low) & (share < high)] for low, high in ends)
    if min(len(train), len(validate), len(test)) == 0:
        raise FitError(f"{len(poses)} poses on the plane z = {plane_mm:g} mm are too few to split 70/20/10")

    x, e, places = left.positions_mm, left.errors_mm, len(np.unique(fit.data.groups[left.rows[train]]))
    fitted = {n: fit_polynomial(x[train], e[train], (n, n, 0)) for n in orders if (n + 1) ** 2 <= places}
    if not fitted:
        raise FitError(f"{len(train)} training rows do not determine a polynomial of order {min(orders)}")
    rest = {n: e - c(x) for n, c in fitted.items()}
    validation = {n: _um(_rms, r[validate]) for n, r in rest.items()}
    chosen = {a: min(validation, key=lambda n: validation[n][a]) for a in "xyz"}
    missed = np.column_stack([rest[chosen[a]][:, k] for k, a in enumerate("xyz")])
    others = {float(v): missed[plane == v] for v in levels if v != nearest}
    return PaperProtocol(
        plane_mm=float(nearest),
        orders=chosen,
        validation_um={a: {n: by_axis[a] for n, by_axis in validation.items()} for a in "xyz"},
        test_um=_um(_rms, missed[test]),
        test_std_um=_um(np.std, missed[test]),
        other_planes_um={v: _um(_rms, r) for v, r in others.items()},
        other_planes_std_um={v: _um(np.std, r) for v, r in others.items()},
        corrections={a: fitted[n] for a, n in chosen.items()},
    )


def _um(measure: Callable[[Floats], Any], errors_mm: Floats) -> dict[str, float]:
    """A measure of errors (n, 3) by axis, µm."""
    return {a: 1e3 * float(measure(errors_mm[:, k])) for k, a in enumerate("xyz")}


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
