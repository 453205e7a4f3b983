"""A run that is killed goes on to the same numbers."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest

from bayesbl.bench.bench import Bench
from bayesbl.config.bench import dump_bench, reference_bench
from bayesbl.errors import RecordingError, ResultError
from bayesbl.results.store import read_tree
from bayesbl.results.work import decoder, encoded
from bayesbl.ringing.estimator import Estimator, Fit
from bayesbl.ringing.posterior import SamplerSettings
from bayesbl.runs.kinds import load_run, run
from bayesbl.runs.simulate import recording_csv
from bayesbl.runs.workflow import Options

pytestmark = pytest.mark.long

RUN = '[run]\nseed = 5\nworkers = 1\noutput = "out"\n'
POSTERIOR = "[posterior]\nensembles = 2\nmax_steps = 500\n"
BEFORE = '[[recordings]]\nfile = "before.csv"\n'
AFTER = '[[recordings]]\nfile = "after.csv"\n'
BENCH = 'bench = "bench.toml"\n'
SWEEP = """[sweep]
gap_rad = {low = 2e-4, high = 3e-3, count = 8}
start_angles = 2
rotations = 2.0
sampling_hz = 250.0
bench_draws = 4
"""
KINDS = {
    "fit": f'kind = "fit"\n{RUN}{BEFORE}{POSTERIOR}',
    "compare": f'kind = "compare"\n{RUN}{BEFORE}{AFTER}{POSTERIOR}',
    "direct": f'kind = "fit"\n{RUN}{BEFORE}{POSTERIOR}[estimator]\nroute = "direct"\n{BENCH}',
    "sweep": f'kind = "sweep"\n{BENCH}{RUN}{SWEEP}',
    "diagnose": f'kind = "diagnose"\n{BENCH}{RUN}{BEFORE}use = "fit"\n{AFTER}use = "hold_out"\n'
    '[candidates]\neffects = ["load_coulomb_friction"]\n',
    "study": f'kind = "study"\nstudy = "study.py"\n{RUN}[[rows]]\nname = "slow"\n',
}
STUDY = """
import time
import numpy as np

def count(row):
    return 12

def run_case(row, index, seed):
    time.sleep(0.1)
    return {"mean_rpm": np.random.default_rng(seed).standard_normal(9).mean()}

def summarise(row, cases):
    return {"mean_rpm": float(cases["mean_rpm"].mean())}
