"""Values of a data sheet that recordings contradict, also where others make up for them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from bayesbl.identification.problem import FALSE_ALARM, Problem, is_explained
from bayesbl.identification.wrong_by_far import explanations_from_afar, freed
from bayesbl.matching.alignment import remaining_noise
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated
from bayesbl.matching.loop_noise import factors_along, factors_of_estimates
from bayesbl.matching.signals import GAP, Unknown
from bayesbl.naming.criteria import are_alike, contends, left
from bayesbl.naming.explanation import (
    Explanation,
    explain,
    gain_threshold,
    gains_more_than_chance,
    polished,
    with_noise,
)
from bayesbl.probabilities import chi2_sf
from bayesbl.progress import Progress
from bayesbl.recording.types import FloatArray

WIDER = 1.5
"""Times a tolerance, where its edge has stopped a match."""

AT_EDGE = 1e-6
"""Of a tolerance's width, between a match that an edge has stopped and the edge."""

EDGE_FALSE_ALARM = 0.05
"""Of a fall of χ² beyond the edges of tolerances, where all true values lie at these very edges."""

POLISHED = 3
"""Parameters beyond their tolerance that are fitted to the end, the best of the rough fits."""


@dataclass(frozen=True, slots=True)
class BeyondDataSheet:
    """A value of the data sheet that the recordings contradict.

    Attributes
    ----------
    believed, tolerance
        By the data sheet.
    found
        By the recordings.
    deviations
        From the nearer end of its tolerance to what was found, in standard deviations.
    could_be
        Other parameters that would explain the recordings as well, each alone.
    """

    name: str
    believed: float
    tolerance: float
    found: float
    deviations: float
    could_be: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class WiderTolerances:
    """The recordings matched again with tolerances half as wide again.

    Attributes
    ----------
    at_edges
        Parameters that lay at the edges of their tolerances.
    gain
        By how much χ² falls.
    noise
        Variance of noise along what changed, some likely values, (k,): 1 of the recorder's.
    gaps_rad
        δ of each gap before and after, shape (gap, 2).
    """

    at_edges: tuple[str, ...]
    gain: float
    noise: FloatArray
    gaps_rad: FloatArray

    @property
    def explain_more(self) -> bool:
        """Whether χ² falls by more than chance, were the true values within the tolerances."""
        chances = [chance_at_edges(self.gain / own, len(self.at_edges)) for own in self.noise]
        return float(np.mean(chances)) < EDGE_FALSE_ALARM


def chance_at_edges(gain: float, edges: int) -> float:
    """Probability that χ² falls by so much or more beyond edges at which the true values lie.

    Each of independent normal values is beyond its edge in one case of two: a mixture of χ² with 0
    to all degrees of freedom (Self and Liang 1987).
    """
    ways = [math.comb(edges, freedom) for freedom in range(1, edges + 1)]
    tails = chi2_sf(gain, np.arange(1, edges + 1))
    return float(np.dot(ways, tails)) / 2.0**edges


def with_wider_tolerances(fit: SimulatedFit, problem: Problem) -> WiderTolerances | None:
    """The match again, from where it ended, if the edge of a tolerance has stopped it there."""
    model = fit.model
    own = [k for k, u in enumerate(model.unknowns) if u.name in problem.parameters]
    ends = np.minimum(fit.point - model.low, model.high - fit.point)
    stopped = [k for k in own if ends[k] < AT_EDGE * (model.high[k] - model.low[k])]
    if not stopped:
        return None
    unknowns = [_wider(u) if k in own else u for k, u in enumerate(model.unknowns)]
    wider = fit_simulated(replace(model, unknowns=unknowns), fit.point, fit.steps)
    gaps = [k for k, u in enumerate(unknowns) if u.name == GAP]
    values = [[unknowns[k].value(f.point[k]) for f in (fit, wider)] for k in gaps]
    names = tuple(unknowns[k].name for k in stopped)
    noise = factors_along(fit, fit.residual - wider.residual)
    return WiderTolerances(names, fit.chi_square - wider.chi_square, noise, np.array(values))


