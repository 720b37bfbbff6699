"""The compiled spherical robot and its camera: shapes, names, errors, and that its solver finds what was planted."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sherkit import _core
from sherkit.errors import NotFinite, NotSeen, OutOfReach, RobotError, ShapeError, Singular

Floats = NDArray[np.float64]

ARC = 0.7854
GEOMETRY = np.array([ARC, ARC, 0.0, ARC, ARC, 0.0])
INTRINSICS = np.array([1100.0, 1100.0, 640.0, 320.0])
CAMERA = _core.Camera.facing(math.pi / 2, math.pi / 4, 446.2, INTRINSICS)
SETTINGS = np.array([200.0, 0.0, 0.6, -0.8, 0.0, 0.0])


def plan(n: int = 400, seed: int = 1) -> Floats:
    """Joint readings over the paper's quarter sphere."""
    random = np.random.default_rng(seed)
    mean, half = random.uniform(0.9, 2.2, n), random.uniform(0.4, 1.3, n)
    return np.stack([mean + half, mean - half], axis=1)


#: Where the parameters of each effect stand.
PLACES: dict[str, list[int]] = {}
for _row in _core.SphericalModel.CATALOGUE:
    _start = sum(map(len, PLACES.values()))
    PLACES[_row["name"]] = list(range(_start, _start + len(_row["parameters"])))
COUNT = _core.SphericalModel.PARAMETERS


def rows(joints: Floats, **more: Any) -> Any:
    return (joints, None, more.get("covariates"), more.get("push"))


def test_batches_are_the_single_poses_and_mark_what_has_no_answer() -> None:
    """Catches rows and columns swapped, a mark on the wrong row, a remainder of a block of lanes left out."""
    k = _core.SphericalKinematics(GEOMETRY)
    joints = np.vstack([plan(21), [[1.0, 1.0], [np.nan, 0.0]], [[2.1e6, 2.1e6 - 1.2]]])
    angles, reached = k.forward_batch(joints)
    assert reached.tolist() == [True] * 21 + [False, False, True]
    assert np.isnan(angles[~reached]).all()
    for q, a in zip(joints[reached], angles[reached], strict=True):
        np.testing.assert_array_equal(k.forward(q), a)
        np.testing.assert_allclose(k.inverse(a), q, atol=1e-9 if abs(q[0]) > 100 else 1e-12)
    back, reached = k.inverse_batch(angles[:21])
    assert reached.all()
    np.testing.assert_allclose(back, joints[:21], atol=1e-12)
    by_joints, by_parameters, _ = k.derivatives_batch(joints[:21])
    of_joints, of_parameters, _ = k.inverse_derivatives_batch(joints[:21])
    np.testing.assert_allclose(of_joints @ by_joints, np.broadcast_to(np.eye(2), (21, 2, 2)), atol=1e-9)
    np.testing.assert_allclose(of_joints @ by_parameters, -of_parameters, atol=1e-9)


def test_errors_say_what_is_wrong() -> None:
    """Catches a panic, or an error of the wrong kind."""
    k = _core.SphericalKinematics(np.array([0.9, 0.6, 0.0, 0.9, 0.6, 0.0]))
    with pytest.raises(OutOfReach, match="cannot meet") as apart:
        k.forward(np.array([1.5, -1.5]))
    assert apart.value.limb == 0
    assert apart.value.miss_rad > 0
    assert math.isnan(apart.value.miss_mm)
    with pytest.raises(OutOfReach, match=r"for limb 1 the tool axis is 0\.100000 rad too far from") as far:
        k.inverse(np.array([0.0, 1.6]))
    assert far.value.limb == 1
    with pytest.raises(OutOfReach, match="too near to"):
        k.inverse(np.array([0.0, 0.2]))
    with pytest.raises(OutOfReach, match="other assembly"):
        k.inverse(np.array([0.0, 0.4]))
    with pytest.raises(Singular, match="elbow axes coincide"):
        k.forward(np.array([1.0, 1.0]))
    with pytest.raises(NotFinite):
        k.forward(np.array([1.0, np.nan]))
    with pytest.raises(RobotError, match="limb 2: beta"):
        _core.SphericalKinematics(np.array([0.9, 0.6, 0.0, 0.9, 4.0, 0.0]))
    with pytest.raises(ShapeError, match="elbows"):
        k.inverse(np.array([0.0, 1.0]), "sideways")
    camera = _core.Camera(CAMERA)
    with pytest.raises(NotSeen, match="behind the camera"):
        camera.project(1000.0 * camera.position)
    with pytest.raises(NotSeen, match="misses the sphere"):
        camera.angles(np.array([3000.0, 320.0]), 200.0)
    folded = CAMERA.copy()
    folded[4] = -1.0
    with pytest.raises(NotSeen, match="folds over"):
        _core.Camera(folded).undistort(np.array([3000.0, 320.0]))
    with pytest.raises(RobotError, match="focal"):
        _core.Camera(np.zeros(15))
    with pytest.raises(ShapeError, match="readings"):
        _core.SphericalModel(GEOMETRY, CAMERA, SETTINGS, readings="words")
    model = _core.SphericalModel(GEOMETRY, CAMERA, SETTINGS)
    with pytest.raises(ShapeError, match="reads no distances"):
        model.predict(np.zeros(COUNT), (plan(3), plan(3), None, None))
    with pytest.raises(ShapeError, match="covariates"):
        model.predict(np.zeros(COUNT), rows(plan(3), covariates=np.zeros((3, 5))))
    with pytest.raises(ShapeError, match="free"):
        model.derivatives(np.zeros(COUNT), rows(plan(3)), [COUNT])


