"""An emulated camera: a source of frames that shows the world's picture."""

from __future__ import annotations

import time
from dataclasses import KW_ONLY, dataclass, field
from functools import partial
from typing import Any

import numpy as np

from ...errors import ExperimentError
from .server import Page
from .world import Faults, World


@dataclass(eq=False, repr=False)
class CameraEmulator:
    """A camera whose :meth:`source` offers what OpenCV's ``VideoCapture`` does.

    ``noise`` is the standard deviation of a pixel, grey values. Faults: ``drop`` gives no picture, ``garble`` a cut
    one, ``stall`` waits, ``over_range`` is all white, ``disconnect`` closes the source.
    """

    world: World
    _: KW_ONLY
    faults: Faults = field(default_factory=Faults)
    noise: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        self.random = np.random.default_rng(self.seed)

    def source(self) -> CameraSource:
        """Opens it: what a driver calls, again after a disconnect."""
        return CameraSource(self)


class CameraSource:
    """One opening of the camera."""

    def __init__(self, camera: CameraEmulator) -> None:
        self._camera = camera
        self._open = True

    def isOpened(self) -> bool:  # noqa: N802
        """Whether frames can be read."""
        return self._open

    def read(self) -> tuple[bool, Any]:
        """Whether there is a frame, and the frame."""
        camera = self._camera
        fault = camera.faults.take()
        kind = fault.kind if fault is not None else ""
        self._open = self._open and kind != "disconnect"
        if kind == "drop" or not self._open:
            return False, None
        if fault is not None and kind == "stall":
            time.sleep(fault.seconds)
        picture = camera.world.picture()
        if camera.noise:
            noisy = picture + camera.random.normal(0.0, camera.noise, picture.shape)
            picture = np.clip(np.round(noisy), 0, 255).astype(np.uint8)
        if kind == "over_range":
            picture = np.full_like(picture, 255)
        if kind == "garble":
            picture = picture[: len(picture) // 2]
        return True, picture

    def release(self) -> None:
        """Closes it."""
        self._open = False


@dataclass(eq=False, repr=False)
class NetworkCamera(Page):
    """A camera on HTTP: each request for ``/snapshot.png`` takes a picture. ``address`` is for the driver.

    It listens on this machine alone unless ``host`` says otherwise. Its pictures are those of the world, which draws
    their noise (``noise_grey``): that of a place is always the same.
    """

    path = "/snapshot.png"
    content_type = "image/png"

    _: KW_ONLY
    noise_grey: float = 0.0

    def __post_init__(self) -> None:
        try:
            import cv2
        except ImportError:
            raise ExperimentError('an emulated camera needs OpenCV: pip install "sherkit[vision]"') from None
        super().__post_init__()
        self._encoded = partial(cv2.imencode, ".png", params=[cv2.IMWRITE_PNG_COMPRESSION, 1])
        self._camera = CameraEmulator(self.world, faults=self.faults)
        self._source = self._camera.source()

    def shown(self) -> bytes | None:
        """The picture."""
        there, picture = self._source.read()
        if not self._source.isOpened():
            # a camera that was unplugged is there again for the next one
            self._source = self._camera.source()
        return self._encoded(picture)[1].tobytes() if there else None
