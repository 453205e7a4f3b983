"""Full fits of sets of hypotheses, jointly with all declared unknowns."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from bayesbl.errors import BenchError
from bayesbl.matching.alignment import aligned_starts, remaining_noise
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated
from bayesbl.matching.signals import SimulatedSignals
from bayesbl.model_search.catalogue import Candidate, CandidateKey
from bayesbl.noise.channel_noise import ChannelNoise
from bayesbl.processes import in_threads
from bayesbl.recording.types import FloatArray

SEEN_STEP = 4.0
"""Change of the signals over a derivative's step, in standard deviations of noise: a smaller one
drowns in the simulator's error, a larger one suffers from curvature."""

SCANNED_GAPS = 10
MOST_FROM_AFAR = 3
LEFT_FROM_AFAR = 0.5
"""Largest share of χ² beyond noise that a rough fit from afar may leave to be pursued."""

SHARES_TRIED = (1.0, 0.3, 0.1, 0.03)
"""Shares of the sizes promised by the linearisation, from which a fit may start."""


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """The recordings fitted with a set of hypotheses.

    ``candidates``: in the order of their addition; ``fit``: their unknowns follow those of the
    nominal fit.
    """

    candidates: tuple[Candidate, ...]
    fit: SimulatedFit

    @property
    def names(self) -> tuple[str, ...]:
        """Labels of the candidates."""
        return tuple(c.label for c in self.candidates)

    @property
    def keys(self) -> frozenset[CandidateKey]:
        """Key that identifies the set."""
        return frozenset(c.key for c in self.candidates)

    def with_derivatives(self) -> Explanation:
        """The same explanation, whose fit holds its Jacobian."""
        return replace(self, fit=self.fit.with_derivatives())

    def without_derivatives(self) -> Explanation:
        """The same explanation without the Jacobian, to save memory."""
        return replace(self, fit=self.fit.without_derivatives())

    def places(self, candidate: Candidate) -> list[int]:
        """Indices of a candidate's unknowns in a point."""
        indices = {unknown.key: index for index, unknown in enumerate(self.fit.model.unknowns)}
        return [indices[unknown.key] for unknown in candidate.unknowns]

    @property
    def log_prior(self) -> float:
        """ln prior density of all candidates' unknowns."""
        return sum(c.log_prior(self.fit.point[self.places(c)]) for c in self.candidates)


def with_noise(explanation: Explanation, noise: Sequence[ChannelNoise]) -> Explanation:
    """Refit the explanation under another noise model."""
    fit = explanation.fit
    model = replace(fit.model, noise=noise)
    return replace(explanation, fit=fit_simulated(model, fit.point, fit.steps))


def with_own_noise(explanation: Explanation) -> Explanation:
    """Refit the explanation under the noise of its own residuals."""
    return with_noise(explanation, remaining_noise(explanation.fit))


def polished(explanation: Explanation) -> Explanation:
    """Refit the explanation until it converges fully."""
    fit = explanation.fit
    ended = fit_simulated(fit.model, fit.point, fit.steps, one_sided=True)
    return replace(explanation, fit=ended)


def extended(model: SimulatedSignals, candidate: Candidate) -> SimulatedSignals:
    """The model with a candidate's unknowns added."""
    return model.with_unknowns(candidate.bench(model.bench), candidate.unknowns)


def refit(
    base: Explanation, added: Sequence[tuple[Candidate, FloatArray]], shift: FloatArray
) -> Explanation | None:
    """Fit a set extended by some candidates roughly; ``None`` if it cannot be simulated.

    ``added``: candidates, each with the coordinates that the linearisation promises, shape (k,);
    ``shift``: promised shift of the base fit's unknowns, shape (d,).
    """
    model = base.fit.model
    for candidate, _ in added:
        model = extended(model, candidate)
    point = base.fit.point
    neutral = [c.neutral for c, _ in added]
    starts = []
    for share in SHARES_TRIED:
        added_points = [
            np.where(
                np.isfinite(c.usual) & ~c.is_at_full_size(coordinates),
                zero + share * (coordinates - zero),
                coordinates,
            )
            for (c, coordinates), zero in zip(added, neutral, strict=True)
        ]
        starts += [
            np.concatenate([point + base_shift, *added_points])
            for base_shift in (share * shift, 0.0 * shift)
        ]
    fit = fitted_from(base.fit, model, starts)
    return None if fit is None else Explanation((*base.candidates, *(c for c, _ in added)), fit)


