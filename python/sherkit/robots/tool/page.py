"""The page of a tool's run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...base.answer import Answer
from ...diagnosis import Diagnosis
from ...report.notebook import telling_pictures
from ...report.page import Made, Section, html_sentences, write_page
from .pictures import EstimateOverTime, estimate_picture


def write_estimate(
    path: Path, answer: Answer, over_time: EstimateOverTime, tables: Sequence[str], made: Made,
    found: Diagnosis | None = None,
) -> None:  # fmt: skip
    """Depth and tip over a run, ``tables`` of their errors, and what a diagnosis ``found``, where one was asked. Raises
    :class:`~sherkit.errors.NotWritten`."""
    drawn = estimate_picture(over_time)
    sections = [Section(f"{over_time.name.capitalize()} over the run", "", drawn.root, drawn.note)]
    if any(tables):
        sections.append(Section("Errors", "".join(tables)))
    for k, picture in enumerate(telling_pictures(found) if found is not None else ()):
        title = "What is missing" if not k else f"What the camera sees, {k}"
        sections.append(Section(title, "", picture.root, picture.note))
    if found is not None:
        sections.append(Section("What the verdict rests on", html_sentences(*map(str, found.checks))))
    write_page(path, answer, sections, made)
