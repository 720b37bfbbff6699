"""The pages that stand on the site alone: their blocks run; and the site itself, every link of it followed."""

from __future__ import annotations

import ast
import importlib.util
import re
import runpy
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest

import test_docs
import test_docs_laboratory
from running import slow
from sherkit.report.page import browser
from test_docs import HERE, MACHINE, blocks, command, commands, run_python, sherkit, text_of

#: Pages whose blocks run in order in the folder that the demo leaves.
PAGES = ("docs/start.md", "docs/howto_data.md", "docs/howto_repeats.md", "docs/howto_ties.md", "docs/howto_plan.md",
         "docs/howto_effect.md",
         "docs/howto_adaptive.md", "docs/history.md", "docs/other_programs.md", "docs/howto_package.md")  # fmt: skip
#: Pages that show nothing to run.
WORDS = ("docs/verdict.md", "docs/glossary.md", "docs/questions.md", "docs/dependencies.md", "docs/reference.md",
         "docs/limits.md", "docs/howto_driver.md", "docs/releasing.md")  # fmt: skip
INSTRUMENTS = "docs/instruments.md"
LOOP = "docs/howto_c.md"
NEEDS = {"docs/other_programs.md": ("bluesky", "ophyd", "rosbags")}


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_a_page_runs(name: str, work: Path) -> None:
    """Catches an example that a rename has broken, and a command that is no longer one."""
    for module in NEEDS.get(name, ()):
        pytest.importorskip(module)
    names: dict[str, Any] = {}
    for block in blocks(name):
        if block.language == "python":
            run_python(block, names)
    for arguments in commands(name):
        if arguments[0].isupper():
            continue
        sherkit(arguments if whole(arguments) else [arguments[0], "--help"], work)


def whole(arguments: list[str]) -> bool:
    """Whether a command can be run as it stands: no word stands for another, and no file is yet to be made."""
    if arguments[0] in ("demo", "completion") or arguments == ["import", "klipper"]:
        return False
    given = [word for word, before in zip(arguments[1:], arguments, strict=False) if before not in ("-o", "--report")]
    files = [word for word in given if re.search(r"\.(toml|csv|sqlite)$", word)]
    return not any(word.isupper() and word.isalpha() for word in given) and all(Path(word).exists() for word in files)


@pytest.mark.slow
def test_the_page_on_instruments_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches an instrument of the user's own that a reader cannot bring: by SCPI, VISA, Python, PyMeasure, ophyd."""
    for module in ("pyvisa_py", "pymeasure", "ophyd"):
        pytest.importorskip(module)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    lab: subprocess.Popen[bytes] | None = None
    printed = []
    try:
        for block in blocks(INSTRUMENTS):
            if block.language == "toml":
                (tmp_path / block.text.split()[1]).write_text(block.text, encoding="utf-8")
            elif block.language == "python":
                printed.append(run_python(block, names))
            else:
                arguments = command(block.text.strip()) or []
                if arguments[0] == "lab":
                    lab = test_docs_laboratory.background(arguments, tmp_path)
                else:
                    said = sherkit(arguments, tmp_path)
                    assert "3 of 3 steps" in said, said
    finally:
        if lab is not None:
            lab.send_signal(signal.SIGINT)
            lab.communicate(timeout=60)
    assert printed[0].startswith("SHERKIT,EMULATED")
    assert "('mm', 'mm', 'mm')" in "".join(printed)


def test_the_page_on_c_compiles(work: Path) -> None:
    """Catches a header that does not compile, and a program that commands another place than Python, or has it
    elsewhere in one of the two frames: the same bits in both."""
    import sherkit as sk

    test_c = pytest.importorskip("test_c_library")
    test_c.tool("cc")
    if shutil.which("cargo") is None:
        pytest.skip("cargo is not installed, so the C library cannot be tested")
    for arguments in commands(LOOP):
        if arguments[0] == "calibrate" or "-o" in arguments:
            sherkit(arguments, work)
        else:
            sherkit([arguments[0], "--help"], work)
    (code,) = (b for b in blocks(LOOP) if b.language == "c")
    (work / "main.c").write_text(code.text, encoding="utf-8")
    archive = test_c.built_archive()
    flags = ["-std=c11", "-Wall", "-Wextra", "-Werror", f"-I{HERE / 'rust/c/include'}"]
    test_c.run("cc", *flags, work / "main.c", archive, "-lm", "-o", work / "main")
    found = dict(re.findall(r"(\w+) +(.*) mm", test_c.run(work / "main")))
    made: Any = sk.load_calibration(work / "calibrated.toml")
    joints = made.inverse([1.0, -2.0, 3.0], frame="base")
    expected = {"joints": joints} | {frame: made.forward(joints, frame=frame) for frame in ("base", "sensor")}
    assert {name: [float(word) for word in words.split()] for name, words in found.items()} == {
        name: numbers.tolist() for name, numbers in expected.items()
    }
    # the instrument's beams are not square, and that is nowhere in the base
    assert abs(expected["sensor"] - made.to_sensor([expected["base"]])[0]).max() > 1e-4


# -- the site ----------------------------------------------------------------------------------------------------


