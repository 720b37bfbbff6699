"""The columns of a run of a printer: what a probe or callipers measured, one number in each row."""

from __future__ import annotations

from ...data.columns import Layout
from ..delta.columns import JOINTS, POSITION, TO_JOINTS

#: Where the carriages were sent; how high above the middle plane of the bed the probe's tip then was, or, in a row that
#: has another end, how far apart the two places are. One reading a row, so that distances count as heights do.
PROBED = Layout(JOINTS, ("measured_mm",), "µm", 1e3, None, TO_JOINTS, follows=False)
#: How far the plate was turned, degrees anticlockwise seen from above, and which of the probings a row is from.
PLATE, PROBING = "plate_deg", "probing"

__all__ = ["PLATE", "POSITION", "PROBED", "PROBING"]
