"""Lines of a residual that are of the motor's angle, and their rivals, which only look like it.

At one speed ω an order n of the motor's turning and the frequency n ω/2π in time are the same. A
line is of the angle, or of time, only where it is there at other speeds too: of the one whose wave
is the larger where it is smaller. (It need not be as large there: above the loop's bandwidth the
inertia carries part of a ripple.) All else was seen at one speed only. Of that, what has the
frequency at which a stepped position passes its steps, as the sampling shows it, is the
encoder's:

    |ω/q − k/T|,   q the step, T the sampling period, k the nearest whole number
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Literal

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from bayesbl.diagnosis.residuals.unexplained import Unexplained
from bayesbl.diagnosis.rigid.order_scan import (
    FEWEST_SAMPLES,
    STEPS_PER_CYCLE,
    OrderedRest,
    Owner,
    owner_of,
    spectrum_of,
    sums_of,
    turns_of,
)
from bayesbl.recording.types import BoolArray, FloatArray
from bayesbl.units import unit_of

MOST_REMAINING = 5
MOST_LINES = 8
"""Looked at, each beneath the stronger ones."""

CLEAREST = 3
"""Lines, of which one may be named: one that stands out more need not be larger."""

LINE_ALARM = 0.01
"""False alarms of a line where there is none, and of its being there at other speeds."""

OTHER_SPEED = 1.25
"""From one speed to another: nearer, a motion that sways has one line at both."""

STEP_HARMONICS = 8
_SPEEDS = 60
_WIDEST = 0.02
"""Of the sampling rate: where the steps' frequency is less sure, no line is known to be theirs."""


@dataclass(frozen=True, slots=True)
class Line:
    """Something periodic in residuals.

    Attributes
    ----------
    order, frequency_hz
        At the speed at which it is strongest.
    score, trials
        Of the order; how much likelier it is somewhere than at one order.
    amplitude
        Where it is strongest, if it is not of the angle.
    slowest, fastest
        Speeds at which it is strongest, rad/s.
    """

    order: float
    frequency_hz: float
    dependence: Literal["motor angle", "time", "angle or time", "encoder"]
    score: float
    trials: float
    amplitude: float
    slowest: float
    fastest: float


def of_angle(lines: Sequence[Line]) -> Line | None:
    """The largest that is of the motor's angle."""
    own = [line for line in lines if line.dependence == "motor angle"]
    return max(own, key=lambda line: line.amplitude, default=None)


@dataclass(frozen=True, slots=True)
class OrderScan:
    """Residuals over the motor's angle; ``shared``: all recordings have one phase."""

    rests: tuple[OrderedRest, ...]
    shared: bool

    @property
    def step(self) -> float:
        """Between orders looked at."""
        return 1.0 / (STEPS_PER_CYCLE * turns_of(self.rests, self.shared))

    def clearest(self) -> list[Line]:
        """The few lines that stand out most."""
        return list(islice(self.lines(LINE_ALARM), CLEAREST))

    def lines(self, false_alarm: float) -> Iterator[Line]:
        """What stands out, the strongest first, each of what the stronger ones leave.

        Neighbours within two resolved cycles belong to the stronger line.
        """
        scan, known = self, list[float]()
        while len(known) < MOST_LINES:
            spectrum = spectrum_of(scan.rests, self.shared)
            if not spectrum.orders.size:
                return
            width = 2.0 * STEPS_PER_CYCLE * self.step
            scores = spectrum.scores.copy()
            for order in known:
                scores[np.abs(spectrum.orders - order) <= width] = 0.0
            k = int(np.argmax(scores))
            score, trials = float(scores[k]), spectrum.trials(float(scores[k]))
            if trials * chi2.sf(score, spectrum.freedom) > false_alarm:
                return
            powers = {owner: float(power[k]) for owner, power in spectrum.powers.items()}
            found = _Found(float(spectrum.orders[k]), powers, scan.rests, self.shared)
            known.append(found.order)
            line = found.told(score, trials, float(spectrum.amplitudes[k]), width)
            yield line
            scan = replace(scan, rests=found.removed(line))

    def remaining(
        self, channel: str, recordings: tuple[str, ...], false_alarm: float
    ) -> tuple[Unexplained, ...]:
        """Lines that stand out, strongest first, at most :data:`MOST_REMAINING`.

        ``recordings`` are those that were scanned. What the encoder's steps make is no torque.
        """
        told = []
        for line in islice(self.lines(false_alarm), MOST_REMAINING):
            if line.dependence == "encoder":
                continue
            order = math.nan if line.dependence == "time" else line.order
            hertz = math.nan if line.dependence == "motor angle" else line.frequency_hz
            unit, what = unit_of(channel), line.dependence
            told.append(
                Unexplained(
                    channel, what, line.amplitude, unit, order, order, hertz, recordings, line.score
                )
            )
        return tuple(told)


