"""Is δ right where a joint only strokes to and fro, and withheld where the strokes do not show it?

Pairs of recordings of one joint, made by the independent simulator: strokes about a posture, the
second with a gap that may have grown. Both are answered together by the direct route. A gap counts
as shown where, in the part that is compared, the true joint passes from one tooth flank to the
other. The posterior is the surrogate's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from independent_bench import plant, simulate_moving, strokes, values_of
from pydantic import Field
from study_tools import StudyRow, bench_of, inside, mean

from bayesbl.bench.bench import Bench
from bayesbl.bench.kernel import TWIST
from bayesbl.bench.simulation import simulate_motions
from bayesbl.matching.motions import changes_of
from bayesbl.matching.observed import Observed, observed
from bayesbl.matching.signals import GAP
from bayesbl.measurement.direct_route import direct_reasons, fit_directly
from bayesbl.measurement.measurement import outcome_of
from bayesbl.recording.types import REFERENCE_POSITION, REFERENCE_SPEED, Recording
from bayesbl.sampling.chains import SamplerSettings

FAST = SamplerSettings(ensembles=2, max_steps=2000)
RANGE_RAD = (1e-4, 1e-2)
GAPS_RAD = (2e-4, 3e-3)
LARGEST_GROWTH = 0.5
RAMP_SHARE = 0.25
"""Of a stroke's time, that it accelerates for, and brakes for."""

NAMES = ("first", "second")
CHANNELS = {
    "speed": (REFERENCE_SPEED,),
    "position": (REFERENCE_POSITION,),
    "both": (REFERENCE_SPEED, REFERENCE_POSITION),
}


class Row(StudyRow):
    """A row: strokes of ``stroke_s`` from −``reach_deg`` to ``reach_deg`` about a posture.

    ``posture_deg``: 0 hangs straight down. ``bench_error``: the true bench is drawn within the
    tolerances of the bench file. ``cut_s``: what the recording lacks of its begin. ``joint``: what
    the joint has instead of what the bench file says, known to both.
    """

    bench: Path
    posture_deg: float = 0.0
    reach_deg: float = Field(default=30.0, gt=0.0)
    stroke_s: float = Field(default=1.0, gt=0.0)
    dwell_s: float = 0.15
    duration_s: float = 16.0
    sampling_hz: float = 1000.0
    reference: str = "speed"
    cut_s: float = 0.0
    bench_error: bool = False
    joint: dict[str, float] = Field(default_factory=dict)


