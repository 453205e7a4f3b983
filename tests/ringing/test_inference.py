"""From a recording to the posterior: noise, covariance, optimum, sampling and what is said of it.

All recordings are of the disturbance model itself, so the truth is known. Statistical tests have
fixed seeds and say how often they would fail if nothing were wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from made_recordings import draw_symbols, synthetic_recording
from scipy import stats
from scipy.linalg import toeplitz
from synthetic_ringing import TRUTH

from bayesbl.errors import ConfigError, RecordingError
from bayesbl.noise.process import NO_NOISE, NoiseModel
from bayesbl.noise.rotation_noise import (
    Noise,
    autocorrelation,
    correlated,
    estimate_noise,
    innovation_share,
)
from bayesbl.recording.types import MOTOR_SPEED, Recording
from bayesbl.ringing import optimum as optimum_module
from bayesbl.ringing.covariance import Covariance, covariance, repeating_misfit
from bayesbl.ringing.estimator import Estimator, Fit, PointEstimate
from bayesbl.ringing.guess import guesses
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import Optimum, find_optimum, local_search
from bayesbl.ringing.posterior import sample_posterior
from bayesbl.ringing.search import refine
from bayesbl.ringing.symbols import (
    AMPLITUDE,
    DECAY,
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
from bayesbl.ringing.waveform import model_speed, pulse_train
from bayesbl.sampling.chains import SamplerSettings
from bayesbl.sampling.convergence import (
    Contender,
    Diagnostics,
    integrated_time,
    judge,
    rank_r_hat_and_ess,
)
from bayesbl.sentences import flaws_in_words

BASELINE_RPM = (5.0, -3.0)
WHITE = NoiseModel(1.5)
SLOW = NoiseModel(1.5, (0.9,))


def recording(noise: NoiseModel, seed: int = 0, **options: Any) -> Recording:
    options = {"baseline_rpm": BASELINE_RPM, **options}
    return synthetic_recording(TRUTH, noise, np.random.default_rng(seed), **options)


def objective_of(
    measured: Recording, model: DisturbanceModel | None = None, **kwargs: Any
) -> Objective:
    model = model or DisturbanceModel(**kwargs)
    return Objective(model, measured.time_s, measured.motor_speed_rpm)


def true_point(model: DisturbanceModel, truth: Mapping[str, float] = TRUTH) -> np.ndarray:
    return np.array([truth[name] for name in model.searched])


def seeded(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.fixture
def searching_from(monkeypatch: pytest.MonkeyPatch) -> Callable[[np.ndarray], None]:
    """Lets the search start from a given point instead of its own guesses."""

    def start_at(point: np.ndarray) -> None:
        monkeypatch.setattr(optimum_module, "guesses", lambda objective, count: point[None])

    return start_at


@pytest.fixture(scope="module")
def point() -> PointEstimate:
    """All but the sampling of one recording, found by the search as users run it."""
    return Estimator().estimate(recording(SLOW, 3), np.random.SeedSequence(1))


@pytest.fixture(scope="module")
def fit() -> Fit:
    """A whole fit with the settings that users get."""
    return Estimator().fit(recording(SLOW, 3), np.random.SeedSequence(1))


# Noise


def with_misfit(noise: NoiseModel, seed: int, size_rpm: float = 3.0) -> np.ndarray:
    """A residual at 1 kHz in which something repeats exactly, 3600 samples a rotation."""
    phase = 2.0 * np.pi * np.arange(18_000) / 3600.0
    repeating = np.sin(9.0 * phase) + 0.5 * np.cos(23.0 * phase + 1.0)
    return size_rpm * repeating + noise.draw(phase.size, seeded(seed))


def test_noise_is_told_from_a_misfit_that_repeats_however_large() -> None:
    true = NoiseModel(1.5, (0.9, -0.3))
    for size_rpm in (0.0, 3.0, 30.0):
        found = estimate_noise(with_misfit(true, 1, size_rpm), 3.6, 1e-3)
        assert found.order == 2
        # Standard error of each coefficient about 0.008, of the scale 1.2 %.
        np.testing.assert_allclose(found.coefficients, true.coefficients, atol=0.04)
        assert math.isclose(found.sd_rpm, 1.5, rel_tol=0.05)


def test_a_model_fitted_to_the_residual_itself_would_take_the_misfit_for_noise() -> None:
    residual = with_misfit(NoiseModel(1.5, (0.6,)), 2)
    correlation = float(residual[1:] @ residual[:-1] / (residual @ residual))
    assert correlation > 0.85
    assert residual.std() > 2.0
    found = estimate_noise(residual, 3.6, 1e-3)
    np.testing.assert_allclose(found.coefficients, [0.6], atol=0.03)
    assert math.isclose(found.sd_rpm, 1.5, rel_tol=0.05)


@pytest.mark.parametrize("coefficients", [(), (0.6,), (0.9, -0.3), (0.5, 0.0, 0.0, 0.0, 0.3)])
def test_the_order_of_the_noise_is_found(coefficients: tuple[float, ...]) -> None:
    # BIC takes an order too many in about 1 % of recordings; 3 wrong of 12: false alarm 2e-4.
    true = NoiseModel(1.0, coefficients)
    found = [estimate_noise(with_misfit(true, seed), 3.6, 1e-3).order for seed in range(12)]
    assert np.sum(np.array(found) != len(coefficients)) <= 2


def test_noise_of_a_given_kind_is_not_chosen_by_the_criterion() -> None:
    residual = with_misfit(NoiseModel(1.5, (0.6,)), 3)
    white = estimate_noise(residual, 3.6, 1e-3, "white")
    third = estimate_noise(residual, 3.6, 1e-3, "ar", 3)
    assert (white.order, white.kind, third.order, third.kind) == (0, "white", 3, "ar")
    assert white.sd_rpm == third.sd_rpm


def test_a_recording_without_a_second_rotation_cannot_tell_its_noise() -> None:
    with pytest.raises(RecordingError, match="two rotations"):
        estimate_noise(np.ones(3700), 3.6, 1e-3)


def test_autocorrelation_of_first_order_noise_is_geometric() -> None:
    for phi in (0.9, 0.3, -0.5):
        np.testing.assert_allclose(
            autocorrelation(np.array([phi]), 40), phi ** np.arange(40), atol=1e-12
        )
    assert math.isclose(innovation_share(np.array([0.9])), 1.0 - 0.81)


def test_autocorrelation_agrees_with_a_long_simulation() -> None:
    coefficients = np.array([0.7, -0.2, 0.3])
    noise = Noise(2.0, coefficients, np.zeros(16), 0)
    x = NoiseModel(2.0, tuple(coefficients)).draw(1_000_000, seeded(4))
    measured = [float(x[k:] @ x[: x.size - k]) / x.size for k in range(12)]
    # Standard errors are at most 0.5 % of the variance; four of them.
    np.testing.assert_allclose(measured, noise.covariance_times(np.eye(12))[0], atol=0.02 * 4.0)


@pytest.mark.parametrize("size", [1, 2, 97, 500])
@pytest.mark.parametrize("differentiated", [False, True])
def test_columns_are_correlated_as_by_the_whole_matrix(size: int, differentiated: bool) -> None:
    coefficients = np.array([0.7, -0.2, 0.3])
    columns = np.random.default_rng(size).standard_normal((size, 3))
    whole = toeplitz(autocorrelation(coefficients, size, differentiated))
    found = correlated(coefficients, columns, differentiated)
    np.testing.assert_allclose(found, whole @ columns, atol=1e-12)
    np.testing.assert_allclose(correlated(coefficients, columns[:, 0], differentiated), found[:, 0])


def test_the_misfit_that_repeats_is_found_and_nothing_where_nothing_repeats() -> None:
    time_s = np.arange(18_000) / 1000.0
    phase = 2.0 * np.pi * time_s / 3.6
    wave = 2.0 * np.sin(7.0 * phase) * np.exp(-((np.mod(phase, 2.0 * np.pi) - 2.0) ** 2))
    noise = WHITE.draw(time_s.size, seeded(5))
    found = repeating_misfit(time_s, wave + noise, 3.6)
    shape = 2.0 * np.sin(7.0 * found.phase_rad) * np.exp(-((found.phase_rad - 2.0) ** 2))
    assert math.isclose(found.rms_rpm, float(wave.std()), rel_tol=0.1)
    # Five rotations of ten samples a bin: the average of a bin is known to 0.2 rpm.
    assert np.max(np.abs(found.mean_rpm - shape)) < 5.0 * 0.21
    assert repeating_misfit(time_s, noise, 3.6).rms_rpm < 0.15


# Covariance


def covariance_at_truth(noise: NoiseModel, measured: Recording) -> Covariance:
    """The sandwich at the truth under the noise as it is."""
    known = Noise(noise.standard_deviation, np.array(noise.coefficients), np.zeros(16), 0)
    objective = objective_of(measured)
    solution = objective.solve(true_point(objective.model)[None])
    at_truth = Optimum(
        model=objective.model,
        symbols=TRUTH,
        baseline_rpm=np.array(BASELINE_RPM),
        sum_of_squares=float(solution.sum_of_squares[0]),
        samples=objective.samples,
        speed_sd_rpm=1.0,
        history=None,  # type: ignore[arg-type]
        rivals=(),
        seconds=0.0,
        method="guess",
    )
    return covariance(at_truth, objective.time_s, np.zeros(objective.samples), known)


def test_under_white_noise_the_sandwich_is_the_inverse_curvature() -> None:
    spread = covariance_at_truth(WHITE, recording(WHITE))
    np.testing.assert_allclose(spread.sandwich, spread.scale * spread.inverse_curvature, rtol=1e-6)
    # Impacts without any residual do not scatter: what they might is a hundredth or two.
    assert 1.0 <= spread.scale / 1.5**2 < 1.02
    np.testing.assert_allclose(spread.calibration, np.eye(len(spread.names)), atol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("noise", [WHITE, SLOW], ids=["white", "AR(1) 0.9"])
def test_optima_scatter_as_the_sandwich_predicts(noise: NoiseModel) -> None:
    count = 150
    spread = covariance_at_truth(noise, recording(noise))
    found = []
    for seed in range(count):
        objective = objective_of(recording(noise, 100 + seed))
        values, _ = objective.solved(refine(objective, true_point(objective.model)))
        found.append([values[n] for n in (AMPLITUDE, DECAY, FREQUENCY, START)])
    scatter = np.var(found, axis=0, ddof=1)
    predicted = [spread.standard_deviations[n] ** 2 for n in (AMPLITUDE, DECAY, FREQUENCY, START)]
    # Chi-square band of 99.8 % for each of the four: false alarm 0.8 %.
    low, high = stats.chi2.ppf([0.001, 0.999], count - 1) / (count - 1)
    assert np.all(scatter > low * np.array(predicted))
    assert np.all(scatter < high * np.array(predicted))
    bias = np.mean(found, axis=0) - [TRUTH[n] for n in (AMPLITUDE, DECAY, FREQUENCY, START)]
    assert np.all(np.abs(bias) < 3.6 * np.sqrt(np.array(predicted) / count))  # 0.13 % in all


def test_symbols_that_the_recording_does_not_determine_are_refused() -> None:
    measured = recording(WHITE)
    objective = objective_of(measured)
    found = find_optimum(objective, "guess", seeded())
    # t2 beyond the end of every pulse's ringing, and no pulse at all: nothing to learn from.
    silent = {**found.symbols, AMPLITUDE: 0.0}
    lost = Optimum(**{**{n: getattr(found, n) for n in found.__slots__}, "symbols": silent})
    noise = Noise(1.5, np.zeros(0), np.zeros(16), 0)
    with pytest.raises(RecordingError, match="does not determine"):
        covariance(lost, objective.time_s, np.zeros(objective.samples), noise)


@pytest.mark.long
def test_intervals_cover_the_truth_as_often_as_they_say(
    searching_from: Callable[[np.ndarray], None],
) -> None:
    # 40 recordings, 90 % intervals of A, τ and ω from the sandwich. Less than 30 of 40 has 0.15 %
    # for each of the three: false alarm 0.4 %. The whole study is experiments/calibration.py.
    covered = np.zeros(3)
    for seed in range(40):
        noise = SLOW if seed % 2 else WHITE
        truth = draw_symbols(seeded(seed), 20.0)
        searching_from(true_point(DisturbanceModel(), truth))
        measured = synthetic_recording(truth, noise, seeded(500 + seed), baseline_rpm=BASELINE_RPM)
        found = Estimator().estimate(measured, np.random.SeedSequence(seed))
        sd = found.spread.standard_deviations
        for i, name in enumerate((AMPLITUDE, DECAY, FREQUENCY)):
            covered[i] += abs(found.optimum.symbols[name] - truth[name]) < 1.645 * sd[name]
    assert np.all(covered >= 30), covered


# Optimum


def test_without_noise_the_search_finds_the_truth() -> None:
    found = find_optimum(objective_of(recording(NO_NOISE)), "guess", seeded())
    for name in SYMBOLS:
        assert math.isclose(found.symbols[name], TRUTH[name], rel_tol=1e-6), name
    np.testing.assert_allclose(found.baseline_rpm, BASELINE_RPM, rtol=1e-5)
    assert found.rmse_rpm < 1e-4


def test_the_guesses_need_no_rotation_period() -> None:
    for seed, rotation in enumerate((0.9, 1.7, 2.9, 4.1, 5.8)):
        truth = {**TRUTH, ROTATION: rotation, SEPARATION: 0.4 * rotation, START: 0.3 * rotation}
        measured = synthetic_recording(truth, WHITE, seeded(seed), rotations=4.3)
        objective = objective_of(measured)
        starts = guesses(objective, 4)
        periods = starts[:, objective.searched.index(ROTATION)]
        first = starts[:, objective.searched.index(START)]
        late = (first - truth[START] + 0.5 * rotation) % rotation - 0.5 * rotation
        near = (np.abs(periods / rotation - 1.0) < 0.01) & (np.abs(late) < 0.5 * np.pi / 62.0)
        assert np.any(near), rotation


def test_equal_solutions_have_one_canonical_form(
    searching_from: Callable[[np.ndarray], None],
) -> None:
    objective = objective_of(recording(SLOW))
    names = objective.searched
    start, separation = names.index(START), names.index(SEPARATION)
    found = []
    for turns, exchanged in ((0, False), (2, False), (-1, False), (0, True), (1, True)):
        point = true_point(objective.model)
        if exchanged:
            point[start] -= point[separation]
            point[separation] *= -1.0
        point[start] += turns * TRUTH[ROTATION]
        point[separation] += turns * TRUTH[ROTATION]
        searching_from(point)
        found.append(find_optimum(objective, "guess", seeded()).symbols)
        assert found[-1][AMPLITUDE] > 0.0
        assert 0.0 < found[-1][SEPARATION] < found[-1][ROTATION]
        assert 0.0 <= found[-1][START] < found[-1][ROTATION]
    for symbols in found[1:]:
        for name in SYMBOLS:
            assert math.isclose(symbols[name], found[0][name], rel_tol=1e-4), name


def test_the_fast_refinement_and_cma_end_in_the_same_optimum() -> None:
    for seed in range(4):
        objective = objective_of(recording(SLOW, seed))
        truth = true_point(objective.model)
        refined, (searched, _) = refine(objective, truth), local_search(objective, truth, seeded())
        ends = np.array([refined, searched])
        a, b = objective.sum_of_squares(ends)
        assert math.isclose(a, b, rel_tol=2e-6)
        amplitude = objective.solve(ends).coefficients[:, -1]
        assert abs(amplitude[0] - amplitude[1]) < 0.02  # a twentieth of its standard deviation


@pytest.mark.long
def test_the_same_seed_gives_the_same_optimum_and_leaves_numpys_random_state_alone(
    point: PointEstimate,
) -> None:
    before = np.random.get_state()  # noqa: NPY002
    again = find_optimum(point.objective, "guess", seeded(9))
    once_more = find_optimum(point.objective, "guess", seeded(9))
    after = np.random.get_state()  # noqa: NPY002
    assert again.symbols == once_more.symbols
    np.testing.assert_array_equal(again.history.rmse_rpm, once_more.history.rmse_rpm)
    np.testing.assert_array_equal(before[1], after[1])
    assert before[2:] == after[2:]
    other = find_optimum(point.objective, "guess", seeded(10))
    assert math.isclose(other.rmse_rpm, again.rmse_rpm, rel_tol=1e-7)


def test_the_history_of_a_search_falls_to_its_optimum(point: PointEstimate) -> None:
    history, found = point.optimum.history, point.optimum
    for run in np.unique(history.run):
        assert np.all(np.diff(history.rmse_rpm[history.run == run]) <= 0.0)
        assert np.all(np.diff(history.evaluations[history.run == run]) > 0.0)
    assert math.isclose(history.rmse_rpm.min(), found.rmse_rpm, rel_tol=1e-9)
    residual = point.objective.speed_rpm - found.predict(point.objective.time_s)
    assert math.isclose(float(np.sqrt(np.mean(residual**2))), found.rmse_rpm, rel_tol=1e-9)
    assert all(rival.sum_of_squares >= found.sum_of_squares for rival in found.rivals)


def test_symbols_stay_where_they_are_fixed_and_inside_their_ranges() -> None:
    measured = recording(WHITE)
    fixed = {WINDOW_START: 0.0, WINDOW_END: 0.204, FREQUENCY: 60.0}
    later = (TRUTH[START] + 2.8, TRUTH[START] + 4.2)  # holds t0 + T_w, not t0
    ranges = {DECAY: (4.0, 9.0), START: later}
    found = find_optimum(objective_of(measured, fixed=fixed, ranges=ranges), "guess", seeded())
    assert found.symbols[FREQUENCY] == 60.0
    assert found.symbols[WINDOW_END] == 0.204
    assert 8.9 < found.symbols[DECAY] <= 9.0  # the truth, 12, is out of reach
    assert math.isclose(found.symbols[START], TRUTH[START] + TRUTH[ROTATION], abs_tol=0.01)


@pytest.mark.parametrize("free", [WINDOW_START, WINDOW_END])
def test_the_pulse_window_can_be_free(free: str) -> None:
    # t0 and t1 only enter as their sum, so t0 is fixed where t1 is free.
    fixed = {WINDOW_START: 0.0, WINDOW_END: 0.204, START: TRUTH[START] - 0.03}
    del fixed[free]
    if free == WINDOW_END:
        del fixed[START]
    ranges = {WINDOW_START: (0.0, 0.1), WINDOW_END: (0.1, 0.4)}
    model = DisturbanceModel(fixed=fixed, ranges={free: ranges[free]})
    found = Estimator(model).estimate(recording(WHITE), np.random.SeedSequence(2))
    expected = 0.03 if free == WINDOW_START else TRUTH[WINDOW_END]
    assert math.isclose(found.optimum.symbols[free], expected, abs_tol=0.01)
    assert found.spread.standard_deviations[free] > 0.0


@pytest.mark.parametrize(
    "name", [n for n in SYMBOLS if n not in (AMPLITUDE, WINDOW_START, WINDOW_END)]
)
def test_any_other_symbol_can_be_fixed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(optimum_module, "GUESSES_REFINED", 1)
    fixed = {WINDOW_START: 0.0, WINDOW_END: 0.204, name: TRUTH[name]}
    found = find_optimum(objective_of(recording(WHITE), fixed=fixed), "guess", seeded())
    assert found.symbols[name] == TRUTH[name]
    assert math.isclose(found.symbols[AMPLITUDE], TRUTH[AMPLITUDE], rel_tol=0.1)
    assert math.isclose(found.symbols[ROTATION], TRUTH[ROTATION], rel_tol=1e-3)


def test_a_fixed_amplitude_leaves_nothing_to_measure() -> None:
    with pytest.raises(ConfigError, match="nothing to measure"):
        Estimator(DisturbanceModel(fixed={WINDOW_START: 0.0, WINDOW_END: 0.2, AMPLITUDE: 20.0}))


def test_the_fingerprint_follows_what_a_means_and_nothing_else() -> None:
    measured = recording(WHITE)
    longer = recording(SLOW, 1, rotations=6.0)
    own = Estimator().fingerprint(measured)
    assert own == Estimator(search="paper", noise_kind="white").fingerprint(longer)
    assert own != Estimator(DisturbanceModel(0)).fingerprint(measured)
    window = {WINDOW_START: 0.0, WINDOW_END: 0.15}
    assert own != Estimator(DisturbanceModel(fixed=window)).fingerprint(measured)
    assert own != Estimator().fingerprint(recording(WHITE, sampling_hz=500.0))
    ranged = DisturbanceModel(ranges={DECAY: (5.0, 8.0)})
    assert own != Estimator(ranged).fingerprint(measured)
    begin = DisturbanceModel(ranges={START: (4.1, 5.5)})  # another one in every recording
    assert own == Estimator(begin).fingerprint(measured)


def test_fingerprints_in_stored_curves_stay_what_they_are() -> None:
    assert Estimator().fingerprint(recording(WHITE)) == (
        '{"baseline_harmonics": 1, "fixed": {"window_end_s": 0.204, "window_start_s": 0.0}, '
        '"nominal_speed_rpm": 2000.0, "sampling_hz": 1000.0, '
        '"waveform": "eq. 3, edges resolved to the sampling"}'
    )


# Posterior


def test_the_same_seed_gives_the_same_draws_and_leaves_numpys_random_state_alone(
    point: PointEstimate,
) -> None:
    settings = SamplerSettings(ensembles=2, max_steps=250)
    before = np.random.get_state()  # noqa: NPY002

    def draws(seed: int) -> dict[str, np.ndarray]:
        return sample_posterior(point, settings, np.random.SeedSequence(seed)).draws

    first = draws(5)
    np.testing.assert_array_equal(before[1], np.random.get_state()[1])  # noqa: NPY002
    np.random.seed(77)  # noqa: NPY002
    again, other = draws(5), draws(6)
    np.random.set_state(before)  # noqa: NPY002
    for name in first:
        np.testing.assert_array_equal(first[name], again[name])
        assert not np.array_equal(first[name], other[name])


@pytest.mark.long
def test_a_strong_signal_is_sampled_to_convergence(fit: Fit) -> None:
    diagnostics = fit.posterior.diagnostics
    assert diagnostics.outcome == "converged", diagnostics.reasons
    assert max(diagnostics.r_hat.values()) < 1.01
    assert min(diagnostics.ess_bulk.values()) > 400.0
    assert diagnostics.steps > 50.0 * diagnostics.autocorrelation_steps
    assert np.all((diagnostics.acceptance > 0.1) & (diagnostics.acceptance < 0.7))
    assert fit.posterior.baseline_rpm.shape == (*fit.posterior.draws[AMPLITUDE].shape, 2)


def test_draws_have_the_centre_of_the_optimum_and_the_width_of_the_sandwich(fit: Fit) -> None:
    optimum, spread, draws = fit.point.optimum, fit.point.spread, fit.posterior.draws
    # About 2000 effective draws: a mean is known to 0.022 sd and a width to 1.6 %. The window's
    # edges leave kinks in the sum of squares, which Gauss-Newton does not see: 10 % where they act.
    for name, values in draws.items():
        sd = spread.standard_deviations[name]
        assert abs(values.mean() - optimum.symbols[name]) < 0.25 * sd, name
        assert abs(values.std() / sd - 1.0) < (0.06 if name == AMPLITUDE else 0.12), name


def test_all_draws_together_scatter_as_the_sandwich_also_where_symbols_are_correlated() -> None:
    # A ringing almost as slow as the baseline, under slow noise: A, v_t and the baseline hang
    # together. τ lies close to its lower bound, but by 30 standard deviations.
    symbols = {**TRUTH, FREQUENCY: 4.0, DECAY: 2.5, WINDOW_END: 1.2}
    fixed = {n: v for n, v in symbols.items() if n not in (AMPLITUDE, MEAN, DECAY)}
    noise = NoiseModel(0.2, (0.9,))
    measured = synthetic_recording(
        symbols, noise, seeded(2), rotations=2.3, baseline_rpm=BASELINE_RPM
    )
    found = Estimator(DisturbanceModel(1, fixed)).fit(measured, np.random.SeedSequence(1))
    assert found.posterior.diagnostics.outcome == "converged"
    spread, draws = found.point.spread, found.posterior.draws
    drawn = np.column_stack(
        [
            *(draws[n].ravel() for n in spread.names if n in SYMBOLS),
            found.posterior.baseline_rpm.reshape(-1, 2),
        ]
    )
    root = np.linalg.cholesky(spread.sandwich)
    whitened = np.linalg.solve(root, np.cov(drawn.T)) @ np.linalg.inv(root).T
    # About 3000 effective draws: entries are known to 0.018, on the diagonal 0.026.
    np.testing.assert_allclose(whitened, np.eye(len(spread.names)), atol=0.12)


@pytest.mark.long
def test_linear_symbols_are_integrated_out_as_a_grid_over_all_symbols_does() -> None:
    # A weak, short and coarsely sampled recording: far enough from a normal posterior that the
    # determinant of the linear symbols moves it (without it, the mean of τ by 0.25 sd).
    symbols = {**TRUTH, AMPLITUDE: 5.0, FREQUENCY: 31.0, DECAY: 9.0}
    measured = synthetic_recording(
        symbols, NoiseModel(2.0), seeded(7), rotations=2.2, sampling_hz=250.0
    )
    fixed = {n: TRUTH[n] for n in (START, WINDOW_START, WINDOW_END, SEPARATION, ROTATION)}
    point = Estimator(DisturbanceModel(0, fixed), noise_kind="white").estimate(
        measured, np.random.SeedSequence(1)
    )
    settings = SamplerSettings(max_steps=3000)
    posterior = sample_posterior(point, settings, np.random.SeedSequence(2))
    y = measured.motor_speed_rpm - 2000.0
    axes = {
        DECAY: np.linspace(2.0, 32.0, 61),
        FREQUENCY: np.linspace(16.0, 46.0, 61),
        AMPLITUDE: np.linspace(-2.0, 16.0, 73),
        MEAN: np.linspace(-0.4, 0.4, 17) + y.mean(),
    }
    log_likelihood = np.empty([axis.size for axis in axes.values()])
    amplitude, mean = np.meshgrid(axes[AMPLITUDE], axes[MEAN], indexing="ij")
    for i, decay in enumerate(axes[DECAY]):
        for j, frequency in enumerate(axes[FREQUENCY]):
            symbols = TRUTH | {DECAY: decay, FREQUENCY: frequency}
            q = pulse_train(measured.time_s, symbols, measured.sampling_period_s)
            log_likelihood[i, j] = (
                2.0 * (amplitude * (q @ y) + mean * y.sum() - amplitude * mean * q.sum())
                - amplitude**2 * (q @ q)
                - mean**2 * y.size
            )
    weight = np.exp(0.5 * (log_likelihood - log_likelihood.max()) / point.spread.scale)
    for i, (name, axis) in enumerate(axes.items()):
        marginal = weight.sum(axis=tuple(k for k in range(4) if k != i))
        marginal /= marginal.sum()
        expected = float(marginal @ axis)
        sd = math.sqrt(float(marginal @ (axis - expected) ** 2))
        drawn = posterior.draws[name] - (2000.0 if name == MEAN else 0.0)
        assert marginal[0] + marginal[-1] < 5e-3, name
        assert abs(drawn.mean() - expected) < 0.1 * sd, name
        assert abs(drawn.std() / sd - 1.0) < 0.08, name


@pytest.mark.long
def test_a_fit_with_a_free_window_end_is_sampled() -> None:
    model = DisturbanceModel(fixed={WINDOW_START: 0.0}, ranges={WINDOW_END: (0.1, 0.4)})
    estimator = Estimator(model, sampler=SamplerSettings(ensembles=2, max_steps=1000))
    found = estimator.fit(recording(WHITE), np.random.SeedSequence(3))
    draws = found.posterior.draws[WINDOW_END]
    assert abs(draws.mean() - TRUTH[WINDOW_END]) < 0.01
    assert found.posterior.diagnostics.outcome != "withheld"


# Diagnostics


def judged(**changes: Any) -> Diagnostics:
    numbers: dict[str, Any] = {
        "r_hat": {AMPLITUDE: 1.001},
        "ess_bulk": {AMPLITUDE: 2000.0},
        "autocorrelation_steps": 20.0,
        "steps": 2000,
        "acceptance": np.array([0.4, 0.4]),
        "bounds_stable": True,
        "signal_to_noise": 50.0,
        "at_bound": {DECAY: 0.0},
    }
    numbers |= changes
    of_judge = {"bounds_stable", "signal_to_noise", "at_bound", "other_answer"} & set(numbers)
    besides = {name: numbers.pop(name) for name in of_judge}
    return judge(Diagnostics(**numbers), **besides)


def test_a_good_chain_is_converged_without_reasons() -> None:
    assert judged().outcome == "converged"
    assert judged().reasons == ()


def test_ensembles_in_different_modes_are_withheld_though_each_mixes_well() -> None:
    draws = seeded(8).standard_normal((4, 1000))
    draws[2:] += 6.0
    r_hat, ess = rank_r_hat_and_ess({AMPLITUDE: draws})
    verdict = judged(r_hat=r_hat, ess_bulk=ess)
    assert r_hat[AMPLITUDE] > 1.05
    assert verdict.outcome == "withheld"
    assert "several modes" in flaws_in_words(verdict.reasons)[0]


@pytest.mark.parametrize(
    ("changes", "outcome", "said"),
    [
        ({"steps": 800}, "usable", "chain is short"),
        ({"steps": 300}, "withheld", "chain is short"),
        ({"autocorrelation_steps": math.inf}, "withheld", "never moved"),
        ({"autocorrelation_steps": math.nan}, "withheld", "never moved"),
        ({"acceptance": np.array([0.4, 0.01])}, "withheld", "Ensemble 2 of 2 is stuck"),
        ({"r_hat": {AMPLITUDE: 1.03}}, "usable", "below 1.01"),
        ({"r_hat": {AMPLITUDE: math.nan}}, "withheld", "ensembles disagree"),
        ({"ess_bulk": {AMPLITUDE: 90.0}}, "usable", "effective draws"),
        ({"bounds_stable": False}, "usable", "still moved"),
        ({"signal_to_noise": 5.9}, "withheld", "too weak"),
        ({"at_bound": {DECAY: 0.1}}, "usable", "the range, not the recording"),
        ({"at_bound": {DECAY: 0.24}}, "withheld", "the range, not the recording"),
        ({"other_answer": Contender(12.0, -1.0)}, "withheld", "another optimum, A = 12 rpm"),
    ],
)
def test_each_flaw_is_judged_and_said(changes: dict[str, Any], outcome: str, said: str) -> None:
    verdict = judged(**changes)
    assert verdict.outcome == outcome
    assert len(verdict.reasons) == 1
    assert said in flaws_in_words(verdict.reasons)[0]


def test_a_walker_that_never_moves_makes_the_autocorrelation_time_infinite() -> None:
    chain = seeded(9).standard_normal((500, 8, 2))
    assert integrated_time(chain) < 5.0
    chain[:, 3] = 1.0
    assert integrated_time(chain) == math.inf


@pytest.mark.long
def test_ringing_no_stronger_than_its_uncertainty_is_withheld() -> None:
    symbols = {**TRUTH, AMPLITUDE: 1.0}
    estimator = Estimator(sampler=SamplerSettings(ensembles=2, max_steps=500))
    measured = synthetic_recording(symbols, SLOW, seeded(1), baseline_rpm=BASELINE_RPM)
    verdict = estimator.fit(measured, np.random.SeedSequence(1)).posterior.diagnostics
    assert verdict.outcome == "withheld"
    assert any("too weak" in reason for reason in flaws_in_words(verdict.reasons))


@pytest.mark.long
def test_a_range_that_cuts_the_posterior_is_said() -> None:
    model = DisturbanceModel(ranges={DECAY: (5.0, 11.9)})
    estimator = Estimator(model, sampler=SamplerSettings(ensembles=2, max_steps=500))
    verdict = estimator.fit(recording(WHITE), np.random.SeedSequence(1)).posterior.diagnostics
    assert "draws_at_bound" in [flaw.code for flaw in verdict.reasons]


@pytest.mark.long
def test_a_residual_holds_what_the_model_does_not(point: PointEstimate) -> None:
    # The search, the noise and the misfit see the same residual: what is put in comes out.
    measured = point.recording
    # A bump, since a single line is taken for something that shakes the joint, and taken out.
    phase = np.mod(2.0 * np.pi * measured.time_s / TRUTH[ROTATION], 2.0 * np.pi)
    bump = 4.0 * np.exp(-0.5 * ((phase - 4.0) / 0.15) ** 2)
    speed = measured.motor_speed_rpm + bump
    changed = Recording("with misfit", measured.time_s, {MOTOR_SPEED: speed})
    found = Estimator().estimate(changed, np.random.SeedSequence(1))
    assert found.noise.order == 1
    np.testing.assert_allclose(found.noise.coefficients, [0.9], atol=0.02)
    assert 0.5 < found.misfit.rms_rpm < 1.3
    assert found.misfit.rms_rpm > 2.0 * point.misfit.rms_rpm
    clean = model_speed(measured.time_s, found.optimum.symbols, found.optimum.baseline_rpm)
    np.testing.assert_allclose(found.residual_rpm, speed - clean, atol=1e-8)
