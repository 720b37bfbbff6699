"""Exact forward kinematics: platform pose from the six rod-length constraints, by Newton."""

from __future__ import annotations

import numpy as np

from .geometry import Array, Robot, tangential

PLATFORM_WEIGHT_N = 5.0
TOLERANCE_MM = 1e-12
MAX_ITERATIONS = 40
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


def rod_residuals(
    robot: Robot, carriages: Array, mismatch: Array, compliance: Array, centre: Array, turn: Array
) -> tuple[Array, Array, Array]:
    """Rod length errors (n, 6) in mm at a trial pose, rod unit vectors and platform lever arms.

    Rod k of limb i joins C_i + k (s/2) e_t(pair_i) to c + R (p_i + k (s/2) e_t(pair_i)) and
    measures l_i + k m_i / 2 + c_i F_i, with k = +1 or -1 and the tension F_i of the trial pose.
    """
    half = 0.5 * robot.rod_spacing * ROD_SIGNS[None, :, None]
    joints = robot.platform_joints()
    pair = half * tangential(robot.pair_angle)[:, None]
    tops = carriages[:, :, None] + pair
    ends = joints[:, None] + pair
    turned_back = np.swapaxes(turn, 1, 2)
    levers = ends.reshape(6, 3) @ turned_back
    rods = tops.reshape(-1, 6, 3) - centre[:, None] - levers
    measured = np.sqrt(np.sum(rods**2, axis=-1))
    lengths = robot.rod_length[:, None] + 0.5 * mismatch[:, None] * ROD_SIGNS
    lengths = np.broadcast_to(lengths.ravel(), measured.shape)
    if np.any(compliance):
        limbs = carriages - centre[:, None] - joints @ turned_back
        tension = limb_tension(limbs / np.linalg.norm(limbs, axis=-1, keepdims=True))
        lengths = lengths + np.repeat(compliance * tension, 2, axis=1)
    return measured - lengths, rods / measured[..., None], levers


def solve_pose(robot: Robot, carriages: Array, mismatch: Array, compliance: Array) -> tuple[Array, Array]:
    """Platform centres (n, 3) in mm and rotation matrices (n, 3, 3) for carriages (n, 3, 3).

    ``mismatch`` (3) in mm and ``compliance`` (3) in mm/N are per limb. The Jacobian leaves out
    the sag's own tiny derivative: the residual keeps it, so the converged pose is still exact.
    """
    drop = np.sqrt(robot.rod_length**2 - (robot.base_radius - robot.platform_radius) ** 2)
    centre = np.zeros((len(carriages), 3))
    centre[:, 2] = np.mean(carriages[..., 2] - drop, axis=1)
    turn = np.tile(np.eye(3), (len(carriages), 1, 1))
    for _ in range(MAX_ITERATIONS):
        residual, axes, levers = rod_residuals(robot, carriages, mismatch, compliance, centre, turn)
        worst = np.max(np.abs(residual))
        if worst < TOLERANCE_MM:
            return centre, turn
        # d(length) = -u . dc - (lever x u) . dw, the turn composed from the left.
        jacobian = -np.concatenate([axes, np.cross(levers, axes)], axis=-1)
        step = np.linalg.solve(jacobian, -residual[..., None])[..., 0]
        centre = centre + step[:, :3]
        turn = rotation_matrix(step[:, 3:]) @ turn
    raise RuntimeError(f"Newton did not converge: worst rod error {worst:.1e} mm")
