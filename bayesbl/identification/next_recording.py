"""Which recording would tell most about what these leave open."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesbl.diagnosis.closed_loop.suggest import ROTATIONS, SPEED_SHARES
from bayesbl.matching.least_squares import SimulatedFit, derivatives
from bayesbl.matching.observed import Observed
from bayesbl.matching.signals import GAP, START_ANGLE, SimulatedSignals, Unknown
from bayesbl.recording.types import FloatArray

NEAR_LIMIT = 0.95
"""Share of the drive's largest current that a suggested recording may take."""


@dataclass(frozen=True, slots=True)
class NextRecording:
    """A recording in steady rotation, five rotations long, with the noise of the first.

    Attributes
    ----------
    information_bits
        Expected: half the binary logarithm of how much the volume of what is unknown shrinks.
    sharpens
        The gap or parameter that gains most, with the standard deviation of its logarithm before
        and after.
    """

    reference_speed_rpm: float
    information_bits: float
    sharpens: str
    sd_before: float
    sd_after: float


def next_recording(fit: SimulatedFit) -> NextRecording | None:
    """The one of some speeds and directions that is expected to tell most; ``None`` if none runs.

    With S the covariance of what recordings share and J the whitened derivatives of a further one,
    its start angle free, S⁻¹ grows by Jᵀ(1 − P)J, P the projection on the start angle's derivative.
    """
    shared = [i for i, u in enumerate(fit.model.unknowns) if _is_shared(u, fit)]
    before = fit.covariance[np.ix_(shared, shared)]
    found = [
        _judged(fit, shared, before, speed, information)
        for speed in _speeds(fit.model.recordings)
        if (information := _information(fit, shared, speed)) is not None
    ]
    return max(found, key=lambda one: one.information_bits, default=None)


def _is_shared(unknown: Unknown, fit: SimulatedFit) -> bool:
    """The gap counts as that of the last recording, where each has its own."""
    last = fit.model.recordings[-1].name
    return unknown.recording is None or (unknown.name == GAP and unknown.recording == last)


def _speeds(recordings: Sequence[Observed]) -> Iterator[float]:
    top = max(abs(seen.reference_speed_rpm) for seen in recordings)
    for share in SPEED_SHARES:
        yield from (share * top, -share * top)


def _judged(
    fit: SimulatedFit,
    shared: Sequence[int],
    before: FloatArray,
    speed_rpm: float,
    information: FloatArray,
) -> NextRecording:
    after = np.linalg.inv(np.linalg.inv(before) + information)
    bits = 0.5 * (np.linalg.slogdet(before)[1] - np.linalg.slogdet(after)[1]) / math.log(2.0)
    sd = np.sqrt(np.stack([np.diag(before), np.diag(after)]))
    relative = np.array([fit.model.unknowns[i].logarithmic for i in shared])
    best = int(np.argmin(np.where(relative, sd[1] / sd[0], np.inf)))
    name = fit.model.unknowns[shared[best]].name
    return NextRecording(speed_rpm, float(bits), name, float(sd[0, best]), float(sd[1, best]))


def _information(fit: SimulatedFit, shared: Sequence[int], speed_rpm: float) -> FloatArray | None:
    """Of one rotation, times their number; ``None`` where the bench cannot run at this speed."""
    model, last = fit.model, fit.model.recordings[-1]
    period = model.bench.rotation_period_s(speed_rpm)
    samples = round(period * last.sampling_hz) + model.noise[-1].order
    seen = replace(
        last,
        signals=np.zeros((len(last.signals), samples)),
        reference_speed_rpm=speed_rpm,
        rotation_period_s=period,
        excluded=None,
        motion=None,
        cycle=None,
        begin_s=0.0,
    )
    # Its start angle, and phases of effects, are those of the last recording.
    own = [i for i, u in enumerate(model.unknowns) if u.recording in (None, last.name)]
    unknowns = [model.unknowns[i] for i in own]
    there = SimulatedSignals(model.bench, [seen], unknowns, [model.noise[-1]], model.workers)
    point = fit.point[own]
    signals = there.signals(point, 0)[0]
    limit = NEAR_LIMIT * model.bench.value("current_limit_a")
    if not np.all(np.isfinite(signals)) or (len(signals) > 1 and np.abs(signals[1]).max() > limit):
        return None
    matrix = derivatives(there, point, fit.steps[own])
    start = matrix[:, [k for k, u in enumerate(unknowns) if u.name == START_ANGLE]]
    free = matrix[:, [own.index(i) for i in shared]]
    root, _ = np.linalg.qr(start)
    left = free - root @ (root.T @ free)
    return np.asarray(ROTATIONS * left.T @ left)
