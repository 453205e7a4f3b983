"""What speaks for an explanation: gains in every rotation, and how much of what repeats is gone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import begin_of, whole_rotations
from bayesbl.matching.predictive_check import (
    RepeatingPower,
    agrees,
    disagreements,
)
from bayesbl.naming.explanation import BEHIND, Explanation, distance, noise_between
from bayesbl.probabilities import f_isf
from bayesbl.recording.types import FloatArray

ALIKE = 5.0
"""|z| between two best fits below which the recordings do not tell them apart."""

ENOUGH_CLOSED = 0.95
ENOUGH_CLOSED_BY_PARAMETERS = 0.99
"""Share of what repeats that an explanation must remove where something still repeats after it.

Several parameters, each a little wrong, imitate much: more is asked of an explanation with them.
"""

GROSS = 1.05
"""χ² per sample that counts as far off: the gap may be in another place of its range.

Of a bench that lacked an effect the fitted gap was at most 8 % off below it, near enough to go on
from, and up to a factor of two above it (``configs/far_off.toml``: 24 and 36 cases). Noise alone is
below it by 4.5 standard deviations, √(2/N + 2.5/N) for a variance over one learnt from rotation
differences, in N = 36000 samples (five rotations at 1 kHz, speed and current); it exceeds it once
in six times at N = 1800, which costs only the wider search.
"""

BEYOND_CHANCE = 2.0
"""Standard deviations of noise subtracted from the remainder before it speaks against a name."""

SLACK = 100.0
"""χ² by which what a rough fit or a promise leaves may besides be larger than what the best leaves:
rivals are those within 25."""

CHANCE_LOSS = 6.6
"""χ² that one recording may lose by chance: once in a hundred, with one degree of freedom."""


def is_gross(explanation: Explanation) -> bool:
    """Whether the simulation is far off, so that other optima of the gap come into question."""
    return explanation.fit.chi_square > GROSS * explanation.fit.residual.size


def gross_recordings(explanation: Explanation) -> list[str]:
    """Names of the recordings that are far off themselves."""
    parts = explanation.fit.model.by_recording(explanation.fit.residual)
    named = zip(explanation.fit.model.recordings, parts, strict=True)
    return [seen.name for seen, part in named if float(np.sum(part**2)) > GROSS * part.size]


def left(explanation: Explanation) -> float:
    """χ² beyond that of noise."""
    return explanation.fit.chi_square - explanation.fit.residual.size


def contends(left: float, least: float) -> bool:
    """Whether what a rough fit or a promise leaves is near enough to the least that one leaves."""
    return left - least < (BEHIND - 1.0) * max(least, 0.0) + SLACK


def are_alike(a: Explanation, b: Explanation, scale: float = 1.0) -> bool:
    """Whether the recordings do not tell two explanations apart.

    ``scale``: variance over that of noise of what neither explains.
    """
    apart = distance(a, b) / math.sqrt(scale)
    return apart < ALIKE or apart < ALIKE * math.sqrt(float(np.mean(noise_between(a, b))))


def misfit_scale(fit: SimulatedFit, false_alarm: float = 0.01) -> float:
    """Variance, over that of noise, of what repeats and no name explains; 1 where only noise is."""
    scale, _ = _misfit(fit, false_alarm)
    return scale


def least_ratio(fit: SimulatedFit, added: int, trials: int, false_alarm: float) -> float:
    """Gain over what is left beyond noise that a name asks for, so many unknowns added; 0 if none.

    Beside a law that no catalogue has, every column gains something: what is left is the noise that
    a gain is held against, in an F test.
    """
    _, degrees = _misfit(fit, false_alarm)
    if math.isinf(degrees):
        return 0.0
    return added / degrees * f_isf(false_alarm / max(trials, 1), added, degrees)


def stands_out_of_misfit(
    base: Explanation, more: Explanation, trials: int, false_alarm: float
) -> bool:
    """Whether a name explains more than chance would of what ``more`` leaves."""
    scale, degrees = _misfit(more.fit, false_alarm)
    if math.isinf(degrees):
        return True
    least = least_ratio(more.fit, more.parameters - base.parameters, trials, false_alarm)
    return base.fit.chi_square - more.fit.chi_square > least * degrees * scale


def _misfit(fit: SimulatedFit, false_alarm: float) -> tuple[float, float]:
    """What repeats beyond noise: its χ² per degree of freedom, and how many degrees it has.

    2 (Σ|s|²)²/Σ|s|⁴ is the number of degrees that a misfit of few orders has. (1, ∞) where all
    that is left is noise.
    """
    if agrees(disagreements(fit), false_alarm):
        return 1.0, math.inf
    first, second = _repeating(fit)
    if first <= 0.0 or second <= 0.0:
        return 1.0, math.inf
    degrees = 2.0 * first**2 / second
    return max(first / degrees, 1.0), degrees


def repeating_misfit(fit: SimulatedFit) -> float:
    """χ² beyond noise of what repeats; about zero, either sign, where only noise is."""
    return _repeating(fit)[0]


def _repeating(fit: SimulatedFit) -> tuple[float, float]:
    """Σ|s|² and Σ|s|⁴ of what repeats.

    Of P = |s|² + noise at every order, with the noise's χ² of two degrees, Σ(P − 2) and
    Σ(P² − 8P + 8) estimate them.
    """
    first = second = 0.0
    parts = fit.model.by_recording(fit.residual)
    for seen, part in zip(fit.model.recordings, parts, strict=True):
        repeats = seen.motion is None or seen.cycle is not None
        for row in part[:, begin_of(seen) :]:
            turns = whole_rotations(row, seen.lag) if repeats else row[None]
            power = np.abs(np.fft.rfft(turns.mean(axis=0))) ** 2
            power *= len(turns) * 2.0 / turns.shape[1]
            power[0] *= 0.5
            first += float(np.sum(power - 2.0))
            second += float(np.sum(power**2 - 8.0 * power + 8.0))
    return first, second


def explains(
    nominal: Explanation,
    final: Explanation,
    before: Sequence[RepeatingPower],
    remaining: Sequence[RepeatingPower],
    false_alarm: float,
) -> bool:
    """Whether the best explanation found removes enough of what repeats.

    Parameters
    ----------
    before, remaining
        What repeats with nothing added and with the explanation.
    false_alarm
        Probability of finding that something repeats where nothing does.
    """
    if agrees(list(remaining), false_alarm):
        return True
    known = _squares(nominal.fit.deviations) - _squares(final.fit.deviations)
    return _remaining_share(before, remaining, known) <= 1.0 - enough_closed(final)


def enough_closed(explanation: Explanation) -> float:
    """Share that must be gone if not all of it is."""
    effects = all(c.kind == "effect" for c in explanation.candidates)
    return ENOUGH_CLOSED if effects else ENOUGH_CLOSED_BY_PARAMETERS


def _remaining_share(
    before: Sequence[RepeatingPower], after: Sequence[RepeatingPower], known: float
) -> float:
    """Share of the χ² that repeats beyond noise which surely remains, over mean and widest band.

    ``known`` is what the prior gained besides, as of a known start angle.
    """
    widest = max(entry.highest_order for entry in before)
    first, last = (
        sum(_degrees(e) * (e.ratio - 1.0) for e in entries if e.highest_order in (0, widest))
        for entries in (before, after)
    )
    degrees = sum(_degrees(e) for e in after if e.highest_order in (0, widest))
    there = first + max(known, 0.0)
    return (last - BEYOND_CHANCE * math.sqrt(2.0 * degrees)) / there if there > 0.0 else 1.0


def _degrees(entry: RepeatingPower) -> float:
    return 2.0 * entry.highest_order if entry.highest_order else 1.0


def consistency(base: SimulatedFit, more: SimulatedFit) -> float:
    """Mean gain of χ² per rotation over its standard error.

    An effect may show in one recording more than in another: where no recording loses, the gains
    scatter about their own recording's mean, else about the mean of all. What a normal prior gains,
    as of a known start angle, holds in all rotations alike.
    """
    gains = gains_per_rotation(base, more)
    values = np.concatenate(gains)
    none_loses = all(part.sum() > -CHANCE_LOSS for part in gains)
    if not none_loses or min(part.size for part in gains) < 2:
        gains = [values]
    squares = sum(_squares(part - part.mean()) for part in gains)
    error = math.sqrt(squares / max(values.size - len(gains), 1) / values.size)
    known = _squares(base.deviations) - _squares(more.deviations)
    mean = float(values.mean()) + known / values.size
    return mean / error if error > 0.0 else math.inf


def gains_per_rotation(base: SimulatedFit, more: SimulatedFit) -> list[FloatArray]:
    """Drop of χ² in each whole rotation, a vector for each recording."""
    gains = []
    parts = base.model.by_recording(base.residual**2 - more.residual**2)
    for seen, change in zip(base.model.recordings, parts, strict=True):
        gains.append(whole_rotations(change.sum(axis=0), seen.lag).sum(axis=1))
    return gains


def _squares(values: FloatArray) -> float:
    return float(values @ values)
