"""Studies: many independent cases in rows, over processes or a cluster, resumed where left.

``result.nc`` holds all cases, a group per row; ``table.csv`` a line per row. A study file says how
one independent case of a row is run. It defines two functions::

    def run_case(row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]: ...
        # One case: named numbers. ``seed`` belongs to this case alone. A UserError that leaves
        # it is recorded as a failed case; anything else stops the study, as an error of its file.

    def summarise(row, cases: xr.Dataset) -> Mapping[str, float | str]: ...
        # The row's line of the table, from its cases that did not fail (dimension ``case``).

and may define::

    def count(row) -> int: ...
        # How many independent cases the row has, if it is not what the row says as ``cases``.

    class Row(pydantic.BaseModel): ...
        # What a row may say; the functions then get it in place of the plain table.

    COLUMNS: Mapping[str, tuple[str, str]]
        # Unit and long name of what the cases return.

    def figure(table, cases) -> matplotlib.figure.Figure: ...
        # From the table's lines and the cases of each row by name.

Cases run in other processes, maybe on other machines, on one thread each, in any order. What is
costly and shared by the cases of a row goes into a function under ``functools.cache``.
"""

from __future__ import annotations

import ast
import csv
import hashlib
import importlib.util
import io
import json
import os
import sys
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
import xarray as xr
from pydantic import BaseModel, ValidationError

from bayesbl.config.kinds import StudyConfig
from bayesbl.config.loading import config_error, problems_of
from bayesbl.errors import ConfigError, UserError, WorkerError
from bayesbl.progress import of_stage
from bayesbl.results.folder import figure_title, replacing
from bayesbl.results.provenance import file_sha256, git_commit, provenance_of
from bayesbl.results.store import OUTCOME, Head, json_text, summary_of
from bayesbl.results.work import WorkStore
from bayesbl.runs.cluster import run_jobs
from bayesbl.runs.workflow import Options, Plan, work_of, write_result

Table = Mapping[str, Any]  # A row as the configuration states it
REQUIRED = ("run_case", "summarise")

OWN_COLUMNS = {
    "failed": ("1", "1 where the case failed, and has no values"),
    "message": ("", "why the case failed"),
    "seconds": ("s", "time that the case took"),
}
"""Unit and long name of what the runner stores of every case besides the study's numbers."""


@dataclass(frozen=True)
class Study:
    """A study file that was loaded."""

    path: Path
    module: ModuleType

    @property
    def name(self) -> str:
        """File name without suffix."""
        return self.path.stem

    def row(self, table: Table) -> Any:
        """A row as the study's functions take it. Raises ConfigError with all that ``Row``
        refuses."""
        model: type[BaseModel] | None = getattr(self.module, "Row", None)
        if model is None:
            return dict(table)
        known = {k: v for k, v in table.items() if k != "name" or "name" in model.model_fields}
        try:
            return model.model_validate(known)
        except ValidationError as error:
            row = f'[[rows]] "{table["name"]}" '
            problems = [problem.at(ConfigError, row) for problem in problems_of(error, model)]
            raise config_error(problems, None) from None

    def count(self, table: Table) -> int:
        """Number of cases in a row."""
        with error_of(self.path, f'in count, row "{table["name"]}"'):
            row, own = self.row(table), getattr(self.module, "count", None)
            count = table.get("cases") if own is None else own(row)
        if not isinstance(count, int) or count < 1:
            raise ConfigError(
                "A row needs cases.",
                file=self.path,
                where=f'cases of row "{table["name"]}"',
                found=repr(count),
                expected="a whole number, 1 or more",
            )
        return count

    def run_case(self, table: Table, index: int, seed: np.random.SeedSequence) -> dict[str, float]:
        """Run one case."""
        values = self.module.run_case(self.row(table), index, seed)
        if taken := sorted(values.keys() & OWN_COLUMNS.keys()):
            raise ValueError(
                f"run_case returns names that the runner uses itself: {', '.join(taken)}"
            )
        return {str(name): float(value) for name, value in values.items()}

    def summarise(self, table: Table, cases: xr.Dataset) -> dict[str, float | int | str]:
        """The row's line of the table, in plain Python values."""
        with error_of(self.path, f'in summarise, row "{table["name"]}"'):
            line = {
                str(name): value.item() if isinstance(value, np.generic) else value
                for name, value in self.module.summarise(self.row(table), cases).items()
            }
            json.dumps(line)  # as it is stored
        return line

    def definition(self, table: Table, seed: int) -> str:
        """What determines a row's cases besides the package's code: table, study's code and seed.

        Files that a row names count by their content, wherever they are.
        """
        said = {
            key: [Path(value).name, file_sha256(value)] if _is_file(value) else value
            for key, value in table.items()
        }
        with error_of(self.path, "while its imports were read"):
            code = _code_of(self.path)
        return json.dumps([said, sorted(code.values()), seed], sort_keys=True, default=str)


