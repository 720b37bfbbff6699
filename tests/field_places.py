"""Two arms of a robot in the field, calibrated in one place and asked in others, beside their drawing.

``python tests/field_places.py FOLDER`` reads a public data set of a Motoman SDA10F with a laser tracker, which is not
kept here: ``right.toml``, ``right.csv``, ``left.toml`` and ``left.csv`` of the place where the arms were measured, and
the data sets of the other places as their authors give them (``leica_lower_…`` and so on, MATLAB files whose columns 7
to 12 are the joints of the right arm, 13 to 18 of the left, rad, and 19 to 21 what the tracker read, m). Errors are
root mean squares in the best rigid frame, mm; where the arms were measured those of poses held out.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
import scipy

import sherkit as sk
from field_worlds import best_frame

#: Places by the names of their files, and the columns of the joints of each arm.
PLACES = ("lower", "higher", "wall", "self_lower")
JOINTS = {"right": slice(7, 13), "left": slice(13, 19)}
READ = slice(19, 22)
#: Fewest postures that make a place, and digits to which postures and readings are the same.
FEWEST, DIGITS = 5, 4


def places_of(folder: Path, arm: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Postures (n, 6), rad, of an arm in each other place where it was read, and what the tracker read (n, 3), mm."""
    out = {}
    for name in PLACES:
        (path,) = folder.glob(f"leica_{name}[0-9_]*.mat")
        rows = scipy.io.loadmat(path)["dataset"]
        rows = rows[np.isfinite(rows[:, READ]).all(axis=1)]
        both = np.round(np.c_[rows[:, JOINTS[arm]], rows[:, READ]], DIGITS)
        rows = rows[np.unique(both, axis=0, return_index=True)[1]]
        joints = rows[:, JOINTS[arm]]
        if len(np.unique(np.round(joints, DIGITS), axis=0)) >= FEWEST:
            out[name] = np.ascontiguousarray(joints), 1e3 * rows[:, READ]
    return out


def table(folder: Path) -> str:
    """The lines that are printed."""
    lines = [f"{'arm':6} {'place':11} {'drawing':>8} {'plain':>8} {'default':>8} {'with all that is named':>23}"]
    for arm in JOINTS:
        robot, run = folder / f"{arm}.toml", folder / f"{arm}.csv"
        found = sk.diagnose(robot, run)
        plain, default = (sk.calibrate(robot, run, priors=priors).calibration for priors in (False, None))
        named = sk.calibrate(robot, run, effects=found.effects).calibration
        drawn = sk.load_robot(robot)
        home, with_that = (step.error.rms / 1e3 for step in (found.steps[0], found.steps[-1]))
        names = ", ".join(found.effects) or "nothing more"
        lines.append(f"{arm:6} {'measured':11} {home:26.4f} {with_that:23.4f} with {names}")
        for place, (joints, read) in places_of(folder, arm).items():
            tips = [drawn.forward_batch(joints).values, *(
                one.forward_batch(joints).values for one in (plain, default, named)
            )]  # fmt: skip
            off = [best_frame(tip, read) for tip in tips]
            lines.append(f"{arm:6} {place:11} {off[0]:8.3f} {off[1]:8.3f} {off[2]:8.3f} {off[3]:23.3f}")
    return "\n".join(lines)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    print(table(Path(sys.argv[1])))
