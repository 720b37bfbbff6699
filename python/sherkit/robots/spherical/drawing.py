"""The spherical robot as it is drawn: two limbs of two arcs each about the remote centre, tool, marker and camera."""

from __future__ import annotations

import numpy as np

from ...base.types import Floats
from ...data import Measurements
from ...model.drawing import Drawing, DrawnPart, line, with_target
from .model import SphericalModel
from .robot import SPHERICAL_ANGLES

#: Arcs are drawn on spheres of these parts of the marker's radius: proximal ones inside distal ones.
_PROXIMAL, _DISTAL = 0.62, 0.8
_STEPS = 17
#: How long the camera is drawn, by its distance from the centre.
_CAMERA = 0.16


def drawing(model: SphericalModel, data: Measurements, values: Floats, readings: Floats | None = None) -> Drawing:
    """The robot at each row, or with ``readings`` (n, m) as what is read. Raises as
    :meth:`~sherkit.model.chain.ChainModel.predict`."""
    points = model.parts(data, values)
    pole, near_1, elbow_1, near_2, elbow_2, centre, end, marker, target = np.moveaxis(points, 1, 0)
    read = model.predict(data, values) if readings is None else readings
    by_angles = data.layout == SPHERICAL_ANGLES
    shown = model.robot.point(read[:, :2]) if by_angles else _on_the_drawn_sphere(model, read, target)
    parts = [
        DrawnPart("actuated axis", "axis", line(-0.25 * pole, 1.15 * pole)),
        DrawnPart("circle of the base", "guide", _circle(float(np.linalg.norm(pole[0])) * _PROXIMAL)),
    ]
    for k, (near, elbow) in enumerate([(near_1, elbow_1), (near_2, elbow_2)], 1):
        axis = elbow - near
        parts += [
            DrawnPart(f"proximal link {k}", "link", _arc(pole, axis, _PROXIMAL) + near[:, None]),
            DrawnPart(f"elbow axis {k}", "axis", line(near, elbow)),
            DrawnPart(f"distal link {k}", "rod", _arc(axis, end - centre, _DISTAL) + 0.5 * (near + centre)[:, None]),
            DrawnPart(f"elbow {k}", "joint", line(near + _DISTAL * axis)),
        ]
    parts += [
        DrawnPart("tool", "platform", line(centre, end)),
        DrawnPart("from the tool's axis to the marker", "ray", line(end, marker, target)),
        DrawnPart("remote centre", "joint", line(centre)),
        *([] if by_angles else _camera(model, values)),
    ]
    return with_target(parts, target, shown)


def _arc(start: Floats, end: Floats, scale: float) -> Floats:
    """Great circles (n, k, 3) from directions to others, on a sphere of ``scale`` times the length of the latter."""
    radius = scale * np.linalg.norm(end, axis=1)[:, None, None]
    a, b = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (start, end))
    angle = np.arccos(np.clip((a * b).sum(axis=1), -1.0, 1.0))[:, None, None].clip(1e-9)
    t = np.linspace(0.0, 1.0, _STEPS)[None, :, None]
    mixed = np.sin((1.0 - t) * angle) * a[:, None] + np.sin(t * angle) * b[:, None]
    return np.asarray(radius * mixed / np.sin(angle))


def _circle(radius: float) -> Floats:
    turn = np.linspace(0.0, 2.0 * np.pi, 4 * _STEPS)
    return radius * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))])[None]


def _on_the_drawn_sphere(model: SphericalModel, pixels: Floats, markers: Floats) -> Floats:
    """Where the camera of the drawing sees pixels (n, 2) as points (n, 3) of the sphere of the drawing; beyond its edge
    as far away as the marker is."""
    camera, radius, pixels = model.robot.seen.core, model.robot.radius_mm, np.ascontiguousarray(pixels[:, :2])
    found, there = camera.on_sphere_batch(pixels, radius)
    if not there.all():
        rays, _ = camera.undistort_batch(pixels)
        ways = np.column_stack([rays, np.ones(len(rays))]) @ camera.rotation
        far = np.linalg.norm(markers - camera.position, axis=1)
        straight = camera.position + ways * (far / np.linalg.norm(ways, axis=1))[:, None]
        found = np.where(there[:, None], found, straight)
    return found


def _camera(model: SphericalModel, values: Floats) -> list[DrawnPart]:
    """The camera with its errors: its centre, and a picture before it."""
    view, camera = model.robot.seen, model.camera_with(values)
    far = _CAMERA * float(np.linalg.norm(view.core.position))
    size, focal = np.array(view.size_px, dtype=float), np.array(view.focal_px)
    corners = (np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) * size - np.array(view.centre_px)) / focal
    eye = camera.position
    picture = eye + far * np.column_stack([corners, np.ones(5)]) @ camera.rotation
    return [
        DrawnPart("picture of the camera", "sensor", picture[None]),
        DrawnPart("camera", "sensor", line(picture[0], eye, picture[1], eye, picture[2], eye, picture[3])),
        DrawnPart("where the camera looks", "guide", line(eye, eye + 5.0 * far * camera.rotation[2])),
    ]
