"""Many machines of one robot: verdicts in one table, what they share, who stands out; anywhere the same."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import tracemalloc
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sherkit as sk
from running import cluster_of_two, slow
from sherkit.cli import main
from sherkit.cli.demo import EXAMPLE
from sherkit.fleets import Fleet, FleetMember
from sherkit.robots.delta.virtual import VirtualDelta

POSES = sk.delta.paper_whole()[::3]


def machine(seed: int, *, lean_rad: float = 0.0, longer_mm: float = 0.0) -> sk.Measurements:
    """A run of one machine of the batch: small errors of its own, perhaps leaning rails, perhaps a wrong rod."""
    drawn = VirtualDelta.draw(
        EXAMPLE, seed, sizes={"joint_offset": 0.02, "rod_length": 0.02}, rail_lean_rad=lean_rad, noise_mm=0.005
    )
    errors = dict(drawn.errors)
    errors["rod_length_2"] = errors.get("rod_length_2", 0.0) + longer_mm
    return replace(drawn, errors=errors).measure(POSES, repeats=2, order="shuffled", seed=seed)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Four good machines, one with leaning rails, one file that is none."""
    folder = tmp_path_factory.mktemp("fleet")
    sk.save_robot(EXAMPLE, folder / "robot.toml")
    for k in range(5):
        machine(k, lean_rad=0.003 if k == 3 else 0.0).save(folder / f"machine_{k}.csv")
    (folder / "machine_5.csv").write_text("q1_mm,q2_mm\n1,2\n", encoding="utf-8")
    return [str(folder / f"machine_{k}.csv") for k in range(6)]


@pytest.fixture(scope="module")
def found(runs: list[str]) -> Fleet:
    """What is said of them, here, one after the other."""
    return sk.fleet(runs, EXAMPLE)


def test_each_machine_is_diagnosed_by_itself(found: Fleet, runs: list[str]) -> None:
    """Catches machines whose rows are mixed, an effect given to the wrong one, and a bad file that ends all."""
    assert [m.run for m in found.machines] == runs
    assert [m.failed is None for m in found.machines] == [True] * 5 + [False]
    assert "machine_5.csv: column 'q3_mm' is missing" in str(found.machines[5].failed)
    assert found.machines[3].effects == ("rail_lean",)
    assert found.shared["rail_lean"] == (runs[3],)
    alone = sk.diagnose(sk.identify(EXAMPLE, runs[3]))
    assert found.machines[3].verdict == alone.verdict
    assert found.machines[3].after == alone.steps[-1].error.rms
    assert found.machines[3].before > 2 * found.machines[3].after


def test_a_run_with_a_mistake_of_its_set_up_is_no_odd_machine() -> None:
    """Catches a run in inches of which only "rod_length_2 is 22.8 mm" stands out, where a diagnosis says inches."""
    inches = machine(7).to_frame()
    inches = inches.with_columns([inches[name] / 25.4 for name in ("x_mm", "y_mm", "z_mm")])
    found = sk.fleet([machine(6), sk.from_frame(inches)], EXAMPLE)
    assert found.machines[0].failed is None
    assert "inches" in str(found.machines[1].failed)
    assert "inches" in repr(found)


def test_a_row_is_flat_and_the_same_from_a_diagnosis_and_a_fleet(found: Fleet, runs: list[str]) -> None:
    """Catches a table that cannot be made of its rows, errors without a unit, and a failed run that ends the table."""
    alone = sk.diagnose(EXAMPLE, runs[3])
    row = alone.row()
    assert all(value is None or isinstance(value, str | int | float) for value in row.values())
    assert row["effects"] == "rail_lean"
    assert row["after_um"] == alone.steps[-1].error.rms
    assert row["ratio"] == pytest.approx(row["after_um"] / row["before_um"])
    assert row["p_lack_of_fit"] == next(c.p for c in alone.checks if c.name == "poses_as_repeats")
    table = found.to_frame()
    assert table["run"].to_list() == runs
    assert table.row(3, named=True) == {"run": runs[3], "failed": None} | row
    assert "column 'q3_mm' is missing" in table["failed"][5]
    assert table["verdict"].null_count() == 1
    reversed_too = Fleet(found.machines[::-1]).to_frame()
    assert set(reversed_too.columns) == set(table.columns)


def test_a_thread_pool_says_the_same(found: Fleet, runs: list[str]) -> None:
    """Catches an answer that depends on who computes it, or comes in the order of its being ready."""
    with ThreadPoolExecutor(2) as pool:
        assert sk.fleet(runs[3:], EXAMPLE, executor=pool).machines == found.machines[3:]


@pytest.mark.slow
def test_a_process_pool_says_the_same(found: Fleet, runs: list[str]) -> None:
    """Catches a task that cannot be sent, and warnings or errors that are lost on the way back."""
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        assert sk.fleet(runs, EXAMPLE, executor=pool) == found


