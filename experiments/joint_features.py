"""What the check between snapshots without a bench rests on, and how well it does.

    python experiments/joint_features.py bounds      # a minute
    python experiments/joint_features.py alarms --pairs 100

``bounds``: how far a gap that grows from 0.3 to 3 mrad moves each quantity that is compared, over
benches drawn around the reference one. ``alarms``: how often a pair of recordings is called
different, of an unchanged joint whose gap grew, and of one in which something else changed.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.signal import lfilter
from study_tools import without_current

from bayesbl.bench.bench import Bench
from bayesbl.config.bench import load_bench
from bayesbl.curve.sweep import SweepSettings, sweep_nominal
from bayesbl.measurement.same_joint import MEAN_CURRENT, features, harmonic_name, same_joint
from bayesbl.recording.repetition import folded
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED
from bayesbl.ringing.estimator import Estimator, PointEstimate
from bayesbl.ringing.symbols import DECAY, FREQUENCY

BENCH = Path(__file__).resolve().parents[1] / "configs" / "bench.toml"
FACTOR = 1.65
"""Benches are drawn log-uniformly within it."""

DRAWN = (
    "motor_inertia_kg_m2",
    "load_inertia_kg_m2",
    "shaft_stiffness_nm_per_rad",
    "shaft_damping_nm_s_per_rad",
    "gravity_torque_nm",
    "speed_gain_nm_s_per_rad",
    "integral_gain_nm_per_rad",
)
CHANGES: dict[str, dict[str, float]] = {
    "nothing": {},
    "payload × 1.1": {"gravity_torque_nm": 1.1, "load_inertia_kg_m2": 1.1},
    "payload × 2, inertia × 1.5": {"gravity_torque_nm": 2.0, "load_inertia_kg_m2": 1.5},
    "K_s − 10 %": {"shaft_stiffness_nm_per_rad": 0.9},
    "K_p − 10 %": {"speed_gain_nm_s_per_rad": 0.9},
    "K_p − 30 %": {"speed_gain_nm_s_per_rad": 0.7},
    "K_i − 10 %": {"integral_gain_nm_per_rad": 0.9},
    "K_t − 5 %": {"torque_constant_nm_per_a": 0.95},
    "D_s − 30 %": {"shaft_damping_nm_s_per_rad": 0.7},
}
MEANS_S = (0.01, 0.02, 0.04)
"""Of the speed with its noise, formed in the first recording and no longer in the second."""


def bounds(benches: int) -> None:
    """Largest slopes and shares over the benches."""
    reference, generator = load_bench(BENCH), np.random.default_rng(3)
    model = Estimator().model
    settings = SweepSettings(3e-4, 3e-3, count=10, start_angles=2, rotations=2.0)
    slopes, shares, sampling = [], [], []
    for number in range(benches):
        reach = math.log(FACTOR) if number else 0.0
        bench = _multiplied(
            reference, {n: math.exp(generator.uniform(-reach, reach)) for n in DRAWN}
        )
        row = sweep_nominal(bench, model, settings, np.random.default_rng(1))
        logs = [
            np.log(values.mean(axis=1))
            for values in (row.amplitude_rpm, row.symbol(FREQUENCY, {}), row.symbol(DECAY, {}))
        ]
        amplitude, *others = (np.diff(values) for values in logs)
        slopes.append([np.abs(other / amplitude).max() for other in others])
        shares.append(_shares(bench))
        sampling.append(_by_sampling(bench))
    frequency, decay = np.max(slopes, axis=0)
    print(f"largest |d ln / d ln A|: frequency {frequency:.2f}, decay {decay:.2f}")
    current, speed = np.abs(shares).max(axis=0)
    print(f"largest shares of the first order: current {current:.2%}, speed {speed:.2%}")
    frequency, decay = np.max(sampling, axis=0)
    print(f"largest |change of ln| per (ω T)²: frequency {frequency:.3f}, decay {decay:.3f}")
    for rotations in (2.0, 5.0):
        settings = SweepSettings(3e-4, 3e-3, count=8, start_angles=8, rotations=rotations)
        row = sweep_nominal(reference, model, settings, np.random.default_rng(1))
        sds = [np.log(row.symbol(s, {})).std(axis=1, ddof=1).max() for s in (FREQUENCY, DECAY)]
        print(f"scatter over start angles, {rotations:g} rotations: ln ω {sds[0]:.4f}, "
              f"ln τ {sds[1]:.4f}")  # fmt: skip


def alarms(pairs: int, *, with_current: bool) -> None:
    """Share of pairs called different, for every change."""
    bench = load_bench(BENCH)
    changes = {name: (_multiplied(bench, factors), 0.0) for name, factors in CHANGES.items()}
    changes |= {f"no mean over {1e3 * mean_s:g} ms": (bench, mean_s) for mean_s in MEANS_S}
    for name, (second, mean_s) in changes.items():
        called = 0
        for pair in range(pairs):
            generator = np.random.default_rng([17, pair])
            gap = math.exp(generator.uniform(math.log(4e-4), math.log(2e-3)))
            points = [
                _point(made, gap * growth, generator, with_current, smoothed_s)
                for made, growth, smoothed_s in ((bench, 1.0, mean_s), (second, 1.3, 0.0))
            ]
            called += not same_joint(points, (False, False))["agrees"]
        print(f"{name:28s} {called} of {pairs} called different", flush=True)


def _point(
    bench: Bench,
    gap_rad: float,
    generator: np.random.Generator,
    with_current: bool,
    mean_s: float,
) -> PointEstimate:
    angle = generator.uniform(0.0, 2.0 * math.pi)
    recording = bench.simulate(
        gap_rad, rotations=5.0, start_angle_rad=angle, seed=generator, name="made"
    )
    width = max(1, round(mean_s / recording.sampling_period_s))
    speed = recording.motor_speed_rpm
    smoothed = lfilter(np.full(width, 1.0 / width), [1.0], speed - speed[0]) + speed[0]
    recording = replace(recording, channels={**recording.channels, MOTOR_SPEED: smoothed})
    if not with_current:
        recording = without_current(recording)
    return Estimator().estimate(recording, np.random.SeedSequence(1))


def _shares(bench: Bench) -> tuple[float, float]:
    """Largest change of a mean or load order as a share of the first, of current and speed."""
    found = []
    for gap_rad in (3e-4, 3e-3):
        recording = bench.simulate(gap_rad, rotations=2.3, start_angle_rad=0.3)
        per_rotation = bench.rotation_period_s() / recording.sampling_period_s
        signals = (recording.motor_speed_rpm, recording.channels[MOTOR_CURRENT])
        rotations = np.stack([folded(signal, per_rotation) for signal in signals])
        made = features(rotations, recording.sampling_period_s)
        found.append({feature.name: feature.value for feature in made})
    first, last = found
    largest = {
        channel: max(
            abs(last[name] - first[name]) / first[harmonic_name(channel, 1)]
            for name in (*extra, harmonic_name(channel, 1), harmonic_name(channel, 2))
        )
        for channel, extra in (("current", (MEAN_CURRENT,)), ("speed", ()))
    }
    return largest["current"], largest["speed"]


def _by_sampling(bench: Bench) -> tuple[float, float]:
    """Largest share by which coarser samples move ω and τ, per square of the angle between two."""
    logs: dict[float, tuple[float, float]] = {}
    for rate_hz in (1000.0, 250.0, 125.0):
        made = bench.simulate(8e-4, rotations=5.3, start_angle_rad=0.3, sampling_hz=rate_hz)
        centre, _ = Estimator().estimate(made, np.random.SeedSequence(1)).ringing
        logs[rate_hz] = (centre[1], centre[2])
    frequency, decay = (
        max(
            abs(logs[rate_hz][place] - logs[1000.0][place])
            / (math.exp(2.0 * logs[1000.0][0]) * (rate_hz**-2.0 - 1e-6))
            for rate_hz in (250.0, 125.0)
        )
        for place in (0, 1)
    )
    return frequency, decay


def _multiplied(bench: Bench, factors: dict[str, float]) -> Bench:
    return bench.with_parameters(**{n: f * bench.value(n) for n, f in factors.items()})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=("bounds", "alarms"))
    parser.add_argument("--benches", type=int, default=25)
    parser.add_argument("--pairs", type=int, default=100)
    parser.add_argument("--without-current", action="store_true")
    wanted = parser.parse_args()
    if wanted.part == "bounds":
        bounds(wanted.benches)
    else:
        alarms(wanted.pairs, with_current=not wanted.without_current)
