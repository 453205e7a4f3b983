"""Laws of wear: how the mean gap grows in time, and what is believed of them before measuring.

Time counts in spans, from 0 at the first snapshot in use to 1 at the last, so no law has a unit of
time. A law gives the growth since the first snapshot as a multiple of that over the span,
u(0) = 0, u(1) = 1, with up to three shape parameters, each with a prior of its own.

==============  ======================================================  ==========================
law             growth before scaling, at t spans                       shapes
==============  ======================================================  ==========================
``linear``      t                                                       none
``running_in``  f t + (1 − f) (1 − e^(−t/c)) / (1 − e^(−1/c))           f steady share, c duration
``power``       (a + t)^p − a^p                                         p exponent, a age at t = 0
``exponential`` e^(g t) − 1                                             g growth of the rate
``s_shaped``    f t + (1 − f) S(t), S logistic from 0 to 1              f, middle m, steepness w
==============  ======================================================  ==========================

Wear is linear in sliding distance and load where nothing else changes (Archard 1953); surfaces
that run in wear faster first (Blau 2005); a gap that grows is hit harder, which speeds its wear up,
as a power of age (exponents 1/8 to 2 in the deterioration laws that van Noortwijk 2009 lists) or
without a memory of it; wear that sped up may level off. The priors are wide on purpose: with two
dates they alone say how wide a forecast is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from bayesbl.recording.types import FloatArray

SHAPES = 3
"""Shape parameters that a law has at most."""

_LARGEST_EXPONENT = 300.0
"""Powers of e beyond this are as good as infinite; above 700 they overflow."""


@dataclass(frozen=True, slots=True)
class Shape:
    """The prior of a shape parameter: log-uniform for times and shares, uniform for exponents."""

    low: float
    high: float
    is_exponent: bool = False

    def at(self, share: FloatArray) -> FloatArray:
        """Its value below which this share of the prior lies."""
        if self.is_exponent:
            return self.low + (self.high - self.low) * share
        return np.asarray(self.low * (self.high / self.low) ** share)


@dataclass(frozen=True, slots=True)
class Law:
    """One law: its prior probability, its shapes, and its growth.

    ``grown`` takes the time in spans and the shapes, and need not be 1 at the end of the span.
    """

    name: str
    probability: float
    shapes: tuple[Shape, ...]
    grown: Callable[..., FloatArray]


def _linear(elapsed: FloatArray) -> FloatArray:
    return elapsed


def _running_in(elapsed: FloatArray, steady: FloatArray, duration: FloatArray) -> FloatArray:
    transient = np.expm1(-elapsed / duration) / np.expm1(-1.0 / duration)
    return steady * elapsed + (1.0 - steady) * transient


def _power(elapsed: FloatArray, exponent: FloatArray, age: FloatArray) -> FloatArray:
    return np.expm1(np.minimum(exponent * np.log1p(elapsed / age), _LARGEST_EXPONENT))


def _exponential(elapsed: FloatArray, growth: FloatArray) -> FloatArray:
    return np.expm1(np.minimum(growth * elapsed, _LARGEST_EXPONENT))


def _s_shaped(
    elapsed: FloatArray, steady: FloatArray, middle: FloatArray, width: FloatArray
) -> FloatArray:
    def risen(at: FloatArray | float) -> FloatArray:
        return np.asarray(np.tanh((at - middle) / (2.0 * width)))

    start = risen(0.0)
    return steady * elapsed + (1.0 - steady) * (risen(elapsed) - start) / (risen(1.0) - start)


LAWS = (
    Law("linear", 0.17, (), _linear),
    Law("running_in", 0.06, (Shape(0.4, 1.0), Shape(0.05, 2.0)), _running_in),
    Law("power", 0.26, (Shape(1.2, 3.5, is_exponent=True), Shape(0.03, 3.0)), _power),
    Law("exponential", 0.31, (Shape(0.3, 4.5, is_exponent=True),), _exponential),
    Law("s_shaped", 0.20, (Shape(0.08, 0.5), Shape(0.3, 3.0), Shape(0.1, 1.0)), _s_shaped),
)


@dataclass(frozen=True, slots=True)
class Kind:
    """A law, or a third of it, that joints may share."""

    law: str
    probability: float


POWERS = 3
"""Kinds of the power law, by its exponent, which means the same for every joint: the other shapes
count in spans of the joint's own snapshots."""

KINDS = tuple(
    Kind(law.name, law.probability / parts)
    for law in LAWS
    for parts in (POWERS if law.name == "power" else 1,)
    for _ in range(parts)
)


def kinds(law: NDArray[np.int_], shape: FloatArray) -> NDArray[np.int_]:
    """Number of the kind of each draw, shapes (draw,) and (``SHAPES``, draw)."""
    first = {each.name: [k.law for k in KINDS].index(each.name) for each in LAWS}
    found = np.array([first[each.name] for each in LAWS])[law]
    exponent = LAWS[[each.name for each in LAWS].index("power")].shapes[0]
    share = (shape[0] - exponent.low) / (exponent.high - exponent.low)
    of = found == first["power"]
    found[of] += np.clip(POWERS * share[of], 0, POWERS - 1).astype(int)
    return np.asarray(found)


def shapes(law: NDArray[np.int_], normal: FloatArray, age: float | None = None) -> FloatArray:
    """Shape parameters from standard normal numbers, shape (``SHAPES``, particle); unused are 1.

    ``age`` is that of the joint at the first snapshot, in spans, where it is known.
    """
    found = np.ones(normal.shape)
    share = ndtr(normal)
    for number, each in enumerate(LAWS):
        of = law == number
        for row, prior_of in enumerate(each.shapes):
            found[row, of] = prior_of.at(share[row, of])
        if each.name == "power" and age is not None:
            found[1, of] = max(age, 1e-3)  # a law of age 0 is that of this one
    return found


def grown(law: NDArray[np.int_], shape: FloatArray, elapsed: FloatArray) -> FloatArray:
    """Growth in multiples of that over the span, of the shape of ``elapsed``, (…, particle)."""
    found = np.empty(elapsed.shape)
    for number, each in enumerate(LAWS):
        of = np.flatnonzero(law == number)
        own = shape[: len(each.shapes), of]
        found[..., of] = each.grown(elapsed[..., of], *own) / each.grown(np.ones(of.shape), *own)
    return found


def time_of(
    law: NDArray[np.int_], shape: FloatArray, growth: FloatArray, longest: float
) -> FloatArray:
    """Time in spans, 1 to ``longest``, at which a growth of at least 1 is there, by halving."""
    low, high = np.ones(law.shape), np.full(law.shape, longest)
    for _ in range(52):
        middle = 0.5 * (low + high)
        short = grown(law, shape, middle) < growth
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return high


def prior() -> Sequence[float]:
    """Prior probability of each law."""
    return [law.probability for law in LAWS]
