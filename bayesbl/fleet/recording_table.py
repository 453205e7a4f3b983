"""A ``recordings.parquet`` that grows row by row, and survives a power cut at any moment.

Its key is device, joint and SHA-256 of the recording. The same answer twice is one row, and a
usable answer replaces an unusable one. This holds on the measuring device and where answers are
collected, in whatever order they come.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesbl.errors import ResultError
from bayesbl.fleet.measured_joint import FAILED, REFUSED
from bayesbl.fleet.plant_tables import (
    RECORDING_COLUMNS,
    RECORDINGS_FILE,
    require_tables,
    schema_of,
    write_table,
)
from bayesbl.results.atomic import locked_sibling, replacing
from bayesbl.results.folder import is_finished, require_no_link

Row = dict[str, Any]

UNUSABLE = frozenset({REFUSED, FAILED})

_BESIDE = ".growing"


@dataclass(slots=True)
class RecordingTable:
    """Rows and their file. ``beside``: a locked hidden folder for the writer's own data."""

    path: Path
    beside: Path
    rows: list[Row]
    _changed: bool = False

    @classmethod
    @contextmanager
    def opened(cls, output: Path) -> Iterator[RecordingTable]:
        """The table of an output folder, for one writer at a time; the folder is made if needed.

        Raises UserError if the folder holds a fleet's result, which the next run replaces, if the
        table is damaged or in use, or without pyarrow.
        """
        require_tables()
        require_no_link(output)
        if is_finished(output):
            raise ResultError(
                "This folder holds the result of a run, which would be mixed with other rows.",
                file=output,
                expected="another folder (--out)",
            )
        with locked_sibling(output, _BESIDE) as beside:
            path = output / RECORDINGS_FILE
            yield cls(path, beside, _read(path))

    def holds_measured(self, joint: str, sha256: str) -> bool:
        """Whether a recording was measured here and is usable."""
        return bool(self._outcomes(None, joint, sha256) - UNUSABLE)

    def put(self, row: Row) -> bool:
        """Add a row, unless the table has it, or one of the same recording that says more.

        Rows of the same device, joint and file describe its former content and are removed.
        """
        if self._knows(row):
            return False
        kept = [one for one in self.rows if not _replaces(row, one)]
        self.rows = sorted([*kept, row], key=lambda one: (one["joint"], one["date"], one["file"]))
        self._changed = True
        return True

    def save(self) -> None:
        """Write all rows to disk. Raises OSError and leaves the file unchanged if that fails."""
        if self._changed:
            with replacing(self.path, durable=True) as temporary:
                write_table(self.rows, RECORDING_COLUMNS, temporary)
            self._changed = False

    def _knows(self, row: Row) -> bool:
        if row["sha256"] is None:
            same = ("device", "joint", "file", "reason")
            return any(all(one[key] == row[key] for key in same) for one in self.rows)
        known = self._outcomes(row["device"], row["joint"], row["sha256"])
        return bool(known if row["outcome"] in UNUSABLE else known - UNUSABLE)

    def _outcomes(self, device: str | None, joint: str, sha256: str) -> set[str]:
        asked = device, joint, sha256
        keys = "device", "joint", "sha256"
        return {o["outcome"] for o in self.rows if tuple(o[key] for key in keys) == asked}


def _replaces(row: Row, one: Row) -> bool:
    """Whether both rows are of the same device and joint, and of the same file or bytes."""
    same = one["file"] == row["file"] or one["sha256"] == row["sha256"] is not None
    return same and (one["device"], one["joint"]) == (row["device"], row["joint"])


def _read(path: Path) -> list[Row]:
    import pyarrow.parquet

    if not path.exists():
        return []
    schema = schema_of(RECORDING_COLUMNS)
    try:
        table = pyarrow.parquet.read_table(path)
        return list(table.select(schema.names).cast(schema).to_pylist())
    except (pyarrow.ArrowException, KeyError, ValueError) as error:
        raise ResultError(
            "This is no table of recordings, or it is damaged.",
            file=path,
            found=str(error),
            expected="a table that bayesbl wrote; to start a new one, move this file away",
        ) from None
