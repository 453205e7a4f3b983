"""The command line: what it leaves behind, what it prints, and with which status it ends."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from fresh_process import loaded_by
from places import AFTER, BEFORE, CONFIGS, RECORDINGS

from bayesbl import cli
from bayesbl.cli.commands import brought_forward

ROTATION_SAMPLES = 3600


def cut(source: Path, target: Path, samples: int) -> Path:
    """The first samples of a recording."""
    lines = source.read_text().splitlines(keepends=True)
    target.write_text("".join(lines[: samples + 1]))
    return target


def altered(source: Path, target: Path, change) -> Path:
    """A recording whose speed went through a function."""
    header, *_ = source.read_text().splitlines()
    names = header.split(",")
    table = np.loadtxt(source, delimiter=",", skiprows=1)
    column = names.index("motor_speed_rpm")
    table[:, column] = change(table[:, column])
    keep = [names.index("time_s"), column]
    np.savetxt(target, table[:, keep], "%.10g", ",", header="time_s,motor_speed_rpm", comments="")
    return target


def content(folder: Path) -> dict[str, bytes]:
    """Every file of a folder with its bytes."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def snapshots(tmp_path_factory):
    """Two short recordings and a configuration that compares them."""
    folder = tmp_path_factory.mktemp("snapshots")
    for source in (BEFORE, AFTER):
        cut(source, folder / source.name, int(2.3 * ROTATION_SAMPLES))
    (folder / "wear.toml").write_text(
        """schema = 1
kind = "compare"
[run]
seed = 3
output = "out"
[joint]
gear_ratio = 120.0
limit_rad = 1.2e-3
[[recordings]]
name = "old"
file = "wear_before.csv"
[[recordings]]
name = "new"
file = "wear_after.csv"
[curve]
source = "published"
[posterior]
ensembles = 2
"""
    )
    return folder


@pytest.fixture(scope="module")
def compared(snapshots):
    """The output folder of a comparison with its figures."""
    assert cli.status(["run", str(snapshots / "wear.toml")]) == 0
    return snapshots / "out"


def refused(arguments, capsys, *told: str) -> str:
    """The one message of a command that must be refused, which holds the texts ``told``."""
    assert cli.status([str(argument) for argument in arguments]) == cli.WRONG
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "Traceback" not in printed.err
    for text in told:
        assert text in printed.err
    return printed.err


# What a comparison leaves behind


def test_a_comparison_leaves_result_summary_config_and_figures(compared):
    assert {path.name for path in compared.iterdir()} == {
        "result.nc",
        "summary.json",
        "config.toml",
        "manifest.json",
        "figures",
    }
    drawn = list((compared / "figures").iterdir())
    assert len(drawn) >= 3
    assert {path.suffix for path in drawn} == {".png"}


def test_the_summary_answers_with_the_contracts_keys(compared):
    summary = json.loads((compared / "summary.json").read_text())
    assert [snapshot["name"] for snapshot in summary["snapshots"]] == ["old", "new"]
    for snapshot in summary["snapshots"]:
        assert set(snapshot["delta_rad"]) == {"median", "low", "high", "level", "kind"}
        assert snapshot["probability_above_limit"] is None, "the curve is of another machine"
    assert summary["change_rad"]["low"] < 2.7e-4 < summary["change_rad"]["high"] * 1.08
    assert summary["probability_increase"] > 0.99


