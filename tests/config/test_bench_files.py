"""Bench and simulate files: what they hold, what they refuse, what they write."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from places import CONFIGS

import bayesbl.bench
from bayesbl.bench.parameters import BENCH_PARAMETERS
from bayesbl.config.bench import REFERENCE_BENCH, dump_bench, load_bench, reference_bench
from bayesbl.errors import ConfigError, ResultError, UserError
from bayesbl.noise.process import NoiseModel
from bayesbl.runs.kinds import check
from bayesbl.runs.simulate import run_simulate

SHIPPED = CONFIGS / "bench.toml"

SIMULATE = """
schema = 1
kind = "simulate"
bench = "bench.toml"
truth_file = "truth.json"
[run]
seed = 3
[[recordings]]
name = "forward"
file = "forward.csv"
gap_rad = 8e-4
rotations = 0.5
[[recordings]]
name = "reverse"
file = "sub/reverse.csv"
gap_rad = 8e-4
rotations = 0.5
reference_speed_rpm = -1500
start_angle_rad = 0.5
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "bench.toml").write_bytes(SHIPPED.read_bytes())
    (tmp_path / "simulate.toml").write_text(SIMULATE)
    return tmp_path


def bench_file(tmp_path: Path, old: str, new: str) -> Path:
    """The shipped bench file with one thing changed."""
    text = SHIPPED.read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "changed.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return path


def test_package_ships_the_same_reference_bench() -> None:
    package = Path(bayesbl.bench.__file__).parent / REFERENCE_BENCH
    assert package.read_bytes() == SHIPPED.read_bytes()
    assert reference_bench() == load_bench(SHIPPED)


def test_shipped_bench_explains_every_parameter_without_a_default() -> None:
    lines = SHIPPED.read_text(encoding="utf-8").splitlines()
    given = {line.partition(" ")[0]: line for line in lines}
    for info in BENCH_PARAMETERS:
        if info.default is not None and info.name not in given:
            continue
        line = given[info.name]
        _, _, comment = line.partition("#")
        assert info.unit in comment
        assert len(comment) > 5


def test_a_dumped_bench_loads_back_equal(tmp_path: Path) -> None:
    effects = '[[effects]]\nname = "load_coulomb_friction"\n'
    effects += "parameters = {torque_nm = {value = 15.0, sd = 0.4}}\n"
    changed = bench_file(tmp_path, "[measurement]", effects + "\n[measurement]")
    bench = load_bench(changed)
    assert bench.value("load_coulomb_friction.torque_nm") == 15.0
    again = tmp_path / "again.toml"
    again.write_text(dump_bench(bench), encoding="utf-8")
    assert load_bench(again) == bench
    assert load_bench(again).fingerprint() == bench.fingerprint()


def test_a_speed_filter_is_the_effect_that_averages(tmp_path: Path) -> None:
    stated = "[measurement]\nspeed_filter_s = 0.004"
    bench = load_bench(bench_file(tmp_path, "[measurement]", stated))
    assert bench.value("speed_averaging.time_s") == 0.004
    again = tmp_path / "again.toml"
    again.write_text(dump_bench(bench), encoding="utf-8")
    assert load_bench(again) == bench


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ('speed_filter_s = 0.001\nspeed_source = "encoder"', "averaged over a sampling period"),
        ("speed_filter_s = 0.5", "speed_filter_s"),
        (
            "speed_filter_s = 0.001\n[[effects]]\nname = 'speed_averaging'\n"
            "parameters = {time_s = {value = 0.001}}",
            "stated twice",
        ),
    ],
)
def test_an_average_is_stated_once_and_in_range(tmp_path: Path, more: str, said: str) -> None:
    parameters, _, _ = SHIPPED.read_text(encoding="utf-8").partition("[measurement]")
    stated = tmp_path / "stated.toml"
    stated.write_text(f"{parameters}[measurement]\nencoder_counts = 16384\n{more}\n", "utf-8")
    with pytest.raises(ConfigError, match=said):
        load_bench(stated)


def test_noise_with_outliers_can_be_asked_for(tmp_path: Path) -> None:
    old = 'kind = "ar", sd_rpm = 1.5'
    new = 'kind = "student_t", degrees_of_freedom = 3.0, sd_rpm = 1.5'
    bench = load_bench(bench_file(tmp_path, old, new))
    assert bench.measurement.speed_noise == NoiseModel(1.5, (0.6,), 3.0)
    again = tmp_path / "again.toml"
    again.write_text(dump_bench(bench), encoding="utf-8")
    assert load_bench(again) == bench


