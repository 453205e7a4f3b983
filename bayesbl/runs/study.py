"""Studies: many independent cases in rows, over processes or a cluster, resumed where left.

For what a study is, see :mod:`bayesbl.runs.study_file`. ``result.nc`` holds all cases, a
group per row; ``table.csv`` a line per row.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr

from bayesbl.config.study import StudyConfig
from bayesbl.errors import ResultError
from bayesbl.results.folder import figure_title, is_finished, require_free
from bayesbl.results.provenance import git_commit, provenance_of
from bayesbl.results.store import OUTCOME
from bayesbl.results.summary_types import Head, head
from bayesbl.results.variables import Group, Variable
from bayesbl.results.work import WorkStore
from bayesbl.runs.cases import Case, Job, files_of_study, run_in_processes, run_of_file
from bayesbl.runs.cluster import run_on_cluster
from bayesbl.runs.declared_groups import read_result
from bayesbl.runs.study_file import RESERVED, Study, Table, load_study
from bayesbl.runs.workflow import Options, Plan, require_output, write_result

TABLE_FILE = "table.csv"
_FORMULA = ("=", "+", "-", "@", "\t", "\n")

_OWN_COLUMNS = {
    "failed": ("1", "1 where the case failed, and has no values"),
    "message": ("", "why the case failed"),
    "seconds": ("s", "time that the case took"),
    "commit": ("", "commit that the case was run at"),
}
"""Unit and long name of :data:`RESERVED`."""


@dataclass(slots=True)
class Row:
    """A row with the cases that are finished, by index."""

    table: Table
    count: int
    definition: str
    cases: dict[int, Case] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return str(self.table["name"])

    def jobs(self, seed: int) -> list[Job]:
        """The cases that are still to be run."""
        return [
            Job(self.table, index, seed) for index in range(self.count) if index not in self.cases
        ]

    def address(self, index: int) -> tuple[str, int]:
        """What decides the numbers of a case."""
        return self.definition, index


def run(config: StudyConfig, options: Options) -> StudySummary:
    """Run what is not finished of a study, write its output folder, and return the summary.

    A finished result is added to: its rows keep their cases, and the commit that made them. Where
    one of them would be lost, because it is now defined differently or is gone from the
    configuration, the run is refused. ``options.force`` starts over: every case is run again.

    Raises
    ------
    UserError
        If the study, a row or the output folder cannot be used.
    """
    study, rows = prepare(config)
    output = config.run.output
    add = not options.force and is_finished(output)
    if add:
        _take_from_result(study, rows, output)
    require_free(output, force=options.force or add)
    with WorkStore.beside(output, fresh=options.force) as work:
        # A case keeps the commit that made it, as in a finished result that is added to.
        kept = replace(work, code="")
        for row in rows:
            _take_from_store(row, kept, options.say)
        _finish(study, rows, config, kept, options)
        tree = _tree(study, rows, config)
        summary = summarise_study(tree)
        replaced = replace(options, draw=partial(draw_study, study), force=options.force or add)
        table = {TABLE_FILE: table_csv(summary["rows"])}
        write_result(tree, summary, config, replaced, table, work)
    return summary


def describe(config: StudyConfig, plan: Plan) -> None:
    """What would run, in words."""
    plan.add("output", partial(require_output, config.run.output))
    plan.add("study", partial(_in_words, config))


def _in_words(config: StudyConfig) -> str:
    study, rows = prepare(config)
    return f"{study.path}, " + ", ".join(f'"{row.name}" {row.count} cases' for row in rows)


def declared_groups(tree: xr.DataTree) -> tuple[Group, ...]:
    """A group for each row of a study."""
    own = tuple(
        Variable(name, ("case",), unit, meaning, "number" if unit else "text")
        for name, (unit, meaning) in _OWN_COLUMNS.items()
    )
    index = Variable("case", ("case",), "1", "index of the case")
    return tuple(Group(name, own, (index,), _column) for name in _names_of_rows(tree))


def _column(name: str) -> Variable:
    """What the study's own code returns of each case."""
    return Variable(name, ("case",), "", name)


