"""Bench parameters that are fitted unasked, as the recordings contradict them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from types import MappingProxyType

import numpy as np

from bayesbl.diagnosis.comparison import EffectsFit, residuals, shown_squares, sum_of_squares
from bayesbl.diagnosis.fitted_parameters import impossible
from bayesbl.diagnosis.residual_noise import ResidualNoise, distance
from bayesbl.diagnosis.rigid.inverse import InverseComparison
from bayesbl.diagnosis.rigid.learned_from_motion import (
    LearnedFromMotion,
    learning_of,
    straight_line,
)
from bayesbl.diagnosis.rigid.preparation import GRAVITY, INERTIAS
from bayesbl.model_search.constants import ALIKE

MOST = 0.5
"""Share of the squares that a bench parameter must not leave, to be fitted unasked."""

_RELEASED: Mapping[str, str] = MappingProxyType(
    {
        "inertia": "Most of what friction leaves goes with the acceleration, though the bench has "
        "its inertia without a tolerance: it was fitted.",
        "gravity": "Most of what friction leaves goes with the load's angle as gravity does, "
        "though the bench has gravity_torque_nm without a tolerance: it was fitted. What it is "
        "beyond the bench's is {line}: a balancer that the bench lacks may look the same.",
        "direction": "Most of what friction and inertia leave goes with the load's angle as "
        "gravity does, though the bench has gravity_torque_nm = 0: it was fitted, with its "
        "direction. It is {line}, which looks much the same. Give gravity in the bench file, if it "
        "is that.",
    }
)


def with_released(comparison: InverseComparison) -> tuple[InverseComparison, tuple[str, ...]]:
    """The comparison with those bench parameters free that the recordings contradict, and which.

    Inertia and gravity, where the bench claims to know them: of the smallest sets of them beside
    which no other would take most of what is left, with every effect in proportion to a size, the
    first. A set that would need an inertia below zero is none.
    """
    free = {
        "inertia": lambda made: replace(made, unknown=(*made.unknown, INERTIAS[0])),
        "gravity": lambda made: replace(made, unknown=(*made.unknown, GRAVITY)),
        "direction": lambda made: replace(made, gravity_free=True),
    }
    if comparison.load or set(comparison.unknown) & set(INERTIAS):
        del free["inertia"]
    if comparison.load or not comparison.load_angle_known or GRAVITY in comparison.unknown:
        del free["gravity"]
    if comparison.load or comparison.load_angle_known or comparison.gravity_free:
        del free["direction"]

    def left(names: Sequence[str]) -> float:
        made = comparison
        for name in names:
            made = free[name](made)
        fit = made.fit(tuple(c.name for c in made.candidates if c.is_plain), None)
        if any(impossible(fit, {})):
            return math.inf
        return shown_squares(made, fit)

    sets = [names for size in range(len(free) + 1) for names in combinations(free, size)]
    squares = [left(names) for names in sets]
    chosen = next(s for s, own in zip(sets, squares, strict=True) if MOST * own <= min(squares))
    for name in chosen:
        comparison = free[name](comparison)
    return comparison, chosen


def notes_on_released(
    comparison: InverseComparison, fit: EffectsFit, released: Sequence[str], gravity_nm: float
) -> tuple[str, ...]:
    """What was fitted unasked and still is; of gravity, the spring that it could be.

    ``gravity_nm``: what the bench states, as the comparison has it fitted, N m.
    """
    free = {
        "inertia": INERTIAS[0] in comparison.unknown,
        "gravity": GRAVITY in comparison.unknown,
        "direction": comparison.gravity_free,
    }
    line = _beyond_gravity(comparison, fit, gravity_nm)
    return tuple(_RELEASED[name].format(line=line) for name in released if free[name])


def _beyond_gravity(comparison: InverseComparison, fit: EffectsFit, gravity_nm: float) -> str:
    """What is fitted over the load's angle beyond the bench's gravity, as a spring would have it.

    In the recording that goes farthest: of the others each may have a zero of its own.
    """
    ratio = comparison.bench.value("gear_ratio")
    pairs = zip(comparison.pieces, comparison.motions, strict=True)
    ways = [(motion.angle / ratio, p.name) for p, motion in pairs if p.use == "used" and p.shown]
    angle, name = max(ways, key=lambda pair: float(np.ptp(pair[0])))
    x = np.linspace(float(angle.min()), float(angle.max()), 200)
    more = fit.bench.get(GRAVITY, gravity_nm) - gravity_nm
    sine = fit.besides.get(f"gravity_sine@{name}", 0.0)
    cosine = fit.besides.get(f"gravity_cosine@{name}", 0.0)
    return straight_line(x, (more + sine) * np.sin(x) + cosine * np.cos(x))


@dataclass(frozen=True, slots=True)
class GravityInstead:
    """Another gravity than the bench's, instead of a torque over the load's angle.

    ``gravity_nm``: the bench's, N m.
    """

    comparison: InverseComparison
    gravity_nm: float

    @property
    def held(self) -> InverseComparison:
        """The same."""
        return self.comparison

    @property
    def same(self) -> None:
        """Names are found again."""

    @property
    def as_found(self) -> None:
        """There is none."""

    def answer(self, fit: EffectsFit) -> None:
        """Nothing was learned."""

    def notes(self, fit: EffectsFit) -> tuple[str, ...]:
        """That it was fitted unasked."""
        return notes_on_released(self.comparison, fit, ["gravity"], self.gravity_nm)

    def bench(self, fit: EffectsFit) -> None:
        """Nothing was learned."""


def learned_or_gravity(
    comparison: InverseComparison, fit: EffectsFit, false_alarm: float, gravity_nm: float
) -> LearnedFromMotion | GravityInstead | None:
    """What is learned; where another gravity explains a torque over the load's angle, that.

    Gravity is a law, so it is taken where it leaves no more, but for what the noise could do.
    ``gravity_nm``: what the bench states, N m.
    """
    found = learning_of(comparison, fit, false_alarm, gravity_nm)
    if (
        found is None
        or found.torque.variable != "load_angle"
        or found.torque.reverses
        or not comparison.load_angle_known
        or gravity_nm == 0.0
        or GRAVITY in comparison.unknown
    ):
        return found
    gravity = replace(comparison, unknown=(*comparison.unknown, GRAVITY))
    plain = tuple(c.name for c in gravity.candidates if c.is_plain)
    one = gravity.fit((*(e for e in fit.effects if e not in plain), *plain), None)
    made = found.comparison
    names = tuple(e for e in one.effects if e in made.terms)
    other = made.fit(names, None)
    return GravityInstead(gravity, gravity_nm) if leaves_no_more(comparison, one, other) else found


def leaves_no_more(comparison: InverseComparison, one: EffectsFit, other: EffectsFit) -> bool:
    """Whether one fit leaves no more of the used pieces than another, but for noise."""
    theirs = residuals(comparison, one, "used"), residuals(comparison, other, "used")
    first, second = map(sum_of_squares, theirs)
    noises = [ResidualNoise.of(part) for part in theirs[1]]
    return first <= second or distance(*theirs, noises) < ALIKE
