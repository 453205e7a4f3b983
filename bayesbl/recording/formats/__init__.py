"""File formats of recordings: each module here that declares a :class:`Format` adds one.

Asked by the command line's help and by configurations before any number is read, so a format
imports what it reads with only when it reads.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.declared import declared

if TYPE_CHECKING:
    from bayesbl.recording.array_table import ArrayTable


@dataclass(frozen=True, slots=True)
class Format:
    """A kind of file that holds a recording.

    Attributes
    ----------
    name
        What the help calls it.
    suffixes
        Of its files, in small letters with the dot.
    read
        From path and bytes to named columns. Called in a process of its own, but for text; what
        it raises there is told as a damaged file.
    library
        The optional library that it reads with, as it is imported; empty where there is none.
    signatures
        What its files have at which byte, any of them; a file without is not parsed, and nothing
        of it is quoted. Empty for text.
    beside
        Suffix of a file of the same name whose bytes follow the file's own, if it is there.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[Path, bytes], ArrayTable]
    library: str = ""
    signatures: tuple[tuple[int, bytes], ...] = ()
    beside: str = ""

    def is_begun_by(self, data: bytes) -> bool:
        """Whether bytes may be a file of this format."""
        return not self.signatures or any(
            data[at : at + len(mark)] == mark for at, mark in self.signatures
        )


def formats() -> dict[str, Format]:
    """Suffix to the format of files that end in it."""
    found = declared(sys.modules[__name__], Format)
    return {suffix: format_ for format_ in found for suffix in format_.suffixes}


def names() -> str:
    """``CSV, TSV, MATLAB, NetCDF or Parquet``."""
    *most, last = dict.fromkeys(format_.name for format_ in formats().values())
    return f"{', '.join(most)} or {last}"
