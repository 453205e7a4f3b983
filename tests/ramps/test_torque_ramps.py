"""Laws of the play that torque ramps show, on loops of the play operator and an independent rig.

The play operator is quasi-static and exact, so what ramps leave is known by hand: with friction T,
a gap δ and flanks of compliance c, ramps to M ≥ 2T leave 2(δ + c T) between them.
"""

from __future__ import annotations

import json
from importlib import import_module
from itertools import pairwise

import numpy as np
import pytest
from places import ROOT
from scipy import stats

from bayesbl.ramps.flanks import find_flanks, lost_motion, of_cycles, stiffness
from bayesbl.ramps.play import Widths, sample_play
from bayesbl.ramps.torque_cycles import find_ramps
from bayesbl.recording.readers import read_recording
from bayesbl.sampling.chains import SamplerSettings

STAND = ROOT.parent / "shared" / "data" / "torque_ramps"
GAP, FRICTION, COMPLIANCE = 5e-3, 1.0, 5e-4
SMALL, LARGE = 3.0, 20.0


def triangles(*amplitudes: float, points: int = 800) -> np.ndarray:
    """Torque of one cycle to and fro after another."""
    phase = np.arange(points) / points
    return np.concatenate(
        [a * 2.0 / np.pi * np.arcsin(np.sin(2 * np.pi * phase)) for a in amplitudes]
    )


def operator(torque, gap=GAP, friction=FRICTION, compliance=COMPLIANCE, start=0.0):
    """Position of a play operator; a negative gap is an interference that both flanks carry."""
    grid = np.linspace(-0.5, 0.5, 200_001)
    force = (np.maximum(grid - gap, 0.0) - np.maximum(-grid - gap, 0.0)) / compliance
    if gap > 0.0:
        force = force + 1e-6 * grid  # one position for each force
    lower = np.interp(torque - friction, force, grid)
    upper = np.interp(torque + friction, force, grid)
    found = []
    for least, most in zip(lower, upper, strict=True):
        start = min(max(start, least), most)
        found.append(start)
    return np.array(found)


def noisy(torque, position, seed=0):
    generator = np.random.default_rng(seed)
    return torque + 0.05 * generator.standard_normal(torque.size), position


CYCLES = (*[SMALL] * 5, *[LARGE] * 2)


def flanks_of(*amplitudes, seed=0, **joint):
    torque = triangles(*amplitudes)
    return find_flanks([find_ramps(*noisy(torque, operator(torque, **joint), seed))])


def test_what_ramps_leave_is_the_play_and_what_friction_holds():
    found = flanks_of(*CYCLES)
    expected = 2.0 * (GAP + COMPLIANCE * FRICTION)
    assert found.finding == "play"
    assert found.level.amplitude_nm == pytest.approx(SMALL, rel=0.03)
    assert np.concatenate(found.level.widths()) == pytest.approx(expected, rel=0.01)
    assert found.level.friction_nm == pytest.approx(FRICTION, rel=0.05)
    assert len(found.level.cycles) == 9  # of ten excursions


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("scale", [0.1, 30.0])
def test_the_answer_goes_with_units_and_not_with_direction_or_origin(sign, scale):
    torque = triangles(*CYCLES)
    position = operator(torque)
    plain = find_flanks([find_ramps(torque, position)])
    other = find_flanks([find_ramps(sign * scale * torque, sign * position + 7.0)])
    assert other.finding == plain.finding
    assert other.level.widths()[0] == pytest.approx(plain.level.widths()[0], rel=1e-6)
    assert other.level.friction_nm == pytest.approx(scale * plain.level.friction_nm, rel=1e-6)


def test_a_torque_that_counts_against_the_position_is_turned_round():
    torque = triangles(*CYCLES)
    position = operator(torque)
    plain, against = find_ramps(torque, position), find_ramps(-torque, position)
    assert against.turned
    assert not plain.turned
    for one, other in zip(plain.cycles, against.cycles, strict=True):
        assert other.width_rad == one.width_rad > 0.0


@pytest.mark.long
@pytest.mark.parametrize("cycles", [1, 4, 300])
def test_few_ramps_and_many_are_read_alike(cycles):
    torque = triangles(*[SMALL] * cycles)
    ramps = find_ramps(*noisy(torque, operator(torque)))
    assert len(ramps.cycles) >= 2 * cycles - 2
    width = np.mean([c.width_rad for c in ramps.cycles])
    assert width == pytest.approx(2.0 * (GAP + COMPLIANCE * FRICTION), rel=0.01)
    assert ramps.cycles[-1].amplitude_nm == pytest.approx(SMALL, rel=0.04)


