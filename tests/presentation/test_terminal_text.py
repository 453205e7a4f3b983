"""Laws of what reaches the terminal: plain text in an encoding that it has."""

from __future__ import annotations

import io
import sys

import pytest

from bayesbl.errors import UserError
from bayesbl.presentation.terminal import (
    error,
    make_console,
    plain,
    replace_what_cannot_be_printed,
    say,
)

HOSTILE = "\x1b[31mred\x1b]0;owned\x07\x9b2J\u202egpj"


def test_what_steers_a_terminal_is_dropped():
    assert plain(HOSTILE) == "[31mred]0;owned2Jgpj"
    assert plain("δ\tin\nmrad") == "δ\tin\nmrad"


def test_messages_are_plain_even_in_colour(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    error(make_console(stderr=True), UserError("No.", found=HOSTILE))
    say(HOSTILE)
    out, err = capsys.readouterr()
    assert out == plain(HOSTILE) + "\n"
    assert plain(HOSTILE) in err
    assert "\x07" not in err
    assert "\x9b" not in err
    assert "\x1b[1;31mError: " in err, "colours of its own stay"


@pytest.mark.parametrize(
    ("encoding", "printed"),
    [("ascii", "? 1e?3 ?2 ? ?"), ("latin-1", "? 1e?3 ±2 é ?"), ("utf-8", "δ 1e−3 ±2 é ?")],
)
def test_characters_that_a_terminal_lacks_are_replaced(encoding, printed, monkeypatch):
    bytes_out = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(bytes_out, encoding=encoding))
    replace_what_cannot_be_printed()
    say("δ 1e−3 ±2 é \udcff")
    sys.stdout.flush()
    assert bytes_out.getvalue().decode(encoding) == printed + "\n"
