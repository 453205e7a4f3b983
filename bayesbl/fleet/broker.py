"""A broker of messages (MQTT 5): where it is, who we are to it, what it says when it refuses.

What a device has to say waits on its disk until ``collect`` says that it is stored.

A broker carries it; that it has taken a message says nothing: another client may have asked
for the topic, and a broker may lose what it holds. So each message is known by its SHA-256, which
``collect`` sends back once its row is on the disk; until then the message is sent again, each time
after twice as long, so that few copies of it wait at a broker while ``collect`` is away.
"""

from __future__ import annotations

import json
import os
import queue
import ssl
import stat
import sys
import threading
import time
import tomllib
import uuid
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit

from bayesbl.errors import BrokerError, ConfigError
from bayesbl.fleet.message import REPLIES, name_of, replies
from bayesbl.recording.channels import did_you_mean
from bayesbl.recording.input_bytes import read_input
from bayesbl.results.atomic import PrivateFolder

if TYPE_CHECKING:
    from paho.mqtt.client import Client


PORTS = {"mqtt": 1883, "mqtts": 8883}

LOOPBACK = ("localhost", "127.0.0.1", "::1")

FIRST_WAIT_S, LONGEST_WAIT_S = 1, 120
"""Between attempts to reach a broker; doubled each time."""

_EXPECTED = "mqtts://broker/topic, or mqtts://broker:8883/plant/cell4"
_CLIENT = "client"


@dataclass(frozen=True, slots=True)
class Address:
    """Of a topic at a broker."""

    host: str
    port: int
    topic: str
    encrypted: bool

    @property
    def in_words(self) -> str:
        """As it may be printed."""
        return f"{self.topic} at {self.host}:{self.port}"

    @property
    def open_to_others(self) -> str | None:
        """A warning where password and answers can be read on their way."""
        if self.encrypted or self.host in LOOPBACK:
            return None
        return (
            f"Password and answers go to {self.host} without encryption, as mqtt:// says; "
            "mqtts:// encrypts them."
        )


@dataclass(frozen=True, slots=True)
class Credentials:
    """User and password, and the file of the authority that signed the broker's certificate."""

    user: str | None = None
    password: str | None = field(default=None, repr=False)
    ca: Path | None = None


def read_address(url: str) -> Address:
    """The address that a URL gives; nothing of a wrong one is repeated, as it may hold a password.

    Raises
    ------
    ConfigError
        Saying what is wrong with it.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        raise ConfigError("This address cannot be read.", expected=_EXPECTED) from None
    if parts.username is not None or parts.password is not None:
        raise ConfigError(
            "User and password do not belong in an address: others can read it.",
            where="URL",
            expected="a file with them (--credentials FILE)",
        )
    topic = unquote(parts.path).strip("/")
    if parts.scheme not in PORTS or not host:
        raise ConfigError("This is no address of a broker.", where="URL", expected=_EXPECTED)
    wrong = not topic or topic.startswith("$") or any(sign in topic for sign in "+#\0")
    wrong |= topic.rpartition("/")[2] == REPLIES
    if wrong or parts.query or parts.fragment:
        raise ConfigError(
            "This address names no topic.",
            where="URL",
            expected=f"{_EXPECTED}; collect takes what is below its topic too",
        )
    return Address(host, port or PORTS[parts.scheme], topic, parts.scheme == "mqtts")


def read_credentials(file: Path | None) -> Credentials:
    """Credentials from a TOML file that nobody else can read.

    Raises
    ------
    ConfigError
        If it cannot be read or holds anything else; none of its content is repeated.
    """
    if file is None:
        return Credentials()
    expected = 'user = "…", password = "…" and, if need be, ca = "ca.crt"'
    try:
        mode = os.stat(file).st_mode
        content = tomllib.loads(read_input(file).decode("utf-8-sig"))
    except OSError as error:
        raise ConfigError(
            "The credentials cannot be read.", file=file, found=error.strerror, expected=expected
        ) from None
    except (ValueError, RecursionError):
        raise ConfigError("This is no TOML.", file=file, expected=expected) from None
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise ConfigError(
            "Others can read these credentials.",
            file=file,
            found=f"permissions {stat.S_IMODE(mode):o}",
            expected=f"600: chmod 600 {file}",
        )
    keys = {"user", "password", "ca"}
    for key, value in content.items():
        if key not in keys or not isinstance(value, str):
            raise ConfigError(
                "This is not one of the credentials." + did_you_mean(key, keys),
                file=file,
                where=key,
                expected=expected,
            )
    ca = content.get("ca")
    path = None if ca is None else Path(os.path.normpath(file.parent / os.path.expanduser(ca)))
    if path is not None and not path.is_file():
        raise ConfigError(
            "There is no such file.", file=file, where="ca", found=path, expected="a certificate"
        )
    return Credentials(content.get("user"), content.get("password"), path)


def stays_known_by(folder: Path) -> str:
    """The name of this client at the broker, kept in a folder, so that its session goes on.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    file = folder / _CLIENT
    if not file.is_file():
        PrivateFolder(folder).write(_CLIENT, f"bayesbl-{uuid.uuid4().hex}".encode(), durable=True)
    return file.read_text()


