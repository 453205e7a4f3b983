"""Laws of the check between snapshots without a bench: the gap is no change, the rest is one."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import CONFIGS
from recording_files import write_csv

import bayesbl
from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.config.bench import load_bench
from bayesbl.curve.gap_curve import GapCurve, Ringing, published_curve
from bayesbl.measurement.measurement import JointCheck
from bayesbl.measurement.same_joint import (
    COULD_BE,
    FILTER,
    INTEGRAL,
    LINE,
    MEAN_CURRENT,
    PROPORTIONAL,
    change_reason,
    features,
    harmonic_name,
    same_joint,
)
from bayesbl.recording.repetition import folded
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED
from bayesbl.ringing.estimator import Estimator, PointEstimate
from bayesbl.sentences import CAUSES, sentence

BENCH = load_bench(CONFIGS / "bench.toml")


def point(
    bench: Bench,
    gap_rad: float,
    seed: int,
    *,
    with_current: bool = True,
    rotations: float = 4.0,
) -> PointEstimate:
    generator = np.random.default_rng(seed)
    made = bench.simulate(
        gap_rad,
        rotations=rotations,
        sampling_hz=500.0,
        start_angle_rad=generator.uniform(0.0, 6.0),
        seed=generator,
    )
    if not with_current:
        kept = {name: values for name, values in made.channels.items() if name != MOTOR_CURRENT}
        made = replace(made, channels=kept)
    return Estimator().estimate(made, np.random.SeedSequence(1))


@pytest.fixture(scope="module")
def before() -> PointEstimate:
    return point(BENCH, 8e-4, 1)


def changed(**factors: float) -> Bench:
    return BENCH.with_parameters(**{n: f * BENCH.value(n) for n, f in factors.items()})


def told(check: JointCheck) -> list[str]:
    """What a check found, in words."""
    return [sentence(finding) for finding in check["findings"]]


def test_noise_that_stands_out_by_chance_shows_no_gain() -> None:
    """Gravity's wave and noise alone, with which the current rises: no order shows the gain."""
    noise = np.random.default_rng(6).standard_normal((5, 4000))
    wave = np.cos(2.0 * np.pi * np.arange(4000) / 4000)
    signals = np.stack([2.0 * wave + 6.0 * noise, 8.0 * wave + 0.3 * noise])
    assert PROPORTIONAL not in {feature.name for feature in features(signals, 2e-3)}


def found_values(gap_rad: float, seed: int | None) -> dict[str, tuple[float, float]]:
    """Value and standard error of every feature of a recording, of noise-free signals for none."""
    generator = None if seed is None else np.random.default_rng(seed)
    made = BENCH.simulate(gap_rad, rotations=5.3, start_angle_rad=0.3, seed=generator)
    per_rotation = BENCH.rotation_period_s() / made.sampling_period_s
    signals = (made.motor_speed_rpm, made.channels[MOTOR_CURRENT])
    rotations = np.stack([folded(signal, per_rotation) for signal in signals])
    return {
        f.name: (f.value, f.standard_error) for f in features(rotations, made.sampling_period_s)
    }


def test_features_recover_the_bench_whatever_the_gap() -> None:
    torque_constant = BENCH.value("torque_constant_nm_per_a")
    expected = {
        PROPORTIONAL: BENCH.value("speed_gain_nm_s_per_rad") / torque_constant,
        INTEGRAL: BENCH.value("integral_gain_nm_per_rad") / torque_constant,
        harmonic_name("current", 1): BENCH.value("gravity_torque_nm") / 120.0 / torque_constant,
        MEAN_CURRENT: 0.0,
    }
    small, large = found_values(5e-4, 1), found_values(2e-3, 2)
    # Fails by chance in 1 of 2000: four standard errors on either side, eight values; the inertia
    # of the joint adds 0.2 % to the first order, a gap up to 0.25 % of it.
    for name, value in expected.items():
        allowed = 0.005 * expected[harmonic_name("current", 1)] if "gain" not in name else 0.0
        for measured, sd in (small[name], large[name]):
            assert abs(measured - value) < 4.0 * sd + allowed, name


def test_every_quantity_that_is_compared_has_its_cause_in_words() -> None:
    assert set(CAUSES) == set(COULD_BE) - {FILTER, LINE}


def test_more_gap_alone_is_no_other_joint(before: PointEstimate) -> None:
    # The false alarm is 1 % each.
    for gap_rad, seed in ((8e-4, 2), (1.2e-3, 3), (2e-3, 4)):
        check = same_joint([before, point(BENCH, gap_rad, seed)], (False, False))
        assert check["agrees"], told(check)
        assert change_reason(check) is None
        assert check["items"]
        assert check["blind_spots"]


