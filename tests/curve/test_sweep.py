"""Sweeps of the virtual bench and the gap curves they give."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from places import RECORDINGS

from bayesbl.config.bench import dump_bench, reference_bench
from bayesbl.config.kinds import SweepConfig
from bayesbl.config.loading import load_config
from bayesbl.curve.gap_curve import GapCurve, likeliest_branch
from bayesbl.curve.sweep import (
    SIZES,
    SweepRow,
    SweepSettings,
    SweptDraws,
    degree_reports,
    regress,
    sweep_nominal,
    swept_curve,
    virtual_departures,
)
from bayesbl.errors import ConfigError, CurveError, UserError
from bayesbl.measurement.compatibility import SPEED_TOLERANCE, require_same_estimator
from bayesbl.measurement.curves import curve_from_dataset, curve_group, read_curve
from bayesbl.measurement.gap_by_curve import MeasuredRinging, gaps
from bayesbl.noise.process import NoiseModel
from bayesbl.noise.rotation_noise import Noise
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import Recording
from bayesbl.results.store import read_tree, write_tree
from bayesbl.ringing.covariance import covariance
from bayesbl.ringing.estimator import Estimator
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import find_optimum
from bayesbl.ringing.search import refine
from bayesbl.ringing.symbols import SYMBOLS, DisturbanceModel
from bayesbl.ringing.waveform import jacobian, jacobian_columns, misfit_curvature
from bayesbl.runs.kinds import check, result_of_run

SETTINGS = SweepSettings(count=14, start_angles=3)
TOLERANT = (
    "shaft_stiffness_nm_per_rad",
    "speed_gain_nm_s_per_rad",
    "integral_gain_nm_per_rad",
    "gravity_torque_nm",
)


@pytest.fixture(scope="session")
def nominal() -> SweepRow:
    return sweep_nominal(reference_bench(), DisturbanceModel(), SETTINGS, np.random.default_rng(1))


@pytest.fixture(scope="session")
def curve(nominal: SweepRow) -> GapCurve:
    recording = reference_bench().simulate(1e-3)
    return swept_curve(
        "test",
        nominal,
        DisturbanceModel(),
        3,
        Estimator().fingerprint(recording),
        np.random.SeedSequence(1),
    )


def point(recording, seed: int = 1):  # type: ignore[no-untyped-def]
    return Estimator().estimate(recording, np.random.SeedSequence(seed))


def sweep_config(folder: Path, workers: int = 1, draws: int = 6, **sweep: object) -> SweepConfig:
    """A small sweep of a bench with tolerances, as a file."""
    text = dump_bench(reference_bench())
    lines = []
    for line in text.splitlines():
        lines.append(line)
        if line.strip("[]").removeprefix("parameters.") in TOLERANT:
            lines.append("relative_tolerance = 0.05")
    (folder / "bench.toml").write_text("\n".join(lines))
    settings = {"start_angles": 2, "rotations": 2.0, "sampling_hz": 500.0, "degree": 3} | sweep
    body = "\n".join(f"{k} = {v}" for k, v in settings.items())
    (folder / "sweep.toml").write_text(
        f"""schema = 1