COLUMNS = {
    **{
        f"{key}_{name}": (unit, f"{meaning}, {name} recording")
        for name in NAMES
        for key, unit, meaning in (
            ("shown", "1", "1 where the true joint changes flanks in what is compared"),
            ("withheld", "1", "1 where δ is withheld"),
            ("below", "1", "share of the posterior below the true δ"),
            ("error", "1", "median of ln δ less the truth"),
            ("sd", "1", "posterior sd of ln δ"),
            ("bound", "1", "Cramér-Rao bound on it"),
        )
    },
    "below_change": ("1", "share of the posterior below the true change"),
    "gap_rad": ("rad", "true δ of the first"),
}


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One pair of recordings."""
    truth_seed, fit_seed = seed.spawn(2)
    rng = np.random.default_rng(truth_seed)
    believed = bench_of(row.bench).with_parameters(**row.joint)
    joint = believed.draw(rng) if row.bench_error else believed
    first = math.exp(rng.uniform(*np.log(GAPS_RAD)))
    gaps = (first, first * (1.0 + rng.uniform(0.0, LARGEST_GROWTH)))
    made = [_recorded(row, joint, gap, name, rng) for gap, name in zip(gaps, NAMES, strict=True)]
    seen = [observed(recording, believed) for recording in made]
    found = fit_directly(believed, seen, RANGE_RAD, {}, FAST, fit_seed)
    model = found.posterior.fit.model
    result = {"gap_rad": first}
    for i, (name, gap) in enumerate(zip(NAMES, gaps, strict=True)):
        draws = np.log(found.posterior.values(GAP, name)).ravel()
        compared = model.recordings[i]
        result |= {
            f"shown_{name}": float(_flank_changes(row, joint, gap, compared) > 0),
            f"withheld_{name}": float(outcome_of(direct_reasons(found, i)) == "withheld"),
            f"below_{name}": float(np.mean(draws < math.log(gap))),
            f"error_{name}": float(np.median(draws)) - math.log(gap),
            f"sd_{name}": float(draws.std()),
            f"bound_{name}": float(found.posterior.fit.bound[model.index(GAP, name)]),
        }
    result["below_change"] = float(np.mean(found.change_rad < gaps[1] - gaps[0]))
    return result


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Withheld rightly and wrongly, coverage of δ and of the change where both are given."""
    shown, withheld, below, ratio, sd = (
        np.concatenate([cases[f"{key}_{name}"].values for name in NAMES])
        for key in ("shown", "withheld", "below", "sd", "sd")
    )
    bound = np.concatenate([cases[f"bound_{name}"].values for name in NAMES])
    answered = withheld == 0.0
    both = np.all([cases[f"withheld_{name}"].values == 0.0 for name in NAMES], axis=0)
    change = cases["below_change"].values[both]
    line: dict[str, float | str] = {
        "shown": int(np.sum(shown)),
        "answered_of_shown_%": 100.0 * mean(answered[shown > 0.0]),
        "not_shown": int(np.sum(shown == 0.0)),
        "withheld_of_not_shown_%": 100.0 * mean(~answered[shown == 0.0]),
        "answers": int(np.sum(answered)),
        "covered_%": 100.0 * mean(inside(below[answered])),
        "changes": int(change.size),
        "change_covered_%": 100.0 * mean(inside(change)),
    }
    if np.any(answered):
        ratio = sd[answered] / bound[answered]
        line["sd_%"] = 100.0 * float(np.median(sd[answered]))
        line["sd/bound"] = float(np.median(ratio))
        line["sd/bound_90th"] = float(np.quantile(ratio, 0.9))
    return line


def _recorded(
    row: Row, joint: Bench, gap_rad: float, name: str, rng: np.random.Generator
) -> Recording:
    reach = math.radians(row.reach_deg)
    ratio = joint.value("gear_ratio")
    speed = 2.0 * reach * ratio / (row.stroke_s * (1.0 - RAMP_SHARE)) * 60.0 / (2.0 * math.pi)
    values = values_of(joint) | {
        "gap_rad": gap_rad,
        "reference_speed_rpm": speed,
        "start_angle_rad": math.radians(row.posture_deg) - reach,
    }
    effects = {
        f"{effect.name}__{key}": value
        for effect in joint.effects
        for key, value in effect.complete().items()
    }
    reference = strokes(
        ratio, (-reach, reach), speed, speed / (RAMP_SHARE * row.stroke_s), row.dwell_s
    )
    return simulate_moving(
        plant({**values, **effects}),
        reference,
        row.duration_s,
        rng,
        name=name,
        sampling_hz=row.sampling_hz,
        channels=CHANNELS[row.reference],
        cut_s=row.cut_s,
    ).recording


def _flank_changes(row: Row, joint: Bench, gap_rad: float, seen: Observed) -> int:
    """Of the true joint in what is compared; where the recording is cut, from the bench at rest."""
    start = math.radians(row.posture_deg - row.reach_deg)
    assert seen.motion is not None
    if row.cut_s > 0.0:
        time = np.arange(seen.samples) / seen.sampling_hz
        start += float(np.ptp(seen.motion.position_rad(time))) / joint.value("gear_ratio")
        start -= float(np.max(seen.motion.position_rad(time))) / joint.value("gear_ratio")
    vector = joint.vector(gap_rad=gap_rad, start_angle_rad=start)
    size = seen.samples, seen.sampling_hz
    twist = simulate_motions(vector, seen.motion, *size, states=True)[0, TWIST]
    return len(changes_of(twist, gap_rad, 1.0 / seen.sampling_hz, seen.excluded))
