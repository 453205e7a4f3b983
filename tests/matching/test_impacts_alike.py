"""Whether the load changes flanks at one angle in every rotation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayesbl.bench.measured_channels import Measurement
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.observed import observed
from bayesbl.matching.predictive_check import impacts_alike
from bayesbl.matching.signals import gap_unknown, start_angle_unknown
from bayesbl.noise.process import NoiseModel

LATE_S = 2e-3


@pytest.mark.parametrize(
    ("late_s", "rotations", "alike"),
    [(0.0, 3.0, True), (LATE_S, 3.0, False), (0.0, 1.97, True)],  # the last: hardly two to compare
)
def test_impacts_that_come_late_in_some_rotations_are_seen(
    late_s: float, rotations: float, alike: bool
) -> None:
    """To and fro by 2 ms in 2.3 s; false alarm 0.5 %, the seed is fixed."""
    noise = Measurement(speed_noise=NoiseModel(1.5, (0.6,)), current_noise=NoiseModel(0.05))
    bench = replace(reference_bench(), measurement=noise)
    made = bench.simulate(
        8e-4,
        rotations=rotations,
        sampling_hz=250.0,
        start_angle_rad=0.4,
        seed=np.random.default_rng(5),
    )
    at = made.time_s + late_s * np.sin(2.0 * np.pi * made.time_s / 2.3)
    moved = {name: np.interp(at, made.time_s, row) for name, row in made.channels.items()}
    seen = observed(replace(made, channels=moved), bench, 2000.0)
    unknowns = [gap_unknown(1e-4, 1e-2), start_angle_unknown(seen.name)]
    assert impacts_alike(fit_aligned(bench, [seen], unknowns), 0.005) == [alike]
