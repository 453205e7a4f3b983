"""Find where a recording starts and roughly how large the gap is, from the recording alone."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayesbl.bench.bench import Bench
from bayesbl.bench.kernel import CURRENT, SPEED
from bayesbl.bench.simulation import simulate_channels
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated
from bayesbl.matching.motions import motion_starts, noise_of, remembered_start, start_angles
from bayesbl.matching.observed import Observed, with_held_reference, without_start
from bayesbl.matching.predictive_check import is_explained
from bayesbl.matching.signals import (
    AT_ONCE,
    GAP,
    REFERENCE_DELAY,
    START_ANGLE,
    SimulatedSignals,
    Unknown,
)
from bayesbl.noise.channel_noise import ChannelNoise
from bayesbl.progress import Progress, silent
from bayesbl.recording.repetition import folded
from bayesbl.recording.types import FloatArray

GAPS_TRIED = 36
LOAD_FRICTION = ("load_viscous_friction", "load_coulomb_friction")
FRICTIONS_TRIED = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5])
"""Friction in usual sizes; one joint in eighty has more."""
SHIFTS_TRIED = 4
"""Shifts of a learned term per period of its highest order."""
STARTS_FITTED = 3
NOISE_ROUNDS = 2
FORGOTTEN = 0.01
"""χ² below which the start is forgotten: a shift of at most 0.1 standard deviations in any
direction."""


def fit_aligned(
    bench: Bench,
    recordings: Sequence[Observed],
    unknowns: Sequence[Unknown],
    workers: int = 1,
    progress: Progress = silent,
) -> SimulatedFit:
    """Find the most probable point of all unknowns, from the recordings alone.

    The gap is scanned, and the load's friction if it is unknown. For each value, the recordings,
    averaged over rotations, are shifted against the simulation by correlation. The best few points
    are fitted, and the noise is estimated again from the residuals. ``progress``: called with (fits
    made, fits expected).
    """
    noise = [noise_of(observation, observation.signals) for observation in recordings]
    model = SimulatedSignals(bench, recordings, unknowns, noise, workers)
    progress(0, STARTS_FITTED + NOISE_ROUNDS)
    starts = _with_motions_fitted(model, aligned_starts(model, _load_friction(model)))
    fits: list[SimulatedFit] = []
    for start in starts:
        fits.append(fit_simulated(model, start, rough=True))
        progress(len(fits), len(starts) + NOISE_ROUNDS)
    best = min(fits, key=lambda fit: fit.chi_square)
    best = replace(best, model=replace(model, noise=remaining_noise(best)))
    recordings = [_forgetful(best, i) for i in range(len(recordings))]
    return refitted(SimulatedSignals(bench, recordings, unknowns, noise, workers), best)


def _load_friction(model: SimulatedSignals) -> dict[int, FloatArray]:
    """Values of the load's friction to scan, by index of the unknown.

    Friction shifts the flank changes of one rotation against one another, in many joints by half a
    ringing period, where a fit gets stuck. Motions show both directions, and gravity moves their
    current by more.
    """
    if all(observation.motion is not None for observation in model.recordings):
        return {}
    for index, unknown in enumerate(model.unknowns):
        effect = unknown.name.partition("__")[0]
        if effect in LOAD_FRICTION and unknown.low == unknown.centre and unknown.recording is None:
            return {index: unknown.sd * FRICTIONS_TRIED}
    return {}


def refitted(model: SimulatedSignals, fit: SimulatedFit) -> SimulatedFit:
    """Refit a model from the optimum of another fit, estimating the noise again twice."""
    best = replace(fit, model=model)
    for _ in range(NOISE_ROUNDS):
        model = replace(model, noise=remaining_noise(best))
        best = fit_simulated(model, best.point, best.steps)
    return best.with_derivatives()


def _forgetful(fit: SimulatedFit, index: int) -> Observed:
    """A recording without the part that depends on the initial tooth flank."""
    observation = fit.model.recordings[index]
    if observation.motion is None:
        return observation
    remembered = remembered_start(fit, index)
    return without_start(observation, int(np.sum(remembered > FORGOTTEN)))


def remaining_noise(fit: SimulatedFit) -> list[ChannelNoise]:
    """Noise of each recording, from rotation differences of the fit's residuals."""
    return [
        noise_of(observation, fit.unexplained(i))
        for i, observation in enumerate(fit.model.recordings)
    ]


