"""Laws that bias the gap before they show, and drift, beside fits of simulated recordings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from bayesbl.bench.bench import Bench, BenchEffect, BenchParameter, EffectParameterValue
from bayesbl.bench.effects import EFFECT_BY_NAME, EFFECTS, effect_named
from bayesbl.bench.kernel import Slot
from bayesbl.bench.parameters import BENCH_PARAMETERS, DEFAULT_DRIFT, PARAMETER_INFO, drift_of
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import Observed, observed
from bayesbl.matching.posterior import sample_direct
from bayesbl.matching.signals import GAP, Unknown, gap_unknown, start_angle_unknown
from bayesbl.measurement.direct_route import direct_reasons, fit_directly
from bayesbl.model_search import always_in
from bayesbl.model_search.always_in import (
    Direction,
    Label,
    always_terms,
    directions,
    edge_variances,
    laws,
    linearised_fit,
    marginalised,
    with_far_terms_freed,
    with_friction,
    with_neutral,
)
from bayesbl.model_search.catalogue import candidates
from bayesbl.model_search.closed_loop import weighed
from bayesbl.model_search.joint_change import loops_and_parts, with_part
from bayesbl.model_search.linear import Linearised, Term, search
from bayesbl.model_search.pipeline import JointFit, direct_unknowns, fit_jointly
from bayesbl.model_search.refit import Explanation, refit
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, Recording
from bayesbl.sampling.chains import SamplerSettings

BENCH = reference_bench()
GAP_RAD = 8e-4
DAMPING = "shaft_damping_nm_s_per_rad"
INERTIA, GRAVITY = "load_inertia_kg_m2", "gravity_torque_nm"
STIFFNESS = "shaft_stiffness_nm_per_rad"
GAIN = "speed_gain_nm_s_per_rad"


def pair_seen(second: Bench, seed: int) -> list[Observed]:
    """Two snapshots of one gap, the second of another bench."""
    rng = np.random.default_rng(seed)
    return [
        observed(
            made.simulate(
                GAP_RAD,
                rotations=3,
                start_angle_rad=float(rng.uniform(-3.0, 3.0)),
                seed=rng,
                name=name,
            ),
            BENCH,
        )
        for name, made in (("before", BENCH), ("after", second))
    ]


def pair(second: Bench, seed: int = 1) -> SimulatedFit:
    """Two snapshots of one gap, the second of another bench, fitted with the first's."""
    seen = pair_seen(second, seed)
    return fit_aligned(BENCH, seen, direct_unknowns(BENCH, ["before", "after"], (1e-4, 1e-2)))


def scaled(**factors: float) -> Bench:
    return BENCH.with_parameters(**{n: BENCH.value(n) * f for n, f in factors.items()})


def change(fit: SimulatedFit, shift: np.ndarray) -> tuple[float, float]:
    """Of ln δ and its standard deviation, with draws of what moves the unknowns, (n, d)."""
    toward = np.zeros(fit.point.size)
    toward[fit.model.index(GAP, "after")], toward[fit.model.index(GAP, "before")] = 1.0, -1.0
    moved = shift @ toward
    sd = math.hypot(math.sqrt(toward @ fit.covariance @ toward), float(moved.std()))
    return float(toward @ fit.point + moved.mean()), sd


def test_every_budget_is_of_something_that_exists_and_has_a_source() -> None:
    assert set(DEFAULT_DRIFT) <= set(PARAMETER_INFO) | set(EFFECT_BY_NAME)
    assert all(relative_sd > 0.0 for relative_sd in DEFAULT_DRIFT.values())


def test_what_people_set_does_not_drift_unless_told() -> None:
    for name in (INERTIA, GRAVITY, "speed_gain_nm_s_per_rad"):
        assert drift_of(name, {}) == 0.0
        assert drift_of(name, {name: 0.02}) == 0.02


def test_a_stated_zero_switches_a_drift_off_and_a_tolerance_the_usual_size() -> None:
    def damping(bench: Bench, stated: dict[str, float]) -> tuple[float, float]:
        (own,) = [d for d in directions(bench, stated) if d.slot == DAMPING]
        return own.usual, own.drift

    usual, drift = damping(BENCH, {})
    assert usual > 0.0
    assert drift > 0.0
    assert damping(BENCH, {DAMPING: 0.0}) == (usual, 0.0)
    value = BENCH.value(DAMPING)
    known = replace(
        BENCH, parameters={**BENCH.parameters, DAMPING: BenchParameter(value, 0.05 * value)}
    )
    assert damping(known, {}) == (0.0, drift)


def test_a_law_that_the_bench_states_is_not_in_twice_and_drifts_with_its_own_size() -> None:
    law = BenchEffect("contact_damping", {"factor_s_per_rad": EffectParameterValue(0.8)})
    (own,) = [
        d
        for d in directions(BENCH.with_effects(law), {})
        if d.slot == "contact_damping__factor_s_per_rad"
    ]
    assert own.usual == 0.0
    assert own.drift == pytest.approx(0.8 * drift_of("contact_damping", {}))


