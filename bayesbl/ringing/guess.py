"""First guesses of the searched symbols, from the recording alone.

Damped-sinusoid templates are correlated with the speed, and each correlation is folded over every
candidate rotation period. A guess is a period with one phase where impacts of one sign pile up and
one where those of the other sign do. The power that the load-angle baseline explains at a period
counts too: under strong noise it determines T_w better than the pulses do. No prior knowledge of
T_w is needed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from scipy.fft import next_fast_len

from bayesbl.compiled import compiled
from bayesbl.errors import NoFlankChange
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.objective import SHORTEST_ROTATION_S, Objective
from bayesbl.ringing.symbols import (
    DECAY,
    DEFAULT_RANGES,
    FREQUENCY,
    ROTATION,
    SEPARATION,
    START,
    WINDOW_END,
    WINDOW_START,
    DisturbanceModel,
)

TEMPLATE_DECAY_PER_S = 12.0
SAMPLES_PER_RINGING = 8.0
"""Time resolution of the folding, in steps per ringing period of the template."""
FOLDS_KEPT = 24
PERIODOGRAM_PADDING = 8
LONGEST_ROTATION = 0.95
"""Longest candidate period as a share of the recording: beyond one rotation nothing repeats."""


def search_window(objective: Objective) -> tuple[float, float, float]:
    """Length of the pulse window, shortest and longest rotation period of a recording, all in s."""
    model = objective.model
    fixed = model.fixed
    end = fixed.get(WINDOW_END, model.ranges.get(WINDOW_END, (0.0, 0.204))[1])
    length = end - fixed.get(WINDOW_START, 0.0)
    longest = LONGEST_ROTATION * objective.duration_s
    low, high = model.ranges.get(ROTATION, (2.5 * length, longest))
    if ROTATION in fixed:
        low = high = fixed[ROTATION]
    return length, max(low, SHORTEST_ROTATION_S), min(high, longest)


def guesses(objective: Objective, count: int) -> FloatArray:
    """The most promising distinct starting points for a local search.

    Returns
    -------
    Shape (up to ``count``, d), columns in the order of ``objective.searched``, best first.
    """
    window_s, shortest_s, longest_s = search_window(objective)
    time_s, speed = objective.time_s, objective.speed_rpm - objective.offset_rpm
    # Drop in the sum of squares by one sinusoid, rpm²: a zero-padded periodogram.
    padded = np.fft.rfft(speed, PERIODOGRAM_PADDING * speed.size)
    power = 2.0 / speed.size * np.abs(padded) ** 2
    folds: list[tuple[float, float, float, float, float, float]] = []
    for decay, frequency in _templates(objective):
        response, step = _response(speed, objective.period_s, window_s, decay, frequency)
        folded = _fold_all(
            response,
            step,
            shortest_s,
            longest_s,
            window_s,
            power,
            PERIODOGRAM_PADDING * objective.duration_s,
            objective.model.baseline_harmonics,
        )
        folds += [(gain, decay, frequency, *fold_rest) for gain, *fold_rest in folded]
    if not folds:
        raise NoFlankChange(
            "Nothing in the motor's speed repeats with a rotation of the load: no impact shows.",
            found=f"a speed that varies by {np.ptp(speed):.3g} rpm",
            expected=f"ringing after impacts; where the load stays on one tooth flank (a vertical "
            f"axis, a balanced arm), {NoFlankChange.MOTION}",
        )
    folds.sort(reverse=True)
    points = np.concatenate(
        [_neighbours(objective, time_s[0], *fold[1:]) for fold in folds[:FOLDS_KEPT]]
    )
    order = np.argsort(objective.sum_of_squares(points), kind="stable")
    return _distinct(objective, points[order], count)


def _templates(objective: Objective) -> list[tuple[float, float]]:
    """(decay, frequency) pairs, spaced no farther than a template's own bandwidth."""
    fixed, ranges = objective.model.fixed, objective.model.ranges
    low, high = ranges.get(FREQUENCY, DEFAULT_RANGES[FREQUENCY])
    high = min(high, 0.8 * math.pi / objective.period_s)
    frequencies = [low]
    while frequencies[-1] < high:
        last = frequencies[-1]
        frequencies.append(last + min(0.18 * last, 1.4 * TEMPLATE_DECAY_PER_S))
    if FREQUENCY in fixed:
        frequencies = [fixed[FREQUENCY]]
    decay = fixed.get(DECAY, TEMPLATE_DECAY_PER_S)
    return [(decay, frequency) for frequency in frequencies]


