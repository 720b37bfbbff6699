"""``sherkit estimate``: depth and tip of a flexible tool over a recorded run."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from itertools import combinations_with_replacement
from pathlib import Path

import click
import numpy as np
import polars as pl

from ....base.answer import AFTER, BEFORE, Bar, ToDo, as_sentence
from ....base.figures import finite, listed
from ....base.types import Floats
from ....cli import output
from ....cli.file_kinds import PICTURE, TABLE
from ....cli.paths import InputFile, OutputFile
from ....data.tables import write_table
from ....diagnosis import Diagnosis
from ..consistency import ErrorStatistics, NeesConsistency, SignalErrors, judge, known, mean_errors
from ..filters import Estimate, status_in_words
from ..filters import estimate as run_filters
from ..model import Applied
from ..runs import read_tool_run, summary
from ..tool import load_tool
from ..trust import COARSE, trust

#: Filters by the name that a person gives, and by what a tool file calls their noise.
_FILTERS = {"rod": "propagated", "paper": "ebrahimi_2020", "paper-of-force": "ebrahimi_2020_of_force"}
_KNOWN = "Does the filter know its own errors?"
_KNOWLEDGE = ("rows", "95 % cover", "NEES", "99 % band", "largest / σ", "verdict")


@click.command()
@click.argument("tool", type=InputFile())
@click.argument("run", type=InputFile())
@click.option("-o", "--output", "destination", type=OutputFile(TABLE), help="Write the estimates (CSV, Parquet).")
@click.option(
    "--filter",
    "which",
    type=click.Choice(tuple(_FILTERS)),
    help="Whose estimates are written: of the rod about its pivot, or the paper's own filters.",
)
@click.option("--both", is_flag=True, help="Write the paper's filters beside, as columns of their own.")
@click.option("--report", "picture", type=OutputFile(PICTURE),
              help="Draw estimate, band, truth and force over time (HTML, PNG or SVG).")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs instead of tables.")
def estimate(
    tool: Path, run: Path, destination: Path | None, which: str | None, both: bool, picture: Path | None, as_json: bool
) -> None:
    """Replay RUN (CSV or Parquet) of a flexible TOOL (TOML): insertion depth and tip, and how far they are off."""
    if picture is not None:
        output.require_view()
    made = load_tool(tool)
    if which is not None:
        made = made.with_noise(_FILTERS[which])
    result = run_filters(made, read_tool_run(run, made.columns))
    judged, truths = judge(result), known(result)
    if destination is not None:
        write_table(_frame(result, both=both), destination)
    answer = replace(trust(result, truths).answer, bars=_bars(judged), unit="mm")
    if picture is not None:
        from ....report.page import save_picture
        from ..pictures import depth_over_time, estimate_picture, write_estimate

        if picture.suffix.lower() == ".html":
            write_estimate(picture, answer, depth_over_time(result), _tables(result), output.made_by([tool, run]))
        else:
            save_picture(estimate_picture(depth_over_time(result), as_sentence(answer.verdict)), picture)
    if as_json:
        output.print_json(_json(result, judged, truths))
        return
    output.show(answer, tool, run)
    sizes = summary(result.run)
    output.say(
        f"{sizes['rows']} rows of the robot at {sizes['robot_hz']:.0f} Hz, {sizes['pictures']} pictures; "
        f"filter: {next(name for name, noise in _FILTERS.items() if noise == made.noise)}"
    )
    for j in judged:
        table = output.table(
            f"Error of the {j.quantity}, mean, mm", "", "whole run", f"T0 ({100 * j.share_t0:.0f} %)", "T1", "largest",
            note=f"against {j.truth}; T0: filter and {'gratings' if j.quantity == 'depth' else 'kinematics'} differ by "
            "more than 0.1 mm",
        )  # fmt: skip
        for e in j.errors:
            table.add_row(e.signal, *_error_cells(e))
        output.out.print(table)
    if not judged:
        output.say("neither depth_mm nor a camera is in this run: nothing to judge by")
    print_knowledge(truths)
    for fault in result.faults:
        output.warn(f"{result.run.source}: {fault}")
    told = {name: n for name, n in status_in_words(result.depth).items() if n and name != "updated"}
    if told:
        output.say("depth was only predicted on rows " + ", ".join(f"{name}: {n}" for name, n in told.items()))
    output.say(_left_gratings(result))
    if destination is not None:
        output.say(f"estimates written to {destination}")
    if picture is not None:
        output.say(f"drawn in {picture}")


def _bars(judged: Sequence[ErrorStatistics]) -> tuple[Bar, ...]:
    """Mean errors of the depth beside the paper's filter, where the run tells them."""
    errors = mean_errors(judged).get("depth", {})
    which = ((BEFORE, "paper's filter"), (AFTER, "filter"))
    return tuple(
        Bar(what, f"depth, {name}", errors[name]) for what, name in which if np.isfinite(errors.get(name, np.nan))
    )


