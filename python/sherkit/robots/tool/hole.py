"""The hole of a run, where it stands still: its place, how much wider than the shaft it is, and what it pushes.

The hole stands at E in the base, so the unbent shaft passes it u = Rᵀ (E - S) aside. Where the shaft leans, u is the
clearance c along the force and what hole and shaft give way, u = c F/|F| + F (a³/3EI + 1/k), and a force that is felt
late is the true one less a part along its motion. E, c, 1/k and that part stand linear: least squares over the rows in
which the force moves. What the hole pushes tells the force while the gratings stand still.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...base import linalg
from ...base.types import Bools, Floats
from .runs import ToolRun
from .tool import FlexibleTool

#: Forces of less than this part of the usual one do not say where the edge is.
_LEANS = 0.3
#: Part of the force that may be left where the hole stands still.
_STANDS = 0.1
#: What is left of the fit is alike for so long, s.
_ALIKE_S = 1.0
_CLEARANCE = 3
#: No hole is rounder than this, mm.
_LEAST_STD_MM = 0.03


@dataclass(frozen=True, eq=False)
class Hole:
    """Its ``place_mm`` (3,), base; the radius by which it is wider than the shaft, mm, with its standard deviation; and
    how it gives way, mm/mN."""

    place_mm: Floats
    clearance_mm: float
    clearance_std_mm: float
    gives_mm_mn: float

    def in_tool(self, tool: FlexibleTool) -> FlexibleTool:
        """The tool whose file says how wide the hole is."""
        return replace(tool, clearance_mm=self.clearance_mm, clearance_std_mm=self.clearance_std_mm)

    def force(self, tool: FlexibleTool, run: ToolRun, depth_mm: Floats) -> Floats:
        """What it pushes (n, 2), mN, tool frame, at depths (n,)."""
        aside = np.einsum("nji,nj->ni", run.rotations, self.place_mm - run.position_mm)[:, :2]
        far = np.linalg.norm(aside, axis=1)
        push = (far - self.clearance_mm).clip(0.0) / (_softness(tool, depth_mm) + self.gives_mm_mn)
        return np.asarray(aside * (push / np.where(far > 0, far, 1.0))[:, None])


def find_hole(
    tool: FlexibleTool, run: ToolRun, force_mn: Floats, depth_mm: Floats, ways: Floats, moving: Bools
) -> Hole | None:
    """The hole that explains the force (n, 2), mN, where it is ``moving`` (n,) along ``ways`` (n, 2), at depths (n,);
    None where no hole that stands still does."""
    size = np.linalg.norm(force_mn, axis=1)
    usual = float(np.sqrt(np.mean(size**2)))
    leans = moving & (size > _LEANS * usual)
    gives = _softness(tool, depth_mm)
    across = run.rotations.transpose(0, 2, 1)[:, :2, :]
    pushed = np.stack([force_mn / np.where(size > 0, size, 1.0)[:, None], force_mn, ways * gives[:, None]], axis=2)
    columns = np.concatenate([across, -pushed], axis=2)[leans].reshape(-1, 6)
    right = (np.einsum("nij,nj->ni", across, run.position_mm) + force_mn * gives[:, None])[leans].ravel()
    if len(right) < 2 * columns.shape[1]:
        return None
    found, _, rank, _ = linalg.lstsq(columns, right, rcond=None)
    softness = gives[leans] + found[4]
    if rank < columns.shape[1] or not (gives + found[4] > 0).all():
        return None
    left = (columns @ found - right).reshape(-1, 2)
    if not ((left / softness[:, None]) ** 2).sum(axis=1).mean() < (_STANDS * usual) ** 2:
        return None
    alike = max(_ALIKE_S / float(np.median(np.diff(run.time_s))), 1.0)
    variance = linalg.inv(columns.T @ columns)[_CLEARANCE, _CLEARANCE] * float((left**2).mean()) * alike
    std = max(float(np.sqrt(variance)), _LEAST_STD_MM)
    return Hole(found[:3], max(float(found[_CLEARANCE]), 0.0), std, float(found[4]))


def _softness(tool: FlexibleTool, depth_mm: Floats) -> Floats:
    """How the shaft gives way at the contact (n,), mm/mN."""
    return np.asarray((tool.length_mm - depth_mm).clip(0.0) ** 3 / (3.0 * tool.stiffness_mn_mm2))
