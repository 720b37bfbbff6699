"""The core of the package without arms, printers, the flexible tool, laboratories and cameras: these reach the rest
through entry points alone, as a stranger's package does."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path

import pytest

from running import slow
from sherkit import save_robot
from sherkit.robots.delta import VirtualDelta, grid
from strategies import EXAMPLE
from test_floors import FLOORS, MENU, PACKAGE, imported

#: What can be taken away: the floors below the command line.
FOLDERS = tuple(room for rooms in FLOORS[FLOORS.index(("cli",)) + 1 : -1] for room in rooms)

STORY = """
import json, sys
from pathlib import Path
import numpy as np, polars as pl
import sherkit as sk
from sherkit.cli import main

folder, machine = Path(sys.argv[1]), sys.argv[2]


def command(*words):
    try:
        main([str(word) for word in words])
    except SystemExit as end:
        assert not end.code, (words, end.code)


for kind in filter(None, sys.argv[3].split(",")):
    robot, run = folder / f"{kind}.toml", folder / f"{kind}.csv"
    sk.save_robot(sk.model.kinds.known_kinds()[kind].example, robot)
    command("simulate", robot, "-o", run, "--repeats", 2, "--seed", 3)
    command("diagnose", robot, run, "--report", folder / f"{kind}.html")
    command("calibrate", robot, run, "-o", folder / f"{kind}_calibrated.toml")
rng = np.random.default_rng(4)
at = rng.uniform(0.0, 200.0, (80, 3))
read = at + 1e-3 * np.column_stack([at[:, 1], 0.0 * at[:, 1], 0.5 * at[:, 0]]) + rng.normal(0.0, 2e-3, at.shape)
names = ("x_axis_mm", "y_axis_mm", "z_axis_mm", "x_mm", "y_mm", "z_mm")
pl.DataFrame(dict(zip(names, np.hstack([at, read]).T, strict=True))).write_csv(folder / "machine.csv")
command("diagnose", machine, folder / "machine.csv", "--report", folder / "machine.html")
command("calibrate", machine, folder / "machine.csv", "-o", folder / "machine_calibrated.toml")
if sys.argv[3]:
    command("check", folder / "delta.csv", folder / "delta.toml")
    command("compare", folder / "delta.toml", folder / "delta.csv", folder / "delta.csv")
    command("verify", folder / "delta_calibrated.toml", folder / "delta.csv")
    command("export", "c", folder / "delta_calibrated.toml", "-o", folder / "robot.h")
for words in (["effects"], ["schema", "robot"], ["--help"], ["export", "--help"], ["import", "--help"], ["doctor"]):
    command(*words)
print("\\n" + json.dumps(sorted(name for name in sys.modules if name.startswith("sherkit."))))
"""
#: The page, asked for once over its port.
PAGE = """
import threading, urllib.request, sys
from pathlib import Path
from sherkit.app.server import PageServer
from sherkit.app.workbench import Workbench

robot, run = map(Path, sys.argv[1:])
bench = Workbench.open(robot, run, run.with_suffix(".study"))
server = PageServer(bench, port=0)


def ask():
    page = urllib.request.urlopen(server.url, timeout=60).read().decode()
    print("bokeh" in page.lower(), "sherkit" in page.lower())
    server.server.io_loop.add_callback(server.server.io_loop.stop)


server.run(lambda: threading.Thread(target=ask).start())
"""


def test_no_file_of_the_core_names_a_folder_that_it_works_without() -> None:
    """Catches an import of the flexible tool, an arm, a driver or OpenCV's room where it would be loaded for all."""
    away = tuple(folder.replace("/", ".") for folder in FOLDERS)
    wrong = [
        f"{file.relative_to(PACKAGE)} imports {module}"
        for file in sorted(PACKAGE.rglob("*.py"))
        if (here := file.relative_to(PACKAGE).as_posix()) != MENU
        and not here.startswith(tuple(f"{one}/" for one in FOLDERS))
        for module in imported(file)
        if any(module == one or module.startswith(f"{one}.") for one in away)
    ]
    assert not wrong, "\n".join(wrong)


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An installation without these folders: its package, and what its metadata still declares."""
    site = tmp_path_factory.mktemp("site")
    # with what Python has made of the sources already: to compile them takes longer than the story
    shutil.copytree(Path(sys.modules["sherkit"].__file__).parent, site / "sherkit")
    for folder in FOLDERS:
        shutil.rmtree(site / "sherkit" / folder)
    here = distribution("sherkit")
    metadata = site / f"sherkit-{here.version}.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: sherkit\nVersion: {here.version}\n")
    kept: dict[str, list[str]] = {}
    for entry in here.entry_points:
        if not entry.module.removeprefix("sherkit.").replace(".", "/").startswith(FOLDERS):
            kept.setdefault(entry.group, []).append(f"{entry.name} = {entry.value}")
    (metadata / "entry_points.txt").write_text("".join(f"[{g}]\n" + "\n".join(v) + "\n" for g, v in kept.items()))
    return site


def told(core: Path, folder: Path, kinds: str) -> subprocess.CompletedProcess[str]:
    """What the story of a machine and of these kinds said in this installation."""
    return asked(core, STORY, str(folder), str(PACKAGE.parents[1] / "examples" / "machines" / "gantry.py"), kinds)


def asked(core: Path, code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, encoding="utf-8", timeout=300,
        env=os.environ | {"PYTHONPATH": str(core)}, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("kinds", ["", *slow("delta,spherical")])
def test_the_core_works_alone(kinds: str, core: Path, tmp_path: Path) -> None:
    """Catches a core that needs what it names nowhere: delta, sphere and machine from a run over diagnosis, report and
    calibration to the header of a loop, in an installation without arms, printers, tool, laboratories, cameras."""
    folder, done = tmp_path, told(core, tmp_path, kinds)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "warning" not in done.stderr, done.stderr
    loaded = json.loads(done.stdout.splitlines()[-1])
    assert {"sherkit.robots.spherical", "sherkit.robots.delta", "sherkit.report.document"} <= set(loaded)
    for name in (*filter(None, kinds.split(",")), "machine"):
        assert (folder / f"{name}.html").stat().st_size > 50_000, name
        assert (folder / f"{name}_calibrated.toml").exists(), name


@pytest.mark.slow
def test_the_page_of_the_core_alone(core: Path, tmp_path: Path) -> None:
    """Catches a page that needs a laboratory or a tool in order to be served."""
    save_robot(EXAMPLE, tmp_path / "delta.toml")
    VirtualDelta.draw(EXAMPLE, 3).measure(grid(20.0, 6, (-18.0, 0.0, 18.0)), repeats=2).save(tmp_path / "delta.csv")
    done = asked(core, PAGE, str(tmp_path / "delta.toml"), str(tmp_path / "delta.csv"))
    assert done.stdout.split() == ["True", "True"], done.stderr[-2000:]


def test_the_core_is_named_where_it_is_not_there(core: Path) -> None:
    """Catches a robot's file that ends in a traceback where its folder is not installed."""
    done = asked(
        core, "import sys; from pathlib import Path; p = Path(sys.argv[1]); p.write_text('kind = \"serial\"\\n');"
        "from sherkit.cli import main; main(['diagnose', str(p), str(p)])", str(core / "arm.toml"),
    )  # fmt: skip
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "expected one of 'delta', 'spherical', found 'serial'" in done.stderr, done.stderr
