"""How ensembles are run until their chains are long enough, and what is kept of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayesbl.recording.types import FloatArray

STEPS_BETWEEN_CHECKS = 250
BURN_IN_AUTOCORRELATIONS = 5.0
DRAWS_KEPT = 1000
BOUND_TOLERANCE_SD = 0.05
"""Interval bounds count as stable when they move less than this many standard deviations."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class SamplerSettings:
    """How the posterior is sampled; never part of what A means.

    Attributes
    ----------
    ensembles
        Independent emcee ensembles; these are the chains.
    max_steps
        Upper limit of steps per ensemble; the sampler stops by itself when converged.
    level
        Interval level whose bounds must be stable.
    """

    ensembles: int = 4
    max_steps: int = 20000
    level: float = 0.9


def burn_in(tau: float, steps: int) -> int:
    """Steps left out at the start: five autocorrelation times, at most half of all."""
    half = steps // 2
    return half if not math.isfinite(tau) else min(half, math.ceil(BURN_IN_AUTOCORRELATIONS * tau))


def thinned(chain: FloatArray, count: int = DRAWS_KEPT) -> FloatArray:
    """``count`` evenly spaced draws of a chain (step, walker, d), shape (draw, d)."""
    flat = chain.reshape(-1, chain.shape[-1])
    return np.asarray(flat[np.linspace(0, len(flat) - 1, count).round().astype(int)])
