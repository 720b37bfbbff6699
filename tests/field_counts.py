"""Arms in the field, counted: how far calibrated ones are off in regions that were not measured, beside their drawings,
and whether what is said of their accuracy holds there.

``python tests/field_counts.py --robots N --first SEED`` prints each region that is worse than the drawing, and the
counts. Robots in turn are off their drawing by what makers state, and by a tenth, three tenths and one of the sizes
that are plausible. With ``--best`` nothing ripples or bends, and each robot's file states the spread by which it was
drawn: no calibration has a smaller expected error than that with such a prior, so what it counts is what chance does.
"""

from __future__ import annotations

import argparse
import time
import warnings
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

import sherkit as sk
from field_worlds import REGIONS, Field, best_frame, spread_of
from field_worlds import field as world

#: By how much each robot in turn is off.
OFF = (None, 0.1, 0.3, 1.0)
#: Times the drawing, and times plain least squares as a tracker reads it, that are too much.
WORSE, WORSE_INSIDE = 1.02, 1.05


@dataclass
class Counted:
    """What was found: ratios to the drawing by region (r,), those inside to plain least squares, and by frame and
    region the error of each place, what was said of it, and the part of that which poses show (none of moves), mm."""

    away: dict[str, list[float]] = field(default_factory=dict)
    inside: list[float] = field(default_factory=list)
    held: dict[tuple[str, str], list[np.ndarray]] = field(default_factory=dict)

    def add(self, made: Field, what: str, *, spread: tuple[float, ...] = ()) -> None:
        """One robot: calibrated from its run by default, or with the ``spread`` by which it was drawn as its prior;
        asked inside and in each other region."""
        run = made.run(declared=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            priors = True if spread else None
            done = sk.calibrate(made.arm.robot(spread=spread), run, priors=priors).calibration
            plain = sk.calibrate(made.arm.robot(), run, priors=False).calibration
        off = [best_frame(one.forward_batch(made.inside).values, made.arm.base(made.inside)) for one in (done, plain)]
        read = np.hypot(off, np.sqrt(3.0) * made.arm.noise_mm)
        self.inside.append(read[0] / read[1])
        if self.inside[-1] > WORSE_INSIDE:
            print(f"{what}: inside {self.inside[-1]:.3f} times plain least squares", flush=True)
        for name, q in {"inside": made.inside, **made.asked}.items():
            self._hold(done, made, name, q)
        for name, q in made.asked.items():
            drawn, real = best_frame(made.arm.drawn(q), made.arm.base(q)), made.arm.base(q)
            ratio = best_frame(done.forward_batch(q).values, real) / drawn
            self.away.setdefault(name, []).append(ratio)
            if ratio > WORSE:
                beside = best_frame(plain.forward_batch(q).values, real) / drawn
                print(f"{what}: {name} {ratio:.3f} of {drawn:.3f} mm; plain least squares {beside:.3f}", flush=True)

    def _hold(self, done: sk.serial.SerialCalibration, made: Field, name: str, q: np.ndarray) -> None:
        for frame, real in (("sensor", made.arm.seen(q)), ("base", made.arm.base(q))):
            said = done.predicted_accuracies_with(q, frame=frame)
            off = np.linalg.norm(done.forward_batch(q, frame=frame).values - real, axis=1)
            self.held.setdefault((frame, name), []).append(np.stack([off, said.total_mm, said.radius_mm]))
        there, real = done.forward_batch(q, frame="sensor").values, made.arm.seen(q)
        off = np.linalg.norm(np.diff(there, axis=0) - np.diff(real, axis=0), axis=1)
        said = np.array([done.move_accuracy_with(a, b, frame="sensor") for a, b in pairwise(q)])
        self.held.setdefault(("moves", name), []).append(np.stack([off, said, np.full(len(off), np.nan)]))

    def cover(self, frame: str, *names: str) -> tuple[float, float, float, float]:
        """The part of places within what is said of them and within what poses show (NaN of moves), and the medians
        (mm) of their errors and of what is said."""
        off, said, shown = np.concatenate([one for name in names for one in self.held[frame, name]], axis=1)
        by_poses = float((off <= shown).mean()) if np.isfinite(shown).all() else np.nan
        return float((off <= said).mean()), by_poses, float(np.median(off)), float(np.median(said))

    def __str__(self) -> str:
        every = np.concatenate([*self.away.values()])
        lines = [
            f"{len(every)} (robot × other region): {np.count_nonzero(every > WORSE)} above {WORSE} × the drawing, "
            f"worst {every.max():.2f}, median {np.median(every):.3f}",
            *(f"  {name}: {np.count_nonzero(np.array(one) > WORSE)} of {len(one)}, worst {max(one):.2f}, median "
              f"{np.median(one):.3f}" for name, one in self.away.items()),
            f"inside, as read, beside plain least squares: worst {max(self.inside):.3f}, median "
            f"{np.median(self.inside):.3f}",
        ]  # fmt: skip
        for frame in ("sensor", "base", "moves"):
            for called, names in (("inside", ("inside",)), ("outside", REGIONS), *((n, (n,)) for n in REGIONS)):
                held, by_poses, off, said = self.cover(frame, *names)
                alone = "" if np.isnan(by_poses) else f", {by_poses:.3f} by what poses show alone"
                lines.append(f"{frame:6} {called:7}: {held:.3f} held{alone}; median off {off:.3f} mm, said {said:.3f}")
        return "\n".join(lines)


def counted(robots: int, first: int, *, best: bool = False) -> Counted:
    """So many robots, from a seed on; the ``best`` that can be of those without gears and loads."""
    out = Counted()
    for seed in range(first, first + robots):
        off = OFF[seed % len(OFF)]
        said = f"seed {seed}, off by {'what makers state' if off is None else off}"
        out.add(world(seed, sizes=off, bare=best), said, spread=spread_of(off) if best else ())
    return out


if __name__ == "__main__":
    asked = argparse.ArgumentParser()
    asked.add_argument("--robots", type=int, default=20)
    asked.add_argument("--first", type=int, default=0)
    asked.add_argument("--best", action="store_true")
    given = asked.parse_args()
    began = time.process_time()
    print(counted(given.robots, given.first, best=given.best))
    print(f"{time.process_time() - began:.0f} s of processor")
