"""What each effect of the catalogue adds to an inverse comparison, as a function of the motion.

Two things may be compared: the torque that the motor must give (``TORQUE_TERMS``), and where the
load stands for a given motor position (``POSITION_TERMS``). A rigid drive has no shaft, so effects
of the shaft enter only the second; lags inside the loop enter neither, since the recorded current
is the one that flows and the motion is the one that happened.

To let an effect take part: its signal here, from the equation in the catalogue.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from bayesbl.bench.bench import Bench, BenchEffect
from bayesbl.bench.effects import effect_named
from bayesbl.bench.kernel import LOAD_SIGN_WIDTH, MOTOR_SIGN_WIDTH
from bayesbl.diagnosis.comparison import Candidate
from bayesbl.diagnosis.rigid.motion import Motion
from bayesbl.recording.types import FloatArray

PHASE = "phase_rad"
ORDER = "order"
SKEW = "channel_time_skew"
_COEFFICIENT = "coefficient_nm_s_per_rad"

Parameters = Mapping[str, float]
Signal = Callable[[Motion, Bench, Parameters], FloatArray]


@dataclass(frozen=True, slots=True)
class Term:
    """An effect in an inverse comparison; its signal is linear in the candidate's amplitude.

    Attributes
    ----------
    signal
        Shape (n,), N m at the motor or rad at the load, of the catalogue's parameters in SI.
    linear
        Parameters beside the amplitude that the signal is linear in.
    shape
        A parameter to scan, and ``None`` or the values to try; orders get their own grid.
    periodic
        The signal goes as sin(n θ_m + φ): amplitude and phase are solved as one.
    """

    candidate: Candidate
    signal: Signal
    linear: tuple[str, ...] = ()
    shape: str | None = None
    grid: tuple[float, ...] = ()
    periodic: bool = False


def direction(motion: Motion) -> FloatArray:
    """Smoothed sign of the motor speed, as the simulator's friction has it."""
    return np.tanh(motion.speed / MOTOR_SIGN_WIDTH)


def transmitted(motion: Motion, bench: Bench) -> FloatArray:
    """Torque that the gear passes on, at the motor: load inertia, gravity, losses there; N m."""
    ratio = bench.value("gear_ratio")
    torque = bench.value("load_inertia_kg_m2") / ratio * motion.acceleration
    torque = torque + bench.value("gravity_torque_nm") * np.sin(motion.angle / ratio)
    for effect in bench.effects:
        if effect.name in _LOAD_LAWS:
            torque = torque + _LOAD_LAWS[effect.name](motion, ratio, _complete(effect))
    return np.asarray(torque / ratio)


def required_torque(motion: Motion, bench: Bench) -> FloatArray:
    """Torque that this motion asks of the motor, effects of the bench included, N m.

    (J_m + J_l/N²) dω_m/dt + (m g l/N) sin(θ_m/N) and the losses. What a rigid drive cannot show
    (shaft, loop lags) is left out; a skew is the comparison's business.
    """
    torque = bench.value("motor_inertia_kg_m2") * motion.acceleration + transmitted(motion, bench)
    for effect in bench.effects:
        if effect.name in TORQUE_TERMS and effect.name not in _LOAD_LAWS:
            signal = TORQUE_TERMS[effect.name].signal
            torque = torque + signal(motion, bench, _complete(effect))
    return np.asarray(torque)


def _complete(effect: BenchEffect) -> dict[str, float]:
    """All parameters of an effect, those not given at their neutral value."""
    given = {key: item.value for key, item in effect.parameters.items()}
    return {p.name: given.get(p.name, p.neutral) for p in effect_named(effect.name).parameters}


def _stribeck(m: Motion, _: Bench, p: Parameters) -> FloatArray:
    fading = np.exp(-((m.speed / p["speed_rad_per_s"]) ** 2))
    return np.asarray(p["torque_nm"] * fading * direction(m))


def _ripple(m: Motion, _: Bench, p: Parameters) -> FloatArray:
    return np.asarray(p["torque_nm"] * np.sin(p[ORDER] * m.angle + p[PHASE]))


def _drift(m: Motion, _: Bench, p: Parameters) -> FloatArray:
    time = m.time_s - m.time_s[0]
    return np.asarray((p["torque_nm"] + p["rate_nm_per_s"] * time) * direction(m))


def _eccentricity_torque(m: Motion, b: Bench, p: Parameters) -> FloatArray:
    """What is taken for acceleration and is not: the encoder's sway, differentiated as the rest."""
    ratio = b.value("gear_ratio")
    inertia = b.value("motor_inertia_kg_m2") + b.value("load_inertia_kg_m2") / ratio**2
    sway = (m.sway * np.exp(1j * p[PHASE])).imag
    return np.asarray(-inertia * p["angle_rad"] * sway)


def _backlash(m: Motion, b: Bench, p: Parameters) -> FloatArray:
    """A load that friction holds lies half the clearance behind, and waits at reversals."""
    return play(m.angle / b.value("gear_ratio"), p["gap_rad"])


def _hysteresis(m: Motion, b: Bench, p: Parameters) -> FloatArray:
    """Twist −(T/K_s) z of a shaft whose Dahl friction follows the motion."""
    bent = p["torque_nm"] / b.value("shaft_stiffness_nm_per_rad")
    return np.asarray(-bent * dahl(m.angle / b.value("gear_ratio"), p["angle_rad"]))


