"""Which columns of a file become which channels, and their units."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.array_table import ArrayTable
from bayesbl.recording.channels import (
    CHANNELS,
    TIME,
    ColumnSpec,
    did_you_mean,
    is_mappable,
    or_another_name,
)
from bayesbl.recording.types import FloatArray
from bayesbl.units import (
    OTHER_UNITS,
    QUESTIONS,
    accepted_units,
    choice_of_units,
    conversion_factor,
    is_accepted,
    is_unit,
    plain_letters,
    spelled,
)

_BRACKETS = re.compile(r"[\[({<]([^\])}>]*)[\])}>]")
_BOUNDARY = re.compile(r"^|(?<=[\s_/,:;|.-])|(?<=[a-z]{2})(?=[A-Z])")
_LONGEST_ENDING = 24
_NUMBER_FIRST = re.compile(r"[x×*]?\s*(\d+)(?![\d/]*min)([^\s_A-Za-z]*)")
_BY_TIME = re.compile(r"\S+/(?:s|sec|min)|(?:s|sec|min)\^?-1")
_LENGTHS = frozenset("m mm cm km in inch ft".split())  # noqa: SIM905
_SCALED = re.compile(r"[%‰]$|(?:(?<![^\W_])[x×]|[*])\s*10+$")
"""End of a name that marks a share, or a factor that was or is to be applied."""

COUNTED = frozenset(("sample", "samples"))
_INDEX = re.compile(r"(?:[\s_]|[\s_]?[(\[])\d+[)\]]?$")
"""End of a name that numbers a joint, or one of several columns of the same name."""

_FULL_WIDTH = str.maketrans("（）［］【】／％", "()[][]/%")

_COUNTERS_WORDS = COUNTED | {"index", "number", "no", "nr", "count"}


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the file, the channel it becomes, and its unit.

    ``note`` says that the unit is taken from the column's name, if it is.
    """

    name: str
    channel: str
    unit: str | None
    note: str | None = None
    reversed: bool = False

    @property
    def factor(self) -> float:
        """Factor that converts the column to the channel's own unit and sign."""
        size = 1.0 if self.unit is None else conversion_factor(self.channel, self.unit)
        return -size if self.reversed else size


def choose_columns(table: ArrayTable, specs: Mapping[str, ColumnSpec]) -> list[Column]:
    """Time first, then the mapped columns, then columns that have a channel's name.

    If the file ties columns to clocks, time is the clock of the mapped columns unless it is mapped.
    """
    names = table.columns
    channels = {
        channel: replace(_mapped(table, channel, spec), reversed=spec.reversed)
        for channel, spec in specs.items()
    }
    taken = {column.name for column in channels.values()}
    mapped = {table.clocks[name] for name in taken if name in table.clocks}
    for channel in (TIME, *CHANNELS):
        if channel in channels or channel not in names or channel in taken:
            continue
        if not mapped or table.clocks.get(channel) in mapped:
            channels[channel] = _mapped(table, channel, ColumnSpec(channel))
    used = [column.name for column in channels.values()]
    tied = {table.clocks[name] for name in used if name in table.clocks}
    if len(tied) > 1:
        raise RecordingError(
            "These columns were not sampled together.",
            where=", ".join(f'"{name}"' for name in used),
            found=_listed(tuple(name for name in names if name in tied)) + " as their times",
            expected="columns of one joint, topic or group",
        )
    if TIME not in channels and next(iter(tied), "").endswith(TIME):
        channels[TIME] = Column(tied.pop(), TIME, "s")
    if TIME not in channels:
        raise _missing_column(table, TIME)
    if len(channels) == 1:
        raise RecordingError(
            "No column but time has a known name.",
            where="header",
            found=_listed(names),
            expected=f"at least one of {', '.join(CHANNELS)}; {or_another_name(table.file)}",
        )
    return [channels.pop(TIME), *channels.values()]


