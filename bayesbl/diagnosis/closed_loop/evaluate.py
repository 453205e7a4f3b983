"""The gap between simulation and recording, on what was fitted and on what was held out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesbl.diagnosis.closed_loop.augment import augmented_bench, known_settings
from bayesbl.diagnosis.closed_loop.explain import Explanation
from bayesbl.matching.alignment import aligned_starts
from bayesbl.matching.least_squares import fit_simulated
from bayesbl.matching.signals import (
    Observed,
    SimulatedSignals,
    Unknown,
    start_angle_unknown,
)
from bayesbl.noise.channel_noise import ChannelNoise, estimate_channel_noise
from bayesbl.recording.types import FloatArray

Use = Literal["used", "held_out"]

SURE_EXCESS = 10.0
"""Standard errors that the excess over the noise must have before a share of it is told."""

CORRELATION_LAGS = 200


@dataclass(frozen=True, slots=True)
class Compared:
    """A recording beside its simulation before and after naming.

    Attributes
    ----------
    before, after
        Simulated channels, shape (c, n), in the channels' units.
    noise
        Of what is left after naming.
    """

    seen: Observed
    use: Use
    before: FloatArray
    after: FloatArray
    noise: ChannelNoise


@dataclass(frozen=True, slots=True)
class ChannelGap:
    """RMS between simulation and recording in one channel, in its unit.

    Attributes
    ----------
    noise_floor
        Standard deviation of what does not repeat.
    closed_fraction
        1 − (after² − floor²)/(before² − floor²); ``None`` where the excess before is not sure.
    """

    recording: str
    channel: str
    use: Use
    before: float
    after: float
    noise_floor: float
    closed_fraction: float | None


def compared(
    nominal: Explanation, final: Explanation, held_out: Sequence[Observed] = ()
) -> list[Compared]:
    """All recordings with both simulations; of held-out ones only start and phases are fitted."""
    found = []
    for i, seen in enumerate(final.fit.model.recordings):
        before = nominal.fit.model.signals(nominal.fit.point, i)[0]
        after = final.fit.model.signals(final.fit.point, i)[0]
        found.append(Compared(seen, "used", before, after, _noise(seen, after)))
    for seen in held_out:
        before, after = predicted(nominal, seen), predicted(final, seen)
        found.append(Compared(seen, "held_out", before, after, _noise(seen, after)))
    return found


def predicted(explanation: Explanation, seen: Observed) -> FloatArray:
    """What an explanation says of a recording that it was not fitted on, shape (c, n)."""
    fit = explanation.fit
    phases = [
        Unknown(u.name, recording=seen.name)
        for u in fit.model.unknowns
        if u.recording == fit.model.recordings[0].name and u.name.endswith("__phase_rad")
    ]
    unknowns = [start_angle_unknown(seen.name), *phases]
    model = SimulatedSignals(
        augmented_bench(explanation),
        [seen],
        unknowns,
        [estimate_channel_noise(seen.signals, seen.lag)],
        fit.model.workers,
        known_settings(explanation),
    )
    start = aligned_starts(model)[0]
    trials = [start]
    if phases:  # four quadrants, as a phase far off has no slope towards the right one
        trials = [start.copy() for _ in range(4)]
        for k, trial in enumerate(trials):
            trial[1:] = 0.5 * math.pi * k
    fits = [fit_simulated(model, trial) for trial in trials]
    best = min(fits, key=lambda f: f.chi_square)
    return np.asarray(model.signals(best.point, 0)[0])


def channel_gaps(recordings: Sequence[Compared]) -> list[ChannelGap]:
    """One entry for each recording and channel."""
    return [
        _gap(item.seen.name, channel, item.use, [(item, k, 1.0)])
        for item in recordings
        for k, channel in enumerate(item.seen.channels)
    ]


def whitened_gaps(recordings: Sequence[Compared]) -> list[ChannelGap]:
    """One entry for each use, all recordings and channels together, in units of the noise."""
    found = []
    uses: tuple[Use, ...] = ("used", "held_out")
    for use in uses:
        parts = [
            (item, k, 1.0 / item.noise.sd[k])
            for item in recordings
            if item.use == use
            for k in range(len(item.seen.channels))
        ]
        if parts:
            found.append(_gap("all", "all", use, parts))
    return found


def _gap(
    name: str, channel: str, use: Use, parts: Sequence[tuple[Compared, int, float]]
) -> ChannelGap:
    """From recordings, their channel's place and the scale put to it."""
    size = sum(item.seen.samples for item, _, _ in parts)
    before = sum(_squares(s * item.seen.left_by(item.before)[k]) for item, k, s in parts)
    after = sum(_squares(s * item.seen.left_by(item.after)[k]) for item, k, s in parts)
    floor = sum(item.seen.samples * (s * item.noise.sd[k]) ** 2 for item, k, s in parts)
    before, after, floor = before / size, after / size, floor / size
    independent = sum(
        item.seen.samples / _inflation(item.seen.left_by(item.after)[k]) for item, k, _ in parts
    )
    excess = before - floor
    # Of a mean square of noise, taken twice, and of its product with the misfit.
    error = math.sqrt((4.0 * floor**2 + 4.0 * max(excess, 0.0) * floor) / independent)
    closed = 1.0 - (after - floor) / excess if excess > SURE_EXCESS * error else None
    return ChannelGap(
        name, channel, use, math.sqrt(before), math.sqrt(after), math.sqrt(floor), closed
    )


def _squares(values: FloatArray) -> float:
    return float(values @ values)


def _inflation(rest: FloatArray) -> float:
    """Σ ρ_k²: by how much correlation lowers the number of independent squares."""
    centred = rest - rest.mean()
    lags = min(CORRELATION_LAGS, centred.size // 4)
    power = float(centred @ centred)
    if power <= 0.0:
        return 1.0
    rho = np.array([float(centred[k:] @ centred[: centred.size - k]) for k in range(1, lags)])
    return 1.0 + 2.0 * float(np.sum((rho / power) ** 2))


def _noise(seen: Observed, simulated: FloatArray) -> ChannelNoise:
    return estimate_channel_noise(seen.left_by(simulated), seen.lag)
