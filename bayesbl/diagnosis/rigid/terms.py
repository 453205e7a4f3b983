"""Effects that take part in an inverse comparison, with what each adds to it.

Two things may be compared: the torque that the motor must give (``TORQUE_TERMS``), and where the
load is for a given motor position (``POSITION_TERMS``). A rigid drive has no shaft, so effects of
the shaft enter only the second; lags inside the loop enter neither, since the recorded current is
the one that flows and the motion is the one that happened.

An effect takes part by the laws that its module under ``bench/effects`` declares.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.bench.effect_declaration import ORDER, Effect, RigidLaw
from bayesbl.bench.effects import EFFECTS, effect_named
from bayesbl.diagnosis.comparison import TestedEffect
from bayesbl.diagnosis.rigid.motion import Motion
from bayesbl.diagnosis.rigid.order_scan import FEWEST_CYCLES
from bayesbl.recording.types import FloatArray

SKEW = "channel_time_skew"


@dataclass(frozen=True, slots=True)
class Term:
    """An effect in an inverse comparison.

    Attributes
    ----------
    law
        Its signal, shape (n,), is in N m at the motor or rad at the load.
    periodic
        The signal goes as sin(n θ_m + φ): amplitude and phase are solved as one.
    """

    candidate: TestedEffect
    law: RigidLaw
    periodic: bool

    @property
    def scanned(self) -> str | None:
        """The parameter that the linear solution does not give; ``None`` if it gives all."""
        return self.candidate.amplitude if self.candidate.name == SKEW else self.law.scanned

    @property
    def has_direction(self) -> bool:
        """Whether it is dry friction."""
        return "direction" in effect_named(self.candidate.name).depends_on


@dataclass(frozen=True, slots=True)
class ShapedEffect:
    """A term with a value of what its signal is not linear in; there is none without.

    Raises
    ------
    ValueError
        If there is no value for a scanned parameter, or a value for none.
    """

    term: Term
    value: float | None = None

    def __post_init__(self) -> None:
        if (self.value is None) != (self.term.scanned is None):
            raise ValueError(f"{self.name}: {self.term.scanned} is {self.value}")

    @property
    def name(self) -> str:
        """Of the catalogue."""
        return self.term.candidate.name

    @property
    def shape(self) -> dict[str, float]:
        """The scanned parameter and its value; empty if there is none."""
        scanned = self.term.scanned
        return {} if scanned is None or self.value is None else {scanned: self.value}


@dataclass(frozen=True, slots=True)
class ShapedEffects:
    """Effects of a fit: with their linear coefficients all that a prediction needs.

    ``width``: speed over which dry friction changes its sign, rad/s; 0 for a step.
    """

    effects: tuple[ShapedEffect, ...] = ()
    width: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Of the catalogue."""
        return tuple(effect.name for effect in self.effects)

    @property
    def skew_s(self) -> tuple[float, float]:
        """By which current and position lag."""
        shape = next((effect.shape for effect in self.effects if effect.name == SKEW), {})
        return shape.get("current_s", 0.0), shape.get("position_s", 0.0)

    @property
    def values(self) -> dict[str, float]:
        """``effect.parameter`` of everything scanned, the width apart."""
        return {f"{e.name}.{key}": value for e in self.effects for key, value in e.shape.items()}

    def plus(self, term: Term, value: float | None = None) -> ShapedEffects:
        """With a term, or with another value of one that is there."""
        effect = ShapedEffect(term, value)
        if effect.name in self.names:
            changed = tuple(effect if e.name == effect.name else e for e in self.effects)
            return replace(self, effects=changed)
        return replace(self, effects=(*self.effects, effect))

    def only(self, names: Collection[str]) -> ShapedEffects:
        """Without all others."""
        return replace(self, effects=tuple(e for e in self.effects if e.name in names))


def _term(effect: Effect, law: RigidLaw) -> Term:
    candidate = TestedEffect(
        effect.name,
        law.amplitude,
        freedom=2 if effect.is_periodic else 1,
        same_as=law.same_as,
        contains=law.contains,
        not_negative=law.not_negative
        or any(item.not_negative for item in effect.amplitudes if item.name == law.amplitude),
        at_most=min(
            (a.high for a in effect.amplitudes if a.name == law.amplitude and not a.unit),
            default=math.inf,
        ),
        acts_above=law.scanned == ORDER,
        is_plain=not (
            effect.is_periodic
            or law.scanned
            or law.linear
            or law.contains
            or law.beside
            or effect.name == SKEW
        ),
    )
    return Term(candidate, law, effect.is_periodic)


TORQUE_TERMS: Mapping[str, Term] = MappingProxyType(
    {e.name: _term(e, e.torque) for e in EFFECTS if e.torque is not None}
)
"""Effects in the torque at the motor."""

POSITION_TERMS: Mapping[str, Term] = MappingProxyType(
    {e.name: _term(e, e.position) for e in EFFECTS if e.position is not None}
)
"""Effects in the load's position for a given motor position."""


def without_load_angle(terms: Mapping[str, Term]) -> dict[str, Term]:
    """The terms that do not ask where the load hangs."""
    return {n: term for n, term in terms.items() if "load_angle" not in effect_named(n).depends_on}


def within_turns(terms: Mapping[str, Term], turns: float) -> dict[str, Term]:
    """The terms without those that repeat once a turn of the motor, and so too rarely."""
    return {
        name: term
        for name, term in terms.items()
        if not term.periodic or term.law.scanned == ORDER or turns >= FEWEST_CYCLES
    }


def uncomputable(terms: Mapping[str, Term], bench: Bench, load_angle_known: bool) -> list[str]:
    """Names of terms for which the bench file or the angles do not give enough, sorted.

    Without the load's angle gravity is unknown, and with it the torque that the gear passes on.
    """
    gravity_unknown = bench.value("gravity_torque_nm") > 0.0 and not load_angle_known
    return sorted(
        name
        for name, term in terms.items()
        if bench.assumed & set(term.law.bench_parameters)
        or (gravity_unknown and "transmitted_torque" in effect_named(name).depends_on)
    )


def required_torque(motion: Motion, bench: Bench) -> FloatArray:
    """Torque that this motion asks of the motor, effects of the bench included, N m.

    (J_m + J_l/N²) dω_m/dt + (m g l/N) sin(θ_m/N) and the losses. What a rigid drive cannot show
    (shaft, loop lags) is left out; a skew is the comparison's business.
    """
    torque = bench.value("motor_inertia_kg_m2") * motion.acceleration
    torque = torque + bench.transmitted_torque(motion)
    for present in bench.effects:
        effect = effect_named(present.name)
        if effect.torque is not None and effect.load_torque is None:
            torque = torque + effect.torque.signal(motion, bench, present.complete())
    if bench.learned_torque is not None:
        torque = torque + bench.learned_torque.along(motion, bench.value("gear_ratio"))
    return np.asarray(torque)
