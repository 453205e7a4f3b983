"""Parquet files as a table."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow
import pyarrow.compute
import pyarrow.parquet
import pyarrow.types as types

from bayesbl.recording.array_table import AnyArray, ArrayTable, Group, table_of_groups
from bayesbl.recording.input_bytes import two_of

_LONGEST_LIST = 64


def read(data: bytes) -> ArrayTable:
    """All columns, including an index stored by pandas.

    Elements of lists are named by joint as in LeRobot's ``meta/info.json``: ``shoulder_pan.pos`` of
    ``observation.state`` becomes ``shoulder_pan/observation.state.pos``. Episodes in one file
    become groups. pyarrow reads, because a damaged file can crash the lighter fastparquet.
    """
    data, info = two_of(data)
    names = _names_of_elements(info)
    pyarrow.set_memory_pool(pyarrow.system_memory_pool())  # its own reserves far more than it uses
    stored = pyarrow.parquet.ParquetFile(pyarrow.BufferReader(data))
    table = stored.read(use_threads=False)
    arrays: dict[str, AnyArray] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        arrays |= _of_lists(name, column, names.get(name, ())) or {name: column.to_numpy()}
    episodes = arrays.get("episode_index", np.zeros(0)) if info else np.zeros(0)
    starts = np.flatnonzero(np.diff(episodes)) + 1
    if not starts.size:
        return ArrayTable(arrays)
    groups = []
    for begin, end in pairwise([0, *starts.tolist(), episodes.size]):
        columns = {name: values[begin:end] for name, values in arrays.items()}
        groups.append(Group(f"episode_{episodes[begin]}", columns, columns.pop("timestamp", None)))
    return table_of_groups(groups)


def _names_of_elements(info: bytes) -> dict[str, list[str]]:
    """Names of the elements of each list by LeRobot: a list, or a list in an object."""
    try:
        stated = json.loads(info)
    except ValueError:
        return {}  # another program's file
    features = stated.get("features") if isinstance(stated, dict) else None
    names = {}
    for feature, about in features.items() if isinstance(features, dict) else ():
        called = about.get("names") if isinstance(about, dict) else None
        called = next(iter(called.values()), None) if isinstance(called, dict) else called
        names[feature] = [*map(str, called)] if isinstance(called, list) else []
    return names


def _of_lists(name: str, column: Any, elements: Sequence[str]) -> dict[str, AnyArray]:
    """Columns of the elements of a column of lists of one length; empty for other columns."""

    kind = column.type
    if not (types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)):
        return {}
    lengths = pyarrow.compute.unique(pyarrow.compute.list_value_length(column)).to_pylist()
    if len(lengths) != 1 or not 0 < (lengths[0] or 0) <= _LONGEST_LIST:
        return {}
    flat = pyarrow.compute.list_flatten(column).to_numpy().reshape(-1, lengths[0])
    if not len({*elements}) == len(elements) == lengths[0]:
        return {f"{name}[{i}]": flat[:, i] for i in range(lengths[0])}
    parts = [element.partition(".") for element in elements]
    return {f"{of}/{name}{dot}{kind}": flat[:, i] for i, (of, dot, kind) in enumerate(parts)}
