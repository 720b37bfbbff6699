"""An arm from other descriptions of it: a table of Denavit-Hartenberg or Hayati parameters, or URDF.

Standard: ``Rz(θ) Tz(d) Tx(a) Rx(α)`` behind each joint (Denavit and Hartenberg, 1955; Paul, 1981); modified:
``Rx(α) Tx(a) Rz(θ) Tz(d)`` before it (Craig, 1986); Hayati, for an axis that is nearly parallel to the one before:
``Rz(θ) Tx(a) Rx(α) Ry(β)`` (Hayati and Mirmirani, 1985), here a standard row with a β, whose d is zero.

Read with Python's own XML parser: what is needed of URDF is a handful of attributes, and the libraries that read all of
it bring meshes and viewers with them. Lengths of URDF are m, angles rad (wiki.ros.org/urdf/XML).
"""

from __future__ import annotations

import csv
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, zip_longest
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from ...base.figures import brief, listed, nearest
from ...base.types import Floats
from ...data.tables import head_of
from ...errors import RobotError, ShapeError
from .frames import Triple, about, frame, of_rpy, placed, rpy_of_transform, triple
from .robot import MOST_JOINTS, TYPES, Joint, Serial, as_name

# -- Tables of parameters -----------------------------------------------------------------------------------------

CONVENTIONS = ("standard", "modified")
_NEEDED = ("d_mm", "a_mm", "alpha_deg")
_KNOWN = ("name", "type", "theta_deg", *_NEEDED, "beta_deg", "follows", "low", "high")
#: A row of this type moves nothing: it leads from the base to the first axis, or from the last one to the target.
_FIXED = "fixed"


def import_dh(path: str | Path, convention: str = "standard") -> Serial:
    """The arm of a CSV table, a row for each joint: ``d_mm``, ``a_mm``, ``alpha_deg``, and where they are not the same
    for all ``name``, ``type`` (revolute, prismatic, or ``fixed`` of a row that no joint moves), ``theta_deg`` (what is
    added to the reading), ``beta_deg`` (Hayati), ``follows`` (the part of the reading before it by which it moves
    besides), and the limits ``low`` and ``high`` (degrees, or mm of what slides).

    The target is the origin of the last frame. Raises :class:`~sherkit.errors.RobotError` with row and column.
    """
    if convention not in CONVENTIONS:
        raise RobotError(f"convention: '{convention}' is not known; choose {' or '.join(CONVENTIONS)}")
    rows = _rows(Path(path))
    folded, joints, named = np.eye(4), list[Joint](), dict[str, int]()
    for k, row in enumerate(rows, 1):
        moved = _Row(f"{path}: row {k}", row)
        d, a, *angles = (moved.number(name) for name in ("d_mm", "a_mm", "theta_deg", "alpha_deg", "beta_deg"))
        theta, alpha, beta = map(math.radians, angles)
        own = frame((0.0, 0.0, d), about(2, theta))
        link = frame((a, 0.0, 0.0), about(0, alpha) @ about(1, beta))
        if convention == "modified":
            folded = folded @ link @ own
        else:
            if beta and d:
                raise RobotError(f"{path}: row {k}: a row of Hayati (beta_deg) has no d_mm; put it to zero")
            folded = folded @ own
        if (kind := moved.type()) == _FIXED:
            folded = folded if convention == "modified" else folded @ link
            continue
        shift, turn = rpy_of_transform(folded)
        name, follows = moved.text("name") or f"joint_{len(joints) + 1}", moved.number("follows")
        if named.setdefault(name, k) != k:
            raise RobotError(
                f"{path}: row {k}: name: '{name}' is the joint of row {named[name]} already; name each once"
            )
        joints.append(Joint(name, kind, shift, turn, limits=moved.limits(), follows=follows))
        folded = np.eye(4) if convention == "modified" else link
    if not 1 <= len(joints) <= MOST_JOINTS:
        raise RobotError(f"{path}: expected one to {MOST_JOINTS} rows that a joint moves, found {len(joints)}")
    return _arm_of(path, joints, folded)


