"""Which order of the motor's turning stands out of what is left, against the noise around it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from bayesbl.discrepancy.comparison import Fit
from bayesbl.discrepancy.report import Remaining
from bayesbl.discrepancy.residual_noise import ResidualNoise
from bayesbl.physics.effects import EFFECT_BY_NAME
from bayesbl.recording.types import FloatArray

if TYPE_CHECKING:
    from bayesbl.discrepancy.inverse import InverseComparison

FEWEST_CYCLES = 3.0
MOST_REMAINING = 5
_STEPS_PER_CYCLE = 5.0
_MOST_ORDERS = 40_000
_NOISE_KNOTS = 40


def order_scores(comparison: InverseComparison, fit: Fit) -> tuple[FloatArray, FloatArray, float]:
    """Score of sin and cos of every order: χ² with two degrees of freedom if nothing is there.

    |Σ r exp(i n θ)|² over what coloured noise makes of it, ½ XᵀΣX of sine and cosine together;
    summed before the square where all recordings share one phase, after it where not.

    Returns
    -------
    Orders and scores, shape (m,), and the number of orders that are independent of one another.
    """
    used = [i for i, piece in enumerate(comparison.pieces) if piece.use == "used"]
    angles = [comparison.motions[i].angle for i in used]
    rests = [comparison.pieces[i].measured - fit.predictions[i] for i in used]
    ends = [(a.min(), a.max()) for a in angles]
    turns = max(high - low for low, high in ends) / (2.0 * math.pi)
    if comparison.phases_shared:
        turns = (max(e[1] for e in ends) - min(e[0] for e in ends)) / (2.0 * math.pi)
    low, high = _range(comparison)
    low = max(low, FEWEST_CYCLES / turns) if turns > 0.0 else high
    count = int(min(_MOST_ORDERS, (high - low) * turns * _STEPS_PER_CYCLE)) + 1
    if low >= high or count < 2:
        return np.array([]), np.array([]), 1.0
    orders = np.linspace(low, high, count)
    knots = np.linspace(low, high, _NOISE_KNOTS)
    scores = np.zeros(count)
    total = np.zeros(count, dtype=complex)
    spread = np.zeros(count)
    for angle, rest in zip(angles, rests, strict=True):
        found = _transform(angle, rest, orders)
        noise = ResidualNoise.of(rest)
        waves = np.exp(1j * np.outer(angle, knots))
        coloured = noise.covariance_times(waves.real), noise.covariance_times(waves.imag)
        power = 0.5 * ((waves.real * coloured[0]) + (waves.imag * coloured[1])).sum(axis=0)
        here = np.exp(np.interp(orders, knots, np.log(power)))
        total += found
        spread += here
        scores += np.abs(found) ** 2 / here
    independent = max(1.0, (high - low) * turns)
    return orders, np.abs(total) ** 2 / spread if comparison.phases_shared else scores, independent


def best_order(comparison: InverseComparison, fit: Fit) -> tuple[float, float, float]:
    """The order of the highest score, the scan's step, and the number of independent trials."""
    orders, scores, trials = order_scores(comparison, fit)
    if not orders.size:
        return 1.0, 0.1, 1.0
    return float(orders[np.argmax(scores)]), float(orders[1] - orders[0]), trials


def _range(comparison: InverseComparison) -> tuple[float, float]:
    name = "gear_transmission_error" if comparison.load else "motor_torque_ripple"
    order = next(p for p in EFFECT_BY_NAME[name].parameters if p.name == "order")
    return order.low, order.high


def _transform(angle: FloatArray, rest: FloatArray, orders: FloatArray) -> np.ndarray:
    """Σ r exp(i n θ) for evenly spaced orders, by turning one wave on from order to order."""
    wave = rest * np.exp(1j * orders[0] * angle)
    turn = np.exp(1j * (orders[1] - orders[0]) * angle)
    out = np.empty(orders.size, dtype=complex)
    for k in range(orders.size):
        out[k] = wave.sum()
        wave *= turn
    return out


def remaining_orders(
    comparison: InverseComparison, fit: Fit, false_alarm: float
) -> tuple[Remaining, ...]:
    """Orders of the motor's turning that stand out of what is left, strongest first.

    Neighbours within one resolved cycle belong to the stronger line; at most
    :data:`MOST_REMAINING` are told.
    """
    orders, scores, trials = order_scores(comparison, fit)
    if not orders.size:
        return ()
    used = [i for i, piece in enumerate(comparison.pieces) if piece.use == "used"]
    freedom = 2 if comparison.phases_shared else 2 * len(used)
    threshold = float(chi2.isf(false_alarm / trials, freedom))
    width = 2.0 * _STEPS_PER_CYCLE * (orders[1] - orders[0])
    left, found = scores.copy(), list[Remaining]()
    while len(found) < MOST_REMAINING and left.max() > threshold:
        best = int(np.argmax(left))
        order = float(orders[best])
        size = sum(
            abs(
                _transform(
                    comparison.motions[i].angle, _rest(comparison, fit, i), orders[[best] * 2]
                )[0]
            )
            for i in used
        )
        count = sum(comparison.pieces[i].measured.size for i in used)
        channel = comparison.pieces[used[0]].channel
        found.append(Remaining(channel, order, float(2.0 * size / count), float(left[best])))
        left[np.abs(orders - order) <= width] = 0.0
    return tuple(found)


def _rest(comparison: InverseComparison, fit: Fit, i: int) -> FloatArray:
    return comparison.pieces[i].measured - fit.predictions[i]
