"""Recordings and the bench believed behind them in; what is missing, and the model error, out."""

from __future__ import annotations

from collections.abc import Iterator

import xarray as xr

from bayesbl.config.diagnose import DiagnoseConfig
from bayesbl.diagnosis.diagnosis import Diagnosis
from bayesbl.diagnosis.groups import declared_groups, diagnosis_tree
from bayesbl.diagnosis.methods import METHODS
from bayesbl.diagnosis.summary import summarise_diagnosis as summarise
from bayesbl.diagnosis.task import Task
from bayesbl.errors import RecordingError
from bayesbl.recording.channels import ColumnSpec
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import Recording
from bayesbl.results.identified import bench_from
from bayesbl.results.provenance import provenance_of
from bayesbl.results.work import WorkStore
from bayesbl.runs.workflow import Options, Plan, settings_of

__all__ = ["ATTRIBUTES", "declared_groups", "describe", "make", "summarise", "task_of"]

ATTRIBUTES = ("outcome", "diagnosis")

FEWEST_SAMPLES = 200


def make(config: DiagnoseConfig, options: Options, work: WorkStore) -> xr.DataTree:
    """Diagnose as configured; nothing is written but finished work.

    Raises
    ------
    UserError
        If bench or recordings cannot be used for this comparison.
    """
    task = task_of(config)
    found = work.get(
        "diagnosis",
        (settings_of(config), task.bench, task.recordings),
        lambda: METHODS[config.comparison.method](task).diagnose(options.progress),
        Diagnosis,
    )
    tree = diagnosis_tree(found, config.interval.level, config.interval.kind)
    tree.attrs |= provenance_of(config)
    return tree


def describe(config: DiagnoseConfig, plan: Plan) -> None:
    """What would be compared, without comparing it."""
    method = METHODS[config.comparison.method]
    plan.add("comparison", lambda: method(task_of(config)).in_words)


def task_of(config: DiagnoseConfig) -> Task:
    """Bench and recordings, read and long enough to be compared."""
    return Task(config, bench_from(config.bench), tuple(_recordings(config)))


def _recordings(config: DiagnoseConfig) -> Iterator[Recording]:
    specs = dict(config.column_specs)
    for name in config.comparison.known_torque:
        specs.setdefault(name, ColumnSpec(name))
    for entry in config.recordings:
        recording = read_recording(entry.file, name=entry.name, columns=specs)
        if recording.samples < FEWEST_SAMPLES * (2 if entry.use == "split" else 1):
            raise RecordingError(
                "The recording is too short to separate an effect from noise.",
                file=entry.file,
                found=f"{recording.samples} samples",
                expected=f"at least {FEWEST_SAMPLES} to fit on, and as many to predict",
            )
        yield recording
