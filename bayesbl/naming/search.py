"""Which effect is missing: candidates added one at a time, compared by evidence and by distance."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.predictive_check import agrees, disagreements
from bayesbl.naming.candidates import Candidate, held_by, steady_torque
from bayesbl.naming.criteria import (
    ALIKE,
    are_alike,
    consistency,
    contends,
    explains,
    gross_recordings,
    is_gross,
    least_ratio,
    left,
    misfit_scale,
    stands_out_of_misfit,
)
from bayesbl.naming.explanation import (
    Explanation,
    distance,
    effects_alone,
    explain,
    from_afar,
    gain_threshold,
    gains_more_than_chance,
    last_alone,
    linear_gains,
    nominal_explanation,
    polished,
    reduced,
    refitted,
    simplified,
)
from bayesbl.naming.law_forms import least_beside, without_mends
from bayesbl.naming.motor_orders import OrderPeak, order_peaks
from bayesbl.naming.naming import NamedCandidate, Naming
from bayesbl.progress import Progress
from bayesbl.recording.types import FloatArray

WORTH_FITTING = 0.5
"""Promised gain from which on a candidate is fitted, as a share of what naming asks for, or of the
best one's where many are tried."""

BEAMS = 3
"""Explanations that another candidate is added to."""
BEAMS_ALONE = 5
"""The same of explanations by one candidate, if none of them agrees."""
MOST_EXCHANGES = 4
CLEARLY_BETTER = 1.0
"""Gain of log evidence for which one candidate is exchanged for another.

Odds of e to 1: below that a difference is "not worth more than a bare mention" (Kass and Raftery
1995, 2 ln B of 2), and both are in the set reported, whichever stands first.
"""
FITTED_AFTER_SCREENING = 5
CONTENDERS = 5
LEAST_CONSISTENCY = 3.0
"""Mean over standard error of the gain per rotation: an effect helps in every rotation.

A gain that comes from k of a recording's n rotations alone, alike in these, has
√(k (n − 1)/(n − k)): 1 for a single event, whatever n, and above 3 only where k > 9n/(n + 8): all
of 4 rotations, 4 of 5, 6 of 10. Gains that scatter about zero pass with the probability of
Student's t, 0.6 % in three recordings of five rotations (12 degrees of freedom), 2 % in one (4),
and only after the whole gain has passed a threshold of its own.
"""


def name_missing(
    nominal_fit: SimulatedFit,
    candidates: Callable[[Sequence[OrderPeak]], Sequence[Candidate]],
    *,
    max_effects: int = 3,
    false_alarm: float = 0.01,
    screened: bool = False,
    progress: Progress | None = None,
) -> Naming:
    """Add candidates until nothing significant remains, nothing generalises or the limit is met.

    Decisions rest on fits of all recordings jointly with every unknown; derivatives choose which
    second and third candidates are fitted, and the first where nothing seems to be missing.

    Parameters
    ----------
    candidates
        All that come into question, given the motor orders that stand out. Orders are looked for
        again in the residual beside the first that are named: they may have stood behind these.
    false_alarm
        Probability of naming anything where nothing is missing, over all candidates.
    screened
        Where the bench disagrees but is not far off, fit only the candidates that promise a good
        share of what the best of them promises.
    progress
        Called with (fits made, fits expected).
    """
    nominal = nominal_explanation(nominal_fit)
    search = _Search(
        nominal, candidates(order_peaks(nominal_fit)), false_alarm, max_effects, screened, progress
    )
    before = disagreements(nominal_fit)
    first = search.first()
    far: list[Explanation] = []
    # In motions a search through the whole range of every candidate would take an hour.
    moving = any(seen.motion is not None for seen in nominal_fit.model.recordings)
    if first and is_gross(first[0]) and not moving:
        # What is missing may have drawn the gap to another optimum.
        far = search.from_afar()
        first = search.first_from_afar(first, far)
    final = search.extended(first, most=2)
    if far and is_gross(first[0]) and not search.agrees(final):
        final = _better(final, search.extended(search.beside(far)))
    if final.candidates and search.add_late(candidates(order_peaks(final.fit)), final):
        final = search.continued(final)
    if len(final.candidates) == 2 and not search.is_done(final):
        final = _better(final, search.extended(first))
    nearest, final = final, search.settled(final, first)
    alone = tuple(first)
    if not final.candidates:
        return Naming(nominal, nominal, (), alone, not agrees(before, false_alarm))
    for answer in (final, effects_alone(nominal, final)):
        if answer and explains(nominal, answer, before, disagreements(answer.fit), false_alarm):
            effects = tuple(search.named(answer, first))
            return without_mends(Naming(nominal, answer, effects, alone, False))
    return Naming(nominal, nominal, (), alone, True, _better(nearest, final))


