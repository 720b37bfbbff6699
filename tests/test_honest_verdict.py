"""A verdict that cannot contradict its own numbers: every case in which it was seen to, and the rates behind them.

The slow tests print tables of outcomes, so that they measure as well: run them with ``-m slow -s``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

import gross_errors
import mistakes
import sherkit as sk
import worlds
from consistency import PRAISED, consistent, contradictions, named, noise_of
from sherkit.diagnosis.result import SINGLY
from sherkit.evidence.fitted_run import FittedRun
from worlds import NOISE_PX, NOISE_UM, ROWS, Answer, World

#: A minute and more of fits; what fails is known, and marked.
pytestmark = pytest.mark.slow

#: Chance with which a correct program fails one of the counts below.
RARE = 1e-3
#: What is no more than noise, in noises: the error of a run varies by a few percent.
ROUNDED = 1.05


def honest(answer: Answer) -> sk.diagnosis.Diagnosis:
    """The diagnosis of an answer, after the check that every diagnosis must pass."""
    assert answer.diagnosis is not None, answer.sentences
    consistent(answer.diagnosis)
    return answer.diagnosis


def table(title: str, outcomes: Iterable[tuple[str, str]]) -> None:
    """Prints how often each outcome came, case by case."""
    counts: dict[str, Counter[str]] = {}
    for case, outcome in outcomes:
        counts.setdefault(case, Counter())[outcome] += 1
    print(f"\n{title}")
    for case, counter in counts.items():
        print(f"  {case:<36} " + ", ".join(f"{outcome} {n}" for outcome, n in counter.most_common()))


# -- the check itself ----------------------------------------------------------------------------------------------


def made_up(**changes: Any) -> Any:
    """A report that does not contradict itself, but for the changes."""
    step = lambda effect, rms: SimpleNamespace(effect=effect, error=SimpleNamespace(rms=rms))  # noqa: E731
    report = {
        "verdict": "explained", "unit": "µm", "noise": {"x": 2.0, "y": 2.0}, "noise_origin": "repeats",
        "effects": ("rail_lean",), "steps": (step(None, 12.0), step("rail_lean", 3.0)), "confirmed": 0.0005,
        "candidates": (SimpleNamespace(effect="rail_lean", plausible=True),), "fit": SimpleNamespace(converged=True),
        "caveat": None,
    }  # fmt: skip
    return SimpleNamespace(**(report | changes))


def test_the_check_finds_each_contradiction() -> None:
    """Catches a check that lets a contradiction pass, or finds one where none is."""
    step = lambda effect, rms: SimpleNamespace(effect=effect, error=SimpleNamespace(rms=rms))  # noqa: E731
    consistent(made_up())
    left = (step(None, 12.0), step("rail_lean", 3.7))
    assert len(contradictions(made_up(steps=left))) == 1
    assert not contradictions(made_up(steps=left, verdict="partly explained"))
    assert not contradictions(made_up(steps=left, noise_origin="unknown"))
    assert len(contradictions(made_up(steps=(step(None, 2.9), step("rail_lean", 3.0))))) == 1
    assert len(contradictions(made_up(confirmed=0.2))) == 1
    assert len(contradictions(made_up(fit=SimpleNamespace(converged=False)))) == 1
    absurd = (SimpleNamespace(effect="rail_lean", plausible=False),)
    assert len(contradictions(made_up(candidates=absurd))) == 1
    assert not contradictions(made_up(candidates=absurd, caveat="it is a thousand times what is usual"))
    assert len(contradictions(made_up(steps=(step(None, float("nan")),), effects=(), verdict="adequate"))) == 1


@pytest.mark.parametrize("make", [worlds.clean, worlds.spherical_clean])
def test_a_clean_run_is_still_adequate(make: Any) -> None:
    """Catches a rule that refuses everything. Seeds 0 and 1."""
    for seed in range(2):
        d = honest(make(seed).ask())
        assert (d.verdict, d.effects) == ("adequate", ())
        assert len(d.outliers) == 0


def test_a_verdict_rests_on_claims() -> None:
    """Catches a verdict with nothing to stand on: each check says what was tested, on which rows, with which result."""
    for world in (worlds.clean(0), worlds.pitch_left_out(0)):
        d = world.ask().diagnosis
        checks = d.checks
        assert checks
        assert len({check.name for check in checks}) == len(checks)
        for check in checks:
            assert check.tested
            assert check.rows
            assert check.result is not None
            assert check.p is None or 0.0 <= check.p <= 1.0
        assert len(d.to_json()["checks"]) == len(checks)


# -- the rows of the table -----------------------------------------------------------------------------------------


def test_a_pitch_that_was_left_out_is_asked_for() -> None:
    """Catches praise at four times the noise, and a period of 1.0 mm taken in silence. Seed 0."""
    answer = worlds.pitch_left_out(0).ask()
    d = honest(answer)
    assert d.verdict != "adequate"
    assert "encoder_cyclic" in named(d)
    assert answer.says(("pole_pitch_mm",))


def test_a_pitch_that_is_wrong_is_found_out() -> None:
    """Catches an effect that is named at a period at which it does nothing. Seed 0."""
    d = honest(worlds.pitch_wrong(0).ask())
    assert d.effects == ("encoder_cyclic",)
    assert abs(d.steps[-1].error.rms / np.sqrt(d.error.axes) / NOISE_UM - 1) < 0.1


def test_a_period_that_no_file_has_is_searched() -> None:
    """Catches a search that ends at a part of the range. Seed 0; the rate is in a slow test."""
    assert period_right(worlds.cyclic_of_any_period(0)) in ("right", "alias said")


def test_without_repeats_and_pitch_nothing_is_praised() -> None:
    """Catches effects named by chance, and praise where the noise is unknown. Seed 1."""
    d = honest(worlds.pitch_left_out_and_no_repeats(1).ask())
    assert d.verdict != "adequate"
    assert named(d) <= {"encoder_cyclic"}


def test_a_rod_spacing_that_was_left_out_is_asked_for() -> None:
    """Catches unequal rods pressed into beams, since nobody said how far apart the rods are."""
    answer = worlds.spacing_left_out(0).ask()
    d = honest(answer)
    assert named(d) <= {"rod_mismatch"}
    assert answer.says(("rod_spacing_mm",))


def test_settings_that_are_left_out_are_asked_for_on_a_clean_run_too() -> None:
    """Catches a warning that comes only when it is too late: without the settings two effects cannot be tried."""
    answer = worlds.delta_world(0, settings=worlds.settings_without("pole_pitch_mm", "rod_spacing_mm")).ask()
    assert answer.says(("pole_pitch_mm",))
    assert answer.says(("rod_spacing_mm",))


def test_a_pose_that_is_wrong_by_metres_is_listed() -> None:
    """Catches metres in the table under a verdict of praise, and the wrong rows listed."""
    world = worlds.pose_wrong_by_metres(0)
    d = honest(world.ask())
    assert gross_errors.poses_listed(world, d.outliers) == set(world.planted["wrong_poses"])


def test_an_effect_that_is_not_needed_is_said_to_be_so() -> None:
    """Catches silence on an effect in the model that does nothing but spoil the others' values."""
    world = worlds.superfluous_effect(0)
    answer = world.ask()
    d = honest(answer)
    assert answer.says(("beam_alignment",), ("not needed",)) or (
        "beam_alignment" in d.verdict and "not needed" in d.verdict
    )


