"""``bayesbl collect``: collect what ``watch`` publishes into one table, each answer once.

A message is acknowledged when its row is on disk. So a power cut loses nothing, and a message that
comes twice is one row. A message that cannot be used is reported with the reason.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesbl.errors import BrokerError
from bayesbl.fleet.broker import (
    LARGEST_MESSAGE_BYTES,
    Address,
    Credentials,
    OnlyOnce,
    decoded_answer,
    make_client,
    refused,
    session,
    stays_known_by,
    unreachable,
)
from bayesbl.fleet.plant_tables import RecordingTable

if TYPE_CHECKING:
    from paho.mqtt.client import Client, MQTTMessage

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
        largest = session(MaximumPacketSize=LARGEST_MESSAGE_BYTES + _HEAD_BYTES)
        client.connect_async(address.host, address.port, clean_start=False, properties=largest)
        client.loop_start()
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
            self.problem = refused(self.address, reason)
