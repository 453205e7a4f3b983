"""The direct route: laws of its optimum, its posterior and its predictive check.

Recordings hold three rotations at 250 Hz, so that many can be fitted. Statistical tests have fixed
seeds; each says how often it would fail by chance.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from places import CONFIGS
from scipy.stats import chi2, kstest, lognorm, norm, truncnorm, uniform

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.parameters import DEFAULT_DRIFT
from bayesbl.bench.simulation import Measurement
from bayesbl.config.bench import load_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated
from bayesbl.matching.motions import noise_of
from bayesbl.matching.observed import Observed, observed
from bayesbl.matching.posterior import sample_direct
from bayesbl.matching.predictive_check import agrees, disagreements
from bayesbl.matching.signals import (
    GAP,
    START_ANGLE,
    SimulatedSignals,
    Unknown,
    effect_unknowns,
    gap_unknown,
    start_angle_unknown,
    tolerance_unknowns,
)
from bayesbl.matching.surrogate import simulated_chi_square
from bayesbl.model_search.always_in import directions
from bayesbl.model_search.pipeline import fit_jointly, friction_drift
from bayesbl.noise.channel_noise import ChannelNoise
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, Recording
from bayesbl.sampling.chains import SamplerSettings

SETTINGS = SamplerSettings(ensembles=2)
FRICTION = BenchEffect("load_coulomb_friction", {"torque_nm": EffectParameterValue(15.0, 0.4)})


@cache
def bench(tolerances: bool = False, noise: float = 1.0) -> Bench:
    """The shipped bench; ``noise`` times the noise of the examples."""
    found = load_bench(CONFIGS / ("bench_tolerances.toml" if tolerances else "bench.toml"))
    return replace(
        found,
        measurement=Measurement(
            encoder_counts=None,
            speed_noise=NoiseModel(1.5 * noise, (0.6,)),
            current_noise=NoiseModel(0.05 * noise),
        ),
    )


def record(on: Bench, gap_rad: float, seed: object, name: str = "one") -> Recording:
    generator = np.random.default_rng(seed)
    return on.simulate(
        gap_rad,
        rotations=3.0,
        sampling_hz=250.0,
        start_angle_rad=generator.uniform(0.0, 2.0 * math.pi),
        seed=generator,
        name=name,
    )


def fitted(known: Bench, *recordings: Recording, gap_rad=(1e-4, 1e-2)):
    names = [r.name for r in recordings]
    unknowns = [
        *(replace(gap_unknown(*gap_rad), recording=name) for name in names),
        *(start_angle_unknown(name) for name in names),
        *effect_unknowns(known, names),
        *tolerance_unknowns(known),
    ]
    return fit_aligned(known, [observed(r, known) for r in recordings], unknowns)


def log_gap(posterior, name="one"):
    return np.log(posterior.values(GAP, name)).ravel()


@pytest.mark.long
def test_optima_scatter_as_the_cramer_rao_bound_allows():
    # χ² of 30 errors within its 99.8 % range: fails by chance in 2 of 1000.
    z = []
    for case in range(30):
        gap = float(np.exp(np.random.default_rng([1, case]).uniform(*np.log([2e-4, 3e-3]))))
        fit = fitted(bench(), record(bench(), gap, [2, case]))
        z.append((fit.point[0] - math.log(gap)) / fit.bound[0])
    low, high = chi2.ppf([0.001, 0.999], 30)
    assert low < float(np.sum(np.square(z))) < high


@pytest.mark.long
def test_the_posterior_is_that_of_full_simulations_on_a_grid():
    # Noise ten times larger, so that the posterior is not normal.
    known = bench(noise=10.0)
    fit = fitted(known, record(known, 2.5e-4, 3))
    posterior = sample_direct(fit, SamplerSettings(), np.random.SeedSequence(1))
    draws = posterior.draws.reshape(-1, 2)
    centre, spread = fit.point, np.sqrt(np.diag(fit.covariance))
    steps = np.linspace(-5.0, 5.0, 33)
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    points = centre + spread * grid
    points = points[fit.model.log_prior(points) > -np.inf]
    residual = np.concatenate([fit.model.whitened(p) for p in np.array_split(points, 20)])
    weights = np.exp(-0.5 * ((residual**2).sum(axis=1) - fit.chi_square))
    weights /= weights.sum()
    mean = weights @ points
    sd = np.sqrt(weights @ (points - mean) ** 2)
    # 1000 draws: their mean scatters by 0.03 sd, their sd by 2.3 %; four times that.
    assert np.abs(draws.mean(axis=0) - mean) / sd == pytest.approx(0.0, abs=0.13)
    assert draws.std(axis=0) / sd == pytest.approx(1.0, abs=0.09)
    skewed = float(weights @ ((points[:, 0] - mean[0]) / sd[0]) ** 3)
    assert abs(skewed) > 0.1  # else the grid would test nothing but the normal approximation
    assert posterior.effective > 0.8 * len(draws)


def test_full_simulations_tell_how_far_they_are():
    fit = fitted(bench(), record(bench(), 8e-4, 4))
    told: list[tuple[int, int]] = []
    sample_direct(
        fit,
        SamplerSettings(),
        np.random.SeedSequence(1),
        simulating=lambda made, all_of_them: told.append((made, all_of_them)),
    )
    assert any(made == all_of_them for made, all_of_them in told)
    assert all(0 < made <= all_of_them for made, all_of_them in told)
    assert told[-1][0] == told[-1][1]


@pytest.mark.long
def test_draws_that_are_not_weighted_would_not_be_moved_by_their_weights():
    known = bench(tolerances=True)
    fit = fitted(known, record(known, 8e-4, 4))
    posterior = sample_direct(fit, SETTINGS, np.random.SeedSequence(2))
    draws = posterior.draws.reshape(-1, posterior.draws.shape[-1])
    assert posterior.simulated < len(draws)
    left = simulated_chi_square(fit.model, draws) - posterior.chi_square.ravel()
    weights = np.exp(-0.5 * (left - left.min()))
    moved = weights @ draws / weights.sum() - draws.mean(axis=0)
    # The mean of 1000 draws scatters by 0.032 sd.
    assert moved / draws.std(axis=0) == pytest.approx(0.0, abs=0.032)


class Linear(SimulatedSignals):
    """Signals that are linear in two unknowns: the limit in which everything is known exactly."""

    def __init__(self, unknowns, matrix, data):
        seen = Observed("one", data[None], 1.0, 1.0, 100.0)
        white = ChannelNoise(np.zeros((0, 1, 1)), np.eye(1), np.ones(1), data.size)
        super().__init__(bench(), [seen], unknowns, [white])
        self.matrix = matrix

    def stretch(self, points, recording):
        return (np.atleast_2d(points) @ self.matrix.T)[:, None, :]


def linear_posterior(unknowns, seed=3):
    generator = np.random.default_rng(5)
    matrix = generator.standard_normal((400, 2)) @ np.array([[1.0, 0.8], [0.0, 0.3]])
    data = matrix @ np.array([0.4, -0.2]) + generator.standard_normal(400)
    fit = fit_simulated(Linear(unknowns, matrix, data), np.zeros(2))
    settings = SamplerSettings(ensembles=2)
    return matrix, data, fit, sample_direct(fit, settings, np.random.SeedSequence(seed))


def test_in_the_linear_gaussian_limit_the_posterior_is_exact():
    priors = [Unknown("a", centre=0.5, sd=0.05), Unknown("b", centre=0.0, sd=0.2)]
    matrix, data, fit, posterior = linear_posterior(priors)
    precision = np.diag([0.05**-2.0, 0.2**-2.0])
    covariance = np.linalg.inv(matrix.T @ matrix + precision)
    mean = covariance @ (matrix.T @ data + precision @ np.array([0.5, 0.0]))
    sd = np.sqrt(np.diag(covariance))
    assert fit.point == pytest.approx(mean, abs=1e-3 * sd.min())
    assert fit.covariance == pytest.approx(covariance, rel=1e-6)
    assert fit.bound == pytest.approx(np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix))), rel=1e-6)
    draws = posterior.draws.reshape(-1, 2)
    assert posterior.effective == pytest.approx(len(draws), rel=1e-6)
    # Means of 1000 draws scatter by 0.032 sd; four times that.
    assert (draws.mean(axis=0) - mean) / sd == pytest.approx(0.0, abs=0.13)
    assert draws.std(axis=0) / sd == pytest.approx(1.0, abs=0.09)


def test_in_the_linear_limit_the_log_likelihood_of_each_rotation_is_exact():
    matrix, data, _, posterior = linear_posterior([Unknown("a", 0.0, 1.0), Unknown("b", -1.0, 1.0)])
    draws = posterior.noise_only.draws
    residual = data - draws @ matrix.T
    exact = norm.logpdf(residual).reshape(*draws.shape[:2], 4, 100).sum(axis=-1)
    assert posterior.noise_only.log_likelihood[0] == pytest.approx(exact, abs=1e-6)


def test_log_likelihood_by_rotation_adds_up_to_that_of_the_simulation():
    fit = fitted(bench(), record(bench(), 8e-4, 6))
    posterior = sample_direct(fit, SETTINGS, np.random.SeedSequence(2))
    draws = posterior.noise_only.draws[:, :10].reshape(-1, len(fit.point))
    told = posterior.noise_only.log_likelihood[0][:, :10].sum(axis=-1).ravel()
    noise, seen = fit.model.noise[0], fit.model.recordings[0]
    each = math.log(2.0 * math.pi) + np.log(np.diag(noise.root)).sum()
    exact = -0.5 * simulated_chi_square(fit.model, draws) - each * (seen.samples - noise.order)
    # Within what the surrogate may be off by, where it is taken for the posterior.
    assert np.std(told - exact) < 0.1
    assert np.mean(told - exact) == pytest.approx(0.0, abs=0.5)


def test_draws_of_the_prior_are_of_its_density():
    unknowns = [
        Unknown("flat", 0.35, 0.45),
        Unknown("normal", centre=1.0, sd=0.2),
        Unknown("cut", 0.0, 1.0, centre=0.0, sd=0.5),
        Unknown("value", centre=math.log(0.3), sd=0.2, logarithmic=True),
        Unknown("phase"),
    ]
    model = Linear(unknowns, np.ones((400, 5)), np.zeros(400))
    drawn = model.prior_draws(1000, np.random.default_rng(8))
    laws = [
        uniform(0.35, 0.1),
        norm(1.0, 0.2),
        truncnorm(0.0, 2.0, loc=0.0, scale=0.5),
        lognorm(0.2, scale=0.3),
        uniform(0.0, 2.0 * math.pi),
    ]
    values = [u.value(x) for u, x in zip(unknowns, drawn.T, strict=True)]
    for own, law, density in zip(values, laws, model.log_priors(drawn).T, strict=True):
        assert kstest(own, law.cdf).pvalue > 0.001
        apart = density - law.logpdf(own)
        assert apart == pytest.approx(apart[0], abs=1e-9), "the same up to a constant"


@pytest.mark.long
def test_a_uniform_tolerance_cuts_the_posterior_exactly():
    # Kolmogorov-Smirnov with 1000 draws of each of 8 seeds, 970 of them effective: fails by
    # chance in 1 of 1000. With the upper 5 % of the tail thinned to 3 % its probability is 3e-8.
    priors = [Unknown("a", 0.35, 0.45), Unknown("b", -1e-9, 1e-9)]
    found = [linear_posterior(priors, seed) for seed in range(8)]
    matrix, data, _, _ = found[0]
    drawn = np.concatenate([each[3].draws[..., 0].ravel() for each in found])
    column = matrix[:, 0]
    mean, sd = (column @ data) / (column @ column), (column @ column) ** -0.5
    exact = truncnorm((0.35 - mean) / sd, (0.45 - mean) / sd, loc=mean, scale=sd)
    assert kstest(drawn, exact.cdf).pvalue > 0.001


def test_forward_and_reverse_give_the_same_gap():
    forward = record(bench(), 8e-4, 6)
    mirrored = {n: -forward.channels[n] for n in (MOTOR_SPEED, MOTOR_CURRENT)}
    there, back = fitted(bench(), forward), fitted(bench(), replace(forward, channels=mirrored))
    sd = np.sqrt(np.diag(there.covariance))
    assert back.point[0] == pytest.approx(there.point[0], abs=0.02 * sd[0])
    assert math.remainder(back.point[1] + there.point[1], 2.0 * math.pi) == pytest.approx(
        0.0, abs=0.02 * sd[1]
    )


@pytest.mark.long
def test_coverage_with_seven_parameters_off():
    # 90 % intervals of 16: fewer than 10 hold the truth in 2 of 10 000 studies.
    known, inside = bench(tolerances=True), 0
    for case in range(16):
        generator = np.random.default_rng([7, case])
        gap = float(np.exp(generator.uniform(*np.log([2e-4, 3e-3]))))
        fit = fitted(known, record(known.draw(generator), gap, [8, case]))
        fast = SamplerSettings(ensembles=2, max_steps=500)
        draws = log_gap(sample_direct(fit, fast, np.random.SeedSequence(case)))
        low, high = np.quantile(draws, [0.05, 0.95])
        inside += low < math.log(gap) < high
    assert inside >= 10


@pytest.mark.long
def test_snapshots_of_one_joint_share_what_is_wrong_with_their_bench():
    known = bench(tolerances=True)
    true = known.draw(np.random.default_rng(9))
    recordings = [record(true, g, [10, i], f"{i}") for i, g in enumerate((8e-4, 9e-4))]
    fit = fitted(known, *recordings)
    posterior = sample_direct(fit, SETTINGS, np.random.SeedSequence(1))
    first, last = (posterior.values(GAP, r.name) for r in recordings)
    change = last - first
    assert change.std() < 0.6 * math.hypot(first.std(), last.std())
    # Fails by chance in 1 of 10 000.
    assert abs(change.mean() - 1e-4) < 4.0 * change.std()


@pytest.mark.parametrize(("stated", "sd", "found"), [(0.0, 2e-3, 7e-4), (2e-3, 1e-4, 2.1e-3)])
def test_friction_drifts_in_proportion_to_itself(stated, sd, found):
    """By what the budget says of it, whether it is stated or only its usual size is known."""
    viscous = BenchEffect(
        "motor_viscous_friction", {"coefficient_nm_s_per_rad": EffectParameterValue(stated, sd)}
    )
    known = bench().with_effects(viscous)
    (friction,) = effect_unknowns(known, ["0", "1"])
    (drift,) = friction_drift([friction], directions(known, {}), ["1"])
    seen = [observed(record(known, 6e-4, [17, i], f"{i}"), known) for i in range(2)]
    model = SimulatedSignals(known, seen, [friction, drift], [noise_of(s, s.signals) for s in seen])
    points = np.array([[found, drift.sd]])
    first, second = (model.settings_of(points, each)[friction.name].item() for each in seen)
    assert first == pytest.approx(found)
    assert second == pytest.approx(found * (1.0 + DEFAULT_DRIFT["motor_viscous_friction"]))


SMALL_JOINT = """
schema = 1
kind = "bench"
drive = "two_mass"

