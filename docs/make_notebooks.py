"""Executes a notebook for each robot: ``python docs/make_notebooks.py FOLDER``.

The notebooks stand in ``docs/notebooks`` as Python files, a cell behind each ``# %%``. What they read is simulated
first. Each is written to FOLDER as ``.ipynb`` with what it drew, and as a page that opens without a network.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import nbformat
from nbclient import NotebookClient
from nbconvert import HTMLExporter

from sherkit.cli.verbs import cli
from sherkit.model.kinds import known_kinds
from sherkit.model.robot_file import save_robot
from sherkit.robots.tool.tool import FlexibleTool
from sherkit.robots.tool.virtual import VirtualTool

SOURCES = Path(__file__).parent / "notebooks"
#: What hides in the machine of each notebook, as options of ``sherkit simulate``.
HIDDEN = {
    "delta": ["--poses", "whole", "--rail-lean-mrad", "8"],
    "spherical": ["--poses", "local", "--joint-offset-mrad", "2", "--unequal-limbs-mrad", "3"],
    "serial": ["--yield-mrad", "0.6"],
}


_FETCHED = re.compile(r'<script[^>]*src="https?:[^>]*></script>')


def simulated(folder: Path) -> None:
    """What the notebooks read: of each robot its file and a run, of the tool a run."""
    for name, options in HIDDEN.items():
        robot, run = folder / f"{name}.toml", folder / f"{name}.csv"
        save_robot(known_kinds()[name].example, robot)
        more = ["--repeats", "2", "--order", "shuffled", "--seed", "3", *options]
        cli.main(["simulate", str(robot), "-o", str(run), *more], standalone_mode=False)
    tool = FlexibleTool()
    tool.save(folder / "tool.toml")
    VirtualTool(tool, camera_warp_mm=0.0).changed(camera_delay_s=0.02).run("vessels", seed=1).save(folder / "tool.csv")


def cells(source: Path) -> nbformat.NotebookNode:
    """The notebook that a file describes."""
    made = nbformat.v4.new_notebook(metadata={"title": source.stem})
    for part in source.read_text(encoding="utf-8").split("# %%")[1:]:
        head, _, text = part.partition("\n")
        if "markdown" in head:
            lines = [line.removeprefix("#").removeprefix(" ") for line in text.strip().splitlines()]
            cell = nbformat.v4.new_markdown_cell("\n".join(lines))
        else:
            cell = nbformat.v4.new_code_cell(text.strip())
        # the same notebook each time that it is made
        cell["id"] = f"cell-{len(made.cells)}"
        made.cells.append(cell)
    return made


def make(folder: Path, names: list[str] | None = None) -> list[Path]:
    """Executes them, all or these, and returns the pages."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = []
    with TemporaryDirectory() as there:
        simulated(Path(there))
        for source in sorted(SOURCES.glob("*.py")):
            if names is not None and source.stem not in names:
                continue
            made = cells(source)
            NotebookClient(made, timeout=300, resources={"metadata": {"path": there}}).execute()
            nbformat.write(made, folder / f"{source.stem}.ipynb")
            # what shows formulas and widgets would be fetched; these have none
            exporter = HTMLExporter(template_name="lab", mathjax_url="", require_js_url="")
            text, _ = exporter.from_notebook_node(made)
            pages.append(folder / f"{source.stem}.html")
            pages[-1].write_text(_FETCHED.sub("", text), encoding="utf-8")
    return pages


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    for page in make(Path(sys.argv[1])):
        print(page)
