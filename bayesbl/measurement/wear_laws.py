"""Laws of wear: how the mean gap grows in time, and what is believed of them before measuring.

Time counts in spans, from 0 at the first snapshot in use to 1 at the last, so no law has a unit of
time. The growth since the first snapshot is a multiple of that over the span, u(0) = 0, u(1) = 1.

There is one law, a power of age that changes from time to time. With a + t the age and p₀, p₁, …
the exponents of its regimes, the rate of wear is

    r(t) ∝ (a + t)^(p_i − 1)    from change i to change i + 1.

Changes come at random, ``HAZARD`` to an e-folding of the age whatever happened before; each
multiplies the rate by k_i and gives it a new exponent. They may lie between the snapshots or ahead
of the last one. So the family holds steady wear (Archard 1953), running in (Blau 2005), powers of
age (exponents 1/8 to 2 in the deterioration laws that van Noortwijk 2009 lists), a kink, wear-out
after years of steady wear, and speeding up that levels off, none of them for certain. Its priors
are

    ln p_i ~ N(ln ``EXPONENT``)    ln k_i ~ N(ln ``FACTOR``)    ln a uniform in ``AGE``

each a median with the standard deviation of its logarithm. With two dates they alone say how wide a
forecast is, and with any number how soon wear may change that was steady so far.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from bayesbl.recording.types import FloatArray

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
