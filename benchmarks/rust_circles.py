"""Circles between the Rust modules: files that need each other.

``python benchmarks/rust_circles.py`` prints, for each crate of ``rust``, the sets of files in which each needs each
other, with the names on the way, and ends with 1 where there is one.

A file needs another where a path of it (in ``use`` or in its code, ``crate::``, ``super::``, ``self::``, a child or a
name brought by ``use``) ends at an item that is written there. A path is followed through re-exports to the file that
has the item, so a parent that hands out what its children hold is in no circle, and neither is ``mod child;``. Only
where a parent's own code says a name does it need the file of that name. Tests within a file, comments, links of the
documentation and strings are not read. What is called by a method or named by a trait alone has no path, and is not
seen: an ``impl`` in two files is two files that do not know each other here, where they may call each other.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

RUST = Path(__file__).parents[1] / "rust"
CRATES = ("core", "python", "c", "header")
Path_ = tuple[str, ...]

_NOT_CODE = re.compile(
    r"//[^\n]*|/\*.*?\*/|b?r(?P<n>#*)\".*?\"(?P=n)|b?\"(?:\\.|[^\"\\])*\"|b?'(?:\\.[^']*|[^\\'])'", re.DOTALL
)
_USE = re.compile(r"(\bpub(?:\([^)]*\))?\s+)?\buse\s+([^;]+);")
_MOD = re.compile(r"(#\[cfg\(test\)\]\s*)?\b(?:pub(?:\([^)]*\))?\s+)?mod\s+(\w+)\s*([;{])")
_MACRO = re.compile(r"\bmacro_rules!\s*(\w+)")
_NAMED = re.compile(r"(?<![\w:.$])\$?\b[A-Za-z_]\w*(?:\s*::\s*\w+)*!?")


def block(code: str, opening: int) -> int:
    """Where the block ends that opens with a brace at this place."""
    depth = 0
    for end in range(opening, len(code)):
        depth += {"{": 1, "}": -1}.get(code[end], 0)
        if not depth:
            return end + 1
    raise ValueError("a brace is not closed")


def leaves(tree: str, root: Path_ = ()) -> Iterator[tuple[str, Path_]]:
    """Names that a ``use`` brings with the path of each: ``a::{self, b as c}`` brings a and c."""
    tree = tree.strip()
    if tree.endswith("}"):
        head, _, inner = tree[:-1].partition("{")
        within = (*root, *(part.strip() for part in head.split("::") if part.strip()))
        depth, piece = 0, ""
        for sign in f"{inner},":
            depth += {"{": 1, "}": -1}.get(sign, 0)
            if sign == "," and not depth:
                if piece.strip():
                    yield from leaves(piece, within)
                piece = ""
            else:
                piece += sign
    else:
        path, _, name = tree.partition(" as ")
        parts = (*root, *(part.strip() for part in path.split("::")))
        if parts[-1] == "self" and len(parts) > 1:
            parts = parts[:-1]
        yield (name.strip() or parts[-1]), parts


class Module:
    """One file: its children, what ``use`` brings, and the paths and names that its code says."""

    def __init__(self, file: Path, name: Path_) -> None:
        self.file, self.name = file, name
        code = _NOT_CODE.sub(" ", file.read_text(encoding="utf-8"))
        self.children: list[str] = []
        while found := next((m for m in _MOD.finditer(code) if m[1] or m[3] == ";"), None):
            end = found.end() if found[3] == ";" else block(code, found.end() - 1)
            if found[3] == ";":
                self.children.append(found[2])
            code = code[: found.start()] + code[end:]
        self.brought: dict[str, Path_] = {}
        self.handed_out: set[str] = set()
        for use in _USE.finditer(code):
            names = dict(leaves(use[2]))
            self.brought |= names
            self.handed_out |= set(names) if use[1] else set()
        self.macros = set(_MACRO.findall(code))
        body = _USE.sub(" ", code)
        self.said = {tuple(re.split(r"\s*::\s*", path.lstrip("$"))) for path in _NAMED.findall(body)}


def modules(crate: str, rust: Path = RUST) -> dict[Path_, Module]:
    """All files of a crate by the path of their module."""
    source = rust / crate / "src"
    root = next(f for f in (source / "lib.rs", source / "main.rs") if f.exists())
    found: dict[Path_, Module] = {}

    def read(file: Path, name: Path_) -> None:
        found[name] = module = Module(file, name)
        here = file.parent if file.name in ("mod.rs", "lib.rs", "main.rs") else file.with_suffix("")
        for child in module.children:
            whole = here / f"{child}.rs"
            read(whole if whole.exists() else here / child / "mod.rs", (*name, child))

    read(root, ())
    return found


def home(of: Module, path: Path_, crate: dict[Path_, Module], asked: frozenset[Path_] = frozenset()) -> Path_ | None:
    """The module that has the item at the end of a path; none where it is no item of this crate, or a module."""
    at, first, rest = of.name, path[0], path[1:]
    if first in ("crate", "self", "super"):
        at = {"crate": (), "self": at, "super": at[:-1]}[first]
    elif (*at, first) in crate:
        at = (*at, first)
    elif first in of.brought and (*at, first) not in asked:
        return home(of, (*of.brought[first], *rest), crate, asked | {(*at, first)})
    else:
        return None
    while rest and (rest[0] == "super" or (*at, rest[0]) in crate):
        at = at[:-1] if rest[0] == "super" else (*at, rest[0])
        rest = rest[1:]
    if not rest:
        return None
    if rest[0] in crate[at].brought:
        through = home(crate[at], rest, crate, asked)
        return at if through is None and crate[at].brought[rest[0]] == (rest[0],) else through
    return at


def needs(of: Module, crate: dict[Path_, Module]) -> dict[Path_, set[str]]:
    """The modules that a file needs, each with the names for which it does."""
    owners = {macro: name for name, module in crate.items() for macro in module.macros}
    said = {path for path in of.said if not path[-1].endswith("!")}
    heads = {path[0] for path in said}
    found: dict[Path_, set[str]] = {}
    for path in said:
        if (other := home(of, path, crate)) is not None:
            found.setdefault(other, set()).add("::".join(path))
    for name, path in of.brought.items():
        # handing out is not needing; what is brought for this file alone is, if only a trait for its methods
        if (name in heads or name not in of.handed_out) and (other := home(of, path, crate)) is not None:
            found.setdefault(other, set()).add(name)
    for macro in {path[0] for path in of.said if len(path) == 1 and path[0].endswith("!")}:
        if macro.rstrip("!") in owners:
            found.setdefault(owners[macro.rstrip("!")], set()).add(macro)
    found.pop(of.name, None)
    return found


def circles(graph: dict[Path_, set[Path_]]) -> list[list[Path_]]:
    """Sets of modules in which each is reached from each other."""
    reached = {}
    for start in graph:
        seen: set[Path_] = set()
        ahead = set(graph[start])
        while ahead:
            one = ahead.pop()
            if one not in seen:
                seen.add(one)
                ahead |= graph[one] - seen
        reached[start] = seen
    found = {frozenset({a, *(b for b in reached[a] if a in reached[b])}) for a in graph if a in reached[a]}
    return sorted(sorted(one) for one in found)


def main() -> int:
    """Prints the circles of every crate, with who needs what of whom."""
    wrong = 0
    for name in CRATES:
        crate = modules(name)
        graph = {path: needs(module, crate) for path, module in crate.items()}
        found = circles({path: set(others) for path, others in graph.items()})
        wrong += len(found)
        print(f"rust/{name}: {len(crate)} modules, {sum(map(len, graph.values()))} arrows, {len(found)} circles")
        for circle in found:
            for one in circle:
                for other in sorted(set(graph[one]) & set(circle)):
                    words = ", ".join(sorted(graph[one][other]))
                    print(f"    {'::'.join(one) or 'lib'} needs of {'::'.join(other) or 'lib'}: {words}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
