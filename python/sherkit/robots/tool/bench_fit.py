"""What a load bench says of a tool, by one likelihood: gains, sections, stiffness, length, and how its table is to be
read.

A row's moments at sections I and II and the deflection of the contact are what its load makes of the rod. They scatter
by the wavelengths' noise, by the load cell's (which both sections share), by friction that drags on the shaft (moment
``T y`` beside ``N x``), and by the gauge's. All four are found with the parameters: Gaussian likelihood, in turns least
squares whitened by the scatter and the scatter of largest likelihood (Patterson and Thompson, Biometrika 1971).

What a table calls depth and force is a convention: the load's height along the unbent axis (the paper's l, section V.A)
or the length of shaft beyond it; the force across that axis or across the shaft. Large bends tell which. Where the
bench has its zero of the depth, and where sections stand, is told by both the drawing and the rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from scipy.optimize import least_squares, minimize

import sherkit._core as _core

from ...base import linalg
from ...base.types import Floats

#: How far a drawing may be off, mm: sections, free length; and the zero of the bench.
SECTION_MM, LENGTH_MM, ZERO_MM = 0.2, 1.0, 0.2
#: The stiffness of a drawing, relative.
_STIFFNESS = 0.3
_ROUNDS = 4
#: How well rows must tell a term that the model lacks, of the largest that is expected.
_TOLD = 0.05
_STEP = 1e-4
#: Two differences of three fibres, orthonormal, without what is common to them.
DIFFERENCES = np.array([[2.0, -1.0, -1.0], [0.0, np.sqrt(3.0), -np.sqrt(3.0)]]) / np.sqrt(6.0)


@dataclass(frozen=True)
class Convention:
    """How a table of loads is to be read: ``depth`` is ``"axis"`` or ``"arc"``, ``force`` ``"across"`` or
    ``"normal"``."""

    depth: str
    force: str

    def __str__(self) -> str:
        depths = {"axis": "heights along the unbent axis", "arc": "lengths of shaft beyond the load"}
        forces = {"across": "across that axis", "normal": "across the bent shaft"}
        return f"the bench's depths are {depths[self.depth]}, its forces {forces[self.force]}"


#: The paper's own first.
CONVENTIONS = tuple(Convention(depth, force) for depth in ("axis", "arc") for force in ("across", "normal"))


@dataclass(frozen=True)
class Scatter:
    """Deviations of a wavelength (nm), of a load's components (mN), of the friction's share, of the gauge (mm)."""

    wavelength_nm: float
    load_mn: float
    friction: float
    gauge_mm: float


@dataclass(frozen=True, eq=False)
class LoadRows:
    """Loads (n,) as read: ``size_mn`` along ``way`` (n, 2) at ``depth_mm``, ``differences_nm`` (n, 2, 2) of sections I
    and II, ``deflection_mm`` (NaN: not read)."""

    size_mn: Floats
    way: Floats
    depth_mm: Floats
    differences_nm: Floats
    deflection_mm: Floats

    @cached_property
    def bent(self) -> Floats:
        """1 where a deflection was read (n,), else 0."""
        return np.isfinite(self.deflection_mm).astype(float)

    @cached_property
    def sideways(self) -> Floats:
        """Across the load (n, 2)."""
        return np.stack([-self.way[:, 1], self.way[:, 0]], axis=1)


@dataclass(frozen=True, eq=False)
class Drawn:
    """What is known before: ``distances_mm`` of the sections, ``length_mm``, ``stiffness_mn_mm2``, ``exact`` bends."""

    distances_mm: Floats
    length_mm: float
    stiffness_mn_mm2: float
    exact: bool


@dataclass(frozen=True, eq=False)
class Parameters:
    """``by_difference`` (2, 2, 2) moments by differences, mN·mm/nm; ``distances_mm`` (2,); the rod; the bench's
    zero."""

    by_difference: Floats
    distances_mm: Floats
    length_mm: float
    stiffness_mn_mm2: float
    zero_mm: float

    @classmethod
    def of(cls, x: Floats) -> Parameters:
        """From the vector (13,) that is fitted."""
        return cls(x[:8].reshape(2, 2, 2), x[8:10], float(x[10]), float(np.exp(x[11])), float(x[12]))

    @property
    def gains(self) -> Floats:
        """K (2, 2, 3), mN·mm/nm."""
        return np.asarray(self.by_difference @ DIFFERENCES)


@dataclass(frozen=True, eq=False)
class BenchFit:
    """``value`` with the ``covariance`` (13, 13) of its vector; ``deviance`` is minus twice the logarithm of the
    likelihood, ``left`` (n, 5) the moments' residuals along and across the load at I and II (mN·mm) and the
    deflection's
    (mm), ``expected`` (n, 3) what was predicted of moments and deflection. ``whitened`` is the vector that was
    minimised, with its Jacobian."""

    convention: Convention
    rows: LoadRows
    drawn: Drawn
    x: Floats
    covariance: Floats
    scatter: Scatter
    deviance: float
    left: Floats
    expected: Floats
    whitened: tuple[Floats, Floats]

    @property
    def value(self) -> Parameters:
        """The parameters."""
        return Parameters.of(self.x)


class _Model:
    """Residuals of rows under a convention, and their covariance."""

    def __init__(self, rows: LoadRows, drawn: Drawn, convention: Convention, noise_nm: float) -> None:
        self.rows, self.drawn, self.convention, self.noise_nm = rows, drawn, convention, noise_nm

    def residuals(self, x: Floats, larger: float = 1.0) -> tuple[Floats, Floats, Floats]:
        """(n, 5) as in :class:`BenchFit`, expected (n, 3), and the true loads (n, 2): force across the rod, arc; for
        loads that are ``larger``."""
        p, r = Parameters.of(x), self.rows
        beam = _core.ToolBeam(max(p.length_mm, 1.0), p.stiffness_mn_mm2, self.drawn.exact)
        loads = beam.loads_batch(
            larger * r.size_mn, np.ascontiguousarray(r.depth_mm - p.zero_mm), (float(p.distances_mm[0]), float(p.distances_mm[1])),  # noqa: E501
            self.convention.depth == "axis", self.convention.force == "across",
        )  # fmt: skip
        moments = np.einsum("sad,nsd->nsa", p.by_difference, r.differences_nm)
        along = np.einsum("nsa,na->ns", moments, r.way) - loads[:, 2:4]
        across = np.einsum("nsa,na->ns", moments, r.sideways)
        bend = np.where(r.bent > 0, np.nan_to_num(r.deflection_mm) - loads[:, 4], 0.0)
        return np.column_stack([along, across, bend]), loads[:, 2:], loads[:, :2]

    def covariance(self, x: Floats, s: Scatter) -> tuple[Floats, Floats]:
        """Of a row's along and deflection (n, 3, 3), and of its across (n, 2, 2)."""
        p, r = Parameters.of(x), self.rows
        _, expected, loads = self.residuals(x)
        force, arc = loads.T
        ei = p.stiffness_mn_mm2
        arms = (p.distances_mm - arc[:, None]).clip(0.0)
        clamp = (p.length_mm - arc)[:, None]
        by_load = expected / force[:, None]
        # what drags along the shaft with a share of the force pushes it at its own bend (to first order in q)
        bend = force[:, None] * clamp**2 / ei
        own = np.hstack([force[:, None] ** 2 * arms**3 / (6 * ei), force[:, None] ** 2 * clamp**5 / (30 * ei**2)])
        by_drag = own * (1.0 + 0.35 * bend**2)
        if self.convention.force == "across":
            # and it takes a part in what a cell feels across the unbent axis
            more = self.residuals(x, 1.0 + _STEP)[1]
            by_drag -= (more - expected) / (_STEP * r.size_mn[:, None]) * force[:, None] * bend / 2 * (1 - bend**2 / 20)
        noise = s.wavelength_nm**2 * (p.by_difference**2).sum(axis=(1, 2)) / 2.0
        along = s.load_mn**2 * _outer(by_load) + s.friction**2 * _outer(by_drag)
        along[:, [0, 1], [0, 1]] += noise
        along[:, 2, 2] += s.gauge_mm**2
        none = r.bent == 0
        along[none, 2, :] = along[none, :, 2] = 0.0
        along[none, 2, 2] = 1.0
        across = s.load_mn**2 * _outer(by_load[:, :2])
        across[:, [0, 1], [0, 1]] += noise
        return along, across

    def prior(self, x: Floats) -> Floats:
        """How far the drawing is left (5,), in deviations."""
        p, d = Parameters.of(x), self.drawn
        return np.concatenate([
            (p.distances_mm - d.distances_mm) / SECTION_MM,
            [(p.length_mm - d.length_mm) / LENGTH_MM],
            [np.log(p.stiffness_mn_mm2 / d.stiffness_mn_mm2) / _STIFFNESS],
            [p.zero_mm / ZERO_MM],
        ])  # fmt: skip

    def deviance(self, x: Floats, s: Scatter) -> float:
        left = self.residuals(x)[0]
        total = float((self.prior(x) ** 2).sum())
        for block, columns in zip(self.covariance(x, s), ([0, 1, 4], [2, 3]), strict=True):
            one = left[:, columns]
            total += float(np.einsum("ni,ni->", one, linalg.solve(block, one[..., None])[..., 0]))
            total += float(np.linalg.slogdet(block)[1].sum())
        return total

    def whitener(self, x: Floats, s: Scatter) -> tuple[Floats, Floats]:
        along, across = (linalg.inv(linalg.cholesky(block)) for block in self.covariance(x, s))
        return along, across

    def whitened(self, x: Floats, by: tuple[Floats, Floats]) -> Floats:
        left = self.residuals(x)[0]
        parts = [np.einsum("nij,nj->ni", w, left[:, c]).ravel() for w, c in zip(by, ([0, 1, 4], [2, 3]), strict=True)]
        return np.concatenate([*parts, self.prior(x)])

    def scattered(self, x: Floats, before: Scatter) -> Scatter:
        """The scatter of largest likelihood."""
        least = np.array([self.noise_nm, 1e-3, 1e-4, 1e-4])
        start = np.log(
            np.maximum([before.wavelength_nm, before.load_mn, before.friction, before.gauge_mm], 2.0 * least)
        )

        def worse(v: Floats) -> float:
            return self.deviance(x, Scatter(*np.maximum(np.exp(v), least)))

        simplex = np.vstack([start, start + 0.7 * np.eye(4)])
        options = {"xatol": 0.02, "fatol": 0.02, "maxiter": 300, "initial_simplex": simplex}
        found = minimize(worse, start, method="Nelder-Mead", options=options)
        return Scatter(*(float(v) for v in np.maximum(np.exp(found.x), least)))


