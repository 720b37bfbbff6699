"""What a run says of itself that must hold before its depth is trusted: each check holds, fails, or is not told by it.

Innovations see no mistake that a filter can follow: it takes what contradicts the robot for an eye that strays. So the
streams are held against each other: the robot's motion and the depth that the gratings feel, the tip and the camera,
the nine gratings, the beginning and the tool file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy

from ...base.figures import listed
from ...base.types import Floats
from .alignment import at_times
from .consistency import NeesConsistency, knowledge, known_of
from .filters import Estimate, tracked
from .runs import ELSEWHERE_MM, ToolRun
from .tool import FIBRES, POSITION, TURN, FlexibleTool

_PUT_RIGHT, _AGAIN = "put that right, and estimate again", "use the other seconds, or measure again"


@dataclass(frozen=True)
class RunCheck:
    """``what`` must hold; ``holds`` is None where the run does not tell. What contradicts, and what to do then."""

    what: str
    holds: bool | None = True
    sentences: tuple[str, ...] = ()
    to_do: str = _PUT_RIGHT


def checks(e: Estimate, truths: list[NeesConsistency]) -> tuple[RunCheck, ...]:
    """All that a run is asked, the causes before what follows from them."""
    return (
        _robot(e), _columns(e, truths), _check("the run began where the tool file says", began(e)),
        _check("no stream froze", e.run.froze, _AGAIN),
        _check("no grating jumped", list(map(str, e.run.leaps.jumps)), "use the seconds before, or measure again"),
        _check("wavelengths scatter as the tool file says", _scatter(e)), _motion(e), _gratings(e), _camera(e, truths),
    )  # fmt: skip


def _check(what: str, sentences: list[str], to_do: str = _PUT_RIGHT) -> RunCheck:
    return RunCheck(what, not sentences, tuple(sentences), to_do)


# -- The robot beside the gratings ------------------------------------------------------------------------------------

#: Tool bent by so many times its usual noise, nm of the differences between fibres.
_BENT = 20.0


def _robot(e: Estimate) -> RunCheck:
    """Whether place and turn were recorded: neither is the same number all the time while the other moves, or the tool
    bends."""
    run, what = e.run, "the robot's pose was recorded"
    place, turn = (bool((values == values[0]).all()) for values in (run.position_mm, run.turn_rad))
    if not place:
        return RunCheck(what)
    if not turn:
        return RunCheck(what, False, (
            f"{listed(POSITION)} are the same in all rows, to the last digit, while the tool turned: their source "
            "froze (a topic that was not renewed, a column that was not written)",
        ), "record the robot's places, and measure again")  # fmt: skip
    waves = run.wavelengths_nm.reshape(-1, 3, 3)[:, :2]
    bends = waves - waves.mean(axis=2, keepdims=True)
    known = np.isfinite(bends).all(axis=(1, 2))
    if not known.any() or float(bends[known].std(axis=0).max()) < _BENT * e.tool.noise_nm:
        return RunCheck(what, None)
    return RunCheck(what, False, (
        "The robot's pose is the same in all rows, to the last digit, while the tool was bent: either its source "
        "froze, or it held still and the hole moved, and depth and tip know of neither",
    ), "look at what records the robot, and measure again")  # fmt: skip


#: Asked is where the depth by the gratings goes by so many of its deviations, and by so much, mm.
_GOES, _GOES_MM, _FINEST_MM = 4.0, 1.0, 0.05
#: The robot's motion along the shaft must leave less than this of it, or than as many deviations.
_LEAVES = 0.4
#: A robot that goes by less than this of the depth hardly moved; how many times less it is in metres, and how surely.
_HARDLY, _METRES, _ALIKE = 0.02, (500.0, 2000.0), 0.7
_LEAST_ROWS = 50


def _motion(e: Estimate) -> RunCheck:
    """Whether the depth by the gratings goes as the robot goes along the shaft, which it does through one hole."""
    run, what = e.run, "the robot's motion explains how the depth goes"
    std = e.fibre_depth_std_mm
    told = np.isfinite(e.fibre_depth_mm) & np.isfinite(std) & ~e.faulty_sections[:, :2].any(axis=1)
    # what a jump makes of the depth is said with it
    told &= run.time_s < min((one.at_s for one in run.leaps.jumps), default=np.inf)
    if told.sum() < _LEAST_ROWS or (run.position_mm == run.position_mm[0]).all():
        return RunCheck(what, None)
    weight = 1.0 / (std[told] ** 2 + _FINEST_MM**2)
    weight /= weight.sum()

    def spread(values: Floats) -> Floats:
        return np.asarray(values - weight @ values)

    along = np.einsum("ni,ni->n", run.position_mm - run.position_mm[0], run.rotations[:, :, 2])
    fibres = spread(e.fibre_depth_mm[told] + (e.together.value[:, 0] - e.arc_mm)[told])
    robot = spread(along[told])
    goes, moved, left = (float(np.sqrt(weight @ v**2)) for v in (fibres, robot, fibres - robot))
    known = _GOES * float(np.sqrt(weight @ std[told] ** 2))
    if goes < max(_GOES_MM, known):
        return RunCheck(what, None)
    if left < max(_LEAVES * goes, known):
        return RunCheck(what)
    alike = float(weight @ (fibres * robot)) / (goes * moved)
    if alike > _ALIKE and _METRES[0] < goes / moved < _METRES[1]:
        why = f"are {listed(POSITION)} in m? They are in mm"
    elif moved < _HARDLY * goes:
        why = f"were {listed(POSITION)} recorded, and in mm?"
    elif alike < -_ALIKE:
        why = f"it goes the other way: is one of {listed(POSITION)} turned round, or the tool's z, which is to the tip?"
    else:
        why = "is the tool file that of this tool, calibrated on its bench, and does the shaft go through one hole?"
    return RunCheck(what, False, (
        f"By the gratings the depth goes by ± {goes:.2g} mm, the robot's motion along the shaft by ± {moved:.2g} mm, "
        f"which leaves ± {left:.2g} mm of it: {why}",
    ))  # fmt: skip


# -- The gratings beside each other -----------------------------------------------------------------------------------

#: Readings that scatter by so many times noise_nm are none of those that the tool file is for.
_NOISIER = 2.0


def _scatter(e: Estimate) -> list[str]:
    scatter, known = e.run.leaps.scatter_nm, e.tool.noise_nm
    if not scatter > _NOISIER * known:
        return []
    return [
        f"Wavelengths scatter by {scatter:.2g} nm from reading to reading, and noise_nm of [gratings] is {known:.2g}: "
        "write there what this interrogator does"
    ]


#: So many gratings of a section that were left out at once leave nothing that the others check, in this part of the
#: run.
_AT_ONCE, _MOST = 2, 0.5


def _gratings(e: Estimate) -> RunCheck:
    """Whether the sections agree with the tool file in most of the run: one grating may be dead, not two of three."""
    read = np.isfinite(e.run.wavelengths_nm)
    out = e.left_out & read
    rows = read.any(axis=1)
    lost = (out.reshape(-1, 3, 3).sum(axis=2) >= _AT_ONCE)[rows].mean(axis=0) > _MOST
    share = out[rows].mean(axis=0)
    # gratings of different sections that fail at once are as many
    named = [name for k, name in enumerate(FIBRES) if share[k] > _MOST]
    what = "the gratings agree with the tool file"
    if not (lost.any() or len(named) > _AT_ONCE):
        return RunCheck(what)
    some = named or [name for k, name in enumerate(FIBRES) if lost[k // 3]]
    return RunCheck(what, False, (
        f"{listed(some)} are left out in {100 * float(out[rows].any(axis=1).mean()):.0f} % of the rows, and nothing "
        "checks what is left: is the tool file that of this tool, calibrated on its bench?",
    ))  # fmt: skip


# -- The tip beside the camera ----------------------------------------------------------------------------------------

#: A camera contradicts a tip that is further off than so many of its deviations, in half of the pictures.
_FAR = 2.5
#: Clocks are tried so far apart, s, in steps of a picture; one that takes this part away is named.
_LATEST_S, _TAKEN = 10.0, 0.5


def _camera(e: Estimate, truths: list[NeesConsistency]) -> RunCheck:
    """Whether the camera saw the tip where the estimate has it, within what both are stated to know."""
    what = "the camera sees the tip where it is estimated"
    tip = known_of(truths, "tip")
    if tip is None:
        return RunCheck(what, None)
    moments, seen = e.pictures
    off = _off(e, e.tip.value, moments, seen)
    if tip.verdict != "overconfident" or off < _FAR * e.tool.camera_std_mm:
        return RunCheck(what)
    best_s, best = _other_clock(e)
    if off > ELSEWHERE_MM:
        why = "is the tool file that of this tool, and its [camera] that of this camera? sherkit register finds it"
    elif best < (1.0 - _TAKEN) * off:
        late = "later" if best_s > 0.0 else "earlier"
        why = (
            f"with its clock {abs(best_s):.2g} s {late} than delay_s of [camera] says it is {best:.2g} mm; sherkit "
            "register finds the delay"
        )
    else:
        why = "are the robot's places and turns those of this run, and is [camera] still where it was registered?"
    return RunCheck(what, False, (
        f"The camera sees the tip {off:.3g} mm from where the estimate has it, in half of the pictures, "
        f"and {100 * tip.coverage:.0f} % of them within what is stated: {why}",
    ))  # fmt: skip


def _off(e: Estimate, tip_mm: Floats, moments: Floats, seen: Floats) -> float:
    """How far the tip (n, 3) is from where it was seen (k, 3), in half of the pictures, mm."""
    return float(np.median(np.linalg.norm(at_times(e.run.time_s, tip_mm, moments) - seen, axis=1)))


def _other_clock(e: Estimate) -> tuple[float, float]:
    """By how much later the camera's clock would stand for the tip to be nearest, s, and how near, mm."""
    moments, seen = e.pictures
    time, apart = e.run.time_s, float(np.median(np.diff(moments)))
    least = (0.0, np.inf)
    for late_s in np.arange(-_LATEST_S, _LATEST_S, apart):
        there = (moments - late_s >= time[0]) & (moments - late_s <= time[-1])
        if there.sum() > len(moments) // 2:
            least = min(least, (float(late_s), _off(e, e.tip.value, moments[there] - late_s, seen[there])),
                        key=lambda one: one[1])  # fmt: skip
    return least


