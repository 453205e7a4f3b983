"""A message broker (MQTT 5): its address, our credentials, its refusals; a sender of answers.

A message from a device to ``collect`` is a row of ``recordings.parquet`` as JSON. Messages come
from a network, so all that ``watch`` cannot have written is refused with a reason.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import ssl
import stat
import sys
import time
import tomllib
import uuid
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import date as Date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn
from urllib.parse import unquote, urlsplit

from pydantic import ConfigDict, Field, ValidationError, create_model

from bayesbl.config.loading import problems_of
from bayesbl.config.sections import BASE_DIRECTORY, LONGEST_NAME, InputPath, Section
from bayesbl.errors import ConfigError, shortened
from bayesbl.fleet.plant_tables import QUANTILE_COLUMNS, RECORDING_COLUMNS
from bayesbl.recording.input_bytes import read_input
from bayesbl.results.folder import replacing

if TYPE_CHECKING:
    from paho.mqtt.client import Client


PORTS = {"mqtt": 1883, "mqtts": 8883}

LOOPBACK = ("localhost", "127.0.0.1", "::1")
FIRST_WAIT_S, LONGEST_WAIT_S = 1, 120  # wait between attempts to reach a broker; doubled each time
_EXPECTED = "mqtts://broker/topic, or mqtts://broker:8883/plant/cell4"
_CLIENT = "client"


@dataclass(frozen=True, slots=True)
class Address:
    """Address of a topic at a broker."""

    host: str
    port: int
    topic: str
    encrypted: bool

    @property
    def in_words(self) -> str:
        """The address without secrets."""
        return f"{self.topic} at {self.host}:{self.port}"

    @property
    def open_to_others(self) -> str | None:
        """A warning if others could read password and answers on their way."""
        if self.encrypted or self.host in LOOPBACK:
            return None
        return (
            f"Password and answers go to {self.host} without encryption, as mqtt:// says; "
            "mqtts:// encrypts them."
        )


class Credentials(Section):
    """User and password, and the file of the authority that signed the broker's certificate."""

    user: str | None = None
    password: str | None = Field(default=None, repr=False)
    ca: InputPath | None = None


def read_address(url: str) -> Address:
    """The address in a URL. The ConfigError repeats nothing of it, as it may contain a password."""
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
        raise ConfigError("This is not the address of a broker.", where="URL", expected=_EXPECTED)
    wrong = not topic or topic.startswith("$") or any(sign in topic for sign in "+#\0")
    if wrong or parts.query or parts.fragment:
        raise ConfigError(
            "This address names no topic.",
            where="URL",
            expected=f"{_EXPECTED}; collect takes what is below its topic too",
        )
    return Address(host, port or PORTS[parts.scheme], topic, parts.scheme == "mqtts")


def read_credentials(file: Path | None) -> Credentials:
    """Credentials from a TOML file of the user's alone; the ConfigError repeats nothing of it."""
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
        raise ConfigError("This is not TOML.", file=file, expected=expected) from None
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise ConfigError(
            "Others can read these credentials.",
            file=file,
            found=f"permissions {stat.S_IMODE(mode):o}",
            expected=f"600: chmod 600 {file}",
        )
    try:
        return Credentials.model_validate(content, context={BASE_DIRECTORY: file.parent})
    except ValidationError as error:
        first, *_ = problems_of(error, Credentials)
        raise ConfigError(first.problem, file=file, where=first.where, expected=expected) from None


def stays_known_by(folder: Path) -> str:
    """Name of this client at the broker, kept in a folder so that its session continues."""
    file = folder / _CLIENT
    if not file.is_file():
        with replacing(file, durable=True) as temporary:
            temporary.write_text(f"bayesbl-{uuid.uuid4().hex}")
    return file.read_text()


def make_client(
    address: Address, credentials: Credentials, name: str, *, acknowledge_by_hand: bool
) -> Client:
    """A client, not connected. Raises ConfigError without paho-mqtt or a valid certificate."""
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
                "This is not a certificate.", file=credentials.ca, expected="a file in PEM format"
            ) from None
    return client


def start(client: Client, address: Address, **more: int) -> None:
    """Connect in paho's thread, for a session that the broker keeps."""
    kept = _properties("CONNECT", SessionExpiryInterval=0xFFFFFFFF, **more)  # never
    client.connect_async(address.host, address.port, clean_start=False, properties=kept)
    client.loop_start()


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
        reason = error.verify_message
    else:
        reason = getattr(error, "strerror", None) or str(error)
    return f"{address.host}:{address.port} cannot be reached: {reason}."


