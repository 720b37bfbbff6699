"""The flexible tool as it is drawn: the bent shaft with its gratings, the sclera that bends it, the camera's sight."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...base.types import Floats
from ...model.drawing import Drawing, Part, line, with_target

_STEPS = 25
#: Radius of the hole as it is drawn, and how much of the way to the camera, by the length of the shaft.
_HOLE, _SIGHT = 0.12, 0.8


def drawing(
    tool: Any, turn: Floats, unbent_mm: Floats, depth_mm: Floats, tip_mm: Floats, shown_mm: Floats
) -> Drawing:  # fmt: skip
    """A tool at n moments.

    ``turn`` (n, 3, 3) takes its frame to the base, ``unbent_mm`` (n, 3) is where the tip would be without force,
    ``depth_mm`` (n,) how far from the tip the contact is, ``tip_mm`` (n, 3) where the tip is, ``shown_mm`` (n, 3) where
    it is seen.

    The shaft has the shape of a cantilever under a load at the contact, w(s) ~ s² (3 a - s) and straight beyond it, of
    the size that brings its end to the tip.
    """
    length, way = tool.length_mm, turn[:, :, 2]
    clamp = unbent_mm - length * way
    contact = np.clip(length - depth_mm, 0.05 * length, length)

    def along(s: Floats) -> Floats:
        """Points (n, k, 3) at ways (n, k) from the clamp."""
        a = contact[:, None]
        bent = np.where(s < a, s**2 * (3.0 * a - s), a**2 * (3.0 * s - a))
        share = bent / (contact**2 * (3.0 * length - contact))[:, None]
        straight = clamp[:, None] + s[:, :, None] * way[:, None]
        return np.asarray(straight + share[:, :, None] * (tip_mm - unbent_mm)[:, None])

    n = len(tip_mm)
    whole = np.broadcast_to(np.linspace(0.0, length, _STEPS), (n, _STEPS))
    hole = along(contact[:, None])[:, 0]
    angle = np.linspace(0.0, 2.0 * np.pi, 33)[None, :, None]
    circle = _HOLE * length * (np.cos(angle) * turn[:, None, :, 0] + np.sin(angle) * turn[:, None, :, 1])
    to_camera = np.array(tool.camera_translation_mm) - shown_mm
    far = np.linalg.norm(to_camera, axis=1, keepdims=True)
    sight = shown_mm + _SIGHT * length * np.divide(to_camera, far, out=np.zeros_like(to_camera), where=far > 0)
    parts = [
        Part("shaft without force", "guide", line(clamp, unbent_mm)),
        Part("hole in the sclera", "sensor", hole[:, None] + circle),
        Part("shaft", "link", along(whole)),
        Part("clamp", "joint", line(clamp)),
        *(
            Part(f"gratings of section {name}", "joint", along(np.full((n, 1), length - distance)))
            for name, distance in zip(("I", "II"), tool.distances_mm, strict=True)
        ),
        Part("towards the camera", "guide", line(shown_mm, sight)),
    ]
    return with_target(parts, tip_mm, shown_mm)