def fitted_from(
    fit: SimulatedFit,
    model: SimulatedSignals,
    starts: Sequence[FloatArray],
    goal: float = math.inf,
) -> SimulatedFit | None:
    """Fit an extended model roughly from the best of some starts; ``None`` without one.

    ``goal``: as :func:`fit_simulated` takes it.
    """
    # A linear promise may be outside a range.
    trials = np.clip(np.stack(starts), model.low, model.high)
    best = min(trials, key=lambda trial: chi_square(model, trial))
    known = fit.derivatives()
    with suppress(BenchError):
        return fit_simulated(model, best, fit.steps, rough=True, known=known, goal=goal)
    return None


def reduced(
    nominal: Explanation, full: Explanation, without: Collection[int]
) -> Explanation | None:
    """Refit an explanation without the candidates at these indices, from its present point.

    Returns ``nominal`` if no candidate is left, and ``None`` if it cannot be simulated.
    """
    if len(without) == len(full.candidates):
        return nominal
    kept = [c for k, c in enumerate(full.candidates) if k not in without]
    indices = list(range(nominal.fit.point.size))
    for candidate in kept:
        indices += full.places(candidate)
    model = nominal.fit.model
    for candidate in kept:
        model = extended(model, candidate)
    try:
        fit = fit_simulated(model, full.fit.point[indices], full.fit.steps[indices], one_sided=True)
    except BenchError:
        return None
    return Explanation(tuple(kept), fit)


def from_afar(nominal: Explanation, candidates: Sequence[Candidate]) -> list[Explanation]:
    """Fit candidates that move the gap roughly, from the best points of a full-range scan.

    Only the few with the best starting χ² are fitted. Returns those that remove much of the χ²,
    best first.
    """
    model, nominal_size = nominal.fit.model, nominal.fit.point.size
    scans = []
    for candidate in (c for c in candidates if c.scanned):
        extended_model = extended(model, candidate)
        neutral = {nominal_size + i: np.array([zero]) for i, zero in enumerate(candidate.neutral)}
        grids = neutral | {nominal_size + i: grid for i, grid in candidate.scanned.items()}
        start = aligned_starts(extended_model, grids, SCANNED_GAPS)[0]
        scans.append((chi_square(extended_model, start), start, extended_model, candidate))
    fitted = []
    for _, start, extended_model, candidate in sorted(scans, key=lambda p: p[0])[:MOST_FROM_AFAR]:
        with suppress(BenchError):
            fit = fit_simulated(extended_model, start, nominal.fit.steps, rough=True)
            fitted.append(Explanation((*nominal.candidates, candidate), fit))
    samples = nominal.fit.residual.size
    limit = samples + LEFT_FROM_AFAR * (nominal.fit.chi_square - samples)
    hopeful = [e for e in fitted if e.fit.chi_square < limit]
    return sorted(hopeful, key=lambda e: e.fit.chi_square)


def slopes(
    model: SimulatedSignals,
    index: int,
    point: FloatArray,
    moves: FloatArray,
    steps: tuple[FloatArray, FloatArray, FloatArray],
    reference: FloatArray | None = None,
) -> FloatArray:
    """Derivatives of one recording's whitened signals along moves of a point, (k, N).

    A step whose change of the signals is far from ``SEEN_STEP`` is made once more.

    ``moves``: changes of the point by a step of one, (k, d); ``steps``: first, shortest and longest
    step along each, (k,); no derivative is made by a step of zero; ``reference``: whitened residual
    at the point, (N,), if it is known.
    """
    first, shortest, longest = steps
    if reference is None:
        reference = model.whitened_of(point, index)[0]
    sizes = np.minimum(first, longest)
    result, pending = np.zeros((len(moves), reference.size)), np.flatnonzero(sizes > 0.0)
    for _ in range(2):
        points = point + sizes[pending, None] * moves[pending]
        # Rounding must not take an unknown out of its range.
        trials = np.clip(points, np.minimum(model.low, point), np.maximum(model.high, point))
        changes = reference - model.whitened_of(trials, index)
        result[pending] = changes / sizes[pending, None]
        better = sizes[pending] * SEEN_STEP / np.maximum(np.linalg.norm(changes, axis=1), 1e-12)
        better = np.clip(better, shortest[pending], longest[pending])
        repeated = (better > 2.0 * sizes[pending]) | (better < 0.2 * sizes[pending])
        sizes[pending], pending = better, pending[repeated]
        if not pending.size:
            break
    return result


