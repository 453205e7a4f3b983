"""What a watcher, a fleet and a broker must never do to a plant: lose, delete, leak, mix up.

What a recording says is made of its content here, where it is not about what it says.
"""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from mosquitto import Broker

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from attack.plant import FLEET
from bayesbl.config.loading import load_config
from bayesbl.errors import RecordingError, UnavailableError
from bayesbl.fleet import measured_joint
from bayesbl.fleet.broker import Credentials, read_address
from bayesbl.fleet.inventory import Found
from bayesbl.fleet.measured_joint import REFUSED, JointJob, RecordingAnswer
from bayesbl.library import draw
from bayesbl.runs import watch as watching
from bayesbl.runs.kinds import run
from bayesbl.runs.watch import Watched, collect, watch
from bayesbl.runs.workflow import Options

pytest.importorskip("pyarrow")


def answer(job: JointJob, number: int) -> RecordingAnswer:
    """Refused where the content says so."""
    if "broken" in Path(job.recordings[number].file).read_text():
        return RecordingAnswer(REFUSED, "It is broken.")
    gap = np.random.default_rng(int(job.recordings[number].sha256[:8], 16)).normal(1e-3, 1e-5, 100)
    return RecordingAnswer("usable", None, route="direct", gap_rad=gap)


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    (tmp_path / "joints.csv").write_text("joint\nJ1\nJ2\n")
    (tmp_path / "plant.toml").write_text(FLEET)
    return tmp_path


def put(plant: Path, joint: str, day: str, text: str = "") -> Path:
    file = plant / "data" / joint / f"{day}.csv"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text or f"{joint} of {day}")
    return file


def watched(plant: Path, measure: Callable[..., RecordingAnswer] = answer, **more: object) -> None:
    asked = Watched(plant / "data", plant / "watched", once=True, settled_s=0.01, **more)
    with patch.object(watching, "measure_recording", measure):
        watch(load_config(plant / "plant.toml"), asked, lambda _: None, lambda _: None)


def fleet(plant: Path, measure: Callable[..., RecordingAnswer] = answer) -> list[str]:
    said: list[str] = []
    with patch.object(measured_joint, "measure_recording", measure):
        run(load_config(plant / "plant.toml"), Options(draw, say=said.append))
    return said


def table(folder: Path, name: str = "recordings") -> list[dict[str, object]]:
    from pyarrow.parquet import read_table

    return read_table(folder / f"{name}.parquet").to_pylist()


# Links.


