"""Recordings and the bench believed behind them in; what is missing, and both gaps, out."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import xarray as xr

from bayesbl.config.bench import load_bench
from bayesbl.config.diagnose import DiagnoseConfig
from bayesbl.config.loading import dump_config
from bayesbl.diagnosis.closed_loop.problem import forward_diagnosis, forward_problem
from bayesbl.diagnosis.problem import Problem
from bayesbl.diagnosis.rigid.naming import Settings, diagnose
from bayesbl.diagnosis.rigid.problem import rigid_problem
from bayesbl.errors import RecordingError
from bayesbl.recording.channels import ColumnSpec
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import Recording
from bayesbl.results.diagnosis import diagnosis_tree
from bayesbl.results.provenance import file_sha256, provenance
from bayesbl.runs.workflow import Options, Plan, Progress, Summary, run_into_folder

FEWEST_SAMPLES = 200


def run_diagnose(config: DiagnoseConfig, progress: Progress | None = None) -> xr.DataTree:
    """Diagnose as configured; nothing is written.

    Raises
    ------
    UserError
        If bench or recordings cannot be used for this comparison.
    """
    if config.comparison.method == "forward":
        tree = forward_diagnosis(
            config,
            load_bench(config.bench),
            list(_recordings(config)),
            None if progress is None else partial(progress, "candidates"),
        )
    else:
        problem = problem_of(config)
        settings = Settings(config.candidates.max_effects, config.candidates.false_alarm)
        found = diagnose(
            problem.comparison, problem.bench, settings, problem.remaining, problem.notes, progress
        )
        tree = diagnosis_tree(found, config.interval.level)
    inputs = {str(entry.file): file_sha256(entry.file) for entry in config.recordings}
    inputs[str(config.bench)] = file_sha256(config.bench)
    tree.attrs |= provenance(dump_config(config), config.run.seed, inputs)
    return tree


def problem_of(config: DiagnoseConfig) -> Problem:
    """Recordings read and checked, and put beside a rigid bench."""
    bench = load_bench(config.bench)
    return rigid_problem(config, bench, list(_recordings(config)))


def run(config: DiagnoseConfig, options: Options) -> Summary:
    """Diagnose, and write the output folder."""
    return run_into_folder(config, options, lambda work: run_diagnose(config, options.progress))


def describe(config: DiagnoseConfig, plan: Plan) -> None:
    """What would be compared, without comparing it."""
    plan.add("comparison", partial(_in_words, config))


def _in_words(config: DiagnoseConfig) -> str:
    if config.comparison.method == "forward":
        bench, recordings = load_bench(config.bench), list(_recordings(config))
        used, held_out, unknowns, _ = forward_problem(config, bench, recordings)
        free = ", ".join(dict.fromkeys(unknown.name for unknown in unknowns))
        return f"forward, {len(used)} to fit on, {len(held_out)} held out; unknown {free}"
    comparison = problem_of(config).comparison
    names = ", ".join(candidate.name for candidate in comparison.candidates)
    return f"{config.comparison.method}, {comparison.pieces[0].channel}; candidates {names}"


def _recordings(config: DiagnoseConfig) -> Iterator[Recording]:
    specs = dict(config.column_specs)
    for name in config.comparison.known_torque:
        specs.setdefault(name, ColumnSpec(name))
    for entry in config.recordings:
        recording = read_recording(entry.file, name=entry.name, columns=specs)
        if recording.samples < FEWEST_SAMPLES * (2 if entry.use == "split" else 1):
            raise RecordingError(
                "The recording is too short to tell an effect from noise.",
                file=entry.file,
                found=f"{recording.samples} samples",
                expected=f"at least {FEWEST_SAMPLES} to fit on, and as many to predict",
            )
        yield recording