def load_study(path: str | Path) -> Study:
    """Load a study file. Raises ConfigError if it fails, or lacks one of the two functions."""
    path = Path(path)
    # Registered under a name of its own: pydantic and pickle look modules up there.
    name = f"bayesbl_study_{path.stem}"
    specification = importlib.util.spec_from_file_location(name, path)
    if specification is None or specification.loader is None:
        raise ConfigError("This is not a study.", file=path, expected="a Python file, .py")
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module
    if (beside := str(path.absolute().parent)) not in sys.path:
        sys.path.append(beside)  # for modules that the study imports, as when it runs as a script
    with error_of(path, "while it was loaded"):
        specification.loader.exec_module(module)
    lacking = [f for f in REQUIRED if not callable(getattr(module, f, None))]
    if lacking:
        raise ConfigError(
            "The study file lacks a function.",
            file=path,
            found=f"no {' and no '.join(lacking)}",
            expected=f"functions {', '.join(REQUIRED)}",
        )
    return Study(path, module)


_study_in = cache(load_study)


@contextmanager
def error_of(path: Path, when: str) -> Iterator[None]:
    """Turn any exception of a study file's code, even ``sys.exit``, into an error of this file.

    A :class:`UserError` passes, because the file raises it in its own words.
    """
    try:
        yield
    except (UserError, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise ConfigError(
            f"The study file failed {when}.",
            file=path,
            where=_line_of(error, path),
            found=f"{type(error).__name__}: {error}",
        ) from error


def _code_of(study: Path) -> dict[str, str]:
    """SHA-256 of a study file and of all modules beside it that it imports, by file name."""
    found: dict[str, str] = {}
    waiting = [study]
    while waiting:
        file = waiting.pop()
        if file.name in found or not file.is_file():
            continue
        found[file.name] = file_sha256(file)
        for node in ast.walk(ast.parse(file.read_bytes())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            waiting += [study.with_name(f"{name.partition('.')[0]}.py") for name in names]
    return found


def seed_of_case(seed: int, row: str, index: int) -> np.random.SeedSequence:
    """Seed of a case, from the run's seed and the row's name, independent of other rows."""
    words = hashlib.sha256(row.encode()).digest()[:16]
    return np.random.SeedSequence([seed, int.from_bytes(words, "little")], spawn_key=(index,))


def _is_file(value: Any) -> bool:
    return isinstance(value, str) and os.path.isfile(value)


def _line_of(error: BaseException, path: Path) -> str | None:
    """The last line of the study file that an exception passed through."""
    if isinstance(error, SyntaxError) and error.lineno is not None:
        return f"line {error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(path)]
    return f"line {lines[-1]}" if lines else None


@dataclass(frozen=True, slots=True)
class Case:
    """A finished case; ``values`` are empty and ``message`` is set if it failed."""

    index: int
    values: Mapping[str, float]
    seconds: float
    message: str = ""


@dataclass(frozen=True, slots=True)
class Job:
    """A case to run; ``seed`` is the study's."""

    table: Table
    index: int
    seed: int

    @property
    def row(self) -> str:
        """The row's name."""
        return str(self.table["name"])

    @property
    def in_words(self) -> str:
        """Name of the case."""
        return f'case {self.index} of row "{self.row}"'


def run_case(path: str, job: Job) -> Case:
    """Run a case of the study in a file. A :class:`UserError` becomes the case's message."""
    study = _study_in(path)
    start = time.perf_counter()
    values, message = {}, ""
    seed = seed_of_case(job.seed, job.row, job.index)
    with error_of(study.path, f"in {job.in_words}"):
        try:
            values = study.run_case(job.table, job.index, seed)
        except UserError as error:
            message = str(error)
    return Case(job.index, values, time.perf_counter() - start, message)


def files_of_study(study: Study, jobs: Sequence[Job]) -> list[str]:
    """The study file and every file that the rows of these cases name."""
    named = (value for job in jobs for value in job.table.values() if _is_file(value))
    return list(dict.fromkeys([str(study.path), *named]))


TABLE_FILE = "table.csv"
_FORMULA = ("=", "+", "-", "@", "\t", "\n")


@dataclass(slots=True)
class Row:
    """A row with its finished cases, by index."""

    table: Table
    count: int
    definition: str
    cases: dict[int, Case] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return str(self.table["name"])


def run(config: StudyConfig, options: Options) -> StudySummary:
    """Run the cases of a study that no run has finished, write its output folder, and return the
    summary.

    A case is the same as long as the definition of its row is. Raises UserError if the study, a row
    or the output folder cannot be used.
    """
    study, rows = prepare(config)
    with work_of(config, options) as work:
        for row in rows:
            kept = (work.recall("case", (row.definition, n), Case) for n in range(row.count))
            row.cases = {case.index: case for case in kept if case is not None}
            if row.cases:
                options.say(f'Row "{row.name}" has {len(row.cases)} of {row.count} cases already.')
        _finish(study, rows, config, work, options)
        tree = _tree(study, rows, config)
        summary: StudySummary = summary_of(tree)
        drawn = replace(options, draw=partial(draw_study, study))
        write_result(tree, summary, config, drawn, {TABLE_FILE: table_csv(summary["rows"])})
    return summary


def describe(config: StudyConfig, plan: Plan) -> None:
    """What would run."""

    def told() -> str:
        study, rows = prepare(config)
        return f"{study.path}, " + ", ".join(f'"{row.name}" {row.count} cases' for row in rows)

    plan.add("study", told)


def prepare(config: StudyConfig) -> tuple[Study, list[Row]]:
    """The study with its validated rows. ConfigError if it cannot be loaded, or refuses one."""
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


def table_csv(lines: Sequence[Mapping[str, Any]]) -> str:
    """The table as CSV with six digits, the commit last, without times.

    A text that a spreadsheet would take for a formula gets an apostrophe in front.
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
    """Columns in the order of their first appearance, the commit last."""
    columns = dict.fromkeys(column for line in lines for column in line)
    return [column for column in columns if column not in ("seconds", "commit")] + ["commit"]


def cell(value: object) -> str:
    """A value of the table as text."""
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def stored_rows(tree: xr.DataTree) -> tuple[list[dict[str, Any]], dict[str, xr.Dataset]]:
    """Lines of a result's table, and the cases of each row by name."""
    names = sorted(tree.children, key=lambda name: int(name.removeprefix("row_")))
    groups = [tree[name].to_dataset() for name in names]
    lines = [json.loads(group.attrs["line"]) for group in groups]
    return lines, {group.attrs["name"]: group for group in groups}


def _finish(
    study: Study, rows: Sequence[Row], config: StudyConfig, work: WorkStore, options: Options
) -> None:
    """Run all missing cases, in any order, and store each as soon as it ends."""
    by_name = {row.name: row for row in rows}
    jobs = [
        Job(row.table, index, config.run.seed)
        for row in rows
        for index in range(row.count)
        if index not in row.cases
    ]
    if not jobs:
        return
    row = by_name[jobs[0].row]
    of_stage(options.progress, row.name)(len(row.cases), row.count)
    run, files = partial(run_case, str(study.path)), files_of_study(study, jobs)
    try:
        for job, case in run_jobs(run, jobs, files, config.run, options.say, "cases"):
            row = by_name[job.row]
            if not case.message:  # what refused it may be gone the next time
                work.keep("case", (row.definition, case.index), case)
            if case.message and not any(other.message for other in row.cases.values()):
                options.say(f'Row "{row.name}": case {case.index} failed: {case.message}')
            row.cases[case.index] = case
            of_stage(options.progress, row.name)(len(row.cases), row.count)
    except WorkerError:
        raise ConfigError(
            "A process that ran cases of this study died.",
            file=study.path,
            expected="cases that return, and memory enough for one in each worker",
        ) from None


def _tree(study: Study, rows: Sequence[Row], config: StudyConfig) -> xr.DataTree:
    groups = {f"row_{n}": _row_group(study, row) for n, row in enumerate(rows, start=1)}
    tree = xr.DataTree.from_dict(groups)
    lines = [
        {**json.loads(group.attrs["line"]), "seconds": group.attrs["seconds"]}
        for group in groups.values()
    ]
    tree.attrs = {
        "kind": "study",
        "summary": json_text({"study": study.name, "rows": lines}),
        OUTCOME: "done",
        **provenance_of(config),
    }
    return tree


def _row_group(study: Study, row: Row) -> xr.Dataset:
    """All cases of a row with its line of the table."""
    cases = [row.cases[index] for index in range(row.count)]
    names = dict.fromkeys(name for case in cases for name in case.values)

    def described(name: str) -> dict[str, str]:
        stated = getattr(study.module, "COLUMNS", {})
        unit, long_name = OWN_COLUMNS.get(name) or stated.get(name, ("", name))
        return {"units": unit, "long_name": long_name}

    columns: dict[str, Sequence[float] | Sequence[str]] = {
        name: [case.values.get(name, np.nan) for case in cases] for name in names
    }
    columns["failed"] = [float(bool(case.message)) for case in cases]
    columns["message"] = [case.message for case in cases]
    columns["seconds"] = [case.seconds for case in cases]
    group = xr.Dataset(
        {name: ("case", values, described(name)) for name, values in columns.items()},
        {"case": np.arange(row.count)},
    )
    done = np.flatnonzero(group["failed"].values == 0.0)
    line = {
        "name": row.name,
        "cases": row.count,
        "failed": row.count - done.size,
        **(study.summarise(row.table, group.isel(case=done)) if done.size else {}),
        "commit": git_commit(),
    }
    group.attrs = {
        "name": row.name,
        "row": json.dumps(dict(row.table), default=str, ensure_ascii=False),
        "seconds": float(group["seconds"].sum()),
        "line": json.dumps(line, ensure_ascii=False),
    }
    return group


def draw_study(study: Study, tree: xr.DataTree, folder: Path, formats: Sequence[str]) -> list[Path]:
    """Draw the study's own figure, if its file has one; return the files."""
    if not hasattr(study.module, "figure") or not formats:
        return []
    with error_of(study.path, "in figure"):
        figure = study.module.figure(*stored_rows(tree))
    paths = [folder / f"{study.name}.{ending}" for ending in formats]
    for path in paths:
        with replacing(path) as new:
            figure.savefig(new, metadata={"Title": figure_title(study.name)})
    return paths
