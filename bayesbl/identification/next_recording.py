"""Suggest the recording that would reduce the remaining uncertainty most."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TypedDict

import numpy as np

from bayesbl.diagnosis.closed_loop.prediction import ROTATIONS, SPEED_SHARES
from bayesbl.matching.least_squares import SimulatedFit, derivatives
from bayesbl.matching.observed import Observed
from bayesbl.matching.planning import LARGEST_CURRENT_SHARE
from bayesbl.matching.signals import GAP, REFERENCE_DELAY, START_ANGLE, SimulatedSignals, Unknown
from bayesbl.recording.types import FloatArray

OF_ITS_START = (START_ANGLE, REFERENCE_DELAY)
"""Unknowns that each further recording has of its own."""

PACES = (1.0, 0.6, 0.3)
"""Relative speeds of a recorded motion: none is faster than the joint has shown."""


class NextRecordingSummary(TypedDict):
    """What to record next: five load rotations at one speed, or the motion of the recording
    ``motion_of``.

    ``information_bits``: log2 of the factor by which the volume of the posterior shrinks.
    ``sharpens``: the unknown that gains most, with the standard deviations of its logarithm.
    """

    reference_speed_rpm: float
    motion_of: str | None
    information_bits: float
    sharpens: str
    sd_before: float
    sd_after: float


def next_recording(fit: SimulatedFit) -> NextRecordingSummary | None:
    """Suggest the most informative of some recordings; ``None`` if the joint can run none.

    The options are some speeds in both directions, or if all recordings are motions, these at some
    paces. With S the covariance of the shared unknowns and J the whitened Jacobian of a further
    recording with its own start free, S⁻¹ grows by Jᵀ(1 − P)J, P the projection on the derivatives
    by that start.
    """
    shared = [i for i, u in enumerate(fit.model.unknowns) if _is_shared(u, fit)]
    covariance = fit.covariance[np.ix_(shared, shared)]
    recordings = fit.model.recordings
    moving = all(observation.motion is not None for observation in recordings)
    candidates = _motions(recordings) if moving else _rotations(fit.model)
    options = [
        _summary(fit, shared, covariance, observation, information)
        for observation, index in candidates
        if (information := _information(fit, shared, observation, index)) is not None
    ]
    return max(options, key=lambda option: option["information_bits"], default=None)


def _is_shared(unknown: Unknown, fit: SimulatedFit) -> bool:
    """Whether further recordings share the unknown; of separate gaps, they share the last one."""
    last = fit.model.recordings[-1].name
    return unknown.recording is None or (unknown.name == GAP and unknown.recording == last)


def _rotations(model: SimulatedSignals) -> Iterator[tuple[Observed, int]]:
    """One rotation at each speed, with the index of the last recording."""
    top = max(abs(observation.reference_speed_rpm) for observation in model.recordings)
    index = len(model.recordings) - 1
    last = model.recordings[index]
    for share, direction in itertools.product(SPEED_SHARES, (1.0, -1.0)):
        speed = direction * share * top
        period = model.bench.rotation_period_s(speed)
        samples = round(period * last.sampling_hz) + model.noise[index].order
        observation = replace(
            last,
            signals=np.zeros((len(last.signals), samples)),
            reference_speed_rpm=speed,
            rotation_period_s=period,
            excluded=None,
            motion=None,
            cycle=None,
            begin_s=0.0,
            motor_lines=None,
        )
        yield observation, index


def _motions(recordings: Sequence[Observed]) -> Iterator[tuple[Observed, int]]:
    """Each recorded motion at each pace, with the index of its recording."""
    for index, observation in enumerate(recordings):
        assert observation.motion is not None
        start_mask = np.arange(observation.samples) < observation.first_compared
        for pace in PACES:
            slower = observation.motion.at_pace(pace)
            speed = pace * observation.reference_speed_rpm
            slowed = replace(
                observation, motion=slower, reference_speed_rpm=speed, excluded=start_mask
            )
            yield slowed, index


def _summary(
    fit: SimulatedFit,
    shared: Sequence[int],
    covariance: FloatArray,
    observation: Observed,
    information: FloatArray,
) -> NextRecordingSummary:
    updated = np.linalg.inv(np.linalg.inv(covariance) + information)
    bits = 0.5 * (np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(updated)[1]) / math.log(2.0)
    sd = np.sqrt(np.stack([np.diag(covariance), np.diag(updated)]))
    relative = np.array([fit.model.unknowns[i].logarithmic for i in shared])
    best = int(np.argmin(np.where(relative, sd[1] / sd[0], np.inf)))
    return {
        "reference_speed_rpm": observation.reference_speed_rpm,
        "motion_of": None if observation.motion is None else observation.name,
        "information_bits": float(bits),
        "sharpens": fit.model.unknowns[shared[best]].name,
        "sd_before": float(sd[0, best]),
        "sd_after": float(sd[1, best]),
    }


def _information(
    fit: SimulatedFit, shared: Sequence[int], observation: Observed, index: int
) -> FloatArray | None:
    """Information of one rotation times their number, or of a motion.

    Start angle and phases of effects are those of the recording at that index. ``None`` if the
    drive cannot follow.
    """
    model = fit.model
    indices = model.places_in(index)
    unknowns = [model.unknowns[i] for i in indices]
    single = SimulatedSignals(
        model.bench, [observation], unknowns, [model.noise[index]], model.workers
    )
    point = fit.point[indices]
    signals = single.signals(point, 0)[0]
    limit = LARGEST_CURRENT_SHARE * model.bench.value("current_limit_a")
    if not np.all(np.isfinite(signals)) or (len(signals) > 1 and np.abs(signals[1]).max() > limit):
        return None
    matrix = derivatives(single, point, fit.steps[indices])
    start = matrix[:, [k for k, u in enumerate(unknowns) if u.name in OF_ITS_START]]
    gap = single.place_of(GAP, observation.name)
    columns = [indices.index(i) if i in indices else gap for i in shared]
    by_shared = np.column_stack(
        [np.zeros(len(matrix)) if k is None else matrix[:, k] for k in columns]
    )
    root, _ = np.linalg.qr(start)
    beside_start = by_shared - root @ (root.T @ by_shared)
    return np.asarray(
        (ROTATIONS if observation.motion is None else 1.0) * beside_start.T @ beside_start
    )
