"""Do rates pooled over a type hold the truth as often as said, and how much sharper are they?

    python experiments/pooled_coverage.py [FLEETS]

Fleets of 20 joints whose rates are log-normal, around a median that may depend on the load; each
joint is measured with an error of its own, and its posterior is that of a prior flat above zero.
Writes
``experiments/results/pooled_coverage.csv``.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
from scipy.stats import truncnorm

from bayesbl.fleet.pooled_rates import Pooled, pooled
from bayesbl.measurement.wear import KINDS, SCATTER, WearDraws
from bayesbl.recording.types import FloatArray
from bayesbl.results.provenance import git_commit

LEVELS = (0.05, 0.95)
MEDIAN = 4e-4
"""Of the rates, rad/year."""
JOINTS = 20
SETTINGS = (
    (0.1, 1.0, 0.0),
    (0.2, 0.6, 0.0),
    (0.6, 0.6, 0.0),
    (0.4, 0.15, 0.0),
    (0.2, 0.6, 0.7),
    (0.2, 0.15, 0.3),
)
"""Spread τ of ln rate; error of measuring over the median rate (halved to doubled by joint); what a
standard deviation of the load adds to ln rate."""

RESULT = Path(__file__).parent / "results" / "pooled_coverage.csv"


def fleet(
    generator: np.random.Generator,
    joints: int,
    spread: float,
    error: float,
    of_load: FloatArray | float = 0.0,
) -> tuple[FloatArray, list[FloatArray]]:
    """True rates and draws of each joint's posterior; ``of_load`` is what it adds to ln rate."""
    truth = MEDIAN * np.exp(of_load + spread * generator.standard_normal(joints))
    sd = error * MEDIAN * generator.uniform(0.5, 2.0, joints)
    measured = truth + sd * generator.standard_normal(joints)
    draws = [
        truncnorm.rvs(-m / s, np.inf, m, s, 1000, random_state=generator)
        for m, s in zip(measured, sd, strict=True)
    ]
    return truth, draws


def of_rate(rate: FloatArray, generator: np.random.Generator) -> WearDraws:
    """Draws of a joint that tells nothing of laws and jumps: these are of the prior."""
    kind = generator.choice(len(KINDS), rate.size, p=[one.probability for one in KINDS])
    scatter = SCATTER[0] * (SCATTER[1] / SCATTER[0]) ** generator.uniform(size=rate.size)
    return WearDraws(rate, kind, rate * scatter**2, rate)


def bounds(draws: list[FloatArray]) -> FloatArray:
    """Of the interval of each joint, shape (joint, 2)."""
    return np.array([np.quantile(one, LEVELS) for one in draws])


def case(seed: int, spread: float, error: float, slope: float = 0.0) -> dict[str, float]:
    """One fleet: shares held, and the width of pooled intervals over those alone."""
    generator = np.random.default_rng(seed)
    load = np.random.default_rng([seed, 1]).standard_normal(JOINTS)
    load = (load - load.mean()) / load.std()
    truth, rates = fleet(generator, JOINTS, spread, error, slope * load)
    draws = [of_rate(own, generator) for own in rates]
    found = pooled(draws, generator, {"load": load} if slope else {})
    assert found is not None
    together = bounds(chosen(rates, found))
    alone = bounds(rates)
    of_type = np.quantile(found.rates.median_rad_per_year, LEVELS)
    if slope:
        without = pooled(draws, generator)
        assert without is not None
        factor = np.quantile(found.rates.factors["load"].draws, LEVELS)
        ratio = np.median(np.diff(together)) / np.median(np.diff(bounds(chosen(rates, without))))
        told = {
            "factor_held": float(factor[0] <= np.exp(slope) <= factor[1]),
            "width_over_without_load": float(ratio),
        }
    else:
        told = dict.fromkeys(("factor_held", "width_over_without_load"), np.nan)
    return {
        "held": float(np.mean((together[:, 0] <= truth) & (truth <= together[:, 1]))),
        "held_alone": float(np.mean((alone[:, 0] <= truth) & (truth <= alone[:, 1]))),
        "median_held": float(of_type[0] <= MEDIAN <= of_type[1]),
        "width_over_alone": float(np.median(np.diff(together)) / np.median(np.diff(alone))),
        "stay_alone": float(np.mean([one.chosen is None for one in found.joints])),
        **told,
    }


def chosen(rates: list[FloatArray], found: Pooled) -> list[FloatArray]:
    """Draws of each joint with what its type says."""
    return [
        own if one.chosen is None else own[one.chosen]
        for own, one in zip(rates, found.joints, strict=True)
    ]


def main(fleets: int = 60) -> None:
    """A row for each setting."""
    rows = []
    for spread, error, slope in SETTINGS:
        cases = [case(seed, spread, error, slope) for seed in range(fleets)]
        means = {key: f"{np.mean([one[key] for one in cases]):.3f}" for key in cases[0]}
        rows.append({"spread": spread, "error": error, "load": slope, "fleets": fleets, **means})
        print(rows[-1], flush=True)
    with RESULT.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [*rows[0], "commit"], lineterminator="\n")
        writer.writeheader()
        writer.writerows({**row, "commit": git_commit()} for row in rows)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
