"""Files as drives, historians and loggers of plants write them: read as they are meant, or asked
about, or refused with what to do."""

from __future__ import annotations

import datetime
import json
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from bayesbl.errors import RecordingError
from bayesbl.recording import text_table
from bayesbl.recording.array_table import ArrayTable
from bayesbl.recording.channels import ColumnSpec
from bayesbl.recording.formats.ros_bag import _groups
from bayesbl.recording.guessing import UNKNOWN, GuessedColumn, guess_columns
from bayesbl.recording.readers import read_recording, read_table

COUNT = 400
TIME = np.arange(COUNT) / 1000.0
NOISE = np.random.default_rng(3).normal(0.0, 1.0, COUNT)
SPEED = np.round(1500.0 + 30.0 * np.sin(70.0 * TIME) + NOISE, 3)
CURRENT = np.round(2.0 * np.sin(20.0 * TIME) + 0.01 * NOISE, 4)
BEGIN = datetime.datetime(2026, 3, 14, 8, 12, 33, 800_000)
STAMPS = [BEGIN + datetime.timedelta(milliseconds=i) for i in range(COUNT)]
ROWS = list(enumerate(zip(TIME, SPEED, CURRENT, strict=True)))


def lines(form: Callable[[int, float, float, float], str]) -> list[str]:
    return [form(i, t, n, a) for i, (t, n, a) in ROWS]


def table(*header: str, form: str = "{t:.3f},{n},{a}") -> str:
    return "\n".join([*header, *lines(lambda i, t, n, a: form.format(i=i, t=t, n=n, a=a))])


def dated(header: str, form: str, mark: str) -> str:
    stamps = [stamp.strftime(form)[:-3] if "%f" in form else stamp.strftime(form)
              for stamp in STAMPS]  # fmt: skip
    rows = lines(lambda i, t, n, a: f"{stamps[i]}{mark}{n}{mark}{a}")
    return "\n".join([header, *rows])


def by_tag(header: str, form: Callable[[int, str, float], str]) -> str:
    both = (("speed_rpm", SPEED), ("current_A", CURRENT))
    return "\n".join([header, *(form(i, tag, v[i]) for i in range(COUNT) for tag, v in both)])


def guessed(path: Path, joint: str | None = None) -> dict[str, GuessedColumn]:
    return {c.channel: c for c in guess_columns(read_table(path), joint).columns}


def written(folder: Path, content: str | bytes, name: str = "a.csv") -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


