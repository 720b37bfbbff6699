"""Exact forward kinematics: platform pose from the six rod-length constraints, by Newton."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .geometry import Array, Robot, tangential

PLATFORM_WEIGHT_N = 5.0
TOLERANCE_MM = 1e-12
MAX_ITERATIONS = 40
ROUNDS = 6
ROD_SIGNS = np.array([1.0, -1.0])  # the two rods of a limb, at +e_t and -e_t


def rotation_matrix(vector: Array) -> Array:
    """Rodrigues: rotation vectors (n, 3) in rad to matrices (n, 3, 3)."""
    angle = np.linalg.norm(vector, axis=-1)[:, None, None]
    skew = np.zeros((len(vector), 3, 3))
    skew[:, [2, 0, 1], [1, 2, 0]] = vector
    skew[:, [1, 2, 0], [2, 0, 1]] = -vector
    # sinc forms stay exact as the angle goes to zero.
    sine = np.sinc(angle / np.pi)
    versine = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.eye(3) + sine * skew + versine * (skew @ skew)


def limb_tension(axes: Array) -> Array:
    """Axial forces F (n, 3) in N with sum F_i u_i = (0, 0, W); u_i = axes[:, i], unit vectors
    from platform joint to carriage. Tension is positive."""
    load = np.array([[0.0], [0.0], [PLATFORM_WEIGHT_N]])
    return np.linalg.solve(np.swapaxes(axes, 1, 2), load)[..., 0]


@dataclass(frozen=True)
class Limbs:
    """What is wrong with the limbs and their drives, one value per limb; zero is the ideal robot.

    ``mismatch`` mm, ``compliance`` of a limb along itself mm/N, ``twist`` rad, ``drive`` compliance of a carriage
    along its rail mm/N, whose direction is ``rail`` (3, 3).
    """

    mismatch: Array = field(default_factory=lambda: np.zeros(3))
    compliance: Array = field(default_factory=lambda: np.zeros(3))
    twist: Array = field(default_factory=lambda: np.zeros(3))
    drive: Array = field(default_factory=lambda: np.zeros(3))
    rail: Array = field(default_factory=lambda: np.tile([0.0, 0.0, 1.0], (3, 1)))


def limb_axes(robot: Robot, carriages: Array, centre: Array, turn: Array) -> Array:
    """Unit vectors (n, 3, 3) from the middle of each platform joint to its carriage."""
    limbs = carriages - centre[:, None] - robot.platform_joints() @ np.swapaxes(turn, 1, 2)
    return limbs / np.linalg.norm(limbs, axis=-1, keepdims=True)


def given_way(robot: Robot, limbs: Limbs, carriages: Array, centre: Array, turn: Array) -> tuple[Array, Array]:
    """Where the loaded carriages stand (n, 3, 3) and the limbs' tensions (n, 3), at a pose.

    The limb pulls its carriage with -F u; the part of it along the rail moves the carriage by the drive's compliance.
    The limb's line depends on where the carriage has gone: each round leaves about a thousandth of the way.
    """
    loaded = carriages
    for _ in range(ROUNDS if limbs.drive.any() else 1):
        axes = limb_axes(robot, loaded, centre, turn)
        tension = limb_tension(axes)
        pull = -tension * np.sum(axes * limbs.rail, axis=-1)
        loaded = carriages + (limbs.drive * pull)[..., None] * limbs.rail
    return loaded, tension


def rod_residuals(
    robot: Robot, carriages: Array, limbs: Limbs, centre: Array, turn: Array
) -> tuple[Array, Array, Array]:
    """Rod length errors (n, 6) in mm at a trial pose, rod unit vectors and platform lever arms.

    Rod k of limb i joins C_i + k (s/2) e_t(pair_i + twist_i) to c + R (p_i + k (s/2) e_t(pair_i)) and
    measures l_i + k m_i / 2 + c_i F_i, with k = +1 or -1 and the tension F_i of the trial pose. C_i has given way.
    """
    half = 0.5 * robot.rod_spacing * ROD_SIGNS[None, :, None]
    joints = robot.platform_joints()
    loaded = np.any(limbs.compliance) or np.any(limbs.drive)
    tension = np.zeros(carriages.shape[:2])
    if loaded:
        carriages, tension = given_way(robot, limbs, carriages, centre, turn)
    tops = carriages[:, :, None] + half * tangential(robot.pair_angle + limbs.twist)[:, None]
    ends = joints[:, None] + half * tangential(robot.pair_angle)[:, None]
    turned_back = np.swapaxes(turn, 1, 2)
    sensitivities = ends.reshape(6, 3) @ turned_back
    rods = tops.reshape(-1, 6, 3) - centre[:, None] - sensitivities
    measured = np.sqrt(np.sum(rods**2, axis=-1))
    lengths = robot.rod_length[:, None] + 0.5 * limbs.mismatch[:, None] * ROD_SIGNS
    lengths = lengths.ravel() + np.repeat(limbs.compliance * tension, 2, axis=1)
    return measured - lengths, rods / measured[..., None], sensitivities


def solve_pose(robot: Robot, carriages: Array, limbs: Limbs) -> tuple[Array, Array]:
    """Platform centres (n, 3) in mm and rotation matrices (n, 3, 3) for unloaded carriages (n, 3, 3).

    The Jacobian leaves out the tiny derivatives of what the loads do: the residual keeps them, so the converged pose
    is still exact.
    """
    drop = np.sqrt(robot.rod_length**2 - (robot.base_radius - robot.platform_radius) ** 2)
    centre = np.zeros((len(carriages), 3))
    centre[:, 2] = np.mean(carriages[..., 2] - drop, axis=1)
    turn = np.tile(np.eye(3), (len(carriages), 1, 1))
    for _ in range(MAX_ITERATIONS):
        residual, axes, sensitivities = rod_residuals(robot, carriages, limbs, centre, turn)
        worst = np.max(np.abs(residual))
        if worst < TOLERANCE_MM:
            return centre, turn
        # d(length) = -u . dc - (lever x u) . dw, the turn composed from the left.
        jacobian = -np.concatenate([axes, np.cross(sensitivities, axes)], axis=-1)
        step = np.linalg.solve(jacobian, -residual[..., None])[..., 0]
        centre = centre + step[:, :3]
        turn = rotation_matrix(step[:, 3:]) @ turn
    raise RuntimeError(f"Newton did not converge: worst rod error {worst:.1e} mm")