@dataclass(frozen=True, slots=True)
class StatedUnit:
    """What a file states about a column's unit."""

    bare: str  # the column's name without the unit
    unit: str | None = None  # in this package's spelling, if known
    unknown: str | None = None  # a unit that is unknown or has no size: a question to the user
    ending: str = ""  # end of the name that states it (n_rad_s); empty if file or brackets do

    def of(self, channel: str) -> StatedUnit:
        """The same for a channel: a unit that the channel cannot have becomes a question.

        A single letter at the end of a name may mean anything: ``speed_a`` may be the speed of axis
        a.
        """
        if self.unit is None or is_accepted(channel, self.unit):
            return self
        before = re.split(r"[\W_]+", self.bare.lower())[-1]
        if len(self.ending) == 1 and before in _LENGTHS | QUESTIONS:  # of vel_mm_s
            return StatedUnit(self.bare, None, f"{before}/{self.ending}")
        if len(self.ending) == 1:
            return StatedUnit(self.bare)
        return replace(self, unit=None, unknown=self.unknown or self.ending or self.unit)


def stated_unit(table: ArrayTable, column: str, name: str | None = None) -> StatedUnit:
    """The unit stated by the file, else in brackets in the column's name, else at the end of the
    name.

    Examples are ``n [rad/s]``, ``n / rad/s``, ``n_rad_per_s`` and ``nRadPerS``. Text that looks
    like a unit but is not known here is ``unknown``, because a guess would be wrong by a factor.
    Indices (``x[0]``) and remarks are not units.
    """
    name = (column if name is None else name).translate(_FULL_WIDTH)
    scaled = _SCALED.search(name.strip())
    of_name = StatedUnit(name, None, scaled[0]) if scaled else _bracketed(name) or _ending(name)
    if of_name.unit and (scaled := _SCALED.search(of_name.bare.strip())):  # n x10 [rpm]
        of_name = replace(of_name, unit=None, unknown=f"{scaled[0]} {of_name.unit}")
    of_file = table.units.get(column, "").strip()
    if re.search(r"[^\W\d_]|[%‰°'\"′″]", of_file):
        unit = spelled(of_file)
        known = (unit, None) if is_unit(unit) else (None, of_file)
        of_name = StatedUnit(of_name.bare, *known)
    # Of an inverter, Hz is the electrical frequency.
    is_electrical = (of_name.unit or "").endswith("Hz")
    return replace(of_name, unit=None, unknown=of_name.unit) if is_electrical else of_name


def stamps_and_values(
    table: ArrayTable, time: str, columns: Sequence[str] = ()
) -> tuple[FloatArray, FloatArray]:
    """Numbers of a time column, shape (n,), and of other columns, shape (n, c)."""
    read = table.numbers([time, *columns])
    return table.with_parts(read[:, 0], time), read[:, 1:]


def _bracketed(name: str) -> StatedUnit | None:
    every = list(_BRACKETS.finditer(name))
    parts = [(b, part) for b in every for part in (b[1], *re.split("[,;]", b[1]))]
    for brackets, part in parts:
        if is_unit(unit := spelled(part)):
            return StatedUnit(name[: brackets.start()] + name[brackets.end() :], unit)
    for brackets in reversed(every):
        text = brackets[1].strip()
        words = re.findall(r"[^\W\d_]+", re.sub("0x[0-9a-f]+", "", text.lower()))
        meant = brackets[0][0] == "[" or any(mark in text for mark in "/%‰°")
        meant |= plain_letters(text) in OTHER_UNITS or _BY_TIME.fullmatch(text) is not None
        meant |= len(words) > 1 and OTHER_UNITS.issuperset(words)  # lbf·ft
        meant |= any(len(word) > 1 and is_unit(spelled(word)) for word in words)
        if meant and (words or re.search("[%‰°]", text)):
            return StatedUnit(name[: brackets.start()] + name[brackets.end() :], None, text)
    return None