# -- Columns of the robot that were exchanged: with each mistake undone ----------------------------------------------

#: Asked is where the tip stands further from the camera than so many of its deviations in half of the pictures, or one
#: picture by so many of those that are stated.
_SEEN_OFF, _ONE_OFF = 2.5, 4.5
#: With a mistake undone the tip must come this much nearer, and no further off than the others; or its squares fall by
#: this part, and what is left is as large as stated.
_NEARER, _NEAR, _SQUARES = 0.5, 4.0, 0.2


def _columns(e: Estimate, truths: list[NeesConsistency]) -> RunCheck:
    what = f"{POSITION[0]} … {TURN[-1]} mean what they are called"
    return _check(what, exchanged(e, truths) or across(e))


def _of_angles(order: str, run: ToolRun) -> ToolRun:
    """With turns that are three angles about the axes, in an order as scipy names it."""
    return replace(run, turn_rad=scipy.spatial.transform.Rotation.from_euler(order, run.turn_rad).as_rotvec())


def _about_shaft(turn_rad: float, run: ToolRun) -> ToolRun:
    """With the gratings turned about the shaft."""
    of, by = scipy.spatial.transform.Rotation, [0.0, 0.0, turn_rad]
    return replace(run, turn_rad=(of.from_rotvec(run.turn_rad) * of.from_rotvec(by)).as_rotvec())


