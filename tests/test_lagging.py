"""Columns of what follows the room late: one pattern by how much warmer it is, at any lag.

Would catch: a pattern that knows the room it was made in, a lag counted from another temperature, columns in another
order or over another noise than those of the model at that lag.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sherkit as sk
from sherkit.data.in_time import Room
from sherkit.evidence.fitted_run import FittedRun
from sherkit.model.kinds import known_kinds, model_of


@pytest.mark.parametrize("name", ["delta", "spherical", "serial"])
@pytest.mark.parametrize("within", [(), ("thermal_growth",)])
def test_columns_at_any_lag_are_those_of_the_model_with_it(name: str, within: tuple[str, ...]) -> None:
    kind = known_kinds()[name]
    robot = kind.example
    virtual = kind.require_virtual().simulated(robot, 1, 1.0, {k: o.default for k, o in kind.virtual.OPTIONS.items()})
    places = kind.areas[next(iter(kind.areas))](robot)[::7]
    data = virtual.measure(places, repeats=2, order="shuffled", seed=3)
    n = len(data)
    time = 4.0 * np.arange(n)
    room = 21.0 + 3.0 * np.sin(time / 300.0) + 1e-3 * time
    data = replace(
        data, time_s=time, order=np.arange(n), covariates={**data.covariates, "temperature_c": room},
        room=Room(time, room),
    )  # fmt: skip
    run = FittedRun(sk.identify(robot, data, effects=within))
    effect = model_of(robot).known_effects["thermal_shift"]
    sigma = np.full(len(run.axes), 0.3)
    rows = np.arange(n)[n // 5 :]
    view = run.linearised(rows, [effect], sigma)
    ((_, behind),) = view.lagging
    part = data.select(rows)
    for lag in (20.0, 400.0):
        model = run.model.with_settings(effect, lag)
        direct = model.tried(part, run.fit.values, [effect]).columns(slice(3, 40))[:, list(run.axes)] / 0.3
        np.testing.assert_allclose(behind(lag)(slice(3, 40)), direct, rtol=1e-6, atol=1e-9 * np.abs(direct).max())
