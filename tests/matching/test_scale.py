"""A joint in other units of torque, motor angle and time is the same joint: no constant has a unit.

A joint whose load torques are t times as large, its motor angles a times and its times s times, has
the same answer in every number without a unit. Load angles stay: gravity knows what a radian is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.effects import EFFECTS, search_scale
from bayesbl.bench.motion import cycle
from bayesbl.bench.simulation import Measurement
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import observed
from bayesbl.matching.predictive_check import agrees, disagreements
from bayesbl.matching.signals import GAP, gap_unknown, start_angle_unknown
from bayesbl.model_search.catalogue import candidates
from bayesbl.model_search.closed_loop import name_missing
from bayesbl.model_search.pipeline import direct_unknowns
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import FloatArray

GAP_RAD = 8e-4
FRICTION = (
    ("motor_coulomb_friction", {"torque_nm": 0.2}),
    ("motor_stribeck_friction", {"torque_nm": 0.1, "speed_rad_per_s": 50.0}),
    ("load_coulomb_friction", {"torque_nm": 5.0}),
    ("load_viscous_friction", {"coefficient_nm_s_per_rad": 3.0}),
    ("shaft_hysteresis", {"torque_nm": 10.0, "angle_rad": 1e-3}),
)


@dataclass(frozen=True)
class Scale:
    """Of load torques, motor angles and times."""

    torque: float = 1.0
    angle: float = 1.0
    time: float = 1.0

    @property
    def speed(self) -> float:
        """Of the motor."""
        return self.angle / self.time

    def bench(self) -> Bench:
        """The reference bench, rubbing, and its noise."""
        inertia, motor_torque = self.torque * self.time**2, self.torque / self.angle
        factors = {
            "gear_ratio": self.angle,
            "motor_inertia_kg_m2": inertia / self.angle**2,
            "load_inertia_kg_m2": inertia,
            "shaft_stiffness_nm_per_rad": self.torque,
            "shaft_damping_nm_s_per_rad": self.torque * self.time,
            "gravity_torque_nm": self.torque,
            "speed_gain_nm_s_per_rad": motor_torque / self.speed,
            "integral_gain_nm_per_rad": motor_torque / self.angle,
            "torque_constant_nm_per_a": motor_torque,
            "reference_speed_rpm": self.speed,
        }
        made = reference_bench()
        made = made.with_parameters(**{n: f * made.value(n) for n, f in factors.items()})
        noise = NoiseModel(1.5 * self.speed, (0.6,))
        measurement = Measurement(None, speed_noise=noise, current_noise=NoiseModel(0.05))
        return replace(made, measurement=measurement)

    def rubbing(self) -> Bench:
        """With effects of motor, load and shaft."""
        units = {
            "torque_nm": self.torque,
            "speed_rad_per_s": self.speed,
            "coefficient_nm_s_per_rad": self.torque * self.time,
            "angle_rad": 1.0,
        }
        effects = []
        for name, given in FRICTION:
            of_motor = {"torque_nm": 1.0 / self.angle} if name.startswith("motor") else {}
            values = {p: v * units[p] * of_motor.get(p, 1.0) for p, v in given.items()}
            effects.append(
                BenchEffect(name, {p: EffectParameterValue(v) for p, v in values.items()})
            )
        return self.bench().with_effects(*effects)

    def fit(self) -> SimulatedFit:
        """A recording matched directly, by the same draws of noise."""
        bench = self.bench()
        made = bench.simulate(
            GAP_RAD,
            rotations=3.0,
            sampling_hz=250.0 / self.time,
            start_angle_rad=1.0,
            seed=np.random.default_rng(1),
            name="made",
        )
        unknowns = direct_unknowns(bench, ["made"], (1e-4, 1e-2))
        return fit_aligned(bench, [observed(made, bench)], unknowns)


SCALES = [
    *(Scale(torque=1e3**power) for power in (1, -1)),
    *(Scale(angle=1e3**power) for power in (1, -1)),
    *(Scale(time=1e3**power) for power in (1, -1)),
]


@pytest.mark.parametrize("scale", SCALES, ids=str)
def test_the_direct_answer_is_the_same_in_other_units(scale: Scale) -> None:
    fit, plain = scale.fit(), Scale().fit()
    for part in (fit, plain):
        assert agrees(disagreements(part))
        assert abs(math.log(part.value(GAP, "made") / GAP_RAD)) < 4.0 * part.sd(GAP, "made")
    sd = plain.sd(GAP, "made")
    # Not rounded and simulated to the same share, so what is left is where a search stops.
    assert math.log(fit.value(GAP, "made")) == pytest.approx(
        math.log(plain.value(GAP, "made")), abs=0.02 * sd
    )
    assert fit.sd(GAP, "made") == pytest.approx(sd, rel=0.01)


@pytest.mark.parametrize("scale", SCALES, ids=str)
def test_friction_is_the_same_law_in_other_units(scale: Scale) -> None:
    """In steady rotation to the accuracy, through strokes with standstills to ten times it."""

    def turning(made: Scale) -> FloatArray:
        run = made.rubbing().simulate_many(GAP_RAD, rotations=1.2, sampling_hz=250.0 / made.time)
        return np.asarray(run[0] / made.speed)

    def stroking(made: Scale) -> FloatArray:
        motion = cycle(
            120.0 * made.angle,
            (-0.5, 0.5),
            2000.0 * made.speed,
            8000.0 * made.speed / made.time,
            0.15 * made.time,
            2.0 * made.time,
        )
        run = made.rubbing()
        run = replace(run, measurement=replace(run.measurement, speed_noise=NoiseModel(0.0)))
        recording = run.simulate(GAP_RAD, motion, sampling_hz=250.0 / made.time)
        return np.asarray(recording.motor_speed_rpm / made.speed)

    assert turning(scale) == pytest.approx(turning(Scale()), abs=0.01)
    assert stroking(scale) == pytest.approx(stroking(Scale()), abs=0.1)


@pytest.mark.parametrize("scale", SCALES, ids=str)
def test_what_is_sought_goes_with_the_joint(scale: Scale) -> None:
    """Ranges of torques and coefficients, and what is scanned of them, have the joint's units."""
    bench, plain = scale.bench(), Scale().bench()
    seen = [
        observed(b.simulate(GAP_RAD, rotations=2.0, sampling_hz=hz, name="made"), b)
        for b, hz in ((plain, 250.0), (bench, 250.0 / scale.time))
    ]
    before, after = (candidates(b, [s]) for b, s in zip((plain, bench), seen, strict=True))
    ranges = {u.name: u.high for c in before for u in c.unknowns if c.kind == "effect"}
    found = {u.name: u.high for c in after for u in c.unknowns if c.kind == "effect"}
    for old, new in zip(before, after, strict=True):
        sizes = [(u.low, u.high) for u in old.unknowns], [(u.low, u.high) for u in new.unknowns]
        for place, grid in old.scanned.items():
            (_, was), (_, now) = (size[place] for size in sizes)
            assert new.scanned[place] == pytest.approx(grid * (now / was))
        assert len(new.starts) == len(old.starts)
        for start, other in zip(old.starts, new.starts, strict=True):
            shares = [np.array([h for _, h in size]) for size in sizes]
            assert other / shares[1] == pytest.approx(start / shares[0])
    assert found["motor_coulomb_friction__torque_nm"] == pytest.approx(
        scale.torque / scale.angle * ranges["motor_coulomb_friction__torque_nm"]
    )
    assert found["load_coulomb_friction__torque_nm"] == pytest.approx(
        scale.torque * ranges["load_coulomb_friction__torque_nm"]
    )
    assert found["load_viscous_friction__coefficient_nm_s_per_rad"] == pytest.approx(
        scale.torque * scale.time * ranges["load_viscous_friction__coefficient_nm_s_per_rad"]
    )
    assert found["motor_stribeck_friction__speed_rad_per_s"] == pytest.approx(
        scale.speed * ranges["motor_stribeck_friction__speed_rad_per_s"]
    )