def test_each_named_effect_earns_its_place() -> None:
    """Catches a member of a pair that does nothing. Seed 15, on which a third effect joins by chance."""
    d = honest(worlds.needless_member(15).ask())
    assert d.verdict == "explained"
    assert set(d.effects) == {"gravity_flexure", "backlash"}


def test_a_sine_in_the_picture_is_not_adequate() -> None:
    """Catches praise at twenty times the noise, on seeds 0 to 2."""
    for seed in range(3):
        assert honest(worlds.spherical_sine(seed).ask()).verdict == "unexplained"


def test_a_scatter_from_pose_to_pose_is_unexplained_with_its_size() -> None:
    """Catches praise where each pose has an error of its own, and a size that is not in the first line."""
    answer = worlds.spherical_scatter(1).ask()
    d = honest(answer)
    assert d.verdict == "unexplained"
    assert "0.4" in repr(d).splitlines()[0]
    # and the ways to declare it, where it is known
    assert "columns pose_sigma_u_px, pose_sigma_v_px, or marker_sigma_px under [camera] in the robot file" in d.headline


@pytest.mark.parametrize("where", ["run", "robot file"])
def test_a_scatter_that_was_declared_is_adequate(where: str) -> None:
    """Catches a user who has said what the marker's error is and hears of it for ever: it belongs to the noise."""
    world = worlds.spherical_scatter(1)
    n = len(world.columns["pose"])
    if where == "run":
        declared = {f"pose_sigma_{name}": np.full(n, 4 * NOISE_PX) for name in ("u_px", "v_px")}
        world = replace(world, columns=world.columns | declared)
    else:
        camera = world.settings["camera"] | {"marker_sigma_px": 4 * NOISE_PX}
        world = replace(world, settings=world.settings | {"camera": camera})
        assert world.robot.to_tables()["camera"]["marker_sigma_px"] == 4 * NOISE_PX
    d = honest(world.ask())
    assert d.verdict == "adequate"
    noise = noise_of(d)
    assert noise is not None
    assert noise > 3.5 * NOISE_PX


