"""Reading recordings: what must come through unchanged, and what must be refused in words."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from places import BEFORE

from bayesbl.errors import RecordingError, UserError
from bayesbl.recording.channels import ColumnSpec
from bayesbl.recording.readers import read_recording

TIME = np.arange(40) * 0.001
SPEED = 2000.0 + np.sin(TIME * 300.0)


def csv_text(
    header: str = "time_s,motor_speed_rpm", *, separator: str = ",", end: str = "\n"
) -> str:
    rows = [f"{t:.4f}{separator}{v:.6f}" for t, v in zip(TIME, SPEED, strict=True)]
    return end.join([header, *rows]) + end


def lines_with(line: int, text: str) -> str:
    """The plain file, with one line (counted from 1) replaced."""
    lines = csv_text().splitlines()
    lines[line - 1] = text
    return "\n".join(lines) + "\n"


def write(folder: Path, content: str | bytes, name: str = "recording.csv") -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_the_example_recording_is_read_whole() -> None:
    recording = read_recording(BEFORE)
    assert recording.name == "wear_before"
    assert recording.samples == 18001
    assert set(recording.channels) == {
        "motor_speed_rpm",
        "motor_position_rad",
        "motor_current_a",
    }
    assert recording.source is not None
    assert recording.source.sha256 == hashlib.sha256(BEFORE.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    "content",
    [
        csv_text(end="\r\n"),
        csv_text(end="\r"),
        b"\xef\xbb\xbf" + csv_text().encode(),
        csv_text().encode("utf-16"),
        csv_text('"time_s" , "motor_speed_rpm"'),
        csv_text("  time_s ,motor_speed_rpm "),
        csv_text("time_s;motor_speed_rpm", separator=";"),
        csv_text("time_s\tmotor_speed_rpm", separator="\t"),
        csv_text("time_s;motor_speed_rpm", separator=";").replace(".", ","),
        csv_text() + "\n  \n,\n\n",
        "\n\n" + csv_text(),
        csv_text(separator=" , "),
        csv_text(end=",\n"),
        csv_text("time_s,motor_speed_rpm,note", end=",ok\n").replace("note,ok", "note"),
        "\n".join(
            ["time_s,motor_speed_rpm"]
            + [f'"{t:.4f}","{v:.6f}"' for t, v in zip(TIME, SPEED, strict=True)]
        ),
    ],
    ids=[
        "CRLF",
        "CR",
        "byte order mark",
        "UTF-16",
        "quoted header",
        "spaces in the header",
        "semicolons",
        "tabs",
        "decimal commas",
        "blank lines at the end",
        "blank lines before the header",
        "spaces around numbers",
        "a separator too many in each line",
        "a column of text that nobody asked for",
        "quoted numbers",
    ],
)
def test_the_same_numbers_come_out_however_the_csv_is_written(
    tmp_path: Path, content: str | bytes
) -> None:
    recording = read_recording(write(tmp_path, content))
    np.testing.assert_allclose(recording.time_s, TIME, atol=1e-12)
    np.testing.assert_allclose(recording.motor_speed_rpm, SPEED, atol=1e-6)


def test_decimal_commas_and_decimal_points_are_never_mixed_up(tmp_path: Path) -> None:
    good = csv_text("time_s;motor_speed_rpm", separator=";")
    grouped = read_recording(write(tmp_path, good.replace("2000.", "2,000.")))
    np.testing.assert_allclose(grouped.motor_speed_rpm, SPEED, atol=1e-6)
    for old, new in ((";2000.", ";2000,"), ("0.0010;", "0,0010;")):
        text = good.replace(old, new, 1)
        with pytest.raises(RecordingError, match=r"line \d+, column.*text in a column"):
            read_recording(write(tmp_path, text))


def test_columns_are_renamed_and_converted_to_the_units_of_their_channels(tmp_path: Path) -> None:
    text = csv_text("t [ms],Speed,motor_current_a", end=",1.5\n").replace(
        "motor_current_a,1.5", "motor_current_a"
    )
    columns = {
        "time_s": ColumnSpec("t [ms]", "ms"),
        "motor_speed_rpm": ColumnSpec("Speed", "rad/s"),
    }
    recording = read_recording(write(tmp_path, text), columns=columns, name="first")
    np.testing.assert_allclose(recording.time_s, TIME / 1000.0, atol=1e-9)
    np.testing.assert_allclose(recording.motor_speed_rpm, SPEED * 30.0 / np.pi, atol=1e-4)
    assert recording.channels["motor_current_a"][0] == 1.5
    assert recording.name == "first"


def test_a_reversed_column_changes_its_sign(tmp_path: Path) -> None:
    file = write(tmp_path, csv_text("time_s,Speed"))
    forwards, backwards = (
        read_recording(file, columns={"motor_speed_rpm": ColumnSpec("Speed", "rad/s", is_reversed)})
        for is_reversed in (False, True)
    )
    np.testing.assert_array_equal(backwards.motor_speed_rpm, -forwards.motor_speed_rpm)


def test_columns_that_nobody_asked_for_are_listed(tmp_path: Path) -> None:
    text = csv_text("time_s,motor_speed_rpm,humidity", end=",40\n").replace(
        "humidity,40", "humidity"
    )
    source = read_recording(write(tmp_path, text)).source
    assert source is not None
    assert source.unused_columns == ("humidity",)


def test_a_mapped_column_takes_the_place_of_one_with_the_channels_name(tmp_path: Path) -> None:
    text = csv_text("time_s,raw,motor_speed_rpm", end=",7\n").replace("_rpm,7", "_rpm")
    recording = read_recording(
        write(tmp_path, text), columns={"motor_speed_rpm": ColumnSpec("raw")}
    )
    np.testing.assert_allclose(recording.motor_speed_rpm, SPEED, atol=1e-6)


BAD_FILES = {
    "empty file": ("", "empty", None, None),
    "blank file": (" \n\n", "empty", None, None),
    "header only": ("time_s,motor_speed_rpm\n", "no sample", None, "a header only"),
    "binary": (b"\x89PNG\r\n\x1a\n\x00\x00,", "not a CSV", None, "binary data"),
    "prose": ("Dear colleague\nthe data follow\n", "not a CSV", None, "no lines with a number"),
    "no header": (csv_text("0.0,2000.0"), "is missing", "header", '"column 1", "column 2"'),
    "same name twice": (
        csv_text("time_s,time_s"),
        'column "time_s" is missing',
        "header",
        '"time_s (1)", "time_s (2)"',
    ),
    "time missing": (
        csv_text("tims_s,motor_speed_rpm"),
        'column "time_s" is missing. Did you mean "tims_s"?',
        "header",
        '"tims_s", "motor_speed_rpm"',
    ),
    "no channel": (csv_text("time_s,b"), "known name", "header", '"time_s", "b"'),
    "text among numbers": (
        lines_with(17, "0.0150,1995 or so"),
        "There is text",
        'line 17, column "motor_speed_rpm"',
        "'1995 or so'",
    ),
    "thousands with underscores": (
        lines_with(3, "0.001,2_000"),
        "There is text",
        'line 3, column "motor_speed_rpm"',
        "'2_000'",
    ),
    "decimal commas between commas": (
        csv_text().replace(".", ","),
        "one cell for each column",
        "line 2",
        "4 cells",
    ),
    "NaN everywhere": (
        "time_s,motor_speed_rpm\n" + "".join(f"{t:.3f},nan\n" for t in TIME),
        "holds no number",
        'column "motor_speed_rpm"',
        "all 40 samples",
    ),
    "time runs backwards": (
        lines_with(12, "0.0085,2000"),
        "Time runs backwards",
        'line 12, column "time_s"',
        "0.0085 after 0.009",
    ),
    "time does not advance": (
        lines_with(12, "0.009,2000"),
        "Time does not advance",
        "line 12",
        "0.009 after 0.009",
    ),
    "too short": (
        "".join(csv_text().splitlines(True)[:6]),
        "too short",
        None,
        "5 samples",
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_file_is_refused_with_place_finding_and_expectation(
    tmp_path: Path, case: str
) -> None:
    content, problem, where, found = BAD_FILES[case]
    path = write(tmp_path, content)
    with pytest.raises(RecordingError) as caught:
        read_recording(path)
    error = caught.value
    assert problem in error.problem
    assert error.file == str(path)
    assert error.expected
    if where is not None:
        assert error.where is not None
        assert error.where.startswith(where)
    if found is not None:
        assert found in str(error.found)


def test_line_numbers_count_blank_lines(tmp_path: Path) -> None:
    text = lines_with(9, "0.007,2_000").replace("\n", "\n\n", 1)
    with pytest.raises(RecordingError, match="line 10,"):
        read_recording(write(tmp_path, text))


def test_a_missing_file_a_folder_and_an_unknown_suffix_are_refused(tmp_path: Path) -> None:
    for path, problem in (
        (tmp_path / "none.csv", "no such file"),
        (tmp_path, "a folder"),
        (write(tmp_path, "x", "notes.docx"), "cannot be read as recordings"),
    ):
        with pytest.raises(RecordingError, match=problem) as caught:
            read_recording(path)
        assert caught.value.file == str(path)
        assert caught.value.expected


def test_a_mapping_to_what_is_not_there_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, csv_text("time_s,Speed"))
    with pytest.raises(RecordingError, match=r'"speed" is missing\. Did you mean "Speed"\?'):
        read_recording(path, columns={"motor_speed_rpm": ColumnSpec("speed")})
    with pytest.raises(RecordingError, match=r'\[columns\] motor_sped_rpm.*"motor_speed_rpm"'):
        read_recording(path, columns={"motor_sped_rpm": ColumnSpec("Speed")})
    with pytest.raises(RecordingError, match=r'Found: "mph"\. Expected: rpm or rad/s'):
        read_recording(path, columns={"motor_speed_rpm": ColumnSpec("Speed", "mph")})


CELLS = st.one_of(
    st.floats(width=64).map(repr),
    st.integers().map(str),
    st.sampled_from(["", "nan", "inf", '"', '"1', "x", " ", "1e400", "0x1p3", "1,5", "−1", "\v"]),
    st.text(max_size=4),
)
TABLES = st.builds(
    lambda separator, end, header, rows: end.join(
        [separator.join(header), *(separator.join(row) for row in rows)]
    ).encode("utf-8", "replace"),
    st.sampled_from([",", ";", "\t"]),
    st.sampled_from(["\n", "\r\n", "\r"]),
    st.sampled_from(
        [["time_s", "motor_speed_rpm"], ["time_s", "x", "motor_current_a"], ["time_s"]]
    ),
    st.lists(st.lists(CELLS, min_size=1, max_size=4), max_size=30),
)


@settings(max_examples=300, deadline=None, suppress_health_check=list(HealthCheck))
@given(content=st.one_of(st.binary(max_size=300), st.text(max_size=300).map(str.encode), TABLES))
@example(content=b",0,0\n,0,0,")
def test_no_file_whatever_its_bytes_ends_in_a_traceback(tmp_path: Path, content: bytes) -> None:
    path = write(tmp_path, content)
    with suppress(UserError):
        assert np.all(np.diff(read_recording(path).time_s) > 0)


@settings(max_examples=100, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    position=st.integers(0, 900),
    replacement=st.binary(min_size=1, max_size=6),
)
def test_damage_anywhere_in_a_good_file_never_ends_in_a_traceback(
    tmp_path: Path, position: int, replacement: bytes
) -> None:
    good = csv_text().encode()
    damaged = good[:position] + replacement + good[position + len(replacement) :]
    with suppress(UserError):
        read_recording(write(tmp_path, damaged))
