"""Posterior of the play of all snapshots of a joint together, from the widths that ramps leave.

What is counted is what repeats, so the noise within a ramp need not be known, whatever its colour.
A snapshot of several files, each at its own position round the turn, has one observation per file,
the mean of its cycles; a snapshot of one file has one per cycle. With y_sn observation n of
snapshot s,

    y_sn ~ N(w_s, σ_s² + e_sn²),      cov(y_sn, y_s'n) = ρ σ_s σ_s'

where σ_s is the scatter round the turn (of repeated ramps, with one file), e_sn what the cycles of
a file leave open of its mean, and ρ how far the pattern round the turn stays the same from snapshot
to snapshot. Files are paired by their order; a wrong order is the same as ρ = 0. w_s is flat,
ln σ_s uniform within bounds, ρ uniform. Given σ and ρ the widths are normal and integrated out:
emcee walks in (ln σ, ρ), and the widths are drawn afterwards. With three positions the interval
of w is about that of Student's t with two degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesbl.probabilities import ends
from bayesbl.progress import Progress
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.chains import Ensembles, SamplerSettings, thinned, walk
from bayesbl.sampling.convergence import Diagnostics

SCATTER = (0.01, 1.0 / np.sqrt(2.0))
"""σ over the mean width. A width that goes once round the turn like a sine and is nowhere negative
scatters by 1/√2 of its mean at most; less than a hundredth is nothing beside what compliance does.
"""

MOST_REDRAWN = 100
"""Times that negative widths are drawn again: their share is far below a half."""


@dataclass(frozen=True, slots=True)
class Widths:
    """What the ramps of one snapshot measured.

    Attributes
    ----------
    by_file
        Independent widths of every file, rad.
    resolution_rad
        Of the encoder: widths cannot be known better.
    """

    name: str
    by_file: tuple[FloatArray, ...]
    resolution_rad: float

    def observations(self, *, by_file: bool) -> tuple[FloatArray, FloatArray]:
        """Widths and the variances that they have beside σ, rad and rad², shape (n,)."""
        rounding = self.resolution_rad**2 / 6.0  # of two positions
        if not by_file:
            (cycles,) = self.by_file
            return cycles, np.full(cycles.size, rounding)
        freedom = sum(v.size - 1 for v in self.by_file)
        squares = sum(float(v.var()) * v.size for v in self.by_file)
        within = squares / freedom if freedom else 0.0
        number = np.array([v.size for v in self.by_file])
        return np.array([v.mean() for v in self.by_file]), (within + rounding) / number


@dataclass(frozen=True, slots=True)
class PlayPosterior:
    """Draws of shape (chain, draw) of every snapshot, by its name.

    Attributes
    ----------
    width_rad
        Mean round the turn of what the ramps leave between the flanks; of one file, there.
    scatter_rad
        σ: round the turn, or of repeated ramps where there is one file.
    shared_pattern
        ρ; ``None`` where snapshots cannot be paired.
    log_density
        Of (ln σ, ρ), widths integrated out.
    """

    width_rad: dict[str, FloatArray]
    scatter_rad: dict[str, FloatArray]
    shared_pattern: FloatArray | None
    log_density: FloatArray
    diagnostics: Diagnostics


class _Scatter:
    """Log density of points (walker, d): ln σ of every snapshot, and ρ where they are paired."""

    def __init__(self, snapshots: Sequence[Widths], *, round_the_turn: bool) -> None:
        by_file = round_the_turn or any(len(s.by_file) > 1 for s in snapshots)
        observed = [s.observations(by_file=by_file) for s in snapshots]
        self.count = len(snapshots)
        most = max(y.size for y, _ in observed)
        # What is not there has no weight.
        self.y, self.own = np.zeros((self.count, most)), np.full((self.count, most), np.inf)
        for i, (y, variance) in enumerate(observed):
            self.y[i, : y.size], self.own[i, : y.size] = y, variance
        self.paired = by_file and self.count > 1 and bool(np.all(np.isfinite(self.own)))
        floors = [s.resolution_rad for s in snapshots]
        size = np.maximum([np.abs(y).mean() for y, _ in observed], floors)
        spread = np.array([y.std() for y, _ in observed])
        ends = np.log(SCATTER[0] * size), np.log(SCATTER[1] * size)
        pattern = np.arange(2.0) if self.paired else np.empty((2, 0))
        self.box = np.append(ends[0], pattern[:1]), np.append(ends[1], pattern[1:])
        margin = 0.1 * (ends[1] - ends[0])
        centre = np.clip(np.log(np.maximum(spread, 1e-300)), ends[0] + margin, ends[1] - margin)
        self.centre = np.append(centre, [0.5] * self.paired)

    def _precision(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of the widths, (walker, s, s), times their mean, (walker, s), and the log density."""
        sigma = np.exp(points[:, : self.count])
        rho = points[:, -1] if self.paired else np.zeros(len(points))
        own = self.own + (1.0 - rho[:, None, None]) * sigma[:, :, None] ** 2  # (walker, s, n)
        inverse = 1.0 / own
        # The inverse of diag(own) + ρ σσᵀ for every n, by Sherman and Morrison.
        common = sigma[:, :, None] * inverse
        weight = 1.0 + rho[:, None] * np.sum(common * sigma[:, :, None], axis=1)
        share = (rho[:, None] / weight)[:, None, :] * common
        precision = -np.einsum("wsn,wtn->wst", share, common)
        place = np.arange(self.count)
        precision[:, place, place] += inverse.sum(axis=2)
        scalar = np.sum(common * self.y, axis=1)
        towards = np.sum(inverse * self.y - share * scalar[:, None, :], axis=2)
        square = np.sum(inverse * self.y**2, axis=(1, 2))
        square -= np.sum(rho[:, None] / weight * scalar**2, axis=1)
        logs = np.log(own, where=np.isfinite(own), out=np.zeros_like(own)).sum(axis=(1, 2))
        return precision, towards, -0.5 * (square + logs + np.log(weight).sum(axis=1))

    def __call__(self, points: FloatArray) -> FloatArray:
        low, high = self.box
        inside = np.all((points >= low) & (points <= high), axis=1)
        precision, towards, log = self._precision(np.clip(points, low, high))
        middle = np.linalg.solve(precision, towards[:, :, None])[:, :, 0]
        log += 0.5 * np.sum(towards * middle, axis=1) - 0.5 * np.linalg.slogdet(precision)[1]
        return np.where(inside, log, -np.inf)

    def widths(self, points: FloatArray, generator: np.random.Generator) -> FloatArray:
        """A draw of the widths for each point, none negative, shape (walker, s)."""
        precision, towards, _ = self._precision(points)
        middle = np.linalg.solve(precision, towards[:, :, None])[:, :, 0]
        root = np.linalg.cholesky(np.linalg.inv(precision))
        drawn = np.full_like(middle, -1.0)
        for _ in range(MOST_REDRAWN):
            again = np.any(drawn < 0.0, axis=1)
            if not again.any():
                break
            normal = generator.standard_normal((int(again.sum()), self.count))
            drawn[again] = middle[again] + np.einsum("wst,wt->ws", root[again], normal)
        return np.maximum(drawn, 0.0)


