"""Whether the load changes from one tooth flank to the other while a joint turns at one speed.

At constant speed the gear passes on what the load asks for alone,

    τ_s(θ) = m g l sin θ + torques at the load (offset, friction, what was learned there).

Where that keeps its sign over a rotation (a vertical axis, a balanced arm, an arm that is loaded to
one side) there is no impact, and nothing of a recording at that speed depends on the gap.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.bench.effect_declaration import RigidMotion
from bayesbl.bench.effects import effect_named
from bayesbl.errors import NoFlankChange
from bayesbl.units import RPM_PER_RAD_PER_S

_ANGLES = 720


def steady_rotation(bench: Bench, reference_speed_rpm: float) -> RigidMotion:
    """One rotation of the load at a constant speed, from where it hangs straight down."""
    ratio, speed = bench.value("gear_ratio"), reference_speed_rpm / RPM_PER_RAD_PER_S
    angle = math.copysign(ratio, speed) * np.linspace(0.0, 2.0 * math.pi, _ANGLES)
    speeds = np.full(_ANGLES, speed)
    sway = -(speeds**2) * np.exp(1j * angle)
    return RigidMotion(angle / speed, angle, speeds, np.zeros(_ANGLES), sway)


def steady_torque_nm(bench: Bench, reference_speed_rpm: float) -> tuple[float, float]:
    """Smallest and largest torque that the gear passes on in a rotation, N m at the load."""
    motion = steady_rotation(bench, reference_speed_rpm)
    ratio = bench.value("gear_ratio")
    torque = ratio * bench.transmitted_torque(motion)
    for term in bench.learned_terms:
        if term.side == "load":
            torque = torque + ratio * term.along(motion, ratio)
    return float(torque.min()), float(torque.max())


def heaviest(bench: Bench) -> Bench:
    """With all the gravity that its tolerance allows."""
    gravity = bench.parameters["gravity_torque_nm"]
    return bench.with_parameters(gravity_torque_nm=gravity.value + gravity.tolerance)


def require_flank_change(
    bench: Bench, speeds_rpm: Sequence[float] = (), file: str | Path | None = None
) -> None:
    """Refuse speeds, all of them, at which a bench leaves the load on one flank.

    Parameters
    ----------
    speeds_rpm
        Of the motor; the bench's own by default.
    file
        Of the bench or the recording, to be named.

    Raises
    ------
    NoFlankChange
        With the torque, and the motion that would show the gap.
    """
    speeds = speeds_rpm or [bench.value("reference_speed_rpm")]
    torques = [steady_torque_nm(bench, speed) for speed in speeds]
    if bench.drive == "rigid" or any(low < 0.0 < high for low, high in torques):
        return
    acting = [e.name for e in bench.effects if effect_named(e.name).load_torque is not None]
    low, high = torques[0]
    raise NoFlankChange(
        "At this speed the load never changes from one tooth flank to the other, so nothing that "
        "is recorded depends on the gap.",
        file=file,
        where="gravity_torque_nm" + "".join(f", {name}" for name in acting),
        found=f"a torque of {low:.4g} to {high:.4g} N m at the load over a rotation at "
        f"{speeds[0]:.4g} rpm",
        expected=f"{NoFlankChange.MOTION}, or a bench whose load torque changes its sign",
    )
