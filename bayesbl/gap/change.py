"""From draws of A to draws of δ, and from snapshots of δ to its change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesbl.gap.curve import CurveDraws, GapCurve
from bayesbl.recording.types import FloatArray

LARGEST_SHARE_OUTSIDE = 0.01


@dataclass(frozen=True, slots=True)
class Gap:
    """The gap of one snapshot.

    Attributes
    ----------
    delta_rad
        Draws of δ, shape (chain, draw), rad.
    outside
        −1, 0, +1 for draws of A below, inside, above the curve's range, shape (chain, draw).
    budget
        Share of the variance of ln δ by source; sums to 1.
    reason
        Why δ is withheld; ``None`` where it is not.
    """

    delta_rad: FloatArray
    outside: FloatArray
    budget: dict[str, float]
    reason: str | None


def gaps(
    curve: GapCurve,
    amplitudes_rpm: Sequence[FloatArray],
    seed: np.random.SeedSequence,
    *,
    allow_extrapolation: bool = False,
    level: float = 0.9,
) -> list[Gap]:
    """δ of every snapshot of one joint, all through the same draws of the curve.

    The prior is flat in ln δ: draws of A, which come with a flat prior in A, are resampled with
    the Jacobian d ln δ/dA as weight. Start-angle scatter is drawn per snapshot.

    Parameters
    ----------
    amplitudes_rpm
        Draws of A per snapshot, each of shape (chain, draw), rpm.
    level
        Of the one-sided bound that a withheld answer gives.
    """
    shared_seed, *own_seeds = seed.spawn(1 + len(amplitudes_rpm))
    count = amplitudes_rpm[0].size
    shared = curve.draw(count, np.random.default_rng(shared_seed))
    result = []
    for amplitude, own in zip(amplitudes_rpm, own_seeds, strict=True):
        generator = np.random.default_rng(own)
        weighted = resample(amplitude, curve.log_slope(amplitude), generator)
        sd = curve.start_angle_sd(weighted)
        scattered = weighted + sd * generator.standard_normal(weighted.shape)
        delta = shared.gap(scattered.ravel()).reshape(amplitude.shape)
        outside = curve.outside(scattered)
        result.append(
            Gap(
                delta,
                outside,
                _budget(curve, shared, weighted, sd, generator),
                None if allow_extrapolation else _extrapolation(curve, outside, delta, level),
            )
        )
    return result


def resample(
    draws: FloatArray, weights: FloatArray, generator: np.random.Generator
) -> FloatArray:
    """Systematic resampling within each chain, shape (chain, draw) kept, order nearly kept.

    Draws whose weights are all equal come back as they are.
    """
    result = np.empty_like(draws)
    count = draws.shape[1]
    for row, (values, weight) in enumerate(zip(draws, weights, strict=True)):
        total = weight.sum()
        if not total > 0.0:
            result[row] = values
            continue
        edges = np.cumsum(weight) * (count / total)
        ticks = np.arange(count) + generator.uniform()
        result[row] = values[np.minimum(np.searchsorted(edges, ticks), count - 1)]
    return result


def _extrapolation(
    curve: GapCurve, outside: FloatArray, delta_rad: FloatArray, level: float
) -> str | None:
    """Why an answer beyond the curve's range is withheld, with a bound in its place."""
    share = float(np.mean(outside != 0.0))
    if share < LARGEST_SHARE_OUTSIDE:
        return None
    low, high = curve.gap_range_rad
    if np.sum(outside > 0.0) >= np.sum(outside < 0.0):
        bound = min(float(np.quantile(delta_rad, 1.0 - level)), high)
        statement = f"δ is above {bound:.3g} rad with {level:.0%} probability"
    else:
        bound = max(float(np.quantile(delta_rad, level)), low)
        statement = f"δ is below {bound:.3g} rad with {level:.0%} probability"
    return (
        f"{share:.0%} of the posterior lies beyond the range of the gap curve "
        f"({low:.3g} to {high:.3g} rad). {statement}. Use a curve that reaches farther, or ask for "
        "extrapolation by [curve] allow_extrapolation = true."
    )


def _budget(
    curve: GapCurve,
    shared: CurveDraws,
    amplitude_rpm: FloatArray,
    start_angle_sd_rpm: FloatArray,
    generator: np.random.Generator,
) -> dict[str, float]:
    """Variance of ln δ with one source at work at a time, as shares of their sum."""
    flat = amplitude_rpm.ravel()
    middle = np.full_like(flat, np.median(flat))
    if middle[0] <= 0.0:
        return {}
    nudged = middle + start_angle_sd_rpm.ravel() * generator.standard_normal(flat.size)
    variances = {
        "noise": _log_variance(curve.gap(flat)),
        "start_angle": _log_variance(curve.gap(nudged)),
    }
    for name, coefficients in shared.coefficients.items():
        alone = CurveDraws(curve, {name: coefficients})
        variances[name] = _log_variance(alone.gap(middle))
    total = sum(variances.values())
    return {name: value / total if total else 0.0 for name, value in variances.items()}


def _log_variance(delta_rad: FloatArray) -> float:
    positive = delta_rad[delta_rad > 0.0]
    return float(np.var(np.log(positive))) if positive.size else 0.0


@dataclass(frozen=True, slots=True)
class Change:
    """Change of δ between two snapshots, draw by draw through the same curve.

    Attributes
    ----------
    first, last
        Names of the snapshots.
    change_rad
        δ_last − δ_first, shape (chain, draw), rad.
    """

    first: str
    last: str
    change_rad: FloatArray

    @property
    def probability_increase(self) -> float:
        """Share of draws in which δ grew."""
        return float(np.mean(self.change_rad > 0.0))


def changes(delta_rad: Mapping[str, FloatArray]) -> tuple[Change, list[Change]]:
    """The change from first to last snapshot, and every step between neighbours.

    Parameters
    ----------
    delta_rad
        Draws per snapshot name in order of time, each (chain, draw), paired by draw.
    """
    names = list(delta_rad)
    steps = [
        Change(a, b, delta_rad[b] - delta_rad[a]) for a, b in zip(names, names[1:], strict=False)
    ]
    first, last = names[0], names[-1]
    return Change(first, last, delta_rad[last] - delta_rad[first]), steps


def probability_above(delta_rad: FloatArray, limit_rad: float) -> float:
    """Share of draws with δ above a limit."""
    return float(np.mean(delta_rad > limit_rad))
