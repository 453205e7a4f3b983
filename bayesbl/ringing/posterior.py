"""The posterior of the disturbance model around its RMSE optimum, by emcee.

The likelihood is exp(−SSE(θ) / 2κ). It is centred on the least-squares optimum, which is how the
gap curve defines A, and its width is set by the recording's own noise and impacts (docs/design.md,
"Statistics"). A is corrected for the loss by early and late impacts.
Priors are flat in every symbol within its range. emcee samples the nonlinear symbols. A, v_t and
the baseline are linear, so they are integrated out exactly and drawn afterwards.

A second, independent sampler of the same posterior is nested sampling by dynesty. emcee starts at
the optimum and sees only what its walkers reach. Nested sampling contracts from a wide box around
the optimum and around every rival optimum that may matter. Its evidence gives the share of the
posterior in each. If both agree, neither is likely to be wrong.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesbl.errors import ConfigError
from bayesbl.probabilities import ends
from bayesbl.progress import Progress
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.covariance import PointEstimate
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import Optimum, bounds
from bayesbl.ringing.search import scatter_root
from bayesbl.ringing.symbols import AMPLITUDE, FREQUENCY, MEAN, SEPARATION, START
from bayesbl.sampling.chains import Ensembles, SamplerSettings, thinned, walk
from bayesbl.sampling.convergence import Contender, Diagnostics

DRAWS_FOR_EDGES = 2000
"""Draws per ensemble; with four of these, the edge of a 90 % interval scatters by 0.023 sd."""


@dataclass(frozen=True, slots=True)
class Posterior:
    """Posterior draws of every free symbol.

    Attributes
    ----------
    draws
        Free symbols by name, each of shape (chain, draw); chain = ensemble.
    baseline_rpm
        cos and sin of each load-angle harmonic, shape (chain, draw, 2k).
    log_likelihood
        −SSE/2κ maximised over the linear symbols, shape (chain, draw).
    """

    draws: dict[str, FloatArray]
    baseline_rpm: FloatArray
    log_likelihood: FloatArray
    diagnostics: Diagnostics


class LogPosterior:
    """log p(searched symbols | recording), with A, v_t and the baseline integrated out."""

    def __init__(self, objective: Objective, optimum: Optimum, scale: float) -> None:
        self._objective = objective
        self._scale = scale
        low, high = bounds(objective)
        self.low, self.high = low, high
        self._least = optimum.sum_of_squares

    def __call__(self, points: FloatArray) -> FloatArray:
        """Log posterior up to a constant, shape (m, d) to (m,); −inf outside the ranges."""
        sse, volume = self._objective.sum_of_squares_and_volume(points)
        value = -0.5 * ((sse - self._least) / self._scale + volume)
        inside = np.all((points >= self.low) & (points <= self.high), axis=1)
        return np.where(inside & np.isfinite(sse), value, -np.inf)


def sample_posterior(
    point: PointEstimate,
    settings: SamplerSettings,
    seed: np.random.SeedSequence,
    progress: Progress | None = None,
) -> Posterior:
    """Sample until converged or until ``settings.max_steps`` is reached.

    Parameters
    ----------
    seed
        One child is spawned for the ensembles and one for the linear symbols.
    progress
        Called with (steps made, steps allowed) at every check.
    """
    objective, optimum, spread = point.objective, point.optimum, point.spread
    walk_seed, linear_seed = seed.spawn(2)
    target = LogPosterior(objective, optimum, spread.scale)
    searched = np.array([spread.names.index(n) for n in objective.searched])
    local = spread.scale * spread.inverse_curvature[np.ix_(searched, searched)]
    box = (target.low, target.high)
    ensembles = Ensembles.around(
        target, optimum.searched, local, box, settings.ensembles, walk_seed
    )

    def amplitude_ends(chains: FloatArray) -> FloatArray:
        """Ends of the interval of A's conditional mean over all ensembles, rpm."""
        points = np.concatenate([thinned(chain, DRAWS_FOR_EDGES) for chain in chains])
        return ends(objective.solve(points).coefficients[:, -1], settings.level)

    walked = walk(
        ensembles,
        settings,
        amplitude_ends,
        math.sqrt(spread.sandwich[0, 0]),
        progress,
    )
    generator = np.random.default_rng(linear_seed)
    points = np.stack([thinned(chain) for chain in walked.chains])
    draws, baseline, log_likelihood = complete(point, points, generator)
    diagnostics = walked.judged(
        draws,
        signal_to_noise=point.signal_to_noise,
        at_bound=_at_bound(objective, points),
        other_answer=_other_answer(point, target),
    )
    return Posterior(draws, baseline, log_likelihood, diagnostics)


