"""A gearbox on a stand, its output held and its torque ramped: shares nothing with the package.

One inertia at the output (motor and gears), LuGre friction with Stribeck's law that grows with the
load and changes with the position and from ramp to ramp, and two flanks that harden:

    J v' = τ − F(θ) − τ_f,        F(θ) = f(θ − δ) − f(−θ − δ),   f(e) = k e (1 + (e/e_h)²), e > 0
    z' = v − σ_0 |v| z / g,        τ_f = σ_0 z + σ_1 z' + σ_2 v
    g = [T_c + (T_s − T_c) exp(−(v/v_s)²)] (1 + variation(θ, ramp)) + μ |F|

A negative δ is an interference: both flanks carry the joint around zero, up to the preload f(|δ|).
All are of the output, in rad, N m and s.

    python experiments/torque_ramp_rig.py FILE [FILE …]

writes three recordings of the gearbox of ``configs/torque_ramp.toml`` new, worn, or preloaded,
depending on the start of the file's name.
"""

from __future__ import annotations

import csv
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numba
import numpy as np
from numpy.typing import NDArray

STEP_S = 1e-4
RECORDED_EVERY = 25
TICK_S = 0.0156
KNOTS = 64

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Gearbox:
    """One state of a gearbox at one position of the turn.

    ``pattern``: how far δ goes up and down round the turn, of 1. ``surface``: seed of the part of
    the friction's variation that stays.
    """

    play_rad: float = 8e-3
    stiffness_nm_per_rad: float = 600.0
    hardening_rad: float = 0.02
    friction_nm: float = 1.6
    stribeck: float = 1.15
    load_friction: float = 0.12
    variation: float = 0.2
    presliding_rad: float = 2e-4
    inertia_kg_m2: float = 0.05
    pattern: float = 0.0
    surface: int = 0

    def at(self, angle_rad: float) -> Gearbox:
        """The same at a position of the turn."""
        play_rad = self.play_rad * (1.0 + self.pattern * np.sin(angle_rad))
        surface = self.surface + int(1e6 * (angle_rad % (2.0 * np.pi)))
        return replace(self, play_rad=play_rad, surface=surface)


@dataclass(frozen=True)
class Ramps:
    """Cycles to ±``torque_nm`` in ``period_s`` each, one after another by amplitude."""

    torque_nm: tuple[float, ...] = (4.0, 30.0)
    cycles: tuple[int, ...] = (5, 2)
    period_s: tuple[float, ...] = (4.0, 16.0)
    limit_nm: float = np.inf


def torque_of(ramps: Ramps) -> tuple[Array, NDArray[np.int64]]:
    """Torque over time at every step, and the number of the half cycle."""
    parts, halves, number = [], [], 0
    for torque, cycles, period in zip(ramps.torque_nm, ramps.cycles, ramps.period_s, strict=True):
        steps = round(period / STEP_S)
        phase = np.arange(steps * cycles) / steps
        parts.append(torque * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * phase)))
        halves.append(number + np.floor(2.0 * phase + 0.5).astype(np.int64))
        number = int(halves[-1][-1]) + 1
    whole = np.clip(np.concatenate(parts), -ramps.limit_nm, ramps.limit_nm)
    return whole, np.concatenate(halves)


def simulate(box: Gearbox, ramps: Ramps, generator: np.random.Generator) -> tuple[Array, Array]:
    """True torque and position every ``RECORDED_EVERY`` steps."""
    torque, half = torque_of(ramps)
    # A pattern of the position that stays, and as much again that changes from ramp to ramp.
    fixed = _smooth(np.random.default_rng(box.surface).standard_normal((1, KNOTS)))
    fresh = _smooth(generator.standard_normal((int(half[-1]) + 1, KNOTS)))
    variation = box.variation * (0.8 * fixed + 0.6 * fresh)
    span = abs(box.play_rad) + 0.02
    position = _run(
        torque, half, np.maximum(variation, -0.8), span, box.play_rad, box.stiffness_nm_per_rad,
        box.hardening_rad, box.friction_nm, box.stribeck, box.load_friction, box.presliding_rad,
        box.inertia_kg_m2,
    )  # fmt: skip
    return torque[::RECORDED_EVERY], position[::RECORDED_EVERY]


