"""``sherkit import``: files of other programs into sherkit's."""

from __future__ import annotations

from pathlib import Path

import click

from ..base.extensions import IMPORTERS
from ..data import Measurements, from_bluesky, from_rosbag
from ..errors import MeasurementError
from . import output
from .file_kinds import ROBOT, TABLE
from .groups import OpenGroup
from .paths import InputFile, OutputFile, OutputFolder


class _Importers(OpenGroup):
    """Those below, and those that are declared (``sherkit.importers``)."""

    declared = IMPORTERS


@click.group("import", cls=_Importers)
def import_group() -> None:
    """Turn files of other programs into robot.toml and run.csv."""


#: Where an importer writes a robot and its run.
folder_option = click.option(
    "-o",
    "--output",
    "folder",
    required=True,
    help="Folder to write to.",
    type=OutputFolder({"robot.toml": ROBOT, "run.csv": TABLE}),
)

_RUN_FILE = click.option(
    "-o", "--output", "destination", type=OutputFile(TABLE), required=True, help="The CSV or Parquet to write."
)


@import_group.command("bluesky")
@click.argument("documents", type=InputFile())
@click.option("--column", "columns", multiple=True, metavar="OURS=KEY", help="A column's key; repeat it.")
@click.option("--stream", default="primary", show_default=True, help="The stream whose events are rows.")
@click.option("--each-a-pose", is_flag=True, help="Every event is a pose of its own: no two are repeats.")
@_RUN_FILE
def bluesky(documents: Path, columns: tuple[str, ...], stream: str, each_a_pose: bool, destination: Path) -> None:
    """A run of bluesky: its documents, a pair of name and document as JSON on each line, as a run.csv."""
    run = from_bluesky(documents, columns=_named(columns, "--column"), stream=stream, poses=each_a_pose)
    _write_run(run, destination)


@import_group.command("rosbag")
@click.argument("folder", type=InputFile(folders=True))
@click.option("--joint", "joints", multiple=True, required=True, metavar="OURS=NAME", help="A joint's name; repeat it.")
@click.option("--poses", "topic", required=True, metavar="TOPIC", help="What a tracker saw.")
@click.option("--joint-states", default="/joint_states", show_default=True, metavar="TOPIC", help="Where joints are.")
@click.option("--coordinates", default="x_mm,y_mm,z_mm", show_default=True, help="Columns of what was seen.")
@click.option("--longest-gap-s", type=click.FloatRange(0.0), default=0.05, show_default=True,
              help="Between the joint states around a pose.")  # fmt: skip
@click.option("--still-per-s", type=click.FloatRange(0.0), help="Leave out poses at which a joint was faster.")
@_RUN_FILE
def rosbag(
    folder: Path, joints: tuple[str, ...], topic: str, joint_states: str, coordinates: str, longest_gap_s: float,
    still_per_s: float | None, destination: Path,
) -> None:  # fmt: skip
    """A ROS bag: joint states and the poses that a tracker saw, as a run.csv."""
    _write_run(
        from_rosbag(
            folder, _named(joints, "--joint"), topic, joint_states=joint_states,
            coordinates=[name.strip() for name in coordinates.split(",")], longest_gap_s=longest_gap_s,
            still_per_s=still_per_s,
        ),
        destination,
    )  # fmt: skip


def _named(pairs: tuple[str, ...], option: str) -> dict[str, str]:
    """Names of others by ours."""
    out: dict[str, str] = {}
    for pair in pairs:
        ours, equals, theirs = (part.strip() for part in pair.partition("="))
        if not (ours and equals and theirs):
            raise MeasurementError(f"{option} {pair}: expected a column and its name there, as q1_mm=rails_q1")
        if ours in out:
            raise MeasurementError(f"{option} {pair}: '{ours}' is given twice")
        out[ours] = theirs
    return out


def _write_run(run: Measurements, destination: Path) -> None:
    run.save(destination)
    layout = run.layout
    read = [name for name, taken in zip(layout.readings, run.taken.T, strict=True) if taken.any()]
    output.say(f"{destination}: {len(run)} rows of {', '.join((*layout.joints, *read))}")
