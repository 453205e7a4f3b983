"""A second, independent sampler on the same posterior: nested sampling by dynesty.

emcee starts at the optimum and sees what its walkers reach. Nested sampling closes in from a wide
box around the optimum, and from one around every rival optimum that may matter; its evidence says
how much of the posterior each holds. Where both agree, neither is likely to be wrong.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesbl.errors import ConfigError
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.covariance import Covariance
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import Optimum
from bayesbl.ringing.posterior import (
    LogPosterior,
    Posterior,
    complete,
    weighed_by_likelihood,
)
from bayesbl.ringing.search import scatter_root
from bayesbl.ringing.symbols import FREQUENCY, SEPARATION, START

LIVE_POINTS = 400
LAST_EVIDENCE = 0.1
"""ln of the share of the evidence that may be left unsampled."""
HALF_WIDTH_SD = 12.0
"""Of a box, in standard deviations of the symbols there."""
FAINTEST_LOG_ODDS = -7.0
"""Rivals below this against the optimum hold less than a thousandth of the posterior."""

LARGEST_DIFFERENCE_SD = 0.25
LARGEST_WIDTH_RATIO = 1.25
"""Beyond these the samplers disagree; by chance alone they differ by 0.1 sd and 5 % at most."""


@dataclass(frozen=True, slots=True)
class SamplerCheck:
    """How far nested sampling and emcee are apart.

    Attributes
    ----------
    difference_sd
        By symbol, nested mean minus emcee's, in emcee's standard deviations.
    width_ratio
        By symbol, nested standard deviation over emcee's.
    evaluations
        Of the posterior, by the nested sampler.
    """

    difference_sd: Mapping[str, float]
    width_ratio: Mapping[str, float]
    evaluations: int

    @property
    def differing(self) -> tuple[str, ...]:
        """Symbols for which the two disagree."""
        return tuple(
            name
            for name, ratio in self.width_ratio.items()
            if not abs(self.difference_sd[name]) <= LARGEST_DIFFERENCE_SD
            or not 1.0 / LARGEST_WIDTH_RATIO <= ratio <= LARGEST_WIDTH_RATIO
        )

    @property
    def reason(self) -> str | None:
        """Why the posterior cannot be trusted; ``None`` where the samplers agree."""
        if not self.differing:
            return None
        told = ", ".join(
            f"{name} by {self.difference_sd[name]:+.2f} sd with {self.width_ratio[name]:.2f} "
            "times the width"
            for name in self.differing
        )
        return f"The second sampler disagrees with emcee: {told}."


def require_second_sampler() -> None:
    """Raises :class:`ConfigError` naming the extra if dynesty is not installed."""
    if importlib.util.find_spec("dynesty") is None:
        raise ConfigError(
            "The second sampler is not installed.",
            where="--check-sampler",
            found="no package dynesty",
            expected="dynesty, from: pip install 'bayesbl[check]'",
        )


def check_sampler(
    objective: Objective,
    optimum: Optimum,
    spread: Covariance,
    posterior: Posterior,
    seed: np.random.SeedSequence,
) -> SamplerCheck:
    """Sample the posterior again by nested sampling, and compare.

    Both sets of points go through the same drawing of the linear symbols and the same calibration.
    """
    nested_seed, linear_seed = seed.spawn(2)
    target = LogPosterior(objective, optimum, spread.scale)
    points, evaluations = _nested_over_modes(objective, optimum, target, spread, nested_seed)
    generator = np.random.default_rng(linear_seed)
    nested, _, _ = complete(objective, optimum, spread, points[None], generator)
    difference, ratio = {}, {}
    for name, draws in posterior.draws.items():
        sd = float(draws.std())
        difference[name] = float(nested[name].mean() - draws.mean()) / sd
        ratio[name] = float(nested[name].std()) / sd
    return SamplerCheck(difference, ratio, evaluations)


def _nested_over_modes(
    objective: Objective,
    optimum: Optimum,
    target: LogPosterior,
    spread: Covariance,
    seed: np.random.SeedSequence,
) -> tuple[FloatArray, int]:
    """Equally weighted points over all modes, shape (n, d), and the number of evaluations."""
    weighed = zip(weighed_by_likelihood(target, optimum), optimum.rivals, strict=True)
    rivals = [rival for contender, rival in weighed if contender.log_odds > FAINTEST_LOG_ODDS]
    centres = [
        np.array([symbols[name] for name in objective.searched])
        for symbols in (optimum.symbols, *(rival.symbols for rival in rivals))
    ]
    *seeds, mix_seed = seed.spawn(len(centres) + 1)
    runs = [
        _nested(target, *_box(objective, target, centre, spread.scale), s)
        for centre, s in zip(centres, seeds, strict=True)
    ]
    evidence = np.array([run.log_evidence for run in runs])
    shares = np.exp(evidence - evidence.max())
    count = len(runs[0].points)
    generator = np.random.default_rng(mix_seed)
    picked = generator.multinomial(count, shares / shares.sum())
    points = [
        generator.choice(run.points, n, replace=n > len(run.points))
        for run, n in zip(runs, picked, strict=True)
    ]
    return np.concatenate(points), sum(run.evaluations for run in runs)


def _box(
    objective: Objective, target: LogPosterior, centre: FloatArray, scale: float
) -> tuple[FloatArray, FloatArray]:
    """A box around a mode that no other mode's box overlaps.

    Modes are a quarter of a ringing apart in t0 or T, at least.
    """
    sd = np.sqrt(scale) * np.linalg.norm(scatter_root(objective, centre), axis=1)
    half = HALF_WIDTH_SD * sd
    frequency = {**objective.model.fixed, **dict(zip(objective.searched, centre, strict=True))}[
        FREQUENCY
    ]
    for i, name in enumerate(objective.searched):
        if name in (START, SEPARATION):
            half[i] = min(half[i], 0.25 * np.pi / frequency)
    return np.maximum(target.low, centre - half), np.minimum(target.high, centre + half)


@dataclass(frozen=True, slots=True)
class _Run:
    """Equally weighted points, shape (n, d), and what they weigh against other runs."""

    points: FloatArray
    log_evidence: float
    evaluations: int


def _nested(
    target: LogPosterior, low: FloatArray, high: FloatArray, seed: np.random.SeedSequence
) -> _Run:
    """Nested sampling of a box; the evidence is under a flat prior of density one."""
    from dynesty import NestedSampler

    run_seed, weight_seed = seed.spawn(2)
    sampler = NestedSampler(
        lambda x: float(target(x[None])[0]),
        lambda u: low + u * (high - low),
        low.size,
        nlive=LIVE_POINTS,
        sample="unif",
        rstate=np.random.default_rng(run_seed),
    )
    sampler.run_nested(dlogz=LAST_EVIDENCE, print_progress=False)
    results = sampler.results
    points = np.asarray(results.samples_equal(rstate=np.random.default_rng(weight_seed)))
    volume = float(np.sum(np.log(high - low)))
    return _Run(points, float(results.logz[-1]) + volume, int(np.sum(results.ncall)))
