"""Parquet files as a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow
import pyarrow.compute
import pyarrow.parquet
import pyarrow.types as types

from bayesbl.recording.array_table import AnyArray, ArrayTable

_LONGEST_LIST = 64


def read(file: Path, data: bytes) -> ArrayTable:
    """All columns, the index that pandas may have stored among them.

    By pyarrow, not the lighter fastparquet, which a damaged file can crash.
    """
    pyarrow.set_memory_pool(pyarrow.system_memory_pool())  # its own reserves far more than it uses
    stored = pyarrow.parquet.ParquetFile(pyarrow.BufferReader(data))
    table = stored.read(use_threads=False)
    arrays: dict[str, AnyArray] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        arrays |= _of_lists(name, column) or {name: column.to_numpy()}
    return ArrayTable(str(file), arrays)


def _of_lists(name: str, column: Any) -> dict[str, AnyArray]:
    """``NAME[0]``, ``NAME[1]`` … of a column whose cells are lists of one length, else nothing."""

    kind = column.type
    if not (types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)):
        return {}
    lengths = pyarrow.compute.unique(pyarrow.compute.list_value_length(column)).to_pylist()
    if len(lengths) != 1 or not 0 < (lengths[0] or 0) <= _LONGEST_LIST:
        return {}
    flat = pyarrow.compute.list_flatten(column).to_numpy().reshape(-1, lengths[0])
    return {f"{name}[{i}]": flat[:, i] for i in range(lengths[0])}