def aligned_starts(
    model: SimulatedSignals,
    grids: Mapping[int, FloatArray] | None = None,
    gaps_tried: int = GAPS_TRIED,
) -> list[FloatArray]:
    """Starting points for fits, best first: gaps by scan, start angles by correlation.

    Each start has other values of what is scanned besides the gap. If these are too few, starts
    have other gaps: the best of each recording with its own gap, then the second best of each, …

    Parameters
    ----------
    grids
        Coordinates to scan besides the gap, by index in a point; all combinations are tried. Other
        unknowns start at their prior's centre, or the middle of their range.
    gaps_tried
        Number of gaps over the range.
    """
    points = _combinations(np.array([u.middle for u in model.unknowns]), grids or {})
    starts = np.repeat(points[:, None], STARTS_FITTED, axis=1)
    total = np.zeros(starts.shape[:2])
    by_gap: dict[int | None, list[int]] = {}
    for i, observation in enumerate(model.recordings):
        by_gap.setdefault(model.place_of(GAP, observation.name), []).append(i)
    for index, members in by_gap.items():
        trials = points[:, None]
        if index is not None:
            trials = np.repeat(trials, gaps_tried, axis=1)
            trials[..., index] = np.linspace(model.low[index], model.high[index], gaps_tried)
        shape = trials.shape[:2]
        aligned = _aligned(model, trials.reshape(-1, trials.shape[2]), members)
        cost = np.sum([cost for _, cost in aligned], axis=0).reshape(shape)
        chosen = np.stack([_best_apart(row) for row in cost])
        total += np.take_along_axis(cost, chosen, axis=1)
        if index is not None:
            starts[..., index] = np.take_along_axis(trials[..., index], chosen, axis=1)
        for i, (angles, _) in zip(members, aligned, strict=True):
            angle_index = model.place_of(START_ANGLE, model.recordings[i].name)
            if angle_index is not None:
                best = np.take_along_axis(angles.reshape(shape), chosen, axis=1)
                if math.isfinite(model.unknowns[angle_index].sd):
                    turn, centre = 2.0 * math.pi, model.unknowns[angle_index].centre
                    best = best - turn * np.round((best - centre) / turn)
                starts[..., angle_index] = best
    order = np.argsort(total, axis=0, kind="stable")
    starts = np.take_along_axis(starts, order[..., None], axis=0)
    starts = starts.swapaxes(0, 1).reshape(-1, starts.shape[2])
    _, first = np.unique(starts, axis=0, return_index=True)
    return [with_shifts(model, starts[k]) for k in np.sort(first)[:STARTS_FITTED]]


def with_shifts(model: SimulatedSignals, start: FloatArray) -> FloatArray:
    """The point with each learned term shifted to its best place in each recording, by a scan."""
    start = start.copy()
    terms = model.bench.learned_terms
    for (i, observation), term in itertools.product(enumerate(model.recordings), terms):
        index = model.place_of(term.shift_slot, observation.name)
        if index is None:
            continue
        count = SHIFTS_TRIED * term.orders
        trials = np.repeat(start[None], count, axis=0)
        trials[:, index] = np.linspace(-0.5, 0.5, count, endpoint=False)
        trials[:, index] *= term.period
        residuals = model.whitened_of(trials, i)
        chi_square = np.einsum("ij,ij->i", residuals, residuals)
        start = trials[int(np.argmin(np.nan_to_num(chi_square, nan=np.inf)))]
    return start


def _with_motions_fitted(model: SimulatedSignals, starts: list[FloatArray]) -> list[FloatArray]:
    """The starts, with the own unknowns of every motion from its best separate fit.

    A motion has more local minima than a rotation, and these differ between recordings.
    """
    settled = [start.copy() for start in starts]
    for i, observation in enumerate(model.recordings):
        if observation.motion is None:
            continue
        indices = [k for k, u in enumerate(model.unknowns) if u.recording == observation.name]
        if all(model.unknowns[k].name != GAP for k in indices):
            continue
        shared = {
            u.name: float(u.value(starts[0][k]))
            for k, u in enumerate(model.unknowns)
            if u.recording is None
        }
        single = SimulatedSignals(
            model.bench,
            [observation],
            [model.unknowns[k] for k in indices],
            [model.noise[i]],
            model.workers,
            {**model.settings, **shared},
            model.recent,
        )
        fits = [fit_simulated(single, start) for start in motion_starts(single, starts[0][indices])]
        best = min(fits, key=lambda fit: fit.chi_square)
        for start in settled:
            start[indices] = best.point
    _, first = np.unique(settled, axis=0, return_index=True)
    return [settled[k] for k in np.sort(first)]


def _combinations(start: FloatArray, scanned: Mapping[int, FloatArray]) -> FloatArray:
    """The start with every combination of the scanned values, shape (m, d)."""
    meshes = np.meshgrid(*scanned.values(), indexing="ij")
    points = np.repeat(start[None], meshes[0].size if meshes else 1, axis=0)
    for index, mesh in zip(scanned, meshes, strict=True):
        points[:, index] = mesh.ravel()
    return points