[parameters]
gear_ratio = {value = 101}
motor_inertia_kg_m2 = {value = 9.3e-05, relative_tolerance = 0.05}
load_inertia_kg_m2 = {value = 0.836, relative_tolerance = 0.06}
shaft_stiffness_nm_per_rad = {value = 2.05e4, relative_tolerance = 0.12}
shaft_damping_nm_s_per_rad = {value = 5.95, relative_tolerance = 0.8}
gravity_torque_nm = {value = 22.96, relative_tolerance = 0.05}
speed_gain_nm_s_per_rad = {value = 0.0133, relative_tolerance = 0.03}
integral_gain_nm_per_rad = {value = 0.878, relative_tolerance = 0.03}
torque_constant_nm_per_a = {value = 0.199, relative_tolerance = 0.04}
position_gain_per_s = {value = 0}
current_limit_a = {value = 15}
reference_speed_rpm = {value = 1800.0}

[measurement]
speed_noise = {kind = "white", sd_rpm = 1.0}
current_noise = {kind = "white", sd_a = 0.05}
"""


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_friction_that_drifts_leaves_the_gaps_where_they_are(tmp_path, seed):
    """The mean current moves by far more than its noise; the load's friction has valleys."""
    (tmp_path / "bench.toml").write_text(SMALL_JOINT)
    known = load_bench(tmp_path / "bench.toml")
    true = known.with_parameters(
        motor_inertia_kg_m2=9e-5,
        load_inertia_kg_m2=0.8,
        shaft_stiffness_nm_per_rad=2.2e4,
        shaft_damping_nm_s_per_rad=6.0,
        gravity_torque_nm=22.0,
        speed_gain_nm_s_per_rad=0.0135,
        integral_gain_nm_per_rad=0.9,
        torque_constant_nm_per_a=0.2,
    )
    generator, recordings = np.random.default_rng(seed), []
    for motor in (1.8e-4, 1.1e-4):
        frictions = [
            BenchEffect(
                f"{side}_viscous_friction", {"coefficient_nm_s_per_rad": EffectParameterValue(size)}
            )
            for side, size in (("motor", motor), ("load", 0.93))
        ]
        recording = true.with_effects(*frictions).simulate(
            3e-4,
            rotations=2.6,
            sampling_hz=1000.0,
            start_angle_rad=generator.uniform(0.0, 2.0 * math.pi),
            seed=generator,
            name=f"{motor}",
        )
        recordings.append(recording)
    fit = fit_jointly(
        known, [observed(r, known) for r in recordings], (1e-5, 1e-2), {}
    ).linear_fit.fit
    for recording in recordings:
        # Fails by chance in 1 of 10 000.
        sd = fit.sd(GAP, recording.name)
        assert abs(math.log(fit.value(GAP, recording.name) / 3e-4)) < 4.0 * sd < 0.2


