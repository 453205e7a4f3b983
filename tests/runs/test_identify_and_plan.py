"""From files to a summary: small runs of the kinds whose other tests are long or none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from places import CONFIGS
from recording_files import write_csv

from bayesbl.cli import status
from bayesbl.config.bench import load_bench

BENCH = CONFIGS / "bench.toml"
GAP_RAD = 8e-4


def answered(folder: Path, *arguments: object) -> dict:
    out = folder / "out"
    assert status([*map(str, arguments), "--out", str(out), "--workers", "1"]) == 0
    return json.loads((out / "summary.json").read_text())


def test_identify_finds_an_inertia_and_the_gap(tmp_path: Path) -> None:
    """Within 4 standard deviations each."""
    bench, inertia = load_bench(BENCH), "load_inertia_kg_m2"
    seed, start_rad = np.random.default_rng(7), 0.4
    made = bench.simulate(
        GAP_RAD, rotations=2.2, sampling_hz=250.0, start_angle_rad=start_rad, seed=seed
    )
    file = write_csv(tmp_path / "a.csv", {"time_s": made.time_s, **made.channels})
    stated, sheet = f"{inertia} = {{value = 20.0", tmp_path / "sheet.toml"
    text = BENCH.read_text()
    assert stated in text
    sheet.write_text(text.replace(stated, f"{inertia} = {{value = 20.5, relative_tolerance = 0.1"))
    found = answered(tmp_path, "identify", file, "--bench", sheet)
    assert found["outcome"] in ("converged", "usable")
    assert set(found["parameters"]) == {inertia}
    value = found["parameters"][inertia]["posterior"]
    gap = found["gaps"]["a"]
    for one, true in ((value, bench.value(inertia)), (gap, GAP_RAD)):
        assert abs(one["median"] - true) < 4.0 * (one["high"] - one["low"]) / 3.29


def test_plan_ranks_motions_by_how_well_they_tell_the_gap(tmp_path: Path) -> None:
    """Those that show nothing come last: their load never reaches the other tooth flank."""
    limits = ["--range-rad", "-0.5", "0.5", "--duration-s", "2"]
    motions = answered(tmp_path, "plan", "--bench", BENCH, *limits)["plan"]["motions"]
    sds = [motion["expected_relative_sd"] for motion in motions]
    telling = [sd for sd in sds if sd is not None]
    assert telling == sorted(telling) == sds[: len(telling)]
    assert 0.0 < telling[0] < 0.01
    assert all(motion["flank_changes"] > 0 for motion in motions[: len(telling)])
