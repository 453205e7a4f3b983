"""``kind = "bench"``: describe a bench file and what looks wrong in it; it cannot be run."""

from __future__ import annotations

import math
from pathlib import Path

from bayesbl.bench.bench import Bench
from bayesbl.bench.steady import contact_rates
from bayesbl.config.bench import load_bench, reduced_inertia_kg_m2
from bayesbl.runs.workflow import Plan
from bayesbl.units import STANDARD_GRAVITY

USUAL_FREQUENCY_HZ = (2.0, 100.0)
USUAL_INERTIA_RATIO = (0.05, 50.0)
USUAL_PENDULUM_M = (0.05, 3.0)  # for robot joints of any size; beyond, a unit is probably wrong


def describe(path: Path, plan: Plan) -> None:
    """Describe the virtual bench of a file, and what looks wrong in it."""
    bench = load_bench(path)
    plan.lines.append(("bench", f"drive {bench.drive}, gap form {bench.gap_form}"))
    if bench.drive == "two_mass":
        _look_at(bench, plan)
    if bench.effects:
        plan.lines.append(("effects", ", ".join(effect.name for effect in bench.effects)))
    known = ", ".join(
        f"{name} ± {100.0 * half / abs(bench.value(name)):.0f} %" if bench.value(name) else name
        for name, half in bench.tolerances.items()
    )
    plan.lines.append(("tolerances", known or "none: every value counts as exact"))


def _look_at(bench: Bench, plan: Plan) -> None:
    """Add derived quantities, and a warning for each that is unusual for a robot joint."""
    values = {name: parameter.value for name, parameter in bench.parameters.items()}
    stiffness, gravity_nm = values["shaft_stiffness_nm_per_rad"], values["gravity_torque_nm"]
    frequency_hz = math.sqrt(stiffness / reduced_inertia_kg_m2(values)) / (2.0 * math.pi)
    ratio = values["load_inertia_kg_m2"] / values["gear_ratio"] ** 2 / values["motor_inertia_kg_m2"]
    current_a = gravity_nm / values["gear_ratio"] / values["torque_constant_nm_per_a"]
    limit_a = bench.value("current_limit_a")
    # J_l g/(m g l): length of a point mass that swings as the load does, where one does.
    pendulum_m = values["load_inertia_kg_m2"] * STANDARD_GRAVITY / (gravity_nm or math.nan)
    plan.lines += [
        ("natural frequency", f"{frequency_hz:.3g} Hz, motor against load on the shaft"),
        ("inertia ratio", f"{ratio:.3g}, load over motor, both at the load"),
        ("current against gravity", f"{current_a:.3g} A of {limit_a:g} A, arm level"),
    ]
    for value, (low, high), text, culprits in (
        (
            frequency_hz,
            USUAL_FREQUENCY_HZ,
            f"a natural frequency of {frequency_hz:.3g} Hz",
            "inertias and stiffness",
        ),
        (ratio, USUAL_INERTIA_RATIO, f"an inertia ratio of {ratio:.3g}", "inertias and gear ratio"),
        (
            pendulum_m,
            USUAL_PENDULUM_M,
            f"a pendulum {pendulum_m:.3g} m long (a spring or counterweight makes it longer)",
            "load_inertia_kg_m2 and gravity_torque_nm",
        ),
    ):
        if value <= low or value >= high:
            plan.warnings.append(
                f"{text} is not that of a robot joint (usually {low:g} to {high:g}): check "
                f"{culprits}, and their units."
            )
    if current_a > limit_a:
        plan.warnings.append(
            f"gravity takes {current_a:.3g} A with the arm level, and the drive gives {limit_a:g} "
            "A: check gravity_torque_nm, gear_ratio, torque_constant_nm_per_a and current_limit_a."
        )
    if contact_rates(bench.vector())[0].real.max() > 1e-6:
        plan.warnings.append(
            "the speed loop is not stable with these gains: check speed_gain_nm_s_per_rad and "
            "integral_gain_nm_per_rad, and their units."
        )
