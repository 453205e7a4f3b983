"""Infer names, sizes and disagreement from an affine model of the recordings.

Near its fit, a view predicts base + nuisances u + candidates a + discrepancy h. The posterior over
sets of candidates is that of :mod:`bayesbl.model_search.linear`. The noise is autoregressive. It is
estimated first from the residual of a ridge regression on everything, then from the residual of the
posterior mean.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal, Self, TypeVar

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
from bayesbl.model_search.constants import EXPECTED_HYPOTHESES, FORM_SHARE, LEARNED_SHARE, NAMED_AT
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
"""Largest number of terms in a set: real rigid machines lacked at most five laws, besides lines."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A recording, or a part of one, with the channel that is compared.

    Attributes
    ----------
    use
        ``used``: effects are fitted on it. ``held_out``: only start, phases and offsets are.
    time_s, measured
        Evenly spaced samples, shape (n,), in the channel's unit.
    excluded
        Samples that are lost or not trusted, shape (n,); ``None`` for none.
    shown
        Whether its disagreement is reported.
    white
        Autocovariance of white noise behind the comparison's filter, at lags of 0, 1, … samples;
        ``None`` without a filter.
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
        """Values at the samples that are not excluded, (n, …) to (k, …)."""
        return values if self.excluded is None else values[~self.excluded]

    def part(self, rows: slice, use: Use) -> Piece:
        """Some of its samples, for another use."""
        excluded = None if self.excluded is None else self.excluded[rows]
        time_s, measured = self.time_s[rows], self.measured[rows]
        return replace(self, time_s=time_s, measured=measured, excluded=excluded, use=use)

    @property
    def period_s(self) -> float:
        """Sampling period, s."""
        return float(self.time_s[-1] - self.time_s[0]) / (self.time_s.size - 1)


@dataclass(frozen=True, eq=False)
class Rows:
    """Samples of several pieces that are not excluded, piece after piece: N in all."""

    pieces: tuple[Piece, ...]

    def stack(self, values_of: Callable[[int], FloatArray]) -> FloatArray:
        """Stack values (n, …) of each piece, given by its index, into (N, …)."""
        return np.concatenate([piece.kept(values_of(i)) for i, piece in enumerate(self.pieces)])

    @cached_property
    def slices(self) -> list[slice]:
        """Rows of each piece."""
        ends = np.cumsum([0, *(piece.kept(piece.time_s).size for piece in self.pieces)])
        return [slice(*pair) for pair in pairwise(ends.tolist())]

    @cached_property
    def measured(self) -> FloatArray:
        """Measured values, (N,)."""
        return self.stack(lambda i: self.pieces[i].measured)

    def where(self, condition: Callable[[Piece], bool]) -> BoolArray:
        """Mask of the rows whose piece fulfils a condition, (N,)."""
        lengths = [rows.stop - rows.start for rows in self.slices]
        return np.repeat([condition(piece) for piece in self.pieces], lengths)

    def of(self, recording: str) -> BoolArray:
        """Mask of the rows of one recording, (N,)."""
        return self.where(lambda piece: piece.name == recording)

    @cached_property
    def used(self) -> BoolArray:
        """Mask of the rows that are fitted, (N,)."""
        return self.where(lambda piece: piece.use == "used")

    @cached_property
    def shown(self) -> BoolArray:
        """Mask of the fitted rows whose disagreement is reported, (N,)."""
        return self.where(lambda piece: piece.use == "used" and piece.shown)

    @cached_property
    def recordings(self) -> tuple[str, ...]:
        """Names of the recordings that are fitted."""
        return tuple(dict.fromkeys(p.name for p in self.pieces if p.use == "used"))

    def by_recording(self, columns: FloatArray) -> FloatArray:
        """Columns (N, k) for each fitted recording separately, (N, k recordings)."""
        return np.hstack([columns * self.of(name)[:, None] for name in self.recordings])


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """One form of a candidate.

    ``shapes``: values of its nonlinear parameters. ``columns``: change of the prediction per unit
    of each linear parameter, (N, k). ``weight``: share of the candidate's prior. ``size``: usual
    size of its parameter in its unit, if it does not depend on the recordings.
    """

    shapes: Mapping[str, float]
    columns: FloatArray
    weight: float = 1.0
    size: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A hypothesis of a view.

    Attributes
    ----------
    label
        Unique: name of an effect, a bench parameter or a line.
    kind
        ``effect`` of the catalogue, wrong ``parameter`` of the bench, ``line`` in time, or
        ``gravity`` that the bench does not state.
    parameters
        Names of the linear parameters. A wave has only its amplitude; its columns are sine and
        cosine.
    usual
        Usual share in the root mean square of the compared signal.
    largest
        Largest size that any joint has, in the parameter's unit.
    not_negative
        Whether the amplitude cannot be negative.
    own_phase
        Whether a wave has its own sine and cosine in each recording.
    probability
        Prior probability; ``None`` for that of every other candidate.
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
    largest: float = math.inf

    @property
    def shapes(self) -> Mapping[str, float]:
        """Nonlinear parameters of its first form."""
        return self.looks[0].shapes