def fit_bench(
    rows: LoadRows, drawn: Drawn, convention: Convention, noise_nm: float, scatter: Scatter | None = None
) -> BenchFit:
    """Fits a table read under a convention; with a ``scatter`` given, that is kept."""
    model = _Model(rows, drawn, convention, noise_nm)
    x = _start(model)
    found = scatter or Scatter(noise_nm, 1.0, 0.03, 0.02)
    scale = np.concatenate([np.full(8, 0.1 * np.abs(x[:8]).max()), [0.3, 0.3, 0.5, 0.1, 0.2]])
    for _ in range(1 if scatter else _ROUNDS):
        by = model.whitener(x, found)
        done = least_squares(model.whitened, x, x_scale=scale, args=(by,), method="trf", max_nfev=60)
        x = done.x
        if scatter is None:
            found = model.scattered(x, found)
    by = model.whitener(x, found)
    done = least_squares(model.whitened, x, x_scale=scale, args=(by,), method="trf", max_nfev=60)
    left, expected, _ = model.residuals(done.x)
    scaled = done.jac * scale
    covariance = linalg.pinv(scaled.T @ scaled, hermitian=True, rcond=1e-12) * np.outer(scale, scale)
    return BenchFit(convention, rows, drawn, done.x, covariance, found, model.deviance(done.x, found), left, expected,
                    (done.fun, done.jac))  # fmt: skip