def prepare(config: StudyConfig) -> tuple[Study, list[Row]]:
    """The study with its rows, all of them validated.

    Raises
    ------
    ConfigError
        If the study file cannot be loaded, or refuses a row.
    """
    study = load_study(config.study)
    return study, [
        Row(table, study.count(table), study.definition(table, config.run.seed))
        for table in config.rows
    ]


class StudySummary(Head):
    """``summary.json`` of a study; ``rows`` are the lines of its table."""

    kind: Literal["study"]
    study: str
    rows: list[dict[str, Any]]


def summarise_study(tree: xr.DataTree) -> StudySummary:
    """``summary.json`` of a study, from the result alone."""
    return {
        "kind": "study",
        **head(tree),
        "study": tree.attrs["study"],
        "rows": [
            {**json.loads(row.attrs["line"]), "seconds": float(row.attrs["seconds"])}
            for row in _groups(tree)
        ],
    }


def table_csv(lines: Sequence[Mapping[str, Any]]) -> str:
    """Lines of the table as CSV, six digits, the commit last; times are left to the summary.

    A text that a spreadsheet would take for a formula begins with an apostrophe.
    """
    columns = table_columns(lines)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(_harmless, columns))
    writer.writerows([_harmless(line.get(column)) for column in columns] for line in lines)
    return text.getvalue()


def _harmless(value: object) -> str:
    if not isinstance(value, str):
        return cell(value)
    text = value.replace("\r", "\n")  # which csv does not quote
    return f"'{text}" if text.startswith(_FORMULA) else text


def table_columns(lines: Sequence[Mapping[str, Any]]) -> list[str]:
    """Columns of all lines in the order of their first appearance, the commit last."""
    columns = dict.fromkeys(column for line in lines for column in line)
    return [column for column in columns if column not in ("seconds", "commit")] + ["commit"]


def cell(value: object) -> str:
    """A value of the table as text."""
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def stored_rows(tree: xr.DataTree) -> tuple[list[dict[str, Any]], dict[str, xr.Dataset]]:
    """Lines of a result's table, and the cases of each row by its name."""
    groups = _groups(tree)
    lines = [json.loads(group.attrs["line"]) for group in groups]
    return lines, {group.attrs["name"]: group for group in groups}


def _take_from_result(study: Study, rows: Sequence[Row], output: Path) -> None:
    """Give rows the cases of a finished result that this run may add to, or refuse."""
    tree = read_result(output)
    if tree.attrs.get("kind") != "study":
        require_free(output)
    stored = {group.attrs["name"]: group for group in _groups(tree)}
    definitions = {row.name: row.definition for row in rows}
    lost = [n for n, g in stored.items() if definitions.get(n) != g.attrs["definition"]]
    if lost:
        raise ResultError(
            "This folder holds a finished result with rows that this run would lose.",
            file=output,
            found=", ".join(
                f'"{name}" ' + ("defined differently" if name in definitions else "not asked for")
                for name in lost
            ),
            expected="the rows as they were and others beside them, another folder (--out), or "
            "--force to start over",
        )
    if len(stored) == len(rows) and tree.attrs["study_sha256"] == study.sha256:
        require_free(output)  # nothing is left to do
    for row in rows:
        if row.name in stored:
            row.cases = _cases_of(stored[row.name])


def _take_from_store(row: Row, work: WorkStore, say: Callable[[str], None]) -> None:
    """Give a row the cases that an earlier, unfinished run stored."""
    if row.cases:
        return
    last = work.recall("definition of a row", row.name, str)
    if last not in (None, row.definition):
        say(f'Row "{row.name}" is defined differently than before: its cases are run again.')
    work.keep("definition of a row", row.name, row.definition)
    stored = (work.recall("case", row.address(index), Case) for index in range(row.count))
    row.cases = {case.index: case for case in stored if case is not None}
    if row.cases:
        say(f'Row "{row.name}" goes on after {len(row.cases)} of {row.count} cases.')


