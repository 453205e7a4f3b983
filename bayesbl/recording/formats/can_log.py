"""Frames of a CAN bus by the DBC file beside them: of candump, or Vector's ``.asc`` and ``.blf``.

Frames of one message, with the same signals in them, were sampled together.
"""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
from cantools.logreader import Parser

from bayesbl.errors import RecordingError
from bayesbl.recording.array_table import ArrayTable, Group, table_of_groups
from bayesbl.recording.input_bytes import two_of


def read(file: Path, data: bytes) -> ArrayTable:
    """Each message's signals in physical units, with the units that the DBC file states.

    Raises
    ------
    RecordingError
        If there is no DBC file, or no frame with a time is of one of its messages.
    """
    log, dbc = two_of(data)
    database = cantools.database.Database()
    if dbc:
        database.add_dbc_string(dbc.decode("cp1252", "replace"))
    messages = {(m.frame_id, m.is_extended_frame): m for m in database.messages}
    rows: dict[tuple[Any, ...], list[tuple[float, dict[str, float]]]] = {}
    repairs: Counter[str] = Counter()
    for time, bus, number, content in _frames(log):
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
            file=file,
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
    return replace(table_of_groups(file, groups, one_origin=True), repairs=repairs)


def _frames(log: bytes) -> Iterator[tuple[float, object, tuple[int, bool], bytes]]:
    """Time in s, bus, identifier, whether that is extended, and content of each frame of data."""
    text, is_binary = io.StringIO(log.decode("latin-1")), log.startswith(b"LOGG")
    if is_binary or log[:5].lower() == b"date ":
        for frame in can.BLFReader(io.BytesIO(log)) if is_binary else can.ASCReader(text):
            if not (frame.is_remote_frame or frame.is_error_frame):
                number = (frame.arbitration_id, frame.is_extended_id)
                yield frame.timestamp, frame.channel, number, bytes(frame.data)
        return
    first = None
    for frame in Parser(text):
        if frame.timestamp is not None and not frame.is_remote_frame:
            first = frame.timestamp if first is None else first
            seconds = (frame.timestamp - first).total_seconds()
            yield seconds, frame.channel, (frame.frame_id, frame.is_extended_frame), frame.data
