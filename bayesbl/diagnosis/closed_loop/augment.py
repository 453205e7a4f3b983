"""The bench with what was named in it, as a bench file holds it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.learned import LearnedTerm
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.signals import START_ANGLE
from bayesbl.model_search.refit import Explanation


def augmented_bench(explanation: Explanation) -> Bench:
    """Effects and corrected parameters of an explanation, with their standard deviations.

    A corrected parameter gets the fit's standard deviation as the standard deviation of a uniform
    tolerance. The phase of a periodic effect belongs to a recording, not to the bench: the first
    recording's is in the bench, ``simulate`` shifts it with the start.
    """
    fit = explanation.fit
    bench = fit.model.bench
    values: dict[str, float] = {}
    deviations: dict[str, float] = {}
    for i, unknown in enumerate(fit.model.unknowns):
        if unknown.name not in values:
            values[unknown.name] = float(unknown.value(fit.point[i]))
            scale = values[unknown.name] if unknown.logarithmic else 1.0
            deviations[unknown.name] = scale * float(np.sqrt(fit.covariance[i, i]))
    effects = tuple(_fitted(effect, values, deviations) for effect in bench.effects)
    corrected = {name: values[name] for name in values if name in bench.parameters}
    bench = bench.with_parameters(**corrected).with_effects(*effects)
    bench = bench.with_learned(*learned_terms(fit))
    parameters = dict(bench.parameters)
    for name in corrected:
        half = min(math.sqrt(3.0) * deviations[name], 0.5 * abs(values[name]))
        parameters[name] = replace(parameters[name], tolerance=half)
    return replace(bench, parameters=parameters)


def learned_terms(fit: SimulatedFit) -> list[LearnedTerm]:
    """What the bench has learned, at the optimum, with standard deviations."""
    places = {u.name: i for i, u in enumerate(fit.model.unknowns) if u.recording is None}
    spread = np.sqrt(np.diag(fit.covariance))
    values = {name: float(fit.point[i]) for name, i in places.items()}
    sds = {name: float(spread[i]) for name, i in places.items()}
    return [term.fitted(values, sds) for term in fit.model.bench.learned_terms]


def known_settings(explanation: Explanation) -> dict[str, float]:
    """Fitted values of what belongs to no bench file and to no single recording, as the gap."""
    fit = explanation.fit
    return {
        unknown.name: float(unknown.value(fit.point[i]))
        for i, unknown in enumerate(fit.model.unknowns)
        if unknown.recording is None
        and unknown.name != START_ANGLE
        and unknown.name not in fit.model.bench.parameters
        and "__" not in unknown.name
    }


def _fitted(
    effect: BenchEffect, values: dict[str, float], deviations: dict[str, float]
) -> BenchEffect:
    parameters = {}
    for name, given in effect.parameters.items():
        key = f"{effect.name}__{name}"
        if key in values:
            given = EffectParameterValue(values[key], deviations[key])
        parameters[name] = given
    return BenchEffect(effect.name, parameters)
