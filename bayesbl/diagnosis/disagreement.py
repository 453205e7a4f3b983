"""How far bench and measurement lie apart, before naming and after, against the noise.

One definition for every method. The noise floor is the RMS of what does not follow from a
recording's own past: from one load rotation before where the recording holds whole rotations,
elsewhere from the samples just before. What repeats in every rotation is no noise for the first,
but is for the second where it cannot be predicted, so that the two are stored with where they are
from and are not to be compared. Behind a low pass even white noise follows from the samples before,
the more the denser they are: what the filter alone foretells is noise still.

Noise is autoregressive, from the residual of a fit. All of it counts, misfit included: what a bench
that is still wrong leaves blurs what it could show.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import uniform_filter1d

from bayesbl.noise.rotation_noise import (
    HIGHEST_ORDER,
    bic,
    burg,
    innovation_share,
    levinson,
    log_variances,
)
from bayesbl.recording.types import FloatArray
from bayesbl.units import unit_of

AROUND = 25
"""Samples: their mean square is good to 0.28 of itself where they are independent."""

_FREQUENCIES = np.linspace(0.0, math.pi, 2001)
"""rad per sample."""


@dataclass(frozen=True, slots=True)
class ResidualNoise:
    """Autoregressive noise in the unit of its channel; order by BIC over 0 to 15."""

    sd: float
    coefficients: FloatArray
    residual: FloatArray

    @classmethod
    def of(cls, residual: FloatArray) -> ResidualNoise:
        """Burg's estimate on a residual of shape (n,)."""
        n = residual.size
        fits = burg(residual, min(HIGHEST_ORDER, n // 20))
        order = int(np.argmin(bic(log_variances(fits), n)))
        return cls(math.sqrt(float(residual @ residual) / n), fits[order][1], residual)

    @property
    def innovation(self) -> float:
        """Standard deviation of what does not follow from the samples before."""
        return self.sd * math.sqrt(max(0.0, innovation_share(self.coefficients)))

    @property
    def strongest(self) -> float:
        """Standard deviation per sample at the frequency where the noise is strongest."""
        waves = np.exp(-1j * np.outer(_FREQUENCIES, np.arange(1, self.coefficients.size + 1)))
        return float(np.max(self.innovation / np.abs(1.0 - waves @ self.coefficients)))

    @property
    def local(self) -> FloatArray:
        """The same where the residual is as large as around each of its samples, (n,).

        What a bench leaves comes in bursts, where the axis starts, slips or turns round.
        """
        power = uniform_filter1d(self.residual**2, min(AROUND, self.residual.size), mode="nearest")
        power = np.maximum(power, 0.0)  # of its running sum rounding leaves less than none
        return np.asarray(self.strongest * np.sqrt(power) / max(self.sd, np.finfo(float).tiny))


Use = Literal["used", "held_out"]
FloorFrom = Literal["rotation", "samples"]

USES: tuple[Use, ...] = ("used", "held_out")

SURE_EXCESS = 10.0
"""Standard errors that the excess over the noise must have before a share of it is reported."""

CORRELATION_LAGS = 200


@dataclass(frozen=True, slots=True)
class PieceResiduals:
    """What the bench leaves of one channel of a recording, or of a part of it.

    Attributes
    ----------
    use
        ``used``: effects were fitted on it. ``held_out``: only start, phases and offsets were.
    before, after
        Measured less predicted without and with what was named, shape (n,), the channel's unit.
    noise_floor
        RMS of what does not follow from the recording's own past.
    noise_floor_from
        Which past: the load rotation before, or the samples before.
    """

    recording: str
    channel: str
    use: Use
    before: FloatArray
    after: FloatArray
    noise_floor: float
    noise_floor_from: FloorFrom


@dataclass(frozen=True, slots=True)
class Disagreement:
    """RMS between bench and measurement, in ``unit``; ``noise`` where over each noise floor.

    Attributes
    ----------
    before, after
        Without and with what was named; what was declared unknown is fitted in both.
    noise_floor
        RMS of what does not follow from the recording's own past.
    closed_fraction
        1 − (after² − floor²)/(before² − floor²); ``None`` where the excess before is not sure.
    """

    before: float
    after: float
    noise_floor: float
    closed_fraction: float | None
    unit: str


@dataclass(frozen=True, slots=True)
class PieceDisagreement(Disagreement):
    """That of one piece, and which past its noise floor is from."""

    recording: str
    channel: str
    use: Use
    noise_floor_from: FloorFrom


@dataclass(frozen=True, slots=True)
class DisagreementTable:
    """Of every piece, and of all pieces of each use together.

    ``unit`` is that of all values; ``None`` where every piece has its own, and ``overall`` is in
    units of each piece's noise floor.
    """

    pieces: tuple[PieceDisagreement, ...]
    overall: Mapping[Use, Disagreement]
    unit: str | None


def piece_residuals(
    recording: str,
    channel: str,
    use: Use,
    before: FloatArray,
    after: FloatArray,
    rotation: int | None = None,
    white: FloatArray | None = None,
) -> PieceResiduals:
    """Residuals with their noise floor.

    Parameters
    ----------
    rotation
        Samples in a load rotation, of a recording that holds whole ones; ``None`` elsewhere.
    white
        Autocovariance, in samples, of white noise behind the filter that the residuals passed.
    """
    if rotation is None:
        noise = ResidualNoise.of(after)
        floor = noise.innovation
        if white is not None:
            variance, _ = levinson(white, min(noise.coefficients.size, white.size - 1))[-1]
            floor = min(noise.sd, floor * math.sqrt(float(white[0]) / variance))
        return PieceResiduals(recording, channel, use, before, after, floor, "samples")
    difference = after[rotation:] - after[:-rotation]
    floor = math.sqrt(0.5 * float(np.mean(difference**2)))
    return PieceResiduals(recording, channel, use, before, after, floor, "rotation")


def disagreement_table(
    pieces: Sequence[PieceResiduals], *, in_units_of_noise: bool
) -> DisagreementTable:
    """Disagreement of each piece, and of all pieces of each use."""
    unit = None if in_units_of_noise else unit_of(pieces[0].channel)
    overall: dict[Use, Disagreement] = {}
    for use in USES:
        parts = [
            (piece, 1.0 / piece.noise_floor if in_units_of_noise else 1.0)
            for piece in pieces
            if piece.use == use
        ]
        if parts:
            overall[use] = disagreement_of(parts, unit or "noise")
    return DisagreementTable(tuple(map(_of_piece, pieces)), overall, unit)


def disagreement_of(parts: Sequence[tuple[PieceResiduals, float]], unit: str) -> Disagreement:
    """Of some pieces together, each multiplied by its factor."""
    size = sum(piece.after.size for piece, _ in parts)
    before = sum(_squares(factor * piece.before) for piece, factor in parts) / size
    after = sum(_squares(factor * piece.after) for piece, factor in parts) / size
    floor = sum(p.after.size * (factor * p.noise_floor) ** 2 for p, factor in parts) / size
    independent = sum(piece.after.size / _inflation(piece.after) for piece, _ in parts)
    excess = before - floor
    # Of a mean square of noise, taken twice, and of its product with the misfit.
    error = math.sqrt((4.0 * floor**2 + 4.0 * max(excess, 0.0) * floor) / independent)
    closed = 1.0 - (after - floor) / excess if excess > SURE_EXCESS * error else None
    return Disagreement(math.sqrt(before), math.sqrt(after), math.sqrt(floor), closed, unit)


def _of_piece(piece: PieceResiduals) -> PieceDisagreement:
    found = disagreement_of([(piece, 1.0)], unit_of(piece.channel))
    return PieceDisagreement(
        **asdict(found),
        recording=piece.recording,
        channel=piece.channel,
        use=piece.use,
        noise_floor_from=piece.noise_floor_from,
    )


def _squares(values: FloatArray) -> float:
    return float(values @ values)


def _inflation(residual: FloatArray) -> float:
    """1 + 2 Σ ρ_k²: by how much correlation lowers the number of independent squares."""
    centred = residual - residual.mean()
    lags = min(CORRELATION_LAGS, centred.size // 4)
    power = float(centred @ centred)
    if power <= 0.0:
        return 1.0
    rho = np.array([float(centred[k:] @ centred[: centred.size - k]) for k in range(1, lags)])
    return 1.0 + 2.0 * float(np.sum((rho / power) ** 2))
