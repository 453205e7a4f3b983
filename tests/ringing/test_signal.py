"""The disturbance model: the fast kernel against the plain formula, and its laws."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from bayesbl.ringing.objective import Objective
from bayesbl.ringing.symbols import SYMBOLS, DisturbanceModel
from bayesbl.ringing.waveform import (
    baseline_columns,
    impact,
    jacobian,
    jacobian_columns,
    misfit_curvature,
    model_speed,
    pulse_train,
)


@dataclass(frozen=True)
class Case:
    """One random setting of the model with a noisy recording of it."""

    model: DisturbanceModel
    symbols: dict[str, float]
    time_s: np.ndarray
    speed_rpm: np.ndarray

    @property
    def searched(self) -> np.ndarray:
        return np.array([[self.symbols[name] for name in self.model.searched]])


def waveform(time_s: np.ndarray, s: dict[str, float], period_s: float) -> np.ndarray:
    return pulse_train(time_s, s, period_s)


def random_case(seed: int) -> Case:
    """Overlapping pulses, pulses cut by either end, window ends on samples, 250 Hz to 4 kHz."""
    rng = np.random.default_rng(seed)
    rate = float(rng.choice([250, 500, 1000, 4000]))
    samples = int(rng.uniform(5.0, 18.0) * rate)
    time_s = rng.uniform(-3.0, 3.0) + np.arange(samples) / rate
    duration = samples / rate
    harmonics = int(rng.integers(0, 4))
    window = 0.204 if rng.random() < 0.6 else rng.uniform(0.05, 0.5)
    overlapping = rng.random() < 0.3
    rotation = rng.uniform(0.22, 0.45) if overlapping else rng.uniform(0.5, 0.9 * duration)
    separation = rng.uniform(0.01, window) if rng.random() < 0.4 else rng.uniform(0.0, rotation)
    start = rng.uniform(time_s[0] - rotation, time_s[0] + rotation)
    if rng.random() < 0.3:
        start = time_s[0] + round((start - time_s[0]) * rate) / rate
        rotation, separation, window = (
            round(x * rate) / rate for x in (rotation, separation, window)
        )
    fixed = {"window_start_s": 0.003, "window_end_s": 0.003 + window}
    symbols = {
        "amplitude_rpm": 30.0,
        "start_time_s": start,
        "decay_rate_per_s": rng.uniform(5.0, 30.0),
        "angular_frequency_rad_per_s": rng.uniform(6.3, 250.0),
        "mean_speed_rpm": 2000.0,
        **fixed,
        "pulse_separation_s": separation,
        "rotation_period_s": rotation,
    }
    clean = 30.0 * waveform(time_s, symbols, 1.0 / rate)
    clean += baseline_columns(time_s, rotation, harmonics)[:, 1:] @ rng.normal(size=2 * harmonics)
    noise = rng.normal(size=samples) * clean.std() * 10.0 ** rng.uniform(-2.0, 0.0)
    model = DisturbanceModel(baseline_harmonics=harmonics, fixed=fixed)
    return Case(model, symbols, time_s, 2000.0 + clean + noise)


def plain_sum_of_squares(case: Case, solve_mean: bool) -> float:
    """The paper's formula written out, linear symbols by a library's least squares."""
    period_s = (case.time_s[-1] - case.time_s[0]) / (case.time_s.size - 1)
    pulses = waveform(case.time_s, case.symbols, period_s)
    columns = baseline_columns(
        case.time_s, case.symbols["rotation_period_s"], case.model.baseline_harmonics
    )
    left, columns = case.speed_rpm.copy(), np.column_stack([columns, pulses])
    if not solve_mean:
        left -= case.symbols["mean_speed_rpm"]
        columns = columns[:, 1:]
    left = left - columns @ np.linalg.lstsq(columns, left, rcond=None)[0]
    return float(left @ left)


@pytest.mark.parametrize("solve_mean", [True, False])
def test_the_kernel_agrees_with_the_plain_formula_to_1e_10(solve_mean: bool) -> None:
    for seed in range(40):
        case = random_case(seed)
        fixed = dict(case.model.fixed)
        if not solve_mean:
            fixed["mean_speed_rpm"] = case.symbols["mean_speed_rpm"]
        model = DisturbanceModel(case.model.baseline_harmonics, fixed)
        fast = Objective(model, case.time_s, case.speed_rpm).sum_of_squares(case.searched)[0]
        plain = plain_sum_of_squares(case, solve_mean)
        assert math.sqrt(plain / case.time_s.size) >= 0.009 * case.speed_rpm.std()
        assert math.isclose(math.sqrt(fast), math.sqrt(plain), rel_tol=1e-10), f"seed {seed}"


def test_moving_all_pulses_by_whole_rotations_changes_nothing() -> None:
    case = random_case(8)
    objective = Objective(case.model, case.time_s, case.speed_rpm)
    moved = case.searched.copy()
    names = case.model.searched
    rotation = moved[0, names.index("rotation_period_s")]
    moved[0, names.index("start_time_s")] += 3.0 * rotation
    moved[0, names.index("pulse_separation_s")] -= rotation
    np.testing.assert_allclose(
        objective.sum_of_squares(moved), objective.sum_of_squares(case.searched), rtol=1e-9
    )


@pytest.mark.parametrize("start_s", [1e30, -1e93, math.inf, math.nan])
def test_a_start_without_a_place_in_the_recording_makes_no_waveform(start_s: float) -> None:
    case = random_case(8)
    lost = case.searched.copy()
    lost[0, case.model.searched.index("start_time_s")] = start_s
    objective = Objective(case.model, case.time_s, case.speed_rpm)
    assert objective.sum_of_squares(lost)[0] == math.inf


def test_exchanging_the_pulses_negates_the_amplitude_and_nothing_else() -> None:
    case = random_case(8)
    objective = Objective(case.model, case.time_s, case.speed_rpm)
    names = case.model.searched
    start, separation, rotation = (
        names.index(n) for n in ("start_time_s", "pulse_separation_s", "rotation_period_s")
    )
    exchanged = case.searched.copy()
    exchanged[0, start] -= case.searched[0, separation]
    exchanged[0, separation] = case.searched[0, rotation] - case.searched[0, separation]
    a, b = objective.solve(case.searched), objective.solve(exchanged)
    np.testing.assert_allclose(a.sum_of_squares, b.sum_of_squares, rtol=1e-9)
    np.testing.assert_allclose(a.coefficients[:, -1], -b.coefficients[:, -1], rtol=1e-9)


def test_the_sum_of_squares_is_continuous_where_a_sample_crosses_the_window_end() -> None:
    case = random_case(2)
    objective = Objective(case.model, case.time_s, case.speed_rpm)
    period = objective.period_s
    column = case.model.searched.index("start_time_s")
    fine = np.repeat(case.searched, 4001, axis=0)
    fine[:, column] += np.linspace(0.0, 2.0 * period, 4001)
    steps = np.abs(np.diff(objective.sum_of_squares(fine)))
    coarse = np.abs(np.diff(objective.sum_of_squares(fine[::10])))
    # A jump would be as large in steps a tenth as long; a continuous function's steps shrink.
    assert steps.max() < 0.2 * coarse.max()


def test_a_pulse_starts_at_zero_decays_and_ends_with_its_window() -> None:
    time_s = np.arange(-0.1, 0.5, 1e-4)
    pulse = impact(time_s, 12.0, 60.0, 0.204, 1e-3)
    assert np.all(pulse[time_s < -0.001] == 0.0)
    assert np.all(pulse[time_s > 0.2046] == 0.0)
    inside = (time_s >= 0.001) & (time_s <= 0.203)
    expected = np.exp(-12.0 * time_s[inside]) * np.sin(60.0 * time_s[inside])
    np.testing.assert_allclose(pulse[inside], expected, rtol=1e-12, atol=1e-15)


def test_a_pulse_meets_a_smooth_signal_alike_wherever_it_falls_between_samples() -> None:
    """Σ_n q(t_n − s) c(t_n) over a cubic c on the corner does not depend on s within a sample."""
    period = 1e-3
    shifts = np.linspace(0.0, 1.0, 41) * period
    time_s = np.arange(-20, 400) * period

    def met(shift: float, corner: bool) -> float:
        pulse = impact(time_s - shift, 12.0, 70.0, 0.2035, period)
        if not corner:
            pulse[np.abs(time_s - shift) < period] = 0.0
            u = time_s - shift
            near = (u >= 0.0) & (u < period)
            pulse[near] = np.exp(-12.0 * u[near]) * np.sin(70.0 * u[near])
        u = (time_s - shift) / period
        smooth = np.where(u < 30.0, (1.0 - u / 30.0) ** 3, 0.0)
        return float(pulse @ smooth)

    with_corner = np.ptp([met(s, True) for s in shifts])
    without = np.ptp([met(s, False) for s in shifts])
    assert with_corner < 0.02 * without


def test_the_curvature_of_the_misfit_is_its_second_derivative() -> None:
    # The ringing is over at the window's end, which the curvature takes for still, and no impact
    # falls on a sample, where the second derivative jumps.
    symbols = {
        "amplitude_rpm": 30.0,
        "start_time_s": 0.4003,
        "decay_rate_per_s": 70.0,
        "angular_frequency_rad_per_s": 71.0,
        "mean_speed_rpm": 2000.0,
        "window_start_s": 0.0,
        "window_end_s": 0.204,
        "pulse_separation_s": 0.90048,
        "rotation_period_s": 1.80013,
    }
    model = DisturbanceModel(0)
    time_s = np.arange(8000) * 1e-3
    residual = 3.0 * np.cos(5.0 * time_s) + np.sin(40.0 * time_s)

    def met(values: dict[str, float]) -> float:
        return float(residual @ model_speed(time_s, values))

    names = jacobian_columns(model)
    curvature = misfit_curvature(model, time_s, symbols, residual)
    steps = {
        "start_time_s": 1e-5,
        "decay_rate_per_s": 0.03,
        "angular_frequency_rad_per_s": 0.03,
        "pulse_separation_s": 1e-5,
        "rotation_period_s": 1e-6,
    }
    scale = np.array([1.0 / steps.get(name, np.inf) for name in names])
    largest = np.abs(curvature / np.outer(scale, scale).clip(1e-300)).max()
    for a, da in steps.items():
        for b, db in steps.items():
            numeric = 0.0
            for sign_a, sign_b in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
                moved = dict(symbols)
                moved[a] += sign_a * da
                moved[b] += sign_b * db
                numeric += 0.25 * sign_a * sign_b * met(moved)
            analytic = curvature[names.index(a), names.index(b)] * da * db
            assert abs(numeric - analytic) < 2e-3 * largest, (a, b)


def test_the_jacobian_is_the_derivative_of_the_model() -> None:
    case = random_case(4)
    s = case.symbols
    model = case.model
    period = (case.time_s[-1] - case.time_s[0]) / (case.time_s.size - 1)
    baseline = np.arange(1.0, 2.0 * model.baseline_harmonics + 1.0)

    def h(symbols: dict[str, float]) -> np.ndarray:
        columns = baseline_columns(
            case.time_s, symbols["rotation_period_s"], model.baseline_harmonics
        )
        return (
            symbols["mean_speed_rpm"]
            + columns[:, 1:] @ baseline
            + symbols["amplitude_rpm"] * waveform(case.time_s, symbols, period)
        )

    analytic = jacobian(model, case.time_s, s, baseline)
    for i, name in enumerate(jacobian_columns(model)):
        if name not in SYMBOLS:
            continue
        step = 1e-6 * max(abs(s[name]), 1e-2)
        numeric = (h({**s, name: s[name] + step}) - h({**s, name: s[name] - step})) / (2 * step)
        off = np.abs(numeric - analytic[:, i]) > 1e-4 * np.abs(numeric).max()
        # One sample per pulse lies on the window's ramp, whose movement is left out by design,
        # and one at its start, where the derivative itself jumps.
        pulses = 2 * (case.time_s[-1] - case.time_s[0]) / s["rotation_period_s"] + 4
        assert off.sum() <= 2 * pulses, name


def test_every_symbol_can_be_freed_or_fixed() -> None:
    for name in SYMBOLS:
        fixed = {"window_start_s": 0.0, "window_end_s": 0.204}
        if name in ("window_start_s", "window_end_s"):
            del fixed[name]
            fixed["start_time_s"] = 0.1
            assert name in DisturbanceModel(fixed=fixed).searched
        else:
            assert name in DisturbanceModel(fixed=fixed).free
            if name != "amplitude_rpm":  # without which there is nothing to measure
                assert name not in DisturbanceModel(fixed={**fixed, name: 1.0}).free


@pytest.mark.parametrize("harmonics", [0, 1, 3])
def test_samples_left_out_count_for_nothing(harmonics: int) -> None:
    generator = np.random.default_rng(harmonics)
    time_s = 0.002 * np.arange(4000)
    speed = 2000.0 + generator.normal(0.0, 3.0, time_s.size)
    excluded = generator.uniform(size=time_s.size) < 0.02
    excluded[:7] = excluded[1500:1540] = True
    wild = np.where(excluded, 1e4, speed)
    objective = Objective(DisturbanceModel(harmonics), time_s, wild, excluded=excluded)
    low, high = [0.0, 5.0, 40.0, 0.0, 0.6], [3.0, 20.0, 90.0, 3.0, 3.9]
    points = generator.uniform(low, high, (30, 5))
    solution = objective.solve(points)
    for row in range(len(points)):
        symbols, _ = objective.solved(points[row])
        baseline = baseline_columns(time_s, symbols["rotation_period_s"], harmonics)
        pulses = pulse_train(time_s, symbols, objective.period_s)
        kept = np.column_stack([baseline, pulses])[~excluded]
        expected, left, *_ = np.linalg.lstsq(kept, speed[~excluded])
        np.testing.assert_allclose(solution.coefficients[row], expected, atol=1e-8)
        np.testing.assert_allclose(solution.sum_of_squares[row], left[0], rtol=1e-10)
