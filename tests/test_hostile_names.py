"""No name of a column, a file or an effect becomes code or markup, whatever writes it."""

from __future__ import annotations

import ast
import json
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sherkit as sk
from hostile import HOSTILE, names
from sherkit.cli.demo import EXAMPLE
from sherkit.data.columns import Layout, bare
from sherkit.diagnosis import template
from test_commands_fuzz import run
from test_fuzz import lines_run

_SHAPES = ("smooth", "periodic", "step", "kink", "bump", "hysteretic", "interaction")


@st.composite
def signatures(draw: st.DrawFn) -> tuple[dict[str, Any], Layout, str]:
    """What a diagnosis may say of rows with these columns, and the name of the file that is written."""
    columns = draw(st.lists(names.filter(lambda n: bare(n) == n), min_size=5, max_size=8, unique=True))
    place, read, others = columns[:2], columns[2:4], columns[4:]
    shape = draw(st.sampled_from(_SHAPES))
    count = 2 if shape == "interaction" else 1
    known = [place[0]] if shape == "hysteretic" else others
    depends = draw(st.lists(st.sampled_from(known + place), min_size=count, max_size=count, unique=True))
    layout = Layout(tuple(place), tuple(read), draw(st.sampled_from(["furlong", '"); import os  #'])), 1.0)
    if shape == "hysteretic":
        depends = [place[0]]
    on_joint = draw(st.booleans())
    signature = {
        "depends_on": depends, "shape": shape, "axis": [] if on_joint else [layout.names[0]],
        "joint": place[1] if on_joint else None, "order": draw(st.integers(1, 3)), "share_explained": 0.5,
        "period": draw(st.floats(1e-3, 1e3)), "at": draw(st.one_of(st.none(), st.floats(0.1, 9.0))),
        "ranges": dict.fromkeys(depends, (1.0, 2.0)),
    }  # fmt: skip
    if shape in ("step", "kink", "bump"):
        signature |= {"at": 3.0, "width": 0.5}
    return signature, layout, draw(names)


def structure(source: str) -> str:
    """What a program does, with every literal text and every parameter's name taken out."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            node.value = "text"
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "p":
            node.attr = "parameter"
    return ast.dump(tree)


@given(signatures())
def test_a_template_does_the_same_whatever_columns_are_called(given_: tuple[dict[str, Any], Layout, str]) -> None:
    """Catches a name that becomes code: what the template does may not depend on it."""
    signature, layout, file = given_
    called = dict(zip((*layout.joints, *layout.coordinates), ("a", "b", "c", "d"), strict=True))
    called |= {n: f"other_{k}" for k, n in enumerate(signature["depends_on"]) if n not in called}
    tame_layout = Layout(("a", "b"), ("c", "d"), "furlong", 1.0)
    tame = {
        **signature, "depends_on": [called[n] for n in signature["depends_on"]],
        "axis": ["c"] if signature["axis"] else [], "joint": "b" if signature["joint"] else None,
        "ranges": {called[n]: v for n, v in signature["ranges"].items()},
    }  # fmt: skip
    source = template(signature, layout, file=file)
    assert structure(source) == structure(template(tame, tame_layout))
    assert all(c.isprintable() or c == "\n" for c in source)


@pytest.mark.parametrize("name", HOSTILE)
def test_a_template_of_a_hostile_column_runs(name: str) -> None:
    """Catches a template that refuses, or reads another column than the one that it was written for."""
    rng = np.random.default_rng(0)
    wanted, wrong = rng.normal(size=(2, 50))
    layout = Layout(("turn",), ("shown",), "mm", 1.0)
    signature = {
        "depends_on": [name], "shape": "smooth", "axis": ["shown"], "order": 1, "share_explained": 0.5,
        "period": None,
        "ranges": {name: (0.0, 1.0)},
    }  # fmt: skip
    space: dict[str, Any] = {}
    exec(compile(template(signature, layout), "my_effects.py", "exec"), space)
    data = sk.data.from_arrays(
        place={"turn": rng.normal(size=50)}, readings=rng.normal(size=(50, 1)), names=("shown",), unit="mm",
        covariates={"temperature": wrong, name: wanted, "time": wrong} | {name: wanted}, time_s=np.arange(50.0),
    )  # fmt: skip
    effect = space["unknown_effect"]
    from sherkit.model.rows import EffectRows

    made = effect.evaluate(EffectRows(data, lambda: np.zeros((50, 1))), np.array([2.0]), 1)
    np.testing.assert_allclose(made[:, 0], 2.0 * wanted)


@pytest.mark.parametrize("name", ["a b", "class", "1", "", "x\n", "import os"])
def test_an_effect_has_the_name_of_a_function(name: str) -> None:
    """Catches a name that ends the line of the definition."""
    signature = {"depends_on": ["t"], "shape": "step", "axis": ["x"], "at": 1.0, "share_explained": 0.1, "order": 1}
    signature |= {"period": 1.0}
    with pytest.raises(sk.errors.EffectError, match="cannot be the name of an effect"):
        template(signature, Layout(("t",), ("x",), "mm", 1.0), name)


@pytest.mark.slow
def test_a_run_with_hostile_columns_is_diagnosed_and_reported(tmp_path: Path) -> None:
    """Catches a name that is markup in the terminal, an element in the report, or code in the template that is run."""
    rng = np.random.default_rng(0)
    data = lines_run().to_frame()
    hostile = [n for n in HOSTILE if n.strip() == n and n and "\x00" not in n and not n.startswith("#")]
    chosen = [*hostile[:12], "[/]", "[red]", "[link=x]", "\x1b[31m", "</script><script>alert(1)</script>"]
    frame = data.with_columns(pl.Series(n, rng.normal(size=len(data))) for n in dict.fromkeys(chosen))
    # what is left goes with one of them: it is named, and becomes a template
    worst = chosen[0]
    frame = frame.with_columns(pl.col(a) + 0.2 * pl.col(worst) for a in ("x_mm", "y_mm", "z_mm"))
    frame.write_csv(tmp_path / "run.csv")
    sk.save_robot(EXAMPLE, tmp_path / "robot.toml")
    told = [str(tmp_path / n) for n in ("robot.toml", "run.csv")]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        code, out, err = run(["diagnose", *told, "--template", str(tmp_path / "t.py"),
                              "--report", str(tmp_path / "r.html")])  # fmt: skip
    assert code == 0, err
    assert "Traceback" not in err
    assert worst[:20] in out
    ast.parse((tmp_path / "t.py").read_text())
    assert f"rows[{worst!r}]" in (tmp_path / "t.py").read_text()
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    elements = re.sub(r"<script\b.*?</script>", "", page, flags=re.DOTALL)
    assert "<script>alert" not in elements
    assert re.findall(r"<script(?! nonce=| type=\"application/json\")", page.split("</head>")[1]) == []
    code, out, err = run(["diagnose", *told, "--json", "--effects", str(tmp_path / "t.py")])
    assert code == 0, err
    assert json.loads(out)
