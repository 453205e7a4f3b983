"""What changed in the joint between its recordings, or differs from its bench in all of them.

The candidates are those of a diagnosis, each acting in all recordings or in one of them alone, with
what people change on a real joint beside them: its payload, its controller's gains. What is freed
is fitted together with every gap, so wear is never taken for a change of the joint.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.effects import EFFECTS, effect_named
from bayesbl.bench.kernel import Slot
from bayesbl.bench.parameters import CORRECTABLE_PARAMETERS, declaration_of
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated
from bayesbl.matching.loop_noise import noise_along
from bayesbl.matching.predictive_check import FALSE_ALARM, is_explained
from bayesbl.matching.signals import GAP, Unknown
from bayesbl.model_search.always_in import (
    CHANGED_TOGETHER,
    DEAD_TIME,
    INSTANT_SHARE,
    SAMPLED,
    Direction,
)
from bayesbl.model_search.catalogue import USUAL_SHARE, Candidate, candidates
from bayesbl.model_search.closed_loop import FittedSet, Naming, SetSearch, name_missing
from bayesbl.model_search.refit import Explanation, columns_of
from bayesbl.probabilities import chi2_isf, normal_isf
from bayesbl.progress import Progress, silent
from bayesbl.recording.types import FloatArray

OWN_EFFECT_SHARE = 0.3
"""Of what an effect of the bench is: usual size by which it is more or less."""

FURTHEST_CHANGE = 3.0
"""Factor by which a parameter may have changed, up or down."""

MOST_CHANGES = 2

BEYOND = 2.0
"""Budgets of drift beyond which a parameter has changed: one in twenty drifts so far."""

MISSED = 0.05
"""Share of changes of a blind spot's size that pass; smaller ones pass more often."""


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A bench parameter, or one of an effect, as :meth:`Bench.vector` takes it."""

    slot: str

    @property
    def name(self) -> str:
        """As a user writes it: ``effect.parameter``."""
        return self.slot.replace("__", ".")

    @property
    def unit(self) -> str:
        """As declared."""
        return declaration_of(self.slot).unit


@dataclass(frozen=True, slots=True)
class ChangedParameter(_Quantity):
    """What the bench would have to have instead of what it has.

    Attributes
    ----------
    recording
        The only one that it differs in; ``None`` where all recordings contradict the bench.
    expected, estimate
        In another recording and in this one; by the bench and by the recordings where no other
        recording has a value that is not its own.
    sd
        Of ``estimate`` against ``expected``.
    """

    recording: str | None
    expected: float
    estimate: float
    sd: float


@dataclass(frozen=True, slots=True)
class AddedPart:
    """An elastic part that the bench lacks: its effect, resonance, probability and values.

    ``frequency_hz``: of what swings behind it against the rest of its inertia; of a base against
    ground. ``probability``: against no such part and the others.
    """

    name: str
    frequency_hz: float
    probability: float
    values: tuple[ChangedParameter, ...]


@dataclass(frozen=True, slots=True)
class HiddenChange(_Quantity):
    """A change of the joint in its last recording that the check would not see.

    Attributes
    ----------
    expected, size
        Its value by the bench, and the largest change of it that passes.
    error_rad
        By which it would move the change of δ from the first recording to the last; absolute.
    """

    expected: float
    size: float
    error_rad: float


@dataclass(frozen=True, slots=True)
class JointFindings:
    """Whether one joint, as its bench describes it, made all recordings.

    Attributes
    ----------
    recordings
        Their names.
    explained
        Whether the bench, with what changed, explains all recordings to within noise.
    changed
        What is surely not as the bench has it.
    could_be
        Names of that, and of what these recordings cannot tell from it.
    blind_spots
        The one that moves the change of δ most first.
    allowed
        What was fitted besides and is no more than a joint may differ from its bench, or drift.
    part
        An elastic part that the bench lacks and δ allows for.
    """

    recordings: tuple[str, ...]
    explained: bool
    changed: tuple[ChangedParameter, ...]
    could_be: tuple[str, ...]
    blind_spots: tuple[HiddenChange, ...]
    allowed: tuple[ChangedParameter, ...] = ()
    part: AddedPart | None = None

    @property
    def agrees(self) -> bool:
        """Whether the bench as believed explains all recordings."""
        return self.explained and not self.changed

    @property
    def beyond_bench(self) -> tuple[ChangedParameter, ...]:
        """What no recording has as the bench has it."""
        return tuple(c for c in self.changed if c.recording is None or self._differs(c.slot))

    @property
    def between(self) -> tuple[ChangedParameter, ...]:
        """What differs between the recordings."""
        return tuple(c for c in self.changed if c not in self.beyond_bench)

    def _differs(self, slot: str) -> bool:
        return {c.recording for c in self.changed if c.slot == slot} >= set(self.recordings)


def elastic_parts(
    fit: SimulatedFit, among: Sequence[Direction]
) -> tuple[tuple[FittedSet, float], ...]:
    """The fit without and with a belt, an arm or a base that gives way, the most probable first.

    What one does is far from linear in its compliance, and the tolerances of a bench take up most
    of it, with δ off by much more than its interval. So each is tried where nothing else asks for
    it, and δ is averaged over all.
    """
    bench, recordings = fit.model.bench, fit.model.recordings
    names = [e.name for e in EFFECTS if e.resonance is not None]
    parts = [c for c in candidates(bench, recordings, names) if c.name in names]
    return SetSearch(Explanation((), fit), lambda _: parts, 1, among).sets


def with_part(
    nominal: SimulatedFit, explanation: Explanation, probability: float
) -> tuple[SimulatedFit, tuple[Direction, ...], AddedPart]:
    """A fitted part put into the bench at its most probable values: the fit with the unknowns of
    the nominal one, and the values as directions of their flat priors, to be marginalised.

    Of what swings behind a part the recordings say little, and that moves δ little. Laws and drift
    that stood in for it in the fit are linear again beside it, as they are next to nothing then: a
    lag of microseconds is what the simulator is slowest with.
    """
    (part,) = explanation.candidates
    places, own = explanation.places(part), nominal.point.size
    sds = np.sqrt(np.diag(explanation.fit.covariance))[places].tolist()
    values = {
        u.name.partition("__")[2]: float(explanation.fit.point[k])
        for u, k in zip(part.unknowns, places, strict=True)
    }
    effect = BenchEffect(part.name, {k: EffectParameterValue(v) for k, v in values.items()})
    bench, fit = nominal.model.bench, explanation.fit
    stated = {own.name for own in bench.effects}
    # How the controller samples is kept: it did not stand in for the part.
    ticks = [e for e in fit.model.bench.effects if e.name == SAMPLED and e.name not in stated]
    of_ticks = {DEAD_TIME, INSTANT_SHARE}
    kept = [
        *range(own),
        *(k for k, u in enumerate(fit.model.unknowns) if k >= own and u.name in of_ticks),
    ]
    model = nominal.model.beside(
        bench.with_effects(*bench.effects, *ticks, effect),
        [fit.model.unknowns[k] for k in kept[own:]],
    )
    alone = fit_simulated(model, fit.point[kept], fit.steps[kept])
    directions = tuple(
        Direction(u.name, min(u.prior_sd, 3.0 * sd), 0.0, is_fitted=True)
        for u, sd in zip(part.unknowns, sds, strict=True)
    )
    fitted = tuple(
        ChangedParameter(u.name, None, 0.0, value, sd)
        for u, value, sd in zip(part.unknowns, values.values(), sds, strict=True)
    )
    added = AddedPart(part.name, _frequency_hz(bench, part.name, values), probability, fitted)
    return alone, directions, added


def _frequency_hz(bench: Bench, name: str, values: Mapping[str, float]) -> float:
    """See :class:`AddedPart`; ``values``: of its effect's parameters."""
    effect = effect_named(name)
    assert effect.resonance is not None
    (compliance,) = effect.amplitudes
    inertia = part = values[effect.resonance.part]
    if effect.resonance.is_share:
        inertia *= (1.0 - part) * bench.value(effect.resonance.inertia)
    return 1.0 / (2.0 * math.pi * math.sqrt(values[compliance.name] * inertia))


