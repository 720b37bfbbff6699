"""Machines that are no deltas: the telescope mounts of ``examples/telescope_mount.py``, measured and simulated."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import sherkit as sk
from sherkit.fit.hold_out import hold_out

Floats = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples" / "telescope_mount.py"
DATA = ROOT / "tests" / "data"


def _load() -> Any:
    spec = importlib.util.spec_from_file_location("telescope_mount", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up there
    spec.loader.exec_module(module)
    return module


mount = _load()


def on_sky(report: Any) -> float:
    """Held-out RMS as an angle on the sky, arcsec."""
    return float(report.error.rms if hasattr(report, "error") else report.held_out_rms)


# -- measured ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def gem() -> sk.diagnosis.Diagnosis:
    return mount.diagnosed(mount.read_gem(DATA / mount.GEM, "gem-28.dat"))


def test_gem_tube_flexure_is_found(gem: sk.diagnosis.Diagnosis) -> None:
    # known of this run: 557″ with six terms, 208″ with tube flexure, when single stars are held out
    assert gem.effects == ("tube_flexure",)
    before, after = [on_sky(s) for s in gem.steps]
    assert before == pytest.approx(557.0, rel=0.03)
    assert after == pytest.approx(208.0, rel=0.04)
    assert gem.confirmed is not None
    assert gem.confirmed < 0.01
    (flexure,) = (c.parameters[0] for c in gem.candidates if c.effect == "tube_flexure")
    assert flexure["value"] == pytest.approx(-1450.0, abs=60.0)


def test_gem_is_explained_only_in_part(gem: sk.diagnosis.Diagnosis) -> None:
    assert gem.verdict == "partly explained"
    assert gem.signature is not None
    left = gem.error.rms
    assert left == pytest.approx(195.0, abs=15.0)


def test_gem_outliers_are_the_rows_off_by_a_turn(gem: sk.diagnosis.Diagnosis) -> None:
    off = np.flatnonzero(np.abs(gem.fit.data.readings).max(axis=1) > 3600.0 * 90.0)
    assert len(off) == 19
    assert set(off) <= set(gem.outliers.tolist())
    # a few more stand out from 435 rows whose errors are no noise
    assert len(gem.outliers) <= 19 + 6


@pytest.mark.slow
def test_gem_tiles_of_the_sky_tell_the_same(gem: sk.diagnosis.Diagnosis) -> None:
    """Held out by neighbourhoods, errors are larger, the cause is the same."""
    rows = replace(gem.fit.data, block=None, outlier=np.zeros(len(gem.fit.data), dtype=bool))
    d = mount.diagnosed(rows)
    assert d.effects == ("tube_flexure",)
    assert d.verdict == "partly explained"
    before, after = [on_sky(s) for s in d.steps]
    assert after < 0.4 * before


@pytest.mark.parametrize("night", ["20230702", "20230924"])
def test_mmt_next_to_nothing_is_missing(night: str) -> None:
    rows = mount.read_mmt(DATA / mount.MMT, f"point_{night}.dat")
    d = mount.diagnosed(rows)
    assert d.verdict == "adequate"
    assert d.effects == ()
    assert on_sky(d.steps[0]) == pytest.approx(1.4, abs=0.1)
    assert {c.effect for c in d.candidates} == {e.name for e in mount.Mount.candidates}
    # a twentieth of it
    assert max(on_sky(d.steps[0]) - on_sky(c) for c in d.candidates) <= 0.07


@pytest.mark.slow
def test_example_prints_the_fall() -> None:
    done = subprocess.run([sys.executable, EXAMPLE, DATA], capture_output=True, encoding="utf-8", timeout=600)
    assert done.returncode == 0, done.stderr
    assert "partly explained" in done.stdout
    assert "+ tube_flexure" in done.stdout
    assert done.stdout.count("adequate") == 2


def test_example_says_that_data_are_absent(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, EXAMPLE, tmp_path], capture_output=True, encoding="utf-8", timeout=600)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"skipped: no pointing runs in {tmp_path}")


# -- simulated ---------------------------------------------------------------------------------------------

SIX = np.array([300.0, -120.0, 90.0, 40.0, -200.0, 150.0])
NOISE = 5.0


def simulated(seed: int, flexure: float = 0.0, n: int = 150, repeats: int = 1) -> sk.Measurements:
    """A run of a mount with known terms, arcsec; noise of ``NOISE`` on each axis."""
    rng = np.random.default_rng(seed)
    h, d = np.repeat(rng.uniform([-80.0, -20.0], [80.0, 80.0], (n, 2)), repeats, axis=0).T
    still = np.zeros(n * repeats)
    pole = np.full(n * repeats, 40.0)
    rows = mount.pointing_run("simulated", h, d, (still, still), np.where(h > 0, -1.0, 1.0), pole)
    true = mount.Mount().predict(rows, SIX)
    effect = mount.tube_flexure.evaluate(rows, np.array([flexure]), 2)
    pose = np.repeat(np.arange(n), repeats)
    read = rows.with_readings(true + effect + NOISE * rng.standard_normal(true.shape))
    return replace(read, pose=pose, block=None)


def test_terms_are_recovered_with_honest_deviations() -> None:
    pulls = []
    for seed in range(20):
        fit = sk.identify(mount.Mount(), simulated(seed))
        assert fit.converged
        assert fit.noise.origin == "unknown"
        pulls.append((fit.values - SIX) / fit.std_from_readings)
    assert np.sqrt(np.mean(np.square(pulls))) == pytest.approx(1.0, abs=0.25)


def test_planted_flexure_explains() -> None:
    d = sk.diagnose(sk.identify(mount.Mount(), simulated(1, 40.0, repeats=2)))
    assert (d.verdict, d.unit, d.noise_origin) == ("explained", "arcsec", "repeats")
    assert d.effects == ("tube_flexure",)
    assert d.fit.by_name["tube_flexure.TF"] == pytest.approx(40.0, abs=5.0)
    assert d.noise["parallel"] == pytest.approx(NOISE, rel=0.2)
    said = json.dumps(d.to_json())
    assert json.loads(said)["unit"] == "arcsec"
    assert '_um"' not in said
    assert "arcsec held out" in repr(d)


@pytest.mark.parametrize("runs", [4, pytest.param(8, marks=pytest.mark.slow)])
def test_nothing_planted_nothing_found(runs: int) -> None:
    verdicts = [sk.diagnose(sk.identify(mount.Mount(), simulated(seed))).verdict for seed in range(runs)]
    # one in a hundred may be found at this level
    assert verdicts.count("adequate") >= runs - 1


@pytest.mark.parametrize("loss", ["huber", "cauchy", "tukey"])
def test_robust_losses_do_not_follow_wild_rows(loss: str) -> None:
    rows = simulated(3)
    wild = rows.readings.copy()
    wild[::15] += 20_000.0
    fit = sk.identify(mount.Mount(), rows.with_readings(wild), loss=loss)
    assert np.abs(fit.values - SIX).max() < 10.0
    assert set(range(0, 150, 15)) == set(sk.diagnose(fit).outliers.tolist())


def test_readings_that_were_not_taken_do_not_count() -> None:
    rows = simulated(4)
    holes = rows.readings.copy()
    holes[:30, 0] = np.nan
    fit = sk.identify(mount.Mount(), rows.with_readings(holes))
    assert np.abs(fit.values - SIX).max() < 10.0
    assert sk.diagnose(fit).verdict == "adequate"


def test_effect_without_its_column_is_untestable() -> None:
    @sk.effect(at="sensor", parameters={"by_degree": "arcsec"}, needs=("temperature_c",))
    def warmth(rows: Any, p: Any) -> Floats:
        return p.by_degree * np.column_stack([rows["temperature_c"], rows["temperature_c"]])

    d = sk.diagnose(sk.identify(mount.Mount(), simulated(5)), effects=(warmth,))
    assert d.untestable == {"warmth": "it needs the column temperature_c"}


def test_wrong_tables_and_models_are_refused() -> None:
    rows = simulated(6)
    inputs = {name: rows[name] for name in rows.layout.joints}

    def table(**columns: Any) -> sk.Measurements:
        given = {"place": inputs, "readings": rows.readings, "covariates": rows.covariates} | columns
        return sk.data.from_arrays(names=rows.layout.names, unit="arcsec", **given)

    assert np.array_equal(table().readings, rows.readings)
    with pytest.raises(sk.errors.ShapeError, match="column 'side'"):
        table(covariates={"side": np.ones(3)})
    bad = rows["declination_deg"].copy()
    bad[2] = np.nan
    with pytest.raises(sk.errors.NotFinite, match="row 2: column 'declination_deg'"):
        table(place={**inputs, "declination_deg": bad})
    empty = np.where([True, False], rows.readings, np.nan)
    with pytest.raises(sk.errors.NotFinite, match="no number in 'meridian'"):
        table(readings=empty)
    with pytest.raises(sk.errors.ShapeError, match="sigma: expected positive"):
        table(sigma=np.zeros(rows.readings.shape))
    with pytest.raises(sk.errors.ShapeError, match="readings: expected"):
        rows.with_readings(rows.readings[:5])
    with pytest.raises(sk.errors.EffectError, match=r"have no 'sides'.*'side'"):
        _ = rows["sides"]
    with pytest.raises(sk.errors.FitError, match="choose linear"):
        sk.identify(mount.Mount(), rows, loss="square")
    with pytest.raises(sk.errors.FitError, match="marked as an outlier"):
        sk.identify(mount.Mount(), rows.mark_outliers(np.arange(len(rows))))

    class Flat(mount.Mount):  # type: ignore[misc, name-defined]
        def predict(self, data: sk.Measurements, values: Floats) -> Floats:
            return super().predict(data, values)[:, :1]

    with pytest.raises(sk.errors.ShapeError, match="predict: expected"):
        sk.identify(Flat(), rows)


def test_a_fit_says_of_any_machine_what_it_says_of_a_robot() -> None:
    """Catches directions in millimetres, errors or outliers that only robots have, and a table without a parameter."""
    rows = simulated(7, 40.0, repeats=2)
    fit = sk.identify(mount.Mount(), rows, effects=["tube_flexure"])
    assert set(fit.by_name) == {*mount.Mount.terms, "tube_flexure.TF"}
    assert fit.rms()["parallel"] == pytest.approx(NOISE, rel=0.2)
    assert fit.unobserved == ()
    assert {d.unit for d in fit.badly_observed} == {"arcsec"}
    assert len(sk.diagnosis.gross_errors(fit)) == 0
    wild = rows.readings.copy()
    wild[17] += 20 * NOISE
    spoilt = sk.identify(mount.Mount(), rows.with_readings(wild), loss="huber")
    assert sk.diagnosis.gross_errors(spoilt).tolist() == [17]
    table = str(fit)
    for parameter in fit.parameters:
        assert f"\n{parameter.name} " in table
    assert "arcsec  observed" in table
    assert "from repeats" in table
    assert repr(fit).startswith("Fit(7 parameters, rank 7, RMS parallel ")


def test_a_pole_that_no_star_tells_is_unobserved() -> None:
    """Catches a term without any influence that is called observed: one star alone tells two combinations of six."""
    rows = simulated(8).select(np.zeros(12, dtype=np.int64))
    fit = sk.identify(mount.Mount(), rows)
    assert fit.rank == 2
    assert len(fit.unobserved) == 4
    assert "in part" in str(fit)
    assert "rank       2 of 6" in str(fit)


def test_any_model_is_held_out_by_its_blocks() -> None:
    """Catches blocks of the rows that are not heeded, and errors held out that are no larger than those fitted."""
    rows = simulated(9, n=60)
    together = replace(rows, block=np.arange(60) % 7)
    held = hold_out(mount.Mount(), together)
    assert all(len(set(held.block[together.block == k])) == 1 for k in range(7))
    assert len(set(held.block)) == 5
    fit = sk.identify(mount.Mount(), rows)
    assert np.mean(held.residuals**2) > np.mean(fit.residuals**2)


def test_a_stream_of_any_model_is_its_fit() -> None:
    """Catches a stream that only compiled models pass through."""
    rows = simulated(10, 40.0)
    blocks = [rows.select(np.arange(k, min(k + 40, len(rows)))) for k in range(0, len(rows), 40)]
    stream = sk.data.MeasurementStream(lambda: iter(blocks), "blocks")
    streamed = sk.fit.identify_stream(mount.Mount(), stream, effects=["tube_flexure"])
    fit = sk.identify(mount.Mount(), rows, effects=["tube_flexure"])
    np.testing.assert_allclose(streamed.values, fit.values, rtol=0, atol=1e-6)
    np.testing.assert_allclose(streamed.std_from_readings, fit.std_from_readings, rtol=1e-6)
    assert streamed.rows == len(rows)


def test_what_is_no_model_is_refused_in_a_sentence() -> None:
    """Catches an attribute error deep in the fit."""
    with pytest.raises(sk.errors.FitError, match=r"expected a robot, or a model with parameters.*got float"):
        sk.identify(3.0, simulated(1))  # type: ignore[arg-type]
    with pytest.raises(sk.errors.FitError, match="says itself which of its parameters are free"):
        sk.identify(mount.Mount(), simulated(1), free=("IH",))
    with pytest.raises(sk.errors.EffectError, match=r"'tube_flexur' is not a known effect.*'tube_flexure'"):
        sk.identify(mount.Mount(), simulated(1), effects=["tube_flexur"])


# -- four nights of one mount ------------------------------------------------------------------------------

NIGHTS = ("2021-08-21", "2023-07-02", "2023-09-24", "2025-03-26")


def nights(encoder: str) -> list[sk.Measurements]:
    """The runs of the four nights."""
    return [mount.read_mmt(DATA / mount.MMT, f"point_{night.replace('-', '')}.dat", encoder) for night in NIGHTS]


@pytest.mark.slow
def test_what_the_nights_have_in_common_is_no_change() -> None:
    """Catches what the six terms miss in every night alike, 0.6″ along the azimuth, taken for a change since the first:
    of encoders that the telescope's own pointing model has corrected nothing has changed."""
    runs = nights("abs")
    for k in range(1, 4):
        found = sk.compare(mount.Mount(), [runs[0], runs[k]])
        assert (found.verdict, found.changed) == ("unchanged", ())
    assert sk.history(mount.Mount(), runs, dates=NIGHTS).verdict == "unchanged"


