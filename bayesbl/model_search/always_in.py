"""What is always taken into account and never selected: laws that bias δ before they show, and drift.

No test at any level finds a law that moves δ by two standard deviations and the residuals by one. So
it is never asked whether such a law is there. With u the unknowns of a fit, L = (JᵀJ + P)⁻¹ their
covariance, and c_k the derivative of the whitened signals by the size of a law in a recording, the
sizes a = F w, w standard normal (half-normal where a law has one sign), have the posterior

    A = Fᵀ(CᵀC − CᵀJ L JᵀC)F + 1,   A w̄ = Fᵀ(Cᵀr − CᵀJ L (Jᵀr + pull)),

and each draw of u moves by −L JᵀC F w. Of a law all snapshots share one size, and beside it, as every
parameter that drifts, each has its own: F holds usual sizes and budgets (:mod:`bayesbl.bench.drift`).
So the change between snapshots stays sharp where it may. What is far from where the fit has it is
fitted and sampled as any other unknown; linear is the rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.drift import drift_of
from bayesbl.bench.effects import EFFECTS, effect_named
from bayesbl.bench.kernel import Slot
from bayesbl.bench.parameters import BENCH_PARAMETERS
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated, prior_pull
from bayesbl.matching.posterior import TAILS, DirectPosterior
from bayesbl.matching.signals import SimulatedSignals, Unknown
from bayesbl.naming.joint_size import search_scale
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.truncated_normal import truncated_normal

STEP = 0.1
"""Of derivatives, in usual sizes or budgets."""

SHAFT_DAMPING_SHARE = 0.25
"""Of the shaft's damping, which no data sheet states and every bench has from somewhere."""

FAR = 3.0
"""Posterior standard deviations of a size that data put elsewhere than a fit without it has it."""

MOST_ROUNDS = 3
MOST_TRIES = 20


@dataclass(frozen=True, slots=True)
class Direction:
    """One way in which a joint is not quite its bench.

    Attributes
    ----------
    slot
        As :meth:`Bench.vector` takes it.
    usual, drift
        Standard deviations in the slot's unit: of what all snapshots share, and of a snapshot's
        difference to the first; 0 for none.
    positive
        The shared size is half-normal.
    least
        Smallest size that the simulator takes without tiny steps.
    effect
        Of the catalogue, where the bench has none such.
    """

    slot: str
    usual: float
    drift: float
    positive: bool = False
    least: float = 0.0
    effect: str | None = None

    @property
    def step(self) -> float:
        """That derivatives are taken over."""
        return max(STEP * (self.usual or self.drift), self.least)


def directions(bench: Bench, stated: Mapping[str, float]) -> list[Direction]:
    """All that may be, on a bench.

    ``stated``: relative standard deviations of drift by name, in place of the defaults; 0 for none.
    What a bench states with a tolerance has its uncertainty there.
    """
    return [d for d in _directions(bench, stated) if d.usual > 0.0 or d.drift > 0.0]


def _directions(bench: Bench, stated: Mapping[str, float]) -> Iterator[Direction]:
    known = set(bench.tolerances) | set(() if bench.identified is None else bench.identified.names)
    for info in BENCH_PARAMETERS:
        size = abs(bench.value(info.name))
        share = SHAFT_DAMPING_SHARE if info.name == "shaft_damping_nm_s_per_rad" else 0.0
        usual = 0.0 if info.name in known else share * size
        yield Direction(info.name, usual, drift_of(info.name, stated) * size)
    present = {effect.name: effect for effect in bench.effects}
    loop_is_stated = any(effect_named(name).enters == "loop" for name in present)
    for effect in EFFECTS:
        if effect.name in present:
            values = present[effect.name].complete()
            for item in effect.amplitudes:
                drift = drift_of(f"{effect.name}.{item.name}", stated) * abs(values[item.name])
                yield Direction(f"{effect.name}__{item.name}", 0.0, drift)
        elif effect.always_in and not (effect.enters == "loop" and loop_is_stated):
            item = effect.amplitudes[0]
            usual = search_scale(bench, effect, item) * item.typical
            yield Direction(
                f"{effect.name}__{item.name}",
                usual,
                drift_of(effect.name, stated) * usual,
                item.low >= 0.0,
                item.sought_from or 0.0,
                effect.name,
            )


