"""Find what a two-mass bench lacks, by comparing recordings with their simulation.

This is the closed-loop view for :mod:`.linear`: derivatives of the simulation by all unknowns and
hypotheses, and bands of load orders in which anything may be wrong. Whitened residuals are first
averaged over the rotations: the mean holds all that repeats, and the rest is noise. No real shaft
follows the catalogue's laws exactly. So each shaft law comes with free errors of a tenth of its own
signal, in every band of every channel.

A linearisation holds near its fit. So the sets that it promises are fitted in full and the best is
linearised again, until nothing promises more. If a fit is far off, the whole range of the gap is
scanned too. The posterior covers all fitted sets.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
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
from bayesbl.model_search.always_in import (
    Direction,
    LinearisedFit,
    always_terms,
    common_unknowns,
    linearised_fit,
)
from bayesbl.model_search.catalogue import Candidate, CandidateKey
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
"""Number of sets fitted from one linearisation, the most promising."""

LOOP_COLUMNS = 10
"""Number of columns for one recording's noise in the loop, the strongest."""

MOST_FITS = 16
MOST_ROUNDS = 4


@dataclass(eq=False)
class FittedSet:
    """A set of hypotheses at its fit.

    ``log_evidence``: ln of prior times evidence, without terms that are not in the set;
    ``posterior``: posterior of the terms always included, and of the misfit; ``excess_by_band``: χ²
    beyond noise of the repeating part, by band, the mean first, (b,); ``nuisances``: directions
    that are marginalised.
    """

    explanation: Explanation
    log_evidence: float
    posterior: ModelPosterior
    excess_by_band: FloatArray
    nuisances: Sequence[Direction] = ()

    @property
    def fit(self) -> SimulatedFit:
        """Fit of all unknowns."""
        return self.explanation.fit

    @property
    def excess(self) -> float:
        """χ² beyond noise of the repeating part."""
        return max(float(self.excess_by_band.sum()), 0.0)

    @property
    def misfits(self) -> FloatArray:
        """Excess χ² of the bands that have a misfit, (b,)."""
        return np.maximum(self.excess_by_band, 0.0) * (
            np.array(self.posterior.models[0].scales) > 0.0
        )

    @property
    def misfit(self) -> float:
        """Sum of ``misfits``."""
        return float(self.misfits.sum())

    def draws(self, generator: np.random.Generator, n: int) -> FloatArray:
        """Draws of all unknowns, (n, d), normal at the fit, with misfit and linear terms."""
        sd = np.sqrt(np.diag(self.fit.covariance))
        correlation = self.fit.covariance / np.outer(sd, sd)
        scatter = generator.multivariate_normal(np.zeros(sd.size), correlation, n, method="eigh")
        return np.asarray(self.fit.peak() + sd * scatter + self.posterior.draw(generator, n).shift)

    @cached_property
    def explains_all(self) -> bool:
        """Whether nothing unexplained repeats beside the marginalised terms."""
        if not self.nuisances:
            return is_explained(self.fit)
        return linearised_fit(self.fit, self.nuisances).explains


@dataclass(frozen=True, slots=True)
class NamedCandidate:
    """A named hypothesis, with those that these recordings cannot distinguish from it.

    ``gain``: its reduction of χ²; ``indistinguishable``: the others, each with a set that has it.
    """

    candidate: Candidate
    gain: float
    probability: float
    indistinguishable: tuple[tuple[Candidate, Explanation], ...] = ()

    @property
    def name(self) -> str:
        """Name of the effect or parameter."""
        return self.candidate.name

    @property
    def members(self) -> tuple[str, ...]:
        """Its name and those indistinguishable from it, the most probable first."""
        return tuple(dict.fromkeys((self.name, *(c.name for c, _ in self.indistinguishable))))


