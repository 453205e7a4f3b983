"""Motions: found in recordings, matched with their bench, answered only where a flank changes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bayesbl.bench.bench import Bench
from bayesbl.bench.kernel import CURRENT, SPEED
from bayesbl.bench.motion import Motion, cycle, held_motion, sine
from bayesbl.bench.simulation import simulate_motions
from bayesbl.config.bench import reference_bench
from bayesbl.diagnosis.closed_loop.prediction import predicted
from bayesbl.errors import RecordingError
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.motions import changes_of, flank_changes
from bayesbl.matching.observed import observed
from bayesbl.matching.planning import Strokes, ranked_motions
from bayesbl.matching.predictive_check import disagreements
from bayesbl.matching.signals import GAP, REFERENCE_DELAY
from bayesbl.measurement.direct_route import direct_reasons, fit_directly, unknown_start
from bayesbl.model_search.pipeline import direct_unknowns
from bayesbl.model_search.refit import Explanation
from bayesbl.noise.channel_noise import estimate_channel_noise, estimate_fast_noise
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.checks import cycle_of, moves
from bayesbl.recording.types import (
    MOTOR_CURRENT,
    MOTOR_SPEED,
    REFERENCE_POSITION,
    REFERENCE_SPEED,
    Recording,
)
from bayesbl.sampling.chains import SamplerSettings
from bayesbl.sentences import sentence

RANGE_RAD = (1e-4, 1e-2)
GAP_RAD = 8e-4
BENCH = replace(
    reference_bench(),
    measurement=replace(
        reference_bench().measurement,
        speed_noise=NoiseModel(1.5, (0.6,)),
        current_noise=NoiseModel(0.05),
    ),
)
SWINGING = cycle(120.0, (-0.4, 0.5), 1500.0, 6000.0, 0.1, 7.0)
HELD_UP = cycle(120.0, (0.9, 1.5), 600.0, 1500.0, 0.2, 8.0)


def recorded(
    motion: Motion = SWINGING, bench: Bench = BENCH, seed: int = 1, sampling_hz: float = 500.0
) -> Recording:
    """A noisy recording of a motion, with both references."""
    rng = np.random.default_rng(seed)
    return bench.simulate(GAP_RAD, motion, sampling_hz=sampling_hz, seed=rng, name="r")


def only(recording: Recording, *left_out: str) -> Recording:
    """The same without some channels."""
    kept = {name: values for name, values in recording.channels.items() if name not in left_out}
    return replace(recording, channels=kept)


def cut(recording: Recording, begin: int, end: int | None = None) -> Recording:
    """A part of a recording, its time from zero."""
    part = slice(begin, end)
    time = recording.time_s[part] - recording.time_s[begin]
    kept = {name: values[part] for name, values in recording.channels.items()}
    return replace(recording, time_s=time, channels=kept)


def fitted(recording: Recording, bench: Bench = BENCH) -> SimulatedFit:
    """The optimum of gap and start angle."""
    unknowns = direct_unknowns(bench, ["r"], RANGE_RAD, moving=["r"])
    return fit_aligned(bench, [observed(recording, bench)], unknowns)


def z_of(fit: SimulatedFit) -> float:
    """Error of ln δ in posterior standard deviations."""
    return (math.log(fit.value(GAP, "r")) - math.log(GAP_RAD)) / fit.sd(GAP, "r")


def begun_on(side: float, recording: Recording) -> Recording:
    """The same recording of the joint without gravity, its teeth touching on one flank at first."""
    size = recording.samples, 1.0 / recording.sampling_period_s
    row = VERTICAL.vector(gap_rad=GAP_RAD)
    usual, other = (
        simulate_motions(row, SWINGING, *size, start_flank=flank)[0] for flank in (0.0, side)
    )
    channels = dict(recording.channels)
    channels[MOTOR_SPEED] = channels[MOTOR_SPEED] + (other - usual)[SPEED]
    channels[MOTOR_CURRENT] = channels[MOTOR_CURRENT] + (other - usual)[CURRENT]
    return replace(recording, channels=channels)


def test_only_a_reference_that_varies_is_a_motion() -> None:
    moving = recorded()
    assert moves(moving)
    assert moves(only(moving, REFERENCE_SPEED))
    assert not moves(only(moving, REFERENCE_SPEED, REFERENCE_POSITION))
    steady = BENCH.simulate(GAP_RAD, rotations=2.0)
    asked = np.full(steady.samples, 2000.0)
    ramp = 2000.0 / 60.0 * 2.0 * math.pi * steady.time_s
    assert not moves(replace(steady, channels={**steady.channels, REFERENCE_SPEED: asked}))
    assert not moves(replace(steady, channels={**steady.channels, REFERENCE_POSITION: ramp}))


def test_a_little_less_than_two_rotations_is_checked() -> None:
    short = BENCH.simulate(GAP_RAD, rotations=1.95, seed=np.random.default_rng(1))
    fit = fit_aligned(
        BENCH, [observed(short, BENCH)], direct_unknowns(BENCH, [short.name], RANGE_RAD)
    )
    entries = disagreements(fit)
    assert all(entry.probability * len(entries) > 1e-3 for entry in entries)


def test_a_cycle_is_found_where_two_are_recorded() -> None:
    time = np.arange(7000) / 1000.0
    speed = SWINGING.speed_rpm(time)
    way, top, acceleration = 0.9 * 120.0, 1500.0 * math.pi / 30.0, 6000.0 * math.pi / 30.0
    stroke = way / top + top / acceleration + 0.1
    assert cycle_of(speed) == pytest.approx(2000.0 * stroke, abs=1.0)
    assert cycle_of(speed[: round(1.8 * 2000.0 * stroke)]) is None
    slow = sine(120.0, (0.0, 1.0), 30.0, 70.0).speed_rpm(np.arange(70_000) / 1000.0)
    assert cycle_of(slow) == 30_000
    assert cycle_of(np.random.default_rng(1).standard_normal(3000).cumsum()) is None


RECORDINGS = {
    "whole": (recorded(), BENCH),
    "speed asked alone": (only(recorded(seed=2), REFERENCE_POSITION), BENCH),
    "position asked alone": (only(recorded(seed=3), REFERENCE_SPEED), BENCH),
    "cut in a stroke": (cut(recorded(seed=4), 180), BENCH),
    "cut while the stop rings": (cut(recorded(seed=5), 500), BENCH),
    "one cycle": (cut(recorded(seed=6), 0, 1100), BENCH),
    "two cycles, fewer compared": (cut(recorded(seed=10), 0, 4200), BENCH),
    "sine": (recorded(sine(120.0, (-0.5, 0.5), 2.0, 7.0), seed=7), BENCH),
}
VERTICAL = BENCH.with_parameters(gravity_torque_nm=0.0)
RECORDINGS["no gravity"] = (recorded(bench=VERTICAL, seed=8), VERTICAL)
LOOPED = BENCH.with_parameters(position_gain_per_s=5.0, gravity_angle_rad=0.3)
RECORDINGS["position loop"] = (recorded(bench=LOOPED, seed=9), LOOPED)


@pytest.mark.parametrize("name", RECORDINGS)
def test_the_gap_is_recovered_and_the_check_passes(name: str) -> None:
    # Normal errors are beyond 4 in one of 16,000; the check's false alarms are one in a thousand.
    fit = fitted(*RECORDINGS[name])
    assert abs(z_of(fit)) < 4.0
    assert fit.sd(GAP, "r") == pytest.approx(fit.bound[fit.model.index(GAP, "r")], rel=0.01)
    entries = disagreements(fit)
    assert all(entry.probability * len(entries) > 1e-3 for entry in entries)
    assert flank_changes(fit, 0)


@pytest.mark.parametrize(
    ("reach_rad", "speed_rpm", "acceleration_rpm_per_s", "duration_s", "gap_rad"),
    [(0.03125, 1000.0, 900.0, 4.0, 8e-4), (0.5, 2000.0, 1800.0, 8.0, 1.12e-3)],
)
def test_the_gap_of_many_valleys_is_the_true_one(
    reach_rad: float,
    speed_rpm: float,
    acceleration_rpm_per_s: float,
    duration_s: float,
    gap_rad: float,
) -> None:
    """Within 4 standard deviations; gap and start angle have another valley 6 % off."""
    ends = (-reach_rad, reach_rad)
    motion = cycle(120.0, ends, speed_rpm, acceleration_rpm_per_s, 0.15, duration_s)
    rng = np.random.default_rng(77)
    fit = fitted(BENCH.simulate(gap_rad, motion, seed=rng, name="r"))
    error = math.log(fit.value(GAP, "r") / gap_rad)
    assert abs(error) < 4.0 * fit.sd(GAP, "r")


@pytest.mark.long
def test_a_reference_that_is_held_and_late_is_found_so() -> None:
    # As a digital drive has it: four samples late, and held for a millisecond each.
    recording = recorded(seed=10, sampling_hz=1000.0)
    late = {
        name: np.r_[values[4:], np.full(4, values[-1])] if name.startswith("reference") else values
        for name, values in recording.channels.items()
    }
    fit = fitted(replace(recording, channels=late))
    assert fit.value(REFERENCE_DELAY, "r") == pytest.approx(4e-3, abs=1e-4)
    assert abs(z_of(fit)) < 4.0


@pytest.mark.long
def test_a_reference_that_a_drive_holds_is_found_so() -> None:
    held = held_motion(SWINGING, 3501, 500.0)
    seen = observed(recorded(held, seed=11), BENCH)
    sampler = SamplerSettings(2, 1000, 0.9)
    seed = np.random.SeedSequence(1)
    found = fit_directly(BENCH, [seen], RANGE_RAD, {}, sampler, seed)
    assert abs(z_of(found.posterior.fit)) < 4.0
    assert any("held" in sentence(note.stored) for note in direct_reasons(found, 0))


def test_what_begins_unknown_is_left_out() -> None:
    assert 0.02 < observed(RECORDINGS["whole"][0], BENCH).first_compared / 500.0 < 1.0
    begin = observed(RECORDINGS["cut in a stroke"][0], BENCH).first_compared
    assert 0.02 < begin / 500.0 < 0.5


def test_without_gravity_the_flank_that_a_motion_begins_on_does_not_matter() -> None:
    # Normal errors are beyond 4 in one of 16,000. Where only the slowest mode of the contact is
    # waited for, which the gap does not let decay, the two are 0.43 sd apart.
    recording = recorded(bench=VERTICAL, seed=8)
    forward, backward = (fitted(begun_on(side, recording), VERTICAL) for side in (1.0, -1.0))
    assert abs(z_of(forward)) < 4.0
    assert abs(z_of(forward) - z_of(backward)) < 0.1


def test_a_start_that_a_short_motion_still_remembers_withholds_the_gap() -> None:
    """Half a stroke without gravity: 30 % of it may be left out, and that is too little."""
    recording = recorded(bench=VERTICAL, seed=8)
    assert unknown_start(fitted(recording, VERTICAL), 0) is None
    reason = unknown_start(fitted(cut(recording, 0, 400), VERTICAL), 0)
    assert reason is not None
    assert "Record the same motion for longer" in sentence(reason.stored)


@pytest.mark.long
def test_a_motion_without_a_change_of_flank_tells_no_gap() -> None:
    seen = observed(recorded(HELD_UP), BENCH)
    sampler = SamplerSettings(2, 1000, 0.9)
    seed = np.random.SeedSequence(1)
    found = fit_directly(BENCH, [seen], RANGE_RAD, {}, sampler, seed)
    assert not flank_changes(found.posterior.fit, 0)
    (reason,) = (one for one in direct_reasons(found, 0) if one.withholds)
    assert reason.code == "gap_unseen"
    assert "never passes from one tooth flank" in sentence(reason.stored)
    assert "bayesbl plan" in sentence(reason.stored)


def test_a_change_of_flank_is_a_passage_of_the_whole_gap() -> None:
    gap = 1.0
    twist = np.array([2.0, 0.5, 0.9, 1.5, 0.0, -0.5, -1.2, -0.9, -1.1, 0.2, 3.0])
    found = changes_of(twist, gap, 0.1)
    assert [(c.left_s, c.met_s, c.side) for c in found] == [
        (pytest.approx(0.3), pytest.approx(0.6), -1),
        (pytest.approx(0.8), pytest.approx(1.0), 1),
    ]
    excluded = np.arange(twist.size) > 8
    assert len(changes_of(twist, gap, 0.1, excluded)) == 1


def test_a_reference_of_the_load_is_refused() -> None:
    recording = recorded()
    asked = recording.channels[REFERENCE_SPEED] / 120.0
    wrong = replace(recording, channels={**recording.channels, REFERENCE_SPEED: asked})
    with pytest.raises(RecordingError, match="do not agree"):
        observed(wrong, BENCH)


def test_noise_is_that_of_the_samples_that_are_kept() -> None:
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((2, 6000))
    spoiled, kept = noise.copy(), np.ones(6000, dtype=bool)
    for begin in range(500, 6000, 1000):
        spoiled[:, begin : begin + 200] += 50.0
        kept[begin : begin + 200] = False
    found = estimate_channel_noise(spoiled, 1000, kept)
    assert found.order == 0
    assert found.sd == pytest.approx([1.0, 1.0], rel=0.05)
    fast = estimate_fast_noise(noise + np.linspace(0.0, 300.0, 6000), 250)
    assert fast.order == 0
    assert fast.sd == pytest.approx([1.0, 1.0], rel=0.05)


@pytest.mark.long
def test_a_plan_expects_what_a_fit_then_finds() -> None:
    limits = Strokes((-0.4, 1.4), 1500.0, 6000.0, 0.1, 3.0)
    ranked = ranked_motions(BENCH, limits, GAP_RAD, 250.0)
    expected = [m.expected_relative_sd for m in ranked]
    shown = [sd for sd in expected if sd is not None]
    assert shown == sorted(shown)
    assert expected[len(shown) :] == [None] * (len(expected) - len(shown))
    assert 0 < len(shown) < len(expected)
    found = []
    for planned in ranked[0 : len(shown) : max(1, len(shown) // 2)]:
        motion = cycle(
            120.0, planned.range_rad, planned.speed_rpm, planned.acceleration_rpm_per_s, 0.1, 3.0
        )
        found.append(
            (planned.expected_relative_sd, fitted(recorded(motion, sampling_hz=250.0)).sd(GAP, "r"))
        )
    # At one gap of the three that a plan goes by; the order is held, and the size roughly.
    ratios = np.array([sd / promised for promised, sd in found if promised])
    assert np.all((ratios > 0.2) & (ratios < 2.0))


@pytest.mark.long
@pytest.mark.parametrize("motion", [SWINGING, HELD_UP])
def test_a_motion_that_is_held_out_is_predicted_with_a_gap_of_its_own(motion: Motion) -> None:
    rng = np.random.default_rng(2)
    later = BENCH.simulate(1.5 * GAP_RAD, motion, sampling_hz=500.0, seed=rng, name="later")
    seen = observed(later, BENCH)
    left = seen.residual_of(predicted(Explanation((), fitted(recorded())), seen))
    assert np.std(left, axis=1) == pytest.approx([1.5, 0.05], rel=0.06)
