"""Linear algebra that LAPACK refuses: an answer by another way, or a sentence, wherever it is asked."""

from __future__ import annotations

import ast
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import threadpoolctl
from numpy.typing import NDArray

import sherkit as sk
from consistency import named
from sherkit.base import linalg
from sherkit.errors import NotConverged, NotFinite, Singular
from sources import parsed
from strategies import EXAMPLE
from test_few_poses import few

Floats = NDArray[np.float64]

PACKAGE = Path(sk.__file__).parent
#: What LAPACK is asked first, by name.
FIRST = [name for name in vars(linalg) if name.startswith(("_np_", "_scipy_"))]
#: What is NumPy's own everywhere: it cannot fail.
FREE = {"norm", "det", "slogdet", "LinAlgError"}


def refuse(*_: Any, **__: Any) -> Any:
    raise np.linalg.LinAlgError("did not converge")


@pytest.fixture
def refusing(monkeypatch: pytest.MonkeyPatch) -> None:
    """NumPy's quick routines end without an answer, whatever they are asked."""
    for name in FIRST:
        monkeypatch.setattr(linalg, name, refuse)


@pytest.fixture
def no_lapack(refusing: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor do the slower ones."""
    for name in ("eigh", "svd", "qr"):
        monkeypatch.setattr(linalg.scipy.linalg, name, refuse)


def matrices() -> Iterator[Floats]:
    """Of all shapes: well and badly conditioned, with columns that are copies, of zeros, and huge or tiny."""
    rng = np.random.default_rng(1)
    for n, k in ((6, 6), (9, 4), (4, 9), (1, 1), (5, 1)):
        a = rng.normal(size=(n, k))
        yield a
        yield a * 10.0 ** rng.uniform(-6, 6, size=k)
        yield a * 1e-160
        yield a * 1e140
        yield np.concatenate([a, a[:, :1], np.zeros((n, 1))], axis=1)


def check_all() -> None:
    """Each function against what it means, not against another implementation."""
    for a in matrices():
        size = float(np.abs(a).max())
        for full in (False, True):
            u, value, vt = linalg.svd(a, full_matrices=full)
            m = min(a.shape)
            np.testing.assert_allclose((u[:, :m] * value) @ vt[:m], a, rtol=0, atol=1e-12 * size)
            np.testing.assert_allclose(u.T @ u, np.eye(u.shape[1]), atol=1e-12)
            np.testing.assert_allclose(vt @ vt.T, np.eye(len(vt)), atol=1e-12)
            assert (np.diff(value) <= 0).all()
        np.testing.assert_allclose(linalg.singular_values(a), value, rtol=0, atol=1e-12 * size)
        q, r = linalg.qr(a)
        np.testing.assert_allclose(q @ r, a, rtol=0, atol=1e-12 * size)
        np.testing.assert_allclose(q.T @ q, np.eye(q.shape[1]), atol=1e-12)
        np.testing.assert_array_equal(r, np.triu(r))
        if 1e-100 < size < 1e100:
            np.testing.assert_allclose(linalg.triangle(a).T @ linalg.triangle(a), a.T @ a, rtol=0, atol=1e-12 * size**2)
            gram = a.T @ a
            value, vector = linalg.eigh(gram)
            np.testing.assert_allclose((vector * value) @ vector.T, gram, rtol=0, atol=1e-12 * size**2)
            np.testing.assert_allclose(vector.T @ vector, np.eye(len(gram)), atol=1e-12)
            assert (np.diff(value) >= 0).all()
            np.testing.assert_allclose(linalg.eigvalsh(gram), value, rtol=0, atol=1e-12 * size**2)
            right = a @ np.ones(a.shape[1])
            x, _, rank, _ = linalg.lstsq(a, right, rcond=1e-9)
            np.testing.assert_allclose(a @ x, right, rtol=0, atol=1e-8 * size)
            assert rank == (linalg.singular_values(a) > 1e-9 * linalg.singular_values(a)[0]).sum()
            np.testing.assert_allclose(linalg.pinv(a, rcond=1e-9) @ right, x, rtol=0, atol=1e-6 * np.abs(x).max())
    rng = np.random.default_rng(2)
    stack = rng.normal(size=(3, 2, 5, 5)) + 3.0 * np.eye(5)
    np.testing.assert_allclose(linalg.inv(stack) @ stack, np.broadcast_to(np.eye(5), stack.shape), atol=1e-10)
    right = rng.normal(size=(3, 2, 5, 2))
    np.testing.assert_allclose(stack @ linalg.solve(stack, right), right, atol=1e-10)
    np.testing.assert_allclose(
        stack[0, 0] @ linalg.solve(stack[0, 0], right[0, 0, :, 0]), right[0, 0, :, 0], atol=1e-10
    )
    spread = stack @ stack.transpose(0, 1, 3, 2)
    lower = linalg.cholesky(spread)
    np.testing.assert_allclose(lower @ lower.transpose(0, 1, 3, 2), spread, rtol=0, atol=1e-10 * spread.max())
    np.testing.assert_array_equal(lower, np.tril(lower))
    value, vector = linalg.eigh(spread)
    np.testing.assert_allclose((vector * value[..., None, :]) @ vector.transpose(0, 1, 3, 2), spread, atol=1e-9)
    bands = np.array([[4.0, 5.0, 6.0], [1.0, -1.0, 0.0]])
    full = np.array([[4.0, 1.0, 0.0], [1.0, 5.0, -1.0], [0.0, -1.0, 6.0]])
    np.testing.assert_allclose(full @ linalg.solveh_banded(bands, np.ones(3)), np.ones(3), atol=1e-12)


def test_lapack_answers() -> None:
    """Catches a function that is not what it is called."""
    check_all()


def test_slower_routines_answer_the_same(refusing: None) -> None:
    """Catches a way round that gives other numbers: NumPy's routines refuse."""
    check_all()


@pytest.mark.parametrize("name", ["eigh", "svd", "qr", "inv", "cholesky", "pinv"])
def test_where_no_routine_answers_a_sentence_does(name: str, no_lapack: None) -> None:
    """Catches a traceback where the slower routines refuse, too."""
    with pytest.raises((NotConverged, Singular), match="a matrix of 3 × 3 numbers"):
        getattr(linalg, name)(np.eye(3) + 0.1)


NAN, INF = np.nan, np.inf


@pytest.mark.parametrize(
    ("ask", "error", "words"),
    [
        (lambda: linalg.eigh(np.array([[1.0, NAN], [NAN, 1.0]])), NotFinite, "2 × 2 numbers holds nan at (0, 1) and 1"),
        (lambda: linalg.svd(np.array([[1.0, INF]])), NotFinite, "inf at (0, 1)"),
        (lambda: linalg.lstsq(np.eye(2), np.array([1.0, NAN])), NotFinite, "what is fitted of 2 numbers holds nan"),
        (lambda: linalg.inv(np.array([[1.0, 2.0], [2.0, 4.0]])), Singular, "columns 0 and 1 are multiples of each"),
        (lambda: linalg.solve(np.diag([1.0, 0.0]), np.ones(2)), Singular, "column 1 of it are nothing but zeros"),
        (lambda: linalg.cholesky(np.diag([1.0, -1.0])), Singular, "2 × 2 numbers has no inverse"),
    ],
)
def test_no_answer_is_a_sentence(ask: Callable[[], Any], error: type[sk.SherkitError], words: str) -> None:
    """Catches a traceback of LAPACK, and a sentence that does not say which numbers are at fault."""
    with pytest.raises(error) as told:
        ask()
    assert words in str(told.value)


def calls(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Names of modules of linear algebra with what is taken of them, and the line."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute | ast.Name):
            owner = node.value.attr if isinstance(node.value, ast.Attribute) else node.value.id
            whole = isinstance(node.value, ast.Attribute)
            if owner == "linalg" and whole:
                yield node.attr, node.lineno
        if isinstance(node, ast.ImportFrom) and (node.module or "").endswith(".linalg") and not node.level:
            for name in node.names:
                yield name.name, node.lineno


def test_nothing_else_asks_lapack() -> None:
    """Catches a call of NumPy's or SciPy's linear algebra beside the one module that may."""
    wrong = []
    for file in sorted(PACKAGE.rglob("*.py")):
        if file.name == "linalg.py":
            continue
        for name, line in calls(parsed(file)):
            # products, and what solves with a factor that is there already, decompose nothing
            if name not in FREE | {"blas", "cho_solve"}:
                wrong.append(f"{file.relative_to(PACKAGE)}:{line} {name}")
    assert not wrong, "\n".join(wrong)


def run() -> sk.Measurements:
    return few(30, 2, 1, rail_lean=10.0).data


def test_a_diagnosis_needs_no_lapack_that_converges(refusing: None) -> None:
    """Catches a call whose other way is not the same: every one of a whole diagnosis is refused at first."""
    found = sk.diagnose(EXAMPLE, run())
    linalg_names = {name: getattr(linalg, name) for name in FIRST}
    assert set(linalg_names.values()) == {refuse}
    assert found.verdict == "explained"
    assert "rail_lean" in named(found)


def sites(ask: Callable[[], Any], monkeypatch: pytest.MonkeyPatch) -> set[tuple[str, int]]:
    """Where in the package linear algebra is asked: files and lines."""
    seen: set[tuple[str, int]] = set()
    first = linalg._first

    def noted(*args: Any, **kwargs: Any) -> Any:
        seen.add(caller())
        return first(*args, **kwargs)

    with monkeypatch.context() as patched:
        patched.setattr(linalg, "_first", noted)
        ask()
    return seen


def caller() -> tuple[str, int]:
    frame = sys._getframe(1)
    while Path(frame.f_code.co_filename).name in ("linalg.py", Path(__file__).name):
        assert frame.f_back is not None
        frame = frame.f_back
    return frame.f_code.co_filename, frame.f_lineno


@pytest.mark.slow
def test_a_call_that_fails_for_good_is_an_answer_or_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a traceback at any call site of fit, diagnosis, study, plan and accuracy: each by itself has no answer at
    all, and what a person asked for ends in an answer or in an error of sherkit's."""
    data = run()

    def ask() -> None:
        study = sk.Study(EXAMPLE, data)
        study.diagnose()
        study.add("rail_lean")
        study.calibration()

    every = sites(ask, monkeypatch)
    assert len(every) > 20
    first, ended = linalg._first, 0
    for site in sorted(every):

        def failing(*args: Any, site: tuple[str, int] = site, **kwargs: Any) -> Any:
            if caller() == site:
                raise NotConverged("no decomposition of these numbers converges")
            return first(*args, **kwargs)

        with monkeypatch.context() as patched:
            patched.setattr(linalg, "_first", failing)
            try:
                ask()
            except sk.SherkitError:
                ended += 1
    assert ended > 0


@pytest.mark.parametrize("column", ["copied", "session", "x_mm"])
def test_columns_that_are_copies_end_in_an_answer(column: str) -> None:
    """Catches a traceback where a column is another one once more, tells two stands apart, or where a coordinate holds
    the readings of a joint: its repeats do not differ at all, and what is divided by their noise is no number."""
    frame = run().to_frame()
    n = len(frame)
    more = {
        "copied": frame["time_s"] * 2.0,
        "session": pl.Series((np.arange(n) >= n // 2).astype(float)),
        "x_mm": frame["q1_mm"],
    }[column]
    found = sk.diagnose(EXAMPLE, frame.with_columns(more.alias(column)))
    assert (found.verdict in ("adequate", "explained")) is (column != "x_mm")


def test_blas_computes_on_one_thread_while_asked_to_and_as_before_after() -> None:
    """Catches a limit that stays, or that a diagnosis within another lifts too early."""
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        with linalg.one_thread():
            with linalg.one_thread():
                assert set(threads()) == {1}
            assert set(threads()) == {1}
        assert set(threads()) == {2} or os.cpu_count() == 1


def threads() -> list[int]:
    """How many threads each BLAS of NumPy and SciPy may use; OpenCV brings one of its own, which no diagnosis asks."""
    every = (pool for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas")
    return [pool["num_threads"] for pool in every if "opencv" not in pool["filepath"]]