@dataclass(frozen=True, slots=True)
class Naming:
    """What a bench lacks.

    Attributes
    ----------
    nominal, final
        Fits before and after adding what is named; the same if nothing is. The noise of ``final``
        is estimated from its own residuals.
    sets
        All fitted sets, each with its probability.
    repeats
        Whether something unexplained repeats.
    nearest
        The most probable set, if it explains too little to be named.
    linear_fit
        Terms linearised at ``final``: see :func:`name_missing`.
    """

    nominal: Explanation
    final: Explanation
    effects: tuple[NamedCandidate, ...]
    sets: tuple[tuple[FittedSet, float], ...]
    repeats: bool
    nearest: Explanation | None = None
    linear_fit: LinearisedFit | None = None

    @property
    def others(self) -> list[tuple[FittedSet, float]]:
        """All sets but ``final``."""
        return [(entry, p) for entry, p in self.sets if entry.explanation.keys != self.final.keys]


def averaged(
    posterior: DirectPosterior,
    others: Sequence[tuple[FittedSet, float]],
    seed: np.random.SeedSequence,
    nuisances: Sequence[Direction] = (),
) -> DirectPosterior:
    """Average the draws over all sets, each with its share, normal at its fit.

    Unknowns that only one of two sets has keep their draws. ``others``: sets with their
    probabilities; ``nuisances``: directions to marginalise in each set, if the search did not do
    so.
    """
    model = posterior.fit.model
    rng, draws = np.random.default_rng(seed), posterior.draws.reshape(-1, len(model.unknowns))
    draws, order = draws.copy(), rng.permutation(len(draws))
    for rival, weight in others:
        if count := round(weight * len(draws)):
            rows, order = order[:count], order[count:]
            reweighed = weighed(rival.explanation, nuisances) if nuisances else rival
            common = sum(1 for _ in common_unknowns(model, rival.fit.model))
            rival_draws = reweighed.draws(rng, count)[:, :common]
            draws[rows, :common] = np.clip(rival_draws, model.low[:common], model.high[:common])
    return posterior.with_model(draws)


def name_missing(
    nominal_fit: SimulatedFit,
    candidates: Callable[[Sequence[float]], Sequence[Candidate]],
    *,
    max_effects: int = 3,
    nuisances: Sequence[Direction] = (),
    progress: Progress = silent,
) -> Naming:
    """Compute the posterior over sets of candidates, and name hypotheses from it.

    A law outside the catalogue may remain unexplained. It is modelled as a sum of all laws of the
    catalogue, their usual sizes times one learned factor, and of anything that repeats, equally
    over a band of load orders.

    Parameters
    ----------
    candidates
        Makes all candidates from the motor orders that stand out. Orders are sought again in the
        residual of the best set, which may have hidden them.
    nuisances
        Directions marginalised in each set. If empty, ``linear_fit`` of the result is ``None``.
    progress
        Called with (fits made, fits expected).
    """
    posterior = SetSearch(
        Explanation((), nominal_fit), candidates, max_effects, nuisances, progress
    )
    naming = posterior.answer()
    return (
        replace(naming, linear_fit=posterior.linearised_fit(naming.final)) if nuisances else naming
    )


