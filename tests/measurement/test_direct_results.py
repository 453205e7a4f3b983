"""The direct route from the command line: what it answers, refuses, stores, draws and prints."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from places import CONFIGS
from quick import two_ensembles

from bayesbl import cli
from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.config.bench import load_bench
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED
from bayesbl.results.store import read_tree

pytestmark = pytest.mark.long

KNOWN, TOLERANCES = CONFIGS / "bench.toml", CONFIGS / "bench_tolerances.toml"
OFFSET = """
[[effects]]
name = "load_torque_offset"
parameters = {torque_nm = {value = -15.0, sd = 0.4}}
"""


def written(folder: Path, on: Bench, gap_rad: float, seed: int, name: str, current=True) -> Path:
    """A recording of three rotations at 250 Hz as a file."""
    generator = np.random.default_rng(seed)
    found = on.simulate(
        gap_rad, rotations=3.0, sampling_hz=250.0, start_angle_rad=1.0 + seed, seed=generator
    )
    channels = [MOTOR_SPEED, *([MOTOR_CURRENT] if current else [])]
    table = np.column_stack([found.time_s, *(found.channels[c] for c in channels)])
    header = ",".join(["time_s", *channels])
    file = folder / f"{name}.csv"
    np.savetxt(file, table, "%.10g", ",", header=header, comments="")
    return file


def run(*arguments: object) -> int:
    return cli.status([str(a) for a in arguments])


def summary(folder: Path) -> dict:
    return json.loads((folder / "summary.json").read_text())


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("direct")


@pytest.fixture(scope="module")
def fit(folder) -> Path:
    """A fit with everything, figures included."""
    file = written(folder, load_bench(KNOWN), 8e-4, 1, "one")
    options = ["--bench", KNOWN, "--limit-rad", 1e-3]
    options += ["--config", two_ensembles(folder, "fit")]
    assert run("fit", file, *options, "--out", folder / "fit") == 0
    return folder / "fit"


@pytest.fixture(scope="module")
def compared(folder) -> Path:
    """Two snapshots, the second without current, on a bench known within its tolerances."""
    known = load_bench(TOLERANCES)
    true = known.draw(np.random.default_rng(1))
    files = [
        written(folder, true, 8e-4, 2, "before"),
        written(folder, true, 9e-4, 3, "after", current=False),
    ]
    options = ["--route", "direct", "--bench", TOLERANCES, "--out", folder / "compare"]
    assert run("compare", *files, *options, "--config", two_ensembles(folder, "compare")) == 0
    return folder / "compare"


def test_a_fit_answers_with_the_keys_of_the_contract(fit):
    found = summary(fit)
    delta = found["delta_rad"]
    # Fails by chance in 1 of 10 000: four standard deviations on either side.
    assert abs(delta["median"] - 8e-4) < 4.0 * found["posterior_sd"]["delta_rad"]
    friction = {f"{side}_viscous_friction__coefficient_nm_s_per_rad" for side in ("motor", "load")}
    assert {"start_angle_rad", *friction} == set(found["parameters"])
    assert set(found["budget"]) == {"noise", "laws_and_drift", "bench"}
    assert sum(found["budget"].values()) == pytest.approx(1.0)
    assert found["noise"]["kind"] == "ar"
    assert found["noise"]["sd_a"] == pytest.approx(0.05, rel=0.1)
    assert found["diagnostics"]["outcome"] == "converged"
    assert found["probability_above_limit"] == 0.0
    assert found["excluded_samples"] == 0
    # Flat prior: without laws that the bench may lack as wide as the bound, and as much wider as
    # few rotations leave open of their scatter; the sd of 1000 draws scatters by 2.3 %.
    ratio = found["posterior_sd"]["delta_rad"] / found["cramer_rao_sd"]["delta_rad"]
    assert 0.9 < ratio * math.sqrt(found["budget"]["noise"]) < 1.3


def test_a_fit_shows_the_amplitude_route_beside_it(fit):
    found = summary(fit)
    assert found["route"] == "direct"
    assert found["routes"]["direct"]["delta_rad"] == found["delta_rad"]
    beside = found["routes"]["amplitude"]
    assert beside["curve"] == str(KNOWN)
    assert beside["amplitude_rpm"] == found["amplitude_rpm"]
    width = beside["delta_rad"]["high"] - beside["delta_rad"]["low"]
    assert width > 3.0 * (found["delta_rad"]["high"] - found["delta_rad"]["low"])


def test_the_model_check_compares_what_can_be_named_with_what_the_bench_does(fit):
    check = summary(fit)["routes"]["amplitude"]["model_check"]
    items = {item["quantity"]: item for item in check["items"]}
    assert check["agrees"]
    bench = load_bench(KNOWN)
    torque_constant = bench.value("torque_constant_nm_per_a")
    for quantity, gain in (
        ("proportional gain", "speed_gain_nm_s_per_rad"),
        ("integral gain", "integral_gain_nm_per_rad"),
    ):
        assert items[quantity]["expected"] == pytest.approx(
            bench.value(gain) / torque_constant, rel=0.01
        )
    named = ["proportional gain", "integral gain", "mean current", "current at load order 1"]
    named += ["speed at load order 1", "ringing frequency", "ringing decay"]
    # One of seven beyond four standard deviations: by chance in 4 of 10 000.
    assert all(abs(items[quantity]["z"]) < 4.0 for quantity in named)


def test_a_fit_is_stored_whole_and_can_be_drawn_again(fit):
    tree = read_tree(fit)
    posterior = tree["direct/posterior"].to_dataset()
    assert posterior["delta_rad"].dims == ("chain", "draw")
    residual = tree["direct/predictive"]["residual_motor_current_a"].values
    simulated = tree["direct/predictive"]["simulated_motor_current_a"].values
    assert np.allclose(simulated + residual, tree["direct/observed_data"][MOTOR_CURRENT].values)
    for node in tree.subtree:
        for name, variable in node.to_dataset(inherit=False).data_vars.items():
            assert {"units", "long_name"} <= set(variable.attrs), (node.path, name)
    assert {p.stem for p in (fit / "figures").glob("*.png")} == {
        "signal",
        "simulation",
        "gap",
        "amplitude_to_gap",
        "corner",
    }
    assert run("figures", fit) == 0


def test_inspect_shows_the_bound_and_the_predictive_check(fit, capsys):
    assert run("inspect", fit) == 0
    text = capsys.readouterr().out
    for told in ("Cramér-Rao", "Repeating", "mean", KNOWN.name, "effective draws by"):
        assert told in text


def test_snapshots_without_current_work_and_say_so(compared):
    found = summary(compared)
    before, after = found["snapshots"]
    assert before["noise"]["sd_a"] is not None
    assert after["noise"]["sd_a"] is None
    assert not any(r["code"] == "no_current" for r in before["diagnostics"]["reasons"])
    assert any(r["code"] == "no_current" for r in after["diagnostics"]["reasons"])
    assert {e["channel"] for e in after["predictive_check"]} == {MOTOR_SPEED}


def test_snapshots_share_their_bench_and_the_change_is_the_difference(compared):
    found, tree = summary(compared), read_tree(compared)
    first, last = found["snapshots"]
    shared = set(load_bench(TOLERANCES).tolerances)
    assert shared <= set(first["parameters"])
    assert all(first["parameters"][n] == last["parameters"][n] for n in shared)
    delta = tree["gap"]["delta_rad"].values
    assert np.allclose(tree["change"]["change_rad"].values, delta[1] - delta[0])
    assert 0.0 < first["budget"]["bench"] < 1.0
    # Fails by chance in 2 of 1000.
    low, high = np.quantile(tree["change"]["change_rad"].values, [0.001, 0.999])
    assert low < 1e-4 < high


def test_where_something_shakes_the_joint_the_amplitude_answers_and_says_why(
    folder, no_figures, capsys
):
    file = written(folder, load_bench(KNOWN), 8e-4, 6, "shaken")
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    table[:, 1] += 3.0 * np.sin(2.0 * np.pi * 9.7 * table[:, 0] + 0.3)
    np.savetxt(
        file, table, "%.10g", ",", header="time_s,motor_speed_rpm,motor_current_a", comments=""
    )
    options = ["--bench", KNOWN, "--config", two_ensembles(folder, "fit")]
    assert run("fit", file, *options, "--out", folder / "shaken") == 0
    found = summary(folder / "shaken")
    assert found["route"] == "amplitude"
    assert found["routes"]["direct"]["delta_rad"] is None
    shaking = r"at 9\.(69|7)\d* Hz"
    assert re.search(shaking, found["routes"]["direct"]["reason"]["text"])
    # Fails by chance in 1 of 10 000: four standard deviations on either side.
    width = found["delta_rad"]["high"] - found["delta_rad"]["low"]
    assert abs(found["delta_rad"]["median"] - 8e-4) < 4.0 * width / 3.29
    assert re.search(shaking, capsys.readouterr().out)


def test_an_effect_that_the_bench_lacks_is_named_and_part_of_the_answer(folder, no_figures, capsys):
    effect = BenchEffect("load_torque_offset", {"torque_nm": EffectParameterValue(-15.0)})
    file = written(folder, load_bench(KNOWN).with_effects(effect), 8e-4, 4, "offset")
    options = ["--route", "direct", "--config", two_ensembles(folder, "fit")]
    lacking = ["--bench", KNOWN, "--out", folder / "lacking"]
    assert run("fit", file, *options, *lacking) == 0
    found = summary(folder / "lacking")
    # Fails by chance in 1 of 10 000.
    assert abs(found["delta_rad"]["median"] - 8e-4) < 4.0 * found["posterior_sd"]["delta_rad"]
    assert found["diagnostics"]["outcome"] == "usable"
    (told,) = (r for r in found["diagnostics"]["reasons"] if r["code"] == "bench_lacks")
    assert "load_torque_offset.torque_nm" in told["text"]
    assert "bayesbl diagnose" in told["text"]
    assert "load_torque_offset.torque_nm" in capsys.readouterr().out

    completed = folder / "completed.toml"
    completed.write_text(KNOWN.read_text() + OFFSET)
    answered = ["--bench", completed, "--out", folder / "answered"]
    assert run("fit", file, *options, *answered) == 0
    found = summary(folder / "answered")
    sd = found["posterior_sd"]["delta_rad"]
    # Fails by chance in 1 of 10 000.
    assert abs(found["delta_rad"]["median"] - 8e-4) < 4.0 * sd
    torque = found["parameters"]["load_torque_offset__torque_nm"]
    assert -16.0 < torque["low"] < torque["high"] < -14.0
    assert "bench_lacks" not in {r["code"] for r in found["diagnostics"]["reasons"]}


def test_friction_that_the_bench_lacks_is_part_of_the_answer(folder, no_figures):
    effect = BenchEffect("load_coulomb_friction", {"torque_nm": EffectParameterValue(15.0)})
    file = written(folder, load_bench(KNOWN).with_effects(effect), 8e-4, 4, "friction")
    options = ["--route", "direct", "--config", two_ensembles(folder, "fit"), "--bench", KNOWN]
    assert run("fit", file, *options, "--out", folder / "friction") == 0
    found = summary(folder / "friction")
    # Fails by chance in 1 of 10 000.
    assert abs(found["delta_rad"]["median"] - 8e-4) < 4.0 * found["posterior_sd"]["delta_rad"]


def test_what_changed_in_one_recording_is_no_parameter_of_the_other(folder, no_figures, capsys):
    known = load_bench(KNOWN)
    filtered = BenchEffect("speed_averaging", {"time_s": EffectParameterValue(0.008)})
    files = [
        written(folder, known, 8e-4, 5, "plain"),
        written(folder, known.with_effects(filtered), 8e-4, 6, "filtered"),
    ]
    options = ["--route", "direct", "--bench", KNOWN, "--config", two_ensembles(folder, "compare")]
    run("compare", *files, *options, "--out", folder / "filtered")
    plain, other = summary(folder / "filtered")["snapshots"]
    assert "drift__speed_averaging__time_s" in other["parameters"]
    for snapshot in (plain, other):
        # Fails by chance in 1 of 10 000.
        off = snapshot["delta_rad"]["median"] - 8e-4
        assert abs(off) < 4.0 * snapshot["posterior_sd"]["delta_rad"]
    friction = {f"{side}_viscous_friction__coefficient_nm_s_per_rad" for side in ("motor", "load")}
    assert set(plain["optimum"]) == {"delta_rad", "start_angle_rad"} | friction
    assert set(plain["optimum"]) == set(plain["posterior_sd"]) == set(plain["cramer_rao_sd"])
    capsys.readouterr()
    assert run("inspect", folder / "filtered") == 0
    assert "nan" not in capsys.readouterr().out


def test_a_bench_that_does_not_fit_is_refused(folder, capsys):
    other, told = folder / "other.toml", "A rigid bench has no gap"
    other.write_text(KNOWN.read_text().replace('drive = "two_mass"', 'drive = "rigid"'))
    file = written(folder, load_bench(KNOWN), 8e-4, 5, "plain")
    options = ["--route", "direct", "--bench", other, "--out", folder / "none"]
    assert run("fit", file, *options) == cli.WRONG
    assert told in capsys.readouterr().err
    assert not (folder / "none").exists()