DRIVE = BENCH.with_effects(
    BenchEffect("sampled_control", {"period_s": EffectParameterValue(2.5e-4)}),
)


@pytest.mark.parametrize("slot", ["speed_sensor_lag__time_s", "current_loop_lag__time_s"])
def test_the_column_of_a_lag_beside_ticks_is_what_the_lag_does(slot: str) -> None:
    """Beside what the unknowns of the fit do: that is what it is known by."""
    name = "one"
    made = DRIVE.simulate(GAP_RAD, rotations=3, seed=np.random.default_rng(5), name=name)
    unknowns = [
        *direct_unknowns(DRIVE, [name], (1e-4, 1e-2)),
        *(Unknown(n, centre=DRIVE.value(n), sd=0.1 * DRIVE.value(n)) for n in (STIFFNESS, GAIN)),
    ]
    fit = fit_aligned(DRIVE, [observed(made, DRIVE)], unknowns)
    (own,) = [d for d in directions(DRIVE, {}) if d.slot == slot]
    (label,), (column,) = always_terms(fit, [own])
    lagging = with_neutral(DRIVE, [own])
    beside_lag = fit.model.with_unknowns(lagging, [Unknown(slot, added=True)])
    size_s = 5e-4
    none, some = beside_lag.whitened(np.append(fit.point, 0.0)), np.append(fit.point, size_s)
    whole = (none[0] - beside_lag.whitened(some)[0]) * label.scales[0] / size_s
    jacobian, prior = fit.derivatives(), fit.model.prior_precision()
    explained = np.linalg.solve(jacobian.T @ jacobian + prior, jacobian.T)
    left = [v - jacobian @ (explained @ v) for v in (column[:, 0], whole)]
    sizes = [float(np.linalg.norm(v)) for v in left]
    assert left[0] @ left[1] > 0.95 * sizes[0] * sizes[1]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.25)


def test_dry_friction_at_one_speed_is_told_from_viscous_by_the_crossing() -> None:
    """Of a load that has dry friction alone, the gap within 3.5 standard deviations."""
    torque_nm = 0.05 * BENCH.value(GRAVITY)
    dry = BenchEffect("load_coulomb_friction", {"torque_nm": EffectParameterValue(torque_nm)})
    made = BENCH.with_effects(dry)
    rng = np.random.default_rng(12)
    gaps_rad = {"before": 7e-4, "after": 9e-4}
    seen = [
        observed(made.simulate(gap, rotations=3, seed=rng, name=name), BENCH)
        for name, gap in gaps_rad.items()
    ]
    whole = fit_jointly(BENCH, seen, (1e-4, 1e-2), {})
    rest, joint = whole.linear_fit, whole.joint
    fit = rest.fit
    assert joint.explained
    shift = rest.posterior.draw(np.random.default_rng(0), 1000).shift
    for name, gap in gaps_rad.items():
        place = fit.model.index(GAP, name)
        sd = math.hypot(math.sqrt(fit.covariance[place, place]), float(shift[:, place].std()))
        assert abs(fit.point[place] + shift[:, place].mean() - math.log(gap)) < 3.5 * sd


@pytest.mark.parametrize(
    ("delay", "with_current"),
    [
        (0.0, True),
        pytest.param(0.0, False, marks=pytest.mark.long),
        pytest.param(1.0, True, marks=pytest.mark.long),
    ],
)
def test_a_controller_that_reads_the_speed_of_the_instant_is_less_late(
    independent: ModuleType, delay: float, with_current: bool
) -> None:
    """By half a period; δ within 3.5 standard deviations, on a sheet that is off."""
    period = EffectParameterValue(1e-3)
    off = scaled(**{INERTIA: 1.02, STIFFNESS: 0.97, GRAVITY: 1.01})
    shares = {INERTIA: 0.05, STIFFNESS: 0.08, GRAVITY: 0.04, GAIN: 0.01}
    known = {n: BenchParameter(off.value(n), share * off.value(n)) for n, share in shares.items()}
    bench = replace(off, parameters={**off.parameters, **known})
    bench = bench.with_effects(BenchEffect("sampled_control", {"period_s": period}))
    truth = {name: item.value for name, item in BENCH.parameters.items()}
    truth |= {"sampled_control.period_s": 1e-3, "sampled_control.delay_periods": delay}
    truth |= {"outside__speed_of_instant": 1.0, "start_angle_rad": 0.4}
    seen = by_ticks(independent, bench, truth, with_current)
    whole = fit_jointly(bench, seen, (1e-4, 1e-2), {})
    assert_holds_the_gaps(whole)


