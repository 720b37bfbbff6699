"""The cameras that a robot file may have meant: a pose is written in more than one way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ...base.types import Floats
from .robot import CameraView, Spherical

_MEANT = "x_camera = R x_base + t is meant"


def camera_written_otherwise(robot: Spherical) -> Iterator[tuple[str, str, Spherical]]:
    """The robots whose camera was written from the camera to the base, as OpenCV does not, or in degrees: what looks
    wrong, what to write, and the robot as it would be then."""
    camera = robot.camera
    if camera is None:
        return
    turn, shift = Rotation.from_rotvec(camera.rotation_rad), np.array(camera.translation_mm)
    back, forth = turn.inv(), "that from the camera to the base"
    here, place = "of [camera] in the robot file", "the camera's place in the base"
    for looks, is_turn, is_shift in (
        (f"rotation_rad {here} looks like {forth}", back, shift),
        (f"rotation_rad and translation_mm {here} look like {forth}", back, -back.apply(shift)),
        (f"translation_mm {here} looks like {place}", turn, -turn.apply(shift)),
    ):
        yield from _as_meant(robot, camera, f"{looks}, where {_MEANT}", is_turn.as_rotvec(), is_shift)
    looks = f"rotation_rad {here} looks like degrees"
    yield from _as_meant(robot, camera, looks, np.deg2rad(camera.rotation_rad), shift)


def _as_meant(
    robot: Spherical, camera: CameraView, looks: str, rotation_rad: Floats, translation_mm: Floats
) -> Iterator[tuple[str, str, Spherical]]:
    """The robot with this pose of its camera, unless it is the one that it has."""
    poses = {"rotation_rad": rotation_rad, "translation_mm": translation_mm}
    changed = {key: value for key, value in poses.items() if not np.allclose(value, getattr(camera, key), atol=1e-9)}
    if changed:
        told = "; ".join(f"{key} = [{', '.join(_plain(v) for v in value)}]" for key, value in changed.items())
        meant = replace(camera, **{key: tuple(value.tolist()) for key, value in changed.items()})  # type: ignore[arg-type]
        yield looks, f"write {told}", replace(robot, camera=meant)


def _plain(value: float) -> str:
    """Six digits; what is but rounding is none."""
    return f"{round(value, 9) + 0.0:.6g}"
