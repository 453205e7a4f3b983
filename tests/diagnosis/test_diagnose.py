"""``bayesbl diagnose`` from configuration to output folder, what it refuses, and ``effects``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from rigid_machine import SAMPLING_HZ, recording

from bayesbl.bench.effects import EFFECTS
from bayesbl.cli import status
from bayesbl.config.bench import dump_bench, load_bench
from bayesbl.errors import BenchError
from bayesbl.recording.types import MOTOR_POSITION, MOTOR_SPEED, MOTOR_TORQUE, Recording
from bayesbl.results.store import read_tree

BENCH = """
schema = 1
kind = "bench"
drive = "rigid"
[parameters]
gear_ratio = {value = 100.0}
motor_inertia_kg_m2 = {value = 2e-3}
load_inertia_kg_m2 = {value = 60.0, relative_tolerance = 0.1}
gravity_torque_nm = {value = 300.0}
"""

CONFIG = """
schema = 1
kind = "diagnose"
bench = "bench.toml"
[run]
output = "out"
[comparison]
method = "inverse"
load_angle_known = true
motor_angle_known = true
[unknowns]
bench_parameters = ["load_inertia_kg_m2"]
[candidates]
max_effects = 2
[[recordings]]
file = "a.csv"
[[recordings]]
file = "b.csv"
use = "split"
"""


def write_csv(made: Recording, path: Path, channels: tuple[str, ...]) -> None:
    columns = [made.time_s, *(made.channels[c] for c in channels)]
    header = ",".join(("time_s", *channels))
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for seed, name in enumerate("ab"):
        made = recording(name, 70 + seed, coulomb=0.5, viscous=5e-3)
        write_csv(made, tmp_path / f"{name}.csv", (MOTOR_POSITION, MOTOR_SPEED, MOTOR_TORQUE))
    (tmp_path / "bench.toml").write_text(BENCH)
    (tmp_path / "config.toml").write_text(CONFIG)
    return tmp_path


@pytest.mark.long
def test_a_diagnosis_leaves_a_whole_result_in_the_words_of_the_contract(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(["check", str(folder / "config.toml")]) == 0
    assert "motor_coulomb_friction" in capsys.readouterr().out
    assert status(["diagnose", str(folder / "config.toml")]) == 0
    told = " ".join(capsys.readouterr().out.split())
    first = told.split("motor torque")[0]
    for part in ("Coulomb friction 0.5", "or load Coulomb friction", "are missing from the bench"):
        assert part in first
    summary = json.loads((folder / "out" / "summary.json").read_text())
    assert summary["verdict"] == "named"
    names = [effect["name"] for effect in summary["effects"]]
    assert sorted(names) == ["motor_coulomb_friction", "motor_viscous_friction"]
    coulomb = next(e for e in summary["effects"] if e["name"] == "motor_coulomb_friction")
    interval = coulomb["parameters"]["torque_nm"]
    assert interval["low"] < 0.5 < interval["high"]
    assert coulomb["probability"] > 0.999
    assert "load_coulomb_friction" in coulomb["indistinguishable_from"]
    disagreement = summary["disagreement"]
    assert set(disagreement["recordings"]) == {"a", "b"}
    assert set(disagreement["recordings"]["b"][MOTOR_TORQUE]) == {"used", "held_out"}
    held_out = disagreement["over_all"]["held_out"]
    assert held_out["after"] < 0.15 < held_out["before"]
    assert held_out["closed_fraction"] > 0.95
    assert summary["parameter_errors"] == []
    tree = read_tree(folder / "out")
    signals = tree["signals"].to_dataset()
    first = signals.isel(piece=0)
    rest = (first["measured"] - first["after"]).values
    assert np.sqrt(np.nanmean(rest**2)) == pytest.approx(
        disagreement["recordings"]["a"][MOTOR_TORQUE]["used"]["after"]
    )
    drawn = sorted(path.name for path in (folder / "out" / "figures").glob("*.png"))
    assert drawn == ["diagnosis.png"]
    assert status(["inspect", str(folder / "out")]) == 0
    assert status(["figures", str(folder / "out")]) == 0
    assert status(["run", str(folder / "config.toml")]) == 2  # never written over


def spoiled(folder: Path, table: np.ndarray) -> None:
    header = ",".join(("time_s", MOTOR_POSITION, MOTOR_SPEED, MOTOR_TORQUE))
    np.savetxt(folder / "b.csv", table, delimiter=",", header=header, comments="")


@pytest.mark.long
def test_lost_and_stray_samples_count_nowhere(folder: Path) -> None:
    table = np.loadtxt(folder / "b.csv", delimiter=",", skiprows=1)
    table[[300, 1500], 3] = 65535.0
    table[900, 1] = 65535.0
    lost = np.concatenate([np.arange(600, 620), np.arange(1700, 1720)])
    spoiled(folder, np.delete(table, lost, axis=0))
    assert status(["run", str(folder / "config.toml")]) == 0
    summary = json.loads((folder / "out" / "summary.json").read_text())
    left_out = [w for w in summary["warnings"] if "left out" in w]
    assert len(left_out) == 2, "stray samples of all channels, and missing ones"
    assert all(warning.startswith("b: ") for warning in left_out)
    found = {e["name"]: e["parameters"] for e in summary["effects"]}
    assert set(found) == {"motor_coulomb_friction", "motor_viscous_friction"}
    coulomb = found["motor_coulomb_friction"]["torque_nm"]
    assert coulomb["low"] < 0.5 < coulomb["high"]
    # As much as in the recording that lost nothing; a bridge of 80 ms alone would leave twice that.
    left = summary["disagreement"]["recordings"]
    whole = left["a"][MOTOR_TORQUE]["used"]["after"]
    for found in left["b"][MOTOR_TORQUE].values():
        assert found["after"] == pytest.approx(whole, rel=0.15)


def test_a_recording_with_more_lost_than_kept_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = np.loadtxt(folder / "b.csv", delimiter=",", skiprows=1)
    spoiled(folder, np.delete(table, np.arange(40, 2000, 40), axis=0))
    config = folder / "config.toml"
    slow = config.read_text().replace("[comparison]\n", "[comparison]\ncutoff_hz = 5.0\n")
    config.write_text(slow)
    assert status(["run", str(folder / "config.toml")]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "Too little remains" in told
    assert "b.csv" in told


def test_torque_that_a_limit_cut_off_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = np.loadtxt(folder / "b.csv", delimiter=",", skiprows=1)
    table[:, 3] = np.minimum(table[:, 3], 0.8 * table[:, 3].max())
    spoiled(folder, table)
    assert status(["run", str(folder / "config.toml")]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "torque is cut off" in told
    assert "b.csv" in told


def test_free_motion_may_come_to_rest(folder: Path) -> None:
    bench = BENCH.replace("gravity_torque_nm = {value = 300.0}", "gravity_torque_nm = {value = 0}")
    (folder / "bench.toml").write_text(bench)
    time = np.arange(2000) / SAMPLING_HZ
    stop_s = 5.0
    running = np.minimum(time, stop_s)
    position = np.round(40.0 * running * (1.0 - 0.5 * running / stop_s), 3)
    for name in "ab":
        made = Recording(name, time, {MOTOR_POSITION: position})
        write_csv(made, folder / f"{name}.csv", (MOTOR_POSITION,))
    text = CONFIG.replace('method = "inverse"', 'method = "free_motion"')
    (folder / "config.toml").write_text(text)
    assert status(["check", str(folder / "config.toml")]) == 0


def test_free_motion_in_a_single_step_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All of its travel is in one sample, so it has no halves."""
    bench = BENCH.replace("gravity_torque_nm = {value = 300.0}", "gravity_torque_nm = {value = 0}")
    (folder / "bench.toml").write_text(bench)
    time = np.arange(2000) / SAMPLING_HZ
    position = np.where(time > 0.0, 1.0, 0.0)
    for name in "ab":
        made = Recording(name, time, {MOTOR_POSITION: position})
        write_csv(made, folder / f"{name}.csv", (MOTOR_POSITION,))
    text = CONFIG.replace('method = "inverse"', 'method = "free_motion"')
    (folder / "config.toml").write_text(
        text.replace('file = "a.csv"', 'file = "a.csv"\nuse = "split"')
    )
    assert status(["check", str(folder / "config.toml")]) == 2
    assert "Nothing moves in a part" in capsys.readouterr().err


