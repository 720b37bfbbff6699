"""What is really known of an effect: one number where one is known, and no more forms than the readings tell."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import sherkit as sk
import worlds
from sherkit.fit.forms import known, simplest_form
from sherkit.model.effect import Effect, Parameter

RAIL_LEAN = sk.delta.CATALOGUE["rail_lean"]


def fit_with(values: Any, covariance: Any, effect: Effect = RAIL_LEAN, readings: int = 900) -> Any:
    """A fit of this effect alone, with these numbers."""
    count = len(effect.parameters)
    model = SimpleNamespace(effects=(effect,), owns=lambda _: slice(0, count))
    data = SimpleNamespace(used=np.ones((readings, 1), dtype=bool))
    covariance = np.asarray(covariance, dtype=float)
    return SimpleNamespace(
        model=model, data=data, values=np.asarray(values, dtype=float), covariance=covariance,
        unobserved_covariance=np.zeros_like(covariance), priors=False,
    )  # fmt: skip


FORMS = {
    "common": ([0.0, 2e-3] * 3, "common", (1, 2, 3)),
    "one": ([0.0, 0.0, 3e-3, 0.0, 0.0, 0.0], "one", (2,)),
    "opposite": ([2e-3, 0.0, 0.0, 0.0, -2e-3, 0.0], "opposite", (1, 3)),
}


@pytest.mark.parametrize("name", FORMS)
def test_the_form_is_the_one_that_made_the_numbers(name: str) -> None:
    """Catches a form of the wrong limb or kind, and a deviation that is none: of 200 draws 90 %, those within 2 σ."""
    hidden, form, at = FORMS[name]
    rng = np.random.default_rng(1)
    mixed = rng.normal(size=(6, 6))
    covariance = 1e-8 * (np.eye(6) + mixed @ mixed.T)
    right = inside = 0
    size = np.rad2deg(max(hidden))
    for draw in rng.multivariate_normal(hidden, covariance, 200):
        one = simplest_form(fit_with(draw, covariance), RAIL_LEAN)
        if one is not None and (one.form, one.at, len(one.values)) == (form, at, 1):
            right += 1
            inside += abs(one.values[0].value - size) < 2 * one.values[0].std
    assert right >= 180
    assert inside >= 0.9 * right


def test_six_numbers_that_are_known_stay_six() -> None:
    """Catches a form that is forced on numbers that refuse it."""
    hidden = [1e-3, -2e-3, 2e-3, 1e-3, -3e-3, 2e-3]
    assert simplest_form(fit_with(hidden, 1e-9 * np.eye(6)), RAIL_LEAN) is None


def test_the_best_known_combination_is_said_where_no_form_holds() -> None:
    """Catches numbers given as findings of which only a sum is known, and that sum with a wrong sign or factor."""
    effect = Effect("tilt", "structure", (Parameter("a_1", "a", "mm", 1.0), Parameter("a_2", "a", "mm", 1.0)))
    along = np.array([2.0, 1.0]) / np.sqrt(5.0)
    across = np.array([-1.0, 2.0]) / np.sqrt(5.0)
    covariance = 1e-6 * np.outer(along, along) + 25.0 * np.outer(across, across)
    values = 0.1 * along + 40.0 * across
    one = simplest_form(fit_with(values, covariance, effect), effect)
    assert one.form == "combination"
    assert one.values[0].what == "a_1 + 0.5 a_2"
    assert one.values[0].value == pytest.approx(0.1 * np.sqrt(5.0) / 2.0)
    assert one.values[0].std == pytest.approx(1e-3 * np.sqrt(5.0) / 2.0)
    assert "best known" in one.sentence


@pytest.mark.parametrize("sigmas", [1.4, 40.0])
def test_a_combination_that_says_nothing_is_not_said(sigmas: float) -> None:
    """Catches a sum that may as well be zero in the first line of a report, and one of five parts, which nobody reads;
    both are kept for programs."""
    along = np.array([1.0, 0.0, 0.8, 0.0, 0.7, 0.0])
    five = np.array([0.4, -1.0, 0.9, 0.8, -0.9, 0.7])
    axes = [one / np.linalg.norm(one) for one in (along, five - along * (five @ along) / (along @ along))]
    covariance = 1e-5 * np.eye(6)
    covariance -= sum((1e-5 - std**2) * np.outer(one, one) for one, std in zip(axes, (1e-4, 2e-4), strict=True))
    values = 1e-4 * sigmas * axes[0] + 2e-2 * axes[1]
    one = simplest_form(fit_with(values, covariance), RAIL_LEAN)
    assert one is not None
    assert (one.form, [value.parts for value in one.values]) == ("combination", [3, 5])
    assert one.short.startswith(
        "best known: radial_1 + 0.8 radial_2 +" if sigmas > 3.0 else "known of all limbs together, of none alone"
    )
    assert len(one.short) < 80
    assert one.sentence.count("to better than") == 1
    assert [value["what"].count("_") for value in one.to_json()["values"]] == [3, 5]


def test_a_combination_is_known_as_it_is_written() -> None:
    """Catches parts that are left out or rounded in the words while the deviation is that of all of them: z to 8. 40
    covariances of which three directions are known, seed 3."""
    rng, z = np.random.default_rng(3), []
    names = [p.name for p in RAIL_LEAN.parameters]
    for _ in range(40):
        turn = np.linalg.qr(rng.normal(size=(6, 6)))[0]
        covariance = (turn * np.repeat([1e-9, 1e-5], 3)) @ turn.T
        hidden = rng.normal(scale=1e-3, size=6)
        one = simplest_form(fit_with(rng.multivariate_normal(hidden, covariance), covariance), RAIL_LEAN)
        if one is None or one.form != "combination":
            continue
        known = dict(zip(names, np.rad2deg(hidden), strict=True))
        for value in one.values:
            said = eval(re.sub(r"([\d.]+) (\w+_\d)", r"\1 * \2", value.what), {}, known)
            z.append((value.value - said) / value.std)
    assert len(z) > 20
    assert np.max(np.abs(z)) < 4.0


def test_where_poses_tell_less_the_other_forms_are_said() -> None:
    """Catches one of several forms given as the finding: heights of a plane tell one number of six."""
    study = worlds.printer_heights(0).study()
    study.add("rail_lean")
    one = known(study.fit)["rail_lean"]
    assert one.form == "common"
    assert "tangential" in one.values[0].what
    assert any("limb" in other for other in one.also)
    assert "not known to better than" in one.sentence


def test_a_diagnosis_says_it() -> None:
    """Catches tables and JSON that show six numbers where one is known."""
    d = worlds.delta_world(0, effects={"rail_lean": np.tile([0.0, 2e-3], 3)}).ask().diagnosis
    assert any("common tangential rail lean" in note for note in d.notes)
    (said,) = d.to_json()["known"]
    assert said["form"] == "common"
    assert abs(np.deg2rad(said["values"][0]["value"]) - 2e-3) < 3 * np.deg2rad(said["values"][0]["std"])
    lead = d.candidates[0]
    assert sk.diagnosis.largest(d, lead).startswith("common tangential rail lean")
    assert "common tangential rail lean" in str(d.fit)


def test_effects_without_limbs_are_left_alone() -> None:
    """Catches forms that are read into coordinates, or into a single number."""
    for name in ("drift", "thermal_growth", "beam_alignment"):
        effect = sk.delta.CATALOGUE[name]
        count = len(effect.parameters)
        assert simplest_form(fit_with(np.ones(count), np.eye(count), effect), effect) is None