def test_speed_alone_is_less_sharp_than_speed_and_current():
    whole = record(bench(), 8e-4, 11)
    alone = replace(whole, channels={MOTOR_SPEED: whole.motor_speed_rpm})
    both, single = fitted(bench(), whole), fitted(bench(), alone)
    assert single.bound[0] > 2.0 * both.bound[0]
    # Fails by chance in 1 of 10 000.
    assert abs(single.point[0] - math.log(8e-4)) < 4.0 * single.bound[0]


def test_excluded_samples_do_not_count():
    whole = record(bench(), 8e-4, 17)
    lost = np.zeros(whole.samples, dtype=bool)
    lost[[100, 101, 1500]] = True
    broken = {n: np.where(lost, v + 100.0, v) for n, v in whole.channels.items()}
    model = fitted(bench(), whole).model
    points = np.array([[math.log(8e-4), 1.0], [math.log(9e-4), 2.0]])
    kept = [
        SimulatedSignals(bench(), [observed(r, bench())], model.unknowns, model.noise)
        for r in (
            replace(whole, excluded=lost),
            replace(whole, channels=broken, excluded=lost),
        )
    ]
    assert np.array_equal(kept[0].whitened(points), kept[1].whitened(points))
    gone = np.count_nonzero(kept[0].whitened(points)[0] == 0.0)
    assert gone == 2 * (2 * (model.noise[0].order + 1) + 1)


