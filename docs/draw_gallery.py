"""Draws every picture of docs/gallery.md and writes the page: ``make demo``, then ``python docs/draw_gallery.py``.

The lines that the page shows are the lines that are run here. Needs Chromium; Pillow, where it is installed, makes the
files smaller.
"""

from __future__ import annotations

import runpy
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl

import sherkit as sk
from sherkit.report.page import save_picture

HERE = Path(__file__).parent
FOLDER, OUT, PAGE = Path("demo"), HERE / "pictures" / "gallery", HERE / "gallery.md"
_WIDTH_PX = 960
_COLOURS = 160
#: Of a reading of the virtual robot.
_NOISE_MM = 0.005
#: Letters in a line of the page.
_LINE = 118

SETUP = """
import sherkit as sk

study = sk.Study(sk.load_robot("demo/robot.toml"), sk.read_measurements("demo/whole.csv"))
before = study.fit
found = study.diagnose()
for name in found.effects:
    study.add(name)
"""


@dataclass(frozen=True)
class Item:
    """A picture of the page: how to read it, and the lines that make it (the last one is the picture)."""

    file: str
    title: str
    text: str
    lines: str
    setup: str = "demo"


ITEMS = [
    Item("residual_map", "Residual map",
         "Where the model is wrong, and which way. An arrow starts at the black dot of its pose and shows the error in "
         "x and y, its colour the error in z; left before, right with the effect added, all on one scale. Compare the "
         "arrows with the circle: noise alone would leave 95 of 100 inside it.",
         "from sherkit.report.residuals import residuals_of\n"
         "from sherkit.report.residual_arrows import Change\n"
         "from sherkit.report.residual_map import residual_map\n"
         'change = Change(residuals_of(before), residuals_of(study.fit), "geometry calibrated", "+ rail_lean")\n'
         "residual_map(change, width_px=700)"),
    Item("residual_map_plane", "… of one plane and 20 rows",
         "Each pose was read once; the noise, 5 µm, stands in columns of the file, so that there is a circle without "
         "repeats.",
         'change = Change(residuals_of(before), residuals_of(study.fit), "geometry calibrated", "+ rail_lean")\n'
         "residual_map(change, width_px=700)",
         "plane"),
    Item("residual_map_many", "… of 20,000 rows",
         "Poses are so many that arrows would hide one another: each is the mean of a cell, and the planes are slabs "
         "of equally many rows.",
         'change = Change(residuals_of(before), residuals_of(study.fit), "geometry calibrated", "+ rail_lean")\n'
         "residual_map(change, width_px=700)",
         "many"),
    Item("against", "Residual against anything",
         "One panel for each reading against a joint, a coordinate, time or any other column. The black line is the "
         "running mean, its band two standard errors: where the band leaves zero, something depends on this variable. "
         "Grey is the error before the effect was added, dashed what the effect explains of it.",
         "from sherkit.report.residual_against import ResidualAgainst, residual_against\n"
         'residual_against(ResidualAgainst(residuals_of(study.fit), "q1_mm", residuals_of(before)))'),
    Item("against_plane", "… of one plane and 20 rows",
         "With a few rows the band is wide: hardly anything can be said, and the picture says so.",
         'residual_against(ResidualAgainst(residuals_of(study.fit), "x_mm", residuals_of(before)))', "plane"),
    Item("against_many", "… of 20,000 rows",
         "A sample of the rows is drawn; running mean and band count all of them.",
         'residual_against(ResidualAgainst(residuals_of(study.fit), "q1_mm", residuals_of(before)))', "many"),
    Item("fall", "The fall of the error",
         "Every step of a study: filled on poses that the fit had not seen, open on those it was fitted to. The "
         "further apart the two, the more the fit learned by heart. Dotted is the noise, below which nothing can be "
         "gained; dashed the accuracy that is needed.",
         "from sherkit.report.states import error_history, error_history_of\n"
         "error_history(error_history_of(study, found))"),
    Item("candidates", "Candidates",
         "What each effect would bring if it were added: the error that would remain on poses held out, with two "
         "standard errors. Blue is what the diagnosis names, a cross helps only at a size that is not plausible.",
         "from sherkit.report.candidates import candidates\ncandidates(found)"),
    Item("candidates_plane", "… of one plane and 20 rows",
         "The bracket holds effects that these rows cannot tell apart: do not believe the first one more than the "
         "other.",
         "candidates(found)", "plane"),
    Item("atlas", "Signature atlas",
         "The measured map, and beside it how each effect would look on the same poses at its best. The tile that is "
         "most alike names the effect; the percentage says how much of the squared error it explains.",
         "from sherkit.report.candidates import atlas_of, signature_atlas\nsignature_atlas(atlas_of(before))"),
    Item("parameters", "Parameters",
         "Identified values with 95 % intervals: dark is what the readings leave, pale what no reading tells. A dark "
         "bar too short to be seen behind its dot is a parameter that is known well.",
         "from sherkit.report.parameters import parameters\nparameters(study.fit)"),
    Item("correlations", "Correlations",
         "Dark cells off the diagonal are pairs of which the readings tell the sum or the difference, and hardly each "
         "of the two.",
         "from sherkit.report.parameters import correlations\ncorrelations(study.fit)"),
    Item("directions", "Badly observed directions",
         "Combinations of parameters that the readings fix worst: how far one standard deviation moves them together.",
         "from sherkit.report.parameters import directions\ndirections(study.fit)"),
    Item("accuracy", "Predicted accuracy",
         "The radius around a commanded position that holds 95 of 100, at three heights. The outline is the region "
         "that meets the requirement; hatched is where no pose was measured, so that the figure is extrapolated.",
         "from sherkit.report.parameters import accuracy_map, accuracy_of\n"
         "accuracy_map(accuracy_of(study.calibration()))"),
    Item("next_poses", "Poses to measure next",
         "Where tied effects differ most, numbered in the order to measure them, from above and from the side. Here "
         "for the run of one plane and 20 rows: the run of the demo leaves nothing tied.",
         "from sherkit.report.parameters import NextPoses, next_poses\n"
         "next_poses(NextPoses(found.next_poses, residuals_of(before)))", "plane"),
    Item("noise_before", "Against the noise: geometry calibrated",
         "Left the readings in units of their noise, right the same as quantiles against those of a Gaussian. Where "
         "the line is steeper than the dashed one there is more than noise.",
         "from sherkit.report.residual_against import noise_picture\nnoise_picture(residuals_of(before))"),
    Item("noise", "Against the noise: with the effect",
         "What is left now lies on the dashed line: it is noise.",
         "noise_picture(residuals_of(study.fit))"),
    Item("run", "The run in time",
         "What is left in the order in which it was measured: steps, trends and single wild readings show here. "
         "Other columns that vary, a temperature for instance, stand below on the same axis.",
         "from sherkit.report.residual_against import run_in_time\nrun_in_time(residuals_of(study.fit))"),
    Item("estimate", "An estimate over time (made-up data)",
         "For a tool with sensors of its own: the filter's estimate with its 95 % band, the sensor alone, the truth "
         "where it is known, and the force below; under the dotted line the sensor says little. The numbers are drawn "
         "at random, not measured.",
         "from sherkit.robots.tool.pictures import EstimateOverTime, estimate_picture\n"
         'others = {"sensor alone": raw, "truth": truth}\n'
         'estimate_picture(EstimateOverTime(time, value, std, "depth", "mm", others, force, 2))',
         "tool"),
    Item("reprojection", "Reprojection errors on the camera's picture (made-up data)",
         "Where the camera saw the marker, and how far the model sees it from there; the arrows are much longer than "
         "the errors, and the note says by how much. The numbers are drawn at random, not measured.",
         "from sherkit.report.residual_map import Reprojection, reprojection\n"
         "reprojection(Reprojection(seen, error, (1280, 960), line, image))", "camera"),
    Item("before_and_after", "Before and after: two nights of one telescope",
         "Measured: the mount of a 6.5 m telescope (tests/data/mmt_pointing), its raw encoders against stars, in July "
         "and in September 2023, by the six geometric terms of examples/telescope_mount.py as July has them (the hour "
         "angle of "
         "this mount is its azimuth, the declination its elevation). July is "
         "off by 1.4″, September by 12″: `partly explained`, the azimuth axis leans sideways (MA) by 13.4″ less, and "
         "without that no set of changes is likely. Fits of either night alone differ by 13.2″. What else has "
         "changed these two nights cannot tell: the index error IH and any smooth course in elevation would each do. "
         "There are no repeats; the noise is what a night's own fit leaves.",
         "from sherkit.report.pages import before_and_after\n"
         "before_and_after(sk.compare(mount.Mount(), nights[1:3]))", "mount"),
    Item("course", "The course: four nights of one telescope",
         "The same mount from 2021 to 2025: in July 2023 alone its axis leaned by 12.6″ more. The verdict is `partly "
         "explained`: the other changes are not named. Read by the encoders that the telescope's own pointing model "
         "has corrected (`abs` in that file) it is `unchanged`, though the six terms miss 0.6″ in every night: what "
         "all runs miss alike is no change. Limits: four nights, no repeats, the dates of service are not known, and "
         "nobody but the fits of the nights apart confirms what is said. What lasts and what happened once were "
         "taken up on seeing these very nights: they show what is said, and are no test of it. The two sides of the "
         "pier of three "
         "other mounts (tests/data/gem_mount_pointing), taken for before and after, are `unchanged` of one and "
         "`unexplained` of two: they bend another way when they are turned over, no term has changed, and none is "
         "named. Of the printer in tests/data there is one mesh: no pair.",
         "from sherkit.report.pages import course\n"
         "course(sk.history(mount.Mount(), nights, dates=dates))", "mount"),
]  # fmt: skip


