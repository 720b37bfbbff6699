"""A printer examined: what is wrong, how sure that is, what to do, what accuracy remains, what to measure next.

For somebody who has a probe and a screwdriver. What the sentences rest on is a diagnosis and the suspects behind it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from ...base.answer import AFTER, BEFORE, FILES, Answer, Bar, ToDo
from ...base.figures import listed
from ...base.types import Floats
from ...diagnosis import Diagnosis, diagnose
from ...fit.forms import known
from ...fit.identify import Fit, residuals
from . import import_duet, import_klipper, import_marlin
from .calibration import FirmwareFit, commands, held, told
from .gcode import words
from .hypotheses import Suspect, plain_fit, suspects, turns
from .klipper import text_of
from .lengths import BOWL_MM, lengths_of, size_by_bowl, size_of
from .model import bed_shape
from .robot import ImportedPrinter

#: By how much a plate is best turned: shapes of up to five lobes lie elsewhere then. A third of a turn would leave one
#: of three lobes as it was, and that is what a twisted frame looks like.
TURN_DEG = 60.0
#: New numbers are worth entering where they take this part of the error, and so much, mm.
_WORTH, _WORTH_MM = 0.2, 0.005
#: Of lengths, mm.
_WORTH_LENGTH_MM = 0.02
#: A part of the size that nobody measures.
_WORTH_SIZE = 0.0005
#: Less than this, mm RMS, no probe resolves and nobody feels.
_FELT_MM = 0.003
#: Heights by which one fault is told from another.
_ENOUGH = 25
_TOWERS = {1: "A (front left)", 2: "B (front right)", 3: "C (back)"}
#: What the owner of a printer calls a suspect.
_CALLED = {
    "rail_lean": "towers that lean",
    "joint_scale": "a belt that moves its carriage too far or not far enough",
    "rod_mismatch": "an effector that tilts, since the two rods of an arm differ",
    "bed_shape": "a plate that is not flat",
    "bar_zero": "callipers that read every distance too long or too short",
}


@dataclass(frozen=True, eq=False)
class Examined:
    """What the probing of a printer says; :attr:`sections` are its words."""

    found: ImportedPrinter
    plain: Fit
    diagnosis: Diagnosis
    suspects: tuple[Suspect, ...]
    #: The file that the better numbers were written to.
    written: str = ""

    @property
    def tied(self) -> bool:
        """Whether several could be behind it."""
        return len(self.suspects) > 1

    @cached_property
    def numbers_told(self) -> FirmwareFit:
        """The best numbers that the firmware can hold: by the suspect that leads, where it leads alone, else by all
        that was measured as it is, as the firmware's own calibration would; as far as they are told from those there
        are."""
        fit = self.suspects[0].fit if len(self.suspects) == 1 else self.plain
        return held(self.found.robot, told(fit))

    @cached_property
    def new(self) -> FirmwareFit:
        """The numbers for the firmware: the best where they are worth entering, else those that it has."""
        best = self.numbers_told
        return best if self.better_numbers else replace(best, towers=self.found.robot.towers, errors={})

    @property
    def before_mm(self) -> float:
        """Height errors over the plate as the firmware has it, RMS, each probing about its own zero."""
        return self._heights(self.plain.nominal_residuals)

    @property
    def left_mm(self) -> float:
        """The least that any numbers of the firmware leave of them."""
        return self._heights(self.plain.residuals)

    @cached_property
    def after_mm(self) -> float:
        """What :attr:`new` leaves of them, where they are probed again: what is fitted follows the scatter of the
        probe, which is another then."""
        return self._promised(self.new.errors) if self.better_numbers else self.before_mm

    def _promised(self, errors: Mapping[str, float]) -> float:
        plain = self.plain
        rows = ~plain.data.between_places & plain.data.used[:, 0]
        columns = plain.model.derivatives(plain.data, plain.values)[rows, 0]
        spread = float(np.einsum("ij,jk,ik->i", columns, plain.covariance, columns).mean())
        return float(np.sqrt(self._heights(self._left(errors)) ** 2 + 2.0 * spread))

    @cached_property
    def left_by_new(self) -> Floats:
        """What the numbers that are advised leave of each measurement (n, 1), the plate taken as flat."""
        return self._left(self.new.errors)

    def _left(self, errors: Mapping[str, float]) -> Floats:
        """What a geometry with these errors leaves (n, 1) of a plate that is flat."""
        plain = self.plain
        return residuals(plain.model, plain.data, np.array([errors.get(p.name, 0.0) for p in plain.parameters]))

    @cached_property
    def lengths_mm(self) -> tuple[float, float]:
        """Errors of the distances by callipers, RMS, by the numbers of the firmware and by the best."""
        now, best = self.plain.nominal_residuals, self._left(self.numbers_told.errors)
        data = self.plain.data
        return lengths_of(data, now), lengths_of(data, best)

    @property
    def chance(self) -> float:
        """How often a perfect machine on a flat plate would leave as much of a pattern: by the diagnosis, or by what
        the likeliest suspect takes (Wilks, "The large-sample distribution of the likelihood ratio", 1938)."""
        p = self.diagnosis.p_missing
        for one in self.suspects[:1]:
            nothing = Suspect((), self.plain, self.plain)
            p = min(p, float(scipy.special.chdtrc(one.numbers, nothing.alone - one.alone)))
        return max(p, 1e-6)

    def _heights(self, left: Floats) -> float:
        data = self.plain.data
        rows = ~data.between_places & ~data.outlier
        probing = data.covariates["probing"][rows]
        values = left[rows, 0]
        means = {k: values[probing == k].mean() for k in np.unique(probing).tolist()}
        return float(np.sqrt(np.mean([(v - means[k]) ** 2 for v, k in zip(values, probing.tolist(), strict=True)])))

    @cached_property
    def better_numbers(self) -> bool:
        """Whether new numbers are worth entering: for the height over the plate, or for lengths."""
        heights = self.before_mm, self._promised(self.numbers_told.errors)
        return heights[0] - heights[1] > max(_WORTH * heights[0], _WORTH_MM) or self.better_lengths

    @cached_property
    def better_lengths(self) -> bool:
        """Whether the best numbers make lengths truer by more than callipers are off."""
        before, after = self.lengths_mm
        return before - after > max(_WORTH * before, _WORTH_LENGTH_MM)

    @property
    def unknown(self) -> bool:
        """Whether there is a pattern of which nobody is suspected."""
        told = self.diagnosis
        return not self.suspects and told.p_missing <= told.level and self.left_mm >= _FELT_MM

    # -- words ---------------------------------------------------------------------------------------------

    @property
    def answer(self) -> Answer:
        """What it says for whoever reads nothing else."""
        if self.suspects:
            verdict = self._called
        elif self.unknown:
            verdict = "a pattern that no known fault makes"
        else:
            verdict = "the numbers in the firmware" if self.better_numbers else "nothing that this probing shows"
        wrong, steps = self._wrong(), tuple(self._steps()) or (ToDo("Nothing needs to be changed."),)
        before = Bar(BEFORE, "the plate as it reads now", self.before_mm)
        bars = before, Bar(AFTER, "with the best numbers", self.after_mm)
        # the verdict says which pattern it is
        further = self._leaning() if self.suspects else wrong[1:]
        return Answer(verdict, wrong[0], (*further, *self._sure()), steps, bars, "mm")

    @property
    def _called(self) -> str:
        """What could be behind it, in words."""
        said = (" together with ".join(_CALLED.get(n, n) for n in one.names) for one in self.suspects)
        return f"{'either ' if self.tied else ''}{', or '.join(said)}"

    def _steps(self) -> Iterator[ToDo]:
        """What to do, with the commands that do it."""
        if self.better_numbers and self.written:
            yield ToDo(f"Use {self.written}: it has the better numbers.")
        elif self.better_numbers and self.found.robot.firmware == "klipper":
            yield ToDo("Write the better numbers into printer.cfg", f"sherkit printer {FILES} -o new.cfg")
        elif self.better_numbers:
            yield ToDo("Send these to the printer:", "\n".join(commands(self.found.robot, self.new.towers)))
        if self.better_numbers:
            yield ToDo(self._mesh())
        elif self.suspects:
            yield ToDo("Leave the numbers in the firmware as they are: none are clearly better.")
        if self.tied:
            yield ToDo("Turn no screw yet: see below what tells them apart.")
        for one in self.suspects if not self.tied else ():
            yield from (ToDo(e.remedy) for e in one.effects)
        if any(bed_shape.name in one.names for one in self.suspects):
            yield ToDo("For printing meanwhile, let the firmware's mesh follow the plate.")

    def _mesh(self) -> str:
        """What is to be done about meshes that were probed with the numbers of now."""
        firmware = self.found.robot.firmware
        why = "a mesh that was probed with the old numbers would bring their errors back"
        if firmware == "klipper":
            return (
                "Then BED_MESH_CALIBRATE and SAVE_CONFIG before the next print: meshes are left out of the new file, "
                f"as {why}, and until then a macro that loads one stops."
            )
        return f"Then G29, saved, before the next print: {why}."

    @property
    def numbers(self) -> list[tuple[str, str, str]]:
        """The firmware's numbers, each as it is and as it would be better."""
        now, new = self.found.robot.towers, self.new.towers
        pairs = [("delta radius, mm", now.radius_mm, new.radius_mm)]
        for k, tower in enumerate("ABC"):
            for what, name in (("angle, °", "angle_deg"), ("arm, mm", "arm_mm"), ("endstop, mm", "endstop_mm")):
                pairs.append((f"{tower}: {what}", getattr(now, name)[k], getattr(new, name)[k]))
        return [(what, f"{before:.3f}", f"{after:.3f}") for what, before, after in pairs]

    @property
    def sections(self) -> list[tuple[str, list[str]]]:
        """Titles, each with its sentences."""
        return [
            ("What was measured", [self._measured()]),
            ("What is wrong", self._wrong()),
            ("How sure", self._sure()),
            ("What to do", self._do()),
            ("What accuracy remains", self._remains()),
            ("What to measure next", self._next()),
        ]

    def _measured(self) -> str:
        data, robot = self.plain.data, self.found.robot
        count = int(data.between_places.sum())
        lengths = f" and {count} distances" if count else ""
        turned = [f"{t:g}°" for t in turns(data) if t]
        plate = f", the plate turned by {' and '.join(turned)} in part of them" if turned else ""
        names = ", ".join(robot.probings) or "callipers"
        still = ""
        if len(robot.probings) > 1 and not turned:
            still = " All are taken with the plate lying the same way; if it was turned under one: --plate NAME=60."
        return f"{len(data) - count} heights{lengths} ({names}){plate}.{self._left_out()}{still}"

    def _left_out(self) -> str:
        """Heights that nothing explains, and where; and distances."""
        data, left = self.plain.data, self.plain.residuals[:, 0]
        far = data.outlier & data.between_places
        out = f" {int(far.sum())} of the distances left out as wrong: measure again." if far.any() else ""
        rows = np.flatnonzero(data.outlier & ~far)
        if not len(rows):
            return out
        at, off = self.plain.model.tips(data)[rows], left[rows]
        each = listed([f"({round(x)}, {round(y)}) by {_mm(abs(z))}" for (x, y, *_), z in zip(at, off, strict=True)], 6)
        those, them = ("are", "them") if len(rows) > 1 else ("is", "it")
        return (
            f" {len(rows)} of them {those} off at {each} and left out: look what lies there, and probe {them} again."
            + out
        )

    def _wrong(self) -> list[str]:
        out = []
        if self.better_numbers:
            out.append(
                f"The numbers in the firmware: with them the nozzle is {_mm(self.before_mm)} too high or too low over "
                f"the plate (RMS), and with better ones {_mm(self.after_mm)}."
            )
            if self.better_lengths:
                now, then = self.lengths_mm
                out.append(f"With them lengths are {_mm(now)} off (RMS), and with better ones {_mm(then)}.")
        begins = (
            f"{'Besides, what' if out else 'What'} the firmware's numbers cannot take away, {_mm(self.left_mm)}, has"
        )
        if self.unknown:
            out.append(f"{begins} a pattern that neither this plate nor a known fault of the machine makes.")
        if not self.suspects:
            told = self.diagnosis
            named = told.indistinguishable[0] if told.indistinguishable else told.effects
            if named and not self.unknown:
                # who asks diagnose about the same file hears these names
                called = ", or ".join(_CALLED.get(one, one) for one in named)
                out.append(f"What is left, {_mm(self.left_mm)}, may be {called}: too little of it to act on.")
            if not out:
                out.append("Nothing that this probing could show: what is left looks like the scatter of the probe.")
            return out
        return [*out, f"{begins} a pattern: {'it is ' if self.tied else ''}{self._called}.", *self._leaning()]

    def _leaning(self) -> list[str]:
        """Which towers lean and where to, if it is these."""
        doubt = "If it is the towers: " if self.tied else ""
        return [f"{doubt}{told}" for one in self.suspects for told in self._which(one)]

    def _which(self, one: Suspect) -> list[str]:
        """The tower, the direction, how far at its top."""
        if "rail_lean" not in one.names:
            return []
        out, what = [], known(one.fit).get("rail_lean")
        if what is not None:
            top, towers = float(self.found.robot.towers.top_mm.mean()), [_TOWERS[k] for k in what.at]
            for value in what.values:
                lean, spread = np.tan(np.deg2rad(abs(value.value))) * top, np.deg2rad(value.std) * top
                far = f"{lean:.1f} ± {max(spread, 0.1):.1f} mm at its top, {top:.0f} mm up"
                if what.form == "common" and value.what.startswith("tangential"):
                    way = f"{'anticlockwise' if value.value > 0 else 'clockwise'} seen from above"
                    out.append(f"All three towers lean the same way round, {way}, {far}: the frame is twisted.")
                elif what.form == "one":
                    way = _way(value.what.split()[0], what.at[0], value.value)
                    out.append(f"Tower {towers[0]} leans {way}, {far}.")
                elif what.form == "opposite":
                    out.append(f"Towers {' and '.join(towers)} lean against each other, each {far}.")
        return out or ["Which tower it is these heights do not say: check each with a level or a square."]

    def _sure(self) -> list[str]:
        p = self.chance
        often = f"fewer than 1 of {1 / p:,.0f} probings" if p < 0.005 else f"{100 * p:.0f} of 100 probings"
        if not self.suspects:
            what = "Apart from these numbers, a" if self.better_numbers else "A"
            return [f"{what} perfect machine would leave as much of a pattern in {often}."]
        out = [f"A perfect machine on a flat plate would leave such a pattern in {often}."]
        if self.tied:
            out.append("Which of them it is these heights cannot tell: all of them leave the same on the plate.")
        return out

    def _do(self) -> list[str]:
        out = []
        for step in self._steps():
            # what a printer is sent is typed line by line
            if step.command.startswith("sherkit "):
                out.append(f"{step.sentence}: run this again with -o NEW.cfg, and use that file.")
            else:
                out += [step.sentence, *(f"    {line}" for line in step.command.splitlines())]
        return out or ["Nothing needs to be changed."]

    def _remains(self) -> list[str]:
        out = [f"{_mm(self.after_mm)} RMS over the plate, the scatter of the probe included."]
        if any(bed_shape.name in one.names for one in self.suspects):
            out[0] = f"{_mm(self.after_mm)} RMS over the plate as it lies there, the scatter of the probe included."
        if self.new.rms_mm > 0.0005:
            out.append(
                f"The firmware has no number for what is wrong: {_mm(self.new.rms_mm)} RMS, {_mm(self.new.largest_mm)} "
                "at worst, stay until the machine is put right, and a mesh hides them on the first layer only."
            )
        size = size_of(self.suspects[0].fit if self.suspects else self.plain, self.left_by_new)
        if size is not None:
            off, within = (100 * one for one in size)
            out.append(f"Sizes of parts: {off:+.2f} % by these distances, ± {max(within, 0.01):.2f} %.")
        elif (bowl := size_by_bowl(self.plain)) > _WORTH_SIZE:
            out.append(
                f"Sizes of parts heights do not tell: a plate bowed by {BOWL_MM:g} mm passes for other numbers, and "
                f"parts are {100 * bowl:.1f} % too large or too small for it. Distances by callipers tell."
            )
        return out

    def _next(self) -> list[str]:
        names = {n for one in self.suspects for n in one.names}
        turned = len(turns(self.plain.data)) > 1
        out = []
        if bed_shape.name in names and self.tied and not turned:
            out.append(
                f"Turn the plate by {TURN_DEG:g}° (a sixth of a turn, anticlockwise seen from above), probe a mesh "
                f"under another name, and run this again with --plate NAME={TURN_DEG:g}: what turned with the plate is "
                "the plate's, what stayed is the machine's. A third of a turn would not do: a plate of three lobes "
                "would look the same again, and so does a twisted frame."
            )
        if "rail_lean" in names and (self.tied or turned):
            top = float(self.found.robot.towers.radius_mm)
            out.append(
                "Print a square tower 150 mm tall with edges of 40 mm and hold a steel rule along them: a twisted "
                f"frame turns them, {150 * np.deg2rad(0.5) / top * 28:.1f} mm from foot to top for each 0.5° of lean."
            )
        if "rod_mismatch" in names and self.tied:
            out.append("Lay the two rods of each arm side by side on two pins: do they have the same length?")
        if self.better_numbers and not self.tied:
            out.append("Probe again with the new numbers: the plate should read as is said above.")
        probings = self.found.robot.probings
        if self.unknown and len(probings) > 1 and not turned:
            out.append(
                f"If the plate was turned between {' and '.join(probings)}, say by how much: run this again with "
                f"--plate {probings[-1]}=DEGREES."
            )
        elif self.unknown:
            out.append("Probe the same points again: what does not come back is the probe's, or something is loose.")
        elif not self.suspects and not turned:
            out.append(
                "A plate bent like a bowl or a saddle looks just like wrong numbers. If prints are not to size "
                f"although the first layer is even, turn the plate by {TURN_DEG:g}°, probe again under another name, "
                f"and run this with --plate NAME={TURN_DEG:g}."
            )
        heights = int((~self.plain.data.between_places).sum())
        if self.suspects and heights < _ENOUGH:
            one = f"by {heights} heights one fault looks like another"
            out.append(f"Probe a mesh of 7 by 7 points or more, and run this again: {one}.")
        return out or ["Nothing more."]

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "sections": dict(self.sections),
            "suspects": [list(one.names) for one in self.suspects],
            "p_value": self.chance,
            "before_mm": self.before_mm,
            "after_mm": self.after_mm,
            "not_held_mm": {"rms": self.new.rms_mm, "largest": self.new.largest_mm},
            "firmware": asdict(self.new.towers),
        }


