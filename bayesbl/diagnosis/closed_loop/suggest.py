"""The recording that would tell apart what these recordings cannot."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.bench.simulation import simulate_channels
from bayesbl.diagnosis.closed_loop.prediction import augmented_bench, known_settings
from bayesbl.diagnosis.diagnosis import Suggestion
from bayesbl.matching.observed import Observed
from bayesbl.matching.signals import START_ANGLE
from bayesbl.model_search.closed_loop import NamedCandidate
from bayesbl.model_search.refit import Explanation
from bayesbl.recording.types import FloatArray

SPEED_SHARES = (1.0, 0.6, 0.3, 1.5)
"""Of the highest speed recorded, that are tried."""
PAYLOAD = 1.3
"""Times the present one, that is tried at the highest speed."""
ANGLE_STEP = 1e-4
ROTATIONS = 5.0
"""Of the load, in a recording that is suggested."""


def suggested_recording(final: Explanation, named: Sequence[NamedCandidate]) -> Suggestion | None:
    """Of some simple recordings the one in which rivals differ most; ``None`` without rivals.

    Every explanation is simulated with what it was fitted to; what a start angle or an offset of
    the phase could hide is projected out. Noise as in the first recording.
    """
    rivals = [rival for effect in named for _, rival in effect.indistinguishable]
    if not rivals:
        return None
    separates = tuple(effect.members for effect in named if effect.indistinguishable)
    first = final.fit.model.recordings[0]
    best: Suggestion | None = None
    for speed, payload in _options(final.fit.model.recordings):
        seen = [_seen(e, first, speed, payload) for e in (final, *rivals)]
        if any(s is None for s in seen):
            continue
        signals = [s for s in seen if s is not None]
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
    """(reference speed, payload share) of recordings that are not there yet."""
    there = {round(seen.reference_speed_rpm) for seen in recordings}
    top = max(abs(seen.reference_speed_rpm) for seen in recordings)
    for share in SPEED_SHARES:
        for direction in (1.0, -1.0):
            if round(direction * share * top) not in there:
                yield direction * share * top, 1.0
    yield top, PAYLOAD


def _seen(
    explanation: Explanation, first: Observed, speed_rpm: float, payload: float
) -> tuple[FloatArray, FloatArray] | None:
    """One rotation and its derivative by the start angle, (c, n) each; ``None`` if it fails."""
    bench: Bench = augmented_bench(explanation)
    bench = bench.with_parameters(
        gravity_torque_nm=payload * bench.value("gravity_torque_nm"),
        load_inertia_kg_m2=payload * bench.value("load_inertia_kg_m2"),
    )
    settings = known_settings(explanation) | {"reference_speed_rpm": speed_rpm}
    matrix = bench.vector(**{START_ANGLE: np.array([0.0, ANGLE_STEP])}, **settings)
    samples = round(bench.rotation_period_s(speed_rpm) * first.sampling_hz)
    everything = simulate_channels(matrix, samples, first.sampling_hz, failures="nan")
    both = everything[:, first.rows]
    if not np.all(np.isfinite(both)):
        return None
    return both[0], (both[1] - both[0]) / ANGLE_STEP