def test_tolerances_are_relative_or_absolute(tmp_path: Path) -> None:
    for entry, expected in (
        ("{value = 20.0, relative_tolerance = 0.05}", 1.0),
        ("{value = 20.0, tolerance = 0.3}", 0.3),
    ):
        bench = load_bench(
            bench_file(
                tmp_path, "load_inertia_kg_m2 = {value = 20.0}", f"load_inertia_kg_m2 = {entry}"
            )
        )
        assert bench.tolerances == pytest.approx({"load_inertia_kg_m2": expected})


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("gear_ratio = {", "gear_rati = {", ["gear_rati", 'Did you mean "gear_ratio"?']),
        ("gear_ratio = {value = 120.0}", "", ["gear_ratio", "needs this parameter"]),
        ("gravity_torque_nm = ", "# ", ["gravity_torque_nm", "0 for a vertical axis"]),
        (
            "gear_ratio = {value = 120.0}",
            "gear_ratio = 120.0",
            ["a table, such as {value = 120.0}"],
        ),
        ("value = 120.0", "value = -120.0", ["gear_ratio", "-120", "above zero"]),
        ("value = 120.0", "value = nan", ["gear_ratio"]),
        ("value = 120.0}", "valu = 120.0}", ["valu", "line"]),
        ('drive = "two_mass"', 'drive = "twomass"', ["drive", "two_mass"]),
        ('kind = "ar", ', 'kind = "white", ', ["speed_noise", "oefficients"]),
        ('kind = "ar", ', 'kind = "student_t", ', ["speed_noise", "Degrees of freedom"]),
        ("coefficients = [0.6]", "coefficients = [1.1]", ["grows without bound"]),
        ("encoder_counts = 16384", "encoder_count = 16384", ["encoder_count", "encoder_counts"]),
        (
            "[measurement]",
            '[[effects]]\nname = "load_friction"\nparameters = {}\n[measurement]',
            ["load_friction", "no such effect"],
        ),
        (
            "[measurement]",
            '[[effects]]\nname = "backlash"\nparameters = {gap = {value = 1e-3}}\n[measurement]',
            ["gap", "gap_rad"],
        ),
        (
            "{value = 20.0}",
            "{value = 20.0, tolerance = 1.0, relative_tolerance = 0.1}",
            ["load_inertia_kg_m2", "one tolerance"],
        ),
        (
            "{value = 20.0}",
            '{value = 20.0, tolerance = "12.5 %"}',
            ["load_inertia_kg_m2", "relative_tolerance = 0.125"],
        ),
        ("schema = 1", "schema = ", ["TOML"]),
    ],
)
def test_a_wrong_bench_file_is_refused_with_file_and_field(
    tmp_path: Path, old: str, new: str, expected: list[str]
) -> None:
    path = bench_file(tmp_path, old, new)
    with pytest.raises(ConfigError) as caught:
        load_bench(path)
    for part in (str(path), *expected):
        assert part in str(caught.value)


def test_simulate_writes_recordings_and_the_truth(folder: Path) -> None:
    written = run_simulate(folder / "simulate.toml", folder / "out")
    assert [path.relative_to(folder / "out").as_posix() for path in written] == [
        "forward.csv",
        "sub/reverse.csv",
        "truth.json",
    ]
    header, *rows = written[0].read_text().splitlines()
    assert header == "time_s,motor_position_rad,motor_speed_rpm,motor_current_a"
    assert len(rows) == 1801
    truth = json.loads(written[2].read_text())
    for entry, path in zip(truth["recordings"], written[:2], strict=True):
        assert entry["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
        assert entry["gap_rad"] == 8e-4
    assert truth["recordings"][1]["start_angle_rad"] == 0.5
    assert truth["recordings"][1]["reference_speed_rpm"] == -1500
    reverse = np.loadtxt(written[1], delimiter=",", skiprows=1)
    assert reverse[:, 2].mean() == pytest.approx(-1500, abs=10)
    assert not list(folder.rglob("*.partial"))


def test_simulate_repeats_with_the_seed_and_any_number_of_workers(folder: Path) -> None:
    runs = [
        run_simulate(folder / "simulate.toml", folder / name, seed, workers)
        for name, seed, workers in (("a", None, 1), ("b", 3, 4), ("c", 4, 1))
    ]
    first, same, other = ([path.read_bytes() for path in run] for run in runs)
    assert first == same
    assert first[0] != other[0]


def test_simulate_writes_beside_its_file_and_never_over_another(folder: Path) -> None:
    written = run_simulate(folder / "simulate.toml")
    assert written[0] == folder / "forward.csv"
    before = written[0].read_bytes()
    with pytest.raises(ResultError, match="exists already"):
        run_simulate(folder / "simulate.toml", seed=9)
    assert written[0].read_bytes() == before
    run_simulate(folder / "simulate.toml", seed=9, force=True)
    assert written[0].read_bytes() != before


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("rotations = 0.5", "rotations = 1e-9", "two samples"),
        ('"forward.csv"', '"simulate.toml/a.csv"', "file where"),
        ('"forward.csv"', '"deep"', "not a file"),
    ],
)
def test_a_check_refuses_what_the_simulation_refuses(folder: Path, old, new, told) -> None:
    (folder / "deep").mkdir()
    path = folder / "simulate.toml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    assert [told in str(problem) for problem in check(path).problems] == [True]
    with pytest.raises(UserError, match=told):
        run_simulate(path, force=True)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "gap_rad = 8e-4\nrotations",
            "gap_rad = 4\nrotations",
            ["[[recordings]] 1", "equal to 3.14"],
        ),
        ('bench = "bench.toml"', 'bench = "benches.toml"', ["benches.toml", "no such file"]),
        ('file = "sub/reverse.csv"', 'file = "forward.csv"', ["same file"]),
        ("rotations = 0.5", "rotation = 0.5", ["rotation", "rotations"]),
        ('kind = "simulate"', 'kind = "sweep"', ["kind"]),
    ],
)
def test_a_wrong_simulate_file_is_refused(
    folder: Path, old: str, new: str, expected: list[str]
) -> None:
    path = folder / "simulate.toml"
    path.write_text(SIMULATE.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        run_simulate(path)
    for part in (str(path), *expected):
        assert part in str(caught.value)
    assert not list(folder.rglob("*.csv"))