@pytest.mark.long
def test_the_same_seed_gives_the_same_numbers(compared, snapshots, capsys, tmp_path):
    arguments = ["run", str(compared / "config.toml"), "--out", str(tmp_path / "again"), "--json"]
    assert cli.status([*arguments, "--no-figures"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out) == json.loads((compared / "summary.json").read_text())
    assert printed.out == (tmp_path / "again" / "summary.json").read_text()
    assert not (tmp_path / "again" / "figures").exists()


def test_a_finished_result_is_left_as_it_is(compared, snapshots, capsys):
    before = content(compared)
    refused(["run", snapshots / "wear.toml"], capsys, str(compared), "--force")
    refused(
        ["compare", snapshots / "wear_before.csv", snapshots / "wear_after.csv", "--out", compared],
        capsys,
        "holds a finished result",
    )
    assert content(compared) == before


def test_a_result_is_inspected(compared, capsys):
    assert cli.status(["inspect", str(compared)]) == 0
    assert "The gap grew" in capsys.readouterr().out
    assert cli.status(["inspect", str(compared / "result.nc"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["kind"] == "compare"


def test_figures_are_drawn_again_in_their_place(compared, monkeypatch, capsys):
    kept = content(compared)

    def draw(tree, folder, formats, study):
        assert formats == ("pdf", "png")
        (folder / "gap.pdf").write_text("gap")
        return [folder / "gap.pdf"]

    monkeypatch.setattr("bayesbl.library.draw", draw)
    assert cli.status(["figures", str(compared)]) == 0
    assert capsys.readouterr().out.splitlines() == [str(compared / "figures" / "gap.pdf")]
    assert content(compared) == kept | {"figures/gap.pdf": b"gap"}


@pytest.mark.long
def test_a_withheld_answer_is_stored_and_ends_with_status_3(no_figures, capsys, tmp_path):
    out = ["--out", str(tmp_path / "out")]
    loud = altered(BEFORE, tmp_path / "loud.csv", lambda v: v.mean() + 4.0 * (v - v.mean()))
    assert cli.status(["fit", str(loud), "--curve", "published", *out, "--json"]) == cli.WITHHELD
    printed = capsys.readouterr()
    summary = json.loads(printed.out)
    assert summary["delta_rad"] is None
    assert summary["reason"]["code"]
    assert summary["reason"]["text"] in printed.err
    assert summary["amplitude_rpm"]["median"] > 100.0
    assert (tmp_path / "out" / "result.nc").is_file()


# What is refused, with one message that names place, finding and expectation


def test_a_missing_file_is_refused(tmp_path, capsys):
    refused(["fit", tmp_path / "none.csv", "--out", tmp_path / "o"], capsys, "none.csv")
    refused(["run", tmp_path / "none.toml"], capsys, "none.toml")
    refused(["inspect", tmp_path / "none"], capsys, "none")


HEADER = "time_s,motor_speed_rpm\n"


def rows(speed=lambda i: 2000.0 + i % 7, time_s=lambda i: i / 1000, count=1000) -> str:
    return HEADER + "".join(f"{time_s(i)},{speed(i)}\n" for i in range(count))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        pytest.param(b"\x89PNG\r\n\x1a\n\x00\x00", "not a CSV", id="not a CSV"),
        pytest.param(b"", "empty", id="empty file"),
        pytest.param(
            rows().replace("motor_speed_rpm", "motor_sped_rpm"), "motor_sped_rpm", id="no column"
        ),
        pytest.param(
            rows(lambda i: "2000 or so" if i == 12 else 2000 + i % 3), "line 14", id="text"
        ),
        pytest.param(rows(lambda i: "nan"), "motor_speed_rpm", id="NaN everywhere"),
        pytest.param(rows(time_s=lambda i: abs(i - 40) / 1000), "time_s", id="time backwards"),
        pytest.param(rows(lambda i: 2000.0, count=8000), "never changes", id="constant speed"),
    ],
)
def test_a_recording_that_cannot_be_used_is_refused(text, told, tmp_path, capsys):
    file = tmp_path / "joint.csv"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    for command in (["fit", file], ["compare", BEFORE, file]):
        refused([*command, "--out", tmp_path / "out"], capsys, str(file), told)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options", [[], ["--gear-ratio", "120"]])
def test_fewer_than_two_rotations_are_refused(options, tmp_path, capsys):
    short = cut(BEFORE, tmp_path / "short.csv", int(1.5 * ROTATION_SAMPLES))
    refused(
        ["fit", short, "--out", tmp_path / "out", *options], capsys, str(short), "rotations", "2"
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("ensembles = 2", "ensemble = 2", ["line 18", "ensemble", 'Did you mean "ensembles"']),
        ("ensembles = 2", "ensembles = 1", ["[posterior] ensembles", "Found: 1", "2"]),
        ("limit_rad = 1.2e-3", "limit_rad = -1e-3", ["[joint] limit_rad", "-0.001"]),
        ('"wear_after.csv"', '"gone.csv"', ["gone.csv", "no such file"]),
        ('kind = "compare"', 'kind = "compar"', ["compar", "compare"]),
    ],
)
def test_a_wrong_configuration_is_refused(old, new, told, snapshots, capsys):
    config = snapshots / "wrong.toml"
    config.write_text((snapshots / "wear.toml").read_text().replace(old, new))
    for command in ("run", "check"):
        refused([command, config], capsys, str(config), *told)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--limit-rad", "-0.1"),
        ("--limit-rad", "1,2"),
        ("--limit-rad", "nan"),
        ("--gear-ratio", "0"),
        ("--level", "1.5"),
        ("--workers", "0"),
        ("--seed", "-1"),
        ("--seed", "one"),
        ("--curve", "none.nc"),
        ("--config", "none.toml"),
    ],
)
def test_a_wrong_option_is_refused_by_its_name(option, value, tmp_path, capsys):
    told = refused(["fit", BEFORE, "--out", tmp_path / "out", option, value], capsys, value)
    assert option in told or option == "--config"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["compair", "a.csv", "b.csv"], "compare"),
        (["fit", "a.csv", "--limt-rad", "1"], "--limit-rad"),
        (["fit"], "RECORDING"),
        (["compare", "a.csv"], "SECOND"),
    ],
)
def test_wrong_usage_is_refused_with_what_was_meant(arguments, told, capsys):
    refused(arguments, capsys, told)