@pytest.mark.parametrize(
    ("period_s", "delay"), [(2e-3, 0.0), pytest.param(1e-3, 1.0, marks=pytest.mark.long)]
)
def test_a_period_that_nobody_states_is_found_beside_dry_friction(
    independent: ModuleType, period_s: float, delay: float
) -> None:
    """Of both sides; without the ticks the loop's lags stand in, and the gap is withheld."""
    truth = {name: item.value for name, item in BENCH.parameters.items()}
    truth |= {"sampled_control.period_s": period_s, "sampled_control.delay_periods": delay}
    truth |= {"motor_coulomb_friction.torque_nm": 0.2, "load_coulomb_friction.torque_nm": 8.0}
    seen = by_ticks(independent, BENCH, truth | {"start_angle_rad": 0.4}, True)
    whole = fit_jointly(BENCH, seen, (1e-4, 1e-2), {})
    assert_holds_the_gaps(whole)
    (ticks,) = [e for e in whole.linear_fit.fit.model.bench.effects if e.name == "sampled_control"]
    assert ticks.complete()["period_s"] == period_s
    fit = whole.linear_fit.fit
    share = fit.value("sampled_control__instant_share")
    # The age of the current does not say how late the loop is, so a share may make up for a delay.
    late = fit.value("sampled_control__delay_periods") - 0.5 * share
    assert late == pytest.approx(delay, abs=0.1)


def test_loops_that_fit_alike_are_averaged_over(independent: ModuleType) -> None:
    """By the speed alone; what fits worse by χ² 20 has no share."""
    truth = {name: item.value for name, item in BENCH.parameters.items()}
    truth |= {"sampled_control.period_s": 5e-4, "sampled_control.delay_periods": 1.0}
    seen = by_ticks(independent, BENCH, truth | {"start_angle_rad": 0.4}, with_current=False)
    whole = fit_jointly(BENCH, seen, (1e-4, 1e-2), {})
    assert_holds_the_gaps(whole)
    chosen = whole.linear_fit.fit
    loops = [(own.fit, share) for own, share in whole.others if not own.explanation.candidates]
    assert loops
    assert sum(share for _, share in whole.others) < 1.0
    for fit, share in loops:
        assert share < 1e-3 or fit.chi_square < chosen.chi_square + 20.0


def test_a_current_that_is_read_before_the_new_torque_acts_moves_no_gap(
    independent: ModuleType,
) -> None:
    """As drives measure it: a period older than the loop's dead time says, beside a filter."""
    truth = {name: item.value for name, item in BENCH.parameters.items()}
    truth |= {"sampled_control.period_s": 1e-3, "sampled_control.delay_periods": 1.0}
    truth |= {"outside__loop_filter": 0.7, "channel_time_skew.current_s": 1e-3}
    shares = {INERTIA: 0.05, STIFFNESS: 0.08, GRAVITY: 0.04, GAIN: 0.05}
    known = {n: BenchParameter(BENCH.value(n), s * BENCH.value(n)) for n, s in shares.items()}
    sheet = replace(BENCH, parameters={**BENCH.parameters, **known})
    period = BenchEffect("sampled_control", {"period_s": EffectParameterValue(1e-3)})
    seen = by_ticks(independent, sheet.with_effects(period), truth | {"start_angle_rad": 0.4}, True)
    whole = fit_jointly(sheet.with_effects(period), seen, (1e-4, 1e-2), {})
    assert_holds_the_gaps(whole)


GAPS_RAD = {"before": 7e-4, "after": 9e-4}


def by_ticks(
    independent: ModuleType, bench: Bench, truth: Mapping[str, float], with_current: bool
) -> list[Observed]:
    """Two snapshots by another simulator."""
    rng, seen = np.random.default_rng(5), []
    for name, gap in GAPS_RAD.items():
        plant = independent.plant(truth, gap_rad=gap)
        _, speed, current = independent.noise_free(plant, 3.02, 1000.0)
        channels = {MOTOR_SPEED: speed + 0.2 * rng.standard_normal(speed.size)}
        if with_current:
            channels[MOTOR_CURRENT] = current + 0.02 * rng.standard_normal(speed.size)
        made = Recording(name, np.arange(speed.size) / 1000.0, channels)
        seen.append(observed(made, bench, 2000.0))
    return seen


def assert_holds_the_gaps(whole: JointFit) -> None:
    assert whole.joint.explained
    fit, shift = (
        whole.linear_fit.fit,
        whole.linear_fit.posterior.draw(np.random.default_rng(0), 1000).shift,
    )
    for name, gap in GAPS_RAD.items():
        place = fit.model.index(GAP, name)
        sd = math.hypot(math.sqrt(fit.covariance[place, place]), float(shift[:, place].std()))
        assert abs(fit.point[place] + shift[:, place].mean() - math.log(gap)) < 3.5 * sd
        assert sd < 0.03
    error, sd = change(fit, shift)
    assert abs(error - math.log(GAPS_RAD["after"] / GAPS_RAD["before"])) < 3.5 * sd


