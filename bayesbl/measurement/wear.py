"""How fast a joint wears, and when its gap reaches a limit: from joint draws of dated snapshots.

Path, laws and priors are those of ``docs/design.md``, "Change and wear". Time counts in spans, from
0 at the first snapshot in use to 1 at the last, so no law has a unit of time; the growth since the
first snapshot is a multiple of that over the span.

Law and scatter are drawn by sequential Monte Carlo (Del Moral, Doucet and Jasra 2006) from their
marginal likelihood: δ(t₁) and Δ have flat priors and are integrated out; between snapshots the
gamma process is taken as normal with the same mean and covariance, beyond the last it is the gamma
process itself, with changes of the law that no snapshot can show.

The path is laid through *each joint draw* of the gaps, each with a law of its own. What the
snapshots share, the curve's coefficients and the bench, is thereby one draw for all of them; a
factor that they share makes another path of the same law. Weights come from what they do not
share.

Wear does not heal: paths that fall are left out. Rate and date must therefore never be read as a
sign of wear; that is what :func:`trend` is for, which may have either sign.

**Stored.** :data:`DATES` and, where there is a rate, :data:`WEAR` as one group of ``result.nc``.
Attributes: ``decide_before`` where that was asked, ``relative_sd_per_date`` with ``drift_widens``
where the gaps drift, ``width_over_prior`` of the date. The keys of the summary are those of
:class:`bayesbl.measurement.summary_types.WearSummary`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date as Date
from datetime import timedelta
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import bisect
from scipy.special import gdtrib, ndtr, ndtri

from bayesbl.config.measurement import CompareConfig
from bayesbl.config.sections import Interval as IntervalConfig
from bayesbl.measurement.compatibility import limit_rad_of
from bayesbl.measurement.measurement import Answer, Reason
from bayesbl.measurement.summary_types import WearSummary
from bayesbl.probabilities import normal_sf
from bayesbl.recording.types import FloatArray
from bayesbl.results.intervals import interval
from bayesbl.results.variables import Group, dataset, table

HAZARD = 1.5
"""Changes of regime to be expected while the age grows e-fold."""

EXPONENT = (1.8, 1.0)
FACTOR = (1.3, 1.3)
AGE = (0.03, 10.0)

CHANGES, AHEAD = 2, 4
"""Changes between the snapshots and ahead of them at most."""

NORMALS = 2 + 3 * CHANGES
"""Standard normal numbers that make one law: age, exponents, changes and their factors."""

_LARGEST_EXPONENT = 300.0
"""Powers of e beyond this are as good as infinite; above 700 they overflow."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A range of exponents of the regime at the last snapshot, and its prior probability."""

    law: str
    exponents: tuple[float, float]

    @property
    def probability(self) -> float:
        median, deviation = EXPONENT
        low, high = (np.log(np.asarray(each) / median) / deviation for each in self.exponents)
        return float(ndtr(high) - ndtr(low))


KINDS = (
    Kind("slowing", (1e-9, 0.85)),
    Kind("steady", (0.85, 1.18)),
    Kind("speeding_up", (1.18, 2.0)),
    Kind("speeding_up", (2.0, 3.5)),
    Kind("speeding_up", (3.5, 1e9)),
)
"""Kinds of wear, which mean the same for every joint, so that joints may share them."""


def shares(kind: NDArray[np.int_] | FloatArray) -> dict[str, float]:
    """Share of each law among the draws of a kind, all of them."""
    counted = np.bincount(kind.astype(int).ravel(), minlength=len(KINDS)) / kind.size
    return by_law(counted)


def by_law(share: FloatArray) -> dict[str, float]:
    """Shares of kinds, summed over those of one law."""
    total = dict.fromkeys((kind.law for kind in KINDS), 0.0)
    for kind, each in zip(KINDS, share, strict=True):
        total[kind.law] += float(each)
    return total


