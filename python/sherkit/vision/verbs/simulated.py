"""``sherkit simulate --pictures``: a virtual robot at which a camera looks, measured in its pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import click

from ...base.types import Floats
from ...cli.file_kinds import PICTURE
from ...cli.paths import OutputFolder
from ...data import Measurements
from ...model.kinds import SeenInPictures, Virtual
from .cameras import require_vision


class Pictures:
    """Draws what the camera sees, and finds the marker in it."""

    simulate_options = (
        click.Option(["--pictures"], type=OutputFolder({"picture_*.png": PICTURE}),
                     help="With a camera: draw pictures into this folder, and read the pixels from them."),
    )  # fmt: skip

    def is_asked(self, virtual: Virtual, given: Mapping[str, Any]) -> bool:
        """Where a folder for them is named, and a camera looks."""
        return given.get("pictures") is not None and isinstance(virtual, SeenInPictures)

    def measuring(self, virtual: Virtual, given: Mapping[str, Any]) -> Callable[..., Measurements]:
        """Plans, draws and reads."""
        require_vision()
        from ..spherical import pictures_of, seen_run  # needs OpenCV

        assert isinstance(virtual, SeenInPictures)

        def measure(coordinates: Floats, *, repeats: int, order: str, seed: int) -> Measurements:
            plan = virtual.plan(coordinates, repeats=repeats, order=order, seed=seed)
            # the seed of the robot itself: another order of rows sees the same camera
            return seen_run(plan, pictures_of(virtual, plan, seed=seed - 1), save_in=given["pictures"])

        return measure


PICTURES = Pictures()