def test_links_that_leave_the_folder_are_not_read(plant, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside")
    (outside / "2025-01-01.csv").write_text("root:secret:0:0")
    put(plant, "J1", "2025-02-01")
    (plant / "data/J1/2025-01-01.csv").symlink_to(outside / "2025-01-01.csv")
    (plant / "data/J2").symlink_to(outside, target_is_directory=True)
    (plant / "data/J1/2025-03-01.csv").symlink_to("2025-02-01.csv")  # stays inside

    def opened(job: JointJob, number: int) -> RecordingAnswer:
        assert "secret" not in Path(job.recordings[number].file).read_text()
        return answer(job, number)

    watched(plant, opened)
    fleet(plant, opened)
    (plant / "list.csv").write_text(
        "joint,date,file\nJ1,2025-01-01,data/J1/2025-01-01.csv\nJ2,2025-01-01,data/J2/2025-01-01.csv\n"
    )
    for folder in ("watched", "plant"):
        refused = [row for row in table(plant / folder) if "leads out" in str(row["reason"])]
        assert {(row["joint"], row["sha256"]) for row in refused} == {("J1", None), ("J2", None)}
    text = FLEET.replace("data/{joint}/{date}.csv", "list.csv")
    (plant / "plant.toml").write_text(text.replace('"plant"', '"by_table"'))
    fleet(plant, opened)
    assert all("leads out" in str(row["reason"]) for row in table(plant / "by_table"))
    assert (outside / "2025-01-01.csv").read_text() == "root:secret:0:0"


@pytest.mark.parametrize("name", [".plant.kept", ".watched.growing"])
def test_a_planted_link_costs_no_foreign_file(plant, tmp_path_factory, name):
    outside = tmp_path_factory.mktemp("outside")
    (outside / "thesis.tex").write_text("mine")
    put(plant, "J1", "2025-01-01")
    (plant / name).symlink_to(outside, target_is_directory=True)
    with pytest.raises(Exception, match="somebody else"):
        (watched if name == ".watched.growing" else fleet)(plant)
    assert [path.name for path in outside.iterdir()] == ["thesis.tex"]


# Answers that do not last.


def test_what_could_not_be_read_here_and_now_is_tried_again(plant):
    put(plant, "J1", "2025-01-01")
    put(plant, "J1", "2025-02-01", "broken")

    def without_library(job: JointJob, number: int) -> RecordingAnswer:
        return RecordingAnswer(REFUSED, "not installed", lasting=False)

    for act, folder in ((fleet, "plant"), (watched, "watched")):
        act(plant, without_library)
        assert {row["outcome"] for row in table(plant / folder)} == {"refused"}
        act(plant)
        assert [row["outcome"] for row in table(plant / folder)] == ["usable", "refused"]
        shutil.rmtree(plant / ".plant.kept")
    fleet(plant)
    assert fleet(plant) == []


def test_a_refusal_lasts_only_if_content_alone_decides_it(plant):
    from bayesbl.fleet.inventory import find_recordings, read_joints
    from bayesbl.runs.fleet import _jobs

    file = put(plant, "J1", "2025-01-01", "time_s,motor_speed_rpm\n0.0,1.0\n")
    config = load_config(plant / "plant.toml")
    joints = read_joints(config.fleet)
    (job, _), _ = _jobs(config, joints, find_recordings(config.fleet, joints))
    assert measured_joint.measure_recording(job, 0).lasting

    def failing(error: Exception, text: str | None = None) -> RecordingAnswer:
        def measure(*_: object, **__: object) -> None:
            if text is not None:
                file.write_text(text)
                file.write_text("time_s,motor_speed_rpm\n0.0,1.0\n")  # back again: the same bytes
            raise error

        with patch.object(measured_joint, "measure", measure):
            return measured_joint.measure_recording(job, 0)

    assert failing(RecordingError("too short")).lasting
    assert not failing(UnavailableError("no library")).lasting
    assert not failing(RecordingError("too short"), "half").lasting
    file.write_text("other")
    assert not measured_joint.measure_recording(job, 0).lasting


# Messages.


ONE_IMAGE = {"file": "data/J1.csv"}
ANN = Credentials(user="ann", password="secret")


def collected(plant: Path, broker: Broker) -> list[dict[str, object]]:
    address = read_address(f"mqtt://localhost:{broker.port}/plant")
    with patch.object(watching, "IDLE_S", 0.5):
        collect(address, ANN, plant / "all", lambda _: None, lambda _: None, once=True)
    return table(plant / "all") if (plant / "all/recordings.parquet").exists() else []


def test_what_another_subscriber_got_instead_comes_again(plant, broker):
    """The broker takes what another client has asked for, and ``collect`` gets nothing of it."""
    from paho.mqtt.client import Client
    from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

    got: list[bytes] = []
    other = Client(CallbackAPIVersion.VERSION2, "other", protocol=MQTTProtocolVersion.MQTTv5)
    other.username_pw_set("ann", "secret")
    other.on_connect = lambda client, *_: client.subscribe("#", qos=1)
    other.on_message = lambda client, data, message: got.append(bytes(message.payload))
    other.connect("localhost", broker.port)
    other.loop_start()
    try:
        time.sleep(0.5)
        for day in ("2025-01-01", "2025-02-01"):
            put(plant, "J1", day)
        address = read_address(f"mqtt://localhost:{broker.port}/plant/r1")
        watched(plant, publish=address, credentials=ANN)
        assert len(got) >= 2
        assert collected(plant, broker) == []
        with patch("bayesbl.fleet.broker.SEND_ALL_AFTER_S", 0.2):
            watched(plant, publish=address, credentials=ANN)
        assert len(collected(plant, broker)) == 2
    finally:
        other.loop_stop()
        other.disconnect()


def test_two_devices_with_one_joint_name_keep_their_rows(plant, broker, tmp_path):
    collected(plant, broker)
    own = Found.identity.fget
    for robot in ("r1", "r2"):
        place = tmp_path / robot
        place.mkdir()
        for name in ("joints.csv", "plant.toml"):
            shutil.copy(plant / name, place / name)
        put(place, "J1", "2025-01-01", f"J1 of {robot}")
        # The same path in the row of both, as on two devices of one image.
        with patch.object(Found, "identity", property(lambda one: own(one) | ONE_IMAGE)):
            address = read_address(f"mqtt://localhost:{broker.port}/plant/{robot}")
            watched(place, publish=address, credentials=ANN)
    rows = collected(plant, broker)
    assert len({row["sha256"] for row in rows}) == len({row["device"] for row in rows}) == 2
    assert {row["outcome"] for row in rows} == {"usable"}
