"""Posterior of the gap and everything else unknown, from the recordings' own simulation.

emcee walks on a second-order surrogate of the whitened signals; full simulations of its draws then
give each an importance weight, so that what is reported is the simulator's posterior. Where few
draws carry the weight, the surrogate is fitted again around them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bayesbl.bench.parameters import cannot_be_negative, is_share
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.signals import GAP, SimulatedSignals, Unknown
from bayesbl.matching.surrogate import Surrogate, points_needed, regress
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.chains import Progress, SamplerSettings, Walk, thinned, walk
from bayesbl.sampling.convergence import (
    Diagnostics,
    judge,
    rank_r_hat_and_ess,
)
from bayesbl.sampling.ensemble import Ensemble
from bayesbl.sampling.importance import effective_size, resampled

DRAWS = 1000
"""Draws over all ensembles; each is simulated in full."""
MOST_REFITS = 3
GOOD_SHARE = 0.4
"""Effective share of the draws from which on the surrogate is good enough to be corrected."""
FEWEST_EFFECTIVE = 100.0
"""Below it the answer is withheld: the actual level of a 90 % interval is 90 ± 3 % at 100 draws.

The share of the posterior between two quantiles of n draws has the standard deviation
√(p (1 − p)/n), p its level.
"""
AT_BOUND_SHARE = 0.01
LARGEST_FAILED_SHARE = 0.01
PRESSED = 1.1
"""Mean distance of draws from an edge over their standard deviation.

1.10 where a normal likelihood has its peak two standard deviations beyond the edge, 1.32 where it
has it at the edge, 1.73 where it is flat.
"""
LEAST_SHARE = 0.1
"""Of the lower end of a range above zero, that the surrogate's points stay above."""
BEYOND = 0.5
"""How far, in half-widths, the surrogate's points may leave a flat prior's range."""


@dataclass(frozen=True, slots=True)
class DirectPosterior:
    """Draws of all unknowns.

    Attributes
    ----------
    draws
        Coordinates as the model's ``unknowns`` have them, shape (chain, draw, d); chain = ensemble.
    chi_square
        Of each draw, by full simulation where ``effective`` is a number, shape (chain, draw).
    effective
        Effective sample size of the importance weights; nan if the surrogate was not corrected.
    simulated
        Number of draws that the weights were spread over.
    refits
        How often the surrogate was fitted again.
    """

    fit: SimulatedFit
    draws: FloatArray
    chi_square: FloatArray
    effective: float
    simulated: int
    refits: int
    diagnostics: Diagnostics

    def beyond_tolerance(self, recording: str | None, level: float) -> str | None:
        """Why the gap of a recording cannot be told; ``None`` where no tolerance decides it.

        ``recording``: ``None`` for the one gap that all recordings share.

        Where a parameter lies at the edge of its tolerance, its true value may lie beyond. If half
        the tolerance more would move δ, by the regression of δ on the parameter, further than half
        its interval, the tolerance and not the recording decides δ.
        """
        model = self.fit.model
        gap = self.values(GAP, recording).ravel()
        low, high = np.quantile(gap, [0.5 - 0.5 * level, 0.5 + 0.5 * level])
        for i, side, _ in _at_edges(model, self.draws):
            unknown, own = model.unknowns[i], self.draws[..., i].ravel()
            slope = float(np.cov(own, gap)[0, 1]) / float(own.var(ddof=1))
            shift = abs(slope) * 0.5 * (unknown.high - unknown.low)
            if shift > 0.5 * (high - low):
                return (
                    f"δ depends on {unknown.name}, which lies at the {side} edge of its tolerance: "
                    f"half the tolerance more would move δ by {1e3 * shift:.2g} mrad, further than "
                    "its interval. Correct the bench file, or widen this tolerance."
                )
        return None

    def values(self, name: str, recording: str | None = None) -> FloatArray:
        """Draws of one unknown's value, shape (chain, draw)."""
        i = self.fit.model.index(name, recording)
        return self.fit.model.unknowns[i].value(self.draws[..., i])


class _LogDensity:
    """log posterior by the surrogate."""

    def __init__(self, model: SimulatedSignals, surrogate: Surrogate) -> None:
        self._model, self._surrogate = model, surrogate

    def __call__(self, points: FloatArray) -> FloatArray:
        prior, chi_square = self._model.log_prior(points), self._surrogate.chi_square(points)
        # A bench nowhere near the recordings overflows; such a point has no weight.
        finite = np.isfinite(chi_square)
        return np.where(finite, prior, -np.inf) - 0.5 * np.where(finite, chi_square, 0.0)