def test_an_output_folder_with_files_of_the_user_is_refused_before_the_run(tmp_path, capsys):
    (tmp_path / "thesis.tex").write_text("years of work")
    refused(["fit", BEFORE, "--out", tmp_path, "--force"], capsys, "thesis.tex")
    assert content(tmp_path) == {"thesis.tex": b"years of work"}


# Checking and simulating


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("wear_snapshots.toml", "Ready to run."),
        ("fit_example.toml", "Ready to run."),
        ("bench.toml", "The bench can be used."),
    ],
)
def test_the_examples_pass_their_check(name, said, capsys):
    assert cli.status(["check", str(CONFIGS / name)]) == 0
    printed = capsys.readouterr()
    assert said in printed.out
    # Progress, if it takes more than two seconds.
    assert all(line.endswith(" s") and ", after " in line for line in printed.err.splitlines())


def test_a_check_names_every_recording_that_cannot_be_used(snapshots, tmp_path, capsys):
    for name, samples in (("wear_before.csv", 5000), ("wear_after.csv", 5400)):
        cut(RECORDINGS / name, tmp_path / name, samples)
    (tmp_path / "wear.toml").write_text((snapshots / "wear.toml").read_text())
    assert cli.status(["check", str(tmp_path / "wear.toml")]) == cli.WRONG
    errors = capsys.readouterr().err
    assert errors.count("too few rotations") == 2
    assert not (tmp_path / "out").exists()


