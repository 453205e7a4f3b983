"""Which hypotheses a residual asks for, and what that leaves open for the parameters.

A view (closed loop, inverse dynamics, speed lines, free motion) linearises at its fit:

    r = J u + Σ_k s_k C_k a_k + H h + e,   e ~ N(0, I)

r is the whitened residual, u the shift of the fitted parameters, a_k the sizes of hypotheses in
units of their usual size (normal or half-normal with standard deviation 1), s_k whether a
hypothesis is there, h what none of them explains, each group of its columns with a scale that is
learned. All but s, the signs and the scales is normal, so that u, h and the hypotheses that are
always there are marginalised exactly, from Gram matrices (Rasmussen and
Williams 2006, section 2.7).
Half-normal sizes multiply the evidence by 2 an amplitude and by the probability of the orthant,
by expectation propagation (Cunningham, Hennig and Lacoste-Julien 2011), exact for one amplitude.
The prior over sets is a Bernoulli one (George and McCulloch 1993); sets are enumerated up to pairs
and continued from the best. Nothing here knows what a hypothesis means.
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
DEPENDENT = 1e-8
"""Share of its own length that a column must have apart from the others, to be fitted."""

EVEN: Mapping[str, float] = MappingProxyType({})
"""Prior probabilities of hypotheses, even over all."""


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """One way a hypothesis can look.

    Attributes
    ----------
    hypothesis
        Its label. Several terms of one label are alternatives: shapes, starts. At most one of them
        is in a set.
    columns
        (N, k) whitened change of the prediction by one usual size of each amplitude.
    positive
        The amplitude cannot be negative: a half-normal prior (k = 1).
    always
        Never selected, always there.
    absent
        Probability that a positive one that is always there is of no size: teeth pull at one
        another or do not, a speed is averaged or is not. A half-normal alone would have a little of
        each law in every joint, and all of them widen a gap. Only draws know of it.
    prior_weight
        Share of the hypothesis' prior probability.
    excludes
        Labels of hypotheses that it cannot stand beside.
    requires
        Labels of hypotheses without which it makes no sense (strong heredity; Chipman 1996, Can. J.
        Stat. 24, 17); those that are not among the terms are taken to hold.
    unit, source
        What one usual size of its amplitudes is, (k,), and what it is a term of, for whoever asks.
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
    """Columns of what no hypothesis explains that share one learned scale.

    Attributes
    ----------
    kind
        What it is: ``"motor_torque_over_motor_angle"``, ``"motor_speed_error"``, …
    columns
        Which of :attr:`Linearised.discrepancy`.
    usual
        Size that its root mean square usually has, in standard deviations of a sample's noise: a
        scale is half-normal with it where it is there, beside being flat in its logarithm. What
        laws explain is so not left to a discrepancy of their size.
    """

    kind: str
    columns: slice
    usual: float = math.inf