def find_changes(
    nominal: SimulatedFit,
    *,
    among: Sequence[Direction] = (),
    progress: Progress = silent,
) -> tuple[Naming, JointFindings]:
    """What the bench would have to have, in all recordings or in one, to explain them.

    Parameters
    ----------
    nominal
        All recordings of a joint fitted together with the bench as believed.
    among
        What is marginalised beside every fit, and so is no blind spot.
    progress
        Called with (fits made, fits expected).
    """
    naming = name_missing(
        nominal,
        partial(_candidates, nominal),
        max_effects=MOST_CHANGES,
        among=among,
        progress=progress,
    )
    final, rest = naming.final, naming.rest
    explained = is_explained(final.fit) if rest is None else rest.explains
    names = dict.fromkeys(name for effect in naming.effects for name in effect.members)
    return naming, JointFindings(
        tuple(observation.name for observation in nominal.model.recordings),
        explained,
        tuple(_parameters(final)),
        tuple(names),
        tuple(blind_spots(final.fit, among)) if explained else (),
    )


def changed_beside(
    fit: SimulatedFit, among: Sequence[Direction], part: AddedPart | None = None
) -> JointFindings:
    """What of the joint changed where laws, drift and changes beside a fit explain everything.

    ``among``: what was marginalised, and so is no blind spot; what was far is now an unknown.
    ``part``: which of them is an elastic part that the bench lacks.
    """
    names = tuple(observation.name for observation in fit.model.recordings)
    by_slot = {direction.slot: direction for direction in among}
    changed: list[ChangedParameter] = []
    allowed = [] if part is None else [*part.values]
    for unknown in fit.model.unknowns:
        direction = by_slot.get(unknown.name)
        # A tolerance of the bench, or what the user lets drift, is flat.
        if direction is None or not math.isfinite(unknown.sd):
            continue
        difference = _against_known(fit, unknown)
        drifted = (
            unknown.added
            and abs(difference.estimate - difference.expected) <= BEYOND * direction.drift
        )
        (allowed if drifted or not unknown.added else changed).append(difference)
    return JointFindings(
        names,
        True,
        tuple(changed),
        tuple(dict.fromkeys(c.name for c in changed)),
        tuple(blind_spots(fit, among)),
        tuple(allowed),
        part,
    )


