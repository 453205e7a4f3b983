"""A diagnosis without a file: what is guessed of recordings and bench, and that a file says it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayesbl.bench.bench import Bench
from bayesbl.cli import status
from bayesbl.config.bench import dump_bench, load_bench, reference_bench
from bayesbl.config.kinds import DiagnoseConfig
from bayesbl.config.loading import dump_config, load_config
from bayesbl.errors import RecordingError
from bayesbl.recording.types import (
    LOAD_POSITION,
    MOTOR_CURRENT,
    MOTOR_POSITION,
    MOTOR_SPEED,
    MOTOR_TORQUE,
    REFERENCE_SPEED,
    Recording,
)
from bayesbl.runs.diagnose import diagnosis_of, guess_diagnosis

RIGID = """
schema = 1
kind = "bench"
drive = "rigid"
[parameters]
gear_ratio = {value = 100.0}
motor_inertia_kg_m2 = {value = 2e-3, relative_tolerance = 0.1}
load_inertia_kg_m2 = {value = 60.0, relative_tolerance = 0.1}
speed_gain_nm_s_per_rad = {value = 0.2, relative_tolerance = 0.1}
integral_gain_nm_per_rad = {value = 5.0}
"""


@pytest.fixture
def rigid(tmp_path: Path) -> Bench:
    (tmp_path / "rigid.toml").write_text(RIGID)
    return load_bench(tmp_path / "rigid.toml")


def turning(rpm: float, *channels: str, lasting_s: float = 30.0) -> Recording:
    """One speed, and other channels that vary."""
    rng = np.random.default_rng(int(abs(rpm)))
    time = np.arange(round(500.0 * lasting_s)) / 500.0
    values = {name: rng.standard_normal(time.size) for name in channels}
    values[MOTOR_SPEED] = rpm + rng.standard_normal(time.size)
    return Recording(f"{rpm:g}".replace("-", "reverse "), time, values)


def swinging(name: str, *channels: str) -> Recording:
    """A motion that comes to rest, and other channels that vary."""
    rng = np.random.default_rng(1)
    time = np.arange(4000) / 500.0
    values = {channel: rng.standard_normal(time.size) for channel in channels}
    values[MOTOR_POSITION] = np.exp(-0.3 * time) * np.cos(6.0 * time)
    return Recording(name, time, values)


def guessed(bench: Bench, *recordings: Recording) -> dict[tuple[str, str], object]:
    found = guess_diagnosis(bench, recordings)
    assert all(choice.reason for choice in found)
    return {choice.place: choice.value for choice in found}


def test_a_joint_with_a_gap_is_compared_in_its_closed_loop() -> None:
    three = [turning(rpm, MOTOR_CURRENT) for rpm in (2000.0, -2000.0, 1200.0)]
    found = guessed(reference_bench(), *three)
    assert found["comparison", "method"] == "forward"
    assert found["comparison", "channels"] == (MOTOR_SPEED, MOTOR_CURRENT)
    assert {found[r.name, "use"] for r in three} == {"split"}
    assert found["1200", "reference_speed_rpm"] == 1200.0
    assert ("2000", "reference_speed_rpm") not in found  # the bench's own


def test_one_of_four_speeds_is_held_out_and_it_lies_between_the_others() -> None:
    four = [turning(rpm) for rpm in (2000.0, -2000.0, 1200.0, 1600.0)]
    found = guessed(reference_bench(), *four)
    assert {r.name: found[r.name, "use"] for r in four} == {
        "2000": "fit", "reverse 2000": "fit", "1200": "fit", "1600": "hold_out"
    }  # fmt: skip
    assert found["comparison", "channels"] == (MOTOR_SPEED,)


def test_what_is_too_short_for_two_halves_is_not_split() -> None:
    two = [turning(rpm, lasting_s=8.0) for rpm in (2000.0, -2000.0)]
    found = guessed(reference_bench(), *two)  # 2.2 load rotations
    assert [found[r.name, "use"] for r in two] == ["fit", "hold_out"]


@pytest.mark.parametrize(
    ("channels", "method", "compared", "unknown"),
    [
        ((MOTOR_TORQUE, LOAD_POSITION), "inverse", (MOTOR_TORQUE,), ("load_inertia_kg_m2",)),
        ((MOTOR_CURRENT,), "inverse", (MOTOR_CURRENT,), ("load_inertia_kg_m2",)),
        ((), "free_motion", (MOTOR_POSITION,), ("load_inertia_kg_m2",)),
    ],
)
def test_a_rigid_machine_s_method_follows_from_its_channels(
    rigid: Bench, channels, method, compared, unknown
) -> None:
    found = guessed(rigid, swinging("a", *channels), swinging("b", *channels))
    assert found["comparison", "method"] == method
    assert found["comparison", "channels"] == compared
    assert found.get(("unknowns", "bench_parameters")) == unknown
    assert (found["a", "use"], found["b", "use"]) == ("fit", "hold_out")


def test_two_encoders_alone_are_no_free_motion(rigid: Bench) -> None:
    with pytest.raises(RecordingError, match="two_encoders"):
        guess_diagnosis(rigid, [swinging("a", LOAD_POSITION)])


def test_a_torque_that_never_changes_is_none(rigid: Bench) -> None:
    swing = swinging("a")
    swing.channels[MOTOR_TORQUE] = np.zeros(swing.samples)
    found = guessed(rigid, swing)
    assert found["comparison", "method"] == "free_motion"
    assert found["a", "use"] == "split"


def test_a_driven_motion_without_its_torque_is_not_taken_for_a_free_one(rigid: Bench) -> None:
    swing = swinging("a")
    swing.channels[REFERENCE_SPEED] = np.gradient(swing.channels[MOTOR_POSITION], swing.time_s)
    with pytest.raises(RecordingError, match="From motion alone"):
        guess_diagnosis(rigid, [swing])


def test_the_speed_alone_at_constant_speeds_shows_the_loop(rigid: Bench) -> None:
    found = guessed(rigid, turning(300.0), turning(600.0))
    assert found["comparison", "method"] == "forward"
    assert found["unknowns", "bench_parameters"] == (
        "motor_inertia_kg_m2", "load_inertia_kg_m2", "speed_gain_nm_s_per_rad"
    )  # fmt: skip


def test_a_motion_of_a_joint_with_a_gap_is_refused_with_what_to_do() -> None:
    moving = turning(2000.0)
    moving.channels[MOTOR_SPEED] *= np.linspace(-1.0, 1.0, moving.samples)
    with pytest.raises(RecordingError) as refused:
        guess_diagnosis(reference_bench(), [moving])
    assert "bayesbl identify" in str(refused.value.expected)


def test_a_configuration_is_completed_and_says_what_the_command_does(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bench.toml").write_text(dump_bench(reference_bench()))
    for name, rpm in (("forward", 2000.0), ("back", -1200.0)):
        made = turning(rpm, MOTOR_CURRENT)
        columns = [made.time_s, *(made.channels[c] for c in (MOTOR_SPEED, MOTOR_CURRENT))]
        np.savetxt(
            f"{name}.csv",
            np.column_stack(columns),
            "%.6g",
            ",",
            "\n",
            "Time [s],Speed [rpm],Current [A]",
            "",
            "",
        )
    files = [Path("forward.csv"), Path("back.csv")]
    assert status(["init", "forward.csv", "--out", "columns.toml"]) == 0
    text = Path("columns.toml").read_text()
    assert "motor_speed_rpm" in text
    direct, guess = diagnosis_of(files, "columns.toml", bench=Path("bench.toml"))
    assert {choice.place[1] for choice in guess} >= {"method", "channels", "use"}
    Path("ran.toml").write_text(dump_config(direct))
    written = load_config("ran.toml")
    assert isinstance(written, DiagnoseConfig)
    assert written.comparison == direct.comparison
    assert written.unknowns == direct.unknowns
    assert written.recordings == direct.recordings


def test_what_is_missing_is_asked_for(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    np.savetxt("a.csv", np.ones((300, 2)), delimiter=",", header="t,x", comments="")
    assert status(["diagnose", "a.csv"]) == 2
    assert "bayesbl init --bench" in capsys.readouterr().err
    Path("bench.toml").write_text(dump_bench(reference_bench()))
    assert status(["diagnose", "a.csv", "--bench", "bench.toml"]) == 2
    assert "`bayesbl init a.csv`" in capsys.readouterr().err
