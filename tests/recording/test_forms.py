"""Forms in which real tools write a recording: each is read as it is meant, with its repairs told
in one note, or refused with the place and what to do."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from struct import pack

import h5py
import numpy as np
import openpyxl
import pytest
from scipy.io import savemat

from bayesbl.errors import RecordingError
from bayesbl.recording import text_table
from bayesbl.recording.channels import ColumnSpec
from bayesbl.recording.columns import stamps_and_values
from bayesbl.recording.guessing import UNKNOWN, GuessedColumn, guess_columns
from bayesbl.recording.readers import read_recording, read_table
from bayesbl.recording.types import Recording
from bayesbl.runs.first_configuration import start_config
from bayesbl.units import RPM_PER_RAD_PER_S, conversion_factor, is_accepted

COUNT = 600
TIME = np.arange(COUNT) / 1000.0
NOISE = np.random.default_rng(7).normal(0.0, 1.5, COUNT)
SPEED = np.round(1995.0 + 10.0 * np.sin(40.0 * TIME) + NOISE, 3)
PAIRS = list(zip(TIME, SPEED, strict=True))
NAMES = "time_s", "motor_speed_rpm"


def rows(form: str = "{t:.3f},{n:.3f}") -> list[str]:
    return [form.format(t=t, n=n) for t, n in PAIRS]


def text(lines: list[str], header: str | None = ",".join(NAMES)) -> str:
    return "\n".join([header, *lines] if header is not None else lines) + "\n"


def with_line(line: str, at: int = 300) -> str:
    lines = rows()
    return text([*lines[:at], line, *lines[at:]])


def grouped(number: float, mark: str, decimal: str) -> str:
    whole, _, part = f"{number:,.3f}".partition(".")
    return whole.replace(",", mark) + decimal + part


def clock(seconds: float, form: str = "%H:%M:%S") -> str:
    start = np.datetime64("2026-03-01T23:59:59.700", "ms")
    return (start + np.timedelta64(round(1000 * seconds), "ms")).item().strftime(form)


SPACED = {
    "np.savetxt": text(rows("{t:.18e} {n:.18e}"), f"# {' '.join(NAMES)}"),
    "spaces": text(rows("{t:.3f}   {n:.3f}"), "  ".join(NAMES)),
    "tabs among spaces": text(rows("{t:.3f} \t {n:.3f}"), "   ".join(NAMES)),
    "bars": text(rows("{t:.3f} | {n:.3f}"), " | ".join(NAMES)),
}
MARKS = {
    "1.000,0": text(
        [f"{t:.3f};".replace(".", ",") + grouped(n, ".", ",") for t, n in PAIRS],
        ";".join(NAMES),
    ),
    "1'000.0": text(
        [f"{t:.3f};" + grouped(n, "'", ".") for t, n in PAIRS],
        ";".join(NAMES),
    ),
    "1’000.0": text(
        [f"{t:.3f}\t" + grouped(n, "’", ".") for t, n in PAIRS],
        "\t".join(NAMES),
    ),
    "1,000.0 quoted": text([f'{t:.3f},"' + grouped(n, ",", ".") + '"' for t, n in PAIRS]),
    "1 000,0": text(
        [f"{t:.3f};".replace(".", ",") + grouped(n, " ", ",") for t, n in PAIRS],
        ";".join(NAMES),
    ),
}
ENCODED = {
    "UTF-16 without a mark": text(rows()).encode("utf-16-le"),
    "UTF-16, the other end first": text(rows()).encode("utf-16-be"),
    "umlauts of Latin-1": text(rows(), ["time_s,motor_speed_rpm", "Öl °C"][0]).encode("latin-1"),
    "a control byte at each line's end": text(rows()).replace("\n", "\x02\n").encode(),
    "NUL bytes": text(rows()).encode().replace(b"0.300,", b"\0\0\x000.300,"),
    "NULs at the end": text(rows()).encode() + bytes(4096),
}
LEFT_OUT = {
    "a cut last line": text(rows()).encode()[: len(text(rows())) - 1] + b"\n0.6",
    "a footer": text(rows()) + "\nStopped by the user\nend of file;\n",
    "comments": with_line("# the brake was closed here"),
    "a header again": with_line(",".join(NAMES)),
    "a line of text": with_line("stopped"),
    "units below": text(["s,rpm", *rows()]),
    "units with a number below": text(["1 s,1 rpm", *rows()]),
    "brackets of units below": text(["[s],[rpm]", *rows()]),
    "a name over two lines": text(rows(), '"time_s\n",motor_speed_rpm'),
    "numbers of columns above": text([",".join(NAMES), *rows()], "1,2"),
    "a title above": "Recorder 7\nMachine;A\n\n" + text(rows()),
}
MORE_COLUMNS = {
    "two columns of one name": text([f"{row},1,2" for row in rows()], "time_s,motor_speed_rpm,x,x"),
    "a tuple": text([f'{row},"(1, 2)"' for row in rows()], "time_s,motor_speed_rpm,pose"),
    "a tuple without quotes": text(
        [f"(1, 2),{row}" for row in rows()], "pose,time_s,motor_speed_rpm"
    ),
    "units in the cells": text(rows('{t:.3f} sec,"{n:.3f} rpm"')),
    "a list": text([f"[1, 2, 3],{row}" for row in rows()], "pose,time_s,motor_speed_rpm"),
}


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(content, id=name)
        for name, content in {**SPACED, **MARKS, **ENCODED, **LEFT_OUT, **MORE_COLUMNS}.items()
    ],
)
def test_every_form_of_text_holds_the_same_samples(content: str | bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    read = read_recording(path)
    np.testing.assert_allclose(read.time_s, TIME, atol=1e-9)
    np.testing.assert_allclose(read.motor_speed_rpm, SPEED, atol=1e-9)
    assert sum("Put right" in note for note in read.notes) <= 1


def test_how_large_the_blocks_of_a_text_are_changes_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = tmp_path / "a.csv"
    for name, content in {**SPACED, **MARKS, **ENCODED, **LEFT_OUT, **MORE_COLUMNS}.items():
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        monkeypatch.setattr(text_table, "_BLOCK_BYTES", 1 << 20)
        whole, place = read_recording(path), read_table(path).place(500, "time_s")
        monkeypatch.setattr(text_table, "_BLOCK_BYTES", 70)
        cut = read_recording(path)
        np.testing.assert_array_equal(cut.time_s, whole.time_s, name)
        np.testing.assert_array_equal(cut.motor_speed_rpm, whole.motor_speed_rpm, name)
        assert (cut.notes, read_table(path).place(500, "time_s")) == (whole.notes, place), name


def test_units_in_the_cells_count_and_may_not_differ(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text(rows("{t:.3f} s,{n:.3f} rad/s"), "time,speed"))
    columns = {c.channel: c for c in guess_columns(read_table(path)).columns}
    assert (columns["motor_speed_rpm"].unit, columns["motor_speed_rpm"].sure) == ("rad/s", True)
    # What a dashboard scales by itself: 0.999 s comes after 998 ms.
    lines = [f"{1e3 * t:.0f} ms,{n:.3f}" if t < 0.3 else f"{t:.3f} s,{n:.3f}" for t, n in PAIRS]
    path.write_text(text(lines))
    with pytest.raises(RecordingError, match=r"not known for this channel.*ms and s"):
        read_recording(path)


def test_units_count_in_a_line_above_the_names_as_in_one_below(tmp_path: Path) -> None:
    for head in ("ms;1/min\nt;n", "t;n\nms;1/min"):
        path = tmp_path / "a.csv"
        path.write_text(text([f"{1e3 * t:.0f};{n}" for t, n in PAIRS], head))
        read = read_recording(
            path, columns={"time_s": ColumnSpec("t"), "motor_speed_rpm": ColumnSpec("n")}
        )
        np.testing.assert_allclose(read.time_s, TIME, atol=1e-9)
        np.testing.assert_array_equal(read.motor_speed_rpm, SPEED)


def test_a_group_of_columns_above_the_names_is_no_unit(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text(rows(), "A,A\n" + ",".join(NAMES)))
    np.testing.assert_array_equal(read_recording(path).motor_speed_rpm, SPEED)


def test_a_quotation_mark_opens_a_cell_at_its_begin_alone(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text(rows(), 'time_s,twist ["]'))
    assert read_table(path).columns == ("time_s", 'twist ["]')
    assert 'of the motor "arcsec"' in guess_columns(read_table(path)).columns[1].reason
    path.write_text(text(['s,"', *rows()], "time_s,twist"))
    assert read_table(path).columns == ("time_s", "twist")
    path.write_text(text(rows(), 'time_s,"twist\n(filtered)"'))
    assert read_table(path).columns == ("time_s", "twist (filtered)")


def test_one_long_cell_does_not_make_every_cell_long(tmp_path: Path) -> None:
    lines = [f"{row},{'x' * (100_000 if i == 5 else 1)}" for i, row in enumerate(rows())]
    path = tmp_path / "a.csv"
    path.write_text(text(lines, "time_s,motor_speed_rpm,state"))
    assert read_table(path).arrays["state"].nbytes < 1e6
    assert read_recording(path).samples == COUNT


def test_what_is_left_out_is_told_once_with_its_count(tmp_path: Path) -> None:
    lines = rows()
    lines[200:200] = ["# one", ",".join(NAMES), "# two"]
    path = tmp_path / "a.csv"
    path.write_text(text(lines) + "0.6")
    (note,) = read_recording(path).notes
    assert "2 × comment" in note
    assert "1 × repeated header" in note
    assert "1 × cut last line" in note


def test_one_missing_field_is_a_lost_sample(tmp_path: Path) -> None:
    lines = rows()
    lines[300] = "0.300"
    path = tmp_path / "a.csv"
    path.write_text(text(lines))
    read = read_recording(path)
    assert read.excluded is not None
    assert np.flatnonzero(read.excluded).tolist() == [300]
    assert read.samples == COUNT


def test_many_missing_fields_are_refused_with_the_first(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    lines = [row.split(",")[0] if i % 9 == 8 else row for i, row in enumerate(rows())]
    path.write_text(text(lines))
    with pytest.raises(RecordingError, match=r"line 10: .*one cell for each column.*1 cells"):
        read_recording(path)


def test_a_comma_that_may_be_either_mark_is_a_question(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text([f"{i + 1};{1 + i % 3},{100 + i}" for i in range(COUNT)], ";".join(NAMES)))
    with pytest.raises(RecordingError, match=r"decimal comma.*part thousands.*'2,401'|'\d,\d{3}'"):
        read_recording(path)


def test_columns_without_names_are_numbered(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text(text(rows("{t:.6f} {n:.6f} 0 1"), None))
    with pytest.raises(RecordingError, match=r'"time_s" is missing.*"column 1", "column 2"'):
        read_recording(path)
    columns = {name: ColumnSpec(f"column {i + 1}") for i, name in enumerate(NAMES)}
    np.testing.assert_allclose(read_recording(path, columns=columns).motor_speed_rpm, SPEED)


# Time

TIMES: dict[str, Callable[[float], str]] = {
    "German dates": lambda t: clock(t, "%d.%m.%Y %H:%M:%S,%f"),
    "English dates": lambda t: clock(t, "%m/%d/%Y %I:%M:%S.%f %p"),
    "dates of open order": lambda t: clock(t, "%d/%m/%y %H:%M:%S.%f"),
    "ISO dates": lambda t: clock(t, "%Y-%m-%dT%H:%M:%S.%f"),
    "times of day": lambda t: clock(t, "%H:%M:%S.%f"),
    "milliseconds after a colon": lambda t: clock(t, "%H:%M:%S:%f")[:-3],
    "milliseconds after a semicolon": lambda t: '"' + clock(t, "%H:%M:%S;%f")[:-3] + '"',
}


@pytest.mark.parametrize("kind", TIMES)
def test_dates_and_times_of_day_are_seconds_over_midnight(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text([f"{TIMES[kind](t)};{n}" for t, n in PAIRS], ";".join(NAMES)))
    read = read_recording(path)
    np.testing.assert_allclose(read.time_s, TIME, atol=1e-9)


def recorded(tmp_path: Path, columns: dict[str, np.ndarray], **units: str) -> Recording:
    """What is read of a Parquet file: the stage is one for all formats."""
    import pandas as pd

    path = tmp_path / "a.parquet"
    pd.DataFrame(columns).to_parquet(path)
    return read_recording(path, columns={k: ColumnSpec(k, unit) for k, unit in units.items()})


@pytest.mark.parametrize(
    ("unit", "stamps"),
    [
        ("ms", (65000 + 1000 * TIME).round() % 2**16),
        ("us", (2**32 - 100_000 + 1e6 * TIME).round() % 2**32),
        ("ms", (86_399_800 + 1000 * TIME).round() % 86_400_000),
        ("us", (2**32 - 100_000 + 1e6 * TIME).round() % 2**32 - 2**31),
    ],
    ids=["16 bits of ms", "32 bits of us", "ms of the day", "32 bits with a sign"],
)
def test_a_counter_that_begins_again_goes_on(unit: str, stamps: np.ndarray, tmp_path: Path) -> None:
    read = recorded(tmp_path, {"time_s": stamps, "motor_speed_rpm": SPEED}, time_s=unit)
    np.testing.assert_allclose(read.time_s - read.time_s[0], TIME, atol=1e-9)
    assert "time counter" in read.notes[0]


@pytest.mark.parametrize("tick_ms", [2, 5, 10, 20])
@pytest.mark.parametrize("start_ms", [0.0, 0.7])
def test_a_coarse_clock_is_spread_by_its_own_fit(
    tick_ms: int, start_ms: float, tmp_path: Path
) -> None:
    stamps = np.floor((1000.0 * TIME + start_ms) / tick_ms) * tick_ms / 1000.0
    read = recorded(tmp_path, {"time_s": stamps, "motor_speed_rpm": SPEED})
    steps = np.diff(read.time_s)
    np.testing.assert_allclose(steps, 1e-3, rtol=0.01)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6)
    assert "ticks" in read.notes[0]


def test_time_as_floats_of_32_bits_is_even_again(tmp_path: Path) -> None:
    stamps = (30_000.0 + TIME).astype(np.float32)
    read = recorded(tmp_path, {"time_s": stamps.astype(float), "motor_speed_rpm": SPEED})
    np.testing.assert_allclose(np.diff(read.time_s), 1e-3, rtol=0.01)


def test_rows_sent_twice_or_late_are_put_in_order(tmp_path: Path) -> None:
    order = np.arange(COUNT)
    order[[50, 51]] = order[[51, 50]]
    order = np.insert(order, 300, [250, 251, 252])
    read = recorded(tmp_path, {"time_s": TIME[order], "motor_speed_rpm": SPEED[order]})
    np.testing.assert_array_equal(read.time_s, TIME)
    np.testing.assert_array_equal(read.motor_speed_rpm, SPEED)
    assert "3 × exact repeat" in read.notes[0]
    assert "2 × row out of order" in read.notes[0]


def test_two_recordings_in_one_file_are_not_merged(tmp_path: Path) -> None:
    for shift in (0.0, 0.0005):
        time = np.concatenate([TIME, TIME + shift])
        speed = np.concatenate([SPEED, SPEED[::-1]])
        with pytest.raises(RecordingError, match="Time runs backwards"):
            recorded(tmp_path, {"time_s": time, "motor_speed_rpm": speed})


def test_another_header_among_the_samples_is_another_table(tmp_path: Path) -> None:
    lines = [f"{row},1" for row in rows()]
    path = tmp_path / "a.csv"
    swapped = "motor_speed_rpm,time_s,motor_current_a"
    whole = text([*lines[:300], swapped, *lines[300:]], ",".join([*NAMES, "motor_current_a"]))
    path.write_text(whole)
    with pytest.raises(RecordingError, match=r"line 302: There is another header"):
        read_recording(path)


def test_a_stamp_that_comes_twice_with_other_values_is_refused(tmp_path: Path) -> None:
    time = np.insert(TIME, 300, TIME[300])
    with pytest.raises(RecordingError, match="Time does not advance"):
        recorded(tmp_path, {"time_s": time, "motor_speed_rpm": np.insert(SPEED, 300, 1.0)})


# Values


@pytest.mark.parametrize(
    ("turn", "unit", "low"),
    [
        (2 * np.pi, "rad", 0.0),
        (360.0, "deg", 0.0),
        (360.0, "deg", -180.0),
        (65536.0, "rev/65536", 0.0),
        (1.0, "rev", 0.0),
        (4096.0, "rev/4096", 0.0),
        (10000.0, "rev/10000", 0.0),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_position_that_begins_again_goes_on(
    turn: float, unit: str, low: float, sign: float, tmp_path: Path
) -> None:
    turns = sign * (0.3 + SPEED.mean() / 60.0 * TIME)
    columns = {
        "time_s": TIME,
        "motor_speed_rpm": SPEED,
        "motor_position_rad": (turns * turn - low) % turn + low,
    }
    read = recorded(tmp_path, columns, motor_position_rad=unit)
    position = read.channels["motor_position_rad"]
    np.testing.assert_allclose(np.diff(position), 2 * np.pi * np.diff(turns), atol=1e-9)
    assert "turn of the motor position" in read.notes[0]


def test_strokes_are_no_turns(tmp_path: Path) -> None:
    strokes = np.pi * np.sign(np.sin(30.0 * TIME)) * 0.9
    columns = {"time_s": TIME, "motor_speed_rpm": SPEED, "motor_position_rad": strokes}
    np.testing.assert_array_equal(
        recorded(tmp_path, columns).channels["motor_position_rad"], strokes
    )


@pytest.mark.parametrize("every", [2, 4, 5])
@pytest.mark.parametrize("how", ["interpolated", "repeated"])
@pytest.mark.parametrize("digits", [3, 12])
def test_samples_that_the_recorder_made_up_are_not_used(
    every: int, how: str, digits: int, tmp_path: Path
) -> None:
    knots = np.arange(0, COUNT, every)
    made = np.interp(np.arange(COUNT), knots, SPEED[knots])
    if how == "repeated":
        made = SPEED[np.arange(COUNT) // every * every]
    read = recorded(tmp_path, {"time_s": TIME, "motor_speed_rpm": np.round(made, digits)})
    np.testing.assert_allclose(read.time_s, TIME[knots][: read.samples], atol=1e-12)
    assert read.samples >= knots.size - 1
    np.testing.assert_allclose(read.motor_speed_rpm, SPEED[knots][: read.samples], atol=1e-9)
    assert how in read.notes[-1]


@pytest.mark.parametrize("lines", [64, 512, 4096])
def test_an_encoders_rounded_speed_is_not_called_made_up(lines: int, tmp_path: Path) -> None:
    speed = np.round(SPEED / (60e3 / lines)) * (60e3 / lines)
    read = recorded(tmp_path, {"time_s": TIME, "motor_speed_rpm": speed + 1e-9 * TIME})
    assert read.samples == COUNT


def test_a_log_on_change_is_held_and_a_slower_channel_is_not(tmp_path: Path) -> None:
    full = np.round(SPEED / 500.0, 2)
    change = np.r_[True, np.diff(full) != 0.0]
    columns = {
        "time_s": TIME,
        "motor_speed_rpm": SPEED,
        "motor_current_a": np.where(change, full, np.nan),
    }
    read = recorded(tmp_path, columns)
    np.testing.assert_array_equal(read.channels["motor_current_a"], full)
    assert f"{(~change).sum()} × empty cell of a log on change" in read.notes[0]
    slower = np.where(np.arange(COUNT) % 3 == 0, SPEED / 500.0, np.nan)
    with pytest.raises(RecordingError, match="Too many samples"):
        recorded(tmp_path, {**columns, "motor_current_a": slower})


@pytest.mark.parametrize("stray", [32767.0, -32768.0])
@pytest.mark.parametrize("channel", ["motor_current_a", "motor_torque_nm", "motor_speed_rpm"])
def test_single_strays_are_left_out_of_a_motion_too(
    channel: str, stray: float, tmp_path: Path
) -> None:
    wave = np.sin(40.0 * TIME)
    measured = np.round(4.0 * wave + np.random.default_rng(3).normal(0, 0.3, COUNT), 3)
    measured[[100, 400]] = stray
    columns = {"time_s": TIME, "motor_speed_rpm": SPEED, "reference_speed_rpm": 4.0 * wave}
    mended = recorded(tmp_path, {**columns, channel: measured})
    assert mended.excluded is not None
    assert np.flatnonzero(mended.excluded).tolist() == [100, 400]
    assert np.abs(mended.channels[channel]).max() < 10.0
    assert any("2 × stray sample" in note for note in mended.notes)


# Units


@pytest.mark.parametrize(
    ("channel", "unit", "factor"),
    [
        ("motor_position_rad", "rev/4096", 2 * np.pi / 4096),
        ("motor_position_rad", "arcmin", np.pi / 10800),
        ("motor_position_rad", "arcsec", np.pi / 648000),
        ("motor_speed_rpm", "rpm/7", 1 / 7),
        ("motor_speed_rpm", "0.1 rpm", 0.1),
        ("time_s", "4 ms", 4e-3),
        ("motor_current_a", "% of 12.5 A", 0.125),
        ("motor_current_a", "‰ of 12.5 A", 0.0125),
        ("motor_torque_nm", "per mille of 2.4 N m", 2.4e-3),
        ("motor_torque_nm", "% of 2.4 N m", 2.4e-2),
    ],
)
def test_units_with_a_number_in_them(channel: str, unit: str, factor: float) -> None:
    assert conversion_factor(channel, unit) == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize("unit", ["rpm/0", "0 ms", "counts", "%", "4 parsec", "rev/", "?"])
def test_what_is_no_unit_is_not_accepted(unit: str) -> None:
    for channel in ("motor_position_rad", "motor_speed_rpm", "time_s", "motor_current_a"):
        assert not is_accepted(channel, unit)


def test_turns_that_the_file_states_win_over_every_guess(tmp_path: Path) -> None:
    path = tmp_path / "odrive.csv"
    turns = np.cumsum(SPEED / 60.0) * 1e-3
    lines = [f"{t:.3f},{n / 60.0:.9f},{p:.9f}" for (t, n), p in zip(PAIRS, turns, strict=True)]
    path.write_text(text(lines, "time [s],vel_estimate [turns/s],pos_estimate [turns]"))
    guess = {c.channel: c for c in guess_columns(read_table(path)).columns}
    assert guess["motor_speed_rpm"].unit == "rev/s"
    assert guess["motor_position_rad"].unit == "rev"
    columns = {
        "time_s": ColumnSpec("time [s]"),
        "motor_speed_rpm": ColumnSpec("vel_estimate [turns/s]"),
        "motor_position_rad": ColumnSpec("pos_estimate [turns]"),
    }
    read = read_recording(path, columns=columns)
    np.testing.assert_allclose(read.motor_speed_rpm, SPEED, rtol=1e-7)
    position = read.channels["motor_position_rad"]
    assert np.ptp(position) / 0.599 * RPM_PER_RAD_PER_S == pytest.approx(1995, rel=0.01)


STATED = {
    "motor_speed_rpm": ("speed", 1.0, "rpm|r/min|1/min|min⁻¹|min^-1|U/min|revolutions per minute"),
    "motor_speed_rpm ": ("speed", 1e3, "krpm|kr/min"),
    "motor_speed_rpm  ": ("speed", RPM_PER_RAD_PER_S, "rad/s|rad s-1|rad·s⁻¹|rad_per_sec|rad_s"),
    "motor_speed_rpm   ": ("speed", 1.0 / 6.0, "deg/s|°/s|degrees per second|dps"),
    "motor_position_rad": ("position", np.pi / 180.0, "deg|°|degrees"),
    "motor_position_rad ": ("position", 1e-3 * np.pi / 180.0, "mdeg|m°"),
    "motor_position_rad  ": ("position", 2.0 * np.pi, "turns|rev|Umdr"),
    "motor_current_a": ("current", 1e-3, "mA|milliamps|mA rms"),
    "time_s": ("time", 1e-6, "us|µs|usec|microseconds"),
    "time_s ": ("time", 3600.0, "h|hours"),
}
PLACES = ("{n} [{u}]", "{n}({u})", "{n} <{u}>", "{n} / {u}", "{n}/{u}", "{n}, {u}", "{n} in {u}")


@pytest.mark.parametrize("place", [*PLACES, "{n} {u}", "{n}_{u}", "drive_2 {n}:{u}", "below"])
@pytest.mark.parametrize("channel", STATED)
def test_a_stated_unit_wins_wherever_it_stands(channel: str, place: str, tmp_path: Path) -> None:
    word, factor, units = STATED[channel]
    channel = channel.strip()
    path = tmp_path / "a.csv"
    for unit in units.split("|"):
        columns = {"time_s": "time [s]", "motor_speed_rpm": "speed [rpm]"}
        below = place == "below"
        columns[channel] = word if below else place.format(n=word, u=unit)
        units_below = [unit if c == channel and below else "" for c in columns]
        lines = [";".join(units_below)] if below else []
        size = 1e3 if channel == "motor_speed_rpm" else 1.0  # a slow one may be the joint's
        values = {"time_s": TIME, "motor_speed_rpm": SPEED} | {channel: size * (1.0 + TIME)}
        lines += [
            ";".join(map(repr, map(float, row))) for row in zip(*values.values(), strict=True)
        ]
        path.write_text(text(lines, ";".join(columns.values())), encoding="utf-8")
        guess = {c.channel: c for c in guess_columns(read_table(path)).columns}[channel]
        assert guess.sure
        assert conversion_factor(channel, guess.unit) == pytest.approx(factor, rel=1e-10), unit
        specs = {c: ColumnSpec(name) for c, name in columns.items()}
        read = read_recording(path, columns=specs)
        series = read.time_s if channel == "time_s" else read.channels[channel]
        assert np.ptp(series) == pytest.approx(factor * np.ptp(values[channel]), rel=1e-9), unit


@pytest.mark.parametrize(
    ("name", "channel", "unit"),
    [
        ("SERVO_02.r61[0]: Drehzahlistwert Geber 1 [1/min]", "motor_speed_rpm", "rpm"),
        ("Motordrehzahl ist 1/min", "motor_speed_rpm", "rpm"),
        ("Drehzahlsollwert [1/min]", "reference_speed_rpm", "rpm"),
        ("speed (krpm)", "motor_speed_rpm", "krpm"),
        ("motor speed (rad/min)", "motor_speed_rpm", "rad/min"),
        ("current_mA", "motor_current_a", "mA"),
        ("Strom ist A", "motor_current_a", "A"),
        ("SERVO_02.r78: Stromistwert [Aeff]", "motor_current_a", "A"),
        ("Motorwinkel [mrad]", "motor_position_rad", "mrad"),
    ],
)
def test_names_of_drives_tell_channel_and_unit(
    name: str, channel: str, unit: str, tmp_path: Path
) -> None:
    speed = "" if channel == "motor_speed_rpm" else ";n [rpm]"
    form = "{t:.3f};{n:.3f};{n:.3f}" if speed else "{t:.3f};{n:.3f}"
    file = tmp_path / "drive.csv"
    file.write_text(text(rows(form), f"time [s]{speed};{name}"), encoding="utf-8")
    guess = guess_columns(read_table(file))
    (own,) = [column for column in guess.columns if column.name == name]
    assert (own.channel, own.unit, own.sure) == (channel, unit, True)


def test_units_that_agree_alike_are_not_told_apart(tmp_path: Path) -> None:
    # A joint by ROS, in rad and rad/s: the same numbers agree as turns and turns per second.
    speed = 1.5 + 0.01 * np.sin(40.0 * TIME)
    angle = np.cumsum(speed) * 1e-3
    lines = [f"{t:.3f},{q:.8f},{v:.8f}" for t, q, v in zip(TIME, angle, speed, strict=True)]
    file = tmp_path / "joint.csv"
    file.write_text(text(lines, "time,position,velocity"), encoding="utf-8")
    _, speed_, position = guess_columns(read_table(file)).columns
    assert speed_.is_open
    assert position.unit == UNKNOWN
    assert not position.needed
    file.write_text(text(lines, "time,/joint_states/arm/position,/joint_states/arm/velocity"))
    _, speed_, position = guess_columns(read_table(file)).columns
    assert (speed_.is_open, position.is_spare) == (True, True)
    for column, unit in ((speed_, "rad/s"), (position, "rad")):  # ROS logs in SI units
        assert "slow for a motor" in column.reason
        assert f'"120 {unit}", of the motor "{unit}"' in column.reason
    # The position alone: its unit is asked for, and stated it is slow for a motor.
    file.write_text(text([line.rpartition(",")[0] for line in lines], "time,position"))
    assert guess_columns(read_table(file)).columns[1].unit == UNKNOWN
    file.write_text(text([line.rpartition(",")[0] for line in lines], "time,position [rad]"))
    assert "slow for a motor" in guess_columns(read_table(file)).columns[1].reason


def test_a_labview_file_is_a_table(tmp_path: Path) -> None:
    head = "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\n\t\nChannels\t1\t\t\n"
    file = tmp_path / "one.lvm"
    file.write_text(head + text(rows("{t:.6f}\t{n:.6f}"), "\t".join([*NAMES, "Comment"])))
    recording = read_recording(file)
    np.testing.assert_allclose(recording.motor_speed_rpm, SPEED)


@pytest.mark.parametrize(
    "name",
    [
        "speed [furlong/s]",
        "speed (cnt/s)",
        "speed [counts]",
        "motor_erpm",
        "speed (%)",
        "vel_counts",
        "speed / r/s",
        "speed, 1/s",
        "speed (s^-1)",
        "speed, 0.1 rpm",
        "speed x1000 rpm",
        "speed (rpm x10)",
        "speed_deg",
        "speed_pct",
        "speed_%",
        "vel_mm_s",
        "vel_mps",
        "speed_rpm_x10",
        "speed [rpm]*10",
    ],
)
def test_a_unit_that_is_not_known_is_a_question(name: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text(rows("{t:.3f};{n:.3f}"), f"time_s;{name}"))
    with pytest.raises(RecordingError, match=r"states a unit that is not known.*state the right"):
        read_recording(path, columns={"motor_speed_rpm": ColumnSpec(name)})
    speed = guess_columns(read_table(path)).columns[1]
    assert speed.unit == UNKNOWN
    assert "the file says" in speed.reason
    stated = {"motor_speed_rpm": ColumnSpec(name, "rpm/7")}
    np.testing.assert_allclose(read_recording(path, columns=stated).motor_speed_rpm, SPEED / 7)


@pytest.mark.parametrize("name", ["data(:,2)", "speed (filtered)", "x[1]", "n (raw)", "v(1)"])
def test_a_remark_or_an_index_is_no_unit(name: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text([row.replace(",", ";") for row in rows()], f"time_s;{name}"))
    read = read_recording(path, columns={"motor_speed_rpm": ColumnSpec(name)})
    np.testing.assert_allclose(read.motor_speed_rpm, SPEED)


@pytest.mark.parametrize(
    ("names", "channel", "name"),
    [
        ("n;t;speed", "motor_speed_rpm", "speed"),
        ("i;t;speed", "motor_current_a", None),
        ("speed_error;t;speed", "motor_speed_rpm", "speed"),
        ("speed_filtered;t;speed", "motor_speed_rpm", "speed"),
        ("ms_today;tacho;speed", "time_s", "ms_today"),
    ],
)
def test_numbers_of_rows_errors_and_filtered_signals_are_not_the_channel(
    names: str, channel: str, name: str | None, tmp_path: Path
) -> None:
    path = tmp_path / "a.csv"
    lines = [f"{i};{t:.3f};{n:.3f}" for i, (t, n) in enumerate(PAIRS)]
    path.write_text(text(lines, names))
    found = {c.channel: c.name for c in guess_columns(read_table(path)).columns}
    assert found.get(channel) == name


def test_a_position_beside_a_speed_of_unknown_size_is_asked_for_too(tmp_path: Path) -> None:
    # The configuration leaves such a speed out, and the position alone would set its size.
    path = tmp_path / "a.csv"
    lines = [f"{t:.3f};{7 * n:.1f};{6 * n * t % 360:.2f}" for t, n in PAIRS]
    path.write_text(text(lines, "t;erpm;encoder_position"))
    columns = guess_columns(read_table(path)).columns
    assert [column.unit for column in columns[1:]] == [UNKNOWN, UNKNOWN]


def test_a_demand_is_the_reference_and_a_unit_below_goes_before_one_of_the_name(
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.csv"
    lines = [f"{t:.3f};2000;{n:.3f}" for t, n in PAIRS]
    path.write_text(text(["s;rad/s;rad/s", *lines], "t;SpeedDemand;motor_speed_rpm"))
    guess = {c.channel: c for c in guess_columns(read_table(path)).columns}
    assert guess["reference_speed_rpm"].name == "SpeedDemand"
    assert guess["motor_speed_rpm"].unit == "rad/s"


@pytest.mark.parametrize("between", [0, 1, 3])
def test_rows_of_other_topics_are_no_samples(between: int, tmp_path: Path) -> None:
    # As PlotJuggler exports topics: a row for each stamp of any, empty cells for the others.
    generator = np.random.default_rng(3)
    lines = []
    for t, n in PAIRS:
        lines.append(f"{t:.4f},{n:.3f},")
        others = generator.integers(0, between + 1)
        lines += [f"{t + 0.0002 * (k + 1):.4f},,{k}" for k in range(others)]
    path = tmp_path / "a.csv"
    path.write_text(text(lines, "time_s,motor_speed_rpm,imu"))
    read = read_recording(path)
    np.testing.assert_allclose(read.time_s, TIME, atol=1e-9)
    np.testing.assert_array_equal(read.motor_speed_rpm, SPEED)
    assert read.excluded is None


def test_marks_that_could_be_decimal_or_part_thousands_alike_are_a_question(
    tmp_path: Path,
) -> None:
    # 12.345 s and 1995 rpm, or 12345 ms and 1.995 rpm: 1 kHz and a steady motor either way.
    lines = [f"{12345 + 1e3 * t:,.0f};{round(n) / 1e3:.3f}" for t, n in PAIRS]
    path = tmp_path / "a.csv"
    path.write_text(text(lines, "t;n"))
    with pytest.raises(RecordingError, match="decimal comma"):
        read_table(path)


# Other formats


def test_a_workbook_may_have_titles_units_text_and_faults(tmp_path: Path) -> None:
    import openpyxl

    path = tmp_path / "a.xlsx"
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["Measurement of joint 2"])
    sheet.append([])
    sheet.append(["Time", "Speed", "Remark"])
    sheet.append(["ms", "rpm", ""])
    for i, (t, n) in enumerate(PAIRS):
        sheet.append([1000.0 * t, str(n) if i % 2 else float(n), "warm" if i == 3 else None])
    sheet.cell(200, 2).value = "#N/A"
    book.save(path)
    columns = {"time_s": ColumnSpec("Time"), "motor_speed_rpm": ColumnSpec("Speed")}
    read = read_recording(path, columns=columns)
    np.testing.assert_allclose(read.time_s, TIME, atol=1e-9)
    assert read.excluded is not None
    assert np.flatnonzero(read.excluded).tolist() == [195]
    kept = ~read.excluded
    np.testing.assert_array_equal(read.motor_speed_rpm[kept], SPEED[kept])
    assert "number written as text" in read.notes[0]


def test_decimal_commas_as_text_in_a_workbook_are_told_from_its_numbers(tmp_path: Path) -> None:
    import openpyxl

    path = tmp_path / "a.xlsx"
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(list(NAMES))
    for t, n in PAIRS:
        sheet.append([float(t), f"{n:.3f}".replace(".", ",")])
    book.save(path)
    read = read_recording(path)
    np.testing.assert_array_equal(read.time_s, TIME)
    np.testing.assert_array_equal(read.motor_speed_rpm, SPEED)


def test_times_of_day_in_a_workbook_are_times(tmp_path: Path) -> None:
    import datetime

    import openpyxl

    path = tmp_path / "a.xlsx"
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(list(NAMES))
    for t, n in PAIRS:
        sheet.append([datetime.time(12, 0, 0, round(1e6 * t)), float(n)])
    book.save(path)
    np.testing.assert_allclose(read_recording(path).time_s, TIME, atol=2e-6)


def test_channels_of_tdms_that_start_apart_are_not_laid_on_one_another(tmp_path: Path) -> None:
    import nptdms

    path = tmp_path / "a.tdms"
    start = np.datetime64("2026-03-01T12:00:00", "us")
    channels = [
        nptdms.ChannelObject(
            "log",
            name,
            values,
            properties={"wf_start_time": start + np.timedelta64(late, "s"), "wf_increment": 1e-3},
        )
        for name, values, late in (
            ("motor_speed_rpm", SPEED, 0),
            ("motor_current_a", SPEED / 500.0, 3),
        )
    ]
    with nptdms.TdmsWriter(path) as file:
        file.write_segment(channels)
    both = {c.channel: ColumnSpec(c.channel) for c in channels}
    with pytest.raises(RecordingError, match="not sampled together"):
        read_recording(path, columns=both)
    alone = read_recording(path, columns={"motor_speed_rpm": ColumnSpec("motor_speed_rpm")})
    assert set(alone.channels) == {"motor_speed_rpm"}


def test_samples_that_an_mdf_file_marks_as_invalid_are_lost_ones(tmp_path: Path) -> None:
    import asammdf

    path = tmp_path / "a.mf4"
    invalid = np.zeros(COUNT, dtype=bool)
    invalid[300:310] = True
    speed = np.where(invalid, 1e6, SPEED)
    with asammdf.MDF(version="4.10") as file:
        file.append(
            [
                asammdf.Signal(speed, TIME, name=NAMES[1], invalidation_bits=invalid),
                asammdf.Signal(SPEED, TIME, name="motor_current_a"),
            ]
        )
        file.save(path, overwrite=True)
    read = read_recording(path)
    np.testing.assert_array_equal(read.excluded, invalid)
    np.testing.assert_array_equal(read.motor_speed_rpm[~invalid], SPEED[~invalid])


def test_lists_in_parquet_are_columns(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = tmp_path / "a.parquet"
    state = [[float(n), float(i)] for i, n in enumerate(SPEED)]
    table = {"time_s": TIME, "state": state, "uneven": [[0.0] * (i % 3) for i in range(COUNT)]}
    pq.write_table(pa.table(table), path)
    columns = {"motor_speed_rpm": ColumnSpec("state[0]")}
    np.testing.assert_array_equal(read_recording(path, columns=columns).motor_speed_rpm, SPEED)


def test_dates_may_be_without_seconds(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text([f"2026-03-01 12:{i:02d},{n}" for i, n in enumerate(SPEED[:60])]))
    np.testing.assert_array_equal(read_recording(path).time_s, 60.0 * np.arange(60))


def test_the_form_of_a_date_is_no_unit_and_a_count_of_samples_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    lines = [f"{i},{clock(t, '%H:%M:%S.%f')},{n}" for i, (t, n) in enumerate(PAIRS)]
    path.write_text(text(lines, "sample,Time [hh:mm:ss],speed [rpm]"))
    guess = {c.channel: c for c in guess_columns(read_table(path)).columns}
    assert (guess["time_s"].name, guess["time_s"].unit) == ("Time [hh:mm:ss]", "datetime")
    speed = {"motor_speed_rpm": ColumnSpec("speed [rpm]")}
    for name, unit in (("Time [hh:mm:ss]", None), ("sample", "1 ms")):
        read = read_recording(path, columns=speed | {"time_s": ColumnSpec(name, unit)})
        np.testing.assert_allclose(read.time_s, TIME, atol=1e-9)
    path.write_text(text([f"{i},{n}" for i, n in enumerate(SPEED)], "sample,speed [rpm]"))
    time = guess_columns(read_table(path)).columns[0]
    assert (time.name, time.unit) == ("sample", UNKNOWN)
    assert '"4 ms"' in time.reason


@pytest.mark.parametrize("count", [0, 1, 15])
def test_a_table_of_few_rows_is_too_short_in_every_stage(count: int, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="too short"):
        recorded(tmp_path, {"time_s": TIME[:count], "motor_speed_rpm": SPEED[:count]})


# Files of other people's tools


def test_an_event_log_of_two_positions_is_held_until_the_next_event(tmp_path: Path) -> None:
    start = np.datetime64("2020-12-08T16:17:33.317076", "us")
    lines = []
    for i in range(COUNT):
        stamp = str(start + np.timedelta64(10_000 * i, "us")).replace("T", " ")
        lines.append(f"IOC:Enc-PosAct {stamp} {0.5 * i}  ")
        if i % 2 == 0:
            lines.append(f"IOC:Axis1-PosAct          {stamp} {-float(i)} HIGH MINOR")
    lines.insert(7, "IOC:Axis1-PosAct *** Disconnected")
    path = tmp_path / "axis.log"
    path.write_text("\n".join(lines))
    columns = {
        "motor_position_rad": ColumnSpec("IOC:Axis1-PosAct", "deg"),
        "load_position_rad": ColumnSpec("IOC:Enc-PosAct", "deg"),
    }
    read = read_recording(path, columns=columns, even=False)
    np.testing.assert_allclose(read.time_s, 0.01 * np.arange(COUNT), atol=1e-9)
    steps = np.repeat(-np.arange(0.0, COUNT, 2.0), 2)
    np.testing.assert_allclose(read.channels["motor_position_rad"], np.deg2rad(steps))
    (note,) = (n for n in read.notes if "Put right" in n)
    assert f"{COUNT // 2} × value of an event log" in note
    assert "1 × line of text left out" in note


def test_an_event_log_of_one_value_has_its_stamps_in_two_cells(tmp_path: Path) -> None:
    lines = [f"2026-03-01 12:00:{t:06.3f} {n}" for t, n in PAIRS]
    path = tmp_path / "a.txt"
    path.write_text("\n".join(lines))
    read = read_recording(path, columns={"motor_speed_rpm": ColumnSpec("value")})
    np.testing.assert_allclose(read.time_s, TIME, atol=1e-6)
    np.testing.assert_array_equal(read.motor_speed_rpm, SPEED)


RECORDS = [{"time_s": t, "joint": {"n": n, "pose": [n, 0.0]}, "note": "x"} for t, n in PAIRS]
JSON_LOGS = {
    "lists by name": ({"time_s": TIME.tolist(), "n": SPEED.tolist(), "rate": 1000}, "n"),
    "lists within": ({"time_s": TIME.tolist(), "log": {"n": SPEED.tolist()}}, "log/n"),
    "records": (RECORDS, "joint/n"),
    "records below a head": ({"mass": 1.0, "entries": RECORDS}, "entries/joint/pose[0]"),
    "rows": ({"data": [[t, n] for t, n in PAIRS]}, "data[1]"),
}


@pytest.mark.parametrize("kind", JSON_LOGS)
def test_json_logs_are_tables(kind: str, tmp_path: Path) -> None:
    content, name = JSON_LOGS[kind]
    path = tmp_path / "a.json"
    path.write_text(json.dumps(content))
    time = {"records below a head": "entries/time_s", "rows": "data[0]"}.get(kind, "time_s")
    columns = {"time_s": ColumnSpec(time), "motor_speed_rpm": ColumnSpec(name)}
    read = read_recording(path, columns=columns)
    np.testing.assert_array_equal(read.time_s, TIME)
    np.testing.assert_array_equal(read.motor_speed_rpm, SPEED)


def test_a_record_a_line_is_a_table_and_other_json_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text("\n".join(map(json.dumps, RECORDS)))
    read = read_recording(path, columns={"motor_speed_rpm": ColumnSpec("joint/n")})
    np.testing.assert_array_equal(read.motor_speed_rpm, SPEED)
    for text, problem in (("[1", "cannot be read as JSON"), ('{"a": 1}', "no series of numbers")):
        (tmp_path / "b.json").write_text(text)
        with pytest.raises(RecordingError, match=problem):
            read_recording(tmp_path / "b.json")


def kuka_trace(folder: Path, samples: np.ndarray, words: tuple[str, str]) -> Path:
    """As a KRC controller writes it: a header, and interleaved 64-bit floats beside it."""
    implicit, explicit = words
    channels = [f"200,Zeit\n202,s\n210,{implicit}\n220,{len(samples)}\n240,0.\n241,0.012"] + [
        f"200,{name}\n202,{unit}\n210,{explicit}\n211,a.r64\n213,BLOCK\n214,REAL64\n"
        f"220,{len(samples)}\n221,{i}\n240,0.\n241,{factor}"
        for i, (name, unit, factor) in enumerate(
            (("AXIS_POS_ACT A1", "deg", "1."), ("MOTOR_VEL A1", "rpm", "2.")), 1
        )
    ]
    body = "".join(f"#BEGINCHANNELHEADER\n{c}\n#ENDCHANNELHEADER\n" for c in channels)
    path = folder / "a.dat"
    path.write_text("#BEGINGLOBALHEADER\n101,KRC\n#ENDGLOBALHEADER\n" + body)
    samples.astype("<f8").tofile(folder / "a.r64")
    return path


@pytest.mark.parametrize("words", [("IMPLIZIT", "EXPLIZIT"), ("IMPLICIT", "EXPLICIT")])
def test_a_kuka_trace_is_read_with_its_samples(words: tuple[str, str], tmp_path: Path) -> None:
    path = kuka_trace(tmp_path, np.column_stack([SPEED, 0.5 * SPEED]), words)
    columns = {"time_s": ColumnSpec("Zeit"), "motor_speed_rpm": ColumnSpec("MOTOR_VEL A1")}
    read = read_recording(path, columns=columns)
    np.testing.assert_allclose(read.time_s, 0.012 * np.arange(COUNT))
    np.testing.assert_allclose(read.motor_speed_rpm, SPEED)
    first = read.source.sha256 if read.source else ""
    (tmp_path / "a.r64").write_bytes((tmp_path / "a.r64").read_bytes()[:-8] + bytes(8))
    again = read_recording(path, columns=columns)
    assert again.source is not None
    assert again.source.sha256 != first
    (tmp_path / "a.r64").write_bytes(bytes(80))
    with pytest.raises(RecordingError, match="fewer samples than its header"):
        read_recording(path, columns=columns)


def test_a_stamp_that_comes_twice_is_spread_where_no_even_samples_are_needed(
    tmp_path: Path,
) -> None:
    time = TIME.copy()
    time[300] = time[299]
    path = tmp_path / "a.csv"
    path.write_text(text([f"{t},{n}" for t, n in zip(time, SPEED, strict=True)]))
    read = read_recording(path, even=False)
    np.testing.assert_array_equal(read.motor_speed_rpm, SPEED)
    np.testing.assert_allclose(read.time_s, TIME, atol=5.1e-4)


@pytest.mark.parametrize(
    "names",
    [
        "time,theta_m,theta_l",
        "t,motor_pos,output_pos",
        "time,q_motor,q_link",
        "time,enc1_angle,enc2_angle",
        "time,joint_rel_pos,joint_abs_pos",
        "time,motor,axis",
    ],
)
def test_positions_of_motor_and_load_are_told_apart(names: str, tmp_path: Path) -> None:
    load = np.sin(4.0 * np.pi * TIME / TIME[-1])
    path = tmp_path / "a.csv"
    rows_ = [f"{t},{50.0 * x},{x}" for t, x in zip(TIME, load, strict=True)]
    path.write_text(text(rows_, names))
    guess = guess_columns(read_table(path))
    assert guess.route == "two_encoders"
    told = {column.channel: column.name for column in guess.columns}
    assert list(told.values()) == names.split(",")
    assert list(told) == ["time_s", "motor_position_rad", "load_position_rad"]


TO_AND_FRO = np.sin(6.0 * np.pi * TIME)


def guessed(path: Path, columns: dict[str, np.ndarray]) -> dict[str, tuple[str, str]]:
    """Channel to name and unit, of a file of such columns."""
    lines = [",".join(map(repr, map(float, row))) for row in zip(*columns.values(), strict=True)]
    path.write_text(text(lines, ",".join(columns)))
    return {c.channel: (c.name, c.unit) for c in guess_columns(read_table(path)).columns}


@pytest.mark.parametrize("names", ["pos_abs,sencond_pos_abs", "enc1,enc2", "enc2,enc1"])
@pytest.mark.parametrize("form", ["counts", "turns of 4096", "turns of 360"])
def test_of_two_positions_the_motor_is_the_one_that_moves_more(
    names: str, form: str, tmp_path: Path
) -> None:
    turns = 3.0 * TO_AND_FRO  # of the motor
    whole = 360.0 if form.endswith("360") else 4096.0
    counts = [np.floor(whole * ratio * turns + 700.0) for ratio in (1.0, 0.04)]
    motor, load = counts if form == "counts" else [each % whole for each in counts]
    for columns in ((motor, load), (load, motor)):
        named = dict(zip(names.split(","), columns, strict=True))
        found = guessed(tmp_path / "a.csv", {"time": TIME, **named})
        assert named[found["motor_position_rad"][0]] is motor
        assert named[found["load_position_rad"][0]] is load
        assert found["load_position_rad"][1] == found["motor_position_rad"][1] == UNKNOWN


def test_one_position_twice_is_no_motor_and_load(tmp_path: Path) -> None:
    columns = {"time": TIME, "pos": TO_AND_FRO, "pos_raw": TO_AND_FRO + 1e-3 * NOISE}
    assert "load_position_rad" not in guessed(tmp_path / "a.csv", columns)
    columns = {"time": TIME, "motor temp": TO_AND_FRO, "housing temp": 0.5 * TO_AND_FRO}
    assert guessed(tmp_path / "a.csv", columns)["motor_position_rad"] == (UNKNOWN, UNKNOWN)
    columns = {"time": TIME, "pos": TO_AND_FRO, "pos_goal": 1.1 * TO_AND_FRO}
    assert guessed(tmp_path / "a.csv", columns)["motor_position_rad"][0] == "pos"


@pytest.mark.parametrize(
    ("motor", "joint"),
    [("motor", "joint"), ("/motor_states/elbow", "/joint_states/elbow"), ("motor_2", "link_2")],
)
def test_the_side_before_the_slash_tells_motor_and_joint_apart(
    motor: str, joint: str, tmp_path: Path
) -> None:
    speed = np.gradient(TO_AND_FRO, TIME)
    columns = {
        "t": TIME,
        f"{joint}/position": TO_AND_FRO,
        f"{joint}/velocity": speed,
        f"{motor}/position": 50.0 * TO_AND_FRO,
        f"{motor}/velocity": 50.0 * speed,
    }
    found = guessed(tmp_path / "a.csv", columns)
    by_ros = motor.startswith("/")
    assert found["motor_speed_rpm"] == (f"{motor}/velocity", "rad/s" if by_ros else UNKNOWN)
    assert found["motor_position_rad"] == (f"{motor}/position", "rad" if by_ros else UNKNOWN)
    assert found["load_position_rad"] == (f"{joint}/position", "rad" if by_ros else UNKNOWN)
    two = columns | {f"motor_7/{kind}": speed for kind in ("position", "velocity")}
    if motor == "motor_2":
        with pytest.raises(RecordingError, match="several joints"):
            guessed(tmp_path / "a.csv", two)


@pytest.mark.parametrize("unit", ["rpm", "rad/s", "deg/s", "rev/s"])
def test_a_speeds_unit_is_that_of_the_positions_derivative_to_and_fro(
    unit: str, tmp_path: Path
) -> None:
    noise = np.random.default_rng(11).normal(0.0, 3.0, COUNT)
    speed = 100.0 * np.gradient(TO_AND_FRO, TIME) + noise  # rad/s
    columns = {
        "time": TIME,
        "velocity": speed * RPM_PER_RAD_PER_S / conversion_factor("motor_speed_rpm", unit),
        "position [rad]": 100.0 * TO_AND_FRO % (2.0 * np.pi),
    }
    told = guessed(tmp_path / "a.csv", columns)["motor_speed_rpm"][1]
    factor = conversion_factor("motor_speed_rpm", unit)
    assert told != UNKNOWN
    assert conversion_factor("motor_speed_rpm", told) == pytest.approx(factor)
    columns["velocity"] = np.abs(columns["velocity"])  # a sign that the log writes as a bit
    assert guessed(tmp_path / "a.csv", columns)["motor_speed_rpm"][1] == UNKNOWN


def test_counts_and_lengths_are_asked_for_with_what_to_write(tmp_path: Path) -> None:
    columns = {"time [s]": TIME, "motor [deg]": 9e3 * TO_AND_FRO, "table position [mm]": TO_AND_FRO}
    assert guessed(tmp_path / "a.csv", columns)["load_position_rad"][1] == UNKNOWN
    load = guess_columns(read_table(tmp_path / "a.csv")).columns[-1]
    assert '"mm"' in load.reason
    assert "the mm of a screw's turn" in load.reason
    assert conversion_factor("load_position_rad", "rad/400") == pytest.approx(1.0 / 400.0)
    assert '"rad/400" (mm at 400 mm)' in load.reason


@pytest.mark.parametrize("name", ["ina1 current [A]", "supply_current_a", "bus current"])
def test_the_current_of_a_supply_is_not_the_motors(name: str, tmp_path: Path) -> None:
    columns = {"time [s]": TIME, "speed [rpm]": SPEED, name: SPEED}
    assert "motor_current_a" not in guessed(tmp_path / "a.csv", columns)


def test_a_symbol_with_its_sides_letter_is_that_sides(tmp_path: Path) -> None:
    columns = {"t": TIME, "ql": TO_AND_FRO, "qm": 50.0 * TO_AND_FRO}
    found = guessed(tmp_path / "a.csv", columns)
    assert found["motor_position_rad"][0] == "qm"
    assert found["load_position_rad"][0] == "ql"


def test_titles_above_columns_of_one_name_tell_them_apart(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    lines = [f"{1e3 * t:.0f},{n},{1e3 * t:.0f},{i}," for i, (t, n) in enumerate(PAIRS)]
    path.write_text(text(["X,Y,X,Y", *lines], "Speed [0x2201/31],,Current,,"))
    names = ("Speed [0x2201/31] X", "Speed [0x2201/31] Y", "Current X", "Current Y")
    assert read_table(path).columns == names
    assert "counts the samples" in guess_columns(read_table(path)).columns[0].reason


@pytest.mark.parametrize(
    ("seconds", "nanoseconds", "whole"),
    [("stamp.sec", "stamp.nanosec", True), ("time_s", "time_ns", False)],
)
def test_nanoseconds_are_added_to_whole_seconds_only(
    seconds: str, nanoseconds: str, whole: bool, tmp_path: Path
) -> None:
    path, step_ns, count = tmp_path / "a.csv", 4_000_000, 240  # less than a second, if not whole
    clock_ns = step_ns * np.arange(10 * count if whole else count)
    rows_ = [
        f"{ns // 10**9},{ns % 10**9},1500" if whole else f"{ns / 1e9},{ns},1500" for ns in clock_ns
    ]
    path.write_text(text(rows_, f"{seconds},{nanoseconds},motor_speed_rpm"))
    stamps, _ = stamps_and_values(read_table(path), seconds)
    np.testing.assert_allclose(stamps, 1e-9 * clock_ns, atol=1e-9)


@pytest.mark.parametrize("rate_hz", [20.0, 25.0, 40.0])
def test_slow_samples_of_a_minute_are_in_seconds_and_not_a_moment_in_milliseconds(
    rate_hz: float, tmp_path: Path
) -> None:
    path, stamps = tmp_path / "a.csv", np.arange(0.0, 60.0, 1.0 / rate_hz)
    path.write_text(text([f"{t:.6g},1500" for t in stamps], "time,motor_speed_rpm"))
    guess = {c.channel: c.unit for c in guess_columns(read_table(path)).columns}
    assert guess["time_s"] == "s"


@pytest.mark.parametrize("index", ["_0", "[3]", " (1)", " 2", ""])
def test_an_index_does_not_hide_the_unit_before_it(index: str, tmp_path: Path) -> None:
    columns = {"time": TIME, f"speed_rpm{index}": SPEED, f"current_mA{index}": SPEED}
    told = guessed(tmp_path / "a.csv", columns)
    assert told["motor_speed_rpm"][1] == "rpm"
    assert told["motor_current_a"] == (f"current_mA{index}", "mA")


def test_columns_with_times_of_their_own_are_put_to_shared_ones(tmp_path: Path) -> None:
    # As PlotJuggler exports topics: a row for each stamp of any, empty cells for the others.
    own = np.arange(COUNT) % 3 == 0
    columns = {
        "__time": 1.7e9 + TIME,
        "/motor_state/position": np.where(own, np.nan, 50.0 * TO_AND_FRO),
        "/joint_states/joint_1/position": np.where(own, TO_AND_FRO, np.nan),
    }
    told = guessed(tmp_path / "a.csv", columns)
    names = {channel: name for channel, (name, _) in told.items()}
    assert list(names.values()) == list(columns)
    specs = {channel: ColumnSpec(name) for channel, name in names.items()}
    read = read_recording(tmp_path / "a.csv", columns=specs, even=False)
    assert read.samples == own.sum() - 1  # the motor is known a sample later
    motor, load = read.channels["motor_position_rad"], read.channels["load_position_rad"]
    bend = (6.0 * np.pi) ** 2 * 0.002**2 / 8.0  # of the sine over a hole of 2 ms
    np.testing.assert_allclose(motor, 50.0 * load, atol=50.0 * 1.1 * bend)
    assert "value put between two of the times of its own column" in read.notes[0]


# Ramps of torque: what turns lags behind by its friction, what is held follows.
TORQUE = 40.0 * TO_AND_FRO
TWIST = 1e-4 * (TORQUE - 8.0 * np.sign(np.gradient(TORQUE)))


@pytest.mark.parametrize(
    ("columns", "position", "torque"),
    [
        (("Torque(N·m)", "Torsion angle(deg)"), "Torsion angle(deg)", "Torque(N·m)"),
        (("Load [Nm]", "Encoder [arcsec]"), "Encoder [arcsec]", "Load [Nm]"),
        (("Kraft (N)", "Messuhr (mm)"), "Messuhr (mm)", "Kraft (N)"),
        (("output torque [Nm]", "output pos", "motor pos"), "output pos", "output torque [Nm]"),
        (("motor torque [Nm]", "motor pos", "output pos"), "motor pos", "motor torque [Nm]"),
        (("torque", "position", "velocity"), "position", "torque"),
    ],
)
def test_where_one_side_is_held_torque_turns_the_other(
    columns: tuple[str, ...], position: str, torque: str, tmp_path: Path
) -> None:
    beside = np.gradient(TWIST, TIME) if columns[-1] == "velocity" else 1e-6 * TORQUE
    values = dict(zip(columns, (TORQUE, TWIST, beside), strict=False))
    told = guessed(tmp_path / "a.csv", values)
    assert told["motor_position_rad"][0] == position
    assert told["motor_torque_nm"][0] == torque
    assert len(told) == 2
    guess = guess_columns(read_table(tmp_path / "a.csv"))
    assert guess.route == "torque_ramp"
    assert guess.of_motor == columns[0].startswith("motor")
    if guess.of_motor:
        values = {"output torque [Nm]": TORQUE, **values}
        assert guessed(tmp_path / "a.csv", values) == told  # its own torque
        del values[torque]
        assert guessed(tmp_path / "a.csv", values)["motor_torque_nm"] == (
            "output torque [Nm]",
            UNKNOWN,
        )
    # A weight hangs at the joint: its torque goes with the angle, but less than the motor does.
    moved = {"time": TIME, "tau": TORQUE, "q": TWIST, "theta": 50.0 * TWIST + 1e-3 * NOISE}
    guessed(tmp_path / "b.csv", moved)
    assert guess_columns(read_table(tmp_path / "b.csv")).route == "two_encoders"


def test_joints_that_are_numbered_are_chosen_by_their_number(tmp_path: Path) -> None:
    columns = {"time": TIME}
    for joint in range(4):
        columns[f"q_{joint}"] = (joint + 1.0) * TO_AND_FRO
        columns[f"theta_{joint}"] = 50.0 * (joint + 1.0) * TO_AND_FRO
    with pytest.raises(RecordingError, match=r"several joints.*0, 1, 2, 3"):
        guessed(tmp_path / "a.csv", columns)
    guess = guess_columns(read_table(tmp_path / "a.csv"), "2")
    assert [column.name for column in guess.columns] == ["time", "theta_2", "q_2"]
    at_output = {"time": TIME, "q_1": TO_AND_FRO, "theta_1": TO_AND_FRO + 1e-5 * NOISE}
    told = guessed(tmp_path / "a.csv", at_output)
    assert (told["motor_position_rad"][0], told["load_position_rad"][0]) == ("theta_1", "q_1")


def test_of_two_counters_which_is_the_motors_is_a_question(tmp_path: Path) -> None:
    columns = {"t": TIME, "A [inc]": 4e3 * TO_AND_FRO, "B [inc]": 3e4 * TO_AND_FRO}
    columns |= {"velocity [inc/s]": np.gradient(4e3 * TO_AND_FRO, TIME)}
    names = {"A [inc]": "pos A [inc]", "B [inc]": "pos B [inc]"}
    guessed(tmp_path / "a.csv", {names.get(name, name): v for name, v in columns.items()})
    _, speed, motor, load = guess_columns(read_table(tmp_path / "a.csv")).columns
    assert not speed.needed
    assert (motor.name, load.name) == ("pos B [inc]", "pos A [inc]")
    assert motor.reason.startswith("perhaps the load's")
    assert motor.doubted
    guessed(tmp_path / "b.csv", {"t": TIME, "theta_m": 3e4 * TO_AND_FRO, "theta_l": TO_AND_FRO})
    assert not any(c.doubted for c in guess_columns(read_table(tmp_path / "b.csv")).columns)


# Forms of tools whose files state more above the samples than names


def test_a_stated_step_is_the_clock_of_a_file_without_times(tmp_path: Path) -> None:
    # LabVIEW without times, and Yaskawa's SigmaWin+.
    labview = (
        "LabVIEW Measurement\t\nX_Columns\tNo\n***End_of_Header***\t\n\t\nChannels\t1\t\n"
        f"Samples\t{COUNT}\t\nY_Unit_Label\trad/s\tVolts\t\nX0\t0.0E+0\t\nDelta_X\t0.002000\t\n"
        "***End_of_Header***\t\t\nX_Value\tMotor Speed\tSpare\tComment\n"
    )
    yaskawa = "SigmaWin+,Trace\nSampling Time,2 ms\n\nNo.,Feedback Speed[rad/s]\n"
    for header, form, name in (
        (labview, "\t{n}\t{i}", "Motor Speed"),
        (yaskawa, "{i},{n}", "Feedback Speed[rad/s]"),
    ):
        path = tmp_path / "a.csv"
        path.write_text(header + "\n".join(form.format(i=i, n=n) for i, n in enumerate(SPEED)))
        (column,) = guess_columns(read_table(path)).columns
        assert (column.name, column.unit, column.sure) == (name, "rad/s", True)
        read = read_recording(path, columns={"motor_speed_rpm": ColumnSpec(name, "rad/s")})
        np.testing.assert_allclose(read.time_s, 2.0 * TIME, atol=1e-9)


def test_numbers_of_samples_are_no_milliseconds(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    lines = [f"{i},{n}" for i, n in enumerate(SPEED)]
    path.write_text("\n".join(["No.,Feedback Speed[rpm]", *lines]))
    assert guess_columns(read_table(path)).columns[0].unit == UNKNOWN
    path.write_text("\n".join(["t,Feedback Speed[rpm]", *lines]))
    assert guess_columns(read_table(path)).columns[0].unit == "ms"


@pytest.mark.parametrize("form", ["historian", "influx"])
def test_a_value_a_line_with_its_name_is_a_column_for_each_name(form: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    both = [("pos_deg", TO_AND_FRO), ("speed_rpm", SPEED)]
    stamp = "2026-03-14T08:12:{:06.3f}Z"
    if form == "historian":
        head = "TagName,Timestamp,Value,Quality"
        lines = [f"{n},{stamp.format(t)},{v[i]},192" for i, t in enumerate(TIME) for n, v in both]
    else:
        head = "#group,false,false,true,false,false,true\n,result,table,_start,_time,_value,_field"
        begin = "2026-03-14T08:00:00Z"
        lines = [
            f",,{k},{begin},{stamp.format(t)},{v[i]},{n}"
            for k, (n, v) in enumerate(both)
            for i, t in enumerate(TIME)
        ]
    path.write_text("\n".join([head, *lines]))
    table = read_table(path)
    assert set(table.columns) == {"time_s", "pos_deg", "speed_rpm"}
    np.testing.assert_allclose(table.arrays["speed_rpm"], SPEED)
    np.testing.assert_allclose(table.arrays["pos_deg"], TO_AND_FRO)
    np.testing.assert_allclose(table.arrays["time_s"], TIME, atol=1e-6)


def test_a_second_time_is_the_clock_of_the_columns_behind_it(tmp_path: Path) -> None:
    # As LabVIEW, CODESYS and Excel write channels of several rates.
    path, slow = tmp_path / "a.csv", SPEED[::2] / 500.0
    lines = [
        f"{1e3 * t:.1f};{n};" + (f"{2e3 * t + 0.4:.1f};{slow[i]}" if i < slow.size else ";")
        for i, (t, n) in enumerate(PAIRS)
    ]
    path.write_text("\n".join(["Time [ms];Speed [rpm];Time [ms];Current [A]", *lines]))
    assert read_table(path).columns == ("Time [ms]", "Speed [rpm]", "Current [A]")
    guess = guess_columns(read_table(path))
    read = read_recording(path, columns={c.channel: ColumnSpec(c.name) for c in guess.columns})
    assert read.sampling_period_s == pytest.approx(2e-3)
    expected = np.interp(read.time_s, TIME, SPEED)
    np.testing.assert_allclose(read.motor_speed_rpm, expected, atol=1e-6)
    assert any("between two of the times" in note for note in read.notes)


def test_what_is_not_needed_does_not_ask(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    lines = [f"{t};{n};{i};{n / 20.0}" for i, (t, n) in enumerate(PAIRS)]
    path.write_text("\n".join(["time [s];speed [rpm];position [inc];torque [‰]", *lines]))
    guess = guess_columns(read_table(path))
    assert not guess.is_open
    assert [c.unit for c in guess.columns] == ["s", "rpm", UNKNOWN, UNKNOWN]
    written, _ = start_config([path], tmp_path / "a.toml")
    assert "\n# motor_torque_nm = {" in written.read_text(encoding="utf-8")


def test_names_and_units_may_stand_in_lines_that_begin_with_a_word(tmp_path: Path) -> None:
    # As Yokogawa's recorders write them, with a step in place of a clock.
    head = (
        '"Model","DL850"\n"TraceName","n_mot","i_mot"\n"BlockSize",1000,1000\n"VUnit","rpm","A"\n'
        '"SampleRate",1.0E+03,1.0E+03\n"HUnit","s","s"\n\n'
    )
    path = tmp_path / "a.csv"
    path.write_text(head + "\n".join(f",{n:.6E},{n / 500:.4E}" for n in SPEED))
    guess = guess_columns(read_table(path))
    assert [(c.name, c.unit) for c in guess.columns] == [("n_mot", "rpm"), ("i_mot", "A")]
    read = read_recording(path, columns={c.channel: ColumnSpec(c.name) for c in guess.columns})
    np.testing.assert_allclose(read.time_s, TIME, atol=1e-9)


def test_a_clock_of_the_group_that_a_joint_is_in_is_the_joints(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    joints = [{"joint3": {"speed_rpm": n}, "joint4": {"speed_rpm": 1}} for n in SPEED]
    records = [{"stamp": t, **joint} for t, joint in zip(TIME, joints, strict=True)]
    path.write_text(json.dumps({"samples": records}))
    time, speed = guess_columns(read_table(path), "samples/joint3").columns
    assert (time.name, speed.name) == ("samples/stamp", "samples/joint3/speed_rpm")


def test_durations_as_pandas_writes_them_are_times(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    lines = [f"0 days 00:00:{t:09.6f},{n}" for t, n in PAIRS]
    path.write_text("\n".join([",speed_rpm", *lines]))
    time, speed = guess_columns(read_table(path)).columns
    read = read_recording(path, columns={c.channel: ColumnSpec(c.name) for c in (time, speed)})
    np.testing.assert_allclose(read.time_s, TIME, atol=1e-6)


# Forms of plants, historians and oscilloscopes


def told(path: Path) -> dict[str, tuple[str, str]]:
    """Channel to name and unit, as guessed of a file."""
    return {c.channel: (c.name, c.unit) for c in guess_columns(read_table(path)).columns}


def read_as_told(path: Path) -> Recording:
    """What a user reads who leaves the guesses as they are."""
    found = told(path).items()
    return read_recording(path, columns={c: ColumnSpec(*each) for c, each in found})


WINCC = np.datetime64("2026-03-14T08:12:33.250", "ms") - np.datetime64("1899-12-30", "ms")


@pytest.mark.parametrize("names", [("n_rpm", "i_A"), ("n_rpm",)])
def test_a_time_that_is_not_as_long_as_the_dates_beside_it_is_a_question(
    names: tuple[str, ...], tmp_path: Path
) -> None:
    # WinCC's Time_ms counts millionths of a day since 1899; its last line is an event.
    lines = ["VarName;TimeString;VarValue;Validity;Time_ms"]
    for t, n in PAIRS:
        stamp = (WINCC.astype(float) + 4e3 * t) / 86.4
        lines += [
            f"{name};14.03.2026 08:12:{33 + int(4 * t + 0.25):02d};{n:.3f};1;{stamp:.4f}".replace(
                ".", ","
            ).replace("14,03,", "14.03.")
            for name in names
        ]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([*lines, "$RT_OFF$;14.03.2026 08:13:00;0;2;46095342361,1111"]))
    time = guess_columns(read_table(path)).columns[0]
    assert (time.name, time.unit) == ("Time_ms", UNKNOWN)
    assert 's in ms, but 2 s by the dates in "TimeString"; write "86.4 ms"' in time.reason
    if len(names) > 1:
        columns = {
            "time_s": ColumnSpec("Time_ms", "86.4 ms"),
            "motor_speed_rpm": ColumnSpec("n_rpm"),
        }
        read = read_recording(path, columns=columns)
        np.testing.assert_allclose(read.time_s, 4.0 * TIME, atol=1e-4)
        np.testing.assert_array_equal(read.motor_speed_rpm, SPEED)


def test_days_of_a_workbook_are_days_and_no_seconds(tmp_path: Path) -> None:
    for origin in (46095.25, 740000.25):  # of Excel and of MATLAB
        path = tmp_path / "a.csv"
        lines = [f"{origin + t / 86400.0:.12f},{n}" for t, n in PAIRS]
        path.write_text(text(lines, "Time,speed [rpm]"))
        assert told(path)["time_s"] == ("Time", "datenum")
        np.testing.assert_allclose(read_as_told(path).time_s, TIME, atol=2e-5)
    path.write_text(text([f"{5.0 + t / 86400.0:.12f},{n}" for t, n in PAIRS], "Time,speed [rpm]"))
    assert told(path)["time_s"] == ("Time", UNKNOWN)  # of no year: 86 MHz


@pytest.mark.parametrize("name", ["current", "tau"])
def test_the_unit_of_a_current_or_torque_is_not_made_up(name: str, tmp_path: Path) -> None:
    # A share of the rated value, or counts of 2.69 mA, look like A.
    path = tmp_path / "a.csv"
    path.write_text(text([f"{t},{n},{n / 50}" for t, n in PAIRS], f"t [s],n [rpm],{name}"))
    assert guess_columns(read_table(path)).columns[2].is_spare


@pytest.mark.parametrize("form", ["a copy of the value", "a number first", "a growing value"])
def test_a_historians_clock_is_its_dates(form: str, tmp_path: Path) -> None:
    path, lines = tmp_path / "a.csv", []
    for i, (t, n) in enumerate(PAIRS):
        for k, (name, value) in enumerate((("pos_rev", float(i)), ("speed_rpm", n))):
            copy = f",{value}" if form == "a copy of the value" else ""
            first = f"{2 * i + k}," if form == "a number first" else ""
            lines.append(f"{first}{name},{value}{copy},2026-03-14 08:12:{t:06.3f},192")
    head = "TagName,Value,DateTime,Quality"
    head = head.replace("DateTime", "vValue,DateTime") if form == "a copy of the value" else head
    path.write_text("\n".join(["id," + head if form == "a number first" else head, *lines]))
    read = read_as_told(path)
    np.testing.assert_allclose(read.time_s, TIME, atol=1e-6)
    np.testing.assert_array_equal(read.motor_speed_rpm, SPEED)


@pytest.mark.parametrize(
    "form",
    [
        "%d-%b-%y %H:%M:%S.%f",
        "%b %d, %Y %H:%M:%S.%f",
        "%a %b %d %Y %H:%M:%S.%f",
        "%d %B %Y %H:%M:%S.%f",
    ],
)
def test_months_may_have_names(form: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text([f'"{clock(t, form)}",{n}' for t, n in PAIRS], "Time,speed [rpm]"))
    np.testing.assert_allclose(read_as_told(path).time_s, TIME, atol=1e-9)


def test_milliseconds_may_have_a_column_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    lines = [f"{clock(t, '%m/%d/%Y,%H:%M:%S')},{(700 + 1000 * t) % 1000:.0f},{n}" for t, n in PAIRS]
    path.write_text(text(lines, "Date,Time,Millitm,Speed_rpm"))
    np.testing.assert_allclose(read_as_told(path).time_s, TIME, atol=1e-9)


ABOVE = {
    "Ignition": '"#NAMES"\n"t_stamp","speed_rpm","i_A"\n"#TYPES"\n"date","D","D"\n"#ROWS","600"',
    "Simulink": "time_s,speed,i\nUnit: s,Unit: rpm,Unit: A\nInterp: zoh,Interp: zoh,Interp: zoh",
    "catman": "Zeit,speed,Strom\nSek,1/min,A\nRate: 1,Rate: 1,Rate: 1\nNr: 1,Nr: 2,Nr: 3",
    "Lenze": "Index,0x606C:speed,0x6078:current\nUnit,rpm,A\nScaling,1,1\nTime [s],Value,Value",
}


@pytest.mark.parametrize("tool", ABOVE)
def test_rows_about_columns_below_the_names_do_not_hide_these(tool: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text([f"{t},{n},{n / 500}" for t, n in PAIRS], ABOVE[tool]))
    assert [unit for _, unit in told(path).values()] == ["s", "rpm", "A"]
    np.testing.assert_array_equal(read_as_told(path).motor_speed_rpm, SPEED)


def test_an_oscilloscopes_start_and_increment_below_the_names_are_no_sample(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    head = "X,n_mot [rpm],CH2,Start,Increment,\nSequence,Volt,Volt,-6.0e-01,1.0e-03,"
    path.write_text(text([f"{i},{n:.6E},1.0,," for i, n in enumerate(SPEED)], head))
    assert told(path) == {"motor_speed_rpm": ("n_mot [rpm]", "rpm")}
    read = read_as_told(path)
    np.testing.assert_allclose(read.time_s, TIME, atol=1e-9)
    lines = [f"{t},{'∞' if i == 300 else n}" for i, (t, n) in enumerate(PAIRS)]
    path.write_text(text(lines), encoding="utf-8")  # PicoScope, beyond its range
    assert read_recording(path).excluded is not None


def test_a_table_of_names_beside_rows_and_an_index_are_columns_of_json(tmp_path: Path) -> None:
    path, names = tmp_path / "a.json", ["time_s", "speed_rpm"]
    series = {"columns": names, "values": [[t, n] for t, n in PAIRS]}
    indexed = {name: dict(enumerate(v)) for name, v in zip(names, (TIME, SPEED), strict=True)}
    for content in ({"results": [{"series": [series]}]}, series, indexed):
        path.write_text(json.dumps(content))
        np.testing.assert_array_equal(read_as_told(path).motor_speed_rpm, SPEED)


def test_hdf5_and_records_of_numpy_are_tables(tmp_path: Path) -> None:
    import h5py

    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["log/pose"] = np.column_stack([SPEED, SPEED / 2.0])
        for name, values, unit in (("time", 1e3 * TIME, "ms"), ("speed", SPEED, "rpm")):
            file[f"log/{name}"] = values
            file[f"log/{name}"].attrs["units"] = unit
    assert read_table(path).columns == ("pose(:,1)", "pose(:,2)", "speed", "time")
    np.testing.assert_allclose(read_as_told(path).time_s, TIME, atol=1e-9)
    np.testing.assert_array_equal(read_as_told(path).motor_speed_rpm, SPEED)
    path = tmp_path / "a.npz"
    kind = [("time_s", float), ("motor_speed_rpm", float)]
    np.savez(path, log=np.array(PAIRS, dtype=kind))
    np.testing.assert_array_equal(read_recording(path).motor_speed_rpm, SPEED)


def test_groups_of_one_origin_are_put_to_shared_times(tmp_path: Path) -> None:
    import asammdf

    path = tmp_path / "a.mf4"
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(SPEED, TIME, name="speed", unit="rpm")])
        file.append([asammdf.Signal(TIME, TIME + 4e-4, name="current", unit="A")])
        file.append([asammdf.Signal(TIME[::5], TIME[::5], name="torque", unit="Nm")])
        file.save(path, overwrite=True)
    assert "motor_torque_nm" not in told(path)  # five times slower, and not needed
    read = read_as_told(path)
    np.testing.assert_array_equal(read.motor_speed_rpm, SPEED[1:])
    np.testing.assert_allclose(read.channels["motor_current_a"], TIME[1:] - 4e-4, atol=1e-9)


def test_a_groups_own_column_of_times_is_its_clock(tmp_path: Path) -> None:
    import nptdms

    path = tmp_path / "a.tdms"
    groups = {
        "A": {"Time": TIME, "Current": SPEED / 500.0},
        "B": {"Time": 2.0 * TIME, "Speed": SPEED},
    }
    units = {"Time": "s", "Current": "A", "Speed": "rpm"}
    with nptdms.TdmsWriter(path) as file:
        file.write_segment(
            [
                nptdms.ChannelObject(group, name, values, properties={"unit_string": units[name]})
                for group, columns in groups.items()
                for name, values in columns.items()
            ]
        )
    assert told(path) == {"time_s": ("B/Time", "s"), "motor_speed_rpm": ("Speed", "rpm")}
    wrong = {"time_s": ColumnSpec("A/Time"), "motor_speed_rpm": ColumnSpec("Speed")}
    with pytest.raises(RecordingError, match="not sampled together"):
        read_recording(path, columns=wrong)


def test_a_row_of_scales_makes_the_units_a_question(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    head = "Signal;Time;N_ACT;I_ACT\nUnit;ms;1/min;A\nFactor;1;0,1;0,001"
    path.write_text(text([f";{1e3 * t:.0f};{10 * n:.0f};4000" for t, n in PAIRS], head))
    time, speed, current = guess_columns(read_table(path)).columns
    assert (time.unit, speed.is_open, current.is_spare) == ("ms", True, True)
    assert '"1/min (scale 0,1)"' in speed.reason


@pytest.mark.parametrize(
    "name", ["Electrical Speed [rpm]", "omega_el [rad/s]", "Drehzahl elektrisch"]
)
def test_an_electrical_speed_is_a_question_and_comes_after_the_mechanical(
    name: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text([f"{t},{4 * n}" for t, n in PAIRS], f"t [s],{name}"))
    speed = guess_columns(read_table(path)).columns[1]
    assert speed.is_open
    assert '"rpm/7" (of 7 pole pairs)' in speed.reason
    path.write_text(text([f"{t},{4 * n},{n}" for t, n in PAIRS], f"t [s],{name},Speed [rpm]"))
    assert told(path)["motor_speed_rpm"] == ("Speed [rpm]", "rpm")


@pytest.mark.parametrize(
    ("above", "step_s"),
    [("Sample rate,1 kHz", 1e-3), ("Sampling rate [kHz],2", 5e-4), ("Scan rate,500", 2e-3)],
)
def test_a_stated_rate_has_a_unit(above: str, step_s: float, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text([f"{n},{n / 500}" for n in SPEED], f"{above}\nSpeed [rpm],Current [A]"))
    assert read_as_told(path).sampling_period_s == pytest.approx(step_s)


def test_a_step_of_one_without_a_unit_is_none(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text([f"{n},4" for n in SPEED], "Sampling period,1\nSpeed [rpm],i [A]"))
    with pytest.raises(RecordingError, match="No column looks like time"):
        told(path)


@pytest.mark.parametrize("form", ["joint_{}", "{}"])
def test_a_line_for_each_joint_is_not_one_joint(form: str, tmp_path: Path) -> None:
    path, joints = tmp_path / "a.csv", [form.format(joint) for joint in (1, 2, 3)]
    late = 2e-4 if form == "{}" else 0.0
    lines = [
        f"{t + late * k:.4f},{joint},{k * n}" for t, n in PAIRS for k, joint in enumerate(joints, 1)
    ]
    path.write_text(text(lines, "time,joint,speed_rpm"))
    with pytest.raises(RecordingError, match="several joints"):
        told(path)
    columns = {
        "time_s": ColumnSpec("time"),
        "motor_speed_rpm": ColumnSpec(f"{joints[1]}/speed_rpm"),
    }
    read = read_recording(path, columns=columns)
    np.testing.assert_allclose(read.motor_speed_rpm, 2.0 * SPEED)
    np.testing.assert_allclose(read.time_s, TIME + 2.0 * late)


def test_dates_in_digits_are_no_milliseconds(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    stamps = [f"202603140812{i:02d}" for i in range(60)]
    path.write_text(text([f"{s},{n}" for s, n in zip(stamps, SPEED, strict=False)], "Time,n [rpm]"))
    time = guess_columns(read_table(path)).columns[0]
    assert time.unit == UNKNOWN
    assert "2026-03-14T08:12:33" in time.reason


# Names that tell a side, joints of one message, and clocks that the other columns contradict


def guess_of(tmp_path: Path, content: str, joint: str | None = None) -> dict[str, GuessedColumn]:
    path = tmp_path / "a.txt"
    path.write_text(content)
    return {c.channel: c for c in guess_columns(read_table(path), joint).columns}


@pytest.mark.parametrize(
    "name",
    ["A1 speed [deg/s]", "J1 velocity (deg/s)", "qd_actual_0 [rad/s]", "actual_qd_0", "axis_pos"],
)
def test_what_robots_log_of_an_axis_is_not_silently_the_motors(tmp_path: Path, name: str) -> None:
    for called, is_asked in ((name, True), (f"motor {name}", False)):
        (found,) = (c for c in guess_of(tmp_path, text(rows(), f"time_s,{called}")).values()
                    if c.channel != "time_s")  # fmt: skip
        assert ("behind the gearbox" in found.reason) == is_asked
        assert found.is_open or not is_asked
    position = [f"{row},{t}" for row, t in zip(rows(), TIME, strict=True)]
    beside = guess_of(tmp_path, text(position, "time_s,motor speed [rpm],A1 position [deg]"))
    assert beside["motor_position_rad"].is_spare


@pytest.mark.parametrize(
    "names", ["field.velocity0,field.velocity1", "velocity[0],velocity[1]", "j1_speed,j2_speed"]
)
def test_which_of_two_joints_in_a_message_is_asked(tmp_path: Path, names: str) -> None:
    content = text([f"{row},{2 * n}" for row, (_, n) in zip(rows(), PAIRS, strict=True)],
                   f"time_s,{names}")  # fmt: skip
    with pytest.raises(RecordingError) as refused:
        guess_of(tmp_path, content)
    options = str(refused.value.found).split(", ")
    for option, name in zip(options, names.split(","), strict=True):
        assert guess_of(tmp_path, content, option)["motor_speed_rpm"].name == name


@pytest.mark.parametrize("tick", [1e-4, 1e-3, 1e-2])
def test_a_clocks_unit_that_speed_and_position_contradict_is_asked(
    tmp_path: Path, tick: float
) -> None:
    angle = np.cumsum(SPEED) * 6.0 * 0.001
    steps = [f"{round(1e-2 / tick) * i},{n},{a}" for i, (n, a) in enumerate(
        zip(SPEED, 10.0 * angle, strict=True))]  # fmt: skip
    time = guess_of(tmp_path, text(steps, "time,motor speed [rpm],motor position [deg]"))["time_s"]
    if tick != 1e-3:
        assert time.unit == UNKNOWN
        assert f'"{1e3 * tick:g} ms"' in time.reason or "Hz in" in time.reason
    else:
        assert time.unit == "ms"


@pytest.mark.parametrize(
    "form", ["20260301T{:%H%M%S.%f}", "2026-03-01_{:%H-%M-%S.%f}", "20260301_{:%H%M%S.%f}"]
)
def test_dates_without_marks_are_dates(tmp_path: Path, form: str) -> None:
    start = np.datetime64("2026-03-01T12:00:59.700", "us")
    stamps = [(start + np.timedelta64(1000 * i, "us")).item() for i in range(COUNT)]
    lines = [f"{form.format(stamp)},{n}" for stamp, n in zip(stamps, SPEED, strict=True)]
    path = tmp_path / "a.csv"
    path.write_text(text(lines, "time,motor_speed_rpm"))
    read = read_recording(path, columns={"time_s": ColumnSpec("time")})
    np.testing.assert_allclose(read.time_s, TIME, atol=1e-9)


@pytest.mark.parametrize(
    ("form", "clock_name"),
    [
        ("t:{ms} vel:{n} cur:0.4", "t"),
        ("t={ms},vel={n},pos=-1.5e-3", "t"),
        ("Time: {ms} Velocity: {n}", "Time"),
        ("t = {ms}, vel = {n} rpm, cur = 0.4 A", "t"),
        ("[12:30:00.{ms:03d}] I ({ms}) motor: vel={n} cur=0.4", "clock"),
        ("I ({ms}) motor: vel={n} rpm, cur=0.4 A", "clock [ms]"),
        ("12:30:00.{ms:03d} -> vel:{n} cur:0.4", "clock"),
    ],
)
def test_a_serial_log_of_names_and_values_is_read_as_written(
    tmp_path: Path, form: str, clock_name: str
) -> None:
    lines = [form.format(ms=i, n=n) for i, (_, n) in enumerate(PAIRS)]
    path = tmp_path / "serial.log"
    path.write_text("\n".join(["ets Jun  8 2016 00:22:57", *lines, lines[0][:8]]))
    table = read_table(path)
    assert table.place(0, "vel").startswith("line 2,")
    speed = next(name for name in table.columns if name.lower().startswith("vel"))
    unit = None if clock_name == "clock" else "ms"
    columns = {"time_s": ColumnSpec(clock_name, unit), "motor_speed_rpm": ColumnSpec(speed, "rpm")}
    read = read_recording(path, columns=columns)
    np.testing.assert_allclose(read.time_s, TIME, atol=1e-9)
    np.testing.assert_array_equal(read.motor_speed_rpm, SPEED)
    found = guess_columns(table).columns
    assert [c.name for c in found[:2]] == [clock_name, speed]


@pytest.mark.parametrize(
    "form",
    [
        "({t:.6f}) can0 123#{n:08X}",
        " ({t:.6f})  can0  123   [4]  10 20 30 40",
        "  can0  123   [4]  10 20 30 40",
        "   {t:.6f} 1  18FF0203x       Rx   d 4 10 20 30 40",
    ],
)
def test_raw_frames_are_no_table_and_said_to_need_their_dbc(tmp_path: Path, form: str) -> None:
    path = tmp_path / "can.asc"
    lines = [form.format(t=1436509052.25 + t, n=i) for i, t in enumerate(TIME)]
    path.write_text("\n".join(["date Mon Nov 30 08:30:00.000 am 2026", "base hex", *lines]))
    with pytest.raises(RecordingError, match=r"raw CAN frames.*DBC"):
        read_table(path)


def test_a_letter_beside_a_word_says_nothing_and_a_line_for_each_joint_keeps_its_clock(
    tmp_path: Path,
) -> None:
    lines = [
        f"{joint}|{angle:.5f}|0.4|{n}|{t:.3f}"
        for t, n, angle in zip(TIME, SPEED, np.cumsum(SPEED), strict=True)
        for joint in ("elbow", "wrist")
    ]
    content = "\n".join(["joint_name|position_rad|torque_Nm|force_N|timestamp", *lines])
    found = {channel: c.name for channel, c in guess_of(tmp_path, content, "wrist").items()}
    assert found == {
        "time_s": "timestamp",
        "motor_position_rad": "wrist/position_rad",
        "motor_torque_nm": "wrist/torque_Nm",
    }


TURNED = np.concatenate([[0.0], np.cumsum(0.5 * (SPEED[1:] + SPEED[:-1]) * 1e-3)]) * 6.0
"""Degrees."""


def test_a_column_that_increases_is_no_time_unless_its_name_says_so(tmp_path: Path) -> None:
    lines = "".join(f"{n:.3f} {p:.5f}\n" for n, p in zip(SPEED, TURNED, strict=True))
    clock = guess_of(tmp_path, lines)["time_s"]
    assert (clock.name, clock.unit, clock.is_open) == ("column 2", UNKNOWN, True)


def test_texts_before_each_value_name_them_and_a_period_in_words_is_the_step(
    tmp_path: Path,
) -> None:
    lines = [f"axis.pos +{p:.5f} axis.vel +{n:.3f} " for n, p in zip(SPEED, TURNED, strict=True)]
    path = tmp_path / "halscope.log"
    path.write_text("\n".join(["Sampling period is 1000000 nSec ", "", *lines]))
    read = read_recording(path, columns={"motor_speed_rpm": ColumnSpec("axis.vel", "rpm")})
    np.testing.assert_allclose(read.time_s, TIME, atol=1e-9)
    np.testing.assert_allclose(read.motor_speed_rpm, SPEED)
    lines = [f"{clock(t)}.{i:03d};j1.vel;{n};j1.cur;0.4;" for i, (t, n) in enumerate(PAIRS)]
    found = guess_of(tmp_path, "\n".join(lines))
    assert [c.name for c in found.values()] == ["column 1", "j1.vel", "j1.cur"]


def test_dates_are_time_whatever_their_name_and_a_finer_counter_beside_them_is_asked_about(
    tmp_path: Path,
) -> None:
    rows_ = [(f"12:00:{int(8 * t):02d}", 4096 + 8 * i, n) for i, (t, n) in enumerate(PAIRS)]
    lines = "\n".join(f"2026-03-01 {day},{ipoc},{n}" for day, ipoc, n in rows_)
    asked = guess_of(tmp_path, "Stamp,IPOC,vel\n" + lines)["time_s"]
    assert (asked.name, asked.unit) == ("IPOC", UNKNOWN)
    assert asked.reason.endswith('write "ms"')
    lines = "\n".join(f"2026-03-01 {day},{n}" for day, _, n in rows_)
    assert guess_of(tmp_path, "Stamp,vel\n" + lines)["time_s"].name == "Stamp"
    lines = "\n".join(f"2026-03-01 12:00:00,{ipoc},{n}" for _, ipoc, n in rows_)
    assert guess_of(tmp_path, "Begun,IPOC,vel\n" + lines)["time_s"].name == "IPOC"
    # Ticks of 4 ms are spread: no other clock is needed.
    lines = "\n".join(f"12:00:00.{i // 4 * 4:03d},{i},{n}" for i, (_, n) in enumerate(PAIRS))
    assert guess_of(tmp_path, "Stamp,IPOC,vel\n" + lines)["time_s"].name == "Stamp"


@pytest.mark.parametrize("filtered", ["Velocity averaged [rpm]", "n geglättet [1/min]"])
def test_a_filtered_speed_comes_after_the_other_one_in_any_word_for_it(
    tmp_path: Path, filtered: str
) -> None:
    lines = "\n".join(f"{t:.3f},{n},{n}" for t, n in PAIRS)
    found = guess_of(tmp_path, f"Time [s],{filtered},ActVelo [rpm]\n{lines}")
    assert found["motor_speed_rpm"].name == "ActVelo [rpm]"


def test_units_of_a_row_that_is_longer_than_the_samples_are_nobodys(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    head = ["# unit_string: s           unit_string: Nm          unit_string: 1/min"]
    path.write_text("\n".join([*head, "t torque n", *rows("{t:.3f} 0.4 {n:.3f}")]))
    assert not read_table(path).units


@pytest.mark.parametrize("negative", [lambda n: 32768 + n, lambda n: 65536 - n])
def test_signs_in_unsigned_words_are_put_back(
    tmp_path: Path, negative: Callable[[int], int]
) -> None:
    counts = [round(n) if i % 300 < 150 else -round(n) for i, n in enumerate(SPEED)]
    written = [n if n >= 0 else negative(-n) for n in counts]
    path = tmp_path / "servo.csv"
    path.write_text(text([f"{t:.3f},{n}" for t, n in zip(TIME, written, strict=True)]))
    read = read_recording(path)
    np.testing.assert_allclose(read.motor_speed_rpm, counts)
    assert read.notes == (
        "Put right while reading: 300 × sign of the motor speed in an unsigned word.",
    )
    fast = [n + 5000 if n > 32767 else n % 5 for n in written]  # beside a standstill
    path.write_text(text([f"{t:.3f},{n}" for t, n in zip(TIME, fast, strict=True)]))
    assert read_recording(path).motor_speed_rpm.max() > 30000.0
    path.write_text(text([f"{t:.3f},{n + 0.25}" for t, n in zip(TIME, written, strict=True)]))
    assert read_recording(path).motor_speed_rpm.max() > 30000.0


def test_a_reference_may_jump_over_half_of_all_numbers(tmp_path: Path) -> None:
    asked = np.where(np.arange(TIME.size) < 300, 10000, 40000)
    lines = [f"{t:.3f},{n:.3f},{a}" for t, n, a in zip(TIME, SPEED, asked, strict=True)]
    path = tmp_path / "steps.csv"
    path.write_text(text(lines, "time_s,motor_speed_rpm,reference_speed_rpm"))
    assert read_recording(path).channels["reference_speed_rpm"].min() > 0.0


@pytest.mark.parametrize("form", ["{t:.3f} s {n:.3f} rpm 300 mA", "{t:.3f} s pos 1.5 rad"])
def test_units_after_values_are_no_names_of_the_next(tmp_path: Path, form: str) -> None:
    path = tmp_path / "a.log"
    path.write_text(text(rows(form), None))
    assert not {"s", "rpm"} & set(read_table(path).columns)


def test_a_current_called_by_a_letter_is_no_speed_for_its_folder(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text(rows("{t:.3f},0.4,{n:.3f}"), "t [s],speed_controller.i,vel.w [rpm]"))
    named = {c.channel: c.name for c in guess_columns(read_table(path)).columns}
    assert named["motor_speed_rpm"] == "vel.w [rpm]"
    assert named["motor_current_a"] == "speed_controller.i"


def lerobot(folder: Path, names: object, episodes: int = 1) -> Path:
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = folder / "data" / "chunk-000" / "file-000.parquet"
    path.parent.mkdir(parents=True)
    angle = np.tile(TURNED % 90.0, episodes)
    lists = pa.array(np.column_stack([angle, angle + 1.0]).tolist())
    table = {
        "observation.state": lists,
        "action": lists,
        "timestamp": np.tile(TIME, episodes).astype("f4"),
        "episode_index": np.repeat(np.arange(episodes), COUNT),
    }
    pq.write_table(pa.table(table), path)
    features = {key: {"names": names} for key in ("observation.state", "action")}
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text(json.dumps({"fps": 1000, "features": features}))
    return path


@pytest.mark.parametrize("form", [lambda names: names, lambda names: {"motors": names}])
def test_lists_of_lerobot_are_called_as_its_info_says(
    tmp_path: Path, form: Callable[[list[str]], object]
) -> None:
    path = lerobot(tmp_path, form(["shoulder_pan.pos", "gripper.pos"]))
    table = read_table(path)
    np.testing.assert_allclose(table.arrays["gripper/action.pos"], TURNED % 90.0 + 1.0)
    found = {c.channel: c for c in guess_columns(table, "shoulder_pan").columns}
    assert found["motor_position_rad"].name == "shoulder_pan/observation.state.pos"
    assert found["motor_position_rad"].is_open
    before = read_recording(path, columns=LEROBOT).source.sha256
    for others in ("{}", "no JSON", '{"features": {"action": {"names": ["a", "a", "b"]}}}'):
        (tmp_path / "meta" / "info.json").write_text(others)
        assert read_table(path).columns[:2] == ("observation.state[0]", "observation.state[1]")
    (tmp_path / "meta" / "info.json").unlink()
    assert read_table(path).columns[:2] == ("observation.state[0]", "observation.state[1]")
    assert len(before) == 64


LEROBOT = {
    "time_s": ColumnSpec("timestamp", "s"),
    "motor_position_rad": ColumnSpec("shoulder_pan/observation.state.pos", "deg"),
}


def test_episodes_in_one_file_of_lerobot_are_groups(tmp_path: Path) -> None:
    table = read_table(lerobot(tmp_path, ["shoulder_pan.pos", "gripper.pos"], 3))
    with pytest.raises(RecordingError, match=r"several joints.*episode_0/shoulder_pan"):
        guess_columns(table)
    clock_, angle = guess_columns(table, "episode_1/gripper").columns
    assert clock_.name == "episode_1/time_s"
    assert angle.name == "episode_1/gripper/observation.state.pos"
    assert table.arrays[angle.name].size == COUNT


DBC = """VERSION ""
BU_: DRV
BO_ 321 Motor: 6 DRV
 SG_ MotorSpeed : 0|32@1- (0.001,0) [0|0] "rpm" DRV
 SG_ MotorCurrent : 32|16@1- (0.01,0) [0|0] "A" DRV
