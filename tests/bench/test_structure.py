"""Joints with a belt, an elastic arm, a base that gives way, a gap that varies: laws of each."""

from __future__ import annotations

import math
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from bayesbl.bench.bench import BenchEffect, EffectParameterValue
from bayesbl.bench.kernel import (
    ARM_SPEED,
    ARM_TWIST,
    BELT_SPEED,
    BELT_TWIST,
    CURRENT,
    SPEED,
    STATES,
    Slot,
)
from bayesbl.bench.parameters import BENCH_PARAMETERS
from bayesbl.bench.simulation import simulate_channels, simulate_states
from bayesbl.bench.steady import contact_rates
from bayesbl.config.bench import dump_bench, load_bench, parse_bench, reference_bench
from bayesbl.errors import ConfigError

BENCH = reference_bench()

BELT = {"belt__compliance_rad_per_nm": 0.012, "belt__damping_ratio": 0.06}
BELT |= {"belt__reducer_share": 0.35}
ARM = {"arm__compliance_rad_per_nm": 3e-5, "arm__damping_ratio": 0.06}
ARM |= {"arm__inertia_share": 0.3, "arm__gravity_share": 0.6}
BASE = {"base__compliance_rad_per_nm": 1.5e-6, "base__damping_ratio": 0.06}
BASE |= {"base__inertia_kg_m2": 45.0}
VARIES = {"gap_variation__cosine_1": 0.25, "gap_variation__sine_1": -0.1}
VARIES |= {"gap_variation__cosine_2": 0.07, "gap_variation__sine_2": -0.04}
COULOMB = {"load_coulomb_friction__torque_nm": 15.0}

JOINTS = {
    "belt": BELT,
    "arm": ARM,
    "base": BASE,
    "varying gap": VARIES,
    "all, with friction": {**BELT, **ARM, **BASE, **VARIES, **COULOMB},
}


@pytest.mark.parametrize("joint", JOINTS)
@pytest.mark.parametrize("speed_rpm", [2000.0, -1200.0])
def test_an_independent_simulator_in_absolute_coordinates_agrees(
    independent: ModuleType, joint: str, speed_rpm: float
) -> None:
    settings = JOINTS[joint]
    run = {"gap_rad": 7e-4, "start_angle_rad": 0.4, "reference_speed_rpm": speed_rpm}
    values = {info.name: BENCH.value(info.name) for info in BENCH_PARAMETERS}
    own = BENCH.simulate_many(**run, **settings, rotations=1.1, channels="all", accuracy_rpm=1e-3)[
        0
    ]
    other = independent.noise_free(independent.plant({**values, **run, **settings}), 1.1)
    apart = np.max(np.abs(own - other), axis=1)
    # 0.01 rpm is what the package promises of a simulated speed.
    assert apart[SPEED] < 0.01
    assert apart[CURRENT] < 1e-3


@pytest.mark.parametrize(
    ("part", "compliance"),
    [("belt", 1.0 / 2e4), ("arm", 1.0 / 5e8), ("base", 1.0 / 5e9)],
)
def test_a_stiff_part_leaves_the_bench_as_it_was(part: str, compliance: float) -> None:
    plain = BENCH.simulate_many(8e-4, rotations=1.0)[0]

    def apart(times: float) -> float:
        stiff = {f"{part}__compliance_rad_per_nm": times * compliance, **SHAPES[part]}
        moved = BENCH.simulate_many(8e-4, **stiff, rotations=1.0)[0]
        # A mean over 50 ms leaves out the ringing of the part itself.
        return float(np.max(np.abs(uniform_filter1d(moved - plain, 50))))

    # To first order a spring does what its compliance does.
    assert apart(1.0) < 0.1
    assert apart(1.0) == pytest.approx(0.25 * apart(4.0), rel=0.1)


SHAPES = {
    part: {name: value for name, value in settings.items() if "compliance" not in name}
    for part, settings in (("belt", BELT), ("arm", ARM), ("base", BASE))
}


