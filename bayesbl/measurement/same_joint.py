"""Whether nothing but the gap changed between snapshots, asked of the recordings alone.

Compared is what the gap moves little or not at all: the controller's gains, the mean current, the
first two load orders of current and speed, the ringing's frequency and decay. How far a changed gap
may move each of them is taken off the difference before it is held against its standard error.
Without a current a changed filter of the recorded speed shows in the colour of the noise alone.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

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
from bayesbl.probabilities import normal_isf
from bayesbl.recording.types import MOTOR_CURRENT
from bayesbl.ringing.cleaning import MotorLine
from bayesbl.ringing.estimator import PointEstimate, nominal_speed_rpm

FALSE_ALARM = 0.01
"""Of one comparison, over all its quantities and snapshots."""

FREQUENCY, DECAY = "ringing frequency", "ringing decay"
FILTER = "share of the ringing that is recorded"
"""Its logarithm is compared, by the noise of the first snapshot and of another."""

LINE = "line of the motor in the speed"
"""A ripple or an error of transmission or encoder, where it stands out of the speed."""

HARMLESS_SD = 0.5
"""Of the change of ln A: a 90 % interval that is off by so much holds the truth in 86 %."""

BY_AMPLITUDE = {FREQUENCY: 0.1, DECAY: 0.5}
"""Largest ∂ln quantity/∂ln A along the gap, over benches within a factor of 1.6 of the reference
and gaps of 0.3 to 3 mrad (0.09 and 0.47, ``experiments/joint_features.py``)."""

BY_GAP = {"current": 0.0025, "speed": 0.005}
"""What 2.7 mrad more gap adds to a load order, or to the mean, as a share of the first order: the
load jumps by twice the gap at each flip of flanks, the second order by 8/(3π) of that angle
(0.23 and 0.46 %, same command)."""

BY_SPEED = 2.0
"""Powers of the speed that a quantity goes with at most; snapshots may differ by 2 % in it."""

BY_SAMPLING = {FREQUENCY: 0.15, DECAY: 0.41}
"""Largest share by which a fit of samples T apart is off, per (ω T)², over the same benches at 125
and 250 Hz (0.149 and 0.408, same command)."""

SAME_RATE = 0.01
"""Share by which two sampling rates may differ and still show the same noise."""

SAME_SPEED = 0.02
"""Share by which two speeds may differ and the loop still answer a line of the motor alike."""

START_ANGLE_SD = {FREQUENCY: 0.0015, DECAY: 0.002}
"""Scatter of ln quantity with the start angle on the reference bench (same command)."""

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
"""What of the joint would move each quantity."""

SHOWN_BEST = (DECAY, FREQUENCY, PROPORTIONAL, INTEGRAL, harmonic_name("current", 1))
"""Of which it is told how much may change unseen, those of the ringing itself first."""


@dataclass(frozen=True, slots=True)
class _Snapshot:
    """What is compared of one snapshot."""

    name: str
    features: dict[str, Feature]
    log_amplitude: float
    log_amplitude_sd: float
    log_speed: float
    direction: float
    period_s: float
    noise: NoiseSpectrum | None
    lines: Mapping[int, MotorLine]

    @classmethod
    def of(cls, point: PointEstimate) -> _Snapshot:
        centre, covariance = point.ringing
        features = {feature.name: feature for feature in features_of(point)}
        for name, unit, place, scale in (
            (FREQUENCY, "Hz", 1, 2.0 * math.pi),
            (DECAY, "1/s", 2, 1.0),
        ):
            sd = math.sqrt(covariance[place, place])
            if sd > 0.0:  # a fixed one is no measurement
                value = math.exp(centre[place]) / scale
                sd = math.hypot(sd, START_ANGLE_SD[name])
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
        )


def same_joint(
    points: Sequence[PointEstimate],
    repaired: Sequence[bool],
    stated: Sequence[Hashable] | None = None,
) -> JointCheck:
    """Every snapshot against the first one like it since the last repair.

    Parameters
    ----------
    repaired
        Whether each snapshot is the first one after a repair.
    stated
        What the user says of each snapshot: those of which another thing is said may differ.
    """
    if len(points) < 2:
        return joint_check()
    pairs: list[_Pair] = []
    first: dict[Hashable, _Snapshot] = {}
    for point, anew, said in zip(points, repaired, stated or [None] * len(points), strict=True):
        snapshot = _Snapshot.of(point)
        if anew:
            first.clear()
        if said in first:
            pairs.append(_Pair(first[said], snapshot))
        else:
            first[said] = snapshot
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
    """Why the change of a gap that a curve gave is withheld; ``None`` where it is not."""
    return None if check["agrees"] else Reason("joint_changed", {"also": check["findings"]})


@dataclass(frozen=True, slots=True)
class _Pair:
    """Two snapshots that are compared."""

    first: _Snapshot
    other: _Snapshot

    @property
    def shows_gains(self) -> bool:
        """The law of the controller shows a filter of the speed, and better than the noise does."""
        return all(PROPORTIONAL in each.features for each in (self.first, self.other))

    @property
    def change(self) -> float:
        """Of ln A."""
        return self.other.log_amplitude - self.first.log_amplitude

    @property
    def change_sd(self) -> float:
        return math.hypot(self.first.log_amplitude_sd, self.other.log_amplitude_sd)

    @property
    def harmless(self) -> float:
        """What may be done to ln A without harm to an interval."""
        return HARMLESS_SD * self.change_sd

    @property
    def items(self) -> list[CheckItem]:
        """Each feature that both have."""
        items = []
        for name, before in self.first.features.items():
            after = self.other.features.get(name)
            turned = self.first.direction != self.other.direction
            # In the other direction a constant torque changes sides.
            if after is None or (name == MEAN_CURRENT and turned):
                continue
            difference, late = after.value - before.value, self.by_lateness(name)
            difference -= min(max(difference, min(late, 0.0)), max(late, 0.0))
            beyond = max(abs(difference) - self.explained(name), 0.0)
            z = math.copysign(beyond, difference) / self.sd(name)
            items.append(check_item(name, after.value, before.value, before.unit, z))
        return items

    @property
    def lines(self) -> dict[int, CheckItem]:
        """Every line of the motor by its order; one that does not stand out counts as none."""
        if abs(self.other.log_speed - self.first.log_speed) > SAME_SPEED:
            return {}
        items = {}
        for order in sorted({*self.first.lines, *self.other.lines}):
            none = MotorLine(order, 0.0, 0.0)
            before, after = (each.lines.get(order, none) for each in (self.first, self.other))
            sd = math.hypot(before.standard_error_rpm, after.standard_error_rpm)
            z = (after.size_rpm - before.size_rpm) / sd if sd > 0.0 else 0.0
            items[order] = check_item(LINE, after.size_rpm, before.size_rpm, "rpm", z)
        return items

    def filter_change(self, bound: float) -> FilterChange | None:
        """By the noise, where nothing shows it better; another rate folds another part of it."""
        first, other = self.first, self.other
        same_rate = abs(math.log(other.period_s / first.period_s)) < SAME_RATE
        if self.shows_gains or first.noise is None or other.noise is None or not same_rate:
            return None
        return filter_change(first.noise, other.noise, bound)

    def findings(
        self, change: FilterChange | None, bound: float
    ) -> Iterator[tuple[CheckItem, dict[str, Any] | None]]:
        """Each quantity with what is to be said of it, where it is no chance and does harm."""
        for item in self.items:
            moved = abs(item["z"]) > bound
            yield item, {"code": "quantity_changed", **_values(item)} if moved else None
        if change is not None:
            shift = change.log_amplitude
            item = check_item(FILTER, math.exp(shift), 1.0, "", change.deviations)
            moved = abs(item["z"]) > bound and abs(shift) > self.harmless
            least = math.expm1(change.low if shift > 0.0 else change.high)
            yield item, {"code": "filter_changed", "least_share": least} if moved else None
        for order, item in self.lines.items():
            # What repeats with the motor is there when the teeth meet, so they meet faster or
            # slower by as much as it moves the motor: the ringing behind is that much louder.
            furthest = abs(item["measured"] - item["expected"]) / math.exp(self.first.log_amplitude)
            least = max(abs(self.change) - bound * self.change_sd, 0.0)
            moved = abs(item["z"]) > bound and abs(self.change) > self.harmless
            values = {"order": order, "furthest_share": furthest, **_values(item)}
            is_changed = moved and furthest >= least
            yield item, {"code": "line_changed", **values} if is_changed else None

    def sd(self, name: str) -> float:
        """Of a feature's change."""
        return math.hypot(*(s.features[name].standard_error for s in (self.first, self.other)))

    def explained(self, name: str) -> float:
        """How far gap, speed and sampling may have moved a feature."""
        first, other = self.first, self.other
        value = first.features[name].value
        by_speed = BY_SPEED * abs(value * (other.log_speed - first.log_speed))
        if name in BY_AMPLITUDE:
            angular_frequency = 2.0 * math.pi * first.features[FREQUENCY].value
            squares = angular_frequency**2 * (other.period_s**2 - first.period_s**2)
            by_sampling = BY_SAMPLING[name] * abs(squares)
            return by_speed + abs(value) * (abs(BY_AMPLITUDE[name] * self.change) + by_sampling)
        if name in (PROPORTIONAL, INTEGRAL):
            return 0.0  # what the controller makes of a speed error does not depend on either
        channel = "speed" if name.startswith("speed") else "current"
        return by_speed + BY_GAP[channel] * first.features[harmonic_name(channel, 1)].value

    def by_lateness(self, name: str) -> float:
        """What the speed may differ by for being a mean over the sampling period, if it is one.

        Such a mean over T comes T/2 late, by which K_p + K_i/jω seems larger by K_i T/2.
        """
        if name != PROPORTIONAL:
            return 0.0
        later_s = self.other.period_s - self.first.period_s
        return 0.5 * self.first.features[INTEGRAL].value * later_s


