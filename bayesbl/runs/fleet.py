"""``kind = "fleet"``: measure every recording of every joint once; write tables and pages anew.

Answers are kept in a hidden folder beside the output folder, under the hash of all that determines
them: the recording, its joint's row, the settings and the code. So a new file costs its own
measurement and its joint's wear, and a killed run continues.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr

import bayesbl
from bayesbl.config.kinds import FleetConfig
from bayesbl.config.loading import dump_config
from bayesbl.fleet.inventory import Found, Joint, find_recordings, read_joints
from bayesbl.fleet.measured_joint import (
    REFUSED,
    JointAnswer,
    JointJob,
    MeasuredJoint,
    RecordingAnswer,
    measure_joint,
)
from bayesbl.fleet.plant_tables import (
    JOINT_COLUMNS,
    JOINTS_FILE,
    RECORDING_COLUMNS,
    RECORDINGS_FILE,
    Measured,
    joint_rows,
    pool,
    recording_row,
    require_tables,
    write_draws,
    write_table,
)
from bayesbl.fleet.pooled_rates import TypeRates
from bayesbl.progress import of_stage
from bayesbl.results.folder import (
    CONFIG_FILE,
    SUMMARY_FILE,
    is_finished,
    locked_sibling,
    new_result,
    require_free,
)
from bayesbl.results.provenance import git_commit
from bayesbl.results.store import Head, interval, write_json, write_text
from bayesbl.results.work import LARGEST_STORE_BYTES, STORE, WorkStore
from bayesbl.runs.cluster import run_jobs
from bayesbl.runs.workflow import Options, Plan

DRAWS_FOLDER = "draws.zarr"
KEPT = ".kept"  # suffix of the hidden folder of answers
MOST_URGENT = 20  # number of joints in the summary; the tables have all


class FleetSummary(Head):
    """``summary.json`` of a fleet.

    ``recordings`` counts them by outcome, ``types`` has the pooled rates, and ``most_urgent`` rows
    of ``joints.parquet``.
    """

    kind: Literal["fleet"]
    joints: int
    with_rate: int
    recordings: dict[str, int]
    types: dict[str, dict[str, Any]]
    alarms: list[str]
    most_urgent: list[dict[str, Any]]
    level: float
    interval_kind: str
    pool_by: str | None
    decide_before: str | None


@dataclass(frozen=True, slots=True)
class KeptJoint:
    """A joint's answer with the rows of its recordings."""

    answer: JointAnswer
    rows: tuple[dict[str, Any], ...]


def describe(config: FleetConfig, plan: Plan) -> None:
    """What would be measured."""

    def counted() -> str:
        joints = read_joints(config.fleet)
        recordings = find_recordings(config.fleet, joints)
        bad = sum(one.reason is not None for one in recordings)
        unusable = f", {bad} that cannot be used" if bad else ""
        return f"{len(joints)}, {len(recordings) - bad} recordings{unusable}"

    plan.add("tables", require_tables)
    plan.add("joints", counted)


def run(config: FleetConfig, options: Options) -> FleetSummary:
    """Measure what is new, and write the output folder anew.

    Raises UserError if the inventory cannot be used, or the folder holds anything but a fleet's
    result.
    """
    output = config.run.output
    _require_own(output, options.force)
    joints = read_joints(config.fleet)
    recordings = find_recordings(config.fleet, joints)
    with locked_sibling(output, KEPT) as folder:
        jobs, refused = _jobs(config, joints, recordings)
        store = WorkStore(folder)
        with new_result(output, force=True) as new:
            summary = _write(config, jobs, refused, _answers(config, jobs, store, options), new)
            # The pages are made of the tables alone.
            options.draw(xr.DataTree(xr.Dataset(attrs={"kind": "fleet"})), new, options.formats)
    WorkStore.shared(output.parent / STORE).keep_latest(size_bytes=LARGEST_STORE_BYTES)
    return summary


def _require_own(output: Path, force: bool) -> None:
    """Require a free folder, or that of a fleet, whose result every run replaces."""
    if not is_finished(output):
        require_free(output)
        return
    kind = None
    with suppress(OSError, ValueError):
        kind = json.loads((output / SUMMARY_FILE).read_text(encoding="utf-8")).get("kind")
    require_free(output, force=force or kind == "fleet")


