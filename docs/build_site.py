"""Builds the documentation as a site and checks every link of it: ``python docs/build_site.py FOLDER``.

The pages are laid out as they stand in the repository, so that a link which works there works here. What is checked
of the pages that were made: every file, picture and heading that is linked to is there, and nothing is fetched from
another host.
"""

from __future__ import annotations

import logging
import re
import shutil
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

sys.path.insert(0, str(Path(__file__).parent))
from make_notebooks import make as make_notebooks
from make_pages import make as make_pages

HERE = Path(__file__).resolve().parents[1]
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "CODE_OF_CONDUCT.md", "LICENSE",
         "benchmarks/README.md", "rust/c/README.md")  # fmt: skip
#: What nobody looks for, and pages that come before others that hold the same words.
UNSEARCHED = ("CHANGELOG.md", "SECURITY.md", "CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "LICENSE")
FIRST = {
    "docs/howto_effect.md": 6,
    "docs/start.md": 12,
    "docs/verdict.md": 4,
    "docs/howto_c.md": 6,
    "docs/questions.md": 2,
}
WORKER = "site_worker.js"
_FETCHED_WORKER = re.compile(r"https://[\w.]+/iframe-worker/shim")
#: Attributes by which a browser fetches by itself; a link is followed by a person.
_FETCHED = {
    ("script", "src"),
    ("img", "src"),
    ("link", "href"),
    ("iframe", "src"),
    ("source", "src"),
    ("object", "data"),
}
#: Relations of a link element that fetch nothing.
_SAID = {"canonical", "next", "prev", "alternate", "license"}


def lay_out(source: Path) -> None:
    """Copies the sources of the site."""
    shutil.rmtree(source, ignore_errors=True)
    for page in PAGES:
        (source / page).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(HERE / page, source / page)
    # the scripts that make the documents are no documents
    shutil.copytree(
        HERE / "docs", source / "docs", ignore=shutil.ignore_patterns("__pycache__", "*.py", "*.js", "notebooks")
    )
    for page, how in {
        **dict.fromkeys(UNSEARCHED, "exclude: true"),
        **{p: f"boost: {n}" for p, n in FIRST.items()},
    }.items():
        text = (source / page).read_text(encoding="utf-8")
        (source / page).write_text(f"---\nsearch:\n  {how}\n---\n\n{text}", encoding="utf-8")
    shutil.copytree(HERE / "examples", source / "examples", ignore=shutil.ignore_patterns("__pycache__"))


def build(site: Path) -> list[str]:
    """Builds the site, and returns everything that is wrong with it."""
    from mkdocs.commands.build import build as mkdocs_build
    from mkdocs.config import load_config

    source = site.with_name(f"{site.name}_source")
    lay_out(source)
    make_notebooks(source / "docs" / "notebooks")
    made = make_pages(source / "docs" / "made")
    wrong = _Warnings()
    logger = logging.getLogger("mkdocs")
    logger.addHandler(wrong)
    try:
        config = load_config(str(HERE / "mkdocs.yml"), docs_dir=str(source), site_dir=str(site))
        reference = next(part["Reference"] for part in config["nav"] if "Reference" in part)
        reference += [
            {title: [{name: page.relative_to(source).as_posix()} for name, page in pages]} for title, pages in made
        ]
        mkdocs_build(config)
    finally:
        logger.removeHandler(wrong)
    own_worker(site)
    return wrong.said + checked(site)


def own_worker(site: Path) -> None:
    """What lets a site search that is opened as files, from the site itself: the theme's would be fetched."""
    shutil.copy(HERE / "docs" / WORKER, site / "assets" / WORKER)
    for path in site.rglob("*.html"):
        above = "../" * (len(path.relative_to(site).parts) - 1)
        text = _FETCHED_WORKER.sub(f"{above}assets/{WORKER}", path.read_text(encoding="utf-8"))
        path.write_text(text, encoding="utf-8")


class _Warnings(logging.Handler):
    """What mkdocs and its plugins warn of."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.said: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.said.append(record.getMessage())


class Page(HTMLParser):
    """Links, places that can be linked to, and what is fetched, of one page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.places: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {key: value or "" for key, value in attrs}
        self.places |= {given[key] for key in ("id", "name") if key in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if given.get("rel") not in _SAID:
            self.fetched += [given[key] for key in given if (tag, key) in _FETCHED]


def checked(site: Path) -> list[str]:
    """Links that lead nowhere, and what would be fetched from another host, in every page of a site."""
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    wrong = []
    for path, page in pages.items():
        name = path.relative_to(site)
        if path.name == "404.html":
            continue  # it is shown anywhere, with links of a server
        for link in (*page.links, *page.fetched):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                if link in page.fetched and parts.scheme != "data":
                    wrong.append(f"{name} fetches {link}")
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            if not target.is_file():
                wrong.append(f"{name} links to {link}, which is not there")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].places | {"__top"}:
                wrong.append(f"{name} links to {link}: there is no such heading")
    return wrong


if __name__ == "__main__":
    found = build(Path(sys.argv[1]).resolve())
    print("\n".join(found) if found else f"{sys.argv[1]} is built; every link leads somewhere")
    sys.exit(1 if found else 0)
