"""Sensorless measurement of the backlash gap in robot joints, with honest uncertainty.

The public functions and types, whose names stay:

=====================  ============================================================================
``fit``, ``compare``   recordings in, gap and change out; what all of these give is a ``Result``
``identify``           a data sheet and recordings in, the joint's own bench out
``diagnose``           what recordings show and a bench lacks
``sweep``              the gap curve of a bench
``Result``             prints its answer, plots, gives an xarray tree, a table and a page
``read_result``        a stored result as such an object
``summarise``          a tree as ``summary.json`` holds it: δ in rad, intervals, probabilities
``run``                a configuration of any kind, with its output folder
``load_config``        a validated configuration from TOML
``read_recording``     a ``Recording``: channels over time, units in their names
``load_bench``         a ``Bench``; ``Bench.simulate`` makes a ``Recording``
``published_curve``    the paper's ``GapCurve``, from amplitude in rpm to gap in rad
``write_page``         the HTML page of a stored result
``UserError``          what every function raises for input that it cannot use
=====================  ============================================================================

They are imported when they are first asked for, so that ``import bayesbl`` costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bayesbl.bench.bench import Bench
    from bayesbl.config.bench import load_bench
    from bayesbl.config.loading import load_config
    from bayesbl.curve.gap_curve import GapCurve, published_curve
    from bayesbl.errors import UserError
    from bayesbl.library import compare, diagnose, fit, identify, read_result, run, sweep
    from bayesbl.presentation.page.build import write_page
    from bayesbl.presentation.result_object import Result
    from bayesbl.recording.readers import read_recording
    from bayesbl.recording.types import Recording
    from bayesbl.runs.kinds import summarise

__version__ = "0.4.0"

__all__ = [
    "Bench",
    "GapCurve",
    "Recording",
    "Result",
    "UserError",
    "__version__",
    "compare",
    "diagnose",
    "fit",
    "identify",
    "load_bench",
    "load_config",
    "published_curve",
    "read_recording",
    "read_result",
    "run",
    "summarise",
    "sweep",
    "write_page",
]

_HOMES = {
    name: module
    for module, names in {
        "bayesbl.bench.bench": "Bench",
        "bayesbl.config.bench": "load_bench",
        "bayesbl.config.loading": "load_config",
        "bayesbl.curve.gap_curve": "GapCurve published_curve",
        "bayesbl.errors": "UserError",
        "bayesbl.library": "compare diagnose fit identify read_result run sweep",
        "bayesbl.presentation.page.build": "write_page",
        "bayesbl.presentation.result_object": "Result",
        "bayesbl.recording.readers": "read_recording",
        "bayesbl.recording.types": "Recording",
        "bayesbl.runs.kinds": "summarise",
    }.items()
    for name in names.split()
}
"""Module of each public name."""


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
