"""The commands as functions, which return results that print, plot and give their numbers.

Options that are not given come from ``config``, or are the defaults of the command line.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from bayesbl.arguments import (
    Dates,
    File,
    Formats,
    Names,
    RecordingLike,
    Takes,
    Tree,
    as_path,
    checked,
)
from bayesbl.config.sections import RunConfig
from bayesbl.errors import ResultError

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.presentation.result_object import (
        ComparisonResult,
        DiagnosisResult,
        FitResult,
        IdentificationResult,
        Result,
        SweepResult,
    )
    from bayesbl.runs.kinds import Summary

Route = Literal["auto", "direct", "amplitude", "torque_ramp", "two_encoders"]


def _as_bench(value: Any) -> Any:
    from bayesbl.bench.bench import Bench

    return value if isinstance(value, Bench) else as_path(value)


BenchLike = Annotated[Any, Takes("the path of a bench file or result, or a Bench", _as_bench)]
Configuration = Annotated[
    str | Path | RunConfig,
    Takes(
        "a path: str or pathlib.Path, or a configuration that load_config() has read",
        lambda value: value if isinstance(value, RunConfig) else as_path(value),
    ),
]


@checked
def fit(
    recording: RecordingLike,
    *,
    config: File | None = None,
    bench: BenchLike | None = None,
    curve: File | None = None,
    route: Route | None = None,
    limit: str | Mapping[str, object] | None = None,
    limit_rad: float | None = None,
    gear_ratio: float | None = None,
    upright: bool | None = None,
    level: float | None = None,
    start_from: File | None = None,
    check_sampler: bool | None = None,
    seed: int | None = None,
    workers: int | None = None,
    progress: bool = False,
) -> FitResult:
    """Measure the gap in one recording; nothing is written.

    Parameters
    ----------
    recording
        A file, or a recording in memory: a pandas ``DataFrame``, an xarray ``Dataset``, a
        ``Recording``, a mapping of names to arrays, or a pair of arrays (time in s, motor speed in
        rpm). Other column names and units are mapped by ``config``.
    config
        A configuration file that the other arguments override.
    bench, curve
        What δ is based on: a bench file or a ``Bench``; or the result of a sweep, or
        ``"published"`` for the paper's curve.
    limit
        Repair limit as data sheets state it, such as ``"3 arcmin play"``.
    limit_rad
        Repair limit for the gap δ, in rad at the load.
    upright
        Gravity does not turn the joint: its axis is vertical, or its load is balanced.
    level
        Probability of intervals.
    start_from
        An earlier result; its optimum starts the search.
    progress
        Show bars on a terminal.

    Returns
    -------
    With groups ``posterior`` (``delta_rad`` in rad, ``amplitude_rpm`` in rpm, …, dimensions
    ``chain`` and ``draw``), ``sample_stats``, ``observed_data`` and more, units on every variable.

    Raises
    ------
    UserError
        If the recording or the configuration cannot be used.
    """
    given = locals()
    result: FitResult = _run_options("fit", [given.pop("recording")], **given)
    return result


@checked
def compare(
    first: RecordingLike,
    *later: RecordingLike,
    config: File | None = None,
    bench: BenchLike | None = None,
    curve: File | None = None,
    route: Route | None = None,
    dates: Dates = (),
    limit: str | Mapping[str, object] | None = None,
    limit_rad: float | None = None,
    before: date | None = None,
    gear_ratio: float | None = None,
    upright: bool | None = None,
    level: float | None = None,
    start_from: File | None = None,
    check_sampler: bool | None = None,
    seed: int | None = None,
    workers: int | None = None,
    progress: bool = False,
) -> ComparisonResult:
    """Measure the gap in each recording of one joint, and its change; nothing is written.

    Other arguments are as in :func:`fit`.

    Parameters
    ----------
    first, later
        Recordings in the order they were taken, at least two.
    dates
        When each was taken. With dates, the result has a group ``wear``.
    before
        A date: the result then has the probability that the gap passes its limit before it.

    Returns
    -------
    As :func:`fit`, with a dimension ``snapshot``, and a group ``change`` (``change_rad``, last
    minus first, in rad).

    Raises
    ------
    UserError
        If a recording or the configuration cannot be used.
    """
    given = locals()
    recordings = [given.pop("first"), *given.pop("later")]
    result: ComparisonResult = _run_options("compare", recordings, **given)
    return result


@checked
def identify(
    *recordings: RecordingLike,
    config: File | None = None,
    bench: BenchLike | None = None,
    effects: Names | None = None,
    dates: Dates = (),
    level: float | None = None,
    seed: int | None = None,
    workers: int | None = None,
    progress: bool = False,
) -> IdentificationResult:
    """Find the bench of a joint from its data sheet and recordings; nothing is written.

    Without recordings, those of ``config`` are used. Other arguments are as in
    :func:`compare`.

    Parameters
    ----------
    bench
        The data sheet: a bench file with tolerances.
    effects
        Effects that the data sheet lacks: ``"catalogue"`` to search for them, or names to fit.

    Raises
    ------
    UserError
        If data sheet, recordings or configuration cannot be used.
    """
    given = locals()
    if effects not in (None, "catalogue"):
        given["effects"] = list(effects or ())
    result: IdentificationResult = _run_options("identify", given.pop("recordings"), **given)
    return result


@checked
def diagnose(
    *recordings: RecordingLike,
    config: File | None = None,
    bench: BenchLike | None = None,
    level: float | None = None,
    seed: int | None = None,
    workers: int | None = None,
    progress: bool = False,
) -> DiagnosisResult:
    """Find what the bench of a joint lacks, from recordings; nothing is written.

    Bench and recordings decide how they are compared, unless ``config`` states it. Without
    recordings, those of ``config`` are used.

    Raises
    ------
    UserError
        If configuration, bench or recordings cannot be used.
    """
    given = locals()
    result: DiagnosisResult = _run_options("diagnose", given.pop("recordings"), **given)
    return result


@checked
def sweep(
    config: File, *, seed: int | None = None, workers: int | None = None, progress: bool = False
) -> SweepResult:
    """Simulate a bench over a range of gaps, as a configuration states, to make its gap curve.

    Only the simulations are written, into ``.finished`` beside the output, for other sweeps.

    Raises
    ------
    UserError
        If configuration or bench cannot be used, or the curve is not monotone.
    """
    result: SweepResult = _run_options("sweep", (), **locals())
    return result


@checked
def read_result(path: File) -> Result:
    """Read a stored result of any kind.

    Raises
    ------
    ResultError
        If there is no readable, finished result.
    """
    from bayesbl.presentation.result_object import result_of
    from bayesbl.runs.kinds import read_result as read

    return result_of(read(path))


@checked
def run(config: Configuration, *, force: bool = False, figures: Formats = ("png",)) -> Summary:
    """Run a configuration of any kind but ``simulate`` and write its output folder with figures.

    Parameters
    ----------
    figures
        Formats to draw in, ``"png"`` and ``"pdf"``; none for no figures.

    Returns
    -------
    What ``summary.json`` holds.

    Raises
    ------
    UserError
        If the configuration cannot be run, or the folder holds a finished result and ``force`` is
        not given.
    """
    from bayesbl.runs.kinds import load_run
    from bayesbl.runs.kinds import run as run_config
    from bayesbl.runs.workflow import Options

    file = None if isinstance(config, RunConfig) else Path(config)
    loaded = config if isinstance(config, RunConfig) else load_run(config)
    return run_config(loaded, Options(draw, force, formats=figures), file)


@checked
def draw(
    tree: Tree, folder: Path, formats: Formats = ("png",), study: Path | None = None
) -> list[Path]:
    """Write every figure of a result of any kind into a folder; the files written.

    Parameters
    ----------
    formats
        ``"png"``, ``"pdf"``, both or none; a fleet's pages are written whatever they are.
    study
        The study file, if the result is a study's: only the user says which file is run.

    Raises
    ------
    ResultError
        If the result is a study's and there is no study file, or the reverse.
    """
    if tree.attrs.get("kind") == "fleet":
        from bayesbl.presentation.page.plant import write_pages

        return write_pages(folder)
    require_study_file(tree, study)
    if study is not None:
        from bayesbl.runs.study import draw_study, load_study

        return draw_study(load_study(study), tree, folder, formats)
    from bayesbl.presentation.figures.stored_figure import draw_all

    return draw_all(tree, folder, formats)


def require_study_file(tree: xr.DataTree, study: Path | None, result: Path | None = None) -> None:
    """Require a study file for a study's result, and for no other; else raise ResultError."""
    if (tree.attrs["kind"] == "study") is not (study is not None):
        raise ResultError(
            "The figure of a study, and no other, is drawn by its study file.",
            file=result,
            found=f'kind = "{tree.attrs["kind"]}"' + (f" with {study}" if study else ""),
            expected="bayesbl figures RESULT --study FILE for a study; FILE is run",
        )


