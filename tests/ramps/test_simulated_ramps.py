"""A simulated test stand: torque ramps with the output held, from the simulate file to the play."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from quick import without_figures

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.cli import status
from bayesbl.config.bench import dump_bench, reference_bench
from bayesbl.recording.channels import MOTOR_POSITION, MOTOR_TORQUE
from bayesbl.recording.readers import read_recording

SIMULATE = """
schema = 1
kind = "simulate"
bench = "bench.toml"
truth_file = "truth.json"

[run]
seed = 3

[[recordings]]
name = "new"
file = "new.csv"
gap_rad = 8e-4
sampling_hz = 500
motion = {kind = "torque_ramp", torque_nm = [0.15, 3.0], cycles = 6, period_s = 8.0}

[[recordings]]
name = "worn"
file = "worn.csv"
gap_rad = 2e-3
sampling_hz = 500
motion = {kind = "torque_ramp", torque_nm = [0.15, 3.0], cycles = 6, period_s = 8.0}
"""
FRICTION_NM = 0.02


def with_friction() -> Bench:
    """The reference bench, damped as it is, with dry friction of the motor."""
    friction = {"torque_nm": EffectParameterValue(FRICTION_NM)}
    return reference_bench().with_effects(BenchEffect("motor_coulomb_friction", friction))


def test_the_play_of_a_simulated_stand_is_recovered(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").write_text(dump_bench(with_friction()))
    (tmp_path / "simulate.toml").write_text(SIMULATE)
    assert status(["simulate", str(tmp_path / "simulate.toml")]) == 0
    files = [str(tmp_path / f"{name}.csv") for name in ("new", "worn")]
    assert set(read_recording(files[0]).channels) == {MOTOR_POSITION, MOTOR_TORQUE}
    with without_figures():
        code = status(
            ["compare", *files, "--route", "torque_ramp", "--gear-ratio", "120"]
            + ["--out", str(tmp_path / "out"), "--workers", "1"]
        )
    assert code == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    truth = json.loads((tmp_path / "truth.json").read_text())
    for snapshot, sealed in zip(summary["snapshots"], truth["recordings"], strict=True):
        found = snapshot["delta_rad"]
        assert found["low"] < sealed["gap_rad"] < found["high"], (found, sealed["gap_rad"])
        assert found["high"] - found["low"] < 0.1 * sealed["gap_rad"]
        assert snapshot["friction_torque_nm"]["median"] == pytest.approx(120 * FRICTION_NM, rel=0.5)
    change = summary["change_rad"]
    assert change["low"] < 1.2e-3 < change["high"]
