"""Does the gap's interval hold the truth beside a damping that nothing shows?

    bayesbl run configs/weak_damping.toml

Three recordings of one gap of 0.23 mrad by the simulator of ``independent_bench.py``, whose contact
damps by the root of its compression, a law that the catalogue has in another form. A row's cases
have consecutive seeds. ``alone`` is the fit with the bench as believed; beside it stands what is
always in (:mod:`bayesbl.model_search.always_in`), by the normal approximation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import xarray as xr
from independent_bench import random_recordings, values_of
from pydantic import NonNegativeFloat, PositiveInt
from study_tools import StudyRow, inside

from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.observed import observed
from bayesbl.matching.signals import GAP, gap_unknown, start_angle_unknown
from bayesbl.model_search.always_in import laws, with_far_terms_freed

GAP_RAD = 2.3e-4
SPEEDS_RPM = (2000.0, -2000.0, 1200.0)
DRAWS = 4000


class Row(StudyRow):
    """A row: the damping in N m s/rad at a compression of one radian, and its first seed."""

    damping: NonNegativeFloat
    first_seed: PositiveInt


COLUMNS = {
    "alone_z": ("1", "error of ln δ in standard deviations, with the bench as believed"),
    "z": ("1", "the same beside what is always in"),
    "below": ("1", "share of the draws of δ below the truth"),
    "wider": ("1", "standard deviation of ln δ over that with the bench as believed"),
}


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One joint; its seed is the row's first one and the case's place."""
    bench = reference_bench()
    made = random_recordings(
        values_of(bench),
        {"outside__contact_damping_nm_s_per_rad": row.damping} if row.damping else {},
        np.random.default_rng(row.first_seed + index),
        gap_rad=(GAP_RAD, GAP_RAD),
        speeds_rpm=SPEEDS_RPM,
    )
    seen = [observed(m.recording, bench, m.truth.reference_speed_rpm) for m in made]
    unknowns = [gap_unknown(1e-4, 4e-3), *(start_angle_unknown(s.name) for s in seen)]
    alone = fit_aligned(bench, seen, unknowns)
    rest = with_far_terms_freed(alone, laws(bench))
    fit = rest.fit
    place, rng, truth = fit.model.index(GAP), np.random.default_rng(1), math.log(GAP_RAD)
    draws = fit.point[place] + fit.sd(GAP) * rng.standard_normal(DRAWS)
    draws += rest.posterior.draw(rng, DRAWS).shift[:, place]
    return {
        "alone_z": (math.log(alone.value(GAP)) - truth) / alone.sd(GAP),
        "z": float((draws.mean() - truth) / draws.std()),
        "below": float(np.mean(draws < truth)),
        "wider": float(draws.std()) / alone.sd(GAP),
    }


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """How often the 90 % interval holds δ, and how wide it is."""
    below, z = cases["below"].values, cases["z"].values
    return {
        "joints": float(below.size),
        "held": float(inside(below).sum()),
        "held_alone": float(np.sum(np.abs(cases["alone_z"].values) < 1.645)),
        "mean_z": float(z.mean()),
        "root_mean_square_z": float(np.sqrt(np.mean(z**2))),
        "largest_z": float(np.max(np.abs(z))),
        "wider": float(np.median(cases["wider"].values)),
    }
