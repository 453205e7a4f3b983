"""Studies on a Dask cluster: the numbers are those of processes, and what differs is refused."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import test_fleet as fleet
from places import CONFIGS, ROOT

from bayesbl import cli
from bayesbl.config.bench import reference_bench
from bayesbl.config.loading import load_config
from bayesbl.errors import ClusterError
from bayesbl.results.store import read_tree
from bayesbl.results.work import STORE
from bayesbl.runs import cluster as clusters
from bayesbl.runs.cluster import differences, facts
from bayesbl.runs.simulate import recording_csv
from bayesbl.runs.study import Job, files_of_study, prepare
from bayesbl.runs.study import run as run_study
from bayesbl.runs.workflow import Options

STUDY = """
import os
import time
from pathlib import Path

import numpy as np

from bayesbl.errors import UserError

running = []


def count(row):
    return 6


def run_case(row, index, seed):
    if index == row.get("dies"):
        kept = Path(row["note"]).with_suffix(".died")
        if row.get("always") or not kept.exists():
            kept.write_text("")
            os._exit(1)
    if index == row.get("refuse"):
        raise UserError("This case is refused.")
    if index == row.get("bug"):
        raise KeyError("bug")
    running.append(index)
    time.sleep(row.get("sleep", 0.02))
    assert running == [index], "another case runs in this process"
    # Rounding depends on the number of threads that a product of this size is split over.
    draws = np.random.default_rng(seed).standard_normal((300, 300))
    own = np.random.default_rng(seed.spawn(1)[0]).standard_normal()
    running.remove(index)
    return {"norm": np.linalg.norm(draws @ draws), "own": own, "process": os.getpid()}


def summarise(row, cases):
    return {"norm": float(cases["norm"].mean())}
