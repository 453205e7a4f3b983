"""What an effect declares is what the simulator does: laws that hold for every effect there is."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bayesbl.bench.effect_declaration import ORDER, PHASE, Effect, EffectParameter
from bayesbl.bench.effects import EFFECT_BY_NAME, EFFECTS, repeat_each_rotation, turn_with_the_motor
from bayesbl.bench.kernel import CURRENT, POSITION, SPEED, Slot
from bayesbl.bench.learned import ENCODER_ERROR, LEARNED_TORQUE
from bayesbl.bench.parameters import check_parameters
from bayesbl.bench.simulation import simulate_channels
from bayesbl.config.bench import reference_bench
from bayesbl.errors import BenchError

BENCH = reference_bench()
WHOLE, BROKEN = 120.0, 120.5
"""Gear ratios with a whole number of motor turns per load rotation, and without."""

BY_NAME = pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
AMPLITUDES = [(effect, item) for effect in EFFECTS for item in effect.amplitudes]
BY_AMPLITUDE = pytest.mark.parametrize(
    ("effect", "amplitude"), AMPLITUDES, ids=[f"{e.name}.{i.name}" for e, i in AMPLITUDES]
)


def settings(effect: Effect, amplitudes: tuple[EffectParameter, ...]) -> dict[str, float]:
    """The effect at its typical shape, with these amplitudes at their typical strength."""
    return {
        f"{effect.name}__{item.name}": item.typical
        for item in effect.parameters
        if not item.is_amplitude or item in amplitudes
    }


def bench(ratio: float = WHOLE, **given: float) -> np.ndarray:
    """One parameter vector, shape (1, SLOTS)."""
    return BENCH.vector(
        **{"gap_rad": 8e-4, "start_angle_rad": 0.4, "gear_ratio": ratio, **given},
        reference_speed_rpm=2000.0,
    )


def simulated(parameters: np.ndarray, rotations: int = 1) -> np.ndarray:
    """Position, speed and current over whole rotations at 1 kHz, shape (3, n)."""
    samples = rotations * round(30.0 * parameters[0, Slot.gear_ratio])
    return simulate_channels(parameters, samples, 1000.0, accuracy_rpm=1e-3)[0]


def does_repeat(parameters: np.ndarray) -> bool:
    """Whether the second load rotation is as the first."""
    first, second = np.split(simulated(parameters, rotations=2), 2, axis=1)
    apart = np.max(np.abs(second - first), axis=1)
    repeats = bool(apart[SPEED] < 0.005 and apart[CURRENT] < 5e-4)
    assert repeats or apart[CURRENT] > 0.01, "neither the same nor clearly another"
    return repeats


@BY_AMPLITUDE
def test_what_is_declared_to_repeat_repeats_and_nothing_else(
    effect: Effect, amplitude: EffectParameter
) -> None:
    given = settings(effect, (amplitude,))
    if effect.has_order:
        given[f"{effect.name}__{ORDER}"] = 1.0
    for ratio in (WHOLE, BROKEN):
        parameters = bench(ratio, **given)
        declared = {"always": True, "never": False, "whole_orders": ratio == WHOLE}
        assert repeat_each_rotation(parameters) is declared[amplitude.repeats]
        assert does_repeat(parameters) is declared[amplitude.repeats]


@BY_NAME
def test_only_what_depends_on_the_motor_angle_feels_where_the_motor_starts(effect: Effect) -> None:
    given = settings(effect, effect.amplitudes)
    at_zero, turned = (bench(motor_start_angle_rad=start, **given) for start in (0.0, 1.0))
    same = np.array_equal(simulated(at_zero), simulated(turned))
    assert turn_with_the_motor(at_zero) is ("motor_angle" in effect.depends_on) is not same


@BY_NAME
def test_shapes_change_nothing_while_no_amplitude_is_on(effect: Effect) -> None:
    names = [f"{effect.name}__{item.name}" for item in effect.shapes]
    lows, highs = [item.low for item in effect.shapes], [item.high for item in effect.shapes]
    low, high = (
        simulated(bench(**dict(zip(names, values, strict=True)))) for values in (lows, highs)
    )
    assert np.array_equal(low, high)
    assert np.max(np.abs(low - simulated(bench()))[[SPEED, CURRENT]]) < 2e-3


@BY_AMPLITUDE
def test_every_amplitude_shows_at_its_typical_strength(
    effect: Effect, amplitude: EffectParameter
) -> None:
    change = simulated(bench(**settings(effect, (amplitude,)))) - simulated(bench())
    largest = np.max(np.abs(change), axis=1)
    # Laws that move a gap before they show are those that every fit has in.
    least_rpm = 0.03 if effect.always_in else 0.1
    assert largest[SPEED] > least_rpm or largest[CURRENT] > 0.02 or largest[POSITION] > 0.1


def refused(effect: Effect, item: EffectParameter, value: float) -> bool:
    """Whether the simulator refuses the effect with another value of one parameter."""
    given = settings(effect, effect.amplitudes) | {f"{effect.name}__{item.name}": value}
    wrong = ""
    try:
        check_parameters(bench(**given))
    except BenchError as error:
        wrong = error.where
    return wrong == f"{effect.name}.{item.name}"


@BY_NAME
def test_the_simulator_refuses_what_the_declaration_excludes_and_nothing_else(
    effect: Effect,
) -> None:
    for item in effect.parameters:
        assert not refused(effect, item, item.typical)
        assert not refused(effect, item, item.high)
    for item in effect.amplitudes:
        assert not refused(effect, item, 0.0)
        assert refused(effect, item, -abs(item.typical)) is item.not_negative
        assert refused(effect, item, 1e9) is (item.smaller_than is not None)
    for item in effect.shapes:
        assert refused(effect, item, 0.0) is item.positive_scale
        below = item.low - abs(item.typical) if item.bounded else -abs(item.typical)
        assert refused(effect, item, below) is (item.positive_scale or item.bounded)
        assert refused(effect, item, 1e9) is item.bounded


def torque_of(effect: Effect, speed: float) -> np.ndarray:
    """An effect's torque on a rigid bench that turns at one speed, rad/s."""
    time = np.linspace(0.0, 1.0, 50)
    motion = SimpleNamespace(
        time_s=time,
        angle=10.0 * time,
        speed=np.full(50, speed),
        acceleration=np.zeros(50),
        sway=np.exp(10j * time),
        friction_width=0.0,
    )
    law = effect.load_torque or (effect.torque and effect.torque.signal)
    return law(motion, BENCH, {item.name: item.typical for item in effect.parameters})


