"""Linear algebra that ends in an answer or in a sentence, never in a traceback of LAPACK.

Every decomposition of the package passes here. What it is given is checked first: nothing that is not finite goes on.
Where LAPACK's quick routine does not converge, as divide and conquer does not now and then on columns that are nearly
copies of each other, a slower routine takes its place. Where the numbers have no answer, the error says which.

The functions are those of :mod:`numpy.linalg` and mean the same. Lengths and determinants cannot fail: they are NumPy's
own.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import ContextDecorator
from typing import Any, NamedTuple

import numpy as np
import scipy
import scipy.linalg
import threadpoolctl

from ..errors import NotConverged, NotFinite, Singular
from .types import Bools, Floats

#: The threads of NumPy's BLAS and of SciPy's, which are two. Looked for once, while this is imported:
#: looking holds the loader's lock, and waits for ever where another thread imports at that moment.
_POOLS = threadpoolctl.ThreadpoolController().select(user_api="blas").lib_controllers

#: Part of the largest number up to which what is left is rounding.
_ROUNDING = 1e-12


class LeastSquaresSolution(NamedTuple):
    """As :func:`numpy.linalg.lstsq` answers."""

    x: Floats
    residuals: Floats
    rank: int
    singular: Floats


class one_thread(ContextDecorator):  # noqa: N801 - read as a function: `with one_thread():`, `@one_thread()`
    """While this is entered, anywhere and however often, BLAS computes on one thread.

    The matrices of a diagnosis are small and many: on a machine whose cores are busy, threads that wait for each other
    after each of them took ten times the processor's time of one alone.
    """

    _lock = threading.Lock()
    _entered = 0
    _before: tuple[tuple[Any, int], ...] = ()

    def __enter__(self) -> None:
        with one_thread._lock:
            if one_thread._entered == 0:
                one_thread._before = tuple((pool, n) for pool in _POOLS if (n := pool.num_threads) != 1)
                for pool, _ in one_thread._before:
                    pool.set_num_threads(1)
            one_thread._entered += 1

    def __exit__(self, *_: object) -> None:
        with one_thread._lock:
            one_thread._entered -= 1
            if one_thread._entered == 0:
                for pool, before in one_thread._before:
                    pool.set_num_threads(before)


def eigh(matrix: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues (…, k), ascending, and vectors (…, k, k) of symmetric matrices. Raises as :func:`checked` and
    :class:`~sherkit.errors.NotConverged`."""
    a = checked(matrix, "a symmetric matrix")

    def slower(one: Floats) -> tuple[Floats, Floats]:
        value, vector = scipy.linalg.eigh(one, driver="ev")
        return value, vector

    return _first(a, lambda: _np_eigh(a), _each(a, slower, 2))


def eigvalsh(matrix: Floats) -> Floats:
    """Eigenvalues alone. Raises as :func:`eigh`."""
    a = checked(matrix, "a symmetric matrix")
    return _first(a, lambda: _np_eigvalsh(a), lambda: eigh(a)[0])


def svd(matrix: Floats, full_matrices: bool = True) -> tuple[Floats, Floats, Floats]:
    """Left vectors, singular values and right vectors, transposed, of a matrix (n, k). Raises as :func:`eigh`."""
    a = checked(matrix, "a matrix")

    def slower(one: Floats) -> tuple[Floats, Floats, Floats]:
        u, value, vt = scipy.linalg.svd(one, full_matrices=full_matrices, lapack_driver="gesvd")
        return u, value, vt

    return _first(a, lambda: tuple(_np_svd(a, full_matrices)), _each(a, slower, 3))


def singular_values(matrix: Floats) -> Floats:
    """Singular values alone, descending. Raises as :func:`svd`."""
    a = checked(matrix, "a matrix")
    return _first(a, lambda: _np_singular_values(a), lambda: svd(a, full_matrices=False)[1])


def matrix_rank(matrix: Floats, tol: float) -> int:
    """How many singular values are larger than ``tol``. Raises as :func:`svd`."""
    return int((singular_values(matrix) > tol).sum())


def triangle(matrix: Floats) -> Floats:
    """The triangle R of a QR decomposition. Raises as :func:`svd`."""
    a = checked(matrix, "columns")
    return _first(a, lambda: _np_triangle(a), lambda: qr(a)[1])


def qr(matrix: Floats) -> tuple[Floats, Floats]:
    """Orthonormal columns Q and the triangle R of a matrix (n, k), in its reduced form. Raises as :func:`svd`."""
    a = checked(matrix, "columns")

    def slower(one: Floats) -> tuple[Floats, Floats]:
        q, r = scipy.linalg.qr(one, mode="economic")
        return q, r

    return _first(a, lambda: tuple(_np_qr(a)), lambda: slower(a))


