"""Wear of compared snapshots in time: from their dates and repairs to a rate, or a reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.config.measurement import CompareConfig
from bayesbl.measurement.dated_wear import wear_group, years_between
from bayesbl.measurement.wear import LEAST_SHARE_GROWING, since_repair, straightness, wear
from bayesbl.recording.types import FloatArray


def wear_of(
    config: CompareConfig,
    delta_rad: Sequence[FloatArray],
    verdicts: Mapping[str, Mapping[str, Any]],
    seed: np.random.SeedSequence,
) -> xr.Dataset | None:
    """Group ``wear`` of the result; ``None`` where not every recording has a date.

    ``delta_rad`` are draws of each gap, paired by draw, shape (chain, draw).
    """
    dates = config.dates
    if dates is None:
        return None
    used = since_repair([recording.repaired for recording in config.recordings])
    since = dates[used]
    before = config.joint.decide_before
    withheld = [r.name for r in config.recordings[used] if verdicts[r.name]["reason"]]
    if since[0] == since[-1]:
        count = "one snapshot" if len(since) == 1 else "snapshots of one day"
        reason = f"There is only {count} since the repair: a rate needs two, at different dates."
        if used.start == 0 and not config.recordings[0].repaired:
            reason = f"There are only {count}: a rate needs two, at different dates."
        return wear_group(dates, used, None, reason=reason, decide_before=before)
    years = np.array([years_between(since[0], day) for day in since])
    drawn = np.stack(delta_rad[used])
    result = wear(drawn, years, seed, limit_rad=config.joint.limit_rad)
    reason = ""
    if withheld:
        reason = f"The gap is withheld for {', '.join(withheld)}."
    elif 1.0 - result.heals.mean() < LEAST_SHARE_GROWING:
        reason = (
            "The gap shrank, and wear does not heal. If the joint was repaired, mark the first "
            "recording after it (repaired = true)."
        )
    line = None if reason else straightness(drawn, years)
    return wear_group(dates, used, result, reason=reason, decide_before=before, line=line)
