"""A broker of messages (MQTT 5): where it is, who we are to it, what it says when it refuses."""

from __future__ import annotations

import os
import ssl
import stat
import sys
import tomllib
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit

from bayesbl.errors import BrokerError, ConfigError
from bayesbl.fleet.message import REPLIES
from bayesbl.recording.channels import did_you_mean
from bayesbl.recording.input_bytes import read_input
from bayesbl.results.atomic import replacing

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
            "User and password do not stand in an address: others can read it.",
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
    if sys.platform != "win32" and mode & (stat.S_IRWXG | stat.S_IRWXO):
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
        with replacing(file, durable=True) as temporary:
            temporary.write_text(f"bayesbl-{uuid.uuid4().hex}")
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


def session(largest_bytes: int | None = None) -> Any:
    """Properties of a connection whose session the broker keeps."""
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.properties import Properties

    properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    properties.SessionExpiryInterval = 0xFFFFFFFF  # never
    if largest_bytes is not None:
        properties.MaximumPacketSize = largest_bytes
    return properties


def publishing(expires_s: int) -> Any:
    """Properties of a message that the broker is to forget after a time."""
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.properties import Properties

    properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
    properties.MessageExpiryInterval = expires_s
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
