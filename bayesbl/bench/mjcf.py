"""Export a joint with its measured gap as a MuJoCo model (MJCF).

Motor, shaft and load are bodies in series, all referred to the load:

    motor (J_m N²) ── hinge with spring K_s and damper D_s ── hinge within ±δ ── load (J_l, m g l)

The stop of the last hinge is rigid. Only the shaft's spring and damper yield, and only while the
teeth touch. Friction of the load is that of a tendon over all three hinges, whose length is the
load's angle. The motor's torque is that of the actuator. No controller is written, since MJCF has
none with a period and an integral. MJCF names: https://mujoco.readthedocs.io.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping

from bayesbl.bench.bench import Bench
from bayesbl.bench.effects import EFFECTS
from bayesbl.bench.kernel import Slot
from bayesbl.errors import BenchError
from bayesbl.units import STANDARD_GRAVITY

SHAFT_SHARE = 1e-3
"""Share of the load's inertia assigned to the shaft between spring and gap, because a body needs an
inertia. The load has the rest."""

STEPS_PER_PERIOD = 50.0
"""Time steps per period of the shaft's own inertia on its spring, the fastest oscillation."""

STOP_STEPS, STOP_HOLDS = 4.0, "0.99 0.999 0.00001"
"""Time constant of the stop in steps, and its MuJoCo impedance: as stiff as the step allows. The
stop yields by a thousandth of the shaft's deflection."""

LEAST_INERTIA = 1e-9
"""Smallest inertia of a body, kg m²."""

WRITTEN = (
    "motor_coulomb_friction",
    "motor_viscous_friction",
    "load_coulomb_friction",
    "load_viscous_friction",
)
"""Effects that MJCF can express."""


def mjcf(bench: Bench, gap_rad: float, values: Mapping[str, float] | None = None) -> str:
    """Write the joint as MJCF.

    Parameters
    ----------
    bench
        A bench of two masses.
    gap_rad
        δ, half of the play, at the load.
    values
        Values that replace the bench's, by slot (``shaft_stiffness_nm_per_rad``,
        ``motor_viscous_friction__coefficient_nm_s_per_rad``, …).

    Returns
    -------
    An XML text with hinges ``motor``, ``shaft`` and ``gap`` and an actuator ``torque``, N m at the
    motor. Effects of bench and ``values`` that MJCF cannot express are listed in a comment.

    Raises
    ------
    BenchError
        If the bench is rigid.
    """
    if bench.drive == "rigid":
        raise BenchError(
            "A rigid bench has no gap.", found='drive = "rigid"', expected='drive = "two_mass"'
        )
    vector = bench.vector(**dict(values or {}))[0]

    def value(slot: Slot) -> float:
        return float(vector[slot])

    ratio, inertia = value(Slot.gear_ratio), value(Slot.load_inertia_kg_m2)
    root = ET.Element("mujoco", model="joint")
    unsupported = [
        effect.name
        for effect in EFFECTS
        if effect.name not in WRITTEN
        and any(value(effect.slots[item.name]) != 0.0 for item in effect.amplitudes)
    ]
    unsupported += [learned.block for learned in bench.learned_terms]
    if unsupported:
        root.append(ET.Comment(f" Not written: {', '.join(unsupported)} "))
    ET.SubElement(root, "compiler", angle="radian")
    stiffness = value(Slot.shaft_stiffness_nm_per_rad)
    period_s = 2.0 * math.pi * math.sqrt(SHAFT_SHARE * inertia / stiffness)
    step_s = period_s / STEPS_PER_PERIOD
    ET.SubElement(
        root,
        "option",
        timestep=_text(step_s),
        integrator="implicitfast",
        gravity=f"0 0 {-STANDARD_GRAVITY}",
    )
    motor = _body(ET.SubElement(root, "worldbody"), "motor")
    _hinge(
        motor,
        "motor",
        armature=value(Slot.motor_inertia_kg_m2) * ratio**2,
        frictionloss=value(Slot.motor_coulomb_friction__torque_nm) * ratio,
        damping=value(Slot.motor_viscous_friction__coefficient_nm_s_per_rad) * ratio**2,
    )
    _inertia(motor, 0.0)  # its rotor is the hinge's armature
    shaft = _body(motor, "shaft")
    _hinge(
        shaft,
        "shaft",
        stiffness=stiffness,
        damping=value(Slot.shaft_damping_nm_s_per_rad),
    )
    _inertia(shaft, SHAFT_SHARE * inertia)
    load = _body(shaft, "load")
    _hinge(
        load,
        "gap",
        range=f"{_text(-gap_rad)} {_text(gap_rad)}",
        limited="true",
        solreflimit=f"{_text(STOP_STEPS * step_s)} 1",
        solimplimit=STOP_HOLDS,
    )
    gravity = value(Slot.gravity_torque_nm), value(Slot.gravity_angle_rad)
    _inertia(load, (1.0 - SHAFT_SHARE) * inertia, *gravity)
    friction = {
        "frictionloss": value(Slot.load_coulomb_friction__torque_nm),
        "damping": value(Slot.load_viscous_friction__coefficient_nm_s_per_rad),
    }
    angle = ET.SubElement(
        ET.SubElement(root, "tendon"), "fixed", {"name": "load"} | _texts(friction)
    )
    for joint in ("motor", "shaft", "gap"):
        ET.SubElement(angle, "joint", joint=joint, coef="1")
    ET.SubElement(
        ET.SubElement(root, "actuator"), "motor", name="torque", joint="motor", gear=_text(ratio)
    )
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _body(parent: ET.Element, name: str) -> ET.Element:
    return ET.SubElement(parent, "body", name=name)


def _hinge(body: ET.Element, name: str, **values: float | str) -> None:
    kind = {"name": name, "type": "hinge", "axis": "0 1 0"}
    ET.SubElement(body, "joint", kind | _texts(values))


def _texts(values: Mapping[str, float | str]) -> dict[str, str]:
    return {k: v if isinstance(v, str) else _text(v) for k, v in values.items() if v != 0.0}


def _text(value: float) -> str:
    # No minus before zero.
    return f"{value + 0.0:.9g}"


def _inertia(body: ET.Element, inertia: float, torque_nm: float = 0.0, at_rad: float = 0.0) -> None:
    """Add an inertia about the hinge, with a mass that hangs ``at_rad`` before the angle 0."""
    arm = mass = 0.0
    if torque_nm != 0.0:
        # The arm is so short that more than a third of the inertia is the body's own.
        arm = min(0.5, 0.6 * inertia * STANDARD_GRAVITY / torque_nm)
        mass = torque_nm / (STANDARD_GRAVITY * arm)
    body_inertia = max(inertia - mass * arm**2, LEAST_INERTIA)
    position = f"{_text(-arm * math.sin(at_rad))} 0 {_text(-arm * math.cos(at_rad))}"
    size = " ".join([_text(body_inertia)] * 3)
    ET.SubElement(body, "inertial", pos=position, mass=_text(max(mass, 1e-3)), diaginertia=size)