@dataclass(frozen=True, slots=True)
class Laws:
    """Laws of wear, one a particle, in regimes from the first snapshot on.

    Attributes
    ----------
    rows
        Shape (1 + 3 regimes, particle): the age at the first snapshot in spans; ln of the age at
        which each regime starts over that at the first snapshot, ascending, the first 0; the
        exponent of each; the factor of the rate as each starts.
    """

    rows: FloatArray

    @classmethod
    def until_now(cls, normal: FloatArray, age: float | None = None) -> Laws:
        """Laws up to the last snapshot from standard normal numbers, (``NORMALS``, particle).

        Changes are counted back from the last snapshot: where they come at random, that is as good
        as counting from the first, and the latest ones matter most. ``age`` is that at the first
        snapshot where it is known.
        """
        exponents, waits, factors = np.split(normal[1:], [CHANGES + 1, 2 * CHANGES + 1])
        low, high = AGE
        ages = low * (high / low) ** ndtr(normal[:1])
        if age is not None:
            ages = np.full(ages.shape, max(age, 1e-3))
        back = np.log1p(1.0 / ages) - np.cumsum(_waits(waits), axis=0)[::-1]
        start, factor = np.maximum(back, 0.0), _log_normal(FACTOR, factors)
        first = np.zeros(ages.shape)
        exponent = _log_normal(EXPONENT, exponents)
        return cls(np.concatenate([ages, first, start, exponent, first + 1.0, factor]))

    def and_ahead(self, generator: np.random.Generator) -> Laws:
        """The same with changes ahead of the last snapshot, as believed beforehand."""
        count = self.rows.shape[1]
        waits, exponents, factors = generator.standard_normal((3, AHEAD, count))
        start = self._log_age(1.0) + np.cumsum(_waits(waits), axis=0)
        ahead = [start, _log_normal(EXPONENT, exponents), _log_normal(FACTOR, factors)]
        parts = np.concatenate([self._parts(), np.stack(ahead)], axis=1)
        return Laws(np.concatenate([self.rows[:1], parts.reshape(-1, count)]))

    def _parts(self) -> FloatArray:
        """Starts, exponents and factors, shape (3, regime, particle)."""
        return self.rows[1:].reshape(3, -1, self.rows.shape[1])

    def _log_age(self, elapsed: FloatArray | float) -> FloatArray:
        """ln of the age so many spans after the first snapshot over that at it."""
        return np.asarray(np.log1p(np.asarray(elapsed) / self.rows[0]))

    def grown(self, elapsed: FloatArray) -> FloatArray:
        """Growth in multiples of that over the span; ``elapsed`` has shape (…, particle)."""
        return self._grown(elapsed) / self._grown(np.ones(self.rows.shape[1]))

    def _grown(self, elapsed: FloatArray) -> FloatArray:
        log_age = self._log_age(elapsed)
        total = np.zeros(log_age.shape)
        for start, end, exponent, scale in self._regimes():
            within = np.clip(log_age, start, end) - start
            total += scale * np.expm1(_small(exponent * within))
        return total

    def _regimes(self) -> Iterator[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
        """Start, end and exponent p of each regime; growth where e^(p (ln age − start)) is 2."""
        starts, exponents, factors = self._parts()
        ends = np.concatenate([starts[1:], np.full((1, starts.shape[1]), np.inf)])
        log_rate = np.zeros(starts.shape[1])
        for start, end, exponent, factor in zip(starts, ends, exponents, factors, strict=True):
            log_rate = log_rate + np.log(factor)
            yield start, end, exponent, np.exp(_small(log_rate + start)) / exponent
            log_rate = log_rate + (exponent - 1.0) * (end - start)

    def kind(self) -> NDArray[np.int_]:
        """Number in :data:`KINDS` of the regime at the last snapshot, (particle,)."""
        bounds = [kind.exponents[1] for kind in KINDS[:-1]]
        return np.asarray(np.searchsorted(bounds, self._parts()[1, CHANGES]))

    def time_of(self, growth: FloatArray, longest: float) -> FloatArray:
        """Time in spans, at most ``longest``, at which so much of that over the span is there."""
        missing = growth * self._grown(np.ones(self.rows.shape[1]))
        log_age = np.zeros(growth.shape)
        for start, end, exponent, scale in self._regimes():
            whole = scale * np.expm1(_small(exponent * (end - start)))
            last = np.log1p(np.clip(missing, 0.0, whole) / scale) / exponent
            log_age = np.where(missing > 0.0, start + last, log_age)
            missing = missing - whole
        return np.asarray(np.minimum(self.rows[0] * np.expm1(_small(log_age)), longest))

    def changes_before(self, elapsed: FloatArray) -> NDArray[np.bool_]:
        """Whether wear changes between the last snapshot and so many spans, (particle,)."""
        return np.asarray(self._parts()[0, CHANGES + 1] < self._log_age(elapsed))


def _waits(normal: FloatArray) -> FloatArray:
    """Exponentially distributed e-foldings of the age from one change to the next."""
    return np.asarray(-np.log(ndtr(normal)) / HAZARD)


def _log_normal(prior: tuple[float, float], normal: FloatArray) -> FloatArray:
    return np.asarray(prior[0] * np.exp(prior[1] * normal))


def _small(exponent: FloatArray) -> FloatArray:
    return np.minimum(exponent, _LARGEST_EXPONENT)


FEWEST_FOR_SCATTER = 4
"""Snapshots from which on irregular wear can be told from errors of measuring."""

LEAST_SHARE_GROWING = 0.01
"""Share of draws that grow below which the gap has shrunk, which wear cannot do."""

FALSE_ALARM = 0.01
"""How often gaps that never fell are said to have fallen between two dates."""

LONGEST_YEARS = 1000.0
"""Times to the limit are cut here: a rate near 0 makes them as long as one likes."""

SCATTER = (0.001, 0.8)
"""Range of the log-uniform prior of σ, in multiples of the growth over the span."""

PARTICLES = 2048
LEAST_EFFECTIVE = 0.5
"""Share of particles that a step of tempering leaves effective."""

MOVES = 4
"""Metropolis steps of every particle after each step of tempering."""

_SMOOTH = 1e4
"""More jumps than this between the gap and its limit are as good as none."""


WEAR = Group(
    "wear",
    table("""
        law (chain, draw) | 1 | kind of the law at the last snapshot, from 0
        law_shape (law_parameter, chain, draw) | 1 | age, starts, exponents, factors of the law
        first_rad (chain, draw) | rad | gap at the first snapshot in use, estimated from all
        current_rad (chain, draw) | rad | gap at the last snapshot, estimated from all
        expected_growth_rad (chain, draw) | rad | mean growth between them by the law
        rate_now_rad_per_year (chain, draw) | rad/year | rate at the last snapshot by the law
        scatter_rad_per_root_year (chain, draw) | rad/year^0.5 | irregular wear
        trend_rad_per_year (chain, draw) | rad/year | slope of a straight line, of either sign
        years_to_limit? (chain, draw) | year | time from the last snapshot to the limit
        changes_ahead? (chain, draw) | 1 | 1 where wear changes before the limit is reached
    """),
)
"""Wear of one joint since its last repair; chains and draws are those of the gaps.

``law`` is a number in :data:`KINDS`, ``law_shape`` is :attr:`Laws.rows`, ``expected_growth_rad`` Δ,
and ``scatter_rad_per_root_year`` σ over the root of the span. ``years_to_limit`` is 0 where δ is
beyond the limit, at most ``LONGEST_YEARS``; it and ``changes_ahead``, which nothing measured can
show, are there where there is a limit. The attribute ``width_over_prior`` is the width of the 90 %
interval of ln years_to_limit over that with the same gap and mean rate but laws as believed
beforehand; it is missing where hardly a draw has the limit ahead.
"""

DATES = Group(
    WEAR.name,
    table("""
        date (dated) | text | date of snapshot
        used (dated) | 1 | 1 where taken since the last repair
    """),
)
"""What the group :data:`WEAR` holds of dated snapshots, whether there is a rate or not."""


def fall(delta_rad: FloatArray) -> tuple[int, float, float] | None:
    """The surest fall of the gap from one snapshot to the next, which wear rules out.

    From joint draws, (snapshot, chain, draw), in rad: what snapshots share falls nowhere.

    Returns
    -------
    Number of the snapshot that lies below the one before it, by how many rad, and by how many
    standard deviations; ``None`` where errors of measuring make a fall as sure as this somewhere
    with a probability of ``FALSE_ALARM`` (Bonferroni).
    """
    falls = -np.diff(delta_rad.reshape(len(delta_rad), -1), axis=0)
    middle, spread = falls.mean(axis=1), falls.std(axis=1)
    deviations = middle / np.maximum(spread, 1e-12 * np.abs(delta_rad).max())
    surest = int(np.argmax(deviations))
    deviation = float(deviations[surest])
    if len(falls) * normal_sf(deviation) >= FALSE_ALARM:
        return None
    return surest + 1, float(middle[surest]), deviation


def since_repair(repaired: Sequence[bool]) -> slice:
    """The snapshots from the last that was the first after a repair, or all of them."""
    starts = [number for number, flag in enumerate(repaired) if flag]
    return slice(starts[-1] if starts else 0, len(repaired))


def trend(delta_rad: FloatArray, years: FloatArray) -> FloatArray:
    """Slope of the straight line through each joint draw, of either sign, rad/year.

    Whatever the law, its sign is that of the wear. Parameters as :func:`wear` takes them.
    """
    gaps = delta_rad.reshape(len(years), -1)
    elapsed = np.broadcast_to(years[:, None] - years[0], gaps.shape)
    line, _ = _fit(gaps, elapsed, own_variance(gaps), np.zeros(gaps.shape[1]))
    return np.asarray(line[1].reshape(delta_rad.shape[1:]))


def wear(
    delta_rad: FloatArray,
    years: FloatArray,
    seed: np.random.SeedSequence,
    *,
    limit_rad: float | None = None,
    age_years: float | None = None,
) -> xr.Dataset | None:
    """Law, rate, present gap and time to the limit, from snapshots without a repair between them.

    As group :data:`WEAR`; ``None`` where less than ``LEAST_SHARE_GROWING`` of the draws grow: the
    gap shrank.

    Parameters
    ----------
    delta_rad
        Draws of the gaps, paired by draw, shape (snapshot, chain, draw), two snapshots or more.
    years
        When each was taken, from any origin, shape (snapshot,), ascending, not all the same.
    age_years
        How long the joint had worn at the first snapshot; ``None`` where nobody knows.

    Raises
    ------
    ValueError
        Where the times give no rate.
    """
    span = float(years[-1] - years[0])
    if len(years) < 2 or span <= 0.0 or np.any(np.diff(years) < 0.0):
        raise ValueError("a rate needs ascending times of two snapshots or more")
    generator = np.random.default_rng(seed)
    gaps = delta_rad.reshape(len(years), -1)
    problem = _Problem.of(gaps, (years - years[0]) / span, age_years and age_years / span)
    normal = _tempered(problem, generator)
    count = gaps.shape[1]
    normal = normal[:, generator.permutation(np.arange(count) % PARTICLES)]
    elapsed, scatter = problem.growth(normal), problem.scatter(normal)
    steps = np.sqrt(np.diff(elapsed, axis=0, prepend=0.0))
    path = scatter * np.cumsum(steps * generator.standard_normal(gaps.shape), axis=0)
    # Matheron's rule: the line through what a drawn path leaves of a draw is a draw of the line.
    (first, growth), _ = _fit(gaps - path, elapsed, problem.own, scatter**2)
    current = first + growth + path[-1]
    grows = np.flatnonzero((growth > scatter / SCATTER[1]) & (current > first))
    if grows.size < LEAST_SHARE_GROWING * count:
        return None
    # Every draw that falls gives its place to one that grows.
    place = np.arange(count)
    place[np.setdiff1d(place, grows)] = generator.choice(grows, count - grows.size)
    laws = problem.laws(normal[:, place]).and_ahead(generator)
    first, growth, current, scatter = (x[place] for x in (first, growth, current, scatter))
    before = np.full(count, 1.0 - 1e-3)
    values = {
        "law": laws.kind(),
        "law_shape": laws.rows,
        "first_rad": first,
        "current_rad": current,
        "expected_growth_rad": growth,
        "rate_now_rad_per_year": growth * (1.0 - laws.grown(before)) / (1e-3 * span),
        "scatter_rad_per_root_year": scatter / np.sqrt(span),
    }
    attrs = {}
    if limit_rad is not None:
        needed = _growth_needed(limit_rad - current, scatter**2 / growth, generator)
        believed = problem.laws(generator.standard_normal(normal.shape)).and_ahead(generator)
        longest = 1.0 + LONGEST_YEARS / span
        spans, prior = (x.time_of(1.0 + needed / growth, longest) for x in (laws, believed))
        is_ahead = needed > 0.0
        values["years_to_limit"] = np.where(is_ahead, span * (spans - 1.0), 0.0)
        values["changes_ahead"] = np.where(is_ahead & laws.changes_before(spans), 1.0, 0.0)
        if is_ahead.mean() > LEAST_SHARE_GROWING:
            width = _log_width(spans[is_ahead] - 1.0) / _log_width(prior[is_ahead] - 1.0)
            attrs["width_over_prior"] = width
    draws = delta_rad.shape[1:]
    values = {name: v.reshape(*v.shape[:-1], *draws) for name, v in values.items()}
    values["trend_rad_per_year"] = trend(delta_rad, years)
    return dataset(WEAR, values).assign_attrs(attrs)


def _log_width(times: FloatArray) -> float:
    low, high = np.quantile(np.log(np.maximum(times, 1e-12)), [0.05, 0.95])
    return max(float(high - low), 1e-12)


def own_variance(gaps: FloatArray) -> FloatArray:
    """Variance of each gap that it does not share with the others, shape (snapshot,), rad²."""
    middle = gaps.mean(axis=1)
    relative = np.cov(gaps / middle[:, None])
    variance = np.diag(relative)
    shared = (relative.sum() - variance.sum()) / (relative.size - variance.size)
    # A floor: gaps that share all but rounding must not be taken for exact.
    return np.asarray(np.maximum(variance - shared, 1e-4 * variance + 1e-18) * middle**2)


@dataclass(frozen=True, slots=True)
class _Problem:
    """What is measured, in spans of time: means and own variances of the gaps, (snapshot,)."""

    middle: FloatArray
    own: FloatArray
    elapsed: FloatArray
    scale_rad: float
    age: float | None

    @classmethod
    def of(cls, gaps: FloatArray, elapsed: FloatArray, age: float | None) -> _Problem:
        own = own_variance(gaps)
        slope = trend(gaps[:, None, :], elapsed)
        scale = max(float(slope.mean()), float(slope.std()))
        return cls(gaps.mean(axis=1), own, elapsed, scale, age)

    def laws(self, normal: FloatArray) -> Laws:
        return Laws.until_now(normal[:NORMALS], self.age)

    def scatter(self, normal: FloatArray) -> FloatArray:
        low, high = SCATTER
        return np.asarray(self.scale_rad * low * (high / low) ** ndtr(normal[NORMALS]))

    def growth(self, normal: FloatArray) -> FloatArray:
        """u at each snapshot, shape (snapshot, particle)."""
        return self.laws(normal).grown(self.elapsed[:, None])

    def log_likelihood(self, normal: FloatArray) -> FloatArray:
        growth, variance = self.growth(normal), self.scatter(normal) ** 2
        middle = np.broadcast_to(self.middle[:, None], growth.shape)
        return _fit(middle, growth, self.own, variance)[1]


def _fit(
    gaps: FloatArray, growth: FloatArray, own: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """δ(t₁) and Δ by generalised least squares, (2, particle), and ln of the restricted likelihood.

    Of gaps = δ(t₁) + Δ u + W + errors, W a normal walk of variance ``variance`` u, all but ``own``
    of shape (snapshot, particle) or (particle,). A Kalman filter takes the walk out, one snapshot
    after the other, so that n of them cost n.
    """
    columns = np.stack([np.ones(gaps.shape), growth, gaps - gaps[0]])
    state, uncertain = np.zeros((3, gaps.shape[1])), np.zeros(gaps.shape[1])
    products, log_determinant = np.zeros((3, 3, gaps.shape[1])), 0.0
    before = np.zeros(gaps.shape[1])
    for number, noise in enumerate(own):
        uncertain = uncertain + variance * (growth[number] - before)
        before = growth[number]
        total = uncertain + noise
        innovation = columns[:, number] - state
        products += innovation[:, None] * innovation[None] / total
        log_determinant = log_determinant + np.log(total)
        gain = uncertain / total
        state, uncertain = state + gain * innovation, uncertain * (1.0 - gain)
    (a, b, e), (_, c, f), (_, _, squares) = products
    determinant = a * c - b * b
    line = np.stack([c * e - b * f, a * f - b * e]) / determinant
    misfit = squares - line[0] * e - line[1] * f
    log_likelihood = -0.5 * (log_determinant + np.log(determinant) + misfit)
    line[0] += gaps[0]
    return line, log_likelihood


def _tempered(problem: _Problem, generator: np.random.Generator) -> FloatArray:
    """Standard normal numbers of equally likely laws and scatters, by tempering the likelihood."""
    from scipy.stats import qmc

    uniform = qmc.Sobol(NORMALS + 1, rng=generator).random(PARTICLES)
    normal = ndtri(np.clip(uniform.T, 1e-9, 1.0 - 1e-9))
    likely, done = problem.log_likelihood(normal), 0.0
    while done < 1.0:
        step = _step(likely, 1.0 - done)
        done += step
        weight = np.exp(step * (likely - likely.max()))
        ladder = (np.arange(PARTICLES) + generator.uniform()) / PARTICLES
        chosen = np.searchsorted(np.cumsum(weight / weight.sum()), ladder)
        chosen = generator.permutation(np.minimum(chosen, PARTICLES - 1))
        normal, likely = normal[:, chosen], likely[chosen]
        for _ in range(MOVES):
            # Along the difference of two others, in some of the numbers (ter Braak 2006).
            others = normal[:, generator.permutation(PARTICLES)]
            apart = normal[:, generator.permutation(PARTICLES)] - others
            size = generator.choice([0.1, 0.4, 0.8], PARTICLES)
            touched = generator.uniform(size=normal.shape) < generator.choice(
                [0.2, 0.5, 1.0], PARTICLES
            )
            noise = 0.01 * generator.standard_normal(normal.shape)
            moved = normal + np.where(touched, size * apart, 0.0) + noise
            proposed_likelihood = problem.log_likelihood(moved)
            gain = done * (proposed_likelihood - likely) - 0.5 * np.sum(
                moved**2 - normal**2, axis=0
            )
            taken = np.log(generator.uniform(size=PARTICLES)) < gain
            normal = np.where(taken, moved, normal)
            likely = np.where(taken, proposed_likelihood, likely)
    return np.asarray(normal)


def _step(likely: FloatArray, most: float) -> float:
    """How far to temper so that ``LEAST_EFFECTIVE`` of the particles stay effective."""

    def effective(step: float) -> float:
        weight = np.exp(step * (likely - likely.max()))
        return float(weight.sum() ** 2 / np.sum(weight**2)) / likely.size

    if effective(most) >= LEAST_EFFECTIVE:
        return most
    return float(bisect(lambda step: effective(step) - LEAST_EFFECTIVE, 0.0, most))


def _growth_needed(
    distance: FloatArray, jump: FloatArray, generator: np.random.Generator
) -> FloatArray:
    """Mean growth until a gamma process first covers a distance, 0 where it is behind.

    A mean growth of m is a gamma distribution of shape m / jump and scale ``jump``: the shape at
    which a uniform share of it lies below the distance.
    """
    ahead = np.maximum(distance, 0.0)
    jumps = np.clip(ahead / jump, 1e-12, _SMOOTH)
    shape = gdtrib(1.0, generator.uniform(size=jumps.size), jumps)
    return np.where(jumps < _SMOOTH, shape * jump, ahead) * (distance > 0.0)


DAYS_PER_YEAR = 365.25


def years_between(first: Date, last: Date) -> float:
    """Time from one date to another."""
    return (last - first).days / DAYS_PER_YEAR


def date_after(first: Date, years: float) -> Date | None:
    """The day so many years later; ``None`` where that is beyond what is computed."""
    if years >= LONGEST_YEARS:
        return None
    return first + timedelta(days=round(years * DAYS_PER_YEAR))


def wear_of(
    config: CompareConfig,
    answers: Sequence[Answer],
    seed: np.random.SeedSequence,
    change_reason: Reason | None = None,
) -> tuple[xr.Dataset | None, Reason | None]:
    """Group :data:`WEAR` of a comparison, with its :data:`DATES`, and why it has no rate.

    ``None`` where not every recording has a date. ``change_reason`` is why the change of the gap is
    withheld, which withholds its rate too.
    """
    dates = config.dates
    if dates is None:
        return None, None
    used = since_repair([recording.repaired for recording in config.recordings])
    since, chosen = dates[used], answers[used]
    taken = np.zeros(len(dates))
    taken[used] = 1.0
    group = dataset(DATES, {"date": [d.isoformat() for d in dates], "used": taken})
    if config.joint.decide_before is not None:
        group.attrs["decide_before"] = config.joint.decide_before.isoformat()
    if since[0] == since[-1]:
        repaired = config.recordings[used.start].repaired
        return group, Reason("one_date", {"count": len(since), "repaired": repaired})
    withheld = [answer.name for answer in chosen if answer.is_withheld]
    if withheld:
        return group, Reason("gap_withheld", {"names": withheld})
    if change_reason is not None:
        return group, change_reason
    years = np.array([years_between(since[0], day) for day in since])
    drift_seed, wear_seed = seed.spawn(2)
    measured = np.stack([a.delta_rad for a in chosen if a.delta_rad is not None])
    drawn = _drifting(measured, config.wear.relative_sd_per_date, drift_seed)
    start, limit = config.wear.in_service_since, limit_rad_of(config)
    age = None if start is None else max(years_between(start, since[0]), 0.0)
    if (fell := fall(drawn)) is not None:
        number, fall_rad, deviations = fell
        values = {"name": chosen[number].name, "fall_rad": fall_rad}
        return group, Reason("gap_fell", {**values, "standard_deviations": deviations})
    forecast = wear(drawn, years, wear_seed, limit_rad=limit, age_years=age)
    if forecast is None:
        return group, Reason("gap_shrank")
    group = group.merge(forecast).assign_attrs({**group.attrs, **forecast.attrs})
    if config.wear.relative_sd_per_date > 0.0:
        group.attrs["relative_sd_per_date"] = config.wear.relative_sd_per_date
        group.attrs["drift_widens"] = float(
            trend(drawn, years).std() / trend(measured, years).std()
        )
    return group, None


def _drifting(
    delta_rad: FloatArray, relative_sd: float, seed: np.random.SeedSequence
) -> FloatArray:
    """Draws of gaps that temperature, grease and the like may have moved, each date by itself."""
    moved = np.random.default_rng(seed).standard_normal(delta_rad.shape)
    return np.asarray(delta_rad * np.exp(relative_sd * moved))


def used_dates(group: xr.Dataset) -> list[Date]:
    """Dates of the snapshots since the last repair."""
    stored = zip(group["date"].values, group["used"].values, strict=True)
    return [Date.fromisoformat(str(day)) for day, used in stored if used]


@dataclass(frozen=True, slots=True)
class WearDraws:
    """How a joint wears: paired draws, shape (draw,).

    Attributes
    ----------
    rate_rad_per_year
        Mean from the first snapshot in use to the last.
    kind
        Of the law at the last snapshot, its number in :data:`KINDS`.
    jump_rad
        Mean jump of irregular wear: variance of the growth over its mean.
    years_to_limit
        ``None`` without a limit.
    probability_wear
        That the gap grows at all, by lines of either sign.
    """

    rate_rad_per_year: FloatArray
    kind: NDArray[np.int_]
    jump_rad: FloatArray
    rate_now_rad_per_year: FloatArray
    years_to_limit: FloatArray | None = None
    probability_wear: float = 1.0

    @classmethod
    def of(cls, group: xr.Dataset) -> WearDraws | None:
        """From group :data:`WEAR`; ``None`` where it has dates and no rate."""
        if "law" not in group:
            return None
        dates = used_dates(group)
        span = years_between(dates[0], dates[-1])
        rows = {str(name): group[name].values.ravel() for name in group.data_vars}
        return cls(
            (rows["current_rad"] - rows["first_rad"]) / span,
            rows["law"].astype(int),
            rows["scatter_rad_per_root_year"] ** 2 * span / rows["expected_growth_rad"],
            rows["rate_now_rad_per_year"],
            rows.get("years_to_limit"),
            float(np.mean(rows["trend_rad_per_year"] > 0.0)),
        )

    def at(self, draws: NDArray[np.int_]) -> WearDraws:
        """Some of the draws, by their numbers."""
        return WearDraws(
            self.rate_rad_per_year[draws],
            self.kind[draws],
            self.jump_rad[draws],
            self.rate_now_rad_per_year[draws],
            None if self.years_to_limit is None else self.years_to_limit[draws],
            self.probability_wear,
        )

    def summary(self, last: Date, of: IntervalConfig, before: Date | None) -> dict[str, Any]:
        """Keys of :class:`WearSummary` that follow from the draws.

        ``last``: date of the last snapshot; ``before``: that to decide before.
        """
        level, kind = of.level, of.kind
        result: dict[str, Any] = {
            "probability_wear": self.probability_wear,
            "law": shares(self.kind),
            "rate": {**interval(self.rate_rad_per_year, level, kind), "unit": "rad/year"},
            "rate_now": {**interval(self.rate_now_rad_per_year, level, kind), "unit": "rad/year"},
            "rate_at_most_rad_per_year": float(np.quantile(self.rate_rad_per_year, level)),
        }
        if (years := self.years_to_limit) is not None:
            bounds = interval(years, level, kind)
            ends = {key: _iso(last, bounds[key]) for key in ("median", "low", "high")}
            earliest = _iso(last, float(np.quantile(years, 1.0 - level)))
            result |= {
                "years_to_limit": bounds,
                "date_of_limit": {**bounds, **ends},
                "not_before": {"date": earliest, "level": level},
            }
            if before is not None:
                passed = float(np.mean(years <= years_between(last, before)))
                result["probability_before"] = {"date": before.isoformat(), "probability": passed}
        return result


def summarise_wear(
    group: xr.Dataset,
    names: Sequence[str],
    of: IntervalConfig,
    limit_rad: float | None,
    stated_limit: str | None = None,
) -> dict[str, Any]:
    """``wear`` of the summary of a comparison (see the module), but for its ``reason``."""
    before = group.attrs.get("decide_before")
    dates = used_dates(group)
    result: dict[str, Any] = dict.fromkeys(WearSummary.__annotations__)
    result |= {
        "snapshots": [n for n, used in zip(names, group["used"].values, strict=True) if used],
        "first_date": dates[0].isoformat(),
        "last_date": dates[-1].isoformat(),
        "level": of.level,
        "relative_sd_per_date": float(group.attrs.get("relative_sd_per_date", 0.0)),
        "drift_widens": group.attrs.get("drift_widens"),
        "limit_rad": limit_rad,
        "limit": stated_limit,
        "decide_before": before,
    }
    draws = WearDraws.of(group)
    if draws is None:
        return result
    result |= draws.summary(dates[-1], of, None if before is None else Date.fromisoformat(before))
    if len(dates) >= FEWEST_FOR_SCATTER:
        scatter = group["scatter_rad_per_root_year"].values
        result["scatter_rad_per_root_year"] = interval(scatter, of.level, of.kind)
    if "width_over_prior" in group.attrs:
        result["forecast_from_prior"] = {
            "width_over_prior": float(group.attrs["width_over_prior"]),
            "probability_change_ahead": float(group["changes_ahead"].mean()),
        }
    return result


def _iso(first: Date, years: float) -> str | None:
    date = date_after(first, years)
    return None if date is None else date.isoformat()