def _response(
    speed_rpm: FloatArray, period_s: float, window_s: float, decay: float, frequency: float
) -> tuple[FloatArray, float]:
    """Matched-filter response, decimated to the resolution of its ringing; its step in s."""
    u = np.arange(0.0, window_s, period_s)
    template = np.exp(-decay * u) * np.sin(frequency * u)
    slow = np.stack([np.ones_like(u), u - u.mean()])
    template = template - (slow @ template / (slow**2).sum(axis=1)) @ slow
    template /= math.sqrt(template @ template)
    size = next_fast_len(speed_rpm.size + template.size, real=True)
    spectrum = np.fft.rfft(speed_rpm, size) * np.conj(np.fft.rfft(template, size))
    response = np.fft.irfft(spectrum, size)[: speed_rpm.size - template.size]
    stride = max(1, int(2.0 * math.pi / frequency / SAMPLES_PER_RINGING / period_s))
    return response[::stride].astype(np.float32), stride * period_s


@compiled()
def _add(total, row):  # type: ignore[no-untyped-def]
    for j in range(row.size):
        total[j] += row[j]


@compiled(fastmath={"nnan", "nsz", "reassoc"})
def _extremes(values):  # type: ignore[no-untyped-def]
    """Largest and smallest value, in a loop that vectorises (np.argmax does not)."""
    largest = values[0]
    smallest = values[0]
    for j in range(values.size):
        largest = max(largest, values[j])
        smallest = min(smallest, values[j])
    return largest, smallest


@compiled()
def _fold_all(  # type: ignore[no-untyped-def]
    response, step, shortest, longest, guard, power, power_length, harmonics
):
    """Best folds of a response over all periods: (gain, period, positive and negative phase).

    The gain is the drop in the sum of squares. It is (F₊ − F₋)² / number of pulses, for pulses of
    unit norm at the two phases, plus that of the baseline's harmonics. The phases are at least
    ``guard`` seconds apart, so that one impact does not count as both.
    """
    n = response.size
    kept = 6
    best = np.zeros((kept, 4))
    period = shortest
    folded = np.empty(n + 1, response.dtype)
    spacing = max(1, int(guard / step))
    while period <= longest:
        width = int(period / step)
        if width >= n or width < 2 * spacing + 2:
            period += step
            continue
        rotations = int(n * step / period)
        folded[:width] = 0.0
        pulses = 0
        for rotation in range(rotations + 1):
            begin = int(round(rotation * period / step))
            stop = min(width, n - begin)
            if stop < width and rotation > 1:
                break
            _add(folded[:stop], response[begin : begin + stop])
            pulses += 1
        baseline = 0.0
        for k in range(1, harmonics + 1):
            baseline += power[int(round(k * power_length / period))]
        largest, smallest = _extremes(folded[:width])
        if baseline + (largest - smallest) ** 2 / (2.0 * pulses) <= np.min(best[:, 0]):
            period += 2.0 * step / (rotations + 1)
            continue
        high = int(np.argmax(folded[:width]))
        low = int(np.argmin(folded[:width]))
        distance = abs(high - low)
        if min(distance, width - distance) < spacing:
            # Keep the stronger of the two and find the other one away from it.
            keep_high = folded[high] > -folded[low]
            centre = high if keep_high else low
            value = np.inf
            for j in range(width):
                distance_j = abs(j - centre)
                if min(distance_j, width - distance_j) >= spacing:
                    candidate = folded[j] if keep_high else -folded[j]
                    if candidate < value:
                        value = candidate
                        if keep_high:
                            low = j
                        else:
                            high = j
        gain = baseline + (folded[high] - folded[low]) ** 2 / (2.0 * pulses)
        # Neighbouring periods belong to one peak: keep the best of each peak.
        place = -1
        for k in range(kept):
            if best[k, 0] > 0.0 and abs(best[k, 1] - period) < 2.0 * step:
                place = k
        if place < 0:
            place = int(np.argmin(best[:, 0]))
        if gain > best[place, 0]:
            best[place, 0] = gain
            best[place, 1] = period
            best[place, 2] = high * step
            best[place, 3] = low * step
        period += 2.0 * step / (rotations + 1)
    return [(row[0], row[1], row[2], row[3]) for row in best if row[0] > 0.0]


