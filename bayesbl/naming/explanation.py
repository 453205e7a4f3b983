"""Fits of candidate explanations, jointly with everything declared unknown."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesbl.errors import BenchError
from bayesbl.matching.alignment import aligned_starts, remaining_noise
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated, with_model
from bayesbl.matching.loop_noise import factors_along
from bayesbl.matching.signals import GAP, OF_THE_TICKS, SimulatedSignals, Unknown
from bayesbl.naming.candidates import (
    Candidate,
    amplitude_places,
    is_harmonic,
    is_periodic,
    quadrant_phases,
    wrapped,
)
from bayesbl.noise.channel_noise import ChannelNoise
from bayesbl.probabilities import chi2_isf, chi2_sf
from bayesbl.recording.types import FloatArray

SCANNED_GAPS = 10
BEHIND = 2.0
"""What is far from its optimum and leaves this multiple of what the best leaves is not pursued."""


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """The recordings fitted with some candidates added to the nominal comparison.

    Attributes
    ----------
    candidates
        In the order they were added.
    log_evidence
        Laplace approximation, flat priors over the candidates' ranges.
    """

    candidates: tuple[Candidate, ...]
    fit: SimulatedFit

    @property
    def names(self) -> tuple[str, ...]:
        """Labels of what is added."""
        return tuple(c.label for c in self.candidates)

    @property
    def parameters(self) -> int:
        """Number of unknowns."""
        return len(self.fit.model.unknowns)

    @property
    def log_evidence(self) -> float:
        """ln Z up to a constant that all explanations of the same recordings share."""
        fit = self.fit
        d = fit.point.size
        volume = 0.5 * d * math.log(2.0 * math.pi) + 0.5 * float(
            np.linalg.slogdet(fit.covariance)[1]
        )
        width = sum(math.log(_width(u)) for u in fit.model.unknowns)
        return -0.5 * fit.chi_square + volume - width


def nominal_explanation(fit: SimulatedFit) -> Explanation:
    """Nothing added."""
    return Explanation((), fit)


def with_noise(explanation: Explanation, noise: Sequence[ChannelNoise]) -> Explanation:
    """The same explanation, fitted again under another noise."""
    fit = explanation.fit
    model = replace(fit.model, noise=noise)
    return replace(explanation, fit=fit_simulated(model, fit.point, fit.steps))


def with_own_noise(explanation: Explanation) -> Explanation:
    """The same explanation, fitted again under the noise that it leaves itself."""
    return with_noise(explanation, remaining_noise(explanation.fit))


def distance(a: Explanation, b: Explanation) -> float:
    """|z| between the best fits of two explanations: their difference in units of noise."""
    apart = np.linalg.norm(a.fit.residual - b.fit.residual)
    return float(np.hypot(apart, np.linalg.norm(a.fit.deviations - b.fit.deviations)))


def gain_threshold(parameters: int, trials: int, false_alarm: float) -> float:
    """χ² that adding so many parameters must gain, at a false-alarm rate over all trials."""
    return float(chi2_isf(false_alarm / max(trials, 1), max(parameters, 1)))


def gains_more_than_chance(
    base: Explanation, more: Explanation, trials: int, false_alarm: float
) -> bool:
    """Whether χ² falls by more than noise would let it, at a false-alarm rate over all trials.

    Along what the two differ by noise that goes round in the speed loop may have more variance than
    elsewhere, and a gain by chance is larger by that.
    """
    gain, added = base.fit.chi_square - more.fit.chi_square, more.parameters - base.parameters
    if gain <= gain_threshold(added, trials, false_alarm):
        return False
    factors = noise_between(base, more)
    return float(np.mean(chi2_sf(gain / factors, max(added, 1)))) < false_alarm / max(trials, 1)


def noise_between(a: Explanation, b: Explanation) -> FloatArray:
    """Variance of noise along what two explanations differ by, some likely values.

    1 where all of it is the recorder's.
    """
    return factors_along(a.fit, a.fit.residual - b.fit.residual)


def explain(base: Explanation, candidate: Candidate) -> Explanation | None:
    """Fit roughly with one candidate more; ``None`` if its bench cannot be simulated."""
    model = extended(base.fit.model, candidate)
    own = len(base.fit.point)
    starts = [np.concatenate([base.fit.point, candidate.neutral])]
    starts += [np.concatenate([base.fit.point, start]) for start in candidate.starts]
    if is_periodic(candidate):
        starts = [_phased(model, candidate, start) for start in starts]
    elif len(starts) > 1:
        starts = [_nudged(model, start, own) for start in starts]
        starts = sorted(starts, key=lambda s: _chi_square(model, s))[:2]
    return _best(base, candidate, model, starts)


def from_afar(base: Explanation, candidate: Candidate) -> Explanation | None:
    """As :func:`explain`, but from the best places in the candidate's whole range."""
    model = extended(base.fit.model, candidate)
    starts = _scanned_starts(model, base, candidate)
    left = [_chi_square(model, start) for start in starts]
    near = BEHIND * min(left)
    return _best(
        base,
        candidate,
        model,
        [start for start, value in zip(starts, left, strict=True) if value <= near],
    )