@pytest.mark.long
def test_a_law_that_no_catalogue_has_widens_the_gap(independent: ModuleType) -> None:
    """Friction that varies over the load's turn: the truth within 3.5 standard deviations."""
    rng = np.random.default_rng(77)
    gaps_rad = {"before": 7e-4, "after": 9e-4}
    truth = {n: p.value for n, p in BENCH.parameters.items()}
    truth |= {"reference_speed_rpm": 2000.0, "start_angle_rad": 0.7}
    truth |= {"outside__position_friction_nm": 0.005 * BENCH.value(GRAVITY)}
    seen = []
    for name, gap in gaps_rad.items():
        plant = independent.plant(truth, gap_rad=gap)
        made = independent.simulate(plant, rng, name=name, rotations=3).recording
        seen.append(observed(made, BENCH))
    match = fit_directly(
        BENCH, seen, (1e-4, 1e-2), {}, SamplerSettings(), np.random.SeedSequence(1)
    )
    assert not match.joint.explained
    assert match.allows_for_misfit
    for name, gap in gaps_rad.items():
        log_gap = np.log(match.posterior.values(GAP, name))
        assert abs(log_gap.mean() - math.log(gap)) < 3.5 * log_gap.std()
    assert match.posterior.model_widening[0] > 1.5
    said = [
        [reason for reason in direct_reasons(match, index) if reason.code == "allows_for_misfit"]
        for index in range(len(seen))
    ]
    assert all(of_one == said[0] != [] for of_one in said)


@pytest.mark.long
def test_teeth_that_let_go_do_not_move_the_gap_though_nothing_shows_it() -> None:
    """With three times the damping, fitted without that law gaps are 4 standard deviations off,
    and χ² is that of noise."""
    damped = scaled(shaft_damping_nm_s_per_rad=3.0)
    release = BenchEffect("contact_release", {"share": EffectParameterValue(1.0)})
    made = damped.with_effects(*damped.effects, release)
    rng = np.random.default_rng(1)
    seen = [
        observed(made.simulate(gap, rotations=3, seed=rng, name=name), damped)
        for name, gap in GAPS_RAD.items()
    ]
    alone = fit_aligned(damped, seen, direct_unknowns(damped, [*GAPS_RAD], (1e-4, 1e-2)))
    assert alone.chi_square < 1.03 * alone.residual.size
    for name, gap in GAPS_RAD.items():
        error = alone.point[alone.model.index(GAP, name)] - math.log(gap)
        assert error < -4.0 * alone.sd(GAP, name)
    assert_holds_the_gaps(fit_jointly(damped, seen, (1e-4, 1e-2), {}))


@pytest.mark.long
def test_a_law_many_times_as_large_as_usual_is_not_pulled_back_to_its_usual_size() -> None:
    """Damping in the gap as large as the shaft's, where a data sheet is off within its tolerances.

    A normal prior of the usual size pulls by 19 of its standard deviations, along which tolerances
    move the gap: 4 %.
    """
    rng = np.random.default_rng(5)
    names = (INERTIA, STIFFNESS, DAMPING, GRAVITY, "motor_inertia_kg_m2")
    sheet = replace(
        BENCH,
        parameters={
            name: BenchParameter(item.value, 0.08 * item.value) if name in names else item
            for name, item in BENCH.parameters.items()
        },
    )
    share = {name: 1.0 + 0.08 * rng.uniform(-1.0, 1.0) for name in names}
    coefficient = EffectParameterValue(BENCH.value(DAMPING))
    made = scaled(**share).with_effects(
        BenchEffect("gap_damping", {"coefficient_nm_s_per_rad": coefficient})
    )
    seen = [
        observed(made.simulate(gap, rotations=3, seed=rng, name=name), sheet)
        for name, gap in GAPS_RAD.items()
    ]
    whole = fit_jointly(sheet, seen, (1e-4, 1e-2), {})
    assert any(u.name.startswith("gap_damping") for u in whole.linear_fit.fit.model.unknowns)
    assert_holds_the_gaps(whole)


@pytest.mark.parametrize("share", [0.8, 1.0, 1.3])
def test_the_least_that_a_change_leaves_is_a_hundredth_of_what_there_was(share: float) -> None:
    """Also where that is not the bench's value."""
    fit = pair(BENCH)
    value = share * BENCH.value(STIFFNESS)
    label = Label((Direction(STIFFNESS, 0.0, 0.0, 0.1 * value),), "after", "shaft")
    bench_values = BENCH.vector(**{STIFFNESS: value})[0]
    shared = Unknown(STIFFNESS, 0.1 * value, 10.0 * value)
    (change_of,) = label.unknowns(bench_values, np.ones(1))
    model = fit.model.with_unknowns(BENCH, [shared, change_of])
    point = np.array([*fit.point, value, change_of.low])
    _, after = (
        float(model.vectors(point[None], own)[0, Slot[STIFFNESS]]) for own in model.recordings
    )
    assert after == pytest.approx(0.01 * value)