def measured(
    torque: Array, position: Array, generator: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Time in coarse ticks, torque with noise and in steps, position in steps of an encoder."""
    time = np.arange(torque.size) * STEP_S * RECORDED_EVERY
    noise = 0.15 * generator.standard_normal(torque.size)
    return (
        np.floor(time / TICK_S) * TICK_S,
        np.round((torque + noise) / 0.05) * 0.05,
        np.round(position / 9.6e-5) * 9.6e-5,
    )


def reading(box: Gearbox, torque_nm: float, generator: np.random.Generator, cycles: int) -> float:
    """Half of the mean width at zero torque that ramps leave: what the route should give."""
    torque, position = simulate(box, Ramps((torque_nm,), (cycles,), (4.0,)), generator)
    back = np.flatnonzero(np.diff(np.sign(torque)) != 0)
    left = position[back[back > 0]]
    side = np.where(torque[np.maximum(back[back > 0] - 100, 0)] > 0.0, 1.0, -1.0)
    return 0.5 * float(left[side > 0].mean() - left[side < 0].mean())


def _smooth(values: Array) -> Array:
    """Neighbours averaged, at standard deviation one."""
    wide = values + np.roll(values, 1, axis=1) + np.roll(values, -1, axis=1)
    return np.asarray(wide / np.sqrt(3.0))


@numba.njit
def _run(  # type: ignore[no-untyped-def]  # pragma: no cover
    torque, half, variation, span, play, stiffness, hardening, friction, stribeck, by_load,
    presliding, inertia,
):  # fmt: skip
    position = np.empty(torque.size)
    theta = 0.0
    speed = 0.0
    z = 0.0
    knots = variation.shape[1]
    for k in range(torque.size):
        above, below = theta - play, -theta - play
        force = 0.0
        if above > 0.0:
            force += stiffness * above * (1.0 + (above / hardening) ** 2)
        if below > 0.0:
            force -= stiffness * below * (1.0 + (below / hardening) ** 2)
        place = (theta + span) / (2.0 * span) * (knots - 1)
        place = min(max(place, 0.0), knots - 1.001)
        n = int(place)
        part = place - n
        row = variation[half[k]]
        local = 1.0 + (1.0 - part) * row[n] + part * row[n + 1]
        level = friction * (1.0 + (stribeck - 1.0) * np.exp(-((speed / 0.05) ** 2)))
        most = level * local + by_load * abs(force)
        bristle = friction / presliding
        # Implicit in z, as it is stiff: z' = v − σ_0 |v| z / g.
        z = (z + STEP_S * speed) / (1.0 + STEP_S * bristle * abs(speed) / most)
        rate = speed - bristle * abs(speed) * z / most
        drag = bristle * z + 0.3 * np.sqrt(bristle * inertia) * rate
        # Viscous friction and the flanks' damping, implicit in the speed.
        damping = 1.0 + (0.3 * np.sqrt(stiffness * inertia) if force != 0.0 else 0.0)
        speed = (speed + STEP_S / inertia * (torque[k] - force - drag)) / (
            1.0 + STEP_S * damping / inertia
        )
        theta += STEP_S * speed
        position[k] = theta
    return position


STATES = {
    "new": Gearbox(play_rad=6e-3, pattern=0.25),
    "worn": Gearbox(play_rad=9e-3, pattern=0.25),
    "preloaded": Gearbox(play_rad=-5e-3, friction_nm=1.2),
}


def write(path: Path, number: int) -> None:
    """A recording of one position round the turn."""
    state = next((name for name in STATES if path.name.startswith(name)), "new")
    generator = np.random.default_rng([number, len(state)])
    box = STATES[state].at(2.0 * np.pi * number / 3.0)
    time, torque, position = measured(*simulate(box, Ramps(), generator), generator)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["time_s", "motor_position_rad", "motor_torque_nm"])
        for row in zip(time, position, torque, strict=True):
            rows.writerow([f"{row[0]:.4f}", f"{row[1]:.6f}", f"{row[2]:.2f}"])


if __name__ == "__main__":
    for place, name in enumerate(sys.argv[1:]):
        write(Path(name), place % 3)
