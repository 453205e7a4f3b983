"""The posterior of the disturbance model around its RMSE optimum, by emcee.

The likelihood is exp(−SSE(θ) / 2κ): centred on the least-squares optimum, which is what the gap
curve means by A, and as wide as the recording's own noise and impacts make it (docs/design.md,
"Statistics"). What impacts lose that come early and late is given back to A.
Priors are flat in every symbol within its range. emcee walks over the symbols that enter
nonlinearly; A, v_t and the baseline are linear, integrated out exactly and drawn afterwards.

A second, independent sampler on the same posterior: nested sampling by dynesty.

emcee starts at the optimum and sees what its walkers reach. Nested sampling closes in from a wide
box around the optimum, and from one around every rival optimum that may matter; its evidence says
how much of the posterior each holds. Where both agree, neither is likely to be wrong.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesbl.errors import ConfigError
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
"""Of each ensemble: with four the edge of a 90 % interval scatters by 0.023 standard deviations."""


@dataclass(frozen=True, slots=True)
class Posterior:
    """Draws of every free symbol.

    Attributes
    ----------
    draws
        Free symbols by name, each of shape (chain, draw); chain = ensemble.
    baseline_rpm
        cos and sin of each load-angle harmonic, shape (chain, draw, 2k).
    log_likelihood
        −SSE/2κ with the linear symbols at their best, shape (chain, draw).
    """

    draws: dict[str, FloatArray]
    baseline_rpm: FloatArray
    log_likelihood: FloatArray
    diagnostics: Diagnostics


class LogPosterior:
    """log p(searched symbols | recording), A, v_t and the baseline integrated out."""

    def __init__(self, objective: Objective, optimum: Optimum, scale: float) -> None:
        self._objective = objective
        self._scale = scale
        low, high = bounds(objective)
        self.low, self.high = low, high
        self._least = optimum.sum_of_squares

    def __call__(self, points: FloatArray) -> FloatArray:
        """Shape (m, d) to (m,), up to a constant; −inf outside the ranges."""
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
    """Sample until converged or ``settings.max_steps`` is reached.

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
    walked = walk(
        ensembles,
        settings,
        lambda chains: _interval_edges(objective, chains, settings.level),
        math.sqrt(spread.sandwich[0, 0]),
        progress,
    )
    generator = np.random.default_rng(linear_seed)
    points = np.stack([thinned(chain) for chain in walked.chains])
    draws, baseline, log_likelihood = complete(point, points, generator)
    diagnostics = walked.judged(
        draws, point.signal_to_noise, _at_bound(objective, points), _other_answer(point, target)
    )
    return Posterior(draws, baseline, log_likelihood, diagnostics)


def weighed_by_likelihood(target: LogPosterior, optimum: Optimum) -> tuple[Contender, ...]:
    """The optimum's rivals, weighed by the height of the posterior there.

    The peaks are assumed to be equally wide; a rival outside the ranges has no weight.
    """
    if not optimum.rivals:
        return ()
    names = optimum.model.searched
    points = np.array([[r.symbols[name] for name in names] for r in optimum.rivals])
    height, own = target(points), target(optimum.searched[None])[0]
    odds = np.full(height.shape, -np.inf)
    np.subtract(height, own, out=odds, where=np.isfinite(height))
    return tuple(
        Contender(r.symbols[AMPLITUDE], float(o)) for r, o in zip(optimum.rivals, odds, strict=True)
    )


def _other_answer(point: PointEstimate, target: LogPosterior) -> Contender | None:
    """The likeliest contender whose amplitude differs from the optimum's."""
    own, sd = point.optimum.symbols[AMPLITUDE], math.sqrt(point.spread.sandwich[0, 0])
    contenders = point.contenders
    if contenders is None:
        contenders = weighed_by_likelihood(target, point.optimum)
    others = [c for c in contenders if abs(c.amplitude_rpm - own) > sd]
    return max(others, key=lambda c: c.log_odds, default=None)


def _interval_edges(objective: Objective, chains: FloatArray, level: float) -> FloatArray:
    """Bounds of the interval of A's conditional mean over all ensembles, rpm."""
    points = np.concatenate([thinned(chain, DRAWS_FOR_EDGES) for chain in chains])
    amplitude = objective.solve(points).coefficients[:, -1]
    return np.asarray(np.quantile(amplitude, [0.5 - 0.5 * level, 0.5 + 0.5 * level]))


