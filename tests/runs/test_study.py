"""Studies: the numbers of a row depend on that row alone, and none is lost or mixed up."""

from __future__ import annotations

import csv
import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from bayesbl import cli
from bayesbl.config.loading import load_config
from bayesbl.errors import ConfigError, ResultError
from bayesbl.results.store import read_tree
from bayesbl.results.work import STORE
from bayesbl.runs.study import load_study, seed_of_case, table_csv
from bayesbl.runs.study import run as run_study
from bayesbl.runs.workflow import Options

STUDY = '''"""The mean of normal draws."""

import time

import numpy as np
from pydantic import BaseModel

from bayesbl.errors import UserError

COLUMNS = {"mean_rpm": ("rpm", "mean of the draws")}


class Row(BaseModel):
    model_config = {"extra": "forbid"}

    draws: int
    cases: int = 6
    refuse: int = -1
    source: str = ""


def count(row):
    return row.cases


def run_case(row, index, seed):
    """One mean."""
    if index == row.refuse:
        raise UserError("This case is refused.")
    draws = np.random.default_rng(seed).standard_normal((50, row.draws))
    return {"mean_rpm": np.linalg.lstsq(draws, np.ones(50), rcond=None)[0].sum()}


def summarise(row, cases):
    return {"mean_rpm": float(cases["mean_rpm"].mean()), "draws": row.draws}
'''

RECORDING = Path(__file__).parents[2] / "configs" / "recordings" / "wear_before.csv"
ROWS = {"few, AR(1)": "draws = 3", "many": "draws = 30"}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "study.py").write_text(STUDY)
    return tmp_path


def configure(folder: Path, rows=ROWS, *, output="out", seed=1, workers=2) -> Path:
    """A study's configuration with the given rows."""
    tables = "".join(f'[[rows]]\nname = "{name}"\n{row}\n' for name, row in rows.items())
    path = folder / f"{output}.toml"
    path.write_text(
        f'schema = 1\nkind = "study"\nstudy = "study.py"\n'
        f'[run]\noutput = "{output}"\nseed = {seed}\nworkers = {workers}\n{tables}'
    )
    return path


def run(config: Path, **options) -> tuple[dict, list[str]]:
    """The summary of a study that was run, and what was said meanwhile."""
    said: list[str] = []
    return run_study(load_config(config), Options(say=said.append, **options)), said


def means(output: Path) -> dict[str, list[float]]:
    """The cases' numbers by row."""
    tree = read_tree(output)
    return {g.attrs["name"]: g["mean_rpm"].values.tolist() for g in tree.children.values()}


def test_the_numbers_do_not_depend_on_the_workers(folder):
    run(configure(folder, output="one", workers=1))
    shutil.rmtree(folder / STORE)
    run(configure(folder, output="three", workers=3))
    assert means(folder / "one") == means(folder / "three")


def test_another_row_or_order_leaves_a_rows_numbers_alone_and_another_seed_does_not(folder):
    run(configure(folder))
    more = {"first": "draws = 3", **dict(reversed(ROWS.items()))}
    run(configure(folder, more, output="more"))
    run(configure(folder, output="other", seed=2))
    first, second, other = (means(folder / name) for name in ("out", "more", "other"))
    assert {name: second[name] for name in ROWS} == first
    assert second["first"] != first["few, AR(1)"]
    assert not set(np.ravel(list(first.values()))) & set(np.ravel(list(other.values())))


def test_every_case_has_a_seed_of_its_own():
    seeds = {
        tuple(seed_of_case(seed, row, index).generate_state(2))
        for seed in (1, 2)
        for row in ("a", "b")
        for index in range(50)
    }
    assert len(seeds) == 200


def test_the_folder_holds_all_cases_a_table_and_the_configuration(folder):
    summary, said = run(configure(folder))
    output = folder / "out"
    assert {p.name for p in output.iterdir()} == {
        "result.nc",
        "summary.json",
        "table.csv",
        "config.toml",
        "manifest.json",
    }
    assert said == []
    tree = read_tree(output)
    assert tree["row_1"]["mean_rpm"].attrs == {"units": "rpm", "long_name": "mean of the draws"}
    assert json.loads((output / "summary.json").read_text()) == summary
    with open(output / "table.csv", newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["name"] for line in lines] == list(ROWS)
    assert list(lines[0]) == ["name", "cases", "failed", "mean_rpm", "draws", "commit"]
    assert float(lines[1]["mean_rpm"]) == pytest.approx(np.mean(means(output)["many"]), rel=1e-5)
    assert load_config(output / "config.toml").rows == load_config(folder / "out.toml").rows
    assert not list(folder.glob(".out.*"))