class _Search:
    """Fits of candidates with their thresholds; counts them for the progress bar."""

    def __init__(
        self,
        nominal: Explanation,
        candidates: Sequence[Candidate],
        false_alarm: float,
        max_effects: int,
        screened: bool,
        progress: Progress | None,
    ) -> None:
        self._nominal = nominal
        self._candidates = tuple(candidates)
        self._false_alarm = false_alarm
        self._max_effects = max_effects
        self._screened_first = screened
        self._progress = progress
        self._made = 0
        self._fits: dict[tuple[int, int], tuple[Explanation, Explanation | None]] = {}
        self._rests: dict[tuple[int, int], tuple[Explanation, Explanation | None]] = {}
        self._promises: dict[int, tuple[Explanation, FloatArray]] = {}
        self._polished: dict[int, tuple[Explanation, Explanation]] = {}

    def first(self) -> list[Explanation]:
        """All candidates that come into question, one at a time, most probable first.

        Where the bench as believed agrees with the recordings, what is missing is small and its
        derivatives tell what it could gain: what promises nothing is not fitted.
        """
        tried = self._candidates
        if not is_gross(self._nominal) and (self._screened_first or self.agrees(self._nominal)):
            least = WORTH_FITTING * self._threshold(1)
            if self._screened_first:
                least = max(least, WORTH_FITTING * self._best_promise(self._nominal))
            promised = zip(tried, self._promised(self._nominal), strict=True)
            tried = tuple(c for c, gain in promised if gain > least)
        return self._contenders([self._fit(self._nominal, c) for c in tried])

    def from_afar(self) -> list[Explanation]:
        """Candidates that move the gap, each sought in its whole range, most probable first.

        They are sought with a constant torque free in every recording, so that friction of the
        motor does not draw the gap away, and then stand without it, not fitted again. What acts in
        one recording alone is sought where that one is far off and another is not.
        """
        model = self._nominal.fit.model
        steady = steady_torque(model.bench, model.recordings)
        free = (None if steady is None else self._fit(self._nominal, steady)) or self._nominal
        off = gross_recordings(self._nominal)
        alone = off if len(off) < len(model.recordings) else ()
        sought = [c for c in self._candidates if c.scanned and c.recording in (None, *alone)]
        found = []
        for candidate in sought:
            found.append(from_afar(free, candidate))
            self._report(len(sought) - len(found))
        best = sorted((e for e in found if e is not None), key=lambda e: -e.log_evidence)
        return [last_alone(self._nominal, e) for e in best]

    def first_from_afar(
        self, first: Sequence[Explanation], far: Sequence[Explanation]
    ) -> list[Explanation]:
        """All candidates one at a time, those from afar fitted from where they stand too."""
        return _distinct(self._contenders([*first, *map(refitted, far)]))

    def beside(self, far: Sequence[Explanation]) -> list[Explanation]:
        """Pairs of the best candidates from afar with another."""
        pairs: list[Explanation] = []
        for explanation in far[:BEAMS]:
            pairs += self.next(explanation)
            if any(self.is_done(pair) for pair in pairs):
                break
        return self._contenders(pairs)

    def extended(self, first: Sequence[Explanation], most: int | None = None) -> Explanation:
        """The most probable explanation by as many candidates as it takes, at most so many."""
        most = self._max_effects if most is None else min(most, self._max_effects)
        beams = [e for e in first if self.is_significant(self._nominal, e)]
        final = beams[0] if beams else self._nominal
        if not self.agrees(self._nominal):
            # One of two effects alone may fit one recording better and another worse.
            beams = [e for e in first if self._gains_enough(self._nominal, e)]
        beams = _apart(beams)[: BEAMS if self.agrees(final) else BEAMS_ALONE]
        while beams and len(final.candidates) < most and not self.is_done(final):
            following: list[Explanation] = []
            for beam in beams:
                following += self.next(beam, max([final, *following], key=_evidence))
                if any(self.is_done(e) for e in following):
                    break
            following = _distinct(sorted(following, key=_evidence, reverse=True))
            if not following or following[0].log_evidence <= final.log_evidence:
                break
            beams, final = _apart(following)[:BEAMS], following[0]
        return final

    def continued(self, base: Explanation) -> Explanation:
        """An explanation with the candidates that it still takes, one after the other."""
        while len(base.candidates) < self._max_effects and not self.is_done(base):
            more = self.next(base)
            if not more or more[0].log_evidence <= base.log_evidence:
                break
            base = more[0]
        return base

    def next(self, base: Explanation, rival: Explanation | None = None) -> list[Explanation]:
        """The few candidates that the derivatives speak for, added to ``base`` and significant.

        What promises no more than the form of a law may leave is not tried, nor, with a
        ``rival``, what promises to leave more than this one does.
        """
        least = WORTH_FITTING * least_beside(self._nominal, base)
        if rival is not None:
            least = max(least, left(base) - left(rival))
        promised = dict(zip(map(id, self._candidates), self._promised(base), strict=True))
        tried = [c for c in self._screened(base) if promised[id(c)] > least]
        fits = self._contenders([self._fit(base, c) for c in tried])
        return [f for f in fits if self.is_significant(base, f)]

    def add_late(self, found: Sequence[Candidate], beside: Explanation) -> bool:
        """Add candidates not known before that can stand beside an explanation; whether any are."""
        known = {c.key for c in self._candidates}
        late = [c for c in found if c.key not in known and c.label not in beside.names]
        self._candidates += tuple(late)
        if late:
            self._promises.clear()
        return bool(late)

    def agrees(self, explanation: Explanation) -> bool:
        """Whether nothing repeats any more."""
        return agrees(disagreements(explanation.fit), self._false_alarm)

    def is_significant(self, base: Explanation, more: Explanation) -> bool:
        """Whether χ² falls by more than chance, and in the rotations alike."""
        enough = self._gains_enough(base, more)
        return enough and consistency(base.fit, more.fit) > LEAST_CONSISTENCY

    def _gains_enough(self, base: Explanation, more: Explanation) -> bool:
        return gains_more_than_chance(base, more, len(self._candidates), self._false_alarm)

    def is_done(self, explanation: Explanation) -> bool:
        """Whether nothing repeats any more and no further candidate promises anything."""
        return self.agrees(explanation) and self._best_promise(explanation) < self._threshold(1)

    def settled(self, final: Explanation, first: Sequence[Explanation]) -> Explanation:
        """Leave out and exchange candidates until neither helps.

        What came first was chosen alone, and may only have stood in for what was to follow.
        """
        for _ in range(MOST_EXCHANGES):
            final = self.without_idle(final, first)
            better = self._exchanged(final, first)
            if better is None:
                break
            final = better
        return self._simplest(final)

    def _simplest(self, final: Explanation) -> Explanation:
        """With the law that another one holds in its place, where its own term does not stand out.

        Friction that drifts explains what Coulomb friction does, and a little of anything else.
        """
        for place, candidate in enumerate(final.candidates):
            held = held_by(candidate)
            for inner in (c for c in self._candidates if (c.name, c.recording) == held):
                simpler = simplified(self._nominal, final, place, inner)
                if simpler is not None and not self._is_worth_naming(simpler, final):
                    return simpler
        return final

    def _exchanged(self, final: Explanation, first: Sequence[Explanation]) -> Explanation | None:
        """The most probable explanation with one candidate replaced, if that is a better one."""
        if len(final.candidates) < 2:
            return None
        others = [
            e for k in range(len(final.candidates)) for e in self._alternatives(final, k, first)
        ]
        best = max(others, key=lambda e: e.log_evidence, default=final)
        return best if best.log_evidence > final.log_evidence + CLEARLY_BETTER else None

    def without_idle(self, final: Explanation, first: Sequence[Explanation]) -> Explanation:
        """Leave out what the others have made superfluous."""
        if len(final.candidates) < 2:
            return final
        for k in range(len(final.candidates)):
            rest = self._rebuilt(final, k, first)
            if rest is not None and not self._is_worth_naming(rest, final):
                return self.without_idle(rest, first)
        return final

    def _is_worth_naming(self, rest: Explanation, final: Explanation) -> bool:
        """Whether a name stands out of the noise, and of what all names together leave."""
        return self.is_significant(rest, final) and stands_out_of_misfit(
            rest, final, len(self._candidates), self._false_alarm
        )

    def named(self, final: Explanation, first: Sequence[Explanation]) -> list[NamedCandidate]:
        """Each effect with the set that it belongs to."""
        found = []
        for k, candidate in enumerate(final.candidates):
            rest = self._rebuilt(final, k, first)
            if rest is not None:
                gain = rest.fit.chi_square - final.fit.chi_square
                rivals = self._rivals(final, candidate, self._alternatives(final, k, first))
                found.append(NamedCandidate(candidate, gain, rivals))
        return found

    def _alternatives(
        self, final: Explanation, k: int, first: Sequence[Explanation]
    ) -> list[Explanation]:
        """Explanations with another candidate in place of the ``k``-th."""
        candidate = final.candidates[k]
        if len(final.candidates) == 1:
            return [e for e in first if e.candidates[-1] is not candidate]
        rest = self._rebuilt(final, k, first)
        if rest is None:
            return []
        tried = [c for c in self._screened(rest, candidate) if c is not candidate]
        return self._contenders([self._fit(rest, c) for c in tried])

    def _rivals(
        self, final: Explanation, candidate: Candidate, alternatives: Sequence[Explanation]
    ) -> tuple[Explanation, ...]:
        """Alternatives that look alike; larger ones that hold this one and gain nothing are not."""
        near = []
        # Where something remains that no name explains, it blurs the difference as noise does.
        scale = misfit_scale(final.fit, self._false_alarm)
        for other in alternatives:
            if other.candidates[-1].label == candidate.label:
                continue
            if not are_alike(final, other, scale):
                continue
            more = other.parameters - final.parameters
            if more > 0 and not gains_more_than_chance(final, other, 1, self._false_alarm):
                continue
            near.append(other)
        return tuple(sorted(near, key=lambda e: -e.log_evidence))

    def _rebuilt(
        self, final: Explanation, without: int, first: Sequence[Explanation]
    ) -> Explanation | None:
        """The explanation without one of its candidates, fitted again."""
        rest = [c for k, c in enumerate(final.candidates) if k != without]
        if not rest:
            return self._nominal
        key = id(final), without
        if key not in self._rests:
            found = [reduced(self._nominal, final, [without])]
            found += [e for e in first if len(rest) == 1 and e.candidates[-1] is rest[0]]
            known = [e for e in found if e is not None]
            best = min(known, key=lambda e: e.fit.chi_square, default=None)
            self._rests[key] = final, best
        return self._rests[key][1]

    def _threshold(self, parameters: int) -> float:
        return gain_threshold(parameters, len(self._candidates), self._false_alarm)

    def _screened(self, base: Explanation, rival: Candidate | None = None) -> list[Candidate]:
        """Few candidates that promise to leave no more than the best of them, or a rival, does.

        Far from its optimum no candidate promises all that it keeps: a rival's promise is held
        against theirs. The last one that may be added must promise to stand out of what it leaves.
        """
        gains = self._promised(base)
        remains = left(base) - gains
        least = min(remains, default=0.0)
        if rival is not None:
            least = float(remains[self._candidates.index(rival)])
        needed = 0.0
        if len(base.candidates) == self._max_effects - 1:
            needed = WORTH_FITTING * self._least_ratio(base)
        order = [int(i) for i in np.argsort(gains)[::-1][:FITTED_AFTER_SCREENING]]
        return [
            self._candidates[i]
            for i in order
            if gains[i] > max(needed * remains[i], 0.0) and contends(remains[i], least)
        ]

    def _least_ratio(self, explanation: Explanation) -> float:
        return least_ratio(explanation.fit, 1, len(self._candidates), self._false_alarm)

    def _best_promise(self, base: Explanation) -> float:
        return float(np.max(self._promised(base), initial=0.0))

    def _promised(self, base: Explanation) -> FloatArray:
        """Gain that the derivatives promise, of each candidate; 0 of those that are in already."""
        if id(base) not in self._promises:
            self._promises[id(base)] = base, linear_gains(base, self._candidates)
        return self._promises[id(base)][1]

    def _fit(self, base: Explanation, candidate: Candidate) -> Explanation | None:
        key = id(base), id(candidate)
        if key not in self._fits:
            self._fits[key] = base, explain(base, candidate)
            self._report()
        return self._fits[key][1]

    def _report(self, surely_left: int = 0) -> None:
        """One fit more; ``surely_left`` are known to follow."""
        self._made += 1
        if self._progress is not None:
            self._progress(self._made, max(self._made + surely_left, len(self._candidates)))

    def _contenders(self, fits: Sequence[Explanation | None]) -> list[Explanation]:
        """Most probable first, the first few fitted to the end where they could be the best."""
        found = sorted((f for f in fits if f is not None), key=_evidence, reverse=True)
        if not found:
            return []
        best = found[0]
        for place, rough in enumerate(found[:CONTENDERS]):
            if contends(left(rough), left(best)):
                found[place] = self._to_the_end(rough)
                best = _better(best, found[place])
        return sorted(found, key=_evidence, reverse=True)

    def _to_the_end(self, rough: Explanation) -> Explanation:
        if id(rough) not in self._polished:
            fine = polished(rough)
            self._polished[id(rough)] = rough, fine
            self._polished[id(fine)] = fine, fine
        return self._polished[id(rough)][1]


def _evidence(explanation: Explanation) -> float:
    return explanation.log_evidence


def _better(a: Explanation, b: Explanation) -> Explanation:
    """The more probable one, the first if neither is."""
    return max(a, b, key=lambda e: e.log_evidence)


def _apart(explanations: Sequence[Explanation]) -> list[Explanation]:
    """Without those that look like one before them: what can be added to them does, too."""
    kept: list[Explanation] = []
    for explanation in explanations:
        if all(distance(explanation, other) >= ALIKE for other in kept):
            kept.append(explanation)
    return kept


def _distinct(explanations: Sequence[Explanation]) -> list[Explanation]:
    """One explanation for each set of names, the most probable."""
    seen: set[frozenset[str]] = set()
    kept = []
    for explanation in explanations:
        key = frozenset(explanation.names)
        if key not in seen:
            seen.add(key)
            kept.append(explanation)
    return kept