class OnlyOnce:
    """Says a sentence only if it differs from the last one: a broker may be away for days."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say, self._last = say, ""

    def __call__(self, text: str) -> None:
        if text != self._last:
            self._last = text
            self._say(text)


NOBODY_LISTENS = 16  # MQTT 5's reason code if no client has subscribed to the topic
EXPIRES_S = 7 * 24 * 3600  # after this time, a broker may forget an answer
SEND_ALL_AFTER_S = float(EXPIRES_S)  # after this time, a device sends all of its answers again
_SENT = "sent.json"


class Sender:
    """Sends the answers of a device, each until a broker has taken it; connects by itself.

    A broker that took an answer may still lose it, or deliver it to another subscriber than
    ``collect``. So all answers are sent again every week, and at once to a broker that lost its
    session; ``collect`` keeps each once. ``folder`` stores the sender's name and what it has sent.
    """

    def __init__(
        self, folder: Path, address: Address, credentials: Credentials, say: Callable[[str], None]
    ) -> None:
        self._file, self._device = folder / _SENT, stays_known_by(folder)
        self._address, self._say = address, OnlyOnce(say)
        self._client = make_client(address, credentials, self._device, acknowledge_by_hand=False)
        self._client.on_publish = self._on_publish
        self._client.on_connect = self._on_connect
        self._client.on_connect_fail = self._on_connect_fail
        self._answers: dict[tuple[str, str], tuple[str, bytes]] = {}
        self._under_way: dict[str, int] = {}  # paho's number of each
        self._reasons: dict[int, Any] = {}
        self._sent, self._since_s = self._kept()
        self._pause_s, self._again_s = FIRST_WAIT_S, 0.0
        start(self._client, address)

    def offer(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Add answers to send, and send what waits; call it repeatedly, even without answers.

        A newer answer for the same file replaces an older one.
        """
        for row in rows:
            if row["device"] is None:  # not of another, that was collected here
                message = encoded_answer(row, self._device)
                name = hashlib.sha256(message).hexdigest()
                self._answers[row["joint"], row["file"]] = name, message
        if not 0.0 <= time.time() - self._since_s < SEND_ALL_AFTER_S:  # a clock may be set
            self._sent, self._since_s = set(), time.time()
        for name, number in list(self._under_way.items()):
            if number in self._reasons:
                del self._under_way[name]
                self._settle(name, self._reasons.pop(number))
        if time.monotonic() >= self._again_s:
            expires = _properties("PUBLISH", MessageExpiryInterval=EXPIRES_S)
            for name, message in self._waiting():
                if name not in self._under_way:
                    sent = self._client.publish(self._address.topic, message, 1, properties=expires)
                    self._under_way[name] = sent.mid

    def stop(self, wait_s: float = 0.0) -> int:
        """Stop when nothing waits or the time is over; return how many answers still wait."""
        end = time.monotonic() + wait_s
        while self._waiting() and time.monotonic() < end:
            time.sleep(0.05)
            self.offer(())
        self._client.disconnect()
        self._client.loop_stop()
        self._keep()
        return len(self._waiting())

    def _waiting(self) -> list[tuple[str, bytes]]:
        return [one for one in self._answers.values() if one[0] not in self._sent]

    def _settle(self, name: str, reason: Any) -> None:
        """Handle what the broker says about an answer."""
        if not reason.is_failure and reason.value != NOBODY_LISTENS:
            self._say(f"Answers go to {self._address.in_words}.")
            self._sent.add(name)
            self._pause_s = FIRST_WAIT_S
            if not self._waiting():
                self._keep()
            return
        self._say(
            f"Nobody has asked for {self._address.in_words} yet: answers wait until "
            "`bayesbl collect` has been there once."
            if reason.value == NOBODY_LISTENS
            else f"The broker refuses {self._address.in_words}: {reason}. Answers wait."
        )
        self._again_s = time.monotonic() + self._pause_s
        self._pause_s = min(2 * self._pause_s, LONGEST_WAIT_S)

    def _kept(self) -> tuple[set[str], float]:
        """Names of what was sent, and since when; what is lost of this is sent once more."""
        try:
            kept = json.loads(self._file.read_bytes())
            return set(map(str, kept["sent"])), float(kept["since_s"])
        except (OSError, ValueError, TypeError, KeyError):
            return set(), time.time()

    def _keep(self) -> None:
        sent = self._sent.intersection(name for name, _ in self._answers.values())
        with suppress(OSError), replacing(self._file) as file:
            file.write_text(json.dumps({"since_s": self._since_s, "sent": sorted(sent)}))

    # Called by paho's thread.
    def _on_publish(
        self, client: object, data: object, mid: int, reason: Any, more: object
    ) -> None:
        self._reasons[mid] = reason

    def _on_connect(self, client: Any, data: object, flags: Any, reason: Any, more: object) -> None:
        if reason.is_failure:
            self._say(f"The broker does not let us in: {reason}. Answers wait.")
        elif not flags.session_present:  # the broker has lost what it knew
            self._sent = set()

    def _on_connect_fail(self, client: object, data: object) -> None:
        self._say(f"{unreachable(self._address, sys.exception())} Answers wait until it can.")


