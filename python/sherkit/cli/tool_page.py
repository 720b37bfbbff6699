"""``sherkit app`` on a run of a flexible tool: the story of the run as one page, in the browser."""

from __future__ import annotations

import webbrowser
from pathlib import Path

from ..diagnosis import diagnose as run_diagnosis
from ..fit.identify import identify
from ..model.effect_file import load_effects
from ..robots.tool.applied import applied
from ..robots.tool.filters import estimate
from ..robots.tool.model import ToolModel
from ..robots.tool.runs import read_tool_run
from ..robots.tool.tool import load_tool
from . import output
from .tool import write_tool_report


def show_tool(tool: Path, run: Path, files: tuple[Path, ...], *, opened: bool) -> None:
    """Estimates and diagnoses RUN, writes the page beside it and opens it: depth over time with its errors, verdict,
    what each effect would bring, and what is left."""
    own = tuple(effect for file in files for effect in load_effects(file))
    with output.steps(14) as step:
        step(f"reading {run}")
        model = ToolModel(load_tool(tool), read_tool_run(run))
        step("fitting the camera's offset")
        found = run_diagnosis(identify(model, model.readings), effects=own, step=step)
        told = applied(model, found.fit)
        step("depth and tip")
        after = estimate(told.tool, model.run)
    page = run.parent / f"{run.stem}.story.html"
    write_tool_report(page, f"{tool.stem} on {run.name}", found, after, told)
    output.say(f"{found.headline}\nthe page is {page}")
    if opened:
        webbrowser.open(page.resolve().as_uri())
