"""``kind = "fit"`` and ``"compare"``: measure the gaps in recordings of one joint."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from bayesbl.config.measurement import SnapshotConfig
from bayesbl.config.sections import SnapshotRecording
from bayesbl.errors import UserError
from bayesbl.measurement.compatibility import (
    limit_rad_of,
    require_different,
    require_plausible_limit,
)
from bayesbl.measurement.measurement import ExpectedSd
from bayesbl.measurement.routes import measure, measurer_of
from bayesbl.probabilities import normal_isf
from bayesbl.results.work import WorkStore
from bayesbl.runs.workflow import Options, Plan
from bayesbl.sentences import sentence

if TYPE_CHECKING:
    import xarray as xr


def make(config: SnapshotConfig, options: Options, work: WorkStore) -> xr.DataTree:
    """Measure; with other dates or another limit, fits and curves are those of an earlier run."""
    return measure(config, options.progress, work, options.say, recordings=options.recordings)


def describe(config: SnapshotConfig, plan: Plan) -> None:
    """What would be measured, and how."""
    measurer = measurer_of(config)
    interval = f"{100.0 * config.interval.level:g} %, {config.interval.kind}"
    plan.add("interval", lambda: interval)
    for label, text in measurer.describe():
        plan.add(label, text)

    def checked(entry: SnapshotRecording) -> str:
        recording = measurer.read(entry)
        measurer.require_usable(recording)
        rate = 1.0 / recording.sampling_period_s
        plan.recordings.append(recording)
        plan.warnings += [f"{entry.name}: {note}" for note in recording.notes]
        doubts = (reason.stored for reason in measurer.doubts(recording))
        plan.withheld += [f"{entry.name}: {sentence(why)}" for why in doubts]
        more = len(entry.every_file) - 1
        files = f"{entry.file}{f' and {more} more' if more else ''}"
        return f"{files}, {recording.duration_s:.4g} s at {rate:.4g} Hz"

    for entry in config.recordings:
        plan.add(f"recording {entry.name}", partial(checked, entry))
    plan.warnings += plan.withheld
    plan.add("files", partial(require_different, plan.recordings))
    plan.add("speed", partial(measurer.require_together, plan.recordings))
    if plan.is_check:
        # It is for a run to refuse a recording, one that something shakes say.
        with suppress(UserError, np.linalg.LinAlgError):
            sds = measurer.expected(plan.recordings, plan.progress)
            plan.add("expected", lambda: _expected(sds, config))
    if config.joint.limit_rad is not None or config.joint.limit is not None:
        plan.add("limit", partial(_limit, config, measurer.gap_range_rad))


def _expected(sds: Sequence[ExpectedSd], config: SnapshotConfig) -> str | None:
    """Expected half-widths of the intervals, before any fit."""
    if not sds:
        return None
    level = config.interval.level
    times = 1e3 * normal_isf(0.5 * (1.0 - level))
    gaps = [f"±{times * sd.delta_rad:.2g} mrad at {1e3 * sd.gap_rad:g} mrad" for sd in sds]
    text = f"{100.0 * level:g} % intervals of the gap, if the bench is right: {', '.join(gaps)}"
    changes = [f"±{times * sd.change_rad:.2g}" for sd in sds if sd.change_rad is not None]
    if changes:
        text += f"; of a change at these gaps: {', '.join(changes)} mrad"
    return text


def _limit(config: SnapshotConfig, range_rad: tuple[float, float] | None) -> str:
    limit_rad, stated = limit_rad_of(config), config.joint.limit
    require_plausible_limit(limit_rad, range_rad)
    given = "" if range_rad else "; not used without δ"
    meant = "" if stated is None or stated.name == "mrad of δ" else f" ({stated})"
    return f"{1e3 * (limit_rad or 0.0):.4g} mrad of δ{meant}{given}"