def _ending(name: str) -> StatedUnit:
    """The longest unit that a name ends with; a number before it is an index or a question."""
    name = _INDEX.sub("", name.strip())
    for at in (boundary.start() for boundary in _BOUNDARY.finditer(name)):
        text = name[at:].strip()
        is_whole = at == 0 and (len(text) < 2 or text.lower() == "min")  # a name of its own
        if is_whole or len(text) > _LONGEST_ENDING or not re.search(r"[\w°'\"′″]$", text):
            continue
        unit = spelled(text)
        if not is_unit(unit):
            unit = spelled(re.sub("(?<=[a-z]{2})(?=[A-Z])", " ", text))
        if not is_unit(unit):
            continue
        number = _NUMBER_FIRST.match(text)
        if number and (number[2] or re.fullmatch("10+", number[1])):
            return StatedUnit(name[:at], None, text)
        if not number:
            bare = re.sub(r"[\s_/,:;|.-]+(?:in[\s_]*)?$", "", name[:at])
            # Of "x/s" the x may be a unit that is none here, of "x_s" only s may be a unit.
            return StatedUnit(bare, unit, ending=f"/{text}" if name[:at].endswith("/") else text)
    last_two = re.split(r"[\W_]+", name)[-2:]
    if by_time := _BY_TIME.fullmatch(re.split(r"[\s_,:]", name)[-1]):
        return StatedUnit(name, None, by_time[0])
    words = {word for word in re.split(r"[\W_\d]+", name.lower()) if word}
    if words & COUNTED and words <= _COUNTERS_WORDS:
        return StatedUnit(name, None, "a count of samples")
    endings = (plain_letters(" ".join(last_two)), last_two[-1].lower())  # oz-in, counts
    return StatedUnit(name, None, next((e for e in endings if e in QUESTIONS), None))


def _mapped(table: ArrayTable, channel: str, spec: ColumnSpec) -> Column:
    if not is_mappable(channel):
        raise RecordingError(
            "A column is mapped to a channel that does not exist."
            + did_you_mean(channel, (TIME, *CHANNELS)),
            where=f"[columns] {channel}",
            found=f'"{channel}"',
            expected=f"one of {', '.join((TIME, *CHANNELS))}, or a torque's name ending in _nm",
        )
    if spec.name not in table.columns:
        raise _missing_column(table, spec.name)
    stated = StatedUnit(spec.name, spec.unit) if spec.unit else stated_unit(table, spec.name)
    stated = stated.of(channel)
    # What looks like a unit may be the form of a date: time [hh:mm:ss].
    is_of_dates = channel == TIME and table.timestamps(spec.name) is not None
    if stated.unknown and (spec.unit or not is_of_dates):
        raise RecordingError(
            f"{'[columns]' if spec.unit else 'The file'} states a unit that is not known for this "
            "channel.",
            where=f'column "{spec.name}"',
            found=f'"{shortened(stated.unknown)}"',
            expected=choice_of_units(channel) + "; state the right one under [columns]",
        )
    if spec.unit:
        if table.units.get(spec.name, "").strip():
            _require_agreement(stated_unit(table, spec.name).of(channel), channel, spec)
        return Column(spec.name, channel, spec.unit)
    column = Column(spec.name, channel, stated.unit)
    if column.factor == 1.0 or table.units.get(spec.name, "").strip():
        return column
    note = f'The unit of column "{spec.name}" is taken from its name: {stated.unit}.'
    return replace(column, note=note)


def _require_agreement(of_file: StatedUnit, channel: str, spec: ColumnSpec) -> None:
    """Refuse a plain unit beside another one that the file states, perhaps of a later export, and
    anything but a share beside per cent.

    A unit in the column's name is part of what the configuration says already. A word that is no
    unit here may be the same unit in another language.
    """
    unit, other = spec.unit or "", of_file.unit or of_file.unknown or ""
    if "%" in other or "‰" in other:
        agree = " of " in unit
        expected = f'a share, as unit = "% of 12.5 {accepted_units(channel)[0]}"'
    elif unit == "datetime" or unit not in accepted_units(channel):
        return  # datetime says how numbers are written, not how large they are
    elif of_file.unit:
        agree = math.isclose(*(conversion_factor(channel, each) for each in (unit, of_file.unit)))
        expected = f'unit = "{of_file.unit}", or unit = "1 {unit}" if the file is wrong'
    else:
        agree = not is_unit(other) and plain_letters(other) not in OTHER_UNITS
        expected = f'unit = "1 {unit}" if the file is wrong; {choice_of_units(channel)}'
    if not agree:
        raise RecordingError(
            "[columns] and the file state different units.",
            where=f'column "{spec.name}"',
            found=f"{unit} under [columns], {other} in the file",
            expected=expected,
        )


def _missing_column(table: ArrayTable, wanted: str) -> RecordingError:
    names = table.columns
    return RecordingError(
        f'The column "{wanted}" is missing.{did_you_mean(wanted, names)}',
        where="header",
        found=_listed(names),
        expected=f'a column "{wanted}", {or_another_name(table.file)}',
    )


def _listed(names: tuple[str, ...]) -> str:
    return shortened(", ".join(f'"{name}"' for name in names), 200) or "no column"