@pytest.mark.parametrize("text", ["=cmd|'/c calc'!A0", "+1", "-1+2", "@SUM(1)", "\t=1", "\r=1"])
def test_no_cell_of_the_table_is_a_formula(text):
    line = {"name": text, text: text, "number": -1.0, "count": -2}
    head, cells = csv.reader(io.StringIO(table_csv([line]), newline=""))
    assert head[1] == cells[0] == cells[1] == "'" + text.replace("\r", "\n")
    assert cells[2:4] == ["-1", "-2"]


def test_a_case_that_is_refused_is_counted_and_its_reason_kept(folder):
    rows = {
        "sound": "draws = 3",
        "partly": "draws = 3\nrefuse = 2",
        "never": "draws = 3\ncases = 1\nrefuse = 0",
    }
    summary, said = run(configure(folder, rows))
    assert sorted(said) == [
        'Row "never": case 0 failed: This case is refused.',
        'Row "partly": case 2 failed: This case is refused.',
    ]
    assert [(row["cases"], row["failed"]) for row in summary["rows"]] == [(6, 0), (6, 1), (1, 1)]
    partly = read_tree(folder / "out")["row_2"]
    assert partly["message"].values[2] == "This case is refused."
    assert np.flatnonzero(np.isnan(partly["mean_rpm"].values)).tolist() == [2]
    assert "mean_rpm" not in summary["rows"][2]


@pytest.mark.long
def test_a_row_defined_differently_is_run_again(folder, monkeypatch):
    config = configure(folder)
    interrupt_before_the_result(config, monkeypatch)
    configure(folder, ROWS | {"many": "draws = 20"})
    _, said = run(config)
    assert said == [
        'Row "few, AR(1)" has 6 of 6 cases already.',
    ]
    fresh = configure(folder, ROWS | {"many": "draws = 20"}, output="fresh")
    run(fresh)
    assert means(folder / "out") == means(folder / "fresh")