class SetSearch:
    """Search over fitted sets, from the nominal one on.

    Parameters as :func:`name_missing` takes them.
    """

    def __init__(
        self,
        nominal: Explanation,
        candidates: Callable[[Sequence[float]], Sequence[Candidate]],
        max_size: int,
        nuisances: Sequence[Direction] = (),
        progress: Progress = silent,
    ) -> None:
        self._catalogue, self._max_size, self._nuisances = candidates, max_size, nuisances
        self._progress = progress
        # All sets share the recorder's noise, and its simulation is expensive.
        self._noise = noise_in_loop(nominal.fit)
        self._candidates = {c.key: c for c in candidates(motor_orders(nominal.fit))}
        self._sets: dict[frozenset[CandidateKey], FittedSet] = {}
        self._explored: set[frozenset[CandidateKey]] = set()
        # The initial number of hypotheses: later ones do not change the odds.
        labels = {c.label for c in self._candidates.values()}
        self._probability = even_probability(len(labels))
        self.nominal = self._add(nominal)
        self._climb()

    @property
    def best(self) -> FittedSet:
        """The most probable set."""
        return max(self._sets.values(), key=lambda entry: entry.log_evidence)

    def _climb(self) -> None:
        """Fit what the best set promises, until nothing promises more."""
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
            # An early candidate may only have replaced a later one.
            for smaller in list(self._reduced(best)):
                if len(self._sets) <= MOST_FITS:
                    self._explore(smaller)
            if self.best is best or len(self._sets) > MOST_FITS:
                break
        self._shed()

    def _shed(self) -> None:
        """Fit the best set without each of its hypotheses, until none can be left out."""
        while True:
            best = self.best
            for _ in self._reduced(best):
                pass
            if self.best is best:
                return

    def _scan(self) -> None:
        """Fit candidates that move the gap, from scans of their whole range and the gap's.

        If laws and drift are marginalised, only effects that may be large in one recording are
        scanned.
        """
        scanned = [
            c
            for c in self._candidates.values()
            if not self._nuisances or (c.kind == "effect" and effect_named(c.name).may_change)
        ]
        for explanation in from_afar(self.nominal.explanation, scanned):
            self._add(polished(explanation))
            # If another law is missing too, a fit of this one alone is drawn away again.
            self._explore(weighed(explanation, self._nuisances, self._noise))

    @property
    def sets(self) -> tuple[tuple[FittedSet, float], ...]:
        """All fitted sets, each with its probability, the most probable first."""
        return with_probabilities(self._sets.values())

    def answer(self) -> Naming:
        """Name hypotheses by the threshold on their probability."""
        sets = self.sets
        best_set, _ = sets[0]
        nominal, best = self.nominal.explanation, best_set.explanation
        naming = Naming(nominal, nominal, (), sets, repeats=True)
        if not best.candidates:
            return replace(naming, repeats=not best_set.explains_all)
        if self._is_unexplained(best_set):
            return replace(naming, nearest=best)
        labels = [(frozenset(entry.explanation.names), p) for entry, p in sets]
        inclusion = {name: sum(p for names, p in labels if name in names) for name in best.names}
        certain = [name for name, p in inclusion.items() if p >= NAMED_AT]
        effects, unneeded = [], set(range(len(best.candidates)))
        for group in [*((name,) for name in certain), *confounded(labels, certain)]:
            index = next((k for k, name in enumerate(best.names) if name in group), None)
            if index is None:
                continue
            unneeded.discard(index)
            name, smaller = best.names[index], self._without(best_set, index)
            gain = math.inf if smaller is None else smaller.fit.chi_square - best_set.fit.chi_square
            rivals = tuple(
                (c, entry.explanation)
                for entry, p in sets
                for c in entry.explanation.candidates
                if c.label in group
                and name not in entry.explanation.names
                and p > (1.0 - NAMED_AT) * 0.1
            )
            effects.append(NamedCandidate(best.candidates[index], gain, inclusion[name], rivals))
        final = (reduced(nominal, best, unneeded) if unneeded else best) or nominal
        return replace(
            naming,
            final=with_own_noise(final) if final.candidates else nominal,
            effects=tuple(effects),
            repeats=not effects and not self.nominal.explains_all,
        )

    def linearised_fit(self, explanation: Explanation) -> LinearisedFit:
        """Linearise laws and drift at a fit; with a misfit, all other laws together too."""
        linear_fit = linearised_fit(explanation.fit, self._nuisances)
        if linear_fit.explains:
            return linear_fit
        explanation = explanation.with_derivatives()
        view = self._linearised(explanation)
        laws = [t.columns * math.sqrt(t.prior_weight) for t in view.terms if not t.always]
        columns = np.hstack([view.discrepancy, *laws])
        group = DiscrepancyGroup("laws", slice(0, columns.shape[1]))
        always = [t for t in view.terms if t.always]
        extended_view = replace(view, terms=always, discrepancy=columns, groups=[group])
        return replace(linear_fit, posterior=search(extended_view, 0))

    def _is_unexplained(self, fitted: FittedSet) -> bool:
        """Whether the share of the disagreement that no hypothesis explains is too large.

        Means are left out: any friction explains them, and they may be nearly all of it.
        """
        share = fitted.misfits[1:].sum() / max(float(self.nominal.excess_by_band[1:].sum()), 1e-300)
        return share > UNEXPLAINED_SHARE and not fitted.explains_all

    def _is_hopeless(self) -> bool:
        """Whether no set explains enough yet for a few more hypotheses to explain nearly all."""
        least = min(entry.misfit for entry in self._sets.values())
        return least > (1.0 - HOPEFUL_SHARE) * self.nominal.excess

    def _stalls(self, previous: FittedSet) -> bool:
        """Whether the best set explains hardly more than the last one, and leaves much."""
        best = self.best
        return best.misfit > (1.0 - HOPEFUL_SHARE) * previous.misfit and not best.explains_all

    def _is_far(self, fitted: FittedSet) -> bool:
        """Whether a missing effect may have drawn the gap far away."""
        moving = any(observation.motion is not None for observation in fitted.fit.model.recordings)
        return not moving and self._is_unexplained(fitted)

    def _find_orders(self, fitted: FittedSet) -> None:
        """Add candidates at motor orders that the set's hypotheses had hidden."""
        if fitted.explanation.candidates and fitted.explanation.keys not in self._explored:
            for candidate in self._catalogue(motor_orders(fitted.fit)):
                self._candidates.setdefault(candidate.key, candidate)

    def _reduced(self, fitted: FittedSet) -> Iterator[FittedSet]:
        for index in range(len(fitted.explanation.candidates)):
            smaller = self._without(fitted, index)
            if smaller is not None:
                yield smaller

    def _without(self, fitted: FittedSet, index: int) -> FittedSet | None:
        """A set without one of its hypotheses."""
        keys = fitted.explanation.keys - {fitted.explanation.candidates[index].key}
        if keys not in self._sets:
            smaller = reduced(self.nominal.explanation, fitted.explanation, [index])
            if smaller is None:
                return None
            self._add(smaller)
        return self._sets[keys]

    def _explore(self, base: FittedSet) -> None:
        """Fit the extensions that a set promises."""
        keys = base.explanation.keys
        room = self._max_size - len(base.explanation.candidates)
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
        contenders = [(k,) for k in sorted(excess, key=lambda k: excess[k])]
        contenders = [t for t in contenders if excess[t[0]] < LEAVES_MOST * least + SLACK]
        best = self.best.log_evidence + math.log(1.0 - NAMED_AT)
        pairs = [
            terms
            for terms, p in posterior.sets.items()
            if len(terms) == 2 and offset + posterior.log_evidence + math.log(p) > best
        ]
        tried: set[frozenset[CandidateKey]] = set()
        for terms in (*contenders, *pairs[:1]):
            added = [view.terms[i].source for i in terms]
            extended_keys = keys | {candidate.key for candidate, _ in added}
            if (
                extended_keys in self._sets
                or extended_keys in tried
                or len(tried) >= CONTENDERS + len(terms) - 1
            ):
                continue
            tried.add(extended_keys)
            sizes, shift = posterior.mean_of(terms)
            starts = [
                (c, promised(c, start, size)) for (c, start), size in zip(added, sizes, strict=True)
            ]
            fitted = refit(explanation, starts, shift)
            if fitted is not None:
                self._add(fitted, base)

    def _add(self, explanation: Explanation, base: FittedSet | None = None) -> FittedSet:
        """Add a set with its evidence; of two fits, keep the better.

        ``base``: the set whose linearisation promised this rough fit. The fit is completed if the
        set may have weight, and if either ``base`` explains everything or this set explains much of
        the excess of ``base``.
        """
        keys = explanation.keys
        fitted = self._weighed(explanation)
        if base is not None:
            is_likely = fitted.log_evidence > self.best.log_evidence + math.log(1.0 - NAMED_AT)
            hopeful = fitted.excess < (1.0 - HOPEFUL_SHARE) * base.excess or base.explains_all
            if hopeful and (is_likely or fitted.excess < LEAVES_MOST * self.best.excess):
                fitted = self._weighed(polished(explanation))
        if keys:
            self._progress(len(self._sets), max(len(self._sets), CONTENDERS + 2))
        previous = self._sets.get(keys)
        if previous is None or fitted.log_evidence > previous.log_evidence:
            self._sets[keys] = fitted
        # The Jacobians of all sets together would fill the memory.
        for entry in self._sets.values():
            if entry is not self.best:
                entry.explanation = entry.explanation.without_derivatives()
        return self._sets[keys]

    def _weighed(self, explanation: Explanation) -> FittedSet:
        fitted = weighed(explanation, self._nuisances, self._noise)
        fitted.log_evidence += log_odds(self._probability) * len(explanation.candidates)
        return fitted

    def _linearised(self, explanation: Explanation) -> Linearised:
        """The view at a fit: one term for each compatible candidate and start."""
        terms: list[Term] = []
        # Alike in all recordings and in one: neighbours find each other's simulations in the cache.
        for candidate in sorted(self._candidates.values(), key=lambda c: (c.name, c.order or 0.0)):
            if any(member.bars(candidate) for member in explanation.candidates):
                continue
            starts = (candidate.neutral, *candidate.starts)
            by_start = columns_of(explanation.fit, candidate)
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
        form_counts = Counter(term.hypothesis for term in terms)
        terms = [replace(term, prior_weight=1.0 / form_counts[term.hypothesis]) for term in terms]
        return linearised(explanation, terms, self._nuisances, self._noise)

    def _excluded(self, candidate: Candidate) -> frozenset[str]:
        """Labels of hypotheses that cannot be in one set with a candidate."""
        names = {u.name for u in candidate.unknowns}
        return frozenset(
            other.label
            for other in self._candidates.values()
            if other.label != candidate.label
            if candidate.bars(other)
            # An effect in all recordings and in one is as good as one in each of two.
            or (
                None in (candidate.recording, other.recording)
                and names & {u.name for u in other.unknowns}
            )
        )


