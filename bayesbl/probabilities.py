"""Tails of the usual distributions and their inverses.

For values that are not negative and probabilities between 0 and 1. ``scipy.stats`` has them too;
its import takes a quarter of a second of every command.
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


def normal_sf(z: float) -> float:
    """P(Z > z), Z standard normal."""
    return float(special.ndtr(-z))


def normal_isf(probability: float) -> float:
    """The z that Z exceeds with this probability."""
    return float(-special.ndtri(probability))


def chi2_sf(value: ArrayLike, freedom: ArrayLike) -> np.ndarray:
    """P(χ² > value) at so many degrees of freedom."""
    return np.asarray(special.chdtrc(freedom, value))


def chi2_isf(probability: ArrayLike, freedom: ArrayLike) -> np.ndarray:
    """The value that χ² exceeds with this probability."""
    return np.asarray(special.chdtri(freedom, probability))


def f_sf(value: float, above: float, below: float) -> float:
    """P(F > value) at degrees of freedom above and below the line."""
    return float(special.fdtrc(above, below, value))
