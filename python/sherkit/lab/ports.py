"""Files of ports: which instrument is at which address, written by a laboratory and read by an experiment."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..data.files import write_whole
from ..errors import ExperimentError


def write_ports(path: str | Path, ports: Mapping[str, Mapping[str, str]]) -> None:
    """Writes kind and address by name as JSON; the file is whole whenever another program looks at it."""
    write_whole(path, json.dumps(ports, indent=2) + "\n")


def read_ports(path: str | Path) -> dict[str, dict[str, Any]]:
    """Reads what :func:`write_ports` wrote. Raises :class:`~sherkit.errors.ExperimentError`."""
    path = Path(path)
    try:
        ports = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ExperimentError(f"{path}: there is no such file of ports; is the laboratory running?") from None
    except (OSError, ValueError) as error:
        raise ExperimentError(f"{path}: holds no ports: {error}") from None
    if not isinstance(ports, dict) or not all(isinstance(p, dict) and "address" in p for p in ports.values()):
        raise ExperimentError(f"{path}: expected an object with an address for each instrument")
    return ports