def test_drift_of_an_absent_law_is_at_least_what_shows() -> None:
    """A mean over no time is another limit of a sampled drive: a fit got stuck there."""
    (averaging,) = [d for d in directions(BENCH, {}) if d.slot.startswith("speed_averaging")]
    (drift,) = Label((averaging,), "after", "filter").unknowns(BENCH.vector()[0], np.ones(1))
    assert drift.low == effect_named("speed_averaging").main_amplitude.sought_from


def test_a_law_that_the_bench_lacks_cannot_become_less_in_one_snapshot() -> None:
    """A mean over less than no time and a skew, which cancel, were certain: each was made a fit."""
    (averaging,) = [d for d in directions(BENCH, {}) if d.slot.startswith("speed_averaging")]
    changed, column = Label((averaging,), "after", "speed_averaging"), np.ones((3, 1))
    assert changed.term(column, BENCH).positive
    assert changed.term(column, BENCH).absent == 0.0
    assert not changed.term(column, with_neutral(BENCH, [averaging])).positive
    assert not Label((averaging,), "after").term(column, BENCH).positive


def test_drift_and_a_changed_payload_are_not_taken_for_wear() -> None:
    """The change was 14 standard deviations off, and the gap "grew, > 99.9 %"."""
    nominal = pair(scaled(**{INERTIA: 1.03, STIFFNESS: 0.99}))
    before, sd = change(nominal, np.zeros((2, nominal.point.size)))
    assert abs(before) > 5.0 * sd
    rest = with_far_terms_freed(nominal, directions(BENCH, {}))
    fit = rest.fit
    after, wider = change(fit, rest.posterior.draw(np.random.default_rng(0), 2000).shift)
    assert abs(after) < 2.6 * wider  # one false alarm in a hundred


@pytest.mark.long
@pytest.mark.parametrize("effect", [effect.name for effect in EFFECTS if effect.may_change])
def test_what_a_setting_or_a_weight_does_to_one_recording_is_not_taken_for_wear(
    effect: str,
) -> None:
    """A speed averaged over 8 ms in one of two recordings was a gap smaller by 7 %."""
    amplitude = effect_named(effect).main_amplitude
    size = {amplitude.name: EffectParameterValue(2.0 * amplitude.typical)}
    seen = pair_seen(BENCH.with_effects(BenchEffect(effect, size)), seed=11)
    whole = fit_jointly(BENCH, seen, (1e-4, 1e-2), {})
    assert whole.joint.explained
    shift = whole.linear_fit.posterior.draw(np.random.default_rng(0), 2000).shift
    found, wider = change(whole.linear_fit.fit, shift)
    assert abs(found) < 2.6 * wider  # one false alarm in a hundred
    assert wider < 0.03


@pytest.mark.long
def test_a_payload_changes_inertia_and_gravity_at_once() -> None:
    """Gravity is seen at once; the inertia looked like drift of damping and stiffness."""
    nominal = pair(scaled(**{INERTIA: 0.97, GRAVITY: 1.03}), seed=3)
    rest = with_far_terms_freed(nominal, directions(BENCH, {}))
    fit = rest.fit
    assert {INERTIA, GRAVITY} <= {u.name for u in fit.model.unknowns if u.added}
    found, wider = change(fit, rest.posterior.draw(np.random.default_rng(0), 2000).shift)
    assert abs(found) < 2.6 * wider  # one false alarm in a hundred


@pytest.mark.long
def test_an_unchanged_joint_stays_sharp_and_nothing_is_made_an_unknown() -> None:
    nominal = pair(BENCH, seed=2)
    rest = with_far_terms_freed(nominal, directions(BENCH, {}))
    fit = rest.fit
    assert fit is nominal
    _, sd = change(nominal, np.zeros((2, nominal.point.size)))
    found, wider = change(fit, rest.posterior.draw(np.random.default_rng(0), 2000).shift)
    assert sd < wider < 2.0 * sd
    assert abs(found) < 2.6 * wider


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_a_damping_that_only_the_gap_shows_is_within_the_interval(
    independent: ModuleType, seed: int
) -> None:
    """Nothing repeats that noise does not explain, and δ is two or three deviations too small."""
    gap_rad = 2.3e-4
    made = independent.random_recordings(
        {info.name: BENCH.value(info.name) for info in BENCH_PARAMETERS},
        {"outside__contact_damping_nm_s_per_rad": 1000.0},
        np.random.default_rng(seed),
        gap_rad=(gap_rad, gap_rad),
        speeds_rpm=(2000.0, -2000.0, 1200.0),
    )
    seen = [observed(m.recording, BENCH, m.truth.reference_speed_rpm) for m in made]
    unknowns = [gap_unknown(1e-4, 4e-3), *(start_angle_unknown(s.name) for s in seen)]
    fit = fit_aligned(BENCH, seen, unknowns)
    assert (fit.point[0] - math.log(gap_rad)) / fit.sd(GAP) < -1.645
    shift = (
        linearised_fit(fit, laws(BENCH)).posterior.draw(np.random.default_rng(0), 4000).shift[:, 0]
    )
    sd = math.hypot(fit.sd(GAP), float(shift.std()))
    assert abs(fit.point[0] + shift.mean() - math.log(gap_rad)) < 1.645 * sd


