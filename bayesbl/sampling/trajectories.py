"""Hamiltonian Monte Carlo of many walkers in a box, for densities whose gradient is known.

A trajectory crosses a roughly normal density in a few steps, whatever the number of dimensions
(Neal 2011, Handbook of Markov Chain Monte Carlo, chapter 5). At an end of a range it is reflected
(Afshar and Domke 2015), so draws that crowd there move as fast as others.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from bayesbl.recording.types import BoolArray, FloatArray

LENGTH = 0.5 * math.pi
"""Duration of a trajectory: a quarter of the period in a normal density, to forget its start."""
FIRST_STEP, STEP_JITTER = 0.4, 0.3
ACCEPTED = 0.8
"""Share of trajectories to accept, near the optimum for any density (Betancourt, Byrne and Girolami
2014)."""
WARM_UP = 40
"""Trajectories that choose the step."""
GAIN = 0.3
MOST_PER_TRAJECTORY = 100
"""Steps: a walker that needs more is stuck, and its ensemble says so."""
MOST_REFLECTIONS = 100
"""In one step; a trajectory in a corner that needs more is rejected."""


class Trajectories:
    """Independent ensembles of independent walkers.

    Parameters
    ----------
    target
        Log density and its gradient at points (m, d): shapes (m,) and (m, d).
    starts
        Start of each walker, shape (ensembles, walkers, d), with a finite log density.
    covariance
        Approximate covariance, (d, d). It affects the speed of sampling, not its result.
    box
        Low and high end of every range, shapes (d,); infinite where there is none.
    """

    def __init__(
        self,
        target: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
        starts: FloatArray,
        covariance: FloatArray,
        box: tuple[FloatArray, FloatArray],
        seed: np.random.SeedSequence,
    ) -> None:
        self._target, self._rng, self._shape = target, np.random.default_rng(seed), starts.shape
        self._low, self._high = box
        self._bounded = np.flatnonzero(np.isfinite(self._low) | np.isfinite(self._high))
        self._root = np.linalg.cholesky(covariance)
        self._points = starts.reshape(-1, starts.shape[-1])
        self._log_density, self._gradient = target(self._points)
        self._step = FIRST_STEP
        for _ in range(WARM_UP):
            change = math.exp(GAIN * (float(self._move().mean()) - ACCEPTED))
            self._step = max(change * self._step, LENGTH / MOST_PER_TRAJECTORY)
        self._kept: list[FloatArray] = []
        self._accepted = np.zeros(len(self._points))

    def run(self, steps: int) -> None:
        """Continue for a number of trajectories of each walker."""
        for _ in range(steps):
            self._accepted += self._move()
            self._kept.append(self._points)

    @property
    def chains(self) -> FloatArray:
        """All points so far, shape (ensemble, step, walker, d)."""
        return np.stack(self._kept).reshape(-1, *self._shape).swapaxes(0, 1)

    @property
    def acceptance(self) -> FloatArray:
        """Accepted share of trajectories, by ensemble."""
        share = self._accepted / len(self._kept)
        return np.asarray(share.reshape(self._shape[:2]).mean(axis=1))

    def _move(self) -> BoolArray:
        """Move every walker along one trajectory; returns which are accepted, (m,)."""
        momenta = self._rng.standard_normal(self._points.shape)
        energy = 0.5 * np.sum(momenta**2, axis=1) - self._log_density
        jitter = self._rng.uniform(-STEP_JITTER, STEP_JITTER, (len(momenta), 1))
        steps = self._step * (1.0 + jitter)
        points, gradient = self._points.copy(), self._gradient
        stays = np.ones(len(points), dtype=bool)
        for _ in range(math.ceil(LENGTH / self._step)):
            momenta += 0.5 * steps * (gradient @ self._root)
            stays &= self._drift(points, momenta, steps[:, 0])
            log_density, gradient = self._target(points)
            momenta += 0.5 * steps * (gradient @ self._root)
        gain = energy - 0.5 * np.sum(momenta**2, axis=1) + log_density
        accepted = stays & (np.log(self._rng.random(len(gain))) < gain)
        self._points = np.where(accepted[:, None], points, self._points)
        self._log_density = np.where(accepted, log_density, self._log_density)
        self._gradient = np.where(accepted[:, None], gradient, self._gradient)
        return np.asarray(accepted)

    def _drift(self, points: FloatArray, momenta: FloatArray, times: FloatArray) -> BoolArray:
        """Move points (m, d) in place by straight lines in the box; returns which arrived, (m,).

        Momenta, in units of the covariance's root, are reflected at the planes that limit the box.
        """
        low, high, bounded = self._low, self._high, self._bounded
        arrived = np.zeros(len(points), dtype=bool)
        moving, left = np.arange(len(points)), times
        for _ in range(MOST_REFLECTIONS):
            begin, speed = points[moving], momenta[moving] @ self._root.T
            ends = np.where(speed < 0.0, low, high)[:, bounded]
            with np.errstate(divide="ignore", invalid="ignore"):
                until = (ends - begin[:, bounded]) / speed[:, bounded]
            until = np.where(np.isnan(until), np.inf, np.maximum(until, 0.0))
            first = np.argmin(until, axis=1) if bounded.size else np.zeros(len(moving), np.intp)
            reach = np.min(until, axis=1, initial=np.inf)
            step = np.minimum(reach, left)
            points[moving] = np.clip(begin + step[:, None] * speed, low, high)
            reflected = reach < left
            arrived[moving[~reflected]] = True
            if not reflected.any():
                break
            moving, left = moving[reflected], (left - step)[reflected]
            normals = self._root[bounded[first[reflected]]]
            normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
            along = np.sum(momenta[moving] * normals, axis=1, keepdims=True)
            momenta[moving] -= 2.0 * along * normals
        return arrived
