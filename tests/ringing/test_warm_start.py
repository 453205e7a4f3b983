"""Starting from an earlier optimum: the same optimum as the full search, or an honest refusal."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from made_recordings import synthetic_recording
from places import BEFORE, CONFIGS, RECORDINGS
from quick import two_ensembles
from synthetic_ringing import TRUTH

from bayesbl.config.bench import load_bench
from bayesbl.config.loading import config_from_options
from bayesbl.errors import ConfigError, ResultError
from bayesbl.measurement.amplitude_route import read_earlier
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import MOTOR_SPEED, Recording
from bayesbl.results.store import write_tree
from bayesbl.ringing import optimum
from bayesbl.ringing.estimator import Estimator
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import (
    EarlierOptimum,
    NoLongerFits,
    Optimum,
    find_optimum,
    warm_optimum,
)
from bayesbl.ringing.posterior import LogPosterior
from bayesbl.ringing.symbols import (
    AMPLITUDE,
    DECAY,
    FREQUENCY,
    MEAN,
    ROTATION,
    SEPARATION,
    START,
    DisturbanceModel,
)
from bayesbl.runs.kinds import check, run
from bayesbl.runs.workflow import Options

NOISE = NoiseModel(1.5, (0.6,))
OLD = EarlierOptimum("the old optimum", TRUTH, 1.5)


def recording(seed: int = 1, noise: NoiseModel = NOISE, **changes: float) -> Recording:
    symbols = {**TRUTH, **changes}
    return synthetic_recording(
        symbols, noise, np.random.default_rng(seed), baseline_rpm=(5.0, -3.0)
    )


def objective_of(measured: Recording, **model: Any) -> Objective:
    return Objective(DisturbanceModel(**model), measured.time_s, measured.motor_speed_rpm)


def full(objective: Objective) -> Optimum:
    return find_optimum(objective, "guess", np.random.default_rng(1))


def assert_same(warm: Optimum, other: Optimum) -> None:
    """The same optimum to within the kinks of the window's edges, in the same canonical form."""
    assert warm.sum_of_squares <= other.sum_of_squares * (1.0 + 1e-4)
    for name in (AMPLITUDE, DECAY, FREQUENCY, SEPARATION, ROTATION):
        assert warm.symbols[name] == pytest.approx(other.symbols[name], rel=0.01)
    assert warm.symbols[START] == pytest.approx(other.symbols[START], abs=2e-3)


@pytest.mark.long
@pytest.mark.parametrize("start", np.linspace(0.0, 3.6, 7, endpoint=False))
def test_the_gear_may_stand_in_any_phase_at_the_begin(start: float) -> None:
    objective = objective_of(recording(**{START: start + 0.05}))
    assert_same(warm_optimum(objective, OLD), full(objective))


@pytest.mark.long
def test_a_worn_gap_on_the_bench_is_followed() -> None:
    bench = load_bench(CONFIGS / "bench.toml")
    generator = np.random.default_rng(4)
    for gap in (2e-4, 8e-4, 2.5e-3):
        objectives = []
        for worn in (gap, 1.4 * gap):
            made = bench.simulate(
                worn, rotations=5.0, start_angle_rad=generator.uniform(0.0, 2.0 * math.pi)
            )
            speed = made.motor_speed_rpm + NOISE.draw(made.time_s.size, generator)
            objectives.append(objective_of(Recording("worn", made.time_s, {MOTOR_SPEED: speed})))
        old = full(objectives[0])
        earlier = EarlierOptimum("the old optimum", old.symbols, old.rmse_rpm)
        assert_same(warm_optimum(objectives[1], earlier), full(objectives[1]))


@pytest.mark.long
@pytest.mark.parametrize(
    "ranges",
    [
        {DECAY: (5.0, 8.0)},  # the truth, 12, is out of reach
        {FREQUENCY: (70.0, 120.0)},  # likewise 62
        {DECAY: (5.0, 8.0), FREQUENCY: (63.0, 120.0)},
        {START: (4.1, 5.5)},  # holds t0 + T_w, not t0
        {SEPARATION: (1.75, 3.0)},  # holds T_w − T as well: the pulses may change places
    ],
    ids=lambda ranges: ", ".join(ranges),
)
def test_warm_and_full_search_end_in_the_same_optimum_inside_the_ranges(
    ranges: dict[str, tuple[float, float]],
) -> None:
    objective = objective_of(recording(), ranges=ranges)
    cold = full(objective)
    warm = warm_optimum(objective, EarlierOptimum("the old one", cold.symbols, cold.rmse_rpm))
    assert_same(warm, cold)
    for found in (warm, cold):
        assert np.isfinite(LogPosterior(objective, found, 1.0)(found.searched[None])[0])
        for name, (low, high) in ranges.items():
            assert all(low <= rival.symbols[name] <= high for rival in found.rivals)


def test_the_history_of_a_search_ends_at_its_rmse_whatever_is_left_out() -> None:
    measured = recording()
    excluded = np.arange(measured.samples) % 25 == 0
    objective = Objective(
        DisturbanceModel(), measured.time_s, measured.motor_speed_rpm, excluded=excluded
    )
    for found in (full(objective), warm_optimum(objective, OLD)):
        residual = (measured.motor_speed_rpm - found.predict(measured.time_s))[~excluded]
        assert found.rmse_rpm == pytest.approx(math.sqrt(np.mean(residual**2)), rel=1e-9)
        assert found.history.rmse_rpm.min() == pytest.approx(found.rmse_rpm, rel=1e-9)


