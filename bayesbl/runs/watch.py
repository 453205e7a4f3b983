"""``bayesbl watch``: measure recordings as they appear, on a small device, a row for each.

Each is measured as by ``bayesbl fleet``, and its answer is kept where a fleet of the same
configuration looks for it. The answer is first stored by its content, then becomes a row, then is
sent. So a power cut does no harm at any moment: a recording without a row is continued from the
store, and an answer sent twice is one row.
"""

from __future__ import annotations

import gc
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayesbl.config.kinds import FleetConfig
from bayesbl.errors import ConfigError
from bayesbl.fleet.broker import Address, Credentials, Sender
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
