"""``bayesbl collect``: what ``watch`` publishes, as rows of one table, each answer once.

When its row is on the disk, a message is acknowledged: a cut at any moment loses nothing, and what
then comes twice is one row. Of a message that cannot be used the reason is said.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesbl.errors import BrokerError
from bayesbl.fleet.broker import (
    FIRST_WAIT_S,
    LONGEST_WAIT_S,
    Address,
    Credentials,
    OnlyOnce,
    make_client,
    refused,
    session,
    stays_known_by,
    unreachable,
)
from bayesbl.fleet.message import LARGEST_MESSAGE_BYTES, decoded_answer
from bayesbl.fleet.recording_table import RecordingTable

if TYPE_CHECKING:
    from paho.mqtt.client import Client, MQTTMessage

IDLE_S = 5.0
"""Without a message, after which nothing more is waited for (``--once``)."""

MOST_AT_ONCE = 200
"""Messages that are stored, and acknowledged, together."""

_HEAD_BYTES = 4_000
"""Of a packet, beside its message."""


def collect(
    address: Address,
    credentials: Credentials,
    output: Path,
    say: Callable[[str], None],
    tell: Callable[[Mapping[str, Any]], None],
    *,
    once: bool = False,
) -> None:
    """Store what the broker brings, until interrupted or, ``once``, until nothing more comes.

    Parameters
    ----------
    tell
        Called with each new row.

    Raises
    ------
    UserError
        If the output folder or the credentials cannot be used; once, also if the broker cannot be
        reached, or does not let us in.
    OSError
        If nothing can be written: what was not stored is not acknowledged.
    """
    with RecordingTable.opened(output) as table:
        name = stays_known_by(table.beside)
        client = make_client(address, credentials, name, acknowledge_by_hand=True)
        collecting = _Collecting(client, address, table, OnlyOnce(say), say, tell, once)
        client.on_connect = collecting.on_connect
        client.on_subscribe = collecting.on_subscribe
        client.on_message = collecting.on_message
        try:
            collecting.run()
        finally:
            client.disconnect()


@dataclass(slots=True)
class _Collecting:
    """One thread: no acknowledgement can meet another connection than its message came by."""

    client: Client
    address: Address
    table: RecordingTable
    say: OnlyOnce
    say_always: Callable[[str], None]
    tell: Callable[[Mapping[str, Any]], None]
    once: bool
    arrived: list[MQTTMessage] = field(default_factory=list)
    refusal: str | None = None
    pause_s: int = FIRST_WAIT_S
    last: float = field(default_factory=time.monotonic)

    def run(self) -> None:
        """Receive, store, acknowledge, and connect again where that is needed."""
        properties = session(MaximumPacketSize=LARGEST_MESSAGE_BYTES + _HEAD_BYTES)
        while True:
            self.refusal = None
            try:
                self.client.connect(
                    self.address.host,
                    self.address.port,
                    clean_start=False,
                    properties=properties,
                )
            except OSError as error:
                told = unreachable(self.address, error)
                if self.once:
                    raise BrokerError(told) from None
                self.say(f"{told} It is tried again.")
            else:
                self.last = time.monotonic()
                if self._received():
                    return
                if self.once and self.refusal:
                    raise refused(self.address, self.refusal)
            time.sleep(self.pause_s)
            self.pause_s = min(2 * self.pause_s, LONGEST_WAIT_S)

    def _received(self) -> bool:
        """Until the connection ends; whether that was all."""
        while not self.client.loop(1.0):
            while self.arrived and len(self.arrived) < MOST_AT_ONCE:
                count = len(self.arrived)
                if self.client.loop(0.02) or len(self.arrived) == count:
                    break
            if self.arrived:
                self._store()
                self.last = time.monotonic()
            if self.refusal:
                return False
            if self.once and time.monotonic() - self.last > IDLE_S:
                return True
        self._store()
        if not self.refusal:
            self.say(f"The connection to {self.address.in_words} ended. It is tried again.")
        return False

    def _store(self) -> None:
        """First on the disk, then acknowledged."""
        rows = []
        for message in self.arrived:
            payload = bytes(message.payload)
            try:
                rows += self.table.put(decoded_answer(payload))
            except OSError:
                raise  # the disk's, not the message's
            except Exception as error:
                # Whatever a message does, it is acknowledged, or it would come again for ever.
                told = str(error) if isinstance(error, ValueError) else type(error).__name__
                size, topic = len(payload), message.topic
                self.say_always(f"A message of {size} bytes on {topic!r} cannot be used: {told}.")
        self.table.save()
        for message in self.arrived:
            self.client.ack(message.mid, message.qos)
        self.arrived.clear()
        for row in rows:
            self.tell(row)

    def on_connect(
        self, client: Client, data: object, flags: object, reason: Any, more: object
    ) -> None:
        """Ask for the topic and those below it, as the session may have done before."""
        if reason.is_failure:
            self._refused(str(reason))
        else:
            client.subscribe(f"{self.address.topic}/#", qos=1)

    def on_subscribe(
        self, client: Client, data: object, mid: int, reasons: list[Any], more: object
    ) -> None:
        """Say that answers can come."""
        if reasons[0].is_failure:
            self._refused(str(reasons[0]))
        else:
            self.pause_s = FIRST_WAIT_S
            self.say(f"Waiting for answers from {self.address.in_words}.")

    def on_message(self, client: Client, data: object, message: MQTTMessage) -> None:
        """Keep a message until it is stored."""
        self.arrived.append(message)

    def _refused(self, reason: str) -> None:
        self.refusal = reason
        self.say(f"The broker refuses {self.address.in_words}: {reason}. It is tried again.")
