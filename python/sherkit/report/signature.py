"""What each effect looks like: the residual map of one effect alone on a robot, after the geometry has had its say."""

from __future__ import annotations

import numpy as np

from ..base.names import listed
from ..errors import SherkitError
from ..model.effect import Effect
from ..model.kinds import Robot, kind_of, known_kinds
from .picture import Panel, residual_maps, round_bar


def signature_map(effect: Effect, robot: Robot) -> str:
    """The signature as SVG, one panel per height. Raises :class:`~sherkit.errors.SherkitError` where it has none."""
    signature = kind_of(robot).signature
    if signature is None:
        drawn = [name for name, kind in known_kinds().items() if kind.signature is not None]
        raise SherkitError(
            f"--picture draws on a {listed(drawn)} alone; a report shows the maps of all effects on a run"
        )
    poses, left = signature(effect, robot)
    bar = round_bar(left)
    panels = []
    for z in np.unique(poses[:, 2]):
        here = poses[:, 2] == z
        panels.append(Panel(f"z = {z:.0f} mm", poses[here], left[here], bar))
    return residual_maps(panels, f"What {effect.name} of plausible size leaves after the geometry was fitted.")
