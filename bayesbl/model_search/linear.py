"""Posterior over sets of hypotheses, and over the parameters, for a linearised view.

A view (closed loop, inverse dynamics, speed lines, free motion) linearises at its fit:

    r = J u + Σ_k s_k C_k a_k + H h + e,   e ~ N(0, I)

r is the whitened residual, u the shift of the fitted parameters, and a_k the sizes of hypothesis k
in units of their usual size, normal or half-normal with standard deviation 1. s_k says whether the
hypothesis holds. h is the discrepancy that no hypothesis explains; each group of its columns has a
learned scale. Everything is normal but s, the signs and the scales. So u, h and the hypotheses
always included are marginalised exactly from Gram matrices (Rasmussen and Williams 2006, section
2.7).

Each half-normal size multiplies the evidence by 2, and together they multiply it by an orthant
probability. Expectation propagation computes it, exactly for one amplitude (Cunningham, Hennig and
Lacoste-Julien 2011). The prior over sets is Bernoulli (George and McCulloch 1993). All pairs are
tried, and larger sets are extended from the best. Nothing here knows what a hypothesis means.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.special import expit, log_ndtr

from bayesbl.model_search.constants import (
    BEAM,
    CONFOUNDED_MOST,
    DISCREPANCY_ABSENT,
    DISCREPANCY_LARGEST,
    DISCREPANCY_SPACING,
    EXPECTED_HYPOTHESES,
    FAR,
    KEPT_BELOW,
    MOST_KEPT,
    MOST_WEIGHED,
    NAMED_AT,
    WEIGHED_SHARE,
)
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.importance import normal_between

_LOG_TWO_PI = math.log(2.0 * math.pi)
GIBBS_SWEEPS = 25
ROUNDING = 2e-15
"""Rounding error of a number that is computed from numbers of size one."""

NOTHING = 1e-13
"""Singular value of unit columns, below which it is rounding error."""

DEPENDENT = 1e-8
"""Smallest component of a fitted column orthogonal to the others, relative to its length."""

EVEN: Mapping[str, float] = MappingProxyType({})
"""No individual prior probabilities: all hypotheses are equally probable."""


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """One form of a hypothesis.

    Attributes
    ----------
    hypothesis
        Label. Terms with the same label are alternatives (shapes, starts): a set has at most one of
        them.
    columns
        (N, k) whitened change of the prediction per usual size of each amplitude.
    positive
        Whether the amplitude is half-normal, never negative (k = 1).
    always
        Whether it is always included, never selected.
    absent
        Prior probability that a positive term which is always included has size zero: teeth attract
        one another or not, a speed is averaged or not. A half-normal prior alone would put a little
        of each law into every joint, and all of them would widen the gap's interval. Only draws use
        it.
    prior_weight
        Share of the hypothesis' prior probability.
    excludes
        Labels of hypotheses that cannot be in one set with it.
    requires
        Labels of hypotheses that it depends on (strong heredity; Chipman 1996, Can. J. Stat. 24,
        17). Those without terms are taken to hold.
    unit, source
        Usual size of its amplitudes, (k,), and the origin of the term, for callers.
    """

    hypothesis: str
    columns: FloatArray
    positive: bool = False
    always: bool = False
    absent: float = 0.0
    prior_weight: float = 1.0
    excludes: frozenset[str] = frozenset()
    requires: frozenset[str] = frozenset()
    unit: FloatArray | float = 1.0
    source: Any = None

    def __post_init__(self) -> None:
        if self.columns.ndim != 2 or (self.positive and self.columns.shape[1] != 1):
            raise ValueError(f"{self.hypothesis}: columns of shape {self.columns.shape}")


@dataclass(frozen=True, slots=True, eq=False)
class DiscrepancyGroup:
    """Columns of the discrepancy that share one learned scale.

    Attributes
    ----------
    kind
        What it is: ``"motor_torque_over_motor_angle"``, ``"motor_speed_error"``, …
    columns
        Its columns of :attr:`Linearised.discrepancy`.
    usual
        Usual root mean square, in standard deviations of a sample's noise. The prior of the scale,
        flat in its logarithm, has a half-normal factor of this width. So a discrepancy of this size
        does not replace laws.
    """

    kind: str
    columns: slice
    usual: float = math.inf


@dataclass(frozen=True, slots=True, eq=False)
class MisfitBand:
    """Rows with errors besides noise, of the same variance and otherwise unknown.

    Equivalent to a group with one column for each row, at the cost of one factor for each.

    ``kind``: what the rows are: ``"load orders up to 8"``, …; ``rows``: rows of the residual, the
    columns and the Jacobian; ``freedom``: number of independent values, if the rows are an R factor
    of more; ``usual``: as :attr:`DiscrepancyGroup.usual`.
    """

    kind: str
    rows: slice
    freedom: int
    usual: float = math.inf


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """A view at its fit.

    Attributes
    ----------
    residual
        (N,) whitened, measured minus predicted.
    jacobian
        (N, d) change of the prediction by each fitted parameter.
    prior_precision
        (d, d) of the fitted parameters; zeros where nothing is known.
    prior_pull
        (d,) gradient of the log prior at the fit; zeros at the prior's centre.
    terms
        The catalogue in this view.
    discrepancy
        (N, m) columns, in any unit; each group is scaled to a root mean square of one.
    groups
        Groups of these columns.
    bands
        Rows with unknown errors; no two overlap.
    """

    residual: FloatArray
    jacobian: FloatArray
    prior_precision: FloatArray
    prior_pull: FloatArray
    terms: Sequence[Term]
    discrepancy: FloatArray
    groups: Sequence[DiscrepancyGroup] = ()
    bands: Sequence[MisfitBand] = ()

    @property
    def scaled(self) -> tuple[DiscrepancyGroup | MisfitBand, ...]:
        """All groups and bands, in the order of :attr:`Model.scales`."""
        return (*self.groups, *self.bands)


def even_probability(hypotheses: int) -> float:
    """Prior probability of each of this many hypotheses in a joint that nobody has examined."""
    return min(EXPECTED_HYPOTHESES / max(1, hypotheses), 0.5)


def log_odds(probability: float) -> float:
    """ln of the odds of a probability."""
    return math.log(probability) - math.log1p(-probability)


@dataclass(frozen=True, slots=True)
class Model:
    """A set of terms at one scale of the discrepancy.

    ``terms``: indices into :attr:`Linearised.terms`, without those always included; ``scales``:
    standard deviation of each discrepancy group, then of each misfit band, in units of a sample's
    noise; 0: absent; ``log_posterior``: ln of the probability.
    """

    terms: tuple[int, ...]
    scales: tuple[float, ...]
    log_posterior: float
    _level: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Draws:
    """Draws of the posterior.

    (n, c) sizes of all columns of all terms in usual sizes, (n, m) coefficients of the
    discrepancy's columns as the caller scaled them, (n, d) shift of the fitted parameters by both,
    and (n, d) u itself in the linearisation.
    """

    sizes: FloatArray
    discrepancy: FloatArray
    shift: FloatArray
    fitted: FloatArray


def orthant(
    mean: FloatArray, precision: FloatArray, positive: np.ndarray, sweeps: int = 12
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """ln P(a > 0 where ``positive``) of normal vectors, and mean and covariance given that, by row.

    Expectation propagation on the sites a_i > 0. Exact for one bounded amplitude, otherwise to some
    parts in a thousand. (B, n), (B, n, n) and (B, n) to (B,), (B, n) and (B, n, n).
    """
    covariance = np.linalg.inv(precision)
    natural = np.einsum("bij,bj->bi", precision, mean)
    mu, sigma = mean.copy(), covariance.copy()
    t, v = np.zeros_like(mean), np.zeros_like(mean)
    log_site = np.zeros_like(mean)
    bounded = [i for i in range(mean.shape[1]) if positive[:, i].any()]
    if len(bounded) == 1:
        sweeps = 1
    for _ in range(sweeps):
        largest_change = 0.0
        for i in bounded:
            on = positive[:, i]
            # Rounding must not make a variance negative if the matrix is nearly singular.
            s = np.maximum(sigma[:, i, i], 1e-12 * np.abs(covariance[:, i, i]))
            cavity = 1.0 / np.maximum(1.0 / s - t[:, i], 1e-12 / s)
            cavity_mean = cavity * (mu[:, i] / s - v[:, i])
            z = cavity_mean / np.sqrt(cavity)
            log_z = log_ndtr(z)
            hazard = np.exp(-0.5 * z * z - 0.5 * _LOG_TWO_PI - log_z)
            is_far = z < -50.0
            zf = np.where(is_far, z, -50.0)
            variance_ratio = np.where(is_far, 1.0 / zf**2, 1.0 - hazard * (z + hazard))
            tilted_mean = np.where(
                is_far, -np.sqrt(cavity) / zf, cavity_mean + np.sqrt(cavity) * hazard
            )
            tilted_variance = cavity * np.clip(variance_ratio, 1e-12, 1.0)
            t_new = np.where(on, np.maximum(1.0 / tilted_variance - 1.0 / cavity, 0.0), 0.0)
            v_new = np.where(on, tilted_mean / tilted_variance - cavity_mean / cavity, 0.0)
            dt, dv = t_new - t[:, i], v_new - v[:, i]
            row = sigma[:, :, i].copy()
            grow = 1.0 + dt * s
            mu = mu + ((dv - dt * mu[:, i]) / grow)[:, None] * row
            sigma = sigma - (dt / grow)[:, None, None] * row[:, :, None] * row[:, None, :]
            t[:, i], v[:, i] = t_new, v_new
            largest_change = max(largest_change, float(np.max(np.abs(dt) * s / grow)))
            site = -0.5 * np.log1p(t_new * cavity) + 0.5 * (
                (cavity_mean / cavity + v_new) ** 2 * cavity / (1.0 + t_new * cavity)
                - cavity_mean**2 / cavity
            )
            log_site[:, i] = np.where(on, log_z - site, 0.0)
        if largest_change < 1e-4:
            break
    tilted = precision + t[:, :, None] * np.eye(mean.shape[1])
    log_det = np.linalg.slogdet(tilted)[1] - np.linalg.slogdet(precision)[1]
    normal = 0.5 * (((natural + v) * mu).sum(1) - (natural * mean).sum(1)) - 0.5 * log_det
    return np.asarray(log_site.sum(1) + normal), mu, np.asarray(sigma, dtype=float)


def _triangle(rows: FloatArray) -> FloatArray:
    """R factor of rows (n, p), shape (p, p): it has their inner products, without squaring them.

    Its diagonal is not negative. So it is unique, and draws that are made with it do not change
    with rounding.
    """
    missing = max(rows.shape[1] - len(rows), 0)
    triangle = np.linalg.qr(np.pad(rows, [(0, missing), (0, 0)]), mode="r")
    return np.asarray(np.where(np.diag(triangle) < 0.0, -1.0, 1.0)[:, None] * triangle)


@dataclass(frozen=True, slots=True, eq=False)
class _Marginalised:
    """Some columns of whitened rows, integrated out.

    Attributes
    ----------
    root, along, across
        Given the sizes v of the other columns, those of these are root (along − across v + e) with
        a standard normal e; shapes (q, rank), (rank,) and (rank, k).
    rest
        Other columns and residual orthogonal to these, (k + 1, k + 1), an R factor.
    log_volume
        −½ ln |A|, A the posterior precision of these columns.
    """

    root: FloatArray
    along: FloatArray
    across: FloatArray
    rest: FloatArray
    log_volume: float

    @classmethod
    def of(cls, rows: FloatArray, count: int) -> _Marginalised:
        """Integrate out the first columns of whitened rows, priors among them; residual last.

        A direction with neither data nor prior is left out.
        """
        columns, others = rows[:, :count], rows[:, count:]
        unit = np.linalg.norm(columns, axis=0)
        unit = np.where(unit > 0.0, unit, 1.0)
        basis, sizes, axes = np.linalg.svd(columns / unit, full_matrices=False)
        kept = sizes > NOTHING
        basis, sizes, axes = basis[:, kept], sizes[kept], axes[kept]
        products = basis.T @ others
        rest = others - basis @ products
        return cls(
            axes.T / sizes / unit[:, None],
            products[:, -1],
            products[:, :-1],
            _triangle(rest - basis @ (basis.T @ rest)),
            -float(np.log(sizes).sum() + np.log(unit).sum()),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """The view with nuisances and discrepancy h marginalised at one level of their scales.

    Attributes
    ----------
    matrix, target
        Whitened columns of the remaining terms, (k, k), and residual, (k,).
    precision
        Precision of their sizes with their priors, (k, k).
    log_evidence
        ln evidence of the residual orthogonal to them.
    of_h
        Given sizes a, the present columns of h are T⁻¹ (y − B a + e): (T, B, y) side by side.
    """

    matrix: FloatArray
    target: FloatArray
    precision: FloatArray
    log_evidence: float
    of_h: FloatArray


class _Grams:
    """Gram matrices with u marginalised: everything that depends on the view alone."""

    def __init__(self, view: Linearised, probability: Mapping[str, float]) -> None:
        self.view = view
        terms = view.terms
        self.selected = [i for i, t in enumerate(terms) if not t.always]
        self.free = [i for i, t in enumerate(terms) if t.always and not t.positive]
        remaining = [i for i in range(len(terms)) if i not in set(self.free)]
        self.widths = np.array([t.columns.shape[1] for t in terms], dtype=int)
        ends = np.cumsum([0, *self.widths])
        column_ranges = [np.arange(a, b) for a, b in itertools.pairwise(ends)]
        empty = np.zeros(0, dtype=int)
        self.columns_remaining = np.concatenate([empty, *(column_ranges[i] for i in remaining)])
        self.columns_free = np.concatenate([empty, *(column_ranges[i] for i in self.free)])
        self.d, self.k = view.jacobian.shape[1], self.columns_remaining.size
        self.m = view.discrepancy.shape[1]
        self.scale_of_column = self._discrepancy_scale()
        nuisance = [view.jacobian, *(terms[i].columns for i in self.free)]
        h = view.discrepancy * self.scale_of_column
        columns = [terms[i].columns for i in remaining]
        everything = np.hstack([*nuisance, *columns, h, view.residual[:, None]])
        free = np.eye(self.columns_free.size, everything.shape[1], self.d)
        self.prior = np.concatenate([self._prior_of_u(everything.shape[1]), free])
        in_band = np.zeros(len(everything), dtype=bool)
        self.parts = []
        for band in view.bands:
            in_band[band.rows] = True
            self.parts.append(_triangle(everything[band.rows]))
        self.outside_bands = _triangle(everything[~in_band])
        self._bases: dict[tuple[int, ...], tuple[_Marginalised, _Marginalised]] = {}
        samples = view.residual.size
        lowest = 1.0 / math.sqrt(max(1, samples))
        steps = math.ceil(math.log(DISCREPANCY_LARGEST / lowest) / math.log(DISCREPANCY_SPACING))
        self.lattice = np.concatenate([[0.0], lowest * DISCREPANCY_SPACING ** np.arange(steps)])
        self.of_u = self.bases((0,) * len(view.scaled))[1]
        by_prior = np.sum((self.prior[:, : self.d] @ self.of_u.root) ** 2)
        freedom = samples - self.of_u.along.size + float(by_prior)
        self.excess_chi_square = float(np.sum(self.of_u.rest[:, -1] ** 2)) - freedom
        starts = dict(zip(remaining, np.cumsum([0, *self.widths[remaining]]), strict=False))
        self.columns_of = {i: starts[i] + np.arange(self.widths[i]) for i in remaining}
        always_positive = [i for i in remaining if terms[i].always]
        self.bound_columns = np.concatenate([empty, *(self.columns_of[i] for i in always_positive)])
        self.is_positive = np.zeros(self.k, dtype=bool)
        self.absent = np.zeros(self.k)
        for i in remaining:
            self.is_positive[starts[i]] = terms[i].positive
            self.absent[starts[i]] = terms[i].absent
        even = even_probability(len({terms[i].hypothesis for i in self.selected}))
        self.log_prior = np.zeros(len(terms))
        for i in self.selected:
            odds = log_odds(probability.get(terms[i].hypothesis, even))
            self.log_prior[i] = odds + math.log(terms[i].prior_weight)
        self.excluded = self._exclusions()
        present = {term.hypothesis for term in terms}
        self.requires = [term.requires & present for term in terms]
        self._cache: dict[tuple[int, ...], _Level] = {}

    def _prior_of_u(self, width: int) -> FloatArray:
        """Prior of u as rows W with W u = w + e, e standard normal: W in front and w at the end."""
        view = self.view
        scale = np.sqrt(np.diag(view.prior_precision))
        scale = np.where(scale > 0.0, scale, 1.0)
        values, axes = np.linalg.eigh(view.prior_precision / np.outer(scale, scale))
        axes, root = axes[:, values > ROUNDING], np.sqrt(values[values > ROUNDING])
        rows = np.zeros((root.size, width))
        rows[:, : self.d] = root[:, None] * axes.T * scale
        rows[:, -1] = axes.T @ (view.prior_pull / scale) / root
        self.log_prior_volume = float(np.log(root).sum() + np.log(scale).sum())
        return rows

    def bases(self, level: tuple[int, ...]) -> tuple[_Marginalised, _Marginalised]:
        """All nuisances, and u alone, marginalised at the bands' scales."""
        indices = level[len(self.view.groups) :]
        if indices not in self._bases:
            sds = np.sqrt(1.0 + self.lattice[list(indices)] ** 2)
            parts = [part / sd for part, sd in zip(self.parts, sds, strict=True)]
            rows = np.concatenate([self.outside_bands, *parts, self.prior])
            of_u = all_nuisances = _Marginalised.of(rows, self.d)
            if self.free:
                all_nuisances = _Marginalised.of(rows, self.d + self.columns_free.size)
            self._bases[indices] = all_nuisances, of_u
        return self._bases[indices]

    def _discrepancy_scale(self) -> FloatArray:
        size, squares = self.view.residual.size, (self.view.discrepancy**2).sum(axis=0)
        scale = np.zeros(squares.size)
        for group in self.view.groups:
            total = squares[group.columns].sum()
            scale[group.columns] = math.sqrt(size / total) if total > 0.0 else 0.0
        return scale

    def _exclusions(self) -> np.ndarray:
        """Matrix of the pairs of terms that cannot be in one set."""
        terms = self.view.terms
        excluded = np.zeros((len(terms), len(terms)), dtype=bool)
        labels = np.array([t.hypothesis for t in terms])
        for i, term in enumerate(terms):
            excluded[i] = (labels == term.hypothesis) | np.isin(labels, list(term.excludes))
        return excluded | excluded.T

    def precision_of_h(self, level: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
        """Indices of the present columns of h, and their prior precision."""
        present, precision = [], []
        for index, group in zip(level, self.view.groups, strict=False):
            if index:
                indices = np.arange(self.m)[group.columns]
                present.append(indices[self.scale_of_column[indices] > 0.0])
                precision.append(np.full(present[-1].size, self.lattice[index] ** -2.0))
        if not present:
            return np.zeros(0, dtype=int), np.zeros(0)
        return np.concatenate(present), np.concatenate(precision)

    def at(self, level: tuple[int, ...]) -> _Level:
        """The view at one level."""
        if level not in self._cache:
            base = self.bases(level)[0]
            present, precision = self.precision_of_h(level)
            order = np.concatenate([present + self.k, np.arange(self.k), [-1]])
            prior = np.zeros((present.size, order.size))
            np.fill_diagonal(prior, np.sqrt(precision))
            triangle = _triangle(np.concatenate([base.rest[:, order], prior]))
            of_h, below = triangle[: present.size], triangle[present.size :]
            shrink = np.abs(np.diag(of_h)) / np.sqrt(precision)
            log_evidence = base.log_volume - float(np.log(shrink).sum()) + self.log_prior_volume
            log_evidence -= 0.5 * float(below[-1, -1]) ** 2
            absent = DISCREPANCY_ABSENT
            for index, group in zip(level, self.view.scaled, strict=True):
                weight = absent if index == 0 else (1.0 - absent) / (self.lattice.size - 1)
                scale = float(self.lattice[index])
                log_evidence += math.log(weight) - 0.5 * (scale / group.usual) ** 2
                if isinstance(group, MisfitBand):
                    log_evidence -= 0.5 * group.freedom * math.log1p(scale**2)
            matrix = below[:-1, present.size : -1]
            gram = matrix.T @ matrix
            # The prior of each size is 1. The rest keeps collinear columns apart beyond rounding.
            precision_of_sizes = gram + np.diag(1.0 + ROUNDING * np.diag(gram))
            self._cache[level] = _Level(
                matrix, below[:-1, -1], precision_of_sizes, log_evidence, of_h
            )
        return self._cache[level]

    def right(self, level: tuple[int, ...]) -> FloatArray:
        """Products of the remaining columns with the residual, (k,)."""
        return np.asarray(self.at(level).matrix.T @ self.at(level).target)

    def columns(self, terms: tuple[int, ...]) -> np.ndarray:
        """Columns of a set's terms and of those always included, (n,)."""
        return np.concatenate([*(self.columns_of[i] for i in terms), self.bound_columns])

    def is_complete(self, terms: tuple[int, ...]) -> bool:
        """Whether the set has everything that its terms require."""
        labels = {self.view.terms[i].hypothesis for i in terms}
        return all(self.requires[i] <= labels for i in terms)

    def log_posterior(
        self, sets: Sequence[tuple[int, ...]], level: tuple[int, ...], *, sweeps: int = 12
    ) -> FloatArray:
        """ln of prior times evidence of sets at one level, (B,)."""
        at, right = self.at(level), self.right(level)
        result = at.log_evidence + np.array([self.log_prior[list(terms)].sum() for terms in sets])
        by_size: dict[int, list[int]] = {}
        columns_by_set = [self.columns(terms) for terms in sets]
        for k, columns in enumerate(columns_by_set):
            by_size.setdefault(columns.size, []).append(k)
        for size, indices in by_size.items():
            if size == 0:
                result[indices] -= 0.5 * float(at.target @ at.target)
                continue
            columns = np.stack([columns_by_set[k] for k in indices])
            precision = at.precision[columns[:, :, None], columns[:, None, :]]
            mean = np.linalg.solve(precision, right[columns][:, :, None])[:, :, 0]
            # The residual itself: a difference of much larger sums of squares is rounding error.
            residual = at.target - np.einsum("kbi,bi->bk", at.matrix[:, columns], mean)
            chi_square = (residual**2).sum(1) + (mean**2).sum(1)
            values = -0.5 * (chi_square + np.linalg.slogdet(precision)[1])
            positive = self.is_positive[columns]
            if positive.any():
                log_orthant = orthant(mean, precision, positive, sweeps)[0]
                values = values + math.log(2.0) * positive.sum(1) + log_orthant
            result[indices] += values
        return result

    def extensions(self, terms: tuple[int, ...], level: tuple[int, ...]) -> FloatArray:
        """Gain in ln of prior times evidence by adding each selected term; −∞ if it is excluded.

        A first estimate, which ignores the sign constraints of the set.
        """
        precisions, right = self.at(level).precision, self.right(level)
        columns = self.columns(terms)
        if columns.size:
            regression = np.linalg.solve(precisions[np.ix_(columns, columns)], precisions[columns])
            precisions = precisions - precisions[:, columns] @ regression
            right = right - regression.T @ right[columns]
        selected = np.array(self.selected, dtype=int)
        added = np.full(selected.size, -np.inf)
        possible = (
            ~self.excluded[list(terms)][:, selected].any(axis=0)
            if terms
            else np.ones(selected.size, dtype=bool)
        )
        for width in np.unique(self.widths[selected]):
            rows = np.flatnonzero(possible & (self.widths[selected] == width))
            if not rows.size:
                continue
            added_columns = np.stack([self.columns_of[i] for i in selected[rows]])
            precision = precisions[added_columns[:, :, None], added_columns[:, None, :]]
            b = right[added_columns]
            mean = np.linalg.solve(precision, b[:, :, None])[:, :, 0]
            value = 0.5 * (b * mean).sum(1) - 0.5 * np.linalg.slogdet(precision)[1]
            if width == 1:
                z = mean[:, 0] * np.sqrt(precision[:, 0, 0])
                value += np.where(
                    self.is_positive[added_columns[:, 0]], math.log(2.0) + log_ndtr(z), 0.0
                )
            added[rows] = value + self.log_prior[selected[rows]]
        return added

    def normal(
        self, terms: tuple[int, ...], level: tuple[int, ...]
    ) -> tuple[np.ndarray, FloatArray, FloatArray]:
        """Columns of a set (those always included last); mean and precision without sign
        constraints."""
        columns = self.columns(terms)
        precision = self.at(level).precision[np.ix_(columns, columns)]
        return columns, np.linalg.solve(precision, self.right(level)[columns]), precision


def search(
    linearised: Linearised, max_terms: int = 3, probability: Mapping[str, float] = EVEN
) -> ModelPosterior:
    """Compute the posterior over sets of hypotheses, their sizes, and the shift of the parameters.

    ``probability``: individual prior probabilities of hypotheses.

    Scales of the discrepancy are on a lattice; those that suit the best sets, and their neighbours,
    are used. All pairs are tried, and larger sets are extended from the best.
    """
    grams = _Grams(linearised, probability)
    no_discrepancy = (0,) * len(linearised.scaled)
    levels = list(dict.fromkeys([no_discrepancy, _best_level(grams, (), no_discrepancy)]))
    pool: dict[tuple[int, ...], float] = {}
    done = 0
    while done < len(levels) and done < 5:
        for terms, value in _enumerate(grams, levels[done], max_terms).items():
            pool[terms] = max(value, pool.get(terms, -math.inf))
        done += 1
        best = max(pool, key=lambda terms: pool[terms])
        level = _best_level(grams, best, levels[done - 1])
        if level not in levels:
            levels.append(level)
    top = max(pool.values())
    # ``>=``, because a difference of twelve vanishes beside an evidence above 1e17.
    sets = [terms for terms in pool if pool[terms] >= top - KEPT_BELOW]
    sets = sorted(sets, key=lambda terms: -pool[terms])[:MOST_KEPT]
    best_scores = {level: float(grams.log_posterior(sets[:1], level)[0]) for level in levels}
    good_levels = [
        level for level in levels if best_scores[level] >= max(best_scores.values()) - KEPT_BELOW
    ]
    evaluated_levels = dict.fromkeys(
        n for level in good_levels for n in (level, *_neighbours(grams, level))
    )
    scored: list[tuple[float, tuple[int, ...], tuple[int, ...]]] = []
    for level in evaluated_levels:
        values = grams.log_posterior(sets, level)
        scored += zip(values.tolist(), sets, itertools.repeat(level))
    top = max(score for score, _, _ in scored)
    scored = [item for item in scored if item[0] >= top - KEPT_BELOW]
    total = top + math.log(sum(math.exp(score - top) for score, _, _ in scored))
    models = tuple(
        Model(terms, tuple(float(grams.lattice[i]) for i in level), score - total, level)
        for score, terms, level in sorted(scored, key=lambda item: -item[0])
    )
    return ModelPosterior(linearised, models, total, grams)


def _enumerate(
    grams: _Grams, level: tuple[int, ...], max_terms: int
) -> dict[tuple[int, ...], float]:
    """ln prior times evidence of the sets worth keeping at one level."""
    start = float(grams.log_posterior([()], level)[0])
    result: dict[tuple[int, ...], float] = {(): start}
    current: dict[tuple[int, ...], float] = {(): start}
    for size in range(1, max_terms + 1):
        extended: dict[tuple[int, ...], float] = {}
        limit = len(current) if size <= 2 else BEAM
        for terms in sorted(current, key=lambda candidate: -current[candidate])[:limit]:
            added = grams.extensions(terms, level)
            for k in np.flatnonzero(added > -FAR):
                larger = tuple(sorted((*terms, grams.selected[k])))
                extended[larger] = max(
                    current[terms] + float(added[k]), extended.get(larger, -np.inf)
                )
        if not extended:
            break
        likeliest = sorted(extended, key=lambda candidate: -extended[candidate])[:MOST_WEIGHED]
        values = grams.log_posterior(likeliest, level, sweeps=2).tolist()
        current = dict(zip(likeliest, values, strict=True))
        result |= {terms: value for terms, value in current.items() if grams.is_complete(terms)}
    return result


def _best_level(grams: _Grams, terms: tuple[int, ...], start: tuple[int, ...]) -> tuple[int, ...]:
    """The level that suits a set best, one group after the other."""
    level = list(start)

    def value(group: int, index: int) -> float:
        trial = (*level[:group], index, *level[group + 1 :])
        return float(grams.log_posterior([terms], trial, sweeps=2)[0])

    for _ in range(2):
        previous = tuple(level)
        for group in range(len(level)):
            scores = {i: value(group, i) for i in (0, *range(1, grams.lattice.size, 6))}
            best = max(scores, key=lambda i: scores[i])
            nearby = range(max(1, best - 4), min(grams.lattice.size, best + 5), 2) if best else ()
            scores |= {i: value(group, i) for i in nearby}
            level[group] = max(scores, key=lambda i: scores[i])
        if tuple(level) == previous:
            break
    return tuple(level)


def _neighbours(grams: _Grams, level: tuple[int, ...]) -> Iterable[tuple[int, ...]]:
    """Neighbouring levels: one group a step or two up, down, or absent."""
    for group, index in enumerate(level):
        steps = {0, index - 1, index + 1, index - 2, index + 2} if index else {1}
        for neighbour in sorted(steps - {index}):
            if 0 <= neighbour < grams.lattice.size:
                yield (*level[:group], neighbour, *level[group + 1 :])


@dataclass(frozen=True, eq=False)
class ModelPosterior:
    """Result of :func:`search`.

    ``linearised``: the view that was searched; ``models``: sets at their scales, the most probable
    first; probabilities sum to one; ``log_evidence``: ln of the sum of all priors times evidences,
    up to a constant that depends on the residual's size and the prior of u.
    """

    linearised: Linearised
    models: tuple[Model, ...]
    log_evidence: float
    _grams: _Grams

    @property
    def always_gain(self) -> float:
        """Reduction of χ², priors included, by the terms always included."""
        base = self._grams.bases((0,) * len(self.linearised.scaled))[0]
        return float(base.along @ base.along)

    @cached_property
    def sets(self) -> dict[tuple[int, ...], float]:
        """Probability of each set of terms, the most probable first."""
        result: dict[tuple[int, ...], float] = {}
        for model in self.models:
            result[model.terms] = result.get(model.terms, 0.0) + math.exp(model.log_posterior)
        return dict(sorted(result.items(), key=lambda item: -item[1]))

    def labels(self, terms: Iterable[int]) -> frozenset[str]:
        """Hypotheses of a set of terms."""
        return frozenset(self.linearised.terms[i].hypothesis for i in terms)

    @cached_property
    def inclusion(self) -> dict[str, float]:
        """Probability of each selected hypothesis, the most probable first."""
        result = dict.fromkeys((t.hypothesis for t in self.linearised.terms if not t.always), 0.0)
        for terms, probability in self.sets.items():
            for label in self.labels(terms):
                result[label] += probability
        return dict(sorted(result.items(), key=lambda item: -item[1]))

    @cached_property
    def named(self) -> tuple[str, ...]:
        """Hypotheses with a probability of at least ``NAMED_AT``."""
        return tuple(label for label, p in self.inclusion.items() if p >= NAMED_AT)

    def probability(self, labels: Iterable[str]) -> float:
        """Probability that at least one of some hypotheses holds."""
        wanted = set(labels)
        return min(1.0, sum(p for terms, p in self.sets.items() if wanted & self.labels(terms)))

    def likeliest(self, label: str) -> int:
        """Index of the most probable term of a hypothesis."""
        indices = [k for k, t in enumerate(self.linearised.terms) if t.hypothesis == label]
        sets = self.sets.items()
        return max(indices, key=lambda k: sum(p for terms, p in sets if k in terms))

    @cached_property
    def confounded(self) -> tuple[tuple[str, ...], ...]:
        """Smallest groups of unnamed hypotheses, one of which holds almost surely."""
        sets = {terms: (self.labels(terms), p) for terms, p in self.sets.items()}
        return confounded(list(sets.values()), self.named)

    @property
    def sure(self) -> tuple[tuple[str, ...], ...]:
        """Named hypotheses, and confounded groups."""
        return (*((label,) for label in self.named), *self.confounded)

    def mean_of(self, terms: tuple[int, ...]) -> tuple[list[FloatArray], FloatArray]:
        """Most probable sizes of a set's terms in their units, (k,) each, and the shift of u, (d,).

        At the set's most probable scales, or at those of the most probable model if it has none.
        """
        grams = self._grams
        levels = (m._level for m in self.models if m.terms == terms)
        level = next(levels, self.models[0]._level)
        base, at, columns = grams.bases(level)[0], grams.at(level), grams.columns(terms)
        rows = np.concatenate([at.matrix[:, columns], np.eye(columns.size)])
        target = np.concatenate([at.target, np.zeros(columns.size)])
        least = np.where(grams.is_positive[columns], 0.0, -np.inf)
        sizes = bounded_least_squares(rows, target, least)
        centre = base.root @ (base.along - base.across[:, columns] @ sizes)
        set_terms = [self.linearised.terms[i] for i in terms]
        parts = np.split(sizes, np.cumsum([term.columns.shape[1] for term in set_terms]))
        return [p * t.unit for p, t in zip(parts, set_terms, strict=False)], centre[: grams.d]

    def single_gains(self) -> dict[int, float]:
        """Gain in ln of prior times evidence by each selected term alone, without misfit."""
        grams = self._grams
        added = grams.extensions((), (0,) * len(self.linearised.scaled))
        return dict(zip(grams.selected, added.tolist(), strict=True))

    @cached_property
    def sizes(self) -> dict[int, tuple[FloatArray, FloatArray, FloatArray]]:
        """Posterior of the sizes of each selected term in a likely model.

        The probability of each such model, (m,), and its mean, (m, k), and covariance, (m, k, k),
        in usual sizes.
        """
        parts: dict[int, list[tuple[float, FloatArray, FloatArray]]] = {}
        for model, weight in self._likely().items():
            columns, mean, precision = self._grams.normal(model.terms, model._level)
            if not columns.size:
                continue
            positive = self._grams.is_positive[columns]
            _, middle, spread = orthant(mean[None], precision[None], positive[None])
            first = 0
            for term in model.terms:
                block = slice(first, first + self._grams.columns_of[term].size)
                parts.setdefault(term, []).append(
                    (weight, middle[0, block], spread[0, block, block])
                )
                first = block.stop
        by_term = {}
        for term, entries in parts.items():
            weights, means, spreads = zip(*entries, strict=True)
            by_term[term] = (np.array(weights), np.stack(means), np.stack(spreads))
        return by_term

    def _likely(self) -> dict[Model, float]:
        """Models with nearly all of the probability, and the share of each."""
        cumulative = np.cumsum(np.exp([m.log_posterior for m in self.models]))
        count = 1 + int(np.searchsorted(cumulative, WEIGHED_SHARE * cumulative[-1]))
        return {m: math.exp(m.log_posterior) / cumulative[count - 1] for m in self.models[:count]}

    @property
    def covariance(self) -> FloatArray:
        """Covariance of u alone, (d, d)."""
        root = self._grams.of_u.root
        return np.asarray(root @ root.T)

    @property
    def excess_chi_square(self) -> float:
        """χ² minus its degrees of freedom, at the fit of u alone."""
        return self._grams.excess_chi_square

    def discrepancy_sd(self, group: int) -> float:
        """Prior standard deviation of a group's coefficients, as the caller scaled its columns.

        In the most probable model that has the group; 0 if none has.
        """
        scales = (m.scales[group] for m in self.models if m.scales[group] > 0.0)
        columns = self.linearised.groups[group].columns
        return next(scales, 0.0) * float(self._grams.scale_of_column[columns].max(initial=0.0))

    def draw(self, generator: np.random.Generator, n: int) -> Draws:
        """Draw sizes, discrepancy and the shift of the fitted parameters, averaged over models.

        Draws of the nonlinear posterior of u alone plus this shift are draws of the full posterior,
        exactly so for a linear model.
        """
        grams = self._grams
        weights = np.exp([m.log_posterior for m in self.models])
        # Each model has its own random stream, so models without draws change nothing.
        ends = np.floor(n * np.cumsum(weights) / weights.sum() + 0.5).astype(int)
        counts = np.diff(ends, prepend=0)
        width = grams.columns_remaining.size + grams.columns_free.size
        sizes, h, shift = (np.zeros((n, size)) for size in (width, grams.m, grams.d))
        alone = grams.of_u
        start, unshifted = 0, alone.root @ alone.along
        for model, count in zip(self.models, counts, strict=True):
            if not count:
                continue
            rows = slice(start, start + count)
            start += count
            (model_generator,) = generator.spawn(1)
            columns, mean, precision = grams.normal(model.terms, model._level)
            base, of_u = grams.bases(model._level)
            a = _truncated(
                mean,
                precision,
                grams.is_positive[columns],
                grams.absent[columns],
                count,
                model_generator,
            )
            sizes[rows, grams.columns_remaining[columns]] = a
            present, _ = grams.precision_of_h(model._level)
            both = np.concatenate([columns, present + grams.k])
            if present.size:
                triangle, across, along = np.split(
                    grams.at(model._level).of_h, [present.size, present.size + grams.k], axis=1
                )
                noise = model_generator.standard_normal((count, present.size))
                pull = along + noise.T - across[:, columns] @ a.T
                h[rows, present] = np.linalg.solve(triangle, pull).T
            if grams.free:
                values = np.concatenate([a, h[rows, present]], axis=1)
                root = base.root[grams.d :]
                noise = model_generator.standard_normal((count, len(root)))
                sizes[rows, grams.columns_free] = (
                    base.along - values @ base.across[:, both].T
                ) @ root.T + noise @ _triangle(root.T)
            # Rows with misfit leave u less certain than the draws of u alone have it.
            more = of_u.root @ of_u.root.T - alone.root @ alone.root.T
            values, vectors = np.linalg.eigh(more)
            root_of_more = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
            extra = model_generator.standard_normal((count, grams.d)) @ root_of_more
            free, remaining = (
                sizes[rows][:, grams.columns_free],
                sizes[rows][:, grams.columns_remaining],
            )
            others = np.concatenate([free, remaining, h[rows]], axis=1)
            centre = (of_u.along - others @ of_u.across.T) @ of_u.root.T
            shift[rows] = centre + extra - unshifted
        order = generator.permutation(n)
        shift = shift[order]
        noise = generator.standard_normal((n, grams.d))
        fitted = unshifted + noise @ _triangle(alone.root.T) + shift
        return Draws(sizes[order], h[order] * grams.scale_of_column, shift, fitted)


def confounded(
    sets: Sequence[tuple[frozenset[str], float]], named: Iterable[str] = ()
) -> tuple[tuple[str, ...], ...]:
    """Smallest groups of unnamed hypotheses, one of which holds almost surely.

    ``sets``: hypotheses that hold together, each set with its probability.
    """
    result: list[tuple[str, ...]] = []
    used = set(named)
    while members := _smallest_cover(sets, used):
        result.append(members)
        used |= set(members)
    return tuple(result)


def _smallest_cover(
    sets: Sequence[tuple[frozenset[str], float]], used: set[str]
) -> tuple[str, ...]:
    """Smallest group of unused hypotheses, one of which is in almost every set; or none."""
    uncovered = [(labels - used, p) for labels, p in sets]
    members: list[str] = []
    while len(members) < CONFOUNDED_MOST and sum(p for _, p in uncovered) > 1.0 - NAMED_AT:
        gain: dict[str, float] = {}
        for labels, probability in uncovered:
            for label in labels:
                gain[label] = gain.get(label, 0.0) + probability
        if not gain:
            return ()
        members.append(max(gain, key=lambda label: gain[label]))
        uncovered = [(labels, p) for labels, p in uncovered if members[-1] not in labels]
    return tuple(members) if sum(p for _, p in uncovered) <= 1.0 - NAMED_AT else ()


def least_squares(matrix: FloatArray, target: FloatArray) -> FloatArray:
    """x that minimises ‖target − matrix x‖, shape (p,); columns in any unit, (n, p)."""
    scale = np.sqrt((matrix**2).sum(axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    return np.asarray(np.linalg.lstsq(matrix / scale, target, rcond=DEPENDENT)[0] / scale)


def bounded_least_squares(matrix: FloatArray, target: FloatArray, low: FloatArray) -> FloatArray:
    """The same with lower bounds ``low``, (p,), each zero or minus infinity."""
    from scipy.optimize import lsq_linear

    scale = np.sqrt((matrix**2).sum(axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    unconstrained = least_squares(matrix, target)
    if np.all(unconstrained >= low):
        return unconstrained
    scaled = np.column_stack([matrix / scale, target])
    root = np.asarray(np.linalg.qr(scaled, mode="r"), dtype=float)
    return np.asarray(lsq_linear(root[:, :-1], root[:, -1], (low, np.inf)).x / scale)


def _truncated(
    mean: FloatArray,
    precision: FloatArray,
    positive: np.ndarray,
    absent: FloatArray,
    n: int,
    generator: np.random.Generator,
) -> FloatArray:
    """(n, k) draws of a normal vector with some amplitudes positive, by n parallel Gibbs chains.

    ``absent``: prior probability that each is 0 (George and McCulloch 1993), (k,).
    """
    result, covariance = np.zeros((n, mean.size)), np.linalg.inv(precision)
    bounded, free = np.flatnonzero(positive), np.flatnonzero(~positive)
    if bounded.size:
        sub = covariance[np.ix_(bounded, bounded)]
        sub_precision = np.linalg.inv(sub)
        middle = mean[bounded]
        x = np.maximum(np.broadcast_to(middle, (n, bounded.size)), 0.0).copy()
        for _ in range(GIBBS_SWEEPS if bounded.size > 1 else 1):
            for i in range(bounded.size):
                sd = 1.0 / math.sqrt(sub_precision[i, i])
                centre = (
                    x[:, i]
                    - (x @ sub_precision[i] - middle @ sub_precision[i]) / sub_precision[i, i]
                )
                z = normal_between(-centre / sd, np.full(n, np.inf), generator.uniform(size=n))
                x[:, i] = np.maximum(centre + sd * z, 0.0)
                if absent[bounded[i]] > 0.0:
                    # Odds of a half-normal against zero, where the normal has exp(−c²/2s²).
                    log_odds_present = (
                        math.log(2.0 * sd) + log_ndtr(centre / sd) + 0.5 * (centre / sd) ** 2
                    )
                    log_odds_present -= log_odds(absent[bounded[i]])
                    x[generator.uniform(size=n) > expit(log_odds_present), i] = 0.0
        result[:, bounded] = x
    if free.size:
        centre = np.broadcast_to(mean[free], (n, free.size))
        if bounded.size:
            gain = np.linalg.solve(sub, covariance[np.ix_(bounded, free)])
            centre = centre + (result[:, bounded] - mean[bounded]) @ gain
        root = np.linalg.inv(np.linalg.cholesky(precision[np.ix_(free, free)]))
        result[:, free] = centre + generator.standard_normal((n, free.size)) @ root
    return result
