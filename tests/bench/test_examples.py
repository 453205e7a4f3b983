"""The example recordings, made by an independent simulator of the reference bench."""

from __future__ import annotations

import math

import numpy as np
import pytest
from places import RECORDINGS
from scipy.optimize import minimize_scalar

from bayesbl.config.bench import reference_bench

BENCH = reference_bench()


@pytest.mark.parametrize(("name", "gap"), [("wear_before", 6.8539e-4), ("wear_after", 9.5394e-4)])
def test_simulation_differs_from_the_example_by_its_noise_alone(name: str, gap: float) -> None:
    path = RECORDINGS / f"{name}.csv"
    if not path.exists():
        pytest.skip(f"{path} is absent")
    _, position, speed, current = np.loadtxt(path, delimiter=",", skiprows=1).T

    def residuals(start_angle: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        simulated = BENCH.simulate_many(gap, start_angle_rad=start_angle, channels="all")[0]
        turned = position - (simulated[0] - simulated[0, 0])
        return turned, speed - simulated[1], current - simulated[2]

    def misfit(start_angle: float) -> float:
        _, of_speed, of_current = residuals(start_angle)
        return float(np.mean((of_speed / 1.5) ** 2) + np.mean((of_current / 0.05) ** 2))

    grid = np.linspace(0.0, 2.0 * math.pi, 60)
    coarse = float(grid[np.argmin([misfit(angle) for angle in grid])])
    best = minimize_scalar(
        misfit, bounds=(coarse - 0.15, coarse + 0.15), method="bounded", options={"xatol": 1e-7}
    )
    turned, of_speed, of_current = residuals(best.x)
    # What AR(1) noise of sd 1.5 rpm and φ 0.6, and white noise of sd 0.05 A, leave: the standard
    # deviations to four standard errors of 18,001 samples.
    assert of_speed.std() == pytest.approx(1.5, rel=0.03)
    assert of_current.std() == pytest.approx(0.05, rel=0.022)
    innovations = of_speed[1:] - 0.6 * of_speed[:-1]
    assert innovations.size == 18_000
    assert innovations.std() == pytest.approx(1.5 * 0.8, rel=0.022)
    for white in (innovations, of_current):
        assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 4.0 / math.sqrt(white.size)
        # Nothing repeats from rotation to rotation: that average is noise over √5.
        repeating = white[-18_000:].reshape(5, 3600).mean(axis=0)
        assert repeating.std() == pytest.approx(white.std() / math.sqrt(5.0), rel=0.05)
    assert np.max(np.abs(turned)) < 2.0 * math.pi / 16384
