"""The bench that a configuration names for its joint."""

from __future__ import annotations

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.config.bench import load_bench
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.errors import BenchError, ConfigError

GEAR_RATIOS_APART = 0.01
"""Largest relative difference between the joint's gear ratio and its bench's."""


def bench_of(config: SnapshotConfig) -> Bench:
    """The bench of the joint.

    Raises
    ------
    ConfigError
        If there is none, or it has no gap to measure.
    """
    file = config.estimator.bench
    if file is None:
        raise ConfigError("This route needs a bench.", expected="--bench FILE")
    bench = load_bench(file)
    if bench.drive == "rigid":
        raise ConfigError(
            "A rigid bench has no gap to measure.",
            file=file,
            found='drive = "rigid"',
            expected='drive = "two_mass"',
        )
    stated, known = config.joint.gear_ratio, bench.value("gear_ratio")
    if stated is not None and abs(stated / known - 1.0) > GEAR_RATIOS_APART:
        raise ConfigError(
            "The joint's gear ratio is not that of its bench.",
            where="[joint] gear_ratio",
            found=f"{stated:g}, and {known:g} in {file}",
            expected="the same in both",
        )
    low, high = config.estimator.gap_rad
    try:
        bench.simulate_many(np.array([low, high]), rotations=0.1)
    except BenchError as error:
        raise BenchError(
            f"The bench cannot be simulated at the ends of the range of gaps. {error.problem}",
            file=file,
            where="[estimator] gap_rad",
            found=error.found,
            expected=error.expected,
        ) from None
    return bench