def _against_known(fit: SimulatedFit, unknown: Unknown) -> ChangedParameter:
    """An unknown against the first recording that has no value of its own of it, or where it has
    one in all or all share it against the bench."""
    slot, where = unknown.name, unknown.recording
    own = {u.recording for u in fit.model.unknowns if u.name == slot}
    other = next((r.name for r in fit.model.recordings if r.name not in own), None)
    if where is not None and other is not None:
        return _against(fit, slot, where, other)
    by_bench = float(fit.model.bench.vector()[0, Slot[slot]])
    return ChangedParameter(slot, where, by_bench, fit.value(slot, where), fit.sd(slot, where))


def _parameters(final: Explanation) -> Iterator[ChangedParameter]:
    """What each candidate in the explanation found, phases left out.

    Of two recordings whose values both lie within the bench's tolerance, the later one is what
    changed.
    """
    fit = final.fit
    first, *later = [observation.name for observation in fit.model.recordings]
    freed = {unknown.key for unknown in fit.model.unknowns}
    for candidate in final.candidates:
        unknowns = [candidate.unknowns[place] for place in _stated_places(candidate)]
        if (
            len(later) == 1
            and candidate.recording == first
            and not freed & {(u.name, later[0]) for u in unknowns}
            and all(_is_tolerated(fit, u.name, fit.value(u.name, first)) for u in unknowns)
        ):
            yield from (_against(fit, u.name, later[0], first) for u in unknowns)
        else:
            yield from (_against_known(fit, unknown) for unknown in unknowns)


