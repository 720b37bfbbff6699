"""The flexible force-sensing tool: a needle with Bragg gratings on a robot's flange, seen by a stereo camera.

Source: Ebrahimi et al., "Stochastic Force-based Insertion Depth and Tip Position Estimations of Flexible FBG-Equipped
Instruments in Robotic Retinal Surgery" (T-Mech 2020): a cantilever that the sclera pushes sideways, gratings at three
sections, nine wavelengths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import scipy
import tomli_w

import sherkit._core as _core

from ...base.notebook import Saved
from ...base.types import Floats
from ...data.columns import TIME
from ...data.declared import Declared, Inner, key
from ...data.files import write_whole
from ...data.toml import Table, read_toml
from ...errors import RobotError

# -- The columns of a run and of a load bench ---------------------------------------------------------------------

POSITION = ("robot_x_mm", "robot_y_mm", "robot_z_mm")
#: A rotation vector, tool to base.
TURN = ("robot_rx_rad", "robot_ry_rad", "robot_rz_rad")
#: Three fibres at each of the sections I, II, III.
FIBRES = tuple(f"fbg{k + 1}_nm" for k in range(9))
#: When the interrogator took the row's wavelengths, by the robot's clock; without the column, at the row's own time.
FIBRE_TIME = "fbg_time_s"
CAMERA = ("camera_x_mm", "camera_y_mm", "camera_z_mm")
#: The paper's l: from the hole to the unbent tip along the unbent axis; and the length of shaft beyond the hole.
DEPTH, ARC = "depth_mm", "arc_mm"
#: All of a run.
KNOWN = (TIME, *POSITION, *TURN, *FIBRES, FIBRE_TIME, *CAMERA, DEPTH)
#: Sclera force in the tool's frame, and the deflection at the contact along it.
FORCE = ("force_x_mn", "force_y_mn")
DEFLECTION = "deflection_mm"


@dataclass(frozen=True)
class OwnNames:
    """What a laboratory calls these columns in its files: pairs of our name and its own."""

    pairs: tuple[tuple[str, str], ...] = ()

    @classmethod
    def from_table(cls, table: Table) -> OwnNames:
        """Reads ``[columns]``."""
        known = (*KNOWN, *FORCE, ARC, DEFLECTION)
        return cls(tuple((name, said) for name in known if (said := table.words(name, ""))))

    def to_table(self) -> dict[str, str]:
        """What :meth:`from_table` reads."""
        return dict(self.pairs)


# -- The tool -----------------------------------------------------------------------------------------------------

Triple = tuple[float, float, float]

#: The key ``kind`` of its file.
KIND = "flexible_tool"
NOISES = ("propagated", "ebrahimi_2020", "ebrahimi_2020_of_force")
BENDINGS = ("exact", "small")
#: A moment of 1 mN·mm shifts the wavelength opposite to it by this, nm.
_SHIFT_NM_PER_MOMENT = 2.1e-4


def nested(values: Floats) -> Any:
    """An array as tuples of tuples, as a tool keeps it."""
    return tuple(nested(row) for row in values) if values.ndim > 1 else tuple(values.tolist())


def even_gains(turn_rad: float = 0.0) -> Floats:
    """Gains K (2, 3), mN·mm/nm, of a section whose three fibres stand evenly around the shaft."""
    angle = turn_rad + 2 * np.pi / 3 * np.arange(3)
    return 2.0 / (3.0 * _SHIFT_NM_PER_MOMENT) * np.stack([np.cos(angle), np.sin(angle)])


@dataclass(frozen=True)
class ToolDoubt:
    """What a calibration does not know; :func:`~sherkit.robots.tool.calibrate_tool` writes it into the tool file.

    ``depth`` (3, 3) is the covariance of θ where gains and sections put the depth off by θ₀ + θ₁ d/10 + θ₂ (d/10)², mm;
    ``deeper_mm`` the deviation of all depths alike (where the bench had its zero), ``turn_rad`` of the gratings' turn
    about the shaft against the robot's frame: both are learnt in a run. ``force`` is relative, ``beam`` (2, 2) the
    covariance of length (mm) and of the stiffness that the gratings' own force sees (mN·mm²), ``reference_nm`` the
    deviation of a reference wavelength, ``mean`` of what a bend leaves in the mean of three fibres, over the shift that
    it makes; ``unlike`` how unlike the fibres answer to warmth (deviation over the mean answer), ``warmth`` what is not
    known of the tool's own ``warmth``: as much, where nothing was learnt of it. ``depth`` and ``force`` are never
    averaged away (Schmidt 1966).
    """

    depth: tuple[Triple, Triple, Triple] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    beam: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    deeper_mm: float = 0.0
    turn_rad: float = 0.005
    force: float = 0.0
    reference_nm: float = 0.0
    mean: float = 0.02
    unlike: float = 0.02
    warmth: float = 0.02

    @classmethod
    def from_table(cls, table: Table) -> ToolDoubt:
        """Reads ``[doubt]``; what is not said is known, but for the turn and what fibres have by themselves."""
        d = cls()
        depth = table.numbers("depth", 9, (0.0,) * 9)
        beam = table.numbers("beam", 4, (0.0,) * 4)
        warmth = table.number("warmth", d.warmth, least=0.0)
        names = ("deeper_mm", "turn_rad", "force", "reference_nm", "mean")
        return cls(
            depth=nested(np.reshape(depth, (3, 3))),
            beam=nested(np.reshape(beam, (2, 2))),
            unlike=table.number("unlike", warmth, least=0.0),
            warmth=warmth,
            **{name: table.number(name, getattr(d, name), least=0.0) for name in names},
        )

    def to_table(self) -> dict[str, Any]:
        """What :meth:`from_table` reads, without loss."""
        return {**asdict(self), "depth": np.ravel(self.depth).tolist(), "beam": np.ravel(self.beam).tolist()}


@dataclass(frozen=True)
class FlexibleTool(Declared, Saved):
    """The tool as calibrated, and how the filters are to treat it.

    ``length_mm`` is the free length h, ``stiffness_mn_mm2`` the bending stiffness EI, ``distances_mm`` from the tip to
    the sections I and II, ``gains`` (2, 2, 3) K_I and K_II in mN·mm/nm, ``reference_nm`` (9,) the wavelengths of the
    unloaded tool (sections I, II, III, three fibres each), ``noise_nm`` the standard deviation of one, ``means`` (2, 2)
    what the mean of a section's three fibres answers to a moment, nm per mN·mm (with the gains: 3 × 2 answers a
    section), ``warmth`` (2, 3) how much more than its section's mean each fibre of I and II answers to warmth,
    relative. ``camera_*`` take
    the camera's frame to the base: x_base = R(``camera_rotation_rad``) x_camera + ``camera_translation_mm``; its clock
    stands ``camera_delay_s`` later than the robot's, and that of the fibres ``fibre_delay_s``. ``bending`` is
    ``"exact"``, an elastica, or ``"small"``, the paper's cantilever, which is off by 0.03 mm and more above 150 mN.
    A run starts at ``start_depth_mm`` within ``start_std_mm``; None where nobody knows: outside, or far inside.
    ``clearance_mm`` is how much wider than the shaft the hole is (radius), as far as that is known before it is felt.
    ``bench`` says how its table of loads is to be read, depth and force (see :mod:`.bench_fit`); ``"any"``: as fits
    best. ``names`` are those of the columns in its tables, where they are not ours.
    ``noise`` names what the filters trust:
    ``"propagated"`` follows the force and the calibration's ``doubt``, with ``per_second_mm2`` (depth, tip; the depth's
    is the least, faster motion of the eye is learnt) and, for the filters of Eqs. 8 and 14, ``floor_mm2``; the others
    are the paper's.
    """

    length_mm: float = 60.0
    stiffness_mn_mm2: float = 3.39e6 / 3.0
    distances_mm: tuple[float, float] = (40.0, 50.0)
    gains: tuple[tuple[Triple, Triple], tuple[Triple, Triple]] = (
        nested(even_gains()),
        nested(even_gains(0.02)),
    )
    reference_nm: tuple[float, ...] = (1531.0, 1531.2, 1530.9, 1545.1, 1545.0, 1544.8, 1559.0, 1559.1, 1558.9)
    noise_nm: float = 1e-3
    means: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    warmth: tuple[Triple, Triple] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    camera_rotation_rad: Triple = (0.0, 0.0, 0.0)
    camera_translation_mm: Triple = (0.0, 0.0, 0.0)
    camera_delay_s: float = 0.0
    camera_std_mm: float = 0.2
    noise: str = "propagated"
    per_second_mm2: tuple[float, float] = (0.01, 1.0)
    floor_mm2: tuple[float, float] = (0.01, 0.002)
    start_depth_mm: float = 0.0
    start_std_mm: float | None = None
    bending: str = "exact"
    fibre_delay_s: float = 0.0
    clearance_mm: float = 0.5
    clearance_std_mm: float = 1.0
    bench: tuple[str, str] = ("any", "any")
    doubt: ToolDoubt = ToolDoubt()
    names: OwnNames = OwnNames()
    kind: str = field(default=KIND, init=False)

    TABLES: ClassVar = {
        "shaft": {
            "length_mm": key(Table.number, positive=True).needed,
            "stiffness_mn_mm2": key(Table.number, positive=True).needed,
            "bending": key(Table.text, BENDINGS),
        },
        "gratings": {
            "distances_mm": key(Table.numbers, 2, positive=True).needed,
            "gain_I_x": key(Table.numbers, 3).of("gains", 0, 0).needed,
            "gain_I_y": key(Table.numbers, 3).of("gains", 0, 1).needed,
            "gain_II_x": key(Table.numbers, 3).of("gains", 1, 0).needed,
            "gain_II_y": key(Table.numbers, 3).of("gains", 1, 1).needed,
            "reference_nm": key(Table.numbers, 9, positive=True).needed,
            "noise_nm": key(Table.number, positive=True).needed,
            "mean_I": key(Table.numbers, 2).of("means", 0),
            "mean_II": key(Table.numbers, 2).of("means", 1),
            "warmth_I": key(Table.numbers, 3).of("warmth", 0),
            "warmth_II": key(Table.numbers, 3).of("warmth", 1),
            "delay_s": key(Table.number, least=0.0).of("fibre_delay_s"),
        },
        "camera": {
            "rotation_rad": key(Table.numbers, 3).of("camera_rotation_rad"),
            "translation_mm": key(Table.numbers, 3).of("camera_translation_mm"),
            "delay_s": key(Table.number).of("camera_delay_s"),
            "std_mm": key(Table.number, positive=True).of("camera_std_mm"),
        },
        "filter": {
            "noise": key(Table.text, NOISES),
            "per_second_mm2": key(Table.numbers, 2),
            "floor_mm2": key(Table.numbers, 2),
            "start_depth_mm": key(Table.number),
            "start_std_mm": key(Table.positive),
            "clearance_mm": key(Table.number, least=0.0),
            "clearance_std_mm": key(Table.number, least=0.0),
        },
        "bench": {
            "depth": key(Table.text, ("axis", "arc", "any")).of("bench", 0),
            "force": key(Table.text, ("across", "normal", "weight", "any")).of("bench", 1),
        },
        "doubt": Inner(ToolDoubt, "doubt"),
        "columns": Inner(OwnNames, "names"),
    }

    @classmethod
    def check(cls, name: str, table: Table, values: Mapping[str, Any]) -> None:
        """Refuses sections beyond the shaft, and noise below nothing."""
        if name == "gratings" and not values["distances_mm"][0] < values["distances_mm"][1] < values["length_mm"]:
            raise table.fail("distances_mm", f"I, then II, both less than length_mm = {values['length_mm']:g}")
        for one in ("per_second_mm2", "floor_mm2") if name == "filter" else ():
            if min(values[one]) < 0:
                raise table.fail(one, "2 numbers, none below zero")

    def __post_init__(self) -> None:
        _ = self.beam, self.sensor  # refuses numbers that are no tool
        for name, one, known in (("noise", self.noise, NOISES), ("bending", self.bending, BENDINGS)):
            if one not in known:
                raise RobotError(f"{name}: '{one}' is not known; choose {', '.join(known)}")
        if not self.fibre_delay_s >= 0.0:
            raise RobotError(
                f"[gratings] delay_s: {self.fibre_delay_s:g} s would be readings from the future; expected 0 or more. "
                "Where the robot's rows are late, put their time_s right"
            )

    def save(self, path: str | Path) -> None:
        """Writes a tool file that :func:`load_tool` reads."""
        write_whole(path, tomli_w.dumps(self.to_tables()))

    @property
    def columns(self) -> dict[str, str]:
        """What columns of its tables are called, by our names."""
        return self.names.to_table()

    # -- the compiled parts ------------------------------------------------------------------------------

    @cached_property
    def beam(self) -> _core.ToolBeam:
        """The shaft (Eq. 9)."""
        return _core.ToolBeam(self.length_mm, self.stiffness_mn_mm2, self.bending == "exact")

    @cached_property
    def sensor(self) -> _core.ToolSensor:
        """The gratings (Eqs. 1 and 2)."""
        gratings = (np.array(self.gains), np.array(self.distances_mm), np.array(self.reference_nm))
        return _core.ToolSensor(*gratings, self.noise_nm, self.beam)

    def tracker(self, time_s: float, pose: Floats) -> _core.ToolFilter:
        """The filter that a control loop runs, started at a time and a pose (12,)."""
        d = self.doubt
        doubts = (d.deeper_mm, d.turn_rad, d.force, d.reference_nm, d.mean, d.unlike, d.warmth, self.clearance_std_mm)
        return _core.ToolFilter(
            self.sensor, np.array(self.means), np.array(self.warmth), np.array(d.depth), np.array(d.beam), doubts,
            self.clearance_mm, self.per_second_mm2[0], self._start(time_s), np.ascontiguousarray(pose),
        )  # fmt: skip

    def paper_filter(self, time_s: float, pose: Floats) -> _core.PaperFilter:
        """The paper's own filters, started as :meth:`tracker`."""
        of_force = self.noise == "ebrahimi_2020_of_force"
        return _core.PaperFilter(self.sensor, self._start(time_s), np.ascontiguousarray(pose), of_force)

    def _start(self, time_s: float) -> tuple[float, float, float]:
        return self.start_depth_mm, self.start_known_mm**2, time_s

    @property
    def start_known_mm(self) -> float:
        """How well it is known where a run starts, as a standard deviation, mm: a third of the shaft where the file
        says nothing, so that the first force decides."""
        return self.length_mm / 3.0 if self.start_std_mm is None else self.start_std_mm

    def as_if_cold(self, wavelengths_nm: Floats) -> Floats:
        """Wavelengths (n, 9) without what warmth makes of the differences of unlike fibres."""
        rest = np.array(self.reference_nm)
        common = (wavelengths_nm - rest).reshape(-1, 3, 3).mean(axis=2)
        own = np.vstack([np.array(self.warmth), np.zeros(3)])
        return np.ascontiguousarray(wavelengths_nm - (common[:, :, None] * own).reshape(-1, 9))

    def with_noise(self, noise: str) -> FlexibleTool:
        """The same tool with filters that trust otherwise. Raises :class:`~sherkit.errors.RobotError`."""
        return replace(self, noise=noise)

    @property
    def camera_rotation(self) -> Floats:
        """The rotation (3, 3) from the camera's frame to the base."""
        return rotation_of(self.camera_rotation_rad)[0]

    def in_base(self, points_mm: Floats) -> Floats:
        """Points (n, 3) of the camera's frame in the robot's base."""
        return points_mm @ self.camera_rotation.T + np.array(self.camera_translation_mm)


def load_tool(path: str | Path) -> FlexibleTool:
    """Reads a tool from TOML. Raises :class:`~sherkit.errors.RobotError` naming file, table and key."""
    table = Table(read_toml(path, "tool"), str(path))
    table.text("kind", (KIND,))
    made = FlexibleTool.from_table(table)
    table.finish()
    return made


def rotation_of(vectors_rad: Sequence[float] | Floats) -> Floats:
    """Rotation matrices (n, 3, 3) of rotation vectors (n, 3)."""
    vectors = np.atleast_2d(np.asarray(vectors_rad, dtype=float))
    return np.asarray(scipy.spatial.transform.Rotation.from_rotvec(vectors).as_matrix())
