"""What a hole that stands still pushes, by the robot's motion alone: it tells the force while the gratings stand still.

The hole stands at E in the base, so the unbent shaft passes it u = Rᵀ (E - S) aside. Where the shaft leans, that is the
clearance c along the force and what shaft and hole give way, u = c F/|F| + F (a³/3EI + 1/k), and a force that is felt
late is the true one less a part along its motion. E, c, 1/k and that part stand linear: least squares over the rows in
which the force moves.
"""

from __future__ import annotations

import numpy as np

from ...types import Bools, Floats
from .runs import ToolRun
from .tool import FlexibleTool

#: Forces of less than this part of the usual one do not say where the edge is.
_LEANS = 0.3
#: Part of the force that may be left where the hole stands still.
_STANDS = 0.1


def hole_force(
    tool: FlexibleTool, run: ToolRun, force_mn: Floats, depth_mm: Floats, ways: Floats, moving: Bools
) -> Floats | None:
    """The force (n, 2), mN, tool frame, of the hole that explains the one felt (n, 2) where this is ``moving`` (n,)
    along ``ways`` (n, 2); None where no hole that stands still does."""
    size = np.linalg.norm(force_mn, axis=1)
    usual = float(np.sqrt(np.mean(size**2)))
    leans = moving & (size > _LEANS * usual)
    gives = (tool.length_mm - depth_mm).clip(0.0) ** 3 / (3.0 * tool.stiffness_mn_mm2)
    across = run.rotations.transpose(0, 2, 1)[:, :2, :]
    reached = np.einsum("nij,nj->ni", across, run.position_mm)
    pushed = np.stack([force_mn / np.where(size > 0, size, 1.0)[:, None], force_mn, ways * gives[:, None]], axis=2)
    columns = np.concatenate([across, -pushed], axis=2)[leans].reshape(-1, 6)
    right = (reached + force_mn * gives[:, None])[leans].ravel()
    if len(right) < 2 * columns.shape[1]:
        return None
    found = np.linalg.lstsq(columns, right, rcond=None)[0]
    softness = gives + found[4]
    if not (softness > 0).all():
        return None
    left = ((columns @ found - right).reshape(-1, 2) / softness[leans, None]) ** 2
    if not left.sum(axis=1).mean() < (_STANDS * usual) ** 2:
        return None
    aside = across @ found[:3] - reached
    far = np.linalg.norm(aside, axis=1)
    push = (far - max(found[3], 0.0)).clip(0.0) / softness
    return np.asarray(aside * (push / np.where(far > 0, far, 1.0))[:, None])
