"""What a simulation leaves, in sentences."""

from __future__ import annotations

import math

from bayesbl.discrepancy.attribution import Line
from bayesbl.discrepancy.locate import ChannelLeft, Located, RecordingLeft
from bayesbl.discrepancy.unexplained import (
    FEWEST_OUTLIERS,
    SKEW_EXPLAINS,
    Unexplained,
    describe_unexplained,
    has_skew,
    repeats,
)
from bayesbl.recording.types import CHANNELS
from bayesbl.units import number, unit_of

MOST_LINES = 3


def located_sentences(located: Located) -> list[str]:
    """What is left, recording by recording, then over all of them."""
    if not describe_unexplained(located):
        rate = 100.0 * located.false_discovery_rate
        return [
            "Nothing repeats, drifts or lags beyond noise in any channel "
            f"(were that so in truth, {rate:g} % of such data would show a line by chance)."
        ]
    sentences = []
    for recording in located.recordings:
        sentences += _of_recording(recording, located)
    return sentences + _offset_sentences(located)


def unexplained_phrase(entry: Unexplained) -> str:
    """``motor current: 0.13 A at 7.3 Hz, periodic in time``; for a verdict's list."""
    size = quantity(entry.amplitude, entry.unit)
    head = f"{channel_name(entry.channel)}: "
    if entry.dependence == "offset":
        return f"{head}an offset of {size}"
    if entry.dependence == "drift":
        return f"{head}a drift of {size}"
    if entry.dependence == "skew":
        return f"{head}{_lag(entry.amplitude)}"
    if entry.dependence == "outliers":
        return f"{head}{entry.amplitude:g} samples that no noise explains"
    if entry.dependence == "load angle":
        orders = _orders(int(entry.lowest_order), int(entry.highest_order))
        return f"{head}{size} with the load angle, mostly at {orders}"
    if entry.dependence == "motor angle":
        return f"{head}{size} at order {entry.lowest_order:.4g} of the motor"
    if entry.dependence == "time":
        return f"{head}{size} at {entry.frequency_hz:.4g} Hz, periodic in time"
    return (
        f"{head}{size} at {entry.frequency_hz:.4g} Hz or order {entry.lowest_order:.4g} of the "
        "motor (these recordings cannot tell which)"
    )


def quantity(value: float, unit: str) -> str:
    """Two significant figures with a true minus and the unit: ``−0.25 A``."""
    if value == 0.0:
        return f"0 {unit}"
    rounded = float(f"{value:.1e}")
    digits = 1 - math.floor(math.log10(abs(rounded)))
    return f"{number(rounded, max(0, digits))} {unit}"


def channel_name(channel: str) -> str:
    """``motor speed``."""
    return CHANNELS.get(channel, channel)


def _orders(low: int, high: int) -> str:
    return f"order {low}" if low == high else f"orders {low} to {high}"


def _lag(seconds: float) -> str:
    verb = "lags" if seconds > 0.0 else "leads"
    return f"{verb} by {quantity(1e3 * abs(seconds), 'ms')}"


def _of_recording(recording: RecordingLeft, located: Located) -> list[str]:
    tests = sum(len(other.channels) for other in located.recordings)
    sentences = []
    for channel in recording.channels:
        parts = _parts(channel, tests)
        name = channel_name(channel.channel)
        noise = quantity(channel.noise_sd, unit_of(channel.channel))
        if parts:
            sentences.append(f"In the {name} of '{recording.name}', {'; '.join(parts)}.")
        else:
            sentences.append(
                f"In the {name} of '{recording.name}' only noise of {noise} (RMS) is left."
            )
    return sentences


def _parts(channel: ChannelLeft, tests: int) -> list[str]:
    unit = unit_of(channel.channel)
    parts = []
    if repeats(channel, tests):
        where = channel.main_orders
        at = f", mostly at {_orders(*where)}" if where else ""
        size = quantity(channel.repeating_rms, unit)
        parts.append(f"{size} (RMS) repeat with the load angle{at}")
    lines = [line for line in channel.lines if line.dependence != "load angle"]
    parts += [_line(line, unit) for line in lines[:MOST_LINES]]
    if len(lines) > MOST_LINES:
        parts.append(f"{len(lines) - MOST_LINES} weaker lines")
    if channel.offset_significant:
        parts.append(f"the mean is off by {quantity(channel.offset, unit)}")
    if abs(channel.drift_per_s) > 5.0 * channel.drift_error_per_s:
        parts.append(f"it drifts by {quantity(channel.drift_per_s, f'{unit}/s')}")
    if channel.skew.explained >= SKEW_EXPLAINS and has_skew(channel, tests):
        share = 100.0 * channel.skew.explained
        lag = _lag(channel.skew.lag_s)
        parts.append(f"it {lag}, which explains {share:.0f} % of what is left")
    if channel.outliers >= FEWEST_OUTLIERS:
        parts.append(f"{channel.outliers} samples lie where no noise puts them")
    return parts


def _line(line: Line, unit: str) -> str:
    size = quantity(line.amplitude, unit)
    if line.dependence == "motor angle":
        return f"{size} repeat with the motor angle at order {line.motor_order:.4g}"
    if line.dependence == "time":
        return f"{size} repeat in time at {line.frequency_hz:.4g} Hz"
    return (
        f"{size} repeat at {line.frequency_hz:.4g} Hz or motor order {line.motor_order:.4g}, "
        "which these recordings cannot tell apart"
    )


def _offset_sentences(located: Located) -> list[str]:
    """How offsets depend on direction and speed, where there is an offset to speak of."""
    shown = {
        channel.channel
        for recording in located.recordings
        for channel in recording.channels
        if channel.offset_significant
    }
    sentences = []
    for offset in located.offsets:
        if offset.channel not in shown or len(located.recordings) < 2:
            continue
        unit = unit_of(offset.channel)
        parts = [
            (offset.constant, offset.constant_error, "{} in both directions"),
            (offset.with_direction, offset.with_direction_error, "{} with the sign of the motion"),
            (offset.per_1000_rpm, offset.per_1000_rpm_error, "{} for every 1000 rpm"),
        ]
        told = [
            text.format(quantity(value, unit))
            for value, error, text in parts
            if not math.isnan(value) and abs(value) > 3.0 * error
        ]
        if told:
            name = channel_name(offset.channel)
            sentences.append(f"The {name}'s mean is off by {', '.join(told)}.")
    return sentences
