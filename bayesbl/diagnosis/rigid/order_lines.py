"""Lines at orders of the motor's turning in recordings of one speed each."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import minimize_scalar
from scipy.special import gammaln, logsumexp
from scipy.stats import chi2

from bayesbl.bench.effect_declaration import HIGHEST_ORDER, LOWEST_ORDER
from bayesbl.diagnosis.comparison import Piece
from bayesbl.diagnosis.rigid.order_scan import FEWEST_CYCLES
from bayesbl.diagnosis.rigid.view import WIDEST
from bayesbl.recording.types import ComplexArray, FloatArray
from bayesbl.units import RPM_PER_RAD_PER_S

FINER = 4
"""Steps of a spectrum in one resolved order."""

LEVEL_ORDERS = 40
"""Resolved orders over which the noise around a line is taken, by its median."""

RESOLVED_CYCLES = 2.0
"""By which an order must differ from a stronger one in a piece that is to show it."""

WHOLE = 4.0
"""Standard deviations within which an order is a whole one."""


@dataclass(frozen=True, slots=True)
class Turning:
    """The motor's speed over its angle.

    Attributes
    ----------
    angle
        Of the motor, rad, shape (n,).
    response
        What the loop makes of a torque at a frequency in rad/s.
    load_order
        Of the load's turning, where gravity acts on it: what it does to the speed is fitted apart.
    """

    piece: Piece
    angle: FloatArray
    response: Callable[[FloatArray], ComplexArray]
    load_order: float | None = None
    made: dict[float, FloatArray] = field(default_factory=dict, repr=False, compare=False)

    @property
    def speed_rad_per_s(self) -> float:
        """Mean, with its sign."""
        time = self.piece.time_s
        return float(self.angle[-1] - self.angle[0]) / float(time[-1] - time[0])

    @property
    def turns(self) -> float:
        """Of the motor."""
        return abs(float(self.angle[-1] - self.angle[0])) / (2.0 * math.pi)

    @property
    def turns_per_s(self) -> float:
        """Of the motor."""
        return abs(self.speed_rad_per_s) / (2.0 * math.pi)

    @property
    def highest_order(self) -> float:
        """That the sampling shows."""
        return min(HIGHEST_ORDER, WIDEST / self.piece.period_s / self.turns_per_s)

    def shows(self, order: float) -> bool:
        """Whether an order turns often enough, and not too fast for the sampling."""
        return order < self.highest_order and order * self.turns >= FEWEST_CYCLES

    def waves(self, orders: Sequence[float]) -> FloatArray:
        """Cosine and sine of each order that shows, then what is fitted apart, (k, p)."""
        slow = [] if self.load_order is None else [self.load_order]
        waves = [self._answer(o) for o in (*(o for o in orders if self.shows(o)), *slow)]
        return self.piece.kept(np.column_stack([*waves, np.ones(self.angle.size)]))

    def _answer(self, order: float) -> FloatArray:
        """The loop's answer to cos n θ and sin n θ, 1 at the mean speed, shape (n, 2).

        A torque that makes the speed sway makes its own angle sway too: at low speeds the answer
        has harmonics, which would otherwise be taken for other torques.
        """
        if order not in self.made:
            lead = self.angle.size // 2  # in which the loop forgets how it began
            step = self.speed_rad_per_s * self.piece.period_s
            before = self.angle[0] - step * np.arange(lead, 0, -1)
            torque = np.exp(1j * order * np.concatenate((before, self.angle)))
            turning = np.fft.fftfreq(torque.size, self.piece.period_s)
            frequency: FloatArray = np.asarray(2.0 * math.pi * turning, dtype=float)
            frequency[0] = frequency[1]
            answer = self.response(frequency)
            answer[0] = 0.0  # the mean is fitted apart
            mean: FloatArray = np.array([order * self.speed_rad_per_s])
            one = abs(complex(self.response(mean)[0]))
            both = np.fft.fft(np.stack([torque.real, torque.imag]), axis=1) * answer / one
            self.made[order] = np.fft.ifft(both, axis=1).real[:, lead:].T
        return self.made[order]

    def fit(self, orders: Sequence[float]) -> tuple[ComplexArray, FloatArray]:
        """Line c of each order, Re c exp(i n θ), and what all of them leave; NaN where none shows.

        Shapes (m,) and (k,).
        """
        matrix, measured = self.waves(orders), self.piece.kept(self.piece.measured)
        found = np.linalg.lstsq(matrix, measured, rcond=1e-10)[0]
        lines = np.full(len(orders), complex(math.nan, math.nan))
        shown = np.array([self.shows(order) for order in orders], bool)
        pairs = found[: 2 * int(shown.sum())]
        lines[shown] = pairs[0::2] - 1j * pairs[1::2]
        return lines, measured - matrix @ found

    def predicted(self, orders: Sequence[float], sizes: FloatArray) -> FloatArray:
        """The speed with lines of these sizes, rpm, shape (n,); phases and the rest as they fit."""
        shown = [order for order in orders if self.shows(order)]
        found = np.linalg.lstsq(
            self.waves(shown), self.piece.kept(self.piece.measured), rcond=1e-10
        )[0]
        for k, order in enumerate(shown):
            pair = found[2 * k : 2 * k + 2]
            pair *= sizes[list(orders).index(order)] / max(float(np.hypot(*pair)), 1e-300)
        whole = replace(self, piece=replace(self.piece, excluded=None))
        return whole.waves(shown) @ found

    def spectrum(self, left: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Orders, |Σ x exp(−i n θ)|², and what noise makes of it around; evenly over the angle."""
        way = np.maximum.accumulate(np.abs(self.piece.kept(self.angle) - self.angle[0]))
        grid = np.linspace(way[0], way[-1], left.size)
        power = np.abs(np.fft.rfft(np.interp(grid, way, left), FINER * left.size)) ** 2
        orders = np.arange(power.size) / (FINER * self.turns)
        size = min(FINER * LEVEL_ORDERS, power.size)
        level = median_filter(power, size) / (chi2.median(2) / 2.0)
        return orders, power, np.asarray(level)


