"""What one who reads the way of a diagnosis walks through, and how large the house is: ``make house``.

Counts are a help to see where the code could read better; nothing fails because of them.

- Way: one ``sherkit diagnose`` of 588 × 5 rows, followed by the profiler of CPython: own functions and files that are
  entered, how often one room (folder) calls another, how deep calls are nested; and how often the costly parts of the
  work are done. Functions of the package's import are not of the way.
- House: files, lines, and functions of a complexity above 15 (McCabe's, as ruff counts it).
"""

from __future__ import annotations

import ast
import json
import subprocess
import sys
import tempfile
import tokenize
from collections import Counter
from collections.abc import Iterable
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from diagnosing import run_with_lean
from rich.console import Console
from rich.table import Table
from rust_circles import CRATES, circles, modules, needs

import sherkit as sk
from sherkit.cli import main
from sherkit.cli.demo import EXAMPLE as ROBOT

PACKAGE = Path(sk.__file__).parent
REPOSITORY = Path(__file__).parents[1]
#: Lines from which on a file is long, and complexity from which on a function is.
LONG, COMPLEX = 450, 15
#: What is costly on the way, by the functions that do it.
COSTLY: dict[str, tuple[Any, ...]] = {
    "robot's file read": (1, "load_robot"),
    "fits": (3, "identify"),
    "Jacobians": (6, "DeltaModel.derivatives"),
    "families of columns": (2, "Family.__init__"),
    "times that columns enter a model": (40, "Base.with_columns"),
}


class Way:
    """What a call enters: own functions and files, changes of room, depth."""

    def __init__(self) -> None:
        self.calls: Counter[CodeType] = Counter()
        self.core: Counter[str] = Counter()
        self.between: Counter[tuple[str, str]] = Counter()
        self.depth = self.deepest = 0

    def follow(self, work: Any) -> None:
        """Does it, and looks."""
        sys.setprofile(self._seen)
        try:
            work()
        finally:
            sys.setprofile(None)

    def count(self, *functions: str) -> int:
        """How often functions of the package or the core were called, by their qualified names."""
        own = sum(n for code, n in self.calls.items() if code.co_qualname in functions)
        return own + sum(self.core[name] for name in functions)

    def _seen(self, frame: FrameType, event: str, arg: Any) -> None:
        if event == "c_call" and "_core" in f"{arg.__module__} {type(arg.__self__).__module__}":
            self.core[arg.__qualname__] += 1
        code = frame.f_code
        if not code.co_filename.startswith(str(PACKAGE)) or code.co_name.startswith("<"):
            return
        if event == "return":
            self.depth -= 1
        elif event == "call":
            self.depth += 1
            self.deepest = max(self.deepest, self.depth)
            self.calls[code] += 1
            caller = frame.f_back
            while caller is not None and not caller.f_code.co_filename.startswith(str(PACKAGE)):
                caller = caller.f_back
            if caller is not None and room(caller.f_code) != room(code):
                self.between[room(caller.f_code), room(code)] += 1


def called(arguments: list[str]) -> None:
    """A verb, in this process."""
    with redirect_stdout(StringIO()), suppress(SystemExit):
        main(arguments)


def room(code: CodeType) -> str:
    """The folder of a function's file."""
    return str(Path(code.co_filename).parent.relative_to(PACKAGE)) or "."


def followed() -> Way:
    """The way of a diagnosis whose modules are loaded."""
    with tempfile.TemporaryDirectory() as folder:
        robot, run = Path(folder) / "robot.toml", Path(folder) / "run.csv"
        sk.save_robot(ROBOT, robot)
        run_with_lean(5).to_frame().write_csv(run)
        called(["diagnose", str(robot), str(run)])
        way = Way()
        way.follow(lambda: called(["diagnose", str(robot), str(run)]))
    return way


def lines(folder: Path, *endings: str) -> dict[Path, int]:
    """Lines of each file."""
    files = (path for ending in endings for path in folder.rglob(f"*{ending}"))
    return {path: len(path.read_text().splitlines()) for path in files if "target" not in path.parts}


#: Rooms that ask what is missing, and names that tokens are counted without.
ASKING = ("evidence", "diagnosis", "adaptive", "changes", "planning", "fit")
LAYOUT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}


def files_of(rooms: Iterable[str]) -> list[Path]:
    """Python files of these rooms."""
    return [path for room in rooms for path in sorted((PACKAGE / room).rglob("*.py"))]


def tokens(path: Path) -> int:
    """Tokens of a file, comments apart, so that no formatter helps."""
    with path.open(encoding="utf-8") as file:
        return sum(one.type not in LAYOUT for one in tokenize.generate_tokens(file.readline))


def numbers(path: Path) -> int:
    """Numbers that stand at the head of a module, in whatever they stand there."""
    heads = (
        one.value for one in ast.parse(path.read_text("utf-8")).body if isinstance(one, ast.Assign | ast.AnnAssign)
    )
    every = (node for head in heads if head is not None for node in ast.walk(head))
    return sum(isinstance(n, ast.Constant) and type(n.value) in (int, float) for n in every)


def imported(path: Path) -> int:
    """Names of the house that a file imports."""
    found = (node for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.ImportFrom))
    return sum(len(node.names) for node in found if node.level or (node.module or "").startswith("sherkit"))


def complex_functions() -> int:
    """How many functions of the package are hard to follow."""
    ruff = Path(sys.executable).parent / "ruff"
    config = f"lint.mccabe.max-complexity={COMPLEX}"
    arguments = [ruff, "check", "--isolated", "--select", "C901", "--config", config, "--output-format", "json"]
    return len(json.loads(subprocess.run([*arguments, PACKAGE], capture_output=True, text=True).stdout))