BELT_HZ, REDUCER_SHARE = 80.0, 0.4


def with_belt(bench: Bench) -> Bench:
    """Whose motor hangs on a belt, the share of its inertia behind it."""
    swings = bench.value("motor_inertia_kg_m2") * REDUCER_SHARE * (1.0 - REDUCER_SHARE)
    values = {
        "compliance_rad_per_nm": 1.0 / ((2.0 * math.pi * BELT_HZ) ** 2 * swings),
        "damping_ratio": 0.05,
        "reducer_share": REDUCER_SHARE,
    }
    belt = BenchEffect("belt", {n: EffectParameterValue(v) for n, v in values.items()})
    return bench.with_effects(belt)


def test_a_belt_is_found_with_its_frequency_where_tolerances_would_take_it_up() -> None:
    sheet = replace(
        BENCH,
        parameters={
            name: BenchParameter(item.value, 0.1 * item.value)
            if name in (STIFFNESS, DAMPING, INERTIA, "motor_inertia_kg_m2")
            else item
            for name, item in BENCH.parameters.items()
        },
    )
    seed = np.random.default_rng(4)
    made = with_belt(BENCH).simulate(
        GAP_RAD, rotations=3, start_angle_rad=0.7, seed=seed, name="one"
    )
    unknowns = direct_unknowns(sheet, ["one"], (1e-4, 1e-2))
    nominal = fit_aligned(sheet, [observed(made, sheet)], unknowns)
    (best, probability), *_ = loops_and_parts(nominal, (), directions(BENCH, {}))
    fit, _, part = with_part(nominal, best.explanation, probability)
    assert part.name == "belt"
    assert part.frequency_hz == pytest.approx(BELT_HZ, rel=0.1)
    place = fit.model.index(GAP, "one")
    z = (fit.point[place] - math.log(GAP_RAD)) / math.sqrt(fit.covariance[place, place])
    assert abs(z) < 3.0
    assert fit.chi_square < nominal.chi_square - 30.0


def test_a_fit_without_its_discrepancy_gives_no_gap_where_something_repeats() -> None:
    """However narrow: its draws know nothing of what nothing explains."""
    fit = pair(BENCH)
    assert not linearised_fit(fit, directions(BENCH, {})).is_useful


def test_what_stands_beside_a_fit_leaves_its_derivatives_as_they_are() -> None:
    """Of an unknown at the end of its range they were lost."""
    fit = pair(BENCH).with_derivatives()
    fit.point[0] = fit.model.high[0]
    before = fit.derivatives().copy()
    weighed(Explanation((), fit))
    assert np.array_equal(fit.derivatives(), before)


def test_a_set_explains_what_its_marginalised_terms_explain() -> None:
    """Drifted damping repeats in the residual, and the drift that is marginalised explains it."""
    fit, among = pair(scaled(**{DAMPING: 0.6})), directions(BENCH, {})
    assert not weighed(Explanation((), fit)).explains_all
    assert weighed(Explanation((), fit), among).explains_all


def test_a_law_that_no_start_can_simulate_is_left_out() -> None:
    """A lag that makes the loop unstable, not an error of the bench."""
    fit = pair(BENCH)
    name = "current_loop_lag"
    (lag,) = (c for c in candidates(BENCH, fit.model.recordings, [name]) if c.name == name)
    slow = replace(lag, unknowns=(replace(lag.unknowns[0], low=0.1, high=0.2),))
    shift = np.zeros(fit.point.size)
    assert refit(Explanation((), fit), [(slow, np.array([0.15]))], shift) is None


def test_no_elastic_part_is_found_in_a_joint_that_has_none() -> None:
    (best, _), *_ = loops_and_parts(pair(BENCH), (), directions(BENCH, {}))
    assert not best.explanation.candidates