def main() -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    names: dict[str, dict[str, Any]] = {}
    page = [
        "# Pictures",
        "",
        fill(
            "Every picture of the report, the notebook and the page `sherkit app`. `make demo`, then "
            "`python docs/draw_gallery.py`, draws them; it runs the lines that stand below each of them after these:",
            _LINE,
        ),
        "",
        f"```python{SETUP}```",
        "",
        fill(
            "Where a heading says so, `study`, `before` and `found` are those of another run of the same virtual "
            "robot, which the script simulates. `sherkit.report.page.save_picture(picture, path)` writes `.html`, "
            "`.png` or `.svg`. In a notebook, studies, diagnoses, fits and calibrations draw themselves.",
            _LINE,
        ),
    ]
    imports = ""
    for item in ITEMS:
        if item.setup not in names:
            names[item.setup] = prepared(item.setup)
        *before, last = item.lines.splitlines()
        imports += "".join(line + "\n" for line in before if line.startswith("from"))
        exec("\n".join([imports, *before]), names[item.setup])
        picture = eval(last, names[item.setup])
        file = OUT / f"{item.file}.png"
        save_picture(picture, file, width_px=_WIDTH_PX)
        _smaller(file)
        page += ["", f"## {item.title}", "", fill(f"{item.text}{_note(item, picture)}", _LINE), ""]
        page += [f"![{item.title}](pictures/gallery/{file.name})", "", f"```python\n{_shown(item.lines)}\n```"]
        print(f"{file}: {file.stat().st_size / 1e3:.0f} kB")
    PAGE.write_text("\n".join(page) + "\n", encoding="utf-8")
    print(f"{PAGE}; pictures together {sum(f.stat().st_size for f in OUT.glob('*.png')) / 1e6:.2f} MB")


