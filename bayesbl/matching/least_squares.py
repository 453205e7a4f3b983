"""Least-squares fit of a simulation to recordings, by whitened residuals."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from bayesbl.errors import SimulationError
from bayesbl.matching.signals import SimulatedSignals
from bayesbl.recording.types import FloatArray

IDLE = 1e-100
"""Root of a curvature below which nothing depends on a coordinate, whatever its unit."""

STEEPEST = 1e100
"""Derivative from which a simulation has diverged: squares of it may overflow."""
SHORTEST_STEP = 1e-12
"""Shortest step of a derivative, relative to the coordinate: a shorter one is lost in rounding."""
STEP_CHANGE = 4.0
"""Change of the whitened signals over a derivative's step, in standard deviations."""
LONGEST_STEP = 0.25 * math.sqrt(12.0)
"""Longest step of a derivative, in prior standard deviations: a quarter of a flat prior's range."""
MOST_ROUNDS = 30
CONVERGED = 0.01
CONVERGED_SHARE = 1e-4
"""Iterations end when one lowers χ² by less than this, or by this share of its excess over
noise."""
KEPT_PROMISE = 0.8
"""Share of the promised gain above which a Jacobian serves for the next iteration too."""
RANKING_STEP = 20.0
"""Step of derivatives that only rank points, relative to a fit's first step."""
NEAR = 1.0
"""Gain of χ² since the Jacobian was computed, within which it is valid for the covariance: about
one standard deviation of a coordinate."""
ROUGHLY_CONVERGED, ROUGHLY_CONVERGED_SHARE = 1.0, 0.01
"""The same limits for a rough fit. A fit that gains less per iteration is no contender yet; the
best ones are completed."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedFit:
    """The most probable point and the derivatives there.

    Attributes
    ----------
    point
        Shape (d,).
    residual
        Whitened residuals, shape (N,).
    curvature
        JᵀJ, with J the Jacobian of the whitened signals, shape (d, d).
    covariance
        (JᵀJ + P)⁻¹ with P the prior's precision, shape (d, d).
    steps
        Steps of the derivatives, shape (d,).
    """

    model: SimulatedSignals
    point: FloatArray
    residual: FloatArray
    curvature: FloatArray
    covariance: FloatArray
    steps: FloatArray
    _jacobian: FloatArray | None = field(default=None, init=False)

    @property
    def chi_square(self) -> float:
        """Sum of squared whitened residuals and deviations."""
        return float(self.residual @ self.residual) + float(self.deviations @ self.deviations)

    @property
    def deviations(self) -> FloatArray:
        """Whitened deviations from normal priors: (centre − coordinate) / prior standard deviation.

        Such a prior acts like a further measurement, for example of a start angle.
        """
        return self.model.normal_prior.deviations(self.point)

    @property
    def bound(self) -> FloatArray:
        """Cramér-Rao bound on the standard deviation of each coordinate, without priors, (d,).

        Infinite if nothing depends on the coordinate, as on the angle of an axis without gravity.
        """
        norms = np.sqrt(np.diag(self.curvature))
        shown = norms > 0.0
        scaled = self.curvature[np.ix_(shown, shown)] / np.outer(norms[shown], norms[shown])
        bound = np.full(norms.size, np.inf)
        bound[shown] = np.sqrt(np.diag(np.linalg.pinv(scaled))) / norms[shown]
        return bound

    def derivatives(self) -> FloatArray:
        """Jacobian J of the whitened signals at the point, shape (N, d).

        The fit's last one, or computed again if it was dropped.
        """
        if self._jacobian is not None:
            return self._jacobian
        return _jacobian(self.model, self.point, self.steps)[0]

    def with_derivatives(self) -> SimulatedFit:
        """The same fit, holding its Jacobian."""
        if self._jacobian is not None:
            return self
        return _fit(
            self.model, self.point, self.residual, self.curvature, self.steps, self.derivatives()
        )

    def without_derivatives(self) -> SimulatedFit:
        """The same fit without its Jacobian, to save memory."""
        return replace(self)

    def peak(self) -> FloatArray:
        """Peak of the normal approximation, (d,); outside where a range's end stopped the fit."""
        model = self.model
        if np.all((self.point > model.low) & (self.point < model.high)):
            return self.point
        pull = self.derivatives().T @ self.residual + prior_pull(model, self.point)
        return np.asarray(self.point + self.covariance @ pull)

    def simulated(self, recording: int) -> FloatArray:
        """Simulated channels of a recording, shape (c, n)."""
        return np.asarray(self.model.signals(self.point, recording)[0])

    def unexplained(self, recording: int) -> FloatArray:
        """Recorded minus simulated channels, shape (c, n); 0 where excluded."""
        return self.model.recordings[recording].residual_of(self.simulated(recording))

    def value(self, name: str, recording: str | None = None) -> float:
        """Value of an unknown at the optimum."""
        i = self.model.index(name, recording)
        return float(self.model.unknowns[i].value(self.point[i]))

    def sd(self, name: str, recording: str | None = None) -> float:
        """Posterior standard deviation of an unknown's coordinate (of ln δ for the gap)."""
        i = self.model.index(name, recording)
        return float(np.sqrt(self.covariance[i, i]))


