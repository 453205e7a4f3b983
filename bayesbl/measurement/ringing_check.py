"""The ringing's frequency and decay beside those of the curve's bench at the same amplitude."""

from __future__ import annotations

import math

import numpy as np

from bayesbl.curve.gap_curve import GapCurve
from bayesbl.measurement.change import CONTRADICTED, Gap, MeasuredRinging
from bayesbl.measurement.joint_check import NOTHING_COMPARED, CheckItem, JointCheck
from bayesbl.measurement.same_joint import COULD_BE, DECAY, FREQUENCY

_UNITS = {FREQUENCY: ("Hz", 2.0 * math.pi), DECAY: ("1/s", 1.0)}
"""With what of it one is, in rad/s and 1/s."""


def ringing_check(curve: GapCurve, measured: MeasuredRinging, gap: Gap) -> JointCheck:
    """Frequency and decay at the measured amplitude; a curve without them compares nothing.

    The standard deviation is of the logarithms at that amplitude: of fit, start angle and the
    bench's tolerances.
    """
    ringing = curve.ringing
    if ringing is None:
        return NOTHING_COMPARED
    amplitude = measured.centre[0]
    nearest = int(np.argmin(np.abs(curve.knots_rpm - amplitude)))
    covariance = measured.covariance + ringing.scatter[nearest]
    given_amplitude = covariance - np.outer(covariance[0], covariance[0]) / covariance[0, 0]
    items = []
    for place, (quantity, expected, draws) in enumerate(
        (
            (FREQUENCY, ringing.log_frequency, ringing.frequency_draws),
            (DECAY, ringing.log_decay, ringing.decay_draws),
        ),
        start=1,
    ):
        if measured.covariance[place, place] == 0.0:
            continue  # a fixed one is no measurement
        unit, one = _UNITS[quantity]
        by_curve = float(np.interp(amplitude, curve.knots_rpm, expected))
        sd = math.sqrt(given_amplitude[place, place] + float(np.var(draws[:, nearest])))
        found = float(measured.centre[place])
        items.append(
            CheckItem(
                quantity,
                math.exp(found) / one,
                math.exp(by_curve) / one,
                unit,
                (found - by_curve) / sd,
            )
        )
    agrees = all(reason.code != CONTRADICTED for reason in gap.reasons)
    causes = [] if agrees else [cause for item in items for cause in COULD_BE[item.quantity]]
    return JointCheck(agrees, items, tuple(dict.fromkeys(causes)))
