"""Laws of ``init``: what it writes passes its check, and units follow the numbers."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from places import AFTER, BEFORE
from recording_files import write_csv, write_netcdf

from bayesbl import cli
from bayesbl.bench.motion import cycle
from bayesbl.config.loading import load_config
from bayesbl.errors import RecordingError
from bayesbl.recording.channels import ColumnSpec
from bayesbl.recording.guessing import guess_columns
from bayesbl.recording.readers import read_recording, read_table

SPEED = {"rpm": 1.0, "rad/s": math.pi / 30.0, "deg/s": 6.0}
ANGLE = {"rad": 1.0, "deg": 180.0 / math.pi, "rev": 0.5 / math.pi}
TIME = {"s": 1.0, "ms": 1e3, "us": 1e6}


@pytest.fixture(scope="module")
def measured():
    return read_recording(BEFORE)


def guessed(path: Path) -> dict[str, tuple[str, str]]:
    found = guess_columns(read_table(path))
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


@pytest.mark.parametrize("name", ["I_q", "Iq", "iq_measured", "motorCurrent_q", "I_q [A]"])
def test_a_current_is_no_position(name, measured, tmp_path):
    path = write_csv(
        tmp_path / "joint.csv",
        {"t": measured.time_s, "n": measured.motor_speed_rpm, name: np.sin(measured.time_s)},
    )
    found = guessed(path)
    assert found["motor_current_a"][0] == name
    assert "motor_position_rad" not in found


@pytest.mark.long
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
    if (angle, speed) == ("rad", "rad/s"):  # turns and turns per second agree as well
        assert found["motor_speed_rpm"] == ("Drehzahl", "?")
        return
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
        ("drive1_velocity_degps", "deg/s"),
        ("velocity [°/s]", "deg/s"),
    ],
)
def test_a_unit_in_a_columns_name_is_taken(name, unit, measured, tmp_path):
    values = {"t [ms]": 1e3 * measured.time_s, name: SPEED[unit] * measured.motor_speed_rpm}
    path = write_csv(tmp_path / "joint.csv", values)
    assert guessed(path) == {"time_s": ("t [ms]", "ms"), "motor_speed_rpm": (name, unit)}
    columns = {"time_s": ColumnSpec("t [ms]"), "motor_speed_rpm": ColumnSpec(name)}
    read = read_recording(path, columns=columns)
    assert read.motor_speed_rpm == pytest.approx(measured.motor_speed_rpm)
    assert read.time_s == pytest.approx(measured.time_s)
    assert [note for note in read.notes if name in note] == (
        [] if unit == "rpm" else [f'The unit of column "{name}" is taken from its name: {unit}.']
    )
    stated = {**columns, "motor_speed_rpm": ColumnSpec(name, "Hz")}
    read = read_recording(path, columns=stated)
    assert read.motor_speed_rpm == pytest.approx(60.0 * values[name])
    wrong = {"time_s": ColumnSpec("t [ms]"), "motor_current_a": ColumnSpec(name)}
    with pytest.raises(RecordingError, match="not known for this channel"):
        read_recording(path, columns=wrong)


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
        "torque_enabled": (np.arange(speed.size) > 50).astype(int),
        "comment": ["ok"] * speed.size,
    }
    path = write_csv(tmp_path / "joint.csv", values)
    found = guess_columns(read_table(path))
    assert {column.channel: column.name for column in found.columns} == {
        "time_s": "time",
        "motor_speed_rpm": "speed",
        "load_position_rad": "load_angle_rad",
        "reference_speed_rpm": "speed_ref",
    }
    assert found.unused == ("load_speed", "torque_enabled", "comment")


def test_what_no_name_tells_is_left_to_fill_in(measured, tmp_path, capsys):
    path = write_csv(tmp_path / "joint.csv", {"time": measured.time_s, "x": measured.time_s})
    out = tmp_path / "a.toml"
    assert cli.status(["init", str(path), "--out", str(out)]) == cli.WRONG
    assert 'cannot run yet: fill in each "?"' in " ".join(capsys.readouterr().err.split())
    assert 'motor_position_rad = {name = "?", unit = "?"}' in out.read_text()
    assert cli.status(["check", str(out)]) == cli.WRONG
    assert "unit of motor_position_rad is not known" in capsys.readouterr().err
    out.write_text(out.read_text().replace('"?", unit = "?"', '"x", unit = "rev/4096"'))
    assert load_config(out).column_specs["motor_position_rad"] == ColumnSpec("x", "rev/4096")


@pytest.mark.parametrize(
    ("first", "third", "told"),
    [
        ("2000.5", "OVL", 'line 4, column "speed": There is text in a column of numbers.'),
        ("rpm", "OVL", 'line 4, column "speed": There is text in a column of numbers.'),
        ("", "", 'column "speed": This column is not a series of numbers. Found: 1 finite'),
    ],
)
def test_a_recording_that_holds_no_numbers_gets_no_configuration(
    first, third, told, tmp_path, capsys, recwarn
):
    rows = [f"{'s' if first == 'rpm' else 0.0},{first}", "0.001,1999", f"0.002,{third}"]
    path = tmp_path / "joint.csv"
    path.write_text("\n".join(["t,speed", *rows]) + "\n")
    assert cli.status(["init", str(path), "--out", str(tmp_path / "a.toml")]) == cli.WRONG
    printed = capsys.readouterr()
    assert told in printed.err
    assert not printed.out
    assert not recwarn.list
    assert list(tmp_path.iterdir()) == [path]


def test_a_recording_that_is_not_there_leaves_no_configuration(tmp_path, capsys):
    arguments = ["init", str(BEFORE), str(tmp_path / "none.csv"), "--out", str(tmp_path / "a.toml")]
    assert cli.status(arguments) == cli.WRONG
    assert "none.csv: There is no such file" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["joint_speed", "load_position"])
def test_a_column_of_the_joint_is_told_to_need_the_gear_ratio(name, measured, tmp_path):
    values = {"time_s": measured.time_s, name: measured.motor_speed_rpm / 120.0}
    found = guess_columns(read_table(write_csv(tmp_path / "joint.csv", values)))
    (asked,) = (c.reason for c in found.columns if c.channel == "motor_position_rad")
    assert f'or "{name}", behind the gearbox: enter the gear ratio with its unit' in asked


def test_init_of_strokes_asks_for_a_bench_and_is_no_failure(tmp_path, capsys):
    time_s = np.arange(0.0, 4.0, 1e-3)
    speed = cycle(120.0, (-0.5, 0.5), 1500.0, 6000.0, 0.15, 4.0).speed_rpm(time_s)
    values = {"time_s": time_s, "motor_speed_rpm": speed, "reference_speed_rpm": speed}
    path = write_csv(tmp_path / "strokes.csv", values)
    assert cli.status(["init", str(path), "--out", str(tmp_path / "a.toml")]) == 0
    printed = capsys.readouterr()
    assert not printed.err
    assert "fill in bench" in " ".join(printed.out.split())


def test_what_cannot_run_is_not_told_to_run(measured, tmp_path, capsys):
    values = {"t [s]": measured.time_s[::40], "speed [rpm]": measured.motor_speed_rpm[::40]}
    path = write_csv(tmp_path / "slow.csv", values)
    assert cli.status(["init", str(path), "--out", str(tmp_path / "a.toml")]) == cli.WRONG
    printed = capsys.readouterr()
    assert "It cannot run yet:" in printed.out
    assert "bayesbl run" not in printed.out
    assert "sampling rate" in printed.err


def test_a_configuration_is_not_written_over(tmp_path, capsys):
    out = tmp_path / "mine.toml"
    out.write_text("years of work")
    assert cli.status(["init", str(BEFORE), "--out", str(out)]) == cli.WRONG
    assert out.read_text() == "years of work"
    assert cli.status(["init", str(BEFORE), "--out", str(out), "--force"]) == 0


def test_strange_names_stay_text(measured, tmp_path, capsys):
    path = tmp_path / 'x\' #1 (old) "now".csv'
    write_csv(path, {"time_s": measured.time_s, 'n "1" [rpm]': measured.motor_speed_rpm})
    out = tmp_path / "strange.toml"
    assert cli.status(["init", str(path), "--out", str(out)]) in (0, cli.WRONG)
    assert load_config(out).recordings[0].file == path
