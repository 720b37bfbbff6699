"""``sherkit tool``: from three tables to a tool file, in one command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from ....base.figures import finite
from ....cli import output
from ....cli.file_kinds import TOOL
from ....cli.paths import InputFile, OutputFile
from ....diagnosis import Diagnosis
from ....diagnosis import diagnose as run_diagnosis
from ....errors import MeasurementError
from ....fit.identify import identify
from ..alignment import Aligned, align_run
from ..calibration import ToolCalibration, read_loads
from ..calibration import calibrate_tool as run_calibration
from ..consistency import judge, known, mean_errors
from ..filters import Estimate
from ..filters import estimate as run_filters
from ..model import Applied, ToolModel, mended
from ..places import TipPlaces
from ..runs import ToolRun, read_free_motion, read_tool_run, require_camera
from ..tare import Tare, tare
from ..tool import FlexibleTool, load_tool
from .estimate import knowledge_json, print_knowledge, sentences_of, trust_in_words, trust_json, write_tool_report
from .loads import calibration_json, print_calibration
from .register import alignment_json, print_alignment


@click.command("tool")
@click.argument("bench", type=InputFile())
@click.argument("free", type=InputFile())
@click.argument("run", type=InputFile())
@click.option("-o", "--output", "destination", type=OutputFile(TOOL), required=True, help="The tool file.")
@click.option("--drawing", type=InputFile(),
              help="A tool file with what no table tells, as where sections are; default: the paper's.")  # fmt: skip
@click.option("--longest-delay-s", type=click.FloatRange(min=0, min_open=True), default=0.5, show_default=True)
@output.report_option
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Rules folds and flips of the diagnosis."
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
def tool_story(
    bench: Path, free: Path, run: Path, destination: Path, drawing: Path | None, longest_delay_s: float,
    report: Path | None, seed: int, as_json: bool,
) -> None:  # fmt: skip
    """Make a tool file of known loads (BENCH), a free motion (FREE) and a RUN, and say what RUN is still missing."""
    if report is not None:
        output.require_view()
    with output.steps(16) as step:
        step("reading")
        drawn = load_tool(drawing) if drawing else FlexibleTool()
        named = drawn.columns
        loads, led, recorded = read_loads(bench, named), read_free_motion(free, named), read_tool_run(run, named)
        require_camera(recorded)
        step("gains, stiffness and length")
        calibration = run_calibration(drawn, loads)
        step("the camera's frame and clock")
        found = align_run(led, longest_delay_s, calibration.tool.length_mm)
        step("unloaded seconds")
        tares = _tared(found.in_tool(calibration.tool), led, recorded)
        hole = TipPlaces(tares[-1].tool, recorded, recorded.time_s[:1]).hole
        made = tares[-1].tool if hole is None else hole.in_tool(tares[-1].tool)
        step("depth and tip")
        before = run_filters(made, recorded)
        step("what is missing")
        model = ToolModel(made, recorded)
        diagnosis = run_diagnosis(identify(model, model.readings), seed=seed, step=step)
        told = mended(model, diagnosis)
        after = run_filters(told.tool, recorded)
    told.tool.save(destination)
    if report is not None:
        write_tool_report(report, diagnosis, after, told, (bench, free, run), destination)
    if as_json:
        output.print_json(_json(calibration, found, tares, diagnosis, told, before, after))
        return
    _say("1. Known loads", bench)
    print_calibration(calibration)
    _say("2. The camera, from a free motion", free)
    print_alignment(found)
    _say("3. The unloaded tool", run)
    for one, source in zip(tares, (free, run), strict=False):
        output.say(
            f"   {one.seconds:.1f} s of {source.name} were unloaded: references moved by "
            f"{1e3 * np.abs(one.shift_nm).max():.2f} pm at most; fibres answer to warmth unlike by "
            f"{100 * np.abs(one.tool.warmth).max():.1f} ± {100 * one.tool.doubt.warmth:.1f} %"
        )
    if hole is not None:
        output.say(
            f"   the hole is {hole.clearance_mm:.2f} ± {hole.clearance_std_mm:.2f} mm wider than the shaft all around"
        )
    _say("4. What is missing?", run)
    output.show(replace(diagnosis.answer, to_do=()), destination, run)
    for finding in diagnosis.findings:
        if finding.about in ("tie", "note"):
            output.say(f"   {finding.answer}")
    for sentence in (*sentences_of(told), *(str(one) for one in diagnosis.checks if one.holds is False)):
        output.say(f"   {sentence}")
    _say("5. Depth and tip", run)
    for sentence in trust_in_words(after):
        output.say(f"   {sentence}")
    _print_errors(before, after)
    print_knowledge(known(after))
    output.say(f"\nthe tool is in {destination}; estimate the next run with\n  sherkit estimate {destination} {run}")
    if report is not None:
        output.say(f"the report is in {report}")


def _tared(tool: FlexibleTool, led: ToolRun, recorded: ToolRun) -> list[Tare]:
    """References of the untouched tool, then of the unloaded seconds of the run, which are nearer to it in time."""
    tares = []
    if led.present.any():
        tares.append(tare(tool, led, untouched=True))
        tool = tares[-1].tool
    return [*tares, tare(tool, recorded)]


def _say(heading: str, path: Path) -> None:
    output.out.print(f"\n[bold]{heading}[/]  ({path.name})")


def _print_errors(before: Estimate, after: Estimate) -> None:
    first, last = mean_errors(judge(before)), mean_errors(judge(after))
    if not last:
        raise MeasurementError(f"{after.run.source}: neither depth_mm nor a camera to judge by")
    table = output.table("Mean error, mm", "", "before", "with what was named")
    for quantity, signals in last.items():
        for signal, value in signals.items():
            table.add_row(f"{quantity}, {signal}", f"{first[quantity][signal]:.3f}", f"{value:.3f}")
    output.out.print(table)


def _json(
    calibration: ToolCalibration, found: Aligned, tares: list[Tare], diagnosis: Diagnosis, told: Applied,
    before: Estimate, after: Estimate,
) -> dict[str, Any]:  # fmt: skip
    errors = {
        name: {q: {s: finite(v) for s, v in one.items()} for q, one in mean_errors(judge(e)).items()}
        for name, e in (("before", before), ("after", after))
    }
    return {
        "calibration": calibration_json(calibration),
        "camera": alignment_json(found),
        "tare": [{"seconds": one.seconds, "shift_nm": one.shift_nm.tolist()} for one in tares],
        "diagnosis": diagnosis.to_json(),
        "written": list(told.written),
        "kept_out": list(told.kept_out),
        "errors_mm": errors,
        "trust": trust_json(after, known(after)),
        "knowledge": knowledge_json(known(after)),
        "tool": told.tool.to_tables(),
    }  # fmt: skip
