"""A simulated test stand: torque ramps with the output held, from the simulate file to the play."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from quick import without_figures

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.simulation import Measurement
from bayesbl.cli import status
from bayesbl.config.bench import dump_bench, reference_bench
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.channels import MOTOR_POSITION, MOTOR_TORQUE
from bayesbl.recording.readers import read_recording

GAPS_RAD = {"new": 8e-4, "worn": 2e-3}
SIMULATE = """
schema = 1
kind = "simulate"
bench = "bench.toml"

[run]
seed = 3
"""
RECORDING = """
[[recordings]]
name = "{name}"
file = "{name}.csv"
gap_rad = {gap_rad}
sampling_hz = 250
motion = {{kind = "torque_ramp", torque_nm = [0.15, 3.0], cycles = 5, period_s = 6.0}}
"""
FRICTION_NM = 0.02


def stand() -> Bench:
    """The reference bench, damped as it is, with dry friction of the motor; torque to 5 mN m."""
    friction = {"torque_nm": EffectParameterValue(FRICTION_NM)}
    bench = reference_bench().with_effects(BenchEffect("motor_coulomb_friction", friction))
    return replace(bench, measurement=Measurement(16384, current_noise=NoiseModel(0.01)))


def test_the_play_of_a_simulated_stand_is_recovered(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").write_text(dump_bench(stand()))
    entries = [RECORDING.format(name=name, gap_rad=gap) for name, gap in GAPS_RAD.items()]
    (tmp_path / "simulate.toml").write_text(SIMULATE + "".join(entries))
    assert status(["simulate", str(tmp_path / "simulate.toml")]) == 0
    files = [str(tmp_path / f"{name}.csv") for name in GAPS_RAD]
    assert set(read_recording(files[0]).channels) == {MOTOR_POSITION, MOTOR_TORQUE}
    with without_figures():
        out = ["--out", str(tmp_path / "out"), "--workers", "1"]
        code = status(["compare", *files, "--route", "torque_ramp", "--gear-ratio", "120", *out])
    assert code == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    for snapshot in summary["snapshots"]:
        found, true = snapshot["delta_rad"], GAPS_RAD[snapshot["name"]]
        assert found["low"] < true < found["high"]
        # Ramps so fast that the torque rises by 10 N m as the joint crosses the play.
        assert found["high"] - found["low"] < 0.2 * true
    change = summary["change_rad"]
    assert change["low"] < GAPS_RAD["worn"] - GAPS_RAD["new"] < change["high"]