@dataclass(frozen=True, slots=True, eq=False)
class MisfitBand:
    """Rows in which anything may be off besides noise: errors alike in size, and no more is known.

    The same as a group with a column for each row, at the price of a factor for each.

    Attributes
    ----------
    kind
        What the rows are: ``"load orders up to 8"``, …
    rows
        Of the residual, the columns and the derivatives.
    freedom
        Independent values that they stand for, where they are a triangle of more.
    usual
        As :attr:`DiscrepancyGroup.usual`.
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
        (N,) whitened, measured less predicted.
    jacobian
        (N, d) change of the prediction by each fitted parameter.
    prior_precision
        (d, d) of the fitted parameters; zeros where nothing is known.
    prior_pull
        (d,) gradient of the log prior at the fit: zeros at the prior's centre.
    terms
        The catalogue as this view sees it.
    discrepancy
        (N, m) columns, in any unit; each group is scaled to a root mean square of one.
    groups
        What these columns are.
    bands
        Rows that nothing is known of; no two overlap.
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
        """All that has a scale, in the order of :attr:`Model.scales`."""
        return (*self.groups, *self.bands)


def even_probability(hypotheses: int) -> float:
    """Of each of so many in a joint nobody has looked at."""
    return min(EXPECTED_HYPOTHESES / max(1, hypotheses), 0.5)


def log_odds(probability: float) -> float:
    """ln of the odds of a probability."""
    return math.log(probability) - math.log1p(-probability)


@dataclass(frozen=True, slots=True)
class Model:
    """A set of terms at one scale of the discrepancy.

    Attributes
    ----------
    terms
        Indices into :attr:`Linearised.terms`, those always there left out.
    scales
        Standard deviation of each discrepancy group, then of each misfit band, in units of a
        sample's noise; 0: absent.
    log_posterior
        ln of the probability.
    """

    terms: tuple[int, ...]
    scales: tuple[float, ...]
    log_posterior: float
    _level: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Draws:
    """(n, c) sizes in usual ones of all columns of all terms, (n, m) of the discrepancy's columns
    as the caller scaled them, (n, d) what both move the fitted parameters by, and (n, d) u itself,
    as the linearisation has it."""

    sizes: FloatArray
    discrepancy: FloatArray
    shift: FloatArray
    fitted: FloatArray


def orthant(
    mean: FloatArray, precision: FloatArray, positive: np.ndarray, sweeps: int = 12
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """ln P(a > 0 where ``positive``) of normals, and mean and covariance within, of each row.

    Expectation propagation on the sites a_i > 0. Exact where one amplitude is bounded; elsewhere to
    some parts in a thousand. (B, n), (B, n, n) and (B, n) to (B,), (B, n) and (B, n, n).
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
        moved = 0.0
        for i in bounded:
            on = positive[:, i]
            # Rounding must not take a variance below none where the matrix is nearly singular.
            s = np.maximum(sigma[:, i, i], 1e-12 * np.abs(covariance[:, i, i]))
            cavity = 1.0 / np.maximum(1.0 / s - t[:, i], 1e-12 / s)
            middle = cavity * (mu[:, i] / s - v[:, i])
            z = middle / np.sqrt(cavity)
            log_z = log_ndtr(z)
            hazard = np.exp(-0.5 * z * z - 0.5 * _LOG_TWO_PI - log_z)
            far = z < -50.0
            zf = np.where(far, z, -50.0)
            shrunk = np.where(far, 1.0 / zf**2, 1.0 - hazard * (z + hazard))
            inside = np.where(far, -np.sqrt(cavity) / zf, middle + np.sqrt(cavity) * hazard)
            spread = cavity * np.clip(shrunk, 1e-12, 1.0)
            t_new = np.where(on, np.maximum(1.0 / spread - 1.0 / cavity, 0.0), 0.0)
            v_new = np.where(on, inside / spread - middle / cavity, 0.0)
            dt, dv = t_new - t[:, i], v_new - v[:, i]
            row = sigma[:, :, i].copy()
            grow = 1.0 + dt * s
            mu = mu + ((dv - dt * mu[:, i]) / grow)[:, None] * row
            sigma = sigma - (dt / grow)[:, None, None] * row[:, :, None] * row[:, None, :]
            t[:, i], v[:, i] = t_new, v_new
            moved = max(moved, float(np.max(np.abs(dt) * s / grow)))
            site = -0.5 * np.log1p(t_new * cavity) + 0.5 * (
                (middle / cavity + v_new) ** 2 * cavity / (1.0 + t_new * cavity)
                - middle**2 / cavity
            )
            log_site[:, i] = np.where(on, log_z - site, 0.0)
        if moved < 1e-4:
            break
    tilted = precision + t[:, :, None] * np.eye(mean.shape[1])
    log_det = np.linalg.slogdet(tilted)[1] - np.linalg.slogdet(precision)[1]
    normal = 0.5 * (((natural + v) * mu).sum(1) - (natural * mean).sum(1)) - 0.5 * log_det
    return np.asarray(log_site.sum(1) + normal), mu, np.asarray(sigma, dtype=float)


def _factor(gram: FloatArray) -> tuple[FloatArray, float]:
    """A⁻¹ of a positive semidefinite matrix of columns in any unit, and ln |A|; of directions
    without data 0."""
    root, log_det = _inverse_root(gram)
    return np.asarray(root @ root.T), log_det


def _inverse_root(gram: FloatArray) -> tuple[FloatArray, float]:
    """R of R Rᵀ = A⁻¹, (n, rank), and ln |A|."""
    scale = np.sqrt(np.where(np.diag(gram) > 0.0, np.diag(gram), 1.0))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    kept = values > 1e-12 * max(1.0, float(values[-1]) if values.size else 1.0)
    part = vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None]
    log_det = float(np.log(values[kept]).sum()) + 2.0 * float(np.log(scale).sum())
    return np.asarray(part), log_det


