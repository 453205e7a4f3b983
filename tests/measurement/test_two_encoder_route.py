"""Two encoders from files to the answer: what is refused, guessed, and given."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from quick import without_figures
from recording_files import write_csv

from bayesbl.cli import status
from bayesbl.recording.guessing import guess_columns
from bayesbl.recording.readers import read_table

RATIO = 20.0


def write(path: Path, play=8e-3, cycles=5, **others) -> Path:
    generator = np.random.default_rng(int(1e6 * play))
    time = np.arange(0.0, 2.0 * cycles, 8e-3) + 1e-3 * generator.uniform(size=250 * cycles)
    motor = np.sin(np.pi * time) if cycles > 1 else 0.5 * time
    load, at = [], motor[0]
    for x in motor:
        at = min(max(at, x - 0.5 * play), x + 0.5 * play)
        load.append(at)
    noise = 1e-4 * generator.standard_normal(time.size)
    columns = {
        "time_s": time,
        "motor_position_rad": RATIO * motor,
        "load_position_rad": np.array(load) + noise,
        **{name: values(time) for name, values in others.items()},
    }
    return write_csv(path, columns)


def run(*arguments) -> int:
    with without_figures():
        return status([*map(str, arguments), "--route", "two_encoders", "--gear-ratio", str(RATIO)])


def test_a_comparison_gives_both_plays_and_their_change(tmp_path):
    files = write(tmp_path / "new.csv"), write(tmp_path / "worn.csv", play=16e-3)
    assert run("compare", *files, "--out", tmp_path / "out") == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    for part, play in zip(summary["snapshots"], (8e-3, 16e-3), strict=True):
        assert part["route"] == "two_encoders"
        assert part["delta_upper_bound_rad"] is None
        assert part["play_rad"]["median"] == pytest.approx(play, rel=0.1)
        assert part["delta_rad"]["median"] == pytest.approx(0.5 * play, rel=0.1)
        assert part["gear_ratio"]["median"] == pytest.approx(RATIO, rel=0.01)
        assert abs(part["channel_skew_s"]["median"]) < 1e-3
        assert part["windup_rad_per_nm"] is None
        assert part["transmission_error"]["peak_to_peak_rad"]["median"] < 2e-3
    assert summary["change_rad"]["low"] < 4e-3 < summary["change_rad"]["high"]
    # Where there is play at both dates, it grew for sure.
    sure = min(part["probability_of_play"] for part in summary["snapshots"])
    assert summary["probability_increase"] >= sure > 0.95


def test_a_joint_has_play_or_none_at_both_dates(tmp_path):
    """Where play is likely but not sure, the change is known far better than both gaps."""
    plays = 2.4e-3, 3e-3
    files = [write(tmp_path / f"{play}.csv", play=play) for play in plays]
    assert run("compare", *files, "--out", tmp_path / "out") == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    for part in summary["snapshots"]:
        assert 0.5 < part["probability_of_play"] < 0.95
    change, growth = summary["change_rad"], 0.5 * (plays[1] - plays[0])
    assert -0.1 * growth < change["low"] < growth < change["high"] < 0.5 * plays[0]


def test_no_change_is_told_between_recordings_that_show_no_play(tmp_path):
    """That play is unlikely is the prior's, and no evidence that nothing changed."""
    files = [write(tmp_path / f"{name}.csv", play=play) for name, play in (("a", 0.0), ("b", 1e-6))]
    assert run("compare", *files, "--upright", "--out", tmp_path / "out") == 3
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["change_rad"] is None
    assert summary["probability_increase"] is None
    assert summary["reason"]["code"] == "change_of_bounds"
    after = summary["snapshots"][-1]["delta_upper_bound_rad"]
    assert summary["reason"]["upper_rad"] == pytest.approx(after)
    assert after < 1e-3


def test_a_load_that_may_rest_on_one_flank_gets_no_bound_without_torque(tmp_path):
    """A load that its weight holds follows its flank exactly, whatever the play."""
    recording = write(tmp_path / "held.csv", play=0.0)
    answers = {}
    for name, options in {"unknown": (), "upright": ("--upright",)}.items():
        status_of_run = run("fit", recording, "--out", tmp_path / name, *options)
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        answers[name] = status_of_run, summary
    code, part = answers["unknown"]
    assert code == 3
    assert part["delta_upper_bound_rad"] is None
    assert part["reason"]["code"] == "weight_unknown"
    code, part = answers["upright"]
    assert code == 0
    assert part["delta_upper_bound_rad"] < 1e-3


def test_wind_up_of_a_soft_joint_on_one_flank_is_not_a_bound_of_its_play(tmp_path):
    """Weight above its friction keeps the load on a flank: only what friction winds up shows."""
    wound, rings_s2 = 4e-3, 1e-4
    time = np.arange(0.0, 40.0, 5e-3)
    motor = 0.2 * np.sin(1.6 * time) + 0.1 * np.sin(2.7 * time + 1.0)
    load, at = [], motor[0]
    for x in motor:
        at = min(max(at, x - wound), x + wound)
        load.append(at)
    # On its flank, and behind by its inertia.
    load = np.array(load) - 0.015 - rings_s2 * np.gradient(np.gradient(motor, time), time)
    load += 3e-4 * np.random.default_rng(4).standard_normal(time.size)
    columns = {"time_s": time, "motor_position_rad": RATIO * motor, "load_position_rad": load}
    assert run("fit", write_csv(tmp_path / "held.csv", columns), "--out", tmp_path / "out") == 3
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["reason"]["code"] == "weight_unknown"


def test_an_upright_joint_that_a_hand_holds_on_one_flank_gets_no_bound(tmp_path):
    """Not only weight holds a load: the torque shows that something does."""

    def torque(time):
        return (30.0 + 5.0 * np.sign(np.cos(np.pi * time))) / RATIO

    file = write(tmp_path / "held.csv", play=0.0, motor_torque_nm=torque)
    assert run("fit", file, "--upright", "--out", tmp_path / "out") == 3
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["reason"]["code"] == "held_by_weight"


def test_a_likely_play_leaves_its_load_no_flank_to_rest_on(tmp_path):
    """What shows is play, not wind-up on one flank: its bound needs no torque."""
    play = 3e-3
    assert run("fit", write(tmp_path / "worn.csv", play=play), "--out", tmp_path / "out") == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["probability_of_play"] < 0.95
    assert 0.5 * play <= summary["delta_upper_bound_rad"] < play


def test_a_motor_that_does_not_turn_back_is_refused(tmp_path, capsys):
    file = write(tmp_path / "one_way.csv", cycles=1)
    assert run("fit", file, "--out", tmp_path / "out") != 0
    assert "does not reverse" in capsys.readouterr().err


def test_a_load_of_another_joint_is_refused(tmp_path, capsys):
    file = write(tmp_path / "other.csv", load_position_rad=lambda time: np.cos(2.7 * time) ** 2)
    assert run("fit", file, "--out", tmp_path / "out") != 0
    assert "does not follow the motor" in capsys.readouterr().err


@pytest.mark.long
def test_a_motor_that_wraps_faster_than_it_is_sampled_is_refused(tmp_path, capsys):
    file = write(
        tmp_path / "wraps.csv",
        motor_position_rad=lambda time: np.mod(400.0 * np.sin(np.pi * time), 2.0 * np.pi),
    )
    assert run("fit", file, "--out", tmp_path / "out") != 0
    assert "too far between two samples" in capsys.readouterr().err


def test_init_knows_two_encoders(tmp_path):
    file = write(tmp_path / "joint.csv")
    guess = guess_columns(read_table(file))
    assert guess.route == "two_encoders"
