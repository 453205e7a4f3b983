"""From a file to a :class:`Recording`: columns mapped, units converted, the file checked.

Only what any task needs is checked here; rotations, sampling and the like are in
:mod:`bayesbl.recording.checks`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import numpy as np

from bayesbl.errors import RecordingError
from bayesbl.recording.channels import (
    CHANNELS,
    TIME,
    ColumnSpec,
    did_you_mean,
    is_mappable,
)
from bayesbl.recording.csv_table import read_csv, shortened
from bayesbl.recording.types import FloatArray, Recording, Source
from bayesbl.units import accepted_units, conversion_factor

MINIMUM_SAMPLES = 16
"""Fewer samples than this are no recording, whatever the task."""


class Table(Protocol):
    """What a file format must offer: named columns of numbers, and the place of each cell."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names as they stand in the file."""

    def numbers(self, columns: Sequence[int]) -> FloatArray:
        """Values of some columns, shape (samples, len(columns)); missing ones are NaN."""

    def place(self, row: int, column: int) -> str:
        """Where a value stands, in words."""


_FORMATS: Mapping[str, Callable[[Path, bytes], Table]] = MappingProxyType(
    {".csv": read_csv, ".tsv": read_csv, ".txt": read_csv}
)


@dataclass(frozen=True, slots=True)
class _Column:
    """A column of the file, the channel it becomes, and the factor between their units."""

    index: int
    channel: str
    factor: float


def read_recording(
    path: str | Path,
    *,
    name: str | None = None,
    columns: Mapping[str, ColumnSpec] | None = None,
) -> Recording:
    """Read and check one recording.

    Parameters
    ----------
    path
        The file; its suffix tells the format.
    name
        Short name for results and figures; the file's name without suffix by default.
    columns
        Channel to the column that holds it, where name or unit differ from the package's own.
        Columns that already have a channel's name need no entry.

    Raises
    ------
    RecordingError
        If the file cannot be read, lacks a column, or holds anything but finite numbers over
        strictly increasing time. The message names line and column.
    """
    path = Path(path)
    data = _read_bytes(path)
    table = _format_of(path)(path, data)
    chosen = _choose_columns(path, table.columns, columns or {})
    values = table.numbers([column.index for column in chosen])
    with np.errstate(over="ignore"):
        values = values * np.array([column.factor for column in chosen])
    _check_length(path, values)
    _check_finite(path, table, chosen, values)
    _check_time(path, table, chosen, values)
    series = {column.channel: values[:, i].copy() for i, column in enumerate(chosen)}
    used = {column.index for column in chosen}
    return Recording(
        name=name or path.stem,
        time_s=series.pop(TIME),
        channels=series,
        source=Source(
            file=str(path),
            sha256=hashlib.sha256(data).hexdigest(),
            unused_columns=tuple(
                column or f"column {i + 1}"
                for i, column in enumerate(table.columns)
                if i not in used
            ),
        ),
    )


