"""``bayesbl watch`` and ``collect``: a row for each recording, where it is made and where all are.

``watch`` measures recordings as they appear, on a small device. Each is measured as by ``bayesbl
fleet``, and its answer is kept where a fleet of the same configuration looks for it. The answer is
first stored by its content, then becomes a row, then is sent. So a power cut does no harm at any
moment: a recording without a row is continued from the store, and an answer sent twice is one row.

``collect`` puts what ``watch`` publishes into one table, each answer once. A message is
acknowledged when its row is on disk. So a power cut loses nothing, and a message that comes twice
is one row. A message that cannot be used is reported with the reason.
"""

from __future__ import annotations

import gc
import os
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesbl.config.kinds import FleetConfig
from bayesbl.errors import BrokerError, ConfigError
from bayesbl.fleet.broker import (
    LARGEST_MESSAGE_BYTES,
    Address,
    Credentials,
    OnlyOnce,
    Sender,
    decoded_answer,
    make_client,
    start,
    stays_known_by,
    unreachable,
)
from bayesbl.fleet.inventory import (
    FileState,
    Found,
    Joint,
    file_state,
    find_recordings,
    read_joints,
)
from bayesbl.fleet.measured_joint import (
    CHANGED,
    REFUSED,
    JointJob,
    RecordingAnswer,
    measure_recording,
)
from bayesbl.fleet.plant_tables import RecordingTable, recording_row
from bayesbl.results.folder import sibling
from bayesbl.results.work import STORE, WorkStore
from bayesbl.runs.fleet import KEPT

if TYPE_CHECKING:
    from paho.mqtt.client import Client, MQTTMessage

SETTLED_S = 5.0  # time without a change of size or date after which a file is complete
POLL_S = 1.0
LARGEST_KEPT_BYTES = 500_000_000  # of answers, and of finished fits; the oldest are deleted
LAST_SENT_WAIT_S = 30.0  # how long a run that ends waits for the broker


@dataclass(frozen=True, slots=True)
class Watched:
    """What to watch, and how; ``once``: end when everything is measured and sent."""

    folder: Path
    output: Path
    publish: Address | None = None
    credentials: Credentials = field(default_factory=Credentials)
    once: bool = False
    settled_s: float = SETTLED_S


def watch(
    config: FleetConfig,
    asked: Watched,
    say: Callable[[str], None],
    tell: Callable[[Mapping[str, Any]], None],
) -> None:
    """Measure what appears until interrupted or, with ``once``, until nothing is left.

    ``tell`` is called with each new row. Raises UserError if configuration, inventory, output
    folder or credentials cannot be used, and OSError if nothing can be written; what was measured
    before is safe.
    """
    config = _with_folder(config, asked.folder)
    joints = {joint.name: joint for joint in read_joints(config.fleet)}
    with RecordingTable.opened(asked.output) as table:
        store = WorkStore(sibling(config.run.output, KEPT))
        with _sending(asked, table, say) as offer:
            _watch(asked, _Measuring(config, joints, table, store, offer, tell))


def _with_folder(config: FleetConfig, folder: Path) -> FleetConfig:
    """The configuration with the folder of its pattern replaced."""
    if not config.fleet.is_pattern:
        raise ConfigError(
            "New recordings are found by a pattern, not by a table.",
            where="[fleet] recordings",
            found=config.fleet.recordings,
            expected='a pattern such as "data/{joint}/{date}.csv"',
        )
    if not folder.is_dir():
        raise ConfigError(
            "There is no such folder.", where="FOLDER", found=folder, expected="an existing folder"
        )
    parts = Path(config.fleet.recordings).parts
    first = next(n for n, part in enumerate(parts) if re.search(r"\{(joint|date)\}", part))
    pattern = Path(os.path.abspath(folder), *parts[first:])
    section = config.fleet.model_copy(update={"recordings": str(pattern)})
    return config.model_copy(update={"fleet": section})


@contextmanager
def _sending(
    asked: Watched, table: RecordingTable, say: Callable[[str], None]
) -> Iterator[Callable[[list[dict[str, Any]]], None]]:
    """Send all rows, and those that the block offers, if there is an address."""
    if asked.publish is None:
        yield lambda rows: None
        return
    sender = Sender(table.beside, asked.publish, asked.credentials, say)
    sender.offer(table.rows)
    wait_s = 0.0
    try:
        yield sender.offer
        wait_s = LAST_SENT_WAIT_S
    finally:
        unsent = sender.stop(wait_s)
        if unsent:
            say(f"Answers that the broker has not taken yet: {unsent}. They are sent again.")


def _watch(asked: Watched, measuring: _Measuring) -> None:
    since: dict[tuple[str, FileState], float] = {}
    done: set[tuple[str, FileState]] = set()
    while True:
        now = time.monotonic()
        files = {
            (one.file, state): one
            for one in find_recordings(measuring.config.fleet, list(measuring.joints.values()))
            if (state := file_state(one.file)) is not None
        }
        since = {version: since.get(version, now) for version in files}
        done &= files.keys()
        for version, one in files.items():
            is_settled = (
                now - since[version] >= asked.settled_s and file_state(one.file) == version[1]
            )
            if version not in done and is_settled and measuring.took(one):
                done.add(version)
        if asked.once and files.keys() <= done:
            return
        measuring.offer([])
        time.sleep(min(POLL_S, asked.settled_s) if asked.once else POLL_S)