def test_a_belt_rings_at_the_frequency_of_its_two_inertias() -> None:
    stiffness = 80.0
    settings = {
        "belt__compliance_rad_per_nm": 1.0 / stiffness,
        "belt__reducer_share": 0.4,
        "shaft_stiffness_nm_per_rad": 1.0,
        "shaft_damping_nm_s_per_rad": 0.0,
        "speed_gain_nm_s_per_rad": 1e-6,
        "integral_gain_nm_per_rad": 1e-6,
    }
    inertia = BENCH.value("motor_inertia_kg_m2")
    expected = math.sqrt(stiffness / (inertia * 0.4 * 0.6))
    rates = contact_rates(BENCH.vector(**settings))[0].imag
    assert np.min(np.abs(rates - expected)) < 1e-4 * expected


def test_energy_is_kept_without_control_and_damping() -> None:
    """Of motor, reducer, load and arm, in contact and across the gap."""
    p = BENCH.vector(gap_rad=2e-3, hard_dead_zone=1.0, **{**BELT, **ARM})[0]
    for name in (
        "shaft_damping_nm_s_per_rad",
        "speed_gain_nm_s_per_rad",
        "integral_gain_nm_per_rad",
        "belt__damping_ratio",
        "arm__damping_ratio",
    ):
        p[Slot[name]] = 0.0
    start = np.zeros(STATES)
    start[1], start[2] = 60.0, 6e-3
    states = simulate_states(p, start, 2000, 500.0, accuracy_rpm=1e-4)
    ratio = p[Slot.gear_ratio]
    reducer, load = p[Slot.belt__reducer_share], p[Slot.arm__inertia_share]
    motor_speed = states[1] + states[BELT_SPEED]
    load_angle, load_speed = states[0] / ratio - states[2], states[1] / ratio - states[3]
    arm_angle, arm_speed = load_angle - states[ARM_TWIST], load_speed - states[ARM_SPEED]
    motor = p[Slot.motor_inertia_kg_m2]
    energy = 0.5 * motor * ((1.0 - reducer) * motor_speed**2 + reducer * states[1] ** 2)
    inertia = p[Slot.load_inertia_kg_m2]
    energy = energy + 0.5 * inertia * ((1.0 - load) * load_speed**2 + load * arm_speed**2)
    energy += 0.5 * states[BELT_TWIST] ** 2 / p[Slot.belt__compliance_rad_per_nm]
    energy += 0.5 * states[ARM_TWIST] ** 2 / p[Slot.arm__compliance_rad_per_nm]
    wound = np.maximum(0.0, np.abs(states[2]) - p[Slot.gap_rad])
    energy += 0.5 * p[Slot.shaft_stiffness_nm_per_rad] * wound**2
    far = p[Slot.arm__gravity_share]
    weight = (1.0 - far) * np.cos(load_angle) + far * np.cos(arm_angle)
    energy -= p[Slot.gravity_torque_nm] * weight
    assert states[2].min() < -p[Slot.gap_rad] < p[Slot.gap_rad] < states[2].max()
    assert np.ptp(energy) < 1e-4 * abs(energy[0])


def test_a_wider_gap_at_one_impact_is_that_gap_there() -> None:
    """A gap that is a constant share wider all round is that wider gap."""
    wide = BENCH.simulate_many(8e-4 * 1.2, rotations=1.0)[0]
    # cos 2θ at the two flank changes, θ near 0 and π, is one; there the gap is wider by a fifth.
    varied = BENCH.simulate_many(8e-4, gap_variation__cosine_2=0.2, rotations=1.0)[0]
    plain = BENCH.simulate_many(8e-4, rotations=1.0)[0]
    moved = np.max(np.abs(wide - plain))
    assert np.max(np.abs(varied - wide)) < 0.1 * moved


