"""``bayesbl fleet``: each recording once, a broken one a row, the same however it is run."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from places import AFTER, BEFORE, CONFIGS

from bayesbl import cli
from bayesbl.config.loading import load_config
from bayesbl.fleet.measured_joint import JointJob, measure_joint
from bayesbl.library import draw
from bayesbl.results.work import STORE
from bayesbl.runs import fleet, watch
from bayesbl.runs.kinds import run
from bayesbl.runs.simulate import run_simulate
from bayesbl.runs.watch import Watched
from bayesbl.runs.workflow import Options

pytest.importorskip("pyarrow")

GAPS = {"2025-01-01": 5e-4, "2026-01-01": 9e-4}

HEAD = """schema = 1
kind = "fleet"
[fleet]
joints = "joints.csv"
recordings = "data/{{joint}}/{{date}}.csv"
pool_by = "gearbox"
decide_before = 2030-01-01
[estimator]
route = "amplitude"
[posterior]
ensembles = 2
[run]
output = "{output}"
{run}
"""


def table(output: Path, name: str) -> list[dict[str, object]]:
    from pyarrow.parquet import read_table

    return read_table(output / f"{name}.parquet").to_pylist()


def configure(folder: Path, output: str = "plant", how: str = "workers = 1") -> Path:
    path = folder / f"{output}.toml"
    path.write_text(HEAD.format(output=output, run=how))
    return path


def start(config: Path, **options: object) -> list[str]:
    """Run; what was said."""
    said: list[str] = []
    run(load_config(config), Options(draw, say=said.append, **options))
    return said


def put(folder: Path, joint: str, day: str, source: Path) -> None:
    place = folder / "data" / joint / f"{day}.csv"
    place.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(source, place)


@pytest.fixture(scope="module")
def plant(tmp_path_factory) -> Path:
    """Two joints after a first run: one that wears, one with nothing to measure it by."""
    folder = tmp_path_factory.mktemp("fleet")
    shutil.copy(CONFIGS / "bench.toml", folder / "bench.toml")
    entries = "".join(
        f'[[recordings]]\nname = "{day}"\nfile = "{day}.csv"\ngap_rad = {gap}\nrotations = 3\n'
        for day, gap in GAPS.items()
    )
    simulation = folder / "simulate.toml"
    simulation.write_text(
        'schema = 1\nkind = "simulate"\nbench = "bench.toml"\n[run]\nseed = 3\n'
        f'output = "data/J1"\n{entries}'
    )
    run_simulate(simulation)
    put(folder, "J2", "2025-01-01", BEFORE)
    broken = folder / "data/J2/2025-02-01.csv"
    broken.write_text("This is <b>no</b> recording.")
    (folder / "joints.csv").write_text(
        "joint,gearbox,bench,limit_rad,gear_ratio,cell\n"
        "J1,RV-80,bench.toml,1.2e-3,120,A\nJ2,<RV>,,,120,B\n"
    )
    said = start(configure(folder))
    assert said == ["4 recordings to measure, 2 of 2 joints to look at."]
    return folder


def test_every_recording_is_a_row_and_a_broken_one_says_why(plant):
    rows = {(row["joint"], row["date"]): row for row in table(plant / "plant", "recordings")}
    assert len(rows) == 4
    for day, gap in GAPS.items():
        row = rows["J1", day]
        assert row["outcome"] in ("converged", "usable")
        assert row["delta_rad_q01"] < gap < row["delta_rad_q99"]
    assert rows["J2", "2025-01-01"]["outcome"] == "no_curve"
    assert rows["J2", "2025-01-01"]["amplitude_rpm_median"] > 10.0
    assert rows["J2", "2025-02-01"]["outcome"] == "refused"
    assert "not a CSV file" in rows["J2", "2025-02-01"]["reason"]


def test_a_joint_that_wears_has_rate_and_date_and_the_other_a_reason(plant):
    first, second = table(plant / "plant", "joints")
    assert (first["joint"], first["rank"], first["cell"]) == ("J1", 1, "A")
    assert first["rate_rad_per_year_low"] < 4e-4 < first["rate_rad_per_year_high"]
    assert "2026-01-01" < first["limit_date_low"] < first["limit_date_high"]
    assert first["pooled"] is False
    assert (second["joint"], second["rank"]) == ("J2", None)
    assert second["rate_rad_per_year_median"] is None
    assert "For δ, give a bench" in second["reason"]


def test_draws_are_stored_by_joint(plant):
    head = json.loads((plant / "plant/draws.zarr/J1/delta_rad/.zarray").read_text())
    values = (plant / "plant/draws.zarr/J1/delta_rad/0.0").read_bytes()
    gaps = np.frombuffer(values, head["dtype"]).reshape(head["shape"])
    assert gaps.shape[0] == 2
    assert np.median(gaps[1]) == pytest.approx(9e-4, rel=0.1)


def test_pages_need_nothing_else_and_take_no_text_for_markup(plant):
    index = (plant / "plant/index.html").read_text(encoding="utf-8")
    page = (plant / "plant/joints/J2.html").read_text(encoding="utf-8")
    assert 'href="joints/J1.html"' in index
    assert "&lt;RV&gt;" in index
    assert "<RV>" not in index
    for text in (index, page):
        assert "http://" not in text.replace("http://www.w3.org", "")
        assert "https://" not in text
        assert "default-src 'none'" in text


def test_a_run_without_news_measures_nothing_and_writes_the_same(plant):
    before = [table(plant / "plant", name) for name in ("recordings", "joints")]
    with patch.object(fleet, "measure_joint", side_effect=AssertionError("it is measured")):
        assert start(configure(plant)) == []
    assert [table(plant / "plant", name) for name in ("recordings", "joints")] == before


def test_a_device_gives_the_same_rows_and_takes_over_what_a_fleet_has_measured(plant):
    start(configure(plant))
    asked = Watched(plant / "data", plant / "watched", once=True, settled_s=0.01)
    told: list[str] = []
    with patch.object(watch, "measure_recording", side_effect=AssertionError("it is measured")):
        watch.watch(
            load_config(configure(plant)), asked, print, lambda row: told.append(row["joint"])
        )
    assert told == ["J1", "J1", "J2", "J2"]
    rows = [table(plant / name, "recordings") for name in ("plant", "watched")]
    for row in (*rows[0], *rows[1]):
        row["used"] = None
    assert rows[0] == rows[1]


def test_a_new_file_touches_its_joint_only_and_a_copied_one_is_told(plant):
    put(plant, "J2", "2025-03-01", BEFORE)
    (plant / "data/J2/2025-04-01.csv").write_text("Nor is this.")
    try:
        said = start(configure(plant))
        assert said == ["1 recordings to measure, 1 of 2 joints to look at."]
        rows = {row["date"]: row for row in table(plant / "plant", "recordings")}
        assert "to the last byte that of 2025-01-01" in rows["2025-03-01"]["reason"]
    finally:
        for day in ("2025-03-01", "2025-04-01"):
            (plant / f"data/J2/{day}.csv").unlink()


def test_another_limit_measures_no_recording_again(plant):
    inventory = plant / "joints.csv"
    text = inventory.read_text()
    start(configure(plant))
    inventory.write_text(text.replace("1.2e-3", "8e-4"))
    try:
        assert start(configure(plant)) == ["0 recordings to measure, 1 of 2 joints to look at."]
        (first, _) = table(plant / "plant", "joints")
        assert first["alarm"] is True
        assert first["probability_limit_now"] > 0.95
    finally:
        inventory.write_text(text)


def test_what_a_user_put_into_the_folder_is_left(plant, capsys):
    note = plant / "plant/joints/note.txt"
    start(configure(plant))
    note.write_text("mine")
    assert cli.status(["fleet", str(plant / "plant.toml")]) == cli.WRONG
    assert "note.txt" in capsys.readouterr().err
    assert note.read_text() == "mine"
    note.unlink()


def test_the_command_says_what_is_urgent(plant, capsys):
    assert cli.status(["check", str(configure(plant))]) == 0
    assert "joints: 2, 4 recordings" in capsys.readouterr().out
    assert cli.status(["fleet", str(configure(plant))]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "2 joints, 1 with a rate of wear, from 2 of 4 recordings." in told
    assert "1 without a bench or a curve" in told


def test_a_run_that_was_killed_goes_on_with_the_joints_that_it_lacks(tmp_path):
    for name in ("J1", "J2"):
        (tmp_path / "data" / name).mkdir(parents=True)
        (tmp_path / "data" / name / "2025-01-01.csv").write_text(f"{name} is no recording.")
    (tmp_path / "joints.csv").write_text("joint,gearbox\nJ1,\nJ2,\n")

    def killed(job: JointJob) -> object:
        if job.joint.name == "J2":
            raise KeyboardInterrupt
        return measure_joint(job)

    with patch.object(fleet, "measure_joint", killed), pytest.raises(KeyboardInterrupt):
        start(configure(tmp_path))
    assert not (tmp_path / "plant").exists()
    assert start(configure(tmp_path)) == ["1 recordings to measure, 1 of 2 joints to look at."]
    outcomes = [row["outcome"] for row in table(tmp_path / "plant", "recordings")]
    assert outcomes == ["refused", "refused"]
    assert "withheld" in (tmp_path / "plant/summary.json").read_text()


@pytest.mark.long
def test_recordings_matched_with_the_bench_one_by_one_give_the_change(plant, tmp_path):
    for name in ("bench.toml", "data/J1"):
        (shutil.copytree if "/" in name else shutil.copy)(plant / name, tmp_path / name)
    (tmp_path / "joints.csv").write_text("joint,bench,limit_rad\nJ1,bench.toml,1.2e-3\n")
    config = configure(tmp_path)
    config.write_text(config.read_text().replace('"amplitude"', '"direct"'))
    start(config)
    (joint,) = table(tmp_path / "plant", "joints")
    assert (joint["route"], joint["used"], joint["reason"]) == ("direct", 2, None)
    low, high = joint["rate_rad_per_year_low"], joint["rate_rad_per_year_high"]
    assert low < 4.003e-4 < high  # 0.4 mrad in 365 of 365.25 days
    assert high - low < 0.1 * 4e-4


@pytest.mark.long
def test_one_process_two_and_a_cluster_write_the_same_tables(tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    put(tmp_path, "J1", "2025-01-01", BEFORE)
    put(tmp_path, "J2", "2025-01-01", AFTER)
    (tmp_path / "joints.csv").write_text("joint,gearbox,gear_ratio\nJ1,,120\nJ2,,120\n")
    start(configure(tmp_path, "one"))
    shutil.rmtree(tmp_path / STORE)
    start(configure(tmp_path, "two", "workers = 2"))
    shutil.rmtree(tmp_path / STORE)
    with distributed.LocalCluster(n_workers=1, dashboard_address=":0") as cluster:
        how = f'scheduler = "{cluster.scheduler_address}"'
        said = start(configure(tmp_path, "cluster", how))
    assert f"2 joints run on 1 workers of {cluster.scheduler_address}." in said
    for name in ("recordings", "joints"):
        tables = [table(tmp_path / output, name) for output in ("one", "two", "cluster")]
        assert tables[0] == tables[1] == tables[2]
        assert len(tables[0]) == 2