BO_ 322 Housing: 2 DRV
 SG_ Temperature : 0|16@1- (0.1,0) [0|0] "degC" DRV
"""


def can_log(path: Path) -> None:
    import can

    # A frame of the motor each ms, one of the housing after every fifth, one of nobody, one cut.
    frames = [(TIME[i], 321, pack("<ih", round(1e3 * SPEED[i]), 40)) for i in range(COUNT)]
    frames += [(TIME[i] + 3e-4, 322, pack("<h", 310)) for i in range(0, COUNT, 5)]
    frames += [(0.2004, 0x7FF, b"1"), (0.2006, 321, b"1"), (-1e-4, 322, pack("<h", 310))]
    frames.sort()
    if path.suffix == ".log":
        lines = [f"({1436509052 + t:.6f}) can0 {i:03X}#{d.hex().upper()}" for t, i, d in frames]
        path.write_text("\n".join(lines))
        return
    with can.Logger(str(path)) as log:
        for t, i, d in frames:
            log(can.Message(t + 1436509052, i, is_extended_id=False, channel=0, data=d))


@pytest.mark.parametrize("suffix", ["log", "asc", "blf"])
def test_frames_of_a_bus_are_decoded_by_the_dbc_file_beside_them(
    tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / f"drive.{suffix}"
    can_log(path)
    with pytest.raises(RecordingError, match=r"raw CAN frames.*no DBC file"):
        read_table(path)
    (tmp_path / "cell.dbc").write_text(DBC)
    table = read_table(path)
    assert table.units["MotorSpeed"] == "rpm"
    found = [c.name for c in guess_columns(table).columns]
    assert found == ["Motor/time_s", "MotorSpeed", "MotorCurrent"]
    columns = {name: ColumnSpec(of) for name, of in CAN_COLUMNS.items()}
    read = read_recording(path, columns=columns)
    np.testing.assert_allclose(read.motor_speed_rpm, SPEED, atol=1e-3)
    np.testing.assert_allclose(read.time_s - read.time_s[0], TIME, atol=1e-6)
    np.testing.assert_allclose(read.channels["motor_current_a"], 0.4)
    assert "1 × CAN frame that its message does not describe" in read.notes[0]
    (tmp_path / "other.dbc").write_text(DBC.replace("321", "320").replace("322", "319"))
    with pytest.raises(RecordingError, match=r"cell.dbc, other.dbc.*drive.dbc"):
        read_table(path)
    (tmp_path / "other.dbc").rename(tmp_path / "drive.dbc")
    with pytest.raises(RecordingError, match="none of a message in its DBC file"):
        read_table(path)


def rewritten_can_log(folder: Path, suffix: str, rewrite: Callable[[list[str]], list[str]]) -> Path:
    """A CAN log whose lines were rewritten, with its DBC file beside it."""
    can_log(log := folder / f"can.{suffix}")
    log.write_text("\n".join(rewrite(log.read_text().splitlines())) + "\n", encoding="utf-8")
    (folder / "can.dbc").write_text(DBC)
    return log


def spaced(line: str, stamp: str) -> str:
    """A line of ``candump -L`` as candump prints it on a terminal."""
    name, _, content = line.split()[-1].partition("#")
    return f"{stamp}  can0  {name}   [{len(content) // 2}]  {' '.join(re.findall('..', content))}"


def of_differences(lines: list[str]) -> list[str]:
    """Lines of candump with the time since the line before, as ``-td`` writes it."""
    stamps = [float(line[1 : line.index(")")]) for line in lines]
    steps = np.diff(stamps, prepend=stamps[0])
    return [spaced(line, f" ({step:010.6f})") for step, line in zip(steps, lines, strict=True)]


def of_times_out_of_order(lines: list[str]) -> list[str]:
    """Lines of ``candump -tz`` of two buses, of which two came out of order."""
    stamps = [float(line[1 : line.index(")")]) for line in lines]
    rows = [
        spaced(line, f" ({stamp - stamps[0]:010.6f})")
        for stamp, line in zip(stamps, lines, strict=True)
    ]
    other = next(i for i, row in enumerate(rows) if "  142  " in row and i > 100)
    rows[other : other + 2] = rows[other + 1], rows[other]
    return rows


def of_relative_stamps(lines: list[str]) -> list[str]:
    """Lines of Vector's tools with the time since the line before."""
    before, written = 0.0, []
    for line in lines:
        stamp, _, rest = line.strip().partition(" ")
        if re.fullmatch(r"\d+\.\d+", stamp):
            written.append(f"{float(stamp) - before:12.6f} {rest}")
            before = float(stamp)
        else:
            written.append(line.replace("timestamps absolute", "timestamps relative"))
    return written


