"""Pool wear over joints of a type, so that joints with few recordings borrow from the others.

A share 1 − ε of the joints of a type g wears like the type. Their rates r are log-normal, their law
of wear is one of the kinds k of the type, and the mean jump s, which describes irregular wear, is
log-normal:

    ln r_j ~ N(μ + x_j·β, τ²)    k_j ~ π, π ~ Dirichlet(6 p)    ln s_j ~ N(m, t²)

The priors of μ, τ, m and t are nearly flat. p are the prior probabilities of the kinds, which count
as six joints. The covariates x of a joint, such as its load, are standardised over the joints of
the type, with β ~ N(0, 1): one standard deviation hardly changes the rate more than twentyfold. The
share ε wears in its own way and has the prior of a single joint: flat in the rate (half-Cauchy, so
that it is proper), p for the kind, flat in ln s. ε is uniform. So the data show how alike the
joints of a type are. A joint whose recordings contradict its type keeps its own answer, and one
with few recordings keeps as much of it as its type has strangers.

A joint enters by draws of its own posterior with the prior of a single joint. Each draw is weighted
by the ratio of priors (importance weights, Hogg, Myers and Bovy 2010). Gibbs sampling alternates:
for each joint one of its draws by these weights, and whether it is like its type; then the type
given the joints that are. Finally a joint's draws, with all that is paired with them (the time to
the limit), are weighted by the draws of the type. With two dates, a forecast is as wide as the
prior of laws and irregular wear, which the type sharpens.

A joint that does not wear has a small rate here, not none. So the rates of a type, like those of a
joint, are no evidence of wear.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesbl.measurement.wear import KINDS, SCATTER, WearDraws, by_law
from bayesbl.recording.types import FloatArray

FEWEST_JOINTS = 3  # fewest joints of a type: the spread of two rates is mostly its prior

BELIEF = 6.0
"""Number of joints that the prior of the laws counts as. With less, joints that show little of
their laws are soon assumed to share one."""

SPREAD = (0.03, 3.0)
"""Range of τ, from joints alike within 3 % to twentyfold differences. The prior is flat (Gelman
2006); flat in ln τ, few joints would seem too similar."""

JUMP_SPREAD = (2.0, 4.0)
"""Range of t: joints share the order of magnitude of their jumps, or, at 4, no more than the prior
of a single joint."""

FALSE_CALLS = 0.05  # expected share of false calls among the joints called over their limit
OWN_RATE = 3.0  # scale of the rates of joints that wear otherwise, relative to the median
BURN_IN, SWEEPS = 200, 800
HYPER_DRAWS = 100  # draws of the type by which joints are weighted: every eighth sweep
DRAWS_A_SWEEP = 400  # draws of each joint from which a sweep chooses; all are weighted at the end

FEWEST_EFFECTIVE = 100.0
"""Fewest effective draws; below, a joint stays alone, because the level of its 90 % interval would
be uncertain by 3 %, √(p (1 − p)/n)."""

_PRIOR = np.array([kind.probability for kind in KINDS])
_SLOPE = 1.0  # standard deviation of the normal prior of β
_FAR = 3.0  # standard deviation of the nearly flat priors of μ and m
_LOG_JUMPS = 2.0 * float(np.log(SCATTER[1] / SCATTER[0]))  # prior width of ln s of a single joint


@dataclass(frozen=True, slots=True)
class TypeRates:
    """What the joints of a type show about it.

    ``median_rad_per_year``, ``spread``: draws of exp μ and of τ, shape (draw,). ``law``: share of
    the joints by law (mean). ``own``: draws of ε, shape (draw,). ``factors``: effect of each
    covariate.
    """

    joints: int
    median_rad_per_year: FloatArray
    spread: FloatArray
    law: Mapping[str, float]
    own: FloatArray
    factors: Mapping[str, Factor]


@dataclass(frozen=True, slots=True)
class Factor:
    """Factor on the rate (``draws``, shape (draw,)) if a covariate rises by its standard deviation
    ``sd`` over the joints of the type, in its own unit."""

    sd: float
    draws: FloatArray


@dataclass(frozen=True, slots=True)
class Borrowed:
    """What its type adds to a joint.

    ``chosen``: numbers of draws that replace its own, with repetition, shape (draw,); ``None`` if
    too few of its draws are near the type. ``probability_own``: probability that it wears in its
    own way.
    """

    chosen: NDArray[np.int_] | None
    probability_own: float


@dataclass(frozen=True, slots=True)
class Pooled:
    """A type, and what it adds to each of its joints."""

    rates: TypeRates
    joints: tuple[Borrowed, ...]


def pooled(
    joints: Sequence[WearDraws],
    generator: np.random.Generator,
    covariates: Mapping[str, FloatArray] | None = None,
) -> Pooled | None:
    """Pool the joints of a type; ``None`` if there are too few.

    ``covariates`` have shape (joint,), in any unit; one that all joints share is left out.
    """
    if len(joints) < FEWEST_JOINTS:
        return None
    varied = {name: v for name, v in (covariates or {}).items() if v.std() > 0.0}
    x = np.array([(v - v.mean()) / v.std() for v in varied.values()])
    x = x.reshape(-1, len(joints)).T
    count = min(*(one.kind.size for one in joints), DRAWS_A_SWEEP)
    few = [_Log.of(one, np.linspace(0, one.kind.size - 1, count).astype(int)) for one in joints]
    together = _Log(
        np.array([one.rate for one in few]),
        np.array([one.kind for one in few]),
        np.array([one.jump for one in few]),
    )
    types = _sampled(together, x, generator)
    share = np.mean([one.share for one in types], axis=0)
    rates = TypeRates(
        len(joints),
        np.exp([one.centre for one in types]),
        np.array([one.spread for one in types]),
        by_law(share),
        np.array([one.own for one in types]),
        {
            name: Factor(float(values.std()), np.exp([one.slope[c] for one in types]))
            for c, (name, values) in enumerate(varied.items())
        },
    )
    return Pooled(
        rates,
        tuple(
            _borrowed(_Log.of(one), own, types, generator)
            for one, own in zip(joints, x, strict=True)
        ),
    )


def alarms(probability: Sequence[float | None]) -> list[bool]:
    """Which joints to call over their limit, with at most 5 % expected false calls.

    This is the largest set whose mean probability of a false call is below that (Müller, Parmigiani
    and Rice 2007). A joint without a probability is not called.
    """
    false = np.array([1.0 if p is None else 1.0 - p for p in probability])
    order = np.argsort(false, kind="stable")
    mean = np.cumsum(false[order]) / np.arange(1, false.size + 1)
    count = int(np.flatnonzero(mean <= FALSE_CALLS)[-1]) + 1 if np.any(mean <= FALSE_CALLS) else 0
    called = np.zeros(false.size, dtype=bool)
    called[order[:count]] = True
    return [bool(one) and false[n] < 0.5 for n, one in enumerate(called)]


@dataclass(frozen=True, slots=True)
class _Log:
    """Draws with rate and jump as logarithms, shape (…, draw)."""

    rate: FloatArray
    kind: NDArray[np.int_]
    jump: FloatArray

    @classmethod
    def of(cls, draws: WearDraws, at: NDArray[np.int_] | slice = slice(None)) -> _Log:
        rate = np.log(np.maximum(draws.rate_rad_per_year[at], 1e-12))
        return cls(rate, draws.kind[at], np.log(draws.jump_rad[at]))

    def at(self, draw: NDArray[np.int_]) -> _Log:
        """One draw of each joint."""
        joint = np.arange(draw.size)
        return _Log(self.rate[joint, draw], self.kind[joint, draw], self.jump[joint, draw])


@dataclass(frozen=True, slots=True)
class _Type:
    """One draw of what the joints of a type have in common."""

    centre: float
    slope: FloatArray
    spread: float
    share: FloatArray
    jump_centre: float
    jump_spread: float
    own: float

    def worth(self, joint: _Log, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weight of each draw for the type, and as a joint of its own, both (…, draw).

        Densities relative to the prior of a single joint, which is flat in the rate. ``x``:
        covariates, shape (…, c).
        """
        from_centre = joint.rate - self.centre - (x @ self.slope)[..., None]
        alike = -0.5 * (from_centre / self.spread) ** 2 - from_centre
        alike -= 0.5 * ((joint.jump - self.jump_centre) / self.jump_spread) ** 2
        scale = _LOG_JUMPS / (2.0 * np.pi * self.spread * self.jump_spread)
        # A kind that no joint has is worth little, never nothing.
        of_kind = np.maximum(self.share / _PRIOR, 1e-9)[joint.kind]
        own = 2.0 / (np.pi * OWN_RATE * (1.0 + (np.exp(from_centre) / OWN_RATE) ** 2))
        return (1.0 - self.own) * scale * of_kind * np.exp(alike), self.own * own