class _Found:
    """A line at an order, and the samples that could show it."""

    def __init__(
        self,
        order: float,
        powers: dict[Owner, float],
        rests: Sequence[OrderedRest],
        shared: bool,
    ) -> None:
        self.order = order
        self._rests, self._powers, self._shared = rests, powers, shared
        self._shown = [item.shows(order) for item in rests]
        self._rows = [(r, s) for r, s in zip(rests, self._shown, strict=True)]

    def told(self, score: float, trials: float, amplitude: float, width: float) -> Line:
        """What it belongs to; ``width``: of an order, as these recordings resolve it."""
        (slowest, fastest), largest = self._strongest()
        inside = [(r.speed >= slowest) & (r.speed < fastest) for r in self._rests]
        chosen = [s & i for s, i in zip(self._shown, inside, strict=True)]
        speeds = np.concatenate([r.speed[c] for r, c in zip(self._rests, chosen, strict=True)])
        speed, unsure_of_speed = _steady(speeds)
        hertz = self.order * speed / (2.0 * math.pi)

        def line(
            what: Literal["motor angle", "time", "angle or time", "encoder"],
            hertz: float,
            amplitude: float,
        ) -> Line:
            return Line(self.order, hertz, what, score, trials, amplitude, slowest, fastest)

        rate = 1.0 / min(item.period_s for item in self._rests)
        sampled = _as_sampled(hertz, rate)
        exact = self._frequency(sampled)
        turning = [self.order * r.angle for r in self._rests]
        passing = [2.0 * math.pi * exact * r.time_s for r in self._rests]
        of_angle = self._everywhere(turning, inside, self._shared)
        of_time = self._everywhere(passing, inside, False)
        if of_angle > of_time:
            return line("motor angle", hertz, amplitude)
        if of_time > 0.0:
            return line("time", exact, largest)
        step = max(item.step_rad for item in self._rests)
        if step > 0.0:
            for k in range(1, STEP_HARMONICS + 1):
                unsure = width * speed / (2.0 * math.pi) + k * unsure_of_speed / step
                off = abs(_as_sampled(k * speed / step, rate) - sampled)
                if off < unsure < _WIDEST * rate:
                    return line("encoder", sampled, largest)
        return line("angle or time", sampled, largest)

    def removed(self, line: Line) -> tuple[OrderedRest, ...]:
        """Residuals without the line: with one phase if it is known to have one."""
        found = []
        for item, shown in self._rows:
            rest = item.rest.copy()
            phase = self.order * item.angle
            runs = [np.flatnonzero(shown)]
            if line.dependence == "time":
                phase = 2.0 * math.pi * line.frequency_hz * item.time_s
                runs = [np.arange(rest.size)]
            elif line.dependence != "motor angle":
                inside = (item.speed >= line.slowest) & (item.speed < line.fastest)
                rows = np.flatnonzero(shown & inside)
                runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
            for rows in runs:
                if rows.size >= FEWEST_SAMPLES:
                    waves = np.column_stack([np.cos(phase[rows]), np.sin(phase[rows])])
                    rest[rows] -= waves @ np.linalg.lstsq(waves, rest[rows])[0]
            found.append(replace(item, rest=rest))
        return tuple(found)

    def _strongest(self) -> tuple[tuple[float, float], float]:
        """Where it stands out most, of speeds up to :data:`OTHER_SPEED` apart; its size there."""
        every = np.concatenate([r.speed[s] for r, s in self._rows])
        top = float(every.max())
        lows = np.geomspace(max(float(every.min()), 1e-2 * top), top, _SPEEDS)
        lows /= math.sqrt(OTHER_SPEED)
        score, size, count = np.zeros((3, lows.size))
        for item, shown in self._rows:
            speed, rest = item.speed[shown], item.rest[shown]
            order = np.argsort(speed)
            wave = rest * np.exp(1j * self.order * item.angle[shown])
            sums = np.concatenate(([0.0], np.cumsum(wave[order])))
            first = np.searchsorted(speed[order], lows)
            last = np.searchsorted(speed[order], OTHER_SPEED * lows)
            squares = np.concatenate(([0.0], np.cumsum(rest[order] ** 2)))
            within = np.abs(sums[last] - sums[first])
            noise = np.maximum(
                0.5 * (squares[last] - squares[first]),
                self._powers[owner_of(item, self._shared)] * (last - first),
            )
            score += within**2 / np.where(noise > 0.0, noise, np.inf)
            size += within
            count += last - first
        k = int(np.argmax(score))
        ends = float(lows[k]), float(OTHER_SPEED * lows[k])
        return ends, 2.0 * float(size[k]) / max(float(count[k]), 1.0)

    def _everywhere(
        self, phases: Sequence[FloatArray], inside: Sequence[BoolArray], shared: bool
    ) -> float:
        """Size of a wave where it is smaller, at the line's own speeds or at all others.

        Zero where it is not beyond the noise at the others.
        """
        sums = dict[Owner, list[complex]]()
        for (item, shown), phase, near in zip(self._rows, phases, inside, strict=True):
            wave = item.rest * np.exp(1j * phase)
            own = sums.setdefault(owner_of(item, shared), [0j, 0j, 0.0, 0.0, 0.0])
            power = self._powers[owner_of(item, self._shared)]
            for side, rows in enumerate((shown & near, shown & ~near)):
                own[side] += complex(wave[rows].sum())
                own[2 + side] += np.count_nonzero(rows)
            away = item.rest[shown & ~near]
            own[4] += max(power * away.size, 0.5 * float(away @ away))
        found = [own for own in sums.values() if own[3].real >= FEWEST_SAMPLES]
        if not found:
            return 0.0
        score = sum(abs(own[1]) ** 2 / own[4].real for own in found if own[4].real > 0.0)
        if chi2.sf(score, 2 * len(found)) > LINE_ALARM:
            return 0.0
        return min(
            sum(abs(own[side]) for own in found)
            / max(sum(own[2 + side].real for own in found), 1.0)
            for side in (0, 1)
        )

    def _frequency(self, near: float) -> float:
        """Of the strongest line in time around a frequency, Hz."""
        lasting = max(float(np.ptp(item.time_s)) for item in self._rests)
        step = 1.0 / (STEPS_PER_CYCLE * lasting)
        low, high = (round(near * ratio / step) for ratio in (1.0 / OTHER_SPEED, OTHER_SPEED))
        power = np.zeros(high - low + 1)
        for item in self._rests:
            found = sums_of(item.time_s, item.rest, 2.0 * math.pi * step, high + 1)
            power += np.abs(found[low:]) ** 2 / item.rest.size
        best = step * (low + int(np.argmax(power)))

        def less(hertz: float) -> float:
            waves = (np.exp(2.0j * math.pi * hertz * item.time_s) for item in self._rests)
            pairs = zip(waves, self._rests, strict=True)
            return -sum(
                abs(complex(wave @ item.rest)) ** 2 / item.rest.size for wave, item in pairs
            )

        found = minimize_scalar(less, bounds=(best - step, best + step), method="bounded")
        return float(found.x)


def _as_sampled(hertz: float, rate: float) -> float:
    """The frequency that samples show of another, Hz."""
    return abs(hertz - round(hertz / rate) * rate)


def _steady(speeds: FloatArray) -> tuple[float, float]:
    """The speed around which half of all lie closest, and how unsure it is, rad/s."""
    ordered = np.sort(speeds)
    half = max(ordered.size // 2, 1)
    first = int(np.argmin(ordered[half - 1 :] - ordered[: ordered.size - half + 1]))
    closest = ordered[first : first + half]
    return float(closest.mean()), float(np.ptp(closest)) / math.sqrt(half)
