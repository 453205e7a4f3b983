"""Bench parameters that a comparison fits: what no joint can have, and what the bench denies."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from bayesbl.bench.bench import Bench
from bayesbl.bench.parameters import PARAMETER_INFO
from bayesbl.diagnosis.diagnosis import Estimate, ParameterError

SURE_PARAMETER = 3.0
"""Standard deviations beyond which a value is told: three in a thousand by chance."""


def impossible(estimates: Mapping[str, Estimate]) -> Iterator[str]:
    """A sentence for each fitted parameter that no joint can have: then nothing is believed.

    Noise alone may carry a value below zero.
    """
    for name, found in estimates.items():
        info = PARAMETER_INFO[name]
        if info.positive and found.value + SURE_PARAMETER * found.sd <= 0.0:
            yield (
                f"The best fit with {name} free has {found.value:.3g} {info.unit} there, which "
                "nothing has: what the recordings show follows no law that was tried, so nothing "
                "is named. Faster motion shows the inertia, slow motion in both directions the "
                "friction."
            )


def parameter_errors(bench: Bench, estimates: Mapping[str, Estimate]) -> tuple[ParameterError, ...]:
    """Those that lie beyond their tolerance by more than their standard deviations explain."""
    found = []
    for name, fitted in estimates.items():
        believed = bench.parameters[name]
        value = math.exp(fitted.value) if fitted.logarithmic else fitted.value
        sd = value * fitted.sd if fitted.logarithmic else fitted.sd
        if abs(value - believed.value) - believed.tolerance > SURE_PARAMETER * sd:
            found.append(ParameterError(name, believed.value, believed.tolerance, fitted))
    return tuple(found)