def make_client(
    address: Address, credentials: Credentials, name: str, *, acknowledge_by_hand: bool
) -> Client:
    """A client that is not connected yet.

    Raises
    ------
    ConfigError
        If paho-mqtt is missing, or the authority's certificate is none.
    """
    try:
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
    except ImportError:
        raise ConfigError(
            "A broker needs a package that is not installed.",
            expected="pip install 'bayesbl[device]'",
        ) from None
    client = Client(
        CallbackAPIVersion.VERSION2,
        name,
        protocol=MQTTProtocolVersion.MQTTv5,
        manual_ack=acknowledge_by_hand,
    )
    client.reconnect_delay_set(FIRST_WAIT_S, LONGEST_WAIT_S)
    if credentials.user is not None:
        client.username_pw_set(credentials.user, credentials.password)
    if address.encrypted:
        try:
            client.tls_set(None if credentials.ca is None else str(credentials.ca))
        except (ssl.SSLError, OSError):
            raise ConfigError(
                "This is no certificate.", file=credentials.ca, expected="a file in PEM format"
            ) from None
    return client


def session(**more: int) -> Any:
    """Properties of a connection whose session the broker keeps."""
    return _properties("CONNECT", SessionExpiryInterval=0xFFFFFFFF, **more)  # never


def _properties(packet: str, **values: int) -> Any:
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.properties import Properties

    properties = Properties(getattr(PacketTypes, packet))  # type: ignore[no-untyped-call]
    for name, value in values.items():
        setattr(properties, name, value)
    return properties


def unreachable(address: Address, error: BaseException | None) -> str:
    """Why there is no connection, as a sentence."""
    if isinstance(error, ssl.SSLCertVerificationError):
        told = error.verify_message
    else:
        told = getattr(error, "strerror", None) or str(error)
    return f"{address.host}:{address.port} cannot be reached: {told}."


def refused(address: Address, reason: object) -> BrokerError:
    """The broker answers, and does not let us in."""
    return BrokerError(
        "The broker refuses.", where=address.in_words, found=str(reason), expected="to be let in"
    )


class OnlyOnce:
    """Says a sentence when it is another than the last: a broker may be away for days."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say, self._last = say, ""

    def __call__(self, text: str) -> None:
        if text != self._last:
            self._last = text
            self._say(text)


NOBODY_LISTENS = 16
"""MQTT 5's reason code where no client, present or away, has asked for the topic."""

FIRST_AGAIN_S, LONGEST_AGAIN_S = 600.0, 6 * 3600.0
"""After which a message is sent again; doubled each time."""

EXPIRES_S = 7 * 24 * 3600
"""After which a broker may forget a copy: some 30 of them are there at most."""

REPLY_S = 5.0
"""For which a run that ends by itself waits for ``collect``, once the broker has all."""

_POLL_S = 0.5
_DIGITS = 12
_WAITING, _ASIDE, _SENT_FILE = ".json", ".refused", "sent"

Again = dict[str, tuple[float, float]]
"""By file: when it is sent again, in seconds since 1970, and how long after the last time."""


@dataclass(frozen=True, slots=True)
class Outbox:
    """Messages that wait, a file each, numbered in the order in which they are to be sent.

    Attributes
    ----------
    device
        What this device calls itself in each of them.
    """

    folder: PrivateFolder
    device: str

    def put(self, message: bytes, subject: str) -> None:
        """Keep a message, unless it waits already; it is on the disk when this returns.

        An older one of the same subject goes: sent once more, it would take the newer one's place.

        Raises
        ------
        OSError
            If the disk is full, or the folder cannot be written for another reason.
        """
        waiting, name = self.waiting(), name_of(message)
        if not any(_name_in(file) == name for file in waiting):
            number = int(waiting[-1][:_DIGITS]) + 1 if waiting else 1
            about = name_of(subject.encode())[:_DIGITS]
            file = f"{number:0{_DIGITS}d}-{about}-{name}{_WAITING}"
            self.folder.write(file, message, durable=True)
            for older in waiting:
                if f"-{about}-" in older:
                    self.folder.delete(older)

    def waiting(self) -> list[str]:
        """Files of all messages that wait, the oldest first."""
        return sorted(name for name in self.folder.entries() if name.endswith(_WAITING))

    def sent(self) -> Again:
        """What the broker has taken, as far as that was kept."""
        try:
            kept = json.loads(self.folder.read(_SENT_FILE))
            return {str(file): (float(due), float(pause)) for file, (due, pause) in kept.items()}
        except (OSError, ValueError, TypeError, AttributeError):
            return {}

    def settle(self, stored: set[str], refused: set[str]) -> int:
        """Forget what is stored, set aside what was refused; how many of these there are now."""
        aside = [file for file in self.waiting() if _name_in(file) in refused]
        for file in aside:
            self.folder.write(file.removesuffix(_WAITING) + _ASIDE, self.folder.read(file))
        for file in self.waiting():
            if _name_in(file) in stored | refused:
                self.folder.delete(file)
        return len(aside)


