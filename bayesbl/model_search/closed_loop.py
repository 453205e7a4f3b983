"""What a two-mass bench lacks, from recordings beside their simulation.

The view of the closed loop for :mod:`.linear`: derivatives of the simulation by everything unknown
and by every hypothesis, and bands of load orders in which anything may be off. Whitened residuals
are averaged over the rotations first, as all that repeats is in the average; what does not repeat
is noise. Beside a law of the shaft a tenth of its own signal, free in every band of every channel,
is always there: no real shaft follows the catalogue's laws to the last digit.

A linearisation holds near its fit. So sets are fitted in full from what it promises, the best of
them is linearised again, until nothing promises more; where a fit is far off, the whole range of
the gap is scanned too. The posterior is that of all sets that were fitted.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesbl.bench.effects import effect_named
from bayesbl.matching.least_squares import SimulatedFit, prior_pull
from bayesbl.matching.loop_noise import loop_noise
from bayesbl.matching.observed import Observed, whole_rotations
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.matching.predictive_check import BANDS, is_explained
from bayesbl.matching.signals import SimulatedSignals
from bayesbl.model_search.always_in import Beside, Direction, always_terms, beside, common_unknowns
from bayesbl.model_search.catalogue import Candidate
from bayesbl.model_search.constants import (
    FORM_SHARE,
    HOPEFUL_SHARE,
    LEAVES_MOST,
    MEAN_SHARE,
    NAMED_AT,
    SLACK,
    UNEXPLAINED_SHARE,
)
from bayesbl.model_search.linear import (
    DiscrepancyGroup,
    Linearised,
    MisfitBand,
    ModelPosterior,
    Term,
    confounded,
    even_probability,
    log_odds,
    search,
)
from bayesbl.model_search.refit import (
    Explanation,
    columns_of,
    from_afar,
    polished,
    promised,
    reduced,
    refit,
    with_own_noise,
)
from bayesbl.model_search.residuals import motor_orders
from bayesbl.progress import Progress, silent
from bayesbl.recording.types import FloatArray

CONTENDERS = 4
"""Sets that are fitted from one linearisation, the most promising."""

LOOP_COLUMNS = 10
"""Of the noise in the loop of one recording, the strongest."""

MOST_FITS = 16
MOST_ROUNDS = 4


@dataclass(eq=False)
class FittedSet:
    """A set of hypotheses at its fit.

    Attributes
    ----------
    log_evidence
        ln of its prior times evidence, anything beside it left out.
    posterior
        Of what is always beside it, and of the misfit.
    beyond
        χ² beyond noise of what repeats, by band, the mean first, (b,).
    """

    explanation: Explanation
    log_evidence: float
    posterior: ModelPosterior
    beyond: FloatArray

    @property
    def fit(self) -> SimulatedFit:
        """Of everything unknown."""
        return self.explanation.fit

    @property
    def excess(self) -> float:
        """χ² beyond noise of what repeats."""
        return max(float(self.beyond.sum()), 0.0)

    @property
    def misfits(self) -> FloatArray:
        """What of it lies in bands that have a misfit, (b,)."""
        return np.maximum(self.beyond, 0.0) * (np.array(self.posterior.models[0].scales) > 0.0)

    @property
    def misfit(self) -> float:
        """Of all bands."""
        return float(self.misfits.sum())

    def draws(self, generator: np.random.Generator, n: int) -> FloatArray:
        """Of everything unknown, with misfit and what is always beside it, (n, d), normal at the
        fit."""
        sd = np.sqrt(np.diag(self.fit.covariance))
        correlation = self.fit.covariance / np.outer(sd, sd)
        around = generator.multivariate_normal(np.zeros(sd.size), correlation, n, method="eigh")
        return np.asarray(self.fit.peak() + sd * around + self.posterior.draw(generator, n).shift)

    @cached_property
    def explains_all(self) -> bool:
        """Whether nothing repeats any more."""
        return is_explained(self.fit)


@dataclass(frozen=True, slots=True)
class NamedCandidate:
    """A name, with those that these recordings cannot tell from it.

    ``gain``: fall of χ² by it; ``indistinguishable``: others, each with the set that has it.
    """

    candidate: Candidate
    gain: float
    probability: float
    indistinguishable: tuple[tuple[Candidate, Explanation], ...] = ()

    @property
    def name(self) -> str:
        """Of the effect or parameter."""
        return self.candidate.name

    @property
    def members(self) -> tuple[str, ...]:
        """The set of names, the most probable first."""
        return tuple(dict.fromkeys((self.name, *(c.name for c, _ in self.indistinguishable))))


@dataclass(frozen=True, slots=True)
class Naming:
    """What a bench lacks.

    Attributes
    ----------
    nominal, final
        Before and after adding what is named; the same where nothing is. What was missing is no
        noise: the noise of ``final`` is estimated without it.
    sets
        All that were fitted, each with its probability.
    repeats
        Whether something repeats that nothing explains.
    nearest
        The most probable set, where it explains too little to be named.
    rest
        What stands beside ``final``: see :func:`name_missing`.
    """

    nominal: Explanation
    final: Explanation
    effects: tuple[NamedCandidate, ...]
    sets: tuple[tuple[FittedSet, float], ...]
    repeats: bool
    nearest: Explanation | None = None
    rest: Beside | None = None

    @property
    def others(self) -> list[tuple[FittedSet, float]]:
        """All but ``final``."""
        return [(own, p) for own, p in self.sets if own.explanation.keys != self.final.keys]

    @property
    def alone(self) -> list[FittedSet]:
        """Each candidate that was fitted alone, most probable first."""
        return [own for own, _ in self.sets if len(own.explanation.candidates) == 1]


def averaged(
    posterior: DirectPosterior,
    others: Sequence[tuple[FittedSet, float]],
    seed: np.random.SeedSequence,
    among: Sequence[Direction] = (),
) -> DirectPosterior:
    """Draws of all sets: each other one than that of ``posterior`` has its share, normal at its
    fit; of what only one of the two has, the draws stay.

    ``others``: each with its probability; ``among``: what is always beside each set, where the
    search had nothing there.
    """
    model = posterior.fit.model
    rng, draws = np.random.default_rng(seed), posterior.draws.reshape(-1, len(model.unknowns))
    draws, order = draws.copy(), rng.permutation(len(draws))
    for other, weight in others:
        if count := round(weight * len(draws)):
            rows, order = order[:count], order[count:]
            whole = weighed(other.explanation, among) if among else other
            common = sum(1 for _ in common_unknowns(model, other.fit.model))
            own = whole.draws(rng, count)[:, :common]
            draws[rows, :common] = np.clip(own, model.low[:common], model.high[:common])
    return posterior.with_model(draws)


def name_missing(
    nominal_fit: SimulatedFit,
    candidates: Callable[[Sequence[float]], Sequence[Candidate]],
    *,
    max_effects: int = 3,
    among: Sequence[Direction] = (),
    progress: Progress = silent,
) -> Naming:
    """The posterior over sets of candidates, and the names that it gives.

    What remains beside what is named, laws and drift is a law that no catalogue has. It is taken
    for a sum of all those that it has, each of its usual size times one factor that is learned, and
    of anything that repeats, alike over a band of load orders.

    Parameters
    ----------
    candidates
        All that come into question, given the motor orders that stand out. Orders are looked for
        again in what the best set leaves: they may have stood behind it.
    among
        What is always beside each set, beyond its unknowns; where nothing is, nothing is said of
        what stands beside ``final``.
    progress
        Called with (fits made, fits expected).
    """
    posterior = SetSearch(Explanation((), nominal_fit), candidates, max_effects, among, progress)
    naming = posterior.answer()
    return replace(naming, rest=posterior.beside(naming.final)) if among else naming


class SetSearch:
    """Sets that were fitted, from the nominal one on, and what they promise.

    Parameters as :func:`name_missing` takes them.
    """

    def __init__(
        self,
        nominal: Explanation,
        candidates: Callable[[Sequence[float]], Sequence[Candidate]],
        most: int,
        among: Sequence[Direction] = (),
        progress: Progress = silent,
    ) -> None:
        self._catalogue, self._most, self._among = candidates, most, among
        self._progress = progress
        # One noise for all sets, as the recorder's is; and its simulation is dear.
        self._noise = noise_in_loop(nominal.fit)
        self._candidates = {c.key: c for c in candidates(motor_orders(nominal.fit))}
        self._sets: dict[frozenset[tuple[str, float | None]], FittedSet] = {}
        self._explored: set[frozenset[tuple[str, float | None]]] = set()
        # As many hypotheses as there are at the start: those found later raise no odds.
        labels = {c.label for c in self._candidates.values()}
        self._probability = even_probability(len(labels))
        self.nominal = self._add(nominal)
        self._climb()

    @property
    def best(self) -> FittedSet:
        """The most probable set."""
        return max(self._sets.values(), key=lambda own: own.log_evidence)

    def _climb(self) -> None:
        """Fit what is promised, from the best set on, until nothing promises more."""
        for _ in range(MOST_ROUNDS):
            best = self.best
            self._find_orders(best)
            self._explore(best)
            if not best.explanation.candidates and self._is_far(self.best):
                self._scan()
            if self._is_hopeless():
                return
            self._shed()
            if self.best is not best:
                if self._stalls(best):
                    break
                continue
            # What was added first may only have stood in for what came after it.
            for less in list(self._reduced(best)):
                if len(self._sets) <= MOST_FITS:
                    self._explore(less)
            if self.best is best or len(self._sets) > MOST_FITS:
                break
        self._shed()

    def _shed(self) -> None:
        """Fit the best set less each of its hypotheses, until none does without one."""
        while True:
            best = self.best
            for _ in self._reduced(best):
                pass
            if self.best is best:
                return

    def _scan(self) -> None:
        """Candidates that move the gap, from their whole range and the gap's.

        Where laws and drift are beside the fit, only what may be large in one recording.
        """
        scanned = [
            c
            for c in self._candidates.values()
            if not self._among or (c.kind == "effect" and effect_named(c.name).may_change)
        ]
        for explanation in from_afar(self.nominal.explanation, scanned):
            self._add(polished(explanation))
            # Where another law is missing too, alone it is drawn away again.
            self._explore(weighed(explanation, self._among, self._noise))

    @property
    def sets(self) -> tuple[tuple[FittedSet, float], ...]:
        """All that were fitted, each with its probability, the most probable first."""
        fitted = sorted(self._sets.values(), key=lambda own: -own.log_evidence)
        weights = np.exp([own.log_evidence - fitted[0].log_evidence for own in fitted])
        return tuple(zip(fitted, (weights / weights.sum()).tolist(), strict=True))

    def answer(self) -> Naming:
        """Names by the one rule."""
        sets = self.sets
        first, _ = sets[0]
        nominal, best = self.nominal.explanation, first.explanation
        naming = Naming(nominal, nominal, (), sets, repeats=True)
        if not best.candidates:
            return replace(naming, repeats=not first.explains_all)
        if self._is_unexplained(first):
            return replace(naming, nearest=best)
        labels = [(frozenset(own.explanation.names), p) for own, p in sets]
        inclusion = {name: sum(p for own, p in labels if name in own) for name in best.names}
        certain = [name for name, p in inclusion.items() if p >= NAMED_AT]
        effects, idle = [], set(range(len(best.candidates)))
        for group in [*((name,) for name in certain), *confounded(labels, certain)]:
            place = next((k for k, name in enumerate(best.names) if name in group), None)
            if place is None:
                continue
            idle.discard(place)
            name, rest = best.names[place], self._without(first, place)
            gain = math.inf if rest is None else rest.fit.chi_square - first.fit.chi_square
            rivals = tuple(
                (c, own.explanation)
                for own, p in sets
                for c in own.explanation.candidates
                if c.label in group
                and name not in own.explanation.names
                and p > (1.0 - NAMED_AT) * 0.1
            )
            effects.append(NamedCandidate(best.candidates[place], gain, inclusion[name], rivals))
        final = (reduced(nominal, best, idle) if idle else best) or nominal
        return replace(
            naming,
            final=with_own_noise(final) if final.candidates else nominal,
            effects=tuple(effects),
            repeats=not effects and not self.nominal.explains_all,
        )

    def beside(self, explanation: Explanation) -> Beside:
        """Laws and drift beside a fit; where something remains, all other laws at once too."""
        rest = beside(explanation.fit, self._among)
        if rest.explains:
            return rest
        explanation = explanation.with_derivatives()
        view = self._linearised(explanation)
        laws = [t.columns * math.sqrt(t.prior_weight) for t in view.terms if not t.always]
        columns = np.hstack([view.discrepancy, *laws])
        group = DiscrepancyGroup("laws", slice(0, columns.shape[1]))
        always = [t for t in view.terms if t.always]
        whole = replace(view, terms=always, discrepancy=columns, groups=[group])
        return replace(rest, posterior=search(whole, 0))

    def _is_unexplained(self, own: FittedSet) -> bool:
        """What no hypothesis holds is more than a share of the disagreement beside the means: any
        friction holds these, and they may be nearly all of it."""
        share = own.misfits[1:].sum() / max(float(self.nominal.beyond[1:].sum()), 1e-300)
        return share > UNEXPLAINED_SHARE and not own.explains_all

    def _is_hopeless(self) -> bool:
        """Whether a few hypotheses more cannot hold nearly all, as none yet holds anything much."""
        least = min(own.misfit for own in self._sets.values())
        return least > (1.0 - HOPEFUL_SHARE) * self.nominal.excess

    def _stalls(self, before: FittedSet) -> bool:
        """Whether the best set holds next to nothing more than the last, and leaves much."""
        best = self.best
        return not best.explains_all and best.misfit > (1.0 - HOPEFUL_SHARE) * before.misfit

    def _is_far(self, own: FittedSet) -> bool:
        """Whether what a bench lacks may have drawn the gap away from where it is."""
        moving = any(observation.motion is not None for observation in own.fit.model.recordings)
        return not moving and self._is_unexplained(own)

    def _find_orders(self, own: FittedSet) -> None:
        """Orders that stood behind what is in the set."""
        if own.explanation.candidates and own.explanation.keys not in self._explored:
            late = {c.key: c for c in self._catalogue(motor_orders(own.fit))}
            self._candidates |= {k: c for k, c in late.items() if k not in self._candidates}

    def _reduced(self, own: FittedSet) -> Iterator[FittedSet]:
        for place in range(len(own.explanation.candidates)):
            rest = self._without(own, place)
            if rest is not None:
                yield rest

    def _without(self, own: FittedSet, place: int) -> FittedSet | None:
        """A set less one of its hypotheses."""
        keys = own.explanation.keys - {own.explanation.candidates[place].key}
        if keys not in self._sets:
            less = reduced(self.nominal.explanation, own.explanation, [place])
            if less is None:
                return None
            self._add(less)
        return self._sets[keys]

    def _explore(self, base: FittedSet) -> None:
        """Fit what a set promises beside itself."""
        keys = base.explanation.keys
        room = self._most - len(base.explanation.candidates)
        is_known = self._sets.get(keys) is base
        if room == 0 or (is_known and keys in self._explored):
            return
        if is_known:
            self._explored.add(keys)
        explanation = base.explanation.with_derivatives()
        view = self._linearised(explanation)
        offset = base.log_evidence - base.posterior.log_evidence
        labels = {c.label for c in self._candidates.values()}
        posterior = search(view, min(2, room), dict.fromkeys(labels, self._probability))
        gains = posterior.single_gains()
        excess = {k: base.excess - 2.0 * gain for k, gain in gains.items() if gain > 0.0}
        least = max(min(excess.values(), default=0.0), 0.0)
        contend = [(k,) for k in sorted(excess, key=lambda k: excess[k])]
        contend = [t for t in contend if excess[t[0]] < LEAVES_MOST * least + SLACK]
        best = self.best.log_evidence + math.log(1.0 - NAMED_AT)
        pairs = [
            terms
            for terms, p in posterior.sets.items()
            if len(terms) == 2 and offset + posterior.log_evidence + math.log(p) > best
        ]
        tried: set[frozenset[tuple[str, float | None]]] = set()
        for terms in (*contend, *pairs[:1]):
            added = [view.terms[i].source for i in terms]
            whole = keys | {candidate.key for candidate, _ in added}
            if whole in self._sets or whole in tried or len(tried) >= CONTENDERS + len(terms) - 1:
                continue
            tried.add(whole)
            sizes, shift = posterior.mean_of(terms)
            starts = [(c, promised(c, at, own)) for (c, at), own in zip(added, sizes, strict=True)]
            fitted = refit(explanation, starts, shift)
            if fitted is not None:
                self._add(fitted, base)

    def _add(self, explanation: Explanation, base: FittedSet | None = None) -> FittedSet:
        """A set with its evidence; the better one of two fits.

        ``base``: the set that a rough fit was promised beside. It is fitted to the end where it may
        have weight, if either that explains all or this holds much of what that leaves.
        """
        keys = explanation.keys
        own = self._weighed(explanation)
        if base is not None:
            near = own.log_evidence > self.best.log_evidence + math.log(1.0 - NAMED_AT)
            hopeful = base.explains_all or own.excess < (1.0 - HOPEFUL_SHARE) * base.excess
            if hopeful and (near or own.excess < LEAVES_MOST * self.best.excess):
                own = self._weighed(polished(explanation))
        if keys:
            self._progress(len(self._sets), max(len(self._sets), CONTENDERS + 2))
        known = self._sets.get(keys)
        if known is None or own.log_evidence > known.log_evidence:
            self._sets[keys] = own
        # Of all sets together the derivatives would fill the memory.
        for other in self._sets.values():
            if other is not self.best:
                other.explanation = other.explanation.without_derivatives()
        return self._sets[keys]

    def _weighed(self, explanation: Explanation) -> FittedSet:
        own = weighed(explanation, self._among, self._noise)
        own.log_evidence += log_odds(self._probability) * len(explanation.candidates)
        return own

    def _linearised(self, explanation: Explanation) -> Linearised:
        """The view at a fit: terms of all that may stand beside it, each from one of its starts."""
        terms: list[Term] = []
        simulated: dict[tuple[str, float | None], list[list[FloatArray]]] = {}
        for candidate in self._candidates.values():
            if any(own.bars(candidate) for own in explanation.candidates):
                continue
            starts = (candidate.neutral, *candidate.starts)
            by_start = self._columns(explanation.fit, candidate, simulated)
            for start, columns in zip(starts, by_start, strict=True):
                if not columns:
                    continue
                usual = np.resize(candidate.usual[candidate.amplitudes], len(columns))
                terms.append(
                    Term(
                        candidate.label,
                        np.stack(columns, axis=1) * usual,
                        positive=candidate.is_positive and len(columns) == 1,
                        excludes=self._excluded(candidate),
                        unit=usual,
                        source=(candidate, start),
                    )
                )
        looks = Counter(term.hypothesis for term in terms)
        terms = [replace(term, prior_weight=1.0 / looks[term.hypothesis]) for term in terms]
        return linearised(explanation, terms, self._among, self._noise)

    def _columns(
        self,
        fit: SimulatedFit,
        candidate: Candidate,
        simulated: dict[tuple[str, float | None], list[list[FloatArray]]],
    ) -> list[list[FloatArray]]:
        """Of one recording's candidate the rows of that recording, where all share the effect.

        So what is known of the recording has not changed in it.
        """
        if candidate.recording is None or candidate.is_periodic:
            return columns_of(fit, candidate)
        key = candidate.name, candidate.order
        if key not in simulated:
            # Its unknowns in one recording and everywhere are the same change there.
            shared = tuple(replace(u, recording=None) for u in candidate.unknowns)
            everywhere = replace(candidate, recording=None, unknowns=shared)
            simulated[key] = columns_of(fit, everywhere)
        place = [observation.name for observation in fit.model.recordings].index(
            candidate.recording
        )
        return [[fit.model.only_in(place, column) for column in own] for own in simulated[key]]

    def _excluded(self, candidate: Candidate) -> frozenset[str]:
        """Labels of what cannot stand beside a candidate."""
        names = {u.name for u in candidate.unknowns}
        return frozenset(
            other.label
            for other in self._candidates.values()
            if other.label != candidate.label
            if candidate.bars(other)
            # In all recordings and in one of them: as good as in two by themselves.
            or (
                None in (candidate.recording, other.recording)
                and names & {u.name for u in other.unknowns}
            )
        )


def weighed(
    explanation: Explanation,
    among: Sequence[Direction] = (),
    noise: Sequence[Sequence[FloatArray]] | None = None,
) -> FittedSet:
    """A set with its evidence, all sets taken to be as likely beforehand.

    ``among``: what is always beside it; ``noise``: in the loop, as :func:`noise_in_loop` of another
    fit has it.
    """
    view = linearised(explanation, (), among, noise)
    alone = search(view, 0)
    beyond = [float(np.sum(view.residual[band.rows] ** 2)) - band.freedom for band in view.bands]
    # Laplace's volume of what is added, beside that of everything in the posterior.
    k = sum(len(c.unknowns) for c in explanation.candidates)
    evidence = alone.log_evidence + explanation.log_prior + 0.5 * k * math.log(2.0 * math.pi)
    return FittedSet(explanation, evidence, alone, np.array(beyond))


def linearised(
    explanation: Explanation,
    terms: Sequence[Term],
    among: Sequence[Direction] = (),
    noise: Sequence[Sequence[FloatArray]] | None = None,
) -> Linearised:
    """The view at a fit: terms of whitened signals, (N, k) each, then what is always there."""
    fit = explanation.fit
    noise = noise_in_loop(fit) if noise is None else noise
    labels, columns = always_terms(fit, among) if among else ((), [])
    always = [label.term(by) for label, by in zip(labels, columns, strict=True)]
    forms = [f for c in explanation.candidates for f in _own_signal(explanation, c)]
    return _banded(fit, [*terms, *always], forms, noise)


def laws_of_shaft(explanation: Explanation) -> list[Candidate]:
    """What is added of torques over the twist, whose form a real joint has its own of."""
    return [
        c
        for c in explanation.candidates
        if c.kind == "effect" and "twist" in effect_named(c.name).depends_on
    ]


def _own_signal(explanation: Explanation, candidate: Candidate) -> Iterator[FloatArray]:
    """What a law of the shaft does to the whitened signals, (N,); nothing of anything else."""
    if candidate not in laws_of_shaft(explanation):
        return
    fit = explanation.fit
    point, at = fit.point.copy(), np.array(explanation.places(candidate))
    point[at[candidate.amplitudes]] = candidate.neutral[candidate.amplitudes]
    signal = fit.model.whitened(point)[0] - fit.residual
    if np.all(np.isfinite(signal)):
        yield signal


def _banded(
    fit: SimulatedFit,
    terms: Sequence[Term],
    forms: Sequence[FloatArray],
    noise: Sequence[Sequence[FloatArray]],
) -> Linearised:
    """Derivatives, terms and residual of a fit by bands of load orders.

    Of ``forms``, (N,) each, a term more for every piece of a band and channel of a recording. Only
    inner products matter: a triangle has those of all rows.
    """
    model, d = fit.model, fit.point.size
    widths = [term.columns.shape[1] for term in terms]
    # What the end of its range has stopped goes no further, whatever would explain more there.
    stopped = (fit.point <= model.low) | (fit.point >= model.high)
    pull = np.where(stopped, 0.0, prior_pull(model, fit.point))
    columns = [fit.derivatives(), *(term.columns for term in terms)]
    columns += [signal[:, None] for signal in (*forms, fit.residual)]
    size, own = sum(part.shape[1] for part in columns), len(forms)
    total = np.zeros((size, size))
    pieces: list[list[FloatArray]] = [[] for _ in BANDS]
    ends = np.cumsum([0, *(part.size for part in model.by_recording(fit.residual))])
    for observation, (begin, end) in zip(model.recordings, itertools.pairwise(ends), strict=True):
        # One recording after the other: all columns of all of them once more would fill the memory.
        rows = np.hstack([part[begin:end] for part in columns])
        rows[:, :d][:, stopped] = 0.0
        total += rows.T @ rows
        channels = rows.reshape(len(observation.signals), -1, size)
        for channel in channels:
            for place, piece in enumerate(
                _by_band(channel[observation.first_compared :], observation)
            ):
                pieces[place].append(piece)
    first = d + sum(widths)
    several = sum(len(band) for band in pieces)
    count = noise[0][0].shape[1] if noise else 0
    usual = {BANDS[0]: MEAN_SHARE * _largest_line(model)}
    blocks, bands, begin, at = [], [], 0, 0
    for place, (highest, band) in enumerate(zip(BANDS, pieces, strict=True)):
        stacked = []
        for piece, around in itertools.zip_longest(band, noise[place] if noise else ()):
            total -= piece.T @ piece
            form = np.zeros((len(piece), several * own))
            form[:, at * own : (at + 1) * own] = FORM_SHARE * piece[:, first : first + own]
            at += 1
            by_loop = np.zeros((len(piece), 0)) if around is None else around
            stacked.append(np.hstack([piece[:, :first], form, by_loop, piece[:, -1:]]))
        rows = np.concatenate(stacked)
        freedom = len(rows)
        if freedom > rows.shape[1]:
            rows = np.asarray(np.linalg.qr(rows, mode="r"))
        if len(rows):
            own_rows = slice(begin, begin + len(rows))
            kind, size_of = f"load orders up to {highest}", usual.get(highest, math.inf)
            bands.append(MisfitBand(kind, own_rows, freedom, size_of))
            blocks.append(rows)
            begin += len(rows)
    kept = [*range(first), size - 1]
    values, vectors = np.linalg.eigh(total[np.ix_(kept, kept)])
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    rest = np.hstack([root[:, :-1], np.zeros((len(root), several * own + count)), root[:, -1:]])
    view = np.concatenate([*blocks, rest])
    ends = d + np.cumsum([0, *widths])
    pairs = zip(terms, itertools.pairwise(ends), strict=True)
    banded = [replace(term, columns=view[:, a:b]) for term, (a, b) in pairs]
    banded += [
        Term("always", view[:, k : k + 1], always=True) for k in range(first, view.shape[1] - 1)
    ]
    return Linearised(
        view[:, -1],
        view[:, :d],
        model.prior_precision(),
        pull,
        banded,
        np.zeros((len(view), 0)),
        bands=bands,
    )


def _largest_line(model: SimulatedSignals) -> float:
    """Of the whitened channels beside their means, in the mean rotation's units: the median."""
    largest = []
    for observation, noise in zip(model.recordings, model.noise, strict=True):
        for row in noise.whiten(observation.signals):
            _, *bands = _by_band(row[observation.first_compared :, None], observation)
            largest.append(max((float(np.abs(b).max()) for b in bands if len(b)), default=0.0))
    return max(float(np.median(largest)), 1.0)


