"""Motor orders that stand out of the noise around them in a residual."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft
from scipy.ndimage import median_filter
from scipy.optimize import minimize_scalar
from scipy.special import gammaln, logsumexp
from scipy.stats import chi2

from bayesbl.recording.types import BoolArray, ComplexArray, FloatArray

FEWEST_CYCLES = 3.0
FEWEST_SAMPLES = 20
"""Fewest cycles and samples of an order for its score to be a χ²."""

CHANCE = 0.5
"""False-alarm probability up to which a line becomes a candidate; the search decides."""

WHOLE = 0.25
"""Standard deviation of an order up to which it can be recognised as whole."""

SLOW_SHARE = 0.1
"""Share of the time in which the highest order has less than two samples in a period."""

STEPS_PER_CYCLE = 5.0
_MOST_ORDERS = 100_000
_LEVEL_CYCLES = 40.0
"""Resolved cycles over which the noise is averaged: many lines wide, few in the whole range."""

_OVERSAMPLING = 8
"""Bins in a period of the highest order: aliases of higher orders are below 2 %."""

_SLOWEST = 1e-6
"""Smallest speed relative to the largest, for a motor that stands."""

Owner = tuple[bool, str]
"""Data that share one phase: above the cut-off or not, and the recording ("" for all)."""


@dataclass(frozen=True, slots=True)
class OrderedRest:
    """A residual over the motor angle, rad, each of shape (n,).

    ``speed``: absolute motor speed, rad/s; ``cutoff_hz``, ``above``: cut-off of the filter, and
    whether the residual is what lies above it; ``period_s``, ``step_rad``: sampling period, and
    step of the position; 0 without steps.
    """

    recording: str
    time_s: FloatArray
    angle: FloatArray
    speed: FloatArray
    rest: FloatArray
    cutoff_hz: float
    above: bool
    period_s: float
    step_rad: float = 0.0

    @property
    def passing(self) -> FloatArray:
        """Motor order at the cut-off frequency, shape (n,)."""
        slowest = max(_SLOWEST * float(self.speed.max()), np.finfo(float).tiny)
        return 2.0 * math.pi * self.cutoff_hz / np.maximum(self.speed, slowest)

    def shows(self, order: float) -> BoolArray:
        """Mask of the samples that show an order, shape (n,)."""
        return np.asarray(self.passing <= order if self.above else self.passing > order)


@dataclass(frozen=True, slots=True)
class OrderSpectrum:
    """Score of each order: χ² if there is only noise.

    The score is |Σ r exp(i n θ)|² over half of its expectation under noise. This is the median of
    the neighbouring orders, which a line does not affect, but at least that of white noise, so that
    leakage of a line into a quiet region is no line. Recordings with a common phase are summed
    before squaring, others after. Samples above and below the cut-off are scored separately,
    because a ripple may show only at high speed.

    ``orders``, ``scores``: shape (m,), evenly spaced; empty if the motor does not turn far enough;
    ``powers``: half of the expectation of |Σ r exp(i n θ)|² under noise, for each owner, shape
    (m,); 0 if the owner does not show the order; ``independent``: number of independent orders.
    """

    orders: FloatArray
    scores: FloatArray
    powers: dict[Owner, FloatArray]
    independent: float

    def log_chance(self) -> FloatArray:
        """ln of the false-alarm probability of each score among all orders, shape (m,).

        It is W √(χ²/2) times that of one order, with W independent orders, because the score can be
        higher between them (Baluev 2008). For 2 m degrees of freedom, that of one order is
        exp(−x/2) Σ (x/2)ʲ/j!, j < m. Scores of a thousand are common, hence the logarithms.
        """
        owners = np.sum([power > 0.0 for power in self.powers.values()], axis=0)
        j, half = np.arange(len(self.powers))[:, None], np.maximum(0.5 * self.scores, 1e-12)
        terms = np.where(j < np.maximum(owners, 1), j * np.log(half) - gammaln(j + 1.0), -np.inf)
        rise = self.independent * np.sqrt(np.maximum(1.0, half))
        return np.asarray(logsumexp(terms, axis=0) - half + np.log(rise))


def turns_of(rests: Sequence[OrderedRest], shared: bool) -> float:
    """Motor turns in the longest recording, or over all recordings if they share one phase."""
    ends = [(float(item.angle.min()), float(item.angle.max())) for item in rests]
    if shared:
        ends = [(min(first for first, _ in ends), max(last for _, last in ends))]
    return max(last - first for first, last in ends) / (2.0 * math.pi)


def order_range(
    rests: Sequence[OrderedRest], turns: float, highest: float = math.inf
) -> tuple[float, float]:
    """Lowest and highest order that recordings can show, whatever the unit of the angle.

    From three cycles in the whole travel to two samples, or two position steps, per cycle.
    """
    speeds = np.concatenate([item.speed for item in rests])
    slow = float(np.quantile(speeds, SLOW_SHARE))
    if not (turns > 0.0 and slow > 0.0):
        return math.inf, 0.0
    sampled = math.pi / slow / min(item.period_s for item in rests)
    stepped = [math.pi / item.step_rad for item in rests if item.step_rad > 0.0]
    return FEWEST_CYCLES / turns, min(
        highest, sampled, _MOST_ORDERS / STEPS_PER_CYCLE / turns, *stepped
    )


def owner_of(item: OrderedRest, shared: bool) -> Owner:
    """Owner of a residual."""
    return item.above, "" if shared else item.recording


def spectrum_of(
    rests: Sequence[OrderedRest], shared: bool, *, highest: float = math.inf, coloured: bool = False
) -> OrderSpectrum:
    """Score all orders.

    ``shared``: whether all recordings share one phase; ``highest``: highest order; ``coloured``:
    whether noise is estimated from the neighbouring orders alone, because it may be coloured.
    """
    turns = turns_of(rests, shared)
    low, high = order_range(rests, turns, highest)
    owners = [owner_of(item, shared) for item in rests]
    if not (high - low) * turns * STEPS_PER_CYCLE >= 2.0:
        nothing = np.array([])
        return OrderSpectrum(nothing, nothing, dict.fromkeys(owners, nothing), 1.0)
    step = 1.0 / (STEPS_PER_CYCLE * turns)
    orders: FloatArray = step * np.arange(math.ceil(low / step), math.floor(high / step) + 1.0)
    waves = {owner: np.zeros(orders.size, dtype=complex) for owner in owners}
    powers = {owner: np.zeros(orders.size) for owner in owners}
    for owner, item in zip(owners, rests, strict=True):
        transform, samples, white = _transform(item, orders)
        own, level = turns_of([item], shared), np.zeros(orders.size)
        enough = (samples >= FEWEST_SAMPLES) & (orders * own >= FEWEST_CYCLES)
        # SciPy's filter of more than there are takes a thousand times as long.
        most = max(int(np.count_nonzero(enough)), 1)
        around = round(_LEVEL_CYCLES / max(step * own, _LEVEL_CYCLES / most))
        level[enough] = median_filter(np.abs(transform[enough]) ** 2, around)
        waves[owner] += np.where(enough, transform, 0.0)
        least = 0.0 if coloured else white
        powers[owner] += np.where(enough, np.maximum(level / chi2.median(2), least), 0.0)
    scores = np.zeros(orders.size)
    for owner, wave in waves.items():
        scores += np.abs(wave) ** 2 / np.where(powers[owner] > 0.0, powers[owner], np.inf)
    return OrderSpectrum(orders, scores, powers, max(1.0, (high - low) * turns))


def sums_of(x: FloatArray, values: FloatArray, step: float, count: int) -> ComplexArray:
    """Σ v exp(i k step x) for k = 0 … count − 1, shape (count,).

    Each value is divided between the two nearest bins of a fast Fourier transform.
    """
    size = fft.next_fast_len(_OVERSAMPLING * count, real=True)
    place = (x * (step * size / (2.0 * math.pi))) % size
    first = np.floor(place).astype(np.intp)
    share = place - first
    bins = np.bincount(first % size, values * (1.0 - share), size)
    bins += np.bincount((first + 1) % size, values * share, size)
    sums = np.conj(fft.rfft(bins)[:count]) / np.sinc(np.arange(count) / size) ** 2
    return np.asarray(sums, dtype=complex)


def _transform(
    item: OrderedRest, orders: FloatArray
) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Σ r exp(i n θ), number of samples that show the order, and ½ Σ r² of these, (m,) each.

    Samples that do not show an order have no such signal or noise behind the filter.
    """
    step = float(orders[1] - orders[0])
    first = round(float(orders[0]) / step)
    sums = sums_of(item.angle, item.rest, step, first + orders.size)[first:]
    fastest_first = np.argsort(item.passing)
    samples = np.searchsorted(item.passing[fastest_first], orders, side="right")
    squares = np.concatenate([[0.0], np.cumsum(item.rest[fastest_first] ** 2)])
    powers = squares[samples]
    if not item.above:
        samples, powers = item.rest.size - samples, squares[-1] - powers
    return sums, np.asarray(samples, dtype=float), np.asarray(0.5 * powers)


