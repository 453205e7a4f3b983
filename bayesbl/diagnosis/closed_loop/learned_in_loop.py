"""Learn a torque without a known law, or an encoder error, from the residual of a simulation.

Each is a Fourier series over one variable with normal coefficients that fall as 1/k. Such a series
is a hypothesis like all others (:mod:`bayesbl.model_search.closed_loop`): linearised at the fit of
an explanation, then, if probable, fitted in full.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bayesbl.bench.kernel import LEARNED_HARMONICS
from bayesbl.bench.learned import ENCODER, LearnedTerm, Side, Variable, waves_over
from bayesbl.bench.steady import ringing_hz
from bayesbl.diagnosis.closed_loop.prediction import learned_terms
from bayesbl.diagnosis.diagnosis import CURVE_POINTS, LearnedAnswer
from bayesbl.errors import BenchError
from bayesbl.matching.alignment import aligned_starts, with_shifts
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated
from bayesbl.matching.observed import Observed
from bayesbl.matching.signals import SimulatedSignals, Unknown
from bayesbl.model_search.closed_loop import CONTENDERS, linearised, noise_in_loop, weighed
from bayesbl.model_search.constants import EXPECTED_HYPOTHESES, NAMED_AT, UNEXPLAINED_SHARE
from bayesbl.model_search.linear import Term, search
from bayesbl.model_search.refit import Explanation, chi_square, with_own_noise
from bayesbl.model_search.residuals import Unexplained, What, with_shares
from bayesbl.recording.types import FloatArray
from bayesbl.units import RPM_PER_RAD_PER_S

ORDERS = (1, 2, 3, 4, 6, 8, LEARNED_HARMONICS)
"""Numbers of orders to try."""

LONGEST_PERIOD = 5.0
"""Longest period in motor turns; a longer one belongs to the load or to time."""

MOST_BASES = 3

WHOLE = 0.02
"""Relative difference of orders that count as the same."""

SAME_ORDER = 2e-3
"""Relative difference of lines of two channels that count as one."""

PLACES = 16
"""Shifts to try in a period of the highest order."""


@dataclass(frozen=True, slots=True)
class Series:
    """A Fourier series that may act on one side, over one variable.

    ``own_zero``: whether each recording has its own zero of the variable. ``size``: usual size of
    order 1, N m or rad.
    """

    side: Side | Literal["encoder"]
    variable: Variable
    period: float
    reverses: bool = False
    own_zero: bool = False
    orders: int = LEARNED_HARMONICS
    size: float = 0.0

    def term(self, coefficients: FloatArray) -> LearnedTerm:
        """Term with these coefficients: constant (not of an encoder), cosines, sines."""
        constant, *waves = map(float, coefficients)
        cosine, sine = tuple(waves[: self.orders]), tuple(waves[self.orders :])
        constant = 0.0 if self.side == ENCODER else constant
        return LearnedTerm(
            self.side, self.variable, self.period, constant, cosine, sine, self.reverses
        )

    @property
    def nothing(self) -> LearnedTerm:
        """Term of size zero."""
        return self.term(np.zeros(2 * self.orders + 1))

    @property
    def free(self) -> list[int]:
        """Indices of the fitted coefficients: with its own zero, a constant would be an offset."""
        without_constant = self.own_zero or self.side == ENCODER
        return list(range(int(without_constant), 2 * self.orders + 1))

    @property
    def usual(self) -> FloatArray:
        """Usual size of each coefficient, (2 orders + 1,)."""
        falling = self.size / np.arange(1, 1 + self.orders)
        return np.concatenate([[self.size], falling, falling])


@dataclass(frozen=True, slots=True)
class Learned:
    """A learned term, fitted jointly with everything else.

    ``explanation``: explanation with the coefficients among its unknowns; ``block``:
    ``learned_torque`` or ``encoder_error``; ``alike``: other terms that the recordings do not
    distinguish from it.
    """

    explanation: Explanation
    block: str
    alike: tuple[LearnedTerm, ...]

    @property
    def term(self) -> LearnedTerm:
        """The term as fitted, with standard deviations."""
        terms = learned_terms(self.explanation.fit)
        return next(term for term in terms if term.block == self.block)

    @property
    def reaches_ringing(self) -> bool:
        """Whether its load orders reach the ringing frequency, so that it may imitate impacts."""
        term, model = self.term, self.explanation.fit.model
        if term.variable != "load_angle":
            return False
        fastest = max(1.0 / observation.rotation_period_s for observation in model.recordings)
        return term.orders * fastest >= ringing_hz(model.bench.vector())


def learned_term(
    base: Explanation,
    around: Sequence[tuple[Explanation, Sequence[Unexplained]]],
    motor_angle_known: bool,
) -> Learned | None:
    """The almost certain series that an explanation lacks; ``None`` without one.

    ``around``: explanations at which series are linearised, each with its remaining lines, which
    propose motor orders and frequencies.
    """
    fit, noise = base.fit, noise_in_loop(base.fit)
    known = {term.block for term in fit.model.bench.learned_terms}
    without = weighed(base, noise=noise).log_evidence
    fitted: list[tuple[float, Learned]] = []
    for near, remaining in around:
        possible = [
            replace(series, orders=_shown(fit.model, series), size=_typical_size(near.fit, series))
            for series in _series(remaining, motor_angle_known)
            if series.nothing.block not in known
        ]
        odds = math.log(EXPECTED_HYPOTHESES / max(1, len(possible)))
        for series, sizes in _promised(near.with_derivatives(), possible):
            with suppress(BenchError):
                extended = _fitted(base, series, sizes)
                gain = weighed(extended, noise=noise).log_evidence - without
                fitted.append((gain + odds, Learned(extended, series.nothing.block, ())))
    fitted.sort(key=lambda pair: -pair[0])
    if not fitted or fitted[0][0] < -math.log1p(-NAMED_AT):
        return None
    (most, best), *others = fitted
    least = most + math.log(1.0 - NAMED_AT)
    alike = {_dependence(other.term): other.term for e, other in others if e > least}
    alike.pop(_dependence(best.term), None)
    explanation = with_own_noise(best.explanation)
    return replace(best, explanation=explanation, alike=tuple(alike.values()))


def _dependence(term: LearnedTerm) -> tuple[str, str, bool]:
    return term.side, term.variable, term.reverses


def _promised(near: Explanation, possible: Sequence[Series]) -> list[tuple[Series, FloatArray]]:
    """The most probable series in the linearisation at a fit, with their coefficients."""
    noise = noise_in_loop(near.fit)
    promises = [p for series in possible if (p := _promise(near, series, noise)) is not None]
    promises.sort(key=lambda promise: -promise[0])
    return [(series, sizes) for _, series, sizes in promises[:CONTENDERS]]


def _series(remaining: Sequence[Unexplained], motor_angle_known: bool) -> Iterator[Series]:
    """All series to try."""
    turn = 2.0 * math.pi
    for side in ("load", "motor"):
        for reverses in (False, True):
            yield Series(side, "load_angle", turn, reverses)
    own = not motor_angle_known
    orders = _bases(remaining, "motor angle", lambda entry: entry.lowest_order)
    for order in orders:
        if order * LONGEST_PERIOD >= 1.0:
            yield Series("motor", "motor_angle", turn / order, False, own)
    whole = [order for order in orders if order == round(order)]
    for order in whole[:1]:
        yield Series("encoder", "motor_angle", turn / order, False, own)
    for frequency in _bases(remaining, "time", lambda entry: entry.frequency_hz):
        yield Series("motor", "time", 1.0 / frequency, False, True)


def _shown(model: SimulatedSignals, series: Series) -> int:
    """Number of orders below half the sampling rate of some recording."""

    def base_hz(observation: Observed) -> float:
        if series.variable == "time":
            return 1.0 / series.period
        turns = 1.0 / observation.rotation_period_s
        if series.variable == "motor_angle":
            turns = abs(observation.reference_speed_rpm) / 60.0
        return turns * 2.0 * math.pi / series.period

    most = max(
        0.5 * observation.sampling_hz / base_hz(observation) for observation in model.recordings
    )
    return max(1, min(int(most), LEARNED_HARMONICS))


def _bases(
    remaining: Sequence[Unexplained], dependence: What, value: Callable[[Unexplained], float]
) -> list[float]:
    """A few base orders or frequencies for the remaining lines.

    They are 1 if a line is at a whole order, the smallest distance of two lines, and the strongest
    lines.
    """
    lines: dict[float, float] = {}
    for entry, share in with_shares(remaining):
        if entry.dependence in (dependence, "angle or time") and value(entry) > 0.0:
            line = value(entry)
            if dependence == "motor angle" and abs(line - round(line)) < 0.1 * WHOLE:
                line = float(round(line))
            line = next((x for x in lines if abs(line / x - 1.0) <= SAME_ORDER), line)
            lines[line] = lines.get(line, 0.0) + share
    between = [abs(a - b) for a in lines for b in lines if abs(a - b) > WHOLE]
    is_whole = dependence == "motor angle" and any(line == round(line) for line in lines)
    strongest = sorted(lines, key=lambda line: -lines[line])
    bases: list[float] = []
    for base in [1.0] * is_whole + sorted(between)[:1] + strongest:
        if all(abs(base / other - 1.0) > WHOLE for other in bases):
            bases.append(base)
    return bases[:MOST_BASES]


def _promise(
    near: Explanation, series: Series, noise: Sequence[Sequence[FloatArray]]
) -> tuple[float, Series, FloatArray] | None:
    """ln evidence in the linearisation at a fit, the series with its most probable number of
    orders, and its coefficients, (recordings with an own zero, 2 orders + 1); ``None`` if none is
    probable.
    """
    model, most = near.fit.model, series.orders
    extended = _with(
        model, series, [Unknown(series.nothing.names[k - 1 - 2 * most]) for k in series.free]
    )
    steps = series.usual[series.free]
    moved = np.tile(np.concatenate([near.fit.point, np.zeros(steps.size)]), (steps.size + 1, 1))
    moved[np.arange(steps.size) + 1, np.arange(steps.size) + near.fit.point.size] = steps
    z = extended.whitened(moved)
    changes = z[0] - z[1:]
    if not np.all(np.isfinite(changes)):
        return None
    owners = range(len(model.recordings)) if series.own_zero else [None]
    columns = np.stack([c if o is None else model.only_in(o, c) for o in owners for c in changes])
    variants = [replace(series, orders=n) for n in sorted({min(n, most) for n in ORDERS})]
    terms, place = [], {k: i for i, k in enumerate(series.free)}
    for variant in variants:
        orders = variant.orders
        kept = [place[k if k <= orders else k - orders + most] for k in variant.free]
        rows = np.concatenate([np.array(kept) + i * steps.size for i in range(len(owners))])
        terms.append(Term("learned", columns[rows].T, prior_weight=1.0 / len(variants)))
    posterior = search(linearised(near, terms, noise=noise), 1)
    likeliest = next((terms for terms in posterior.sets if terms), None)
    if likeliest is None:
        return None
    best = variants[likeliest[0]]
    sizes = np.zeros((len(owners), 2 * best.orders + 1))
    ((mean,), _) = posterior.mean_of(likeliest)
    sizes[:, best.free] = mean.reshape(len(owners), -1)
    evidence = posterior.log_evidence + math.log(posterior.sets[likeliest])
    return evidence, best, sizes * best.usual


def _typical_size(fit: SimulatedFit, series: Series) -> float:
    """Size of the series that has the RMS of the residual, N m or rad."""
    model = fit.model
    observation = model.recordings[0]
    residual_rms = np.sqrt(np.mean(fit.unexplained(0) ** 2, axis=1))
    if series.side == "encoder":
        return float(residual_rms[0]) / abs(observation.reference_speed_rpm)
    if len(residual_rms) > 1:
        torque = float(residual_rms[1]) * model.bench.value("torque_constant_nm_per_a")
    else:
        torque = (
            float(residual_rms[0])
            / RPM_PER_RAD_PER_S
            * model.bench.value("speed_gain_nm_s_per_rad")
        )
    return torque * (model.bench.value("gear_ratio") if series.side == "load" else 1.0)


def _with(model: SimulatedSignals, series: Series, unknowns: Sequence[Unknown]) -> SimulatedSignals:
    """The model with a series of size zero, and further unknowns."""
    return model.with_unknowns(model.bench.with_learned(series.nothing), unknowns)


def aligned(sizes: FloatArray, series: Series) -> tuple[FloatArray, list[float]]:
    """Combine the series of r recordings, (r, 2 orders + 1), into one, (2 orders + 1,).

    Also returns its shift in each recording, relative to the first.
    """
    n = series.orders
    waves = sizes[:, 1 : n + 1] - 1j * sizes[:, n + 1 :]
    turns = np.arange(n * PLACES) / (n * PLACES)
    tried = np.exp(2j * math.pi * np.outer(turns, np.arange(1, n + 1)))
    strongest = waves[np.argmax(np.abs(waves).max(axis=1))]
    places = [int(np.argmax((tried.conj() @ (wave * strongest.conj())).real)) for wave in waves]
    mean = np.mean([wave * tried[k].conj() for wave, k in zip(waves, places, strict=True)], axis=0)
    mean = mean * tried[places[0]]
    shifts = [series.period * float(turns[k] - turns[places[0]]) for k in places]
    return np.concatenate([sizes[:1, 0], mean.real, -mean.imag]), shifts


def _fitted(base: Explanation, series: Series, sizes: FloatArray) -> Explanation:
    """Fit of all unknowns with the coefficients of a series."""
    model, names = base.fit.model, series.nothing.names
    name_of = {k: names[k - 1 - 2 * series.orders] for k in series.free}
    together, shifts = aligned(sizes, series) if series.own_zero else (sizes[0], [])
    unknowns = [Unknown(name_of[k], sd=float(series.usual[k])) for k in series.free]
    start = [float(together[k]) for k in series.free]
    period = series.period
    if series.own_zero:
        whole = abs(2.0 * math.pi / period % 1.0) < 1e-6
        if not (series.variable == "motor_angle" and whole):
            half = 0.5 * WHOLE * period
            unknowns.append(Unknown(series.nothing.period_slot, period - half, period + half))
            start.append(period)
        for observation, shift in zip(model.recordings[1:], shifts[1:], strict=True):
            reach = 1.5 * period
            unknowns.append(
                Unknown(series.nothing.shift_slot, -reach, reach, recording=observation.name)
            )
            start.append((shift + 0.5 * period) % period - 0.5 * period)
    extended = _with(model, series, unknowns)
    starts = [np.concatenate([base.fit.point, start])]
    # The missing term may have drawn the gap away, so starts are also aligned with the term.
    for aligned_start in aligned_starts(extended):
        aligned_start[base.fit.point.size :] = start
        starts.append(with_shifts(extended, aligned_start))
    best = min(starts, key=lambda point: chi_square(extended, point))
    return replace(base, fit=fit_simulated(extended, best, base.fit.steps, rough=True))


def sd_over(fit: SimulatedFit, term: LearnedTerm, x: FloatArray) -> FloatArray:
    """Standard deviation of a term at values of its variable, as ``x``."""
    basis = np.hstack([np.ones((x.size, 1)), *waves_over(x, term.period, term.orders)])
    basis = basis[:, -len(term.names) :]  # an encoder has no constant
    places = {u.name: i for i, u in enumerate(fit.model.unknowns) if u.recording is None}
    free = [k for k, name in enumerate(term.names) if name in places]
    at = [places[term.names[k]] for k in free]
    covariance = fit.covariance[np.ix_(at, at)]
    variance = np.einsum("xi,ij,xj->x", basis[:, free], covariance, basis[:, free])
    return np.asarray(np.sqrt(variance))


def answer_of(learned: Learned) -> LearnedAnswer:
    """The learned term over its variable."""
    term = learned.term
    lowest = 0.0 if term.belongs_to_recordings else -0.5 * term.period
    x = lowest + term.period * np.linspace(0.0, 1.0, CURVE_POINTS)
    sd = sd_over(learned.explanation.fit, term, x)
    return LearnedAnswer(term, x, sd, learned.alike)


def why_no_gap(learned: Learned, closed: float, remains: bool) -> str:
    """Reason why the learned term leaves δ undetermined; empty otherwise.

    ``closed``: share of the repeating residual that it removes; ``remains``: whether anything still
    stands out.
    """
    if learned.reaches_ringing:
        return (
            "What was learned repeats with the load at orders that reach the ringing of an "
            "impact: it could be taken for impacts, so no gap is given."
        )
    if remains and closed < (1.0 - UNEXPLAINED_SHARE):
        return (
            f"What was learned removes {100.0 * closed:.0f} % of what repeats; from "
            f"{100.0 * (1.0 - UNEXPLAINED_SHARE):g} % on a gap would be given."
        )
    if len({other.block for other in (learned.term, *learned.alike)}) > 1:
        return (
            "These recordings do not tell an error of the motor's encoder from a torque at the "
            "motor, nor either from a transmission error, which moves the gap: so no gap is given. "
            "Record a second speed, and the other direction."
        )
    if learned.explanation.candidates:
        return (
            "Beside a torque of no known law a name of the catalogue may be wrong and bias the "
            "gap, so no gap is given. Add known effects of the joint to the bench, and diagnose "
            "again."
        )
    return ""
