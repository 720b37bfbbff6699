"""``sherkit check`` of a flexible tool's tables: all that is wrong with a run or a bench, as far as it can be read."""

from __future__ import annotations

import shlex
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ....base.types import Floats
from ....cli import output
from ....data.called import header_unit
from ....data.columns import TIME, bare
from ....data.tables import write_table
from ....errors import SherkitError, SherkitWarning
from ..bench_doubts import against_drawing
from ..calibration import calibrate_tool, check_loads, depth_column, loaded_rows, read_loads
from ..checks import checks
from ..consistency import judge, known
from ..filters import estimate
from ..runs import check_clocks, check_turn, check_wavelengths, tool_run_of
from ..tables import instead, no_numbers, table_at
from ..tool import ARC, DEFLECTION, FIBRES, FORCE, KNOWN, POSITION, TURN, FlexibleTool


def check_table(tool: FlexibleTool, of: Path, table: Path, destination: Path | None, *, as_json: bool) -> None:
    """Lists all that is wrong with a run or a bench of a tool, and writes its rows where they can be mended; ends with
    1 where there is anything that was not."""
    frame, mended = _in_order(table_at(table, tool.columns))
    wrong, is_bench = wrong_with(tool, table, frame), _is_bench(frame)
    what = "a bench of known loads" if is_bench else "a run"
    written = destination is not None and not wrong
    if destination is not None and written:
        write_table(frame, destination)
    if as_json:
        output.print_json({
            "format": "sherkit check 1", "source": str(table), "read_as": what, "good": not (wrong or mended),
            "rows": len(frame),
            "wrong": [*({"said": one, "mended": True} for one in mended), *({"said": one} for one in wrong)],
        })  # fmt: skip
    else:
        output.say(f"{table}: {len(frame)} rows, read as {what} of a flexible tool")
        for one in (*mended, *wrong):
            output.warn(one)
        if written:
            output.say(f"{destination}: {len(frame)} rows, mended")
        elif mended and not wrong:
            output.say(f"All of it can be mended:\n     {shlex.join(('sherkit', 'check', str(table), str(of)))} "
                       "--write clean.csv")  # fmt: skip
        elif not wrong:
            output.say("nothing is wrong with it")
        if written or not (wrong or mended):
            then = ("sherkit", "calibrate" if is_bench else "estimate", str(of), str(destination if written else table))
            output.say(f"Next:\n     {shlex.join(then)}")
    if wrong or (mended and not written):
        if not as_json:
            why = "not all of it can be mended, nothing was written" if destination else "cannot be trusted as it is"
            output.fail(f"{table}: {why}")
        sys.exit(1)


def _in_order(frame: pl.DataFrame) -> tuple[pl.DataFrame, list[str]]:
    """A run's rows by their time, each once, and what was done to them."""
    time = frame[TIME] if TIME in frame.columns else None
    if time is None or not time.dtype.is_numeric() or time.null_count():
        return frame, []
    told, earlier = [], int((time < time.cum_max()).sum())
    if earlier:
        frame = frame.sort(TIME, maintain_order=True)
        told.append(f"{earlier} rows stand behind later ones: they are put in the order of {TIME}")
    if twice := len(frame) - len(frame := frame.unique(maintain_order=True)):
        told.append(f"{twice} rows are there twice, to the last digit: each is left once")
    return frame, told


def _is_bench(frame: pl.DataFrame) -> bool:
    """Whether it has columns of a bench, in whatever unit, and none of a robot's."""
    names = {header_unit(name)[0].lower() for name in frame.columns}
    return bool(names & set(map(bare, (*FORCE, ARC, DEFLECTION)))) and not names & set(map(bare, POSITION))


def wrong_with(tool: FlexibleTool, table: Path, frame: pl.DataFrame) -> list[str]:
    """Sentences: first on its columns, then on their numbers, last on what a tool makes of them."""
    is_bench = _is_bench(frame)
    needed = (*FORCE, depth_column(frame), *FIBRES) if is_bench else (TIME, *POSITION, *TURN, *FIBRES)
    told = list(_columns(frame, needed, (*needed, DEFLECTION) if is_bench else KNOWN))
    lacking = any(name not in frame.columns for name in needed)
    if not lacking:
        asked = _of_bench(tool, table) if is_bench else _of_run(tool, str(table), frame)
        for one in asked:
            told += [sentence.removeprefix(f"{table}: ") for sentence in _said_by(one)]
    return list(dict.fromkeys(told))


def _columns(frame: pl.DataFrame, needed: tuple[str, ...], known: tuple[str, ...]) -> Iterator[str]:
    """What is missing, and what holds other things than numbers."""
    for name in needed:
        if name not in frame.columns:
            yield f"column '{name}' is missing{instead(name, frame.columns, known)}"
    for name in (one for one in known if one in frame.columns):
        bad = no_numbers(frame[name])
        if bad.any():
            row = int(bad.arg_max() or 0)
            first = frame[name].cast(pl.String)[row]
            yield f"column '{name}': {int(bad.sum())} cells are no number, the first in row {row + 1}: '{first}'"


def _said_by(ask: Callable[[], Any]) -> list[str]:
    """The refusal and the warnings of one question, and the sentences that it answers with."""
    told: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SherkitWarning)
        try:
            answer = ask()
            told += answer if isinstance(answer, list) else []
        except SherkitError as error:
            told.append(str(error))
    return [*(str(one.message) for one in caught if issubclass(one.category, SherkitWarning)), *told]


def _numbers(frame: pl.DataFrame, names: tuple[str, ...]) -> Floats:
    """Columns (n, k), NaN where there is no number."""
    cast = (frame[name].cast(pl.String).cast(pl.Float64, strict=False) for name in names)
    return np.column_stack([one.to_numpy().astype(float) for one in cast])


def _of_run(tool: FlexibleTool, source: str, frame: pl.DataFrame) -> list[Callable[[], Any]]:
    """Units and clocks each for itself, so that one that is wrong hides no other; then what a run says of itself."""
    pose = _numbers(frame, (TIME, *POSITION, *TURN))
    robot = pose[np.isfinite(pose).all(axis=1)]
    waves = _numbers(frame, FIBRES)

    def contradicts() -> list[str]:
        e = estimate(tool, tool_run_of(frame, source))
        truths = known(e)
        judge(e)
        return [*(sentence for one in checks(e, truths) for sentence in one.sentences), *map(str, e.faults)]

    asked: list[Callable[[], Any]] = [lambda: tool_run_of(frame, source)]
    if len(robot) > 1:
        asked += [lambda: check_clocks(robot[:, 0], None, source), lambda: check_turn(robot[:, 4:], source)]
    return [*asked, lambda: check_wavelengths(waves, tool.reference_nm, source), contradicts]


def _of_bench(tool: FlexibleTool, table: Path) -> list[Callable[[], Any]]:
    """Whether loads can calibrate the tool, and what they have wrong beside its drawing."""

    def beside_drawing() -> list[str]:
        loads = read_loads(table, tool.columns)
        check_loads(tool, loads)
        return against_drawing(tool, loaded_rows(tool, loads))

    return [beside_drawing, lambda: calibrate_tool(tool, read_loads(table, tool.columns))]
