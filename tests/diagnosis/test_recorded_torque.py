"""What the drive and the recorder do to the torque of a rigid axis is not called the axis."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from bayesbl.bench.bench import Bench, BenchParameter
from bayesbl.bench.effects import effect_named
from bayesbl.diagnosis.diagnosis import Diagnosis, Estimate, ParameterError
from bayesbl.diagnosis.inference import candidate_of, diagnose
from bayesbl.diagnosis.rigid.inverse import (
    TORQUE_CONSTANT,
    TORQUE_LAWS,
    InverseView,
    compared,
    within_turns,
    without_load_angle,
)
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_POSITION, FloatArray, Recording

INERTIA, COULOMB, VISCOUS, OFFSET = 0.02, 0.5, 0.1, 0.1
HZ = 500.0
BENCH = Bench(
    {
        name: BenchParameter(value, tolerance)
        for name, value, tolerance in (
            ("gear_ratio", 1.0, 0.0),
            ("motor_inertia_kg_m2", INERTIA, 0.05 * INERTIA),
            ("load_inertia_kg_m2", 1e-9, 0.0),
            ("gravity_torque_nm", 0.0, 0.0),
            ("torque_constant_nm_per_a", 1.0, 0.0),
            ("current_limit_a", 1e3, 0.0),
            ("shaft_stiffness_nm_per_rad", 1e5, 0.0),
            ("shaft_damping_nm_s_per_rad", 100.0, 0.0),
            ("speed_gain_nm_s_per_rad", 0.2, 0.0),
            ("integral_gain_nm_per_rad", 2.0, 0.0),
            ("reference_speed_rpm", 300.0, 0.0),
        )
    },
    drive="rigid",
)

Torque = Callable[[str, FloatArray, FloatArray], FloatArray]


def moving(name: str, top: float, torque: Torque) -> Recording:
    """Moves back and forth at a top speed, rad/s; ``torque``: by name, speed and acceleration."""
    rng = np.random.default_rng(ord(name))
    time = np.arange(6000) / HZ
    pushes = []
    while sum(map(len, pushes)) < time.size:
        sign = -1.0 if len(pushes) % 2 else 1.0
        steady, rest = round(rng.uniform(0.9, 3.0) / top * HZ), round(rng.uniform(0.05, 0.3) * HZ)
        push = sign * 8.0 * top * np.ones(round(HZ / 8.0))
        pushes.append(np.concatenate([push, np.zeros(steady), -push, np.zeros(rest)]))
    window = np.hanning(25)
    smooth = np.convolve(np.concatenate(pushes)[: time.size], window / window.sum(), "same")
    speed = np.cumsum(smooth) / HZ
    # The sum of speeds is half a sample ahead of their integral.
    position = np.cumsum(speed) / HZ + 1e-5 * rng.standard_normal(time.size)
    current = torque(name, speed, np.gradient(speed, time))
    current = current + 0.02 * rng.standard_normal(time.size)
    return Recording(name, time, {MOTOR_POSITION: position, MOTOR_CURRENT: current})


def friction(speed: FloatArray) -> FloatArray:
    return np.asarray(COULOMB * np.tanh(speed / 0.02) + VISCOUS * speed)


def diagnosed(torque: Torque) -> Diagnosis:
    made = [moving(*pair, torque) for pair in (("a", 1.0), ("b", 4.0))]
    parts = [part for r in made for part in compared(r, MOTOR_CURRENT, ("used",), 60.0)]
    laws = within_turns(without_load_angle(TORQUE_LAWS), 0.1)
    view = InverseView(tuple(parts), BENCH, laws, ("motor_inertia_kg_m2",))
    return diagnose(view, BENCH, most=6)


def sizes(found: Diagnosis) -> dict[str, float]:
    return {e.name: next(iter(e.parameters.values())).value for e in found.effects}


@pytest.mark.long
def test_a_torque_half_a_sample_late_is_no_skew_and_leaves_friction_its_size() -> None:
    """Viscous friction is half of all: a smaller part may be another form of dry friction's."""
    found = diagnosed(lambda _, v, a: INERTIA * a + friction(v) + OFFSET)
    named = sizes(found)
    assert named["motor_coulomb_friction"] == pytest.approx(COULOMB, rel=0.02)
    assert named["motor_viscous_friction"] == pytest.approx(VISCOUS, rel=0.05)
    assert named.keys() == {
        "motor_coulomb_friction",
        "motor_viscous_friction",
        "motor_torque_offset",
    }


CABLE = 0.1


