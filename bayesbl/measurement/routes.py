"""Routes of measurement by name, and the one function that runs them.

A route is a module. It declares the groups it stores (in a group of its own name) and has a
:class:`bayesbl.measurement.measurement.Measurer`, named in :data:`ROUTES`.
``auto`` runs two routes and stores the results of the one that answers. If the load's position is
recorded, the two-encoder route runs beside routes that use the motor alone.
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
    "amplitude": "bayesbl.measurement.amplitude_route:AmplitudeMeasurer",
    "direct": "bayesbl.measurement.direct_route:DirectMeasurer",
    "auto": "bayesbl.measurement.auto_route:AutoMeasurer",
    "torque_ramp": "bayesbl.measurement.ramp_route:RampMeasurer",
    "two_encoders": "bayesbl.measurement.two_encoder_route:TwoEncoderMeasurer",
}
"""Class of each route, in a module that is imported only when it is used."""


def measurer_of(config: SnapshotConfig) -> Measurer:
    """Prepare the configured route, and read its bench and curve.

    Raises UserError if the bench or the curve cannot be read or used.
    """
    module, _, name = ROUTES[config.estimator.route].partition(":")
    measurer: Measurer = getattr(import_module(module), name)(config)
    return measurer


def measure(
    config: SnapshotConfig,
    progress: StageProgress | None = None,
    work: WorkStore = NOTHING_KEPT,
    say: Callable[[str], None] = lambda sentence: None,
    seeds: Seeds | None = None,
    recordings: Sequence[Recording] = (),
) -> xr.DataTree:
    """Run a fit or a comparison as configured.

    ``progress``, ``work``, ``say``: as of :class:`bayesbl.measurement.measurement.Task`. ``seeds``:
    seeds of the run; by default from the configuration. ``recordings``: the configured recordings
    as this route reads them; by default they are read here. Returns the whole result; only finished
    steps are written, to ``work``. Raises UserError if a recording, the
    bench or the curve cannot be read or used, the curve does not belong to the estimator, the
    earlier result has no optimum to start from, or the second sampler is not installed.
    """
    measurer = measurer_of(config)
    require_plausible_limit(limit_rad_of(config), measurer.gap_range_rad)
    recordings = tuple(recordings or map(measurer.read, config.recordings))
    require_different(recordings)
    measurer.require_together(recordings)
    for recording in recordings:
        measurer.require_usable(recording)
    seeds = seeds or Seeds.spawn(config.run.seed, len(recordings))
    task = Task(config, recordings, seeds, progress, work, say)
    measured = measurer.measure(task)
    has_load = all(LOAD_POSITION in recording.channels for recording in recordings)
    if has_load and measured.route not in WITHOUT_BENCH:
        from bayesbl.measurement.auto_route import with_witness

        measured = with_witness(measured, task)
    return measurement_tree(measured, task)