def test_another_speed_scales_the_rotation_period() -> None:
    slower = recording(**{MEAN: 1960.0, ROTATION: 3.6 * 2000.0 / 1960.0, SEPARATION: 1.735})
    found = warm_optimum(objective_of(slower), OLD)
    assert found.symbols[ROTATION] == pytest.approx(3.6 * 2000.0 / 1960.0, rel=1e-4)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({MEAN: 1500.0}, "mean_speed_rpm is 1500 rpm"),
        ({ROTATION: 3.3}, "rmse_rpm is"),
        ({FREQUENCY: 95.0, AMPLITUDE: 25.0}, "where it was"),
    ],
)
def test_what_is_no_longer_the_old_joint_is_told(changes: dict[str, float], told: str) -> None:
    with pytest.raises(NoLongerFits, match=told):
        warm_optimum(objective_of(recording(**changes)), OLD)


def test_an_answer_that_was_withheld_is_no_start() -> None:
    doubtful = EarlierOptimum("the old optimum", TRUTH, 1.5, withheld=True)
    with pytest.raises(NoLongerFits, match="withheld"):
        warm_optimum(objective_of(recording()), doubtful)


def test_ringing_lost_in_the_noise_falls_back_to_the_full_search() -> None:
    noisy = recording(noise=NoiseModel(1.5, (0.9,)), **{AMPLITUDE: 0.2})
    point = Estimator().estimate(noisy, np.random.SeedSequence(1), 120.0, OLD)
    assert "no longer fits" in point.start
    assert point.optimum.method == "guess"


@pytest.mark.long
def test_a_fall_back_gives_what_the_full_search_gives() -> None:
    other = recording(**{ROTATION: 3.3})
    warm = Estimator().estimate(other, np.random.SeedSequence(1), None, OLD)
    cold = Estimator().estimate(other, np.random.SeedSequence(1))
    assert warm.start.endswith("The full search was made.")
    assert warm.optimum.symbols == cold.optimum.symbols


# From result to result

SHORT, THINNED = 9001, 2
"""9 s of an example at 500 Hz: two rotations and a half."""


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., tuple[dict[str, Any], str]]:
    """Runs over short example recordings without figures: summary, and what was said."""
    folder = tmp_path_factory.mktemp("warm")
    for name in ("before", "after"):
        lines = (RECORDINGS / f"wear_{name}.csv").read_text().splitlines(keepends=True)
        (folder / f"wear_{name}.csv").write_text(lines[0] + "".join(lines[1:SHORT:THINNED]))

    def run_one(kind: str, names: list[str], out: str, **options: Any) -> tuple[Any, str]:
        said: list[str] = []
        files = [folder / f"wear_{name}.csv" for name in names]
        options = {k: folder / v if k == "start_from" else v for k, v in options.items()}
        short = two_ensembles(folder, kind)
        options["curve"] = "published"
        config = config_from_options(kind, files, short, out=folder / out, **options)
        return run(config, Options(say=said.append)), " ".join(said)

    run_one("compare", ["before", "after"], "old")
    return run_one


@pytest.mark.long
def test_a_fit_starts_from_the_result_of_an_earlier_one(fitted: Any) -> None:
    cold, _ = fitted("fit", ["after"], "cold")
    warm, said = fitted("fit", ["after"], "warm", start_from="old")
    assert 'started from the optimum of "wear_after"' in said
    assert warm["start"] in said
    for key in ("median", "low", "high"):
        width = cold["delta_rad"]["high"] - cold["delta_rad"]["low"]
        assert warm["delta_rad"][key] == pytest.approx(cold["delta_rad"][key], abs=0.05 * width)


@pytest.mark.long
def test_a_recording_of_another_name_starts_from_the_last_one(fitted: Any) -> None:
    fitted("fit", ["before"], "single")
    _, said = fitted("fit", ["after"], "next", start_from="single")
    assert 'started from the optimum of "wear_before"' in said


def test_a_result_without_optimum_is_refused(tmp_path: Path) -> None:
    tree = xr.DataTree()
    tree.attrs = {"kind": "sweep", "outcome": "converged"}
    write_tree(tree, tmp_path / "result.nc")
    with pytest.raises(ResultError, match="no optimum to start from"):
        read_earlier(tmp_path)
    (tmp_path / "fit.toml").write_text(
        f"""schema = 1
kind = "fit"
[run]
output = "out"
[[recordings]]
file = "{BEFORE}"
[estimator.search]
start_from = "result.nc"
"""
    )
    (problem,) = check(tmp_path / "fit.toml").problems
    assert "no optimum to start from" in str(problem)


def test_a_result_that_is_not_there_is_refused_by_its_option(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--start-from: There is no such file"):
        config_from_options("fit", [BEFORE], start_from=tmp_path)


def test_a_warm_start_counts_every_phase_that_it_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []
    folds = optimum._folds
    monkeypatch.setattr(optimum, "_folds", lambda *args: tried.append(folds(*args)) or tried[0])
    found = warm_optimum(objective_of(recording()), OLD)
    assert found.history.evaluations[0] == len(tried[0])
    assert found.evaluations > len(tried[0])
