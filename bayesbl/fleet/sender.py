"""Messages of an outbox sent one after the other, while something else is being done."""

from __future__ import annotations

import queue
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bayesbl.fleet.broker import (
    FIRST_WAIT_S,
    LONGEST_WAIT_S,
    Address,
    Credentials,
    OnlyOnce,
    make_client,
    session,
    unreachable,
)
from bayesbl.fleet.outbox import Outbox

NOBODY_LISTENS = 16
"""MQTT 5's reason code where no client, present or away, has asked for the topic."""

_POLL_S = 0.5


class Sender:
    """Sends what waits in an outbox at least once (QoS 1) and in order; connects by itself.

    One message is on its way at a time, and its file goes when the broker has acknowledged it. What
    the broker refuses, or nobody would get, stays and is sent again later.
    """

    def __init__(
        self,
        outbox: Outbox,
        address: Address,
        credentials: Credentials,
        name: str,
        say: Callable[[str], None],
    ) -> None:
        self._outbox, self._address, self._say = outbox, address, OnlyOnce(say)
        self._client = make_client(address, credentials, name, acknowledge_by_hand=False)
        self._client.on_publish = self._on_publish
        self._client.on_connect = self._on_connect
        self._client.on_connect_fail = self._on_connect_fail
        self._answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._idle = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Begin to connect and to send."""
        self._client.connect_async(
            self._address.host, self._address.port, clean_start=False, properties=session()
        )
        self._client.loop_start()
        self._thread.start()

    def stop(self, wait_s: float = 0.0) -> int:
        """End, once nothing waits or after a time; how many messages wait still."""
        self._idle.clear()
        if self._outbox.waiting():
            self._idle.wait(wait_s)
        self._stop.set()
        self._thread.join()
        self._client.disconnect()
        self._client.loop_stop()
        return len(self._outbox.waiting())

    def _run(self) -> None:
        pause = FIRST_WAIT_S
        while not self._stop.is_set():
            waiting = self._outbox.waiting()
            if not waiting:
                self._idle.set()
                self._stop.wait(_POLL_S)
            elif self._sent(waiting[0]):
                pause = FIRST_WAIT_S
            else:
                self._stop.wait(pause)
                pause = min(2 * pause, LONGEST_WAIT_S)

    def _sent(self, file: Path) -> bool:
        """Whether the broker has taken a message; it is waited for however long that takes."""
        self._client.publish(self._address.topic, file.read_bytes(), qos=1)
        while not self._stop.is_set():
            try:
                reason = self._answers.get(timeout=_POLL_S)
            except queue.Empty:
                continue
            if reason.value == NOBODY_LISTENS:
                self._say(
                    f"Nobody has asked for {self._address.in_words} yet: answers wait until "
                    "`bayesbl collect` has been there once."
                )
                return False
            if reason.is_failure:
                self._say(f"The broker refuses {self._address.in_words}: {reason}. Answers wait.")
                return False
            self._say(f"Answers go to {self._address.in_words}.")
            file.unlink()
            return True
        return False

    # Called by paho's thread, which holds locks that publish() takes: nothing is done here.
    def _on_publish(
        self, client: object, data: object, mid: int, reason: Any, more: object
    ) -> None:
        self._answers.put(reason)

    def _on_connect(
        self, client: object, data: object, flags: object, reason: Any, more: object
    ) -> None:
        if reason.is_failure:
            self._say(f"The broker does not let us in: {reason}. Answers wait.")

    def _on_connect_fail(self, client: object, data: object) -> None:
        self._say(f"{unreachable(self._address, sys.exception())} Answers wait until it can.")
