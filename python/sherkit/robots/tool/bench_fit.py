"""What a load bench says of a tool, by one likelihood: gains, sections, stiffness, length, and how its table is to be
read.

A row's moments at sections I and II and the deflection of the contact are what its load makes of the rod. They scatter
by the wavelengths' noise, by the load cell's (which both sections share), by friction that drags on the shaft (moment
``T y`` beside ``N x``), by the gauge's, and by where each load stands. All five are found with the parameters: Gaussian
likelihood, in turns least squares whitened by the scatter and the scatter of largest likelihood (Patterson and
Thompson, Biometrika 1971).

What a table calls depth and force is a convention: the load's height along the unbent axis (the paper's l, section V.A)
or the length of shaft beyond it; the force across that axis or across the shaft of what pushes it, or a weight that
hangs on it. Large bends tell which. Where the bench has its zero of the depth, and where sections stand, is told by
both the drawing and the rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from scipy.optimize import least_squares, minimize

import sherkit._core as _core

from ...base import linalg
from ...base.types import Bools, Floats
from .dead_weight import hung
from .tool import FlexibleTool, ToolDoubt, nested

#: How far a drawing may be off, mm: sections, free length; and the zero of the bench.
SECTION_MM, LENGTH_MM, ZERO_MM = 0.2, 1.0, 0.2
#: The stiffness of a drawing, relative.
_STIFFNESS = 0.3
_ROUNDS = 4
#: How well rows must tell a term that the model lacks, of the largest that is expected.
_TOLD = 0.05
#: And by so many times what readings that are off make of it.
_BEYOND = 2.0
_STEP = 1e-4
#: For a derivative by where a load stands, mm.
_ELSEWHERE_MM = 1e-3
#: Two differences of three fibres, orthonormal, without what is common to them.
DIFFERENCES = np.array([[2.0, -1.0, -1.0], [0.0, np.sqrt(3.0), -np.sqrt(3.0)]]) / np.sqrt(6.0)


@dataclass(frozen=True)
class Convention:
    """How a table of loads is to be read: ``depth`` is ``"axis"`` or ``"arc"``, ``force`` ``"across"`` or
    ``"normal"`` of one that pushes the shaft, ``"weight"`` of one that hangs on it."""

    depth: str
    force: str

    def __str__(self) -> str:
        depths = {"axis": "heights along the unbent axis", "arc": "lengths of shaft beyond the load"}
        forces = {"across": "across that axis", "normal": "across the bent shaft",
                  "weight": "dead weights across that axis"}  # fmt: skip
        return f"the bench's depths are {depths[self.depth]}, its forces {forces[self.force]}"


DEPTHS, FORCES = ("axis", "arc"), ("across", "normal", "weight")
#: The paper's own first.
CONVENTIONS = tuple(Convention(depth, force) for depth in DEPTHS for force in FORCES)


@dataclass(frozen=True)
class Scatter:
    """Deviations of a wavelength (nm), of a load's components (mN), of the friction's share, of the gauge (mm), and of
    where each load stood (mm)."""

    wavelength_nm: float
    load_mn: float
    friction: float
    gauge_mm: float
    place_mm: float


@dataclass(frozen=True, eq=False)
class LoadRows:
    """Loads (n,) as read: ``size_mn`` along ``way`` (n, 2) at ``depth_mm``, ``shifts_nm`` (n, 9),
    ``deflection_mm`` (NaN: not read)."""

    size_mn: Floats
    way: Floats
    depth_mm: Floats
    shifts_nm: Floats
    deflection_mm: Floats

    def some(self, rows: Bools) -> LoadRows:
        """Some of the rows (n,)."""
        return LoadRows(*(getattr(self, one.name)[rows] for one in fields(self)))

    @cached_property
    def differences_nm(self) -> Floats:
        """Of the fibres of sections I and II (n, 2, 2)."""
        return np.asarray(np.einsum("dk,nsk->nsd", DIFFERENCES, self.shifts_nm[:, :6].reshape(-1, 2, 3)))

    @cached_property
    def bent(self) -> Floats:
        """1 where a deflection was read (n,), else 0."""
        return np.isfinite(self.deflection_mm).astype(float)

    @cached_property
    def sideways(self) -> Floats:
        """Across the load (n, 2)."""
        return np.stack([-self.way[:, 1], self.way[:, 0]], axis=1)


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
class BenchModel:
    """Residuals of rows under a convention, and their covariance; ``drawn`` is the tool as it was known before, whose
    wavelengths scatter by ``noise_nm``."""

    rows: LoadRows
    drawn: FlexibleTool
    convention: Convention
    noise_nm: float

    @property
    def hangs(self) -> bool:
        """Whether the loads are weights, which differ from what pushes where bends are large."""
        return self.convention.force == "weight" and self.drawn.bending == "exact"

    @property
    def drawn_rod(self) -> Floats:
        """What the vector (13,) says of sections, rod and zero (5,), as they are drawn."""
        d = self.drawn
        return np.array([*d.distances_mm, d.length_mm, np.log(d.stiffness_mn_mm2), 0.0])

    def residuals(self, x: Floats, larger: float = 1.0) -> tuple[Floats, Floats, Floats]:
        """Residuals (n, 5) of the moments along the load at I and II, of the deflection, of the moments across it;
        what was expected of the first three (n, 3), and the true loads (n, 2): force across the rod, arc; for loads
        that are ``larger``."""
        p, r = Parameters.of(x), self.rows
        beam = _core.ToolBeam(max(p.length_mm, 1.0), p.stiffness_mn_mm2, self.drawn.bending == "exact")
        near, far = p.distances_mm.tolist()
        size, depth, by_height = larger * r.size_mn, r.depth_mm - p.zero_mm, self.convention.depth == "axis"
        if self.hangs:
            loads = hung(p.length_mm, p.stiffness_mn_mm2, size, depth, p.distances_mm, by_height=by_height)
        else:
            across = self.convention.force == "across"
            loads = beam.loads_batch(size, np.ascontiguousarray(depth), (near, far), by_height, across)
        moments = np.einsum("sad,nsd->nsa", p.by_difference, r.differences_nm)
        along = np.einsum("nsa,na->ns", moments, r.way) - loads[:, 2:4]
        aside = np.einsum("nsa,na->ns", moments, r.sideways)
        bend = np.where(r.bent > 0, np.nan_to_num(r.deflection_mm) - loads[:, 4], 0.0)
        return np.column_stack([along, bend, aside]), loads[:, 2:], loads[:, :2]

    def spread(self, x: Floats) -> Floats:
        """Covariances of each row's residuals (6, n, 5, 5) by a variance of one of wavelengths, load, friction, gauge
        and place; and one of a deflection that was not read."""
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
        # a load that stood elsewhere is one whose bench has another zero
        moved = x.copy()
        moved[12] += _ELSEWHERE_MM
        by_place = (self.residuals(moved)[1] - expected) / _ELSEWHERE_MM
        by_place[:, 2] *= r.bent
        by_load[:, 2] *= r.bent
        by_drag[:, 2] *= r.bent
        out = np.zeros((6, len(force), 5, 5))
        moments = [0, 1, 3, 4]
        out[0][:, moments, moments] = np.tile((p.by_difference**2).sum(axis=(1, 2)) / 2.0, 2)
        out[1, :, :3, :3], out[1, :, 3:, 3:] = _outer(by_load), _outer(by_load[:, :2])
        out[2, :, :3, :3] = _outer(by_drag)
        out[3, :, 2, 2], out[5, :, 2, 2] = r.bent, 1.0 - r.bent
        out[4, :, :3, :3] = _outer(by_place)
        return out

    def prior(self, x: Floats) -> Floats:
        """How far the drawing is left (5,), in deviations."""
        return (x[8:] - self.drawn_rod) / np.array([SECTION_MM, SECTION_MM, LENGTH_MM, _STIFFNESS, ZERO_MM])

    def deviance(self, x: Floats, s: Scatter) -> float:
        """Minus twice the logarithm of the likelihood."""
        return float((self.prior(x) ** 2).sum()) + _deviance(_whitener(self.spread(x), s), self.residuals(x)[0])

    def whitened(self, x: Floats, by: Floats) -> Floats:
        """What is minimised: residuals whitened by (n, 5, 5), row by row, then the prior's."""
        return np.append(np.einsum("nij,nj->ni", by, self.residuals(x)[0]), self.prior(x))

    def scattered(self, x: Floats, before: Scatter) -> Scatter:
        """The scatter of largest likelihood."""
        left, spread = self.residuals(x)[0], self.spread(x)
        least = np.array([self.noise_nm, 1e-3, 1e-4, 1e-4, 1e-4])
        start = np.log(np.maximum(astuple(before), 2.0 * least))

        def scatter_of(v: Floats) -> Scatter:
            return Scatter(*np.maximum(np.exp(v), least).tolist())

        simplex = np.vstack([start, start + 0.7 * np.eye(len(least))])
        # so near that rounding does not decide where it ends
        options = {"xatol": 2e-3, "fatol": 2e-3, "maxiter": 1000, "initial_simplex": simplex}
        found = minimize(
            lambda v: _deviance(_whitener(spread, scatter_of(v)), left), start, method="Nelder-Mead", options=options
        )
        return scatter_of(found.x)


