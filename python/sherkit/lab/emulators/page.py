"""A page on HTTP that an emulator serves from a thread of its own, for as long as it is entered."""

from __future__ import annotations

import threading
from http.server import HTTPServer
from typing import Self


class WebPage:
    """Serves ``server`` between ``__enter__`` and ``__exit__``, and closes it."""

    def __init__(self, server: HTTPServer) -> None:
        self._server = server
        self._thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
