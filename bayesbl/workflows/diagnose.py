"""Recordings and the bench believed behind them in; what is missing, and both gaps, out."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import xarray as xr

from bayesbl.config.bench import load_bench
from bayesbl.config.diagnose import DiagnoseConfig
from bayesbl.config.loading import dump_config
from bayesbl.discrepancy.motion import even
from bayesbl.discrepancy.naming import Settings, diagnose
from bayesbl.errors import RecordingError
from bayesbl.recording.channels import ColumnSpec
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import Recording
from bayesbl.results.diagnosis import diagnosis_tree
from bayesbl.results.provenance import file_sha256, provenance
from bayesbl.workflows.compared import Problem, refused
from bayesbl.workflows.rigid import rigid_problem

Progress = Callable[[str, int, int], None]

FEWEST_SAMPLES = 200


def run_diagnose(config: DiagnoseConfig, progress: Progress | None = None) -> xr.DataTree:
    """Diagnose as configured; nothing is written.

    Raises
    ------
    UserError
        If bench or recordings cannot be used for this comparison.
    """
    problem = problem_of(config)
    settings = Settings(config.candidates.max_effects, config.candidates.false_alarm)
    found = diagnose(
        problem.comparison, problem.bench, settings, problem.remaining, problem.notes, progress
    )
    inputs = {str(entry.file): file_sha256(entry.file) for entry in config.recordings}
    inputs[str(config.bench)] = file_sha256(config.bench)
    tree = diagnosis_tree(found, config.interval.level)
    tree.attrs |= provenance(dump_config(config), config.run.seed, inputs)
    return tree


def problem_of(config: DiagnoseConfig) -> Problem:
    """Recordings read and checked, and put beside the bench."""
    if config.comparison.method == "forward":
        raise refused(
            "This comes later: it is not available in this version.",
            "[comparison] method",
            '"forward"',
            '"inverse" or "free_motion", with a rigid bench',
        )
    bench = load_bench(config.bench)
    recordings = [even(recording) for recording in _recordings(config)]
    return rigid_problem(config, bench, recordings)


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