def _sampled(joints: _Log, x: FloatArray, generator: np.random.Generator) -> list[_Type]:
    """Types by Gibbs sampling from draws of all joints, shape (joint, draw)."""
    middle, middle_jump = float(np.median(joints.rate)), float(np.median(joints.jump))
    one = _Type(middle, np.zeros(x.shape[1]), 0.5, _PRIOR, middle_jump, 1.5, 0.2)
    number, count = joints.rate.shape
    types = []
    for sweep in range(BURN_IN + SWEEPS):
        alike, own = one.worth(joints, x)
        total = np.cumsum(alike + own, axis=1)
        level = generator.uniform(size=number) * total[:, -1]
        at = np.minimum((total < level[:, None]).sum(axis=1), count - 1)
        share_own = own / (alike + own)
        is_own = generator.uniform(size=number) < share_own[np.arange(number), at]
        drawn, strangers = joints.at(at), int(is_own.sum())
        rates, kinds, jumps = (x[~is_own] for x in (drawn.rate, drawn.kind, drawn.jump))
        of_type = x[~is_own]
        centre, slope = _regression(rates, of_type, one.spread, middle, generator)
        jump_centre, _ = _regression(jumps, of_type[:, :0], one.jump_spread, middle_jump, generator)
        one = _Type(
            centre,
            slope,
            _spread(rates - centre - of_type @ slope, SPREAD, generator),
            generator.dirichlet(BELIEF * _PRIOR + np.bincount(kinds, minlength=_PRIOR.size)),
            jump_centre,
            _spread(jumps - jump_centre, JUMP_SPREAD, generator),
            float(generator.beta(1 + strangers, 1 + number - strangers)),
        )
        if sweep >= BURN_IN and sweep % (SWEEPS // HYPER_DRAWS) == 0:
            types.append(one)
    return types


def _regression(
    values: FloatArray, x: FloatArray, spread: float, middle: float, generator: np.random.Generator
) -> tuple[float, FloatArray]:
    """Draw μ and β given ln r_j and τ."""
    columns = np.column_stack([np.ones(values.size), x])
    prior = np.array([_FAR, *[_SLOPE] * x.shape[1]]) ** -2.0
    believed = np.array([middle, *[0.0] * x.shape[1]])
    factor = np.linalg.cholesky(columns.T @ columns / spread**2 + np.diag(prior))
    target = columns.T @ values / spread**2 + prior * believed
    whitened = np.linalg.solve(factor, target) + generator.standard_normal(prior.size)
    centre, *slope = np.linalg.solve(factor.T, whitened)
    return float(centre), np.array(slope)


def _spread(
    apart: FloatArray, bounds: tuple[float, float], generator: np.random.Generator
) -> float:
    """Draw τ given ln r_j − μ, on a grid of 2 to 5 %."""
    grid = np.geomspace(*bounds, 100)
    # One power less of τ, for the grid is even in ln τ and its prior in τ.
    log = (1 - apart.size) * np.log(grid) - 0.5 * float(apart @ apart) / grid**2
    total = np.cumsum(np.exp(log - log.max()))
    return float(grid[np.searchsorted(total, generator.uniform() * total[-1])])


def _borrowed(
    joint: _Log, x: FloatArray, types: Sequence[_Type], generator: np.random.Generator
) -> Borrowed:
    """Draws of a joint weighted by its type, and the probability that it wears in its own way."""
    weight, is_own = np.zeros(joint.rate.size), 0.0
    for one in types:
        alike, own = one.worth(joint, x)
        total = float(alike.sum() + own.sum())
        weight += (alike + own) / total
        is_own += float(own.sum()) / total / len(types)
    if weight.sum() ** 2 / np.sum(weight**2) < FEWEST_EFFECTIVE:
        return Borrowed(None, is_own)
    chosen = generator.choice(weight.size, weight.size, p=weight / weight.sum())
    return Borrowed(chosen, is_own)
