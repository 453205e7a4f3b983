"""A ``recordings.parquet`` that grows a row at a time, and survives a power cut at any moment.

Its key is the device, the joint and the SHA-256 of the recording: the same answer twice is one row,
and one that could be used takes the place of one that could not. The same laws hold on the device
that measures and where answers of many are collected, whatever the order in which they come.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesbl.errors import ResultError
from bayesbl.fleet.inventory import file_of_another
from bayesbl.fleet.measured_joint import FAILED, REFUSED
from bayesbl.fleet.plant_tables import RECORDING_COLUMNS, RECORDINGS_FILE, require_tables, schema_of
from bayesbl.results.atomic import locked_sibling, replacing
from bayesbl.results.folder import is_finished, require_no_link

if TYPE_CHECKING:
    import pyarrow

Row = Mapping[str, Any]

UNUSABLE = frozenset({REFUSED, FAILED})

_BESIDE = ".growing"
_OF_THE_RECORDING = ("joint", "date", "file", "sha256", "device")


@dataclass(slots=True)
class RecordingTable:
    """The rows in memory, some 300 bytes each, and their file.

    Attributes
    ----------
    beside
        Hidden folder for what whoever writes the table must not forget. It is locked.
    """

    path: Path
    beside: Path
    _rows: pyarrow.Table
    _changed: bool = False

    @classmethod
    @contextmanager
    def opened(cls, output: Path) -> Iterator[RecordingTable]:
        """The table of an output folder, which is made, for one writer at a time.

        Raises
        ------
        UserError
            If the folder holds a fleet's result, which the next run of the fleet replaces; if what
            is there is no such table, another writer has it, or pyarrow is missing.
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

    def __len__(self) -> int:
        return int(self._rows.num_rows)

    def rows(self) -> list[dict[str, Any]]:
        """All of them."""
        return list(self._rows.to_pylist())

    def holds_measured(self, **wanted: str) -> bool:
        """Whether a recording was measured here, and could be used, whose row has these values."""
        return bool(self._outcomes(device=None, **wanted) - UNUSABLE)

    def before(self, joint: str, date: str) -> str | None:
        """Digest of the joint's last recording before a date."""
        import pyarrow.compute as compute

        column = self._rows.column
        # By functions of arrays: an expression would load pyarrow's engine for data sets.
        of_joint = compute.equal(column("joint"), joint)
        earlier = compute.less(column("date"), date)
        digests = column("sha256").filter(compute.and_kleene(of_joint, earlier)).drop_null()
        return None if not len(digests) else str(digests[-1].as_py())

    def knows(self, row: Row) -> bool:
        """Whether a row is there already, or one of the same recording that says more."""
        same = {"device": row["device"], "joint": row["joint"]}
        if row["sha256"] is None:
            return bool(self._where(**same, file=row["file"], reason=row["reason"]))
        known = self._outcomes(**same, sha256=row["sha256"])
        # What it says is of nobody where the same bytes are another joint's.
        is_unusable = row["outcome"] in UNUSABLE or bool(self._of_others(row))
        return bool(known if is_unusable else known - UNUSABLE)

    def _of_others(self, row: Row) -> list[int]:
        """Rows of the same bytes for another joint."""
        joints = self._rows.column("joint")
        alike = [] if row["sha256"] is None else self._where(sha256=row["sha256"])
        return [number for number in alike if joints[number].as_py() != row["joint"]]

    def put(self, row: Row) -> list[dict[str, Any]]:
        """Add a row that is not known, and return what changed: it, and others that it concerns.

        A row of the same device, joint and file is of what the file held before, and goes. A
        recording that is there for another joint too is of neither.
        """
        if self.knows(row):
            return []
        same = {"device": row["device"], "joint": row["joint"]}
        old = self._where(**same, file=row["file"])
        if row["sha256"] is not None:
            old += self._where(**same, sha256=row["sha256"])
        others = self._of_others(row)
        new = [dict(row)]
        if others:
            strange = self._rows.take(others).to_pylist()
            new = [_of_neither(row, strange[0]), *(_of_neither(one, row) for one in strange)]
        gone = {*old, *others}
        rows = self._rows
        if gone:
            rows = rows.filter([number not in gone for number in range(len(self))])
        self._rows = _joined(rows, new)
        self._changed = True
        return new

    def save(self) -> None:
        """Have all rows on the disk.

        Raises
        ------
        OSError
            If they cannot be written: the file is then as it was.
        """
        import pyarrow.parquet

        if self._changed:
            with replacing(self.path, durable=True) as temporary:
                pyarrow.parquet.write_table(self._rows, temporary)
            self._changed = False

    def _outcomes(self, **wanted: object) -> set[str]:
        column = self._rows.column("outcome")
        return {str(column[number]) for number in self._where(**wanted)}

    def _where(self, **wanted: object) -> list[int]:
        """Numbers of the rows that have these values."""
        import pyarrow.compute as compute

        found = None
        for name, value in wanted.items():
            column = self._rows.column(name)
            this = compute.is_null(column) if value is None else compute.equal(column, value)
            found = this if found is None else compute.and_kleene(found, this)
        return [int(number) for number in compute.indices_nonzero(found).to_pylist()]


def _joined(rows: pyarrow.Table, new: list[dict[str, Any]]) -> pyarrow.Table:
    """In the order of a fleet's table."""
    import pyarrow

    added = pyarrow.Table.from_pylist(new, schema=schema_of(RECORDING_COLUMNS))
    whole = pyarrow.concat_tables([rows, added]).combine_chunks()
    return whole.sort_by([(name, "ascending") for name in ("joint", "date", "file")])


def _of_neither(row: Row, other: Row) -> dict[str, Any]:
    """The row of a recording that another joint has too: nothing of its answer is left."""
    empty = dict.fromkeys(RECORDING_COLUMNS)
    own = {name: row[name] for name in _OF_THE_RECORDING}
    reason = file_of_another(other["joint"], other["date"])
    return {**empty, **own, "outcome": REFUSED, "reason": reason, "used": False}


def _read(path: Path) -> pyarrow.Table:
    import pyarrow
    import pyarrow.parquet

    schema = schema_of(RECORDING_COLUMNS)
    if not path.exists():
        return schema.empty_table()
    try:
        # Read into memory: the file is replaced while the table is in use.
        found = pyarrow.parquet.read_table(pyarrow.BufferReader(path.read_bytes()))
        if "device" not in found.schema.names:  # an earlier version's
            found = found.append_column("device", pyarrow.nulls(len(found), pyarrow.string()))
        return found.select(schema.names).cast(schema)
    except (pyarrow.ArrowException, KeyError, ValueError) as error:
        raise ResultError(
            "This is no table of recordings, or it is damaged.",
            file=path,
            found=str(error),
            expected="a table that bayesbl wrote; to start a new one, move this file away",
        ) from None
