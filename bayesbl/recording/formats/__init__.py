"""File formats of recordings, and the functions that read them.

The command line's help and configurations use this table, so readers are imported only when they
read.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

from bayesbl.recording.hdf5 import SIGNATURES

if TYPE_CHECKING:
    from bayesbl.recording.array_table import ArrayTable

RESULT_MARK = "bayesbl_format"  # root attribute of our NetCDF results; its value numbers the layout


@dataclass(frozen=True, slots=True)
class Format:
    """A kind of file that holds a recording."""

    name: str  # in the help
    suffixes: tuple[str, ...]  # in small letters with the dot
    module: str  # as of reader_of; called in a process of its own, except for text
    library: str = ""  # optional library to import
    # Bytes at a position, of which a file must have one to be parsed and quoted; none for text.
    signatures: tuple[tuple[int, bytes], ...] = ()
    # Places of a file that belongs to it, seen from its folder; the first one is read with it.
    beside: tuple[str, ...] = ()

    def is_begun_by(self, data: bytes) -> bool:
        """Whether bytes may be the start of such a file."""
        return not self.signatures or any(
            data[at : at + len(mark)] == mark for at, mark in self.signatures
        )

    @property
    def read(self) -> Callable[[bytes], ArrayTable]:
        """The function that turns bytes into named columns."""
        return reader_of(self.module)


def reader_of(module: str) -> Callable[[bytes], ArrayTable]:
    """The function ``read`` of a module, or the named one: ``.csv:read_diadem``."""
    name, _, function = module.partition(":")
    reader: Callable[[bytes], ArrayTable]
    reader = getattr(import_module(name, __name__), function or "read")
    return reader


CAN_LOG = Format(
    "CAN frames",
    (".blf",),
    ".can_log",
    "cantools",
    ((0, b""),),
    ("{stem}.dbc", "{stem}.DBC", "*.dbc", "*.DBC"),
)
"""Also used for texts whose lines are frames."""

_FRAME = re.compile(
    rb"\s*(?:\(\S+\)\s+)?\w*can\d+\s+[0-9A-F]+(?:#|\s+\[\d+\])"
    rb"|\s*\d+\.\d+\s+\d+\s+[0-9A-F]+x?\s+[RT]x\s+d\s",
    re.IGNORECASE,
)
"""A frame as a line of candump or Vector's tools."""


def begins_with_frames(text: bytes) -> bool:
    """Whether most of the first lines of a text are CAN frames."""
    lines = [line for line in text[:20_000].splitlines() if line.strip()]
    return 2 * sum(_FRAME.match(line) is not None for line in lines) > max(2, len(lines))


_MAT_5 = ((126, b"IM"), (126, b"MI"))
_MAT_4 = (*((0, bytes([kind, 0, 0, 0])) for kind in range(0, 60, 10)), (0, b"\x00\x00\x03\xe8"))
"""Version 4 has no signature; it begins with the type of its first variable."""

_EVERY = (
    Format("CSV, TSV", (".csv", ".tsv", ".txt", ".log", ".lvm", ".asc", ".prn"), ".csv"),
    Format(
        "DIAdem or KUKA trace", (".dat",), ".csv:read_diadem", beside=("{stem}.r64", "{stem}.R64")
    ),
    Format("Excel", (".xlsx", ".xlsm"), ".excel", "openpyxl", ((0, b"PK\x03\x04"),)),
    Format(
        "JSON",
        (".json", ".jsonl", ".ndjson"),
        ".json_log",
        signatures=((0, b"{"), (0, b"["), (0, b"\xef\xbb")),
    ),
    Format("MATLAB", (".mat",), ".arrays", signatures=(*_MAT_5, *SIGNATURES, *_MAT_4)),
    Format("HDF5", (".h5", ".hdf5"), ".arrays", signatures=SIGNATURES),
    Format("NumPy", (".npz",), ".arrays", signatures=((0, b"PK\x03\x04"),)),
    Format("MDF", (".mf4", ".mdf"), ".mdf", "asammdf", ((0, b"MDF "), (0, b"UnFinMF"))),
    Format(
        "NetCDF",
        (".nc",),
        ".arrays:read_netcdf",
        signatures=((0, b"CDF\x01"), (0, b"CDF\x02"), (0, b"CDF\x05"), *SIGNATURES),
    ),
    Format(
        "Parquet",
        (".parquet",),
        ".parquet",
        "pyarrow",
        ((0, b"PAR1"),),
        beside=("meta/info.json", "../meta/info.json", "../../meta/info.json"),
    ),
    CAN_LOG,
    Format(
        "ROS bag, MCAP",
        (".mcap", ".db3", ".bag"),
        ".ros_bag",
        "rosbags",
        ((0, b"\x89MCAP0\r\n"), (0, b"SQLite format 3\0"), (0, b"#ROSBAG V2.0\n")),
    ),
    Format("TDMS", (".tdms",), ".tdms", "nptdms", ((0, b"TDSm"),)),
)

FORMATS = {suffix: format_ for format_ in _EVERY for suffix in format_.suffixes}  # format by suffix


def names() -> str:
    """All formats in words: ``CSV, TSV, MATLAB, NetCDF or Parquet``."""
    *most, last = dict.fromkeys(format_.name for format_ in FORMATS.values())
    return f"{', '.join(most)} or {last}"
