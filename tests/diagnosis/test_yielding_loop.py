"""Ripples of an axis whose loop is slower than they are: most of them is in the motion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bayesbl.config.bench import parse_bench
from bayesbl.diagnosis.diagnosis import Diagnosis
from bayesbl.diagnosis.inference import diagnose
from bayesbl.diagnosis.rigid.inverse import (
    TORQUE_LAWS,
    InverseView,
    coherent_hz,
    compared,
    resolved_hz,
    without_load_angle,
)
from bayesbl.recording.types import MOTOR_POSITION, MOTOR_TORQUE, FloatArray, Recording

pytestmark = pytest.mark.long

HZ, CONTROLLER_HZ = 500.0, 2000.0
INERTIA, COULOMB_NM, VISCOUS = 2.8e-4, 0.03, 3e-4
LOOP_RAD_PER_S = 60.0  # 10 Hz
RIPPLE_NM = 0.02
BENCH = """
schema = 1
kind = "bench"
drive = "rigid"
[parameters]
gear_ratio = {value = 1.0}
motor_inertia_kg_m2 = {value = 2.8e-4}
load_inertia_kg_m2 = {value = 1e-12}
"""


def reference(points_rad: list[float], speeds: list[float], lasting_s: float) -> FloatArray:
    """Moves from point to point with raised-cosine speed, at the controller's rate."""
    parts, here = [np.full(200, points_rad[0])], points_rad[0]
    for k in range(1, 100):
        there, fastest = points_rad[k % len(points_rad)], speeds[k % len(speeds)]
        count = max(200, round(2.0 * abs(there - here) / fastest * CONTROLLER_HZ))
        s = np.arange(count) / count
        parts += [here + (there - here) * (s - np.sin(2.0 * math.pi * s) / (2.0 * math.pi))]
        parts += [np.full(400, there)]
        here = there
    return np.concatenate(parts)[: round(lasting_s * CONTROLLER_HZ)]


def recorded(
    name: str, asked: FloatArray, ripples: dict[float, float], seed: int, late_s: float = 0.0
) -> Recording:
    """A rigid axis under a slow position loop; encoder of 2¹⁵ steps, white noise of the torque."""
    rng = np.random.default_rng(seed)
    period, inside = 1.0 / CONTROLLER_HZ, 2
    speed_asked = np.gradient(asked, period)
    ahead = INERTIA * np.gradient(speed_asked, period)
    angle, speed, step = float(asked[0]), 0.0, 2.0 * math.pi / 2**15
    angles, torques = np.empty(asked.size), np.empty(asked.size)
    for k in range(asked.size):
        shown = math.floor(angle / step) * step
        torque = ahead[k] + INERTIA * LOOP_RAD_PER_S * (
            1.4 * (speed_asked[k] - speed) + LOOP_RAD_PER_S * (asked[k] - shown)
        )
        angles[k], torques[k] = shown, torque
        for _ in range(inside):
            against = COULOMB_NM * math.tanh(speed / 0.5) + VISCOUS * speed
            against += sum(size * math.sin(order * angle) for order, size in ripples.items())
            speed += period / inside * (torque - against) / INERTIA
            angle += period / inside * speed
    time = np.arange(asked.size) * period
    torques = np.interp(time - late_s, time, torques)
    kept = slice(None, None, round(CONTROLLER_HZ / HZ))
    torque_nm = torques[kept] + 0.01 * rng.standard_normal(angles[kept].size)
    return Recording(name, time[kept], {MOTOR_POSITION: angles[kept], MOTOR_TORQUE: torque_nm})


def found(recordings: list[Recording]) -> Diagnosis:
    bench = parse_bench(BENCH, "bench.toml")

    def below(cutoff_hz: float) -> InverseView:
        parts = [p for r in recordings for p in compared(r, MOTOR_TORQUE, ("used",), cutoff_hz)]
        return InverseView(
            tuple(parts),
            bench,
            without_load_angle(TORQUE_LAWS),
            phases_shared=True,
        )

    resolved = resolved_hz([r.channels[MOTOR_POSITION] for r in recordings], 1.0 / HZ)
    made = below(coherent_hz(below(min(resolved, 0.4 * HZ))) or resolved)
    return diagnose(made, bench, most=6)


MOVES = [
    reference([0.0, 80.0, -50.0, 40.0], [40.0, 80.0, 130.0], 12.0),
    reference([0.0, -90.0, 60.0, 10.0], [60.0, 130.0, 90.0], 12.0),
]


@pytest.mark.parametrize("ripples", [{2.0: RIPPLE_NM}, {2.0: RIPPLE_NM, 4.0: 0.008}])
def test_a_ripple_that_the_loop_yields_to_is_named_with_its_size_and_is_no_delay(
    ripples: dict[float, float],
) -> None:
    answer = found([recorded(str(k), move, ripples, k) for k, move in enumerate(MOVES)])
    named = {effect.name: effect.parameters for effect in answer.effects}
    assert "channel_time_skew" not in named
    assert named["motor_torque_ripple"]["order"].value == pytest.approx(2.0, abs=2e-3)
    assert named["motor_torque_ripple"]["torque_nm"].value == pytest.approx(RIPPLE_NM, rel=0.05)
    assert named["motor_coulomb_friction"]["torque_nm"].value == pytest.approx(COULOMB_NM, rel=0.05)


def test_a_delay_beside_a_ripple_is_found_with_its_size() -> None:
    late_s = 4e-3
    moves = enumerate(MOVES)
    answer = found([recorded(str(k), move, {2.0: RIPPLE_NM}, k, late_s) for k, move in moves])
    named = {effect.name: effect.parameters for effect in answer.effects}
    assert named["channel_time_skew"]["current_s"].value == pytest.approx(late_s, rel=0.1)
