"""The causes of mishandling that issue 16 lists, each by what must not happen."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from attack import commands, configurations, own_process, recordings
from attack.engine import HARM, Finding, Prepare, Trial
from attack.workshop import (
    CONFIGURATIONS,
    HEAD,
    JOINT,
    REPOSITORY,
    SHORT,
    Originals,
    example,
    plain_csv,
    put_configuration,
    put_inputs,
)
from bayesbl import cli

Findings = Callable[[Prepare], list[Finding]]


# 1


@pytest.mark.parametrize("command", ["report", "figures", "inspect"])
def test_a_received_result_runs_nothing(
    command: str, originals: Originals, findings: Findings
) -> None:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        import shutil

        folder = originals.copy("study", place)
        shutil.rmtree(folder / "figures", ignore_errors=True)
        (place / "study_file_was_run").unlink(missing_ok=True)
        (place / "study.py").write_text("open('study_file_was_run', 'w')\n")

        def judge(ended: object) -> list[Finding]:
            run = (place / "study_file_was_run").exists()
            return [(HARM, "the file that the result names was run")] if run else []

        return Trial([(command, "result")], lambda ended: iter(judge(ended)), outputs=["*"])

    assert not findings(prepare)


# 2


@pytest.mark.parametrize("make", commands.COLLISIONS, ids=lambda make: make.__name__)
def test_no_output_is_an_input(make: Callable[[Path], object], findings: Findings) -> None:
    assert not findings(commands.collided(make))


# 3, 4


@pytest.mark.long
def test_a_package_that_is_read_only_measures_without_a_home(findings: Findings) -> None:
    # The check imports all that a measurement compiles; compiling it takes half a minute.
    def work(place: Path) -> own_process.Findings:
        return own_process.read_only_package(place, ("check", "direct.toml"))

    assert not findings(own_process.in_own_process(work))


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp437"])
def test_a_terminal_that_is_not_utf_8_is_printed_to(encoding: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-m", "bayesbl", "effects", "load_coulomb_friction"],
        env={**os.environ, "PYTHONPATH": str(REPOSITORY), "PYTHONIOENCODING": encoding},
        capture_output=True,
    )
    assert ended.returncode == 0, ended.stderr.decode()


# 5


@pytest.mark.parametrize("name", commands.NAMES.values(), ids=list(commands.NAMES))
def test_a_recording_may_have_any_name(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from bayesbl.config.loading import config_from_options

    monkeypatch.chdir(tmp_path)
    Path(name).write_text(plain_csv(example()))
    assert config_from_options("fit", [name]).kind == "fit"


# 6


def wide(path: Path, columns: int) -> Path:
    names = ",".join(f"{i * 0.001:.3f}" for i in range(columns))
    path.write_text("".join(f"{name},{names}\n" for name in example()))
    return path


def test_a_file_that_is_transposed_and_more_is_said_to_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A line for each channel is read; with a line of another kind below, it is a question."""
    path = wide(tmp_path / "a.csv", 5_000)
    path.write_text(path.read_text() + ",".join(["end"] * 5_001) + "\n")
    assert cli.status(["fit", str(path)]) == cli.WRONG
    assert "transposed?" in capsys.readouterr().err


def test_a_wide_header_is_refused_in_no_time(tmp_path: Path) -> None:
    path = wide(tmp_path / "a.csv", 20_000)
    begin = time.process_time()
    assert cli.status(["fit", str(path)]) == cli.WRONG
    assert time.process_time() - begin < 1.0


# 7, 8


LATER = (
    HEAD.format(kind="fit").replace('"result"', '"later"')
    + JOINT
    + SHORT.replace("1000", "200")
    + '[[recordings]]\nfile = "after.csv"\n'
)
READERS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    **{
        " ".join(step): ("fit", step)
        for step in (
            ("inspect", "result"),
            ("inspect", "result", "--json"),
            ("report", "result"),
            ("figures", "result"),
        )
    },
    "start_from": ("fit", ("check", "later.toml")),
    "source": ("sweep", ("check", "later.toml")),
}


@pytest.mark.parametrize("reader", READERS)
def test_a_changed_result_is_refused_by_whatever_reads_it(
    reader: str, originals: Originals, findings: Findings
) -> None:
    """That any change is found is a test of the store."""
    kind, step = READERS[reader]

    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        file = originals.copy(kind, place) / "result.nc"
        content = bytearray(file.read_bytes())
        content[int(rng.integers(len(content)))] ^= 1
        file.write_bytes(content)
        section = "curve" if kind == "sweep" else "estimator.search"
        (place / "later.toml").write_text(f'{LATER}[{section}]\n{reader} = "result"\n')
        return Trial([step], statuses=(cli.WRONG,), names=["result.nc"])

    assert not findings(prepare)


