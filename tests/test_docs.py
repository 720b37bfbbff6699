"""README, CONTRIBUTING and the stories: what they show runs, what they name exists."""

from __future__ import annotations

import ast
import asyncio
import contextlib
import importlib
import io
import json
import re
import runpy
import shlex
import shutil
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import click
import numpy as np
import pytest
from tornado.ioloop import IOLoop

import sherkit as sk
from running import parse, slow
from second_machines import apart
from sherkit import SherkitWarning, load_robot
from sherkit.cli import main
from sherkit.cli.demo import EXAMPLE
from sherkit.diagnosis import Diagnosis

HERE = Path(__file__).parents[1]
STORIES = ("docs/tutorial.md", "docs/spherical.md", "docs/tool.md", "docs/machine.md", "docs/arm.md")
REFERENCE = ("docs/files.md", "docs/json.md", "docs/page.md", "docs/calibration.md", "docs/study.md", "docs/models.md",
             "docs/accuracy.md", "docs/fleet.md", "docs/printer.md")  # fmt: skip
DOCS = (
    "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "benchmarks/README.md", "docs/laboratory.md", *REFERENCE, *STORIES,
)  # fmt: skip

_BLOCK = re.compile(r"^( *)```(\w*)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
_INLINE = re.compile(r"`([^`\n]+)`")
_NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
MACHINE = re.compile(r"(?<![\w.:/])(?:/(?:home|root|tmp|work|usr|var|opt|mnt|Users)/|[A-Z]:\\|~/)[^\s)`]*")
_BOX = re.compile(r"[─━│┃┏┓┗┛┡┩└┘├┤┼╇┴┳]+")


@dataclass(frozen=True)
class Block:
    """A fenced block: where it starts, its language, its text."""

    place: str
    language: str
    text: str


def text_of(name: str) -> str:
    """A document."""
    return (HERE / name).read_text(encoding="utf-8")


def blocks(name: str) -> list[Block]:
    """Fenced blocks of a document, in order."""
    text = text_of(name)
    out = []
    for found in _BLOCK.finditer(text):
        indent = found[1]
        body = "".join(line.removeprefix(indent) for line in found[3].splitlines(keepends=True))
        out.append(Block(f"{name}:{text[: found.start()].count(chr(10)) + 1}", found[2], body))
    return out


def prose(name: str) -> str:
    """A document without its fenced blocks."""
    return _BLOCK.sub("", text_of(name))


def command(line: str) -> list[str] | None:
    """Arguments of a line that calls sherkit, without its comment; None for another line."""
    words = shlex.split(line, comments=True)
    return words[1:] if words[:1] == ["sherkit"] else None


def commands(name: str) -> list[list[str]]:
    """Every call of sherkit in a document, each once: those of its blocks in order, then those in its prose."""
    fenced = [line for b in blocks(name) if b.language in ("", "sh") for line in b.text.splitlines()]
    found = [command(line) for line in (*fenced, *(m[1] for m in _INLINE.finditer(prose(name))))]
    out: list[list[str]] = []
    for arguments in found:
        if arguments and arguments not in out:
            out.append(arguments)
    return out


def sherkit(arguments: list[str], folder: Path) -> str:
    """What the command says in ``folder``; it must go well. In this process, since starting one takes longer. A page is
    served until it would be opened; ``test_page.py`` looks at it."""
    said, wrong = io.StringIO(), io.StringIO()
    served = arguments[0] == "app" and "--help" not in arguments
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(wrong),
        patch("webbrowser.open", lambda _: IOLoop.current().stop()),
        pytest.raises(SystemExit) as end,
    ):
        main([*arguments, "--port", "0"] if served else arguments)
    assert end.value.code == 0, f"sherkit {shlex.join(arguments)}: {wrong.getvalue()}"
    assert not served or "the page is at http://" in said.getvalue()
    return said.getvalue()