@pytest.mark.parametrize(
    ("suffix", "rewrite"),
    [
        ("asc", lambda lines: ["\ufeff" + lines[0], *lines[1:]]),
        ("asc", lambda lines: [line for line in lines if re.match(r"\s*\d+\.\d+ +1 ", line)]),
        ("asc", of_relative_stamps),
        ("log", of_differences),
        ("log", of_times_out_of_order),
    ],
)
def test_a_can_log_may_lack_a_header_or_have_relative_stamps(suffix, rewrite, tmp_path):
    path = rewritten_can_log(tmp_path, suffix, rewrite)
    columns = {name: ColumnSpec(of) for name, of in CAN_COLUMNS.items()}
    read = read_recording(path, columns=columns)
    assert read.time_s - read.time_s[0] == pytest.approx(TIME - TIME[0], abs=2e-4)
    assert read.motor_speed_rpm == pytest.approx(SPEED, abs=0.05)


def test_a_can_log_without_times_is_refused_for_that(tmp_path):
    path = rewritten_can_log(tmp_path, "log", lambda lines: [spaced(line, "") for line in lines])
    with pytest.raises(RecordingError, match=r"no times.*candump -L"):
        read_recording(path, columns={"motor_speed_rpm": ColumnSpec("MotorSpeed")})


