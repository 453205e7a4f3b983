"""Routes of measurement by name, and the one way to run them.

A route is a module that declares the groups it stores in a group of its own name, and has
``prepare``, which gives its :class:`bayesbl.measurement.measurement.Measurer`; and its row in
:data:`ROUTES`.
``auto`` is of two routes, one of which answers: its results are that one's. Where the load's
position is recorded, two encoders stand beside routes that go by the motor alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module

import xarray as xr

from bayesbl.config.measurement import WITHOUT_BENCH, SnapshotConfig
from bayesbl.measurement.compatibility import (
    limit_rad_of,
    require_different,
    require_plausible_limit,
)
from bayesbl.measurement.measurement import Measurer, Seeds, Task
from bayesbl.measurement.stored import measurement_tree
from bayesbl.progress import StageProgress
from bayesbl.recording.types import LOAD_POSITION, Recording
from bayesbl.results.work import NOTHING_KEPT, WorkStore

ROUTES = {
    "amplitude": "bayesbl.measurement.amplitude_route",
    "direct": "bayesbl.measurement.direct_route",
    "auto": "bayesbl.measurement.auto_route",
    "torque_ramp": "bayesbl.measurement.ramp_route",
    "two_encoders": "bayesbl.measurement.two_encoder_route",
}
"""Name to the module, which is imported only where it is used."""


def measurer_of(config: SnapshotConfig) -> Measurer:
    """The route that a configuration asks for, with all that it reads beside the recordings.

    Raises
    ------
    UserError
        If the bench or the curve cannot be read or used.
    """
    prepared: Measurer = import_module(ROUTES[config.estimator.route]).prepare(config)
    return prepared


def measure(
    config: SnapshotConfig,
    progress: StageProgress | None = None,
    work: WorkStore = NOTHING_KEPT,
    say: Callable[[str], None] = lambda sentence: None,
    swept: WorkStore = NOTHING_KEPT,
    seeds: Seeds | None = None,
    recordings: Sequence[Recording] = (),
) -> xr.DataTree:
    """Run a fit or a comparison as configured.

    Parameters
    ----------
    progress, work, say, swept
        As of :class:`bayesbl.measurement.measurement.Task`.
    seeds
        Those of the configuration by default.
    recordings
        Those of the configuration as this route reads them; read here by default.

    Returns
    -------
    The whole result; nothing is written but finished work.

    Raises
    ------
    UserError
        If a recording, the bench or the curve cannot be read or used, the curve does not belong
        to the estimator, there is nothing to start from in the earlier result, or the second
        sampler is not installed.
    """
    measurer = measurer_of(config)
    require_plausible_limit(limit_rad_of(config), measurer.gap_range_rad)
    recordings = tuple(recordings or map(measurer.read, config.recordings))
    require_different(recordings)
    measurer.require_together(recordings)
    for recording in recordings:
        measurer.require_usable(recording)
    seeds = seeds or Seeds.spawn(config.run.seed, len(recordings))
    task = Task(config, recordings, seeds, progress, work, say, swept)
    measured = measurer.measure(task)
    has_load = all(LOAD_POSITION in recording.channels for recording in recordings)
    if has_load and measured.route not in WITHOUT_BENCH:
        measured = import_module("bayesbl.measurement.auto_route").with_witness(measured, task)
    return measurement_tree(measured, task)