def _best_apart(cost: FloatArray) -> NDArray[np.int64]:
    """Indices of the lowest costs, no two adjacent; repeated if there are too few."""
    chosen: list[int] = []
    for k in map(int, np.argsort(cost, kind="stable")):
        if all(abs(k - c) > 1 for c in chosen):
            chosen.append(k)
        if len(chosen) == STARTS_FITTED:
            break
    return np.resize(np.array(chosen), STARTS_FITTED)


def _aligned(
    model: SimulatedSignals, points: FloatArray, members: Sequence[int]
) -> list[tuple[FloatArray, FloatArray]]:
    """Best start angle and χ² at each point, shape (m,) each, by recording."""
    by_member = {
        i: start_angles(model, points, i) for i in members if model.recordings[i].motion is not None
    }
    steady = [i for i in members if i not in by_member]
    # In pieces, so that recordings at one speed find each other's simulations in the cache.
    pieces = np.array_split(points, math.ceil(len(points) / AT_ONCE))
    aligned = [[_align(model, piece, i) for i in steady] for piece in pieces]
    for i, parts in zip(steady, zip(*aligned, strict=True), strict=True):
        angle, chi_square = np.concatenate(parts).T
        by_member[i] = angle, chi_square
    return [by_member[i] for i in members]


def _align(model: SimulatedSignals, points: FloatArray, recording: int) -> FloatArray:
    """Best start angle of a steady rotation and χ² at each point, shape (m, 2).

    Means are subtracted: an offset of a channel says nothing about the phase.
    """
    observation = model.recordings[recording]
    weight, turn = 1.0 / model.noise[recording].sd ** 2, observation.rotation_period_s
    turns = [folded(row[:-1], turn * observation.sampling_hz) for row in observation.signals]
    recorded = np.mean(turns, axis=1)
    channels, size = recorded.shape
    rate = size / turn
    matrix = model.vectors(points, observation, **{START_ANGLE: 0.0})
    matrix = model.bench.measurement.seen_by(matrix, observation.sampling_hz)
    simulated = model.recent.signals(
        matrix,
        ("a rotation", channels, size, rate),
        partial(_rotations, model, channels, size, rate),
    )
    recorded = recorded - recorded.mean(axis=1, keepdims=True)
    simulated = simulated - simulated.mean(axis=2, keepdims=True)
    product = np.fft.irfft(
        np.conj(np.fft.rfft(recorded)) * np.fft.rfft(simulated), size, axis=2
    )  # [k] = Σ_j recorded_j simulated_{j+k}
    gain = np.einsum("c,mck->mk", weight, product)
    power = np.einsum("c,mcj->m", weight, simulated**2)
    best = np.argmax(np.nan_to_num(gain, nan=-np.inf), axis=1)
    recorded_power = float(weight @ (recorded**2).sum(axis=1))
    chi_square = recorded_power + power - 2.0 * gain[np.arange(len(points)), best]
    rotations = observation.samples / observation.lag
    direction = math.copysign(1.0, observation.reference_speed_rpm)
    angle = direction * 2.0 * math.pi * best / size
    return np.column_stack(
        [angle, np.where(np.isfinite(chi_square), rotations * chi_square, np.inf)]
    )


def _rotations(
    model: SimulatedSignals, channels: int, size: int, rate: float, matrix: FloatArray
) -> FloatArray:
    """One rotation of each bench, shape (m, c, size); nan if a run fails."""
    simulated = simulate_channels(matrix, size, rate, workers=model.workers, failures="nan")
    return simulated[:, [SPEED, CURRENT][:channels]]


def valid_variant(
    fit: SimulatedFit, explains: Callable[[SimulatedFit], bool] = is_explained
) -> SimulatedFit:
    """The fit, or one with held references if only that explains its motions.

    A digital drive holds its reference from sample to sample.
    """
    moves = any(observation.motion is not None for observation in fit.model.recordings)
    if not moves or explains(fit):
        return fit
    held = _held(fit)
    return held if explains(held) else fit


def _held(fit: SimulatedFit) -> SimulatedFit:
    model = fit.model
    # A held reference steps at samples, so it has no delay.
    kept = [k for k, u in enumerate(model.unknowns) if u.name != REFERENCE_DELAY]
    held = replace(
        model,
        recordings=[with_held_reference(observation) for observation in model.recordings],
        unknowns=[model.unknowns[k] for k in kept],
    )
    return refitted(held, replace(fit, point=fit.point[kept], steps=fit.steps[kept]))
