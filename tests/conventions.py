"""The same run as another laboratory writes it: other clock, other order of rows, other numbers of poses, other names
and units of columns. Nothing of it is physics, so that no answer may hang on it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import polars as pl

#: Units in which a column may be written, and how many of them make one of ours.
UNITS: dict[str, dict[str, float]] = {
    "mm": {"mm": 1.0, "um": 1e3, "m": 1e-3, "in": 1.0 / 25.4},
    "rad": {"rad": 1.0, "mrad": 1e3, "deg": 180.0 / np.pi},
    "s": {"s": 1.0, "ms": 1e3, "min": 1.0 / 60.0},
}
#: A clock starts within a day of its zero, or counts from 1970.
DAY_S, SINCE_1970_S = 86400.0, 1.8e9


def written_otherwise(columns: Mapping[str, Any], seed: int) -> tuple[pl.DataFrame, dict[str, str]]:
    """A table and the names of its columns by ours, as :func:`sherkit.from_frame` takes them. Rows are put in any
    order where ``time_s`` tells theirs."""
    rng = np.random.default_rng([seed, 33])
    table = {name: np.asarray(values) for name, values in columns.items()}
    if "time_s" in table:
        rows = rng.permutation(len(table["time_s"]))
        table = {name: values[rows] for name, values in table.items()}
        table["time_s"] = table["time_s"] + rng.uniform(-DAY_S, DAY_S) + rng.choice([0.0, SINCE_1970_S])
    if "pose" in table:
        numbers, place = np.unique(table["pose"], return_inverse=True)
        table["pose"] = rng.permutation(3 * len(numbers))[: len(numbers)][place.ravel()]
    names: dict[str, str] = {}
    for number, name in enumerate(list(table)):
        stem, _, unit = name.rpartition("_")
        if not stem or unit not in UNITS:
            continue
        other = str(rng.choice(list(UNITS[unit])))
        names[name] = f"channel {number} [{other}]"
        table[names[name]] = table.pop(name) * UNITS[unit][other]
    return pl.DataFrame(table), names
