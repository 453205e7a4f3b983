"""Which columns of a file become which channels, and in which unit they come."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.channels import CHANNELS, TIME, ColumnSpec, did_you_mean, is_mappable
from bayesbl.recording.types import FloatArray
from bayesbl.units import choice_of_units, conversion_factor, is_accepted, is_unit, spelled

_BRACKETS = re.compile(r"[\[(]([^\])]*)[\])]")
_PER_SECOND = re.compile(r"(?i)[_ .](rad|deg|rev)(?:_per_|_p_|p|_|/)s$")
_WITHOUT_SIZE = frozenset(
    "count counts cnt cnts inc incs increment increments tick ticks pulse pulses lsb lsbs digit "  # noqa: SIM905
    "digits pu erpm percent permille".split()
)
"""Words for units of a size that only the user knows."""


class Table(Protocol):
    """What a file format must offer: named columns of numbers, and the place of each cell."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names as in the file."""

    @property
    def repairs(self) -> Mapping[str, int]:
        """What was left out as the file was read, in words, and how many times."""

    def numbers(self, columns: Sequence[int]) -> FloatArray:
        """Values of some columns, shape (samples, len(columns)); missing ones are NaN."""

    def timestamps(self, column: int) -> FloatArray | None:
        """Seconds since the first stamp where a column holds dates, else ``None``."""

    def unit(self, column: int) -> str | None:
        """The unit that the file states for a column."""

    def clock(self, column: int) -> int | None:
        """The column that holds a column's time in s, where the file ties them together."""

    def place(self, row: int, column: int) -> str:
        """Where a value is, in words."""

    def without_values(self) -> Table:
        """Its names and places alone."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the file, the channel it becomes, and the unit it comes in.

    ``note`` says so where only the column's name states the unit.
    """

    index: int
    channel: str
    unit: str | None
    note: str | None = None
    reversed: bool = False

    @property
    def factor(self) -> float:
        """What brings the column to the channel's own unit and sign."""
        size = 1.0 if self.unit is None else conversion_factor(self.channel, self.unit)
        return -size if self.reversed else size


def choose_columns(path: Path, table: Table, specs: Mapping[str, ColumnSpec]) -> list[Column]:
    """Time first, then the mapped columns, then those that already have a channel's name.

    Where the file ties columns to clocks, time is that of the mapped columns unless it is mapped.
    """
    names = table.columns
    channels = {
        channel: replace(_mapped(path, table, channel, spec), reversed=spec.reversed)
        for channel, spec in specs.items()
    }
    taken = {column.index for column in channels.values()}
    mapped = {table.clock(index) for index in taken} - {None}
    for channel in (TIME, *CHANNELS):
        if channel in channels or channel not in names or names.index(channel) in taken:
            continue
        if not mapped or table.clock(names.index(channel)) in mapped:
            channels[channel] = _mapped(path, table, channel, ColumnSpec(channel))
    clocks = {column.index: table.clock(column.index) for column in channels.values()}
    tied = {clock for clock in clocks.values() if clock is not None}
    if len(tied) > 1:
        raise RecordingError(
            "These columns were not sampled together.",
            file=path,
            where=", ".join(f'"{names[index]}"' for index in clocks),
            found=_listed(tuple(names[clock] for clock in sorted(tied))) + " as their times",
            expected="columns of one joint, topic or group",
        )
    if TIME not in channels and tied:
        channels[TIME] = Column(tied.pop(), TIME, "s")
    if TIME not in channels:
        raise _missing_column(path, names, TIME)
    if len(channels) == 1:
        raise RecordingError(
            "No column but time has a known name.",
            file=path,
            where="header",
            found=_listed(names),
            expected=f"at least one of {', '.join(CHANNELS)}; map others under [columns]",
        )
    return [channels.pop(TIME), *channels.values()]


def _brackets_of(name: str) -> re.Match[str] | None:
    """The brackets that hold a unit, else the last: an index may stand before, ``r61[0] [rpm]``."""
    every = list(_BRACKETS.finditer(name))
    return next((b for b in every if is_unit(spelled(b[1]))), every[-1] if every else None)


