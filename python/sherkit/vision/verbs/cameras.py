"""``sherkit markers`` and ``sherkit intrinsics``: from pictures to rows, and to the camera that took them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click
import polars as pl
import tomli_w

from ...base.figures import listed
from ...cli import output
from ...cli.file_kinds import CAMERA, PRINTED, TABLE
from ...cli.paths import InputFile, OutputFile
from ...data.columns import POSE, REPEAT, TIME
from ...data.files import write_whole
from ...data.tables import read_table, write_table
from ...errors import MeasurementError, SherkitError
from ...robots.spherical.robot import SPHERICAL_JOINTS

if TYPE_CHECKING:
    from ..pictures import CameraPicture

_MARKERS = ("corner", "aruco", "apriltag")


def require_vision() -> None:
    """Refuses early where what reads pictures is not installed. Raises :class:`~sherkit.errors.SherkitError`."""
    try:
        import cv2  # noqa: F401
    except ModuleNotFoundError:
        message = "pictures of a camera need the extra 'vision': pip install \"sherkit[vision]\""
        raise SherkitError(message) from None


@click.command()
@click.argument("sources", type=InputFile(words=r"\d+", folders=True), nargs=-1)
@click.option("-o", "--output", "destination", type=OutputFile(TABLE), help="CSV or Parquet.")
@click.option("--joints", type=InputFile(), help="CSV with theta1_rad, theta2_rad: one row for each "
              "picture in their order, or for a video with time_s, joined by time.")  # fmt: skip
@click.option("--marker", type=click.Choice(_MARKERS), default="corner", show_default=True)
@click.option("--identity", type=int, help="Number of the tag, where several may be seen, or to be printed.")
@click.option("--delay-s", type=float, default=0.0, show_default=True, help="How much later the camera's clock stands.")
@click.option("--longest-gap-s", type=click.FloatRange(min=0), default=0.1, show_default=True,
              help="Joint readings on both sides of a picture may be this far apart.")  # fmt: skip
@click.option("--seconds", type=click.FloatRange(min=0), help="How long to film with a live camera.")
@click.option("--print", "paper", type=OutputFile(PRINTED), metavar="FILE", help="Write the --marker to print "
              "(.pdf or .png) instead of looking for it.")  # fmt: skip
@click.option("--size-mm", type=click.FloatRange(min=0, min_open=True), default=24.0, show_default=True,
              help="With --print: diameter of the corner marker, side of the black square of a tag.")  # fmt: skip
def markers(
    sources: tuple[Path | str, ...], destination: Path | None, joints: Path | None, marker: str, identity: int | None,
    delay_s: float, longest_gap_s: float, seconds: float | None, paper: Path | None, size_mm: float,
) -> None:  # fmt: skip
    """Find the marker in SOURCES: pictures, folders of them, a video, or the number of a camera.

    Without --joints every picture has a row, and one that shows no marker or cannot be read says why. With --joints the
    output is a run that sherkit calibrate reads. With --print the marker itself is written, to be printed.
    """
    require_vision()
    if paper is not None:
        _print(paper, marker, size_mm, identity, asked=bool(sources) or destination is not None)
        return
    if not sources or destination is None:
        wanted = "-o, the table to write" if sources else "SOURCES, the pictures to look at"
        raise click.UsageError(f"expected {wanted}; or --print FILE for a marker to print")
    from ..pictures import pictures_from
    from ..spherical import WHY, joined_by_time, marker_rows, run_of_pictures

    pictures, timed = pictures_from([str(one) for one in sources], seconds)
    names: list[str] = []
    unreadable: dict[str, str] = {}

    def named() -> Iterator[CameraPicture]:
        for picture in pictures:
            names.append(picture.name)
            if picture.why:
                unreadable[picture.name] = picture.why
            yield picture

    seen = marker_rows(named(), marker, identity)
    if len(seen) == 0:
        raise SherkitError(f"{sources[0]}: holds no picture")
    if len(unreadable) == len(seen):
        more = f"; none of the {len(seen)} pictures can be read" if len(seen) > 1 else ""
        raise SherkitError(f"{names[0]}: {unreadable[names[0]]}{more}")
    for name, why in unreadable.items():
        output.warn(f"{name}: {why}; the others are used")
    if joints is None:
        write_table(seen.with_columns(pl.Series("picture", names)), destination)
        missing = int(seen[WHY].is_not_null().sum())
        output.say(f"{len(seen)} rows written to {destination}; {missing} without a marker", destination)
        return
    moved = _joints(joints)
    if timed:
        moved = joined_by_time(
            seen.select(TIME), moved, SPHERICAL_JOINTS, delay_s=delay_s, longest_gap_s=longest_gap_s
        )  # fmt: skip
    data = run_of_pictures({name: moved[name].to_numpy() for name in moved.columns}, seen, names)
    data.save(destination)
    output.say(f"{len(data)} rows written to {destination}, of {len(seen)} pictures", destination)


def _print(paper: Path, marker: str, size_mm: float, identity: int | None, *, asked: bool) -> None:
    """Writes a marker to print, and says what it is."""
    from ..marker import save_marker

    if asked:
        raise SherkitError("--print writes a marker and looks at no pictures; leave out SOURCES and -o")
    if marker == "corner" and identity is not None:
        raise SherkitError("--identity: a corner marker has no number; choose --marker aruco or apriltag")
    said = save_marker(paper, marker, size_mm=size_mm, identity=identity or 0)
    output.say(f"{paper}: {said}; print it at 100 % and check the bar of 50 mm with a ruler")


def _joints(path: Path) -> pl.DataFrame:
    """Times, poses, repeats, joints and their velocities of a file; anything else in it is left aside."""
    from ...data.reader import checked

    checked(path)
    try:
        frame = read_table(path)
        missing = [name for name in SPHERICAL_JOINTS if name not in frame.columns]
        if missing:
            raise MeasurementError(f"{path}: column '{missing[0]}' is missing; it has {listed(frame.columns, 24)}")
        wanted = (TIME, POSE, REPEAT, *SPHERICAL_JOINTS, *(f"{name}_per_s" for name in SPHERICAL_JOINTS))
        kept = frame.select([pl.col(n).cast(pl.Float64) for n in wanted if n in frame.columns])
    except pl.exceptions.PolarsError as error:
        raise MeasurementError(f"{path}: expected a table of numbers: {str(error).splitlines()[0]}") from None
    for name in kept.columns:
        bad = (kept[name].is_null() | ~kept[name].is_finite()).fill_null(True)
        if bad.any():
            raise MeasurementError(f"{path}: row {int(bad.arg_max() or 0)}, column '{name}': expected a finite number")
    return kept


@click.command()
@click.argument("pictures", nargs=-1, required=True, type=InputFile(folders=True))
@click.option("--chessboard", metavar="COLUMNSxROWS", help="Inner corners of a chessboard, as 9x6.")
@click.option("--charuco", metavar="COLUMNSxROWS", help="Squares of a ChArUco board (5×5 tags), as 8x5.")
@click.option("--square-mm", type=click.FloatRange(min=0, min_open=True), required=True, help="Side of a square.")
@click.option("--marker-mm", type=click.FloatRange(min=0, min_open=True), help="Side of a tag of a ChArUco board.")
@click.option("-o", "--output", "destination", type=OutputFile(CAMERA), help="Write the table [camera] here.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of a table.")
def intrinsics(
    pictures: tuple[Path, ...], chessboard: str | None, charuco: str | None, square_mm: float, marker_mm: float | None,
    destination: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Focal lengths, centre and distortion of a camera from PICTURES of a board (files or folders)."""
    require_vision()
    from ..camera import charuco_intrinsics, chessboard_intrinsics
    from ..pictures import picture_files

    if (chessboard is None) == (charuco is None):
        raise SherkitError("expected either --chessboard or --charuco")
    if (charuco is None) != (marker_mm is None):
        raise SherkitError("--marker-mm goes with --charuco: the side of its tags")
    files = picture_files(pictures)
    if chessboard is not None:
        found = chessboard_intrinsics(files, _two("--chessboard", chessboard), square_mm)
    else:
        found = charuco_intrinsics(files, _two("--charuco", charuco or ""), square_mm, marker_mm or 0.0)
    labels = ("focal_px x", "focal_px y", "centre_px u", "centre_px v", "k1", "k2", "p1", "p2")
    values = (*found.focal_px, *found.centre_px, *found.distortion)
    known = list(zip(labels, values, found.std, strict=True))
    if as_json:
        output.print_json({
            "format": "sherkit intrinsics 1", "size_px": list(found.size_px), "pictures": found.pictures,
            "rms_px": found.rms_px, "without": dict(found.without),
            "values": {label: {"value": float(value), "std": float(std)} for label, value, std in known},
        })  # fmt: skip
    else:
        table = output.table(
            f"Camera of {found.size_px[0]} × {found.size_px[1]} px from {found.pictures} pictures", "", "value",
            "± std", note=f"corners are left with an RMS of {found.rms_px:.3f} px",
        )  # fmt: skip
        for label, value, std in known:
            table.add_row(label, f"{value:.5g}" if abs(value) < 10 else f"{value:.2f}", f"{std:.2g}")
        output.out.print(table)
    for name, why in found.without.items():
        output.warn(f"{name}: {why}")
    if destination is not None:
        lens = {name: list(getattr(found, name)) for name in ("size_px", "focal_px", "centre_px")}
        write_whole(destination, tomli_w.dumps({"camera": {**lens, "distortion": [*found.distortion, 0.0]}}))
        if not as_json:
            output.say(f"{destination}: the lens, for the table [camera] of a robot file; add where the camera stands")


def _two(option: str, text: str) -> tuple[int, int]:
    parts = text.lower().replace("×", "x").split("x")
    if len(parts) != 2 or not all(p.isdecimal() and int(p) > 1 for p in parts):
        raise SherkitError(f"{option}: expected columns and rows as 9x6, got '{text}'")
    return int(parts[0]), int(parts[1])
