"""Mistakes that people make with recordings and limits: each is told, none gives a wrong answer."""

from __future__ import annotations

import math
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from places import AFTER, BEFORE, CONFIGS
from recording_files import write_csv

from bayesbl import cli
from bayesbl.config.bench import load_bench
from bayesbl.config.loading import config_from_options, load_config
from bayesbl.curve.gap_curve import published_curve
from bayesbl.errors import RecordingError, UserError
from bayesbl.matching.observed import observed
from bayesbl.measurement.amplitude_route import reasons_of
from bayesbl.measurement.compatibility import require_plausible_limit
from bayesbl.measurement.curves import curve_from_dataset, curve_group
from bayesbl.measurement.measurement import Reason
from bayesbl.recording.channels import MOTOR_SPEED
from bayesbl.recording.checks import ready_for_fit, require_alive, speed_in_another_unit
from bayesbl.recording.readers import read_recording
from bayesbl.results.store import write_tree


def refused(arguments, capsys, *told: str) -> str:
    """Status 2 and one message that says all of this."""
    assert cli.status([str(argument) for argument in arguments]) == cli.WRONG
    errors = capsys.readouterr().err
    # On a slow machine lines of progress come before.
    errors = errors[max(0, errors.find("Error:")) :]
    assert "Traceback" not in errors
    for text in told:
        assert text in errors
    return errors


def compare_file(folder: Path, joint: str = "", first: str = "", second: str = "") -> Path:
    path = folder / "compare.toml"
    path.write_text(
        f'schema = 1\nkind = "compare"\n[joint]\n{joint}\n'
        f'[[recordings]]\nfile = "{BEFORE}"\n{first}\n[[recordings]]\nfile = "{AFTER}"\n{second}\n'
    )
    return path


# Limits


def test_a_limit_in_mrad_is_refused_with_the_number_that_was_meant(tmp_path, capsys):
    told = ("1200 mrad (68.8°)", "Did you mean 1.2e-3 rad = 1.2 mrad?", "limit_rad")
    refused(["run", compare_file(tmp_path, "limit_rad = 1.2")], capsys, *told)
    refused(["fit", BEFORE, "--limit-rad", "1.2"], capsys, "--limit-rad", *told[:2])
    assert not (tmp_path / "results").exists()


def test_a_limit_as_text_is_told_its_unit(tmp_path, capsys):
    path = compare_file(tmp_path, 'limit_rad = "1.2 mrad"')
    refused(["check", path], capsys, "[joint] limit_rad", "a number in rad")


@pytest.mark.parametrize("factor", [0.09, 0.11, 1.0, 9.0, 11.0])
def test_a_limit_far_from_all_measurable_gaps_is_refused(factor):
    low, high = published_curve().gap_range_rad
    limit = factor * (high if factor > 1.0 else low)
    if 0.1 < factor < 10.0:
        require_plausible_limit(limit, (low, high))
    else:
        with pytest.raises(UserError, match="mrad"):
            require_plausible_limit(limit, (low, high))


# Channels that never change


@pytest.fixture
def dead(tmp_path) -> Path:
    """A recording whose current is the same everywhere."""
    whole = read_recording(BEFORE)
    columns = {"time_s": whole.time_s, "motor_speed_rpm": whole.motor_speed_rpm}
    return write_csv(
        tmp_path / "dead.csv", {**columns, "motor_current_a": np.full(whole.samples, 0.5)}
    )


def direct_file(folder: Path, kind: str, recording: Path) -> Path:
    path = folder / f"{kind}.toml"
    rest = {
        "fit": f'[estimator]\nroute = "direct"\nbench = "{CONFIGS / "bench.toml"}"\n',
        "diagnose": "",
    }
    top = f'bench = "{CONFIGS / "bench.toml"}"\n' if kind == "diagnose" else ""
    path.write_text(
        f'schema = 1\nkind = "{kind}"\n{top}{rest[kind]}[[recordings]]\nfile = "{recording}"\n'
        + ('use = "split"\n' if kind == "diagnose" else "")
    )
    return path


@pytest.mark.parametrize("kind", ["fit", "diagnose"])
@pytest.mark.parametrize("command", ["check", "run"])
def test_a_dead_current_is_refused_where_it_is_used(kind, command, dead, tmp_path, capsys):
    path = direct_file(tmp_path, kind, dead)
    refused(
        [command, path],
        capsys,
        *("dead.csv", "motor_current_a", "never changes", "0.5 in all"),
        "from [columns]",
    )
    assert not (tmp_path / "results").exists()


