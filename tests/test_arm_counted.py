"""Diagnoses of a UR5 before a laser tracker, counted: every effect of the catalogue, none, two at once, and physics
that no catalogue has.

``SHERKIT_COUNT`` sets how many times as many runs are made as by default; ``python tests/test_arm_counted.py singles 4
0`` counts by hand, from a seed on, and prints each run that went wrong.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import sherkit as sk
from consistency import named
from second_arms import SecondArm
from sherkit.base.types import Floats
from sherkit.model.kinds import model_of
from sherkit.robots.serial import Serial, postures
from sherkit.robots.serial.imported import import_dh
from test_serial import EFFECTS, NOISE_MM, PLAIN, UR5, hidden_at, payloads, simulated

COUNT = int(os.environ.get("SHERKIT_COUNT", "1"))
RATIOS = (1, 2, 5)
ROWS = 200
LEVEL = 0.01
#: Chance with which a correct program fails one of the counts below.
RARE = 1e-3
#: Length, in noise, at which what a single effect leaves of a pair shows in 80 % of runs: one column of the 200 that
#: are tried together at the level, on the two thirds of the rows that are searched.
SEEN = float(stats.norm.isf(LEVEL / 200 / 2) + stats.norm.isf(0.2)) * np.sqrt(1.5)
TARGET_MM = (60.0, 20.0, 50.0)


def arm_in(folder: Path) -> Serial:
    """The arm that all this is counted on."""
    (folder / "ur5.csv").write_text(UR5)
    return replace(import_dh(folder / "ur5.csv"), target_mm=TARGET_MM)


@pytest.fixture
def ur5(tmp_path: Path) -> Serial:
    """The same."""
    return arm_in(tmp_path)


# -- physics outside the catalogue ---------------------------------------------------------------------------------


@dataclass
class OwnArm:
    """The UR5 by its table of Denavit and Hartenberg, all rows at once: shares no line with the product.

    ``table`` (6, 5) is d, a, α, a lean β and a zero of each joint, mm and rad; ``outside`` names what else is at work,
    and ``size`` how much; the ``seed`` is that of what nobody wrote down.
    """

    table: Floats
    tool: Floats
    outside: str = ""
    size: float = 0.0
    seed: int = 0

    @classmethod
    def drawn(cls) -> OwnArm:
        """As in the maker's documents."""
        rows = [[float(cell) for cell in line.split(",")[1:]] for line in UR5.splitlines()[1:]]
        table = np.zeros((6, 5))
        table[:, :3] = rows
        table[:, 2] = np.deg2rad(table[:, 2])
        return cls(table, np.array(TARGET_MM))

    @classmethod
    def made(cls, seed: int) -> OwnArm:
        """One of plausible errors."""
        rng, drawn = np.random.default_rng([seed, 3]), cls.drawn()
        return cls(
            drawn.table + rng.normal(size=(6, 5)) * [0.5, 0.5, 1e-3, 1e-3, 3e-3],
            drawn.tool + 2.0 * rng.normal(size=3),
            seed=seed,
        )

    def places(self, q: Floats) -> Floats:
        """Of the target (n, 3), mm, base frame, for joints (n, 6), rad, in the order of the run."""
        q = q + self.table[:, 4]
        if self.outside == "product ripple":
            # two gears on one shaft: their teeth meet in a pattern of both angles
            q = q + self.size * np.outer(np.sin(5.0 * q[:, 1]) * np.sin(4.0 * q[:, 2]), np.eye(6)[3])
        frame = np.tile(np.eye(4), (len(q), 1, 1))
        for k, (d, a, alpha, beta, _) in enumerate(self.table):
            frame = frame @ _about(2, q[:, k], (0.0, 0.0, d))
            if self.outside == "link bends across" and k == 1:
                # a link with a slanted section, under what hangs on it, about its own length and across the joint
                bent = self.size * np.sin(q[:, 1]) * np.sin(q[:, 2])
                frame = frame @ _about(0, bent)
            frame = frame @ _about(0, np.array([alpha]), (a, 0.0, 0.0)) @ _about(1, np.array([beta]))
        return (frame @ [*self.tool, 1.0])[:, :3] + self._sunk(len(q))

    def _sunk(self, rows: int) -> Floats:
        """By how much the floor gives way while a press next door, that nobody wrote down, is loaded (n, 3), mm."""
        if self.outside != "press next door":
            return np.zeros((rows, 3))
        loaded = np.random.default_rng([self.seed, 5]).random(rows // 8 + 1) > 0.5
        return self.size * np.repeat(loaded, 8)[:rows, None] * np.array([0.3, -0.2, 0.9])

    def geometry(self, q: Floats) -> Floats:
        """Directions (3 n, p) that its own numbers, and the place of a tracker, can take up."""
        base, out = self.places(q), []
        for k in np.ndindex(self.table.shape):
            step = np.zeros_like(self.table)
            step[k] = 1e-4
            out.append(replace(self, table=self.table + step).places(q) - base)
        out += [np.cross(axis, base) for axis in np.eye(3)] + [np.tile(axis, (len(q), 1)) for axis in np.eye(3)]
        out += [replace(self, tool=self.tool + axis).places(q) - base for axis in np.eye(3)]
        columns = np.array([column.ravel() for column in out]).T
        return columns / np.linalg.norm(columns, axis=0)

    def at_ratio(self, outside: str, ratio: float, q: Floats) -> OwnArm:
        """With something at work that leaves ``ratio`` times the noise beside the best numbers."""
        with_it = replace(self, outside=outside, size=1e-4)
        change = (with_it.places(q) - self.places(q)).ravel()
        columns = self.geometry(q)
        left = change - columns @ np.linalg.lstsq(columns, change, rcond=1e-9)[0]
        return replace(with_it, size=1e-4 * ratio * NOISE_MM / float(np.sqrt(np.mean(left**2))))

    def run(self, arm: Serial, q: Floats, seed: int, declared: bool) -> sk.Measurements:
        """What a tracker of another place shows, in a file as any other; with its noise ``declared`` in columns."""
        rng = np.random.default_rng([seed, 4])
        seen = self.places(q) @ _about(2, np.array([0.02]))[0, :3, :3].T + [20.0, -10.0, 15.0]
        seen = seen + NOISE_MM * rng.normal(size=seen.shape)
        t = 4.0 * np.arange(len(q))
        columns = {"time_s": t, "temperature_c": 20.0 + 3.0 * (1.0 - np.exp(-2.0 * t / t[-1]))}
        columns |= dict(zip(arm.layout.joints, q.T, strict=True))
        columns |= dict(zip(arm.layout.coordinates, seen.T, strict=True))
        if declared:
            columns |= dict.fromkeys(arm.layout.sigmas[:3], np.full(len(q), NOISE_MM))
        return sk.Measurements.from_columns(columns, "second arm", layout=arm.layout)


OUTSIDE = ("press next door", "link bends across", "product ripple")


def _about(axis: int, angle: Floats, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Floats:
    """Frames (n, 4, 4) turned about a coordinate axis, and shifted."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = np.tile(np.eye(4), (len(angle), 1, 1))
    out[:, i, i] = out[:, j, j] = np.cos(angle)
    out[:, j, i] = np.sin(angle)
    out[:, i, j] = -out[:, j, i]
    out[:, :3, 3] = shift
    return out


def test_the_other_arm_is_the_same_arm(ur5: Serial) -> None:
    """Catches a simulator of another arm than the one that is diagnosed: all below would be unexplained by that."""
    q = postures(ur5, 20)
    np.testing.assert_allclose(OwnArm.drawn().places(q), ur5.forward_batch(q).values, atol=1e-9)


# -- one run of each kind ------------------------------------------------------------------------------------------


def enough_alone(arm: Serial, hidden: dict[str, Any], seed: int) -> set[str]:
    """Effects of which one, with the geometry, explains all that was planted but for less than can be seen.

    In linear approximation, without noise. What was planted comes from the virtual arm.
    """
    virtual = replace(SecondArm.simulated(arm, seed, 1.0, PLAIN), noise_mm=0.0)
    poses = postures(arm, ROWS, 0.9, seed)
    hung = payloads(ROWS, seed)
    with_it = virtual.with_hidden(**hidden).measure(poses, seed=seed + 5, payload_kg=hung)
    planted = (with_it.readings - virtual.measure(poses, seed=seed + 5, payload_kg=hung).readings).ravel()
    model, out = model_of(arm), set()
    for name in EFFECTS:
        if name == "reading_delay" and "late_s" not in hidden:
            # no velocities were written down: it cannot be tried
            continue
        effect = model.known_effects[name]
        at = 2 * np.pi / hidden["per_turn"] if effect.is_periodic else float(with_it.time_s[ROWS // 2])
        larger = model.with_effect(effect, at=at if effect.search and not effect.is_lagging else None)
        columns = larger.derivatives(with_it, np.zeros(len(larger.parameters))).reshape(planted.size, -1)
        columns = columns[:, np.linalg.norm(columns, axis=0) > 0]
        columns = columns / np.linalg.norm(columns, axis=0)
        left = planted - columns @ np.linalg.lstsq(columns, planted, rcond=1e-10)[0]
        if np.linalg.norm(left) < SEEN * NOISE_MM:
            out.add(name)
    return out


Verdict = tuple[str, str, sk.diagnosis.Diagnosis]


def singles(arm: Serial, seeds: range) -> Iterator[Verdict]:
    """Each effect at each ratio: ``right`` where it leads or is tied, with others or, by ``confounded_with``, with the
    geometry while nothing else is blamed; ``wrong`` where others explain it."""
    for seed, ratio, name in product(seeds, RATIOS, EFFECTS):
        d = sk.diagnose(arm, simulated(arm, seed, ROWS, **hidden_at(arm, name, ratio, seed)))
        tied = name in d.confounded_with and d.verdict == "adequate"
        kind = "right" if name in named(d) or tied else "wrong" if d.verdict == "explained" else "missed"
        yield kind, f"{name} at {ratio}, seed {seed}", d


def silent(arm: Serial, seeds: range) -> Iterator[Verdict]:
    """Nothing hidden: ``right`` where nothing is found."""
    for seed in seeds:
        d = sk.diagnose(arm, simulated(arm, seed, ROWS))
        yield "right" if d.verdict == "adequate" else "alarm", f"seed {seed}", d


def pairs(arm: Serial, seeds: range) -> Iterator[Verdict]:
    """Two effects at twice the noise each, pairs in an order of their own by seed."""
    of_all = list(combinations(EFFECTS, 2))
    for seed in seeds:
        pair = of_all[np.random.default_rng(seed // len(of_all)).permutation(len(of_all))[seed % len(of_all)]]
        hidden = hidden_at(arm, pair[0], 2.0, seed) | hidden_at(arm, pair[1], 2.0, seed + 1000)
        d = sk.diagnose(arm, simulated(arm, seed, ROWS, **hidden))
        both = set(pair) <= named(d)
        alone = set() if both else enough_alone(arm, hidden, seed)
        kind = "right" if both else "one enough" if alone & named(d) else "undecidable" if alone else "missed"
        yield kind, f"{pair}, seed {seed}, enough alone {sorted(alone)}", d


def outside(arm: Serial, seeds: range) -> Iterator[Verdict]:
    """Physics of no catalogue, ``wrong`` where it is explained without a caveat; or where nothing is found though
    the noise is declared: without that, what goes with nothing in the file is noise for all that can be known, and the
    headline of what is explained says that how much of the rest is noise is not known."""
    for seed, ratio, name, declared in product(seeds, RATIOS, OUTSIDE, (False, True)):
        q = postures(arm, ROWS, 0.9, seed)
        d = sk.diagnose(arm, OwnArm.made(seed).at_ratio(name, ratio, q).run(arm, q, seed, declared))
        reserved = d.caveat or "how much of the rest is noise is not known" in d.headline
        pressed = d.verdict == "explained" and not reserved
        kind = "wrong" if pressed or (declared and d.verdict == "adequate") else d.verdict
        yield kind, f"{name} at {ratio}, seed {seed}, noise {'declared' if declared else 'unknown'}", d


def counted(runs: Iterator[Verdict]) -> tuple[Counter[str], list[str]]:
    """How many of each, and what went otherwise than right."""
    count: Counter[str] = Counter()
    said = []
    for kind, what, d in runs:
        count[kind] += 1
        if kind != "right":
            said.append(f"{kind}: {what}: {d.verdict} {d.effects} ties {d.indistinguishable}")
    return count, said


# -- rates ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_each_effect_leads_or_is_tied_in_98_of_100(ur5: Serial) -> None:
    """Catches an effect that is not found, or taken for another. At 1, 2 and 5 times the noise, seeds from 0, 98 %;
    explained without it in 1 % at most; binomial allowances of 1 in 1,000."""
    count, said = counted(singles(ur5, range(COUNT)))
    assert count.total() - count["right"] <= stats.binom.isf(RARE, count.total(), 0.02), said
    assert count["wrong"] <= stats.binom.isf(RARE, count.total(), 0.01), said


@pytest.mark.slow
def test_where_nothing_is_hidden_alarms_are_few(ur5: Serial) -> None:
    """Catches a level that is not held: 1.5 % at most, 20 runs by default, binomial allowance of 1 in 1,000."""
    count, said = counted(silent(ur5, range(100, 100 + 20 * COUNT)))
    assert count["alarm"] <= stats.binom.isf(RARE, count.total(), 0.015), said


@pytest.mark.slow
def test_pairs_are_named_in_95_of_100(ur5: Serial) -> None:
    """Catches pairs of which one effect hides the other, at twice the noise: both named in 95 % of those of which no
    single effect explains all that can be seen; binomial allowance of 1 in 1,000."""
    count, said = counted(pairs(ur5, range(20 * COUNT)))
    decidable = count["right"] + count["missed"]
    assert count["missed"] <= stats.binom.isf(RARE, decidable, 0.05), said


@pytest.mark.slow
def test_what_is_in_no_catalogue_is_never_explained(ur5: Serial) -> None:
    """Catches physics pressed into the catalogue: a load that nobody wrote down, a link that bends across its joint, a
    ripple of two joints. At 1, 2 and 5 times the noise; none of them explained without a caveat."""
    count, said = counted(outside(ur5, range(200, 200 + COUNT)))
    assert not count["wrong"], said


@pytest.mark.slow
def test_blocks_of_rows_that_are_put_aside_are_said_before_what_is_left_is_explained(ur5: Serial) -> None:
    """Catches a cause explained away by calling every fourth row wrong. A press at five times the noise, seed 300."""
    q = postures(ur5, ROWS, 0.9, 300)
    d = sk.diagnose(ur5, OwnArm.made(300).at_ratio("press next door", 5, q).run(ur5, q, 300, declared=True))
    assert d.verdict != "explained" or d.caveat


if __name__ == "__main__":
    import sys
    import tempfile
    import time

    kinds: dict[str, Callable[[Serial, range], Iterator[Verdict]]] = {
        "singles": singles, "silent": silent, "pairs": pairs, "outside": outside,
    }  # fmt: skip
    tally: Counter[str] = Counter()
    started, first = time.process_time(), int(sys.argv[3])
    with tempfile.TemporaryDirectory() as made:
        runs = kinds[sys.argv[1]](arm_in(Path(made)), range(first, first + int(sys.argv[2])))
        for kind, what, d in runs:
            tally[kind] += 1
            if kind != "right":
                print(f"{kind}: {what}: {d.verdict} {d.effects} {d.indistinguishable} reserved {d.caveat}", flush=True)
            print(dict(tally), "CPU", round(time.process_time() - started), "s", flush=True)


@pytest.mark.slow
def test_a_loose_grip_is_seldom_blamed_on_the_joints(ur5: Serial) -> None:
    """Catches "partly explained: joint_compliance" of a target that falls to the other side of its grip as it is
    turned over, in 8 of 10 arms: no shape of joints describes that, so that any effect says more than shapes do, and
    each pose is off by its own beside it. Seeds 0 to 9: 4."""
    blamed = 0
    for seed in range(10):
        own, q, rng = OwnArm.made(seed), postures(ur5, 100, 0.9, seed), np.random.default_rng([seed, 8])
        across = replace(own, tool=own.tool + np.eye(3)[0]).places(q) - own.places(q)
        places = own.places(q) + 0.15 * across * np.sign(across[:, 2:])
        order = np.concatenate([rng.permutation(100) for _ in range(2)])
        seen = places[order] + [20.0, -10.0, 15.0] + NOISE_MM * rng.normal(size=(200, 3))
        columns = {"pose": order, "time_s": 4.0 * np.arange(200)} | dict(
            zip(ur5.layout.joints, q[order].T, strict=True)
        )
        run = sk.from_frame(columns | dict(zip(ur5.layout.coordinates, seen.T, strict=True)))
        blamed += sk.diagnose(ur5, run).effects != ()
    assert blamed <= 5


@pytest.mark.parametrize("joint", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 6))])
def test_one_eccentric_encoder_is_found(joint: int, ur5: Serial) -> None:
    """Catches an effect that any of six joints may have, held against shapes of one joint, which pay for no other:
    "unexplained: roll varies smoothly" of one eccentric encoder in 47 of 60 arms."""
    own, q, rng = OwnArm.made(joint), postures(ur5, 90, 0.9, joint), np.random.default_rng([joint, 9])
    driven = q + 1.5e-3 * np.outer(np.sin(q[:, joint] - rng.uniform(0.0, 2.0 * np.pi)), np.eye(6)[joint])
    order = np.concatenate([rng.permutation(90) for _ in range(2)])
    seen = own.places(driven)[order] + [20.0, -10.0, 15.0] + 0.02 * rng.normal(size=(180, 3))
    columns = {"pose": order, "time_s": 4.0 * np.arange(180)} | dict(zip(ur5.layout.joints, q[order].T, strict=True))
    run = sk.from_frame(columns | dict(zip(ur5.layout.coordinates, seen.T, strict=True)))
    found = sk.diagnose(ur5, run)
    assert "encoder_eccentricity" in {*found.effects, *(name for tie in found.indistinguishable for name in tie)}
    assert found.verdict == "explained"
