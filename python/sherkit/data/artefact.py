"""Whether the readings of a run are known places that were touched: a ball plate, a grid of pins."""

from __future__ import annotations

import numpy as np

from .rows import Measurements

#: Places of an artefact at least, and the part of its grid that they fill.
_PLACES, _FILLED = 9, 0.5
#: Part of the rows that stand at joints of their own.
_READ = 0.8


def is_artefact(data: Measurements) -> bool:
    """Places that fill a grid to the last digit, at joints that do not: what is written as a reading is the artefact's
    own coordinate, and the noise is the joints'. No instrument reads like that, however few its digits, and neither do
    averages that were written once for each repeat.

    Where it was set up more than once, those rows are asked of which the places are as they were written: the last.
    """
    used = data.used[:, : data.coordinates].all(axis=1)
    if data.set_up is not None:
        used &= np.asarray(data.set_up == data.last_set_up)
    readings, joints = data.readings[used, : data.coordinates], data.joints[used]
    if len(readings) < _PLACES or data.coordinates < 2 or not joints.shape[1]:
        return False
    if 2 * len(np.unique(readings[:, 0])) > len(readings):
        # an instrument's own digits, which a large table has many of
        return False
    lines = [len(np.unique(column)) for column in readings.T]
    places = len(np.unique(readings, axis=0))
    fills = places >= _PLACES and places >= _FILLED * np.prod(lines, dtype=float) and 2 * max(lines) <= places
    return bool(fills and len(np.unique(joints, axis=0)) >= _READ * len(joints))