"""


@pytest.fixture(scope="module")
def scheduler():
    """The address of a cluster of two processes on this machine."""
    distributed = pytest.importorskip("distributed")
    import dask

    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=2, dashboard_address=":0"
        ) as cluster,
    ):
        yield cluster.scheduler_address


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "study.py").write_text(STUDY)
    (tmp_path / "note.txt").write_text("A file that rows may name.")
    return tmp_path


def configure(folder: Path, output: str, run: str, row: str = "") -> Path:
    path = folder / f"{output}.toml"
    path.write_text(
        f'schema = 1\nkind = "study"\nstudy = "study.py"\n[run]\noutput = "{output}"\n{run}\n'
        f'[[rows]]\nname = "first"\n[[rows]]\nname = "second"\nnote = "note.txt"\n{row}\n'
    )
    return path


def run(config: Path) -> list[str]:
    """Run a study; what was said meanwhile."""
    said: list[str] = []
    run_study(load_config(config), Options(say=said.append))
    return said


def numbers(output: Path, *names: str) -> list[list[float]]:
    """Of all cases, by row."""
    rows = read_tree(output).children.values()
    return [row[name].values.tolist() for row in rows for name in names or ("norm", "own")]


@pytest.mark.long
def test_one_worker_two_workers_and_a_cluster_give_the_same_numbers(folder, scheduler):
    run(configure(folder, "one", "workers = 1"))
    shutil.rmtree(folder / STORE)
    run(configure(folder, "two", "workers = 2"))
    shutil.rmtree(folder / STORE)
    said = run(configure(folder, "cluster", f'scheduler = "{scheduler}"'))
    assert said == [f"12 cases run on 2 workers of {scheduler}."]
    assert numbers(folder / "one") == numbers(folder / "two") == numbers(folder / "cluster")
    assert (folder / "one/table.csv").read_text() == (folder / "cluster/table.csv").read_text()
    assert len({p for row in numbers(folder / "cluster", "process") for p in row}) == 2


def test_a_case_whose_worker_dies_is_run_again_by_another_to_the_same_numbers(folder, scheduler):
    run(configure(folder, "dies", f'scheduler = "{scheduler}"', "dies = 2"))
    assert (folder / "note.died").exists()
    shutil.rmtree(folder / STORE)
    run(configure(folder, "lives", "workers = 2", "dies = 2"))
    assert numbers(folder / "dies") == numbers(folder / "lives")


@pytest.mark.long
def test_a_case_that_kills_every_worker_ends_the_study_in_words_and_the_others_are_kept(
    folder, scheduler, capsys
):
    rows = "dies = 2\nalways = true"
    config = configure(folder, "kept", f'scheduler = "{scheduler}"', rows)
    assert cli.status(["run", str(config)]) == cli.WRONG
    told = " ".join(capsys.readouterr().err.split())
    assert "Workers died repeatedly" in told
    assert "Traceback" not in told
    assert finished(folder) > 0


@pytest.fixture
def processes(tmp_path, monkeypatch):
    """A scheduler and a worker as they are started by hand, and the address."""
    pytest.importorskip("distributed")
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv("PYTHONPATH", str(ROOT), prepend=os.pathsep)
    at = tmp_path / "scheduler.json"
    here = ("--scheduler-file", str(at))
    commands = [
        ["dask_scheduler", *here, "--host", "127.0.0.1", "--port", "0", "--no-dashboard"],
        ["dask_worker", *here, "--nthreads", "1", "--no-nanny", "--no-dashboard"],
    ]
    with ExitStack() as stack:
        started = []
        for module, *options in commands:
            command = [sys.executable, "-m", f"distributed.cli.{module}", *options]
            process = stack.enter_context(
                subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL)
            )
            stack.callback(process.kill)
            started.append(process)
        while not at.exists() or not at.read_text():
            assert started[0].poll() is None
            time.sleep(0.05)
        yield json.loads(at.read_text())["address"], *started


def once_done(end: Callable[[Any], object], process: Any) -> Callable[[str, int, int], None]:
    """Progress that ends a process when the first job is done."""

    def progress(stage: str, done: int, count: int) -> None:
        if done:
            end(process)

    return progress


@pytest.mark.long
@pytest.mark.parametrize("ends", [subprocess.Popen.kill, subprocess.Popen.terminate])
def test_a_scheduler_that_is_lost_is_told_and_the_study_goes_on_without_it(folder, processes, ends):
    address, scheduler, _ = processes
    config = configure(folder, "kept", f'scheduler = "{address}"', "sleep = 0.2")
    with pytest.raises(ClusterError, match="scheduler was lost"):
        run_study(load_config(config), Options(say=list, progress=once_done(ends, scheduler)))
    before = finished(folder)
    assert 0 < before < 12
    run(configure(folder, "kept", "workers = 2", "sleep = 0.2"))
    shutil.rmtree(folder / STORE)
    run(configure(folder, "whole", "workers = 2", "sleep = 0.2"))
    assert numbers(folder / "kept") == numbers(folder / "whole")


@pytest.mark.long
def test_a_fleet_whose_scheduler_is_killed_loses_nothing_and_measures_nothing_twice(
    tmp_path, processes
):
    """Four joints; the scheduler goes when the first is measured, and one more may be at work."""
    pytest.importorskip("pyarrow")
    joints = [f"J{number}" for number in range(4)]
    (tmp_path / "joints.csv").write_text("joint\n" + "\n".join(joints))
    bench = reference_bench()
    for number, joint in enumerate(joints):
        made = bench.simulate(
            8e-4, rotations=3.0, sampling_hz=250.0, seed=np.random.default_rng(number)
        )
        place = tmp_path / "data" / joint / "2025-01-01.csv"
        place.parent.mkdir(parents=True)
        place.write_text(recording_csv(made))
    address, scheduler, _ = processes
    killed = fleet.configure(tmp_path, "killed", f'scheduler = "{address}"')
    with pytest.raises(ClusterError, match="scheduler was lost"):
        fleet.start(killed, progress=once_done(subprocess.Popen.kill, scheduler))
    assert not (tmp_path / "killed").exists()
    said = fleet.start(fleet.configure(tmp_path, "killed"))
    assert said in [[f"{n} recordings to measure, {n} of 4 joints to look at."] for n in (1, 2, 3)]
    shutil.rmtree(tmp_path / STORE)
    fleet.start(fleet.configure(tmp_path, "whole"))
    for name in ("recordings", "joints"):
        assert fleet.table(tmp_path / "killed", name) == fleet.table(tmp_path / "whole", name)
    assert len(fleet.table(tmp_path / "killed", "recordings")) == 4


@pytest.mark.long
def test_a_bug_in_a_case_names_it_and_what_is_finished_goes_on_over_processes(
    folder, scheduler, capsys
):
    config = configure(folder, "kept", f'scheduler = "{scheduler}"', "refuse = 1\nbug = 4")
    assert cli.status(["run", str(config)]) == cli.WRONG
    assert 'in case 4 of row "second".' in " ".join(capsys.readouterr().err.split())
    assert finished(folder) > 0
    configure(folder, "kept", "workers = 2", "refuse = 1")
    run(config)
    shutil.rmtree(folder / STORE)
    run(configure(folder, "whole", "workers = 2", "refuse = 1"))
    for name in ("norm", "own"):
        np.testing.assert_array_equal(
            numbers(folder / "kept", name), numbers(folder / "whole", name)
        )


def finished(folder: Path) -> int:
    """Cases that the study ``kept`` has stored."""
    return len(list((folder / STORE).iterdir()))


def test_a_worker_with_other_code_or_files_is_refused_before_anything_runs(
    folder, scheduler, monkeypatch, capsys
):
    config = configure(folder, "other", f'scheduler = "{scheduler}"')
    versions = clusters.code_versions() | {"bayesbl": "0.0.1, commit abc", "numpy": "1.0"}
    with monkeypatch.context() as patch:
        patch.setattr(clusters, "code_versions", lambda: versions)
        assert cli.status(["run", str(config)]) == cli.WRONG
    told = " ".join(capsys.readouterr().err.split())
    assert "in place of 0.0.1, commit abc" in told
    assert "in place of 1.0" in told
    assert "tcp://" in told
    assert "Traceback" not in told
    assert not (folder / "other").exists()


def test_a_worker_that_joins_later_is_asked_too(folder, monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    said = []
    with distributed.LocalCluster(
        n_workers=0, processes=False, protocol="tcp", dashboard_address=":0"
    ) as cluster:
        config = load_config(
            configure(folder, "later", f'scheduler = "{cluster.scheduler_address}"')
        )

        def say(text: str) -> None:
            said.append(text)
            cluster.scale(1)

        with pytest.raises(ClusterError, match=r"tcp://.*OMP_NUM_THREADS 2 in place of 1"):
            run_study(config, Options(say=say))
    assert said == [f"{config.run.scheduler} has no workers yet; 12 cases wait for them."]


def files_of(folder: Path) -> list[str]:
    study, rows = prepare(load_config(configure(folder, "out", "workers = 1")))
    return files_of_study(study, [Job(row.table, 0, 1) for row in rows])


def test_a_worker_tells_what_it_has_otherwise(folder):
    files = files_of(folder)
    wanted = facts(files)
    assert differences(wanted, files) == []
    (folder / "note.txt").write_text("Another file at the same path.")
    (folder / "study.py").unlink()
    gone, other = differences(wanted, files)
    assert f"{folder / 'study.py'} cannot be read (No such file" in gone
    assert other.startswith(f"{folder / 'note.txt'} with SHA-256 ")


def test_linear_algebra_on_many_threads_is_told(monkeypatch):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    assert ("OMP_NUM_THREADS", "not set") in facts(())
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    wanted = facts(())
    assert ("MKL_NUM_THREADS", "1") in wanted
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    assert differences(wanted, ()) == ["OPENBLAS_NUM_THREADS 2 in place of 1"]


def test_a_scheduler_that_does_not_answer_is_told(folder, monkeypatch, capsys):
    pytest.importorskip("distributed")
    monkeypatch.setattr(clusters, "ANSWER_WITHIN_S", 1.0)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        config = configure(folder, "none", "workers = 1")
        assert cli.status(["run", str(config), "--scheduler", address]) == cli.WRONG
    told = " ".join(capsys.readouterr().err.split())
    assert (
        f"{address}: No Dask scheduler answers at this address. Found: nothing within 1 s." in told
    )
    assert "dask scheduler" in told


def test_without_the_extra_it_is_told_how_to_install_it(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ClusterError, match=r"pip install 'bayesbl\[cluster\]'"):
        run(configure(folder, "out", 'scheduler = "tcp://127.0.0.1:8786"'))


@pytest.mark.parametrize("address", ["host", "host:8786", "tcp://host", "http://host:8786"])
def test_an_address_that_cannot_be_one_is_refused(folder, address, capsys):
    config = configure(folder, "out", f'scheduler = "{address}"')
    assert cli.status(["check", str(config)]) == cli.WRONG
    assert "tcp://host:8786" in " ".join(capsys.readouterr().err.split())


def test_only_studies_and_fleets_take_a_scheduler(capsys):
    config = CONFIGS / "wear_snapshots.toml"
    arguments = ["run", str(config), "--scheduler", "tcp://127.0.0.1:1"]
    assert cli.status(arguments) == cli.WRONG
    assert "--scheduler: This option is not for this kind of run." in capsys.readouterr().err