def late(torque: FloatArray) -> FloatArray:
    """Behind a low pass of 25 ms, as a drive records it."""
    kept = math.exp(-1.0 / HZ / 0.025)
    return np.asarray(lfilter([1.0 - kept], [1.0, -kept], torque))


BESIDE: dict[str, Torque] = {
    "late": lambda _, v, a: late(INERTIA * a + friction(v)),
    "warm": lambda n, v, a: INERTIA * a + (1.1 if n == "b" else 0.9) * friction(v),
    "root": lambda _, v, a: (
        INERTIA * a + friction(v) + 0.1 * np.sqrt(np.abs(v)) * np.tanh(v / 0.02)
    ),
    "cable": lambda _, v, a: INERTIA * a + friction(v) + CABLE * np.cumsum(v) / HZ,
    "payload": lambda n, v, a: (1.6 if n == "b" else 0.4) * INERTIA * a + friction(v),
}
"""What real axes have beside their laws; friction and load of both recordings are right on average.
"""


@pytest.mark.long
@pytest.mark.parametrize("beside", BESIDE)
def test_what_no_axis_lacks_leaves_the_laws_within_their_intervals(beside: str) -> None:
    found = diagnosed(BESIDE[beside])
    true = {
        "motor_coulomb_friction": COULOMB,
        "motor_viscous_friction": VISCOUS,
        "channel_time_skew": 0.025,
        "motor_inertia_kg_m2": INERTIA,
    }
    stated: dict[str, Estimate] = dict(found.bench_parameters)
    stated |= {e.name: next(iter(e.parameters.values())) for e in found.effects}
    told = " ".join(found.notes)
    assert ("motor_inertia_kg_m2 differs between the recordings" in told) == (beside == "payload")
    assert ("motor_coulomb_friction differs" in told) <= (beside == "warm")
    if beside == "cable":
        stated.pop("motor_torque_offset", None)  # where a cable's torque vanishes is open
    told_nm_per_rad = re.findall(r"does, by (\S+) ± (\S+) N m per rad", told)
    assert bool(told_nm_per_rad) == (beside == "cable")
    for value, sd in told_nm_per_rad:
        assert float(value) == pytest.approx(CABLE, abs=3.0 * float(sd))
    assert {"motor_coulomb_friction", "motor_inertia_kg_m2"} <= stated.keys() <= true.keys()
    assert ("channel_time_skew" in stated) == (beside == "late")
    for name, estimate in stated.items():
        assert estimate.value == pytest.approx(true[name], abs=3.0 * estimate.sd), name
    assert not found.parameter_errors


@pytest.mark.long
def test_a_wrong_torque_constant_looks_like_a_wrong_inertia_and_both_are_said() -> None:
    found = diagnosed(lambda _, v, a: math.sqrt(2.0) * (INERTIA * a + friction(v) + OFFSET))
    (error,) = found.parameter_errors
    assert error.fitted.value == pytest.approx(math.sqrt(2.0) * INERTIA, rel=0.02)
    assert error.indistinguishable_from == (TORQUE_CONSTANT,)
    assert any("off by one factor" in note for note in found.notes)


def test_a_pure_number_is_never_larger_than_in_any_joint() -> None:
    name = "gear_mesh_friction"
    made = candidate_of(TORQUE_LAWS[name], name, ("coefficient",), ())
    assert made.largest == effect_named(name).parameter("coefficient").high


GRAVITY = "gravity_torque_nm"


@pytest.mark.parametrize(
    ("stated", "gravity", "is_rival"),
    [(0.0, 5.0, True), (10.0, None, False), (10.0, 14.0, True), (10.0, 10.0, False)],
)
def test_the_scale_of_torque_must_explain_gravity_too_within_its_tolerance(
    stated: float, gravity: float | None, is_rival: bool
) -> None:
    made = moving("a", 1.0, lambda _, v, a: INERTIA * a + friction(v))
    bench = BENCH.with_parameters(gravity_torque_nm=stated)
    inertia = "motor_inertia_kg_m2"
    parts = tuple(compared(made, MOTOR_CURRENT, ("used",), 60.0))
    view = InverseView(parts, bench, {}, (inertia,), load_angle_known=True)
    estimates = {inertia: Estimate(1.4 * INERTIA, 1e-4)}
    errors = [ParameterError(inertia, INERTIA, 0.05 * INERTIA, estimates[inertia])]
    if gravity is not None:
        estimates[GRAVITY] = Estimate(gravity, 0.01)
        if stated == 0.0:
            errors.append(ParameterError(GRAVITY, 0.0, 0.0, estimates[GRAVITY]))
    assert view.rivals(errors, estimates) == ((TORQUE_CONSTANT,) if is_rival else ())
