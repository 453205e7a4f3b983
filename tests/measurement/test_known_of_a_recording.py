"""What is known of a recording beside its bench file reaches both routes, or is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from places import CONFIGS, RECORDINGS

from bayesbl.bench.bench import BenchEffect, EffectParameterValue
from bayesbl.config.bench import load_bench
from bayesbl.config.loading import config_from_options
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.errors import ConfigError, UserError
from bayesbl.measurement.amplitude_route import AmplitudeMeasurer
from bayesbl.measurement.compatibility import bench_with
from bayesbl.measurement.measurement import Seeds, Task, recording_of
from bayesbl.measurement.routes import measurer_of
from bayesbl.results.work import WorkStore

BENCH = CONFIGS / "bench.toml"


def config_of(
    folder: Path, *, known: str = "{}", drift: str = "{}", estimator: str = f'bench = "{BENCH}"'
) -> SnapshotConfig:
    file = folder / "run.toml"
    file.write_text(
        f'schema = 1\nkind = "compare"\n[joint]\ndrift = {drift}\n'
        f'[[recordings]]\nname = "before"\nfile = "{RECORDINGS / "wear_before.csv"}"\n'
        f'[[recordings]]\nname = "after"\nfile = "{RECORDINGS / "wear_after.csv"}"\n'
        f"bench = {known}\n[estimator]\n{estimator}\n"
    )
    config = config_from_options("compare", (), file)
    assert isinstance(config, SnapshotConfig)
    return config


@pytest.mark.parametrize(
    ("known", "drift", "said"),
    [
        ("{load_inertia_kg_m2 = -3.0}", "{}", "bench of after, load_inertia_kg_m2"),
        ("{load_inertai = 3.0}", "{}", "no such parameter"),
        ("{gear_ratio = 60.0}", "{}", "cannot change"),
        ("{reference_speed_rpm = 1000.0}", "{}", "under [[recordings]]"),
        ("{}", "{load_inertai = 0.1}", "no such parameter"),
        ("{}", "{gear_ratio = 0.1}", "cannot change"),
    ],
)
@pytest.mark.parametrize("route", ["auto", "direct"])
def test_nonsense_is_refused_before_anything_is_measured(
    tmp_path: Path, known: str, drift: str, said: str, route: str
) -> None:
    estimator = f'bench = "{BENCH}"\nroute = "{route}"'
    with pytest.raises(UserError) as refused:
        measurer_of(config_of(tmp_path, known=known, drift=drift, estimator=estimator))
    assert said in str(refused.value)


def test_what_would_be_ignored_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError):
        config_of(tmp_path, known="{load_inertia_kg_m2 = 30.0}", estimator="")


@pytest.mark.parametrize("route", ["auto", "direct"])
def test_a_bench_of_another_gear_ratio_gives_no_gap_by_either_route(
    tmp_path: Path, route: str
) -> None:
    """Where the direct route refused the recording alone, the amplitude answered by that bench."""
    text = BENCH.read_text()
    assert "gear_ratio = {value = 120.0}" in text
    other = tmp_path / "other.toml"
    other.write_text(text.replace("gear_ratio = {value = 120.0}", "gear_ratio = {value = 120.3}"))
    config = config_of(tmp_path, estimator=f'bench = "{other}"\nroute = "{route}"')
    task = Task(
        config,
        tuple(recording_of(entry, config) for entry in config.recordings),
        Seeds.spawn(1, 2),
        work=WorkStore(tmp_path / "kept"),
    )
    with pytest.raises(ConfigError, match="120 turns of the motor"):
        measurer_of(config).measure(task)


@pytest.mark.long
def test_the_curve_of_a_recording_is_of_the_bench_as_it_was_then(tmp_path: Path) -> None:
    config = config_of(tmp_path, known="{speed_gain_nm_s_per_rad = 0.1665}")
    bench = load_bench(BENCH)
    task = Task(
        config,
        tuple(recording_of(entry, config) for entry in config.recordings),
        Seeds.spawn(1, 2),
        work=WorkStore(tmp_path / "kept"),
    )
    before, after = AmplitudeMeasurer(config, bench).curves(task)
    weaker = bench_with(bench, {"speed_gain_nm_s_per_rad": 0.1665})
    wholly, alike = AmplitudeMeasurer(config, weaker).curves(task)
    assert not np.allclose(before.coefficients, after.coefficients, rtol=1e-3, atol=0.0)
    assert np.array_equal(after.coefficients, alike.coefficients)
    assert np.array_equal(after.coefficients, wholly.coefficients)


def test_other_values_of_effects_keep_the_rest_of_the_bench() -> None:
    friction = {"torque_nm": EffectParameterValue(3.0)}
    bench = load_bench(BENCH).with_effects(BenchEffect("load_coulomb_friction", friction))
    changed = bench_with(bench, {"load_coulomb_friction.torque_nm": 5.0})
    assert changed.value("load_coulomb_friction.torque_nm") == 5.0
    assert changed.parameters == bench.parameters
