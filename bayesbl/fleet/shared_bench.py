"""Gaps measured one by one, paired through the bench that they share.

Each recording of a joint is matched with the bench by itself, so its gap rests on its own draws of
what is not known of the bench; but the bench is one for all. In coordinates z in which the prior of
that is standard normal, with m and S mean and covariance of one recording's draws,

    likelihood of recording i:   N(z; S⁻¹m / Λ, Λ⁻¹),   Λ = S⁻¹ − 1
    all of them:                 precision 1 + Σ Λ,      mean (1 + Σ Λ)⁻¹ Σ S⁻¹m

and ln δ of a recording is linear in z, with what z leaves resampled from the recording's own
draws. One z is drawn for all recordings, so that the bench cancels in a change as it does where
they are matched together.
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
"""Share of the prior's variance below which a recording says where a direction of z lies: half of
it leaves the other half of what is compared to the prior, which all recordings have in common."""

BEYOND_CHANCE = 3.0
"""Standard deviations of a variance of finite draws."""

_EDGE = 1e-4
"""Shares of a flat prior beyond which draws count as at its edge (3.7 standard deviations)."""


def as_normal(
    unknowns: Sequence[Unknown], draws: Sequence[FloatArray], joint: JointNormal | None
) -> FloatArray:
    """Draws of values in coordinates whose prior is standard normal, shape (unknown, draw).

    ``joint``: the prior that some of the unknowns have together.
    """
    normals = np.array([_alone(u, values) for u, values in zip(unknowns, draws, strict=True)])
    if joint is None:
        return normals
    shared = [row for row, unknown in enumerate(unknowns) if unknown.name in joint.names]
    sd = np.array([unknowns[row].sd for row in shared])
    whitening = joint.whitening([unknowns[row].name for row in shared])
    normals[shared] = whitening @ (sd[:, None] * normals[shared])
    return normals


def _alone(unknown: Unknown, values: FloatArray) -> FloatArray:
    """Draws of one unknown where its own prior is standard normal, whatever others share it."""
    coordinate = np.log(values) if unknown.logarithmic else values
    if np.isfinite(unknown.sd):
        return np.asarray((coordinate - unknown.centre) / unknown.sd)
    share = (coordinate - unknown.low) / (unknown.high - unknown.low)
    return np.asarray(ndtri(np.clip(share, _EDGE, 1.0 - _EDGE)))


@dataclass(frozen=True)
class MatchedAlone:
    """One recording's posterior: ``gap_rad`` shape (draw,), ``bench`` shape (unknown, draw)."""

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
        """Λ and S⁻¹m in the directions in which S is narrower than the prior beyond chance.

        What finite draws scatter by would add up over the recordings of a joint to knowledge that
        none of them has.
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
    """Mean and covariance of z by all these recordings; the prior's where there are none."""
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
    """Recordings that need another bench than the others do, and in what they differ most.

    With z of the others N(μ, V), the mean of a recording's draws is normal with mean (1 − S) μ and
    covariance (1 − S) V (1 − S) + S − S²; compared in the directions that it has learnt.

    Parameters
    ----------
    names
        Of what is not known of the bench.

    Returns
    -------
    Number of the recording to names, the largest difference first.
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
    """What the recording's mean differs by from what the others say, and the covariance of that."""
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
