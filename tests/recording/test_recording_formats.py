"""Formats: the same numbers come out of all of them, and damage never ends in a traceback."""

from __future__ import annotations

import gzip
import json
import sys
import zipfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recording_files import (
    write_bag,
    write_csv,
    write_excel,
    write_mat5,
    write_mat73,
    write_mdf,
    write_netcdf,
    write_parquet,
    write_scope,
    write_tdms,
)
from scipy.io import savemat

from bayesbl.errors import RecordingError, UserError
from bayesbl.recording import formats
from bayesbl.recording.channels import ColumnSpec
from bayesbl.recording.guessing import guess_columns
from bayesbl.recording.readers import read_recording, read_table
from bayesbl.units import RPM_PER_RAD_PER_S

TIME = np.arange(400) / 1000.0
SPEED = np.round(2000.0 + np.sin(TIME * 30.0), 9)  # Excel keeps 15 digits
PLAIN = {"time_s": TIME, "motor_speed_rpm": SPEED, "note": np.arange(400.0)}
START = np.datetime64("2026-03-01T12:00:00", "ns")
DATES = START + (TIME * 1e9).round().astype("timedelta64[ns]")


def write_json(path: Path, columns: Mapping[str, Sequence[object]]) -> Path:
    path.write_text(json.dumps({name: np.asarray(v).tolist() for name, v in columns.items()}))
    return path