def columns_of(fit: SimulatedFit, candidate: Candidate) -> list[list[FloatArray]]:
    """Derivatives of the whitened signals by a candidate that is not in the fit yet.

    Returns
    -------
    For each start, columns of shape (N,): one for each amplitude, or two (sine, cosine) for each
    recording with its own phase. Columns that cannot be simulated are left out.
    """
    phases = (0.0, 0.5 * math.pi) if candidate.is_periodic else (None,)
    return [
        [
            column
            for amplitude, phase in itertools.product(candidate.amplitudes, phases)
            for column in _columns(fit, candidate, start, amplitude, phase)
        ]
        for start in (candidate.neutral, *candidate.starts)
    ]


def _columns(
    fit: SimulatedFit,
    candidate: Candidate,
    start: FloatArray,
    amplitude: int,
    phase: float | None,
) -> list[FloatArray]:
    """Change of the whitened signals per unit of one amplitude; one column for each separate phase.

    If the start has a size, the change over all of it counts.
    """
    model, neutral, d = extended(fit.model, candidate), start.copy(), fit.point.size
    neutral[candidate.amplitudes] = candidate.neutral[candidate.amplitudes]
    if phase is not None:
        neutral[candidate.phases] = phase
    amount = float(start[amplitude] - candidate.neutral[amplitude])
    if amount == 0.0:
        # A thousandth of the range, downwards at its upper end; from below the range, up to its
        # lower end.
        unknown, value = candidate.unknowns[amplitude], float(neutral[amplitude])
        amount = max(1e-3 * (unknown.high - unknown.low), unknown.low - value)
        amount = amount if value + amount <= unknown.high else -amount
    move = np.zeros((1, d + neutral.size))
    move[0, d + amplitude] = math.copysign(1.0, amount)
    point, step = np.concatenate([fit.point, neutral]), np.array([abs(amount)])
    owners = [
        k
        for k, observation in enumerate(model.recordings)
        if candidate.recording in (None, observation.name)
    ]
    # An effect that is new changes nothing at its neutral value: there the residual is the fit's.
    is_fit = model.bench is not fit.model.bench
    column = np.zeros(model.size)
    parts, residuals = model.by_recording(column), model.by_recording(fit.residual)

    def fill(k: int) -> None:
        reference = residuals[k].reshape(-1) if is_fit else None
        change = slopes(model, k, point, move, (step, step, step), reference)[0]
        parts[k][:] = math.copysign(1.0, amount) * change.reshape(parts[k].shape)

    in_threads(fill, owners, model.workers)
    if not np.all(np.isfinite(column)):
        return []
    return [column] if phase is None else [model.only_in(owner, column) for owner in owners]


def promised(candidate: Candidate, start: FloatArray, sizes: FloatArray) -> FloatArray:
    """Coordinates of a candidate from the sizes of its columns, in the candidate's units."""
    if candidate.is_at_full_size(start):
        return start
    coordinates, amplitudes = start.copy(), candidate.amplitudes
    if not candidate.is_periodic:
        coordinates[amplitudes] = candidate.neutral[amplitudes] + sizes
        return coordinates
    sine, cosine = np.split(sizes, 2)
    # a sin(nθ + φ) = a cos φ · (phase 0) + a sin φ · (phase π/2)
    coordinates[amplitudes] = float(np.median(np.hypot(sine, cosine)))
    phases = np.arctan2(cosine, sine)
    for k, index in enumerate(candidate.phases):
        phase = float(phases[min(k, phases.size - 1)])
        coordinates[index] = (phase + math.pi) % (2.0 * math.pi) - math.pi
    return coordinates


def chi_square(model: SimulatedSignals, point: FloatArray) -> float:
    """χ² at a point, roughly; infinite if it cannot be simulated."""
    z = model.whitened(point)[0]
    value = float(z @ z)
    return value if math.isfinite(value) else math.inf
