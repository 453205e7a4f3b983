"""A controller's period that is not known: why draws carry no weight, and what to do about it."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest
from test_impacts import CURRENT_NOISE_A, HZ, NOISE_RPM, SPEED_RPM

from bayesbl.bench.bench import BenchEffect, EffectParameterValue
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import observed
from bayesbl.matching.posterior import sample_direct
from bayesbl.matching.signals import effect_unknowns, gap_unknown, start_angle_unknown
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, Recording
from bayesbl.sampling.chains import SamplerSettings

PERIOD_S = 4e-3


@pytest.fixture(scope="module")
def recording(independent: ModuleType) -> Recording:
    values = {name: item.value for name, item in reference_bench().parameters.items()}
    ticks = {"sampled_control.period_s": PERIOD_S, "sampled_control.delay_periods": 0.0}
    truth = independent.plant(values | ticks | {"gap_rad": 8e-4, "start_angle_rad": 0.4})
    _, speed, current = independent.noise_free(truth, 3.02, HZ)
    rng = np.random.default_rng(1)
    channels = {
        MOTOR_SPEED: speed + NOISE_RPM * rng.standard_normal(speed.size),
        MOTOR_CURRENT: current + CURRENT_NOISE_A * rng.standard_normal(speed.size),
    }
    return Recording("ticks", np.arange(speed.size) / HZ, channels)


def fitted(recording: Recording, period_sd_s: float | None) -> SimulatedFit:
    values = {
        "period_s": EffectParameterValue(PERIOD_S, period_sd_s),
        "delay_periods": EffectParameterValue(0.0, 0.1 if period_sd_s else None),
    }
    bench = reference_bench().with_effects(BenchEffect("sampled_control", values))
    seen = observed(recording, bench, SPEED_RPM)
    unknowns = [gap_unknown(1e-4, 1e-2), start_angle_unknown(seen.name)]
    return fit_aligned(bench, [seen], [*unknowns, *effect_unknowns(bench, [seen.name])])


def reasons(fit: SimulatedFit, *, withheld: bool = False) -> list[str]:
    seed = np.random.SeedSequence(1)
    settings = SamplerSettings(ensembles=2)
    found = sample_direct(fit, settings, seed, withheld=withheld).diagnostics.reasons
    return [flaw.code for flaw in found]


@pytest.mark.long
def test_a_period_that_is_not_known_is_the_reason_and_its_statement_the_next_step(
    recording: Recording,
) -> None:
    """With the period known all draws carry weight."""
    fit = fitted(recording, 2e-4)
    few_weigh = {"ticks_decide", "other_shape"}
    assert few_weigh & {*reasons(fit)} == {"ticks_decide"}
    assert not few_weigh & {*reasons(fit, withheld=True)}
    assert not few_weigh & {*reasons(fitted(recording, None))}
