"""The bench that a configuration names for its joint, and what it knows beside that file."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.effects import effect_named
from bayesbl.bench.parameters import PARAMETER_INFO
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.errors import BenchError, ConfigError
from bayesbl.results.identified import bench_from

GEAR_RATIOS_APART = 0.01
"""Largest relative difference between the joint's gear ratio and its bench's."""

LASTING = {
    "gear_ratio": "the one of the bench file: a gear keeps its ratio",
    "reference_speed_rpm": "reference_speed_rpm under [[recordings]], which is what it belongs to",
}
"""Parameters that no recording has a value of its own of here, and where they belong."""


def bench_of(config: SnapshotConfig) -> Bench:
    """The bench of the joint.

    Raises
    ------
    ConfigError
        If there is none, it has no gap to measure, or lacks what may drift.
    BenchError
        If a recording is said to have a bench that makes no sense, or none can be simulated.
    """
    file = config.estimator.bench
    if file is None:
        raise ConfigError("This route needs a bench.", expected="--bench FILE")
    bench = bench_from(file)
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
    drifts_of(config, bench)
    for entry in config.recordings:
        where = f"[[recordings]] bench of {entry.name}"
        for name in entry.bench:
            _require_changeable(bench, name, where)
        try:
            bench_with(bench, entry.bench)
        except BenchError as error:
            # The error names the parameter.
            raise BenchError(
                error.problem,
                where=f"{where}, {error.where}" if error.where else where,
                found=error.found,
                expected=error.expected,
            ) from None
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


def bench_with(bench: Bench, known: Mapping[str, float]) -> Bench:
    """The bench with other values of parameters and of ``effect.parameter``.

    Raises
    ------
    BenchError
        If a value makes no physical sense.
    """
    effects = [
        BenchEffect(
            present.name,
            {
                **present.parameters,
                **{
                    name.partition(".")[2]: EffectParameterValue(value)
                    for name, value in known.items()
                    if name.partition(".")[0] == present.name
                },
            },
        )
        for present in bench.effects
    ]
    own = {name: value for name, value in known.items() if "." not in name}
    return bench.with_effects(*effects).with_parameters(**own)


def drifts_of(config: SnapshotConfig, bench: Bench) -> dict[str, float]:
    """Half-width of what may drift between snapshots, by name, in each parameter's unit."""
    found = {}
    for name, drift in config.joint.may_drift.items():
        _require_changeable(bench, name, "[joint] may_drift")
        found[name] = drift.half_width(bench.value(name))
        if found[name] == 0.0:
            raise ConfigError(
                "A share of zero is no drift.",
                where=f"[joint] may_drift, {name}",
                found="relative_tolerance, and a value of 0 in the bench",
                expected="tolerance, in the parameter's unit",
            )
    return found


def _require_changeable(bench: Bench, name: str, where: str) -> None:
    """Refuse what no recording can have a value of its own of."""
    if name in LASTING:
        raise ConfigError(
            "This parameter cannot change here.", where=where, found=name, expected=LASTING[name]
        )
    own = {
        f"{present.name}.{parameter.name}"
        for present in bench.effects
        for parameter in effect_named(present.name).amplitudes
    }
    changeable = [name for name in PARAMETER_INFO if name not in LASTING]
    if name not in own | set(changeable):
        raise ConfigError(
            "The bench has no such parameter.",
            where=where,
            found=name,
            expected="one of "
            + ", ".join([*changeable, *sorted(own)])
            + ", or of an effect that the bench file has",
        )
