"""Check from the recordings alone that only the gap changed between snapshots.

Compared are quantities that the gap changes little or not at all: the controller's gains, the mean
current, the first two load orders of current and speed, the frequency and decay of the ringing. The
difference of each is reduced by the largest effect of a changed gap before it is compared with its
standard error. For the ringing, this effect is that of the user's own bench, by its curve; without
a bench, the largest over benches around the reference. Without a current, only the colour of the
noise shows a changed filter of the speed.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesbl.curve.gap_curve import GapCurve
from bayesbl.measurement.compatibility import SNAPSHOTS_APART
from bayesbl.measurement.joint_features import (
    INTEGRAL,
    MEAN_CURRENT,
    PROPORTIONAL,
    Feature,
    features_of,
    harmonic_name,
)
from bayesbl.measurement.measurement import (
    CheckItem,
    JointCheck,
    Reason,
    blind_spot,
    check_item,
    joint_check,
)
from bayesbl.measurement.noise_colour import (
    FilterChange,
    NoiseSpectrum,
    filter_change,
    noise_spectrum,
)
from bayesbl.probabilities import FALSE_ALARM, normal_isf
from bayesbl.recording.types import MOTOR_CURRENT, FloatArray
from bayesbl.ringing.cleaning import MotorLine
from bayesbl.ringing.estimator import PointEstimate, nominal_speed_rpm

FREQUENCY, DECAY = "ringing frequency", "ringing decay"
FILTER = "share of the ringing that is recorded"
"""Its logarithm is compared, from the noise of the first snapshot and of another."""

RINGING = ((FREQUENCY, "Hz", 2.0 * math.pi), (DECAY, "1/s", 1.0))
"""Name and unit of ω and τ, and what that unit is in rad/s or 1/s."""

LINE = "line of the motor in the speed"
"""Ripple, or error of transmission or encoder, that stands out in the speed."""

HARMLESS_SD = 0.5
"""Harmless bias, in standard deviations: a 90 % interval then covers in 86 % of cases."""

BY_AMPLITUDE = {FREQUENCY: 0.1, DECAY: 0.5}
"""Largest ∂ln quantity/∂ln A along the gap, over benches within a factor of 1.6 of the reference
and gaps of 0.3 to 3 mrad (0.09 and 0.47, ``experiments/joint_features.py``). Without a bench."""

BY_GAP = {"current": 0.0025, "speed": 0.005}
"""Change of a load order, or of the mean, by 2.7 mrad more gap, as a share of the first order: the
load jumps by twice the gap at each change of flank, the second order by 8/(3π) of that angle (0.23
and 0.46 %, same command)."""

BY_SPEED = 2.0
"""Highest power of the speed in a quantity; the speeds of snapshots may differ by 2 %."""

BY_SAMPLING = {FREQUENCY: 0.15, DECAY: 0.41}
"""Largest relative error of a fit with sampling period T, per (ω T)², over the same benches at 125
and 250 Hz (0.149 and 0.408, same command)."""

SAME_RATE = 0.01
"""Relative difference up to which two sampling rates show the same noise."""

START_ANGLE_SD = {FREQUENCY: 0.0015, DECAY: 0.002}
"""Scatter of ln quantity with the start angle on the reference bench (same command), without a
bench."""

COULD_BE = {
    PROPORTIONAL: ("speed_gain_nm_s_per_rad", "torque_constant_nm_per_a", "speed_averaging"),
    INTEGRAL: ("integral_gain_nm_per_rad", "torque_constant_nm_per_a"),
    MEAN_CURRENT: ("motor_coulomb_friction", "motor_viscous_friction", "load_coulomb_friction"),
    harmonic_name("current", 1): ("gravity_torque_nm", "torque_constant_nm_per_a"),
    harmonic_name("current", 2): ("gear_mesh_friction", "load_torque_offset"),
    harmonic_name("speed", 1): ("gravity_torque_nm", "integral_gain_nm_per_rad"),
    harmonic_name("speed", 2): ("integral_gain_nm_per_rad", "gear_mesh_friction"),
    FREQUENCY: (
        "load_inertia_kg_m2",
        "shaft_stiffness_nm_per_rad",
        "speed_gain_nm_s_per_rad",
        "integral_gain_nm_per_rad",
        "speed_sensor_lag",
    ),
    DECAY: ("shaft_damping_nm_s_per_rad", "speed_gain_nm_s_per_rad", "speed_sensor_lag"),
    FILTER: ("speed_averaging", "speed_sensor_lag"),
    LINE: ("gear_transmission_error", "motor_torque_ripple", "encoder_eccentricity"),
}
"""Parameters and effects of the joint that would move each quantity."""

SHOWN_BEST = (DECAY, FREQUENCY, PROPORTIONAL, INTEGRAL, harmonic_name("current", 1))
"""Quantities whose smallest detectable change is reported, those of the ringing first."""


@dataclass(frozen=True, slots=True)
class _Snapshot:
    """The compared quantities of one snapshot."""

    name: str
    features: dict[str, Feature]
    log_amplitude: float
    log_amplitude_sd: float
    log_speed: float
    direction: float
    period_s: float
    noise: NoiseSpectrum | None
    lines: Mapping[int, MotorLine]
    by_bench: Mapping[str, FloatArray]
    """ln of each quantity of the ringing at the amplitude, by draws of the bench, (m,)."""

    @classmethod
    def of(cls, point: PointEstimate, curve: GapCurve | None) -> _Snapshot:
        centre, covariance = point.ringing
        by_bench: dict[str, FloatArray] = {}
        by_start_angle = START_ANGLE_SD
        if curve is not None and curve.ringing is not None:
            expected, scatter, _ = curve.ringing_at(centre[0])
            tables = curve.ringing.frequency_draws, curve.ringing.decay_draws
            for name, log, draws in zip(BY_AMPLITUDE, expected, tables, strict=True):
                rows = np.arange(len(draws))
                by_bench[name] = log + curve.at_rows(draws, rows, np.full(len(draws), centre[0]))
            sds = np.sqrt(np.diag(scatter)[1:]).tolist()
            by_start_angle = dict(zip(BY_AMPLITUDE, sds, strict=True))
        features = {feature.name: feature for feature in features_of(point)}
        for index, (name, unit, scale) in enumerate(RINGING, start=1):
            sd = math.sqrt(covariance[index, index])
            if sd > 0.0:  # a fixed symbol was not measured
                value = math.exp(centre[index]) / scale
                sd = math.hypot(sd, by_start_angle[name])
                features[name] = Feature(name, unit, value, value * sd)
        recording = point.recording
        return cls(
            recording.name,
            features,
            math.log(centre[0]),
            math.sqrt(covariance[0, 0]) / centre[0],
            math.log(nominal_speed_rpm(recording)),
            float(np.sign(recording.motor_speed_rpm.mean())),
            recording.sampling_period_s,
            noise_spectrum(point),
            {line.order: line for line in point.lines},
            by_bench,
        )


def same_joint(
    points: Sequence[PointEstimate],
    repaired: Sequence[bool],
    stated: Sequence[Hashable] | None = None,
    curves: Sequence[GapCurve | None] | None = None,
) -> JointCheck:
    """Compare every snapshot with the first comparable one since the last repair.

    Parameters
    ----------
    repaired
        Whether each snapshot is the first one after a repair.
    stated
        What the user states of each snapshot; only snapshots with equal statements are compared.
    curves
        Curve of each snapshot, for its speed and sampling rate.
    """
    if len(points) < 2:
        return joint_check()
    pairs: list[_Pair] = []
    first: dict[Hashable, _Snapshot] = {}
    nothing = [None] * len(points)
    for point, after_repair, statement, curve in zip(
        points, repaired, stated or nothing, curves or nothing, strict=True
    ):
        snapshot = _Snapshot.of(point, curve)
        if after_repair:
            first.clear()
        if statement in first:
            pairs.append(_Pair(first[statement], snapshot))
        else:
            first[statement] = snapshot
    compared = sum(len(p.items) + (not p.shows_gains) + len(p.lines) for p in pairs)
    if not compared:
        return joint_check()
    bound = normal_isf(0.5 * FALSE_ALARM / compared)
    filters = [pair.filter_change(bound) for pair in pairs]
    items, changed = [], []
    for pair, change in zip(pairs, filters, strict=True):
        where = {"recording": pair.other.name} if len(pairs) > 1 else {}
        for item, finding in pair.findings(change, bound):
            items.append(item)
            if finding is not None:
                changed.append((item["quantity"], {**finding, **where}))
    blind = [*_too_small(pairs, bound), *_filters_unseen(pairs, filters)]
    if not all(MOTOR_CURRENT in point.recording.channels for point in points):
        blind = [blind_spot("gains_unseen"), *blind]
    return joint_check(
        not changed,
        items,
        (cause for quantity, _ in changed for cause in COULD_BE[quantity]),
        [finding for _, finding in changed],
        blind,
    )


def change_reason(check: JointCheck) -> Reason | None:
    """Why the change of a gap by a curve is withheld; ``None`` if it is not."""
    return None if check["agrees"] else Reason("joint_changed", {"also": check["findings"]})


@dataclass(frozen=True, slots=True)
class _Pair:
    """Two snapshots that are compared."""

    first: _Snapshot
    other: _Snapshot

    @property
    def shows_gains(self) -> bool:
        """Whether the control law shows a filter of the speed, better than the noise does."""
        return all(PROPORTIONAL in each.features for each in (self.first, self.other))

    @property
    def change(self) -> float:
        """Change of ln A."""
        return self.other.log_amplitude - self.first.log_amplitude

    @property
    def change_sd(self) -> float:
        return math.hypot(self.first.log_amplitude_sd, self.other.log_amplitude_sd)

    @property
    def harmless(self) -> float:
        """Largest bias of ln A that leaves an interval valid."""
        return HARMLESS_SD * self.change_sd

    @property
    def items(self) -> list[CheckItem]:
        """One item for each feature that both snapshots have."""
        items = []
        for name, before in self.first.features.items():
            after = self.other.features.get(name)
            reversed_direction = self.first.direction != self.other.direction
            # If the direction changed, so did the sign of a constant torque.
            if after is None or (name == MEAN_CURRENT and reversed_direction):
                continue
            difference, possible = after.value - before.value, self.possible(name)
            difference -= min(max(difference, min(possible, 0.0)), max(possible, 0.0))
            beyond = max(abs(difference) - self.explained(name), 0.0)
            z = math.copysign(beyond, difference) / self.sd(name)
            items.append(check_item(name, after.value, before.value, before.unit, z))
        return items

    @property
    def lines(self) -> dict[int, CheckItem]:
        """One item for each line of the motor, by its order; a missing line has amplitude 0."""
        if abs(self.other.log_speed - self.first.log_speed) > SNAPSHOTS_APART:
            return {}
        items = {}
        for order in sorted({*self.first.lines, *self.other.lines}):
            no_line = MotorLine(order, 0.0, 0.0)
            before, after = (each.lines.get(order, no_line) for each in (self.first, self.other))
            sd = math.hypot(before.standard_error_rpm, after.standard_error_rpm)
            z = (after.size_rpm - before.size_rpm) / sd if sd > 0.0 else 0.0
            items[order] = check_item(LINE, after.size_rpm, before.size_rpm, "rpm", z)
        return items

    def filter_change(self, bound: float) -> FilterChange | None:
        """The filter change by the noise; ``None`` if gains show it better or the rates differ.

        At another sampling rate, another part of the noise is aliased.
        """
        first, other = self.first, self.other
        same_rate = abs(math.log(other.period_s / first.period_s)) < SAME_RATE
        if self.shows_gains or first.noise is None or other.noise is None or not same_rate:
            return None
        return filter_change(first.noise, other.noise, bound)

    def findings(
        self, change: FilterChange | None, bound: float
    ) -> Iterator[tuple[CheckItem, dict[str, Any] | None]]:
        """Yield each item with its finding; ``None`` if the difference is chance or harmless."""
        for item in self.items:
            significant = abs(item["z"]) > bound
            yield item, {"code": "quantity_changed", **_values(item)} if significant else None
        if change is not None:
            shift = change.log_amplitude
            item = check_item(FILTER, math.exp(shift), 1.0, "", change.deviations)
            significant = abs(item["z"]) > bound and abs(shift) > self.harmless
            smallest = math.expm1(change.low if shift > 0.0 else change.high)
            yield item, {"code": "filter_changed", "least_share": smallest} if significant else None
        for order, item in self.lines.items():
            # A ripple that repeats with the motor also acts when the teeth meet. It changes their
            # speed of contact by up to its own amplitude, and the ringing in proportion.
            largest = abs(item["measured"] - item["expected"]) / math.exp(self.first.log_amplitude)
            smallest = max(abs(self.change) - bound * self.change_sd, 0.0)
            significant = abs(item["z"]) > bound and abs(self.change) > self.harmless
            values = {"order": order, "furthest_share": largest, **_values(item)}
            is_changed = significant and largest >= smallest
            yield item, {"code": "line_changed", **values} if is_changed else None

    def sd(self, name: str) -> float:
        """Standard deviation of a feature's change beyond the possible one."""
        errors = [s.features[name].standard_error for s in (self.first, self.other)]
        by_tolerances = self.first.features[name].value * float(self.by_bench(name).std())
        return math.hypot(*errors, by_tolerances)

    def by_bench(self, name: str) -> FloatArray:
        """Change of ln quantity by gap, speed and sampling, by draws of the bench, (m,)."""
        if not self.has_bench(name):
            return np.zeros(1)
        logs = [s.by_bench[name] for s in (self.first, self.other)]
        count = min(map(len, logs))
        return np.asarray(logs[1][:count] - logs[0][:count])

    def has_bench(self, name: str) -> bool:
        """Whether the bench tells how the gap changes a quantity."""
        return name in self.first.by_bench and name in self.other.by_bench

    def explained(self, name: str) -> float:
        """Largest change of a feature by gap, speed and sampling."""
        first, other = self.first, self.other
        value = first.features[name].value
        if self.has_bench(name):
            return 0.0
        by_speed = BY_SPEED * abs(value * (other.log_speed - first.log_speed))
        if name in BY_AMPLITUDE:
            angular_frequency = 2.0 * math.pi * first.features[FREQUENCY].value
            squares = angular_frequency**2 * (other.period_s**2 - first.period_s**2)
            by_sampling = BY_SAMPLING[name] * abs(squares)
            return by_speed + abs(value) * (abs(BY_AMPLITUDE[name] * self.change) + by_sampling)
        if name in (PROPORTIONAL, INTEGRAL):
            return 0.0  # the control law depends on neither speed nor gap
        channel = "speed" if name.startswith("speed") else "current"
        return by_speed + BY_GAP[channel] * first.features[harmonic_name(channel, 1)].value

    def possible(self, name: str) -> float:
        """Change that may be there or not: of the ringing if the gap changed, or of K_p.

        If the speed is a mean over the sampling period T, it is late by T/2, so K_p + K_i/jω
        appears larger by K_i T/2.
        """
        if self.has_bench(name):
            return self.first.features[name].value * float(np.expm1(self.by_bench(name).mean()))
        if name != PROPORTIONAL:
            return 0.0
        longer_period_s = self.other.period_s - self.first.period_s
        return 0.5 * self.first.features[INTEGRAL].value * longer_period_s


