"""Posterior of the gap and all other unknowns, from simulations of the recordings.

Draws come from a second-order surrogate of the whitened signals: independent ones if it is roughly
normal within the ranges, otherwise by Hamiltonian Monte Carlo. Full simulations of some draws show
how far importance weights would move the answer. If that is less than the sampler's own error, the
draws are kept as they are. Otherwise the surrogate is fitted again around them. If no surrogate
suffices, all draws of the best are simulated and weighted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayesbl.bench.parameters import PARAMETER_INFO
from bayesbl.matching.impacts import scattered
from bayesbl.matching.least_squares import SimulatedFit, prior_pull
from bayesbl.matching.signals import GAP, SimulatedSignals
from bayesbl.matching.surrogate import Surrogate, points_needed, regress, simulated_chi_square
from bayesbl.probabilities import FALSE_ALARM, TOO_FEW, chi2_sf, ends
from bayesbl.progress import Progress, silent
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.chains import SamplerSettings, Walk, chance_at_edge, thinned, walk
from bayesbl.sampling.convergence import Diagnostics, Flaw
from bayesbl.sampling.importance import (
    effective_size,
    independent_draws,
    resampled,
    truncated_normal,
)
from bayesbl.sampling.trajectories import Trajectories

DRAWS = 1000
"""Draws over all ensembles."""
CHECKED = 100
"""Number of draws that are first simulated in full: weights with standard deviation s move a mean
by s/10 at random."""
MOST_PROPOSED = 256_000
"""Number of weighted draws of the surrogate."""
WALKERS = 32
"""Walkers of an ensemble: their trajectories are independent, and many at once are fast."""
MOST_TRAJECTORIES = 1000
"""Of a walker. If a far end of the surrogate is reached more slowly, simulations refute the draws
there sooner than more trajectories settle their share."""
MOST_REFITS = 3
GOOD_SHARE = 0.4
"""Effective share of the draws below which a surrogate is fitted again."""
FEWEST_EFFECTIVE = 100.0
"""Below it the answer is withheld: at 100 draws, the actual level of a 90 % interval is 90 ± 3 %.

