"""The paper's search: exactly eq. 6 in the ranges as printed, and whose pulses it found."""

from __future__ import annotations

import math

import numpy as np
import pytest
from made_recordings import speed_as_printed, synthetic_recording
from synthetic_ringing import TRUTH

from bayesbl.noise.process import NoiseModel
from bayesbl.ringing import table_2
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import find_optimum
from bayesbl.ringing.symbols import (
    AMPLITUDE,
    FREQUENCY,
    MEAN,
    ROTATION,
    SEPARATION,
    START,
    SYMBOLS,
    WINDOW_END,
    WINDOW_START,
    DisturbanceModel,
)

OWN = {name: TRUTH[name] for name in SYMBOLS}
QUARTER_S = 0.5 * math.pi / TRUTH[FREQUENCY]


@pytest.fixture(scope="module")
def objective() -> Objective:
    made = synthetic_recording(TRUTH, NoiseModel(1.0), np.random.default_rng(1))
    return Objective(DisturbanceModel(0), made.time_s, made.motor_speed_rpm)


def test_eq_6_has_four_repetitions_and_nothing_beside() -> None:
    symbols = {**OWN, START: 0.1, SEPARATION: 0.5, ROTATION: 2.0, WINDOW_END: 0.05}
    time_s = np.arange(14_000) / 1000.0
    rings = np.abs(speed_as_printed(time_s, symbols) - symbols[MEAN]) > 1e-9
    starts = time_s[1:][rings[1:] & ~rings[:-1]]
    expected = sorted(0.1 + 2.0 * i - apart for i in range(1, 5) for apart in (0.0, 0.5))
    np.testing.assert_allclose(starts, expected, atol=0.0021)


def test_the_squares_of_eq_6_are_those_of_its_speed(objective: Objective) -> None:
    time_s, speed_rpm = objective.time_s, objective.speed_rpm
    box = table_2.ranges_as_printed(time_s, speed_rpm)
    low, high = np.array([box[name] for name in SYMBOLS]).T
    points = low + (high - low) * np.random.default_rng(2).uniform(size=(60, 9))
    points[::2, list(SYMBOLS).index(WINDOW_START)] *= 0.1
    points[::3, list(SYMBOLS).index(ROTATION)] *= 0.01  # pulses over one another
    points[0, list(SYMBOLS).index(ROTATION)] = 0.0
    made = [speed_as_printed(time_s, dict(zip(SYMBOLS, p, strict=True))) for p in points]
    expected = np.sum((speed_rpm - np.array(made)) ** 2, axis=1)
    found = table_2.squares_as_printed(points, time_s, speed_rpm)
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_the_ranges_are_those_that_table_2_prints() -> None:
    time_s, speed_rpm = np.array([0.0, 1.0, 9.0]), np.array([1990.0, 2000.0, 2014.0])
    assert table_2.ranges_as_printed(time_s, speed_rpm) == {
        "amplitude_rpm": (-12.0, 12.0),
        "start_time_s": (0.0, 9.0),
        "decay_rate_per_s": (5.0, 30.0),
        "angular_frequency_rad_per_s": (2.0 * math.pi, 80.0 * math.pi),
        "mean_speed_rpm": (1990.0, 2014.0),
        "window_start_s": (0.0, 0.204),
        "window_end_s": (0.0, 0.102),
        "pulse_separation_s": (0.0, 9.0),
        "rotation_period_s": (0.0, 9.0),
    }


@pytest.mark.parametrize(
    ("moved", "same"),
    [
        ({}, True),
        ({START: OWN[START] + 3.0 * OWN[ROTATION]}, True),
        ({START: OWN[START] + 0.8 * QUARTER_S}, True),
        (
            {
                AMPLITUDE: -OWN[AMPLITUDE],
                START: OWN[START] - OWN[SEPARATION],
                SEPARATION: -OWN[SEPARATION],
            },
            True,
        ),
        ({START: OWN[START] + 2.0 * QUARTER_S}, False),
        ({AMPLITUDE: -OWN[AMPLITUDE]}, False),
        ({ROTATION: 0.5 * OWN[ROTATION]}, False),
        ({WINDOW_START: 0.15, WINDOW_END: 0.1}, False),
    ],
)
def test_whether_a_search_found_the_pulses_of_an_optimum(
    moved: dict[str, float], same: bool
) -> None:
    assert table_2.same_pulses({**OWN, **moved}, OWN, 5.0 * OWN[ROTATION]) is same


@pytest.mark.long
def test_the_optimum_does_not_depend_on_what_a_search_of_the_box_ended_at(
    objective: Objective, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table_2, "POPULATION", 50)
    monkeypatch.setattr(table_2, "ITERATIONS", 5)
    alone = find_optimum(objective, "guess", np.random.default_rng(3))
    found = find_optimum(objective, "paper", np.random.default_rng(3))
    assert found.symbols == alone.symbols
    assert found.method == "paper"
    assert alone.box_search is None
    assert found.box_search is not None
    assert list(found.box_search.symbols) == list(SYMBOLS)
    assert found.evaluations == alone.evaluations + 250
    assert found.box_search.rmse_rpm == found.history.rmse_rpm[-1]