def examine(found: ImportedPrinter, *, seed: int = 0, step: Callable[[str], None] = lambda _: None) -> Examined:
    """Examines a printer by what it probed. Raises :class:`~sherkit.errors.FitError` where that is too little."""
    step("fitting what the firmware can hold")
    plain = plain_fit(found.robot, found.measurements)
    told = diagnose(plain, seed=seed, step=step)
    if len(told.outliers):
        plain = plain_fit(found.robot, found.measurements.mark_outliers(told.outliers))
    step("asking who could be behind it")
    asked = Examined(found, plain, told, ())
    if asked.left_mm < _FELT_MM:
        return asked
    # a diagnosis names nothing that rows held out do not confirm, and at a plate's edge they are too few for its shape
    return Examined(found, plain, told, suspects(plain, significant=told.p_missing <= told.level))


def files_of(path: Path, maps: tuple[Path, ...], plates: dict[str, float]) -> ImportedPrinter:
    """A printer by its files, whichever firmware wrote them. Raises :class:`~sherkit.errors.SherkitError`."""
    if maps:
        return import_duet(path, maps, plates)
    # a printer.cfg may speak of M665 in a macro, but it has sections; a config.g without a map lacks one
    lines = text_of(path, "a printer.cfg, or what Marlin's terminal said").splitlines()
    if words(lines, "M665") and not any(line.startswith("[") for line in lines):
        return import_duet(path, maps, plates) if path.suffix == ".g" else import_marlin(path, plates)
    return import_klipper(path, plates)


def _mm(value: float) -> str:
    return f"{value:.3f} mm"


def _way(kind: str, tower: int, value: float) -> str:
    if kind == "radial":
        return "outwards, away from the middle" if value > 0 else "inwards, over the plate"
    # anticlockwise seen from above, as somebody in front of the printer sees it
    right = {1: "towards the front right", 2: "towards the back", 3: "to the left"}
    left = {1: "towards the back left", 2: "towards the front left", 3: "to the right"}
    return f"sideways, {(right if value > 0 else left)[tower]} seen from the front"
