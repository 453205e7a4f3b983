"""Where recording and simulation disagree: per channel, with which angle or time, how surely.

Averaging over load rotations splits the residual of a simulation into what repeats and what does
not; in the latter, lines that are no whole load order, and drift, are separated from noise. A line
belongs to the load angle, the motor angle or time by its order, by how it stands out of its
neighbours, and, where recordings were made at different speeds, by what stays the same between
them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.stats import norm

from bayesbl.diagnosis.residuals.decomposition import (
    Decomposition,
    Line,
    Scales,
    WholeRotations,
    against_load_angle,
    band_probability,
    benjamini_hochberg,
    decompose,
    load_lines,
    map_error,
    mean_over_rotations,
    order_probabilities,
    over_speeds,
    scales,
)
from bayesbl.errors import RecordingError
from bayesbl.matching.observed import Observed
from bayesbl.recording.types import MOTOR_SPEED, FloatArray
from bayesbl.units import unit_of

FALSE_DISCOVERY_RATE = 0.01
FEWEST_ROTATIONS = 2
MAIN_SHARE = 0.8


@dataclass(frozen=True, slots=True)
class Split:
    """Mean squares that add up to that of the whole difference, the channel's unit squared.

    ``other``: lines of the motor angle and of time, drift. ``noise``: the rest when all else is
    removed, so without the share of the noise that repeats by chance, which is in ``load_angle``.
    """

    offset: float
    load_angle: float
    other: float
    noise: float


@dataclass(frozen=True, slots=True)
class ChannelResiduals:
    """The residual of one channel of one recording, in the unit that the channel's name ends in.

    Attributes
    ----------
    offset, offset_error, offset_significant
        Mean of recording − simulation, its standard error, whether noise explains it.
    repeating_rms
        RMS of what repeats with the load angle, without the offset, lines of the motor angle and
        what noise alone would leave; up to the load order ``repeating_band``.
    repeating_probability
        That noise alone repeats as much (bands of load orders, Bonferroni).
    main_orders
        Load orders between which 80 % of the significant power lies; ``None`` if none is
        significant.
    lines
        Significant lines, strongest first.
    load_map, load_map_error
        What repeats, offset included, at load angles 2π j/720, shape (720,); its standard error.
    amplitude, noise_amplitude
        Of the residual at every bin, and what noise alone would have there (RMS), shape (b,).
    recorded, simulated
        Averages over the rotations at the same angles.
    noise_sd
        Of the noise.
    drift_per_s, drift_error_per_s
        Slope over the recording and its standard error.
    outliers
        Samples that no noise explains (six standard deviations of the whitened noise).
    """

    channel: str
    offset: float
    offset_error: float
    offset_significant: bool
    repeating_rms: float
    repeating_band: int
    repeating_probability: float
    main_orders: tuple[int, int] | None
    lines: tuple[Line, ...]
    load_map: FloatArray
    load_map_error: float
    recorded: FloatArray
    simulated: FloatArray
    amplitude: FloatArray
    noise_amplitude: FloatArray
    noise_sd: float
    drift_per_s: float
    drift_error_per_s: float
    outliers: int
    split: Split


@dataclass(frozen=True, slots=True)
class RecordingResiduals:
    """The residuals of one recording, channel by channel."""

    name: str
    whole: WholeRotations
    channels: tuple[ChannelResiduals, ...]


@dataclass(frozen=True, slots=True)
class ResidualAnalysis:
    """The residuals of all recordings.

    Attributes
    ----------
    false_discovery_rate
        Expected share of false ones among the significant lines; if nothing repeats, the chance
        that any line is called significant.
    """

    recordings: tuple[RecordingResiduals, ...]
    false_discovery_rate: float


def analyse_residuals(
    recordings: Sequence[Observed],
    simulated: Sequence[FloatArray],
    start_angles_rad: Sequence[float],
    *,
    false_discovery_rate: float = FALSE_DISCOVERY_RATE,
) -> ResidualAnalysis:
    """Split the residual of every channel and test every line of its spectrum.

    Parameters
    ----------
    recordings
        Recordings in steady rotation.
    simulated
        Prediction for each, shape (c, n) as its ``signals``.
    start_angles_rad
        Load angle at each recording's first sample.
    false_discovery_rate
        Over all lines: Benjamini and Hochberg for each channel of each recording, and there apart
        for motor orders, load orders and what lies between them, each at its equal share of the
        rate. (All at once would let thousands of true lines in one channel buy false ones in
        another.)

    Raises
    ------
    RecordingError
        If a recording holds less than two load rotations, or a prediction is not finite or not of
        the recording's shape.
    """
    tests = 3 * sum(len(seen.signals) for seen in recordings)
    analysis = [
        _recording(seen, made, start, false_discovery_rate / tests)
        for seen, made, start in zip(recordings, simulated, start_angles_rad, strict=True)
    ]
    return ResidualAnalysis(_attributed(analysis), false_discovery_rate)


def _recording(
    seen: Observed, simulated: FloatArray, start_angle_rad: float, rate: float
) -> RecordingResiduals:
    if simulated.shape != seen.signals.shape or not np.all(np.isfinite(simulated)):
        raise RecordingError(
            "The prediction does not fit the recording.",
            file=seen.name,
            found=f"shape {simulated.shape}, {int(np.isfinite(simulated).sum())} finite values",
            expected=f"shape {seen.signals.shape}, all finite",
        )
    rotation = seen.rotation_period_s * seen.sampling_hz
    rotations = int(seen.samples / rotation + 1e-6)
    if rotations < FEWEST_ROTATIONS:
        raise RecordingError(
            "The recording is too short to tell noise from what repeats every load rotation.",
            file=seen.name,
            found=f"{seen.samples / rotation:.3g} load rotations",
            expected="at least two",
        )
    whole = WholeRotations(
        rotations=rotations,
        samples=min(round(rotations * rotation), seen.samples),
        sampling_hz=seen.sampling_hz,
        reference_speed_rpm=seen.reference_speed_rpm,
        gear_ratio=seen.rotation_period_s * abs(seen.reference_speed_rpm) / 60.0,
        start_angle_rad=start_angle_rad,
    )
    scale = _scales(seen.channels, simulated[:, : whole.samples], whole)
    channels = tuple(
        _channel(name, recorded[: whole.samples], made[: whole.samples], whole, scale, rate)
        for name, recorded, made in zip(seen.channels, seen.signals, simulated, strict=True)
    )
    return RecordingResiduals(seen.name, whole, channels)


def _scales(channels: Sequence[str], simulated: FloatArray, whole: WholeRotations) -> Scales:
    """Time, and the motor angle that the simulated speed makes: it has no noise."""
    speed_hz = np.full(whole.samples, whole.motor_hz)
    if MOTOR_SPEED in channels:
        speed_hz = np.abs(simulated[channels.index(MOTOR_SPEED)]) / 60.0
    turned = cumulative_trapezoid(speed_hz, dx=1.0 / whole.sampling_hz, initial=0.0)
    return scales(2.0 * math.pi * turned, whole.motor_hz, whole.sampling_hz)


def _channel(
    name: str,
    recorded: FloatArray,
    simulated: FloatArray,
    whole: WholeRotations,
    scale: Scales,
    rate: float,
) -> ChannelResiduals:
    difference = recorded - simulated
    parts = decompose(difference, whole, scale, rate)
    probability = order_probabilities(parts, whole.rotations)
    threshold = benjamini_hochberg(probability, rate)
    repeats, highest = band_probability(parts, whole.rotations)
    harmonics = parts.repeating[:: whole.rotations] / whole.samples
    mean_square = 2.0 * np.abs(harmonics) ** 2
    by_noise = 2.0 * parts.floor.at_bins(whole.samples)[:: whole.rotations] / whole.samples
    highest = max(highest, int(np.flatnonzero(probability <= threshold).max(initial=0)))
    excess = float((mean_square - by_noise)[1 : highest + 1].sum())
    lines = (*load_lines(harmonics, whole, probability, threshold), *parts.lines)
    return ChannelResiduals(
        channel=name,
        offset=parts.offset,
        offset_error=parts.offset_error,
        offset_significant=bool(probability[0] <= threshold),
        repeating_rms=math.sqrt(max(excess, 0.0)),
        repeating_band=highest,
        repeating_probability=repeats,
        main_orders=_main_orders(np.where(probability <= threshold, mean_square, 0.0)),
        lines=tuple(sorted(lines, key=lambda line: -line.amplitude)),
        load_map=against_load_angle(harmonics, whole),
        load_map_error=map_error(parts, whole),
        recorded=mean_over_rotations(recorded, whole),
        simulated=mean_over_rotations(simulated, whole),
        amplitude=2.0 * np.abs(np.fft.rfft(difference - difference.mean())) / whole.samples,
        noise_amplitude=2.0 * np.sqrt(parts.floor.at_bins(whole.samples) / whole.samples),
        noise_sd=parts.floor.sd,
        drift_per_s=parts.drift_per_s,
        drift_error_per_s=parts.drift_error_per_s,
        outliers=parts.outliers,
        split=_split(difference, parts),
    )


def _main_orders(power: FloatArray) -> tuple[int, int] | None:
    """Orders that cut off a tenth of the power below and above them."""
    total = power[1:].sum()
    if total == 0.0:
        return None
    below = np.cumsum(power[1:]) / total
    aside = 0.5 * (1.0 - MAIN_SHARE)
    return int(np.argmax(below >= aside)) + 1, int(np.argmax(below >= 1.0 - aside)) + 1


def _split(difference: FloatArray, parts: Decomposition) -> Split:
    repeating = float(np.mean(np.fft.irfft(parts.repeating, difference.size) ** 2))
    noise = float(np.mean(parts.noise**2))
    return Split(
        offset=parts.offset**2,
        load_angle=repeating - parts.offset**2,
        other=float(np.mean(difference**2)) - repeating - noise,
        noise=noise,
    )


def _attributed(analysis: Sequence[RecordingResiduals]) -> tuple[RecordingResiduals, ...]:
    """Lines attributed by all recordings together."""
    result = []
    for i, recording in enumerate(analysis):
        channels = []
        for c, channel in enumerate(recording.channels):
            others = [
                (other.whole, other.channels[c].lines)
                for j, other in enumerate(analysis)
                if j != i and c < len(other.channels)
            ]
            lines = tuple(over_speeds(line, recording.whole, others) for line in channel.lines)
            channels.append(_without_reattributed(channel, lines))
        result.append(dataclasses.replace(recording, channels=tuple(channels)))
    return tuple(result)


def _without_reattributed(channel: ChannelResiduals, lines: tuple[Line, ...]) -> ChannelResiduals:
    """The channel with its lines anew; whole load orders that belong to time repeat no more."""
    moved = [
        old
        for old, new in zip(channel.lines, lines, strict=True)
        if old.dependence == "load angle" != new.dependence
    ]
    if not moved:
        return dataclasses.replace(channel, lines=lines)
    kept = [line for line in lines if line.dependence == "load angle"]
    power = np.zeros(1 + int(max((line.load_order for line in kept), default=0.0)))
    for line in kept:
        power[round(line.load_order)] = line.amplitude**2
    left = channel.repeating_rms**2 - 0.5 * sum(line.amplitude**2 for line in moved)
    return dataclasses.replace(
        channel,
        lines=lines,
        repeating_rms=math.sqrt(max(left, 0.0)),
        repeating_probability=channel.repeating_probability if kept else 1.0,
        main_orders=_main_orders(power),
    )


What = Literal["load angle", "motor angle", "time", "angle or time", "offset", "drift", "outliers"]

SURE = 1e-3
"""Family-wise false-alarm rate of what is no line: repeating bands, drift."""
SAME_ORDER = 2e-3
FEWEST_OUTLIERS = 3
MOST_LINES = 6
"""Of a channel: what is beyond them is weaker, mostly side bands."""


@dataclass(frozen=True, slots=True)
class Unexplained:
    """One thing that the simulation does not explain, over all recordings that show it.

    Attributes
    ----------
    dependence
        What it repeats with, or ``offset``, ``drift`` (over a recording), ``outliers`` (samples
        that no noise explains).
    amplitude
        Largest over the recordings, in ``unit``: of the line; for the load angle that of a sine
        of the same RMS; the offset; the drift per second; the number of samples.
    lowest_order, highest_order
        Of the load for the load angle, else of the motor; ``nan`` where it has none.
    frequency_hz
        Of a line periodic in time, or of one that may be; else ``nan``.
    recordings
        Names of those that show it.
    chi_squared
        Of a line whose test has one.
    """

    channel: str
    dependence: What
    amplitude: float
    unit: str
    lowest_order: float
    highest_order: float
    frequency_hz: float
    recordings: tuple[str, ...]
    chi_squared: float | None = None


Found = tuple[RecordingResiduals, ChannelResiduals]


def describe_unexplained(analysis: ResidualAnalysis) -> list[Unexplained]:
    """What is significant, channel by channel: strongest lines first, then all else."""
    names = dict.fromkeys(c.channel for r in analysis.recordings for c in r.channels)
    every = [(r, c) for r in analysis.recordings for c in r.channels]
    entries: list[Unexplained] = []
    for name in names:
        seen = [(r, c) for r, c in every if c.channel == name]
        unit = unit_of(name)
        entries += _with_load_angle(name, unit, seen, len(every))
        entries += _lines(name, unit, seen)
        entries += _numbers(name, unit, seen, len(every))
    return entries


def _sure(z: float, tests: int) -> bool:
    return 2.0 * float(norm.sf(abs(z))) * tests <= SURE


def _with_load_angle(
    name: str, unit: str, seen: Sequence[Found], tests: int
) -> Iterable[Unexplained]:
    shown = [
        (r, c)
        for r, c in seen
        # A line of a load order, or a whole band.
        if c.main_orders is not None or c.repeating_probability * tests <= SURE
    ]
    if not shown:
        return
    orders = [c.main_orders or (1, c.repeating_band) for _, c in shown]
    yield Unexplained(
        name,
        "load angle",
        math.sqrt(2.0) * max(c.repeating_rms for _, c in shown),
        unit,
        float(min(low for low, _ in orders)),
        float(max(high for _, high in orders)),
        math.nan,
        tuple(r.name for r, _ in shown),
    )


def _lines(name: str, unit: str, seen: Sequence[Found]) -> list[Unexplained]:
    """Lines of the motor angle and of time, those of one order or frequency together."""
    lines = [(r.name, x) for r, c in seen for x in c.lines if x.dependence != "load angle"]
    groups: list[list[tuple[str, Line]]] = []
    for recording, line in sorted(lines, key=lambda found: -found[1].amplitude):
        for group in groups:
            if _same(group[0][1], line):
                group.append((recording, line))
                break
        else:
            groups.append([(recording, line)])
    entries = []
    for group in groups[:MOST_LINES]:
        first = group[0][1]
        in_time = first.dependence == "time"
        order = math.nan if in_time else first.motor_order
        hertz = math.nan if first.dependence == "motor angle" else first.frequency_hz
        names = {recording for recording, _ in group}
        shown = tuple(r.name for r, _ in seen if r.name in names)
        entries.append(
            Unexplained(name, first.dependence, first.amplitude, unit, order, order, hertz, shown)
        )
    return entries


def _same(one: Line, other: Line) -> bool:
    if one.dependence != other.dependence:
        return False
    if one.dependence == "motor angle":
        return abs(one.motor_order - other.motor_order) < SAME_ORDER * one.motor_order
    return abs(one.frequency_hz - other.frequency_hz) < SAME_ORDER * one.frequency_hz


def _numbers(name: str, unit: str, seen: Sequence[Found], tests: int) -> Iterator[Unexplained]:
    """What a channel has one of: offset, drift, number of outliers; largest of those sure."""

    def numbers(c: ChannelResiduals) -> Iterator[tuple[What, str, float, bool]]:
        yield "offset", unit, c.offset, c.offset_significant
        yield "drift", f"{unit}/s", c.drift_per_s, _sure(c.drift_per_s / c.drift_error_per_s, tests)
        yield "outliers", "samples", c.outliers, c.outliers >= FEWEST_OUTLIERS

    of_recordings = [[(r.name, *number) for number in numbers(c)] for r, c in seen]
    for same in zip(*of_recordings, strict=True):
        shown = [(recording, value) for recording, _, _, value, sure in same if sure]
        if shown:
            _, what, own_unit, _, _ = same[0]
            largest = max((value for _, value in shown), key=abs)
            recordings = tuple(recording for recording, _ in shown)
            nan = math.nan
            yield Unexplained(name, what, largest, own_unit, nan, nan, nan, recordings)