def fit_simulated(
    model: SimulatedSignals,
    start: FloatArray,
    steps: FloatArray | None = None,
    *,
    rough: bool = False,
    one_sided: bool = False,
    known: FloatArray | None = None,
    goal: float = math.inf,
) -> SimulatedFit:
    """Levenberg-Marquardt within the priors' ranges, with each Jacobian in one simulation batch.

    Parameters
    ----------
    start
        Shape (d,); clipped to the ranges.
    steps
        Derivative steps of the first unknowns, from a fit without the others.
    rough
        Converge only as far as comparisons need, with one-sided differences, keeping the last
        Jacobian.
    one_sided
        Use one-sided differences, at half the cost: for fits that are only compared. Those that
        decide are made again with central differences.
    known
        Derivatives by the first unknowns at a nearby point, shape (N, k).
    goal
        χ² above which the fit is useless: it ends if the remaining iterations would not reach it at
        the last gain.

    Raises
    ------
    SimulationError
        If the bench cannot be simulated at the start.
    """
    point = np.clip(start, model.low, model.high)
    first_steps = _first_steps(model, point)
    steps = first_steps if steps is None else np.concatenate([steps, first_steps[len(steps) :]])
    residual = model.whitened(point)[0]
    if not np.all(np.isfinite(residual)):
        model.require(point)
        raise SimulationError(
            "The bench cannot be simulated at the start of the fit.",
            found=", ".join(
                f"{u.label} = {float(u.value(x)):.4g}"
                for u, x in zip(model.unknowns, point, strict=True)
            ),
        )
    value = _objective(model, point, residual)
    damping = 1e-3
    normal = model.normal_prior.precision
    least, share = CONVERGED, CONVERGED_SHARE
    if rough:
        least, share = ROUGHLY_CONVERGED, ROUGHLY_CONVERGED_SHARE
    one_sided = one_sided or rough
    jacobian, steps = _jacobian(model, point, steps, one_sided=one_sided, known=known)
    is_reused, value_at_jacobian, rounds = known is not None, value, 1
    while True:
        gradient = jacobian.T @ residual + prior_pull(model, point)
        curvature = jacobian.T @ jacobian
        hessian = curvature + normal
        gained, promised = 0.0, math.inf
        while damping < 1e8:
            move = _bounded_step(point, gradient, hessian, damping, model.low, model.high)
            trial = point + move
            trial_residual = model.whitened(trial)[0]
            trial_value = _objective(model, trial, trial_residual)
            if trial_value < value:
                gained, promised = value - trial_value, _promised(gradient, hessian, move)
                point, residual, value = trial, trial_residual, trial_value
                damping = max(damping / 10.0, 1e-9)
                break
            if is_reused or np.all(np.abs(move) < 1e-3 / np.sqrt(np.diag(hessian).clip(1e-300))):
                break
            damping *= 10.0
        was_new, is_reused = not is_reused, gained > KEPT_PROMISE * promised
        least_gain = max(least, share * (value - residual.size))
        if was_new and value - goal > gained * (MOST_ROUNDS - rounds):
            break
        ended = gained < least_gain and (was_new or is_reused)
        if ended and known is not None:
            # A Jacobian from elsewhere may miss a way on.
            is_reused = False
        elif ended:
            break
        if not is_reused:
            if rounds >= MOST_ROUNDS:
                break
            jacobian, steps = _jacobian(model, point, steps, one_sided=one_sided)
            value_at_jacobian, rounds, known = value, rounds + 1, None
    if not rough and value_at_jacobian - value > NEAR:
        jacobian, steps = _jacobian(model, point, steps, one_sided=one_sided)
        curvature, value_at_jacobian = jacobian.T @ jacobian, value
    # A comparison may use a nearby Jacobian; an answer needs that of the optimum.
    final_jacobian = (
        jacobian if value_at_jacobian - value <= (NEAR if one_sided else CONVERGED) else None
    )
    return _fit(model, point, residual, curvature, steps, final_jacobian)