WRITERS: dict[str, tuple[str, Callable[[Path], Path]]] = {
    "CSV": ("csv", lambda path: write_csv(path, PLAIN)),
    "NetCDF 4": ("nc", lambda path: write_netcdf(path, PLAIN)),
    "NetCDF 3": ("nc", lambda path: write_netcdf(path, PLAIN, "NETCDF3_CLASSIC")),
    "MATLAB v5, columns": ("mat", lambda path: write_mat5(path, PLAIN)),
    "MATLAB v5, rows": ("mat", lambda path: write_mat5(path, PLAIN, "row")),
    "MATLAB v5, one structure": ("mat", lambda path: write_mat5(path, {"rec": PLAIN})),
    "MATLAB v7.3": ("mat", lambda path: write_mat73(path, PLAIN)),
    "MATLAB v7.3, rows": (
        "mat",
        lambda path: write_mat73(path, {k: np.array(v)[:, None] for k, v in PLAIN.items()}),
    ),
    "MATLAB v7.3, one structure": ("mat", lambda path: write_mat73(path, {"rec": PLAIN})),
    "Parquet": ("parquet", lambda path: write_parquet(path, PLAIN)),
    "Excel": ("xlsx", lambda path: write_excel(path, PLAIN)),
    "MDF 4": ("mf4", lambda path: write_mdf(path, PLAIN)),
    "MDF 3": ("mdf", lambda path: write_mdf(path, PLAIN, "3.30")),
    "TDMS": ("tdms", lambda path: write_tdms(path, {"log": PLAIN})),
    "JSON": ("json", lambda path: write_json(path, PLAIN)),
    "TwinCAT Scope": ("csv", lambda path: write_scope(path, PLAIN)),
    "TwinCAT Scope, English": ("csv", lambda path: write_scope(path, PLAIN, ";", ".")),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_the_same_numbers_come_out_of_every_format(tmp_path: Path, kind: str) -> None:
    suffix, write = WRITERS[kind]
    recording = read_recording(write(tmp_path / f"recording.{suffix}"))
    np.testing.assert_allclose(recording.time_s, TIME, rtol=1e-15)  # some formats count in ms
    np.testing.assert_array_equal(recording.motor_speed_rpm, SPEED)
    assert recording.source is not None
    assert recording.source.unused_columns == ("note",)
    assert recording.excluded is None


@pytest.mark.parametrize("kind", WRITERS)
def test_columns_are_mapped_in_every_format(tmp_path: Path, kind: str) -> None:
    suffix, write = WRITERS[kind]
    columns = {
        "time_s": ColumnSpec("note", "ms"),
        "motor_speed_rpm": ColumnSpec("motor_speed_rpm", "rad/s"),
    }
    recording = read_recording(write(tmp_path / f"recording.{suffix}"), columns=columns)
    np.testing.assert_allclose(recording.time_s, TIME, atol=1e-12)
    np.testing.assert_allclose(recording.motor_speed_rpm, SPEED * 30.0 / np.pi, rtol=1e-12)


def iso(dates: np.ndarray, suffix: str = "") -> list[str]:
    return [str(date) + suffix for date in dates.astype("datetime64[us]")]


TIMES: dict[str, tuple[str, Callable[[Path], Path], str | None]] = {
    "ISO text": ("csv", lambda p: write_csv(p, PLAIN | {"time_s": iso(DATES)}), None),
    "ISO text, UTC": ("csv", lambda p: write_csv(p, PLAIN | {"time_s": iso(DATES, "Z")}), None),
    "ISO text, declared": (
        "csv",
        lambda p: write_csv(p, PLAIN | {"time_s": iso(DATES)}),
        "datetime",
    ),
    "calendar time in NetCDF": (
        "nc",
        lambda p: write_netcdf(p, PLAIN | {"time_s": DATES}),
        None,
    ),
    "calendar time in Parquet": (
        "parquet",
        lambda p: write_parquet(p, PLAIN | {"time_s": DATES}),
        None,
    ),
    "calendar time with a zone in Parquet": (
        "parquet",
        lambda p: write_parquet(
            p, PLAIN | {"time_s": pd.DatetimeIndex(DATES).tz_localize("Europe/Berlin")}
        ),
        None,
    ),
    "ISO text in Parquet": (
        "parquet",
        lambda p: write_parquet(p, PLAIN | {"time_s": iso(DATES)}),
        None,
    ),
    "ISO text in a MATLAB cell array": (
        "mat",
        lambda p: write_mat5(p, PLAIN | {"time_s": np.array(iso(DATES), dtype=object)}),
        None,
    ),
    "MATLAB datenum": (
        "mat",
        lambda p: write_mat5(p, PLAIN | {"time_s": 740042.5 + TIME / 86400.0}),
        "datenum",
    ),
    "milliseconds": ("csv", lambda p: write_csv(p, PLAIN | {"time_s": 1e3 * TIME}), "ms"),
    "milliseconds, stated in NetCDF": (
        "nc",
        lambda p: write_netcdf(p, PLAIN | {"time_s": 1e3 * TIME}, time_s="milliseconds"),
        None,
    ),
    "microseconds as whole numbers": (
        "parquet",
        lambda p: write_parquet(p, PLAIN | {"time_s": (1e6 * TIME).round().astype(np.int64)}),
        "us",
    ),
    "seconds since 1970": (
        "csv",
        lambda p: write_csv(p, PLAIN | {"time_s": 1772366400.0 + TIME}),
        None,
    ),
}


@pytest.mark.parametrize("kind", TIMES)
def test_time_comes_out_in_seconds_however_it_is_told(tmp_path: Path, kind: str) -> None:
    suffix, write, unit = TIMES[kind]
    columns = {} if unit is None else {"time_s": ColumnSpec("time_s", unit)}
    recording = read_recording(write(tmp_path / f"recording.{suffix}"), columns=columns)
    # A datenum resolves 1e-10 days, 10 µs.
    np.testing.assert_allclose(recording.time_s, TIME, atol=1.2e-5)
    np.testing.assert_array_equal(recording.motor_speed_rpm, SPEED)


def test_a_unit_that_the_file_states_is_used_and_the_users_goes_before(tmp_path: Path) -> None:
    path = write_netcdf(tmp_path / "recording.nc", PLAIN, motor_speed_rpm="rad/s", time_s="seconds")
    stated = read_recording(path)
    np.testing.assert_allclose(stated.motor_speed_rpm, SPEED * 30.0 / np.pi, rtol=1e-12)
    mine = read_recording(path, columns={"motor_speed_rpm": ColumnSpec("motor_speed_rpm", "1 rpm")})
    np.testing.assert_array_equal(mine.motor_speed_rpm, SPEED)
    with pytest.raises(RecordingError, match="different units"):
        read_recording(path, columns={"motor_speed_rpm": ColumnSpec("motor_speed_rpm", "rpm")})


def test_matrices_and_structures_are_named_as_matlab_names_them(tmp_path: Path) -> None:
    variables = {"data": np.column_stack([TIME, SPEED]), "rec": {"i": {"q": SPEED}}}
    columns = {
        "time_s": ColumnSpec("data(:,1)"),
        "motor_speed_rpm": ColumnSpec("data(:,2)"),
        "motor_current_a": ColumnSpec("rec.i.q"),
    }
    for path in (
        write_mat5(tmp_path / "five.mat", variables),
        write_mat73(tmp_path / "seven.mat", variables | {"data": variables["data"].T}),
    ):
        recording = read_recording(path, columns=columns)
        np.testing.assert_array_equal(recording.motor_speed_rpm, SPEED)
        np.testing.assert_array_equal(recording.channels["motor_current_a"], SPEED)


JOINTS = {
    "joint_1": {"position": TIME, "velocity": -SPEED, "effort": TIME},
    "joint_2": {"position": 2.0 * TIME, "velocity": SPEED, "effort": -TIME},
}
SEVERAL_JOINTS: dict[str, tuple[str, Callable[[Path], Path]]] = {
    "MCAP": ("mcap", lambda path: write_bag(path, JOINTS, TIME)),
    "ROS 2, SQLite": ("db3", lambda path: write_bag(path, JOINTS, TIME)),
    "ROS 1": ("bag", lambda path: write_bag(path, JOINTS, TIME)),
    "TDMS, a group each": (
        "tdms",
        lambda path: write_tdms(
            path, JOINTS, wf_increment=0.001, wf_start_offset=0.0, unit_string="rad/s"
        ),
    ),
}


ALL = WRITERS | SEVERAL_JOINTS


@pytest.mark.parametrize("kind", SEVERAL_JOINTS)
def test_one_joint_of_several_in_a_file_is_chosen_by_name_with_its_unit_and_its_clock(
    tmp_path: Path, kind: str
) -> None:
    suffix, write = SEVERAL_JOINTS[kind]
    path = write(tmp_path / f"recording.{suffix}")
    recording = read_recording(path, columns={"motor_speed_rpm": ColumnSpec("joint_2/velocity")})
    np.testing.assert_allclose(recording.time_s, TIME, rtol=1e-15)
    np.testing.assert_array_equal(recording.motor_speed_rpm, SPEED * RPM_PER_RAD_PER_S)
    mixed = {
        "motor_speed_rpm": ColumnSpec("joint_2/velocity"),
        "reference_speed_rpm": ColumnSpec("joint_1/velocity"),
    }
    with pytest.raises(RecordingError, match="not sampled together"):
        read_recording(path, columns=mixed)


def test_columns_of_a_file_with_several_joints_are_guessed_for_the_one_that_is_asked_for(
    tmp_path: Path,
) -> None:
    path = write_bag(tmp_path / "bag.mcap", JOINTS, TIME)
    with pytest.raises(RecordingError, match=r"several joints.*joint_1, joint_2.*--joint joint_1"):
        guess_columns(read_table(path))
    with pytest.raises(RecordingError, match=r"no such joint.*joint_3.*joint_1, joint_2"):
        guess_columns(read_table(path), "joint_3")
    guess = guess_columns(read_table(path), "joint_2")
    assert {column.channel: (column.name, column.unit) for column in guess.columns} == {
        "time_s": ("joint_2/time_s", "s"),
        "motor_speed_rpm": ("joint_2/velocity", "rad/s"),
        "motor_position_rad": ("joint_2/position", "rad"),
        "motor_torque_nm": ("joint_2/effort", "N m"),
    }
    slow = {"axis": {"position": TIME, "velocity": SPEED / 1e4, "effort": TIME}}
    path = write_bag(tmp_path / "slow.mcap", slow, TIME)
    speed = guess_columns(read_table(path)).columns[1]
    assert "behind the gearbox" in speed.reason
    assert speed.is_open
    sides = {"t": TIME, "motor/speed": SPEED, "ref/speed": SPEED, "load/angle": TIME}
    path = write_csv(tmp_path / "sides.csv", sides)
    found = {column.channel for column in guess_columns(read_table(path)).columns}
    assert found == {"time_s", "motor_speed_rpm", "reference_speed_rpm", "load_position_rad"}
    plain = write_csv(tmp_path / "log.csv", {"t": TIME, "axis 1/speed [rad/s]": SPEED})
    assert guess_columns(read_table(plain)).columns[1].name == "axis 1/speed [rad/s]"


def test_a_bag_without_stamps_is_read_by_the_time_of_recording_only_if_that_is_asked_for(
    tmp_path: Path,
) -> None:
    path = write_bag(tmp_path / "bag.mcap", JOINTS, TIME, stamped=False)
    speed = {"motor_speed_rpm": ColumnSpec("joint_2/velocity")}
    with pytest.raises(RecordingError, match='"time_s" is missing'):
        read_recording(path, columns=speed)
    asked = read_recording(path, columns=speed | {"time_s": ColumnSpec("joint_2/received_s")})
    np.testing.assert_array_equal(asked.time_s, TIME)


def test_units_of_mdf_are_used_and_a_packed_file_is_the_same(tmp_path: Path) -> None:
    path = write_mdf(tmp_path / "log.mf4", PLAIN, motor_speed_rpm="rad/s")
    packed = tmp_path / "log.mf4.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    for file in (path, packed):
        speed = read_recording(file).motor_speed_rpm
        np.testing.assert_array_equal(speed, SPEED * RPM_PER_RAD_PER_S)


@pytest.mark.parametrize(("suffix", "version"), [("mf4", "4.10"), ("mdf", "3.30")])
def test_a_formula_in_an_mdf_file_is_not_run(tmp_path: Path, suffix: str, version: str) -> None:
    import asammdf

    path = tmp_path / f"log.{suffix}"
    signals = [
        asammdf.Signal(SPEED, TIME, name="linear", conversion={"a": 2.0, "b": 1.0}),
        asammdf.Signal(SPEED, TIME, name="formula", conversion={"formula": "2 * X1"}),
    ]
    with asammdf.MDF(version=version) as file:
        file.append(signals)
        file.save(path)
    table = read_table(path)
    assert table.columns == ("time_s", "linear", "formula")
    np.testing.assert_array_equal(table.numbers(["linear"])[:, 0], 2.0 * SPEED + 1.0)
    with pytest.raises(RecordingError, match=r'column "formula".*values by a formula'):
        table.numbers(["formula"])


def test_a_line_far_down_in_a_workbook_is_refused_at_once(tmp_path: Path) -> None:
    good = write_excel(tmp_path / "good.xlsx", PLAIN)
    path = tmp_path / "far.xlsx"
    with zipfile.ZipFile(good) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            text = old.read(name).replace(b'<row r="9">', b'<row r="999999999999">')
            new.writestr(name, text)
    with pytest.raises(RecordingError, match="too large"):
        read_recording(path)


def test_a_slower_channel_of_a_scope_export_keeps_its_own_times(tmp_path: Path) -> None:
    header = (
        "Name\tA\nStarttime of export\t1\n\nName\tn\tName\tslow\nUnit\trad/s (Speed)\tUnit\tA\n"
    )
    kept = "".join(f"{i}\t{i % 7}\t{2 * i}\t{i}\n" for i in range(20)) + "20\t6\n" * 1
    path = tmp_path / "scope.csv"
    path.write_text(header + "\n" + kept)
    table = read_table(path)
    assert table.columns == ("time_s", "n", "slow")
    assert (table.units["n"], table.units["slow"]) == ("rad/s", "A")
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(table.arrays["slow"]))[:3], [0, 2, 4])
    # Interpolated by Scope: the slow one's samples repeated to fill the lines.
    filled = "".join(f"{i}\t{i % 7}\t{2 * (i // 2)}\t{i // 2}\n" for i in range(40))
    path.write_text(header + "\n" + filled)
    slow = read_table(path).arrays["slow"]
    np.testing.assert_array_equal(slow[np.isfinite(slow)], np.arange(20))


