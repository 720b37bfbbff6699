"""The page on the laboratory: its files are read, its commands run, one after the other, as a reader would."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time

import pytest

from sherkit import load_robot
from sherkit.robots.delta.model import DeltaModel
from test_docs import blocks, command, prose, run_python, sherkit

PAGE = "docs/laboratory.md"
#: What the drivers wait for an answer, s: the emulators run on this machine, which others may keep busy. The page keeps
#: what fits an instrument: a controller that is silent for half a second while axes move is braked.
_PATIENCE = {"galil": "timeout_s = 20.0\npoll_timeout_s = 20.0\n", "keyence": "timeout_s = 20.0\n"}


def background(arguments, folder):
    """Starts a laboratory and returns once its ports are written."""
    code = "from sherkit.cli import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    end = time.monotonic() + 600
    while not (folder / "ports.json").exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.05)
    return process


def patient(experiment):
    """An experiment whose drivers wait longer."""
    return re.sub(r'^kind = "(\w+)".*\n', lambda kind: kind[0] + _PATIENCE[kind[1]], experiment, flags=re.MULTILINE)


def hasty(name, text):
    """A file of the page whose robot has less far to go in the time of whoever waits for it."""
    if name == "lab.toml":
        return text.replace("time_scale = 50.0", "time_scale = 400.0")
    return patient(text).replace("seconds = 0.04", "seconds = 0.005") if name == "experiment.toml" else text


@pytest.mark.slow
def test_the_page_on_the_laboratory_runs(tmp_path, monkeypatch):
    """Catches a key of a file that was renamed since, and a command that a reader cannot follow."""
    monkeypatch.chdir(tmp_path)
    laboratory = None
    ran = []
    try:
        for block in blocks(PAGE):
            if block.language == "toml":
                name = re.match(r"# (\w+\.toml)\n", block.text)
                assert name, block.place
                (tmp_path / name[1]).write_text(hasty(name[1], block.text), encoding="utf-8")
            elif block.language == "python":
                assert run_python(block, {}) == "96 steps\nTrue 14\n"
            elif block.language == "sh":
                for arguments in filter(None, map(command, block.text.splitlines())):
                    ran.append(arguments[0])
                    if "--demo" in arguments:
                        continue  # has a test of its own
                    if arguments[0] == "lab":
                        laboratory = background(arguments, tmp_path)
                    else:
                        said = sherkit(arguments, tmp_path)
                        if arguments[0] == "measure":
                            assert "96 of 96 steps" in said
    finally:
        if laboratory is not None:
            laboratory.send_signal(signal.SIGINT)
            laboratory.communicate(timeout=600)
    assert ran == ["lab", "lab", "plan", "home", "measure", "export", "calibrate", "measure"]


def test_names_on_the_page_are_the_codes(tmp_path):
    """Catches a fault or parameter that the page names and the laboratory does not know."""
    from sherkit.lab.emulators import FAULTS
    from sherkit.lab.experiment.file import names_of_poses
    from sherkit.lab.experiment.plan import ORDERS
    from sherkit.lab.kinds import INSTRUMENTS
    from sherkit.model.kinds import KINDS

    text = prose(PAGE) + "".join(b.text for b in blocks(PAGE))
    poses = [name for kind in KINDS.values() for name in names_of_poses(kind)]
    for name in (*FAULTS, *poses, *ORDERS, *INSTRUMENTS):
        assert name in text, name
    robot = next(b for b in blocks(PAGE) if b.text.startswith("# robot.toml"))
    (tmp_path / "robot.toml").write_text(robot.text, encoding="utf-8")
    model = DeltaModel(load_robot(tmp_path / "robot.toml"))
    example = re.search(r'as `"([\w.]+)" = 0.02`', prose(PAGE))
    assert example
    assert example[1] in {p.name for p in model.core_parameters}