def _whitener(spread: Floats, s: Scatter) -> Floats:
    """Takes residuals of each row to those of variance one (n, 5, 5)."""
    return linalg.inv(linalg.cholesky(np.tensordot(np.append(np.square(astuple(s)), 1.0), spread, 1)))


def _deviance(by: Floats, left: Floats) -> float:
    """Of residuals (n, 5) alone, by what whitens them."""
    squares = (np.einsum("nij,nj->ni", by, left) ** 2).sum()
    return float(squares - 2.0 * np.log(np.einsum("nii->ni", by)).sum())


@dataclass(frozen=True, eq=False)
class BenchFit:
    """What a ``model`` was fitted to: the vector ``x`` with its ``covariance`` (13, 13); ``deviance`` is minus twice
    the logarithm of the likelihood, ``left`` (n, 5) and ``expected`` (n, 3) are as in :class:`BenchModel`.
    ``whitened`` is what was minimised, with its Jacobian."""

    model: BenchModel
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


def fit_bench(model: BenchModel) -> BenchFit:
    """Fits a table read under a convention."""
    x = _start(model)
    scale = np.concatenate([np.full(8, 0.1 * np.abs(x[:8]).max()), [0.3, 0.3, 0.5, 0.1, 0.2]])

    def settled(x: Floats, s: Scatter) -> Any:
        by = _whitener(model.spread(x), s)
        return least_squares(model.whitened, x, x_scale=scale, args=(by,), method="trf", max_nfev=60)

    found = Scatter(model.noise_nm, 1.0, 0.03, 0.02, 0.02)
    done = settled(x, found)
    for _ in range(_ROUNDS):
        found = model.scattered(done.x, found)
        done = settled(done.x, found)
    left, expected, _ = model.residuals(done.x)
    scaled = done.jac * scale
    covariance = linalg.pinv(scaled.T @ scaled, hermitian=True, rcond=1e-12) * np.outer(scale, scale)
    return BenchFit(model, done.x, covariance, found, model.deviance(done.x, found), left, expected,
                    (done.fun, done.jac))  # fmt: skip