CAN_COLUMNS = {"motor_speed_rpm": "MotorSpeed", "motor_current_a": "MotorCurrent"}


@pytest.mark.parametrize(
    ("pattern", "joints"),
    [
        ("{what} {joint} [{unit}]", ("X", "Y")),
        ("{joint} {what} ({unit})", ("left", "right")),
        ("drive {joint}.{what} [{unit}]", ("A", "B")),
        ("{what}_{joint} [{unit}]", ("1", "2")),
    ],
)
def test_a_current_of_another_joint_is_never_taken(
    pattern: str, joints: tuple[str, str], tmp_path: Path
) -> None:
    """Two speeds, and the current of the second joint alone."""
    first, second = joints
    named = [("speed", first, "rpm"), ("speed", second, "rpm"), ("current", second, "A")]
    header = [pattern.format(what=what, joint=j, unit=u) for what, j, u in named]
    rows = [f"{i / 1000},{n:.6g},{-n:.6g},{0.001 * n:.6g}" for i, n in enumerate(SPEED)]
    content = "\n".join(["time_s," + ",".join(header), *rows])
    with pytest.raises(RecordingError, match=f"several joints. Found: {first}, {second}"):
        guess_of(tmp_path, content)
    assert set(guess_of(tmp_path, content, first)) == {"time_s", "motor_speed_rpm"}
    assert guess_of(tmp_path, content, second)["motor_current_a"].name == header[2]


