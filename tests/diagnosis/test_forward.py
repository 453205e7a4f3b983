"""What is missing in a two-mass bench in its closed loop, on data of the independent simulator."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.parameters import BENCH_PARAMETERS
from bayesbl.bench.simulation import Measurement
from bayesbl.cli import status
from bayesbl.config.bench import dump_bench, load_bench, reference_bench
from bayesbl.config.loading import load_config
from bayesbl.diagnosis.closed_loop import diagnosis as forward
from bayesbl.diagnosis.closed_loop.diagnosis import (
    Findings,
    diagnosis_of,
    estimates,
    part_of,
    search,
)
from bayesbl.diagnosis.closed_loop.prediction import predicted
from bayesbl.diagnosis.diagnosis import Diagnosis, Estimate
from bayesbl.diagnosis.groups import diagnosis_tree
from bayesbl.diagnosis.task import Task
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.observed import Observed, observed
from bayesbl.matching.posterior import sample_direct
from bayesbl.matching.signals import GAP, START_ANGLE, Unknown, gap_unknown, start_angle_unknown
from bayesbl.model_search.residuals import motor_orders
from bayesbl.noise.process import NoiseModel
from bayesbl.presentation.diagnosis import headline, wear
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_POSITION, MOTOR_SPEED, Recording
from bayesbl.results.store import summary_of
from bayesbl.runs.kinds import result_of_run
from bayesbl.sampling.chains import SamplerSettings

BENCH = reference_bench()
BELIEVED = {info.name: BENCH.value(info.name) for info in BENCH_PARAMETERS}
GAP_RAD = 8e-4
HELD_OUT_RPM = 1600.0
FRICTION_NM = 15.0
SURE = 4.0
"""Standard deviations: one estimate in 16,000 is farther off."""


def recorded(independent, speeds_rpm, seed, hidden=None, rotations=3.0, **truth) -> list[Recording]:
    """Rotations at 500 Hz for each speed, start angles at random."""
    rng = np.random.default_rng(seed)
    made = []
    for speed in speeds_rpm:
        start, motor = rng.uniform(-math.pi, math.pi, 2)
        run = {
            "gap_rad": GAP_RAD,
            "reference_speed_rpm": speed,
            "start_angle_rad": start,
            "motor_start_angle_rad": motor,
        }
        plant = independent.plant(BELIEVED | run | truth | (hidden or {}))
        name = f"{speed:g} rpm"
        made.append(
            independent.simulate(
                plant,
                rng,
                name=name,
                rotations=rotations,
                sampling_hz=500.0,
                absolute_position=True,
            ).recording
        )
    return made


class Found(NamedTuple):
    """What the search found, and the answer that it makes."""

    findings: Findings
    answer: Diagnosis


def own_unknowns(used: Sequence[Observed]) -> list[Unknown]:
    """Of each recording its own gap and start angle."""
    gaps = [gap_unknown(1e-4, 4e-3, seen.name) for seen in used]
    return [*gaps, *(start_angle_unknown(seen.name) for seen in used)]


def diagnosed(recordings, effects, held_out=()) -> Found:
    used, checked = (
        [observed(r, BENCH, float(r.name.removesuffix(" rpm"))) for r in some]
        for some in (recordings, held_out)
    )
    findings = search(BENCH, used, checked, own_unknowns(used), effects=effects)
    return Found(findings, diagnosis_of(findings))


def names(found: Found) -> list[str]:
    return [effect.name for effect in (*found.answer.effects, *found.answer.parameter_errors)]


def fitted(found: Found, name: str) -> dict[str, Estimate]:
    return estimates(found.findings.final, name)


def near(estimate: Estimate, truth: float) -> bool:
    return abs(estimate.value - truth) < SURE * estimate.sd


@pytest.fixture(scope="module")
def friction(independent) -> Found:
    hidden = {"load_coulomb_friction__torque_nm": FRICTION_NM}
    *used, held_out = recorded(independent, (2000.0, -2000.0, HELD_OUT_RPM), 1, hidden)
    effects = ("motor_coulomb_friction", "load_coulomb_friction", "gear_mesh_friction")
    return diagnosed(used, effects, [held_out])


def test_a_hidden_effect_is_named_with_its_size(friction: Found) -> None:
    assert friction.answer.verdict == "named"
    assert names(friction) == ["load_coulomb_friction"]
    assert not friction.answer.effects[0].indistinguishable_from
    size = fitted(friction, "load_coulomb_friction")["torque_nm"]
    assert near(size, FRICTION_NM)
    assert size.sd < 0.1 * FRICTION_NM


@pytest.mark.long
def test_a_gap_that_the_edge_of_a_search_decides_is_withheld(independent) -> None:
    """Damping a quarter of the bench's: found at the edge of half, with a wrong gap."""
    soft = {"shaft_damping_nm_s_per_rad": 0.25 * BELIEVED["shaft_damping_nm_s_per_rad"]}
    used = recorded(independent, (2000.0, -2000.0), 6, soft)
    findings = diagnosed(used, ("shaft_damping_nm_s_per_rad",)).findings
    settings = SamplerSettings(ensembles=2)
    posterior = sample_direct(findings.final.fit, settings, np.random.SeedSequence(1))
    tree = diagnosis_tree(diagnosis_of(findings, posterior), 0.9, "equal_tailed")
    summary = summary_of(tree)
    assert summary["verdict"] == "parameter_error"
    assert summary["delta_rad_after"] is None
    assert "is at the lower edge" in summary["gap_withheld"]
    assert "or lacks an effect" in headline(summary)
    assert any("The gap is withheld" in sentence for sentence in wear(summary))


