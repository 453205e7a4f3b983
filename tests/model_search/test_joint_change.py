"""What changed in a joint between two recordings, on data of the independent simulator."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bayesbl.bench.bench import BenchEffect, BenchParameter, EffectParameterValue
from bayesbl.bench.parameters import BENCH_PARAMETERS
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.least_squares import fit_simulated
from bayesbl.matching.observed import marginalising_motor_lines, observed
from bayesbl.matching.posterior import sample_direct
from bayesbl.matching.predictive_check import is_explained
from bayesbl.matching.signals import GAP, Unknown
from bayesbl.measurement.direct_route import bench_lacks
from bayesbl.model_search.joint_change import blind_spots, find_changes
from bayesbl.model_search.pipeline import direct_unknowns, fit_jointly
from bayesbl.sampling.chains import SamplerSettings
from bayesbl.sentences import sentence

pytestmark = pytest.mark.long

BENCH = reference_bench()
BELIEVED = {info.name: BENCH.value(info.name) for info in BENCH_PARAMETERS}
GAP_RAD = 8e-4
GAP_RANGE_RAD = (1e-4, 1e-2)
SURE = 4.0
"""Standard deviations: one estimate in 16,000 is farther off."""


def nominal_fit(
    independent,
    second,
    seed,
    gaps_rad=(GAP_RAD, GAP_RAD),
    speed_alone=False,
    first=None,
    bench=BENCH,
    known=None,
    lines=False,
):
    """Both recordings fitted together with the bench as believed; with the motor's ``lines``."""
    rng = np.random.default_rng(seed)
    seen = []
    for name, gap, changed in zip(
        ("before", "after"), gaps_rad, (first or {}, second), strict=True
    ):
        start, motor = rng.uniform(-math.pi, math.pi, 2)
        truth = independent.plant(
            {**BELIEVED, **changed},
            gap_rad=gap,
            start_angle_rad=start,
            motor_start_angle_rad=motor,
        )
        made = observed(independent.simulate(truth, rng, name=name).recording, bench)
        made = replace(made, known=(known or {}).get(name, {}))
        made = made if lines else marginalising_motor_lines(made, bench)
        seen.append(replace(made, signals=made.signals[:1]) if speed_alone else made)
    return fit_aligned(bench, seen, direct_unknowns(bench, ["before", "after"], GAP_RANGE_RAD))


def changes(nominal):
    """The fit with what changed freed, and what that is."""
    naming, _, found = find_changes(nominal)
    return naming.final.fit, found


def change(fit):
    """Change of δ and its standard deviation, rad."""
    toward = np.zeros(fit.point.size)
    toward[fit.model.index(GAP, "after")] = fit.value(GAP, "after")
    toward[fit.model.index(GAP, "before")] = -fit.value(GAP, "before")
    sd = math.sqrt(toward @ fit.covariance @ toward)
    return fit.value(GAP, "after") - fit.value(GAP, "before"), sd


def times(factor, name):
    return {name: factor * BELIEVED[name]}


