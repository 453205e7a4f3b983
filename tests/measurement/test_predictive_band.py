"""The predictive band holds the nominal share of samples, of the same joint recorded again too."""

from __future__ import annotations

import numpy as np
import pytest

from bayesbl.config.bench import reference_bench
from bayesbl.measurement.amplitude_route import amplitude_groups
from bayesbl.recording.types import MOTOR_SPEED, Recording
from bayesbl.results.variables import datasets
from bayesbl.ringing.estimator import Estimator
from bayesbl.sampling.chains import SamplerSettings

LEVEL = 0.9


@pytest.mark.long
@pytest.mark.parametrize(("gap_rad", "noise_rpm"), [(8e-4, 0.3), (8e-4, 1.5), (3e-3, 1.5)])
def test_the_band_holds_its_share_whatever_misfit_repeats(gap_rad: float, noise_rpm: float) -> None:
    made = reference_bench().simulate(
        gap_rad, rotations=5.0, sampling_hz=1000.0, start_angle_rad=0.4
    )
    generator = np.random.default_rng(1)
    fitted, again = (
        made.motor_speed_rpm + generator.normal(0.0, noise_rpm, made.samples) for _ in range(2)
    )
    recording = Recording("made", made.time_s, {MOTOR_SPEED: fitted})
    quick = Estimator(sampler=SamplerSettings(ensembles=2, max_steps=200))
    fit = quick.fit(recording, np.random.SeedSequence(1))
    # Noise and parameters alone held 27 to 85 % here.
    groups = datasets(amplitude_groups(fit, None, None, LEVEL, np.random.SeedSequence(2)))
    band = groups["predictive"]
    for speed in (fitted, again):
        share = np.mean((speed > band["low_rpm"].values) & (speed < band["high_rpm"].values))
        # 0.22 % is one standard deviation of the share of 18000 samples.
        assert share == pytest.approx(LEVEL, abs=0.02)
