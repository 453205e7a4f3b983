"""Tails of common distributions, and their inverses.

Values must not be negative, probabilities between 0 and 1. The import of ``scipy.stats``, which has
them too, takes a quarter of a second.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

FALSE_ALARM = 0.01
"""Probability of a false alarm, over all that one check compares: a recording, a bench or a joint
is called inconsistent although it is not."""

LINE_FALSE_ALARM = 1e-5
"""The same for removing a line or a drift from a recording: a false one would cost signal."""

TOO_FEW = 0.01
"""Share of draws or simulations that is too small to decide anything."""


def ends(draws: np.ndarray, level: float, axis: int | tuple[int, ...] | None = None) -> np.ndarray:
    """Ends of the interval that leaves (1 − level)/2 of the draws on either side, (2, …)."""
    return np.asarray(np.quantile(draws, (0.5 - 0.5 * level, 0.5 + 0.5 * level), axis=axis))


def normal_sf(z: float) -> float:
    """P(Z > z), Z standard normal."""
    return float(special.ndtr(-z))


def normal_isf(probability: float) -> float:
    """The z with P(Z > z) equal to this probability."""
    return float(-special.ndtri(probability))


def chi2_sf(value: ArrayLike, freedom: ArrayLike) -> np.ndarray:
    """P(χ² > value) with these degrees of freedom."""
    return np.asarray(special.chdtrc(freedom, value))


def chi2_isf(probability: ArrayLike, freedom: ArrayLike) -> np.ndarray:
    """The value with P(χ² > value) equal to this probability."""
    return np.asarray(special.chdtri(freedom, probability))


def f_sf(value: float, above: float, below: float) -> float:
    """P(F > value) with these degrees of freedom of numerator and denominator."""
    return float(special.fdtrc(above, below, value))