def _finish(
    study: Study, rows: Sequence[Row], config: StudyConfig, work: WorkStore, options: Options
) -> None:
    """Run all cases that lack, each stored as soon as it ends."""
    by_name = {row.name: row for row in rows}
    jobs = [job for row in rows for job in row.jobs(config.run.seed)]
    if not jobs:
        return
    if config.run.scheduler is None:
        ended = run_in_processes(study, jobs, git_commit(), config.run.workers)
    else:
        run_case = partial(run_of_file, str(study.path), git_commit())
        files = files_of_study(study, jobs)
        ended = run_on_cluster(run_case, jobs, files, config.run.scheduler, options.say)
    for job, case in ended:
        row = by_name[job.row]
        work.keep("case", row.address(case.index), case)
        if case.message and not any(other.message for other in row.cases.values()):
            options.say(f'Row "{row.name}": case {case.index} failed: {case.message}')
        row.cases[case.index] = case
        if options.progress is not None:
            options.progress(row.name, len(row.cases), row.count)


def _tree(study: Study, rows: Sequence[Row], config: StudyConfig) -> xr.DataTree:
    groups = {f"row_{n}": _row_group(study, row) for n, row in enumerate(rows, start=1)}
    tree = xr.DataTree.from_dict(groups)
    tree.attrs = {
        "kind": "study",
        "study": study.name,
        "study_sha256": study.sha256,
        OUTCOME: "done",
        **provenance_of(config),
    }
    return tree


def _row_group(study: Study, row: Row) -> xr.Dataset:
    """All cases of a row with its line of the table."""
    cases = [row.cases[index] for index in range(row.count)]
    names = dict.fromkeys(name for case in cases for name in case.values)
    columns: dict[str, Sequence[float] | Sequence[str]] = {
        name: [case.values.get(name, np.nan) for case in cases] for name in names
    }
    columns["failed"] = [float(bool(case.message)) for case in cases]
    columns["message"] = [case.message for case in cases]
    columns["seconds"] = [case.seconds for case in cases]
    columns["commit"] = [case.commit for case in cases]
    group = xr.Dataset(
        {name: ("case", values, _described(study, name)) for name, values in columns.items()},
        {"case": np.arange(row.count)},
    )
    done = np.flatnonzero(group["failed"].values == 0.0)
    commit = ", ".join(dict.fromkeys(case.commit for case in cases))
    line = {
        "name": row.name,
        "cases": row.count,
        "failed": row.count - done.size,
        **(study.summarise(row.table, group.isel(case=done)) if done.size else {}),
        "commit": commit,
    }
    group.attrs = {
        "name": row.name,
        "row": json.dumps(dict(row.table), default=str, ensure_ascii=False),
        "definition": row.definition,
        "commit": commit,
        "seconds": float(group["seconds"].sum()),
        "line": json.dumps(line, ensure_ascii=False),
    }
    return group


def _described(study: Study, name: str) -> dict[str, str]:
    unit, long_name = _OWN_COLUMNS.get(name) or study.columns.get(name, ("", name))
    return {"units": unit, "long_name": long_name}


def _cases_of(group: xr.Dataset) -> dict[int, Case]:
    """The inverse of :func:`_row_group`."""
    names = [str(name) for name in group.data_vars if name not in RESERVED]
    columns = {name: group[name].values for name in (*names, *RESERVED)}
    return {
        index: Case(
            index,
            {name: float(columns[name][index]) for name in names} if not failed else {},
            float(columns["seconds"][index]),
            str(columns["commit"][index]),
            str(columns["message"][index]),
        )
        for index, failed in enumerate(columns["failed"])
    }


def _groups(tree: xr.DataTree) -> list[xr.Dataset]:
    """The rows of a result in their order."""
    return [tree[name].to_dataset() for name in _names_of_rows(tree)]


def _names_of_rows(tree: xr.DataTree) -> list[str]:
    """Of those groups that are rows, in their order."""
    numbers = (re.fullmatch(r"row_(\d+)", name) for name in tree.children)
    return [found[0] for found in sorted(filter(None, numbers), key=lambda found: int(found[1]))]


def draw_study(study: Study, tree: xr.DataTree, folder: Path, formats: Sequence[str]) -> list[Path]:
    """Draw the study's own figure, if its file has one; the files written."""
    if not study.has_figure or not formats:
        return []
    figure = study.figure(*stored_rows(tree))
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{study.name}.{ending}" for ending in formats]
    for path in paths:
        figure.savefig(path, metadata={"Title": figure_title(study.name)})
    return paths
