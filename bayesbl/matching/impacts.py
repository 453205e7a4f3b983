"""Impacts that are not alike in all rotations, and what that does to the gap.

A recorder's noise is the same at an impact and between two. Noise that goes round in the speed loop
moves the motor, so the load meets a flank a little earlier or harder than the last time, and other
axes do as much: each rotation then has a best gap of its own. Two things follow.

The rotations' gaps scatter by more than the noise leaves them. With r_i the whitened residual of
rotation i, J_i its derivative, u_i = J_iᵀr_i, C the posterior covariance and a the row of C that is
the gap's,

    Q = Σ (aᵀ(u_i − ū))²/(mean of |J_i a|²)

is χ² with ν degrees of freedom, the rotations less one of each recording, if all noise is the
recorder's; else v times that. What v is to be expected is simulated
(:mod:`bayesbl.matching.loop_noise`). As in a sandwich covariance with rotations for clusters, a
draw x becomes x + √((v − 1) ν/Q) Σ ξ_i C(u_i − ū) with ξ standard normal: the gap's variance is
then v times what it was, and what scatters with the gap goes along.

And the mean rotation has the ringing of none of them: it is smeared, by however many they are. How
far that moves δ is simulated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.loop_noise import impact_factors, turns_of
from bayesbl.matching.signals import GAP, START_ANGLE, SimulatedSignals
from bayesbl.recording.types import FloatArray

IMPACTS_ABOVE = 8
"""Load order above which the ringing is: slower parts of the derivative are gravity's."""

BETWEEN_IMPACTS = 8
"""Share of a rotation that is quiet between two impacts, one over it."""

SURPRISE = 0.2
"""Chance that rotations scatter by more than is expected. A judgement: with one of two, intervals
of three rotations without any such scatter are a sixth wider, with one of five a twentieth."""

SHARES = 1000
"""Places between 0 and 1 that a share is drawn from."""

IMPACTS_DIFFER = (
    "The load does not change flanks at the same angle in each rotation, as where another axis "
    "moves or the speed varies. Simulated rotations are all alike, so δ cannot be read by them. "
    "Record again with all other axes at rest, at constant speed."
)


