"""What the other rows make one expect of a reading, without a model of the machine: a smooth function of its joints."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np

from ...base import linalg
from ...base.types import Bools, Floats
from ..noise import MAD

#: Terms of the function, and rows for each of them.
_MOST_TERMS = 120
_ROWS_PER_TERM = 3
_DEGREES = (3, 2, 1)
#: A joint that turns by more than this is seen through its sine and cosine, rad.
_TURNS = 0.3
#: Rounds in which rows that are far off lose their weight.
_ROUNDS = 4


def expected(inputs: Floats, turning: Bools, values: Floats, rows: Bools) -> tuple[Floats, float] | None:
    """A polynomial in ``inputs`` (n, k), fitted to ``values`` (n,) in these ``rows``: what it gives in all rows, and
    its robust RMS in those it was fitted to. ``turning`` (k,) tells angles. None where rows are too few.

    Rows that are far off weigh less (Cauchy), so that a few wild ones do not count.
    """
    variables = _variables(inputs, turning)
    if not variables:
        return None
    for degree in _DEGREES:
        terms = [t for d in range(degree + 1) for t in combinations_with_replacement(range(len(variables)), d)]
        if len(terms) <= _MOST_TERMS and _ROWS_PER_TERM * len(terms) <= rows.sum():
            break
    else:
        return None
    columns = np.stack([np.prod([np.ones(len(values)), *(variables[k] for k in t)], axis=0) for t in terms], axis=1)
    weight = np.ones(int(rows.sum()))
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        x = linalg.lstsq(columns[rows] * root[:, None], values[rows] * root, rcond=1e-9)[0]
        off = values[rows] - columns[rows] @ x
        rms = MAD * float(np.median(np.abs(off)))
        weight = 1.0 / (1.0 + (off / max(2.0 * rms, 1e-12)) ** 2)
    return columns @ x, rms


def _variables(inputs: Floats, turning: Bools) -> list[Floats]:
    """The inputs that move, from -1 to 1, each once."""
    out: list[Floats] = []
    for column, turns in zip(inputs.T, turning, strict=True):
        reach = float(np.ptp(column))
        if reach == 0:
            continue
        if turns and _TURNS < reach < 4 * np.pi:
            out += [np.sin(column), np.cos(column)]
        else:
            out.append((2.0 * column - column.max() - column.min()) / reach)
    return out