def lstsq(columns: Floats, right: Floats, rcond: float | None = None) -> LeastSquaresSolution:
    """The shortest least-squares solution. Raises as :func:`svd`."""
    a, b = checked(columns, "columns"), checked(right, "what is fitted")

    def plain() -> LeastSquaresSolution:
        return LeastSquaresSolution(*_np_lstsq(a, b, rcond))

    def by_svd() -> LeastSquaresSolution:
        u, value, vt = svd(a, full_matrices=False)
        limit = (np.finfo(float).eps * max(a.shape) if rcond is None else rcond) * float(value.max(initial=0.0))
        keep = value > limit
        x = vt[keep].T @ ((u[:, keep].T @ b).T / value[keep]).T
        left = np.atleast_1d(((b - a @ x) ** 2).sum(axis=0))
        return LeastSquaresSolution(x, left if keep.all() and len(a) > len(vt) else np.zeros(0), int(keep.sum()), value)

    return _first(a, plain, by_svd)


def pinv(matrix: Floats, rcond: float = 1e-15, hermitian: bool = False) -> Floats:
    """The pseudo-inverses of matrices (…, n, k). Raises as :func:`svd`."""
    a = checked(matrix, "a matrix")

    def by_svd(one: Floats) -> Floats:
        u, value, vt = svd(one, full_matrices=False)
        keep = value > rcond * value.max(initial=0.0)
        return np.asarray((vt[keep].T / value[keep]) @ u[:, keep].T)

    return _first(a, lambda: _np_pinv(a, rcond, hermitian), _each(a, by_svd, 1))


def solve(matrix: Floats, right: Floats) -> Floats:
    """``x`` of ``matrix @ x = right``. Raises as :func:`checked` and :class:`~sherkit.errors.Singular` where there is
    none."""
    a, b = checked(matrix, "the matrix of an equation"), checked(right, "the right side of an equation")
    # of one vector NumPy 1 and 2 see the same, of several they do not
    wide = b[..., None] if b.ndim == 1 else b

    def again(one: Floats, side: Floats) -> Floats:
        x, _, rank, _ = lstsq(one, side)
        if rank < len(one):
            raise np.linalg.LinAlgError
        return np.asarray(x)

    def each() -> Floats:
        shape = np.broadcast_shapes(a.shape[:-2], wide.shape[:-2])
        sides = np.broadcast_to(wide, (*shape, *wide.shape[-2:])).reshape(-1, *wide.shape[-2:])
        every = np.broadcast_to(a, (*shape, *a.shape[-2:])).reshape(-1, *a.shape[-2:])
        return np.stack([again(*pair) for pair in zip(every, sides, strict=True)]).reshape(*shape, *wide.shape[-2:])

    x = _first(a, lambda: _np_solve(a, wide), each, error=Singular)
    return x[..., 0] if b.ndim == 1 else x


def inv(matrix: Floats) -> Floats:
    """Inverses of matrices (…, k, k). Raises as :func:`solve`."""
    a = checked(matrix, "a matrix to be inverted")
    return _first(
        a, lambda: _np_inv(a), lambda: solve(a, np.broadcast_to(np.eye(a.shape[-1]), a.shape)), error=Singular
    )


def cholesky(matrix: Floats) -> Floats:
    """Lower triangles L of which L Lᵀ are these matrices (…, k, k). Raises as :func:`checked`, and
    :class:`~sherkit.errors.Singular` where one is not positive definite beyond rounding."""
    a = checked(matrix, "a covariance")

    def by_values(one: Floats) -> Floats:
        value, vector = eigh(one)
        if value[0] < -_ROUNDING * max(value[-1], 0.0) or value[-1] <= 0.0:
            raise np.linalg.LinAlgError
        r = triangle((vector * np.sqrt(value.clip(_ROUNDING * value[-1]))).T)
        return np.asarray((r * np.where(np.diag(r) < 0, -1.0, 1.0)[:, None]).T)

    return _first(a, lambda: _np_cholesky(a), _each(a, by_values, 1), error=Singular)


def solveh_banded(bands: Floats, right: Floats) -> Floats:
    """Solves for a positive definite matrix given by its lower bands (b, n). Raises as :func:`solve`."""
    a, b = checked(bands, "the bands of a matrix"), checked(right, "the right side of an equation")

    def whole() -> Floats:
        full = np.zeros((a.shape[1], a.shape[1]))
        for k, band in enumerate(a):
            rows = np.arange(a.shape[1] - k)
            full[rows + k, rows] = full[rows, rows + k] = band[: len(rows)]
        return solve(full, b)

    return _first(a, lambda: _scipy_banded(a, b), whole, error=Singular)


