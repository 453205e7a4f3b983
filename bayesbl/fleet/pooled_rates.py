"""Rates of wear pooled over joints that wear alike: those with few recordings borrow from others.

The rate of a joint of type g is log-normal,

    ln r_j ~ N(μ_g, τ_g²),    flat priors on μ and τ

Each joint enters by draws of its own posterior, as they are. Their prior is flat in the growth, so
with draws r_js the likelihood of (μ, τ) is Π_j mean_s LN(r_js; μ, τ) (Hogg, Myers and Bovy 2010),
computed on a grid. A joint's draws are then weighed by the same densities, averaged over (μ, τ),
and whatever is paired with them (the time to the limit) is weighed with them.

A joint that does not wear has a small rate here, not none: the rates of a type are not evidence of
wear, as those of a joint are not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesbl.recording.types import FloatArray

FEWEST_JOINTS = 3
"""Of a type: two rates say nothing of a spread that is not mostly its prior."""

SPREAD = (0.03, 3.0)
"""Range of τ: from joints that wear alike within 3 % to those that differ twentyfold. Its prior is
flat (Gelman 2006): flat in ln τ, few joints are taken for more alike than they are."""

GRID = (28, 20)
"""Points of μ and τ."""

QUANTILES = (100, 100, 400)
"""Of each joint's draws, that the likelihood is averaged over: twice to find where it lies, in a
grid that closes in on it, and once for the answer. Quantiles scatter far less than draws do."""

_FAR = 12.0
"""Log likelihood below the largest beyond which nothing is left: 6e-6 of its density."""

HYPER_DRAWS = 200

FEWEST_EFFECTIVE = 100.0
"""Effective draws below which a joint stays alone: the level of its 90 % interval would be known to
3 %, √(p (1 − p)/n)."""


@dataclass(frozen=True, slots=True)
class TypeRates:
    """What the joints of one type say of it.

    Attributes
    ----------
    median_rad_per_year, spread
        Draws of exp μ and of τ, shape (draw,).
    """

    joints: int
    median_rad_per_year: FloatArray
    spread: FloatArray


@dataclass(frozen=True, slots=True)
class Pooled:
    """The type, and for each of its joints the draws to take in place of its own.

    ``chosen``: numbers of draws, with repetition, shape (draw,); ``None`` where the joint stays
    alone, as too few of its draws are near what its type says.
    """

    rates: TypeRates
    chosen: tuple[NDArray[np.int_] | None, ...]


def pooled(rates: Sequence[FloatArray], generator: np.random.Generator) -> Pooled | None:
    """Pool the draws of the rates of the joints of one type; ``None`` where they are too few.

    Parameters
    ----------
    rates
        Draws of each joint, rad/year, positive, shape (draw,) each.
    """
    if len(rates) < FEWEST_JOINTS:
        return None
    logs = [np.log(np.maximum(draws, 1e-12)) for draws in rates]
    middle = [float(np.median(draws)) for draws in logs]
    room = 2.0 * max(float(np.std(draws)) for draws in logs)
    centres = np.linspace(min(middle) - room, max(middle) + room, GRID[0])
    spreads = np.geomspace(*SPREAD, GRID[1])
    share = np.ones(GRID)
    for count in QUANTILES:
        centres, spreads = (
            _closer(centres, share, np.linspace),
            _closer(spreads, share.T, np.geomspace),
        )
        levels = (np.arange(count) + 0.5) / count
        likely = np.tile(np.log(spreads), (GRID[0], 1))  # flat in τ on a grid of ln τ
        for draws in logs:
            likely += _log_mean_density(np.quantile(draws, levels), centres, spreads)
        share = np.exp(likely - likely.max())
    place = generator.choice(share.size, HYPER_DRAWS, p=share.ravel() / share.sum())
    # Within a cell of the grid any point is as likely.
    step = np.array([centres[1] - centres[0], np.log(spreads[1] / spreads[0])])
    shift = generator.uniform(-0.5, 0.5, (2, HYPER_DRAWS)) * step[:, None]
    centre = centres[place // GRID[1]] + shift[0]
    spread = spreads[place % GRID[1]] * np.exp(shift[1])
    chosen = tuple(_reweighed(draws, centre, spread, generator) for draws in logs)
    return Pooled(TypeRates(len(rates), np.exp(centre), spread), chosen)


def alarms(probability: Sequence[float | None], rate: float = 0.05) -> list[bool]:
    """Which joints to call over their limit so that of those called at most ``rate`` are not.

    The largest set whose mean probability of a false call stays below the rate (Müller, Parmigiani
    and Rice 2007); a joint without a probability is not called.
    """
    false = np.array([1.0 if p is None else 1.0 - p for p in probability])
    order = np.argsort(false, kind="stable")
    mean = np.cumsum(false[order]) / np.arange(1, false.size + 1)
    count = int(np.flatnonzero(mean <= rate)[-1]) + 1 if np.any(mean <= rate) else 0
    called = np.zeros(false.size, dtype=bool)
    called[order[:count]] = True
    return [bool(one) and false[n] < 0.5 for n, one in enumerate(called)]


def _closer(axis: FloatArray, share: FloatArray, spaced: Callable[..., FloatArray]) -> FloatArray:
    """The part of a grid's axis, the first of ``share``, in which anything is left."""
    left = np.flatnonzero(share.max(axis=1) > np.exp(-_FAR))
    low, high = max(left[0] - 1, 0), min(left[-1] + 1, axis.size - 1)
    return spaced(axis[low], axis[high], axis.size)


def _log_mean_density(log_rate: FloatArray, centres: FloatArray, spreads: FloatArray) -> FloatArray:
    """ln of the mean of LN(r; μ, τ) over draws, shape (μ, τ)."""
    z = (log_rate[:, None, None] - centres[:, None]) / spreads
    exponent = -0.5 * z**2 - log_rate[:, None, None]
    most = exponent.max(axis=0)
    return np.asarray(most + np.log(np.exp(exponent - most).mean(axis=0)) - np.log(spreads))


def _reweighed(
    log_rate: FloatArray,
    centre: FloatArray,
    spread: FloatArray,
    generator: np.random.Generator,
) -> NDArray[np.int_] | None:
    exponent = -0.5 * ((log_rate[:, None] - centre) / spread) ** 2 - log_rate[:, None]
    each = np.exp(exponent - exponent.max(axis=0))
    weight = (each / each.sum(axis=0)).mean(axis=1)
    if weight.sum() ** 2 / np.sum(weight**2) < FEWEST_EFFECTIVE:
        return None
    return generator.choice(log_rate.size, log_rate.size, p=weight / weight.sum())