def test_friction_that_the_bench_lacks_moves_no_gap() -> None:
    """Friction at the load moves the flank changes, that of the motor the current's mean."""
    friction = (
        BenchEffect(
            "load_viscous_friction", {"coefficient_nm_s_per_rad": EffectParameterValue(6.0)}
        ),
        BenchEffect("motor_coulomb_friction", {"torque_nm": EffectParameterValue(0.12)}),
    )
    made = BENCH.with_effects(*friction)
    gaps_rad = {"before": 7e-4, "after": 9e-4}
    rng = np.random.default_rng(20261126)
    seen = [
        observed(made.simulate(gap, rotations=3, seed=rng, name=name), BENCH)
        for name, gap in gaps_rad.items()
    ]
    whole = fit_jointly(BENCH, seen, (1e-4, 1e-2), {})
    fit, joint = whole.linear_fit.fit, whole.joint
    assert joint.explained
    assert not joint.changed
    for name, gap in gaps_rad.items():
        place = fit.model.index(GAP, name)
        sd = math.sqrt(fit.covariance[place, place])
        assert abs(fit.point[place] - math.log(gap)) < 3.5 * sd
        assert sd < 0.01


def test_soft_edges_that_show_are_in_the_interval_of_the_gap_but_not_of_its_change() -> None:
    """What is called the gap is open by the edge's width, alike in both snapshots."""
    variance, gaps_rad = 2.5e-9, {"before": 7e-4, "after": 9e-4}
    soft = BenchEffect("contact_softness", {"variance_rad2": EffectParameterValue(variance)})
    rng = np.random.default_rng(20261127)
    seen = [
        observed(BENCH.with_effects(soft).simulate(gap, rotations=3, seed=rng, name=name), BENCH)
        for name, gap in gaps_rad.items()
    ]
    match = fit_directly(
        BENCH, seen, (1e-4, 1e-2), {}, SamplerSettings(), np.random.SeedSequence(1)
    )
    assert edge_variances(match.posterior).mean() == pytest.approx(variance, rel=0.5)
    edge_rad = math.sqrt(variance)
    for name, gap in gaps_rad.items():
        draws = match.posterior.values(GAP, name)
        assert 0.7 * edge_rad < draws.std() < 1.5 * edge_rad
        assert abs(draws.mean() - gap) < edge_rad
    change = match.change_rad
    assert change.std() < 0.2 * edge_rad
    assert abs(change.mean() - 2e-4) < 3.5 * change.std()


def test_no_gap_is_known_more_precisely_than_the_edges_of_the_arctan_are_wide() -> None:
    """Alike in both snapshots, so the change is as precise as before."""
    fit = pair(BENCH)
    posterior = sample_direct(fit, SamplerSettings(), np.random.SeedSequence(1), withheld=True)
    certain = replace(posterior, draws=np.zeros_like(posterior.draws) + fit.point)
    nothing = np.zeros((1, fit.point.size))
    view = Linearised(np.zeros(1), nothing, np.eye(fit.point.size), nothing[0], [], nothing[:, :0])
    moved = marginalised(certain, search(view), np.random.SeedSequence(2))
    before, after = moved.values(GAP, "before"), moved.values(GAP, "after")
    edge_rad = 1.0 / BENCH.value("stiffness_sharpness_per_rad")
    assert before.std() == pytest.approx(edge_rad, rel=0.1)
    assert np.ptp(after - before) < 1e-3 * edge_rad


def test_no_drift_takes_a_parameter_below_zero_that_its_tolerance_lowers() -> None:
    nominal = BENCH.value(STIFFNESS)
    bench = replace(
        BENCH, parameters={**BENCH.parameters, STIFFNESS: BenchParameter(nominal, 0.25 * nominal)}
    )
    fit = pair(BENCH)
    unknowns = [
        Unknown(STIFFNESS, 0.75 * nominal, 1.25 * nominal),
        Unknown(STIFFNESS, -nominal, sd=0.01 * nominal, recording="after", added=True),
    ]
    model = fit.model.with_unknowns(bench, unknowns)
    point = np.array([*fit.point, 0.75 * nominal, -0.9 * nominal])
    before, after = (
        float(model.vectors(point[None], seen)[0, Slot[STIFFNESS]]) for seen in model.recordings
    )
    assert before == pytest.approx(0.75 * nominal)
    assert after == pytest.approx(0.1 * before)


def test_a_drift_below_what_all_have_leaves_nothing_and_every_column_is_finite() -> None:
    """What all share may fall after the drift was fitted: then the second has no friction."""
    slot = Slot.motor_viscous_friction__coefficient_nm_s_per_rad
    seen = pair_seen(BENCH, 1)
    bench = with_friction(BENCH, seen)
    fit = fit_aligned(bench, seen, direct_unknowns(bench, [s.name for s in seen], (1e-4, 1e-2)))
    drift = Unknown(slot.name, -1.0, 1.0, recording="after", added=True)
    model = fit.model.with_unknowns(bench, [drift])
    point = np.array([*fit.point, -1e-3])
    for shared in (2e-5, 0.0):
        point[model.index(slot.name)] = shared
        before, after = (float(model.vectors(point[None], own)[0, slot]) for own in seen)
        assert (before, after) == (shared, 0.0)
        at = SimulatedFit(
            model, point, model.whitened(point)[0], fit.curvature, fit.covariance, fit.steps
        )
        labels, columns = always_terms(at, directions(bench, {}))
        assert any(label.directions[0].instead_of == slot.name for label in labels) == bool(shared)
        assert all(np.all(np.isfinite(by)) for by in columns)