def test_a_dead_current_is_told_where_it_is_not_used(dead, tmp_path, capsys):
    (note,) = ready_for_fit(read_recording(dead)).notes
    assert "motor_current_a" in note
    assert ready_for_fit(read_recording(BEFORE)).notes == ()
    out = tmp_path / "dead.toml"
    for command in (["init", dead, "--out", out], ["check", out]):
        assert cli.status([str(argument) for argument in command]) == 0
        assert note in capsys.readouterr().out


def test_a_dead_position_is_refused_whatever_the_route(tmp_path):
    whole = read_recording(BEFORE)
    columns = {"time_s": whole.time_s, "motor_speed_rpm": whole.motor_speed_rpm}
    path = write_csv(
        tmp_path / "dead.csv", {**columns, "motor_position_rad": np.zeros(whole.samples)}
    )
    with pytest.raises(RecordingError, match="position never changes"):
        ready_for_fit(read_recording(path), 120.0)
    require_alive(whole, list(whole.channels))


# Dates, copies


def test_dates_on_some_recordings_only_are_refused(tmp_path, capsys):
    path = compare_file(tmp_path, second="date = 2026-03-01")
    refused(["run", path], capsys, "every one needs its date, or none", '"wear_before"')
    path = compare_file(tmp_path, second="repaired = true")
    refused(["run", path], capsys, "[[recordings]] 2", "needs dated recordings")
    for dates in ({}, {"first": "date = 2026-02-01", "second": "date = 2026-03-01"}):
        assert cli.status(["check", str(compare_file(tmp_path, **dates))]) == 0


def test_copies_of_one_recording_are_refused(tmp_path, capsys):
    """No change between them means anything."""
    copy = tmp_path / "friday.csv"
    copy.write_bytes(BEFORE.read_bytes())
    path = compare_file(tmp_path)
    path.write_text(path.read_text().replace(str(AFTER), str(copy)))
    for command in ("check", "run"):
        refused([command, path], capsys, "wear_before and", "are one and the same", "copied")


# Units that were guessed wrong


def slow(recording, factor: float):
    """The recording as if its speed had been in another unit."""
    return replace(recording, channels={MOTOR_SPEED: factor * recording.motor_speed_rpm})


@pytest.mark.parametrize(
    ("factor", "unit"),
    [(math.pi / 30.0, "rad/s"), (30.0 / math.pi, "rpm, not rad/s"), (6.0, "deg/s")],
)
def test_the_unit_is_asked_for_where_another_gives_the_benches_speed(factor, unit):
    measured = read_recording(BEFORE)
    reference = published_curve().reference_speed_rpm
    question = speed_in_another_unit(slow(measured, factor), reference)
    assert unit in question
    assert "2000 rpm" in question
    for other in (1.0, 0.5, 0.2):
        assert speed_in_another_unit(slow(measured, other), reference) is None
    assert speed_in_another_unit(slow(measured, factor), None) is None


def test_the_direct_route_asks_for_the_unit_too():
    bench = load_bench(CONFIGS / "bench.toml")
    with pytest.raises(RecordingError) as refusal:
        observed(slow(read_recording(BEFORE), math.pi / 30.0), bench)
    assert 'unit = "rad/s"' in refusal.value.problem
    # Half the bench's speed is no other unit: the recording's own speed is taken.
    half = observed(slow(read_recording(BEFORE), 0.5), bench)
    assert half.reference_speed_rpm == pytest.approx(1000.0, rel=1e-3)


def test_a_withheld_answer_asks_for_the_unit_before_all_else():
    diagnostics = SimpleNamespace(failures=(), doubts=(), code="sampling")
    point = SimpleNamespace(notes=(), recording=SimpleNamespace(notes=()))
    fit = SimpleNamespace(
        posterior=SimpleNamespace(diagnostics=diagnostics), check=None, point=point
    )
    beyond = SimpleNamespace(notes=(), reasons=(Reason("beyond_curve"),))
    question = Reason.of_text("speed_unit", "Is the unit right?")
    found = reasons_of(fit, beyond, question=question)
    assert [reason.code for reason in found] == ["speed_unit", "beyond_curve"]
    inside = SimpleNamespace(notes=(), reasons=())
    assert not reasons_of(fit, inside, question=question)