_ANGLES = "robot_rx_rad, robot_ry_rad and robot_rz_rad are roll, pitch and yaw about axes that"
_ANYHOW: dict[str, Callable[[ToolRun], ToolRun]] = {
    "robot_x_mm and robot_y_mm are exchanged": lambda run: replace(run, position_mm=run.position_mm[:, [1, 0, 2]]),
    "robot_rx_rad, robot_ry_rad and robot_rz_rad are those of the inverse turn, base to tool": lambda run: replace(
        run, turn_rad=-run.turn_rad
    ),
    f"{_ANGLES} stand still, and no rotation vector": partial(_of_angles, "xyz"),
    f"{_ANGLES} turn with the tool, and no rotation vector": partial(_of_angles, "XYZ"),
    "the tool was mounted half a turn about its shaft from how it stood on the bench, or both forces of the bench have "
    "the other sign": partial(_about_shaft, np.pi),
    "the tool was mounted a quarter turn about its shaft from how it stood on the bench": partial(
        _about_shaft, 0.5 * np.pi
    ),
    "the tool was mounted a quarter turn about its shaft from how it stood on the bench, to the other side": partial(
        _about_shaft, -0.5 * np.pi
    ),
}


def _undone(tool: FlexibleTool) -> dict[str, Callable[[ToolRun], ToolRun]]:
    """Each mistake that a run may have with what undoes it."""
    said = f"{listed(POSITION)} are those of the flange, and not of the unbent tip {tool.length_mm:.3g} mm further on"
    return {**_ANYHOW, said: lambda run: run.further_on(tool.length_mm)}