def _best(
    base: Explanation,
    candidate: Candidate,
    model: SimulatedSignals,
    starts: Sequence[FloatArray],
) -> Explanation | None:
    """The best of rough fits from several starts; ``None`` if none of them can be simulated."""
    fits = []
    for start in starts:
        with suppress(BenchError):
            fits.append(fit_simulated(model, start, base.fit.steps, rough=True))
    best = min(fits, key=lambda fit: fit.chi_square, default=None)
    return None if best is None else Explanation((*base.candidates, candidate), best)


def last_alone(nominal: Explanation, full: Explanation) -> Explanation:
    """An explanation with all candidates but the last taken away and nothing fitted again."""
    last = full.candidates[-1]
    size = full.fit.point.size
    kept = np.r_[: nominal.fit.point.size, size - len(last.unknowns) : size]
    found = replace(full.fit, point=full.fit.point[kept], steps=full.fit.steps[kept])
    return Explanation((last,), with_model(found, extended(nominal.fit.model, last)))


def refitted(explanation: Explanation) -> Explanation:
    """The same explanation, fitted roughly from where it is."""
    fit = explanation.fit
    return replace(explanation, fit=fit_simulated(fit.model, fit.point, fit.steps, rough=True))


def polished(explanation: Explanation) -> Explanation:
    """The same explanation, fitted to the end."""
    fit = explanation.fit
    return replace(explanation, fit=fit_simulated(fit.model, fit.point, fit.steps))


def reduced(
    nominal: Explanation, full: Explanation, without: Collection[int]
) -> Explanation | None:
    """An explanation less the candidates at these places, fitted again from where it is.

    ``nominal`` where none is left; ``None`` if it cannot be simulated.
    """
    if len(without) == len(full.candidates):
        return nominal
    places, own = [np.arange(nominal.fit.point.size)], nominal.fit.point.size
    kept = []
    for k, candidate in enumerate(full.candidates):
        own += len(candidate.unknowns)
        if k not in without:
            kept.append(candidate)
            places.append(np.arange(own - len(candidate.unknowns), own))
    return _from_where(nominal, full, kept, np.concatenate(places))


def simplified(
    nominal: Explanation, full: Explanation, place: int, simpler: Candidate
) -> Explanation | None:
    """An explanation with a candidate replaced by one that it holds, fitted from where it is.

    Unknowns of both have the same names behind those of their effects. ``None`` if it cannot be
    simulated.
    """
    candidates = (*full.candidates[:place], simpler, *full.candidates[place + 1 :])
    before = nominal.fit.point.size + sum(len(c.unknowns) for c in full.candidates[:place])
    names = [u.name.rpartition("__")[2] for u in full.candidates[place].unknowns]
    kept = [before + names.index(u.name.rpartition("__")[2]) for u in simpler.unknowns]
    after = np.arange(before + len(names), full.fit.point.size)
    return _from_where(nominal, full, candidates, np.r_[:before, kept, after])


