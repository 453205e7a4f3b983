"""An explanation as a bench, and its predictions.

Predictions of the fitted recordings, of held-out ones, and of a future recording that would
distinguish what these cannot.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.learned import LearnedTerm
from bayesbl.bench.simulation import simulate_channels
from bayesbl.diagnosis.diagnosis import Suggestion
from bayesbl.diagnosis.disagreement import ComparedPiece, Use
from bayesbl.matching.alignment import aligned_starts
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated
from bayesbl.matching.motions import noise_of
from bayesbl.matching.observed import Observed
from bayesbl.matching.signals import (
    GAP,
    START_ANGLE,
    SimulatedSignals,
    Unknown,
    shift_unknowns,
    start_angle_unknown,
)
from bayesbl.model_search.closed_loop import NamedCandidate
from bayesbl.model_search.refit import Explanation
from bayesbl.recording.types import FloatArray

SPEED_SHARES = (1.0, 0.6, 0.3, 1.5)
"""Speeds to try, relative to the highest recorded one."""
PAYLOAD = 1.3
"""Payload to try at the highest speed, relative to the present one."""
ANGLE_STEP = 1e-4
ROTATIONS = 5.0
"""Load rotations in a suggested recording."""


def augmented_bench(explanation: Explanation) -> Bench:
    """The bench with the effects and corrected parameters of an explanation.

    The tolerance of a corrected parameter is √3 standard deviations of the fit. A phase belongs to
    a recording, not to the bench: the bench has that of the first, and ``simulate`` shifts it.
    """
    fit = explanation.fit
    bench = fit.model.bench
    estimates: dict[str, tuple[float, float]] = {}
    for i, unknown in enumerate(fit.model.unknowns):
        if unknown.name not in estimates:
            value = float(unknown.value(fit.point[i]))
            scale = value if unknown.logarithmic else 1.0
            sd = scale * float(np.sqrt(fit.covariance[i, i]))
            estimates[unknown.name] = value, sd
    effects = (_with_estimates(effect, estimates) for effect in bench.effects)
    corrected = {name: pair for name, pair in estimates.items() if name in bench.parameters}
    bench = bench.with_parameters(**{name: value for name, (value, _) in corrected.items()})
    bench = bench.with_effects(*effects).with_learned(*learned_terms(fit))
    parameters = dict(bench.parameters)
    for name, (value, sd) in corrected.items():
        half = min(math.sqrt(3.0) * sd, 0.5 * abs(value))
        parameters[name] = replace(parameters[name], tolerance=half)
    return replace(bench, parameters=parameters)


def learned_terms(fit: SimulatedFit) -> list[LearnedTerm]:
    """Learned terms of the bench at the optimum, with standard deviations."""
    places = {u.name: i for i, u in enumerate(fit.model.unknowns) if u.recording is None}
    spread = np.sqrt(np.diag(fit.covariance))
    values = {name: float(fit.point[i]) for name, i in places.items()}
    sds = {name: float(spread[i]) for name, i in places.items()}
    return [term.fitted(values, sds) for term in fit.model.bench.learned_terms]


def _with_estimates(
    effect: BenchEffect, estimates: Mapping[str, tuple[float, float]]
) -> BenchEffect:
    pairs = {k: estimates.get(f"{effect.name}__{k}") for k in effect.parameters}
    estimated = {k: EffectParameterValue(*pair) for k, pair in pairs.items() if pair is not None}
    return BenchEffect(effect.name, {**effect.parameters, **estimated})


def compared_pieces(
    nominal: Explanation, final: Explanation, held_out: Sequence[Observed]
) -> tuple[ComparedPiece, ...]:
    """All channels of all recordings with both simulations.

    Only gap, start and phases of held-out recordings are fitted to them.
    """
    both, pieces = (nominal, final), list[ComparedPiece]()
    for i, observation in enumerate(final.fit.model.recordings):
        pieces += compared_channels(observation, "used", *(e.fit.simulated(i) for e in both))
    for observation in held_out:
        pieces += compared_channels(
            observation, "held_out", *(predicted(e, observation) for e in both)
        )
    return tuple(pieces)


def compared_channels(
    observation: Observed, use: Use, before: FloatArray, after: FloatArray
) -> Iterator[ComparedPiece]:
    """Each channel with both simulations, (c, n); excluded samples do not change its RMS."""
    time_s, measured = (
        observation.begin_s + np.arange(observation.samples) / observation.sampling_hz,
        observation.signals,
    )
    if observation.excluded is not None:
        measured = np.where(observation.excluded, np.nan, measured)
    residuals = np.stack([observation.residual_of(s) for s in (before, after)], axis=1)
    residuals *= float(np.mean(observation.compared)) ** -0.5
    for name, residual, *signals in zip(
        observation.channels, residuals, measured, before, after, strict=True
    ):
        yield ComparedPiece.of(
            observation.name,
            name,
            use,
            time_s,
            *signals,
            residual=residual,
            rotation=observation.lag,
        )


def predicted(explanation: Explanation, observation: Observed) -> FloatArray:
    """Prediction of a recording that was not fitted, shape (c, n).

    The gap is that of all recordings, or of the fitted half of a split recording. Otherwise it is
    fitted to the recording, like its start angle.
    """
    fit = explanation.fit
    gap = fit.model.place_of(GAP, observation.name)
    known = {} if gap is None else {GAP: fit.value(*fit.model.unknowns[gap].key)}
    like = next(u for u in fit.model.unknowns if u.name == GAP)
    own = [] if known else [replace(like, recording=observation.name)]
    phases = [
        Unknown(u.name, recording=observation.name)
        for u in fit.model.unknowns
        if u.recording == fit.model.recordings[0].name and u.name.endswith("__phase_rad")
    ]
    bench = augmented_bench(explanation)
    named = {u.name for u in fit.model.unknowns}
    shifts = [
        unknown
        for term in bench.learned_terms
        if term.shift_slot in named
        for unknown in shift_unknowns(term, [observation.name])
    ]
    unknowns = [*own, start_angle_unknown(observation.name), *phases, *shifts]
    model = SimulatedSignals(
        bench,
        [observation],
        unknowns,
        [noise_of(observation, observation.signals)],
        fit.model.workers,
        known,
    )
    trials = aligned_starts(model)
    if phases:  # four quadrants, because a distant phase has no slope towards the right one
        at = [k for k, unknown in enumerate(unknowns) if unknown in phases]
        trials = [trial.copy() for trial in trials for _ in range(4)]
        for k, trial in enumerate(trials):
            trial[at] = 0.5 * math.pi * (k % 4)
    fits = [fit_simulated(model, trial) for trial in trials]
    return min(fits, key=lambda f: f.chi_square).simulated(0)


def suggested_recording(final: Explanation, named: Sequence[NamedCandidate]) -> Suggestion | None:
    """The simple recording in which rivals differ most; ``None`` without rivals.

    Each explanation is simulated as fitted, with the noise of the first recording. Differences that
    a start angle could hide are projected out.
    """
    rivals = [rival for effect in named for _, rival in effect.indistinguishable]
    if not rivals:
        return None
    separates = tuple(effect.members for effect in named if effect.indistinguishable)
    first = final.fit.model.recordings[0]
    best: Suggestion | None = None
    for speed, payload in _options(final.fit.model.recordings):
        simulations = [_rotation(e, first, speed, payload) for e in (final, *rivals)]
        if any(s is None for s in simulations):
            continue
        signals = [s for s in simulations if s is not None]
        noise = final.fit.model.noise[0]
        turn, shift = noise.whiten(signals[0][0]).ravel(), noise.whiten(signals[0][1]).ravel()
        least = math.inf
        for other, _ in signals[1:]:
            difference = noise.whiten(other).ravel() - turn
            difference -= shift * float(difference @ shift) / float(shift @ shift)
            least = min(least, float(np.linalg.norm(difference)) * math.sqrt(ROTATIONS))
        if best is None or least > best.distance:
            best = Suggestion(speed, payload, least, separates)
    return best


def _options(recordings: Sequence[Observed]) -> Iterator[tuple[float, float]]:
    """(reference speed, payload share) of further recordings."""
    recorded = {round(observation.reference_speed_rpm) for observation in recordings}
    top = max(abs(observation.reference_speed_rpm) for observation in recordings)
    for share in SPEED_SHARES:
        for direction in (1.0, -1.0):
            if round(direction * share * top) not in recorded:
                yield direction * share * top, 1.0
    yield top, PAYLOAD


def _rotation(
    explanation: Explanation, first: Observed, speed_rpm: float, payload: float
) -> tuple[FloatArray, FloatArray] | None:
    """One rotation and its derivative by the start angle, (c, n) each; ``None`` if it fails."""
    bench = augmented_bench(explanation)
    bench = bench.with_parameters(
        gravity_torque_nm=payload * bench.value("gravity_torque_nm"),
        load_inertia_kg_m2=payload * bench.value("load_inertia_kg_m2"),
    )
    settings = {"reference_speed_rpm": speed_rpm, GAP: explanation.fit.value(GAP, first.name)}
    matrix = bench.vector(**{START_ANGLE: np.array([0.0, ANGLE_STEP])}, **settings)
    samples = round(bench.rotation_period_s(speed_rpm) * first.sampling_hz)
    everything = simulate_channels(matrix, samples, first.sampling_hz, failures="nan")
    both = everything[:, first.rows]
    if not np.all(np.isfinite(both)):
        return None
    return both[0], (both[1] - both[0]) / ANGLE_STEP