def test_pixels_lead_back_to_angles() -> None:
    """Catches a chain, a camera and a kinematics that do not mean the same frame."""
    joints = plan(50)
    model = _core.SphericalModel(GEOMETRY, CAMERA, SETTINGS)
    readings, reached = model.predict(np.zeros(COUNT), rows(joints))
    assert reached.all()
    camera = _core.Camera(CAMERA)
    angles, seen = camera.angles_batch(readings, 200.0)
    expected, _ = _core.SphericalKinematics(GEOMETRY).forward_batch(joints)
    # the side of the sphere that faces the camera: the line of sight enters it there
    markers, _ = model.markers(np.zeros(COUNT), rows(joints))
    near = markers @ camera.position > 200.0**2
    assert seen[near].all()
    assert near.sum() > 30
    np.testing.assert_allclose(angles[near], expected[near], atol=1e-9)
    direct, _ = model.reading("angles").predict(np.zeros(COUNT), rows(joints))
    np.testing.assert_allclose(direct, expected, atol=1e-12)


@pytest.mark.parametrize("kind", ["pixels", "angles", "inverse"])
def test_the_solver_finds_what_was_planted(kind: str) -> None:
    """Catches a residual or a derivative of the wrong sign, and readings of the wrong columns."""
    planted = np.zeros(COUNT)
    planted[:3] = [-0.022, 0.0183, 10.0]
    free = [0, 1] if kind == "angles" else [0, 1, 2]
    if kind != "angles":
        planted[PLACES["lens_distortion"][2:]] = [1e-3, -1e-3]
    else:
        free += PLACES["datum"]
        planted[PLACES["datum"]] = [0.01, -0.02]
    if kind == "pixels":
        free += PLACES["unequal_limbs"] + PLACES["marker_offset"]
        planted[PLACES["unequal_limbs"]] = [0.004, -0.003]
        planted[PLACES["marker_offset"]] = [0.7, -1.1]
    model = _core.SphericalModel(GEOMETRY, CAMERA, SETTINGS, readings="angles" if kind == "angles" else "pixels")
    joints = plan()
    if kind == "inverse":
        # away from the edge of the sphere and from stretched limbs, so that every row has an inverse at the start too
        markers, _ = model.markers(planted, rows(joints))
        inside = (markers @ _core.Camera(CAMERA).position > 1.3 * 200.0**2) & (joints[:, 0] - joints[:, 1] > 1.4)
        joints = np.ascontiguousarray(joints[inside])
        assert len(joints) > 50
    block = rows(joints)
    readings, reached = model.predict(planted, block)
    assert reached.all()
    start = planted.copy()
    start[free] = 0.0
    solver = _core.Solver(np.zeros(len(free)), np.full(len(free), 0.01))
    if kind == "inverse":
        weights = np.full((len(readings), 2), 1e3)
        how, missing = model.solve_inverse(solver, start, free, block, readings, weights)
    else:
        how, missing = model.solve(solver, start, free, block, readings, np.ones_like(readings))
    assert (how, missing) == ("converged", [])
    np.testing.assert_allclose(solver.result()["values"], planted[free], atol=1e-8)


def test_the_papers_figures() -> None:
    """Catches another root of Eq. 33. The paper prints its distance and no lens: these angles follow from it."""
    for degrees, region in [(26.90, "half"), (17.31, "quarter")]:
        found = _core.spherical_camera_placement(200.0, math.radians(degrees), 5.0, region)
        assert found["distance_mm"] == pytest.approx(446.2, abs=0.1)