def complete(
    point: PointEstimate, points: FloatArray, generator: np.random.Generator
) -> tuple[dict[str, FloatArray], FloatArray, FloatArray]:
    """Draw the linear symbols given the searched ones, then calibrate every width to the noise.

    Draws that calibration carries beyond a symbol's range, where the prior is zero, are put at the
    bound: for a symbol that the recording hardly determines, the map leads to decays that grow.

    Parameters
    ----------
    points
        Of the searched symbols, shape (chain, draw, d).

    Returns
    -------
    Draws by name, baseline and log likelihood, as :class:`Posterior` holds them.
    """
    objective, optimum, spread = point.objective, point.optimum, point.spread
    chains, count, d = points.shape
    flat = points.reshape(-1, d)
    solution = objective.solve(flat)
    linear = solution.coefficients.copy()
    free_linear = np.flatnonzero(solution.factor[0].diagonal() > 0.0)
    factor = solution.factor[:, free_linear[:, None], free_linear]
    white = math.sqrt(spread.scale) * generator.standard_normal((len(flat), free_linear.size, 1))
    linear[:, free_linear] += np.linalg.solve(np.swapaxes(factor, 1, 2), white)[:, :, 0]

    values = {name: flat[:, i] for i, name in enumerate(objective.searched)}
    values[AMPLITUDE], values[MEAN] = linear[:, -1], linear[:, 0]
    names = spread.names
    symbols = [n for n in names if n in values]
    stacked = np.column_stack([*(values[n] for n in symbols), linear[:, 1:-1]])
    centre = np.r_[[optimum.symbols[n] for n in symbols], optimum.baseline_rpm]
    case = generator.integers(spread.factors.size, size=len(flat))
    wider = np.sqrt(spread.factors[case])
    stacked = centre + wider[:, None] * ((stacked - centre) @ spread.calibration.T)
    stacked[:, 0] *= 1.0 + spread.losses[case]
    ranged = [symbols.index(n) for n in objective.searched]
    stacked[:, ranged] = np.clip(stacked[:, ranged], *bounds(objective))

    shape = (chains, count)
    draws = {n: stacked[:, i].reshape(shape) for i, n in enumerate(symbols)}
    baseline = stacked[:, len(symbols) :].reshape(*shape, -1)
    log_likelihood = -0.5 * (solution.sum_of_squares - optimum.sum_of_squares) / spread.scale
    return draws, baseline, log_likelihood.reshape(shape)


def _at_bound(objective: Objective, points: FloatArray) -> dict[str, float]:
    """By symbol, the share of draws within half a standard deviation of a bound of its range.

    A posterior that ends before its bound has hardly any, one cut off at its peak a quarter.
    """
    low, high = bounds(objective)
    near = 0.5 * points.std(axis=(0, 1))
    close = (points < low + near) | (points > high - near)
    return dict(zip(objective.searched, close.mean(axis=(0, 1)).tolist(), strict=True))


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
    """

    difference_sd: Mapping[str, float]
    width_ratio: Mapping[str, float]

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
        differences = ", ".join(
            f"{name} by {self.difference_sd[name]:+.2f} sd with {self.width_ratio[name]:.2f} "
            "times the width"
            for name in self.differing
        )
        return f"The second sampler disagrees with emcee: {differences}."


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
    point: PointEstimate, posterior: Posterior, seed: np.random.SeedSequence
) -> SamplerCheck:
    """Sample the posterior again by nested sampling, and compare.

    Both sets of points go through the same drawing of the linear symbols and the same calibration.
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
    weighed = zip(weighed_by_likelihood(target, optimum), optimum.rivals, strict=True)
    rivals = [rival for contender, rival in weighed if contender.log_odds > FAINTEST_LOG_ODDS]
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
    picked = generator.multinomial(len(points[0]), shares / shares.sum())
    mixed = [
        generator.choice(own, n, replace=n > len(own))
        for own, n in zip(points, picked, strict=True)
    ]
    return np.concatenate(mixed)


def _box(
    objective: Objective, target: LogPosterior, centre: FloatArray, scale: float
) -> tuple[FloatArray, FloatArray]:
    """A box around a mode that no other mode's box overlaps.

    Modes are a quarter of a ringing apart in t0 or T, at least.
    """
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
    """Nested sampling of a box: equally weighted points, shape (n, d), and the log evidence.

    The evidence is under a flat prior of density one.
    """
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
    return points, float(results.logz[-1]) + volume
