"""Studies: many independent cases in rows, over processes or a cluster, resumed where left.

What a study is stands in :mod:`bayesbl.runs.study_file`. ``result.nc`` holds all cases, a
group per row; ``table.csv`` a line per row.
"""

from __future__ import annotations

import csv
import io
import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from bayesbl.config.loading import dump_config
from bayesbl.config.study import StudyConfig
from bayesbl.errors import ResultError
from bayesbl.results.folder import (
    CONFIG_FILE,
    FIGURES,
    RESULT_FILE,
    SUMMARY_FILE,
    is_finished,
    new_result,
    require_free,
)
from bayesbl.results.provenance import git_commit, provenance
from bayesbl.results.store import OUTCOME, read_tree, write_json, write_text, write_tree
from bayesbl.runs.cases import Case, CaseStore, Job, run_cases
from bayesbl.runs.study_file import RESERVED, Study, Table, load_study

if TYPE_CHECKING:
    from bayesbl.measurement.task import StageProgress

TABLE_FILE = "table.csv"

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


def run_study(
    config: StudyConfig,
    *,
    force: bool = False,
    progress: StageProgress | None = None,
    say: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Run what is not finished of a study, write its output folder, and return the summary.

    A finished result is added to: its rows keep their cases, and the commit that made them. Where
    one of them would be lost, because it was defined otherwise or is gone from the configuration,
    the run is refused.

    Parameters
    ----------
    force
        Start over: every case is run again, and a finished result replaced.
    progress
        Called with (row, finished cases, all cases).
    say
        Told in a sentence what is taken over, what is run again, and on how many workers of a
        cluster.

    Raises
    ------
    UserError
        If the study, a row or the output folder cannot be used.
    """
    study, rows = prepare(config)
    output = config.run.output
    add = not force and is_finished(output)
    if add:
        _take_from_result(study, rows, output)
    require_free(output, force=force or add, also={TABLE_FILE})
    with CaseStore.beside(output, fresh=force) as store:
        for row in rows:
            _take_from_store(row, store, say)
        _finish(study, rows, config, store, progress, say)
        tree = _tree(study, rows, config)
        summary = summarise_study(tree)
        with new_result(output, force=force or add, also={TABLE_FILE}) as folder:
            write_tree(tree, folder / RESULT_FILE)
            write_json(summary, folder / SUMMARY_FILE)
            write_text(table_csv(summary["rows"]), folder / TABLE_FILE)
            write_text(dump_config(config), folder / CONFIG_FILE)
            _draw(study, tree, folder / FIGURES)
        store.clear()
    return summary


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


def describe(config: StudyConfig) -> str:
    """What would run, in words."""
    study, rows = prepare(config)
    return f"{study.path}, " + ", ".join(f'"{row.name}" {row.count} cases' for row in rows)


def summarise_study(tree: xr.DataTree) -> dict[str, Any]:
    """``summary.json`` of a study, from the result alone."""
    attributes = tree.attrs
    return {
        "kind": "study",
        "study": attributes["study"],
        "outcome": attributes[OUTCOME],
        "reason": None,
        "version": attributes["bayesbl_version"],
        "commit": attributes["git_commit"],
        "seed": int(attributes["seed"]),
        "rows": [
            {**json.loads(row.attrs["line"]), "seconds": float(row.attrs["seconds"])}
            for row in _groups(tree)
        ],
    }


def table_csv(lines: Sequence[Mapping[str, Any]]) -> str:
    """Lines of the table as CSV, six digits, the commit last; times are left to the summary."""
    columns = table_columns(lines)
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for line in lines:
        writer.writerow({column: cell(line.get(column)) for column in columns})
    return text.getvalue()


def table_columns(lines: Sequence[Mapping[str, Any]]) -> list[str]:
    """Columns of all lines in the order of their first appearance, the commit last."""
    columns = dict.fromkeys(column for line in lines for column in line)
    return [column for column in columns if column not in ("seconds", "commit")] + ["commit"]


def cell(value: object) -> str:
    """A value of the table as text."""
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def draw_study(tree: xr.DataTree, folder: Path) -> list[Path]:
    """Draw the study's own figure again, if its file has one."""
    config = tomllib.loads(tree.attrs["config"])
    return _draw(load_study(config["study"]), tree, folder)


def stored_rows(tree: xr.DataTree) -> tuple[list[dict[str, Any]], dict[str, xr.Dataset]]:
    """Lines of a result's table, and the cases of each row by its name."""
    groups = _groups(tree)
    lines = [json.loads(group.attrs["line"]) for group in groups]
    return lines, {group.attrs["name"]: group for group in groups}


def _take_from_result(study: Study, rows: Sequence[Row], output: Path) -> None:
    """Give rows the cases of a finished result that this run may add to, or refuse."""
    tree = read_tree(output)
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
                f'"{name}" ' + ("defined otherwise" if name in definitions else "not asked for")
                for name in lost
            ),
            expected="the rows as they were and others beside them, another folder (--out), or "
            "--force to start over",
        )
    if len(stored) == len(rows) and tree.attrs["study_sha256"] == study.sha256:
        require_free(output, also={TABLE_FILE})  # nothing is left to do
    for row in rows:
        if row.name in stored:
            row.cases = _cases_of(stored[row.name])


def _take_from_store(row: Row, store: CaseStore, say: Callable[[str], None]) -> None:
    """Give a row the cases that an earlier, unfinished run stored."""
    if row.cases:
        return
    found = store.take_over(row.name, row.definition)
    if found is None:
        say(f'Row "{row.name}" is defined otherwise than before: its cases are run again.')
    elif found:
        say(f'Row "{row.name}" goes on after {len(found)} of {row.count} cases.')
    row.cases = found or {}


def _finish(
    study: Study,
    rows: Sequence[Row],
    config: StudyConfig,
    store: CaseStore,
    progress: StageProgress | None,
    say: Callable[[str], None],
) -> None:
    """Run all cases that lack, each stored as soon as it ends."""
    by_name = {row.name: row for row in rows}
    jobs = [job for row in rows for job in row.jobs(config.run.seed)]
    run = config.run
    for job, case in run_cases(study, jobs, run.workers, git_commit(), run.scheduler, say):
        row = by_name[job.row]
        store.add(row.name, case)
        row.cases[case.index] = case
        if progress is not None:
            progress(row.name, len(row.cases), row.count)


def _tree(study: Study, rows: Sequence[Row], config: StudyConfig) -> xr.DataTree:
    groups = {f"row_{n}": _row_group(study, row) for n, row in enumerate(rows, start=1)}
    tree = xr.DataTree.from_dict(groups)
    tree.attrs = {
        "kind": "study",
        "study": study.name,
        "study_sha256": study.sha256,
        OUTCOME: "done",
        **provenance(dump_config(config), config.run.seed, {str(study.path): study.sha256}),
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
    names = sorted(tree.children, key=lambda name: int(name.removeprefix("row_")))
    return [tree[name].to_dataset() for name in names]


def _draw(study: Study, tree: xr.DataTree, folder: Path) -> list[Path]:
    if study.figure is None:
        return []
    figure = study.figure(*stored_rows(tree))
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{study.name}{suffix}" for suffix in (".pdf", ".png")]
    for path in paths:
        figure.savefig(path)
    return paths
