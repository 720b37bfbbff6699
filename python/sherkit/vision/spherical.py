"""The spherical robot in pictures: rows of ``time_s, u_px, v_px`` of a marker, their joining to joint readings by time,
and pictures of a virtual one."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import polars as pl

from ..base.types import Floats
from ..data import Measurements
from ..data.files import write_whole
from ..errors import MeasurementError, ShapeError, SherkitWarning
from ..model.kinds import SeenInPictures
from ..robots.spherical.robot import SPHERICAL_PIXELS
from .camera import Intrinsics, View, draw_marker
from .marker import find_marker
from .pictures import CameraPicture

TIME, U, V, WHY = "time_s", "u_px", "v_px", "why"
SIGMA_U, SIGMA_V = "sigma_u_px", "sigma_v_px"
#: Pictures without a marker that a warning names.
_NAMED = 5
#: Diameter of the marker of a virtual robot.
_MARKER_MM = 12.0


def marker_rows(pictures: Iterable[CameraPicture], kind: str = "corner", identity: int | None = None) -> pl.DataFrame:
    """One row for every picture: ``time_s, u_px, v_px, sigma_u_px, sigma_v_px, why``.

    A picture without a marker, blurred, or with several candidates has empty pixels and a sentence in ``why``; no
    picture is left out.
    """
    rows = []
    for picture in pictures:
        seen = find_marker(picture, kind, identity)
        rows.append((picture.time_s, seen.u_px, seen.v_px, seen.sigma_px, seen.sigma_px, seen.why or None))
    schema = {**dict.fromkeys((TIME, U, V, SIGMA_U, SIGMA_V), pl.Float64), WHY: pl.String}
    return pl.DataFrame(rows, schema, orient="row").with_columns(pl.col(pl.Float64).fill_nan(None))


def pictures_of(
    virtual: SeenInPictures, columns: Mapping[str, Floats], *, seed: int = 0, noise_grey: float = 2.0
) -> Iterator[CameraPicture]:
    """Pictures of a virtual robot's marker, one for every row of its ``plan``, with blur and grey noise.

    Raises :class:`~sherkit.errors.ShapeError` for a lens with a sixth-order term.
    """
    eye = virtual.eye
    k1, k2, p1, p2, k3 = eye.distortion
    if k3 != 0.0:
        raise ShapeError("pictures are drawn with four distortion coefficients; k3 must be zero")
    view = View(Intrinsics(eye.focal_px, eye.centre_px, (k1, k2, p1, p2), eye.size_px), eye.rotation_rad,
                eye.translation_mm)  # fmt: skip
    rng = np.random.default_rng([seed, 2])
    joints = np.column_stack([columns[name] for name in SPHERICAL_PIXELS.joints])
    for time, place, normal in zip(columns[TIME], virtual.markers(joints), virtual.axes(joints), strict=True):
        drawn = draw_marker(view, place, normal, _MARKER_MM, rng, noise=noise_grey)
        yield CameraPicture(drawn, f"picture at {time:g} s", float(time))


def seen_run(
    plan: Mapping[str, Floats], pictures: Iterable[CameraPicture], *, kind: str = "corner", save_in: Path | None = None
) -> Measurements:
    """The run of a plan (columns of joints, time, pose, repeat) whose pixels are read from its pictures, in its order.

    ``save_in`` keeps all pictures as PNG. Raises and warns as :func:`run_of_pictures`.
    """

    def kept(folder: Path) -> Iterator[CameraPicture]:
        folder.mkdir(parents=True, exist_ok=True)
        for number, picture in enumerate(pictures, start=1):
            write_whole(folder / f"picture_{number:04d}.png", cv2.imencode(".png", picture.grey)[1].tobytes())
            yield picture

    frame = marker_rows(pictures if save_in is None else kept(save_in), kind)
    return run_of_pictures(plan, frame, [f"picture {k + 1}" for k in range(len(frame))])


def run_of_pictures(plan: Mapping[str, Floats], seen: pl.DataFrame, names: Sequence[str]) -> Measurements:
    """The run of a plan whose pictures gave the :func:`marker_rows` ``seen``, picture by picture; ``names`` for people.

    A picture in which no marker was found has no row in the run, with a warning that says which and why. Raises
    :class:`~sherkit.errors.MeasurementError` where no picture shows the marker, or plan and pictures differ in number.
    """
    count = len(next(iter(plan.values())))
    if count != len(seen):
        raise MeasurementError(
            f"{len(seen)} pictures for {count} rows of joints; expected one picture for each row, in the same order"
        )
    good = seen[WHY].is_null().to_numpy()
    lost = np.flatnonzero(~good)
    if not good.any():
        raise MeasurementError(f"no picture shows the marker; {names[0]}: {seen[WHY][0]}")
    if len(lost):
        reasons = "; ".join(f"{names[k]}: {seen[WHY][int(k)]}" for k in lost[:_NAMED])
        more = f"; and {len(lost) - _NAMED} more" if len(lost) > _NAMED else ""
        warnings.warn(f"{len(lost)} of {len(good)} pictures give no row: {reasons}{more}", SherkitWarning, stacklevel=3)
    columns = {name: np.asarray(values)[good] for name, values in plan.items()}
    columns |= {name: seen[name].to_numpy().astype(float)[good] for name in (U, V)}
    return Measurements.from_columns(columns, "pictures", layout=SPHERICAL_PIXELS)


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
    outside = (moment < at[0]) | (moment > at[-1]) | ~np.isfinite(moment)
    after = np.clip(np.searchsorted(at, moment, side="right"), 1, len(at) - 1)
    before = after - 1
    gap = (at[after] - at[before] > longest_gap_s) & (moment != at[before])
    if (outside | gap).any():
        row = int(np.argmax(outside | gap))
        why = "lies outside the joints' readings" if outside[row] else f"has no reading within {longest_gap_s:g} s"
        raise MeasurementError(
            f"camera: row {row} at {moment[row]:.4f} s {why} ({at[0]:.4f} to {at[-1]:.4f} s); "
            f"{int((outside | gap).sum())} rows of {len(moment)} are so"
        )
    made = {}
    for name in columns:
        q = joints[name].to_numpy().astype(float)
        made[name] = np.interp(moment, at, q)
        made[f"{name}_per_s"] = (q[after] - q[before]) / (at[after] - at[before])
    return camera.with_columns(**{name: pl.Series(values) for name, values in made.items()})
