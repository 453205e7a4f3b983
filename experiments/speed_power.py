"""By what power of the speed a gap is misread through a curve of another speed.

    python experiments/speed_power.py

The reference bench without noise, at its speed and 10 % faster: δ that the amplitude at the faster
speed has on the curve of the slower one, d ln δ / d ln v. ``SPEED_POWER`` and the tolerances of
speeds in ``bayesbl/measurement/compatibility.py`` rest on it. Half a minute on one core; the table
is experiments/results/speed_power.csv.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from bayesbl.config.bench import reference_bench
from bayesbl.ringing.estimator import Estimator
from bayesbl.ringing.symbols import AMPLITUDE

GAPS_RAD = (2e-4, 4e-4, 8e-4, 1.6e-3, 3.5e-3)
FASTER = 1.1
WIDER = 1.05
START_ANGLES_RAD = (0.4, 2.5)
TABLE = Path(__file__).parent / "results" / "speed_power.csv"


def amplitude_rpm(gap_rad: float, speed_ratio: float) -> float:
    """A of the ringing, averaged over start angles."""
    bench = reference_bench()
    speed = speed_ratio * bench.value("reference_speed_rpm")
    turning = bench.with_parameters(reference_speed_rpm=speed)
    found = [
        Estimator().estimate(
            turning.simulate(gap_rad, rotations=3.0, start_angle_rad=angle),
            np.random.SeedSequence(1),
        )
        for angle in START_ANGLES_RAD
    ]
    return float(np.mean([point.optimum.symbols[AMPLITUDE] for point in found]))


def power(gap_rad: float) -> tuple[float, float]:
    """d ln δ / d ln v at a given A, and d ln δ / d ln A."""
    here = amplitude_rpm(gap_rad, 1.0)
    wider, faster = amplitude_rpm(gap_rad * WIDER, 1.0), amplitude_rpm(gap_rad, FASTER)
    slope = math.log(WIDER) / math.log(wider / here)
    return slope * math.log(faster / here) / math.log(FASTER), slope


if __name__ == "__main__":
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["gap_rad", "power_of_speed", "log_gap_by_log_amplitude"])
        for gap_rad in GAPS_RAD:
            row = [gap_rad, *(round(value, 3) for value in power(gap_rad))]
            table.writerow(row)
            print(*row)