"""


def configure(folder: Path, kind: str) -> Path:
    """A small run of a kind, with its inputs, in a folder of its own; its configuration."""
    folder.mkdir()
    bench = reference_bench()
    for seed, (name, gap_rad) in enumerate({"before": 8e-4, "after": 9e-4}.items()):
        made = bench.simulate(
            gap_rad, rotations=3.0, sampling_hz=250.0, seed=np.random.default_rng(seed)
        )
        rows = recording_csv(made).splitlines(keepends=True)
        if kind == "compare":
            del rows[300]  # a lost sample is bridged, and left out of every sum
        (folder / f"{name}.csv").write_text("".join(rows))
    (folder / "bench.toml").write_text(_tolerant(bench))
    (folder / "study.py").write_text(STUDY)
    config = folder / "config.toml"
    config.write_text(f"schema = 1\n{KINDS[kind]}")
    return config


def _tolerant(bench: Bench) -> str:
    name = "[parameters.shaft_stiffness_nm_per_rad]\n"
    return dump_bench(bench).replace(name, f"{name}relative_tolerance = 0.02\n")


def finish(config: Path, **options) -> list[str]:
    """Run without figures; what was said meanwhile."""
    said: list[str] = []
    force = options.pop("force", False)
    run(load_run(config, **options), Options(force=force, say=said.append))
    return said


def numbers(config: Path) -> dict[str, bytes]:
    """Every number of the result but times, bit for bit."""
    return {
        f"{node.path}/{name}": variable.values.tobytes()
        for node in read_tree(config.parent / "out").subtree
        for name, variable in node.to_dataset(inherit=False).data_vars.items()
        if variable.dtype.kind in "biuf" and "seconds" not in str(name)
    }


def running(config: Path) -> Path:
    """The folder whose lock a run holds; one that is killed leaves it."""
    return config.parent / ".out.running"


def entries(config: Path) -> list[Path]:
    """Finished work of the run, the rows of sweeps included."""
    folder = config.parent / ".finished"
    return [file for file in folder.iterdir() if file.is_file()] if folder.is_dir() else []


@pytest.fixture(scope="module", params=KINDS)
def whole(request, tmp_path_factory) -> tuple[str, dict[str, bytes]]:
    """A kind, and the numbers of a run of it that nobody disturbed."""
    config = configure(tmp_path_factory.mktemp("whole") / "run", request.param)
    assert finish(config) == []
    return request.param, numbers(config)


def kill(config: Path, seconds: float) -> None:
    """Start the command, and kill it that long after it has finished something."""
    process = subprocess.Popen(
        [sys.executable, "-m", "bayesbl", "run", config], stdout=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 120.0
    while not entries(config) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(seconds)
    process.send_signal(signal.SIGKILL)
    process.wait()


def test_a_run_that_is_killed_ends_with_the_same_numbers(whole, tmp_path):
    kind, expected = whole
    config = configure(tmp_path / "run", kind)
    generator = np.random.default_rng(crc32(kind.encode()))
    kill(config, 0.5 * float(generator.uniform()))
    if not (config.parent / "out").exists():
        assert entries(config)
        finish(config)
    assert numbers(config) == expected
    assert not running(config).exists()
    assert not list(config.parent.glob(".out*"))


def interrupted(config: Path, **options) -> None:
    """Run a comparison until the second recording is begun, and stop it by Ctrl-C."""

    def progress(stage: str, done: int, allowed: int) -> None:
        if stage == "Sampling after":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(load_run(config, **options), Options(progress=progress, say=lambda _: None))


@pytest.fixture
def config(tmp_path) -> Path:
    """A comparison of which one recording is finished."""
    config = configure(tmp_path / "run", "compare")
    interrupted(config)
    assert len(entries(config)) == 1
    return config


def test_what_was_finished_is_not_done_again(config, monkeypatch):
    searched: list[str] = []
    fit = Estimator.fit

    def counted(self, recording, *arguments, **options):
        searched.append(recording.name)
        return fit(self, recording, *arguments, **options)

    monkeypatch.setattr(Estimator, "fit", counted)
    finish(config)
    assert searched == ["after"]


@pytest.mark.parametrize("whole", ["compare"], indirect=True)
def test_any_number_of_workers_gives_the_same_numbers_and_resumes_those_of_one(
    config, whole, monkeypatch
):
    monkeypatch.setattr("bayesbl.measurement.amplitude_route.FEWEST_PER_PROCESS", 1)
    finish(config, workers=2)
    assert numbers(config) == whole[1]


@pytest.mark.parametrize("whole", ["compare"], indirect=True)
def test_damaged_work_is_made_again(config, whole):
    [entry] = entries(config)
    entry.write_bytes(entry.read_bytes()[:1000])
    finish(config)
    assert numbers(config) == whole[1]


@pytest.mark.parametrize("whole", ["compare"], indirect=True)
def test_a_changed_problem_takes_nothing_of_the_unfinished_run(config, whole):
    finish(config, seed=6)
    assert numbers(config) != whole[1]
    finish(config, seed=5, out=config.parent / "again")
    for name in ("out", "again"):
        assert not (config.parent / f".{name}.running").exists()


def test_a_fit_that_is_kept_comes_back_whole():
    recording = reference_bench().simulate(8e-4, rotations=3.0, sampling_hz=250.0)
    fit = Estimator(sampler=SamplerSettings(2, 500)).fit(recording, np.random.SeedSequence(1))
    kept = encoded(fit)
    again = decoder(Fit)(kept)
    assert encoded(again) == kept
    np.testing.assert_array_equal(again.point.residual_rpm, fit.point.residual_rpm)
    assert again.point.ringing[0].tolist() == fit.point.ringing[0].tolist()
    searched = fit.point.optimum.searched[None]
    squares = [each.point.objective.sum_of_squares(searched)[0] for each in (fit, again)]
    assert squares[0] == squares[1] == pytest.approx(fit.point.optimum.sum_of_squares, rel=1e-9)


def test_a_figure_that_cannot_be_drawn_costs_no_result(tmp_path):
    def draw(tree: object, place: Path, formats: object) -> None:
        raise ValueError("no such colour")

    config = configure(tmp_path / "run", "sweep")
    with pytest.raises(ValueError, match="no such colour") as failure:
        run(load_run(config), Options(draw))
    assert f"bayesbl figures {config.parent / 'out'}" in failure.value.__notes__[0]
    assert numbers(config)
    assert not running(config).exists()


def test_a_run_that_cannot_end_leaves_nothing(tmp_path):
    config = configure(tmp_path / "run", "fit")
    recording = config.parent / "before.csv"
    recording.write_text("".join(recording.read_text().splitlines(keepends=True)[:700]))
    before = sorted(config.parent.iterdir())
    with pytest.raises(RecordingError):
        finish(config)
    assert sorted(config.parent.iterdir()) == before


def test_what_a_kill_after_the_result_leaves_is_cleared_away(config):
    finish(config)
    running(config).mkdir(0o700)
    with pytest.raises(ResultError, match="finished result"):
        finish(config)
    assert not running(config).exists()
