"""ROS bags (MCAP, SQLite, ROS 1): joints by name, other topics by field."""

from __future__ import annotations

import io
import math
from array import array
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from bayesbl.recording.array_table import AnyArray, ArrayTable, Group, table_of_groups

_JOINT_STATE = "sensor_msgs/msg/JointState"
_JOINT_UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N m"}
"""For a rotary joint, by the definition of JointState."""

_SUFFIXES = {b"\x89MCAP": ".mcap", b"SQLite": ".db3", b"#ROSBAG": ".bag"}
_LONGEST_ARRAY = 100
_DEEPEST = 6


@dataclass(frozen=True, slots=True)
class _Bytes:
    """A file in memory with the part of the path interface that rosbags uses."""

    name: str
    data: bytes

    @property
    def suffix(self) -> str:
        return Path(self.name).suffix

    @property
    def st_size(self) -> int:
        return len(self.data)

    def stat(self) -> _Bytes:
        return self

    def exists(self) -> bool:
        return True

    def is_dir(self) -> bool:
        return False

    def open(self, *_: object) -> io.BytesIO:
        return io.BytesIO(self.data)

    def __str__(self) -> str:
        return self.name


def read(data: bytes) -> ArrayTable:
    """``JOINT/velocity`` of JointState and ``TOPIC/FIELD`` of other messages, each with its clock.

    Time is the header's stamp minus the first one of the group. Without stamps, ``received_s`` has
    the times of recording, which a network makes uneven.
    """
    suffix = next(kind for mark, kind in _SUFFIXES.items() if data.startswith(mark))
    path = _Bytes(f"recording{suffix}", data)
    # Before ROS 2 Iron, SQLite bags held no definitions of their messages.
    store = get_typestore(Stores.ROS2_HUMBLE)
    with AnyReader([path], default_typestore=store) as reader:
        series = _series(reader)
    groups = _groups(series)
    return table_of_groups(groups, always_prefixed=True)


class _Rows:
    """Messages: the header's stamp (0 if none) and time of recording, both in ns, and fields."""

    def __init__(self) -> None:
        self.stamps_ns, self.received_ns = array("q"), array("q")
        self.fields: dict[str, array[float]] = {}

    def add(self, stamp_ns: int, received_ns: int, numbers: Mapping[str, float]) -> None:
        """Add a message, with NaN for missing numbers."""
        for name, value in numbers.items():
            held = self.fields.setdefault(name, array("d"))
            held.extend([math.nan] * (len(self.stamps_ns) - len(held)))
            held.append(value)
        self.stamps_ns.append(stamp_ns)
        self.received_ns.append(received_ns)


_Series = dict[tuple[str, str], _Rows]  # by topic and joint, which is empty except for JointState


def _series(reader: Any) -> _Series:
    series: _Series = defaultdict(_Rows)
    for connection, received_ns, raw in reader.messages():
        message = reader.deserialize(raw, connection.msgtype)
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        stamp_ns = 0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)
        if connection.msgtype == _JOINT_STATE:
            for joint, numbers in _joints(message):
                series[connection.topic, joint].add(stamp_ns, received_ns, numbers)
        else:
            numbers = dict(_fields(message))
            if numbers:
                series[connection.topic, ""].add(stamp_ns, received_ns, numbers)
    return series


def _joints(message: Any) -> Iterator[tuple[str, dict[str, float]]]:
    """Joints of a JointState, with the quantities that it states for all joints."""
    given = {
        quantity: values
        for quantity in _JOINT_UNITS
        if len(values := getattr(message, quantity)) == len(message.name)
    }
    for place, joint in enumerate(message.name):
        yield str(joint), {quantity: float(values[place]) for quantity, values in given.items()}


def _fields(message: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, float]]:
    """Numbers of a message by their path, without the header."""

    for name in getattr(message, "__dataclass_fields__", ()):
        value = getattr(message, name)
        if name == "header" or name.startswith("__"):
            continue
        if isinstance(value, (bool, int, float)):
            yield prefix + name, float(value)
        elif isinstance(value, np.ndarray) and value.size <= _LONGEST_ARRAY:
            yield from ((f"{prefix}{name}[{i}]", float(v)) for i, v in enumerate(value.flat))
        elif depth < _DEEPEST:
            yield from _fields(value, f"{prefix}{name}.", depth + 1)


def _groups(series: _Series) -> list[Group]:
    """Groups by joint, with the topic in front if several topics have the joint."""
    times = Counter(joint for _, joint in series)
    return [
        _group(topic, rows, {})
        if not joint
        else _group(joint if times[joint] == 1 else f"{topic}/{joint}", rows, _JOINT_UNITS)
        for (topic, joint), rows in series.items()
    ]


def _group(name: str, rows: _Rows, units: Mapping[str, str]) -> Group:
    stamps_ns, received_ns = np.array(rows.stamps_ns), np.array(rows.received_ns)
    columns: dict[str, AnyArray] = {}
    for field, values in rows.fields.items():
        columns[field] = np.full(stamps_ns.size, np.nan)
        columns[field][: len(values)] = values
    columns["received_s"] = (received_ns - received_ns[0]) / 1e9
    time = (stamps_ns - stamps_ns[0]) / 1e9 if stamps_ns.all() else None
    return Group(name, columns, time, {**units, "received_s": "s"})