def _jobs(
    config: FleetConfig, joints: Sequence[Joint], recordings: Iterable[Found]
) -> tuple[list[JointJob], list[Found]]:
    """A job for each joint, and the recordings that cannot be measured."""
    recordings = [one.read() for one in recordings]
    owners: dict[str | None, list[Found]] = defaultdict(list)
    for one in recordings:
        owners[one.sha256].append(one)
    of_joint: dict[str, list[Found]] = defaultdict(list)
    refused: list[Found] = []
    for one in recordings:
        reason = one.reason or _copied(one, owners[one.sha256])
        if reason is None:
            of_joint[one.joint].append(one)
        else:
            refused.append(replace(one, reason=reason))
    return [JointJob.of(config, joint, of_joint[joint.name]) for joint in joints], refused


def _copied(one: Found, alike: Sequence[Found]) -> str | None:
    """Why a duplicate is not measured; the first of one joint is."""
    strange = next((other for other in alike if other.joint != one.joint), None)
    if strange is None and one is alike[0]:
        return None
    whose = f"joint {strange.joint}, {strange.date}" if strange else alike[0].date
    neither = ", so it counts for neither" if strange else ""
    return f"Its file is to the last byte that of {whose}{neither}. Was a file copied by mistake?"


def _answers(
    config: FleetConfig, jobs: Sequence[JointJob], store: WorkStore, options: Options
) -> Iterator[tuple[JointJob, KeptJoint]]:
    """Joints with their answers: first the kept ones, then those measured now, as they end. Of the
    latter, recordings that earlier runs measured are known.

    At the end, answers that no file leads to any more are deleted.
    """
    lacking = []
    for job in jobs:
        kept = store.recall("joint", job.problem(), KeptJoint)
        if kept is not None:
            yield job, kept
            continue
        numbers = range(len(job.recordings))
        found = (store.recall("recording", job.problem_of(n), RecordingAnswer) for n in numbers)
        known = {n: answer for n, answer in enumerate(found) if answer is not None}
        lacking.append(replace(job, known=known))
    if lacking:
        new = sum(len(job.recordings) - len(job.known) for job in lacking)
        options.say(
            f"{new} recordings to measure, {len(lacking)} of {len(jobs)} joints to look at."
        )
    done, report = len(jobs) - len(lacking), of_stage(options.progress, "Joints")
    report(done, len(jobs))
    for job, (answers, wear) in _measured(config, lacking, options.say):
        for number, answer in enumerate(answers):
            if number not in job.known and answer.lasting:
                store.keep("recording", job.problem_of(number), answer)
        rows = tuple(
            recording_row(answer, job.joint, number in wear.used, config.interval)
            for number, answer in enumerate(answers)
        )
        kept = KeptJoint(wear, rows)
        if wear.lasting:
            store.keep("joint", job.problem(), kept)
        done += 1
        report(done, len(jobs))
        yield job, kept
    of_joints = [("joint", job.problem()) for job in jobs]
    of_each = [("recording", job.problem_of(n)) for job in jobs for n in range(len(job.recordings))]
    store.keep_only({store.address_of(*step) for step in of_joints + of_each})


def _measured(
    config: FleetConfig, jobs: Sequence[JointJob], say: Callable[[str], None]
) -> Iterator[tuple[JointJob, MeasuredJoint]]:
    """Joints as they end, in any order; a single worker measures in this process."""
    if (config.run.scheduler is None and min(config.run.workers, len(jobs)) <= 1) or not jobs:
        for job in jobs:
            yield job, measure_joint(job)
        return
    files = sorted({file for job in jobs for file in job.named})
    yield from run_jobs(measure_joint, jobs, files, config.run, say, "joints")


