"""Naming on a rigid axis of any size: independent of units, with sizes, and with honest halves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bayesbl.bench.bench import Bench, BenchParameter
from bayesbl.bench.effects import effect_named
from bayesbl.diagnosis.diagnosis import Diagnosis
from bayesbl.diagnosis.disagreement import Use
from bayesbl.diagnosis.inference import diagnose
from bayesbl.diagnosis.rigid.inverse import (
    SKEW,
    TORQUE_LAWS,
    InverseView,
    coherent_hz,
    compared,
    resolved_hz,
    within_turns,
    without_load_angle,
)
from bayesbl.diagnosis.rigid.motion import LowPass
from bayesbl.recording.types import MOTOR_POSITION, MOTOR_TORQUE, Recording
from bayesbl.runs.study import seed_of_case
from experiments.positioning_axis import Axis, Row, believed, drawn_axis, recorded, run_case

pytestmark = pytest.mark.long

MOTOR = ("motor_coulomb_friction", "motor_viscous_friction", "motor_torque_offset")


def axis(seed: int, **changes: float) -> tuple[Axis, list[Recording]]:
    rng = np.random.default_rng(seed)
    made = replace(drawn_axis(rng), **changes)
    return made, [recorded(made, name, rng, lasting_s=8.0, hz=500.0) for name in "ab"]


def comparison(
    recordings: list[Recording], bench: Bench, cutoff_hz: float, uses: tuple[tuple[Use, ...], ...]
) -> InverseView:
    found = [
        part
        for recording, use in zip(recordings, uses, strict=True)
        for part in compared(recording, MOTOR_TORQUE, use, cutoff_hz)
    ]
    return InverseView(
        tuple(found),
        bench,
        within_turns(without_load_angle(TORQUE_LAWS), 0.1),
        ("motor_inertia_kg_m2",),
    )


def answer(made: InverseView) -> Diagnosis:
    return diagnose(made, made.bench, most=6)


def sizes(found: Diagnosis) -> dict[str, float]:
    return {e.name: next(iter(e.parameters.values())).value for e in found.effects}


WHOLE: tuple[tuple[Use, ...], ...] = (("used",), ("held_out",))


@pytest.mark.parametrize(
    ("angle", "torque", "time"),
    [(1e-3, 1.0, 1.0), (3.0, 1.0, 1.0), (1.0, 1e-3, 1e3), (3.0, 1e3, 1e-3)],
)
def test_no_answer_depends_on_the_units(angle: float, torque: float, time: float) -> None:
    """As long as the axis goes through less than a radian, and no order is known to a quarter.

    Gravity and a turn know the unit: of an order known so well, a whole one is tried too. The model
    is linear around a mean of 1000 draws, which rounding makes others: 3 % of a standard deviation.
    """
    made, recordings = axis(3)
    cogging = (
        0.5 * made.coulomb_nm,
        40.0 * 2.0 * math.pi / np.ptp(recordings[0].channels[MOTOR_POSITION]),
    )
    recordings = [
        Recording(
            r.name,
            r.time_s,
            {
                **r.channels,
                MOTOR_TORQUE: r.channels[MOTOR_TORQUE]
                + cogging[0] * np.sin(cogging[1] * r.channels[MOTOR_POSITION]),
            },
        )
        for r in recordings
    ]
    bench = believed(made)
    first = answer(comparison(recordings, bench, 20.0, WHOLE))
    ripple = next(e for e in first.effects if e.name == "motor_torque_ripple").parameters
    assert ripple["torque_nm"].value == pytest.approx(cogging[0], rel=0.05)
    assert ripple["order"].value == pytest.approx(cogging[1], rel=1e-2)
    scaled = [
        Recording(
            r.name,
            r.time_s * time,
            {
                MOTOR_POSITION: angle * r.channels[MOTOR_POSITION],
                MOTOR_TORQUE: torque * r.channels[MOTOR_TORQUE],
            },
        )
        for r in recordings
    ]
    inertia = torque * time**2 / angle
    parameters = {
        name: BenchParameter(item.value * inertia, item.tolerance * inertia)
        if name.endswith("kg_m2")
        else item
        for name, item in bench.parameters.items()
    }
    other = answer(comparison(scaled, replace(bench, parameters=parameters), 20.0 / time, WHOLE))
    assert {*MOTOR} <= {e.name for e in first.effects}
    assert other.verdict == first.verdict
    units = {
        "torque_nm": torque,
        "coefficient_nm_s_per_rad": torque * time / angle,
        "speed_rad_per_s": angle / time,
        "order": 1.0 / angle,
    }
    for one, same in zip(first.effects, other.effects, strict=True):
        assert one.name == same.name
        assert one.indistinguishable_from == same.indistinguishable_from
        for key, estimate in one.parameters.items():
            expected, sd = units[key] * estimate.value, units[key] * estimate.sd
            assert same.parameters[key].value == pytest.approx(expected, abs=0.1 * sd, rel=1e-3)
            assert same.parameters[key].sd == pytest.approx(sd, rel=0.03)


@pytest.mark.parametrize("seed", [3, 5])
def test_the_three_laws_of_a_slow_axis_are_named_with_their_sizes(seed: int) -> None:
    # 100 axes drawn like these: `bayesbl run configs/positioning_axis.toml`.
    made, recordings = axis(seed)
    found = sizes(answer(comparison(recordings, believed(made), 20.0, WHOLE)))
    assert found["motor_coulomb_friction"] == pytest.approx(made.coulomb_nm, rel=0.05)
    assert found["motor_viscous_friction"] == pytest.approx(made.viscous_nm_s_per_rad, rel=0.05)
    assert found["motor_torque_offset"] == pytest.approx(made.offset_nm, rel=0.05)
    assert "channel_time_skew" not in found
    assert "friction_asymmetry" not in found


def test_what_the_motion_below_the_cut_off_denies_is_no_ripple() -> None:
    """An axis that moves through a fifth of a turn: what its controller does to the noise above the
    cut-off passed for an order of 64."""
    name = "trapezoidal moves, 0.05 to 20 rad/s"  # a row of configs/positioning_axis.toml
    found = run_case(Row(name=name, cases=100), 88, seed_of_case(41, name, 88))
    assert found["others"] == 0.0
    for size in ("coulomb", "viscous", "offset"):
        assert found[size] == pytest.approx(1.0, rel=0.05)


def swinging(reach_rad: float, gravity_nm: float, angle_rad: float = 0.3) -> list[Recording]:
    """A sine of one frequency with Coulomb and viscous friction, and gravity where there is any."""
    rng = np.random.default_rng(8)
    time = np.arange(0.0, 12.0, 2e-3)
    rate = 2.0 * math.pi * 0.4
    angle = reach_rad * np.sin(rate * time)
    speed, acceleration = np.gradient(angle, time), -(rate**2) * angle
    torque = 0.02 * acceleration + 0.5 * np.tanh(speed / 1e-3) + 0.02 * speed
    torque = torque + gravity_nm * np.sin(angle + angle_rad)
    found = []
    for name in "ab":
        noise = 0.01 * rng.standard_normal(time.size)
        found.append(Recording(name, time, {MOTOR_POSITION: angle, MOTOR_TORQUE: torque + noise}))
    return found


@pytest.mark.parametrize(("reach_rad", "gravity_nm"), [(1.5, 1.2), (1.5, 0.0), (0.1, 0.0)])
def test_gravity_is_seen_where_it_acts_and_a_wrong_inertia_is_not_gravity(
    reach_rad: float, gravity_nm: float
) -> None:
    """The bench has no gravity, and an inertia half as large again: it goes with the angle too."""
    bench = believed(replace(drawn_axis(np.random.default_rng(1)), inertia_kg_m2=0.03 / 0.8))
    made = replace(comparison(swinging(reach_rad, gravity_nm), bench, 20.0, WHOLE), unknown=())
    bench = replace(
        bench, parameters={n: replace(p, tolerance=0.0) for n, p in bench.parameters.items()}
    )
    found, gravity = wrong(replace(made, bench=bench))
    # In a swing of one frequency, a cable's spring is an inertia.
    assert {error.name for error in found.parameter_errors} <= {"motor_inertia_kg_m2"}
    for error in found.parameter_errors:
        assert error.fitted.value == pytest.approx(0.02, abs=4.0 * error.fitted.sd + 1e-4)
    assert gravity == (gravity_nm > 0.0)
    right = believed(replace(drawn_axis(np.random.default_rng(1)), inertia_kg_m2=0.02 / 0.8))
    found, gravity = wrong(replace(made, bench=right))
    assert not found.parameter_errors
    assert gravity == (gravity_nm > 0.0)


def wrong(made: InverseView) -> tuple[Diagnosis, bool]:
    """The answer, and whether gravity is told that the bench lacks."""
    found = answer(made)
    return found, any("as gravity does" in note for note in found.notes)


def test_what_the_bench_states_is_what_the_disagreement_starts_from() -> None:
    """An inertia half as large again is a hypothesis, and told against the stated one."""
    bench = believed(replace(drawn_axis(np.random.default_rng(1)), inertia_kg_m2=0.03 / 0.8))
    stated = {name: replace(p, tolerance=0.0) for name, p in bench.parameters.items()}
    bench = replace(bench, parameters=stated)
    made = replace(comparison(swinging(1.5, 0.0), bench, 20.0, WHOLE), bench=bench, unknown=())
    found = answer(made)
    left = (made.rows.measured - made.base)[made.rows.shown]
    before = found.disagreement["over_all"]["used"]["before"]
    assert before == pytest.approx(float(np.sqrt(np.mean(left**2))), rel=1e-6)


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_complete_bench_has_no_skew_at_a_high_cut_off(seed: int) -> None:
    """Between samples a straight line would take noise from the acceleration."""
    made, recordings = axis(seed)
    found = answer(comparison(recordings, believed(made), 190.0, WHOLE))
    assert "channel_time_skew" not in {e.name for e in found.effects}


@pytest.mark.parametrize("angle_rad", [0.0, 0.3])
def test_a_spring_at_one_frequency_leaves_the_inertia_open(angle_rad: float) -> None:
    """It goes with −α there: gravity of 4 N m is an inertia of −0.6 kg m², and the true one 0.02.

    Alone, it is far larger than a cable's share: nothing is named. Beside its offset, it may be a
    cable's, so friction is named, and the inertia stays open by as much.
    """
    bench = believed(drawn_axis(np.random.default_rng(1)))
    made = comparison(swinging(0.1, 4.0, angle_rad), bench, 20.0, WHOLE)
    plain = {
        name: law
        for name, law in made.laws.items()
        if not (effect_named(name).is_periodic or law.scanned or law.linear or name == SKEW)
    }
    found = answer(replace(made, laws=plain))
    if angle_rad == 0.0:
        assert found.verdict == "unexplained"
        assert not found.effects
        assert not found.parameter_errors
        assert any("which nothing has" in note for note in found.notes)
        return
    inertia = found.bench_parameters["motor_inertia_kg_m2"]
    assert inertia.sd > 0.05
    assert 0.0 < inertia.value < 0.02 + 2.0 * inertia.sd
    coulomb = next(e for e in found.effects if e.name == "motor_coulomb_friction")
    (size,) = coulomb.parameters.values()
    assert size.value == pytest.approx(0.5, abs=2.0 * size.sd)


def test_the_size_of_an_eccentric_encoder_is_that_on_the_bench_as_fitted() -> None:
    """It adds J d²e/dt², so an inertia half as large again would make it a third too small."""
    rng = np.random.default_rng(2)
    time = np.arange(0.0, 8.0, 1e-3)
    found = []
    for name, rate in (("a", 1.1), ("b", 0.7)):
        true = 30.0 * np.sin(rate * time) + 9.0 * np.sin(3.3 * rate * time)
        acceleration = -(rate**2) * (
            30.0 * np.sin(rate * time) + 3.3**2 * 9.0 * np.sin(3.3 * rate * time)
        )
        torque = 1e-3 * acceleration + 2e-3 * rng.standard_normal(time.size)
        shown = true + 0.02 * np.sin(true)
        found.append(Recording(name, time, {MOTOR_POSITION: shown, MOTOR_TORQUE: torque}))
    bench = believed(replace(drawn_axis(rng), inertia_kg_m2=1e-3)).with_parameters(
        motor_inertia_kg_m2=1.5e-3
    )
    made = comparison(found, bench, 100.0, (("used",), ("used",)))
    made = replace(made, laws={"encoder_eccentricity": TORQUE_LAWS["encoder_eccentricity"]})
    # What the reading adds to the angle in the sine is of second order: e/2.
    assert sizes(answer(made))["encoder_eccentricity"] == pytest.approx(0.02, rel=0.02)


@pytest.mark.parametrize("times", [0, 1, 2])
@pytest.mark.parametrize("frequency_hz", [3.0, 21.0, 80.0])
def test_a_derivative_behind_the_filter_is_exact_at_every_frequency(
    times: int, frequency_hz: float
) -> None:
    """But for the filter's gain, and for the ends, which it carries two periods far."""
    time, rate = np.arange(0.0, 4.0, 5e-3), 2.0 * math.pi * frequency_hz
    low_pass = LowPass(60.0, 5e-3)
    edge = math.tan(math.pi * 60.0 * 5e-3)
    gain = 1.0 / (1.0 + (math.tan(math.pi * frequency_hz * 5e-3) / edge) ** 8)
    found = low_pass.derivative(np.sin(rate * time + 0.7) + 5.0 * time + 2.0, times)
    slow = (5.0 * time + 2.0, 5.0, 0.0)[times]
    expected = gain * rate**times * np.sin(rate * time + 0.7 + 0.5 * math.pi * times) + slow
    inside = slice(100, -100)
    np.testing.assert_allclose(found[inside], expected[inside], atol=1e-3 * gain * rate**times)