def with_probabilities(sets: Iterable[FittedSet]) -> tuple[tuple[FittedSet, float], ...]:
    """Fitted sets, each with its probability, the most probable first."""
    fitted = sorted(sets, key=lambda entry: -entry.log_evidence)
    weights = np.exp([entry.log_evidence - fitted[0].log_evidence for entry in fitted])
    return tuple(zip(fitted, (weights / weights.sum()).tolist(), strict=True))


def weighed(
    explanation: Explanation,
    nuisances: Sequence[Direction] = (),
    noise: Sequence[Sequence[FloatArray]] | None = None,
) -> FittedSet:
    """Compute the evidence of a set, with equal prior odds for all sets.

    ``nuisances``: directions to marginalise; ``noise``: in the loop, as :func:`noise_in_loop` made
    it at another fit.
    """
    view = linearised(explanation, (), nuisances, noise)
    posterior = search(view, 0)
    beyond = [float(np.sum(view.residual[band.rows] ** 2)) - band.freedom for band in view.bands]
    evidence = posterior.log_evidence + explanation.log_prior
    # The prior of a candidate's unknowns replaces the normal one that the view has for them.
    unknowns = (u for c in explanation.candidates for u in c.unknowns)
    evidence += sum(math.log(math.sqrt(2.0 * math.pi) * u.prior_sd) for u in unknowns)
    return FittedSet(explanation, evidence, posterior, np.array(beyond), nuisances)


