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

import numpy as np

from bayesbl.measurement.joint_check import (
    NO_CURRENT,
    BlindSpot,
    CheckItem,
    JointCheck,
    check_item,
    joint_check,
)
from bayesbl.measurement.joint_features import (
    INTEGRAL,
    MEAN_CURRENT,
    PROPORTIONAL,
    Feature,
    features_of,
    harmonic_name,
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
from bayesbl.units import number

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

IN_WORDS = {
    PROPORTIONAL: "the speed controller's gains, the torque constant or a filter of the speed",
    INTEGRAL: "the speed controller's gains or the torque constant",
    MEAN_CURRENT: "friction, or a constant torque",
    harmonic_name("current", 1): "the payload or the torque constant",
    harmonic_name("current", 2): "friction that depends on the load",
    harmonic_name("speed", 1): "the payload or the controller's integral gain",
    harmonic_name("speed", 2): "the integral gain, or friction that depends on the load",
    FREQUENCY: "payload, stiffness, gains or a filter of the drive",
    DECAY: "damping, gains or a filter of the drive",
}

SHOWN_BEST = (DECAY, FREQUENCY, PROPORTIONAL, INTEGRAL, harmonic_name("current", 1))
"""Of which it is told how much may change unseen, those of the ringing itself first."""

WITHOUT_CURRENT = (
    BlindSpot(
        change="the speed controller's gains, the torque constant and friction",
        reason=NO_CURRENT,
        delta_error_rad=None,
    ),
)


@dataclass(frozen=True, slots=True)
class _Seen:
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
    seen = [_seen(point) for point in points]
    pairs: list[tuple[_Seen, _Seen]] = []
    first: dict[Hashable, _Seen] = {}
    for snapshot, anew, said in zip(seen, repaired, stated or [None] * len(seen), strict=True):
        if anew:
            first.clear()
        if said in first:
            pairs.append((first[said], snapshot))
        else:
            first[said] = snapshot
    compared = sum(
        len(_compared(*pair)) + (not _gains_seen(*pair)) + len(list(_lines(*pair)))
        for pair in pairs
    )
    if not compared:
        return joint_check()
    bound = normal_isf(0.5 * FALSE_ALARM / compared)
    places = [f" in {other.name}" if len(pairs) > 1 else "" for _, other in pairs]
    filters = [None if _gains_seen(*pair) else _filter_change(*pair, bound) for pair in pairs]
    found = [
        finding
        for pair, change, where in zip(pairs, filters, places, strict=True)
        for finding in _findings(*pair, change, bound, where)
    ]
    told = [(item, sentence) for item, sentence in found if sentence]
    blind = [*_too_small(pairs, bound), *_filters_unseen(pairs, filters)]
    if not all(MOTOR_CURRENT in point.recording.channels for point in points):
        blind = [*WITHOUT_CURRENT, *blind]
    return joint_check(
        not told,
        [item for item, _ in found],
        (cause for item, _ in told for cause in COULD_BE[item["quantity"]]),
        [sentence for _, sentence in told],
        blind,
    )


def change_reason(check: JointCheck) -> str | None:
    """Why the change of a gap that a curve gave is withheld; ``None`` where it is not."""
    if check["agrees"]:
        return None
    return (
        "Something other than the gap changed between the snapshots, which moves the ringing too, "
        f"so their change is withheld. {' '.join(check['sentences'])}"
    )


def _seen(point: PointEstimate) -> _Seen:
    centre, covariance = point.ringing
    found = {feature.name: feature for feature in features_of(point)}
    for name, unit, place, scale in (
        (FREQUENCY, "Hz", 1, 2.0 * math.pi),
        (DECAY, "1/s", 2, 1.0),
    ):
        sd = math.sqrt(covariance[place, place])
        if sd > 0.0:  # a fixed one is no measurement
            value = math.exp(centre[place]) / scale
            sd = math.hypot(sd, START_ANGLE_SD[name])
            found[name] = Feature(name, unit, value, value * sd)
    recording = point.recording
    return _Seen(
        recording.name,
        found,
        math.log(centre[0]),
        math.sqrt(covariance[0, 0]) / centre[0],
        math.log(nominal_speed_rpm(recording)),
        float(np.sign(recording.motor_speed_rpm.mean())),
        recording.sampling_period_s,
        noise_spectrum(point),
        {line.order: line for line in point.lines},
    )


def _findings(
    first: _Seen, other: _Seen, change: FilterChange | None, bound: float, where: str
) -> Iterator[tuple[CheckItem, str]]:
    """Each quantity with what is said of it, nothing where it may be chance or does no harm."""
    for item in _compared(first, other):
        yield item, _sentence(item, where) if abs(item["z"]) > bound else ""
    if change is not None:
        shift = change.log_amplitude
        item = check_item(FILTER, math.exp(shift), 1.0, "", change.deviations)
        moved = abs(item["z"]) > bound and abs(shift) > _harmless(first, other)
        yield item, _sentence_of_filter(change, where) if moved else ""
    for item, order in _lines(first, other):
        yield item, _sentence_of_line(first, other, item, order, bound, where)


def _gains_seen(first: _Seen, other: _Seen) -> bool:
    """The law of the controller shows a filter of the speed, and better than the noise does."""
    return all(PROPORTIONAL in seen.features for seen in (first, other))


def _filter_change(first: _Seen, other: _Seen, bound: float) -> FilterChange | None:
    if first.noise is None or other.noise is None or not _same_rate(first, other):
        return None
    return filter_change(first.noise, other.noise, bound)


def _same_rate(first: _Seen, other: _Seen) -> bool:
    """Another rate folds another part of the noise, so its colour says nothing of a filter."""
    return abs(math.log(other.period_s / first.period_s)) < SAME_RATE


def _harmless(first: _Seen, other: _Seen) -> float:
    """What a filter may do to ln A without harm to an interval."""
    return HARMLESS_SD * math.hypot(first.log_amplitude_sd, other.log_amplitude_sd)


def _compared(first: _Seen, other: _Seen) -> list[CheckItem]:
    items = []
    for name, before in first.features.items():
        after = other.features.get(name)
        # In the other direction a constant torque changes sides.
        if after is None or (name == MEAN_CURRENT and first.direction != other.direction):
            continue
        difference = after.value - before.value
        late = _by_lateness(name, first, other)
        difference -= min(max(difference, min(late, 0.0)), max(late, 0.0))
        explained = _explained(name, first, other)
        beyond = math.copysign(max(abs(difference) - explained, 0.0), difference)
        z = beyond / _sd(name, first, other)
        items.append(check_item(name, after.value, before.value, before.unit, z))
    return items


def _lines(first: _Seen, other: _Seen) -> Iterator[tuple[CheckItem, int]]:
    """Every line of the motor with its order; one that does not stand out counts as none."""
    if abs(other.log_speed - first.log_speed) > SAME_SPEED:
        return
    for order in sorted({*first.lines, *other.lines}):
        before, after = (
            seen.lines.get(order, MotorLine(order, 0.0, 0.0)) for seen in (first, other)
        )
        sd = math.hypot(before.standard_error_rpm, after.standard_error_rpm)
        z = (after.size_rpm - before.size_rpm) / sd if sd > 0.0 else 0.0
        yield check_item(LINE, after.size_rpm, before.size_rpm, "rpm", z), order


def _too_small(pairs: Sequence[tuple[_Seen, _Seen]], bound: float) -> Iterator[BlindSpot]:
    """How much of each quantity could change unseen, by the pair that shows it worst."""
    for name in SHOWN_BEST:
        least = [
            (
                bound * _sd(name, first, other)
                + _explained(name, first, other)
                + abs(_by_lateness(name, first, other)),
                first.features[name].value,
            )
            for first, other in pairs
            if name in first.features and name in other.features
        ]
        if not least:
            continue
        if all(value > 0.0 for _, value in least):
            percent = 100.0 * max(size / value for size, value in least)
            change = f"a change of the {name} by less than {percent:.2g} %"
        else:  # a harmonic that noise hides
            change = f"a change of the {name}, which one of them does not show"
        yield BlindSpot(
            change=f"{change} ({IN_WORDS[name]})",
            reason="too small for these recordings to show",
            delta_error_rad=None,
        )


def _filters_unseen(
    pairs: Sequence[tuple[_Seen, _Seen]], filters: Sequence[FilterChange | None]
) -> Iterator[BlindSpot]:
    """What filter of the speed would pass, by the pair that shows it worst."""
    by_noise = [
        (pair, change)
        for pair, change in zip(pairs, filters, strict=True)
        if not _gains_seen(*pair)
    ]
    if any(change is None for _, change in by_noise):
        yield BlindSpot(
            change="a filter of the speed",
            reason="these recordings have too little noise above the ringing, were mended, or "
            "have different rates",
            delta_error_rad=None,
        )
    reach = [
        max(
            change.high - change.log_amplitude,
            change.log_amplitude - change.low,
            _harmless(*pair),
        )
        for pair, change in by_noise
        if change is not None
    ]
    if reach:
        yield BlindSpot(
            change="a filter of the speed behind which most of the noise arises, or before a "
            "recorder that keeps one sample in several",
            reason="the noise does not show it",
            delta_error_rad=None,
        )
        yield BlindSpot(
            change="a change of a filter of the speed that moves the ringing by less than "
            f"{100.0 * math.expm1(max(reach)):.2g} %",
            reason="too small for the noise of these recordings to show",
            delta_error_rad=None,
        )


def _sd(name: str, first: _Seen, other: _Seen) -> float:
    return math.hypot(first.features[name].standard_error, other.features[name].standard_error)


def _explained(name: str, first: _Seen, other: _Seen) -> float:
    """How far gap, speed and sampling may have moved a quantity."""
    value = first.features[name].value
    by_speed = BY_SPEED * abs(value * (other.log_speed - first.log_speed))
    if name in BY_AMPLITUDE:
        by_amplitude = BY_AMPLITUDE[name] * (other.log_amplitude - first.log_amplitude)
        angular_frequency = 2.0 * math.pi * first.features[FREQUENCY].value
        squares = angular_frequency**2 * (other.period_s**2 - first.period_s**2)
        return by_speed + abs(value) * (abs(by_amplitude) + BY_SAMPLING[name] * abs(squares))
    if name in (PROPORTIONAL, INTEGRAL):
        return 0.0  # what the controller makes of a speed error does not depend on either
    channel = "speed" if name.startswith("speed") else "current"
    return by_speed + BY_GAP[channel] * first.features[harmonic_name(channel, 1)].value


def _by_lateness(name: str, first: _Seen, other: _Seen) -> float:
    """What the speed may differ by for being a mean over the sampling period, if it is one.

    Such a mean over T comes T/2 late, by which K_p + K_i/jω seems larger by K_i T/2.
    """
    if name != PROPORTIONAL:
        return 0.0
    return 0.5 * first.features[INTEGRAL].value * (other.period_s - first.period_s)


def _sentence(item: CheckItem, where: str) -> str:
    measured, expected, quantity = item["measured"], item["expected"], item["quantity"]
    direction = "rose" if measured > expected else "fell"
    places = max(0, 2 - math.floor(math.log10(max(abs(measured - expected), 1e-9))))
    before, after = number(expected, places), number(measured, places)
    return (
        f"The {quantity} {direction} from {before} to {after} {item['unit']}{where}: "
        f"{IN_WORDS[quantity]}, not the gap."
    )


def _sentence_of_filter(change: FilterChange, where: str) -> str:
    direction, least = (
        ("raise", math.expm1(change.low))
        if change.log_amplitude > 0.0
        else ("lower", -math.expm1(change.high))
    )
    return (
        f"The noise of the speed changed its colour{where}, as behind another filter or with noise "
        f"from another source. Such a filter alone would {direction} the ringing by "
        f"{100.0 * least:.2g} % or more. Record all snapshots through the same filter, or the "
        "motor current as well."
    )


def _sentence_of_line(
    first: _Seen, other: _Seen, item: CheckItem, order: int, bound: float, where: str
) -> str:
    """Where a line that changed may be all that moved the ringing; else nothing.

    What repeats with the motor is there when the teeth meet, so they meet faster or slower by as
    much as it moves the motor: the ringing behind is that much louder at most.
    """
    moved = other.log_amplitude - first.log_amplitude
    chance = bound * math.hypot(first.log_amplitude_sd, other.log_amplitude_sd)
    measured, expected = item["measured"], item["expected"]
    furthest = abs(measured - expected) / math.exp(first.log_amplitude)
    if (
        abs(item["z"]) <= bound
        or abs(moved) <= _harmless(first, other)
        or furthest < abs(moved) - chance
    ):
        return ""
    direction = "rose" if measured > expected else "fell"
    return (
        f"The {LINE} at motor order {order} {direction} from {expected:.2g} to "
        f"{measured:.2g} rpm{where}: an error of transmission or encoder or a ripple of the "
        f"torque, not the gap. It could move the ringing by up to {100.0 * furthest:.2g} %, as "
        "much as was seen."
    )