def test_a_model_with_a_wrong_derivative_is_never_praised() -> None:
    """Catches a verdict on a fit that did not converge. Seeds 0 to 2; with the right derivative all is well."""
    for seed in range(3):
        right = sk.diagnose(worlds.turntable(seed, wrong=False))
        consistent(right)
        assert right.verdict == "adequate"
        wrong = sk.diagnose(worlds.turntable(seed))
        consistent(wrong)
        assert wrong.verdict not in PRAISED


def reserved(answer: Answer, right: str) -> bool:
    """Whether an effect that the catalogue lacks is not called explained, or only with the caveat that one
    unknown would do the same; once the catalogue has it, its name is right."""
    d = honest(answer)
    return d.verdict != "explained" or right in named(d) or answer.says(("one unknown", "single unknown"))


STRUCTURAL = {
    "limb twist": "limb_twist", "limb twist of a base angle": "limb_twist", "drive compliance": "drive_compliance",
}  # fmt: skip


@pytest.mark.parametrize("name", STRUCTURAL)
def test_a_missing_structural_effect_is_not_explained_by_others(name: str) -> None:
    """Catches a conspiracy: two or three effects with a dozen parameters in place of one of three. Seed 0."""
    assert reserved(ROWS[name](0).ask(), STRUCTURAL[name])


def test_a_constant_reading_explains_nothing() -> None:
    """Catches gains of -1, scales of hundreds and effects found in a column that says one number."""
    answer = worlds.printer_heights(0).ask()
    d = honest(answer)
    assert "joint_scale" not in named(d)
    assert d.verdict != "explained" or d.effects == ("rail_lean",)
    assert answer.says(("z_mm",), ("constant", "same"))


# -- the bullets ---------------------------------------------------------------------------------------------------


def test_where_the_noise_is_unknown_the_words_say_so() -> None:
    """Catches praise that nothing stands behind: without repeats or a declared noise only structure can be missed."""
    d = honest(worlds.delta_world(0, repeats=1).ask())
    assert "nothing with structure" in repr(d).splitlines()[0]


def test_equal_joint_readings_are_repeats() -> None:
    """Catches a noise that is called unknown though the run tells it."""
    world = worlds.clean(0)
    columns = {k: v for k, v in world.columns.items() if k not in ("pose", "repeat")}
    assert honest(replace(world, columns=columns).ask()).noise_origin == "repeats"


def test_the_answer_does_not_hang_on_the_seed() -> None:
    """Catches a name that chance gives: a lean of less than half the noise, diagnosed with the seeds 0 to 3."""
    world = worlds.delta_world(1, {"rail_lean": 0.42 * NOISE_UM})
    answers = [honest(world.ask(seed)) for seed in range(4)]
    assert len({(d.verdict, d.effects) for d in answers}) == 1


def test_what_is_common_to_all_limbs_is_said_as_one_number() -> None:
    """Catches six numbers given as findings where one is known: all rails lean by 2 mrad tangentially."""
    answer = worlds.delta_world(0, effects={"rail_lean": np.tile([0.0, 2e-3], 3)}).ask()
    assert honest(answer).effects == ("rail_lean",)
    assert answer.says(("common",), ("tangential",), ("lean",))


def test_next_poses_come_as_joints_and_as_targets() -> None:
    """Catches poses that nobody can drive to: a turn of the second joint is tied with an axis off its place."""
    world = worlds.spherical_world(0, effects={"joint_offset": [0.0, 0.004]}, per_side=12, repeats=3)
    d = honest(world.ask())
    assert d.indistinguishable
    if d.next_poses:  # none is an answer as well: these instruments cannot tell
        assert {"theta1_rad", "theta2_rad", "phi_rad", "gamma_rad"} <= set(d.next_poses[0])
        assert d.next_poses[-1]["separation_sigma"] >= 3.0


# -- mistakes of the set-up ----------------------------------------------------------------------------------------