def linearised(
    explanation: Explanation,
    terms: Sequence[Term],
    nuisances: Sequence[Direction] = (),
    noise: Sequence[Sequence[FloatArray]] | None = None,
) -> Linearised:
    """The view at a fit: terms of whitened signals, (N, k) each, then those always included."""
    fit = explanation.fit
    noise = noise_in_loop(fit) if noise is None else noise
    labels, columns = always_terms(fit, nuisances) if nuisances else ((), [])
    always = [
        label.term(term_columns, fit.model.bench)
        for label, term_columns in zip(labels, columns, strict=True)
    ]
    forms = [f for c in explanation.candidates for f in _own_signal(explanation, c)]
    return _banded(fit, [*terms, *always], forms, noise)


def laws_of_shaft(explanation: Explanation) -> list[Candidate]:
    """Candidates that are torques over the twist: a real joint has its own form of these laws."""
    return [
        c
        for c in explanation.candidates
        if c.kind == "effect" and "twist" in effect_named(c.name).depends_on
    ]


def _own_signal(explanation: Explanation, candidate: Candidate) -> Iterator[FloatArray]:
    """Effect of a shaft law on the whitened signals, (N,); nothing for other candidates."""
    if candidate not in laws_of_shaft(explanation):
        return
    fit = explanation.fit
    point, indices = fit.point.copy(), np.array(explanation.places(candidate))
    point[indices[candidate.amplitudes]] = candidate.neutral[candidate.amplitudes]
    signal = fit.model.whitened(point)[0] - fit.residual
    if np.all(np.isfinite(signal)):
        yield signal