def _read_bytes(path: Path) -> bytes:
    try:
        data = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise RecordingError(
            "There is no such file.", file=path, expected="an existing recording"
        ) from None
    except IsADirectoryError:
        raise RecordingError(
            "This is a folder.", file=path, found="a folder", expected="a recording's file"
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise RecordingError(
            "The file cannot be read.", file=path, found=reason, expected="a readable file"
        ) from None
    if not data.strip():
        raise RecordingError(
            "The file is empty.", file=path, found=f"{len(data)} bytes", expected="a recording"
        )
    return data


def _format_of(path: Path) -> Callable[[Path, bytes], Table]:
    reader = _FORMATS.get(path.suffix.lower())
    if reader is None:
        raise RecordingError(
            "This kind of file is not known as a recording.",
            file=path,
            found=f'"{path.suffix}"' if path.suffix else "no suffix",
            expected=" or ".join(_FORMATS),
        )
    return reader


def _choose_columns(
    path: Path, names: tuple[str, ...], specs: Mapping[str, ColumnSpec]
) -> list[_Column]:
    """Time first, then the mapped columns, then those that already have a channel's name."""
    channels = {channel: _mapped(path, names, channel, spec) for channel, spec in specs.items()}
    taken = {column.index for column in channels.values()}
    for channel in (TIME, *CHANNELS):
        if channel not in channels and channel in names and names.index(channel) not in taken:
            channels[channel] = _Column(names.index(channel), channel, 1.0)
    if TIME not in channels:
        raise _missing_column(path, names, TIME)
    if len(channels) == 1:
        raise RecordingError(
            "No column but time has a name that is known.",
            file=path,
            where="header",
            found=_listed(names),
            expected=f"at least one of {', '.join(CHANNELS)}; map others under [columns]",
        )
    return [channels.pop(TIME), *channels.values()]


def _mapped(path: Path, names: tuple[str, ...], channel: str, spec: ColumnSpec) -> _Column:
    if not is_mappable(channel):
        raise RecordingError(
            "A column is mapped to a channel that does not exist."
            + did_you_mean(channel, (TIME, *CHANNELS)),
            file=path,
            where=f"[columns] {channel}",
            found=f'"{channel}"',
            expected=f"one of {', '.join((TIME, *CHANNELS))}, or a torque's name ending in _nm",
        )
    if spec.name not in names:
        raise _missing_column(path, names, spec.name)
    try:
        factor = 1.0 if spec.unit is None else conversion_factor(channel, spec.unit)
    except KeyError:
        raise RecordingError(
            "The unit is not known for this channel.",
            file=path,
            where=f"[columns] {channel}",
            found=f'"{spec.unit}"',
            expected=" or ".join(accepted_units(channel)),
        ) from None
    return _Column(names.index(spec.name), channel, factor)


def _missing_column(path: Path, names: tuple[str, ...], wanted: str) -> RecordingError:
    return RecordingError(
        f'The column "{wanted}" is missing.{did_you_mean(wanted, names)}',
        file=path,
        where="header",
        found=_listed(names),
        expected=f'a column "{wanted}", or another name for it under [columns]',
    )


def _listed(names: tuple[str, ...]) -> str:
    return shortened(", ".join(f'"{name}"' for name in names), 200)


def _check_length(path: Path, values: FloatArray) -> None:
    if len(values) < MINIMUM_SAMPLES:
        raise RecordingError(
            "The recording is too short.",
            file=path,
            found=f"{len(values)} samples",
            expected=f"at least {MINIMUM_SAMPLES}",
        )


def _check_finite(path: Path, table: Table, chosen: Sequence[_Column], values: FloatArray) -> None:
    """Refuse values that are missing or infinite, in the column where they come first."""
    bad = ~np.isfinite(values)
    if not bad.any():
        return
    row, index = np.argwhere(bad)[0]
    count = int(bad[:, index].sum())
    name = table.columns[chosen[index].index]
    if count == len(values):
        raise RecordingError(
            "This column does not hold a single number.",
            file=path,
            where=f'column "{name}"',
            found=f"NaN, infinite or empty in all {count} samples",
            expected="a finite number in every sample",
        )
    raise RecordingError(
        f"{count} of {len(values)} values are missing or not finite; this is the first.",
        file=path,
        where=table.place(int(row), chosen[index].index),
        found="nothing or NaN" if np.isnan(values[row, index]) else str(values[row, index]),
        expected="a finite number in every sample",
    )


def _check_time(path: Path, table: Table, chosen: Sequence[_Column], values: FloatArray) -> None:
    time = values[:, 0]
    backward = np.flatnonzero(time[1:] <= time[:-1])
    if backward.size == 0:
        return
    row = int(backward[0]) + 1
    before, after = time[row - 1] / chosen[0].factor, time[row] / chosen[0].factor
    problem = "Time stands still" if after == before else "Time runs backwards"
    raise RecordingError(
        f"{problem} ({backward.size} times in all; this is the first).",
        file=path,
        where=table.place(row, chosen[0].index),
        found=f"{after:.12g} after {before:.12g}",
        expected="time that increases from each line to the next",
    )
