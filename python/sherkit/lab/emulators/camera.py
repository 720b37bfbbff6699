"""An emulated camera: a source of frames that shows the world's picture."""

from __future__ import annotations

import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np

from ...errors import ExperimentError
from .faults import Faults
from .server import LOOPBACK, WebPage
from .world import World


class CameraEmulator:
    """A camera whose :meth:`source` offers what OpenCV's ``VideoCapture`` does.

    ``noise`` is the standard deviation of a pixel, grey values. Faults: ``drop`` gives no picture, ``garble`` a cut
    one, ``stall`` waits, ``over_range`` is all white, ``disconnect`` closes the source.
    """

    def __init__(self, world: World, *, faults: Faults | None = None, noise: float = 0.0, seed: int = 0) -> None:
        self.world = world
        self.faults = Faults() if faults is None else faults
        self.noise = noise
        self.random = np.random.default_rng(seed)

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
        if kind == "disconnect":
            self._open = False
        if kind == "drop" or not self._open:
            return False, None
        if kind == "stall" and fault is not None:
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


class NetworkCamera(WebPage):
    """A camera on HTTP: each request for ``/snapshot.png`` takes a picture. ``address`` is for the driver.

    It listens on this machine alone unless ``host`` says otherwise. Its pictures are those of the world, which draws
    their noise: that of a place is always the same.
    """

    page = ""

    def __init__(
        self,
        world: World,
        *,
        link: str = "http",
        host: str = LOOPBACK,
        port: int = 0,
        faults: Faults | None = None,
        seed: int = 0,
        noise_grey: float = 0.0,
    ) -> None:
        del link, seed, noise_grey
        try:
            import cv2
        except ImportError:
            raise ExperimentError('an emulated camera needs OpenCV: pip install "sherkit[vision]"') from None
        camera = CameraEmulator(world, faults=faults)
        self.faults = camera.faults
        lock = threading.Lock()
        source = camera.source()

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                nonlocal source
                with lock:
                    there, picture = source.read() if self.path == "/snapshot.png" else (False, None)
                    if not source.isOpened():
                        # a camera that was unplugged is there again for the next one
                        source = camera.source()
                if not there:
                    self.send_error(404 if self.path != "/snapshot.png" else 503)
                    return
                self.send_response(200)
                self.send_header("Content-Type", "image/png")
                self.end_headers()
                self.wfile.write(cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes())

            def log_message(self, *_: Any) -> None:
                """Nothing: tests read what is printed."""

        server = ThreadingHTTPServer((host, port), Handler)
        server.daemon_threads = True
        super().__init__(server)
        self.address = f"http://{host}:{server.server_port}/snapshot.png"
