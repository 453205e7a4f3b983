"""An elastic part of the joint that its bench lacks: a belt, an arm or a base that yields.

It is no direction: what it does is far from linear in its compliance, and the tolerances of a bench
take up most of it, with δ off by much more than its interval. So each is a hypothesis at its full
size over its frequencies, in a search of their own: of three, half of all joints have one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bayesbl.bench.bench import BenchEffect, EffectParameterValue
from bayesbl.bench.effects import EFFECTS, effect_named
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated
from bayesbl.model_search.always_in import Direction
from bayesbl.model_search.catalogue import candidates
from bayesbl.model_search.closed_loop import name_missing
from bayesbl.model_search.refit import Explanation


@dataclass(frozen=True, slots=True)
class ElasticPart:
    """A part that the recordings speak for and the bench lacks.

    Attributes
    ----------
    fit
        With it in the bench at its most probable values, and the unknowns of the nominal fit.
    directions
        Its own values, to be marginalised: of what swings behind it the recordings say little, and
        that moves δ little.
    values, sds
        By slot.
    probability
        Against no such part and the others.
    """

    fit: SimulatedFit
    directions: tuple[Direction, ...]
    values: Mapping[str, float]
    sds: Mapping[str, float]
    probability: float

    @property
    def name(self) -> str:
        """Of its effect."""
        return next(iter(self.values)).partition("__")[0]

    @property
    def frequency_hz(self) -> float:
        """Of what swings behind it against the rest of its inertia; of a base against ground."""
        effect = effect_named(self.name)
        assert effect.resonance is not None
        (compliance,) = effect.amplitudes
        part = self.values[f"{self.name}__{effect.resonance.part}"]
        inertia = part
        if effect.resonance.is_share:
            inertia *= (1.0 - part) * self.fit.model.bench.value(effect.resonance.inertia)
        of_spring = self.values[f"{self.name}__{compliance.name}"]
        return 1.0 / (2.0 * math.pi * math.sqrt(of_spring * inertia))


def elastic_part(
    nominal: SimulatedFit, fit: SimulatedFit, among: Sequence[Direction]
) -> ElasticPart | None:
    """The part that is more likely than none, laws and drift beside either; ``None`` where none is.

    ``fit``: ``nominal`` with laws and drift freed that stood in for the part. They are linear again
    beside it, as they are next to nothing then: a lag of microseconds is what the simulator is
    slowest with.
    """
    names = [e.name for e in EFFECTS if e.resonance is not None]
    every = candidates(fit.model.bench, fit.model.recordings, names)
    parts = [c for c in every if c.name in names]
    best, probability = name_missing(fit, lambda _: parts, max_effects=1, among=among).sets[0]
    found = best.explanation
    return _in_bench(nominal, found, probability) if found.candidates else None


def _in_bench(nominal: SimulatedFit, found: Explanation, probability: float) -> ElasticPart:
    """A fitted part put into the bench, its values as directions of their flat priors."""
    (part,) = found.candidates
    places, own = found.places(part), nominal.point.size
    values = {u.name: float(found.fit.point[k]) for u, k in zip(part.unknowns, places, strict=True)}
    sds = {
        u.name: math.sqrt(float(found.fit.covariance[k, k]))
        for u, k in zip(part.unknowns, places, strict=True)
    }
    effect = BenchEffect(
        part.name,
        {name.partition("__")[2]: EffectParameterValue(value) for name, value in values.items()},
    )
    bench = nominal.model.bench
    model = nominal.model.beside(bench.with_effects(*bench.effects, effect), ())
    alone = fit_simulated(model, found.fit.point[:own], found.fit.steps[:own])
    directions = tuple(
        Direction(u.name, min(u.prior_sd, 3.0 * sds[u.name]), 0.0, is_fitted=True)
        for u in part.unknowns
    )
    return ElasticPart(alone, directions, values, sds, probability)
