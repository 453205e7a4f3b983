"""Torques read through one factor, such as a torque constant, are all as uncertain as it is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from bayesbl.bench.effects import effect_named
from bayesbl.bench.parameters import PARAMETER_INFO
from bayesbl.diagnosis.diagnosis import Estimate, NamedEffect

TORQUES = ("N m", "kg")
"""Beginnings of the units of what is in proportion to a torque: coefficients and inertias too."""


def with_shared_scale(effect: NamedEffect, scale_sd: float) -> NamedEffect:
    """An effect with its torques as uncertain as the factor.

    ``scale_sd``: relative standard deviation of the factor, zero if it is known.
    """
    units = {p.name: p.unit for p in effect_named(effect.name).parameters}
    return replace(effect, parameters=_widened(effect.parameters, units, scale_sd))


def scaled_parameters(estimates: Mapping[str, Estimate], scale_sd: float) -> Mapping[str, Estimate]:
    """Parameters of the bench by name, the same way."""
    units = {name: PARAMETER_INFO[name].unit for name in estimates}
    return _widened(estimates, units, scale_sd)


def _widened(
    estimates: Mapping[str, Estimate], units: Mapping[str, str], scale_sd: float
) -> Mapping[str, Estimate]:
    return {
        name: replace(found, sd=math.hypot(found.sd, scale_sd * found.value))
        if units[name].startswith(TORQUES)
        else found
        for name, found in estimates.items()
    }
