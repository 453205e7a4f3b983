"""From an affine model of recordings to names, sizes and disagreement: one posterior, one rule.

Around its fit a view is affine, base + nuisances u + candidates a + discrepancy h, and knows
nothing of probabilities. The posterior is :mod:`bayesbl.model_search.linear`'s. Noise is
autoregressive, as the model with everything in it leaves it, then as the average over the posterior
does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal, Protocol, Self, TypeVar

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.bench.effect_declaration import ORDER, PHASE, RigidLaw
from bayesbl.bench.effects import effect_named
from bayesbl.bench.learned import LearnedTerm, Variable, waves_over
from bayesbl.bench.parameters import PARAMETER_INFO
from bayesbl.diagnosis.diagnosis import (
    CURVE_POINTS,
    Diagnosis,
    Estimate,
    LearnedAnswer,
    NamedEffect,
    ParameterError,
    verdict_of,
)
from bayesbl.diagnosis.disagreement import ComparedPiece, ResidualNoise, Use, disagreement_table
from bayesbl.model_search.constants import EXPECTED_HYPOTHESES, LEARNED_SHARE, NAMED_AT
from bayesbl.model_search.linear import (
    DiscrepancyGroup,
    Draws,
    Linearised,
    MisfitBand,
    Term,
    bounded_least_squares,
    least_squares,
    search,
)
from bayesbl.model_search.residuals import Unexplained, What
from bayesbl.progress import StageProgress
from bayesbl.recording.types import BoolArray, FloatArray
from bayesbl.units import unit_of

MOST_TERMS = 8
"""Of a set: the rigid benches met so far lack five laws at most, and lines come beside these."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A recording, or a part of one, as it is compared.

    Attributes
    ----------
    name, channel
        Of the recording, and of what is compared.
    use
        ``used``: effects are fitted on it. ``held_out``: only start, phases and offsets are.
    time_s, measured
        Shape (n,), evenly spaced; the channel's unit.
    excluded
        Shape (n,): samples that were lost or cannot be trusted, ``None`` where there are none.
    shown
        Whether the answer tells its disagreement: not of what the comparison could not explain.
    white
        Autocovariance of white noise behind the filter that both sides passed, lags of 0, 1, …
        samples; ``None`` where they passed none.
    """

    name: str
    channel: str
    use: Use
    time_s: FloatArray
    measured: FloatArray
    excluded: BoolArray | None = None
    shown: bool = True
    white: FloatArray | None = None

    def kept(self, values: FloatArray) -> FloatArray:
        """Values of the samples that count, (n, …) to (k, …)."""
        return values if self.excluded is None else values[~self.excluded]

    def part(self, rows: slice, use: Use) -> Piece:
        """Some samples of it, with a use of their own."""
        excluded = None if self.excluded is None else self.excluded[rows]
        time_s, measured = self.time_s[rows], self.measured[rows]
        return replace(self, time_s=time_s, measured=measured, excluded=excluded, use=use)

    @property
    def period_s(self) -> float:
        """Sampling period, s."""
        return float(self.time_s[-1] - self.time_s[0]) / (self.time_s.size - 1)


@dataclass(frozen=True, eq=False)
class Rows:
    """The samples of pieces that count, one piece after the other: N in all."""

    pieces: tuple[Piece, ...]

    def stack(self, of: Callable[[int], FloatArray]) -> FloatArray:
        """What there is of each piece, (n, …), in one array, (N, …)."""
        return np.concatenate([piece.kept(of(i)) for i, piece in enumerate(self.pieces)])

    @cached_property
    def slices(self) -> list[slice]:
        """Of each piece."""
        ends = np.cumsum([0, *(piece.kept(piece.time_s).size for piece in self.pieces)])
        return [slice(*pair) for pair in pairwise(ends.tolist())]

    @cached_property
    def measured(self) -> FloatArray:
        """Shape (N,)."""
        return self.stack(lambda i: self.pieces[i].measured)

    def where(self, holds: Callable[[Piece], bool]) -> BoolArray:
        """Samples of the pieces of which something holds, (N,)."""
        lengths = [rows.stop - rows.start for rows in self.slices]
        return np.repeat([holds(piece) for piece in self.pieces], lengths)

    def of(self, recording: str) -> BoolArray:
        """Samples of one recording, (N,)."""
        return self.where(lambda piece: piece.name == recording)

    @cached_property
    def used(self) -> BoolArray:
        """Those that are fitted, (N,)."""
        return self.where(lambda piece: piece.use == "used")

    @cached_property
    def shown(self) -> BoolArray:
        """Of these, those whose disagreement is told, (N,)."""
        return self.where(lambda piece: piece.use == "used" and piece.shown)

    @cached_property
    def recordings(self) -> tuple[str, ...]:
        """Names of those that are fitted."""
        return tuple(dict.fromkeys(p.name for p in self.pieces if p.use == "used"))

    def by_recording(self, columns: FloatArray) -> FloatArray:
        """Columns, (N, k), apart for every fitted recording, (N, k recordings)."""
        return np.hstack([columns * self.of(name)[:, None] for name in self.recordings])


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """One shape of a candidate.

    ``shapes``: parameters that are not linear, by name. ``columns``: change of the prediction by
    one unit of each linear parameter, (N, k). ``weight``: share of its prior.
    ``size``: that its parameter usually has, in its unit, where that is known whatever is compared.
    """

    shapes: Mapping[str, float]
    columns: FloatArray
    weight: float = 1.0
    size: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A hypothesis as a view sees it.

    Attributes
    ----------
    label
        Unique; an effect's name, a bench parameter's, or a line's.
    kind
        ``effect`` of the catalogue, ``parameter`` of the bench that is wrong, ``line`` in time, or
        ``gravity`` of which the bench states none.
    name
        Of the effect or the parameter.
    parameters
        Names of the linear ones; of a wave its amplitude alone, as its columns are sine and cosine.
    usual
        Share that it usually has in the root mean square of what is compared.
    not_negative
        The amplitude has a sign.
    own_phase
        A wave with a sine and a cosine for every recording; with one for all where ``False``.
    probability
        Beforehand; ``None`` where it is as of any other.
    """

    label: str
    kind: Literal["effect", "parameter", "line", "gravity"]
    name: str
    parameters: tuple[str, ...]
    looks: tuple[Look, ...]
    usual: float
    not_negative: bool = False
    is_wave: bool = False
    own_phase: bool = False
    excludes: frozenset[str] = frozenset()
    requires: frozenset[str] = frozenset()
    same_as: tuple[str, ...] = ()
    probability: float | None = None

    @property
    def holds_another(self) -> bool:
        """Whether it is one law and a departure from it: two hypotheses in one."""
        return self.kind == "effect" and bool(self.excludes)


