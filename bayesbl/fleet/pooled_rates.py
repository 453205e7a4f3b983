"""Wear pooled over joints that wear alike: those with few recordings borrow from the others.

The rate of a joint of type g is log-normal, and its law of wear one of the kinds that the type has,

    ln r_j ~ N(μ_g, τ_g²),  flat priors on μ and τ        k_j ~ π_g,  π_g ~ Dirichlet(p)

where p are the prior probabilities of the kinds: all that is believed of laws beforehand counts as
one joint. A joint enters by draws of its own posterior, as they are, with the rate r_js and the
kind k_js of each. Their prior is flat in the growth and p in the kind, so a draw is worth

    LN(r_js; μ, τ) · π(k_js) / p(k_js)

to its type (importance weights, Hogg, Myers and Bovy 2010). Gibbs sampling takes turns: for each
joint one of its draws by these weights, then μ, τ and π given those. At the end a joint's draws are
weighed by what is found of the type, and whatever is paired with them (the time to the limit) is
weighed with them. With two dates a forecast is as wide as what is believed of laws, and it is the
kinds that sharpen it.

A joint that does not wear has a small rate here, not none: the rates of a type are not evidence of
wear, as those of a joint are not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesbl.measurement.wear_laws import KINDS
from bayesbl.recording.types import FloatArray

FEWEST_JOINTS = 3
"""Of a type: two rates say nothing of a spread that is not mostly its prior."""

SPREAD = (0.03, 3.0)
"""Range of τ: from joints that wear alike within 3 % to those that differ twentyfold. Its prior is
flat (Gelman 2006): flat in ln τ, few joints are taken for more alike than they are."""

BURN_IN, SWEEPS = 200, 800
HYPER_DRAWS = 200
"""Of the type, that joints are weighed by: every fourth sweep."""

DRAWS_A_SWEEP = 400
"""Of each joint, that a sweep chooses from; all are weighed at the end."""

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
    law
        Share of its joints by law, the mean of what is left open.
    """

    joints: int
    median_rad_per_year: FloatArray
    spread: FloatArray
    law: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Pooled:
    """The type, and for each of its joints the draws to take in place of its own.

    ``chosen``: numbers of draws, with repetition, shape (draw,); ``None`` where the joint stays
    alone, as too few of its draws are near what its type says.
    """

    rates: TypeRates
    chosen: tuple[NDArray[np.int_] | None, ...]


def pooled(
    rates: Sequence[FloatArray], kinds: Sequence[NDArray[np.int_]], generator: np.random.Generator
) -> Pooled | None:
    """Pool the joints of one type; ``None`` where they are too few.

    Parameters
    ----------
    rates
        Draws of each joint, rad/year, positive, shape (draw,) each.
    kinds
        Number of the kind of law of each of these draws, of
        :data:`bayesbl.measurement.wear_laws.KINDS`.
    """
    if len(rates) < FEWEST_JOINTS:
        return None
    prior = np.array([kind.probability for kind in KINDS])
    count = min(*map(len, rates), DRAWS_A_SWEEP)
    few = [np.linspace(0, len(draws) - 1, count).astype(int) for draws in rates]
    log_rate = np.array([_log(draws[at]) for draws, at in zip(rates, few, strict=True)])
    kind = np.array([of[at] for of, at in zip(kinds, few, strict=True)])
    centre, spread, share = float(np.median(log_rate)), 0.5, prior
    centres, spreads, shares = [], [], []
    for _ in range(BURN_IN + SWEEPS):
        total = np.cumsum(_worth(log_rate, kind, centre, spread, share / prior), axis=1)
        level = generator.uniform(size=len(rates)) * total[:, -1]
        at = np.minimum((total < level[:, None]).sum(axis=1), count - 1)[:, None]
        rate_of = np.take_along_axis(log_rate, at, 1).ravel()
        kind_of = np.take_along_axis(kind, at, 1).ravel()
        centre = float(generator.normal(rate_of.mean(), spread / np.sqrt(len(rates))))
        spread = _spread(rate_of - centre, generator)
        share = generator.dirichlet(prior + np.bincount(kind_of, minlength=prior.size))
        centres.append(centre)
        spreads.append(spread)
        shares.append(share)
    kept = slice(BURN_IN, None, SWEEPS // HYPER_DRAWS)
    hyper = np.array(centres)[kept], np.array(spreads)[kept], np.array(shares)[kept]
    chosen = tuple(
        _reweighed(_log(draws), of, *hyper, prior, generator)
        for draws, of in zip(rates, kinds, strict=True)
    )
    law: dict[str, float] = {}
    for each, mean in zip(KINDS, np.array(shares)[BURN_IN:].mean(axis=0), strict=True):
        law[each.law] = law.get(each.law, 0.0) + float(mean)
    return Pooled(TypeRates(len(rates), np.exp(hyper[0]), hyper[1], law), chosen)


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


def _log(rate: FloatArray) -> FloatArray:
    return np.log(np.maximum(rate, 1e-12))


def _worth(
    log_rate: FloatArray,
    kind: NDArray[np.int_],
    centre: float,
    spread: float,
    of_kind: FloatArray,
) -> FloatArray:
    """What each draw is worth to its type, (…, draw), up to a factor for each joint."""
    exponent = -0.5 * ((log_rate - centre) / spread) ** 2 - log_rate
    exponent -= exponent.max(axis=-1, keepdims=True)
    # A kind that no joint has is worth little, never nothing.
    return np.asarray(np.exp(exponent) * np.maximum(of_kind, 1e-9)[kind])


def _spread(apart: FloatArray, generator: np.random.Generator) -> float:
    """τ given ln r_j − μ: with its flat prior τ² is inverse gamma, within :data:`SPREAD`."""
    square = 0.5 * float(apart @ apart)
    drawn = (square / generator.gamma(0.5 * (apart.size - 1), size=64)) ** 0.5
    inside = drawn[(drawn > SPREAD[0]) & (drawn < SPREAD[1])]
    return float(inside[0] if inside.size else np.clip(drawn[0], *SPREAD))


def _reweighed(
    log_rate: FloatArray,
    kind: NDArray[np.int_],
    centres: FloatArray,
    spreads: FloatArray,
    shares: FloatArray,
    prior: FloatArray,
    generator: np.random.Generator,
) -> NDArray[np.int_] | None:
    weight = np.zeros(log_rate.size)
    for centre, spread, share in zip(centres, spreads, shares, strict=True):
        worth = _worth(log_rate, kind, float(centre), float(spread), share / prior)
        weight += worth / worth.sum()
    if weight.sum() ** 2 / np.sum(weight**2) < FEWEST_EFFECTIVE:
        return None
    return generator.choice(log_rate.size, log_rate.size, p=weight / weight.sum())
