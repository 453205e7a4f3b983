"""A reference that is held from sample to sample, as by a digital drive, is recognised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayesbl.bench.motion import cycle, held_motion
from bayesbl.bench.simulation import Measurement
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned, valid_variant
from bayesbl.matching.observed import observed
from bayesbl.matching.predictive_check import agrees, disagreements
from bayesbl.matching.signals import (
    GAP,
    REFERENCE_DELAY,
    gap_unknown,
    reference_delay_unknown,
    start_angle_unknown,
)
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import MOTOR_CURRENT, REFERENCE_SPEED

GAP_RAD, RATE_HZ, DURATION_S = 8e-4, 250.0, 8.0
BENCH = replace(
    reference_bench(),
    measurement=Measurement(speed_noise=NoiseModel(1.5), current_noise=NoiseModel(0.05)),
)
ASKED = cycle(BENCH.value("gear_ratio"), (-0.8, 0.8), 2000.0, 8000.0, 0.4, DURATION_S)


@pytest.mark.parametrize("held", [False, True])
def test_a_motion_is_believed_as_it_was_made(held: bool) -> None:
    """The check passes, and the gap is within 3.5 standard deviations: by chance 1 in 2000."""
    motion = held_motion(ASKED, int(DURATION_S * RATE_HZ), RATE_HZ) if held else ASKED
    made = BENCH.simulate(GAP_RAD, motion, sampling_hz=RATE_HZ, seed=np.random.default_rng(2))
    channels = {name: made.channels[name] for name in ("motor_speed_rpm", MOTOR_CURRENT)}
    made = replace(made, channels=channels | {REFERENCE_SPEED: ASKED.speed_rpm(made.time_s)})
    unknowns = [
        gap_unknown(1e-4, 1e-2),
        start_angle_unknown(made.name),
        reference_delay_unknown(made.name),
    ]
    fit = fit_aligned(BENCH, [observed(made, BENCH)], unknowns)
    assert agrees(disagreements(fit)) == (not held)
    found = valid_variant(fit)
    assert agrees(disagreements(found))
    assert (REFERENCE_DELAY in [u.name for u in found.model.unknowns]) == (not held)
    assert abs(found.value(GAP) / GAP_RAD - 1.0) < 3.5 * found.sd(GAP)
