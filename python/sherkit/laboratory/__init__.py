"""A laboratory of emulated instruments around one virtual robot, described by a file."""

from .file import Laboratory, load_laboratory
from .running import RunningLaboratory, read_ports

__all__ = ["Laboratory", "RunningLaboratory", "load_laboratory", "read_ports"]
