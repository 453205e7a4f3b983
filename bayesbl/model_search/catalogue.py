"""Hypotheses about what a bench lacks: the catalogue's effects and wrong bench parameters.

The prior of a size is a Cauchy distribution with the usual size as its scale, or half of it if
physics fixes the sign: real effects may be much stronger than usual.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.effect_declaration import PHASE, Effect, EffectParameter, Resonance, Role
from bayesbl.bench.effects import EFFECTS, effect_named, parameters_on
from bayesbl.bench.parameters import CORRECTABLE_PARAMETERS
from bayesbl.matching.observed import Observed
from bayesbl.matching.signals import Unknown
from bayesbl.recording.types import FloatArray

Kind = Literal["effect", "parameter"]

CandidateKey = tuple[str, float | None, tuple[str, ...]]
"""Label, motor order, and the names of the unknowns."""

HARMONICS = (2.0, 3.0, 4.0)
"""Multiples of an order that may be its harmonics. Eccentricities and ripples have harmonics."""

RESONANCE_SPACING = 1.35
"""Ratio of neighbouring grid frequencies of an elastic part: a fit converges to any frequency
between."""

USUAL_SHARE = 0.1
"""Usual relative error of a bench parameter."""

PARAMETER_RANGE = 0.5
"""Half-width of a wrong parameter's search range, relative to its value."""

_SCANNED_SHARES = (0.0, 0.03, 0.1, 0.3)


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One hypothesis: unknowns added to those of the nominal model.

    Attributes
    ----------
    name
        Of the effect or bench parameter.
    unknowns
        Named as :meth:`Bench.vector` takes them.
    starts
        Starting points besides ``neutral``, shape (s, k). At a start with a size, the linear
        promise is based on the change over all of it.
    neutral
        Coordinates at which the candidate changes nothing, shape (k,).
    scanned
        Grids of coordinates by index of the unknown. All combinations are tried where the nominal
        fit may be far off.
    recording
        The only recording that it acts in; ``None`` for all.
    usual
        Usual size of each amplitude, shape (k,); NaN for shapes and phases.
    """

    name: str
    kind: Kind
    unknowns: tuple[Unknown, ...]
    neutral: FloatArray
    starts: tuple[FloatArray, ...] = ()
    scanned: Mapping[int, FloatArray] = field(default_factory=dict)
    effect: BenchEffect | None = field(default=None)
    recording: str | None = None
    usual: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def label(self) -> str:
        """Name, followed by the recording if the candidate acts in one only."""
        return self.name if self.recording is None else f"{self.name} ({self.recording})"

    @property
    def order(self) -> float | None:
        """Motor order; ``None`` if the candidate does not repeat with the motor angle."""
        order = None if self.effect is None else self.effect.parameters.get("order")
        return None if order is None else order.value

    @property
    def key(self) -> CandidateKey:
        """Key that identifies a candidate."""
        return self.label, self.order, tuple(unknown.name for unknown in self.unknowns)

    @property
    def unknown_keys(self) -> frozenset[tuple[str, str | None]]:
        """Keys of its unknowns. Two candidates of one set share none."""
        return frozenset(unknown.key for unknown in self.unknowns)

    def bars(self, other: Candidate) -> bool:
        """Whether the other candidate cannot be in one set with this one.

        Both may be the same, share an unknown, or be the same law but for one term. Or the other's
        order is a low multiple of this one's, and may be its harmonic. A real ripple has several
        orders, the bench one per effect: another effect at a harmonic would have no rival and be
        named whatever its cause.
        """
        order, own_order = other.order, self.order
        return (
            other.label == self.label
            or bool(self.unknown_keys & other.unknown_keys)
            or self._contains(other)
            or other._contains(self)
            or (order is not None and own_order is not None and order / own_order in HARMONICS)
        )

    def _contains(self, other: Candidate) -> bool:
        """Whether the other candidate's law is this one without one term."""
        law = effect_named(self.name).torque if self.kind == "effect" else None
        same_place = other.recording == self.recording
        return law is not None and law.contains == other.name and same_place

    @property
    def is_periodic(self) -> bool:
        """Whether it repeats with the motor angle; its phases are then fitted first."""
        return self.effect is not None and effect_named(self.name).is_periodic

    @property
    def amplitudes(self) -> list[int]:
        """Indices of the unknowns that change the prediction at the neutral point."""
        if self.effect is None:
            return list(range(len(self.unknowns)))
        return self._indices("amplitude")

    @property
    def phases(self) -> list[int]:
        """Indices of the phases among its unknowns."""
        return [] if self.effect is None else self._indices("phase")

    def _indices(self, role: Role) -> list[int]:
        roles = {f"{self.name}__{p.name}": p.role for p in effect_named(self.name).parameters}
        return [i for i, u in enumerate(self.unknowns) if roles[u.name] == role]

    @property
    def is_positive(self) -> bool:
        """Whether it has a single amplitude, which cannot be negative."""
        indices = self.amplitudes
        return len(indices) == 1 and self.unknowns[indices[0]].low >= self.neutral[indices[0]]

    def is_at_full_size(self, start: FloatArray) -> bool:
        """Whether a start has a size, as for elastic parts, whose frequency depends on it."""
        indices = self.amplitudes
        return bool(np.any(start[indices] != self.neutral[indices])) and any(
            np.array_equal(start, known_start) for known_start in self.starts
        )

    def log_prior(self, coordinates: FloatArray) -> float:
        """ln prior density at the coordinates of its unknowns, shape (k,)."""
        total = 0.0
        for unknown, x, zero, usual in zip(
            self.unknowns, coordinates, self.neutral, self.usual, strict=True
        ):
            if math.isfinite(usual):
                total -= math.log(math.pi * usual) + math.log1p(((x - zero) / usual) ** 2)
                total += math.log(2.0) if unknown.low >= zero else 0.0
            elif math.isfinite(unknown.high - unknown.low):
                total -= math.log(unknown.high - unknown.low)
            else:
                total -= math.log(2.0 * math.pi)
        return total

    def bench(self, bench: Bench) -> Bench:
        """The bench with this effect added at its neutral value."""
        if self.effect is None or any(e.name == self.effect.name for e in bench.effects):
            return bench
        return bench.with_effects(*bench.effects, self.effect)

    def within(self, recording: str) -> Candidate:
        """The same candidate, acting in one recording only."""
        kept = [i for i, u in enumerate(self.unknowns) if u.recording in (None, recording)]
        return replace(
            self,
            unknowns=tuple(replace(self.unknowns[i], recording=recording) for i in kept),
            neutral=self.neutral[kept],
            starts=tuple(start[kept] for start in self.starts),
            recording=recording,
            usual=self.usual[kept],
        )