@pytest.mark.long
def test_effects_that_the_bench_has_are_not_missing(folder: Path) -> None:
    bench = BENCH + (
        '[[effects]]\nname = "motor_coulomb_friction"\nparameters = {torque_nm = {value = 0.5}}\n'
        '[[effects]]\nname = "motor_viscous_friction"\n'
        "parameters = {coefficient_nm_s_per_rad = {value = 5e-3}}\n"
    )
    (folder / "bench.toml").write_text(bench)
    assert status(["run", str(folder / "config.toml")]) == 0
    summary = json.loads((folder / "out" / "summary.json").read_text())
    assert summary["verdict"] == "nothing_missing"
    assert summary["disagreement"]["over_all"]["held_out"]["before"] < 0.15


@pytest.mark.long
def test_current_says_as_much_as_torque_and_speed_as_much_as_position(folder: Path) -> None:
    for name in "ab":
        made = recording(name, 70 + "ab".index(name), coulomb=0.5, viscous=5e-3)
        channels = {
            MOTOR_SPEED: made.channels[MOTOR_SPEED],
            "motor_current_a": made.channels[MOTOR_TORQUE] / 0.5,
        }
        seen = Recording(name, made.time_s, channels)
        write_csv(seen, folder / f"{name}.csv", (MOTOR_SPEED, "motor_current_a"))
    (folder / "bench.toml").write_text(BENCH + "torque_constant_nm_per_a = {value = 0.5}\n")
    text = CONFIG.replace("load_angle_known = true\nmotor_angle_known = true\n", "")
    (folder / "config.toml").write_text(text)
    assert status(["run", str(folder / "config.toml")]) == 0
    summary = json.loads((folder / "out" / "summary.json").read_text())
    found = {e["name"]: e["parameters"] for e in summary["effects"]}
    assert set(found) == {"motor_coulomb_friction", "motor_viscous_friction"}
    coulomb = found["motor_coulomb_friction"]["torque_nm"]
    assert coulomb["median"] == pytest.approx(0.5, rel=0.05)
    assert any("where it starts is unknown" in note for note in summary["warnings"])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('method = "inverse"\n', "", "controller's gains"),
        ('use = "split"', "", "nothing held out"),
        ('use = "split"', 'use = "splat"', "one of"),
        ('file = "a.csv"', 'file = "absent.csv"', "There is no such file"),
        ("max_effects = 2", 'effects = ["motor_coulomb"]', 'Did you mean "motor_coulomb_friction"'),
        ("max_effects = 2", 'effects = ["backlash"]', "does not show in this comparison"),
        ('["load_inertia_kg_m2"]', '["load_inertia"]', 'Did you mean "load_inertia_kg_m2"'),
        ('["load_inertia_kg_m2"]', '["shaft_stiffness_nm_per_rad"]', "no part in this"),
        (
            '["load_inertia_kg_m2"]',
            '["load_inertia_kg_m2", "motor_inertia_kg_m2"]',
            "only the sum",
        ),
        ("[unknowns]", "[unknowns]\ngap_rad = [1e-4, 1e-3]", "has no gap"),
        ("[unknowns]", "[unknowns]\ngap_rad = [0.0, 1e-3]", "greater than 0"),
        ('method = "inverse"', 'method = "inverse"\ncutoff_hz = 120.0', "cut-off"),
        ('method = "inverse"', 'method = "inverse"\nchannels = ["motor_current_a"]', "no column"),
        ('method = "inverse"', 'method = "inverse"\nknown_torque = ["gravity_nm"]', "gravity_nm"),
        ('method = "inverse"', 'method = "inverse"\nknown_torque = ["speed"]', "ending in _nm"),
        (
            'method = "inverse"',
            'method = "free_motion"\nknown_torque = ["motor_torque_nm"]',
            "no torque but",
        ),
    ],
)
def test_what_cannot_be_diagnosed_is_refused_in_words(
    folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, words: str
) -> None:
    assert old in CONFIG
    (folder / "config.toml").write_text(CONFIG.replace(old, new))
    assert status(["diagnose", str(folder / "config.toml")]) == 2
    told = capsys.readouterr().err
    assert words in told
    assert "Traceback" not in told
    assert not (folder / "out").exists()


