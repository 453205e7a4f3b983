"""Which local optimum is the ringing, where the sum of squares alone may be wrong.

Pulses close to the noise can fit almost as well, and sometimes better, exchanged and half a ringing
off. A sweep knows which frequency and decay belong to each amplitude; as a prior on both this
separates the optima. Within the chosen optimum A stays the least-squares amplitude that the curve
means.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesbl.curve.gap_curve import GapCurve, Ringing
from bayesbl.ringing.estimator import Estimator, PointEstimate
from bayesbl.ringing.optimum import promoted
from bayesbl.ringing.symbols import AMPLITUDE
from bayesbl.sampling.convergence import Contender

LARGEST_DEFICIT = 15.0
"""Log likelihood below the optimum's at which a rival is no longer considered."""


def likeliest_branch(curve: GapCurve, estimator: Estimator, point: PointEstimate) -> PointEstimate:
    """The optimum, or the rival that is likelier with the curve's frequency and decay.

    The evidence of each is its likelihood times the density of its (ln ω, ln τ) under the curve's
    at its amplitude, spread by the fit's covariance, the start angle's scatter and the bench's.
    A curve without ringing keeps the optimum as it is.
    """
    ringing = curve.ringing
    if ringing is None:
        return point
    weighed = [(_log_prior(curve, ringing, point), point)]
    for rival in point.optimum.rivals:
        excess = rival.sum_of_squares - point.optimum.sum_of_squares
        deficit = 0.5 * excess / point.spread.scale
        if deficit > LARGEST_DEFICIT:
            continue
        other = estimator.around(
            point.recording, point.objective, promoted(point.objective, point.optimum, rival)
        ).shaken(point.shaking)
        weighed.append((_log_prior(curve, ringing, other) - deficit, other))
    evidence, best = max(weighed, key=lambda pair: pair[0])
    contenders = tuple(
        Contender(other.optimum.symbols[AMPLITUDE], found - evidence)
        for found, other in weighed
        if other is not best
    )
    if best is point:
        return replace(point, contenders=contenders)
    note = (
        "The optimum of least RMSE does not ring like this bench at any gap. Another that does, "
        f"{100.0 * (best.optimum.rmse_rpm / point.optimum.rmse_rpm - 1.0):.2g} % larger in RMSE, "
        "was used instead."
    )
    notes = (*point.notes, note)
    return replace(
        best,
        notes=notes,
        start=point.start,
        contenders=contenders,
        mended=point.mended,
        lines=point.lines,
    )


def _log_prior(curve: GapCurve, ringing: Ringing, point: PointEstimate) -> float:
    """ln of the density of the measured (ln ω, ln τ) under the curve's at the measured A."""
    centre, covariance = point.ringing
    log_knots, x = np.log(curve.knots_rpm), float(np.log(centre[0]))
    nearest = int(np.argmin(np.abs(log_knots - x)))
    draws = np.stack([ringing.frequency_draws[:, nearest], ringing.decay_draws[:, nearest]])
    bench = np.cov(draws) if draws.shape[1] > 1 else np.zeros((2, 2))
    total = (covariance + ringing.scatter[nearest])[1:, 1:] + bench
    expected = np.array(
        [np.interp(x, log_knots, ringing.log_frequency), np.interp(x, log_knots, ringing.log_decay)]
    )
    # A fixed frequency or decay carries no information and has no variance.
    told = np.diag(covariance)[1:] > 0.0
    difference = (centre[1:] - expected)[told]
    total = total[np.ix_(told, told)]
    distance = difference @ np.linalg.solve(total, difference)
    return float(-0.5 * (distance + np.linalg.slogdet(total)[1]))
