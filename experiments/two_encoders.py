"""Whether play, lost motion and stiffness from two encoders are what two simulators put in.

    bayesbl run configs/two_encoders_study.toml

Both simulators share nothing with the route. ``kinematic`` moves the motor along a path and drags
the load behind it through the play, or drops it from flank to flank by its weight. ``dynamic``
integrates motor and load (Runge and Kutta, fourth order) with a spring behind a dead zone, Coulomb
friction of both and a position controller: the load strikes, coasts and winds the joint up. Each
joint has its own ratio, sign, motion, eccentric encoders, gear mesh, skew, coarse encoders, uneven
stamps; the ratio is stated exactly, a little wrong, or not at all.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
import xarray as xr
from numba import njit
from numpy.typing import NDArray
from pydantic import BaseModel
from scipy.stats import binom
from study_tools import LEVEL, StudyRow, held, interval_of, mean

from bayesbl.measurement.two_encoder_route import upper_bound_rad
from bayesbl.two_encoders.paths import Channels
from bayesbl.two_encoders.transmission import fit_transmission

Array = NDArray[np.float64]

TOLD = 0.95
BRAKE = (0.3, 0.9)
"""Torque at the output over the load's friction: it bends the joint, and turns no flank."""

WEIGHT = (0.0, 0.5)
"""Of the load, over what is left of that friction."""

COLUMNS = {
    "play_rad": ("rad", "whole play of the simulator"),
    "lost_rad": ("rad", "play and what the load's friction winds up, both ways"),
    "probability": ("1", "probability of play"),
    "play_covered": ("1", "1 where the interval of the play holds it, of plays that are told"),
    "bound_holds": ("1", "1 where the play is below its upper bound"),
    "lost_covered": ("1", "1 where the interval of the lost motion holds it"),
    "stiffness_covered": ("1", "1 where the interval of the stiffness holds it, where it is given"),
    "ratio_covered": ("1", "1 where the interval of the gear ratio holds it"),
    "skew_covered": ("1", "1 where the interval of the skew holds it"),
    "error": ("1", "median of the play over the truth, less 1"),
    "width": ("1", "width of its interval over the truth"),
}


class Row(StudyRow):
    """A row: the simulator, whether there is play, and whether the motor's torque is recorded."""

    simulator: Literal["kinematic", "dynamic"]
    play: bool = True
    torque: bool = False


def motion(generator: np.random.Generator, amplitude: float) -> tuple[Array, float]:
    """Load angle asked for at 2 kHz, shape (n,), and its period of sampling."""
    period = generator.uniform(1.0, 4.0)
    cycles = int(generator.integers(4, 14))
    time = np.arange(0.0, cycles * period, 5e-4)
    kind = generator.integers(4)
    phase = 2.0 * np.pi * time / period
    if kind == 0:
        path = np.sin(phase)
    elif kind == 1:
        path = 0.7 * np.sin(phase) + 0.3 * np.sin(math.pi * phase / 2.0 + 1.0)
    elif kind == 2:  # strokes with rests
        path = np.clip(1.6 * 2.0 / np.pi * np.arcsin(np.sin(phase)), -1.0, 1.0)
    else:  # slow and fast strokes
        slow = 2.0 * np.pi * np.cumsum(0.6 + 0.5 * np.sign(np.sin(phase / 3.0))) * 5e-4 / period
        path = 2.0 / np.pi * np.arcsin(0.999 * np.sin(slow))
    window = np.hanning(81)
    smooth = np.convolve(np.pad(path, 40, "edge"), window / window.sum(), "valid")
    return amplitude * smooth, 5e-4


def dragged(path: Array, half: float) -> Array:
    """The load behind the motor, dragged through the play."""
    load = np.empty_like(path)
    at = path[0]
    for k, x in enumerate(path):
        at = min(max(at, x - half), x + half)
        load[k] = at
    return load


@njit(cache=True)
def integrated(  # type: ignore[no-untyped-def]
    path,
    dt,
    inner,
    inertia,
    load_inertia,
    stiffness,
    damping,
    half,
    friction,
    load_friction,
    mgl,
    pulled,
):
    """Motor and load, both at the load: angles and the torque of the motor, shapes (n,)."""
    n = path.size
    motor, load, torque = np.empty(n), np.empty(n), np.empty(n)
    state = np.array([path[0], 0.0, path[0], 0.0])
    rate, zeta = 2.0 * np.pi * 12.0, 0.8
    h = dt / inner
    slopes = np.empty((4, 4))
    v0 = 2e-4 + 1e-3 * np.std(np.diff(path)) / dt
    for k in range(n):
        ahead = path[min(k + 1, n - 1)]
        speed = (ahead - path[k]) / dt
        applied = 0.0
        for i in range(inner):
            asked = path[k] + (ahead - path[k]) * i / inner
            pull = rate * rate * (asked - state[0]) + 2.0 * zeta * rate * (speed - state[1])
            applied = inertia * pull + friction * np.tanh(speed / v0)
            for stage in range(4):
                if stage == 0:
                    z = state
                elif stage == 3:
                    z = state + h * slopes[2]
                else:
                    z = state + 0.5 * h * slopes[stage - 1]
                wound = z[0] - z[2]
                over = max(wound - half, 0.0) + min(wound + half, 0.0)
                force = stiffness * over
                if over != 0.0:
                    force += damping * (z[1] - z[3])
                    if force * over < 0.0:
                        force = 0.0
                slopes[stage, 0] = z[1]
                slopes[stage, 1] = (applied - force - friction * np.tanh(z[1] / v0)) / inertia
                slopes[stage, 2] = z[3]
                slopes[stage, 3] = (
                    force - load_friction * np.tanh(z[3] / v0) - mgl * np.sin(z[2]) - pulled[k]
                ) / load_inertia
            state = state + h / 6.0 * (slopes[0] + 2.0 * slopes[1] + 2.0 * slopes[2] + slopes[3])
        motor[k], load[k], torque[k] = state[0], state[2], applied
    return motor, load, torque