@pytest.mark.slow
def test_a_cluster_says_the_same(found: Fleet, runs: list[str], tmp_path: Path) -> None:
    """Catches what only holds for executors of the standard library, and answers that are older than their files."""
    copied = [tmp_path / Path(run).name for run in runs]
    for path, run in zip(copied, runs, strict=True):
        path.write_bytes(Path(run).read_bytes())
    runs = [str(path) for path in copied]
    found = sk.fleet(runs, EXAMPLE)
    with cluster_of_two() as (_, executor):
        assert sk.fleet(runs, EXAMPLE, executor=executor) == found
        # asked again, a file is read again: a cluster keeps answers by what was asked
        machine(1).save(runs[3])
        again = sk.fleet(runs, EXAMPLE, executor=executor)
        assert again.machines[3].effects == ()
        assert again.machines[4] == found.machines[4]


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_loses_no_machine(tmp_path: Path) -> None:
    """Catches a fleet that ends, lacks machines, has them twice or in another order, or stops to say how far it is,
    since one of two processes was killed in the middle of 200 runs."""
    runs = []
    for k in range(200):
        machine(k, lean_rad=0.003 if k % 10 == 0 else 0.0).save(tmp_path / f"machine_{k:03d}.csv")
        runs.append(str(tmp_path / f"machine_{k:03d}.csv"))
    told: list[tuple[int, int]] = []
    killed: list[int] = []
    with cluster_of_two() as (client, executor):

        def progress(done: int, total: int) -> None:
            told.append((done, total))
            if done == 60:
                killed.append(next(iter(client.run(os.getpid).values())))
                os.kill(killed[0], signal.SIGKILL)

        made = sk.fleet(runs, EXAMPLE, executor=executor, progress=progress)
    assert killed
    assert told == [(k, 200) for k in range(201)]
    assert [m.run for m in made.machines] == runs
    assert [m.run for m in made.machines if m.failed] == []
    assert sum(m.effects == ("rail_lean",) for m in made.machines[::10]) >= 19
    assert made.machines[57:64] == sk.fleet(runs[57:64], EXAMPLE).machines


def test_ten_thousand_verdicts_are_one_table() -> None:
    """Catches a table that holds the rows of its runs, or is made in a time that grows with the square of them: 10,000
    machines take less than 100 MB."""
    told = sk.diagnose(EXAMPLE, machine(1))
    values = dict(zip([p.name for p in told.fit.parameters], told.fit.values.tolist(), strict=True))
    units, std = {p.name: p.unit for p in told.fit.parameters}, dict.fromkeys(values, 1e-3)
    tracemalloc.start()
    machines = tuple(
        FleetMember(
            **vars(told.summary), run=f"machine {k}", values=dict(values), std_from_readings=dict(std), units=units
        )
        for k in range(10_000)
    )
    made = Fleet(machines)
    table = made.to_frame()
    assert tracemalloc.get_traced_memory()[1] < 100e6
    tracemalloc.stop()
    assert table.height == 10_000
    assert table["run"].n_unique() == 10_000
    assert made.stands_out == ()


