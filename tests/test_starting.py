"""What is loaded when: a program that imports sherkit, or asks a command something small, waits for nothing else."""

from __future__ import annotations

import ast
import json
import pickle
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import sherkit as sk

#: Takes a tenth of a second or more to load.
SLOW = {"numpy", "scipy", "polars", "rich", "bokeh", "jinja2", "cv2", "serial", "pandas"}
PACKAGES = ("sherkit", "sherkit.lab", "sherkit.robots.serial", "sherkit.robots.printer", "sherkit.robots.tool")


def loaded_by(code: str, *arguments: str) -> set[str]:
    """Modules that are there after a program of its own."""
    told = "\nimport sys, json\nprint('\\n' + json.dumps(sorted(sys.modules)))"
    program = [sys.executable, "-c", code + told, *arguments]
    answer = subprocess.run(program, capture_output=True, text=True, check=True)
    return set(json.loads(answer.stdout.splitlines()[-1]))


def command(*typed: str) -> str:
    """A program that runs a command and goes on."""
    return f"from sherkit.cli import main\ntry:\n    main({list(typed)!r})\nexcept SystemExit:\n    pass"


def test_the_import_alone_loads_nothing_that_is_slow() -> None:
    """Catches ``import sherkit`` that loads NumPy, SciPy, a table reader, what draws, or instruments, before anything
    was asked."""
    loaded = loaded_by("import sherkit")
    assert not loaded & {*SLOW, "click", "concurrent.futures", "subprocess"}
    assert not {name for name in loaded if name.startswith(("sherkit._core", "sherkit.lab."))}


@pytest.mark.parametrize("typed", [["--version"], ["diagnoze"]])
def test_a_small_question_loads_nothing_that_is_slow(typed: list[str]) -> None:
    """Catches a command that loads all verbs in order to say its version, or that there is no such verb."""
    loaded = loaded_by(command(*typed))
    assert not loaded & SLOW
    assert typed != ["--version"] or "click" not in loaded
    # the group that answers, and what groups have in common
    of_groups = {"sherkit.cli.verbs", "sherkit.cli.groups"}
    assert not {name for name in loaded if name.startswith("sherkit.cli.")} - of_groups


def test_a_diagnosis_loads_neither_what_draws_nor_the_tool_nor_drivers() -> None:
    """Catches a verb that loads what it does not use: pictures, instruments, the flexible tool, SciPy's slow rooms."""
    loaded = loaded_by("import sherkit.cli.diagnose")
    assert not loaded & {"bokeh", "jinja2", "cv2", "serial", "rich.progress"}
    slow = ("scipy.stats", "scipy.optimize", "scipy.signal", "scipy.spatial", "scipy.sparse")
    assert not {name for name in loaded if name.startswith(slow)}
    assert not {name for name in loaded if name.startswith(("sherkit.robots.tool.", "sherkit.lab", "sherkit.report"))}


@pytest.mark.parametrize("package", PACKAGES)
def test_what_types_see_is_what_is_there(package: str) -> None:
    """Catches a door whose imports for readers of types and whose table for Python say different things."""
    module = import_module(package)
    source = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
    static = next(n for n in source.body if isinstance(n, ast.If) and "TYPE_CHECKING" in ast.unparse(n.test))
    names = set()
    for line in static.body:
        assert isinstance(line, ast.ImportFrom)
        seen: dict[str, object] = {"__package__": package, "__name__": package}
        exec(ast.unparse(line), seen)
        for one in line.names:
            names.add(one.name)
            assert getattr(module, one.name) is seen[one.name], one.name
            assert line.module or isinstance(seen[one.name], ModuleType), one.name
    assert names == set(dir(module))
    assert set(module.__all__) <= names


def test_the_door_is_like_any_module() -> None:
    """Catches names that cannot be listed, pickled or taken with a star, and a wrong name that is not refused."""
    assert pickle.loads(pickle.dumps(sk.diagnose)) is sk.diagnose
    assert pickle.loads(pickle.dumps(sk.Study)) is sk.Study
    taken: dict[str, object] = {}
    exec("from sherkit import *", taken)
    assert set(sk.__all__) <= set(taken)
    with pytest.raises(AttributeError, match="module 'sherkit' has no attribute 'diagnoze'"):
        sk.diagnoze  # noqa: B018  # type: ignore[attr-defined]
    with pytest.raises(ImportError, match="diagnoze"):
        exec("from sherkit import diagnoze", {})


#: Programs that begin with one file of sherkit, and go on.
PROGRAMS = [
    # a function is not hidden by the file of its name, once something has loaded that
    "import sherkit.cli.calibrate, sherkit.cli.diagnose, sherkit as sk\n"
    "assert all(callable(getattr(sk, n)) for n in ('calibrate', 'diagnose', 'effect', 'identify'))",
    "from sherkit.data.columns import layout_of\nassert layout_of(['q1_mm', 'x_mm']).joints[0] == 'q1_mm'",
    "from sherkit.data import from_frame\n"
    "from_frame({k: [0.0, 1.0] for k in ('q1_mm', 'q2_mm', 'q3_mm', 'x_mm', 'y_mm', 'z_mm')})",
    "from sherkit.model.kinds import known_kinds\n"
    "assert list(known_kinds()) == ['delta', 'spherical', 'serial', 'printer']",
    "from sherkit.model.kinds import register, known_kinds\nfrom dataclasses import replace\n"
    "from sherkit.robots.delta import KIND\nregister(replace(KIND, name='own'))\n"
    "assert list(known_kinds()) == ['delta', 'spherical', 'serial', 'printer', 'own']",
    "import tempfile\nfrom sherkit.robots.serial.imported import import_dh\n"
    "open((f := tempfile.mkdtemp() + '/arm.csv'), 'w').write('d_mm,a_mm,alpha_deg\\n' + '90,200,0\\n' * 6)\n"
    "import_dh(f)\nfrom sherkit.data.columns import layout_of\nassert layout_of(['t']).joints[0] == 'q1_mm'",
]


@pytest.mark.slow
def test_a_program_may_begin_with_any_file() -> None:
    """Catches ``sk.calibrate`` that is a module; a file of runs or a robot that is not understood, since nobody has
    asked for the robots before. All in one process, which forgets sherkit in between."""
    forgets = "[sys.modules.pop(n) for n in list(sys.modules) if n.startswith('sherkit') and n != 'sherkit._core']"
    loaded_by("import sys\n" + "\n".join(f"exec({code!r}, {{}})\n{forgets}" for code in PROGRAMS))


def test_every_verb_says_its_help_where_nothing_extra_is_installed() -> None:
    """Catches a verb that loads what only an extra brings: the plain wheel then has no ``sherkit --help`` at all."""
    code = """
import sys
for name in ("bokeh", "jinja2", "cv2", "serial", "pyvisa", "pymeasure", "ophyd", "rosbags", "pandas", "tornado"):
    sys.modules[name] = None
import click
from sherkit.cli.verbs import cli
asked = [(cli, [])]
while asked:
    verb, words = asked.pop()
    context = click.Context(verb, info_name=" ".join(["sherkit", *words]))
    assert verb.get_help(context).startswith("Usage"), words
    if isinstance(verb, click.Group):
        asked += [(verb.get_command(context, name), [*words, name]) for name in verb.list_commands(context)]
    context.close()
for words in (["effects"], ["effects", "rail_lean"], ["--help"]):
    cli.main(words, standalone_mode=False)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr[-800:]
    assert "rail_lean" in done.stdout