def candidates(
    bench: Bench,
    recordings: Sequence[Observed],
    effects: Sequence[str] | Literal["all"] = "all",
    peaks: Sequence[float] = (),
    *,
    declared: Sequence[str] = (),
    load_angle_known: bool = False,
    motor_angle_known: bool = False,
) -> list[Candidate]:
    """Every hypothesis that these recordings can test.

    ``effects``: names from the catalogue, or all of it. ``peaks``: whole motor orders that stand
    out of the fit's residual: starts of the periodic effects. Without peaks there are none.
    ``declared``: bench parameters that are unknown anyway, and so no candidates.
    """
    present = {effect.name for effect in bench.effects}
    hypotheses = []
    for effect in EFFECTS:
        if effect.name in present or not (effects == "all" or effect.name in effects):
            continue
        if effects == "all" and not effect.sought_in_loop:
            continue
        if effect.replaces is not None:
            continue
        if "load_angle" in effect.depends_on and not load_angle_known:
            continue
        between_channels = effect.enters == "measurement" and effect.sought_alone is not None
        if between_channels and any(len(observation.signals) < 2 for observation in recordings):
            continue
        if effect.is_periodic:
            hypotheses += _periodic(bench, effect, recordings, peaks, motor_angle_known)
        elif effect.resonance is not None:
            hypotheses += _elastic(bench, effect, effect.resonance, recordings)
        else:
            hypotheses.append(_plain(bench, effect))
    hypotheses += [
        _parameter(bench, name) for name in CORRECTABLE_PARAMETERS if name not in declared
    ]
    return hypotheses


def _sought(bench: Bench, effect: Effect) -> list[EffectParameter]:
    return [p for p in parameters_on(bench, effect) if effect.sought_alone in (None, p.name)]


def _without_starts(bench: Bench, effect: Effect) -> Candidate:
    sought = _sought(bench, effect)
    lowest = [p.low if p.sought_from is None else p.sought_from for p in sought]
    unknowns = tuple(
        _unknown(effect, p, low, p.high) for p, low in zip(sought, lowest, strict=True)
    )
    return Candidate(
        effect.name,
        "effect",
        unknowns,
        np.array([p.neutral for p in sought]),
        effect=_neutral_effect(effect),
        usual=np.array([abs(p.typical) if p.is_amplitude else math.nan for p in sought]),
    )


