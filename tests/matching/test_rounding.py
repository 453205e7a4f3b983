"""Recordings without noise, or whose noise is rounding that is the same in every rotation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from bayesbl.bench.bench import BenchEffect, EffectParameterValue
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.impacts import by_impact, smeared
from bayesbl.matching.observed import observed
from bayesbl.matching.predictive_check import agrees, disagreements
from bayesbl.matching.signals import GAP, gap_unknown, start_angle_unknown
from bayesbl.noise.channel_noise import HIGHEST_ORDER
from bayesbl.noise.quantisation import Rounding, speed_steps
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, FloatArray, Recording
from bayesbl.units import RPM_PER_RAD_PER_S

GAP_RAD = 8e-4
COUNTS = 65536
HZ = 1000.0


def exact(speed_rpm: FloatArray) -> FloatArray:
    return speed_rpm


def in_steps(speed_rpm: FloatArray) -> FloatArray:
    """Of 1 rpm."""
    return np.round(speed_rpm)


def counted(speed_rpm: FloatArray) -> FloatArray:
    """Differences of an encoder's counts."""
    turns = np.cumsum(speed_rpm) / 60.0 / HZ
    counts = np.floor(COUNTS * turns + 0.3)
    return np.diff(counts, prepend=counts[0] - (counts[1] - counts[0])) / COUNTS * 60.0 * HZ


def counted_apart(speed_rpm: FloatArray) -> FloatArray:
    """The same over the first half of each sample: no two share a count."""
    turns = np.cumsum(speed_rpm) / 60.0 / HZ
    before, after = np.floor(COUNTS * np.stack([turns, turns + 0.5 * speed_rpm / 60.0 / HZ]) + 0.3)
    return np.asarray((after - before) / COUNTS * 60.0 * 2.0 * HZ)


@pytest.mark.parametrize("shown", [exact, in_steps, counted, counted_apart])
def test_a_joint_of_another_simulator_that_shows_no_noise_is_measured(
    independent: ModuleType, shown: Callable[[FloatArray], FloatArray]
) -> None:
    """δ within three of its standard deviations, which are below 0.2 %; the check passes."""
    values = {name: item.value for name, item in reference_bench().parameters.items()}
    truth = independent.plant(values | {"gap_rad": GAP_RAD, "start_angle_rad": 0.4})
    made = independent.simulate(truth, rotations=3.0, sampling_hz=HZ).recording
    speed = shown(made.motor_speed_rpm)
    made = replace(made, channels={**made.channels, MOTOR_SPEED: speed})
    seen = observed(made, reference_bench(), 2000.0)
    fit = fit_aligned(
        reference_bench(), [seen], [gap_unknown(1e-4, 1e-2), start_angle_unknown(seen.name)]
    )
    z = (math.log(fit.value(GAP)) - math.log(GAP_RAD)) / fit.sd(GAP)
    assert abs(z) < 3.0
    assert fit.sd(GAP) < 2e-3
    assert agrees(disagreements(fit))
    (impacts,) = by_impact(fit, fit.covariance)
    moved = impacts.timing_variance.mean() * smeared(fit, impacts)[fit.model.index(GAP)]
    assert abs(moved) < 0.1 * fit.sd(GAP)


@pytest.mark.parametrize("sampling_hz", [HZ, 0.25 * HZ])
def test_an_encoder_without_noise_in_a_sampled_loop_disagrees_only_where_an_effect_is_missing(
    independent: ModuleType, sampling_hz: float
) -> None:
    """δ within three of its standard deviations; friction of 1e-4 N m s/rad is seen, and at the
    controller's own rate 1 % of the stiffness, with which δ is more than three off."""
    period = EffectParameterValue(1.0 / HZ)
    bench = reference_bench().with_effects(BenchEffect("sampled_control", {"period_s": period}))
    friction = "motor_viscous_friction__coefficient_nm_s_per_rad"
    stiffness = "shaft_stiffness_nm_per_rad"
    stiffer = [{stiffness: 1.01 * bench.value(stiffness)}] if sampling_hz == HZ else []
    for extra in ({}, {friction: 1e-4}, *stiffer):
        values = {name: item.value for name, item in reference_bench().parameters.items()} | extra
        values |= {"sampled_control.period_s": 1.0 / HZ, "outside__loop_counts": 16384.0}
        truth = independent.plant(values | {"gap_rad": GAP_RAD, "start_angle_rad": 0.4})
        _, speed, current = independent.noise_free(truth, 3.02, sampling_hz)
        time = np.arange(speed.size) / sampling_hz
        made = Recording("counted", time, {MOTOR_SPEED: speed, MOTOR_CURRENT: current})
        seen = observed(made, bench, 2000.0)
        unknowns = [gap_unknown(1e-4, 1e-2), start_angle_unknown(seen.name)]
        fit = fit_aligned(bench, [seen], unknowns)
        assert fit.model.noise[0].repeats
        assert agrees(disagreements(fit)) == (not extra)
        off = abs(math.log(fit.value(GAP) / GAP_RAD)) / fit.sd(GAP)
        assert off < 3.0 or extra
        assert off > 3.0 or stiffness not in extra


@pytest.mark.parametrize("shown", [in_steps, counted, counted_apart])
def test_rounding_has_the_autocovariance_that_is_counted_for_it(
    shown: Callable[[FloatArray], FloatArray],
) -> None:
    """Within 3 % of the variance at every lag; a ripple of 20 rpm over 60 s."""
    time = np.arange(60_000) / HZ
    speed = (
        2000.0
        + 20.0 * np.sin(7.3 * time)
        + 5.0 * np.random.default_rng(3).standard_normal(time.size)
    )
    steps = speed_steps(shown(speed))
    assert steps is not None
    away = (shown(speed) - speed)[1:]  # of the first no difference is counted
    away -= away.mean()
    lags = range(HIGHEST_ORDER + 1)
    measured = np.array([away[k:] @ away[: away.size - k] / away.size for k in lags])
    told = Rounding(steps, 0.0).autocovariance(speed, shown(speed) - speed, HIGHEST_ORDER + 1)
    np.testing.assert_allclose(told, measured, atol=0.03 * measured[0])


def test_what_the_simulation_is_not_exact_by_is_counted_in_the_current_too() -> None:
    """By the controller's gain: 0.01 rpm."""
    bench = reference_bench()
    made = bench.simulate(GAP_RAD, rotations=2.0)
    speed, current = observed(made, bench).rounding
    gain = bench.value("speed_gain_nm_s_per_rad") / bench.value("torque_constant_nm_per_a")
    assert current.least_sd == pytest.approx(gain * speed.least_sd / RPM_PER_RAD_PER_S)
    assert MOTOR_CURRENT in made.channels
