"""A run that is killed goes on where it was, to the same draws, or is refused in words."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from bayesbl.results.checkpoint import Checkpoint

from bayesbl.config.loading import config_from_options, load_config
from bayesbl.errors import RecordingError, ResultError
from bayesbl.results.folder import is_finished
from bayesbl.results.store import read_tree
from bayesbl.runs.run import run

RECORDINGS = Path(__file__).parents[2] / "configs" / "recordings"
SAMPLES, THINNED = 8000, 4  # 8 s, every fourth sample: 250 Hz
STEPS = 600
KILLS = 20


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two short recordings, and a comparison of them with few steps."""
    folder = tmp_path_factory.mktemp("resume")
    for name in ("before", "after"):
        lines = (RECORDINGS / f"wear_{name}.csv").read_text().splitlines(keepends=True)
        rows = lines[1 : SAMPLES + 1 : THINNED]
        if name == "before":
            del rows[700]  # a lost sample is bridged, and left out of every sum
        (folder / f"{name}.csv").write_text(lines[0] + "".join(rows))
    (folder / "compare.toml").write_text(
        f"""schema = 1
kind = "compare"
[run]
seed = 5
workers = 1
[[recordings]]
file = "before.csv"
[[recordings]]
file = "after.csv"
[posterior]
ensembles = 2
max_steps = {STEPS}
"""
    )
    return folder


def measured(folder: Path, output: Path, *, force: bool = False, **options) -> list[str]:
    """Run the comparison without figures; what was said meanwhile."""
    said: list[str] = []
    config = config_from_options("compare", (), folder / "compare.toml", out=output, **options)
    run(config, lambda tree, place: None, force=force, say=said.append)
    return said


def interrupted(folder: Path, output: Path, steps: int, name: str = "before") -> None:
    """Stop the run by Ctrl-C after so many steps on a recording."""

    def progress(recording: str, done: int, allowed: int) -> None:
        if recording == name and done >= steps:
            raise KeyboardInterrupt

    config = config_from_options("compare", (), folder / "compare.toml", out=output)
    with pytest.raises(KeyboardInterrupt):
        run(config, lambda tree, place: None, progress=progress, say=lambda sentence: None)


def draws(output: Path) -> dict[str, bytes]:
    """Every number of optimum, search, posterior and change but times, bit for bit."""
    tree = read_tree(output)
    groups = ("optimum", "search_history", "posterior", "sample_stats", "diagnostics", "change")
    return {
        f"{group}/{name}": variable.values.tobytes()
        for group in groups
        for name, variable in tree[group].to_dataset().data_vars.items()
        if variable.dtype.kind in "biuf" and name != "search_seconds"
    }


def unfinished(output: Path) -> Path:
    return output.with_name(f".{output.name}.unfinished")


@pytest.fixture(scope="module")
def whole(folder: Path) -> dict[str, bytes]:
    """The draws of a run that nobody disturbed."""
    measured(folder, folder / "whole")
    return draws(folder / "whole")


def in_child(folder: Path, output: Path) -> None:
    measured(folder, output)
    os._exit(0)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_run_killed_at_any_moment_ends_with_the_same_draws(
    folder: Path, whole: dict[str, bytes], tmp_path: Path
) -> None:
    began = time.perf_counter()
    measured(folder, tmp_path / "timed")
    duration = time.perf_counter() - began
    generator = np.random.default_rng(11)
    context = multiprocessing.get_context("fork")  # spares each run a second of imports
    resumed = 0
    for number, share in enumerate(generator.permutation(KILLS)):
        output = tmp_path / f"run-{number}"
        child = context.Process(target=in_child, args=(folder, output))
        child.start()
        time.sleep(duration * (share + generator.uniform()) / KILLS)
        assert child.pid is not None
        os.kill(child.pid, signal.SIGKILL)
        child.join()
        if is_finished(output):
            assert draws(output) == whole  # no half result, whatever the moment
        else:
            assert not output.exists()
            resumed += bool(measured(folder, output))
            assert draws(output) == whole
            assert not unfinished(output).exists()
            assert not list(tmp_path.glob(f".{output.name}.*"))
    assert resumed  # how many kills met a finished stage is the machine's to say


