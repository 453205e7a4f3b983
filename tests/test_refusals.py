"""Mistakes that people make with recordings and limits: each is told, none gives a wrong answer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_files import write_csv

from bayesbl import cli
from bayesbl.errors import RecordingError, UserError
from bayesbl.gap.curve import published_curve
from bayesbl.recording.checks import ready_for_fit, require_alive
from bayesbl.recording.readers import read_recording
from bayesbl.workflows.measure import require_plausible_limit, same_files

CONFIGS = Path(__file__).parents[1] / "configs"
BEFORE = CONFIGS / "recordings" / "wear_before.csv"
AFTER = CONFIGS / "recordings" / "wear_after.csv"


def refused(arguments, capsys, *told: str) -> str:
    """Status 2 and one message that says all of this."""
    assert cli.status([str(argument) for argument in arguments]) == cli.WRONG
    errors = capsys.readouterr().err
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
        "out of [columns]",
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
    for dates in ({}, {"first": "date = 2026-02-01", "second": "date = 2026-03-01"}):
        assert cli.status(["check", str(compare_file(tmp_path, **dates))]) == 0


def test_copies_of_one_recording_are_told(tmp_path, capsys):
    copy = tmp_path / "friday.csv"
    copy.write_bytes(BEFORE.read_bytes())
    first, again, other = (read_recording(path) for path in (BEFORE, copy, AFTER))
    (told,) = same_files([first, other, again])
    assert "wear_before and friday are one and the same" in told
    assert same_files([first, other]) == []
    path = compare_file(tmp_path)
    path.write_text(path.read_text().replace(str(AFTER), str(copy)))
    assert cli.status(["check", str(path)]) == 0
    assert "one and the same" in capsys.readouterr().out
