"""Laws of curves swept on demand: they read the true gap, are kept, and stay paired."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import CONFIGS

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.config.bench import load_bench
from bayesbl.config.loading import config_from_options
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.measurement.amplitude_route import AmplitudeMeasurer
from bayesbl.measurement.gap_by_curve import MeasuredRinging, gaps
from bayesbl.measurement.measurement import Seeds, Task
from bayesbl.recording.types import Recording
from bayesbl.results.work import WorkStore
from bayesbl.ringing.estimator import Estimator

pytestmark = pytest.mark.long

KNOWN, TOLERANCES = CONFIGS / "bench.toml", CONFIGS / "bench_tolerances.toml"


def recording(bench: Bench, gap_rad: float, name: str, **options: Any) -> Recording:
    return bench.simulate(gap_rad, rotations=3.0, start_angle_rad=1.0, name=name, **options)


def written(recordings: list[Recording], folder: Path) -> list[Path]:
    files = []
    for made in recordings:
        table = np.column_stack([made.time_s, made.motor_speed_rpm])
        files.append(folder / f"{made.name}.csv")
        np.savetxt(files[-1], table, "%.10g", ",", header="time_s,motor_speed_rpm", comments="")
    return files


def task_of(recordings: list[Recording], folder: Path, bench: Path, store: WorkStore) -> Task:
    files = written(recordings, folder)
    tables = folder / "speeds.toml"
    entries = "".join(
        f'[[recordings]]\nname = "{made.name}"\nfile = "{file}"\n'
        f"reference_speed_rpm = {round(float(made.motor_speed_rpm.mean()), -2)}\n"
        for made, file in zip(recordings, files, strict=True)
    )
    tables.write_text(
        f'schema = 1\nkind = "compare"\n[run]\nworkers = 1\n[estimator]\nbench = "{bench}"\n'
        f"{entries}"
    )
    config = config_from_options("compare", (), tables)
    assert isinstance(config, SnapshotConfig)
    return Task(config, tuple(recordings), Seeds.spawn(1, len(recordings)), work=store)


def ringing(made: Recording) -> MeasuredRinging:
    """What a fit says of it, as if it were all but free of noise."""
    centre, _ = Estimator().estimate(made, np.random.SeedSequence(1)).ringing
    draws = centre[0] + 1e-3 * np.random.default_rng(1).standard_normal((2, 500))
    return MeasuredRinging(draws, centre, np.diag([1e-6, 1e-6, 1e-6]))


def test_each_speed_and_rate_has_a_curve_of_its_own_that_reads_the_true_gap(tmp_path: Path) -> None:
    bench = load_bench(KNOWN)
    recordings = [
        recording(bench, 8e-4, "slow", reference_speed_rpm=1500.0, sampling_hz=500.0),
        recording(bench, 8e-4, "fast", reference_speed_rpm=-2400.0, sampling_hz=1000.0),
    ]
    task = task_of(recordings, tmp_path, KNOWN, WorkStore(tmp_path / "kept"))
    curves = AmplitudeMeasurer(task.config, bench).curves(task)
    assert [curve.reference_speed_rpm for curve in curves] == [1500.0, 2400.0]
    for found in gaps(curves, [ringing(made) for made in recordings], task.seeds.gap):
        # The design's bound on a curve's error, 0.03 %, beside the start angle's scatter of A.
        assert float(np.median(found.delta_rad)) == pytest.approx(8e-4, rel=2e-3)


def test_what_was_swept_is_read_the_next_time_and_the_store_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, store = load_bench(KNOWN), WorkStore(tmp_path / "kept")
    made = recording(bench, 8e-4, "one", sampling_hz=250.0)
    task = task_of([made, replace(made, name="two")], tmp_path, KNOWN, store)
    first, again = AmplitudeMeasurer(task.config, bench).curves(task)
    assert first is again, "one need, one curve"

    def never(*_: object) -> None:
        raise AssertionError("swept again")

    monkeypatch.setattr("bayesbl.measurement.curves.sweep_nominal", never)
    read, _ = AmplitudeMeasurer(task.config, bench).curves(task)
    assert np.array_equal(read.coefficients, first.coefficients)
    monkeypatch.setattr("bayesbl.measurement.curves.LARGEST_STORE_BYTES", 0)
    AmplitudeMeasurer(task.config, bench).curves(task)
    assert store.folder is not None
    assert [*store.folder.iterdir()] == []


def test_an_unknown_bench_cancels_in_the_change_between_two_speeds(tmp_path: Path) -> None:
    believed = load_bench(TOLERANCES)
    true = believed.draw(np.random.default_rng(4))
    recordings = [
        recording(true, 8e-4, "slow", reference_speed_rpm=1800.0, sampling_hz=250.0),
        recording(true, 8e-4, "fast", reference_speed_rpm=2200.0, sampling_hz=250.0),
    ]
    task = task_of(recordings, tmp_path, TOLERANCES, WorkStore(tmp_path / "kept"))
    curves = AmplitudeMeasurer(task.config, believed).curves(task)
    seen = [ringing(made) for made in recordings]
    paired = [np.log(found.delta_rad) for found in gaps(curves, seen, task.seeds.gap)]
    apart = [
        np.log(gaps(curve, [one], seed)[0].delta_rad)
        for curve, one, seed in zip(curves, seen, task.seeds.gap.spawn(2), strict=True)
    ]
    together = float(np.std(paired[1] - paired[0]))
    alone = math.hypot(*(float(np.std(draws)) for draws in apart))
    assert together < 0.5 * alone
    assert abs(float(np.mean(paired[1] - paired[0]))) < 4.0 * together


def test_a_bench_does_not_keep_the_snapshots_from_being_compared(tmp_path: Path) -> None:
    bench = load_bench(KNOWN)
    friction = BenchEffect("motor_coulomb_friction", {"torque_nm": EffectParameterValue(0.3)})
    recordings = [
        recording(bench, 8e-4, "warm", seed=np.random.default_rng(1)),
        recording(bench, 8e-4, "still warm", seed=np.random.default_rng(2)),
        recording(bench.with_effects(friction), 8e-4, "cold", seed=np.random.default_rng(3)),
    ]
    store = WorkStore(tmp_path / "kept")
    alike = task_of(recordings[:2], tmp_path, KNOWN, store)
    assert AmplitudeMeasurer(alike.config).measure(alike).same_joint["agrees"]
    other = task_of(recordings[::2], tmp_path, KNOWN, store)
    found = AmplitudeMeasurer(other.config).measure(other)
    assert found.same_joint["could_be"][0] == "motor_coulomb_friction"
    assert found.change_reason is not None


def test_what_is_stated_of_one_snapshot_is_no_change_of_the_joint(tmp_path: Path) -> None:
    bench = load_bench(KNOWN)
    gain = 0.85 * bench.value("speed_gain_nm_s_per_rad")
    recordings = [
        recording(bench, 8e-4, "before", seed=np.random.default_rng(1)),
        recording(
            bench.with_parameters(speed_gain_nm_s_per_rad=gain),
            8e-4,
            "softer",
            seed=np.random.default_rng(2),
        ),
    ]
    task = task_of(recordings, tmp_path, KNOWN, WorkStore(tmp_path / "kept"))
    first, softer = task.config.recordings
    known = softer.model_copy(update={"bench": {"speed_gain_nm_s_per_rad": gain}})
    config = task.config.model_copy(update={"recordings": [first, known]})
    found = AmplitudeMeasurer(config).measure(replace(task, config=config))
    assert found.change_reason is None
    for snapshot in found.answers:
        # Of two intervals of 99 % one misses the truth in 2 of 100 seeds; this one is fixed.
        low, high = np.quantile(snapshot.delta_rad, [0.005, 0.995])
        assert low < 8e-4 < high
