"""What has changed since: the same machine before and after."""

from .comparison import Comparison, Moved, compare

__all__ = ["Comparison", "Moved", "compare"]