def test_the_command_prints_and_writes_the_same(
    runs: list[str], found: Fleet, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a table without the failed run or its sentence, who alone lacks an effect and is not named, a pattern
    that no shell has spread, and other JSON."""
    monkeypatch.chdir(Path(runs[0]).parent)
    for arguments in ([], ["--json"]):
        with pytest.raises(SystemExit) as ended:
            main(["fleet", "machine_[0345].csv", "--robot", "robot.toml", "--workers", "1", *arguments])
        assert not ended.value.code
    text, _, data = capsys.readouterr().out.partition("{\n")
    assert "failed: machine_5.csv: column 'q3_mm' is missing" in text
    assert "rail_lean is missing in 1 of 3: machine_3.csv" in text
    assert "from 4 machines on" in text
    said = json.loads("{" + data)
    assert [m["verdict"] for m in said["machines"]] == [found.machines[k].verdict for k in (0, 3, 4, 5)]
    assert said["machines"][1]["values"] == found.machines[3].values


def test_a_fleet_of_which_no_run_can_be_used_is_no_success(runs: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Catches the exit code 0 where nothing was looked at."""
    with pytest.raises(SystemExit) as ended:
        main(["fleet", runs[5], "nowhere.csv", "--robot", str(Path(runs[0]).parent / "robot.toml"), "--workers", "1"])
    assert ended.value.code == 1
    assert "none of the 2 runs could be used" in capsys.readouterr().err


# -- who stands out: numbers alone, so that the level can be counted -----------------------------------------


def fleet_of(values: np.ndarray, std: float = 0.1) -> Fleet:
    """Machines (n, p) that have these values."""
    names = [f"p{k}" for k in range(values.shape[1])]
    units, stds = dict.fromkeys(names, "mm"), dict.fromkeys(names, std)
    made = [dict(zip(names, row.tolist(), strict=True)) for row in values]
    numbers = {"std_from_readings": stds, "std": stds, "units": units}
    return Fleet(tuple(FleetMember(f"m{k}", after=5.0, values=v, **numbers) for k, v in enumerate(made)))


def test_the_odd_one_is_named_and_the_others_are_not() -> None:
    """Catches a mean that the odd machine moves, and a spread that it widens until it hides itself."""
    values = np.random.default_rng(2).normal(0.0, 1.0, (12, 6))
    values[7, 4] = 40.0
    found = fleet_of(values).stands_out
    assert [(one.run, one.name) for one in found] == [("m7", "p4")]
    assert "m7: p4 is 40 mm, the fleet's median" in str(found[0])
    two = values.copy()
    two[3, 1] = -60.0
    assert {(one.run, one.name) for one in fleet_of(two).stands_out} == {("m7", "p4"), ("m3", "p1")}


@pytest.mark.parametrize(("machines", "std"), [(4, 0.1), (7, 1.0), *slow((7, 0.1), (12, 0.1))])
def test_a_fleet_of_like_machines_is_left_alone(machines: int, std: float) -> None:
    """Catches a threshold without regard to how many machines and parameters are looked at, and a spread of so few that
    it is nothing by chance: 5 of 100 at most here, whether machines differ or readings are uncertain."""
    rng = np.random.default_rng(9)
    said = sum(bool(fleet_of(rng.normal(0.0, 1.0, (machines, 15)), std).stands_out) for _ in range(150))
    assert said <= 0.05 * 150 + 3 * np.sqrt(150 * 0.05 * 0.95)


@pytest.mark.parametrize("odd", [[3], [3, 5]])
def test_of_seven_machines_what_is_far_off_stands_out(odd: list[int]) -> None:
    """Catches a threshold that nothing passes in a fleet of a few: a rod 2 mm off beside six within 0.1 mm was like the
    others in 24 of 24 fleets; and two odd ones of which each hides the other."""
    for seed in range(20):
        values = np.random.default_rng(seed).normal(0.0, 0.1, (7, 15))
        values[odd, 4] += 2.5
        found = fleet_of(values, std=0.02).stands_out
        assert {(one.run, one.name) for one in found} >= {(f"m{k}", "p4") for k in odd}
        assert all(abs(one.deviations) > one.threshold for one in found)


def test_what_the_drawing_leaves_open_is_the_same_for_all() -> None:
    """Catches a base radius 5 mm off that hides in what its fit takes from the drawing (deviation 1.5 mm, of which the
    readings leave 0.09), beside six machines that keep to the drawing within 0.1 mm: like the others in 6 of 6."""
    values = np.random.default_rng(4).normal(0.0, 0.1, (7, 15))
    values[3, 4] = 3.7
    like = fleet_of(values, std=0.09).machines
    odd = replace(like[3], std=dict.fromkeys(like[3].values or {}, 1.5))
    assert [(one.run, one.name) for one in Fleet((*like[:3], odd, *like[4:])).stands_out] == [("m3", "p4")]


def test_where_an_instrument_stood_is_nothing_of_a_machine() -> None:
    """Catches a machine that stands out because its tracker stood elsewhere."""
    like = fleet_of(np.random.default_rng(2).normal(0.0, 1.0, (12, 6)))
    moved = [replace(m, values={**(m.values or {}), "p5": 900.0 * (k == 3)}) for k, m in enumerate(like.machines)]
    assert Fleet(tuple(moved)).stands_out
    assert not Fleet(tuple(replace(m, of_sensor=("p5",)) for m in moved)).stands_out


def test_an_uncertain_value_stands_out_less() -> None:
    """Catches a badly measured machine that is called odd: its own uncertainty counts."""
    values = np.random.default_rng(2).normal(0.0, 1.0, (12, 6))
    values[7, 4] = 40.0
    assert not fleet_of(values, std=20.0).stands_out


def test_too_few_machines_say_nothing_of_one() -> None:
    """Catches a median of two machines, from which both are as far."""
    assert not fleet_of(np.array([[0.0], [0.1], [90.0]])).stands_out


@pytest.mark.parametrize(
    ("given", "said"),
    [([], "at least one run"), (["a.csv", "a.csv"], "a.csv: given more than once")],
)
def test_what_is_no_fleet_is_refused(given: list[str], said: str) -> None:
    """Catches a fleet of nothing, and a machine that is counted twice."""
    with pytest.raises(sk.errors.FitError, match=said):
        sk.fleet(given, EXAMPLE)
