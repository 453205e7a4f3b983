"""Does the posterior of A, τ and ω hold what it promises on recordings of the disturbance model?

    bayesbl run configs/coverage_study.toml

Recordings with A = 20 rpm and all else drawn at random go through the whole fit: search, noise from
what does not repeat, sampling. Such recordings have no repeating misfit; coverage on recordings of
the virtual bench, which have, is another study (``gap_coverage.py``).
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
import xarray as xr
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PositiveInt

from bayesbl.config.fields import as_tuple
from bayesbl.inference.estimator import Estimator
from bayesbl.inference.posterior import SamplerSettings
from bayesbl.physics.noise import NoiseModel
from bayesbl.signal.parameters import AMPLITUDE, DECAY, FREQUENCY
from bayesbl.signal.synthetic import draw_symbols, synthetic_recording

AMPLITUDE_RPM = 20.0
LARGEST_BASELINE_RPM = 10.0
LEVEL = 0.9
SHOWN = {"amplitude": AMPLITUDE, "decay_rate": DECAY, "frequency": FREQUENCY}
"""Name in the table to symbol."""

COLUMNS = {
    "noise_order": ("1", "order of the noise found"),
    "withheld": ("1", "1 where the answer would be withheld"),
    **{
        f"{name}_{what}": ("1", f"{text} of {symbol}")
        for name, symbol in SHOWN.items()
        for what, text in (
            ("rank", "share of posterior draws below the truth"),
            ("error", "posterior mean less the truth, in posterior standard deviations,"),
        )
    },
}


class Row(BaseModel):
    """A row: recordings with one kind of noise."""

    model_config = ConfigDict(extra="forbid")

    cases: PositiveInt
    noise_sd_rpm: float = Field(gt=0.0)
    coefficients: Annotated[tuple[float, ...], BeforeValidator(as_tuple)] = ()


def count(row: Row) -> int:
    return row.cases


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> dict[str, float]:
    truth_seed, fit_seed = seed.spawn(2)
    generator = np.random.default_rng(truth_seed)
    truth = draw_symbols(generator, AMPLITUDE_RPM)
    size, phase = generator.uniform(0.0, LARGEST_BASELINE_RPM), generator.uniform(0.0, 2 * math.pi)
    recording = synthetic_recording(
        truth,
        NoiseModel(row.noise_sd_rpm, row.coefficients),
        generator,
        rotations=generator.uniform(4.0, 6.0),
        baseline_rpm=(size * math.cos(phase), size * math.sin(phase)),
    )
    # Two short ensembles: the interval's bounds need no more than a few hundred effective draws.
    fit = Estimator(sampler=SamplerSettings(ensembles=2, max_steps=1500)).fit(recording, fit_seed)
    values = {
        "noise_order": fit.point.noise.order,
        "withheld": fit.posterior.diagnostics.outcome == "withheld",
    }
    for name, symbol in SHOWN.items():
        draws = fit.posterior.draws[symbol]
        values[f"{name}_rank"] = np.mean(draws < truth[symbol])
        values[f"{name}_error"] = (draws.mean() - truth[symbol]) / draws.std()
    return values


def summarise(row: Row, cases: xr.Dataset) -> dict[str, float]:
    """Coverage of the 90 % interval, claimed over actual width, and bias in claimed sd."""
    order = cases["noise_order"].values
    line = {
        "right_noise_order": float(np.mean(order == len(row.coefficients))),
        "withheld": float(cases["withheld"].mean()),
    }
    for name in SHOWN:
        rank, error = cases[f"{name}_rank"].values, cases[f"{name}_error"].values
        line[f"{name}_coverage"] = float(np.mean(np.abs(rank - 0.5) <= 0.5 * LEVEL))
        line[f"{name}_claimed_over_actual"] = float(1.0 / np.std(error)) if len(error) > 1 else 1.0
        line[f"{name}_bias_sd"] = float(np.mean(error))
    return line