@dataclass(frozen=True, slots=True)
class _Measuring:
    """Turns a complete recording into a row."""

    config: FleetConfig
    joints: Mapping[str, Joint]
    table: RecordingTable
    store: WorkStore
    offer: Callable[[list[dict[str, Any]]], None]
    tell: Callable[[Mapping[str, Any]], None]

    def took(self, one: Found) -> bool:
        """Whether a recording has a row now; one that is being changed is left for later."""
        listed, one = one, one.read()
        if one.reason != listed.reason and file_state(one.file) is None:
            return False  # it has been taken away
        if one.sha256 is None:
            answer = RecordingAnswer(REFUSED, one.reason)
        elif self.table.holds_measured(joint=one.joint, sha256=one.sha256):
            return True
        else:
            answer = self._answer(one)
            if answer is CHANGED:
                return False
        self._put(one, answer)
        gc.collect()  # measuring leaves arrays in circles, which would pile up over recordings
        return True

    def _answer(self, one: Found) -> RecordingAnswer:
        job = JointJob.of(self.config, self.joints[one.joint], [one])
        problem = job.problem_of(0)
        answer = self.store.recall("recording", problem, RecordingAnswer)
        if answer is None:
            answer = measure_recording(job, 0)
            if answer.lasting:
                self.store.keep("recording", problem, answer)
        for kept in (self.store, WorkStore.shared(self.config.run.output.parent / STORE)):
            kept.keep_latest(size_bytes=LARGEST_KEPT_BYTES)
        return answer

    def _put(self, one: Found, answer: RecordingAnswer) -> None:
        used = False if answer.outcome == REFUSED else None
        row = recording_row(answer, self.joints.get(one.joint), used, self.config.interval)
        row |= one.identity
        if self.table.put(row):
            self.table.save()
            self.offer([row])
            self.tell(row)


IDLE_S = 5.0  # silence after which ``--once`` ends
CONNECTED_WITHIN_S = 10.0
_HEAD_BYTES = 4_000  # size of a packet besides its message
_POLL_S = 0.1


def collect(
    address: Address,
    credentials: Credentials,
    output: Path,
    say: Callable[[str], None],
    tell: Callable[[Mapping[str, Any]], None],
    *,
    once: bool = False,
) -> None:
    """Store answers from the broker until interrupted or, with ``once``, until no more come.

    ``tell`` is called with each new row. Raises UserError if the output folder or the credentials
    cannot be used; with ``once``, also if the broker cannot be reached or refuses. Raises OSError
    if nothing can be written: what is not stored is not acknowledged.
    """
    with RecordingTable.opened(output) as table:
        name = stays_known_by(table.beside)
        client = make_client(address, credentials, name, acknowledge_by_hand=True)
        collecting = _Collecting(address, table, OnlyOnce(say), say, tell, once)
        client.on_connect = collecting.on_connect
        client.on_connect_fail = collecting.on_connect_fail
        client.on_subscribe = collecting.on_subscribe
        client.on_message = collecting.on_message
        start(client, address, MaximumPacketSize=LARGEST_MESSAGE_BYTES + _HEAD_BYTES)
        try:
            while not collecting.is_over:
                time.sleep(_POLL_S)
        finally:
            client.disconnect()
            client.loop_stop()
    if collecting.problem is not None:
        raise collecting.problem


@dataclass(slots=True)
class _Collecting:
    """Callbacks for paho's thread, which reconnects by itself."""

    address: Address
    table: RecordingTable
    say: OnlyOnce
    say_always: Callable[[str], None]
    tell: Callable[[Mapping[str, Any]], None]
    once: bool
    problem: Exception | None = None
    last: float = field(default_factory=lambda: time.monotonic() + CONNECTED_WITHIN_S)

    @property
    def is_over(self) -> bool:
        """Whether nothing more is expected."""
        is_idle = time.monotonic() - self.last > IDLE_S
        return self.problem is not None or (self.once and is_idle)

    def on_connect(
        self, client: Client, data: object, flags: object, reason: Any, more: object
    ) -> None:
        """Subscribe to the topic and those below it, even if the session already had."""
        if reason.is_failure:
            self._refused(reason)
        else:
            client.subscribe(f"{self.address.topic}/#", qos=1)

    def on_connect_fail(self, client: Client, data: object) -> None:
        """Report that there is no connection."""
        reason = unreachable(self.address, sys.exception())
        self.say(f"{reason} It is tried again.")
        if self.once:
            self.problem = BrokerError(reason)

    def on_subscribe(
        self, client: Client, data: object, mid: int, reasons: list[Any], more: object
    ) -> None:
        """Report that answers can arrive."""
        if reasons[0].is_failure:
            self._refused(reasons[0])
        else:
            self.last = time.monotonic()
            self.say(f"Waiting for answers from {self.address.in_words}.")

    def on_message(self, client: Client, data: object, message: MQTTMessage) -> None:
        """Write the answer to disk, then acknowledge it."""
        if self.problem is not None:
            return
        payload, row = bytes(message.payload), None
        try:
            answer = decoded_answer(payload)
            row = answer if self.table.put(answer) else None
        except Exception as error:
            # Whatever a message does, it is acknowledged, or it would come again for ever.
            reason = str(error) if isinstance(error, ValueError) else type(error).__name__
            size, topic = len(payload), message.topic
            self.say_always(f"A message of {size} bytes on {topic!r} cannot be used: {reason}.")
        try:
            self.table.save()
        except OSError as error:
            self.problem = error
            return
        client.ack(message.mid, message.qos)
        self.last = time.monotonic()
        if row is not None:
            self.tell(row)

    def _refused(self, reason: object) -> None:
        self.say(f"The broker refuses {self.address.in_words}: {reason}. It is tried again.")
        if self.once:
            self.problem = BrokerError(
                "The broker refuses.",
                where=self.address.in_words,
                found=str(reason),
                expected="to be let in",
            )