def test_a_steady_drift_moves_no_width():
    torque = triangles(*[SMALL] * 6)
    drift = np.linspace(0.0, GAP, torque.size)
    still, moved = (find_ramps(torque, operator(torque) + d) for d in (0.0, drift))
    width = [find_flanks([f]).level.widths()[0].mean() for f in (still, moved)]
    assert width[1] == pytest.approx(width[0], rel=0.01)


def test_a_saturated_torque_and_ringing_where_the_joint_jumps_are_no_ramps_of_their_own():
    torque = np.clip(triangles(*CYCLES), -15.0, 15.0)
    position = operator(torque)
    jumps = np.flatnonzero(np.abs(np.diff(position)) > 0.2 * GAP)
    rung = torque.copy()
    for jump in jumps:
        rung[jump : jump + 8] -= 1.5 * torque[jump]
    sides = [e.side for e in find_ramps(rung, position).excursions]
    assert all(a == -b for a, b in pairwise(sides))
    assert len(sides) == 14 or len(sides) == 13


def test_small_ramps_beside_large_ones_at_one_rate_are_ramps():
    """A ramp of 2 to 50 N m takes a 25th of the time."""
    pieces = [triangles(2.0, points=80)] * 3 + [triangles(50.0, points=2000)] * 2
    torque = np.concatenate(pieces)
    ramps = find_ramps(torque, operator(torque, friction=0.8))
    assert len(ramps.excursions) == 10


@pytest.mark.parametrize("torque", [np.abs(triangles(*CYCLES)), np.linspace(-4.0, 4.0, 3000)])
def test_ramps_of_one_direction_leave_no_width(torque):
    assert find_flanks([find_ramps(torque, operator(torque))]) is None


@pytest.mark.parametrize("preload_nm", [2.0, 6.0, 60.0])
def test_a_preloaded_joint_is_one_without_play(preload_nm):
    found = flanks_of(*CYCLES, gap=-preload_nm * COMPLIANCE)
    assert found.probability_of_play < 0.5
    if preload_nm < LARGE:
        assert found.finding == "preloaded"
        assert found.relative_compliance < 0.8


def test_larger_ramps_answer_where_friction_holds_the_small_ones():
    found = flanks_of(0.5, 0.5, 0.5, *[SMALL] * 3, *[LARGE] * 2)
    assert found.finding == "play"
    assert found.level.amplitude_nm == pytest.approx(SMALL, rel=0.05)
    assert len(found.skipped_nm) == 1


@pytest.mark.parametrize("size", [5.0, 10.0, LARGE])
def test_ramps_of_one_size_show_the_play_and_the_wind_up_behind_it(size):
    found = flanks_of(*[size] * 5)
    assert found.finding == "play"
    windup = np.concatenate(found.windup_rad).mean()
    assert found.level.width_rad - windup == pytest.approx(2.0 * GAP, rel=0.02)
    assert windup == pytest.approx(2.0 * COMPLIANCE * FRICTION, rel=0.2)


def test_ramps_of_one_size_that_hardly_exceed_the_friction_do_not():
    found = flanks_of(*[SMALL] * 5)
    assert found.finding == "too_small"
    assert found.needed_nm == pytest.approx(3.0 * SMALL, rel=0.03)


def test_small_ramps_that_stick_in_front_of_a_compliance_are_skipped():
    """With a spring in series they move, but leave nothing: larger ones leave the whole play."""
    torque = triangles(*[4.0] * 3, *[50.0] * 3)
    position = operator(torque, friction=5.0) + COMPLIANCE * torque
    generator = np.random.default_rng(0)
    position = position + 1e-6 * generator.standard_normal(torque.size)
    found = find_flanks([find_ramps(*noisy(torque, position))])
    assert found.finding == "play"
    assert found.skipped_nm == pytest.approx((4.0,), rel=0.05)


def test_small_ramps_that_stop_in_the_middle_of_the_play_are_skipped():
    """They leave less than larger ones leave without any wind-up that friction can hold."""
    torque = np.concatenate([triangles(*[SMALL] * 3), triangles(*[LARGE] * 3)])
    position = operator(torque)
    small = slice(0, 3 * 800)
    position[small] *= 0.6
    found = find_flanks([find_ramps(torque, position)])
    assert found.skipped_nm == pytest.approx((SMALL,), rel=0.05)
    assert found.level.amplitude_nm == pytest.approx(LARGE, rel=0.05)