def _start(model: BenchModel) -> Floats:
    """Gains by plain least squares at the drawing's rod."""
    r, x = model.rows, np.append(np.zeros(8), model.drawn_rod)
    _, expected, _ = model.residuals(x)
    for s in range(2):
        found = linalg.lstsq(r.differences_nm[:, s], expected[:, s, None] * r.way, rcond=None)[0]
        x[4 * s : 4 * s + 4] = found.T.ravel()
    return x


def _outer(v: Floats) -> Floats:
    return np.asarray(v[:, :, None] * v[:, None, :])


@dataclass(frozen=True)
class Lack:
    """What rows do that the model has no term for: ``what`` (a section's moments or the deflections), what goes with
    load and depth, over what was expected (n,), the ``most`` of it in ``unit`` that parameters leave, and the
    p-value."""

    what: str
    unit: str
    relative: Floats
    most: float
    p: float

    def __str__(self) -> str:
        return (
            f"{self.what} do not follow the calibrated model: up to {self.most:.2g} {self.unit} go with load and depth "
            f"as nothing in it does (p = {self.p:.1g}); look for a bend beyond the model, a depth that is off, or "
            "fibres that slip"
        )


def lack_of_fit(fit: BenchFit) -> tuple[Lack, ...]:
    """Score tests of terms in load squared and cubed and in load times depth, for moments and deflections."""
    r, (fun, jac) = fit.model.rows, fit.whitened
    by = _whitener(fit.model.spread(fit.x), fit.scatter)
    deep = r.depth_mm / max(float(r.depth_mm.max()), 1e-9)
    out = []
    names = (("the moments at section I", "mN mm"), ("the moments at section II", "mN mm"), ("the deflections", "mm"))
    for column, (what, unit) in enumerate(names):
        rows = r.bent > 0 if column == 2 else np.ones_like(r.bent, dtype=bool)
        if rows.sum() < 12:
            continue
        expected = fit.expected[:, column]
        largest = np.abs(expected[rows]).max()
        scaled = expected / largest
        more = np.stack([scaled**2, scaled**3, scaled * deep], axis=1) * rows[:, None]
        # what a reading is off goes into the terms as well as into what is left
        by_reading = np.stack([2.0 * scaled**2, 3.0 * scaled**3, scaled * deep], axis=1) * rows[:, None]
        by_reading *= float(np.median(np.abs(fit.left[rows, column])) / np.median(np.abs(expected[rows])))
        into, chance = (np.einsum("ni,nk->nik", by[:, :, column], one).reshape(-1, 3) for one in (more, by_reading))
        white = np.zeros((len(fun), 3))
        white[: len(into)] = into
        white = white - jac @ linalg.lstsq(jac, white, rcond=None)[0]
        # loads at few depths, or of one size, show less than three terms
        left, seen, terms = linalg.svd(white * largest, full_matrices=False)
        told = seen > np.maximum(1.0 / _TOLD, _BEYOND * largest * np.linalg.norm(chance @ terms.T, axis=0))
        if not told.any():
            continue
        by_term = -left[:, told].T @ fun
        found = largest * more @ (terms[told].T @ (by_term / seen[told]))
        p = float(scipy.stats.chi2.sf(by_term @ by_term, told.sum()))
        # parameters take most of it: what they leave is what rows show
        shown = linalg.solve(by, (left[:, told] @ by_term)[: len(into)].reshape(-1, 5, 1))[:, column, 0]
        out.append(Lack(what, unit, found / np.where(expected != 0, expected, 1.0), float(np.abs(shown).max()), p))
    return tuple(out)


