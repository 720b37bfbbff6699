"""Rows of ``time_s, u_px, v_px`` from pictures, a video or a camera, and their joining to joint readings by time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..errors import MeasurementError
from .marker import Seen, find_marker
from .pictures import Picture

Floats = NDArray[np.float64]

TIME, U, V, WHY = "time_s", "u_px", "v_px", "why"
SIGMA_U, SIGMA_V = "sigma_u_px", "sigma_v_px"


def marker_rows(pictures: Iterable[Picture], kind: str = "corner", identity: int | None = None) -> pl.DataFrame:
    """One row for every picture: ``time_s, u_px, v_px, sigma_u_px, sigma_v_px, why``.

    A picture without a marker, blurred, or with several candidates has empty pixels and a sentence in ``why``; no
    picture is left out.
    """
    times: list[float] = []
    seen: list[Seen] = []
    for picture in pictures:
        times.append(picture.time_s)
        seen.append(find_marker(picture, kind, identity))
    columns: dict[str, Any] = {
        TIME: times,
        U: [s.u_px for s in seen],
        V: [s.v_px for s in seen],
        SIGMA_U: [s.sigma_px for s in seen],
        SIGMA_V: [s.sigma_px for s in seen],
    }
    frame = pl.DataFrame({k: np.array(v, dtype=float) for k, v in columns.items()})
    return frame.with_columns(pl.col(pl.Float64).fill_nan(None), pl.Series(WHY, [s.why for s in seen], dtype=pl.String))


def joined_by_time(
    camera: pl.DataFrame, joints: pl.DataFrame, columns: Sequence[str], *,
    delay_s: float = 0.0, longest_gap_s: float = 0.1,
) -> pl.DataFrame:  # fmt: skip
    """Camera rows with the joint readings ``columns`` at the moment each picture shows, and their velocities.

    Joints are interpolated in ``time_s`` between the readings on both sides; ``delay_s`` is how much later the camera's
    clock stands. Velocities come as ``<joint>_per_s`` beside the joints. Rows whose neighbours are further apart than
    ``longest_gap_s``, or that lie outside the joints' time, are refused.

    Raises :class:`~sherkit.errors.MeasurementError` for times that do not grow, a missing column, a row without joints.
    """
    for name, frame, needed in (("camera", camera, (TIME,)), ("joints", joints, (TIME, *columns))):
        missing = [c for c in needed if c not in frame.columns]
        if missing:
            raise MeasurementError(f"{name}: column '{missing[0]}' is missing; it has {', '.join(frame.columns)}")
    at = joints[TIME].to_numpy().astype(float)
    if len(at) < 2 or not (np.diff(at) > 0).all():
        row = int(np.argmin(np.diff(at) > 0)) + 1 if len(at) > 1 else 0
        raise MeasurementError(f"joints: time_s does not grow at row {row}; expected readings in the order of time")
    moment = camera[TIME].to_numpy().astype(float) - delay_s
    place = np.searchsorted(at, moment, side="right")
    outside = (moment < at[0]) | (moment > at[-1]) | ~np.isfinite(moment)
    before, after = np.clip(place - 1, 0, len(at) - 2), np.clip(place, 1, len(at) - 1)
    after = np.maximum(after, before + 1)
    gap = (at[after] - at[before] > longest_gap_s) & (moment != at[before])
    if (outside | gap).any():
        row = int(np.argmax(outside | gap))
        why = "lies outside the joints' readings" if outside[row] else f"has no reading within {longest_gap_s:g} s"
        raise MeasurementError(
            f"camera: row {row} at {moment[row]:.4f} s {why} ({at[0]:.4f} to {at[-1]:.4f} s); "
            f"{int((outside | gap).sum())} rows of {len(moment)} are so"
        )
    share = (moment - at[before]) / (at[after] - at[before])
    made = []
    for name in columns:
        q = joints[name].to_numpy().astype(float)
        made.append(pl.Series(name, q[before] + share * (q[after] - q[before])))
        made.append(pl.Series(f"{name}_per_s", (q[after] - q[before]) / (at[after] - at[before])))
    return camera.with_columns(made)
