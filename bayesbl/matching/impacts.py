"""Impacts that are not alike in all rotations, and what that does to the gap.

A recorder's noise is the same at an impact and between two. Noise that goes round in the speed loop
moves the motor, so the load meets a flank a little earlier or harder than the last time, and other
axes do as much: each rotation then has a best gap of its own. Two things follow.

The rotations' gaps scatter by more than the noise leaves them. With r_i the whitened residual of
rotation i, J_i its derivative, u_i = J_iᵀr_i, C the posterior covariance and a the row of C that is
the gap's,

    Q = Σ (aᵀ(u_i − ū))²/(mean of |J_i a|²)

is χ² with ν degrees of freedom, the rotations of a recording less one, if all its noise is the
recorder's; else v times that. What v is to be expected is simulated
(:mod:`bayesbl.matching.loop_noise`). The draws are then widened as if all noise of the recording
had v times its variance: x + √(v − 1) C(JᵀJ)^½ ξ, ξ standard normal. What a prior knows stays as
sharp as it is.

And the mean rotation has the ringing of none of them: it is smeared, by however many they are. How
far that moves δ is simulated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.loop_noise import loop_noise, turns_of
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
    """How the gaps of a recording's rotations, or of a motion's cycles, scatter.

    Attributes
    ----------
    square
        Q.
    freedom
        ν.
    expected
        v by simulation, all values as likely, shape (k,).
    """

    square: float
    freedom: int
    expected: FloatArray

    @classmethod
    def of(cls, fit: SimulatedFit, place: int, along: FloatArray, residual: FloatArray) -> Scatter:
        """``along``: J_i a, ``residual``: r_i of the rotations, (r, c lag) each."""
        power = np.sum(along**2, axis=1)
        # A rotation that was lost says nothing.
        whole = power > 0.5 * np.median(power)
        if not whole.any():  # nothing of the gap is seen
            return cls(0.0, 0, np.ones(1))
        scores = np.sum(residual[whole] * along[whole], axis=1)
        square = float(np.sum((scores - scores.mean()) ** 2) / np.mean(power[whole]))
        loop = loop_noise(fit, place)
        expected = np.ones(1) if loop is None else loop.factors(along)
        return cls(square, int(whole.sum()) - 1, expected)

    def factors(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draws of v, shape (count,).

        Before Q is seen it is what is expected, but for a chance of ``SURPRISE``; then that is a
        share of it, which may be anything between 0 and 1. Where nothing repeats it is what is
        expected.
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


def scatters(fit: SimulatedFit, covariance: FloatArray) -> list[tuple[Scatter, FloatArray]]:
    """Of each recording, with its JᵀJ, (d, d); ``covariance``: C, (d, d)."""
    found = []
    for place, (residual, derivatives) in enumerate(_by_rotation(fit, fit.derivatives())):
        along = derivatives @ covariance[_gap(fit.model, place)]
        information = np.einsum("rnd,rne->de", derivatives, derivatives)
        found.append((Scatter.of(fit, place, along, residual), information))
    return found


def scattered(
    fit: SimulatedFit, draws: FloatArray, covariance: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Draws, shape (m, d), with what rotations scatter by beyond the recorder's noise.

    ``covariance``: C, (d, d), of the draws.
    """
    wider = draws.copy()
    for scatter, information in scatters(fit, covariance):
        values, vectors = np.linalg.eigh(information)
        root = vectors * np.sqrt(np.clip(values, 0.0, None))
        moves = rng.standard_normal(draws.shape) @ root.T @ covariance
        wider += np.sqrt(scatter.factors(len(draws), rng) - 1.0)[:, None] * moves
    return wider


def smeared(fit: SimulatedFit) -> FloatArray:
    """By how much ln δ of each recording is wrong as its impacts come early and late, (recording,).

    With j the derivative by the start angle above load order ``IMPACTS_ABOVE`` around an impact and
    c_i = jᵀr_i/jᵀj its place in rotation i, s² is what the places scatter by beyond noise, in the
    mean of both impacts. The mean of two simulations, s to either side, less the one between is
    what smeared ringing lacks. Motions are not looked at. The start angle of every other recording
    must be among the unknowns; NaN where one of the two cannot be simulated.
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
