"""Where a run began, by its first forces, beside where the tool file says that it begins."""

from __future__ import annotations

import numpy as np

from .filters import Estimate

#: The first forces are those of so long, s.
_FIRST_S = 3.0
#: Asked is where both differ by so many deviations; how far the hole stands aside puts the depth off by about so much
#: when the tool turns, mm.
_FAR, _ASIDE_MM = 4.0, 0.5
#: In one hole depths of the whole run differ from what these say by no more than this part of it.
_ONE_HOLE = 0.25


def began(e: Estimate) -> list[str]:
    """A sentence where the tool file says where runs begin, and the first forces say that this one did not."""
    run, tool = e.run, e.tool
    told = np.isfinite(e.fibre_depth_mm)
    if tool.start_std_mm is None or not told.any():
        return []
    step = float(np.median(np.diff(run.time_s)))
    told &= np.cumsum(told) <= max(1, round(_FIRST_S / step))
    last = int(np.flatnonzero(told)[-1])
    way = run.rotations[:, :, 2]
    hole = run.position_mm[0] - tool.start_depth_mm * way[0]
    carried = np.einsum("ni,ni->n", run.position_mm - hole, way)
    bent = e.together.value[:, 0] - e.arc_mm
    every = e.fibre_depth_mm + bent - carried
    off = every[told]
    # fibres that lag keep a share of the bends before, each its own; the lever is the longest, as the depth is in doubt
    near, far = tool.distances_mm
    size = np.linalg.norm(e.force_mn, axis=1)
    most = np.fmax.accumulate(np.where(np.isfinite(size), size, 0.0))
    lags = float(e.lags.max()) * (most / size)[told] * near * far / (far - near)
    variance = e.fibre_depth_std_mm[told] ** 2 + lags**2
    mean = float((off / variance).sum() / (1.0 / variance).sum())
    strays = tool.per_second_mm2[0] * float(run.time_s[last] - run.time_s[0])
    # what puts one depth off puts all of these seconds off
    sure = float(np.sqrt(tool.start_std_mm**2 + variance.min() + strays + _ASIDE_MM**2))
    # a shaft that is pressed elsewhere each time has no hole at which it began
    apart = float(np.nanmedian(np.abs(every - mean)))
    if abs(mean) < _FAR * sure or apart > _ONE_HOLE * abs(mean):
        return []
    where = tool.start_depth_mm + mean
    began_at = f"{where:.1f} mm inside" if where > 0.0 else f"{-where:.1f} mm before the hole"
    return [
        f"By its first forces {run.source} began {began_at}, and the tool file says {tool.start_depth_mm:g} ± "
        f"{tool.start_std_mm:g} mm: what is said before these forces is off by as much. Leave start_std_mm of [filter] "
        "out where nobody knows how deep a run begins, or write how deep this one did"
    ]