@dataclass(frozen=True, slots=True)
class Line:
    """A line that becomes a candidate.

    ``values``: orders or frequencies to try, evenly spaced except for a whole one; ``anywhere``,
    ``whole``: prior weight of all values together, and the additional weight of a whole order.
    """

    values: tuple[float, ...]
    anywhere: float
    whole: float

    @classmethod
    def around(cls, centre: float, step: float, anywhere: float, whole: float = 0.0) -> Line:
        """Five values one step apart, and the nearest whole one if it has a weight."""
        values = set((centre + step * np.arange(-2.0, 3.0)).tolist())
        if whole:
            values.add(float(round(centre)))
        return cls(tuple(sorted(values)), anywhere, whole)

    @property
    def middle(self) -> float:
        """Middle value."""
        return self.values[len(self.values) // 2]

    @property
    def weights(self) -> tuple[float, ...]:
        """Prior weight of each value."""
        even = self.anywhere / len(self.values)
        return tuple(even + self.whole * float(v == round(v)) for v in self.values)

    def finer(self, centre: float, sd: float) -> Line:
        """The line around its most probable value, with steps of its standard deviation."""
        step = float(np.median(np.diff(self.values)))
        return Line.around(centre, _halved(step, max(sd, 0.25 * step)), self.anywhere, self.whole)


def _halved(step: float, size: float) -> float:
    """A step halved or doubled to about a size, so that it does not depend on rounding."""
    return float(step * 2.0 ** round(math.log2(size / step)))


@dataclass(frozen=True, slots=True)
class Peak:
    """An order that stands out of a spectrum.

    ``sd``: standard deviation of the order; ``score``: χ²; ``log_chance``: ln of the false-alarm
    probability; ``behind``: χ² by which the nearest whole order is worse.
    """

    order: float
    sd: float
    score: float
    log_chance: float
    behind: float
    spectrum: OrderSpectrum

    @property
    def step(self) -> float:
        """Distance between orders of the spectrum."""
        return float(self.spectrum.orders[1] - self.spectrum.orders[0])


def clearest(
    rests: Sequence[OrderedRest],
    known: Iterable[float],
    shared: bool,
    *,
    highest: float = math.inf,
    coloured: bool = False,
) -> Peak | None:
    """The order that stands out most, away from known ones; ``None`` if no order is shown.

    Other parameters as :func:`spectrum_of` takes them.
    """
    spectrum = spectrum_of(rests, shared, highest=highest, coloured=coloured)
    if not spectrum.orders.size:
        return None
    chance = spectrum.log_chance()
    for order in known:
        near = np.abs(spectrum.orders - order) <= 2.0 / turns_of(rests, shared)
        chance[near] = math.inf
    k = int(np.argmin(chance))
    order, sd, behind = _sharp(rests, shared, spectrum, k)
    return Peak(order, sd, float(spectrum.scores[k]), float(chance[k]), behind, spectrum)


def peaks(
    rests: Sequence[OrderedRest], shared: bool, most: int, *, whole: bool = True
) -> list[Line]:
    """Orders that stand out most, each after subtraction of the stronger ones.

    All resolved orders are equally probable a priori. But if ``whole``, half of the probability
    belongs to whole orders, because whatever is fixed to the motor repeats with its turn.
    """
    lines: list[Line] = []
    known: list[float] = []
    while len(lines) < most:
        peak = clearest(rests, known, shared)
        if peak is None or peak.log_chance > math.log(CHANCE):
            break
        order, sd, nearest = peak.order, peak.sd, round(peak.order)
        near = whole and nearest > 0 and abs(order - nearest) < peak.step and sd < WHOLE
        # The values have the share of a resolved order that they cover.
        share = (0.5 if whole else 1.0) * min(1.0, 5.0 * sd / (STEPS_PER_CYCLE * peak.step))
        special = 0.5 / max(1.0, float(peak.spectrum.orders[-1])) if near else 0.0
        anywhere = min(1.0, share / peak.spectrum.independent)
        lines.append(Line.around(order, sd, anywhere, special))
        known.append(order)
        rests = [_without(item, order) for item in rests]
    return lines


def _sharp(
    rests: Sequence[OrderedRest], shared: bool, spectrum: OrderSpectrum, k: int
) -> tuple[float, float, float]:
    """Best order near one of a spectrum, its standard deviation, and the χ² by which the nearest
    whole order is worse.

    A frequency with score χ² in a time T has √6/(π T √χ²) (Rife and Boorstyn 1974).
    """
    order, step = float(spectrum.orders[k]), float(spectrum.orders[1] - spectrum.orders[0])

    def score(at: float) -> float:
        waves = dict.fromkeys(spectrum.powers, 0.0j)
        for item in rests:
            waves[owner_of(item, shared)] += item.rest @ np.exp(1j * at * item.angle)
        noise = {owner: float(power[k]) for owner, power in spectrum.powers.items()}
        return sum(abs(waves[o]) ** 2 / noise[o] for o in waves if noise[o] > 0.0)

    ends = (order - step, order + step)
    exact = {"xatol": 1e-4 * step}
    best = minimize_scalar(lambda at: -score(at), bounds=ends, method="bounded", options=exact)
    sd = math.sqrt(6.0) / math.pi * STEPS_PER_CYCLE * step / math.sqrt(max(1.0, -float(best.fun)))
    sd = _halved(step, min(sd, 0.5 * step))
    behind = -float(best.fun) - score(float(round(best.x)))
    return sd * round(float(best.x) / sd), sd, behind


def _without(item: OrderedRest, order: float) -> OrderedRest:
    """The residual without the wave of an order, at the samples that show it."""
    rows = np.flatnonzero(item.shows(order))
    if rows.size < FEWEST_SAMPLES:
        return item
    phase = order * item.angle[rows]
    waves = np.column_stack([np.cos(phase), np.sin(phase)])
    rest = item.rest.copy()
    rest[rows] -= waves @ np.linalg.lstsq(waves, rest[rows])[0]
    return replace(item, rest=rest)
