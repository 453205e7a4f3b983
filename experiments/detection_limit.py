"""How small a gap, and how little wear, do two recordings show?

    bayesbl run configs/detection_limit.toml

A case is a pair of recordings by the simulator of ``independent_bench.py``, on a bench drawn within
the tolerances of the row's, before and after a change of the gap. Both are fitted together by the
direct route, as ``compare`` does. A gap is *told* where the answer is no upper bound. The limits
of a row are those of a normal posterior of the median width: the gap that is told, and the wear
that is reported at 95 %, in 95 % of pairs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from calibration_statistics import coverage_band
from independent_bench import Noise, plant, simulate, values_of
from pydantic import NonNegativeFloat
from study_tools import LEVEL, SNAPSHOTS, StudyRow, bench_of, inside, random_start, without_current

from bayesbl.bench.bench import Bench
from bayesbl.config.sections import Items
from bayesbl.matching.observed import Observed, observed
from bayesbl.matching.signals import GAP, SMALLEST_GAP_RAD
from bayesbl.measurement.direct_route import direct_reasons, fit_directly
from bayesbl.measurement.measurement import UPPER_BOUND_LEVEL, outcome_of, upper_bound
from bayesbl.probabilities import TOO_FEW, normal_isf
from bayesbl.sampling.chains import SamplerSettings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RANGE_RAD = (0.0, 1e-2)
POWER = 0.95
NOISE = Noise()


class Row(StudyRow):
    """A row: the bench as it is known, gaps and changes that take turns, and what is not usual.

    ``noise``: times that of the shipped example; ``payload``: times the bench's gravity and
    inertia; ``edge_sd_rad``: standard deviation of soft edges and ``damping``, N m s/rad at a
    compression of one radian, that the bench lacks.
    """

    bench: Path
    gaps_rad: Items[NonNegativeFloat] = (5e-5,)
    change_rad: float = 2e-5
    noise: NonNegativeFloat = 1.0
    speed_rpm: float = 2000.0
    payload: float = 1.0
    sampling_hz: float = 1000.0
    rotations: float = 5.0
    with_current: bool = True
    edge_sd_rad: NonNegativeFloat = 0.0
    damping: NonNegativeFloat = 0.0


COLUMNS = {
    "gap_rad": ("rad", "gap simulated in the first recording"),
    "below": ("1", "share of the draws of this gap below the truth"),
    "median_rad": ("rad", "median of this gap"),
    "sd_rad": ("rad", "standard deviation of this gap"),
    "upper_rad": ("rad", "95 % upper bound of this gap"),
    "told": ("1", "1 where it is told from none"),
    "withheld": ("1", "1 where it is withheld"),
    "contradicted": ("1", "1 where it is withheld because the recording contradicts the bench"),
    "change_below": ("1", "share of the draws of the change below the truth"),
    "change_sd_rad": ("rad", "standard deviation of the change"),
    "probability_increase": ("1", "posterior probability that the gap grew"),
}


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One pair; gaps take turns."""
    truth_seed, fit_seed = seed.spawn(2)
    bench, gap = _bench(row), row.gaps_rad[index % len(row.gaps_rad)]
    recordings = _recorded(row, bench, gap, np.random.default_rng(truth_seed))
    found = fit_directly(bench, recordings, RANGE_RAD, {}, SamplerSettings(), fit_seed)
    reasons = direct_reasons(found, 0)
    drawn = found.posterior.values(GAP, SNAPSHOTS[0])
    withheld, change = outcome_of(reasons) == "withheld", found.change_rad
    codes = [reason.code for reason in reasons]
    return {
        "gap_rad": gap,
        "below": float(np.mean(drawn < gap)),
        "median_rad": float(np.median(drawn)),
        "sd_rad": float(drawn.std()),
        "upper_rad": upper_bound(drawn),
        "told": float(not withheld and "gap_not_told" not in codes),
        "withheld": float(withheld),
        "contradicted": float(any(r.withholds and r.code != "sampling" for r in reasons)),
        "change_below": float(np.mean(change < row.change_rad)),
        "change_sd_rad": float(change.std()),
        "probability_increase": float(np.mean(change > 0.0)),
    }


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """How often the intervals hold the truth, and the smallest gap and wear that are shown."""
    own = {name: cases[name].values for name in COLUMNS}
    answered, told = own["withheld"] == 0.0, own["told"] == 1.0
    bounded = answered & ~told
    line: dict[str, float | str] = {
        "pairs": float(answered.size),
        "gaps_mrad": " ".join(f"{1e3 * gap:g}" for gap in row.gaps_rad),
        "answered": float(answered.sum()),
        "contradicted": float(own["contradicted"].sum()),
        "told": float(told.sum()),
        "held": float(inside(own["below"][told]).sum()),
        "bounds_hold": float(np.sum((own["gap_rad"] <= own["upper_rad"])[bounded])),
        "bounds": float(bounded.sum()),
        "median_bound_mrad": 1e3 * float(np.median(own["upper_rad"][bounded]))
        if bounded.any()
        else math.nan,
        "changes_held": float(inside(own["change_below"][answered]).sum()),
        "held_from": coverage_band(int(told.sum()), LEVEL)[0] if told.any() else math.nan,
    }
    tail, power = normal_isf(1.0 - UPPER_BOUND_LEVEL), normal_isf(1.0 - POWER)
    sd, change_sd = (float(np.median(own[k])) for k in ("sd_rad", "change_sd_rad"))
    least = SMALLEST_GAP_RAD + (normal_isf(TOO_FEW) + power) * sd
    return line | {
        "sd_mrad": 1e3 * sd,
        "change_sd_mrad": 1e3 * change_sd,
        "smallest_gap_mrad": 1e3 * least,
        "smallest_wear_mrad": 1e3 * (tail + power) * change_sd,
    }