@pytest.mark.long
def test_intervals_are_those_of_the_draws_that_are_stored(friction: Found) -> None:
    settings = SamplerSettings(ensembles=2)
    posterior = sample_direct(friction.findings.final.fit, settings, np.random.SeedSequence(1))
    tree = diagnosis_tree(diagnosis_of(friction.findings, posterior), 0.9, "equal_tailed")
    summary = summary_of(tree)
    assert summary["diagnostics"]["outcome"] == "converged"
    for told, draws in (
        (summary["delta_rad_after"], tree["posterior"]["delta_rad"]),
        (
            summary["effects"][0]["parameters"]["torque_nm"],
            tree["posterior"]["load_coulomb_friction__torque_nm"],
        ),
    ):
        assert [told["low"], told["high"]] == pytest.approx(np.quantile(draws, [0.05, 0.95]))
    # Where recordings say as much as these, the posterior is nearly normal; 1000 draws scatter by
    # 0.03 sd in the mean and 2.3 % in the sd.
    laplace, log_gap = friction.answer.delta_after, np.log(tree["posterior"]["delta_rad"])
    assert laplace is not None
    assert abs(float(log_gap.mean()) - laplace.value) < 0.2 * laplace.sd
    assert float(log_gap.std()) == pytest.approx(laplace.sd, rel=0.1)


def test_what_repeats_before_and_after_naming_is_told_from_noise(friction: Found) -> None:
    before, after = friction.findings.before.remaining, friction.findings.after.remaining
    assert ("motor_current_a", "load angle") in {(e.channel, e.dependence) for e in before}
    assert not after


def test_naming_what_was_missing_rights_the_gap(friction: Found) -> None:
    before, after = friction.answer.delta_before, friction.answer.delta_after
    assert before is not None
    assert after is not None
    assert not near(before, math.log(GAP_RAD))
    assert near(after, math.log(GAP_RAD))


def test_the_disagreement_closes_on_what_was_not_fitted(friction: Found) -> None:
    table = friction.answer.disagreement
    assert table["over_all"]["used"]["closed_fraction"] > 0.95
    assert table["over_all"]["held_out"]["closed_fraction"] > 0.9
    held_out = table["recordings"][f"{HELD_OUT_RPM:g} rpm"]
    assert set(held_out) == {MOTOR_SPEED, MOTOR_CURRENT}
    assert all(uses["held_out"]["after"] < uses["held_out"]["before"] for uses in held_out.values())