def candidate_of(
    law: RigidLaw, name: str, parameters: tuple[str, ...], looks: tuple[Look, ...], **other: Any
) -> Candidate:
    """Candidate for an effect, from its law; ``other``: fields with other values."""
    amplitude = effect_named(name).parameter(law.amplitude)
    by_law = Candidate(
        name,
        "effect",
        name,
        parameters,
        looks,
        law.usual,
        amplitude.not_negative,
        excludes=frozenset({law.contains} if law.contains else ()),
        requires=frozenset({law.requires} if law.requires else ()),
        same_as=law.same_as,
        # The range of a pure number is that of every joint.
        largest=math.inf if amplitude.unit else amplitude.high,
    )
    return replace(by_law, **other)


@dataclass(frozen=True, eq=False)
class Series:
    """Fourier series of a torque over a variable, whose amplitudes fall as 1/k.

    ``reach``: lowest and highest recorded value of the variable.
    """

    variable: Variable
    period: float
    reverses: bool
    orders: int
    reach: tuple[float, float]

    @property
    def kind(self) -> str:
        """Kind of the discrepancy."""
        return f"motor_torque_over_{self.variable}{'_reversing' if self.reverses else ''}"

    @cached_property
    def _decay(self) -> FloatArray:
        """1/k of the cosines, then of the sines, (2 orders,)."""
        return np.tile(1.0 / np.arange(1, self.orders + 1), 2)

    @cached_property
    def means(self) -> FloatArray:
        """Means of the waves over the recorded range, or their values at a standstill within it,
        (2 orders,). They are subtracted, because a constant torque and dry friction are in the
        catalogue."""
        low, high = self.reach
        if self.variable == "motor_speed" and low <= 0.0 <= high:
            low = high = 0.0
        x = np.linspace(low, min(high, low + self.period), 1000)
        return np.asarray(self._waves(x).mean(axis=0))

    def _waves(self, x: FloatArray) -> FloatArray:
        return np.hstack(waves_over(x, self.period, self.orders)) * self._decay

    def waves(self, x: FloatArray) -> FloatArray:
        """Cosines, then sines, without their means, (n, 2 orders)."""
        return self._waves(x) - self.means

    def torque(self, coefficients: FloatArray, sds: FloatArray | None = None) -> LearnedTerm:
        """Torque with these coefficients of the waves, (2 orders,), and standard deviations."""
        waves = (coefficients * self._decay).tolist()
        sd: tuple[float, ...] = ()
        if sds is not None:
            sd = (float(np.linalg.norm(sds * self.means)), *(sds * self._decay).tolist())
        return LearnedTerm(
            "motor",
            self.variable,
            self.period,
            -float(coefficients @ self.means),
            tuple(waves[: self.orders]),
            tuple(waves[self.orders :]),
            self.reverses,
            sd,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Discrepancy:
    """Columns of one kind of discrepancy, (N, m), scaled to equal priors.

    ``series``: the torque that they make up, if any. ``is_form``: whether it is a departure from
    the forms of laws, which no joint follows exactly, so that it is always in at its usual size.
    ``own``: root mean square of a law of the bench that it resembles, in the channel's unit.
    ``of``: the candidate whose departures in each recording they are, if any.
    """

    kind: str
    columns: FloatArray
    series: Series | None = None
    is_form: bool = False
    own: float = 0.0
    of: str = ""


@dataclass(frozen=True, eq=False)
class AffineModel:
    """A view linearised at its fit, over its N rows, in the channel's unit.

    Attributes
    ----------
    nuisances
        Columns that are always fitted, (N,), by name.
    nuisance_sds
        Prior standard deviations of nuisances, around their value in ``base``; others are flat.
    of_recorder
        Nuisances that a fit without any effect lacks.
    without
        Prediction of a fit without any effect, (N,), if base and nuisances alone are none.
    bands
        Rows with unknown errors.
    noises
        Noise of each used piece, if it is known.
    """

    rows: Rows
    base: FloatArray
    nuisances: Mapping[str, FloatArray]
    candidates: tuple[Candidate, ...] = ()
    discrepancies: tuple[Discrepancy, ...] = ()
    nuisance_sds: Mapping[str, float] = field(default_factory=dict)
    of_recorder: frozenset[str] = frozenset()
    without: FloatArray | None = None
    bands: tuple[MisfitBand, ...] = ()
    noises: Sequence[ResidualNoise] | None = None
    most_terms: int = MOST_TERMS

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the nuisances, without those of held-out recordings."""
        used, columns = self.rows.used, self.nuisances.items()
        return tuple(name for name, column in columns if column[used].any() or not column.any())

    @cached_property
    def jacobian(self) -> FloatArray:
        """Columns of these nuisances, (N, d)."""
        columns = [self.nuisances[name] for name in self.names]
        return np.column_stack([np.zeros((self.base.size, 0)), *columns])

    @cached_property
    def by_nuisances(self) -> FloatArray:
        """Least-squares fit of the nuisances, but the recorder's, to the shown rows, (d,)."""
        shown, residual = self.rows.shown, self.rows.measured - self.base
        columns = self.jacobian * [name not in self.of_recorder for name in self.names]
        return least_squares(columns[shown], residual[shown])

    def columns(self, candidate: Candidate, look: Look) -> FloatArray:
        """Columns of a candidate, separate for each used recording if its phases are."""
        return self.rows.by_recording(look.columns) if candidate.own_phase else look.columns


SURE_PARAMETER = 3.0
"""Standard deviations beyond which a value is reported as wrong: three in a thousand by chance."""


def impossible(estimates: Mapping[str, Estimate]) -> Iterator[str]:
    """A sentence for each fitted parameter with a value that no joint can have.

    Nothing else of such a fit is believed. Noise alone may make a value slightly negative.
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
    """Parameters that are significantly beyond their tolerances."""
    for name, fitted in estimates.items():
        believed = bench.parameters[name]
        beyond = abs(fitted.value - believed.value) - believed.tolerance
        if beyond > SURE_PARAMETER * fitted.sd:
            yield ParameterError(name, believed.value, believed.tolerance, fitted)


TORQUES = ("N m", "kg")
"""First characters of the units of all quantities that are proportional to a torque."""


def with_shared_scale(
    estimates: Mapping[str, Estimate], units: Mapping[str, str], scale_sd: float
) -> dict[str, Estimate]:
    """Add the uncertainty of a common factor of all torques to estimates, by name.

    ``scale_sd``: relative standard deviation of the factor, zero if it is known.
    """
    return {
        name: replace(estimate, sd=math.hypot(estimate.sd, scale_sd * estimate.value))
        if units[name].startswith(TORQUES)
        else estimate
        for name, estimate in estimates.items()
    }


DRAWS = 1000
"""Number of posterior draws: a standard deviation is exact to 2 %."""

EXCESS = 3.4
"""Residual over the noise floor up to which it is taken for noise. Slow noise and drift exceed the
floor, and nothing tells them from a missing effect. With 2.5 samples in a period of the cut-off,
this is 4 times the prediction error from the past samples, where white noise has 1.16 times that.
Denser samples do not change it."""

CLOSED = 0.9
"""Share of the disagreement that may remain after naming, if it is far above the noise."""

MOST_EFFECTS = 6
"""Default of the largest number of effects that are named."""

NONE = 1e-6
"""Size relative to the usual one below which an effect counts as absent."""

ROUNDS = 3
"""Number of rounds of search, noise and finer shapes."""

ROUNDING = 1e-6
"""Smallest noise, relative to the residual of the base. A simulation without noise would otherwise
be explained to the last digit, and evidence would come from rounding errors."""

COLLINEAR = 0.9999
"""Cosine between the signals of two candidates beyond which they differ by less than 1 %."""

_RIDGE_ROUNDS = 4
_TINY = float(np.finfo(float).tiny)


AnyView = TypeVar("AnyView", bound="View")


class View(ABC):
    """Recordings and a bench as an affine model around a fit."""

    @property
    @abstractmethod
    def rows(self) -> Rows:
        """Rows that are compared."""

    @property
    @abstractmethod
    def model(self) -> AffineModel:
        """Model at the present fit."""

    def prepared(self) -> Self:
        """The view at a first fit."""
        return self

    @abstractmethod
    def refined(self, inference: Inference) -> Self:
        """The view at the fit that an inference gives, with finer shapes."""

    def settled(self, labels: Sequence[str]) -> Self:
        """The view at the fit with exactly these candidates; the same if it is linear."""
        return self

    def augmented(
        self, named: Mapping[str, Mapping[str, float]], answer: Diagnosis
    ) -> Bench | None:
        """The bench with everything named and learned, if a bench file can hold it."""
        return None

    def reportable(self, inference: Inference, label: str) -> bool:
        """Whether a named candidate says something about the joint."""
        return True

    @property
    def silent(self) -> Sequence[str]:
        """Candidates that are fitted even if they are not reportable."""
        return ()

    def remarks(self, inference: Inference) -> Iterator[str]:
        """Notes on what an inference finds that is in no catalogue."""
        yield from ()

    def rivals(
        self, errors: Sequence[ParameterError], estimates: Mapping[str, Estimate]
    ) -> tuple[str, ...]:
        """What may be wrong instead of all these parameters; ``estimates``: all fitted ones."""
        return ()


@dataclass(frozen=True, slots=True, eq=False)
class Coefficients:
    """Nuisances, (d,); sizes of terms in catalogue units, and of discrepancy groups, by index."""

    nuisances: FloatArray
    sizes: Mapping[int, FloatArray] = field(default_factory=dict)
    discrepancy: Mapping[int, FloatArray] = field(default_factory=dict)


class Inference:
    """Posterior of one affine model.

    Attributes
    ----------
    noises
        Noise of each used piece.
    sizes
        Unit in which each used sample counts, in the channel's unit, (N,). All shown pieces share
        one, and so do the others: the noise at its strongest frequency, and more where the residual
        is larger than on average. Then p'Σp ≤ s² p'p for every prediction p, and no evidence is
        overstated. Whitened, or each with its own noise, recordings would be fitted where their
        noise is smallest: on a real joint, where the bench happens to be best.
    posterior
        Posterior over sets of candidates.
    """

    def __init__(self, model: AffineModel, noises: Sequence[ResidualNoise] | None = None) -> None:
        self.model, rows = model, model.rows
        used = rows.used
        self._target = (rows.measured - model.base)[used]
        self._nuisances = model.jacobian[used]
        pieces = [piece for piece in rows.pieces if piece.use == "used"]
        lengths = [piece.kept(piece.time_s).size for piece in pieces]
        self._ends = np.cumsum(lengths)[:-1]
        terms = list(self._terms())
        discrepancies = [d.columns for d in model.discrepancies]
        self._discrepancy = np.hstack([np.zeros((rows.measured.size, 0)), *discrepancies])[used]
        ends = np.cumsum([0, *(columns.shape[1] for columns in discrepancies)]).tolist()
        self.groups = [slice(*pair) for pair in pairwise(ends)]
        noises = noises or model.noises
        if noises is None:
            selected = [term.columns for term in terms if not term.always]
            noises = self._noise_beside_everything(selected)
        self.noises = tuple(noises)
        shown = [piece.shown for piece in pieces]
        pairs = list(zip(self.noises, shown, strict=True))
        strongest = {
            kind: max(self._rounding, *(noise.strongest for noise, s in pairs if s == kind))
            for kind in set(shown)
        }
        self._shown_size = strongest[True]
        even = np.repeat([strongest[kind] for kind in shown], lengths)
        self.sizes = np.maximum(np.concatenate([noise.local for noise in self.noises]), even)
        self._burst = self.sizes / even
        self._search(terms)

    def _terms(self) -> Iterator[Term]:
        """A term for each form of a candidate that the recordings show, in the channel's unit."""
        for candidate in self.model.candidates:
            for look in candidate.looks:
                block = self.model.columns(candidate, look)[self.model.rows.used]
                parts = np.split(block, self._ends)
                size = np.sqrt(np.max([(part**2).mean(axis=0) for part in parts], axis=0))
                if not size.any():
                    continue
                usual = candidate.usual * self._level / np.where(size > 0.0, size, 1.0)
                usual = np.minimum(usual, candidate.largest)
                unit = np.where(size > 0.0, usual if look.size is None else look.size, 0.0)
                yield Term(
                    candidate.label,
                    block * unit,
                    candidate.not_negative and unit.size == 1,
                    prior_weight=look.weight,
                    excludes=candidate.excludes,
                    requires=candidate.requires,
                    unit=unit,
                    source=(candidate, look),
                )
        for form in (d for d in self.model.discrepancies if d.is_form):
            columns, rows = form.columns, self.model.rows
            size = math.sqrt(float((columns[rows.shown] ** 2).mean(axis=0).sum())) or 1.0
            size = FORM_SHARE * math.hypot(self._level, form.own) / size
            columns, unit = columns[rows.used], np.full(columns.shape[1], size)
            yield Term(form.kind, columns * unit, always=True, unit=unit, source=form)

    @cached_property
    def _rounding(self) -> float:
        """Smallest noise."""
        model, shown = self.model, self.model.rows.shown
        residual = (model.rows.measured - model.base)[shown]
        return ROUNDING * (math.sqrt(float(np.mean(residual**2))) or 1.0)

    @cached_property
    def _level(self) -> float:
        """Root mean square of the shown pieces, without base and nuisances."""
        model = self.model
        residual = model.rows.measured - model.base - model.jacobian @ model.by_nuisances
        return max(math.sqrt(float(np.mean(residual[model.rows.shown] ** 2))), self._rounding)

    def _noise_beside_everything(self, blocks: list[FloatArray]) -> list[ResidualNoise]:
        """Noise of each used piece: the residual of a ridge regression on everything."""
        level = self._level
        n, h, target = self._nuisances, self._discrepancy, self._target
        scale = np.sqrt((n**2).mean(axis=0))
        rms = np.sqrt((h**2).mean(axis=0).max(initial=0.0))
        h = h * (0.3 * level / rms if rms > 0.0 else 0.0)
        matrix = np.hstack([n / np.where(scale > 0.0, scale, 1.0), *blocks, h])
        gram, right = matrix.T @ matrix, matrix.T @ target
        ridge = np.concatenate([np.full(n.shape[1], 1e-12), np.ones(matrix.shape[1] - n.shape[1])])
        variance = (0.1 * level) ** 2
        for _ in range(_RIDGE_ROUNDS):
            inverse = np.linalg.pinv(gram + np.diag(variance * ridge), 1e-13, True)
            residual = target - matrix @ (inverse @ right)
            freedom = max(target.size - float(np.sum(inverse * gram)), 0.1 * target.size)
            variance = float(residual @ residual) / freedom
        return [ResidualNoise.of(part) for part in np.split(residual, self._ends)]

    def _search(self, terms: list[Term]) -> None:
        def scaled(rows: FloatArray) -> FloatArray:
            return np.asarray((rows.T / self.sizes).T)

        model = self.model
        hypotheses = len({term.hypothesis for term in terms if not term.always})
        another = EXPECTED_HYPOTHESES / max(1, hypotheses)
        for k, term in enumerate(terms):
            weight = term.prior_weight
            # A law that contains another one is that law plus a departure: two hypotheses.
            if term.excludes and term.source[0].kind == "effect":
                weight *= another
            terms[k] = replace(term, columns=scaled(term.columns), prior_weight=weight)
        usual = FORM_SHARE * self._level / self._shown_size
        groups = [
            DiscrepancyGroup(d.kind, columns, usual)
            for d, columns in zip(model.discrepancies, self.groups, strict=True)
        ]
        sds = np.array([model.nuisance_sds.get(n, math.inf) for n in model.names], dtype=float)
        linearised = Linearised(
            scaled(self._target),
            scaled(self._nuisances),
            np.diag(sds**-2.0),
            np.zeros(sds.size),
            terms,
            scaled(self._discrepancy),
            groups,
            model.bands,
        )
        priors = {c.label: c.probability for c in model.candidates if c.probability is not None}
        self.posterior = search(linearised, model.most_terms, priors)

    @cached_property
    def draws(self) -> Draws:
        """Draws of the posterior."""
        return self.posterior.draw(np.random.default_rng(0), DRAWS)

    @property
    def terms(self) -> Sequence[Term]:
        """Terms of the posterior; the source of each is (candidate, look)."""
        return self.posterior.linearised.terms

    @cached_property
    def labels(self) -> Mapping[str, Candidate]:
        """Candidates that the recordings show, by label."""
        return {term.hypothesis: term.source[0] for term in self.terms if not term.always}

    @cached_property
    def sure(self) -> tuple[tuple[str, ...], ...]:
        """Named candidates and confounded groups; the members in the catalogue's order."""
        sure = self.posterior.sure
        return tuple(tuple(n for n in self.labels if n in members) for members in sure)

    def lookalikes(self, label: str) -> list[str]:
        """Candidates whose signals differ from those of one only by nuisances."""
        view = self.posterior.linearised
        terms = [t for t in view.terms if t.columns.shape[1] == 1 and not t.always]
        scale = np.maximum(np.abs(view.jacobian).max(axis=0), _TINY)
        basis, _ = np.linalg.qr(view.jacobian / scale)
        columns = np.hstack([np.zeros((len(basis), 0)), *(term.columns for term in terms)])
        rest = columns - basis @ (basis.T @ columns)
        rest /= np.maximum(np.linalg.norm(rest, axis=0), _TINY)
        is_label = np.array([term.hypothesis == label for term in terms], dtype=bool)
        alike = np.any(np.abs(rest[:, is_label].T @ rest) > COLLINEAR, axis=0) & ~is_label
        return [terms[k].hypothesis for k in np.flatnonzero(alike)]

    def values(self, label: str) -> dict[str, Estimate]:
        """Linear parameters and shapes of a candidate, averaged over the models that have it."""
        candidate = self.labels[label]
        parts: dict[str, list[tuple[FloatArray, FloatArray, FloatArray]]] = {}
        for k, term in enumerate(self.terms):
            if term.hypothesis != label or k not in self.posterior.sizes:
                continue
            weight, mean, covariance = self.posterior.sizes[k]
            mean = mean * term.unit
            covariance = covariance * np.outer(term.unit, term.unit)
            if candidate.is_wave:
                values = _of_waves(candidate, mean, covariance)
            else:
                values = {
                    name: (mean[:, at], covariance[:, at, at])
                    for at, name in enumerate(candidate.parameters)
                }
            for name, shape in term.source[1].shapes.items():
                values[name] = (np.full(weight.size, shape), np.zeros(weight.size))
            for name, (value, variance) in values.items():
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
            if name == candidate.parameters[0]:
                spread += self.between_recordings(label)
            estimates[name] = Estimate(middle, math.sqrt(spread))
        return estimates

    def between_recordings(self, label: str) -> float:
        """Variance of a mean size, of a candidate or parameter that differs between the recordings.

        Σ c²/(R (R − 1)), with the departures c of R recordings from their mean.
        """
        discrepancies = zip(self.model.discrepancies, self.groups, strict=True)
        groups = [group for discrepancy, group in discrepancies if discrepancy.of == label]
        draws = np.hstack([np.zeros((DRAWS, 0)), *(self.draws.discrepancy[:, g] for g in groups)])
        recordings = len(self.model.rows.recordings)
        apart = draws - draws.mean(axis=1, keepdims=True) if groups else draws
        return float(np.sum(apart**2)) / DRAWS / max(1, recordings * (recordings - 1))

    def change(self, name: str) -> Estimate:
        """Change of a parameter: the sum of its nuisance and its candidate, if it has them."""
        draws = np.zeros(DRAWS)
        if name in self.model.names:
            draws = draws + self.draws.fitted[:, self.model.names.index(name)]
        ends = np.cumsum([term.columns.shape[1] for term in self.terms]).tolist()
        for term, end in zip(self.terms, ends, strict=True):
            if term.hypothesis == name:
                draws = draws + self.draws.sizes[:, end - 1] * float(np.ravel(term.unit)[0])
        variance = float(draws.var()) + self.between_recordings(name)
        return Estimate(float(draws.mean()), math.sqrt(variance))

    def always(self, k: int) -> FloatArray:
        """Draws of the sizes of a term that is always included, (n, p)."""
        first = sum(term.columns.shape[1] for term in self.terms[:k])
        width = self.terms[k].columns.shape[1]
        return self.draws.sizes[:, first : first + width] * self.terms[k].unit

    @property
    def average(self) -> Coefficients:
        """Posterior mean of everything."""
        sizes = {
            k: weight @ mean * self.terms[k].unit
            for k, (weight, mean, _) in self.posterior.sizes.items()
        }
        always = {k: self.always(k).mean(axis=0) for k, t in enumerate(self.terms) if t.always}
        sizes |= always
        return Coefficients(
            self.draws.fitted.mean(axis=0),
            sizes,
            {
                g: self.draws.discrepancy[:, group].mean(axis=0)
                for g, group in enumerate(self.groups)
            },
        )

    def projection(self, labels: Sequence[str], groups: Sequence[int] = ()) -> Coefficients:
        """Least-squares fit of some candidates and discrepancy groups, and nothing else.

        Names and discrepancy are separable only if the names take all that they can: the
        discrepancy is the remainder, orthogonal to them (Plumlee 2017, JASA 112, 1274). All samples
        count alike, because the bench also has to predict where it is worst.
        """
        view, free = self.posterior.linearised, math.inf
        chosen = [self.posterior.likeliest(label) for label in labels]
        # A cable is a law that no catalogue has; a departure of form is none.
        chosen += [k for k, t in enumerate(view.terms) if t.always and t.source.series is None]
        terms = [view.terms[k] for k in chosen]
        learned = [view.discrepancy[:, self.groups[g]] for g in groups]
        blocks = [view.jacobian, *(term.columns for term in terms), *learned]
        widths = [block.shape[1] for block in blocks]
        lowest = [-free, *(0.0 if t.positive else -free for t in terms), *(-free for _ in groups)]
        nuisance_sds = [self.model.nuisance_sds.get(n, free) for n in self.model.names]
        block_sds = [1.0 if term.always else free for term in terms]
        block_sds += [self.posterior.discrepancy_sd(g) for g in groups]
        sds = np.concatenate([nuisance_sds, np.repeat(block_sds, widths[1:])])
        prior = np.diag(1.0 / np.maximum(sds, 1e-300))[np.isfinite(sds)]
        values = bounded_least_squares(
            np.vstack([(np.hstack(blocks).T * self._burst).T, prior]),
            np.concatenate([view.residual * self._burst, np.zeros(len(prior))]),
            np.repeat(lowest, widths),
        )
        nuisances, *parts = np.split(values, np.cumsum(widths)[:-1])
        sizes = {k: part * self.terms[k].unit for k, part in zip(chosen, parts, strict=False)}
        return Coefficients(nuisances, sizes, dict(zip(groups, parts[len(chosen) :], strict=True)))

    def of_projection(self, fitted: Coefficients, label: str) -> dict[str, float]:
        """Linear parameters of a candidate in a projection."""
        candidate = self.labels[label]
        size = fitted.sizes[self.posterior.likeliest(label)]
        if not candidate.is_wave:
            return dict(zip(candidate.parameters, size.tolist(), strict=True))
        waves = _of_waves(candidate, size[None], np.zeros((1, size.size, size.size)))
        return {name: float(value[0]) for name, (value, _) in waves.items()}

    def is_none(self, fitted: Coefficients, label: str) -> bool:
        """Whether a projection leaves nothing of a candidate whose sign is known."""
        index = self.posterior.likeliest(label)
        term = self.terms[index]
        return term.positive and bool(fitted.sizes[index] <= NONE * term.unit)

    def predicted(self, coefficients: Coefficients) -> FloatArray:
        """Prediction of every row, (N,).

        Nuisances and phases that belong to a held-out recording are fitted to it.
        """
        model, rows = self.model, self.model.rows
        total = model.base + model.jacobian @ coefficients.nuisances
        waves: list[tuple[float, FloatArray]] = []
        for k, size in coefficients.sizes.items():
            if self.terms[k].always:
                total = total + self.terms[k].source.columns @ size
                continue
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
        """Posterior mean of the discrepancy and of departures from the laws' forms, (N,)."""
        average, total = self.average, np.zeros(self.model.base.size)
        for g, size in average.discrepancy.items():
            total += self.model.discrepancies[g].columns @ size
        for k, term in enumerate(self.terms):
            if term.always:
                total += term.source.columns @ average.sizes[k]
        return total

    def residual_noise(self) -> Sequence[ResidualNoise]:
        """Noise of each used piece, from the residual of the posterior mean, if it is not known."""
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
        """Probability that one of some candidates holds, by their labels or effects."""
        wanted = set(names)
        labels = (label for label, c in self.labels.items() if {label, c.name} & wanted)
        return self.posterior.probability(labels)

    def power(self, label: str) -> float:
        """χ² of the mean signal of a candidate."""
        signal = np.zeros(self.posterior.linearised.residual.size)
        for k, term in enumerate(self.terms):
            if term.hypothesis == label and k in self.posterior.sizes:
                weight, mean, _ = self.posterior.sizes[k]
                signal += term.columns @ (weight @ mean)
        return float(signal @ signal)


def _of_waves(
    candidate: Candidate, mean: FloatArray, covariance: FloatArray
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Mean amplitude of all pairs of sine and cosine, and a common phase, with variances, (m,)."""
    pairs = mean.reshape(len(mean), -1, 2)
    size = np.maximum(np.hypot(pairs[..., 0], pairs[..., 1]), _TINY)
    along = (pairs / size[..., None] / size.shape[1]).reshape(mean.shape)
    variance = np.einsum("mi,mij,mj->m", along, covariance, along)
    values = {candidate.parameters[0]: (size.mean(axis=1), variance)}
    if not candidate.own_phase:
        across = np.stack([-pairs[:, 0, 1], pairs[:, 0, 0]], axis=1) / size**2
        variance = np.einsum("mi,mij,mj->m", across, covariance, across)
        values[PHASE] = (np.arctan2(pairs[:, 0, 1], pairs[:, 0, 0]), variance)
    return values


def inferred(
    view: AnyView, progress: StageProgress | None = None, rounds: int = ROUNDS
) -> tuple[AnyView, Inference]:
    """Refine a view in some rounds, each at the fit of the previous inference."""
    inference = Inference(view.model)
    for done in range(1, rounds):
        if progress is not None:
            progress("Comparing sets of effects", done, rounds)
        noises = inference.residual_noise()
        view = view.refined(inference)
        inference = Inference(view.model, noises)
    return view, inference


SCALED = (
    "Instead of a wrong value of the bench, all recorded torques may be off by one factor: their "
    "unit, the torque constant, or a peak instead of an effective current. Then all torques found "
    "are off by it too. A known load tells them apart."
)


def diagnose(
    view: View,
    bench: Bench,
    *,
    most: int,
    notes: Sequence[str] = (),
    scale_sd: float = 0.0,
    progress: StageProgress | None = None,
) -> Diagnosis:
    """Name what is missing, with the disagreement before and after.

    ``view``: not yet prepared; ``bench``: the bench as believed, with tolerances of fitted
    parameters; ``most``: largest number of effects to name, the strongest; ``scale_sd``: relative
    standard deviation of a common factor of all torques and inertias.
    """
    view, inference = inferred(view.prepared(), progress)
    named, remaining = _named(view, inference, most)
    groups = _learned_groups(inference)
    silent = {label for label, _ in named if not view.reportable(inference, label)}
    view, at = view.settled([label for label, _ in named]), inference
    if view.model is not inference.model:
        at = Inference(view.model, inference.noises)
    named, fitted = _fitted(at, named, groups)
    learned = next(filter(None, (learned_answer(at, fitted, group) for group in groups)), None)
    kinds = {label: inference.labels[label].kind for label, _ in named}
    estimates = {
        name: Estimate(bench.value(name) + value, at.change(name).rms_about(value))
        for name, value in zip(at.model.names, fitted.nuisances, strict=True)
        if name in PARAMETER_INFO
    }
    for label in (label for label, kind in kinds.items() if kind == "parameter"):
        (value,) = at.of_projection(fitted, label).values()
        sd = at.values(label)[label].rms_about(value)
        estimates[label] = Estimate(bench.value(label) + value, sd)
    after, before = at.predicted(fitted), at.model.without
    if before is None:
        before = at.predicted(Coefficients(at.model.by_nuisances))
    denied = tuple(impossible(estimates))
    if not denied:
        positive = {name for name in estimates if PARAMETER_INFO[name].positive}
        estimates |= {name: estimates[name].given_positive() for name in positive}
    if denied:
        remaining = []
    pieces = compared_pieces(at.model.rows, before, after)
    disagreement = disagreement_table(pieces)["over_all"]["used"]
    # A fit that stays far from the recordings names effects by accident.
    least = max(CLOSED * disagreement["before"], EXCESS * disagreement["noise_floor"])
    if denied or disagreement["after"] >= least:
        named, estimates, learned = [], {}, None
        pieces = compared_pieces(at.model.rows, before, before)
        disagreement = disagreement_table(pieces)["over_all"]["used"]
    units = {name: PARAMETER_INFO[name].unit for name in estimates}
    estimates = with_shared_scale(estimates, units, scale_sd)
    effects = [
        _effect(at, label, fitted, alike, inference.probability((label, *alike)), scale_sd)
        for label, alike in named
        if kinds[label] == "effect" and label not in silent
    ]
    errors = tuple(parameter_errors(bench, estimates))
    rivals = view.rivals(errors, estimates)
    # A factor leaves zero as it is.
    errors = tuple(replace(e, indistinguishable_from=rivals if e.believed else ()) for e in errors)
    lines = tuple(_line(inference, *item) for item in remaining)
    over_noise = disagreement["after"] / max(
        disagreement["noise_floor"], ROUNDING * disagreement["before"], _TINY
    )
    is_much = over_noise > EXCESS
    remains = bool(lines or denied or groups or "gravity" in kinds.values()) or is_much
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
        (
            *denied,
            *([SCALED] if rivals else []),
            *notes,
            *view.remarks(inference),
            *_differences(inference, groups),
        ),
        bench_parameters=estimates,
        learned=learned,
    )
    if learned is None:
        return answer
    sizes = {e.name: {k: v.value for k, v in e.parameters.items()} for e in effects}
    return replace(answer, augmented_bench=view.augmented(sizes, answer))


def _differences(inference: Inference, groups: Sequence[int]) -> Iterator[str]:
    """Notes on sizes that differ between the recordings."""
    recordings = len(inference.model.rows.recordings)
    for name in filter(None, (inference.model.discrepancies[group].of for group in groups)):
        sd = math.sqrt(recordings * inference.between_recordings(name))
        info = PARAMETER_INFO.get(name) or effect_named(name).parameters[0]
        yield (
            f"{name} differs between the recordings, with a standard deviation of {sd:.2g} "
            f"{info.unit}; what is stated is the mean. Recordings with one payload and temperature "
            "show it better."
        )


def _named(
    view: View, inference: Inference, most: int
) -> tuple[list[tuple[str, tuple[str, ...]]], list[tuple[str, What]]]:
    """Labels to name, each with the names it is confounded with; and lines that remain."""
    labels = inference.labels
    named: list[tuple[str, tuple[str, ...]]] = []
    remaining: list[tuple[str, What]] = []
    waves: list[str] = []
    for members in inference.sure:
        in_time = [m for m in members if labels[m].kind == "line"]
        ripple = [m for m in members if labels[m].kind == "effect" and ORDER in labels[m].shapes]
        if in_time:
            remaining.append((ripple[0], "angle or time") if ripple else (in_time[0], "time"))
        elif ripple and len(ripple) == len(members):
            waves.append(ripple[0])
        elif all(m in view.silent or view.reportable(inference, m) for m in members):
            first, *others = members
            names = dict.fromkeys(labels[m].name for m in (*others, *inference.lookalikes(first)))
            named.append((first, tuple(n for n in names if n != labels[first].name)))
    waves.sort(key=lambda m: -inference.power(m))
    named += [(m, ()) for m in waves[:1]]
    remaining += [(m, "motor angle") for m in waves[1:]]
    named.sort(key=lambda pair: -inference.power(pair[0]))
    too_many = [p for p in named if labels[p[0]].kind == "effect"][most:]
    return [p for p in named if p not in too_many], remaining


def _fitted(
    inference: Inference, named: list[tuple[str, tuple[str, ...]]], groups: Sequence[int]
) -> tuple[list[tuple[str, tuple[str, ...]]], Coefficients]:
    """Projection on what is named, without names that vanish there or require one that does."""
    while True:
        fitted = inference.projection([label for label, _ in named], groups)
        none = {label for label, _ in named if inference.is_none(fitted, label)}
        none |= {label for label, _ in named if inference.labels[label].requires & none}
        if not none:
            return named, fitted
        named = [pair for pair in named if pair[0] not in none]


def _learned_groups(inference: Inference) -> list[int]:
    """Discrepancy groups to report: almost certain, with a fair share of the excess χ², the largest
    first."""
    posterior, shares = inference.posterior, dict[int, float]()
    for group, columns in enumerate(inference.groups):
        present = (m.log_posterior for m in posterior.models if m.scales[group] > 0.0)
        if sum(map(math.exp, present)) >= NAMED_AT:
            mean = inference.draws.discrepancy[:, columns].mean(axis=0)
            signal = posterior.linearised.discrepancy[:, columns] @ mean
            share = float(signal @ signal) / max(posterior.excess_chi_square, 1.0)
            if share > LEARNED_SHARE:
                shares[group] = share
    return sorted(shares, key=lambda group: -shares[group])


def _effect(
    inference: Inference,
    label: str,
    fitted: Coefficients,
    alike: tuple[str, ...],
    probability: float,
    scale_sd: float,
) -> NamedEffect:
    candidate = inference.labels[label]
    parameters = inference.values(label)
    for name, value in inference.of_projection(fitted, label).items():
        known = parameters[name]
        # Lines beside that of a ripple are its sidebands, and share its size.
        sd = known.sd if candidate.is_wave else known.rms_about(value)
        parameters[name] = Estimate(value, sd)
    size = parameters[candidate.parameters[0]]
    z = abs(size.value) / max(size.sd, _TINY)
    units = {p.name: p.unit for p in effect_named(candidate.name).parameters}
    parameters = with_shared_scale(parameters, units, scale_sd)
    return NamedEffect(candidate.name, parameters, probability, z, (*candidate.same_as, *alike))


def _line(inference: Inference, label: str, dependence: What) -> Unexplained:
    """A wave that is reported but not named."""
    candidate = inference.labels[label]
    values = inference.values(label)
    order = values[ORDER].value if ORDER in values and dependence != "time" else math.nan
    hertz = values["frequency_hz"].value if "frequency_hz" in values else math.nan
    rows = inference.model.rows
    channel = rows.pieces[0].channel
    if dependence == "angle or time":
        lines = [m for m, c in inference.labels.items() if c.kind == "line"]
        best = max(lines, key=lambda m: inference.posterior.inclusion[m])
        hertz = inference.labels[best].shapes["frequency_hz"]
    return Unexplained(
        channel,
        dependence,
        values[candidate.parameters[0]].value,
        unit_of(channel),
        order,
        order,
        hertz if dependence != "motor angle" else math.nan,
        rows.recordings,
        inference.power(label),
    )


def compared_pieces(rows: Rows, before: FloatArray, after: FloatArray) -> tuple[ComparedPiece, ...]:
    """The shown pieces with their predictions before and after naming, (N,) each."""
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
    """A discrepancy group as a torque over its variable; ``None`` if it is no torque."""
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
