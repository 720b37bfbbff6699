"""What every verb says, kept: ``python tests/outputs.py`` lists the commands that say something else now, and
``python tests/outputs.py --write NAME`` keeps the new words of those whose line holds NAME.

A change of the code that is to change nothing shows here what it changed after all: text and JSON. Numbers are compared
as ``golden.py`` compares them, since a fit settles a little elsewhere on another machine.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from golden import LAST_DIGITS
from pages_of_verbs import runs_of_a_pair, tables_of_a_tool
from running import command, thin
from second_printer.trials import Trial

FILE = Path(__file__).parent / "golden" / "outputs.json"
MACHINE = Path(__file__).parents[1] / "examples" / "machines" / "gantry.py"
#: In the order in which they are typed, all in one folder; what one writes another reads.
LINES = (
    "demo -o demo", "check demo/whole.csv demo/robot.toml", "check demo/whole.csv --json",
    "diagnose demo/robot.toml thin.csv", "diagnose demo/robot.toml thin.csv --json",
    "diagnose demo/robot.toml thin.csv --effect rail_lean --json",
    "calibrate demo/robot.toml thin.csv -o c.toml", "calibrate demo/robot.toml thin.csv --effect rail_lean -o l.toml",
    "calibrate demo/robot.toml thin.csv --json", "verify l.toml demo/local.csv", "verify l.toml demo/local.csv --json",
    "compare robot.toml run_1.csv run_2.csv", "compare robot.toml run_1.csv run_2.csv --json",
    "history robot.toml run_1.csv run_2.csv run_1.csv", "fleet run_1.csv run_2.csv --robot robot.toml",
    "effects", "effects backlash", "effects --json", "export c l.toml -o l.h", "plan l.toml --verify --poses 8",
    "schema robot", "schema experiment", "schema laboratory", "simulate sphere.toml -o sphere.csv --repeats 2 --seed 3",
    "diagnose sphere.toml sphere.csv --json", "calibrate sphere.toml sphere.csv -o sc.toml",
    "simulate arm.toml -o arm.csv --repeats 2 --seed 4 --yield-mrad 0.6", "diagnose arm.toml arm.csv",
    "calibrate arm.toml arm.csv --effect joint_compliance -o ac.toml", "export urdf ac.toml -o ac.urdf",
    "export dh ac.toml -o ac.csv", "export xacro arm.toml -o arm.xacro", "export kinematics ac.toml -o ac.yaml",
    "import urdf ac.urdf -o again.toml", "printer printer.cfg --plate at60=60",
    "printer printer.cfg --plate at60=60 --json",
    "import klipper printer.cfg --plate at60=60 -o printer", "tool bench.csv free.csv run.csv -o tool.toml",
    "estimate tool.toml run.csv", "estimate tool.toml run.csv --json", "register tool.toml free.csv",
    "diagnose tool.toml run.csv", "export c tool.toml -o tool.h", f"effects --robot {MACHINE}",
    "--help", "export --help", "import --help", "export -o o.urdf urdf ac.toml",
    "export kinematics.yaml ac.toml -o k.yaml",
    # and what is refused
    "export nosuch -o out.csv", "export nosuch.sqlite -o out.csv", "export -o urdf run.sqlite",
    "diagnose demo/robot.toml nothing.csv", "diagnose demo/whole.csv demo/robot.toml", "diagnoze",
    "export dhh l.toml -o x",
    "export urdf l.toml -o l.urdf", "export klipper l.toml -o x.cfg", "simulate arm.toml -o x.csv --rail-lean-mrad 2",
    "estimate demo/robot.toml run.csv", "compare demo/robot.toml thin.csv", "verify demo/robot.toml thin.csv",
)  # fmt: skip
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
#: What is another one at each time.
_TIMES = re.compile(r"\b\d+(?:\.\d+)? (?:s|ms|minutes)\b|\d{4}-\d\d-\d\dT[\d:.+]+")


def prepared(folder: Path) -> None:
    """Robots and runs that the lines read, besides what they write themselves."""
    import sherkit as sk
    from sherkit.model.kinds import known_kinds

    for name, kind in (("sphere", "spherical"), ("arm", "serial")):
        sk.save_robot(known_kinds()[kind].example, folder / f"{name}.toml")
    runs_of_a_pair(folder)
    tables_of_a_tool(folder)
    Trial.of("frame twisted", 5, 1).write(folder, "klipper", (0.0, 60.0), 1)


def said() -> Iterator[tuple[str, str]]:
    """Each line with its code and all that it prints."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepared(folder)
        for line in LINES:
            code, out, err = command(folder, *line.split())
            if line.startswith("demo"):
                (folder / "thin.csv").write_bytes((folder / "demo" / "whole.csv").read_bytes())
                thin(folder / "thin.csv", 3)
            text = "\n".join(one.rstrip() for one in f"{out}{err}".replace(name, "FOLDER").splitlines())
            yield line.replace(str(MACHINE.parents[2]), "."), f"{code}\n{_TIMES.sub('TIME', text)}"


def differs(kept: str, now: str) -> str:
    """The first words that are otherwise, or nothing: texts to the letter, numbers within their last digits."""
    for before, after in zip(kept.splitlines(), now.splitlines(), strict=False):
        numbers = [[float(v) for v in _NUMBER.findall(one)] for one in (before, after)]
        near = len(numbers[0]) == len(numbers[1]) and all(
            abs(a - b) <= 5.0 * LAST_DIGITS * max(abs(a), abs(b), 1e-3) for a, b in zip(*numbers, strict=True)
        )
        if not near or " ".join(_NUMBER.sub("#", before).split()) != " ".join(_NUMBER.sub("#", after).split()):
            return f"  - {before}\n  + {after}"
    lengths = len(kept.splitlines()), len(now.splitlines())
    return "" if lengths[0] == lengths[1] else f"  {lengths[0]} lines were said, now {lengths[1]}"


def main() -> int:
    """Compares, or keeps anew."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", metavar="NAME", help="Keep what lines with NAME in them say now.")
    wanted = parser.parse_args().write
    kept = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    changed = 0
    for line, now in said():
        if wanted is not None and wanted in line:
            kept[line] = now
        elif (found := differs(kept.get(line, ""), now)) or line not in kept:
            changed += 1
            print(f"sherkit {line}\n{found}")
    if wanted is not None:
        FILE.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(f"{len(LINES)} commands, {changed} say something else")
    return int(changed > 0 and wanted is None)


if __name__ == "__main__":
    sys.exit(main())
