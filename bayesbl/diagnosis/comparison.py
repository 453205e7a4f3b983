"""What a least-squares comparison of bench and recordings hands to the selection of effects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.diagnosis.diagnosis import LearnedAnswer
from bayesbl.diagnosis.disagreement import PieceResiduals, Use, piece_residuals
from bayesbl.recording.types import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Piece:
    """A recording, or a part of one, as it is compared.

    Attributes
    ----------
    name, channel
        Of the recording, and of what is compared.
    use
        ``used``: effects are fitted on it. ``held_out``: only start, phases and offsets are.
    time_s, measured
        Shape (n,), evenly spaced; the channel's unit.
    excluded
        Shape (n,): samples that were lost or cannot be trusted, ``None`` where there are none.
    shown
        Whether the answer tells its disagreement: not of what the comparison could not explain.
    white
        Autocovariance of white noise behind the filter that both sides passed, lags of 0, 1, …
        samples; ``None`` where they passed none.
    """

    name: str
    channel: str
    use: Use
    time_s: FloatArray
    measured: FloatArray
    excluded: BoolArray | None = None
    shown: bool = True
    white: FloatArray | None = None

    def kept(self, values: FloatArray) -> FloatArray:
        """Values of the samples that count, (n, …) to (k, …)."""
        return values if self.excluded is None else values[~self.excluded]

    def half(self, second: bool) -> Piece:
        """The first or the second half."""
        middle = self.time_s.size // 2
        rows = slice(middle, None) if second else slice(None, middle)
        excluded = None if self.excluded is None else self.excluded[rows]
        return replace(
            self, time_s=self.time_s[rows], measured=self.measured[rows], excluded=excluded
        )

    @property
    def period_s(self) -> float:
        """Sampling period, s."""
        return float(self.time_s[-1] - self.time_s[0]) / (self.time_s.size - 1)


@dataclass(frozen=True, slots=True)
class TestedEffect:
    """An effect that may be missing.

    Attributes
    ----------
    name, amplitude
        Of the catalogue; its parameter that is zero when the effect is absent.
    freedom
        Parameters that vanish from the model with the effect: degrees of freedom of its test.
    same_as
        Effects that are the same law in this comparison, only named for another place.
    contains
        A simpler effect that this one holds as a special case, and replaces.
    not_negative
        The amplitude has a sign: friction brakes.
    at_most
        Largest amplitude that makes sense, of one without a unit.
    acts_above
        It is seen in pieces that the answer does not show.
    is_plain
        Linear in one amplitude, without a shape to be found, and no special case of another.
    """

    name: str
    amplitude: str
    freedom: int = 1
    same_as: tuple[str, ...] = ()
    contains: str | None = None
    not_negative: bool = False
    at_most: float = math.inf
    acts_above: bool = False
    is_plain: bool = False

    def is_physical(self, amplitude: float) -> bool:
        """Whether it can have this size."""
        return amplitude <= self.at_most and (amplitude >= 0.0 or not self.not_negative)


@dataclass(frozen=True, slots=True)
class EffectsFit:
    """Least squares with a set of effects in the bench.

    Attributes
    ----------
    effects
        Catalogue name to its parameters, units as in the catalogue.
    bench
        Declared unknown bench parameters, fitted.
    predictions
        For every piece, shape (n,), in the unit of its channel.
    columns
        For every used piece, ∂prediction/∂parameter at the samples that count, shape (k, p).
    names
        The p parameters: ``effect.parameter``, a bench parameter, or a nuisance (start, offset,
        phase) with the recording's name behind ``@``.
    trials
        Effect to the number of independent shapes that were tried to find it.
    at_edge
        Effects with a parameter at the end of its range: not an optimum, so not to be believed.
    shared
        Shapes that belong to no single effect.
    besides
        What else is linear (start, offset, a torque that is being learned), by name.
    """

    effects: Mapping[str, Mapping[str, float]]
    bench: Mapping[str, float]
    predictions: tuple[FloatArray, ...]
    columns: tuple[FloatArray, ...]
    names: tuple[str, ...]
    trials: Mapping[str, float] = field(default_factory=dict)
    at_edge: frozenset[str] = frozenset()
    shared: Mapping[str, float] = field(default_factory=dict)
    besides: Mapping[str, float] = field(default_factory=dict)


class Comparison(Protocol):
    """Recordings and a bench, ready to be fitted with any effects."""

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Everything compared, in the order of a fit's predictions."""

    @property
    def candidates(self) -> tuple[TestedEffect, ...]:
        """Effects that these recordings can show."""

    def fit(self, effects: tuple[str, ...], start: EffectsFit | None) -> EffectsFit:
        """Fit on the used pieces; what ``start`` has found is where the search starts."""

    def folds(self) -> Sequence[Comparison]:
        """The used pieces alone, some to fit on and some to predict, each predicted once."""


class Learning(Protocol):
    """A torque of no known law, found in what a fit leaves."""

    @property
    def comparison(self) -> Comparison:
        """With the torque in it, as free as it is told."""

    @property
    def held(self) -> Comparison:
        """With the torque as it was found: effects are named again beside it."""

    @property
    def same(self) -> EffectsFit | None:
        """A fit with the names as they were, where they cannot be found again beside it."""

    @property
    def as_found(self) -> Learning | None:
        """Where names stay as they were, to be taken if those found again leave more."""

    def answer(self, fit: EffectsFit) -> LearnedAnswer | None:
        """What is told of the torque beside what this fit names; ``None`` if none is needed."""

    def notes(self, fit: EffectsFit) -> tuple[str, ...]:
        """Sentences on what could be behind it."""

    def bench(self, fit: EffectsFit) -> Bench | None:
        """The bench with the torque and what is named, if a bench file can hold it."""


def residuals_of_pieces(
    comparison: Comparison, before: EffectsFit, after: EffectsFit
) -> list[PieceResiduals]:
    """Of every piece, at the samples that count."""
    return [
        piece_residuals(
            piece.name,
            piece.channel,
            piece.use,
            piece.kept(piece.measured - first),
            piece.kept(piece.measured - last),
            white=piece.white,
        )
        for piece, first, last in zip(
            comparison.pieces, before.predictions, after.predictions, strict=True
        )
        if piece.shown
    ]


def residuals(comparison: Comparison, fit: EffectsFit, use: Use) -> list[FloatArray]:
    """Measured less predicted at the samples that count, for the pieces of one use."""
    return [
        piece.kept(piece.measured - prediction)
        for piece, prediction in zip(comparison.pieces, fit.predictions, strict=True)
        if piece.use == use
    ]


def sum_of_squares(parts: list[FloatArray]) -> float:
    """Over all pieces."""
    return float(sum(np.dot(part, part) for part in parts))


def shown_squares(comparison: Comparison, fit: EffectsFit) -> float:
    """Of what a fit leaves of the used pieces that the answer shows."""
    return sum(
        float(np.sum(piece.kept(piece.measured - prediction) ** 2))
        for piece, prediction in zip(comparison.pieces, fit.predictions, strict=True)
        if piece.use == "used" and piece.shown
    )
