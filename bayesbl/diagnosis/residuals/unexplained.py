"""Residuals in a few entries: channel, order or frequency, amplitude, what they depend on."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from scipy.stats import norm

from bayesbl.diagnosis.residuals.analysis import (
    ChannelResiduals,
    RecordingResiduals,
    ResidualAnalysis,
)
from bayesbl.diagnosis.residuals.lines import Line
from bayesbl.units import unit_of

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