def split_unit(name: str) -> tuple[str, str | None]:
    """A column's name without the unit in it, and the unit: ``n [rad/s]``, ``n_rad_per_s``."""
    brackets = _brackets_of(name)
    bare = name[: brackets.start()] + name[brackets.end() :] if brackets else name
    unit = spelled(brackets[1]) if brackets else ""
    tail = _PER_SECOND.search(bare)
    if tail:
        bare, unit = bare[: tail.start()], unit if is_unit(unit) else f"{tail[1].lower()}/s"
    return bare, unit if is_unit(unit) else None


def unknown_unit(name: str) -> str | None:
    """What a column's name states as a unit that is none here: ``pos [counts]``, ``speed_erpm``.

    A question, as any guess would be a factor. An index (``x[0]``) and a remark are no units.
    """
    if split_unit(name)[1] is not None:
        return None
    brackets = _brackets_of(name)
    if brackets:
        text = brackets[1].strip()
        looks = brackets[0][0] == "[" or any(mark in text for mark in "/%‰°")
        if text and not is_unit(spelled(text)):
            worded = re.search(r"[^\W\d_]", text) or text in ("%", "‰", "°")
            if worded and (looks or text.lower() in _WITHOUT_SIZE):
                return text
    last = re.split(r"[\W_]+", name.strip())[-1].lower()
    return last if last in _WITHOUT_SIZE else None


def _mapped(path: Path, table: Table, channel: str, spec: ColumnSpec) -> Column:
    if not is_mappable(channel):
        raise RecordingError(
            "A column is mapped to a channel that does not exist."
            + did_you_mean(channel, (TIME, *CHANNELS)),
            file=path,
            where=f"[columns] {channel}",
            found=f'"{channel}"',
            expected=f"one of {', '.join((TIME, *CHANNELS))}, or a torque's name ending in _nm",
        )
    if spec.name not in table.columns:
        raise _missing_column(path, table.columns, spec.name)
    index = table.columns.index(spec.name)
    if spec.unit is not None and not is_accepted(channel, spec.unit):
        raise RecordingError(
            "The unit is not known for this channel.",
            file=path,
            where=f"[columns] {channel}",
            found=f'"{spec.unit}"',
            expected=choice_of_units(channel),
        )
    if spec.unit is not None:
        return Column(index, channel, spec.unit)
    stated = table.unit(index)
    if stated and stated.strip():
        return Column(index, channel, _known(path, table, index, channel, stated))
    _, named = split_unit(spec.name)
    if named is None and (named := unknown_unit(spec.name)) and channel == TIME:
        # The form of a date (time [hh:mm:ss]) is no unit.
        named = None if table.timestamps(index) is not None else named
    if named is None:
        return Column(index, channel, None)
    unit = _known(path, table, index, channel, named)
    column = Column(index, channel, unit)
    if column.factor == 1.0:
        return column
    note = f'The unit of column "{spec.name}" is taken from its name: {unit}.'
    return replace(column, note=note)


def _known(path: Path, table: Table, index: int, channel: str, stated: str) -> str:
    """The unit that the file itself states; the user's, under [columns], goes before."""
    unit = spelled(stated)
    if not is_accepted(channel, unit):
        raise RecordingError(
            "The file states a unit that is not known for this channel.",
            file=path,
            where=f'column "{table.columns[index]}"',
            found=f'"{shortened(stated)}"',
            expected=choice_of_units(channel) + "; state the right one under [columns]",
        )
    return unit


def _missing_column(path: Path, names: tuple[str, ...], wanted: str) -> RecordingError:
    return RecordingError(
        f'The column "{wanted}" is missing.{did_you_mean(wanted, names)}',
        file=path,
        where="header",
        found=_listed(names),
        expected=f'a column "{wanted}", or another name for it under [columns]',
    )


def _listed(names: tuple[str, ...]) -> str:
    return shortened(", ".join(f'"{name}"' for name in names), 200) or "no column"