def _root(matrix: np.ndarray) -> FloatArray:
    """Lower triangular root of a positive definite matrix, beyond rounding where noise is tiny."""
    try:
        return np.asarray(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        rounding = 1e-12 * np.diag(matrix).max()
        values, vectors = np.linalg.eigh(matrix)
        least = np.maximum(values, rounding)
        return np.asarray(np.linalg.cholesky((vectors * least) @ vectors.T))


def _without_rounding(gram: FloatArray) -> FloatArray:
    """A Gram matrix to which priors of size one can be added.

    Where noise is tiny, rounding of what the nuisance takes leaves squares below minus one.
    """
    try:
        np.linalg.cholesky(gram + np.eye(len(gram)))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(gram)
        return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
    return gram


@dataclass(frozen=True, slots=True, eq=False)
class _Base:
    """Gram matrices at one scale of the misfit bands: of the nuisance (u and what is always there),
    between it and the other columns, and of those with it marginalised."""

    nuisance_gram: FloatArray
    inverse: FloatArray
    cross: FloatArray
    nuisance_pull: FloatArray
    gram: FloatArray
    right: FloatArray
    squares: float
    chi_square: float
    log_volume: float

    @classmethod
    def of(cls, total: FloatArray, prior: FloatArray, pull: FloatArray, log_volume: float) -> _Base:
        q = len(prior)
        nuisance_gram, cross = total[:q, :q] + prior, total[:q, q:-1]
        inverse, log_det = _factor(nuisance_gram)
        nuisance_pull = total[:q, -1] + pull
        squares = float(total[-1, -1])
        return cls(
            nuisance_gram,
            inverse,
            cross,
            nuisance_pull,
            _without_rounding(total[q:-1, q:-1] - cross.T @ inverse @ cross),
            total[q:-1, -1] - cross.T @ (inverse @ nuisance_pull),
            squares,
            squares - float(nuisance_pull @ inverse @ nuisance_pull),
            log_volume - 0.5 * log_det,
        )


class _Grams:
    """Everything that depends on the view alone: the Gram matrices with u marginalised."""

    def __init__(self, view: Linearised, probability: Mapping[str, float]) -> None:
        self.view = view
        terms = view.terms
        self.selected = [i for i, t in enumerate(terms) if not t.always]
        self.free = [i for i, t in enumerate(terms) if t.always and not t.positive]
        own = [i for i in range(len(terms)) if i not in set(self.free)]
        self.widths = np.array([t.columns.shape[1] for t in terms], dtype=int)
        ends = np.cumsum([0, *self.widths])
        every = [np.arange(a, b) for a, b in itertools.pairwise(ends)]
        nothing = np.zeros(0, dtype=int)
        self.place = np.concatenate([nothing, *(every[i] for i in own)])
        self.place_free = np.concatenate([nothing, *(every[i] for i in self.free)])
        self.d, self.k = view.jacobian.shape[1], self.place.size
        self.m = view.discrepancy.shape[1]
        self.scale_of_column = self._discrepancy_scale()
        nuisance = [view.jacobian, *(terms[i].columns for i in self.free)]
        h = view.discrepancy * self.scale_of_column
        columns = [terms[i].columns for i in own]
        everything = np.hstack([*nuisance, *columns, h, view.residual[:, None]])
        self.prior = np.eye(self.d + self.place_free.size)
        self.prior[: self.d, : self.d] = view.prior_precision
        self.pull = np.zeros(len(self.prior))
        self.pull[: self.d] = view.prior_pull
        self.parts = [everything[b.rows].T @ everything[b.rows] for b in view.bands]
        self.rest_part = everything.T @ everything - sum(self.parts, np.zeros(()))
        self._bases: dict[tuple[int, ...], _Base] = {}
        size = view.residual.size
        lowest = 1.0 / math.sqrt(max(1, size))
        steps = math.ceil(math.log(DISCREPANCY_LARGEST / lowest) / math.log(DISCREPANCY_SPACING))
        self.lattice = np.concatenate([[0.0], lowest * DISCREPANCY_SPACING ** np.arange(steps)])
        alone = self.base((0,) * len(view.scaled))
        gram_u = alone.nuisance_gram[: self.d, : self.d]
        self.root_u, _ = _inverse_root(gram_u)
        self.inverse_u = self.root_u @ self.root_u.T
        self.pull_u = alone.nuisance_pull[: self.d]
        chi_square = alone.squares - float(self.pull_u @ self.inverse_u @ self.pull_u)
        effective = float(np.sum(self.inverse_u * (gram_u - view.prior_precision)))
        self.excess_chi_square = chi_square - (size - effective)
        starts = dict(zip(own, np.cumsum([0, *self.widths[own]]), strict=False))
        self.columns_of = {i: starts[i] + np.arange(self.widths[i]) for i in own}
        bound = [i for i in own if terms[i].always]
        self.bound_columns = np.concatenate([nothing, *(self.columns_of[i] for i in bound)])
        self.is_positive = np.zeros(self.k, dtype=bool)
        self.absent = np.zeros(self.k)
        for i in own:
            self.is_positive[starts[i]] = terms[i].positive
            self.absent[starts[i]] = terms[i].absent
        even = even_probability(len({terms[i].hypothesis for i in self.selected}))
        self.log_prior = np.zeros(len(terms))
        for i in self.selected:
            odds = log_odds(probability.get(terms[i].hypothesis, even))
            self.log_prior[i] = odds + math.log(terms[i].prior_weight)
        self.apart = self._apart()
        there = {term.hypothesis for term in terms}
        self.requires = [term.requires & there for term in terms]
        self._cache: dict[tuple[int, ...], tuple[FloatArray, FloatArray, float]] = {}

    def base(self, level: tuple[int, ...]) -> _Base:
        """Everything with u and what is always there marginalised, at the scales of the bands."""
        own = level[len(self.view.groups) :]
        if own not in self._bases:
            total = self.rest_part.copy()
            log_volume = 0.0
            for index, band, part in zip(own, self.view.bands, self.parts, strict=True):
                variance = 1.0 + float(self.lattice[index]) ** 2
                total += part / variance
                log_volume -= 0.5 * band.freedom * math.log(variance)
            self._bases[own] = _Base.of(total, self.prior, self.pull, log_volume)
        return self._bases[own]

    def _discrepancy_scale(self) -> FloatArray:
        size, squares = self.view.residual.size, (self.view.discrepancy**2).sum(axis=0)
        scale = np.zeros(squares.size)
        for group in self.view.groups:
            total = squares[group.columns].sum()
            scale[group.columns] = math.sqrt(size / total) if total > 0.0 else 0.0
        return scale

    def _apart(self) -> np.ndarray:
        """Which terms cannot stand beside which."""
        terms = self.view.terms
        apart = np.zeros((len(terms), len(terms)), dtype=bool)
        labels = np.array([t.hypothesis for t in terms])
        for i, term in enumerate(terms):
            apart[i] = (labels == term.hypothesis) | np.isin(labels, list(term.excludes))
        return apart | apart.T

    def precision_of_h(self, level: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
        """Columns of h that are there, and their prior precision."""
        there, precision = [], []
        for index, group in zip(level, self.view.groups, strict=False):
            if index:
                inside = np.arange(self.m)[group.columns]
                there.append(inside[self.scale_of_column[inside] > 0.0])
                precision.append(np.full(there[-1].size, self.lattice[index] ** -2.0))
        if not there:
            return np.zeros(0, dtype=int), np.zeros(0)
        return np.concatenate(there), np.concatenate(precision)

    def at(self, level: tuple[int, ...]) -> tuple[FloatArray, FloatArray, float]:
        """Gram and right side of the terms with h marginalised, and its ln evidence."""
        if level not in self._cache:
            k, base = self.k, self.base(level)
            gram, right = base.gram[:k, :k], base.right[:k]
            log_evidence = base.log_volume - 0.5 * base.chi_square
            there, precision = self.precision_of_h(level)
            if there.size:
                at = there + k
                root = np.sqrt(precision)
                # (R⁻¹ G R⁻¹ + I), R² the precision: well scaled at every scale.
                inside = base.gram[np.ix_(at, at)] / np.outer(root, root) + np.eye(there.size)
                lower = _root(inside)
                cross = np.linalg.solve(lower, base.gram[np.ix_(at, np.arange(k))] / root[:, None])
                own = np.linalg.solve(lower, base.right[at] / root)
                gram = _without_rounding(gram - cross.T @ cross)
                right = right - cross.T @ own
                log_evidence += 0.5 * float(own @ own) - float(np.log(np.diag(lower)).sum())
                # No h takes more than all that is there: then rounding has the better of its scale.
                if float(own @ own) > (1.0 + 1e-6) * base.chi_square:
                    right, log_evidence = np.zeros(k), -math.inf
            absent = DISCREPANCY_ABSENT
            for index, group in zip(level, self.view.scaled, strict=True):
                weight = absent if index == 0 else (1.0 - absent) / (self.lattice.size - 1)
                log_evidence += math.log(weight)
                log_evidence -= 0.5 * float(self.lattice[index] / group.usual) ** 2
            self._cache[level] = gram, right, log_evidence
        return self._cache[level]

    def columns(self, terms: tuple[int, ...]) -> np.ndarray:
        """Of the terms of a set, and of those always there, (n,)."""
        return np.concatenate([*(self.columns_of[i] for i in terms), self.bound_columns])

    def is_complete(self, terms: tuple[int, ...]) -> bool:
        """Whether every term has what it requires."""
        labels = {self.view.terms[i].hypothesis for i in terms}
        return all(self.requires[i] <= labels for i in terms)

    def log_posterior(
        self, sets: Sequence[tuple[int, ...]], level: tuple[int, ...], *, sweeps: int = 12
    ) -> FloatArray:
        """ln of prior times evidence of sets at one level, (B,)."""
        gram, right, base = self.at(level)
        result = np.array([base + sum(self.log_prior[i] for i in terms) for terms in sets])
        by_size: dict[int, list[int]] = {}
        every = [self.columns(terms) for terms in sets]
        for k, columns in enumerate(every):
            by_size.setdefault(columns.size, []).append(k)
        for size, places in by_size.items():
            if size == 0:
                continue
            columns = np.stack([every[k] for k in places])
            precision = gram[columns[:, :, None], columns[:, None, :]] + np.eye(size)
            b = right[columns]
            mean = np.linalg.solve(precision, b[:, :, None])[:, :, 0]
            values = 0.5 * (b * mean).sum(1) - 0.5 * np.linalg.slogdet(precision)[1]
            positive = self.is_positive[columns]
            if positive.any():
                inside = orthant(mean, precision, positive, sweeps)[0]
                values = values + math.log(2.0) * positive.sum(1) + inside
            result[places] += values
        return result

    def extensions(self, terms: tuple[int, ...], level: tuple[int, ...]) -> FloatArray:
        """What each selected term adds to ln of prior times evidence beside a set; −∞ where it
        cannot stand there. Signs of the set are left as they are: a first estimate."""
        gram, right, _ = self.at(level)
        columns = self.columns(terms)
        if columns.size:
            block = gram[np.ix_(columns, columns)] + np.eye(columns.size)
            through = np.linalg.solve(block, gram[columns])
            gram = gram - gram[:, columns] @ through
            right = right - through.T @ right[columns]
        selected = np.array(self.selected, dtype=int)
        added = np.full(selected.size, -np.inf)
        possible = (
            ~self.apart[list(terms)][:, selected].any(axis=0)
            if terms
            else np.ones(selected.size, dtype=bool)
        )
        for width in np.unique(self.widths[selected]):
            rows = np.flatnonzero(possible & (self.widths[selected] == width))
            if not rows.size:
                continue
            at = np.stack([self.columns_of[i] for i in selected[rows]])
            precision = gram[at[:, :, None], at[:, None, :]] + np.eye(width)
            b = right[at]
            mean = np.linalg.solve(precision, b[:, :, None])[:, :, 0]
            value = 0.5 * (b * mean).sum(1) - 0.5 * np.linalg.slogdet(precision)[1]
            if width == 1:
                z = mean[:, 0] * np.sqrt(precision[:, 0, 0])
                value += np.where(self.is_positive[at[:, 0]], math.log(2.0) + log_ndtr(z), 0.0)
            added[rows] = value + self.log_prior[selected[rows]]
        return added

    def normal(
        self, terms: tuple[int, ...], level: tuple[int, ...]
    ) -> tuple[np.ndarray, FloatArray, FloatArray]:
        """Columns of a set (those always there last), mean and precision before the signs."""
        gram, right, _ = self.at(level)
        columns = self.columns(terms)
        precision = gram[np.ix_(columns, columns)] + np.eye(columns.size)
        return columns, np.linalg.solve(precision, right[columns]), precision


def search(
    linearised: Linearised, max_terms: int = 3, probability: Mapping[str, float] = EVEN
) -> ModelPosterior:
    """The posterior over sets of hypotheses, their sizes and what they move.

    ``probability``: of hypotheses that have one of their own beforehand.

    Scales of the discrepancy are taken on a lattice: those that suit the best sets and their
    neighbours. All pairs are tried, larger sets continued from the best.
    """
    grams = _Grams(linearised, probability)
    nowhere = (0,) * len(linearised.scaled)
    levels = list(dict.fromkeys([nowhere, _climb(grams, (), nowhere)]))
    pool: dict[tuple[int, ...], float] = {}
    done = 0
    while done < len(levels) and done < 5:
        for terms, value in _enumerate(grams, levels[done], max_terms).items():
            pool[terms] = max(value, pool.get(terms, -math.inf))
        done += 1
        best = max(pool, key=lambda terms: pool[terms])
        level = _climb(grams, best, levels[done - 1])
        if level not in levels:
            levels.append(level)
    top = max(pool.values())
    # At least: of evidence beyond 1e17 nothing is less by twelve.
    sets = [terms for terms in pool if pool[terms] >= top - KEPT_BELOW]
    sets = sorted(sets, key=lambda terms: -pool[terms])[:MOST_KEPT]
    suits = {level: float(grams.log_posterior(sets[:1], level)[0]) for level in levels}
    suiting = [level for level in levels if suits[level] >= max(suits.values()) - KEPT_BELOW]
    every = dict.fromkeys(n for level in suiting for n in (level, *_neighbours(grams, level)))
    scored: list[tuple[float, tuple[int, ...], tuple[int, ...]]] = []
    for level in every:
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
    last: dict[tuple[int, ...], float] = {(): start}
    for size in range(1, max_terms + 1):
        wider: dict[tuple[int, ...], float] = {}
        most = len(last) if size <= 2 else BEAM
        for terms in sorted(last, key=lambda some: -last[some])[:most]:
            added = grams.extensions(terms, level)
            for k in np.flatnonzero(added > -FAR):
                more = tuple(sorted((*terms, grams.selected[k])))
                wider[more] = max(last[terms] + float(added[k]), wider.get(more, -np.inf))
        if not wider:
            break
        likely = sorted(wider, key=lambda some: -wider[some])[:MOST_WEIGHED]
        weighed = grams.log_posterior(likely, level, sweeps=2).tolist()
        last = dict(zip(likely, weighed, strict=True))
        result |= {terms: value for terms, value in last.items() if grams.is_complete(terms)}
    return result


def _climb(grams: _Grams, terms: tuple[int, ...], start: tuple[int, ...]) -> tuple[int, ...]:
    """The level that suits a set best, one group after the other."""
    level = list(start)

    def value(group: int, index: int) -> float:
        trial = (*level[:group], index, *level[group + 1 :])
        return float(grams.log_posterior([terms], trial, sweeps=2)[0])

    for _ in range(2):
        before = tuple(level)
        for group in range(len(level)):
            tried = {i: value(group, i) for i in (0, *range(1, grams.lattice.size, 6))}
            best = max(tried, key=lambda i: tried[i])
            near = range(max(1, best - 4), min(grams.lattice.size, best + 5), 2) if best else ()
            tried |= {i: value(group, i) for i in near}
            level[group] = max(tried, key=lambda i: tried[i])
        if tuple(level) == before:
            break
    return tuple(level)


def _neighbours(grams: _Grams, level: tuple[int, ...]) -> Iterable[tuple[int, ...]]:
    """Levels beside one: each group alone a step up, down, or absent."""
    for group, index in enumerate(level):
        steps = {0, index - 1, index + 1, index - 2, index + 2} if index else {1}
        for other in sorted(steps - {index}):
            if 0 <= other < grams.lattice.size:
                yield (*level[:group], other, *level[group + 1 :])


@dataclass(frozen=True, eq=False)
class ModelPosterior:
    """What :func:`search` says.

    Attributes
    ----------
    linearised
        What was searched.
    models
        Sets at their scales, the most probable first; probabilities sum to one.
    log_evidence
        ln of the sum of all their priors times evidences, up to a constant of the residual's size
        and of the prior of u.
    """

    linearised: Linearised
    models: tuple[Model, ...]
    log_evidence: float
    _grams: _Grams

    @property
    def always_gain(self) -> float:
        """Fall of χ², priors included, by what is always there."""
        base = self._grams.base((0,) * len(self.linearised.scaled))
        return base.squares - base.chi_square

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
        """Hypotheses of at least the stated probability."""
        return tuple(label for label, p in self.inclusion.items() if p >= NAMED_AT)

    def probability(self, labels: Iterable[str]) -> float:
        """That one of some hypotheses is there."""
        own = set(labels)
        return min(1.0, sum(p for terms, p in self.sets.items() if own & self.labels(terms)))

    def likeliest(self, label: str) -> int:
        """The term of a hypothesis that is most probable."""
        places = [k for k, t in enumerate(self.linearised.terms) if t.hypothesis == label]
        sets = self.sets.items()
        return max(places, key=lambda k: sum(p for terms, p in sets if k in terms))

    @cached_property
    def confounded(self) -> tuple[tuple[str, ...], ...]:
        """Smallest sets of hypotheses, none named, one of which is there almost surely."""
        sets = {terms: (self.labels(terms), p) for terms, p in self.sets.items()}
        return confounded(list(sets.values()), self.named)

    @property
    def sure(self) -> tuple[tuple[str, ...], ...]:
        """Hypotheses that are there almost surely, each alone or one of several."""
        return (*((label,) for label in self.named), *self.confounded)

    def mean_of(self, terms: tuple[int, ...]) -> tuple[list[FloatArray], FloatArray]:
        """Most probable sizes of each term of a set, in its unit, (k,), and the shift of u with
        them, (d,); at the scales of the most probable model, where the set has none."""
        grams = self._grams
        own = (m._level for m in self.models if m.terms == terms)
        level = next(own, self.models[0]._level)
        base = grams.base(level)
        columns, _, precision = grams.normal(terms, level)
        right = grams.at(level)[1][columns]
        sizes = _within(right, precision, grams.is_positive[columns])
        centre = base.inverse @ (base.nuisance_pull - base.cross[:, columns] @ sizes)
        own_terms = [self.linearised.terms[i] for i in terms]
        parts = np.split(sizes, np.cumsum([term.columns.shape[1] for term in own_terms]))
        return [p * t.unit for p, t in zip(parts, own_terms, strict=False)], centre[: grams.d]

    def single_gains(self) -> dict[int, float]:
        """ln of prior times evidence that each selected term adds alone, were there no misfit."""
        grams = self._grams
        added = grams.extensions((), (0,) * len(self.linearised.scaled))
        return dict(zip(grams.selected, added.tolist(), strict=True))

    @cached_property
    def sizes(self) -> dict[int, tuple[FloatArray, FloatArray, FloatArray]]:
        """Of each selected term that a likely model has: the probability of each such model, (m,),
        and there the mean, (m, k), and covariance, (m, k, k), of its sizes in usual ones."""
        parts: dict[int, list[tuple[float, FloatArray, FloatArray]]] = {}
        for model, weight in self._likely().items():
            columns, mean, precision = self._grams.normal(model.terms, model._level)
            if not columns.size:
                continue
            positive = self._grams.is_positive[columns]
            _, middle, spread = orthant(mean[None], precision[None], positive[None])
            at = 0
            for term in model.terms:
                own = slice(at, at + self._grams.columns_of[term].size)
                parts.setdefault(term, []).append((weight, middle[0, own], spread[0, own, own]))
                at = own.stop
        by_term = {}
        for term, every in parts.items():
            weights, means, spreads = zip(*every, strict=True)
            by_term[term] = (np.array(weights), np.stack(means), np.stack(spreads))
        return by_term

    def _likely(self) -> dict[Model, float]:
        """Models that hold nearly all of the probability, and what each has of theirs."""
        held = np.cumsum(np.exp([m.log_posterior for m in self.models]))
        count = 1 + int(np.searchsorted(held, WEIGHED_SHARE * held[-1]))
        return {m: math.exp(m.log_posterior) / held[count - 1] for m in self.models[:count]}

    @property
    def excess_chi_square(self) -> float:
        """Chi-square less its freedom, at the fit of u alone."""
        return self._grams.excess_chi_square

    def discrepancy_sd(self, group: int) -> float:
        """Prior standard deviation of a group's coefficients, as the caller scaled its columns, in
        the most probable model that has it; 0 where none has."""
        scales = (m.scales[group] for m in self.models if m.scales[group] > 0.0)
        columns = self.linearised.groups[group].columns
        return next(scales, 0.0) * float(self._grams.scale_of_column[columns].max(initial=0.0))

    def draw(self, generator: np.random.Generator, n: int) -> Draws:
        """Sizes, discrepancy and what they move the fitted parameters by, of the average.

        Draws of the nonlinear posterior of u without any of it plus this shift are draws of the
        posterior of everything; for a linear model exactly.
        """
        grams = self._grams
        weights = np.exp([m.log_posterior for m in self.models])
        # Each has its share of the draws, and randomness of its own: what none has changes nothing.
        ends = np.floor(n * np.cumsum(weights) / weights.sum() + 0.5).astype(int)
        counts = np.diff(ends, prepend=0)
        width = grams.place.size + grams.place_free.size
        sizes, h, shift = (np.zeros((n, size)) for size in (width, grams.m, grams.d))
        at, unshifted = 0, grams.inverse_u @ grams.pull_u
        for model, count in zip(self.models, counts, strict=True):
            if not count:
                continue
            rows = slice(at, at + count)
            at += count
            (own_generator,) = generator.spawn(1)
            columns, mean, precision = grams.normal(model.terms, model._level)
            base = grams.base(model._level)
            a = _truncated(
                mean,
                precision,
                grams.is_positive[columns],
                grams.absent[columns],
                count,
                own_generator,
            )
            sizes[rows, grams.place[columns]] = a
            there, prior = grams.precision_of_h(model._level)
            both = np.concatenate([columns, there + grams.k])
            if there.size:
                inside = there + grams.k
                gram = base.gram[np.ix_(inside, inside)] + np.diag(prior)
                right = base.right[inside] - a @ base.gram[np.ix_(columns, inside)]
                lower = _root(gram)
                centre = np.linalg.solve(gram, right.T).T
                noise = own_generator.standard_normal((count, there.size))
                h[rows, there] = centre + np.linalg.solve(lower.T, noise.T).T
            if grams.free:
                values = np.concatenate([a, h[rows, there]], axis=1)
                centre = (base.nuisance_pull - values @ base.cross[:, both].T) @ base.inverse
                block = base.inverse[grams.d :, grams.d :]
                root = _root(block)
                noise = own_generator.standard_normal((count, block.shape[0]))
                sizes[rows, grams.place_free] = centre[:, grams.d :] + noise @ root.T
            inverse_u, _ = _factor(base.nuisance_gram[: grams.d, : grams.d])
            # Rows that are known less well leave u more open than draws without it are.
            values, vectors = np.linalg.eigh(inverse_u - grams.inverse_u)
            wider = own_generator.standard_normal((count, grams.d)) * np.sqrt(
                np.maximum(values, 0.0)
            )
            signal = sizes[rows][:, grams.place] @ base.cross[: grams.d, : grams.k].T
            signal += h[rows] @ base.cross[: grams.d, grams.k :].T
            signal += sizes[rows][:, grams.place_free] @ base.nuisance_gram[grams.d :, : grams.d]
            centre = (base.nuisance_pull[: grams.d] - signal) @ inverse_u
            shift[rows] = centre + wider @ vectors.T - unshifted
        order = generator.permutation(n)
        shift = shift[order]
        noise = generator.standard_normal((n, grams.root_u.shape[1]))
        fitted = unshifted + noise @ grams.root_u.T + shift
        return Draws(sizes[order], h[order] * grams.scale_of_column, shift, fitted)


def confounded(
    sets: Sequence[tuple[frozenset[str], float]], named: Iterable[str] = ()
) -> tuple[tuple[str, ...], ...]:
    """Smallest groups of hypotheses, none named, one of which is there almost surely.

    ``sets``: of hypotheses that are there together, each with its probability.
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
    """Hypotheses, none of those used, of which the sets hold one almost surely; or none."""
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


def _within(right: FloatArray, precision: FloatArray, positive: np.ndarray) -> FloatArray:
    """Most probable sizes with their signs."""
    root = _root(precision)
    along = np.asarray(np.linalg.solve(root, right), dtype=float)
    return bounded_least_squares(root.T, along, np.where(positive, 0.0, -np.inf))


def least_squares(matrix: FloatArray, target: FloatArray) -> FloatArray:
    """x of the least ‖target − matrix x‖, shape (p,), with columns of any unit, (n, p)."""
    scale = np.sqrt((matrix**2).sum(axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    return np.asarray(np.linalg.lstsq(matrix / scale, target, rcond=DEPENDENT)[0] / scale)


def bounded_least_squares(matrix: FloatArray, target: FloatArray, low: FloatArray) -> FloatArray:
    """The same with every x at least as large as ``low``, (p,): zero, or minus infinity."""
    from scipy.optimize import lsq_linear

    scale = np.sqrt((matrix**2).sum(axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    free = least_squares(matrix, target)
    if np.all(free >= low):
        return free
    whole = np.column_stack([matrix / scale, target])
    root = np.asarray(np.linalg.qr(whole, mode="r"), dtype=float)
    return np.asarray(lsq_linear(root[:, :-1], root[:, -1], (low, np.inf)).x / scale)


def _truncated(
    mean: FloatArray,
    precision: FloatArray,
    positive: np.ndarray,
    absent: FloatArray,
    n: int,
    generator: np.random.Generator,
) -> FloatArray:
    """(n, k) draws of a normal with some amplitudes positive: n chains of Gibbs side by side.

    ``absent``: prior probability of each that it is 0 (George and McCulloch 1993), (k,).
    """
    result, covariance = np.zeros((n, mean.size)), np.linalg.inv(precision)
    bounded, free = np.flatnonzero(positive), np.flatnonzero(~positive)
    if bounded.size:
        sub = covariance[np.ix_(bounded, bounded)]
        own = np.linalg.inv(sub)
        middle = mean[bounded]
        x = np.maximum(np.broadcast_to(middle, (n, bounded.size)), 0.0).copy()
        for _ in range(GIBBS_SWEEPS if bounded.size > 1 else 1):
            for i in range(bounded.size):
                sd = 1.0 / math.sqrt(own[i, i])
                centre = x[:, i] - (x @ own[i] - middle @ own[i]) / own[i, i]
                z = normal_between(-centre / sd, np.full(n, np.inf), generator.uniform(size=n))
                x[:, i] = np.maximum(centre + sd * z, 0.0)
                if absent[bounded[i]] > 0.0:
                    # Of a half-normal against none, of which the normal has exp(−c²/2s²).
                    there = math.log(2.0 * sd) + log_ndtr(centre / sd) + 0.5 * (centre / sd) ** 2
                    there -= log_odds(absent[bounded[i]])
                    x[generator.uniform(size=n) > expit(there), i] = 0.0
        result[:, bounded] = x
    if free.size:
        centre = np.broadcast_to(mean[free], (n, free.size))
        if bounded.size:
            gain = np.linalg.solve(sub, covariance[np.ix_(bounded, free)])
            centre = centre + (result[:, bounded] - mean[bounded]) @ gain
        root = _root(np.linalg.inv(precision[np.ix_(free, free)]))
        result[:, free] = centre + generator.standard_normal((n, free.size)) @ root.T
    return result
