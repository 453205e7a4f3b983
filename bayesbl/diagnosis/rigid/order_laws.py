"""Which law the lines of a rigid drive's speed follow over its speeds: a torque's, or an angle's.

The size of each order's line at each speed is compared with what one torque, or one error of the
encoder, would give through the loop (:mod:`bayesbl.diagnosis.rigid.speed_loop`), all orders
together and with the loop's own unknowns. Phases are free: where the motor starts is not known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.optimize import least_squares

from bayesbl.diagnosis.rigid.speed_loop import speed_of_torque, torque_of_angle
from bayesbl.model_search.constants import ALIKE
from bayesbl.recording.types import FloatArray

Law = Literal["torque", "angle", "both"]

FEWEST_FOR_BOTH = 4
"""Speeds at which two sizes and the angle between them still leave something to be wrong."""

STARTS = (0.1, 1.0, 10.0)
"""Of what is added to the loop, in sizes that would count: a small lag may raise what a larger one
lowers."""

EXPLAINED = 0.5
"""Largest share of a line's power that its law may leave at speeds that it was not fitted to."""


@dataclass(frozen=True, slots=True)
class Lines:
    """Lines of recordings, each at one speed.

    ``size``, ``sd``: of the m orders in the r recordings, shape (r, m), rpm, NaN where not shown;
    ``speeds``: mean speed of each recording, rad/s, shape (r,).
    """

    orders: tuple[float, ...]
    speeds: FloatArray
    size: FloatArray
    sd: FloatArray


@dataclass(frozen=True, slots=True)
class Free:
    """What of the loop is fitted.

    ``priors``: parameter to the sd of its logarithm; infinite where it has none. ``added``: effect
    to a size that would count, in its own unit.
    """

    priors: Mapping[str, float] = field(default_factory=dict)
    added: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LawFit:
    """Least squares of laws to lines.

    Attributes
    ----------
    laws
        Order's place to its law.
    values
        Of the loop, as fitted.
    sizes
        Order's place to its torque, N m, its angle, rad, and the phase between them.
    chi_squared, freedom
        Of the lines, in the noise's own measure, and the number of those beyond what is fitted.
    deviations
        Standard deviations: of a logarithm for a parameter, else in its unit; for an order under
        ``(place, "torque")`` and ``(place, "angle")``.
    cost
        χ² with what the priors add.
    """

    laws: Mapping[int, Law]
    values: Mapping[str, float]
    sizes: Mapping[int, tuple[float, float, float]]
    chi_squared: float
    freedom: int
    deviations: Mapping[object, float]
    cost: float

    @property
    def scatter(self) -> float:
        """Of lines around their laws, in noise; 1 where noise explains it."""
        return math.sqrt(max(1.0, self.chi_squared / max(1, self.freedom)))

    def predicted(self, place: int, order: float, speeds: FloatArray) -> FloatArray:
        """Size of a line at these speeds, rpm, shape (r,)."""
        return line_size(self.values, order, speeds, *self.sizes[place])


def line_size(
    values: Mapping[str, float],
    order: float,
    speeds: FloatArray,
    torque: float,
    angle: float,
    phase: float,
) -> FloatArray:
    """|G (a exp(iφ) + Z ε)| of a torque a, N m, and an error of the angle ε, rad; rpm."""
    frequency = order * speeds
    driving = torque * np.exp(1j * phase) + angle * torque_of_angle(values, frequency)
    return np.asarray(np.abs(speed_of_torque(values, frequency) * driving))