@pytest.mark.parametrize("speed_rpm", [2000.0, None])
def test_a_curve_keeps_its_speed_in_its_file(speed_rpm):
    curve = replace(published_curve(draws=10), reference_speed_rpm=speed_rpm)
    stored = curve_group(curve, 0.9, np.random.SeedSequence(1))
    assert curve_from_dataset(stored, "x").reference_speed_rpm == speed_rpm


@pytest.mark.parametrize(
    ("spelling", "unit"),
    [
        *((spelling, "rpm") for spelling in ("U/min", "1/min", "rpm", "min⁻¹")),
        *((spelling, "deg/s") for spelling in ("°/s", "degree/s", "degps")),
        *((spelling, "rad/s") for spelling in ("rad·s⁻¹", "radian/s")),
        ("rps", "rev/s"),
    ],
)
def test_units_have_several_spellings(spelling, unit, tmp_path):
    path = compare_file(tmp_path)
    path.write_text(
        path.read_text() + f'[columns]\nmotor_speed_rpm = {{name = "n", unit = "{spelling}"}}\n'
    )
    assert load_config(path).columns["motor_speed_rpm"].unit == unit


# What to type instead


@pytest.fixture
def foreign(tmp_path, monkeypatch):
    """Two recordings with columns that nobody has described, in the working directory."""
    for name, file in (("monday.csv", BEFORE), ("friday.csv", AFTER)):
        measured = read_recording(file)
        columns = {"Zeit": measured.time_s, "Drehzahl": measured.motor_speed_rpm}
        write_csv(tmp_path / name, columns)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_unknown_columns_lead_to_init_and_leave_nothing(foreign, capsys):
    before = sorted(foreign.iterdir())
    hint = "under [columns] (`bayesbl init monday.csv` writes them"
    refused(["compare", "monday.csv", "friday.csv"], capsys, '"time_s" is missing', hint)
    assert sorted(foreign.iterdir()) == before
    (foreign / "results").mkdir()
    refused(["compare", "monday.csv", "friday.csv"], capsys, hint)
    assert (foreign / "results").is_dir()


def test_init_takes_dates_from_names_where_all_have_one(foreign, capsys):
    names = ["axis3_2026-03-01.csv", "2026-07-31 axis3.csv"]
    for old, new in zip(("monday.csv", "friday.csv"), names, strict=True):
        (foreign / old).rename(foreign / new)
    assert cli.status(["init", *names, "--out", "dated.toml"]) == 0
    days = load_config(foreign / "dated.toml").dates
    assert [day.isoformat() for day in days] == ["2026-03-01", "2026-07-31"]
    (foreign / names[1]).rename(foreign / "2026-02-31.csv")  # no day
    assert cli.status(["init", names[0], "2026-02-31.csv", "--out", "plain.toml"]) == 0
    assert load_config(foreign / "plain.toml").dates is None


def test_problems_that_recordings_share_are_said_once(foreign, capsys):
    for name in ("monday.csv", "friday.csv"):
        write_csv(foreign / name, {"Zeit": np.arange(2000) / 1e3, "Drehzahl": np.full(2000, 1e3)})
    assert cli.status(["init", "monday.csv", "friday.csv"]) == 2
    told = capsys.readouterr().err
    assert told.count("Error:") == 1
    assert "The same applies to" in told


def test_init_says_what_is_still_to_be_filled_in(foreign, capsys):
    assert cli.status(["init", "monday.csv", "friday.csv"]) == 0
    told = capsys.readouterr().out
    for text in ("gear_ratio", "limit (when to repair)", "bayesbl run monday.toml"):
        assert text in told
    assert told.count("no unit found") == 1
    text = (foreign / "monday.toml").read_text()
    filled = re.sub(r"(?m)^# (gear_ratio|limit|decide_before|date|repaired) =", r"\1 =", text)
    (foreign / "filled.toml").write_text(filled)
    config = load_config(foreign / "filled.toml")
    assert config.joint.gear_ratio == 120.0
    assert config.joint.limit.delta_rad() == pytest.approx(1.2e-3)
    assert config.joint.decide_before > config.dates[-1]
    assert all(recording.repaired for recording in config.recordings)
    assert "half the play" in text


