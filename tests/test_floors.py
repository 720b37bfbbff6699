"""The floors of the house: a module imports only from those above its own, and nothing runs in a circle."""

from __future__ import annotations

import ast
import importlib.util
import sys
from graphlib import TopologicalSorter
from pathlib import Path
from types import ModuleType

import pytest

from sources import nodes, parsed

PACKAGE = Path(__file__).parents[1] / "python" / "sherkit"
#: From the top down; CONTRIBUTING says what each is for. Rooms of one floor do not know each other.
FLOORS = (
    ("errors", "_core"), ("base",), ("data",), ("model",), ("fit",), ("evidence",), ("diagnosis",),
    ("robots",), ("planning", "calibration", "fleets"), ("study", "adaptive"), ("changes",),
    ("report", "testing"), ("__init__",), ("app",), ("cli",),
    # what the rest works without, and names nowhere but in the menu
    ("vision", "robots/serial", "robots/printer", "robots/tool"), ("lab",), ("__main__",),
)  # fmt: skip
#: The file of names that leads to them where they are there.
MENU = "__init__.py"
FLOOR = {room: k for k, rooms in enumerate(FLOORS) for room in rooms}


def imported(file: Path) -> set[str]:
    """Modules of the package that a file imports, wherever in it, as dotted names below ``sherkit``."""
    here = file.relative_to(PACKAGE).with_suffix("").parts
    modules = set()
    for node in nodes(file):
        if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").startswith("sherkit")):
            base = here[: len(here) - node.level] if node.level else ()
            name = [*base, *(node.module or "").split(".")[0 if node.level else 1 :]]
            for one in node.names:
                whole = ".".join(part for part in (*name, one.name) if part)
                modules.add(whole if exists(whole) else ".".join(part for part in name if part))
        elif isinstance(node, ast.Import):
            modules |= {one.name.removeprefix("sherkit.") for one in node.names if one.name.startswith("sherkit.")}
    return {m or "__init__" for m in modules}


def exists(module: str) -> bool:
    """Whether a dotted name is a module of the package, not a name in one."""
    path = PACKAGE.joinpath(*module.split("."))
    return path.with_suffix(".py").exists() or path.is_dir() or module == "_core"


def test_imports_run_downwards() -> None:
    """Catches a floor that looks up: a model that draws itself, a fit that knows robots, a driver in the numerics."""
    wrong = []
    for file in sorted(PACKAGE.rglob("*.py")):
        here = file.relative_to(PACKAGE)
        room = room_of(here.with_suffix("").parts)
        for module in imported(file):
            other = room_of(tuple(module.split(".")))
            looks_up = other != room and FLOOR[other] >= FLOOR[room] and str(here) != MENU
            # of such a folder the verbs alone know the command line
            of_verbs = FLOOR[room] > FLOOR["cli"] and other in ("app", "cli") and "verbs" not in here.parts
            if looks_up or (of_verbs and room != "__main__"):
                wrong.append(f"{here} imports {module}")
    assert not wrong, "\n".join(wrong)


def room_of(parts: tuple[str, ...]) -> str:
    """The room of a module by its parts: the folder of a robot where that is one of its own."""
    return two if (two := "/".join(parts[:2])) in FLOOR else parts[0]


def test_nothing_runs_in_a_circle() -> None:
    """Catches files that need each other, inside one room too."""
    graph = {}
    for file in PACKAGE.rglob("*.py"):
        name = ".".join(file.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")
        graph[name] = {m for m in imported(file) if m != name and not name.startswith(f"{m}.")}
    tuple(TopologicalSorter(graph).static_order())


def test_a_name_means_one_thing_in_its_file() -> None:
    """Catches files that were put together and had a constant of the same name: the later value is that of both."""
    twice = []
    for file in sorted(PACKAGE.rglob("*.py")):
        known = set()
        for statement in parsed(file).body:
            targets = statement.targets if isinstance(statement, ast.Assign) else ()
            names = {node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)}
            twice += [f"{file.relative_to(PACKAGE)}:{statement.lineno} {name}" for name in names & known]
            known |= names
    assert not twice, "\n".join(twice)


@pytest.fixture(scope="module")
def rust() -> ModuleType:
    """``benchmarks/rust_circles.py``, which is no package."""
    file = PACKAGE.parents[1] / "benchmarks" / "rust_circles.py"
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[file.stem] = module
    spec.loader.exec_module(module)
    return module


def in_circles(rust: ModuleType, crate: dict) -> list[list[str]]:
    """The circles of a crate, by the names of its modules."""
    graph = {path: set(rust.needs(module, crate)) for path, module in crate.items()}
    return [["::".join(path) for path in circle] for circle in rust.circles(graph)]


def test_nothing_runs_in_a_circle_in_rust(rust: ModuleType) -> None:
    """Catches Rust files that need each other: a link that needs the chain, data beside what is made of it."""
    for crate in rust.CRATES:
        assert not in_circles(rust, rust.modules(crate)), f"python benchmarks/rust_circles.py says what of rust/{crate}"


@pytest.mark.parametrize(
    ("above", "below", "expected"),
    [
        ("pub use one::One;", "pub struct One;", []),
        ("pub use one::One;\npub struct Two(One);", "use super::Two;\npub struct One;", [["", "one"]]),
        ("pub use one::One;\npub struct Two;", "pub struct One(crate::Two);", []),
        ("use one::One;\npub struct Two;", "pub struct One(super::Two);", [["", "one"]]),
        ("pub struct Two(one::One);", "pub struct One; impl One { fn two() -> crate::Two { loop {} } }", [["", "one"]]),
        ("pub struct Two(one::One);", '//! As [`super::Two`].\n/* crate::Two */ const ONE: &str = "super::Two";', []),
        ("pub struct Two(one::One);", "pub struct One;\n#[cfg(test)]\nmod tests { use super::super::Two; }", []),
        ("macro_rules! two { () => {} }\npub struct Two(one::One);", "two!();\npub struct One;", [["", "one"]]),
        ("pub mod two;\npub use two::Two;", "pub struct One(super::Two);", [["one", "two"]]),
        ("pub mod two;\nuse two as three;", "pub struct One(super::three::Two);", [["one", "two"]]),
    ],
)
def test_a_circle_in_rust_is_seen(rust: ModuleType, tmp_path: Path, above: str, below: str, expected: list) -> None:
    """Catches a reader of Rust that follows no path, or takes what a parent hands out or a comment names for one."""
    source = tmp_path / "some" / "src"
    source.mkdir(parents=True)
    (source / "lib.rs").write_text(f"mod one;\n{above}\n", encoding="utf-8")
    (source / "one.rs").write_text(below + "\n", encoding="utf-8")
    (source / "two.rs").write_text("use crate::one::One;\npub struct Two(One);\n", encoding="utf-8")
    assert in_circles(rust, rust.modules("some", tmp_path)) == expected
