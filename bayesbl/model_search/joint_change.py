"""Find what changed in the joint between recordings, or differs from its bench in all of them.

The candidates are those of a diagnosis, each in all recordings or in a single one, and what people
change on a real joint: its payload and its controller's gains. Every candidate is fitted jointly
with all gaps, so wear is never mistaken for a change of the joint.
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
from bayesbl.matching.signals import GAP, Unknown
from bayesbl.model_search.always_in import (
    CHANGED_TOGETHER,
    DEAD_TIME,
    INSTANT_SHARE,
    SAMPLED,
    Direction,
    LinearisedFit,
)
from bayesbl.model_search.catalogue import USUAL_SHARE, Candidate, candidates
from bayesbl.model_search.closed_loop import (
    FittedSet,
    Naming,
    SetSearch,
    weighed,
    with_probabilities,
)
from bayesbl.model_search.refit import Explanation, columns_of
from bayesbl.probabilities import FALSE_ALARM, chi2_isf, normal_isf
from bayesbl.progress import Progress, silent
from bayesbl.recording.types import FloatArray

ELASTIC_PARTS = tuple(effect.name for effect in EFFECTS if effect.resonance is not None)
OWN_EFFECT_SHARE = 0.3
"""Usual relative change of an effect that the bench has."""

FURTHEST_CHANGE = 3.0
"""Largest factor by which a parameter may have changed, up or down."""

MOST_CHANGES = 2

BEYOND = 2.0
"""Number of drift standard deviations beyond which a parameter has changed: one in twenty drifts so
far."""

MISSED = 0.05
"""Share of changes of a blind spot's size that pass the check. Smaller changes pass more often."""


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A parameter of the bench or of an effect, named as :meth:`Bench.vector` takes it."""

    slot: str

    @property
    def name(self) -> str:
        """Name as a user writes it: ``effect.parameter``."""
        return self.slot.replace("__", ".")

    @property
    def unit(self) -> str:
        """Declared unit."""
        return declaration_of(self.slot).unit


@dataclass(frozen=True, slots=True)
class ChangedParameter(_Quantity):
    """A parameter whose value must differ from the bench's.

    Attributes
    ----------
    recording
        The only recording in which it differs; ``None`` if all recordings contradict the bench.
    expected, estimate
        Values in another recording and in this one. If no other recording has a value that is not
        its own, values by the bench and by the recordings.
    sd
        Standard deviation of ``estimate`` − ``expected``.
    """

    recording: str | None
    expected: float
    estimate: float
    sd: float


@dataclass(frozen=True, slots=True)
class AddedPart:
    """An elastic part that the bench lacks: its effect, resonance, probability and values.

    ``frequency_hz``: of the oscillating part against the remaining inertia; of a base against
    ground. ``probability``: against no such part and the other parts.
    """

    name: str
    frequency_hz: float
    probability: float
    values: tuple[ChangedParameter, ...]


@dataclass(frozen=True, slots=True)
class HiddenChange(_Quantity):
    """A change of the joint in its last recording that the check would miss.

    ``expected``, ``size``: value by the bench, and the largest change that passes; ``error_rad``:
    absolute shift of the change of δ from the first recording to the last.
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
        Whether the bench, with the changes, explains all recordings to within noise.
    changed
        Parameters that surely differ from the bench.
    could_be
        Their names, and the names that these recordings cannot distinguish from them.
    blind_spots
        Undetected changes, in decreasing order of their effect on the change of δ.
    allowed
        Fitted deviations within what a joint may differ from its bench, or drift.
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
        """Changes by which every recording differs from the bench."""
        return tuple(c for c in self.changed if c.recording is None or self._differs(c.slot))

    @property
    def between(self) -> tuple[ChangedParameter, ...]:
        """Changes between the recordings."""
        return tuple(c for c in self.changed if c not in self.beyond_bench)

    def _differs(self, slot: str) -> bool:
        return {c.recording for c in self.changed if c.slot == slot} >= set(self.recordings)


def loops_and_parts(
    fit: SimulatedFit, loops: Sequence[SimulatedFit], nuisances: Sequence[Direction]
) -> tuple[tuple[FittedSet, float], ...]:
    """Fit the joint as it is, with other loops, and with an elastic part; the most probable first.

    The recordings often cannot tell which loop is the right one, and each gives its own gap. An
    elastic belt, arm or base is far from linear in its compliance. The tolerances of a bench absorb
    most of its effect, and δ is then wrong by much more than its interval. So each part is tried
    even if nothing else indicates it, and δ is averaged over all models. Empty for motions, in
    which no part is sought, if no other loop fits as well.
    """
    bench, recordings = fit.model.bench, fit.model.recordings
    parts = [c for c in candidates(bench, recordings, ELASTIC_PARTS) if c.name in ELASTIC_PARTS]
    if all(observation.motion is None for observation in recordings):
        found = SetSearch(Explanation((), fit), lambda _: parts, 1, nuisances).sets
        sets = [entry for entry, _ in found]
    elif loops:
        sets = [weighed(Explanation((), fit), nuisances)]
    else:
        return ()
    sets += [weighed(Explanation((), loop), nuisances) for loop in loops]
    return with_probabilities(sets)