def _error_cells(e: SignalErrors) -> tuple[str, ...]:
    return tuple(f"{v:.3f}" if np.isfinite(v) else "–" for v in (e.total, e.t0, e.t1, e.largest))


def print_knowledge(truths: list[NeesConsistency]) -> None:
    """Whether stated deviations are true, where a truth is known."""
    if truths:
        coarse = any(k.of_truth > COARSE for k in truths)
        table = output.table(
            _KNOWN, "", *_KNOWLEDGE,
            note="NEES per degree of freedom is 1 where deviations are true"
            + (f"; more than {100 * COARSE:.0f} % of the tip's is the camera's own std_mm" if coarse else ""),
        )  # fmt: skip
        for cells in _knowledge_cells(truths):
            table.add_row(*cells)
        output.out.print(table)


def _knowledge_cells(truths: list[NeesConsistency]) -> Iterator[tuple[str, ...]]:
    """Rows of the table on it; where the truth is the coarser of both, an error beyond what is stated may as well be
    its own."""
    for k in truths:
        if k.signal == "filter" or k.condition == "whole run":
            own = ", or the camera" if k.verdict == "overconfident" and k.of_truth > COARSE else ""
            yield (
                f"{k.quantity}, {k.signal}, {k.condition}", str(k.rows), f"{k.coverage:.3f}", f"{k.nees:.2f}",
                f"{k.low:.2f} to {k.high:.2f}", f"{k.largest:.1f}", f"{k.verdict}{own}",
            )  # fmt: skip


def _json(e: Estimate, judged: list[ErrorStatistics], truths: list[NeesConsistency]) -> dict[str, object]:
    return {
        "noise": e.tool.noise,
        "run": {k: finite(float(v)) for k, v in summary(e.run).items()},
        "errors_mm": {
            j.quantity: {
                "share_t0": j.share_t0,
                "against": j.truth,
                **{
                    x.signal: {k: finite(getattr(x, k)) for k in ("total", "t0", "t1", "largest")} for x in j.errors
                },
            }
            for j in judged
        },
        "trust": trust_json(e, truths),
        "innovations": finite(e.depth.consistency.ratio),
        "knowledge": knowledge_json(truths),
        "status": status_in_words(e.depth),
        "faults": [{**asdict(f), "sentence": str(f)} for f in e.faults],
    }  # fmt: skip


def trust_json(e: Estimate, truths: list[NeesConsistency]) -> dict[str, object]:
    """What a run says of itself, for programs."""
    told = trust(e, truths)
    return {
        "verdict": told.verdict, "of": told.of, "sentence": told.sentence, "to_do": told.to_do,
        "noticed": list(told.noticed), "checks": [asdict(one) for one in told.checks],
    }  # fmt: skip


def trust_in_words(e: Estimate) -> tuple[str, ...]:
    """The same in sentences, the verdict first."""
    told = trust(e, known(e)).answer
    return f"{told.verdict}: {told.sure[0]}", *told.sure[1:]


def knowledge_json(truths: list[NeesConsistency]) -> list[dict[str, object]]:
    """What is known of its errors, for programs."""
    return [{**asdict(k), "verdict": k.verdict} for k in truths]