def test_the_augmented_bench_is_a_bench_file_that_simulates(
    friction: Found, tmp_path: Path
) -> None:
    assert friction.answer.augmented_bench is not None
    file = tmp_path / "bench.toml"
    file.write_text(dump_bench(friction.answer.augmented_bench))
    bench = load_bench(file)
    assert [effect.name for effect in bench.effects] == ["load_coulomb_friction"]
    with_it = bench.simulate_many(GAP_RAD, rotations=1.0)
    without = BENCH.simulate_many(GAP_RAD, rotations=1.0)
    assert np.max(np.abs(with_it - without)) > 1.0


@pytest.mark.long
def test_where_nothing_is_missing_nothing_is_named(independent) -> None:
    found = diagnosed(
        recorded(independent, (2000.0, -1200.0), 2),
        ("motor_coulomb_friction", "load_coulomb_friction", "current_loop_lag"),
    )
    assert found.answer.verdict == "nothing_missing"
    assert not names(found)
    assert not found.answer.remaining
    assert found.answer.augmented_bench is None
    assert near(found.answer.delta_after, math.log(GAP_RAD))


@pytest.mark.long
def test_a_wrong_parameter_is_no_missing_effect(independent) -> None:
    true = 0.9 * BELIEVED["shaft_stiffness_nm_per_rad"]
    found = diagnosed(
        recorded(independent, (2000.0, -1200.0), 3, shaft_stiffness_nm_per_rad=true),
        ("load_coulomb_friction", "stiffness_hardening", "current_loop_lag"),
    )
    assert found.answer.verdict == "parameter_error"
    assert names(found) == ["shaft_stiffness_nm_per_rad"]
    (error,) = found.answer.parameter_errors
    assert near(error.fitted, true)
    bench = found.answer.augmented_bench
    assert bench is not None
    assert bench.value("shaft_stiffness_nm_per_rad") == pytest.approx(true, rel=0.03)


@pytest.mark.long
def test_hysteresis_that_draws_the_gap_far_away_is_named(independent) -> None:
    hidden = {"shaft_hysteresis__torque_nm": 40.0, "shaft_hysteresis__angle_rad": 1e-3}
    found = diagnosed(
        recorded(independent, (2000.0, -1200.0), 6, hidden, gap_rad=2.7e-3),
        ("shaft_hysteresis",),
    )
    assert abs(found.answer.delta_before.value - math.log(2.7e-3)) > 1.0
    assert names(found) == ["shaft_hysteresis"]
    assert near(fitted(found, "shaft_hysteresis")["torque_nm"], 40.0)
    assert near(found.answer.delta_after, math.log(2.7e-3))


@pytest.mark.long
def test_names_that_explain_the_means_alone_give_no_gap(independent) -> None:
    """Motor friction holds nearly all that the load's does, its means; the gap is off by half."""
    hidden = {
        "shaft_hysteresis__torque_nm": 40.0,
        "shaft_hysteresis__angle_rad": 1e-3,
        "load_coulomb_friction__torque_nm": 40.0,
    }
    found = diagnosed(
        recorded(independent, (2000.0, -1200.0), 31, hidden),
        ("shaft_hysteresis", "motor_coulomb_friction"),
    )
    assert found.answer.verdict == "unexplained"
    assert found.answer.delta_after is None
    assert found.answer.gap_withheld


@pytest.mark.long
def test_friction_on_both_sides_of_the_gear_is_named_where_neither_alone_fits(independent) -> None:
    hidden = {
        "motor_coulomb_friction__torque_nm": 0.2,
        "load_coulomb_friction__torque_nm": FRICTION_NM,
    }
    found = diagnosed(
        recorded(independent, (2000.0, -1200.0), 7, hidden, gap_rad=2.7e-3),
        ("motor_coulomb_friction", "load_coulomb_friction"),
    )
    assert sorted(names(found)) == ["load_coulomb_friction", "motor_coulomb_friction"]
    for name, size in (("motor_coulomb_friction", 0.2), ("load_coulomb_friction", FRICTION_NM)):
        assert near(fitted(found, name)["torque_nm"], size)
    assert near(found.answer.delta_after, math.log(2.7e-3))