def read_in_the_other_convention(arm: Serial) -> Iterator[tuple[str, str, Serial]]:
    """The arms that a table gives which was read in the other convention, where the arm may come from a table: with the
    part of each row that moves with the joint on the wrong side of it."""
    rows = [_row_of(placed(joint.origin_mm, joint.rpy_deg)) for joint in arm.joints]
    if any(row is None for row in rows):
        return
    links, own = zip(*(row for row in rows if row is not None), strict=True)
    end, nothing = placed(arm.target_mm, arm.tool_rpy_deg), np.eye(4)
    # read as standard, a link stands behind its joint, as modified before it; a target of one's own hides the last
    last = end if _is_link(end) else frame((0.0, 0.0, 0.0), end[:3, :3])
    if _is_link(last):
        rest = nothing if _is_link(end) else frame(arm.target_mm, nothing[:3, :3])
        yield _read_as("standard", "modified", arm, (*links[1:], last), own, rest)
    yield _read_as("modified", "standard", arm, (nothing, *links[:-1]), own, links[-1] @ end)


def _read_as(
    read: str, meant: str, arm: Serial, links: Sequence[Floats], own: Sequence[Floats], end: Floats
) -> tuple[str, str, Serial]:
    made = [rpy_of_transform(link @ moved) for link, moved in zip(links, own, strict=True)]
    joints = [replace(one, origin_mm=shift, rpy_deg=turn) for one, (shift, turn) in zip(arm.joints, made, strict=True)]
    target, tool = rpy_of_transform(end)
    looks = f"the table of Denavit and Hartenberg behind the robot file looks {meant}, and was read as {read}"
    other = replace(arm, joints=tuple(joints), target_mm=target, tool_rpy_deg=tool)
    return looks, f"import it with the convention {meant}", other


def _is_link(made: Floats) -> bool:
    """Whether a transform is ``Tx(a) Rx(α)``."""
    row = _row_of(made)
    return row is not None and np.allclose(row[1], np.eye(4), atol=1e-6)


def _row_of(made: Floats) -> tuple[Floats, Floats] | None:
    """The two parts of ``Tx(a) Rx(α) Tz(d) Rz(θ)``; None for a transform that is no such product."""
    alpha, theta = np.arctan2(-made[1, 2], made[2, 2]), np.arctan2(-made[0, 1], made[0, 0])
    link = frame((made[0, 3], 0.0, 0.0), about(0, alpha))
    along = float(np.cos(alpha) * made[2, 3] - np.sin(alpha) * made[1, 3])
    own = frame((0.0, 0.0, along), about(2, theta))
    return (link, own) if np.allclose(link @ own, made, atol=1e-6) else None


class _Row:
    """A row of the table, every cell checked when it is asked for."""

    def __init__(self, where: str, cells: dict[str, str]) -> None:
        self.where, self.cells = where, cells

    def text(self, column: str) -> str:
        """Empty where the table has no such column, or no such cell."""
        return self.cells.get(column, "").strip()

    def number(self, column: str) -> float:
        """Zero where it is empty."""
        text = self.text(column)
        try:
            value = float(text) if text else 0.0
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise RobotError(f"{self.where}: {column}: expected a number, found '{brief(text)}'")
        return value

    def type(self) -> str:
        """Revolute unless it says otherwise."""
        found = self.text("type") or TYPES[0]
        if found not in (*TYPES, _FIXED):
            raise RobotError(f"{self.where}: type: expected {', '.join(TYPES)} or {_FIXED}, found '{found}'")
        return found

    def limits(self) -> tuple[float, float] | None:
        """None where the row names none."""
        if not (self.text("low") and self.text("high")):
            return None
        low, high = self.number("low"), self.number("high")
        if not low < high:
            raise RobotError(f"{self.where}: low: expected less than high, found {low:g} and {high:g}")
        return low, high


