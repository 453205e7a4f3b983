"""A second, independent sampler on the same posterior: nested sampling by dynesty.

emcee starts at the optimum and sees what its walkers reach. Nested sampling starts from the whole
box, here everything around the optimum that is not the same solution again, and closes in on
whatever modes the box holds. Where both agree, neither is likely to be wrong.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesbl.errors import ConfigError
from bayesbl.inference.covariance import Covariance
from bayesbl.inference.memory import Memory
from bayesbl.inference.optimum import Optimum
from bayesbl.inference.posterior import LogPosterior, Posterior, complete
from bayesbl.recording.types import FloatArray
from bayesbl.signal.objective import Objective
from bayesbl.signal.parameters import ROTATION, SEPARATION, START

LIVE_POINTS = 400
LAST_EVIDENCE = 0.1
"""ln of the share of the evidence that may be left unsampled."""
ROTATION_HALF_WIDTH = 0.01
"""Of the box in T_w, as a share of it: other periods are far worse than any posterior reaches."""

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
            expected="it beside bayesbl: pip install 'bayesbl[check]'",
        )


def check_sampler(
    objective: Objective,
    optimum: Optimum,
    spread: Covariance,
    posterior: Posterior,
    seed: np.random.SeedSequence,
    memory: Memory,
) -> SamplerCheck:
    """Sample the posterior again by nested sampling, and compare.

    Both sets of points go through the same drawing of the linear symbols and the same calibration.
    """
    nested_seed, linear_seed = seed.spawn(2)
    target = LogPosterior(objective, optimum, spread.scale)
    stored = memory.recall("nested")
    if stored is None:
        points, evaluations = _nested(target, *_box(objective, optimum, target), nested_seed)
        stored = {"points": points, "evaluations": np.array(evaluations)}
        memory.remember("nested", stored)
    generator = np.random.default_rng(linear_seed)
    nested, _, _ = complete(objective, optimum, spread, stored["points"][None], generator)
    difference, ratio = {}, {}
    for name, draws in posterior.draws.items():
        sd = float(draws.std())
        difference[name] = float(nested[name].mean() - draws.mean()) / sd
        ratio[name] = float(nested[name].std()) / sd
    return SamplerCheck(difference, ratio, int(stored["evaluations"]))


def _box(
    objective: Objective, optimum: Optimum, target: LogPosterior
) -> tuple[FloatArray, FloatArray]:
    """The prior's box without the copies of the optimum that are the same solution.

    Those stand whole rotations away in t0 and T, and, with A negated, where the pulses change
    places: T away in t0.
    """
    value = optimum.symbols
    rotation, separation = value[ROTATION], value[SEPARATION] % value[ROTATION]
    half_turn = 0.5 * min(separation, rotation - separation)
    reach = {START: half_turn, SEPARATION: half_turn, ROTATION: ROTATION_HALF_WIDTH * rotation}
    low, high = target.low.copy(), target.high.copy()
    for i, name in enumerate(objective.searched):
        if name in reach:
            low[i] = max(low[i], value[name] - reach[name])
            high[i] = min(high[i], value[name] + reach[name])
    return low, high


def _nested(
    target: LogPosterior, low: FloatArray, high: FloatArray, seed: np.random.SeedSequence
) -> tuple[FloatArray, int]:
    """Equally weighted points, shape (n, d), and the number of evaluations."""
    from dynesty import NestedSampler

    run_seed, weight_seed = seed.spawn(2)
    sampler = NestedSampler(
        lambda x: max(float(target(x[None])[0]), -1e300),
        lambda u: low + u * (high - low),
        low.size,
        nlive=LIVE_POINTS,
        sample="rwalk",
        rstate=np.random.default_rng(run_seed),
    )
    sampler.run_nested(dlogz=LAST_EVIDENCE, print_progress=False)
    points = sampler.results.samples_equal(rstate=np.random.default_rng(weight_seed))
    return np.asarray(points), int(np.sum(sampler.results.ncall))