@pytest.mark.long
@pytest.mark.parametrize("torque", [0.02, 20.0])
def test_what_is_missing_has_the_same_name_on_another_size_of_joint(torque: float) -> None:
    """Coulomb friction of the motor, 0.2 N m on the reference bench; two speeds, both ways."""
    scale = Scale(torque=torque)
    bench, size = scale.bench(), 0.2 * torque
    friction = BenchEffect("motor_coulomb_friction", {"torque_nm": EffectParameterValue(size)})
    speeds_rpm = (2000.0, -2000.0, 1400.0)
    recordings = [
        bench.with_effects(friction).simulate(
            GAP_RAD,
            rotations=4.0,
            sampling_hz=250.0,
            start_angle_rad=1.0 + index,
            reference_speed_rpm=speed_rpm,
            seed=np.random.default_rng(index),
            name=f"at {speed_rpm:g} rpm",
        )
        for index, speed_rpm in enumerate(speeds_rpm)
    ]
    seen = [
        observed(made, bench, speed_rpm)
        for made, speed_rpm in zip(recordings, speeds_rpm, strict=True)
    ]
    unknowns = [gap_unknown(1e-4, 1e-2), *(start_angle_unknown(made.name) for made in recordings)]
    found = name_missing(
        fit_aligned(bench, seen, unknowns), partial(candidates, bench, seen, "all")
    )
    assert [effect.members for effect in found.effects] == [("motor_coulomb_friction",)]
    assert abs(math.log(found.final.fit.value(GAP) / GAP_RAD)) < 4.0 * found.final.fit.sd(GAP)
    assert found.final.fit.value("motor_coulomb_friction__torque_nm") == pytest.approx(
        size, rel=0.01
    )


def test_the_ranges_of_the_catalogue_are_those_of_the_reference_bench() -> None:
    for effect in EFFECTS:
        for parameter in effect.parameters:
            assert search_scale(reference_bench(), effect, parameter) == 1.0
