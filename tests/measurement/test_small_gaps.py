"""Gaps down to none by the direct route: the prior reaches zero, and a bound is an answer."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from places import CONFIGS
from quick import two_ensembles

from bayesbl import cli
from bayesbl.config.bench import load_bench
from bayesbl.errors import BenchError
from bayesbl.matching.motions import noise_of
from bayesbl.matching.observed import observed
from bayesbl.matching.signals import SMALLEST_GAP_RAD, SimulatedSignals, gap_unknown
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, Recording

KNOWN = CONFIGS / "bench.toml"
HIGHEST_RAD = 1e-2


def recorded(gap_rad: float, seed: int) -> Recording:
    """Three rotations at 250 Hz."""
    return load_bench(KNOWN).simulate(
        gap_rad,
        rotations=3.0,
        sampling_hz=250.0,
        start_angle_rad=1.0 + seed,
        seed=np.random.default_rng(seed),
    )


def test_the_prior_from_zero_is_proper_and_log_uniform_far_above_the_smallest_gap() -> None:
    unknown = gap_unknown(0.0, HIGHEST_RAD)
    gap_rad = unknown.value(np.linspace(unknown.low, unknown.high, 100_001))
    assert 0.0 <= gap_rad[0] < 1e-15
    assert gap_rad[-1] == pytest.approx(HIGHEST_RAD)
    assert np.allclose(unknown.coordinate(gap_rad[1:]), np.log(gap_rad[1:] + SMALLEST_GAP_RAD))
    total = math.log(1.0 + HIGHEST_RAD / SMALLEST_GAP_RAD)
    for edge in (1e-6, 1e-5, 1e-3):
        share = math.log(1.0 + edge / SMALLEST_GAP_RAD) / total
        assert np.mean(gap_rad < edge) == pytest.approx(share, abs=1e-4)
    decades = [np.mean((gap_rad > low) & (gap_rad < 3.0 * low)) for low in (3e-4, 3e-3)]
    assert decades[0] == pytest.approx(decades[1], rel=0.03)


def test_a_range_above_zero_is_log_uniform() -> None:
    unknown = gap_unknown(1e-4, HIGHEST_RAD)
    assert unknown.value(np.array([unknown.low, unknown.high])) == pytest.approx([1e-4, 1e-2])
    assert unknown.coordinate(np.array([2e-4])) == pytest.approx(math.log(2e-4))


def test_a_gap_may_be_as_small_as_it_likes_where_its_edges_are_sharp() -> None:
    bench = load_bench(KNOWN)
    none, small = (bench.simulate(g, rotations=1.0).motor_speed_rpm for g in (0.0, 1e-8))
    # The noise of the bench would hide it.
    dull = bench.with_parameters(stiffness_sharpness_per_rad=1e5)
    with pytest.raises(BenchError, match="no dead zone at so small a gap"):
        dull.simulate(1e-6, rotations=1.0)
    dull.simulate(6e-4, rotations=1.0)
    assert np.allclose(none, small, atol=1e-2)


def test_without_impacts_no_clock_is_taken_to_be_off() -> None:
    # By gravity's wave alone one in forty was refused for its gear ratio.
    bench = load_bench(KNOWN)
    for seed in range(20):
        assert observed(recorded(0.0, seed), bench).notes == ()


def test_near_no_gap_signals_are_linear_in_it() -> None:
    bench = load_bench(KNOWN)
    seen = observed(recorded(0.0, 1), bench)
    unknown = gap_unknown(0.0, HIGHEST_RAD)
    noise = noise_of(seen, seen.signals)
    model = SimulatedSignals(bench, [seen], [unknown], [noise], settings={"start_angle_rad": 2.0})
    points = unknown.coordinate(np.array([0.0, 2e-6, 4e-6]))[:, None]
    points[0] = unknown.low
    none, once, twice = model.whitened(points)
    assert np.linalg.norm(twice - none) > 0.1
    away = (twice - none) - 2.0 * (once - none)
    assert np.linalg.norm(away) < 0.05 * np.linalg.norm(twice - none)


@pytest.fixture(scope="module")
def compared(tmp_path_factory) -> Path:
    """Without a gap, then with one of 0.1 mrad."""
    folder = tmp_path_factory.mktemp("small")
    files = []
    for name, gap_rad, seed in (("none", 0.0, 2), ("worn", 1e-4, 3)):
        made = recorded(gap_rad, seed)
        channels = [MOTOR_SPEED, MOTOR_CURRENT]
        table = np.column_stack([made.time_s, *(made.channels[c] for c in channels)])
        files.append(folder / f"{name}.csv")
        np.savetxt(
            files[-1], table, "%.10g", ",", header=",".join(["time_s", *channels]), comments=""
        )
    options = ["--route", "direct", "--bench", KNOWN, "--config", two_ensembles(folder, "compare")]
    out = folder / "out"
    assert cli.status([str(a) for a in ("compare", *files, *options, "--out", out)]) == 0
    return out


def test_a_joint_without_a_gap_is_answered_by_a_bound_and_its_growth_by_an_interval(
    compared, no_figures, capsys
) -> None:
    found = json.loads((compared / "summary.json").read_text())
    none, worn = found["snapshots"]
    assert 0.0 < none["delta_upper_bound_rad"] < 2.0 * SMALLEST_GAP_RAD
    assert none["diagnostics"]["outcome"] == "usable"
    assert none["diagnostics"]["reasons"][0]["code"] == "gap_not_told"
    assert none["reason"] is None
    assert worn["delta_upper_bound_rad"] is None
    sd = worn["posterior_sd"]["delta_rad"]
    # Fails by chance in 1 of 10 000.
    assert abs(worn["delta_rad"]["median"] - 1e-4) < 4.0 * sd
    assert abs(found["change_rad"]["median"] - 1e-4) < 4.0 * sd
    assert found["probability_increase"] > 0.999
    capsys.readouterr()
    assert cli.status(["inspect", str(compared)]) == 0
    told = capsys.readouterr().out
    assert "The gap grew by" in told
    assert "below 0.0" in told


@pytest.mark.long
def test_the_shipped_precision_reducer_is_measured(tmp_path: Path, no_figures) -> None:
    configs = tmp_path / "configs"
    configs.mkdir()
    for name in ("bench_precision.toml", "simulate_precision.toml", "precision.toml"):
        shutil.copy(CONFIGS / name, configs)
    assert cli.status(["simulate", str(configs / "simulate_precision.toml")]) == 0
    assert cli.status(["run", str(configs / "precision.toml")]) == 0
    found = json.loads((tmp_path / "results/precision/summary.json").read_text())
    for part, gap_rad in zip(found["snapshots"], (5e-5, 9e-5), strict=True):
        sd = part["posterior_sd"]["delta_rad"]
        assert sd < 0.05 * gap_rad
        # Fails by chance in 1 of 10 000.
        assert abs(part["delta_rad"]["median"] - gap_rad) < 4.0 * sd
    assert found["change_rad"]["low"] > 3e-5
    assert found["snapshots"][1]["probability_above_limit"] < 0.01
