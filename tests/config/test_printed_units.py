"""Numbers as data sheets print them mean the same as in the bench's own units."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from bayesbl.bench.bench import Bench
from bayesbl.bench.parameters import PARAMETER_INFO
from bayesbl.config.bench import CONVERSIONS, load_bench, reduced_inertia_kg_m2, reference_bench
from bayesbl.errors import ConfigError
from bayesbl.runs.first_configuration import write_first_bench

HEAD = 'schema = 1\nkind = "bench"\n[parameters]\n'


def with_entry(folder: Path, name: str, entry: str) -> Bench:
    """The reference bench with one entry as a user writes it."""
    lines = [
        f"{other} = {entry if other == name else {'value': p.value}}".replace("'value':", "value =")
        for other, p in reference_bench().parameters.items()
    ]
    path = folder / "bench.toml"
    path.write_text(HEAD + "\n".join(lines))
    return load_bench(path)


@pytest.mark.parametrize(
    ("name", "entry"),
    [
        ("motor_inertia_kg_m2", '{value = 12.1, unit = "kg cm²"}'),
        ("load_inertia_kg_m2", '{value = 2e7, unit = "kg mm^2"}'),
        ("shaft_stiffness_nm_per_rad", '{value = 34.90658503988659, unit = "Nm/arcmin"}'),
        ("shaft_stiffness_nm_per_rad", '{value = 0.028647889756541160, unit = "arcmin/(N m)"}'),
        ("torque_constant_nm_per_a", '{value = 500, unit = "mN m/A"}'),
        ("speed_gain_nm_s_per_rad", '{value = 0.37, unit = "A s/rad"}'),
        ("integral_gain_nm_per_rad", '{value = 23.125, unit = "ms"}'),
        ("reference_speed_rpm", '{value = 209.43951023931953, unit = "rad/s"}'),
    ],
)
def test_the_same_quantity_in_another_unit_is_the_same_bench(
    tmp_path: Path, name: str, entry: str
) -> None:
    found = with_entry(tmp_path, name, entry)
    assert found.value(name) == pytest.approx(reference_bench().value(name), rel=1e-9)


def test_a_damping_ratio_is_that_of_the_two_masses_on_the_shaft(tmp_path: Path) -> None:
    found = with_entry(
        tmp_path, "shaft_damping_nm_s_per_rad", '{value = 0.1, unit = "damping ratio"}'
    )
    values = {name: parameter.value for name, parameter in found.parameters.items()}
    inertia, stiffness = reduced_inertia_kg_m2(values), values["shaft_stiffness_nm_per_rad"]
    ratio = found.value("shaft_damping_nm_s_per_rad") / (2.0 * math.sqrt(stiffness * inertia))
    assert ratio == pytest.approx(0.1)


def test_a_tolerance_is_in_the_unit_of_its_value(tmp_path: Path) -> None:
    entry = '{value = 12.1, tolerance = 1.21, unit = "kg cm2"}'
    found = with_entry(tmp_path, "motor_inertia_kg_m2", entry)
    assert found.tolerances["motor_inertia_kg_m2"] == pytest.approx(1.21e-4)


def test_an_unknown_unit_is_refused_with_those_known(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"motor_inertia_kg_m2.*kg cm2"):
        with_entry(tmp_path, "motor_inertia_kg_m2", '{value = 12.1, unit = "lb in2"}')


def test_a_conversion_says_which_parameter_it_lacks(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    path.write_text(HEAD + 'integral_gain_nm_per_rad = {value = 20.0, unit = "ms"}')
    with pytest.raises(ConfigError, match="speed_gain_nm_s_per_rad"):
        load_bench(path)


def test_every_unit_s_own_name_comes_first() -> None:
    for name, units in CONVERSIONS.items():
        own = PARAMETER_INFO[name].unit.replace("²", "2")
        assert next(iter(units)) == own


ENTRY = re.compile(r"# (\[|\w+ = (\{|\"|[-\d.e]+$))")


def test_the_file_to_fill_in_explains_every_parameter_that_a_bench_needs(tmp_path: Path) -> None:
    path = write_first_bench(tmp_path / "axis.toml")
    text = path.read_text()
    assert "bayesbl check axis.toml" in text
    filled = "".join(
        line.removeprefix("# ") if ENTRY.match(line) else line
        for line in text.splitlines(keepends=True)
    )
    path.write_text(filled)
    bench = load_bench(path)  # which refuses one that lacks a parameter
    assert bench.tolerances
    assert bench.value("sampled_control.period_s") == 250e-6
    assert bench.value("speed_averaging.time_s") == 4e-3


def test_a_file_that_nobody_filled_in_is_refused(tmp_path: Path) -> None:
    path = write_first_bench(tmp_path / "joint.toml")
    with pytest.raises(ConfigError, match="needs this parameter"):
        load_bench(path)