def _stated_places(candidate: Candidate) -> list[int]:
    """Places of what a bench file needs: a period without its dead time is half of it."""
    places = candidate.amplitudes
    if candidate.effect is None:
        return places
    effect = effect_named(candidate.name)
    stated = {
        effect.slots[shape.name].name
        for shape in effect.shapes
        if shape.starts or effect.resonance is not None
    }
    return places + [i for i, u in enumerate(candidate.unknowns) if u.name in stated]


def _is_tolerated(fit: SimulatedFit, name: str, value: float) -> bool:
    """Whether the bench's tolerance of a parameter holds a value."""
    ends = [
        (float(u.value(np.array(u.low))), float(u.value(np.array(u.high))))
        for u in fit.model.unknowns
        if u.name == name and u.recording is None
    ]
    return any(low <= value <= high for low, high in ends)


def _against(fit: SimulatedFit, name: str, one: str, other: str) -> ChangedParameter:
    """A parameter in one recording against what is known of it in another, or what all share, with
    its drift."""
    own_sd = np.sqrt(np.diag(fit.covariance))
    steps = np.diag(own_sd)
    points = np.concatenate([fit.point[None], fit.point + steps, fit.point - steps])
    by_bench = fit.model.bench.vector()[0, Slot[name]]
    values = [
        np.broadcast_to(fit.model.settings_of(points, observation).get(name, by_bench), len(points))
        for recording in (one, other)
        for observation in fit.model.recordings
        if observation.name == recording
    ]
    up, down = np.split((values[0] - values[1])[1:], 2)
    slopes = np.divide(up - down, 2.0 * own_sd, out=np.zeros(own_sd.size), where=own_sd > 0.0)
    sd = math.sqrt(float(slopes @ fit.covariance @ slopes))
    return ChangedParameter(name, one, float(values[1][0]), float(values[0][0]), sd)


def _candidates(fit: SimulatedFit, peaks: Sequence[float]) -> list[Candidate]:
    """All that may differ from the bench, in all recordings together and in each alone."""
    model = fit.model
    bench, recordings = model.bench, model.recordings
    # A parameter of zero changes by no factor: an axis without gravity keeps none.
    changeable = {name: (name,) for name in CORRECTABLE_PARAMETERS} | CHANGED_TOGETHER
    every = [
        *(c for c in candidates(bench, recordings, "all", peaks) if c.kind == "effect"),
        *(
            _changed(bench, name, names)
            for name, names in changeable.items()
            if all(bench.value(parameter) != 0.0 for parameter in names)
        ),
        *_own_effects(bench),
    ]
    shared = {u.name for u in model.unknowns if u.recording is None}
    everywhere = [c for c in every if not shared & {u.name for u in c.unknowns}]
    if len(recordings) == 1:
        return everywhere
    own = {unknown.key for unknown in model.unknowns}
    within = [c.within(observation.name) for observation in recordings for c in every]
    return [*everywhere, *(c for c in within if not own & c.unknown_keys)]


def _changed(bench: Bench, name: str, parameters: Sequence[str]) -> Candidate:
    values = np.array([bench.value(parameter) for parameter in parameters])
    unknowns = tuple(
        Unknown(parameter, *_furthest(value, bench.tolerances.get(parameter, 0.0)))
        for parameter, value in zip(parameters, values, strict=True)
    )
    return Candidate(name, "parameter", unknowns, values, usual=USUAL_SHARE * np.abs(values))


def _furthest(value: float, tolerance: float) -> tuple[float, float]:
    """Range of a changed parameter: also of one that was anywhere within a wide tolerance."""
    ends = [value / FURTHEST_CHANGE, value * FURTHEST_CHANGE, value - tolerance, value + tolerance]
    kept = [end for end in ends if end * value > 0.0]
    return min(kept), max(kept)


