"""Addresses and credentials: what is wrong is said, what is secret is not."""

from __future__ import annotations

import pytest

from bayesbl.errors import ConfigError
from bayesbl.fleet.broker import Address, read_address, read_credentials, stays_known_by


def test_addresses_are_read_with_their_usual_ports():
    assert read_address("mqtts://b.plant/p/r1") == Address("b.plant", 8883, "p/r1", True)
    assert read_address("mqtt://[::1]/p%20q/") == Address("::1", 1883, "p q", False)
    assert read_address("mqtt://localhost:99/p").open_to_others is None
    assert "without encryption" in str(read_address("mqtt://b.plant/p").open_to_others)


@pytest.mark.parametrize(
    ("url", "told"),
    [
        ("mqtts://ann:hunter2@b/p", "do not belong in an address"),
        ("http://b/p", "not the address of a broker"),
        ("mqtts:///p", "not the address of a broker"),
        ("mqtts://b", "names no topic"),
        ("mqtts://b/p/%23", "names no topic"),
        ("mqtts://b/$SYS", "names no topic"),
        ("mqtts://b/p?x=hunter2", "names no topic"),
        ("mqtts://b:port/p", "cannot be read"),
    ],
)
def test_what_is_no_address_is_told_without_its_secrets(url, told):
    with pytest.raises(ConfigError, match=told) as caught:
        read_address(url)
    assert "hunter2" not in str(caught.value)


def test_credentials_are_read_and_not_shown(tmp_path):
    file = tmp_path / "broker.toml"
    (tmp_path / "ca.crt").write_text("")
    file.write_text('user = "ann"\npassword = "hunter2"\nca = "ca.crt"\n')
    file.chmod(0o600)
    found = read_credentials(file)
    assert (found.user, found.password, found.ca) == ("ann", "hunter2", tmp_path / "ca.crt")
    assert "hunter2" not in repr(found)


@pytest.mark.parametrize(
    ("text", "mode", "told"),
    [
        ('password = "hunter2"', 0o640, "Others can read"),
        ('pasword = "hunter2"', 0o600, "did you mean"),
        ('password = "hunter2', 0o600, "not TOML"),
        ('ca = "none.crt"', 0o600, "no such file"),
        ("password = 12", 0o600, "cannot be used"),
    ],
)
def test_credentials_that_cannot_be_used_are_told_without_them(tmp_path, text, mode, told):
    file = tmp_path / "broker.toml"
    file.write_text(text)
    file.chmod(mode)
    with pytest.raises(ConfigError, match=f"(?i){told}") as caught:
        read_credentials(file)
    assert "hunter2" not in str(caught.value)


def test_a_client_keeps_its_name(tmp_path):
    assert stays_known_by(tmp_path) == stays_known_by(tmp_path)
