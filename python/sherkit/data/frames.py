"""Measurements from any table or arrays in memory: polars, pandas, a mapping of columns, or a dict for each row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..base.arguments import validate_arguments
from ..base.figures import brief, listed
from ..base.types import Bools, Floats, Ints
from ..errors import MeasurementError, NotFinite, ShapeError
from . import columns as c
from .called import Columns, proposal, refuse_unmapped, renamed
from .columns import Layout
from .in_time import begin_of, order_in_time
from .rows import Measurements
from .set_up import set_up_names

# -- From NumPy arrays -------------------------------------------------------------------------------------------------
# Rows of any machine, from NumPy arrays.


def from_arrays(
    *,
    place: Mapping[str, Floats],
    readings: Floats,
    names: Sequence[str],
    unit: str,
    covariates: Mapping[str, Floats] | None = None,
    time_s: Floats | None = None,
    pose: Ints | None = None,
    block: Ints | None = None,
    sigma: Floats | None = None,
    outlier: Bools | None = None,
    line: Ints | None = None,
    source: str = "readings",
) -> Measurements:
    """Rows of readings of any machine, whose model is fitted and diagnosed as a robot's is.

    ``place`` maps names to values (n,) that say where the machine was: its inputs, or the direction it looked in.
    ``readings`` (n, m) are all in ``unit``, NaN where one was not taken; ``names`` names their columns. ``covariates``
    are further columns (n,); ``time_s`` (n,); ``pose`` (n,) is equal for repeats; ``sigma`` (n, m) is the noise, in
    ``unit``, where it is known; ``outlier`` (n,) marks rows that are kept and listed but not fitted; ``line`` (n,)
    is the number of the row in its file. ``block`` (n,) says which rows are held out together in validation; left
    out, neighbours in ``place`` are.

    Raises :class:`~sherkit.errors.ShapeError` or :class:`~sherkit.errors.NotFinite` naming the column.
    """
    if readings.ndim != 2 or readings.shape[1] != len(names) or not len(readings):
        raise ShapeError(f"{source}: readings: expected (n, {len(names)}) for {listed(names)}, got {readings.shape}")
    taken = np.isfinite(readings)
    for name, column in zip(names, taken.T, strict=True):
        if not column.any():
            raise NotFinite(f"{source}: readings: no number in '{name}'; leave the column out")
    n = len(readings)
    marked = np.zeros(n, dtype=bool) if outlier is None else outlier
    numbers = np.arange(n, dtype=np.int64) if line is None else line
    others: dict[str, NDArray[Any] | None] = {**place, **(covariates or {})}
    others |= {"time_s": time_s, "pose": pose, "block": block, "outlier": marked, "line": numbers}
    for name, other in others.items():
        if other is None:
            continue
        if other.shape != (n,):
            raise ShapeError(f"{source}: column '{name}': expected {n} rows, got {other.shape}")
        if not np.isfinite(other).all():
            row = int(numbers[np.argmin(np.isfinite(other))])
            raise NotFinite(f"{source}: row {row}: column '{name}' is not a finite number")
    if sigma is not None and (sigma.shape != readings.shape or not (sigma > 0).all()):
        raise ShapeError(f"{source}: sigma: expected positive numbers of shape {readings.shape}")
    inputs = np.column_stack([np.asarray(v, dtype=float) for v in place.values()]) if place else np.zeros((n, 0))
    return Measurements(
        joints=inputs,
        to_joints=np.full(inputs.shape, np.nan),
        readings=np.where(taken, readings, 0.0),
        taken=taken,
        sigma=np.full(readings.shape, np.nan) if sigma is None else sigma,
        pose_sigma=np.zeros(readings.shape),
        time_s=time_s,
        pose=pose,
        repeat=None,
        outlier=marked,
        covariates=dict(covariates or {}),
        labels={},
        source=source,
        line=numbers,
        counted="row",
        # the side from which an input came to its value is not known of a machine that is not
        direction=np.full(inputs.shape, np.nan),
        order=order_in_time(time_s, n) if line is None else numbers,
        # a place need not be all that the machine was told: which rows are repeats, the caller says
        layout=Layout(tuple(place), tuple(names), unit, 1.0, joints_tell_pose=False),
        block=block,
        begins_s=begin_of(time_s),
    )


# -- From tables in memory ---------------------------------------------------------------------------------------------

#: Beyond this, squares overflow and no reading was meant.
_LARGEST = 1e100
#: Beyond this, a float no longer tells whole numbers apart.
_LARGEST_WHOLE = 2**53


@validate_arguments
def from_frame(frame: Any, source: str = "frame", *, columns: Columns | None = None) -> Measurements:
    """Measurements from a polars or pandas frame, a mapping of columns to sequences, or a dict for each row.

    Null (polars) and NaN (pandas, NumPy) mean "not taken" in reading columns and are refused elsewhere. ``columns`` as
    in :func:`~sherkit.data.read_measurements`. A machine of your own is described first: its columns are known from
    then on. Raises :class:`~sherkit.errors.MeasurementError` naming row (from 0) and column.

        frame = polars.read_csv("demo/whole.csv")
        run = sk.from_frame(frame.filter(polars.col("repeat") == 1))
    """
    return clean(to_polars(frame), source, None, "row", columns)


def to_polars(frame: Any) -> pl.DataFrame:
    """Any of the accepted tables as a polars frame; raises :class:`MeasurementError` for anything else."""
    if isinstance(frame, pl.DataFrame):
        return frame
    if isinstance(frame, pl.LazyFrame):
        return frame.collect()
    if isinstance(frame, list | tuple) and all(isinstance(row, Mapping) for row in frame):
        # asked before polars is: it walks down into a cell until the stack ends
        for row in frame:
            for name, cell in row.items():
                if isinstance(cell, Mapping | list | tuple | set) or np.ndim(cell):
                    told = f"frame: column '{name}' holds lists or tables"
                    raise MeasurementError(f"{told}; expected a number in each row")
        return pl.DataFrame([dict(row) for row in frame], infer_schema_length=None, strict=False)
    if not (isinstance(frame, Mapping) or hasattr(frame, "columns")):
        raise MeasurementError(
            "expected a polars or pandas frame, a mapping of columns or a list of dicts, one for each row, "
            f"got {type(frame).__name__}"
        )
    names = list(getattr(frame, "columns", frame))
    c.check_unique([str(name) for name in names], "frame")
    columns = {str(name): _series(str(name), frame[name]) for name in names}
    lengths = {name: len(v) for name, v in columns.items()}
    if len(set(lengths.values())) > 1:
        raise MeasurementError(f"frame: columns have different lengths: {lengths}")
    return pl.DataFrame(columns)


def _series(name: str, values: Any) -> pl.Series:
    """A column of a pandas frame or a mapping; what is missing becomes null, mixed cells become text."""
    try:
        array = np.asarray(values)
    except ValueError:
        array = np.empty((0, 0))
    if array.ndim != 1 or array.dtype.kind == "c":
        raise MeasurementError(f"frame: column '{name}' is no list of numbers")
    if array.dtype.kind != "O":
        return pl.Series(name, array.astype(str) if array.dtype.kind in "mM" else array)
    missing = values.isna() if hasattr(values, "isna") else [v is None or v != v for v in array]
    cells = [None if m else v for m, v in zip(missing, array, strict=True)]
    if any(isinstance(v, str) for v in cells):
        cells = [None if v is None else str(v) for v in cells]
    return pl.Series(name, cells, strict=False)


def clean(
    frame: pl.DataFrame, source: str, line: Ints | None, counted: str, columns: Columns | None = None,
    layouts: Sequence[c.Layout] = (),
) -> Measurements:  # fmt: skip
    """Checks cell by cell that a frame holds numbers where numbers belong, and builds the rows.

    ``line`` (n,) gives the place of each row for messages, a ``"line"`` or a ``"row"``; None counts from 0.
    ``columns`` gives the names in the frame by ours; ``layouts`` are those of its robot, where that is known.
    """
    c.check_unique([name.strip() for name in frame.columns], source)
    frame = frame.rename({name: name.strip() for name in frame.columns})
    frame, factors = renamed(frame, columns or {}, source)
    try:
        layout = c.check_columns(frame.columns, source, layouts)
    except MeasurementError as error:
        raise MeasurementError(f"{error}{proposal(frame.columns, layouts)}") from None
    refuse_unmapped(frame.columns, layout, source)
    if frame.height == 0:
        raise MeasurementError(f"{source}: holds no row, only column names; expected measurements")
    line = np.arange(frame.height, dtype=np.int64) if line is None else line
    place = f"{source}: {counted}"
    made: dict[str, Any] = {}
    for name in frame.columns:
        column = frame[name]
        if name == c.SETUP:
            made[name] = set_up_names(column.to_numpy(), place, line)
            continue
        number = _numbers(column, name, place, line, layout)
        made[name] = _labels(column) if number is None else number * factors.get(name, 1.0)
    return Measurements.from_columns(made, source, line, counted, layout)


def _labels(column: pl.Series) -> NDArray[Any]:
    return np.array(["" if v is None else str(v) for v in column], dtype=object)


def _numbers(column: pl.Series, name: str, place: str, line: Ints, layout: c.Layout) -> NDArray[np.float64] | None:
    """The column as floats, None where it is a label; raises at the first cell that is no number."""
    known = name in layout.known
    text = column.dtype in (pl.String, pl.Categorical, pl.Enum)
    if text:
        raw = column.cast(pl.String).str.strip_chars()
        raw = raw.set(raw == "", None)
    elif column.dtype.is_numeric() or column.dtype in (pl.Boolean, pl.Null):
        raw = column
    elif known:
        _refuse(place, line, np.ones(len(column), dtype=bool), name, f"{brief(repr(column[0]))} is not a number")
    else:
        return None
    number = raw.cast(pl.Float64, strict=False)
    values = number.to_numpy().astype(float, copy=False)
    narrower = (c.POSE, c.REPEAT, *layout.sigmas, *layout.pose_sigmas)
    if not text and name not in narrower and (np.abs(values) <= _LARGEST).all():
        return values  # as nearly always: a number in every row, and none that went wrong
    hint = "; where nothing was taken, leave the cell empty" if name in layout.may_be_empty else "; expected a number"
    bad = (number.is_null() & raw.is_not_null()).to_numpy()
    if bad.any():
        if not known and bad.sum() > 0.5 * (len(raw) - raw.null_count()):
            return None
        first = raw[int(np.argmax(bad))]
        if name == c.TIME and ":" in first:
            hint = "; expected seconds, counted from any moment"
        _refuse(place, line, bad, name, f"'{brief(first)}' is not a number{hint}")
    missing = number.is_null().to_numpy()
    # NaN is how pandas and NumPy say "nothing"; in a file it is a number that went wrong
    broken = np.isinf(values) | (np.abs(values) > _LARGEST) | (np.isnan(values) & ~missing if text else False)
    if broken.any():
        _refuse(place, line, broken, name, f"{values[int(np.argmax(broken))]} is not a measurement{hint}")
    empty = np.isnan(values)
    if empty.all() and not known:
        return None
    if empty.any() and name not in layout.may_be_empty:
        what = "a reading column may be empty, this one not" if known else "expected a number in every row"
        _refuse(place, line, empty, name, f"is empty; {what}")
    if name in (c.POSE, c.REPEAT):
        fraction = (values != np.floor(values)) | (np.abs(values) > _LARGEST_WHOLE)
        if fraction.any():
            _refuse(place, line, fraction, name, f"{values[int(np.argmax(fraction))]} is not a whole number")
    if name in (*layout.sigmas, *layout.pose_sigmas):
        low = values <= 0
        if low.any():
            _refuse(place, line, low, name, f"{values[int(np.argmax(low))]} must be greater than zero")
    return values


def _refuse(place: str, line: Ints, bad: NDArray[np.bool_], name: str, what: str) -> NoReturn:
    rows = np.flatnonzero(bad)
    more = f" (and {len(rows) - 1} more rows)" if len(rows) > 1 else ""
    raise MeasurementError(f"{place} {line[rows[0]]}, column '{brief(name)}': {what}{more}")