#: One of each sort.
QUICK = (
    "delta: joints counted from 2", "delta: joint 1 counted downwards", "delta: base angles in radians",
    "delta: time in milliseconds", "delta: everything in inches", "delta: commanded joints",
    "delta: joints in micrometres", "spherical: joints swapped", "spherical: working mode",
    "spherical: readings -1 rows",
)  # fmt: skip
EVERY = tuple(f"{kind}: {m.name}" for kind, (_, made) in mistakes.MISTAKES.items() for m in made)


def mistake(label: str) -> tuple[Any, mistakes.Mistake]:
    """What makes the clean run of a mistake, and the mistake."""
    kind, name = label.split(": ", 1)
    make, made = mistakes.MISTAKES[kind]
    return make, next(m for m in made if m.name == name)


def check_mistake(label: str) -> None:
    make, one = mistake(label)
    right, said = mistakes.named(one, make(0))
    assert right, said


@pytest.mark.parametrize("label", QUICK)
def test_a_mistake_of_the_set_up_is_named(label: str) -> None:
    """Catches physics blamed for a slip of the hand: one sentence says what to change, and nothing is praised."""
    check_mistake(label)


@pytest.mark.parametrize("label", [label for label in EVERY if label not in QUICK])
def test_every_other_mistake_is_named(label: str) -> None:
    """As above, all others."""
    check_mistake(label)


def test_key_words_are_not_in_a_clean_answer() -> None:
    """Catches words that any answer has, so that a mistake would seem named: on clean runs no mistake is claimed."""
    for make, made in mistakes.MISTAKES.values():
        answer = mistakes.file_of(make(0)).ask()
        assert honest(answer).verdict == "adequate"
        assert [m.name for m in made if answer.says(*m.words)] == []


@pytest.mark.parametrize("kind", mistakes.MISTAKES)
def test_mistakes_are_named_on_random_robots(kind: str) -> None:
    """Catches what works on the example only: every mistake on five random robots, at least 95 % named; none praised,
    unless the model then leaves no more than its noise: limbs that are alike, counted from another, are a turn.

    Prints what is said of each.
    """
    make, made = mistakes.MISTAKES[kind]
    outcomes = []
    praised = []
    for seed in range(mistakes.ROBOTS):
        world = make(seed)
        for one in made:
            answer = mistakes.file_of(one.change(world)).ask()
            right = answer.says(*one.words)
            d = answer.diagnosis
            if answer.verdict in PRAISED and d.error.rms > ROUNDED * (noise_of(d) or 0.0):
                praised.append((one.name, seed))
            outcomes.append((one.name, ("named, " if right else "") + answer.verdict))
    table(f"mistakes on {mistakes.ROBOTS} robots: {kind}", outcomes)
    missed = sum(not outcome.startswith("named") for _, outcome in outcomes)
    assert missed <= 0.05 * len(outcomes)
    assert praised == []


def test_no_mistake_is_claimed_on_clean_runs() -> None:
    """Catches a suspicion without cause: 400 clean runs of random robots, none is told of a mistake."""
    outcomes, claimed = [], []
    for kind, count in (("delta", 200), ("spherical", 150), ("angles", 50)):
        make, made = mistakes.MISTAKES[kind]
        for seed in range(count):
            answer = mistakes.file_of(make(seed)).ask()
            outcomes.append((kind, answer.verdict))
            # a check that holds may name a base angle and its radians, too
            claimed += [(kind, seed, str(c)) for c in answer.diagnosis.checks if c.name == "set_up" and not c.holds]
            told = Answer(None, answer.diagnosis.notes)
            claimed += [(kind, seed, m.name) for m in made if told.says(*m.words)]
    table("clean runs", outcomes)
    assert claimed == []


# -- gross errors --------------------------------------------------------------------------------------------------


