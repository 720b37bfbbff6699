"""A flexible tool's file, as the verbs ask for it: a run of it is a series in time beside a camera's pictures."""

from __future__ import annotations

import shlex
import webbrowser
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from ....base.figures import listed
from ....cli import output
from ....cli.file_kinds import PAGE, TOOL
from ....cli.output import refuse_given
from ....cli.paths import OutputFile, require_kind
from ....data import Measurements
from ....data.files import write_whole
from ....diagnosis import Diagnosis
from ....diagnosis import diagnose as run_diagnosis
from ....errors import SherkitError
from ....fit.identify import identify
from ....model.base import ModelWithEffects
from ....model.effect import Effect, load_effects
from ....model.kinds import model_of
from ..c_header import tool_header
from ..calibration import calibrate_tool, read_loads
from ..effects import TOOL_CATALOGUE
from ..filters import estimate
from ..model import ToolModel, mended
from ..runs import read_tool_run
from ..tool import KIND, FlexibleTool, load_tool
from ..virtual import EXPERIMENTS, VirtualTool
from .check import check_table
from .estimate import sentences_of, write_tool_report
from .loads import calibration_json, print_calibration


class ToolFile:
    """A flexible tool."""

    kind = KIND
    title = "the flexible tool and its camera"
    catalogue: Mapping[str, Effect] = TOOL_CATALOGUE
    example = FlexibleTool()
    drawn_on = None
    simulate_options = (
        click.Option(["--experiment"], type=click.Choice((*EXPERIMENTS, "free", "bench")), default="vessels",
                     show_default=True, help="Flexible tool: one of the paper's, free (unbent), bench (known loads)."),
        click.Option(["--seconds"], type=click.FloatRange(min=2), default=60.0, show_default=True,
                     help="Flexible tool."),
    )  # fmt: skip

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def own_ways(self) -> Mapping[str, Callable[..., None]]:
        """A bench of known loads instead of poses, a page that is one file, runs in time, a header and own tables."""
        return {"calibrate": self._calibrate, "app": self._app, "simulate": self._simulate, "export": self._export,
                "check": self._check}  # fmt: skip

    # -- a diagnosis -------------------------------------------------------------------------------------

    def read(self, runs: Sequence[Path]) -> tuple[ModelWithEffects, Measurements]:
        """The tool in one run, and where the camera saw its tip."""
        if len(runs) > 1:
            raise SherkitError(f"{runs[1]}: runs of a flexible tool are diagnosed one at a time")
        tool = load_tool(self.path)
        self.model = ToolModel(tool, read_tool_run(runs[0], tool.columns))
        return model_of(self.model), self.model.readings

    def told(self, runs: Sequence[Path]) -> tuple[Path, ...]:
        """Tool and run."""
        return (self.path, *runs)

    def require_writable(self, destination: Path | None) -> None:
        """A tool's file holds what was named."""

    def write(self, destination: Path, found: Diagnosis) -> tuple[Diagnosis, list[str]]:
        """The tool with what was named."""
        told = mended(self.model, found)
        told.tool.save(destination)
        go_on = f"sherkit estimate {shlex.quote(str(destination))} RUN"
        return found.added(go_on), [*sentences_of(told), f"the tool is in {destination}"]

    def report(self, path: Path, found: Diagnosis, *, sources: Sequence[Path], **_: Any) -> None:
        """The story of the run, with what was named written into the tool."""
        told = mended(self.model, found)
        write_tool_report(path, found, estimate(told.tool, self.model.run), told, sources)

    # -- verbs in a way of its own -----------------------------------------------------------------------

    def _check(self, table: Path, destination: Path | None, *, as_json: bool) -> None:
        refuse_given("run", "robot", "destination", "as_json", why="is not for tables of a flexible tool")
        check_table(load_tool(self.path), self.path, table, destination, as_json=as_json)

    def _calibrate(self, loads: Path, destination: Path | None, *, as_json: bool) -> None:
        refuse_given(
            "robot", "runs", "destination", "columns", "as_json", why="is not for the known loads of a flexible tool"
        )
        if destination is not None:
            require_kind(destination, "--output", (TOOL,))
        drawn = load_tool(self.path)
        result = calibrate_tool(drawn, read_loads(loads, drawn.columns))
        if destination is not None:
            result.tool.save(destination)
        if as_json:
            output.print_json({**calibration_json(result), "tool": result.tool.to_tables()})
            return
        print_calibration(result)
        if destination is not None:
            output.say(f"calibrated tool written to {destination}")

    def _app(self, run: Path, files: Sequence[Path], *, opened: bool) -> None:
        """Estimates and diagnoses the run, writes the page beside it and opens it: depth over time with its errors,
        verdict, what each effect would bring, and what is left."""
        refuse_given(
            "robot", "run", "files", "no_open",
            why=f"{self.path}: the page of a flexible tool's run is one file, beside RUN; give TOOL and RUN, and "
            "--effects for effects of your own",
        )  # fmt: skip
        page = OutputFile(PAGE).checked(run.parent / f"{run.stem}.story.html", "the page beside RUN")
        own = tuple(effect for file in files for effect in load_effects(file))
        with output.steps(14) as step:
            step(f"reading {run}")
            model, data = self.read((run,))
            step("fitting the camera's offset")
            found = run_diagnosis(identify(model, data), effects=own, step=step)
            step("depth and tip")
            self.report(page, found, sources=(self.path, run))
        output.say(f"{found.headline}\nthe page is {page}")
        if opened:
            webbrowser.open(page.resolve().as_uri())

    def _simulate(self, destination: Path, *, seed: int, given: Mapping[str, Any]) -> None:
        """A run of the tool as its file has it."""
        experiment, seconds = given["experiment"], given["seconds"]
        own = {option.name for option in self.simulate_options}
        wrong = [
            f"--{name.replace('_', '-')}" for name, value in given.items() if value is not None and name not in own
        ]
        if wrong:
            raise SherkitError(f"{self.path}: is a flexible tool; {listed(wrong)} is not for that kind")
        virtual = VirtualTool(load_tool(self.path))
        if experiment == "bench":
            loads = virtual.bench(seed=seed)
            loads.save(destination)
            output.say(f"{len(loads)} loads written to {destination}", destination)
            return
        if experiment == "free":
            run = virtual.free_motion(seconds=seconds, seed=seed)
        else:
            run = virtual.run(experiment, seconds=seconds, seed=seed)
        run.save(destination)
        output.say(f"{len(run)} rows and {len(run.camera_time_s)} pictures written to {destination}", destination)

    def _export(self, destination: Path) -> None:
        """A C header."""
        made = load_tool(self.path)
        if made.noise != "propagated":
            output.warn(
                f"{self.path}: noise '{made.noise}' is for comparisons; the loop in C runs the filter of 'propagated'"
            )
        write_whole(destination, tool_header(made, self.path.name))
        output.say(f"{destination} written; a loop includes it: cc loop.c $(sherkit c --cflags --libs)")
