"""From a configuration of any kind to its output folder, and what can be told before it runs."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesbl.config.diagnose import DiagnoseConfig
from bayesbl.config.loading import config_from_options, dump_config, load_config
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.config.sections import RunConfig, SnapshotRecording
from bayesbl.config.study import StudyConfig
from bayesbl.config.sweep import SweepConfig
from bayesbl.errors import ConfigError, UserError
from bayesbl.results.folder import (
    AUGMENTED_BENCH,
    CONFIG_FILE,
    FIGURES,
    RESULT_FILE,
    SUMMARY_FILE,
    is_finished,
    new_result,
    require_free,
)

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.measurement.task import StageProgress
    from bayesbl.recording.types import Recording

Draw = Callable[["xr.DataTree", Path], object]
"""Draws the figures of a result into a folder; passed in, as figures are made from results."""

Summary = Mapping[str, Any]


def load_run(path: str | Path, *, kind: str | None = None, **options: object) -> RunConfig:
    """A configuration file with the options of the command line over it; ``None`` is not given.

    Raises
    ------
    ConfigError
        As :func:`bayesbl.config.loading.load_config`.
    """
    if kind_of(path) == "bench":
        raise ConfigError(
            "A bench is simulated on, not run.",
            file=path,
            found='kind = "bench"',
            expected='a configuration that names this bench, e.g. of kind = "simulate"',
        )
    config = load_config(path, kind=kind)
    given: dict[str, Any] = {o: value for o, value in options.items() if value is not None}
    return config_from_options(config.kind, (), path, **given) if given else config


def kind_of(path: str | Path) -> str:
    """What a file says of its kind; empty where it cannot, and loading will tell why."""
    try:
        kind = tomllib.loads(Path(path).read_text(encoding="utf-8-sig")).get("kind")
    except (OSError, ValueError, RecursionError):
        return ""
    return kind if isinstance(kind, str) else ""


def run(
    config: RunConfig,
    draw: Draw,
    *,
    force: bool = False,
    progress: StageProgress | None = None,
    say: Callable[[str], None] = print,
) -> Summary:
    """Run a configuration and write its output folder; the summary that was stored.

    Parameters
    ----------
    force
        Replace a finished result; start over where a run was left unfinished.
    say
        Told, in a sentence, what a study takes over or computes again, what a run goes on from,
        and what a search starts from.

    Raises
    ------
    UserError
        If the folder may not be written, or anything in the configuration cannot be used.
    """
    if isinstance(config, StudyConfig):
        from bayesbl.runs.study import run_study

        return run_study(config, force=force, progress=progress, say=say)
    _require_free(config, force)
    # Imported after the questions that can be answered at once: numba and xarray take a second.
    if isinstance(config, SweepConfig):
        from bayesbl.runs.sweep import run_sweep

        tree = run_sweep(config, progress, fresh=force)
    elif isinstance(config, DiagnoseConfig):
        from bayesbl.runs.diagnose import run_diagnose

        tree = run_diagnose(config, progress)
    elif isinstance(config, SnapshotConfig):
        return _measure(config, draw, force, progress, say)
    else:
        raise TypeError(f"no workflow for kind {config.kind!r}")
    return write_result(tree, config, draw, force=force)


def _measure(
    config: SnapshotConfig,
    draw: Draw,
    force: bool,
    progress: StageProgress | None,
    say: Callable[[str], None],
) -> Summary:
    """Measure, going on where an unfinished run of the same problem was left."""
    from bayesbl.measurement.routes import measure
    from bayesbl.measurement.task import problem_of_run
    from bayesbl.results.checkpoint import Checkpoint

    problem = problem_of_run(config)
    with Checkpoint.beside(config.run.output, problem, fresh=force) as checkpoint:
        if checkpoint.resumes:
            say("This goes on where an unfinished run was left.")
        try:
            tree = measure(config, progress, checkpoint, say)
        except UserError:
            checkpoint.clear()  # it would end the same way again
            raise
        return write_result(tree, config, draw, force=force, stored=checkpoint.clear)


def _require_free(config: RunConfig, force: bool) -> None:
    if is_finished(config.run.output):
        from bayesbl.results.checkpoint import forget

        forget(config.run.output)
    require_free(config.run.output, force=force)


def write_result(
    tree: xr.DataTree,
    config: RunConfig,
    draw: Draw,
    *,
    force: bool = False,
    stored: Callable[[], object] = lambda: None,
) -> Summary:
    """The output folder of a result, whole or not at all; its summary.

    Figures can be made again at once, what was computed cannot: where drawing fails, the result is
    stored with the figures drawn so far, and the failure raised only then, with a note that says
    so.

    Parameters
    ----------
    stored
        Called when the folder stands.
    """
    from bayesbl.results.store import write_json, write_text, write_tree
    from bayesbl.runs.summary import summarise

    summary = summarise(tree)
    with new_result(config.run.output, force=force) as folder:
        write_tree(tree, folder / RESULT_FILE)
        write_json(summary, folder / SUMMARY_FILE)
        write_text(dump_config(config), folder / CONFIG_FILE)
        if tree.attrs.get("augmented_bench"):
            write_text(tree.attrs["augmented_bench"], folder / AUGMENTED_BENCH)
        failure: Exception | None = None
        try:
            draw(tree, folder / FIGURES)
        except Exception as error:
            failure = error
    stored()
    if failure is not None:
        failure.add_note(
            f"The result is stored in {config.run.output}; only figures are missing. To draw them "
            f"again: bayesbl figures {config.run.output}"
        )
        raise failure
    return summary


@dataclass(slots=True)
class Plan:
    """What a configuration would do, in pairs of label and text, and what speaks against it."""

    lines: list[tuple[str, str]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    problems: list[UserError] = field(default_factory=list)

    def add(self, label: str, text: Callable[[], str | None]) -> None:
        """A line, or the problem that making it met; no line for ``None``."""
        try:
            line = text()
        except UserError as problem:
            self.problems.append(problem)
        else:
            if line is not None:
                self.lines.append((label, line))


def check(path: str | Path) -> Plan:
    """Everything that can be checked of a configuration without running it.

    Raises
    ------
    ConfigError
        If the file itself cannot be read or is not valid; what is wrong beyond it is in the plan.
    """
    kind = kind_of(path)
    plan = Plan([("kind", kind)])
    if kind == "bench":
        _check_bench(plan, Path(path))
        return plan
    if kind == "simulate":
        _check_simulation(plan, Path(path))
        return plan
    config = load_run(path)
    plan.lines += [("output", _output(config)), ("seed", str(config.run.seed))]
    if isinstance(config, StudyConfig):
        from bayesbl.runs.study import describe

        plan.add("study", lambda: describe(config))
    if isinstance(config, SnapshotConfig):
        _check_snapshots(plan, config)
    if isinstance(config, DiagnoseConfig):
        plan.add("comparison", partial(_check_diagnosis, config))
    if isinstance(config, SweepConfig):
        _check_bench(plan, config.bench)
        plan.add("gaps", partial(_gaps, config))
    return plan


def _output(config: RunConfig) -> str:
    """The output folder; a result that stands there stops a run, but is no fault of the file."""
    folder = config.run.output
    return f"{folder} (holds a finished result)" if is_finished(folder) else str(folder)


def _check_bench(plan: Plan, path: Path) -> None:
    from bayesbl.config.bench import load_bench

    bench = load_bench(path)
    plan.lines.append(("bench", f"drive {bench.drive}, gap form {bench.gap_form}"))


def _check_diagnosis(config: DiagnoseConfig) -> str:
    from bayesbl.runs.diagnose import describe_problem

    return describe_problem(config)


def _check_simulation(plan: Plan, path: Path) -> None:
    from bayesbl.config.bench import load_bench
    from bayesbl.config.simulate import load_simulation

    config = load_simulation(path)
    plan.add("bench", lambda: f"{config.bench}, gap form {load_bench(config.bench).gap_form}")
    for entry in config.recordings:
        told = f"{entry.file}, gap {entry.gap_rad:g} rad, {entry.rotations:g} rotations"
        plan.lines.append((f"recording {entry.name}", told))


def _gaps(config: SweepConfig) -> str:
    from bayesbl.config.bench import load_bench
    from bayesbl.runs.sweep import require_drawable

    require_drawable(config, load_bench(config.bench))
    gap = config.sweep.gap_rad
    return f"{gap.count} from {gap.low:g} to {gap.high:g} rad, {config.sweep.bench_draws} draws"


def _limit(limit_rad: float, range_rad: tuple[float, float]) -> str:
    from bayesbl.measurement.compatibility import require_plausible_limit

    require_plausible_limit(limit_rad, range_rad)
    return f"{1e3 * limit_rad:g} mrad"


def _check_snapshots(plan: Plan, config: SnapshotConfig) -> None:
    from bayesbl.measurement.compatibility import same_files
    from bayesbl.measurement.routes import route_of
    from bayesbl.measurement.task import curve_of, estimator_of, recording_of

    estimator, curve = estimator_of(config), curve_of(config)
    plan.lines += [
        ("curve", curve.name),
        ("estimator", f"search {estimator.search}, noise {estimator.noise_kind}"),
        ("interval", f"{100.0 * config.interval.level:g} %, {config.interval.kind}"),
    ]
    measurer = route_of(config.estimator.route).prepare(config)
    for label, text in measurer.describe():
        plan.add(label, text)

    def checked(entry: SnapshotRecording) -> str:
        recording = recording_of(entry, config)
        measurer.require_usable(recording)
        rate = 1.0 / recording.sampling_period_s
        sound.append(recording)
        plan.warnings += [f"{entry.name}: {note}" for note in recording.notes]
        return f"{entry.file}, {recording.duration_s:.4g} s at {rate:.4g} Hz"

    sound: list[Recording] = []
    for entry in config.recordings:
        plan.add(f"recording {entry.name}", partial(checked, entry))
    plan.warnings += [*same_files(sound), *measurer.notes()]
    plan.add("speed", partial(measurer.require_together, sound))
    if config.joint.limit_rad is not None:
        plan.add("limit", partial(_limit, config.joint.limit_rad, measurer.gap_range_rad))