def promised_within(
    model: SimulatedSignals, point: FloatArray, low: FloatArray, high: FloatArray
) -> float:
    """χ² that a single step from a point, shape (d,), within a range promises to leave.

    Not finite if the point cannot be simulated. One-sided differences over a fiftieth of each range
    rank distant points well enough without a fit from each.
    """
    steps = _first_steps(model, point) * RANKING_STEP
    steps = np.where(point + steps > model.high, -steps, steps)
    white = model.whitened(np.concatenate([point[None], point + np.diag(steps)]))
    residual = white[0]
    jacobian = (residual - white[1:]).T / steps
    jacobian[:, ~np.all(np.isfinite(jacobian), axis=0)] = 0.0
    gradient, curvature = jacobian.T @ residual, jacobian.T @ jacobian
    move = _bounded_step(point, gradient, curvature, 1e-9, low, high)
    return float(residual @ residual) - _promised(gradient, curvature, move)


def _promised(gradient: FloatArray, curvature: FloatArray, move: FloatArray) -> float:
    """Reduction of χ² by a move, in the quadratic approximation."""
    return float(2.0 * gradient @ move - move @ curvature @ move)


def fit_at(model: SimulatedSignals, point: FloatArray) -> SimulatedFit:
    """A fit object at a given point, with the derivatives there."""
    residual = model.whitened(point)[0]
    jacobian, steps = _jacobian(model, point, _first_steps(model, point))
    return _fit(model, point, residual, jacobian.T @ jacobian, steps, jacobian)


def derivatives(model: SimulatedSignals, point: FloatArray, steps: FloatArray) -> FloatArray:
    """Jacobian of the whitened signals at a point, shape (N, d)."""
    return _jacobian(model, point, steps)[0]


def _fit(
    model: SimulatedSignals,
    point: FloatArray,
    residual: FloatArray,
    curvature: FloatArray,
    steps: FloatArray,
    jacobian: FloatArray | None,
) -> SimulatedFit:
    """``jacobian``: at the point; dropped when the fit is changed."""
    covariance = np.asarray(np.linalg.inv(curvature + model.prior_precision()), np.float64)
    fit = SimulatedFit(model, point, residual, curvature, covariance, steps)
    object.__setattr__(fit, "_jacobian", jacobian)
    return fit


def _objective(model: SimulatedSignals, point: FloatArray, residual: FloatArray) -> float:
    chi_square = float(residual @ residual)
    return (
        chi_square - 2.0 * float(model.log_prior(point)[0]) if np.isfinite(chi_square) else np.inf
    )


def prior_pull(model: SimulatedSignals, point: FloatArray) -> FloatArray:
    """Gradient of the log prior at points, shape (…, d), without flat priors."""
    prior = model.normal_prior
    return np.asarray((prior.centre - point) @ prior.precision)