def test_a_law_at_the_end_of_its_range_has_its_slope_from_within() -> None:
    arm = {"compliance_rad_per_nm": 2e-5, "inertia_share": 0.3}
    (damping,) = [p for p in EFFECT_BY_NAME["arm"].shapes if p.name == "damping_ratio"]
    sizes = []
    for value in (damping.high, 0.9 * damping.high):
        parameters = {n: EffectParameterValue(v) for n, v in arm.items()}
        parameters[damping.name] = EffectParameterValue(value)
        bench = BENCH.with_effects(BenchEffect("arm", parameters))
        seen = observed(
            bench.simulate(GAP_RAD, rotations=3, seed=np.random.default_rng(1), name="one"), bench
        )
        fit = fit_aligned(bench, [seen], direct_unknowns(bench, ["one"], (1e-4, 1e-2)))
        own = Direction(f"arm__{damping.name}", 0.2 * damping.high, 0.0, is_fitted=True)
        sizes.append(
            linearised_fit(fit, [own]).posterior.draw(np.random.default_rng(1), 500).sizes.std()
        )
    assert sizes[0] == pytest.approx(sizes[1], rel=0.3)


def test_drift_of_a_lag_in_one_recording_is_no_lag_of_the_loop() -> None:
    """It is freed by itself: no controller of another period explains one recording."""
    (lag,) = [d for d in directions(BENCH, {}) if d.effect == "speed_sensor_lag"]
    assert Label((lag,), None).is_lag
    assert not Label((replace(lag, drift=1e-4),), "after").is_lag


@pytest.mark.parametrize("explains", [True, False])
def test_the_fit_that_answers_is_the_one_that_was_checked(
    monkeypatch: pytest.MonkeyPatch, explains: bool
) -> None:
    """A one-sided fit explains the recordings; with central differences it may not."""
    model = SimpleNamespace(unknowns=())
    nominal, one_sided, central = (
        SimpleNamespace(model=model, point=None, steps=None, chi_square=0.0) for _ in range(3)
    )
    one_sided.without_derivatives = lambda: one_sided
    checked = {id(nominal): False, id(one_sided): True, id(central): explains}

    @dataclass
    class Checked:
        fit: SimpleNamespace
        loops: tuple[()] = ()

        @property
        def explains(self) -> bool:
            return checked[id(self.fit)]

    trials = iter([[one_sided], []])
    monkeypatch.setattr(always_in, "linearised_fit", lambda fit, _: Checked(fit))
    monkeypatch.setattr(always_in, "_with_next_freed", lambda *_: next(trials))
    monkeypatch.setattr(
        always_in, "fit_simulated", lambda *_, one_sided=False: fits[bool(one_sided)]
    )
    fits = {True: one_sided, False: central}
    answer = always_in.with_far_terms_freed(nominal, [])
    assert answer.fit is (central if explains else nominal)


def test_a_law_that_leads_out_of_a_range_still_widens_the_gap() -> None:
    """It took all of the friction's size and more, so no draw stayed within the range."""
    friction = {"coefficient_nm_s_per_rad": EffectParameterValue(20.0, 10.0)}
    bench = BENCH.with_effects(BenchEffect("load_viscous_friction", friction))
    made = bench.simulate(GAP_RAD, rotations=3, seed=np.random.default_rng(5), name="one")
    seen = observed(made, bench)
    unknowns = direct_unknowns(bench, ["one"], (1e-4, 1e-2))
    fit = fit_aligned(bench, [seen], unknowns)
    posterior = sample_direct(fit, SamplerSettings(max_steps=2000), np.random.SeedSequence(3))
    gap = fit.model.index(GAP, "one")
    coefficient = fit.model.index("load_viscous_friction__coefficient_nm_s_per_rad")
    triangle = np.linalg.qr(fit.derivatives(), mode="r")
    law = -0.05 * triangle[:, gap] + 1e4 * triangle[:, coefficient]
    view = Linearised(
        np.zeros(len(triangle)),
        triangle,
        np.zeros(triangle.shape),
        np.zeros(len(triangle)),
        [Term("law", law[:, None], positive=True, always=True)],
        np.zeros((len(triangle), 0)),
    )
    moved = marginalised(posterior, search(view), np.random.SeedSequence(4))
    widened = np.std(np.log(moved.values(GAP, "one")))
    assert widened == pytest.approx(0.05 * math.sqrt(1.0 - 2.0 / math.pi), rel=0.15)
    assert np.all(moved.draws >= fit.model.low)
