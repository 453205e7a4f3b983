"""Effects in proportion to one size, fitted together: the smallest set of them that is adequate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import chi2

from bayesbl.diagnosis.comparison import Comparison, EffectsFit, TestedEffect, residuals
from bayesbl.diagnosis.residual_noise import ResidualNoise
from bayesbl.model_search.constants import ALIKE
from bayesbl.recording.types import FloatArray


def smallest_set(
    comparison: Comparison,
    every: EffectsFit,
    plain: list[TestedEffect],
    most: int,
    threshold: float,
) -> tuple[str, ...]:
    """Of the sets of plain effects, the smallest that the best set adds nothing to.

    Around the fit with all of them the problem is linear. The best set has the smallest residual of
    those in which every size is physical. With X the columns of a set and Z those that the best one
    has besides, cleared of X, s = Zᵀr of the set's residual r has covariance ZᵀΣZ, and sᵀ(ZᵀΣZ)⁻¹s
    is χ² if they are not there. Of several such sets that look alike the first in the catalogue.
    """
    sets = _plain_sets(comparison, every, plain, most)
    noises = [ResidualNoise.of(part) for part in residuals(comparison, every, "used")]
    ends = np.cumsum([part.shape[0] for part in every.columns])[:-1]

    def spread(values: FloatArray) -> FloatArray:
        """Columns times the noise's covariance, shape (p, p)."""
        pairs = zip(np.split(values, ends), noises, strict=True)
        return np.asarray(sum(part.T @ noise.covariance_times(part) for part, noise in pairs))

    best = min(sets, key=lambda made: made.squares)
    adequate: list[_PlainSet] = []
    for made in sets:
        if adequate and len(made.members) > len(adequate[0].members):
            break
        more = [best.columns[m] for m in best.members if m not in made.members]
        if not more:
            adequate.append(made)
            continue
        others = np.column_stack(more)
        kept = made.matrix
        if kept.shape[1]:
            others = others - kept @ np.linalg.lstsq(kept, others, rcond=1e-10)[0]
        noise = spread(others)
        rank = int(np.linalg.matrix_rank(noise, rtol=1e-10, hermitian=True))
        score = others.T @ made.left
        if rank == 0 or (
            chi2.sf(float(score @ np.linalg.pinv(noise, 1e-10, True) @ score), rank) > threshold
        ):
            adequate.append(made)
    nearest = min(adequate, key=lambda made: made.squares)
    for made in adequate:
        apart = made.left - nearest.left
        size = float(apart @ apart)
        if size == 0.0 or size < ALIKE * math.sqrt(float(spread(apart[:, None])[0, 0])):
            return tuple(plain[m].name for m in made.members)
    raise AssertionError("the nearest set is like itself")


@dataclass(frozen=True, slots=True)
class _PlainSet:
    """Least squares with some plain effects, by number, beside all else that is fitted.

    ``matrix``: columns of the fit, (n, p); ``columns``: those of every plain effect, by number;
    ``left``: residual, (n,).
    """

    members: tuple[int, ...]
    matrix: FloatArray
    columns: Sequence[FloatArray]
    left: FloatArray
    squares: float


def _plain_sets(
    comparison: Comparison, every: EffectsFit, plain: list[TestedEffect], most: int
) -> list[_PlainSet]:
    """All sets of at most so many effects in which every size is physical, small ones first."""
    places = [every.names.index(f"{c.name}.{c.amplitude}") for c in plain]
    matrix = np.vstack(every.columns)
    scale = np.sqrt((matrix**2).sum(axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    matrix = matrix / scale
    columns = [matrix[:, place] for place in places]
    target = np.concatenate(residuals(comparison, every, "used"))
    for c, place in zip(plain, places, strict=True):
        target = target + matrix[:, place] * scale[place] * every.effects[c.name][c.amplitude]
    # A shape that all share is held: beside nothing with that shape it would stand for anything.
    held = [every.names.index(name) for name in every.shared if name in every.names]
    common = [k for k in range(matrix.shape[1]) if k not in places and k not in held]
    found = []
    for size in range(min(most, len(plain)) + 1):
        for members in combinations(range(len(plain)), size):
            kept = matrix[:, common + [places[m] for m in members]]
            fitted = np.linalg.lstsq(kept, target, rcond=1e-10)[0] if kept.shape[1] else np.zeros(0)
            values = zip(members, fitted[len(common) :], strict=True)
            if all(plain[m].is_physical(value / scale[places[m]]) for m, value in values):
                left = target - kept @ fitted
                found.append(_PlainSet(members, kept, columns, left, float(left @ left)))
    return found
