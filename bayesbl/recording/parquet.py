"""Parquet files as a table."""

from __future__ import annotations

import io
from pathlib import Path

from bayesbl.recording.array_table import ArrayTable, missing_library, readable


def read_parquet(file: Path, data: bytes) -> ArrayTable:
    """All columns, the index that pandas may have stored among them.

    Raises
    ------
    RecordingError
        If it is no Parquet file, or fastparquet is not installed.
    """
    try:
        import fastparquet
    except ImportError:
        raise missing_library(file, "Parquet", "fastparquet") from None
    with readable(file, "Parquet"):
        frame = fastparquet.ParquetFile(io.BytesIO(data)).to_pandas(index=False)
        arrays = {}
        for name in frame.columns:
            column = frame[name]
            if getattr(column.dtype, "tz", None) is not None:
                column = column.dt.tz_convert("UTC").dt.tz_localize(None)
            arrays[str(name)] = column.to_numpy()
    return ArrayTable(str(file), arrays)
