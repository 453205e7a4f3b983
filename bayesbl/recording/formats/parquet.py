"""Parquet files as a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.recording.formats import Format

if TYPE_CHECKING:
    from bayesbl.recording.array_table import ArrayTable


def read_parquet(file: Path, data: bytes) -> ArrayTable:
    """All columns, the index that pandas may have stored among them.

    By pyarrow, not the lighter fastparquet, which a damaged file can crash.

    Raises
    ------
    RecordingError
        If it is no Parquet file, or pyarrow is not installed.
    """
    from bayesbl.recording.array_table import ArrayTable, missing_library, readable

    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise missing_library(file, "Parquet", "pyarrow") from None
    with readable(file, "Parquet"):
        table = pyarrow.parquet.read_table(pyarrow.BufferReader(data))
        arrays = {
            name: column.to_numpy()
            for name, column in zip(table.column_names, table.columns, strict=True)
        }
    return ArrayTable(str(file), arrays)


FORMAT = Format("Parquet", (".parquet",), read_parquet)
