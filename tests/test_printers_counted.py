"""Verdicts on simulated printers with realistic faults, counted."""

from __future__ import annotations

import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from second_printer.trials import FAULTS, Trial
from sherkit import SherkitWarning
from sherkit.robots.printer import import_klipper
from sherkit.robots.printer.hypotheses import plain_fit
from sherkit.robots.printer.printer_diagnosis import Examined, examine, files_of

FIRMWARES = ("klipper", "reprapfirmware", "marlin")
#: A fault shows where without noise it leaves more than this part of the noise, RMS, that no number of the firmware
#: takes.
_SHOWS = 1.0


def examined(trial: Trial, folder: Path, firmware: str, turned: tuple[float, ...], seed: int | None) -> Examined:
    """A printer examined by its files."""
    config, *maps = trial.write(folder, firmware, turned, seed)
    names = [f"G29_{k + 1}" for k in range(len(turned))] if firmware == "marlin" else [f"at{t:g}" for t in turned]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SherkitWarning)
        found = files_of(config, tuple(maps), dict(zip(names, turned, strict=True)))
        return examine(found)


def left_without_noise(trial: Trial, folder: Path, turned: tuple[float, ...]) -> float:
    """What the best numbers of the firmware leave of a probing without noise, mm RMS."""
    found = import_klipper(trial.write(folder, "klipper", turned, None)[0], {f"at{t:g}": t for t in turned})
    left = plain_fit(found.robot, found.measurements).residuals
    return float(np.sqrt(np.mean(left**2)))


def counted(printers: int, folder: Path, seed: int, *, first: int = 0, told: bool = False) -> Counter[str]:
    """Verdicts on so many printers from the ``first`` on, each with one mesh and with the plate turned."""
    out: Counter[str] = Counter()
    for number in range(first, first + printers):
        fault = list(FAULTS)[number % len(FAULTS)]
        firmware = FIRMWARES[number // len(FAULTS) % len(FIRMWARES)]
        trial, right = Trial.of(fault, seed, number), FAULTS[fault]
        for turned in ((0.0,), (0.0, 60.0)):
            kind = "turned" if len(turned) > 1 else "one"
            # what a fault leaves is told by the file without noise, in Klipper's digits
            shown = left_without_noise(trial, folder, turned) > _SHOWS * trial.probe.noise
            e = examined(trial, folder, firmware, turned, 1000 * seed + number)
            blamed = {name for one in e.suspects for name in one.names}
            verdict = "right" if (right in blamed if right and shown else not blamed or right in blamed) else "wrong"
            out[f"{kind} {verdict}"] += 1
            plate, machine = "bed_shape" in blamed, bool(blamed - {"bed_shape"})
            out[f"{kind} machine for plate"] += fault == "bent plate" and machine and not plate
            out[f"{kind} plate for machine"] += fault != "bent plate" and plate and not machine
            out[f"{kind} bent plates"] += fault == "bent plate"
            if right and shown and kind == "turned":
                apart = plate != machine and plate == (fault == "bent plate")
                out["told apart" if apart else "not told apart"] += 1
            out[f"{kind} shown {fault}"] += shown
            if told:
                print(
                    number, fault, firmware, kind, "shown" if shown else "hidden", verdict, sorted(blamed), flush=True
                )
    return out


def held(out: Counter[str], printers: int) -> None:
    """The figures that are promised."""
    for kind in ("one", "turned"):
        assert out[f"{kind} right"] >= 0.95 * printers, out
        assert out[f"{kind} machine for plate"] <= max(0.02 * printers, 0), out
        assert out[f"{kind} plate for machine"] <= 0.02 * printers, out
    assert out["told apart"] >= 0.95 * (out["told apart"] + out["not told apart"]), out


@pytest.mark.slow
def test_a_twisted_frame_and_a_bent_plate(tmp_path: Path) -> None:
    """Catches a frame that is twisted taken for a plate, or the reverse, once the plate was turned by a sixth of a
    turn; and a third of a turn that would be believed to tell them apart."""
    twisted, bent = Trial.of("frame twisted", 5, 1), Trial.of("bent plate", 5, 2)
    machine = [s.names for s in examined(twisted, tmp_path, "klipper", (0.0, 60.0), 1).suspects]
    assert ("rail_lean",) in machine
    assert not any("bed_shape" in names for names in machine)
    assert [s.names for s in examined(bent, tmp_path, "klipper", (0.0, 60.0), 1).suspects] == [("bed_shape",)]
    third = {n for s in examined(twisted, tmp_path, "klipper", (0.0, 120.0), 1).suspects for n in s.names}
    assert third >= {"rail_lean", "bed_shape"}
    leaning = Trial.of("one tower leans", 11, 10)
    one = examined(leaning, tmp_path, "reprapfirmware", (0.0,), 11010)
    assert {n for s in one.suspects for n in s.names} >= {"rail_lean", "bed_shape"}
    assert "Turn the plate by 60°" in " ".join(one.sections[-1][1])


@pytest.mark.slow
def test_two_hundred_printers(tmp_path: Path) -> None:
    """Catches machines that are blamed for their plate, plates for their machine, and faults that are not named."""
    held(counted(200, tmp_path, 7), 200)


if __name__ == "__main__":
    import sys
    import tempfile
    import time

    started = time.process_time()
    with tempfile.TemporaryDirectory() as made:
        result = counted(int(sys.argv[1]), Path(made), int(sys.argv[2]), first=int(sys.argv[3]), told=True)
    for key in sorted(result):
        print(key, result[key])
    print("CPU", np.round(time.process_time() - started, 1), "s")