def checked(values: Any, what: str) -> Floats:
    """The numbers as they are. Raises :class:`~sherkit.errors.NotFinite` that says which of them are none."""
    a = np.asarray(values, dtype=np.float64)
    finite = np.isfinite(a)
    if not finite.all():
        raise NotFinite(
            f"{what} of {_shape(a)} numbers holds {_which(a, ~finite)}: what it was made of has no answer there"
        )
    return a


# -- what LAPACK is asked first ------------------------------------------------------------------------------------


def _np_eigh(a: Floats) -> tuple[Floats, Floats]:
    value, vector = np.linalg.eigh(a)
    return value, vector


def _np_eigvalsh(a: Floats) -> Floats:
    return np.asarray(np.linalg.eigvalsh(a))


def _np_svd(a: Floats, full_matrices: bool) -> Any:
    return np.linalg.svd(a, full_matrices=full_matrices)


def _np_singular_values(a: Floats) -> Floats:
    return np.asarray(np.linalg.svd(a, compute_uv=False))


def _np_triangle(a: Floats) -> Floats:
    return np.asarray(np.linalg.qr(a, mode="r"))


def _np_qr(a: Floats) -> Any:
    return np.linalg.qr(a)


def _np_lstsq(a: Floats, b: Floats, rcond: float | None) -> Any:
    return np.linalg.lstsq(a, b, rcond=rcond)


def _np_pinv(a: Floats, rcond: float, hermitian: bool) -> Floats:
    return np.asarray(np.linalg.pinv(a, rcond=rcond, hermitian=hermitian))


def _np_solve(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.linalg.solve(a, b))


def _np_inv(a: Floats) -> Floats:
    return np.asarray(np.linalg.inv(a))


def _np_cholesky(a: Floats) -> Floats:
    return np.asarray(np.linalg.cholesky(a))


def _scipy_banded(a: Floats, b: Floats) -> Floats:
    return np.asarray(scipy.linalg.solveh_banded(a, b, lower=True))


# -- what is done where it has no answer ---------------------------------------------------------------------------


def _first(a: Floats, *ways: Callable[[], Any], error: type[NotConverged | Singular] = NotConverged) -> Any:
    """The first answer that comes and is finite."""
    for way in ways:
        try:
            answer = way()
        except (np.linalg.LinAlgError, Singular, NotConverged, ValueError):
            continue
        if all(np.isfinite(part).all() for part in (answer if isinstance(answer, tuple) else (answer,))):
            return answer
    what = "has no inverse" if error is Singular else "has a decomposition that does not converge"
    raise error(f"a matrix of {_shape(a)} numbers {what}: {_told(a)}")


def _each(a: Floats, one: Callable[[Floats], Any], parts: int) -> Callable[[], Any]:
    """Applies a way to each matrix of a stack by itself; those that it has not to be told to scale."""

    def every() -> Any:
        if a.ndim == 2:
            return one(a)
        found = [one(matrix) for matrix in a.reshape(-1, *a.shape[-2:])]
        if parts == 1:
            return np.stack(found).reshape(*a.shape[:-2], *found[0].shape)
        stacked = (np.stack([answer[k] for answer in found]) for k in range(parts))
        return tuple(part.reshape(*a.shape[:-2], *part.shape[1:]) for part in stacked)

    return every


# -- words ---------------------------------------------------------------------------------------------------------


def _shape(a: Floats) -> str:
    return " × ".join(str(k) for k in a.shape) or "1"


def _which(a: Floats, wrong: Bools) -> str:
    """Where numbers are wrong, for a sentence."""
    at = np.argwhere(wrong)
    first = ", ".join(str(k) for k in at[0].tolist())
    more = f" and {len(at) - 1} more" if len(at) > 1 else ""
    return f"{a[tuple(at[0])]} at ({first}){more}"


def _told(a: Floats) -> str:
    """What stands out in a matrix: columns of zeros, columns that are copies, sizes that are far apart."""
    flat = a.reshape(-1, a.shape[-1])
    length = np.linalg.norm(flat / (float(np.abs(flat).max(initial=0.0)) or 1.0), axis=0)
    if zero := np.flatnonzero(length == 0.0).tolist():
        return f"column{'s' if len(zero) > 1 else ''} {', '.join(map(str, zero[:5]))} of it are nothing but zeros"
    unit = flat / np.abs(flat).max() / length
    alike = np.argwhere(np.triu(np.abs(unit.T @ unit) > 1.0 - _ROUNDING, 1))
    if len(alike):
        return f"its columns {alike[0][0]} and {alike[0][1]} are multiples of each other"
    return f"its columns have lengths from {length.min():.2g} to {length.max():.2g} of the largest number"
