"""A corpus of awkward recordings: each read and fitted right, or refused in one clear message."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import BEFORE
from recording_files import write_csv, write_mat5, write_netcdf, write_parquet

from bayesbl import cli
from bayesbl.recording.channels import ColumnSpec
from bayesbl.recording.readers import read_recording
from bayesbl.ringing.estimator import Estimator, PointEstimate

SAMPLES = 8280  # 2.3 rotations
TIME, SPEED, POSITION, CURRENT = (
    "time_s",
    "motor_speed_rpm",
    "motor_position_rad",
    "motor_current_a",
)
Table = dict[str, Any]
RPM = 30.0 / np.pi


@cache
def _whole() -> Table:
    names = BEFORE.open().readline().strip().split(",")
    return dict(zip(names, np.loadtxt(BEFORE, delimiter=",", skiprows=1).T, strict=True))


def plain(first: int = 0, samples: int = SAMPLES) -> Table:
    return {name: values[first : first + samples].copy() for name, values in _whole().items()}


def speed_only(table: Table) -> Table:
    return {TIME: table[TIME], SPEED: table[SPEED]}


def changed(table: Table, **columns: Any) -> Table:
    return {**table, **columns}


def without(table: Table, rows: Any) -> Table:
    return {name: np.delete(values, rows) for name, values in table.items()}


def with_values(table: Table, name: str, rows: Any, value: float) -> Table:
    values = table[name].copy()
    values[rows] = value
    return {**table, name: values}


def random_rows(share: float) -> np.ndarray:
    generator = np.random.default_rng(1)
    return np.flatnonzero(generator.uniform(size=SAMPLES - 2) < share) + 1


def jittered(table: Table, periods: float) -> Table:
    noise = 1e-3 * np.random.default_rng(2).uniform(-periods, periods, SAMPLES)
    return changed(table, time_s=table[TIME] + noise)


def dates(table: Table) -> list[str]:
    start = np.datetime64("2026-03-01T12:00:00", "us")
    return [f"{t}Z" for t in start + (1e6 * table[TIME]).round().astype("timedelta64[us]")]


@pytest.fixture(scope="module")
def reference() -> PointEstimate:
    return fitted(read_recording(BEFORE), slice(0, SAMPLES))


def fitted(recording: Any, part: slice | None = None) -> PointEstimate:
    from dataclasses import replace

    if part is not None:
        channels = {name: values[part] for name, values in recording.channels.items()}
        recording = replace(recording, time_s=recording.time_s[part], channels=channels)
    return Estimator().estimate(recording, np.random.SeedSequence(1))


def sent_twice() -> Table:
    """Every 50th row once more, three rows later."""
    rows = np.insert(np.arange(SAMPLES), np.arange(53, SAMPLES, 50), np.arange(50, SAMPLES - 3, 50))
    return {name: values[rows] for name, values in plain().items()}


def exchanged() -> np.ndarray:
    rows = np.arange(SAMPLES)
    rows[[700, 701]] = rows[[701, 700]]
    return rows


MS = {TIME: ColumnSpec(TIME, "ms")}

# What was done to the recording; how many samples the fit must leave out; the columns' mapping.
FITTED: dict[str, tuple[Callable[[Path], Path], int, dict[str, ColumnSpec]]] = {
    "one line in a hundred lost": (
        lambda p: write_csv(p / "a.csv", without(plain(), random_rows(0.01))),
        len(random_rows(0.01)),
        {},
    ),
    "one value in a hundred NaN": (
        lambda p: write_csv(p / "a.csv", with_values(plain(), SPEED, random_rows(0.01), np.nan)),
        len(random_rows(0.01)),
        {},
    ),
    "one value in a hundred infinite, Parquet": (
        lambda p: write_parquet(
            p / "a.parquet", with_values(plain(), SPEED, random_rows(0.01), np.inf)
        ),
        len(random_rows(0.01)),
        {},
    ),
    "a value of the current missing": (
        lambda p: write_csv(p / "a.csv", with_values(plain(), CURRENT, 4000, np.nan)),
        1,
        {},
    ),
    "90 ms lost": (
        lambda p: write_csv(p / "a.csv", without(plain(), slice(3000, 3090))),
        90,
        {},
    ),
    "90 ms of NaN, NetCDF": (
        lambda p: write_netcdf(p / "a.nc", with_values(plain(), SPEED, slice(3000, 3090), np.nan)),
        90,
        {},
    ),
    "time stamps missing": (
        lambda p: write_csv(p / "a.csv", with_values(plain(), TIME, [100, 200, 201], np.nan)),
        3,
        {},
    ),
    "a sample twice": (
        lambda p: write_csv(p / "a.csv", {k: np.insert(v, 10, v[10]) for k, v in plain().items()}),
        0,
        {},
    ),
    "a sample in 50 sent twice, and late": (lambda p: write_csv(p / "a.csv", sent_twice()), 0, {}),
    "the file twice": (
        lambda p: write_csv(p / "a.csv", {k: np.concatenate([v, v]) for k, v in plain().items()}),
        0,
        {},
    ),
    "two rows exchanged": (
        lambda p: write_csv(p / "a.csv", {k: v[exchanged()] for k, v in plain().items()}),
        0,
        {},
    ),
    "a counter of 16 bits in ms": (
        lambda p: write_csv(
            p / "a.csv", changed(plain(), time_s=(60000 + 1e3 * plain()[TIME]).round() % 65536)
        ),
        0,
        MS,
    ),
    "a clock that ticks in 10 ms": (
        lambda p: write_csv(p / "a.csv", changed(plain(), time_s=0.01 * (plain()[TIME] // 0.01))),
        0,
        {},
    ),
    "time as floats of 32 bits": (
        lambda p: write_csv(
            p / "a.csv", changed(plain(), time_s=(20000.0 + plain()[TIME]).astype(np.float32))
        ),
        0,
        {},
    ),
    "a position that begins again at each turn": (
        lambda p: write_csv(
            p / "a.csv", changed(plain(), motor_position_rad=plain()[POSITION] % (2.0 * np.pi))
        ),
        0,
        {},
    ),
    "time jitters by 0.3 of a period": (
        lambda p: write_csv(p / "a.csv", jittered(plain(), 0.3)),
        0,
        {},
    ),
    "lines lost and time jitters": (
        lambda p: write_csv(p / "a.csv", without(jittered(plain(), 0.2), [700, 5000, 5001])),
        3,
        {},
    ),
    "lines lost and time jitters by 0.3 of a period": (
        lambda p: write_csv(p / "a.csv", without(jittered(plain(), 0.3), random_rows(0.01))),
        len(random_rows(0.01)),
        {},
    ),
    "turning the other way": (
        lambda p: write_csv(p / "a.csv", {k: v if k == TIME else -v for k, v in plain().items()}),
        0,
        {},
    ),
    "dropouts to zero": (
        lambda p: write_csv(
            p / "a.csv", with_values(speed_only(plain()), SPEED, random_rows(0.005), 0.0)
        ),
        len(random_rows(0.005)),
        {},
    ),
    "a counter that overflows": (
        lambda p: write_csv(
            p / "a.csv", with_values(plain(), SPEED, [50, 51, 52, 3000, 8000], 65535.0)
        ),
        5,
        {},
    ),
    "dropouts to both rails": (
        lambda p: write_csv(
            p / "a.csv",
            with_values(with_values(plain(), SPEED, [9, 700], 0.0), SPEED, [4000], 32767.0),
        ),
        3,
        {},
    ),
    "time in ms, declared": (
        lambda p: write_csv(p / "a.csv", changed(plain(), time_s=1e3 * plain()[TIME])),
        0,
        MS,
    ),
    "dates for time": (
        lambda p: write_csv(p / "a.csv", changed(plain(), time_s=dates(plain()))),
        0,
        {},
    ),
    "seconds since 1970": (
        lambda p: write_csv(p / "a.csv", changed(plain(), time_s=1.77e9 + plain()[TIME])),
        0,
        {},
    ),
    "speed in rad/s, declared, MATLAB": (
        lambda p: write_mat5(p / "a.mat", changed(plain(), motor_speed_rpm=plain()[SPEED] / RPM)),
        0,
        {SPEED: ColumnSpec(SPEED, "rad/s")},
    ),
    "a sensor that wakes up late and sleeps early": (
        lambda p: write_csv(
            p / "a.csv",
            {
                name: np.concatenate([head, values, head])
                for (name, values), head in zip(
                    changed(plain(), time_s=plain()[TIME] + 1.0).items(),
                    [np.full(1, np.nan)] * 4,
                    strict=True,
                )
            },
        ),
        0,
        {},
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("case", FITTED)
def test_what_can_be_handled_is_fitted_right(
    tmp_path: Path, case: str, reference: PointEstimate
) -> None:
    write, left_out, columns = FITTED[case]
    point = fitted(read_recording(write(tmp_path), columns=columns))
    excluded = point.recording.excluded
    assert (0 if excluded is None else int(excluded.sum())) == left_out
    if left_out:
        assert str(left_out) in " ".join(point.recording.notes)
    # Noise and impacts are the same ones, so that far less than the scatter of A is left.
    a, b = point.ringing[0], reference.ringing[0]
    sd = np.sqrt(np.diag(reference.ringing[1]))
    np.testing.assert_array_less(np.abs(a - b), 0.35 * sd)
    assert point.spread.standard_deviations["amplitude_rpm"] == pytest.approx(sd[0], rel=0.1)


@pytest.mark.parametrize("first", [500, 1300, 2100, 2900])
def test_a_recording_may_begin_anywhere_in_a_rotation(
    tmp_path: Path, first: int, reference: PointEstimate
) -> None:
    recording = read_recording(write_csv(tmp_path / "a.csv", plain(first)))
    point = fitted(recording)
    # Other noise and other impacts: independent of the reference to a good part.
    sd = np.hypot(np.sqrt(point.ringing[1][0, 0]), np.sqrt(reference.ringing[1][0, 0]))
    assert abs(point.ringing[0][0] - reference.ringing[0][0]) < 3.0 * sd
    assert point.optimum.symbols["rotation_period_s"] == pytest.approx(3.6, abs=0.02)


def two_speeds(table: Table) -> np.ndarray:
    return np.where(table[TIME] < 5.0, table[SPEED], 0.9 * table[SPEED])


def starting_up(table: Table) -> np.ndarray:
    return np.asarray(table[SPEED] * np.minimum(1.0, table[TIME] / 2.0))


def in_blocks(table: Table) -> np.ndarray:
    return np.asarray(table[SPEED] + 60.0 * ((table[TIME] // 2.0) % 2))


# What was done to the recording, and what the message must name.
REFUSED: dict[str, tuple[Callable[[Path], Path], str, str, str]] = {
    "half a second lost": (
        lambda p: write_csv(p / "a.csv", without(plain(), slice(3000, 3500))),
        'after line 3001, column "time_s"',
        "nothing for 0.501 s",
        "at most 0.1 s",
    ),
    "half a second of NaN": (
        lambda p: write_csv(p / "a.csv", with_values(plain(), SPEED, slice(3000, 3500), np.nan)),
        'after line 3001, column "motor_speed_rpm"',
        "nothing for 0.501 s",
        "at most 0.1 s",
    ),
    "a tenth of the values missing, Parquet": (
        lambda p: write_parquet(
            p / "a.parquet", with_values(plain(), CURRENT, random_rows(0.1), np.nan)
        ),
        'column "motor_current_a"',
        f"{len(random_rows(0.1))} of 8280 samples",
        "at most 5 %",
    ),
    "a tenth of the lines lost": (
        lambda p: write_csv(p / "a.csv", without(plain(), random_rows(0.1))),
        'column "time_s"',
        "of 8280 samples",
        "at most 5 %",
    ),
    "a column of NaN, NetCDF": (
        lambda p: write_netcdf(p / "a.nc", with_values(plain(), CURRENT, slice(None), np.nan)),
        'column "motor_current_a"',
        "all 8280 samples",
        "a finite number",
    ),
    "time jitters by three periods": (
        lambda p: write_csv(
            p / "a.csv",
            changed(plain(), time_s=np.sort(jittered(plain(), 3.0)[TIME])),
        ),
        "time_s near",
        "the longest step",
        "at most",
    ),
    "time runs backwards": (
        lambda p: write_csv(p / "a.csv", with_values(plain(), TIME, 99, 0.0)),
        'line 101, column "time_s"',
        "0 after 0.098",
        "increases",
    ),
    "two files in one": (
        lambda p: write_csv(
            p / "a.csv",
            {
                name: np.concatenate([v[:4000], v[4000:8000] - (4.0 if name == TIME else 0.0)])
                for name, v in plain().items()
            },
        ),
        'line 4002, column "time_s"',
        "0 after 3.999",
        "increases",
    ),
    "time in ms, not declared": (
        lambda p: write_csv(p / "a.csv", changed(plain(), time_s=1e3 * plain()[TIME])),
        "looks like ms, not s",
        "1 Hz",
        "at least 50 Hz",
    ),
    "speed in rad/s, not declared": (
        lambda p: write_csv(p / "a.csv", changed(plain(), motor_speed_rpm=plain()[SPEED] / RPM)),
        "motor_speed_rpm looks like rad/s, not rpm",
        "a mean speed of 209",
        "under [columns]",
    ),
    "position in degrees, not declared, MATLAB": (
        lambda p: write_mat5(
            p / "a.mat", changed(plain(), motor_position_rad=np.degrees(plain()[POSITION]))
        ),
        "motor_position_rad looks like deg, not rad",
        "114",
        "under [columns]",
    ),
    "speed beside a reference in another unit": (
        lambda p: write_csv(
            p / "a.csv",
            changed(
                speed_only(plain()),
                motor_speed_rpm=plain()[SPEED] / RPM,
                reference_speed_rpm=np.full(SAMPLES, 2000.0),
            ),
        ),
        "motor_speed_rpm looks like rad/s, not rpm",
        "2000 rpm",
        "under [columns]",
    ),
    "peaks cut off": (
        lambda p: write_csv(
            p / "a.csv", changed(plain(), motor_speed_rpm=np.minimum(plain()[SPEED], 2022.0))
        ),
        "motor_speed_rpm from",
        "at the largest value, 2022",
        "cut the file to a part that stays inside it",
    ),
    "a sensor that stands still for a second": (
        lambda p: write_csv(
            p / "a.csv", with_values(speed_only(plain()), SPEED, slice(4000, 5000), 0.0)
        ),
        'after line 4001, column "time_s"',
        "nothing for 1.001 s",
        "at most 0.1 s",
    ),
    "two speeds": (
        lambda p: write_csv(
            p / "a.csv", changed(speed_only(plain()), motor_speed_rpm=two_speeds(plain()))
        ),
        "near 5 s",
        "rpm from 0 to 5 s",
        "one recording per speed",
    ),
    "a machine that starts up": (
        lambda p: write_csv(
            p / "a.csv", changed(speed_only(plain()), motor_speed_rpm=starting_up(plain()))
        ),
        "motor_speed_rpm from 0 to",
        "rpm for most of the recording",
        "split the file",
    ),
    "a speed that goes to and fro": (
        lambda p: write_csv(
            p / "a.csv", changed(speed_only(plain()), motor_speed_rpm=in_blocks(plain()))
        ),
        "motor_speed_rpm near",
        "rpm from 0 to",
        "split the file",
    ),
    "a speed that drifts": (
        lambda p: write_csv(
            p / "a.csv",
            changed(
                speed_only(plain(samples=18000)),
                motor_speed_rpm=plain(samples=18000)[SPEED] + np.linspace(0.0, 40.0, 18000),
            ),
        ),
        "motor_speed_rpm from 0 to 18 s: The speed drifts",
        "to 2040.1 rpm (2 %)",
        "one speed for two rotations",
    ),
    "a motor at rest": (
        lambda p: write_csv(
            p / "a.csv",
            changed(
                speed_only(plain()),
                motor_speed_rpm=0.1 * np.random.default_rng(1).standard_normal(SAMPLES),
            ),
        ),
        "The motor does not turn",
        "rpm in means over 0.25 s",
        "is the speed in rpm?",
    ),
    "a constant speed": (
        lambda p: write_csv(p / "a.csv", with_values(speed_only(plain()), SPEED, slice(None), 2e3)),
        "motor_speed_rpm",
        "2000 in all",
        "remove its line",
    ),
    "one rotation": (
        lambda p: write_csv(p / "a.csv", plain(samples=3700)),
        "too few rotations",
        "1.03 rotations",
        "at least 2",
    ),
    "40 Hz": (
        lambda p: write_csv(p / "a.csv", {k: v[::25] for k, v in _whole().items()}),
        "too low",
        "40 Hz",
        "at least 50 Hz",
    ),
    "dates and then none": (
        lambda p: write_csv(
            p / "a.csv", changed(plain(), time_s=[*dates(plain())[:-1], "the end"])
        ),
        'line 8281, column "time_s"',
        "'the end'",
        "a date with a time",
    ),
    "text for speed, Parquet": (
        lambda p: write_parquet(p / "a.parquet", {TIME: np.arange(20.0), SPEED: ["fast"] * 20}),
        'sample 1, column "motor_speed_rpm"',
        "'fast'",
        "a number",
    ),
    "complex speed, MATLAB": (
        lambda p: write_mat5(p / "a.mat", {TIME: np.arange(20.0), SPEED: 1j + np.arange(20)}),
        'column "motor_speed_rpm"',
        "complex",
        "real numbers",
    ),
    "lengths that differ, MATLAB": (
        lambda p: write_mat5(p / "a.mat", {TIME: np.arange(20.0), SPEED: np.arange(21.0)}),
        '"time_s", "motor_speed_rpm"',
        "20 and 21",
        "one value",
    ),
    "no vector, MATLAB": (
        lambda p: write_mat5(p / "a.mat", {"x": np.zeros((3, 3, 3))}),
        "no vector",
        '"x"',
        "a vector for each channel",
    ),
    "a unit nobody knows, NetCDF": (
        lambda p: write_netcdf(p / "a.nc", speed_only(plain()), motor_speed_rpm="furlong"),
        'column "motor_speed_rpm"',
        '"furlong"',
        "under [columns]",
    ),
    "a CSV file called .mat": (
        lambda p: write_csv(p / "a.mat", plain(samples=50)),
        "cannot be read as MATLAB",
        "",
        "a whole MATLAB file",
    ),
    "a CSV file called .parquet": (
        lambda p: write_csv(p / "a.parquet", plain(samples=50)),
        "cannot be read as Parquet",
        "",
        "a whole Parquet file",
    ),
    "a CSV file called .nc": (
        lambda p: write_csv(p / "a.nc", plain(samples=50)),
        "cannot be read as NetCDF",
        "",
        "a whole NetCDF file",
    ),
    "an HDF5 file of no use": (
        lambda p: write_netcdf(p / "a.nc", {"x": np.arange(20.0)}),
        'column "time_s" is missing',
        '"x"',
        'a column "time_s"',
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_is_refused_in_one_message_with_status_2(
    tmp_path: Path, case: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write, place, found, expected = REFUSED[case]
    path = write(tmp_path)
    output = tmp_path / "out"
    options = ["--gear-ratio", "120", "--out", str(output)]
    assert cli.status(["fit", str(path), *options]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    assert printed.err.startswith(f"Error: {path}")
    for part in (place, "Found: ", found, "Expected: ", expected):
        assert part in printed.err
    assert not output.exists()


def test_a_speed_that_is_not_the_one_asked_for_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    slow = changed(speed_only(plain()), motor_speed_rpm=plain()[SPEED] / RPM)
    write_csv(tmp_path / "a.csv", slow)
    config = tmp_path / "fit.toml"
    config.write_text(
        'schema = 1\nkind = "fit"\n[[recordings]]\nfile = "a.csv"\nreference_speed_rpm = 2000\n'
    )
    assert cli.status(["check", str(config)]) == 2
    assert "motor_speed_rpm looks like rad/s, not rpm" in capsys.readouterr().err
