"""An arm as other programs read it: URDF, xacro, a table of Denavit and Hartenberg, the kinematics of UR's driver.

Each is read back by its own way in (:mod:`.imported`, a YAML reader): the same poses to the last digits of a double.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import polars as pl

from ...base import linalg
from ...base.types import Floats
from ...errors import RobotError
from .frames import about, frame, placed, rpy_of, rpy_of_transform
from .robot import Joint, Serial, as_name

_MM = 1000.0

# -- URDF -----------------------------------------------------------------------------------------------------------

#: The links at both ends.
BASE_LINK, TOOL_LINK = "base", "tool"
#: What URDF asks for of a joint that has limits, and nobody here knows: ROS takes them for N·m and rad/s.
_EFFORT, _SPEED = "1000", "3"


def urdf(arm: Serial, name: str = "arm") -> str:
    """The arm as URDF: links ``base``, one for each joint, ``tool``, whose origin is the target.

    A joint that follows the one before it has two: one that mimics that joint, then its own. Masses are those of the
    file; inertias, which it has not, are zero.
    """
    robot = Element("robot", name=as_name(name, "arm"))
    robot.extend(_elements(arm, ""))
    return _text(robot)


def xacro(arm: Serial, name: str = "arm") -> str:
    """The same as a xacro: a macro of this name with a prefix for all links and joints, called once with that of the
    argument ``prefix``, empty by default."""
    ElementTree.register_namespace("xacro", _XACRO)
    own = as_name(name, "arm")
    robot = Element("robot", name=own)
    SubElement(robot, f"{{{_XACRO}}}arg", name="prefix", default="")
    SubElement(robot, f"{{{_XACRO}}}macro", name=own, params="prefix").extend(_elements(arm, "${prefix}"))
    SubElement(robot, f"{{{_XACRO}}}{own}", prefix="$(arg prefix)")
    return _text(robot)


_XACRO = "http://www.ros.org/wiki/xacro"


def _text(root: Element) -> str:
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _elements(arm: Serial, prefix: str) -> Iterator[Element]:
    taken, parent, before = {joint.name for joint in arm.joints}, BASE_LINK, None
    yield Element("link", name=prefix + BASE_LINK)
    for joint in arm.joints:
        origin = placed(joint.origin_mm, joint.rpy_deg)
        if joint.follows and before is not None:
            between = _free(f"{joint.name}_follows", taken)
            yield Element("link", name=f"{prefix}{between}_link")
            made = _joint(prefix, between, _sort(joint), parent, f"{between}_link", origin)
            _axis(made, joint, *sorted(joint.follows * one for one in before.range))
            per = joint.follows * (_MM if before.slides else 1.0) / (_MM if joint.slides else 1.0)
            SubElement(made, "mimic", joint=prefix + before.name, multiplier=repr(per), offset="0")
            yield made
            origin, parent = np.eye(4), f"{between}_link"
        link = Element("link", name=f"{prefix}{joint.name}_link")
        if joint.mass_kg:
            _weigh(link, joint)
        yield link
        made = _joint(prefix, joint.name, _sort(joint), parent, f"{joint.name}_link", origin)
        _axis(made, joint, *joint.range)
        yield made
        parent, before = f"{joint.name}_link", joint
    end = placed(arm.target_mm, arm.tool_rpy_deg)
    yield Element("link", name=prefix + TOOL_LINK)
    yield _joint(prefix, _free(TOOL_LINK, taken), "fixed", parent, TOOL_LINK, end)


def _free(name: str, taken: set[str]) -> str:
    """A name that no joint has yet."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _sort(joint: Joint) -> str:
    return "prismatic" if joint.slides else "continuous" if joint.limits is None else "revolute"


def _joint(prefix: str, name: str, sort: str, parent: str, child: str, origin: Floats) -> Element:
    made = Element("joint", name=prefix + name, type=sort)
    SubElement(made, "parent", link=prefix + parent)
    SubElement(made, "child", link=prefix + child)
    xyz, rpy = origin[:3, 3] / _MM, rpy_of(origin[:3, :3])
    SubElement(made, "origin", xyz=_numbers(xyz), rpy=_numbers(rpy))
    return made


def _axis(made: Element, joint: Joint, low: float, high: float) -> None:
    """Axis and limits of what moves."""
    axis = np.array(joint.axis, dtype=float)
    SubElement(made, "axis", xyz=_numbers(axis / np.linalg.norm(axis)))
    if made.get("type") != "continuous":
        per = _MM if joint.slides else 1.0
        limits = {"lower": repr(low / per), "upper": repr(high / per)}
        SubElement(made, "limit", limits | {"effort": _EFFORT, "velocity": _SPEED})


