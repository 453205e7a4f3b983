"""Pair gaps that were measured one by one, through the bench that they share.

Each recording of a joint is fitted by itself, with its own draws of the bench's unknowns, although
the bench is one for all. z are these unknowns in coordinates in which their prior is standard
normal; m and S are mean and covariance of one recording's draws:

    likelihood of recording i:   N(z; S⁻¹m / Λ, Λ⁻¹),   Λ = S⁻¹ − 1
    all of them:                 precision 1 + Σ Λ,      mean (1 + Σ Λ)⁻¹ Σ S⁻¹m

ln δ of a recording is linear in z; the rest is resampled from the recording's own draws. All
recordings share the drawn z, so the bench cancels in a change as it does in a joint fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtri

from bayesbl.bench.parameters import JointNormal
from bayesbl.matching.signals import SMALLEST_GAP_RAD, Unknown
from bayesbl.probabilities import FALSE_ALARM, chi2_sf
from bayesbl.recording.types import FloatArray

LEARNT = 0.5
"""Share of the prior's variance below which a recording determines a direction of z. At half, the
prior, which all recordings share, is half of what is compared."""

BEYOND_CHANCE = 3.0  # standard deviations of the variance of finitely many draws
_EDGE = 1e-4  # shares of a flat prior beyond which draws are at its edge (3.7 deviations)


def as_normal(
    unknowns: Sequence[Unknown], draws: Sequence[FloatArray], joint: JointNormal | None
) -> FloatArray:
    """Draws, (unknown, draw), made standard normal a priori; ``joint``: prior of several."""
    normals = np.array([_alone(u, values) for u, values in zip(unknowns, draws, strict=True)])
    if joint is None:
        return normals
    shared = [row for row, unknown in enumerate(unknowns) if unknown.name in joint.names]
    sd = np.array([unknowns[row].sd for row in shared])
    whitening = joint.whitening([unknowns[row].name for row in shared])
    normals[shared] = whitening @ (sd[:, None] * normals[shared])
    return normals


def _alone(unknown: Unknown, values: FloatArray) -> FloatArray:
    """Draws of an unknown in coordinates in which its own prior is standard normal."""
    coordinate = np.log(values) if unknown.logarithmic else values
    if np.isfinite(unknown.sd):
        return np.asarray((coordinate - unknown.centre) / unknown.sd)
    share = (coordinate - unknown.low) / (unknown.high - unknown.low)
    return np.asarray(ndtri(np.clip(share, _EDGE, 1.0 - _EDGE)))


@dataclass(frozen=True)
class MatchedAlone:
    """Posterior of one recording: ``gap_rad``, (draw,), and ``bench``, (unknown, draw)."""

    gap_rad: FloatArray
    bench: FloatArray

    @cached_property
    def mean(self) -> FloatArray:
        """m."""
        return np.asarray(self.bench.mean(axis=1))

    @cached_property
    def covariance(self) -> FloatArray:
        """S."""
        return np.atleast_2d(np.cov(self.bench))

    @cached_property
    def learnt(self) -> tuple[FloatArray, FloatArray]:
        """Λ and S⁻¹m in the directions in which S is significantly narrower than the prior.

        Otherwise the scatter of finitely many draws would add up over the recordings to false
        knowledge.
        """
        values, vectors = np.linalg.eigh(self.covariance)
        scatter = np.sqrt(2.0 / self.bench.shape[1])
        kept = vectors[:, values < 1.0 - BEYOND_CHANCE * scatter]
        inverse: FloatArray = np.asarray((kept / values[: kept.shape[1]]) @ kept.T, dtype=float)
        precision: FloatArray = inverse - kept @ kept.T
        return precision, np.asarray(inverse @ self.mean, dtype=float)

    def at(self, bench: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Draws of the gap on given benches, shape (draw,)."""
        log_gap = np.log(self.gap_rad + SMALLEST_GAP_RAD)
        columns = np.vstack([np.ones(log_gap.size), self.bench]).T
        line, *_ = np.linalg.lstsq(columns, log_gap, rcond=None)
        scatter = generator.choice(log_gap - columns @ line, bench.shape[1])
        gap_rad = np.exp(line[0] + line[1:] @ bench + scatter) - SMALLEST_GAP_RAD
        return np.asarray(np.maximum(gap_rad, 0.0))


def shared_bench(alone: Sequence[MatchedAlone]) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of z from all these recordings; those of the prior without any."""
    precision = np.eye(alone[0].mean.size) + sum(one.learnt[0] for one in alone)
    covariance = np.asarray(np.linalg.inv(precision), dtype=float)
    return np.asarray(covariance @ sum(one.learnt[1] for one in alone), dtype=float), covariance


def paired_gaps(
    alone: Sequence[MatchedAlone], draws: int, generator: np.random.Generator
) -> FloatArray:
    """Draws of all gaps on the same benches, shape (recording, draw)."""
    if alone[0].bench.shape[0] == 0:
        return np.stack([generator.choice(one.gap_rad, draws) for one in alone])
    mean, covariance = shared_bench(alone)
    bench = generator.multivariate_normal(mean, covariance, draws).T
    return np.stack([one.at(bench, generator) for one in alone])


def other_benches(alone: Sequence[MatchedAlone], names: Sequence[str]) -> dict[int, list[str]]:
    """Recordings that need another bench than the others, and what differs most.

    With z of the others N(μ, V), the mean of a recording's draws is normal with mean (1 − S) μ and
    covariance (1 − S) V (1 − S) + S − S². It is compared in the directions that the recording
    determines. Returns the unknowns (of these ``names``) by number of the recording, the largest
    difference first.
    """
    if len(alone) < 2 or not names:
        return {}
    outliers = {}
    for number, one in enumerate(alone):
        others = shared_bench([other for other in alone if other is not one])
        if _probability(one, others) < FALSE_ALARM / len(alone):
            difference, covariance = _difference(one, others)
            z = np.abs(difference) / np.sqrt(np.diag(covariance))
            outliers[number] = [names[i] for i in np.argsort(-z)[:2]]
    return outliers


def _difference(
    one: MatchedAlone, others: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """The recording's mean minus that expected from the others, and its covariance."""
    mean, covariance = others
    values, vectors = np.linalg.eigh(one.covariance)
    shares = np.minimum(values, 1.0)
    projection = (vectors * (1.0 - shares)) @ vectors.T
    # What finite draws scatter by comes on top of what the recording's noise does.
    own = (vectors * (shares * (1.0 - shares) + values / one.bench.shape[1])) @ vectors.T
    return one.mean - projection @ mean, projection @ covariance @ projection + own


def _probability(one: MatchedAlone, others: tuple[FloatArray, FloatArray]) -> float:
    values, vectors = np.linalg.eigh(one.covariance)
    learnt = vectors[:, values < LEARNT]
    if learnt.shape[1] == 0:
        return 1.0
    difference, covariance = _difference(one, others)
    along, spread = learnt.T @ difference, learnt.T @ covariance @ learnt
    return float(chi2_sf(along @ np.linalg.solve(spread, along), learnt.shape[1]))