def navigation() -> list[str]:
    """Pages in the order of the site."""
    return re.findall(r"^ +- .*: ((?:docs/|rust/|benchmarks/)?\w+\.md)$", text_of("mkdocs.yml"), re.MULTILINE)


def test_every_page_is_on_the_site_and_runs_somewhere() -> None:
    """Catches a page that nobody finds, and a page whose blocks no test runs."""
    there = {f"docs/{path.name}" for path in (HERE / "docs").glob("*.md")}
    shown = {name for name in navigation() if name.startswith("docs/")}
    assert there == shown
    run = {*PAGES, *WORDS, INSTRUMENTS, LOOP, *test_docs.DOCS, "docs/gallery.md"}
    assert there <= run, there - run
    for name in WORDS:
        assert not [b for b in blocks(name) if b.language in ("python", "sh")], name


@pytest.mark.parametrize("name", [*PAGES, *WORDS, INSTRUMENTS, LOOP])
def test_no_path_of_a_machine(name: str) -> None:
    """Catches a path that exists on the writer's machine alone."""
    found = MACHINE.search(re.sub(r"tcp://\S+", "", text_of(name)))
    assert found is None, f"{name}: {found and found[0]}"


@pytest.mark.slow
def test_the_site_is_built_and_every_link_leads_somewhere(tmp_path: Path) -> None:
    """Catches a dead link, a renamed heading, a name of the reference that is gone, and what is fetched elsewhere."""
    for module in ("mkdocs", "mkdocstrings", "material"):
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed")
    script = runpy.run_path(str(HERE / "docs" / "build_site.py"))
    assert script["build"](tmp_path / "site") == []
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) > 20
    reference = (tmp_path / "site" / "docs" / "reference.html").read_text(encoding="utf-8")
    assert ":class:" not in reference
    if browser() is not None:
        assert len(searched(tmp_path / "site" / "docs" / "start.html", "backlash")) > 2
        for words, page in FOUND.items():
            first = searched(tmp_path / "site" / "docs" / "gallery.html", words)[0]
            assert page in first, f"'{words}' leads to {first}"


#: What a person types, and the page that it has to lead to first.
FOUND = {
    "add an effect": "howto_effect.html",
    "undecided": "verdict.html",
    "install": "start.html",
    "C header": "howto_c.html",
}


def searched(page_file: Path, word: str) -> list[str]:
    """The pages that a search finds, on a site that is opened as files; nothing else may be asked for."""
    from playwright.sync_api import sync_playwright

    asked: list[str] = []
    with sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=browser(), args=["--no-sandbox"])
        try:
            page = chromium.new_page()
            page.on("request", lambda request: asked.append(request.url))
            page.goto(page_file.resolve().as_uri(), timeout=600_000)
            page.click(".md-search__input")
            page.keyboard.type(word)
            page.wait_for_selector(".md-search-result__item", timeout=600_000)
            page.wait_for_timeout(500)
            links = page.locator(".md-search-result__item > a, .md-search-result__item article > a")
            found = [one.get_attribute("href") or "" for one in links.all()]
        finally:
            chromium.close()
    assert not [url for url in asked if not url.startswith(("file:", "data:", "blob:"))]
    return found


def test_the_checker_of_links_sees_what_is_wrong(tmp_path: Path) -> None:
    """Catches a checker that passes everything."""
    script = runpy.run_path(str(HERE / "docs" / "build_site.py"))
    (tmp_path / "a.html").write_text(
        '<h1 id="top">A</h1><a href="b.html#there">b</a><a href="b.html#nowhere">b</a><a href="c.html">c</a>'
        '<a href="https://example.org">fine</a><img src="https://example.org/x.png"><script src="x.js"></script>',
        encoding="utf-8",
    )
    (tmp_path / "b.html").write_text('<p id="there"><a href="a.html#top">a</a>', encoding="utf-8")
    said = script["checked"](tmp_path)
    assert len(said) == 4
    assert all(any(word in one for one in said) for word in ("#nowhere", "c.html", "fetches https", "x.js"))


# -- notebooks -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["tool", *slow("delta", "serial", "spherical")])
def test_a_notebook_runs(name: str, notebooks: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a cell that stops, and one whose value shows nothing; cell by cell, as a kernel would."""
    monkeypatch.chdir(notebooks)
    names: dict[str, Any] = {}
    shown = 0
    made = runpy.run_path(str(HERE / "docs" / "make_notebooks.py"))["cells"](HERE / "docs/notebooks" / f"{name}.py")
    for cell in made.cells:
        if cell.cell_type == "code":
            *body, last = ast.parse(cell.source).body
            exec(compile(ast.Module(body, []), name, "exec"), names)
            value = eval(compile(ast.Expression(last.value), name, "eval"), names)  # type: ignore[attr-defined]
            shown += value is not None and "<iframe" in (value._repr_html_() or "")
    assert shown >= 2


@pytest.fixture(scope="module")
def notebooks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What notebooks read."""
    pytest.importorskip("nbclient")
    folder = tmp_path_factory.mktemp("notebooks")
    runpy.run_path(str(HERE / "docs" / "make_notebooks.py"))["simulated"](folder)
    return folder