def _values(item: CheckItem) -> dict[str, Any]:
    """Keys of an item that a finding reports: all but ``z``."""
    return {key: value for key, value in item.items() if key != "z"}


def _too_small(pairs: Sequence[_Pair], bound: float) -> Iterator[dict[str, Any]]:
    """Yield the smallest detectable change of each quantity, by the least sensitive pair."""
    for name in SHOWN_BEST:
        detectable = [
            (
                bound * pair.sd(name) + pair.explained(name) + abs(pair.possible(name)),
                pair.first.features[name].value,
            )
            for pair in pairs
            if name in pair.first.features and name in pair.other.features
        ]
        if not detectable:
            continue
        # Noise may hide a harmonic.
        visible = all(value > 0.0 for _, value in detectable)
        share = max(size / value for size, value in detectable) if visible else None
        yield blind_spot("change_unseen", quantity=name, share=share)


def _filters_unseen(
    pairs: Sequence[_Pair], filters: Sequence[FilterChange | None]
) -> Iterator[dict[str, Any]]:
    """Yield the filters of the speed that would go undetected, by the least sensitive pair."""
    by_noise = [(p, f) for p, f in zip(pairs, filters, strict=True) if not p.shows_gains]
    if any(change is None for _, change in by_noise):
        yield blind_spot("filter_unseen")
    undetected = [
        max(change.high - change.log_amplitude, change.log_amplitude - change.low, pair.harmless)
        for pair, change in by_noise
        if change is not None
    ]
    if undetected:
        yield blind_spot("filter_before_noise_unseen")
        yield blind_spot("small_filter_unseen", share=math.expm1(max(undetected)))
