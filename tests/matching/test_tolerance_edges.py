"""A parameter pushed against its tolerance withholds a gap that follows it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bayesbl.matching.posterior import DirectPosterior
from bayesbl.matching.signals import Unknown, gap_unknown
from bayesbl.recording.types import FloatArray

SHAPE = (4, 250)
HALF = Unknown("motor_inertia_kg_m2", 0.9, 1.1)


def posterior(
    parameter: FloatArray, slope: float, rng: np.random.Generator, unknown: Unknown = HALF
) -> DirectPosterior:
    """Draws of a gap that follows the parameter, within 1 % of it."""
    gap = gap_unknown(1e-4, 4e-3)
    model: Any = SimpleNamespace(unknowns=[gap, unknown], index=lambda name, recording: 0)
    fit: Any = SimpleNamespace(model=model)
    values = np.log(1e-3) + slope * (parameter - 1.0) + rng.normal(0.0, 0.01, SHAPE)
    draws = np.stack([values, parameter], axis=-1)
    nothing: Any = None
    as_it_is = np.ones(draws.shape[-1])
    return DirectPosterior(fit, draws, np.zeros(SHAPE), np.nan, 0, 0, nothing, as_it_is, as_it_is)


@pytest.mark.parametrize(
    ("shape", "slope", "withheld"),
    [
        ("flat", 3.0, False),
        ("inside", 3.0, False),
        ("peak at the edge", 3.0, False),
        ("pressed", 0.0, False),
        ("pressed", 3.0, True),
    ],
)
def test_a_gap_is_withheld_where_a_tolerance_decides_it(
    shape: str, slope: float, withheld: bool
) -> None:
    rng = np.random.default_rng(1)
    parameter = {
        "flat": rng.uniform(HALF.low, HALF.high, SHAPE),
        "inside": rng.normal(1.0, 0.02, SHAPE),
        "peak at the edge": HALF.high - np.abs(rng.normal(0.0, 0.02, SHAPE)),
        "pressed": HALF.high - rng.exponential(0.02, SHAPE),
    }[shape]
    why = posterior(parameter, slope, rng).beyond_tolerance("one", 0.9)
    assert (why is not None) is withheld
    assert why is None or "upper edge" in why


@pytest.mark.parametrize(("low_s", "withheld"), [(2e-4, False), (4e-3, True)])
def test_below_a_range_is_no_more_than_zero(low_s: float, withheld: bool) -> None:
    """A lag at the lower edge of 0.2 to 10 ms can be shorter by 0.2 ms, and no more."""
    rng = np.random.default_rng(1)
    lag = Unknown("current_loop_lag__time_s", low_s, 1e-2)
    found = posterior(low_s + rng.exponential(3e-5, SHAPE), 10.0, rng, lag)
    assert (found.beyond_tolerance("one", 0.9) is not None) is withheld