@pytest.mark.parametrize(
    "effect", [e for e in EFFECTS if e.torque or e.load_torque], ids=lambda effect: effect.name
)
def test_a_torque_depends_on_speed_and_direction_as_declared(effect: Effect) -> None:
    slow, fast, reverse = (torque_of(effect, speed) for speed in (50.0, 100.0, -50.0))
    assert np.allclose(slow, fast, rtol=1e-9) is ("speed" not in effect.depends_on)
    if "direction" in effect.depends_on:
        assert np.allclose(slow, -reverse, rtol=1e-9)
    elif "speed" not in effect.depends_on:
        assert np.array_equal(slow, reverse)


@BY_NAME
def test_a_declaration_is_complete_and_consistent(effect: Effect) -> None:
    assert effect.sentence.endswith(".")
    assert effect.amplitudes
    for item in effect.parameters:
        assert (item.role == "order") is (item.name == ORDER)
        assert (item.role == "phase") is (item.name == PHASE)
        assert item.low <= item.typical <= item.high
        assert item.low <= item.neutral <= item.high or effect.replaces == item.name
    names = {item.name: item.role for item in effect.parameters}
    turning = {item.repeats == "whole_orders" for item in effect.amplitudes}
    assert turning == {"motor_angle" in effect.depends_on} == {effect.is_periodic}
    if (law := effect.torque) is not None:
        assert all(names[name] == "amplitude" for name in (law.amplitude, *law.linear))
        assert law.scanned is None or law.scanned in names
        others = {*law.same_as, *([law.contains] if law.contains else [])}
        assert others <= EFFECT_BY_NAME.keys() - {effect.name}
    assert effect.torque is not None or not effect.free_motion
    assert effect.sought_alone is None or effect.sought_alone in names


def test_each_effect_has_its_own_place_and_slots_in_the_kernel() -> None:
    assert len({effect.place for effect in EFFECTS}) == len(EFFECTS)
    slots = {slot for effect in EFFECTS for slot in effect.slots.values()}
    learned = (f"{LEARNED_TORQUE}__", f"{ENCODER_ERROR}__")
    own = {slot for slot in Slot if slot.name.startswith(learned)}
    assert slots == {slot for slot in Slot if "__" in slot.name} - own
