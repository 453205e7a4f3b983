"""``watch`` and ``collect``: the fleet's rows, each once, whatever is killed or away meanwhile.

The recordings are none, so that nothing is fitted: their rows say so. That those with a gap are a
fleet's too stands in ``test_fleet.py``.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from pathlib import Path
from unittest.mock import patch

import pytest
from test_fleet import configure, start, table

from bayesbl import cli
from bayesbl.config.loading import load_config
from bayesbl.errors import BrokerError, ConfigError, ResultError
from bayesbl.fleet.broker import Credentials, read_address
from bayesbl.runs import watch as watching
from bayesbl.runs.watch import Watched, collect, watch

pytest.importorskip("pyarrow")


def put(plant: Path, joint: str, day: str, text: str | None = None) -> Path:
    place = plant / "data" / joint / f"{day}.csv"
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(text or f"{joint} of {day} is no recording.")
    return place


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    (tmp_path / "joints.csv").write_text("joint,gearbox\nJ1,\nJ2,\n")
    for joint, day in (("J1", "2025-01-01"), ("J1", "2025-02-01"), ("J2", "2025-01-01")):
        put(tmp_path, joint, day)
    put(tmp_path, "J2", "spring")
    put(tmp_path, "J3", "2025-01-01")
    configure(tmp_path)
    return tmp_path


def watched(plant: Path, **more: object) -> list[str]:
    """Watch until all is measured; what was said, rows by joint and date."""
    said: list[str] = []
    asked = Watched(plant / "data", plant / "watched", once=True, settled_s=0.01, **more)
    config = load_config(plant / "plant.toml")
    watch(config, asked, said.append, lambda row: said.append(f"{row['joint']} {row['date']}"))
    return said


def without_use(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    return [{**row, "used": None} for row in rows]


def without_device(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    assert len({row["device"] for row in rows}) == 1
    return [{**row, "device": None} for row in rows]


def test_rows_are_those_of_a_fleet_and_are_made_once(plant):
    assert watched(plant)[:2] == ["J1 2025-01-01", "J1 2025-02-01"]
    assert watched(plant) == []
    start(plant / "plant.toml")
    rows = table(plant / "watched", "recordings")
    assert len(rows) == 5
    assert without_use(rows) == without_use(table(plant / "plant", "recordings"))


def test_a_new_file_is_a_new_row_and_a_copy_is_none(plant):
    watched(plant)
    put(plant, "J2", "2025-03-01")
    put(plant, "J2", "2025-04-01", "J2 of 2025-01-01 is no recording.")
    assert watched(plant) == ["J2 2025-03-01"]


def test_a_file_that_still_grows_waits(plant):
    file = plant / "data/J1/2025-01-01.csv"
    growing = threading.Event()

    def grow() -> None:
        while not growing.wait(0.02):
            with file.open("a") as stream:
                stream.write("more\n")

    thread = threading.Thread(target=grow)
    asked = Watched(plant / "data", plant / "watched", once=True, settled_s=0.5)
    rows: list[str] = []

    def tell(row: dict[str, object]) -> None:
        rows.append(f"{row['joint']} {row['date']}")
        growing.set()

    thread.start()
    watch(load_config(plant / "plant.toml"), asked, print, tell)
    thread.join()
    assert rows[-1] == "J1 2025-01-01"
    assert len(rows) == 5


def test_what_cannot_be_watched_is_told(plant):
    with pytest.raises(ConfigError, match="no such folder"):
        watch(load_config(plant / "plant.toml"), Watched(plant / "no", plant / "w"), print, print)
    start(plant / "plant.toml")
    config = str(plant / "plant.toml")
    asked = Watched(plant / "data", plant / "plant", once=True)
    with pytest.raises(ResultError, match="result of a run"):
        watch(load_config(config), asked, print, print)
    (plant / "list.csv").write_text("joint,date,file\n")
    by_table = Path(config).read_text().replace("data/{joint}/{date}.csv", "list.csv")
    Path(config).write_text(by_table)
    with pytest.raises(ConfigError, match="by a pattern"):
        watched(plant)


KILLED = """
import os, signal, sys
from bayesbl.fleet.plant_tables import RecordingTable
from bayesbl import cli
whole, calls = RecordingTable.save, []
def killed(*arguments):
    calls.append(1)
    if len(calls) == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return whole(*arguments)