def _from_where(
    nominal: Explanation, full: Explanation, kept: Sequence[Candidate], at: NDArray[np.int64]
) -> Explanation | None:
    """An explanation by candidates whose unknowns are these of another, fitted from there."""
    model = nominal.fit.model
    for candidate in kept:
        model = extended(model, candidate)
    try:
        fit = fit_simulated(model, full.fit.point[at], full.fit.steps[at])
    except BenchError:
        return None
    return Explanation(tuple(kept), fit)


def effects_alone(nominal: Explanation, full: Explanation) -> Explanation | None:
    """An explanation by effects and parameters without the latter; ``None`` of any other."""
    parameters = [k for k, c in enumerate(full.candidates) if c.kind == "parameter"]
    if not 0 < len(parameters) < len(full.candidates):
        return None
    return reduced(nominal, full, parameters)


def linear_gains(base: Explanation, candidates: Sequence[Candidate]) -> FloatArray:
    """Drop of χ² that the derivatives at the base promise of each candidate, shape (candidates,).

    However far that extrapolates; 0 of those that are in the base already, and
    of what may be a harmonic of one.
    """
    fit = base.fit
    rows = fit.model.normal_prior.rows
    explained, _ = np.linalg.qr(np.concatenate([fit.derivatives(), rows]))
    residual = np.concatenate([fit.residual, fit.deviations])
    gains = np.zeros(len(candidates))
    for place, candidate in enumerate(candidates):
        if candidate.label not in base.names and not is_harmonic(candidate, base.candidates):
            found = (_gain(explained, residual, c) for c in columns_of(fit, candidate))
            gains[place] = max(found, default=0.0)
    return gains


def columns_of(fit: SimulatedFit, candidate: Candidate) -> list[list[FloatArray]]:
    """Derivatives of the whitened signals by a candidate that is not in the fit yet.

    Returns
    -------
    For each of its starts, columns of shape (N,): one for each amplitude, two for each recording
    that has a phase of its own (sine, cosine). Without what cannot be simulated.
    """
    model = extended(fit.model, candidate)
    found = []
    for start in (candidate.neutral, *candidate.starts):
        point = np.concatenate([fit.point, start])
        columns = []
        for i in amplitude_places(candidate):
            for phase in (0.0, 0.5 * math.pi) if is_periodic(candidate) else (None,):
                columns += _difference(model, point, len(fit.point) + i, phase, candidate)
        found.append(columns)
    return found


def extended(model: SimulatedSignals, candidate: Candidate) -> SimulatedSignals:
    """The comparison with a candidate's unknowns beside its own."""
    return model.beside(candidate.bench(model.bench), candidate.unknowns)


def _small(unknown: Unknown, coordinate: float) -> float:
    """A thousandth of the range; to its lower end from a neutral value below it."""
    return max(1e-3 * (unknown.high - unknown.low), unknown.low - coordinate)


def _difference(
    model: SimulatedSignals, point: FloatArray, i: int, phase: float | None, candidate: Candidate
) -> list[FloatArray]:
    """Change of the whitened signals by a small amount of one unknown; a column per phase owner."""
    moved = np.stack([point, point])
    amount = _small(model.unknowns[i], float(point[i]))
    moved[1, i] += amount
    if phase is not None:
        for k in quadrant_phases(candidate):
            moved[:, point.size - len(candidate.unknowns) + k] = phase
    of_ticks = any(u.name.startswith(OF_THE_TICKS) for u in candidate.unknowns)
    z = (model if of_ticks else model.for_differences(point)).whitened(moved)
    change = (z[0] - z[1]) / amount
    if not np.all(np.isfinite(change)):
        return []
    if phase is None:
        return [change]
    names = [seen.name for seen in model.recordings]
    owners = (
        range(len(names)) if candidate.recording is None else [names.index(candidate.recording)]
    )
    parts = [np.zeros_like(change) for _ in owners]
    for owner, part in zip(owners, parts, strict=True):
        model.by_recording(part)[owner][:] = model.by_recording(change)[owner]
    return parts