def with_part(
    nominal: SimulatedFit, explanation: Explanation, probability: float
) -> tuple[SimulatedFit, tuple[Direction, ...], AddedPart]:
    """Put a fitted part into the bench at its most probable values.

    Returns the fit of the nominal unknowns, and the part's values as directions of their flat
    priors, to be marginalised. The recordings say little about the oscillating inertia, which moves
    δ little. Laws and drift that replaced the part in the fit are linear again. They are nearly
    zero then, and a lag of microseconds makes the simulator slowest.
    """
    (part,) = explanation.candidates
    indices, nominal_size = explanation.places(part), nominal.point.size
    sds = np.sqrt(np.diag(explanation.fit.covariance))[indices].tolist()
    values = {
        u.name.partition("__")[2]: float(explanation.fit.point[k])
        for u, k in zip(part.unknowns, indices, strict=True)
    }
    effect = BenchEffect(part.name, {k: EffectParameterValue(v) for k, v in values.items()})
    bench, fit = nominal.model.bench, explanation.fit
    stated = {present.name for present in bench.effects}
    # Keep the controller's sampling: it did not replace the part.
    ticks = [e for e in fit.model.bench.effects if e.name == SAMPLED and e.name not in stated]
    of_ticks = {DEAD_TIME, INSTANT_SHARE}
    kept = [
        *range(nominal_size),
        *(k for k, u in enumerate(fit.model.unknowns) if k >= nominal_size and u.name in of_ticks),
    ]
    model = nominal.model.with_unknowns(
        bench.with_effects(*bench.effects, *ticks, effect),
        [fit.model.unknowns[k] for k in kept[nominal_size:]],
    )
    part_fit = fit_simulated(model, fit.point[kept], fit.steps[kept])
    directions = tuple(
        Direction(u.name, min(u.prior_sd, 3.0 * sd), 0.0, is_fitted=True)
        for u, sd in zip(part.unknowns, sds, strict=True)
    )
    fitted = tuple(
        ChangedParameter(u.name, None, 0.0, value, sd)
        for u, value, sd in zip(part.unknowns, values.values(), sds, strict=True)
    )
    added = AddedPart(part.name, _frequency_hz(bench, part.name, values), probability, fitted)
    return part_fit, directions, added


def _frequency_hz(bench: Bench, name: str, values: Mapping[str, float]) -> float:
    """Frequency of :class:`AddedPart`; ``values``: of its effect's parameters."""
    effect = effect_named(name)
    assert effect.resonance is not None
    (compliance,) = effect.amplitudes
    inertia = part = values[effect.resonance.part]
    if effect.resonance.is_share:
        inertia *= (1.0 - part) * bench.value(effect.resonance.inertia)
    return 1.0 / (2.0 * math.pi * math.sqrt(values[compliance.name] * inertia))


def find_changes(
    nominal: SimulatedFit,
    nuisances: Sequence[Direction] = (),
    progress: Progress = silent,
) -> tuple[Naming, LinearisedFit, JointFindings]:
    """Find what must differ from the bench, in all recordings or in one, to explain them.

    ``nominal``: all recordings of a joint fitted together with the bench as believed;
    ``nuisances``: directions marginalised at every fit, which are therefore no blind spots;
    ``progress``: called with (fits made, fits expected).
    """
    posterior = SetSearch(
        Explanation((), nominal), partial(_candidates, nominal), MOST_CHANGES, nuisances, progress
    )
    naming = posterior.answer()
    final, linear_fit = naming.final, posterior.linearised_fit(naming.final)
    names = dict.fromkeys(name for effect in naming.effects for name in effect.members)
    findings = JointFindings(
        tuple(observation.name for observation in nominal.model.recordings),
        linear_fit.explains,
        tuple(_parameters(final)),
        tuple(names),
        tuple(blind_spots(final.fit, nuisances)) if linear_fit.explains else (),
    )
    return naming, linear_fit, findings


