"""A smooth torque that nothing explains, as a Fourier series: its columns, and how it is told."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from bayesbl.bench.learned import LearnedTorque, Variable
from bayesbl.diagnosis.diagnosis import CURVE_POINTS, LearnedAnswer, LearnedCurve
from bayesbl.diagnosis.inference import Coefficients, Inference
from bayesbl.recording.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A torque over a variable, its amplitudes falling as 1/k.

    Attributes
    ----------
    means
        Of the cosines and sines over what was recorded, which are taken off, (2 orders,): the mean
        is an effect's.
    reach
        Of the variable, as recorded.
    """

    variable: Variable
    period: float
    reverses: bool
    orders: int
    means: FloatArray
    reach: tuple[float, float]

    @classmethod
    def over(
        cls,
        variable: Variable,
        period: float,
        *,
        reverses: bool,
        orders: int,
        reach: tuple[float, float],
    ) -> Series:
        """With the means over this reach of its variable."""
        made = cls(variable, period, reverses, orders, np.zeros(2 * orders), reach)
        x = np.linspace(reach[0], min(reach[1], reach[0] + period), 1000)
        return replace(made, means=made.waves(x).mean(axis=0))

    @property
    def kind(self) -> str:
        """What it is a torque over."""
        return f"motor_torque_over_{self.variable}{'_reversing' if self.reverses else ''}"

    def waves(self, x: FloatArray) -> FloatArray:
        """Cosines, then sines, less their means, (n, 2 orders)."""
        k = np.arange(1, self.orders + 1)
        phase = 2.0 * math.pi * x[:, None] * k / self.period
        return np.hstack([np.cos(phase) / k, np.sin(phase) / k]) - self.means

    def torque(self, coefficients: FloatArray, sds: FloatArray | None = None) -> LearnedTorque:
        """With coefficients of the waves, (2 orders,), and their standard deviations."""
        decay = np.tile(1.0 / np.arange(1, self.orders + 1), 2)
        waves = coefficients * decay
        sd: tuple[float, ...] = ()
        if sds is not None:
            constant = math.sqrt(float((sds * self.means) @ (sds * self.means)))
            sd = (constant, *(sds * decay).tolist())
        return LearnedTorque(
            "motor",
            self.variable,
            self.period,
            -float(coefficients @ self.means),
            tuple(waves[: self.orders].tolist()),
            tuple(waves[self.orders :].tolist()),
            self.reverses,
            sd,
        )


def learned_answer(
    series: Series, inference: Inference, fitted: Coefficients, group: int
) -> LearnedAnswer:
    """A group of the discrepancy as a torque over its variable."""
    draws = inference.discrepancy_draws[:, inference.groups[group]]
    value = fitted.discrepancy[group]
    term = series.torque(value, draws.std(axis=0))
    low, high = series.reach
    if high - low > term.period:
        low, high = -0.5 * term.period, 0.5 * term.period
    x = np.linspace(low, high, CURVE_POINTS)
    waves = series.waves(x)
    curve = LearnedCurve(x, waves @ value, (waves @ draws.T).std(axis=1))
    size = curve.value if term.reverses else curve.value - curve.value.mean()
    return LearnedAnswer(term, float(np.abs(size).max()), (), curve)