def noise_in_loop(fit: SimulatedFit) -> list[list[FloatArray]]:
    """Columns of noise that goes round the loop, where it has more variance than the linear loop
    makes of it, by band, recording and channel; empty without such noise.

    A column of standard normal size is a covariance of its outer product. In the mean rotation
    noise has the covariance that it has in each.
    """
    model = fit.model
    made: list[tuple[int, FloatArray]] = []
    for place, observation in enumerate(model.recordings):
        loop = loop_noise(fit, place)
        if loop is not None:
            rows = (loop.around - loop.linear).reshape(
                len(loop.around), len(observation.signals), -1
            )
            scale = math.sqrt(float(loop.shares.mean()) / len(rows))
            made.append((place, scale * rows))
    if not made:
        return []
    columns: list[list[FloatArray]] = [[] for _ in BANDS]
    width = LOOP_COLUMNS * len(made)
    by_place = dict(made)
    for place, observation in enumerate(model.recordings):
        around = by_place.get(place)
        bands: list[FloatArray] = []
        for channel in range(len(observation.signals)):
            length = observation.lag if around is None else around.shape[2]
            own = np.zeros((length, 1)) if around is None else around[:, channel].T
            bands += list(_spectral_bands(own, observation))
        stacked = np.concatenate(bands)
        out = np.zeros((len(stacked), width))
        if around is not None:
            at = LOOP_COLUMNS * [p for p, _ in made].index(place)
            basis, sizes, _ = np.linalg.svd(stacked, full_matrices=False)
            most = min(LOOP_COLUMNS, sizes.size)
            out[:, at : at + most] = basis[:, :most] * sizes[:most]
        begin = 0
        for k, band in enumerate(bands):
            columns[k % len(BANDS)].append(out[begin : begin + len(band)])
            begin += len(band)
    return columns


def _by_band(rows: FloatArray, observation: Observed) -> Iterator[FloatArray]:
    """Of whitened rows (n, p) the mean rotation by bands of load orders, noise alike in each.

    A motion that does not repeat counts as one rotation, in cycles a quarter of it.
    """
    lag = observation.lag if observation.repeats else len(rows)
    turns = whole_rotations(rows, lag)
    yield from _spectral_bands(turns.sum(axis=0) / math.sqrt(len(turns)), observation)


def _spectral_bands(mean: FloatArray, observation: Observed) -> Iterator[FloatArray]:
    """Of a rotation (lag, p) by bands of load orders, (k, p) each."""
    spectrum = np.fft.rfft(mean, axis=0) / math.sqrt(len(mean))
    yield spectrum[:1].real
    below = 1
    for highest in BANDS[1:]:
        end = min(highest if observation.repeats else 4 * highest, len(spectrum) - 2) + 1
        band = spectrum[below : max(end, below)] * math.sqrt(2.0)
        yield np.concatenate([band.real, band.imag])
        below = max(end, below)