def gross_outcome(spoiled: gross_errors.Spoiled, clean: Any) -> str:
    """``right``: all wrong poses are listed and few others, verdict and parameters are as without them: as those of
    ``clean``, the diagnosis of the run in which a person has marked just these poses."""
    d = spoiled.world.ask().diagnosis
    if d is None:
        return "error"
    listed = gross_errors.poses_listed(spoiled.world, d.outliers)
    if not spoiled.poses <= listed:
        # poses are visited at random, so that a block of the plan is a place: a small one may be taken for a bend there
        if spoiled.name == "block" and d.verdict == "unexplained" and not d.effects:
            return "a bend"
        return ("praised, " if d.verdict in PRAISED else "") + "not all listed"
    if len(listed - spoiled.poses) > 0.01 * len(np.unique(spoiled.world.columns["pose"])):
        return "too many listed"
    # what lies together in time is no accident: nothing is praised, whatever is left of the run
    together = any(check.name == SINGLY and check.holds is False for check in d.checks)
    if together and (spoiled.name != "block" or d.verdict in PRAISED):
        return "no accidents" if spoiled.name != "block" else "praised"
    if (d.verdict, d.effects) != (clean.verdict, clean.effects) and not (together and d.effects == clean.effects):
        return "another verdict"
    # parameters that no reading tells have no deviation worth the name: those are held to their plausible size
    size = np.array([p.size for p in clean.fit.parameters])
    allowed = 4.0 * clean.fit.std_from_readings + 1e-6 * size
    if not (np.abs(d.fit.values - clean.fit.values) <= allowed).all():
        return "other parameters"
    return "right" if not contradictions(d) else "contradiction"


GROSS = (
    "delta: one, far away", "delta: wrong index 5%", "delta: scattered 5% × 20", "delta: scattered 10% × 1000",
    "spherical: one, far away", "spherical: scattered 5% × 100", "spherical: block 10% × 100",
)  # fmt: skip


@pytest.mark.parametrize("label", GROSS)
def test_gross_errors_of_poses_are_found(label: str) -> None:
    """Catches poses that are wrong in all repeats and stay in the numbers that are shown. Seed 0."""
    kind, name = label.split(": ", 1)
    spoiled = next(s for label, s in gross_errors.every_error(kind, range(1)) if label == name)
    assert gross_outcome(spoiled, spoiled.marked.ask().diagnosis) == "right"


@pytest.mark.parametrize("kind", ["delta", "spherical"])
def test_gross_errors_are_found_in_98_of_100(kind: str) -> None:
    """Catches a start that believes the worst rows: 50 runs of each of 28 kinds, from 5 noises to kilometres.

    Prints the outcomes. At least 98 % right in all, with a binomial allowance of 1 in 1,000 for each kind. Of a block
    of 5 noises one in four may be taken for a bend of the workspace, said to be unexplained; that is not right.
    """
    outcomes = []
    for seed in range(50):
        clean: dict[frozenset[int], Any] = {}
        for label, spoiled in gross_errors.every_error(kind, range(seed, seed + 1)):
            if spoiled.poses not in clean:
                clean[spoiled.poses] = spoiled.marked.ask().diagnosis
            outcomes.append((label, gross_outcome(spoiled, clean[spoiled.poses])))
    table(f"gross errors: {kind}", outcomes)
    bent = Counter(label for label, outcome in outcomes if outcome == "a bend" and label.endswith("× 5"))
    wrong = Counter(label for label, outcome in outcomes if outcome != "right")
    assert wrong.total() <= 0.02 * len(outcomes)
    assert max(bent.values(), default=0) <= 0.25 * 50
    wrong -= bent
    assert max(wrong.values(), default=0) <= stats.binom.isf(RARE, 50, 0.02)


# -- rates ---------------------------------------------------------------------------------------------------------


def period_right(world: World) -> str:
    """Whether the period of a cyclic error is found to 1 %, or said to be an alias of the one found."""
    answer = world.ask()
    d = answer.diagnosis
    if d is None or "encoder_cyclic" not in named(d):
        return "not named"
    period = getattr(d.fit.model, "period_mm", None)
    if period is None:
        return "no period"
    # one of all joints, or one for each
    if (np.abs(np.array(period) / world.planted["period_mm"] - 1) < 0.01).all():
        return "right"
    return "alias said" if answer.says(("alias",)) else "wrong period"


def test_periods_of_0_7_to_20_mm_are_found() -> None:
    """Catches a periodogram that is too coarse or ends too early: 60 runs, 95 % right or the alias said."""
    outcomes = []
    for seed in range(60):
        world = worlds.cyclic_of_any_period(seed)
        period = world.planted["period_mm"]
        band = next(f"below {top} mm" for top in (1, 2, 5, 10, 20.1) if period < top)
        outcomes.append((band, period_right(world)))
    table("cyclic errors of unknown period", outcomes)
    wrong = sum(outcome not in ("right", "alias said") for _, outcome in outcomes)
    assert wrong <= stats.binom.isf(RARE, 60, 0.05)


