"""What a refit leaves is tested with the columns that the fit before it had, those of what is fitted alone made anew:
beside it the same with all columns made anew."""

from __future__ import annotations

import numpy as np
import pytest

import sherkit as sk
from sherkit.diagnosis.explanation import refit
from sherkit.diagnosis.search import Search
from sherkit.evidence.fitted_run import FittedRun
from test_discovery import DELTA, measured, whole_grid


@pytest.mark.parametrize(
    ("name", "noises"), [("rail_lean", 60.0), ("slip", 8.0), ("thermal_growth", 20.0), ("backlash", 6.0)]
)
def test_what_a_refit_leaves_is_seen_as_if_all_columns_were_made_anew(name: str, noises: float) -> None:
    """Catches an effect that is taken for fitted by what it was to first order from zero, a residual, a candidate or a
    pattern of signs of the fit before: the sum of squares is the same to rounding, the p to 0.02."""
    places = whole_grid()
    chosen = np.random.default_rng([77, 1]).choice(len(places), 120, replace=False)
    run = FittedRun(sk.identify(DELTA, measured(places[chosen], 1, repeats=3, scaled={name: noises}).data))
    search = Search(run, run.catalogue, np.arange(len(run.data)), run.noise[0], level=0.01)
    stage = search.stage(search.base)
    assert search.p_value(stage) < 0.01
    found = next(c for c in search.strongest_settings(stage) if c.name == name)
    fit = refit(stage.run, (found,))
    seen, anew = stage.refitted(fit, (found,)), search.stage(fit)
    assert {(c.name, c.setting) for c in seen.candidates} == {(c.name, c.setting) for c in anew.candidates}
    assert seen.scan.sum_of_squares == pytest.approx(anew.scan.sum_of_squares, rel=1e-9)
    assert search.p_value(seen) == pytest.approx(search.p_value(anew), abs=0.02)
