"""ROS bags (MCAP, SQLite, ROS 1): joints by name, other topics by field."""

from __future__ import annotations

import io
import math
from array import array
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from bayesbl.recording.array_table import ArrayTable, Group, table_of_groups

_JOINT_STATE = "sensor_msgs/msg/JointState"
_JOINT_UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N m"}
"""For a rotary joint, by the definition of JointState."""

_SUFFIXES = {b"\x89MCAP": ".mcap", b"SQLite": ".db3", b"#ROSBAG": ".bag"}
_LONGEST_ARRAY = 100
_DEEPEST = 6


class _Bytes(SimpleNamespace):
    """A file in memory with the part of the path interface that rosbags uses."""

    def __str__(self) -> str:
        return str(self.name)


def read(data: bytes) -> ArrayTable:
    """``JOINT/velocity`` of JointState and ``TOPIC/FIELD`` of other messages, each with its clock.

    Time is the header's stamp minus the first one of the group. Without stamps, ``received_s`` has
    the times of recording, which a network makes uneven.
    """
    suffix = next(kind for mark, kind in _SUFFIXES.items() if data.startswith(mark))
    path: Any = _Bytes(
        name=f"recording{suffix}",
        suffix=suffix,
        stat=lambda: SimpleNamespace(st_size=len(data)),
        exists=lambda: True,
        is_dir=lambda: False,
        open=lambda *_: io.BytesIO(data),
    )
    # Before ROS 2 Iron, SQLite bags held no definitions of their messages.
    store = get_typestore(Stores.ROS2_HUMBLE)
    with AnyReader([path], default_typestore=store) as reader:
        groups = [*_groups(_series(reader))]
    return table_of_groups(groups, always_prefixed=True)


_Key = tuple[str, str, tuple[str, ...]]
"""Topic, joint (empty except for JointState) and names of the numbers in a message."""


def _series(reader: Any) -> dict[_Key, array[float]]:
    """Rows of the header's stamp (NaN if none), the time of recording, both in s since the first
    message of this topic and joint, and the numbers."""
    series: dict[_Key, array[float]] = defaultdict(lambda: array("d"))
    first: dict[tuple[str, str], tuple[int, int]] = {}
    for connection, received_ns, raw in reader.messages():
        message = reader.deserialize(raw, connection.msgtype)
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        stamp_ns = 0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)
        is_of_joints = connection.msgtype == _JOINT_STATE
        for joint, numbers in _joints(message) if is_of_joints else [("", dict(_fields(message)))]:
            if not numbers:
                continue
            key = connection.topic, joint, tuple(numbers)
            start_ns, begin_ns = first.setdefault(key[:2], (stamp_ns, received_ns))
            stamp_s = (stamp_ns - start_ns) / 1e9 if stamp_ns else math.nan
            series[key].extend([stamp_s, (received_ns - begin_ns) / 1e9, *numbers.values()])
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


def _groups(series: Mapping[_Key, array[float]]) -> Iterator[Group]:
    """Groups by joint, with the topic in front if several topics have the joint."""
    times = Counter(joint for _, joint in {key[:2] for key in series})
    for topic, joint in dict.fromkeys(key[:2] for key in series):
        # Some messages may lack numbers that others have, as an effort before the drive is on.
        kinds = {key[2]: rows for key, rows in series.items() if key[:2] == (topic, joint)}
        fields = ["", "received_s", *dict.fromkeys(name for names in kinds for name in names)]
        place = {field: column for column, field in enumerate(fields)}
        blocks = []
        for names, numbers in kinds.items():
            rows = np.array(numbers).reshape(-1, 2 + len(names))
            blocks.append(np.full((len(rows), len(fields)), np.nan))
            blocks[-1][:, [0, 1, *(place[name] for name in names)]] = rows
        table = np.concatenate(blocks)
        stamps_s, *values = table[np.argsort(table[:, 1], kind="stable")].T
        name = topic if not joint else joint if times[joint] == 1 else f"{topic}/{joint}"
        units = (_JOINT_UNITS if joint else {}) | {"received_s": "s"}
        columns = dict(zip(fields[1:], values, strict=True))
        yield Group(name, columns, stamps_s if np.isfinite(stamps_s).all() else None, units)