@pytest.mark.parametrize("friction", [1e-6, 0.5, 3.0])
def test_lost_motion_is_the_play_and_the_twist_whatever_the_friction(friction):
    torque = triangles(*[LARGE] * 3)
    ramps = find_ramps(torque, operator(torque, friction=friction))
    level = find_flanks([ramps]).largest
    (lost,) = of_cycles(level, lambda cycle: lost_motion(cycle, 1.0))
    # The first one begins between the flanks.
    assert lost[1:] == pytest.approx(2.0 * (GAP + COMPLIANCE * 1.0), rel=0.02)


def test_ramps_that_shrink_step_by_step_are_small_and_large_ones():
    torque = triangles(*(LARGE * 0.7**k for k in range(7)))
    flanks = find_flanks([find_ramps(torque, operator(torque))])
    assert flanks.finding == "play"
    assert flanks.level.width_rad == pytest.approx(2.0 * (GAP + COMPLIANCE * FRICTION), rel=0.05)


@pytest.mark.long
def test_one_snapshot_of_three_positions_is_nearly_students_t():
    """The prior of σ is bounded, so the tails are shorter than with two degrees of freedom."""
    values = np.array([9.0e-3, 10.0e-3, 11.0e-3])
    widths = Widths("one", tuple(np.array([v, v]) for v in values), 1e-9)
    found = sample_play([widths], SamplerSettings(), np.random.SeedSequence(1))
    draws = found.width_rad["one"].ravel()
    t = stats.t(2, values.mean(), values.std(ddof=1) / np.sqrt(3))
    assert np.median(draws) == pytest.approx(values.mean(), rel=0.01)
    low, high = np.quantile(draws, (0.05, 0.95))
    assert t.ppf(0.05) - 1e-4 < low < t.ppf(0.15)
    assert t.ppf(0.85) < high < t.ppf(0.95) + 1e-4


@pytest.mark.long
def test_a_pattern_round_the_turn_that_stays_sharpens_the_change():
    pattern = np.array([-2e-3, 0.0, 2e-3])
    small = np.array([1e-4, -1e-4, 0.0])
    before, after = 8e-3 + pattern, 10e-3 + pattern + small
    shuffled = after[[1, 2, 0]]
    widths = []
    for later in (after, shuffled):
        snapshots = [
            Widths(name, tuple(np.array([v]) for v in values), 1e-9)
            for name, values in (("before", before), ("after", later))
        ]
        found = sample_play(snapshots, SamplerSettings(ensembles=2), np.random.SeedSequence(2))
        change = found.width_rad["after"] - found.width_rad["before"]
        widths.append(float(np.std(change)))
        assert np.median(change) == pytest.approx(2e-3, abs=6e-4)
    assert widths[0] < 0.7 * widths[1]


@pytest.mark.long
def test_widths_are_covered_by_their_interval():
    """Scatter of a fifth, five cycles: 90 % intervals hold the truth in 22 of 30 or more (1 %).

    With hundreds of gearboxes: ``configs/torque_ramps_study.toml``.
    """
    generator = np.random.default_rng(5)
    inside = []
    for _ in range(30):
        y = 1e-2 * (1.0 + 0.2 * generator.standard_normal(5))
        found = sample_play(
            [Widths("s", (y,), 1e-9)],
            SamplerSettings(ensembles=2, max_steps=500),
            np.random.SeedSequence(int(generator.integers(1 << 30))),
        )
        low, high = np.quantile(found.width_rad["s"], (0.05, 0.95))
        inside.append(low < 1e-2 < high)
    assert sum(inside) >= stats.binom.ppf(0.01, 30, 0.9)


@pytest.fixture(scope="module")
def rig():
    import sys

    sys.path.append(str(ROOT / "experiments"))
    return import_module("torque_ramp_rig")


@pytest.mark.parametrize("state", ["new", "worn"])
def test_the_play_of_an_independent_rig_is_what_its_ramps_leave(rig, state):
    box, generator = rig.STATES[state], np.random.default_rng(1)
    _, torque, position = rig.measured(*rig.simulate(box, rig.Ramps(), generator), generator)
    found = find_flanks([find_ramps(torque, position)], 9.6e-5)
    truth = rig.reading(box, 4.0, generator, 20)
    assert found.finding == "play"
    assert 0.5 * found.level.widths()[0].mean() == pytest.approx(truth, rel=0.04)


