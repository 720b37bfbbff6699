"""An arm from URDF: the chain of joints between two links, with what is fixed folded in and what hangs on each weighed.

Read with Python's own XML parser: what is needed of URDF is a handful of attributes, and the libraries that read all of
it bring meshes and viewers with them. Lengths of URDF are m, angles rad (wiki.ros.org/urdf/XML).
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from ...base.names import listed, nearest
from ...base.types import Floats
from ...errors import RobotError
from .frames import Triple, as_written, frame, of_rpy
from .robot import MOST_JOINTS, Joint, Serial

_MM = 1000.0
_MOVING = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}


def import_urdf(path: str | Path, base: str | None = None, tip: str | None = None) -> Serial:
    """The arm from link ``base`` (left out: the root) to link ``tip`` (left out: the only end there is), whose frame's
    origin is the target.

    Masses and their centres are those of everything that moves with a joint and not with the next, side branches at
    zero. Raises :class:`~sherkit.errors.RobotError` for what is no URDF or no such arm.
    """
    tree = _Tree(Path(path))
    base = tree.root if base is None else tree.require(base, "base")
    tip = tree.only_end() if tip is None else tree.require(tip, "tip")
    chain = tree.between(base, tip)
    moving = [one for one in chain if one.kind in _MOVING]
    if not moving:
        raise RobotError(f"{path}: no joint moves between '{base}' and '{tip}'; choose links at both ends of the arm")
    if len(moving) > MOST_JOINTS:
        raise RobotError(
            f"{path}: {len(moving)} joints move between '{base}' and '{tip}', an arm has at most {MOST_JOINTS}; "
            "choose links nearer to each other"
        )
    folded, joints = np.eye(4), []
    for one in chain:
        folded = folded @ one.origin
        if one.kind in _MOVING:
            joints.append(tree.joint(one, folded, [other.child for other in chain if other is not one]))
            folded = np.eye(4)
    target, turn = as_written(folded)
    return Serial(tuple(joints), target, turn)


@dataclass(frozen=True, eq=False)
class _Joint:
    """A joint as URDF has it: ``origin`` (4, 4), mm, from the frame of its parent link."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Floats
    element: Element


