"""Check that recordings, estimator, gap curve, gear ratio and limit belong together.

Also read the bench that a configuration names for its joint, with the parameter values that the
configuration overrides.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.effects import EFFECT_BY_NAME, effect_named
from bayesbl.bench.parameters import PARAMETER_INFO
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.curve.gap_curve import GapCurve
from bayesbl.errors import BenchError, ConfigError, CurveError, RecordingError
from bayesbl.measurement.measurement import Reason
from bayesbl.recording.types import Recording
from bayesbl.results.identified import bench_from, require_gap
from bayesbl.ringing.estimator import Estimator, Fit, nominal_speed_rpm
from bayesbl.ringing.symbols import ROTATION

GEAR_RATIOS_APART = 0.01
"""Largest relative difference between the joint's gear ratio and that of its bench."""

LASTING = {
    "gear_ratio": "the one of the bench file: a gear keeps its ratio",
    "reference_speed_rpm": "reference_speed_rpm under [[recordings]], which is what it belongs to",
}
"""Parameters that cannot have a value per recording, and where to state them instead."""


def bench_of(config: SnapshotConfig) -> Bench:
    """Read and check the bench of the joint.

    Raises ConfigError if there is no bench, it has no gap to measure, or it lacks a parameter that
    may drift, and BenchError if the bench of a recording makes no physical sense, or cannot be
    simulated.
    """
    file = config.estimator.bench
    if file is None:
        raise ConfigError("This route needs a bench.", expected="--bench FILE")
    bench = bench_from(file)
    require_gap(bench, file)
    configured, of_bench = config.joint.gear_ratio, bench.value("gear_ratio")
    if configured is not None and abs(configured / of_bench - 1.0) > GEAR_RATIOS_APART:
        raise ConfigError(
            "The joint's gear ratio is not that of its bench.",
            where="[joint] gear_ratio",
            found=f"{configured:g}, and {of_bench:g} in {file}",
            expected="the same in both",
        )
    for name in config.joint.drift:
        if name not in EFFECT_BY_NAME:
            _require_changeable(bench, name, "[joint] drift")
    for entry in config.recordings:
        where = f"[[recordings]] bench of {entry.name}"
        for name in entry.bench:
            _require_changeable(bench, name, where)
        try:
            bench_with(bench, entry.bench)
        except BenchError as error:
            raise error.at(BenchError, f"{where}, ") from None
    low, high = config.estimator.gap_rad
    try:
        bench.simulate_many(np.array([low, high]), rotations=0.1)
    except BenchError as error:
        error.problem = (
            f"The bench cannot be simulated at the ends of the range of gaps. {error.problem}"
        )
        raise error.at(BenchError, "[estimator] gap_rad, ", file) from None
    return bench


def bench_with(bench: Bench, known: Mapping[str, float]) -> Bench:
    """Replace the values of parameters and of effects' parameters (``effect.parameter``).

    Raises BenchError if a value makes no physical sense.
    """
    effects = []
    for effect in bench.effects:
        own = {
            name.partition(".")[2]: EffectParameterValue(value)
            for name, value in known.items()
            if name.partition(".")[0] == effect.name
        }
        effects.append(BenchEffect(effect.name, {**effect.parameters, **own}))
    parameters = {name: value for name, value in known.items() if "." not in name}
    return bench.with_effects(*effects).with_parameters(**parameters)


def _require_changeable(bench: Bench, name: str, where: str) -> None:
    """Refuse a parameter that cannot have a value per recording."""
    if name in LASTING:
        raise ConfigError(
            "This parameter cannot change here.", where=where, found=name, expected=LASTING[name]
        )
    amplitudes = {
        f"{effect.name}.{parameter.name}"
        for effect in bench.effects
        for parameter in effect_named(effect.name).amplitudes
    }
    changeable = [name for name in PARAMETER_INFO if name not in LASTING]
    if name not in amplitudes | set(changeable):
        raise ConfigError(
            "The bench has no such parameter.",
            where=where,
            found=name,
            expected="one of "
            + ", ".join([*changeable, *sorted(amplitudes)])
            + ", or of an effect that the bench file has",
        )