class Joint(BaseModel):
    """What a joint is, and what it records."""

    play_rad: float
    lost_rad: float
    stiffness: float
    ratio: float
    stated: float | None
    skew_s: float


def simulated(row: Row, generator: np.random.Generator) -> tuple[Joint, Channels]:
    """A joint and its recording."""
    most = 0.1 if row.simulator == "dynamic" else 0.3
    half = math.exp(generator.uniform(math.log(2e-4), math.log(most))) if row.play else 0.0
    amplitude = max(generator.uniform(0.2, 3.0), 6.0 * half) * generator.choice([1.0, 1.0, 4.0])
    path, dt = motion(generator, amplitude)
    ratio = float(generator.choice([1.0, 6.0, 9.0, 14.0, 50.0, 100.0, 120.0]))
    ratio *= generator.choice([-1.0, 1.0])
    friction = math.exp(generator.uniform(math.log(0.05), math.log(2.0)))
    share = generator.uniform(0.2, 0.9)
    outside = friction * share * generator.uniform(*BRAKE) if row.torque else 0.0
    mgl = (friction * share - outside) * generator.uniform(*WEIGHT) if row.torque else 0.0
    turns = 2.0 * np.pi * generator.uniform(0.05, 0.4) * dt * np.arange(path.size)
    pulled = outside * np.sin(turns + generator.uniform(0.0, 6.0))
    # Friction alone winds the joint up by some hundredths of a mrad.
    stiffness = friction * share / math.exp(generator.normal(math.log(2.5e-5), 1.0))
    if row.torque:
        # A brake at the output that pulls by a torque of its own, to and fro.
        stiffness = friction / math.exp(generator.uniform(math.log(5e-5), math.log(1e-3)))
    if row.simulator == "kinematic":
        motor = path
        load = dragged(path, half)
        # Friction holds what it wound up while the load rests.
        steps = np.sign(np.diff(load, prepend=load[0]))
        last = np.maximum.accumulate(np.where(steps != 0.0, np.arange(steps.size), 0))
        moving = np.convolve(steps[last], np.ones(21) / 21.0, "same")
        held = friction * share * moving + mgl * np.sin(load) + pulled
        load = load - held / stiffness
        torque = held + friction * (1.0 - share) * np.sign(np.gradient(path))
    else:
        inertia = friction / math.exp(generator.uniform(math.log(5.0), math.log(200.0)))
        load_inertia = inertia * generator.uniform(0.3, 3.0)
        fast = math.sqrt(stiffness * (1.0 / inertia + 1.0 / load_inertia))
        if fast > 2e3:  # what rings faster is stiff to the recording, and slow to integrate
            load_inertia *= (fast / 2e3) ** 2
            inertia *= (fast / 2e3) ** 2
        damping = generator.uniform(0.2, 1.0) * math.sqrt(stiffness * load_inertia)
        motor, load, torque = integrated(
            path, dt, 10, inertia, load_inertia, stiffness, damping, half,
            friction * (1.0 - share), friction * share, mgl, pulled,
        )  # fmt: skip
    time = dt * np.arange(path.size)
    rate = math.exp(generator.uniform(math.log(80.0), math.log(1000.0)))
    skew = generator.uniform(-6e-3, 6e-3)
    stamps = np.arange(0.05, time[-1] - 0.05, 1.0 / rate)
    stamps += generator.uniform(-0.3, 0.3, stamps.size) / rate
    stamps = stamps[generator.uniform(size=stamps.size) > 0.01]
    motor_at = np.interp(stamps, time, motor)
    load_at = np.interp(stamps - skew, time, load)
    phase = generator.uniform(0.0, 2.0 * np.pi, 5)
    off_centre = math.exp(generator.uniform(math.log(1e-4), math.log(8e-3)))
    read = (
        load_at
        + off_centre * np.sin(load_at + phase[0])
        + 0.2 * off_centre * np.sin(2.0 * load_at + phase[1])
        + generator.uniform(0.0, 2e-4) * np.sin(abs(ratio) * motor_at + phase[2])
        + generator.uniform(0.0, 1e-4) * np.sin(23.7 * load_at + phase[3])
    )
    step = 2.0 * np.pi / 2.0 ** int(generator.integers(12, 20))
    noise = step * generator.uniform(0.0, 1.0) + 1e-6
    read = step * np.round((read + generator.normal(0.0, noise, read.size)) / step)
    counted = 2.0 * np.pi / 2.0 ** int(generator.integers(12, 18))
    turned = counted * np.round(ratio * motor_at / counted) + generator.uniform(-9.0, 9.0)
    wrapped = read + generator.uniform(-3.0, 3.0)
    if generator.uniform() < 0.3:
        wrapped = np.mod(wrapped, 2.0 * np.pi)
    recorded = None
    if row.torque:
        level = float(np.std(torque))
        noisy = np.interp(stamps, time, torque) + generator.normal(0.0, 0.05 * level, stamps.size)
        recorded = noisy / ratio
    stated = [ratio, ratio * (1.0 + generator.normal(0.0, 0.005)), None][generator.integers(3)]
    joint = Joint(
        play_rad=2.0 * half,
        lost_rad=2.0 * (half + friction * share / stiffness),
        stiffness=stiffness,
        ratio=ratio,
        stated=None if stated is None else abs(stated),
        skew_s=skew,
    )
    return joint, Channels(stamps, turned, np.unwrap(wrapped), recorded)


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> dict[str, float]:
    made_seed, fit_seed = seed.spawn(2)
    joint, channels = simulated(row, np.random.default_rng(made_seed))
    return scored(joint, channels, fit_seed)