def _write(
    config: FleetConfig,
    jobs: Sequence[JointJob],
    refused: Sequence[Found],
    answers: Iterable[tuple[JointJob, KeptJoint]],
    folder: Path,
) -> FleetSummary:
    """Write tables, draws, summary and configuration of a fleet, from answers in any order."""
    write_draws(folder / DRAWS_FOLDER, {}, {})
    rows: list[dict[str, Any]] = []
    of_joint: dict[str, Measured] = {}
    broken = Counter(one.joint for one in refused)
    for job, kept in answers:
        for one, row in zip(job.recordings, kept.rows, strict=True):
            rows.append({**row, **one.identity})
        dates = tuple(one.date for one in job.recordings)
        outcomes = tuple(str(row["outcome"]) for row in kept.rows)
        outcomes += (REFUSED,) * broken[job.joint.name]
        _write_draws(folder / DRAWS_FOLDER / job.joint.name, job, kept.answer)
        # The draws of single recordings are on disk, and are not needed any more.
        now = None if kept.answer.gap_rad is None else kept.answer.gap_rad[-1:]
        answer = replace(kept.answer, gap_rad=now)
        of_joint[job.joint.name] = Measured(job.joint, answer, dates, outcomes)
    for one in refused:
        row = recording_row(RecordingAnswer(REFUSED, one.reason), None, False, config.interval)
        rows.append({**row, **one.identity})
    rows.sort(key=lambda row: (row["joint"], row["date"], row["file"]))
    asked = config.fleet
    measured = [of_joint[job.joint.name] for job in jobs]
    types, borrowed = pool(measured, asked.pool_by, config.run.seed, asked.covariates)
    of_joints = joint_rows(measured, borrowed, config.interval, asked.decide_before)
    write_table(rows, RECORDING_COLUMNS, folder / RECORDINGS_FILE)
    write_table(of_joints, JOINT_COLUMNS, folder / JOINTS_FILE)
    summary = summary_of(config, rows, of_joints, types)
    write_json(summary, folder / SUMMARY_FILE)
    write_text(dump_config(config), folder / CONFIG_FILE)
    return summary


def _write_draws(folder: Path, job: JointJob, answer: JointAnswer) -> None:
    if answer.gap_rad is None:
        return
    dates = np.array([job.recordings[number].date for number in answer.used], dtype="U10")
    arrays: dict[str, Any] = {
        "date": (("recording",), dates),
        "delta_rad": (("recording", "draw"), answer.gap_rad),
    }
    for name in ("rate_rad_per_year", "rate_now_rad_per_year", "years_to_limit"):
        values = getattr(answer.wear, name, None)
        if values is not None:
            arrays[name] = (("wear_draw",), values)
    write_draws(folder, arrays, {"reason": answer.reason or "", "route": answer.route})


def summary_of(
    config: FleetConfig,
    rows: Sequence[Mapping[str, Any]],
    joints: Sequence[Mapping[str, Any]],
    types: Mapping[str, TypeRates],
) -> FleetSummary:
    """``summary.json`` from the rows of both tables."""
    of, before = config.interval, config.fleet.decide_before
    counted = Counter(str(row["outcome"]) for row in rows)
    any_gap = any(row["delta_rad_median"] is not None for row in rows)
    rates = {
        name: {
            "joints": of_type.joints,
            "median_rad_per_year": interval(of_type.median_rad_per_year, of.level, of.kind),
            "spread": interval(of_type.spread, of.level, of.kind),
            "law": dict(of_type.law),
            "own": interval(of_type.own, of.level, of.kind),
            "covariates": {
                key: {"sd": one.sd, "factor": interval(one.draws, of.level, of.kind)}
                for key, one in of_type.factors.items()
            },
        }
        for name, of_type in types.items()
    }
    return {
        "kind": "fleet",
        "outcome": "converged" if any_gap else "withheld",
        "reason": None if any_gap else "No recording gives a gap: see reason in the tables.",
        "warnings": [],
        "version": bayesbl.__version__,
        "commit": git_commit(),
        "seed": config.run.seed,
        "joints": len(joints),
        "with_rate": sum(row["rate_rad_per_year_median"] is not None for row in joints),
        "recordings": dict(counted),
        "types": rates,
        "alarms": [str(row["joint"]) for row in joints if row["alarm"]],
        "most_urgent": [dict(row) for row in joints[:MOST_URGENT]],
        "level": of.level,
        "interval_kind": of.kind,
        "pool_by": config.fleet.pool_by,
        "decide_before": None if before is None else before.isoformat(),
    }