def test_a_preloaded_rig_is_called_so(rig):
    box, generator = rig.STATES["preloaded"], np.random.default_rng(1)
    _, torque, position = rig.measured(*rig.simulate(box, rig.Ramps(), generator), generator)
    assert find_flanks([find_ramps(torque, position)], 9.6e-5).finding == "preloaded"


def test_ramps_of_half_the_friction_are_too_small(rig):
    ramps, generator = rig.Ramps((0.8,), (5,), (4.0,)), np.random.default_rng(1)
    box = rig.STATES["new"]
    _, torque, position = rig.measured(*rig.simulate(box, ramps, generator), generator)
    found = find_flanks([find_ramps(torque, position)], 9.6e-5)
    assert found.finding == "too_small"
    assert found.needed_nm > 2.0 * 0.8


@pytest.mark.skipif(not STAND.is_dir(), reason="the recordings of the test stand are not here")
def test_gearboxes_of_a_test_stand_have_the_play_that_their_author_read():
    """Within 0.15° of whole play or two standard deviations in at least 8 of 9 states."""
    columns = import_module("bayesbl.recording.channels").ColumnSpec
    specs = {
        "time_s": columns("TIME", "s"),
        "motor_position_rad": columns("POSITION", "rev"),
        "motor_torque_nm": columns("TORQUE", "N m"),
    }
    close, grew, by_preload = [], {}, []
    for folder in sorted(path for path in STAND.iterdir() if path.is_dir()):
        states = json.loads((folder / "truth.json").read_text())
        widths, play = [], {}
        for state in states:
            files = []
            for place in (1, 5, 6):
                recording = read_recording(folder / f"{state}_{place}.csv.gz", columns=specs)
                channels = recording.channels
                files.append(
                    find_ramps(channels["motor_torque_nm"], channels["motor_position_rad"])
                )
            found = find_flanks(files)
            assert found.answered
            play[state] = found.probability_of_play
            widths.append(Widths(state, tuple(found.level.widths()), 1e-4))
        drawn = sample_play(widths, SamplerSettings(), np.random.SeedSequence(1)).width_rad
        for state, truth in states.items():
            degrees = np.degrees(drawn[state])
            error = abs(np.median(degrees) - truth["play_deg"])
            close.append(error < max(0.15, 2.0 * degrees.std()))
            if "preload" in state or "reassembled" in state:
                by_preload.append((np.median(degrees), play[state]))
        after = next(s for s in states if s.startswith("after"))
        grew[folder.name] = float(np.mean(drawn[after] > drawn["initial"]))
    assert sum(close) >= 8
    assert grew["baseline_onyx"] > 0.95
    assert grew["split_pinwheel_pc_cf"] > 0.95
    assert grew["baseline_pc_cf"] < 0.7
    assert [p for p, _ in by_preload] == sorted((p for p, _ in by_preload), reverse=True)
    assert [play > 0.5 for _, play in by_preload] == [True, True, False, False]


@pytest.mark.skipif(not STAND.is_dir(), reason="the recordings of the actuators are not here")
@pytest.mark.parametrize(
    ("actuator", "ratio", "published_nm_per_rad"), [("sspg", 7.2, 242.7), ("cpg", 14.0, 201.6)]
)
def test_the_stiffness_of_two_actuators_is_the_published_one(actuator, ratio, published_nm_per_rad):
    """Position of the motor, torque of the output, within 2 %."""
    table = STAND.parent / "planetary_compact" / f"transmission_stiffness_{actuator}.csv.gz"
    columns = np.genfromtxt(table, delimiter=",", names=True)
    ramps = find_ramps(columns["output_torque_Nm"], columns["encoder_pos_rad"] / ratio)
    (cycle,) = ramps.cycles
    assert stiffness(cycle) == pytest.approx(published_nm_per_rad, rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "answered", "none"), [("preloaded", 1.0, 1), ("too_small", 0.0, 0)]
)
def test_gearboxes_of_the_study_are_called_what_they_are(rig, kind, answered, none):
    study = import_module("torque_ramps")
    row = study.Row(kind=kind, positions=3 if none else 1, cases=3)
    for number in range(3):
        found = study.run_case(row, number, np.random.SeedSequence([11, number]))
        assert found["answered"] == answered
        assert not none or found["none"] > 0.5
