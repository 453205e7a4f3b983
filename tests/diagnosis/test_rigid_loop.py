"""A rigid drive under its speed controller: what repeats in its speed, simulated apart."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import bayesbl
from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.cli import status
from bayesbl.config.bench import load_bench
from bayesbl.config.kinds import DiagnoseConfig
from bayesbl.diagnosis.diagnosis import Diagnosis
from bayesbl.diagnosis.inference import inferred
from bayesbl.diagnosis.rigid import speed_loop
from bayesbl.diagnosis.rigid.orders import OrderedRest, OrderSpectrum, Peak, clearest
from bayesbl.diagnosis.rigid.speed_loop import (
    ANGLE,
    CANDIDATES,
    TORQUE,
    Lines,
    LoopView,
    comparison,
    find_orders,
    law_powers,
    lines_of,
    loop_setting,
    loop_values,
    speed_of_torque,
    torque_of_angle,
)
from bayesbl.diagnosis.task import Task
from bayesbl.errors import ConfigError, RecordingError
from experiments.rigid_loop import Drive, recorded

BENCH = """
schema = 1
kind = "bench"
drive = "rigid"
[parameters]
gear_ratio = {value = 1.0}
motor_inertia_kg_m2 = {value = 1.96e-3, relative_tolerance = 0.05}
load_inertia_kg_m2 = {value = 1e-9}
speed_gain_nm_s_per_rad = {value = 0.156, relative_tolerance = 0.05}
integral_gain_nm_per_rad = {value = 4.1, relative_tolerance = 0.05}
"""
EXACT = (
    BENCH.replace(", relative_tolerance = 0.05", "")
    .replace("1.96e-3", "2e-3")
    .replace("0.156", "0.15")
    .replace("4.1", "4.0")
)
GAINS = ("motor_inertia_kg_m2", "speed_gain_nm_s_per_rad", "integral_gain_nm_per_rad")
SPEEDS_RPM = (100.0, 200.0, 400.0, -600.0, 1000.0)
FAST_RPM = (300.0, 500.0, 800.0, -1100.0, 1500.0)
SLOW_RPM = (20.0, 40.0, 80.0, -160.0, 300.0)
RIPPLE = ((6.0, 0.08, 0.3), (12.0, 0.03, 1.0), (18.0, 0.02, 2.0))
SURE = 4.0
"""Standard deviations: one estimate in 16,000 is farther off."""


def task(folder: Path, recordings: Sequence, text: str = BENCH, uses: str = "split") -> Task:
    (folder / "bench.toml").write_text(text)
    (folder / "one.csv").touch()
    bench = load_bench(folder / "bench.toml")
    config = DiagnoseConfig.model_validate(
        {
            "schema": 1,
            "kind": "diagnose",
            "run": {"output": str(folder / "out")},
            "bench": str(folder / "bench.toml"),
            "comparison": {"method": "forward"},
            "unknowns": {"bench_parameters": [n for n in GAINS if n in bench.tolerances]},
            "recordings": [
                {"name": r.name, "file": str(folder / "one.csv"), "use": uses} for r in recordings
            ],
        }
    )
    return Task(config, bench, tuple(recordings))


def diagnosed(
    folder: Path, drive: Drive, speeds: Sequence[float], text: str = BENCH, seed: int = 1
) -> Diagnosis:
    made = [recorded(drive, speed, 10 * seed + k) for k, speed in enumerate(speeds)]
    return comparison(task(folder, made, text)).diagnose(None)


def ripples(found: Diagnosis) -> dict[float, float]:
    """Order to torque."""
    return {
        e.parameters["order"].value: e.parameters["torque_nm"].value
        for e in found.effects
        if e.name == "motor_torque_ripple"
    }


@pytest.mark.long
def test_a_ripple_and_two_harmonics_at_five_speeds_have_their_orders_and_sizes(
    tmp_path: Path,
) -> None:
    found = diagnosed(tmp_path, Drive(torques=RIPPLE), SPEEDS_RPM)
    assert found.verdict == "named"
    named = ripples(found)
    assert list(named) == [order for order, *_ in RIPPLE]
    for order, torque, _ in RIPPLE:
        assert named[order] == pytest.approx(torque, rel=0.1)
    assert len(found.effects) == len(RIPPLE)
    assert (found.disagreement["over_all"]["held_out"]["closed_fraction"] or 0.0) > 0.95


@pytest.mark.long
def test_an_order_that_is_not_whole_is_not_rounded(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, Drive(torques=((7.31, 0.08, 0.0),)), SPEEDS_RPM)
    ((order, torque),) = ripples(found).items()
    spread = found.effects[0].parameters["order"].sd
    assert abs(order - 7.31) < SURE * spread < 0.005
    assert torque == pytest.approx(0.08, rel=0.1)


@pytest.mark.long
def test_an_encoder_that_is_off_centre_is_no_ripple_and_stands_beside_one(tmp_path: Path) -> None:
    off_centre = ((1.0, 2e-3, 0.3),)
    (alone,) = diagnosed(tmp_path, Drive(angles=off_centre), FAST_RPM).effects
    assert alone.name == "encoder_eccentricity"
    assert not alone.indistinguishable_from
    assert alone.parameters["angle_rad"].value == pytest.approx(2e-3, rel=0.1)
    drive = Drive(angles=off_centre, torques=((1.0, 0.03, 1.0),))
    both = {effect.name: effect for effect in diagnosed(tmp_path, drive, FAST_RPM).effects}
    assert both.keys() == {"encoder_eccentricity", "motor_torque_ripple"}
    for name, size in (("angle_rad", 2e-3), ("torque_nm", 0.03)):
        (fitted,) = (e.parameters[name] for e in both.values() if name in e.parameters)
        assert abs(fitted.value - size) < SURE * fitted.sd < 0.2 * size


@pytest.mark.long
def test_a_ripple_has_no_sidebands_over_an_encoder_that_is_off_centre(tmp_path: Path) -> None:
    drive = Drive(angles=((1.0, 8e-3, 0.3),), torques=((6.0, 0.3, 1.0),))
    found = diagnosed(tmp_path, drive, FAST_RPM)
    assert [e.name for e in found.effects].count("encoder_eccentricity") == 1
    assert list(ripples(found)) == [6.0]
    assert not found.remaining


def test_one_speed_names_nothing_and_asks_for_another(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, Drive(torques=RIPPLE), (800.0, -800.0))
    assert found.verdict == "unexplained"
    assert not found.effects
    assert found.remaining[0].lowest_order == 6.0
    assert any("another speed" in note for note in found.notes)


def test_an_error_of_the_angle_at_another_order_is_described_and_not_called_ripple(
    tmp_path: Path,
) -> None:
    found = diagnosed(tmp_path, Drive(angles=((2.0, 1e-3, 0.0),)), SPEEDS_RPM)
    assert found.verdict == "unexplained"
    assert [line.lowest_order for line in found.remaining] == [2.0]
    assert any("error of the encoder" in note for note in found.notes)


def test_a_change_of_the_loop_without_a_size_is_not_named(tmp_path: Path) -> None:
    """Where no line follows a law of the catalogue, nothing shows how the loop answers."""
    drive = Drive(angles=((2.0, 0.0019327130760249433, 5.604170449736185),), viscous=0.054)
    found = diagnosed(tmp_path, drive, FAST_RPM, seed=146)
    assert not found.effects
    assert not found.parameter_errors


def test_a_wrong_gain_beside_an_error_of_the_angle_leaves_the_torques_their_sizes(
    tmp_path: Path,
) -> None:
    waves = ((12.0, 0.1284, 5.83339220009124), (18.0, 0.2742, 4.0278), (6.0, 0.1894, 2.7583))
    drive = Drive(torques=waves, angles=((3.0, 1.8169e-3, 5.478),), integral_gain=2.5622)
    named = ripples(diagnosed(tmp_path, drive, SLOW_RPM, EXACT, seed=132))
    for order, torque, _ in waves:
        assert named[order] == pytest.approx(torque, rel=0.1)


@pytest.mark.parametrize("torques", [(), ((2.0, 0.15, 4.9),)])
def test_a_line_at_one_frequency_is_periodic_in_time(
    tmp_path: Path, torques: tuple[tuple[float, float, float], ...]
) -> None:
    drive = Drive(hum=(50.0, 0.03), torques=torques)
    found = diagnosed(tmp_path, drive, (300.0, 570.0, 800.0, -1100.0), seed=2)
    assert list(ripples(found)) == [order for order, *_ in torques]
    (line,) = found.remaining
    assert line.dependence == "time"
    assert line.frequency_hz == pytest.approx(50.0, rel=1e-3)


def test_nothing_hidden_leaves_nothing_missing(tmp_path: Path) -> None:
    """False alarms: 1 in 100 for each set of recordings."""
    for seed in (1, 2):
        found = diagnosed(tmp_path, Drive(), SPEEDS_RPM, seed=seed)
        assert found.verdict == "nothing_missing"


@pytest.mark.long
def test_friction_shows_in_how_the_loop_answers_and_so_does_a_wrong_gain(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, Drive(torques=RIPPLE, viscous=0.06), SLOW_RPM, EXACT)
    (friction,) = (e for e in found.effects if e.name == "motor_viscous_friction")
    size = friction.parameters["coefficient_nm_s_per_rad"]
    assert abs(size.value - 0.06) < SURE * size.sd
    assert friction.indistinguishable_from == ("speed_gain_nm_s_per_rad",)
    found = diagnosed(tmp_path, Drive(torques=RIPPLE, integral_gain=6.0), SLOW_RPM, EXACT)
    (error,) = found.parameter_errors
    assert error.name == "integral_gain_nm_per_rad"
    assert math.exp(error.fitted.value) == pytest.approx(6.0, rel=0.05)


@pytest.mark.long
def test_a_lag_of_the_sensor_is_named_with_its_time(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, Drive(torques=RIPPLE, sensor_lag_s=2e-3), SPEEDS_RPM)
    (lag,) = (e.parameters["time_s"] for e in found.effects if e.name == "speed_sensor_lag")
    assert abs(lag.value - 2e-3) < SURE * lag.sd < 2e-3


def test_a_ripple_at_crawling_speed_has_no_harmonics_of_its_own_making(tmp_path: Path) -> None:
    drive = Drive(torques=((6.0, 0.2, 0.0),), viscous=0.0)
    found = diagnosed(tmp_path, drive, SLOW_RPM, EXACT)
    assert list(ripples(found)) == [6.0]


def test_an_error_of_the_angle_is_a_torque_that_grows_with_the_square_of_the_speed() -> None:
    values = VALUES | {"current_loop_lag": 0.0}
    frequency = np.array([1.0, 10.0, 1e6])
    assert np.allclose(torque_of_angle(values, frequency), 2e-3 * frequency**2)
    # Slow torques are held by the integral, fast ones by the inertia alone.
    rpm = np.abs(speed_of_torque(values, frequency)) * 2.0 * math.pi / 60.0
    assert rpm[0] == pytest.approx(1.0 / 4.0, rel=0.01)
    assert rpm[-1] == pytest.approx(1.0 / (2e-3 * 1e6), rel=0.01)


def test_orders_stand_out_whatever_their_score(tmp_path: Path) -> None:
    """The probability of a strong line is far below the smallest number."""
    made = [recorded(Drive(torques=((6.0, 2.0, 0.0),)), s, 3, noise_rpm=0.1) for s in FAST_RPM]
    asked = task(tmp_path, made)
    used = loop_setting(asked).used
    first, *_ = find_orders(used, 3, 0.01)
    assert first.order == 6.0
    assert np.all(lines_of(used, [6.0]).power > 0.0)


def test_what_does_not_suit_is_refused(tmp_path: Path) -> None:
    made = [recorded(Drive(), 800.0, 1, lasting_s=1.0)]
    without = "\n".join(line for line in BENCH.splitlines() if "speed_gain" not in line)
    with pytest.raises(ConfigError, match="gains"):
        comparison(task(tmp_path, made, without))
    rippled = task(tmp_path, made)
    effect = BenchEffect("motor_torque_ripple", {"torque_nm": EffectParameterValue(0.1)})
    bench: Bench = rippled.bench.with_effects(effect)
    with pytest.raises(ConfigError, match="all that repeats"):
        comparison(Task(rippled.config, bench, rippled.recordings))
    ramp = made[0].motor_speed_rpm * np.linspace(0.5, 1.5, made[0].samples)
    made[0].channels["motor_speed_rpm"][:] = ramp
    with pytest.raises(RecordingError, match="one speed"):
        comparison(task(tmp_path, made))


def test_the_bench_s_own_friction_and_lags_are_in_its_loop(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").write_text(BENCH)
    bench = load_bench(tmp_path / "bench.toml").with_effects(
        BenchEffect(
            "motor_viscous_friction", {"coefficient_nm_s_per_rad": EffectParameterValue(0.02)}
        ),
        BenchEffect("speed_sensor_lag", {"time_s": EffectParameterValue(1e-3)}),
    )
    values = loop_values(bench)
    assert values["motor_viscous_friction"] == 0.02
    assert values["speed_sensor_lag"] == 1e-3


def test_recordings_of_the_speed_and_a_bench_are_enough(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bench.toml").write_text(BENCH)
    files = []
    for rpm in (150.0, -600.0):
        made = recorded(Drive(torques=RIPPLE[:1]), rpm, 7, lasting_s=4.0, noise_rpm=0.5)
        files.append(f"{made.name}.csv".replace(" ", "_"))
        table = np.column_stack([made.time_s, made.motor_speed_rpm])
        np.savetxt(files[-1], table, "%.6f", ",", header="time_s,motor_speed_rpm", comments="")
    assert status(["diagnose", *files, "--bench", "bench.toml", "--out", "out"]) == 0
    told = capsys.readouterr()
    assert "speed's ripple" in " ".join(told.err.split())  # why this method
    first = " ".join(told.out.split())
    assert first.startswith("Motor torque ripple (order 6) 0.0")
    assert "is missing from the bench: adding it" in first
    same = bayesbl.diagnose(*files, bench="bench.toml").summary
    stored = json.loads(Path("out", "summary.json").read_text())
    assert [e["parameters"] for e in same["effects"]] == [
        e["parameters"] for e in stored["effects"]
    ]


VALUES = {
    "gear_ratio": 1.0,
    "motor_inertia_kg_m2": 2e-3,
    "load_inertia_kg_m2": 0.0,
    "speed_gain_nm_s_per_rad": 0.15,
    "integral_gain_nm_per_rad": 4.0,
    "position_gain_per_s": 0.0,
    "motor_viscous_friction": 0.0,
    "current_loop_lag": 1e-3,
    "speed_sensor_lag": 0.0,
}


def test_the_power_of_a_line_is_that_of_a_torque_and_an_error_of_the_angle_together() -> None:
    speeds, order, torque, angle, phase = np.array([-60.0, 20.0, 100.0]), 3.0, 0.05, 2e-3, 0.8
    frequency = order * speeds
    driving = torque + angle * np.exp(1j * phase) * torque_of_angle(VALUES, frequency)
    power = np.abs(speed_of_torque(VALUES, frequency) * driving) ** 2
    sizes = torque**2, angle**2, torque * angle * math.cos(phase)
    assert law_powers(VALUES, [order], speeds)[:, 0] @ sizes == pytest.approx(power, rel=1e-9)


def test_recordings_of_one_speed_leave_both_laws_of_a_line_open() -> None:
    """A torque and an error of the angle that give the same powers have the same probability."""
    for speeds, apart in (([80.0, -80.0, 80.0], False), ([20.0, 80.0, -160.0], True)):
        power = law_powers(VALUES, [6.0], np.array(speeds))[..., 0] * 0.05**2
        noise = np.full(power.shape, 1e-3 * power.min())
        lines = Lines((6.0,), np.array(speeds), power, noise, np.full(3, 5.0))
        view, inference = inferred(LoopView(lines, VALUES, {}, CANDIDATES))
        (members,) = inference.sure
        parts = {view.laws[label][1] for label in members}
        assert parts == ({TORQUE} if apart else {TORQUE, ANGLE})


def test_noise_alone_stands_out_as_rarely_as_it_is_said_to() -> None:
    """Of 60 at a rate of 0.1, more than 12 come by chance once in a hundred."""
    rng, alarms = np.random.default_rng(4), 0
    for _ in range(60):
        pieces = [
            OrderedRest(
                str(k), t, speed * t, np.full(t.size, speed), rng.standard_normal(t.size), 200.0,
                False, 2e-3,
            )
            for k, (speed, t) in enumerate((s, np.arange(2000) * 2e-3) for s in (15.0, 40.0, 90.0))
        ]  # fmt: skip
        peak = clearest(pieces, (), False, highest=64.0, coloured=True)
        alarms += peak.log_chance < math.log(0.1)
    assert alarms <= 12


def test_a_whole_order_is_found_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A line beside a whole order that is known already stays where it is."""
    used = loop_setting(task(tmp_path, [recorded(Drive(), 800.0, 1)])).used
    found = iter([6.01, 6.03, 7.98])

    def peak(*_: object, **__: object) -> Peak:
        order = next(found)
        return Peak(order, 0.01, 200.0, -90.0, 1.0, OrderSpectrum(np.arange(3.0), None, {}, 1.0))

    monkeypatch.setattr(speed_loop, "clearest", peak)
    assert [line.order for line in find_orders(used, 3, 0.01)] == [6.0, 6.03, 8.0]


def test_a_gain_beyond_its_tolerance_has_one_value(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, Drive(torques=RIPPLE, integral_gain=6.0), SLOW_RPM)
    (error,) = found.parameter_errors
    assert error.name == "integral_gain_nm_per_rad"
    assert math.exp(error.fitted.value) == pytest.approx(6.0, rel=0.05)
    assert found.bench_parameters[error.name].value == pytest.approx(error.fitted.value)