def _rows(path: Path) -> list[dict[str, str]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            head = head_of(str(path), enumerate(file, start=1))
            if head is None:
                raise RobotError(f"{path}: is empty; expected a table with a row for each joint")
            rows_below = (line for _, line in head.lines if not line.lstrip().startswith("#"))
            text = rows_below if head.called else chain([head.names], rows_below)
            cells = [row for row in csv.reader(text, skipinitialspace=True, delimiter=head.separator) if row]
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise RobotError(f"{path}: is no CSV table: {error}") from None
    names = [name.strip() for name in head.called or cells.pop(0)]
    if wide := [k for k, row in enumerate(cells, 1) if len(row) > len(names)]:
        raise RobotError(f"{path}: row {wide[0]} has more cells than there are columns; a comma for a point?")
    for name in names:
        if name not in _KNOWN:
            raise RobotError(
                f"{path}: column '{name}' is not known{nearest(name, _KNOWN)}; there are {listed(_KNOWN, 12)}"
            )
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise RobotError(f"{path}: column '{twice[0]}' is there twice")
    if lacking := [name for name in _NEEDED if name not in names]:
        raise RobotError(f"{path}: column {listed(lacking)} is missing")
    return [dict(zip_longest(names, row, fillvalue="")) for row in cells]


# -- URDF: the chain between two links, with what is fixed folded in and what hangs on each weighed ---------------

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
    ratios = tree.followed(chain)
    moving = [one for one in chain if one.kind in _MOVING and one.child not in ratios]
    if not moving:
        raise RobotError(f"{path}: no joint moves between '{base}' and '{tip}'; choose links at both ends of the arm")
    if len(moving) > MOST_JOINTS:
        raise RobotError(
            f"{path}: {len(moving)} joints move between '{base}' and '{tip}', an arm has at most {MOST_JOINTS}; "
            "choose links nearer to each other"
        )
    folded, joints, follows = np.eye(4), [], 0.0
    for one in chain:
        folded = folded @ one.origin
        if one.child in ratios:
            follows = ratios[one.child]
        elif one.kind in _MOVING:
            made = tree.joint(one, folded, [other.child for other in chain if other is not one])
            joints.append(replace(made, follows=follows))
            folded, follows = np.eye(4), 0.0
    return _arm_of(path, joints, folded)


def _arm_of(path: str | Path, joints: Sequence[Joint], folded: Floats) -> Serial:
    """The arm of these joints, its target ``folded`` (4, 4) away from the last. What makes no arm is said with its
    file."""
    target, turn = rpy_of_transform(folded)
    try:
        return Serial(tuple(joints), target, turn)
    except ShapeError as error:
        raise RobotError(f"{path}: {error}") from None


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
        return out[::-1]

    def followed(self, chain: Sequence[_Joint]) -> dict[str, float]:
        """Of joints that mimic the one before them, about the axis and in the place of the next one, by the link that
        each moves: the part of its reading, in both their units, by which that next one moves besides."""
        out: dict[str, float] = {}
        for k, one in enumerate(chain):
            if (mimic := one.element.find("mimic")) is None:
                continue
            before = [other for other in chain[:k] if other.kind in _MOVING and other.child not in out]
            behind = chain[k + 1 : k + 2]
            beside = behind and behind[0].kind in _MOVING and _MOVING[behind[0].kind] == _MOVING.get(one.kind)
            if not (
                before and beside and mimic.get("joint") == before[-1].name and behind[0].element.find("mimic") is None
                and np.allclose(behind[0].origin, np.eye(4), atol=1e-12)
                and np.allclose(self._axis(one), self._axis(behind[0]), atol=1e-12)
                and not self._numbers(mimic.get("offset", "0"), 1, f"'{one.name}': mimic offset")[0]
            ):  # fmt: skip
                raise RobotError(
                    f"{self.path}: joint '{one.name}' follows another (mimic): it has no reading of its own"
                )
            own, other = (_MM if _MOVING[which.kind] == "prismatic" else 1.0 for which in (one, before[-1]))
            ratio = self._numbers(mimic.get("multiplier", "1"), 1, f"'{one.name}': mimic multiplier")[0]
            out[one.child] = ratio * own / other
        return out

    def _axis(self, one: _Joint) -> Floats:
        """Its direction, of length one."""
        element = one.element.find("axis")
        axis = [1.0, 0.0, 0.0] if element is None else self._numbers(element.get("xyz"), 3, f"'{one.name}': axis")
        if not np.linalg.norm(axis) > 0:
            raise RobotError(f"{self.path}: joint '{one.name}': its axis has no direction")
        return np.array(axis) / np.linalg.norm(axis)

    def joint(self, one: _Joint, folded: Floats, others: list[str]) -> Joint:
        """A joint that moves, ``folded`` (4, 4) behind the one before it; ``others`` are links of the chain beside its
        own."""
        kind = _MOVING[one.kind]
        axis, limits = triple(self._axis(one)), None
        element = one.element.find("limit")
        if element is not None and one.kind != "continuous":
            low, high = (self._numbers(element.get(k), 1, f"'{one.name}': limit {k}")[0] for k in ("lower", "upper"))
            per = _MM if kind == "prismatic" else 180.0 / math.pi
            limits = (low * per, high * per) if low < high else None
        origin, rpy = rpy_of_transform(folded)
        mass, centre = self._weight(one.child, set(others))
        name = as_name(one.name, "joint")
        return Joint(name, kind, origin, rpy, axis, limits, 0.0, mass or None, centre if mass else (0.0, 0.0, 0.0))

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
        return mass, triple(moment / mass if mass else moment)
