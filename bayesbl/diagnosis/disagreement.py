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
        log_variances, by_order = burg(residual, min(HIGHEST_ORDER, n // 20))
        order = int(np.argmin(bic(log_variances, n)))
        return cls(math.sqrt(float(residual @ residual) / n), by_order[order], residual)

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


class DisagreementSummary(TypedDict):
    """RMS of measurement minus simulation, in ``unit``; the unit ``noise`` is the noise floor.

    ``before`` is without what was named, ``after`` with it; declared unknowns are fitted in both.
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

    ``unit`` is that of all. If units differ, it is null, and ``over_all`` is in units of each noise
    floor.
    """

    unit: str | None
    recordings: dict[str, dict[str, dict[Use, DisagreementSummary]]]
    over_all: dict[Use, DisagreementSummary]


@dataclass(frozen=True, slots=True)
class ComparedPiece:
    """One channel of a recording, or of a part of it, beside its predictions.

    Attributes
    ----------
    use
        ``used``: effects were fitted on it. ``held_out``: only start, phases and offsets were.
    measured
        Shape (n,), the channel's unit; NaN where nothing was.
    before, after
        Predicted without and with what was named, as ``measured``.
    residual
        What is compared of measured less these, (2, n).
    noise_floor, noise_floor_from
        RMS of what does not follow from the recording's own past, and which past: the load rotation
        before, or the samples before.
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
        """With its noise floor.

        Parameters
        ----------
        residual
            As the attribute, where samples are left out.
        rotation
            Samples in a load rotation, of a recording that holds whole ones; ``None`` elsewhere.
        white
            Autocovariance, in samples, of white noise behind the filter that both sides passed.
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
    """Of some pieces together, each multiplied by its factor."""
    size = sum(piece.residual.shape[1] for piece, _ in parts)
    before, after = (
        sum(float(np.sum((factor * piece.residual[k]) ** 2)) for piece, factor in parts) / size
        for k in range(2)
    )
    floor = sum(p.residual.shape[1] * (factor * p.noise_floor) ** 2 for p, factor in parts) / size
    independent = sum(piece.residual.shape[1] / _inflation(piece.residual[1]) for piece, _ in parts)
    excess = before - floor
    # Of a mean square of noise, taken twice, and of its product with the misfit.
    error = math.sqrt((4.0 * floor**2 + 4.0 * max(excess, 0.0) * floor) / independent)
    return {
        "before": math.sqrt(before),
        "after": math.sqrt(after),
        "noise_floor": math.sqrt(floor),
        "closed_fraction": 1.0 - (after - floor) / excess if excess > SURE_EXCESS * error else None,
        "unit": unit,
    }


def _inflation(residual: FloatArray) -> float:
    """1 + 2 Σ ρ_k²: by how much correlation lowers the number of independent squares."""
    centred = residual - residual.mean()
    lags = min(CORRELATION_LAGS, centred.size // 4)
    power = float(centred @ centred)
    if power <= 0.0:
        return 1.0
    rho = np.array([float(centred[k:] @ centred[: centred.size - k]) for k in range(1, lags)])
    return 1.0 + 2.0 * float(np.sum((rho / power) ** 2))
