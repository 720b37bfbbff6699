"""What is seen of a loop while it goes on: errors at readings that no fit knew yet, why poses were driven, the page."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest

import sherkit as sk
from driven_worlds import DrivenDelta, World
from sherkit.report.page import Made
from sherkit.report.pages import write_adaptive

HIDDEN = "rail_lean"


@pytest.fixture(scope="module")
def on_its_way() -> tuple[sk.Adaptive, World, list[str]]:
    """A loop after four looks, and why each row was asked for."""
    world = DrivenDelta(1, (HIDDEN,), 5.0)
    loop, asked = sk.Adaptive(world.robot, budget=150, span_min=60.0, required_um=20), []
    for _ in range(4):
        rows = loop.ask()
        asked += [row["reason"] for row in rows]
        # what read them hands on what it was asked
        loop.tell([told | {"reason": row["reason"]} for told, row in zip(world.read(rows), rows, strict=True)])
    return loop, world, asked


def test_the_error_is_that_of_readings_that_the_fit_did_not_know(
    on_its_way: tuple[sk.Adaptive, World, list[str]],
) -> None:
    """Catches an error of rows that were fitted, of other rows, or in another unit: a fit of the geometry to the rows
    before, by the door that everybody uses, is off by as much at the rows since."""
    loop, _, _ = on_its_way
    before, now = loop.looks[-2:]
    rows = loop.data.select(np.arange(before.readings))
    fit = sk.identify(loop.robot, rows.mark_outliers(before.aside))
    left = now.data.readings - fit.model.predict(now.data, fit.values)
    by_hand = 1e3 * np.sqrt(np.mean(np.square(left[before.readings :])))
    # axes weigh a little otherwise there
    assert loop.progress[-1].by_geometry == pytest.approx(by_hand, rel=0.25)
    assert loop.progress[-1].by_lead < 0.5 * loop.progress[-1].by_geometry
    assert not np.isfinite(loop.progress[0].by_geometry)
    assert "µm by the geometry alone" in loop.sentence()


@pytest.mark.slow
def test_reasons_are_kept_with_the_rows(on_its_way: tuple[sk.Adaptive, World, list[str]], tmp_path: Path) -> None:
    """Catches reasons that are lost in a file, or that stand at other rows."""
    loop, _, asked = on_its_way
    # one file has one loop: the copy gives it back
    kept = copy.deepcopy(loop)
    kept.save(tmp_path / "loop.json")
    kept.close()
    again = sk.Adaptive.load(tmp_path / "loop.json")
    assert again.reasons == loop.reasons == tuple(asked)
    assert asked[:12] == ["start"] * 12
    assert again.ask() == loop.ask()


def test_the_page_renews_itself_until_it_is_known(
    on_its_way: tuple[sk.Adaptive, World, list[str]], tmp_path: Path
) -> None:
    """Catches a page that stands still while the run goes on, one that never ends, and one that hides what is next."""
    loop, world, _ = on_its_way
    write_adaptive(tmp_path / "page.html", loop, Made("A <run>"))
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert 'http-equiv="refresh"' in page
    assert "Next: " in page
    assert "A &lt;run&gt;" in page
    assert HIDDEN in page
    done = sk.Adaptive(world.robot, budget=loop.readings)
    done.tell(loop.data)
    assert done.done
    write_adaptive(tmp_path / "page.html", done, Made("A run"))
    assert 'http-equiv="refresh"' not in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_a_page_of_nothing_yet(tmp_path: Path) -> None:
    """Catches a page that fails before the first look."""
    loop = sk.Adaptive(DrivenDelta(1).robot)
    write_adaptive(tmp_path / "page.html", loop, Made("A run"))
    assert "0 readings" in (tmp_path / "page.html").read_text(encoding="utf-8")
