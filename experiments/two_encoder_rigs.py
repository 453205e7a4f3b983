"""Rigs with two encoders as others build and log them: does the play come out of their recordings?

    bayesbl run configs/two_encoder_rigs.toml

An independent simulator: motor and load as two masses behind a dead zone with a spring and a damper
(semi-implicit Euler, 25 µs), Coulomb and viscous friction, gravity, a position controller with a
limit; then encoders of their own resolution, eccentricity and noise, stamps that jitter and are
late, and a motor's torque with noise. Each rig is a kind of machine; each case draws play, motion,
encoder faults and seeds anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import Field
from study_tools import StudyRow
from two_encoders import COLUMNS as COLUMNS
from two_encoders import Joint, scored
from two_encoders import summarise as summarise

from bayesbl.two_encoders.paths import Channels

Array = NDArray[np.float64]

STEP_S = 1e-4
JITTER_OF_PLAY = 0.7
"""Half the width of ln play around a rig's own."""


@dataclass(frozen=True)
class Rig:
    """A kind of machine; rad: whole play, eccentricity, and what friction winds up (``wound``)."""

    play: float
    ratio: float
    motion: str
    amplitude: float
    rate_hz: float
    load: str = "dragged"
    period_s: float = 4.0
    duration_s: float = 40.0
    jitter: float = 0.0
    motor_counts: int = 2**14
    load_counts: int = 2**14
    skew_s: float = 0.0
    eccentric: float = 0.0
    wound: float = 1e-4
    has_torque: bool = True
    stated: float | None = 1.0  # times the ratio


RIGS = MappingProxyType(
    {
        "collaborative joint": Rig(
            2e-3, 100, "multisine", 1.2, 500, motor_counts=2**17, load_counts=2**19, eccentric=1e-3
        ),
        "collaborative joint under gravity": Rig(
            2e-3, 100, "multisine", 2.5, 125, "pendulum",
            motor_counts=2**17, load_counts=2**19, eccentric=2e-3,
        ),
        "hobby servo, 50 Hz": Rig(
            0.035, 254, "sine", 0.8, 50, duration_s=60, motor_counts=64, load_counts=4096,
            has_torque=False, stated=None,
        ),
        "printed planetary": Rig(0.02, 14, "triangle", 2.0, 100, eccentric=4e-3),
        "planetary, skewed": Rig(
            8e-3, 9, "sine", 1.5, 320, jitter=0.2, motor_counts=8192, skew_s=2e-3
        ),
        "wide play, dragged": Rig(
            1.0, 1, "sine", 3.0, 200, duration_s=60, motor_counts=4096, load_counts=4096,
            has_torque=False,
        ),
        "wide play, light load": Rig(
            0.9, 1, "multisine", 3.0, 200, "light", duration_s=60, motor_counts=4096,
            load_counts=4096, stated=None,
        ),
        "flywheel": Rig(
            0.05, 1, "multisine", 2.0, 1000, "inertia", period_s=3, duration_s=30,
            motor_counts=10000, load_counts=10000,
        ),
        "random steps": Rig(
            0.06, 70, "random", 0.8, 500, "light", period_s=2, motor_counts=4096, load_counts=4096,
            has_torque=False,
        ),
        "worm gear, 20 Hz": Rig(
            4e-3, 360, "strokes", 0.15, 20, period_s=10, duration_s=200, motor_counts=400,
            load_counts=2**23, has_torque=False,
        ),
        "knee of a humanoid": Rig(
            5e-3, -50, "drift", 1.0, 200, "pendulum", eccentric=8e-3, skew_s=-4e-3
        ),
        "no play, eccentric": Rig(
            0.0, 14, "sine", 2.0, 325, jitter=0.3, eccentric=0.015, wound=2e-5, has_torque=False
        ),
        "no play, skewed": Rig(
            0.0, 100, "sine", 1.0, 250, motor_counts=2**17, load_counts=2**20, skew_s=5e-3,
            wound=2e-5,
        ),
        "no play, wrong ratio": Rig(
            0.0, 101, "multisine", 1.5, 250, load_counts=2**18, eccentric=3e-3, wound=2e-5,
            has_torque=False, stated=100 / 101,
        ),
        "no play, elastic": Rig(0.0, 80, "multisine", 1.0, 500, load_counts=2**18, wound=1e-3),
        "no play, one speed": Rig(
            0.0, 50, "triangle", 1.0, 100, load_counts=2**16, skew_s=8e-3, wound=2e-5,
            has_torque=False,
        ),
        "strain wave": Rig(
            1.2e-4, 100, "slow and fast", 0.8, 1000, motor_counts=2**17, load_counts=2**23,
            eccentric=2e-4, wound=2e-5,
        ),
        "strain wave, new": Rig(
            2e-5, 120, "slow and fast", 0.8, 1000, motor_counts=2**20, load_counts=2**25, wound=5e-6
        ),
        "half a milliradian": Rig(
            5e-4, 100, "multisine", 0.8, 250, load_counts=2**20, wound=3e-5, has_torque=False
        ),
        "strokes": Rig(0.012, 20, "strokes", 0.6, 100, period_s=6, duration_s=60),
        "reversed load": Rig(
            0.02, -30, "chirp", 1.0, 200, duration_s=60, load_counts=4096, has_torque=False
        ),
        "industrial arm": Rig(0.01, 50, "multisine", 1.0, 125, load_counts=2**16),
        "arm held by its weight": Rig(
            3e-3, 160, "drift", 1.2, 250, "held", period_s=6, duration_s=60, motor_counts=2**13,
            load_counts=2**20,
        ),
        "arm over its balance": Rig(
            0.07, 50, "sine", 1.6, 100, "pendulum", period_s=1.8, duration_s=30, skew_s=3e-3,
            has_torque=False, stated=None,
        ),
        "wheel": Rig(
            0.03, 5, "sine", 12.0, 200, "light", period_s=8, duration_s=60, has_torque=False
        ),
        "free load": Rig(
            0.25, 1, "multisine", 1.5, 500, "free", motor_counts=8000, load_counts=8000,
            has_torque=False, stated=None,
        ),
        "coarse encoders": Rig(
            0.04, 30, "sine", 1.0, 50, duration_s=60, motor_counts=48, load_counts=1024,
            has_torque=False,
        ),
    }
)  # fmt: skip


