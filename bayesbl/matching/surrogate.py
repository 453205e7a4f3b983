"""Fast approximation of χ² between recordings and simulation near a point.

The whitened signals are smooth there, so a second-order polynomial of the unknowns describes them.
χ², the sum of their squares, is a quartic that is never negative. Each recording depends only on
its own and the shared unknowns, and has its own polynomial.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesbl.matching.signals import AT_ONCE, SimulatedSignals
from bayesbl.progress import Progress, silent
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.importance import quadratic_terms

POINTS_PER_TERM = 1.5
MOST_POINTS = 8192
REACH = 2.0
"""Range of validity, relative to the furthest point: a normal posterior has nothing beyond."""
LEAST_REACH = 10.0
"""Smallest range in standard deviations: at the edge of a range, the posterior may have an
exponential tail."""


@dataclass(frozen=True, slots=True)
class _Part:
    """One recording: r(u) = Cᵀφ(u) with φ = (1, u, uuᵀ), so χ² = φᵀ(CCᵀ)φ.

    ``index``: the recording's unknowns; u = ``inverse_root`` (x − ``centre``). The polynomial is
    invalid where |u| exceeds ``reach``. ``gram`` is CCᵀ, and ``by_rotation`` holds its terms from
    each rotation, shape (rotation, p, p).
    """

    index: NDArray[np.int64]
    centre: FloatArray
    inverse_root: FloatArray
    gram: FloatArray
    by_rotation: FloatArray
    reach: float

    def chi_square(self, points: FloatArray) -> FloatArray:
        u = (points[:, self.index] - self.centre) @ self.inverse_root.T
        is_valid = np.linalg.norm(u, axis=1) < self.reach
        terms = quadratic_terms(u[is_valid])
        chi_square = np.full(len(points), np.inf)
        chi_square[is_valid] = np.einsum("mp,mp->m", terms @ self.gram, terms)
        return chi_square

    def with_gradient(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """χ² and its gradient by the recording's unknowns, (m, d) to (m,) and (m, k)."""
        u = (points[:, self.index] - self.centre) @ self.inverse_root.T
        terms = quadratic_terms(u)
        slopes = terms @ self.gram
        k = u.shape[1]
        first, second = np.triu_indices(k)
        products = np.zeros((len(u), k, k))
        products[:, first, second] = slopes[:, 1 + k :]
        gradient = slopes[:, 1 : 1 + k] + np.einsum("mij,mj->mi", products, u)
        gradient += np.einsum("mij,mi->mj", products, u)
        is_valid = np.linalg.norm(u, axis=1) < self.reach
        chi_square = np.where(is_valid, np.einsum("mp,mp->m", slopes, terms), np.inf)
        return chi_square, 2.0 * gradient @ self.inverse_root

    def chi_square_by_rotation(self, points: FloatArray) -> FloatArray:
        terms = quadratic_terms((points[:, self.index] - self.centre) @ self.inverse_root.T)
        return np.stack([np.einsum("mp,mp->m", terms @ g, terms) for g in self.by_rotation], axis=1)


@dataclass(frozen=True, slots=True)
class Surrogate:
    """χ² of all recordings; made by :func:`regress`."""

    parts: tuple[_Part, ...]

    def chi_square(self, points: FloatArray) -> FloatArray:
        """χ², shape (m, d) to (m,); infinite outside the range of validity."""
        # In pieces: all terms of many points would fill the memory.
        pieces = np.array_split(points, math.ceil(len(points) / MOST_POINTS))
        return np.concatenate([sum(p.chi_square(rows) for p in self.parts) for rows in pieces])

    def with_gradient(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """χ² and its gradient, (m, d) to (m,) and (m, d); infinite outside the range."""
        chi_square, gradient = np.zeros(len(points)), np.zeros(points.shape)
        for part in self.parts:
            of_part, slope = part.with_gradient(points)
            chi_square += of_part
            gradient[:, part.index] += slope
        return chi_square, gradient

    def chi_square_by_rotation(self, points: FloatArray) -> list[FloatArray]:
        """χ² of each recording by its ``SimulatedSignals.rotations``, (m, d) to (m, rotation)."""
        return [part.chi_square_by_rotation(points) for part in self.parts]


def points_needed(model: SimulatedSignals) -> int:
    """Number of points that :func:`regress` needs for its polynomials."""
    largest = max(len(model.places_in(i)) for i in range(len(model.recordings)))
    return math.ceil(POINTS_PER_TERM * (1 + largest + largest * (largest + 1) // 2))


def regress(
    model: SimulatedSignals,
    points: FloatArray,
    centre: FloatArray,
    covariance: FloatArray,
    progress: Progress = silent,
) -> tuple[FloatArray, Surrogate]:
    """Simulate at some points and fit the polynomials.

    Parameters
    ----------
    points
        Shape (m, d), m at least :func:`points_needed`.
    centre, covariance
        Approximate mean and covariance of the points, shapes (d,) and (d, d). On this scale, the
        polynomials are well conditioned.
    progress
        Called with (simulations made, simulations to make), of one recording each.

    Returns
    -------
    χ² of shape (m,), nan where the simulation fails, and the surrogate.
    """
    chi_square = np.zeros(len(points))
    parts = []
    for i in range(len(model.recordings)):
        index = np.array(model.places_in(i))
        root = np.linalg.cholesky(covariance[np.ix_(index, index)])
        inverse_root = np.linalg.inv(root)
        u = (points[:, index] - centre[index]) @ inverse_root.T
        terms = quadratic_terms(u)
        p = terms.shape[1]
        normal, right = np.zeros((p, p)), np.zeros((p, model.samples_of(i)))
        for begin in range(0, len(points), AT_ONCE):
            rows = slice(begin, begin + AT_ONCE)
            residual = model.whitened_of(points[rows], i)
            chi_squares = _sums_of_squares(residual)
            chi_square[rows] += chi_squares
            residual[~np.isfinite(chi_squares)] = 0.0
            phi = terms[rows] * np.isfinite(chi_squares)[:, None]
            normal += phi.T @ phi
            right += phi.T @ residual
            done = i * len(points) + min(begin + AT_ONCE, len(points))
            progress(done, len(points) * len(model.recordings))
        # C = A⁺B, but only CCᵀ is needed, so all matrices stay small.
        inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
        channels = len(model.recordings[i].signals)
        rotation = np.tile(model.rotations(i), channels)
        rows_by_rotation = (right[:, rotation == r] for r in range(rotation[-1] + 1))
        by_rotation = inverse @ np.stack([rows @ rows.T for rows in rows_by_rotation]) @ inverse
        gram = by_rotation.sum(axis=0)
        reach = max(REACH * float(np.linalg.norm(u, axis=1).max()), LEAST_REACH)
        parts.append(_Part(index, centre[index], inverse_root, gram, by_rotation, reach))
    return chi_square, Surrogate(tuple(parts))


def simulated_chi_square(model: SimulatedSignals, points: FloatArray) -> FloatArray:
    """χ² at some points by full simulation, (m, d) to (m,); nan if it fails."""
    pieces = np.array_split(points, -(-len(points) // AT_ONCE))
    return np.concatenate([_sums_of_squares(model.whitened(piece)) for piece in pieces])


def _sums_of_squares(residuals: FloatArray) -> FloatArray:
    """Sum of squares of each row, (m, N) to (m,)."""
    return np.asarray(np.einsum("mn,mn->m", residuals, residuals))
