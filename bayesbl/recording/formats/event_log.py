"""Text with one value a line, its name and its stamp, as EPICS's camonitor writes it.

::

    axis:Enc-PosAct 2020-12-08 16:17:33.317076 1.12222
    1607444253.317 axis:Enc-PosAct 1.12222

A value holds until the next one of its name: such logs are written on change.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bayesbl.recording.array_table import ArrayTable

_DATE = r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d(?:[.,]\d+)?"
_STAMP = rf"(?P<stamp>{_DATE}|\(?\d{{9,10}}\.\d+\)?)"
_NAME = r"(?P<name>[^\s\d(#%][^\s]*)"
_FORMS = tuple(
    re.compile(form + r"\s+(?P<value>\S+)(?:\s.*)?")
    for form in (rf"{_NAME}\s+{_STAMP}", rf"{_STAMP}\s+{_NAME}", rf"(?P<stamp>{_DATE})")
)
_ALIKE = 0.8
"""Share of the first lines that are events, from which the text is a log of them."""


def form_of_events(lines: Sequence[str]) -> re.Pattern[str] | None:
    """How most lines write an event, if they do; a name is wanted where a line may be a table's."""
    from bayesbl.recording.cells import number_in

    written = [line.strip() for line in lines if line.strip()]
    for form in _FORMS:
        events = [event for line in written if (event := form.fullmatch(line))]
        of_one = form is _FORMS[-1] and any(len(line.split()) > 3 for line in written)
        numbers = [event for event in events if number_in(event["value"], ".") is not None]
        if len(numbers) >= max(2.0, _ALIKE * len(written)) and not of_one:
            return form
    return None


def read_events(file: Path, lines: Iterable[str], form: re.Pattern[str]) -> ArrayTable:
    """A column for each name, over all stamps from the first at which every name has a value.

    Names of fewer than two events are left out; so are lines that are no events, and are counted.
    """
    import numpy as np

    from bayesbl.recording.array_table import ArrayTable
    from bayesbl.recording.cells import number_in
    from bayesbl.recording.timestamps import is_date, seconds_of_dates

    stamps: list[str] = []
    events: list[tuple[str, float]] = []
    places: list[int] = []
    repairs: Counter[str] = Counter()
    for number, line in enumerate(lines, 1):
        event = form.fullmatch(line.strip())
        value = number_in(event["value"], ".") if event else None
        if event is None or value is None:
            repairs["line that is no event left out"] += bool(line.strip())
            continue
        stamps.append(event["stamp"].strip("()"))
        events.append((event.groupdict().get("name") or "value", value))
        places.append(number)
    if is_date(stamps[0]):
        time = seconds_of_dates(stamps, str(file), lambda row: f"line {places[row]}")
    else:
        time = np.array([float(stamp) for stamp in stamps])
        time -= time.min()
    counts = Counter(name for name, _ in events)
    names = [name for name, count in counts.items() if count > 1]
    rows, row = np.unique(time, return_inverse=True)
    values = {name: np.full(rows.size, np.nan) for name in names}
    for at, (name, value) in sorted(zip(row.tolist(), events, strict=True), key=lambda e: e[0]):
        if name in values:
            values[name][at] = value
    begin = max(int(np.flatnonzero(np.isfinite(each))[0]) for each in values.values())
    columns = {}
    for name, each in values.items():
        last = np.maximum.accumulate(np.where(np.isfinite(each), np.arange(rows.size), 0))
        columns[name] = each[last][begin:]
        repairs["value of an event log, held until the next"] += int(np.isnan(each[begin:]).sum())
    return ArrayTable(str(file), {"time_s": rows[begin:], **columns}, repairs=repairs)
