"""Is the direct posterior of δ as sharp as the Cramér-Rao bound allows, and does it hold what it
promises?

Recordings are simulated with a random start angle, on the bench itself or on one drawn within its
tolerances, and fitted from the recording alone. The posterior is the surrogate's; in the first
cases of each row the one weighted by full simulations is computed too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from calibration_statistics import LEVELS, coverage
from pydantic import Field, NonNegativeInt
from study_tools import FAST, TurningRow, bench_of, turned

from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.observed import observed
from bayesbl.matching.posterior import DirectPosterior, sample_direct
from bayesbl.matching.predictive_check import agrees, disagreements
from bayesbl.matching.signals import GAP, gap_unknown, start_angle_unknown, tolerance_unknowns
from bayesbl.matching.surrogate import simulated_chi_square
from bayesbl.sampling.importance import effective_size


class Row(TurningRow):
    """A row: the bench as it is known, and the gap. What has a tolerance is drawn within it.

    ``full_cases``: how many cases are sampled in full too.
    """

    bench: Path
    gap_rad: float = Field(gt=0.0)
    full_cases: NonNegativeInt = 0
    lowest_gap_rad: float = Field(default=1e-4, gt=0.0)
    highest_gap_rad: float = Field(default=1e-2, gt=0.0)


COLUMNS = {
    "log_error": ("1", "ln of the posterior median over the gap simulated"),
    "log_sd": ("1", "posterior standard deviation of ln δ"),
    "bound": ("1", "Cramér-Rao bound on the standard deviation of ln δ, priors left out"),
    "width": ("1", "width of the 90 % interval of ln δ"),
    "rank": ("1", "share of posterior draws below the truth"),
    "agrees": ("1", "1 where the predictive check found nothing that repeats"),
    "full_shift": ("1", "mean of ln δ by full simulation less the surrogate's, in its sd"),
    "full_sd_ratio": ("1", "sd of ln δ by full simulation over the surrogate's"),
    "full_rank": ("1", "share of fully simulated draws below the truth"),
    "effective": ("1", "effective share of the draws after full simulation"),
}


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One recording from truth to posterior."""
    truth_seed, walk_seed, _ = seed.spawn(3)
    generator = np.random.default_rng(truth_seed)
    bench = bench_of(row.bench)
    recording = turned(bench.draw(generator), row.gap_rad, row, generator)
    unknowns = [
        gap_unknown(row.lowest_gap_rad, row.highest_gap_rad),
        start_angle_unknown(recording.name),
        *tolerance_unknowns(bench),
    ]
    fit = fit_aligned(bench, [observed(recording, bench)], unknowns)
    found = sample_direct(fit, FAST, walk_seed)
    log_gap = np.log(found.values(GAP)).ravel()
    truth = math.log(row.gap_rad)
    low, high = np.quantile(log_gap, [0.05, 0.95])
    result = {
        "log_error": float(np.median(log_gap)) - truth,
        "log_sd": float(log_gap.std()),
        "bound": float(fit.bound[fit.model.index(GAP)]),
        "width": float(high - low),
        "rank": float(np.mean(log_gap < truth)),
        "agrees": float(agrees(disagreements(fit))),
    }
    return result | _weighted(found if index < row.full_cases else None, truth)


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Sharpness, coverage at each level, width, and how the full posterior compares."""
    error, sd, bound = (cases[n].values for n in ("log_error", "log_sd", "bound"))
    shift, ratio = cases["full_shift"].values, cases["full_sd_ratio"].values
    beside = np.isfinite(shift)
    line: dict[str, float | str] = {
        "n": float(error.size),
        "bound_%": 100.0 * float(np.median(bound)),
        "sd/bound": float(np.median(sd / bound)),
        "scatter/bound": float(np.sqrt(np.mean((error / bound) ** 2))),
        "bias_%": 100.0 * float(error.mean()),
        "bias_se_%": 100.0 * float(error.std()) / math.sqrt(error.size),
        "width_%": 100.0 * float(np.median(cases["width"].values)),
    }
    line |= {f"cover_{p:.0%}": coverage(cases["rank"].values, p) for p in LEVELS}
    line |= {
        "claimed/actual": float(np.sqrt(np.mean(sd**2) / np.mean(error**2))),
        "refused": float(np.mean(cases["agrees"].values == 0.0)),
        "full_n": float(beside.sum()),
    }
    if np.any(beside):
        line |= {
            "full_shift_sd": float(np.max(np.abs(shift[beside]))),
            "full_sd_ratio_low": float(ratio[beside].min()),
            "full_sd_ratio_high": float(ratio[beside].max()),
            "full_effective": float(cases["effective"].values[beside].min()),
        }
    return line


def _weighted(found: DirectPosterior | None, truth: float) -> dict[str, float]:
    """The same draws with the weights that full simulation of all of them gives."""
    if found is None:
        names = ("full_shift", "full_sd_ratio", "full_rank", "effective")
        return dict.fromkeys(names, math.nan)
    draws = found.draws.reshape(-1, found.draws.shape[-1])
    log_gap = np.log(found.values(GAP)).ravel()
    log_weights = -0.5 * (simulated_chi_square(found.fit.model, draws) - found.chi_square.ravel())
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    mean = float(weights @ log_gap)
    return {
        "full_shift": (mean - float(log_gap.mean())) / float(log_gap.std()),
        "full_sd_ratio": math.sqrt(weights @ (log_gap - mean) ** 2) / float(log_gap.std()),
        "full_rank": float(weights @ (log_gap < truth)),
        "effective": effective_size(log_weights) / log_gap.size,
    }
