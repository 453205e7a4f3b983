"""Recordings spoiled as real ones are: samples that were lost, a speed that drifts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.recording.lost_samples import bridge
from bayesbl.recording.types import MOTOR_SPEED, Recording

FINER = 10
"""How many times finer a steady recording is sampled that a drifting one is read from."""


def with_samples_lost(
    recording: Recording, share: float, generator: np.random.Generator
) -> Recording:
    """A recording as it is read in after each sample was lost with probability ``share``.

    Raises
    ------
    RecordingError
        If more is lost than a reader bridges.
    """
    names = list(recording.channels)
    values = np.column_stack([recording.channels[name] for name in names])
    values[generator.uniform(size=recording.samples) < share] = np.nan
    bridged = bridge(Path(recording.name), recording.time_s, values, lambda row, _: f"sample {row}")
    return replace(
        recording,
        time_s=bridged.time_s,
        channels=dict(zip(names, bridged.values.T, strict=True)),
        excluded=bridged.excluded,
        notes=(*recording.notes, *bridged.notes),
    )


def drifting(
    bench: Bench,
    gap_rad: float,
    drift_share: float,
    generator: np.random.Generator,
    *,
    rotations: float,
    sampling_hz: float,
    start_angle_rad: float,
) -> Recording:
    """Motor speed whose mean grows by ``drift_share`` of itself from begin to end.

    The drift is slow against the ringing, so everything happens as at constant speed, when the
    load reaches the angle at which it happens.
    """
    steady = bench.simulate(
        gap_rad,
        rotations=rotations + 0.1,
        sampling_hz=FINER * sampling_hz,
        start_angle_rad=start_angle_rad,
    )
    samples = bench.samples(rotations, sampling_hz)
    time_s = np.arange(samples) / sampling_hz
    drift = drift_share * (time_s / time_s[-1] - 0.5)
    ahead_s = np.concatenate(([0.0], np.cumsum(drift[1:] + drift[:-1]))) * (0.5 / sampling_hz)
    reached_s = time_s + ahead_s
    speed = np.interp(reached_s - reached_s.min(), steady.time_s, steady.motor_speed_rpm)
    speed += drift * bench.value("reference_speed_rpm")
    speed += bench.measurement.speed_noise.draw(samples, generator)
    return Recording("drifting", time_s, {MOTOR_SPEED: speed})
