"""The bench with what was named in it, as a bench file holds it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.learned_torque import LEARNED_TORQUE, LearnedTorque
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.signals import START_ANGLE
from bayesbl.naming.explanation import Explanation


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
    if bench.learned_torque is not None:
        bench = replace(bench, learned_torque=torque_of(fit))
    parameters = dict(bench.parameters)
    for name in corrected:
        half = min(math.sqrt(3.0) * deviations[name], 0.5 * abs(values[name]))
        parameters[name] = replace(parameters[name], tolerance=half)
    return replace(bench, parameters=parameters)


def torque_of(fit: SimulatedFit) -> LearnedTorque:
    """The learned torque at the optimum, with standard deviations."""
    learned = fit.model.bench.learned_torque
    assert learned is not None
    places = {u.name: i for i, u in enumerate(fit.model.unknowns) if u.recording is None}
    spread = np.sqrt(np.diag(fit.covariance))
    values = [
        float(fit.point[places[name]]) if name in places else known
        for name, known in zip(learned.names, learned.coefficients, strict=True)
    ]
    held = learned.sd_nm or (0.0,) * len(learned.names)
    sds = [
        float(spread[places[name]]) if name in places else sd
        for name, sd in zip(learned.names, held, strict=True)
    ]
    period = places.get(f"{LEARNED_TORQUE}__period")
    orders = len(learned.cosine_nm)
    return replace(
        learned,
        period=learned.period if period is None else float(fit.point[period]),
        constant_nm=values[0],
        cosine_nm=tuple(values[1 : 1 + orders]),
        sine_nm=tuple(values[1 + orders :]),
        sd_nm=tuple(sds),
    )


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