def _neighbours(
    objective: Objective,
    origin_s: float,
    decay: float,
    frequency: float,
    rotation_s: float,
    positive_s: float,
    negative_s: float,
) -> FloatArray:
    """Points around one fold: phases shifted by up to half a ringing, periods and shapes nearby."""
    half = math.pi / frequency
    step = 2.0 * half / SAMPLES_PER_RINGING
    ranges = objective.model.ranges
    shifts = (-half, -2.0 * step, -step, 0.0, step, 2.0 * step, half)
    rotations = rotation_s + step * np.array([-0.5, 0.0, 0.5])
    axes = {
        START: [origin_s + positive_s + s for s in shifts],
        DECAY: [decay / 2.0, decay, 2.0 * decay],
        FREQUENCY: [0.93 * frequency, frequency, 1.07 * frequency],
        SEPARATION: [positive_s - negative_s + s for s in shifts],
        ROTATION: list(rotations),
        WINDOW_START: [np.mean(ranges.get(WINDOW_START, (0.0, 0.102)))],
        WINDOW_END: [np.mean(ranges.get(WINDOW_END, (0.15, 0.204)))],
    }
    axes |= {name: [value] for name, value in objective.model.fixed.items() if name in axes}
    mesh = np.meshgrid(*[np.asarray(axes[name]) for name in axes], indexing="ij")
    values = {name: grid.ravel() for name, grid in zip(axes, mesh, strict=True)}
    values = first_turn(objective.model, values, origin_s)
    return np.column_stack([values[name] for name in objective.searched])


Value = TypeVar("Value", float, FloatArray)


def first_turn(
    model: DisturbanceModel, values: dict[str, Value], begin_s: float
) -> dict[str, Value]:
    """Shift t0 and T, if searched, by whole rotations to the start of their range.

    Without a range, t0 starts at ``begin_s`` and T at 0.
    """
    begins = {START: begin_s, SEPARATION: 0.0} | range_starts(model)
    return wrapped(values, {n: begin for n, begin in begins.items() if n in model.searched})


def range_starts(model: DisturbanceModel) -> dict[str, float]:
    """Start of the ranges of t0 and T, s, where these have one."""
    return {name: model.ranges[name][0] for name in (START, SEPARATION) if name in model.ranges}


def wrapped(values: dict[str, Value], begins: Mapping[str, float]) -> dict[str, Value]:
    """Shift symbols by whole rotations into the rotation that starts at ``begins``, s."""
    rotation = values[ROTATION]
    return values | {n: begin + (values[n] - begin) % rotation for n, begin in begins.items()}


def _distinct(objective: Objective, points: FloatArray, count: int) -> FloatArray:
    """The first ``count`` points of which no two are close in phase."""
    kept: list[FloatArray] = []
    kept_symbols: list[dict[str, float]] = []
    for point in points:
        value = objective.model.named(point)
        quarter, rotation = 0.5 * math.pi / value[FREQUENCY], value[ROTATION]
        if not any(
            abs(other[ROTATION] - rotation) * objective.duration_s < quarter * rotation
            and phase_distance_s(value, other) < quarter
            for other in kept_symbols
        ):
            kept.append(point)
            kept_symbols.append(value)
        if len(kept) == count:
            break
    return np.array(kept)


def phase_distance_s(a: Mapping[str, float], b: Mapping[str, float]) -> float:
    """Largest difference of t0 and T modulo the rotation, s."""
    rotation = a[ROTATION]
    differences = [(a[n] - b[n]) % rotation for n in (START, SEPARATION)]
    return max(min(d, rotation - d) for d in differences)