def _start(model: _Model) -> Floats:
    """Gains by plain least squares at the drawing's rod."""
    d, r = model.drawn, model.rows
    x = np.concatenate([np.zeros(8), d.distances_mm, [d.length_mm, np.log(d.stiffness_mn_mm2), 0.0]])
    _, expected, _ = model.residuals(x)
    for s in range(2):
        found = linalg.lstsq(r.differences_nm[:, s], expected[:, s, None] * r.way, rcond=None)[0]
        x[4 * s : 4 * s + 4] = found.T.ravel()
    return x


def _outer(v: Floats) -> Floats:
    return np.asarray(v[:, :, None] * v[:, None, :])


@dataclass(frozen=True, eq=False)
class Open:
    """What a fit leaves open of the estimates. ``depth`` (3, 3) is the covariance of θ in a depth that is off by
    θ₀ + θ₁ d/10 + θ₂ (d/10)², mm, without the deviation ``deeper_mm`` of all depths alike; ``force`` is relative,
    ``beam`` (2, 2) the covariance of length (mm) and stiffness as the gratings' own force sees it (mN·mm²)."""

    depth: Floats
    deeper_mm: float
    force: float
    beam: Floats


def left_open(fit: BenchFit, lacks: tuple[Lack, ...] = ()) -> Open:
    """By the fit's covariance, and by what no parameter takes: a lack that both sections share is one of the force,
    what
    they do not share is one of the depth."""
    p, rng = fit.value, np.linspace(1.0, 25.0, 9)
    near, far = p.distances_mm
    rng = rng[rng < near - 3.0]
    one, two = near - rng, far - rng
    apart = far - near
    by_depth, by_force = np.zeros((4, len(rng), 13)), np.zeros((4, 13))
    for k, angle in enumerate(np.pi / 4 * np.arange(4)):
        way = np.array([np.cos(angle), np.sin(angle)])
        # differences that a moment of one makes, and what another gain makes of them along the way
        made = [linalg.solve(p.by_difference[s], way) for s in range(2)]
        for s, (arm, lever) in enumerate(((one, -two), (two, one))):
            moved = np.outer(way, made[s]).ravel()
            by_depth[k, :, 4 * s : 4 * s + 4] = (lever * arm / apart)[:, None] * moved
            by_force[k, 4 * s : 4 * s + 4] = 0.5 * moved
        by_depth[k, :, 8], by_depth[k, :, 9] = two / apart, -one / apart
    middle = len(rng) // 2
    off = np.mean([j @ fit.covariance @ j.T for j in by_depth], axis=0)
    own = {one.what[-2:]: one.relative for one in lacks if one.unit != "mm"}
    unlike = own.get(" I", np.zeros(1)) - own.get("II", np.zeros(1))
    off += float((unlike**2).mean()) * np.outer(one * two / apart, one * two / apart)
    basis = np.stack([np.ones_like(rng), rng / 10.0, (rng / 10.0) ** 2], axis=1)
    shape = linalg.pinv(basis)
    # all depths alike: that of the middle; the rest is what others differ from it
    less = np.eye(len(rng)) - np.eye(len(rng))[middle]
    depth = shape @ less @ off @ less.T @ shape.T
    # a stiffness that goes with the gains does not bend the tip
    rod = np.zeros((2, 13))
    rod[0, 10], rod[1, 11] = 1.0, p.stiffness_mn_mm2
    by_gain = np.mean(by_force, axis=0)
    rod[1] -= p.stiffness_mn_mm2 * by_gain
    alike = max((float((v**2).mean()) for v in own.values()), default=0.0)
    force = float(np.mean([j @ fit.covariance @ j for j in by_force]) + alike)
    return Open(
        (depth + depth.T) / 2.0,
        float(np.sqrt(off[middle, middle])),
        float(np.sqrt(force)),
        rod @ fit.covariance @ rod.T,
    )