def test_a_channel_of_text_in_a_scope_export_is_left_and_text_among_numbers_refused(
    tmp_path: Path,
) -> None:
    header = "Name\tA\nStarttime of export\t1\n\nName\tn\tName\ton\nData-Type\tREAL64\n\n"
    path = tmp_path / "scope.csv"
    path.write_text(header + "".join(f"{i}\t{i % 7}\t{i}\tTrue\n" for i in range(20)))
    table = read_table(path)
    assert table.columns == ("time_s", "n", "on")
    assert table.numbers(table.columns[:2]).shape == (20, 2)
    path.write_text(path.read_text().replace("\n5\t5\t", "\n5\t5x\t"))
    with pytest.raises(RecordingError, match=r"text in a column of numbers.*'5x'"):
        (table := read_table(path)).numbers(table.columns[:2])


@pytest.mark.parametrize(
    ("library", "kind"),
    [
        ("pyarrow", "Parquet"),
        ("openpyxl", "Excel"),
        ("asammdf", "MDF 4"),
        ("nptdms", "TDMS"),
        ("rosbags", "MCAP"),
    ],
)
def test_a_library_that_is_not_installed_is_named_with_how_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, library: str, kind: str
) -> None:
    suffix, write = ALL[kind]
    path = write(tmp_path / f"recording.{suffix}")
    for module in [name for name in sys.modules if name.startswith(f"{library}.")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(RecordingError, match=rf'(?i){library}.*pip install "bayesbl\[formats\]"'):
        read_recording(path)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("good")
    return {
        kind: write(folder / f"{number}.{suffix}").read_bytes()
        for number, (kind, (suffix, write)) in enumerate(ALL.items())
    }


@pytest.mark.long
@settings(
    max_examples=150, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)
@given(
    kind=st.sampled_from([kind for kind in ALL if kind != "CSV"]),
    place=st.floats(0.0, 1.0),
    replacement=st.binary(min_size=1, max_size=6),
    cut=st.booleans(),
)
def test_damage_to_a_file_of_any_format_never_ends_in_a_traceback(
    tmp_path: Path,
    good: dict[str, bytes],
    kind: str,
    place: float,
    replacement: bytes,
    cut: bool,
) -> None:
    data = good[kind]
    # Headers are short, and the damage that matters is there: the place is not uniform.
    position = int(place**3 * len(data))
    behind = b"" if cut else data[position + len(replacement) :]
    path = tmp_path / f"damaged.{ALL[kind][0]}"
    path.write_bytes(data[:position] + replacement + behind)
    columns = {"motor_speed_rpm": ColumnSpec("joint_2/velocity")} if kind in SEVERAL_JOINTS else {}
    with suppress(UserError):
        assert np.all(np.diff(read_recording(path, columns=columns).time_s) > 0)


NUMBERS = st.one_of(
    st.floats(width=64), st.integers(-3, 40).map(float), st.sampled_from([np.nan, np.inf, 1e308])
)


@pytest.mark.long
@settings(max_examples=200, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    time=st.one_of(
        st.lists(NUMBERS, min_size=1, max_size=40),
        st.lists(st.floats(-1e9, 1e9), min_size=16, max_size=60, unique=True).map(sorted),
        st.sets(st.integers(0, 80), min_size=16).map(lambda s: [1e-3 * i for i in sorted(s)]),
    ),
    speed=st.lists(NUMBERS, min_size=1, max_size=80),
    suffix=st.sampled_from(["nc", "mat", "parquet"]),
)
def test_no_numbers_in_any_format_end_in_a_traceback(
    tmp_path: Path, time: list[float], speed: list[float], suffix: str
) -> None:
    speed = (speed * len(time))[: len(time)]
    columns = {"time_s": np.array(time), "motor_speed_rpm": np.array(speed)}
    path = tmp_path / f"fuzz.{suffix}"
    {"nc": write_netcdf, "mat": write_mat5, "parquet": write_parquet}[suffix](path, columns)
    with suppress(UserError):
        recording = read_recording(path)
        assert np.all(np.diff(recording.time_s) > 0)
        assert np.all(np.isfinite(recording.motor_speed_rpm))


A_FORMAT = """
import io

import numpy as np

from bayesbl.recording.array_table import ArrayTable


def read(data):
    return ArrayTable(dict(np.load(io.BytesIO(data)).items()))
"""


def test_a_module_and_a_row_are_a_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = tmp_path / "modules" / "numpy_columns.py"
    module.parent.mkdir()
    module.write_text(A_FORMAT)
    monkeypatch.syspath_prepend(module.parent)
    path = tmp_path / "joint.own"
    with path.open("wb") as stream:
        np.savez(stream, **{name: np.array(values) for name, values in PLAIN.items()})
    with pytest.raises(RecordingError, match="cannot be read as recordings"):
        read_recording(path)
    added = formats.Format("Own", (".own",), "numpy_columns")
    monkeypatch.setitem(formats.FORMATS, ".own", added)
    np.testing.assert_array_equal(read_recording(path).motor_speed_rpm, SPEED)
    assert "Own" in formats.names()


ABOVE = "Trace V3.2;Achse 2;14.03.2026 08:12:33\nAbtastzeit;1 ms\n\n"
GERMAN = "Zeit [ms];Drehzahlistwert [1/min];Lageistwert [°]\n"
JAPANESE = "時間(s),モータ速度(r/min),速度指令(r/min)\n"


def test_lines_that_a_drive_writes_above_the_header_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "trace.csv"
    body = "".join(f"{i},0;{n:.3f};{0.5 * i}\n".replace(".", ",") for i, n in enumerate(SPEED))
    path.write_bytes((ABOVE + GERMAN + body).encode("latin-1"))
    guess = guess_columns(read_table(path))
    assert [c.channel for c in guess.columns] == ["time_s", "motor_speed_rpm", "motor_position_rad"]
    columns = {c.channel: ColumnSpec(c.name, c.unit) for c in guess.columns}
    recording = read_recording(path, columns=columns)
    assert recording.motor_speed_rpm == pytest.approx(SPEED, abs=5e-4)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp932"])
def test_a_japanese_trace_is_read_in_its_own_encoding(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "trace.csv"
    body = "".join(f"{t:.3f},{n:.3f},2000.0\n" for t, n in zip(TIME, SPEED, strict=True))
    path.write_bytes((JAPANESE + body).encode(encoding))
    guess = guess_columns(read_table(path))
    assert {c.channel: c.name for c in guess.columns} == {
        "time_s": "時間(s)",
        "motor_speed_rpm": "モータ速度(r/min)",
        "reference_speed_rpm": "速度指令(r/min)",
    }


def test_archives_of_numpy_and_signals_of_a_scope_are_columns(tmp_path: Path) -> None:
    t, q = np.linspace(0.0, 1.0, 30), np.arange(30.0)
    np.savez(tmp_path / "a.npz", t=t, q=np.stack([q, 2.0 * q], 1), dt=0.1)
    table = read_table(tmp_path / "a.npz")
    assert table.columns == ("t", "q(:,1)", "q(:,2)")
    np.testing.assert_array_equal(table.numbers(["q(:,2)"])[:, 0], 2.0 * q)
    signals = np.zeros((1, 2), dtype=[("values", "O"), ("label", "O")])
    signals[0, 0], signals[0, 1] = (q[:, None], "theta_m [rad]"), (2.0 * q[:, None], "")
    savemat(tmp_path / "a.mat", {"Scope": {"time": t[:, None], "signals": signals}})
    table = read_table(tmp_path / "a.mat")
    names = ("time", "signals(1).theta_m [rad]", "signals(2).values")
    assert table.columns[:3] == names
    np.testing.assert_array_equal(table.numbers(["signals(2).values"])[:, 0], 2.0 * q)
