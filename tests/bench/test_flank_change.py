"""Whether a joint shows its gap at one speed is told before anything is fitted."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from bayesbl.bench.bench import (
    Bench,
    BenchEffect,
    EffectParameterValue,
    require_flank_change,
    steady_torque_nm,
)
from bayesbl.bench.simulation import simulate_channels
from bayesbl.bench.steady import contact_rates, sampled_period, settling_time_s
from bayesbl.cli import WRONG, status
from bayesbl.config.bench import dump_bench, reference_bench
from bayesbl.errors import NoFlankChange

BENCH = reference_bench()


def effect(name: str, **parameters: float) -> BenchEffect:
    return BenchEffect(name, {k: EffectParameterValue(v) for k, v in parameters.items()})


def drawn(rng: np.random.Generator) -> Bench:
    gravity = float(rng.choice([0.0, 40.0, 200.0, 425.0]))
    return BENCH.with_parameters(gravity_torque_nm=gravity).with_effects(
        effect("load_torque_offset", torque_nm=float(rng.uniform(-600.0, 600.0))),
        effect("load_coulomb_friction", torque_nm=float(rng.uniform(0.0, 60.0))),
    )


@pytest.mark.parametrize("seed", range(20))
def test_what_is_refused_is_what_the_simulator_does_not_ring_at(seed: int) -> None:
    """An independent sign: where the flank never changes, the speed does not depend on the gap."""
    bench = drawn(np.random.default_rng(seed))
    low, high = steady_torque_nm(bench, 2000.0)
    if min(abs(low), abs(high)) < 10.0 and high - low > 0.0:
        pytest.skip("hardly passes the gap")
    parameters = bench.vector(gap_rad=np.array([2e-4, 2e-3]))
    first, second = simulate_channels(parameters, 3600, 1000.0)[:, 1]
    shows = bool(np.max(np.abs(first - second)) > 0.5)
    if shows:
        require_flank_change(bench)
        return
    with pytest.raises(NoFlankChange, match="strokes") as refusal:
        require_flank_change(bench)
    assert refusal.value.code == "no_flank_change"


def test_the_torque_over_a_rotation_is_gravity_and_what_acts_at_the_load() -> None:
    bench = BENCH.with_effects(effect("load_coulomb_friction", torque_nm=30.0))
    assert steady_torque_nm(bench, 2000.0) == pytest.approx((30.0 - 425.0, 30.0 + 425.0), abs=0.1)
    assert steady_torque_nm(bench, -2000.0) == pytest.approx((-455.0, 395.0), abs=0.1)


def test_one_direction_that_shows_the_gap_is_enough() -> None:
    held = BENCH.with_parameters(gravity_torque_nm=20.0).with_effects(
        effect("load_torque_offset", torque_nm=15.0),
        effect("load_coulomb_friction", torque_nm=10.0),
    )
    require_flank_change(held, [-500.0])
    require_flank_change(held, [500.0, -500.0])
    with pytest.raises(NoFlankChange, match="at 500 rpm"):
        require_flank_change(held, [500.0])


@pytest.mark.parametrize("joint", ["vertical", "loaded to one side"])
def test_every_command_that_seeks_a_gap_says_so(
    joint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    bench = BENCH.with_parameters(gravity_torque_nm=0.0)
    if joint != "vertical":
        bench = BENCH.with_effects(effect("load_torque_offset", torque_nm=500.0))
    Path("bench.toml").write_text(dump_bench(bench))
    Path("sweep.toml").write_text(
        'schema = 1\nkind = "sweep"\nbench = "bench.toml"\n[sweep]\nbench_draws = 0\n'
    )
    rng = np.random.default_rng(4)
    for name in ("a.csv", "b.csv"):
        seen = bench.simulate(8e-4, sampling_hz=500.0, seed=rng)
        table = [seen.time_s, seen.channels["motor_speed_rpm"], seen.channels["motor_current_a"]]
        header = "time_s,motor_speed_rpm,motor_current_a"
        np.savetxt(name, np.column_stack(table), delimiter=",", header=header, comments="")
    by_bench = ("--bench", "bench.toml")
    commands = [("sweep", "sweep.toml"), ("check", "sweep.toml"), ("fit", "a.csv", *by_bench)]
    for route in ("auto", "direct", "amplitude"):
        commands.append(("compare", "a.csv", "b.csv", *by_bench, "--route", route))
    for command in commands:
        assert status(command) == WRONG
        told = " ".join(capsys.readouterr().err.split())
        assert "never changes from one tooth flank to the other" in told
        assert "strokes" in told


def test_a_sampled_loop_whose_modes_alternate_has_rates() -> None:
    """Where all factors over a period are real, some are negative: their logarithm is complex."""
    alternating = 0
    for period in np.geomspace(1e-4, 1e-3, 20):
        row = BENCH.vector(
            shaft_damping_nm_s_per_rad=1e4,
            speed_gain_nm_s_per_rad=0.07,
            integral_gain_nm_per_rad=0.0,
            sampled_control__period_s=float(period),
            sampled_control__delay_periods=1.0,
        )
        factors = np.linalg.eigvals(sampled_period(row[0])[0])
        alternating += bool(np.isrealobj(factors) and factors.min() < -1e-3)
        rates = contact_rates(row)[0]
        assert math.exp(period * rates.real.max()) == pytest.approx(np.abs(factors).max())
        assert np.isfinite(settling_time_s(row, 1e-3)).all()
    assert alternating > 0
