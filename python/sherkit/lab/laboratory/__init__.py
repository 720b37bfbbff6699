"""A laboratory of emulated instruments around one virtual robot, described by a file."""

from .file import Laboratory, load_laboratory
from .running import RunningLaboratory

__all__ = ["Laboratory", "RunningLaboratory", "load_laboratory"]