kind = "sweep"
bench = "bench.toml"
[run]
workers = {workers}
output = "out/sweep"
[sweep]
gap_rad = {{low = 2e-4, high = 3e-3, count = 8}}
bench_draws = {draws}
{body}
"""
    )
    config = load_config(folder / "sweep.toml")
    assert isinstance(config, SweepConfig)
    return config


@pytest.mark.long
def test_the_reference_bench_follows_the_papers_curve_within_5_percent(nominal: SweepRow) -> None:
    paper = 1e-4 * np.array([-0.138809, 0.138764, 0.003122, -0.000009])
    grid = np.linspace(5.0, 115.0, 50_000)
    expected = np.interp(nominal.gap_rad, np.polynomial.polynomial.polyval(grid, paper), grid)
    assert np.all(np.abs(nominal.amplitude_rpm.mean(axis=1) / expected - 1.0) < 0.05)


@pytest.mark.long
def test_a_sweep_of_two_rotations_keeps_to_the_ringing() -> None:
    settings = SweepSettings(rotations=2.0)
    bench = reference_bench().with_parameters(
        gear_ratio=100.0,
        motor_inertia_kg_m2=1e-3,
        load_inertia_kg_m2=15.0,
        shaft_stiffness_nm_per_rad=1e5,
        shaft_damping_nm_s_per_rad=180.0,
        gravity_torque_nm=320.0,
        torque_constant_nm_per_a=0.5,
        speed_gain_nm_s_per_rad=0.16,
        integral_gain_nm_per_rad=6.0,
        reference_speed_rpm=1500.0,
    )
    row = sweep_nominal(bench, DisturbanceModel(), settings, np.random.default_rng(1))
    assert np.all(np.diff(row.amplitude_rpm[:, 0]) > 0.0)


def test_a_curve_ends_where_the_optimum_leaps_to_another_ringing() -> None:
    bench = reference_bench().with_parameters(
        gear_ratio=100.0,
        motor_inertia_kg_m2=9e-4,
        load_inertia_kg_m2=15.0,
        shaft_stiffness_nm_per_rad=9e4,
        shaft_damping_nm_s_per_rad=150.0,
        gravity_torque_nm=350.0,
        torque_constant_nm_per_a=0.6,
        speed_gain_nm_s_per_rad=0.15,
        integral_gain_nm_per_rad=5.0,
    )
    bench = dataclasses.replace(bench, gap_form="dead_zone")
    settings = SweepSettings(rotations=3.0, start_angles=2)
    model = DisturbanceModel()
    row = sweep_nominal(bench, model, settings, np.random.default_rng(1))
    frequency = row.symbol("angular_frequency_rad_per_s", model.fixed)
    assert np.ptp(np.log(frequency)) < 0.05  # below 0.13 mrad it would be 40 % higher
    assert 1.2e-4 < row.gap_rad[0] < 1.5e-4
    assert row.gap_rad[-1] == settings.high_rad
    curve = swept_curve("leap", row, model, 3, "", np.random.SeedSequence(1))
    amplitude = row.amplitude_rpm.mean(axis=1)
    np.testing.assert_allclose(curve.gap(amplitude), row.gap_rad, rtol=2e-3)


@pytest.mark.parametrize(("leap", "kept"), [(10, 30), (None, 40)])
def test_a_row_is_cut_at_a_leap_however_fine_its_gaps(leap: int | None, kept: int) -> None:
    row = made_row(leap)
    assert row.on_one_branch({}).gap_rad.size == kept


def test_a_leap_that_leaves_too_few_gaps_is_told() -> None:
    with pytest.raises(CurveError, match="jumps"):
        made_row(38).on_one_branch({})


def made_row(leap: int | None) -> SweepRow:
    """Forty gaps close together; ω scatters by 3 % and is half as high again below the leap."""
    gap = np.linspace(1e-3, 1.05e-3, 40)
    frequency = 70.0 * np.exp(0.03 * np.random.default_rng(1).standard_normal(40))
    frequency[: leap or 0] *= 1.5
    searched = frequency[:, None, None]
    amplitude = 5e4 * gap[:, None]
    names = ("angular_frequency_rad_per_s",)
    return SweepRow(gap, np.zeros((40, 1)), searched, amplitude, np.zeros((40, 1)), names)


def test_a_sweep_finds_what_a_fit_finds_inside_the_same_ranges() -> None:
    bench, settings = reference_bench(), SweepSettings(5e-4, 2e-3, 6, start_angles=2, rotations=3.0)
    model = DisturbanceModel(ranges={"decay_rate_per_s": (5.0, 12.0)})  # free, 18 to 20
    row = sweep_nominal(bench, model, settings, np.random.default_rng(1))
    decay = row.symbol("decay_rate_per_s", model.fixed)
    assert np.all((decay >= 5.0) & (decay <= 12.0))
    angle = row.start_angle_rad[3, 1]
    recording = bench.simulate(row.gap_rad[3], rotations=3.0, start_angle_rad=angle)
    fitted = Estimator(model).estimate(recording, np.random.SeedSequence(1)).optimum
    assert row.amplitude_rpm[3, 1] == pytest.approx(fitted.symbols["amplitude_rpm"], rel=1e-3)


@pytest.mark.long
def test_a_noise_free_recording_gives_its_gap_back_at_any_start_angle(curve: GapCurve) -> None:
    rng = np.random.default_rng(3)
    for gap in np.exp(rng.uniform(np.log(1.5e-4), np.log(3.8e-3), 4)):
        recording = reference_bench().simulate(gap, start_angle_rad=rng.uniform(0.0, 6.28))
        amplitude = point(recording).optimum.symbols["amplitude_rpm"]
        # Scatter with the start angle is below 0.15 % of A, the regression's error below 0.1 %.
        assert abs(float(curve.gap(np.array(amplitude))) / gap - 1.0) < 5e-3


@pytest.mark.long
def test_the_example_recordings_give_their_gaps_and_their_change(curve: GapCurve) -> None:
    truths = (6.8539e-4, 9.5394e-4)
    points = [
        point(read_recording(RECORDINGS / f"wear_{name}.csv")) for name in ("before", "after")
    ]
    rng = np.random.default_rng(1)
    ringing = [
        MeasuredRinging(
            rng.normal(p.ringing[0][0], np.sqrt(p.ringing[1][0, 0]), (4, 1000)), *p.ringing
        )
        for p in points
    ]
    found = gaps(curve, ringing, np.random.SeedSequence(1))
    for truth, gap in zip(truths, found, strict=True):
        low, high = np.quantile(gap.delta_rad, [0.025, 0.975])
        assert abs(np.median(gap.delta_rad) / truth - 1.0) < 0.04
        assert low < truth < high
    low, high = np.quantile(found[1].delta_rad - found[0].delta_rad, [0.025, 0.975])
    assert low < truths[1] - truths[0] < high


@pytest.mark.long
def test_a_waveform_that_is_not_exact_bends_the_sum_of_squares_as_the_sandwich_says() -> None:
    model, noise = DisturbanceModel(), NoiseModel(1.5, (0.6,))
    speed = reference_bench().simulate_many(1.2e-3, start_angle_rad=1.0)[0]
    time_s = np.arange(speed.size) / 1000.0
    clean = Objective(model, time_s, speed)
    optimum = find_optimum(clean, "guess", np.random.default_rng(1))
    residual = speed - optimum.predict(time_s)
    known = Noise(1.5, np.array([0.6]), np.zeros(16), 0)
    spread = covariance(optimum, time_s, residual, known)
    without = covariance(optimum, time_s, np.zeros_like(speed), known)
    rng, count, found = np.random.default_rng(4), 120, []
    for seed in range(count):
        noisy = Objective(model, time_s, speed + noise.draw(speed.size, rng))
        point = refine(noisy, optimum.searched, seed)
        found.append([noisy.solve(point[None]).coefficients[0, -1], point[2]])
    actual = np.std(found, axis=0, ddof=1)
    # Chi-square: a standard deviation from 120 is within 20 % but in 0.2 % of seeds.
    for name, value in zip(("amplitude_rpm", "angular_frequency_rad_per_s"), actual, strict=True):
        assert 0.8 < value / spread.standard_deviations[name] < 1.2, name
    assert actual[1] > 1.25 * without.standard_deviations["angular_frequency_rad_per_s"]


def test_the_curvature_of_the_misfit_is_the_derivative_of_the_gradient() -> None:
    model = DisturbanceModel()
    names = jacobian_columns(model)
    time_s = np.arange(4000) / 500.0
    symbols = dict(zip(SYMBOLS, (20.0, 0.4, 12.0, 60.0, 2000.0, 0.0, 0.204, 1.7, 3.6), strict=True))
    residual = np.random.default_rng(1).standard_normal(time_s.size)
    curvature = misfit_curvature(model, time_s, symbols, residual)
    np.testing.assert_allclose(curvature, curvature.T, atol=1e-9 * np.abs(curvature).max())
    # The decay and the frequency move no window edge, so differences see nothing else.
    for name in ("decay_rate_per_s", "angular_frequency_rad_per_s"):
        step = 1e-4
        gradients = [
            residual @ jacobian(model, time_s, {**symbols, name: symbols[name] + h}, np.zeros(2))
            for h in (step, -step)
        ]
        numeric = (gradients[0] - gradients[1]) / (2.0 * step)
        column = names.index(name)
        for row in ("start_time_s", "decay_rate_per_s", "angular_frequency_rad_per_s"):
            i = names.index(row)
            np.testing.assert_allclose(curvature[i, column], numeric[i], rtol=1e-5, atol=1e-6)


@pytest.mark.long
def test_pulses_exchanged_by_noise_are_told_by_how_the_bench_rings(curve: GapCurve) -> None:
    estimator, noise = Estimator(), NoiseModel(4.0, (0.6,))
    rng = np.random.default_rng(3)
    clean = 12.33  # least-squares amplitude of this gap without noise
    exchanged = 0
    for case in range(9):
        recording = reference_bench().simulate(2e-4, start_angle_rad=rng.uniform(0.0, 6.28))
        speed = recording.motor_speed_rpm + noise.draw(recording.samples, rng)
        noisy = dataclasses.replace(recording, channels={"motor_speed_rpm": speed})
        plain = point(noisy, case)
        chosen = likeliest_branch(curve, estimator, plain)
        amplitude = chosen.optimum.symbols["amplitude_rpm"]
        assert abs(amplitude - clean) < 3.5 * chosen.spread.standard_deviations["amplitude_rpm"]
        if chosen.optimum is not plain.optimum:
            exchanged += 1
            wrong = plain.optimum.symbols["amplitude_rpm"]
            assert abs(wrong - clean) > 2.5 * plain.spread.standard_deviations["amplitude_rpm"]
            assert chosen.optimum.rivals[0].symbols["amplitude_rpm"] == wrong
            assert "was used instead" in chosen.notes[-1]
    assert exchanged >= 1


def test_strong_pulses_are_left_as_they_are(curve: GapCurve) -> None:
    recording = reference_bench().simulate(1e-3, start_angle_rad=2.0, seed=np.random.default_rng(1))
    found = point(recording)
    chosen = likeliest_branch(curve, Estimator(), found)
    assert chosen.optimum is found.optimum
    assert chosen.notes == found.notes


def test_a_cubic_describes_the_bench_where_lower_degrees_do_not(nominal: SweepRow) -> None:
    reports = degree_reports(nominal)
    assert reports[1]["rms_departure"] > 0.1
    assert reports[2]["rms_departure"] > 3.0 * reports[3]["rms_departure"]
    assert reports[3]["largest_departure"] < 0.005


def test_the_regression_recovers_a_known_cubic_within_its_own_uncertainty() -> None:
    rng = np.random.default_rng(5)
    truth = np.array([-1e-5, 1.4e-5, 3e-7, -9e-10])
    knots = np.geomspace(8.0, 95.0, 30)
    inside = []
    for _ in range(30):
        amplitude = np.repeat(np.geomspace(7.0, 100.0, 25), 3)
        gap = np.polynomial.polynomial.polyval(amplitude, truth)
        slope = np.gradient(np.log(gap[::3]), amplitude[::3]).repeat(3)
        seen = amplitude + 0.05 * rng.standard_normal(amplitude.size)
        regression = regress(seen, gap, slope * 0.05, knots, 3)
        coefficients, lack = regression.draws(400, rng)
        draws = regression.log_gap + coefficients + lack
        exact = np.log(np.polynomial.polynomial.polyval(knots, truth))
        low, high = np.quantile(draws, [0.05, 0.95], axis=0)
        inside.append(np.mean((low < exact) & (exact < high)))
    # 30 sweeps with correlated knots: outside 0.8 to 0.98 less than once in a thousand seeds.
    assert 0.8 < np.mean(inside) < 0.98


def test_draws_of_a_curve_leave_the_curve_where_it_is(curve: GapCurve) -> None:
    amplitude = np.full(4000, 30.0)
    drawn = curve.draw(4000, np.random.default_rng(1)).gap(amplitude)
    assert abs(np.log(drawn).mean() - np.log(curve.gap(amplitude[:1])[0])) < 1e-4


def test_a_curve_is_the_same_after_a_round_trip_through_netcdf(
    curve: GapCurve, tmp_path: Path
) -> None:
    import xarray as xr

    tree = xr.DataTree.from_dict({"curve": curve_group(curve, 0.9, np.random.SeedSequence(1))})
    tree.attrs = {"outcome": "converged", "kind": "sweep"}
    write_tree(tree, tmp_path / "result.nc")
    again = read_curve(tmp_path / "result.nc")
    grid = np.geomspace(3.0, 200.0, 100)
    np.testing.assert_array_equal(again.gap(grid), curve.gap(grid))
    draws = [c.draw(100, np.random.default_rng(2)).gap(grid) for c in (curve, again)]
    np.testing.assert_array_equal(*draws)
    assert again.fingerprint == curve.fingerprint


def test_an_amplitude_that_does_not_grow_with_the_gap_is_refused(nominal: SweepRow) -> None:
    amplitude = nominal.amplitude_rpm.copy()
    amplitude[6] = amplitude[4]
    broken = dataclasses.replace(nominal, amplitude_rpm=amplitude)
    with pytest.raises(CurveError, match="does not grow with the gap"):
        swept_curve("broken", broken, DisturbanceModel(), 3, "", np.random.SeedSequence(1))


def test_a_gap_beyond_the_sweep_is_withheld_with_a_bound(curve: GapCurve) -> None:
    centre = np.array([150.0, np.log(70.0), np.log(18.0)])
    amplitude = np.random.default_rng(1).normal(150.0, 0.5, (4, 500))
    ringing = MeasuredRinging(amplitude, centre, np.diag([0.25, 1e-4, 1e-4]))
    gap = gaps(curve, [ringing], np.random.SeedSequence(1))[0]
    (reason,) = gap.reasons
    assert reason.code == "beyond_curve"
    assert reason.values["is_above"]
    allowed = gaps(curve, [ringing], np.random.SeedSequence(1), allow_extrapolation=True)[0]
    assert allowed.reasons == ()
    assert np.median(allowed.delta_rad) > curve.gap_range_rad[1]


@pytest.mark.parametrize(
    ("estimator", "sampling_hz", "word"),
    [
        (Estimator(DisturbanceModel(baseline_harmonics=0)), 1000.0, "baseline_harmonics"),
        (Estimator(), 500.0, "sampling_hz"),
        (
            Estimator(DisturbanceModel(fixed={"window_start_s": 0.0, "window_end_s": 0.15})),
            1000.0,
            "window_end_s",
        ),
        (
            Estimator(DisturbanceModel(ranges={"decay_rate_per_s": (5.0, 12.0)})),
            1000.0,
            "ranges",
        ),
    ],
)
def test_a_curve_made_with_another_estimator_is_refused(
    curve: GapCurve, estimator: Estimator, sampling_hz: float, word: str
) -> None:
    recording = reference_bench().simulate(1e-3, rotations=2.0, sampling_hz=sampling_hz)
    with pytest.raises(CurveError, match=word):
        require_same_estimator(curve, estimator, recording)
    require_same_estimator(curve, Estimator(), reference_bench().simulate(1e-3))


@pytest.mark.parametrize("swept_rpm", [1000.0, 1249.98, 1250.02, 1749.98, 1750.02, 2000.0])
def test_a_curve_is_accepted_within_one_percent_of_its_speed_and_nowhere_else(
    curve: GapCurve, swept_rpm: float, tmp_path: Path
) -> None:
    import xarray as xr

    def at(speed_rpm: float) -> Recording:
        bench = reference_bench().with_parameters(reference_speed_rpm=speed_rpm)
        return bench.simulate(1e-3, rotations=2.0, sampling_hz=1000.0)

    fingerprint = Estimator().fingerprint(at(swept_rpm))
    made = dataclasses.replace(curve, fingerprint=fingerprint, reference_speed_rpm=swept_rpm)
    tree = xr.DataTree.from_dict({"curve": curve_group(made, 0.9, np.random.SeedSequence(1))})
    tree.attrs = {"outcome": "converged", "kind": "sweep"}
    write_tree(tree, tmp_path / "result.nc")
    stored = read_curve(tmp_path / "result.nc")
    for ratio in (0.991, 0.9999, 1.0001, 1.009):
        require_same_estimator(stored, Estimator(), at(ratio * swept_rpm))
    for ratio in (0.98, 0.989, 1.011, 1.02):
        with pytest.raises(CurveError, match="nominal_speed_rpm"):
            require_same_estimator(stored, Estimator(), at(ratio * swept_rpm))


@pytest.mark.long
def test_one_percent_of_speed_moves_the_gap_by_less_than_a_curve_may_be_off(
    nominal: SweepRow, curve: GapCurve
) -> None:
    bench = reference_bench()
    faster = bench.with_parameters(reference_speed_rpm=2000.0 * (1.0 + SPEED_TOLERANCE))
    for g in (0, 7, 13):
        options = {"rotations": 5.0, "start_angle_rad": nominal.start_angle_rad[g, 0]}
        recording = faster.simulate(nominal.gap_rad[g], **options)
        amplitude = point(recording).optimum.symbols["amplitude_rpm"]
        gaps_rad = curve.gap(np.array([amplitude, nominal.amplitude_rpm[g, 0]]))
        assert abs(np.log(gaps_rad[0] / gaps_rad[1])) < SIZES[-1]


def test_virtual_draws_reproduce_what_depends_linearly_on_the_parameters() -> None:
    rng = np.random.default_rng(2)
    slopes = rng.normal(size=(3, 5, 3)) * 0.02
    shifts = rng.uniform(-1.0, 1.0, (40, 3))
    swept = SweptDraws(("a", "b", "c"), shifts, np.einsum("bp,pgk->bgk", shifts, slopes))
    virtual = np.concatenate([virtual_departures(swept, rng) for _ in range(7)])
    # Uniform on [−1, 1] has variance 1/3.
    np.testing.assert_allclose(
        virtual.std(axis=0), np.sqrt((slopes**2).sum(axis=0) / 3.0), rtol=0.03
    )


@pytest.fixture(scope="session")
def tolerant_sweep(tmp_path_factory: pytest.TempPathFactory):  # type: ignore[no-untyped-def]
    folder = tmp_path_factory.mktemp("sweep")
    config = sweep_config(folder, draws=24)
    return folder, config, result_of_run(config)


@pytest.mark.long
def test_a_second_sweep_takes_its_rows_from_the_cache_and_two_workers_make_the_same(
    tolerant_sweep,
    tmp_path: Path,  # type: ignore[no-untyped-def]
) -> None:
    folder, config, first = tolerant_sweep
    cache = folder / "out" / ".finished"
    made = {path.name: path.stat().st_mtime_ns for path in cache.iterdir()}
    assert len(made) == 25
    again = result_of_run(config)
    assert {path.name: path.stat().st_mtime_ns for path in cache.iterdir()} == made
    elsewhere = result_of_run(sweep_config(tmp_path, workers=2, draws=6))
    few = elsewhere["bench_draws"]["departure"].values
    np.testing.assert_array_equal(few, first["bench_draws"]["departure"].values[:6])
    np.testing.assert_array_equal(again["sweep"]["amplitude_rpm"], first["sweep"]["amplitude_rpm"])
    np.testing.assert_array_equal(
        elsewhere["sweep"]["amplitude_rpm"], first["sweep"]["amplitude_rpm"]
    )


@pytest.mark.long
def test_rows_made_by_other_code_are_not_taken_from_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = sweep_config(tmp_path, draws=0)
    first = result_of_run(config)
    made: list[str] = []

    def counted(*arguments: object) -> SweepRow:
        made.append("row")
        return sweep_nominal(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr("bayesbl.measurement.curves.sweep_nominal", counted)
    result_of_run(config)
    assert not made
    with monkeypatch.context() as edited:
        edited.setattr("bayesbl.results.work.code_sha256", lambda: "another code")
        other = result_of_run(config)
    assert len(made) == 1
    np.testing.assert_array_equal(other["sweep"]["amplitude_rpm"], first["sweep"]["amplitude_rpm"])


def test_a_torn_cache_entry_is_made_again(tolerant_sweep) -> None:  # type: ignore[no-untyped-def]
    folder, config, first = tolerant_sweep
    entry = sorted((folder / "out" / ".finished").iterdir())[0]
    entry.write_bytes(entry.read_bytes()[:100])
    again = result_of_run(config)
    np.testing.assert_array_equal(
        again["bench_draws"]["departure"], first["bench_draws"]["departure"]
    )


def test_a_shared_bench_cancels_in_the_change_and_the_ringing_narrows_it(
    tolerant_sweep,  # type: ignore[no-untyped-def]
) -> None:
    curve = curve_from_dataset(tolerant_sweep[2]["curve"].to_dataset(), "test")
    rng = np.random.default_rng(1)
    assert curve.ringing is not None
    snapshots, blind = [], []
    for knot in (20, 40):
        amplitude = curve.knots_rpm[knot]
        frequency, decay = curve.ringing.log_frequency[knot], curve.ringing.log_decay[knot]
        draws = rng.normal(amplitude, 0.01 * amplitude, (4, 1000))
        centre = np.array([amplitude, frequency, decay])
        sharp = np.diag([(0.01 * amplitude) ** 2, 4e-3**2, 2e-2**2])
        snapshots.append(MeasuredRinging(draws, centre, sharp))
        blind.append(MeasuredRinging(draws, centre, sharp + np.diag([0.0, 10.0, 10.0])))
    seeing = [g.delta_rad.ravel() for g in gaps(curve, snapshots, np.random.SeedSequence(1))]
    unseeing = [g.delta_rad.ravel() for g in gaps(curve, blind, np.random.SeedSequence(1))]
    shared = (seeing[1] - seeing[0]).std()
    independent = (seeing[1] - rng.permutation(seeing[0])).std()
    assert shared < 0.9 * independent
    for narrow, wide in zip(seeing, unseeing, strict=True):
        assert np.log(narrow).std() < 0.9 * np.log(wide).std()


def test_draws_without_a_tolerance_are_refused(tmp_path: Path) -> None:
    config = sweep_config(tmp_path, draws=3)
    (tmp_path / "bench.toml").write_text(dump_bench(reference_bench()))
    with pytest.raises(UserError, match="nothing to draw"):
        result_of_run(config)
    assert not (tmp_path / "out").exists()  # refused before anything was simulated
    (problem,) = check(tmp_path / "sweep.toml").problems
    assert "nothing to draw" in str(problem)


def test_a_degree_that_the_gaps_cannot_carry_is_refused_before_the_sweep(tmp_path: Path) -> None:
    assert sweep_config(tmp_path, degree=5).sweep.gap_rad.count == 8
    with pytest.raises(ConfigError, match=r"\[sweep\] degree.*gap_rad\.count of at least 9"):
        sweep_config(tmp_path, degree=6)


def test_a_sweep_without_a_curve_is_no_curve(tmp_path: Path) -> None:
    import xarray as xr

    tree = xr.DataTree.from_dict({"posterior": xr.Dataset()})
    tree.attrs = {"outcome": "converged", "kind": "fit"}
    write_tree(tree, tmp_path / "result.nc")
    assert read_tree(tmp_path / "result.nc").attrs["kind"] == "fit"
    with pytest.raises(CurveError, match="holds no gap curve"):
        read_curve(tmp_path / "result.nc")


def test_a_ringing_that_is_not_the_benchs_withholds_the_gap(curve: GapCurve) -> None:
    """The amplitude lies inside the sweep; only frequency and decay tell of another joint."""
    ringing = curve.ringing
    assert ringing is not None
    amplitude = float(np.median(curve.knots_rpm))
    nearest = int(np.argmin(np.abs(curve.knots_rpm - amplitude)))
    draws = np.random.default_rng(2).normal(amplitude, 0.3, (4, 500))
    own = np.array([amplitude, ringing.log_frequency[nearest], ringing.log_decay[nearest]])
    covariance = np.diag([0.09, 1e-5, 1e-4])
    for softer, contradicted in ((0.0, False), (0.5 * np.log(0.7), True)):
        centre = own + np.array([0.0, softer, 0.0])
        found = gaps(curve, [MeasuredRinging(draws, centre, covariance)], np.random.SeedSequence(2))
        assert bool(found[0].reasons) == contradicted