def circles_in_rust() -> int:
    """How many sets of Rust files need each other."""
    crates = [modules(crate) for crate in CRATES]
    return sum(len(circles({name: set(needs(one, crate)) for name, one in crate.items()})) for crate in crates)


@dataclass(frozen=True)
class House:
    """The product as a reader meets it, in the commit whose package stands at ``package``."""

    files: int
    core_lines: int
    tokens: int
    tests_tokens: int
    functions: int
    classes: int
    names_twice: int
    median_imported: int
    most_imported: int

    @classmethod
    def of(cls, package: Path, tests: Path) -> House:
        """Counted from the files."""
        files = sorted(package.rglob("*.py"))
        trees = [ast.parse(path.read_text("utf-8")) for path in files]
        nodes = [node for tree in trees for node in ast.walk(tree)]
        names = Counter(node.name for node in nodes if isinstance(node, ast.ClassDef))
        names_in = sorted(map(imported, files))
        core = [path for path in files if not path.relative_to(package).as_posix().startswith(BESIDE_THE_CORE)]
        return cls(
            len(files), sum(len(path.read_text("utf-8").splitlines()) for path in core), sum(map(tokens, files)),
            sum(map(tokens, tests.rglob("*.py"))),
            sum(isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) for node in nodes), sum(names.values()),
            sum(count > 1 for count in names.values()), names_in[len(names_in) // 2], names_in[-1],
        )  # fmt: skip

    @classmethod
    def at(cls, commit: str) -> House | None:
        """That of another commit; None where this is no clone that has it."""
        with tempfile.TemporaryDirectory() as folder:
            packed = subprocess.run(
                ["git", "archive", commit, "python/sherkit", "tests"], cwd=REPOSITORY, capture_output=True
            )  # fmt: skip
            if packed.returncode:
                return None
            subprocess.run(["tar", "-x", "-C", folder], input=packed.stdout, check=True)
            return cls.of(Path(folder) / "python" / "sherkit", Path(folder) / "tests")


#: Which commit the house is compared with, folders that the core works without, and what of each count would read well.
BEFORE = "9636955"
BESIDE_THE_CORE = ("robots/serial", "robots/printer", "robots/tool", "lab", "vision")
AIMS = House(200, 25_000, 375_000, 0, 3_100, 350, 0, 6, 25)


def table(title: str, rows: dict[str, tuple[int | None, ...]], *heads: str) -> None:
    """Prints counts beside what would read well."""
    drawn = Table(title=title, title_justify="left", show_edge=False)
    drawn.add_column("")
    for head in (*heads, "now", "aim"):
        drawn.add_column(head, justify="right")
    for name, counts in rows.items():
        drawn.add_row(name, *("" if one is None else f"{one:,}" for one in counts))
    Console().print(drawn, "")


if __name__ == "__main__":
    way = followed()
    table(
        "The way of one diagnosis, 588 × 5 rows",
        {
            "own functions": (len(way.calls), 400),
            "files": (len({code.co_filename for code in way.calls}), 45),
            "rooms": (len({room(code) for code in way.calls}), 9),
            "calls": (sum(way.calls.values()), None),
            "calls from room to room": (sum(way.between.values()), 200),
            "depth": (way.deepest, 15),
            **{name: (way.count(*of), aim) for name, (aim, *of) in COSTLY.items()},
        },
    )
    asking = files_of(ASKING)
    table(
        "Rooms that ask what is missing",
        {
            **{f"tokens of {name}/": (sum(map(tokens, files_of([name]))), None) for name in ASKING},
            "tokens in all": (sum(map(tokens, asking)), 84_500),
            "lines in all": (sum(len(path.read_text("utf-8").splitlines()) for path in asking), 9_700),
            "numbers at the heads of modules": (sum(map(numbers, asking)), 80),
            "most names of the house that a file imports": (max(map(imported, asking)), 20),
        },
    )
    python = lines(PACKAGE, ".py")
    rust = lines(REPOSITORY / "rust", ".rs")
    tests = lines(REPOSITORY / "tests", ".py")
    long = {path: n for path, n in (python | rust).items() if n > LONG}
    now, before = House.of(PACKAGE, REPOSITORY / "tests"), House.at(BEFORE)
    aims = replace(AIMS, tests_tokens=round(0.8 * before.tests_tokens) if before else 0)
    said = {
        "files": "Python files", "core_lines": f"lines of the core (without {', '.join(BESIDE_THE_CORE)})",
        "tokens": "tokens, comments apart", "tests_tokens": "tokens of the tests", "functions": "functions",
        "classes": "classes", "names_twice": "names of classes that stand twice or more",
        "median_imported": "names of the house that a file imports, median", "most_imported": "and most",
    }  # fmt: skip
    table(
        "The product",
        {
            text: (getattr(before, name) if before else None, getattr(now, name), getattr(aims, name))
            for name, text in said.items()
        },
        BEFORE,
    )
    table(
        "Its files",
        {
            "lines of Python": (sum(python.values()), None),
            "lines of Rust": (sum(rust.values()), None),
            "lines of tests": (sum(tests.values()), None),
            f"files above {LONG} lines": (len(long), 0),
            f"functions of a complexity above {COMPLEX}": (complex_functions(), 20),
            "circles between files of Rust": (circles_in_rust(), 0),
            "places that ask whether a robot is a tool": (sum(p.read_text().count("is_tool") for p in python), 0),
        },
    )
    for path, n in sorted(long.items(), key=lambda item: -item[1]):
        print(f"{n:5}  {path.relative_to(REPOSITORY) if path.is_relative_to(REPOSITORY) else path.name}")