def _transmission(m: Motion, _: Bench, p: Parameters) -> FloatArray:
    return np.asarray(p["angle_rad"] * np.sin(p[ORDER] * m.angle + p[PHASE]))


def _eccentricity_position(m: Motion, b: Bench, p: Parameters) -> FloatArray:
    return np.asarray(-p["angle_rad"] / b.value("gear_ratio") * np.sin(m.angle + p[PHASE]))


def play(angle: FloatArray, half_width: float) -> FloatArray:
    """Departure of the play operator from its input, shape (n,), within ±half_width."""
    out = np.empty_like(angle)
    held = angle[0]
    for i, value in enumerate(angle):
        held = min(max(held, value - half_width), value + half_width)
        out[i] = held - value
    return out


def dahl(angle: FloatArray, reach: float) -> FloatArray:
    """z of dz/dx = (1 − z sign dx)/θ_p along the angle, exactly for each step; shape (n,)."""
    out = np.empty_like(angle)
    z = 0.0
    out[0] = z
    steps = np.diff(angle)
    fading = np.exp(-np.abs(steps) / reach)
    signs = np.sign(steps)
    for i, (keep, sign) in enumerate(zip(fading, signs, strict=True), start=1):
        z = sign + (z - sign) * keep if sign else z
        out[i] = z
    return out


_LOAD_LAWS: Mapping[str, Callable[[Motion, float, Parameters], FloatArray]] = MappingProxyType(
    {
        "load_coulomb_friction": lambda m, ratio, p: (
            p["torque_nm"] * np.tanh(m.speed / ratio / LOAD_SIGN_WIDTH)
        ),
        "load_viscous_friction": lambda m, ratio, p: p[_COEFFICIENT] * m.speed / ratio,
        "load_torque_offset": lambda m, ratio, p: p["torque_nm"] * np.ones_like(m.speed),
        "gravity_phase": lambda m, ratio, p: p["torque_nm"] * np.cos(m.angle / ratio),
    }
)
"""Effects of a bench at its load, N m there, by motion and gear ratio."""

_SPEEDS = tuple(np.geomspace(1.0, 500.0, 25))
_REACHES = tuple(np.geomspace(1e-5, 1e-2, 13))

_TORQUE = (
    Term(
        Candidate(
            "motor_coulomb_friction",
            "torque_nm",
            same_as=("load_coulomb_friction",),
            not_negative=True,
        ),
        lambda m, b, p: p["torque_nm"] * direction(m),
    ),
    Term(
        Candidate(
            "motor_viscous_friction",
            _COEFFICIENT,
            same_as=("load_viscous_friction",),
            not_negative=True,
        ),
        lambda m, b, p: p[_COEFFICIENT] * m.speed,
    ),
    Term(
        Candidate("motor_stribeck_friction", "torque_nm", not_negative=True),
        _stribeck,
        shape="speed_rad_per_s",
        grid=_SPEEDS,
    ),
    Term(
        Candidate("friction_asymmetry", _COEFFICIENT),
        lambda m, b, p: p[_COEFFICIENT] * m.speed * direction(m),
    ),
    Term(
        Candidate("motor_torque_offset", "torque_nm", same_as=("load_torque_offset",)),
        lambda m, b, p: p["torque_nm"] * np.ones_like(m.speed),
    ),
    Term(
        Candidate("gravity_phase", "torque_nm"),
        lambda m, b, p: (
            _LOAD_LAWS["gravity_phase"](m, b.value("gear_ratio"), p) / b.value("gear_ratio")
        ),
    ),
    Term(
        Candidate("gear_mesh_friction", "coefficient", not_negative=True),
        lambda m, b, p: p["coefficient"] * np.abs(transmitted(m, b)) * direction(m),
    ),
    Term(
        Candidate("motor_torque_ripple", "torque_nm", freedom=2),
        _ripple,
        shape=ORDER,
        periodic=True,
    ),
    Term(
        Candidate("friction_drift", "rate_nm_per_s", contains="motor_coulomb_friction"),
        _drift,
        linear=("torque_nm",),
    ),
    Term(
        Candidate("encoder_eccentricity", "angle_rad", freedom=2),
        _eccentricity_torque,
        periodic=True,
    ),
    Term(Candidate(SKEW, "current_s"), lambda m, b, p: np.zeros_like(m.speed)),
)

_POSITION = (
    Term(
        Candidate("backlash", "gap_rad", not_negative=True),
        _backlash,
        shape="gap_rad",
        grid=tuple(np.geomspace(1e-5, 4e-3, 25)),
    ),
    Term(
        Candidate("shaft_hysteresis", "torque_nm", not_negative=True),
        _hysteresis,
        shape="angle_rad",
        grid=_REACHES,
    ),
    Term(
        Candidate("gear_transmission_error", "angle_rad", freedom=2),
        _transmission,
        shape=ORDER,
        periodic=True,
    ),
    Term(
        Candidate("encoder_eccentricity", "angle_rad", freedom=2),
        _eccentricity_position,
        periodic=True,
    ),
    Term(Candidate(SKEW, "position_s"), lambda m, b, p: np.zeros_like(m.speed)),
)

TORQUE_TERMS: Mapping[str, Term] = MappingProxyType({t.candidate.name: t for t in _TORQUE})
"""Effects in the torque at the motor."""

POSITION_TERMS: Mapping[str, Term] = MappingProxyType({t.candidate.name: t for t in _POSITION})
"""Effects in the load's position for a given motor position."""
