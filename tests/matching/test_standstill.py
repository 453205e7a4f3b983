"""Motions where the bench can be believed: what happens at rest counts for nothing, held or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayesbl.bench.motion import cycle, held_motion
from bayesbl.bench.simulation import Measurement
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned, in_motion, valid_variant
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import observed, standstills
from bayesbl.matching.predictive_check import agrees, disagreements
from bayesbl.matching.signals import (
    GAP,
    REFERENCE_DELAY,
    gap_unknown,
    reference_delay_unknown,
    start_angle_unknown,
)
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import MOTOR_CURRENT, REFERENCE_SPEED, Recording

GAP_RAD, RATE_HZ, DURATION_S = 8e-4, 250.0, 8.0
BENCH = replace(
    reference_bench(),
    measurement=Measurement(speed_noise=NoiseModel(1.5), current_noise=NoiseModel(0.05)),
)
ASKED = cycle(BENCH.value("gear_ratio"), (-0.8, 0.8), 2000.0, 8000.0, 0.4, DURATION_S)


def recording(*, held: bool = False, creep_a: float = 0.0) -> Recording:
    """Strokes whose reference is held or not, with so much more current at rest."""
    size = int(DURATION_S * RATE_HZ)
    motion = held_motion(ASKED, size, RATE_HZ) if held else ASKED
    made = BENCH.simulate(GAP_RAD, motion, sampling_hz=RATE_HZ, seed=np.random.default_rng(2))
    channels = {name: made.channels[name] for name in ("motor_speed_rpm", MOTOR_CURRENT)}
    channels[REFERENCE_SPEED] = ASKED.speed_rpm(made.time_s)
    made = replace(made, channels=channels)
    stands = standstills(observed(made, BENCH), BENCH)
    channels[MOTOR_CURRENT] = channels[MOTOR_CURRENT] + creep_a * stands
    return replace(made, channels=channels)


def fitted(made: Recording) -> SimulatedFit:
    unknowns = [
        gap_unknown(1e-4, 1e-2),
        start_angle_unknown(made.name),
        reference_delay_unknown(made.name),
    ]
    return fit_aligned(BENCH, [observed(made, BENCH)], unknowns)


def test_what_happens_at_rest_changes_nothing_in_motion() -> None:
    as_it_is, creeping = (in_motion(fitted(recording(creep_a=size))) for size in (0.0, 0.4))
    assert as_it_is is not None
    assert creeping is not None
    apart = (creeping.point - as_it_is.point) / np.sqrt(np.diag(as_it_is.covariance))
    assert np.abs(apart).max() < 0.05


@pytest.mark.parametrize("creep_a", [0.0, 0.4])
@pytest.mark.parametrize("held", [False, True])
def test_a_motion_is_believed_as_it_was_made(held: bool, creep_a: float) -> None:
    """The check passes, and the gap is within 3.5 standard deviations: by chance 1 in 2000."""
    fit = fitted(recording(held=held, creep_a=creep_a))
    assert agrees(disagreements(fit)) == (not held and creep_a == 0.0)
    found = valid_variant(fit)
    assert agrees(disagreements(found))
    assert (REFERENCE_DELAY in [u.name for u in found.model.unknowns]) == (not held)
    assert abs(found.value(GAP) / GAP_RAD - 1.0) < 3.5 * found.sd(GAP)