SAME = {
    "a row of kinds above the units": table(
        "ETASAsciiItemFile\trecord", "time\tn_mot\ti_mot", "f8\tf8\tf8", "s\trpm\tA",
        form="{t:.3f}\t{n}\t{a}",
    ),
    "a row of other kinds below the units": table(
        "Time;Speed;Current", "s;rpm;A", "LREAL;REAL;LREAL", form="{t:.3f};{n};{a}"
    ),
    "a row of sources above the units": table(
        "Time;Speed;Current", "Clock;Drive1;Drive1", "s;rpm;A", form="{t:.3f};{n};{a}"
    ),
    "brackets of full width": table("时间（ms）,电机转速（rpm）,电流（A）", form="{i},{n},{a}"),
    "seconds and microseconds": "\n".join(
        [
            "tv_sec,tv_usec,speed_rpm,current_A",
            *lines(lambda i, t, n, a: f"{177 + (i + 800) // 1000},{(i + 800) % 1000}000,{n},{a}"),
        ]
    ),
    "minutes and seconds": table("Time,Speed [rpm],I [A]", form="00:{t:06.3f},{n},{a}"),
    "@": dated("Time|speed_rpm|current_A", "%b %d, %Y @ %H:%M:%S.%f", "|"),
    "a date of IEC 61131": dated("Time;speed_rpm;current_A", "DTL#%Y-%m-%d-%H:%M:%S.%f", ";"),
    "newest first": "\n".join(
        ["Time,speed_rpm,current_A", *reversed(lines(lambda i, t, n, a: f"{STAMPS[i]},{n},{a}"))]
    ),
    "Kepware": by_tag(
        "_NAME,_NUMERICID,_VALUE,_TIMESTAMP,_QUALITY",
        lambda i, tag, value: f"{tag},0,{value},{STAMPS[i]},192",
    ),
    "milliseconds beside dates": by_tag(
        "Date;Time;Millitm;Tagname;Value",
        lambda i, tag, v: f"{STAMPS[i]:%m/%d/%Y;%H:%M:%S};{(800 + i) % 1000};{tag};{v}",
    ),
    "a column for each kind of number": by_tag(
        "tag,intvalue,floatvalue,t_stamp", lambda i, tag, value: f"{tag},,{value},{STAMPS[i]}"
    ),
    "a line for each channel": "\n".join(
        ";".join([name, unit, *map(repr, map(float, values))])
        for name, unit, values in (
            ("Time", "s", TIME),
            ("Motor speed", "rpm", SPEED),
            ("Motor current", "A", CURRENT),
        )
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", SAME)
def test_every_form_holds_the_same_samples(kind: str, tmp_path: Path) -> None:
    path = written(tmp_path, SAME[kind])
    found = guessed(path)
    assert not any(c.is_open or c.doubted for c in found.values())
    read = read_recording(path, columns={k: ColumnSpec(c.name, c.unit) for k, c in found.items()})
    np.testing.assert_allclose(read.time_s - read.time_s[0], TIME, atol=2e-6)
    np.testing.assert_allclose(read.motor_speed_rpm, SPEED)
    np.testing.assert_allclose(read.channels["motor_current_a"], CURRENT)


@pytest.mark.parametrize("suffix", ["json", "jsonl", "xlsx"])
def test_a_value_a_line_is_a_column_for_each_name_in_every_format(
    suffix: str, tmp_path: Path
) -> None:
    keys = ("topic", "ts", "payload")
    both = (("speed_rpm", SPEED), ("current_A", CURRENT))
    rows = [(tag, 1773475953250 + i, float(v[i])) for i in range(COUNT) for tag, v in both]
    path = tmp_path / f"a.{suffix}"
    if suffix == "xlsx":
        book = openpyxl.Workbook()
        for row in (keys, *rows):
            book.active.append(list(row))
        book.save(path)
    else:
        records = [dict(zip(keys, row, strict=True)) for row in rows]
        text = "\n".join(map(json.dumps, records)) if suffix == "jsonl" else json.dumps(records)
        path.write_text(text)
    found = guessed(path)
    assert {k: c.name for k, c in found.items()} == {
        "time_s": "ts",
        "motor_speed_rpm": "speed_rpm",
        "motor_current_a": "current_A",
    }
    np.testing.assert_array_equal(read_table(path).arrays["current_A"], CURRENT)


# Clocks


@pytest.mark.parametrize(
    ("above", "step_s"),
    [
        ('"Sampling Time","0.0625","ms"', 6.25e-5),
        ("Sampling period,250,us", 2.5e-4),
        ("Sampling rate,8,kHz", 1.25e-4),
    ],
)
def test_the_unit_of_a_step_may_have_a_cell_of_its_own(
    above: str, step_s: float, tmp_path: Path
) -> None:
    path = written(tmp_path, table(above, "Speed [rpm],Current [A]", form="{n},{a}"))
    read = read_recording(path, columns={"motor_speed_rpm": ColumnSpec("Speed [rpm]")})
    assert read.sampling_period_s == pytest.approx(step_s)


@pytest.mark.parametrize(
    "above", ["Recording time,2999 ms", "Trace time [ms],3000", "Sampling time,0.5,ms/div"]
)
def test_the_length_of_a_recording_is_no_step(above: str, tmp_path: Path) -> None:
    path = written(tmp_path, table(above, "No.,Speed [rpm],Current [A]", form="{i},{n},{a}"))
    time = guessed(path)["time_s"]
    assert (time.name, time.unit) == ("No.", UNKNOWN)


def test_segments_of_a_file_without_times_are_not_joined(tmp_path: Path) -> None:
    head = ["Channels\t2\t\t", "Samples\t400\t400\t", "Y_Unit_Label\trpm\tA\t",
            "Delta_X\t0.001\t0.001\t", "***End_of_Header***\t\t\t",
            "X_Value\tSpeed\tCurrent\tComment"]  # fmt: skip
    part = table(*head, form="\t{n}\t{a}")
    path = written(tmp_path, "\n\n".join(["LabVIEW Measurement\t", *[part] * 3]), "a.lvm")
    with pytest.raises(RecordingError, match="another header among the samples"):
        read_table(path)


# Channels and units


@pytest.mark.parametrize(
    "name",
    [
        "Absolute current actual value",
        "Stromistwert Betrag",
        "Input current",
        "Zwischenkreisstrom",
        "Bremsstrom",
        "Reactive current",
    ],
)
def test_a_current_without_its_sign_or_of_another_part_is_not_taken(
    name: str, tmp_path: Path
) -> None:
    path = written(tmp_path, table(f"Time [s],Speed [rpm],{name} [A]"))
    assert set(guessed(path)) == {"time_s", "motor_speed_rpm"}


@pytest.mark.parametrize(
    ("speed", "current"),
    [("Axis1 speed", "Axis2 current"), ("Drive_A.Velocity", "Drive_B.Current"), ("J1 n", "J2 iq")],
)
def test_the_only_current_may_be_of_another_axis(speed: str, current: str, tmp_path: Path) -> None:
    path = written(tmp_path, table(f"Time [s],{speed} [rpm],{current} [A]"))
    assert set(guessed(path)) == {"time_s", "motor_speed_rpm"}
    same = current.replace("2", "1").replace("B", "A")
    path = written(tmp_path, table(f"Time [s],{speed} [rpm],{same} [A]"))
    assert guessed(path)["motor_current_a"].name == f"{same} [A]"


@pytest.mark.parametrize(
    "name", ["Disturbance torque", "Störmoment", "Friction torque", "Holding torque"]
)
def test_a_torque_that_does_not_drive_is_not_taken(name: str, tmp_path: Path) -> None:
    path = written(tmp_path, table(f"Time [s],Speed [rpm],{name} [Nm]"))
    assert set(guessed(path)) == {"time_s", "motor_speed_rpm"}
    path = written(tmp_path, table("Time [s],Speed [rpm],Input torque [Nm]"))
    assert "motor_torque_nm" in guessed(path)  # of a gear is the motor's


@pytest.mark.parametrize(
    ("name", "is_doubted"),
    [
        ("PSU current [A]", True),
        ("RMS current [A]", True),
        ("elbow current [Arms]", False),
        ("Torque sensor [Nm]", True),
        ("Torque-generating current actual value [A]", False),
        ("elbow current [A]", False),
        ("Corrente [A]", False),
        ("Idc [A]", True),
        ("Ibus [A]", True),
    ],
)
def test_a_word_more_in_a_name_is_a_question(name: str, is_doubted: bool, tmp_path: Path) -> None:
    path = written(tmp_path, table(f"Time [s],elbow speed [rpm],{name}"))
    *_, driven = guessed(path).values()
    assert (driven.name, driven.doubted) == (name, is_doubted)


@pytest.mark.parametrize(
    ("asked", "measured"),
    [
        ("Consigna de velocidad", "Velocidad real"),
        ("Velocità di riferimento", "Velocità motore"),
        ("Profile velocity", "Velocity"),
        ("Fan speed", "Velocity actual"),
        ("Börvärde varvtal", "Ärvärde varvtal"),
    ],
)
def test_a_measured_speed_goes_before_one_that_never_changes_or_is_another(
    asked: str, measured: str, tmp_path: Path
) -> None:
    path = written(
        tmp_path, table(f"t [s],{asked} [rpm],{measured} [rpm]", form="{t:.3f},1500,{n}")
    )
    speed = guessed(path)["motor_speed_rpm"]
    assert (speed.name, speed.doubted) == (f"{measured} [rpm]", False)


def test_columns_about_a_tag_are_no_speeds(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        table(
            "Speed_NUMERICID,Speed_VALUE,Speed_TIMESTAMP,Speed_QUALITY", form="7,{n},{t:.3f},192"
        ),
    )
    assert guessed(path)["motor_speed_rpm"].name == "Speed_VALUE"


def test_a_factor_is_a_question_whatever_offset_follows_it(tmp_path: Path) -> None:
    head = ("Signal;Time;N_ACT;I_ACT", "Unit;ms;1/min;A", "Factor;1;0,1;1", "Offset;0;0;0.000E+00")
    path = written(tmp_path, table(*head, form=";{i};{n};{a}"))
    found = guessed(path)
    assert found["motor_speed_rpm"].is_open
    assert '"1/min (scale 0,1)"' in found["motor_speed_rpm"].reason
    assert found["motor_current_a"].unit == "A"


def in_per_cent(path: Path) -> Path:
    book = openpyxl.Workbook()
    book.active.append(["time_s", "motor_speed_rpm", "torque"])
    for t, n, a in zip(TIME, SPEED, CURRENT, strict=True):
        book.active.append([float(t), float(n), float(a)])
        book.active.cell(book.active.max_row, 3).number_format = "0 %"
    book.save(path)
    return path


@pytest.mark.parametrize("suffix", ["xlsx", "csv"])
def test_a_share_is_of_something(suffix: str, tmp_path: Path) -> None:
    if suffix == "xlsx":
        path = in_per_cent(tmp_path / "a.xlsx")
    else:
        rows = lines(lambda i, t, n, a: f"{t},{n},{100.0 * a:.2f}")
        head = ["time_s,motor_speed_rpm,torque", "s,rpm,%"]
        path = written(tmp_path, "\n".join([*head, *rows]))
    for unit in ("N m", "1 N m", "12 N m"):
        with pytest.raises(RecordingError, match=r"different units.*% of 12\.5 N m"):
            read_recording(path, columns={"motor_torque_nm": ColumnSpec("torque", unit)})
    read = read_recording(path, columns={"motor_torque_nm": ColumnSpec("torque", "% of 12 N m")})
    np.testing.assert_allclose(read.channels["motor_torque_nm"], 12.0 * CURRENT, atol=1e-9)


@pytest.mark.parametrize(("unit", "agrees"), [("V", False), ("deg", False), ("об/мин", True)])
def test_a_plain_unit_does_not_go_over_one_of_another_quantity(
    unit: str, agrees: bool, tmp_path: Path
) -> None:
    path = written(tmp_path, table("time_s,n,i", f"s,{unit},A"))
    columns = {"motor_speed_rpm": ColumnSpec("n", "rpm")}
    if not agrees:
        with pytest.raises(RecordingError, match=r'different units.*"1 rpm" if the file is wrong'):
            read_recording(path, columns=columns)
        columns = {"motor_speed_rpm": ColumnSpec("n", "1 rpm")}
    np.testing.assert_allclose(read_recording(path, columns=columns).motor_speed_rpm, SPEED)


def test_what_a_historian_writes_for_no_value_is_a_lost_sample(tmp_path: Path) -> None:
    values: Sequence[object] = [*SPEED[:200], "Bad Input", *SPEED[201:]]
    rows = [f"J2.SPEED,{STAMPS[i]},{value}" for i, value in enumerate(values)]
    path = written(tmp_path, "\n".join(["Tag,Timestamp,Value", *rows]))
    read = read_recording(path, columns={"motor_speed_rpm": ColumnSpec("J2.SPEED", "rpm")})
    np.testing.assert_allclose(read.motor_speed_rpm[:200], SPEED[:200])


def test_a_line_of_a_channel_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    rows = {"time_s": TIME, "motor_speed_rpm": SPEED, "motor_current_a": CURRENT[:-1]}
    lines_ = [",".join([name, *(f"{v:.6f}" for v in values)]) for name, values in rows.items()]
    path = written(tmp_path, "\n".join(lines_))
    with pytest.raises(RecordingError, match="differ in length"):
        read_recording(path)


def test_a_step_is_stated_beside_other_keys(tmp_path: Path) -> None:
    head = ["Sample Interval,0.001,Record Length,400", "motor_speed_rpm,motor_current_a"]
    rows = [f"{n:.6f},{a:.6f}" for n, a in zip(SPEED, CURRENT, strict=True)]
    read = read_recording(written(tmp_path, "\n".join([*head, *rows])))
    assert read.sampling_period_s == pytest.approx(1e-3)


# What an inverter, a joint, a terminal and a server of OPC write


@pytest.mark.parametrize(
    ("header", "cell"),
    [
        ("t [s];Speed [Hz];Current [A]", "{n}"),
        ("t [s];Istdrehzahl [Hz];Current [A]", "{n}"),
        ("t_s;motor_speed_hz;current_a", "{n}"),
        ("t [s];Motor speed (0.01 Hz);Current [A]", "{n}"),
        ("t;Speed;Current\ns;Hz;A", "{n}"),
        ("t;speed;current", "{n} Hz"),
    ],
)
def test_an_inverters_hertz_is_electrical(header: str, cell: str, tmp_path: Path) -> None:
    path = written(tmp_path, table(header, form=f"{{t:.3f}};{cell};{{a}}"))
    speed = guessed(path)["motor_speed_rpm"]
    assert speed.is_open
    assert '"rev/s/7" (Hz)' in speed.reason
    columns = {"time_s": ColumnSpec(read_table(path).columns[0], "s"),
               "motor_speed_rpm": ColumnSpec(speed.name, "rev/s/4")}  # fmt: skip
    np.testing.assert_allclose(read_recording(path, columns=columns).motor_speed_rpm, 15.0 * SPEED)


def test_a_speed_in_rpm_goes_before_one_in_hertz(tmp_path: Path) -> None:
    path = written(tmp_path, table("t [s],Speed [Hz],Speed [rpm]", form="{t},{a},{n}"))
    assert guessed(path)["motor_speed_rpm"].name == "Speed [rpm]"


@pytest.mark.parametrize(
    "name", ["JT2 speed", "Gelenk 2 Geschwindigkeit", "dq2", "Eje 2 velocidad", "軸2 速度", "speed"]
)
def test_what_no_motor_is_as_slow_as_is_asked_about(name: str, tmp_path: Path) -> None:
    slow = f"Time [s];{name} [deg/s]"
    path = written(tmp_path, "\n".join([slow, *lines(lambda i, t, n, a: f"{t};{6.0 * n / 25.0}")]))
    speed = guessed(path)["motor_speed_rpm"]
    assert (speed.unit, "slow for a motor" in speed.reason) == (UNKNOWN, True)
    path = written(tmp_path, path.read_text().replace(name, "Motor speed"))
    assert guessed(path)["motor_speed_rpm"].unit == "deg/s"


def test_a_point_in_a_number_is_no_path(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        table("Time in s;Actual speed in 0.0001 rpm;Active current in 0.1 % I_N",
              form="{t};{n};{a}"),
    )  # fmt: skip
    found = guessed(path)
    assert found["motor_speed_rpm"].name.startswith("Actual speed")
    assert found["motor_current_a"].name.startswith("Active current")


def test_a_slash_may_part_two_languages(tmp_path: Path) -> None:
    path = written(tmp_path, table("Zeit/Time [s],Drehzahl/Speed [min-1],Strom/Current [A]"))
    assert not any(c.is_open or c.doubted for c in guessed(path).values())


@pytest.mark.parametrize(("mark", "size"), [("%", 0.12), ("‰", 0.012)])
def test_a_share_may_stand_in_the_cells(mark: str, size: float, tmp_path: Path) -> None:
    path = written(
        tmp_path, table("t_s;speed_rpm;torque;load", form=f"{{t}};{{n}};{{a}} {mark};3%")
    )
    torque = guessed(path)["motor_torque_nm"]
    assert (torque.name, torque.unit) == ("torque", UNKNOWN)
    columns = {"time_s": ColumnSpec("t_s", "s"),
               "motor_torque_nm": ColumnSpec("torque", f"{mark} of 12 N m")}  # fmt: skip
    read = read_recording(path, columns=columns).channels["motor_torque_nm"]
    np.testing.assert_allclose(read, size * CURRENT, atol=1e-9)


def test_only_a_needed_column_is_refused_for_cells_in_several_units(tmp_path: Path) -> None:
    rows = lines(
        lambda i, t, n, a: f"{t},{n},{i % 256:02X},{f'{a} A' if a > 1.0 else f'{1e3 * a} mA'}"
    )
    path = written(tmp_path, "\n".join(["time_s,motor_speed_rpm,raw,current", *rows]))
    np.testing.assert_allclose(read_recording(path).motor_speed_rpm, SPEED)
    with pytest.raises(RecordingError, match=r"line 2.*A'"):
        read_recording(path, columns={"motor_current_a": ColumnSpec("current", "A")})


STAMPED = {
    "Tera Term": ("[2026-03-14 08:12:33.790] speed_rpm,current_A", "[%Y-%m-%d %H:%M:%S.%f] ", ","),
    "Tera Term, tabs": ("time\tspeed_rpm\tcurrent_A", "[%Y-%m-%d %H:%M:%S.%f]\t", "\t"),
    "Tera Term, old": ("[Sat Mar 14 08:12:33.790 2026] speed_rpm current_A",
                       "[%a %b %d %H:%M:%S.%f %Y] ", " "),
    "Arduino": ("08:12:33.790 -> speed_rpm,current_A", "%H:%M:%S.%f -> ", ","),
}  # fmt: skip


@pytest.mark.parametrize("kind", STAMPED)
def test_a_terminals_stamp_in_front_is_the_time(kind: str, tmp_path: Path) -> None:
    header, form, mark = STAMPED[kind]
    rows = lines(lambda i, t, n, a: f"{STAMPS[i].strftime(form)}{n}{mark}{a}")
    path = written(tmp_path, "\n".join([header, *rows]), "a.log")
    found = guessed(path)
    read = read_recording(path, columns={k: ColumnSpec(c.name, c.unit) for k, c in found.items()})
    np.testing.assert_allclose(read.time_s, TIME, atol=2e-6)
    np.testing.assert_allclose(read.motor_speed_rpm, SPEED)


def test_line_protocol_is_a_table(tmp_path: Path) -> None:
    form = "drive,host=plc speed_rpm={},current_A={},n={}i,ok=true {}"
    rows = lines(lambda i, t, n, a: form.format(n, a, i, (1773475953000 + i) * 10**6))
    path = written(tmp_path, "\n".join(rows), "a.txt")
    found = guessed(path)
    assert [found[c].unit for c in ("time_s", "motor_speed_rpm", "motor_current_a")] == [
        "ns", "rpm", "A",
    ]  # fmt: skip
    rows = lines(lambda i, t, n, a: f"speed_rpm value={n} {(1773475953000 + i) * 10**6}\n"
                 f"current_A value={a} {(1773475953000 + i) * 10**6}")  # fmt: skip
    path = written(tmp_path, "\n".join(rows), "b.txt")
    np.testing.assert_allclose(read_table(path).arrays["speed_rpm"], SPEED)


def test_records_of_json_may_be_called_a_log(tmp_path: Path) -> None:
    records = lines(lambda i, t, n, a: json.dumps({"time_s": t, "motor_speed_rpm": n}))
    path = written(tmp_path, "\n".join(records), "a.log")
    np.testing.assert_allclose(read_recording(path).motor_speed_rpm, SPEED)


@pytest.mark.parametrize(
    ("good", "poor"),
    [("Good", "Bad"), ("192", "24"), ("0x00000000", "0x80050000"), ("Good", "Uncertain: last")],
)
@pytest.mark.parametrize("is_wide", [True, False])
def test_a_value_of_bad_quality_is_no_sample(
    good: str, poor: str, is_wide: bool, tmp_path: Path
) -> None:
    lost = range(200, 220)  # the server repeats the last value
    if is_wide:
        rows = [f"{STAMPS[i]};{SPEED[i]};{poor if i in lost else good}" for i in range(COUNT)]
        text = "\n".join(["Timestamp;speed_rpm;speed_quality", *rows])
    else:
        text = by_tag(
            "tag;timestamp;value;quality",
            lambda i, tag, v: (
                f"{tag};{STAMPS[i]};{v};" + (poor if i in lost and tag == "speed_rpm" else good)
            ),
        )
    path = written(tmp_path, text)
    found = guessed(path)
    read = read_recording(path, columns={k: ColumnSpec(c.name, c.unit) for k, c in found.items()})
    assert read.excluded is not None
    np.testing.assert_array_equal(np.flatnonzero(read.excluded), [*lost])
    assert "20 × row of bad quality" in read.notes[0]


def test_a_drives_status_word_is_no_quality(tmp_path: Path) -> None:
    rows = lines(lambda i, t, n, a: f"{t};{n};0x80000250")
    path = written(tmp_path, "\n".join(["time_s;motor_speed_rpm;DriveStatus", *rows]))
    recording = read_recording(path)
    np.testing.assert_allclose(recording.motor_speed_rpm, SPEED)
    assert recording.excluded is None


def test_a_brace_before_a_table_is_not_json(tmp_path: Path) -> None:
    rows = lines(lambda i, t, n, a: f"{t};{n}")
    path = written(tmp_path, "\n".join(["{axis 3}", "time_s;motor_speed_rpm", *rows]))
    np.testing.assert_allclose(read_recording(path).motor_speed_rpm, SPEED)


def test_cells_in_several_units_are_refused_as_such(tmp_path: Path) -> None:
    rows = lines(lambda i, t, n, a: f"{t};{n} {'rpm' if i else 'rad/s'}")
    path = written(tmp_path, "\n".join(["time_s;speed", *rows]))
    with pytest.raises(RecordingError, match="one unit for the whole column"):
        read_recording(path, columns={"motor_speed_rpm": ColumnSpec("speed", "rpm")})


@pytest.mark.parametrize(("suffix", "block"), [("csv", 1 << 20), ("csv", 70), ("xlsx", 1 << 20)])
def test_a_word_among_numbers_is_a_lost_sample_and_told(
    suffix: str, block: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """However many words are in one block of the text: what counts is their share of the column."""
    monkeypatch.setattr(text_table, "_BLOCK_BYTES", block)
    rows = [[t, "Scan Off" if i in (200, 201) else n] for i, (t, n, _) in ROWS]
    path = tmp_path / f"a.{suffix}"
    if suffix == "xlsx":
        book = openpyxl.Workbook()
        for row in [["time_s", "motor_speed_rpm"], *rows]:
            book.active.append([float(v) if isinstance(v, np.floating) else v for v in row])
        book.save(path)
    else:
        path.write_text("\n".join(["time_s,motor_speed_rpm", *(f"{t},{n}" for t, n in rows)]))
    read = read_recording(path)
    assert read.excluded is not None
    assert np.flatnonzero(read.excluded).tolist() == [200, 201]
    assert '2 × "Scan Off" for a number, a lost sample' in read.notes[0]


@pytest.mark.parametrize(
    "names",
    [
        ("elbow velocity [deg/s]", "elbow torque [Nm]"),
        ("A1 vel [deg/s]", "A1 torque [Nm]"),
        ("/joint_states/elbow/velocity", "/joint_states/elbow/effort"),
    ],
)
def test_a_torque_beside_the_speed_of_a_joint_is_asked_for(
    names: tuple[str, str], tmp_path: Path
) -> None:
    path = written(tmp_path, table(f"time_s,{','.join(names)}", form="{t:.3f},2.{i},{a}"))
    found = guessed(path)
    assert found["motor_torque_nm"].unit == UNKNOWN
    assert "at the motor" in found["motor_torque_nm"].reason
    path.write_text(path.read_text().replace(names[1], "motor torque [Nm]"))
    assert guessed(path)["motor_torque_nm"].unit == "Nm"


def test_rows_without_a_time_are_no_recording(tmp_path: Path) -> None:
    rows = [f"{t if i % 5 == 0 else ''},{n}" for i, (t, n, _) in ROWS]
    path = written(tmp_path, "\n".join(["time_s,motor_speed_rpm", *rows]))
    with pytest.raises(RecordingError, match=r"line 3.*values but no time"):
        read_recording(path)
    rows = [f"{t if i % 50 else ''},{n}" for i, (t, n, _) in ROWS]
    path = written(tmp_path, "\n".join(["time_s,motor_speed_rpm", *rows]))
    assert read_recording(path).samples == COUNT - 1


def test_microseconds_may_have_a_column_beside_whole_dates(tmp_path: Path) -> None:
    rows = [
        f"{at:%Y-%m-%d},{at:%H:%M:%S},{at.microsecond},{n}"
        for at, (_, (_, n, _)) in zip(STAMPS, ROWS, strict=True)
    ]
    path = written(tmp_path, "\n".join(["Date,Time,us,motor_speed_rpm", *rows]))
    read = read_recording(path, columns={"time_s": ColumnSpec("Time")})
    np.testing.assert_allclose(read.time_s, TIME, atol=1e-9)


def test_a_joint_whose_first_messages_lack_the_effort_is_one_group() -> None:
    """Its messages are in order of their times, with NaN for what they lack."""
    series = {
        ("/joint_states", "j1", ("position",)): array("d", [0.0, 0.0, 1.0, 0.2, 0.2, 3.0]),
        ("/joint_states", "j1", ("position", "effort")): array("d", [0.1, 0.1, 2.0, 5.0]),
    }
    (group,) = _groups(series)
    assert np.array_equal(group.columns["position"], [1.0, 2.0, 3.0])
    assert np.array_equal(group.columns["effort"], [np.nan, 5.0, np.nan], equal_nan=True)


def test_parts_of_a_second_beside_dates_are_in_order_and_change() -> None:
    """Unsigned numbers out of order are not a clock, nor is a constant delay."""
    unordered = ArrayTable({"x_ms": np.array([500, 100, 900, 200], dtype=np.uint16)})
    seconds = np.array([0.0, 0.0, 0.0, 1.0])
    assert np.array_equal(unordered.with_parts(seconds), seconds)
    parts = {"delay_ms": np.ones(4), "time_ms": np.array([100, 200, 100, 200])}
    dates = ArrayTable(parts).with_parts(np.array([0.0, 0.0, 1.0, 1.0]))
    assert np.allclose(dates, [0.0, 0.1, 1.0, 1.1])