def candidate_of(
    law: RigidLaw, name: str, parameters: tuple[str, ...], looks: tuple[Look, ...], **other: Any
) -> Candidate:
    """The effect of this name, by its law; ``other``: fields that are not as that says."""
    by_law = Candidate(
        name,
        "effect",
        name,
        parameters,
        looks,
        law.usual,
        effect_named(name).parameter(law.amplitude).not_negative,
        excludes=frozenset({law.contains} if law.contains else ()),
        requires=frozenset({law.requires} if law.requires else ()),
        same_as=law.same_as,
    )
    return replace(by_law, **other)


@dataclass(frozen=True, eq=False)
class Series:
    """A torque over a variable, its amplitudes falling as 1/k.

    ``reach``: of the variable, as recorded.
    """

    variable: Variable
    period: float
    reverses: bool
    orders: int
    reach: tuple[float, float]

    @property
    def kind(self) -> str:
        """What it is a torque over."""
        return f"motor_torque_over_{self.variable}{'_reversing' if self.reverses else ''}"

    @cached_property
    def _decay(self) -> FloatArray:
        """Of the amplitudes, cosines and sines, (2 orders,)."""
        return np.tile(1.0 / np.arange(1, self.orders + 1), 2)

    @cached_property
    def means(self) -> FloatArray:
        """Of the waves over what was recorded, which are taken off, (2 orders,): the mean is an
        effect's."""
        low, high = self.reach
        x = np.linspace(low, min(high, low + self.period), 1000)
        return np.asarray(self._waves(x).mean(axis=0))

    def _waves(self, x: FloatArray) -> FloatArray:
        return np.hstack(waves_over(x, self.period, self.orders)) * self._decay

    def waves(self, x: FloatArray) -> FloatArray:
        """Cosines, then sines, less their means, (n, 2 orders)."""
        return self._waves(x) - self.means

    def torque(self, coefficients: FloatArray, sds: FloatArray | None = None) -> LearnedTerm:
        """With coefficients of the waves, (2 orders,), and their standard deviations."""
        waves = coefficients * self._decay
        sd: tuple[float, ...] = ()
        if sds is not None:
            constant = math.sqrt(float((sds * self.means) @ (sds * self.means)))
            sd = (constant, *(sds * self._decay).tolist())
        return LearnedTerm(
            "motor",
            self.variable,
            self.period,
            -float(coefficients @ self.means),
            tuple(waves[: self.orders].tolist()),
            tuple(waves[self.orders :].tolist()),
            self.reverses,
            sd,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Discrepancy:
    """Columns of what nothing explains, (N, m), each times its prior's amplitude; ``series``: the
    torque that they are, if any."""

    kind: str
    columns: FloatArray
    series: Series | None = None


@dataclass(frozen=True, eq=False)
class AffineModel:
    """A view around a fit, in the channel's unit, everything over its N rows.

    ``nuisances``: columns that are fitted anyway, (N,), by name. ``nuisance_sds``: of those of
    which something is known beforehand, around what the base has. ``without``: predictions of a fit
    without any effect, (N,), where the base and the nuisances alone are none. ``bands``: rows in
    which anything may be off. ``noises``: of every used piece, where known. ``most_terms``: of a
    set.
    """

    rows: Rows
    base: FloatArray
    nuisances: Mapping[str, FloatArray]
    candidates: tuple[Candidate, ...] = ()
    discrepancies: tuple[Discrepancy, ...] = ()
    nuisance_sds: Mapping[str, float] = field(default_factory=dict)
    without: FloatArray | None = None
    bands: tuple[MisfitBand, ...] = ()
    noises: Sequence[ResidualNoise] | None = None
    most_terms: int = MOST_TERMS

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the nuisances but for those of held-out recordings alone."""
        used, every = self.rows.used, self.nuisances.items()
        return tuple(name for name, column in every if column[used].any() or not column.any())

    @cached_property
    def jacobian(self) -> FloatArray:
        """Theirs, (N, d)."""
        own = [self.nuisances[name] for name in self.names]
        return np.column_stack([np.zeros((self.base.size, 0)), *own])

    @cached_property
    def by_nuisances(self) -> FloatArray:
        """Nuisances that fit the shown rows best beside nothing else, (d,)."""
        shown, residual = self.rows.shown, self.rows.measured - self.base
        return least_squares(self.jacobian[shown], residual[shown])

    def columns(self, candidate: Candidate, look: Look) -> FloatArray:
        """Of a candidate, with a pair for every used recording where phases are their own."""
        return self.rows.by_recording(look.columns) if candidate.own_phase else look.columns


SURE_PARAMETER = 3.0
"""Standard deviations beyond which a value is told: three in a thousand by chance."""


def impossible(estimates: Mapping[str, Estimate]) -> Iterator[str]:
    """A sentence for each fitted parameter that no joint can have: then nothing is believed.

    Noise alone may carry a value below zero.
    """
    for name, estimate in estimates.items():
        info = PARAMETER_INFO[name]
        if info.positive and estimate.value + SURE_PARAMETER * estimate.sd <= 0.0:
            yield (
                f"The best fit with {name} free has {estimate.value:.3g} {info.unit} there, which "
                "nothing has: what the recordings show follows no law that was tried, so nothing "
                "is named. Faster motion shows the inertia, slow motion in both directions the "
                "friction."
            )


def parameter_errors(bench: Bench, estimates: Mapping[str, Estimate]) -> Iterator[ParameterError]:
    """Those that lie beyond their tolerance by more than their standard deviations explain."""
    for name, fitted in estimates.items():
        believed = bench.parameters[name]
        beyond = abs(fitted.value - believed.value) - believed.tolerance
        if beyond > SURE_PARAMETER * fitted.sd:
            yield ParameterError(name, believed.value, believed.tolerance, fitted)


TORQUES = ("N m", "kg")
"""Beginnings of the units of what is in proportion to a torque: coefficients and inertias too."""


def with_shared_scale(
    estimates: Mapping[str, Estimate], units: Mapping[str, str], scale_sd: float
) -> dict[str, Estimate]:
    """Estimates by name, those of torques as uncertain as the factor.

    ``scale_sd``: relative standard deviation of the factor, zero if it is known.
    """
    return {
        name: replace(estimate, sd=math.hypot(estimate.sd, scale_sd * estimate.value))
        if units[name].startswith(TORQUES)
        else estimate
        for name, estimate in estimates.items()
    }


DRAWS = 1000
"""Of the posterior, from which sizes are told: a standard deviation is good to 2 %."""

DISCREPANCY_SHARE = 0.1
"""Of the root mean square of what is compared, that usually has no law of the catalogue: a smooth
torque, or a share of a line's power, as no loop is quite as its equation."""

EXCESS = 3.4
"""Of what a bench leaves over the noise floor, up to which it is taken for noise. Slower noise, and
drift, is more, and nothing tells it from an effect that is missing. At 2.5 samples in a period of
the cut-off it is 4 times what does not follow from the samples before: there white noise is 1.16
times that. Denser samples do not move it."""

CLOSED = 0.9
"""Of the disagreement before, below which it must be after naming, if it is far above the noise."""

MOST_EFFECTS = 6
"""Named where a configuration does not say how many."""

NONE = 1e-6
"""Of its usual size: so small a size is none."""

ROUNDS = 3
"""Of search, noise and finer shapes."""

ROUNDING = 1e-6
"""Least noise, of the root mean square of what the base leaves. A simulation without noise is
explained to the last digit, and evidence would be that of its rounding, or none."""

COLLINEAR = 0.9999
"""Cosine between what two candidates do, from which it is the same but for a hundredth."""

_RIDGE_ROUNDS = 4
_TINY = float(np.finfo(float).tiny)


AnyView = TypeVar("AnyView", bound="Refinable")


class Refinable(Protocol):
    """Recordings as an affine model around a fit."""

    @property
    def model(self) -> AffineModel:
        """Around the present fit."""

    def refined(self, inference: Inference) -> Self:
        """Around the fit that an inference gives, with finer shapes."""


class View(Refinable, Protocol):
    """Recordings and a bench, linearised, of which :func:`diagnose` tells what is missing."""

    @property
    def rows(self) -> Rows:
        """What is compared."""

    def prepared(self) -> View:
        """Around a first fit."""

    def settled(self, labels: Sequence[str]) -> View:
        """Around the fit with these candidates and no other; itself where that is linear."""

    def augmented(
        self, named: Mapping[str, Mapping[str, float]], answer: Diagnosis
    ) -> Bench | None:
        """The bench with what was named and learned, if a bench file can hold it."""

    def reportable(self, inference: Inference, label: str) -> bool:
        """Whether a name says something of the joint."""


@dataclass(frozen=True, slots=True, eq=False)
class Coefficients:
    """Of the nuisances (d,); of terms, in the catalogue's units, and of groups, by their places
    where they are not none."""

    nuisances: FloatArray
    sizes: Mapping[int, FloatArray] = field(default_factory=dict)
    discrepancy: Mapping[int, FloatArray] = field(default_factory=dict)


class Inference:
    """The posterior of one affine model.

    Attributes
    ----------
    model
        What was inferred.
    noises
        Of every used piece.
    sizes
        What the samples of used pieces are counted in, the channel's unit, (N,): one size for all
        that are shown, one for those that hold lines alone, of the noise where its spectrum is
        strongest, and more where it is larger than on average. There p'Σp ≤ s² p'p for every
        prediction p, so that no evidence is counted that is not there. Whitened, or each in its
        own, recordings would be fitted where they are least noisy, which of a real joint is where
        the bench happens to be best.
    posterior
        Over sets of candidates.
    """

    def __init__(self, model: AffineModel, noises: Sequence[ResidualNoise] | None = None) -> None:
        self.model, rows = model, model.rows
        used = rows.used
        self._target = (rows.measured - model.base)[used]
        self._nuisances = model.jacobian[used]
        pieces = [piece for piece in rows.pieces if piece.use == "used"]
        lengths = [piece.kept(piece.time_s).size for piece in pieces]
        self._ends = np.cumsum(lengths)[:-1]
        terms: list[Term] = []
        for candidate in model.candidates:
            for look in candidate.looks:
                block = model.columns(candidate, look)[used]
                parts = np.split(block, self._ends)
                size = np.sqrt(np.max([(part**2).mean(axis=0) for part in parts], axis=0))
                if not size.any():
                    continue  # these recordings do not show it
                usual = candidate.usual * self._level / np.where(size > 0.0, size, 1.0)
                unit = np.where(size > 0.0, usual if look.size is None else look.size, 0.0)
                terms.append(
                    Term(
                        candidate.label,
                        block * unit,
                        candidate.not_negative and unit.size == 1,
                        prior_weight=look.weight,
                        excludes=candidate.excludes,
                        requires=candidate.requires,
                        unit=unit,
                        source=(candidate, look),
                    )
                )
        every = [np.zeros((rows.measured.size, 0)), *(d.columns for d in model.discrepancies)]
        self._discrepancy = np.hstack(every)[used]
        ends = np.cumsum([columns.shape[1] for columns in every]).tolist()
        self.groups = [slice(*pair) for pair in pairwise(ends)]
        noises = noises or model.noises
        if noises is None:
            noises = self._noise_beside_everything([term.columns for term in terms])
        self.noises = tuple(noises)
        shown = [piece.shown for piece in pieces]
        pairs = list(zip(self.noises, shown, strict=True))
        strongest = {
            alike: max(self._rounding, *(noise.strongest for noise, s in pairs if s == alike))
            for alike in set(shown)
        }
        self._shown_size = strongest[True]
        even = np.repeat([strongest[alike] for alike in shown], lengths)
        self.sizes = np.maximum(np.concatenate([noise.local for noise in self.noises]), even)
        self._burst = self.sizes / even
        self._search(terms)

    @cached_property
    def _rounding(self) -> float:
        """Noise that is always there."""
        model, shown = self.model, self.model.rows.shown
        residual = (model.rows.measured - model.base)[shown]
        return ROUNDING * (math.sqrt(float(np.mean(residual**2))) or 1.0)

    @cached_property
    def _level(self) -> float:
        """Root mean square of what the shown pieces show beside the nuisances."""
        model = self.model
        residual = model.rows.measured - model.base - model.jacobian @ model.by_nuisances
        return max(math.sqrt(float(np.mean(residual[model.rows.shown] ** 2))), self._rounding)

    def _noise_beside_everything(self, blocks: list[FloatArray]) -> list[ResidualNoise]:
        """From what all candidates and the discrepancy together leave, by ridge regression."""
        level = self._level
        n, h, target = self._nuisances, self._discrepancy, self._target
        scale = np.sqrt((n**2).mean(axis=0))
        rms = np.sqrt((h**2).mean(axis=0).max(initial=0.0))
        h = h * (0.3 * level / rms if rms > 0.0 else 0.0)
        matrix = np.hstack([n / np.where(scale > 0.0, scale, 1.0), *blocks, h])
        gram, right = matrix.T @ matrix, matrix.T @ target
        free = np.concatenate([np.full(n.shape[1], 1e-12), np.ones(matrix.shape[1] - n.shape[1])])
        variance = (0.1 * level) ** 2
        for _ in range(_RIDGE_ROUNDS):
            inverse = np.linalg.pinv(gram + np.diag(variance * free), 1e-13, True)
            residual = target - matrix @ (inverse @ right)
            freedom = max(target.size - float(np.sum(inverse * gram)), 0.1 * target.size)
            variance = float(residual @ residual) / freedom
        return [ResidualNoise.of(part) for part in np.split(residual, self._ends)]

    def _search(self, terms: list[Term]) -> None:
        def counted(rows: FloatArray) -> FloatArray:
            return np.asarray((rows.T / self.sizes).T)

        jacobian, discrepancy = counted(self._nuisances), counted(self._discrepancy)
        residual, d = counted(self._target), jacobian.shape[1]
        one_more = EXPECTED_HYPOTHESES / max(1, len({term.hypothesis for term in terms}))
        for k, term in enumerate(terms):
            weight = term.prior_weight * (one_more if term.source[0].holds_another else 1.0)
            terms[k] = replace(term, columns=counted(term.columns), prior_weight=weight)
        kinds = [d.kind for d in self.model.discrepancies]
        usual = DISCREPANCY_SHARE * self._level / self._shown_size
        groups = [DiscrepancyGroup(k, s, usual) for k, s in zip(kinds, self.groups, strict=True)]
        sds = [self.model.nuisance_sds.get(n, math.inf) for n in self.model.names]
        prior = np.diag(np.asarray(sds, dtype=float) ** -2.0)
        linearised = Linearised(
            residual, jacobian, prior, np.zeros(d), terms, discrepancy, groups, self.model.bands
        )
        own = {c.label: c.probability for c in self.model.candidates if c.probability is not None}
        self.posterior = search(linearised, self.model.most_terms, own)

    @cached_property
    def draws(self) -> Draws:
        """Of the posterior."""
        return self.posterior.draw(np.random.default_rng(0), DRAWS)

    # What is asked of it

    @property
    def terms(self) -> Sequence[Term]:
        """Each of one look of a candidate: these two are its source."""
        return self.posterior.linearised.terms

    @cached_property
    def labels(self) -> Mapping[str, Candidate]:
        """Candidates that show."""
        return {term.hypothesis: term.source[0] for term in self.terms}

    @cached_property
    def sure(self) -> tuple[tuple[str, ...], ...]:
        """Candidates that are there almost surely, alone or one of several, in catalogue order."""
        sure = self.posterior.sure
        return tuple(tuple(n for n in self.labels if n in members) for members in sure)

    def lookalikes(self, label: str) -> list[str]:
        """Candidates that differ from one by nothing in these recordings but nuisances."""
        view = self.posterior.linearised
        terms = [term for term in view.terms if term.columns.shape[1] == 1]
        scale = np.maximum(np.abs(view.jacobian).max(axis=0), _TINY)
        basis, _ = np.linalg.qr(view.jacobian / scale)
        columns = np.hstack([np.zeros((len(basis), 0)), *(term.columns for term in terms)])
        apart = columns - basis @ (basis.T @ columns)
        apart /= np.maximum(np.linalg.norm(apart, axis=0), _TINY)
        own = np.array([term.hypothesis == label for term in terms], dtype=bool)
        alike = np.any(np.abs(apart[:, own].T @ apart) > COLLINEAR, axis=0) & ~own
        return [terms[k].hypothesis for k in np.flatnonzero(alike)]

    def values(self, label: str) -> dict[str, Estimate]:
        """Parameters of a candidate where it is there: linear ones and shapes, averaged."""
        candidate = self.labels[label]
        parts: dict[str, list[tuple[FloatArray, FloatArray, FloatArray]]] = {}
        for k, term in enumerate(self.terms):
            if term.hypothesis != label or k not in self.posterior.sizes:
                continue
            weight, mean, covariance = self.posterior.sizes[k]
            mean = mean * term.unit
            covariance = covariance * np.outer(term.unit, term.unit)
            own: dict[str, tuple[FloatArray, FloatArray]] = {}
            if candidate.is_wave:
                own = _of_waves(candidate, mean, covariance)
            else:
                for at, name in enumerate(candidate.parameters):
                    own[name] = (mean[:, at], covariance[:, at, at])
            for name, shape in term.source[1].shapes.items():
                own[name] = (np.full(weight.size, shape), np.zeros(weight.size))
            for name, (value, variance) in own.items():
                parts.setdefault(name, []).append((weight, value, variance))
        estimates = {}
        for name, pieces in parts.items():
            weight, value, variance = map(np.concatenate, zip(*pieces, strict=True))
            share = weight / weight.sum()
            middle = float(share @ value)
            if name == PHASE:
                middle = math.atan2(share @ np.sin(value), share @ np.cos(value))
                value = middle + np.angle(np.exp(1j * (value - middle)))
            spread = float(share @ (variance + (value - middle) ** 2))
            estimates[name] = Estimate(middle, math.sqrt(spread))
        return estimates

    def nuisance(self, name: str) -> Estimate:
        """A nuisance by name."""
        draws = self.draws.fitted[:, self.model.names.index(name)]
        return Estimate(float(draws.mean()), float(draws.std()))

    @property
    def average(self) -> Coefficients:
        """Of everything, over the posterior."""
        return Coefficients(
            self.draws.fitted.mean(axis=0),
            {
                k: weight @ mean * self.terms[k].unit
                for k, (weight, mean, _) in self.posterior.sizes.items()
            },
            {
                g: self.draws.discrepancy[:, group].mean(axis=0)
                for g, group in enumerate(self.groups)
            },
        )

    def projection(self, labels: Sequence[str], groups: Sequence[int] = ()) -> Coefficients:
        """Of what is named, as it fits best with what is learned and nothing else.

        What no name holds is told apart from the names only if the names take all they can: the
        discrepancy is what is left, orthogonal to them (Plumlee 2017, JASA 112, 1274). All samples
        count alike: where a bench is worst is a part of what it has to predict.
        """
        view, free = self.posterior.linearised, math.inf
        chosen = [self.posterior.likeliest(label) for label in labels]
        terms = [view.terms[k] for k in chosen]
        learned = [view.discrepancy[:, self.groups[g]] for g in groups]
        blocks = [view.jacobian, *(term.columns for term in terms), *learned]
        widths = [block.shape[1] for block in blocks]
        signs = [0.0 if term.positive else -free for term in terms]
        anyway = [self.model.nuisance_sds.get(n, free) for n in self.model.names]
        known = [*(free for _ in terms), *(self.posterior.discrepancy_sd(g) for g in groups)]
        sds = np.concatenate([anyway, np.repeat(known, widths[1:])])
        prior = np.diag(1.0 / np.maximum(sds, 1e-300))[np.isfinite(sds)]
        values = bounded_least_squares(
            np.vstack([(np.hstack(blocks).T * self._burst).T, prior]),
            np.concatenate([view.residual * self._burst, np.zeros(len(prior))]),
            np.repeat([-free, *signs, *(-free for _ in groups)], widths),
        )
        nuisances, *parts = np.split(values, np.cumsum(widths)[:-1])
        sizes = {k: part * self.terms[k].unit for k, part in zip(chosen, parts, strict=False)}
        return Coefficients(nuisances, sizes, dict(zip(groups, parts[len(chosen) :], strict=True)))

    def of_projection(self, fitted: Coefficients, label: str) -> dict[str, float]:
        """Linear parameters of a candidate."""
        candidate = self.labels[label]
        size = fitted.sizes[self.posterior.likeliest(label)]
        if not candidate.is_wave:
            return dict(zip(candidate.parameters, size.tolist(), strict=True))
        waves = _of_waves(candidate, size[None], np.zeros((1, size.size, size.size)))
        return {name: float(value[0]) for name, (value, _) in waves.items()}

    def is_none(self, fitted: Coefficients, label: str) -> bool:
        """Whether a candidate whose sign is known would rather have the other one."""
        place = self.posterior.likeliest(label)
        term = self.terms[place]
        return term.positive and bool(fitted.sizes[place] <= NONE * term.unit)

    def predicted(self, coefficients: Coefficients) -> FloatArray:
        """Of every row, (N,); what belongs to a held-out recording alone is fitted on it."""
        model, rows = self.model, self.model.rows
        total = model.base + model.jacobian @ coefficients.nuisances
        waves: list[tuple[float, FloatArray]] = []
        for k, size in coefficients.sizes.items():
            candidate, look = self.terms[k].source
            total = total + model.columns(candidate, look) @ size
            if candidate.own_phase and size.any():
                waves.append((float(np.hypot(*size.reshape(-1, 2).T).mean()), look.columns))
        for g, size in coefficients.discrepancy.items():
            total = total + model.discrepancies[g].columns @ size
        for piece, own in zip(rows.pieces, rows.slices, strict=True):
            if piece.use == "used":
                continue
            free = [c[own] for n, c in model.nuisances.items() if n not in model.names]
            new = [] if piece.name in rows.recordings else waves
            if not (free or new):
                continue
            matrix = np.column_stack([*free, *(columns[own] for _, columns in new)])
            values = least_squares(matrix, rows.measured[own] - total[own])
            for k, (pair_size, _) in enumerate(new):
                pair = values[len(free) + 2 * k : len(free) + 2 * k + 2]
                pair *= pair_size / max(float(np.hypot(*pair)), 1e-12 * pair_size)
            total[own] += matrix @ values
        return np.asarray(total)

    def discrepancy(self) -> FloatArray:
        """Of every row what nothing explains, averaged, (N,)."""
        total = np.zeros(self.model.base.size)
        for g, size in self.average.discrepancy.items():
            total += self.model.discrepancies[g].columns @ size
        return total

    def residual_noise(self) -> Sequence[ResidualNoise]:
        """Of what the average over the posterior leaves of every used piece, unless it is known."""
        if self.model.noises is not None:
            return self.model.noises
        rows = self.model.rows
        residual = rows.measured - self.predicted(self.average)
        return [
            ResidualNoise.of(residual[own])
            for piece, own in zip(rows.pieces, rows.slices, strict=True)
            if piece.use == "used"
        ]

    def probability(self, names: Sequence[str]) -> float:
        """That one of some candidates is there, by their labels or their effects' names."""
        own = set(names)
        return self.posterior.probability(n for n, c in self.labels.items() if {n, c.name} & own)


def _of_waves(
    candidate: Candidate, mean: FloatArray, covariance: FloatArray
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Amplitude, over all pairs of sine and cosine, and phase, if there is one, with variances."""
    pairs = mean.reshape(len(mean), -1, 2)
    size = np.maximum(np.hypot(pairs[..., 0], pairs[..., 1]), _TINY)
    along = (pairs / size[..., None] / size.shape[1]).reshape(mean.shape)
    variance = np.einsum("mi,mij,mj->m", along, covariance, along)
    made = {candidate.parameters[0]: (size.mean(axis=1), variance)}
    if not candidate.own_phase:
        across = np.stack([-pairs[:, 0, 1], pairs[:, 0, 0]], axis=1) / size**2
        variance = np.einsum("mi,mij,mj->m", across, covariance, across)
        made[PHASE] = (np.arctan2(pairs[:, 0, 1], pairs[:, 0, 0]), variance)
    return made


def inferred(
    view: AnyView, progress: StageProgress | None = None, rounds: int = ROUNDS
) -> tuple[AnyView, Inference]:
    """A view around its best fit, and the posterior there.

    ``rounds``: of inference, each but the first around the fit that the last one gives.
    """
    inference = Inference(view.model)
    for done in range(1, rounds):
        if progress is not None:
            progress("Comparing sets of effects", done, rounds)
        noises = inference.residual_noise()
        view = view.refined(inference)
        inference = Inference(view.model, noises)
    return view, inference


def diagnose(
    view: View,
    bench: Bench,
    *,
    most: int,
    notes: Sequence[str] = (),
    scale_sd: float = 0.0,
    progress: StageProgress | None = None,
) -> Diagnosis:
    """Name what is missing; the disagreement before and after.

    Parameters
    ----------
    view
        Not yet prepared.
    bench
        The one believed, for the tolerances of parameters that were fitted.
    most
        Effects named at most, the strongest.
    scale_sd
        Relative standard deviation of a factor that all torques and inertias have in common.
    """
    view, inference = inferred(view.prepared(), progress)
    named_sets, remaining = _named(view, inference, most)
    group = _learned_group(inference)
    view, at = view.settled([label for label, _ in named_sets]), inference
    if view.model is not inference.model:
        at = Inference(view.model, inference.noises)
    named_sets, fitted = _fitted(at, named_sets, [] if group is None else [group])
    labels = [label for label, _ in named_sets]
    learned = None if group is None else learned_answer(at, fitted, group)
    kinds = {label: inference.labels[label].kind for label in labels}
    estimates = {
        name: Estimate(bench.value(name) + value, inference.nuisance(name).sd)
        for name, value in zip(at.model.names, fitted.nuisances, strict=True)
        if name in PARAMETER_INFO
    }
    for label in (label for label, kind in kinds.items() if kind == "parameter"):
        (size,) = at.of_projection(fitted, label).values()
        estimates[label] = Estimate(bench.value(label) + size, inference.values(label)[label].sd)
    after, before = at.predicted(fitted), at.model.without
    if before is None:
        before = at.predicted(Coefficients(at.model.by_nuisances))
    denied = tuple(impossible(estimates))
    if denied:
        remaining = []
    pieces = compared_pieces(at.model.rows, before, after)
    disagreement = disagreement_table(pieces)["over_all"]["used"]
    # Otherwise it would be an accident of a fit that is far from what was recorded.
    least = max(CLOSED * disagreement["before"], EXCESS * disagreement["noise_floor"])
    if denied or disagreement["after"] >= least:
        named_sets, estimates, learned = [], {}, None
        pieces = compared_pieces(at.model.rows, before, before)
        disagreement = disagreement_table(pieces)["over_all"]["used"]
    named = [(label, alike) for label, alike in named_sets if kinds[label] == "effect"]
    units = {name: PARAMETER_INFO[name].unit for name in estimates}
    estimates = with_shared_scale(estimates, units, scale_sd)
    effects = [
        _effect(inference, label, at.of_projection(fitted, label), alike, scale_sd)
        for label, alike in named
    ]
    errors = tuple(parameter_errors(bench, estimates))
    lines = tuple(_line(inference, *item) for item in remaining)
    over_noise = disagreement["after"] / max(
        disagreement["noise_floor"], ROUNDING * disagreement["before"], _TINY
    )
    is_much = over_noise > EXCESS
    remains = bool(lines or denied or group is not None or "gravity" in kinds.values()) or is_much
    if effects and is_much:
        denied = (
            f"With what is named, {over_noise:.0f} times the noise remains: "
            "something else is missing too, and the sizes may include part of it.",
        )
    answer = Diagnosis(
        verdict_of(effects=bool(effects), parameters=bool(errors), remains=remains),
        tuple(effects),
        errors,
        lines,
        pieces,
        (*denied, *notes, *_gravity_notes(inference)),
        bench_parameters=estimates,
        learned=learned,
    )
    if learned is None:
        return answer
    sizes = {e.name: {k: v.value for k, v in e.parameters.items()} for e in effects}
    return replace(answer, augmented_bench=view.augmented(sizes, answer))


def _gravity_notes(inference: Inference) -> Iterator[str]:
    """Of gravity that the bench lacks."""
    if "gravity" in inference.posterior.named:
        ((name, size),) = inference.values("gravity").items()
        yield (
            "The rest follows the load's angle as gravity does, although the bench has "
            f"{name} = 0: {size.value:.3g} N m at the load were fitted, with their "
            "direction. A balancer that the bench lacks may look the same. Give gravity in the "
            "bench file, if it is that."
        )


def _named(
    view: View, inference: Inference, most: int
) -> tuple[list[tuple[str, tuple[str, ...]]], list[tuple[str, What]]]:
    """Labels that are named, each with what it is confounded with; lines that remain."""
    labels = inference.labels
    named: list[tuple[str, tuple[str, ...]]] = []
    remaining: list[tuple[str, What]] = []
    waves: list[str] = []
    for members in inference.sure:
        in_time = [m for m in members if labels[m].kind == "line"]
        ripple = [m for m in members if labels[m].kind == "effect" and ORDER in _shapes(labels[m])]
        if in_time:
            remaining.append((ripple[0], "angle or time") if ripple else (in_time[0], "time"))
        elif ripple and len(ripple) == len(members):
            waves.append(ripple[0])
        elif all(view.reportable(inference, m) for m in members):
            first, *others = members
            names = dict.fromkeys(labels[m].name for m in (*others, *inference.lookalikes(first)))
            named.append((first, tuple(n for n in names if n != labels[first].name)))
    waves.sort(key=lambda m: -_share(inference, m))
    named += [(m, ()) for m in waves[:1]]
    remaining += [(m, "motor angle") for m in waves[1:]]
    named.sort(key=lambda pair: -_share(inference, pair[0]))
    effects = [p for p in named if labels[p[0]].kind == "effect"][most:]
    return [p for p in named if p not in effects], remaining


def _fitted(
    inference: Inference, named: list[tuple[str, tuple[str, ...]]], groups: Sequence[int]
) -> tuple[list[tuple[str, tuple[str, ...]]], Coefficients]:
    """What is told, as it fits best; without what is none then, and what requires that."""
    while True:
        fitted = inference.projection([label for label, _ in named], groups)
        none = {label for label, _ in named if inference.is_none(fitted, label)}
        none |= {label for label, _ in named if inference.labels[label].requires & none}
        if not none:
            return named, fitted
        named = [pair for pair in named if pair[0] not in none]


def _shapes(candidate: Candidate) -> Mapping[str, float]:
    return candidate.looks[0].shapes


def _share(inference: Inference, label: str) -> float:
    """χ² of what a candidate makes, averaged."""
    linearised = inference.posterior.linearised
    total = np.zeros(linearised.residual.size)
    sizes = inference.posterior.sizes
    for k, term in enumerate(linearised.terms):
        if term.hypothesis == label and k in sizes:
            total += term.columns @ (sizes[k][0] @ sizes[k][1])
    return float(total @ total)


def _learned_group(inference: Inference) -> int | None:
    """The group of the discrepancy that is told: there almost surely, and its mean no small share
    of the disagreement at the nominal fit."""
    posterior, sure = inference.posterior, dict[int, float]()
    for group, columns in enumerate(inference.groups):
        there = (m.log_posterior for m in posterior.models if m.scales[group] > 0.0)
        if sum(map(math.exp, there)) >= NAMED_AT:
            mean = inference.draws.discrepancy[:, columns].mean(axis=0)
            signal = posterior.linearised.discrepancy[:, columns] @ mean
            share = float(signal @ signal) / max(posterior.excess_chi_square, 1.0)
            if share > LEARNED_SHARE:
                sure[group] = share
    return max(sure, key=lambda group: sure[group], default=None)


def _effect(
    inference: Inference,
    label: str,
    fitted: Mapping[str, float],
    alike: tuple[str, ...],
    scale_sd: float,
) -> NamedEffect:
    candidate = inference.labels[label]
    parameters = inference.values(label)
    for name, value in fitted.items():
        parameters[name] = Estimate(value, parameters[name].sd)
    size = parameters[candidate.parameters[0]]
    sure = inference.probability((label, *alike))
    z = abs(size.value) / max(size.sd, _TINY)
    units = {p.name: p.unit for p in effect_named(candidate.name).parameters}
    parameters = with_shared_scale(parameters, units, scale_sd)
    return NamedEffect(candidate.name, parameters, sure, z, (*candidate.same_as, *alike))


def _line(inference: Inference, label: str, dependence: What) -> Unexplained:
    """A wave that is told and not named."""
    candidate = inference.labels[label]
    values = inference.values(label)
    order = values[ORDER].value if ORDER in values and dependence != "time" else math.nan
    hertz = values["frequency_hz"].value if "frequency_hz" in values else math.nan
    rows = inference.model.rows
    channel = rows.pieces[0].channel
    if dependence == "angle or time":
        rival = [m for m in inference.labels if inference.labels[m].kind == "line"]
        best = max(rival, key=lambda m: inference.posterior.inclusion[m])
        hertz = _shapes(inference.labels[best])["frequency_hz"]
    return Unexplained(
        channel,
        dependence,
        values[candidate.parameters[0]].value,
        unit_of(channel),
        order,
        order,
        hertz if dependence != "motor angle" else math.nan,
        rows.recordings,
        _share(inference, label),
    )


def compared_pieces(rows: Rows, before: FloatArray, after: FloatArray) -> tuple[ComparedPiece, ...]:
    """The shown pieces beside their predictions without and with what was named, each (N,)."""
    return tuple(
        ComparedPiece.of(
            piece.name,
            piece.channel,
            piece.use,
            piece.kept(piece.time_s),
            *(values[own] for values in (rows.measured, before, after)),
            white=piece.white,
        )
        for piece, own in zip(rows.pieces, rows.slices, strict=True)
        if piece.shown
    )


def learned_answer(inference: Inference, fitted: Coefficients, group: int) -> LearnedAnswer | None:
    """A group of the discrepancy as a torque over its variable; ``None`` where it is none."""
    series = inference.model.discrepancies[group].series
    if series is None:
        return None
    draws = inference.draws.discrepancy[:, inference.groups[group]]
    term = series.torque(fitted.discrepancy[group], draws.std(axis=0))
    low, high = series.reach
    if high - low > term.period:
        low, high = -0.5 * term.period, 0.5 * term.period
    x = np.linspace(low, high, CURVE_POINTS)
    return LearnedAnswer(term, x, (series.waves(x) @ draws.T).std(axis=1))
