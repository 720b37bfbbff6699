"""Machines with hidden errors, written apart from the examples and from the package: frames are matrices, every error
is a motion of its own, and runs come as files of columns. Nothing is where a convention has it: instruments stand
anywhere, zeros of joints are off, rows come in any order, columns under names of their own (:func:`foreign`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import polars as pl
from numpy.typing import NDArray

from sherkit.data.columns import LAYOUTS
from sherkit.model.kinds import KINDS, known_kinds

Floats = NDArray[np.float64]


def turn(axis: int, angle: float) -> Floats:
    """A rotation as a 4 × 4 matrix."""
    i, j = [k for k in range(3) if k != axis]
    if axis == 1:
        i, j = j, i
    out = np.eye(4)
    out[i, i] = out[j, j] = np.cos(angle)
    out[j, i], out[i, j] = np.sin(angle), -np.sin(angle)
    return out


def shift(x: float, y: float, z: float) -> Floats:
    """A translation as a 4 × 4 matrix."""
    out = np.eye(4)
    out[:3, 3] = x, y, z
    return out


@dataclass
class Hidden:
    """What is wrong with a machine, by the names of what does it."""

    sizes: Mapping[str, float] = field(default_factory=dict)

    def __getattr__(self, name: str) -> float:
        return float(self.sizes.get(name, 0.0))


def gantry(q: Floats, came: Floats, time_h: float, warm: float, h: Hidden) -> Floats:
    """Three rails, the second on the first and the third on the second; they lean by squarenesses."""
    x, y, z = q + 0.5 * h.play_mm * came
    turns = 2 * np.pi * x / h.sizes.get("ripple_period_mm", 7.3)
    x = x + h.ripple_mm * np.sin(turns + 0.4) + h.second_mm * np.sin(2 * turns + 1.1)
    y = y * (1 + h.pitch)
    # a rail that bends pitches what stands on it: once over its length
    x = x + h.bow_mm * (x / 200.0 - 1.0) ** 2
    # a rack in two pieces, of which the second has another pitch
    x = x + h.rack_mm * np.maximum(x - h.sizes.get("rack_from_mm", 150.0), 0.0) / 200.0
    frame = shift(x, 0, 0) @ turn(2, -4e-4 - h.square_xy) @ shift(0, y, 0) @ turn(0, h.square_yz) @ shift(0, 0, z)
    point = frame[:3, 3] * (1 + h.growth * warm)
    point[2] -= 2e-4 * point[0] + h.droop * (point[0] ** 2 + point[1] ** 2)
    return point + np.array([0.0, h.drift_mm_h * time_h, 0.0])


def scara(q: Floats, came: Floats, time_h: float, warm: float, h: Hidden) -> Floats:
    """Two arms and a quill."""
    first, second, quill = q + 0.5 * np.array([h.play_rad, h.play_rad, 0.0]) * came
    first = first + h.ring_rad * np.sin(first + 0.7) + h.ripple_rad * np.sin(50 * first + 0.3)
    quill = quill + h.quill_screw_mm * np.sin(2 * np.pi * quill / 12.0 + 0.9)
    # play that is more at one end, and a bump of the other joint
    first = first + 0.5 * h.worn_rad * came[0] * (q[0] + 1.5) / 3.0
    second = second + h.bump_rad * np.exp(-0.5 * ((q[1] - h.sizes.get("bump_at_rad", 1.3)) / 0.3) ** 2)
    second = second + h.belt * q[0] + h.oval_rad * np.cos(2 * second)
    reach = shift(250.4, 0, 0) @ turn(2, second) @ shift(199.7, 0, 0)
    frame = turn(2, first) @ reach @ turn(0, h.quill_lean) @ shift(0, 0, -quill)
    point = frame[:3, 3]
    point[2] -= h.droop * (point[0] ** 2 + point[1] ** 2)
    point = point * (1 + h.growth * warm)
    return point + np.array([0.0, h.drift_mm_h * time_h, 0.0])


def pan_tilt(q: Floats, came: Floats, time_h: float, warm: float, h: Hidden) -> Floats:
    """A mark on the wall through a pinhole; the head turns beneath it."""
    del warm
    pan = q[0] + h.ring_rad * np.sin(q[0]) + 0.5 * h.play_rad * came[0]
    tilt = q[1] + h.scale * q[1]
    looked = turn(0, tilt) @ turn(1, -pan) @ np.array([0.21, -0.11, 4.0, 1.0])
    u, v = 1512 * looked[0] / looked[2], 1512 * looked[1] / looked[2]
    return np.array([960 + u + h.drift_px_h * time_h, 540 + v])


#: How far off the zeros of joints may be. That of a pan is right: where the mark is tells it, and its owner gave that.
ZEROS = {"gantry": (1.0, 1.0, 1.0), "scara": (0.02, 0.01, 1.0), "pan_tilt": (0.0, 0.006)}
#: How far an instrument stands from the base at most, along each axis, mm.
FAR_MM = 300.0

#: By name: the machine, the columns of its joints and where they go, those of its readings, and the noise.
MACHINES: dict[str, tuple[Callable[..., Floats], dict[str, tuple[float, float]], tuple[str, ...], float]] = {
    "gantry": (
        gantry, {f"{a}_axis_mm": (0.0, end) for a, end in zip("xyz", (400.0, 300.0, 200.0), strict=True)},
        ("x_mm", "y_mm", "z_mm"), 0.005,
    ),
    "scara": (
        scara, {"shoulder_rad": (-1.5, 1.5), "elbow_rad": (0.4, 2.2), "quill_mm": (5.0, 145.0)},
        ("x_mm", "y_mm", "z_mm"), 0.01,
    ),
    "pan_tilt": (pan_tilt, {"pan_rad": (-0.38, 0.48), "tilt_rad": (-0.24, 0.19)}, ("u_px", "v_px"), 0.1),
}  # fmt: skip


def stand_of(seed: int) -> Floats:
    """Where an instrument sees a machine that somebody put somewhere: any turn, as a 4 × 4 matrix."""
    rng = np.random.default_rng([seed, 53])
    about_z, about_x = rng.uniform(-np.pi, np.pi, 2)
    return (
        shift(*rng.uniform(-FAR_MM, FAR_MM, 3))
        @ turn(2, about_z)
        @ turn(1, np.arcsin(rng.uniform(-1, 1)))
        @ turn(0, about_x)
    )


def zeros_of(name: str, seed: int) -> Floats:
    """Where the encoders of a machine have their zeros."""
    return np.random.default_rng([seed, 54]).uniform(-1.0, 1.0, len(ZEROS[name])) * ZEROS[name]


def seen_from(stand: Floats | None, points: Floats) -> Floats:
    """Points (n, 3) as an instrument sees them; None sees all as it is."""
    return points if stand is None else np.array([(stand @ [*p, 1.0])[:3] for p in points])


def run_of(
    name: str, seed: int, sizes: Mapping[str, float] | None = None, *, poses: int = 150, repeats: int = 2,
    stand: Floats | None = None, in_order: bool = False, exact: bool = False, still: int | None = None,
    places: Floats | None = None,
) -> pl.DataFrame:  # fmt: skip
    """A run of ``poses`` at random, ``repeats`` times in another order each time, ten seconds a row, in a room and by a
    clock that are drawn, from where ``stand`` sees it, by default anywhere, in any order unless ``in_order``, without
    noise if ``exact``. The joint of number ``still`` stands where it was first. ``places`` (poses, k) are taken instead
    of those drawn."""
    true, joints, readings, noise = MACHINES[name]
    rng = np.random.default_rng(seed)
    low, high = np.array(list(joints.values())).T
    drawn = rng.uniform(low, high, (poses, len(low)))
    places = drawn if places is None else places
    if still is not None:
        places[:, still] = places[0, still]
    pose = np.concatenate([rng.permutation(poses) for _ in range(repeats)])
    q = places[pose]
    time_s = 10.0 * np.arange(len(q))
    came = np.sign(np.diff(q, axis=0, prepend=q[:1]))
    # from where a machine came to its first row nobody is told
    came[0] = np.where(np.floor(1e4 * q[0]) % 2 == 0, 1.0, -1.0)
    room = np.random.default_rng([seed, 5])
    waves = room.uniform(0.4, 1.6)
    warmth = room.uniform(15, 28) + room.uniform(0.5, 3.0) * np.sin(
        2 * np.pi * (time_s / time_s[-1] * waves + room.uniform())
    )
    hidden = Hidden(sizes or {})
    # the first joint loses steps about the middle of the run; the stand is late by eight minutes
    lost, kicked = np.random.default_rng([seed, 55]).uniform([0.35, 0.55], [0.65, 0.75]) * time_s[-1]
    q = q + zeros_of(name, seed) + np.outer(time_s > lost, np.eye(len(low))[0]) * hidden.lost
    # the motors of the first two joints warm up
    q = q + np.outer(1 - np.exp(-4 * time_s / time_s[-1]), [1.0, -0.7, *np.zeros(len(low) - 2)]) * hidden.warm_motors
    late = np.full(len(time_s), warmth[0] - 20.0)
    for k in range(1, len(time_s)):
        now = 0.5 * (warmth[k - 1] + warmth[k]) - 20.0
        late[k] = now + (late[k - 1] - now) * np.exp(-(time_s[k] - time_s[k - 1]) / 480.0)
    seen = np.array([true(*row, hidden) for row in zip(q, came, time_s / 3600, warmth - 20, strict=True)])
    if seen.shape[1] == 3:
        seen = _knocked(seen, stand_of(seed) if stand is None else stand, time_s > kicked, hidden)
    seen += hidden.stand_per_c * np.outer(late, np.linspace(1.0, -0.6, seen.shape[1]))
    seen += (0.0 if exact else noise) * rng.normal(size=seen.shape)
    made = pl.DataFrame(
        {"time_s": time_s + room.uniform(-1e5, 1e5), "pose": pose + 1, "temperature_c": warmth}
        | dict(zip(joints, places[pose].T, strict=True))
        | dict(zip(readings, seen.T, strict=True))
    )
    return made if in_order else made[room.permutation(len(made))]


def _knocked(points: Floats, stand: Floats, since: NDArray[np.bool_], h: Hidden) -> Floats:
    """What the instrument shows; before some of the points somebody kicks the tripod."""
    after = shift(h.kick_mm, -h.kick_mm, 0.5 * h.kick_mm) @ stand @ turn(2, h.kick_rad) @ turn(0, 0.7 * h.kick_rad)
    return np.where(since[:, None], seen_from(after, points), seen_from(stand, points))


def foreign(frame: pl.DataFrame, name: str, seed: int) -> tuple[pl.DataFrame, dict[str, str]]:
    """A run with its columns in another order and under the names of somebody else, and those by the machine's."""
    _, joints, readings, _ = MACHINES[name]
    rng = np.random.default_rng([seed, 55])
    theirs = {f"Ch{k} {word}" for k, word in enumerate(("cmd", "ist", "pos", "Soll", "ball", "raw"))}
    columns = dict(zip((*joints, *readings), rng.permutation(sorted(theirs)).tolist(), strict=False))
    return frame.rename(columns).select(rng.permutation(list(frame.rename(columns).columns)).tolist()), columns


@contextmanager
def apart() -> Iterator[None]:
    """What machines make known is forgotten at the end: other tests must not meet them."""
    kinds, layouts = dict(known_kinds()), list(LAYOUTS)
    try:
        yield
    finally:
        KINDS.clear()
        KINDS.update(kinds)
        LAYOUTS[:] = layouts
