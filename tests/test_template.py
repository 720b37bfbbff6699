"""A template of an effect, filled in from what a run leaves: it runs as it is, on every robot and on a user's model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

import sherkit as sk
import test_discovery as delta
import test_spherical_discovery as spherical
from running import slow
from sherkit.diagnosis import template
from sherkit.diagnosis.template import course
from sherkit.model.effect import load_effects
from strategies import EXAMPLE
from worlds import WrongDerivative


def of_a_delta() -> tuple[Any, sk.Measurements]:
    """What goes with the humidity: no effect of the catalogue."""
    return delta.DELTA, delta.measured(delta.GRIDS["small"], 3, scaled={"humidity": 4 * delta.NOISE_UM}).data


def of_a_spherical_robot() -> tuple[Any, sk.Measurements]:
    """A cube of one joint, in v alone; the robot file has no workspace."""
    frame = spherical.measured("small", 4).data.to_frame()
    theta = frame["theta2_rad"].to_numpy()
    cube = 0.4 * ((theta - theta.mean()) / theta.std()) ** 3
    return spherical.ROBOT, sk.from_frame(frame.with_columns(v_px=frame["v_px"] + pl.Series(cube)))


def of_a_users_model() -> tuple[Any, sk.Measurements]:
    """A turntable that shows how warm its scale is."""
    rng = np.random.default_rng(3)
    pose = np.repeat(np.arange(100), 3)
    angle, warm = rng.uniform(-3.0, 3.0, 100)[pose], rng.uniform(18.0, 26.0, 100)[pose]
    shown = 1e3 * angle + 1.0 + 4.0 * np.sin(angle) + 8.0 * np.sin(2 * angle) + 0.3 * (warm - 22.0) ** 2
    readings = (shown + 0.2 * rng.normal(size=300))[:, None]
    data = sk.data.from_arrays(
        place={"angle_rad": angle}, readings=readings, names=("shown",), unit="mrad", pose=pose,
        covariates={"scale_c": warm},
    )  # fmt: skip
    return Warmed(wrong=False), data


class Warmed(WrongDerivative):
    """The turntable whose temperature may be a suspect."""

    def covariates(self, data: sk.Measurements) -> dict[str, Any]:
        return {"scale_c": data["scale_c"]}


def test_a_course_that_no_polynomial_names_has_no_order() -> None:
    """Catches "varies smoothly (order None)"."""
    shape = {"shape": "smooth", "order": None, "period": None, "at": None, "axis": ["x"], "joint": None}
    assert course(shape | {"depends_on": ["time_s"]}) == "the error in x varies smoothly with time_s"
    assert "(order 2)" in course(shape | {"depends_on": ["time_s"], "order": 2})
    warms = shape | {"depends_on": ["time_s"], "at": 1234.5}
    assert course(warms) == "the error in x settles in the course of time, by two thirds in 1234 s"


@pytest.mark.parametrize("of", [*slow(of_a_delta, of_a_spherical_robot), of_a_users_model])
def test_the_template_of_what_is_left_explains_it(of: Any, tmp_path: Path) -> None:
    """Catches a template that knows the columns of one robot, or a study that cannot take it."""
    robot, data = of()
    fit = sk.identify(robot, data)
    d = sk.diagnose(fit)
    assert d.signature is not None
    path = tmp_path / "my_effects.py"
    path.write_text(template(d.signature, data.layout, "unknown_effect", path.name), encoding="utf-8")
    (effect,) = load_effects(path)
    again = sk.diagnose(fit, effects=(effect,))
    assert "unknown_effect" in again.effects
    assert again.steps[-1].error.rms < 0.5 * again.steps[0].error.rms
    if isinstance(robot, sk.delta.Delta | sk.spherical.Spherical):
        study = sk.Study(robot, data)
        before = study.diagnose().steps[0].error.rms
        assert study.add(effect).error.rms
        assert study.diagnose().steps[0].error.rms < 0.5 * before


@pytest.mark.parametrize("seed", [1, *slow(0, 2)])
def test_a_template_of_places_holds_wherever_the_instrument_stands(seed: int, tmp_path: Path) -> None:
    """Catches numbers of the base in a template whose rows give places as a tracker reads them that stands turned: of a
    saddle of 25 µm 13 to 23 were left."""
    run = sk.delta.VirtualDelta.draw(EXAMPLE, seed).measure(sk.delta.paper_whole()[::3], repeats=2, seed=seed)
    at = run.readings[:, :3]
    at = at + 0.06 * np.outer(at[:, 0] * at[:, 1] / 400.0, [0.0, 0.0, 1.0])
    seen = Rotation.random(random_state=seed).apply(at) + np.array([300.0, -200.0, 500.0])
    data = sk.from_frame(run.to_frame().with_columns(**{f"{a}_mm": pl.Series(seen[:, k]) for k, a in enumerate("xyz")}))
    found = sk.diagnose(EXAMPLE, data)
    assert found.signature is not None
    assert set(found.signature["depends_on"]) == {"x_mm", "y_mm"}
    path = tmp_path / "my_effects.py"
    path.write_text(template(found.signature, data.layout, "unknown_effect", path.name), encoding="utf-8")
    with_it = sk.identify(EXAMPLE, data, effects=load_effects(path))
    assert with_it.error.rms < 1.3 * sum(v**2 for v in found.noise.values()) ** 0.5