def _name_in(file: str) -> str:
    return file.rpartition("-")[2].removesuffix(_WAITING)


class Sender:
    """Sends what waits in an outbox, in order and until it is stored; connects by itself."""

    def __init__(
        self,
        outbox: Outbox,
        address: Address,
        credentials: Credentials,
        say: Callable[[str], None],
    ) -> None:
        self._outbox, self._address, self._say = outbox, address, OnlyOnce(say)
        self._client = make_client(address, credentials, outbox.device, acknowledge_by_hand=False)
        self._client.on_publish = self._on_publish
        self._client.on_connect = self._on_connect
        self._client.on_subscribe = self._on_subscribe
        self._client.on_message = self._on_message
        self._client.on_connect_fail = self._on_connect_fail
        self._answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._again = outbox.sent()
        self._taken: set[str] = set()
        self._listening = threading.Event()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Begin to connect and to send."""
        self._client.connect_async(
            self._address.host, self._address.port, clean_start=False, properties=session()
        )
        self._client.loop_start()
        self._thread.start()

    def stop(self, wait_s: float = 0.0) -> int:
        """End, once nothing waits or after a time; how many messages are not stored yet.

        The time is for the broker; where it has them all, ``collect`` is waited for less long.
        """
        end = time.monotonic() + wait_s
        taken_until = time.monotonic() + REPLY_S
        while (waiting := self._outbox.waiting()) and time.monotonic() < end:
            if any(self._is_due(file) for file in waiting if file not in self._taken):
                taken_until = time.monotonic() + REPLY_S
            elif time.monotonic() > taken_until:
                break
            time.sleep(0.05)
        self._stop.set()
        self._thread.join()
        with suppress(OSError):  # what is lost of it is sent once more
            self._outbox.folder.write(_SENT_FILE, json.dumps(self._again).encode())
        self._client.disconnect()
        self._client.loop_stop()
        return len(self._outbox.waiting())

    def _run(self) -> None:
        pause = FIRST_WAIT_S
        while not self._stop.is_set():
            waiting = self._outbox.waiting()
            self._again = {file: self._again[file] for file in waiting if file in self._again}
            due = [file for file in waiting if self._is_due(file)]
            if not due or not self._listening.wait(_POLL_S):
                self._stop.wait(_POLL_S)
            elif self._sent(min(due, key=self._due_s)):
                pause = FIRST_WAIT_S
            else:
                self._stop.wait(pause)
                pause = min(2 * pause, LONGEST_WAIT_S)

    def _due_s(self, file: str) -> float:
        """When a message is to be sent: the oldest first of those that have not been."""
        return self._again.get(file, (0.0, 0.0))[0]

    def _is_due(self, file: str) -> bool:
        now = time.time()
        return not now < self._due_s(file) <= now + LONGEST_AGAIN_S  # a clock may be set

    def _sent(self, file: str) -> bool:
        """Whether the broker has taken a message; it is waited for however long that takes."""
        _, last_s = self._again.get(file, (0.0, 0.0))
        next_s = min(max(2.0 * last_s, FIRST_AGAIN_S), LONGEST_AGAIN_S)
        try:
            message = self._outbox.folder.read(file)
        except FileNotFoundError:
            return True  # it has just been stored
        forgotten = _properties("PUBLISH", MessageExpiryInterval=EXPIRES_S)
        self._client.publish(self._address.topic, message, qos=1, properties=forgotten)
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
            self._again[file] = time.time() + next_s, next_s
            self._taken.add(file)
            return True
        return False

    # Called by paho's thread, which holds locks that publish() takes: nothing is published here.
    def _on_publish(
        self, client: object, data: object, mid: int, reason: Any, more: object
    ) -> None:
        self._answers.put(reason)

    def _on_message(self, client: object, data: object, message: Any) -> None:
        # A disk that fails costs nothing but another copy of what is stored.
        with suppress(OSError):
            refused = self._outbox.settle(*replies(bytes(message.payload)))
            if refused:
                self._say(
                    f"`bayesbl collect` could not use {refused} of the answers; they are set aside "
                    f"in {self._outbox.folder.path}. Are both of one version?"
                )

    def _on_connect(self, client: Any, data: object, flags: Any, reason: Any, more: object) -> None:
        if reason.is_failure:
            self._say(f"The broker does not let us in: {reason}. Answers wait.")
        else:
            if not flags.session_present:  # the broker has lost what it knew
                self._again = {}
            client.subscribe(f"{self._address.topic}/{REPLIES}", qos=1)

    def _on_subscribe(
        self, client: object, data: object, mid: int, reasons: list[Any], more: object
    ) -> None:
        if reasons[0].is_failure:
            self._say(
                f"The broker does not let us read {self._address.topic}/{REPLIES}, where `bayesbl "
                f"collect` says what it has stored: {reasons[0]}. Answers wait."
            )
        else:
            self._listening.set()

    def _on_connect_fail(self, client: object, data: object) -> None:
        self._say(f"{unreachable(self._address, sys.exception())} Answers wait until it can.")