@pytest.mark.long
def test_a_ripple_beside_a_stronger_effect_is_named_with_it(independent) -> None:
    hidden = {
        "load_torque_offset__torque_nm": FRICTION_NM,
        "motor_torque_ripple__torque_nm": 0.05,
        "motor_torque_ripple__order": 6.0,
        "motor_torque_ripple__phase_rad": 0.7,
    }
    found = diagnosed(
        recorded(independent, (2000.0, -1200.0), 8, hidden),
        ("load_torque_offset", "motor_torque_ripple"),
    )
    assert motor_orders(found.findings.naming.nominal.fit) == [6.0]
    assert sorted(names(found)) == ["load_torque_offset", "motor_torque_ripple"]
    ripple = fitted(found, "motor_torque_ripple")
    assert ripple["order"].value == 6.0
    assert near(ripple["torque_nm"], 0.05)


@pytest.mark.long
def test_what_no_catalogue_holds_is_described_and_not_named(independent) -> None:
    found = diagnosed(
        recorded(independent, (2000.0, -1200.0), 4, {"outside__belt_torque_nm": 0.2}),
        ("motor_coulomb_friction", "load_coulomb_friction", "motor_torque_ripple"),
    )
    assert found.answer.verdict == "unexplained"
    assert not names(found)
    learned = found.answer.learned
    assert learned is not None
    assert learned.term.variable == "motor_angle"
    assert abs(2.0 * math.pi / learned.term.period - 1.0 / 1.37) < 1e-3
    assert found.answer.augmented_bench is not None
    assert found.answer.augmented_bench.learned_torque == learned.term
    assert near(found.answer.delta_after, math.log(GAP_RAD))


@pytest.mark.long
def test_a_torque_in_time_is_no_wrong_parameter(independent) -> None:
    found = diagnosed(
        recorded(independent, (2000.0, -2000.0, 1200.0), 8, {"outside__time_torque_nm": 0.3}),
        (),
    )
    assert found.answer.verdict == "unexplained"
    assert not names(found)
    # It is so strong that the gap is drawn elsewhere, where mostly nothing predicts.
    learned = found.answer.learned
    assert learned is None or abs(1.0 / learned.term.period - 7.3) < 0.05
    assert (found.answer.augmented_bench is None) == (learned is None)
    assert any(abs(e.frequency_hz - 7.3) < 0.05 for e in found.answer.remaining)


@pytest.mark.long
def test_one_direction_leaves_a_set_and_asks_for_the_other(independent) -> None:
    alike = {"motor_coulomb_friction", "motor_viscous_friction", "motor_torque_offset"}
    found = diagnosed(
        recorded(independent, (2000.0,), 5, {"motor_coulomb_friction__torque_nm": 0.2}),
        (*sorted(alike), "load_coulomb_friction"),
    )
    assert found.answer.verdict == "named"
    (effect,) = found.answer.effects
    assert {effect.name, *effect.indistinguishable_from} >= alike
    assert found.answer.suggestion is not None
    assert found.answer.suggestion.reference_speed_rpm < 0.0
    assert found.answer.suggestion.distance > 5.0


@pytest.mark.long
@pytest.mark.parametrize("turns", [0, 1, -1])
def test_a_known_start_angle_counts_in_any_turn(independent, turns: int) -> None:
    angle = 2.5
    (made,) = recorded(independent, (-1200.0,), 7, start_angle_rad=angle)
    seen = observed(made, BENCH, -1200.0)
    counted = angle + 2.0 * math.pi * turns
    known = Unknown(START_ANGLE, centre=counted, sd=1e-3, recording=seen.name)
    fit = fit_aligned(BENCH, [seen], [gap_unknown(1e-4, 4e-3), known])
    assert abs(fit.value(START_ANGLE, seen.name) - counted) < SURE * known.sd
    assert near(Estimate(math.log(fit.value(GAP)), fit.sd(GAP)), math.log(GAP_RAD))
    assert fit.chi_square == pytest.approx(fit.residual.size, rel=0.1)