def _bounded_step(
    point: FloatArray,
    gradient: FloatArray,
    curvature: FloatArray,
    damping: float,
    low: FloatArray,
    high: FloatArray,
) -> FloatArray:
    """Damped Gauss-Newton step, clipped at the ends of the ranges.

    Coordinates that nothing depends on (the torque constant without current) stay where they are.
    ``gradient``: Jᵀr plus the prior's pull, with r = recording − simulation and J the derivative of
    the simulation, so it points towards the optimum.
    """
    scale = np.sqrt(np.diag(curvature))
    free = scale > IDLE
    move = np.zeros(point.size)
    for _ in range(point.size + 1):
        index = np.flatnonzero(free)
        if not index.size:
            break
        matrix = curvature[np.ix_(index, index)] / np.outer(scale[index], scale[index])
        matrix = matrix + damping * np.eye(index.size)
        right = gradient[index] - curvature[np.ix_(index, ~free)] @ move[~free]
        move[index] = np.linalg.solve(matrix, right / scale[index]) / scale[index]
        outside = free & ((point + move < low - 1e-15) | (point + move > high + 1e-15))
        if not np.any(outside):
            break
        move[outside] = np.clip(point + move, low, high)[outside] - point[outside]
        free &= ~outside
    return np.asarray(np.clip(point + move, low, high) - point)


def _first_steps(model: SimulatedSignals, point: FloatArray) -> FloatArray:
    """First steps: a thousandth of each range, or of a radian, or of the value."""
    width = model.high - model.low
    rough = np.maximum(1e-3 * np.abs(point), 1e-6)
    return np.where(np.isfinite(width), 1e-3 * width, rough)


def _jacobian(
    model: SimulatedSignals,
    point: FloatArray,
    steps: FloatArray,
    one_sided: bool = False,
    known: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Jacobian of the whitened signals by differences, and better steps for the next time.

    Steps whose change is not of the order of the noise are repeated: the simulator's own error
    drowns a shorter one, and curvature distorts a longer one. Central differences unless
    ``one_sided``.
    """
    d = point.size
    columns = np.empty((d, model.size)).T
    pending = np.arange(0 if known is None else known.shape[1], d)
    if known is not None:
        columns[:, : known.shape[1]] = known
    steps = steps.copy()
    sides = 1.0 if one_sided else 2.0
    for attempt in range(4 if pending.size else 0):
        steps = np.maximum(steps, SHORTEST_STEP * np.abs(point))
        points = np.repeat(point[None], 2 * pending.size, axis=0)
        ends = points[: pending.size], points[pending.size :]
        for row, i in enumerate(pending):
            ends[0][row, i] = min(point[i] + steps[i], model.high[i])
            if not one_sided or ends[0][row, i] <= point[i]:
                ends[1][row, i] = max(point[i] - steps[i], model.low[i])
        begin, half = 0, pending.size
        for recording in range(len(model.recordings)):
            # One recording at a time: twice as many signals as derivatives would fill the memory.
            z = model.whitened_of(points, recording)
            # The residual falls where the simulation rises.
            columns.T[pending, begin : begin + z.shape[1]] = z[half:] - z[:half]
            begin += z.shape[1]
        repeated = []
        for row, i in enumerate(pending):
            change = float(np.linalg.norm(columns[:, i])) / sides
            length = ends[0][row, i] - ends[1][row, i]
            if not change < STEEPEST * length:
                steps[i] *= 0.1
                repeated.append(i)
                continue
            columns[:, i] /= length
            better = steps[i] * float(np.clip(STEP_CHANGE / max(change, 1e-12), 1e-3, 1e3))
            better = min(better, LONGEST_STEP * model.unknowns[int(i)].prior_sd)
            if not 0.2 < change / STEP_CHANGE < 5.0 and not np.isclose(better, steps[i]):
                repeated.append(i)
            steps[i] = better
        pending = np.array(repeated, dtype=int)
        if not pending.size or attempt == 3:
            break
    columns[:, ~(np.abs(columns).max(axis=0, initial=0.0) < STEEPEST)] = 0.0
    return columns, steps
