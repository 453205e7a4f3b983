"""What a diagnosis says, whatever the method: verdict, named effects, gaps before and after."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from bayesbl.diagnosis.comparison import Comparison, Fit, Piece, Use
from bayesbl.diagnosis.residual_noise import ResidualNoise
from bayesbl.recording.types import FloatArray

Verdict = Literal["nothing_missing", "named", "parameter_error", "unexplained"]

SURE_EXCESS = 10.0
"""Standard errors that the gap's excess over the noise must have before its share is told."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A fitted value; its standard deviation under the noise of the residual."""

    value: float
    sd: float


@dataclass(frozen=True, slots=True)
class NamedEffect:
    """An effect that is missing in the bench.

    Attributes
    ----------
    probability
        That it is there, given the others, at even odds beforehand (BIC approximation).
    z
        Amplitude over its standard deviation.
    indistinguishable_from
        Other effects that would explain these recordings as well.
    """

    name: str
    parameters: Mapping[str, Estimate]
    probability: float
    z: float
    indistinguishable_from: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ParameterError:
    """A bench parameter whose fitted value lies outside what the bench file allows."""

    name: str
    believed: float
    tolerance: float
    fitted: Estimate


@dataclass(frozen=True, slots=True)
class Remaining:
    """Something that repeats in what is left: its order of the motor's turning, and its size."""

    channel: str
    order: float
    amplitude: float
    chi_squared: float


@dataclass(frozen=True, slots=True)
class Gap:
    """RMS between simulation and measurement, in the channel's unit.

    Attributes
    ----------
    before, after
        Without and with the named effects; what was declared unknown is fitted in both.
    noise_floor
        RMS of what cannot be foretold from the samples before it: a lower bound of the noise.
    closed_fraction
        1 − (after² − floor²)/(before² − floor²); ``None`` where the excess before is not sure.
    """

    before: float
    after: float
    noise_floor: float
    closed_fraction: float | None


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The whole answer. ``gaps`` holds one for each piece, ``overall`` one for each use."""

    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    parameter_errors: tuple[ParameterError, ...]
    bench: Mapping[str, Estimate]
    remaining: tuple[Remaining, ...]
    gaps: tuple[tuple[Piece, Gap], ...]
    overall: Mapping[Use, Gap]
    notes: tuple[str, ...]
    before: Fit
    after: Fit


def verdict_of(
    effects: tuple[NamedEffect, ...],
    parameter_errors: tuple[ParameterError, ...],
    remaining: tuple[Remaining, ...],
) -> Verdict:
    """One word for it all."""
    if effects:
        return "named"
    if parameter_errors:
        return "parameter_error"
    return "unexplained" if remaining else "nothing_missing"


def gaps_of(
    comparison: Comparison, before: Fit, after: Fit
) -> tuple[tuple[tuple[Piece, Gap], ...], dict[Use, Gap]]:
    """Gap of each piece, and of all pieces of each use together."""
    parts = []
    for i, piece in enumerate(comparison.pieces):
        first = piece.kept(piece.measured - before.predictions[i])
        last = piece.kept(piece.measured - after.predictions[i])
        parts.append((piece, first, last, ResidualNoise.of(last)))
    single = tuple((piece, _gap([(a, b, noise)])) for piece, a, b, noise in parts)
    uses: tuple[Use, ...] = ("used", "held_out")
    overall = {
        use: _gap([(a, b, noise) for piece, a, b, noise in parts if piece.use == use])
        for use in uses
        if any(piece.use == use for piece, *_ in parts)
    }
    return single, overall


def _gap(parts: list[tuple[FloatArray, FloatArray, ResidualNoise]]) -> Gap:
    count = sum(a.size for a, _, _ in parts)
    before = sum(float(a @ a) for a, _, _ in parts) / count
    after = sum(float(b @ b) for _, b, _ in parts) / count
    floor = sum(b.size * noise.innovation**2 for _, b, noise in parts) / count
    independent = sum(noise.effective_samples(b.size) for _, b, noise in parts)
    excess = before - floor
    # Of a mean square of noise, and of its product with the misfit.
    error = math.sqrt((2.0 * floor**2 + 4.0 * max(excess, 0.0) * floor) / independent)
    sure = excess > SURE_EXCESS * error
    closed = 1.0 - (after - floor) / excess if sure else None
    return Gap(math.sqrt(before), math.sqrt(after), math.sqrt(floor), closed)