def interrupt_before_the_result(config: Path, monkeypatch) -> None:
    """Run all cases, and stop before the output folder is written."""
    with monkeypatch.context() as patch:
        patch.setattr("bayesbl.runs.study._tree", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run(config)


def interrupted(*arguments):
    raise KeyboardInterrupt


@pytest.mark.long
def test_a_finished_study_is_left_as_it_is_until_it_is_given_up(folder):
    config = configure(folder)
    run(config)
    kept = means(folder / "out")
    configure(folder, ROWS | {"new": "draws = 4"})
    with pytest.raises(ResultError, match="finished result, which is not overwritten"):
        run(config)
    assert means(folder / "out") == kept
    run(config, force=True)
    assert list(means(folder / "out")) == [*ROWS, "new"]
    assert {name: values for name, values in means(folder / "out").items() if name in kept} == kept


def test_only_what_decides_the_cases_defines_a_row(folder):
    table = {"name": "a", "draws": 3, "source": str(folder / "bench.toml")}
    (folder / "bench.toml").write_text("stiffness = 1")
    first = load_study(folder / "study.py").definition(table, 1)

    def changed(old: str, new: str) -> bool:
        (folder / "study.py").write_text(STUDY.replace(old, new))
        return load_study(folder / "study.py").definition(table, 1) != first

    assert changed("(50, row.draws)", "(60, row.draws)")
    assert not changed("", "")
    (folder / "bench.toml").write_text("stiffness = 2")
    assert load_study(folder / "study.py").definition(table, 1) != first


def test_a_module_that_the_study_imports_defines_its_rows_too(folder):
    path, beside = folder / "study.py", folder / "rig.py"
    path.write_text("def summarise(row, cases):\n    import rig\n" + STUDY)
    (folder / "other.py").write_text("")
    definitions = []
    for code in ("A = 1", "A = 2", "import other"):
        beside.write_text(code)
        definitions.append(load_study(path).definition({"name": "a"}, 1))
    (folder / "other.py").write_text("B = 1")
    definitions.append(load_study(path).definition({"name": "a"}, 1))
    (folder / "unused.py").write_text("C = 1")
    definitions.append(load_study(path).definition({"name": "a"}, 1))
    assert len(set(definitions)) == 4
    assert definitions[-1] == definitions[-2]


def test_rows_and_study_files_that_cannot_be_used_are_refused(folder):
    with pytest.raises(ConfigError, match=r'\[\[rows\]\] "a" drws.*Did you mean "draws"'):
        run(configure(folder, {"a": "drws = 3\ndraws = 2"}))
    (folder / "study.py").write_text(STUDY.replace("def summarise", "def summarised"))
    with pytest.raises(ConfigError, match="no summarise"):
        run(configure(folder))
    (folder / "study.py").write_text("import nowhere\n")
    with pytest.raises(ConfigError, match=r"study.py, line 1: .*No module named 'nowhere'"):
        run(configure(folder))


def test_a_bug_in_a_case_names_it_and_keeps_the_others(folder, capsys):
    (folder / "study.py").write_text(STUDY.replace("raise UserError", "raise KeyError"))
    config = configure(folder, {"a": "draws = 3\nrefuse = 5"}, workers=1)
    assert cli.status(["run", str(config)]) == cli.WRONG
    told = capsys.readouterr().err
    assert f"{folder / 'study.py'}, line " in told
    assert 'failed in case 5 of row "a". Found: KeyError' in told
    assert len(list((folder / ".finished").iterdir())) == 5


@pytest.mark.parametrize("ending", ["raise SystemExit(0)", "return ends()", "os._exit(0)"])
def test_a_case_that_ends_its_process_is_an_error_of_the_file(folder, capsys, ending):
    ends = "import os\n\n\ndef ends():\n    return ends()\n"
    text = STUDY.replace('raise UserError("This case is refused.")', ending)
    (folder / "study.py").write_text(text + ends)
    config = configure(folder, {"a": "draws = 3\nrefuse = 5"}, workers=1)
    assert cli.status(["run", str(config)]) == cli.WRONG
    told = capsys.readouterr().err
    assert str(folder / "study.py") in told
    assert "Traceback" not in told


@pytest.mark.parametrize("function", ["count", "summarise", "figure"])
def test_any_function_that_fails_is_an_error_of_the_file(folder, capsys, function):
    failing = f"\n\ndef {function}(*arguments):\n    raise SystemExit(0)\n"
    (folder / "study.py").write_text(STUDY + failing)
    assert cli.status(["run", str(configure(folder))]) == cli.WRONG
    told = capsys.readouterr().err
    assert f"failed in {function}" in told
    assert ("The result is stored" in told) is (function == "figure")


def drawing(folder: Path) -> str:
    """The configuration of a study that has a figure; its file leaves a mark when it is run."""
    mark = folder / "mark"
    (folder / "study.py").write_text(
        f"""{STUDY}

open({str(mark)!r}, "w").close()


def figure(table, cases):
    from matplotlib.figure import Figure

    figure = Figure()
    figure.add_subplot().plot([cases[line["name"]]["mean_rpm"].mean() for line in table])
    return figure
"""
    )
    return str(configure(folder))


def test_a_study_runs_and_is_inspected_on_the_command_line(folder, capsys):
    config = drawing(folder)
    assert cli.status(["check", config]) == 0
    assert '"many" 6 cases' in capsys.readouterr().out
    assert cli.status(["run", config]) == 0
    assert "few, AR(1)" in capsys.readouterr().out
    assert cli.status(["inspect", str(folder / "out")]) == 0
    assert "mean_rpm" in capsys.readouterr().out
    assert {p.name for p in (folder / "out" / "figures").iterdir()} == {"study.png"}
    assert cli.status(["run", config, "--json", "--out", str(folder / "b")]) == 0
    assert json.loads(capsys.readouterr().out)["kind"] == "study"
    assert cli.status(["run", config]) == cli.WRONG


def test_a_stored_result_never_runs_the_file_that_it_names(folder, capsys):
    output, mark, figures = folder / "out", folder / "mark", folder / "out" / "figures"
    run(Path(drawing(folder)))
    drawn = {path: path.read_bytes() for path in figures.iterdir()}

    def printed(*arguments) -> tuple[int, str]:
        mark.unlink(missing_ok=True)
        status = cli.status([str(argument) for argument in arguments])
        return status, " ".join("".join(capsys.readouterr()).split())

    for command in ("figures", "report", "inspect"):
        printed(command, output)
        assert not mark.exists()
    for option in ("--curve", "--start-from"):
        printed("fit", RECORDING, option, output, "--out", folder / "fit")
        assert not mark.exists()
    assert {path: path.read_bytes() for path in figures.iterdir()} == drawn
    assert "<img" in (output / "report.html").read_text()

    for path in drawn:
        path.unlink()
    status, told = printed("figures", output)
    assert status == cli.WRONG
    assert "--study FILE" in told
    status, _ = printed("report", output)
    assert status == 0
    assert not mark.exists()
    status, _ = printed("figures", output, "--study", folder / "study.py")
    assert status == 0
    assert mark.exists()  # the user has named the file
    assert {path.name for path in figures.iterdir()} == {"study.pdf", "study.png"}