def weighed_by_likelihood(target: LogPosterior, optimum: Optimum) -> tuple[Contender, ...]:
    """Weight the optimum's rivals by the height of the posterior there.

    All peaks are assumed to be equally wide. A rival outside the ranges has no weight.
    """
    if not optimum.rivals:
        return ()
    names = optimum.model.searched
    points = np.array([[r.symbols[name] for name in names] for r in optimum.rivals])
    height, optimum_height = target(points), target(optimum.searched[None])[0]
    odds = np.full(height.shape, -np.inf)
    np.subtract(height, optimum_height, out=odds, where=np.isfinite(height))
    return tuple(
        Contender(r.symbols[AMPLITUDE], float(o)) for r, o in zip(optimum.rivals, odds, strict=True)
    )


def _other_answer(point: PointEstimate, target: LogPosterior) -> Contender | None:
    """The most probable contender whose amplitude differs from the optimum's."""
    amplitude_rpm, sd = point.optimum.symbols[AMPLITUDE], math.sqrt(point.spread.sandwich[0, 0])
    contenders = point.contenders
    if contenders is None:
        contenders = weighed_by_likelihood(target, point.optimum)
    different = [c for c in contenders if abs(c.amplitude_rpm - amplitude_rpm) > sd]
    return max(different, key=lambda c: c.log_odds, default=None)


def complete(
    point: PointEstimate, points: FloatArray, generator: np.random.Generator
) -> tuple[dict[str, FloatArray], FloatArray, FloatArray]:
    """Draw the linear symbols given the searched ones, then calibrate all widths to the noise.

    Calibration may move draws beyond a symbol's range, where the prior is zero. They are clipped to
    the bound: for a symbol that is hardly determined, negative decay rates would result.

    Parameters
    ----------
    points
        Draws of the searched symbols, shape (chain, draw, d).

    Returns
    -------
    Draws by name, baseline and log likelihood, as in :class:`Posterior`.
    """
    objective, optimum, spread = point.objective, point.optimum, point.spread
    chains, count, d = points.shape
    flat = points.reshape(-1, d)
    solution = objective.solve(flat)
    linear = solution.coefficients.copy()
    free_linear = np.flatnonzero(solution.factor[0].diagonal() > 0.0)
    factor = solution.factor[:, free_linear[:, None], free_linear]
    normal = math.sqrt(spread.scale) * generator.standard_normal((len(flat), free_linear.size, 1))
    linear[:, free_linear] += np.linalg.solve(np.swapaxes(factor, 1, 2), normal)[:, :, 0]

    values = {name: flat[:, i] for i, name in enumerate(objective.searched)}
    values[AMPLITUDE], values[MEAN] = linear[:, -1], linear[:, 0]
    names = spread.names
    symbols = [n for n in names if n in values]
    stacked = np.column_stack([*(values[n] for n in symbols), linear[:, 1:-1]])
    centre = np.r_[[optimum.symbols[n] for n in symbols], optimum.baseline_rpm]
    factor_index = generator.integers(spread.factors.size, size=len(flat))
    width_factor = np.sqrt(spread.factors[factor_index])
    stacked = centre + width_factor[:, None] * ((stacked - centre) @ spread.calibration.T)
    stacked[:, 0] *= 1.0 + spread.losses[factor_index]
    searched_columns = [symbols.index(n) for n in objective.searched]
    stacked[:, searched_columns] = np.clip(stacked[:, searched_columns], *bounds(objective))

    shape = (chains, count)
    draws = {n: stacked[:, i].reshape(shape) for i, n in enumerate(symbols)}
    baseline = stacked[:, len(symbols) :].reshape(*shape, -1)
    log_likelihood = -0.5 * (solution.sum_of_squares - optimum.sum_of_squares) / spread.scale
    return draws, baseline, log_likelihood.reshape(shape)


def _at_bound(objective: Objective, points: FloatArray) -> dict[str, float]:
    """Share of draws within half a standard deviation of a bound of the range, by symbol. It is
    near 0 if the posterior ends before the bound, and a quarter if it is cut off at its peak."""
    low, high = bounds(objective)
    near = 0.5 * points.std(axis=(0, 1))
    close = (points < low + near) | (points > high - near)
    return dict(zip(objective.searched, close.mean(axis=(0, 1)).tolist(), strict=True))


HALF_WIDTH_SD = 12.0
"""Half width of a box, in local standard deviations of the symbols."""
FAINTEST_LOG_ODDS = -7.0
"""Least log odds of a rival against the optimum; below, it holds under 0.1 % of the posterior."""

LARGEST_DIFFERENCE_SD = 0.25
LARGEST_WIDTH_RATIO = 1.25
"""Beyond these the samplers disagree; by chance they differ by at most 0.1 sd and 5 %."""


