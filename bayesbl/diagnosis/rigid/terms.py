"""Effects that take part in an inverse comparison, with what each adds to it.

Two things may be compared: the torque that the motor must give (``TORQUE_TERMS``), and where the
load is for a given motor position (``POSITION_TERMS``). A rigid drive has no shaft, so effects of
the shaft enter only the second; lags inside the loop enter neither, since the recorded current is
the one that flows and the motion is the one that happened.

An effect takes part by the laws that its module under ``bench/effects`` declares.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
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
    not_negative: bool


def _term(effect: Effect, law: RigidLaw) -> Term:
    not_negative = law.not_negative or any(
        item.not_negative for item in effect.amplitudes if item.name == law.amplitude
    )
    candidate = TestedEffect(effect.name, law.same_as, law.contains)
    return Term(candidate, law, effect.is_periodic, not_negative)


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
