"""CAN frames, decoded by the DBC file beside them: from candump, or Vector's ``.asc`` and ``.blf``.

Frames of one message that contain the same signals form one group.
"""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from datetime import timedelta
from itertools import accumulate, pairwise
from typing import Any

import can
import cantools
import numpy as np
from cantools.logreader import Parser

from bayesbl.errors import RecordingError
from bayesbl.recording.array_table import ArrayTable, Group, table_of_groups
from bayesbl.recording.input_bytes import two_of

_HEAD = 20_000
_VECTOR_FRAME = re.compile(r"(?im)^\s*\d+\.\d+\s+\d+\s+[0-9A-F]+x?\s+[RT]x\s+d\s")


def read(data: bytes) -> ArrayTable:
    """The signals of each message in physical units, which the DBC file states.

    Raises RecordingError without a DBC file, without times, or without a frame of one of its
    messages.
    """
    log, dbc = two_of(data)
    database = cantools.database.Database()
    if dbc:
        database.add_dbc_string(dbc.decode("cp1252", "replace"))
    messages = {(m.frame_id, m.is_extended_frame): m for m in database.messages}
    rows: dict[tuple[Any, ...], list[tuple[float, dict[str, float]]]] = {}
    repairs: Counter[str] = Counter()
    for time, bus, number, content in _frames(log) if dbc else ():
        if number not in messages:
            continue
        try:
            values = messages[number].decode(content, decode_choices=False)
        except cantools.database.DecodeError:
            repairs["CAN frame that its message does not describe"] += 1
        else:
            rows.setdefault((str(bus), number, *values), []).append((time, values))
    if not rows:
        raise RecordingError(
            "This is a log of raw CAN frames.",
            found="none of a message in its DBC file" if dbc else "no DBC file beside it",
            expected="a DBC file with the names, scales and units of what is in its frames, of the "
            "same name, or the only one in the folder",
        )
    groups = []
    for (_, number, *names), those in rows.items():
        message = messages[number]
        columns = {name: np.array([values[name] for _, values in those], float) for name in names}
        units = {s.name: s.unit or "" for s in message.signals if s.name in columns}
        groups.append(Group(message.name, columns, np.array([time for time, _ in those]), units))
    return replace(table_of_groups(groups, one_origin=True), repairs=repairs)


def _frames(log: bytes) -> Iterator[tuple[float, object, tuple[int, bool], bytes]]:
    """Yield time in s, bus, (identifier, whether it is extended) and content of each data frame."""
    text = log.decode("latin-1").removeprefix("\xef\xbb\xbf")
    is_binary = log.startswith(b"LOGG")
    if is_binary or _VECTOR_FRAME.search(text[:_HEAD]):
        asc = io.StringIO(_with_header(text))
        for frame in can.BLFReader(io.BytesIO(log)) if is_binary else can.ASCReader(asc):
            if not (frame.is_remote_frame or frame.is_error_frame):
                number = (frame.arbitration_id, frame.is_extended_id)
                yield frame.timestamp, frame.channel, number, bytes(frame.data)
        return
    frames = list(Parser(io.StringIO(text)))
    stamps = [frame.timestamp for frame in frames]
    if None in stamps:
        raise RecordingError(
            "These CAN frames have no times.",
            found="lines of candump without a time",
            expected="a log of `candump -L` or `candump -tz`",
        )
    seconds = [(stamp - stamps[0]).total_seconds() for stamp in stamps]
    steps = [b - a for a, b in pairwise(seconds)]
    falls = min(steps, default=0.0) < 0.0
    if falls and isinstance(stamps[0], timedelta) and max(seconds) <= 2.0 * max(steps):
        # Of candump -td: the time since the frame before. Times since the start fall too where
        # frames of two buses are out of order, but they add up to far more than any one step.
        seconds = [*accumulate(stamp.total_seconds() for stamp in stamps)]
    for second, frame in zip(seconds, frames, strict=True):
        if not frame.is_remote_frame:
            yield second, frame.channel, (frame.frame_id, frame.is_extended_frame), frame.data


def _with_header(text: str) -> str:
    """An .asc file as python-can expects it: with a header, and times from one origin."""
    if re.match(r"\s*\d", text):  # python-can takes the first line for a header
        text = f"no internal events logged\n{text}"
    if not re.search(r"(?im)^base\s.*timestamps\s+relative", text[:_HEAD]):
        return text
    passed = 0.0

    def from_origin(stamp: re.Match[str]) -> str:
        nonlocal passed
        passed += float(stamp[0])
        return f"{passed:.9f}"

    return re.sub(r"(?m)^ *\d+\.\d+(?=\s)", from_origin, text)
