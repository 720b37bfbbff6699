"""A camera on a pan-tilt head that looks at one mark on the wall: where the mark is seen tells where the head looks."""

import numpy as np

import sherkit as sk

MARK_M = np.array([0.2, -0.1, 4.0])  # in the head's frame, by a tape measure


def forward(q, p):
    """Where the mark is seen, px."""
    x, y, z = MARK_M[0] + p.mark_x, MARK_M[1] + p.mark_y, MARK_M[2]
    pan, tilt = q[:, 0], q[:, 1] + p.tilt_zero
    x, z = x * np.cos(pan) - z * np.sin(pan), x * np.sin(pan) + z * np.cos(pan)
    x, y = x + p.axes_skew * y, y - p.axes_skew * x  # the tilt axis is not square to the pan axis
    y, z = y * np.cos(tilt) - z * np.sin(tilt), y * np.sin(tilt) + z * np.cos(tilt)
    focal = 1500 * (1 + p.focal)
    return np.stack([960 + focal * (x + p.roll * y) / z, 540 + focal * (y - p.roll * x) / z], axis=1)


machine = sk.Machine(
    forward,
    joints={"pan_rad": (-0.4, 0.5), "tilt_rad": (-0.25, 0.2)},
    readings=("u_px", "v_px"),
    parameters={
        "mark_x": ("m", 0.02), "mark_y": ("m", 0.02), "tilt_zero": ("rad", 0.01), "axes_skew": ("rad", 2e-3),
        "roll": ("rad", 0.01), "focal": ("", 0.01),
    },
)  # fmt: skip