SNAPSHOTS_APART = 0.02
"""Largest relative difference in speed between snapshots. On the published bench, a relative error
of the speed changes δ by its power :data:`SPEED_POWER`. This tolerance moves a change of δ by at
most 1 % of δ."""

CURVE_APART = 0.05
"""Largest relative difference in speed between a recording and a curve of another bench. Such a
curve is wrong by about as much anyway."""

SPEED_POWER = 0.4
"""d ln δ/d ln v at a given amplitude on the reference bench: 0.28 at 0.2 mrad, 0.57 at 3.5 mrad.
From ``python experiments/speed_power.py``. The value near 0.5 mrad is 0.4. It predicts the error,
reported as "some … %", to within half of itself everywhere in that range."""

ROTATION_APART = 0.03
"""Largest relative difference between the fitted load rotation and that by speed and gear ratio."""

SPEED_TOLERANCE = 0.01
"""Largest relative difference in speed between a recording and the curve that δ is read from.

With a power of at most 0.57 (see :data:`SPEED_POWER`) this moves δ by at most 0.6 %. That is no
more than the lack of fit allowed for a curve, and a quarter of the 2 % to which an amplitude
determines δ.
"""

SPEED = "nominal_speed_rpm"
"""Entry of a fingerprint that is compared within a tolerance, not digit by digit."""

LIMIT_BEYOND = 10.0
"""A limit outside the range of measurable gaps by more than this factor is taken for a mistake."""


def limit_rad_of(config: SnapshotConfig) -> float | None:
    """The limit of δ, rad, however it is stated; ``None`` without one.

    Raises ConfigError if the joint's wind-up is not known, or leaves no room for a gap.
    """
    limit = config.joint.limit
    return config.joint.limit_rad if limit is None else limit.delta_rad(windup_rad_of(config))


def windup_rad_of(config: SnapshotConfig) -> float:
    """Wind-up, both ways, at the torque of a limit of lost motion, rad; 0 without such a limit."""
    joint, bench = config.joint, config.estimator.bench
    if joint.limit is None:
        return 0.0
    stiffness = None
    if joint.limit.of == "lost_motion" and bench is not None:
        shaft_bench = bench_from(bench)
        if shaft_bench.drive != "rigid":
            stiffness = shaft_bench.parameters["shaft_stiffness_nm_per_rad"].value
    return joint.limit.windup_rad(joint.rated_torque_nm, stiffness)


def require_plausible_limit(limit_rad: float | None, range_rad: tuple[float, float] | None) -> None:
    """Refuse a limit far outside the range of measurable gaps: most likely another unit."""
    if limit_rad is None or range_rad is None:
        return
    low, high = range_rad
    if low / LIMIT_BEYOND <= limit_rad <= LIMIT_BEYOND * high:
        return
    raise ConfigError(
        "The limit is far from any gap that can be measured in this joint.",
        where="limit_rad",
        found=f"{limit_rad:g} rad = {1e3 * limit_rad:.4g} mrad",
        expected=f"a limit near {1e3 * low:.3g} to {1e3 * high:.3g} mrad, given in rad "
        "(1.2e-3 = 1.2 mrad)",
    )


def require_different(recordings: Sequence[Recording]) -> None:
    """Refuse two files that are identical byte for byte, by :class:`RecordingError`.

    A change between them would mean nothing.
    """
    names: dict[str, str] = {}
    for recording in recordings:
        if recording.source is None:
            continue
        first = names.setdefault(recording.source.sha256, recording.name)
        if first != recording.name:
            raise RecordingError(
                f"{first} and {recording.name} are one and the same recording, so no change "
                "between them means anything. Was a file copied by mistake?",
                file=recording.place,
                found="two files alike to the last byte",
                expected="another recording",
            )