SCHEMA = 2
LARGEST_MESSAGE_BYTES = 1_000_000  # an answer takes about 1,200 bytes
LONGEST_TEXT = 10_000

LARGEST_RPM = 1e6

OUTCOMES = ("converged", "usable", "withheld", "no_curve", "refused", "failed")

_DEVICE = re.compile(r"[A-Za-z0-9._-]{1,100}")

_GAP = (*(f"delta_rad_{end}" for end in ("median", "low", "high", "sd")), *QUANTILE_COLUMNS)
_AMPLITUDE = ("amplitude_rpm_low", "amplitude_rpm_high")


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number")


def encoded_answer(row: Mapping[str, Any], device: str) -> bytes:
    """A row as a message, without missing or infinite values."""
    given = {
        name: value
        for name, value in row.items()
        if value is not None and not (isinstance(value, float) and not math.isfinite(value))
    }
    return json.dumps({"schema": SCHEMA, "device": device, "recording": given}).encode()


def _column(name: str, kind: str) -> Any:
    """Type of a column. Noise may give a negative amplitude; gaps are positive."""
    if kind == "string":
        return Annotated[str, Field(max_length=LONGEST_TEXT, pattern=r"^[^\x00]*$")]
    if kind == "bool":
        return bool
    low, high = 0.0, 1.0 if name.startswith("probability") else math.pi
    if name.startswith("amplitude"):
        low, high = -LARGEST_RPM, LARGEST_RPM
    return Annotated[float, Field(ge=low, le=high)]


_Given = Annotated[str, Field(min_length=1, max_length=LONGEST_TEXT, pattern=r"^[^\x00]+$")]
_JointName = Annotated[str, Field(pattern=rf"^\w[\w .,+-]{{0,{LONGEST_NAME - 1}}}$")]
_COLUMNS: dict[str, Any] = {
    name: (_column(name, kind) | None, None)
    for name, (kind, _) in RECORDING_COLUMNS.items()
    if name != "device"
}
_COLUMNS |= {name: (_Given, ...) for name in ("date", "file")}
_COLUMNS |= {"joint": (_JointName, ...), "outcome": (Literal[OUTCOMES], ...)}
_COLUMNS |= {"sha256": (Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None, None)}


_STRICT = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)
_Row = create_model("_Row", __config__=_STRICT, **_COLUMNS)


def decoded_answer(message: bytes) -> dict[str, Any]:
    """The row in a message, with every column. The ValueError's reason may be printed."""
    if len(message) > LARGEST_MESSAGE_BYTES:
        raise ValueError(f"it has {len(message)} bytes, more than {LARGEST_MESSAGE_BYTES}")
    try:
        content = json.loads(message, parse_constant=_no_number)
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError):
        raise ValueError("it is not JSON") from None
    except ValueError as error:  # of a number with thousands of digits, also
        raise ValueError(shortened(str(error), 100)) from None
    if not isinstance(content, dict) or content.pop("schema", None) != SCHEMA:
        raise ValueError(f"it is not a message of schema {SCHEMA}")
    device = content.pop("device", None)
    if not isinstance(device, str) or not _DEVICE.fullmatch(device):
        raise ValueError("it does not say which device it is from")
    if content.keys() != {"recording"}:
        raise ValueError("it has other parts than schema, device and recording")
    try:
        recording = _Row.model_validate(content["recording"])
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise ValueError(shortened(f"{where}: {first['msg']}", 200)) from None
    row: dict[str, Any] = dict.fromkeys(RECORDING_COLUMNS) | dict(recording)
    day = None
    if row["outcome"] != "refused":  # which it may be just for its date
        with suppress(ValueError):
            day = Date.fromisoformat(row["date"]).isoformat()
        if day != row["date"]:
            raise ValueError("date: it is not written as 2026-03-01")
        if row["sha256"] is None:
            raise ValueError("sha256: there is none")
    _require_gap(row)
    return row | {"device": device}


def _require_gap(row: Mapping[str, Any]) -> None:
    """Require a whole gap or a reason, with bounds in order."""
    if row["reason"] is None:
        lacking = [name for name in _GAP if row[name] is None]
        if lacking:
            raise ValueError(f"there is no {lacking[0]}, and no reason")
        if row["outcome"] not in ("converged", "usable"):
            raise ValueError("there is a gap, but its outcome says that there is none")
    elif any(row[name] is not None for name in (*_GAP, "probability_above_limit")):
        raise ValueError("there is a gap beside the reason why there is none")
    for names in (("delta_rad_low", "delta_rad_high"), QUANTILE_COLUMNS, _AMPLITUDE):
        given = [row[name] for name in names if row[name] is not None]
        if given != sorted(given) or len(given) not in (0, len(names)):
            raise ValueError(f"{names[0]} to {names[-1]} are not in order, or not complete")