def test_the_axis_that_leaned_in_one_of_the_nights() -> None:
    """Catches another term, a size that fits of the nights apart do not have, and a night alone told as steps."""
    runs = nights("raw")
    apart = [sk.identify(mount.Mount(), rows).by_name["MA"] for rows in runs]
    found = sk.compare(mount.Mount(), runs[1:3])
    assert (found.verdict, found.changed) == ("partly explained", ("MA",))
    assert found.parameters[0].change == pytest.approx(apart[2] - apart[1], abs=1.0)
    course = sk.history(mount.Mount(), runs, dates=NIGHTS)
    assert [(c.name, c.kind, c.date) for c in course.changes] == [("MA", "once", "2023-07-02")]
    assert course.changes[0].parameters[0][1] == pytest.approx(13.0, abs=1.5)


@pytest.mark.slow
def test_the_side_of_the_pier_is_no_change_of_a_term() -> None:
    """Catches a name for flexure that turning the mount over reverses: nothing was changed between the sides."""
    rows = mount.read_gem(DATA / mount.GEM, "gem-28.dat")
    sides = [rows.select(np.flatnonzero(rows["side"] == side)) for side in (1.0, -1.0)]
    found = sk.compare(mount.Mount(), sides)
    assert found.verdict == "unexplained"
    assert next(iter(found.aside.values())) >= 19