def _plain(bench: Bench, effect: Effect) -> Candidate:
    sought, candidate = _sought(bench, effect), _without_starts(bench, effect)
    neutral = candidate.neutral
    starts: tuple[FloatArray, ...] = ()
    scanned: dict[int, FloatArray] = {}
    if effect.enters in ("load", "shaft"):
        main = next(p for p in sought if p.is_amplitude)
        grid = main.high * np.array(_SCANNED_SHARES)
        scanned[0] = grid if main.low >= 0.0 else np.concatenate([-grid[:0:-1], grid])
    shape = [i for i, p in enumerate(sought) if not p.is_amplitude and not p.starts]
    if shape:
        i = shape[0]
        middle = np.geomspace(sought[i].low, sought[i].high, 7)[2:6]
        starts = tuple(np.where(np.arange(neutral.size) == i, m, neutral) for m in middle)
        if scanned:
            scanned[i] = middle
    for i, parameter_starts in ((i, p.starts) for i, p in enumerate(sought) if not p.is_amplitude):
        starts += tuple(
            np.where(np.arange(neutral.size) == i, start, neutral) for start in parameter_starts
        )
    return replace(candidate, starts=starts, scanned=scanned)


def _elastic(
    bench: Bench, effect: Effect, resonance: Resonance, recordings: Sequence[Observed]
) -> Iterator[Candidate]:
    """An elastic part, at full size over a grid of frequencies and inertias.

    Its frequency goes up to half the sampling frequency, at the inertia that makes it lowest. A
    stiffer part acts like a softer shaft, and makes the simulator's steps tiny. Compliances go to
    four times the largest of the grid, and the oscillating inertia from a quarter of the smallest.
    None is left if the grid is beyond what the recordings resolve.
    """
    load = bench.value("load_inertia_kg_m2")
    shaft_rate = math.sqrt(bench.value("shaft_stiffness_nm_per_rad") / load)
    low, high = resonance.multiples
    highest = min(math.pi * max(r.sampling_hz for r in recordings), 2.0 * high * shaft_rate)
    count = 1 + round(math.log(high / low) / math.log(RESONANCE_SPACING))
    rates = shaft_rate * np.geomspace(low, high, count)
    rates = rates[rates < highest]
    if not rates.size:
        return
    (compliance,) = effect.amplitudes
    starts, compliances = [], []
    for part in resonance.parts:
        behind = part if resonance.is_share else part * load
        inertia = behind
        if resonance.is_share:
            inertia *= (1.0 - part) * bench.value(resonance.inertia)
        compliances += [1.0 / (rate**2 * inertia) for rate in (highest, rates[0])]
        for rate in rates:
            values = {p.name: p.neutral for p in effect.parameters}
            values |= {compliance.name: 1.0 / (rate**2 * inertia), resonance.part: behind}
            starts.append(np.array([values[p.name] for p in effect.parameters]))
    candidate = _without_starts(bench, effect)
    unknowns = [
        replace(unknown, low=min(compliances), high=4.0 * max(compliances))
        if parameter.is_amplitude
        else replace(unknown, low=max(unknown.low, 0.25 * min(start[k] for start in starts)))
        if parameter.name == resonance.part
        else unknown
        for k, (unknown, parameter) in enumerate(
            zip(candidate.unknowns, effect.parameters, strict=True)
        )
    ]
    yield replace(candidate, unknowns=tuple(unknowns), starts=tuple(starts))


def _periodic(
    bench: Bench,
    effect: Effect,
    recordings: Sequence[Observed],
    peaks: Sequence[float],
    motor_angle_known: bool,
) -> list[Candidate]:
    """One candidate for each order."""
    (amplitude,) = (p for p in parameters_on(bench, effect) if p.is_amplitude)
    owners: list[str | None] = [None] if motor_angle_known else [r.name for r in recordings]
    hypotheses = []
    for order in peaks:
        if not effect.has_order and order != 1.0:
            continue
        unknowns = [_unknown(effect, amplitude, 0.0, amplitude.high)]
        unknowns += [Unknown(f"{effect.name}__{PHASE}", recording=owner) for owner in owners]
        at_peak = _neutral_effect(effect, order=order)
        neutral = np.zeros(len(unknowns))
        usual = np.full(len(unknowns), math.nan)
        usual[0] = abs(amplitude.typical)
        hypotheses.append(
            Candidate(effect.name, "effect", tuple(unknowns), neutral, effect=at_peak, usual=usual)
        )
    return hypotheses


def _parameter(bench: Bench, name: str) -> Candidate:
    value = bench.value(name)
    unknown = Unknown(name, (1.0 - PARAMETER_RANGE) * value, (1.0 + PARAMETER_RANGE) * value)
    usual = np.array([USUAL_SHARE * abs(value)])
    return Candidate(name, "parameter", (unknown,), np.array([value]), usual=usual)


def _unknown(effect: Effect, parameter: EffectParameter, low: float, high: float) -> Unknown:
    return Unknown(f"{effect.name}__{parameter.name}", low, high)


def _neutral_effect(effect: Effect, **overrides: float) -> BenchEffect:
    values = {p.name: p.neutral for p in effect.parameters}
    values |= {name: value for name, value in overrides.items() if name in values}
    return BenchEffect(
        effect.name, {name: EffectParameterValue(value) for name, value in values.items()}
    )