@dataclass(frozen=True, slots=True)
class Label:
    """A direction in all snapshots (``recording`` is ``None``), or beyond that in one."""

    direction: Direction
    recording: str | None

    @property
    def scale(self) -> float:
        """Standard deviation, in the slot's unit."""
        return self.direction.usual if self.recording is None else self.direction.drift

    @property
    def is_positive(self) -> bool:
        """Half-normal."""
        return self.recording is None and self.direction.positive

    def unknown(self, bench: Bench) -> Unknown:
        """As an unknown of a fit."""
        own = self.direction
        if self.recording is not None:
            return Unknown(own.slot, sd=own.drift, recording=self.recording, added=True)
        centre = float(with_neutral(bench, [own]).vector()[0, Slot[own.slot]])
        low = 0.0 if own.positive else -math.inf
        return Unknown(own.slot, low=low, centre=centre, sd=own.usual)


@dataclass(frozen=True, slots=True, eq=False)
class Sizes:
    """The posterior of w beside a fit.

    Attributes
    ----------
    labels
        Of each w.
    precision, mean
        A and w̄, before what is half-normal is cut off, shapes (k, k) and (k,).
    positive
        Which are half-normal, shape (k,).
    best
        The most probable w, shape (k,).
    moves
        Of u by each w, −L JᵀC F, shape (d, k).
    residual
        Of the fit with w and u at their most probable, shape (N,).
    """

    labels: tuple[Label, ...]
    precision: FloatArray
    mean: FloatArray
    positive: NDArray[np.bool_]
    best: FloatArray
    moves: FloatArray
    residual: FloatArray

    def drawn(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draws of w, shape (count, k)."""
        covariance = np.linalg.inv(self.precision)
        cut, rest = np.flatnonzero(self.positive), np.flatnonzero(~self.positive)
        out = np.empty((count, self.mean.size))
        if cut.size:
            own = covariance[np.ix_(cut, cut)]
            box = np.zeros(cut.size), np.full(cut.size, np.inf)
            start = np.maximum(self.mean[cut], np.sqrt(np.diag(own)))
            out[:, cut] = truncated_normal(self.mean[cut], own, start, box, count, rng)
        if rest.size:
            among = self.precision[np.ix_(rest, rest)]
            pulled = (out[:, cut] - self.mean[cut]) @ self.precision[np.ix_(cut, rest)]
            root = np.linalg.inv(np.linalg.cholesky(among))
            out[:, rest] = self.mean[rest] - np.linalg.solve(among, pulled.T).T
            out[:, rest] += rng.standard_normal((count, rest.size)) @ root
        return out

    @property
    def far(self) -> tuple[Label, ...]:
        """What data put elsewhere than a fit without it has it."""
        sd = np.sqrt(np.diag(np.linalg.inv(self.precision)))
        pairs = zip(self.labels, np.abs(self.best) > FAR * sd, strict=True)
        return tuple(label for label, is_far in pairs if is_far)

    def explained(self, fit: SimulatedFit) -> SimulatedFit:
        """The fit with the residuals that it and the sizes leave together."""
        return replace(fit, residual=self.residual)


def sizes(fit: SimulatedFit, among: Sequence[Direction]) -> Sizes:
    """The posterior of all sizes beside a fit; what is an unknown of its model is left out."""
    model = fit.model
    labels = _labels(model, among)
    ends = np.cumsum([part.size for part in model.by_recording(fit.residual)])[:-1]
    jacobians, residuals = np.split(fit.derivatives(), ends), np.split(fit.residual, ends)
    moved = np.zeros((fit.point.size, len(labels)))
    gram, right = np.zeros((len(labels), len(labels))), np.zeros(len(labels))
    columns, gradient = [], prior_pull(model, fit.point)
    for place, (jacobian, residual) in enumerate(zip(jacobians, residuals, strict=True)):
        own = _scaled_columns(fit, place, labels)
        columns.append(own)
        moved += jacobian.T @ own
        gram += own.T @ own
        right += own.T @ residual
        gradient += jacobian.T @ residual
    moves = -fit.covariance @ moved
    precision = gram + moved.T @ moves + np.eye(len(labels))
    mean = np.linalg.solve(precision, right + moves.T @ gradient)
    positive = np.array([label.is_positive for label in labels], dtype=bool)
    best = _most_probable(precision, mean, positive)
    left = [
        r - j @ (moves @ best) - own @ best
        for r, j, own in zip(residuals, jacobians, columns, strict=True)
    ]
    return Sizes(labels, precision, mean, positive, best, moves, np.concatenate(left))


def _labels(model: SimulatedSignals, among: Sequence[Direction]) -> tuple[Label, ...]:
    """Each direction for all snapshots together, and for each but the first."""
    taken = {(u.name, u.recording) for u in model.unknowns if u.added or u.recording is None}
    owners = [seen.name for seen in model.recordings[1:]]
    found = [Label(d, None) for d in among if d.usual > 0.0]
    found += [Label(d, owner) for d in among if d.drift > 0.0 for owner in owners]
    return tuple(f for f in found if (f.direction.slot, f.recording) not in taken)


def _scaled_columns(fit: SimulatedFit, place: int, labels: Sequence[Label]) -> FloatArray:
    """C F of one recording, shape (N, k): 0 where a size does not touch it."""
    model, seen = fit.model, fit.model.recordings[place]
    acting = [
        k
        for k, label in enumerate(labels)
        if label.recording in (None, seen.name) and label.direction.slot not in seen.known
    ]
    among = list(dict.fromkeys(labels[k].direction for k in acting))
    own = [Unknown(d.slot, recording=seen.name, added=True) for d in among]
    wider = model.beside(with_neutral(model.bench, among), own).for_differences(
        np.concatenate([fit.point, np.zeros(len(own))])
    )
    points = np.zeros((1 + len(own), fit.point.size + len(own)))
    points[:, : fit.point.size] = fit.point
    for row, direction in enumerate(among):
        points[1 + row, fit.point.size + row] = direction.step
    white = wider.whitened_of(points, place)
    out = np.zeros((white.shape[1], len(labels)))
    for k in acting:
        row = 1 + among.index(labels[k].direction)
        change = (white[0] - white[row]) * (labels[k].scale / labels[k].direction.step)
        if np.all(np.isfinite(change)):
            out[:, k] = change
    return out


def with_neutral(bench: Bench, among: Sequence[Direction]) -> Bench:
    """The bench with every law that it lacks, of no size."""
    have = {effect.name for effect in bench.effects}
    lacking = dict.fromkeys(d.effect for d in among if d.effect is not None)
    added = [
        BenchEffect(
            name,
            {p.name: EffectParameterValue(p.neutral) for p in effect_named(name).parameters},
        )
        for name in lacking
        if name not in have
    ]
    return bench.with_effects(*bench.effects, *added) if added else bench


def _most_probable(
    precision: FloatArray, mean: FloatArray, positive: NDArray[np.bool_]
) -> FloatArray:
    """The largest density of what is cut off at zero, shape (k,)."""
    if not np.any(positive & (mean < 0.0)):
        return mean
    root = np.linalg.cholesky(precision).T
    low = np.where(positive, 0.0, -np.inf)
    return np.asarray(lsq_linear(root, root @ mean, (low, np.full(mean.size, np.inf))).x)


def settled(fit: SimulatedFit, among: Sequence[Direction]) -> tuple[SimulatedFit, Sizes]:
    """The fit with what data put far away among its unknowns, and the sizes of the rest."""
    own = sizes(fit, among)
    for _ in range(MOST_ROUNDS):
        if not own.far:
            break
        model = fit.model.beside(
            with_neutral(fit.model.bench, [label.direction for label in own.far]),
            [label.unknown(fit.model.bench) for label in own.far],
        )
        near = fit.point + own.moves @ own.best
        start = [label.unknown(fit.model.bench).centre for label in own.far]
        start = np.array(start) + [
            w * label.scale
            for label, w in zip(own.labels, own.best, strict=True)
            if label in own.far
        ]
        fit = fit_simulated(model, np.concatenate([near, start]), fit.steps)
        own = sizes(fit, among)
    return fit, own


def marginalised(
    posterior: DirectPosterior, own: Sizes, seed: np.random.SeedSequence
) -> DirectPosterior:
    """Draws that no longer take the laws of the bench and its parameters to be as they are.

    Within the ranges of the unknowns: a draw that would leave them is made anew, and stays where it
    was where none is within.
    """
    model, rng = posterior.fit.model, np.random.default_rng(seed)
    flat = posterior.draws.reshape(-1, posterior.draws.shape[-1])
    if not own.labels:
        return posterior
    moved = flat.copy()
    outside = np.arange(len(flat))
    for _ in range(MOST_TRIES):
        tried = flat[outside] + own.drawn(outside.size, rng) @ own.moves.T
        within = np.all((tried > model.low) & (tried < model.high), axis=1)
        moved[outside[within]] = tried[within]
        outside = outside[~within]
        if not outside.size:
            break
    before, after = (np.diff(np.quantile(d, TAILS, axis=0), axis=0)[0] for d in (flat, moved))
    factor = after / np.maximum(before, 1e-300)
    return replace(posterior, draws=moved.reshape(posterior.draws.shape), model_widening=factor)