def test_the_bench_tells_how_the_gap_changes_the_ringing(before: PointEstimate) -> None:
    """On a joint unlike the reference bench, the ringing may follow the amplitude more closely."""
    after = point(changed(speed_gain_nm_s_per_rad=0.6), 1.2e-3, 3)
    (first, _), (second, _) = before.ringing, after.ringing
    curve = published_curve(draws=1)
    log_amplitude = np.log(curve.knots_rpm / first[0]) / math.log(second[0] / first[0])
    frequency, decay = (first[k] + (second[k] - first[k]) * log_amplitude for k in (1, 2))
    nothing, scatter = np.zeros((1, log_amplitude.size)), np.zeros((log_amplitude.size, 3, 3))
    own = replace(curve, ringing=Ringing(frequency, decay, nothing, nothing, scatter))

    def is_changed(*curves: GapCurve | None) -> bool:
        check = same_joint([before, after], (False, False), curves=curves)
        items = [item for item in check["items"] if item["quantity"].startswith("ringing")]
        return max(abs(item["z"]) for item in items) > 3.0

    assert is_changed(None, None)
    assert is_changed(curve, curve)
    assert not is_changed(own, own)


@pytest.mark.long
@pytest.mark.parametrize(
    ("factors", "quantity", "cause"),
    [
        (
            {"gravity_torque_nm": 2.0, "load_inertia_kg_m2": 1.5},
            "ringing frequency",
            "load_inertia_kg_m2",
        ),
        (
            {"integral_gain_nm_per_rad": 0.8},
            "integral gain",
            "integral_gain_nm_per_rad",
        ),
        (
            {"gravity_torque_nm": 1.05},
            "current at load order 1",
            "gravity_torque_nm",
        ),
        ({"shaft_stiffness_nm_per_rad": 0.6}, "ringing frequency", "shaft_stiffness_nm_per_rad"),
    ],
)
def test_what_changed_besides_the_gap_is_told_with_its_cause(
    before: PointEstimate, factors: dict[str, float], quantity: str, cause: str
) -> None:
    check = same_joint([before, point(changed(**factors), 8e-4, 5)], (False, False))
    assert not check["agrees"]
    assert any(quantity in text for text in told(check))
    assert cause in check["could_be"]
    assert check["findings"] == change_reason(check).values["also"]


@pytest.mark.long
@pytest.mark.parametrize("rotations", [1.97, 2.0])
def test_what_is_hardly_two_rotations_is_compared_by_the_ringing(
    before: PointEstimate, rotations: float
) -> None:
    short = point(BENCH, 8e-4, 2, rotations=rotations)
    check = same_joint([before, short], (False, False))
    assert check["agrees"]
    names = {item["quantity"] for item in check["items"]}
    assert {"ringing frequency", "ringing decay"} <= names
    assert ("mean current" in names) == (rotations == 2.0)


def test_a_repair_begins_anew(before: PointEstimate) -> None:
    other = point(changed(gravity_torque_nm=1.3), 3e-4, 6)
    again = point(changed(gravity_torque_nm=1.3), 4e-4, 7)
    assert not same_joint([before, other, again], (False, False, False))["agrees"]
    assert same_joint([before, other, again], (False, True, False))["agrees"]


@pytest.mark.long
def test_without_a_current_the_gains_are_a_blind_spot(before: PointEstimate) -> None:
    blind = [point(BENCH, 8e-4, n, with_current=False) for n in (1, 2)]
    check = same_joint(blind, (False, False))
    assert check["agrees"]
    assert not any("gain" in item["quantity"] for item in check["items"])
    assert "gains_unseen" in {spot["code"] for spot in check["blind_spots"]}
    shown = same_joint([before, point(BENCH, 8e-4, 2)], (False, False))
    assert any(item["quantity"] == PROPORTIONAL for item in shown["items"])
    assert all(math.isfinite(item["z"]) for item in shown["items"])


def written(folder: Path, bench: Bench, seed: int, rate_hz: int) -> Path:
    """A file of a drive that shows the mean of the speed over each sampling period."""
    generator = np.random.default_rng(seed)
    finest_hz = 4000
    made = bench.simulate(
        8e-4,
        rotations=4.0,
        sampling_hz=float(finest_hz),
        start_angle_rad=generator.uniform(0.0, 6.0),
    )
    each = finest_hz // rate_hz
    count = made.samples // each
    last = np.arange(1, count + 1) * each - 1
    mean = made.motor_speed_rpm[: count * each].reshape(count, each).mean(axis=1)
    columns = {
        "time_s": np.arange(count) / rate_hz,
        MOTOR_SPEED: mean + generator.normal(0.0, 0.3, count),
        MOTOR_CURRENT: made.channels[MOTOR_CURRENT][last] + generator.normal(0.0, 0.02, count),
    }
    return write_csv(folder / f"{rate_hz}.csv", columns)


@pytest.mark.parametrize(
    ("factors", "quantity"),
    [
        ({}, None),
        ({"shaft_stiffness_nm_per_rad": 0.85}, "ringing frequency"),
        pytest.param(
            {"speed_gain_nm_s_per_rad": 0.85}, "proportional gain", marks=pytest.mark.long
        ),
        pytest.param(
            {"gravity_torque_nm": 0.95}, "current at load order 1", marks=pytest.mark.long
        ),
    ],
)
def test_another_sampling_rate_hides_no_change_and_is_none(
    tmp_path: Path, factors: dict[str, float], quantity: str | None
) -> None:
    files = [written(tmp_path, BENCH, 1, 1000), written(tmp_path, changed(**factors), 2, 250)]
    check = bayesbl.compare(*files, workers=1).summary["same_joint"]
    assert check["items"]
    assert check["agrees"] == (quantity is None), told(check)
    if quantity is not None:
        assert any(quantity in text for text in told(check))