def run_python(block: Block, names: dict[str, Any]) -> str:
    """What a block prints. A block that starts with ``# name.py`` is also written to that file."""
    file = re.match(r"# (\w+\.py)\n", block.text)
    if file:
        Path(file[1]).write_text(block.text, encoding="utf-8")
    said = io.StringIO()
    # what is left out of a calibration is warned of, and the tutorial says so
    with contextlib.redirect_stdout(said), warnings.catch_warnings():
        warnings.simplefilter("ignore", SherkitWarning)
        exec(compile(block.text, block.place, "exec"), names)
    return said.getvalue()


def plain(text: str) -> str:
    """Text with every number as ``#``, without rules and boxes, and with single spaces."""
    return " ".join(_BOX.sub(" ", _NUMBER.sub("#", text)).split())


#: What the page on the JSON shows; run where its keys are compared.
_AS_JSON = ["diagnose", "demo/robot.toml", "demo/whole.csv", "--json"]

# -- what they show runs -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["README.md", *sorted(f"docs/{path.name}" for path in (HERE / "docs").glob("*.md"))])
def test_what_is_shown_is_known(name: str) -> None:
    """Catches a verb, an option, a module or a public name that is gone, on any page; that pages run is asked below."""
    for arguments in commands(name):
        if arguments[0].isupper() or arguments[0].startswith("-"):
            continue
        # one that is only named must exist; a word may stand for another, or for the rest
        with contextlib.suppress(click.BadParameter):
            parse([*arguments, "--help"] if len(arguments) == 1 else arguments)
    for block in blocks(name):
        if block.language != "python":
            continue
        for node in ast.walk(ast.parse(block.text)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("sherkit"):
                module = importlib.import_module(node.module or "")
                assert all(hasattr(module, one.name) for one in node.names), block.place
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "sk":
                assert hasattr(sk, node.attr), f"{block.place}: sk.{node.attr}"


@pytest.mark.parametrize("name", ["README.md", *slow(*REFERENCE)])
def test_what_is_shown_runs(name: str, work: Path) -> None:
    """Catches an example that a rename has broken: a reader copies it first."""
    names: dict[str, Any] = {}
    said = [run_python(b, names) for b in blocks(name) if b.language == "python"]
    shown = commands(name)
    if name == "README.md":
        assert said, "no Python was found; has the fence changed?"
        assert shown, "no command was found"
    ran = [["demo"]]
    if name == "README.md":
        assert said[0].startswith("explained ('rail_lean',)\n")
    if name == "docs/study.md":
        assert any("adequate\n" in one for one in said)
    if name == "docs/json.md":
        ran.append(_AS_JSON)
    for arguments in shown:
        # a command that is only named must exist
        if arguments in ran:
            continue
        sherkit([*arguments, "--help"] if len(arguments) == 1 else arguments, work)


@pytest.mark.slow
def test_the_answer_of_the_front_page_is_what_is_printed(made_whole: Path) -> None:
    """Catches figures or words of the README that a diagnosis of the demo no longer says."""
    answer = next(b.text for b in blocks("README.md") if b.language == "console").splitlines()
    told = " ".join(sherkit(command(answer[0].removeprefix("$ ")) or [], made_whole).split())
    assert told.startswith(" ".join(" ".join(answer[1:]).split()))


def test_the_first_commands_work_in_a_fresh_clone() -> None:
    """Catches a command of the README above the one that builds what it needs: wheel, command, the demo's files."""
    lines = [one for b in blocks("README.md") for one in b.text.splitlines()]
    built = next(k for k, line in enumerate(lines) if line.split("#")[0].strip() == "make demo")
    needs = re.compile(r"target/|demo/|^(\$ )?sherkit |import sherkit|pip install")
    early = [line for line in lines[:built] if needs.search(line)]
    assert early == []
    assert any(needs.search(line) for line in lines[built:])


@pytest.mark.slow
def test_the_gallery_is_what_its_script_draws(work: Path) -> None:
    """Catches a picture that a rename has broken, and a page that shows other lines than those that made it."""
    script = runpy.run_path(str(HERE / "docs" / "draw_gallery.py"))
    page = text_of("docs/gallery.md")
    names: dict[str, dict[str, Any]] = {}
    imports = ""
    for item in script["ITEMS"]:
        if item.setup not in names:
            names[item.setup] = script["prepared"](item.setup)
        *before, last = item.lines.splitlines()
        imports += "".join(line + "\n" for line in before if line.startswith("from"))
        exec("\n".join([imports, *before]), names[item.setup])
        assert eval(last, names[item.setup]).sources, item.title
        assert f"## {item.title}\n" in page
        assert script["_shown"](item.lines) in page, item.title
        assert (HERE / "docs" / "pictures" / "gallery" / f"{item.file}.png").is_file()


@pytest.mark.slow
def test_the_pages_pictures_say_what_it_says(made_whole: Path, tmp_path: Path) -> None:
    """Catches a picture with figures or sentences that the page no longer shows."""
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")
    pytest.importorskip("bokeh", reason="the page needs Bokeh")
    from bokeh.document import Document

    from sherkit.app.page import StudyPage
    from sherkit.app.workbench import Workbench

    async def said(bench: Workbench) -> str:
        page = StudyPage(Document(), bench, "")
        return "\n".join(page.document.get_model_by_name(name).text for name in ("numbers", "headline"))

    folder = made_whole / "demo"
    bench = Workbench.open(folder / "robot.toml", folder / "whole.csv", tmp_path / "page.study")
    try:
        for name, before in (("page_found", None), ("page", "rail_lean")):
            if before:
                bench.toggle(before).result()
            bench.diagnose().result()
            shown = asyncio.run(said(bench))
            for ending in ("", "_tablet", "_phone"):
                with image.open(HERE / "docs" / "pictures" / f"{name}{ending}.png") as drawn:
                    assert drawn.text["said"] == shown, "stale: run make pictures"
    finally:
        bench.close()


@pytest.mark.slow
@pytest.mark.parametrize("story", STORIES)
def test_a_story_runs(story: str, made_whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a tutorial that stops working half way, or that promises another verdict than sherkit gives."""
    monkeypatch.chdir(tmp_path)
    with apart():
        _run(story, made_whole, tmp_path)


def _run(story: str, made_whole: Path, tmp_path: Path) -> None:
    names: dict[str, Any] = {}
    said = ""
    quoted = 0
    for block in blocks(story):
        if block.language == "python":
            said = run_python(block, names)
        elif block.language == "sh":
            calls = [command(line) for line in block.text.splitlines()]
            assert None not in calls, f"{block.place}: a line that is no call of sherkit"
            if ["demo"] in calls:  # it was run already
                shutil.copytree(made_whole / "demo", tmp_path / "demo")
                calls.remove(["demo"])
            said = "\n".join(sherkit(arguments, tmp_path) for arguments in calls if arguments)
        elif block.language in ("toml", "xml", "c"):
            # the first comment names the file
            (tmp_path / block.text.split()[1]).write_text(block.text, encoding="utf-8")
        else:
            assert block.language == "text", f"{block.place}: neither run nor compared"
            for line in filter(str.strip, block.text.splitlines()):
                there = f" {plain(line)} " in f" {plain(said)} "
                assert there, f"{block.place}: '{line}' is not what was printed:\n{said}"
                quoted += 1
    assert quoted > (15 if story == "docs/tutorial.md" else 8)
    if "found" not in names:
        return
    # names of the signature's keys, as the page on JSON lists them
    sentences = next(line for line in text_of("docs/json.md").splitlines() if line.startswith("| `signature`"))
    found: Diagnosis = names["found"]
    assert found.signature is not None
    assert set(found.signature) == set(_INLINE.findall(sentences)) - {"signature"}


def shape(value: Any) -> Any:
    """A JSON value with its numbers left out and its lists of objects cut to their first entry."""
    if isinstance(value, dict):
        return {key: shape(v) for key, v in value.items()}
    if isinstance(value, list):
        return [shape(v) for v in (value[:1] if value and isinstance(value[0], dict) else value)]
    return "number" if isinstance(value, float) else value


@pytest.mark.slow
def test_the_json_is_what_is_printed(made_whole: Path) -> None:
    """Catches a key of the JSON that its page does not tell of, or tells of under another name."""
    (block,) = (b for b in blocks("docs/json.md") if b.language == "json")
    told = json.loads(block.text)
    assert _AS_JSON in commands("docs/json.md")
    printed = json.loads(sherkit(_AS_JSON, made_whole))
    for one in (told, printed):  # which parameters an effect hides in depends on the last digits
        one["confounded_with"] = sorted(one["confounded_with"])
    assert shape(told) == shape(printed)
    text = prose("docs/json.md")
    rows = text[text.index("| key | meaning |") :].split("\n\n")[0].splitlines()[2:]
    keys = [k for row in rows for k in _INLINE.findall(row.split("|")[1])]
    assert sorted(keys) == sorted(printed)


def test_the_robot_of_the_documents_is_the_demos(tmp_path: Path) -> None:
    """Catches a robot file in the documents that sherkit refuses, or that is another robot than the demo's."""
    (block,) = (b for b in blocks("docs/files.md") if b.language == "toml")
    (tmp_path / "robot.toml").write_text(block.text, encoding="utf-8")
    assert load_robot(tmp_path / "robot.toml") == EXAMPLE


@pytest.mark.parametrize("name", ["docs/start.md", "docs/files.md"])
def test_the_sensors_pose_of_the_documents_is_read(name: str, tmp_path: Path) -> None:
    """Catches a table in the documents that sherkit refuses, or that says another thing than the text beside it: shifts
    free, turns known to 0.02°."""
    (robot,) = (b for b in blocks("docs/files.md") if b.language == "toml")
    (table,) = (b for b in blocks(name) if b.text.startswith("[sensor_pose]"))
    (tmp_path / "robot.toml").write_text(robot.text + table.text, encoding="utf-8")
    read: Any = load_robot(tmp_path / "robot.toml")
    pose = read.sensor_pose
    assert (pose.origin_mm, pose.rpy_deg) == ((1250.0, -330.0, 812.0), (0.0, 0.0, 35.0))
    assert np.isinf(pose.shift_sd_mm).all()
    assert pose.turn_sd_deg == (0.02, 0.02, 0.02 if name == "docs/start.md" else np.inf)


# -- what they name exists -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", DOCS)
def test_links_lead_somewhere(name: str) -> None:
    """Catches a link to a file that was moved or never written, and a heading that is not there."""
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(name)):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, heading = target.partition("#")
        file = (HERE / name).parent / path if path else HERE / name
        assert file.exists(), f"{name} links to {target}"
        if heading:
            titles = re.findall(r"^#+ (.+)$", file.read_text(encoding="utf-8"), re.MULTILINE)
            assert heading in {re.sub(r"[^\w -]", "", t).lower().replace(" ", "-") for t in titles}


@pytest.mark.parametrize("name", DOCS)
def test_targets_of_make_exist(name: str) -> None:
    """Catches ``make`` with a target that the Makefile does not have."""
    targets = set(re.findall(r"^([\w-]+):(?!=)", text_of("Makefile"), re.MULTILINE))
    fenced = "\n".join(b.text for b in blocks(name))
    named = set(re.findall(r"^make ([\w-]+)", fenced, re.MULTILINE))
    named |= {m[1].split()[1] for m in _INLINE.finditer(prose(name)) if m[1].startswith("make ")}
    assert named <= targets


@pytest.mark.parametrize("name", DOCS)
def test_files_that_are_named_exist(name: str) -> None:
    """Catches a file of the source tree that was renamed since; the reader's own files have no folder in the tree."""
    roots = ("rust/", "python/", "tests/", "docs/", "benchmarks/", ".ci/")
    for named in _INLINE.findall(prose(name)):
        if named.startswith(roots) and " " not in named:
            assert (HERE / named).exists(), f"{name} names {named}"


@pytest.mark.parametrize("name", DOCS)
def test_no_path_of_a_machine(name: str) -> None:
    """Catches a path that exists on the writer's machine alone."""
    found = MACHINE.search(text_of(name))
    assert found is None, f"{name}: {found and found[0]}"