def sample_play(
    snapshots: Sequence[Widths],
    settings: SamplerSettings,
    seed: np.random.SeedSequence,
    progress: Progress | None = None,
    *,
    round_the_turn: bool = False,
) -> PlayPosterior:
    """Sample the widths of all snapshots together, by independent ensembles.

    Parameters
    ----------
    round_the_turn
        Whether snapshots of one file each are of different positions. Nothing then tells the
        scatter round the turn but its prior.
    """
    target = _Scatter(snapshots, round_the_turn=round_the_turn)
    widths_seed, walk_seed = seed.spawn(2)
    low, high = target.box
    covariance = np.diag((0.1 * (high - low)) ** 2)
    ensembles = Ensembles.around(
        target, target.centre, covariance, target.box, settings.ensembles, walk_seed
    )
    walkers = walk(
        ensembles,
        settings,
        lambda chains: ends(chains, settings.level, (0, 1, 2)),
        0.3 * (high - low),
        progress,
    )
    kept = np.stack([thinned(chain) for chain in walkers.chains])
    flat = kept.reshape(-1, kept.shape[-1])
    drawn = target.widths(flat, np.random.default_rng(widths_seed)).reshape(*kept.shape[:2], -1)
    widths = {s.name: drawn[..., i] for i, s in enumerate(snapshots)}
    diagnostics = walkers.judged({f"play of {name}": draws for name, draws in widths.items()})
    return PlayPosterior(
        widths,
        {s.name: np.exp(kept[..., i]) for i, s in enumerate(snapshots)},
        kept[..., -1] if target.paired else None,
        target(flat).reshape(kept.shape[:2]),
        diagnostics,
    )