def _values(item: CheckItem) -> dict[str, Any]:
    """What is said of a quantity: all but its deviations."""
    return {key: value for key, value in item.items() if key != "z"}


def _too_small(pairs: Sequence[_Pair], bound: float) -> Iterator[dict[str, Any]]:
    """How much of each quantity could change unseen, by the pair that shows it worst."""
    for name in SHOWN_BEST:
        least = [
            (
                bound * pair.sd(name) + pair.explained(name) + abs(pair.by_lateness(name)),
                pair.first.features[name].value,
            )
            for pair in pairs
            if name in pair.first.features and name in pair.other.features
        ]
        if not least:
            continue
        # Noise may hide a harmonic.
        shown = all(value > 0.0 for _, value in least)
        share = max(size / value for size, value in least) if shown else None
        yield blind_spot("change_unseen", quantity=name, share=share)


def _filters_unseen(
    pairs: Sequence[_Pair], filters: Sequence[FilterChange | None]
) -> Iterator[dict[str, Any]]:
    """What filter of the speed would pass, by the pair that shows it worst."""
    by_noise = [(p, f) for p, f in zip(pairs, filters, strict=True) if not p.shows_gains]
    if any(change is None for _, change in by_noise):
        yield blind_spot("filter_unseen")
    reach = [
        max(change.high - change.log_amplitude, change.log_amplitude - change.low, pair.harmless)
        for pair, change in by_noise
        if change is not None
    ]
    if reach:
        yield blind_spot("filter_before_noise_unseen")
        yield blind_spot("small_filter_unseen", share=math.expm1(max(reach)))