def _run_options(
    kind: str,
    recordings: Sequence[Any],
    *,
    config: File | None,
    progress: bool,
    bench: Any = None,
    dates: Sequence[date] = (),
    **given: Any,
) -> Any:
    """The result object of options over a configuration."""
    from bayesbl.config.loading import config_from_options
    from bayesbl.presentation import terminal
    from bayesbl.presentation.result_object import result_of
    from bayesbl.runs.kinds import result_of_run

    shown = terminal.progress(terminal.make_console(stderr=True)) if progress else nullcontext()
    loaded: RunConfig
    with _files(recordings, bench) as (files, of_bench), shown as tell:
        if kind == "diagnose" and files:
            from bayesbl.runs.diagnose import diagnosis_of

            loaded, _ = diagnosis_of(files, config, bench=of_bench, **given)
        else:
            loaded = config_from_options(kind, files, config, dates, bench=of_bench, **given)
        return result_of(result_of_run(loaded, tell))


@contextmanager
def _files(recordings: Sequence[Any], bench: Any) -> Iterator[tuple[list[Path], Path | None]]:
    """Files of recordings and a bench; those in memory are written to a temporary folder.

    Recordings in memory are named ``recording_1``, ``recording_2``, ….
    """
    import xarray as xr

    from bayesbl.config.bench import dump_bench

    with tempfile.TemporaryDirectory(prefix="bayesbl-") as folder:
        files = list(recordings)
        for place, given in enumerate(recordings):
            if isinstance(given, Mapping):
                table = {name: ("sample", column) for name, column in given.items()}
                files[place] = Path(folder, f"recording_{place + 1}.nc")
                xr.Dataset(table).to_netcdf(files[place], engine="netcdf4")
        file = bench
        if not (bench is None or isinstance(bench, Path)):
            file = Path(folder, "bench.toml")
            file.write_text(dump_bench(bench), encoding="utf-8")
        yield files, file