def test_the_cut_off_is_where_the_position_no_longer_resolves_the_acceleration() -> None:
    # A sine in white noise: 1 % where σ² Σ f⁴ reaches a hundredth of its power.
    rng = np.random.default_rng(1)
    time = np.arange(20_000) / 1000.0
    sd = 1e-4
    position = np.sin(2.0 * np.pi * 3.0 * time) + sd * rng.standard_normal(time.size)
    found = resolved_hz([position], 1e-3)
    # Power of the sine n/4 · 3⁴ · n; of the noise below f, a line every 1/20 s: 20 f⁵/5 · n σ².
    expected = (0.01 * 0.25 * time.size * 81.0 / (4.0 * sd**2)) ** 0.2
    assert found == pytest.approx(expected, rel=0.1)


def test_a_prediction_is_coherent_up_to_where_the_motion_ends() -> None:
    made, recordings = axis(3, torque_noise_nm=0.02)
    widest = 60.0
    found = coherent_hz(comparison(recordings, believed(made), widest, WHOLE))
    assert found is not None
    assert 5.0 < found <= widest


def test_nothing_is_decided_on_what_is_held_out() -> None:
    made, recordings = axis(3)
    bench = believed(made)
    spoilt = Recording(
        "b",
        recordings[1].time_s,
        {
            **recordings[1].channels,
            MOTOR_TORQUE: np.random.default_rng(0).permutation(
                recordings[1].channels[MOTOR_TORQUE]
            ),
        },
    )
    first = answer(comparison(recordings, bench, 20.0, WHOLE))
    other = answer(comparison([recordings[0], spoilt], bench, 20.0, WHOLE))
    assert sizes(other) == sizes(first)
    assert (
        other.disagreement["over_all"]["held_out"]["after"]
        > first.disagreement["over_all"]["held_out"]["after"]
    )


def test_both_halves_of_a_split_recording_have_one_time() -> None:
    # Friction that drifts: fitted on the first half, it goes on in the second.
    made, recordings = axis(3)
    whole = recordings[0]
    position = whole.channels[MOTOR_POSITION]
    speed = np.gradient(position, whole.time_s)
    drift = 0.1 * made.coulomb_nm * whole.time_s * np.sign(speed)
    torque = whole.channels[MOTOR_TORQUE] + drift
    drifting = Recording("a", whole.time_s, {MOTOR_POSITION: position, MOTOR_TORQUE: torque})
    found = answer(comparison([drifting], believed(made), 20.0, (("used", "held_out"),)))
    assert sizes(found)["friction_drift"] == pytest.approx(0.1 * made.coulomb_nm, rel=0.1)
    table = found.disagreement["over_all"]
    assert table["held_out"]["after"] < 1.3 * table["used"]["after"]