def _own_effects(bench: Bench) -> list[Candidate]:
    """Effects that the bench has, grown or shrunk; a controller's dead time, which may be any."""
    resized = []
    for present in bench.effects:
        values, effect = present.complete(), effect_named(present.name)
        ranges = {
            item.name: sorted(
                (values[item.name] / FURTHEST_CHANGE, values[item.name] * FURTHEST_CHANGE)
            )
            for item in effect.amplitudes
            if values[item.name] != 0.0
        }
        ranges |= {item.name: [item.low, item.high] for item in effect.shapes if item.starts}
        for name, (low, high) in ranges.items():
            unknown = Unknown(f"{present.name}__{name}", low, high)
            neutral = np.array([values[name]])
            usual = np.array([OWN_EFFECT_SHARE * max(abs(values[name]), high - low)])
            resized.append(Candidate(present.name, "parameter", (unknown,), neutral, usual=usual))
    return resized


def blind_spots(fit: SimulatedFit, among: Sequence[Direction] = ()) -> list[HiddenChange]:
    """Changes in the last recording that would pass, the one that moves the change of δ most first.

    But for laws and drift ``among`` what is marginalised.

    With J the derivatives of the fit, C = (JᵀJ + P)⁻¹ and j that by the change, a change of size η
    moves the unknowns by C Jᵀj η if it is not modelled, and is found where η exceeds its standard
    deviation (jᵀj − jᵀJ C Jᵀj)^(−1/2), were it free, often enough for the threshold. Noise that
    goes round in the speed loop makes that larger.
    """
    model = fit.model
    first, last = model.recordings[0].name, model.recordings[-1].name
    if first == last:
        return []
    toward = np.zeros(fit.point.size)
    for sign, name in ((1.0, last), (-1.0, first)):
        place = model.index(GAP, name)
        toward[place] = sign * model.unknowns[place].slope(np.array(fit.value(GAP, name)))
    least = math.sqrt(float(chi2_isf(FALSE_ALARM / len(_candidates(fit, ())), 1)))
    least += normal_isf(MISSED)
    derivatives, noise = fit.derivatives(), noise_along(fit)
    # That something was changed by people is only a small probability.
    marginalised = {d.slot for d in among if d.usual > 0.0 or d.drift > 0.0}
    spots = []
    for candidate in _candidates(fit, [1.0]):
        if candidate.recording != last or len(candidate.amplitudes) != 1:
            continue
        if marginalised & {u.name for u in candidate.unknowns}:
            continue
        spots += [
            _largest_hidden(fit, candidate, columns, derivatives, toward, least, noise)
            for columns in columns_of(fit, candidate)
            if columns
        ]
    worst: dict[str, HiddenChange] = {}
    for spot in sorted(spots, key=lambda spot: -spot.error_rad):
        worst.setdefault(spot.name, spot)
    return list(worst.values())


def _largest_hidden(
    fit: SimulatedFit,
    candidate: Candidate,
    columns: Sequence[FloatArray],
    derivatives: FloatArray,
    toward: FloatArray,
    least: float,
    noise: Callable[[FloatArray], FloatArray],
) -> HiddenChange:
    """The change that passes and moves δ most: max |pᵀη| with ηᵀIη = least², within its range."""
    matrix = np.column_stack(columns)
    across = derivatives.T @ matrix
    moved = fit.covariance @ across
    information = matrix.T @ matrix - across.T @ moved
    pull = toward @ moved
    hidden = np.linalg.pinv(information, hermitian=True) @ pull
    reach = math.sqrt(max(float(pull @ hidden), 0.0))
    place = candidate.amplitudes[0]
    unknown = candidate.unknowns[place]
    furthest = unknown.high - float(candidate.neutral[place])
    if reach > 0.0:
        hidden *= least / reach
        along = matrix @ hidden - derivatives @ (moved @ hidden)
        hidden *= math.sqrt(float(np.mean(noise(along))))
    size = float(np.linalg.norm(hidden))
    if size > furthest or reach == 0.0:
        hidden *= furthest / size if size > 0.0 else 0.0
        size = furthest
    expected, error_rad = float(candidate.neutral[place]), abs(float(pull @ hidden))
    return HiddenChange(unknown.name, expected, size, error_rad)