def _wider(unknown: Unknown) -> Unknown:
    """Over a range ``WIDER`` times as wide; none that is not negative becomes so."""
    more = 0.5 * (WIDER - 1.0) * (unknown.high - unknown.low)
    low = unknown.low - more
    if unknown.low >= 0.0 and not unknown.logarithmic:
        low = max(low, 0.0)
    return replace(unknown, low=low, high=unknown.high + more)


def beyond_an_edge(
    found: Explanation, wider: WiderTolerances, problem: Problem
) -> tuple[Explanation, BeyondDataSheet] | None:
    """One parameter beyond its tolerance, where that explains more than chance would."""
    trials = len(problem.parameters)
    # A wrong value shows most of it there, and each below takes a fit.
    if wider.gain < gain_threshold(1, trials, FALSE_ALARM):
        return None
    wrong = beyond_data_sheet(found, problem)
    if wrong is None:
        return None
    by_same_noise = with_noise(wrong[0], found.fit.model.noise)
    stands_out = gains_more_than_chance(found, by_same_noise, trials, FALSE_ALARM)
    return wrong if stands_out else None


def beyond_data_sheet(
    nominal: Explanation, problem: Problem
) -> tuple[Explanation, BeyondDataSheet] | None:
    """One parameter beyond its tolerance that explains all, from where the match has ended."""
    fit = nominal.fit
    wider = [
        freed(name, fit.value(name))
        for name in problem.parameters
        if problem.bench.value(name) > 0.0
    ]
    rough = [e for e in (explain(nominal, c) for c in wider) if e is not None]
    return _best_beyond(rough, problem)


def far_beyond_data_sheet(
    problem: Problem, progress: Progress | None = None
) -> tuple[Explanation, BeyondDataSheet] | None:
    """The same where no match is near: from wherever in its whole range it may fit best.

    ``progress``: called with (places scanned, places in all).
    """
    return _best_beyond(explanations_from_afar(problem, progress), problem)


def _best_beyond(
    rough: list[Explanation], problem: Problem
) -> tuple[Explanation, BeyondDataSheet] | None:
    """The best of rough fits that explains all once fitted to the end, beyond its tolerance."""
    best = sorted(rough, key=lambda e: e.fit.chi_square)[:POLISHED]
    # What leaves far more than the best is no rival, and would take long to fit to the end.
    best = [e for e in best if contends(left(e), left(best[0]))]
    fitted = [with_noise(polished(e), remaining_noise(e.fit)) for e in best]
    outside = [e for e in fitted if _is_outside(e, problem)]
    found = sorted(filter(is_explained, outside), key=lambda e: e.fit.chi_square)
    if not found:
        return None
    chosen, *others = found
    name = chosen.candidates[-1].name
    value, half = problem.bench.value(name), problem.bench.tolerances[name]
    unknown = chosen.fit.model.unknowns[-1]
    estimate = float(chosen.fit.point[-1])
    ends = [math.log(end) for end in (value - half, value + half) if end > 0.0]
    own = np.eye(chosen.fit.point.size)[-1]
    noise = float(np.mean(factors_of_estimates(chosen.fit, own)))
    sd = math.sqrt(noise * float(chosen.fit.covariance[-1, -1]))
    return chosen, BeyondDataSheet(
        name,
        value,
        half,
        float(unknown.value(np.array(estimate))),
        min(abs(estimate - end) for end in ends) / sd,
        _alike(chosen, others),
    )


def _alike(chosen: Explanation, others: list[Explanation]) -> tuple[str, ...]:
    """Other parameters that the recordings do not tell from the chosen one, each once."""
    names = [e.candidates[-1].name for e in others if are_alike(chosen, e)]
    return tuple(n for n in dict.fromkeys(names) if n != chosen.candidates[-1].name)


def _is_outside(explanation: Explanation, problem: Problem) -> bool:
    """Whether the parameter freed last is beyond its tolerance."""
    name = explanation.candidates[-1].name
    found = float(explanation.fit.model.unknowns[-1].value(explanation.fit.point[-1]))
    return abs(found - problem.bench.value(name)) > problem.bench.tolerances[name]