RIPPLE = {"torque_nm": 0.3, "order": 1.0, "phase_rad": 0.7}


def explained(seen: Observed, bench: Bench) -> float:
    """Mean square of what a bench leaves of a recording, gap and start fitted, over the noise's."""
    unknowns = [gap_unknown(1e-4, 4e-3), start_angle_unknown(seen.name)]
    fit = fit_aligned(bench, [seen], unknowns)
    return fit.chi_square / fit.residual.size


@pytest.mark.long
@pytest.mark.parametrize(("start", "lost"), [(0.5, 0), (1.6, 20), (4.7, 0), (4.7, 20)])
def test_both_halves_of_every_recording_show_one_phase_of_the_motor(
    independent, tmp_path: Path, start: float, lost: int
) -> None:
    values = {name: EffectParameterValue(value) for name, value in RIPPLE.items()}
    bench = BENCH.with_effects(BenchEffect("motor_torque_ripple", values))
    hidden = {f"motor_torque_ripple__{name}": value for name, value in RIPPLE.items()}
    (made,) = recorded(independent, (2000.0,), 9, hidden, rotations=4.1, start_angle_rad=start)
    channels = (MOTOR_SPEED, MOTOR_CURRENT, MOTOR_POSITION)
    table = np.column_stack([made.time_s, *(made.channels[c] for c in channels)])
    if lost:
        table[3000, 1] = table[4000, 2] = 65535.0
    table = np.delete(table, [*range(1000, 1000 + lost), *range(5000, 5000 + lost)], axis=0)
    file = tmp_path / "forward.csv"
    header = ",".join(("time_s", *channels))
    np.savetxt(file, table, delimiter=",", header=header, comments="")
    (tmp_path / "bench.toml").write_text(dump_bench(bench))
    known = 'method = "forward"\nmotor_angle_known = true'
    (tmp_path / "config.toml").write_text(CONFIG.replace('method = "forward"', known))
    config = load_config(tmp_path / "config.toml", kind="diagnose")
    recording = read_recording(file, name="forward")
    used, held_out, _, notes = forward.forward_problem(Task(config, bench, (recording,)))
    # Stray samples of all channels in one note, missing ones in another.
    assert len(notes) == (2 if lost else 0)
    assert all("left out" in note for note in notes)
    # 13,000 residuals scatter by 1.2 %; a half without a phase of its own leaves 5 or more.
    for seen in (*used, *held_out):
        assert explained(seen, bench) == pytest.approx(1.0, abs=0.06)


CONFIG = """
schema = 1
kind = "diagnose"
bench = "bench.toml"
[run]
output = "out"
[comparison]
method = "forward"
channels = ["motor_speed_rpm", "motor_current_a"]
[[recordings]]
name = "forward"
file = "forward.csv"
reference_speed_rpm = 2000.0
use = "split"
"""


@pytest.fixture
def folder(tmp_path: Path, independent) -> Path:
    (tmp_path / "bench.toml").write_text(dump_bench(BENCH))
    (tmp_path / "config.toml").write_text(CONFIG)
    (made,) = recorded(independent, (2000.0,), 6, rotations=5.0)
    columns = [made.time_s, *(made.channels[c] for c in (MOTOR_SPEED, MOTOR_CURRENT))]
    header = f"time_s,{MOTOR_SPEED},{MOTOR_CURRENT}"
    np.savetxt(
        tmp_path / "forward.csv",
        np.column_stack(columns),
        delimiter=",",
        header=header,
        comments="",
    )
    return tmp_path