def _banded(
    fit: SimulatedFit,
    terms: Sequence[Term],
    forms: Sequence[FloatArray],
    noise: Sequence[Sequence[FloatArray]],
) -> Linearised:
    """Jacobian, terms and residual of a fit by bands of load orders.

    Each of ``forms``, (N,), gets one more term for every band and channel of a recording. Only
    inner products matter, so R factors replace the rows.
    """
    model, d = fit.model, fit.point.size
    widths = [term.columns.shape[1] for term in terms]
    # An unknown stopped by the end of its range moves no further, whatever that would explain.
    at_bound = (fit.point <= model.low) | (fit.point >= model.high)
    pull = np.where(at_bound, 0.0, prior_pull(model, fit.point))
    columns = [fit.derivatives(), *(term.columns for term in terms)]
    columns += [signal[:, None] for signal in (*forms, fit.residual)]
    size, form_count = sum(part.shape[1] for part in columns), len(forms)
    total = np.zeros((size, size))
    pieces: list[list[FloatArray]] = [[] for _ in BANDS]
    ends = np.cumsum([0, *(part.size for part in model.by_recording(fit.residual))])
    for observation, (begin, end) in zip(model.recordings, itertools.pairwise(ends), strict=True):
        # One recording at a time: a second copy of all columns would fill the memory.
        rows = np.hstack([part[begin:end] for part in columns])
        rows[:, :d][:, at_bound] = 0.0
        total += rows.T @ rows
        channels = rows.reshape(len(observation.signals), -1, size)
        for channel in channels:
            for band_index, piece in enumerate(
                _by_band(channel[observation.first_compared :], observation)
            ):
                pieces[band_index].append(piece)
    form_start = d + sum(widths)
    piece_count = sum(len(band) for band in pieces)
    loop_count = noise[0][0].shape[1] if noise else 0
    usual = {BANDS[0]: MEAN_SHARE * _largest_line(model)}
    blocks, bands, begin, piece_index = [], [], 0, 0
    for band_index, (highest, band) in enumerate(zip(BANDS, pieces, strict=True)):
        stacked = []
        for piece, loop_columns in itertools.zip_longest(band, noise[band_index] if noise else ()):
            total -= piece.T @ piece
            own_forms = FORM_SHARE * piece[:, form_start : form_start + form_count]
            form = np.kron(np.eye(piece_count)[piece_index], own_forms)
            piece_index += 1
            by_loop = np.zeros((len(piece), 0)) if loop_columns is None else loop_columns
            stacked.append(np.hstack([piece[:, :form_start], form, by_loop, piece[:, -1:]]))
        rows = np.concatenate(stacked)
        freedom = len(rows)
        if freedom > rows.shape[1]:
            rows = np.asarray(np.linalg.qr(rows, mode="r"))
        if len(rows):
            own_rows = slice(begin, begin + len(rows))
            kind, usual_size = f"load orders up to {highest}", usual.get(highest, math.inf)
            bands.append(MisfitBand(kind, own_rows, freedom, usual_size))
            blocks.append(rows)
            begin += len(rows)
    kept = [*range(form_start), size - 1]
    values, vectors = np.linalg.eigh(total[np.ix_(kept, kept)])
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    remainder = np.hstack(
        [root[:, :-1], np.zeros((len(root), piece_count * form_count + loop_count)), root[:, -1:]]
    )
    view = np.concatenate([*blocks, remainder])
    ends = d + np.cumsum([0, *widths])
    pairs = zip(terms, itertools.pairwise(ends), strict=True)
    banded = [replace(term, columns=view[:, a:b]) for term, (a, b) in pairs]
    banded += [
        Term("always", view[:, k : k + 1], always=True)
        for k in range(form_start, view.shape[1] - 1)
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
    """Median over the whitened channels of their largest line, in units of the mean rotation."""
    largest = []
    for observation, noise in zip(model.recordings, model.noise, strict=True):
        for row in noise.whiten(observation.signals):
            _, *bands = _by_band(row[observation.first_compared :, None], observation)
            largest.append(max((float(np.abs(b).max()) for b in bands if len(b)), default=0.0))
    return max(float(np.median(largest)), 1.0)


def noise_in_loop(fit: SimulatedFit) -> list[list[FloatArray]]:
    """Columns of noise fed back by the loop, by band, recording and channel; empty without any.

    They hold its variance beyond that of the linear loop. A column with a standard normal size adds
    the covariance of its outer product. Noise has the same covariance in the mean rotation as in
    each.
    """
    recordings = fit.model.recordings
    loops = [loop_noise(fit, index) for index in range(len(recordings))]
    count = sum(loop is not None for loop in loops)
    if not count:
        return []
    columns: list[list[FloatArray]] = [[] for _ in BANDS]
    first_column = 0
    for observation, loop in zip(recordings, loops, strict=True):
        channels = len(observation.signals)
        excess = np.zeros((1, channels, observation.lag))
        if loop is not None:
            excess = np.concatenate(loop.fed_back - loop.linear)
            excess = excess.reshape(len(excess), channels, -1)
            excess = excess * math.sqrt(float(loop.shares.mean()) / len(excess))
        bands = [b for k in range(channels) for b in _spectral_bands(excess[:, k].T, observation)]
        stacked = np.concatenate(bands)
        out = np.zeros((len(stacked), LOOP_COLUMNS * count))
        if loop is not None:
            basis, sizes, _ = np.linalg.svd(stacked, full_matrices=False)
            kept = min(LOOP_COLUMNS, sizes.size)
            out[:, first_column : first_column + kept] = basis[:, :kept] * sizes[:kept]
            first_column += LOOP_COLUMNS
        ends = np.cumsum([len(band) for band in bands])[:-1]
        for k, part in enumerate(np.split(out, ends)):
            columns[k % len(BANDS)].append(part)
    return columns


def _by_band(rows: FloatArray, observation: Observed) -> Iterator[FloatArray]:
    """Mean rotation of whitened rows (n, p) by bands of load orders, with the same noise in each.

    A motion that does not repeat counts as one rotation, in cycles per quarter of it.
    """
    lag = observation.lag if observation.repeats else len(rows)
    turns = whole_rotations(rows, lag)
    yield from _spectral_bands(turns.sum(axis=0) / math.sqrt(len(turns)), observation)


def _spectral_bands(mean: FloatArray, observation: Observed) -> Iterator[FloatArray]:
    """Split one rotation (lag, p) into bands of load orders, (k, p) each."""
    spectrum = np.fft.rfft(mean, axis=0) / math.sqrt(len(mean))
    yield spectrum[:1].real
    below = 1
    for highest in BANDS[1:]:
        end = min(highest if observation.repeats else 4 * highest, len(spectrum) - 2) + 1
        band = spectrum[below : max(end, below)] * math.sqrt(2.0)
        yield np.concatenate([band.real, band.imag])
        below = max(end, below)