class Row(StudyRow):
    """A row: which rig."""

    rig: str = Field(pattern="|".join(f"^{name}$" for name in RIGS))

    @property
    def play(self) -> bool:
        """Whether it has any."""
        return RIGS[self.rig].play > 0.0


def reference(rig: Rig, amplitude: float, period: float, generator: np.random.Generator) -> Array:
    """Load angle asked for at every step."""
    time = np.arange(0.0, rig.duration_s, STEP_S)
    phase = 2.0 * np.pi * time / period
    if rig.motion == "sine":
        path = np.sin(phase)
    elif rig.motion == "multisine":
        shares = ((1.0, 0.6), (1.7, 0.3), (3.1, 0.15))
        waves = [a * np.sin(phase * f + generator.uniform(0.0, 6.28)) for f, a in shares]
        path = np.sum(waves, axis=0)
    elif rig.motion == "triangle":
        path = 2.0 / np.pi * np.arcsin(0.995 * np.sin(phase))
    elif rig.motion == "strokes":
        path = np.clip(3.0 / np.pi * np.arcsin(np.sin(phase)), -1.0, 1.0)
    elif rig.motion == "chirp":
        rising = 0.4 * time + 1.3 * time**2 / rig.duration_s
        path = np.sin(2.0 * np.pi * rising / period) * np.linspace(1.0, 0.5, time.size)
    elif rig.motion == "random":
        steps = generator.uniform(-1.0, 1.0, int(2.0 * rig.duration_s / period) + 2)
        path = steps[(2.0 * time / period).astype(int)]
    elif rig.motion == "slow and fast":
        slow = np.where((time // (3.0 * period)) % 2 == 0, 1.0, 0.3)
        path = (
            2.0 / np.pi * np.arcsin(0.99 * np.sin(2.0 * np.pi * np.cumsum(slow) * STEP_S / period))
        )
    else:  # drift
        path = 0.4 * np.sin(phase) + 0.6 * np.sin(phase / 7.3)
    length = int((0.25 if rig.motion == "random" else 0.03) * period / STEP_S) | 1
    window = np.hanning(length + 2)
    padded = np.pad(path, (length + 2) // 2, "edge")
    return amplitude * np.convolve(padded, window / window.sum(), "valid")[: time.size]


@njit(cache=True)
def integrated(  # type: ignore[no-untyped-def]
    asked, speed, load_inertia, motor_inertia, stiffness, damping, half, motor_friction, friction,
    viscous, weight, phase, gains, limit, turning,
):  # fmt: skip
    """Motor and load at the load, rad, and the motor's torque, shapes (n,)."""
    n, inner = asked.size, 4
    motor, load, torque = np.empty(n), np.empty(n), np.empty(n)
    m, at, vm, vl = asked[0], asked[0] - 0.3 * half, 0.0, 0.0
    h = STEP_S / inner
    for i in range(n):
        u = gains[0] * (asked[i] - m) + gains[1] * (speed[i] - vm)
        u += 0.9 * motor_friction * np.tanh(speed[i] / turning)
        u = min(max(u, -limit), limit)
        motor[i], load[i], torque[i] = m, at, u
        for _ in range(inner):
            over = max(m - at - half, 0.0) + min(m - at + half, 0.0)
            force = 0.0
            if over != 0.0:
                force = stiffness * over + damping * (vm - vl)
                if force * over < 0.0:
                    force = 0.0
            vm += h * (u - force - motor_friction * np.tanh(vm / turning)) / motor_inertia
            held = friction * np.tanh(vl / turning) + viscous * vl + weight * np.sin(at + phase)
            vl += h * (force - held) / load_inertia
            m += h * vm
            at += h * vl
    return motor, load, torque


def simulated(rig: Rig, generator: np.random.Generator) -> tuple[Joint, Channels]:
    """A case of a rig and its recording."""
    spread = math.exp(generator.uniform(-JITTER_OF_PLAY, JITTER_OF_PLAY))
    play = rig.play * (spread if rig.play < 0.3 else generator.uniform(0.5, 1.0))
    amplitude = rig.amplitude * generator.uniform(0.8, 1.25)
    path = reference(rig, amplitude, rig.period_s * generator.uniform(0.7, 1.4), generator)
    speed = np.gradient(path, STEP_S)
    usual = float(np.std(np.gradient(speed, STEP_S)))
    weight, phase = 0.0, generator.uniform(-0.2, 0.2)
    friction = {"light": 0.4, "inertia": 0.08, "free": 0.01}.get(rig.load, 0.0) * usual
    if rig.load == "dragged":
        friction = 8.0 * max(usual, 0.5)
    elif rig.load in ("pendulum", "held"):
        weight = 9.81 / 0.25
        friction = (0.15 if rig.load == "pendulum" else 0.1) * weight
        phase += np.pi / 2.0 if rig.load == "held" else 0.0
    wound = rig.wound * math.exp(generator.normal(0.0, 0.5))
    stiffness = min(friction / wound, (2.0 * np.pi * 150.0) ** 2)
    motor_inertia, motor_friction = 0.5, 0.5 * friction + 0.2 * usual
    ringing = math.sqrt(stiffness * (1.0 + 1.0 / motor_inertia))
    damping = 0.16 * ringing * motor_inertia / (1.0 + motor_inertia)
    width = 2.0 * np.pi * 10.0
    gains = (2.0 * motor_inertia * width**2, 3.0 * motor_inertia * width)
    limit = 30.0 * usual + 5.0 * (friction + motor_friction + weight)
    turning = max(
        2e-3 * float(np.std(speed)) + 1e-5,
        0.5 * (friction + motor_friction / motor_inertia) * STEP_S,
    )
    motor, load, torque = integrated(
        path, speed, 1.0, motor_inertia, stiffness, damping, 0.5 * play, motor_friction, friction,
        0.02, weight, phase, gains, limit, turning,
    )  # fmt: skip
    time = STEP_S * np.arange(path.size)
    stamps = np.arange(0.2, time[-1] - 0.2, 1.0 / rig.rate_hz)
    stamps += rig.jitter / rig.rate_hz * generator.uniform(-1.0, 1.0, stamps.size)
    skew = rig.skew_s * generator.uniform(-1.5, 1.5)
    off_centre = rig.eccentric * generator.uniform(0.3, 2.0)
    at = np.interp(stamps - skew, time, load)
    read = at + off_centre * np.sin(at + generator.uniform(0.0, 6.28))
    read += 0.15 * off_centre * np.sin(2.0 * at + 1.0)
    turned = rig.ratio * np.interp(stamps, time, motor)
    counted = [2.0 * np.pi / each for each in (rig.motor_counts, rig.load_counts)]
    turned, read = (
        step * np.floor(values / step + 0.3 * generator.normal(size=values.size))
        for step, values in zip(counted, (turned, read), strict=True)
    )
    recorded = None
    if rig.has_torque:
        recorded = np.interp(stamps, time, torque) / rig.ratio
        recorded += 0.03 * float(np.std(recorded)) * generator.normal(size=stamps.size)
    stated = None if rig.stated is None else abs(rig.ratio) * rig.stated
    joint = Joint(
        play_rad=play,
        lost_rad=play + 2.0 * friction / stiffness,
        stiffness=stiffness,
        ratio=rig.ratio,
        stated=stated,
        skew_s=skew,
    )
    return joint, Channels(stamps, turned, read, recorded)


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> dict[str, float]:
    made_seed, fit_seed = seed.spawn(2)
    joint, channels = simulated(RIGS[row.rig], np.random.default_rng(made_seed))
    return scored(joint, channels, fit_seed)