The share of the posterior between two quantiles of n draws has the standard deviation √(p(1−p)/n),
with p its level.
"""
LEVEL = 0.9
MATTERS = 0.2
"""Share of an interval by which an error may move δ or its change without being reported."""
Side = Literal["lower", "upper"]


@dataclass(frozen=True, slots=True)
class NoiseOnly:
    """Draws of prior times likelihood with the recorder's noise alone.

    Attributes
    ----------
    draws
        Shape (chain, draw, d).
    log_likelihood
        For each recording, log density of its rotations by the surrogate, shape (chain, draw,
        rotation).
    """

    draws: FloatArray
    log_likelihood: tuple[FloatArray, ...]

    @classmethod
    def by(cls, model: SimulatedSignals, surrogate: Surrogate, draws: FloatArray) -> NoiseOnly:
        """``draws``: of that surrogate, shape (chain, draw, d)."""
        by_rotation = surrogate.chi_square_by_rotation(draws.reshape(-1, draws.shape[-1]))
        groups = [
            (model.rotation_log_density(i) - 0.5 * chi_square).reshape(*draws.shape[:2], -1)
            for i, chi_square in enumerate(by_rotation)
        ]
        return cls(draws, tuple(groups))


@dataclass(frozen=True, slots=True)
class DirectPosterior:
    """Draws of all unknowns.

    Attributes
    ----------
    draws
        Coordinates in the order of the model's ``unknowns``, shape (chain, draw, d); chain =
        ensemble.
    chi_square
        χ² of each draw before widening, shape (chain, draw); by full simulation if all draws were
        simulated.
    effective
        Effective sample size of all draws, by their importance weights or those of the checked
        draws.
    simulated
        Number of draws simulated in full.
    refits
        Number of further surrogate fits.
    widening
        Ratio of each coordinate's 90 % interval to that without the extra scatter of impacts, shape
        (d,).
    model_widening
        Ratio to that with the bench's laws and parameters held fixed, shape (d,).
    noise_only
        Draws before widening; ``None`` if nothing was simulated.
    """

    fit: SimulatedFit
    draws: FloatArray
    chi_square: FloatArray
    effective: float
    simulated: int
    refits: int
    diagnostics: Diagnostics
    widening: FloatArray
    model_widening: FloatArray
    noise_only: NoiseOnly | None = None

    def beyond_tolerance(self, recording: str, level: float) -> dict[str, Any] | None:
        """Bench parameter whose tolerance decides a recording's gap; ``None`` if none does.

        With the shift of δ: if the recordings contradict a tolerance or range, the true value may
        lie beyond. The tolerance, and not the recording, decides δ if removing it would shift δ, by
        the regression of δ on the parameter, by more than half its interval.
        """
        model = self.fit.model
        gap = self.values(GAP, recording).ravel()
        low, high = ends(gap, level)
        for i, side, reach, _ in _contradicted(model, self.draws):
            coordinate = self.draws[..., i].ravel()
            variance = float(coordinate.var(ddof=1))
            slope = float(np.cov(coordinate, gap)[0, 1]) / variance if variance > 0.0 else 0.0
            shift_rad = abs(slope) * reach
            if shift_rad > 0.5 * (high - low):
                name = model.unknowns[i].name.replace("__", ".")
                return {"name": name, "side": side, "shift_rad": shift_rad}
        return None

    @property
    def contradicted(self) -> list[Flaw]:
        """Stated values that the recordings contradict."""
        return [flaw for *_, flaw in _contradicted(self.fit.model, self.draws)]

    def contradicted_together(self) -> list[str]:
        """Stated values that the recordings contradict together, even without the worst one.

        One value of a data sheet may be wrong. Several together mean that the bench lacks
        something, and δ is as wrong as they are. For normal priors with covariance S around c, and
        a posterior with mean x and covariance V, x − c has the covariance S − V. So (x − c)ᵀS⁻¹(x −
        c) is a sum of squares with weights 1 − λ, λ the eigenvalues of S⁻¹V: values that the
        recordings hardly show hardly count. Empty if chance explains this (1 %); the largest
        deviation comes first.
        """
        model = self.fit.model
        indices = [
            k
            for k, u in enumerate(model.unknowns)
            if u.name in PARAMETER_INFO and u.recording is None and math.isfinite(u.sd)
        ]
        if len(indices) < 2:
            return []
        draws = self._flat[:, indices]
        stated = np.linalg.inv(model.normal_prior.precision[np.ix_(indices, indices)])
        deviations = draws.mean(axis=0) - model.normal_prior.centre[indices]
        root = np.linalg.inv(np.linalg.cholesky(stated))
        shares, axes = np.linalg.eigh(root @ np.cov(draws, rowvar=False) @ root.T)
        axes = root.T @ axes
        gain = (axes * np.maximum(1.0 / shares - 1.0, 0.0)) @ axes.T
        pull = (gain + root.T @ root) @ deviations

        def chance(worst: int) -> float:
            """p-value of the others if one value is not stated, by the moments of the sum."""
            others = [k for k in range(len(indices)) if k != worst]
            root = np.linalg.inv(np.linalg.cholesky(stated[np.ix_(others, others)]))
            precision = gain.copy()
            precision[np.ix_(others, others)] += root.T @ root
            posterior = np.linalg.pinv(precision, hermitian=True)
            whitened = root @ (posterior @ pull)[others]
            shares = np.linalg.eigvalsh(root @ posterior[np.ix_(others, others)] @ root.T)
            weights = np.clip(1.0 - shares, 1e-12, 1.0)
            mean, squares = float(weights.sum()), float(np.sum(weights**2))
            return float(chi2_sf(float(whitened @ whitened) * mean / squares, mean**2 / squares))

        if max(map(chance, range(len(indices)))) > FALSE_ALARM:
            return []
        order = np.argsort(-np.abs(deviations) / np.sqrt(np.diag(stated)))
        return [model.unknowns[indices[k]].name for k in order]

    def with_model(self, draws: FloatArray) -> DirectPosterior:
        """The posterior with draws (n, d) in place of these, widened by what the bench may lack."""
        factor = self.model_widening * _width_ratio(self._flat, draws)
        return replace(self, draws=draws.reshape(self.draws.shape), model_widening=factor)

    @property
    def _flat(self) -> FloatArray:
        return self.draws.reshape(-1, self.draws.shape[-1])

    def values(self, name: str, recording: str | None = None) -> FloatArray:
        """Draws of one unknown's value, shape (chain, draw)."""
        i = self.fit.model.index(name, recording)
        return self.fit.model.unknowns[i].value(self.draws[..., i])


