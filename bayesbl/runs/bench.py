"""A bench file; it is simulated on, not run; only what it is can be said, and what looks wrong."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from bayesbl.bench.bench import Bench
from bayesbl.bench.steady import contact_rates
from bayesbl.config.bench import STANDARD_GRAVITY, load_bench, reduced_inertia_kg_m2
from bayesbl.runs.workflow import Plan

USUAL_FREQUENCY_HZ = (2.0, 100.0)
USUAL_INERTIA_RATIO = (0.05, 50.0)
USUAL_PENDULUM_M = (0.05, 3.0)
"""Of robot joints, small arms to heavy ones; beyond them a unit is more probably wrong."""


def describe(path: Path, plan: Plan) -> None:
    """Which virtual bench the file holds, and what of it looks wrong."""
    bench = load_bench(path)
    plan.lines.append(("bench", f"drive {bench.drive}, gap form {bench.gap_form}"))
    if bench.drive == "two_mass":
        plan.lines += _derived(bench)
        plan.warnings += _doubts(bench)
    if bench.effects:
        plan.lines.append(("effects", ", ".join(effect.name for effect in bench.effects)))
    known = ", ".join(
        f"{name} ± {100.0 * half / abs(bench.value(name)):.0f} %" if bench.value(name) else name
        for name, half in bench.tolerances.items()
    )
    plan.lines.append(("tolerances", known or "none: every value counts as exact"))


def _derived(bench: Bench) -> Iterator[tuple[str, str]]:
    yield "natural frequency", f"{_frequency_hz(bench):.3g} Hz, motor against load on the shaft"
    yield "inertia ratio", f"{_inertia_ratio(bench):.3g}, load over motor, both at the load"
    yield (
        "current against gravity",
        f"{_steady_current_a(bench):.3g} A of {bench.value('current_limit_a'):g} A, arm level",
    )


def _doubts(bench: Bench) -> Iterator[str]:
    for what, value, unit, (low, high), culprit in (
        ("natural frequency", _frequency_hz(bench), " Hz", USUAL_FREQUENCY_HZ, "stiffness"),
        ("inertia ratio", _inertia_ratio(bench), "", USUAL_INERTIA_RATIO, "gear ratio"),
    ):
        if not low < value < high:
            yield (
                f"the {what} of {value:.3g}{unit} is not that of a robot joint (usually {low:g} "
                f"to {high:g}): check the inertias and the {culprit}, and their units."
            )
    low, high = USUAL_PENDULUM_M
    gravity_nm = bench.value("gravity_torque_nm")
    # J_l g/(m g l): length of a point mass that swings as the load does, where one does.
    pendulum_m = bench.value("load_inertia_kg_m2") * STANDARD_GRAVITY / (gravity_nm or math.nan)
    if pendulum_m <= low or pendulum_m >= high:
        yield (
            f"load inertia and gravity torque are those of a pendulum {pendulum_m:.3g} m long "
            f"(usually {low:g} to {high:g}): check load_inertia_kg_m2 and gravity_torque_nm, and "
            "their units. A spring or counterweight makes it longer."
        )
    if _steady_current_a(bench) > bench.value("current_limit_a"):
        yield (
            f"gravity takes {_steady_current_a(bench):.3g} A with the arm level, and the drive "
            f"gives {bench.value('current_limit_a'):g} A: check gravity_torque_nm, gear_ratio, "
            "torque_constant_nm_per_a and current_limit_a."
        )
    poles = contact_rates(bench.vector())[0]
    if poles.real.max() > 1e-6:
        yield (
            "the speed loop is not stable with these gains: check speed_gain_nm_s_per_rad and "
            "integral_gain_nm_per_rad, and their units."
        )


def _frequency_hz(bench: Bench) -> float:
    values = {name: parameter.value for name, parameter in bench.parameters.items()}
    stiffness = values["shaft_stiffness_nm_per_rad"]
    return math.sqrt(stiffness / reduced_inertia_kg_m2(values)) / (2.0 * math.pi)


def _inertia_ratio(bench: Bench) -> float:
    motor = bench.value("gear_ratio") ** 2 * bench.value("motor_inertia_kg_m2")
    return bench.value("load_inertia_kg_m2") / motor


def _steady_current_a(bench: Bench) -> float:
    torque = bench.value("gravity_torque_nm") / bench.value("gear_ratio")
    return torque / bench.value("torque_constant_nm_per_a")
