"""Schemas of the files of experiments and laboratories."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import tomli_w

from ...cli.schema import asked
from ...data.declared import AskedTable, merged
from ...data.files import write_whole
from ...data.toml import Schema
from ...model.kinds import Kind, known_kinds
from ..experiment.file import experiment_from, names_of_poses
from ..instruments.user_driver import OwnCode
from ..kinds import instrument_kinds
from ..laboratory import laboratory_from

_LIMITS = {"mm": ("limits_mm", [60.0, 200.0]), "rad": ("limits_deg", [-180.0, 270.0])}


def experiments() -> Schema:
    """Every set of poses and every instrument of every kind of robot."""

    def examples(kind: Kind, robot: str) -> Iterator[Mapping[str, Any]]:
        rules: dict[str, Any] = {"robot": robot, "goal": {}}
        for poses in names_of_poses(kind):
            yield {**rules, "plan": {"poses": poses}}
        yield {**rules, "adaptive": {}}
        # any set of poses, and each instrument by itself: none keeps the others from being asked
        simplest = min(kind.poses, key=len)
        for name in instrument_kinds():
            yield {**rules, "plan": {"poses": simplest}, "instrument": [{"kind": name, "address": "http://x"}]}

    return _of_kinds(examples, partial(experiment_from, code=OwnCode(), offline=True))


def laboratories() -> Schema:
    """Every emulated instrument around every kind of robot."""

    def examples(kind: Kind, robot: str) -> Iterator[Mapping[str, Any]]:
        shown = [n for n, row in instrument_kinds().items() if row.emulator and row.sees(kind.example)]
        parts = [{"kind": name, "name": name} for name in shown]
        yield {"robot": robot, "instrument": parts, "tool": {}}
        yield {"robot": robot, "instrument": parts}

    return _of_kinds(examples, laboratory_from)


def _of_kinds(
    examples: Callable[[Kind, str], Iterator[Mapping[str, Any]]], reader: Callable[[AskedTable, Path], object]
) -> Schema:
    found = []
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = Path(folder) / "robot.toml"
        for kind in known_kinds().values():
            if kind.example is None or not kind.poses:  # no plan can name poses of such a robot
                continue
            tables = kind.example.to_tables()
            key, limits = _LIMITS[kind.example.joint_unit]
            tables["joints"] = {**tables.get("joints", {}), key: limits}
            write_whole(path, tomli_w.dumps(tables))
            found += [asked(one, lambda table: reader(table, path)) for one in examples(kind, path.name)]
    return merged(found)
