"""An emulated camera: a source of frames that shows the world's picture."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from .faults import Faults
from .world import World


class CameraEmulator:
    """Offers what OpenCV's ``VideoCapture`` does. ``noise`` is the standard deviation of a pixel, grey values.

    Faults: ``drop`` gives no picture, ``garble`` a cut one, ``stall`` waits, ``over_range`` is all white,
    ``disconnect`` closes it.
    """

    def __init__(self, world: World, *, faults: Faults | None = None, noise: float = 0.0, seed: int = 0) -> None:
        self.world = world
        self.faults = Faults() if faults is None else faults
        self.noise = noise
        self._random = np.random.default_rng(seed)
        self._open = True
        self._waker = threading.Event()

    def source(self) -> CameraEmulator:
        """Opens it, again after a disconnect: what a driver calls."""
        self._open = True
        return self

    def isOpened(self) -> bool:  # noqa: N802
        """Whether frames can be read."""
        return self._open

    def read(self) -> tuple[bool, Any]:
        """Whether there is a frame, and the frame."""
        fault = self.faults.take()
        kind = fault.kind if fault is not None else ""
        if kind == "disconnect":
            self._open = False
        if kind == "drop" or not self._open:
            return False, None
        if kind == "stall" and fault is not None:
            self._waker.wait(fault.seconds)
        picture = self.world.picture()
        if self.noise:
            noisy = picture + self._random.normal(0.0, self.noise, picture.shape)
            picture = np.clip(np.round(noisy), 0, 255).astype(np.uint8)
        if kind == "over_range":
            picture = np.full_like(picture, 255)
        if kind == "garble":
            picture = picture[: len(picture) // 2]
        return True, picture

    def release(self) -> None:
        """Closes it."""
        self._open = False