def with_drift(made: PointEstimate, drift_rpm: float) -> PointEstimate:
    """The same recording, its speed drifting from begin to end."""
    recording = made.recording
    drift = drift_rpm * np.linspace(-0.5, 0.5, recording.samples)
    speed = recording.motor_speed_rpm + drift
    drifting = replace(recording, channels={**recording.channels, MOTOR_SPEED: speed})
    return Estimator().estimate(drifting, np.random.SeedSequence(1))


def test_a_mended_recording_is_compared_by_its_current_too(before: PointEstimate) -> None:
    """A drift that was removed hid a changed gain, as the current was forgotten with it."""
    softer = with_drift(point(changed(speed_gain_nm_s_per_rad=0.85), 8e-4, 5), 20.0)
    assert softer.mended
    check = same_joint([before, softer], (False, False))
    assert any(PROPORTIONAL in text for text in told(check))
    same = with_drift(point(BENCH, 8e-4, 5), 20.0)
    assert same.mended
    check = same_joint([before, same], (False, False))
    assert {PROPORTIONAL, MEAN_CURRENT} <= {item["quantity"] for item in check["items"]}
    assert check["agrees"], told(check)


def test_a_line_of_the_motor_is_no_other_controller(before: PointEstimate) -> None:
    """It is taken out of speed and current alike, so the law of the controller holds."""
    ripple = {"torque_nm": 0.3, "order": 1.0, "phase_rad": 0.4}
    values = {name: EffectParameterValue(value) for name, value in ripple.items()}
    rippled = BENCH.with_effects(BenchEffect("motor_torque_ripple", values))
    found = point(rippled, 8e-4, 5)
    assert any("motor order 1" in note for note in found.notes)
    check = same_joint([before, found], (False, False))
    assert PROPORTIONAL in {item["quantity"] for item in check["items"]}
    assert not any("gain" in text for text in told(check)), told(check)


@pytest.mark.parametrize(("growth", "gap_rad"), [(3.0, 8e-4), (1.0, 9.6e-4)])
def test_a_line_of_the_motor_that_grew_is_no_wear(growth: float, gap_rad: float) -> None:
    """A transmission error makes teeth meet slower: it lowered the ringing of the same gap."""

    def erring(angle_rad: float, gap: float, seed: int) -> PointEstimate:
        values = {"angle_rad": angle_rad, "order": 2.0, "phase_rad": 0.4}
        parameters = {name: EffectParameterValue(value) for name, value in values.items()}
        bench = BENCH.with_effects(BenchEffect("gear_transmission_error", parameters))
        return point(bench, gap, seed, with_current=False)

    first, other = erring(5e-5, 8e-4, 1), erring(5e-5 * growth, gap_rad, 2)
    check = same_joint([first, other], (False, False))
    assert any(item["quantity"] == LINE for item in check["items"])
    assert check["agrees"] == (growth == 1.0), told(check)
    if growth != 1.0:
        assert "motor order 2" in sentence(change_reason(check).stored)
        assert "gear_transmission_error" in check["could_be"]


@pytest.mark.long
def test_the_change_of_a_ringing_that_is_withheld_is_none(tmp_path: Path) -> None:
    """Noise in which no ringing is seen gave a change of its amplitude with a probability."""
    files = []
    for seed, noise_rpm in ((1, 0.5), (2, 80.0)):
        made = BENCH.simulate(8e-4, rotations=2.2, sampling_hz=250.0, start_angle_rad=0.4)
        noise = np.random.default_rng(seed).normal(0.0, noise_rpm, made.samples)
        columns = {"time_s": made.time_s, MOTOR_SPEED: made.motor_speed_rpm + noise}
        files.append(write_csv(tmp_path / f"{seed}.csv", columns))
    summary = bayesbl.compare(*files, workers=1, gear_ratio=BENCH.value("gear_ratio")).summary
    assert summary["outcome"] == "withheld"
    assert summary["ringing_change"] is None
    assert summary["probability_ringing_grew"] is None


def test_a_harmonic_that_noise_hides_is_a_blind_spot(before: PointEstimate) -> None:
    """Its size is that of products of different rotations, which may be none at all."""
    hidden = 0
    for seed in range(4):
        noise = np.random.default_rng(seed).standard_normal(before.recording.samples)
        channels = {**before.recording.channels, MOTOR_CURRENT: noise}
        silent = replace(before, recording=replace(before.recording, channels=channels))
        check = same_joint([silent, before], (False, False))
        hidden += any("does not show" in sentence(spot) for spot in check["blind_spots"])
    assert 0 < hidden < 4
