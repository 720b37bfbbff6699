"""Values that are copied, pickled and sent to other processes by what they were made of."""

from __future__ import annotations

from functools import cached_property
from typing import Any


class Saved:
    """A value that remembers what was computed from it, such as compiled parts, and leaves that out of its copies:
    there it is computed again when it is asked for."""

    def __getstate__(self) -> dict[str, Any]:
        made = {k: v for k, v in vars(self).items() if not isinstance(getattr(type(self), k, None), cached_property)}
        return {k: v for k, v in made.items() if not k.startswith("_last_")}