def require_same_estimator(curve: GapCurve, estimator: Estimator, recording: Recording) -> None:
    """Require that curve and fit define A alike; raise :class:`CurveError` with the difference."""
    if curve.fingerprint is None:
        return
    of_fit, of_curve = json.loads(estimator.fingerprint(recording)), json.loads(curve.fingerprint)
    # A fingerprint rounds the speed to two digits; the curve's file also has all of them.
    of_fit[SPEED] = nominal_speed_rpm(recording)
    of_curve[SPEED] = curve.reference_speed_rpm or of_curve[SPEED]
    different = {k for k in {*of_fit, *of_curve} if of_fit.get(k) != of_curve.get(k)}
    if abs(of_fit[SPEED] / of_curve[SPEED] - 1.0) <= SPEED_TOLERANCE:
        different.discard(SPEED)

    def entry(key: str, fingerprint: Mapping[str, object]) -> str:
        if key not in fingerprint:
            return f"no {key}"
        value = fingerprint[key]
        return f"{key} = {value:.6g}" if isinstance(value, float) else f"{key} = {value}"

    if different:
        names = sorted(different)
        problem = (
            "This gap curve was swept at another speed, where the same gap rings differently."
            if names == [SPEED]
            else "This gap curve was made with another estimator, so it means another amplitude."
        )
        raise CurveError(
            problem,
            file=curve.name,
            where=", ".join(names),
            found="; ".join(f"{entry(k, of_curve)} in the curve" for k in names),
            expected="; ".join(f"{entry(k, of_fit)} as in {recording.name}" for k in names),
        )


def require_one_speed_of_all(recordings: Sequence[Recording]) -> None:
    """Require that all snapshots have one speed, in either direction.

    Raises RecordingError if not: the same gap rings differently at another speed, and that would
    pass for wear.
    """
    first = recordings[0]
    for other in recordings[1:]:
        speeds = nominal_speed_rpm(first), nominal_speed_rpm(other)
        if max(speeds) > (1.0 + SNAPSHOTS_APART) * min(speeds):
            raise RecordingError(
                "The snapshots were recorded at different speeds, and the same gap rings "
                "differently at another speed: that would pass for wear.",
                file=other.place,
                where="motor_speed_rpm",
                found=f"{speeds[1]:.5g} rpm on average, but {speeds[0]:.5g} rpm in {first.name}",
                expected=f"speeds within {100.0 * SNAPSHOTS_APART:g} %, in one unit; record at the "
                'same speed, or give a bench: bench = "bench.toml" (--bench bench.toml)',
            )


def other_speed(recording: Recording, curve: GapCurve) -> Reason | None:
    """Why a curve of another speed gives no gap; ``None`` if the speeds agree."""
    if curve.reference_speed_rpm is None:
        return None
    speed = nominal_speed_rpm(recording)
    ratio = speed / curve.reference_speed_rpm
    if abs(ratio - 1.0) <= CURVE_APART:
        return None
    values = {
        "curve_rpm": curve.reference_speed_rpm,
        "recording_rpm": speed,
        "relative_error": ratio**SPEED_POWER - 1.0,
    }
    return Reason("other_speed", values)


def unsuited(
    recording: Recording, fit: Fit, curve: GapCurve | None, config: SnapshotConfig
) -> Iterator[Reason]:
    """Yield why recording, estimator, curve and gear ratio do not belong together."""
    found_s, speed = fit.point.optimum.symbols[ROTATION], nominal_speed_rpm(recording)
    if (gear_ratio := config.joint.gear_ratio) is not None:
        expected_s = 60.0 * gear_ratio / speed
        if abs(found_s / expected_s - 1.0) > ROTATION_APART:
            values = {
                "rotation_s": found_s,
                "expected_s": expected_s,
                "gear_ratio": gear_ratio,
                "speed_rpm": speed,
                "fitting_ratio": found_s * speed / 60.0,
            }
            yield Reason("other_rotation", values)
    if curve is not None and not config.curve.allow_extrapolation:
        against = other_speed(recording, curve)
        yield from () if against is None else (against,)