def scored(joint: Joint, channels: Channels, fit_seed: np.random.SeedSequence) -> dict[str, float]:
    """What the route says of a recording, against what the joint is."""
    own, of_joint = fit_seed.spawn(2)
    found = fit_transmission(channels, own, of_joint, joint.stated)

    play = found.draws["play_rad"]
    told = found.probability_of_play >= TOLD
    low, high = interval_of(play)
    compliance = "compliance_rad_per_nm"
    return {
        "play_rad": joint.play_rad,
        "lost_rad": joint.lost_rad,
        "probability": found.probability_of_play,
        "play_covered": held(play, joint.play_rad) if told else math.nan,
        "bound_holds": float(joint.play_rad <= 2.0 * upper_bound_rad(found)),
        "lost_covered": held(found.draws["lost_motion_rad"], joint.lost_rad),
        "stiffness_covered": held(found.draws[compliance], 1.0 / joint.stiffness)
        if compliance in found.draws
        else math.nan,
        "ratio_covered": held(found.draws["gear_ratio"], joint.ratio),
        "skew_covered": held(found.draws["channel_skew_s"], joint.skew_s),
        "error": float(np.median(play)) / joint.play_rad - 1.0
        if told and joint.play_rad
        else math.nan,
        "width": (high - low) / joint.play_rad if told and joint.play_rad else math.nan,
    }


class HasPlay(Protocol):
    """A row of a study of two encoders."""

    @property
    def play(self) -> bool:
        """Whether the joints have any."""


def summarise(row: HasPlay, cases: xr.Dataset) -> dict[str, float]:
    told = cases["probability"].values >= TOLD
    band = binom.ppf((0.005, 0.995), max(int(told.sum()), 1), LEVEL) / max(int(told.sum()), 1)
    size = np.abs(cases["error"].values)
    return {
        "told": float(told.sum()),
        "false_play": math.nan if row.play else float(told.mean()),
        **{name: mean(cases[name]) for name in COLUMNS if name.endswith(("covered", "holds"))},
        "stiffness_given": float(np.isfinite(cases["stiffness_covered"].values).sum()),
        "band_low": float(band[0]),
        "band_high": float(band[1]),
        "error_median": float(np.nanmedian(size)) if np.isfinite(size).any() else math.nan,
        "error_worst": float(np.nanmax(size)) if np.isfinite(size).any() else math.nan,
        "width": float(np.nanmedian(cases["width"].values))
        if told.any() and row.play
        else math.nan,
    }


def example(half: float, seed: int) -> Channels:
    """A joint of ratio 100 with this δ, moved slowly and fast, in uneven samples of 500 Hz."""
    generator = np.random.default_rng(seed)
    dt = 5e-4
    time = np.arange(0.0, 20.0, dt)
    path = 0.8 * np.sin(np.pi * time) + 0.4 * np.sin(2.0 * np.pi * time / 3.3)
    load = dragged(path, half)
    stamps = np.arange(0.1, 19.9, 2e-3)
    stamps += generator.uniform(-3e-4, 3e-4, stamps.size)
    step = 2.0 * np.pi / 2**17
    at = np.interp(stamps - 1e-3, time, load)
    read = step * np.round((at + 1e-3 * np.sin(at + 0.4)) / step)
    return Channels(stamps, 100.0 * np.interp(stamps, time, path), read)


if __name__ == "__main__":
    for number, (file, gap) in enumerate(zip(sys.argv[1:], (1.5e-3, 2.2e-3), strict=False)):
        made = example(gap, number)
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(
            file,
            np.column_stack([made.time_s, made.motor_rad, made.load_rad]),
            delimiter=",",
            header="time_s,motor_position_rad,load_position_rad",
            comments="",
            fmt="%.9g",
        )