def _log_density(model: SimulatedSignals, surrogate: Surrogate, points: FloatArray) -> FloatArray:
    """ln posterior density by the surrogate, (m, d) to (m,)."""
    prior, chi_square = model.log_prior(points), surrogate.chi_square(points)
    # Far from the recordings χ² overflows; such a point has no weight.
    finite = np.isfinite(chi_square)
    return np.where(finite, prior, -np.inf) - 0.5 * np.where(finite, chi_square, 0.0)


def _density_and_slope(
    model: SimulatedSignals, surrogate: Surrogate, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """ln posterior density by the surrogate and its gradient, (m, d) to (m,) and (m, d)."""
    chi_square, slope = surrogate.with_gradient(points)
    density = model.log_prior(points) - 0.5 * chi_square
    return density, prior_pull(model, points) - 0.5 * slope


def sample_direct(
    fit: SimulatedFit,
    settings: SamplerSettings,
    seed: np.random.SeedSequence,
    progress: Progress = silent,
    simulating: Progress = silent,
    *,
    withheld: bool = False,
) -> DirectPosterior:
    """Sample the posterior around the most probable point, with the recorder's noise alone.

    Parameters
    ----------
    withheld
        The gap will not be reported: draw from the normal approximation, without simulations.
    progress
        Called with (steps made, steps allowed) at every check.
    simulating
        Called with (simulations made, simulations to make) before the steps, and after them if the
        draws are simulated in full.
    """
    model = fit.model
    design_seed, pick_seed, *walk_seeds = seed.spawn(3 + MOST_REFITS)
    if withheld:
        return _unsimulated(fit, settings, design_seed)
    local = _Local(fit.point, fit.peak(), fit.covariance)
    needed = points_needed(model)
    points = local.drawn(needed, (model.low, model.high), design_seed)
    chi_square, surrogate = regress(
        model, points, points.mean(axis=0), _covariance(points), simulating
    )
    best: _Weighted | None = None
    for refits, walk_seed in enumerate(walk_seeds):
        walked = _walk(model, surrogate, local, settings, walk_seed, progress)
        draws = np.stack([thinned(c, DRAWS // len(walked.chains)) for c in walked.chains])
        flat = draws.reshape(-1, draws.shape[-1])
        expected = surrogate.chi_square(flat)
        checked = np.linspace(0, len(flat) - 1, CHECKED).astype(np.int64)
        log_weights = _log_weights(expected[checked], simulated_chi_square(model, flat[checked]))
        if _would_stay(flat, checked, log_weights):
            effective = effective_size(log_weights) / CHECKED * len(flat)
            weighted = _Weighted(walked, draws, expected, log_weights, effective, CHECKED, refits)
            diagnostics = _judge(model, weighted, float(np.mean(~np.isfinite(chi_square))))
            return weighted.posterior(fit, surrogate, diagnostics)
        local = _Local(flat.mean(axis=0), flat.mean(axis=0), _covariance(flat))
        used = np.linspace(0, len(flat) - 1, min(needed, len(flat))).astype(np.int64)
        chi_square, surrogate = regress(
            model, flat[used], local.centre, local.covariance, simulating
        )
        log_weights = _log_weights(expected[used], chi_square)
        effective = effective_size(log_weights) / used.size * len(flat)
        if best is not None and effective <= best.effective:
            break  # made of draws that hardly weigh: no surrogate made of it can be better
        best = _Weighted(walked, draws, expected, log_weights, effective, len(flat), refits)
    assert best is not None
    flat = best.draws.reshape(-1, best.draws.shape[-1])
    chi_square = simulated_chi_square(model, flat)
    log_weights = _log_weights(best.chi_square, chi_square)
    best = replace(
        best,
        chi_square=chi_square,
        log_weights=log_weights,
        effective=effective_size(log_weights),
    )
    why = "other_shape"
    generator = np.random.default_rng(pick_seed)
    picked = resampled(best.log_weights.reshape(draws.shape[:2]), draws.shape[1], generator)
    if best.effective < FEWEST_EFFECTIVE and _ticks_decide(fit, generator):
        why = "ticks_decide"
    diagnostics = _judge(model, best, float(np.mean(~np.isfinite(best.chi_square))), why)
    return best.posterior(fit, surrogate, diagnostics, picked)


def _unsimulated(
    fit: SimulatedFit, settings: SamplerSettings, seed: np.random.SeedSequence
) -> DirectPosterior:
    """Draws from the normal approximation at the optimum, within the ranges."""
    model = fit.model
    count = settings.ensembles * (DRAWS // settings.ensembles)
    # The peak of a bad fit may be far from all points within the ranges.
    about = _Local(fit.point, fit.point, fit.covariance)
    walked = _independent(about.drawn(count, (model.low, model.high), seed), settings, 1.0)
    draws = np.stack([chain[:, 0] for chain in walked.chains])
    deviations = draws - fit.point
    chi_square = fit.chi_square + np.einsum("cni,ij,cnj->cn", deviations, fit.curvature, deviations)
    drawn = _Weighted(walked, draws, chi_square, np.zeros(count), float(count), 0, 0)
    return drawn.posterior(fit, None, _judge(model, replace(drawn, effective=math.inf), 0.0))


def _independent(draws: FloatArray, settings: SamplerSettings, share: float) -> Walk:
    """Independent draws (n, d) as chains of one walker each."""
    chains = tuple(np.array_split(draws[:, None], settings.ensembles))
    return Walk(chains, 1.0, len(chains[-1]), np.full(settings.ensembles, share), True)


def widened(posterior: DirectPosterior, seed: np.random.SeedSequence) -> DirectPosterior:
    """Add the extra scatter of impacts to the draws, within the ranges of the unknowns.

    See :mod:`bayesbl.matching.impacts`.
    """
    model = posterior.fit.model
    flat = posterior.draws.reshape(-1, posterior.draws.shape[-1])
    wider = scattered(posterior.fit, flat, _covariance(flat), np.random.default_rng(seed))
    # A draw that would leave its range stays as it was.
    within = np.all((wider > model.low) & (wider < model.high), axis=1)
    wider = np.where(within[:, None], wider, flat)
    widening = _width_ratio(flat, wider)
    return replace(posterior, draws=wider.reshape(posterior.draws.shape), widening=widening)


def _width_ratio(before: FloatArray, after: FloatArray) -> FloatArray:
    """Ratio of the 90 % intervals of draws (n, d), shape (d,)."""
    width_after, width_before = (np.ptp(ends(d, LEVEL, 0), axis=0) for d in (after, before))
    return np.asarray(width_after / np.maximum(width_before, 1e-300))


@dataclass(frozen=True, slots=True)
class _Local:
    """Approximate posterior: a normal distribution, and a point within the ranges."""

    centre: FloatArray
    peak: FloatArray
    covariance: FloatArray

    def drawn(
        self, count: int, box: tuple[FloatArray, FloatArray], seed: np.random.SeedSequence
    ) -> FloatArray:
        """Draws within a box, shape (count, d)."""
        generator = np.random.default_rng(seed)
        return truncated_normal(self.peak, self.covariance, box, count, generator)


def _would_stay(draws: FloatArray, checked: NDArray[np.int64], log_weights: FloatArray) -> bool:
    """Whether weights would move means and interval levels by less than the sampling error.

    Scatter of the weights alone does no harm: the ticks of a sampled controller change χ² from draw
    to draw like noise. What counts is whether the weights of the checked draws, (n,), move a mean
    or an end of an interval of all draws, (m, d). Root mean squares over the coordinates are
    compared with the error of the fewest draws that may be reported.
    """
    share = effective_size(log_weights) / log_weights.size
    if not np.all(np.isfinite(log_weights)) or share < GOOD_SHARE:
        return False
    low, high = ends(draws, LEVEL, 0)
    sd = np.maximum(draws.std(axis=0), 1e-300)
    deviations = (draws[checked] - draws.mean(axis=0)) / sd
    within = (draws[checked] >= low) & (draws[checked] <= high)
    weights = np.exp(log_weights - log_weights.max())
    excess = weights / weights.sum() - 1.0 / weights.size
    mean, level = (math.sqrt(np.mean((excess @ values) ** 2)) for values in (deviations, within))
    scatter = 1.0 / math.sqrt(FEWEST_EFFECTIVE)
    return mean < scatter and level < scatter * math.sqrt(LEVEL * (1.0 - LEVEL))


@dataclass(frozen=True, slots=True)
class _Weighted:
    """Draws of a surrogate, (chain, draw, d), with their χ² and importance weights, (m,)."""

    walked: Walk
    draws: FloatArray
    chi_square: FloatArray
    log_weights: FloatArray
    effective: float
    simulated: int
    refits: int

    def posterior(
        self,
        fit: SimulatedFit,
        surrogate: Surrogate | None,
        diagnostics: Diagnostics,
        picked: NDArray[np.int64] | None = None,
    ) -> DirectPosterior:
        """The posterior by these draws, or by those picked from each chain, (chain, draw)."""
        draws, chi_square = self.draws, self.chi_square.reshape(self.draws.shape[:2])
        if picked is not None:
            draws = np.take_along_axis(draws, picked[..., None], axis=1)
            chi_square = np.take_along_axis(chi_square, picked, axis=1)
        as_it_is = np.ones(draws.shape[-1])
        return DirectPosterior(
            fit,
            draws,
            chi_square,
            self.effective,
            self.simulated,
            self.refits,
            diagnostics,
            as_it_is,
            as_it_is,
            None if surrogate is None else NoiseOnly.by(fit.model, surrogate, draws),
        )


def _log_weights(expected: FloatArray, chi_square: FloatArray) -> FloatArray:
    """ln weights of draws from simulated and surrogate χ², (m,) each; −∞ if a simulation failed."""
    return np.where(np.isfinite(chi_square), -0.5 * np.nan_to_num(chi_square - expected), -np.inf)


def _walk(
    model: SimulatedSignals,
    surrogate: Surrogate,
    local: _Local,
    settings: SamplerSettings,
    seed: np.random.SeedSequence,
    progress: Progress,
) -> Walk:
    """Independent draws, or trajectories until chains are long and the gap's interval is stable."""
    target, box = partial(_log_density, model, surrogate), (model.low, model.high)
    generator = np.random.default_rng(seed.spawn(1)[0])
    independent = independent_draws(
        target, local.peak, local.covariance, box, DRAWS, generator, most=MOST_PROPOSED
    )
    if independent is not None:
        points, chosen, share = independent
        return _independent(points[chosen], settings, share)
    start_seed, walk_seed = seed.spawn(2)
    starts = local.drawn(settings.ensembles * WALKERS, box, start_seed)
    starts = starts.reshape(settings.ensembles, WALKERS, -1)
    slope = partial(_density_and_slope, model, surrogate)
    ensembles = Trajectories(slope, starts, local.covariance, box, walk_seed)
    gaps = [i for i, u in enumerate(model.unknowns) if u.name == GAP]
    return walk(
        ensembles,
        replace(settings, max_steps=min(settings.max_steps, MOST_TRAJECTORIES)),
        lambda chains: ends(chains[..., gaps], settings.level, (0, 1, 2)),
        np.sqrt(np.diag(local.covariance))[gaps],
        progress,
    )


def _covariance(points: FloatArray) -> FloatArray:
    """Covariance of draws, (m, d) to (d, d); never singular, even if draws are at a bound."""
    covariance = np.atleast_2d(np.cov(points.T))
    return np.asarray(covariance + 1e-12 * np.diag(np.diag(covariance) + 1e-30))


def _ticks_decide(fit: SimulatedFit, generator: np.random.Generator) -> bool:
    """Whether the effective sample size would suffice if the controller's ticks were known.

    Draws come from the normal approximation with the ticks fixed at the optimum.
    """
    model = fit.model
    free = [k for k, u in enumerate(model.unknowns) if not u.name.startswith("sampled_control__")]
    if len(free) == len(model.unknowns):
        return False
    precision = np.linalg.inv(fit.covariance)[np.ix_(free, free)]
    covariance = np.linalg.inv(precision)
    draws = np.repeat(fit.point[None], CHECKED, axis=0)
    box = model.low[free], model.high[free]
    draws[:, free] = truncated_normal(fit.point[free], covariance, box, CHECKED, generator)
    deviations = draws[:, free] - fit.point[free]
    expected = fit.chi_square + np.einsum("ni,ij,nj->n", deviations, precision, deviations)
    weights = _log_weights(expected, simulated_chi_square(model, draws))
    return effective_size(weights) * DRAWS / CHECKED >= FEWEST_EFFECTIVE


def _judge(
    model: SimulatedSignals, drawn: _Weighted, failed: float, why: str = "other_shape"
) -> Diagnostics:
    """Convergence checks, and checks of this route that withhold the answer.

    ``failed``: share of failed simulations; ``why``: code of the advice if few draws carry the
    weight.
    """
    draws, effective = drawn.draws, drawn.effective
    diagnostics = drawn.walked.judged(
        {u.label: draws[..., i] for i, u in enumerate(model.unknowns)}
    )
    failures = [*_at_bound(model, draws)]
    if effective < FEWEST_EFFECTIVE:
        count = draws.shape[0] * draws.shape[1]
        values = {"effective": effective, "draws": count, "needed": FEWEST_EFFECTIVE}
        failures.append(Flaw(why, values))
    if failed > TOO_FEW:
        failures.append(Flaw("simulations_failed", {"share": failed}))
    return replace(
        diagnostics,
        failures=(*failures, *diagnostics.failures),
        doubts=(*diagnostics.doubts, *(flaw for *_, flaw in _contradicted(model, draws))),
    )


def _contradicted(
    model: SimulatedSignals, draws: FloatArray
) -> Iterator[tuple[int, Side, float, Flaw]]:
    """Unknowns whose prior the recordings contradict.

    Yields index, side, how much further the coordinate would move without its prior, and the flaw.

    For a normal prior with standard deviation s and a posterior variance v, the posterior mean
    deviates from the centre with variance s² − v. Nothing is contradicted while this mean is within
    the tolerance. A flat prior is contradicted if the draws crowd at its edge. The true value is
    then assumed half the range further, or at zero.
    """
    for i, unknown in enumerate(model.unknowns):
        if unknown.name == GAP or not math.isfinite(unknown.high - unknown.low):
            continue
        coordinates = draws[..., i].ravel()
        low, high = unknown.low, unknown.high
        sides: dict[Side, float] = {}
        if math.isfinite(unknown.sd):
            believed = unknown.sd**2
            low, high = (unknown.centre + k * math.sqrt(3.0) * unknown.sd for k in (-1.0, 1.0))
            mean, variance = float(coordinates.mean()), float(coordinates.var(ddof=1))
            deviation = mean - unknown.centre
            # This many draws estimate a variance no better.
            learned = max(believed - variance, math.sqrt(2.0 / coordinates.size) * believed)
            chance = float(chi2_sf(deviation**2 / learned, 1.0))
            if not low < mean < high and chance < FALSE_ALARM / len(model.unknowns):
                side: Side = "upper" if deviation > 0.0 else "lower"
                sides[side] = abs(deviation) * variance / learned
        else:
            info = PARAMETER_INFO.get(unknown.name)
            positive = low > 0.0 and not (info is not None and info.signed)
            reach = 0.5 * (high - low)
            edges: tuple[tuple[Side, float], ...] = (("lower", low), ("upper", high))
            for side, edge in edges:
                if chance_at_edge(np.abs(coordinates - edge), high - low) < FALSE_ALARM:
                    below = side == "lower" and positive and not unknown.logarithmic
                    sides[side] = min(reach, low) if below else reach
        for side, reach in sides.items():
            low_end, high_end = unknown.value(np.array([low, high])).tolist()
            ends = {"low": low_end, "high": high_end}
            yield i, side, reach, Flaw("at_edge", {"name": unknown.label, "side": side, **ends})


def _at_bound(model: SimulatedSignals, draws: FloatArray) -> Iterator[Flaw]:
    """Yield gaps whose posterior is cut off by the prior's range."""
    for i, unknown in enumerate(model.unknowns):
        if unknown.name != GAP:
            continue
        coordinates = draws[..., i].ravel()
        margin = min(0.01 * (unknown.high - unknown.low), 0.5 * float(coordinates.std()))
        for side, share in (
            ("lower", np.mean(coordinates < unknown.low + margin)),
            ("upper", np.mean(coordinates > unknown.high - margin)),
        ):
            # If the range begins at zero gap, nothing is cut off there.
            if share > TOO_FEW and not (side == "lower" and unknown.offset):
                low, high = unknown.value(np.array([unknown.low, unknown.high])).tolist()
                yield Flaw("gap_at_bound", {"side": side, "low": low, "high": high})