def _note(item: Item, picture: Any) -> str:
    """What the picture itself says where it leaves something out."""
    return f" {picture.note}" if item.file in ("run", "reprojection") else ""


def _shown(lines: str) -> str:
    *before, last = lines.splitlines()
    return "\n".join([*before, *([""] if before else []), f"picture = {last}"])


def prepared(setup: str) -> dict[str, Any]:
    """What the lines of a picture know."""
    if setup == "tool":
        return _tool()
    if setup == "camera":
        return _camera()
    if setup == "mount":
        return _mount()
    names: dict[str, Any] = {}
    if setup == "demo":
        exec(SETUP, names)
        return names
    robot = sk.load_robot(FOLDER / "robot.toml")
    study = sk.Study(robot, one_plane(robot) if setup == "plane" else many(robot))
    names |= {"sk": sk, "study": study, "before": study.fit, "found": study.diagnose()}
    for name in names["found"].effects:
        study.add(name)
    return names


def one_plane(robot: sk.delta.Delta) -> sk.Measurements:
    """20 poses at one height, each read once; the noise is declared."""
    place = np.random.default_rng(3).uniform(-20, 20, (20, 2))
    rows = _virtual(robot).measure(np.column_stack([place, np.zeros(20)]), repeats=1, seed=6).to_frame()
    return sk.from_frame(rows.with_columns(**{f"sigma_{axis}_mm": pl.lit(_NOISE_MM) for axis in "xyz"}))