@pytest.mark.parametrize(
    "name",
    [
        "torque x10 [Nm]",
        "torque_ozin",
        "Torque_lbft",
        "torque_kgcm",
        "torque oz-in",
        "T (lbf·ft)",
        "torque [0.1%]",
        "torque (p.u.)",
    ],
)
def test_a_torque_in_a_unit_that_is_none_here_is_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = [f"{i / 1000},{n:.6g},{0.01 * n:.6g}" for i, n in enumerate(SPEED)]
    path.write_text("\n".join([f"time_s,motor_speed_rpm,{name}", *rows]))
    with pytest.raises(RecordingError, match="not known for this channel"):
        read_recording(path, columns={"motor_torque_nm": ColumnSpec(name)})


def test_newton_millimetres_are_a_unit(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = [f"{i / 1000},{n:.6g},{n:.6g}" for i, n in enumerate(SPEED)]
    path.write_text("\n".join(["time_s,motor_speed_rpm,torque (N mm)", *rows]))
    read = read_recording(path, columns={"motor_torque_nm": ColumnSpec("torque (N mm)")})
    np.testing.assert_allclose(read.channels["motor_torque_nm"], 1e-3 * SPEED, rtol=1e-5)


def test_a_scale_in_an_attribute_is_a_question(tmp_path: Path) -> None:
    """Of HDF5, whose readers do not apply it; NetCDF's do."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["time_s"] = np.arange(SPEED.size) / 1000
        file["motor_speed_rpm"] = 10.0 * SPEED
        file["motor_speed_rpm"].attrs.update(units="rpm", scale_factor=0.1)
    with pytest.raises(RecordingError, match=r'Found: "rpm \(scale_factor 0.1\)"'):
        read_recording(path)
    with h5py.File(path, "a") as file:
        file["motor_speed_rpm"].attrs.update(scale_factor=1.0, add_offset=0.0)
    assert read_recording(path).motor_speed_rpm[3] == 10.0 * SPEED[3]


SPEED_NAME, CURRENT_NAME, TORQUE_NAME = "motor_speed_rpm", "motor_current_a", "motor_torque_nm"


@pytest.mark.parametrize(
    ("wrong", "right", "channel"),
    [
        ("n* [rpm]", "n [rpm]", SPEED_NAME),
        ("VelDem (rpm)", "VelFbk (rpm)", SPEED_NAME),
        ("speed limit [rpm]", "speed [rpm]", SPEED_NAME),
        ("estimated speed [rpm]", "speed [rpm]", SPEED_NAME),
        ("Id [A]", "Iq [A]", CURRENT_NAME),
        ("i_d [A]", "i_q [A]", CURRENT_NAME),
        ("current phase U [A]", "current q [A]", CURRENT_NAME),
        ("peak current [A]", "current [A]", CURRENT_NAME),
        ("torque feedforward [Nm]", "torque [Nm]", TORQUE_NAME),
        ("VCMD [1/min]", "TSA [1/min]", SPEED_NAME),
        ("指令速度 [r/min]", "モータ速度 [r/min]", SPEED_NAME),
        ("Stromistwert feldbildend [A]", "Stromistwert momentenbildend [A]", CURRENT_NAME),
        ("Motor current [%]", "Motor current [A]", CURRENT_NAME),
    ],
)
def test_another_quantity_of_the_same_unit_is_not_taken(
    wrong: str, right: str, channel: str, tmp_path: Path
) -> None:
    """Whichever comes first."""
    for names in ((wrong, right), (right, wrong)):
        rows = [f"{i / 1000},{n:.6g},{0.9 * n:.6g}" for i, n in enumerate(SPEED)]
        guess = guess_of(tmp_path, "\n".join([f"t [s],{','.join(names)}", *rows]))
        assert guess[channel].name == right


def test_the_current_of_a_winding_is_no_motor_current(tmp_path: Path) -> None:
    rows = [f"{i / 1000},{n:.6g},{0.9 * n:.6g}" for i, n in enumerate(SPEED)]
    assert CURRENT_NAME not in guess_of(tmp_path, "\n".join(["t [s],n [rpm],Iu [A]", *rows]))


def test_of_two_speeds_that_no_name_distinguishes_one_is_doubted(tmp_path: Path) -> None:
    rows = [f"{i / 1000},{n:.6g},{0.9 * n:.6g}" for i, n in enumerate(SPEED)]
    header = "t [s],master speed [rpm],slave speed [rpm]"
    speed = guess_of(tmp_path, "\n".join([header, *rows]))[SPEED_NAME]
    assert speed.doubted
    assert '"slave speed [rpm]"' in speed.reason
    header = "t [s],motor speed [rpm],output speed [rpm]"
    assert not guess_of(tmp_path, "\n".join([header, *rows]))[SPEED_NAME].doubted


@pytest.mark.parametrize("marks", [",.", ".,"])
def test_a_time_with_another_decimal_mark_than_the_values_is_a_question(
    marks: str, tmp_path: Path
) -> None:
    """12.345 s beside 1500,25 rpm would be 12345 s, in thousands."""
    of_time, of_values = marks
    rows = [
        f"{12 + i / 1000:.3f}".replace(".", of_time) + ";" + f"{n:.2f}".replace(".", of_values)
        for i, n in enumerate(SPEED)
    ]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["time_s;motor_speed_rpm", *rows]))
    with pytest.raises(RecordingError, match=r"may be a decimal .* or part thousands"):
        read_recording(path)


def test_a_workbook_that_shows_per_cent_holds_shares(tmp_path: Path) -> None:
    import openpyxl

    path = tmp_path / "a.xlsx"
    book = openpyxl.Workbook()
    book.active.append(["time_s", "motor_speed_rpm", "torque [%]"])
    for t, n in PAIRS:
        book.active.append([float(t), float(n), 0.45])
        book.active.cell(book.active.max_row, 3).number_format = "0.0%"
    book.save(path)
    columns = {"motor_torque_nm": ColumnSpec("torque [%]", "% of 10 N m")}
    read = read_recording(path, columns=columns)
    np.testing.assert_allclose(read.channels["motor_torque_nm"], 4.5)


def test_only_a_clock_is_the_time_of_an_mdf_group(tmp_path: Path) -> None:
    """Not the angle of a measurement that is synchronous to a shaft."""
    import asammdf

    path = tmp_path / "a.mf4"
    with asammdf.MDF(version="4.10") as file:
        file.append(asammdf.Signal(SPEED, TIME, name="n", unit="rpm", master_metadata=("phi", 2)))
        file.save(path)
    assert "time_s" not in read_table(path).columns


def test_the_unit_of_a_tdms_axis_is_not_always_seconds(tmp_path: Path) -> None:
    import nptdms

    path = tmp_path / "a.tdms"
    step = {"wf_increment": 1.0, "wf_xunit_string": "ms"}
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.ChannelObject("log", NAMES[1], SPEED, properties=step)])
    assert read_recording(path).sampling_period_s == pytest.approx(1e-3)
    with nptdms.TdmsWriter(path) as file:
        step["wf_xunit_string"] = "Hz"
        file.write_segment([nptdms.ChannelObject("log", NAMES[1], SPEED, properties=step)])
    with pytest.raises(RecordingError, match=r'not known for this channel.*Found: "Hz"'):
        read_recording(path)


@pytest.mark.parametrize("bits", [16, 32])
def test_a_recording_in_reverse_alone_may_be_of_unsigned_words(bits: int, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    whole = np.round(SPEED).astype(int)
    rows = [f"{i / 1000},{2**bits - n}" for i, n in enumerate(whole)]
    path.write_text("\n".join([",".join(NAMES), *rows]))
    read = read_recording(path)
    np.testing.assert_array_equal(read.motor_speed_rpm, -whole)
    assert "sign of the motor speed" in read.notes[0]
    # Counts may be as many, of a speed that is not so large.
    counts = {"motor_speed_rpm": ColumnSpec(NAMES[1], "rev/s/4096")}
    read = read_recording(path, columns=counts)
    assert (float(read.motor_speed_rpm.mean()) > 0.0) == (bits == 16)


def test_a_unit_of_columns_is_not_put_over_another_one_in_the_file(tmp_path: Path) -> None:
    """As of an export whose settings changed since the configuration was written."""
    path = tmp_path / "a.csv"
    path.write_text(text([f"{t},{n}" for t, n in PAIRS], "Time,Speed\ns,rad/s"))
    columns = {"time_s": ColumnSpec("Time", "s"), "motor_speed_rpm": ColumnSpec("Speed", "rpm")}
    with pytest.raises(RecordingError, match=r"different units.*rpm under .* rad/s in the file"):
        read_recording(path, columns=columns)
    columns["motor_speed_rpm"] = ColumnSpec("Speed", "1 rpm")
    np.testing.assert_array_equal(read_recording(path, columns=columns).motor_speed_rpm, SPEED)
    columns["motor_speed_rpm"] = ColumnSpec("Speed", "120 rad/s")
    assert read_recording(path, columns=columns).motor_speed_rpm[0] > 100.0 * SPEED[0]


def test_a_structure_with_name_data_and_unit_is_a_column(tmp_path: Path) -> None:
    """As dSPACE stores it, and as a JSON file may."""
    signals = [
        {"Name": "t", "Data": TIME, "Unit": "s"},
        {"Name": "omega", "Data": SPEED / RPM_PER_RAD_PER_S, "Unit": "rad/s"},
    ]
    path = tmp_path / "a.mat"
    savemat(path, {"log": {"X": signals[0], "Y": signals}})
    columns = {"time_s": ColumnSpec("X.t"), "motor_speed_rpm": ColumnSpec("Y(2).omega")}
    np.testing.assert_allclose(read_recording(path, columns=columns).motor_speed_rpm, SPEED)
    path = tmp_path / "a.json"
    omega = {"unit": "rad/s", "values": (SPEED / RPM_PER_RAD_PER_S).tolist()}
    path.write_text(json.dumps({"t": TIME.tolist(), "omega": omega}))
    columns = {"time_s": ColumnSpec("t"), "motor_speed_rpm": ColumnSpec("omega/values")}
    np.testing.assert_allclose(read_recording(path, columns=columns).motor_speed_rpm, SPEED)


def test_a_constant_setpoint_of_an_axis_names_nothing(tmp_path: Path) -> None:
    """Beside a column called value, it looked like a tag on each line."""
    header = "Time,Axis 1.NcToPlc.ActVelo,Axis 1.NcToPlc.SetVelo,Drive 1.Torque actual value"
    rows = [f"{t},{n},1490,{0.01 * n}" for t, n in PAIRS]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([header, *rows]))
    assert read_table(path).columns == tuple(header.split(","))


def test_one_unit_beside_several_lists_is_the_unit_of_none(tmp_path: Path) -> None:
    path, speed = tmp_path / "a.json", [1500.0 + i for i in range(40)]
    columns = {"time_s": [0.001 * i for i in range(40)], "motor_speed_rpm": speed}
    path.write_text(json.dumps({"units": "SI", **columns}))
    assert read_recording(path).motor_speed_rpm.tolist() == speed
    path.write_text(json.dumps({"n": {"unit": "deg/s", "time": columns["time_s"], "data": speed}}))
    assert read_table(path).units == {"n/data": "deg/s"}


def test_text_in_a_column_of_percent_is_text_in_that_column(tmp_path: Path) -> None:
    rows = [[0.001 * i, 1500.0 + i, 0.45 if i != 30 else "broken"] for i in range(40)]
    path = tmp_path / "a.xlsx"
    for name, unit in (("load", None), ("torque [pu]", "12 N m")):
        book = openpyxl.Workbook()
        sheet = book.active
        for row in [["time_s", "motor_speed_rpm", name], *rows]:
            sheet.append(row)
        for (cell,) in sheet.iter_rows(2, None, 3, 3):
            cell.number_format = "0 %"
        book.save(path)
        assert read_recording(path).motor_speed_rpm[5] == 1505.0
        if unit is not None:  # the name states what the cells hold
            sheet["C32"] = 0.45
            book.save(path)
            columns = {"motor_torque_nm": ColumnSpec(name, unit)}
            torque = read_recording(path, columns=columns).channels["motor_torque_nm"]
            assert torque == pytest.approx(5.4)