def exchanged(e: Estimate, truths: list[NeesConsistency]) -> list[str]:
    """A sentence where the tip comes to where the camera saw it with such a mistake undone, and not without."""
    run, tool, tip = e.run, e.tool, known_of(truths, "tip")
    moments, seen = e.pictures
    if tip is None or len(moments) < 20:
        return []
    before = _off(e, e.together.value[:, 1:], moments, seen)
    far = before > _SEEN_OFF * tool.camera_std_mm
    if not (far or tip.verdict == "overconfident" or tip.largest > _ONE_OFF):
        return []
    rows = np.searchsorted(run.time_s, moments, side="right") - 1

    def squares(tip_mm: Floats) -> Floats:
        return np.asarray(((at_times(run.time_s, tip_mm, moments) - seen) ** 2).sum(axis=1))

    own, told = float(squares(e.together.value[:, 1:]).mean()), []
    for what, undone in _undone(tool).items():
        made = tracked(tool, undone(run))
        place, spread = made["state"][:, 1:], made["covariance"][rows][:, 1:, 1:]
        after = _off(e, place, moments, seen)
        off = at_times(run.time_s, place, moments) - seen
        stated = knowledge(off, spread, tool.camera_std_mm**2 / 3.0).verdict != "overconfident"
        nearer = after < _NEARER * before and after < _NEAR * tool.camera_std_mm
        if (far and nearer) or (stated and float(squares(place).mean()) < (1.0 - _SQUARES) * own):
            told.append(
                f"{run.source}: {what}: with that undone the tip is {after:.2f} mm from the camera's, now "
                f"{before:.2f} mm"
            )
    return told


#: Asked is where the hole strays faster across the shaft, mm/s; with a mistake undone by less than this part of it.
_STRAYS_MM_S, _STILL = 0.3, 0.4


def across(e: Estimate) -> list[str]:
    """A sentence where the hole stands still across the shaft with such a mistake undone, and else goes with the robot:
    what the gratings feel of it has a way, which no camera need see."""
    before = _strays(e.strays_mm_s)
    if before < _STRAYS_MM_S:
        return []
    told = {}
    for what, undone in _undone(e.tool).items():
        told[what] = _strays(np.sqrt(tracked(e.tool, undone(e.run))["inner"][:, 1]))
    what = min(told, key=lambda one: told[one])
    if told[what] > _STILL * before:
        return []
    return [
        f"{e.run.source}: {what}: with that undone the hole strays by {told[what]:.2g} mm/s across the shaft, now by "
        f"{before:.2g} mm/s"
    ]


def _strays(pace_mm_s: Floats) -> float:
    return float(np.median(pace_mm_s[len(pace_mm_s) // 5 :]))


# -- Where a run began, by its first forces, beside where the tool file says that it begins ---------------------------

#: The first forces are those of so long, s.
_FIRST_S = 3.0
#: Asked is where both differ by so many deviations; how far the hole stands aside puts the depth off by about so much
#: when the tool turns, mm.
_BEGAN_OFF, _ASIDE_MM = 4.0, 0.5
#: In one hole depths of the whole run differ from what these say by no more than this part of it.
_ONE_HOLE = 0.25


def began(e: Estimate) -> list[str]:
    """A sentence where the tool file says where runs begin, and the first forces say that this one did not."""
    run, tool = e.run, e.tool
    told = np.isfinite(e.fibre_depth_mm)
    if tool.start_std_mm is None or not told.any():
        return []
    told &= np.cumsum(told) <= max(1, round(_FIRST_S / run.step_s))
    last = int(np.flatnonzero(told)[-1])
    way = run.rotations[:, :, 2]
    hole = run.position_mm[0] - tool.start_depth_mm * way[0]
    carried = np.einsum("ni,ni->n", run.position_mm - hole, way)
    bent = e.together.value[:, 0] - e.arc_mm
    every = e.fibre_depth_mm + bent - carried
    off = every[told]
    # fibres that lag keep a share of the bends before, each its own; the lever is the longest, as the depth is in doubt
    near, far = tool.distances_mm
    size = np.linalg.norm(e.fibre_force_mn, axis=1)
    most = np.fmax.accumulate(np.where(np.isfinite(size), size, 0.0))
    lags = float(e.lags.max()) * (most / size)[told] * near * far / (far - near)
    variance = e.fibre_depth_std_mm[told] ** 2 + lags**2
    mean = float((off / variance).sum() / (1.0 / variance).sum())
    strays = tool.per_second_mm2[0] * float(run.time_s[last] - run.time_s[0])
    # what puts one depth off puts all of these seconds off
    sure = float(np.sqrt(tool.start_std_mm**2 + variance.min() + strays + _ASIDE_MM**2))
    # a shaft that is pressed elsewhere each time has no hole at which it began
    apart = float(np.nanmedian(np.abs(every - mean)))
    if abs(mean) < _BEGAN_OFF * sure or apart > _ONE_HOLE * abs(mean):
        return []
    where = tool.start_depth_mm + mean
    began_at = f"{where:.1f} mm inside" if where > 0.0 else f"{-where:.1f} mm before the hole"
    return [
        f"By its first forces {run.source} began {began_at}, and the tool file says {tool.start_depth_mm:g} ± "
        f"{tool.start_std_mm:g} mm: what is said before these forces is off by as much. Leave start_std_mm of [filter] "
        "out where nobody knows how deep a run begins, or write how deep this one did"
    ]