def sample_direct(
    fit: SimulatedFit,
    settings: SamplerSettings,
    seed: np.random.SeedSequence,
    progress: Progress | None = None,
    *,
    corrected: bool = True,
) -> DirectPosterior:
    """Posterior around the most probable point.

    Parameters
    ----------
    corrected
        Weigh the draws by full simulations; otherwise they are the surrogate's own, at a tenth of
        the time.
    progress
        Called with (steps made, steps allowed) at every check; full simulations follow the last.
    """
    model = fit.model
    design_seed, pick_seed, *walk_seeds = seed.spawn(3 + MOST_REFITS)
    points = _design(fit, points_needed(model), np.random.default_rng(design_seed))
    centre, covariance = fit.point, fit.covariance
    chi_square, surrogate = regress(model, points, centre, covariance)
    failed = float(np.mean(~np.isfinite(chi_square)))
    refits = 0
    while True:
        walked = _walk(model, surrogate, centre, covariance, settings, walk_seeds[refits], progress)
        draws = np.stack([thinned(c, DRAWS // len(walked.chains)) for c in walked.chains])
        flat = draws.reshape(-1, draws.shape[-1])
        expected = surrogate.chi_square(flat)
        if not corrected:
            diagnostics = _judge(model, walked, draws, math.nan, failed)
            return DirectPosterior(
                fit, draws, expected.reshape(draws.shape[:2]), math.nan, 0, 0, diagnostics
            )
        centre, covariance = flat.mean(axis=0), _covariance(flat)
        chi_square, better = regress(model, flat, centre, covariance)
        log_weights = np.where(
            np.isfinite(chi_square), -0.5 * np.nan_to_num(chi_square - expected), -np.inf
        )
        effective = effective_size(log_weights)
        failed = float(np.mean(~np.isfinite(chi_square)))
        if effective >= GOOD_SHARE * len(flat) or refits == MOST_REFITS:
            break
        surrogate, refits = better, refits + 1
    diagnostics = _judge(model, walked, draws, effective, failed)
    weights = log_weights.reshape(draws.shape[:2])
    picked = resampled(weights, draws.shape[1], np.random.default_rng(pick_seed))
    return DirectPosterior(
        fit,
        np.take_along_axis(draws, picked[..., None], axis=1),
        np.take_along_axis(chi_square.reshape(draws.shape[:2]), picked, axis=1),
        effective,
        len(flat),
        refits,
        diagnostics,
    )


def _design(fit: SimulatedFit, count: int, generator: np.random.Generator) -> FloatArray:
    """Points drawn from the Laplace posterior; those outside the priors' ranges are pulled in.

    A point moves towards the optimum as a whole: along one coordinate alone it would leave the
    valley that the recordings allow.
    """
    model = fit.model
    steps = generator.standard_normal((count, fit.point.size))
    moves = steps @ np.linalg.cholesky(fit.covariance).T
    half = 0.5 * (model.high - model.low)
    margin = np.array([_margin(u, h) for u, h in zip(model.unknowns, half, strict=True)])
    # Below zero much makes no physical sense, and at zero some of it neither.
    floor = [
        -math.inf
        if u.logarithmic or u.added or not cannot_be_negative(u.name)
        else LEAST_SHARE * u.low
        for u in model.unknowns
    ]
    ceiling = [1.0 if is_share(u.name) else math.inf for u in model.unknowns]
    low = np.maximum(model.low - margin, floor)
    high = np.minimum(model.high + margin, ceiling)
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(moves > 0.0, (high - fit.point) / moves, (low - fit.point) / moves)
    share = np.clip(np.nan_to_num(room, nan=1.0).min(axis=1), 0.0, 1.0)
    return np.asarray(fit.point + share[:, None] * moves)


def _margin(unknown: Unknown, half_width: float) -> float:
    """How far the surrogate's points may leave a flat prior's range.

    The logarithm of a bench parameter may go three standard deviations of that prior beyond it:
    what scales several of them at once changes no signal, and points pulled back along it would
    not spread along what does.
    """
    if unknown.name == GAP or not math.isfinite(half_width):
        return 0.0
    return 3.0 * unknown.prior_sd if unknown.logarithmic else BEYOND * half_width


def _walk(
    model: SimulatedSignals,
    surrogate: Surrogate,
    centre: FloatArray,
    covariance: FloatArray,
    settings: SamplerSettings,
    seed: np.random.SeedSequence,
    progress: Progress | None,
) -> Walk:
    """emcee until its chains are long enough and the gap's interval stands still."""
    target = _LogDensity(model, surrogate)
    # Wide tolerances are cut by the ends of other parameters' ranges: most first draws are outside.
    wide = bool(np.any(model.prior_slope))
    ensembles = [
        Ensemble(target, centre, covariance, (model.low, model.high), s, redrawn=wide)
        for s in seed.spawn(settings.ensembles)
    ]
    gaps = [i for i, u in enumerate(model.unknowns) if u.name == GAP]
    tail = 0.5 - 0.5 * settings.level

    def bounds(chains: Sequence[FloatArray]) -> FloatArray:
        pooled = np.concatenate([thinned(chain)[:, gaps] for chain in chains])
        return np.asarray(np.quantile(pooled, [tail, 1.0 - tail], axis=0))

    return walk(ensembles, settings, bounds, np.sqrt(np.diag(covariance))[gaps], progress)


def _covariance(points: FloatArray) -> FloatArray:
    """Of draws, (m, d) to (d, d); never singular, even where draws lie at a bound."""
    found = np.atleast_2d(np.cov(points.T))
    return np.asarray(found + 1e-12 * np.diag(np.diag(found) + 1e-30))


def _judge(
    model: SimulatedSignals, walked: Walk, draws: FloatArray, effective: float, failed: float
) -> Diagnostics:
    """The usual checks of sampling, and those special to this route, which withhold the answer."""
    r_hat, ess = rank_r_hat_and_ess({u.label: draws[..., i] for i, u in enumerate(model.unknowns)})
    found = judge(
        r_hat,
        ess,
        walked.autocorrelation_steps,
        walked.steps,
        walked.acceptance,
        walked.stable,
        math.inf,
        {},
    )
    failures = [*_at_bound(model, draws)]
    if effective < FEWEST_EFFECTIVE:
        failures.append(
            f"Only {effective:.0f} of {draws.shape[0] * draws.shape[1]} draws carry the weight "
            f"after full simulation ({FEWEST_EFFECTIVE:.0f} are needed): the surrogate does "
            "not have the shape of the posterior. Narrow the bench's tolerances, or find "
            "them from recordings (bayesbl identify)."
        )
    if failed > LARGEST_FAILED_SHARE:
        failures.append(
            f"{failed:.0%} of the simulations near the optimum failed: the bench cannot run there."
        )
    if failures:
        found = replace(found, outcome="withheld", reasons=(*failures, *found.reasons))
    edges = tuple(sentence for _, _, sentence in _at_edges(model, draws))
    if edges and found.outcome == "converged":
        found = replace(found, outcome="usable")
    return replace(found, reasons=(*found.reasons, *edges))


def _at_edges(
    model: SimulatedSignals, draws: FloatArray
) -> Iterator[tuple[int, Literal["lower", "upper"], str]]:
    """Index, side and a sentence for each bench parameter that is pressed against its tolerance.

    A true value near an edge is no fault: tolerances are uniform. One beyond it shows in how the
    draws crowd there: by their mean distance from the edge over their standard deviation.
    """
    for i, unknown in enumerate(model.unknowns):
        if unknown.name == GAP or not math.isfinite(unknown.high - unknown.low):
            continue
        own = draws[..., i].ravel()
        edges: tuple[tuple[Literal["lower", "upper"], float], ...] = (
            ("lower", unknown.low),
            ("upper", unknown.high),
        )
        for side, edge in edges:
            if abs(float(own.mean()) - edge) < PRESSED * float(own.std()):
                low, high = unknown.value(np.array([unknown.low, unknown.high]))
                yield (
                    i,
                    side,
                    f"{unknown.label} lies at the {side} edge of its tolerance "
                    f"({low:.4g} to {high:.4g}): its true value may lie beyond.",
                )


def _at_bound(model: SimulatedSignals, draws: FloatArray) -> Sequence[str]:
    """A sentence for each gap whose posterior is cut by its prior's range."""
    sentences = []
    for i, unknown in enumerate(model.unknowns):
        if unknown.name != GAP:
            continue
        own = draws[..., i].ravel()
        near = min(0.01 * (unknown.high - unknown.low), 0.5 * float(own.std()))
        for side, share in (
            ("lower", np.mean(own < unknown.low + near)),
            ("upper", np.mean(own > unknown.high - near)),
        ):
            if share > AT_BOUND_SHARE:
                ends = unknown.value(np.array([unknown.low, unknown.high]))
                sentences.append(
                    f"The posterior of δ lies at the {side} bound of its range "
                    f"({ends[0]:.3g} to {ends[1]:.3g} rad): the range, not the recording, decides. "
                    "Widen [estimator] gap_rad, or correct the bench."
                )
    return sentences