def test_what_was_finished_is_not_done_again(
    folder: Path, whole: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = tmp_path / "out"
    interrupted(folder, output, STEPS, "after")
    monkeypatch.setattr("bayesbl.ringing.estimator.find_optimum", None)
    monkeypatch.setattr("bayesbl.sampling.ensemble.Ensemble.run", None)
    assert measured(folder, output) == ["This goes on where an unfinished run was left."]
    assert draws(output) == whole
    assert not unfinished(output).exists()


def test_a_figure_that_cannot_be_drawn_costs_no_result(
    folder: Path, whole: dict[str, bytes], tmp_path: Path
) -> None:
    def draw(tree: object, place: Path) -> None:
        raise ValueError("no such colour")

    output = tmp_path / "out"
    config = config_from_options("compare", (), folder / "compare.toml", out=output)
    with pytest.raises(ValueError, match="no such colour") as failure:
        run(config, draw, say=lambda sentence: None)
    assert f"bayesbl figures {output}" in failure.value.__notes__[0]
    assert draws(output) == whole
    assert not unfinished(output).exists()


def test_any_number_of_workers_gives_the_same_draws_and_resumes_those_of_one(
    folder: Path, whole: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupted(folder, tmp_path / "out", 250)
    monkeypatch.setattr("bayesbl.measurement.fits.FEWEST_PER_PROCESS", 1)
    assert measured(folder, tmp_path / "out", workers=2)
    assert draws(tmp_path / "out") == whole


def test_a_changed_configuration_is_refused_in_words(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "out"
    interrupted(folder, output, 250)
    with pytest.raises(ResultError, match=r"another problem.*run\.seed was 5, is 6.*--force"):
        measured(folder, output, seed=6)
    with pytest.raises(ResultError, match=r"joint\.limit_rad was not given, is 0\.001"):
        measured(folder, output, limit_rad=1e-3)
    assert measured(folder, output)  # it can still go on


def test_a_changed_recording_is_refused_in_words(folder: Path, tmp_path: Path) -> None:
    for file in folder.glob("*.*"):
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    interrupted(tmp_path, tmp_path / "out", 250)
    lines = (tmp_path / "after.csv").read_text().splitlines(keepends=True)
    (tmp_path / "after.csv").write_text("".join(lines[:-1]))
    with pytest.raises(ResultError, match=r"content of .*after\.csv was SHA-256"):
        measured(tmp_path, tmp_path / "out")


def test_another_version_is_refused_in_words(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "out"
    interrupted(folder, output, 250)
    file = unfinished(output) / "problem.json"
    problem = json.loads(file.read_text())
    problem["version of emcee"] = "3.0.0"
    file.write_text(json.dumps(problem))
    with pytest.raises(ResultError, match=r"version of emcee was 3\.0\.0, is"):
        measured(folder, output)


def test_force_starts_over(folder: Path, whole: dict[str, bytes], tmp_path: Path) -> None:
    output = tmp_path / "out"
    interrupted(folder, output, 250)
    assert measured(folder, output, force=True) == []
    assert draws(output) == whole


def test_a_stored_optimum_that_the_recording_denies_is_refused(
    folder: Path, tmp_path: Path
) -> None:
    output = tmp_path / "out"
    interrupted(folder, output, 250)
    (file,) = unfinished(output).glob("*-optimum.npz")
    with np.load(file) as stored:
        arrays = dict(stored)
    arrays["symbols"] = arrays["symbols"] * (1.0 + 1e-5)
    np.savez(file, **arrays)
    with pytest.raises(ResultError, match="does not agree with the recording"):
        measured(folder, output)


def test_a_damaged_stage_is_made_again(
    folder: Path, whole: dict[str, bytes], tmp_path: Path
) -> None:
    output = tmp_path / "out"
    interrupted(folder, output, STEPS)
    files = sorted(unfinished(output).glob("*-steps-*.npz"))
    assert len(files) == 3
    files[1].write_bytes(files[1].read_bytes()[:1000])
    files[2].write_bytes(b"")
    assert measured(folder, output)
    assert draws(output) == whole


def test_two_runs_into_one_folder_do_not_mix(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "out"
    with (
        Checkpoint.beside(output, {"a": "1"}),
        pytest.raises(ResultError, match="under way"),
    ):
        measured(folder, output)
    assert not unfinished(output).exists()
    measured(folder, output)


def test_a_run_that_cannot_end_leaves_nothing(folder: Path, tmp_path: Path) -> None:
    lines = (folder / "after.csv").read_text().splitlines(keepends=True)
    (tmp_path / "short.csv").write_text("".join(lines[: 3000 // THINNED]))
    config = config_from_options("fit", [tmp_path / "short.csv"], out=tmp_path / "out")
    with pytest.raises(RecordingError):
        run(config, lambda tree, place: None, say=lambda sentence: None)
    assert [path.name for path in tmp_path.iterdir()] == ["short.csv"]


def test_what_a_kill_after_the_result_leaves_is_cleared_away(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "out"
    interrupted(folder, output, 250)
    leftover = unfinished(output)
    kept = {file.name: file.read_bytes() for file in leftover.iterdir()}
    measured(folder, output)
    leftover.mkdir()
    for name, content in kept.items():
        (leftover / name).write_bytes(content)
    with pytest.raises(ResultError, match="finished result"):
        measured(folder, output)
    assert not leftover.exists()


def test_the_new_keys_have_their_options(folder: Path, tmp_path: Path) -> None:
    measured(folder, tmp_path / "old")
    config = config_from_options(
        "compare", (), folder / "compare.toml", start_from=tmp_path / "old", check_sampler=True
    )
    assert config.estimator.search.start_from == tmp_path / "old" / "result.nc"
    assert config.posterior.check_sampler
    assert not load_config(folder / "compare.toml").posterior.check_sampler