def runs_of_all_sorts() -> list[tuple[str, World]]:
    """40 runs, half of them on the edge of what can be seen."""
    out = [(f"clean {seed}", worlds.clean(seed)) for seed in range(5)]
    names = ("rail_lean", "backlash", "joint_scale", "sensor_linearity", "gravity_sag", "beam_alignment", "drift")
    for k, name in enumerate(names):
        for ratio in (0.3, 0.5, 1.0, 2.0, 5.0):
            out.append((f"{name} × {ratio}", worlds.delta_world(10 + k, {name: ratio * NOISE_UM})))
    return out


def test_twenty_seeds_say_the_same() -> None:
    """Catches answers that hang on the seed: 20 seeds on 40 runs, the same verdict and names in 97 %."""
    outcomes, same = [], 0
    for label, world in runs_of_all_sorts():
        answers = Counter()
        for seed in range(20):
            d = world.ask(seed).diagnosis
            answers[f"{d.verdict} {'+'.join(d.effects)}"] += 1
        same += answers.most_common(1)[0][1]
        outcomes += [(label, answer) for answer in answers.elements()]
    table("20 seeds", outcomes)
    assert same >= 0.97 * len(outcomes)


@pytest.mark.parametrize("name", ["limb_twist", "drive_compliance"])
def test_structural_effects_are_never_explained_by_others(name: str) -> None:
    """Catches conspiracies on any draw: ratios 1, 2 and 4, ten seeds each. Prints what is named instead."""
    outcomes, wrong = [], []
    for ratio in (1, 2, 4):
        for seed in range(10):
            answer = worlds.delta_world(seed, {name: ratio * NOISE_UM}).ask()
            d = answer.diagnosis
            outcomes.append((f"{name} × {ratio}", f"{d.verdict} {'+'.join(d.effects)}"))
            alone = answer.says(("one unknown", "single unknown"))
            if d.verdict == "explained" and name not in named(d) and not alone:
                wrong.append((ratio, seed))
    table("structural effects", outcomes)
    assert wrong == []


#: Effects of the delta's catalogue that a run of its own kind can show.
SWITCHED_OFF = (
    "rail_lean", "encoder_cyclic", "backlash", "joint_scale", "sensor_linearity", "gravity_sag", "rod_mismatch",
    "beam_alignment", "drift", "thermal_growth", "slip", "limb_twist", "drive_compliance",
)  # fmt: skip


@pytest.mark.parametrize("name", SWITCHED_OFF)
def test_what_the_catalogue_lacks_is_never_explained_by_the_rest(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a missing effect that is explained by others as if they were there: each effect of the catalogue taken
    out of it and planted, ratios 2 and 5, four seeds each. Prints what is said instead."""
    known = FittedRun.catalogue.fget
    monkeypatch.setattr(FittedRun, "catalogue", property(lambda run: tuple(e for e in known(run) if e.name != name)))
    outcomes, wrong = [], []
    for ratio in (2, 5):
        for seed in range(4):
            d = honest(worlds.delta_world(seed, {name: ratio * NOISE_UM}).ask())
            reserved = "" if d.verdict != "explained" else f", {'with' if d.caveat else 'WITHOUT'} caveat"
            outcomes.append((f"{name} × {ratio}", f"{d.verdict} {'+'.join(d.effects)}{reserved}"))
            if d.verdict == "adequate" or (d.verdict == "explained" and not d.caveat):
                wrong.append((ratio, seed, d.effects))
    table("not in the catalogue", outcomes)
    assert wrong == []


def test_no_row_of_the_table_contradicts_itself() -> None:
    """Catches a contradiction that a test of one seed misses: every row on ten seeds. Prints what was found."""
    outcomes = []
    for name, make in ROWS.items():
        for seed in range(10):
            answer = make(seed).ask()
            if answer.diagnosis is None:
                outcomes.append((name, "error"))
                continue
            found = contradictions(answer.diagnosis)
            outcomes.append((name, f"{answer.verdict}{', contradicts itself' if found else ''}"))
    table("rows of the table", outcomes)
    assert not [case for case, outcome in outcomes if "contradicts" in outcome]


def test_a_combination_that_hardly_shows_does_not_keep_a_fit_from_its_minimum() -> None:
    """Catches a fit that is called unfinished because steps along a combination known to 35 plausible sizes stay long:
    the right effect was refused for it, and what it leaves called scatter of the poses."""
    d = honest(worlds.delta_world(13, {"sensor_linearity": NOISE_UM}).ask())
    assert d.effects == ("sensor_linearity",)
    assert d.verdict == "explained"