def test_a_simulation_runs_by_either_command(tmp_path, capsys):
    (tmp_path / "simulate.toml").write_text(
        f"""schema = 1
kind = "simulate"
bench = "{CONFIGS / "bench.toml"}"
[[recordings]]
name = "forward"
file = "forward.csv"
gap_rad = 8e-4
"""
    )
    config = str(tmp_path / "simulate.toml")
    assert cli.status(["check", config]) == 0
    capsys.readouterr()
    told = []
    for command, folder in (("simulate", "a"), ("run", "b")):
        assert cli.status([command, config, "--out", str(tmp_path / folder), "--json"]) == 0
        told.append(json.loads(capsys.readouterr().out))
    assert [Path(file).parent for summary in told for file in summary["files"][:1]] == [
        tmp_path / "a",
        tmp_path / "b",
    ]
    assert content(tmp_path / "a") == content(tmp_path / "b")
    capsys.readouterr()
    refused(["run", config, "--out", tmp_path / "b"], capsys, "forward.csv", "--force")


def test_an_option_that_a_simulation_does_not_use_is_refused(tmp_path, capsys):
    (tmp_path / "a.toml").write_text('kind = "simulate"')
    given = ["run", tmp_path / "a.toml", "--before", "2027-01-01"]
    refused(given, capsys, "a.toml", "--before", "simulation")


# The process


def test_help_and_version_end_with_status_0(capsys):
    assert cli.status(["--version"]) == 0
    assert re.fullmatch(
        r"bayesbl \d+\.\d+\.\d+( \([0-9a-f]{40}(-dirty)?\))?\n", capsys.readouterr().out
    )
    assert cli.status(["--help"]) == 0
    assert "compare" in capsys.readouterr().out


def test_help_imports_nothing_heavy():
    heavy = {"numpy", "scipy", "numba", "xarray", "pydantic", "matplotlib", "rich"}
    assert not loaded_by("from bayesbl import cli; cli.status(['--help'])") & heavy


def test_a_bug_is_told_with_its_traceback_and_status_1(monkeypatch, capsys):
    def broken(*arguments, **keywords):
        raise KeyError("posterior")

    monkeypatch.setattr("bayesbl.runs.kinds.run", broken)
    assert cli.status(["fit", str(BEFORE)]) == cli.FAILED
    errors = capsys.readouterr().err
    assert errors.startswith("This is a bug in bayesbl")
    assert "KeyError: 'posterior'" in errors


@pytest.mark.long
def test_ctrl_c_ends_with_1_and_leaves_no_output(tmp_path):
    arguments = ["compare", BEFORE, AFTER, "--out", tmp_path / "results" / "out"]
    process = subprocess.Popen(
        [sys.executable, "-m", "bayesbl", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Tests that run in the background of a shell are started with it ignored.
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
    )
    results = tmp_path / "results"
    while not results.exists() and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == cli.FAILED
    assert "Interrupted" in errors
    assert "Traceback" not in errors
    # What is finished so far stays for the next run, hidden.
    left = os.listdir(results) if results.exists() else []
    assert [name for name in left if not name.startswith(".")] == []


@pytest.mark.long
def test_no_standard_output_costs_no_answer(tmp_path):
    config = tmp_path / "simulate.toml"
    config.write_text(
        f'schema = 1\nkind = "simulate"\nbench = "{CONFIGS / "bench.toml"}"\n'
        '[[recordings]]\nname = "a"\nfile = "a.csv"\ngap_rad = 8e-4\nrotations = 2.2\n'
    )
    run = [sys.executable, "-m", "bayesbl", "run", str(config)]
    assert subprocess.run(["sh", "-c", '"$@" >&- 2>&-', "sh", *run]).returncode == 0
    assert (tmp_path / "a.csv").read_text().startswith("time_s,")


@pytest.mark.long
def test_a_closed_pipe_is_quiet(compared):
    process = subprocess.Popen(
        [sys.executable, "-m", "bayesbl", "inspect", str(compared)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    process.stdout.close()
    errors = process.stderr.read()
    process.wait(timeout=30)
    assert errors == b""


def test_only_options_before_two_dashes_are_brought_forward():
    given = ["fit", "a.csv", "--pdf", "--", "--no-figures"]
    assert brought_forward(given) == ["--pdf", "fit", "a.csv", "--", "--no-figures"]