def _gain(explained: FloatArray, residual: FloatArray, columns: list[FloatArray]) -> float:
    """Square of the residual along what the columns add to an orthonormal basis."""
    if not columns:
        return 0.0
    more = np.pad(np.stack(columns), ((0, 0), (0, len(residual) - columns[0].size)))
    more -= (more @ explained) @ explained.T
    along = more @ residual
    return float(along @ np.linalg.pinv(more @ more.T, 1e-10, hermitian=True) @ along)


def _phased(model: SimulatedSignals, candidate: Candidate, start: FloatArray) -> FloatArray:
    """Amplitude and phases of a periodic candidate by linear least squares at the start."""
    own = start.size - len(candidate.unknowns)
    cosine = _difference(model, start, own, 0.5 * math.pi, candidate)
    sine = _difference(model, start, own, 0.0, candidate)
    if not cosine or not sine:
        return start
    residual = model.whitened(start)[0]
    amplitudes, phases = [], []
    for s, c in zip(sine, cosine, strict=True):
        # a sin(nθ + φ) = a cos φ · (phase 0) + a sin φ · (phase π/2)
        (in_phase, quadrature), *_ = np.linalg.lstsq(np.column_stack([s, c]), residual, rcond=None)
        amplitudes.append(math.hypot(in_phase, quadrature))
        phases.append(wrapped(math.atan2(quadrature, in_phase)))
    phased = start.copy()
    phased[own] = float(np.clip(np.median(amplitudes), 0.0, model.unknowns[own].high))
    for k, place in enumerate(quadrant_phases(candidate)):
        phased[own + place] = phases[k] if len(quadrant_phases(candidate)) > 1 else phases[0]
    return phased


def _nudged(model: SimulatedSignals, start: FloatArray, own: int) -> FloatArray:
    """A little of the effect, so that its shape parameters have a derivative to follow."""
    unknown = model.unknowns[own]
    least = max(unknown.low, 0.0)
    amounts = [least + share * (unknown.high - least) for share in (0.003, 0.03, 0.2)]
    if unknown.low < 0.0:
        amounts += [-a for a in amounts]
    trials = np.repeat(start[None], len(amounts), axis=0)
    trials[:, own] = amounts
    of_ticks = unknown.name.startswith(OF_THE_TICKS)
    swift = model if of_ticks else model.for_differences(start)
    here, *z = swift.whitened(np.concatenate([start[None], trials]))
    z = model.whitened(start) + z - here
    values = np.einsum("ij,ij->i", z, z)
    return np.asarray(trials[int(np.nanargmin(np.where(np.isfinite(values), values, np.inf)))])


def _chi_square(model: SimulatedSignals, point: FloatArray) -> float:
    z = model.whitened(point)[0]
    value = float(z @ z)
    return value if math.isfinite(value) else math.inf


def _scanned_starts(
    model: SimulatedSignals, base: Explanation, candidate: Candidate
) -> list[FloatArray]:
    own = len(base.fit.point)
    grids = {own + place: grid for place, grid in candidate.scanned.items()}
    names = [u.name for u in model.unknowns]
    if GAP in names:
        gap = names.index(GAP)
        grids[gap] = np.linspace(model.low[gap], model.high[gap], SCANNED_GAPS)
    starts = aligned_starts(model, grids)
    for start in starts:
        for i in range(len(candidate.unknowns)):
            if i not in candidate.scanned:
                start[own + i] = candidate.neutral[i]
    return starts


def _width(unknown: Unknown) -> float:
    if math.isfinite(unknown.sd):
        return unknown.sd * math.sqrt(2.0 * math.pi)
    if math.isfinite(unknown.low) and math.isfinite(unknown.high):
        return unknown.high - unknown.low
    return 2.0 * math.pi
