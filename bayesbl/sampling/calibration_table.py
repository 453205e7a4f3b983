"""What the cases of a calibration study say of each quantity, as a line of its table."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from bayesbl.sampling.calibration import LEVELS, coverage, levels_missed, uniformity

if TYPE_CHECKING:
    import xarray as xr

WORDS = {
    "delta": "δ",
    "change": "change of δ",
    "amplitude": "A",
    "decay_rate": "τ",
    "frequency": "ω",
}
"""How tables and figures call what is asked for."""


def calibration_line(name: str, cases: xr.Dataset, *, from_prior: bool) -> dict[str, float | str]:
    """What the cases of a row say of one quantity.

    Parameters
    ----------
    cases
        ``NAME_rank`` of each truth, ``NAME_error`` of the posterior median and ``NAME_sd`` of the
        posterior; if they are there, ``NAME_shipped_rank`` beside ``withheld``, and
        ``NAME_emcee_rank``, which cases that lack it have as NaN.
    from_prior
        Whether truths came from the prior, so that their ranks should be uniform.
    """
    ranks = cases[f"{name}_rank"].values
    missed = levels_missed(ranks)
    line: dict[str, float | str] = {f"{name}_{p:.0%}": coverage(ranks, p) for p in LEVELS}
    line[f"{name}_holds"] = "not at " + " ".join(f"{p:.0%}" for p in missed) if missed else "yes"
    if from_prior:
        line[f"{name}_uniform_p"] = uniformity(ranks)
    standardised = cases[f"{name}_error"].values / cases[f"{name}_sd"].values
    line[f"{name}_bias_sd"] = float(np.mean(standardised))
    line[f"{name}_claimed/actual"] = 1.0 / math.sqrt(float(np.mean(standardised**2)))
    if f"{name}_shipped_rank" in cases:
        shipped = cases[f"{name}_shipped_rank"].values
        told = shipped[cases["withheld"].values == 0.0]
        line[f"{name}_told_90%"] = coverage(told, 0.9) if told.size else math.nan
    if f"{name}_emcee_rank" in cases:
        apart = ranks - cases[f"{name}_emcee_rank"].values
        apart = apart[np.isfinite(apart)]
        line["emcee_cases"] = float(apart.size)
        line[f"{name}_rank_off_emcee"] = math.sqrt(float(np.mean(apart**2)))
    return line
