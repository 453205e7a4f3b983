"""What a comparison is run for again: other dates and limits cost no fit."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import numpy as np
import pytest

from bayesbl.bench.bench import Bench
from bayesbl.config.bench import reference_bench
from bayesbl.config.loading import config_from_options
from bayesbl.results.store import read_tree
from bayesbl.ringing.estimator import Estimator
from bayesbl.runs.kinds import run
from bayesbl.runs.simulate import recording_csv
from bayesbl.runs.workflow import Options

POSTERIOR = "[posterior]\nensembles = 2\nmax_steps = 400\n"


def compare(folder: Path, file: Path, day: int, limit_rad: float) -> None:
    """A comparison of both recordings, with dates and a limit."""
    config = config_from_options(
        "compare",
        [folder / "before.csv", folder / "after.csv"],
        file,
        [date(2026, 1, 1), date(2026, 6, day)],
        limit_rad=limit_rad,
        curve="published",
        out=folder / "out",
    )
    run(config, Options(force=True, say=lambda _: None))


def test_other_dates_and_another_limit_make_no_fit_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench: Bench = reference_bench()
    for seed, (name, gap_rad) in enumerate({"before": 8e-4, "after": 9e-4}.items()):
        made = bench.simulate(
            gap_rad, rotations=3.0, sampling_hz=250.0, seed=np.random.default_rng(seed)
        )
        (tmp_path / f"{name}.csv").write_text(recording_csv(made))
    file = tmp_path / "fit.toml"
    file.write_text(
        'schema = 1\nkind = "compare"\n[run]\nworkers = 1\n[estimator]\nroute = "amplitude"\n'
        f'{POSTERIOR}[[recordings]]\nfile = "before.csv"\n[[recordings]]\nfile = "after.csv"\n'
    )
    compare(tmp_path, file, 1, 1e-3)
    first = read_tree(tmp_path / "out")

    def never(*_: object, **__: object) -> None:
        raise AssertionError("fitted again")

    monkeypatch.setattr(Estimator, "fit", never)
    compare(tmp_path, file, 20, 2e-3)
    again = read_tree(tmp_path / "out")
    assert again.attrs["limit_rad"] == 2e-3
    gaps = [tree["gap"]["delta_rad"].values for tree in (first, again)]
    assert np.array_equal(*gaps)
