"""What turns with the motor is taken from residuals, and nothing else."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bayesbl.bench.parameters import BENCH_PARAMETERS
from bayesbl.config.bench import reference_bench
from bayesbl.matching.motor_lines import MOST_SHARE, MotorLines
from bayesbl.matching.observed import FEWEST_MOTOR_TURNS, marginalising_motor_lines, observed

SAMPLES = 18_000
KEPT = np.ones(SAMPLES, dtype=bool)


def motor_turns(turns: float = 600.0) -> np.ndarray:
    """A motor whose speed gravity sways five times by a third of a radian."""
    part = np.arange(SAMPLES) / SAMPLES
    return turns * part + np.sin(10.0 * math.pi * part) / (6.0 * math.pi)


def rest(lines: MotorLines, rows: np.ndarray) -> np.ndarray:
    left = rows.copy()
    lines.project_out(left)
    return left


@pytest.mark.parametrize("order", [1, 2, 6, 20])
def test_a_line_of_the_motor_goes_though_its_speed_sways(order: int) -> None:
    line = np.sin(2.0 * math.pi * order * motor_turns() + 1.0)
    taken = rest(MotorLines(motor_turns(), KEPT), line)
    assert taken.std() < 0.06 * line.std()


def test_it_is_a_projection_that_keeps_the_mean() -> None:
    rows = 3.0 + np.random.default_rng(1).standard_normal((2, SAMPLES))
    lines = MotorLines(motor_turns(), KEPT)
    once = rest(lines, rows)
    np.testing.assert_allclose(rest(lines, once), once, atol=1e-9)
    np.testing.assert_allclose(once.mean(axis=1), rows.mean(axis=1), rtol=1e-9)
    # Of white noise it takes as much as it has columns.
    lost = 1.0 - once.var(axis=1) / rows.var(axis=1)
    assert np.all(lost < 1.5 * MOST_SHARE)


def test_what_is_excluded_decides_nothing() -> None:
    kept = KEPT.copy()
    kept[4000:5000] = False
    rows = np.random.default_rng(2).standard_normal((1, SAMPLES)) * kept
    taken = rest(MotorLines(motor_turns(), kept), rows)
    assert np.all(taken[0, ~kept] == 0.0)
    other = np.where(kept, motor_turns(), 0.0)
    np.testing.assert_allclose(rest(MotorLines(other, kept), rows), taken, atol=1e-9)


def test_a_line_in_time_stays() -> None:
    line = np.sin(2.0 * math.pi * 151.3 * np.arange(SAMPLES) / SAMPLES)
    taken = rest(MotorLines(motor_turns(), KEPT), line)
    assert taken.std() > 0.99 * line.std()


def test_a_load_that_turns_with_the_motor_keeps_its_lines(independent) -> None:
    rng = np.random.default_rng(3)
    bench = reference_bench()
    believed = {info.name: bench.value(info.name) for info in BENCH_PARAMETERS}
    joint = independent.plant(believed, gap_rad=8e-4, start_angle_rad=0.0)
    seen = observed(independent.simulate(joint, rng, name="a").recording, bench)
    lines = marginalising_motor_lines(seen, bench).motor_lines
    rotations = seen.samples / (seen.rotation_period_s * seen.sampling_hz)
    assert lines.turns[-1] == pytest.approx(rotations * bench.value("gear_ratio"), rel=1e-3)
    direct = bench.with_parameters(gear_ratio=0.9 * FEWEST_MOTOR_TURNS)
    assert marginalising_motor_lines(seen, direct).motor_lines is None