def test_speed_alone_says_what_it_cannot_tell(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for seed, name in enumerate("ab"):
        write_csv(recording(name, seed), folder / f"{name}.csv", (MOTOR_SPEED,))
    assert status(["run", str(folder / "config.toml")]) == 2
    told = capsys.readouterr().err
    assert "From motion alone" in told
    assert "friction" in told


def test_a_bench_of_two_masses_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from bayesbl.config.bench import reference_bench

    (folder / "bench.toml").write_text(dump_bench(reference_bench()))
    assert status(["run", str(folder / "config.toml")]) == 2
    assert "rigid bench" in capsys.readouterr().err


def test_a_bench_that_never_changes_flank_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A forward comparison of an axis without gravity at one speed: no gap shows."""
    from bayesbl.config.bench import reference_bench

    bench = reference_bench()
    for name in "ab":
        made = bench.simulate(7e-4, rotations=4.2, sampling_hz=500.0, name=name)
        write_csv(made, folder / f"{name}.csv", (MOTOR_SPEED, "motor_current_a"))
    (folder / "bench.toml").write_text(dump_bench(bench.with_parameters(gravity_torque_nm=0.0)))
    config = CONFIG.replace('method = "inverse"', 'method = "forward"')
    config = config.replace("load_angle_known = true\nmotor_angle_known = true\n", "")
    (folder / "config.toml").write_text(config)
    assert status(["check", str(folder / "config.toml")]) == 2
    assert "never changes from one tooth flank" in capsys.readouterr().err


def test_current_needs_a_torque_constant(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for seed, name in enumerate("ab"):
        made = recording(name, seed)
        channels = {**made.channels, "motor_current_a": made.channels[MOTOR_TORQUE]}
        seen = Recording(name, made.time_s, channels)
        write_csv(seen, folder / f"{name}.csv", (MOTOR_POSITION, "motor_current_a"))
    assert status(["run", str(folder / "config.toml")]) == 2
    assert "torque_constant_nm_per_a" in capsys.readouterr().err


def test_a_rigid_bench_may_leave_out_what_drives_it_but_is_not_simulated(folder: Path) -> None:
    bench = load_bench(folder / "bench.toml")
    again = folder / "again.toml"
    again.write_text(dump_bench(bench))
    assert "speed_gain" not in again.read_text()
    assert load_bench(again) == bench
    with pytest.raises(BenchError, match="has no drive"):
        bench.simulate(0.0)


def test_effects_prints_every_entry_and_one_in_full(capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["effects"]) == 0
    listed = capsys.readouterr().out
    assert all(effect.name in listed for effect in EFFECTS)
    for effect in EFFECTS:
        assert status(["effects", effect.name]) == 0
        told = capsys.readouterr().out
        for item in effect.parameters:
            assert item.name in told
        assert effect.equation.split()[0] in told
    assert status(["effects", "motor_ripple"]) == 2
    assert 'Did you mean "motor_torque_ripple"' in capsys.readouterr().err
