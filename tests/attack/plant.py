"""A plant whose devices, collector, fleet and broker are killed: each answer is there once.

``python tests/attack/plant.py --count 50 --seed 16``: each turn kills one of them at a random
moment, gives the same commands again and compares what they end with. Every process is a fork of
this one, so that a turn costs no import, and what a recording says is not fitted but made of its
content: a turn is about what is kept.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))

import numpy as np
from mosquitto import Broker

KINDS = ("watch", "fleet", "collect", "broker")
LONGEST_S = 120.0
"""After which a process that should have ended hangs."""

FLEET = """schema = 1
kind = "fleet"
[fleet]
joints = "joints.csv"
recordings = "data/{joint}/{date}.csv"
[run]
workers = 1
output = "plant"
"""
DAYS = ("2025-01-01", "2025-02-01", "2025-03-01", "2025-04-01")
ROUNDS = 2
"""On a busy machine a collector that ends by itself may do so before all has come."""
Row = tuple[Any, ...]


def put_plant(place: Path) -> None:
    """Recordings that are measured, one a joint that cannot be, and those of no joint."""
    place.mkdir()
    (place / "joints.csv").write_text("joint,gear_ratio\nJ1,120\nJ2,120\n")
    (place / "plant.toml").write_text(FLEET)
    for joint in ("J1", "J2", "J3"):
        (place / "data" / joint).mkdir(parents=True)
        for day in DAYS:
            (place / f"data/{joint}/{day}.csv").write_text(f"{joint} of {day}")


def forked(work: Callable[[], object], place: Path) -> int:
    """A process of its own that does this and ends; what it says goes to ``said.txt``."""
    child = os.fork()
    if child == 0:
        status = 70
        try:
            os.setsid()
            said = os.open(place / "said.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            for stream in (1, 2):
                os.dup2(said, stream)
            os.chdir(place)
            status = int(work() or 0)  # type: ignore[call-overload]
        except BaseException:
            import traceback

            os.write(2, traceback.format_exc().encode())
        finally:
            os._exit(status)
    return child


def ended(child: int) -> int | None:
    """Status of a process once it has ended; ``None`` if it never does, when it is killed."""
    end = time.monotonic() + LONGEST_S
    while time.monotonic() < end:
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    killed(child)
    return None


def killed(child: int) -> None:
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)


def measured(job: Any, number: int) -> Any:
    """An answer in place of a fit, which takes a moment."""
    from bayesbl.errors import RecordingError
    from bayesbl.fleet.measured_joint import REFUSED, RecordingAnswer

    one = job.recordings[number]
    time.sleep(0.05)
    if one.date == DAYS[1]:
        return RecordingAnswer(REFUSED, str(RecordingError("It is too short.", file=one.file)))
    amplitude = int(job.recordings[number].sha256[:4], 16) / 1000.0
    return RecordingAnswer(
        "no_curve", "No curve.", route="amplitude", amplitude_rpm=(amplitude, 0.0, 70.0)
    )


def command(*arguments: str) -> Callable[[], int]:
    def work() -> int:
        from bayesbl.cli import status
        from bayesbl.fleet import measured_joint
        from bayesbl.runs import collect, watch

        measured_joint.measure_recording = watch.measure_recording = measured  # type: ignore
        collect.IDLE_S = 1.0
        return status(list(arguments))

    return work


def rows(table: Path) -> list[Row]:
    """What a table says of each recording, wherever it lies and whoever sent it."""
    from pyarrow.parquet import read_table

    found = read_table(table, use_threads=False).to_pylist() if table.exists() else []
    place = str(table.parent.parent)
    left_out = ("device", "used")
    return sorted(
        tuple(str(v).replace(place, "") for name, v in row.items() if name not in left_out)
        for row in found
    )


@dataclass
class Turn:
    """One turn: a plant, and what is done to it."""

    place: Path
    kind: str
    broker: Broker | None = None

    @property
    def url(self) -> str:
        assert self.broker is not None
        return f"mqtt://localhost:{self.broker.port}/{self.place.name}"

    def arguments(self, what: str) -> tuple[str, ...]:
        credentials = ("--credentials", "broker.toml") if self.broker else ()
        publish = ("--publish", f"{self.url}/r1") if self.broker else ()
        watch = ("watch", "data", "--config", "plant.toml", "--settled-s", "0.01")
        return {
            "fleet": ("fleet", "plant.toml"),
            "watch": (*watch, "--once", *publish, *credentials),
            "collect": ("collect", self.url if self.broker else "", "--out", "all", *credentials),
        }[what]

    def start(self, what: str, *, once: bool = True) -> int:
        again = ("--once",) if once and what == "collect" else ()
        return forked(command(*self.arguments(what), *again), self.place)

    def put(self) -> None:
        put_plant(self.place)
        if self.broker is not None:
            file = self.place / "broker.toml"
            file.touch(0o600)
            file.write_text('user = "ann"\npassword = "secret"\n')

    @property
    def table(self) -> Path:
        name = {"watch": "plant_watched", "fleet": "plant"}.get(self.kind, "all")
        return self.place / name / "recordings.parquet"

    def undisturbed(self) -> tuple[float, list[Row]]:
        """How long the process takes that is to be killed, and the rows."""
        self.put()
        if self.broker is not None:
            assert ended(self.start("collect")) == 0
        begin = time.monotonic()
        statuses = [ended(self.start("watch" if self.broker else self.kind))]
        seconds = time.monotonic() - begin
        if self.broker is not None:
            statuses.append(ended(self.start("collect")))
        if any(status not in (0, 3) for status in statuses):
            raise RuntimeError(f"{self.kind}: {statuses}: {(self.place / 'said.txt').read_text()}")
        return seconds, rows(self.table)

    def disturbed(self, after_s: float, rng: np.random.Generator) -> None:
        """Something is killed at a moment; then the same commands are given again."""
        self.put()
        if self.broker is None:
            child = self.start(self.kind)
            time.sleep(after_s)
            killed(child)
            self.finish(self.kind)
            return
        collector = self.start("collect", once=False)
        if self.kind == "broker" and rng.integers(2):
            time.sleep(0.5)
            killed(collector)  # it is away for all that follows, as the answers are sent
        device = self.start("watch")
        time.sleep(after_s)
        if self.kind == "collect":
            killed(collector)
        else:
            self.broker.stop(kill=True)
            if rng.integers(2):
                killed(device)
            self.broker.start()
        for child in (device, collector):
            try:
                if child == device:
                    ended(child)
                else:
                    killed(child)
            except (ChildProcessError, ProcessLookupError):
                pass  # it was killed before
        # The broker learns of the collector, which may never have been there; then a week passes.
        self.finish("collect")
        for sent in self.place.rglob("sent.json"):
            sent.unlink()
        self.finish("watch")
        for _ in range(ROUNDS):
            self.finish("collect")

    def finish(self, what: str) -> None:
        status = ended(self.start(what))
        if status not in (0, 3):
            said = (self.place / "said.txt").read_text(errors="replace")
            raise RuntimeError(f"{what} ended with {status}: {said[-400:]}")

    def wrong(self, expected: list[Row]) -> Iterator[str]:
        """What is wrong at the end."""
        found = rows(self.table)
        if found != expected:
            yield f"{len(found)} rows, {len(set(found) & set(expected))} of {len(expected)} right"
        said = (self.place / "said.txt").read_text(errors="replace")
        if "Traceback" in said or "This is a bug" in said:
            yield said[-400:]
        left = [path.name for path in self.place.rglob(".*.staging")]
        if left:
            yield f"left behind: {', '.join(left[:3])}"


def listener(broker: Broker) -> Callable[[], int]:
    """A second subscriber, on everything, for as long as it lives: it takes what is published."""

    def work() -> int:
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

        client = Client(CallbackAPIVersion.VERSION2, "another", protocol=MQTTProtocolVersion.MQTTv5)
        client.username_pw_set("ann", "secret")
        client.on_connect = lambda own, *_: own.subscribe("#", qos=1)
        client.reconnect_delay_set(1, 1)
        client.connect("localhost", broker.port)
        client.loop_forever()
        return 0

    return work


def warm(folder: Path) -> None:
    """Import what the processes need, and ask what is asked once, before they are forked."""
    import pyarrow.compute
    from paho.mqtt.client import Client  # noqa: F401

    from bayesbl import library
    from bayesbl.results.work import code_identity
    from bayesbl.runs import collect, fleet, watch  # noqa: F401

    del library, pyarrow
    code_identity()
    put_plant(folder / "warm")
    with chdir(folder / "warm"):
        for work in ("fleet", "watch"):
            assert command(*Turn(folder / "warm", work).arguments(work))() in (0, 3)


class Plants:
    """Turns of all kinds, in a folder; a broker for those that need one."""

    def __init__(self, folder: Path) -> None:
        warm(folder)
        self.folder = folder
        self.broker = Broker(folder / "mosquitto")
        self.broker.start()
        self.listener = forked(listener(self.broker), folder)
        self.known: dict[str, tuple[float, list[Row]]] = {}

    def turn(self, name: str, kind: str) -> Turn:
        broker = self.broker if kind in ("collect", "broker") else None
        return Turn(self.folder / name, kind, broker)

    def killed(self, name: str, kind: str, rng: np.random.Generator) -> tuple[float, list[str]]:
        """When something was killed, and what was then wrong."""
        if kind not in self.known:
            turn = self.turn(f"{kind}-undisturbed", kind)
            self.known[kind] = turn.undisturbed()
        seconds, expected = self.known[kind]
        turn, after_s = self.turn(name, kind), float(rng.uniform(0.0, seconds))
        try:
            turn.disturbed(after_s, rng)
            return after_s, list(turn.wrong(expected))
        except RuntimeError as error:
            return after_s, [str(error)]

    def close(self) -> None:
        killed(self.listener)
        self.broker.stop()


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status: 1 if any turn failed."""
    parser = argparse.ArgumentParser(description="Kill the parts of a plant at random moments.")
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=16)
    parser.add_argument("--only", choices=KINDS)
    options = parser.parse_args(arguments)
    rng, failed = np.random.default_rng(options.seed), Counter[str]()
    kinds = [options.only] if options.only else KINDS
    with tempfile.TemporaryDirectory(prefix="kills-") as temporary:
        folder = Path(temporary)
        plants = Plants(folder)
        try:
            for turn in range(options.count):
                kind = kinds[turn % len(kinds)]
                after_s, problems = plants.killed(f"turn{turn}", kind, rng)
                failed[kind] += bool(problems)
                told = "; ".join(problems) or "well"
                print(f"{turn}: {kind}, killed after {after_s:.2f} s: {told}", flush=True)
                if not problems:
                    shutil.rmtree(folder / f"turn{turn}", ignore_errors=True)
        finally:
            plants.close()
    print(f"{options.count} turns, badly: {dict(failed)}")
    return int(failed.total() > 0)


if __name__ == "__main__":
    sys.exit(main())