def test_what_lies_beside_a_result_is_not_believed(
    originals: Originals, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result, told = originals.copy("fit", tmp_path), []
    for _ in range(2):
        assert cli.status(["inspect", str(result), "--json"]) == 0
        told.append(capsys.readouterr().out)
        (result / "summary.json").write_text('{"delta_rad": 1.0}')
        (result / "config.toml").write_text("nothing")
    assert told[0] == told[1]


# 9


CHECKED: Mapping[str, tuple[str, configurations.Edit]] = {
    **{
        name: ("fit", (configurations.RUN_EDITS | configurations.SNAPSHOT_EDITS)[name])
        for name in (
            "output a file",
            "output root",
            "output here",
            "output /dev/null",
            "output of 300 characters",
            "speed read as rad/s",
            "a wrong gear ratio",
            "another speed asked for",
        )
    },
    **{
        f"{kind}: {name}": (kind, configurations.ROTATION_EDITS[name])
        for kind in ("simulate", "sweep")
        for name in ("1e9 rotations", "1e12 Hz")
    },
}


@pytest.mark.long
@pytest.mark.parametrize("name", CHECKED)
def test_check_asks_what_run_asks(name: str, findings: Findings) -> None:
    kind, edit = CHECKED[name]
    assert not findings(configurations.edited(kind, edit, False))


# 10


@pytest.mark.parametrize("name", commands.STUDY_FILES)
def test_a_study_file_that_fails_is_named(name: str, findings: Findings) -> None:
    assert not findings(commands.study_file(commands.STUDY_FILES[name]))


# 11


SPECIAL = ("/dev/zero", "/dev/urandom", "a FIFO", "a link to /dev/zero", "a socket")


@pytest.mark.parametrize("name", SPECIAL)
@pytest.mark.parametrize("command", ["fit", "check", "--curve"])
def test_only_regular_files_are_read(command: str, name: str, findings: Findings) -> None:
    assert not findings(commands.asked_for_nothing(command, commands.MISSING[name]))


@pytest.mark.long
def test_a_large_csv_takes_a_few_times_its_size(findings: Findings) -> None:
    def work(place: Path) -> own_process.Findings:
        return own_process.memory_of_a_large_csv(place, 15_000_000)

    assert not findings(own_process.in_own_process(work))


# 12


@pytest.mark.long
@pytest.mark.parametrize("writer", ["fit", "init", "simulate"])
@pytest.mark.parametrize("out", ["300 characters", "an escape", "a NUL"])
def test_an_output_name_that_cannot_be_is_refused(
    writer: str, out: str, findings: Findings
) -> None:
    assert not findings(commands.written_to(writer, commands.OUTPUTS[out]))


ODD = [n for n in recordings.VALUES if n.startswith(("a huge", "dates", "time"))]
ESCAPES = [n for n in recordings.STRUCTURE if "escape" in n]


@pytest.mark.parametrize("name", [*ODD, *ESCAPES])
def test_absurd_numbers_dates_and_names_are_refused_in_plain_text(
    name: str, findings: Findings
) -> None:
    change = (recordings.VALUES | recordings.STRUCTURE)[name]
    assert not findings(recordings.with_lines(change, recordings.need_not_be_seen))


# 13


@pytest.mark.long
@pytest.mark.parametrize("kind", ["fit", "sweep", "simulate"])
def test_a_full_disk_is_named_and_nothing_is_left(kind: str, findings: Findings) -> None:
    assert not findings(commands.full_disk(kind))


# From a new user's trial


def test_a_command_and_a_configuration_of_one_name_have_their_own_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from bayesbl.config.loading import config_from_options, load_config

    monkeypatch.chdir(tmp_path)
    put_inputs(tmp_path)
    text = CONFIGURATIONS["compare"].replace('output = "result"\n', "")
    Path("before.toml").write_text(text)
    fitted = config_from_options("fit", ["before.csv"])
    assert fitted.run.output != load_config("before.toml").run.output


def test_a_mistake_is_told_before_the_folder_is_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    put_configuration(tmp_path, "fit")
    (tmp_path / "result").mkdir()
    (tmp_path / "result" / "summary.json").write_text("{}")
    (tmp_path / "result" / "manifest.json").write_text('{"files": ["summary.json"]}')
    (tmp_path / "before.csv").write_text("time_s,speed\n0,1\n")
    assert cli.status(["run", "fit.toml"]) == cli.WRONG
    assert "before.csv" in capsys.readouterr().err


def test_exchanged_columns_are_asked_about(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    put_configuration(tmp_path, "fit")
    text = plain_csv(example()).replace(
        "motor_speed_rpm,motor_current_a", "motor_current_a,motor_speed_rpm", 1
    )
    (tmp_path / "before.csv").write_text(text)
    assert cli.status(["check", "fit.toml"]) == cli.WRONG
    assert "is this another column" in capsys.readouterr().err