@dataclass(frozen=True, slots=True)
class OrderLine:
    """An order that stands out.

    Attributes
    ----------
    sd
        Of the order.
    score, trials
        χ² over the recordings that show it, and how many orders were looked at.
    """

    order: float
    sd: float
    score: float
    trials: float


def find_orders(turning: Sequence[Turning], most: int, false_alarm: float) -> list[OrderLine]:
    """Orders that stand out of the noise of all pieces together, strongest first.

    The rate of false alarms is that of the whole list: half of what is left goes to each order.
    """
    found: list[OrderLine] = []
    top = max(item.highest_order for item in turning)
    turns = max(item.turns for item in turning)
    grid = np.arange(LOWEST_ORDER, top, 1.0 / (FINER * turns))
    trials = max(1.0, (top - LOWEST_ORDER) * turns)
    while len(found) < most and grid.size:
        score, pieces = np.zeros(grid.size), np.zeros(grid.size)
        levels = []
        for item in turning:
            _, left = item.fit([line.order for line in found])
            orders, power, level = item.spectrum(left)
            seen = (grid < item.highest_order) & (grid * item.turns >= FEWEST_CYCLES)
            for line in found:  # what a piece does not resolve belongs to the stronger line
                seen &= np.abs(grid - line.order) * item.turns >= RESOLVED_CYCLES
            score += np.where(seen, np.interp(grid, orders, 2.0 * power / level), 0.0)
            pieces += seen
            levels.append((item, left, orders, level))
        rarity = _log_rarity(score, pieces)
        k = int(np.argmin(rarity))
        rise = trials * math.sqrt(max(1.0, 0.5 * float(score[k])))  # Baluev 2008
        if rarity[k] + math.log(rise) > math.log(false_alarm * 0.5 ** (len(found) + 1)):
            break
        order, sd = _refined(float(grid[k]), 1.0 / turns, levels)
        found.append(OrderLine(order, sd, float(score[k]), rise))
    return found


def _log_rarity(score: FloatArray, pieces: FloatArray) -> FloatArray:
    """Logarithm of the probability of a larger χ² with 2 degrees of freedom for each piece.

    exp(−x/2) Σ_{j<m} (x/2)ʲ/j!, in logarithms: scores of a thousand are usual.
    """
    j = np.arange(max(1, int(pieces.max())))[:, None]
    half = np.maximum(0.5 * score, 1e-12)
    terms = np.where(j < np.maximum(pieces, 1), j * np.log(half) - gammaln(j + 1.0), -np.inf)
    return np.asarray(logsumexp(terms, axis=0) - half)


def _refined(
    order: float,
    width: float,
    levels: Sequence[tuple[Turning, FloatArray, FloatArray, FloatArray]],
) -> tuple[float, float]:
    """The order of the highest score nearby, and its standard deviation by the curvature.

    A whole order within the errors is the whole one, unless every order is near one.
    """
    parts = [
        (item.piece.kept(item.angle), left, float(np.interp(order, orders, level)))
        for item, left, orders, level in levels
        if item.shows(order)
    ]

    def misfit(value: float) -> float:
        return -sum(float(abs(np.vdot(np.exp(1j * value * a), x))) ** 2 / v for a, x, v in parts)

    best = float(
        minimize_scalar(
            misfit,
            bounds=(order - width, order + width),
            method="bounded",
            options={"xatol": 1e-4 * width},
        ).x
    )
    step = 0.1 * width
    bend = (misfit(best + step) - 2.0 * misfit(best) + misfit(best - step)) / step**2
    # The logarithm of the likelihood is the score over the level: its second derivative.
    sd = 1.0 / math.sqrt(bend) if bend > 0.0 else width
    whole = round(best)
    # By the likelihood itself: of a weak line it has several peaks, and a bend of each.
    near = 2.0 * (misfit(float(whole)) - misfit(best)) < WHOLE**2
    return (float(whole) if near and whole > 0 and WHOLE * sd < 0.5 else best), sd


def noise_sd(item: Turning, orders: Sequence[float], left: FloatArray) -> FloatArray:
    """Standard deviation of the real part of the line at each order, shape (m,)."""
    grid, _, level = item.spectrum(left)
    return np.asarray(np.sqrt(2.0 * np.interp(orders, grid, level)) / left.size)


def turned(piece: Piece) -> FloatArray:
    """The motor's angle by its speed, from 0, shape (n,)."""
    speed = piece.measured / RPM_PER_RAD_PER_S
    steps = 0.5 * (speed[1:] + speed[:-1]) * piece.period_s
    return np.concatenate(([0.0], np.cumsum(steps)))