def changes_at_fit(
    fit: SimulatedFit, nuisances: Sequence[Direction], part: AddedPart | None = None
) -> JointFindings:
    """Find the changes of the joint if laws, drift and changes at a fit explain everything.

    ``nuisances``: marginalised directions, which are no blind spots; far ones are unknowns by now.
    ``part``: an elastic part that the bench lacks.
    """
    names = tuple(observation.name for observation in fit.model.recordings)
    by_slot = {direction.slot: direction for direction in nuisances}
    changed: list[ChangedParameter] = []
    allowed = [] if part is None else [*part.values]
    for unknown in fit.model.unknowns:
        direction = by_slot.get(unknown.name)
        # Tolerances of the bench, and drift set by the user, are flat.
        if direction is None or not math.isfinite(unknown.sd):
            continue
        difference = _compared_with_known(fit, unknown)
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
        tuple(blind_spots(fit, nuisances)),
        tuple(allowed),
        part,
    )


def _compared_with_known(fit: SimulatedFit, unknown: Unknown) -> ChangedParameter:
    """Compare an unknown with the first recording that has no value of its own.

    If there is none, or all recordings share the unknown, compare it with the bench.
    """
    slot, where = unknown.name, unknown.recording
    own_recordings = {u.recording for u in fit.model.unknowns if u.name == slot}
    other = next((r.name for r in fit.model.recordings if r.name not in own_recordings), None)
    if where is not None and other is not None:
        return _compared(fit, slot, where, other)
    by_bench = float(fit.model.bench.vector()[0, Slot[slot]])
    return ChangedParameter(slot, where, by_bench, fit.value(slot, where), fit.sd(slot, where))


def _parameters(final: Explanation) -> Iterator[ChangedParameter]:
    """Values found by each candidate of the explanation, without phases.

    If both values of two recordings are within the bench's tolerance, the later one counts as
    changed.
    """
    fit = final.fit
    first, *later = [observation.name for observation in fit.model.recordings]
    freed = {unknown.key for unknown in fit.model.unknowns}
    for candidate in final.candidates:
        unknowns = [candidate.unknowns[index] for index in _stated_indices(candidate)]
        if (
            len(later) == 1
            and candidate.recording == first
            and not freed & {(u.name, later[0]) for u in unknowns}
            and all(_is_tolerated(fit, u.name, fit.value(u.name, first)) for u in unknowns)
        ):
            yield from (_compared(fit, u.name, later[0], first) for u in unknowns)
        else:
            yield from (_compared_with_known(fit, unknown) for unknown in unknowns)


def _stated_indices(candidate: Candidate) -> list[int]:
    """Indices of the values that a bench file needs, such as a period and its dead time."""
    indices = candidate.amplitudes
    if candidate.effect is None:
        return indices
    effect = effect_named(candidate.name)
    stated = {
        effect.slots[shape.name].name
        for shape in effect.shapes
        if shape.starts or effect.resonance is not None
    }
    return indices + [i for i, u in enumerate(candidate.unknowns) if u.name in stated]


def _is_tolerated(fit: SimulatedFit, name: str, value: float) -> bool:
    """Whether a value is within the bench's tolerance of a parameter."""
    ends = [
        (float(u.value(np.array(u.low))), float(u.value(np.array(u.high))))
        for u in fit.model.unknowns
        if u.name == name and u.recording is None
    ]
    return any(low <= value <= high for low, high in ends)


def _compared(fit: SimulatedFit, name: str, one: str, other: str) -> ChangedParameter:
    """Compare a parameter, drift included, between two recordings."""
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
    # A factor cannot change a parameter of zero: an axis without gravity keeps none.
    changeable = {name: (name,) for name in CORRECTABLE_PARAMETERS} | CHANGED_TOGETHER
    hypotheses = [
        *(c for c in candidates(bench, recordings, "all", peaks) if c.kind == "effect"),
        *(
            _changed(bench, name, names)
            for name, names in changeable.items()
            if all(bench.value(parameter) != 0.0 for parameter in names)
        ),
        *_own_effects(bench),
    ]
    shared = {u.name for u in model.unknowns if u.recording is None}
    everywhere = [c for c in hypotheses if not shared & {u.name for u in c.unknowns}]
    if len(recordings) == 1:
        return everywhere
    existing_keys = {unknown.key for unknown in model.unknowns}
    # A joint has an elastic part in all recordings or in none; its stiffness may change.
    within = [
        c.within(observation.name)
        for observation in recordings
        for c in hypotheses
        if c.name not in ELASTIC_PARTS and not any(u.name in observation.known for u in c.unknowns)
    ]
    return [*everywhere, *(c for c in within if not existing_keys & c.unknown_keys)]


def _changed(bench: Bench, name: str, parameters: Sequence[str]) -> Candidate:
    values = np.array([bench.value(parameter) for parameter in parameters])
    unknowns = tuple(
        Unknown(parameter, *_changed_range(value, bench.tolerances.get(parameter, 0.0)))
        for parameter, value in zip(parameters, values, strict=True)
    )
    return Candidate(name, "parameter", unknowns, values, usual=USUAL_SHARE * np.abs(values))