def test_commands_to_type_are_quoted(foreign, capsys):
    name = "Mess ung ä.csv"
    (foreign / "monday.csv").rename(foreign / name)
    assert cli.status(["init", name]) == 0
    assert "then: bayesbl run 'Mess ung ä.toml'" in capsys.readouterr().out
    assert "bayesbl run 'Mess ung ä.toml'" in (foreign / "Mess ung ä.toml").read_text()
    refused(["run", name], capsys, f"`bayesbl init '{name}'`")
    refused(["report", name], capsys, f"`bayesbl fit '{name}'`")
    refused(["report", "Mess ung ä.toml"], capsys, "`bayesbl run 'Mess ung ä.toml'`")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["run", "monday.csv"], "bayesbl init monday.csv"),
        (["check", "monday.csv"], "bayesbl init monday.csv"),
        (["report", "monday.csv"], "bayesbl fit monday.csv"),
        (["report", "dates.toml"], "bayesbl run dates.toml"),
        (["run", "dates.toml"], "dates are written 2026-07-01"),
        (["run", "comma.toml"], "decimal point, not a comma"),
        (["fit", "monday.csv", "--limit-rad", "1,2e-3"], "with a decimal point"),
        (["fit", "monday.csv", "--gear-ratio", "120,0"], "with a decimal point"),
        (["fit", "mnday.csv"], 'Did you mean "monday.csv"'),
        (["init", "mnday.csv"], 'Did you mean "monday.csv"'),
        (["run", "date.toml"], 'Did you mean "dates.toml"'),
    ],
)
def test_what_was_meant_is_told(arguments, told, foreign, capsys):
    top = 'schema = 1\nkind = "fit"\n'
    (foreign / "dates.toml").write_text(f"{top}date = 1.7.2026\n")
    (foreign / "comma.toml").write_text(f"{top}[joint]\ngear_ratio = 120,0\n")
    refused(arguments, capsys, told)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ["fit", "monday.csv", "--config", "sweep.toml"],
            'sweep.toml, line 2, kind: This file is of another kind. Found: "sweep" (a bench to '
            'sweep over its gap). Expected: "fit" (one recording to measure) or "compare"',
        ),
        (
            ["fit", "monday.csv", "--route", "direct", "--bench", "sweep.toml"],
            '"sweep" (a bench to sweep over its gap). Expected: "bench" (a virtual bench)',
        ),
        (["simulate", "bench.toml"], 'Found: "bench" (a virtual bench). Expected: a configuration'),
        (["run", "simulte.toml"], "Did you mean \"simulate\"? Found: 'simulte'. Expected: one of"),
        (
            ["fit", "monday.csv", "--route", "direct", "--bench", "friday.csv"],
            "friday.csv: This is a recording, or not a configuration at all. Found: a file ending "
            'in .csv. Expected: a file of kind "bench" (a virtual bench) in TOML.',
        ),
        (["compare", "result.nc", "monday.csv"], "This is a result of bayesbl, not a recording."),
        (["init", "result.nc"], "This is a result of bayesbl, not a recording."),
    ],
)
def test_a_file_of_another_kind_is_told_as_that_and_no_more(arguments, told, foreign, capsys):
    (foreign / "sweep.toml").write_text('schema = 1\nkind = "sweep"\nbench = "bench.toml"\n')
    (foreign / "simulte.toml").write_text('schema = 1\nkind = "simulte"\n')
    shutil.copy(CONFIGS / "bench.toml", foreign)
    write_tree(xr.DataTree(), foreign / "result.nc")
    assert len(refused(arguments, capsys, told).splitlines()) == 1


def test_help_names_the_formats_and_what_the_limit_is(capsys):
    assert cli.status(["compare", "--help"]) == 0
    told = " ".join(capsys.readouterr().out.split())
    for text in ("Parquet", "MATLAB", "NetCDF", "in rad at the load", "half the total play"):
        assert text in told


def test_a_sweeps_folder_is_a_curve(tmp_path):
    (tmp_path / "sweep").mkdir()
    file = tmp_path / "sweep" / "result.nc"
    file.touch()
    for curve in (file.parent, file):
        assert config_from_options("fit", [BEFORE], curve=curve).curve.source == file