CHANGES = {
    "speed_gain_nm_s_per_rad": times(0.9, "speed_gain_nm_s_per_rad"),
    "shaft_stiffness_nm_per_rad": times(0.9, "shaft_stiffness_nm_per_rad"),
    "payload": times(2.0, "gravity_torque_nm") | times(1.5, "load_inertia_kg_m2"),
    "speed_averaging": {"speed_averaging.time_s": 4e-3},
    "load_coulomb_friction": {"load_coulomb_friction.torque_nm": 15.0},
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_that_is_not_wear_is_named_and_leaves_the_gap_alone(independent, name):
    fit, found = changes(nominal_fit(independent, CHANGES[name], seed=1))
    assert found.explained
    assert found.could_be[0] == name
    assert {c.recording for c in found.changed} == {"after"}
    moved, sd = change(fit)
    assert abs(moved) < SURE * sd


def test_the_change_found_has_the_size_that_it_has(independent):
    truth = times(0.9, "speed_gain_nm_s_per_rad")
    _, found = changes(nominal_fit(independent, truth, seed=2))
    (changed,) = found.changed
    assert abs(changed.estimate - truth[changed.name]) < SURE * changed.sd
    assert changed.expected == BELIEVED[changed.name]
    assert changed.unit == "N m s/rad"


def tolerant(name, value, tolerance):
    """The bench with one parameter known to a tolerance."""
    return replace(BENCH, parameters={**BENCH.parameters, name: BenchParameter(value, tolerance)})


def test_a_change_within_a_tolerance_is_told_against_the_other_recording(independent):
    """Payload and bench file differ too: the bench's own value was in neither recording."""
    name = "gravity_torque_nm"
    value = BELIEVED[name]
    bench = tolerant(name, 1.03 * value, 0.15 * value)
    _, found = changes(nominal_fit(independent, times(1.12, name), seed=2, bench=bench))
    (changed,) = found.changed
    assert (changed.name, changed.recording) == (name, "after")
    assert changed.estimate / changed.expected == pytest.approx(1.12, abs=SURE * changed.sd / value)
    assert changed.expected == pytest.approx(value, rel=0.01)


def test_a_recording_beyond_the_tolerance_is_the_one_that_differs(independent):
    name = "gravity_torque_nm"
    value = BELIEVED[name]
    bench = tolerant(name, value, 0.02 * value)
    wrong = times(1.3, name)
    _, found = changes(nominal_fit(independent, {}, seed=2, first=wrong, bench=bench))
    (changed,) = found.changed
    assert (changed.name, changed.recording) == (name, "before")
    assert abs(changed.estimate - changed.expected - 0.3 * value) < SURE * changed.sd


def test_what_is_known_of_a_recording_is_what_another_is_compared_with(independent):
    name = "gravity_torque_nm"
    value = BELIEVED[name]
    fit = nominal_fit(
        independent,
        times(1.1, name),
        seed=2,
        first=times(1.2, name),
        bench=tolerant(name, value, 0.02 * value),
        known={"after": times(1.1, name)},
    )
    _, found = changes(fit)
    (changed,) = found.changed
    assert changed.recording == "before"
    assert changed.expected == 1.1 * value
    assert abs(changed.estimate - 1.2 * value) < SURE * changed.sd


def test_wear_is_not_taken_for_a_change_of_the_joint(independent):
    """False alarms are at most 1 % of runs, so one seed of four fails by chance in 4 %."""
    for seed in range(4):
        fit, found = changes(nominal_fit(independent, {}, seed, gaps_rad=(GAP_RAD, 1.1e-3)))
        assert found.agrees
        moved, sd = change(fit)
        assert abs(moved - (1.1e-3 - GAP_RAD)) < SURE * sd


def test_a_bench_that_is_wrong_for_both_is_no_change_between_them(independent):
    wrong = times(0.9, "shaft_stiffness_nm_per_rad")
    _, found = changes(nominal_fit(independent, wrong, seed=3, first=wrong))
    assert [c.recording for c in found.changed] == [None]
    assert found.beyond_bench == found.changed
    assert found.changed[0].name == "shaft_stiffness_nm_per_rad"


def test_damping_within_the_gap_is_named_and_the_gaps_stay_right(independent):
    damped = {"gap_damping.coefficient_nm_s_per_rad": 150.0}
    wear = (GAP_RAD, 1.1e-3)
    fit, found = changes(nominal_fit(independent, damped, seed=9, first=damped, gaps_rad=wear))
    assert [c.name for c in found.beyond_bench] == ["gap_damping.coefficient_nm_s_per_rad"]
    assert abs(found.changed[0].estimate - 150.0) < SURE * found.changed[0].sd
    for name, gap_rad in zip(("before", "after"), wear, strict=True):
        assert abs(math.log(fit.value(GAP, name) / gap_rad)) < SURE * fit.sd(GAP, name)


def test_a_smoothed_speed_is_told_with_its_time_and_how_a_bench_states_it(independent):
    smoothed = {"speed_averaging__time_s": 4e-3}
    _, found = changes(nominal_fit(independent, smoothed, seed=6, first=smoothed))
    assert [c.name for c in found.changed] == ["speed_averaging.time_s"]
    assert abs(found.changed[0].estimate - 4e-3) < SURE * found.changed[0].sd
    assert "speed_filter_s under" in sentence({"code": "bench_lacks", **bench_lacks(found)})


def test_an_error_of_the_encoder_is_no_change_of_the_joint_and_does_not_move_the_gap(independent):
    """What turns with the motor is marginalised, for all encoders and motors have such lines."""
    disc = {"outside__encoder_1_rad": 2.5e-4, "outside__encoder_2_rad": 1.5e-4}
    fit = nominal_fit(independent, disc, seed=5, gaps_rad=(GAP_RAD, 9e-4), first=disc, lines=True)
    assert not is_explained(fit)
    fit = nominal_fit(independent, disc, seed=5, gaps_rad=(GAP_RAD, 9e-4), first=disc)
    assert is_explained(fit)
    for name, gap_rad in (("before", GAP_RAD), ("after", 9e-4)):
        off = math.log(fit.value(GAP, name) / gap_rad)
        assert abs(off) < SURE * fit.sd(GAP, name)


def test_a_bench_beyond_its_tolerance_in_every_recording_speaks_against_the_bench(independent):
    """The stiffness is shared within its tolerance, so it can only be freed in each alone."""
    wrong = times(1.1, "shaft_stiffness_nm_per_rad")
    value = BELIEVED["shaft_stiffness_nm_per_rad"]
    known = {**BENCH.parameters, "shaft_stiffness_nm_per_rad": BenchParameter(value, 0.02 * value)}
    bench = replace(BENCH, parameters=known)
    _, found = changes(nominal_fit(independent, wrong, seed=3, first=wrong, bench=bench))
    assert found.beyond_bench == found.changed


def test_without_the_current_a_changed_gain_leaves_the_gap_alone(independent):
    """K_p and friction that grows with speed ring alike, and give another gap each."""
    truth = CHANGES["speed_gain_nm_s_per_rad"]
    fit, found = changes(nominal_fit(independent, truth, seed=5, speed_alone=True))
    assert "speed_gain_nm_s_per_rad" in found.could_be
    moved, sd = change(fit)
    assert abs(moved) < SURE * sd


def test_a_change_as_large_as_its_blind_spot_moves_the_gap_as_told(independent):
    """The linear forecast against a full fit of recordings with that very change."""
    fit, found = changes(nominal_fit(independent, {}, seed=4))
    spot = next(s for s in found.blind_spots if s.name == "shaft_damping_nm_s_per_rad")
    changed = {spot.name: BELIEVED[spot.name] + spot.size}
    moved, _ = change(nominal_fit(independent, changed, seed=4))
    unmoved, sd = change(fit)
    assert abs(abs(moved - unmoved) - spot.error_rad) < 0.3 * spot.error_rad + 0.1 * sd


def test_blind_spots_grow_where_the_current_is_missing(independent):
    errors = {}
    for alone in (False, True):
        _, found = changes(nominal_fit(independent, {}, seed=6, speed_alone=alone))
        errors[alone] = {s.name: s.error_rad for s in found.blind_spots}
    gain = "speed_gain_nm_s_per_rad"
    assert errors[True][gain] > 5.0 * errors[False][gain]
    assert found.blind_spots == tuple(sorted(found.blind_spots, key=lambda s: -s.error_rad))


def test_a_blind_spot_needs_no_negative_friction_elsewhere(independent):
    """At one speed, dry friction looks like viscous friction, but only like what is there."""
    coefficient = 1e-4
    viscous = "motor_viscous_friction__coefficient_nm_s_per_rad"
    stated = {"coefficient_nm_s_per_rad": EffectParameterValue(coefficient)}
    bench = BENCH.with_effects(BenchEffect("motor_viscous_friction", stated))
    truth = {"motor_viscous_friction.coefficient_nm_s_per_rad": coefficient}
    fit = nominal_fit(independent, truth, seed=9, first=truth, bench=bench)
    drift = Unknown(viscous, -coefficient, recording="after", added=True, reference=coefficient)
    fit = fit_simulated(fit.model.with_unknowns(bench, [drift]), np.append(fit.point, 0.0))
    spots = {s.name: s for s in blind_spots(fit)}
    speed_rad_per_s = bench.value("reference_speed_rpm") * math.pi / 30.0
    largest = coefficient + fit.value(viscous, "after") + fit.sd(viscous, "after")
    size = spots["motor_coulomb_friction.torque_nm"].size
    assert 0.0 < size < 1.1 * largest * speed_rad_per_s


def test_what_is_freed_never_leaves_the_physics(independent):
    """Speed alone hardly tells a Stribeck speed from zero: its draws must not go below."""
    truth = {
        "motor_stribeck_friction.torque_nm": 0.05,
        "motor_stribeck_friction.speed_rad_per_s": 200.0,
    }
    fit, found = changes(nominal_fit(independent, truth, seed=8, speed_alone=True))
    assert found.explained
    settings = SamplerSettings(ensembles=2, max_steps=500)
    posterior = sample_direct(fit, settings, np.random.SeedSequence(8))
    assert np.all(np.isfinite(posterior.values(GAP, "after")))


@pytest.mark.long
def test_colder_grease_leaves_the_gap_alone_at_one_speed(independent):
    """Coulomb and viscous friction together: the drift of what a fit has of friction takes both."""
    truth = {
        "motor_coulomb_friction.torque_nm": 0.1,
        "motor_viscous_friction.coefficient_nm_s_per_rad": 4e-4,
    }
    seen = nominal_fit(independent, truth, seed=11).model.recordings
    grown, sd = change(fit_jointly(BENCH, seen, GAP_RANGE_RAD, {}).linear_fit.fit)
    assert abs(grown) < 2.6 * sd  # a false alarm in a hundred
