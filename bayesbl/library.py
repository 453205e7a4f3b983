"""What the commands do, as functions: ``bayesbl.fit``, ``compare``, ``run`` and ``write_page``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.config.measurement import SnapshotConfig
from bayesbl.config.sections import RunConfig
from bayesbl.errors import ResultError

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.runs.summary import Summary


def fit(
    recording: str | Path, *, config: str | Path | None = None, **options: object
) -> xr.DataTree:
    """Measure the gap in one recording; nothing is written.

    Parameters
    ----------
    recording
        A file; other column names and units are mapped by ``config``.
    config
        A configuration file that the options go over.
    options
        As the command line's: ``curve``, ``level``, ``limit_rad`` (rad), ``gear_ratio``, ``seed``,
        ``workers``.

    Returns
    -------
    Groups ``posterior`` (``delta_rad`` in rad, ``amplitude_rpm`` in rpm, …, dimensions ``chain``
    and ``draw``), ``sample_stats``, ``observed_data`` and more, units on every variable.

    Raises
    ------
    UserError
        If the recording or the configuration cannot be used.
    """
    return _measure("fit", [recording], config, options)


def compare(
    first: str | Path,
    *later: str | Path,
    config: str | Path | None = None,
    dates: Sequence[date] = (),
    **options: object,
) -> xr.DataTree:
    """Measure the gap in each recording of one joint, and its change; nothing is written.

    Parameters
    ----------
    first, later
        Files in the order they were taken, at least two.
    config, options
        As for :func:`fit`.
    dates
        When each was taken; with them the result has a group ``wear``.

    Returns
    -------
    As :func:`fit`, with a dimension ``snapshot``, and a group ``change`` (``change_rad``, last
    minus first, in rad).

    Raises
    ------
    UserError
        If a recording or the configuration cannot be used.
    """
    return _measure("compare", [first, *later], config, options, dates)


def run(config: str | Path | RunConfig, *, force: bool = False) -> Summary:
    """Run a configuration of any kind but ``simulate`` and write its output folder with figures.

    Returns
    -------
    What ``summary.json`` holds.

    Raises
    ------
    UserError
        If the configuration cannot be run, or the folder holds a finished result and ``force`` is
        not given.
    """
    from bayesbl.runs.run import load_run
    from bayesbl.runs.run import run as run_config

    if isinstance(config, RunConfig):
        return run_config(config, draw, force=force)
    return run_config(load_run(config), draw, force=force, file=Path(config))


def write_page(result: str | Path) -> Path:
    """Write ``report.html`` beside a stored result; its path.

    Raises
    ------
    UserError
        If there is no finished result.
    """
    from bayesbl.presentation.page.build import write_page as write

    return write(result, draw)


def draw(tree: xr.DataTree, folder: Path, study: Path | None = None) -> list[Path]:
    """Write every figure of a result of any kind into a folder; the files written.

    Parameters
    ----------
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
        from bayesbl.runs.study import draw_study
        from bayesbl.runs.study_file import load_study

        return draw_study(load_study(study), tree, folder)
    from bayesbl.presentation.figures.draw import draw_all

    return draw_all(tree, folder)


def require_study_file(tree: xr.DataTree, study: Path | None, result: Path | None = None) -> None:
    """A study file is given for the result of a study, and for no other.

    Raises
    ------
    ResultError
        Naming the result, where it is given, if not.
    """
    if (tree.attrs["kind"] == "study") is not (study is not None):
        raise ResultError(
            "The figure of a study, and no other, is drawn by its study file.",
            file=result,
            found=f'kind = "{tree.attrs["kind"]}"' + (f" with {study}" if study else ""),
            expected="bayesbl figures RESULT --study FILE for a study; FILE is run",
        )


def _measure(
    kind: str,
    recordings: list[str | Path],
    config: str | Path | None,
    options: Mapping[str, object],
    dates: Sequence[date] = (),
) -> xr.DataTree:
    from bayesbl.config.loading import OPTIONS, config_from_options
    from bayesbl.errors import ConfigError
    from bayesbl.measurement.routes import measure
    from bayesbl.recording.channels import did_you_mean

    for name in options:
        if name not in OPTIONS:
            raise ConfigError(
                "There is no such option." + did_you_mean(name, OPTIONS),
                where=name,
                expected="one of " + ", ".join(OPTIONS),
            )
    loaded = config_from_options(kind, recordings, config, dates, **options)
    assert isinstance(loaded, SnapshotConfig)
    return measure(loaded)