def figure(table: Sequence[Mapping[str, Any]], cases: Mapping[str, xr.Dataset]) -> Figure:
    """The smallest gap and the smallest wear of each row, in mrad."""
    from bayesbl.presentation.figures.style import (
        DOUBLE_COLUMN_IN,
        grid,
        look,
        new_figure,
        publication_style,
    )

    with publication_style():
        drawn = new_figure(DOUBLE_COLUMN_IN, 0.9 + 0.2 * len(table))
        panel = drawn.add_subplot(grid(drawn, 1, 1, left=2.3, top=0.45, bottom=0.5)[0, 0])
        rows = np.arange(len(table))
        shown = (("smallest_gap_mrad", "gap reported"), ("smallest_wear_mrad", "growth detected"))
        for index, (key, label) in enumerate(shown):
            own = look(index)
            values = [float(line[key]) for line in table]
            panel.plot(values, rows, own.marker, color=own.colour, label=label)
        panel.set_yticks(rows, [str(line["name"]) for line in table])
        panel.invert_yaxis()
        panel.set_xscale("log")
        ticks = (0.003, 0.005, 0.01, 0.02, 0.03)
        panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        panel.set_xticks([], minor=True)
        panel.set_xlabel("Smallest in 95 % of pairs (mrad)")
        panel.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return drawn


def _bench(row: Row) -> Bench:
    bench = bench_of(row.bench)
    scaled = {
        name: row.payload * bench.value(name)
        for name in ("gravity_torque_nm", "load_inertia_kg_m2")
    }
    return bench.with_parameters(**scaled, reference_speed_rpm=row.speed_rpm)


def _recorded(
    row: Row, bench: Bench, gap_rad: float, generator: np.random.Generator
) -> list[Observed]:
    """Both recordings of a joint drawn within the tolerances of its bench."""
    drawn = bench.draw(generator)
    noise = replace(
        NOISE,
        speed_sd_rpm=row.noise * NOISE.speed_sd_rpm,
        current_sd_a=row.noise * NOISE.current_sd_a,
    )
    recordings = []
    for name, gap in zip(SNAPSHOTS, (gap_rad, gap_rad + row.change_rad), strict=True):
        truth = plant(
            values_of(drawn),
            gap_rad=gap,
            **random_start(generator),
            contact_softness__variance_rad2=row.edge_sd_rad**2,
            outside__contact_damping_nm_s_per_rad=row.damping,
        )
        made = simulate(
            truth,
            generator,
            name=name,
            rotations=row.rotations,
            sampling_hz=row.sampling_hz,
            noise=noise,
        ).recording
        recordings.append(observed(made if row.with_current else without_current(made), bench))
    return recordings
