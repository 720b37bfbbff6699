"""The laboratory of a spherical robot: joints that turn, a camera that sees the marker, and the way back to α and β."""

from __future__ import annotations

import urllib.error
import urllib.request

import numpy as np
import pytest

pytest.importorskip("cv2")

from laboratories import experiment as delta_experiment
from laboratories import spherical_laboratory
from sherkit import identify
from sherkit.errors import Disconnected, ExperimentError, Garbled, InstrumentError, OutOfRange
from sherkit.lab.experiment import Live, RunFile, load_experiment, run
from sherkit.lab.instruments import Snapshots, VideoCamera
from sherkit.lab.laboratory import RunningLaboratory, load_laboratory


@pytest.fixture
def lab(tmp_path):
    with RunningLaboratory(load_laboratory(spherical_laboratory(tmp_path))) as running:
        running.write_ports(tmp_path / "ports.json")
        yield running


def test_the_camera_sees_the_hidden_robot(lab, tmp_path):
    """Catches a picture of the pose before, joints in degrees, pixels that are swapped, and a robot as drawn."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
        assert run(chosen.plan, bench, file) == "complete"
        data = file.measurements()
    assert data.layout.unit == "px"
    assert np.abs(data.joints - [s.joints for s in chosen.plan]).max() < 1e-4
    true = np.array([lab.bench.position(q, 0.0) for q in data.joints])
    seen = data.readings[:, :2] - true
    assert np.sqrt(np.mean(seen**2)) < 0.1
    drawn = lab.laboratory.robot
    fit = identify(drawn, data)
    hidden = lab.laboratory.virtual.errors
    for name in ("alpha", "beta"):
        found, std = fit.by_name[name], fit.std[[p.name for p in fit.parameters].index(name)]
        assert abs(found - hidden[name]) < max(6.0 * std, 5e-4), name
        assert abs(hidden[name]) > 0.01
    assert np.sqrt(np.nanmean(fit.residuals**2)) < 0.1


@pytest.mark.slow
def test_live_identification_speaks_of_pixels(lab, tmp_path):
    """Catches micrometres for pixels, and a goal whose key is that of another robot."""
    path = tmp_path / "experiment.toml"
    path.write_text(path.read_text() + "\n[goal]\nstd_px = 0.2\n")
    chosen = load_experiment(path)
    live = Live(chosen.robot, chosen.plan, chosen.goal)
    with RunFile.create(chosen.run_path, chosen.plan, chosen.about()) as file, chosen.bench() as bench:
        run(chosen.plan, bench, file, report=lambda now: live.add(now.point))
    assert live.enough
    assert "px (standard deviation)" in live.sentence()
    assert live.short().startswith("residual ")
    assert "px" in live.short()
    path.write_text(path.read_text().replace("std_px", "std_um"))
    with pytest.raises(ExperimentError, match="std_px"):
        load_experiment(path)


def test_a_picture_is_never_an_old_one(lab):
    """Catches a camera whose pictures come from a buffer: the row would be that of the pose before."""
    address = lab.ports()["eye"]["address"]
    with VideoCamera(address, source=lambda: Snapshots(address), discard=0) as camera:
        first = camera.grab().picture
        lab.world.set_joint(0, lambda _: float(lab.bench.home_joints[0]) + 0.05)
        second = camera.grab().picture
    assert first.shape == (640, 1280)
    assert np.abs(first.astype(int) - second.astype(int)).max() > 100


def test_a_camera_that_fails_is_told(lab, tmp_path):
    """Catches a picture that is cut, white or missing and is taken for one with a marker."""
    chosen = load_experiment(tmp_path / "experiment.toml")
    faults = lab.emulators["eye"].faults
    with chosen.bench() as bench:
        eye = bench.sensors[0].instrument
        assert np.isfinite(eye.read().values).all()
        faults.schedule("drop")
        # asked again, since that changes nothing
        assert np.isfinite(eye.read().values).all()
        for _ in range(12):
            faults.schedule("drop", _)
        with pytest.raises((Garbled, Disconnected)):
            eye.read()
        faults.clear()
        eye.connect()
        faults.schedule("over_range")
        with pytest.raises(OutOfRange, match="marker"):
            eye.read()
    with (
        pytest.raises(InstrumentError),
        VideoCamera("http://127.0.0.1:9/x.png", source=lambda: Snapshots("http://127.0.0.1:9/x.png", 1.0)),
    ):
        pass


def test_the_page_of_the_camera_shows_nothing_else(lab):
    """Catches a server that hands out files of this machine."""
    base = lab.ports()["eye"]["address"].rsplit("/", 1)[0]
    assert base.startswith("http://127.0.0.1:")
    for path in ("", "/", "/../../etc/hostname", "/snapshot.png/.."):
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(base + (path or "/"), timeout=600)


def test_a_spherical_robot_is_moved_by_its_own_words(lab, tmp_path):
    """Catches mm for a robot that turns, a line that the camera does not see, and joints without limits."""
    path = tmp_path / "experiment.toml"
    text = path.read_text()
    path.write_text(
        text.replace('poses = "patch"', 'poses = "line"\nline = "horizontal"\ncount = 9')
        .replace("per_side = 5\n", "")
        .replace("share = 0.8\n", "")
    )
    chosen = load_experiment(path)
    assert chosen.targets.shape == (9, 2)
    assert chosen.seconds > 0
    path.write_text(text.replace("counts_per_rad", "counts_per_mm"))
    with pytest.raises(ExperimentError, match="counts_per_rad"):
        load_experiment(path)
    path.write_text(text)
    robot = tmp_path / "robot.toml"
    robot.write_text(
        robot.read_text().replace("limits_deg", "home_deg").replace("[\n    -180.0,\n    270.0,\n]", "[0.0, 0.0]")
    )
    with pytest.raises(ExperimentError, match="limits_deg is missing"):
        load_experiment(path)
    delta_experiment(tmp_path)
    with pytest.raises(ExperimentError):
        load_experiment(path)