def many(robot: sk.delta.Delta) -> sk.Measurements:
    """4000 poses anywhere in the workspace, five readings of each."""
    return _virtual(robot).measure(np.random.default_rng(3).uniform(-20, 20, (4000, 3)), repeats=5, seed=6)


def _virtual(robot: sk.delta.Delta) -> sk.delta.VirtualDelta:
    """The virtual robot of the demo."""
    return sk.delta.VirtualDelta.draw(robot, 6, rail_lean_rad=8e-3, noise_mm=_NOISE_MM)


def _tool() -> dict[str, Any]:
    """A made-up insertion: the sensor drops out where the force is small."""
    rng = np.random.default_rng(0)
    time = np.linspace(0.0, 20.0, 2000)
    truth = 2.0 * np.clip((time - 3.0) / 10.0, 0.0, 1.0) + 0.05 * np.sin(2.0 * time)
    force = np.clip(6.0 * np.sin(0.35 * time - 0.6), 0.1, None) + 0.15 * rng.normal(size=len(time))
    std = np.where(force > 2.0, 0.02, 0.09)
    slow = np.convolve(rng.normal(size=len(time)), np.ones(60) / np.sqrt(60), mode="same")
    raw = truth + rng.normal(size=len(time)) * np.where(force > 2.0, 0.05, 0.3)
    return {"time": time, "truth": truth, "force": force, "std": std, "value": truth + 0.8 * std * slow, "raw": raw}


def _camera() -> dict[str, Any]:
    """A made-up picture with a marker seen at 200 places through a lens that is a little off."""
    rng = np.random.default_rng(1)
    v, u = np.mgrid[0:960, 0:1280]
    image = (120 + 70 * np.exp(-((u - 640) ** 2 + (v - 480) ** 2) / 2e5) + 20 * ((u // 80 + v // 80) % 2)).astype(
        np.uint8
    )
    seen = rng.uniform((60, 60), (1220, 900), (200, 2))
    away = (seen - (640, 480)) / 640
    error = 0.8 * away * (away**2).sum(axis=1, keepdims=True) + 0.08 * rng.normal(size=seen.shape)
    return {"seen": seen, "error": error, "line": np.arange(200) + 2, "image": image}


def _mount() -> dict[str, Any]:
    """Four nights of a telescope, and the example that reads them."""
    mount = SimpleNamespace(**runpy.run_path(str(HERE.parent / "examples" / "telescope_mount.py")))
    dates = ["2021-08-21", "2023-07-02", "2023-09-24", "2025-03-26"]
    file = mount.DATA / mount.MMT
    nights = [mount.read_mmt(file, f"point_{date.replace('-', '')}.dat") for date in dates]
    return {"sk": sk, "mount": mount, "nights": nights, "dates": dates}


def _smaller(file: Path) -> None:
    """Keeps as many colours as these pictures need."""
    try:
        from PIL import Image
    except ModuleNotFoundError:
        return
    with Image.open(file) as drawn:
        white = Image.new("RGB", drawn.size, "white")
        white.paste(drawn, mask=drawn.getchannel("A") if drawn.mode == "RGBA" else None)
    white.quantize(_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(file, optimize=True)


if __name__ == "__main__":
    main()
