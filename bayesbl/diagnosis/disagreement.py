"""Disagreement of bench and measurement before and after naming, and the noise floor.

All methods share this definition. The noise floor is the RMS of what a recording's own past does
not predict: one load rotation earlier if the recording holds whole rotations, else the preceding
samples. Whatever repeats in every rotation is no noise by the first, but may be by the second, so
each floor is stored with its origin and the two are not compared. Behind a low pass, the preceding
samples predict even white noise, the better the denser they are. This part counts as noise.

Noise is autoregressive, estimated from the residual of a fit with its misfit, because the misfit
of a wrong bench hides other effects.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NotRequired, TypedDict

import numpy as np
from scipy import linalg
from scipy.ndimage import uniform_filter1d

from bayesbl.noise.rotation_noise import HIGHEST_ORDER, bic, burg, innovation_share
from bayesbl.recording.types import FloatArray
from bayesbl.units import unit_of

AROUND = 25
"""Samples in a local mean square. If independent, its relative error is 0.28."""

_FREQUENCIES = np.linspace(0.0, math.pi, 2001)
"""Frequencies, rad per sample."""


@dataclass(frozen=True, slots=True)
class ResidualNoise:
    """Autoregressive noise in the channel's unit; the order, 0 to 15, by BIC."""

    sd: float
    coefficients: FloatArray
    residual: FloatArray

    @classmethod
    def of(cls, residual: FloatArray) -> ResidualNoise:
        """Estimate by Burg's method from a residual of shape (n,)."""
        n = residual.size
        log_variances, by_order = burg(residual, min(HIGHEST_ORDER, n // 20))
        order = int(np.argmin(bic(log_variances, n)))
        return cls(math.sqrt(float(residual @ residual) / n), by_order[order], residual)

    @property
    def innovation(self) -> float:
        """Standard deviation of the prediction error from preceding samples."""
        return self.sd * math.sqrt(max(0.0, innovation_share(self.coefficients)))

    @property
    def strongest(self) -> float:
        """Standard deviation per sample at the frequency of strongest noise."""
        waves = np.exp(-1j * np.outer(_FREQUENCIES, np.arange(1, self.coefficients.size + 1)))
        return float(np.max(self.innovation / np.abs(1.0 - waves @ self.coefficients)))

    @property
    def local(self) -> FloatArray:
        """``strongest``, scaled by the local RMS of the residual at each sample, (n,).

        Residuals come in bursts, where the axis starts, slips or reverses.
        """
        power = uniform_filter1d(self.residual**2, min(AROUND, self.residual.size), mode="nearest")
        power = np.maximum(power, 0.0)  # rounding in the running sum
        return np.asarray(self.strongest * np.sqrt(power) / max(self.sd, np.finfo(float).tiny))


Use = Literal["used", "held_out"]
FloorFrom = Literal["rotation", "samples"]

USES: tuple[Use, ...] = ("used", "held_out")

SURE_EXCESS = 10.0
"""Standard errors of the excess over the noise from which its closed fraction is reported."""

CORRELATION_LAGS = 200


class DisagreementSummary(TypedDict):
    """RMS of measurement minus simulation, in ``unit``; the unit ``noise`` is the noise floor.

    The ``[unknowns]`` are fitted ``before`` and ``after`` naming.
    ``closed_fraction``: 1 − (after² − floor²)/(before² − floor²); null if noise may cause all of
    the disagreement before.
    """

    before: float
    after: float
    noise_floor: float
    closed_fraction: float | None
    unit: str
    noise_floor_from: NotRequired[FloorFrom]


class DisagreementTableSummary(TypedDict):
    """Disagreements by recording, channel and use; ``over_all`` by use alone.

    If units differ, ``unit`` is null, and ``over_all`` is in units of each noise floor.
    """

    unit: str | None
    recordings: dict[str, dict[str, dict[Use, DisagreementSummary]]]
    over_all: dict[Use, DisagreementSummary]


@dataclass(frozen=True, slots=True)
class ComparedPiece:
    """One channel of a recording, or of a part of it, with its predictions.

    Attributes
    ----------
    use
        ``used``: effects were fitted on it. ``held_out``: only start, phases and offsets were.
    measured
        Shape (n,), in the channel's unit; NaN for excluded samples.
    before, after
        Predictions without and with the named effects, as ``measured``.
    residual
        Residuals of both that are compared, (2, n).
    noise_floor, noise_floor_from
        RMS that the recording's own past does not predict, and which past: the load rotation, or
        the samples before.
    """

    recording: str
    channel: str
    use: Use
    time_s: FloatArray
    measured: FloatArray
    before: FloatArray
    after: FloatArray
    residual: FloatArray
    noise_floor: float
    noise_floor_from: FloorFrom

    @classmethod
    def of(
        cls,
        recording: str,
        channel: str,
        use: Use,
        time_s: FloatArray,
        measured: FloatArray,
        before: FloatArray,
        after: FloatArray,
        *,
        residual: FloatArray | None = None,
        rotation: int | None = None,
        white: FloatArray | None = None,
    ) -> ComparedPiece:
        """Make a piece and its noise floor.

        ``residual``: as the attribute, if samples are excluded; ``rotation``: samples in a load
        rotation if the recording holds whole ones; ``white``: autocovariance of white noise behind
        the comparison's filter, by lag in samples.
        """
        signals = time_s, measured, before, after
        residual = measured - np.stack([before, after]) if residual is None else residual
        if rotation is not None:
            difference = residual[1, rotation:] - residual[1, :-rotation]
            floor = math.sqrt(0.5 * float(np.mean(difference**2)))
            return cls(recording, channel, use, *signals, residual, floor, "rotation")
        noise = ResidualNoise.of(residual[1])
        floor = noise.innovation
        if white is not None:
            order = min(noise.coefficients.size, white.size - 1)
            past, present = linalg.toeplitz(white[:order]), white[1 : order + 1]
            unforeseen = white[0] - present @ np.linalg.lstsq(past, present)[0]
            floor = min(noise.sd, floor * math.sqrt(white[0] / max(unforeseen, 1e-300)))
        return cls(recording, channel, use, *signals, residual, floor, "samples")


def disagreement_table(pieces: Sequence[ComparedPiece]) -> DisagreementTableSummary:
    """Disagreement of each piece, and of all pieces of each use."""
    units = {unit_of(piece.channel) for piece in pieces}
    unit = units.pop() if len(units) == 1 else None
    recordings: dict[str, dict[str, dict[Use, DisagreementSummary]]] = {}
    for piece in pieces:
        own = _disagreement([(piece, 1.0)], unit_of(piece.channel))
        own["noise_floor_from"] = piece.noise_floor_from
        recordings.setdefault(piece.recording, {}).setdefault(piece.channel, {})[piece.use] = own
    over_all: dict[Use, DisagreementSummary] = {}
    for use in USES:
        some = [piece for piece in pieces if piece.use == use]
        parts = [(piece, 1.0 if unit else 1.0 / piece.noise_floor) for piece in some]
        if parts:
            over_all[use] = _disagreement(parts, unit or "noise")
    return {"unit": unit, "recordings": recordings, "over_all": over_all}


def _disagreement(parts: Sequence[tuple[ComparedPiece, float]], unit: str) -> DisagreementSummary:
    """Disagreement of some pieces together, each multiplied by its factor."""
    size = sum(piece.residual.shape[1] for piece, _ in parts)
    before, after = (
        sum(float(np.sum((factor * piece.residual[k]) ** 2)) for piece, factor in parts) / size
        for k in range(2)
    )
    floor = sum(p.residual.shape[1] * (factor * p.noise_floor) ** 2 for p, factor in parts) / size
    independent = sum(piece.residual.shape[1] / _inflation(piece.residual[1]) for piece, _ in parts)
    excess = before - floor
    # Errors of two mean squares of noise, and of the product of noise and misfit.
    error = math.sqrt((4.0 * floor**2 + 4.0 * max(excess, 0.0) * floor) / independent)
    return {
        "before": math.sqrt(before),
        "after": math.sqrt(after),
        "noise_floor": math.sqrt(floor),
        "closed_fraction": 1.0 - (after - floor) / excess if excess > SURE_EXCESS * error else None,
        "unit": unit,
    }


def _inflation(residual: FloatArray) -> float:
    """1 + 2 Σ ρ_k²: ratio of the numbers of all and of independent squares."""
    centred = residual - residual.mean()
    lags = min(CORRELATION_LAGS, centred.size // 4)
    power = float(centred @ centred)
    if power <= 0.0:
        return 1.0
    rho = np.array([float(centred[k:] @ centred[: centred.size - k]) for k in range(1, lags)])
    return 1.0 + 2.0 * float(np.sum((rho / power) ** 2))
