"""Whether effects predict: pieces that were fitted, each from a fit on the others."""

from __future__ import annotations

import math

import numpy as np

from bayesbl.diagnosis.comparison import Comparison, EffectsFit, TestedEffect, residuals
from bayesbl.diagnosis.residual_noise import ResidualNoise
from bayesbl.recording.types import FloatArray

BETTER = 2.0
"""Standard errors by which pieces must be predicted better."""


class Folds:
    """Prediction of used pieces from fits on the others; each fit's made once."""

    def __init__(self, comparison: Comparison) -> None:
        self._folds = comparison.folds()
        self._left: dict[int, tuple[EffectsFit, list[list[FloatArray]]]] = {}

    def predicts(self, old: EffectsFit, new: EffectsFit, candidate: TestedEffect) -> bool:
        """Whether they are predicted surely better with the new effects.

        ‖r_old‖² − ‖r_new‖² with r_old = r_new + d varies by 2√(dᵀΣd) under the noise. Pieces that
        the answer does not show count only for what acts there, and both kinds in units of their
        mean square: what the noisier ones gain does not pay for what the quieter ones lose.
        """
        bands: dict[bool, list[tuple[FloatArray, FloatArray]]] = {True: [], False: []}
        for fold, first, last in zip(
            self._folds, self._residuals(old), self._residuals(new), strict=True
        ):
            predicted = [piece for piece in fold.pieces if piece.use == "held_out"]
            for piece, a, b in zip(predicted, first, last, strict=True):
                if piece.shown or candidate.acts_above:
                    bands[piece.shown].append((a, b))
        gain = spread = 0.0
        for pairs in filter(None, bands.values()):
            unit = float(np.mean(np.concatenate([b for _, b in pairs]) ** 2))
            for a, b in pairs if unit > 0.0 else ():
                d = a - b
                gain += float(a @ a - b @ b) / unit
                spread += float(d @ ResidualNoise.of(b).covariance_times(d)) / unit**2
        return spread > 0.0 and gain > BETTER * 2.0 * math.sqrt(spread)

    def _residuals(self, fit: EffectsFit) -> list[list[FloatArray]]:
        if id(fit) not in self._left:
            made = [
                residuals(fold, fold.fit(tuple(fit.effects), fit), "held_out")
                for fold in self._folds
            ]
            self._left[id(fit)] = fit, made
        return self._left[id(fit)][1]