class _Tree:
    """Links and joints of a file, every number checked when it is asked for."""

    def __init__(self, path: Path) -> None:
        self.path = path
        root = self._read()
        self.links = {self._name(one): one for one in root.iterfind("link")}
        self.to: dict[str, _Joint] = {}
        for one in root.iterfind("joint"):
            made = self._joint(one)
            if made.child in self.to:
                raise RobotError(f"{path}: link '{made.child}' is the child of two joints")
            self.to[made.child] = made
        roots = [name for name in self.links if name not in self.to]
        if len(roots) != 1:
            raise RobotError(f"{path}: expected one link that is the child of no joint, found {len(roots)}")
        self.root = roots[0]

    def _read(self) -> Element:
        path = self.path
        try:
            text = path.read_bytes()
        except OSError as error:
            raise RobotError(f"{path}: cannot be read: {error.strerror}") from None
        if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
            raise RobotError(f"{path}: holds a DOCTYPE, which no URDF needs; take it out")
        xacro = f"{path}: is a xacro, which is a program; let it write its URDF: xacro {path.name} > robot.urdf"
        try:
            root = ElementTree.fromstring(text)
        except (ElementTree.ParseError, ValueError, LookupError) as error:  # an encoding that nobody knows is looked up
            raise RobotError(xacro if b"<xacro:" in text else f"{path}: is no XML: {error}") from None
        if path.suffix == ".xacro" or any("/xacro}" in one.tag for one in root.iter()):
            raise RobotError(xacro)
        if root.tag != "robot":
            raise RobotError(f"{path}: is no URDF: expected <robot>, found <{root.tag}>")
        return root

    def _name(self, element: Element) -> str:
        name = element.get("name")
        if not name:
            raise RobotError(f"{self.path}: a <{element.tag}> has no name")
        return name

    def _joint(self, element: Element) -> _Joint:
        name = self._name(element)
        parent, child = (self._end(element, name, which) for which in ("parent", "child"))
        return _Joint(name, element.get("type", ""), parent, child, self._origin(element, name), element)

    def _end(self, element: Element, name: str, which: str) -> str:
        one = element.find(which)
        link = None if one is None else one.get("link")
        if link is None or link not in self.links:
            raise RobotError(f"{self.path}: joint '{name}': its {which} '{link}' is no link of the file")
        return link

    def _numbers(self, text: str | None, count: int, where: str) -> list[float]:
        if text is None:
            return [0.0] * count
        try:
            numbers = [float(one) for one in text.split()]
        except ValueError:
            numbers = []
        if len(numbers) != count or not all(math.isfinite(one) for one in numbers):
            raise RobotError(f"{self.path}: {where}: expected {count} numbers, found '{text[:60]}'")
        return numbers

    def _origin(self, element: Element, name: str) -> Floats:
        origin = element.find("origin")
        if origin is None:
            return np.eye(4)
        shift = self._numbers(origin.get("xyz"), 3, f"'{name}': origin xyz")
        return frame([_MM * v for v in shift], of_rpy(self._numbers(origin.get("rpy"), 3, f"'{name}': origin rpy")))

    def require(self, link: str, which: str) -> str:
        """A link of the file by its name."""
        if link not in self.links:
            raise RobotError(f"{self.path}: {which}: '{link}' is no link of the file{nearest(link, self.links)}")
        return link

    def only_end(self) -> str:
        """The link that has no children, where there is one alone."""
        parents = {one.parent for one in self.to.values()}
        ends = [name for name in self.links if name not in parents]
        if len(ends) != 1:
            raise RobotError(f"{self.path}: name the link at the end of the arm (--tip): there are {listed(ends, 12)}")
        return ends[0]

    def _up(self, link: str) -> Iterator[_Joint]:
        """The joints from a link to the root."""
        for _ in self.links:
            if link not in self.to:
                return
            yield self.to[link]
            link = self.to[link].parent
        raise RobotError(f"{self.path}: the joints run in a circle")

    def between(self, base: str, tip: str) -> list[_Joint]:
        """The joints from one link to another that hangs on it."""
        out: list[_Joint] = []
        if base != tip:
            for one in self._up(tip):
                out.append(one)
                if one.parent == base:
                    break
            else:
                raise RobotError(
                    f"{self.path}: '{tip}' does not hang on '{base}'; exchange them, or choose another base"
                )
        for one in out:
            if one.kind not in (*_MOVING, "fixed"):
                raise RobotError(
                    f"{self.path}: joint '{one.name}' is {one.kind or 'of no type'}; an arm turns or slides"
                )
            if one.element.find("mimic") is not None:
                raise RobotError(
                    f"{self.path}: joint '{one.name}' follows another (mimic): it has no reading of its own"
                )
        return out[::-1]

    def joint(self, one: _Joint, folded: Floats, others: list[str]) -> Joint:
        """A joint that moves, ``folded`` (4, 4) behind the one before it; ``others`` are links of the chain beside its
        own."""
        kind = _MOVING[one.kind]
        element = one.element.find("axis")
        axis = [1.0, 0.0, 0.0] if element is None else self._numbers(element.get("xyz"), 3, f"'{one.name}': axis")
        if not np.linalg.norm(axis) > 0:
            raise RobotError(f"{self.path}: joint '{one.name}': its axis has no direction")
        limits = None
        element = one.element.find("limit")
        if element is not None and one.kind != "continuous":
            low, high = (self._numbers(element.get(k), 1, f"'{one.name}': limit {k}")[0] for k in ("lower", "upper"))
            per = _MM if kind == "prismatic" else 180.0 / math.pi
            limits = (low * per, high * per) if low < high else None
        origin, rpy = as_written(folded)
        mass, centre = self._weight(one.child, set(others))
        name = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "_" for c in one.name)
        name = name if name[:1].isalpha() else f"joint_{name}"
        axes = (axis[0], axis[1], axis[2])
        return Joint(name, kind, origin, rpy, axes, limits, 0.0, mass or None, centre if mass else (0.0, 0.0, 0.0))

    def _weight(self, link: str, others: set[str]) -> tuple[float, Triple]:
        """Mass, kg, and its centre, mm, of all that hangs on a link but what the next joint of the chain moves."""
        mass, moment = 0.0, np.zeros(3)
        todo = [(link, np.eye(4))]
        while todo:
            name, where = todo.pop()
            inertial = self.links[name].find("inertial")
            element = None if inertial is None else inertial.find("mass")
            if inertial is not None and element is not None:
                own = self._numbers(element.get("value"), 1, f"'{name}': mass")[0]
                mass += own
                moment += own * (where @ self._origin(inertial, name))[:3, 3]
            for one in self.to.values():
                # what is fixed to this link moves with it, in the chain or beside it
                if one.parent == name and (one.child not in others or one.kind == "fixed"):
                    todo.append((one.child, where @ one.origin))
        centre = moment / mass if mass else moment
        return mass, (float(centre[0]), float(centre[1]), float(centre[2]))