def _changed_range(value: float, tolerance: float) -> tuple[float, float]:
    """Range of a changed parameter; it includes the whole of a wide tolerance."""
    ends = [value / FURTHEST_CHANGE, value * FURTHEST_CHANGE, value - tolerance, value + tolerance]
    kept = [end for end in ends if end * value > 0.0]
    return min(kept), max(kept)


def _own_effects(bench: Bench) -> list[Candidate]:
    """Effects of the bench with another size, and any dead time of its controller."""
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


def blind_spots(fit: SimulatedFit, nuisances: Sequence[Direction] = ()) -> list[HiddenChange]:
    """Undetected changes in the last recording, in decreasing order of their effect on δ's change.

    Marginalised laws and drift are left out.

    With J the Jacobian of the fit, C = (JᵀJ + P)⁻¹ and j the derivative by the change, an
    unmodelled change of size η moves the unknowns by C Jᵀj η. If it were free, its standard
    deviation would be (jᵀj − jᵀJ C Jᵀj)^(−1/2). The change is detected often enough if η exceeds
    this by the threshold. Noise fed back by the speed loop makes it larger.
    """
    model = fit.model
    first, last = model.recordings[0].name, model.recordings[-1].name
    if first == last:
        return []
    gradient = np.zeros(fit.point.size)
    for sign, name in ((1.0, last), (-1.0, first)):
        index = model.index(GAP, name)
        gradient[index] = sign * model.unknowns[index].slope(np.array(fit.value(GAP, name)))
    threshold = math.sqrt(float(chi2_isf(FALSE_ALARM / len(_candidates(fit, ())), 1)))
    threshold += normal_isf(MISSED)
    derivatives, noise = fit.derivatives(), noise_along(fit)
    # A change by people has only a small probability.
    marginalised = {d.slot for d in nuisances if d.usual > 0.0 or d.drift > 0.0}
    spots = []
    for candidate in _candidates(fit, [1.0]):
        if candidate.recording != last or len(candidate.amplitudes) != 1:
            continue
        if marginalised & {u.name for u in candidate.unknowns}:
            continue
        spots += [
            _largest_hidden(fit, candidate, columns, derivatives, gradient, threshold, noise)
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
    gradient: FloatArray,
    threshold: float,
    noise: Callable[[FloatArray], float],
) -> HiddenChange:
    """The undetected change that moves δ most: max |pᵀη| with ηᵀIη = least².

    Neither the change nor any unknown that hides it leaves its range.
    """
    matrix = np.column_stack(columns)
    across = derivatives.T @ matrix
    shifts = fit.covariance @ across
    information = matrix.T @ matrix - across.T @ shifts
    pull = gradient @ shifts
    hidden = np.linalg.pinv(information, hermitian=True) @ pull
    reach = math.sqrt(max(float(pull @ hidden), 0.0))
    if reach > 0.0:
        hidden *= threshold / reach
        projected = matrix @ hidden - derivatives @ (shifts @ hidden)
        hidden *= math.sqrt(noise(projected))
    index = candidate.amplitudes[0]
    unknown, expected = candidate.unknowns[index], float(candidate.neutral[index])
    norm = float(np.linalg.norm(hidden))
    direction = hidden / norm if norm > 0.0 else hidden
    # The fit takes a hidden change for one of its unknowns, so these really are elsewhere.
    truth = -shifts @ direction
    furthest = max(
        min(end, _room(fit, sign * truth))
        for sign, end in ((1.0, unknown.high - expected), (-1.0, expected - unknown.low))
    )
    if reach == 0.0:
        return HiddenChange(unknown.name, expected, furthest, 0.0)
    size = min(norm, furthest)
    return HiddenChange(unknown.name, expected, size, abs(size * float(pull @ direction)))


def _room(fit: SimulatedFit, direction: FloatArray) -> float:
    """How far the unknowns can move in a direction before one leaves its range surely.

    Dry friction hides only where the viscous friction that it replaces remains positive. The point
    is known to a standard deviation, so an unknown at its bound blocks no direction.
    """
    sd = np.sqrt(np.diag(fit.covariance))
    ends = np.array([[u.low, u.high] for u in fit.model.unknowns]) + np.outer(sd, (-1.0, 1.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        rooms = (
            np.where(direction < 0.0, ends[:, 0] - fit.point, ends[:, 1] - fit.point) / direction
        )
    return max(float(np.min(rooms, where=direction != 0.0, initial=math.inf)), 0.0)