def fit_laws(
    lines: Lines, laws: Mapping[int, Law], believed: Mapping[str, float], free: Free
) -> LawFit:
    """Fit sizes, and what of the loop is free."""
    loops = [*free.priors, *free.added]
    keys = [
        (place, part)
        for place, law in laws.items()
        for part in (("torque", "angle", "phase") if law == "both" else (law,))
    ]
    first = {key: _first_size(lines, believed, *key) for key in keys}

    def unpacked(x: FloatArray) -> tuple[dict[str, float], dict[int, tuple[float, float, float]]]:
        values = dict(believed)
        for name, value in zip(loops, x, strict=False):
            if name in free.added:
                values[name] += float(value) * free.added[name]
            else:
                values[name] *= math.exp(float(value))
        parts = {key: float(v) * first[key] for key, v in zip(keys, x[len(loops) :], strict=True)}

        def size(place: int, part: str) -> float:
            return parts.get((place, part), 0.0)

        return values, {
            place: (size(place, "torque"), size(place, "angle"), size(place, "phase"))
            for place in laws
        }

    shown = {place: np.isfinite(lines.size[:, place]) for place in laws}
    priors = np.array([free.priors.get(name, math.inf) for name in loops])

    def misfit(x: FloatArray) -> FloatArray:
        values, sizes = unpacked(x)
        parts = [x[: len(loops)] / priors]
        for place, seen in shown.items():
            made = line_size(values, lines.orders[place], lines.speeds[seen], *sizes[place])
            parts.append((lines.size[seen, place] - made) / lines.sd[seen, place])
        return np.concatenate(parts)

    low = np.array([*(0.0 if name in free.added else -3.0 for name in loops), *[-8.0] * len(keys)])
    high = np.array([*(50.0 if name in free.added else 3.0 for name in loops), *[1e4] * len(keys)])
    found = min(
        (
            least_squares(
                misfit,
                np.array([*(size * (n in free.added) for n in loops), *np.ones(len(keys))]),
                bounds=(low, high),
                x_scale="jac",
            )
            for size in (STARTS if free.added else STARTS[:1])
        ),
        key=lambda trial: float(trial.cost),
    )
    values, sizes = unpacked(found.x)
    rows = sum(int(seen.sum()) for seen in shown.values())
    chi_squared = float(np.sum(found.fun[len(loops) :] ** 2))
    unbounded = int(np.count_nonzero(np.isinf(priors)))
    made = LawFit(laws, values, sizes, chi_squared, rows - len(keys) - unbounded, {}, 0.0)
    # Lines scatter around their laws by more than noise where the laws are not quite right.
    jacobian = found.jac.copy()
    jacobian[len(loops) :] /= made.scatter
    spread = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)))
    scale = [free.added.get(name, 1.0) for name in loops] + [abs(first[key]) for key in keys]
    names: list[object] = [*loops, *keys]
    deviations = dict(zip(names, (spread * scale).tolist(), strict=True))
    return replace(made, deviations=deviations, cost=2.0 * float(found.cost))


def _first_size(lines: Lines, believed: Mapping[str, float], place: int, part: str) -> float:
    """By weighted least squares with the loop as believed."""
    if part == "phase":
        return 1.0
    unit = (1.0, 0.0, 0.0) if part == "torque" else (0.0, 1.0, 0.0)
    return _alone(lines, believed, place, unit, np.ones(lines.speeds.size, bool))


def _alone(
    lines: Lines,
    values: Mapping[str, float],
    place: int,
    unit: tuple[float, float, float],
    chosen: FloatArray,
) -> float:
    """The size of one law for one order, from the recordings chosen."""
    seen = np.isfinite(lines.size[:, place]) & chosen
    made = line_size(values, lines.orders[place], lines.speeds[seen], *unit)
    weight = lines.sd[seen, place] ** -2
    return float(np.sum(weight * made * lines.size[seen, place]) / np.sum(weight * made**2))


def chosen_laws(
    lines: Lines, single: Sequence[Law], believed: Mapping[str, float], free: Free
) -> LawFit:
    """The law of each order that fits all lines best together."""
    laws: dict[int, Law] = dict.fromkeys(range(len(lines.orders)), single[0])
    best = fit_laws(lines, laws, believed, free)
    for _ in range(3):
        before = dict(best.laws)
        for place in before:
            for law in single:
                other = fit_laws(lines, {**best.laws, place: law}, believed, free)
                best = min(best, other, key=lambda fit: fit.cost)
        if best.laws == before:
            break
    return best


def with_both(
    lines: Lines, fit: LawFit, place: int, believed: Mapping[str, float], free: Free
) -> LawFit:
    """A fit in which one order's line is of a torque and an angle, if it must be; else of one."""
    singles = [
        fit_laws(lines, {**fit.laws, place: law}, believed, free) for law in ("torque", "angle")
    ]
    best = min(singles, key=lambda single: single.cost)
    if np.unique(np.round(lines.speeds)).size < FEWEST_FOR_BOTH:
        return best
    both = fit_laws(lines, {**fit.laws, place: "both"}, believed, free)
    return both if z_between(both, best) >= ALIKE else best


def generalises(lines: Lines, fit: LawFit, place: int) -> bool:
    """Whether an order's law predicts its line at each speed from the others.

    Of at least two speeds; of two laws together the ratio is kept.
    """
    speeds = np.round(lines.speeds / (1e-2 * np.abs(lines.speeds).max()))
    seen = np.isfinite(lines.size[:, place])
    left = whole = 0.0
    for speed in np.unique(speeds[seen]):
        others = (speeds != speed) & seen
        if not others.any():
            return False
        scale = _alone(lines, fit.values, place, fit.sizes[place], others)
        here = (speeds == speed) & seen
        made = scale * fit.predicted(place, lines.orders[place], lines.speeds[here])
        left += float(np.sum((lines.size[here, place] - made) ** 2))
        whole += float(np.sum(lines.size[here, place] ** 2))
    return left < EXPLAINED * whole


def z_between(first: LawFit, other: LawFit) -> float:
    """How far the first fits better, in standard deviations of what is left around it."""
    return math.sqrt(max(0.0, other.cost - first.cost)) / first.scatter
