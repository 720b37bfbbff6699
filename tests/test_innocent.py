"""An innocent is not named: physics in no catalogue, on which the search would like to pin what it knows.

The worlds are those of ``second_simulator/unnamed.py``. The counts print a table, so that they measure as well: run
them with ``-m slow -s``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

import sherkit as sk
from running import slow
from second_simulator.unnamed import (
    DELTA_KINDS,
    SPHERICAL_KINDS,
    Kind,
    Unnamed,
    crosstalk_product,
    delta_unnamed,
    room_cycle,
    spherical_unnamed,
    telegraph,
)
from sherkit.diagnosis import indistinguishable, sentence
from sherkit.evidence.made import distinguishable_waves
from sherkit.evidence.thresholds import LOUDER
from strategies import EXAMPLE
from worlds import Answer, World

Make = Callable[[Kind, float, Any, int], Unnamed]

SEEDS = range(8)
RATIOS = (2.0, 5.0)
ORDERS = ("raster", "shuffled")
FEWEST_HELD = 0.70
#: Effects that are a part of the truth: what snaps to another place slips.
TRUE_NAMES: dict[Kind, set[str]] = {telegraph: {"slip"}}


@dataclass
class Count:
    """How the runs of one kind came out."""

    runs: int = 0
    lies: list[str] = field(default_factory=list)
    innocents: Counter[str] = field(default_factory=Counter)
    accusing: int = 0
    asked: int = 0
    held: int = 0
    other: Counter[str] = field(default_factory=Counter)

    def take(self, kind: Kind, world: Unnamed, answer: Answer, where: str) -> None:
        """One more run. Where the verdict praises by right (bumped rows are left out) nothing is described."""
        self.runs += 1
        d = answer.diagnosis
        if d is None:
            self.lies.append(f"{where}: {answer.short()}")
            return
        praised = d.verdict in ("adequate", "explained")
        honest = d.steps[-1].error.rms / np.sqrt(d.error.axes) <= LOUDER * world.noise
        if praised and not honest:
            self.lies.append(f"{where}: {answer.short()}")
        guilty = TRUE_NAMES.get(kind, set())
        guilty = guilty.union(*(tied for tied in d.indistinguishable if guilty.intersection(tied)))
        innocents = set(d.effects) - guilty
        self.innocents.update(innocents)
        self.accusing += bool(innocents)
        if praised and honest:
            return
        self.asked += 1
        told = [d.signature, *d.signature["indistinguishable"]] if d.signature else []
        if any(set(one["depends_on"]) & world.true for one in told):
            self.held += 1
        else:
            self.other[" and ".join(told[0]["depends_on"]) if told else "nothing"] += 1


def ask(world: Unnamed) -> Answer:
    return World(world.settings, world.columns, world.noise).ask()


def counted(make: Make, kinds: dict[Kind, frozenset[str]], seeds: range = SEEDS) -> dict[str, Count]:
    """The table of a robot, printed as it grows."""
    table: dict[str, Count] = {}
    for kind in kinds:
        count = table[kind.__name__] = Count()
        for seed in seeds:
            for ratio in RATIOS:
                for order in ORDERS:
                    world = make(kind, ratio, order, seed)
                    count.take(kind, world, ask(world), f"{kind.__name__} {ratio:g} {order} {seed}")
        print(
            f"{kind.__name__:<20} {count.runs:3} runs, {len(count.lies)} lies, {count.accusing} accuse "
            f"{dict(count.innocents)}, signature {count.held} of {count.asked} {dict(count.other)}",
            flush=True,
        )
    return table


#: The bars are 5 % innocents, none of praise over an error that is not the instrument's, the truth in 80 % of the
#: descriptions. The delta's is nearly reached but for what depends on the way a joint came, which backlash is a cousin
#: of; the spherical robot's is not: within twice the noise two effects imitate what is seen in one picture to a few
#: hundredths. What is held is what seeds showed that nobody had tuned on, with room.
HELD_YET = {"delta": (0.16, 0.03), "spherical": (0.40, 0.05)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "kinds", "robot"),
    [(delta_unnamed, DELTA_KINDS, "delta"), (spherical_unnamed, SPHERICAL_KINDS, "spherical")],
)
def test_an_innocent_is_not_named(make: Make, kinds: dict[Kind, frozenset[str]], robot: str) -> None:
    """Catches an effect that stands in for physics of no catalogue, a verdict of praise over an error that is not the
    instrument's, and a description that does not hold what it depends on.

    Every kind at 2 and 5 times the noise, in raster and shuffled order, seeds 0 to 7.
    """
    table = counted(make, kinds).values()
    runs, asked = sum(c.runs for c in table), sum(c.asked for c in table)
    accusing, held = sum(c.accusing for c in table), sum(c.held for c in table)
    lies = [lie for c in table for lie in c.lies]
    print(f"{runs} runs: {len(lies)} lies, {accusing} accuse an innocent, signature holds the truth in {held}/{asked}")
    most, praised = HELD_YET[robot]
    assert held >= FEWEST_HELD * asked
    assert accusing <= most * runs
    assert len(lies) <= praised * runs, lies


@pytest.mark.slow
def test_a_step_does_not_stand_in_for_a_cycle() -> None:
    """Catches slip named for the air conditioning of a room: beside a free course in time it brings nothing. Seed 0."""
    d = ask(delta_unnamed(room_cycle, 5.0, "shuffled", 0)).diagnosis
    assert d.effects == ()
    assert d.verdict == "unexplained"
    assert (d.signature["depends_on"], d.signature["shape"]) == (["time_s"], "periodic")


@pytest.mark.slow
def test_the_distance_of_poses_is_no_period() -> None:
    """Catches "repeats with z, period 10": on planes ten millimetres apart that is any function of z. Seed 0."""
    d = ask(delta_unnamed(crosstalk_product, 5.0, "shuffled", 0)).diagnosis
    for one in (d.signature, *d.signature["indistinguishable"]):
        assert one["shape"] != "periodic" or one["depends_on"] != ["z_mm"]


def test_shapes_that_do_as_well_are_told() -> None:
    """Catches one of two shapes that these rows cannot tell apart given as the answer: humidity fell in proportion to
    the time."""
    rng = np.random.default_rng(3)
    n = 60
    x, t = rng.uniform(-1, 1, n), np.arange(n) * 10.0
    damp = 50.0 - 0.02 * t
    shown = (3.0 * x + 0.05 * (damp - damp.mean()) + 0.02 * rng.normal(size=n))[:, None]
    model = Straight()
    data = sk.data.from_arrays(
        place={"x_mm": x}, readings=shown, names=("y_mm",), unit="mm", time_s=t, covariates={"humidity_pct": damp}
    )
    d = sk.diagnose(sk.identify(model, data))
    distinguishable_waves = {tuple(one["depends_on"]) for one in (d.signature, *d.signature["indistinguishable"])}
    assert {("time_s",), ("humidity_pct",)} <= distinguishable_waves
    assert "longer run" in d.signature["apart"]
    assert indistinguishable(d.signature) in repr(d)
    assert sentence(d.signature) in repr(d)
    assert d.to_json()["signature"]["indistinguishable"]


def test_a_wave_that_slower_ones_stand_in_for_is_an_alias() -> None:
    """Catches a period read off the lines of a grid, measured or commanded, and one refused where poses can tell it."""
    rng = np.random.default_rng(0)
    lines = np.repeat(np.linspace(-20.0, 20.0, 9), 40)
    for values in (lines, lines + rng.normal(0, 0.1, lines.size)):
        assert distinguishable_waves(values, float(np.ptp(values)) / np.array([5.0, 7.0, 12.0])).tolist() == [
            False,
            False,
            True,
        ]
    assert distinguishable_waves(rng.uniform(-20, 20, 300), 40.0 / np.array([2.0, 5.0, 12.0])).all()


@dataclass(frozen=True)
class Straight:
    """A straight line through zero."""

    parameters: tuple[sk.model.Parameter, ...] = (sk.model.Parameter("slope", "slope", "1", 1.0),)

    def predict(self, data: sk.Measurements, values: Any) -> Any:
        return (values[0] * data["x_mm"])[:, None]

    def derivatives(self, data: sk.Measurements, values: Any) -> Any:
        return data["x_mm"][:, None, None]

    def covariates(self, data: sk.Measurements) -> dict[str, Any]:
        return {"time_s": data.time_s, "humidity_pct": data["humidity_pct"]}


@pytest.mark.parametrize("seed", [1, *slow(2, 3)])
def test_what_swings_between_rows_is_no_noise(seed: int) -> None:
    """Catches "adequate" of an instrument that swings to and fro within four rows, by more than its noise: repeats of a
    pose tell of it as of noise, and no wave so quick was tried."""
    run = (
        sk.delta.VirtualDelta.draw(EXAMPLE, seed).measure(sk.delta.paper_whole()[::4], repeats=4, seed=seed).to_frame()
    )
    time = run["time_s"].to_numpy()
    angle = 2.0 * np.pi * time / (3.3 * np.median(np.diff(np.sort(time))))
    swing = np.random.default_rng(seed).normal(size=3)
    swing *= 0.008 / np.linalg.norm(swing)
    swung = {f"{a}_mm": run[f"{a}_mm"].to_numpy() + by * np.sin(angle) for a, by in zip("xyz", swing, strict=True)}
    assert sk.diagnose(EXAMPLE, sk.from_frame({**run.to_dict(as_series=False), **swung})).verdict == "unexplained"
