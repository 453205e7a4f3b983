"""A credible interval as the result contract writes it."""

from __future__ import annotations

from typing import Literal, NotRequired, TypedDict

import numpy as np

from bayesbl.probabilities import ends
from bayesbl.recording.types import FloatArray

IntervalKind = Literal["equal_tailed", "hdi"]


class Interval(TypedDict):
    """Median, bounds and the probability between them; a rate also has its unit."""

    median: float
    low: float
    high: float
    level: float
    kind: IntervalKind
    unit: NotRequired[str]


def interval(draws: FloatArray, level: float, kind: IntervalKind) -> Interval:
    """Median and credible interval of draws, any shape.

    ``equal_tailed`` leaves (1 − level)/2 on either side; ``hdi`` is the narrowest interval that
    holds ``level``.
    """
    flat = np.sort(np.asarray(draws, dtype=float).ravel())
    if kind == "hdi":
        count = max(1, round(level * flat.size))
        widths = flat[count - 1 :] - flat[: flat.size - count + 1]
        first = int(np.argmin(widths))
        low, high = flat[first], flat[first + count - 1]
    else:
        low, high = ends(flat, level)
    return {
        "median": float(np.median(flat)),
        "low": float(low),
        "high": float(high),
        "level": level,
        "kind": kind,
    }