@dataclass(frozen=True, slots=True)
class Scatter:
    """How the gaps of rotations, or of a motion's cycles, scatter.

    Attributes
    ----------
    square
        Q.
    freedom
        ν.
    moves
        C(u_i − ū)√(n/(n − 1)), n the rotations of the recording, shape (rotation, d).
    expected
        v by simulation, all values as likely, shape (k,).
    """

    square: float
    freedom: int
    moves: FloatArray
    expected: FloatArray

    @classmethod
    def of(cls, fit: SimulatedFit, covariance: FloatArray) -> Scatter:
        """With the posterior covariance C, shape (d, d)."""
        parts = [
            _of_recording(fit, place, residual, derivatives, covariance)
            for place, (residual, derivatives) in enumerate(_by_rotation(fit, fit.derivatives()))
            if len(residual)
        ]
        square, freedom = sum(p.square for p in parts), sum(p.freedom for p in parts)
        as_expected = math.sqrt(freedom / square) if square > 0.0 else 1.0
        moves = [p.moves * (as_expected if p.freedom else 1.0) for p in parts]
        expected = np.broadcast_arrays(*(p.expected for p in parts))
        return cls(square, freedom, np.concatenate(moves), np.mean(expected, axis=0))

    def factors(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draws of v, shape (count,).

        Before Q is seen it is what is expected, but for a chance of ``SURPRISE``; then that is a
        share of it, which may be anything between 0 and 1.
        """
        share = np.concatenate(([1.0], (np.arange(SHARES) + 0.5) / SHARES))
        prior = np.concatenate(([1.0 - SURPRISE], np.full(SHARES, SURPRISE / SHARES)))
        if self.freedom == 0:
            share, prior = share[:1], prior[:1]
        values = (self.expected[:, None] / share).ravel()
        weight = np.log(np.tile(prior, self.expected.size))
        weight -= 0.5 * self.freedom * np.log(values) + 0.5 * self.square / values
        weight = np.exp(weight - weight.max())
        return rng.choice(values, count, p=weight / weight.sum())

    def widened(self, draws: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draws, shape (m, d), with what rotations scatter by beyond the recorder's noise."""
        factors = self.factors(len(draws), rng)
        weights = rng.standard_normal((len(draws), len(self.moves)))
        return np.asarray(draws + np.sqrt(factors - 1.0)[:, None] * (weights @ self.moves))


def _of_recording(
    fit: SimulatedFit,
    place: int,
    residual: FloatArray,
    derivatives: FloatArray,
    covariance: FloatArray,
) -> Scatter:
    """Of one recording, its moves as they are."""
    gap = covariance[_gap(fit.model, place)]
    along = derivatives @ gap
    expected = impact_factors(fit, place, along)
    count = len(residual)
    if count == 1:
        # Nothing repeats: a score like any that noise makes.
        scores = np.linalg.qr(derivatives[0], mode="r")
        return Scatter(0.0, 0, scores @ covariance, expected)
    scores = np.einsum("rn,rnd->rd", residual, derivatives)
    scores -= scores.mean(axis=0)
    by_noise = float(np.mean(np.sum(along**2, axis=1)))
    moves = scores @ covariance * math.sqrt(count / (count - 1))
    return Scatter(float(np.sum((scores @ gap) ** 2)) / by_noise, count - 1, moves, expected)


def smeared(fit: SimulatedFit) -> FloatArray:
    """By how much ln δ of each recording is wrong as its impacts come early and late, (recording,).

    With j the derivative by the start angle above load order ``IMPACTS_ABOVE`` around an impact and
    c_i = jᵀr_i/jᵀj its place in rotation i, s² is what the places scatter by beyond noise, in the
    mean of both impacts. The mean of two simulations, s to either side, less the one between is
    what smeared ringing lacks. Motions are not looked at.
    """
    model = fit.model
    found = np.zeros(len(model.recordings))
    if all(seen.motion is not None for seen in model.recordings):
        return found
    derivatives = fit.derivatives()
    whole = model.by_recording(fit.residual)
    for place, (residual, slopes) in enumerate(_by_rotation(fit, derivatives)):
        seen = model.recordings[place]
        if seen.motion is not None or len(residual) < 2:
            continue
        angle = model.index(START_ANGLE, seen.name)
        beside = np.repeat(fit.point[None], 2, axis=0)
        beside[:, angle] += np.array([-1.0, 1.0]) * _places_sd(
            residual, slopes[..., angle], len(seen.signals)
        )
        lacks = whole[place].ravel() - model.whitened_of(beside, place).mean(axis=0)
        own = np.stack([model.by_recording(column)[place].ravel() for column in derivatives.T])
        found[place] = fit.covariance[_gap(model, place)] @ (own @ lacks)
    return found


def _places_sd(residual: FloatArray, slopes: FloatArray, channels: int) -> float:
    """s, rad at the load, of the impacts of rotations, (r, c lag) each."""
    spectrum = np.fft.rfft(slopes.mean(axis=0).reshape(channels, -1))
    spectrum[:, : IMPACTS_ABOVE + 1] = 0.0
    lag = slopes.shape[1] // channels
    fast = np.fft.irfft(spectrum, lag)
    half, window = lag // 2, lag // BETWEEN_IMPACTS
    around = np.convolve(np.tile(np.sum(fast**2, axis=0), 2), np.ones(window), "valid")
    # Each half of a rotation has one impact, and begins and ends where it is quietest.
    begin = int(np.argmin(around[:half] + around[half : 2 * half])) + window // 2
    fast = np.roll(fast, -begin, axis=1)
    turns = np.roll(residual.reshape(len(residual), channels, lag), -begin, axis=2)
    beyond = 0.0
    for own in (slice(0, half), slice(half, lag)):
        weight = float(np.sum(fast[:, own] ** 2))
        if weight > 0.0:
            places = np.einsum("rcn,cn->r", turns[:, :, own], fast[:, own]) / weight
            beyond += 0.5 * (float(places.var(ddof=1)) - 1.0 / weight)
    return math.sqrt(max(beyond, 0.0))


def _gap(model: SimulatedSignals, place: int) -> int:
    """Index of a recording's δ: its own, or that of all."""
    name = model.recordings[place].name
    own = [k for k, u in enumerate(model.unknowns) if u.name == GAP and u.recording == name]
    return own[0] if own else model.index(GAP)


def _by_rotation(
    fit: SimulatedFit, derivatives: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Whitened residuals and derivatives of each recording's rotations, (r, c lag) and (…, d)."""
    model = fit.model
    rows = [model.by_recording(row) for row in (fit.residual, *derivatives.T)]
    for place, seen in enumerate(model.recordings):
        residual, *columns = (turns_of(row[place], seen) for row in rows)
        yield residual, np.stack(columns, axis=-1)