@pytest.mark.long
@pytest.mark.parametrize(
    ("file", "old", "new", "told"),
    [
        ("bench.toml", 'drive = "two_mass"', 'drive = "rigid"', ("two_mass", "inverse")),
        ("forward.csv", MOTOR_CURRENT, "temperature", (MOTOR_CURRENT, "forward.csv")),
        ("config.toml", "= 2000.0", "= 1200.0", ("another speed", "2000", "1200")),
        ("bench.toml", "value = 120.0\n", "value = 160.0\n", ("forward.csv", "3.75 load", "split")),
        ("config.toml", 'motor_current_a"]', 'motor_position_rad"]', ("motor_position_rad",)),
        (
            "config.toml",
            "[[recordings]]",
            '[unknowns]\nbench_parameters = ["load_inertia_kg_m2"]\n[[recordings]]',
            ("tolerance", "load_inertia_kg_m2"),
        ),
    ],
)
def test_what_does_not_suit_is_refused_in_words(folder, capsys, file, old, new, told) -> None:
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1))
    assert status(["diagnose", str(folder / "config.toml")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "Traceback" not in said
    for word in told:
        assert word in said
    assert not (folder / "out").exists()


TWO_GAPS_RAD = (7e-4, 9.5e-4)
FRICTION = {"motor_coulomb_friction__torque_nm": 0.2}


@pytest.mark.parametrize("hidden", [{}, FRICTION])
def test_recordings_months_apart_have_a_gap_each(independent, tmp_path: Path, hidden) -> None:
    """Undated recordings whose gaps differ: no torque is learned in place of what has worn."""
    (tmp_path / "bench.toml").write_text(dump_bench(BENCH))
    entry = CONFIG[CONFIG.index("[[recordings]]") :]
    text = CONFIG[: CONFIG.index("[[recordings]]")]
    effects = 'effects = ["motor_coulomb_friction", "load_coulomb_friction"]'
    recordings = []
    for name, speed, gap in zip(("new", "worn"), (2000.0, -1200.0), TWO_GAPS_RAD, strict=True):
        (made,) = recorded(independent, (speed,), 100 + len(recordings), hidden, 6.0, gap_rad=gap)
        recordings.append(replace(made, name=name))
        own = entry.replace('"forward"', f'"{name}"').replace("2000.0", f"{speed}")
        text += own.replace("forward.csv", f"{name}.csv")
        (tmp_path / f"{name}.csv").touch()
    (tmp_path / "config.toml").write_text(f"{text}[candidates]\n{effects}\n")
    config = load_config(tmp_path / "config.toml", kind="diagnose")
    answer = forward.comparison(Task(config, BENCH, tuple(recordings))).diagnose(None)
    assert answer.learned is None
    assert [effect.name for effect in answer.effects] == ["motor_coulomb_friction"][: len(hidden)]
    assert answer.verdict == ("named" if hidden else "nothing_missing")
    assert not answer.gap_withheld
    assert answer.disagreement["over_all"]["held_out"]["after"] == pytest.approx(1.0, abs=0.03)
    tree = diagnosis_tree(answer, 0.9, "equal_tailed")
    summary = summary_of(tree)
    for (name, gap), truth in zip(summary["gaps"].items(), TWO_GAPS_RAD, strict=True):
        assert gap["low"] < truth < gap["high"], name
    assert summary["delta_rad_after"] == summary["gaps"]["new"]
    assert np.array_equal(tree["posterior"]["delta_rad"], tree["posterior"]["delta_rad (new)"])
    (told,) = wear(summary)
    assert "in new, 0.9" in told


def test_what_was_held_out_is_predicted_with_a_gap_of_its_own(friction: Found, independent) -> None:
    hidden = {"load_coulomb_friction__torque_nm": FRICTION_NM}
    (worn,) = recorded(independent, (HELD_OUT_RPM,), 2, hidden, gap_rad=1.2 * GAP_RAD)
    seen = observed(worn, BENCH, HELD_OUT_RPM)
    left = seen.residual_of(predicted(friction.findings.final, seen))
    assert np.std(left, axis=1) == pytest.approx([1.5, 0.05], rel=0.06)


@pytest.mark.long
def test_too_few_rotations_to_tell_noise_from_what_repeats_are_refused(folder, capsys) -> None:
    bench, config = folder / "bench.toml", folder / "config.toml"
    bench.write_text(bench.read_text().replace("value = 120.0\n", "value = 310.0\n", 1))
    forward = CONFIG[CONFIG.index("[[recordings]]") :]
    used = forward.replace('"split"', '"fit"')
    held_out = forward.replace('"split"', '"hold_out"').replace('"forward"', '"again"')
    config.write_text(CONFIG.replace(forward, used + held_out))
    assert status(["diagnose", str(config)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    for word in ("forward.csv", "too short to be fitted", "1.94 load rotations"):
        assert word in said


def test_a_current_held_by_the_drive_that_is_simulated_is_not_refused(folder: Path) -> None:
    table = np.loadtxt(folder / "forward.csv", delimiter=",", skiprows=1)
    limit = 0.9 * table[:, 2].max()
    table[:, 2] = np.minimum(table[:, 2], limit)
    header = f"time_s,{MOTOR_SPEED},{MOTOR_CURRENT}"
    np.savetxt(folder / "forward.csv", table, delimiter=",", header=header, comments="")
    bench = folder / "bench.toml"
    text = bench.read_text()
    i = text.index("value", text.index("[parameters.current_limit_a]"))
    bench.write_text(f"{text[:i]}value = {limit}{text[text.index(chr(10), i) :]}")
    assert status(["check", str(folder / "config.toml")]) == 0


@pytest.mark.long
def test_peaks_that_a_limit_cut_off_are_refused(folder: Path, capsys) -> None:
    table = np.loadtxt(folder / "forward.csv", delimiter=",", skiprows=1)
    table[:, 2] = np.minimum(table[:, 2], 0.9 * table[:, 2].max())
    header = f"time_s,{MOTOR_SPEED},{MOTOR_CURRENT}"
    np.savetxt(folder / "forward.csv", table, delimiter=",", header=header, comments="")
    assert status(["diagnose", str(folder / "config.toml")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "current is cut off" in said
    assert "forward.csv" in said


@pytest.mark.long
def test_the_bounds_that_must_stand_still_are_those_asked_for(folder, monkeypatch) -> None:
    class AskedError(Exception):
        pass

    def asked(fit: object, settings: SamplerSettings, *_: object) -> None:
        raise AskedError(settings.level)

    monkeypatch.setattr(forward, "sample_direct", asked)
    extra = '[interval]\nlevel = 0.99\n[candidates]\neffects = ["current_loop_lag"]\n'
    (folder / "config.toml").write_text(CONFIG + extra)
    config = load_config(folder / "config.toml", kind="diagnose")
    with pytest.raises(AskedError, match=r"0\.99"):
        result_of_run(config)


@pytest.mark.long
def test_a_drift_goes_on_in_the_second_half_of_exactly_four_rotations() -> None:
    drifting = replace(
        reference_bench(),
        measurement=Measurement(
            speed_noise=NoiseModel(1.5, (0.6,)), current_noise=NoiseModel(0.05)
        ),
    ).with_effects(
        BenchEffect(
            "friction_drift",
            {
                "torque_nm": EffectParameterValue(0.1),
                "rate_nm_per_s": EffectParameterValue(0.006),  # 0.012 A/s
            },
        )
    )
    used, held_out = [], []
    for k, speed in enumerate((2000.0, -2000.0)):
        recording = drifting.simulate(
            GAP_RAD,
            rotations=4.0,
            sampling_hz=500.0,
            start_angle_rad=0.4 + k,
            reference_speed_rpm=speed,
            seed=np.random.default_rng(k),
            name=f"{speed:g} rpm",
        )
        seen = observed(recording, BENCH, speed)
        forward.require_rotations(seen, "recording.csv", split=True)
        middle = seen.samples // 2
        used.append(part_of(seen, slice(middle)))
        held_out.append(part_of(seen, slice(middle, None)))
    unknowns = own_unknowns(used)
    effects = ("motor_coulomb_friction", "friction_drift", "motor_torque_offset")
    findings = search(BENCH, used, held_out, unknowns, effects=effects)
    found = Found(findings, diagnosis_of(findings))
    assert found.answer.verdict == "named"
    assert names(found) == ["friction_drift"]
    assert near(fitted(found, "friction_drift")["rate_nm_per_s"], 0.006)
    closed = found.answer.disagreement["over_all"]["held_out"]["closed_fraction"]
    assert closed is not None
    assert closed > 0.98