TABLES = """
[belt]
stiffness_nm_per_rad = {value = 80.0, relative_tolerance = 0.2}
damping_nm_s_per_rad = {value = 0.02}
reducer_inertia_kg_m2 = {value = 4.0e-4, tolerance = 1e-4}
[arm]
stiffness_nm_per_rad = {value = 4e4}
damping_nm_s_per_rad = {value = 60.0}
inertia_kg_m2 = {value = 5.0}
gravity_share = {value = 0.6}
[base]
stiffness_nm_per_rad = {value = 6e5}
inertia_kg_m2 = {value = 50.0}
[gap]
cosine = [{value = 0.1}]
sine = [{value = 0.0}, {value = -0.05}]
"""


def _bench_file(folder: Path, more: str) -> Path:
    path = folder / "joint.toml"
    path.write_text(dump_bench(BENCH).replace("effects = []\n", "") + more, encoding="utf-8")
    return path


def test_tables_of_the_bench_file_are_the_effects(tmp_path: Path) -> None:
    bench = load_bench(_bench_file(tmp_path, TABLES))
    effects = {effect.name: effect for effect in bench.effects}
    belt = effects["belt"].parameters
    assert belt["compliance_rad_per_nm"].value == pytest.approx(1.0 / 80.0)
    # A tolerance is the half-width of a uniform distribution.
    expected = 0.2 / 80.0 / math.sqrt(3.0)
    assert belt["compliance_rad_per_nm"].sd == pytest.approx(expected)
    # d = 2 ζ √(k J), with both inertias free.
    critical = 2.0 * math.sqrt(80.0 * 4e-4 * (1.0 - 4e-4 / 1.21e-3))
    assert belt["damping_ratio"].value == pytest.approx(0.02 / critical)
    assert belt["reducer_share"].value == pytest.approx(4e-4 / 1.21e-3)
    assert effects["arm"].complete()["inertia_share"] == pytest.approx(0.25)
    assert effects["gap_variation"].complete()["sine_2"] == -0.05
    as_effects = BENCH.with_effects(*bench.effects)
    assert np.array_equal(as_effects.vector(gap_rad=8e-4), bench.vector(gap_rad=8e-4))
    again = parse_bench(dump_bench(bench), "result.nc")
    assert np.array_equal(again.vector(), bench.vector())
    signals = simulate_channels(bench.vector(gap_rad=8e-4), 500, 1000.0)
    assert np.all(np.isfinite(signals))


@pytest.mark.parametrize(
    ("more", "where", "problem"),
    [
        ("[belt]\nstiffness_nm_per_rad = {value = 0}\nreducer_inertia_kg_m2 = {value = 1e-4}\n",
         "belt.stiffness_nm_per_rad", "stiffness"),
        ("[belt]\nstiffness_nm_per_rad = {value = 80}\nreducer_inertia_kg_m2 = {value = 2e-3}\n",
         "belt.reducer_share", "physical sense"),
        ("[belt]\nstiffness_nm_per_rad = {value = 80}\nreducer_inertia_kg_m2 = {value = 4e-4}\n"
         "play_rad = {value = 1e-3}\n", "belt.play_rad", "not simulated"),
        ("[gap]\ncosine = [{value = 0.1}, {value = 0.1}, {value = 0.1}]\n", "gap", "two harmonics"),
        ("[arm]\nstiffness_nm_per_rad = {value = 1e4, sd = 1.0, tolerance = 2.0}\n"
         "inertia_kg_m2 = {value = 5}\n", "arm.stiffness_nm_per_rad", "one standard deviation"),
    ],
)  # fmt: skip
def test_a_part_without_sense_is_refused_by_its_name(
    tmp_path: Path, more: str, where: str, problem: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        load_bench(_bench_file(tmp_path, more))
    assert where in str(caught.value).replace("[", "").replace("]", "")
    assert problem in str(caught.value)


def test_a_part_is_stated_once(tmp_path: Path) -> None:
    belt = BenchEffect("belt", {"compliance_rad_per_nm": EffectParameterValue(0.01)})
    path = tmp_path / "joint.toml"
    path.write_text(dump_bench(BENCH.with_effects(belt)) + TABLES, encoding="utf-8")
    with pytest.raises(ConfigError, match="stated twice"):
        load_bench(path)
