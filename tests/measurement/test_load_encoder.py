"""The load's encoder as a witness: beside the answer, told first where it disagrees, else silent.

A joint with friction and no weight, stroking to and fro slowly enough that its load stays in the
play while the motor crosses it.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from places import CONFIGS
from quick import two_ensembles, without_figures
from recording_files import write_csv

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.kernel import TWIST
from bayesbl.bench.motion import cycle
from bayesbl.bench.simulation import simulate_motions
from bayesbl.cli import status
from bayesbl.config.bench import dump_bench, load_bench
from bayesbl.config.measurement import CompareConfig
from bayesbl.measurement.auto_route import disagreement, with_witness, within_bound
from bayesbl.measurement.measurement import Answer, Measurement, Seeds, Task
from bayesbl.presentation.answer import lead, which
from bayesbl.recording.types import LOAD_POSITION, MOTOR_POSITION, Recording
from bayesbl.results.store import read_tree

pytestmark = pytest.mark.long

GAP_RAD, OTHER_RAD = 2e-3, 2e-2
MOTION = cycle(120.0, (-0.2, 0.2), 400.0, 800.0, 0.1, 12.0)


def joint() -> Bench:
    friction = BenchEffect("load_coulomb_friction", {"torque_nm": EffectParameterValue(30.0, 0.4)})
    known = load_bench(CONFIGS / "bench.toml")
    return known.with_parameters(gravity_torque_nm=0.0).with_effects(friction)


def recorded(load_gap_rad: float = GAP_RAD, name: str = "r") -> Recording:
    """Of δ by the motor, and by the load's encoder of 2^19 counts.

    Torque and lag are then of two joints, so that the lag alone must tell play from wind-up.
    """
    bench, seed = joint(), np.random.default_rng(5)
    made = bench.simulate(GAP_RAD, MOTION, sampling_hz=250.0, seed=seed, name=name)
    at = bench.vector(gap_rad=load_gap_rad, start_angle_rad=MOTION.start_angle_rad)
    states = simulate_motions(at, MOTION, made.samples, 250.0, states=True)[0]
    step = 2.0 * np.pi / 2**19
    load = step * np.round((states[0] / bench.value("gear_ratio") - states[TWIST]) / step)
    return replace(made, channels={**made.channels, LOAD_POSITION: load})


def by_motor(*names: str) -> Measurement:
    """What a route says that goes by the motor alone: δ within 0.5 %."""
    draws = GAP_RAD * np.exp(5e-3 * np.random.default_rng(1).standard_normal((2, 500)))
    return Measurement("direct", [Answer(name, draws) for name in names])


def witnessed(*recordings: Recording) -> Measurement:
    names = [recording.name for recording in recordings]
    entries = [{"name": name, "file": __file__} for name in names]
    told = {"run": {"output": "out"}, "joint": {"gear_ratio": 120.0}, "recordings": entries}
    config = CompareConfig.model_validate({"schema": 1, "kind": "compare", **told})
    task = Task(config, recordings, Seeds.spawn(1, len(recordings)))
    return with_witness(by_motor(*names), task)


def test_the_witness_stands_beside_an_answer_that_stays():
    lost = np.arange(3001) % 100 == 7
    whole = recorded()
    speed = {name: v for name, v in whole.channels.items() if name != MOTOR_POSITION}
    found = witnessed(replace(whole, excluded=lost), replace(whole, name="again", channels=speed))
    (witness,) = found.beside
    for answer in witness.answers:
        assert np.quantile(answer.delta_rad, 0.01) < GAP_RAD < np.quantile(answer.delta_rad, 0.99)
        assert not answer.is_withheld
    assert found.change_reason is None
    assert found.why.code == "witnessed"
    np.testing.assert_array_equal(found.answers[0].delta_rad, by_motor("r").answers[0].delta_rad)


def test_a_load_of_another_gap_is_told_first(tmp_path, capsys):
    made = recorded(OTHER_RAD)
    file = write_csv(tmp_path / "r.csv", {"time_s": made.time_s, **made.channels})
    (tmp_path / "bench.toml").write_text(dump_bench(joint()))
    given = ["--config", two_ensembles(tmp_path, "fit"), "--bench", tmp_path / "bench.toml"]
    out = tmp_path / "out"
    with without_figures():
        assert status(list(map(str, ["fit", file, *given, "--out", out]))) == 3
    found = json.loads((out / "summary.json").read_text())
    assert found["reason"]["code"] == "routes_disagree"
    assert found["answer"]["route"] == "direct"
    assert found["delta_rad"]["median"] == pytest.approx(GAP_RAD, rel=0.02)
    witness = found["routes"]["two_encoders"]
    assert witness["delta_rad"]["low"] < OTHER_RAD < witness["delta_rad"]["high"]
    assert "delta_rad" in read_tree(out / "result.nc")["two_encoders/posterior"]
    first, *_ = lead(found)
    assert first == found["reason"]["text"]
    assert "the two encoders of motor and load" in first
    assert "two encoders compare the positions" in which(found)
    assert first.split(" disagree")[0] in " ".join(capsys.readouterr().out.split())


def test_a_bound_disagrees_with_gaps_far_above_it_alone():
    answer, below = by_motor("r"), np.full((4, 1000), 1e-5)
    for bound_rad, disagrees in ((1.2 * GAP_RAD, False), (0.8 * GAP_RAD, False), (2e-4, True)):
        bounded = within_bound(Answer("r", below, upper_bound_rad=bound_rad))
        witness = Measurement("two_encoders", [bounded])
        assert (disagreement(answer, witness, witness=True) is not None) == disagrees


def test_of_a_steady_rotation_the_witness_is_withheld_and_nothing_else_changes(tmp_path):
    bench = load_bench(CONFIGS / "bench.toml")
    seed = np.random.default_rng(3)
    made = bench.simulate(8e-4, rotations=3.0, sampling_hz=250.0, seed=seed)
    columns = {"time_s": made.time_s, **made.channels}
    files = {
        "alone": write_csv(tmp_path / "alone.csv", columns),
        "both": write_csv(
            tmp_path / "both.csv", {**columns, LOAD_POSITION: columns[MOTOR_POSITION] / 120.0}
        ),
    }
    given = ["--curve", "published", "--config", two_ensembles(tmp_path, "fit")]
    found = {}
    for name, file in files.items():
        out = tmp_path / name
        with without_figures():
            assert status(list(map(str, ["fit", file, *given, "--out", out]))) == 0
        found[name] = json.loads((out / "summary.json").read_text())
    alone, both = found["alone"], found["both"]
    witness = both["routes"].pop("two_encoders")
    assert witness["delta_rad"] is None
    assert "does not reverse" in witness["reason"]["text"]
    assert both["routes"] == alone["routes"]
    for key in ("outcome", "reason", "answer", "delta_rad", "diagnostics"):
        assert both[key] == alone[key]