RecordingTable.save = killed
cli.status(sys.argv[1:])
"""


@pytest.mark.long
def test_a_device_that_is_killed_loses_nothing_and_measures_nothing_twice(plant):
    """Killed with the second recording measured, before it is a row."""
    arguments = ["watch", str(plant / "data"), "--config", str(plant / "plant.toml"), "--once"]
    arguments += ["--settled-s", "0.01"]
    done = subprocess.run([sys.executable, "-c", KILLED, *arguments], check=False)
    assert done.returncode == -signal.SIGKILL
    assert len(table(plant / "plant_watched", "recordings")) == 1
    measured = []
    real = watching.measure_recording

    def counted(job, number):
        measured.append(job.joint.name)
        return real(job, number)

    with patch.object(watching, "measure_recording", counted):
        assert cli.status(arguments) == 0
    assert measured == ["J2"]
    assert len(table(plant / "plant_watched", "recordings")) == 5


def test_a_service_that_is_stopped_ends_well(plant, capfd):
    code = "import sys; from bayesbl import cli; sys.exit(cli.status(sys.argv[1:]))"
    arguments = ["watch", str(plant / "data"), "--config", str(plant / "plant.toml")]
    command = [sys.executable, "-c", code, *arguments, "--settled-s", "0.01"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert "Watching" in process.stderr.readline()
        assert "J1, 2025-01-01" in process.stderr.readline()
        process.terminate()
        assert process.wait(20) == 0
        assert "Stopped; every recording with a row is safe." in process.stderr.read()


def test_each_answer_arrives_once_though_the_broker_was_away(plant, broker):
    address = read_address(f"mqtt://localhost:{broker.port}/plant")
    below = read_address(f"mqtt://localhost:{broker.port}/plant/r1")
    ann = Credentials(user="ann", password="secret")
    said: list[str] = []

    def collected(credentials: Credentials = ann) -> int:
        before = len(said)
        collect(address, credentials, plant / "all", said.append, lambda row: None, once=True)
        rows = plant / "all/recordings.parquet"
        assert len(said) > before
        return len(table(rows.parent, "recordings")) if rows.exists() else 0

    def sent(wait_s: float) -> str:
        with patch.object(watching, "LAST_SENT_WAIT_S", wait_s):
            return " ".join(watched(plant, publish=below, credentials=ann))

    with patch.object(watching, "IDLE_S", 1.0):
        # Nobody has asked yet, so the broker would drop what it takes.
        told = sent(3.0)
        assert "Nobody has asked" in told
        assert "has not taken yet: 5" in told
        with pytest.raises(BrokerError, match="Not authorized"):
            collected(Credentials(user="ann", password="wrong"))
        assert collected() == 0
        broker.stop()
        assert "cannot be reached" in sent(0.5)
        with pytest.raises(BrokerError, match="cannot be reached"):
            collected()
        broker.start()
        put(plant, "J2", "2025-05-01")
        assert "Answers go to plant/r1" in sent(10.0)
        # The collector is away, the broker ends with what it took, and starts again.
        broker.stop()
        broker.start()
        assert collected() == 6
        assert collected() == 6
        assert sent(10.0) == ""
        # What is lost behind the broker, and of a collector's disk, comes again.
        (plant / "all/recordings.parquet").unlink()
        with patch("bayesbl.fleet.broker.SEND_ALL_AFTER_S", 3.0):
            sent(10.0)
        assert collected() == 6
        broker.stop()
        (broker.folder / "mosquitto.db").unlink()
        (plant / "all/recordings.parquet").unlink()
        broker.start()
        assert collected() == 0
        sent(10.0)
        assert collected() == 6
    rows = [table(plant / name, "recordings") for name in ("watched", "all")]
    assert rows[0] == without_device(rows[1])
    assert not any("secret" in text for text in said)


def test_answers_that_come_twice_and_messages_that_are_none_make_no_rows(plant, broker):
    from paho.mqtt.publish import multiple

    from bayesbl.fleet.broker import encoded_answer

    address = read_address(f"mqtt://localhost:{broker.port}/plant")
    said: list[str] = []

    def collected() -> None:
        collect(
            address,
            Credentials(user="ann", password="secret"),
            plant / "all",
            said.append,
            lambda row: None,
            once=True,
        )

    watched(plant)
    row, *_ = table(plant / "watched", "recordings")
    odd = (
        b"\x1b[2J",
        b"x" * 200_000,
        b'{"schema": NaN}',
        b'{"schema": 2, "device": "d", "picture": {"joint": "J1", "date": "2025-01-01"}}',
        b'{"schema": 2, "device": "d", "recording": {"delta_rad_sd": 1%s}}' % (b"0" * 5000),
    )
    with patch.object(watching, "IDLE_S", 0.3):
        collected()
        answer = encoded_answer(row, "d1")
        multiple(
            [("plant/r1", payload, 1, False) for payload in (answer, *odd, answer, odd[0])],
            port=broker.port,
            auth={"username": "ann", "password": "secret"},
        )
        collected()
    assert table(plant / "all", "recordings") == [row | {"device": "d1"}]
    told = [text for text in said if "cannot be used" in text]
    assert len(told) == len(odd) + 1
    assert (
        told[0] == told[-1] == "A message of 4 bytes on 'plant/r1' cannot be used: it is not JSON."
    )
    with patch.object(watching, "IDLE_S", 0.3):
        said.clear()
        collected()
    assert said == [f"Waiting for answers from plant at localhost:{broker.port}."]
