"""Strokes whose dry friction builds up near rest, over a speed or over an angle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayesbl.bench.bench import BenchEffect, EffectParameterValue
from bayesbl.bench.motion import cycle
from bayesbl.bench.simulation import Measurement
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.observed import observed
from bayesbl.matching.predictive_check import is_explained
from bayesbl.matching.signals import GAP
from bayesbl.model_search.always_in import with_friction
from bayesbl.model_search.pipeline import direct_unknowns
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import MOTOR_CURRENT, REFERENCE_SPEED

GAP_RAD, RATE_HZ, DURATION_S = 8e-4, 250.0, 8.0
BENCH = replace(
    reference_bench(),
    measurement=Measurement(speed_noise=NoiseModel(1.0), current_noise=NoiseModel(0.03)),
)
ASKED = cycle(BENCH.value("gear_ratio"), (-0.8, 0.8), 2000.0, 8000.0, 0.2, DURATION_S)


@pytest.mark.parametrize(
    ("width_rad_per_s", "presliding_rad"), [(4.0, 0.0), (0.0, 0.03)], ids=["speed", "angle"]
)
def test_strokes_show_how_friction_builds_up(width_rad_per_s: float, presliding_rad: float) -> None:
    """Gap, width and angle are within 3.5 standard deviations."""
    true = {
        "torque_nm": 0.4,
        "width_rad_per_s": width_rad_per_s,
        "presliding_rad": presliding_rad,
    }
    stated = {name: EffectParameterValue(value) for name, value in true.items()}
    rubbing = BENCH.with_effects(BenchEffect("motor_coulomb_friction", stated))
    made = rubbing.simulate(GAP_RAD, ASKED, sampling_hz=RATE_HZ, seed=np.random.default_rng(2))
    channels = {name: made.channels[name] for name in ("motor_speed_rpm", MOTOR_CURRENT)}
    channels[REFERENCE_SPEED] = ASKED.speed_rpm(made.time_s)
    observation = observed(replace(made, channels=channels), BENCH)
    bench = with_friction(BENCH, [observation])
    unknowns = direct_unknowns(bench, [observation.name], (1e-4, 1e-2), [observation.name])
    fit = fit_aligned(bench, [observation], unknowns)
    assert is_explained(fit)
    assert abs(fit.value(GAP, observation.name) / GAP_RAD - 1.0) < 3.5 * fit.sd(
        GAP, observation.name
    )
    for name, value in true.items():
        slot = f"motor_coulomb_friction__{name}"
        assert abs(fit.value(slot) - value) < 3.5 * fit.sd(slot) + 0.01 * value