@dataclass(frozen=True, slots=True)
class SamplerCheck:
    """Difference between nested sampling and emcee.

    Attributes
    ----------
    difference_sd
        By symbol, nested mean minus emcee's, in emcee's standard deviations.
    width_ratio
        By symbol, nested standard deviation over emcee's.
    """

    difference_sd: Mapping[str, float]
    width_ratio: Mapping[str, float]

    @property
    def differing(self) -> tuple[str, ...]:
        """Symbols for which the samplers disagree."""
        return tuple(
            name
            for name, ratio in self.width_ratio.items()
            if not abs(self.difference_sd[name]) <= LARGEST_DIFFERENCE_SD
            or not 1.0 / LARGEST_WIDTH_RATIO <= ratio <= LARGEST_WIDTH_RATIO
        )

    @property
    def reason(self) -> str | None:
        """Why the posterior cannot be trusted; ``None`` if the samplers agree."""
        if not self.differing:
            return None
        differences = ", ".join(
            f"{name} by {self.difference_sd[name]:+.2f} sd with {self.width_ratio[name]:.2f} "
            "times the width"
            for name in self.differing
        )
        return f"The second sampler disagrees with emcee: {differences}."


def require_second_sampler() -> str:
    """The second sampler; raises :class:`ConfigError`, which names the extra, if it is missing."""
    if importlib.util.find_spec("dynesty") is None:
        raise ConfigError(
            "The second sampler is not installed.",
            where="--check-sampler",
            found="no package dynesty",
            expected="dynesty, from: pip install 'bayesbl[check]'",
        )
    return "dynesty"


def check_sampler(
    point: PointEstimate, posterior: Posterior, seed: np.random.SeedSequence
) -> SamplerCheck:
    """Sample the posterior again by nested sampling, and compare.

    For both sets of points, linear symbols are drawn and calibrated in the same way.
    """
    nested_seed, linear_seed = seed.spawn(2)
    points = _nested_over_modes(point, nested_seed)
    nested, _, _ = complete(point, points[None], np.random.default_rng(linear_seed))
    difference, ratio = {}, {}
    for name, draws in posterior.draws.items():
        sd = float(draws.std())
        difference[name] = float(nested[name].mean() - draws.mean()) / sd
        ratio[name] = float(nested[name].std()) / sd
    return SamplerCheck(difference, ratio)


def _nested_over_modes(point: PointEstimate, seed: np.random.SeedSequence) -> FloatArray:
    """Equally weighted points over all modes, shape (n, d)."""
    objective, optimum, scale = point.objective, point.optimum, point.spread.scale
    target = LogPosterior(objective, optimum, scale)
    weighted = zip(weighed_by_likelihood(target, optimum), optimum.rivals, strict=True)
    rivals = [rival for contender, rival in weighted if contender.log_odds > FAINTEST_LOG_ODDS]
    centres = [
        np.array([symbols[name] for name in objective.searched])
        for symbols in (optimum.symbols, *(rival.symbols for rival in rivals))
    ]
    *seeds, mix_seed = seed.spawn(len(centres) + 1)
    runs = [
        _nested(target, *_box(objective, target, centre, scale), s)
        for centre, s in zip(centres, seeds, strict=True)
    ]
    points, log_evidence = zip(*runs, strict=True)
    shares = np.exp(np.array(log_evidence) - max(log_evidence))
    generator = np.random.default_rng(mix_seed)
    counts = generator.multinomial(len(points[0]), shares / shares.sum())
    mixed = [
        generator.choice(mode_points, n, replace=n > len(mode_points))
        for mode_points, n in zip(points, counts, strict=True)
    ]
    return np.concatenate(mixed)


def _box(
    objective: Objective, target: LogPosterior, centre: FloatArray, scale: float
) -> tuple[FloatArray, FloatArray]:
    """A box around a mode that overlaps no other mode's box. Modes are at least a quarter of a
    ringing apart in t0 or T."""
    sd = np.sqrt(scale) * np.linalg.norm(scatter_root(objective, centre), axis=1)
    half = HALF_WIDTH_SD * sd
    frequency = objective.model.named(centre)[FREQUENCY]
    for i, name in enumerate(objective.searched):
        if name in (START, SEPARATION):
            half[i] = min(half[i], 0.25 * np.pi / frequency)
    return np.maximum(target.low, centre - half), np.minimum(target.high, centre + half)


def _nested(
    target: LogPosterior, low: FloatArray, high: FloatArray, seed: np.random.SeedSequence
) -> tuple[FloatArray, float]:
    """Nested sampling of a box: equally weighted points, shape (n, d), and the log evidence. The
    evidence is that under a flat prior of density one."""
    from dynesty import NestedSampler

    run_seed, weight_seed = seed.spawn(2)
    sampler = NestedSampler(
        lambda x: float(target(x[None])[0]),
        lambda u: low + u * (high - low),
        low.size,
        nlive=400,
        sample="unif",
        rstate=np.random.default_rng(run_seed),
    )
    # ln of the evidence changes by at most 0.1 by what is left unsampled.
    sampler.run_nested(dlogz=0.1, print_progress=False)
    results = sampler.results
    points = np.asarray(results.samples_equal(rstate=np.random.default_rng(weight_seed)))
    volume = float(np.sum(np.log(high - low)))
    return points, float(results.logz[-1]) + volume