def _weigh(link: Element, joint: Joint) -> None:
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_numbers(np.array(joint.centre_mm) / _MM), rpy="0 0 0")
    SubElement(inertial, "mass", value=repr(float(joint.mass_kg or 0.0)))
    SubElement(inertial, "inertia", dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0"))


def _numbers(values: Sequence[float] | Floats) -> str:
    """Without loss, and no zero that is negative."""
    return " ".join(repr(float(v) + 0.0) for v in values)


# -- Denavit and Hartenberg --------------------------------------------------------------------------------------

#: Axes that lean by less from one another, rad, are told by a row of Hayati: the foot of their common normal would lie
#: far away.
_PARALLEL = 0.05
#: A distance that is none, mm.
_SAME = 1e-9


@dataclass(frozen=True)
class _Link:
    """A transform as ``Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)``, and what a turn and a shift along its own z leave
    for the next."""

    theta: float
    d: float
    a: float
    alpha: float
    beta: float
    left: Floats


def dh_table(arm: Serial, convention: str = "standard") -> pl.DataFrame:
    """The arm as a table of :func:`~.imported.import_dh`: a row for each joint, before and behind them a ``fixed`` one
    that leads from the base to the first axis and from the last one to the target."""
    rows, carried = [], np.eye(4)
    for step in arm.steps:
        found = _link_of(carried @ step)
        rows.append(found)
        carried = found.left
    rows.append(_Link(math.atan2(carried[1, 0], carried[0, 0]), float(carried[2, 3]), 0.0, 0.0, 0.0, np.eye(4)))
    # standard: a link stands behind its joint, modified: before it; that of the last row is none
    links = rows if convention == "standard" else [rows[-1], *rows[:-1]]
    made: list[dict[str, Any]] = []
    for joint, own, link in zip((None, *arm.joints, None), rows, links, strict=True):
        made.append(
            {
                "name": joint.name if joint else "base" if own is rows[0] else "tool",
                "type": joint.type if joint else "fixed",
                "theta_deg": math.degrees(own.theta),
                "d_mm": own.d,
                "a_mm": link.a,
                "alpha_deg": math.degrees(link.alpha),
                "beta_deg": math.degrees(link.beta),
                "follows": joint.follows if joint else 0.0,
                "low": joint.limits[0] if joint and joint.limits else None,
                "high": joint.limits[1] if joint and joint.limits else None,
            }
        )
    # no zero that is negative
    table = (
        pl.DataFrame(made).with_columns(pl.col("low", "high").cast(pl.Float64)).with_columns(pl.col(pl.Float64) + 0.0)
    )
    return table if any(joint.follows for joint in arm.joints) else table.drop("follows")


def _link_of(step: Floats) -> _Link:
    """The link to a line in space, the z of a frame (4, 4), and what then leads along it to that frame."""
    along, point = step[:3, 2], step[:3, 3]
    across = np.array([-along[1], along[0], 0.0])
    if np.linalg.norm(across) > _PARALLEL:
        normal = across / np.linalg.norm(across)
        # of the two ends of the normal that which turns less
        normal = -normal if normal[0] < -_SAME or (abs(normal[0]) <= _SAME and normal[1] < 0) else normal
        theta = math.atan2(normal[1], normal[0])
        alpha = math.atan2(float(np.cross((0.0, 0.0, 1.0), along) @ normal), float(along[2]))
        d, a, _ = linalg.solve(np.column_stack([(0.0, 0.0, 1.0), normal, along]), point).tolist()
        beta = 0.0
    else:
        x, y = (point - along * point[2] / along[2])[:2].tolist()
        d, a = 0.0, math.hypot(x, y)
        theta = math.atan2(y, x) if a > _SAME else 0.0
        if abs(theta) > 0.5 * math.pi + _SAME:
            theta, a = theta - math.copysign(math.pi, theta), -a
        leaning = about(2, -theta) @ along
        beta = math.asin(float(np.clip(leaning[0], -1.0, 1.0)))
        alpha = math.atan2(-leaning[1], leaning[2])
    made = frame((0.0, 0.0, d), about(2, theta)) @ frame((a, 0.0, 0.0), about(0, alpha) @ about(1, beta))
    turn = made[:3, :3].T
    return _Link(theta, d, a, alpha, beta, frame((turn @ (point - made[:3, 3])).tolist(), turn @ step[:3, :3]))


# -- The kinematics of UR's driver -------------------------------------------------------------------------------

#: What UR's description calls what its six joints move.
_UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")


def kinematics_yaml(arm: Serial, name: str = "arm") -> str:
    """The arm as the ``kinematics.yaml`` of ``ur_description``: where each joint stands behind the one before it, m and
    rad, each about or along its own z. Six joints are called as UR calls them, others by their own names.

    Raises :class:`~sherkit.errors.RobotError` for a joint that follows another.
    """
    if followers := [joint.name for joint in arm.joints if joint.follows]:
        raise RobotError(f"joint '{followers[0]}' follows the one before it, which kinematics.yaml has no key for")
    called = _UR_LINKS if len(arm.joints) == len(_UR_LINKS) else [joint.name for joint in arm.joints]
    lines = []
    for link, step in zip(called, arm.steps, strict=False):
        shift, turn = rpy_of_transform(step)
        cells = (*(v / _MM for v in shift), *np.deg2rad(turn).tolist())
        lines.append(f"  {link}:")
        lines += [f"    {key}: {_yaml(cell)}" for key, cell in zip(_KEYS, cells, strict=True)]
    digits = int.from_bytes(hashlib.sha256("\n".join(lines).encode()).digest()[:8], "big")
    what = "as identified by sherkit; m and rad, each joint about or along its z. The tool is not in it."
    return "\n".join([f"# {as_name(name, 'arm')}: {what}", "kinematics:", *lines, f"  hash: calib_{digits}", ""])


def _yaml(value: float) -> str:
    """A number as every YAML reads it as one: with a point, also before an exponent, whose sign stands there."""
    mantissa, e, power = repr(float(value) + 0.0).partition("e")
    whole = mantissa if "." in mantissa else f"{mantissa}.0"
    return f"{whole}e{int(power):+d}" if e else whole