@dataclass(frozen=True)
class Lack:
    """What rows do that the model has no term for: ``what`` (a section's moments or the deflections), what goes with
    load
    and depth, over what was expected (n,), the ``most`` of it in ``unit``, and the p-value."""

    what: str
    unit: str
    relative: Floats
    most: float
    p: float


def lack_of_fit(fit: BenchFit) -> tuple[Lack, ...]:
    """Score tests of terms in load squared and cubed and in load times depth, for moments and deflections."""
    n = len(fit.rows.depth_mm)
    fun, jac = fit.whitened
    model = _Model(fit.rows, fit.drawn, fit.convention, fit.scatter.wavelength_nm)
    by = model.whitener(fit.x, fit.scatter)[0]
    out = []
    names = (("the moments at section I", "mN mm"), ("the moments at section II", "mN mm"), ("the deflections", "mm"))
    for column, (what, unit) in enumerate(names):
        rows = fit.rows.bent > 0 if column == 2 else np.ones(n, dtype=bool)
        if rows.sum() < 12:
            continue
        expected = fit.expected[:, column]
        scaled = expected / np.abs(expected[rows]).max()
        deep = fit.rows.depth_mm / max(float(fit.rows.depth_mm.max()), 1e-9)
        more = np.stack([scaled**2, scaled**3, scaled * deep], axis=1) * rows[:, None]
        block = np.einsum("ni,nk->nik", by[:, :, column], more).reshape(3 * n, 3)
        white = np.vstack([block, np.zeros((len(fun) - 3 * n, 3))])
        white = white - jac @ linalg.lstsq(jac, white, rcond=None)[0]
        # loads at few depths show less than three terms
        left, seen, terms = linalg.svd(white * np.abs(expected[rows]).max(), full_matrices=False)
        told = seen > 1.0 / _TOLD
        if not told.any():
            continue
        by_term = -left[:, told].T @ fun
        found = np.abs(expected[rows]).max() * more @ (terms[told].T @ (by_term / seen[told]))
        p = float(scipy.stats.chi2.sf(by_term @ by_term, told.sum()))
        out.append(Lack(what, unit, found / np.where(expected != 0, expected, 1.0), float(np.abs(found).max()), p))
    return tuple(out)


def best_fit(rows: LoadRows, drawn: Drawn, noise_nm: float, told: tuple[str, str]) -> list[BenchFit]:
    """Fits under all conventions that were not told otherwise (``"any"``), the best first; a difference of the deviance
    of less than 6 tells nothing, and the paper's own reading comes first then."""
    depth, force = told
    tried = [c for c in CONVENTIONS if depth in ("any", c.depth) and force in ("any", c.force)]
    fits = [fit_bench(rows, drawn, c, noise_nm) for c in tried]
    least = min(f.deviance for f in fits)
    first = next(f for f in fits if f.deviance < least + 6.0)
    return [first, *(f for f in fits if f is not first)]


def chi2_as(fits: list[BenchFit], noise_nm: float) -> dict[Convention, float]:
    """χ² of the same rows under each convention, by the scatter of the first."""
    best = fits[0]
    again = [fit_bench(f.rows, f.drawn, f.convention, noise_nm, best.scatter) for f in fits]
    return {f.convention: float((f.whitened[0] ** 2).sum()) for f in again}