@pytest.mark.long
def test_a_missing_effect_is_refused_and_a_known_one_is_not():
    recording = record(bench().with_effects(FRICTION), 8e-4, 12)
    assert not agrees(disagreements(fitted(bench(), recording)))
    fit = fitted(bench().with_effects(FRICTION), recording)
    assert agrees(disagreements(fit))
    draws = log_gap(sample_direct(fit, SETTINGS, np.random.SeedSequence(1)))
    low, high = np.quantile(draws, [0.001, 0.999])
    assert low < math.log(8e-4) < high  # fails by chance in 2 of 1000


def test_friction_that_only_shifts_the_mean_current_is_refused():
    motor = BenchEffect("motor_coulomb_friction", {"torque_nm": EffectParameterValue(0.03)})
    found = disagreements(fitted(bench(), record(bench().with_effects(motor), 8e-4, 13)))
    worst = min(found, key=lambda entry: entry.probability)
    assert not agrees(found)
    assert (worst.channel, worst.highest_order) == (MOTOR_CURRENT, 0)


@pytest.mark.long
def test_the_check_raises_false_alarms_as_often_as_it_says():
    # Five expected among 1000 residuals of pure noise; more than 14 in 2 of 10 000 studies.
    generator = np.random.default_rng(14)
    noise = ChannelNoise(np.zeros((0, 2, 2)), np.eye(2), np.ones(2), 4400)
    seen = Observed("one", np.zeros((2, 4400)), 1.0, 1.0, 1100.0)
    model = SimulatedSignals(bench(), [seen], [gap_unknown(1e-4, 1e-2)], [noise])
    nothing = SimulatedFit(model, np.zeros(1), np.zeros(0), np.zeros((1, 1)), np.eye(1), np.ones(1))
    alarms = sum(
        not agrees(disagreements(replace(nothing, residual=generator.standard_normal(8800))))
        for _ in range(1000)
    )
    assert 0 < alarms <= 14


@pytest.mark.long
def test_a_gap_beyond_its_range_is_withheld():
    fit = fitted(bench(), record(bench(), 8e-4, 15), gap_rad=(1e-4, 7e-4))
    posterior = sample_direct(fit, SETTINGS, np.random.SeedSequence(1))
    assert posterior.diagnostics.outcome == "withheld"
    assert posterior.diagnostics.failures[0].code == "gap_at_bound"


@pytest.mark.long
def test_the_same_seed_gives_the_same_draws_on_any_number_of_workers():
    recording = record(bench(), 8e-4, 16)
    results = []
    for workers in (1, 2):
        seen = [observed(recording, bench())]
        unknowns = [gap_unknown(1e-4, 1e-2), start_angle_unknown("one")]
        fit = fit_aligned(bench(), seen, unknowns, workers)
        results.append(sample_direct(fit, SETTINGS, np.random.SeedSequence(2)).draws)
    assert np.array_equal(*results)
    assert fit.model.index(START_ANGLE, "one") == 1
