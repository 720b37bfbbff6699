"""What ``sherkit VERB --help`` ends with: lines that can be typed as they stand. A test parses each of them."""

from __future__ import annotations

EXAMPLES: dict[str, tuple[str, ...]] = {
    "app": ("sherkit app robot.toml run.csv", "sherkit app robot.toml run.csv --follow --study monday"),
    "c": ("sherkit c --cflags --libs", "sherkit c --example my_loop"),
    "calibrate": (
        "sherkit calibrate robot.toml run.csv -o calibrated.toml",
        "sherkit calibrate robot.toml whole.csv --local near.csv --effect rail_lean --report calibration.html",
    ),
    "check": ("sherkit check run.csv", "sherkit check run.csv robot.toml --write clean.csv"),
    "compare": ("sherkit compare robot.toml monday.csv friday.csv",),
    "completion": ("sherkit completion bash",),
    "demo": ("sherkit demo",),
    "diagnose": (
        "sherkit diagnose robot.toml run.csv",
        "sherkit diagnose robot.toml run.csv --effects my_effects.py --report diagnosis.html",
    ),
    "doctor": ("sherkit doctor",),
    "effects": ("sherkit effects", "sherkit effects backlash --picture backlash.svg"),
    "estimate": ("sherkit estimate tool.toml run.csv -o estimate.csv",),
    "export": (
        "sherkit export experiment.sqlite -o run.csv",
        "sherkit export c calibrated.toml -o robot.h",
        "sherkit export klipper calibrated.toml --config printer.cfg -o new.cfg",
    ),
    "fleet": ("sherkit fleet machine_*.csv --robot robot.toml",),
    "history": ("sherkit history robot.toml january.csv april.csv july.csv --dates 2026-01-10,2026-04-09,2026-07-12",),
    "home": ("sherkit home experiment.toml", "sherkit home experiment.toml --at 128.9,128.9,128.9"),
    "import": (
        "sherkit import klipper printer.cfg -o printer",
        "sherkit import urdf arm.urdf -o robot.toml",
        "sherkit import bluesky run.jsonl --column q1_mm=rails_q1 --column x_mm=laser_x -o run.csv",
        "sherkit import rosbag recorded --joint q1_mm=rail_1 --poses /tracker -o run.csv",
    ),
    "intrinsics": ("sherkit intrinsics boards/ --chessboard 9x6 --square-mm 10 -o camera.toml",),
    "lab": ("sherkit lab --demo", "sherkit lab lab.toml --ports ports.json"),
    "markers": (
        "sherkit markers --print marker.pdf",
        "sherkit markers pictures/ --joints joints.csv -o run.csv",
    ),
    "measure": (
        "sherkit measure experiment.toml --live",
        "sherkit measure experiment.toml --until diagnosed",
        "sherkit measure experiment.toml --python my_lab.py --resume",
    ),
    "plan": (
        "sherkit plan robot.toml experiment.toml --noise-um 2",
        "sherkit plan calibrated.toml --verify --poses 20",
    ),
    "printer": (
        "sherkit printer printer.cfg --report printer.html",
        "sherkit printer printer.cfg --plate turned=60 -o new.cfg",
    ),
    "register": ("sherkit register tool.toml camera.csv -o registered.toml",),
    "schema": ("sherkit schema experiment",),
    "simulate": ("sherkit simulate robot.toml -o run.csv --seed 3",),
    "tool": ("sherkit tool bench.csv free.csv run.csv -o tool.toml --report tool.html",),
    "verify": ("sherkit verify calibrated.toml check.csv --fail-if-invalid",),
}


def epilog(verb: str) -> str:
    """The last paragraph of a verb's help."""
    return "\n".join(["\b", "Examples:", *(f"  {line}" for line in EXAMPLES[verb])])
