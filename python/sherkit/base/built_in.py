"""The built-in kinds of robot, loaded when a kind is first asked for.

No floor looks down to the robots; the package's door says here where they are.
"""

from collections.abc import Callable


def _nobody() -> None:
    """No kinds but those that a program makes known itself."""


#: Makes the built-in kinds known; again it does nothing.
load: Callable[[], object] = _nobody