def _frame(e: Estimate, *, both: bool = False) -> pl.DataFrame:
    """Estimates by row, with what the gratings alone say, and ``both``: with the paper's filters."""

    def along(name: str, places: Floats) -> dict[str, Floats]:
        return {name.format(axis): values for axis, values in zip("xyz", places.T, strict=True)}

    columns = {
        "time_s": e.run.time_s,
        "force_x_mn": e.force_mn[:, 0],
        "force_y_mn": e.force_mn[:, 1],
        "force_std_mn": e.force_std_mn,
        "fibre_force_x_mn": e.fibre_force_mn[:, 0],
        "fibre_force_y_mn": e.fibre_force_mn[:, 1],
        "fibre_depth_mm": e.fibre_depth_mm,
        "fibre_depth_std_mm": np.where(np.isfinite(e.fibre_depth_std_mm), e.fibre_depth_std_mm, np.nan),
        "depth_mm": e.depth.value[:, 0],
        "arc_mm": e.arc_mm,
        "depth_std_mm": e.depth.std[:, 0],
        **along("tip_{}_mm", e.tip.value),
        **along("tip_{}_std_mm", e.tip.std),
        "joint_depth_mm": e.together.value[:, 0],
        **along("joint_tip_{}_mm", e.together.value[:, 1:]),
        **{
            f"covariance_{m}_{n}_mm2": e.together.covariance[:, i, k]
            for (i, m), (k, n) in combinations_with_replacement(enumerate(("depth", *"xyz")), 2)
        },
        **({} if not both else {
            "paper_depth_mm": e.paper.value[:, 0],
            "paper_depth_std_mm": e.paper.std[:, 0],
            **along("paper_tip_{}_mm", e.paper.value[:, 1:]),
            **along("paper_tip_{}_std_mm", e.paper.std[:, 1:]),
        }),
        "misfit": e.misfit,
        "gated": e.gated,
        "faulty": e.faulty,
        "status": e.depth.status | e.tip.status,
        "nis_depth": e.depth.nis,
        "nis_tip": e.tip.nis,
    }  # fmt: skip
    return pl.DataFrame(columns).with_columns(pl.col(pl.Float64).fill_nan(None))


def _left_gratings(e: Estimate) -> str:
    """One line on where the filter left its own gratings for longer than half a second."""
    spans = e.away
    if not spans:
        return "the filter nowhere left its own gratings by more than their deviation for longer than 0.5 s"
    total = sum(b - a for a, b in spans)
    some = listed((f"{a:.1f} to {b:.1f} s" for a, b in spans), 4)
    return f"the filter left its own gratings by more than their deviation for {total:.1f} s: {some}"


def sentences_of(told: Applied) -> list[str]:
    """What was written into a tool file, and what has no place there."""
    written = listed((*told.written, "the camera's offset"))
    return [f"written into the tool: {written}", *told.why]


def write_tool_report(
    path: Path, found: Diagnosis, e: Estimate, told: Applied, sources: Sequence[Path], written: Path | None = None
) -> None:  # fmt: skip
    """The story of a run as one HTML file: what was missing, then depth and tip with that in the tool."""
    from ..pictures import depth_over_time, write_estimate  # Bokeh takes a second to load

    sure = (*trust_in_words(e), *sentences_of(told), *map(str, e.faults))
    to_do = found.answer.to_do
    if written is not None:
        # what was named is in the tool already
        go_on = ToDo("estimate the next run", f"sherkit estimate {shlex.quote(str(written))} RUN")
        to_do = (*(one for one in to_do if not one.command), go_on)
    answer = replace(found.answer, sure=(*found.answer.sure, *sure), to_do=to_do)
    write_estimate(path, answer, depth_over_time(e), _tables(e), output.made_by(sources), found)


def _tables(e: Estimate) -> list[str]:
    """Errors and what the filter knows of them, as HTML."""
    from ....report.page import html_table

    errors = [(f"{j.quantity}, {x.signal}", *_error_cells(x)) for j in judge(e) for x in j.errors]
    tables = (
        ("Mean error, mm", ("", "whole run", "T0", "T1", "largest"), errors),
        (_KNOWN, ("", *_KNOWLEDGE), list(_knowledge_cells(known(e)))),
    )
    return [html_table(heads, rows, caption) for caption, heads, rows in tables if rows]