def left_open(fit: BenchFit, lacks: Sequence[Lack]) -> ToolDoubt:
    """The doubt of the tool as it was drawn, with what the fit leaves open of depth, force and beam: by its covariance,
    and by what no parameter takes. A lack that both sections share is one of the force, what they do not share is one
    of the depth."""
    p, rng = fit.value, np.linspace(1.0, 25.0, 9)
    near, far = p.distances_mm
    rng = rng[rng < near - 3.0]
    one, two = near - rng, far - rng
    apart = far - near
    angle = np.pi / 4 * np.arange(4)
    ways = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    by_depth, by_force = np.zeros((4, len(rng), 13)), np.zeros((4, 13))
    for s, (arm, lever) in enumerate(((one, -two), (two, one))):
        # differences that a moment of one makes, and what another gain makes of them along the way
        made = linalg.solve(p.by_difference[s], ways.T).T
        moved = (ways[:, :, None] * made[:, None, :]).reshape(4, 4)
        by_depth[:, :, 4 * s : 4 * s + 4] = (lever * arm / apart)[:, None] * moved[:, None]
        by_force[:, 4 * s : 4 * s + 4] = 0.5 * moved
    by_depth[:, :, 8], by_depth[:, :, 9] = two / apart, -one / apart
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
    beam = np.zeros((2, 2))
    if fit.model.rows.bent.any():
        beam = rod @ fit.covariance @ rod.T
        beam[1, 1] += sum(float((one.relative**2).mean()) for one in lacks if one.unit == "mm") * p.stiffness_mn_mm2**2
    return replace(
        fit.model.drawn.doubt,
        depth=nested((depth + depth.T) / 2.0), deeper_mm=float(np.sqrt(off[middle, middle])),
        force=float(np.sqrt(force)), beam=nested(beam),
    )  # fmt: skip


#: Of conventions whose deviance differs by less the paper's own is taken; one that differs by less than the second of
#: these may be it: each has a scatter of its own, and by chance the true one is less likely by as much.
_THE_SAME, AS_GOOD = 1.0, 10.0


def fit_as_reads_best(
    rows: LoadRows, drawn: FlexibleTool, noise_nm: float, told: tuple[str, str]
) -> tuple[BenchFit, dict[Convention, float]]:
    """The best fit under the conventions that were not told otherwise (``"any"``), and by how much χ² of each is larger
    than the likeliest's: twice the difference of the logarithms of their likelihoods, each with a scatter of its own.
    Of those that are the same the paper's own reading comes first; the covariance counts how far others that may be it
    lie from it."""
    depth, force = told
    tried = [c for c in CONVENTIONS if depth in ("any", c.depth) and force in ("any", c.force)]
    fits = [fit_bench(BenchModel(rows, drawn, c, noise_nm)) for c in tried]
    least = min(f.deviance for f in fits)
    best = next(f for f in fits if f.deviance < least + _THE_SAME)
    covariance = best.covariance.copy()
    for other in fits:
        if (less := other.deviance - least) < AS_GOOD:
            covariance += np.exp(-less / 4.0) * np.outer(other.x - best.x, other.x - best.x)
    return replace(best, covariance=covariance), {f.model.convention: f.deviance - least for f in fits}
