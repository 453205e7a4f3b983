"""Catalogue of the effects a real joint may have and the nominal bench lacks.

To add one: an entry here, its parameters' places in ``kernel.Slot`` (named
``effect__parameter``), its term in ``kernel.full_right_hand_side`` and a test of its law.

Signs: friction opposes motion; torques called losses stand on the side of the load in the
equation of motion, so a positive offset brakes forward rotation. Motor angles in the periodic
effects are zero where a relaxed shaft would hold the load at the start angle, or absolute where
the recording's ``motor_start_angle_rad`` is given.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bayesbl.bench.kernel import Slot
from bayesbl.errors import BenchError
from bayesbl.recording.channels import did_you_mean


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """One parameter of an effect.

    ``neutral``: the value at which the effect is off. ``low``, ``high``: range a search may use.
    ``shape_only``: it matters only while another parameter of the effect is not neutral; then
    ``neutral`` is a default.
    """

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    neutral: float = 0.0
    shape_only: bool = False


@dataclass(frozen=True, slots=True)
class Effect:
    """One entry of the catalogue.

    ``enters``: motor, load, shaft, loop or measurement. ``data``: what it looks like in a
    recording.
    """

    name: str
    sentence: str
    equation: str
    parameters: tuple[EffectParameter, ...]
    enters: str
    data: str
    reference: str
    slots: Mapping[str, Slot] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        slots = {item.name: Slot[f"{self.name}__{item.name}"] for item in self.parameters}
        object.__setattr__(self, "slots", slots)

    def values(self, given: Mapping[str, float]) -> dict[Slot, float]:
        """Slots and their values, what is not given at its neutral value.

        Raises
        ------
        BenchError
            If a parameter is not one of this effect's.
        """
        for name in given:
            if name not in self.slots:
                raise BenchError(
                    f"The effect {self.name} has no such parameter.",
                    found=name,
                    expected="one of " + ", ".join(self.slots),
                )
        return {
            self.slots[item.name]: float(given.get(item.name, item.neutral))
            for item in self.parameters
        }


_ARMSTRONG = "Armstrong-Hélouvry, Dupont & Canudas de Wit 1994, Automatica 30, 1083"
_PHASE = EffectParameter("phase_rad", "rad", "phase φ", -3.1416, 3.1416, shape_only=True)
_ORDER = EffectParameter(
    "order", "", "cycles per motor turn n, found from the data", 0.5, 64.0, 1.0, shape_only=True
)
_SKEW = "time by which this channel lags the true signal"

EFFECTS: tuple[Effect, ...] = (
    Effect(
        "backlash",
        "The gap itself, where the nominal bench has none.",
        "δ → δ + gap",
        (EffectParameter("gap_rad", "rad", "half the clearance, at the load", 1e-4, 4e-3),),
        "shaft",
        "two ringing pulses of opposite sign in each load rotation",
        "Nordin & Gutman 2002, Automatica 38, 1633",
    ),
    Effect(
        "motor_coulomb_friction",
        "Dry friction at the motor that does not depend on speed.",
        "J_m dω_m/dt: − T_c sign ω_m",
        (EffectParameter("torque_nm", "N m", "friction torque T_c", 0.0, 2.0),),
        "motor",
        "constant current offset that changes sign with the direction",
        _ARMSTRONG,
    ),
    Effect(
        "motor_viscous_friction",
        "Friction at the motor in proportion to speed.",
        "J_m dω_m/dt: − b ω_m",
        (EffectParameter("coefficient_nm_s_per_rad", "N m s/rad", "coefficient b", 0.0, 0.02),),
        "motor",
        "current offset that grows with the reference speed; a little more damping of the ringing",
        _ARMSTRONG,
    ),
    Effect(
        "motor_stribeck_friction",
        "Extra friction at low speed that fades as the lubricant film builds up.",
        "J_m dω_m/dt: − T_s exp(−(ω_m/ω_s)²) sign ω_m",
        (
            EffectParameter("torque_nm", "N m", "extra torque at standstill T_s", -2.0, 2.0),
            EffectParameter(
                "speed_rad_per_s", "rad/s", "fading speed ω_s", 1.0, 500.0, 50.0, shape_only=True
            ),
        ),
        "motor",
        "more current at low reference speeds than at high ones",
        _ARMSTRONG,
    ),
    Effect(
        "friction_asymmetry",
        "Viscous friction that differs between the two directions.",
        "J_m dω_m/dt: − c |ω_m|",
        (
            EffectParameter(
                "coefficient_nm_s_per_rad",
                "N m s/rad",
                "half the difference of the coefficients, forward less reverse",
                -0.01,
                0.01,
            ),
        ),
        "motor",
        "current offsets of forward and reverse recordings that differ in size, more at speed",
        _ARMSTRONG,
    ),
    Effect(
        "motor_torque_offset",
        "A constant torque at the motor that does not know the direction.",
        "J_m dω_m/dt: − T",
        (EffectParameter("torque_nm", "N m", "torque against forward rotation T", -2.0, 2.0),),
        "motor",
        "constant current offset of the same sign in both directions",
        "",
    ),
    Effect(
        "load_coulomb_friction",
        "Dry friction at the load, beyond the gap.",
        "J_l dω_l/dt: − T_c sign ω_l",
        (EffectParameter("torque_nm", "N m", "friction torque T_c", 0.0, 200.0),),
        "load",
        "pulses move away from half a rotation apart and change in size; current offset",
        _ARMSTRONG,
    ),
    Effect(
        "load_viscous_friction",
        "Friction at the load in proportion to its speed.",
        "J_l dω_l/dt: − b ω_l",
        (EffectParameter("coefficient_nm_s_per_rad", "N m s/rad", "coefficient b", 0.0, 100.0),),
        "load",
        "as load Coulomb friction, in proportion to the reference speed",
        _ARMSTRONG,
    ),
    Effect(
        "load_torque_offset",
        "A constant torque at the load that does not know the direction.",
        "J_l dω_l/dt: − T",
        (EffectParameter("torque_nm", "N m", "torque against forward rotation T", -200.0, 200.0),),
        "load",
        "pulses shift alike in both directions",
        "",
    ),
    Effect(
        "gravity_phase",
        "Gravity's direction is not where the load angle's zero says.",
        "J_l dω_l/dt: − m_c cos θ_l",
        (EffectParameter("torque_nm", "N m", "torque at θ_l = 0, m_c", -200.0, 200.0),),
        "load",
        "the whole rotation shifts in phase: a start angle in disguise unless θ_l is absolute",
        "",
    ),
    Effect(
        "gear_mesh_friction",
        "Loss in the gear in proportion to the torque it passes on.",
        "J_m dω_m/dt: − μ |τ_s|/N sign ω_m",
        (EffectParameter("coefficient", "", "share of the torque lost μ", 0.0, 0.5),),
        "motor",
        "current at twice the load rotation: more where gravity is lifted or held back",
        "Hamon, Gautier & Garrec 2010, IROS, 6187",
    ),
    Effect(
        "motor_torque_ripple",
        "Torque that repeats with the motor angle: cogging, current sensor errors.",
        "J_m dω_m/dt: − a sin(n θ_m + φ)",
        (
            EffectParameter("torque_nm", "N m", "amplitude a", -1.0, 1.0),
            _ORDER,
            _PHASE,
        ),
        "motor",
        "a line at order n of the motor speed in speed and current",
        "Holtz & Springob 1996, IEEE Trans. Ind. Electron. 43, 309",
    ),
    Effect(
        "gear_transmission_error",
        "The gear passes motion on unevenly, once or more per motor turn.",
        "Δθ → Δθ + a sin(n θ_m + φ), Δω → Δω + a n ω_m cos(n θ_m + φ)",
        (
            EffectParameter("angle_rad", "rad", "amplitude a at the load", -1e-3, 1e-3),
            _ORDER,
            _PHASE,
        ),
        "shaft",
        "a line at order n while the teeth touch, gone while they do not",
        "Tuttle & Seering 1996, IEEE Trans. Robot. Autom. 12, 368",
    ),
    Effect(
        "encoder_eccentricity",
        "The encoder disc sits off centre: the measured angle sways once per motor turn.",
        "θ_meas = θ_m + e sin(θ_m + φ), ω_meas = ω_m (1 + e cos(θ_m + φ)), inside the loop",
        (EffectParameter("angle_rad", "rad", "amplitude e", -0.02, 0.02), _PHASE),
        "loop",
        "a line at the motor's rotation in speed, answered by the current",
        "",
    ),
    Effect(
        "stiffness_hardening",
        "The shaft stiffens as it is wound up.",
        "τ_s + k₃ e³, e the compression beyond the gap",
        (EffectParameter("stiffness_nm_per_rad3", "N m/rad³", "k₃", -1e9, 1e10),),
        "shaft",
        "ringing faster under high load torque than under low",
        "Tuttle & Seering 1996, IEEE Trans. Robot. Autom. 12, 368",
    ),
    Effect(
        "shaft_hysteresis",
        "Dry friction inside the shaft (Dahl): torque that depends on where the twist came from.",
        "τ_s + T z, dz/dt = (Δω/θ_p)(1 − z sign Δω), also inside the gap",
        (
            EffectParameter("torque_nm", "N m", "friction torque T", 0.0, 200.0),
            EffectParameter(
                "angle_rad", "rad", "twist that builds it up θ_p", 1e-5, 1e-2, 1e-3, shape_only=True
            ),
        ),
        "shaft",
        "ringing that dies sooner; the gap is crossed more slowly",
        "Dahl 1976, AIAA Journal 14, 1675; Ruderman, Bertram & Iwasaki 2014, Mechatronics 24, 407",
    ),
    Effect(
        "current_loop_lag",
        "The motor torque follows the controller with a first-order lag.",
        "T dτ_m/dt = τ_demand − τ_m",
        (EffectParameter("time_s", "s", "time constant T", 0.0, 0.01),),
        "loop",
        "ringing less damped; current behind speed",
        "",
    ),
    Effect(
        "speed_sensor_lag",
        "The speed that the controller sees and records is filtered.",
        "T dω_meas/dt = ω_m − ω_meas",
        (EffectParameter("time_s", "s", "time constant T", 0.0, 0.01),),
        "loop",
        "ringing less damped; pulse fronts rounded",
        "",
    ),
    Effect(
        "friction_drift",
        "Motor friction that changes during the recording as the joint warms up.",
        "J_m dω_m/dt: − (T₀ + r t) sign ω_m",
        (
            EffectParameter("torque_nm", "N m", "friction at the start T₀", -2.0, 2.0),
            EffectParameter("rate_nm_per_s", "N m/s", "change r", -0.05, 0.05),
        ),
        "motor",
        "current that drifts from rotation to rotation",
        "",
    ),
    Effect(
        "channel_time_skew",
        "One channel lags the others by a fixed time.",
        "channel(t) → channel(t − T)",
        (
            EffectParameter("position_s", "s", _SKEW, -0.01, 0.01),
            EffectParameter("speed_s", "s", _SKEW, -0.01, 0.01),
            EffectParameter("current_s", "s", _SKEW, -0.01, 0.01),
        ),
        "measurement",
        "channels whose pulses do not start together",
        "",
    ),
)

EFFECT_BY_NAME: Mapping[str, Effect] = {effect.name: effect for effect in EFFECTS}


def effect_named(name: str) -> Effect:
    """Catalogue entry of that name.

    Raises
    ------
    BenchError
        If there is none.
    """
    if name not in EFFECT_BY_NAME:
        raise BenchError(
            "There is no such effect." + did_you_mean(name, EFFECT_BY_NAME),
            found=name,
            expected="one of " + ", ".join(EFFECT_BY_NAME),
        )
    return EFFECT_BY_NAME[name]
