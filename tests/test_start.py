"""Laws of ``init``: what it writes passes its check, and units follow the numbers."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from recording_files import write_csv, write_netcdf

from bayesbl import cli
from bayesbl.config.loading import load_config
from bayesbl.errors import RecordingError
from bayesbl.recording.guessing import guess_columns
from bayesbl.recording.readers import read_recording, read_table

RECORDINGS = Path(__file__).parents[1] / "configs" / "recordings"
BEFORE, AFTER = RECORDINGS / "wear_before.csv", RECORDINGS / "wear_after.csv"

SPEED = {"rpm": 1.0, "rad/s": math.pi / 30.0, "deg/s": 6.0}
ANGLE = {"rad": 1.0, "deg": 180.0 / math.pi, "rev": 0.5 / math.pi}
TIME = {"s": 1.0, "ms": 1e3, "us": 1e6}


@pytest.fixture(scope="module")
def measured():
    return read_recording(BEFORE)


def guessed(path: Path) -> dict[str, tuple[str, str]]:
    found = guess_columns(path, read_table(path))
    return {column.channel: (column.name, column.unit) for column in found.columns}


@pytest.mark.parametrize("recordings", [[BEFORE], [BEFORE, AFTER]])
def test_the_first_configuration_passes_its_check(recordings, tmp_path, capsys):
    out = tmp_path / "first.toml"
    assert cli.status(["init", *map(str, recordings), "--out", str(out)]) == 0
    assert str(out) in capsys.readouterr().out
    assert cli.status(["check", str(out)]) == 0
    config = load_config(out)
    assert config.kind == ("fit" if len(recordings) == 1 else "compare")
    assert [entry.file for entry in config.recordings] == recordings


@pytest.mark.parametrize("time", TIME)
@pytest.mark.parametrize("speed", SPEED)
@pytest.mark.parametrize("angle", ["rad", "rev"])
def test_unstated_units_are_found_from_the_numbers(time, speed, angle, measured, tmp_path):
    """Speed and position agree in one pair of units that is usual for a motor."""
    path = write_csv(
        tmp_path / "joint.csv",
        {
            "Zeit": TIME[time] * measured.time_s,
            "Drehzahl": SPEED[speed] * measured.motor_speed_rpm,
            "MotorPos": ANGLE[angle] * measured.channels["motor_position_rad"],
        },
    )
    found = guessed(path)
    assert found["time_s"] == ("Zeit", time)
    factor = {"rpm": 1.0, "rad/s": 30.0 / math.pi, "deg/s": 1.0 / 6.0, "rev/s": 60.0, "Hz": 60.0}
    mean = np.mean(SPEED[speed] * measured.motor_speed_rpm) * factor[found["motor_speed_rpm"][1]]
    assert mean == pytest.approx(2000.0, rel=0.02)


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("omega_m [rad/s]", "rad/s"),
        ("Speed (rpm)", "rpm"),
        ("velocity_rad_per_s", "rad/s"),
        ("MotorSpeed_deg_s", "deg/s"),
    ],
)
def test_a_unit_in_a_columns_name_is_taken(name, unit, measured, tmp_path):
    values = {"t [ms]": 1e3 * measured.time_s, name: SPEED[unit] * measured.motor_speed_rpm}
    found = guessed(write_csv(tmp_path / "joint.csv", values))
    assert found == {"time_s": ("t [ms]", "ms"), "motor_speed_rpm": (name, unit)}


def test_a_unit_that_the_file_states_is_taken(measured, tmp_path):
    values = {"t": measured.time_s, "w": SPEED["rad/s"] * measured.motor_speed_rpm}
    found = guessed(write_netcdf(tmp_path / "joint.nc", values, w="rad/s"))
    assert found["motor_speed_rpm"] == ("w", "rad/s")


def test_reference_and_load_are_not_taken_for_the_motor(measured, tmp_path):
    speed = measured.motor_speed_rpm
    values = {
        "time": measured.time_s,
        "speed_ref": np.full(speed.size, 2000.0),
        "load_speed": speed / 120.0,
        "load_angle_rad": measured.channels["motor_position_rad"] / 120.0,
        "speed": speed,
        "comment": ["ok"] * speed.size,
    }
    path = write_csv(tmp_path / "joint.csv", values)
    found = guess_columns(path, read_table(path))
    assert {column.channel: column.name for column in found.columns} == {
        "time_s": "time",
        "motor_speed_rpm": "speed",
        "load_position_rad": "load_angle_rad",
        "reference_speed_rpm": "speed_ref",
    }
    assert found.unused == ("load_speed", "comment")


def test_a_file_without_speed_is_refused(measured, tmp_path, capsys):
    path = write_csv(tmp_path / "joint.csv", {"time": measured.time_s, "x": measured.time_s})
    with pytest.raises(RecordingError, match="motor speed"):
        guess_columns(path, read_table(path))
    assert cli.status(["init", str(path), "--out", str(tmp_path / "a.toml")]) == cli.WRONG
    assert not (tmp_path / "a.toml").exists()


def test_a_configuration_is_not_written_over(tmp_path, capsys):
    out = tmp_path / "mine.toml"
    out.write_text("years of work")
    assert cli.status(["init", str(BEFORE), "--out", str(out)]) == cli.WRONG
    assert out.read_text() == "years of work"
    assert cli.status(["init", str(BEFORE), "--out", str(out), "--force"]) == 0


def test_strange_names_stay_text(measured, tmp_path, capsys):
    path = tmp_path / 'x\' #1 (old) "now".csv'
    write_csv(path, {"time_s": measured.time_s, 'n "rpm"': measured.motor_speed_rpm})
    out = tmp_path / "strange.toml"
    assert cli.status(["init", str(path), "--out", str(out)]) in (0, cli.WRONG)
    assert load_config(out).recordings[0].file == path
