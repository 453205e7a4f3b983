"""Which laws bias the gap before they show?

    bayesbl run configs/bias_against_visibility.toml

For each effect of the catalogue and each bench parameter, the derivative c of the whitened signals
by its size, at a fit with J and L = (JᵀJ + P)⁻¹: a size s that is not modelled moves ln δ by
(L Jᵀc)_δ s, and is seen with z = s (cᵀc − cᵀJ L Jᵀc)^½ standard deviations, were it free.

``bias`` is how many posterior standard deviations δ is off when z is 3, where no search names it
yet; ``hides``, the chance that z is below 3 if the size is half-normal with its usual size (a
quarter of a parameter). A law with a bias above 1 that hides in more than one of twenty joints is
always in (``always_in`` in its file under ``bayesbl/bench/effects``). A case is a bench drawn
within a factor of the reference bench's values; a law with several shapes is shown by its worst.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from pydantic import Field
from scipy.special import erf
from study_tools import StudyRow

from bayesbl.bench.effects import EFFECTS, effect_named, search_scale
from bayesbl.bench.parameters import CORRECTABLE_PARAMETERS
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import observed
from bayesbl.matching.signals import GAP, gap_unknown, start_angle_unknown
from bayesbl.model_search.catalogue import Candidate, candidates
from bayesbl.model_search.refit import columns_of

UNSEEN = 3.0
PARAMETER_SHARE = 0.25
LAWS = tuple(e.name for e in EFFECTS if e.sought_in_loop and not e.is_periodic)
NAMES = (*LAWS, *CORRECTABLE_PARAMETERS)


class Row(StudyRow):
    """A row: one recording at each speed, all of one gap.

    ``spread``: benches are drawn within this factor, one over it to it, in stiffness, damping,
    inertias, gravity and gains.
    """

    speeds_rpm: tuple[float, ...]
    with_current: bool = True
    spread: float = Field(ge=1.0)
    gap_rad: tuple[float, float]


COLUMNS = {
    f"{name}_{what}": ("1", meaning)
    for name in NAMES
    for what, meaning in (
        ("bias", "posterior sds that δ is off where the law is seen with z of 3"),
        ("hides", "chance that z is below 3 at the usual size"),
    )
}


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """Bias and visibility of everything on one bench."""
    rng = np.random.default_rng(seed)
    bench = reference_bench()
    factors = np.exp(rng.uniform(-1.0, 1.0, len(CORRECTABLE_PARAMETERS)) * math.log(row.spread))
    bench = bench.with_parameters(
        **{n: bench.value(n) * f for n, f in zip(CORRECTABLE_PARAMETERS, factors, strict=True)}
    )
    gap = math.exp(rng.uniform(*np.log(row.gap_rad)))
    seen = []
    for place, speed in enumerate(row.speeds_rpm):
        recording = bench.simulate(
            gap,
            start_angle_rad=float(rng.uniform(-math.pi, math.pi)),
            reference_speed_rpm=speed,
            seed=rng,
            name=f"recording {place}",
        )
        own = observed(recording, bench, speed)
        seen.append(own if row.with_current else replace(own, signals=own.signals[:1]))
    unknowns = [gap_unknown(1e-4, 1e-2), *(start_angle_unknown(s.name) for s in seen)]
    fit = fit_aligned(bench, seen, unknowns)
    return _by_law(fit, candidates(bench, seen, "all"))


def _by_law(fit: SimulatedFit, among: Sequence[Candidate]) -> dict[str, float]:
    jacobian, gap = fit.derivatives(), fit.model.index(GAP)
    out = dict.fromkeys(COLUMNS, math.nan)
    for candidate in among:
        if candidate.name not in NAMES:
            continue
        for column in (columns[0] for columns in columns_of(fit, candidate) if len(columns) == 1):
            across = jacobian.T @ column
            moved = fit.covariance @ across
            seen = math.sqrt(max(float(column @ column - across @ moved), 1e-300))
            bias = UNSEEN * abs(float(moved[gap])) / fit.sd(GAP) / seen
            hides = float(erf(UNSEEN / (seen * _usual(fit, candidate)) / math.sqrt(2.0)))
            if not bias <= out[f"{candidate.name}_bias"]:
                out |= {f"{candidate.name}_bias": bias, f"{candidate.name}_hides": hides}
    return out


def _usual(fit: SimulatedFit, candidate: Candidate) -> float:
    if candidate.effect is None:
        return PARAMETER_SHARE * abs(float(candidate.neutral[0]))
    effect = effect_named(candidate.name)
    item = effect.amplitudes[0]
    return search_scale(fit.model.bench, effect, item) * item.typical


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Medians over the benches, and how often a law is one to be always in."""
    line: dict[str, float | str] = {}
    for name in NAMES:
        bias, hides = (cases[f"{name}_{what}"].values for what in ("bias", "hides"))
        line |= {
            f"{name}_bias": float(np.median(bias)),
            f"{name}_hides": float(np.median(hides)),
            f"{name}_in": float(np.mean((bias > 1.0) & (hides > 0.05))),
        }
    return line
